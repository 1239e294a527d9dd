"""An ensemble as text and as arrays: its description, counts and quantiles, variables with their units."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from hashlib import sha256
from importlib.metadata import version as installed
from sysconfig import get_python_version
from types import MappingProxyType
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

import pinmobile
from pinmobile import parts
from pinmobile.arrays import Array, ArrayLike, bounded, finite, scalar, shaped
from pinmobile.compiled import BINS, FIRST, SHIFT, Contents
from pinmobile.controllers import Controller
from pinmobile.errors import import_extra, text_of
from pinmobile.loop._loop import named_forces
from pinmobile.loop._scenario import RecordGrid, Scenario, check_scenario
from pinmobile.loop._spread import SameAs
from pinmobile.metrics import Metric, format_si, value_of
from pinmobile.parts import is_part, parts_of, walk
from pinmobile.plant import Coordinate, Input, Parameter
from pinmobile.signals import Signal
from pinmobile.trajectories import Reference, Trajectory


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


def _format_source(source: Any) -> Any:
    """Return the source of a number of the spread as text."""
    if isinstance(source, SameAs):
        return SameAs(source.name, _format_source(source.factor))
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


_ROUNDING = 4 * float(np.finfo(np.float64).eps)  # rounding of a share such as 0.07 times a count


class Part(NamedTuple):
    """Records of m robots of an ensemble.

    Attributes
    ----------
    lived : ndarray of int, shape (m,)
        Number of samples before the loop diverged; all samples if it did not.
    max_error : ndarray, shape (m, c)
        Largest absolute error of the reference's c coordinates in those of these samples after
        `Scenario.after` [m, m, rad, ...].
    max_distance : ndarray, shape (m,)
        Largest distance from the desired position [m].
    rms_error : ndarray, shape (m, c)
        Root mean square error [m, m, rad, ...].
    max_input : ndarray, shape (m, nu)
        Largest absolute value of each input.
    worst_metric, rms_metric : ndarray, shape (m, j)
        Worst value and root mean square of each metric in the same samples as errors.
    counts : ndarray of int, shape (G, channels, BINS)
        Number of robots by time of the grid, channel of `Scenario.channels` and bin of sizes.
    kept : mapping of str to Signal
        Signals of `Scenario.keep` at the times of the grid, with values of shape (m, G) or (m, G, k).

    See Also
    --------
    loop.part_of : records of some robots of a scenario.
    Ensemble.of : ensemble of the records of all robots.

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot
    >>> from pinmobile import Scenario, Tangent
    >>> from pinmobile.loop import Part, part_of
    >>> runs = Scenario(robot=MobileRobot(30.0, 1.3), n=2, dt=0.1,
    ...                 controller=PD(120, 120), spread={},
    ...                 trajectory=Tangent(Circle(1.0, 0.5, 4.0)))
    >>> one, two = (part_of(runs, k, k + 1)[1] for k in range(2))
    >>> Part.concatenate([one, two]).max_distance  # [m]
    array([0.057, 0.057])
    """

    lived: NDArray[np.int64]
    max_error: Array
    max_distance: Array
    rms_error: Array
    max_input: Array
    worst_metric: Array
    rms_metric: Array
    counts: NDArray[np.int32]
    kept: Mapping[str, Signal] = {}

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        record: Mapping[str, Array],
        counts: NDArray[np.int32],
        kept: Mapping[str, Signal] = MappingProxyType({}),
    ) -> Part:
        """Return the records of m robots from the memory of `Worst`.

        Parameters
        ----------
        scenario : Scenario
            Scenario of the robots.
        record : mapping of str to ndarray, shape (m, ...)
            Memory of the recorder after the last sample.
        counts : ndarray of int, shape (G, channels, BINS)
            Counts of sizes.
        kept : mapping of str to Signal
            Kept signals at the times of the grid.

        Returns
        -------
        Part
            Records of the robots.
        """
        lived = record["lived"].astype(np.int64)
        is_over = np.arange(len(scenario.grid)) * scenario.stride >= lived[:, None]
        for signal in kept.values():
            signal.values[is_over] = np.nan
        count = np.maximum(lived - scenario.begin, 1)[:, None]
        empty = np.zeros((len(lived), 0))
        signs = np.array([-1.0 if metric.is_margin else 1.0 for metric in scenario.recorded_metrics])
        return cls(
            lived,
            record["largest"].copy(),  # a copy, so that the whole record can be freed
            np.sqrt(record["farthest"][:, 0]),
            np.sqrt(record["squares"] / count),
            record["inputs"].copy(),
            record.get("worst", empty) * signs,
            np.sqrt(record.get("metric_squares", empty) / count),
            counts,
            kept,
        )

    @classmethod
    def concatenate(cls, parts: Iterable[Part]) -> Part:
        """Return the records of all robots of several parts, in their order.

        Parameters
        ----------
        parts : iterable of Part
            Records of consecutive robots.

        Returns
        -------
        Part
            Records of all these robots.
        """
        columns: list[list[Any]] = [[] for _ in cls._fields[:-2]]
        counts: Any = 0
        series: dict[tuple[str, str], list[Array]] = {}
        for *arrays, part_counts, kept in parts:
            counts = counts + part_counts
            for column, rows in zip(columns, arrays, strict=True):
                column.append(rows)
            for name, signal in kept.items():
                series.setdefault((name, signal.unit), []).append(signal.values)
        signals = {name: Signal(unit, np.concatenate(rows)) for (name, unit), rows in series.items()}
        # One array after the other, which needs little additional memory.
        return cls._make([*(np.concatenate(columns.pop(0)) for _ in cls._fields[:-2]), counts, signals])


class Arguments(NamedTuple):
    """One robot of an ensemble: ``simulate(*arguments[:3], **arguments.options)`` simulates it.

    Attributes
    ----------
    robot, controller, trajectory
        First arguments of `simulate`.
    options : dict
        Other arguments of `simulate`, by name.

    See Also
    --------
    Ensemble.arguments : robot of an ensemble.
    Ensemble.member : samples of a robot.

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Tangent
    >>> from pinmobile import Uniform, ensemble, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> parts = robot, PD(120, 120), Tangent(Circle(1.0, 0.5, 4.0))
    >>> spread = {"mass": Uniform(20.0, 40.0)}
    >>> runs = ensemble(*parts, n=9, spread=spread, dt=0.02)
    >>> arguments = runs.arguments(3)
    >>> run = simulate(*arguments[:3], **arguments.options)
    >>> bool(abs(run.max_error() - runs.max_error[3]).max() < 1e-9)
    True
    """

    robot: Any
    controller: Controller
    trajectory: Trajectory
    options: dict[str, Any]


def arguments_of(scenario: Scenario, i: int, given_draws: Mapping[str, Array] | None = None) -> Arguments:
    """Return robot i as the arguments of `simulate`.

    Parameters
    ----------
    scenario : Scenario
        Scenario of the robots.
    i : int
        Index of the robot, 0 <= i < n.
    given_draws : mapping of str to ndarray, shape (1,), optional
        Draws of this robot.
    """
    draws = scenario.draws(i, i + 1) if given_draws is None else given_draws
    values = scenario.values(draws, i, i + 1)
    robot_values = {path: value[0] for path, value in values.items() if not path.startswith("start")}
    loop = parts.replace(scenario.loop, robot_values)
    references = scenario.references(values, 1, i)
    q, v = scenario.starts(values, 1, references)
    names = "dt", "duration", "integrator", "substeps", "limit"
    options = {name: getattr(scenario, name) for name in names}
    options |= {"q0": q[0], "v0": v[0], "forces": loop.forces}
    if references is not None:
        options["duration"] = float(scenario.t[-1])
    if scenario.is_noisy:
        options |= {"seed": scenario.seed, "member": i}
    return Arguments(loop.plant, loop.controller, loop.trajectory, options)


def edges() -> Array:
    """Return the edges of the bins, shape (BINS + 1,), from 0 to infinity."""
    inner = (np.arange(FIRST, FIRST + BINS - 1, dtype=np.int64) << SHIFT).view(np.float64)
    return np.concatenate([[0.0], inner, [np.inf]])


def bins_of(values: Array) -> NDArray[np.int64]:
    """Return the bins of numbers >= 0 or infinity, shape (...)."""
    bits = np.ascontiguousarray(values).view(np.int64) >> SHIFT
    return np.asarray(np.clip(bits - FIRST + 1, 0, BINS - 1))


def check_share(value: ArrayLike) -> float:
    """Return a share as a float.

    Raises
    ------
    InvalidArgument
        If the argument is not a number from 0 to 1.
    """
    return bounded("share", scalar("share", value), least=0, most=1)


def check_levels(value: ArrayLike) -> Array:
    """Return quantile levels as an array, shape (m,).

    Raises
    ------
    InvalidArgument
        If a level is not between 0 and 1.
    """
    levels = shaped("levels", np.atleast_1d(finite("levels", value)), ("n>=1",))
    return bounded("levels", levels, least=0, most=1)


def share_quantile(values: Array, share: float, axis: int = -1) -> Array:
    """Return the smallest value that a share of the values does not exceed; NaN if a value is NaN.

    Parameters
    ----------
    values : ndarray
        Values; at least one along `axis`.
    share : float
        Share from 0 to 1; 0 selects the smallest value.
    axis : int
        Axis that is reduced.
    """
    index = max(int(np.ceil(_rank(share, values.shape[axis]))), 1) - 1
    quantile = np.take(np.partition(values, index, axis), index, axis)
    return np.where(np.isnan(values).any(axis), np.nan, quantile)


def _rank(share: float, count: int | NDArray[np.int64]) -> Array:
    """Return the product of a share and a count; rounding errors are removed, so that 0.07 of 100 is 7."""
    rank = np.asarray(share * count)
    return np.where(np.abs(rank - np.round(rank)) <= _ROUNDING * rank, np.round(rank), rank)


def quantiles(counts: NDArray[np.int64], levels: Array, *, margins: bool = False) -> Array:
    """Return quantiles from counts in bins.

    Within a bin, the logarithm of the numbers counts as evenly distributed. The error of a quantile is thus
    at most the width of its bin, 2 to 3 %.

    Parameters
    ----------
    counts : ndarray of int, shape (..., BINS)
        Number of robots in each bin; at least one robot in total.
    levels : ndarray, shape (m,)
        Levels from 0 to 1.
    margins : bool
        Whether the sizes are those of margins, see `pinmobile.metrics.size_of`. The share of the robots then
        has at least the returned margin.

    Returns
    -------
    quantiles : ndarray, shape (m, ...)
        Quantiles; infinity in the last bin, or for margins minus infinity in the first bin.
    """
    bounds = edges()
    if margins:
        # From the best to the worst; only the lower edge of the best bin is known.
        counts, bounds = counts[..., ::-1], np.append(bounds[-2], bounds[-2::-1])
    total = counts.cumsum(axis=-1)
    values = np.empty((len(levels), *counts.shape[:-1]))
    for k, level in enumerate(levels):
        rank = _rank(level, total[..., -1:])
        # The first bin whose total reaches the rank, and is not empty.
        bin_ = np.minimum((total < np.maximum(rank, 1e-9)).sum(axis=-1), BINS - 1)
        inside = np.take_along_axis(counts, bin_[..., None], -1)[..., 0]
        below = np.take_along_axis(total, bin_[..., None], -1)[..., 0] - inside
        part = (rank[..., 0] - below) / np.maximum(inside, 1)
        low, high = bounds[bin_], bounds[bin_ + 1]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            value = low * (high / low) ** part
        if margins:
            values[k] = value_of(np.where(bin_ == BINS - 1, 0.0, value))
            continue
        values[k] = np.where(bin_ == 0, bounds[1] * part, np.where(bin_ == BINS - 1, np.inf, value))
    return values


LEVELS = (0.5, 0.9, 0.99)
"""Shares of the robots for which the quantiles over time are kept."""

NOTE = "units and long_name of each variable; robot i of a scenario is row i"
"""Note for readers of the variables."""


class Variable(NamedTuple):
    """Description of an array.

    Attributes
    ----------
    dimensions : tuple of str
        Names of the axes.
    units : str
        Unit, "1" for none; the units of all entries if the last axis is ``coordinate`` or ``input``.
    meaning : str
        Meaning as a noun phrase.
    worst : str
        For metrics: whether the largest or the smallest value of each is the worst.
    """

    dimensions: tuple[str, ...]
    units: str
    meaning: str
    worst: str = ""

    @property
    def attributes(self) -> dict[str, str]:
        """Unit and meaning under the names that xarray and other libraries use."""
        attributes = {"units": self.units, "long_name": self.meaning}
        return attributes | ({"worst": self.worst} if self.worst else {})


_UNTIL = "of a diverged robot until then"
_SINCE = f"from the scenario's `after` on, {_UNTIL}"
_ROBOT, _COORDINATE, _INPUT = ("robot",), ("robot", "coordinate"), ("robot", "input")
_METRIC = ("robot", "metric")
ROBOT_ARRAYS = (
    *("max_error", "rms_error", "max_input", "max_distance", "diverged_at"),
    *("worst_metric", "rms_metric"),
)
"""Names of the arrays with one entry per robot, in addition to draws."""


def robot_vars(scenario: Scenario | Outline) -> dict[str, Variable]:
    """Return the variables of `ROBOT_ARRAYS`; those of metrics only if there are metrics.

    Parameters
    ----------
    scenario : Scenario or Outline
        Scenario of the robots.
    """
    groups = scenario.coordinates, scenario.inputs, scenario.recorded_metrics
    errors, sizes, units = (", ".join(entry.unit or "1" for entry in group) for group in groups)
    variables = {
        "max_error": Variable(_COORDINATE, errors, f"largest |error|, {_SINCE}"),
        "rms_error": Variable(_COORDINATE, errors, f"root mean square error, {_SINCE}"),
        "max_input": Variable(_INPUT, sizes, f"largest |input|, {_UNTIL}"),
        "max_distance": Variable(_ROBOT, "m", f"largest distance from the desired position, {_SINCE}"),
        "diverged_at": Variable(_ROBOT, "s", "time of divergence; NaN if the loop did not diverge"),
    }
    if scenario.recorded_metrics:
        worst = f"largest size, or smallest margin, of each metric, {_SINCE}"
        group = ", ".join(entry.worst for entry in scenario.recorded_metrics)
        variables["worst_metric"] = Variable(_METRIC, units, worst, group)
        variables["rms_metric"] = Variable(_METRIC, units, f"root mean square of each metric, {_SINCE}")
    return variables


SUMS = ("counts", "quantiles")
"""Names of the arrays that contain sums over all robots."""


def sum_vars(channels: Sequence[Metric]) -> dict[str, Variable]:
    """Return the variables of `SUMS`.

    Parameters
    ----------
    channels : sequence of Metric
        Counted quantities.
    """
    counts = "number of robots with this size; diverged robots are in the last bin, for margins in the first"
    quantile = "largest error, or smallest margin, of the share `level` of the robots"
    units = ", ".join(channel.unit or "1" for channel in channels)
    return {
        "counts": Variable(("time", "channel", "bin"), "1", counts),
        "quantiles": Variable(("channel", "level", "time"), units, quantile),
    }


def draw_name(parameter: str) -> str:
    """Return the name of the array of a number's draws; a slash would create a group of a store."""
    return f"drawn_{parameter.replace('/', '.')}"


