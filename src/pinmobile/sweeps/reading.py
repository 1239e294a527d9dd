"""What is read of a store's files by themselves: what it says of itself, counts, what is damaged."""

import json
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

from pinmobile.ensembles.histogram import BINS, miscounted
from pinmobile.errors import InvalidArgument
from pinmobile.files import arrays_of
from pinmobile.sweeps.extras import imported

__all__ = ["METADATA", "attributes_of", "coordinates_of", "counts_of", "damaged", "digest_of"]

METADATA = "zarr.json"
"""The file in which a store, or an array of it, says what it is."""

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
        If there is no store of a sweep, or that file is damaged.
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
