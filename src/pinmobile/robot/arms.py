"""What can be mounted, made ready: a model without a root of its own, its wheels locked, its rest posture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, frozen, one_of
from pinmobile.errors import InvalidArgument
from pinmobile.robot.checks import check_bodies, check_inertias, check_joint_limits
from pinmobile.robot.tree import (
    carries_only_wheels,
    children,
    joint_kind,
    moves_its_axes,
    parts_of,
    root_of,
    tip_of,
)

Picture: TypeAlias = Callable[[pin.Model], pin.GeometryModel]


_RIGHT = 2e-11  # that angles of eleven digits leave of a right one, two of them at most
_ORTHONORMAL = 1e-15


@dataclass(frozen=True)
class Origin:
    """Where an arm comes from, so that it can be read again.

    Parameters
    ----------
    kind : str
        ``"loader"``, ``"urdf"`` or ``"model"``.
    value : str
        The loader's name, the path of the URDF, or the model's name.
    package_dirs : tuple of str
        Folders that ``package://`` in the URDF refers to.
    """

    kind: str
    value: str
    package_dirs: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Arm:
    """A robot that can be mounted.

    Parameters
    ----------
    origin : Origin
        Where it comes from.
    whole : pin.Model
        As it was read. A copy is taken, and copies are handed out.
    rest : ndarray, shape (whole.nq,)
        Its reference posture; the pose of a root of its own is dropped.
    picture : callable
        Returns the visual `pin.GeometryModel` of `whole`.
    locked : tuple of str
        Joints to lock at rest, beside a root and wheels.
    stands : bool
        Whether it stands on its feet, as what has a free-flyer root does, rather than on its root; true of a
        model with such a root in any case.
    usual : ndarray, shape (whole.nq,), optional
        The reference posture that it has unless another is asked for; by default `rest`.

    Attributes
    ----------
    model : pin.Model
        A copy of it without what is locked.
    posture : ndarray, shape (model.nq,)
        Its reference posture.
    tip : str
        Its end effector's frame.
    squared : tuple of str
        Joints of `whole` whose placement was turned by a right angle but for its last digits, as by a file's
        1.57079632679, and is so by an exact one.

    Raises
    ------
    InvalidArgument
        If a joint moves nothing that has inertia, carries what no rigid body is, has limits that limit
        nothing, mimics another one, or has axes that move with its own angles.
    UnknownName
        If a joint to lock is not there.
    """

    origin: Origin
    whole: pin.Model
    rest: Array
    picture: Picture
    locked: tuple[str, ...] = ()
    stands: bool = False
    usual: Array | None = None
    model: pin.Model = field(init=False)
    _whole: pin.Model = field(init=False, repr=False)
    _model: pin.Model = field(init=False, repr=False)
    posture: Array = field(init=False)
    tip: str = field(init=False)
    squared: tuple[str, ...] = field(init=False)

    def __post_init__(self) -> None:
        whole = _whole(self._whole)
        rest = _without_root_pose(whole, self.rest)
        for joint in range(1, whole.njoints):
            if "Mimic" in joint_kind(whole, joint):
                raise InvalidArgument(
                    f"arm {self.origin.value!r}: joint {whole.names[joint]!r} mimics another one, which "
                    "Pinocchio's forward dynamics does not support, expected a model built with mimic=False"
                )
        held = _held(whole, self.locked)
        free = [joint for joint in range(1, whole.njoints) if joint not in held]
        for joint in free:
            if moves_its_axes(whole, joint):
                raise InvalidArgument(
                    f"arm {self.origin.value!r}: joint {whole.names[joint]!r} is a "
                    f"{joint_kind(whole, joint)}, whose axes move with its own angles, for which Pinocchio's "
                    "Coriolis matrix and derivatives are wrong, expected as many joints in series, with one "
                    "axis each, or a ball joint"
                )
        check_bodies(whole, self.origin.value)
        check_joint_limits(whole, free, self.origin.value)
        squared = _squared(whole)
        model, _ = _reduced(whole, [], held, rest)
        parts = [rest[parts_of(whole, joint)[0]] for joint in free]
        posture = np.concatenate(parts) if parts else np.zeros(0)
        check_inertias(model, posture, self.origin.value)
        for name, value in {
            "whole": whole,
            "rest": rest,
            "usual": rest if self.usual is None else _without_root_pose(whole, self.usual),
            "model": model,
            "posture": frozen(posture),
            "tip": tip_of(model),
            "squared": squared,
            "stands": self.stands or any("FreeFlyer" in joint_kind(whole, j) for j in root_of(whole)),
        }.items():
            object.__setattr__(self, name, value)

    def options(self) -> dict[str, object]:
        """Return what `MobileRobot.mount` was asked for beside what it does by default."""
        usual = self.usual is None or np.array_equal(self.rest, self.usual)
        asked = {
            "package_dirs": self.origin.package_dirs,
            "rest": () if usual else self.rest.tolist(),
            "locked": self.locked,
        }
        return {word: value for word, value in asked.items() if value}

    def key(self) -> tuple[object, ...]:
        """Return what makes two arms the same one."""
        return self.origin, self.locked, tuple(self.rest.tolist())

    def reach_down(self) -> float:
        """Return how far its lowest frame is below its root at rest [m]."""
        data = self._model.createData()
        pin.framesForwardKinematics(self._model, data, np.array(self.posture))
        return -min(0.0, *(float(placement.translation[2]) for placement in data.oMf))

    def held(self) -> list[int]:
        """Return the joints of `whole` that do not move: a root of its own, wheels, and those in `locked`."""
        return _held(self._whole, self.locked)

    def visuals(self) -> pin.GeometryModel:
        """Return what is drawn of it, for `model`."""
        shown = self.picture(self._whole)
        _, (kept,) = _reduced(self._whole, [shown], self.held(), self.rest)
        return kept


class _Copied:
    """A model that is kept below the name with an underscore, and handed out as a copy."""

    def __init__(self, name: str) -> None:
        self.kept = f"_{name}"

    def __get__(self, arm: object, owner: type) -> pin.Model:
        return getattr(arm, self.kept).copy()

    def __set__(self, arm: object, model: pin.Model) -> None:
        object.__setattr__(arm, self.kept, model)


for _name in ("whole", "model"):
    # Not in the class, where a dataclass would take them for defaults.
    setattr(Arm, _name, _Copied(_name))


def _whole(model: pin.Model) -> pin.Model:
    """Return a copy with what Pinocchio needs to lock joints, and a model made joint by joint may lack."""
    whole = model.copy()
    # Else it balks: the least velocity is left at its largest number.
    whole.lowerVelocityLimit = np.minimum(whole.lowerVelocityLimit, whole.upperVelocityLimit)
    for joint in range(1, whole.njoints):
        # Else it crashes.
        if not whole.existFrame(whole.names[joint], pin.FrameType.JOINT):
            whole.addJointFrame(joint)
    return whole


def _reduced(
    whole: pin.Model, shown: list[pin.GeometryModel], held: list[int], rest: Array
) -> tuple[pin.Model, list[pin.GeometryModel]]:
    """Return the model and its geometry with joints locked at rest; a copy where there are none."""
    model = whole.copy()
    if not held:
        return model, shown
    # Pinocchio balks at a link, a joint or a fixed joint of the same name, so they are numbered meanwhile.
    names = {}
    for number, frame in enumerate(model.frames):
        if number and frame.type != pin.FrameType.JOINT:
            names[f"{number}/{frame.name}"] = str(frame.name)
            frame.name = f"{number}/{frame.name}"
    try:
        model, kept = pin.buildReducedModel(model, shown, held, np.array(rest))
    except (ValueError, RuntimeError) as error:
        raise InvalidArgument(
            f"arm {model.name!r} cannot be had with joints locked: Pinocchio says {error}, expected a model "
            "with each joint's own frame before those that are fixed to it"
        ) from error
    for frame in model.frames:
        frame.name = names.get(frame.name, frame.name)
    return model, list(kept)


def _squared(model: pin.Model) -> tuple[str, ...]:
    """Make right angles of rotations exact where their rounding hides them, and return the joints' names.

    A rotation with entries of 5e-12 costs as much as any other, and no two ways to compute with it agree to
    the last digits as they do of zeros.
    """
    found = []
    for joint in range(1, model.njoints):
        place = model.jointPlacements[joint]
        R = _squared_rotation(place.rotation)
        if np.abs(R - place.rotation).max() > _ORTHONORMAL:
            found.append(str(model.names[joint]))
        model.jointPlacements[joint] = pin.SE3(R, place.translation)
    for frame in model.frames:
        frame.placement = pin.SE3(_squared_rotation(frame.placement.rotation), frame.placement.translation)
    return tuple(found)


def _squared_rotation(R: Array) -> Array:
    """Return a rotation with exact zeros and ones, where that is a rotation, too."""
    whole = np.rint(R)
    near = np.where(np.abs(R - whole) < _RIGHT, whole, R) + 0.0
    return near if np.abs(near @ near.T - np.eye(3)).max() < _ORTHONORMAL else np.array(R)


def _without_root_pose(model: pin.Model, rest: Array) -> Array:
    """Return the posture with a root at its origin: the mount point says where that is."""
    posture, neutral = np.array(rest), pin.neutral(model)
    for joint in root_of(model):
        own, _ = parts_of(model, joint)
        posture[own] = neutral[own]
    return frozen(posture)


def _held(model: pin.Model, names: Sequence[str]) -> list[int]:
    """Return the joints that do not move: a root of its own, wheels, and those that are named."""
    root = root_of(model)
    below = children(model)
    start = root[-1] if root else 0
    first = below[start]
    rolling = [joint for joint in first if carries_only_wheels(model, joint)]
    # A single chain of continuous joints is a pendulum.
    wheels = rolling if len(first) > 1 else []
    held = {*root}
    while wheels:
        joint = wheels.pop()
        held.add(joint)
        wheels += below[joint]
    known = {name: joint for joint, name in enumerate(model.names) if joint}
    for name in names:
        held.add(known[one_of("joint", name, known)])
    return sorted(held)
