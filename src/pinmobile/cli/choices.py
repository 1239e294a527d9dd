"""What the command and scenario files offer: parts by name, and options as the parts state them."""

import pathlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from inspect import signature
from typing import Any, Generic, TypeAlias, TypeVar

import numpy as np

from pinmobile import (
    LECTURE_TABLE,
    PD,
    SLIDE_TABLE,
    Circle,
    ComputedTorque,
    CubicVia,
    DHTable,
    FixedHeading,
    InvalidArgument,
    LectureHeading,
    Line,
    Lissajous,
    MobileRobot,
    Polyline,
    Tangent,
    VelocityRobot,
    constant_acceleration,
    rk4,
    semi_implicit_euler,
)
from pinmobile.arrays import ArrayLike, one_of, positive
from pinmobile.controllers import Controller
from pinmobile.errors import UnknownName, format_names, shown
from pinmobile.identification import VELOCITY_ROBOTS
from pinmobile.integrators import Integrator
from pinmobile.parts import Number, declared_by
from pinmobile.paths import Path
from pinmobile.trajectories import Trajectory
from pinmobile.wheels import WheelTable

_Made = TypeVar("_Made")
Numbers: TypeAlias = float | tuple[float, ...]
"""One number, or one for each coordinate."""


@dataclass(frozen=True)
class Choice(Generic[_Made]):
    """What a name stands for.

    Attributes
    ----------
    make : callable
        What makes it.
    takes : mapping of str to number, tuple or None
        The options that it takes, and the lecture's own numbers, which are the defaults; None of what is left
        out.
    called : mapping of str to str
        Options by the arguments of `make` that are called otherwise.
    label : str
        What it is called in words.
    """

    make: Callable[..., _Made]
    takes: Mapping[str, Numbers | None] = field(default_factory=dict)
    called: Mapping[str, str] = field(default_factory=dict)
    label: str = ""

    @property
    def believes(self) -> bool:
        """Whether it is made with a robot, which need not be the simulated one."""
        return "robot" in signature(self.make).parameters


def _polyline(waypoints: Sequence[float], **others: Any) -> Polyline:
    """Return the polyline through points whose numbers stand one after another."""
    numbers = np.atleast_1d(waypoints)
    if numbers.size % 2:
        raise InvalidArgument(f"waypoints has {numbers.size} numbers, expected X,Y of each point")
    return Polyline(numbers.reshape(-1, 2), **others)


_CIRCLE: dict[str, None] = {"centre": None, "phase": None, "start_heading": None}
_START = {"heading": "start_heading"}
_LINES: dict[str, Numbers | None] = {
    "duration": 60.0,
    "waypoints": (0, 0, 4, 0, 4, 3),
    "corner_radius": 0.5,
    "acceleration": None,
}
_VIA: dict[str, Numbers] = {"duration": 60.0, "start": (0, 0), "via": (2, 2), "end": (0, 4), "t_via": 30.0}
_END = {"t_end": "duration"}
PATHS: Mapping[str, Choice[Path]] = {
    "circle": Choice(Circle, {"duration": 60.0, "radius": 3.0, "rate": 0.1, **_CIRCLE}, _START),
    "lissajous": Choice(Lissajous, {"duration": 60.0, "rx": 3.0, "ry": 3.0, "wx": 0.2, "wy": 0.1}),
    "via-stop": Choice(CubicVia, {**_VIA, "via_velocity": (0, 0)}, _END),
    "via-free": Choice(CubicVia, _VIA, _END),
    "line": Choice(Line, {"duration": 60.0, "start": (0, 0), "end": (6, 0)}),
    "polyline": Choice(_polyline, _LINES),
}
HEADINGS: Mapping[str, Choice[Trajectory]] = {
    "tangent": Choice(Tangent, {"turn_time": 2.0}),
    "fixed": Choice(FixedHeading, {"psi": 0.0}),
    "lecture": Choice(LectureHeading),
}
_PD = (120.0, 120.0, 0.4)
CONTROLLERS: Mapping[str, Choice[Controller]] = {
    "computed-torque": Choice(ComputedTorque, {"kp": 4.0, "kd": 4.0}, label="computed torque"),
    "pd": Choice(PD, {"kp": _PD, "kd": _PD}, label="PD"),
}
COMPARED = ("pd", "computed-torque")
"""Controllers that run side by side where none is named."""


