"""Accuracy of an integrator: order, drift of conserved quantities, and the cost of a zero-order hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count, pairwise
from typing import NamedTuple, final

import numpy as np

from pinmobile.arrays import (
    Array,
    callable_as,
    count_steps,
    finite,
    frozen,
    instance,
    positive,
    rotate,
    shaped,
)
from pinmobile.controllers import ComputedTorque
from pinmobile.errors import Diverged, InvalidArgument
from pinmobile.integrators import Acceleration, Integrator
from pinmobile.loop import Rollout, simulate
from pinmobile.paths import Circle
from pinmobile.robot import MobileRobot
from pinmobile.trajectories import Tangent

EPS = float(np.finfo(np.float64).eps)  # machine epsilon, 2.2e-16
_MIN_ORDER = 0.5  # smallest order that counts as convergence
_ERROR_RATIO = 10.0  # smallest ratio of an error to rounding that enters the order


@final
@dataclass(frozen=True, eq=False)
class Convergence:
    """Error of an integrator as a function of the time step.

    Attributes
    ----------
    name, unit : str
        Name and unit of the error; the unit is empty for a relative error.
    steps : ndarray, shape (n,)
        Time steps, largest first [s].
    errors : ndarray, shape (n,)
        Error at each step, in `unit`; infinite for a run that diverged.
    rounding : ndarray, shape (n,)
        Error that rounding alone may cause at each step, in `unit`.

    See Also
    --------
    accuracy.integrator_report : measurement of an integrator
    plots.integrator : figure of the errors

    Examples
    --------
    >>> from pinmobile.accuracy import Convergence
    >>> errors = [4e-3, 1e-3, 2.5e-4]
    >>> found = Convergence(
    ...     "position", "m", [0.1, 0.05, 0.025], errors, [1e-12] * 3
    ... )
    >>> print(found)
    order 2.00
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
        """Whether rounding explains the error at every step."""
        return bool((self.errors <= self.rounding).all())

    @property
    def order(self) -> float | None:
        """Slope of log error over log step, by least squares over the errors well above rounding.

        It is None for fewer than two such errors.
        """
        is_clear = (self.errors > _ERROR_RATIO * self.rounding) & np.isfinite(self.errors)
        if is_clear.sum() < 2:
            return None
        return float(np.polyfit(np.log(self.steps[is_clear]), np.log(self.errors[is_clear]), 1)[0])

    @property
    def converges(self) -> bool:
        """Whether the error vanishes with the step, down to rounding: its order is None or above one half."""
        order = self.order
        return bool(np.isfinite(self.errors).all()) if order is None else order > _MIN_ORDER

    def __str__(self) -> str:
        if self.exact:
            return "exact to rounding"
        order = self.order
        if order is None:
            return "diverges" if np.isinf(self.errors).any() else "too close to rounding for an order"
        return f"order {order:.2f}" if self.converges else "does not converge"


# Largest position, 4.5e12 m: beyond, rounding would lose a millimetre, long before an overflow.
FAR = 1e-3 / EPS


def guard(integrator: Integrator) -> Integrator:
    """Return the integrator with checks: its step raises an error for an invalid or diverged state.

    Parameters
    ----------
    integrator : callable
        Integrator to check, see `integrators`.

    Returns
    -------
    callable
        The same step. It raises `Diverged` for a result that is not finite or exceeds `FAR`.

    Raises
    ------
    Diverged
        If a step returns values that are not finite or exceed `FAR`.

    See Also
    --------
    rk4 : an integrator
    accuracy.integrator_report : measurement of an integrator

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import rk4
    >>> from pinmobile.accuracy import guard
    >>> explode = lambda t, q, v: 1e300 * np.ones(3)
    >>> guard(rk4)(explode, 0.0, np.zeros(3), np.zeros(3), 0.1)
    Traceback (most recent call last):
    ...
    pinmobile.errors.Diverged: the integrator diverged at t = 0.1 s
    """

    def step(acceleration: Acceleration, t: float, q: Array, v: Array, dt: float) -> tuple[Array, Array]:
        with np.errstate(all="ignore"):
            answer = integrator(acceleration, t, q, v, dt)
        if not np.abs(answer).max() < FAR:
            raise Diverged(
                f"the integrator diverged at t = {t + dt:g} s", time=t + dt, q=answer[0], v=answer[1]
            )
        return answer

    return step


