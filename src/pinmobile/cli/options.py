"""What somebody typed, as options or in a file, and the closed loops and spreads that it stands for."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from pinmobile import (
    InvalidArgument,
    MobileRobot,
    Moved,
    Normal,
    PinmobileError,
    Same,
    Scenario,
    Uniform,
    UnknownName,
    plain_difference,
    planar_difference,
)
from pinmobile.cli.choices import (
    BELIEVED,
    BODY,
    CONTROLLERS,
    HEADINGS,
    INTEGRATORS,
    OPTIONS,
    PATHS,
    ROBOTS,
    Choice,
)
from pinmobile.controllers import Controller
from pinmobile.errors import shown
from pinmobile.loop import Loop, Relative
from pinmobile.parts import Found, named
from pinmobile.paths import Path
from pinmobile.trajectories import Trajectory

_T = TypeVar("_T")
Told = Callable[[str], str]


def as_option(name: str) -> str:
    """Return how an option is typed: ``"--model-com"`` of ``"model_com"``."""
    table, dot, key = name.partition(".")
    return f"--{table} {key}" if dot else f"--{name.replace('_', '-')}"


def as_key(name: str) -> str:
    """Return what an option is called in a scenario file: its key, or of a type what it is the type of."""
    table, dot, key = name.partition(".")
    if dot:
        return f"{table} of {key}"
    key = OPTIONS[name].key
    return name if key == "type" else key


class Interrupted(PinmobileError):
    """A command was stopped; the message says how to go on with it."""


class Refused(InvalidArgument):
    """What somebody typed is not what is expected; the message calls it as it was typed.

    Attributes
    ----------
    place : str
        Where it stands in a scenario file, such as ``"controller.kp"``.
    """

    def __init__(self, message: str, place: str) -> None:
        super().__init__(message, argument="")
        self.place = place

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (str(self), self.place)


def place_of(name: str) -> str:
    """Return where an option stands in a scenario file: ``"controller.kp"``."""
    return OPTIONS[name].place if name in OPTIONS else name


@dataclass(frozen=True)
class Options:
    """What somebody typed.

    Attributes
    ----------
    values : mapping of str to any
        By the names of the options; None where nothing was typed and other options tell.
    told : callable
        How an option was typed, for messages: `as_option`, or `as_key` of a file.
    place : callable
        Where it stands in the file.
    """

    values: Mapping[str, Any]
    told: Told = as_option
    place: Told = place_of

    def __getitem__(self, name: str) -> Any:
        value = self.values.get(name)
        if value is None or OPTIONS[name].kind is not tuple:
            return value
        return alone(numbers(self.told(name), value, self.place(name)))

    def with_values(self, **values: object) -> "Options":
        """Return these options, some of them others."""
        return replace(self, values={**self.values, **values})

    def made(self, name: str, choice: Choice[_T], *first: object, **more: object) -> _T:
        """Return what the choice of an option makes of these; those that were not typed are the lecture's."""
        taken = {each: self[each] for each in choice.takes}
        arguments = {option: argument for argument, option in choice.called.items()}
        told = {each: choice.takes[each] if value is None else value for each, value in taken.items()}
        given = {arguments.get(each, each): value for each, value in told.items() if value is not None}
        with self.naming(name, **choice.called):
            return choice.make(*first, **more, **given)

    def refuse(self, names: Sequence[str], why: str) -> None:
        """Refuse options that do not apply, where one was typed.

        Parameters
        ----------
        names : sequence of str
            Which.
        why : str
            What the message says of the first.

        Raises
        ------
        Refused
            If one was typed.
        """
        for name in names:
            if self.values.get(name) is not None:
                raise Refused(f"{self.told(name)} {why}", self.place(name))

    @contextmanager
    def naming(self, about: str, **called: str) -> Iterator[None]:
        """Let an error of the library call its argument as it was typed.

        Parameters
        ----------
        about : str
            The option that an error about none is about.
        **called : str
            Options by the names of arguments that are called otherwise.

        Raises
        ------
        Refused
            If the library raises `InvalidArgument`.
        """
        try:
            yield
        except Refused:
            raise
        except InvalidArgument as error:
            name = called.get(error.argument, error.argument)
            if name in OPTIONS:
                raise Refused(str(error.calling(self.told(name))), self.place(name)) from error
            raise Refused(str(error), self.place(about)) from error


