"""Trajectories: a path and a heading, or base and arms together, within the limits of joints."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable
from warnings import warn

import numpy as np

from pinmobile.arrays import (
    LEAST_ANGLE,
    Array,
    ArrayLike,
    finite,
    frozen,
    instance,
    positive,
    required,
    shaped,
)
from pinmobile.errors import InvalidArgument, LimitWarning, unexpected_value
from pinmobile.parts import Following, child, children, number, option, part
from pinmobile.paths import Hold, Path, Value, check_path, pieces_of, within
from pinmobile.plant import refuse_path, stated
from pinmobile.trajectories.direction import (
    STANDSTILL,
    DirectionLimit,
    Hodograph,
    Leg,
    halve,
    heading,
    hodograph,
    max_lengths,
)


class Reference(NamedTuple):
    """Desired configuration, velocity and acceleration, at one time or at many.

    Attributes
    ----------
    q : ndarray, shape (..., nq)
        (x, y, psi) and, for a robot with arms, their configurations [m, m, rad, ...].
    v, a : ndarray, shape (..., nv)
        Velocity and acceleration [m/s, m/s, rad/s, ...; m/s^2, m/s^2, rad/s^2, ...].

    See Also
    --------
    Tangent : a trajectory that returns references
    trajectories.Trajectory : protocol of trajectories

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import PD, Reference
    >>> from pinmobile.controllers import planar_difference
    >>> zero, law = np.zeros(3), PD(kp=100.0, kd=20.0)
    >>> goal = Reference(np.array([1.0, 2.0, 0.0]), zero, zero)
    >>> law(0.0, zero, zero, goal, planar_difference)[0]  # [N]
    array([100., 200.,   0.])
    """

    q: Array
    v: Array
    a: Array


@runtime_checkable
class Trajectory(Protocol):
    """A reference as a function of time, 0 <= t <= duration.

    Any class with these members is a trajectory.

    See Also
    --------
    Tangent : path with its tangent as heading
    FixedHeading : path with a constant heading
    Reference : return value of a trajectory

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import PD, MobileRobot, Reference, simulate
    >>> class Spin:
    ...     duration = 1.0
    ...     def __call__(self, t):
    ...         t, v = np.asarray(t)[..., None], np.array([0, 0, 2])
    ...         return Reference(v * t, v + 0 * t, 0 * v * t)
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> run = simulate(robot, PD(90.0, 9.0), Spin(), dt=0.02)
    >>> run.q[-1].round(2)  # [m, m, rad]
    array([0., 0., 2.])
    """

    @property
    def duration(self) -> float:
        """Time from start to end [s]."""
        ...

    def __call__(self, t: ArrayLike, /) -> Reference:
        """Return the reference.

        Parameters
        ----------
        t : array_like, shape (...)
            Times, 0 <= t <= duration [s].

        Returns
        -------
        reference : Reference
            Arrays of shape (..., n).
        """
        ...


def join_heading(plane: Iterable[Array], headings: Iterable[Array]) -> Reference:
    """Return the reference of a motion in the plane and a motion of the heading.

    Parameters
    ----------
    plane : iterable of three ndarray, shape (..., 2)
        Position, velocity and acceleration [m, m/s, m/s^2].
    headings : iterable of three ndarray, shape (...)
        psi and its two derivatives [rad, rad/s, rad/s^2].
    """
    return Reference(*(np.append(xy, psi[..., None], -1) for xy, psi in zip(plane, headings, strict=True)))


def check_plane_path(path: object) -> Path:
    """Return a path after a check that it has two coordinates and consecutive pieces.

    Raises
    ------
    InvalidArgument
        If it has not.
    """
    plane = check_path(path, 2)
    duration = positive("path.duration", plane.duration, "s")
    ends = [(float(piece.start), float(piece.end)) for piece in pieces_of(plane)]
    times = [0.0, *(end for _, end in ends)]
    if [start for start, _ in ends] != times[:-1] or times != sorted(set(times)) or times[-1] != duration:
        raise InvalidArgument(
            f"path.pieces has (start, end) {ends}, expected consecutive pieces from 0 to {duration}"
        )
    return plane


_LIMIT_TOLERANCE = 1e-9  # [m, rad], relative for velocities: tolerance of a path that ends at a limit


def check_limits(robot: Any, q: Array, v: Array, t: Array | None = None) -> None:
    """Check that configurations and velocities respect the joint limits of a robot.

    Parameters
    ----------
    robot : MobileRobot
        Robot with the limits ``lower``, ``upper`` and ``velocity_limit``.
    q : ndarray, shape (..., n), n <= nq
        Configurations, or their first entries [m, m, rad, ...].
    v : ndarray, shape (..., m), m <= nv
        Velocities, or their first entries [m/s, m/s, rad/s, ...].
    t : ndarray, shape (...), optional
        Times of a reference, for the error message [s]; without them, the state is a start (q0, v0).

    Raises
    ------
    InvalidArgument
        If a value exceeds its limit; the message contains the joint, its value and limit, and the time.

    See Also
    --------
    WholeBody : trajectory that checks joint limits
    MobileRobot : robot with joint limits

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import MobileRobot
    >>> from pinmobile.trajectories import check_limits
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)  # no limits
    >>> check_limits(robot, np.array([9.0, 0, 0]), np.zeros(3))
    """
    n, speed = q.shape[-1], robot.velocity_limit[: v.shape[-1]]
    positions = "q0", "has", q, robot.lower[:n], robot.upper[:n], _LIMIT_TOLERANCE, ""
    rates = "v0", "moves", v, -speed, speed, _LIMIT_TOLERANCE * speed, "/s"
    for start, verb, values, lower, upper, tolerance, rate_unit in (positions, rates):
        outside = (values < lower - tolerance) | (values > upper + tolerance)
        if outside.any():
            *index, k = (int(i) for i in np.argwhere(outside)[0])
            name, unit = robot.coordinates[k][:2]
            source, time = (start, "") if t is None else ("reference", f" at t = {t[tuple(index)]:g} s")
            expected = f"at most {upper[k]:.9g}" if rate_unit else f"{lower[k]:.9g} to {upper[k]:.9g}"
            raise InvalidArgument(
                f"{source} {verb} joint {name!r} at {values[(*index, k)]:.9g} {unit}{rate_unit}{time}, "
                f"expected {expected} {unit}{rate_unit}"
            )


_TIME_TOLERANCE = 1e-9  # relative tolerance for the equality of two durations
_REST_TOLERANCE = 1e-9  # [m/s, rad/s]: tolerance of an end at rest
_PROBES = 33  # samples per analytic piece of a path, including its ends


@part
class WholeBody(Value):
    """Trajectory of the base together with one path per arm.

    The coordinates of an arm's path are the positions of its joints [rad or m]. Any path of this size is
    possible: `CubicVia` and `Spline` through postures, `Hold`, `RestToRest`.

    The trajectory lasts as long as its longest part. Shorter parts must end at rest, and stay there.

    Parameters
    ----------
    robot : MobileRobot or WheeledRobot
        Robot with these arms; of a robot on wheels, the body and the arms. References stay within its limits
        of joint position and velocity.
    base : trajectory
        Trajectory of x, y and psi, such as `Tangent` or `FixedHeading`.
    *paths : Path or None
        One path per arm, in the order of ``robot.mounts``; None keeps the arm's reference posture.
    joints : sequence of Path or None, optional
        The same paths as one sequence.

    Raises
    ------
    InvalidArgument
        If `robot`, `base` or a path is of another kind; the numbers of paths and arms differ; or a path has
        another number of coordinates than its arm, exceeds joint limits, or ends before the others while it
        moves.

    See Also
    --------
    EndEffectorTracking : control of an end effector along a path
    solve_inverse_kinematics : trajectory from a path of poses
    Tangent : trajectory of the base

    Examples
    --------
    >>> from pinmobile import Circle, MobileRobot, RestToRest
    >>> from pinmobile import Tangent, WholeBody
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3).mount("ur5")
    >>> base, arm = Tangent(Circle(3.0, 0.1, 2.0)), robot.rest[3:]
    >>> lift = RestToRest(arm, arm + 0.5, duration=2.0)
    >>> WholeBody(robot, base, lift)(2.0).q[:4].round(2)  # [m, rad]
    array([0.6 , 0.06, 0.2 , 0.5 ])
    """

    robot: Any = option(doc="robot with base and arms")
    base: Any = child(Following, doc="trajectory of x, y and psi")
    joints: Any = children(Path, doc="paths of the arms")

    def __init__(self, robot: Any, base: Any, *paths: Path | None, joints: Sequence[Path] = ()) -> None:
        body = stated(robot, "robot")
        robot = robot if body is None else body
        _check_robot(robot)
        _check_base(base)
        given = paths or joints
        if len(given) != len(robot.mounts):
            raise InvalidArgument(
                f"joints has {len(given)} paths, expected {len(robot.mounts)}, one per arm of the robot"
            )
        checked = [_check_arm_path(robot, k, path, float(base.duration)) for k, path in enumerate(given)]
        self.__attrs_init__(robot, base, checked)  # type: ignore[attr-defined]

    def check(self) -> None:
        """Raise `InvalidArgument` if a part ends while it moves, or exceeds joint limits."""
        for name, (motion, end) in self._parts().items():
            _check_end(name, motion, end, self.duration)
        # Values between these times are checked when the trajectory is called.
        for path in self.joints:
            self(np.concatenate([np.linspace(p.start, p.end, _PROBES) for p in pieces_of(path)]))

    @property
    def duration(self) -> float:
        """Duration of the longest part [s]."""
        return max(float(each.duration) for each in (self.base, *self.joints))

    def __repr__(self) -> str:
        return f"WholeBody({', '.join(map(repr, (self.robot, self.base, *self.joints)))})"

    def __call__(self, t: ArrayLike) -> Reference:
        """Return the reference.

        Parameters
        ----------
        t : array_like, shape (...)
            Times, 0 <= t <= duration [s].

        Returns
        -------
        reference : Reference
            q of shape (..., nq), v and a of shape (..., nv), in the order of the robot.

        Raises
        ------
        InvalidArgument
            If a time lies outside, or the reference exceeds a joint limit; the message names the joint.
        """
        times = within("t", t, self.duration)
        parts = [_clamp_motion(motion, end, times) for motion, end in self._parts().values()]
        q, v, a = (np.concatenate(arrays, axis=-1) for arrays in zip(*parts, strict=True))
        check_limits(self.robot, q, v, times)
        return Reference(q, v, a)

    def _parts(self) -> dict[str, tuple[Callable[[Array], Reference], float]]:
        """Return each part as a function of time, with its duration [s]."""
        paths = {f"joints[{k}]": (partial(_follow, p), float(p.duration)) for k, p in enumerate(self.joints)}
        return {"base": (self.base, float(self.base.duration)), **paths}


def _follow(path: Path, t: Array) -> Reference:
    """Return a path's position and derivatives at times as a reference."""
    return Reference(*(path.derivative(t, order) for order in range(3)))


