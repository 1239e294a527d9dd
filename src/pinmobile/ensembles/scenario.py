"""`Scenario`, the noun: one loop, how often it is run, and what differs from run to run."""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, final

import numpy as np

from pinmobile.arrays import Array, positive, whole
from pinmobile.controllers import PD, ComputedTorque, Delayed, NoisyMeasurement, Saturated, gain_matrix
from pinmobile.disturbances import (
    ConstantForce,
    NoiseForce,
    RollingResistance,
    SinusoidalForce,
    ViscousFriction,
)
from pinmobile.ensembles.distributions import Source
from pinmobile.ensembles.spread import PARAMETERS, check_supports, checked_spread, draw, held
from pinmobile.errors import InvalidArgument
from pinmobile.integrators import Integrator, constant_acceleration
from pinmobile.robot import MobileRobot
from pinmobile.simulation import checked_forces, checked_loop, sample_times, sampled
from pinmobile.trajectories import Reference, Trajectory

__all__ = ["Scenario", "core_of", "layers_of"]

_GRID = 60  # intervals between counts, about
_MOST = 100_000_000  # robots
_RECORD = 150  # bytes for each, about


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
        of its own.
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
    every: int | None = None
    t: Array = field(init=False, repr=False)
    reference: Reference = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if type(self.robot) is not MobileRobot or self.robot.nv != 3:
            raise InvalidArgument(f"robot is {self.robot!r}, expected a MobileRobot without arms")
        checked_loop(self.robot, self.controller, self.trajectory, self.integrator)
        believed = getattr(core_of(self.controller), "robot", None)
        if type(believed) is MobileRobot and believed.nv != self.robot.nv:
            raise InvalidArgument(
                f"controller believes in {believed!r} of {believed.nv} coordinates, expected {self.robot.nv}"
            )
        n = whole("n", self.n)
        if n > _MOST:
            raise InvalidArgument(
                f"n is {n:,}, expected at most {_MOST:,}, whose records take {_MOST * _RECORD / 1e9:.0f} GB"
            )
        t = sample_times(positive("dt", self.dt, "s"), self.duration, self.trajectory.duration)
        every = max(1, round((len(t) - 1) / _GRID)) if self.every is None else whole("every", self.every)
        for name, value in {
            "n": n,
            "seed": whole("seed", self.seed, least=0),
            "substeps": whole("substeps", self.substeps),
            "limit": positive("limit", self.limit),
            "every": every,
            "spread": checked_spread(self.spread, n),
            "forces": checked_forces(self.forces, self.robot),
            "t": t,
            "reference": sampled(self.trajectory, t, self.robot),
        }.items():
            object.__setattr__(self, name, value)
        _check_forces(self.forces)
        object.__setattr__(self, "forces", _with_spread_forces(self.forces, self.spread))
        _check_names(self)
        _check_layers(self.controller)
        check_supports(self.spread)

    @property
    def stride(self) -> int:
        """Samples between two entries of the bands."""
        return self.every or 1

    @property
    def robot_steps(self) -> int:
        """Steps of all robots together."""
        return self.n * (len(self.t) - 1)

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
        if isinstance(core, ComputedTorque) and isinstance(core.robot, MobileRobot):
            found |= _of_robot("model_", core.robot)
        if isinstance(core, PD | ComputedTorque):
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
        """Return what was drawn for the robots from `start` to before `stop`, by name.

        Raises
        ------
        InvalidArgument
            If values are impossible; the message tells their share.
        """
        values = draw(self.spread, self.seed, start, self.n if stop is None else stop, self.nominal)
        for name, column in values.items():
            parameter = PARAMETERS[name]
            wrong = ~parameter.allows(column)
            if wrong.any():
                sign = ">=" if parameter.may_vanish else ">"
                raise InvalidArgument(
                    f"spread[{name!r}] gives {column[wrong].min():.6g} {parameter.unit} as the "
                    f"{parameter.meaning}, and {np.count_nonzero(wrong)} of {len(column)} draws "
                    f"({wrong.mean():.2%}) are impossible; expected {sign} 0"
                )
        return values


