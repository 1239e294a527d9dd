"""Exercise 8: forces from wheels."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace

import numpy as np

import pinmobile as pm
from pinmobile.arrays import Array
from pinmobile.exercises._exercise import Exercise, Numbers, Requirement, uniform

WHEELS = Exercise("08_wheels")


@cache
def _made(**numbers: float) -> pm.WheeledRobot:
    p, wheel = SimpleNamespace(**numbers), {"mass": 0.5, "spin_inertia": numbers["I_w"]}
    table = pm.WheelTable.differential(2 * p.b, p.r_w, supports=[(p.l_s, 0)], **wheel)
    return pm.WheeledRobot(pm.MobileRobot(p.m, p.I_cz, com=(p.x_bc, p.y_bc)), table)


def robot(p: Numbers) -> pm.WheeledRobot:
    """Return the robot of a course, on wheels."""
    return _made(**vars(p))


@WHEELS(2, uniform(0, 0))
def wheel_rates(p: Numbers, v: float, omega: float) -> Array:
    """Return the rates of the (left, right) wheel [rad/s] for the forward speed v and the yaw rate omega.

    ? How fast does the point of the body above each wheel move forward? The left one is at (0, b).
    ? The point of a rolling wheel at the ground is at rest. How fast does the wheel turn?

    ! wheel_rates(p, v, omega)[[1, 0]] =>
      The sides are exchanged: turning to the left, the right wheel is faster.
    ! wheel_rates(p.but(b=2 * p.b), v, omega) => b is half the distance of the wheels, the arm of each.
    ! wheel_rates(p.but(b=p.b / 2), v, omega) => b is half the distance already: its arm is b.
    ! wheel_rates(p, v, omega) * p.r_w**2 => Divide by the radius: a small wheel turns fast.
    ! wheel_rates(p, v, omega) * p.r_w => These are speeds in m/s; the radius is missing.
    ! wheel_rates(p, v, omega) / (2 * np.pi) => These are turns per second, not rad/s.
    """
    return np.asarray(robot(p).wheel_rates([v, 0, omega]))


@WHEELS(1, uniform(0, 0))
def body_twist(p: Numbers, left: float, right: float) -> Array:
    """Return (v, omega) of the body for the rates of the left and the right wheel.

    ? Invert the last question: the mean of the wheels drives, their difference turns.
    ? Add both equations of the last question, then subtract one from the other.

    ! body_twist(p, right, left) => omega has the wrong sign: a faster right wheel turns to the left.
    ! body_twist(p, left, right) * [2, 1] => v is the mean of both wheels, not their sum.
    ! body_twist(p, left, right) * [1, 2] => The distance of the wheels is 2 b, not b.
    ! body_twist(p, left, right) / p.r_w => The radius is missing.
    """
    return np.asarray(robot(p).odometry([left, right]))[[0, 2]]


@WHEELS(2, uniform(0))
def constraint_matrix(p: Numbers, psi: float) -> Array:
    """Return A, a 3x5 matrix, with A dq/dt = 0 for q = (x, y, psi, left, right).

    The rows: the left wheel rolls, the right wheel rolls, the axle does not slide to the side. Each row is
    the velocity of the body at the ground, forward or to the left, less what the wheel rolls.

    ? The forward velocity of the axle's middle is x_dot cos(psi) + y_dot sin(psi).
    ? Turning moves a wheel forward or backward by its arm b; the last columns are what the wheels roll.

    ! constraint_matrix(p, psi) * [1, 1, -1, 1, 1] => The arms of left and right are exchanged.
    ! constraint_matrix(p, -psi) => psi has the wrong sign.
    ! constraint_matrix(p, psi) * [1, 1, 1, -1, -1] => The wheels roll backwards: r_w has the wrong sign.
    ! constraint_matrix(p, psi) / [1, 1, 1, p.r_w, p.r_w] => The radius is missing.
    ! constraint_matrix(p, 0) => psi is missing: x and y are along the axes of {0}.
    ! constraint_matrix(p, psi)[[1, 0, 2]] => The rows of left and right are exchanged.
    ! constraint_matrix(p, psi) * [1, 1, 0, 1, 1] => The arms b are missing: turning moves the wheels too.
    """
    return np.asarray(robot(p).constraint_matrix(np.array([0, 0, psi, 0, 0])))[[0, 2, 1]]


@WHEELS(1, uniform(0, 0, low=-20, high=20))
def wheel_torques(p: Numbers, F: float, M: float) -> Array:
    """Return the torques of the (left, right) wheel that push with the force F and turn with the moment M.

    ? A wheel with the torque tau pushes with tau / r_w, at its arm b.
    ? Write F and M for both torques, and solve for the torques.

    ! wheel_torques(p, F, -M) => The sides are exchanged: the right wheel turns the robot to the left.
    ! wheel_torques(p, 2 * F, M) => F is the sum of both wheels: each has half of it.
    ! wheel_torques(p, F, 2 * M) => Both wheels contribute to M: the divisor is 2 b.
    ! wheel_torques(p, F, M * p.b) => The arm b is missing.
    ! wheel_torques(p, F, M * p.b**2) => Divide M by the arm b.
    ! wheel_torques(p, F, M) / p.r_w => These are forces; the torque is the force times r_w.
    """
    return np.linalg.solve(robot(p).reduced(np.zeros(5), np.zeros(5)).B, [F, M])


@WHEELS(3, uniform(0, 0, 0, 0))
def acceleration(p: Numbers, v: float, omega: float, left: float, right: float) -> Array:
    """Return (dv/dt, domega/dt) for the torques of the left and the right wheel.

    ? Reduce M a + n = B tau + A' lambda by the null space S of A: S' M S, S' (M dS/dt nu + n), S' B.
    ? S takes (v, omega) to the rates of (x, y, psi, left, right). M is that of exercise 1, and I_w twice.
    ? The result does not depend on psi: take psi = 0, after dS/dt.

    ! acceleration(p.but(I_w=0), v, omega, left, right) => The inertia of the wheels is missing.
    ! acceleration(p.but(I_w=p.I_w / 2), v, omega, left, right) => There are two wheels, each with I_w.
    ! acceleration(p, 0, 0, left, right) => The nonlinear effects n_bar are missing.
    ! 2 * acceleration(p, 0, 0, left, right) - acceleration(p, v, omega, left, right) =>
      The nonlinear effects have the wrong sign: a mass ahead of the axle is flung forward.
    ! _without_steiner(p, acceleration(p, v, omega, left, right)) =>
      I_cz is about the centre of mass; about the axle, a term is added (Steiner).
    ! acceleration(p.but(x_bc=0, y_bc=0), v, omega, left, right) => The centre of mass is taken on the axle.
    ! acceleration(p, v, omega, right, left) => The sides are exchanged.
    ! acceleration(p, v, omega, left * p.r_w, right * p.r_w) =>
      The torques are taken for forces: divide them by r_w.
    """
    q, rates = np.zeros(5), [v, 0, omega, *wheel_rates(p, v, omega)]
    return np.asarray(robot(p).forward_dynamics(q, rates, [left, right]))[[0, 2]]


def _without_steiner(p: Numbers, a: Array) -> Array:
    q = np.zeros(5)
    M, steiner = robot(p).reduced(q, q).M, robot(p).mass_matrix(q)[2, 2] - p.I_cz
    return np.asarray(np.linalg.solve(M - np.diag([0, steiner]), M @ a))


@WHEELS(1, unit="N m")
def slip_torque(p: Numbers) -> float:
    """Give the torque that the largest friction of a wheel has about its axle, on level ground, at rest.

    A wheel without inertia of its own starts to slip at this torque of its motor. The centre of mass is x_bc
    ahead of the axle, and the caster l_s; take y_bc = 0 here. The coefficient of friction is mu.

    ? The caster carries a part of the weight. Take moments about it.
    ? Each wheel carries half of what the axle carries. Which force can it transmit at most?

    ! slip_torque(p.but(x_bc=0)) => The caster carries a part of the weight: take moments about it.
    ! slip_torque(p) * p.x_bc / (p.l_s - p.x_bc) => This is with the load of the caster.
    ! slip_torque(p) * 2 => The axle has two wheels; each carries half.
    ! slip_torque(p) / p.r_w => This is the force at the ground; the torque is the force times r_w.
    ! slip_torque(p) / 9.81 => The mass is taken for the weight: g is missing.
    ! slip_torque(p) / p.mu => This is with a coefficient of friction of 1: mu is missing.
    """
    rest = np.zeros((3, 5))
    return float(robot(p.but(y_bc=0)).contact_loads(*rest).values[0] * p.mu * p.r_w)


@WHEELS(2)
def tracking(p: Numbers, zeta: float, k: float) -> list[Requirement]:
    """Choose zeta of UnicycleTracking and k of Backstepping, for a robot that starts 0.1 m beside a circle.

    The circle has a radius of 3 m and a rate of 0.15 rad/s. The distance must be below 2 mm from t = 8 s on,
    and the torque of each wheel below 0.9 N m.

    ? zeta is the damping of the error in the heading; without damping, the robot weaves about the circle.
    ? k is the rate at which the wheels take up the speeds: a large k needs large torques at the start.

    ! zeta <= 0 or k <= 0 => Both must be above 0.
    ! zeta < 0.4 => The damping zeta is too small: the robot weaves about the circle.
    ! zeta > 1.5 => The damping zeta is too large.
    ! k > 1.2 => k is too large: the wheels must take up their speeds at once.
    ! k < 0.8 => k is too small: the wheels take up their speeds too late.
    """
    circle = pm.Tangent(pm.Circle(radius=3, rate=0.15, duration=16))
    law = pm.Backstepping(pm.UnicycleTracking(zeta), robot(p), k)
    q0, v0 = robot(p).start(circle(0))
    run = pm.simulate(robot(p), law, circle, dt=0.05, q0=q0 + np.array([0, 0.1, 0, 0, 0]), v0=v0)
    distance = np.hypot(*run.error[run.t >= 8, :2].T).max()
    return [("distance", float(1e3 * distance), 2, "mm"), ("torque", float(np.abs(run.u).max()), 0.9, "N m")]
