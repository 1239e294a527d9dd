"""From the words of the command line to trajectories, controllers and robots."""

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

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
    Lissajous,
    MobileRobot,
    Tangent,
    UnknownName,
    constant_acceleration,
    plain_difference,
    planar_difference,
    rk4,
    semi_implicit_euler,
)
from pinmobile.ensembles import PARAMETERS
from pinmobile.errors import shown

__all__ = [
    "BELIEVED",
    "CONTROLLERS",
    "HEADINGS",
    "INTEGRATORS",
    "OF_PATHS",
    "PATHS",
    "POINTS",
    "ROBOTS",
    "TABLES",
    "UNITS",
    "choose",
    "closed_loop",
    "controller",
    "controller_of",
    "numbers",
    "path",
    "path_of",
    "plant_of",
    "point",
    "refuse_beside",
    "refuse_without",
    "robot",
    "trajectory_of",
]

_T = TypeVar("_T")

# The lecture's own numbers are the defaults.
PATHS: Mapping[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "circle": (Circle, {"radius": 3.0, "rate": 0.1, "duration": 60.0}),
    "lissajous": (Lissajous, {"rx": 3.0, "ry": 3.0, "wx": 0.2, "wy": 0.1, "duration": 60.0}),
    "via-stop": (
        CubicVia,
        {
            "start": (0, 0),
            "via": (2, 2),
            "end": (0, 4),
            "t_via": 30.0,
            "duration": 60.0,
            "via_velocity": (0, 0),
        },
    ),
    "via-free": (CubicVia, {"start": (0, 0), "via": (2, 2), "end": (0, 4), "t_via": 30.0, "duration": 60.0}),
}
OF_PATHS: Mapping[str, Any] = {name: value for _, given in PATHS.values() for name, value in given.items()}
"""What paths take, with the lecture's numbers."""

POINTS = tuple(name for name, value in OF_PATHS.items() if isinstance(value, tuple))
"""What of that is a point or velocity, told as X,Y."""

UNITS: Mapping[str, str] = {
    **{each.attribute: each.unit for each in PARAMETERS.values() if each.attribute and each.entry is None},
    **{name: each.unit for name, each in PARAMETERS.items()},
    **dict.fromkeys(("duration", "dt", "after"), "s"),
    **{"com": PARAMETERS["com_x"].unit, "ground": "m", "percent": "%"},
}
"""Units of what options and files name: as the parts state them, and of the command's own."""

HEADINGS: Mapping[str, Callable[..., Any]] = {
    "tangent": lambda path, psi, turn_time: Tangent(path, turn_time=turn_time),
    "fixed": lambda path, psi, turn_time: FixedHeading(path, psi),
    "lecture": lambda path, psi, turn_time: LectureHeading(path),
}
ROBOTS: Mapping[str, Callable[[], MobileRobot]] = {"lecture": MobileRobot.lecture, "box": MobileRobot.box}
TABLES: Mapping[str, DHTable] = {"lecture": LECTURE_TABLE, "slide": SLIDE_TABLE}
INTEGRATORS: Mapping[str, Any] = {
    "constant-acceleration": constant_acceleration,
    "semi-implicit-euler": semi_implicit_euler,
    "rk4": rk4,
}
BELIEVED = ("model_mass", "model_yaw_inertia", "model_com")
"""Options of what computed torque takes for the robot."""

CONTROLLERS = ("computed-torque", "pd")
_LECTURE_PD = (120.0, 120.0, 0.4)


def choose(kind: str, name: str, available: Mapping[str, _T]) -> _T:
    """Return what the name stands for.

    Raises
    ------
    UnknownName
        If there is no such name; the message lists those there are, the nearest first.
    """
    if name not in available:
        raise UnknownName(kind, name, available)
    return available[name]


def numbers(option: str, text: str | None) -> float | tuple[float, ...] | None:
    """Return the number, or the tuple of numbers separated by commas.

    Raises
    ------
    InvalidArgument
        If the text is something else.
    """
    if text is None:
        return None
    try:
        values = tuple(float(word) for word in text.split(","))
    except ValueError:
        raise InvalidArgument(f"{option} is {text!r}, expected a number, or numbers with commas") from None
    return values[0] if len(values) == 1 else values


def point(option: str, text: str) -> tuple[float, ...]:
    """Return the numbers of a point.

    Raises
    ------
    InvalidArgument
        If the text is something else.
    """
    values = numbers(option, text)
    return values if isinstance(values, tuple) else (values or 0.0,)


def refuse_beside(option: str, **given: Any) -> None:
    """Refuse options that do not apply beside another.

    Raises
    ------
    InvalidArgument
        If one of them was given.
    """
    for name, value in given.items():
        if value is not None:
            raise InvalidArgument(f"--{name.replace('_', '-')} does not apply beside {option}")


