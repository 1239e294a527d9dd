"""Every error and warning that pinmobile raises on purpose."""

from __future__ import annotations

import copyreg
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from typing import Any

_MAX_LETTERS = 500  # letters of a value that a message shows
_MAX_LIST = 1000  # letters of a list of names


def format_value(value: object) -> str:
    """Return a value as text for a message.

    The text is the ``repr`` of the value, cut after 500 letters. A part with more than 200 letters, such as
    a robot, is its class with ``(...)``. A value whose ``repr`` fails, such as a list that is nested too
    deep, is named by its class.

    Parameters
    ----------
    value : object
        Value that a message shows.

    Returns
    -------
    str
        Text of the value.

    See Also
    --------
    errors.format_names : names as the text of a message.

    Examples
    --------
    >>> from pinmobile.errors import format_value
    >>> format_value([1.0, "two"])
    "[1.0, 'two']"
    >>> len(format_value("x" * 1000)) < 600
    True
    """
    text = text_of(value)
    is_part = hasattr(type(value), "__attrs_attrs__")
    return f"{type(value).__name__}(...)" if len(text) > 200 and is_part else text


def unexpected_value(name: str, value: object, expected: str) -> InvalidArgument:
    """Return the error of an argument with an unexpected value.

    Parameters
    ----------
    name : str
        Name of the argument.
    value : object
        Its value.
    expected : str
        Expected value, as a noun phrase.

    Returns
    -------
    InvalidArgument
        Error to raise.

    Examples
    --------
    >>> from pinmobile.errors import unexpected_value
    >>> print(unexpected_value("order", 7, "a permutation of x, y and psi"))
    order is 7, expected a permutation of x, y and psi
    """
    hint = ": an object, not a class" if isinstance(value, type) else ""
    return InvalidArgument(f"{name} is {format_value(value)}, expected {expected}{hint}")


def text_of(value: object) -> str:
    """Return the ``repr`` of a value, cut after 500 letters, or its class if the ``repr`` fails."""
    try:
        text = repr(value)
    except Exception:
        return f"<{type(value).__name__} without a repr>"
    return text if len(text) <= _MAX_LETTERS else f"{text[:_MAX_LETTERS]}... ({len(text):,} letters)"


def format_names(names: Iterable[str]) -> str:
    """Return names as the text of a message, separated by commas.

    The text contains the first 1000 letters of a long list. A name that a terminal cannot print is quoted.

    Parameters
    ----------
    names : iterable of str
        Names in the order of the text.

    Returns
    -------
    str
        Text of the names.

    See Also
    --------
    errors.format_value : one value as the text of a message.

    Examples
    --------
    >>> from pinmobile.errors import format_names
    >>> format_names(["mass", "yaw_inertia"])
    'mass, yaw_inertia'
    """
    words, room, rest = [], _MAX_LIST, 0
    for name in names:
        word = name if name.isprintable() and len(name) <= _MAX_LETTERS else format_value(name)
        room -= len(word) + 2
        words += [word] * (room >= 0)
        rest += room < 0
    return ", ".join(words) + f" and {rest:,} more" * bool(rest)


class PinmobileError(Exception):
    """Base class of all errors that pinmobile raises.

    See Also
    --------
    InvalidArgument : an argument is invalid.
    Diverged : a simulation diverged.

    Examples
    --------
    >>> from pinmobile import Circle, PinmobileError
    >>> try:
    ...     Circle(radius=-1.0, rate=0.5, duration=4.0)
    ... except PinmobileError as error:
    ...     print(type(error).__name__)
    InvalidArgument
    """

    def __reduce__(self) -> tuple[Any, ...]:
        # The error keeps its attributes when it returns from another process.
        return copyreg.__newobj__, (type(self), *self.args), vars(self)  # type: ignore[attr-defined]


