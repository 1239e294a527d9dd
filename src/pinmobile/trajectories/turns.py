"""Turns on the spot: when a path is held, and how the heading turns meanwhile."""

from collections.abc import Sequence

import numpy as np

from pinmobile.arrays import Array
from pinmobile.constancy import constant
from pinmobile.trajectories.reference import Reference
from pinmobile.trajectories.winding import Jump

__all__ = ["TurnsOnTheSpot"]


@constant
class TurnsOnTheSpot:
    """The clock of a trajectory that holds its path at some times to turn.

    Parameters
    ----------
    jumps : sequence of Jump, length m
        Where the heading jumps, in order.
    turn_time : float
        How long each turn lasts [s].
    path_duration : float
        Duration of the path [s].

    Attributes
    ----------
    starts : ndarray, shape (m,)
        When the turns start, on the trajectory's clock [s].
    duration : float
        Duration of the trajectory [s].
    """

    def __init__(self, jumps: Sequence[Jump], turn_time: float, path_duration: float) -> None:
        self._turn_time = turn_time
        held = np.array([jump.time for jump in jumps])
        self.starts = held + turn_time * np.arange(len(jumps))
        self.duration = path_duration + turn_time * len(jumps)
        self._ends = self.starts + turn_time
        # Of the path's times between turns the one at which the next turn starts belongs to what follows.
        self._first = np.append(0.0, held)
        self._last = np.append(np.nextafter(held, 0.0), path_duration)
        # In powers of the part of the turn time that has passed, the constant first.
        self._quintics = np.array([_quintic(j.before, j.after, turn_time) for j in jumps]).reshape(-1, 6).T

    def path_times(self, t: Array) -> Array:
        """Return the time of the path, shape (...) [s], at the trajectory's `t`, shape (...) [s]."""
        if not len(self.starts):
            return t
        begun = np.searchsorted(self.starts, t, side="right")
        s = t - self._turn_time * begun
        return np.asarray(np.minimum(np.maximum(s, self._first[begun]), self._last[begun]))

    def filled(self, t: Array, reference: Reference) -> Reference:
        """Return the reference with the turns in their place.

        Parameters
        ----------
        t : ndarray, shape (...)
            Times of the trajectory [s].
        reference : Reference
            That of the held path, arrays of shape (..., 3); written to.
        """
        if not len(self.starts):
            return reference
        turn = np.searchsorted(self.starts, t, side="right") - 1
        turning = (turn >= 0) & (t < self._ends[turn])
        turn = turn[turning]
        part = (t[turning] - self.starts[turn]) / self._turn_time
        psi, rate, half = np.zeros((3, *part.shape))
        for coefficients in self._quintics[::-1]:
            half = half * part + rate
            rate = rate * part + psi
            psi = psi * part + coefficients[turn]
        reference.v[turning] = 0.0
        reference.a[turning] = 0.0
        reference.q[turning, 2] = psi
        reference.v[turning, 2] = rate / self._turn_time
        reference.a[turning, 2] = 2 * half / self._turn_time**2
        return reference


def _quintic(before: Array, after: Array, duration: float) -> Array:
    scale = np.array([1.0, duration, duration**2])
    (p, v, a), (p1, v1, a1) = before * scale, after * scale
    d = p1 - p
    return np.array(
        [
            p,
            v,
            a / 2,
            10 * d - 6 * v - 4 * v1 - (3 * a - a1) / 2,
            -15 * d + 8 * v + 7 * v1 + (3 * a - 2 * a1) / 2,
            6 * d - 3 * (v + v1) - (a - a1) / 2,
        ]
    )
