"""One path after another, where they meet."""

from __future__ import annotations

from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any, NamedTuple, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, frozen, positive
from pinmobile.errors import InvalidArgument
from pinmobile.parts import children, part
from pinmobile.paths.path import Curve, Path, Piece, jumps, pieces_of, told

_SLACK = 1e-9  # [m, m/s], and of their size: the rounding of numbers that were computed


@final
@part
class CompositePath(Curve):
    """One path after another, each starting where the one before it ends, at the velocity that that has.

    The acceleration may jump, as at the via point of a `CubicVia`. `path.moved` puts one where another ends.
    """

    paths: Any = children(Path, doc="paths of as many coordinates each")

    def check(self) -> None:
        """Raise `InvalidArgument` where a path does not go on where and as the one before it ends."""
        if not self.paths:
            raise InvalidArgument("paths is empty, expected at least one path")
        shapes = [np.shape(path(0.0)) for path in self.paths]
        for k, shape in enumerate(shapes):
            if len(shape) != 1 or shape != shapes[0]:
                expected = shapes[0] if len(shapes[0]) == 1 else "(n,)"
                raise InvalidArgument(f"paths[{k}] has points of shape {shape}, expected {expected}")
        for k, (before, after) in enumerate(pairwise(self.paths)):
            _check_joint(k, before, after, self._starts[k + 1])

    @cached_property
    def _starts(self) -> Array:
        """Times at which the paths start, and the end [s]."""
        lengths = (positive(f"paths[{k}].duration", p.duration, "s") for k, p in enumerate(self.paths))
        return frozen([0.0, *accumulate(lengths)])

    @property
    def duration(self) -> float:
        """The sum of the paths' durations [s]."""
        return float(self._starts[-1])

    @property
    def pieces(self) -> tuple[Piece, ...]:
        """Those of each path, one after another."""
        each = zip(self._starts.tolist(), self.paths, strict=False)
        return tuple(_Later(start, piece) for start, path in each for piece in pieces_of(path))

    def _at(self, t: Array, order: int) -> Array:
        which = np.searchsorted(self._starts[1:-1], t, side="right")
        found = np.empty((*t.shape, np.size(self.paths[0](0.0))))
        for k in np.unique(which):
            mine, path = which == k, self.paths[k]
            own = np.minimum(t[mine] - self._starts[k], path.duration)
            found[mine] = path.derivative(own, order)
        return found


class _Later(NamedTuple):
    """A piece of a path that starts later.

    Attributes
    ----------
    since : float
        When the path starts [s].
    piece : Piece
        The piece, on the path's own clock.
    """

    since: float
    piece: Piece

    @property
    def start(self) -> float:
        return self.since + float(self.piece.start)

    @property
    def end(self) -> float:
        return self.since + float(self.piece.end)

    def derivative(self, t: ArrayLike, order: int) -> Array:
        own = np.asarray(t, np.float64) - self.since
        return self.piece.derivative(np.clip(own, self.piece.start, self.piece.end), order)


def _check_joint(k: int, before: Path, after: Path, t: float) -> None:
    """Refuse a path that does not start where and as the one before it, number `k`, ends at `t` [s]."""
    last, first = pieces_of(before)[-1], pieces_of(after)[0]
    ends = [(last.derivative(last.end, order), first.derivative(first.start, order)) for order in (0, 1)]
    (here, there), (left, right) = ends
    if jumps(here, there, _SLACK):
        raise InvalidArgument(
            f"paths[{k + 1}] starts at {told(there)} m, {_size(there - here)} m from {told(here)} m, where "
            f"paths[{k}] ends at t = {t:g} s, expected one point; paths[{k + 1}].moved(x, y, angle) puts it "
            "elsewhere"
        )
    if jumps(left, right, _SLACK):
        raise InvalidArgument(
            f"paths[{k + 1}] starts with the velocity {told(right)} m/s, {_size(right - left)} m/s from "
            f"{told(left)} m/s, with which paths[{k}] ends at t = {t:g} s, expected one velocity: round the "
            "corner by a Polyline, or let both rest there"
        )


def _size(vector: Array) -> str:
    return f"{np.linalg.norm(vector):.3g}"
