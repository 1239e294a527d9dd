"""What only sweeps need is imported when it is used."""

from importlib import import_module
from typing import Any

from pinmobile.errors import InvalidArgument

__all__ = ["imported"]


def imported(name: str) -> Any:
    """Return a module of the extra `sweeps`.

    Raises
    ------
    InvalidArgument
        If it is not installed.
    """
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        raise InvalidArgument(
            f"a sweep needs {error.name}: install the extra, pip install 'pinmobile[sweeps]'"
        ) from error
