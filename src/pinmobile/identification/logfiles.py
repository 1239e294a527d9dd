"""Files of logs: CSV; bags of ROS 1 and ROS 2 and MCAP files, read without ROS."""

from __future__ import annotations

import codecs
import csv
import re
import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from itertools import takewhile
from os import SEEK_END, PathLike
from pathlib import Path
from typing import Any

import numpy as np

from pinmobile.arrays import Array, location, one_of, sequence, text
from pinmobile.errors import FileError, InvalidArgument, PinmobileError, UnknownName, format_names, shown
from pinmobile.extras import imported
from pinmobile.files import refusals

_ROLES = ("q", "u", "twist", "wheel_rates")
_STAMPS = ("header", "bag")
_NANO = 1e-9

Row = Callable[[Any], Any]


def read_csv(
    path: str | PathLike[str], columns: Mapping[str, str | Sequence[str]] | None
) -> tuple[dict[str, Array], tuple[str, ...], int]:
    """Return columns by role, units of inputs, and how many rows are of another length: see `Log`."""
    file = location("path", path)
    head, rows = _table(file)
    names = [*map(_named, head)]
    named = {name: k for k, name in enumerate(names) if name}
    if columns is not None and not isinstance(columns, Mapping):
        raise InvalidArgument(f"columns is {shown(columns)}, expected a mapping such as {{'t': 'time', ...}}")
    known = _columns_of(list(named))
    wanted = known if columns is None else dict(columns)
    for role in wanted:
        one_of("part of a log", role, ("t", *_ROLES))
    for roles in (("t",), ("u",), ("q", "twist")):
        if roles[0] in known and not set(roles) & set(wanted):
            wanted[roles[0]] = known[roles[0]]
        if not set(roles) & set(wanted):
            raise InvalidArgument(
                f"path is {str(file)!r}, whose columns are {format_names(named)}: none is known as that of "
                f"{' or '.join(roles)}, expected columns={{'t': 'time', 'q': ('x', 'y', 'psi'), 'u': (...)}} "
                "with the names that stand in its header"
            )
    kept = [row for row in rows if len(row) == len(head)]
    if len(kept) < 2:
        raise InvalidArgument(
            f"path is {str(file)!r}, with {len(kept)} rows of as many columns as its header, expected more"
        )
    parts: dict[str, Array] = {}
    units: tuple[str, ...] = ()
    for role, of_role in wanted.items():
        listed = [of_role] if isinstance(of_role, str) else sequence(f"columns[{role!r}]", of_role, "names")
        for name in listed:
            one_of(f"column of {str(file)!r}", name, named)
            if names.count(name) > 1:
                raise InvalidArgument(f"path is {str(file)!r}, with two columns {name!r}, expected one")
        titles = [head[named[name]] for name in listed]
        rates: list[str | None] = ["rad/s" if role == "wheel_rates" else None] * len(titles)
        expected = _EXPECTED.get((role, len(titles)), rates)
        in_si = [_si_unit(title, each) for title, each in zip(titles, expected, strict=True)]
        cells = ([row[named[name]] for row in kept] for name in listed)
        pairs = zip(titles, cells, in_si, strict=True)
        parts[role] = np.column_stack([factor * _column(file, title, of) for title, of, (_, factor) in pairs])
        units = tuple(unit for unit, _ in in_si) if role == "u" else units
    if "q" in parts and parts["q"].shape[1] == 2 + _QUATERNION:
        x, y, *quaternion = parts["q"].T
        parts["q"] = np.column_stack([x, y, _yaw_of(*quaternion)])
    return parts, units, len(rows) - len(kept)


def _table(file: Path) -> tuple[list[str], list[list[str]]]:
    """Return the header of a file and its rows."""
    with refusals("read", "path", file), file.open("rb") as opened:
        data = opened.read(_MOST_BYTES + 1)  # what is no regular file may never end
    if len(data) > _MOST_BYTES:
        raise InvalidArgument(f"path is {str(file)!r}, of more than {_MOST_BYTES >> 20} MiB, expected less")
    return _cells(file, data)