def draw_vars(parameters: Mapping[str, Parameter]) -> dict[str, Variable]:
    """Return the variables of the draws."""
    return {
        draw_name(name): Variable(_ROBOT, x.unit or "1", f"drawn {x.meaning}; NaN if not in the spread")
        for name, x in parameters.items()
    }


def quantiles_of(counts: NDArray[np.int32], levels: Array, channels: Sequence[Metric]) -> dict[str, Array]:
    """Return the quantiles over time of each channel, shape (L, G), by name.

    Parameters
    ----------
    counts : ndarray of int, shape (G, channels, BINS)
        Counts of all robots.
    levels : ndarray, shape (L,)
        Shares of the robots.
    channels : sequence of Metric
        Counted quantities.
    """
    return {
        channel.name: quantiles(counts[:, k].astype(np.int64), levels, margins=channel.is_margin)
        for k, channel in enumerate(channels)
    }


def sums(counts: NDArray[np.int32], channels: Sequence[Metric]) -> dict[str, Array | NDArray[np.int32]]:
    """Return the arrays of `SUMS`; see `quantiles_of` for the arguments."""
    quantiles = quantiles_of(counts, np.array(LEVELS), channels)
    return {"counts": counts, "quantiles": np.array(list(quantiles.values()))}


def coordinates(scenario: Scenario | Outline) -> list[tuple[str, Sequence[Any], str, str]]:
    """Return name, values, unit and meaning of the coordinates of all dimensions except ``robot``.

    Parameters
    ----------
    scenario : Scenario or Outline
        Scenario of the robots.
    """
    groups = scenario.coordinates, scenario.inputs, scenario.recorded_metrics
    names, inputs, metrics = ([entry.name for entry in group] for group in groups)
    channels = ", ".join(f"{entry.meaning} [{entry.unit or '1'}]" for entry in scenario.channels)
    meanings = ", ".join(entry.meaning for entry in scenario.recorded_metrics)
    edge = "lower edge, also upper edge of the previous bin; for a margin m: of m + sqrt(m^2 + 2^-24)"
    return [
        ("time", scenario.grid.tolist(), "s", "time"),
        ("coordinate", names, "1", "coordinate"),
        ("input", inputs, "1", "input"),
        ("channel", [entry.name for entry in scenario.channels], "1", channels),
        ("level", list(LEVELS), "1", "share of the robots"),
        ("bin", edges()[:-1].tolist(), "unit of the channel", edge),
        *([("metric", metrics, "1", meanings)] if metrics else []),
    ]


