"""Scenario files: TOML in, a grid of scenarios out, and the line of what is wrong."""

import tomllib
from collections.abc import Collection, Mapping
from contextlib import suppress
from copy import deepcopy
from itertools import product
from pathlib import Path
from typing import Any

from pinmobile import InvalidArgument, PinmobileError, Scenario, UnknownName
from pinmobile.cli.choices import (
    CONTROLLERS,
    HEADINGS,
    OF_PARTS,
    OF_SPEEDS,
    OPTIONS,
    UNITS,
    unknown,
)
from pinmobile.cli.options import (
    Options,
    Refused,
    as_key,
    check_lacking,
    controller_of,
    moved,
    path_of,
    plant_of,
    scenario,
    trajectory_of,
    without_model,
)
from pinmobile.cli.tables import (
    FORCES,
    NONE,
    OF_LAWS,
    ROUTES,
    STEPS,
    WRAPPERS,
    Code,
    Maker,
    Table,
    code_in,
    is_code,
    leaves,
    line_of,
    line_of_syntax,
)
from pinmobile.errors import shown
from pinmobile.files import cannot
from pinmobile.sweeps import Axis, Points

_MOST_BYTES = 8 << 20  # as of a URDF

EXAMPLE = """
[robot]            # base ("lecture", "box") or urdf, ground; mass, yaw_inertia, com; or type = "velocity"
base = "box"
[trajectory]       # type and what it takes in `run`; heading, psi, turn_time
type = "circle"
radius = 3
[controller]       # type, kp, kd, model_mass, model_yaw_inertia, model_com
[forces]           # by names of yours, such as wind = {type = "constant", force = [1, 0, 0]}
[loop]             # dt, integrator, substeps
dt = 0.1
[spread]           # uniform, normal, percent (of nominal), same, or a number
start.x = {normal = [0, 0.001]}
start.y = {same = "start.x", factor = {uniform = [-1, 1]}}
[ensemble]         # n, seed; after: errors count from this time on
n = 10000
after = 5
[grid]             # what is swept: any key above, by its table and name
"spread.mass.percent" = [5, 10, 20]
"controller.type" = ["pd", "computed-torque"]
"""
"""A file that runs."""


def _keys(table: str) -> tuple[str, ...]:
    return tuple(option.key for option in OPTIONS.values() if option.table == table)


_CONTROLLERS = {**WRAPPERS, **OF_LAWS}
_OWN = ("forces", "spread")  # tables whose keys others know
_TYPED = ("robot", "trajectory", "controller")  # tables that a type may give keys of its own
_TABLES: Mapping[str, tuple[str, ...]] = {
    table: _keys(table) for table in (*_TYPED, "forces", "loop", "spread", "ensemble")
}
_NAMES = {option.key for option in OPTIONS.values() if option.kind in (str, Path)}
# Of [trajectory], what is not its path's.
_OF_HEADINGS = tuple(dict.fromkeys(each for heading in HEADINGS.values() for each in heading.takes))
_PATH_APART = ("moved", "heading", *_OF_HEADINGS)


def read_grid(path: Path, code: Code | None = None) -> Points:
    """Return the grid of scenarios that a file describes.

    Parameters
    ----------
    path : Path
        The file.
    code : Code, optional
        The modules beside it, which are run where it names parts of theirs; None: that is refused.

    Raises
    ------
    InvalidArgument
        If it cannot be read, something in it is not what is expected, or it names code that must not be run;
        the message begins with the file and the line, where there is one.
    """
    text, tree = _parsed(path)
    swept = dict(leaves(tree.pop("grid"))) if isinstance(tree.get("grid"), Mapping) else {}
    try:
        _check(tree, swept)
        if code is None:
            _refuse_code(path, tree, swept)
        reader = _Reader(tree, swept, Maker(code))
        axes = {name: _axis(name, values) for name, values in swept.items()} or {"scenario": Axis(("all",))}
        made = Points(
            axes, [reader.scenario(**dict(zip(swept, at, strict=True))) for at in product(*swept.values())]
        )
        reader.check_all_taken()
        for scenario in made.scenarios:
            scenario.draws()
    except PinmobileError as error:
        at = line_of(error, text, tree, swept)
        raise InvalidArgument(f"{path.name}{f':{at}' if at else ''}: {error}") from error
    return _in_units(made)


def _parsed(path: Path) -> tuple[str, dict[str, Any]]:
    try:
        with path.open("rb") as file:
            data = file.read(_MOST_BYTES + 1)  # what is no regular file may never end
        if len(data) > _MOST_BYTES:
            raise InvalidArgument(f"{path.name} has more than {_MOST_BYTES >> 20} MiB, expected less")
        text = data.decode("utf-8").replace("\r\n", "\n")
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


