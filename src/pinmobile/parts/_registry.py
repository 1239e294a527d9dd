"""Public names in files and commands: parts, their arguments and constants; values from text."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import math
import re
import sys
from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from functools import cache
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from traceback import extract_tb
from types import FunctionType, ModuleType
from typing import Any, NamedTuple

import attrs

from pinmobile.errors import InvalidArgument, format_names
from pinmobile.parts._capabilities import meaning, members
from pinmobile.parts._fields import Child, Field, Number, Whole, declared_by, is_part, is_protocol

_CODE = re.compile(r"[^\W\d][\w.]*:[^\W\d][\w.]*")


class Parameter(NamedTuple):
    """Argument of a class or function that makes a part.

    Attributes
    ----------
    name : str
        Name in files.
    declared : Field or None
        Declaration of the field, if the argument is a field of the part.
    default : any
        Default, `attrs.NOTHING` if there is none.
    is_required : bool
        Whether the argument is required.
    is_variadic : bool
        Whether the argument takes all further values.
    doc : str
        Meaning as a noun phrase.
    """

    name: str
    declared: Field | None
    default: Any
    is_required: bool
    is_variadic: bool
    doc: str = ""

    @property
    def is_shared(self) -> bool:
        """Whether the file's robot, or a part of the robot, is the default."""
        return self.is_required and (self.name == "robot" or isinstance(self.declared, Child))


@cache
def parameters(make: Any) -> dict[str, Parameter]:
    """Return the arguments of a class or function by name; "**" stands for further named arguments."""
    known = inspect.signature(make).parameters
    fields = dict(declared_by(make)) if is_part_class(make) else {}
    given = {f.name: f.default for f in attrs.fields(make)} if attrs.has(make) else {}
    found, told = {}, _documented(inspect.getdoc(make) or "")
    for name, each in known.items():
        if f"_{name}" not in fields:
            is_rest = each.kind is each.VAR_KEYWORD
            default = given.get(name, attrs.NOTHING if each.default is each.empty else each.default)
            is_required = each.default is each.empty and each.kind is not each.VAR_POSITIONAL
            declared = fields.get(name)
            doc = told.get(name, "") if declared is None else declared.doc
            many = each.kind is each.VAR_POSITIONAL
            required = is_required and not is_rest
            found["**" if is_rest else name] = Parameter(name, declared, default, required, many, doc)
    return found


def _documented(text: str) -> dict[str, str]:
    """Return the first sentence about each parameter in a docstring."""
    rows = re.findall(r"^(\*\*\w+|\**\w+(?:, \**\w+)*(?= : ))(?: : .*)?\n((?: +.*\n?)+)", text, re.MULTILINE)
    return {
        name: re.split(r"[.;] ", f"{' '.join(meaning.split())} ")[0].rstrip(" .")
        for names, meaning in rows
        for name in names.replace("*", "").split(", ")
    }


def is_part_class(value: object) -> bool:
    """Return whether a value is a class of parts."""
    return isinstance(value, type) and (attrs.has(value) or dataclasses.is_dataclass(value))


def is_code(name: str) -> bool:
    """Return whether a text names an object in a user's module, "module:Name"."""
    return _CODE.fullmatch(name) is not None


def resolve(name: str, folder: Path | None = None) -> Any:
    """Return the object of a public name: a class of parts, a constructor or a constant; else None.

    Parameters
    ----------
    name : str
        Name such as ``"PD"``, ``"WheelTable.differential"``, ``"wheels.MOTORS['faulhaber_1331t012sr']"``, or
        in a user's module ``"module:Name"``.
    folder : Path, optional
        Folder of users' modules; None: they must not run.

    Raises
    ------
    InvalidArgument
        If the name is code that must not run, or that fails.
    """
    if is_code(name):
        return _code(name, folder)
    path, bracket, key = name.partition("[")
    first, *rest = path.split(".")
    library = import_module("pinmobile")
    if first in library.__all__ or first not in dir(library):
        found = public().get(first)
    else:
        found = None if first[:1] == "_" else getattr(library, first)
    for word in rest:
        found = _member(found, word)
    if bracket:
        found = found.get(key.strip("]'\"")) if isinstance(found, Mapping) else None
    return None if isinstance(found, ModuleType) else found


