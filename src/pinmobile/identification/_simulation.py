"""Segments of logs, and their simulation by any model."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Any, NamedTuple, Protocol, Self, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.compiled import Identity, Recurrence, choose, entries, jacobian, processors, repeat, symbols

_STEP = 1e-30  # imaginary step, whose square vanishes
_LEAST_SHARE = 1e-9  # of a sample, before which the previous input acts, so that the delay has a slope
_LEAST_SIZE = 1e-3  # smallest size of an input, as a share of the largest
START_SAMPLES = 30_000  # samples that give first estimates
_AT_ONCE = 30_000  # samples that a thread simulates at once: they bound the memory, and fit in a cache
LANES = 8  # segments at once, as many as the numbers of the longest vectors
_PIECES = 10  # of these samples
_Active: TypeAlias = tuple[int, ...] | None
_SHARED = "inputs", "lead", "blocks"  # that all segments have in common
_MOST_STEPS = 10**9  # bound of the integration steps in a sample; the actual count is one of the numbers


def pieces(start: int, stop: int, samples: int) -> list[slice]:
    """Return pieces of a part of so many samples in all, at equal distances: enough for first estimates."""
    size, step = START_SAMPLES // _PIECES, samples // START_SAMPLES
    if step < 2:
        return [slice(start, stop)]
    starts = range(start, max(start + 1, stop - size // 2), size * step)  # the last one is not a few samples
    return [slice(k, min(k + size, stop)) for k in starts]


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
    rows : ndarray of int, shape (S, W)
        Rows of the inputs near a segment.
    lead : int
        Number of these rows before the first sample.
    load : ndarray, shape (S, 4)
        Mass, first moments and inertia of the known load.
    phase : ndarray, shape (S,)
        Time after that of a row at which its inputs begin [samples].
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
    rows: NDArray[np.int_]
    lead: int
    load: Array
    phase: Array
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
        (first, stop, length, lead, extra), (y, good, states, u, noise) = span, rows
        count = max(0, (stop - first) // length)
        index = first + np.arange(count * length).reshape(count, length)
        index = index[good[index].mean(axis=1) >= least]
        window = np.clip(index[:, :1] - lead + np.arange(lead + length + extra), 0, len(u) - 1)
        sigma, loads = np.tile(noise, (len(index), 1)), np.broadcast_to(load, (len(index), 4))
        start, times = states[index[:, 0]], np.full(len(index), dt)
        rows = times, index * dt, y[index], good[index], sigma, start, u, window
        return cls(*rows, lead, loads, np.zeros(len(index)))

    @classmethod
    def join(cls, parts: list[Segments]) -> Segments:
        """Return the segments of several logs together."""
        offsets = np.cumsum([0, *(len(part.inputs) for part in parts)])
        pieces = [part._replace(rows=part.rows + n) for part, n in zip(parts, offsets, strict=False)]
        arrays: dict[str, Any] = {
            n: np.concatenate([getattr(x, n) for x in pieces]) for n in cls._fields if n not in _SHARED
        }
        return cls(inputs=np.concatenate([x.inputs for x in parts]), lead=parts[0].lead, **arrays)

    def select(self, rows: Any) -> Self:
        """Return some of the segments."""
        return self._replace(**{n: getattr(self, n)[rows] for n in self._fields if n not in _SHARED})

    @property
    def few(self) -> slice:
        """Segments at equal distances with samples enough for first estimates."""
        return slice(None, None, max(1, min(len(self.good), self.good.size // START_SAMPLES)))

    @property
    def sizes(self) -> Array:
        """Standard deviations of the inputs, at least a thousandth of the largest, shape (nu,)."""
        sizes = self.inputs[self.rows.min() : self.rows.max() + 1].std(axis=0)
        return np.asarray(np.maximum(sizes, _LEAST_SIZE * sizes.max() + np.finfo(float).tiny))

    def weigh(self, residuals: Array) -> Array:
        """Return residuals, shape (V, S, L, m), divided by the noise; zero without a measurement."""
        return np.asarray(residuals * self.good[..., None] / self.noise[:, None])

    def applied(self, lag: Any, count: int) -> Array:
        """Return the inputs from each sample on, (V, S, count, nu), for lags (V,) or (V, S) [samples]."""
        lags = np.atleast_1d(lag)
        columns = self.lead + np.arange(count) - lags.reshape(len(lags), -1, 1)
        return np.asarray(self.inputs[self.rows[np.arange(len(self.rows))[:, None], columns]])


class Quantity(NamedTuple):
    """Identified number.

    Attributes
    ----------
    name, unit : str
        Name and unit.
    nonnegative : bool
        Whether the number cannot be negative.
    path : str
        Name in a spread.
    """

    name: str
    unit: str
    nonnegative: bool
    path: str = ""


class Model(Protocol):
    """Protocol of models with numbers p, shape (P,), that logs identify."""

    def rates(self, z: Any, u: Any, numbers: Any) -> Any:
        """Return dz/dt, shape (n,), of one state and input, in NumPy; `rate_numbers` returns the numbers."""

    def rate_numbers(self, segments: Segments, p: Array) -> tuple[Array, Array, float]:
        """Return numbers (V, 1 or S, k) for `rates`, delays (V,) [samples] and the longest time step [s]."""

    def outputs(self, segments: Segments, states: Array, numbers: Array) -> Array:
        """Return the measurements, shape (V, S, L, m), of states, shape (V, S, L, n)."""

    def is_possible(self, p: Array) -> bool:
        """Return whether a robot can have the numbers p."""

    def sizes(self, p: Array) -> Array:
        """Return typical sizes of p, shape (P,), which limit the first step of the search."""

    @property
    def delay_index(self) -> int | None:
        """Index of a delay whose slope is a difference over whole samples, if there is one."""

    @property
    def is_linear(self) -> bool:
        """Whether the measurements are linear functions of the states."""


class PhysicalNumbers:
    """Base class of models with physical numbers, which include the losses."""

    def to_physical(self, p: Array) -> Array:
        """Return the numbers unchanged."""
        return p

    def slopes(self, p: Array) -> Array:
        """Return the identity: the derivatives of `to_physical`, shape (P, P)."""
        return np.eye(len(p))

    def forces(self, estimates: Any) -> list[Any]:
        """Return no further forces for `simulate`."""
        return []


@runtime_checkable
class Simulator(Protocol):
    """Protocol of models with simulations of their own, in place of the law of a state and input."""

    def simulate(self, segments: Segments, p: Array, starts: Array) -> Array:
        """Return simulated measurements, see `simulate`."""

    def linearize(
        self, segments: Segments, p: Array, starts: Array, numbers: NDArray[np.int_]
    ) -> tuple[Array, Array]:
        """Return simulated measurements and slopes, see `linearize`."""


class Same:
    """Value that equals another one with the same key."""

    def __init__(self, value: Any, key: Any) -> None:
        self.value, self._key = value, key

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and self._key == other._key

    def __hash__(self) -> int:
        return hash(self._key)


@lru_cache(64)
def _recurrence(law: Callable[..., Any], sizes: tuple[int, int, int], *sensitive: Any) -> Recurrence:
    """Return the recurrence of samples, see `_steps`; the law is compared as an object first."""
    return _steps(Same(law, Identity().visit(law).key), sizes, *sensitive)


@lru_cache(64)
def _steps(given: Same, sizes: tuple[int, int, int], active: _Active = None, lag: bool = False) -> Recurrence:
    """Return the recurrence of samples: steps with the previous input, then steps with the present input.

    Step lengths and counts (h, count, h, count) precede the numbers of the law. With the indices of `active`
    numbers, the state has its slopes behind it, also by a delay if `lag`, see `_tangent`.
    """
    n, m, k = sizes
    law = given.value if active is None else _tangent(given.value, n, active, lag)

    def sample(z: Any, u: Any, numbers: Any) -> Any:
        h, first, h_last, last = (entries(numbers[j]).item() for j in range(4))

        def step(carry: list[Any]) -> tuple[list[Any], Any]:
            *state, left = carry
            is_first, z = left > last, symbols(state, (len(state),))
            u_now, span = np.where(is_first, u[:m], u[m:]), choose(is_first, h, h_last)
            a = law(z, u_now, numbers[4:])
            b = law(z + span / 2 * a, u_now, numbers[4:])
            c = law(z + span / 2 * b, u_now, numbers[4:])
            z_next = z + span / 6 * (a + 2 * (b + c) + law(z + span * c, u_now, numbers[4:]))
            return [*entries(z_next), left - 1.0], left <= 1.0

        values = repeat(step, [*entries(z), first + last], _MOST_STEPS, first + last <= 0.0)
        return symbols(values[:-1], z.shape)

    states = n if active is None else n * (1 + len(active) + n + lag)
    return Recurrence(sample, (states, 2 * m, k + 4))


def _tangent(law: Callable[..., Any], n: int, active: tuple[int, ...], by_delay: bool) -> Callable[..., Any]:
    """Return the law of a state and its slopes Z, shape (n, A + n + late), as one vector.

    The slopes are those by A active numbers, by the initial state and, if `by_delay`, by the delay [samples].
    They follow dZ/dt = df/dz Z + df/dp. The same steps integrate both, so that Z is the exact slope of the
    integrated state. For the delay, the last input is the slope of the step length per step length.
    """

    def rates(stack: Any, u: Any, numbers: Any) -> Any:
        z, Z = stack[:n], entries(stack[n:]).reshape(n, -1)
        f = law(z, u[:-1] if by_delay else u, numbers)
        rows = jacobian(f, [*entries(z), *entries(numbers)[list(active)]])
        slopes = []
        for row, rate in zip(rows, entries(f), strict=True):
            for d in range(Z.shape[1]):
                terms = [x * Z[j, d] for j, x in row.items() if j < n]
                terms += [row[n + d]] if n + d in row else []
                terms += [entries(u)[-1] * rate] * (by_delay and d == Z.shape[1] - 1)
                slopes.append(sum(terms[1:], terms[0]) if terms else 0.0)
        return np.concatenate([f, symbols(slopes, (len(slopes),))])

    return rates


@np.errstate(all="ignore")  # trial values may diverge
def simulate(model: Model, segments: Segments, p: Array, starts: Array) -> Array:
    """Return simulated measurements, shape (V, S, L, m), of numbers (V, P) and initial states (V, S, n).

    In each sample, the previous input acts for the fractional part of the delay, then the present input.
    """
    if isinstance(model, Simulator):
        return model.simulate(segments, p, starts)
    return model.outputs(segments, *simulate_states(model, segments, p, starts))


@np.errstate(all="ignore")
def simulate_states(model: Model, segments: Segments, p: Array, starts: Array) -> tuple[Array, Array]:
    """Return simulated states, shape (V, S, L, n), and the numbers of the rates, for those of `simulate`."""
    given = model.rate_numbers(segments, p)
    return _states(model, segments, given, starts), given[0]


def _states(
    model: Model,
    segments: Segments,
    given: tuple[Array, Array, float],
    starts: Array,
    *sensitive: Any,
) -> Array:
    """Return the states of the samples, shape (V, S, L, n), with slopes for active numbers."""
    (V, S, n), K, (numbers, delays, longest) = starts.shape, segments.y.shape[1] - 1, given
    active, by_delay = sensitive or (None, False)
    late = delays[:, None] + (segments.phase if segments.phase.any() else 0.0)
    lag = np.floor(late + 1e-9).astype(int)
    share = np.maximum(late - lag, _LEAST_SHARE * by_delay)
    lag = lag[:1] if (lag == lag[0]).all() else lag
    inputs, rows = [], []
    for shift, part, slope in ((1, share, 1.0), (0, 1 - share, -1.0)):
        span = part[..., None] * segments.dt[:, None]
        count = max(np.ceil(span.max() / longest - 1e-9), float(by_delay))
        u = segments.applied(lag + shift, K)
        if by_delay:
            u = np.concatenate(
                [u, np.broadcast_to(slope / part[..., None, None], (*u.shape[:3], 1))], axis=-1
            )
        inputs.append(u)
        rows += [span / max(count, 1.0), np.full((1, 1, 1), count)]
    u, m = np.moveaxis(np.concatenate(inputs, axis=-1), 2, 0), inputs[0].shape[-1]
    each = np.concatenate([np.broadcast_to(x, (V, S, x.shape[2])) for x in (*rows, numbers)], axis=2)
    initial = starts.reshape(V * S, n)
    if active is not None:
        first = np.hstack([np.zeros((n, len(active))), np.eye(n), np.zeros((n, int(by_delay)))])
        initial = np.hstack([initial, np.tile(first.ravel(), (S, 1))])
    states = _recurrence(model.rates, (n, m, numbers.shape[2]), *sensitive)(
        initial, np.broadcast_to(u, (K, V, S, 2 * m)), each.reshape(V * S, -1)
    )
    return states.reshape(V, S, K + 1, -1)


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
    size = LANES * max(1, round(_AT_ONCE / (LANES * variants * segments.y.shape[1])))
    cuts = [slice(k, k + size) for k in range(0, len(segments.y), size)]
    results = [function(segments.select(cuts[0]), cuts[0])]  # compiles the model
    with ThreadPoolExecutor(processors()) as pool:
        results += pool.map(lambda rows: function(segments.select(rows), rows), cuts[1:])
    return [np.concatenate(each) for each in zip(*results, strict=True)]


@np.errstate(all="ignore")
def linearize(
    model: Model, segments: Segments, p: Array, starts: Array, numbers: NDArray[np.int_]
) -> tuple[Array, Array]:
    """Return simulated measurements (S, L, m), and slopes by F numbers and initial states (F + n, S, L, m).

    The slopes are exact: those of the states follow the tangents of the integrator's steps, and an imaginary
    step (Squire and Trapp 1998) differentiates the model's arithmetic. The slope by a delay is that of one
    side at a whole sample. The slope by a `delay_index` is the difference over two samples.
    """
    if isinstance(model, Simulator):
        return model.linearize(segments, p, starts, numbers)
    (S, n), F = starts.shape, len(numbers)
    ways, moves = np.zeros((F, len(p))), numbers == (-1 if model.delay_index is None else model.delay_index)
    ways[np.arange(F), numbers] = ~moves
    complex_p: Any = p + 1j * _STEP * np.vstack([0 * p, ways])
    values, delays, longest = model.rate_numbers(segments, complex_p)
    given = values[:1].real, delays[:1].real, longest
    way = np.zeros((F + n, *values.shape[1:]))
    way[:F], by_delay = values[1:].imag / _STEP, delays[1:].imag / _STEP
    by_number = np.broadcast_to(way[:F], (F, S, values.shape[2]))
    active = tuple(np.flatnonzero(by_number.any(axis=(0, 1))).tolist())
    stack = _states(model, segments, given, starts[None], active, bool(by_delay.any()))[0]
    states, Z = stack[..., :n], stack[..., n:].reshape(*stack.shape[:2], n, -1)
    initial = slice(len(active), len(active) + n)  # slopes by the initial state
    rest = np.delete(Z, initial, axis=-1).reshape(S, states[0].size, Z.shape[-1] - n)
    inner = np.concatenate([by_number[..., active], np.tile(by_delay[:, None, None], (1, S, 1))], axis=2)
    outer = rest @ np.moveaxis(inner[..., : rest.shape[-1]], 0, 2)
    slopes_z = np.empty((F + n, *states.shape))
    slopes_z[:F] = np.moveaxis(outer.reshape(*states.shape, F), -1, 0)
    slopes_z[F:] = np.moveaxis(Z[..., initial], -1, 0)
    outputs = model.outputs(segments, states[None], given[0])[0]
    if model.is_linear:
        slope = np.array(model.outputs(segments, slopes_z, given[0]))
    else:
        complex_x: tuple[Any, Any] = states + 1j * _STEP * slopes_z, given[0] + 1j * _STEP * way
        slope = np.array(model.outputs(segments, *complex_x).imag / _STEP)
    if moves.any():
        step = np.eye(len(p))[numbers[moves]] * [[1.0], [-1.0]]
        plus, minus = simulate(model, segments, p + step, np.repeat(starts[None], 2, axis=0))
        slope[:F][moves] = (plus - minus) / 2
    return outputs, np.nan_to_num(slope, copy=False)