def _clamp_motion(motion: Callable[[Array], Reference], end: float, t: Array) -> Reference:
    """Return a motion at times `t`; after its end it stays at rest."""
    q, v, a = motion(np.minimum(t, end))
    rest = (t > end * (1 + _TIME_TOLERANCE))[..., None]
    return Reference(q, *(np.where(rest, 0.0, rate) for rate in (v, a))) if rest.any() else Reference(q, v, a)


def _check_robot(robot: Any) -> None:
    """Check that a robot is a `MobileRobot`."""
    if not isinstance(getattr(robot, "mounts", None), tuple):
        raise unexpected_value("robot", robot, "a MobileRobot")


def _check_base(base: Trajectory) -> None:
    """Check that a base is a trajectory of x, y and psi."""
    refuse_path("base", base)
    is_valid = isinstance(base, Trajectory) and not isinstance(base, type)
    start = base(0.0) if is_valid else None
    if start is None or not hasattr(start, "q"):  # a path has a duration and can be called, too
        raise unexpected_value("base", base, "a trajectory of x, y and psi, such as Tangent(path)")
    positive("base.duration", base.duration, "s")
    shaped("base(0).q", start.q, (3,), words=": x, y and psi")


def _check_arm_path(robot: Any, k: int, path: Path | None, duration: float) -> Path:
    """Return a path of an arm after a check; None becomes a constant posture."""
    mount = robot.mounts[k]
    size = mount.v.stop - mount.v.start
    if path is None:
        return Hold(robot.rest[mount.q], duration)
    given = None if isinstance(path, type) else path
    instance(f"joints[{k}]", given, Path, f"a path of {size} coordinates, or None")
    point, words = finite(f"joints[{k}](0)", path(0.0)), f", one coordinate per joint of {mount.name!r}"
    shaped(f"joints[{k}](0)", point, (size,), words=words)
    positive(f"joints[{k}].duration", path.duration, "s")
    return path


