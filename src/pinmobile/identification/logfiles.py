"""Files of logs: CSV; bags of ROS 1 and ROS 2 and MCAP files, read without ROS."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from itertools import takewhile
from operator import attrgetter
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from pinmobile.arrays import Array, instance, location, one_of, sequence, text
from pinmobile.errors import FileError, InvalidArgument, PinmobileError, UnknownName, format_names, shown
from pinmobile.extras import imported
from pinmobile.files import refusals

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
    names = [_UNIT.sub("", title.strip()).strip() for title in head]
    named = {name: k for k, name in enumerate(names) if name}
    known = _columns_of(list(named))
    such = "a mapping such as {'t': 'time', ...}"
    wanted = known if columns is None else dict(instance("columns", columns, Mapping, such))
    for role in wanted:
        one_of("part of a log", role, ("t", *_RULES))
    for roles in (("t",), ("u",), ("q", "twist")):
        if not set(roles) & set(wanted):
            wanted |= {roles[0]: known[roles[0]]} if roles[0] in known else {}
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
        units_of = _EXPECTED.get((role, len(titles)), ["rad/s" if role == "wheel_rates" else None])
        expected = [*units_of] * (len(titles) // len(units_of))
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
    with refusals("read", "path", file):
        data = file.read_bytes()
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
    if between != ",":  # a comma is then that of a decimal
        rows = [[cell.replace(",", ".") for cell in row] for row in rows]
    return head, rows


_COMMENTS = "#", "%"
_SEPARATORS = ";", "\t", ",", " "
_QUATERNION = 4


def _is_numbers(line: str) -> bool:
    cells = [cell for cell in re.split(r"[;\t, ]+", line.strip()) if cell]
    return bool(cells) and not any(np.isnan(_number(cell)) for cell in cells)


_UNIT = re.compile(r"[\[(]([^][()]*)[\])]$")


def _column(file: Path, title: str, cells: Sequence[str]) -> Array:
    """Return the numbers of a column, or seconds of dates with times; NaN where a cell holds none."""
    numbers = np.array([_number(cell) for cell in cells])
    if np.isnan(numbers).all():
        numbers = np.array([_number(cell, _seconds) for cell in cells])
        if np.isnan(numbers).all():
            raise _refused(file, f"whose column {title!r} holds no numbers but {shown(cells[0])}", "numbers")
        numbers -= np.nanmin(numbers)
    return numbers


def _seconds(cell: str) -> float:
    moment = datetime.fromisoformat(cell)
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


_TURNS = [
    *(["psi"], ["yaw"], ["theta"], ["heading"]),
    *([f"{n}{axis}" for axis in "xyzw"] for n in ("q", "q_", "quat_", "orientation.", "orientation_")),
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


def _si_unit(title: str, expected: str | None) -> tuple[str, float]:
    """Return the unit of SI that a column is kept in, "" where its title has none, and the factor to it.

    Raises
    ------
    UnknownName, InvalidArgument
        If its unit is not known, or of another quantity than is expected of the column.
    """
    found = _UNIT.search(title.strip())
    if not found or not found[1].strip():
        return "", 1.0
    unit = " ".join(map(str.strip, re.split(r"[*.\N{MIDDLE DOT}\N{DOT OPERATOR}]", found[1])))
    if unit not in _UNITS:
        raise UnknownName(f"unit of column {title!r}", unit, list(_UNITS))
    si, factor = _UNITS[unit]
    if expected is not None and si != expected:
        listed = ", ".join([expected, *_SI[expected]]) if expected else "no unit: it is of a quaternion"
        raise InvalidArgument(f"columns has {title!r} in {unit}, expected {listed}")
    return si, factor


def _number(cell: str, read: Callable[[str], float] = float) -> float:
    try:
        return read(cell)
    except ValueError:
        return np.nan


def _columns_of(names: Sequence[str]) -> dict[str, Sequence[str]]:
    """Return which columns tell what, by their names."""
    known = {name.casefold(): name for name in names}

    def first(*sets: Sequence[str]) -> list[str]:
        return next(([known[n] for n in each] for each in sets if set(each) <= set(known)), [])

    inputs = [name for name in names if name.startswith("u_")]
    inputs = inputs or [known[name] for name in ("fx", "fy", "mz") if name in known]
    rates = [name for name in names if name.startswith("rate_")]
    turned = [f"v_{name.removeprefix('u_')}" for name in inputs]  # as Rollout.to_csv calls them
    found: dict[str, Sequence[str]] = {
        "t": first(("t",), ("time",), ("stamp",), ("timestamp",)),
        "q": first(*(("x", "y", *each) for each in _TURNS)),
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
        one_of("part of a log", role, _RULES)
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
            with reader:
                return _streams(reader, topics, stamps, file)
        except (PinmobileError, PermissionError):
            raise
        except Exception as error:  # rosbags and sqlite raise whatever the bytes lead them to
            why = shown(str(error) or type(error).__name__)
            message = f"path is {str(file)!r}, which is damaged or no bag: {why}"
            raise FileError(message, errno=getattr(error, "errno", None), filename=str(file)) from error


def _streams(
    reader: Any, topics: Mapping[str, str], stamps: str, file: Path
) -> dict[str, tuple[Array, Array]]:
    there = {each.topic: each.msgtype for each in reader.connections}
    for topic in topics.values():
        if topic not in there:
            listed = [f"{name} ({kind.rpartition('/')[2]})" for name, kind in there.items()]
            raise UnknownName(f"topic of {str(file)!r}", topic, listed)
    rules: dict[str, list[tuple[str, Row]]] = {topic: [] for topic in topics.values()}
    for role, topic in topics.items():
        known, kind = _RULES[role], there[topic].rpartition("/")[2]
        if kind not in known:
            raise InvalidArgument(
                f"topics[{role!r}] is {topic!r}, whose messages are {there[topic]}, expected "
                f"{', '.join(known)}"
            )
        rules[topic].append((role, known[kind]))
    times: dict[str, list[int]] = {role: [] for role in topics}
    rows: dict[str, list[Any]] = {role: [] for role in topics}
    wanted = [each for each in reader.connections if each.topic in rules]
    left = sum(each.msgcount for each in wanted)
    for connection, arrived, raw in reader.messages(connections=wanted):
        left -= 1
        message = reader.deserialize(raw, connection.msgtype)
        header = getattr(message, "header", None) if stamps == "header" else None
        at = arrived if header is None else header.stamp.sec * 10**9 + header.stamp.nanosec
        for role, row in rules[connection.topic]:
            times[role].append(at)
            rows[role].append(row(message))
    if left > 0:  # as of a chunk without CRC, which is read up to its damage
        raise ValueError(f"{left} messages that the bag counts are gone")
    first = min((at for each in times.values() for at in each), default=0)  # beyond a float's digits
    found = {}
    for role, topic in topics.items():
        lengths = sorted({len(row) for row in rows[role]})
        if len(rows[role]) < 2 or len(lengths) > 1 or not lengths[0]:
            what = f"whose topic {topic!r} has {len(rows[role])} messages of {lengths} numbers"
            raise _refused(file, what, f"2 and more that hold {role}, as many numbers in each")
        t = _NANO * np.array([each - first for each in times[role]], np.float64)
        if stamps == "header" and not t[-1] > t[0]:
            raise InvalidArgument(
                f"stamps is {stamps!r}, and those of topic {topic!r} are the same in all messages, expected "
                "'bag': times of arrival"
            )
        found[role] = t, np.array(rows[role], np.float64)
    return found


def _yaw_of(x: Any, y: Any, z: Any, w: Any) -> Any:
    """Return the yaw of quaternions, which need not be of length one."""
    return np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)


def _pose_in(inside: str = "") -> Row:
    """Return what reads a pose from a message, by the name of a part of it."""
    parts = attrgetter(f"{inside}position", f"{inside}orientation")

    def read(message: Any) -> Any:
        place, turn = parts(message)
        return place.x, place.y, float(_yaw_of(turn.x, turn.y, turn.z, turn.w))

    return read


def _of(inside: str, *names: str) -> Row:
    """Return the numbers of a message by their names inside a part of it."""
    return attrgetter(*(f"{inside}{name}" for name in names))


def _moved(message: Any) -> Any:
    """Return the pose of a transform."""
    at, turn = message.transform.translation, message.transform.rotation
    return at.x, at.y, float(_yaw_of(turn.x, turn.y, turn.z, turn.w))


_WRENCH, _TWIST = ("force.x", "force.y", "torque.z"), ("linear.x", "linear.y", "angular.z")
_COMMAND, _ARRAY = ("linear.x", "angular.z"), attrgetter("data")
_ARRAYS = {"Float64MultiArray": _ARRAY, "Float32MultiArray": _ARRAY}
_RULES: dict[str, dict[str, Row]] = {
    "q": {
        **dict.fromkeys(("Odometry", "PoseWithCovarianceStamped"), _pose_in("pose.pose.")),
        **{"PoseStamped": _pose_in("pose."), "Pose": _pose_in(), "Pose2D": _of("", "x", "y", "theta")},
        "TransformStamped": _moved,
    },
    "u": {
        **{"WrenchStamped": _of("wrench.", *_WRENCH), "Wrench": _of("", *_WRENCH)},
        **{"Twist": _of("", *_COMMAND), "TwistStamped": _of("twist.", *_COMMAND)},
        **{"JointState": attrgetter("effort"), **_ARRAYS},
    },
    "twist": {
        **dict.fromkeys(("Odometry", "TwistWithCovarianceStamped"), _of("twist.twist.", *_TWIST)),
        **{"TwistStamped": _of("twist.", *_TWIST), "Twist": _of("", *_TWIST)},
    },
    "wheel_rates": {"JointState": attrgetter("velocity"), **_ARRAYS},
}
