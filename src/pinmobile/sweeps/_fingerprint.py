"""Description of a sweep: all that determines its numbers, the same in every process, and how two differ."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from hashlib import sha256
from importlib.metadata import version as installed
from platform import machine
from sysconfig import get_python_version
from typing import Any

import numpy as np

import pinmobile
from pinmobile.compiled import Contents
from pinmobile.errors import InvalidArgument
from pinmobile.loop import Scenario
from pinmobile.parts import is_part, parts_of, walk
from pinmobile.sweeps._points import Points

FORMAT = 4
"""Format of stores."""

_PLAIN = ("n", "seed", "dt", "substeps", "limit", "after", "stride", "metrics")
_SHOWN = 16  # numbers of an array that are stated one by one
_LONG = 100  # letters of a text that is stated as it is
_DIGEST = re.compile(r"\b[0-9a-f]{32} of ")


def describe(points: Points, version: str | None = None) -> dict[str, Any]:
    """Return all that determines the numbers of a sweep, as JSON has it.

    Parameters
    ----------
    points : Points
        Its scenarios.
    version : str, optional
        The user's word for objects whose contents are not known.

    Raises
    ------
    InvalidArgument
        If there are such objects, and no such word.
    """
    each = [_described(scenario, version) for scenario in points.scenarios]
    found: dict[str, Any] = {
        "format": FORMAT,
        "machine": machine(),
        "versions": {"python": get_python_version(), "pinmobile": pinmobile.__version__}
        | {name: installed(name) for name in ("numpy", "scipy", "pin", "llvmlite")},
        "axes": {name: {"values": axis.values, "unit": axis.unit} for name, axis in points.axes.items()},
    }
    for name in sorted(set().union(*each)):
        values = [one.get(name) for one in each]
        common = all(json.dumps(value) == json.dumps(values[0]) for value in values)
        found.setdefault("all" if common else "each", {})[name] = values[0] if common else values
    if version is not None:
        found["version"] = version
    same: dict[str, Any] = json.loads(json.dumps(found))  # as a store has it
    return same


def _described(scenario: Scenario, version: str | None) -> dict[str, Any]:
    """Return what determines the numbers of a scenario, by path.

    All that robots see of a trajectory without spread is its reference, so that may stand for its contents.
    """
    found = {name: _form(getattr(scenario, name))[0] for name in _PLAIN}
    found |= {"duration": float(scenario.t[-1]), "reference": _form(np.hstack(scenario.reference))[0]}
    for path, value in _contents(scenario):
        found[path], unknown = _form(value)
        if unknown and version is None and (scenario.has_own_references or not path.startswith("trajectory")):
            raise InvalidArgument(
                f"{path} has {unknown}, whose contents a store cannot recognise, expected numbers, arrays, "
                'functions or objects with attributes, or sweep(..., version="1"), a word that you change '
                "whenever it changes"
            )
    return found


def _contents(scenario: Scenario) -> Iterator[tuple[str, Any]]:
    """Yield classes and fields of the loop and of the spread, by path."""
    for path, part in parts_of(scenario.given):
        yield path or "loop", type(part)
    for leaf in walk(scenario.given):
        yield leaf.path, leaf.value
    for name, source in sorted(scenario.spread.items()):
        for leaf in walk(source) if is_part(source) else ():
            yield f"spread.{name}.{leaf.path}", leaf.value
        yield f"spread.{name}", type(source) if is_part(source) else source


def _form(value: Any) -> tuple[Any, str]:
    """Return a value as JSON has it, of many numbers and of code a digest; and what of it is unknown."""
    if value is None or type(value) in (bool, int, str) or (type(value) is float and np.isfinite(value)):
        return value, ""
    if type(value) is np.ndarray and value.dtype.kind in "biuf" and 0 < value.size <= _SHOWN:
        return f"{value.dtype} {value.tolist()}", ""
    text, unknown = Contents.of_value(value)
    digest = sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:32]
    return text if len(text) <= _LONG else f"{digest} of a {type(value).__name__}", unknown


def differences(theirs: Mapping[str, Any], mine: Mapping[str, Any], most: int = 3) -> str:
    """Return in words how two descriptions differ, axes first, versions and digests last; "" if equal."""
    there, here = _flat(theirs), _flat(mine)
    pairs = {name: (there.get(name, "absent"), here.get(name, "absent")) for name in here | there}
    differ = [(name, *pair) for name, pair in pairs.items() if json.dumps(pair[0]) != json.dumps(pair[1])]
    differ.sort(key=_rank)
    words = [f"{name} is {_short(one)} there and {_short(other)} here" for name, one, other in differ]
    return "; ".join(words[:most]) + (f"; and {len(words) - most} more differ" if len(words) > most else "")


def _flat(description: Mapping[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {f"axis {name}": axis["values"] for name, axis in description["axes"].items()}
    found |= {f"unit of {name}": axis["unit"] for name, axis in description["axes"].items()}
    found |= {f"version of {name}": value for name, value in description["versions"].items()}
    inner = {"axes", "versions", "all", "each"}
    found |= {name: value for name, value in description.items() if name not in inner}
    return {**found, **description.get("all", {}), **description.get("each", {})}


def _rank(difference: tuple[str, Any, Any]) -> int:
    """Return the order in which a difference is stated: those that a reader recognises come first."""
    name, *values = difference
    if name.startswith(("version of ", "format", "machine")):
        return 3
    return (
        0 if name.startswith("axis ") else 1 + any(_DIGEST.search(str(value)) is not None for value in values)
    )


def _short(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
