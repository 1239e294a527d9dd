"""What rides on the body, arms and loads, and the model of the body with all of it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from pinmobile.arrays import ArrayLike, finite, lengths, positive, text
from pinmobile.errors import InvalidArgument, shown
from pinmobile.parts import array, by_value, children, declare, number, option, part, structure
from pinmobile.robot.arms import (
    Arm,
    Entries,
    Link,
    RigidBody,
    com_field,
    inertia_field,
    matrix_of_six,
    six_of,
)
from pinmobile.robot.linkage import BODY_JOINT
from pinmobile.urdf import Body, box_inertia


@by_value
@part
class Mount:
    """An arm at its place on the body.

    Attributes
    ----------
    name : str
        Its own; its joints and frames are called ``name/...``.
    arm : Arm
        What is mounted; `arm.model` is its own `pin.Model`.
    first : int
        Number of its first coordinate in those of the robot.
    links : tuple of Link
        What is fixed to its root, then what is fixed to each of its joints.
    rotors : ndarray, shape (joints,)
        What motors add to the inertias of its joints [kg m^2, kg where one slides].
    at : tuple of 4 floats
        Where it stands on the body: x, y, z and yaw [m, m, m, rad].
    """

    name: str = option(doc="name of the arm")
    arm: Arm = option(doc="the arm as it was read")
    first: int = option(doc="number of its first coordinate")
    links: tuple[Link, ...] = children(Link, doc="what of the arm moves together")
    rotors: Any = array(
        unit="kg m^2",
        lower=0.0,
        labels=lambda mount: mount.joint_names,
        doc="inertia that motors add to joints, kg where one slides",
    )
    at: Any = declare(
        Entries(
            unit="m, m, m, rad",
            labels=("x", "y", "z", "yaw"),
            shapes=((4,),),
            doc="where the arm stands",
            length=4,
        )
    )

    @classmethod
    def after(cls, coordinates: int, arm: Arm, name: str, at: ArrayLike) -> Mount:
        """Return the mount of an arm that comes after so many coordinates."""
        return cls(name, arm, coordinates, arm.links, arm._model.armature, at)

    @structure
    def joint_names(self) -> tuple[str, ...]:
        """Names of its joints."""
        return tuple(map(str, list(self.arm._model.names)[1:]))

    @property
    def v(self) -> slice:
        """Its part of a velocity."""
        return slice(self.first, self.first + len(self.joint_names))

    @property
    def q(self) -> slice:
        """Its part of a configuration."""
        return self.v

    @property
    def joints(self) -> slice:
        """Its part of the joints of the robot's `model`."""
        return slice(self.v.start + 1, self.v.stop + 1)

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
        if not self.is_changed:
            return self.arm._model
        new = self.arm._model.copy()
        for joint, link in enumerate(self.links):
            new.inertias[joint] = link.body
        new.armature = np.array(self.rotors)
        return new

    @cached_property
    def is_changed(self) -> bool:
        """Whether its links or motors have other numbers than those of the arm as it was read."""
        return self != self.as_read

    @property
    def as_read(self) -> Mount:
        """The same with the links and motors that the arm was read with."""
        return Mount.after(self.first, self.arm, self.name, self.at)

    @property
    def moving(self) -> range:
        """Its joints' numbers in the robot's `model`."""
        return range(self.joints.start, self.joints.stop)

    def joint_of(self, item: pin.GeometryObject) -> tuple[int, pin.SE3]:
        """Return the joint of the robot's `model` that a shape of the arm is on, and its place there."""
        own = item.parentJoint
        return (self.v.start + own, item.placement) if own else (BODY_JOINT, self.placement * item.placement)

    @property
    def placement(self) -> pin.SE3:
        """Pose of its root in the body's frame."""
        return pin.SE3(pin.utils.rotate("z", self.at[3]), np.array(self.at[:3]))

    def __repr__(self) -> str:
        words = {"at": self.at, "name": self.name, **self.arm.options()}
        listed = ", ".join(f"{word}={value!r}" for word, value in words.items())
        return f".mount({self.arm.origin.value!r}, {listed})"