def _check_end(name: str, motion: Callable[[Array], Reference], end: float, longest: float) -> None:
    """Check that a part that ends before the others ends at rest."""
    speed = float(np.abs(motion(np.array(end)).v).max(initial=0.0))
    if longest > end * (1 + _TIME_TOLERANCE) and not speed <= _REST_TOLERANCE:
        raise InvalidArgument(
            f"{name} ends after {end:g} s of {longest:g} s while it moves at {speed:.3g}, expected an end "
            "at rest, or the same duration"
        )


_CELLS = 4
_LEVELS = 60
# Tolerance of jumps of the heading: rounding errors of a direction [rad], and of the velocity, relative.
_ANGLE_TOLERANCE = 1e-9
_ROUNDING = 1e-14
_RATE_TOLERANCE = 1e-6  # [rad/s]: smallest jump of the turn rate that causes a warning


@dataclass(frozen=True, eq=False)
class _Jump:
    """Jump of the heading at a knot or rest.

    Parameters
    ----------
    time : float
        Time of the jump [s].
    left, right : ndarray, shape (3,)
        Heading and its first two derivatives before and after the jump [rad, rad/s, rad/s^2].
    speed : float
        The smaller of the speeds on both sides [m/s].
    """

    time: float
    left: Array
    right: Array
    speed: float


