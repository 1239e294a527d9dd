"""Losses of a run: functions of its samples and metrics, reduced to a number each, and their recorder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, final

import numpy as np

from pinmobile.arrays import Array, one_of
from pinmobile.derivatives._problem import Direction, Inputs, Problem, loop_errors
from pinmobile.errors import InvalidArgument, format_value
from pinmobile.loop import Record, Sample, Scenario
from pinmobile.metrics import Metric, check_metric, metrics_of
from pinmobile.parts import option, part

REDUCTIONS = ("sum", "mean", "rms", "last", "largest", "smallest")
"""Reductions of the values of all samples to one number."""
_INITIAL = {"largest": -np.inf, "smallest": np.inf}


class Loss(NamedTuple):
    """Number of a run: a function of a sample or a metric, and how it is reduced.

    Attributes
    ----------
    of : callable or int
        Function of a sample, or index of a metric of the plant.
    reduction : str
        One of `REDUCTIONS`.
    name : str
        Name in messages.
    """

    of: Callable[[Sample], Any] | int
    reduction: str
    name: str

    @classmethod
    def read(cls, given: Any, reduction: str | None, scenario: Scenario, label: str = "loss") -> Loss:
        """Return the loss that a user means.

        Parameters
        ----------
        given : callable, str or Metric
            Function of a sample; or "distance", "heading", a coordinate or a metric of the plant by name.
        reduction : str, optional
            Default: the sum of a function; the worst value of a metric.
        scenario : Scenario
            Loop of the loss.
        label : str
            Name of the argument.

        Raises
        ------
        InvalidArgument, UnknownName
            If it is none of these.
        """
        if reduction is not None:
            one_of("reduction", reduction, REDUCTIONS)
        if isinstance(given, Metric) and given.function is not None:
            check_metric(given)
            worst = "smallest" if given.is_margin else "largest"
            return cls(given.function, reduction or worst, given.name)
        if not isinstance(given, str):
            if not callable(given):
                raise InvalidArgument(
                    f"{label} is {format_value(given)}, expected a function of a sample or the name of a "
                    "metric"
                )
            return cls(given, reduction or "sum", label)
        plant = scenario.robot
        errors: dict[str, Any] = {"distance": _distance, "heading": _Error(2)}
        errors |= {one.name: _Error(i) for i, one in enumerate(scenario.coordinates)}
        metrics = {one.name: (i, one.is_margin) for i, one in enumerate(metrics_of(plant))}
        name = one_of(label, given, {**errors, **metrics})
        if name in errors:
            return cls(errors[name], reduction or "largest", name)
        index, is_margin = metrics[name]
        return cls(index, reduction or ("smallest" if is_margin else "largest"), name)

    def finish(self, value: Array, count: int) -> tuple[Array, Array]:
        """Return the loss of a recorded value, and its slope by the recorded value."""
        if self.reduction == "rms":
            root = np.sqrt(value / count)
            return root, np.divide(0.5 / count, root, out=np.zeros_like(root), where=root > 0)
        share = 1.0 / count if self.reduction == "mean" else 1.0
        return value * share, np.full_like(value, share)


def _distance(sample: Sample) -> Any:
    return np.sqrt((sample.error[:2] ** 2).sum())


class _Error:
    """Size of an error."""

    def __init__(self, i: int) -> None:
        self.i = i

    def __call__(self, sample: Sample) -> Any:
        return np.abs(sample.error[self.i])


@final
@part
class Losses:
    """Recorder of the losses; it keeps whether wheels slide."""

    losses: tuple[Loss, ...] = option(default=())
    signals, errors = True, True

    @property
    def metrics(self) -> tuple[tuple[int, bool], ...]:
        """Metrics of the plant that the recorder reads."""
        return tuple((loss.of, False) for loss in self.losses if isinstance(loss.of, int))

    def initial_state(self, n: int, nu: int) -> Any:
        """Return the losses of no sample."""
        return np.array([_INITIAL.get(loss.reduction, 0.0) for loss in self.losses])

    def __call__(self, sample: Sample, state: Any) -> Record:
        """Return the losses with one more sample."""
        values = []
        for i, loss in enumerate(self.losses):
            value = loss.of(sample) if callable(loss.of) else sample.measured[loss.of]
            if np.shape(value) != ():
                raise InvalidArgument(f"{loss.name} returned {format_value(value)}, expected a number")
            last = state[i]
            if loss.reduction in ("sum", "mean", "rms"):
                value = last + (value * value if loss.reduction == "rms" else value)
            elif loss.reduction != "last":
                is_new = value > last if loss.reduction == "largest" else value < last
                value = np.where(is_new, value, last)
            values.append(value + 0.0 * sample.t)
        kept = {name: sample.signals[name].value for name in ("slides",) if name in sample.signals}
        return Record(np.stack(values), kept=kept)


class Evaluation(NamedTuple):
    """Losses of n robots and their derivatives.

    Attributes
    ----------
    values : ndarray, shape (L, n)
        Losses.
    slopes : ndarray, shape (L, n, P)
        Derivatives by each entry of each number.
    directions : list of Direction
        The entries.
    inputs : Inputs
        Inputs of the machine code.
    """

    values: Array
    slopes: Array
    directions: list[Direction]
    inputs: Inputs


def evaluate_losses(problem: Problem, changes: Mapping[str, Any], mode: str | None) -> Evaluation:
    """Return the losses of the robots with other numbers, and their derivatives in a mode.

    Parameters
    ----------
    problem : Problem
        Loop with the recorder `Losses`.
    changes : mapping of str to ndarray
        Numbers by path.
    mode : str, optional
        ``"forward"`` or ``"reverse"``; None: only the values.
    """
    losses = problem.loop.recorder.losses
    first = next(leaf.first for leaf in problem.machine.tape.leaves if leaf.owner == "recorder")
    indices = [first + i for i in range(len(losses))]
    with loop_errors():
        inputs = problem.inputs(changes)
        directions = problem.directions(inputs, changes) if mode else []
        if mode == "forward":
            final, tangents, _ = problem.tangents(inputs, directions)
            slopes = tangents[indices]
        elif mode == "reverse":
            final, slopes = problem.adjoints(inputs, directions, indices)
        else:
            final, slopes = problem.plain(inputs), np.zeros((len(indices), problem.n, 0))
        pairs = [loss.finish(final[i], len(inputs.samples)) for loss, i in zip(losses, indices, strict=True)]
        values = np.array([value for value, _ in pairs])
        slopes = slopes * np.array([slope for _, slope in pairs])[:, :, None]
    return Evaluation(values, slopes, directions, inputs)
