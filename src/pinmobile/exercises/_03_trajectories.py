"""Exercise 3: trajectories and headings.

Prepare with notebook 3. A reference states position, velocity and acceleration at every time. You write the
pieces of one, and avoid the traps of the notebook: factors that get lost, headings at rest, and angles that
jump by a whole turn.
"""

import numpy as np

from pinmobile.arrays import Array
from pinmobile.exercises._exercise import Exercise, Numbers, uniform
from pinmobile.exercises._question import Requirement

EXERCISE = Exercise("03_trajectories", __doc__, "r w L T")


@EXERCISE.function(2, lambda rng: (rng.uniform(0.2, 2.8), 3 + rng.uniform(), *rng.uniform(-3, 3, 2)))
def cubic(p: Numbers, t: float, T: float, start: float, end: float) -> Array:
    """Return (position, velocity) at time t of a cubic that takes the time T from start to end.

    It is at rest at both ends.

    ? With s = t / T, the position is start + (end - start) (3 s^2 - 2 s^3).
    ? The velocity is the derivative with t, not with s: there is a factor 1 / T.

    ! cubic(p, t, T, start, end) * [1, T] => A factor 1 / T is missing in the velocity, the derivative with t.
    ! np.array([cubic(p, t, T, start, end)[0], (end - start) * (3 * t / T**2 - 2 * t**2 / T**3)]) =>
      The factors 2 and 3 are missing in the velocity: the derivative of s^3 is 3 s^2.
    ! np.array([start + (end - start) * t / T, (end - start) / T]) => This is a line: it does not rest.
    ! cubic(p, t, T, 0, end - start) => The start is missing in the position.
    ! cubic(p, t, T, end, start) => Start and end are exchanged.
    ! cubic(p, t, T, start, start + end) => The cubic must cover end - start, not end.
    """
    s, way = t / T, end - start
    return np.array([start + way * (3 * s**2 - 2 * s**3), way * 6 * (s - s**2) / T])


@EXERCISE.function(1, uniform(0, 0))
def heading_error(p: Numbers, psi: float, psi_d: float) -> float:
    """Return the heading error psi_d - psi on the circle, between -pi and pi.

    ? Headings of 0 and 2 pi are the same; their error must be 0.
    ? atan2(sin(e), cos(e)) is e on the circle.

    ! psi_d - psi => This is a plain difference: it jumps by a whole turn. Take the error on the circle.
    ! (psi_d - psi) % (2 * np.pi) => This lies between 0 and 2 pi: the robot would always turn to the left.
    ! np.sin(psi_d - psi) => The sine is near the error for small errors only; it is 0 at half a turn.
    ! np.abs(heading_error(p, psi, psi_d)) => The sign is missing: it states the direction to turn.
    """
    return float(np.arctan2(np.sin(psi_d - psi), np.cos(psi_d - psi)))


@EXERCISE.function(2, uniform(2, 2))
def heading_rate(p: Numbers, v: Array, a: Array) -> float:
    """Return the rate of the heading along a path with velocity (v_x, v_y) and acceleration (a_x, a_y).

    ? Differentiate psi = atan2(v_y, v_x) with respect to time.
    ? The derivative of atan2(y, x) is (x dy - y dx) / (x^2 + y^2).

    ! heading_rate(p, v, a) * np.hypot(*v) => It is divided by the speed; it must be divided by its square.
    ! heading_rate(p, v, a) * (v @ v) => The division by the square of the speed is missing.
    ! (v @ a) / (v @ v) => This is the change of the speed; take v_x a_y - v_y a_x.
    ! v[0] * a[1] / (v @ v) => The second term, v_y a_x, is missing.
    ! (v[0] * a[1] + v[1] * a[0]) / (v @ v) => The second term has the wrong sign.
    ! np.arctan2(a[1], a[0]) => This is the direction of the acceleration.
    """
    return float((v[0] * a[1] - v[1] * a[0]) / (v @ v))


