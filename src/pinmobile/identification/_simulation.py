"""Segments of logs, and their simulation by any model."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.compiled import Recurrence, entries, processors, repeated, symbols

_SLOPE = 1e-6  # step of differences, as a share of the size of an initial state
_LEAST_SIZE = 1e-3  # smallest size of an input, as a share of the largest
MANY = 30_000  # samples that give first estimates
_AT_ONCE = 30_000  # samples that a thread simulates at once: they bound the memory, and fit in a cache
_PIECES = 10  # of these samples
_SHARED = "inputs", "lead", "blocks"  # that all segments have in common
_MOST_STEPS = 10**9  # bound of the integration steps in a sample; the actual count is one of the numbers


def pieces(start: int, stop: int, samples: int) -> list[slice]:
    """Return pieces of a part of so many samples in all, at equal distances: enough for first estimates."""
    size, step = MANY // _PIECES, samples // MANY
    if step < 2:
        return [slice(start, stop)]
    return [slice(k, min(k + size, stop)) for k in range(start, stop, size * step)]


class Segments(NamedTuple):
    """Segments of logs with separate initial states.

    Attributes
    ----------
    dt : ndarray, shape (S,)
        Time steps [s].
    t : ndarray, shape (S, L)
        Times since the first sample of the log [s].
    y : ndarray, shape (S, L, m)
        Measurements.
    good : ndarray of bool, shape (S, L)
        Mask of samples that count.
    noise : ndarray, shape (S, m)
        Standard deviation of the sensors; infinite without a sensor, 1 if unknown.
    start : ndarray, shape (S, n)
        First estimates of the initial states.
    inputs : ndarray, shape (N, nu)
        Inputs of all logs.
    at : ndarray of int, shape (S, W)
        Rows of the inputs near a segment.
    lead : int
        Number of these rows before the first sample.
    load : ndarray, shape (S, 4)
        Mass, first moments and inertia of the known load.
    blocks : int
        Number of blocks of a segment for the jackknife.
    """

    dt: Array
    t: Array
    y: Array
    good: NDArray[np.bool_]
    noise: Array
    start: Array
    inputs: Array
    at: NDArray[np.int_]
    lead: int
    load: Array
    blocks: int = 1

    @classmethod
    def cut(cls, dt: float, rows: tuple[Any, ...], span: Any, load: Any = 0.0, least: float = 0.0) -> Self:
        """Return the segments of a log.

        Parameters
        ----------
        dt : float
            Time step [s].
        rows : tuple of ndarray, shape (N, ...)
            Measurements, mask of those that count, estimates of states, inputs; and the noise, shape (m,).
        span : tuple of 5 int
            First sample, end, number of samples of a segment, and of inputs before and after it.
        load : array_like, shape () or (4,)
            Known load, see the class.
        least : float
            Smallest share of samples that count.
        """
        (first, stop, length, lead, more), (y, good, states, u, noise) = span, rows
        count = max(0, (stop - first) // length)
        at = first + np.arange(count * length).reshape(count, length)
        at = at[good[at].mean(axis=1) >= least]
        near = np.clip(at[:, :1] - lead + np.arange(lead + length + more), 0, len(u) - 1)
        sigma, known = np.tile(noise, (len(at), 1)), np.broadcast_to(load, (len(at), 4))
        start, times = states[at[:, 0]], np.full(len(at), dt)
        return cls(times, at * dt, y[at], good[at], sigma, start, u, near, lead, known)

    @classmethod
    def joined(cls, parts: list[Segments]) -> Segments:
        """Return the segments of several logs together."""
        before = np.cumsum([0, *(len(part.inputs) for part in parts)])
        moved = [part._replace(at=part.at + n) for part, n in zip(parts, before, strict=False)]
        joined: dict[str, Any] = {
            n: np.concatenate([getattr(x, n) for x in moved]) for n in cls._fields if n not in _SHARED
        }
        return cls(inputs=np.concatenate([x.inputs for x in parts]), lead=parts[0].lead, **joined)

    def some(self, rows: Any) -> Self:
        """Return some of the segments."""
        return self._replace(**{n: getattr(self, n)[rows] for n in self._fields if n not in _SHARED})

    @property
    def few(self) -> slice:
        """Segments at equal distances with samples enough for first estimates."""
        return slice(None, None, max(1, min(len(self.good), self.good.size // MANY)))

    @property
    def sizes(self) -> Array:
        """Standard deviations of the inputs, at least a thousandth of the largest, shape (nu,)."""
        sizes = self.inputs[self.at.min() : self.at.max() + 1].std(axis=0)
        return np.asarray(np.maximum(sizes, _LEAST_SIZE * sizes.max() + np.finfo(float).tiny))

    def weighed(self, residuals: Array) -> Array:
        """Return residuals, shape (V, S, L, m), divided by the noise; zero without a measurement."""
        return np.asarray(residuals * self.good[..., None] / self.noise[:, None])

    def applied(self, lag: Any, count: int) -> Array:
        """Return the inputs from each sample on, shape (V, S, count, nu), for lags (V,) [samples]."""
        columns = self.lead + np.arange(count) - np.reshape(lag, (-1, 1))
        return np.asarray(np.moveaxis(self.inputs[self.at[:, columns]], 0, 1))


class Quantity(NamedTuple):
    """Identified number.

    Attributes
    ----------
    name, unit : str
        Name and unit.
    bounded : bool
        Whether the number cannot be negative.
    path : str
        Name in a spread.
    """

    name: str
    unit: str
    bounded: bool
    path: str = ""


class Model(Protocol):
    """Protocol of models with numbers p, shape (P,), that logs identify."""

    def rates(self, z: Any, u: Any, numbers: Any) -> Any:
        """Return dz/dt, shape (n,), of one state and input, in NumPy; `resolved` returns the numbers."""

    def resolved(self, segments: Segments, p: Array) -> tuple[Array, Array, float]:
        """Return numbers (V, 1 or S, k) for `rates`, delays (V,) [samples] and the longest time step [s]."""

    def observed(self, segments: Segments, states: Array, numbers: Array) -> Array:
        """Return the measurements, shape (V, S, L, m), of states, shape (V, S, L, n)."""

    def is_possible(self, p: Array) -> bool:
        """Return whether a robot can have the numbers p."""

    def sizes(self, p: Array) -> Array:
        """Return typical sizes of p, shape (P,), which limit the first step of the search."""

    def increments(self, p: Array) -> Array:
        """Return the steps of central differences, shape (P,)."""


@lru_cache(64)
def _recurrence(law: Callable[..., Any], sizes: tuple[int, int, int]) -> Recurrence:
    """Return the recurrence of samples: steps with the previous input, then steps with the present input.

    Step lengths and counts (h, count, h, count) precede the numbers of the law.
    """

    def sample(z: Any, u: Any, numbers: Any) -> Any:
        m = len(u) // 2
        for own, h, count in ((u[:m], numbers[0], numbers[1]), (u[m:], numbers[2], numbers[3])):
            z = _advanced(law, z, own, numbers[4:], h, count)
        return z

    n, m, k = sizes
    return Recurrence(sample, (n, 2 * m, k + 4))


def _advanced(law: Callable[..., Any], z: Any, u: Any, numbers: Any, h: Any, count: Any) -> Any:
    """Return a symbolic state after `count` Runge-Kutta steps of fourth order with length h."""

    def step(given: list[Any]) -> tuple[list[Any], Any]:
        *state, left = given
        z = symbols(state, (len(state),))
        a = law(z, u, numbers)
        b = law(z + h / 2 * a, u, numbers)
        c = law(z + h / 2 * b, u, numbers)
        after = z + h / 6 * (a + 2 * (b + c) + law(z + h * c, u, numbers))
        return [*entries(after), left - 1.0], left <= 1.0

    left = entries(count).item()
    return symbols(repeated(step, [*entries(z), left], _MOST_STEPS, left <= 0.0)[:-1], z.shape)


@np.errstate(all="ignore")  # trial values may diverge
def simulate(model: Model, segments: Segments, p: Array, starts: Array) -> Array:
    """Return simulated measurements, shape (V, S, L, m), of numbers (V, P) and initial states (V, S, n).

    In each sample, the previous input acts for the fractional part of the delay, then the present input.
    """
    (V, S, n), K = starts.shape, segments.y.shape[1] - 1
    numbers, late, longest = model.resolved(segments, p)
    lag = np.floor(late + 1e-9).astype(int)
    share = np.maximum(late - lag, 0.0)
    lag = lag[:1] if (lag == lag[0]).all() else lag
    inputs, rows = [], []
    for before, part in ((1, share), (0, 1 - share)):
        span = part[:, None, None] * segments.dt[:, None]
        count = np.ceil(span.max() / longest - 1e-9)
        inputs.append(segments.applied(lag + before, K))
        rows += [span / max(count, 1.0), np.full((1, 1, 1), count)]
    u, m = np.moveaxis(np.concatenate(inputs, axis=-1), 2, 0), inputs[0].shape[-1]
    each = np.concatenate([np.broadcast_to(x, (V, S, x.shape[2])) for x in (*rows, numbers)], axis=2)
    states = _recurrence(model.rates, (n, m, numbers.shape[2]))(
        starts.reshape(V * S, n),
        np.broadcast_to(u, (K, V, S, 2 * m)),
        each.reshape(V * S, -1),
    )
    return model.observed(segments, states.reshape(V, S, K + 1, n), numbers)


def by_groups(
    function: Callable[[Segments, slice], tuple[Array, ...]], segments: Segments, variants: int = 1
) -> list[Array]:
    """Return the arrays, shape (S, ...), of a function of some segments and their rows; threads share them.

    Parameters
    ----------
    function : callable
        Function of segments and their rows, which returns arrays of shape (rows, ...).
    segments : Segments
        All segments.
    variants : int
        Number of simulations of a segment.
    """
    size = max(1, _AT_ONCE // (variants * segments.y.shape[1]))
    cuts = [slice(k, k + size) for k in range(0, len(segments.y), size)]
    found = [function(segments.some(cuts[0]), cuts[0])]  # compiles the model
    with ThreadPoolExecutor(processors()) as pool:
        found += pool.map(lambda rows: function(segments.some(rows), rows), cuts[1:])
    return [np.concatenate(each) for each in zip(*found, strict=True)]


def linearize(
    model: Model, segments: Segments, p: Array, starts: Array, numbers: NDArray[np.int_]
) -> tuple[Array, Array]:
    """Return simulated measurements (S, L, m), and slopes by F numbers and initial states (F + n, S, L, m).

    The slopes are differences to the values themselves, or central differences for steps of whole samples.
    """
    P, n = len(p), starts.shape[1]
    start = _SLOPE * np.maximum(np.abs(starts).mean(axis=0), 0.1)
    size = np.append(model.increments(p)[numbers], start)
    wide, steps = size >= 1.0, np.zeros((len(size), P + n))
    steps[np.arange(len(size)), np.append(numbers, P + np.arange(n))] = size
    ways = np.vstack([np.zeros(P + n), steps, -steps[wide]])
    out = simulate(model, segments, p + ways[:, :P], starts + ways[:, None, P:])
    with np.errstate(all="ignore"):
        after, before = out[1 : 1 + len(size)], out[1 + len(size) :]
        slopes = after - out[0]
        slopes[wide] = (after[wide] - before) / 2
        return out[0], np.nan_to_num(slopes) / size[:, None, None, None]
