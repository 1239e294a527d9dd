"""Exercise 6: models that are wrong.

Prepare with notebook 6. You predict with pencil and paper what a wrong model costs, for one robot and for an
ensemble, find where it becomes unstable, and choose a controller for robots of unknown mass. On a circle of
radius r at the rate w, the robot needs the acceleration r w^2. The controller model has the mass m_hat. PD
has the gains m_hat kp and m_hat kd, and no model.
"""

import numpy as np

from pinmobile.arrays import Array
from pinmobile.exercises._exercise import Exercise, Numbers
from pinmobile.exercises._question import Requirement

EXERCISE = Exercise("06_uncertainty", __doc__, "I_cz r w kp kd m m_hat")


@EXERCISE.function(2, lambda rng: tuple(rng.uniform(15, 60, 2)))
def circle_errors(p: Numbers, m: float, m_hat: float) -> Array:
    """Return the largest errors [m] of (computed torque, PD) on the circle.

    The robot has the mass m, the controller model m_hat.

    ? The error is the force that the model does not supply, over the gain m_hat kp.
    ? Computed torque supplies m_hat r w^2 of m r w^2, and PD supplies nothing of it.

    ! circle_errors(p, m_hat, m) => m and m_hat are exchanged: the gain of the loop is m_hat kp.
    ! circle_errors(p, m, m_hat)[[1, 0]] => The order is (computed torque, PD).
    ! p.r * p.w**2 / p.kp * np.array([m / m_hat - 1, m / m_hat]) => An error is a size: it has no sign.
    ! circle_errors(p, m, m_hat) * p.kp => The gain kp is missing.
    ! circle_errors(p, m, m_hat) / p.w => The acceleration is r w^2; r w is the speed.
    ! p.r * p.w**2 / p.kp * np.array([abs(m / m_hat - 1), 1]) => The gain of PD is m_hat kp; the robot has m.
    ! circle_errors(p, m, m_hat) * m_hat => The mass m_hat must cancel.
    """
    return p.r * p.w**2 / p.kp * np.array([abs(m / m_hat - 1), m / m_hat])


@EXERCISE.number(1, "kg")
def break_even(p: Numbers) -> float:
    """Give the true mass from which on computed torque with m_hat errs less than PD.

    ? Where is |m / m_hat - 1| equal to m / m_hat?

    ! 2 * p.m_hat => The ratio is the other way round: the model is too heavy by a factor of 2 at most.
    ! p.m_hat => There the model is exact; it helps for some lighter robots too.
    """
    return p.m_hat / 2


@EXERCISE.function(2, lambda rng: (rng.uniform(0.05, 0.5),))
def error_quantiles(p: Numbers, delta: float) -> Array:
    """Return the errors [m] that 99 % of the robots stay within, for (computed torque, PD).

    The ratio m / m_hat is uniform between 1 - delta and 1 + delta.

    ? |m / m_hat - 1| is uniform between 0 and delta. Which value do 99 % of the robots stay below?
    ? m / m_hat is uniform over a range of 2 delta; 1 % of that lies above 1 + 0.98 delta.

    ! p.r * p.w**2 / p.kp * np.array([delta, 1 + 0.98 * delta]) =>
      99 % stay below 0.99 delta, not delta.
    ! p.r * p.w**2 / p.kp * np.array([delta, 1 + delta]) =>
      These are the largest errors, of 100 % of the robots.
    ! p.r * p.w**2 / p.kp * np.array([0.99 * delta, 1 + 0.99 * delta]) =>
      The range of PD is 2 delta wide, so 1 % of it is 0.02 delta.
    ! p.r * p.w**2 / p.kp * np.array([0.98 * delta, 1 + 0.98 * delta]) =>
      The error of computed torque has the same size for lighter and heavier robots: its range is delta wide.
    ! p.r * p.w**2 / p.kp * np.array([delta / 2, 1]) => These are the medians.
    ! error_quantiles(p, delta) * p.kp => The gain kp is missing.
    ! error_quantiles(p, delta)[[1, 0]] => The order is (computed torque, PD).
    """
    return p.r * p.w**2 / p.kp * np.array([0.99 * delta, 1 + 0.98 * delta])


@EXERCISE.function(1, lambda rng: (rng.exponential(size=40), rng.uniform(0.2, 2)))
def share_within(p: Numbers, errors: Array, bound: float) -> float:
    """Return the share of the robots of an ensemble whose error is at most the bound, between 0 and 1.

    ? errors <= bound is an array of truth values. What is its mean?

    ! np.sum(errors <= bound) => This is a number of robots; divide it by len(errors).
    ! np.mean(errors > bound) => This is the share of the robots beyond the bound.
    ! np.mean(errors[errors <= bound]) => This is the mean error of the robots within the bound.
    ! np.quantile(errors, min(bound, 1)) => This is a quantile, an error; the share is asked for.
    """
    return float(np.mean(errors <= bound))


