"""The integrator in the loop: its own error, and that of holding the force between two samples."""

from collections.abc import Sequence
from functools import partial
from itertools import count
from typing import Any

import numpy as np

from pinmobile.accuracy.convergence import EPS, Convergence
from pinmobile.accuracy.guarded import FAR, guarded
from pinmobile.arrays import Array
from pinmobile.controllers import ComputedTorque
from pinmobile.errors import Diverged
from pinmobile.integrators import Acceleration, Integrator
from pinmobile.paths import Circle
from pinmobile.robot import MobileRobot
from pinmobile.simulation import Rollout, simulate
from pinmobile.trajectories import Tangent

__all__ = ["held_force"]

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
    options: dict[str, Any] = {"dt": dt, "integrator": integrator, "substeps": substeps}
    try:
        start = trajectory(0.0).q - _OFF
        return simulate(robot, ComputedTorque(robot, _GAIN, _GAIN), trajectory, q0=start, **options)
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
