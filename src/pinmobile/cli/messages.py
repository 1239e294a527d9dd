"""What is said where a name is not there, or somebody stops a command that can go on."""

from collections.abc import Iterable

from pinmobile.errors import PinmobileError, UnknownName

SPREAD_NAMES = "'pinmobile ensemble --help' lists all"
"""Where to see what may be spread."""

_READABLE = 20  # names in a list


class Interrupted(PinmobileError):
    """A command was stopped; the message tells how it goes on."""


def unknown(what: str, name: str, available: Iterable[str], rest: str = "") -> str:
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
    if len(error.listed) <= _READABLE:
        rest = f"available: {', '.join(error.listed)}"
    return f"unknown {what}, {error.meant}{rest}".rstrip()


def shortened(error: UnknownName) -> str:
    """Return the message of an error; where its list is too long to be read, the nearest names."""
    if not error.kind.startswith("parameter in spread"):
        return str(error)
    from pinmobile.ensembles import PARAMETERS

    own = [name for name in error.available if name not in PARAMETERS]
    rest = f"this loop has {', '.join(own)}, and {SPREAD_NAMES} of the library" if own else SPREAD_NAMES
    return unknown(f"{error.kind} {error.name!r}", str(error.name), error.available, rest)
