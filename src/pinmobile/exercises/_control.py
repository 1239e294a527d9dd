"""Exercises 3, 4 and 6: trajectories, controllers, and models that are wrong."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from scipy.linalg import eigh, eigvals
from scipy.optimize import brentq

import pinmobile as pm
from pinmobile import closed_form
from pinmobile.arrays import Array
from pinmobile.controllers import planar_difference
from pinmobile.exercises._equations import mass_matrix, nonlinear_effects, robot
from pinmobile.exercises._exercise import Exercise, Numbers, Requirement, uniform

TRAJECTORIES = Exercise("03_trajectories")


@TRAJECTORIES(2, lambda _, rng: (rng.uniform(0.2, 2.8), 3 + rng.uniform(), *rng.uniform(-3, 3, 2)))
def cubic(p: Numbers, t: float, T: float, start: float, end: float) -> Array:
    """Return (position, velocity) at time t of a cubic that takes the time T from start to end.

    It is at rest at both ends.

    ? Write start + (end - start) h(s) with s = t / T. Which cubic h goes from 0 to 1, flat at both ends?
    ? The velocity is the derivative with t, not with s: there is a factor 1 / T.

    ! cubic(p, t, T, start, end) * [1, T] => A factor 1 / T is missing in the velocity, the derivative with t.
    ! np.array([cubic(p, t, T, start, end)[0], (cubic(p, t, T, start, end)[0] - start) / t]) =>
      The factors 2 and 3 are missing in the velocity: the derivative of s^3 is 3 s^2.
    ! np.array([start + (end - start) * t / T, (end - start) / T]) => This is a line: it does not rest.
    ! cubic(p, t, T, 0, end - start) => The start is missing in the position.
    ! cubic(p, t, T, end, start) => Start and end are exchanged.
    ! cubic(p, t, T, start, start + end) => The cubic must cover end - start, not end.
    """
    return np.array([_line(T, start, end).derivative(t, k)[0] for k in (0, 1)])


@cache
def _line(T: float, start: float, end: float) -> pm.Spline:
    return pm.Spline([[start], [end]], [0, T])


@TRAJECTORIES(1, uniform(0, 0))
def heading_error(p: Numbers, psi: float, psi_d: float) -> float:
    """Return the heading error psi_d - psi on the circle, between -pi and pi.

    ? Headings of 0 and 2 pi are the same; their error must be 0.
    ? Whole turns change neither sin(e) nor cos(e). Which function returns the angle from both?

    ! psi_d - psi => This is a plain difference: it jumps by a whole turn. Take the error on the circle.
    ! (psi_d - psi) % (2 * np.pi) => This lies between 0 and 2 pi: the robot would always turn to the left.
    ! np.sin(psi_d - psi) => The sine is near the error for small errors only; it is 0 at half a turn.
    ! np.abs(heading_error(p, psi, psi_d)) => The sign is missing: it states the direction to turn.
    """
    return float(planar_difference(np.array([0, 0, psi]), np.array([0, 0, psi_d]))[2])


@TRAJECTORIES(2, uniform(2, 2))
def heading_rate(p: Numbers, v: Array, a: Array) -> float:
    """Return the rate of the heading along a path with velocity (v_x, v_y) and acceleration (a_x, a_y).

    ? Differentiate psi = atan2(v_y, v_x) with respect to time.
    ? The derivative of atan(z) is 1 / (1 + z^2), here with z = v_y / v_x.

    ! heading_rate(p, v, a) * np.hypot(*v) => It is divided by the speed; it must be divided by its square.
    ! heading_rate(p, v, a) * (v @ v) => The division by the square of the speed is missing.
    ! (v @ a) / (v @ v) => This is the relative change of the speed.
    ! heading_rate(p, v, a * [0, 1]) => The second term, v_y a_x, is missing.
    ! heading_rate(p, v, a * [-1, 1]) => The second term has the wrong sign.
    ! np.arctan2(a[1], a[0]) => This is the direction of the acceleration.
    """
    early, late = (complex(*(v + step * a)) for step in (-1e-5, 1e-5))
    return float(np.angle(late / early) / 2e-5)


@TRAJECTORIES(2, uniform(2))
def heading_at_stop(p: Numbers, a: Array) -> Array:
    """Return the heading just before the robot comes to rest, as (cos psi, sin psi), for its acceleration a.

    At rest the velocity is zero, and atan2(0, 0) is no direction.

    ? Just before the stop, the velocity is minus the acceleration times the time that is left.
    ? cos psi and sin psi are the entries of a vector of length 1.

    ! heading_at_stop(p, -a) => This is the heading just after a start; before a stop the robot brakes.
    ! np.array([1.0, 0.0]) => This is what atan2(0, 0) gives: a heading of 0, whatever the path.
    ! heading_at_stop(p, a[[1, 0]]) => cos and sin are exchanged: atan2 takes y first.
    ! heading_at_stop(p, a) * np.hypot(*a) => The direction is right; divide it by its length.
    ! heading_at_stop(p, -a) * np.hypot(*a) => The robot brakes, and the vector must have length 1.
    """
    late = pm.Spline([a, 0 * a], [0, 1]).derivative(0.99, 1)  # it brakes along a
    return late / float(np.hypot(*late))


@TRAJECTORIES(2, lambda _, rng: (rng.uniform(0, 60),))
def circle(p: Numbers, t: float) -> Array:
    """Return the reference on the lecture's circle, a 3x3 matrix with the rows q, v and a.

    The path is x = r sin(w t), y = r - r cos(w t); psi is the heading along it, unwrapped.

    ? The heading is the direction of the velocity. At which rate does it turn?
    ? Each derivative of sin(w t) brings a factor w.

    ! circle(p, t)[:, [1, 0, 2]] => x and y are exchanged.
    ! circle(p, t) * [[1, 1, 1], [1 / p.w, 1 / p.w, 1], [1 / p.w**2, 1 / p.w**2, 1]] =>
      The factors w and w^2 of the derivatives are missing.
    ! circle(p, t) * [[1], [1], [-1]] => The acceleration points away from the centre.
    ! circle(p, t) * [1, 1, 0] => The heading is missing: the robot turns with the path.
    ! circle(p, t) - [[0, p.r, 0], [0, 0, 0], [0, 0, 0]] =>
      This circle is about the origin: y = r - r cos(w t).
    ! np.vstack([[*circle(p, t)[0, :2], p.w * t % (2 * np.pi)], circle(p, t)[1:]]) =>
      The heading is wrapped: it must go on past 2 pi.
    """
    return np.array(_circle(p.r, p.w)(t))


@cache
def _circle(radius: float, rate: float) -> pm.Tangent:
    return pm.Tangent(pm.Circle(radius=radius, rate=rate, duration=60))


@TRAJECTORIES(1, unit="m/s")
def peak_speed(p: Numbers) -> float:
    """Give the largest speed of a cubic of length L that takes the time T, from rest to rest.

    ? It is reached half way, at t = T / 2.
    ? Evaluate the velocity of your cubic there.

    ! p.L / p.T => This is the mean speed.
    ! 1.875 * p.L / p.T => This is the largest speed of a polynomial of degree five.
    ! peak_speed(p) * p.T => The time T is missing.
    ! peak_speed(p) * 4 / p.T => This is the largest acceleration.
    """
    return float(_line(p.T, 0, p.L).derivative(np.linspace(0, p.T, 201), 1).max())


@TRAJECTORIES(2)
def duration(p: Numbers, T_m: float) -> list[Requirement]:
    """Choose the duration T_m of the same path for a robot of 30 kg, from rest to rest along a cubic.

    The force must stay below 40 N. The mean speed must be above 0.3 m/s: the
    duration below L / 0.3 m/s.

    ? The largest force is needed at the start and at the end. How large is the acceleration there?
    ? The second derivative of your cubic at t = 0 falls with the square of T_m.

    ! T_m <= 0 => A duration is above 0.
    ! p.L / T_m <= 0.3 => It is too long for the mean speed L / T_m.
    ! T_m > 0 => It is too short: how large is the acceleration at both ends?
    """
    robot, path = pm.MobileRobot(30, 1.3), pm.Spline([(0, 0), (p.L, 0)], [0, T_m])
    run = pm.simulate(robot, pm.ComputedTorque(robot), pm.FixedHeading(path, 0), dt=T_m / 200)
    force = float(np.abs(run.u[:, 0]).max())
    return [("force", force, 40, "N"), ("duration", T_m, p.L / 0.3, "s")]


CONTROL = Exercise("04_control")


@CONTROL(2, uniform(0, low=0.5, high=9))
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


@CONTROL(2, lambda _, rng: (*_gains(rng), *rng.uniform(-3, 3, (4, 3))))
def pd_force(p: Numbers, kp: float, kd: float, q: Array, v: Array, q_d: Array, v_d: Array) -> Array:
    """Return tau of PD control, three numbers: kp e + kd de/dt.

    ? e = q_d - q, and de/dt = v_d - v. Only the last entry of e needs more than a subtraction.
    ? Headings of 0 and 2 pi are the same: take the last entry of e on the circle, as in exercise 3.

    ! _pd(pm.controllers.plain_difference, kp, kd, q, v, q_d, v_d) =>
      The heading error is a plain difference: beyond half a turn the robot turns the long way round.
    ! pd_force(p, 0, kd, q, v, q_d, v_d) - pd_force(p, kp, 0, q, v, q_d, v_d) =>
      The position error has the wrong sign: e = q_d - q.
    ! pd_force(p, kp, 0, q, v, q_d, v_d) - pd_force(p, 0, kd, q, v, q_d, v_d) =>
      The velocity error has the wrong sign: de/dt = v_d - v.
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


