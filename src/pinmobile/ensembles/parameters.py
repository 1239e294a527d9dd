"""The parameters of a loop, which a spread may name: those that its parts state, and those of its start."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import MethodType
from typing import NamedTuple

import numpy as np

from pinmobile import forces, paths, trajectories
from pinmobile.arrays import Array
from pinmobile.compiled import Parts, Place, children_at
from pinmobile.controllers import GAINS
from pinmobile.errors import InvalidArgument, UnknownName
from pinmobile.plant import Coordinate, Parameter, parameters_of
from pinmobile.robot import BODY_PARAMETERS, PlanarBody


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

    @property
    def place(self) -> Place:
        """Where its number stands: the part, and the part's attribute."""
        return Place(self.path, self.parameter.attribute)

    @property
    def is_of_trajectory(self) -> bool:
        """Whether the trajectory, or a part of it, states it."""
        return self.path.partition(".")[0] == "trajectory"


def start_parameters(coordinates: Sequence[Coordinate]) -> tuple[Parameter, ...]:
    """Return the parameters of a start: its offset from the trajectory's start in coordinates and rates."""
    off = "relative to the trajectory's start"
    places = [(each.name, each.unit, f"start of {each.name}, {off}") for each in coordinates]
    rates = [
        (each.rate or f"{each.name}_rate", f"{each.unit}/s", f"rate of {each.name} at the start, {off}")
        for each in coordinates
    ]
    return tuple(Parameter(f"start_{name}", unit, meaning) for name, unit, meaning in (*places, *rates))


def _of_model(parameter: Parameter, prefix: str) -> Parameter:
    meaning = (
        parameter.meaning.replace("the robot", "the controller's model") if prefix else parameter.meaning
    )
    return replace(parameter, name=prefix + parameter.name, meaning=meaning)


def _of_kinds() -> Iterator[tuple[str, tuple[Parameter, ...]]]:
    for package in (forces, paths, trajectories):
        for kind in map(vars(package).get, package.__all__):
            if isinstance(kind, type) and (stated := parameters_of(kind)):
                yield f"{kind.__name__}, if there is one", stated


GROUPS: Mapping[str, tuple[Parameter, ...]] = {
    "the robot": BODY_PARAMETERS,
    "the controller's model": tuple(_of_model(each, "model_") for each in BODY_PARAMETERS),
    "the start, relative to the trajectory's start": start_parameters(PlanarBody.coordinates),
    "gains: one for all coordinates, one for each, or a common factor": GAINS,
    **dict(_of_kinds()),
}
"""The parameters of the library's own parts, by what has them."""

PARAMETERS: Mapping[str, Parameter] = {
    each.name: each for group in reversed(tuple(GROUPS.values())) for each in reversed(group)
}
"""The same by name, of several the first: a spread may name these, and those of users' parts."""


def _walked(path: str, part: object, prefix: str) -> Iterator[tuple[str, Stated]]:
    for parameter in parameters_of(part):
        mine = _of_model(parameter, prefix)
        yield mine.name, Stated(path, mine)
    for name, child in children_at(path, part):
        if not isinstance(getattr(part, name, None), MethodType):
            # The body of a plant on wheels is its own, and no model of it.
            is_model = hasattr(child, "forward_dynamics") and not hasattr(part, "forward_dynamics")
            model = "model_" if is_model else ""
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


def resolved(name: object, known: Mapping[str, list[Stated]], where: str = "spread") -> Stated:
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


def nominal_of(known: Mapping[str, list[Stated]], values: Mapping[Place, Array]) -> dict[str, float]:
    """Return the values of the parameters by name, as far as each is one number.

    Parameters
    ----------
    known : mapping
        The parameters that there are, as `stated_by` returns them.
    values : mapping of Place to ndarray
        What the attributes of the nominal parts are.
    """
    found = {}
    for name, (stated, *others) in known.items():
        value = stated.parameter.nominal(values[stated.place]) if stated.path else 0.0
        if not others and value is not None:
            found[name] = value
    return found


def written(
    stated: Mapping[str, Stated],
    draws: Mapping[str, Array],
    values: Mapping[Place, Array],
    count: int,
    size: int,
) -> dict[Place, Array]:
    """Return the attributes of `count` robots that something is drawn of, shape (count, ...).

    Parameters
    ----------
    stated : mapping of str to Stated
        What is spread, by name, in the order in which parts state it: factors come after what they multiply.
    draws : mapping of str to ndarray, shape (count,)
        What was drawn.
    values : mapping of Place to ndarray
        What the attributes of the nominal parts are; others are left out.
    count, size : int
        How many robots, and how many coordinates the reference has.
    """
    found: dict[Place, Array] = {}
    for name, one in stated.items():
        if one.place in values:
            nominal = values[one.place]
            before = found.get(one.place, np.broadcast_to(nominal, (count, *nominal.shape)))
            found[one.place] = one.parameter.written(before, draws[name], size)
    return found


def check_possible(draws: Mapping[str, Array], stated: Mapping[str, Stated]) -> None:
    """Refuse draws of which a number is impossible.

    Raises
    ------
    InvalidArgument
        If there are; the message tells their share.
    """
    for name, column in draws.items():
        parameter = stated[name].parameter
        wrong = ~parameter.allows(column)
        if wrong.any():
            raise InvalidArgument(
                f"spread[{name!r}] gives {column[wrong].min():.6g} {parameter.unit} as the "
                f"{parameter.meaning}, and {np.count_nonzero(wrong)} of {len(column)} draws "
                f"({wrong.mean():.2%}) are impossible; expected {parameter.bound}"
            )


def check_together(
    draws: Mapping[str, Array], stated: Mapping[str, Stated], parts: Parts, count: int, size: int
) -> None:
    """Refuse draws whose numbers are possible one by one but not together, as the parts say.

    Raises
    ------
    InvalidArgument
        If there is such; the message tells the share.
    """
    paths = dict.fromkeys(one.path for one in stated.values() if one.path)
    knowing = {path: part for path in paths if hasattr(part := parts.at(path), "impossible")}
    values = written(stated, draws, parts.parameters(), count, size) if knowing else {}
    for path, part in knowing.items():
        own = {place.name: array for place, array in values.items() if place.path == path}
        for name, wrong in part.impossible(own):
            raise InvalidArgument(
                f"spread gives the {name} of {path} in {np.count_nonzero(wrong)} of {count} draws "
                f"({wrong.mean():.2%}) an inertia that no body has, {part.EXPECTED}"
            )
