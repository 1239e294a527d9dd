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
from pinmobile.parts._fields import Child, Field, Number, Whole, declarations, is_part, is_protocol

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
    arguments = inspect.signature(make).parameters
    fields = dict(declarations(make)) if is_part_class(make) else {}
    defaults = {f.name: f.default for f in attrs.fields(make)} if attrs.has(make) else {}
    result, docs = {}, _parameter_docs(inspect.getdoc(make) or "")
    for name, arg in arguments.items():
        if f"_{name}" not in fields:
            is_rest = arg.kind is arg.VAR_KEYWORD
            default = defaults.get(name, attrs.NOTHING if arg.default is arg.empty else arg.default)
            is_required = arg.default is arg.empty and arg.kind is not arg.VAR_POSITIONAL
            field = fields.get(name)
            doc = docs.get(name, "") if field is None else field.doc
            is_many = arg.kind is arg.VAR_POSITIONAL
            is_needed = is_required and not is_rest
            result["**" if is_rest else name] = Parameter(name, field, default, is_needed, is_many, doc)
    return result


def _parameter_docs(text: str) -> dict[str, str]:
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
        value = public_names().get(first)
    else:
        value = None if first[:1] == "_" else getattr(library, first)
    for word in rest:
        value = _member(value, word)
    if bracket:
        value = value.get(key.strip("]'\"")) if isinstance(value, Mapping) else None
    return None if isinstance(value, ModuleType) else value


def _member(owner: Any, name: str) -> Any:
    if isinstance(owner, ModuleType):
        return getattr(owner, name) if name in vars(owner).get("__all__", ()) else None
    member = getattr(owner, name) if is_part_class(owner) and name[:1] != "_" and name in dir(owner) else None
    return member if makes_part(member) else None


def makes_part(function: Any) -> bool:
    """Return whether a file may call a function or method: its annotation says that it returns a part."""
    plain = function.__func__ if inspect.ismethod(function) else function
    if not isinstance(plain, FunctionType):
        return False
    result = str(inspect.signature(plain).return_annotation).strip("'")
    return result == "Self" or attrs.has(plain.__globals__.get(result, object))


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
        value = previous = sys.modules.get(module)
        spec = spec_from_file_location(module, file) if file.is_file() else None
        if spec is None or spec.loader is None:
            value = import_module(module)
        elif value is None or value.__file__ != str(file):
            value = sys.modules[module] = module_from_spec(spec)
            try:
                spec.loader.exec_module(value)
            except BaseException:  # remove the incomplete module, and restore the previous one
                sys.modules.pop(module)
                sys.modules |= {} if previous is None else {module: previous}
                raise
        for word in name.split("."):
            value = getattr(value, word)
    except Exception as error:
        frames = [frame for frame in extract_tb(error.__traceback__) if str(folder) in frame.filename]
        place = f" at {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
        message = f"{type(error).__name__}: {error}"
        raise InvalidArgument(f"is {module}:{name}, which fails{place}: {message}") from error
    return value


_PACKAGES = (
    *("controllers", "dh", "forces", "identification", "integrators", "loop"),
    *("paths", "reaching", "robot", "trajectories", "wheels"),
)


@cache
def public_names() -> dict[str, Any]:
    """Return the public names of the top level and of the packages of parts, with their objects."""
    library = import_module("pinmobile")
    objects = {name: getattr(library, name) for name in library.__all__}
    for package in map(import_module, (f"pinmobile.{name}" for name in _PACKAGES)):
        names = vars(package).get("__all__") or [
            name
            for name, value in vars(package).items()
            if name[:1] != "_" and getattr(value, "__module__", "") == package.__name__
        ]
        objects |= {name: value for name in names if _is_usable(value := getattr(package, name))}
    return objects


def _is_usable(value: object) -> bool:
    """Return whether a file may name an object: a class of parts, a part or a function."""
    return is_part_class(value) or is_part(value) or isinstance(value, FunctionType)


@cache
def names_of(kind: Any) -> tuple[str, ...]:
    """Return the public names of the parts of a kind."""
    return tuple(name for name, value in public_names().items() if _is_usable(value) and fits(kind, value))


def fits(kind: Any, value: Any) -> bool:
    """Return whether a class has the members of a kind, or an object is of a kind."""
    if isinstance(kind, tuple):
        return any(fits(kind_part, value) for kind_part in kind)
    if not is_protocol(kind):
        return issubclass(value, kind) if isinstance(value, type) else isinstance(value, kind)
    fields = dict(declarations(value)) if is_part_class(value) else {}
    return all(name in fields or _is_like(name, kind, value) for name in members(kind))


def _is_like(name: str, kind: Any, value: Any) -> bool:
    """Return whether an object has a member of a protocol.

    A call must have the same number of arguments and the same first argument.
    """
    member = getattr(value, name) if name in dir(value) else None
    if name != "__call__" or member is None:
        return member is not None
    if isinstance(value, type) and "__call__" not in dir(value):
        return False
    required, offered = (
        [word for word in inspect.signature(call).parameters.values() if word.name != "self"]
        for call in (kind.__call__, vars(value).get("__call__", member) if isinstance(value, type) else value)
    )
    if [word.kind for word in offered] == [inspect.Parameter.VAR_POSITIONAL]:
        return True  # a wrapper of laws of any kind, such as `Sampled`
    return len(required) == len(offered) and required[0].name == offered[0].name


def suggest_name(name: str, names: Iterable[str]) -> str:
    """Return a question that suggests the nearest name, or a list of all names."""
    plain = {word.lower().replace("_", ""): word for word in names}
    matches = get_close_matches(name[:100].lower().replace("-", "").replace("_", ""), plain, n=1)
    return f"did you mean {plain[matches[0]]!r}?" if matches else f"available: {format_names(names)}"


