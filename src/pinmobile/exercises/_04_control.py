"""Exercise 4: PD and computed torque.

Prepare with notebook 4. You write both controllers of the lecture, predict their errors and their largest
sampling time, and choose gains for requirements. The error is e = q_d - q, with its last entry on the circle.
"""

import numpy as np

from pinmobile.arrays import Array
from pinmobile.exercises._01_equations import mass_matrix
from pinmobile.exercises._exercise import Exercise, Numbers, uniform
from pinmobile.exercises._question import Requirement

EXERCISE = Exercise("04_control", __doc__, "m I_cz x_bc y_bc r w kp kd")


@EXERCISE.function(2, uniform(0, low=0.5, high=9))
def critical(p: Numbers, omega: float) -> Array:
    """Return the gains (kp, kd) with which e_ddot + kd e_dot + kp e = 0 has both poles at -omega.

    ? Compare s^2 + kd s + kp with (s + omega)^2.

    ! np.array([omega**2, omega]) => kd = omega gives a damping ratio of one half: the error overshoots.
    ! np.array([2 * omega, omega**2]) => The gains are exchanged: the order is (kp, kd).
    ! np.array([omega, 2 * omega]) => kp must be the square of omega: compare the units.
    ! np.array([omega**2, 2 * omega**2]) => kd must grow with omega, not with its square: compare the units.
    ! np.array([omega**2, -2 * omega]) => kd has the wrong sign: the poles would be at +omega.
    ! np.array([omega**2, 2 * 0.7 * omega]) => This has a damping ratio of 0.7; critical damping has 1.
    """
    return np.array([omega**2, 2 * omega])


def _error(q: Array, q_d: Array) -> Array:
    """Return the error, with its last entry on the circle."""
    e = q_d - q
    return np.array([e[0], e[1], np.arctan2(np.sin(e[2]), np.cos(e[2]))])


def _gains(rng: np.random.Generator) -> tuple[float, float]:
    """Draw kp and kd."""
    return float(rng.uniform(1, 9)), float(rng.uniform(1, 9))


@EXERCISE.function(2, lambda rng: (*_gains(rng), *rng.uniform(-3, 3, (4, 3))))
def pd_force(p: Numbers, kp: float, kd: float, q: Array, v: Array, q_d: Array, v_d: Array) -> Array:
    """Return tau of PD control, three numbers: kp e + kd de/dt.

    ? e = q_d - q, and de/dt = v_d - v. Only the last entry of e needs more than a subtraction.
    ? Headings of 0 and 2 pi are the same: use atan2(sin(e), cos(e)) for the last entry of e.

    ! kp * (q_d - q) + kd * (v_d - v) =>
      The heading error is a plain difference: beyond half a turn the robot turns the long way round.
    ! -pd_force(p, kp, -kd, q, v, q_d, v_d) => The position error has the wrong sign: e = q_d - q.
    ! pd_force(p, kp, -kd, q, v, q_d, v_d) => The velocity error has the wrong sign: de/dt = v_d - v.
    ! pd_force(p, kp, kd, q, v, q_d, 0 * v) => v_d is missing: this brakes the desired motion too.
    ! pd_force(p, kp, 0, q, v, q_d, v_d) => The derivative term is missing.
    ! pd_force(p, kd, kp, q, v, q_d, v_d) => kp and kd are exchanged.
    """
    return kp * _error(q, q_d) + kd * (v_d - v)


