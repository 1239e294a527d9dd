"""Trajectories: a path and a heading, or base and arms as one, within the limits of joints."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple, Protocol, runtime_checkable
from warnings import warn

import numpy as np

from pinmobile.arrays import LEAST_ANGLE, Array, ArrayLike, finite, frozen, instance, positive, shaped
from pinmobile.errors import InvalidArgument, LimitWarning, shown
from pinmobile.parts import Following, child, children, number, option, part
from pinmobile.paths import Hold, Path, Value, checked_path, pieces_of, within
from pinmobile.plant import refuse_path
from pinmobile.trajectories.direction import (
    STANDSTILL,
    DirectionLimit,
    Hodograph,
    Leg,
    halve,
    heading,
    hodograph,
    largest,
)


class Reference(NamedTuple):
    """Where to be and how to move, at one time or at many.

    Attributes
    ----------
    q : ndarray, shape (..., nq)
        (x, y, psi) and, where there are arms, their configurations [m, m, rad, ...].
    v, a : ndarray, shape (..., nv)
        Velocity and acceleration [per s; per s^2]; of (x, y, psi) the two derivatives.
    """

    q: Array
    v: Array
    a: Array


@runtime_checkable
class Trajectory(Protocol):
    """A reference as a function of time, 0 <= t <= duration."""

    @property
    def duration(self) -> float:
        """Time from start to end [s]."""
        ...

    def __call__(self, t: ArrayLike, /) -> Reference:
        """Return the reference at the times `t`, shape (...) [s]."""
        ...


def joined(plane: Iterable[Array], headings: Iterable[Array]) -> Reference:
    """Return a reference made of a motion in the plane and one of the heading.

    Parameters
    ----------
    plane : iterable of three ndarray, shape (..., 2)
        Position, velocity and acceleration [m, m/s, m/s^2].
    headings : iterable of three ndarray, shape (...)
        psi and its two derivatives [rad, rad/s, rad/s^2].
    """
    return Reference(*(np.append(xy, psi[..., None], -1) for xy, psi in zip(plane, headings, strict=True)))


def plane_path(path: object) -> Path:
    """Check that `path` is a path of two coordinates, and return it.

    Raises
    ------
    InvalidArgument
        If it is not.
    """
    plane = checked_path(path, 2)
    duration = positive("path.duration", plane.duration, "s")
    ends = [(float(piece.start), float(piece.end)) for piece in pieces_of(plane)]
    times = [0.0, *(end for _, end in ends)]
    if [start for start, _ in ends] != times[:-1] or times != sorted(set(times)) or times[-1] != duration:
        raise InvalidArgument(
            f"path.pieces has (start, end) {ends}, expected end to end from 0 to {duration}"
        )
    return plane


_SLACK = 1e-9  # [m, rad], of velocities relative: a path that ends at a limit comes there but for rounding


def check_limits(robot: Any, q: Array, v: Array, t: Array | None = None) -> None:
    """Refuse configurations and velocities outside the joint limits of a robot.

    Parameters
    ----------
    robot : MobileRobot
        Whose `lower`, `upper` and `velocity_limit` are meant.
    q : ndarray, shape (..., n), n <= nq
        Configurations, or their first numbers.
    v : ndarray, shape (..., m), m <= nv
        Velocities, or their first numbers.
    t : ndarray, shape (...), optional
        Their times where they are a reference, for the message [s]; without, they are a start (q0, v0).

    Raises
    ------
    InvalidArgument
        If one is outside; the message names the joint, its value and limits, and the time.
    """
    n, most = q.shape[-1], robot.velocity_limit[: v.shape[-1]]
    places = "q0", "has", q, robot.lower[:n], robot.upper[:n], _SLACK, ""
    rates = "v0", "moves", v, -most, most, _SLACK * most, "/s"
    for start, verb, values, least, highest, slack, per in (places, rates):
        outside = (values < least - slack) | (values > highest + slack)
        if outside.any():
            *where, k = (int(i) for i in np.argwhere(outside)[0])
            name, unit = robot.coordinates[k][:2]
            whose, when = (start, "") if t is None else ("reference", f" at t = {t[tuple(where)]:g} s")
            room = f"at most {highest[k]:.9g}" if per else f"{least[k]:.9g} to {highest[k]:.9g}"
            raise InvalidArgument(
                f"{whose} {verb} joint {name!r} at {values[(*where, k)]:.9g} {unit}{per}{when}, "
                f"expected {room} {unit}{per}"
            )


_SAME = 1e-9  # relative difference of two durations that are meant to be one
_STANDSTILL = 1e-9  # [m/s, rad/s]: the rounding of what ends at rest
_PROBES = 33  # per analytic piece of a path, its ends included


@part
class WholeBody(Value):
    """A trajectory of the base beside one path per arm, on one clock.

    The coordinates of an arm's path are its joints' angles [rad] and ways [m]. Any path of that many
    coordinates will do: `CubicVia` and `Spline` through postures, `Hold`, `RestToRest`.

    It lasts as long as the longest of them. What ends before that must end at rest, and is held there.

    Parameters
    ----------
    robot : MobileRobot
        Whose base and arms these are. No reference leaves its joint limits, or moves faster than they allow.
    base : trajectory
        Of x, y and psi, such as `Tangent` or `FixedHeading`.
    *joints : Path or None
        One per arm, in the order of ``robot.mounts``; None holds the arm's reference posture.

    Raises
    ------
    InvalidArgument
        If `robot`, `base` or a path is something else; there are more or fewer paths than arms; one has
        other coordinates than its arm, leaves the joint limits of position or velocity, or ends before the
        others while it moves.
    """

    robot: Any = option(doc="robot whose base and arms move")
    base: Any = child(Following, doc="trajectory of x, y and psi")
    joints: Any = children(Path, doc="paths of the arms")

    def __init__(self, robot: Any, base: Any, *paths: Path | None, joints: Sequence[Path] = ()) -> None:
        _check_robot(robot)
        _check_base(base)
        given = paths or joints
        if len(given) != len(robot.mounts):
            raise InvalidArgument(
                f"joints has {len(given)} paths, expected {len(robot.mounts)}, one per arm of the robot"
            )
        made = [_checked(robot, k, path, float(base.duration)) for k, path in enumerate(given)]
        self.__attrs_init__(robot, base, made)  # type: ignore[attr-defined]

    def check(self) -> None:
        """Raise `InvalidArgument` where a part ends while it moves, or leaves the joint limits."""
        for name, (motion, end) in self._parts().items():
            _check_end(name, motion, end, self.duration)
        # What leaves the limits between these times is refused when it is asked for.
        for path in self.joints:
            self(np.concatenate([np.linspace(p.start, p.end, _PROBES) for p in pieces_of(path)]))

    @property
    def duration(self) -> float:
        """That of the longest part [s]."""
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
            q of shape (..., nq), v and a of shape (..., nv), in the robot's own order.

        Raises
        ------
        InvalidArgument
            If a time is outside, or the reference leaves the joint limits; the message names the joint.
        """
        times = within("t", t, self.duration)
        parts = [_held(motion, end, times) for motion, end in self._parts().values()]
        q, v, a = (np.concatenate(arrays, axis=-1) for arrays in zip(*parts, strict=True))
        check_limits(self.robot, q, v, times)
        return Reference(q, v, a)

    def _parts(self) -> dict[str, tuple[Callable[[Array], Reference], float]]:
        paths = {f"joints[{k}]": (partial(_along, p), float(p.duration)) for k, p in enumerate(self.joints)}
        return {"base": (self.base, float(self.base.duration)), **paths}


