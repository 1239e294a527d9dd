"""Arms that can be mounted: checked models without their root joints and with locked wheels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from hashlib import sha256
from typing import Any, ClassVar, NamedTuple, Protocol

import attrs
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike, bounded, frozen, one_of
from pinmobile.errors import InvalidArgument, argument_errors
from pinmobile.parts import Number, array, by_value, declare, is_symbolic, number, option, part
from pinmobile.robot.linkage import (
    FREE_FLYER,
    Joint,
    carries_only_wheels,
    children,
    joints_of,
    replace_continuous_joints,
    root_of,
    tip_of,
)

_RIGHT = 2e-11  # rounding error of two right angles with eleven digits
_ORTHONORMAL = 1e-15
_SINGULAR = 1e-9  # smallest share of a joint's inertia that remains if the joints beyond move freely
_GENERIC = 20  # arbitrary seed of the second configuration


_SLACK = 1e-9  # tolerance of moments of inertia, relative and times the mass [m^2]: digits of files
_MOMENTS = ("xx", "yy", "zz", "xy", "xz", "yz")
_EXPECTED = "expected principal moments >= 0, none above the sum of the other two"


@attrs.frozen
class Entries(Number):
    """Declaration of a few numbers that a part stores as a tuple; missing entries are zero.

    Attributes
    ----------
    length : int
        Number of entries.
    """

    length: int = 3

    def convert(self, name: str, value: Any) -> Any:
        """Return a tuple of floats, or the given symbols."""
        values = super().convert(name, value)
        if is_symbolic(values):
            return values
        numbers = values.tolist()
        return (*numbers, *[0.0] * (self.length - len(numbers)))


def com_field(default: Any = attrs.NOTHING, **options: Any) -> Any:
    """Declare a centre of mass, stored as a tuple of 3 numbers."""
    return declare(Entries(unit="m", labels=("x", "y", "z"), **options), default)


def six_of(inertia: Array) -> Array:
    """Return (xx, yy, zz, xy, xz, yz) of an inertia, shape (3, 3)."""
    return inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def matrix_of_six(six: Array) -> Array:
    """Return the matrices of (xx, yy, zz, xy, xz, yz), shape (..., 3, 3)."""
    return six[..., [[0, 3, 4], [3, 1, 5], [4, 5, 2]]]


def are_impossible(inertias: Array, masses: ArrayLike) -> NDArray[np.bool_]:
    """Return which inertias (xx, yy, zz, xy, xz, yz) about centres of mass no body has, shape (...)."""
    moments = np.linalg.eigvalsh(matrix_of_six(inertias))
    slack = _SLACK * (np.abs(moments).max(axis=-1) + masses)
    violates = moments[..., 2] > moments[..., 0] + moments[..., 1] + slack
    return np.asarray(violates | (moments[..., 0] < -slack))


def inertia_field(of: str, **options: Any) -> Any:
    """Declare an inertia, stored as (xx, yy, zz, xy, xz, yz)."""
    doc = f"inertia of {of} about its centre of mass"
    return array(shapes=((6,),), unit="kg m^2", labels=_MOMENTS, doc=doc, **options)


class RigidBody(Protocol):
    """A part with mass, com and inertia (xx, yy, zz, xy, xz, yz) of a rigid body.

    `moments` is the inertia, of which `inertia` is the declared one.
    """

    mass: float
    com: Any
    inertia: Any

    @property
    def label(self) -> str:
        """Name of the body in messages."""

    @property
    def moments(self) -> Any:
        """Inertia (xx, yy, zz, xy, xz, yz) about the centre of mass [kg m^2]."""
        return self.inertia

    def impossible(self, values: Mapping[str, Array]) -> tuple[NDArray[np.bool_], str]:
        """Return which of several values no rigid body has, and the expected values as text."""
        mass = values.get("mass", self.mass)
        return are_impossible(values.get("inertia", self.inertia), mass), _EXPECTED

    def check(self) -> None:
        """Raise `InvalidArgument` if no rigid body has this inertia."""
        if are_impossible(self.moments, self.mass):
            raise InvalidArgument(f"inertia of {self.label} is one that no body has, {_EXPECTED}")

    @property
    def body(self) -> pin.Inertia:
        """Pinocchio inertia of the body in its frame."""
        return pin.Inertia(self.mass, np.array(self.com), matrix_of_six(self.moments))


@by_value
@part
class Link(RigidBody):
    """Rigidly connected links of an arm, as one body along the axes of its joint's frame.

    Parameters
    ----------
    name : str
        Name of the first link with a mass.
    mass : float
        Mass [kg].
    com : array_like, shape (3,)
        Centre of mass in the joint's frame [m].
    inertia : array_like, shape (6,)
        Inertia xx, yy, zz, xy, xz, yz about the centre of mass [kg m^2].

    Raises
    ------
    InvalidArgument
        If no rigid body has these values.

    See Also
    --------
    robot.Mount : mounted arm with its links
    PayloadBody : load on a frame

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> (arm,) = MobileRobot.box(mass=60.0).mount("ur5").mounts
    >>> heaviest = max(arm.links, key=lambda link: link.mass)
    >>> heaviest.name, heaviest.mass  # [kg]
    ('upper_arm_link', 8.393)
    """

    name: str = option(doc="name of the link")
    mass: float = number(unit="kg", lower=0.0, doc="mass of the link")
    com: Any = array(shapes=((3,),), unit="m", labels=("x", "y", "z"), doc="centre of mass of the link")
    inertia: Any = inertia_field("the link")

    @property
    def label(self) -> str:
        """Name of the link in messages."""
        return self.name


def links_of(model: pin.Model, label: str) -> tuple[Link, ...]:
    """Return the rigidly connected links of an arm's model; the first is fixed to its root."""
    links = list[Link]()
    for name, body in zip(_link_names(model), model.inertias, strict=True):
        with argument_errors(f"{label}: link {name!r}: "):
            links.append(Link(name, float(body.mass), np.array(body.lever), six_of(body.inertia)))
    return tuple(links)


