"""Estimates of a robot's parameters from its logs, printed and drawn."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import attrs

from pinmobile import InvalidArgument, Log, identify, identify_velocity, plots
from pinmobile.cli.output import begin, console, output_folder, progress, save_figure
from pinmobile.cli.scenario_file import LoadedFile
from pinmobile.identification import METHODS
from pinmobile.parts import child, number, option, parameters, part

_COMMAND_COUNT = 2  # number of inputs of a robot with velocity inputs


def _roles(name: str, value: Any) -> dict[str, Any]:
    """Return names by role; several names are a list, or text with commas."""
    if not isinstance(value, Mapping):
        raise InvalidArgument(
            f"{name} is {value!r}, expected {name}.ROLE=NAME,NAME, such as {name}.q=px,py,angle"
        )
    return {role: _split_names(names) for role, names in value.items()}


def _split_names(names: Any) -> Any:
    return names.split(",") if isinstance(names, str) and "," in names else names


@part
class IdentifyPaths:
    """Options of an identification: the prior robot, and the form of the logs.

    Attributes
    ----------
    robot : MobileRobot, WheeledRobot or WheelTable, optional
        Prior robot, or its wheels alone; its inputs are the inputs of the logs.
    loads : sequence of PayloadBody or "none", optional
        Known load of each log: loads that differ identify the scale of the inputs.
    by : str or sequence of str, optional
        Numbers of the robot to estimate, by name or pattern.
    method : str
        See `identify`.
    delay : float, optional
        Delay of poses relative to inputs [s]; default: estimated.
    wheelbase : float, optional
        Known distance between the axles of a car [m]: the gain of its steering is estimated.
    rolling_speed : float, optional
        Speed at which dry friction has 71 % of its size [m/s], for wheels [rad/s].
    columns, topics : mapping of str to str or sequence of str, optional
        Columns of a CSV file, or topics of a bag, by role: t, q, u, twist, wheel_rates, joints.
    """

    robot: Any = child(object, optional=True, doc="robot, or its wheels alone", expected="a robot or wheels")
    loads: Any = attrs.field(default=None)
    by: Any = option(default=(), check=lambda _, x: _split_names(x), doc="numbers to estimate: NAME,NAME")
    method: str = option(default=METHODS[0], doc=f"method: {' or '.join(METHODS)}")
    delay: Any = number(default=None, optional=True, unit="s", doc="delay of poses relative to inputs")
    wheelbase: Any = number(default=None, optional=True, unit="m", doc="distance between the axles of a car")
    rolling_speed: Any = number(
        default=None,
        optional=True,
        doc="speed at which dry friction has 71 % of its size",
    )
    columns: Any = option(
        default=None, check=_roles, doc="columns of a CSV file by role: t, q, u, twist, wheel_rates, joints"
    )
    topics: Any = option(default=None, check=_roles, doc="topics of a bag or MCAP file by role")


def show_identification(words: Sequence[str], out: Path) -> int:
    """Print the estimates from logs, and draw the longest log beside its prediction.

    Two inputs without a robot are commands of speed and yaw rate, or of a car: speed and steering angle.

    Raises
    ------
    InvalidArgument, UnknownName
        If an entry or a log is invalid; the message names the file.
    """
    paths = [Path(word) for word in words if "=" not in word]
    if not paths:
        raise InvalidArgument("LOG is missing, expected at least one file, such as run.csv")
    given = LoadedFile([word for word in words if "=" in word], kind=IdentifyPaths).content
    folder = output_folder(out)
    logs = [_load_log(path, given) for path in paths]
    log, path = max(zip(logs, paths, strict=True), key=lambda each: len(each[0]))
    are_commands = log.u.shape[1] == _COMMAND_COUNT and given.robot is None
    loads = given.loads and [None if each == "none" else each for each in given.loads]
    with progress(2) as bar, _name_files(paths):
        begin(bar, "identifying")
        if are_commands:
            for name in ("by", "loads", "rolling_speed"):
                if getattr(given, name) not in (None, ()):
                    raise InvalidArgument(f"{name} does not apply to a log of commands of speed and yaw rate")
            result: Any = identify_velocity(logs, delay=given.delay, wheelbase=given.wheelbase)
        else:
            numbers = {name: getattr(given, name) for name in ("by", "method", "delay", "rolling_speed")}
            result = identify(logs, given.robot, loads=loads, **numbers)
        begin(bar, "drawing")
        prediction, figure = result.predict(log), folder / f"{path.stem}.png"
        save_figure(plots.prediction(prediction, title=f"{path.name}: measured and predicted"), figure)
    for text in ([] if given.robot is None else [f"robot: {given.robot!r}"]) + [str(result), str(prediction)]:
        console.print(text, markup=False)
    console.print(f"measured and predicted: open {figure}", markup=False)
    return 0


def _load_log(path: Path, given: IdentifyPaths) -> Log:
    with _name_files([path]):
        if given.topics or path.suffix == ".mcap":
            return Log.from_bag(path, given.topics or None)
        return Log.from_csv(path, given.columns)


@contextmanager
def _name_files(paths: Sequence[Path]) -> Iterator[None]:
    """Replace the names of logs in errors by the names of their files."""
    try:
        yield
    except InvalidArgument as error:
        argument, text = error.argument, str(error)
        name, _, index = argument.rstrip("]").partition("[")
        if name in parameters(IdentifyPaths):
            raise
        for k, path in enumerate(paths):
            text = text.replace(f"log[{k}]", "log" if index == str(k) else repr(str(path)))
        named = [paths[int(index)]] if name == "log" and index else paths
        files = ", ".join(repr(str(path)) for path in named)
        ending = text.removeprefix("path is ").removeprefix(files) if name == "path" else f": {text}"
        raise InvalidArgument(f"LOG is {files}{ending}", argument="LOG") from error