@EXERCISE.function(2, lambda rng: (rng.uniform(0, 0.5),))
def eigenvalue(p: Numbers, c: float) -> float:
    """Return the largest eigenvalue of M^-1 M_hat for an unknown offset c of the centre of mass.

    The robot has the mass m, the yaw inertia I_cz and its centre of mass at (c, 0). The model has the same
    mass and yaw inertia, and its centre of mass at the origin.

    ? M_hat = diag(m, m, I_cz). M at psi = 0 couples y and psi by m c, and its last entry is I_cz + m c^2.
    ? The eigenvalues are 1, mu and 1/mu, with mu + 1/mu = 2 + m c^2 / I_cz. Solve for the larger one.

    ! 1 / eigenvalue(p, c) => This is the smallest eigenvalue; the largest one decides.
    ! 1 + p.m * c**2 / p.I_cz => This is the ratio of the inertias; the coupling m c is missing.
    ! 2 + p.m * c**2 / p.I_cz => This is mu + 1/mu; solve it for mu.
    ! eigenvalue(p.but(m=p.m / (1 + p.m * c**2 / p.I_cz)), c) => Steiner's term m c^2 is missing in M.
    ! eigenvalue(p, np.sqrt(c / p.m)) => The offset enters with its square, times m.
    """
    half = 1 + p.m * c**2 / p.I_cz / 2
    return float(half + np.sqrt(half**2 - 1))


@EXERCISE.number(1, "m")
def largest_offset(p: Numbers) -> float:
    """Give the offset c at which the loop becomes unstable, for a force that is held for 0.1 s.

    The limit is mu = 2 / (kd 0.1 s), for kp 0.1 s < 2 kd.

    ? Solve mu + 1/mu = 2 + m c^2 / I_cz for c.

    ! np.sqrt((20 / p.kd - 2) * p.I_cz / p.m) => 1/mu is missing in mu + 1/mu.
    ! np.sqrt((20 / p.kd - 1) * p.I_cz / p.m) => This is from the ratio of the inertias, without the coupling.
    ! (20 / p.kd + p.kd / 20 - 2) * p.I_cz / p.m => This is c^2; take the square root.
    ! np.sqrt((2 / p.kd + p.kd / 2 - 2) * p.I_cz / p.m) => The time step of 0.1 s is missing.
    ! np.sqrt((10 / p.kd + p.kd / 10 - 2) * p.I_cz / p.m) => The limit is 2 / (kd dt), not 1 / (kd dt).
    """
    mu = 20 / p.kd
    return float(np.sqrt((mu + 1 / mu - 2) * p.I_cz / p.m))


@EXERCISE.design(3)
def controller(p: Numbers, mass: float, gain: float) -> list[Requirement]:
    """Choose the mass of the controller model and the gain kp for robots of unknown mass.

    The true mass is uniform between 20 kg and 40 kg. The robots start up to 0.1 m beside a circle of
    radius 3 m with a rate of 0.15 rad/s; kd = 2 sqrt(kp), and the force is held for 0.1 s. Of an ensemble of
    400 robots, 99 % must stay within 4 mm from t = 8 s on. The largest force must stay below 30 N.

    ? By the rule, the error of the lightest and of the heaviest robot is |m / mass - 1| r w^2 / kp.
    ? The largest force is needed at the start: about mass (r w^2 + 0.1 kp).
    ? A model in the middle of the range makes both errors alike; the gain follows from 4 mm.

    ! mass <= 0 or gain <= 0 => Mass and gain must be above 0.
    ! gain > 20 => The gain is far too large: forces grow with it, and the force is held for 0.1 s.
    ! mass < 26 => The model is too light: the heaviest robots get too little force.
    ! mass > 35 => The model is too heavy: it asks for too much force.
    ! gain < 5.5 => The gain is too small for 4 mm.
    ! gain > 8 => The gain is too large: the force at the start is about mass (r w^2 + 0.1 kp).
    """
    from pinmobile.controllers import ComputedTorque
    from pinmobile.loop import Uniform, ensemble
    from pinmobile.paths import Circle
    from pinmobile.robot import MobileRobot
    from pinmobile.trajectories import Tangent

    law = ComputedTorque(MobileRobot(mass, 1.3), gain, 2 * np.sqrt(gain))
    spread = {"mass": Uniform(20, 40), "start.y": Uniform(-0.1, 0.1)}
    circle = Tangent(Circle(radius=3, rate=0.15, duration=20))
    robots = ensemble(MobileRobot(30, 1.3), law, circle, n=400, spread=spread, dt=0.1, after=8)
    force = np.abs(robots.max_input[:, :2]).max() if not robots.diverged.any() else np.inf
    return [
        Requirement("unstable", float(robots.diverged.sum()), 1, "robots"),
        Requirement("error of 99 %", float(1e3 * robots.error_quantile(0.99).distance), 4, "mm"),
        Requirement("force", float(force), 30, "N"),
    ]