def _swerve(wheelbase: float, track: float, radius: float, **wheel: Any) -> WheelTable:
    """Return a module in each corner."""
    a, b = positive("wheelbase", wheelbase, "m") / 2, positive("track", track, "m") / 2
    return WheelTable.swerve([(a, b), (a, -b), (-a, b), (-a, -b)], radius, **wheel)


ROBOTS: Mapping[str, Choice[MobileRobot]] = {
    "lecture": Choice(MobileRobot.lecture, label="Icz = 0.1"),
    "box": Choice(MobileRobot.box, label="homogeneous"),
}
TABLES: Mapping[str, DHTable] = {"lecture": LECTURE_TABLE, "slide": SLIDE_TABLE}
INTEGRATORS: Mapping[str, Integrator] = {
    "constant-acceleration": constant_acceleration,
    "semi-implicit-euler": semi_implicit_euler,
    "rk4": rk4,
}


@dataclass(frozen=True)
class Option:
    """An option of the command, and a key of a scenario file.

    Attributes
    ----------
    name : str
        As the argument of a function: ``"model_mass"`` of ``--model-mass``.
    text : str
        What it is, its unit, and what it is where it is not given.
    kind : type
        Of its values; tuple: a number, or several with commas.
    default : any
        What it is where it is not given; None where that hangs on other options.
    table, key : str
        Where it stands in a scenario file; by default, the key is the name.
    unit : str
        "" for none.
    """

    name: str
    text: str
    kind: type = float
    default: object = None
    table: str = ""
    key: str = ""
    unit: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "key", self.key or self.name)

    @property
    def place(self) -> str:
        """Where it stands in a scenario file, such as ``"controller.kp"``."""
        return f"{self.table}.{self.key}"


def velocity_robot(
    preset: str | None = None,
    theta: ArrayLike | None = None,
    ahead: float = 0.0,
    limits: ArrayLike = np.inf,
    accelerations: ArrayLike = np.inf,
) -> VelocityRobot:
    """Return a robot that takes speeds for commands: a published one, or that of six numbers.

    Parameters
    ----------
    preset : str, optional
        Name of one of `VELOCITY_ROBOTS`.
    theta : array_like, shape (6,), optional
        In its place.
    ahead, limits, accelerations
        As of `VelocityRobot`.

    Raises
    ------
    UnknownName
        If there is no such preset; the message lists those there are.
    InvalidArgument
        If neither or both are given, or a number is not what is expected.
    """
    if (preset is None) == (theta is None):
        raise InvalidArgument(
            f"preset is {shown(preset)} and theta {shown(theta)}, expected one of them; presets: "
            f"{', '.join(VELOCITY_ROBOTS)}"
        )
    others = ahead, limits, accelerations
    if theta is not None:
        return VelocityRobot(theta, *others)
    published = VELOCITY_ROBOTS[one_of("preset", preset, VELOCITY_ROBOTS)]
    return VelocityRobot(published.theta, *others, published.size, published.source)


OF_SPEEDS: Mapping[str, Callable[..., VelocityRobot]] = {"velocity": velocity_robot}
"""Robots that take speeds for commands, by the type that a scenario file and `pinmobile drive` call them."""

DEFAULT_PRESET = "pioneer_3dx_laser"
"""The published one that `pinmobile drive` takes where none is named."""

_WHEEL = {"wheel_radius": 0.1}
_FOUR = {"wheelbase": 0.4, "track": 0.5, **_WHEEL}
_CALLED = {"radius": "wheel_radius"}
DRIVES: Mapping[str, Choice[WheelTable]] = {
    "differential": Choice(
        partial(WheelTable.differential, supports=[(0.25, 0.0), (-0.25, 0.0)]),
        {"track": 0.46, **_WHEEL},
        _CALLED,
        "two driven wheels on one axle, two ball casters",
    ),
    "mecanum": Choice(WheelTable.mecanum, _FOUR, _CALLED, "four wheels with rollers at 45 degrees"),
    "omni": Choice(
        WheelTable.omni, {"distance": 0.22, "wheel_radius": 0.06}, _CALLED, "three omni wheels on a circle"
    ),
    "car": Choice(
        WheelTable.car,
        {"wheelbase": 0.5, "track": 0.46, **_WHEEL},
        _CALLED,
        "rear wheels on a differential, front wheels steered by Ackermann's law",
    ),
    "swerve": Choice(
        _swerve,
        {"wheelbase": 0.36, "track": 0.24, "wheel_radius": 0.05},
        _CALLED,
        "four modules that steer and drive",
    ),
    "skid-steer": Choice(
        WheelTable.skid_steer, _FOUR, _CALLED, "four fixed wheels, those of a side on one gear train"
    ),
}
"""Drives by name, each with the numbers of a robot of 0.6 x 0.4 x 0.25 m."""

