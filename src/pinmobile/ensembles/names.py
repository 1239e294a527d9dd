"""What a spread may name: the parameters that the parts of a loop state, and those of its start."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import MethodType
from typing import Any, NamedTuple

from pinmobile import forces, paths, trajectories
from pinmobile.compiled import Parts, children_at
from pinmobile.controllers import GAINS
from pinmobile.errors import InvalidArgument, UnknownName
from pinmobile.plant import Coordinate, Parameter, parameters_of
from pinmobile.robot import BODY_PARAMETERS, PlanarBody


def _stating(package: Any) -> tuple[Any, ...]:
    """Return the kinds of parts of a package that state parameters."""
    return tuple(kind for kind in map(vars(package).get, package.__all__) if hasattr(kind, "parameters"))


_FORCES = _stating(forces)


_FORCE_OF = {each.name: kind for kind in reversed(_FORCES) for each in parameters_of(kind)}


class Stated(NamedTuple):
    """A parameter, and the part that states it.

    Attributes
    ----------
    path : str
        Where the part stands, such as ``"controller.robot"``; ``""`` of the start.
    parameter : Parameter
        The parameter, under the name that `spread` uses.
    """

    path: str
    parameter: Parameter


def start_parameters(coordinates: Sequence[Coordinate]) -> tuple[Parameter, ...]:
    """Return the parameters of a start: how it is off the trajectory's, in each coordinate and its rate."""
    places = [
        Parameter(f"start_{each.name}", each.unit, f"start of {each.name}, from the trajectory's")
        for each in coordinates
    ]
    rates = [
        Parameter(
            f"start_{each.rate or f'{each.name}_rate'}",
            f"{each.unit}/s",
            f"start of the rate of {each.name}, from the trajectory's",
        )
        for each in coordinates
    ]
    return (*places, *rates)


def _of_model(parameter: Parameter, prefix: str) -> Parameter:
    meaning = (
        parameter.meaning.replace("the robot", "the controller's model") if prefix else parameter.meaning
    )
    return replace(parameter, name=prefix + parameter.name, meaning=meaning)


def _of_kinds() -> Iterator[tuple[str, tuple[Parameter, ...]]]:
    for package in (forces, paths, trajectories):
        for kind in _stating(package):
            with_ = f", with {kind.needs}" if hasattr(kind, "needs") else ""
            how = f"added where there is none{with_}" if hasattr(kind, "nothing") else "where there is one"
            if parameters_of(kind):  # of a Spline they hang on how many points it has
                yield f"{kind.__name__}, {how}", parameters_of(kind)


GROUPS: Mapping[str, tuple[Parameter, ...]] = {
    "the robot": BODY_PARAMETERS,
    "the controller's model": tuple(_of_model(each, "model_") for each in BODY_PARAMETERS),
    "the start, from the trajectory's": start_parameters(PlanarBody.coordinates),
    "gains, one for all coordinates, of each, or a factor": GAINS,
    **dict(_of_kinds()),
}
"""The parameters of the library's own parts, by what has them."""

PARAMETERS: Mapping[str, Parameter] = {each.name: each for group in GROUPS.values() for each in group}
"""The same by name: a spread may name these, and those of users' parts."""


def _walked(path: str, part: Any, prefix: str) -> Iterator[tuple[str, Stated]]:
    for parameter in parameters_of(part):
        mine = _of_model(parameter, prefix)
        yield mine.name, Stated(path, mine)
    for name, child in children_at(path, part):
        if not isinstance(getattr(part, name, None), MethodType):
            model = "model_" if hasattr(child, "forward_dynamics") else ""
            yield from _walked(f"{path}.{name}", child, prefix + model)


def stated_by(parts: Parts, coordinates: Sequence[Coordinate]) -> dict[str, list[Stated]]:
    """Return the parameters of a loop by name, and by path and name; several parts may state one name."""
    found: dict[str, list[Stated]] = {}
    every = [each for path, part in parts.by_path() for each in _walked(path, part, "")]
    for parameter in start_parameters(coordinates):
        every.append((parameter.name, Stated("", parameter)))
    for name, stated in every:
        found.setdefault(name, []).append(stated)
        found.setdefault(f"{stated.path}.{name}" if stated.path else name, [stated])
    return found


def resolved(name: Any, known: Mapping[str, list[Stated]], where: str = "spread") -> Stated:
    """Return the parameter that a spread names; `where` appears in error messages.

    Raises
    ------
    UnknownName
        If there is none of that name.
    InvalidArgument
        If several parts have one.
    """
    found = known.get(name) if isinstance(name, str) else None
    if not found:
        raise UnknownName(f"parameter in {where}", name, [each for each in known if "." not in each])
    if len(found) > 1:
        paths = [stated.path for stated in found]
        raise InvalidArgument(
            f"spread has {name!r}, which {' and '.join(paths)} have, expected one of them: "
            f"{' or '.join(repr(f'{path}.{name}') for path in paths)}"
        )
    return found[0]


def with_spread_forces(forces: Sequence[Any], spread: Mapping[str, Any]) -> tuple[Any, ...]:
    """Return the forces, with those of the library that a spread names and that need no more to be known.

    Raises
    ------
    InvalidArgument
        If more must be known of one.
    """
    found = list(forces)
    for name in spread:
        kind = _FORCE_OF.get(name)
        if kind is None or any(name == each.name for force in found for each in parameters_of(force)):
            continue
        needs = getattr(kind, "needs", None)
        if not hasattr(kind, "nothing") or (needs is not None and needs not in spread):
            also = f"no {needs!r} and " if needs else ""
            raise InvalidArgument(
                f"spread has {name!r} but {also}forces no {kind.__name__}, expected "
                f"{'one of them' if needs else 'one'}"
            )
        found.append(kind.nothing())
    return tuple(found)
