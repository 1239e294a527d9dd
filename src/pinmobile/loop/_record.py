"""Recorders, which keep data of the samples of a loop, and the rule that decides whether a loop has diverged.

A recorder is a part like any other: its law is NumPy for one state. The loop calls ``recorder(sample, state)
-> Record`` once per sample, after the controller and before the step.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, final

import numpy as np

from pinmobile.arrays import Array, are_real, one_of
from pinmobile.compiled import has_symbols, place_of
from pinmobile.errors import InvalidArgument, NotTraceable, format_value
from pinmobile.loop._loop import Record, Sample
from pinmobile.metrics import Metric, size_of
from pinmobile.parts import number, option, part

LARGEST = 1e97
"""Largest sum of inputs and accelerations of a loop that has not diverged, as a multiple of its limit."""


def is_near(errors: Any, limit: Any) -> Any:
    """Return whether no error exceeds the limit, shape (...); NaN exceeds it.

    Parameters
    ----------
    errors : ndarray, shape (..., n)
        Errors of coordinates and of their rates [m, rad, m/s, rad/s].
    limit : float
        Largest size.
    """
    return np.all(np.abs(errors) <= limit, axis=-1)


def is_alive(errors: Any, limit: Any, u: Any, a: Any) -> Any:
    """Return whether samples have not diverged, shape (...): the rule of all engines.

    A loop has diverged if an error or its rate exceeds the limit, or if its input or acceleration exceeds
    `LARGEST` limits or is not a number.

    Parameters
    ----------
    errors, limit
        See `is_near`.
    u, a : ndarray, shape (..., nu), (..., nv)
        Input and acceleration.
    """
    return is_near(errors, limit) & (np.abs(np.sum(u, axis=-1) + np.sum(a, axis=-1)) < LARGEST * limit)


class UntraceableMetric(NotTraceable):
    """Error of a metric whose function does not accept symbols.

    Parameters
    ----------
    name : str
        Name of the metric.
    error : Exception
        Error of its function.
    """

    def __init__(self, name: str, error: Exception) -> None:
        reason, remedy = f"it raises {type(error).__name__} ({error})", "write it in NumPy for one sample"
        if isinstance(error, NotTraceable):
            reason, remedy = error.obstacle, error.remedy
        super().__init__(f"metrics has {name!r}: {reason}", remedy, place_of(error.__traceback__))


@final
@part
class Worst:
    """Recorder of each robot's largest and mean square error and largest input until the robot diverges.

    Parameters
    ----------
    limit : float
        Largest error of a loop that has not diverged [m, rad, m/s, rad/s].
    begin : float or None
        Index of the first sample whose error is recorded; None: all samples, which is faster than 0.
    distances : tuple of tuple of int
        Groups of coordinates whose errors form a distance. The recorder keeps the largest distance and counts
        the sizes.
    metrics : tuple of (int or Metric, bool)
        Each recorded metric (of the plant: its index), and whether it is a margin, whose smallest value is
        the worst; see `pinmobile.metrics.Metric`.
    keep : tuple of str
        Names of the signals that are kept of every sample.

    See Also
    --------
    loop.Samples : recorder of all samples.
    ensemble : run many robots with this recorder.

    Examples
    --------
    >>> from pinmobile.loop import Worst
    >>> memory = Worst(limit=10.0).initial_state(n=3, nu=3)
    >>> memory["largest"]  # [m, m, rad]
    array([0., 0., 0.])
    """

    limit: float = number(default=np.inf, above=0, endless=True, doc="largest error")
    begin: Any = number(default=None, optional=True, doc="first sample whose error is recorded")
    distances: tuple[tuple[int, ...], ...] = option(default=((0, 1), (2,)))
    metrics: tuple[tuple[int | Metric, bool], ...] = option(default=())
    keep: tuple[str, ...] = option(default=())

    @property
    def signals(self) -> bool:
        """Whether the recorder reads signals."""
        return bool(self.keep) or any(isinstance(metric, Metric) for metric, _ in self.metrics)

    def initial_state(self, n: int, nu: int) -> dict[str, Array]:
        """Return the record before the first sample.

        Parameters
        ----------
        n, nu : int
            Number of errors and of inputs.

        Returns
        -------
        dict of str to ndarray
            Record of no sample.
        """
        farthest = sum(len(group) > 1 for group in self.distances)
        return {
            "alive": np.ones(()),
            "lived": np.zeros(()),
            "largest": np.zeros(n),
            "farthest": np.zeros(farthest),  # squared
            "squares": np.zeros(n),
            "inputs": np.zeros(nu),
            **self._initial_metrics(),
        }

    def _initial_metrics(self) -> dict[str, Array]:
        if not self.metrics:
            return {}
        worst = np.array([-np.inf if is_margin else 0.0 for _, is_margin in self.metrics])
        return {"worst": worst, "metric_squares": np.zeros(len(worst))}  # margins: the largest -m

    def __call__(self, sample: Sample, state: Mapping[str, Any]) -> Record:
        """Return the record with one more sample.

        Parameters
        ----------
        sample : Sample
            Sample of the loop.
        state : dict of str to ndarray
            Record of the previous samples.

        Returns
        -------
        Record
            Record of all samples so far.
        """
        errors = np.concatenate([sample.error, sample.error_rate], axis=-1)
        alive = (state["alive"] > 0.5) & is_alive(errors, self.limit, sample.u, sample.a)
        one = np.where(alive, 1.0, 0.0)
        error = np.where(alive[..., None], np.abs(sample.error), 0.0)
        factor = 1.0 if self.begin is None else np.where(sample.k == self.begin, 0.0, 1.0)
        squares = error * error
        groups = [sum(squares[..., i] for i in group) for group in self.distances]
        distances = [square for square, group in zip(groups, self.distances, strict=True) if len(group) > 1]
        farthest = state["farthest"]
        record = {
            "alive": one,
            "lived": state["lived"] + one,
            "largest": _larger(error, state["largest"] * factor),
            "farthest": _larger(np.stack(distances, axis=-1), farthest * factor) if distances else farthest,
            "squares": state["squares"] * factor + squares,
            "inputs": _larger(np.where(alive[..., None], np.abs(sample.u), 0.0), state["inputs"]),
        }
        sizes = []
        for square, group in zip(groups, self.distances, strict=True):
            size = np.where(alive, square if len(group) > 1 else error[..., group[0]], np.inf)
            sizes.append(np.sqrt(size) if len(group) > 1 else size)
        if self.metrics:
            metrics, metric_sizes = self._metric_record(sample, state, alive)
            record, sizes = record | metrics, sizes + metric_sizes
        signals = {name: sample.signals[one_of("signal", name, sample.signals)] for name in self.keep}
        series = {f"signal {name}": signal.value for name, signal in signals.items()}
        return Record(record, sizes, series, {name: signal.unit for name, signal in signals.items()})

    def _metric_record(
        self, sample: Sample, state: Mapping[str, Any], alive: Any
    ) -> tuple[dict[str, Any], list[Any]]:
        """Return the record of the plant's metrics, and their sizes."""
        columns = [
            (_value(m, sample) if isinstance(m, Metric) else sample.measured[..., m], is_margin)
            for m, is_margin in self.metrics
        ]
        badness = [-x if is_margin else np.abs(x) for x, is_margin in columns]
        last = {name: state[name] for name in ("worst", "metric_squares")}
        if self.begin is not None:  # reset infinite values of earlier samples, too
            first = self._initial_metrics()
            last = {name: np.where(sample.k == self.begin, first[name], x) for name, x in last.items()}
        is_alive_row = alive[..., None]
        worst = np.where(is_alive_row, np.stack(badness, axis=-1), self._initial_metrics()["worst"])
        squares = np.where(is_alive_row, np.stack([x * x for x, _ in columns], axis=-1), 0.0)
        worst, squares = _larger(worst, last["worst"]), last["metric_squares"] + squares
        sizes = [
            np.where(alive, size_of(x) if is_margin else y, 0.0 if is_margin else np.inf)
            for (x, is_margin), y in zip(columns, badness, strict=True)
        ]
        return {"worst": worst, "metric_squares": squares}, sizes


