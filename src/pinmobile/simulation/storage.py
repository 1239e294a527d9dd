"""Arrays and the robot of a rollout, to and from a NumPy archive."""

import json
from collections.abc import Mapping
from dataclasses import astuple
from pathlib import Path
from typing import IO, Any

import numpy as np

from pinmobile.arrays import Array, finite
from pinmobile.dh import DHRow, DHTable, JointType
from pinmobile.errors import InvalidArgument, PinmobileError
from pinmobile.files import archive_of, unpacking
from pinmobile.robot import Load, MobileRobot, Stance
from pinmobile.robot.sources import kept_arm
from pinmobile.urdf import Body

__all__ = [
    "ARRAYS",
    "check_robot",
    "described_robot",
    "read_archive",
    "restored_robot",
    "why_unknown",
    "write_archive",
]

ARRAYS = ("t", "q", "v", "a", "tau", "error", "reference_q", "reference_v", "reference_a")
"""Names of the arrays of a rollout."""

_FORMAT = "pinmobile rollout 1"
_MOUNT: Mapping[str, type] = {
    "name": str,
    "at": list,
    "arm": str,
    "package_dirs": list,
    "locked": list,
    "rest": list,
}


def write_archive(file: IO[bytes], arrays: dict[str, Array], robot: object) -> None:
    """Write the arrays, and the parameters of the robot where it is a `MobileRobot`.

    Parameters
    ----------
    file : binary file
        Where to.
    arrays : dict of str to ndarray
        Those of `ARRAYS`.
    robot : object
        The plant, see `described_robot`.
    """
    described = json.dumps(described_robot(robot))
    np.savez(file, allow_pickle=False, format=_FORMAT, robot=described, **arrays)


def read_archive(path: Path) -> tuple[dict[str, Array], MobileRobot | None]:
    """Return what `write_archive` wrote; None for a robot that cannot be had again, see `why_unknown`.

    Raises
    ------
    InvalidArgument
        If the file cannot be read or is no such archive.
    """
    named, described = _read(path)
    return named, restored_robot(described)


def why_unknown(path: Path) -> str:
    """Return why `read_archive` has no robot; nothing where it has one.

    Raises
    ------
    InvalidArgument
        If the file cannot be read or is no such archive.
    """
    try:
        _restore(_read(path)[1])
    except PinmobileError as error:
        return str(error)
    return ""


def _read(path: Path) -> tuple[dict[str, Array], dict[str, Any] | None]:
    named, described = archive_of(path, _FORMAT, "robot", dict.fromkeys(ARRAYS, np.float64))
    with unpacking(path, _FORMAT):
        check_robot(described)
    return named, described


def described_robot(robot: object) -> dict[str, Any] | None:
    """Return the parameters of a robot, as JSON can hold them.

    None for what is no `MobileRobot`, or carries an arm without a name or a file.
    """
    return _describe(robot) if isinstance(robot, MobileRobot) and _is_known(robot) else None


def restored_robot(described: dict[str, Any] | None) -> MobileRobot | None:
    """Return the robot of a description that is checked; None where it cannot be had again."""
    try:
        return _restore(described)
    except PinmobileError:
        return None


def check_robot(described: dict[str, Any] | None) -> None:
    """Refuse what `described_robot` cannot have given; whether the files of arms are there is not asked.

    Raises
    ------
    ValueError, TypeError, LookupError, AttributeError, OverflowError
        If it is something else, see `unpacking`.
    """
    if described is None:
        return
    _base(described)
    for mount in described.get("mounts", ()):
        if {name: type(value) for name, value in mount.items()} != _MOUNT:
            raise ValueError(f"robot has a mount of {', '.join(mount)}, expected {', '.join(_MOUNT)}")
        finite("robot's at", mount["at"])
        finite("robot's rest", mount["rest"])
    for frame, *load in described.get("loads", ()):
        Load(*load)
        frame.encode()


def _is_known(robot: MobileRobot) -> bool:
    return all(mount.arm.origin.kind != "model" for mount in robot.mounts)


def _describe(robot: MobileRobot) -> dict[str, Any]:
    # JSON keeps every digit of a float.
    return {
        "mass": robot.mass,
        "com": robot.com,
        "inertia": robot.body.inertia.tolist(),
        "size": robot.size,
        "dh": [(*astuple(row)[:4], row.joint.value, row.variable) for row in robot.dh],
        "source": robot.source,
        "stance": [None if robot.footprint is None else robot.footprint.tolist(), robot.top, robot.grounded],
        "locked_joints": robot.locked_joints,
        "mounts": [
            {
                "name": mount.name,
                "at": mount.at,
                "arm": mount.arm.origin.value,
                "package_dirs": mount.arm.origin.package_dirs,
                "locked": mount.arm.locked,
                "rest": mount.arm.rest.tolist(),
            }
            for mount in robot.mounts
        ],
        "inertias": robot.inertial_parameters.tolist(),
        "joints": _of_joints(robot).tolist(),
        "loads": [[frame, load.mass, load.com, load.inertia, load.size] for frame, load in robot.loads],
    }


def _restore(described: dict[str, Any] | None) -> MobileRobot:
    """Return the robot.

    Raises
    ------
    PinmobileError
        If there is none, or a file of an arm is no longer there, or no longer what it was.
    """
    if described is None:
        raise InvalidArgument(
            "it was no MobileRobot, or had an arm of a pin.Model, which an archive cannot keep"
        )
    robot = _base(described)
    mounts = described.get("mounts", ())
    for mount in mounts:
        name, at = mount.pop("name"), mount.pop("at")
        robot = robot.mount(kept_arm(**mount), at, name=name)
    for frame, mass, com, inertia, size in described.get("loads", ()):
        robot = robot.attach(Load(mass, com, inertia, size), frame)
    files = ", ".join(mount["arm"] for mount in mounts)
    for what, key, found in (
        ("masses and inertias", "inertias", robot.inertial_parameters),
        ("joints' damping, friction and rotors", "joints", _of_joints(robot)),
    ):
        kept = described.get(key)
        if kept is not None and not np.array_equal(found, kept):
            raise InvalidArgument(f"its {what} are no longer those that were kept: see {files}")
    return robot


def _of_joints(robot: MobileRobot) -> Array:
    return np.stack([robot.joint_damping, robot.joint_friction, robot._model.armature])


def _base(described: Mapping[str, Any]) -> MobileRobot:
    """Return the robot without what is mounted on it."""
    rows = tuple(
        DHRow(alpha, a, theta, d, JointType(joint), variable)
        for alpha, a, theta, d, joint, variable in described["dh"]
    )
    return MobileRobot.from_body(
        Body(described["mass"], described["com"], described["inertia"]),
        tuple(described["size"]),
        DHTable(rows),
        described["source"],
        stance=Stance(*described["stance"]) if "stance" in described else None,
        locked_joints=described.get("locked_joints", ()),
    )
