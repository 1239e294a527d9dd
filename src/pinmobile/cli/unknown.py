"""Names that are not there: what was meant, and how to see what there is."""

from collections.abc import Iterable

from pinmobile.ensembles import PARAMETERS
from pinmobile.errors import UnknownName

__all__ = ["SPREAD_NAMES", "meant", "shortened"]

SPREAD_NAMES = "'pinmobile ensemble --help' lists all"
"""Where to see what may be spread."""

_READABLE = 20  # names in a list


def meant(what: str, name: str, available: Iterable[str], rest: str = "") -> str:
    """Return the message about a name that is not there: the nearest, and a list that can be read.

    Parameters
    ----------
    what : str
        What is unknown, such as ``"key 'mas' in [robot]"``.
    name : str
        The name that came.
    available : iterable of str
        The names there are.
    rest : str
        Where to see the names when they are too many to be listed.
    """
    error = UnknownName("", name, available)
    if len(error.available) > _READABLE:
        return f"unknown {what}, {error.meant}{rest}".rstrip()
    return str(error).replace(f"unknown  {name!r}", f"unknown {what}", 1)


def shortened(error: UnknownName) -> str:
    """Return the message of an error; where its list is too long to be read, the nearest names."""
    if not error.kind.startswith("parameter in spread"):
        return str(error)
    own = [name for name in error.available if name not in PARAMETERS]
    rest = f"this loop has {', '.join(own)}, and {SPREAD_NAMES} of the library" if own else SPREAD_NAMES
    return meant(f"{error.kind} {error.name!r}", str(error.name), error.available, rest)