class _Winding:
    """Heading along a path, unwrapped by a table, so that each time is evaluated independently.

    Between two times of the table the heading turns by less than 60 deg. Therefore the entry before a time
    determines the multiple of 2 pi of the arctangent.

    Parameters
    ----------
    hodograph : Hodograph
        Direction of motion.
    """

    def __init__(self, hodograph: Hodograph) -> None:
        legs = hodograph.legs
        nodes = _nodes(hodograph)
        u, _, _ = hodograph(nodes)
        first = np.searchsorted(nodes, [leg.start.time for leg in legs])
        ends = np.array([leg.end.series[0] for leg in legs])  # (L, 2)
        # The table contains the end of a leg and the start of the next one, at the same time.
        indices = np.append(first[1:], len(nodes))
        times = np.insert(nodes, indices, [leg.end.time for leg in legs])
        angles = np.insert(_angle(u), indices, _angle(ends))
        joints = indices[:-1] + np.arange(len(legs) - 1)  # all ends except the last
        steps = -np.round(np.diff(angles) / (2 * np.pi))
        jumps = np.diff(angles)[joints] + 2 * np.pi * steps[joints]
        # A half turn goes to the left, even if rounding errors turn it to the right.
        is_right = jumps < _ANGLE_TOLERANCE - np.pi
        steps[joints[is_right]] += 1
        jumps[is_right] += 2 * np.pi
        turns = np.cumsum(np.append(float(angles[0] <= LEAST_ANGLE), steps))
        self._times, self._psi = times, angles + 2 * np.pi * turns
        self.jumps = tuple(
            _jump(legs[i], legs[i + 1], self._psi[joints[i]], self._psi[joints[i] + 1])
            for i in np.flatnonzero(np.abs(jumps) > _jump_tolerance(hodograph))
        )

    def unwrap(self, t: Array, angle: Array) -> Array:
        """Return the heading [rad] at `t` [s] from its value in [-pi, pi], `angle`; all of shape (...)."""
        nearby = self._psi[np.searchsorted(self._times, t, side="right") - 1]
        return np.asarray(angle + 2 * np.pi * np.round((nearby - angle) / (2 * np.pi)))


