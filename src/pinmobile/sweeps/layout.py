"""The arrays of a sweep's Zarr store: names, dimensions, units, and how they are divided into chunks."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pinmobile.ensembles import PARAMETERS
from pinmobile.ensembles.histogram import BINS
from pinmobile.ensembles.variables import LEVELS, NOTE, coordinates, drawn, over_all, per_robot
from pinmobile.plant import Parameter
from pinmobile.sweeps.extras import imported
from pinmobile.sweeps.grids import Grid
from pinmobile.sweeps.reading import METADATA, digest_of
from pinmobile.sweeps.table import axis_of_rivals

__all__ = ["empty_store", "spread_names"]


def spread_names(grid: Grid) -> list[str]:
    """Return the parameters that are spread in at least one scenario; the library's own come first."""
    return list(_spread_of(grid))


def _spread_of(grid: Grid) -> dict[str, Parameter]:
    found = {name: one for scenario in grid.scenarios for name, one in scenario.parameters.items()}
    known = {name: found[name] for name in PARAMETERS if name in found}
    return known | {name: found[name] for name in sorted(found)}


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
        "Conventions": NOTE,
        "pinmobile_sweep": json.dumps({**mine, "digest": digest_of(mine, nodes, since)}),
        **since,
    }
    # It is in no specification yet, but every reader that does not know it passes over it.
    consolidated = {"kind": "inline", "must_understand": False, "metadata": nodes}
    metadata["consolidated_metadata"] = consolidated
    return {METADATA: json.dumps(metadata, indent=2).encode(), **made}


def _make_arrays(group: Any, grid: Grid, chunk: int) -> None:
    swept = [(name, list(axis.values), axis.unit, name) for name, axis in grid.axes.items()]
    first = grid.scenarios[0]
    for name, values, unit, meaning in [*swept, *coordinates(first)]:
        _coordinate(group, name, values, {**({"units": unit} if unit else {}), "long_name": meaning})
    n = grid.n
    sizes = {"robot": n, "coordinate": len(first.coordinates), "input": len(first.inputs)}
    sizes |= {"time": len(first.grid), "bin": BINS, "level": len(LEVELS)}
    sizes |= {"measure": len(first.judged), "channel": len(first.channels)}
    for name, variable in {
        **per_robot(first),
        **drawn(_spread_of(grid)),
        **over_all(first.channels),
    }.items():
        shape = [sizes[dimension] for dimension in variable.dimensions]
        chunks = [min(chunk, n) if each == "robot" else sizes[each] for each in variable.dimensions]
        _array(
            group,
            name,
            (*grid.axes, *variable.dimensions),
            (*grid.shape, *shape),
            (*(1 for _ in grid.axes), *chunks),
            variable.attributes,
            np.int32 if name == "counts" else np.float64,
        )


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
