"""Arms, made ready to be mounted: checked, without a root of their own, their wheels locked."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from typing import ClassVar, TypeAlias

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, bounded, finite, frozen, non_negative, one_of
from pinmobile.errors import InvalidArgument
from pinmobile.robot.linkage import (
    Joint,
    carries_only_wheels,
    children,
    joints_of,
    replace_continuous_joints,
    root_of,
    tip_of,
)

Picture: TypeAlias = Callable[[pin.Model], pin.GeometryModel]


_RIGHT = 2e-11  # that angles of eleven digits leave of a right one, two of them at most
_ORTHONORMAL = 1e-15
_ROUNDING = 1e-9  # of the moments of inertia, relative: files carry as many digits
_GYRATION = 1e-9  # and of mass [m^2]: exporters leave noise of the size of 1e-18 where a moment is zero
_SINGULAR = 1e-9  # what is left of a joint's inertia when all joints beyond it give way, as a share of it
_GENERIC = 20  # seed of the posture at which inertias are tried; any will do


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
    file_model : pin.Model
        As Pinocchio read it. A copy is taken, and copies are handed out.
    rest : ndarray, shape (whole.nq,)
        Its reference posture; the pose of a root of its own is dropped.
    picture : callable
        Returns the visual `pin.GeometryModel` of the model.
    locked : tuple of str
        Joints to lock at rest, beside a root and wheels.
    stands : bool
        Whether it stands on its feet, as what has a free-flyer root does, rather than on its root; true of a
        model with such a root in any case.
    usual : ndarray, shape (whole.nq,), optional
        The reference posture that it has unless another is asked for; by default `rest`.
    shapes : callable, optional
        Returns the collision `pin.GeometryModel` of the model; by default it has none.

    Attributes
    ----------
    model : pin.Model
        A copy of `whole` without what is locked.
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
        nothing, mimics another one, or has several axes.
    UnknownName
        If a joint to lock is not there.
    """

    origin: Origin
    file_model: pin.Model
    rest: Array
    picture: Picture
    locked: tuple[str, ...] = ()
    stands: bool = False
    usual: Array | None = None
    shapes: Picture | None = None
    model: pin.Model = field(init=False)
    _file_model: pin.Model = field(init=False, repr=False)
    _model: pin.Model = field(init=False, repr=False)
    posture: Array = field(init=False)
    tip: str = field(init=False)
    squared: tuple[str, ...] = field(init=False)

    # By which the store of a sweep knows it again.
    determined_by: ClassVar[tuple[str, ...]] = ("origin", "digest", "locked", "stands", "rest")

    def __post_init__(self) -> None:
        file_model = _copied(self._file_model)
        for joint in joints_of(file_model):
            if joint.mimics:
                raise InvalidArgument(
                    f"arm {self.origin.value!r}: joint {joint.name!r} mimics another one, which "
                    "Pinocchio's forward dynamics does not support, expected a model built with mimic=False"
                )
        squared = _squared(file_model)
        whole = replace_continuous_joints(file_model)
        rest = _without_root_pose(whole, self.rest)
        joints, held = joints_of(whole), _held(whole, self.locked)
        free = [joint for number, joint in enumerate(joints, 1) if number not in held]
        for joint in free:
            if not joint.nq == joint.nv == 1:
                raise InvalidArgument(
                    f"arm {self.origin.value!r}: joint {joint}, which has several axes, expected one axis: "
                    "model it as revolute and prismatic joints in series, or lock it with "
                    f"locked=[{joint.name!r}]"
                )
        check_bodies(whole, self.origin.value)
        check_joint_limits(whole, free, self.origin.value)
        model, _ = _reduced(whole, [], held, rest)
        posture = rest[[joint.q.start for joint in free]]
        check_inertias(model, posture, self.origin.value)
        for name, value in {
            "file_model": file_model,
            "rest": rest,
            "usual": rest if self.usual is None else _without_root_pose(whole, self.usual),
            "model": model,
            "posture": frozen(posture),
            "tip": tip_of(model),
            "squared": squared,
            "stands": self.stands or any(joints[j - 1].in_space for j in root_of(whole)),
        }.items():
            object.__setattr__(self, name, value)

    @property
    def whole(self) -> pin.Model:
        """A copy of the file's model with one angle for each continuous joint."""
        return replace_continuous_joints(self.file_model)

    @property
    def digest(self) -> str:
        """Digest of the file's model, of which copies have the same."""
        return sha256(self._file_model.saveToString().encode()).hexdigest()

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
        return _held(self._file_model, self.locked)

    def visuals(self) -> pin.GeometryModel:
        """Return what is drawn of it, for `model`."""
        whole = self.whole
        _, (kept,) = _reduced(whole, [self.picture(whole)], self.held(), self.rest)
        return kept

    def solids(self) -> tuple[pin.GeometryModel, tuple[str, ...]]:
        """Return its collision geometry, for `model`, and the link of each shape."""
        whole = self.whole
        shapes = pin.GeometryModel() if self.shapes is None else self.shapes(whole)
        links = tuple(link_of(item, whole) for item in shapes.geometryObjects)
        _, (kept,) = _reduced(whole, [shapes], self.held(), self.rest)
        return kept, links