def core_of(controller: Any) -> Any:
    """Return the controller inside all wrappers of the library."""
    while type(controller) in (Saturated, Delayed, NoisyMeasurement):
        controller = controller.controller
    return controller


def layers_of(controller: Any) -> list[Any]:
    """Return the wrappers of the library around a controller, the outermost first."""
    layers = []
    while type(controller) in (Saturated, Delayed, NoisyMeasurement):
        layers.append(controller)
        controller = controller.controller
    return layers


def _of_robot(prefix: str, robot: MobileRobot) -> dict[str, float]:
    bare = robot.lumped() if robot.loads else robot  # loads count as the body's
    values = bare.mass, bare.body.yaw_inertia, *bare.com[:2]
    return dict(
        zip((f"{prefix}{name}" for name in ("mass", "yaw_inertia", "com_x", "com_y")), values, strict=True)
    )


# What of a force its names in a spread stand for: class, field, and the columns of that field.
FORCE_FIELDS: Mapping[str, tuple[type, str, int | None]] = {
    **{name: (ConstantForce, "force", k) for k, name in enumerate(("force_x", "force_y", "moment_z"))},
    **{name: (SinusoidalForce, "amplitude", k) for k, name in enumerate(("sine_x", "sine_y", "sine_moment"))},
    "sine_frequency": (SinusoidalForce, "frequency", None),
    "sine_phase": (SinusoidalForce, "phase", None),
    **{name: (NoiseForce, "std", k) for k, name in enumerate(("noise_x", "noise_y", "noise_moment"))},
    **{
        f"viscous_{a}": (ViscousFriction, "coefficients", k) for k, a in enumerate(("forward", "left", "yaw"))
    },
    **{f"rolling_{a}": (RollingResistance, "force", k) for k, a in enumerate(("forward", "left", "yaw"))},
}


def _check_forces(forces: Sequence[Any]) -> None:
    known = {kind for kind, _, _ in FORCE_FIELDS.values()}
    for k, force in enumerate(forces):
        shape = np.shape(force(0.0, np.zeros(3), np.zeros(3))) if type(force) in known else (3,)
        if shape != (3,):
            raise InvalidArgument(
                f"forces[{k}] gives shape {shape} for one robot, expected (3,): name in spread what differs"
            )


def _with_spread_forces(forces: Sequence[Any], spread: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return the forces, with those that a spread names and that need no more to be known of them."""
    found = list(forces)
    for name in spread:
        if name not in FORCE_FIELDS:
            continue
        kind = FORCE_FIELDS[name][0]
        count = sum(type(force) is kind for force in found)
        if count > 1:
            raise InvalidArgument(f"forces has {count} {kind.__name__}, expected one for spread[{name!r}]")
        if count == 0:
            found.append(_spread_force(kind, name, spread))
    return tuple(found)


def _spread_force(kind: type, name: str, spread: Mapping[str, Any]) -> Any:
    if kind is NoiseForce:
        raise InvalidArgument(f"spread has {name!r} but forces no NoiseForce, expected one for its bandwidth")
    if kind is not SinusoidalForce:
        return kind(np.zeros(3))
    if "sine_frequency" not in spread:
        raise InvalidArgument(
            f"spread has {name!r} but no 'sine_frequency' and forces no SinusoidalForce, expected one of them"
        )
    return SinusoidalForce(np.zeros(3), 0.0)


def _check_layers(controller: Any) -> None:
    for layer in layers_of(controller):
        for name in ("limits", "std_q", "std_v"):
            shape = np.shape(getattr(layer, name, 0.0))
            if shape not in ((), (3,)):
                raise InvalidArgument(f"{name} has shape {shape}, expected () or (3,)")


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
