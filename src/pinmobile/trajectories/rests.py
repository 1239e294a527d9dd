"""Where a path rests: at the ends of its analytic pieces, tested; inside them, searched for."""

from itertools import pairwise

import numpy as np

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.paths import Path, Piece, pieces_of
from pinmobile.trajectories.cells import halve
from pinmobile.trajectories.speeds import Scales

__all__ = ["inner_rests", "rest_order"]

_CELLS = 8
_LEVELS = 17  # a cell left over is a millionth of its piece
_HIGHEST = 6
_STEPS = 60
_NOISE = 1e-13  # a good deal above rounding, and below what counts as standstill


def rest_order(piece: Piece, t: float, scales: Scales, index: int) -> int:
    """Return how fast the speed vanishes: as |t - t_rest|^order, with 0 for one that does not.

    Parameters
    ----------
    piece : Piece
        An analytic piece that moves.
    t : float
        Time on it [s].
    scales : Scales
        Those of the path.
    index : int
        Which of the path's pieces it is.

    Raises
    ------
    InvalidArgument
        If so many derivatives vanish that there is no telling where the path goes.
    """
    for order in range(_HIGHEST + 1):
        if np.linalg.norm(piece.derivative(t, order + 1)) > scales.tolerance(order + 1)[index]:
            return order
    raise InvalidArgument(
        f"path has no direction at t = {t} s: its first {_HIGHEST + 1} derivatives vanish there"
    )


def inner_rests(path: Path, scales: Scales) -> list[list[float]]:
    """Return the times inside each piece at which the path rests [s], in order.

    Parameters
    ----------
    path : Path
        A path of two coordinates.
    scales : Scales
        Its scales.
    """
    pieces = pieces_of(path)
    edges = [
        np.linspace(p.start, p.end, _CELLS + 1)
        for p, dwells in zip(pieces, scales.dwells, strict=True)
        if not dwells
    ]
    cells = np.concatenate([np.stack([e[:-1], e[1:]], axis=-1) for e in edges])
    _, slow = halve(lambda t: _velocity(path, t, scales.top), cells, _LEVELS)
    starts = np.array([piece.start for piece in pieces])
    owners = np.searchsorted(starts, slow.mean(axis=-1), side="right") - 1
    found: list[list[float]] = [[] for _ in pieces]
    for first, last, owner in _clusters(slow, owners):
        rest = _refined(pieces[owner], first, last, scales, owner)
        if rest is not None:
            found[owner].append(rest)
    return found


def _velocity(path: Path, t: Array, top: float) -> tuple[Array, Array, Array]:
    v, a, jerk = (np.asarray(path.derivative(t, order)) for order in (1, 2, 3))
    # Rounding has a direction too, and would pass for motion where the speed is flat around a rest.
    still = np.linalg.norm(v, axis=-1, keepdims=True) < _NOISE * top
    return np.where(still, 0.0, v), a, jerk


def _clusters(cells: Array, owners: Array) -> list[tuple[float, float, int]]:
    if not len(cells):
        return []
    apart = (cells[1:, 0] > cells[:-1, 1]) | (owners[1:] != owners[:-1])
    breaks = [0, *(np.flatnonzero(apart) + 1).tolist(), len(cells)]
    return [(float(cells[i, 0]), float(cells[j - 1, 1]), int(owners[i])) for i, j in pairwise(breaks)]


def _refined(piece: Piece, first: float, last: float, scales: Scales, index: int) -> float | None:
    # A rest at an end of the piece is that end, and known already.
    for end in (piece.start, piece.end):
        if first <= end <= last and rest_order(piece, end, scales, index):
            return None
    # At a rest of order k the speed is too flat to say where it is; the k-th derivative is not.
    for order in range(_HIGHEST, 0, -1):
        t = _zero(piece, order, first, last)
        if t is not None and rest_order(piece, t, scales, index) >= order:
            return t
    return None


def _zero(piece: Piece, order: int, first: float, last: float) -> float | None:
    # Gauss-Newton for derivative(t, order) = 0, two equations in one unknown.
    t, room = (first + last) / 2, last - first
    for _ in range(_STEPS):
        value, slope = piece.derivative(t, order), piece.derivative(t, order + 1)
        square = float(slope @ slope)
        if not square:
            return None
        step = float(value @ slope) / square
        t -= step
        if not max(piece.start, first - room) < t < min(piece.end, last + room):
            return None
        if abs(step) <= np.spacing(t):
            break
    return t
