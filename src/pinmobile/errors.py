"""Every error that pinmobile raises on purpose."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from importlib import import_module
from typing import Any

_LONGEST = 500  # letters of a value that a message shows
_LONGEST_LIST = 4000  # letters of a list of names


def shown(value: object) -> str:
    """Return a value as a message shows it: its repr, cut where that is long; what has none is named.

    A list nested too deep, an integer of too many digits and a user's own class may have none.
    """
    try:
        text = repr(value)
    except Exception:
        return f"<{type(value).__name__} without a repr>"
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}... ({len(text):,} letters)"


def format_names(names: Iterable[str]) -> str:
    """Return names as a message lists them: the first of many, those that a terminal cannot print quoted."""
    words, room, rest = [], _LONGEST_LIST, 0
    for name in names:
        word = name if name.isprintable() and len(name) <= _LONGEST else shown(name)
        room -= len(word) + 2
        words += [word] * (room >= 0)
        rest += room < 0
    return ", ".join(words) + f" and {rest:,} more" * bool(rest)


class PinmobileError(Exception):
    """Base of all errors raised by pinmobile."""


class InvalidArgument(PinmobileError, ValueError):
    """An argument is not what is expected; the message names it first, then what came and what was expected.

    Parameters
    ----------
    message : str
        All of it.
    argument : str, optional
        Name of the argument; by default the first word of the message.
    """

    def __init__(self, message: str = "", argument: str | None = None) -> None:
        super().__init__(message)
        self.argument = str(message).partition(" ")[0] if argument is None else argument

    def calling(self, name: str) -> InvalidArgument:
        """Return the error about the same argument where that is called otherwise."""
        return InvalidArgument(name + str(self).removeprefix(self.argument), name)


class NotTraceable(InvalidArgument):
    """A part's law does what cannot be done with symbols, so it cannot be compiled.

    Parameters
    ----------
    what : str
        What it does.
    instead : str
        What to write instead.
    place : str
        The part and the line, as far as they are known.
    """

    def __init__(self, what: str, instead: str, place: str = "") -> None:
        self.what, self.instead, self.place = what, instead, place
        super().__init__(f"{place and place + ': '}{what}, which cannot be compiled; {instead}")

    @property
    def reason(self) -> str:
        """What it does, where, and what to write instead, on one line and without a word of engines."""
        return " ".join(f"{self.place and self.place + ': '}{self.what}; {self.instead}".split())

    def __reduce__(self) -> tuple[type[NotTraceable], tuple[str, str, str]]:
        return type(self), (self.what, self.instead, self.place)


class FileError(PinmobileError, OSError):
    """A file whose path is right fails: the disk is full, a quota is reached, a device fails, it is damaged.

    Attributes
    ----------
    errno : int or None
        Number of the system's error, see the module `errno`; None where the content is damaged.
    filename : str
        The file.
    """

    def __init__(self, message: str, *, errno: int | None, filename: str) -> None:
        super().__init__(message)
        self.errno, self.filename = errno, filename

    def __str__(self) -> str:
        # OSError would show number and file name beside the message, which has them.
        return str(self.args[0])

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(type(self), errno=self.errno, filename=self.filename), self.args


class UnknownName(PinmobileError, KeyError):
    """A name is not among those there are; the message asks for the nearest, and lists them all.

    Parameters
    ----------
    kind : str
        What is named, such as ``"trajectory"``.
    name : str
        The name that came; what is no text is shown as it is.
    available : iterable of str
        The names there are.

    Attributes
    ----------
    meant : str
        The question for the nearest names, "" where none is near.
    listed : tuple of str
        The names there are, the nearest first.
    """

    def __init__(self, kind: str, name: object, available: Iterable[str]) -> None:
        from difflib import get_close_matches  # here, because nobody else needs it

        self.kind, self.name, self.available = kind, name, tuple(available)
        plain = {known.casefold(): known for known in self.available}
        asked = name.casefold()[:_LONGEST] if isinstance(name, str) else ""
        near = [plain[match] for match in get_close_matches(asked, plain, n=3)]
        self.listed = (*near, *(known for known in self.available if known not in near))
        self.meant = f"did you mean {' or '.join(map(shown, near))}? " if near else ""
        super().__init__(f"unknown {kind} {shown(name)}, {self.meant}available: {format_names(self.listed)}")

    def __str__(self) -> str:
        # KeyError would show the repr of the message.
        return str(self.args[0])

    def __reduce__(self) -> tuple[type[UnknownName], tuple[str, object, tuple[str, ...]]]:
        return type(self), (self.kind, self.name, self.available)


class NotFinite(PinmobileError, ArithmeticError):
    """An answer is beyond the numbers that a computer has, though every argument is finite."""


class Diverged(PinmobileError, ArithmeticError):
    """A simulation left the finite numbers, or its error the limit.

    Attributes
    ----------
    time : float
        Time of the first sample that is not acceptable [s].
    q, v : ndarray
        Configuration and velocity at that time.
    rollout : Rollout or None
        Everything recorded before that time; None where the first sample is already beyond the limit.
    """

    def __init__(self, message: str, *, time: float, q: Any, v: Any, rollout: Any = None) -> None:
        super().__init__(message)
        self.time, self.q, self.v, self.rollout = time, q, v, rollout

    def __reduce__(self) -> tuple[Any, ...]:
        # So that it comes back from another process with all that it carries.
        return partial(type(self), time=self.time, q=self.q, v=self.v, rollout=self.rollout), self.args


class NotSolved(PinmobileError, ArithmeticError):
    """A quadratic program has no solution.

    Attributes
    ----------
    time : float
        Time of its sample [s].
    state : ndarray
        The tracked state's difference from the reference.
    problem : dict of str to ndarray
        H, A, lower, upper and sense: least w' H w / 2 with lower <= A w <= upper.
    """

    def __init__(self, message: str, *, time: float, state: Any, problem: dict[str, Any]) -> None:
        super().__init__(message)
        self.time, self.state, self.problem = time, state, problem

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(type(self), time=self.time, state=self.state, problem=self.problem), self.args


class Unreachable(InvalidArgument):
    """A pose cannot be followed within the limits of the robot, or with the clearance that is asked for.

    Attributes
    ----------
    time : float
        The first time at which the error is beyond the tolerance, or the clearance too small [s].
    resolved : InverseKinematicsTrajectory
        The trajectory that comes nearest, step by step, with its errors.
    """

    def __init__(self, message: str, *, time: float, resolved: Any) -> None:
        super().__init__(message)
        self.time, self.resolved = time, resolved

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(type(self), time=self.time, resolved=self.resolved), self.args


class SlowerEngine(UserWarning):
    """A loop runs by a slower engine than it could: the message names the part and what it lacks."""


class LimitWarning(UserWarning):
    """A run exceeds limits of its robot, the robot tips over, or a reference asks for endless forces.

    What a run does is in `Rollout.events` too.
    """


class ViewerError(PinmobileError, RuntimeError):
    """The viewer cannot do what was asked."""


class SchedulerError(PinmobileError, ConnectionError):
    """A Dask cluster does not answer, has no worker, or is lost; or a process that ran robots is."""


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