def _checked_size(name: str, value: Any) -> Any:
    return None if value is None else tuple(lengths(value).tolist())


@by_value
@part
class PayloadBody(RigidBody):
    """A rigid body that is fixed to a frame of a robot.

    Parameters
    ----------
    mass : float
        Mass [kg].
    com : sequence of 3 floats
        Centre of mass in the frame [m].
    inertia : array_like, shape (3, 3) or (6,), optional
        About the centre of mass, along the frame's axes [kg m^2]: the matrix, or xx, yy, zz, xy, xz, yz of
        it, as which it is kept. By default that of a homogeneous box of `size`, or none where there is no
        size: a point.
    size : sequence of 3 floats, optional
        Of the box about the centre of mass that is drawn [m].
    frame : str, optional
        The frame of the robot that it is attached to: see `MobileRobot.attach`.

    Raises
    ------
    InvalidArgument
        If no rigid body has these.
    """

    mass: float = number(unit="kg", above=0.0, doc="mass of the load")
    com: Any = com_field(shapes=((3,),), doc="centre of mass of the load")
    inertia: Any = inertia_field("the load")
    size: tuple[float, float, float] | None = option(
        default=None, check=_checked_size, doc="size of the box that is drawn"
    )
    frame: str = option(default="", doc="frame that it is attached to")

    def __init__(
        self,
        mass: ArrayLike,
        com: ArrayLike = (0.0, 0.0, 0.0),
        inertia: ArrayLike | None = None,
        size: ArrayLike | None = None,
        frame: str = "",
    ) -> None:
        six: Any = inertia
        if inertia is None:
            solid = np.zeros((3, 3)) if size is None else box_inertia(positive("mass", mass, "kg"), size)
            six = six_of(solid)
        elif finite("inertia", inertia).shape != (6,):
            given = finite("inertia", inertia)
            six = six_of(Body(positive("mass", mass, "kg"), finite("com", com), given).inertia)
        self.__attrs_init__(mass, com, six, size, frame)  # type: ignore[attr-defined]

    @property
    def called(self) -> str:
        """What it is called in messages."""
        return f"load at {self.frame}" if self.frame else "the load"

    def __repr__(self) -> str:
        own = matrix_of_six(self.inertia)
        solid = np.zeros((3, 3)) if self.size is None else box_inertia(self.mass, self.size)
        inertia = None if np.array_equal(own, solid) else tuple(map(tuple, own.tolist()))
        return f"PayloadBody(mass={self.mass!r}, com={self.com!r}, inertia={inertia!r}, size={self.size!r})"


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


def assemble(
    base: pin.Model, mounts: Sequence[Mount], loads: Sequence[PayloadBody] = (), *, at_origin: bool = False
) -> pin.Model:
    """Return the model of a body that carries arms, and loads at frames of either.

    Parameters
    ----------
    base : pin.Model
        The chain with the body; the body's frame is its last.
    mounts : sequence of Mount
        One after the other.
    loads : sequence of PayloadBody
        What is attached.
    at_origin : bool
        Whether the arms stand at the body's origin, instead of where they do.
    """
    model, body = base.copy(), base.nframes - 1
    for mount in mounts:
        place = pin.SE3.Identity() if at_origin else mount.placement
        model = pin.appendModel(model, prefixed(mount._model, mount.name), body, place)
    for mount in mounts:
        # Pinocchio forgets it when it appends; each arm keeps its own, joint by joint.
        model.armature[mount.v] = mount._model.armature
    model.name = base.name
    frames = named_frames(model)
    for load in loads:
        fixed = model.frames[frames[load.frame]]
        model.appendBodyToJoint(fixed.parentJoint, load.body, fixed.placement)
    return model


def named_frames(model: pin.Model) -> dict[str, int]:
    """Return the frames by name, links before joints of the same name."""
    ids: dict[str, int] = {}
    for k in range(1, model.nframes):
        frame = model.frames[k]
        if frame.name not in ids or frame.type == pin.FrameType.BODY:
            ids[frame.name] = k
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
