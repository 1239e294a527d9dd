"""Scenario files: a closed loop, its runs and their differences, as a part with declared fields."""

from __future__ import annotations

import inspect
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib.resources import files
from pathlib import Path
from typing import Any, Protocol

import attrs

from pinmobile import Circle, ComputedTorque, MobileRobot, Scenario, Tangent, simulate
from pinmobile.arrays import instance, sequence
from pinmobile.controllers import Controller
from pinmobile.errors import InvalidArgument, UnknownName
from pinmobile.forces import Force
from pinmobile.integrators import Integrator
from pinmobile.loop import Rollout
from pinmobile.parts import (
    InvalidEntries,
    OnCoordinates,
    Pushable,
    Stepping,
    Values,
    are_nested,
    child,
    children,
    declare,
    evolved,
    flatten,
    integer,
    is_part_class,
    locate_errors,
    makes_part,
    match_refs,
    named,
    number,
    option,
    parameters,
    part,
    public_names,
    read_entries,
    read_file,
    requirement,
    resolve,
    suggest_name,
    write_text,
)
from pinmobile.plant import Plant
from pinmobile.sweeps import Points
from pinmobile.trajectories import Trajectory

_SHIPPED = files("pinmobile") / "scenarios"


def _paths(name: str, value: Any) -> dict[str, Any]:
    return flatten(instance(name, value, Mapping, "a table of PATH = VALUE"))


def _grid(name: str, value: Any) -> dict[str, Any]:
    """Return the values by path: lists, or tables of values by label."""
    values_of: dict[str, Any] = {}
    for path, values in _paths(name, value).items():
        parent, _, label = path.rpartition(".")
        if parent and not isinstance(values, list | tuple):
            values_of.setdefault(parent, {})[label] = values
        else:
            expected = "a list of values, or a table by label"
            values_of[path] = list(sequence(f"{name}.{path}", values, expected))
    return values_of


def _cases(name: str, value: Any) -> dict[str, dict[str, Any]]:
    cases = instance(name, value, Mapping, "tables of PATH = VALUE by name")
    return {case: _paths(f"{name}.{case}", changes) for case, changes in cases.items()}


class _SteppingPlant(Stepping, Pushable, Protocol):
    """A plant with a body, and with its own step instead of ``forward_dynamics``."""


@part
class ScenarioFile:
    """A closed loop, the number of its runs, and their differences; default: the circle of the lecture."""

    robot: Any = child(
        (Plant, _SteppingPlant),
        default=attrs.Factory(MobileRobot.lecture),
        doc="simulated system",
        expected="a robot",
    )
    controller: Any = child(
        Controller,
        default=attrs.Factory(lambda file: ComputedTorque(file.robot), takes_self=True),
        doc="controller, with its wrappers",
    )
    trajectory: Any = child(
        Trajectory, default=Tangent(Circle(3.0, 0.1, 60.0), turn_time=2.0), doc="trajectory"
    )
    forces: Any = children(
        (Force, OnCoordinates), default={}, doc="external forces, by names of yours", expected="a force"
    )
    integrator: Any = child(Integrator, default=None, doc="integrator", expected="an integrator")
    dt: float = number(default=0.1, unit="s", above=0.0, doc="time step")
    substeps: int = integer(default=1, least=1, doc="steps of the plant in a time step")
    duration: Any = number(default=None, unit="s", above=0.0, doc="duration")
    limit: float = number(default=1e3, above=0.0, doc="largest error before a run counts as diverged")
    n: int = integer(default=10_000, least=1, doc="robots of an ensemble")
    seed: int = integer(default=0, doc="seed of all draws")
    after: float = number(default=0.0, unit="s", lower=0.0, doc="time from which ensembles record errors")
    spread: Any = declare(
        Values("numbers that differ between robots: PATH = DISTRIBUTION"), attrs.Factory(dict)
    )
    grid: Any = option(default=attrs.Factory(dict), check=_grid, doc="values to sweep: PATH = [VALUE, ...]")
    cases: Any = option(default=attrs.Factory(dict), check=_cases, doc="named changes to sweep: PATH = VALUE")

    def simulate(self) -> Rollout:
        """Return the run of the loop, without spread, grid and cases."""
        names = "controller trajectory forces integrator dt substeps duration limit seed"
        return simulate(self.robot, **{name: getattr(self, name) for name in names.split()})

    def scenario(self) -> Scenario:
        """Return the scenario of its ensemble, without grid and cases."""
        names = "robot controller trajectory forces integrator dt substeps duration limit n seed after spread"
        return Scenario(**{name: getattr(self, name) for name in names.split()})


