"""Readers of log files: CSV, bags of ROS 1 and ROS 2, and MCAP files; the clock of the inputs of a log."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from itertools import takewhile
from operator import attrgetter
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from pinmobile.arrays import Array, distinct, instance, location, one_of
from pinmobile.errors import (
    FileError,
    InvalidArgument,
    PinmobileError,
    UnknownName,
    argument_errors,
    format_names,
    format_value,
    import_extra,
    unexpected_value,
)
from pinmobile.files import file_errors

_UNIT = re.compile(r"[\[(]([^][()]*)[\])]$")
_SEPARATORS = ";", "\t", ",", " "
_DATE = re.compile(r"(\d{4})\D(\d\d)\D(\d\d)\D(\d\d)\D(\d\d)\D(\d\d)(?:\D(\d{1,9}))?(Z|[+-]\d\d:?\d\d)?")
_EPOCH = 1e9  # [s]: stamps of this century are above it; those in ms, us and ns exceed it 1e3 times and more
_SIX = 6  # columns of x, y and a quaternion
_TURNS = [
    *(["psi"], ["yaw"], ["theta"], ["heading"]),
    *([f"{n}{axis}" for axis in "xyzw"] for n in ("q", "q_", "quat_", "orientation.", "orientation_")),
]
_DEGREE, _REVOLUTION = np.pi / 180, 2 * np.pi / 60
_SI: dict[str, dict[str, float]] = {  # factors from units to the SI unit
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2},
    "rad": {"rad": 1.0, "mrad": 1e-3, "deg": _DEGREE, "degrees": _DEGREE, "\N{DEGREE SIGN}": _DEGREE},
    "m/s": {"m/s": 1.0, "mm/s": 1e-3},
    "rad/s": {"rad/s": 1.0, "deg/s": _DEGREE, "rpm": _REVOLUTION},
    "N": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
    "N m": {"N m": 1.0, "Nm": 1.0, "N mm": 1e-3, "mN m": 1e-3},
    "V": {"V": 1.0, "mV": 1e-3},
    "A": {"A": 1.0, "mA": 1e-3},
}
_EXPECTED: dict[tuple[str, int], Sequence[str | None]] = {  # units by role and number of columns
    ("t", 1): ("s",),
    ("q", 3): ("m", "m", "rad"),
    ("q", _SIX): ("m", "m", "", "", "", ""),
    ("twist", 2): ("m/s", "rad/s"),
    ("twist", 3): ("m/s", "m/s", "rad/s"),
}
_MEANING = {  # of the columns of a role
    "t": "one name",
    "q": "x, y and psi, or x, y and a quaternion",
    "twist": "forward, left and yaw rate, or forward and yaw rate",
}


def _file_error(file: Path, problem: str, expected: str) -> InvalidArgument:
    return InvalidArgument(f"path is {str(file)!r}, {problem}, expected {expected}")


def read_csv(
    path: str | PathLike[str], columns: Mapping[str, str | Sequence[str]] | None
) -> tuple[dict[str, Array], tuple[str, ...], int]:
    """Return columns by role, units of inputs, and the number of rows with another length; see `Log`."""
    file = location("path", path)
    instance("columns", columns or {}, Mapping, "a mapping of roles to titles")
    pairs: Any = (columns or {}).items()
    given = {r: [str(n) for n in ([entry] if isinstance(entry, str | int) else entry)] for r, entry in pairs}
    bare = bool(given) and all(name.isdecimal() for titles in given.values() for name in titles)
    head, rows = _table(file, bare)
    names = [_UNIT.sub("", title).strip() for title in head]
    by_role = _standard_columns(names) | given
    for roles in (("t",), ("u",), ("q", "twist", "wheel_rates", "joints")):
        if not set(roles) & set(by_role):
            raise _file_error(
                file,
                f"whose columns are {format_names(names)}, none of them known for {' or '.join(roles)}",
                "columns={'t': 'time', 'q': ('x', 'y', 'psi'), 'u': (...)} with names of its header (in the "
                "command columns.t=time columns.q=x,y,psi columns.u=...)",
            )
    full_rows = [row for row in rows if len(row) == len(head)]
    if len(full_rows) < 2:
        raise _file_error(file, f"with {len(full_rows)} rows as long as its header", "two or more")
    used = {name for titles in by_role.values() for name in titles}
    distinct(f"path is {str(file)!r}, which has the column", [name for name in names if name in used])
    parts: dict[str, Array] = {}
    units: list[str] = []
    for role, titles in by_role.items():
        one_of("part of a log", role, ("t", *_RULES))
        for name in titles:
            one_of(f"column of {str(file)!r}", name, names)
        if role in _MEANING and (role, len(titles)) not in _EXPECTED:
            raise InvalidArgument(f"columns has {format_names(titles)} for {role}, expected {_MEANING[role]}")
        cols = [names.index(name) for name in titles]
        expected = _EXPECTED.get((role, len(cols)), ["rad/s" if role == "wheel_rates" else None] * len(cols))
        in_si = [_si_unit(file, head[k], unit) for k, unit in zip(cols, expected, strict=True)]
        cells = [_column(file, head[k], [row[k] for row in full_rows]) for k in cols]
        parts[role] = np.column_stack(cells) * [factor for _, factor in in_si]
        units = [unit for unit, _ in in_si] if role == "u" else units
    if not _si_unit(file, head[names.index(by_role["t"][0])], "s")[0]:
        parts["t"] = _since_start(parts["t"])
    if "q" in parts:
        parts["q"] = _in_plane(parts["q"])
    return parts, tuple(units), len(rows) - len(full_rows)


def _since_start(t: Array) -> Array:
    """Return times without a unit [s]: stamps since 1970 in ms, us or ns are recognised by their size."""
    size = np.nanmin(t)
    power = next((n for n in (9, 6, 3) if size > _EPOCH * 10**n), 0)
    return (t - size) * 10.0**-power if power else t


def _table(file: Path, bare: bool) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of a file with cells between commas, semicolons, tabs or blanks.

    Lines before the header that begin with # are comments. The last comment is the header if numbers follow.
    A bare file without header has the numbers of its columns as names: 1, 2, ...
    """
    with file_errors("read", "path", file):
        content = file.read_bytes().decode("utf-8-sig", errors="replace")
    lines = [line.strip() for line in content.splitlines() if line.strip()]
    comments = [*takewhile(lambda line: line.startswith("#"), lines)]
    lines = lines[len(comments) :]
    if comments and lines and _is_numbers(lines[0]):
        lines = [comments[-1].lstrip("# "), *lines]
    headless = bool(lines) and _is_numbers(lines[0])
    if not lines or (headless and not bare):
        problem = f"whose first line {format_value(lines[0])} contains numbers" if lines else "which is empty"
        by_number = "; without a header, columns={'t': '1', 'q': ('2', '3', '4'), ...} counts them from 1"
        expected = "a header that names the columns, such as t,x,y,psi,Fx,Fy,Mz" + by_number * headless
        raise _file_error(file, problem, expected)
    header = re.sub(r"\[[^][]*\]|\([^()]*\)", "", lines[0])  # units may contain blanks
    separator = next((each for each in _SEPARATORS if each in header), ",")
    with argument_errors(f"path is {str(file)!r}, expected a CSV file: ", of=csv.Error):
        read = csv.reader(lines, delimiter=separator, skipinitialspace=True)
        rows = [[cell.strip() for cell in row] for row in read]
        head = [str(k) for k in range(1, len(rows[0]) + 1)] if headless else rows.pop(0)
    if separator != ",":  # a comma then is a decimal comma
        rows = [[cell.replace(",", ".") for cell in row] for row in rows]
    return head, rows


