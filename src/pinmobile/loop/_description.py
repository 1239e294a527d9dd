"""Text about ensembles and scenarios, which needs none of their parts."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from importlib.metadata import version as installed
from itertools import zip_longest
from sysconfig import get_python_version
from typing import Any, final

import numpy as np

import pinmobile
from pinmobile.arrays import Array
from pinmobile.compiled import Contents
from pinmobile.errors import text_of
from pinmobile.loop._loop import named_forces
from pinmobile.loop._scenario import RecordGrid, Scenario, check_scenario
from pinmobile.loop._spread import SameAs, Source
from pinmobile.metrics import Metric, format_si
from pinmobile.parts import is_part, parts_of, walk
from pinmobile.plant import Coordinate, Input, Parameter
from pinmobile.trajectories import Reference

_MIN_WIDTH = 28  # smallest width of a row's name


def format_result(n: int, duration: float, errors: tuple[float, float], diverged: int, after: float) -> str:
    """Return the result of n robots in one line.

    Parameters
    ----------
    n : int
        Number of robots.
    duration : float
        Duration of each run [s].
    errors : tuple of 2 floats
        Distance [m] and heading error [rad] that 99 % of the robots do not exceed; infinite if too many
        diverge.
    diverged : int
        Number of diverged robots.
    after : float
        Time from which errors count [s].
    """
    sizes = f"within {format_si(errors[0])} m and {format_si(errors[1])} rad"
    prefix = f"from {after:g} s on " if after else ""
    if n == 1:
        return f"1 robot over {duration:g} s: {'diverged' if diverged else f'{prefix}stays {sizes}'}"
    start = f"{n:,} robots over {duration:g} s: "
    if np.isinf(errors[0]):
        return f"{start}{diverged:,} diverged, {format_percent(diverged, n).removesuffix(' of')}"
    sizes = f"{prefix}99 % stay {sizes}"
    return f"{start}{sizes}, {f'{diverged:,} diverged' if diverged else 'none diverged'}"


def format_percent(part: int, n: int) -> str:
    """Return a part of n as text: ``"96 % of"`` or ``"all"``; only all of n are 100 %."""
    if part == n:
        return "all"
    share = 100 * part / n
    return f"{share:.2g} % of" if share < 99 else "more than 99 % of"


def format_ranges(
    max_distance: Array,
    max_error: Array,
    max_input: Array,
    coordinates: Sequence[Coordinate],
    inputs: Sequence[Input],
    worst_metric: Array,
    metrics: Sequence[Metric],
) -> list[str]:
    """Return one row per error, input and metric: smallest, median and largest value over the robots.

    Parameters
    ----------
    max_distance : ndarray, shape (n,)
        Largest distance from the desired position [m].
    max_error, max_input : ndarray, shape (n, c), (n, nu)
        Largest errors and inputs.
    coordinates, inputs : sequence of Coordinate, sequence of Input
        Names and units of the coordinates and inputs.
    worst_metric : ndarray, shape (n, j)
        Worst values of the metrics.
    metrics : sequence of Metric
        Names and units of the metrics.
    """
    columns = {"largest distance [m]": max_distance}
    errors = zip([_title(f"error of {one.name}", one.unit) for one in coordinates], max_error.T, strict=True)
    sizes = zip([_title(one.name, one.unit) for one in inputs], max_input.T, strict=True)
    for pair in zip_longest(errors, sizes):
        columns |= dict(filter(None, pair))
    pairs = zip(metrics, worst_metric.T, strict=True)
    columns |= {f"{one.worst} {one.title}": column for one, column in pairs if one.worst != "ever"}
    rows, width = [], max(_MIN_WIDTH, *map(len, columns))
    for name, values in columns.items():
        finite = values[~np.isnan(values)]
        if len(finite):
            low, middle, high = map(format_si, (finite.min(), np.median(finite), finite.max()))
            rows.append(f"{name:<{width}} least {low}, median {middle}, largest {high}")
    return rows


def _title(name: str, unit: str) -> str:
    return f"largest {name} [{unit}]" if unit else f"largest {name}"


_PARTS = ("robot", "controller", "trajectory", "integrator")
_NUMBERS = ("n", "seed", "dt", "substeps", "limit", "after", "every")
_PRINT_OPTIONS: dict[str, Any] = {  # arrays with all digits, independent of the user's options
    **{"precision": 17, "threshold": 1000, "edgeitems": 3, "suppress": False, "floatmode": "maxprec"},
    **{"sign": "-", "formatter": None, "nanstr": "nan", "infstr": "inf", "legacy": False},
}
_RTOL = 1e-9  # largest relative difference between machines or releases


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Outline(RecordGrid):
    """Description of a scenario with its parts as text, for an ensemble that was loaded from a file.

    Attributes
    ----------
    robot, controller, trajectory, integrator : str
        ``repr`` of each part.
    forces : tuple of str
        ``repr`` of each force.
    spread : dict of str to str or SameAs
        Distribution of each number of the spread as text; the factor of a `SameAs` is text.
    parameters : dict of str to Parameter
        Unit and meaning of each number of the spread.
    coordinates : tuple of Coordinate
        Name and unit of the reference's coordinates.
    inputs : tuple of Input
        Name and unit of the plant's inputs.
    recorded_metrics : tuple of Metric
        Recorded metrics of the plant.
    n, seed, substeps, every : int
        Number of robots, seed, substeps, and samples between two entries of the bands.
    dt : float
        Time step of the controller [s].
    limit : float
        Largest error of a loop that has not diverged [m, rad, m/s, rad/s].
    after : float
        Time from which errors are recorded [s].
    t : ndarray, shape (N + 1,)
        Times of the samples [s].
    reference : Reference
        Desired q, v and a at these times, shape (N + 1, ...).
    code : dict of str to str
        Digest of the numbers and the code of each part and of the metrics; "" if they cannot be recognised.
    versions : dict of str to str
        Versions of Python, pinmobile and the packages that compute, at the time of the runs.

    See Also
    --------
    Scenario : scenario with its parts.
    Ensemble.load : ensemble of a file.

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot
    >>> from pinmobile import Scenario, Tangent
    >>> from pinmobile.loop import Outline
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> path = Tangent(Circle(1.0, 0.5, 4.0))
    >>> runs = Scenario(robot=robot, controller=PD(4, 4),
    ...                 trajectory=path, n=9, spread={}, dt=0.1)
    >>> Outline.of(runs).controller
    'PD(kp=4.0, kd=4.0, difference=None)'
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
    code: Mapping[str, str] = field(default_factory=dict, repr=False)
    versions: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, scenario: Scenario | Outline) -> Outline:
        """Return the description of a scenario; a description is returned unchanged.

        Parameters
        ----------
        scenario : Scenario or Outline
            Scenario.

        Returns
        -------
        Outline
            Description with the parts as text.

        Raises
        ------
        InvalidArgument
            If the argument is neither.
        """
        if isinstance(scenario, Outline):
            return scenario
        typed = check_scenario(scenario)
        numbers: Any = {name: getattr(typed, name) for name in (*_NUMBERS, "parameters", "t", "reference")}
        parts: Any = {name: _format_part(getattr(typed, name)) for name in _PARTS}
        return cls(
            **(numbers | {"every": typed.stride}),
            **parts,
            forces=tuple(map(_format_part, named_forces(typed.forces).values())),
            spread={name: _format_source(source) for name, source in typed.spread.items()},
            coordinates=tuple(Coordinate(*row[:2]) for row in typed.coordinates),
            inputs=tuple(Input(*row[:4]) for row in typed.inputs),
            recorded_metrics=tuple(row._replace(function=None) for row in typed.recorded_metrics),
            code=_digests(typed),
            versions=versions(),
        )

    def difference(self, other: Outline) -> str:
        """Return a difference from another description as text; "" if there is no visible difference.

        Parameters
        ----------
        other : Outline
            Description to compare with.

        Returns
        -------
        str
            Name and both values of the first difference.
        """
        texts, others = self._collect_texts(), other._collect_texts()
        for name in {**texts, **others}:
            if texts.get(name) != others.get(name):
                return f"{name} is {texts.get(name, 'absent')} there and {others.get(name, 'absent')} here"
        names = ("t", *(f"reference.{name}" for name in Reference._fields))
        rows = zip(names, (self.t, *self.reference), (other.t, *other.reference), strict=True)
        lines = [f"{name} differs" for name, value, other_value in rows if not are_close(value, other_value)]
        shared = [name for name, digest in self.code.items() if digest and other.code.get(name)]
        lines += [
            f"numbers or code of {name} differ" for name in shared if self.code[name] != other.code[name]
        ]
        return lines[0] if lines else ""

    @property
    def spread_in_words(self) -> str:
        """Names of the spread with distributions and units, "" if nothing is spread."""
        sources = (self._source_text(source) for source in self.spread.values())
        units = (parameter.unit for parameter in self.parameters.values())
        triples = zip(self.spread, sources, units, strict=True)
        rows = ((name, x, "" if x.startswith("Relative(") else unit) for name, x, unit in triples)
        return ", ".join(f"{name} {words} {unit}".rstrip() for name, words, unit in rows)

    @staticmethod
    def _source_text(source: str | SameAs) -> str:
        return f"{source.name} times {source.factor}" if isinstance(source, SameAs) else source

    def __str__(self) -> str:
        texts = self._collect_texts()
        numbers = ", ".join(f"{name} {texts.pop(name)}" for name in _NUMBERS)
        releases = ", ".join(f"{name} {version}" for name, version in self.versions.items())
        return "\n".join([*(f"{name}: {words}" for name, words in texts.items()), numbers, releases])

    def _collect_texts(self) -> dict[str, str]:
        """Return everything except times and reference as text, by name."""
        texts = {name: getattr(self, name) for name in _PARTS}
        texts |= {f"forces[{k}]": force for k, force in enumerate(self.forces)}
        for name, source in self.spread.items():
            texts[f"spread[{name!r}]"] = self._source_text(source)
        if self.recorded_metrics:
            texts["metrics"] = ", ".join(metric.name for metric in self.recorded_metrics)
        return texts | {name: f"{getattr(self, name)!r}" for name in _NUMBERS}


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages on which numbers depend."""
    releases = {"python": get_python_version(), "pinmobile": pinmobile.__version__}
    return releases | {name: installed(name) for name in ("numpy", "scipy", "pin", "llvmlite")}


def contents(scenario: Scenario) -> Iterator[tuple[str, Any]]:
    """Yield classes and fields of the loop and of the spread, by path."""
    yield "metrics", scenario.metrics
    for path, part in parts_of(scenario.nominal_loop):
        yield path or "loop", type(part)
    for leaf in walk(scenario.nominal_loop):
        yield leaf.path, leaf.value
    for name, source in sorted(scenario.spread.items()):
        for leaf in walk(source) if is_part(source) else ():
            yield f"spread.{name}.{leaf.path}", leaf.value
        yield f"spread.{name}", type(source) if is_part(source) else source


def _digests(scenario: Scenario) -> dict[str, str]:
    """Return a digest of the numbers and the code of each part of a loop, and of its metrics."""
    texts: dict[str, list[str]] = {}
    for path, value in contents(scenario):
        name = path.partition(".")[0]
        if name != "spread":  # the draws contain it
            text, unknown = Contents.of_value(value)
            texts.setdefault(name, []).append("" if unknown else f"{path} {text}")
    return {
        name: sha256("\n".join(lines).encode("utf-8", "surrogatepass")).hexdigest() if all(lines) else ""
        for name, lines in texts.items()
    }


def are_close(array: Array, other: Array) -> bool:
    """Return whether arrays are equal up to differences between machines or releases."""
    size = np.abs(array).max(initial=0.0)
    return array.shape == other.shape and np.allclose(array, other, rtol=_RTOL, atol=_RTOL * size)


def _format_source(source: Source) -> str | SameAs:
    """Return the source of a number of the spread as text."""
    if isinstance(source, SameAs):
        return SameAs(source.name, _format_law(source.factor))
    return _format_law(source)


def _format_law(source: Any) -> str:
    if isinstance(source, np.ndarray):
        return f"{source.size} numbers" if source.ndim else repr(float(source))
    law = None if hasattr(source, "sample") else getattr(source, "dist", None)
    if law is None:
        return _format_part(source)
    # The repr of a frozen distribution of scipy.stats contains no parameters.
    arguments = [*map(repr, source.args), *(f"{name}={value!r}" for name, value in source.kwds.items())]
    return f"{law.name}({', '.join(arguments)})"


def _format_part(value: object) -> str:
    """Return the ``repr`` of a part on one line, without its address in memory."""
    with np.printoptions(**_PRINT_OPTIONS):
        line = " ".join(re.sub(r" at 0x[0-9a-fA-F]+", "", text_of(value)).split())
    return "".join(letter if letter.isprintable() else "?" for letter in line)
