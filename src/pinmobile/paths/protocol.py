"""What a path is, what its analytic pieces are, and the times at which it may be asked."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, whole
from pinmobile.errors import InvalidArgument, shown

__all__ = ["Path", "Piece", "Whole", "checked_order", "checked_path", "pieces_of", "within"]

# Relative to the duration: room for the rounding of `n * dt`, and for no more.
_ROUNDING = 4 * float(np.finfo(np.float64).eps)


@runtime_checkable
class Path(Protocol):
    """A curve r(t) of n coordinates, 0 <= t <= duration; a user's own class is as good as the library's.

    At a knot `derivative` is the limit from the right, at the end of the path that from the left. A path
    that is not analytic all along says where by an attribute ``pieces``, a tuple of `Piece`; without it
    the whole path counts as one.
    """

    @property
    def duration(self) -> float:
        """Time from start to end [s]."""
        ...

    def __call__(self, t: ArrayLike, /) -> Array:
        """Return r(t), shape (..., n) [m], for `t` of shape (...) [s]."""
        ...

    def derivative(self, t: ArrayLike, order: int, /) -> Array:
        """Return the derivative of any order >= 0, shape (..., n) [m/s^order], at `t`, shape (...) [s]."""
        ...


class Piece(Protocol):
    """One analytic stretch of a path; valid on the closed interval, so that both its limits are exact."""

    @property
    def start(self) -> float:
        """Time at which it starts [s]."""
        ...

    @property
    def end(self) -> float:
        """Time at which it ends [s]."""
        ...

    def derivative(self, t: ArrayLike, order: int, /) -> Array:
        """Return the derivative, shape (..., n) [m/s^order], at start <= t <= end, shape (...) [s]."""
        ...


@dataclass(frozen=True)
class Whole:
    """A path that is analytic all along, as its only piece.

    Parameters
    ----------
    path : Path
        The path.
    """

    path: Path

    @property
    def start(self) -> float:
        """Zero [s]."""
        return 0.0

    @property
    def end(self) -> float:
        """The path's duration [s]."""
        return float(self.path.duration)

    def derivative(self, t: ArrayLike, order: int) -> Array:
        """Return the path's derivative, shape (..., n) [m/s^order], at `t`, shape (...) [s]."""
        return self.path.derivative(t, order)


def pieces_of(path: Path) -> tuple[Piece, ...]:
    """Return the analytic pieces of a path, in order; a path that names none is one piece."""
    return tuple(getattr(path, "pieces", ())) or (Whole(path),)


def checked_path(path: Any, size: int) -> Path:
    """Return a path whose points have 2 or 3 coordinates.

    Raises
    ------
    InvalidArgument
        If it is none, or its points have another shape.
    """
    if not isinstance(path, Path):
        raise InvalidArgument(
            f"path is {shown(path)}, expected a path: path(t), path.derivative(t, order), path.duration"
        )
    shape = np.shape(path(0.0))
    if shape != (size,):
        where = "the plane" if size == 2 else "space"
        raise InvalidArgument(f"path has points of shape {shape}, expected ({size},), a path in {where}")
    return path


def checked_order(order: Any) -> int:
    """Return the order of a derivative, at least 0.

    Raises
    ------
    InvalidArgument
        If it is no such whole number, or one that nobody needs.
    """
    return whole("order", order, least=0, most=_HIGHEST)


_HIGHEST = 1000  # order of a derivative: beyond, a figure's rates and their powers are no numbers


def within(name: str, t: ArrayLike, duration: float) -> Array:
    """Return the times as float64, after refusing those outside [0, duration].

    A few units of rounding beyond either end are allowed and cut off.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    t : array_like, any shape
        Times [s].
    duration : float
        The latest time allowed [s].

    Raises
    ------
    InvalidArgument
        If a time is not a finite number, or outside.
    """
    times = finite(name, t)
    slack = _ROUNDING * duration
    outside = (times < -slack) | (times > duration + slack)
    if outside.any():
        where = tuple(int(i) for i in np.argwhere(outside)[0])
        place = f"[{', '.join(map(str, where))}]" if where else ""
        raise InvalidArgument(f"{name}{place} is {times[where]} s, expected 0 <= {name} <= {duration} s")
    return np.asarray(np.minimum(np.maximum(times, 0.0), duration))
