"""Motion of a base and its arms by the independent velocities of the wheels under it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import cos, sin
from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.plant import Coordinate

_BASE = 3
_SPEED_TOLERANCE = 0.02  # [m/s]: below, a car keeps its steering angle
# Gauss-Legendre points of a unit interval, weights of the whole and of the part up to each point: an arc of
# a hundredth of a turn between two control points is integrated to rounding.
_POINTS = (np.polynomial.legendre.leggauss(4)[0] + 1) / 2
_ORDERS = np.arange(1, 5)
_INVERSE = np.linalg.inv(np.vander(_POINTS, increasing=True))
_FULL_WEIGHTS = 1 / _ORDERS @ _INVERSE
_PART_WEIGHTS = _POINTS[:, None] ** _ORDERS / _ORDERS @ _INVERSE
# Uniform cubic B-spline between two knots: the four basis functions by powers of the share of the interval.
_SPLINE = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6
_KNOT = _SPLINE[0, :3]
_VALUES = np.vander(_POINTS, increasing=True) @ _SPLINE
_SLOPES = np.vander(_POINTS, 3, increasing=True) * (1, 2, 3) @ _SPLINE[1:]


def _gauss_values(points: Array, dt: float) -> tuple[Array, Array]:
    """Return slopes and values of a uniform cubic B-spline at the Gauss points of an interval.

    Parameters
    ----------
    points : ndarray, shape (..., 4, m)
        Control points.
    dt : float
        Time between knots [s].
    """
    return np.asarray(_SLOPES @ points) / dt, np.asarray(_VALUES @ points)


def rotate_to_world(psi: Array, x: Array) -> Array:
    """Return vectors of the plane and turns along the inertial axes, shape (..., 3), from the body's axes."""
    c, s = np.cos(psi), np.sin(psi)
    components = c * x[..., 0] - s * x[..., 1], s * x[..., 0] + c * x[..., 1], x[..., 2]
    return np.stack(components, axis=-1)