def _member(owner: Any, name: str) -> Any:
    if isinstance(owner, ModuleType):
        return getattr(owner, name) if name in vars(owner).get("__all__", ()) else None
    made = getattr(owner, name) if is_part_class(owner) and name[:1] != "_" and name in dir(owner) else None
    return made if makes_part(made) else None


def makes_part(function: Any) -> bool:
    """Return whether a file may call a function or method: its annotation says that it returns a part."""
    plain = function.__func__ if inspect.ismethod(function) else function
    if not isinstance(plain, FunctionType):
        return False
    returned = str(inspect.signature(plain).return_annotation).strip("'")
    return returned == "Self" or attrs.has(plain.__globals__.get(returned, object))


def _code(text: str, folder: Path | None) -> Any:
    """Return an object of a module in the folder, or of an installed module."""
    module, _, name = text.partition(":")
    if folder is None:
        raise InvalidArgument(
            f"is {text!r}, code of the module {module!r}, which runs only with --allow-code: "
            "check that module first"
        )
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    file = folder.joinpath(*module.split(".")).with_suffix(".py")
    try:
        loaded = before = sys.modules.get(module)
        spec = spec_from_file_location(module, file) if file.is_file() else None
        if spec is None or spec.loader is None:
            loaded = import_module(module)
        elif loaded is None or loaded.__file__ != str(file):
            loaded = sys.modules[module] = module_from_spec(spec)
            try:
                spec.loader.exec_module(loaded)
            except BaseException:  # remove the incomplete module, and restore the previous one
                sys.modules.pop(module)
                sys.modules |= {} if before is None else {module: before}
                raise
        for word in name.split("."):
            loaded = getattr(loaded, word)
    except Exception as error:
        own = [each for each in extract_tb(error.__traceback__) if str(folder) in each.filename]
        place = f" at {Path(own[-1].filename).name}:{own[-1].lineno}" if own else ""
        told = f"{type(error).__name__}: {error}"
        raise InvalidArgument(f"is {module}:{name}, which fails{place}: {told}") from error
    return loaded


_PACKAGES = [
    "controllers",
    "dh",
    "forces",
    "identification",
    "integrators",
    "loop",
    "paths",
    "reaching",
    "robot",
    "trajectories",
    "wheels",
]


@cache
def public() -> dict[str, Any]:
    """Return the public names of the top level and of the packages of parts, with their objects."""
    library = import_module("pinmobile")
    found = {name: getattr(library, name) for name in library.__all__}
    for package in map(import_module, (f"pinmobile.{name}" for name in _PACKAGES)):
        names = vars(package).get("__all__") or [
            name
            for name, one in vars(package).items()
            if name[:1] != "_" and getattr(one, "__module__", "") == package.__name__
        ]
        found |= {name: one for name in names if _is_usable(one := getattr(package, name))}
    return found


def _is_usable(one: object) -> bool:
    """Return whether a file may name an object: a class of parts, a part or a function."""
    return is_part_class(one) or is_part(one) or isinstance(one, FunctionType)


@cache
def names_of(kind: Any) -> tuple[str, ...]:
    """Return the public names of the parts of a kind."""
    return tuple(name for name, one in public().items() if _is_usable(one) and fits(kind, one))


def fits(kind: Any, one: Any) -> bool:
    """Return whether a class has the members of a kind, or an object is of a kind."""
    if isinstance(kind, tuple):
        return any(fits(each, one) for each in kind)
    if not is_protocol(kind):
        return issubclass(one, kind) if isinstance(one, type) else isinstance(one, kind)
    fields = dict(declared_by(one)) if is_part_class(one) else {}
    return all(name in fields or _is_like(name, kind, one) for name in members(kind))


