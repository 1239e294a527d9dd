"""The robots of example-robot-data by their names, and those among them that cannot be mounted."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import pinocchio as pin

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument, PinmobileError, UnknownName
from pinmobile.robot.arms import Arm, Origin, Picture
from pinmobile.robot.pictures import FilePicture, GivenPicture

__all__ = ["EXCEPTIONS", "Exceptional", "Mountable", "Mountables", "load_arm", "mountable"]

_FINGERS = (
    "its fingers have no inertia: lock bravo_finger1_joint and bravo_finger2_joint "
    "(locked=, or --lock of the command)"
)
_UNSEEN = "its loader has no visuals: there is nothing to draw of it"


class Exceptional(NamedTuple):
    """What is exceptional about a name: whether it mounts as it is, and the reason."""

    mounts: bool
    reason: str


EXCEPTIONS: dict[str, Exceptional] = {
    "bluevolta_bravo7_gripper": Exceptional(False, _FINGERS),
    "bravo7_gripper": Exceptional(False, _FINGERS),
    "cassie": Exceptional(False, "its loader reads SDF, which Pinocchio's wheels are built without"),
    "falcon_bravo7_gripper": Exceptional(False, _FINGERS),
    "icub": Exceptional(
        False,
        "its reference posture aligns neck_pitch and neck_roll with no inertia between: try icub_reduced",
    ),
    "romeo": Exceptional(
        False, "24 joints of its hands, RHand and LHand beside fingers and thumbs, have no inertia"
    ),
    "simple_humanoid": Exceptional(True, _UNSEEN),
    "simple_humanoid_classical": Exceptional(True, _UNSEEN),
}
"""Names that `MobileRobot.mount` refuses as they are, or that are not drawn, and why."""


@dataclass(frozen=True)
class Mountable:
    """A robot that can be mounted by its name.

    Attributes
    ----------
    name : str
        What `MobileRobot.mount` takes.
    joints : int
        Degrees of freedom that it brings, without a root and wheels.
    mass : float
        Of the whole of it [kg].
    note : str
        What it lacks, where it lacks something, such as visuals.
    """

    name: str
    joints: int
    mass: float
    note: str = ""


@dataclass(frozen=True)
class Mountables:
    """All robots that can be mounted by name; printed, it is a table, and ``[name]`` is a row of it.

    Attributes
    ----------
    rows : tuple of Mountable
        In the order of their names.
    exceptions : tuple of (str, str)
        Names that the loaders know and that do not mount, with the reason.

    Raises
    ------
    UnknownName
        If a row is asked for that is not there.
    """

    rows: tuple[Mountable, ...]
    exceptions: tuple[tuple[str, str], ...]

    def __iter__(self) -> Iterator[Mountable]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __contains__(self, name: object) -> bool:
        return name in self.names or name in self.rows

    def __getitem__(self, name: str) -> Mountable:
        if name not in self.names:
            raise UnknownName("mountable robot", str(name), self.names)
        return self.rows[self.names.index(name)]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the rows."""
        return tuple(row.name for row in self.rows)

    def __str__(self) -> str:
        width = max(len(name) for name in (*self.names, *(name for name, _ in self.exceptions)))
        lines = [f"{'name':{width}} {'joints':>6} {'mass [kg]':>10}"]
        lines += [
            f"{row.name:{width}} {row.joints:6d} {row.mass:10.3f}  {row.note}".rstrip() for row in self.rows
        ]
        lines += [f"{name:{width}} not: {reason}" for name, reason in self.exceptions]
        return "\n".join(lines)


@lru_cache(maxsize=1)
def mountable() -> Mountables:
    """Return the robots of example-robot-data that `MobileRobot.mount` knows by name.

    It reads each of them once, without its meshes, which takes two seconds; after that it is remembered.
    """
    rows = []
    for name in sorted(_loaders()):
        mounts, note = EXCEPTIONS.get(name, Exceptional(True, ""))
        if mounts:
            model = load_arm(name)._model
            mass = sum(inertia.mass for inertia in model.inertias)
            rows.append(Mountable(name, model.nv, mass, note))
    refused = ((name, reason) for name, (mounts, reason) in sorted(EXCEPTIONS.items()) if not mounts)
    return Mountables(tuple(rows), tuple(refused))


def load_arm(name: str, locked: tuple[str, ...] = ()) -> Arm:
    """Return a robot of example-robot-data.

    Raises
    ------
    UnknownName
        If there is none of that name.
    InvalidArgument
        If its loader fails, or it cannot be mounted.
    """
    loaders = _loaders()
    if name not in loaders:
        raise UnknownName("arm", name, sorted(loaders))
    loader = loaders[name]
    try:
        model, rest, picture = _made(loader) if _does_more(loader) else _read(loader)
    except PinmobileError:
        raise
    except Exception as error:
        known = EXCEPTIONS.get(name)
        reason = known.reason if known else str(error) or type(error).__name__
        raise InvalidArgument(f"arm {name!r} cannot be loaded: {reason}") from error
    return Arm(Origin("loader", name), model, rest, picture, locked, bool(loader.free_flyer))


def _loaders() -> dict[str, Any]:
    from example_robot_data import ROBOTS

    return dict(ROBOTS)


def _does_more(loader: Any) -> bool:
    """Tell whether the loader does more than read a URDF."""
    return "__init__" in vars(loader) or not loader.urdf_filename


def _made(loader: Any) -> tuple[pin.Model, Array, Picture]:
    robot = loader().robot
    return robot.model, robot.q0, GivenPicture(robot.visual_model)


def _read(loader: Any) -> tuple[pin.Model, Array, Picture]:
    """Return what the loader would read, without the meshes, which take a hundred times as long."""
    from example_robot_data import getModelPath, readParamsFromSrdf

    folder = Path(loader.path)
    urdf = folder / loader.urdf_subpath / loader.urdf_filename
    home = Path(getModelPath(str(urdf)))
    model = pin.buildModelFromUrdf(str(home / urdf))
    rest = pin.neutral(model)
    if loader.srdf_filename:
        srdf = home / folder / loader.srdf_subpath / loader.srdf_filename
        rest = readParamsFromSrdf(model, str(srdf), False, loader.has_rotor_parameters, loader.ref_posture)
    return model, rest, FilePicture(home / urdf, (home.parents[1],))