# Chosen so that momentum, angular momentum and energy are not zero for any robot.
_CENTRE, _DRIFT = np.array([0.5, -0.3]), np.array([0.6, 0.2])  # position, velocity of the centre [m, m/s]
_HEADING, _SPIN = 0.4, 1.0  # [rad, rad/s]
_WALK = 64.0  # [eps]: rounding per step; over n steps, roundings add up as sqrt(n)


class _Invariants(NamedTuple):
    """Conserved quantities of a body without external forces.

    Attributes
    ----------
    momentum : ndarray, shape (..., 2)
        Linear momentum [kg m/s].
    angular_momentum : ndarray, shape (...)
        Angular momentum about the inertial origin [kg m^2/s].
    energy : ndarray, shape (...)
        Kinetic energy [J].
    """

    momentum: Array
    angular_momentum: Array
    energy: Array


def invariants(robot: MobileRobot, q: Array, v: Array) -> _Invariants:
    """Return momentum, angular momentum and energy from the motion of the centre of mass.

    Parameters
    ----------
    robot : MobileRobot
        Robot with mass, yaw inertia and centre of mass.
    q, v : ndarray, shape (..., 3)
        Configuration [m, m, rad] and velocity [m/s, m/s, rad/s].

    Returns
    -------
    momentum : ndarray, shape (..., 2)
        Linear momentum [kg m/s].
    angular_momentum : ndarray, shape (...)
        Angular momentum about the inertial origin [kg m^2/s].
    energy : ndarray, shape (...)
        Kinetic energy [J].

    See Also
    --------
    accuracy.free_motion : exact motion without forces
    MobileRobot.kinetic_energy : energy by Pinocchio

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import MobileRobot
    >>> from pinmobile.accuracy import invariants
    >>> q, v = np.array([0.0, 2.0, 0.0]), np.array([1.0, 0.0, 0.0])
    >>> invariants(MobileRobot.lecture(), q, v).angular_momentum
    np.float64(-60.0)
    """
    arm, spin = _arm(robot, q[..., 2]), v[..., 2]
    centre, speed = q[..., :2] + arm, v[..., :2] + spin[..., None] * _quarter_turn(arm)
    moment = robot.mass * (centre[..., 0] * speed[..., 1] - centre[..., 1] * speed[..., 0])
    energy = (robot.mass * np.square(speed).sum(-1) + robot.yaw_inertia * spin**2) / 2
    return _Invariants(robot.mass * speed, moment + robot.yaw_inertia * spin, energy)


def free_motion(robot: MobileRobot, t: Array) -> tuple[Array, Array]:
    """Return exact q and v of a body without forces: its centre of mass and its heading move uniformly.

    Parameters
    ----------
    robot : MobileRobot
        Robot with the centre of mass.
    t : ndarray, shape (...)
        Times [s].

    Returns
    -------
    q, v : ndarray, shape (..., 3)
        Configuration [m, m, rad] and velocity [m/s, m/s, rad/s].

    See Also
    --------
    accuracy.invariants : momentum and energy of this motion
    accuracy.free_body : errors of an integrator for this motion

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import MobileRobot
    >>> from pinmobile.accuracy import free_motion
    >>> q, v = free_motion(MobileRobot.lecture(), np.array([0.0, 1.0]))
    >>> q[1] - q[0]  # uniform motion [m, m, rad]
    array([0.6, 0.2, 1. ])
    """
    psi = _HEADING + _SPIN * t
    arm = _arm(robot, psi)
    origin = _CENTRE + _DRIFT * t[..., None] - arm
    rate = _DRIFT - _SPIN * _quarter_turn(arm)
    return np.append(origin, psi[..., None], -1), np.append(rate, np.full((*t.shape, 1), _SPIN), -1)


