"""What moves: properties of nodes over the frames of a recording, and as compact animation tracks."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.simulation import Rollout

__all__ = ["Channel", "along", "frame_times", "poses_of", "sampled", "tracks"]

_KINDS = {"position": "vector3", "scale": "vector3", "quaternion": "quaternion"}
_DIGITS = {"position": 5, "scale": 5, "quaternion": 6, "drawn": 1}
_MOST_FRAMES = 200_000


@dataclass(frozen=True, eq=False)
class Channel:
    """A property of a node that changes from frame to frame.

    Parameters
    ----------
    path : str
        The node, such as ``"meshcat/robot"``.
    name : str
        The property: position, quaternion or scale, ``drawn`` (a number) or ``caption`` (a text).
    values : ndarray, shape (n, k), or sequence of n str
        One for each frame.
    """

    path: str
    name: str
    values: Array | Sequence[str]

    def at(self, frame: int) -> Any:
        """Return the value at a frame as meshcat takes it."""
        value = self.values[frame]
        if isinstance(value, str):
            return value
        return float(value[0]) if self.name == "drawn" else [float(x) for x in value]


def frame_times(runs: Mapping[str, Rollout], fps: float, speed: float) -> Array:
    """Return the times of the frames, shape (n,) [s], the last sample's included.

    Parameters
    ----------
    runs : mapping of str to Rollout
        What is shown.
    fps : float
        Frames per second.
    speed : float
        Seconds of the rollout per second.

    Raises
    ------
    InvalidArgument
        If they are too many.
    """
    start, end = min(run.t[0] for run in runs.values()), max(run.t[-1] for run in runs.values())
    count = float(end - start) * fps / speed
    if count > _MOST_FRAMES:
        raise InvalidArgument(
            f"fps is {fps:g} 1/s, which makes {count:.3g} frames at a speed of {speed:g}, "
            f"expected at most {_MOST_FRAMES}"
        )
    grid = start + np.arange(int(np.ceil(count - 1e-6))) * speed / fps
    return np.append(grid, end)


def along(path: str, poses: Array, height: float = 0.0) -> list[Channel]:
    """Return the channels of a node that follows poses (x, y, psi), shape (n, 3) [m, m, rad]."""
    zero = np.zeros(len(poses))
    position = np.column_stack([poses[:, :2], zero + height])
    half = poses[:, 2] / 2
    quaternion = np.column_stack([zero, zero, np.sin(half), np.cos(half)])
    return [Channel(path, "position", position), Channel(path, "quaternion", quaternion)]


def poses_of(path: str, placements: Array) -> list[Channel]:
    """Return the channels of a node at placements, shape (n, 4, 4)."""
    R = placements[:, :3, :3]
    return [
        Channel(path, "position", placements[:, :3, 3]),
        Channel(path, "quaternion", _continuous(_quaternions(R))),
    ]


def sampled(times: Array, t: Array, values: Array) -> Array:
    """Return values, shape (N, k), at other times, shape (n,); straight between two samples."""
    return np.stack([np.interp(times, t, column) for column in values.T], axis=-1)


def tracks(channels: Iterable[Channel], times: Array, end: float) -> list[dict[str, Any]]:
    """Return meshcat's animations: few digits, and no key between two that are equal to it.

    Parameters
    ----------
    channels : iterable of Channel
        What moves.
    times : ndarray, shape (n,)
        Of the frames [s], from 0.
    end : float
        When all of them begin again [s].
    """
    by_path: dict[str, list[dict[str, Any]]] = {}
    for channel in channels:
        by_path.setdefault(channel.path, []).append(_track(channel, times))
    return [
        {"path": path, "clip": {"fps": 1, "name": "default", "duration": round(end, 4), "tracks": parts}}
        for path, parts in by_path.items()
    ]


def _track(channel: Channel, times: Array) -> dict[str, Any]:
    if channel.name in _DIGITS:
        values = np.round(np.asarray(channel.values, np.float64), _DIGITS[channel.name]) + 0.0
        new = np.any(values[1:] != values[:-1], axis=1)
        kept = np.concatenate([[True], new]) | np.concatenate([new, [False]])
        kept[-1] |= bool(new.any())
        flat = values[kept].ravel().tolist()
        listed: list[Any] = [int(x) if x == int(x) else x for x in flat]
        kind = _KINDS.get(channel.name, "number")
    else:
        listed = list(channel.values)
        kept = np.array([True, *(a != b for a, b in pairwise(listed))])
        listed = [text for text, keep in zip(listed, kept, strict=True) if keep]
        kind = "string"
    return {
        "name": f".{channel.name}",
        "type": kind,
        "times": np.round(times[kept], 4).tolist(),
        "values": listed,
    }


def _quaternions(R: Array) -> Array:
    """Return (x, y, z, w) of rotations, shape (n, 3, 3), by the largest of the four (Shepperd, 1978)."""
    trace = np.trace(R, axis1=1, axis2=2)
    diagonal = np.diagonal(R, axis1=1, axis2=2)
    squares = np.column_stack([1 + 2 * diagonal - trace[:, None], 1 + trace])
    candidates = np.empty((len(R), 4, 4))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        candidates[:, i, i] = squares[:, i]
        candidates[:, i, j] = R[:, j, i] + R[:, i, j]
        candidates[:, i, k] = R[:, k, i] + R[:, i, k]
        candidates[:, i, 3] = R[:, k, j] - R[:, j, k]
        candidates[:, 3, i] = R[:, k, j] - R[:, j, k]
    candidates[:, 3, 3] = squares[:, 3]
    best = candidates[np.arange(len(R)), squares.argmax(axis=1)]
    return np.asarray(best / np.linalg.norm(best, axis=1, keepdims=True))


def _continuous(quaternions: Array) -> Array:
    """Return the same rotations without a change of sign from one to the next."""
    turns = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0
    signs = np.concatenate([[1.0], np.where(np.cumsum(turns) % 2, -1.0, 1.0)])
    return np.asarray(quaternions * signs[:, None])
