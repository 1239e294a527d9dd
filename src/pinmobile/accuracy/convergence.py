"""How an integrator's error shrinks with its step, and what it keeps of a body that nothing acts on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np

from pinmobile.arrays import Array, frozen
from pinmobile.errors import Diverged, InvalidArgument, shown
from pinmobile.integrators import Acceleration, Integrator
from pinmobile.robot import MobileRobot

EPS = float(np.finfo(np.float64).eps)
_LEAST = 0.5  # an order below is that of an error that stays
_ABOVE = 10.0  # times rounding, from where on an error is the method's


@final
@dataclass(frozen=True, eq=False)
class Convergence:
    """How an error shrinks with the step.

    Attributes
    ----------
    name, unit : str
        What is wrong, and in what it is measured; the unit is empty where the error is relative.
    steps : ndarray, shape (n,)
        Steps, the largest first [s].
    errors : ndarray, shape (n,)
        Error at each step; infinite where the run diverged.
    rounding : ndarray, shape (n,)
        What rounding alone may amount to at each step.
    """

    name: str
    unit: str
    steps: Array
    errors: Array
    rounding: Array

    def __post_init__(self) -> None:
        errors = np.where(np.isfinite(self.errors), self.errors, np.inf)
        for name, value in (("steps", self.steps), ("errors", errors), ("rounding", self.rounding)):
            object.__setattr__(self, name, frozen(value))

    @property
    def exact(self) -> bool:
        """Whether the error is that of rounding at every step."""
        return bool((self.errors <= self.rounding).all())

    @property
    def order(self) -> float | None:
        """The slope of log error over log step, by least squares over the errors well above rounding.

        None where fewer than two are: then there is nothing to fit.
        """
        clear = (self.errors > _ABOVE * self.rounding) & np.isfinite(self.errors)
        if clear.sum() < 2:
            return None
        return float(np.polyfit(np.log(self.steps[clear]), np.log(self.errors[clear]), 1)[0])

    @property
    def converges(self) -> bool:
        """Whether the error vanishes with the step, down to rounding: its order is above one half, if any."""
        order = self.order
        return bool(np.isfinite(self.errors).all()) if order is None else order > _LEAST

    def __str__(self) -> str:
        if self.exact:
            return "exact to rounding"
        order = self.order
        if order is None:
            return "diverges" if np.isinf(self.errors).any() else "too close to rounding to tell"
        return f"order {order:.2f}" if self.converges else "does not converge"


FAR = 1e-3 / EPS  # beyond, a metre is lost in rounding; well before anything overflows


def guarded(integrator: Integrator) -> Integrator:
    """Return the integrator, which raises where its answer is no state, or one that is far off.

    Parameters
    ----------
    integrator : callable
        What is watched: the step that comes back raises `InvalidArgument` where it returns something else
        than q and v, and `Diverged` where they are not finite, or larger than numbers can resolve.
    """

    def step(acceleration: Acceleration, t: float, q: Array, v: Array, dt: float) -> tuple[Array, Array]:
        with np.errstate(all="ignore"):
            answer = integrator(acceleration, t, q, v, dt)
        if type(answer) is not tuple or len(answer) != 2 or any(np.shape(x) != q.shape for x in answer):
            raise InvalidArgument(
                f"integrator returned {shown(answer)}, expected (q, v), each of shape {q.shape}"
            )
        if not np.abs(answer).max() < FAR:
            raise Diverged(
                f"the integrator diverged at t = {t + dt:g} s", time=t + dt, q=answer[0], v=answer[1]
            )
        return answer

    return step


# Such that linear and angular momentum and energy are not zero, whatever the robot.
_CENTRE, _DRIFT = np.array([0.5, -0.3]), np.array([0.6, 0.2])  # [m, m/s] of the centre of mass
_HEADING, _SPIN = 0.4, 1.0  # [rad, rad/s]
_WALK = 64.0  # eps; over n steps, roundings add up as sqrt(n)


class _Conserved(NamedTuple):
    """What no motion of the free body changes.

    Attributes
    ----------
    momentum : ndarray, shape (..., 2)
        Linear momentum [kg m/s].
    angular_momentum : ndarray, shape (...)
        About the inertial origin [kg m^2/s].
    energy : ndarray, shape (...)
        Kinetic energy [J].
    """

    momentum: Array
    angular_momentum: Array
    energy: Array


def conserved(robot: MobileRobot, q: Array, v: Array) -> _Conserved:
    """Return momentum and energy, by the motion of the centre of mass.

    Parameters
    ----------
    robot : MobileRobot
        Whose mass, yaw inertia and centre of mass count.
    q, v : ndarray, shape (..., 3)
        Configuration [m, m, rad] and velocity [m/s, m/s, rad/s].
    """
    arm, spin = _arm(robot, q[..., 2]), v[..., 2]
    centre, speed = q[..., :2] + arm, v[..., :2] + spin[..., None] * _left(arm)
    about = robot.mass * (centre[..., 0] * speed[..., 1] - centre[..., 1] * speed[..., 0])
    energy = (robot.mass * np.square(speed).sum(-1) + robot.yaw_inertia * spin**2) / 2
    return _Conserved(robot.mass * speed, about + robot.yaw_inertia * spin, energy)


def free_motion(robot: MobileRobot, t: Array) -> tuple[Array, Array]:
    """Return q and v of the free body, exactly: centre of mass and heading move uniformly.

    Parameters
    ----------
    robot : MobileRobot
        Whose centre of mass counts.
    t : ndarray, shape (...)
        Times [s].

    Returns
    -------
    q, v : ndarray, shape (..., 3)
        [m, m, rad] and [m/s, m/s, rad/s].
    """
    psi = _HEADING + _SPIN * t
    arm = _arm(robot, psi)
    origin = _CENTRE + _DRIFT * t[..., None] - arm
    rate = _DRIFT - _SPIN * _left(arm)
    return np.append(origin, psi[..., None], -1), np.append(rate, np.full((*t.shape, 1), _SPIN), -1)


def free_body(
    integrator: Integrator, robot: MobileRobot, steps: Sequence[float], duration: float
) -> tuple[Convergence, ...]:
    """Return how pose, momentum and energy of the free body are kept at each step.

    Parameters
    ----------
    integrator : callable
        What is judged.
    robot : MobileRobot
        What moves.
    steps : sequence of float
        Steps, each a whole part of the duration [s].
    duration : float
        [s].

    Returns
    -------
    convergences : tuple of five Convergence
        Position and heading at the end; the largest relative drift of linear momentum, angular momentum about
        the origin, and kinetic energy.

    Raises
    ------
    InvalidArgument
        If the integrator returns something else than q and v.
    """
    step = guarded(integrator)
    errors = np.array([_errors(step, robot, h, round(duration / h)) for h in steps])
    scales = _scales(robot, duration)
    taken = duration / np.asarray(steps)
    named = (
        ("position at the end", "m"),
        ("heading at the end", "rad"),
        ("linear momentum, drift", ""),
        ("angular momentum, drift", ""),
        ("kinetic energy, drift", ""),
    )
    return tuple(
        Convergence(name, unit, np.asarray(steps), column, scale * _WALK * EPS * np.sqrt(taken))
        for (name, unit), column, scale in zip(named, errors.T, scales, strict=True)
    )


def _errors(integrator: Integrator, robot: MobileRobot, h: float, count: int) -> list[float]:
    try:
        states = _travelled(integrator, robot, h, count)
    except Diverged:
        return 5 * [np.inf]
    q, v = states[:, 0], states[:, 1]
    start, now = conserved(robot, q[0], v[0]), conserved(robot, q, v)
    off = q[-1] - free_motion(robot, np.asarray(h * count))[0]
    drift = np.linalg.norm(now.momentum - start.momentum, axis=-1) / np.linalg.norm(start.momentum)
    return [
        float(np.hypot(off[0], off[1])),
        float(abs(off[2])),
        float(drift.max()),
        float(np.abs(now.angular_momentum / start.angular_momentum - 1).max()),
        float(np.abs(now.energy / start.energy - 1).max()),
    ]


def _travelled(integrator: Integrator, robot: MobileRobot, h: float, count: int) -> Array:
    """Return q and v at each step, shape (count + 1, 2, 3)."""
    nothing = np.zeros(3)

    def acceleration(t: float, q: Array, v: Array) -> Array:
        return robot.forward_dynamics(q, v, nothing)

    states = np.empty((count + 1, 2, 3))
    states[0] = free_motion(robot, np.zeros(()))
    for k in range(count):
        states[k + 1] = integrator(acceleration, k * h, states[k, 0].copy(), states[k, 1].copy(), h)
    return states


def _scales(robot: MobileRobot, duration: float) -> tuple[float, ...]:
    """Return the size of the terms that each error is the difference of."""
    reach = float(np.linalg.norm(robot.com[:2]))
    far = float(np.linalg.norm(_CENTRE)) + duration * float(np.linalg.norm(_DRIFT)) + reach
    fast = float(np.linalg.norm(_DRIFT)) + reach * _SPIN
    start = conserved(robot, *free_motion(robot, np.zeros(())))
    turn = _HEADING + _SPIN * duration
    momentum = robot.mass * fast
    return (
        far * turn,
        turn,
        momentum / float(np.linalg.norm(start.momentum)),
        (far * momentum + robot.yaw_inertia * _SPIN) / float(start.angular_momentum),
        (momentum * fast + robot.yaw_inertia * _SPIN**2) / float(start.energy),
    )


def _arm(robot: MobileRobot, psi: Array) -> Array:
    """Return the centre of mass seen from the body's origin, along the inertial axes, shape (..., 2)."""
    x, y = robot.com[:2]
    return np.stack([x * np.cos(psi) - y * np.sin(psi), x * np.sin(psi) + y * np.cos(psi)], axis=-1)


def _left(vector: Array) -> Array:
    """Return the vector turned by a quarter to the left, shape (..., 2)."""
    return np.stack([-vector[..., 1], vector[..., 0]], axis=-1)
