"""`Scenario`, the noun: one loop, how often it is run, and what differs from run to run."""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, final

import numpy as np

from pinmobile.arrays import Array, affordable, positive, scalar, whole
from pinmobile.controllers import PD, ComputedTorque, Decoupled, PDGravity, gain_matrix
from pinmobile.ensembles.distributions import Source
from pinmobile.ensembles.draws import draw, held
from pinmobile.ensembles.forces import check_forces, with_spread_forces
from pinmobile.ensembles.histogram import BINS
from pinmobile.ensembles.layers import check_layers, core_of
from pinmobile.ensembles.parameters import PARAMETERS, Parameter
from pinmobile.ensembles.spread import check_supports, checked_spread
from pinmobile.errors import InvalidArgument, shown
from pinmobile.integrators import Integrator, constant_acceleration
from pinmobile.robot import MobileRobot
from pinmobile.simulation import checked_forces, checked_loop, checked_substeps, sample_times, sampled
from pinmobile.trajectories import Reference, Trajectory

__all__ = ["Scenario", "checked_scenario", "first_counted", "time_within"]

_SAME = 1e-6  # of dt: a time that is meant to be a sample's
_GRID = 60  # intervals between counts, about
_MOST = 100_000_000  # robots
_RECORD = 150  # bytes for each, about
_BANDS = 3 * BINS  # numbers for each time of the bands: counts of two quantities, and their sums


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Scenario:
    """A closed loop that is run `n` times, each time with a robot, a start or a disturbance of its own.

    Parameters
    ----------
    robot : MobileRobot
        The nominal robot, without arms. Loads that are attached to it are part of its body.
    controller : controller
        One of the library's, or a user's that works on arrays: it is called with `q` and `v` of shape
        (m, 3) and the reference of shape (3,), and returns a force of shape (m, 3).
    trajectory : trajectory
        The same for all.
    n : int
        Number of robots.
    spread : mapping of str to Distribution, number or array of shape (n,)
        What differs, by the names in `PARAMETERS`. What is not named is nominal; the controller believes in
        its own robot unless ``model_mass`` and the like are named (`TRUE_MODEL`: it knows the truth).
        ``force_x``, ``viscous_left``, ... stand for what the one force of their kind in `forces` has; a
        constant force, friction or rolling resistance that is not there is added, and a sinusoidal force
        where ``sine_frequency`` is named.
    seed : int
        All draws follow from it; robot i's do not depend on n.
    dt, duration, integrator, substeps, forces, limit
        As in `simulate`. A `NoiseForce` has phases of its own for each robot, a `NoisyMeasurement` numbers
        of its own; they follow from the seed here together with theirs.
    after : float
        Errors are kept from this time on [s], so that what a start costs until the robot has settled is not
        taken for what the controller costs; forces, divergence and the bands over time are kept from the
        start.
    every : int, optional
        Samples between two entries of the bands over time; by default there are some 60.

    Raises
    ------
    InvalidArgument, UnknownName
        If an argument is not what is expected, or draws are impossible (with their share).
    """

    robot: MobileRobot
    controller: Any
    trajectory: Trajectory
    n: int
    spread: Mapping[str, Source]
    dt: float
    seed: int = 0
    duration: float | None = None
    integrator: Integrator = constant_acceleration
    substeps: int = 1
    forces: Sequence[Any] = ()
    limit: float = 1e3
    after: float = 0.0
    every: int | None = None
    t: Array = field(init=False, repr=False)
    reference: Reference = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if type(self.robot) is not MobileRobot or self.robot.nv != 3:
            raise InvalidArgument(f"robot is {shown(self.robot)}, expected a MobileRobot without arms")
        checked_loop(self.robot, self.controller, self.trajectory, self.integrator)
        core: Any = core_of(self.controller)
        believed = core.robot if type(core) in (ComputedTorque, PDGravity, Decoupled) else None
        if type(believed) is MobileRobot and believed.nv != self.robot.nv:
            raise InvalidArgument(
                f"controller believes in {believed!r} of {believed.nv} coordinates, expected {self.robot.nv}"
            )
        n = whole("n", self.n)
        if n > _MOST:
            raise InvalidArgument(
                f"n is {n:,}, expected at most {_MOST:,}, whose records take {_MOST * _RECORD / 1e9:.0f} GB"
            )
        dt = positive("dt", self.dt, "s")
        duration = None if self.duration is None else positive("duration", self.duration, "s")
        t = sample_times(dt, duration, self.trajectory.duration)
        every = max(1, round((len(t) - 1) / _GRID)) if self.every is None else whole("every", self.every)
        bands = len(t[::every])
        affordable(
            f"the bands of {bands:,} times, every {every} samples,", _BANDS * bands, "give a larger `every`"
        )
        for name, value in {
            "n": n,
            "dt": dt,
            "duration": duration,
            "seed": whole("seed", self.seed, least=0),
            "substeps": checked_substeps(self.substeps, len(t)),
            "limit": positive("limit", self.limit),
            "after": time_within("after", self.after, t),
            "every": every,
            "spread": checked_spread(self.spread, n),
            "forces": checked_forces(self.forces, self.robot),
            "t": t,
            "reference": sampled(self.trajectory, t, self.robot),
        }.items():
            object.__setattr__(self, name, value)
        check_forces(self.forces)
        object.__setattr__(self, "forces", with_spread_forces(self.forces, self.spread))
        _check_names(self)
        check_layers(self.controller)
        check_supports(self.spread)

    @property
    def stride(self) -> int:
        """Samples between two entries of the bands."""
        return self.every or 1

    @property
    def begin(self) -> int:
        """First sample whose error is kept."""
        return first_counted(self.t, self.after, self.dt)

    @property
    def parameters(self) -> dict[str, Parameter]:
        """What is spread, by name."""
        return {name: PARAMETERS[name] for name in self.spread}

    @property
    def grid(self) -> Array:
        """Times of the bands, shape (G,) [s]."""
        return self.t[:: self.stride]

    @cached_property
    def nominal(self) -> dict[str, float]:
        """The values of the parameters that are not spread."""
        found = dict.fromkeys(PARAMETERS, 0.0) | {"kp_factor": 1.0, "kd_factor": 1.0}
        found |= _of_robot("", self.robot)
        core = core_of(self.controller)
        if type(core) is ComputedTorque and type(core.robot) is MobileRobot:
            found |= _of_robot("model_", core.robot)
        if type(core) in (PD, ComputedTorque):
            for name in ("kp", "kd"):
                diagonal = np.diag(gain_matrix(name, getattr(core, name), 3))
                found |= {f"{name}_{c}": float(g) for c, g in zip(("x", "y", "psi"), diagonal, strict=True)}
                found[name] = float(diagonal[0])
        return found

    def holding(self, start: int, stop: int) -> "Scenario":
        """Return what another process needs of this to run the robots from `start` to before `stop`.

        Explicit arrays of a spread are cut to those robots; all else, and what it draws, is the same.
        """
        part = copy(self)
        object.__setattr__(part, "spread", held(self.spread, start, stop))
        return part

    def draws(self, start: int = 0, stop: int | None = None) -> dict[str, Array]:
        """Return what was drawn for the robots from `start` to before `stop`, shape (stop - start,), by name.

        Parameters
        ----------
        start, stop : int
            Which robots, 0 <= start < stop; by default all n.

        Raises
        ------
        InvalidArgument
            If values are impossible; the message tells their share.
        """
        first, last = whole("start", start, least=0), self.n if stop is None else whole("stop", stop)
        if not first < last <= self.n:
            raise InvalidArgument(f"start is {first} and stop {last}, expected 0 <= start < stop <= {self.n}")
        values = draw(self.spread, self.seed, first, last, self.nominal)
        for name, column in values.items():
            parameter = PARAMETERS[name]
            wrong = ~parameter.allows(column)
            if wrong.any():
                raise InvalidArgument(
                    f"spread[{name!r}] gives {column[wrong].min():.6g} {parameter.unit} as the "
                    f"{parameter.meaning}, and {np.count_nonzero(wrong)} of {len(column)} draws "
                    f"({wrong.mean():.2%}) are impossible; expected {parameter.bound}"
                )
        return values


