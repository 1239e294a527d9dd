"""The files of a sweep's Zarr store: its arrays, their chunks, and what is read of them by themselves."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from pinmobile.compiled import BINS
from pinmobile.ensembles import (
    LEVELS,
    NOTE,
    PARAMETERS,
    coordinates,
    drawn,
    miscounted,
    over_all,
    per_robot,
)
from pinmobile.errors import InvalidArgument
from pinmobile.files import arrays_of
from pinmobile.plant import Parameter
from pinmobile.sweeps.grids import Grid, imported
from pinmobile.sweeps.table import axis_of_rivals

METADATA = "zarr.json"
"""The file in which a store, or an array of it, says what it is."""

FORMAT = 3
"""Of what a store says that determines its numbers."""

_READ = (2, FORMAT)  # formats whose arrays are these
_MOST = 4096  # bytes of an archive's member beside its numbers


def digest_of(mine: Mapping[str, Any], nodes: Mapping[str, Any], since: Mapping[str, Any]) -> str:
    """Return the digest of all that a store says of itself; what others write into its metadata is no part.

    Parameters
    ----------
    mine : mapping
        What it says of the sweep.
    nodes : mapping
        By the names of its arrays, their metadata.
    since : mapping
        The time from which on errors count, where it is the same for all.
    """
    return sha256(json.dumps([mine, nodes, since], sort_keys=True).encode()).hexdigest()


def attributes_of(path: Path) -> dict[str, Any]:
    """Return what a store says of itself, its arrays' metadata as ``nodes``.

    Raises
    ------
    InvalidArgument
        If there is no store of a sweep, that file is damaged, or another version made it otherwise.
    """
    file = path / METADATA
    try:
        metadata = json.loads(file.read_bytes())
        attributes = metadata["attributes"]
        mine: dict[str, Any] = json.loads(attributes["pinmobile_sweep"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        why = error.strerror if isinstance(error, OSError) else f"it lacks {error}"
        why = f"{error}" if isinstance(error, ValueError) else why
        raise InvalidArgument(
            f"store is {str(path)!r}, which is not the store of a sweep: {str(file)!r} cannot be read: {why}"
        ) from error
    try:
        if mine["determined_by"].get("format") not in (None, *_READ):
            raise InvalidArgument(other_format(path, mine["determined_by"]))
        digest = mine.pop("digest")
        nodes = {name: metadata["consolidated_metadata"]["metadata"][name] for name in mine["arrays"]}
        since = {name: attributes[name] for name in ("errors_from_s",) if name in attributes}
        if digest_of(mine, nodes, since) != digest:
            raise ValueError("it is not what was written")
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InvalidArgument(
            f"store is {str(path)!r}, of which {str(file)!r} is damaged: {error}; a new store of the same "
            "sweep has the same file"
        ) from error
    return {**mine, "nodes": nodes}


def other_format(path: Path, there: Mapping[str, Any]) -> str:
    """Return in words that a store is of a format that is not that of today; "" where it is.

    Parameters
    ----------
    path : Path
        Folder of the store.
    there : mapping
        What it says that determines its numbers.
    """
    if there["format"] == FORMAT:
        return ""
    return (
        f"store is {str(path)!r}, which was made by pinmobile {there['versions']['pinmobile']} in format "
        f"{there['format']}; this one has format {FORMAT}, and cannot tell whether the scenarios are the "
        "same: start in a new folder"
    )


def coordinates_of(nodes: Mapping[str, Any]) -> list[str]:
    """Return the places of the coordinates' files."""
    return [f"{name}/c/0" for name, node in nodes.items() if node["dimension_names"] == [name]]


def counts_of(marker: Path, shape: tuple[int, int], *, robots: int) -> Any:
    """Return the counts in the file that says that a chunk is done, shape (times, channels, BINS).

    Parameters
    ----------
    marker : Path
        The file.
    shape : (int, int)
        How many times of the bands, and channels.
    robots : int
        In the chunk: at each time, so many are counted.

    Raises
    ------
    InvalidArgument
        If it cannot be read, or holds something else.
    FileError
        If the system fails.
    """
    most = 4 * shape[0] * shape[1] * BINS + _MOST
    try:
        counts = arrays_of(
            marker, ["counts"], kind="record of a chunk", name="a file of the store", most=most
        )
        found = counts["counts"]
        why = miscounted(found, *shape, robots)
        if why:
            raise InvalidArgument(f"a file of the store is {str(marker)!r}, which {why}")
    except InvalidArgument as error:
        raise InvalidArgument(f"{error}; remove that file, and start the same sweep again") from error
    return found


def damaged(path: Path) -> str:
    """Return in words which file of a store cannot be read."""
    group = imported("zarr").open_group(path, mode="r")
    for name in attributes_of(path)["arrays"]:
        for file in sorted((path / name / "c").rglob("*")):
            place = file.relative_to(path / name / "c").parts
            if file.is_file() and all(part.isdecimal() for part in place):
                try:
                    group[name].blocks[tuple(map(int, place))]
                except Exception as error:  # whatever its codecs say
                    return f"{str(file)!r} cannot be read: {error}"
    return "a file cannot be read"


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