def _value(metric: Metric, sample: Sample) -> Any:
    """Return the number that the function of a metric returns for a sample."""
    try:
        value = metric.function(sample)  # type: ignore[misc]
    except Exception as error:
        if not has_symbols(sample.q):
            place = f"for the sample at t = {sample.t:g} s"
            error.add_note(f"in the function of the metric {metric.name!r}, {place}")
            raise
        raise UntraceableMetric(metric.name, error) from error
    if np.shape(value) != () or not are_real(np.asarray(value)):
        message = f"metrics has {metric.name!r}, whose function returned {format_value(value)}"
        raise InvalidArgument(f"{message}, expected a number")
    return 1.0 * np.asarray(value) if isinstance(value, bool | np.bool_) else value


def _larger(a: Any, b: Any) -> Any:
    """Return the larger of two numbers, neither of which is NaN."""
    return np.where(a > b, a, b)


@final
@part
class Samples:
    """Recorder of all samples: configuration, velocity, input, acceleration and signals.

    Parameters
    ----------
    errors : bool
        Whether errors are recorded too.
    metrics : tuple of (int, bool)
        Metrics of the plant that are recorded too, as in `Worst`.

    See Also
    --------
    loop.Worst : recorder of the largest errors.
    Rollout : recorded samples of a simulation.

    Examples
    --------
    >>> from pinmobile.loop import Samples
    >>> Samples().signals, Samples().errors
    (True, False)
    """

    errors: bool = option(default=False)
    metrics: tuple[tuple[int, bool], ...] = option(default=())
    signals: ClassVar[bool] = True

    def initial_state(self, n: int, nu: int) -> None:
        """Return None: the recorder has no memory.

        Parameters
        ----------
        n, nu : int
            Number of errors and of inputs.
        """

    def __call__(self, sample: Sample, state: object) -> Record:
        """Return the sample as a record.

        Parameters
        ----------
        sample : Sample
            Sample of the loop.
        state : None
            Memory.

        Returns
        -------
        Record
            Values to keep.
        """
        arrays = {"q": sample.q, "v": sample.v, "u": sample.u, "a": sample.a}
        arrays |= {f"signal {name}": signal.value for name, signal in sample.signals.items()}
        arrays |= {"error": sample.error} if self.errors else {}
        arrays |= {"measured": sample.measured} if self.metrics else {}
        return Record(state, (), arrays, {name: signal.unit for name, signal in sample.signals.items()})