def link_of(item: pin.GeometryObject, model: pin.Model) -> str:
    """Return the link that a shape belongs to; its own name where that is not known."""
    known = 0 <= item.parentFrame < model.nframes
    frame = model.frames[item.parentFrame] if known else None
    return str(frame.name if frame is not None and frame.type == pin.FrameType.BODY else item.name)


class _Copied:
    """A model that is kept below the name with an underscore, and handed out as a copy."""

    def __init__(self, name: str) -> None:
        self.kept = f"_{name}"

    def __get__(self, arm: object, owner: type) -> pin.Model:
        return getattr(arm, self.kept).copy()

    def __set__(self, arm: object, model: pin.Model) -> None:
        object.__setattr__(arm, self.kept, model)


for _name in ("file_model", "model"):
    # Not in the class, where a dataclass would take them for defaults.
    setattr(Arm, _name, _Copied(_name))


def _copied(model: pin.Model) -> pin.Model:
    """Return a copy with what Pinocchio needs to lock joints, and a model made joint by joint may lack."""
    copy = model.copy()
    # Pinocchio refuses it otherwise: the least velocity is left at its largest number.
    copy.lowerVelocityLimit = np.minimum(copy.lowerVelocityLimit, copy.upperVelocityLimit)
    for joint in range(1, copy.njoints):
        # Pinocchio crashes without it.
        if not copy.existFrame(copy.names[joint], pin.FrameType.JOINT):
            copy.addJointFrame(joint)
    return copy


def _reduced(
    whole: pin.Model, shown: list[pin.GeometryModel], held: list[int], rest: Array
) -> tuple[pin.Model, list[pin.GeometryModel]]:
    """Return the model and its geometry with joints locked at rest; a copy where there are none."""
    model = whole.copy()
    if not held:
        return model, shown
    # Pinocchio refuses a link, a joint or a fixed joint of the same name, so they are numbered meanwhile.
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
        own = Joint.of(model, joint).q
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


def check_bodies(model: pin.Model, called: str) -> None:
    """Refuse a joint that carries what no rigid body is; a joint may carry nothing.

    Parameters
    ----------
    model : pin.Model
        The arm as it was read; what is fixed to a link is a part of it.
    called : str
        What the arm is called, for the message.

    Raises
    ------
    InvalidArgument
        If a mass, a centre of mass or an inertia is not finite, a mass is negative, or the principal
        moments of inertia are negative or break the triangle inequality.
    """
    for joint in range(model.njoints):
        body = model.inertias[joint]
        carrier = f"arm {called!r}: joint {model.names[joint]!r}" if joint else f"arm {called!r}: its root"
        mass, inertia = float(body.mass), np.array(body.inertia)
        non_negative(f"{carrier}, whose mass", mass, "kg")
        finite(f"{carrier}, whose centre of mass", body.lever)
        finite(f"{carrier}, whose inertia", inertia)
        least, middle, most = moments = np.linalg.eigvalsh(inertia)
        slack = _ROUNDING * np.abs(moments).max() + _GYRATION * mass
        if least < -slack or most > least + middle + slack:
            raise InvalidArgument(
                f"{carrier} carries principal moments of inertia ({least:.6g}, {middle:.6g}, {most:.6g}) "
                "kg m^2, which no rigid body has: expected each >= 0 and at most the sum of the other two"
            )