def _along(path: Path, t: Array) -> Reference:
    return Reference(*(path.derivative(t, order) for order in range(3)))


def _held(motion: Callable[[Array], Reference], end: float, t: Array) -> Reference:
    """Return a motion at the times `t`, after its end at rest where it ended."""
    q, v, a = motion(np.minimum(t, end))
    over = (t > end * (1 + _SAME))[..., None]
    return Reference(q, *(np.where(over, 0.0, rate) for rate in (v, a))) if over.any() else Reference(q, v, a)


def _check_robot(robot: Any) -> None:
    if not isinstance(getattr(robot, "mounts", None), tuple):
        raise InvalidArgument(f"robot is {shown(robot)}, expected a MobileRobot")


def _check_base(base: Trajectory) -> None:
    refuse_path("base", base)
    known = isinstance(base, Trajectory) and not isinstance(base, type)
    start = base(0.0) if known else None
    if start is None or not hasattr(start, "q"):  # a path has a duration and can be called, too
        raise InvalidArgument(
            f"base is {shown(base)}, expected a trajectory of x, y and psi, such as Tangent(path)"
        )
    positive("base.duration", base.duration, "s")
    shaped("base(0).q", start.q, (3,), words=": x, y and psi")


def _checked(robot: Any, k: int, path: Path | None, duration: float) -> Path:
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
    speed = float(np.abs(motion(np.array(end)).v).max(initial=0.0))
    if longest > end * (1 + _SAME) and not speed <= _STANDSTILL:
        raise InvalidArgument(
            f"{name} ends after {end:g} s of {longest:g} s while it moves at {speed:.3g}, expected it to "
            "end at rest or last as long"
        )


