"""Rows of a log: which have NaN, and whether times and poses can be those of a robot, in SI units."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, increasing
from pinmobile.errors import InvalidArgument

_HOLE = 3  # rows in a row that may be lost, with their inputs
_BRIDGED = 0.3  # [s] of rows without a measurement, half a window of the weak form: over more it is a guess
_LONGEST_STEP = 5.0  # [s]; times of longer steps are no seconds
_FASTEST = 60.0  # [m/s]; positions that change faster are no metres
_HELD, _OFTEN = 1.0, 20  # [s] for which a pose may be that of a slower sensor, and how often it must be
_EVENLY = 0.9  # of these
_FASTEST_TURN = 12.0  # [rad/s], two turns a second; what turns faster is told in degrees
_WINDOW = 0.25  # [s] over which speeds are looked at, so that noise is none


def step(t: Array) -> float:
    """Return the time between two samples: the mean of the steps that lack none."""
    steps = np.diff(t)
    return float(steps[steps < 1.5 * np.median(steps)].mean())


def lost_rows(given: Mapping[str, Array]) -> dict[str, NDArray[np.bool_]]:
    """Return which rows have NaN, by the part of the log."""
    return {name: np.array(np.isnan(x).reshape(len(x), -1).any(axis=1)) for name, x in given.items()}


def any_of(lost: Mapping[str, NDArray[np.bool_]]) -> NDArray[np.bool_]:
    """Return which rows have NaN in any part of the log."""
    return np.asarray(np.logical_or.reduce(list(lost.values())))


def check_times(rows: Array, kept: NDArray[np.int_], lost: Mapping[str, NDArray[np.bool_]]) -> None:
    """Refuse times that do not increase, are of another unit, or lack too many rows in a row.

    Parameters
    ----------
    rows : ndarray, shape (N,)
        All times.
    kept : ndarray of int
        Those whose input is known too.
    lost : mapping of str to ndarray of bool, shape (N,)
        Where there is NaN, by the part of the log.

    Raises
    ------
    InvalidArgument
        If they are such; the message tells NaN from times that jump.
    """
    there = kept[~any_of(lost)[kept]]
    if len(there) < 2:
        raise InvalidArgument(f"t has {len(there)} times without NaN in their rows, expected more")
    t = rows[kept]
    increasing("t", t)
    usual = float(np.median(np.diff(t)))
    if usual > _LONGEST_STEP:
        ladder = ((_LONGEST_STEP * 1e6, "nano"), (_LONGEST_STEP * 1e3, "micro"), (0.0, "milli"))
        small = next(name for least, name in ladder if usual > least)
        raise InvalidArgument(f"t has steps of {usual:g} s, expected seconds: are these {small}seconds?")
    applied = {name: lost[name] for name in ("t", "u")}
    _check_gaps(rows, kept, applied, usual, _HOLE, "what was applied meanwhile is not known")
    most = max(_HOLE, round(_BRIDGED / usual))
    _check_gaps(rows, there, lost, usual, most, f"over more than {_BRIDGED} s what is bridged is a guess")


def _check_gaps(
    rows: Array,
    kept: NDArray[np.int_],
    lost: Mapping[str, NDArray[np.bool_]],
    usual: float,
    most: int,
    why: str,
) -> None:
    """Refuse more rows in a row than may be missing between those kept, and say why, and which they are."""
    t = rows[kept]
    worst = int(np.diff(t).argmax())
    if t[worst + 1] - t[worst] <= (most + 1.5) * usual:
        return
    count = {name: int(each[kept[worst] + 1 : kept[worst + 1]].sum()) for name, each in lost.items()}
    name = max(count, key=lambda each: count[each])
    if not count[name]:
        raise InvalidArgument(
            f"t has a gap from {t[worst]:g} to {t[worst + 1]:g} s between steps of {usual:g} s, expected "
            "none: cut the log there, identify takes several"
        )
    raise InvalidArgument(
        f"{name} has {count[name]} rows of NaN in a row, between {t[worst]:g} and {t[worst + 1]:g} s, "
        f"expected {most} at most: {why}; cut the log there, identify takes several"
    )


def _check_new(t: Array, q: Array) -> None:
    """Refuse poses that stand in several rows each, as of a slower sensor, which are not measured anew."""
    news = np.flatnonzero((np.diff(q, axis=0) != 0).any(axis=1))
    lasts = np.diff(news)
    held = lasts[lasts * step(t) < _HELD]  # longer is a robot that stands
    usual = float(np.median(held)) if len(held) > _OFTEN else 1.0
    if usual > 1 and (np.abs(held - usual) <= 1).mean() > _EVENLY:
        raise InvalidArgument(
            f"q has each pose in {usual:g} rows, of {step(t):.3g} s each, expected it once, and NaN in rows "
            "where none was measured, or Log.from_streams"
        )


def check_pose(t: Array, q: Array) -> None:
    """Refuse poses that change as no robot's in metres and radians do.

    Raises
    ------
    InvalidArgument
        If they do so.
    """
    apart = max(1, round(_WINDOW / step(t)))
    if len(t) <= apart:
        return
    _check_new(t, q)
    dt = t[apart:] - t[:-apart]
    speed = np.hypot(*(q[apart:, :2] - q[:-apart, :2]).T) / dt
    if np.median(speed) > _FASTEST:
        raise InvalidArgument(
            f"q moves at {np.median(speed):.3g} m/s most of the time, expected metres: are these "
            "centimetres or millimetres?"
        )
    jumps = np.abs(np.diff(q[:, 2])) > 1.9 * np.pi
    turn = np.abs(np.unwrap(q[:, 2])[apart:] - np.unwrap(q[:, 2])[:-apart]) / dt
    plain = np.abs(q[apart:, 2] - q[:-apart, 2]) / dt
    in_turns = np.abs(np.diff(q[:, 2]))[jumps]
    if (in_turns.size and np.median(in_turns) > 4 * np.pi) or (
        not in_turns.size and max(np.median(turn), np.quantile(plain, 0.9)) > _FASTEST_TURN
    ):
        raise InvalidArgument(
            f"q has psi from {q[:, 2].min():.4g} to {q[:, 2].max():.4g}, which turns at "
            f"{np.quantile(plain, 0.9):.3g} rad/s and more, expected radians: are these degrees?"
        )