def _link_names(model: pin.Model) -> list[str]:
    names = [str(name) for name in model.names]
    links = [frame for frame in model.frames if frame.type == pin.FrameType.BODY]

    def has_mass(link: pin.Frame) -> bool:
        # Pinocchio stores the mass of a link with its parent joint if this joint is fixed.
        frame = model.frames[link.parentFrame] if link.parentFrame < model.nframes else link
        return bool(frame.type == pin.FrameType.JOINT or frame.inertia.mass > 0)

    # Later names replace earlier ones, so the first link with a mass wins.
    for frame in sorted(reversed(links), key=has_mass):
        names[frame.parentJoint] = str(frame.name)
    return names


class Origin(NamedTuple):
    """Source of an arm, from which it can be read again.

    Attributes
    ----------
    kind : str
        ``"loader"``, ``"urdf"`` or ``"model"``.
    value : str
        Name of the loader, path of the URDF, or name of the model.
    package_dirs : tuple of str
        Folders to which ``package://`` in the URDF refers.
    """

    kind: str
    value: str
    package_dirs: tuple[str, ...] = ()


@attrs.frozen(eq=False, slots=False)
class Arm:
    """Robot that can be mounted, as read from its file; `MobileRobot.mount` makes this object.

    Parameters
    ----------
    origin : Origin
        Source of the arm.
    file_model : pin.Model
        Model as Pinocchio read the file. The arm stores a copy.
    rest : ndarray, shape (whole.nq,)
        Reference configuration [rad or m]. The pose of a root joint is discarded.
    locked : tuple of str
        Names of joints to lock at rest, in addition to root joint and wheels.
    stands : bool
        Whether the lowest frame, not the root, stands on the mounting surface, as for a robot with a
        free-flyer root. It is always True for a model with such a root.
    usual : ndarray, shape (whole.nq,), optional
        Default reference configuration; by default, `rest`.
    file : VisualFile, optional
        URDF with the geometry.
    visual, collision : pin.GeometryModel, optional
        Geometry of an arm without a file; None means no geometry.

    Attributes
    ----------
    posture : ndarray, shape (model.nq,)
        Reference configuration of the unlocked joints [rad or m].
    links : tuple of Link
        Body that is fixed to the root, then the body on each joint.
    squared : tuple of str
        Joints of `whole` whose placement had a rounded right angle (such as 1.57079632679) that is now exact.

    Raises
    ------
    InvalidArgument
        If a joint has no inertia beyond it, several axes or invalid limits, mimics another joint, or carries
        an inertia that no rigid body has.
    UnknownName
        If a joint to lock does not exist.

    See Also
    --------
    MobileRobot.mount : read and mount an arm
    robot.Mount : arm on a robot
    robot.mountable : table of shipped arms

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> (mount,) = MobileRobot.box(mass=60.0).mount("ur5").mounts
    >>> mount.arm.tip, mount.arm.model.nq
    ('tool0', 6)
    >>> mount.arm.posture  # reference configuration [rad]
    array([0., 0., 0., 0., 0., 0.])
    """

    origin: Origin
    _file_model: pin.Model = attrs.field(repr=False)
    rest: Array
    locked: tuple[str, ...] = ()
    stands: bool = False
    usual: Array = attrs.field(default=attrs.Factory(lambda arm: arm.rest, takes_self=True))
    file: Any = None
    visual: pin.GeometryModel | None = None
    collision: pin.GeometryModel | None = None

    squared: tuple[str, ...] = attrs.field(init=False)
    posture: Array = attrs.field(init=False)
    links: tuple[Link, ...] = attrs.field(init=False, repr=False)
    _whole: pin.Model = attrs.field(init=False, repr=False)

    # Fields that identify the arm in the store of a sweep.
    determined_by: ClassVar[tuple[str, ...]] = ("origin", "digest", "locked", "stands", "rest")

    def __attrs_post_init__(self) -> None:
        label, model = f"arm {self.origin.value!r}", _copy_model(self._file_model)
        for joint in joints_of(model):
            if "Mimic" in joint.kind:
                raise InvalidArgument(
                    f"{label}: joint {joint.name!r} mimics another joint, which Pinocchio's forward "
                    "dynamics does not support, expected a model built with mimic=False"
                )
        values: dict[str, Any] = {"squared": _square_rotations(model), "_file_model": model}
        values["_whole"] = full = replace_continuous_joints(model)
        values |= {"rest": _without_root_pose(full, self.rest), "usual": _without_root_pose(full, self.usual)}
        values["stands"] = self.stands or any(Joint.of(full, j).kind == FREE_FLYER for j in root_of(full))
        vars(self).update(values)
        free = [joint for number, joint in enumerate(joints_of(full), 1) if number not in self.fixed_joints]
        for joint in free:
            if not joint.nq == joint.nv == 1:
                raise InvalidArgument(
                    f"{label}: joint {joint}, which has several axes, expected one axis: "
                    "model the joint as revolute and prismatic joints in series, or lock it with "
                    f"locked=[{joint.name!r}]"
                )
            low, high = (float(x[joint.q][0]) for x in (full.lowerPositionLimit, full.upperPositionLimit))
            bounded(f"{label}: upper position limit of joint {joint.name!r}", high, least=low)
        vars(self)["posture"] = frozen(self.rest[[joint.q.start for joint in free]])
        vars(self)["links"] = links_of(self._model, label)

    @cached_property
    def _key(self) -> tuple[object, ...]:
        return self.origin, self.locked, self.rest.tobytes(), self.digest

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Arm) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)

    @cached_property
    def fixed_joints(self) -> list[int]:
        """Numbers of the joints of `whole` that do not move: root joint, wheels, and joints in `locked`."""
        return _find_fixed(self._file_model, self.locked)

    @cached_property
    def _model(self) -> pin.Model:
        return self._lock_joints([])[0]

    @property
    def file_model(self) -> pin.Model:
        """Copy of the file's model, with exact right angles."""
        return self._file_model.copy()

    @property
    def model(self) -> pin.Model:
        """Copy of `whole` without the locked joints."""
        return self._model.copy()

    @property
    def whole(self) -> pin.Model:
        """Copy of the file's model with one angle for each continuous joint."""
        return self._whole.copy()

    @property
    def tip(self) -> str:
        """Name of the end effector's frame."""
        return tip_of(self._model)

    @property
    def digest(self) -> str:
        """Digest of the file's model, the same for copies."""
        return sha256(self._file_model.saveToString().encode()).hexdigest()

    def options(self) -> dict[str, object]:
        """Return the arguments of `MobileRobot.mount` that differ from their defaults."""
        given = {
            "package_dirs": self.origin.package_dirs,
            "rest": () if np.array_equal(self.rest, self.usual) else self.rest.tolist(),
            "locked": self.locked,
        }
        return {word: value for word, value in given.items() if value}

    def reach_down(self) -> float:
        """Return the height of the root above the lowest frame at rest [m]."""
        data = self._model.createData()
        pin.framesForwardKinematics(self._model, data, np.array(self.posture))
        return -min(0.0, *(float(placement.translation[2]) for placement in data.oMf))

    def visuals(self) -> pin.GeometryModel:
        """Return the visual geometry for `model`."""
        given = self.visual or pin.GeometryModel()
        return self._lock_joints([self.file.visuals(self._whole, 7)[0] if self.file else given])[1][0]

    def solids(self) -> tuple[pin.GeometryModel, tuple[str, ...]]:
        """Return the collision geometry for `model`, and the link of each shape."""
        given = self.collision or pin.GeometryModel()
        shapes = self.file.shapes(self._whole) if self.file else given
        links = tuple(link_of(item, self._whole) for item in shapes.geometryObjects)
        return self._lock_joints([shapes])[1][0], links

    def _lock_joints(self, shapes: list[pin.GeometryModel]) -> tuple[pin.Model, list[pin.GeometryModel]]:
        """Return the model and its geometry with joints locked at rest, or copies if no joint is locked."""
        model = self._whole.copy()
        if not self.fixed_joints:
            return model, shapes
        # Numbers make names unique for a while: Pinocchio rejects equal names of links and joints.
        names = {}
        for k, frame in enumerate(model.frames):
            if k and frame.type != pin.FrameType.JOINT:
                names[f"{k}/{frame.name}"] = str(frame.name)
                frame.name = f"{k}/{frame.name}"
        model, shapes_left = pin.buildReducedModel(model, shapes, self.fixed_joints, np.array(self.rest))
        for frame in model.frames:
            frame.name = names.get(frame.name, frame.name)
        return model, list(shapes_left)


