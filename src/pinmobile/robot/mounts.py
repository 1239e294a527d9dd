"""Arms and loads on the body, and the model of the body with arms and loads."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike, finite, lengths, positive
from pinmobile.errors import InvalidArgument
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
    """Arm with its placement on the body; an entry of `MobileRobot.mounts`.

    Attributes
    ----------
    name : str
        Name of the arm. The names of its joints and frames are ``name/...``.
    arm : Arm
        Arm as read from its file; `arm.model` is its model.
    first : int
        Index of its first coordinate in the robot's coordinates.
    links : tuple of Link
        Body that is fixed to its root, then the body on each joint.
    rotors : ndarray, shape (joints,)
        Inertia of the motors, as seen by the joints [kg m^2; kg for a prismatic joint].
    at : tuple of 4 floats
        Placement of its root on the body: x, y, z and yaw [m, m, m, rad].

    See Also
    --------
    MobileRobot.mount : add an arm
    robot.Arm : arm as read from its file

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> robot = MobileRobot.box(mass=60.0).mount("ur5", at=(0.2, 0, 0.3, 0))
    >>> (mount,) = robot.mounts
    >>> mount.name, mount.at
    ('ur5', (0.2, 0.0, 0.3, 0.0))
    >>> robot.rest[mount.q].size  # joints of the arm
    6
    """

    name: str = option(doc="name of the arm")
    arm: Arm = option(doc="the arm as it was read")
    first: int = option(doc="index of its first coordinate")
    links: tuple[Link, ...] = children(Link, doc="rigidly connected links of the arm")
    rotors: Any = array(
        unit="kg m^2",
        lower=0.0,
        labels=lambda mount: mount.joint_names,
        doc="inertia of motors at the joints, kg for a prismatic joint",
    )
    at: Any = declare(
        Entries(
            "placement of the arm", "m, m, m, rad", shapes=((4,),), labels=("x", "y", "z", "yaw"), length=4
        )
    )

    @classmethod
    def create(cls, coordinates: int, arm: Arm, name: str, at: ArrayLike) -> Mount:
        """Return the mount of an arm after a number of coordinates.

        Parameters
        ----------
        coordinates : int
            Number of coordinates before the arm.
        arm : Arm
            Arm.
        name : str
            Name of the arm.
        at : array_like, shape (4,)
            Placement of its root on the body [m, m, m, rad].
        """
        return cls(name, arm, coordinates, arm.links, arm._model.armature, at)

    @structure
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(map(str, list(self.arm._model.names)[1:]))

    @property
    def v(self) -> slice:
        """Slice of the arm in a velocity."""
        return slice(self.first, self.first + len(self.joint_names))

    @property
    def q(self) -> slice:
        """Slice of the arm in a configuration."""
        return self.v

    @property
    def joints(self) -> slice:
        """Slice of the arm's joints in the robot's `model`."""
        return slice(self.v.start + 1, self.v.stop + 1)

    @property
    def tip(self) -> str:
        """Name of the end effector's frame in the robot's `model`."""
        return f"{self.name}/{self.arm.tip}"

    @property
    def model(self) -> pin.Model:
        """Copy of the arm's model, on a fixed base and with the names of its file."""
        return self._model.copy()

    @cached_property
    def _model(self) -> pin.Model:
        """Model of the arm itself; no code writes into this object."""
        if not self.is_changed:
            return self.arm._model
        new = self.arm._model.copy()
        for joint, link in enumerate(self.links):
            new.inertias[joint] = link.body
        new.armature = np.array(self.rotors)
        return new

    @cached_property
    def is_changed(self) -> bool:
        """Whether the numbers of links or motors differ from those of the file."""
        return self != Mount.create(self.first, self.arm, self.name, self.at)

    def joint_of(self, item: pin.GeometryObject) -> tuple[int, pin.SE3]:
        """Return the joint of the robot's `model` that carries a shape of the arm, and the placement.

        Parameters
        ----------
        item : pin.GeometryObject
            Shape of the arm.
        """
        k = item.parentJoint
        return (self.v.start + k, item.placement) if k else (BODY_JOINT, self.placement * item.placement)

    @property
    def placement(self) -> pin.SE3:
        """Pose of the arm's root in the body frame."""
        return pin.SE3(pin.utils.rotate("z", self.at[3]), np.array(self.at[:3]))

    def __repr__(self) -> str:
        words = {"at": self.at, "name": self.name, **self.arm.options()}
        options = ", ".join(f"{word}={value!r}" for word, value in words.items())
        return f".mount({self.arm.origin.value!r}, {options})"


def _checked_size(name: str, value: Any) -> Any:
    return None if value is None else tuple(lengths(value).tolist())


