"""Target poses of an end effector over time: positions on a path, and orientations."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from math import sqrt
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from pinmobile.arrays import (
    Array,
    ArrayLike,
    absent,
    bounded,
    finite,
    frozen,
    increasing,
    instance,
    non_negative,
    positive_or_endless,
    required,
    shaped,
)
from pinmobile.errors import InvalidArgument, NotTraceable
from pinmobile.parts import holds_symbols
from pinmobile.paths import Path, Spline, check_path, within

_HALF_TURN = 1e-6  # [rad]: closer to half a turn, rounding would decide the sense of rotation
_SMALL_ANGLE = 1e-2  # [rad]: below, a series avoids cancellation
_ITERATIONS, _RATE_TOLERANCE = 200, 1e-13  # largest number of iterations, and tolerance
_BANDS = 5  # bands beside the diagonal of a block-tridiagonal matrix with blocks of three rows


class OrientationSample(NamedTuple):
    """Orientation at given times, with its angular velocity and acceleration along the inertial axes.

    Attributes
    ----------
    R : ndarray, shape (..., 3, 3)
        Rotation matrix.
    rate, change : ndarray, shape (..., 3)
        Angular velocity [rad/s] and angular acceleration [rad/s^2].
    """

    R: Array
    rate: Array
    change: Array


@dataclass(frozen=True, eq=False)
class Turn:
    """Rotation about one axis, at rest at both ends: quintic in time.

    Parameters
    ----------
    start : ndarray, shape (3, 3)
        Orientation at time zero.
    turn : ndarray, shape (3,)
        Rotation vector along the axes of `start`, of any length [rad].
    duration : float
        Duration [s].
    """

    start: Array
    turn: Array
    duration: float

    def __call__(self, t: Array) -> OrientationSample:
        """Return the orientation at times between 0 and the duration."""
        s, ds, dds = _quintic(t / self.duration)
        axis = self.start @ self.turn  # constant, so the rates about this axis are those of the angle
        rate, change = ds[..., None] / self.duration * axis, dds[..., None] / self.duration**2 * axis
        return OrientationSample(self.start @ rotations_of(s[..., None] * self.turn), rate, change)


@dataclass(frozen=True, eq=False)
class OrientationSpline:
    """Spline through orientations with continuous angular acceleration, at rest at both ends.

    Between two orientations, the rotation vector relative to the first is a cubic polynomial of time, as in
    ``scipy.spatial.transform.RotationSpline``, whose ends are not at rest.

    Parameters
    ----------
    rotations : ndarray, shape (n, 3, 3)
        Orientations, n >= 2, each less than half a turn from the previous one.
    times : ndarray, shape (n,)
        Times from zero, increasing [s].

    Raises
    ------
    InvalidArgument
        If two successive orientations are half a turn apart, or the iteration for the spline does not
        converge.
    """

    rotations: Array
    times: Array
    _cubics: Array = field(init=False, repr=False)  # (n - 1, 4, 3), in powers of the time since the knot

    def __post_init__(self) -> None:
        R, steps = self.rotations, np.diff(self.times)
        turns = np.array([pin.log3(a.T @ b) for a, b in pairwise(R)])
        k = int(np.argmax(np.linalg.norm(turns, axis=1)))
        advice = "add an orientation between them"
        _check_sense(f"rotation[{k + 1}] is half a turn from rotation[{k}]", turns[k], advice)
        rates = _rates(turns, steps)
        ends = np.einsum("nij,nj->ni", _right_jacobians_inverse(turns), rates[1:])
        h = steps[:, None]
        quadratic = (3 * turns / h - 2 * rates[:-1] - ends) / h
        cubic = (rates[:-1] + ends - 2 * turns / h) / h**2
        rows = np.stack([np.zeros_like(turns), rates[:-1], quadratic, cubic], axis=1)
        object.__setattr__(self, "_cubics", frozen(rows))

    def __call__(self, t: Array) -> OrientationSample:
        """Return the orientation at times between the first and the last."""
        k = np.searchsorted(self.times[1:-1], t, side="right")
        s, c = (t - self.times[k])[..., None], np.moveaxis(self._cubics[k], -2, 0)
        phi = s * (c[1] + s * (c[2] + s * c[3]))
        rate = c[1] + s * (2 * c[2] + s * 3 * c[3])
        change = 2 * c[2] + 6 * s * c[3]
        R = self.rotations[k] @ rotations_of(phi)
        rates = (_body_rate(phi, rate), _body_rate(phi, change) + _body_drift(phi, rate))
        columns = (np.einsum("...ij,...j->...i", R, each) for each in rates)
        return OrientationSample(R, *columns)


def rotations_of(turns: Array) -> Array:
    """Return the rotation matrices of rotation vectors, shape (..., 3, 3) (Rodrigues, 1840).

    Parameters
    ----------
    turns : ndarray, shape (..., 3)
        Rotation vectors [rad].
    """
    K, (a, b, _, _) = _skew(turns), _coefficients(turns)
    sine = (1 - b[..., None, None] * np.einsum("...i,...i->...", turns, turns)[..., None, None]) * K
    return np.asarray(np.eye(3) + sine + a[..., None, None] * (K @ K))


def _check_sense(words: str, turn: Array, advice: str) -> None:
    if is_half_turn(float(np.linalg.norm(turn))):
        ambiguous = "expected less, since the sense of rotation is ambiguous"
        raise InvalidArgument(f"{words}, {ambiguous}: {advice}")


def is_half_turn(angle: float) -> bool:
    """Return whether the angle of a rotation vector [rad] is half a turn, up to rounding."""
    return angle > np.pi - _HALF_TURN


def _rates(turns: Array, steps: Array) -> Array:
    """Return the body's angular velocities at the knots, shape (n, 3) [rad/s], zero at the ends.

    The angular acceleration is continuous at each knot. This condition is linear in the angular velocities,
    except for a term that the rotation of the axes adds; fixed-point iteration determines this term.
    """
    from scipy.linalg import solve_banded

    count = len(turns) - 1
    rates = np.zeros((len(turns) + 1, 3))
    if not count:
        return rates
    J, inverse = _right_jacobians(turns), _right_jacobians_inverse(turns)
    h = steps[:, None]
    right = 6 * (turns[:-1] / h[:-1] ** 2 + turns[1:] / h[1:] ** 2)
    matrix = np.zeros((2 * _BANDS + 1, 3 * count))
    for k in range(count):
        blocks = {k: 4 * (1 / steps[k] + 1 / steps[k + 1]) * np.eye(3)}
        if k:
            blocks[k - 1] = 2 / steps[k] * J[k]
        if k + 1 < count:
            blocks[k + 1] = 2 / steps[k + 1] * inverse[k + 1]
        for column, block in blocks.items():
            for i, j in np.ndindex(3, 3):
                row, col = 3 * k + i, 3 * column + j
                matrix[_BANDS + row - col, col] = block[i, j]
    for _ in range(_ITERATIONS):
        ends = np.einsum("nij,nj->ni", inverse[:-1], rates[1:-1])
        solution = solve_banded((_BANDS, _BANDS), matrix, (right - _body_drift(turns[:-1], ends)).ravel())
        previous, rates[1:-1] = rates[1:-1].copy(), solution.reshape(-1, 3)
        if np.abs(rates[1:-1] - previous).max() <= _RATE_TOLERANCE * np.abs(rates).max():
            return rates
    raise InvalidArgument(
        "rotation has steps too large for a smooth spline, expected smaller ones: add orientations between"
    )


def _coefficients(phi: Array) -> tuple[Array, Array, Array, Array]:
    """Return A = (1 - cos x) / x^2, B = (x - sin x) / x^3, A' / x and B' / x for x, the norm of phi."""
    x = np.linalg.norm(phi, axis=-1)
    small = x < _SMALL_ANGLE
    y = np.where(small, 1.0, x)
    s, c, z = np.sin(y), np.cos(y), x * x
    a = np.where(small, 1 / 2 - z / 24 + z * z / 720, 2 * np.sin(y / 2) ** 2 / y**2)
    b = np.where(small, 1 / 6 - z / 120 + z * z / 5040, (y - s) / y**3)
    da = np.where(small, -1 / 12 + z / 180 - z * z / 6720, (y * s - 2 * (1 - c)) / y**4)
    db = np.where(small, -1 / 60 + z / 1260 - z * z / 60480, (y * (1 - c) - 3 * (y - s)) / y**5)
    return a, b, da, db


def _body_rate(phi: Array, rate: Array) -> Array:
    """Return J(phi) phi', the angular velocity along the rotated axes, shape (..., 3)."""
    a, b, _, _ = (each[..., None] for each in _coefficients(phi))
    product = np.cross(phi, rate)
    return np.asarray(rate - a * product + b * np.cross(phi, product))


