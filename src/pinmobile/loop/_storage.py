"""Arrays, plant and signals of a rollout, to and from a NumPy archive."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, astuple
from pathlib import Path
from typing import IO, Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.dh import DHRow, DHTable, JointType
from pinmobile.errors import InvalidArgument, PinmobileError
from pinmobile.files import archive_of
from pinmobile.parts import evolved, numbers, replace
from pinmobile.plant import Coordinate, Input, PlantOutline
from pinmobile.robot import MobileRobot, PayloadBody, Stance, kept_arm
from pinmobile.signals import Signal
from pinmobile.urdf import Body

RECORDED = ("t", "q", "v", "a", "u", "error", "reference_q", "reference_v", "reference_a")
"""Names of the arrays of a rollout."""

_FORMAT = "pinmobile rollout 3"


def write_archive(file: IO[bytes], rollout: Any) -> None:
    """Write a rollout's arrays, and in words what `described_run` returns.

    Parameters
    ----------
    file : binary file
        Where to.
    rollout : Rollout
        What is written; its signals stand side by side in one array, ``signals``.
    """
    text, beside = json.dumps(described_run(rollout)), signal_columns(rollout.signals, len(rollout))
    np.savez(file, allow_pickle=False, format=_FORMAT, plant=text, signals=beside, **rollout.arrays())


def described_run(rollout: Any) -> dict[str, Any]:
    """Return what a rollout has beside its arrays, as JSON can hold it.

    That is the plant in words, its parameters where it is a `MobileRobot`, the names and units of signals,
    and how it was made.
    """
    plant, q, signals = rollout.plant, rollout.q, rollout.signals
    return {
        "engine": rollout.engine,
        "fallback_reason": rollout.fallback_reason,
        "robot": described_robot(plant),
        "unknown": _unkept(plant),
        "outline": None if plant is None else asdict(PlantOutline.of(plant, q)),
        "signals": [[name, unit, list(x.shape[1:])] for name, (unit, x) in signals.items()],
    }


def signal_columns(signals: Mapping[str, Signal], rows: int) -> Array:
    """Return signals side by side, shape (rows, ...)."""
    columns = [values.reshape(rows, -1) for _, values in signals.values()]
    return np.hstack(columns) if columns else np.zeros((rows, 0))


def restored_run(described: Mapping[str, Any], beside: Array) -> dict[str, Any]:
    """Return plant, signals, engine and why of a description; of a plant that is not at hand, the outline.

    Parameters
    ----------
    described : mapping
        What `described_run` returned; a file of before may say nothing of how it was made.
    beside : ndarray, shape (N + 1, ...)
        What `signal_columns` returned.
    """
    outline = None if described["outline"] is None else _outline(described["outline"])
    signals = _split(beside, described["signals"])
    robot = _restored_robot(described["robot"])
    made = {name: described.get(name, "") for name in ("engine", "fallback_reason")}
    return {"plant": outline if robot is None else robot, "signals": signals, **made}


def read_archive(path: Path) -> tuple[dict[str, Array], dict[str, Any]]:
    """Return what `write_archive` wrote: arrays, and what `restored_run` returns.

    Of a plant that cannot be had again, see `why_unknown`, it is the outline; None where none was known.

    Raises
    ------
    InvalidArgument
        If the file cannot be read or is no such archive.
    """
    named, described = _read(path)
    beside = named.pop("signals")
    return named, restored_run(described, beside)


def why_unknown(path: Path) -> str:
    """Return why `read_archive` has no robot though it was one; nothing where it has, or of other plants.

    Raises
    ------
    InvalidArgument
        If the file cannot be read or is no such archive.
    """
    described = _read(path)[1]
    if described["robot"] is None:
        return str(described["unknown"])
    try:
        _restore(described["robot"])
    except PinmobileError as error:
        return str(error)
    return ""


def _read(path: Path) -> tuple[dict[str, Array], dict[str, Any]]:
    return archive_of(path, _FORMAT, "plant", dict.fromkeys((*RECORDED, "signals"), np.float64))


def _unkept(plant: object) -> str:
    """Return why an archive does not keep a robot; nothing where it does, or it is another plant."""
    if isinstance(plant, MobileRobot) and not _is_known(plant):
        return "it had an arm of a pin.Model, which an archive cannot keep"
    return ""


def _outline(described: Mapping[str, Any]) -> PlantOutline:
    """Return the outline of a plant of its fields, as JSON had them."""
    given: dict[str, Any] = dict(described) | {
        "coordinates": tuple(Coordinate(*one) for one in described["coordinates"]),
        "inputs": tuple(Input(*one) for one in described["inputs"]),
        "reference_sizes": {int(n): size for n, size in described["reference_sizes"].items()},
    }
    found: dict[str, Any] = {name: tuple(x) if isinstance(x, list) else x for name, x in given.items()}
    return PlantOutline(**found)


def _split(columns: Array, described: Any) -> dict[str, Signal]:
    """Return the signals that stand side by side."""
    found: dict[str, Signal] = {}
    start = 0
    for name, unit, more in described:
        stop = start + (more[0] if more else 1)
        part = columns[:, start:stop]
        found[name] = Signal(unit, part if more else part[:, 0])
        start = stop
    return found


def described_robot(robot: object) -> dict[str, Any] | None:
    """Return the parameters of a robot, as JSON can hold them.

    None for what is no `MobileRobot`, or carries an arm without a name or a file.
    """
    return _describe(robot) if isinstance(robot, MobileRobot) and _is_known(robot) else None


def _restored_robot(described: dict[str, Any] | None) -> MobileRobot | None:
    """Return the robot of a description that is checked; None where it cannot be had again."""
    try:
        return _restore(described)
    except PinmobileError:
        return None


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
        "source": robot.base.source,
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
        "changes": _changed(robot),
        "loads": [
            [load.frame, load.mass, load.com, load.inertia.tolist(), load.size] for load in robot.loads
        ],
    }


def _changed(robot: MobileRobot) -> dict[str, Any]:
    """Return the numbers of arms that are not those of the arms as they were read, by path."""
    own = numbers(evolved(robot, {"mounts": tuple(mount.as_read for mount in robot.mounts)}))
    found = ((path, np.asarray(leaf.value)) for path, leaf in numbers(robot).items())
    return {path: value.tolist() for path, value in found if not np.array_equal(value, own[path].value)}


def _restore(described: dict[str, Any] | None) -> MobileRobot:
    """Return the robot.

    Raises
    ------
    PinmobileError
        If there is none, or a file of an arm is no longer there, or no longer what it was.
    """
    if described is None:
        raise InvalidArgument("it was no MobileRobot, or had an arm of a pin.Model")
    robot = _base(described)
    mounts = described.get("mounts", ())
    for mount in mounts:
        name, at = mount.pop("name"), mount.pop("at")
        robot = robot.mount(kept_arm(**mount), at, name=name)
    for frame, mass, com, inertia, size in described.get("loads", ()):
        robot = robot.attach(PayloadBody(mass, com, inertia, size), frame)
    changes = described.get("changes", {})
    robot = replace(robot, changes) if changes else robot
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
    return np.stack([robot.joint_damping, robot.joint_friction, robot.model.armature])


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
