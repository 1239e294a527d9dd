"""MCAP files of rollouts: all samples bit for bit, and standard messages of ROS 2; ROS is not needed."""

from __future__ import annotations

import json
import re
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from io import BytesIO
from os import PathLike
from typing import Any, NamedTuple, TypeVar

import numpy as np

from pinmobile.arrays import Array, location, scalar
from pinmobile.errors import FileError, InvalidArgument, format_names, import_extra
from pinmobile.files import check_form, file_errors, pack, unpack, write_file
from pinmobile.plant import PlantDescription, all_samples, stated
from pinmobile.signals import Signal
from pinmobile.trajectories import Reference

_T = TypeVar("_T")

_TOPIC, _SCHEMA, _METADATA = "/pinmobile/sample", "pinmobile_msgs/msg/Sample", "pinmobile"
_CDR = b"\0\1\0\0"  # encapsulation of little-endian numbers; float64 fields follow without gaps
_LAST_SECOND = 2**31  # ROS 2 has stamps of int32 seconds
_TYPES = {
    "/joint_states": "sensor_msgs/msg/JointState",
    "/input": "std_msgs/msg/Float64MultiArray",
    "/wrench": "geometry_msgs/msg/WrenchStamped",
    "/odom": "nav_msgs/msg/Odometry",
    "/twist": "geometry_msgs/msg/TwistStamped",
}
_BODY_WRENCH = [("Fx", "N"), ("Fy", "N"), ("Mz", "N m")]


class Columns(NamedTuple):
    """Array of a rollout.

    Attributes
    ----------
    key : str
        Its name, such as ``"q"``, ``"reference.q"`` or ``"signals.force"``.
    values : ndarray, shape (N,) or (N, k)
        Its values.
    titles : sequence of (str, str)
        Name and unit of each column.
    """

    key: str
    values: Array
    titles: Sequence[tuple[str, str]]


def write_mcap(
    path: str | PathLike[str], rollout: Any, form: str, columns: Sequence[Columns], start: float
) -> None:
    """Write a rollout to an MCAP file; see `Rollout.to_mcap`.

    Parameters
    ----------
    path : str or path-like
        File to write.
    rollout : Rollout
        Recorded samples.
    form : str
        Name and version of the format.
    columns : sequence of Columns
        All arrays of the rollout.
    start : float
        Time of t = 0 since 1970 [s].
    """
    mcap = import_extra("mcap.writer", "bags", "an MCAP file")
    typesys = import_extra("rosbags.typesys", "bags", "an MCAP file")
    stamps = _stamps(rollout.t, start)

    def content() -> bytes:
        store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        names = [name for name, _ in columns[1].titles]
        table = np.column_stack([part.values for part in columns]).astype("<f8")
        file = BytesIO()
        writer = mcap.Writer(file)
        writer.start("ros2", "pinmobile")
        writer.add_metadata(_METADATA, _metadata(rollout, form, columns))

        channels: dict[str, int] = {}

        def add(topic: str, kind: str, k: int, data: bytes) -> None:
            if topic not in channels:
                is_sample = topic == _TOPIC
                text = _definition(columns) if is_sample else store.generate_msgdef(kind, ros_version=2)[0]
                schema = writer.register_schema(kind, "ros2msg", text.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], stamps[k], data, stamps[k], sequence=k)

        for k, standard in enumerate(_messages(rollout, names, stamps)):
            add(_TOPIC, _SCHEMA, k, _CDR + table[k].tobytes())
            for topic, parts in standard.items():
                data = store.serialize_cdr(_message(store, _TYPES[topic], parts), _TYPES[topic])
                add(topic, _TYPES[topic], k, bytes(data))
        writer.finish()
        return file.getvalue()

    write_file(path, ".mcap", content)


def _stamps(t: Array, start: float) -> list[int]:
    """Return times since 1970, rounded to nanoseconds; fractions are exact, float64 has too few digits."""
    first = Fraction(scalar("start", start))
    stamps = [round((first + Fraction(x)) * 10**9) for x in t.tolist()]
    if stamps[0] < 0 or stamps[-1] >= _LAST_SECOND * 10**9:
        span = " to ".join(f"{x / 10**9:.10g}" for x in (stamps[0], stamps[-1]))
        message = f"start is {start:g}, which gives samples from {span} s since 1970"
        raise InvalidArgument(f"{message}, expected at least 0 and less than {_LAST_SECOND} s")
    return stamps