def free_body(
    integrator: Integrator, robot: MobileRobot, steps: Sequence[float], duration: float
) -> tuple[Convergence, ...]:
    """Return the errors of pose, momentum and energy of a body without forces, for each time step.

    Parameters
    ----------
    integrator : callable
        Integrator to measure, see `integrators`.
    robot : MobileRobot
        Moving robot.
    steps : sequence of float
        Time steps that divide the duration [s].
    duration : float
        Duration of the motion [s].

    Returns
    -------
    tuple of five Convergence
        Position [m] and heading [rad] at the end, and the largest relative drift of linear momentum, angular
        momentum about the origin, and kinetic energy.

    Raises
    ------
    InvalidArgument
        If the integrator does not return q and v.

    See Also
    --------
    accuracy.integrator_report : all measurements of an integrator
    accuracy.hold_errors : errors in a closed loop

    Examples
    --------
    >>> from pinmobile import MobileRobot, rk4
    >>> from pinmobile.accuracy import free_body
    >>> robot = MobileRobot(30, 1.0, com=(0.1, 0.05))
    >>> position, *_ = free_body(rk4, robot, [0.1, 0.05], 1.0)
    >>> position.order
    4.0
    """
    step = guard(integrator)
    errors = np.array([_errors(step, robot, h, round(duration / h)) for h in steps])
    scales = _scales(robot, duration)
    counts = duration / np.asarray(steps)
    titles = (
        ("position at the end", "m"),
        ("heading at the end", "rad"),
        ("linear momentum, drift", ""),
        ("angular momentum, drift", ""),
        ("kinetic energy, drift", ""),
    )
    return tuple(
        Convergence(name, unit, np.asarray(steps), column, scale * _WALK * EPS * np.sqrt(counts))
        for (name, unit), column, scale in zip(titles, errors.T, scales, strict=True)
    )


def _errors(integrator: Integrator, robot: MobileRobot, h: float, count: int) -> list[float]:
    try:
        states = _simulate_states(integrator, robot, h, count)
    except Diverged:
        return 5 * [np.inf]
    q, v = states[:, 0], states[:, 1]
    start, end = invariants(robot, q[0], v[0]), invariants(robot, q, v)
    error = q[-1] - free_motion(robot, np.asarray(h * count))[0]
    drift = np.linalg.norm(end.momentum - start.momentum, axis=-1) / np.linalg.norm(start.momentum)
    return [
        float(np.hypot(error[0], error[1])),
        float(abs(error[2])),
        float(drift.max()),
        float(np.abs(end.angular_momentum / start.angular_momentum - 1).max()),
        float(np.abs(end.energy / start.energy - 1).max()),
    ]


def _simulate_states(integrator: Integrator, robot: MobileRobot, h: float, count: int) -> Array:
    """Return q and v at each step, shape (count + 1, 2, 3)."""
    zero = np.zeros(3)

    def acceleration(t: float, q: Array, v: Array) -> Array:
        return robot.forward_dynamics(q, v, zero)

    states = np.empty((count + 1, 2, 3))
    states[0] = free_motion(robot, np.zeros(()))
    for k in range(count):
        states[k + 1] = integrator(acceleration, k * h, states[k, 0].copy(), states[k, 1].copy(), h)
    return states


