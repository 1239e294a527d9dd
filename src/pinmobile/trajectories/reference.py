"""What a trajectory is and gives, within the limits of joints; and motions of base and arms as one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike, finite, positive
from pinmobile.errors import InvalidArgument, shown
from pinmobile.parts import Following, child, children, option, part
from pinmobile.paths import Hold, Path, Value, checked_path, pieces_of, within
from pinmobile.plant import refuse_path


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
    n, m = q.shape[-1], v.shape[-1]
    lower, upper, most = robot.lower[:n], robot.upper[:n], robot.velocity_limit[:m]
    outside = (q < lower - _SLACK) | (q > upper + _SLACK)
    if outside.any():
        where, column = _first(outside)
        name, unit = robot.coordinates[column][:2]
        raise InvalidArgument(
            f"{'q0' if t is None else 'reference'} has joint {name!r} at {q[where][column]:.9g} {unit}"
            f"{_when(t, where)}, expected {lower[column]:.9g} to {upper[column]:.9g} {unit}"
        )
    fast = np.abs(v) > most * (1 + _SLACK)
    if fast.any():
        where, column = _first(fast)
        name, unit = robot.coordinates[column][:2]
        raise InvalidArgument(
            f"{'v0' if t is None else 'reference'} moves joint {name!r} at {v[where][column]:.9g} {unit}/s"
            f"{_when(t, where)}, expected at most {most[column]:.9g} {unit}/s"
        )


def _when(t: Array | None, where: tuple[int, ...]) -> str:
    return "" if t is None else f" at t = {t[where]:g} s"


def _first(found: NDArray[np.bool_]) -> tuple[tuple[int, ...], int]:
    *row, column = (int(i) for i in np.argwhere(found)[0])
    return tuple(row), column


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
    shape = np.shape(start.q)
    if shape != (3,):
        raise InvalidArgument(f"base has configurations of shape {shape}, expected (3,): x, y and psi")


def _checked(robot: Any, k: int, path: Path | None, duration: float) -> Path:
    mount = robot.mounts[k]
    size = mount.v.stop - mount.v.start
    if path is None:
        return Hold(robot.rest[mount.q], duration)
    if isinstance(path, type) or not isinstance(path, Path):
        raise InvalidArgument(f"joints[{k}] is {shown(path)}, expected a path of {size} coordinates, or None")
    point = finite(f"joints[{k}](0)", path(0.0))
    if point.shape != (size,):
        raise InvalidArgument(
            f"joints[{k}] has points of shape {point.shape}, expected ({size},), "
            f"one coordinate per joint of {mount.name!r}"
        )
    positive(f"joints[{k}].duration", path.duration, "s")
    return path


def _check_end(name: str, motion: Callable[[Array], Reference], end: float, longest: float) -> None:
    speed = float(np.abs(motion(np.array(end)).v).max(initial=0.0))
    if longest > end * (1 + _SAME) and not speed <= _STANDSTILL:
        raise InvalidArgument(
            f"{name} ends after {end:g} s of {longest:g} s while it moves at {speed:.3g}, expected it to "
            "end at rest or last as long"
        )