def link_of(item: pin.GeometryObject, model: pin.Model) -> str:
    """Return the link of a shape; for an unknown link, the name of the shape."""
    is_known = 0 <= item.parentFrame < model.nframes
    frame = model.frames[item.parentFrame] if is_known else None
    return str(frame.name if frame is not None and frame.type == pin.FrameType.BODY else item.name)


def _copy_model(model: pin.Model) -> pin.Model:
    """Return a copy with the data that Pinocchio needs to lock joints; some models lack them."""
    copy = model.copy()
    # Otherwise Pinocchio rejects the model: its lower velocity limit is the largest number by default.
    copy.lowerVelocityLimit = np.minimum(copy.lowerVelocityLimit, copy.upperVelocityLimit)
    for joint in range(1, copy.njoints):
        # Pinocchio crashes without it.
        if not copy.existFrame(copy.names[joint], pin.FrameType.JOINT):
            copy.addJointFrame(joint)
    return copy


def _square_rotations(model: pin.Model) -> tuple[str, ...]:
    """Make rounded right angles of rotations exact, and return the names of the joints.

    A rotation with entries of 5e-12 costs as much as any other rotation. In contrast to exact zeros, such
    entries also make equal methods differ in the last digits.
    """
    names = []
    for joint in range(1, model.njoints):
        place = model.jointPlacements[joint]
        R = _squared_rotation(place.rotation)
        if np.abs(R - place.rotation).max() > _ORTHONORMAL:
            names.append(str(model.names[joint]))
        model.jointPlacements[joint] = pin.SE3(R, place.translation)
    for frame in model.frames:
        frame.placement = pin.SE3(_squared_rotation(frame.placement.rotation), frame.placement.translation)
    return tuple(names)