@dataclass(frozen=True, eq=False)
class Drive:
    """Independent velocities nu of a drive and its arms, and the motion of body and arms that they cause.

    They are those of `wheels.Reduced`: of an omnidirectional drive the body twist (forward, left, yaw rate);
    of one fixed axle the speed along its wheels and the yaw rate; of a car the speed at the fixed axle. The
    rates of the arms follow, and of a car the steering rate. The yaw rate of a car is curvature times speed.

    Parameters
    ----------
    wheeled : WheeledRobot
        Robot on wheels.

    Raises
    ------
    InvalidArgument
        If the wheels are not those of such a drive.
    """

    wheeled: Any

    def __post_init__(self) -> None:
        mobility = self.wheeled.mobility
        kind = mobility.mobility, mobility.steerability
        if not mobility.is_regular or kind not in ((3, 0), (2, 0), (1, 1)) or len(self.wheeled.pivots) > 1:
            raise InvalidArgument(
                f"robot is {mobility.kind}, expected an omnidirectional drive without steering, a drive with "
                "one fixed axle, or a car; for another drive that moves in every direction, robot.robot"
            )

    @cached_property
    def columns(self) -> Array:
        """Body twist per speed and yaw rate, shape (3, 2), or the identity of an omnidirectional drive."""
        if self.wheeled.mobility.mobility == _BASE:
            return np.eye(_BASE)
        a, b, arm = self.wheeled.axle
        return np.array([[b, -a * arm], [-a, -b * arm], [0.0, 1.0]])

    @cached_property
    def is_car(self) -> bool:
        """Whether the drive is a car."""
        return bool(self.wheeled.mobility.steerability)

    @cached_property
    def arms(self) -> slice:
        """Entries of the arms in nu."""
        first = self.columns.shape[1] - self.is_car
        return slice(first, first + self.wheeled.of_body - _BASE)

    @cached_property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Integrals of nu, with names, units and limits."""
        axle = self.columns.shape[1] < _BASE
        base = [("base", "m"), ("psi", "rad")] if axle else [("forward", "m"), ("left", "m"), ("psi", "rad")]
        arms: tuple[Coordinate, ...] = self.wheeled.coordinates[_BASE : self.wheeled.of_body + self.is_car]
        return (*(Coordinate(*each) for each in base[: self.arms.start]), *arms)

    @cached_property
    def velocity_limit(self) -> Array:
        """Limits of the absolute nu, shape (m,); those of the base and the steering are infinite."""
        limits = np.full(len(self.coordinates), np.inf)
        limits[self.arms] = self.wheeled.robot.velocity_limit[_BASE:]
        return limits

    def origin(self, q: Array) -> Array:
        """Return the integrals of nu at a configuration, from which bounds count; a car steers straight."""
        y = np.zeros(len(self.coordinates))
        y[self.arms] = q[_BASE:]
        return y

    @cached_property
    def _pivot(self) -> tuple[float, ...]:
        """Direction of the axle, position of the steered wheel from the axle, and its angle."""
        (a, b, arm), (x, y, angle) = self.wheeled.axle, self.wheeled.pivots[0]
        return float(a), float(b), float(x - arm * b), float(y + arm * a), float(angle)

    def curvature(self, steering: Any) -> tuple[Any, Any]:
        """Return yaw rate per speed of a car at a steering angle [1/m], and its slope [1/m rad]."""
        a, b, x, y, angle = self._pivot
        c, s = np.cos(steering + angle), np.sin(steering + angle)
        lever = x * c + y * s
        return (b * s + a * c) / lever, (b * x - a * y) / lever**2

    def steering(self, step: Array, dt: float, current: float) -> float:
        """Return the steering angle for displacements along the path and in yaw, near the present one."""
        a, b, x, y, angle = self._pivot
        small = (_SPEED_TOLERANCE * dt) ** 2
        curvature = (step[-1] * step[0] + small * self.curvature(current)[0]) / (step[0] ** 2 + small)
        return float(np.arctan((curvature * x - a) / (b - curvature * y)) - angle)

    def displace(self, q: Array, y: Array, step: Array) -> tuple[Array, Array]:
        """Return the configuration after a short displacement of nu's integrals, and the base's derivative.

        Parameters
        ----------
        q : ndarray, shape (nq,)
            Configuration of body and arms.
        y, step : ndarray, shape (m,)
            Integrals of nu, and displacement.

        Returns
        -------
        q : ndarray, shape (nq,)
            Configuration, by the midpoint rule.
        slope : ndarray, shape (3, k)
            Its derivative by the displacements of `columns`.
        """
        D, rates = self.columns, step[: self.columns.shape[1]]
        if self.is_car:
            rates = step[:1] * np.array([1.0, self.curvature(y[-1] + step[-1] / 2)[0]])
        forward, left, turn = (D @ rates).tolist()
        middle = float(q[2]) + turn / 2
        c, s = cos(middle), sin(middle)
        dx, dy = c * forward - s * left, s * forward + c * left
        end = q + np.concatenate([(dx, dy, turn), step[self.arms]])
        return end, np.array([[c, -s, -dy / 2], [s, c, dx / 2], [0.0, 0.0, 1.0]]) @ D

    def jacobian(self, J: Array, slope: Array, curvature: float | None) -> Array:
        """Return a frame's Jacobian by nu, shape (rows, m); without curvature, a car's last column is psi.

        Parameters
        ----------
        J : ndarray, shape (rows, nv)
            Jacobian by the velocities of body and arms.
        slope : ndarray, shape (3, k)
            Derivative of the base, see `displace`.
        curvature : float or None
            Curvature of a car's path [1/m].
        """
        base = J[:, :_BASE] @ slope
        if not self.is_car:
            return np.concatenate([base, J[:, _BASE:]], axis=1)
        last = base[:, 1:] if curvature is None else 0 * base[:, 1:]
        return np.concatenate([base[:, :1] + (curvature or 0.0) * base[:, 1:], J[:, _BASE:], last], axis=1)

    def twists(self, rates: Array, y: Array) -> Array:
        """Return body twists, shape (..., 3), for nu and its integrals, shape (..., m)."""
        if not self.is_car:
            return np.asarray(rates[..., : self.columns.shape[1]] @ self.columns.T)
        factors = np.stack([np.ones_like(y[..., -1]), self.curvature(y[..., -1])[0]], axis=-1)
        return np.asarray(rates[..., :1] * factors @ self.columns.T)

    def displacements(self, psi: Array, h: Array, rates: Array, y: Array) -> Array:
        """Return the displacements of x, y and psi over intervals, shape (..., 3).

        Parameters
        ----------
        psi, h : ndarray, shape (...)
            Headings at the beginning [rad], and durations [s].
        rates, y : ndarray, shape (..., 4, m)
            nu and its integrals at the Gauss points of each interval.
        """
        twists = self.twists(rates, y)
        angle = psi[..., None] + h[..., None] * (twists[..., 2] @ _PART_WEIGHTS.T)
        return np.asarray(h[..., None] * (_FULL_WEIGHTS @ rotate_to_world(angle, twists)))

    def first_pose(self, start: Array, points: Array) -> Array:
        """Return x, y and psi at the first knot, shape (3,), from a start and the first displacements."""
        return self.displace(start, self.origin(start), _KNOT @ points)[0][:_BASE]

    def advance(self, pose: Array, points: Array, origin: Array, y: Array, dt: float) -> tuple[Array, Array]:
        """Return the pose at the next knot, shape (3,), and the configuration where nu has the integrals `y`.

        Parameters
        ----------
        pose : ndarray, shape (3,)
            x, y and psi at a knot.
        points : ndarray, shape (4, m)
            Control points, relative to `origin`.
        origin, y : ndarray, shape (m,)
            Integrals of nu at the start, and near the next knot.
        dt : float
            Time between knots [s].
        """
        rates, values = _gauss_values(points, dt)
        pose = pose + self.displacements(pose[2], np.array(dt), rates, origin + values)
        knot = origin + _KNOT @ points[1:]
        return pose, self.displace(np.append(pose, knot[self.arms]), knot, y - knot)[0]

    def poses(self, start: Array, controls: Array, dt: float) -> Array:
        """Return x, y and psi at the knots of a spline, shape (N + 1, 3), see `InverseKinematicsTrajectory`.

        Parameters
        ----------
        start : ndarray, shape (nq,)
            Configuration at the second control point.
        controls : ndarray, shape (N + 3, m)
            Control points of the integrals of nu, from those at `start` on.
        dt : float
            Time between knots [s].
        """
        origin = self.origin(start)
        first = self.first_pose(start, controls[:3] - controls[1])
        points = np.stack([controls[k : len(controls) - 3 + k] for k in range(4)], axis=1)
        rates, values = _gauss_values(points, dt)
        y = origin + values
        turns = np.cumsum(dt * (self.twists(rates, y)[..., 2] @ _FULL_WEIGHTS))
        steps = self.displacements(first[2] + np.append(0.0, turns[:-1]), np.array(dt), rates, y)
        return np.asarray(np.vstack([first, first + np.cumsum(steps, axis=0)]))

    def reference(self, pose: Array, h: Array, curve: Any, t: Array, start: Array) -> tuple[Array, ...]:
        """Return q, v and a of body and arms at times `t`, `h` after the knots with these poses.

        Parameters
        ----------
        pose : ndarray, shape (..., 3)
            x, y and psi at the knots.
        h, t : ndarray, shape (...)
            Times since the knots, and times [s].
        curve : callable
            Function of times and order of derivative that returns the integrals of nu from `start` on.
        start : ndarray, shape (nq,)
            Configuration at the second control point.
        """
        origin = self.origin(start)
        instants = (t - h)[..., None] + h[..., None] * _POINTS
        pose = pose + self.displacements(pose[..., 2], h, curve(instants, 1), origin + curve(instants, 0))
        y, nu, rates = origin + curve(t, 0), curve(t, 1), curve(t, 2)
        twist, rate = self.twists(nu, y), self.twists(rates, y)
        if self.is_car:
            bend = self.curvature(y[..., -1])[1] * nu[..., -1] * nu[..., 0]
            rate = rate + bend[..., None] * self.columns[:, 1]
        turn = twist[..., 2:]
        rate = rate + turn * np.stack([-twist[..., 1], twist[..., 0], 0 * twist[..., 2]], axis=-1)
        v, a = rotate_to_world(pose[..., 2], twist), rotate_to_world(pose[..., 2], rate)
        pairs = (pose, y), (v, nu), (a, rates)
        return tuple(np.concatenate([base, z[..., self.arms]], axis=-1) for base, z in pairs)
