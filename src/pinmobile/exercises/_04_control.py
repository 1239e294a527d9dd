"""Exercise 4: PD and computed torque.

Prepare with notebook 4. You write both controllers of the lecture, predict their errors and their largest
sampling time, and choose gains for requirements. The error is e = q_d - q, with its last entry on the circle.
"""

from typing import Any

import numpy as np
from scipy.linalg import eigh

import pinmobile as pm
from pinmobile.arrays import Array
from pinmobile.controllers import planar_difference
from pinmobile.exercises._01_equations import mass_matrix, nonlinear_effects, robot
from pinmobile.exercises._exercise import Exercise, Numbers, uniform
from pinmobile.exercises._question import Requirement

EXERCISE = Exercise("04_control", __doc__, "m I_cz x_bc y_bc r w kp kd")


@EXERCISE(2, uniform(0, low=0.5, high=9))
def critical(p: Numbers, omega: float) -> Array:
    """Return the gains (kp, kd) with which e_ddot + kd e_dot + kp e = 0 has both poles at -omega.

    ? Compare s^2 + kd s + kp with the polynomial that has both poles.

    ! critical(p, omega) * [1, 0.5] => kd = omega gives a damping ratio of one half: the error overshoots.
    ! critical(p, omega)[::-1] => The gains are exchanged: the order is (kp, kd).
    ! critical(p, omega) / [omega, 1] => kp must be the square of a rate: compare the units.
    ! critical(p, omega) * [1, omega] => kd must grow with omega, not with its square: compare the units.
    ! critical(p, omega) * [1, -1] => kd has the wrong sign: the poles would be at +omega.
    ! critical(p, omega) * [1, 0.7] => This has a damping ratio of 0.7; critical damping has 1.
    """
    return np.asarray(np.poly([-omega, -omega])[:0:-1], float)


def _gains(rng: np.random.Generator) -> tuple[float, float]:
    """Draw kp and kd."""
    return float(rng.uniform(1, 9)), float(rng.uniform(1, 9))


@EXERCISE(2, lambda _, rng: (*_gains(rng), *rng.uniform(-3, 3, (4, 3))))
def pd_force(p: Numbers, kp: float, kd: float, q: Array, v: Array, q_d: Array, v_d: Array) -> Array:
    """Return tau of PD control, three numbers: kp e + kd de/dt.

    ? e = q_d - q, and de/dt = v_d - v. Only the last entry of e needs more than a subtraction.
    ? Headings of 0 and 2 pi are the same: take the last entry of e on the circle, as in exercise 3.

    ! _pd(pm.controllers.plain_difference, kp, kd, q, v, q_d, v_d) =>
      The heading error is a plain difference: beyond half a turn the robot turns the long way round.
    ! -pd_force(p, kp, -kd, q, v, q_d, v_d) => The position error has the wrong sign: e = q_d - q.
    ! pd_force(p, kp, -kd, q, v, q_d, v_d) => The velocity error has the wrong sign: de/dt = v_d - v.
    ! pd_force(p, kp, kd, q, v, q_d, 0 * v) => v_d is missing: this brakes the desired motion too.
    ! pd_force(p, kp, 0, q, v, q_d, v_d) => The derivative term is missing.
    ! pd_force(p, kd, kp, q, v, q_d, v_d) => kp and kd are exchanged.
    """
    return _pd(planar_difference, kp, kd, q, v, q_d, v_d)


def _pd(difference: Any, kp: float, kd: float, q: Array, v: Array, q_d: Array, v_d: Array) -> Array:
    reference = pm.Reference(q_d, v_d, 0 * v_d)
    return pm.PD(kp, kd, difference)(0, q, v, reference, difference)[0]


def _state(p: Numbers, rng: np.random.Generator) -> tuple[Any, ...]:
    """Draw the arguments of computed torque."""
    q, v = rng.uniform(-3, 3, (2, 3))
    M, n = mass_matrix(p, q), nonlinear_effects(p, q, v)
    return M, n, _gains(rng), q, v, rng.uniform(-3, 3, (3, 3))


@EXERCISE(3, _state)
def computed_torque(
    p: Numbers, M: Array, n: Array, gains: tuple[float, float], q: Array, v: Array, reference: Array
) -> Array:
    """Return tau of computed torque, three numbers.

    The model has the mass matrix M and the nonlinear effects n at q and v. The gains are (kp, kd), and the
    reference has the rows q_d, v_d, a_d.

    ? The robot must accelerate by a_d + kd de/dt + kp e. Which tau does that take?
    ? Inverse dynamics gives it. The heading error is on the circle.

    ! computed_torque(p, M, n, gains, q, v, reference) - n => The nonlinear effects n are missing.
    ! computed_torque(p, M, n, gains, q, v, reference) - 2 * n => n has the wrong sign: tau must supply it.
    ! computed_torque(p, M, n, gains, q, v, reference)
      - (M - np.eye(3)) @ _wanted(p, M, n, gains, q, v, reference * [[1], [1], [0]]) =>
      M must multiply the feedback too.
    ! computed_torque(p, M, n, gains, q, v, reference * [[1], [1], [0]]) =>
      The desired acceleration a_d is missing.
    ! _computed(pm.controllers.plain_difference, p, gains, q, v, reference) =>
      The heading error is a plain difference.
    ! computed_torque(p, M, n, (-gains[0], -gains[1]), q, v, reference) => The errors have the wrong sign.
    ! np.linalg.solve(M, _wanted(p, M, n, gains, q, v, reference) - n) => M is inverted; it multiplies.
    ! computed_torque(p, M, n, gains, q, v, reference)
      - (M - np.diag(np.diag(M))) @ _wanted(p, M, n, gains, q, v, reference) => Use M @, not *: M is a matrix.
    """
    return _computed(planar_difference, p, gains, q, v, reference)