class InvalidArgument(PinmobileError, ValueError):
    """Error of an argument: its name, its value and the expected value.

    Parameters
    ----------
    message : str
        Complete message.
    argument : str, optional
        Name of the argument; default: the first word of the message.

    See Also
    --------
    PinmobileError : base class of all errors.
    errors.UnknownName : a name is unknown.

    Examples
    --------
    >>> from pinmobile import InvalidArgument, MobileRobot
    >>> try:
    ...     MobileRobot(mass=-1.0, yaw_inertia=1.3)
    ... except InvalidArgument as error:
    ...     print(error)
    mass is -1.0 kg, expected > 0
    """

    def __init__(self, message: str = "", argument: str | None = None) -> None:
        super().__init__(message)
        self.argument = str(message).partition(" ")[0] if argument is None else argument

    def calling(self, name: str) -> InvalidArgument:
        """Return the same error with another name of the argument.

        Parameters
        ----------
        name : str
            New name of the argument.

        Returns
        -------
        InvalidArgument
            Error with the same value and the same expected value.
        """
        return InvalidArgument(name + str(self).removeprefix(self.argument), name)


@contextmanager
def argument_errors(
    before: str = "",
    after: str = "",
    argument: str | None = None,
    *,
    of: type[Exception] | tuple[type[Exception], ...] = InvalidArgument,
) -> Iterator[None]:
    """Convert errors within a ``with`` block to `InvalidArgument` with more text, such as the argument.

    Parameters
    ----------
    before, after : str
        Text before and after the message of the error.
    argument : str, optional
        Name of the argument; default: the first word of the new message.
    of : type or tuple of types
        Errors to convert. The errors of pinmobile remain if it names none of them.

    Raises
    ------
    InvalidArgument
        In place of an error within the block.

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> from pinmobile.errors import argument_errors
    >>> with argument_errors("robot 7: "):
    ...     MobileRobot(mass=-1.0, yaw_inertia=1.3)
    Traceback (most recent call last):
        ...
    pinmobile.errors.InvalidArgument: robot 7: mass is -1.0 kg, expected > 0
    """
    kinds = of if isinstance(of, tuple) else (of,)
    try:
        yield
    except kinds as error:
        if isinstance(error, PinmobileError) and not any(issubclass(kind, PinmobileError) for kind in kinds):
            raise
        text = error.reason if isinstance(error, NotTraceable) else error
        raise InvalidArgument(f"{before}{text}{after}", argument) from error


class NotTraceable(InvalidArgument):
    """Error of a law that cannot be compiled: the law does something that symbols do not support.

    Parameters
    ----------
    obstacle : str
        Description of the operation that symbols do not support.
    remedy : str
        Code that the user can write instead.
    place : str
        Part and line of the law, "" if unknown.

    See Also
    --------
    vectorize : compile a function for many robots.
    Engine : engines of a loop.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import vectorize
    >>> size = vectorize(lambda v: v if v[0] > 0 else -v)
    >>> size(np.array([[1.0], [-2.0]]))
    Traceback (most recent call last):
        ...
    pinmobile.errors.NotTraceable: ...
    """

    def __init__(self, obstacle: str, remedy: str, place: str = "") -> None:
        self.obstacle, self.remedy, self.place = obstacle, remedy, place
        super().__init__(f"{place and place + ': '}{obstacle}, which cannot be compiled; {remedy}")

    @property
    def reason(self) -> str:
        """Reason on one line: the place, the operation and the code to write instead."""
        return " ".join(f"{self.place and self.place + ': '}{self.obstacle}; {self.remedy}".split())


class FileError(PinmobileError, OSError):
    """Error of a file whose path is valid: the disk is full, a device fails, or the file is damaged.

    Parameters
    ----------
    message : str
        Complete message.
    errno : int or None
        Number of the system error, see the module `errno`; None if the content is damaged.
    filename : str
        Path of the file.

    See Also
    --------
    Rollout.save : write a rollout.
    Ensemble.save : write an ensemble.

    Examples
    --------
    >>> from pinmobile.errors import FileError
    >>> error = FileError("disk is full", errno=28, filename="a.npz")
    >>> isinstance(error, OSError), error.filename
    (True, 'a.npz')
    """

    def __init__(self, message: str, *, errno: int | None, filename: str) -> None:
        super().__init__(message)
        self.errno, self.filename = errno, filename

    def __str__(self) -> str:
        # OSError would add its number and the file name, which the message already contains.
        return str(self.args[0])

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(type(self), errno=self.errno, filename=self.filename), self.args