@EXERCISE.function(2, uniform(2))
def heading_at_stop(p: Numbers, a: Array) -> Array:
    """Return the heading just before the robot comes to rest, as (cos psi, sin psi), for its acceleration a.

    At rest the velocity is zero, and atan2(0, 0) is no direction.

    ? Just before the stop, the velocity is minus the acceleration times the time that is left.
    ? Normalise -a.

    ! heading_at_stop(p, -a) => This is the heading just after a start; before a stop the robot brakes.
    ! np.array([1.0, 0.0]) => This is what atan2(0, 0) gives: a heading of 0, whatever the path.
    ! heading_at_stop(p, a[[1, 0]]) => cos and sin are exchanged: atan2 takes y first.
    ! -a => The direction is right; divide it by its length.
    ! a => The robot brakes, and the vector must have length 1.
    """
    return -a / float(np.hypot(*a))


@EXERCISE.function(2, lambda rng: (rng.uniform(0, 60),))
def circle(p: Numbers, t: float) -> Array:
    """Return the reference on the lecture's circle, a 3x3 matrix with the rows q, v and a.

    The path is x = r sin(w t), y = r - r cos(w t); psi is the heading along it, unwrapped.

    ? The heading along this circle is psi = w t.
    ? Each derivative of sin(w t) brings a factor w.

    ! circle(p, t)[:, [1, 0, 2]] => x and y are exchanged.
    ! circle(p, t) * [[1, 1, 1], [1 / p.w, 1 / p.w, 1], [1 / p.w**2, 1 / p.w**2, 1]] =>
      The factors w and w^2 of the derivatives are missing.
    ! circle(p, t) * [[1], [1], [-1]] => The acceleration points away from the centre.
    ! circle(p, t) * [1, 1, 0] => The heading is missing: psi = w t, psi_dot = w.
    ! circle(p, t) - [[0, p.r, 0], [0, 0, 0], [0, 0, 0]] =>
      This circle is about the origin: y = r - r cos(w t).
    ! np.vstack([[*circle(p, t)[0, :2], p.w * t % (2 * np.pi)], circle(p, t)[1:]]) =>
      The heading is wrapped: it must go on past 2 pi.
    """
    c, s = np.cos(p.w * t), np.sin(p.w * t)
    return p.r * np.array(
        [[s, 1 - c, p.w * t / p.r], [p.w * c, p.w * s, p.w / p.r], [-(p.w**2) * s, p.w**2 * c, 0]]
    )


@EXERCISE.number(1, "m/s")
def peak_speed(p: Numbers) -> float:
    """Give the largest speed of a cubic of length L that takes the time T, from rest to rest.

    ? It is reached half way, at t = T / 2.
    ? Evaluate the derivative of L (3 s^2 - 2 s^3) at s = 1/2.

    ! p.L / p.T => This is the mean speed.
    ! 1.875 * p.L / p.T => This is the largest speed of a polynomial of degree five.
    ! 1.5 * p.L => The time T is missing.
    ! 6 * p.L / p.T**2 => This is the largest acceleration.
    """
    return 1.5 * p.L / p.T


@EXERCISE.design(2)
def duration(p: Numbers, T_m: float) -> list[Requirement]:
    """Choose the duration T_m of the same path for a robot of 30 kg, from rest to rest along a cubic.

    The force must stay below 40 N. The mean speed must be above 0.3 m/s: the
    duration below L / 0.3 m/s.

    ? The largest force is needed at the start and at the end. How large is the acceleration there?
    ? 30 kg times 6 L / T_m^2 must be below 40 N.

    ! T_m <= 0 => A duration is above 0.
    ! 30 * 6 * p.L / T_m**2 >= 40 => It is too short: the acceleration at both ends is 6 L / T_m^2.
    ! p.L / T_m <= 0.3 => It is too long for the mean speed L / T_m.
    """
    from pinmobile.controllers import ComputedTorque
    from pinmobile.loop import simulate
    from pinmobile.paths import CubicVia
    from pinmobile.robot import MobileRobot
    from pinmobile.trajectories import FixedHeading

    robot, middle = MobileRobot(30, 1.3), 1.5 * p.L / T_m
    path = CubicVia((0, 0), (p.L / 2, 0), (p.L, 0), t_via=T_m / 2, t_end=T_m, via_velocity=(middle, 0))
    run = simulate(robot, ComputedTorque(robot), FixedHeading(path, 0), dt=T_m / 200)
    force = float(np.abs(run.u[:, 0]).max())
    return [Requirement("force", force, 40, "N"), Requirement("duration", T_m, p.L / 0.3, "s")]