def _nodes(hodograph: Hodograph) -> Array:
    """Return the times of the table [s]."""
    cells = np.concatenate([_first_cells(leg) for leg in hodograph.legs])
    done, left = halve(hodograph, cells, _LEVELS)
    return np.sort(np.append(done[:, 0], left[:, 0]))


def _first_cells(leg: Leg) -> Array:
    """Return the cells of a leg before they are halved, shape (m, 2) [s]."""
    start, end = leg.start.time, leg.end.time
    # A series has another scale of u: cells end where it begins.
    first = min(start + max(leg.start.window, 0.0), end)
    last = max(end - max(leg.end.window, 0.0), first)
    edges = np.unique([start, *np.linspace(first, last, _CELLS + 1), end])
    return np.stack([edges[:-1], edges[1:]], axis=-1)


def _jump(leg: Leg, next_leg: Leg, psi_left: float, psi_right: float) -> _Jump:
    """Return the jump between two legs."""
    left, right, speed = leg.end, next_leg.start, min(leg.end.speed, next_leg.start.speed)
    return _Jump(right.time, _derivatives(left, psi_left), _derivatives(right, psi_right), speed)


def _derivatives(limit: DirectionLimit, psi: float) -> Array:
    """Return heading, turn rate and angular acceleration at an end of a leg, shape (3,)."""
    u, du, half = np.concatenate([limit.series, np.zeros((2, 2))])[:3]
    _, rate, acceleration = heading(u, du, 2 * half)
    return np.array([psi, rate, acceleration])


def _jump_tolerance(hodograph: Hodograph) -> Array:
    """Return the tolerance of the heading's jump at each end of a leg, shape (L - 1,) [rad]."""
    limits = ((leg.end, next_leg.start) for leg, next_leg in pairwise(hodograph.legs))
    speeds = [min(limit.speed or hodograph.max_speed for limit in pair) for pair in limits]
    return np.asarray(_ANGLE_TOLERANCE + _ROUNDING * hodograph.max_speed / np.array(speeds))


def _angle(u: Array) -> Array:
    """Return the angle of vectors, shape (...) [rad]."""
    return np.asarray(np.arctan2(u[..., 1], u[..., 0]))


@part
class FixedHeading(Value):
    """Trajectory along a path with a constant heading, for an omnidirectional robot.

    Parameters
    ----------
    path : Path
        Path of two coordinates.
    psi : float
        Constant heading [rad].

    Raises
    ------
    InvalidArgument
        If the path is not a path in the plane, or `psi` is not finite.

    See Also
    --------
    Tangent : heading along the path
    Hold : constant position

    Examples
    --------
    >>> from pinmobile import Circle, FixedHeading
    >>> circle = Circle(radius=3.0, rate=0.1, duration=20.0)
    >>> sideways = FixedHeading(circle, psi=1.57)
    >>> sideways(0.0).v  # [m/s, m/s, rad/s]
    array([0.3, 0. , 0. ])
    """

    path: Any = child(Path, doc="path of two coordinates")
    psi: float = number(unit="rad", doc="constant heading")

    def check(self) -> None:
        """Raise `InvalidArgument` if the path is not a path in the plane."""
        check_plane_path(self.path)

    @property
    def duration(self) -> float:
        """Duration of the path [s]."""
        return float(self.path.duration)

    def __call__(self, t: ArrayLike) -> Reference:
        """Return the reference.

        Parameters
        ----------
        t : array_like, shape (...)
            Times, 0 <= t <= duration [s].

        Returns
        -------
        reference : Reference
            Arrays of shape (..., 3); the derivatives of the heading are zero.

        Raises
        ------
        InvalidArgument
            If a time lies outside.
        """
        times = within("t", t, self.duration)
        zeros = np.zeros(times.shape)
        return join_heading(
            (self.path.derivative(times, order) for order in range(3)), (zeros + self.psi, zeros, zeros)
        )