def _scales(robot: MobileRobot, duration: float) -> tuple[float, ...]:
    """Return the size of the terms whose difference is each error."""
    reach = float(np.linalg.norm(robot.com[:2]))
    distance = float(np.linalg.norm(_CENTRE)) + duration * float(np.linalg.norm(_DRIFT)) + reach
    speed = float(np.linalg.norm(_DRIFT)) + reach * _SPIN
    start = invariants(robot, *free_motion(robot, np.zeros(())))
    turn = _HEADING + _SPIN * duration
    momentum = robot.mass * speed
    return (
        distance * turn,
        turn,
        momentum / float(np.linalg.norm(start.momentum)),
        (distance * momentum + robot.yaw_inertia * _SPIN) / float(start.angular_momentum),
        (momentum * speed + robot.yaw_inertia * _SPIN**2) / float(start.energy),
    )


def _arm(robot: MobileRobot, psi: Array) -> Array:
    """Return the centre of mass from the body's origin, along the inertial axes, shape (..., 2) [m]."""
    return rotate(np.cos(psi), np.sin(psi), np.asarray(robot.com[:2]))


def _quarter_turn(vector: Array) -> Array:
    """Return the vector rotated by a quarter turn to the left, shape (..., 2)."""
    return np.stack([-vector[..., 1], vector[..., 0]], axis=-1)


_RADIUS, _RATE = 1.0, 0.5  # radius and angular rate of the reference circle [m, rad/s]
_INITIAL_ERROR = np.array([0.2, -0.1, 0.4])  # initial error [m, m, rad]
_GAIN = 4.0  # kp [1/s^2] and kd [1/s]: critically damped
_MAX_EVALUATIONS = 50_000  # largest number of evaluations in the accurate solution, which needs some thousand
_TOLERANCE = 1e-13  # relative tolerance of the accurate solution


def hold_errors(
    integrator: Integrator, robot: MobileRobot, steps: Sequence[float], duration: float
) -> tuple[Convergence, Convergence, float]:
    """Return the errors of an integrator between samples and of the sampled loop, and the cost of the hold.

    Computed torque with an exact model drives the robot from a point beside a circle onto this circle.

    Parameters
    ----------
    integrator : callable
        Integrator to measure, see `integrators`.
    robot : MobileRobot
        Controlled robot.
    steps : sequence of float
        Time steps, largest first; the largest is a multiple of each [s].
    duration : float
        Duration of each run [s].

    Returns
    -------
    substeps : Convergence
        Largest distance from an accurate solution of the loop with the same zero-order hold [m]. The force is
        constant over the largest step; the integrator divides this step.
    sampling : Convergence
        Largest distance from the loop in continuous time [m]. The force is constant over each step.
    hold_error : float
        Largest distance between these two solutions [m], which no integrator can reduce.

    Raises
    ------
    InvalidArgument
        If the integrator does not return q and v.

    See Also
    --------
    accuracy.integrator_report : all measurements of an integrator
    accuracy.free_body : errors without a controller

    Examples
    --------
    >>> from pinmobile import MobileRobot, rk4
    >>> from pinmobile.accuracy import hold_errors
    >>> robot = MobileRobot(30, 1.0, com=(0.1, 0.05))
    >>> _, sampling, cost = hold_errors(rk4, robot, [0.1, 0.05], 0.5)
    >>> print(f"order {sampling.order:.0f}, hold {1e3 * cost:.1f} mm")
    order 1, hold 8.3 mm
    """
    dt = np.asarray(steps)
    run, step = partial(_run, robot, duration), guard(integrator)
    fine = run(steps[0], _exact_integrator(), 1)
    substep_errors = [_distance(run(steps[0], step, round(steps[0] / h)), fine) for h in steps]
    sampling_errors = [_continuous_error(run(h, step, 1)) for h in steps]
    size = _RADIUS + duration
    rounding = size * np.full(len(dt), 10 * _TOLERANCE), size * 64 * EPS * np.sqrt(duration / dt)
    return (
        Convergence("position, step h", "m", dt, np.array(substep_errors), rounding[0]),
        Convergence("position, force held for h", "m", dt, np.array(sampling_errors), rounding[1]),
        _continuous_error(fine),
    )


