"""Exercise 3: trajectories and headings.

Prepare with notebook 3. A reference states position, velocity and acceleration at every time. You write the
pieces of one, and avoid the traps of the notebook: factors that get lost, headings at rest, and angles that
jump by a whole turn.
"""

from __future__ import annotations

from functools import cache

import numpy as np

import pinmobile as pm
from pinmobile.arrays import Array
from pinmobile.controllers import planar_difference
from pinmobile.exercises._exercise import Exercise, Numbers, uniform
from pinmobile.exercises._question import Requirement

EXERCISE = Exercise("03_trajectories", __doc__, "r w L T")


@EXERCISE(2, lambda _, rng: (rng.uniform(0.2, 2.8), 3 + rng.uniform(), *rng.uniform(-3, 3, 2)))
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


@EXERCISE(1, uniform(0, 0))
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


@EXERCISE(2, uniform(2, 2))
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


@EXERCISE(2, uniform(2))
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


@EXERCISE(2, lambda _, rng: (rng.uniform(0, 60),))
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


@EXERCISE(1, unit="m/s")
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


@EXERCISE(2)
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
