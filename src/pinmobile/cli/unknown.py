"""Names that are not there: what was meant, and how to see what there is."""

from collections.abc import Iterable
from difflib import get_close_matches

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
    known = list(available)
    near = get_close_matches(name, known, n=3)
    words = [f"unknown {what}"]
    if near:
        words.append(f"did you mean {' or '.join(map(repr, near))}?")
    if len(known) <= _READABLE:
        words.append(f"available: {', '.join([*near, *(one for one in known if one not in near)])}")
    else:
        words.append(rest)
    return f"{words[0]}, {' '.join(words[1:])}"


def shortened(error: UnknownName) -> str:
    """Return the message of an error; where its list is too long to be read, the nearest names."""
    if not error.kind.startswith("parameter in spread"):
        return str(error)
    return meant(f"{error.kind} {error.name!r}", error.name, error.available, SPREAD_NAMES)
