"""What rides on the body, arms and loads, and the model of the body with all of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike, finite, lengths, positive, text
from pinmobile.errors import InvalidArgument, shown
from pinmobile.plant import Parameter
from pinmobile.robot.arms import Arm
from pinmobile.urdf import Body, box_inertia


class LinkNumbers(NamedTuple):
    """Masses, centres of mass and inertias of an arm's root and links, and what its motors add.

    Attributes
    ----------
    masses, coms, inertias : ndarray, shape (links,), (links, 3), (links, 6)
        Inertias are (xx, yy, zz, xy, xz, yz) about the centres of mass [kg, m, kg m^2].
    rotors : ndarray, shape (nv,)
        [kg m^2, kg].
    """

    masses: Array
    coms: Array
    inertias: Array
    rotors: Array

    @classmethod
    def of(cls, model: pin.Model) -> LinkNumbers:
        """Return those of a model."""
        bodies = [model.inertias[joint] for joint in range(model.njoints)]
        masses, coms = np.array([body.mass for body in bodies]), np.array([body.lever for body in bodies])
        inertias = np.array([_six(body.inertia) for body in bodies])
        return cls(masses, coms, inertias, np.array(model.armature))

    def put_into(self, model: pin.Model) -> pin.Model:
        """Return a copy of the model that has them."""
        new = model.copy()
        for joint, (mass, com, six) in enumerate(zip(*self[:3], strict=True)):
            new.inertias[joint] = pin.Inertia(mass, com, _matrix_of(six))
        new.armature = self.rotors
        return new


def _six(inertia: Array) -> Array:
    return inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def _matrix_of(six: Array) -> Array:
    """Return the matrix of (xx, yy, zz, xy, xz, yz)."""
    return six[[[0, 3, 4], [3, 1, 5], [4, 5, 2]]]


_COM = ("com_x", "com_y", "com_z")
_INERTIA = ("inertia_xx", "inertia_yy", "inertia_zz", "inertia_xy", "inertia_xz", "inertia_yz")
_SLACK = 1e-9  # of the moments of inertia, relative, and of the mass [m^2]: files carry as many digits


def body_parameters(k: int, before: str, after: str, of: str) -> list[Parameter]:
    """Return the parameters of the k-th link or load."""
    named = [("mass", "masses", k, "kg", "mass", 0.0)]
    named += [
        (name, "coms", 3 * k + j, "m", f"{name[-1]} of the centre of mass", -np.inf)
        for j, name in enumerate(_COM)
    ]
    for j, name in enumerate(_INERTIA):
        least = 0.0 if j < 3 else -np.inf
        named.append((name, "inertias", 6 * k + j, "kg m^2", f"{name[-2:]} of the inertia", least))
    return [
        Parameter(
            f"{before}{name}{after}",
            unit,
            f"{meaning} of {of}, of the robot",
            least,
            may_vanish=not (before and name == "mass"),
            attribute=f"{before}{attribute}",
            entry=entry,
        )
        for name, attribute, entry, unit, meaning, least in named
    ]


def are_impossible(inertias: Array, masses: Array) -> NDArray[np.bool_]:
    """Tell which inertias (xx, yy, zz, xy, xz, yz) about a centre of mass no body has, shape (...)."""
    xx, yy, zz, xy, xz, yz = np.moveaxis(inertias, -1, 0)
    full = np.stack([np.stack(row, -1) for row in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))], -2)
    moments = np.linalg.eigvalsh(full)
    slack = _SLACK * (np.abs(moments).max(axis=-1) + masses)
    far = moments[..., 2] > moments[..., 0] + moments[..., 1] + slack
    return np.asarray(far | (moments[..., 0] < -slack))


@dataclass(frozen=True, eq=False, repr=False)
class Mount:
    """An arm at its place on the body.

    Attributes
    ----------
    name : str
        Its own; its joints and frames are called ``name/...``.
    at : tuple of 4 floats
        Where it stands on the body: x, y, z and yaw [m, m, m, rad].
    arm : Arm
        What is mounted; `arm.model` is its own `pin.Model`.
    q, v : slice
        Its part of a configuration and of a velocity.
    joints : slice
        Its part of the joints of the robot's `model`.
    numbers : LinkNumbers, optional
        What its links and motors have in place of what the arm has.
    """

    name: str
    at: tuple[float, float, float, float]
    arm: Arm
    q: slice
    v: slice
    joints: slice
    numbers: LinkNumbers | None = None

    @property
    def tip(self) -> str:
        """Its end effector's frame in the robot's `model`."""
        return f"{self.name}/{self.arm.tip}"

    @property
    def model(self) -> pin.Model:
        """A copy of its own model, on a fixed base and with its own names."""
        return self._model.copy()

    @cached_property
    def _model(self) -> pin.Model:
        """The model itself, which is only read."""
        return self.arm._model if self.numbers is None else self.numbers.put_into(self.arm._model)

    @property
    def moving(self) -> range:
        """Its joints' numbers in the robot's `model`."""
        return range(self.joints.start, self.joints.stop)

    @property
    def links(self) -> tuple[str, ...]:
        """What moves together, by the name of its first link with a mass: first what is fixed to the root."""
        model = self._model
        found = [str(name) for name in model.names]
        links = [frame for frame in model.frames if frame.type == pin.FrameType.BODY]

        def has_mass(link: pin.Frame) -> bool:
            # Pinocchio keeps a link's mass with the joint that it hangs on, if that is a fixed one.
            above = model.frames[link.parentFrame] if link.parentFrame < model.nframes else link
            return bool(above.type == pin.FrameType.JOINT or above.inertia.mass > 0)

        # What comes later here is taken: what has a mass, and of that the first.
        for frame in sorted(reversed(links), key=has_mass):
            found[frame.parentJoint] = str(frame.name)
        return tuple(f"{self.name}/{name}" for name in found)

    @property
    def placement(self) -> pin.SE3:
        """Pose of its root in the body's frame."""
        return _placement(self.at)

    def __repr__(self) -> str:
        words = {"at": self.at, "name": self.name, **self.arm.options()}
        listed = ", ".join(f"{word}={value!r}" for word, value in words.items())
        return f".mount({self.arm.origin.value!r}, {listed})"

    def _key(self) -> tuple[object, ...]:
        own = () if self.numbers is None else tuple(map(np.ndarray.tobytes, self.numbers))
        return self.name, self.at, self.arm.key(), own

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Mount) and self._key() == other._key() and self._model == other._model

    def __hash__(self) -> int:
        return hash(self._key())