ROLLING: Mapping[str, Choice[WheelTable]] = {
    name: replace(DRIVES[name], takes=dict.fromkeys(DRIVES[name].takes))
    for name in ("differential", "mecanum", "omni")
}
"""Those whose wheels roll and do not steer, without numbers: a log is of a robot that has its own."""

DRIVEN: Mapping[str, Choice[Path]] = {
    "circle": Choice(Circle, {"duration": 12.6, "radius": 1.0, "rate": 0.5, **_CIRCLE}, _START),
    "lissajous": Choice(Lissajous, {"duration": 12.6, "rx": 0.8, "ry": 0.8, "wx": 1.0, "wy": 0.5}),
    "line": Choice(Line, {"duration": 12.6, "start": (0, 0), "end": (4, 0)}),
    "polyline": Choice(_polyline, {**_LINES, "duration": 12.6, "waypoints": (0, 0, 3, 0, 3, 2)}),
}
"""Paths that a robot of that size drives in a while."""

# No class states these: the number of samples, the shape of the gains or the number of wheels depend on them.
_OWN = {
    "waypoints": Number("waypoints", "m", shapes=(("n",),)),
    "corner_radius": Number("least radius of the corners", "m"),
    "acceleration": Number("with which it starts and comes to rest", "m/s^2"),
    "start_heading": Number("direction of the start, in place of the phase", "rad"),
    "duration": Number("duration of the path", "s"),
    **dict.fromkeys(("kp", "kd"), Number("K or KX,KY,KPSI")),
    "wheelbase": Number("distance of the axles", "m"),
    "track": Number("distance of the sides", "m"),
    "wheel_radius": Number("radius of the wheels", "m"),
    "distance": Number("of the wheels from the middle", "m"),
}


def _told(value: Numbers | None) -> str:
    if value is None:
        return ""
    return ",".join(f"{each:g}" for each in (value if isinstance(value, tuple) else (value,)))


def _sentence(text: str) -> str:
    return text[0].upper() + text[1:]


def _one_of(name: str, choices: Mapping[str, object], default: str, **where: str) -> Option:
    *names, last = choices
    text = f"One of {', '.join(choices)}." if len(choices) > 2 else f"{', '.join(names)} or {last}."
    return Option(name, text, str, default, **where)


def _declared(kind: Any, name: str) -> Number:
    """Return what a part declares of a number."""
    declared: Any = dict(declared_by(kind))[name]
    return declared  # type: ignore[no-any-return]


def _taken(choices: Mapping[str, Choice[Any]], table: str) -> Iterator[Option]:
    """Yield the options that choices take, as their parts state them, with the lecture's numbers."""
    for name in dict.fromkeys(each for choice in choices.values() for each in choice.takes):
        having = {kind: choice for kind, choice in choices.items() if name in choice.takes}
        one = _OWN.get(name) or _declared([*having.values()][-1].make, name)
        first, *others = values = [choice.takes[name] for choice in having.values()]
        which = "" if len(having) == len(choices) else f"{', '.join(having)}: "
        of_others = [
            f", for {kind} {_told(value)}"
            for kind, value in zip([*having][1:], others, strict=True)
            if value != first
        ]
        several = () not in one.shapes or any(isinstance(value, tuple) for value in values)
        axes = f" {'X,Y' if name != 'waypoints' else 'X,Y,X,Y,...'}" if several and one.unit else ""
        in_units = f" ({one.unit})" if one.unit else ""
        default = "" if first is None else f"; {_told(first)}"
        text = f"{one.doc.split(', ')[0]}{axes}{in_units}{default}{''.join(of_others)}."
        yield Option(
            name,
            which + text if which else _sentence(text),
            tuple if several else float,
            table=table,
            unit=str(one.unit),
        )


_NONE: Mapping[str, Numbers] = {}