class UnknownName(PinmobileError, KeyError):
    """Error of a name that does not exist: the message suggests the nearest names and lists all valid names.

    Parameters
    ----------
    kind : str
        Kind of the named thing, such as ``"trajectory"``.
    name : str
        Name that does not exist. The message shows any other object as its ``repr``.
    available : iterable of str
        Valid names.

    Attributes
    ----------
    meant : str
        Question that suggests the nearest names, "" if no name is near.
    listed : tuple of str
        Valid names, the nearest first.

    See Also
    --------
    InvalidArgument : an argument is invalid.

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> MobileRobot(30.0, 1.3).frame_pose([0, 0, 0], "bse_link")
    Traceback (most recent call last):
        ...
    pinmobile.errors.UnknownName: ...did you mean 'base_link'? ...
    """

    def __init__(self, kind: str, name: object, available: Iterable[str]) -> None:
        from difflib import get_close_matches  # here, because only this error needs the module

        self.kind, self.name, self.available = kind, name, tuple(available)
        folded = {x.casefold(): x for x in self.available}
        query = name.casefold()[:_MAX_LETTERS] if isinstance(name, str) else ""
        matches = [folded[match] for match in get_close_matches(query, folded, n=3)]
        self.listed = (*matches, *(x for x in self.available if x not in matches))
        self.meant = f"did you mean {' or '.join(map(format_value, matches))}? " if matches else ""
        words = format_names(self.listed) or "none"
        super().__init__(f"unknown {kind} {format_value(name)}, {self.meant}available: {words}")

    def __str__(self) -> str:
        # KeyError would show the repr of the message instead of the message.
        return str(self.args[0])


class NotFinite(PinmobileError, ArithmeticError):
    """Error of a result that exceeds the largest number of float64 although every argument is finite.

    See Also
    --------
    InvalidArgument : an argument is invalid.

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> robot = MobileRobot(mass=1e308, yaw_inertia=1.3)
    >>> robot.kinetic_energy([0, 0, 0], [1e10, 0, 0])
    Traceback (most recent call last):
        ...
    pinmobile.errors.NotFinite: ...
    """


class Diverged(PinmobileError, ArithmeticError):
    """Error of a simulation that diverged: a number is not finite, or a tracking error exceeds the limit.

    Parameters
    ----------
    message : str
        Complete message.
    time : float
        Time of the first sample that is not acceptable [s].
    q, v : ndarray, shape (nq,), (nv,)
        Configuration and velocity at this time.
    rollout : Rollout or None
        Samples before this time; None if the first sample already exceeds the limit.

    See Also
    --------
    simulate : run one robot.
    Rollout : recorded samples.

    Examples
    --------
    >>> from pinmobile import PD, Circle, Diverged, MobileRobot
    >>> from pinmobile import Tangent, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> path = Tangent(Circle(1.0, 0.5, 4.0))
    >>> try:
    ...     simulate(robot, PD(9, 900), path, dt=0.1, limit=1)
    ... except Diverged as error:
    ...     print(f"{error.time:.1f} s, {len(error.rollout)} samples")
    0.7 s, 7 samples
    """

    def __init__(self, message: str, *, time: float, q: Any, v: Any, rollout: Any = None) -> None:
        super().__init__(message)
        self.time, self.q, self.v, self.rollout = time, q, v, rollout


class NotSolved(PinmobileError, ArithmeticError):
    """Error of a quadratic program that has no solution.

    Parameters
    ----------
    message : str
        Complete message.
    time : float
        Time of the sample [s].
    state : ndarray
        Difference between the tracked state and the reference.
    problem : dict of str to ndarray
        Matrices H and A, bounds lower and upper, and sense: minimise w' H w / 2 subject to lower <= A w <=
        upper.

    See Also
    --------
    MPC : controller that solves a quadratic program in each sample.

    Examples
    --------
    >>> from pinmobile.errors import NotSolved
    >>> kept = {"time": 0.2, "state": [0.1], "problem": {}}
    >>> error = NotSolved("no solution", **kept)
    >>> isinstance(error, ArithmeticError), error.time  # [s]
    (True, 0.2)
    """

    def __init__(self, message: str, *, time: float, state: Any, problem: dict[str, Any]) -> None:
        super().__init__(message)
        self.time, self.state, self.problem = time, state, problem