@part
class LectureHeading(Value):
    """Trajectory along a path with the lecture's desired heading; `Tangent` has the correct one.

    ::

        psi       = wrapTo2Pi(atan2(y', x'))                            in [0, 2 pi)
        psi_dot   = (y''/x' - y' x''/x'^2) / (y'^2/x'^2 + 1)
        psi_ddot  = 0

    The heading jumps by a whole turn where it passes zero. It also jumps where the path rests, because
    atan2(0, 0) = 0 and the rate is 0 there. The angular acceleration is missing everywhere. The lecture does
    not compute the heading error on the circle either; `controllers.planar_difference` does.

    A speed below 1e-12 of the path's largest speed is a rounding error, which differs between machines: the
    path rests there. A y' of this size does not turn the heading of a path along x from 0 to a whole turn.
    Where only x' vanishes, the rate is the limit of the formula, independent of rounding errors of x'. The
    lecture's script returns this limit or 0, depending on the rounding of its linear solver.

    Parameters
    ----------
    path : Path
        Path of two coordinates.

    Raises
    ------
    InvalidArgument
        If the path is not a path in the plane.

    See Also
    --------
    Tangent : correct heading along the path
    controllers.plain_difference : the lecture's error of the heading

    Examples
    --------
    >>> from pinmobile import Circle, Tangent
    >>> from pinmobile.trajectories import LectureHeading
    >>> circle = Circle(radius=3.0, rate=1.0, duration=7.0)
    >>> for motion in Tangent(circle), LectureHeading(circle):
    ...     print(f"{motion(6.5).q[2]:.2f} rad")
    6.50 rad
    0.22 rad
    """

    on_circle: ClassVar[bool] = False  # an additional turn is an error of 2 pi: `plain_difference`

    path: Any = child(Path, doc="path of two coordinates")

    def check(self) -> None:
        """Raise `InvalidArgument` if the path is not a path in the plane."""
        check_plane_path(self.path)
        self._speed_tolerance  # noqa: B018

    @cached_property
    def _speed_tolerance(self) -> float:
        """Speed below which the path rests [m/s]."""
        return STANDSTILL * float(max_lengths(self.path, 1).max())

    @property
    def duration(self) -> float:
        """Duration of the path [s]."""
        return float(self.path.duration)

    def __call__(self, t: ArrayLike) -> Reference:
        """Return the reference.

        Parameters
        ----------
        t : array_like, shape (...)
            Times, 0 <= t <= duration [s].

        Returns
        -------
        reference : Reference
            Arrays of shape (..., 3).

        Raises
        ------
        InvalidArgument
            If a time lies outside.
        """
        times = within("t", t, self.duration)
        position, velocity, acceleration = (self.path.derivative(times, order) for order in range(3))
        x_dot, y_dot = np.moveaxis(velocity, -1, 0)
        speed = np.hypot(x_dot, y_dot)
        is_still = speed < self._speed_tolerance
        is_along_x = (x_dot > self._speed_tolerance) & (y_dot < 0) & (y_dot > -self._speed_tolerance)
        psi = np.where(is_still | is_along_x, 0.0, np.mod(np.arctan2(y_dot, x_dot), 2 * np.pi))
        # Extended by x'^2, the formula does not divide by x'. Two steps, because squares may underflow.
        speed = np.where(is_still, 1.0, speed)
        cos, sin = x_dot / speed, y_dot / speed
        rate = np.where(is_still, 0.0, (cos * acceleration[..., 1] - sin * acceleration[..., 0]) / speed)
        return join_heading((position, velocity, acceleration), (psi, rate, np.zeros_like(rate)))