@cache
def _constants() -> dict[int, str]:
    return {id(value): name for name, value in public_names().items() if not isinstance(value, type)}


def name_of(value: Any) -> str:
    """Return the public name of a class, a function or a constant, "" if there is none."""
    if not isinstance(value, type):
        code_name = f"{value.__module__}:{value.__qualname__}" if isinstance(value, FunctionType) else ""
        return str(_constants().get(id(value), code_name if is_code(code_name) else ""))
    if resolve(value.__name__) is value:
        return str(value.__name__)
    package = ".".join(value.__module__.split(".")[1:2])
    dotted = f"{package}.{value.__name__}"
    return dotted if resolve(dotted) is value else f"{value.__module__}:{value.__qualname__}"


_NO_TEXT = SyntaxError, ValueError, RecursionError, MemoryError, InvalidArgument
_CALL = re.compile(r"([^\W\d][\w.]*:[^\W\d][\w.]*)\s*(\(.*\))", re.DOTALL)


def requirement(field: Field | None, *, one: bool = False) -> str:
    """Return the expected value of a field as text, such as ``"a number > 0 [kg]"``.

    The argument `one` selects the text about one part of a field with several parts.
    """
    if isinstance(field, Number):
        shapes = " or ".join(str(shape).replace("'", "") for shape in field.shapes if shape)
        words = f"numbers of shape {shapes}" if shapes else "a number"
        if shapes and () in field.shapes:
            words = f"a number, or {words}"
        units = "" if callable(field.unit) else ", ".join(x or "-" for x in field.unit.split(", "))
        unit = f"[{units}]" if units.strip("-") else ""
        return " ".join(filter(None, [words, field.bound, unit]))
    if isinstance(field, Whole):
        return f"a whole number >= {field.least}"
    if isinstance(field, Child):
        part_words = field.expected or ("" if isinstance(field.kind, tuple) else meaning(field.kind))
        part_words = part_words.partition(":")[0] or "a part"
        return f"several, each {part_words}" if field.many and not one else part_words
    return "a value"


def read_call(text: str) -> dict[str, Any]:
    """Return the tree of a part from text in Python's notation, ``"PD(kp=120)"``, or from a bare name.

    The text is parsed, never evaluated.
    """
    try:
        return _parse(text)
    except _NO_TEXT:
        return {"type": text}


def _parse(text: str) -> dict[str, Any]:
    code = _CALL.fullmatch(text.strip())
    node = ast.parse(f"_{code[2]}" if code else text.strip(), mode="eval").body
    if not isinstance(node, ast.Call):
        return {"type": text}
    tree = _call(node)
    return tree | {"type": code[1]} if code else tree


def syntax_problem(text: str) -> str:
    """Return why a text with a bracket is no part in Python's notation, or nothing."""
    try:
        if "(" in text:
            _parse(text)
    except SyntaxError as error:
        return f"which cannot be read: {error.msg}"
    except _NO_TEXT as error:
        return f"which cannot be read: {error}"
    return ""


def read_list(text: str) -> Any:
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
    values = [*first, *map(_value, node.args)]
    if takes and takes[min(len(values), len(takes)) - 1 : len(values)] and len(values) > len(takes):
        values = [*values[: len(takes) - 1], values[len(takes) - 1 :]]
    names = [*takes, *(f"argument {k + 1}" for k in range(len(takes), len(values)))]
    keywords = {str(keyword.arg): _value(keyword.value) for keyword in node.keywords}
    return {"type": name, **dict(zip(names, values, strict=False)), **keywords}


def _value(node: ast.AST) -> Any:
    match node:
        case ast.Call():
            return _call(node)
        case ast.List() | ast.Tuple():
            return [_value(item) for item in node.elts]
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
    node: Any = tree
    *keys, last = path.split(".")
    for key in keys:
        child = _entry(node, key)
        if isinstance(child, str):
            child = read_call(child)
        elif isinstance(child, list) and not any(isinstance(item, Mapping | str) for item in child):
            child = {"": child}
        elif isinstance(child, list):
            child = [read_call(item) if isinstance(item, str) else item for item in child]
        elif not isinstance(child, dict):
            child = {} if child is None else {"": child}
        _set_entry(node, key, child)
        node = child
    _set_entry(node, last, value)


def _entry(node: Any, key: str) -> Any:
    if isinstance(node, list):
        index = _index(node, key)
        return None if index is None else node[index]
    return node.get(key)


def _set_entry(node: Any, key: str, value: Any) -> None:
    if isinstance(node, list):
        index = _index(node, key)
        if index is None:
            raise InvalidArgument(f"there is no entry {key!r} among {len(node)}", key)
        node[index] = value
    else:
        node[key] = value


def _index(items: list[Any], key: str) -> int | None:
    names = [str(x.get("name", k)) if isinstance(x, Mapping) else str(k) for k, x in enumerate(items)]
    if key in names:
        return names.index(key)
    return int(key) if key.isdigit() and int(key) < len(items) else None


def make_tree(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values by path as a tree."""
    tree: dict[str, Any] = {}
    for path, value in values.items():
        put(tree, path, value)
    return tree


def flatten(tree: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the values of nested tables by path; tables with a type are values."""
    values: dict[str, Any] = {}
    for key, value in tree.items():
        is_table = isinstance(value, Mapping) and "type" not in value
        values |= flatten(value, f"{prefix}{key}.") if is_table else {f"{prefix}{key}": value}
    return values
