"""A motion of the base beside motions of its arms, as one reference."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, positive
from pinmobile.errors import InvalidArgument, shown
from pinmobile.paths import Hold, Path, pieces_of, within
from pinmobile.trajectories.limits import check_limits
from pinmobile.trajectories.reference import Reference, Trajectory

__all__ = ["WholeBody"]

_SAME = 1e-9  # relative difference of two durations that are meant to be one
_STANDSTILL = 1e-9  # [m/s, rad/s]: the rounding of what ends at rest
_PROBES = 33  # per analytic piece of a path, its ends included


@dataclass(frozen=True, init=False, repr=False)
class WholeBody:
    """A trajectory of the base beside one path per arm, on one clock.

    The coordinates of an arm's path are those of its joints in v: of each its angle [rad] or way [m], of one
    that is (cos, sin) in q too. Any path of that many coordinates will do: `CubicVia` and `Spline` through
    postures, `Hold`, `RestToRest`. Those of a configuration q are ``robot.difference(robot.neutral, q)[3:]``.

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
        others while it moves; or a joint turns about more than one axis, or turns and slides.
    """

    robot: Any
    base: Trajectory
    joints: tuple[Path, ...]
    duration: float = field(compare=False)

    def __init__(self, robot: Any, base: Trajectory, *joints: Path | None) -> None:
        _check_robot(robot)
        _check_base(base)
        if len(joints) != len(robot.mounts):
            raise InvalidArgument(
                f"joints has {len(joints)} paths, expected {len(robot.mounts)}, one per arm of the robot"
            )
        paths = tuple(_checked(robot, k, path, float(base.duration)) for k, path in enumerate(joints))
        longest = max([float(base.duration), *(float(path.duration) for path in paths)])
        for name, value in {"robot": robot, "base": base, "joints": paths, "duration": longest}.items():
            object.__setattr__(self, name, value)
        for name, (motion, end) in self._parts().items():
            _check_end(name, motion, end, longest)
        # What leaves the limits between these times is refused when it is asked for.
        for path in paths:
            self(np.concatenate([np.linspace(p.start, p.end, _PROBES) for p in pieces_of(path)]))

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
        moved, v, a = (np.concatenate(arrays, axis=-1) for arrays in zip(*parts, strict=True))
        simple = self.robot.nq == self.robot.nv
        q = moved if simple else self.robot.integrate(self.robot.neutral, moved)
        check_limits(self.robot, q, v, times)
        return Reference(q, v, a)

    def with_parameters(self) -> "WholeBody":
        """Return the motion made again of its parts, which have what may differ: it has no parameters."""
        return WholeBody(self.robot, self.base, *self.joints)

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
    model = robot.model
    for joint in range(1, model.njoints):
        # Slides along three axes add up as one does.
        if model.nvs[joint] > 1 and model.joints[joint].shortname() != "JointModelTranslation":
            raise InvalidArgument(
                f"robot has joint {model.names[joint]!r} with {model.nvs[joint]} velocities, expected joints "
                "of one, or slides: turns about several axes, or beside slides, are no coordinates of a path"
            )


def _check_base(base: Any) -> None:
    known = isinstance(base, Trajectory) and not isinstance(base, type)
    start: Any = base(0.0) if known else None
    if not hasattr(start, "q"):  # a path has a duration and can be called, too
        raise InvalidArgument(
            f"base is {shown(base)}, expected a trajectory of x, y and psi, such as Tangent(path)"
        )
    positive("base.duration", base.duration, "s")
    shape = np.shape(start.q)
    if shape != (3,):
        raise InvalidArgument(f"base has configurations of shape {shape}, expected (3,): x, y and psi")


def _checked(robot: Any, k: int, path: Any, duration: float) -> Path:
    mount = robot.mounts[k]
    size = mount.v.stop - mount.v.start
    if path is None:
        return Hold(robot.difference(robot.neutral, robot.rest)[mount.v], duration)
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