def _is_numbers(line: str) -> bool:
    cells = [cell for cell in re.split(r"[;\t, ]+", line) if cell]
    return bool(cells) and not any(np.isnan(_number(cell)) for cell in cells)


def _number(cell: str) -> float:
    """Return a number, or a date in seconds since 1970; NaN for another text."""
    date = _DATE.fullmatch(cell)
    try:
        if date is None:
            return np.nan if "_" in cell else float(cell)
        *parts, share, zone = date.groups(default="")
        day = "{}-{}-{}T{}:{}:{}".format(*parts) + (zone or "+00:00")
        return datetime.fromisoformat(day).timestamp() + float(f"0.{share or 0}")
    except ValueError:
        return np.nan


def _column(file: Path, title: str, cells: Sequence[str]) -> Array:
    """Return the numbers of a column; NaN for cells without a number."""
    numbers = np.array([_number(cell) for cell in cells])
    if np.isnan(numbers).all():
        raise _file_error(
            file, f"whose column {title!r} has no numbers, but {format_value(cells[0])}", "numbers"
        )
    return numbers


def _factors(unit: str) -> str:
    """Return a unit with blanks between its factors."""
    return " ".join(map(str.strip, re.split(r"[*.\N{MIDDLE DOT}\N{DOT OPERATOR}]", unit)))


