"""Arrays and the robot of a rollout, to and from a NumPy archive."""

import json
import zipfile
from dataclasses import astuple
from pathlib import Path
from typing import IO, Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.dh import DHRow, DHTable, JointType
from pinmobile.errors import InvalidArgument, PinmobileError, shown
from pinmobile.robot import Load, MobileRobot
from pinmobile.robot.sources import kept_arm
from pinmobile.urdf import Body

__all__ = ["read_archive", "why_unknown", "write_archive"]

_FORMAT = "pinmobile rollout 1"


def write_archive(file: IO[bytes], arrays: dict[str, Array], robot: object) -> None:
    """Write the arrays, and the parameters of the robot where it is a `MobileRobot`.

    Parameters
    ----------
    file : binary file
        Where to.
    arrays : dict of str to ndarray
        Arrays of any shape.
    robot : object
        The plant; any that is not a `MobileRobot`, or carries an arm without a name or a file, is left out.
    """
    described = _describe(robot) if isinstance(robot, MobileRobot) and _is_known(robot) else None
    np.savez(file, allow_pickle=False, format=_FORMAT, robot=json.dumps(described), **arrays)


def read_archive(path: Path) -> tuple[dict[str, Array], MobileRobot | None]:
    """Return what `write_archive` wrote; None for a robot that cannot be had again, see `why_unknown`.

    Raises
    ------
    InvalidArgument
        If the file cannot be read or is no such archive.
    """
    named, described = _read(path)
    try:
        return named, _restore(described)
    except PinmobileError:
        return named, None


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
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            named = dict(archive)
    except OSError as error:
        raise InvalidArgument(
            f"path is {shown(str(path))}, which cannot be read: {error.strerror}"
        ) from error
    except (ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise InvalidArgument(f"path is {shown(str(path))}, which is no NumPy archive") from error
    if str(named.pop("format", "")) != _FORMAT:
        raise InvalidArgument(f"path is {shown(str(path))}, which is no {_FORMAT!r} archive")
    return named, json.loads(str(named.pop("robot")))


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
    rows = tuple(
        DHRow(alpha, a, theta, d, JointType(joint), variable)
        for alpha, a, theta, d, joint, variable in described["dh"]
    )
    body = Body(described["mass"], described["com"], described["inertia"])
    robot = MobileRobot.from_body(body, tuple(described["size"]), DHTable(rows), described["source"])
    mounts = described.get("mounts", ())
    for mount in mounts:
        name, at = mount.pop("name"), mount.pop("at")
        robot = robot.mount(kept_arm(**mount), at, name=name)
    for frame, mass, com, inertia, size in described.get("loads", ()):
        robot = robot.attach(Load(mass, com, inertia, size), frame)
    found, kept = robot.inertial_parameters, described.get("inertias")
    if kept is not None and not np.array_equal(found, kept):
        files = ", ".join(mount["arm"] for mount in mounts)
        raise InvalidArgument(f"its masses and inertias are no longer those that were kept: see {files}")
    return robot