class _TurnsOnTheSpot:
    """Time of a trajectory that stops on its path at some times to turn on the spot.

    Parameters
    ----------
    jumps : sequence of Jump, length m
        Jumps of the heading, in order.
    turn_time : float
        Duration of each turn [s].
    path_duration : float
        Duration of the path [s].

    Attributes
    ----------
    starts : ndarray, shape (m,)
        Start times of the turns in the trajectory [s].
    duration : float
        Duration of the trajectory [s].
    """

    def __init__(self, jumps: Sequence[_Jump], turn_time: float, path_duration: float) -> None:
        self._turn_time = turn_time
        times = np.array([jump.time for jump in jumps])
        self.starts = times + turn_time * np.arange(len(jumps))
        self.duration = path_duration + turn_time * len(jumps)
        self._ends = self.starts + turn_time
        # The path's time at which a turn starts belongs to the part after the turn.
        self._first = np.append(0.0, times)
        self._last = np.append(np.nextafter(times, 0.0), path_duration)
        # Coefficients in powers of the elapsed fraction of the turn time, the constant first.
        self._quintics = np.array([_quintic(j.left, j.right, turn_time) for j in jumps]).reshape(-1, 6).T

    def path_times(self, t: Array) -> Array:
        """Return the time on the path, shape (...) [s], at the trajectory's time `t`, shape (...) [s]."""
        if not len(self.starts):
            return t
        count = np.searchsorted(self.starts, t, side="right")
        s = t - self._turn_time * count
        return np.asarray(np.minimum(np.maximum(s, self._first[count]), self._last[count]))

    def insert_turns(self, t: Array, reference: Reference) -> Reference:
        """Return the reference with the turns inserted.

        Parameters
        ----------
        t : ndarray, shape (...)
            Times of the trajectory [s].
        reference : Reference
            Reference of the path with stops, arrays of shape (..., 3); overwritten.
        """
        if not len(self.starts):
            return reference
        turn = np.searchsorted(self.starts, t, side="right") - 1
        is_turn = (turn >= 0) & (t < self._ends[turn])
        turn = turn[is_turn]
        share = (t[is_turn] - self.starts[turn]) / self._turn_time
        psi, rate, half = np.zeros((3, *share.shape))
        for coefficients in self._quintics[::-1]:
            half = half * share + rate
            rate = rate * share + psi
            psi = psi * share + coefficients[turn]
        reference.v[is_turn] = 0.0
        reference.a[is_turn] = 0.0
        reference.q[is_turn, 2] = psi
        reference.v[is_turn, 2] = rate / self._turn_time
        reference.a[is_turn, 2] = 2 * half / self._turn_time**2
        return reference


def _quintic(start: Array, end: Array, duration: float) -> Array:
    """Return the quintic between two triples of heading and derivatives, by the elapsed fraction."""
    scale = np.array([1.0, duration, duration**2])
    (p, v, a), (p1, v1, a1) = start * scale, end * scale
    d = p1 - p
    return np.array(
        [
            p,
            v,
            a / 2,
            10 * d - 6 * v - 4 * v1 - (3 * a - a1) / 2,
            -15 * d + 8 * v + 7 * v1 + (3 * a - 2 * a1) / 2,
            6 * d - 3 * (v + v1) - (a - a1) / 2,
        ]
    )


