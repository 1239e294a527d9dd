"""From words to what differs between the robots of an ensemble."""

from collections.abc import Mapping, Sequence
from typing import Any

from pinmobile import InvalidArgument, Normal, Same, Scenario, Uniform, UnknownName
from pinmobile.cli import choices
from pinmobile.ensembles import PARAMETERS
from pinmobile.ensembles.names import GROUPS, resolved, with_spread_forces
from pinmobile.plant import Parameter

__all__ = ["SPREAD_FORMS", "listed", "loop_of", "scenario", "spread_of_words", "without_model"]

SPREAD_FORMS = "uniform:LOW,HIGH normal:MEAN,STD percent:P (of the nominal) same:NAME[,FACTOR] or a number"
_KINDS = ("uniform", "normal", "percent", "same")


def listed() -> str:
    """Return the names of all that may be spread, by what has them, with their units."""
    return "\n".join(f"{title}: {_with_units(group)}" for title, group in GROUPS.items())


def _with_units(parameters: Sequence[Parameter]) -> str:
    """Return names, the unit told once for those that follow each other."""
    words = []
    for each, following in zip(parameters, (*parameters[1:], None), strict=True):
        last = following is None or following.unit != each.unit
        words.append(f"{each.name} ({each.unit})" if last and each.unit else each.name)
    return ", ".join(words)


def spread_of_words(words: Sequence[str]) -> dict[str, Any]:
    """Return what ``name=kind:numbers`` stands for, in the form of a scenario file.

    Raises
    ------
    InvalidArgument
        If the words are something else.
    """
    found: dict[str, Any] = {}
    for word in words:
        name, equals, rest = word.partition("=")
        kind, colon, numbers = rest.partition(":")
        if not equals or not rest or (colon and not numbers):
            raise InvalidArgument(f"--spread is {word!r}, expected NAME=FORM with the form {SPREAD_FORMS}")
        if name in found:
            times = sum(other.partition("=")[0] == name for other in words)
            raise InvalidArgument(f"--spread {name} is given {times} times, expected once")
        if not colon:
            found[name] = choices.numbers(f"--spread {name}", kind)
        elif kind == "same":
            other, _, factor = numbers.partition(",")
            found[name] = {"same": other} | (
                {"factor": choices.numbers(f"--spread {name}", factor)} if factor else {}
            )
        else:
            values = choices.point(f"--spread {name}", numbers)
            found[name] = {kind: values[0] if len(values) == 1 else list(values)}
    return found


def loop_of(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a `Scenario` that options of `run` stand for.

    Raises
    ------
    InvalidArgument, UnknownName
        If something is not what is expected.
    """
    plant, law, trajectory, settings = choices.closed_loop(**options)
    return {"robot": plant, "controller": law, "trajectory": trajectory, **settings}


def scenario(
    loop: Mapping[str, Any],
    spread: Mapping[str, Any],
    *,
    n: Any,
    seed: Any,
    after: Any = 0.0,
    lacks: dict[str, UnknownName] | None = None,
) -> Scenario:
    """Return the scenario of a loop and a spread in words.

    Parameters
    ----------
    loop : mapping
        Arguments of `Scenario`.
    spread : mapping
        By parameter a number, a list, or a table such as ``{uniform = [20, 40]}``.
    n, seed : int
        Robots, and the seed of what is drawn.
    after : float
        Time from which on errors count [s].
    lacks : dict of str to UnknownName, optional
        Where several loops share a spread: takes the names that this one does not have, which are left out.

    Raises
    ------
    InvalidArgument, UnknownName
        If something is not what is expected.
    """
    forces = with_spread_forces(loop.get("forces", ()), spread)
    bare = Scenario(**{**loop, "forces": forces}, n=1, spread={})
    own = [name for name in bare.known if "." not in name and name not in PARAMETERS]
    left, lacking = {}, {}
    for name, value in spread.items():
        if name in bare.known:
            resolved(name, bare.known)  # of one part alone
            left[name] = value
        elif lacks is None and name.startswith("model_") and name in PARAMETERS:
            law = type(loop["controller"]).__name__
            raise InvalidArgument(f"--spread {name} does not apply: {law} believes in no model")
        else:
            lacking[name] = UnknownName("parameter in spread", name, [*own, *PARAMETERS])
            if lacks is None:
                raise lacking[name]
    for name, value in left.items():
        other = value.get("same") if isinstance(value, Mapping) else None
        if isinstance(other, str) and other not in bare.known:
            kind = f"parameter in spread[{name!r}]"
            raise lacking.get(other, UnknownName(kind, other, [*own, *PARAMETERS]))
    if lacks is not None:
        lacks |= lacking
    sources = {name: _source(name, value, bare.nominal.get(name, 0.0)) for name, value in left.items()}
    return Scenario(**loop, n=n, seed=seed, after=after, spread=sources)


def without_model(
    options: Mapping[str, Any], spread: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return options and spread without what computed torque alone believes, for PD beside it."""
    kept = {name: value for name, value in spread.items() if not name.startswith("model_")}
    return {**options, **dict.fromkeys(choices.BELIEVED)}, kept


def _source(name: str, value: Any, nominal: float) -> Any:
    if not isinstance(value, Mapping):
        return value
    kinds = [kind for kind in value if kind != "factor"]
    if len(kinds) != 1:
        raise InvalidArgument(f"--spread {name} is {dict(value)!r}, expected one of {', '.join(_KINDS)}")
    kind = kinds[0]
    if kind not in _KINDS:
        raise UnknownName(f"form in the spread of {name}", kind, _KINDS)
    if kind == "same":
        factor = value.get("factor", 1.0)
        return Same(str(value["same"]), _source(f"{name} factor", factor, 1.0))
    if "factor" in value:
        raise InvalidArgument(f"--spread {name} has a factor beside {kind}, expected one beside same alone")
    if kind == "percent":
        return _around(name, value["percent"], nominal)
    numbers = value[kind]
    if not isinstance(numbers, list) or len(numbers) != 2:
        raise InvalidArgument(f"--spread {name} is {kind} of {numbers!r}, expected two numbers")
    try:
        return Uniform(*numbers) if kind == "uniform" else Normal(*numbers)
    except InvalidArgument as error:
        raise InvalidArgument(f"--spread {name}: {error}") from error


def _around(name: str, percent: Any, nominal: float) -> Uniform:
    if not isinstance(percent, int | float) or not percent >= 0:
        raise InvalidArgument(f"--spread {name} is percent of {percent!r}, expected a number >= 0")
    if nominal == 0:
        raise InvalidArgument(f"--spread {name} is {percent:g} percent of 0, expected uniform or normal")
    share = percent / 100
    low, high = sorted((nominal * (1 - share), nominal * (1 + share)))
    return Uniform(low, high)
