"""The arrays of a sweep's Zarr store: names, dimensions, units, and how they are divided into chunks."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pinmobile.ensembles import PARAMETERS
from pinmobile.ensembles.histogram import BINS, edges
from pinmobile.sweeps.extras import imported
from pinmobile.sweeps.grids import Grid
from pinmobile.sweeps.reading import METADATA, digest_of
from pinmobile.sweeps.table import axis_of_rivals

__all__ = ["LEVELS", "PER_ROBOT", "empty_store", "spread_names"]

LEVELS = (0.5, 0.9, 0.99)
"""Shares of the robots of which the store has the quantiles over time."""

_UNTIL = "of a diverged robot until then"
_SINCE = f"from the scenario's `after` on, {_UNTIL}"
_OF_POSE, _OF_FORCE = "m, m, rad", "N, N, N m"
PER_ROBOT: Mapping[str, tuple[tuple[str, ...], str, str]] = {
    "max_error": (("coordinate",), _OF_POSE, f"largest |error|, {_SINCE}"),
    "rms_error": (
        ("coordinate",),
        _OF_POSE,
        f"root of the mean squared error, {_SINCE}",
    ),
    "max_force": (("coordinate",), _OF_FORCE, f"largest |generalised force|, {_UNTIL}"),
    "max_distance": ((), "m", f"largest distance from the desired position, {_SINCE}"),
    "diverged_at": ((), "s", "when the loop diverged; NaN where it did not"),
}
"""Of each array with one entry per robot: further dimensions, unit and meaning."""

_OVER_TIME = {
    "distance_quantile": ("m", "share `level` of the robots is at most this far from the desired position"),
    "heading_quantile": ("rad", "share `level` of the robots is at most this far from the desired heading"),
}


def spread_names(grid: Grid) -> list[str]:
    """Return the parameters that are spread in at least one scenario, in the order of `PARAMETERS`."""
    return [name for name in PARAMETERS if any(name in scenario.spread for scenario in grid.scenarios)]


def empty_store(grid: Grid, description: Mapping[str, Any], chunk: int) -> dict[str, bytes]:
    """Return the files that a store has before any number is known, by their places in it.

    Parameters
    ----------
    grid : Grid
        Its scenarios.
    description : mapping
        All that determines the numbers.
    chunk : int
        Robots in a chunk of the arrays.
    """
    zarr = imported("zarr")
    files: dict[str, Any] = {}
    with zarr.config.set({"array.write_empty_chunks": True}):  # so that a coordinate of zeros has a file too
        _make_arrays(zarr.create_group(zarr.storage.MemoryStore(files)), grid, chunk)
    made = {place: content.to_bytes() for place, content in files.items()}
    begins = {scenario.after for scenario in grid.scenarios}
    since = {"errors_from_s": begins.pop()} if len(begins) == 1 else {}
    metadata = json.loads(made.pop(METADATA))
    nodes = {place.split("/")[0]: json.loads(made[place]) for place in made if place.endswith(METADATA)}
    mine: dict[str, Any] = {"chunk": chunk, "rivals": axis_of_rivals(grid.axes), "determined_by": description}
    mine |= {"arrays": list(nodes)}
    metadata["attributes"] = {
        "Conventions": "units and long_name of each variable; robot i of a scenario is row i",
        "pinmobile_sweep": json.dumps({**mine, "digest": digest_of(mine, nodes, since)}),
        **since,
    }
    # It is in no specification yet, but every reader that does not know it passes over it.
    consolidated = {"kind": "inline", "must_understand": False, "metadata": nodes}
    metadata["consolidated_metadata"] = consolidated
    return {METADATA: json.dumps(metadata, indent=2).encode(), **made}


def _make_arrays(group: Any, grid: Grid, chunk: int) -> None:
    for name, values, unit, meaning in _coordinates(grid):
        _coordinate(group, name, values, {**({"units": unit} if unit else {}), "long_name": meaning})
    outer, ones = tuple(grid.axes), (1,) * len(grid.axes)
    records = dict(PER_ROBOT)
    for name in spread_names(grid):
        parameter = PARAMETERS[name]
        records[f"drawn_{name}"] = (
            (),
            parameter.unit or "1",
            f"drawn {parameter.meaning}; NaN where not spread",
        )
    for name, (inner, unit, meaning) in records.items():
        dimensions, sizes = (*outer, "robot", *inner), (grid.n, *(3 for _ in inner))
        chunks = (*ones, min(chunk, grid.n), *(3 for _ in inner))
        _array(group, name, dimensions, (*grid.shape, *sizes), chunks, {"units": unit, "long_name": meaning})
    times = len(grid.scenarios[0].grid)
    counted = times, 2, BINS
    meaning = "how many robots have an error of this size; what diverged counts in the last bin"
    dimensions = *outer, "time", "channel", "bin"
    attrs = {"units": "1", "long_name": meaning}
    _array(group, "counts", dimensions, (*grid.shape, *counted), (*ones, *counted), attrs, np.int32)
    for name, (unit, meaning) in _OVER_TIME.items():
        sizes = len(LEVELS), times
        attrs = {"units": unit, "long_name": meaning}
        _array(group, name, (*outer, "level", "time"), (*grid.shape, *sizes), (*ones, *sizes), attrs)


def _coordinates(grid: Grid) -> list[tuple[str, Sequence[Any], str, str]]:
    found = [(name, list(axis.values), axis.unit, name) for name, axis in grid.axes.items()]
    return [
        *found,
        ("time", grid.scenarios[0].grid.tolist(), "s", "time"),
        ("coordinate", ["x", "y", "psi"], "1", "coordinate"),
        ("channel", ["distance", "heading"], "1", "distance from the desired position [m], heading [rad]"),
        ("level", list(LEVELS), "1", "share of the robots"),
        (
            "bin",
            edges()[:-1].tolist(),
            "m or rad",
            "lower edge; the upper one is the next bin's lower one",
        ),
    ]


def _coordinate(group: Any, name: str, values: Sequence[Any], attributes: Mapping[str, Any]) -> None:
    data = np.array(values, dtype=object if isinstance(values[0], str) else None)
    made = group.create_array(
        name,
        shape=data.shape,
        chunks=data.shape,
        dtype="string" if data.dtype == object else data.dtype,
        dimension_names=[name],
        attributes=dict(attributes),
        compressors=_compressor(),
    )
    made[:] = data


def _array(
    group: Any,
    name: str,
    dimensions: Sequence[str],
    shape: tuple[int, ...],
    chunks: tuple[int, ...],
    attributes: Mapping[str, Any],
    kind: type = np.float64,
) -> None:
    group.create_array(
        name,
        shape=shape,
        chunks=chunks,
        dtype=kind,
        fill_value=kind(0) if kind is np.int32 else np.nan,
        dimension_names=list(dimensions),
        attributes=dict(attributes),
        compressors=_compressor(),
    )


def _compressor() -> Any:
    return imported("zarr").codecs.ZstdCodec(level=0, checksum=True)  # what is damaged is noticed