def si_spelling(unit: str) -> str:
    """Return the usual spelling of an SI unit, such as "N m" of "Nm"; another unit as it is."""
    return next((si for si, factors in _SI.items() if factors.get(_factors(unit)) == 1.0), unit)


def _si_unit(file: Path, title: str, expected: str | None) -> tuple[str, float]:
    """Return the SI unit of a column ("" for a title without unit), and the factor to this unit.

    Raises
    ------
    UnknownName, InvalidArgument
        If the unit is unknown, or belongs to another quantity than the column.
    """
    match = _UNIT.search(title)
    if not match or not match[1].strip():
        return "", 1.0
    unit = _factors(match[1])
    si = next((si for si, factors in _SI.items() if unit in factors), None)
    if si is None:
        names = [name for each in _SI.values() for name in each]
        raise UnknownName(f"unit of column {title!r} of {str(file)!r}", unit, names)
    if expected not in (None, si):
        options = ", ".join(_SI[expected]) if expected else "no unit for a quaternion"
        raise _file_error(file, f"whose column {title!r} is in {unit}", options)
    return si, _SI[si][unit]


def _standard_columns(names: Sequence[str]) -> dict[str, str | Sequence[str]]:
    """Return the columns with known names, by role."""
    spellings = {name.casefold(): name for name in names}

    def first(*sets: Sequence[str]) -> list[str]:
        return next(([spellings[n] for n in each] for each in sets if set(each) <= set(spellings)), [])

    def beginning(prefix: str) -> list[str]:
        return [name for name in names if name.startswith(prefix)]

    inputs = beginning("u_") or [spellings[name] for name in ("fx", "fy", "mz") if name in spellings]
    rates = [f"v_{name.removeprefix('u_')}" for name in inputs]  # names of Rollout.to_csv
    columns = {
        "t": first(("t",), ("time",), ("stamp",), ("timestamp",)),
        "q": first(*(("x", "y", *each) for each in _TURNS)),
        "u": inputs,
        "twist": beginning("twist_"),
        "wheel_rates": beginning("rate_") or (rates if set(rates) <= set(names) else []),
        "joints": beginning("joint_"),
    }
    return {role: titles for role, titles in columns.items() if titles}


def read_bag(path: str | PathLike[str], topics: Mapping[str, str]) -> dict[str, tuple[Array, Array]]:
    """Return times since the first message, and rows of each topic, by role; see `Log.from_bag`."""
    file = location("path", path)
    sensors = {"q", "twist", "wheel_rates", "joints"}
    if not isinstance(topics, Mapping) or "u" not in topics or not sensors & set(topics):
        example = "{'q': '/odom', 'u': '/wrench'}"
        expected = f"topics of u and of q, twist, wheel_rates or joints, such as {example}"
        raise unexpected_value("topics", topics, expected)
    for role in topics:
        one_of("part of a log", role, _RULES)
    highlevel = import_extra("rosbags.highlevel", "bags", "a bag")
    stores = import_extra("rosbags.typesys", "bags", "a bag")
    store = stores.get_typestore(stores.Stores.ROS2_HUMBLE)
    with file_errors("read", "path", file):
        file.stat()
        try:
            with highlevel.AnyReader([file], default_typestore=store) as reader:
                return _streams(reader, topics, file)
        except (PinmobileError, PermissionError):
            raise
        except Exception as error:  # rosbags and sqlite raise many errors for damaged files
            reason = format_value(str(error) or type(error).__name__)
            message = f"path is {str(file)!r}, expected a bag: it is damaged or another file: {reason}"
            raise FileError(message, errno=getattr(error, "errno", None), filename=str(file)) from error


