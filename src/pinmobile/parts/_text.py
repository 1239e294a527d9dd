"""Trees of parts as text: TOML with meanings, the lines of wrong entries, and the JSON schema of files."""

from __future__ import annotations

import inspect
import json
import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pinmobile.arrays import distinct
from pinmobile.errors import InvalidArgument, argument_errors
from pinmobile.parts._fields import Child, Number, Values, Whole
from pinmobile.parts._registry import (
    Parameter,
    is_code,
    is_part_class,
    names_of,
    parameters,
    public_names,
    put,
    read_list,
    requirement,
    resolve,
)
from pinmobile.parts._tree import InvalidEntries, Reader

_MAX_BYTES = 1 << 20  # bytes of a file


def read_file(path: Path) -> str:
    """Return the text of a file.

    Raises
    ------
    InvalidArgument
        If the file cannot be read, or is too large.
    """
    if path.is_dir():
        words = "a scenario file; `pinmobile view` shows the run of a folder, and Sweep.open opens a sweep"
        raise InvalidArgument(f"FILE is {str(path)!r}, a folder, expected {words}")
    with argument_errors(f"FILE is {str(path)!r}, which cannot be read: ", of=(OSError, ValueError)):
        with path.open("rb") as file:
            data = file.read(_MAX_BYTES + 1)  # a special file may be endless
        if len(data) > _MAX_BYTES:
            raise InvalidArgument(f"FILE is {str(path)!r}, larger than {_MAX_BYTES >> 20} MiB, expected less")
        return data.decode("utf-8-sig").replace("\r\n", "\n")


def read_value(text: str) -> Any:
    """Return the value of text in TOML's notation, or a list in Python's notation; other text stays text."""
    try:
        return tomllib.loads(f"v = {text}")["v"] if "\n" not in text else text
    except (tomllib.TOMLDecodeError, RecursionError):
        return read_list(text)


def read_entries(
    kind: type,
    words: Sequence[str],
    *,
    name: str = "",
    text: str = "",
    folder: Path | None = None,
    unused: Sequence[str] = (),
) -> tuple[Any, Reader]:
    """Return the part of a file with changes PATH=VALUE, and its reader.

    Parameters
    ----------
    kind : type
        Class of the part.
    words : sequence of str
        Changes, such as ``"controller.kp=9"``.
    name, text : str, optional
        Name and text of the file.
    folder : Path, optional
        Folder of users' modules in the file; None: they must not run.
    unused : sequence of str, optional
        Fields that the command ignores.

    Raises
    ------
    InvalidEntries
        If entries are wrong; the message has a line for each, with the line of the file, or the word.
    """
    distinct("the command has", (word.partition("=")[0] for word in words))
    reader, sets = Reader(folder), dict(word.split("=", 1) for word in words)
    try:
        with argument_errors(f"{name}: its values are nested too deep: ", of=RecursionError):
            with argument_errors(f"{name}: ", ", expected TOML", of=tomllib.TOMLDecodeError):
                tree = tomllib.loads(text)
            for path, value in sets.items():
                with argument_errors(f"{path}={value}: ", of=(InvalidArgument, AttributeError, TypeError)):
                    put(tree, path, read_value(value))
            return reader.root(kind, {key: value for key, value in tree.items() if key not in unused}), reader
    except InvalidEntries as error:
        raise locate_errors(error, sets, name, text) from None


def locate_errors(error: InvalidEntries, sets: Mapping[str, str], name: str, text: str) -> InvalidEntries:
    """Return an error whose messages begin with the line of the file, or with the word of the command."""
    messages = {}
    for path, message in error.problems.items():
        paths = [other for other in sets if are_nested(path, other)]
        word = max(paths, key=len) if paths else ""
        place = f"{word}={sets[word]}: " if paths else f"{name}:{line_of(text, path)}: " if text else ""
        messages[path] = f"{place}{message}"
    return InvalidEntries(messages)


def are_nested(path: str, other: str) -> bool:
    """Return whether one path begins with the other."""
    return f"{path}.".startswith(f"{other}.") or f"{other}.".startswith(f"{path}.")


def line_of(text: str, path: str) -> int:
    """Return the number of the line that sets a path, or of the nearest table around it."""
    lines, keys, best, start = text.splitlines(), path.split("."), (0, 1), 1
    for n in range(1, len(lines) + 1):
        try:
            tree = tomllib.loads("\n".join(lines[:n]))
        except tomllib.TOMLDecodeError:
            continue  # a value of several lines is incomplete here
        best = max(best, (_depth(tree, keys), start), key=lambda each: each[0])
        start = n + 1
    return best[1]


def _depth(tree: Any, keys: Sequence[str]) -> int:
    for n in range(len(keys), 0, -1):
        head, rest = ".".join(keys[:n]), keys[n:]
        if isinstance(tree, list) and head.isdigit() and int(head) < len(tree):
            return n + _depth(tree[int(head)], rest)
        if isinstance(tree, Mapping) and head in tree:
            return n + _depth(tree[head], rest)
    return 0


def write_text(kind: type, tree: Mapping[str, Any]) -> str:
    """Return a tree as TOML, with meaning, unit and bound next to each number."""
    return "\n".join(_table(tree, kind, "")).lstrip("\n") + "\n"


