"""An ensemble as named arrays with units and meanings: in an archive, a store and a Dataset."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.errors import imported
from pinmobile.loop._counts import edges, quantiles
from pinmobile.loop._description import Outline
from pinmobile.loop._scenario import Scenario
from pinmobile.metrics import Metric
from pinmobile.plant import Parameter

LEVELS = (0.5, 0.9, 0.99)
"""Shares of the robots for which the quantiles over time are kept."""

NOTE = "units and long_name of each variable; robot i of a scenario is row i"
"""How the variables are to be read."""


class Variable(NamedTuple):
    """An array by its name.

    Attributes
    ----------
    dimensions : tuple of str
        Of its axes.
    units : str
        Its unit, "1" for none; where its last axis is ``coordinate`` or ``input``, that of each.
    meaning : str
        What it is, in words.
    worst : str
        Of metrics, whether the largest or the smallest of each is the worst.
    """

    dimensions: tuple[str, ...]
    units: str
    meaning: str
    worst: str = ""

    @property
    def attributes(self) -> dict[str, str]:
        """Unit and meaning, as xarray and others name them."""
        found = {"units": self.units, "long_name": self.meaning}
        return found | ({"worst": self.worst} if self.worst else {})


_UNTIL = "of a diverged robot until then"
_SINCE = f"from the scenario's `after` on, {_UNTIL}"
_EACH, _EACH_COORDINATE, _EACH_INPUT = ("robot",), ("robot", "coordinate"), ("robot", "input")
_EACH_METRIC = ("robot", "metric")
PER_ROBOT = (
    *("max_error", "rms_error", "max_input", "max_distance", "diverged_at"),
    *("worst_metric", "rms_metric"),
)
"""Names of the arrays with one entry per robot, beside what was drawn."""


def per_robot(scenario: Scenario | Outline) -> dict[str, Variable]:
    """Return the arrays of `PER_ROBOT`; those of metrics where there are any.

    Parameters
    ----------
    scenario : Scenario or Outline
        Whose.
    """
    named = scenario.coordinates, scenario.inputs, scenario.recorded_metrics
    errors, sizes, units = (", ".join(one.unit or "1" for one in each) for each in named)
    found = {
        "max_error": Variable(_EACH_COORDINATE, errors, f"largest |error|, {_SINCE}"),
        "rms_error": Variable(_EACH_COORDINATE, errors, f"root of the mean squared error, {_SINCE}"),
        "max_input": Variable(_EACH_INPUT, sizes, f"largest |input|, {_UNTIL}"),
        "max_distance": Variable(_EACH, "m", f"largest distance from the desired position, {_SINCE}"),
        "diverged_at": Variable(_EACH, "s", "when the loop diverged; NaN where it did not"),
    }
    if scenario.recorded_metrics:
        worst = f"largest size, or smallest margin, of what else is judged, {_SINCE}"
        each = ", ".join(one.worst for one in scenario.recorded_metrics)
        found["worst_metric"] = Variable(_EACH_METRIC, units, worst, each)
        found["rms_metric"] = Variable(_EACH_METRIC, units, f"root of its mean square, {_SINCE}")
    return found


SUMMED = ("counts", "quantiles")
"""Names of the arrays that are summed up over all robots."""


def over_all(channels: Sequence[Metric]) -> dict[str, Variable]:
    """Return the arrays of `SUMMED`.

    Parameters
    ----------
    channels : sequence of Metric
        What is counted.
    """
    counted = "how many robots have this size; what diverged counts in the last bin, of margins in the first"
    within = "share `level` of the robots errs at most by this, or has at least this margin"
    units = ", ".join(one.unit or "1" for one in channels)
    return {
        "counts": Variable(("time", "channel", "bin"), "1", counted),
        "quantiles": Variable(("channel", "level", "time"), units, within),
    }


def drawn_name(parameter: str) -> str:
    """Return what the array of a parameter's draws is called: a slash would make a group of a store of it."""
    return f"drawn_{parameter.replace('/', '.')}"


def drawn(parameters: Mapping[str, Parameter]) -> dict[str, Variable]:
    """Return the arrays of what was drawn for each robot."""
    return {
        drawn_name(name): Variable(_EACH, one.unit or "1", f"drawn {one.meaning}; NaN where not spread")
        for name, one in parameters.items()
    }


def quantiles_of(counts: NDArray[np.int32], levels: Array, channels: Sequence[Metric]) -> dict[str, Array]:
    """Return the quantiles over time of each channel, shape (L, G), by name.

    Parameters
    ----------
    counts : ndarray of int, shape (G, channels, BINS)
        Of all robots.
    levels : ndarray, shape (L,)
        Shares of the robots.
    channels : sequence of Metric
        What is counted.
    """
    return {
        one.name: quantiles(counts[:, k].astype(np.int64), levels, margins=one.is_margin)
        for k, one in enumerate(channels)
    }