def body(
    prefix: str = "", table: str = "", rest: str = "", numbers: Mapping[str, Numbers] = _NONE
) -> Iterator[Option]:
    """Yield the options of a body in the plane, as it states them.

    Parameters
    ----------
    prefix : str
        ``"model_"`` of the controller's.
    table : str
        Where they stand in a scenario file.
    rest : str
        What they are where they are not given, in words.
    numbers : mapping of str to float or tuple, optional
        The same, as numbers.
    """
    for name in ("mass", "yaw_inertia", "com"):
        stated = _declared(MobileRobot, name)
        meaning = stated.doc.replace("the robot", "the controller's model") if prefix else stated.doc
        axes = " X,Y" if name == "com" else ""
        last = rest or (f"; {_told(numbers[name])}" if name in numbers else "")
        text = _sentence(f"{meaning}{axes} ({stated.unit}){last}.")
        yield Option(
            prefix + name, text, tuple if name == "com" else float, table=table, unit=str(stated.unit)
        )


GROUND = Option(
    "ground",
    "With --urdf: z of the ground in the root link's frame (m); by default that of the file.",
    table="robot",
    unit="m",
)
MOVED = Option(
    "moved",
    "Where the path's origin is put, and what the path is turned by, X,Y or X,Y,ANGLE (m, rad).",
    tuple,
    table="trajectory",
)
_KINDS_OF_ROBOTS = " or ".join(f"{name} ({choice.label})" for name, choice in ROBOTS.items())
OPTIONS: Mapping[str, Option] = {
    option.name: option
    for option in (
        _one_of("trajectory", PATHS, "circle", table="trajectory", key="type"),
        *_taken(PATHS, "trajectory"),
        MOVED,
        _one_of("heading", HEADINGS, "tangent", table="trajectory"),
        *_taken(HEADINGS, "trajectory"),
        _one_of("controller", CONTROLLERS, "computed-torque", table="controller", key="type"),
        *_taken(CONTROLLERS, "controller"),
        *body("model_", "controller", "; the robot's"),
        Option("robot", f"{_KINDS_OF_ROBOTS}; lecture.", str, table="robot", key="base"),
        Option("urdf", "URDF of the chain or a bare base, in place of --robot.", pathlib.Path, table="robot"),
        GROUND,
        *body("", "robot", "; that of --robot or --urdf"),
        Option("dt", "Sampling time (s).", float, 0.1, "loop", unit="s"),
        _one_of("integrator", INTEGRATORS, "constant-acceleration", table="loop"),
        Option("substeps", "Steps of the plant per dt.", int, 1, "loop"),
        Option("n", "Number of robots.", int, 10_000, "ensemble"),
        Option("seed", "Seed of what is drawn.", int, 0, "ensemble"),
        Option("after", "Errors count from this time on (s).", float, 0.0, "ensemble", unit="s"),
    )
}
"""All options that a scenario file has as keys, too, by name."""

OF_PARTS = tuple(
    option.name for option in OPTIONS.values() if option.kind is str and option.key == option.name
)
"""Those that name a part and may be a table in a scenario file."""

OF_DRIVES = (
    *_taken(DRIVES, "drive"),
    _one_of("trajectory", DRIVEN, "lissajous", table="trajectory"),
    *_taken(DRIVEN, "trajectory"),
    MOVED,
    _one_of("heading", HEADINGS, "tangent", table="trajectory"),
    *_taken({name: HEADINGS[name] for name in ("tangent", "fixed")}, "trajectory"),
)

OF_ROLLING = tuple(_taken(ROLLING, "drive"))
OF_ENSEMBLES = tuple(option for option in OPTIONS.values() if option.table == "ensemble")
OF_LOOPS = tuple(option for option in OPTIONS.values() if option.table != "ensemble")
BODY, BELIEVED = (tuple(each.name for each in body(prefix)) for prefix in ("", "model_"))

UNITS = {name: option.unit for name, option in OPTIONS.items() if option.unit} | {"percent": "%"}
"""Units of options by name."""

_READABLE = 20  # names in a list
SPREAD_FORMS = "uniform:LOW,HIGH normal:MEAN,STD percent:P (of the nominal) same:NAME[,FACTOR] or a number"


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
        rest = f"available: {format_names(error.listed)}"
    return f"unknown {what}, {error.meant}{rest}".rstrip()
