"""What an ensemble keeps as named arrays with units and meanings: in a sweep's store as in a Dataset."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array
from pinmobile.ensembles.histogram import edges, quantiles
from pinmobile.extras import imported
from pinmobile.plant import Coordinate, Input, Parameter

if TYPE_CHECKING:
    from pinmobile.ensembles.result import Ensemble

__all__ = [
    "LEVELS",
    "NOTE",
    "PER_ROBOT",
    "SUMMED",
    "Variable",
    "columns_of",
    "coordinates",
    "dataset_of",
    "drawn",
    "drawn_name",
    "per_robot",
    "summed",
]

LEVELS = (0.5, 0.9, 0.99)
"""Shares of the robots of which the quantiles over time are told."""

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
    """

    dimensions: tuple[str, ...]
    units: str
    meaning: str

    @property
    def attributes(self) -> dict[str, str]:
        """Unit and meaning, as xarray and others name them."""
        return {"units": self.units, "long_name": self.meaning}


_UNTIL = "of a diverged robot until then"
_SINCE = f"from the scenario's `after` on, {_UNTIL}"
_EACH, _EACH_COORDINATE, _EACH_INPUT = ("robot",), ("robot", "coordinate"), ("robot", "input")
PER_ROBOT = ("max_error", "rms_error", "max_force", "max_distance", "diverged_at")
"""Names of the arrays with one entry per robot, beside what was drawn."""


def per_robot(coordinates: Sequence[Coordinate], inputs: Sequence[Input]) -> dict[str, Variable]:
    """Return the arrays of `PER_ROBOT`.

    Parameters
    ----------
    coordinates : sequence of Coordinate
        Those that the reference has.
    inputs : sequence of Input
        Those of the plant.
    """
    errors, sizes = (", ".join(one.unit or "1" for one in each) for each in (coordinates, inputs))
    return {
        "max_error": Variable(_EACH_COORDINATE, errors, f"largest |error|, {_SINCE}"),
        "rms_error": Variable(_EACH_COORDINATE, errors, f"root of the mean squared error, {_SINCE}"),
        "max_force": Variable(_EACH_INPUT, sizes, f"largest |input|, {_UNTIL}"),
        "max_distance": Variable(_EACH, "m", f"largest distance from the desired position, {_SINCE}"),
        "diverged_at": Variable(_EACH, "s", "when the loop diverged; NaN where it did not"),
    }


_OVER_TIME = ("level", "time")
_FAR = "share `level` of the robots is at most this far from the desired"
SUMMED: Mapping[str, Variable] = {
    "counts": Variable(
        ("time", "channel", "bin"),
        "1",
        "how many robots have an error of this size; what diverged counts in the last bin",
    ),
    "distance_quantile": Variable(_OVER_TIME, "m", f"{_FAR} position"),
    "heading_quantile": Variable(_OVER_TIME, "rad", f"{_FAR} heading"),
}
"""The arrays that are summed up over all robots."""


def drawn_name(parameter: str) -> str:
    """Return what the array of a parameter's draws is called: a slash would make a group of a store of it."""
    return f"drawn_{parameter.replace('/', '.')}"


def drawn(parameters: Mapping[str, Parameter]) -> dict[str, Variable]:
    """Return the arrays of what was drawn for each robot."""
    return {
        drawn_name(name): Variable(_EACH, one.unit or "1", f"drawn {one.meaning}; NaN where not spread")
        for name, one in parameters.items()
    }


def summed(counts: Any) -> dict[str, Any]:
    """Return the arrays of `SUMMED`.

    Parameters
    ----------
    counts : ndarray of int, shape (G, 2, BINS)
        Of all robots.
    """
    found = quantiles(counts.astype(np.int64), np.array(LEVELS))
    return {"counts": counts, "distance_quantile": found[..., 0], "heading_quantile": found[..., 1]}


def coordinates(
    times: Array, names: Sequence[str], inputs: Sequence[str]
) -> list[tuple[str, Sequence[Any], str, str]]:
    """Return name, values, unit and meaning of the coordinates of all dimensions but ``robot``.

    Parameters
    ----------
    times : ndarray, shape (G,)
        Of the counts [s].
    names, inputs : sequence of str
        Of the coordinates that the reference has, and of the plant's inputs.
    """
    return [
        ("time", times.tolist(), "s", "time"),
        ("coordinate", list(names), "1", "coordinate"),
        ("input", list(inputs), "1", "input"),
        ("channel", ["distance", "heading"], "1", "distance from the desired position [m], heading [rad]"),
        ("level", list(LEVELS), "1", "share of the robots"),
        (
            "bin",
            edges()[:-1].tolist(),
            "m or rad",
            "lower edge; the upper one is the next bin's lower one",
        ),
    ]


def dataset_of(ensemble: "Ensemble", attributes: Mapping[str, Any]) -> Any:
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
    scenario, variables = ensemble.scenario, {**_per_robot(ensemble), **SUMMED}
    named = ([one.name for one in each] for each in (scenario.coordinates, scenario.inputs))
    arrays = {name: array for name, _, array in _arrays(ensemble)} | summed(ensemble.counts)
    axes = {
        name: (name, values, {"units": unit, "long_name": meaning})
        for name, values, unit, meaning in coordinates(scenario.grid, *named)
    }
    return xarray.Dataset(
        # Copied, because what xarray hands out may be written into.
        {name: (one.dimensions, arrays[name].copy(), one.attributes) for name, one in variables.items()},
        axes,
        {"Conventions": NOTE, "errors_from_s": scenario.after, **attributes},
    )


def columns_of(ensemble: "Ensemble") -> tuple[list[str], list[Array]]:
    """Return the arrays with one entry per robot as the columns of a table, and their names with units."""
    header, columns = ["robot"], [np.arange(len(ensemble), dtype=np.float64)]
    named: Mapping[str, Sequence[Any]] = {
        "coordinate": ensemble.scenario.coordinates,
        "input": ensemble.scenario.inputs,
    }
    for name, one, array in _arrays(ensemble):
        each = [(f"{name}_{part.name}", part.unit) for part in named.get(one.dimensions[-1], ())]
        known = each or [(name, one.units)]
        header += [f"{of} [{unit}]" if unit not in ("", "1") else of for of, unit in known]
        columns.append(array)
    return header, columns


def _per_robot(ensemble: "Ensemble") -> dict[str, Variable]:
    scenario = ensemble.scenario
    return {**drawn(scenario.parameters), **per_robot(scenario.coordinates, scenario.inputs)}


def _arrays(ensemble: "Ensemble") -> Iterator[tuple[str, Variable, Array]]:
    draws = {drawn_name(name): values for name, values in ensemble.draws.items()}
    for name, one in _per_robot(ensemble).items():
        yield name, one, getattr(ensemble, name) if name in PER_ROBOT else draws[name]
