"""Exercise 6: models that are wrong.

Prepare with notebook 6. You predict with pencil and paper what a wrong model costs, for one robot and for an
ensemble, find where it becomes unstable, and choose a controller for robots of unknown mass. On a circle of
radius r at the rate w, the robot needs the acceleration r w^2. The controller model has the mass m_hat. PD
has the gains m_hat kp and m_hat kd, and no model.
"""

from functools import cache
from typing import Any

import numpy as np
from scipy.linalg import eigvals
from scipy.optimize import brentq

import pinmobile as pm
from pinmobile import closed_form
from pinmobile.arrays import Array
from pinmobile.controllers import planar_difference
from pinmobile.exercises._exercise import Exercise, Numbers
from pinmobile.exercises._question import Requirement

EXERCISE = Exercise("06_uncertainty", __doc__, "I_cz r w kp kd m m_hat")


@EXERCISE(2, lambda _, rng: tuple(rng.uniform(15, 60, 2)))
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


@EXERCISE(1, unit="kg")
def break_even(p: Numbers) -> float:
    """Give the true mass from which on computed torque with m_hat errs less than PD.

    ? Both errors of the first question are equal there.

    ! 4 * break_even(p) => The ratio is the other way round: the model is too heavy by a factor of 2 at most.
    ! p.m_hat => There the model is exact; it helps for some lighter robots too.
    """
    return float(brentq(lambda m: np.subtract(*circle_errors(p, m, p.m_hat)), 0.01 * p.m_hat, p.m_hat))


@EXERCISE(2, lambda _, rng: (rng.uniform(0.05, 0.5),))
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


@EXERCISE(1, lambda _, rng: (rng.exponential(size=40), rng.uniform(0.2, 2)))
def share_within(p: Numbers, errors: Array, bound: float) -> float:
    """Return the share of the robots of an ensemble whose error is at most the bound, between 0 and 1.

    ? A comparison of an array with a number is an array of truth values. How many of them are true?

    ! share_within(p, errors, bound) * len(errors) => This is a number of robots; divide it by len(errors).
    ! 1 - share_within(p, errors, bound) => This is the share of the robots beyond the bound.
    ! np.mean(errors[errors <= bound]) => This is the mean error of the robots within the bound.
    ! np.quantile(errors, min(bound, 1)) => This is a quantile, an error; the share is asked for.
    """
    return float(np.searchsorted(np.sort(errors), bound, side="right") / len(errors))


@EXERCISE(2, lambda _, rng: (rng.uniform(0, 0.5),))
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


@EXERCISE(1, unit="m")
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


@EXERCISE(3)
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