@CONTROL(3, _state)
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
    ! 2 * computed_torque(p, M, n, (0, 0), q, v, reference)
      - computed_torque(p, M, n, gains, q, v, reference) => The errors have the wrong sign.
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


@CONTROL(1, unit="m")
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


@CONTROL(1, unit="s")
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


@CONTROL(3)
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
        ("overshoot", max(0.0, float(-1e3 * error.min())), 5, "mm"),
        ("force", float(np.abs(run.u[:, 0]).max()), 3.6 * p.m, "N"),
    ]


UNCERTAINTY = Exercise("06_uncertainty")


@UNCERTAINTY(2, lambda _, rng: tuple(rng.uniform(15, 60, 2)))
def circle_errors(p: Numbers, m: float, m_hat: float) -> Array:
    """Return the largest errors [m] of (computed torque, PD) on the circle.

    The robot has the mass m, the controller model m_hat.

    ? The error is the force that the model does not supply, over the gain m_hat kp.
    ? Which part of the force does computed torque supply without an error, and which part PD?

    ! circle_errors(p, m_hat, m) => m and m_hat are exchanged: the gain of the loop is m_hat kp.
    ! circle_errors(p, m, m_hat)[[1, 0]] => The order is (computed torque, PD).
    ! _errors(p, m, m_hat) => An error is a size: it has no sign.
    ! circle_errors(p, m, m_hat) * p.kp => The gain kp is missing.
    ! circle_errors(p, m, m_hat) / p.w => The acceleration is r w^2; r w is the speed.
    ! circle_errors(p, m, m_hat) * [1, m_hat / m] => The gain of PD is m_hat kp; the robot has m.
    ! circle_errors(p, m, m_hat) * m_hat => The mass m_hat must cancel.
    """
    return np.abs(_errors(p, m, m_hat))