def _model(rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw a mass matrix and nonlinear effects."""
    A = rng.uniform(-1, 1, (3, 3))
    return A @ A.T + np.eye(3), rng.uniform(-2, 2, 3)


@EXERCISE.function(
    3, lambda rng: (*_model(rng), _gains(rng), *rng.uniform(-3, 3, (2, 3)), rng.uniform(-3, 3, (3, 3)))
)
def computed_torque(
    p: Numbers, M: Array, n: Array, gains: tuple[float, float], q: Array, v: Array, reference: Array
) -> Array:
    """Return tau of computed torque, three numbers.

    The model has the mass matrix M and the nonlinear effects n. The gains are (kp, kd), and the reference
    has the rows q_d, v_d, a_d.

    ? The robot must accelerate by a_d + kd de/dt + kp e. Which tau does that take?
    ? tau = M (a_d + kd de/dt + kp e) + n, with the heading error on the circle.

    ! M @ _wanted(gains, q, v, reference) => The nonlinear effects n are missing.
    ! M @ _wanted(gains, q, v, reference) - n => n has the wrong sign: tau must supply it.
    ! M @ reference[2] + _wanted(gains, q, v, reference * [[1], [1], [0]]) + n =>
      M must multiply the feedback too.
    ! M @ _wanted(gains, q, v, reference * [[1], [1], [0]]) + n => The desired acceleration a_d is missing.
    ! M @ (reference[2] + gains[1] * (reference[1] - v) + gains[0] * (reference[0] - q)) + n =>
      The heading error is a plain difference.
    ! M @ (2 * reference[2] - _wanted(gains, q, v, reference)) + n => The errors have the wrong sign.
    ! np.linalg.solve(M, _wanted(gains, q, v, reference) - n) => M is inverted; it multiplies.
    ! np.diag(M) * _wanted(gains, q, v, reference) + n => Use M @, not *: M is a matrix.
    """
    return M @ _wanted(gains, q, v, reference) + n


def _wanted(gains: tuple[float, float], q: Array, v: Array, reference: Array) -> Array:
    """Return the acceleration that computed torque asks for."""
    q_d, v_d, a_d = reference
    wanted: Array = a_d + gains[1] * (v_d - v) + gains[0] * _error(q, q_d)
    return wanted


@EXERCISE.number(1, "m")
def circle_error(p: Numbers) -> float:
    """Give the error of PD on a circle of radius r at the rate w.

    The gains are kp m and kd m, and the centre of mass is at the origin: x_bc = y_bc = 0.

    ? PD makes a force of an error only. How large is the acceleration on the circle?
    ? m kp e = m r w^2; the part of kd is small.

    ! p.r * p.w / p.kp => The acceleration is r w^2; r w is the speed.
    ! p.r * p.w**2 / p.kp / p.m => The gain is kp m; the force is m r w^2, not r w^2.
    ! p.r * p.w**2 * p.m / p.kp => The gain is kp m, not kp: the mass cancels.
    ! p.r * p.w**2 => This is the acceleration; the gain turns it into an error.
    ! p.r * p.w**2 / p.kd => The position error is multiplied by kp, not by kd.
    """
    return p.r * p.w**2 / p.kp


@EXERCISE.number(1, "s")
def largest_step(p: Numbers) -> float:
    """Give the largest time step dt of PD with the matrix Kd = kd diag(m, m, I_cz), at psi = 0.

    The centre of mass is at (x_bc, y_bc). A force that is held for dt amplifies the error if k dt > 2, where
    k is the largest eigenvalue of M^-1 Kd.

    ? M is your mass matrix of exercise 1 at q = 0. np.linalg.eigvals gives the eigenvalues.
    ? dt = 2 / max(np.linalg.eigvals(np.linalg.solve(M, Kd)).real)

    ! 2 / _rates(p)[0] => This is with the smallest eigenvalue; the fastest direction limits dt.
    ! 1 / _rates(p)[2] => The limit is k dt = 2, not 1.
    ! 2 / p.kd => This holds for a centre of mass at the origin, where k = kd.
    ! _rates(p)[2] => This is the eigenvalue k; dt = 2 / k.
    """
    return float(2 / _rates(p)[2])


def _rates(p: Numbers) -> Array:
    """Return the eigenvalues of M^-1 Kd, the smallest first."""
    M = mass_matrix(p, np.zeros(3))
    return np.sort(np.linalg.eigvals(np.linalg.solve(M, p.kd * np.diag([p.m, p.m, p.I_cz]))).real)


@EXERCISE.design(3)
def gains(p: Numbers, gain_p: float, gain_d: float) -> list[Requirement]:
    """Choose the gains gain_p, gain_d of computed torque for a robot 0.5 m before its goal.

    The model is right. The loop runs at 20 Hz. The error must settle to 5 mm within 2.8 s, and overshoot by
    less than 5 mm. The force must stay below 3.6 m/s^2 times m.

    ? With critical damping the error is 0.5 (1 + omega t) exp(-omega t). When is it 5 mm?
    ? The largest force is the first one, m gain_p 0.5. Which omega gives 3.6 m/s^2 times m?
    ? omega near 2.6 rad/s leaves room on both sides.

    ! gain_p <= 0 or gain_d <= 0 => Both gains must be above 0.
    ! gain_p > 7.3 => gain_p is too large: the first force is m gain_p 0.5.
    ! gain_d**2 < 2.5 * gain_p => The damping gain_d / (2 sqrt(gain_p)) is far below 1: the robot overshoots.
    ! gain_d**2 > 5 * gain_p => The damping gain_d / (2 sqrt(gain_p)) is far above 1: the robot creeps.
    ! gain_p < 5.5 => gain_p is too small: omega = sqrt(gain_p) is too slow.
    """
    from pinmobile.controllers import ComputedTorque
    from pinmobile.loop import simulate
    from pinmobile.paths import Hold
    from pinmobile.robot import MobileRobot
    from pinmobile.trajectories import FixedHeading

    robot = MobileRobot(p.m, p.I_cz, com=(p.x_bc, p.y_bc))
    goal = FixedHeading(Hold((0.5, 0.0), duration=6), psi=0)
    run = simulate(
        robot, ComputedTorque(robot, gain_p, gain_d), goal, dt=0.05, q0=np.zeros(3), v0=np.zeros(3)
    )
    error = 0.5 - run.q[:, 0]
    late = run.t[np.abs(error) > 5e-3].max()
    return [
        Requirement("settling time", float(late) + 0.05, 2.8, "s"),
        Requirement("overshoot", float(-1e3 * error.min()), 5, "mm"),
        Requirement("force", float(np.abs(run.u[:, 0]).max()), 3.6 * p.m, "N"),
    ]