def _run(
    robot: MobileRobot, duration: float, dt: float, integrator: Integrator, substeps: int
) -> Rollout | None:
    """Return the rollout of the loop, or None if the loop diverges."""
    trajectory = Tangent(Circle(_RADIUS, _RATE, duration))
    controller, start = ComputedTorque(robot, _GAIN, _GAIN), trajectory(0.0).q - _INITIAL_ERROR
    try:
        return simulate(
            robot, controller, trajectory, q0=start, dt=dt, integrator=integrator, substeps=substeps
        )
    except Diverged:
        return None


def _exact_integrator() -> Integrator:
    """Return a step of order 8 with a tolerance of `_TOLERANCE`, which detects divergence in bounded time."""
    # Imported here: figures of a report need no solver, and scipy loads slowly.
    from scipy.integrate import solve_ivp

    counter = count()

    def step(acceleration: Acceleration, t: float, q: Array, v: Array, dt: float) -> tuple[Array, Array]:
        def rate(time: float, x: Array) -> Array:
            # A constant force may accelerate the body's rotation, which requires ever shorter steps.
            if next(counter) > _MAX_EVALUATIONS or not np.abs(x).max() < FAR:
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


def _continuous_error(run: Rollout | None) -> float:
    """Return the largest distance from the loop in continuous time [m].

    With an exact model, the error satisfies e'' + kd e' + kp e = 0. kp = kd = 4 gives critical damping. The
    initial velocity equals that of the reference.
    """
    if run is None:
        return np.inf
    t = run.t[:, None]
    exact = run.reference.q - _INITIAL_ERROR * (1 + _GAIN / 2 * t) * np.exp(-_GAIN / 2 * t)
    return float(np.linalg.norm((run.q - exact)[:, :2], axis=1).max())


