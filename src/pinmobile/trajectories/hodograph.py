"""The direction of motion along a path, with its limits where the path rests."""

from dataclasses import dataclass
from itertools import pairwise
from math import factorial, inf

import numpy as np

from pinmobile.arrays import Array
from pinmobile.constancy import constant
from pinmobile.errors import InvalidArgument
from pinmobile.paths import Path, Piece, pieces_of
from pinmobile.trajectories.rests import inner_rests, rest_order
from pinmobile.trajectories.speeds import Scales

__all__ = ["Hodograph", "Leg", "Limit", "heading", "hodograph"]

_TERMS = 13
_TRUNCATION = 1e-17


@dataclass(frozen=True, eq=False)
class Limit:
    """The direction of motion at one end of a leg, and near it where the path rests there.

    Parameters
    ----------
    time : float
        The end [s].
    series : ndarray, shape (m, 2)
        Taylor coefficients of u(t) in powers of t - time; u is a positive multiple of the velocity.
    window : float
        Up to this distance the series stands for u [s]; negative where the path moves and its velocity
        does itself.
    speed : float
        Speed in that limit [m/s]; 0 where the path rests.
    """

    time: float
    series: Array
    window: float
    speed: float


@dataclass(frozen=True, eq=False)
class Leg:
    """A stretch of path between knots and rests."""

    head: Limit
    tail: Limit


@constant
class Hodograph:
    """The direction of motion along a path, a vector u(t) that is never zero and turns as the velocity.

    The velocity v itself is a hodograph but where the path rests. There v = tau^k w(tau) with w(0) not
    zero, tau the time since the rest, and u = w (its opposite before a rest of odd k, since there the
    velocity is) takes its place, by its Taylor series.

    Parameters
    ----------
    path : Path
        The path.
    legs : sequence of Leg, length L
        Its legs, in order.
    top : float
        The largest speed on it [m/s].
    """

    def __init__(self, path: Path, legs: list[Leg], top: float) -> None:
        self.path = path
        self.legs = tuple(legs)
        self.top = top
        self._starts = np.array([leg.head.time for leg in legs])
        self._limits = [limit for leg in legs for limit in (leg.head, leg.tail)]
        self._times = np.array([limit.time for limit in self._limits])
        self._windows = np.array([limit.window for limit in self._limits])
        series = np.zeros((len(self._limits), _TERMS, 2))
        for row, limit in zip(series, self._limits, strict=True):
            row[: len(limit.series)] = limit.series
        terms = np.flatnonzero(series.any(axis=(0, 2)))[-1] + 1
        self._series = series[:, :terms]

    def __call__(self, t: Array) -> tuple[Array, Array, Array]:
        """Return u and its first two derivatives, each of shape (..., 2), at `t`, shape (...) [s]."""
        return self.along(t, *(self.path.derivative(t, order) for order in (1, 2, 3)))

    def along(self, t: Array, v: Array, a: Array, jerk: Array) -> tuple[Array, Array, Array]:
        """As a call, for those who have velocity, acceleration and jerk at hand."""
        head = 2 * (np.searchsorted(self._starts, t, side="right") - 1)
        late = self._times[head + 1] - t < self._windows[head + 1]
        limit = head + late
        near = late | (t - self._times[head] < self._windows[head])
        if not near.any():
            return v, a, jerk
        u = np.stack([v, a, jerk])
        u[:, near] = self._expanded(limit[near], t[near])
        return u[0], u[1], u[2]

    def _expanded(self, limit: Array, t: Array) -> Array:
        tau = (t - self._times[limit])[..., None]
        series = self._series[limit]  # (..., terms, 2)
        u, du, half = np.zeros((3, *t.shape, 2))
        for k in range(series.shape[-2] - 1, -1, -1):
            half = half * tau + du
            du = du * tau + u
            u = u * tau + series[..., k, :]
        return np.stack([u, du, 2 * half])


def heading(u: Array, du: Array, ddu: Array) -> tuple[Array, Array, Array]:
    """Return the heading in [-pi, pi] and its first two derivatives, each of shape (...).

    psi = atan2(u_y, u_x), psi_dot = u x u' / u.u, psi_ddot = u x u'' / u.u - 2 psi_dot u.u' / u.u.

    Parameters
    ----------
    u, du, ddu : ndarray, shape (..., 2)
        A vector along the direction of motion and its first two derivatives by time.
    """
    (x, dx, ddx), (y, dy, ddy) = np.moveaxis(np.stack([u, du, ddu]), -1, 0)
    square = x * x + y * y
    rate = (x * dy - y * dx) / square
    acceleration = (x * ddy - y * ddx - 2 * rate * (x * dx + y * dy)) / square
    return np.arctan2(y, x), rate, acceleration


def hodograph(path: Path) -> Hodograph:
    """Return the hodograph of a path of two coordinates.

    Raises
    ------
    InvalidArgument
        If the path does not move at all, or at a rest so many derivatives vanish that there is no
        telling where it goes.
    """
    scales = Scales(path)
    if not scales.top:
        raise InvalidArgument(
            "path never moves, so it has no tangent; expected one that does, or FixedHeading"
        )
    rests = inner_rests(path, scales)
    legs: list[Leg | None] = []
    spans: list[tuple[float, float]] = []
    for index, piece in enumerate(pieces_of(path)):
        times = [float(piece.start), *rests[index], float(piece.end)]
        for start, end in pairwise(times):
            spans.append((start, end))
            legs.append(None if scales.dwells[index] else _leg(piece, start, end, scales, index))
    return Hodograph(path, _with_dwells(legs, spans), scales.top)


def _leg(piece: Piece, start: float, end: float, scales: Scales, index: int) -> Leg:
    half = (end - start) / 2
    return Leg(*(_limit(piece, t, side, half, scales, index) for t, side in ((start, 1), (end, -1))))


def _limit(piece: Piece, t: float, side: int, room: float, scales: Scales, index: int) -> Limit:
    k = rest_order(piece, t, scales, index)
    if not k:
        v, a, jerk = (piece.derivative(t, order) for order in (1, 2, 3))
        return Limit(t, np.array([v, a, jerk / 2]), -1.0, float(np.linalg.norm(v)))
    orders = range(k, k + _TERMS)
    series = np.array([piece.derivative(t, m + 1) / factorial(m) for m in orders]) * side**k
    series = series / np.linalg.norm(series[0])
    return Limit(t, series, min(room, _reach(series)), 0.0)


def _reach(series: Array) -> float:
    # The last terms are what is left out, give or take; three of them, because of odd and even series.
    powers = np.arange(len(series))[-3:]
    sizes = np.linalg.norm(series[-3:], axis=-1)
    return min(
        (
            float((_TRUNCATION / size) ** (1 / power))
            for size, power in zip(sizes, powers, strict=True)
            if size
        ),
        default=inf,
    )


def _with_dwells(legs: list[Leg | None], spans: list[tuple[float, float]]) -> list[Leg]:
    # Where the path dwells the heading is that before, or at first that to come.
    held = next(leg for leg in legs if leg is not None).head.series[:1]
    whole: list[Leg] = []
    for leg, (start, end) in zip(legs, spans, strict=True):
        filled = leg or Leg(Limit(start, held, inf, 0.0), Limit(end, held, -1.0, 0.0))
        held = filled.tail.series[:1]
        whole.append(filled)
    return whole
