"""`BenchmarkScenario`: a loop in which controllers are compared, and what goes wrong in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from pinmobile.arrays import (
    ArrayLike,
    endless_or_finite,
    finite,
    frozen,
    non_negative,
    positive,
    real,
    sequence,
    text,
    whole,
)
from pinmobile.controllers import Controller, Delayed, NoisyMeasurement, Saturated
from pinmobile.errors import InvalidArgument, NotTraceable
from pinmobile.integrators import Integrator, rk4
from pinmobile.loop import COMPILED, PYTHON, Rollout, Scenario, Source, check_mapping, simulate
from pinmobile.paths import Circle
from pinmobile.robot import MobileRobot
from pinmobile.trajectories import Reference, Tangent

NOMINAL = MobileRobot(mass=30.0, yaw_inertia=1.3, com=(0.1, 0.05))
"""The robot in which the controllers of the standard scenarios believe."""

CIRCLE = Tangent(Circle(radius=1.5, rate=0.6, duration=30.0))
"""What the standard scenarios drive: 0.9 m/s, for 30 s."""


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class BenchmarkScenario:
    """A loop in which controllers are compared: what is driven, and what goes wrong.

    Parameters
    ----------
    robot : plant
        What is simulated; its controllers need not know it.
    trajectory : trajectory
        What is followed, from its start on.
    forces : sequence of forces
        As in `simulate`.
    delay : int
        By how many samples what is measured is late.
    noise : float
        Standard deviation of the measured coordinates [m, rad], 0 for none; that of their rates is ten times
        as large [m/s, rad/s].
    limits : array_like, shape () or (nu,), optional
        Largest inputs.
    lower, upper : array_like, shape (2,), optional
        Walls: between which x and y of the body's origin must stay [m]; infinite where there is none.
    offset : array_like, shape (nv,), optional
        By what displacement the start is off the trajectory [m, m, rad, ...].
    event : float
        From when on recovery counts [s].
    band : float
        Within which distance the robot has recovered [m].
    after : float
        From when on distances, forces and chatter count [s], but those from the start.
    dt, integrator, substeps
        As in `simulate`.
    seed : int
        Of the noise.
    about : str
        What it is, in words.

    Raises
    ------
    InvalidArgument
        If a number is not what is expected; of the parts, when they are run.
    """

    robot: Any = NOMINAL
    trajectory: Any = CIRCLE
    forces: Sequence[Any] = ()
    delay: int = 0
    noise: float = 0.0
    limits: ArrayLike | None = None
    lower: ArrayLike | None = None
    upper: ArrayLike | None = None
    offset: ArrayLike | None = None
    event: float = 0.0
    band: float = 0.005
    after: float = 5.0
    dt: float = 0.01
    integrator: Integrator | None = rk4
    substeps: int = 4
    seed: int = 0
    about: str = ""

    def __post_init__(self) -> None:
        checked: dict[str, Any] = {
            "forces": sequence("forces", self.forces, "a sequence of forces"),
            "delay": whole("delay", self.delay, least=0),
            "noise": float(non_negative("noise", self.noise, "m")),
            "event": float(non_negative("event", self.event, "s")),
            "after": float(non_negative("after", self.after, "s")),
            "band": positive("band", self.band, "m"),
            "dt": positive("dt", self.dt, "s"),
            "substeps": whole("substeps", self.substeps),
            "seed": whole("seed", self.seed, least=0),
            "about": text("about", self.about),
        }
        for name in ("limits", "offset"):
            given = getattr(self, name)
            checked[name] = None if given is None else frozen(finite(name, given))
        for name, sign in (("lower", -1.0), ("upper", 1.0)):
            given = getattr(self, name)
            outward = np.full(2, np.inf) if given is None else sign * real(name, given)
            wall = sign * endless_or_finite(name, outward)
            if wall.shape != (2,):
                raise InvalidArgument(f"{name} has shape {wall.shape}, expected (2,)")
            checked[name] = frozen(wall)
        if not (checked["lower"] < checked["upper"]).all():
            raise InvalidArgument(
                f"lower is {checked['lower'].tolist()} and upper {checked['upper'].tolist()}, expected walls "
                "between which there is room"
            )
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    @property
    def has_walls(self) -> bool:
        """Whether there is any wall."""
        return any(np.isfinite(np.asarray(wall)).any() for wall in (self.lower, self.upper))

    def around(self, controller: Controller) -> Controller:
        """Return the controller behind the limits, the delay and the noise of the scenario.

        One that has ``within(limits, lower, upper)``, as `MPC`, is told of limits and walls, and what that
        returns is taken.
        """
        made: Any = controller
        if hasattr(made, "within") and (self.limits is not None or self.has_walls):
            made = made.within(self.limits, self.lower, self.upper)
        if self.limits is not None:
            made = Saturated(made, self.limits)
        if self.noise:
            made = NoisyMeasurement(made, self.noise, 10 * self.noise, self.seed)
        return Delayed(made, self.delay) if self.delay else made

    def run(self, controller: Controller) -> Rollout:
        """Return the run, compiled where the controller's law can be.

        Raises
        ------
        Diverged
            If the loop does.
        """
        first = Reference(*(np.asarray(part, np.float64) for part in self.trajectory(0.0)))
        q, v = self.robot.start(first)
        if self.offset is not None:
            q = self.robot.integrate(q, np.asarray(self.offset))
        given: dict[str, Any] = {
            "dt": self.dt, "integrator": self.integrator, "substeps": self.substeps, "q0": q, "v0": v,
            "forces": self.forces,
        }  # fmt: skip
        loop = self.robot, self.around(controller), self.trajectory
        try:
            return simulate(*loop, engine=COMPILED, **given)
        except InvalidArgument as error:
            if not isinstance(error.__cause__, NotTraceable):
                raise
        return simulate(*loop, engine=PYTHON, **given)

    def scenario(
        self, controller: Controller, n: int, spread: Mapping[str, Source], *, seed: int = 0
    ) -> Scenario:
        """Return the loop of `n` robots that differ, for `run_scenario` and `sweep`.

        Parameters
        ----------
        controller : controller
            As in `benchmark`.
        n : int
            Number of robots.
        spread : mapping of str to Distribution, number or array of shape (n,)
            What differs, see `Scenario`; a start that is named is that, instead of `offset`.
        seed : int
            Of the draws.

        Raises
        ------
        InvalidArgument, UnknownName
            As of `Scenario`.
        """
        check_mapping(spread)
        offset = np.zeros(0) if self.offset is None else np.asarray(self.offset)
        starts = {f"start.{c.name}": float(by) for c, by in zip(self.robot.coordinates, offset, strict=False)}
        return Scenario(
            robot=self.robot, controller=self.around(controller), trajectory=self.trajectory, n=n,
            spread=starts | dict(spread), dt=self.dt, seed=seed, integrator=self.integrator,
            substeps=self.substeps, forces=self.forces, after=self.after,
        )  # fmt: skip
