"""Scenario files: TOML in, a grid of scenarios out, and the line of what is wrong."""

import re
import tomllib
from collections.abc import Iterator, Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

from pinmobile import Axis, InvalidArgument, PinmobileError, Scenario, UnknownName, grid
from pinmobile.cli.choices import refuse_beside
from pinmobile.cli.lines import line, line_of, line_of_syntax
from pinmobile.cli.spreads import scenario, without_model
from pinmobile.cli.unknown import SPREAD_NAMES, meant
from pinmobile.ensembles import PARAMETERS
from pinmobile.files import cannot
from pinmobile.sweeps import Grid, check_draws

__all__ = ["EXAMPLE", "read_grid"]

EXAMPLE = """
[robot]            # base ("lecture", "box") or urdf, ground; mass, yaw_inertia, com
base = "box"
[trajectory]       # type and what it takes in `run`; heading, psi, turn_time
type = "circle"
radius = 3
[controller]       # type, kp, kd, model_mass, model_yaw_inertia, model_com
[loop]             # dt, integrator, substeps
dt = 0.1
[spread]           # uniform, normal, percent (of nominal), same, or a number
start_x = {normal = [0, 0.001]}
start_y = {same = "start_x", factor = {uniform = [-1, 1]}}
[ensemble]         # n, seed; after: when the start is over and errors count
n = 10000
after = 5
[grid]             # what is swept: any key above, by its table and name
"spread.mass.percent" = [5, 10, 20]
"controller.type" = ["pd", "computed-torque"]
"""
"""A file that runs."""

_CURVE = ("duration", "radius", "rate", "rx", "ry", "wx", "wy", "start", "via", "end", "t_via")
_TABLES: Mapping[str, tuple[str, ...]] = {
    "robot": ("base", "urdf", "ground", "mass", "yaw_inertia", "com"),
    "trajectory": ("type", *_CURVE, "via_velocity", "heading", "psi", "turn_time"),
    "controller": ("type", "kp", "kd", "model_mass", "model_yaw_inertia", "model_com"),
    "loop": ("dt", "integrator", "substeps"),
    "spread": tuple(PARAMETERS),
    "ensemble": ("n", "seed", "after"),
}
_OPTIONS = {
    ("robot", "base"): "robot",
    ("trajectory", "type"): "trajectory",
    ("controller", "type"): "controller",
}
_DEFAULTS = {
    "trajectory": "circle",
    "heading": "tangent",
    "turn_time": 2.0,
    "controller": "computed-torque",
    "dt": 0.1,
    "integrator": "constant-acceleration",
    "substeps": 1,
}
_TEXTS = ("start", "via", "end", "via_velocity", "kp", "kd", "com", "model_com")  # as on the command line
_NAMES = ("base", "urdf", "type", "heading", "integrator")
_UNITS = {
    **{"mass": "kg", "yaw_inertia": "kg m^2", "model_mass": "kg", "model_yaw_inertia": "kg m^2"},
    **{"radius": "m", "rx": "m", "ry": "m", "rate": "rad/s", "wx": "rad/s", "wy": "rad/s", "psi": "rad"},
    **{
        "duration": "s",
        "t_via": "s",
        "turn_time": "s",
        "dt": "s",
        "after": "s",
        "ground": "m",
        "percent": "%",
    },
}


def read_grid(path: Path) -> Grid:
    """Return the grid of scenarios that a file describes.

    Raises
    ------
    InvalidArgument
        If it cannot be read, or something in it is not what is expected; the message begins with the file
        and the line, where there is one.
    """
    text, tree = _parsed(path)
    swept = _checked(path, text, tree)
    both = len(swept.get("controller.type", ())) > 1

    def make(**chosen: Any) -> Scenario:
        changed = deepcopy(tree)
        for name, value in chosen.items():
            _put(changed, name.split("."), value)
        return _scenario(changed, both=both)

    axes = {
        name: _axis(f"{path.name}:{line(text, 'grid', name)}", name, values) for name, values in swept.items()
    }
    try:
        made = grid(make, **axes) if axes else Grid({"scenario": Axis(["all"])}, [make()])
        check_draws(made)
    except PinmobileError as error:
        message = str(error)
        if isinstance(error, UnknownName):
            message = meant(f"{error.kind} {error.name!r}", error.name, error.available, SPREAD_NAMES)
        # The library speaks of arguments, the command of options; a file has keys.
        message = re.sub(r"--spread (\w+)", r"spread of \1", message)
        message = re.sub(r"--([a-z-]+)", lambda found: found[1].replace("-", "_"), message)
        at = line_of(error, message, text, tree, swept)
        raise InvalidArgument(f"{path.name}{at and ':'}{at or ''}: {message}") from error
    return made


