"""How fast a path moves, accelerates and so on, piece by piece: what tells motion from rounding."""

import numpy as np

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.paths import Path, pieces_of

__all__ = ["STANDSTILL", "Scales", "largest"]

STANDSTILL = 1e-12
"""Below this part of the largest speed on a path, a speed is rounding (lecture model, section 7)."""

_SAMPLES = 64
_EPS = float(np.finfo(np.float64).eps)


def largest(path: Path, order: int) -> Array:
    """Return the largest length of a derivative on each piece of a path, as seen by samples.

    Parameters
    ----------
    path : Path
        A path of k pieces.
    order : int
        Order of the derivative.

    Returns
    -------
    lengths : ndarray, shape (k,)
        Close to the suprema [m/s^order], and the same whatever else is asked.

    Raises
    ------
    InvalidArgument
        If a derivative is not finite.
    """
    # Steps of the golden ratio fall into step with no oscillation of the path, as even ones may.
    fractions = (np.arange(1, _SAMPLES + 1) * (np.sqrt(5.0) - 1) / 2) % 1.0
    ends = np.array([(piece.start, piece.end) for piece in pieces_of(path)])  # (k, 2)
    times = ends[:, :1] + fractions * np.diff(ends)
    lengths = np.linalg.norm(path.derivative(times, order), axis=-1)  # (k, samples)
    if not np.isfinite(lengths).all():
        late = times[~np.isfinite(lengths)][0]
        raise InvalidArgument(f"path has no finite derivative of order {order} at t = {late} s")
    return np.asarray(lengths.max(axis=-1))


class Scales:
    """What is large and what is rounding in the derivatives of a path, on each of its k pieces.

    Parameters
    ----------
    path : Path
        The path.

    Attributes
    ----------
    top : float
        Largest speed on the path [m/s].
    dwells : ndarray of bool, shape (k,)
        The pieces on which it does not move.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._ends = np.array([piece.end for piece in pieces_of(path)])
        self._largest: dict[int, Array] = {}
        speeds = largest(path, 1)
        self.top = float(speeds.max())
        self.dwells = speeds <= STANDSTILL * self.top

    def tolerance(self, order: int) -> Array:
        """Return the length below which a derivative is rounding, shape (k,) [m/s^order]."""
        # The second term is what the rounding of the time itself makes of the next derivative.
        drift = 8 * _EPS * self._ends * self._scale(order + 1)
        return np.asarray(STANDSTILL * self._scale(order) + drift)

    def _scale(self, order: int) -> Array:
        if order not in self._largest:
            # A speed is measured by the path's, also on a slow piece; a later derivative by its own.
            of_path = np.full_like(self._ends, self.top)
            self._largest[order] = of_path if order == 1 else largest(self._path, order)
        return self._largest[order]