LECTURE = Options({name: option.default for name, option in OPTIONS.items()})
"""The lecture's own loop: nothing was typed."""


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


def numbers(told: str, value: object, place: str = "") -> tuple[float, ...]:
    """Return the numbers of a text with commas, of a list, or of one number.

    Parameters
    ----------
    told : str
        How the option was typed, for the message.
    value : str, list or number
        What was.
    place : str
        Where it stands in a scenario file.

    Raises
    ------
    Refused
        If it is something else.
    """
    listed: list[Any]
    listed = value.split(",") if isinstance(value, str) else value if isinstance(value, list) else [value]
    if listed and all(isinstance(each, list) for each in listed):  # points
        listed = [number for point in listed for number in point]
    try:
        if not isinstance(value, str) and any(
            isinstance(each, bool) or not isinstance(each, int | float) for each in listed
        ):
            raise ValueError
        first, *others = map(float, listed)
    except (ValueError, OverflowError):
        message = f"{told} is {shown(value)}, expected a number, or numbers with commas"
        raise Refused(message, place) from None
    return first, *others


def alone(found: tuple[float, ...]) -> float | tuple[float, ...]:
    """Return the only number of some, otherwise all."""
    return found if len(found) > 1 else found[0]


def robot(base: Any, **changed: Any) -> Any:
    """Return the robot with another mass, yaw inertia or centre of mass."""
    if not changed:
        return base
    if not hasattr(base, "with_body"):
        raise InvalidArgument(
            f"{', '.join(changed)} of the model are given beside {shown(base)}, expected a robot of the "
            "library",
            argument="",
        )
    own = {name: getattr(base, name) for name in BODY}
    if len(changed.get("com", ())) == 2:  # who says where it is in the plane leaves it as high as it is
        changed["com"] = (*changed["com"], base.com[2])
    other = MobileRobot(**{**own, **changed}, size=base.size, dh=base.dh)
    return base.with_body(other.body, f"{base.source}; with other {', '.join(changed)}")


def path_of(options: Options) -> Path:
    """Return the path that options stand for.

    Raises
    ------
    UnknownName, InvalidArgument
        If an option does not apply to it, or is not what is expected.
    """
    name = options["trajectory"]
    path = choose("trajectory", options["trajectory"], PATHS)
    others = [each for kind in PATHS.values() for each in kind.takes if each not in path.takes]
    takes = ", ".join(map(options.told, path.takes))
    options.refuse(others, f"does not apply to the trajectory {name!r}, which takes {takes}")
    return moved(options, options.made("trajectory", path))


def moved(options: Options, path: Path) -> Path:
    """Return the path where options put it.

    Raises
    ------
    Refused
        If they are not two numbers or three, or the path cannot be moved.
    """
    numbers = options["moved"]
    if numbers is None:
        return path
    if not isinstance(numbers, tuple) or len(numbers) > 3:
        told = options.values["moved"]
        raise Refused(
            f"{options.told('moved')} is {shown(told)}, expected X,Y or X,Y,ANGLE", place_of("moved")
        )
    with options.naming("moved", **dict.fromkeys(("x", "y", "angle"), "moved")):
        return Moved(path, *numbers)


def trajectory_of(options: Options, curve: Path) -> Trajectory:
    """Return the trajectory along a path that options stand for."""
    heading = choose("heading", options["heading"], HEADINGS)
    others = [each for kind in HEADINGS.values() for each in kind.takes if each not in heading.takes]
    options.refuse(others, f"does not apply beside {options.told('heading')} {options['heading']}")
    return options.made("heading", heading, curve)