_CELLS = 4
_LEVELS = 60
# A jump below this is rounding of a direction; what rounding the velocity adds comes on top.
_STRAIGHT = 1e-9
_ROUNDING = 1e-14
_LEAST_RATE = 1e-6  # [rad/s], of a jump that is reported


@dataclass(frozen=True, eq=False)
class _Jump:
    """A jump of the heading at a knot or rest.

    Parameters
    ----------
    time : float
        When [s].
    before, after : ndarray, shape (3,)
        The heading and its first two derivatives on both sides [rad, rad/s, rad/s^2].
    speed : float
        The smaller of the speeds on both sides [m/s].
    """

    time: float
    before: Array
    after: Array
    speed: float


class _Winding:
    """The heading along a path, unwrapped from a table made once: no time asked for matters to another.

    Between two times of the table the heading turns by less than 60 deg, so that the entry before a
    time tells which multiple of 2 pi belongs to the arctangent there.

    Parameters
    ----------
    hodograph : Hodograph
        The direction of motion.
    """

    def __init__(self, hodograph: Hodograph) -> None:
        legs = hodograph.legs
        nodes = _nodes(hodograph)
        u, _, _ = hodograph(nodes)
        first = np.searchsorted(nodes, [leg.head.time for leg in legs])
        ends = np.array([leg.tail.series[0] for leg in legs])  # (L, 2)
        # The end of a leg stands in the table beside the start of the next one, at the same time.
        behind = np.append(first[1:], len(nodes))
        times = np.insert(nodes, behind, [leg.tail.time for leg in legs])
        angles = np.insert(_angle(u), behind, _angle(ends))
        joints = behind[:-1] + np.arange(len(legs) - 1)  # the ends but the last
        steps = -np.round(np.diff(angles) / (2 * np.pi))
        jumps = np.diff(angles)[joints] + 2 * np.pi * steps[joints]
        # A half turn goes to the left, also where rounding has made it one to the right.
        to_the_right = jumps < _STRAIGHT - np.pi
        steps[joints[to_the_right]] += 1
        jumps[to_the_right] += 2 * np.pi
        rounds = np.cumsum(np.append(float(angles[0] <= LEAST_ANGLE), steps))
        self._times, self._psi = times, angles + 2 * np.pi * rounds
        self.jumps = tuple(
            _jump(legs[i], legs[i + 1], self._psi[joints[i]], self._psi[joints[i] + 1])
            for i in np.flatnonzero(np.abs(jumps) > _slack(hodograph))
        )

    def unwrap(self, t: Array, angle: Array) -> Array:
        """Return the heading [rad] at `t` [s] from its value in [-pi, pi], `angle`; all of shape (...)."""
        nearby = self._psi[np.searchsorted(self._times, t, side="right") - 1]
        return np.asarray(angle + 2 * np.pi * np.round((nearby - angle) / (2 * np.pi)))


