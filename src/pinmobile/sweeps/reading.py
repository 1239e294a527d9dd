"""What is read of a store's files by themselves: what it says of itself, counts, what is damaged."""

import json
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from pinmobile.errors import InvalidArgument, shown
from pinmobile.sweeps.extras import imported

__all__ = ["attributes_of", "counts_of", "damaged"]


def attributes_of(path: Path) -> dict[str, Any]:
    """Return what a store says of itself.

    Raises
    ------
    InvalidArgument
        If there is no store of a sweep.
    """
    try:
        metadata = json.loads((path / "zarr.json").read_text(encoding="utf-8"))
        found: dict[str, Any] = {
            **json.loads(metadata["attributes"]["pinmobile_sweep"]),
            "arrays": list(metadata["consolidated_metadata"]["metadata"]),
        }
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InvalidArgument(f"store is {shown(str(path))}, which is not the store of a sweep") from error
    return found


def counts_of(marker: Path) -> Any:
    """Return the counts in the file that says that a chunk is done, shape (G, 2, BINS).

    Raises
    ------
    InvalidArgument
        If it cannot be read.
    """
    try:
        with np.load(marker) as file:
            return file["counts"]
    except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
        raise InvalidArgument(
            f"store has {str(marker)!r}, which cannot be read: {error}; remove that file, and start the same "
            "sweep again"
        ) from error


def damaged(path: Path) -> str:
    """Return in words which file of a store cannot be read."""
    group = imported("zarr").open_group(path, mode="r")
    for name in attributes_of(path)["arrays"]:
        for file in sorted((path / name / "c").rglob("*")):
            if file.is_file():
                try:
                    group[name].blocks[tuple(map(int, file.relative_to(path / name / "c").parts))]
                except Exception as error:  # whatever its codecs say
                    return f"{str(file)!r} cannot be read: {error}"
    return "a file cannot be read"
