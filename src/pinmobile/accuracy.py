"""How good an integrator is: its order, the drift of what should stay, and what holding the force costs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count, pairwise
from math import isfinite
from typing import NamedTuple, final

import numpy as np

from pinmobile.arrays import Array, callable_as, finite, frozen, instance, positive, shaped
from pinmobile.controllers import ComputedTorque
from pinmobile.errors import Diverged, InvalidArgument, shown
from pinmobile.integrators import Acceleration, Integrator
from pinmobile.loop import Rollout, simulate
from pinmobile.paths import Circle
from pinmobile.robot import MobileRobot
from pinmobile.trajectories import Tangent

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