def _streams(reader: Any, topics: Mapping[str, str], file: Path) -> dict[str, tuple[Array, Array]]:
    types = {each.topic: each.msgtype for each in reader.connections}
    rules: dict[str, list[tuple[str, Row]]] = {topic: [] for topic in topics.values()}
    for role, topic in topics.items():
        if topic not in types:
            choices = [f"{name} ({kind.rpartition('/')[2]})" for name, kind in types.items()]
            raise UnknownName(f"topic of {str(file)!r}", topic, choices)
        readers, kind = _RULES[role], types[topic].rpartition("/")[2]
        if kind not in readers:
            problem = f"topics[{role!r}] is {topic!r}, whose messages are {types[topic]}"
            raise InvalidArgument(f"{problem}, expected {', '.join(readers)}")
        rules[topic].append((role, readers[kind]))
    times: dict[str, list[tuple[int, int]]] = {role: [] for role in topics}
    rows: dict[str, list[Any]] = {role: [] for role in topics}
    connections = [each for each in reader.connections if each.topic in rules]
    left = sum(each.msgcount for each in connections)
    for connection, arrival, raw in reader.messages(connections=connections):
        left -= 1
        message = reader.deserialize(raw, connection.msgtype)
        header = getattr(message, "header", None)
        time = arrival if header is None else header.stamp.sec * 10**9 + header.stamp.nanosec
        for role, row in rules[connection.topic]:
            times[role].append((time, arrival))
            rows[role].append(row(message))
    if left > 0:  # a damaged chunk without CRC is only read up to the damage
        raise ValueError(f"{left} messages of the index are missing")
    for role, topic in topics.items():
        lengths = sorted({len(row) for row in rows[role]})
        if len(rows[role]) < 2 or len(lengths) > 1 or not lengths[0]:
            problem = f"whose topic {topic!r} has {len(rows[role])} messages of {lengths} numbers"
            raise _file_error(file, problem, f"2 or more messages of {role} with the same number of numbers")
    has_stamps = all(each[-1][0] > each[0][0] for each in times.values())  # otherwise use times of arrival
    stamps = {role: [pair[not has_stamps] for pair in each] for role, each in times.items()}
    first = min(min(each) for each in stamps.values())  # integer nanoseconds: floats have too few digits
    seconds = {role: 1e-9 * np.array([time - first for time in each], float) for role, each in stamps.items()}
    arrays = {role: np.array(rows[role], float) for role in topics}
    return {role: (seconds[role], _in_plane(x) if role == "q" else x) for role, x in arrays.items()}


Row = Callable[[Any], Any]


def _in_plane(q: Array) -> Array:
    """Return poses (x, y, psi) also of x, y and quaternions, which may be not normalised."""
    if q.shape[1] != _SIX:
        return q
    x, y, z, w = q[:, 2:].T
    return np.column_stack([q[:, :2], np.arctan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)])


def _pose_in(place: str, turn: str) -> Row:
    """Return a function that reads x, y and a quaternion, by the names of position and orientation."""
    return attrgetter(f"{place}.x", f"{place}.y", *(f"{turn}.{axis}" for axis in "xyzw"))


def _read_fields(prefix: str, *names: str) -> Row:
    """Return a function that reads numbers of a part of a message."""
    return attrgetter(*(f"{prefix}{name}" for name in names))


_WRENCH, _TWIST = ("force.x", "force.y", "torque.z"), ("linear.x", "linear.y", "angular.z")
_COMMAND = "linear.x", "angular.z"
_ARRAYS: dict[str, Row] = dict.fromkeys(("Float64MultiArray", "Float32MultiArray"), attrgetter("data"))
_NESTED_POSE = _pose_in("pose.pose.position", "pose.pose.orientation")
_RULES: dict[str, dict[str, Row]] = {
    "q": {
        **{"Odometry": _NESTED_POSE, "PoseWithCovarianceStamped": _NESTED_POSE},
        "PoseStamped": _pose_in("pose.position", "pose.orientation"),
        **{"Pose": _pose_in("position", "orientation"), "Pose2D": _read_fields("", "x", "y", "theta")},
        "TransformStamped": _pose_in("transform.translation", "transform.rotation"),
    },
    "u": {
        **{"WrenchStamped": _read_fields("wrench.", *_WRENCH), "Wrench": _read_fields("", *_WRENCH)},
        **{"Twist": _read_fields("", *_COMMAND), "TwistStamped": _read_fields("twist.", *_COMMAND)},
        **{"JointState": attrgetter("effort"), **_ARRAYS},
    },
    "twist": {
        **dict.fromkeys(("Odometry", "TwistWithCovarianceStamped"), _read_fields("twist.twist.", *_TWIST)),
        **{"TwistStamped": _read_fields("twist.", *_TWIST), "Twist": _read_fields("", *_TWIST)},
    },
    "wheel_rates": {"JointState": attrgetter("velocity"), **_ARRAYS},
    "joints": {"JointState": attrgetter("position"), **_ARRAYS},
}