class _Reader:
    """Makes the scenarios of a file, and keeps in mind what none of them takes."""

    def __init__(self, tree: Table, swept: Mapping[str, list[Any]], maker: Maker) -> None:
        self.tree, self.swept, self.maker = tree, swept, maker
        self.several = {name for name in _TYPED if len(swept.get(f"{name}.type", ())) > 1}
        self.taken = {name: {"type", *_TABLES[name]} for name in _TYPED}
        self.lacks: dict[str, UnknownName] = {}
        self.spread: set[str] = set()

    def scenario(self, **chosen: object) -> Scenario:
        """Return the scenario for values of what is swept."""
        tree = deepcopy(dict(self.tree))
        for name, value in chosen.items():
            _put(tree, name.split("."), value)
        options = _options(tree)
        law = CONTROLLERS.get(options["controller"]) if "controller" in self.several else None
        if law is not None and not law.believes:
            options = without_model(options)
        drawn = {key: options[key] for key in _TABLES["ensemble"]}
        lacks = self.lacks if "controller" in self.several else None
        made = scenario(self._loop(tree, options), tree.get("spread", {}), as_key, lacks=lacks, **drawn)
        self.spread |= set(made.spread)
        return made

    def check_all_taken(self) -> None:
        """Refuse keys that nothing takes, where several types share a table.

        Raises
        ------
        UnknownName
            If there is one.
        """
        check_lacking(self.lacks, self.spread)
        for name in self.several:
            keys = [*self.tree.get(name, ()), *(rest for one in self.swept for rest in _rest(one, name))]
            for key in keys:
                if key not in self.taken[name]:
                    raise UnknownName(
                        f"key in [{name}], which none of its types takes,", key, self.taken[name]
                    )

    def _loop(self, tree: Table, options: Options) -> dict[str, Any]:
        """Return the arguments of a scenario that tables stand for."""
        part = self.maker.part
        robot = part("robot", tree["robot"], OF_SPEEDS) if _is_composed(tree, "robot") else plant_of(options)
        beside = {"robot": robot}
        if _is_composed(tree, "controller"):
            taken = self.taken["controller"] if "controller" in self.several else None
            controller = part("controller", tree["controller"], _CONTROLLERS, beside=beside, taken=taken)
        else:
            controller = controller_of(options, robot)
        # What the file does not say is the robot's own choice.
        typed = tree.get("loop", {}).get("integrator")
        step = None if typed is None else part("integrator", typed, STEPS, beside=beside)
        return {
            "robot": robot,
            "controller": controller,
            "trajectory": self._trajectory(tree, options, beside),
            "forces": {
                name: part(f"forces.{name}", value, FORCES, beside=beside)
                for name, value in tree.get("forces", {}).items()
            },
            "dt": options["dt"],
            "integrator": step,
            "substeps": options["substeps"],
        }

    def _trajectory(self, tree: Table, options: Options, beside: Table) -> Any:
        if _is_composed(tree, "trajectory"):
            table = {key: value for key, value in tree["trajectory"].items() if key not in _PATH_APART}
            taken = self.taken["trajectory"] if "trajectory" in self.several else None
            path = self.maker.part("path", table, ROUTES, beside=beside, taken=taken)
            if not hasattr(path, "derivative"):  # it has a heading of its own
                said = [key for key in _PATH_APART if key in tree["trajectory"]]
                options.refuse(said, f"does not apply beside trajectory {table['type']}, which is no path,")
                return path
            path = moved(options, path)
        else:
            path = path_of(options)
        heading = options["heading"]
        name = heading["type"] if isinstance(heading, Mapping) else heading
        if not is_code(name):
            return trajectory_of(options, path)
        options.refuse(_OF_HEADINGS, f"does not apply beside heading {name}")
        return self.maker.part("heading", heading, NONE, beside=beside, first=path)


def _options(tree: Table) -> Options:
    """Return what tables say beside the keys of users' parts, which are arguments of these."""
    values = {name: option.default for name, option in OPTIONS.items()}
    for name, option in OPTIONS.items():
        key, table = option.key, tree.get(option.table, {})
        if key in table and (not _is_composed(tree, option.table) or key in _PATH_APART):
            values[name] = table[key]
    heading = values["heading"]
    if isinstance(heading, Mapping) and not is_code(heading.get("type")):
        if "type" not in heading:
            raise Refused(
                f"heading is {shown(heading)}, a table without type, expected type = NAME",
                "trajectory.heading",
            )
        for key in heading:
            if key not in ("type", *_OF_HEADINGS):
                raise UnknownName("key in heading", key, ("type", *_OF_HEADINGS))
        values |= {**heading, "heading": heading.get("type")}
    return Options(values, as_key)


def _is_composed(tree: Table, table: str) -> bool:
    """Return whether a table is of a part that takes its keys as the arguments of its class."""
    name = tree.get(table, {}).get("type")
    composed = {"robot": OF_SPEEDS, "controller": _CONTROLLERS, "trajectory": ROUTES}.get(table, NONE)
    return is_code(name) or (isinstance(name, str) and name in composed)


def _rest(name: str, table: str) -> list[str]:
    """Return the key of a dotted name that is of a table; none where it is not."""
    first, _, rest = name.partition(".")
    return [rest.split(".")[0]] if first == table else []