def _cells(file: Path, data: bytes) -> tuple[list[str], list[list[str]]]:
    """Return the header of a table and its rows: cells between commas, semicolons, tabs or blanks.

    Lines before the header that begin with # or % are comments; the last of these is the header where numbers
    follow it.
    """
    content = _decoded(data)
    if "\0" in content:
        raise InvalidArgument(f"path is {str(file)!r}, which is no text, expected a CSV file")
    lines = [line for line in content.splitlines() if line.strip()]
    comments = [*takewhile(lambda line: line.lstrip().startswith(_COMMENTS), lines)]
    lines = lines[len(comments) :]
    if comments and lines and _is_numbers(lines[0]):
        lines = [comments[-1].lstrip().lstrip("".join(_COMMENTS)), *lines]
    if not lines or _is_numbers(lines[0]):
        said = f"whose first line {shown(lines[0])} has numbers" if lines else "which is empty"
        raise InvalidArgument(
            f"path is {str(file)!r}, {said}, expected a header that names the columns, such as "
            "t,x,y,psi,Fx,Fy,Mz"
        )
    between = _separator(lines[0])
    try:
        read = csv.reader(lines, delimiter=between, skipinitialspace=True)
        head, *rows = [[cell.strip() for cell in row] for row in read]
    except csv.Error as error:
        raise InvalidArgument(f"path is {str(file)!r}, which is no table of cells: {error}") from error
    if (longest := max(map(len, head), default=0)) > _LONGEST_NAME:
        raise InvalidArgument(
            f"path is {str(file)!r}, whose header has a name of {longest:,} letters, expected at most "
            f"{_LONGEST_NAME:,}"
        )
    if between != ",":  # a comma is then that of a decimal
        rows = [[cell.replace(",", ".") for cell in row] for row in rows]
    return head, rows


def _is_wide(data: bytes) -> bool:
    return data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))