def dataset_of(ensemble: Any, attributes: Mapping[str, Any]) -> Any:
    """Return an ensemble as an xarray.Dataset.

    Parameters
    ----------
    ensemble : Ensemble
        Ensemble.
    attributes : mapping
        Attributes of the dataset.

    Raises
    ------
    InvalidArgument
        If xarray is not installed.
    """
    xarray = import_extra("xarray", "sweeps", "a Dataset")
    scenario = ensemble.scenario
    variables = {**_robot_variables(ensemble), **sum_vars(scenario.channels)}
    arrays = sums(ensemble.counts, scenario.channels)
    arrays |= {name: array for name, _, array in _arrays(ensemble)}
    for name, (unit, values) in ensemble.kept.items():
        dimensions = ("robot", "time", f"entry of {name}")[: values.ndim]
        variables[f"kept_{name}"] = Variable(dimensions, unit or "1", f"signal {name}")
        arrays[f"kept_{name}"] = values
    axes = {
        name: (name, values, {"units": unit, "long_name": meaning})
        for name, values, unit, meaning in coordinates(scenario)
    }
    return xarray.Dataset(
        # Copied, because users may write into arrays of the dataset.
        {name: (one.dimensions, arrays[name].copy(), one.attributes) for name, one in variables.items()},
        axes,
        {"Conventions": NOTE, "errors_from_s": scenario.after, **attributes},
    )


