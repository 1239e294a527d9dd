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
from operator import attrgetter
from os import SEEK_END, PathLike
from pathlib import Path
from typing import Any

import numpy as np

from pinmobile.arrays import Array, instance, location, one_of, sequence, text
from pinmobile.errors import FileError, InvalidArgument, PinmobileError, UnknownName, format_names, shown
from pinmobile.extras import imported
from pinmobile.files import refusals

_ROLES = ("q", "u", "twist", "wheel_rates")
_STAMPS = ("header", "bag")
_NANO = 1e-9

Row = Callable[[Any], Any]


def _refused(file: Path, what: str, expected: str) -> InvalidArgument:
    """Return the error about a file and what it has."""
    return InvalidArgument(f"path is {str(file)!r}, {what}, expected {expected}")


def read_csv(
    path: str | PathLike[str], columns: Mapping[str, str | Sequence[str]] | None
) -> tuple[dict[str, Array], tuple[str, ...], int]:
    """Return columns by role, units of inputs, and how many rows are of another length: see `Log`."""
    file = location("path", path)
    head, rows = _table(file)
    names = [*map(_named, head)]
    named = {name: k for k, name in enumerate(names) if name}
    known = _columns_of(list(named))
    such = "a mapping such as {'t': 'time', ...}"
    wanted = known if columns is None else dict(instance("columns", columns, Mapping, such))
    for role in wanted:
        one_of("part of a log", role, ("t", *_ROLES))
    for roles in (("t",), ("u",), ("q", "twist")):
        if roles[0] in known and not set(roles) & set(wanted):
            wanted[roles[0]] = known[roles[0]]
        if not set(roles) & set(wanted):
            raise _refused(
                file,
                f"whose columns are {format_names(named)}: none is known as that of {' or '.join(roles)}",
                "columns={'t': 'time', 'q': ('x', 'y', 'psi'), 'u': (...)} with the names that stand in its "
                "header",
            )
    kept = [row for row in rows if len(row) == len(head)]
    if len(kept) < 2:
        raise _refused(file, f"with {len(kept)} rows of as many columns as its header", "more")
    parts: dict[str, Array] = {}
    units: tuple[str, ...] = ()
    for role, of_role in wanted.items():
        listed = [of_role] if isinstance(of_role, str) else sequence(f"columns[{role!r}]", of_role, "names")
        for name in listed:
            one_of(f"column of {str(file)!r}", name, named)
            if names.count(name) > 1:
                raise _refused(file, f"with two columns {name!r}", "one")
        titles = [head[named[name]] for name in listed]
        rates: list[str | None] = ["rad/s" if role == "wheel_rates" else None] * len(titles)
        expected = _EXPECTED.get((role, len(titles)), rates)
        in_si = [_si_unit(title, each) for title, each in zip(titles, expected, strict=True)]
        cells = [_column(file, head[named[name]], [row[named[name]] for row in kept]) for name in listed]
        parts[role] = np.column_stack(cells) * [factor for _, factor in in_si]
        units = tuple(unit for unit, _ in in_si) if role == "u" else units
    if "q" in parts and parts["q"].shape[1] == 2 + _QUATERNION:
        x, y, *quaternion = parts["q"].T
        parts["q"] = np.column_stack([x, y, _yaw_of(*quaternion)])
    return parts, units, len(rows) - len(kept)


def _table(file: Path) -> tuple[list[str], list[list[str]]]:
    """Return the header of a file and its rows: cells between commas, semicolons, tabs or blanks.

    Lines before the header that begin with # or % are comments; the last of these is the header where numbers
    follow it.
    """
    with refusals("read", "path", file), file.open("rb") as opened:
        data = opened.read(_MOST_BYTES + 1)  # what is no regular file may never end
    if len(data) > _MOST_BYTES:
        raise _refused(file, f"of more than {_MOST_BYTES >> 20} MiB", "less")
    wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        content = data.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError:
        content = data.decode("latin-1")
    if "\0" in content:
        raise _refused(file, "which is no text", "a CSV file")
    lines = [line for line in content.splitlines() if line.strip()]
    comments = [*takewhile(lambda line: line.lstrip().startswith(_COMMENTS), lines)]
    lines = lines[len(comments) :]
    if comments and lines and _is_numbers(lines[0]):
        lines = [comments[-1].lstrip().lstrip("".join(_COMMENTS)), *lines]
    if not lines or _is_numbers(lines[0]):
        said = f"whose first line {shown(lines[0])} has numbers" if lines else "which is empty"
        raise _refused(file, said, "a header that names the columns, such as t,x,y,psi,Fx,Fy,Mz")
    # Units in brackets may hold blanks.
    bare = re.sub(r"\[[^][]*\]|\([^()]*\)", "", lines[0].strip())
    between = next((each for each in _SEPARATORS if each in bare), ",")
    try:
        read = csv.reader(lines, delimiter=between, skipinitialspace=True)
        head, *rows = [[cell.strip() for cell in row] for row in read]
    except csv.Error as error:
        raise InvalidArgument(f"path is {str(file)!r}, which is no table of cells: {error}") from error
    if (longest := max(map(len, head), default=0)) > _LONGEST_NAME:
        raise _refused(file, f"whose header has a name of {longest:,} letters", f"at most {_LONGEST_NAME:,}")
    if between != ",":  # a comma is then that of a decimal
        rows = [[cell.replace(",", ".") for cell in row] for row in rows]
    return head, rows