def _table(tree: Mapping[str, Any], make: Any, path: str) -> Iterator[str]:
    """Yield the lines of a table: values first, then the tables of parts."""
    arguments = parameters(make) if callable(make) else {}
    fields = {key: arguments[key].declared if key in arguments else None for key in tree}
    tables = {key: value for key, value in tree.items() if _is_table(value, fields[key], path)}
    for key, value in tree.items():
        if key not in tables:
            comment = arguments[key].doc if key in arguments else ""
            if isinstance(fields[key], Number | Whole):
                comment = f"{comment}{comment and ': '}{requirement(fields[key])}"
            yield f"{_key(key)} = {_text(value)}{comment and f'  # {comment}'}"
    for key, value in tables.items():
        table = f"{path}.{_key(key)}" if path else _key(key)
        comment = f"  # {arguments[key].doc}" if key in arguments and arguments[key].doc else ""
        for item in value if isinstance(value, list) else [value]:
            yield f"\n[[{table}]]{comment}" if isinstance(value, list) else f"\n[{table}]{comment}"
            name = item.get("type", "")
            if name or isinstance(fields[key], Child):
                yield from _table(item, None if is_code(name) else resolve(name), table)
            else:
                yield from (f"{_key(name)} = {_text(entry)}" for name, entry in item.items())


def _is_table(value: Any, declared: Any, path: str) -> bool:
    """Return whether a value becomes one or several tables."""
    if isinstance(value, Mapping):
        return "type" in value or isinstance(declared, Child) or not path
    are_tables = isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value)
    return bool(are_tables) and isinstance(declared, Child)


def _key(key: str) -> str:
    return key if key and all(c.isascii() and (c.isalnum() or c in "-_") for c in key) else json.dumps(key)


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return repr(value) if math.isfinite(value) else str(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_text, value))}]"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(key)} = {_text(item)}" for key, item in value.items()) + "}"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return str(value)


_BOUNDS = {"above": "exclusiveMinimum", "lower": "minimum", "upper": "maximum"}


def schema_of(root: type) -> dict[str, Any]:
    """Return the JSON schema of a file: the fields of each part, with meaning, unit and bound."""
    parts = {name: cls for name, cls in public_names().items() if is_part_class(cls)}
    kinds = {
        _title(argument.declared.kind): argument.declared.kind
        for make in (root, *parts.values())
        for argument in parameters(make).values()
        if isinstance(argument.declared, Child)
    }
    choices = {f"Any{title}": _choice(kind, parts) for title, kind in kinds.items()}
    defs = {name: _object(parameters(cls), inspect.getdoc(cls)) for name, cls in parts.items()} | choices
    head = {"$schema": "http://json-schema.org/draft-07/schema#"}
    return {**head, **_object(parameters(root), inspect.getdoc(root), typed=False), "$defs": defs}


def _title(kind: Any) -> str:
    return "Or".join(map(_title, kind)) if isinstance(kind, tuple) else str(kind.__name__)


def _choice(kind: Any, parts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the schema of a part of a kind: its name, text in Python's notation, or a table with a type."""
    names = [name for name in names_of(kind) if name in parts]
    cases = [
        {
            "if": {"properties": {"type": {"const": name}}, "required": ["type"], "type": "object"},
            "then": {"$ref": f"#/$defs/{name}"},
        }
        for name in names
    ]
    free = {"pattern": "[:.(]"}
    return {
        "type": ["string", "object"],
        "properties": {"type": {"anyOf": [{"enum": names}, free]}},
        "allOf": cases,
    }


def _object(args: Mapping[str, Parameter], text: str | None, *, typed: bool = True) -> dict[str, Any]:
    type_schema = {"type": {"type": "string"}} if typed else {}
    return {
        "type": "object",
        "description": (text or "").split("\n")[0],
        "additionalProperties": False,
        "properties": type_schema | {name: _field(arg) for name, arg in args.items() if name != "**"},
        "required": [name for name, arg in args.items() if arg.is_required and not arg.is_shared],
    }


def _field(argument: Parameter) -> dict[str, Any]:
    field = argument.declared
    schema = {"description": f"{field.doc}: {requirement(field)}"} if field is not None else {}
    if isinstance(field, Whole):
        return schema | {"type": "integer", "minimum": field.least, "maximum": field.most}
    if isinstance(field, Number):
        bounds = {word: getattr(field, name) for name, word in _BOUNDS.items()}
        item = {"type": "number"} | {word: bound for word, bound in bounds.items() if bound is not None}
        if field.endless:
            item["type"] = ["number", "null"]  # infinity in JSON
        free = {"type": item["type"]}  # the bounds of a gain apply to the diagonal of its matrix
        forms = [_array(free if field.is_gain and len(shape) == 2 else item, shape) for shape in field.shapes]
        return schema | {"anyOf": [*forms, {"type": "object"}]}
    if isinstance(field, Child):
        item = {"$ref": f"#/$defs/Any{_title(field.kind)}"}
        many = {"anyOf": [{"type": "array", "items": item}, {"type": "object", "additionalProperties": item}]}
        return schema | (many if field.many else {"anyOf": [item, {"type": "object"}]})
    return schema | ({"type": "object"} if isinstance(field, Values) else {})


def _array(item: dict[str, Any], shape: tuple[int | str, ...]) -> dict[str, Any]:
    for size in reversed(shape):
        fixed = {"minItems": size, "maxItems": size} if isinstance(size, int) else {}
        item = {"type": "array", "items": item} | fixed
    return item