@by_value
@part
class PayloadBody(RigidBody):
    """Rigid body (a load) that is fixed to a frame of a robot.

    Parameters
    ----------
    mass : float
        Mass [kg].
    com : sequence of 3 floats
        Centre of mass in the frame [m].
    inertia : array_like, shape (3, 3) or (6,), optional
        Inertia about the centre of mass, along the frame's axes [kg m^2]: a matrix, or its entries xx, yy,
        zz, xy, xz, yz. By default, the inertia of a homogeneous box of this mass, also in a spread, and of
        dimensions `size`; zero (a point mass) without `size`.
    size : sequence of 3 floats, optional
        Dimensions of the drawn box about the centre of mass [m].
    frame : str, optional
        Frame of the robot that carries the load. `MobileRobot.attach` sets this name.

    Raises
    ------
    InvalidArgument
        If no rigid body has these values.

    See Also
    --------
    MobileRobot.attach : fix a load to a frame
    forces.PayloadForce : force of an unmodelled load in a simulation

    Examples
    --------
    >>> from pinmobile import MobileRobot, PayloadBody
    >>> crate = PayloadBody(10.0, com=(0.2, 0, 0.3), size=(0.2, 0.2, 0.2))
    >>> loaded = MobileRobot.box(mass=30.0).attach(crate)
    >>> whole = loaded.with_locked_arms()
    >>> whole.mass, whole.com  # [kg, m]
    (40.0, (0.05, 0.0, 0.15))
    """

    mass: float = number(unit="kg", above=0.0, doc="mass of the load")
    com: Any = com_field(shapes=((3,),), doc="centre of mass of the load")
    inertia: Any = inertia_field("the load", default=None)
    size: tuple[float, float, float] | None = option(
        default=None, check=_checked_size, doc="dimensions of the drawn box"
    )
    frame: str = option(default="", doc="frame that carries the load")

    def __init__(
        self,
        mass: ArrayLike,
        com: ArrayLike = (0.0, 0.0, 0.0),
        inertia: ArrayLike | None = None,
        size: ArrayLike | None = None,
        frame: str = "",
    ) -> None:
        six: Any = inertia
        if inertia is not None and finite("inertia", inertia).shape != (6,):
            given = finite("inertia", inertia)
            six = six_of(Body(positive("mass", mass, "kg"), finite("com", com), given).inertia)
        self.__attrs_init__(mass, com, six, size, frame)  # type: ignore[attr-defined]

    @property
    def label(self) -> str:
        """Name of the load in messages."""
        return f"load at {self.frame}" if self.frame else "the load"

    @property
    def moments(self) -> Any:
        """Inertia (xx, yy, zz, xy, xz, yz) about the centre of mass [kg m^2], by default that of the box."""
        if self.inertia is not None:
            return self.inertia
        box = np.zeros(6) if self.size is None else six_of(box_inertia(1.0, self.size))
        return self.mass * box

    def impossible(self, values: Mapping[str, Array]) -> tuple[NDArray[np.bool_], str]:
        """Return which of several values no rigid body has; a box has any mass."""
        if self.inertia is None:
            return np.zeros(np.shape(values.get("mass", self.mass)), bool), ""
        return super().impossible(values)

    def __repr__(self) -> str:
        inertia = None
        if self.inertia is not None:
            inertia = tuple(map(tuple, matrix_of_six(self.inertia).tolist()))
        return f"PayloadBody(mass={self.mass!r}, com={self.com!r}, inertia={inertia!r}, size={self.size!r})"


def free_place(mounts: Sequence[Mount], top: float | None, arm: Arm) -> tuple[float, float, float, float]:
    """Return the default placement at the middle of a body with the height `top` of its highest point [m].

    An arm that stands on its feet, or would reach below the ground, is raised by the depth of its lowest
    frame.

    Raises
    ------
    InvalidArgument
        If the height is not known, or another arm is at the middle.
    """
    middle = next((mount.name for mount in mounts if mount.at[:2] == (0.0, 0.0)), None)
    if top is None or middle is not None:
        reason = (
            "the top of the robot is not known" if top is None else f"{middle!r} is already in the middle"
        )
        hint = "; robot.source says what the file lacks" * (top is None)
        label = f"at is not given for {arm.origin.value!r}"
        raise InvalidArgument(f"{label}, and {reason}, expected x, y, z and yaw{hint}")
    depth = arm.reach_down()
    return 0.0, 0.0, top + depth if arm.stands or depth > top else top, 0.0


def free_name(name: str, taken: Iterable[str]) -> str:
    """Return the name, with a number appended if the name is taken."""
    names, number, free = set(taken), 1, name
    while free in names:
        number += 1
        free = f"{name}_{number}"
    return free


def assemble(
    base: pin.Model, mounts: Sequence[Mount], loads: Sequence[PayloadBody] = (), *, at_origin: bool = False
) -> pin.Model:
    """Return the model of a body with arms, and with loads at frames of body and arms.

    Parameters
    ----------
    base : pin.Model
        Chain with the body; the body frame is its last frame.
    mounts : sequence of Mount
        Arms in their order.
    loads : sequence of PayloadBody
        Attached loads.
    at_origin : bool
        Whether all arms are placed at the body's origin.
    """
    model, body = base.copy(), base.nframes - 1
    for mount in mounts:
        place = pin.SE3.Identity() if at_origin else mount.placement
        model = pin.appendModel(model, add_scope(mount._model, mount.name), body, place)
    for mount in mounts:
        # appendModel drops the armature.
        model.armature[mount.v] = mount._model.armature
    model.name = base.name
    frames = named_frames(model)
    for load in loads:
        fixed = model.frames[frames[load.frame]]
        model.appendBodyToJoint(fixed.parentJoint, load.body, fixed.placement)
    return model


def named_frames(model: pin.Model) -> dict[str, int]:
    """Return the indices of the frames by name; a link has priority over a joint of the same name."""
    ids: dict[str, int] = {}
    for k in range(1, model.nframes):
        frame = model.frames[k]
        if frame.name not in ids or frame.type == pin.FrameType.BODY:
            ids[frame.name] = k
    return ids


def add_scope(model: pin.Model, name: str) -> pin.Model:
    """Return a copy with all names ``name/...``; a frame with the name of a link gets a number."""
    copy = model.copy()
    for joint in range(1, copy.njoints):
        copy.names[joint] = f"{name}/{copy.names[joint]}"
    taken = {frame.name for frame in copy.frames if frame.type == pin.FrameType.BODY}
    for frame in copy.frames:
        own = str(frame.name)
        if frame.type != pin.FrameType.BODY:
            # Pinocchio finds a link only by its name.
            own = free_name(own, taken)
            taken.add(own)
        frame.name = f"{name}/{own}"
    return copy
