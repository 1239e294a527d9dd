"""Packages that only some need: imported when they are used, and named where they are missing."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from pinmobile.errors import InvalidArgument

EXTRAS: Mapping[str, tuple[str, ...]] = {
    "sweeps": ("dask", "distributed", "xarray", "zarr"),
    "mp4": ("imageio-ffmpeg",),
    "bags": ("rosbags",),
    "mpc": ("daqp",),
}
"""The packages of each extra, as on PyPI; pyproject.toml has their versions."""


def installing(extra: str) -> str:
    """Return how the packages of an extra are installed, wherever this package came from; and the extra."""
    return f"pip install {' '.join(EXTRAS[extra])}, or 'pinmobile[{extra}]'"


def imported(name: str, extra: str, what: str) -> Any:
    """Return a module of an extra.

    Parameters
    ----------
    name : str
        The module.
    extra : str
        The extra that it is of.
    what : str
        What needs it, for the message, such as ``"a sweep"``.

    Raises
    ------
    InvalidArgument
        If it is not installed.
    """
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        raise InvalidArgument(
            f"{what} needs {error.name}, which is not installed: {installing(extra)}"
        ) from error
