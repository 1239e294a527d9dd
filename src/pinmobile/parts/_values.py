"""Trees of plain values: what text as in Python stands for, and values at paths; and fields in words."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Mapping
from typing import Any

from pinmobile.errors import InvalidArgument
from pinmobile.parts._capabilities import meaning
from pinmobile.parts._fields import Child, Field, Number, Whole
from pinmobile.parts._registry import parameters, resolve

_NO_TEXT = SyntaxError, ValueError, RecursionError, MemoryError, InvalidArgument
_CALL = re.compile(r"([^\W\d][\w.]*:[^\W\d][\w.]*)\s*(\(.*\))", re.DOTALL)


def expected(declared: Field | None, *, one: bool = False) -> str:
    """Return in words what a field takes, such as ``"a number > 0 [kg]"``; `one` of several parts."""
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
    """Return the tree of a part that is written as in Python, ``"PD(kp=120)"``, or of a bare name.

    The text is parsed, never evaluated.
    """
    code = _CALL.fullmatch(text.strip())
    try:
        node = ast.parse(f"_{code[2]}" if code else text.strip(), mode="eval").body
        if isinstance(node, ast.Call):
            found = _call(node)
            return found | {"type": code[1]} if code else found
    except _NO_TEXT:
        pass
    return {"type": text}


def listed(text: str) -> Any:
    """Return the list of a text as in Python, with parts such as ``"[PD(9, 9), PID()]"``; else the text."""
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
    return ast.literal_eval(node)


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
    """Return the values of nested tables by path, as TOML nests dots; tables with a type are values."""
    found: dict[str, Any] = {}
    for key, value in tree.items():
        is_table = isinstance(value, Mapping) and "type" not in value
        found |= flat(value, f"{prefix}{key}.") if is_table else {f"{prefix}{key}": value}
    return found
