"""What a trajectory is and gives, and what it asks of its path."""

from collections.abc import Iterable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from pinmobile.arrays import Array, ArrayLike, positive
from pinmobile.errors import InvalidArgument
from pinmobile.paths import Path, pieces_of
from pinmobile.paths.protocol import checked_path

__all__ = ["Reference", "Trajectory", "joined", "plane_path"]


class Reference(NamedTuple):
    """Where to be and how to move, at one time or at many.

    Attributes
    ----------
    q : ndarray, shape (..., nq)
        (x, y, psi) and, where there are arms, their configurations [m, m, rad, ...].
    v, a : ndarray, shape (..., nv)
        Velocity and acceleration [per s; per s^2]; of (x, y, psi) the two derivatives.
    """

    q: Array
    v: Array
    a: Array


@runtime_checkable
class Trajectory(Protocol):
    """A reference as a function of time, 0 <= t <= duration."""

    @property
    def duration(self) -> float:
        """Time from start to end [s]."""
        ...

    def __call__(self, t: ArrayLike, /) -> Reference:
        """Return the reference at the times `t`, shape (...) [s]."""
        ...


def joined(plane: Iterable[Array], headings: Iterable[Array]) -> Reference:
    """Return a reference made of a motion in the plane and one of the heading.

    Parameters
    ----------
    plane : iterable of three ndarray, shape (..., 2)
        Position, velocity and acceleration [m, m/s, m/s^2].
    headings : iterable of three ndarray, shape (...)
        psi and its two derivatives [rad, rad/s, rad/s^2].
    """
    return Reference(*(np.append(xy, psi[..., None], -1) for xy, psi in zip(plane, headings, strict=True)))


def plane_path(path: Any) -> Path:
    """Return `path`, after refusing what is not a path of two coordinates.

    Raises
    ------
    InvalidArgument
        If it is not.
    """
    plane = checked_path(path, 2)
    duration = positive("path.duration", plane.duration, "s")
    ends = [(float(piece.start), float(piece.end)) for piece in pieces_of(plane)]
    times = [0.0, *(end for _, end in ends)]
    if [start for start, _ in ends] != times[:-1] or times != sorted(set(times)) or times[-1] != duration:
        raise InvalidArgument(
            f"path.pieces has (start, end) {ends}, expected end to end from 0 to {duration}"
        )
    return plane