_SLOWEST, _FASTEST = 0.25, 4.0  # range of rates
_SAMPLES = 4096  # largest number of samples of a signal
_PARTS = 40.0  # of the span, in which the first search looks at the activity
_REFINEMENT = 4.0  # by which each search is finer than the one before
_INPUT_ADVANCE = 0.1  # [s], by which the inputs are taken earlier: their delay is estimated, and not negative
_CANDIDATES = 8  # candidates of a search that the next one refines
_UNIT_RATE_RATIO = 0.8  # unexplained share per that at the rate 1 above which the rate is 1
_SMALLEST_OFFSET = 0.15  # [s], smallest reported offset, and change of the offset along a log
_SMALL = 1e-3  # smallest singular value of the motion, as a share of the largest
_LEAST_R_SQUARED = 0.4  # smallest mean R^2 of inputs that move the robot


def clock_of(t_u: Array, u: Array, t: Array, x: Array, is_pose: bool) -> tuple[float, float]:
    """Return offset [s] and rate of the clock of inputs: time of the motion = offset + rate * t_u.

    The method searches the rate and the offset at which speeds and accelerations explain the inputs best:
    first their smoothed activity, then the signals themselves, finer and finer. Within some tenths of a
    second the offset cannot be distinguished from a delay, which `identify` estimates.

    Parameters
    ----------
    t_u, t : ndarray, shape (M,), (N,)
        Times of the inputs, and of the motion, each of its own clock [s].
    u : ndarray, shape (M, nu)
        Inputs.
    x : ndarray, shape (N, k)
        Poses (x, y, psi), or rates: body twists or wheel rates.
    is_pose : bool
        Whether the motion is given as poses.

    Raises
    ------
    InvalidArgument
        If the motion does not explain the inputs at any rate.
    """
    valid = ~np.isnan(u).any(axis=1)
    t_u, u, span = t_u[valid], u[valid], t[-1] - t[0]
    h = max(float(np.median(np.diff(t))), span / _SAMPLES)
    motion = _signals(t - t[0], x, np.arange(0.0, span, h), is_pose)
    stream = np.column_stack([t_u - t_u[0], u])
    first_rates = np.array([span / stream[-1, 0], 1.0])  # both logs begin and end together, or have one rate

    def best(rates: Array, width: float, smooth: float, finer: float = 1.0, envelope: bool = False) -> Any:
        spacing = 0.25 * smooth / finer / span
        log_steps = np.arange(-np.ceil(width / spacing), np.ceil(width / spacing) + 1) * spacing
        candidates = np.unique(np.append(np.outer(rates, np.exp(log_steps)), first_rates))
        candidates = candidates[(candidates >= _SLOWEST) & (candidates <= _FASTEST)]
        columns = _moving_average(_activity(motion) if envelope else motion, smooth / h)
        left, sizes, _ = np.linalg.svd(columns, full_matrices=False)
        signals = np.ascontiguousarray(left[:, sizes > _SMALL * sizes[0]].T)
        spectra: dict[int, Array] = {}
        scores = [_match(signals, spectra, stream, rate, h, smooth, envelope) for rate in candidates]
        return np.array(sorted(scores, reverse=True)), 2 * spacing

    smooth, finer = span / _PARTS, 1.0
    matches, width = best(first_rates, np.log(_FASTEST), smooth, envelope=True)
    matches, width = best(matches[:_CANDIDATES, 1], width, smooth)
    while smooth / finer > h:
        if finer == 1.0 and smooth > 2 * _REFINEMENT * h:
            other, narrow = best(matches[:_CANDIDATES, 1], width, smooth / _REFINEMENT)
            if other[0, 0] > matches[0, 0]:  # coarser is better where accelerations are noisy
                matches, width, smooth = other, narrow, smooth / _REFINEMENT
                continue
        finer *= _REFINEMENT
        matches, width = best(matches[:_CANDIDATES, 1], width, smooth, finer)
    share, rate, offset = matches[0].tolist()
    unit_rate = matches[matches[:, 1] == 1.0][0].tolist()
    if 1 - share > _UNIT_RATE_RATIO * (1 - unit_rate[0]):
        share, rate, offset = unit_rate
    if share < _LEAST_R_SQUARED:
        raise InvalidArgument(
            f"t_u belongs to inputs of which the motion explains {max(share, 0.0):.0%} at most, at any "
            "rate and offset of their clock, expected inputs that move the robot"
        )
    return float(t[0] + offset - _INPUT_ADVANCE - rate * t_u[0]), float(rate)


