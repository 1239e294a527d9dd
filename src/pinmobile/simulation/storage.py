"""Arrays and the robot of a rollout, to and from a NumPy archive."""

import json
import zipfile
from dataclasses import astuple
from pathlib import Path
from typing import IO, Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.dh import DHRow, DHTable, JointType
from pinmobile.errors import InvalidArgument
from pinmobile.robot import MobileRobot
from pinmobile.urdf import Body

__all__ = ["read_archive", "write_archive"]

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
        The plant; any that is not a `MobileRobot` is left out.
    """
    described = _describe(robot) if isinstance(robot, MobileRobot) else None
    np.savez(file, allow_pickle=False, format=_FORMAT, robot=json.dumps(described), **arrays)


def read_archive(path: Path) -> tuple[dict[str, Array], MobileRobot | None]:
    """Return what `write_archive` wrote.

    Raises
    ------
    InvalidArgument
        If the file cannot be read or is no such archive.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            named = dict(archive)
    except OSError as error:
        raise InvalidArgument(f"path is {str(path)!r}, which cannot be read: {error.strerror}") from error
    except (ValueError, TypeError, EOFError, zipfile.BadZipFile) as error:
        raise InvalidArgument(f"path is {str(path)!r}, which is no NumPy archive") from error
    if str(named.pop("format", "")) != _FORMAT:
        raise InvalidArgument(f"path is {str(path)!r}, which is no {_FORMAT!r} archive")
    described = json.loads(str(named.pop("robot")))
    return named, None if described is None else _restore(described)


def _describe(robot: MobileRobot) -> dict[str, Any]:
    # JSON keeps every digit of a float.
    return {
        "mass": robot.mass,
        "com": robot.com,
        "inertia": robot.body.inertia.tolist(),
        "size": robot.size,
        "dh": [(*astuple(row)[:4], row.joint.value, row.variable) for row in robot.dh],
        "source": robot.source,
    }


def _restore(described: dict[str, Any]) -> MobileRobot:
    rows = tuple(
        DHRow(alpha, a, theta, d, JointType(joint), variable)
        for alpha, a, theta, d, joint, variable in described["dh"]
    )
    body = Body(described["mass"], described["com"], described["inertia"])
    return MobileRobot.from_body(body, tuple(described["size"]), DHTable(rows), described["source"])
