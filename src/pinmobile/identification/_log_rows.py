"""Rows of a log: checks of times and poses, and integrals of inputs."""

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


def lost_rows(given: Mapping[str, Array]) -> NDArray[np.bool_]:
    """Return which rows have NaN in any part of a log."""
    lost = [np.isnan(x).any(axis=tuple(range(1, x.ndim))) for x in given.values()]
    return np.asarray(np.logical_or.reduce(lost))


def check_times(given: Mapping[str, Array], kept: NDArray[np.int_], lost: NDArray[np.bool_]) -> None:
    """Refuse times that do not increase, are of another unit, or lack too many rows in a row.

    Parameters
    ----------
    given : mapping of str to ndarray
        Parts of the log.
    kept : ndarray of int
        Rows whose time and input are known.
    lost : ndarray of bool, shape (N,)
        Rows that have NaN in any part.
    """
    t, there = given["t"], kept[~lost[kept]]
    if len(there) < 2:
        raise InvalidArgument(f"t has {len(there)} times without NaN in their rows, expected more")
    increasing("t", t[kept])
    usual = float(np.median(np.diff(t[kept])))
    if usual > _LONGEST_STEP:
        raise InvalidArgument(f"t has steps of {usual:g} s, expected seconds: are these milliseconds?")
    bridged = max(_HOLE, round(_BRIDGED / usual)), f"over more than {_BRIDGED} s what is bridged is a guess"
    for at, (most, why) in ((kept, (_HOLE, "what was applied meanwhile is not known")), (there, bridged)):
        worst = int(np.diff(t[at]).argmax())
        first, last = at[[worst, worst + 1]]
        if t[last] - t[first] > (most + 1.5) * usual:
            gone = {name: int(lost_rows({name: x[first + 1 : last]}).sum()) for name, x in given.items()}
            name = max(gone, key=lambda each: gone[each])
            what = f"{name} has {gone[name]} rows of NaN in a row" if gone[name] else "t has a gap"
            raise InvalidArgument(
                f"{what}, between {t[first]:g} and {t[last]:g} s, expected {most} rows at most: {why}; cut "
                "the log there, identify takes several"
            )


def check_pose(t: Array, q: Array) -> None:
    """Refuse poses of a slower sensor, which stand in several rows each, and those of other units."""
    dt, psi = step(t), q[:, 2]
    apart = max(1, round(_WINDOW / dt))
    if len(t) <= apart:
        return
    lasts = np.diff(np.flatnonzero((np.diff(q, axis=0) != 0).any(axis=1)))
    held = lasts[lasts * dt < _HELD]  # longer is a robot that stands
    usual = float(np.median(held)) if len(held) > _OFTEN else 1.0
    if usual > 1 and (np.abs(held - usual) <= 1).mean() > _EVENLY:
        raise InvalidArgument(
            f"q has each pose in {usual:g} rows, of {dt:.3g} s each, expected it once, and NaN in rows "
            "where none was measured, or Log.from_streams"
        )

    def rates(x: Array) -> Array:
        return np.abs(x[apart:] - x[:-apart]) / (t[apart:] - t[:-apart])

    speed, fast = np.median(np.hypot(rates(q[:, 0]), rates(q[:, 1]))), np.quantile(rates(psi), 0.9)
    if speed > _FASTEST:
        raise InvalidArgument(
            f"q moves at {speed:.3g} m/s most of the time, expected metres: are these centimetres or "
            "millimetres?"
        )
    whole = (steps := np.abs(np.diff(psi)))[steps > 1.9 * np.pi]
    turns = max(np.median(rates(np.unwrap(psi))), fast) > _FASTEST_TURN
    if np.median(whole) > 4 * np.pi if whole.size else turns:
        raise InvalidArgument(
            f"q has psi from {psi.min():.4g} to {psi.max():.4g}, which turns at {fast:.3g} rad/s and more, "
            "expected radians: are these degrees?"
        )


def held_integrals(t: Array, u: Array, edges: Array) -> Array:
    """Return the integrals between edges of values u each of which holds from its time on."""
    spent = np.vstack([np.zeros(u.shape[1]), np.cumsum(u[:-1] * np.diff(t)[:, None], axis=0)])
    k = np.clip(np.searchsorted(t, edges, side="right") - 1, 0, len(t) - 1)
    return np.asarray(np.diff(spent[k] + u[k] * (edges - t[k])[:, None], axis=0))