def refuse_without(option: str, **given: Any) -> None:
    """Refuse options that apply beside another one alone, which is not given.

    Raises
    ------
    InvalidArgument
        If one of them was given.
    """
    for name, value in given.items():
        if value is not None:
            raise InvalidArgument(f"--{name.replace('_', '-')} applies beside {option} alone")


def path(name: str, given: Mapping[str, Any]) -> Any:
    """Return the path of that name with the parameters that were given in place of the lecture's.

    Raises
    ------
    InvalidArgument
        If a parameter does not apply to the path.
    """
    make, defaults = choose("trajectory", name, PATHS)
    chosen = {key: value for key, value in given.items() if value is not None}
    for key in chosen:
        if key not in defaults:
            options = ", ".join(f"--{option.replace('_', '-')}" for option in defaults)
            option = f"--{key.replace('_', '-')}"
            raise InvalidArgument(
                f"{option} does not apply to the trajectory {name!r}, which takes {options}"
            )
    parameters = {**defaults, **chosen}
    if make is CubicVia:
        parameters["t_end"] = parameters.pop("duration")
    return make(**parameters)


def controller(name: str, model: Any, kp: Any, kd: Any, difference: Any) -> Any:
    """Return the controller of that name; gains that are None are the lecture's.

    Raises
    ------
    UnknownName
        If there is no such controller.
    """
    if name not in CONTROLLERS:
        raise UnknownName("controller", name, CONTROLLERS)
    if name == "pd":
        return PD(_LECTURE_PD if kp is None else kp, _LECTURE_PD if kd is None else kd, difference=difference)
    return ComputedTorque(model, 4 if kp is None else kp, 4 if kd is None else kd, difference=difference)


def robot(base: Any, **changed: Any) -> Any:
    """Return the robot with some of mass, yaw inertia and centre of mass changed; None leaves as it is."""
    kept = {name: value for name, value in changed.items() if value is not None}
    if not kept:
        return base
    if not hasattr(base, "with_body"):
        raise InvalidArgument(
            f"{', '.join(kept)} of the model are given beside {shown(base)}, expected a robot of the library"
        )
    com = kept.get("com")
    if isinstance(com, tuple) and len(com) == 2:
        kept["com"] = (*com, base.com[2])  # who says where it is in the plane leaves it as high as it is
    parameters = {"mass": base.mass, "yaw_inertia": base.yaw_inertia, "com": base.com}
    changed_one = MobileRobot(**{**parameters, **kept}, size=base.size, dh=base.dh)
    return base.with_body(changed_one.body, f"{base.source}; with other {', '.join(kept)}")


def closed_loop(**options: Any) -> tuple[Any, Any, Any, dict[str, Any]]:
    """Return the plant, the controller, the trajectory and the settings that the options of `run` stand for.

    Raises
    ------
    UnknownName, InvalidArgument
        If an option is not what is expected.
    """
    trajectory, plant = trajectory_of(options, path_of(options)), plant_of(options)
    law = controller_of(options, plant)
    step = choose("integrator", options["integrator"], INTEGRATORS)
    return plant, law, trajectory, {"dt": options["dt"], "integrator": step, "substeps": options["substeps"]}


def path_of(options: Mapping[str, Any]) -> Any:
    """Return the path that options stand for."""
    given = {name: options[name] for name in OF_PATHS}
    for name in POINTS:
        given[name] = numbers(f"--{name.replace('_', '-')}", options[name])
    return path(options["trajectory"], given)


def trajectory_of(options: Mapping[str, Any], curve: Any) -> Any:
    """Return the trajectory along a path that options stand for."""
    make = choose("heading", options["heading"], HEADINGS)
    if options["heading"] != "fixed":
        refuse_beside(f"--heading {options['heading']}", psi=options["psi"])
    return make(curve, options["psi"] or 0.0, options["turn_time"])


def plant_of(options: Mapping[str, Any]) -> Any:
    """Return the robot that options stand for."""
    if options["urdf"] is None:
        refuse_without("--urdf", ground=options["ground"])
        base = choose("robot", options["robot"] or "lecture", ROBOTS)()
    else:
        refuse_beside("--urdf", robot=options["robot"])
        base = MobileRobot.from_urdf(options["urdf"], ground=options["ground"])
    changed = {name: options[name] for name in ("mass", "yaw_inertia")}
    return robot(base, **changed, com=numbers("--com", options["com"]))


def controller_of(options: Mapping[str, Any], plant: Any) -> Any:
    """Return the controller of a robot that options stand for."""
    if options["controller"] == "pd":
        refuse_beside("--controller pd", **{name: options[name] for name in BELIEVED})
    changed = {name: options[f"model_{name}"] for name in ("mass", "yaw_inertia")}
    model = robot(plant, **changed, com=numbers("--model-com", options["model_com"]))
    difference = plain_difference if options["heading"] == "lecture" else planar_difference
    gains = numbers("--kp", options["kp"]), numbers("--kd", options["kd"])
    return controller(options["controller"], model, *gains, difference)