def columns_of(ensemble: Any) -> tuple[list[str], list[Array]]:
    """Return the arrays with one entry per robot as columns of a table, and their names with units."""
    header, columns = ["robot"], [np.arange(len(ensemble), dtype=np.float64)]
    parts: Mapping[str, Sequence[Any]] = {
        "coordinate": ensemble.scenario.coordinates,
        "input": ensemble.scenario.inputs,
        "metric": ensemble.scenario.recorded_metrics,
    }
    for name, variable, array in _arrays(ensemble):
        titles = [(f"{name}_{part.name}", part.unit) for part in parts.get(variable.dimensions[-1], ())]
        pairs = titles or [(name, variable.units)]
        header += [f"{title} [{unit}]" if unit not in ("", "1") else title for title, unit in pairs]
        columns.append(array)
    return header, columns


def _robot_variables(ensemble: Any) -> dict[str, Variable]:
    scenario = ensemble.scenario
    return {**draw_vars(scenario.parameters), **robot_vars(scenario)}


def _arrays(ensemble: Any) -> Iterator[tuple[str, Variable, Array]]:
    draws = {draw_name(name): values for name, values in ensemble.draws.items()}
    for name, variable in _robot_variables(ensemble).items():
        yield name, variable, getattr(ensemble, name) if name in ROBOT_ARRAYS else draws[name]


def content_of(ensemble: Any) -> dict[str, Any]:
    """Return the content of a file of an ensemble: description, arrays and their meanings."""
    outline = Outline.of(ensemble.scenario)
    values = {item.name: getattr(ensemble, item.name) for item in fields(ensemble)}
    return values | {
        "scenario": outline,
        "traces": {i: trace.content() for i, trace in ensemble.traces.items()},
        "variables": {**robot_vars(outline), **draw_vars(outline.parameters)},
    }