def _errors(p: Numbers, m: float, m_hat: float) -> Array:
    """Return the errors to the side for which the laws supply the force that the circle needs."""
    (q, v, a), kp = pm.FixedHeading(pm.Circle(p.r, p.w, duration=1), 0)(0), m_hat * p.kp
    needed = closed_form.inverse_dynamics(q, v, a, mass=m, yaw_inertia=1)[1]
    laws = pm.ComputedTorque(_model(m_hat), p.kp, 0), pm.PD(kp, 0, planar_difference)
    return np.array([_solved(law, pm.Reference(q, v, a), needed) for law in laws])


_model = cache(lambda mass: pm.MobileRobot(mass, 1))


def _solved(law: Any, reference: Any, force: float) -> float:
    """Return the error to the side for which a law has a force to the side."""
    errors = ([0.0, 0, 0], [0.0, 1, 0])
    one, other = (law(0, reference.q - e, reference.v, reference, planar_difference)[0][1] for e in errors)
    return float((force - one) / (other - one))


@UNCERTAINTY(1, unit="kg")
def break_even(p: Numbers) -> float:
    """Give the true mass from which on computed torque with m_hat errs less than PD.

    ? Both errors of the first question are equal there.

    ! 4 * break_even(p) => The ratio is the other way round: the model is too heavy by a factor of 2 at most.
    ! p.m_hat => There the model is exact; it helps for some lighter robots too.
    """
    return float(brentq(lambda m: np.subtract(*circle_errors(p, m, p.m_hat)), 0.01 * p.m_hat, p.m_hat))