def _body_drift(phi: Array, rate: Array) -> Array:
    """Return dJ/dt phi', the angular acceleration for phi'' = 0, shape (..., 3)."""
    _, b, da, db = (each[..., None] for each in _coefficients(phi))
    product, projection = np.cross(phi, rate), np.einsum("...i,...i->...", phi, rate)[..., None]
    double = np.cross(phi, product)
    return np.asarray(projection * (db * double - da * product) + b * np.cross(rate, product))


def _right_jacobians(phi: Array) -> Array:
    """Return the Jacobian J of the exponential map along the rotated axes, shape (..., 3, 3)."""
    a, b, _, _ = (each[..., None, None] for each in _coefficients(phi))
    K = _skew(phi)
    return np.asarray(np.eye(3) - a * K + b * (K @ K))


def _right_jacobians_inverse(phi: Array) -> Array:
    return np.asarray(np.linalg.inv(_right_jacobians(phi)), np.float64)


def _skew(v: Array) -> Array:
    K = np.zeros((*v.shape, 3))
    K[..., 0, 1], K[..., 0, 2], K[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return np.asarray(K - np.swapaxes(K, -1, -2))


def _quintic(x: Array) -> tuple[Array, Array, Array]:
    """Return the quintic from 0 to 1, at rest at both ends, and its first two derivatives."""
    return x**3 * (10 - 15 * x + 6 * x**2), 30 * (x * (1 - x)) ** 2, 60 * x * (1 - x) * (1 - 2 * x)


_ROTATION_TOLERANCE = 1e-6  # largest difference of R' R and the identity
_POSITION = 3  # rows of a target without orientation
_END_TOLERANCE = 1e-9  # relative
_SIGN_SHARE = 0.05  # share of the length of a rotation vector


class PoseTarget(NamedTuple):
    """Desired pose of a frame, with its twist and acceleration, at one time or many.

    Attributes
    ----------
    pose : ndarray, shape (..., 4, 4)
        T_0_f, the pose of the frame in the inertial frame [1, m]. The rotation is the identity for a target
        without orientation.
    twist : ndarray, shape (..., 6)
        Velocity of the origin and angular velocity along the inertial axes [m/s, rad/s].
    rate : ndarray, shape (..., 6)
        Time derivative of the twist [m/s^2, rad/s^2].

    See Also
    --------
    PosePath : path that returns this object
    reaching.pose_error : error of a pose

    Examples
    --------
    >>> from pinmobile import Line, PosePath
    >>> target = PosePath(Line([0, 0, 1], [1, 0, 1], 2.0))(1.0)
    >>> target.twist[:3]  # velocity [m/s]
    array([0.5, 0. , 0. ])
    """

    pose: Array
    twist: Array
    rate: Array


@dataclass(frozen=True, eq=False)
class PosePath:
    """Target poses over time: a path in space with an orientation, or without one.

    The orientation is constant, rotates about one axis, or passes through given orientations. A rotation
    about one axis is quintic in time and at rest at both ends. The spline through several orientations has a
    continuous angular acceleration and is at rest at both ends.

    Parameters
    ----------
    path : Path
        Continuous path of three coordinates x, y, z in the inertial frame [m].
    rotation : array_like, shape (3, 3) or (n, 3, 3), optional
        R_0_f, one or n orientations of the frame; by default, the target has no orientation. Each of n
        orientations is less than half a turn from the previous one.
    final_rotation : array_like, shape (3, 3), optional
        Orientation at the end, reached by the shortest rotation; by default, `rotation`.
    turn : array_like, shape (3,), optional
        Rotation vector along the frame's axes (axis times angle), of any length [rad], instead of
        `final_rotation`. With ``(0, 0, 2 * pi)``, the frame turns once about its z axis.
    times : array_like, shape (n,), optional
        Times of the n orientations, increasing from zero to the path's duration [s].

    Raises
    ------
    InvalidArgument
        If `path` is not a path in space; if a matrix is not a rotation; if `final_rotation` or `turn` comes
        without `rotation`, or both are given; if two successive orientations are half a turn apart; or if
        `times` are missing, do not increase, or do not begin and end with the path.

    See Also
    --------
    solve_inverse_kinematics : trajectory of base and arm for this target
    EndEffectorTracking : controller for this target
    Line : path in the plane or in space

    Examples
    --------
    >>> from math import pi
    >>> from pinmobile import Line, PosePath
    >>> identity = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    >>> way = Line([0, 0, 1], [1, 0, 1], 2.0)
    >>> target = PosePath(way, identity, turn=(0, 0, pi))
    >>> target(1.0).twist[[0, 5]]  # middle: forward, yaw [m/s, rad/s]
    array([0.5  , 2.945])
    """

    path: Path
    rotation: ArrayLike | None = None
    final_rotation: ArrayLike | None = None
    turn: ArrayLike | None = None
    times: ArrayLike | None = None
    _orientation: Turn | OrientationSpline | None = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if holds_symbols(self.path):
            raise NotTraceable(
                "target poses of a law are numbers, such as those of EndEffectorTracking",
                "plan by solve_inverse_kinematics and track by ComputedTorque, which is compiled",
            )
        check_path(self.path, 3)
        if self.final_rotation is not None:
            absent("with final_rotation", turn=self.turn)
        if self.rotation is None:
            names = "final_rotation", "turn", "times"
            absent("without rotation", **{name: getattr(self, name) for name in names})
            object.__setattr__(self, "_orientation", None)
            return
        R = finite("rotation", self.rotation)
        many = R.ndim == 3 and self.final_rotation is None and self.turn is None
        object.__setattr__(self, "rotation", _check_rotations(R) if many else _check_rotation(R))
        object.__setattr__(self, "_orientation", self._make_spline() if many else self._make_turn())

    @classmethod
    def through(cls, poses: ArrayLike, times: ArrayLike | None = None) -> PosePath:
        """Return the path through given poses, at rest at both ends, with continuous acceleration.

        The position is the cubic `Spline` through the positions of the poses.

        Parameters
        ----------
        poses : array_like, shape (n, 4, 4)
            T_0_f, at least two poses, each rotated by less than half a turn from the previous one [1, m].
        times : array_like, shape (n,)
            Times of the poses, increasing from zero [s].

        Returns
        -------
        PosePath
            Path through the poses.

        Raises
        ------
        InvalidArgument
            If an argument is not what is expected, times are missing, or two poses have the same time.
        """
        T = shaped("poses", finite("poses", poses), ("n>=2", 4, 4))
        error = np.abs(T[:, 3] - [0, 0, 0, 1]).max()
        if error > _ROTATION_TOLERANCE:
            raise InvalidArgument(f"poses has last rows off by {error:.3g}, expected (0, 0, 0, 1)")
        t = _check_times(times, len(T))
        return cls(Spline(T[:, :3, 3], t), T[:, :3, :3], times=t)

    def _make_turn(self) -> Turn:
        absent("with one rotation: it applies to n of them, shape (n, 3, 3)", times=self.times)
        R, turn = np.asarray(self.rotation), np.zeros(3)
        if self.turn is not None:
            turn = shaped("turn", finite("turn", self.turn), (3,), words=": axis times angle")
            object.__setattr__(self, "turn", frozen(turn))
        if self.final_rotation is not None:
            final = _check_rotation(finite("final_rotation", self.final_rotation), "final_rotation")
            object.__setattr__(self, "final_rotation", final)
            turn = pin.log3(R.T @ final)
            _check_sense("final_rotation is half a turn from rotation", turn, "give turn= instead")
        return Turn(R, frozen(turn), self.duration)

    def _make_spline(self) -> OrientationSpline:
        R, end = np.asarray(self.rotation), self.duration
        t = _check_times(self.times, len(R))
        if t[0] != 0 or abs(t[-1] - end) > _END_TOLERANCE * end:
            raise InvalidArgument(
                f"times goes from {t[0]:g} to {t[-1]:g} s, expected from 0 to {end:g} s, like the path"
            )
        object.__setattr__(self, "times", frozen(t))
        return OrientationSpline(R, np.append(t[:-1], end))

    @property
    def duration(self) -> float:
        """Duration of the path [s]."""
        return float(self.path.duration)

    @property
    def rows(self) -> int:
        """Number of controlled entries of the twist: 6, or 3 for a target without orientation."""
        return 3 if self.rotation is None else 6

    def __call__(self, t: ArrayLike) -> PoseTarget:
        """Return the target at given times.

        Parameters
        ----------
        t : array_like, shape (...)
            Times, 0 <= t <= duration [s].

        Returns
        -------
        reaching.PoseTarget
            Pose, twist and acceleration.

        Raises
        ------
        InvalidArgument
            If a time is out of range.
        """
        times = within("t", t, self.duration)
        pose = np.zeros((*times.shape, 4, 4))
        twist, rate = np.zeros((2, *times.shape, 6))
        pose[..., 3, 3] = 1
        pose[..., :3, 3] = self.path(times)
        twist[..., :3], rate[..., :3] = (self.path.derivative(times, order) for order in (1, 2))
        pose[..., :3, :3] = np.eye(3)
        if self._orientation is not None:
            pose[..., :3, :3], twist[..., 3:], rate[..., 3:] = self._orientation(times)
        return PoseTarget(pose, twist, rate)

    def target_signals(self, frame: str, t: Array) -> dict[str, tuple[str, Array]]:
        """Return the signals of the target of a frame, by name.

        The signals are the position [m], shape (N + 1, 3), and the orientation (if the target has one) as a
        quaternion (x, y, z, w), shape (N + 1, 4), without jumps of sign.

        Parameters
        ----------
        frame : str
            Name of the frame.
        t : ndarray, shape (N + 1,)
            Times [s].
        """
        pose = self(np.minimum(t, self.duration)).pose
        (position, orientation), signals = target_names(frame), dict[str, tuple[str, Array]]()
        signals[position] = "m", pose[:, :3, 3]
        if self.rows > _POSITION:
            quaternions = np.array([pin.Quaternion(R).coeffs() for R in pose[:, :3, :3]])
            signals[orientation] = "", align_signs(quaternions)
        return signals


@dataclass(frozen=True, eq=False)
class FrameTask:
    """Task of a frame in `solve_inverse_kinematics`: pose, position, orientation or direction of an axis.

    The solver minimises the weighted errors of all tasks, ``(weight error)^2``. A weight of a hundred times
    that of another task is a priority: the task then gives way by 1e-4 of the other one's error.

    Parameters
    ----------
    target : PosePath
        Target poses, or target positions, of the frame.
    frame : str, optional
        Frame that follows the target, one of ``robot.frame_names``; by default, ``robot.end_effector``.
    axis : array_like, shape (3,), optional
        Axis along the frame's axes, of any length. With it, the orientation of the target gives only the
        direction of this axis; the frame may turn about it. By default, all of the orientation.
    position, orientation : float
        Weights of the errors of position [1/m] and orientation [1/rad], 0 to 1e6; zero leaves it free.
    tolerance : float
        Largest accepted distance [m] and angle [rad], see `solve_inverse_kinematics`; by default, any. For
        the first of several tasks, the smaller of both tolerances applies.

    Raises
    ------
    InvalidArgument
        If an argument is not what is expected, an axis comes with a target without orientation, or nothing
        has a weight.

    See Also
    --------
    solve_inverse_kinematics : trajectory of base and arm for these tasks
    PosePath : target poses

    Examples
    --------
    >>> from pinmobile import FrameTask, Hold, PosePath
    >>> identity = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    >>> ahead = PosePath(Hold([0, 0, 0], 2.0), identity)
    >>> tool = FrameTask(ahead, position=100, orientation=10)
    >>> heading = FrameTask(ahead, "base_link", (1, 0, 0), position=0)
    >>> tool.weights.tolist(), heading.weights.tolist()
    ([100.0, 100.0, 100.0, 10.0, 10.0, 10.0], [1.0, 1.0, 1.0])
    """

    target: PosePath
    frame: str | None = None
    axis: ArrayLike | None = None
    position: float = 1.0
    orientation: float = 1.0
    tolerance: float = np.inf

    def __post_init__(self) -> None:
        instance("target", self.target, PosePath, "a PosePath")
        values: dict[str, Any] = {"tolerance": positive_or_endless("tolerance", self.tolerance)}
        for name in ("position", "orientation"):
            values[name] = bounded(name, non_negative(name, getattr(self, name)), most=1e6)
        if self.axis is not None:
            axis = shaped("axis", finite("axis", self.axis), (3,))
            length = float(np.linalg.norm(axis))
            if not length or self.target.rows == _POSITION:
                words = "a target with an orientation, PosePath(path, rotation)" if length else "a direction"
                raise InvalidArgument(f"axis is {axis.tolist()}, expected {words}")
            values["axis"] = frozen(axis / length)
        for name, value in values.items():
            object.__setattr__(self, name, value)
        if not len(self.weights):
            raise InvalidArgument("position and orientation have weight 0, expected one > 0")

    @cached_property
    def rows(self) -> slice:
        """Entries of the pose error that the task reduces."""
        has_turn = self.target.rows > _POSITION and self.orientation > 0
        return slice(0 if self.position else _POSITION, 2 * _POSITION if has_turn else _POSITION)

    @cached_property
    def weights(self) -> Array:
        """Weights of these entries, shape (3,) or (6,)."""
        return frozen(np.repeat([self.position, self.orientation], _POSITION)[self.rows])

    def error_of(self, goal: tuple[Array, Array], pose: pin.SE3) -> Array:
        """Return the error of a pose, shape (rows,) [m, rad], see `pose_error`.

        Parameters
        ----------
        goal : two ndarrays, shape (3,) and (3, 3)
            Target position and orientation.
        pose : pin.SE3
            Pose of the frame.
        """
        error = np.empty(2 * _POSITION)
        error[:_POSITION] = goal[0] - pose.translation
        if self.rows.stop > _POSITION:
            error[_POSITION:] = self.turn(goal[1], pose.rotation)
        return error[self.rows]

    def rows_of(self, pose: pin.SE3, J: Array) -> Array:
        """Return the Jacobian of the error's entries, shape (rows, nv), from that of the frame, (6, nv)."""
        if self.axis is not None and self.rows.stop > _POSITION:
            axis = pose.rotation @ np.asarray(self.axis)
            J[_POSITION:] -= np.outer(axis, axis @ J[_POSITION:])  # turns about the axis change nothing
        return J[self.rows]

    def turn(self, target: Array, R: Array) -> Array:
        """Return the rotation vector from an orientation, or its axis, to that of the target, shape (3,)."""
        if self.axis is None:
            return _log(target @ R.T)
        axis = np.asarray(self.axis)
        actual, desired = R @ axis, target @ axis
        normal, cosine = np.cross(actual, desired), float(actual @ desired)
        size = float(np.linalg.norm(normal))
        if not size and cosine < 0:  # any axis across serves
            normal = np.cross(actual, np.eye(3)[np.argmin(np.abs(actual))])
        return np.asarray(normal * (np.arctan2(size, cosine) / (np.linalg.norm(normal) or 1.0)))

    def signals(self, t: Array) -> dict[str, tuple[str, Array]]:
        """Return the signals of the target, see `PosePath.target_signals`; of an axis, those of the position.

        Parameters
        ----------
        t : ndarray, shape (N + 1,)
            Times [s].
        """
        oriented = self.axis is None and self.rows.stop > _POSITION
        return (self.target if oriented else PosePath(self.target.path)).target_signals(str(self.frame), t)


def align_signs(quaternions: Array) -> Array:
    """Return the same rotations without changes of sign between successive quaternions, shape (n, 4)."""
    changes = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0
    return quaternions * np.where(np.cumsum(np.append(False, changes)) % 2, -1.0, 1.0)[:, None]


def target_names(frame: str) -> tuple[str, str]:
    """Return the names of the signals of a frame's target: position and orientation."""
    return f"target position of {frame}", f"target orientation of {frame}"


def pose_error(target: Array, actual: Array) -> Array:
    """Return the error of a pose relative to its target, shape (..., 6) [m, rad], along the inertial axes.

    The first three entries are the displacement of the origin from the actual to the target pose. The last
    three are the rotation vector (axis times angle, angle in [0, pi]) from the actual to the target
    orientation.

    Parameters
    ----------
    target, actual : ndarray, shape (..., 4, 4)
        Poses [1, m]; leading axes broadcast.

    Returns
    -------
    ndarray, shape (..., 6)
        Error of position [m] and of orientation [rad].

    See Also
    --------
    PosePath : target poses
    EndEffectorTracking : controller that reduces this error

    Examples
    --------
    >>> from pinmobile import Line, PosePath, MobileRobot
    >>> from pinmobile.reaching import pose_error
    >>> target = PosePath(Line([0, 0, 0], [1, 0, 0], 2.0))
    >>> actual = MobileRobot.lecture().frame_pose([0.9, 0, 0.1])
    >>> pose_error(target(2.0).pose, actual).round(3)[[0, 5]]
    array([ 0.1, -0.1])
    """
    displacement = target[..., :3, 3] - actual[..., :3, 3]
    turn = target[..., :3, :3] @ np.swapaxes(actual[..., :3, :3], -1, -2)
    turns = np.array([_log(R) for R in turn.reshape(-1, 3, 3)]).reshape((*turn.shape[:-2], 3))
    return np.concatenate([displacement, turns], axis=-1)


def _log(R: Array) -> Array:
    """Return the rotation vector of a rotation, shape (3,), with a sense of half turns free of rounding.

    For a half turn, the first component above a threshold is positive. Common axes have no component of about
    the size of the threshold.
    """
    turn = pin.log3(R)
    angle = sqrt(turn @ turn)
    if is_half_turn(angle):
        leading = turn[np.argmax(np.abs(turn) > _SIGN_SHARE * angle)]
        if leading < 0:
            turn = turn * (1 - 2 * np.pi / angle)  # the same rotation in the opposite sense
    return np.asarray(turn)


def error_sizes(error: Array) -> Array:
    """Return the distance [m] and the angle [rad] of pose errors, shape (..., 2), by Euclidean norms.

    Parameters
    ----------
    error : ndarray, shape (..., 6) or (..., 3)
        Errors as from `pose_error`. For three entries, the angle is zero.
    """
    return np.stack([np.linalg.norm(part, axis=-1) for part in (error[..., :3], error[..., 3:])], axis=-1)


def _check_times(times: ArrayLike | None, count: int) -> Array:
    """Return the times of `count` poses; raise `InvalidArgument` for anything else."""
    given = required("times", times, f"the time of each pose, shape ({count},) [s]")
    t = shaped("times", finite("times", given), (count,), words=", one for each pose")
    increasing("times", t)
    return t


def _check_rotations(R: Array) -> Array:
    shaped("rotation", R, (3, 3), ("n>=2", 3, 3))
    return frozen([_check_rotation(each, f"rotation[{k}]") for k, each in enumerate(R)])


def _check_rotation(R: Array, name: str = "rotation") -> Array:
    shaped(name, R, (3, 3))
    error = float(np.abs(R.T @ R - np.eye(3)).max())
    if error > _ROTATION_TOLERANCE or np.linalg.det(R) < 0:
        raise InvalidArgument(
            f"{name} has R' R off by {round(error, 9):.3g} and det R = {np.linalg.det(R):.3g}, "
            "expected a rotation matrix"
        )
    return frozen(R)
