"""What determines the numbers of a scenario, in words that are the same in every process.

Of a trajectory that is the sampled reference, which is all that the robots see of it, and where a parameter
of it is spread, all that it is made of.
"""

import json
import re
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from platform import machine
from typing import Any

import numpy as np

from pinmobile.ensembles import Scenario, way_of
from pinmobile.errors import InvalidArgument
from pinmobile.sweeps.describe import Described, array_of, known_name
from pinmobile.sweeps.grids import Grid

# All that a scenario is made of; of these two, what came of them is told.
_PLAIN = tuple(
    each.name for each in fields(Scenario) if each.init and each.name not in ("trajectory", "duration")
)


def described(scenario: Scenario) -> dict[str, Any]:
    """Return what determines the numbers of a scenario, as JSON can hold it, by dotted names.

    Raises
    ------
    InvalidArgument
        If there is something whose description would not be the same the next time.
    """
    given = {name: getattr(scenario, name) for name in _PLAIN}
    given |= {"forces": list(given["forces"]), "spread": dict(sorted(given["spread"].items()))}
    made = Described()
    found = {name: made.of(name, value) for name, value in given.items()}
    found["duration"] = float(scenario.t[-1])
    found["engine"] = repr(way_of(scenario).engine)
    found["times"] = array_of("t", scenario.t)
    found["trajectory"] = {
        "type": type(scenario.trajectory).__qualname__,
        **_fields_of_ours(scenario.trajectory),
        "reference": array_of("reference", np.hstack(scenario.reference)),
    }
    if scenario.has_own_references:  # of others than this it gives the references, too
        found["trajectory"]["made of"] = made.of("trajectory", scenario.trajectory)
    return flat(found)


def flat(tree: Any, prefix: str = "") -> dict[str, Any]:
    """Return the leaves of a tree of mappings by their dotted names."""
    if not isinstance(tree, Mapping) or not tree:
        return {prefix: tree}
    found: dict[str, Any] = {}
    for name, value in tree.items():
        joint = "." if prefix and not name.startswith("[") else ""
        found |= flat(value, f"{prefix}{joint}{name}")
    return found


def _fields_of_ours(value: Any) -> dict[str, Any]:
    """Return the fields of a trajectory, for the reader; its reference is what counts."""
    if not is_dataclass(value) or not known_name(type(value)):
        return {}
    try:
        return dict(Described().of("trajectory", value))
    except InvalidArgument:
        return {}


_FORMAT = 2


def determined_by(grid: Grid) -> dict[str, Any]:
    """Return all that determines the numbers of a sweep, with its fingerprint.

    Raises
    ------
    InvalidArgument
        If a scenario holds what cannot be recognised the next time.
    """
    each = [described(scenario) for scenario in grid.scenarios]
    # What all have is told once, for whoever reads it.
    names = sorted({name for one in each for name in one})
    common = {
        name: each[0][name] for name in names if all(_has(one, name, each[0].get(name)) for one in each)
    }
    found: dict[str, Any] = {
        "format": _FORMAT,
        "machine": machine(),
        "versions": {name: _version(name) for name in ("pinmobile", "numpy", "scipy", "pin", "llvmlite")},
        "axes": {name: {"values": list(axis.values), "unit": axis.unit} for name, axis in grid.axes.items()},
        "all": common,
        "each": {name: [one.get(name) for one in each] for name in names if name not in common},
    }
    return {**found, "fingerprint": _fingerprint(found)}


def _has(one: Mapping[str, Any], name: str, value: Any) -> bool:
    return name in one and _text(one[name]) == _text(value)


def _text(value: Any) -> str:
    """Return a value as JSON, which tells 1 from 1.0 and from true."""
    return json.dumps(value, sort_keys=True)


def _version(name: str) -> str:
    if name == "pinmobile":
        import pinmobile

        return pinmobile.__version__
    try:
        return version(name)
    except PackageNotFoundError:
        return "missing"


def _fingerprint(description: Any) -> str:
    """Return the digest of a description."""
    return sha256(json.dumps(description, sort_keys=True).encode()).hexdigest()


def differences(theirs: Mapping[str, Any], mine: Mapping[str, Any], most: int = 3) -> str:
    """Return in words how two descriptions differ; "" where they do not.

    What a reader knows comes first: the axes, then the fields of scenarios, then versions. Digests are told
    where nothing else differs.

    Parameters
    ----------
    theirs, mine : mapping
        Of the store, and of what is to be run; in ``all`` and ``each`` what scenarios share and do not.
    most : int
        How many differences are told.
    """
    absent = "absent"
    there, here = _comparable(theirs), _comparable(mine)
    names = [name for name in {**here, **there} if _differ(name, there, here)]
    values = {name: (there.get(name, absent), here.get(name, absent)) for name in names}
    readable = [name for name in names if not any(map(_is_digest, values[name]))] or names
    shown = sorted(readable, key=_rank)
    words = [
        f"{_told(name)} is {_short(values[name][0])} there and {_short(values[name][1])} here"
        for name in shown[:most]
    ]
    return "; ".join(words) + (f"; and {len(shown) - most} more differ" if len(shown) > most else "")


def _differ(name: str, there: Mapping[str, Any], here: Mapping[str, Any]) -> bool:
    if name not in there or name not in here:
        return True
    if name.startswith("axes."):  # a scenario tells what is made of a value
        return bool(there[name] != here[name])
    return _text(there[name]) != _text(here[name])


def _comparable(description: Mapping[str, Any]) -> dict[str, Any]:
    found = {name: value for name, value in description.items() if name not in ("all", "each", "fingerprint")}
    return {**flat(found), **description.get("all", {}), **description.get("each", {})}


def _rank(name: str) -> int:
    if name.startswith("axes."):
        return 0
    return 2 if name in ("format", "machine", "engine") or name.startswith("versions.") else 1


def _told(name: str) -> str:
    """Return the name of an axis as its user gave it, and of anything else as it is."""
    found = re.fullmatch(r"axes\.(.+)\.(values|unit)", name)
    if found is None:
        return name
    return f"axis {found[1]}" if found[2] == "values" else f"unit of axis {found[1]}"


def _is_digest(value: Any) -> bool:
    if isinstance(value, list):
        return any(map(_is_digest, value))
    return isinstance(value, str) and re.search(r"\) [0-9a-f]{32}$", value) is not None


def _short(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
