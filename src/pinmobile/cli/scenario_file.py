"""Scenario files: TOML in, a grid of scenarios out, and the line of what is wrong."""

import re
import tomllib
from collections.abc import Iterator, Mapping
from copy import deepcopy
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from pinmobile import Axis, InvalidArgument, PinmobileError, Scenario, grid
from pinmobile.cli.spreads import scenario
from pinmobile.ensembles import PARAMETERS
from pinmobile.sweeps import Grid

__all__ = ["EXAMPLE", "read_grid"]

EXAMPLE = """
[robot]            # base ("lecture", "box") or urdf; mass, yaw_inertia, com
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
[ensemble]         # n, seed
n = 10000
[grid]             # what is swept: any key above, by its table and name
"spread.mass.percent" = [5, 10, 20]
"controller.type" = ["pd", "computed-torque"]
"""
"""A file that runs."""

_CURVE = ("duration", "radius", "rate", "rx", "ry", "wx", "wy", "start", "via", "end", "t_via")
_TABLES: Mapping[str, tuple[str, ...]] = {
    "robot": ("base", "urdf", "mass", "yaw_inertia", "com"),
    "trajectory": ("type", *_CURVE, "via_velocity", "heading", "psi", "turn_time"),
    "controller": ("type", "kp", "kd", "model_mass", "model_yaw_inertia", "model_com"),
    "loop": ("dt", "integrator", "substeps"),
    "spread": tuple(PARAMETERS),
    "ensemble": ("n", "seed"),
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
_UNITS = {
    **{"mass": "kg", "yaw_inertia": "kg m^2", "model_mass": "kg", "model_yaw_inertia": "kg m^2"},
    **{"radius": "m", "rx": "m", "ry": "m", "rate": "rad/s", "wx": "rad/s", "wy": "rad/s", "psi": "rad"},
    **{"duration": "s", "t_via": "s", "turn_time": "s", "dt": "s", "percent": "%"},
}


def read_grid(path: Path) -> Grid:
    """Return the grid of scenarios that a file describes.

    Raises
    ------
    InvalidArgument
        If it cannot be read, or something in it is not what is expected; the message begins with the file
        and the line, where there is one.
    """
    try:
        text = path.read_text(encoding="utf-8")
        tree = tomllib.loads(text)
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidArgument(f"FILE is {str(path)!r}, which cannot be read") from error
    except tomllib.TOMLDecodeError as error:
        raise InvalidArgument(_syntax(path, str(error), text)) from error
    swept = _checked(path, text, tree)
    both = len(swept.get("controller.type", ())) > 1

    def make(**chosen: Any) -> Scenario:
        changed = deepcopy(tree)
        for name, value in chosen.items():
            _put(changed, name.split("."), value)
        return _scenario(changed, both=both)

    try:
        axes = {name: _axis(name, values) for name, values in swept.items()}
        return grid(make, **axes) if axes else Grid({"scenario": Axis(["all"])}, [make()])
    except PinmobileError as error:
        # The library speaks of arguments, the command of options; a file has keys.
        message = re.sub(r"--([a-z-]+)", lambda found: found[1].replace("-", "_"), str(error))
        raise InvalidArgument(f"{path.name}{_line_of_message(text, tree, message)}: {message}") from error


def _scenario(tree: Mapping[str, Any], *, both: bool) -> Scenario:
    options: dict[str, Any] = {_OPTIONS.get((t, k), k): None for t, keys in _TABLES.items() for k in keys}
    given = {
        _OPTIONS.get((table, key), key): value
        for table in ("robot", "trajectory", "controller", "loop")
        for key, value in tree.get(table, {}).items()
    }
    options |= _DEFAULTS | given
    spread = dict(tree.get("spread", {}))
    if both and options["controller"] == "pd":  # what another controller believes is nothing to it
        options |= dict.fromkeys(("model_mass", "model_yaw_inertia", "model_com"))
        spread = {name: value for name, value in spread.items() if not name.startswith("model_")}
    for name in _TEXTS:
        value = options[name]
        if value is not None:
            options[name] = ",".join(map(repr, value)) if isinstance(value, list) else str(value)
    wanted = {"n": 10_000, "seed": 0} | tree.get("ensemble", {})
    return scenario(options, spread, **wanted)


def _checked(path: Path, text: str, tree: dict[str, Any]) -> dict[str, list[Any]]:
    """Refuse what has no meaning, and return what is swept, by dotted names."""
    for table, content in tree.items():
        if table not in (*_TABLES, "grid"):
            raise InvalidArgument(
                _unknown(path, _line(text, table), f"table [{table}]", table, [*_TABLES, "grid"])
            )
        if not isinstance(content, Mapping):
            raise InvalidArgument(
                f"{path.name}:{_line(text, table)}: {table} is {content!r}, expected a table"
            )
        if table == "grid":
            continue
        for key in content:
            if key not in _TABLES[table]:
                where = f"key {key!r} in [{table}]"
                raise InvalidArgument(_unknown(path, _line(text, table, key), where, key, _TABLES[table]))
    swept = dict(_leaves(tree.pop("grid", {})))
    for name, values in swept.items():
        at = f"{path.name}:{_line(text, 'grid', name)}"
        table, _, rest = name.partition(".")
        keys = _TABLES.get(table)
        if keys is None or not rest:
            raise InvalidArgument(
                f"{at}: {name!r} in [grid], expected TABLE.KEY with a table of {', '.join(_TABLES)}"
            )
        key = rest.split(".")[0]
        if key not in keys:
            line = _line(text, "grid", name)
            raise InvalidArgument(_unknown(path, line, f"key {key!r} of [{table}] in [grid]", key, keys))
        if not isinstance(values, list) or not values:
            raise InvalidArgument(f"{at}: {name} is {values!r}, expected a list of values")
    return swept


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


def _axis(name: str, values: list[Any]) -> Axis:
    last = name.split(".")[-1]
    unit = (
        PARAMETERS[last].unit if name.startswith("spread.") and last in PARAMETERS else _UNITS.get(last, "")
    )
    if any(isinstance(value, list | dict) for value in values):
        return Axis({_label(value): value for value in values}, unit)
    return Axis(values, unit)


def _label(value: Any) -> str:
    if isinstance(value, dict):
        return " ".join(f"{key} {_label(part)}" for key, part in value.items())
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)