@dataclass(frozen=True)
class Load:
    """A rigid body that is fixed to a frame of a robot.

    Parameters
    ----------
    mass : float
        Mass [kg].
    com : sequence of 3 floats
        Centre of mass in the frame [m].
    inertia : array_like, shape (3, 3), optional
        About the centre of mass, along the frame's axes [kg m^2]; by default that of a homogeneous box of
        `size`, or none where there is no size: a point.
    size : sequence of 3 floats, optional
        Of the box about the centre of mass that is drawn [m].

    Raises
    ------
    InvalidArgument
        If no rigid body has these.
    """

    mass: float
    com: tuple[float, float, float] = (0.0, 0.0, 0.0)
    inertia: tuple[tuple[float, ...], ...] | None = None
    size: tuple[float, float, float] | None = None
    _body: pin.Inertia = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        mass, com = positive("mass", self.mass, "kg"), finite("com", self.com)
        if com.shape != (3,):
            raise InvalidArgument(f"com has shape {com.shape}, expected (3,)")
        inertia = np.zeros((3, 3))
        if self.size is not None:
            size = lengths(self.size)
            object.__setattr__(self, "size", tuple(size.tolist()))
            inertia = box_inertia(mass, size)
        if self.inertia is not None:
            inertia = Body(mass, com, finite("inertia", self.inertia)).inertia
            object.__setattr__(self, "inertia", tuple(map(tuple, inertia.tolist())))
        object.__setattr__(self, "mass", mass)
        object.__setattr__(self, "com", tuple(com.tolist()))
        object.__setattr__(self, "_body", pin.Inertia(mass, com, inertia))

    @property
    def body(self) -> pin.Inertia:
        """A copy of its inertia, seen from the frame."""
        return pin.Inertia(self._body)

    @property
    def six(self) -> Array:
        """Its inertia (xx, yy, zz, xy, xz, yz) about the centre of mass [kg m^2]."""
        return _six(self._body.inertia)

    def with_numbers(self, mass: float, com: Array, six: Array) -> Load:
        """Return the load with another mass, centre of mass and inertia (xx, yy, zz, xy, xz, yz) about it."""
        if mass == self.mass and np.array_equal(com, self.com) and np.array_equal(six, self.six):
            return self
        own = tuple(map(tuple, _matrix_of(six).tolist())) if six.any() else None
        x, y, z = com.tolist()
        return Load(mass, (x, y, z), own, self.size)

    def __reduce__(self) -> tuple[object, ...]:
        return Load, (self.mass, self.com, self.inertia, self.size)


def placed(at: ArrayLike) -> tuple[float, float, float, float]:
    """Return a mount point (x, y, z, yaw), checked.

    Raises
    ------
    InvalidArgument
        If it has another shape or is not finite.
    """
    array = finite("at", at)
    if array.shape != (4,):
        raise InvalidArgument(f"at has shape {array.shape}, expected (4,): x, y, z and yaw")
    x, y, z, yaw = array.tolist()
    return x, y, z, yaw


def free_place(mounts: Sequence[Mount], top: float | None, arm: Arm) -> tuple[float, float, float, float]:
    """Return the mount point in the middle of a body whose highest point has the height `top` [m].

    What stands on its feet, or would otherwise hang below the ground, is as high as its lowest frame needs.

    Raises
    ------
    InvalidArgument
        If the height is not known, or the middle is taken.
    """
    if top is None:
        raise InvalidArgument(
            f"at is not given for {arm.origin.value!r}, and the top of the robot is not known, "
            "expected x, y, z and yaw; robot.source says what its file lacks"
        )
    for mount in mounts:
        if mount.at[:2] == (0.0, 0.0):
            raise InvalidArgument(
                f"at is not given for {arm.origin.value!r}, and {mount.name!r} stands in the middle "
                "already, expected x, y, z and yaw"
            )
    below = arm.reach_down()
    return 0.0, 0.0, top + below if arm.stands or below > top else top, 0.0


