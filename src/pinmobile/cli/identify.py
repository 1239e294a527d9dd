"""What a log tells of a robot: the table, and measured beside foretold."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from pinmobile import InvalidArgument, Log, MobileRobot, UnknownName, identify, identify_velocity, plots
from pinmobile.cli.options import LECTURE, choose
from pinmobile.cli.output import begin, console, output_folder, progress, save_figure
from pinmobile.identification import METHODS

_COMMANDS = 2  # inputs of a robot that takes speeds for commands


def read(path: Path, columns: Sequence[str], topics: Sequence[str]) -> Log:
    """Return the log of a file: of a bag where topics are named, else of a CSV file.

    Parameters
    ----------
    path : Path
        The file.
    columns, topics : sequence of str
        ``ROLE=NAME,NAME`` and ``ROLE=TOPIC``, as they were typed.

    Raises
    ------
    InvalidArgument, UnknownName
        If it cannot be read, or tells something else.
    """
    if columns and topics:
        raise InvalidArgument("--column applies to a CSV file, and --bag to a bag, expected one of them")
    named = _pairs("--column", columns, "ROLE=NAME,NAME, such as q=px,py,angle")
    told = _pairs("--bag", topics, "ROLE=TOPIC, such as q=/odom")
    with _naming([path]):
        if told:
            return Log.from_bag(path, told)
        return Log.from_csv(path, {role: names.split(",") for role, names in named.items()} or None)


@contextmanager
def _naming(paths: Sequence[Path]) -> Iterator[None]:
    """Let errors call files as they were typed, and columns and topics by their options."""
    try:
        yield
    except UnknownName:
        raise
    except InvalidArgument as error:
        argument, _, number = error.argument.rstrip("]").partition("[")
        said, by_columns, _ = (text := str(error)).partition(", expected columns=")
        if by_columns:
            text = f"{said}, expected --column ROLE=NAME,NAME of these, such as --column q=px,py,angle"
        if argument == "log" and number:
            paths, text = [paths[int(number)]], text.replace(f"[{number}]", "", 1)
        called = {"path": "LOG", "columns": "--column", "topics": "--bag", "delay": "--delay"}
        files = ", ".join(repr(str(path)) for path in paths)
        told = called.get(argument, f"LOG is {files}: {argument}")
        raise InvalidArgument(f"{told}{text[len(argument) :]}", argument="") from error


def _pairs(option: str, words: Sequence[str], expected: str) -> Mapping[str, str]:
    """Return what words such as ``q=/odom`` pair.

    Raises
    ------
    InvalidArgument
        If one is no pair; the message says what is expected.
    """
    found = {}
    for word in words:
        role, _, names = word.partition("=")
        if not role or not names:
            raise InvalidArgument(f"{option} is {word!r}, expected {expected}")
        found[role] = names
    return found


def show_identification(
    logs: Sequence[Log],
    paths: Sequence[Path],
    out: Path,
    *,
    urdf: Path | None,
    method: str | None,
    delay: float | None,
) -> int:
    """Print what logs tell, and draw what was measured beside what is foretold, of the longest.

    Logs of two inputs are of commands of speed and yaw rate, and tell theta.

    Parameters
    ----------
    logs : sequence of Log
        What was measured.
    paths : sequence of Path
        Their files, by which figure and errors are called.
    out : Path
        Folder of the figure.
    urdf : Path or None
        Of the robot as it is believed to be; it does not apply to a log of commands.
    method : str or None
        Name of the method with hyphens, by default ``"output-error"``; likewise.
    delay : float or None
        By which poses come late [s]; None: it is found.

    Raises
    ------
    InvalidArgument, UnknownName
        If an option does not apply, or a log is refused; the message names the file.
    """
    folder = output_folder(out)
    way = choose("method", method or "output-error", {each.replace(" ", "-"): each for each in METHODS})
    log, path = max(zip(logs, paths, strict=True), key=lambda each: len(each[0]))
    commands = log.u.shape[1] == _COMMANDS
    for option, value in (("--urdf", urdf), ("--method", method)):
        if commands and value is not None:
            raise InvalidArgument(f"{option} does not apply to a log of commands of speed and yaw rate")
    with LECTURE.naming("urdf", path="urdf"):
        believed = None if urdf is None else MobileRobot.from_urdf(urdf)
    with progress(2) as bar, _naming(paths):
        begin(bar, "identifying")
        if commands:
            theta = identify_velocity(logs, delay=delay)
            table, foretold = str(theta), theta.predict(log)
        else:
            found = identify(logs, believed, method=way, delay=delay)
            table, foretold = str(found), found.predict(log)
        begin(bar, "drawing")
        figure = folder / f"{path.stem}.png"
        save_figure(plots.prediction(foretold, title=f"{path.name}: measured and foretold"), figure)
    console.print(table, markup=False)
    console.print(str(foretold), markup=False)
    console.print(f"measured and foretold: {figure}", markup=False)
    return 0
