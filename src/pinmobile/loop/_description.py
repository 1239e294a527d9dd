"""Ensembles and scenarios in words: what can be said of them without their parts."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import Any, final

import numpy as np

from pinmobile.arrays import Array
from pinmobile.errors import shown
from pinmobile.loop._loop import named_forces
from pinmobile.loop._scenario import Recorded, Scenario, checked_scenario
from pinmobile.loop._spread import SameAs, Source
from pinmobile.metrics import Metric, in_words
from pinmobile.plant import Coordinate, Input, Parameter
from pinmobile.trajectories import Reference

_NARROWEST = 28  # letters of a row's name


def judgement(n: int, duration: float, within: tuple[float, float], diverged: int, after: float) -> str:
    """Return the result of n robots in one line.

    Parameters
    ----------
    n : int
        Number of robots.
    duration : float
        Of each run [s].
    within : tuple of 2 floats
        What 99 % of them stay within [m, rad]; infinite where fewer have not diverged.
    diverged : int
        How many did.
    after : float
        Time from which on errors count [s].
    """
    sizes = f"within {in_words(within[0])} m and {in_words(within[1])} rad"
    since = f"from {after:g} s on " if after else ""
    if n == 1:
        return f"1 robot over {duration:g} s: {'diverged' if diverged else f'{since}stays {sizes}'}"
    start = f"{n:,} robots over {duration:g} s: "
    if np.isinf(within[0]):
        return f"{start}{diverged:,} diverged, {percent(diverged, n).removesuffix(' of')}"
    sizes = f"{since}99 % stay {sizes}"
    return f"{start}{sizes}, {f'{diverged:,} diverged' if diverged else 'none diverged'}"


def percent(part: int, n: int) -> str:
    """Return a part of n in words: ``96 % of``, or ``all``; only all of n are 100 %."""
    if part == n:
        return "all"
    share = 100 * part / n
    return f"{share:.2g} % of" if share < 99 else "more than 99 % of"


def ranges(
    max_distance: Array,
    max_error: Array,
    max_input: Array,
    coordinates: Sequence[Coordinate],
    inputs: Sequence[Input],
    worst_metric: Array,
    metrics: Sequence[Metric],
) -> list[str]:
    """Return a row for each error, input and metric: the least, the median and the largest over the robots.

    Parameters
    ----------
    max_distance : ndarray, shape (n,)
        Largest distance from the desired position [m].
    max_error, max_input : ndarray, shape (n, c), (n, nu)
        Largest error and input.
    coordinates, inputs : sequence of Coordinate, sequence of Input
        Their names and units.
    worst_metric : ndarray, shape (n, j)
        Worst of what else is judged.
    metrics : sequence of Metric
        Its names and units.
    """
    columns = {"largest distance [m]": max_distance}
    errors = [
        (_titled(f"error of {one.name}", one.unit), column)
        for one, column in zip(coordinates, max_error.T, strict=True)
    ]
    sizes = [(_titled(one.name, one.unit), column) for one, column in zip(inputs, max_input.T, strict=True)]
    for pair in zip_longest(errors, sizes):
        columns |= {title: column for title, column in filter(None, pair)}
    each = zip(metrics, worst_metric.T, strict=True)
    columns |= {f"{one.worst} {one.title}": column for one, column in each if one.worst != "ever"}
    rows, width = [], max(_NARROWEST, *map(len, columns))
    for name, values in columns.items():
        good = values[~np.isnan(values)]
        if len(good):
            low, middle, high = map(in_words, (good.min(), np.median(good), good.max()))
            rows.append(f"{name:<{width}} least {low}, median {middle}, largest {high}")
    return rows


def _titled(name: str, unit: str) -> str:
    return f"largest {name} [{unit}]" if unit else f"largest {name}"


_PARTS = ("robot", "controller", "trajectory", "integrator")
_NUMBERS = ("n", "seed", "dt", "substeps", "limit", "after", "every")
_PRINTED: dict[str, Any] = {  # arrays with all digits, whatever options the user has set
    **{"precision": 17, "threshold": 1000, "edgeitems": 3, "suppress": False, "floatmode": "maxprec"},
    **{"sign": "-", "formatter": None, "nanstr": "nan", "infstr": "inf", "legacy": False},
}
_CLOSE = 1e-9  # by which numbers differ that another machine or release makes anew, at most


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Outline(Recorded):
    """Description of a scenario by the text of its parts, of an ensemble that was loaded from a file.

    The attributes are those of `Scenario`.

    Attributes
    ----------
    robot, controller, trajectory, integrator : str
        The parts, as Python shows them.
    forces : tuple of str
        The forces, likewise.
    spread : dict of str to str or SameAs
        From what each parameter was drawn; of a `SameAs`, the factor in words.
    parameters : dict of str to Parameter
        Unit and meaning of what was drawn.
    coordinates : tuple of Coordinate
        Name and unit of those that the reference has.
    inputs : tuple of Input
        Name and unit of the plant's.
    recorded_metrics : tuple of Metric
        Those of the plant, beside errors.
    n, seed, dt, substeps, limit, after, every : number
        As given.
    t : ndarray, shape (N + 1,)
        Times [s].
    reference : Reference
        Desired q, v and a at these times, shape (N + 1, ...), v and a of as many as there are coordinates.
    """

    robot: str
    controller: str
    trajectory: str
    integrator: str
    forces: tuple[str, ...]
    spread: Mapping[str, str | SameAs]
    parameters: Mapping[str, Parameter]
    coordinates: tuple[Coordinate, ...]
    inputs: tuple[Input, ...]
    recorded_metrics: tuple[Metric, ...]
    n: int
    seed: int
    dt: float
    substeps: int
    limit: float
    after: float
    every: int
    t: Array = field(repr=False)
    reference: Reference = field(repr=False)

    @classmethod
    def of(cls, scenario: Scenario | Outline) -> Outline:
        """Return the outline of a scenario; one that is an outline comes back as it is.

        Raises
        ------
        InvalidArgument
            If it is something else.
        """
        if isinstance(scenario, Outline):
            return scenario
        given = checked_scenario(scenario)
        same: dict[str, Any] = {
            name: getattr(given, name) for name in (*_NUMBERS, "parameters", "t", "reference")
        }
        same["every"] = given.stride
        parts: dict[str, Any] = {name: _words(getattr(given, name)) for name in _PARTS}
        forces, spread = tuple(map(_words, named_forces(given.forces).values())), given.spread.items()
        return cls(
            **same,
            **parts,
            forces=forces,
            spread={name: _source(source) for name, source in spread},
            coordinates=tuple(Coordinate(*one[:2]) for one in given.coordinates),
            inputs=tuple(Input(*one[:2]) for one in given.inputs),
            recorded_metrics=given.recorded_metrics,
        )

    def difference(self, other: Outline) -> str:
        """Return how another scenario differs as text; "" where no difference is visible."""
        there, here = self._told(), other._told()
        for name in {**there, **here}:
            if there.get(name) != here.get(name):
                return f"{name} is {there.get(name, 'absent')} there and {here.get(name, 'absent')} here"
        names = ("t", *(f"reference.{name}" for name in Reference._fields))
        pairs = zip((self.t, *self.reference), (other.t, *other.reference), strict=True)
        return next(
            (f"{name} is another" for name, pair in zip(names, pairs, strict=True) if not alike(*pair)), ""
        )

    def __str__(self) -> str:
        told = self._told()
        numbers = ", ".join(f"{name} {told.pop(name)}" for name in _NUMBERS)
        return "\n".join([*(f"{name}: {words}" for name, words in told.items()), numbers])

    def _told(self) -> dict[str, str]:
        """Return everything but times and reference in words, by name."""
        found = {name: getattr(self, name) for name in _PARTS}
        found |= {f"forces[{k}]": force for k, force in enumerate(self.forces)}
        for name, source in self.spread.items():
            words = f"{source.name} times {source.factor}" if isinstance(source, SameAs) else source
            found[f"spread[{name!r}]"] = words
        if self.recorded_metrics:
            found["metrics"] = ", ".join(one.name for one in self.recorded_metrics)
        return found | {name: f"{getattr(self, name)!r}" for name in _NUMBERS}


def alike(one: Array, other: Array) -> bool:
    """Return whether arrays are the same but for what another machine or release may change."""
    size = np.abs(one).max(initial=0.0)
    return one.shape == other.shape and np.allclose(one, other, rtol=_CLOSE, atol=_CLOSE * size)


def _source(source: Source) -> str | SameAs:
    """Return in words from what a parameter is drawn."""
    if isinstance(source, SameAs):
        return SameAs(source.name, _drawn_from(source.factor))
    return _drawn_from(source)


def _drawn_from(source: Any) -> str:
    if isinstance(source, np.ndarray):
        return f"{source.size} numbers" if source.ndim else repr(float(source))
    law = None if hasattr(source, "sample") else getattr(source, "dist", None)
    if law is None:
        return _words(source)
    # A frozen distribution of scipy.stats shows nothing of itself.
    given = [*map(repr, source.args), *(f"{name}={value!r}" for name, value in source.kwds.items())]
    return f"{law.name}({', '.join(given)})"


def _words(value: object) -> str:
    """Return a part as Python shows it, on one line, without its address in memory."""
    with np.printoptions(**_PRINTED):
        line = " ".join(re.sub(r" at 0x[0-9a-fA-F]+", "", shown(value)).split())
    return "".join(letter if letter.isprintable() else "?" for letter in line)