def _metadata(rollout: Any, form: str, columns: Sequence[Columns]) -> dict[str, str]:
    """Return the metadata of a file: texts, and JSON."""
    arrays = {part.key for part in columns} | {"reference", "signals"}
    outline = {name: field for name, field in rollout.content().items() if name not in arrays}
    t, titles = rollout.t.tolist(), [title for part in columns for title in part.titles]
    texts = {"format": form, "samples": str(len(t)), "dt": repr(t[1] - t[0]) if len(t) > 1 else ""}
    values = {
        "t": t,
        "names": [name for name, _ in titles],
        "units": [unit for _, unit in titles],
        "fields": _fields(columns),
        "arrays": [(part.key, len(part.titles) if part.values.ndim == 2 else None) for part in columns],
        "signals": {name: unit for name, (unit, _) in rollout.signals.items()},
    }
    texts |= {name: json.dumps(value) for name, value in values.items()} | {"description": pack(outline)}
    return texts | {"crc32": _checksum(texts)}  # MCAP has checksums of messages, but not of metadata


def _checksum(texts: Mapping[str, str]) -> str:
    return f"{zlib.crc32(json.dumps(sorted(texts.items())).encode()):08x}"


def _fields(columns: Sequence[Columns]) -> list[str]:
    """Return a name for each column that messages of ROS 2 allow."""
    fields: dict[str, None] = {}
    for part in columns:
        for name, _ in part.titles:
            title = f"q_{name}" if part.key == "q" else name
            field = re.sub(r"[^a-z0-9]+", "_", title.lower()).strip("_")
            while field in fields:
                field += f"_{len(fields)}"
            fields[field] = None
    return list(fields)


def _definition(columns: Sequence[Columns]) -> str:
    """Return the definition of the messages with all columns."""
    titles = [f"{name} [{unit}]" if unit else name for part in columns for name, unit in part.titles]
    pairs = zip(_fields(columns), titles, strict=True)
    return "".join(f"float64 {field}  # {json.dumps(title)}\n" for field, title in pairs)


def _messages(rollout: Any, names: list[str], stamps: Sequence[int]) -> Iterator[dict[str, tuple[Any, ...]]]:
    """Generate the parts of the standard messages of each sample, by topic."""
    q, u, efforts, motion = rollout.q, rollout.u, _efforts(rollout, names), _motion(rollout)
    rates, unknown = rollout.v if rollout.v.shape == q.shape else rollout.v[:, :0], np.zeros(36)
    has_wrench = [(entry.name, entry.unit) for entry in rollout.inputs[:3]] == _BODY_WRENCH
    for k, stamp in enumerate(stamps):
        time = divmod(stamp, 10**9)
        odom, base = (time, "odom"), (time, "base_link")
        parts: dict[str, tuple[Any, ...]] = {
            "/joint_states": ((time, ""), names, q[k], rates[k], efforts[k]),
            "/input": (([], 0), u[k]),
        }
        if has_wrench:
            parts["/wrench"] = odom, _planar(*u[k, :3])
        if motion is not None:
            (x, y, psi), twist = motion[0][k], _planar(*motion[1][k])
            pose = (x, y, 0.0), (0.0, 0.0, np.sin(psi / 2), np.cos(psi / 2))
            parts["/odom"] = odom, "base_link", (pose, unknown), (twist, unknown)
            parts["/twist"] = base, twist
        yield parts


def _planar(x: float, y: float, turn: float) -> tuple[Any, ...]:
    """Return the parts of a twist or wrench in the plane."""
    return (x, y, 0.0), (0.0, 0.0, turn)


def _message(store: Any, kind: str, parts: tuple[Any, ...]) -> Any:
    """Return a message of a type whose parts are values, or tuples for messages."""
    fields = store.fielddefs[kind][1]
    values = (
        _message(store, field[1], part) if isinstance(part, tuple) else part
        for part, (_, field) in zip(parts, fields, strict=True)
    )
    return store.types[kind](*values)