@UNCERTAINTY(2, lambda _, rng: (rng.uniform(0.05, 0.5),))
def error_quantiles(p: Numbers, delta: float) -> Array:
    """Return the errors [m] that 99 % of the robots stay within, for (computed torque, PD).

    The ratio m / m_hat is uniform between 1 - delta and 1 + delta.

    ? |m / m_hat - 1| is uniform between 0 and delta. Which value do 99 % of the robots stay below?
    ? m / m_hat is uniform over a range of 2 delta. Which value does 1 % of that range lie above?

    ! _two(p, delta, _quantile(-delta, delta)) => 99 % stay below a part of delta, not below delta.
    ! _two(p, delta, delta) => These are the largest errors, of 100 % of the robots.
    ! _two(p, _quantile(0, delta), _quantile(0, delta)) => The range of PD is 2 delta wide.
    ! _two(p, _quantile(-delta, delta), _quantile(-delta, delta)) =>
      The error of computed torque has the same size for lighter and heavier robots: its range is delta wide.
    ! _two(p, delta / 2, 0) => These are the medians.
    ! error_quantiles(p, delta) * p.kp => The gain kp is missing.
    ! error_quantiles(p, delta)[[1, 0]] => The order is (computed torque, PD).
    """
    return _two(p, _quantile(0, delta), _quantile(-delta, delta))


def _quantile(low: float, high: float) -> float:
    return float(np.quantile([low, high], 0.99))


def _two(p: Numbers, *beyond: float) -> Array:
    """Return the errors of both controllers, each for a true mass beyond m_hat by a part of it."""
    return np.array([circle_errors(p, (1 + x) * p.m_hat, p.m_hat)[k] for k, x in enumerate(beyond)])


@UNCERTAINTY(1, lambda _, rng: (rng.exponential(size=40), rng.uniform(0.2, 2)))
def share_within(p: Numbers, errors: Array, bound: float) -> float:
    """Return the share of the robots of an ensemble whose error is at most the bound, between 0 and 1.

    ? A comparison of an array with a number is an array of truth values. How many of them are true?

    ! share_within(p, errors, bound) * len(errors) => This is a number of robots; divide it by len(errors).
    ! 1 - share_within(p, errors, bound) => This is the share of the robots beyond the bound.
    ! np.mean(errors[errors <= bound]) => This is the mean error of the robots within the bound.
    ! np.quantile(errors, min(bound, 1)) => This is a quantile, an error; the share is asked for.
    """
    return float(np.searchsorted(np.sort(errors), bound, side="right") / len(errors))


@UNCERTAINTY(2, lambda _, rng: (rng.uniform(0, 0.5),))
def eigenvalue(p: Numbers, c: float) -> float:
    """Return the largest eigenvalue of M^-1 M_hat for an unknown offset c of the centre of mass.

    The robot has the mass m, the yaw inertia I_cz and its centre of mass at (c, 0). The model has the same
    mass and yaw inertia, and its centre of mass at the origin.

    ? Both are mass matrices of exercise 1, at any psi. Which one has c?
    ? The eigenvalues are 1, mu and 1/mu. np.linalg.eigvals gives them as numbers.

    ! 1 / eigenvalue(p, c) => This is the smallest eigenvalue; the largest one decides.
    ! _mass(p, c)[2, 2] / p.I_cz => This is the ratio of the inertias; the coupling m c is missing.
    ! eigenvalue(p, c) + 1 / eigenvalue(p, c) => This is mu + 1/mu; solve it for mu.
    ! _largest(np.where(np.diag([0, 0, 1]), p.I_cz, _mass(p, c)), _mass(p, 0)) =>
      Steiner's term m c^2 is missing in M.
    ! eigenvalue(p, np.sqrt(c / p.m)) => The offset enters with its square, times m.
    """
    return _largest(_mass(p, c), _mass(p, 0))


