"""Intervals of time, halved until a vector field turns little within each."""

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument

__all__ = ["Field", "halve"]

Field: TypeAlias = Callable[[Array], tuple[Array, Array, Array]]
"""Vectors and their first two derivatives, each of shape (m, 2), at times of shape (m,)."""

_MOST = 2**22


def halve(field: Field, cells: Array, levels: int) -> tuple[Array, Array]:
    """Halve cells until within each the field stays in a cone of half-angle 30 deg.

    A cell of width h around t is done once |u(t)| > h (|u'(t)| + h/2 |u''(t)|): the field then leaves
    u(t) by half its length at most (but for what the third derivative adds, and there is a factor of
    two to spare). No oscillation escapes: where the samples of u' vanish, those of u'' do not.

    Parameters
    ----------
    field : callable
        The field; see `Field`.
    cells : ndarray, shape (m, 2)
        Start and end of each cell [s].
    levels : int
        How often a cell may be halved.

    Returns
    -------
    done, left : ndarray, shape (..., 2)
        The cells that are done, in order of time, and those that still are not, in order too.

    Raises
    ------
    InvalidArgument
        If the number of cells runs away.
    """
    done = [cells[:0]]
    for _ in range(levels):
        if not len(cells):
            break
        good = _turns_little(field, cells)
        done.append(cells[good])
        cells = cells[~good]
        middle = cells.mean(axis=-1)
        cells = np.concatenate([[cells[:, 0], middle], [middle, cells[:, 1]]], axis=-1).T
        if len(cells) > _MOST:
            raise InvalidArgument(f"path turns more than {_MOST} times between t = 0 and its end")
    finished = np.concatenate(done)
    return finished[np.argsort(finished[:, 0])], cells[np.argsort(cells[:, 0])]


def _turns_little(field: Field, cells: Array) -> NDArray[np.bool_]:
    width = cells[:, 1] - cells[:, 0]
    u, du, ddu = (np.linalg.norm(vectors, axis=-1) for vectors in field(cells.mean(axis=-1)))
    return np.asarray(u > width * (du + width / 2 * ddu))