def _unknown(path: Path, line: int, what: str, name: str, available: Any) -> str:
    near = get_close_matches(name, available, n=3)
    listed = ", ".join([*near, *(known for known in available if known not in near)])
    return f"{path.name}:{line}: unknown {what}, available: {listed}"


def _syntax(path: Path, message: str, text: str) -> str:
    found = re.search(r" \(at line (\d+), column (\d+)\)", message)
    line = found[1] if found else str(max(1, len(text.splitlines())))
    return f"{path.name}:{line}: {message[: found.start()] if found else message}, expected TOML"


def _line(text: str, table: str, key: str | None = None) -> int:
    """Return the line of a table or of a key in it: the parser does not tell."""
    where, header = "", 1
    for number, line in enumerate(text.splitlines(), start=1):
        if found := re.match(r"\s*\[\s*([^\]]+?)\s*\]", line):
            where = found[1]
            if where.split(".")[0] == table:
                header = number
                if key is None or where == f"{table}.{key}":
                    return number
            continue
        name = line.split("=")[0].strip().replace('"', "").replace("'", "") if "=" in line else ""
        full = f"{where}.{name}" if where else name
        wanted = table if key is None else f"{table}.{key}"
        if full == wanted or full.startswith(f"{wanted}."):
            return number
    return header


def _line_of_message(text: str, tree: Mapping[str, Any], message: str) -> str:
    """Return the line of the first key that a message names."""
    for word in re.findall(r"\w+", message):
        for table, content in tree.items():
            if isinstance(content, Mapping) and word in content:
                return f":{_line(text, table, word)}"
    return ""