def _decoded(data: bytes) -> str:
    try:
        return data.decode("utf-16" if _is_wide(data) else "utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


_COMMENTS = "#", "%"
_SEPARATORS = ";", "\t", ",", " "
_QUATERNION = 4
_MOST_BYTES = 1 << 30
_LONGEST_NAME = 1000  # letters of a column's name, with its unit
_HEADER = 1 << 16  # bytes, in which a header is looked for


def _separator(line: str) -> str:
    """Return what stands between the cells of a header; units in brackets may hold blanks."""
    bare = re.sub(r"\[[^][]*\]|\([^()]*\)", "", line.strip())
    return next((each for each in _SEPARATORS if each in bare), ",")


def _is_numbers(line: str) -> bool:
    cells = [cell for cell in re.split(r"[;\t, ]+", line.strip()) if cell]
    return bool(cells) and not any(np.isnan(_number(cell)) for cell in cells)


_UNIT = re.compile(r"[\[(]([^][()]*)[\])]$")


def _named(title: str) -> str:
    """Return the name of a column without its unit."""
    return _UNIT.sub("", title.strip()).strip()


def _column(file: Path, title: str, cells: Sequence[str]) -> Array:
    """Return the numbers of a column; NaN where a cell holds none."""
    numbers = np.array([_number(cell) for cell in cells])
    if np.isnan(numbers).all():
        numbers = np.array([_moment(cell) for cell in cells])
        numbers = numbers - (0.0 if np.isnan(numbers).all() else np.nanmin(numbers))
    if np.isnan(numbers).all():
        raise InvalidArgument(
            f"path is {str(file)!r}, whose column {title!r} holds no numbers but {shown(cells[0])}, expected "
            "numbers"
        )
    return numbers


def _moment(cell: str) -> float:
    """Return a date with a time in seconds."""
    try:
        moment = datetime.fromisoformat(cell)
    except ValueError:
        return np.nan
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


_TURNS = ("psi", "yaw", "theta", "heading")
_QUATERNIONS = [
    [f"{name}{axis}" for axis in "xyzw"] for name in ("q", "q_", "quat_", "orientation.", "orientation_")
]
_SI: dict[str, dict[str, float]] = {
    "s": {"ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "m": {"mm": 1e-3, "cm": 1e-2},
    "rad": {"radians": 1.0, "mrad": 1e-3} | dict.fromkeys(("deg", "degrees", "\N{DEGREE SIGN}"), np.pi / 180),
    "m/s": {"mm/s": 1e-3},
    "rad/s": {"deg/s": np.pi / 180} | dict.fromkeys(("rpm", "rev/min"), 2 * np.pi / 60),
    "N": {"mN": 1e-3, "kN": 1e3},
    "N m": {"Nm": 1.0, "N mm": 1e-3, "mN m": 1e-3},
    "V": {"mV": 1e-3},
    "A": {"mA": 1e-3},
}
"""Units that are read, and what they are of the unit of SI that is kept."""
_UNITS = {name: (si, x) for si, others in _SI.items() for name, x in {si: 1.0, **others}.items()}
_EXPECTED: dict[tuple[str, int], Sequence[str | None]] = {
    ("t", 1): ("s",),
    ("q", 3): ("m", "m", "rad"),
    ("q", 6): ("m", "m", "", "", "", ""),
    ("twist", 2): ("m/s", "rad/s"),
    ("twist", 3): ("m/s", "m/s", "rad/s"),
}
"""Units of the columns of a part of a log; inputs are those of a robot, see `Log.units`."""


def _unit(title: str) -> str:
    """Return the unit of a column, with a blank between its parts; empty where there is none."""
    found = _UNIT.search(title.strip())
    parts = re.split(r"[*.\N{MIDDLE DOT}\N{DOT OPERATOR}]", found[1]) if found else ()
    return " ".join(map(str.strip, parts))


def _si_unit(title: str, expected: str | None) -> tuple[str, float]:
    """Return the unit of SI that a column is kept in, "" where its title has none, and the factor to it.

    Raises
    ------
    UnknownName, InvalidArgument
        If its unit is not known, or of another quantity than is expected of the column.
    """
    unit = _unit(title)
    if not unit:
        return "", 1.0
    if unit not in _UNITS:
        raise UnknownName(f"unit of column {title!r}", unit, list(_UNITS))
    si, factor = _UNITS[unit]
    if expected is not None and si != expected:
        raise InvalidArgument(
            f"columns has {title!r} in {unit}, expected {', '.join([expected, *_SI[expected]])}"
            if expected
            else f"columns has {title!r} in {unit}, expected no unit: it is of a quaternion"
        )
    return si, factor


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
    turn = [known[name] for name in _TURNS if name in known][:1]
    turn = turn or next(([known[n] for n in each] for each in _QUATERNIONS if set(each) <= set(known)), [])
    if time:
        found["t"] = time[:1]
    if turn and {"x", "y"} <= set(known):
        found["q"] = (known["x"], known["y"], *turn)
    inputs = [name for name in names if name.startswith("u_")]
    inputs = inputs or [known[name] for name in ("fx", "fy", "mz") if name in known]
    rates = [name for name in names if name.startswith("rate_")]
    turned = [f"v_{name.removeprefix('u_')}" for name in inputs]  # as Rollout.to_csv calls them
    for role, listed in (
        ("u", inputs),
        ("twist", [name for name in names if name.startswith("twist_")]),
        ("wheel_rates", rates or (turned if set(turned) <= set(names) else [])),
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
        except highlevel.AnyReaderError as error:
            raise InvalidArgument(f"path is {str(file)!r}, expected a bag: {shown(str(error))}") from error
        try:
            for each in sorted(file.glob("*.mcap")) or [file] * (file.suffix == ".mcap"):
                _check_sums(each)
            with reader:
                return _streams(reader, topics, stamps, str(file))
        except (PinmobileError, PermissionError):
            raise
        except Exception as error:  # rosbags and sqlite raise whatever the bytes lead them to
            why = shown(str(error) or type(error).__name__)
            message = f"path is {str(file)!r}, which is damaged or no bag: {why}"
            raise FileError(message, errno=getattr(error, "errno", None), filename=str(file)) from error


def _check_sums(file: Path) -> None:
    """Check what an MCAP file has as CRCs of its data and of its summary; rosbags checks those of chunks."""
    with file.open("rb") as opened:
        end = opened.seek(-37, SEEK_END)  # of the footer and the last 8 bytes
        summary, _, sum_of_summary = struct.unpack("<9xQQI8x", opened.read())
        start = summary or end
        opened.seek(start - 4)
        (sum_of_data,) = struct.unpack("<I", opened.read(4))
        for name, first, last, expected in (
            ("data", 0, start - 13, sum_of_data),
            ("summary", start, end + 25, sum_of_summary),
        ):
            opened.seek(first)
            left, found = last - first if expected else 0, 0
            while left > 0 and (block := opened.read(min(left, 1 << 20))):
                left, found = left - len(block), zlib.crc32(block, found)
            if found != expected:
                raise ValueError(f"CRC of the {name} of {file.name} is {found:#x}, expected {expected:#x}")


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
    left = sum(each.msgcount for each in wanted)
    for connection, arrived, raw in reader.messages(connections=wanted):
        left -= 1
        message = reader.deserialize(raw, connection.msgtype)
        header = getattr(message, "header", None) if stamps == "header" else None
        at = arrived if header is None else header.stamp.sec * 10**9 + header.stamp.nanosec
        for role, topic in topics.items():
            if topic == connection.topic:
                times[role].append(at)
                rows[role].append(rules[role](message))
    if left > 0:  # as of a chunk without CRC, which is read up to its damage
        raise ValueError(f"{left} messages that the bag counts are gone")
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
        if not max(lengths):
            raise InvalidArgument(
                f"topics[{role!r}] is {topics[role]!r}, whose messages hold none of it, expected another"
            )
        t = _NANO * np.array([each - first for each in times[role]], np.float64)
        if stamps == "header" and not t[-1] > t[0]:
            raise InvalidArgument(
                f"stamps is {stamps!r}, and those of topic {topics[role]!r} are the same in all messages, "
                "expected 'bag': times of arrival"
            )
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
    return float(_yaw_of(orientation.x, orientation.y, orientation.z, orientation.w))


def _yaw_of(x: Any, y: Any, z: Any, w: Any) -> Any:
    """Return the yaw of quaternions, which need not be of length one."""
    return np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)


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