def plant_of(options: Options) -> Any:
    """Return the robot that options stand for."""
    urdf = options["urdf"]
    if urdf is None:
        options.refuse(["ground"], f"applies beside {options.told('urdf')} alone")
        base = options.made("robot", choose("robot", options["robot"] or "lecture", ROBOTS))
    else:
        options.refuse(["robot"], f"does not apply beside {options.told('urdf')}")
        with options.naming("urdf", path="urdf"):
            base = MobileRobot.from_urdf(urdf, ground=options["ground"])
    return _changed(options, base, "")


def body_of(options: Options, prefix: str = "") -> dict[str, Any]:
    """Return what was typed of a body, by the arguments of a `MobileRobot`."""
    typed = {name: options[prefix + name] for name in BODY if options[prefix + name] is not None}
    if isinstance(typed.get("com"), float):
        typed["com"] = (typed["com"],)  # a point, if not one of as many numbers as it should have
    return typed


def _changed(options: Options, base: object, prefix: str) -> Any:
    with options.naming(f"{prefix}mass", **{name: prefix + name for name in BODY}):
        return robot(base, **body_of(options, prefix))


def controller_of(options: Options, plant: object) -> Controller:
    """Return the controller of a robot that options stand for."""
    name = options["controller"]
    law = choose("controller", options["controller"], CONTROLLERS)
    heading = HEADINGS.get(str(options["heading"]))
    on_circle = heading is None or getattr(heading.make, "on_circle", True)
    difference = planar_difference if on_circle else plain_difference
    more: dict[str, object] = {"difference": difference if options["heading"] else None}
    if law.believes:
        more["robot"] = _changed(options, plant, "model_")
    else:
        options.refuse(BELIEVED, f"does not apply beside {options.told('controller')} {name}")
    return options.made("controller", law, **more)


def closed_loop(options: Options) -> dict[str, Any]:
    """Return the arguments of a `Scenario` that the options of `run` stand for.

    Raises
    ------
    UnknownName, InvalidArgument
        If an option is not what is expected.
    """
    trajectory, plant = trajectory_of(options, path_of(options)), plant_of(options)
    return {
        "robot": plant,
        "controller": controller_of(options, plant),
        "trajectory": trajectory,
        "integrator": choose("integrator", options["integrator"], INTEGRATORS),
        **{name: options[name] for name in ("dt", "substeps")},
    }


def scenario(
    loop: Mapping[str, Any],
    spread: Mapping[str, Any],
    told: Told,
    *,
    lacks: dict[str, UnknownName] | None = None,
    **drawn: Any,
) -> Scenario:
    """Return the scenario of a loop and a spread in words.

    Parameters
    ----------
    loop : mapping
        Arguments of `Scenario`.
    spread : mapping
        By parameter a number, a list, or a table such as ``{uniform = [20, 40]}``.
    told : callable
        How ``"spread.mass"`` was typed, for messages: `as_option` or `as_key`.
    lacks : dict of str to UnknownName, optional
        Where several loops share a spread: takes the names that this one does not have, which are left out.
    **drawn
        Other arguments of `Scenario`: n, seed, after.

    Raises
    ------
    InvalidArgument, UnknownName
        If something is not what is expected.
    """
    bare = Scenario(**loop, n=1, spread={})
    sources = {}
    for name, value in _by_name(spread, bare):
        try:
            sources[name] = _source(told, name, value, bare.find(name))
        except UnknownName as error:
            if lacks is None or error.name != name:
                raise
            lacks[name] = error
    try:
        return Scenario(**loop, **drawn, spread=sources)
    except UnknownName as error:
        raise (lacks or {}).get(str(error.name), error) from None


def check_lacking(lacks: Mapping[str, UnknownName], spread: Collection[str]) -> None:
    """Refuse names of a spread that none of several loops has.

    Parameters
    ----------
    lacks : mapping of str to UnknownName
        Names that some of the loops lack.
    spread : collection of str
        Names that some of them have.

    Raises
    ------
    UnknownName
        If there is one.
    """
    for name, error in lacks.items():
        if name not in spread:
            raise error