def _parsed(path: Path) -> tuple[str, dict[str, Any]]:
    try:
        text = path.read_text(encoding="utf-8")
        return text, tomllib.loads(text)
    except UnicodeDecodeError as error:
        why = f"byte {error.start} is not UTF-8"
        raise InvalidArgument(f"FILE is {str(path)!r}, which cannot be read: {why}") from error
    except OSError as error:
        raise cannot("read", "FILE", path, error) from error
    except RecursionError:
        raise InvalidArgument(f"{path.name}: its values are nested too deep, expected TOML") from None
    except tomllib.TOMLDecodeError as error:
        at, message = line_of_syntax(str(error), text)
        raise InvalidArgument(f"{path.name}:{at}: {message}, expected TOML") from error


def _scenario(tree: Mapping[str, Any], *, both: bool) -> Scenario:
    options: dict[str, Any] = {_OPTIONS.get((t, k), k): None for t, keys in _TABLES.items() for k in keys}
    given = {
        _OPTIONS.get((table, key), key): value
        for table in ("robot", "trajectory", "controller", "loop")
        for key, value in tree.get(table, {}).items()
    }
    options |= _DEFAULTS | given
    if options["heading"] != "tangent":
        refuse_beside(f"--heading {options['heading']}", turn_time=given.get("turn_time"))
    spread = dict(tree.get("spread", {}))
    if both and options["controller"] == "pd":
        options, spread = without_model(options, spread)
    for name in _TEXTS:
        value = options[name]
        if value is not None:
            options[name] = ",".join(map(repr, value)) if isinstance(value, list) else str(value)
    wanted = {"n": 10_000, "seed": 0} | tree.get("ensemble", {})
    return scenario(options, spread, **wanted)


def _checked(path: Path, text: str, tree: dict[str, Any]) -> dict[str, list[Any]]:
    """Refuse what has no meaning, and return what is swept, by dotted names."""
    for table, content in tree.items():
        at = f"{path.name}:{line(text, table)}"
        if table not in (*_TABLES, "grid"):
            raise InvalidArgument(f"{at}: {meant(f'table [{table}]', table, [*_TABLES, 'grid'])}")
        if not isinstance(content, Mapping):
            raise InvalidArgument(f"{at}: {table} is {content!r}, expected a table")
        for key in content if table != "grid" else ():
            if key not in _TABLES[table]:
                at = f"{path.name}:{line(text, table, key)}"
                raise InvalidArgument(f"{at}: {_no_key(f'key {key!r} in [{table}]', table, key)}")
            if key in _NAMES and not isinstance(content[key], str):
                at = f"{path.name}:{line(text, table, key)}"
                raise InvalidArgument(f"{at}: {key} is {content[key]!r}, expected text in quotes")
    swept = dict(_leaves(tree.pop("grid", {})))
    for name, values in swept.items():
        _check_swept(f"{path.name}:{line(text, 'grid', name)}", name, values)
    return swept


def _check_swept(at: str, name: str, values: Any) -> None:
    table, _, rest = name.partition(".")
    if table not in _TABLES:
        what = f"table {table!r} of {name!r} in [grid]"
        raise InvalidArgument(f"{at}: {meant(what, table, _TABLES)}")
    if not rest:
        raise InvalidArgument(f"{at}: {name!r} in [grid] is a table, expected one of its keys, {name}.KEY")
    key = rest.split(".")[0]
    if key not in _TABLES[table]:
        raise InvalidArgument(f"{at}: {_no_key(f'key {key!r} of [{table}] in [grid]', table, key)}")
    if not isinstance(values, list) or not values:
        raise InvalidArgument(f"{at}: {name} is {values!r}, expected a list of values")
    if key in _NAMES and not all(isinstance(value, str) for value in values):
        raise InvalidArgument(f"{at}: {name} is {values!r}, expected texts in quotes")


def _no_key(what: str, table: str, key: str) -> str:
    return meant(what, key, _TABLES[table], SPREAD_NAMES)


def _leaves(tree: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in tree.items():
        name = f"{prefix}.{key}" if prefix else key
        if isinstance(value, Mapping):
            yield from _leaves(value, name)
        else:
            yield name, value


def _put(tree: dict[str, Any], place: list[str], value: Any) -> None:
    *tables, key = place
    for table in tables:
        inner = tree.setdefault(table, {})
        if not isinstance(inner, dict):
            inner = tree[table] = {}
        tree = inner
    tree[key] = value


def _axis(at: str, name: str, values: list[Any]) -> Axis:
    last = name.split(".")[-1]
    unit = (
        PARAMETERS[last].unit if name.startswith("spread.") and last in PARAMETERS else _UNITS.get(last, "")
    )
    try:
        if any(isinstance(value, list | dict) for value in values):
            return Axis({_label(value): value for value in values}, unit)
        return Axis(values, unit)
    except InvalidArgument as error:
        raise InvalidArgument(f"{at}: {re.sub('^values', name, str(error))}") from error


def _label(value: Any) -> str:
    if isinstance(value, dict):
        return " ".join(f"{key} {_label(part)}" for key, part in value.items())
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)