class Unreachable(InvalidArgument):
    """Error of a pose that the robot cannot reach within its limits or with the required clearance.

    Parameters
    ----------
    message : str
        Complete message.
    time : float
        First time at which the error exceeds its tolerance or the clearance is too small [s].
    resolved : InverseKinematicsTrajectory
        Nearest trajectory that the solver found, with its errors in each step.

    See Also
    --------
    solve_inverse_kinematics : trajectory of the joints for a path of poses.

    Examples
    --------
    >>> from pinmobile import InvalidArgument
    >>> from pinmobile.errors import Unreachable
    >>> error = Unreachable("too far", time=1.5, resolved=None)
    >>> isinstance(error, InvalidArgument), error.time  # [s]
    (True, 1.5)
    """

    def __init__(self, message: str, *, time: float, resolved: Any) -> None:
        super().__init__(message)
        self.time, self.resolved = time, resolved


class SlowerEngine(UserWarning):
    """Warning of a loop that a slower engine runs: the message names the part and the missing feature.

    See Also
    --------
    Engine : engines of a loop.
    Rollout.fallback_reason : reason why a faster engine cannot run the loop.

    Examples
    --------
    >>> import warnings
    >>> from pinmobile.errors import SlowerEngine
    >>> with warnings.catch_warnings():  # accept slower engines
    ...     warnings.simplefilter("ignore", SlowerEngine)
    """


class LimitWarning(UserWarning):
    """Warning of a run that exceeds limits of the robot or in which the robot tips over.

    Functions that evaluate a reference issue the warning if the reference requires infinite forces. The
    attribute `Rollout.events` contains the same sentences.

    See Also
    --------
    Rollout.events : limits that a run exceeds.
    simulate : run one robot.

    Examples
    --------
    >>> import warnings
    >>> from pinmobile.errors import LimitWarning
    >>> with warnings.catch_warnings():  # raise an error instead
    ...     warnings.simplefilter("error", LimitWarning)
    """


class ViewerError(PinmobileError, RuntimeError):
    """Error of the viewer: the viewer cannot perform a request.

    See Also
    --------
    viewer.Viewer : viewer in a web browser.

    Examples
    --------
    >>> from pinmobile.errors import ViewerError
    >>> issubclass(ViewerError, RuntimeError)
    True
    """


class SchedulerError(PinmobileError, ConnectionError):
    """Error of a Dask cluster that does not answer, has no worker or is lost, or of a lost process.

    See Also
    --------
    sweep : run the ensembles of a grid.

    Examples
    --------
    >>> from pinmobile.errors import SchedulerError
    >>> issubclass(SchedulerError, ConnectionError)
    True
    """


EXTRAS: Mapping[str, tuple[str, ...]] = {
    "sweeps": ("dask", "distributed", "xarray", "zarr"),
    "mp4": ("imageio-ffmpeg",),
    "bags": ("rosbags", "mcap"),
    "mpc": ("daqp",),
}
"""Packages of each extra, by their names on PyPI. The file pyproject.toml states their versions."""


def install_command(extra: str) -> str:
    """Return the command that installs the packages of an extra.

    Parameters
    ----------
    extra : str
        Name of the extra, a key of `EXTRAS`.

    Returns
    -------
    str
        Command with the packages, and the name of the extra.

    Examples
    --------
    >>> from pinmobile.errors import install_command
    >>> install_command("mpc")
    "pip install daqp, or 'pinmobile[mpc]'"
    """
    return f"pip install {' '.join(EXTRAS[extra])}, or 'pinmobile[{extra}]'"


def import_extra(name: str, extra: str, label: str, error: type[PinmobileError] = InvalidArgument) -> Any:
    """Return a module of an extra.

    Parameters
    ----------
    name : str
        Name of the module.
    extra : str
        Name of the extra that contains the module.
    label : str
        Feature that needs the module, for the message, such as ``"a sweep"``.
    error : type
        Error to raise.

    Returns
    -------
    module
        Imported module.

    Raises
    ------
    InvalidArgument, or the given error
        If the module is not installed.

    Examples
    --------
    >>> from pinmobile.errors import import_extra
    >>> import_extra("nothing_like_it", "mpc", "MPC")
    Traceback (most recent call last):
        ...
    pinmobile.errors.InvalidArgument: MPC needs nothing_like_it...
    """
    try:
        return import_module(name)
    except ModuleNotFoundError as cause:
        words = f"{label} needs {cause.name}, which is not installed: {install_command(extra)}"
        raise error(words) from cause