def checked_scenario(scenario: Any) -> Scenario:
    """Return a scenario, after refusing what is none.

    Raises
    ------
    InvalidArgument
        If it is something else.
    """
    if not isinstance(scenario, Scenario):
        raise InvalidArgument(f"scenario is a {type(scenario).__name__}, expected a Scenario")
    return scenario


def first_counted(t: Array, after: float, dt: float) -> int:
    """Return the first of the samples at times `t` whose error is kept, those `after` a time."""
    return int(np.searchsorted(t, after - _SAME * dt))


def time_within(name: str, value: Any, t: Array) -> float:
    """Return a time of a run that has samples at times `t`.

    Raises
    ------
    InvalidArgument
        If it is not.
    """
    time = scalar(name, value)
    if not 0 <= time <= t[-1]:
        raise InvalidArgument(f"{name} is {time} s, expected from 0 to the duration, {t[-1]:g} s")
    return time


def _of_robot(prefix: str, robot: MobileRobot) -> dict[str, float]:
    bare = robot.lumped() if robot.loads else robot  # loads count as the body's
    values = bare.mass, bare.body.yaw_inertia, *bare.com[:2]
    return dict(
        zip((f"{prefix}{name}" for name in ("mass", "yaw_inertia", "com_x", "com_y")), values, strict=True)
    )


def _check_names(scenario: Scenario) -> None:
    core = core_of(scenario.controller)
    believed = getattr(core, "robot", None)
    if type(core) is ComputedTorque and type(believed) is not MobileRobot:
        for name in scenario.spread:
            if name.startswith(("model_", "kp", "kd")):
                raise InvalidArgument(
                    f"spread has {name!r} but the controller's robot is a {type(believed).__name__}, "
                    "expected a MobileRobot"
                )
    for name in scenario.spread:
        if name.startswith("model_") and type(core) is not ComputedTorque:
            raise InvalidArgument(
                f"spread has {name!r} but the controller is {type(core).__name__}, expected ComputedTorque"
            )
        if name.startswith(("kp", "kd")) and type(core) not in (PD, ComputedTorque):
            kind = type(core).__name__
            raise InvalidArgument(
                f"spread has {name!r} but the controller is {kind}, expected PD or ComputedTorque"
            )