@final
@dataclass(frozen=True, eq=False, repr=False)
class IntegratorReport:
    """Measured accuracy of an integrator; its text is a table.

    Attributes
    ----------
    integrator : str
        Name of the integrator.
    robot : MobileRobot
        Moving robot.
    duration : float
        Duration of each run [s].
    position, heading : Convergence
        Error of the pose at the end, without forces [m], [rad].
    momentum, angular_momentum, energy : Convergence
        Largest relative drift of conserved quantities, without forces.
    substeps : Convergence
        Closed loop with a constant force over the largest step, which the integrator divides: largest
        distance from an accurate solution of this loop [m]. Its order is the order of the integrator.
    sampling : Convergence
        Closed loop with a constant force over each step: largest distance from the loop in continuous time
        [m]. Its order is 1 for every integrator that converges, since a zero-order hold delays the force by
        half a step on average.
    hold_error : float
        Cost of the zero-order hold over the largest step alone, with exact motion between samples [m].

    See Also
    --------
    accuracy.integrator_report : function that returns this object
    plots.integrator : figure of this report

    Examples
    --------
    >>> from pinmobile import rk4
    >>> from pinmobile.accuracy import integrator_report
    >>> report = integrator_report(rk4, steps=(0.1, 0.05), duration=0.2)
    >>> report.hold_error > 1000 * report.substeps.errors[0]
    np.True_
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
    hold_error: float

    @property
    def free(self) -> tuple[Convergence, ...]:
        """All measurements of the body without forces."""
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
        lines = [f"{self.integrator} on {self.robot!r}"]
        for title, rows in sections:
            lines.append(f"{title:42}" + "".join(f"{f'h = {h:g} s':>14}" for h in steps))
            lines += [_format_row(row) for row in rows]
        return "\n".join([*lines, "", *self._words()])

    def _words(self) -> list[str]:
        """Return the conclusions from the measurements, line by line."""
        dt, error = self.substeps.steps[0], float(self.substeps.errors[0])
        words = ["order p: with half the step, the error is 1 / 2^p."]
        if not all(row.converges for row in (*self.free, self.substeps)):
            return [
                *words,
                "The integrator does not converge: it solves another equation, or the steps are too long.",
            ]
        words.append("In the loop, the zero-order hold has order 1 in dt, for every integrator.")
        costs = f"At dt = {dt:g} s the hold costs {self.hold_error:.2g} m, the integrator {error:.2g} m: "
        shorter_dt = "a shorter dt gains more than a better integrator."
        better_integrator = "a better integrator, or substeps, gain more than a shorter dt."
        return [*words, costs + (shorter_dt if error < self.hold_error else better_integrator)]


def integrator_report(
    integrator: Integrator,
    robot: MobileRobot | None = None,
    *,
    steps: Sequence[float] = (0.1, 0.05, 0.025, 0.0125, 0.00625),
    duration: float = 2.0,
) -> IntegratorReport:
    """Measure the accuracy of an integrator: order, drift, and the cost of the zero-order hold.

    The first part simulates a body without forces whose centre of mass is not its origin. Its centre of mass
    and heading move uniformly, so pose, momentum and energy are known. No integrator of this library
    conserves momentum or energy exactly: M depends on psi, so neither is a linear function of the state, and
    semi-implicit Euler is symplectic in positions and momenta, not in q and v. All integrators are exact in
    the heading, whose acceleration is zero.

    The second part simulates a closed loop, where computed torque drives the robot onto a circle. One series
    keeps the force constant over the largest step, which the integrator divides. The other keeps the force
    constant over shorter and shorter steps.

    Parameters
    ----------
    integrator : callable
        Function for one step, see `integrators`.
    robot : MobileRobot, optional
        Robot; by default, 30 kg and 1 kg m^2 with the centre of mass at (0.1, 0.05) m.
    steps : sequence of float
        Time steps, largest first [s]. The largest is the sampling time of the loop and a multiple of the
        others.
    duration : float
        Duration of each run [s], a multiple of the largest step.

    Returns
    -------
    IntegratorReport
        All errors; its text is a table.

    Raises
    ------
    InvalidArgument
        If an argument is not what is expected, or the integrator does not return a state.

    See Also
    --------
    rk4 : Runge-Kutta method of order 4
    plots.integrator : figure of the report

    Examples
    --------
    >>> from pinmobile import rk4
    >>> from pinmobile.accuracy import integrator_report
    >>> report = integrator_report(rk4, steps=(0.1, 0.05), duration=0.2)
    >>> print(report.position, "|", report.sampling)
    order 4.00 | order 1.0...
    """
    callable_as(
        "integrator(acceleration, t, q, v, dt)",
        integrator,
        "an integrator of pinmobile.integrators or a similar function",
    )
    body = MobileRobot(30, 1.0, com=(0.1, 0.05)) if robot is None else robot
    instance("robot", robot, MobileRobot | None, "a MobileRobot")
    total = positive("duration", duration, "s")
    ladder = _check_steps(steps, total)
    free, loop = (measure(integrator, body, ladder, total) for measure in (free_body, hold_errors))
    name = getattr(integrator, "__name__", repr(integrator))
    return IntegratorReport(name, body, total, *free, *loop)


def _check_steps(steps: Sequence[float], duration: float) -> list[float]:
    array = shaped("steps", finite("steps", steps), ("n>=2",))
    ladder: list[float] = array.tolist()
    if ladder[-1] <= 0 or any(finer >= coarser for coarser, finer in pairwise(ladder)):
        raise InvalidArgument(f"steps are {ladder} s, expected steps > 0, the largest first")
    count_steps("duration", duration, ladder[0])
    for h in ladder:
        count_steps("steps[0]", ladder[0], h)
    return ladder


def _format_row(row: Convergence) -> str:
    name = f"  {row.name}" + (f" [{row.unit}]" if row.unit else "")
    return f"{name:42}" + "".join(f"{error:14.1e}" for error in row.errors) + f"   {row}"