def _squared_rotation(R: Array) -> Array:
    """Return a rotation with entries near 0 and 1 made exact, if the result is a rotation."""
    nearest = np.rint(R)
    exact_R = np.where(np.abs(R - nearest) < _RIGHT, nearest, R) + 0.0
    return exact_R if np.abs(exact_R @ exact_R.T - np.eye(3)).max() < _ORTHONORMAL else np.array(R)


def _without_root_pose(model: pin.Model, rest: Array) -> Array:
    """Return the configuration with the root at its origin, since the mount gives its placement."""
    posture, neutral = np.array(rest), pin.neutral(model)
    for joint in root_of(model):
        rows = Joint.of(model, joint).q
        posture[rows] = neutral[rows]
    return frozen(posture)


def _find_fixed(model: pin.Model, names: Sequence[str]) -> list[int]:
    """Return the joints that do not move: root joint, wheels, and the named joints."""
    root = root_of(model)
    child_of = children(model)
    start = root[-1] if root else 0
    first = child_of[start]
    rolling = [joint for joint in first if carries_only_wheels(model, joint)]
    # A single chain of continuous joints is a pendulum.
    wheels = rolling if len(first) > 1 else []
    fixed = {*root}
    while wheels:
        joint = wheels.pop()
        fixed.add(joint)
        wheels += child_of[joint]
    numbers = {name: joint for joint, name in enumerate(model.names) if joint}
    for name in names:
        fixed.add(numbers[one_of("joint", name, numbers)])
    return sorted(fixed)


