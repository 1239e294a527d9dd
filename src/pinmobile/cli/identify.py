"""What a log tells of a robot: the table, and measured beside foretold."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pinmobile import InvalidArgument, Log, MobileRobot, UnknownName, identify, identify_velocity, plots
from pinmobile.arrays import non_negative, positive
from pinmobile.cli.choices import ROLLING
from pinmobile.cli.options import LECTURE, Options, as_option, choose, numbers
from pinmobile.cli.output import begin, console, output_folder, progress, save_figure
from pinmobile.identification import INSTEAD, METHODS
from pinmobile.parts import evolved, fields_of
from pinmobile.robot import Load
from pinmobile.wheels import MOTORS, Motor, WheeledRobot, WheelTable, read_wheels

_COMMANDS, _WRENCH = 2, 3  # inputs of a robot that takes speeds for commands, and of a body that is pushed
_LOADED = 3  # numbers of a load, its inertia left out
_CALL = "identify([log, loaded], robot, loads=[None, load])"
_TYPED = "pinmobile identify run.csv loaded.csv --load none --load 8@0.1,0.05, say"
_SAID = {
    "of wheels that roll give robot=...": "of wheels that roll give --drive or --urdf",
    "or robot=...,": "or --urdf FILE of the robot,",
    "take identify_velocity;": "give two inputs, and neither --drive nor --urdf;",
    "Then identify": "Then give --drive or --urdf, or three inputs",
    INSTEAD["N"]: "forces take neither --drive nor --motor",
    INSTEAD["N m"]: "torques take --drive, or --urdf, of their wheels, without --motor",
    INSTEAD["V"]: "volts take --drive, or --urdf, and --motor of their wheels",
    INSTEAD["A"]: "currents take --load, once for each LOG, of loads that differ: they tell the torque per "
    "ampere; or multiply by it",
    INSTEAD["m/s"]: "commands of speed and yaw rate take neither --drive nor --urdf",
}
"""What the library says of its arguments, and what is typed for it."""


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
        roles = {role: names.split(",") for role, names in named.items()}
        return Log.from_csv(path, roles or None)


@contextmanager
def _naming(paths: Sequence[Path], robot: str = "") -> Iterator[None]:
    """Let errors call files as they were typed, and columns, topics and the robot by their options."""
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
            text = text.replace(f"[{number}]", "", 1)
            for k, path in enumerate(paths):
                text = text.replace(f"log[{k}]", repr(str(path)))
            paths = [paths[int(number)]]
        for said, words in _SAID.items():
            text = text.replace(said, words)
        called = {"path": "LOG", "columns": "--column", "topics": "--bag", "delay": "--delay"}
        called |= {"loads": "--load", "rolling_speed": "--rolling-speed"}
        if argument == "robot" and robot:
            why = max(text.rfind(", with "), text.find(", expected "), key=lambda at: (at >= 0, -at))
            raise InvalidArgument(f"{robot}{text[why:]}", argument="") from error
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


@dataclass(frozen=True)
class Believed:
    """What is stated of a robot beside its log.

    Attributes
    ----------
    robot : MobileRobot, WheeledRobot, WheelTable or None
        As `identify` takes it; None: the inputs alone tell.
    told : str
        What its inputs are and what is assumed, in words.
    named : str
        The option that stated it, for messages: ``"--urdf is 'robot.urdf'"``.
    """

    robot: Any = None
    told: str = ""
    named: str = ""


def believed_of(given: Mapping[str, Any], drive: str | None, inputs: int) -> Believed:
    """Return the robot that options state: of --drive its wheels alone, of --urdf what the file has.

    Parameters
    ----------
    given : mapping of str to any
        urdf, rollers, wheel_mass, motor, and numbers of the drive, by option; None where nothing was typed.
    drive : str or None
        Name of the drive.
    inputs : int
        How many the log has: of three, without a word about its wheels, the robot of a URDF is pushed.

    Raises
    ------
    InvalidArgument, UnknownName
        If an option does not apply or is not what is expected, or a number of the drive is not given.
    """
    options = Options(given)
    if drive is not None:
        options.refuse(["urdf", "rollers"], "does not apply beside --drive, whose numbers are options")
        return _on(drive, options)
    own = [each for each in given if each not in ("urdf", "rollers", "motor")]
    urdf = given["urdf"]
    options.refuse(own, "applies beside --drive alone" if urdf is None else "does not apply beside --urdf")
    if urdf is None:
        options.refuse(["rollers"], "applies beside --urdf alone")
        options.refuse(["motor"], "applies to wheels, expected --drive or --urdf beside it")
        return Believed()
    of_wheels = [name for name in ("rollers", "motor") if given[name] is not None]
    with LECTURE.naming("urdf", path="urdf"):
        body = MobileRobot.from_urdf(urdf)
    if not body.undercarriage.wheels:
        options.refuse(of_wheels, f"applies to wheels, and --urdf {str(urdf)!r} has none")
    if not body.undercarriage.wheels or (inputs == _WRENCH and not of_wheels):
        told = f"{urdf.name}: inputs are forces on the body" if body.undercarriage.wheels else ""
        return Believed(body, told, f"--urdf is {str(urdf)!r}")
    return _under(body, urdf, options)


def _under(body: MobileRobot, urdf: Path, options: Options) -> Believed:
    """Return the robot of a file on its wheels."""
    rollers, motor = options.values["rollers"], _motor(options.values["motor"])
    named = f"--urdf is {str(urdf)!r}"
    try:
        table = read_wheels(body, **({} if rollers is None else {"rollers": rollers}))
        told = f"{urdf.name}: {table.source}\n{_inputs(table, motor)}"
        if motor is None:
            return Believed(WheeledRobot(body, table), told, named)
        rows = (each if each.motor is None else evolved(each, motor=motor) for each in table.wheels)
        robot = WheeledRobot(body, evolved(table, wheels=tuple(rows)))
        return Believed(robot.by_voltage(), told, named)
    except InvalidArgument as error:
        if rollers is not None and error.argument == "rollers":
            raise error.calling("--rollers") from error
        why = f": {error}"
        if rollers is None and "rollers" in str(error):
            why = (
                ", whose wheels are on more than one axle, expected --rollers ANGLE of them, such as 0.785 "
                "of mecanum wheels: those that skid are not identified"
            )
        raise InvalidArgument(f"{named}{why}", argument="") from error


def _on(drive: str, options: Options) -> Believed:
    """Return the wheels of a drive."""
    choice = choose("drive", drive, ROLLING)
    others = {name for each in ROLLING.values() for name in each.takes} - {*choice.takes}
    takes = ", ".join(map(as_option, choice.takes))
    options.refuse(sorted(others), f"does not apply to {drive}, which takes {takes}")
    own = {name: options.values[name] for name in choice.takes}
    lacking = [as_option(name) for name, value in own.items() if value is None]
    if lacking:
        raise InvalidArgument(f"--drive {drive} needs {' and '.join(lacking)} too", argument="")
    mass = non_negative("--wheel-mass", options.values["wheel_mass"] or 0.0, "kg")
    radius = positive("--wheel-radius", own["wheel_radius"], "m")
    motor = _motor(options.values["motor"])
    called = {option: argument for argument, option in choice.called.items()}
    disc: dict[str, Any] = {} if motor is None else {"motor": motor}
    try:
        table = choice.make(
            **{called.get(name, name): value for name, value in own.items()},
            **disc,
            spin_inertia=mass * radius**2 / 2,
        )
    except InvalidArgument as error:
        raise error.calling(as_option(choice.called.get(error.argument, error.argument))) from None
    turning = (
        f"wheels of {mass:g} kg turn as uniform discs"
        if mass
        else "wheels turn without inertia of their own: what they have is told as the body's, --wheel-mass"
    )
    told = f"{drive}: {choice.label}, of a body of which nothing is believed; {turning}"
    return Believed(table, f"{told}\n{_inputs(table, motor)}", f"--drive is {drive!r}")


def _inputs(table: WheelTable, motor: Motor | None) -> str:
    names = ", ".join(each.name for each in table.actuators)
    if motor is None:
        return f"inputs: torques of {names} [N m], in this order"
    return f"inputs: volts of {names} [V], in this order; {motor.source or evolved(motor, source='')}"


def _motor(text: str | None) -> Motor | None:
    """Return the motor that was named, or whose numbers were typed.

    Raises
    ------
    UnknownName, InvalidArgument
        If there is none of that name, or it takes no volts.
    """
    if text is None:
        return None
    if "=" not in text:
        return choose("motor", text, MOTORS)
    known = [name for name, *_ in fields_of(Motor()) if name != "source"]
    told: dict[str, Any] = {}
    for word in text.split(","):
        name, _, value = word.partition("=")
        if name not in known:
            raise UnknownName("number of --motor", name, known)
        told[name], *_ = numbers(f"--motor {name}", value)
    if "resistance" not in told:
        raise InvalidArgument(
            f"--motor is {text!r}, without a resistance, expected resistance, torque_constant and voltage of "
            f"one that takes volts, or a name: {', '.join(MOTORS)}",
            argument="",
        )
    try:
        return Motor(**told)
    except InvalidArgument as error:
        raise InvalidArgument(f"--motor: {str(error).replace(' of a Motor', '')}", argument="") from error


_LOAD = "none, KG@X,Y or KG@X,Y,INERTIA [kg, m, m, kg m^2]"


def loads_of(words: Sequence[str] | None, count: int) -> list[Load | None] | None:
    """Return the loads that were typed, one for each log; None where none was.

    Raises
    ------
    InvalidArgument
        If there is not one for each log, or it is none.
    """
    if not words:
        return None
    if len(words) != count:
        raise InvalidArgument(
            f"--load comes {len(words)} times, expected {count}, one for each LOG in turn: {_LOAD}",
            argument="",
        )
    return [None if word == "none" else _load(word) for word in words]


def _load(word: str) -> Load:
    mass, _, rest = word.partition("@")
    try:
        told = numbers("--load", f"{mass},{rest}")
    except InvalidArgument:
        told = ()
    if len(told) not in (_LOADED, _LOADED + 1):
        raise InvalidArgument(f"--load is {word!r}, expected {_LOAD}", argument="")
    kilograms, x, y, *about = told
    try:
        return Load(kilograms, (x, y, 0.0), tuple(map(tuple, about[0] * np.eye(3))) if any(about) else None)
    except InvalidArgument as error:
        raise InvalidArgument(f"--load is {word!r}: {error}", argument="") from error


def show_identification(
    logs: Sequence[Log],
    paths: Sequence[Path],
    out: Path,
    believed: Believed,
    *,
    loads: Sequence[Load | None] | None,
    method: str | None,
    delay: float | None,
    rolling_speed: float | None,
) -> int:
    """Print what logs tell, and draw what was measured beside what is foretold, of the longest.

    Logs of two inputs, of which no option says that they are of wheels, are of commands of speed and yaw
    rate, and tell theta.

    Parameters
    ----------
    logs : sequence of Log
        What was measured.
    paths : sequence of Path
        Their files, by which figure and errors are called.
    out : Path
        Folder of the figure.
    believed : Believed
        What is stated of the robot; it does not apply to a log of commands.
    loads : sequence of Load or None, optional
        What it carried in each log; likewise.
    method : str or None
        Name of the method with hyphens, by default ``"output-error"``; likewise.
    delay : float or None
        By which poses come late [s]; None: it is found.
    rolling_speed : float or None
        Where dry friction has reached 71 % of its size [m/s, rad/s]; it does not apply to a log of commands.

    Raises
    ------
    InvalidArgument, UnknownName
        If an option does not apply, or a log is refused; the message names the file.
    """
    folder = output_folder(out)
    way = choose("method", method or "output-error", {each.replace(" ", "-"): each for each in METHODS})
    log, path = max(zip(logs, paths, strict=True), key=lambda each: len(each[0]))
    commands = log.u.shape[1] == _COMMANDS and not believed.told
    typed = {"urdf": believed.robot, "method": method, "load": loads, "rolling-speed": rolling_speed}
    for option, value in typed.items():
        if commands and value is not None:
            raise InvalidArgument(f"--{option} does not apply to a log of commands of speed and yaw rate")
    with progress(2) as bar, _naming(paths, believed.named):
        begin(bar, "identifying")
        if commands:
            theta = identify_velocity(logs, delay=delay)
            table, foretold = str(theta), theta.predict(log)
        else:
            found = identify(
                logs, believed.robot, loads=loads, method=way, delay=delay, rolling_speed=rolling_speed
            )
            table, foretold = str(found).replace(_CALL, _TYPED), found.predict(log)
        begin(bar, "drawing")
        figure = folder / f"{path.stem}.png"
        save_figure(plots.prediction(foretold, title=f"{path.name}: measured and foretold"), figure)
    for text in (believed.told, table, str(foretold), f"measured and foretold: {figure}"):
        if text:
            console.print(text, markup=False)
    return 0