def _nodes(hodograph: Hodograph) -> Array:
    cells = np.concatenate([_first_cells(leg) for leg in hodograph.legs])
    done, left = halve(hodograph, cells, _LEVELS)
    return np.sort(np.append(done[:, 0], left[:, 0]))


def _first_cells(leg: Leg) -> Array:
    start, end = leg.head.time, leg.tail.time
    # Where a series takes over u changes its scale: cells end there.
    first = min(start + max(leg.head.window, 0.0), end)
    last = max(end - max(leg.tail.window, 0.0), first)
    edges = np.unique([start, *np.linspace(first, last, _CELLS + 1), end])
    return np.stack([edges[:-1], edges[1:]], axis=-1)


def _jump(before: Leg, after: Leg, psi_before: float, psi_after: float) -> _Jump:
    left, right = before.tail, after.head
    return _Jump(
        right.time,
        _derivatives(left, psi_before),
        _derivatives(right, psi_after),
        min(left.speed, right.speed),
    )


def _derivatives(limit: DirectionLimit, psi: float) -> Array:
    u, du, half = np.concatenate([limit.series, np.zeros((2, 2))])[:3]
    _, rate, acceleration = heading(u, du, 2 * half)
    return np.array([psi, rate, acceleration])


def _slack(hodograph: Hodograph) -> Array:
    limits = ((before.tail, after.head) for before, after in pairwise(hodograph.legs))
    slowest = [min(limit.speed or hodograph.top for limit in pair) for pair in limits]
    return np.asarray(_STRAIGHT + _ROUNDING * hodograph.top / np.array(slowest))


def _angle(u: Array) -> Array:
    return np.asarray(np.arctan2(u[..., 1], u[..., 0]))