def summed(counts: NDArray[np.int32], channels: Sequence[Metric]) -> dict[str, Array | NDArray[np.int32]]:
    """Return the arrays of `SUMMED`; the arguments are those of `quantiles_of`."""
    found = quantiles_of(counts, np.array(LEVELS), channels)
    return {"counts": counts, "quantiles": np.array(list(found.values()))}


def coordinates(scenario: Scenario | Outline) -> list[tuple[str, Sequence[Any], str, str]]:
    """Return name, values, unit and meaning of the coordinates of all dimensions but ``robot``.

    Parameters
    ----------
    scenario : Scenario or Outline
        Whose.
    """
    names, inputs, metrics = (
        [one.name for one in each]
        for each in (scenario.coordinates, scenario.inputs, scenario.recorded_metrics)
    )
    told = ", ".join(f"{one.meaning} [{one.unit or '1'}]" for one in scenario.channels)
    judged = ", ".join(one.meaning for one in scenario.recorded_metrics)
    return [
        ("time", scenario.grid.tolist(), "s", "time"),
        ("coordinate", list(names), "1", "coordinate"),
        ("input", list(inputs), "1", "input"),
        ("channel", [one.name for one in scenario.channels], "1", told),
        ("level", list(LEVELS), "1", "share of the robots"),
        (
            "bin",
            edges()[:-1].tolist(),
            "as of the channel",
            "lower edge; the upper one is the next bin's lower one; of a margin m, of m + sqrt(m^2 + 2^-24)",
        ),
        *([("metric", metrics, "1", judged)] if metrics else []),
    ]


def dataset_of(ensemble: Any, attributes: Mapping[str, Any]) -> Any:
    """Return an ensemble as an xarray.Dataset.

    Parameters
    ----------
    ensemble : Ensemble
        What is told.
    attributes : mapping
        Of the whole.

    Raises
    ------
    InvalidArgument
        If xarray is not installed.
    """
    xarray = imported("xarray", "sweeps", "a Dataset")
    scenario = ensemble.scenario
    variables = {**_per_robot(ensemble), **over_all(scenario.channels)}
    arrays = summed(ensemble.counts, scenario.channels)
    arrays |= {name: array for name, _, array in _arrays(ensemble)}
    axes = {
        name: (name, values, {"units": unit, "long_name": meaning})
        for name, values, unit, meaning in coordinates(scenario)
    }
    return xarray.Dataset(
        # Copied, because what xarray hands out may be written into.
        {name: (one.dimensions, arrays[name].copy(), one.attributes) for name, one in variables.items()},
        axes,
        {"Conventions": NOTE, "errors_from_s": scenario.after, **attributes},
    )


def columns_of(ensemble: Any) -> tuple[list[str], list[Array]]:
    """Return the arrays with one entry per robot as the columns of a table, and their names with units."""
    header, columns = ["robot"], [np.arange(len(ensemble), dtype=np.float64)]
    named: Mapping[str, Sequence[Any]] = {
        "coordinate": ensemble.scenario.coordinates,
        "input": ensemble.scenario.inputs,
        "metric": ensemble.scenario.recorded_metrics,
    }
    for name, one, array in _arrays(ensemble):
        each = [(f"{name}_{part.name}", part.unit) for part in named.get(one.dimensions[-1], ())]
        known = each or [(name, one.units)]
        header += [f"{of} [{unit}]" if unit not in ("", "1") else of for of, unit in known]
        columns.append(array)
    return header, columns


def _per_robot(ensemble: Any) -> dict[str, Variable]:
    scenario = ensemble.scenario
    return {**drawn(scenario.parameters), **per_robot(scenario)}


def _arrays(ensemble: Any) -> Iterator[tuple[str, Variable, Array]]:
    draws = {drawn_name(name): values for name, values in ensemble.draws.items()}
    for name, one in _per_robot(ensemble).items():
        yield name, one, getattr(ensemble, name) if name in PER_ROBOT else draws[name]


def content_of(ensemble: Any) -> dict[str, Any]:
    """Return all that a file of an ensemble keeps: its scenario in words, and what each array is."""
    outline = Outline.of(ensemble.scenario)
    own = {each.name: getattr(ensemble, each.name) for each in fields(ensemble)}
    return own | {
        "scenario": outline,
        "traces": {i: trace.content() for i, trace in ensemble.traces.items()},
        "variables": {**per_robot(outline), **drawn(outline.parameters)},
    }