def with_numbers(
    mounts: Sequence[Mount], loads: Sequence[tuple[str, Load]], new: Mapping[str, Array]
) -> tuple[tuple[Mount, ...], tuple[tuple[str, Load], ...]]:
    """Return arms and loads with other numbers, by attribute of `ArticulatedBody`."""
    changed, link, joint = [], 0, 0
    for mount, at in zip(mounts, new["places"].reshape(-1, 4), strict=True):
        end, last = link + len(mount.links), joint + mount.v.stop - mount.v.start
        each = (("masses", 1), ("coms", 3), ("inertias", 6))
        masses, coms, inertias = (new[name][k * link : k * end] for name, k in each)
        rotors = new["rotors"][joint:last]
        numbers = LinkNumbers(masses, coms.reshape(-1, 3), inertias.reshape(-1, 6), rotors)
        same = all(map(np.array_equal, numbers, LinkNumbers.of(mount.arm._model)))
        changed.append(replace(mount, at=placed(at), numbers=None if same else numbers))
        link, joint = end, last
    coms, inertias = new["load_coms"].reshape(-1, 3), new["load_inertias"].reshape(-1, 6)
    rows = zip(loads, new["load_masses"], coms, inertias, strict=True)
    carried = ((frame, load.with_numbers(float(m), com, six)) for (frame, load), m, com, six in rows)
    return tuple(changed), tuple(carried)


def checked_name(name: str) -> str:
    """Return the name of a mount.

    Raises
    ------
    InvalidArgument
        If it is no text, is empty, or has a slash, a comma, a quotation mark or a control character.
    """
    if not isinstance(name, str) or not text("name", name).strip() or set('/,"') & set(name):
        raise InvalidArgument(
            f"name is {shown(name)}, expected a word without slash, comma and quotation mark"
        )
    return name


def free_name(name: str, taken: Iterable[str]) -> str:
    """Return the name, numbered where it is taken."""
    known, number, free = set(taken), 1, name
    while free in known:
        number += 1
        free = f"{name}_{number}"
    return free


def mount_after(model: pin.Model, arm: Arm, name: str, at: tuple[float, float, float, float]) -> Mount:
    """Return the mount of an arm that comes after all that is in a model."""
    own = arm._model
    q, v = (slice(n, n + more) for n, more in ((model.nq, own.nq), (model.nv, own.nv)))
    return Mount(name, at, arm, q, v, slice(model.njoints, model.njoints + own.njoints - 1))


def _placement(at: tuple[float, float, float, float]) -> pin.SE3:
    return pin.SE3(pin.utils.rotate("z", at[3]), np.array(at[:3]))


def assemble(base: pin.Model, mounts: Sequence[Mount], loads: Sequence[tuple[str, Load]]) -> pin.Model:
    """Return the model of a body that carries arms, and loads at frames of either.

    Parameters
    ----------
    base : pin.Model
        The chain with the body; the body's frame is its last.
    mounts : sequence of Mount
        One after the other.
    loads : sequence of (str, Load)
        Each with the frame it is fixed to.
    """
    model, body = base.copy(), base.nframes - 1
    for mount in mounts:
        model = pin.appendModel(model, prefixed(mount._model, mount.name), body, mount.placement)
    for mount in mounts:
        # Pinocchio forgets it when it appends; each arm keeps its own, joint by joint.
        model.armature[mount.v] = mount._model.armature
    model.name = base.name
    for frame, load in loads:
        fixed = model.frames[named_frames(model)[frame]]
        model.appendBodyToJoint(fixed.parentJoint, load.body, fixed.placement)
    return model


def named_frames(model: pin.Model) -> dict[str, int]:
    """Return the frames by name, links before joints of the same name."""
    ids: dict[str, int] = {}
    for number in range(1, model.nframes):
        frame = model.frames[number]
        if frame.name not in ids or frame.type == pin.FrameType.BODY:
            ids[frame.name] = number
    return ids


def prefixed(model: pin.Model, name: str) -> pin.Model:
    """Return a copy with all names ``name/...``; a frame is numbered where a link has its name."""
    copy = model.copy()
    for joint in range(1, copy.njoints):
        copy.names[joint] = f"{name}/{copy.names[joint]}"
    taken = {frame.name for frame in copy.frames if frame.type == pin.FrameType.BODY}
    for frame in copy.frames:
        own = str(frame.name)
        if frame.type != pin.FrameType.BODY:
            # Pinocchio finds a link by its name alone.
            own = free_name(own, taken)
            taken.add(own)
        frame.name = f"{name}/{own}"
    return copy


def resistances(nv: int, mounts: Sequence[Mount]) -> tuple[Array, Array]:
    """Return damping and friction of the joints, each of shape (nv,); the base has none."""
    damping, friction = np.zeros((2, nv))
    for mount in mounts:
        damping[mount.v], friction[mount.v] = mount._model.damping, mount._model.friction
    return damping, friction
