"""What rides on the body: arms and loads."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from pinmobile.arrays import ArrayLike, finite, lengths, positive, text
from pinmobile.errors import InvalidArgument, shown
from pinmobile.robot.arms import Arm
from pinmobile.urdf import Body, box_inertia

__all__ = [
    "Load",
    "Mount",
    "checked_name",
    "free_name",
    "mount_after",
    "on_top",
    "placed",
]


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
    """

    name: str
    at: tuple[float, float, float, float]
    arm: Arm
    q: slice
    v: slice
    joints: slice

    @property
    def tip(self) -> str:
        """Its end effector's frame in the robot's `model`."""
        return f"{self.name}/{self.arm.tip}"

    @property
    def model(self) -> pin.Model:
        """A copy of its own model, on a fixed base and with its own names."""
        return self.arm.model

    @property
    def _model(self) -> pin.Model:
        """The model itself, which is only read."""
        return self.arm._model

    @property
    def placement(self) -> pin.SE3:
        """Pose of its root in the body's frame."""
        return _placement(self.at)

    def __repr__(self) -> str:
        words = {"at": self.at, "name": self.name, **self.arm.options()}
        listed = ", ".join(f"{word}={value!r}" for word, value in words.items())
        return f".mount({self.arm.origin.value!r}, {listed})"

    def _key(self) -> tuple[object, ...]:
        return self.name, self.at, self.arm.key()

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


def on_top(top: float, arm: Arm) -> tuple[float, float, float, float]:
    """Return the mount point in the middle of a body of some height [m].

    What stands on its feet, or would otherwise hang below the ground, is as high as its lowest frame needs.
    """
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


def mount_after(model: pin.Model, arm: Arm, name: str, at: tuple[float, float, float, float]) -> Mount:
    """Return the mount of an arm that comes after all that is in a model."""
    own = arm._model
    q, v = (slice(n, n + more) for n, more in ((model.nq, own.nq), (model.nv, own.nv)))
    return Mount(name, at, arm, q, v, slice(model.njoints, model.njoints + own.njoints - 1))


def _placement(at: tuple[float, float, float, float]) -> pin.SE3:
    return pin.SE3(pin.utils.rotate("z", at[3]), np.array(at[:3]))
