"""What determines the numbers of a scenario, in words that are the same in every process.

Of a trajectory that is the sampled reference, which is all that the robots see of it, and where a parameter
of it is spread, all that it is made of.
"""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from pinmobile.ensembles import Scenario
from pinmobile.ensembles.ways import way_of
from pinmobile.errors import InvalidArgument
from pinmobile.sweeps.functions import known_name
from pinmobile.sweeps.values import Described, array_of

__all__ = ["described", "flat"]

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