def check_whole(model: pin.Model, posture: Array) -> None:
    """Reject a robot with a mass matrix that overflows, or that is singular in one of two configurations.

    Parameters
    ----------
    model : pin.Model
        Model of the base with arms and loads.
    posture : ndarray, shape (nq,)
        Reference configuration in the order of the model.

    Raises
    ------
    InvalidArgument
        If M overflows or is singular. The message names the joint and the heaviest part.
    """
    joint = max(range(model.njoints), key=lambda k: model.inertias[k].mass)
    heaviest = f"the heaviest, {model.inertias[joint].mass:g} kg, is on joint {model.names[joint]!r}"
    data = model.createData()
    generic = posture + np.random.default_rng(_GENERIC).uniform(-1, 1, model.nv)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        for posture_name, q in (("at rest", posture), ("at a posture like any other", generic)):
            diagonal = np.diag(pin.crba(model, data, q)).copy()
            pin.cholesky.decompose(model, data)
            # Elimination goes from the tips to the root; the entries after a zero are NaN.
            singular = np.flatnonzero(~(np.array(data.D) > _SINGULAR * diagonal))
            if len(singular):
                raise InvalidArgument(_cause(model, int(singular[-1]), posture_name, heaviest))


def _cause(model: pin.Model, k: int, words: str, heaviest: str) -> str:
    """Return the error message for the joint of a coordinate that moves no inertia."""
    joint = next(j for j in range(1, model.njoints) if 0 <= k - model.idx_vs[j] < model.nvs[j])
    name = repr(model.names[joint])
    bodies = [model.inertias[beyond] for beyond in model.subtrees[joint]]
    if not any(body.mass or np.array(body.inertia).any() for body in bodies):
        return (
            f"joint {name} moves parts that have no inertia, expected inertia beyond each joint: lock this "
            "joint, or add inertia"
        )
    return (
        f"the mass matrix is singular {words} about joint {name}: if the joints beyond move too, it moves "
        f"less than {_SINGULAR:g} of its inertia, expected another `rest`, inertia there, less different "
        f"masses and distances, or this joint locked: {heaviest}"
    )