def _check(tree: Table, swept: Table) -> None:
    """Check that all tables and keys, and the dotted names of what is swept, have a meaning."""
    for table, content in tree.items():
        if table not in (*_TABLES, "grid"):
            raise Refused(unknown(f"table [{table}]", table, [*_TABLES, "grid"]), table)
        if not isinstance(content, Mapping):
            named = ", such as [forces.wind]" if table == "forces" else ""
            raise Refused(f"{table} is {content!r}, expected a table{named}", table)
    own = {*_OWN, *(table for table in _TYPED if _may_be_composed(tree, swept, table))}
    kind = tree.get("robot", {}).get("type")
    if "robot" not in own and kind is not None:
        raise Refused(unknown(f"type of [robot] {kind!r}", str(kind), OF_SPEEDS), "robot.type")
    for table, content in tree.items():
        for key, value in content.items():
            _check_key(f"key {key!r} in [{table}]", table, key, own)
            if not _names_well(table, key, value):
                raise Refused(f"{key} is {value!r}, expected text in quotes", f"{table}.{key}")
    for name, values in swept.items():
        _check_swept(name, values, own)


def _check_key(what: str, table: str, key: str, own: Collection[str], place: str = "") -> None:
    if key not in _TABLES[table] and table not in own:
        raise Refused(unknown(what, key, _TABLES[table]), place or f"{table}.{key}")


def _may_be_composed(tree: Table, swept: Table, table: str) -> bool:
    values = swept.get(f"{table}.type", ())
    types = [tree.get(table, {}).get("type"), *(values if isinstance(values, list) else ())]
    return any(_is_composed({table: {"type": name}}, table) for name in types)


def _names_well(table: str, key: str, value: object) -> bool:
    """Return whether a key that names something has a text, or a table where that is possible."""
    if table in _OWN or key not in _NAMES or isinstance(value, str):
        return True
    return key in OF_PARTS and isinstance(value, Mapping)


def _refuse_code(path: Path, tree: Table, swept: Table) -> None:
    """Refuse the names of users' parts, before any of their modules is looked at.

    Raises
    ------
    Refused
        If there is one; the message says what to type.
    """
    named = {f"{table}.{key}": value for table, keys in tree.items() for key, value in keys.items()}
    for dotted, value in {**named, **swept}.items():
        table, *keys = dotted.split(".")
        for name in code_in("type" if table == "forces" and len(keys) == 1 else keys[-1], value):
            raise Refused(
                f"{'.'.join(keys)} of [{table}] is {name!r}, code of the module {name.partition(':')[0]!r}, "
                "which is not run unless you allow it: look at that module, then type "
                f"'pinmobile sweep {path} --allow-code'",
                dotted,
            )


def _check_swept(name: str, values: object, own: Collection[str]) -> None:
    table, _, rest = name.partition(".")
    if table not in _TABLES:
        raise Refused(unknown(f"table {table!r} of {name!r} in [grid]", table, _TABLES), name)
    if not rest:
        raise Refused(f"{name!r} in [grid] is a table, expected one of its keys, {name}.KEY", name)
    key = rest.split(".")[0]
    _check_key(f"key {key!r} of [{table}] in [grid]", table, key, own, name)
    if not isinstance(values, list) or not values:
        raise Refused(f"{name} is {values!r}, expected a list of values", name)
    if key == rest and not all(_names_well(table, key, value) for value in values):
        raise Refused(f"{name} is {values!r}, expected texts in quotes", name)


def _put(tree: dict[str, Any], place: list[str], value: object) -> None:
    *tables, key = place
    for table in tables:
        inner = tree.setdefault(table, {})
        if not isinstance(inner, dict):
            inner = tree[table] = {}
        tree = inner
    tree[key] = value


def _axis(name: str, values: list[Any]) -> Axis:
    labels = list(map(_label, values)) if any(isinstance(x, list | dict) for x in values) else values
    if not labels or len(set(labels)) < len(labels) or len({isinstance(x, str) for x in labels}) > 1:
        raise Refused(f"{name} is {values!r}, expected different numbers or texts", name)
    return Axis(tuple(labels), UNITS.get(name.split(".")[-1], ""))


def _in_units(made: Points) -> Points:
    """Return the grid with the units of numbers that are swept: a loop knows them."""
    axes = dict(made.axes)
    for name, axis in made.axes.items():
        units = {unit for one in made.scenarios if (unit := _unit(one, name))}
        if len(units) == 1:
            axes[name] = Axis(axis.values, units.pop())
    return Points(axes, made.scenarios)


def _unit(made: Scenario, name: str) -> str:
    """Return the unit of a number of a loop by its dotted name in a file; "" where it is none."""
    table, _, key = name.partition(".")
    paths = {"spread": key, "robot": f"plant.{key}"}
    with suppress(UnknownName, InvalidArgument):
        return made.find(paths.get(table, name)).unit
    return ""


def _label(value: object) -> str:
    if isinstance(value, dict):
        return " ".join(f"{key} {_label(part)}" for key, part in value.items())
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)
