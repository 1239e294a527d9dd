"""`integrator_report`: everything that is measured of an integrator, as a table and in words."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import isfinite
from typing import Any, final

from pinmobile.accuracy.convergence import Convergence
from pinmobile.accuracy.free_body import free_body
from pinmobile.accuracy.held_force import held_force
from pinmobile.arrays import callable_as, finite, positive
from pinmobile.errors import InvalidArgument, shown
from pinmobile.integrators import Integrator
from pinmobile.robot import MobileRobot

__all__ = ["IntegratorReport", "integrator_report"]

_WHOLE = 1e-9  # relative rounding allowed in a ratio of times


@final
@dataclass(frozen=True, eq=False, repr=False)
class IntegratorReport:
    """What was measured of an integrator; printed, it is a table.

    Attributes
    ----------
    integrator : str
        Its name.
    robot : MobileRobot
        What moved.
    duration : float
        How long [s].
    position, heading : Convergence
        Error of the free body's pose at the end [m], [rad].
    momentum, angular_momentum, energy : Convergence
        Largest drift of what the free body should keep, relative to what it started with.
    substeps : Convergence
        The loop with the force held over the largest step, divided into steps of the integrator: largest
        distance from the same loop solved far finer [m]. Its order is the integrator's own.
    sampling : Convergence
        The loop with the force held over each step: largest distance from the loop in continuous time [m].
        Its order is 1 for every integrator that converges, since the held force is late by half a step on
        average.
    held : float
        What holding the force over the largest step costs by itself, with the motion in between exact [m].
    """

    integrator: str
    robot: MobileRobot
    duration: float
    position: Convergence
    heading: Convergence
    momentum: Convergence
    angular_momentum: Convergence
    energy: Convergence
    substeps: Convergence
    sampling: Convergence
    held: float

    @property
    def free(self) -> tuple[Convergence, ...]:
        """All that was measured of the free body."""
        return self.position, self.heading, self.momentum, self.angular_momentum, self.energy

    def __repr__(self) -> str:
        return f"<IntegratorReport: {self.integrator}, {self.position} alone, {self.sampling} in the loop>"

    def __str__(self) -> str:
        steps = self.position.steps
        sections = (
            (f"free body over {self.duration:g} s", self.free),
            (f"closed loop, force held for {steps[0]:g} s", (self.substeps,)),
            ("closed loop against continuous control", (self.sampling,)),
        )
        lines = [f"{self.integrator} on {self.robot}"]
        for title, rows in sections:
            lines.append(f"{title:42}" + "".join(f"{f'h = {h:g} s':>14}" for h in steps))
            lines += [_row(row) for row in rows]
        return "\n".join([*lines, "", *self._words()])

    def _words(self) -> list[str]:
        """Return what the numbers mean."""
        dt, own = self.substeps.steps[0], float(self.substeps.errors[0])
        words = ["order p: with half the step, the error is 1 / 2^p."]
        if not all(row.converges for row in (*self.free, self.substeps)):
            return [
                *words,
                "It does not converge: it solves another equation, or the steps are too long.",
            ]
        words.append("In the loop, holding the force is of order 1 in dt, whatever the integrator.")
        costs = f"At dt = {dt:g} s holding it costs {self.held:.2g} m, the integrator {own:.2g} m: "
        more = "a shorter dt gains more than a better integrator."
        less = "a better integrator, or substeps, gain more than a shorter dt."
        return [*words, costs + (more if own < self.held else less)]


def integrator_report(
    integrator: Integrator,
    robot: MobileRobot | None = None,
    *,
    steps: Sequence[float] = (0.1, 0.05, 0.025, 0.0125, 0.00625),
    duration: float = 2.0,
) -> IntegratorReport:
    """Measure an integrator: its order, what drifts, and what the held force costs beside it.

    Alone, on the body that nothing acts on, which spins about a centre of mass that is not its origin: the
    centre of mass and the heading move uniformly, so pose, momentum and energy are known. No method of this
    library keeps momentum or energy exactly: M depends on psi, so none is a linear function of the state, and
    semi-implicit Euler is symplectic in positions and momenta, not in q and v. All keep the heading, whose
    acceleration is zero.

    In the loop, where computed torque brings the robot back to a circle: as the force is held over the
    largest step, which the integrator divides; and as the force is held over shorter and shorter times.

    Parameters
    ----------
    integrator : callable
        One step, see `pinmobile.integrators`.
    robot : MobileRobot, optional
        By default 30 kg and 1 kg m^2 with the centre of mass at (0.1, 0.05) m.
    steps : sequence of float
        Steps, the largest first [s]. It is the sampling time of the loop, and a whole multiple of the others.
    duration : float
        Of each run [s]; a whole multiple of the largest step.

    Returns
    -------
    report : IntegratorReport
        Print it, or draw it with `pinmobile.plots.integrator`.

    Raises
    ------
    InvalidArgument
        If an argument is not what is expected, or the integrator returns something else than a state.
    """
    callable_as(
        "integrator(acceleration, t, q, v, dt)",
        integrator,
        "one of pinmobile.integrators or such a step",
    )
    body = MobileRobot(30, 1.0, com=(0.1, 0.05)) if robot is None else robot
    if not isinstance(body, MobileRobot):
        raise InvalidArgument(f"robot is {shown(robot)}, expected a MobileRobot")
    total = positive("duration", duration, "s")
    ladder = _ladder(steps, total)
    free, loop = (measure(integrator, body, ladder, total) for measure in (free_body, held_force))
    name: Any = getattr(integrator, "__name__", repr(integrator))
    return IntegratorReport(name, body, total, *free, *loop)


def _ladder(steps: Sequence[float], duration: float) -> list[float]:
    array = finite("steps", steps)
    if array.ndim != 1 or len(array) < 2:
        raise InvalidArgument(f"steps has shape {array.shape}, expected (n,) with n >= 2")
    ladder: list[float] = array.tolist()
    if ladder[-1] <= 0 or any(finer >= coarser for coarser, finer in pairwise(ladder)):
        raise InvalidArgument(f"steps are {ladder} s, expected ones > 0, the largest first")
    if duration / ladder[-1] > _MOST_STEPS:
        raise InvalidArgument(
            f"duration is {duration} s, which makes {duration / ladder[-1]:.3g} of the shortest step, "
            f"expected at most {_MOST_STEPS:g}"
        )
    for name, whole, part in (
        ("duration", duration, ladder[0]),
        *(("steps[0]", ladder[0], h) for h in ladder),
    ):
        if not isfinite(whole / part) or abs(whole / part - round(whole / part)) > _WHOLE * whole / part:
            raise InvalidArgument(f"{name} is {whole} s, expected a whole multiple of the step {part} s")
    return ladder


_MOST_STEPS = 1e7


def _row(row: Convergence) -> str:
    name = f"  {row.name}" + (f" [{row.unit}]" if row.unit else "")
    return f"{name:42}" + "".join(f"{error:14.1e}" for error in row.errors) + f"   {row}"