def _computed(
    difference: Any, p: Numbers, gains: tuple[float, float], q: Array, v: Array, reference: Array
) -> Array:
    return pm.ComputedTorque(robot(p), *gains, difference)(0, q, v, pm.Reference(*reference), None)[0]


def _wanted(p: Numbers, M: Array, n: Array, *given: Any) -> Array:
    """Return the acceleration that computed torque asks for."""
    return np.asarray(np.linalg.solve(M, computed_torque(p, M, n, *given) - n), float)


@EXERCISE(1, unit="m")
def circle_error(p: Numbers) -> float:
    """Give the error of PD on a circle of radius r at the rate w.

    The gains are kp m and kd m, and the centre of mass is at the origin: x_bc = y_bc = 0.

    ? PD makes a force of an error only. How large is the acceleration on the circle?
    ? Equate the force of kp with the force that the circle needs; the part of kd is small.

    ! circle_error(p) / p.w => This is with the speed in place of the acceleration.
    ! circle_error(p) / p.m => The gain is kp m, and the force contains the mass too.
    ! circle_error(p) * p.m => The gain is kp m, not kp: the mass cancels.
    ! circle_error(p) * p.kp => This is the acceleration; the gain turns it into an error.
    ! circle_error(p) * p.kp / p.kd => The position error is multiplied by kp, not by kd.
    """
    body, zero = p.but(x_bc=0, y_bc=0), np.zeros(3)
    needed = robot(body).inverse_dynamics(*pm.FixedHeading(pm.Circle(p.r, p.w, duration=1), 0)(0))
    force = pd_force(p, p.kp * p.m, 0, zero, zero, np.array([1.0, 0, 0]), zero)
    return float(np.linalg.norm(needed) / np.linalg.norm(force))


@EXERCISE(1, unit="s")
def largest_step(p: Numbers) -> float:
    """Give the largest time step dt of PD with the matrix Kd = kd diag(m, m, I_cz), at psi = 0.

    The centre of mass is at (x_bc, y_bc). A force that is held for dt amplifies the error if k dt > 2, where
    k is the largest eigenvalue of M^-1 Kd.

    ? M is your mass matrix of exercise 1 at q = 0. np.linalg.eigvals gives the eigenvalues.
    ? np.linalg.solve(M, Kd) is M^-1 Kd. Which direction is the fastest?

    ! 2 / _rates(p)[0] => This is with the smallest eigenvalue; the fastest direction limits dt.
    ! 1 / _rates(p)[2] => The limit is k dt = 2, not 1.
    ! largest_step(p.but(x_bc=0, y_bc=0)) => This holds for a centre of mass at the origin, where k = kd.
    ! _rates(p)[2] => This is the eigenvalue k; dt = 2 / k.
    """
    return float(2 / _rates(p)[2])


def _rates(p: Numbers) -> Array:
    """Return the eigenvalues of M^-1 Kd, the smallest first."""
    Kd = p.kd * mass_matrix(p.but(x_bc=0, y_bc=0), np.zeros(3))
    return np.asarray(eigh(Kd, mass_matrix(p, np.zeros(3)), eigvals_only=True))


@EXERCISE(3)
def gains(p: Numbers, gain_p: float, gain_d: float) -> list[Requirement]:
    """Choose the gains gain_p, gain_d of computed torque for a robot 0.5 m before its goal.

    The model is right. The loop runs at 20 Hz. The error must settle to 5 mm within 2.8 s, and overshoot by
    less than 5 mm. The force must stay below 3.6 m/s^2 times m.

    ? With critical damping one number is left, omega. For which omega is the error 5 mm at 2.8 s?
    ? The largest force is the first one. Which gain_p makes it 3.6 m/s^2 times m?

    ! gain_p <= 0 or gain_d <= 0 => Both gains must be above 0.
    ! gain_p > 7.3 => gain_p is too large: look at the first force.
    ! gain_d**2 < 2.5 * gain_p => The damping gain_d / (2 sqrt(gain_p)) is far below 1: the robot overshoots.
    ! gain_d**2 > 5 * gain_p => The damping gain_d / (2 sqrt(gain_p)) is far above 1: the robot creeps.
    ! gain_p < 5.5 => gain_p is too small: omega = sqrt(gain_p) is too slow.
    """
    goal = pm.FixedHeading(pm.Hold((0.5, 0.0), duration=6), 0)
    law = pm.ComputedTorque(robot(p), gain_p, gain_d)
    run = pm.simulate(robot(p), law, goal, dt=0.05, q0=np.zeros(3), v0=np.zeros(3))
    error = 0.5 - run.q[:, 0]
    late = run.t[np.abs(error) > 5e-3].max()
    return [
        ("settling time", float(late) + 0.05, 2.8, "s"),
        ("overshoot", float(-1e3 * error.min()), 5, "mm"),
        ("force", float(np.abs(run.u[:, 0]).max()), 3.6 * p.m, "N"),
    ]