def _is_like(name: str, kind: Any, one: Any) -> bool:
    """Return whether an object has a member of a protocol.

    A call must have the same number of arguments and the same first argument.
    """
    own = getattr(one, name) if name in dir(one) else None
    if name != "__call__" or own is None:
        return own is not None
    if isinstance(one, type) and "__call__" not in dir(one):
        return False
    asked, has = (
        [each for each in inspect.signature(call).parameters if each != "self"]
        for call in (kind.__call__, vars(one).get("__call__", own) if isinstance(one, type) else one)
    )
    return len(asked) == len(has) and asked[0] == has[0]


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a question that suggests the nearest name, or a list of all names."""
    plain = {each.lower().replace("_", ""): each for each in known}
    near = get_close_matches(name[:100].lower().replace("-", "").replace("_", ""), plain, n=1)
    return f"did you mean {plain[near[0]]!r}?" if near else f"available: {format_names(known)}"


@cache
def _constants() -> dict[int, str]:
    return {id(one): name for name, one in public().items() if not isinstance(one, type)}


def name_of(value: Any) -> str:
    """Return the public name of a class, a function or a constant, "" if there is none."""
    if not isinstance(value, type):
        own = f"{value.__module__}:{value.__qualname__}" if isinstance(value, FunctionType) else ""
        return str(_constants().get(id(value), own if is_code(own) else ""))
    if resolve(value.__name__) is value:
        return str(value.__name__)
    package = ".".join(value.__module__.split(".")[1:2])
    dotted = f"{package}.{value.__name__}"
    return dotted if resolve(dotted) is value else f"{value.__module__}:{value.__qualname__}"


_NO_TEXT = SyntaxError, ValueError, RecursionError, MemoryError, InvalidArgument
_CALL = re.compile(r"([^\W\d][\w.]*:[^\W\d][\w.]*)\s*(\(.*\))", re.DOTALL)


def expected(declared: Field | None, *, one: bool = False) -> str:
    """Return the expected value of a field as text, such as ``"a number > 0 [kg]"``.

    The argument `one` selects the text about one part of a field with several parts.
    """
    if isinstance(declared, Number):
        shapes = " or ".join(str(shape).replace("'", "") for shape in declared.shapes if shape)
        what = f"numbers of shape {shapes}" if shapes else "a number"
        if shapes and () in declared.shapes:
            what = f"a number, or {what}"
        unit = f"[{declared.unit}]" if declared.unit and not callable(declared.unit) else ""
        return " ".join(filter(None, [what, declared.bound, unit]))
    if isinstance(declared, Whole):
        return f"a whole number >= {declared.least}"
    if isinstance(declared, Child):
        known = declared.expected or ("" if isinstance(declared.kind, tuple) else meaning(declared.kind))
        known = known.partition(":")[0]
        known = known or "a part"
        return f"several, each {known}" if declared.many and not one else known
    return "a value"


def called(text: str) -> dict[str, Any]:
    """Return the tree of a part from text in Python's notation, ``"PD(kp=120)"``, or from a bare name.

    The text is parsed, never evaluated.
    """
    try:
        return _parsed(text)
    except _NO_TEXT:
        return {"type": text}


def _parsed(text: str) -> dict[str, Any]:
    code = _CALL.fullmatch(text.strip())
    node = ast.parse(f"_{code[2]}" if code else text.strip(), mode="eval").body
    if not isinstance(node, ast.Call):
        return {"type": text}
    found = _call(node)
    return found | {"type": code[1]} if code else found


def unreadable(text: str) -> str:
    """Return why a text with a bracket is no part in Python's notation, or nothing."""
    try:
        if "(" in text:
            _parsed(text)
    except SyntaxError as error:
        return f"which cannot be read: {error.msg}"
    except _NO_TEXT as error:
        return f"which cannot be read: {error}"
    return ""