def check_joint_limits(model: pin.Model, joints: Iterable[Joint], called: str) -> None:
    """Refuse position limits in the wrong order, and limits, damping and friction that are negative or NaN.

    Parameters
    ----------
    model : pin.Model
        The arm as it was read.
    joints : iterable of Joint
        Those of its joints that move.
    called : str
        What the arm is called, for the message.

    Raises
    ------
    InvalidArgument
        The message names the joint.
    """
    for joint in joints:
        name, limits = (
            f"arm {called!r}: joint {joint.name!r}",
            (model.lowerPositionLimit, model.upperPositionLimit),
        )
        for least, most in zip(*(limit[joint.q] for limit in limits), strict=True):
            if not least <= most:
                raise InvalidArgument(
                    f"{name} has position limits from {least:g} to {most:g}, expected the lower one first"
                )
        for kind, given in (
            ("velocity limit", model.velocityLimit),
            ("effort limit", model.effortLimit),
            ("damping", model.damping),
            ("friction", model.friction),
        ):
            bounded(f"{name}, whose {kind}", np.asarray(given[joint.v]), least=0)


def check_inertias(model: pin.Model, posture: Array, called: str) -> None:
    """Refuse a joint that moves no inertia, at rest or at another posture.

    Parameters
    ----------
    model : pin.Model
        The arm without what is locked.
    posture : ndarray, shape (nq,)
        Its reference posture.
    called : str
        What the arm is called, for the message.

    Raises
    ------
    InvalidArgument
        The message names the joint.
    """
    for joint, where in _weakest(model, posture):
        raise InvalidArgument(f"arm {called!r}: {_cause(model, joint, where)}, or that joint locked")


def check_whole(model: pin.Model, posture: Array) -> None:
    """Refuse a robot whose mass matrix overflows, or is singular to rounding, at rest or at another posture.

    Parameters
    ----------
    model : pin.Model
        The base and all that it carries.
    posture : ndarray, shape (nq,)
        In the order of the model.

    Raises
    ------
    InvalidArgument
        The message names the joint, and the heaviest part.
    """
    joint = max(range(model.njoints), key=lambda k: model.inertias[k].mass)
    heaviest = f"the heaviest, {model.inertias[joint].mass:g} kg, is on joint {model.names[joint]!r}"
    if not np.isfinite(pin.crba(model, model.createData(), np.array(posture))).all():
        raise InvalidArgument(
            "the robot's mass matrix is beyond 1.8e308, expected smaller masses or distances: " + heaviest
        )
    for joint, where in _weakest(model, posture):
        raise InvalidArgument(
            f"the robot's mass matrix is singular to rounding {where}: joint {model.names[joint]!r} alone "
            f"moves less than {_SINGULAR:g} of the inertia that it moves with those beyond, expected masses "
            f"and distances nearer to each other: {heaviest}"
        )


def _weakest(model: pin.Model, posture: Array) -> Iterator[tuple[int, str]]:
    """Yield a joint that moves no inertia, but for rounding, and where, at each of two postures with one."""
    if not model.nv:
        return
    data = model.createData()
    step = np.random.default_rng(_GENERIC).uniform(-1, 1, model.nv)
    generic = posture + step
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        for where, q in (("at rest", posture), ("at a posture like any other", generic)):
            own = np.diag(pin.crba(model, data, q)).copy()
            pin.cholesky.decompose(model, data)
            left = np.array(data.D)
            # Elimination goes from the tips to the root, and what comes after a zero is no number.
            singular = np.flatnonzero(~(left > _SINGULAR * own))
            if len(singular):
                yield _joint_of(model, int(singular[-1])), where


def _cause(model: pin.Model, joint: int, where: str) -> str:
    """Return what is wrong with a joint that moves no inertia, and what is expected."""
    name = repr(model.names[joint])
    moved = [model.inertias[beyond] for beyond in model.subtrees[joint]]
    if not any(body.mass or np.array(body.inertia).any() for body in moved):
        return f"joint {name} moves parts that have no inertia, expected inertia beyond each joint"
    return (
        f"the mass matrix is singular {where} about joint {name}: moved together with joints beyond "
        "it, it moves no inertia, expected another `rest`, inertia there"
    )


def _joint_of(model: pin.Model, k: int) -> int:
    """Return the joint of a velocity coordinate."""
    return next(j for j in range(1, model.njoints) if 0 <= k - model.idx_vs[j] < model.nvs[j])