def clock_hint(t: Array, u: Array, x: Array, is_pose: bool) -> str:
    """Return the correction of the clock of a log's inputs as text; "" if there is none."""
    try:
        offset, rate = clock_of(t, u, t, x, is_pose)
    except InvalidArgument:
        return ""
    shift = offset + _INPUT_ADVANCE + (rate - 1) * t[0]
    if abs(shift) < _SMALLEST_OFFSET and abs(rate - 1) * (t[-1] - t[0]) < _SMALLEST_OFFSET:
        return ""
    return (
        f"The motion explains the inputs best if their times are multiplied by {rate:.6g} and moved by "
        f"{shift:.3g} s, as of another clock: Log.from_streams(..., one_clock=False) corrects this"
    )


def _match(
    motion: Array,
    spectra: dict[int, Array],
    timed_inputs: Array,
    rate: float,
    h: float,
    smooth: float,
    envelope: bool,
) -> tuple[float, float, float]:
    """Return the largest mean R^2 of inputs for the orthonormal signals of a motion, rate, and offset [s].

    `motion` has shape (k, N). `spectra` has its Fourier transforms by their length.
    """
    from scipy.fft import irfft, next_fast_len, rfft  # slow to load

    t, u = rate * timed_inputs[:, 0], timed_inputs[:, 1:]
    inputs = u[np.searchsorted(t, np.arange(0.0, t[-1], h), side="right") - 1]
    inputs = _moving_average(_activity(inputs) if envelope else inputs, smooth / h)
    count, size = motion.shape[1], next_fast_len(motion.shape[1] + len(inputs), real=True)
    if size not in spectra:
        spectra[size] = rfft(motion, size)
    each = irfft(spectra[size][:, None] * np.conj(rfft(inputs.T, size)), size)
    total = np.einsum("kmn,kmn->n", each, each) / inputs.shape[1]
    lag = int(total.argmax())
    return float(total[lag]), rate, h * (lag if lag < count else lag - size)


def _signals(t: Array, x: Array, grid: Array, is_pose: bool) -> Array:
    """Return speeds, of poses both in the body and in the inertial frame, and accelerations on a grid."""
    rows = ~np.isnan(x).any(axis=1)
    speeds = np.column_stack([np.interp(grid, t[rows], column) for column in x[rows].T])
    if is_pose:
        v = np.gradient(speeds, grid[1], axis=0)
        body_velocity = np.exp(-1j * speeds[:, 2]) * (v[:, 0] + 1j * v[:, 1])
        speeds = np.column_stack([body_velocity.real, body_velocity.imag, v])
    return np.column_stack([speeds, np.gradient(speeds, grid[1], axis=0)])


def _activity(x: Array) -> Array:
    return np.asarray(np.linalg.norm(x / (x.std(axis=0) + 1e-300), axis=1, keepdims=True))


def _moving_average(x: Array, samples: float) -> Array:
    """Return columns after a moving average, without their means, of length 1."""
    from scipy.ndimage import uniform_filter1d  # slow to load

    y = uniform_filter1d(x, max(1, round(samples)), axis=0)
    y = y - y.mean(axis=0)
    return np.asarray(y / (np.linalg.norm(y, axis=0) + 1e-300))