def listed(text: str) -> Any:
    """Return the list of a text in Python's notation, which may contain parts; other text stays text."""
    try:
        node = ast.parse(text.strip(), mode="eval").body
        return _value(node) if isinstance(node, ast.List) else text
    except _NO_TEXT:
        return text


def _call(node: ast.Call) -> dict[str, Any]:
    function, first = node.func, []
    if isinstance(function, ast.Attribute) and isinstance(function.value, ast.Call):
        first = [_call(function.value)]
        name = f"{first[0]['type'].partition('.')[0]}.{function.attr}"
    else:
        name = ast.unparse(function)
    make = resolve(name)
    takes = list(parameters(make)) if callable(make) else []
    given = [*first, *map(_value, node.args)]
    if takes and takes[min(len(given), len(takes)) - 1 : len(given)] and len(given) > len(takes):
        given = [*given[: len(takes) - 1], given[len(takes) - 1 :]]
    names = [*takes, *(f"argument {k + 1}" for k in range(len(takes), len(given)))]
    own = {str(each.arg): _value(each.value) for each in node.keywords}
    return {"type": name, **dict(zip(names, given, strict=False)), **own}


def _value(node: ast.AST) -> Any:
    match node:
        case ast.Call():
            return _call(node)
        case ast.List() | ast.Tuple():
            return [_value(each) for each in node.elts]
        case ast.Name():
            return math.inf if node.id == "inf" else node.id
        case ast.Subscript() | ast.Attribute():
            return ast.unparse(node)
        case ast.UnaryOp(op=ast.USub(), operand=ast.Name(id="inf")):
            return -math.inf
        case ast.BinOp() | ast.UnaryOp(operand=ast.Name() | ast.BinOp()):
            return ast.unparse(node)  # text, for fields that read formulas
    try:
        return ast.literal_eval(node)
    except ValueError:
        raise InvalidArgument(f"{ast.unparse(node)} is no number, text or part") from None


def put(tree: dict[str, Any], path: str, value: Any) -> None:
    """Set the value at a path of a tree, such as ``controller.kp`` or ``robot.com.x``."""
    at: Any = tree
    *way, last = path.split(".")
    for key in way:
        below = _entry(at, key)
        if isinstance(below, str):
            below = called(below)
        elif isinstance(below, list) and not any(isinstance(each, Mapping | str) for each in below):
            below = {"": below}
        elif isinstance(below, list):
            below = [called(each) if isinstance(each, str) else each for each in below]
        elif not isinstance(below, dict):
            below = {} if below is None else {"": below}
        _set(at, key, below)
        at = below
    _set(at, last, value)


def _entry(at: Any, key: str) -> Any:
    if isinstance(at, list):
        place = _place(at, key)
        return None if place is None else at[place]
    return at.get(key)


def _set(at: Any, key: str, value: Any) -> None:
    if isinstance(at, list):
        place = _place(at, key)
        if place is None:
            raise InvalidArgument(f"there is no entry {key!r} among {len(at)}", key)
        at[place] = value
    else:
        at[key] = value


def _place(at: list[Any], key: str) -> int | None:
    names = [str(each.get("name", k)) if isinstance(each, Mapping) else str(k) for k, each in enumerate(at)]
    if key in names:
        return names.index(key)
    return int(key) if key.isdigit() and int(key) < len(at) else None


def nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values by path as a tree."""
    tree: dict[str, Any] = {}
    for path, value in values.items():
        put(tree, path, value)
    return tree


def flat(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the values of nested tables by path; tables with a type are values."""
    found: dict[str, Any] = {}
    for key, value in tree.items():
        is_table = isinstance(value, Mapping) and "type" not in value
        found |= flat(value, f"{prefix}{key}.") if is_table else {f"{prefix}{key}": value}
    return found
