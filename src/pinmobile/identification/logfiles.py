"""Files of logs: CSV; bags of ROS 1 and ROS 2 and MCAP files, read without ROS."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from typing import Any

import numpy as np

from pinmobile.arrays import Array, location, one_of, sequence, text
from pinmobile.errors import InvalidArgument, UnknownName, shown
from pinmobile.extras import imported
from pinmobile.files import refusals

_ROLES = ("q", "u", "twist", "wheel_rates")
_STAMPS = ("header", "bag")
_NANO = 1e-9

Row = Callable[[Any], Any]


def read_csv(
    path: str | PathLike[str], columns: Mapping[str, str | Sequence[str]] | None
) -> tuple[dict[str, Array], int]:
    """Return the columns of a file by role, and how many rows are of another length; see `Log.from_csv`."""
    file = location("path", path)
    with (
        refusals("read", "path", file),
        file.open(newline="", encoding="utf-8-sig", errors="replace") as opened,
    ):
        lines = csv.reader(opened)
        head = next(lines, [])
        rows = [row for row in lines if row]
    named = {re.sub(r"\s*\[.*\]\s*$", "", title).strip(): k for k, title in enumerate(head)}
    if columns is not None and not isinstance(columns, Mapping):
        raise InvalidArgument(f"columns is {shown(columns)}, expected a mapping such as {{'t': 'time', ...}}")
    wanted = _columns_of(list(named)) if columns is None else dict(columns)
    for role in wanted:
        one_of("part of a log", role, ("t", *_ROLES))
    numbers = np.array([[_number(cell) for cell in row] for row in rows if len(row) == len(head)])
    if len(numbers) < 2:
        raise InvalidArgument(
            f"path is {str(file)!r}, with {len(numbers)} rows of as many columns as its header, expected more"
        )
    parts: dict[str, Array] = {}
    for role, of_role in wanted.items():
        listed = [of_role] if isinstance(of_role, str) else sequence(f"columns[{role!r}]", of_role, "names")
        for name in listed:
            one_of(f"column of {str(file)!r}", name, named)
        parts[role] = np.column_stack([_in_si(head[named[n]], numbers[:, named[n]]) for n in listed])
    for role in ("t", "u"):
        if role not in parts:
            raise InvalidArgument(
                f"path is {str(file)!r}, whose columns are {', '.join(named)}: none is that of {role}, "
                f"expected columns={{{role!r}: ...}}"
            )
    return parts, len(rows) - len(numbers)


_TURNS = ("psi", "yaw", "theta", "heading")
_UNITS = {
    **dict.fromkeys(("", "s", "m", "rad", "N", "N m", "Nm", "V", "A", "m/s", "rad/s"), 1.0),
    **{"deg": np.pi / 180, "deg/s": np.pi / 180, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    **{"mm": 1e-3, "cm": 1e-2, "mm/s": 1e-3, "mrad": 1e-3, "mN": 1e-3, "kN": 1e3, "mV": 1e-3, "mA": 1e-3},
    **{"N mm": 1e-3, "mN m": 1e-3, "rpm": 2 * np.pi / 60, "rev/min": 2 * np.pi / 60},
}


def _in_si(title: str, column: Array) -> Array:
    found = re.search(r"\[(.*)\]\s*$", title)
    unit = found[1].strip() if found else ""
    if unit not in _UNITS:
        raise UnknownName(f"unit of column {title!r}", unit, _UNITS)
    return column * _UNITS[unit]


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return np.nan


def _columns_of(names: Sequence[str]) -> dict[str, Sequence[str]]:
    """Return which columns tell what, by their names."""
    known = {name.casefold(): name for name in names}
    found: dict[str, Sequence[str]] = {}
    time = [known[name] for name in ("t", "time", "stamp", "timestamp") if name in known]
    turn = [known[name] for name in _TURNS if name in known]
    if time:
        found["t"] = time[:1]
    if turn and {"x", "y"} <= set(known):
        found["q"] = (known["x"], known["y"], turn[0])
    inputs = [name for name in names if name.startswith("u_")]
    inputs = inputs or [known[name] for name in ("fx", "fy", "mz") if name in known]
    for role, listed in (
        ("u", inputs),
        ("twist", [name for name in names if name.startswith("twist_")]),
        ("wheel_rates", [name for name in names if name.startswith("rate_")]),
    ):
        if listed:
            found[role] = listed
    return found


def read_bag(
    path: str | PathLike[str], topics: Mapping[str, str], stamps: str
) -> dict[str, tuple[Array, Array]]:
    """Return times, counted from the first of all, and rows of each topic, by role; see `Log.from_bag`."""
    file = location("path", path)
    if not isinstance(topics, Mapping) or "u" not in topics or not {"q", "twist"} & set(topics):
        raise InvalidArgument(
            f"topics is {shown(topics)}, expected those of u and of q or twist, such as "
            "{'q': '/odom', 'u': '/wrench'}"
        )
    for role, topic in topics.items():
        one_of("part of a log", role, _ROLES)
        text(f"topics[{role!r}]", topic)
    one_of("stamps", stamps, _STAMPS)
    highlevel = imported("rosbags.highlevel", "bags", "a bag")
    stores = imported("rosbags.typesys", "bags", "a bag")
    with refusals("read", "path", file):
        file.stat()
    try:
        reader = highlevel.AnyReader(
            [file], default_typestore=stores.get_typestore(stores.Stores.ROS2_HUMBLE)
        )
        reader.open()
    except Exception as error:  # rosbags raises what its readers of several formats raise
        raise InvalidArgument(f"path is {str(file)!r}, which is no bag that can be read: {error}") from error
    try:
        return _streams(reader, topics, stamps, str(file))
    finally:
        reader.close()


def _streams(
    reader: Any, topics: Mapping[str, str], stamps: str, file: str
) -> dict[str, tuple[Array, Array]]:
    there = {each.topic: each.msgtype for each in reader.connections}
    for topic in topics.values():
        if topic not in there:
            listed = [f"{name} ({kind.rpartition('/')[2]})" for name, kind in there.items()]
            raise UnknownName(f"topic of {file!r}", topic, listed)
    rules = {role: _rule(role, topic, there[topic]) for role, topic in topics.items()}
    times: dict[str, list[int]] = {role: [] for role in topics}
    rows: dict[str, list[Any]] = {role: [] for role in topics}
    wanted = [each for each in reader.connections if each.topic in set(topics.values())]
    for connection, arrived, raw in reader.messages(connections=wanted):
        message = reader.deserialize(raw, connection.msgtype)
        header = getattr(message, "header", None) if stamps == "header" else None
        at = arrived if header is None else header.stamp.sec * 10**9 + header.stamp.nanosec
        for role, topic in topics.items():
            if topic == connection.topic:
                times[role].append(at)
                rows[role].append(rules[role](message))
    empty = next((topic for role, topic in topics.items() if len(rows[role]) < 2), None)
    if empty is not None:
        raise InvalidArgument(f"path is {file!r}, whose topic {empty!r} has fewer than 2 messages")
    first = min(min(each) for each in times.values())  # whole numbers: 1.7e18 ns are beyond a float's digits
    found = {}
    for role in topics:
        lengths = {len(row) for row in rows[role]}
        if len(lengths) > 1:
            raise InvalidArgument(
                f"path is {file!r}, whose topic {topics[role]!r} has messages of {sorted(lengths)} numbers, "
                "expected as many in each"
            )
        t = _NANO * np.array([each - first for each in times[role]], np.float64)
        found[role] = t, np.array(rows[role], np.float64)
    return found


def _rule(role: str, topic: str, kind: str) -> Row:
    """Return what makes a row of a message.

    Raises
    ------
    InvalidArgument
        If messages of this kind do not tell this.
    """
    short = kind.rpartition("/")[2]
    known = _RULES[role]
    if short not in known:
        raise InvalidArgument(
            f"topics[{role!r}] is {topic!r}, whose messages are {kind}, expected {', '.join(known)}"
        )
    return known[short]


def _yaw(orientation: Any) -> float:
    x, y, z, w = orientation.x, orientation.y, orientation.z, orientation.w
    return float(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


def _pose(pose: Any) -> tuple[float, float, float]:
    return pose.position.x, pose.position.y, _yaw(pose.orientation)


def _transform(transform: Any) -> tuple[float, float, float]:
    return transform.translation.x, transform.translation.y, _yaw(transform.rotation)


def _planar_wrench(wrench: Any) -> tuple[float, float, float]:
    return wrench.force.x, wrench.force.y, wrench.torque.z


def _command(twist: Any) -> tuple[float, float]:
    return twist.linear.x, twist.angular.z


def _planar_twist(twist: Any) -> tuple[float, float, float]:
    return twist.linear.x, twist.linear.y, twist.angular.z


_ARRAYS: dict[str, Row] = {
    "Float64MultiArray": lambda message: np.asarray(message.data),
    "Float32MultiArray": lambda message: np.asarray(message.data),
}
_RULES: dict[str, dict[str, Row]] = {
    "q": {
        "Odometry": lambda message: _pose(message.pose.pose),
        "PoseStamped": lambda message: _pose(message.pose),
        "PoseWithCovarianceStamped": lambda message: _pose(message.pose.pose),
        "Pose": _pose,
        "Pose2D": lambda message: (message.x, message.y, message.theta),
        "TransformStamped": lambda message: _transform(message.transform),
    },
    "u": {
        "WrenchStamped": lambda message: _planar_wrench(message.wrench),
        "Wrench": _planar_wrench,
        "Twist": _command,
        "TwistStamped": lambda message: _command(message.twist),
        "JointState": lambda message: np.asarray(message.effort),
        **_ARRAYS,
    },
    "twist": {
        "Odometry": lambda message: _planar_twist(message.twist.twist),
        "TwistStamped": lambda message: _planar_twist(message.twist),
        "TwistWithCovarianceStamped": lambda message: _planar_twist(message.twist.twist),
        "Twist": _planar_twist,
    },
    "wheel_rates": {"JointState": lambda message: np.asarray(message.velocity), **_ARRAYS},
}
