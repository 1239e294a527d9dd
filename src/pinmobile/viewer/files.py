"""Files that are replaced once all of their content is there."""

from collections.abc import Callable
from os import PathLike
from pathlib import Path

from pinmobile.arrays import location
from pinmobile.errors import InvalidArgument, shown

__all__ = ["written"]


def written(path: str | PathLike[str], suffix: str, content: Callable[[], bytes]) -> Path:
    """Write a file once its content is there, after a look that it can be written.

    Raises
    ------
    InvalidArgument
        If it cannot be, or its name ends in another suffix.
    """
    target = location("path", path)
    if target.suffix.lower() != suffix:
        raise InvalidArgument(f"path is {shown(str(target))}, expected a name that ends in {suffix!r}")
    try:
        is_new = not target.exists()
        with target.open("ab"):
            pass
        if is_new:
            target.unlink()
        data = content()
        target.write_bytes(data)
    except OSError as error:
        raise InvalidArgument(
            f"path is {shown(str(target))}, which cannot be written: {error.strerror}"
        ) from error
    return target
