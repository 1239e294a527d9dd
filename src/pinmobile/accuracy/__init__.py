"""How good an integrator is: its order, the drift of what should stay, and what holding the force costs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count, pairwise
from math import isfinite
from typing import final

import numpy as np

from pinmobile.accuracy.convergence import EPS, FAR, Convergence, free_body, guarded
from pinmobile.arrays import Array, callable_as, finite, instance, positive, shaped
from pinmobile.controllers import ComputedTorque
from pinmobile.errors import Diverged, InvalidArgument
from pinmobile.integrators import Acceleration, Integrator
from pinmobile.loop import Rollout, simulate
from pinmobile.paths import Circle
from pinmobile.robot import MobileRobot
from pinmobile.trajectories import Tangent

__all__ = ["Convergence", "IntegratorReport", "integrator_report"]

_RADIUS, _RATE = 1.0, 0.5  # [m, rad/s] of the circle that is driven
_OFF = np.array([0.2, -0.1, 0.4])  # [m, m, rad] beside it at the start
_GAIN = 4.0  # kp [1/s^2] and kd [1/s]: critically damped
_MOST = 50_000  # accelerations asked for by the finer solution; it takes some thousand
_TOLERANCE = 1e-13  # of the finer solution, relative


def held_force(
    integrator: Integrator, robot: MobileRobot, steps: Sequence[float], duration: float
) -> tuple[Convergence, Convergence, float]:
    """Return how the integrator does between samples, how the loop does as they get closer, and their gap.

    The robot drives a circle by computed torque with an exact model, from beside it.

    Parameters
    ----------
    integrator : callable
        What is judged.
    robot : MobileRobot
        What is controlled.
    steps : sequence of float
        Steps, the largest first; it is a whole multiple of each [s].
    duration : float
        [s].

    Returns
    -------
    substeps : Convergence
        Largest distance from the loop whose force is held as long, and which is solved far finer. The force
        is held over the largest step; the integrator divides it.
    sampling : Convergence
        Largest distance from the loop in continuous time, with the force held over each step.
    held : float
        Largest distance between those two solutions, which no integrator could make up for [m].
    """
    at = np.asarray(steps)
    run, step = partial(_run, robot, duration), guarded(integrator)
    fine = run(steps[0], _exactly(), 1)
    inner = [_distance(run(steps[0], step, round(steps[0] / h)), fine) for h in steps]
    outer = [_from_continuous(run(h, step, 1)) for h in steps]
    size = _RADIUS + duration
    rounding = size * np.full(len(at), 10 * _TOLERANCE), size * 64 * EPS * np.sqrt(duration / at)
    return (
        Convergence("position, step h", "m", at, np.array(inner), rounding[0]),
        Convergence("position, force held for h", "m", at, np.array(outer), rounding[1]),
        _from_continuous(fine),
    )


def _run(
    robot: MobileRobot, duration: float, dt: float, integrator: Integrator, substeps: int
) -> Rollout | None:
    """Return the loop, or None where it diverges."""
    trajectory = Tangent(Circle(_RADIUS, _RATE, duration))
    controller, start = ComputedTorque(robot, _GAIN, _GAIN), trajectory(0.0).q - _OFF
    try:
        return simulate(
            robot, controller, trajectory, q0=start, dt=dt, integrator=integrator, substeps=substeps
        )
    except Diverged:
        return None


def _exactly() -> Integrator:
    """Return a step of order 8 to about `_TOLERANCE`, which tells in bounded time that it diverges."""
    # Figures of a report need no solver, and scipy's takes a while to load.
    from scipy.integrate import solve_ivp

    asked = count()

    def step(acceleration: Acceleration, t: float, q: Array, v: Array, dt: float) -> tuple[Array, Array]:
        def rate(time: float, x: Array) -> Array:
            # A body that the held force spins up needs ever shorter steps.
            if next(asked) > _MOST or not np.abs(x).max() < FAR:
                raise Diverged(f"the loop diverged at t = {time:g} s", time=time, q=x[:3], v=x[3:])
            return np.concatenate([x[3:], acceleration(time, x[:3], x[3:])])

        options = {"method": "DOP853", "rtol": _TOLERANCE, "atol": 1e-2 * _TOLERANCE}
        end = solve_ivp(rate, (t, t + dt), np.concatenate([q, v]), **options).y[:, -1]
        return end[:3], end[3:]

    return step


def _distance(run: Rollout | None, other: Rollout | None) -> float:
    if run is None or other is None:
        return np.inf
    return float(np.linalg.norm((run.q - other.q)[:, :2], axis=1).max())


def _from_continuous(run: Rollout | None) -> float:
    """Return the largest distance from the loop in continuous time.

    With the model exact, its error obeys e'' + kd e' + kp e = 0, of which kp = kd = 4 is the critically
    damped case; the start is as fast as the reference.
    """
    if run is None:
        return np.inf
    t = run.t[:, None]
    exact = run.reference.q - _OFF * (1 + _GAIN / 2 * t) * np.exp(-_GAIN / 2 * t)
    return float(np.linalg.norm((run.q - exact)[:, :2], axis=1).max())


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
    instance("robot", robot, MobileRobot | None, "a MobileRobot")
    total = positive("duration", duration, "s")
    ladder = _ladder(steps, total)
    free, loop = (measure(integrator, body, ladder, total) for measure in (free_body, held_force))
    name = getattr(integrator, "__name__", repr(integrator))
    return IntegratorReport(name, body, total, *free, *loop)


def _ladder(steps: Sequence[float], duration: float) -> list[float]:
    array = shaped("steps", finite("steps", steps), ("n>=2",))
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