def _efforts(rollout: Any, names: list[str]) -> Array:
    """Return the forces and torques of the inputs along the entries of q, shape (N, nq), or (N, 0) if none.

    An input belongs to the coordinate of its name, or, where u and v have the same size, of its index. A
    coordinate without input has 0. A coordinate whose input is a voltage or a command has NaN.
    """
    efforts, are_known = np.zeros(rollout.q.shape), False
    for k, x in enumerate(rollout.inputs):
        column = names.index(x.name) if x.name in names else k if rollout.u.shape == efforts.shape else None
        if column is not None:
            is_force = x.unit in ("N", "N m")
            efforts[:, column], are_known = rollout.u[:, k] if is_force else np.nan, are_known or is_force
    return efforts if are_known else efforts[:, :0]


def _motion(rollout: Any) -> tuple[Array, Array] | None:
    """Return poses, and twists in the axes of the body; None for a plant without the pose of its body."""
    plant, q, v = rollout.plant, rollout.q, rollout.v
    try:
        poses = rollout.poses
    except InvalidArgument:
        return None
    columns = (0, 1, 2) if plant is None else PlantDescription.of(plant, q).posed
    if callable(stated(plant, "pose_rate")):
        rates = all_samples(plant, "pose_rate", q, v)
    elif columns is not None and q.shape == v.shape:
        rates = v[:, list(columns)]
    else:
        rates = np.full(poses.shape, np.nan)
    cos, sin, (x, y, turn) = np.cos(poses[:, 2]), np.sin(poses[:, 2]), rates.T
    return poses, np.column_stack([cos * x + sin * y, cos * y - sin * x, turn])


def read_mcap(path: str | PathLike[str], form: str, make: Callable[[dict[str, Any]], _T]) -> _T:
    """Read a file of `write_mcap`, and return a function of its content; see `Rollout.from_mcap`.

    Parameters
    ----------
    path : str or path-like
        File to read.
    form : str
        Expected name and version of the format.
    make : callable
        Function of the content.
    """
    mcap = import_extra("mcap.reader", "bags", "an MCAP file")
    file = location("path", path)
    with file_errors("read", "path", file):
        data = file.read_bytes()
    try:
        return make(_content(mcap.make_reader(BytesIO(data), validate_crcs=True), form))
    except Exception as error:  # mcap, struct and the decompressors raise many errors for damaged files
        reason = f"it has no {error}" if isinstance(error, KeyError) else str(error) or type(error).__name__
        message = f"path is {str(file)!r}, which is not a {form!r} file of Rollout.to_mcap: {reason}"
        raise FileError(message, errno=None, filename=str(file)) from error


def _content(reader: Any, form: str) -> dict[str, Any]:
    """Return the content of a file, see `Rollout.content`."""
    summary = reader.get_summary()
    topics = [item.topic for item in summary.channels.values()] if summary else []
    if _TOPIC not in topics:
        contents = f"its topics are {format_names(topics)}" if topics else "it has no topics"
        raise ValueError(f"{contents}, expected {_TOPIC}; Log.from_bag(path, topics) reads other topics")
    texts = {item.name: item.metadata for item in reader.iter_metadata()}[_METADATA]
    check_form(texts["format"], form)
    if texts.pop("crc32") != _checksum(texts):
        raise ValueError(f"its metadata {_METADATA!r} are damaged")
    messages = [message for _, _, message in reader.iter_messages(topics=_TOPIC, log_time_order=False)]
    data = b"".join(item.data[len(_CDR) :] for item in sorted(messages, key=lambda each: each.sequence))
    table = np.frombuffer(data, "<f8").reshape(int(texts["samples"]), -1)
    arrays, column = {}, 0
    for key, width in json.loads(texts["arrays"]):
        arrays[key] = table[:, column] if width is None else table[:, column : column + width]
        column += 1 if width is None else width
    units = json.loads(texts["signals"])
    content: dict[str, Any] = unpack(texts["description"])
    content["reference"] = Reference(*(arrays.pop(f"reference.{name}") for name in Reference._fields))
    content["signals"] = {name: Signal(unit, arrays.pop(f"signals.{name}")) for name, unit in units.items()}
    return content | arrays