class LoadedFile:
    """A scenario file that has been read, with the words that change it.

    Parameters
    ----------
    words : sequence of str
        A file, or the name of a shipped scenario, and PATH=VALUE.
    allow_code : bool
        Whether modules that the file names may run.
    unused : sequence of str
        Fields that the command leaves aside.
    kind : type
        Class of the content.

    Raises
    ------
    InvalidArgument
        If the file cannot be read, or entries are invalid; the message lists all of them with their lines.
    """

    def __init__(
        self,
        words: Sequence[str],
        *,
        allow_code: bool = False,
        unused: Sequence[str] = (),
        kind: type = ScenarioFile,
    ) -> None:
        self.words = ["=".join(map(str.strip, word.split("=", 1))) for word in words if "=" in word]
        names = [word for word in words if "=" not in word]
        if len(names) > 1:
            raise InvalidArgument(f"{names[1]!r} is a second FILE beside {names[0]!r}, expected PATH=VALUE")
        self.name = names[0] if names else ""
        self.text = _load_text(self.name) if names else ""
        folder = (Path(self.name).absolute().parent if names else Path.cwd()) if allow_code else None
        self.content, self.reader = read_entries(
            kind, self.words, name=self.name, text=self.text, folder=folder, unused=unused
        )

    @property
    def title(self) -> str:
        """Name of the file without its ending, or of its robot."""
        return Path(self.name).stem or "lecture"

    def to_toml(self) -> str:
        """Return the whole scenario as TOML."""
        return write_text(type(self.content), self.reader.tree(self.content))

    def axes(self) -> dict[str, dict[str, Any] | list[Any]]:
        """Return the axes of cases and grid: numbers, or values by label."""
        axes: dict[str, Any] = {}
        for path, values in self.content.grid.items():
            is_numeric = isinstance(values, list) and all(
                isinstance(each, int | float) and not isinstance(each, bool) for each in values
            )
            is_list = isinstance(values, list) and not is_numeric
            axes[path] = {_label(each): each for each in values} if is_list else values
        if self.content.cases:
            axes["case"] = {name: name for name in self.content.cases}
        return axes

    def scenario(self) -> Scenario:
        """Return the nominal scenario of the ensemble.

        Raises
        ------
        InvalidEntries
            If the spread names no number of the loop.
        """
        plain: ScenarioFile = evolved(self.content, grid={}, cases={})
        problems: dict[str, str] = {}
        with self.error_lines():
            nominal = evolved(plain, spread={}).scenario()
        for path in self.content.spread:
            try:
                match_refs(nominal.nominal_loop, path, named(nominal.nominal_loop), "spread")
            except (UnknownName, InvalidArgument) as error:
                problems[f"spread.{path}"] = str(error)
        self._raise_problems(problems)
        with self.error_lines():
            return plain.scenario()

    @contextmanager
    def error_lines(self) -> Iterator[None]:
        """Enter a context in which the error of an entry begins with its line, or its word of the command."""
        try:
            yield
        except InvalidArgument as error:
            path = re.sub(r"\['?(.*?)'?\]", r".\1", error.argument)
            entries = [*tomllib.loads(self.text), *(re.split(r"[.=]", word)[0] for word in self.words)]
            if isinstance(error, InvalidEntries) or path.partition(".")[0] not in entries:
                raise
            self._raise_problems({path: str(error)})

    def _raise_problems(self, problems: Mapping[str, str]) -> None:
        if problems:
            sets = dict(word.split("=", 1) for word in self.words)
            raise locate_errors(InvalidEntries(problems), sets, self.name, self.text)

    def points(self) -> Points:
        """Return the scenarios at all points of cases and grid.

        Raises
        ------
        InvalidArgument
            If values are invalid; the message has a line for each path.
        """
        plain, nominal = evolved(self.content, grid={}, cases={}), self.scenario()
        grid_paths = {_full_path(nominal, path) for path in self.content.grid}
        problems: dict[str, str] = {
            f"cases.{case}.{path}": f"{path} is an axis of the grid too, expected one of them"
            for case, changes in self.content.cases.items()
            for path in changes
            if _full_path(nominal, path) in grid_paths
        }

        def make_scenario(values: dict[str, Any]) -> Scenario:
            case = values.pop("case", "")
            rows = {f"cases.{case}.{path}": (path, x) for path, x in self.content.cases.get(case, {}).items()}
            rows |= {f"grid.{path}": (path, x) for path, x in values.items()}
            paths = {entry: _full_path(nominal, path) for entry, (path, _) in rows.items()}
            try:
                changed = self.reader.change(plain, {paths[entry]: x for entry, (_, x) in rows.items()})
                return changed.scenario()  # type: ignore[no-any-return]
            except InvalidEntries as error:
                self.reader.problems.clear()
                for path, message in error.problems.items():
                    problems.update({entry: message for entry in paths if are_nested(paths[entry], path)})
                return nominal

        points = Points.product(self.axes() or {"case": {"all": ""}}, make_scenario)
        self._raise_problems(problems)
        return points