def _largest(M: Array, M_hat: Array) -> float:
    return float(eigvals(M_hat, M).real.max())


def _mass(p: Numbers, c: float) -> Array:
    return closed_form.mass_matrix(np.zeros(3), mass=p.m, yaw_inertia=p.I_cz, com=(c, 0))


@UNCERTAINTY(1, unit="m")
def largest_offset(p: Numbers) -> float:
    """Give the offset c at which the loop becomes unstable, for a force that is held for 0.1 s.

    The limit is mu = 2 / (kd 0.1 s), for kp 0.1 s < 2 kd.

    ? For which c has M^-1 M_hat the eigenvalue mu? Its trace is 1 + mu + 1/mu.

    ! np.sqrt(largest_offset(p) ** 2 - p.kd / 20 * p.I_cz / p.m) => 1/mu is missing in mu + 1/mu.
    ! np.sqrt((20 / p.kd - 1) * p.I_cz / p.m) => This is from the ratio of the inertias, without the coupling.
    ! largest_offset(p) ** 2 => This is c^2; take the square root.
    ! largest_offset(p.but(kd=40 / p.kd)) => The time step of 0.1 s is missing.
    ! largest_offset(p.but(kd=2 * p.kd)) => The limit is 2 / (kd dt), not 1 / (kd dt).
    """
    return float(brentq(lambda c: eigenvalue(p, c) - 2 / (0.1 * p.kd), 0, 9))


@UNCERTAINTY(3)
def controller(p: Numbers, mass: float, gain: float) -> list[Requirement]:
    """Choose the mass of the controller model and the gain kp for robots of unknown mass.

    The true mass is uniform between 20 kg and 40 kg. The robots start up to 0.1 m beside a circle of
    radius 3 m with a rate of 0.15 rad/s; kd = 2 sqrt(kp), and the force is held for 0.1 s. Of an ensemble of
    400 robots, 99 % must stay within 4 mm from t = 8 s on. The largest force must stay below 30 N.

    ? Predict the errors of the lightest and of the heaviest robot with your circle_errors.
    ? The largest force is needed at the start, where the error is 0.1 m.
    ? Which mass makes the errors of both robots alike? The gain follows from 4 mm.

    ! mass <= 0 or gain <= 0 => Mass and gain must be above 0.
    ! gain > 20 => The gain is far too large: forces grow with it, and the force is held for 0.1 s.
    ! mass < 26 => The model is too light: the heaviest robots get too little force.
    ! mass > 35 => The model is too heavy: it asks for too much force.
    ! gain < 5.5 => The gain is too small for 4 mm.
    ! gain > 8 => The gain is too large: look at the force at the start.
    """
    law = pm.ComputedTorque(pm.MobileRobot(mass, 1.3), gain, 2 * np.sqrt(gain))
    spread = {"mass": pm.Uniform(20, 40), "start.y": pm.Uniform(-0.1, 0.1)}
    circle = pm.Tangent(pm.Circle(radius=3, rate=0.15, duration=20))
    robots = pm.ensemble(pm.MobileRobot(30, 1.3), law, circle, n=400, spread=spread, dt=0.1, after=8)
    force = np.abs(robots.max_input[:, :2]).max() if not robots.diverged.any() else np.inf
    return [
        ("unstable", float(robots.diverged.sum()), 1, "robots"),
        ("error of 99 %", float(1e3 * robots.error_quantile(0.99).distance), 4, "mm"),
        ("force", float(force), 30, "N"),
    ]
