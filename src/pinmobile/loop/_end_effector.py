"""`EndEffector`: where a frame of a robot was, where it should have been, and how far off it was."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, frozen
from pinmobile.errors import InvalidArgument, shown
from pinmobile.plant import stated, whole_configurations
from pinmobile.reaching import error_sizes, pose_error, target_names
from pinmobile.signals import Signal

_BASE = 3


@dataclass(frozen=True, eq=False, repr=False)
class EndEffector:
    """A frame over the samples of a rollout; made by `Rollout.end_effector`.

    Attributes
    ----------
    frame : str
        Its name.
    t : ndarray, shape (N + 1,)
        Times [s].
    pose : ndarray, shape (N + 1, 4, 4)
        T_0_f, where it was.
    target : ndarray, shape (N + 1, 4, 4), or None
        Where it should have been; None where nothing says so.
    is_oriented : bool
        Whether the target says how it should stand too, not its position alone.
    """

    units: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("position", "position_error", "distance"), "m"),
        **{"t": "s", "orientation": "", "orientation_error": "rad", "angle": "rad"},
    }

    frame: str
    t: Array
    pose: Array
    target: Array | None = None
    is_oriented: bool = True

    def __post_init__(self) -> None:
        for name in ("t", "pose", "target"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, frozen(getattr(self, name)))

    def __repr__(self) -> str:
        return f"<EndEffector: {self}>"

    def __str__(self) -> str:
        if self.target is None:
            return f"{self.frame} over {self.t[-1]:g} s, without target"
        metres, radians = self.max_error()
        turn = f", {radians:.3e} rad" if self.is_oriented else ""
        return f"{self.frame} over {self.t[-1]:g} s, largest error {metres:.3e} m{turn}"

    @property
    def position(self) -> Array:
        """Of its origin, shape (N + 1, 3) [m]."""
        return self.pose[:, :3, 3]

    @property
    def orientation(self) -> Array:
        """R_0_f, shape (N + 1, 3, 3)."""
        return self.pose[:, :3, :3]

    @cached_property
    def error(self) -> Array:
        """From its pose to the target's along the inertial axes, shape (N + 1, 6) [m, rad].

        The last three are the rotation vector; NaN where the position alone is followed.

        Raises
        ------
        InvalidArgument
            If there is no target.
        """
        if self.target is None:
            raise InvalidArgument(
                f"end effector {self.frame!r} has no target, expected a run of EndEffectorTracking, of a "
                "trajectory that solve_inverse_kinematics gave, or of a reference with the arm's coordinates"
            )
        error = pose_error(self.target, self.pose)
        if not self.is_oriented:
            error[:, _BASE:] = np.nan
        return frozen(error)

    @property
    def position_error(self) -> Array:
        """Of its origin, shape (N + 1, 3) [m]; raises as `error`."""
        return self.error[:, :_BASE]

    @property
    def orientation_error(self) -> Array:
        """Rotation vector from how it stands to how it should, shape (N + 1, 3) [rad]; as of `error`."""
        return self.error[:, _BASE:]

    @property
    def distance(self) -> Array:
        """Size of the position's error, shape (N + 1,) [m]; raises as `error`."""
        return np.asarray(error_sizes(self.error)[:, 0])

    @property
    def angle(self) -> Array:
        """Angle of the orientation's error, shape (N + 1,) [rad]; NaN where none is desired."""
        return np.asarray(error_sizes(self.error)[:, 1])

    def max_error(self) -> tuple[float, float]:
        """Return the largest distance [m] and the largest angle [rad] from the target, as of `error`."""
        way, turn = error_sizes(self.error).max(axis=0)
        return float(way), float(turn)


def aimed_at(rollout: Any) -> str | None:
    """Return the first frame of a rollout's plant whose target the run has; None where it has none."""
    names = stated(rollout.plant, "frame_names") or ()
    return next((name for name in names if target_names(name)[0] in rollout.signals), None)


def end_effector_of(rollout: Any, frame: str | None) -> EndEffector:
    """Return a frame of a rollout's plant over its samples.

    Parameters
    ----------
    rollout : Rollout
        The run.
    frame : str or None
        Its name; None: that whose target the run has, else the plant's ``end_effector``.

    Raises
    ------
    InvalidArgument
        If the plant does not tell where its frames are.
    UnknownName
        If there is no such frame.
    """
    plant = rollout.plant
    if not all(callable(stated(plant, name)) for name in ("frame_pose", "frame_name")):
        raise InvalidArgument(
            f"plant is {shown(plant)}, which does not tell where its frames are, expected a MobileRobot, a "
            "WheeledRobot, or a plant with frame_name(frame) and frame_pose(q, frame)"
        )
    name = plant.frame_name(aimed_at(rollout) if frame is None else frame)
    pose = plant.frame_pose(rollout.q, name)
    position, orientation = target_names(name)
    if position in rollout.signals:
        target = _told(rollout.signals, position, orientation)
        return EndEffector(name, rollout.t, pose, target, orientation in rollout.signals)
    if rollout.error.shape[1] < _coordinates_of(plant, name):
        return EndEffector(name, rollout.t, pose)
    desired = whole_configurations(plant, rollout.q, rollout.reference.q)
    return EndEffector(name, rollout.t, pose, plant.frame_pose(desired, name))


def _told(signals: Mapping[str, Signal], position: str, orientation: str) -> Array:
    """Return the poses of signals, shape (N + 1, 4, 4)."""
    place = signals[position].values
    target = np.tile(np.eye(4), (len(place), 1, 1))
    target[:, :3, 3] = place
    if orientation in signals:
        quaternions = signals[orientation].values
        target[:, :3, :3] = [pin.Quaternion(row).toRotationMatrix() for row in quaternions]
    return target


def _coordinates_of(plant: Any, frame: str) -> int:
    """Return how many of the first coordinates a reference needs to define the pose of a frame."""
    mounts = stated(plant, "mounts")
    if mounts is None:
        return int(plant.nv)
    own = (mount.v.stop for mount in mounts if frame.startswith(f"{mount.name}/"))
    return int(next(own, _BASE))