@part
class Tangent(Value):
    """Trajectory along a path with its tangent as heading (lecture, section 5.4, and its errata).

    ::

        psi      = atan2(y', x'), unwrapped from (-pi, pi] at the start
        psi_dot  = (x' y'' - y' x'') / (x'^2 + y'^2),   psi_ddot its derivative

    Where the path rests, these are the exact limits from the right, at its end from the left. If the tangent
    jumps at a rest, the path stops for `turn_time` while the heading turns on the spot, by the shorter way, a
    half turn to the left: by the quintic that meets psi, psi_dot and psi_ddot on both sides. The trajectory
    lasts longer than the path by these turns. While the path stays in one place, the heading is constant.

    Parameters
    ----------
    path : Path
        Path of two coordinates, with derivatives of order 0 to 3, and higher ones where it rests.
    turn_time : float, optional
        Duration of each turn on the spot, > 0 [s]. Without it, a path that needs such turns raises an error.

    Warns
    -----
    LimitWarning
        If the turn rate jumps where the path rests, which would need an infinite moment.

    Raises
    ------
    InvalidArgument
        If the path is not a path in the plane, never moves, has a corner without a rest, or needs
        `turn_time`.

    See Also
    --------
    FixedHeading : constant heading
    WholeBody : trajectory of base and arms
    trajectories.LectureHeading : the lecture's heading

    Examples
    --------
    >>> from pinmobile import Circle, Tangent
    >>> motion = Tangent(Circle(radius=3.0, rate=0.1, duration=20.0))
    >>> motion(10.0).q.round(2)  # [m, m, rad]
    array([2.52, 1.38, 1.  ])
    >>> motion(10.0).v[2]  # [rad/s]
    np.float64(0.1)
    """

    path: Any = child(Path, doc="path of two coordinates")
    turn_time: float | None = number(default=None, above=0, unit="s", doc="duration of each turn on the spot")

    def check(self) -> None:
        """Raise `InvalidArgument` if the path has no tangent, or needs a time for turns on the spot."""
        check_plane_path(self.path)
        for jump in self._winding.jumps:
            _check_jump(jump, self.turn_time)
        _report_rates(self._hodograph, {jump.time for jump in self._winding.jumps})

    @property
    def turns(self) -> Array:
        """Start times of the turns on the spot in the trajectory, shape (m,) [s]."""
        return frozen(self._stops.starts)

    @cached_property
    def _hodograph(self) -> Hodograph:
        return hodograph(self.path)

    @cached_property
    def _winding(self) -> _Winding:
        return _Winding(self._hodograph)

    @cached_property
    def _stops(self) -> _TurnsOnTheSpot:
        return _TurnsOnTheSpot(self._winding.jumps, self.turn_time or 0.0, float(self.path.duration))

    @property
    def duration(self) -> float:
        """Duration of the path plus all turns on the spot [s]."""
        return self._stops.duration

    def __call__(self, t: ArrayLike) -> Reference:
        """Return the reference.

        Parameters
        ----------
        t : array_like, shape (...)
            Times, 0 <= t <= duration [s].

        Returns
        -------
        reference : Reference
            Arrays of shape (..., 3).

        Raises
        ------
        InvalidArgument
            If a time lies outside.
        """
        clock = within("t", t, self.duration)
        s = self._stops.path_times(clock)
        position, v, a, jerk = (np.asarray(self.path.derivative(s, order)) for order in range(4))
        angle, rate, acceleration = heading(*self._hodograph.from_derivatives(s, v, a, jerk))
        headings = (self._winding.unwrap(s, angle), rate, acceleration)
        return self._stops.insert_turns(clock, join_heading((position, v, a), headings))


def _check_jump(jump: _Jump, turn_time: float | None) -> None:
    """Check that a jump of the heading is at a rest, and that there is a time for it."""
    left, right = np.degrees([jump.left[0], jump.right[0]])
    if jump.speed:
        raise InvalidArgument(
            f"path has a corner at t = {jump.time} s, from {left:.6g} deg to {right:.6g} deg, passed at "
            f"{jump.speed:.6g} m/s; expected no corner, or a rest at the corner"
        )
    words = f"the path rests at t = {jump.time} s and its direction jumps there"
    required("turn_time", turn_time, f"> 0 s: {words}, from {left:.6g} deg to {right:.6g} deg")


def _report_rates(direction: Hodograph, turns: set[float]) -> None:
    """Warn about the first rest, except for turns on the spot, at which the turn rate jumps."""
    for leg, next_leg in pairwise(direction.legs):
        left, right = (float(_derivatives(limit, 0.0)[1]) + 0.0 for limit in (leg.end, next_leg.start))
        is_rest = not min(leg.end.speed, next_leg.start.speed) and next_leg.start.time not in turns
        if is_rest and abs(right - left) > _RATE_TOLERANCE:
            warn(
                f"the turn rate jumps from {left:.4g} to {right:.4g} rad/s at t = {next_leg.start.time:g} s, "
                "where the path rests; this would need an infinite moment: use a path with a straight end",
                LimitWarning,
                stacklevel=5,
            )
            return