def _by_name(spread: Mapping[str, Any], bare: Scenario, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield names and values of a spread: TOML has ``com.x`` as a table within a table."""
    for key, value in spread.items():
        name = f"{prefix}{key}"
        is_table = isinstance(value, Mapping) and not value.keys() & {*_KINDS}
        if is_table and any(isinstance(x, Mapping) or _has(bare, f"{name}.{k}") for k, x in value.items()):
            yield from _by_name(value, bare, f"{name}.")
        else:
            yield name, value


def _has(bare: Scenario, name: str) -> bool:
    with suppress(UnknownName, InvalidArgument):
        return bool(bare.find(name))
    return False


_KINDS = ("uniform", "normal", "percent", "same")


def _unfit(told: Told, name: str, why: str) -> Refused:
    return Refused(f"{told(f'spread.{name}')} {why}", f"spread.{name.removesuffix(' factor')}")


def _source(told: Told, name: str, value: object, found: Found | None) -> Any:
    """Return the distribution or number that a value in words stands for; `found` is the nominal number."""
    if not isinstance(value, Mapping):
        return value
    kinds = [kind for kind in value if kind != "factor"]
    if len(kinds) != 1:
        raise _unfit(told, name, f"is {dict(value)!r}, expected one of {', '.join(_KINDS)}")
    kind = kinds[0]
    if kind not in _KINDS:
        raise UnknownName(f"form in the spread of {name}", kind, _KINDS)
    if kind == "same":
        if not isinstance(value[kind], str):
            raise _unfit(told, name, f"is the same as {value[kind]!r}, expected the name of a parameter")
        factor = _source(told, f"{name} factor", value.get("factor", 1.0), None)
        return Same(value[kind], factor)
    if "factor" in value:
        raise _unfit(told, name, f"has a factor beside {kind}, expected one beside same alone")
    if kind == "percent":
        return _around(told, name, value["percent"], found)
    bounds = value[kind]
    if not isinstance(bounds, list) or len(bounds) != 2:
        raise _unfit(told, name, f"is {kind} of {bounds!r}, expected two numbers")
    try:
        return Uniform(*bounds) if kind == "uniform" else Normal(*bounds)
    except InvalidArgument as error:
        raise Refused(f"{told(f'spread.{name}')}: {error}", f"spread.{name}") from error


def _around(told: Told, name: str, percent: object, found: Found | None) -> Uniform | Relative:
    if not isinstance(percent, int | float) or not percent >= 0:
        raise _unfit(told, name, f"is percent of {percent!r}, expected a number >= 0")
    share, nominal = percent / 100, 1.0 if found is None else float(found.value)
    if found is not None and found.is_array:
        return Relative(Uniform(1 - share, 1 + share))
    if nominal == 0:
        raise _unfit(told, name, f"is {percent:g} percent of 0, expected uniform or normal")
    low, high = sorted((nominal * (1 - share), nominal * (1 + share)))
    return Uniform(low, high)


def without_model(options: Options) -> Options:
    """Return options without the controller's model, for a controller that has none."""
    return options.with_values(**dict.fromkeys(BELIEVED))


def spreadable() -> str:
    """Return what may be spread of the lecture's loop, by the parts that have it, with units."""
    loop = closed_loop(LECTURE)
    found = named(Loop(loop["robot"], loop["controller"], loop["trajectory"], (), loop["integrator"]))
    words: dict[str, list[str]] = {}
    for one in found.values():
        part = one.leaf.path.rpartition(".")[0]
        name = one.path.removeprefix(f"{part}.")
        words.setdefault(part or "start", []).append(f"{name} ({one.unit})" if one.unit else name)
    listed = "\n".join(f"{part}: {', '.join(names)}" for part, names in words.items())
    return (
        f"{listed}\n\nThese are the lecture's. The end of a path is enough: mass is plant.mass, radius "
        "trajectory.path.radius; controller.mass is the nearest one there. Forces, arms and wheels have "
        "more: forces.wind.force.x, forearm_link.mass and left.radius."
    )