def _full_path(nominal: Scenario, path: str) -> str:
    """Return the full path of a number in the file for the end of a path."""
    fields = {*parameters(ScenarioFile)} - {"robot"}
    if path.split(".")[0] not in fields:
        with suppress(UnknownName, InvalidArgument):
            path = nominal.find(path).path
    return f"robot.{path.removeprefix('plant.')}" if path.startswith("plant.") else path


def _label(value: object) -> str:
    if isinstance(value, Mapping):
        return " ".join(
            str(each) if key == "type" else f"{key} {_label(each)}" for key, each in value.items()
        )
    return ",".join(map(_label, value)) if isinstance(value, list | tuple) else str(value)


def _load_text(name: str) -> str:
    """Return the text of a file, or of a shipped scenario for a name without suffix."""
    path = Path(name)
    if path.suffix in (".csv", ".npz"):
        raise InvalidArgument(
            f"FILE is {name!r}, a recorded run, expected a scenario; view takes .npz of runs"
        )
    if path.suffix or path.exists():
        return read_file(path)
    if name not in shipped_names():
        reason = f"neither a file nor a shipped scenario, {suggest_name(name, shipped_names())}"
        raise InvalidArgument(f"FILE is {name!r}, {reason}")
    return (_SHIPPED / f"{name}.toml").read_text("utf-8")


def shipped_names() -> list[str]:
    """Return the names of the shipped scenarios."""
    return sorted(each.name.removesuffix(".toml") for each in _SHIPPED.iterdir())


def list_parts() -> str:
    """Return the public parts by package, each with the first line of its docstring."""
    table: dict[str, list[str]] = {}
    for name, one in public_names().items():
        if is_part_class(one):
            package = one.__module__.split(".")[1]
            table.setdefault(package, []).append(f"  {name:20} {(inspect.getdoc(one) or '').splitlines()[0]}")
    lines = [line for package, rows in table.items() for line in (package, *rows)]
    lines += ["fields of one: pinmobile parts NAME, such as scenario, PD or WheelTable.differential"]
    return "\n".join([*lines, f"shipped scenarios: {', '.join(shipped_names())}"])


def describe_part(name: str) -> str:
    """Return the fields of a part, or the arguments of its constructor, with meaning, unit and default."""
    make = ScenarioFile if name == "scenario" else resolve(name)
    if not (is_part_class(make) or makes_part(make)):
        names = [each for each, one in public_names().items() if is_part_class(one)]
        raise InvalidArgument(f"NAME is {name!r}, expected a part, {suggest_name(name, names)}")
    lines = [f"{name}: {(inspect.getdoc(make) or '').splitlines()[0]}"]
    for key, each in parameters(make).items():
        expected = requirement(each.declared).replace("a value", "")
        is_stated = not (
            each.is_required
            or each.default is None
            or each.default is attrs.NOTHING
            or "Factory(" in (text := repr(each.default))
        )
        default = f"default {text}" if is_stated and len(text) < 60 else ""
        lines.append(f"  {key:16} {'; '.join(filter(None, [each.doc, expected, default]))}".rstrip())
    if is_part_class(make):
        makers = [each for each in dir(make) if each[:1] != "_" and resolve(f"{name}.{each}") is not None]
        lines += [f"made by: {', '.join(f'{name}.{each}' for each in makers)}"] if makers else []
    return "\n".join(lines)