_COMMENTS = "#", "%"
_SEPARATORS = ";", "\t", ",", " "
_QUATERNION = 4
_MOST_BYTES = 1 << 30
_LONGEST_NAME = 1000  # letters of a column's name, with its unit


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
        raise _refused(file, f"whose column {title!r} holds no numbers but {shown(cells[0])}", "numbers")
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
# Units that are read, and what they are of the unit of SI that is kept.
_UNITS = {name: (si, x) for si, others in _SI.items() for name, x in {si: 1.0, **others}.items()}
_EXPECTED: dict[tuple[str, int], Sequence[str | None]] = {
    ("t", 1): ("s",),
    ("q", 3): ("m", "m", "rad"),
    ("q", 6): ("m", "m", "", "", "", ""),
    ("twist", 2): ("m/s", "rad/s"),
    ("twist", 3): ("m/s", "m/s", "rad/s"),
}
# Units of the columns of a part of a log; inputs are those of a robot, see `Log.units`.


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
    time = [known[name] for name in ("t", "time", "stamp", "timestamp") if name in known]
    turn = [known[name] for name in _TURNS if name in known][:1]
    turn = turn or next(([known[n] for n in each] for each in _QUATERNIONS if set(each) <= set(known)), [])
    place = [known[name] for name in ("x", "y") if name in known]
    inputs = [name for name in names if name.startswith("u_")]
    inputs = inputs or [known[name] for name in ("fx", "fy", "mz") if name in known]
    rates = [name for name in names if name.startswith("rate_")]
    turned = [f"v_{name.removeprefix('u_')}" for name in inputs]  # as Rollout.to_csv calls them
    found: dict[str, Sequence[str]] = {
        "t": time[:1],
        "q": [*place, *turn] if turn and len(place) == 2 else [],
        "u": inputs,
        "twist": [name for name in names if name.startswith("twist_")],
        "wheel_rates": rates or (turned if set(turned) <= set(names) else []),
    }
    return {role: listed for role, listed in found.items() if listed}


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
                return _streams(reader, topics, stamps, file)
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
    reader: Any, topics: Mapping[str, str], stamps: str, file: Path
) -> dict[str, tuple[Array, Array]]:
    there = {each.topic: each.msgtype for each in reader.connections}
    for topic in topics.values():
        if topic not in there:
            listed = [f"{name} ({kind.rpartition('/')[2]})" for name, kind in there.items()]
            raise UnknownName(f"topic of {str(file)!r}", topic, listed)
    rules: dict[str, Row] = {}
    for role, topic in topics.items():
        known, kind = _RULES[role], there[topic].rpartition("/")[2]
        if kind not in known:
            raise InvalidArgument(
                f"topics[{role!r}] is {topic!r}, whose messages are {there[topic]}, expected "
                f"{', '.join(known)}"
            )
        rules[role] = known[kind]
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
        raise _refused(file, f"whose topic {empty!r} has fewer than 2 messages", "more")
    first = min(min(each) for each in times.values())  # whole numbers: 1.7e18 ns are beyond a float's digits
    found = {}
    for role in topics:
        lengths = {len(row) for row in rows[role]}
        if len(lengths) > 1:
            what = f"whose topic {topics[role]!r} has messages of {sorted(lengths)} numbers"
            raise _refused(file, what, "as many in each")
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


def _yaw_of(x: Any, y: Any, z: Any, w: Any) -> Any:
    """Return the yaw of quaternions, which need not be of length one."""
    return np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)


def _pose(place: Any, turn: Any) -> tuple[float, float, float]:
    return place.x, place.y, float(_yaw_of(turn.x, turn.y, turn.z, turn.w))


_WRENCH = "force.x", "force.y", "torque.z"
_TWIST = "linear.x", "linear.y", "angular.z"
_COMMAND = "linear.x", "angular.z"


def _of(inside: str, names: Sequence[str]) -> Row:
    """Return the numbers of a message by their names inside a part of it."""
    return attrgetter(*(f"{inside}{name}" for name in names))


_ARRAYS: dict[str, Row] = dict.fromkeys(
    ("Float64MultiArray", "Float32MultiArray"), lambda message: np.asarray(message.data)
)
_RULES: dict[str, dict[str, Row]] = {
    "q": {
        "Odometry": lambda message: _pose(message.pose.pose.position, message.pose.pose.orientation),
        "PoseStamped": lambda message: _pose(message.pose.position, message.pose.orientation),
        "PoseWithCovarianceStamped": lambda message: _pose(
            message.pose.pose.position, message.pose.pose.orientation
        ),
        "Pose": lambda message: _pose(message.position, message.orientation),
        "Pose2D": attrgetter("x", "y", "theta"),
        "TransformStamped": lambda message: _pose(message.transform.translation, message.transform.rotation),
    },
    "u": {
        "WrenchStamped": _of("wrench.", _WRENCH),
        "Wrench": _of("", _WRENCH),
        "Twist": _of("", _COMMAND),
        "TwistStamped": _of("twist.", _COMMAND),
        "JointState": lambda message: np.asarray(message.effort),
        **_ARRAYS,
    },
    "twist": {
        "Odometry": _of("twist.twist.", _TWIST),
        "TwistStamped": _of("twist.", _TWIST),
        "TwistWithCovarianceStamped": _of("twist.twist.", _TWIST),
        "Twist": _of("", _TWIST),
    },
    "wheel_rates": {"JointState": lambda message: np.asarray(message.velocity), **_ARRAYS},
}