@part
class FixedHeading(Value):
    """Along a path with one heading throughout: a holonomic robot can."""

    path: Any = child(Path, doc="path of two coordinates")
    psi: float = number(unit="rad", doc="heading that is held")

    def check(self) -> None:
        """Raise `InvalidArgument` where the path is none in the plane."""
        plane_path(self.path)

    @property
    def duration(self) -> float:
        """The path's duration [s]."""
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
            Arrays of shape (..., 3); the heading's derivatives are zero.

        Raises
        ------
        InvalidArgument
            If a time is outside.
        """
        times = within("t", t, self.duration)
        still = np.zeros(times.shape)
        return joined(
            (self.path.derivative(times, order) for order in range(3)), (still + self.psi, still, still)
        )


@part
class LectureHeading(Value):
    """Along a path with the lecture's desired heading; `Tangent` has it right.

        psi       = wrapTo2Pi(atan2(y', x'))                            in [0, 2 pi)
        psi_dot   = (y''/x' - y' x''/x'^2) / (y'^2/x'^2 + 1)
        psi_ddot  = 0

    So the heading jumps by a whole turn where it passes zero, and by whatever it takes where the path
    rests, for which atan2(0, 0) = 0 and the rate is 0; the acceleration is lost everywhere. The error on the
    circle that `planar_difference` takes was not the lecture's either.

    Below 1e-12 of the path's largest speed a speed is rounding, which differs from machine to machine: the
    path rests there, and a y' of that size does not turn the heading of a path that runs along x from 0 to a
    whole turn. Where x' alone vanishes the rate is the formula's limit, whatever is left of x'; the lecture's
    script has that or 0 there, as the rounding of its linear solver falls.
    """

    on_circle: ClassVar[bool] = False  # a turn too many is an error of 2 pi: `plain_difference`

    path: Any = child(Path, doc="path of two coordinates")

    def check(self) -> None:
        """Raise `InvalidArgument` where the path is none in the plane."""
        plane_path(self.path)
        self._still  # noqa: B018

    @cached_property
    def _still(self) -> float:
        return STANDSTILL * float(largest(self.path, 1).max())

    @property
    def duration(self) -> float:
        """The path's duration [s]."""
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
            If a time is outside.
        """
        times = within("t", t, self.duration)
        position, velocity, acceleration = (self.path.derivative(times, order) for order in range(3))
        x_dot, y_dot = np.moveaxis(velocity, -1, 0)
        speed = np.hypot(x_dot, y_dot)
        still = speed < self._still
        along_x = (x_dot > self._still) & (y_dot < 0) & (y_dot > -self._still)
        psi = np.where(still | along_x, 0.0, np.mod(np.arctan2(y_dot, x_dot), 2 * np.pi))
        # By x'^2 above and below, the formula needs no x'. In two steps, because squares may underflow.
        speed = np.where(still, 1.0, speed)
        cos, sin = x_dot / speed, y_dot / speed
        rate = np.where(still, 0.0, (cos * acceleration[..., 1] - sin * acceleration[..., 0]) / speed)
        return joined((position, velocity, acceleration), (psi, rate, np.zeros_like(rate)))


class _TurnsOnTheSpot:
    """The clock of a trajectory that holds its path at some times to turn.

    Parameters
    ----------
    jumps : sequence of Jump, length m
        Where the heading jumps, in order.
    turn_time : float
        How long each turn lasts [s].
    path_duration : float
        Duration of the path [s].

    Attributes
    ----------
    starts : ndarray, shape (m,)
        When the turns start, on the trajectory's clock [s].
    duration : float
        Duration of the trajectory [s].
    """

    def __init__(self, jumps: Sequence[_Jump], turn_time: float, path_duration: float) -> None:
        self._turn_time = turn_time
        held = np.array([jump.time for jump in jumps])
        self.starts = held + turn_time * np.arange(len(jumps))
        self.duration = path_duration + turn_time * len(jumps)
        self._ends = self.starts + turn_time
        # Of the path's times between turns the one at which the next turn starts belongs to what follows.
        self._first = np.append(0.0, held)
        self._last = np.append(np.nextafter(held, 0.0), path_duration)
        # In powers of the part of the turn time that has passed, the constant first.
        self._quintics = np.array([_quintic(j.before, j.after, turn_time) for j in jumps]).reshape(-1, 6).T

    def path_times(self, t: Array) -> Array:
        """Return the time of the path, shape (...) [s], at the trajectory's `t`, shape (...) [s]."""
        if not len(self.starts):
            return t
        begun = np.searchsorted(self.starts, t, side="right")
        s = t - self._turn_time * begun
        return np.asarray(np.minimum(np.maximum(s, self._first[begun]), self._last[begun]))

    def filled(self, t: Array, reference: Reference) -> Reference:
        """Return the reference with the turns in their place.

        Parameters
        ----------
        t : ndarray, shape (...)
            Times of the trajectory [s].
        reference : Reference
            That of the held path, arrays of shape (..., 3); written to.
        """
        if not len(self.starts):
            return reference
        turn = np.searchsorted(self.starts, t, side="right") - 1
        turning = (turn >= 0) & (t < self._ends[turn])
        turn = turn[turning]
        part = (t[turning] - self.starts[turn]) / self._turn_time
        psi, rate, half = np.zeros((3, *part.shape))
        for coefficients in self._quintics[::-1]:
            half = half * part + rate
            rate = rate * part + psi
            psi = psi * part + coefficients[turn]
        reference.v[turning] = 0.0
        reference.a[turning] = 0.0
        reference.q[turning, 2] = psi
        reference.v[turning, 2] = rate / self._turn_time
        reference.a[turning, 2] = 2 * half / self._turn_time**2
        return reference


def _quintic(before: Array, after: Array, duration: float) -> Array:
    scale = np.array([1.0, duration, duration**2])
    (p, v, a), (p1, v1, a1) = before * scale, after * scale
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
    """Along a path with the heading along its tangent (lecture, section 5.4, and its errata).

        psi      = atan2(y', x'), unwrapped from (-pi, pi] at the start
        psi_dot  = (x' y'' - y' x'') / (x'^2 + y'^2),   psi_ddot its derivative

    Where the path rests these are the limits from the right (at its end from the left), exactly. Where
    the tangent jumps at a rest the path is held for `turn_time` while the heading turns on the spot, by
    the shorter way, a half turn to the left: the quintic that meets psi, psi_dot and psi_ddot on both
    sides. The trajectory lasts longer than the path by these turns. While the path dwells the heading
    stays.

    Parameters
    ----------
    path : Path
        Derivatives of order 0 to 3 are asked for, higher ones where it rests.
    turn_time : float, optional
        Without it a path that needs a turn on the spot is refused.

    Warns
    -----
    LimitWarning
        If the turn rate jumps where the path rests, which no finite moment can follow.
    """

    path: Any = child(Path, doc="path of two coordinates")
    turn_time: float | None = number(default=None, above=0, unit="s", doc="time of each turn on the spot")

    def check(self) -> None:
        """Raise `InvalidArgument` where the path has no tangent, or needs turns without a time for them."""
        plane_path(self.path)
        for jump in self._winding.jumps:
            _check(jump, self.turn_time)
        _report_rates(self._hodograph, {jump.time for jump in self._winding.jumps})

    @property
    def turns(self) -> Array:
        """Times at which a turn on the spot begins, on the clock of the trajectory, shape (m,) [s]."""
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
        """The path's duration and that of all turns on the spot [s]."""
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
            If a time is outside.
        """
        clock = within("t", t, self.duration)
        s = self._stops.path_times(clock)
        position, v, a, jerk = (np.asarray(self.path.derivative(s, order)) for order in range(4))
        angle, rate, acceleration = heading(*self._hodograph.along(s, v, a, jerk))
        headings = (self._winding.unwrap(s, angle), rate, acceleration)
        return self._stops.filled(clock, joined((position, v, a), headings))


def _check(jump: _Jump, turn_time: float | None) -> None:
    before, after = np.degrees([jump.before[0], jump.after[0]])
    if jump.speed:
        raise InvalidArgument(
            f"path has a corner at t = {jump.time} s, from {before:.6g} deg to {after:.6g} deg, taken at "
            f"{jump.speed:.6g} m/s; expected no corner, or one that the path rests at"
        )
    if turn_time is None:
        raise InvalidArgument(
            f"turn_time is None, expected > 0 s: the path rests at t = {jump.time} s and its direction "
            f"jumps there, from {before:.6g} deg to {after:.6g} deg"
        )


def _report_rates(direction: Hodograph, turns: set[float]) -> None:
    """Warn of the first rest, but for turns on the spot, at which the turn rate jumps."""
    for before, after in pairwise(direction.legs):
        left, right = (float(_derivatives(limit, 0.0)[1]) + 0.0 for limit in (before.tail, after.head))
        at_rest = not min(before.tail.speed, after.head.speed) and after.head.time not in turns
        if at_rest and abs(right - left) > _LEAST_RATE:
            warn(
                f"the turn rate jumps from {left:.4g} to {right:.4g} rad/s at t = {after.head.time:g} s, "
                "where the path rests, and no finite moment follows that: let the path end straight ahead",
                LimitWarning,
                stacklevel=5,
            )
            return
