"""`Ensemble`: the results of the robots of a scenario, their counts, quantiles and variables of a file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from os import PathLike
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from pinmobile import parts
from pinmobile.arrays import Array, ArrayLike, bounded, finite, location, one_of, scalar, shaped, whole
from pinmobile.compiled import BINS, FIRST, SHIFT
from pinmobile.controllers import Controller
from pinmobile.errors import Diverged, InvalidArgument, imported
from pinmobile.files import read_archive, write_archive, write_table
from pinmobile.loop._description import Outline, alike, judgement, ranges
from pinmobile.loop._rollout import Rollout
from pinmobile.loop._scenario import Scenario
from pinmobile.loop._simulate import simulate
from pinmobile.metrics import Metric, value_of
from pinmobile.plant import Parameter
from pinmobile.trajectories import Trajectory

LEVELS = (0.5, 0.9, 0.99)
"""Shares of the robots for which the quantiles over time are kept."""

NOTE = "units and long_name of each variable; robot i of a scenario is row i"
"""How the variables are to be read."""


class Variable(NamedTuple):
    """An array by its name.

    Attributes
    ----------
    dimensions : tuple of str
        Of its axes.
    units : str
        Its unit, "1" for none; where its last axis is ``coordinate`` or ``input``, that of each.
    meaning : str
        What it is, in words.
    worst : str
        Of metrics, whether the largest or the smallest of each is the worst.
    """

    dimensions: tuple[str, ...]
    units: str
    meaning: str
    worst: str = ""

    @property
    def attributes(self) -> dict[str, str]:
        """Unit and meaning, as xarray and others name them."""
        found = {"units": self.units, "long_name": self.meaning}
        return found | ({"worst": self.worst} if self.worst else {})


_UNTIL = "of a diverged robot until then"
_SINCE = f"from the scenario's `after` on, {_UNTIL}"
_EACH, _EACH_COORDINATE, _EACH_INPUT = ("robot",), ("robot", "coordinate"), ("robot", "input")
_EACH_METRIC = ("robot", "metric")
PER_ROBOT = (
    *("max_error", "rms_error", "max_input", "max_distance", "diverged_at"),
    *("worst_metric", "rms_metric"),
)
"""Names of the arrays with one entry per robot, beside what was drawn."""


def per_robot(scenario: Scenario | Outline) -> dict[str, Variable]:
    """Return the arrays of `PER_ROBOT`; those of metrics where there are any.

    Parameters
    ----------
    scenario : Scenario or Outline
        Whose.
    """
    named = scenario.coordinates, scenario.inputs, scenario.recorded_metrics
    errors, sizes, units = (", ".join(one.unit or "1" for one in each) for each in named)
    found = {
        "max_error": Variable(_EACH_COORDINATE, errors, f"largest |error|, {_SINCE}"),
        "rms_error": Variable(_EACH_COORDINATE, errors, f"root of the mean squared error, {_SINCE}"),
        "max_input": Variable(_EACH_INPUT, sizes, f"largest |input|, {_UNTIL}"),
        "max_distance": Variable(_EACH, "m", f"largest distance from the desired position, {_SINCE}"),
        "diverged_at": Variable(_EACH, "s", "when the loop diverged; NaN where it did not"),
    }
    if scenario.recorded_metrics:
        worst = f"largest size, or smallest margin, of what else is judged, {_SINCE}"
        each = ", ".join(one.worst for one in scenario.recorded_metrics)
        found["worst_metric"] = Variable(_EACH_METRIC, units, worst, each)
        found["rms_metric"] = Variable(_EACH_METRIC, units, f"root of its mean square, {_SINCE}")
    return found


SUMMED = ("counts", "quantiles")
"""Names of the arrays that are summed up over all robots."""


def over_all(channels: Sequence[Metric]) -> dict[str, Variable]:
    """Return the arrays of `SUMMED`.

    Parameters
    ----------
    channels : sequence of Metric
        What is counted.
    """
    counted = "how many robots have this size; what diverged counts in the last bin, of margins in the first"
    within = "share `level` of the robots errs at most by this, or has at least this margin"
    units = ", ".join(one.unit or "1" for one in channels)
    return {
        "counts": Variable(("time", "channel", "bin"), "1", counted),
        "quantiles": Variable(("channel", "level", "time"), units, within),
    }


def drawn_name(parameter: str) -> str:
    """Return what the array of a parameter's draws is called: a slash would make a group of a store of it."""
    return f"drawn_{parameter.replace('/', '.')}"


def drawn(parameters: Mapping[str, Parameter]) -> dict[str, Variable]:
    """Return the arrays of what was drawn for each robot."""
    return {
        drawn_name(name): Variable(_EACH, one.unit or "1", f"drawn {one.meaning}; NaN where not spread")
        for name, one in parameters.items()
    }


def quantiles_of(counts: NDArray[np.int32], levels: Array, channels: Sequence[Metric]) -> dict[str, Array]:
    """Return the quantiles over time of each channel, shape (L, G), by name.

    Parameters
    ----------
    counts : ndarray of int, shape (G, channels, BINS)
        Of all robots.
    levels : ndarray, shape (L,)
        Shares of the robots.
    channels : sequence of Metric
        What is counted.
    """
    return {
        one.name: quantiles(counts[:, k].astype(np.int64), levels, margins=one.is_margin)
        for k, one in enumerate(channels)
    }


def summed(counts: NDArray[np.int32], channels: Sequence[Metric]) -> dict[str, Array | NDArray[np.int32]]:
    """Return the arrays of `SUMMED`; the arguments are those of `quantiles_of`."""
    found = quantiles_of(counts, np.array(LEVELS), channels)
    return {"counts": counts, "quantiles": np.array(list(found.values()))}


def coordinates(scenario: Scenario | Outline) -> list[tuple[str, Sequence[Any], str, str]]:
    """Return name, values, unit and meaning of the coordinates of all dimensions but ``robot``.

    Parameters
    ----------
    scenario : Scenario or Outline
        Whose.
    """
    names, inputs, metrics = (
        [one.name for one in each]
        for each in (scenario.coordinates, scenario.inputs, scenario.recorded_metrics)
    )
    told = ", ".join(f"{one.meaning} [{one.unit or '1'}]" for one in scenario.channels)
    judged = ", ".join(one.meaning for one in scenario.recorded_metrics)
    return [
        ("time", scenario.grid.tolist(), "s", "time"),
        ("coordinate", list(names), "1", "coordinate"),
        ("input", list(inputs), "1", "input"),
        ("channel", [one.name for one in scenario.channels], "1", told),
        ("level", list(LEVELS), "1", "share of the robots"),
        (
            "bin",
            edges()[:-1].tolist(),
            "as of the channel",
            "lower edge; the upper one is the next bin's lower one; of a margin m, of m + sqrt(m^2 + 2^-24)",
        ),
        *([("metric", metrics, "1", judged)] if metrics else []),
    ]


def dataset_of(ensemble: Any, attributes: Mapping[str, Any]) -> Any:
    """Return an ensemble as an xarray.Dataset.

    Parameters
    ----------
    ensemble : Ensemble
        What is told.
    attributes : mapping
        Of the whole.

    Raises
    ------
    InvalidArgument
        If xarray is not installed.
    """
    xarray = imported("xarray", "sweeps", "a Dataset")
    scenario = ensemble.scenario
    variables = {**_per_robot(ensemble), **over_all(scenario.channels)}
    arrays = summed(ensemble.counts, scenario.channels)
    arrays |= {name: array for name, _, array in _arrays(ensemble)}
    axes = {
        name: (name, values, {"units": unit, "long_name": meaning})
        for name, values, unit, meaning in coordinates(scenario)
    }
    return xarray.Dataset(
        # Copied, because what xarray hands out may be written into.
        {name: (one.dimensions, arrays[name].copy(), one.attributes) for name, one in variables.items()},
        axes,
        {"Conventions": NOTE, "errors_from_s": scenario.after, **attributes},
    )


def columns_of(ensemble: Any) -> tuple[list[str], list[Array]]:
    """Return the arrays with one entry per robot as the columns of a table, and their names with units."""
    header, columns = ["robot"], [np.arange(len(ensemble), dtype=np.float64)]
    named: Mapping[str, Sequence[Any]] = {
        "coordinate": ensemble.scenario.coordinates,
        "input": ensemble.scenario.inputs,
        "metric": ensemble.scenario.recorded_metrics,
    }
    for name, one, array in _arrays(ensemble):
        each = [(f"{name}_{part.name}", part.unit) for part in named.get(one.dimensions[-1], ())]
        known = each or [(name, one.units)]
        header += [f"{of} [{unit}]" if unit not in ("", "1") else of for of, unit in known]
        columns.append(array)
    return header, columns


def _per_robot(ensemble: Any) -> dict[str, Variable]:
    scenario = ensemble.scenario
    return {**drawn(scenario.parameters), **per_robot(scenario)}


def _arrays(ensemble: Any) -> Iterator[tuple[str, Variable, Array]]:
    draws = {drawn_name(name): values for name, values in ensemble.draws.items()}
    for name, one in _per_robot(ensemble).items():
        yield name, one, getattr(ensemble, name) if name in PER_ROBOT else draws[name]


def content_of(ensemble: Any) -> dict[str, Any]:
    """Return all that a file of an ensemble keeps: its scenario in words, and what each array is."""
    outline = Outline.of(ensemble.scenario)
    own = {each.name: getattr(ensemble, each.name) for each in fields(ensemble)}
    return own | {
        "scenario": outline,
        "traces": {i: trace.content() for i, trace in ensemble.traces.items()},
        "variables": {**per_robot(outline), **drawn(outline.parameters)},
    }


_ROUNDING = 4 * float(np.finfo(np.float64).eps)  # of a share such as 0.07, and of its product with a count


class Part(NamedTuple):
    """The records of m robots.

    Attributes
    ----------
    lived : ndarray of int, shape (m,)
        Samples before the loop diverged; all of them where it did not.
    max_error : ndarray, shape (m, c)
        Largest |error| of the reference's c coordinates in those of these samples from `Scenario.after` on.
    max_distance : ndarray, shape (m,)
        Largest distance from the desired position [m].
    rms_error : ndarray, shape (m, c)
        Root of the mean squared error.
    max_input : ndarray, shape (m, nu)
        Largest |input|.
    worst_metric, rms_metric : ndarray, shape (m, j)
        Worst, and root of the mean square, of each metric, in the samples of which errors are kept.
    counts : ndarray of int, shape (G, channels, BINS)
        At each time of the grid, how many robots have a distance, and so on, of which size; see
        `Scenario.channels`.
    """

    lived: NDArray[np.int64]
    max_error: Array
    max_distance: Array
    rms_error: Array
    max_input: Array
    worst_metric: Array
    rms_metric: Array
    counts: NDArray[np.int32]

    @classmethod
    def of(cls, scenario: Scenario, record: Mapping[str, Array], counts: NDArray[np.int32]) -> Part:
        """Return what a `Summary` kept of m robots, its arrays with the robots as their first axis."""
        lived = record["lived"].astype(np.int64)
        kept = np.maximum(lived - scenario.begin, 1)[:, None]
        none = np.zeros((len(lived), 0))
        signs = np.array([-1.0 if one.is_margin else 1.0 for one in scenario.recorded_metrics])
        return cls(
            lived,
            record["largest"].copy(),  # not a view of all that the robots kept
            np.sqrt(record["farthest"][:, 0]),
            np.sqrt(record["squares"] / kept),
            record["inputs"].copy(),
            record.get("worst", none) * signs,
            np.sqrt(record.get("metric_squares", none) / kept),
            counts,
        )

    @classmethod
    def joined(cls, parts: Iterable[Part]) -> Part:
        """Return the records of all robots of some parts, in their order."""
        columns: list[list[Any]] = [[] for _ in cls._fields[:-1]]
        counts: Any = 0
        for *own, counted in parts:
            counts = counts + counted
            for column, rows in zip(columns, own, strict=True):
                column.append(rows)
        # One after the other, so that hardly anything is in memory twice.
        return cls._make([*(np.concatenate(columns.pop(0)) for _ in cls._fields[:-1]), counts])


class Member(NamedTuple):
    """One robot of an ensemble: ``simulate(*member[:3], **member.options)`` runs it alone.

    Attributes
    ----------
    robot, controller, trajectory
        As in `simulate`.
    options : dict
        The other arguments of `simulate`.
    """

    robot: Any
    controller: Controller
    trajectory: Trajectory
    options: dict[str, Any]


def member_of(scenario: Scenario, i: int, drawn: Mapping[str, Array] | None = None) -> Member:
    """Return robot i as the arguments of `simulate`.

    Parameters
    ----------
    scenario : Scenario
        Whose robot.
    i : int
        Its index, 0 <= i < n.
    drawn : mapping of str to ndarray, shape (1,), optional
        What was drawn for it.
    """
    draws = scenario.draws(i, i + 1) if drawn is None else drawn
    values = scenario.values(draws, i, i + 1).items()
    own_values = {path: value[0] for path, value in values if not path.startswith("start")}
    loop = parts.replace(scenario.loop, own_values)
    own = scenario.references(draws, 1, i)
    q, v = scenario.starts(draws, 1, own)
    options = {
        "dt": scenario.dt,
        "duration": scenario.duration if own is None else float(scenario.t[-1]),
        "q0": q[0],
        "v0": v[0],
        "integrator": scenario.integrator,
        "substeps": scenario.substeps,
        "forces": loop.forces,
        "limit": scenario.limit,
    }
    if scenario.is_noisy:
        options |= {"seed": scenario.seed, "member": i}
    return Member(loop.plant, loop.controller, loop.trajectory, options)


def edges() -> Array:
    """Return the edges of the bins, shape (BINS + 1,), from 0 to infinity."""
    inner = (np.arange(FIRST, FIRST + BINS - 1, dtype=np.int64) << SHIFT).view(np.float64)
    return np.concatenate([[0.0], inner, [np.inf]])


def bins_of(values: Array) -> NDArray[np.int64]:
    """Return the bins of numbers >= 0, infinity included, shape (...)."""
    bits = np.ascontiguousarray(values).view(np.int64) >> SHIFT
    return np.asarray(np.clip(bits - FIRST + 1, 0, BINS - 1))


def checked_share(value: ArrayLike) -> float:
    """Return a share as a float.

    Raises
    ------
    InvalidArgument
        If it is not one number from 0 to 1.
    """
    return bounded("share", scalar("share", value), least=0, most=1)


def checked_levels(value: ArrayLike) -> Array:
    """Return the levels of quantiles as an array, shape (m,).

    Raises
    ------
    InvalidArgument
        If one is not between 0 and 1.
    """
    found = shaped("levels", np.atleast_1d(finite("levels", value)), ("n>=1",))
    return bounded("levels", found, least=0, most=1)


def share_within(values: Array, share: float, axis: int = -1) -> Array:
    """Return the least of the values that a share of them does not exceed; NaN where one is NaN.

    Parameters
    ----------
    values : ndarray
        Along `axis`, at least one.
    share : float
        From 0 to 1; of 0, the smallest value.
    axis : int
        The axis that is reduced.
    """
    place = max(int(np.ceil(_rank(share, values.shape[axis]))), 1) - 1
    found = np.take(np.partition(values, place, axis), place, axis)
    return np.where(np.isnan(values).any(axis), np.nan, found)


def _rank(share: float, count: int | NDArray[np.int64]) -> Array:
    """Return the share of a count, a whole number where it is one but for rounding (0.07 of 100 is 7)."""
    rank = np.asarray(share * count)
    return np.where(np.abs(rank - np.round(rank)) <= _ROUNDING * rank, np.round(rank), rank)


def quantiles(counts: NDArray[np.int64], wanted: Array, *, margins: bool = False) -> Array:
    """Return quantiles from counts: what shares of the robots are within.

    Within a bin the numbers are taken to lie evenly in the logarithm: a quantile is off by the width
    of its bin, 2 to 3 %, at most.

    Parameters
    ----------
    counts : ndarray of int, shape (..., BINS)
        How many are in each bin; at least one in all.
    wanted : ndarray, shape (m,)
        Levels from 0 to 1.
    margins : bool
        Whether these are sizes of margins, see `pinmobile.metrics.size_of`: then a share of the robots has
        at least what is returned, in numbers of the margin.

    Returns
    -------
    quantiles : ndarray, shape (m, ...)
        Infinite where it falls in the last bin, of margins minus infinity in the first.
    """
    bounds = edges()
    if margins:
        # From the best to the worst; of what is in the best bin only its lower edge is known.
        counts, bounds = counts[..., ::-1], np.append(bounds[-2], bounds[-2::-1])
    total = counts.cumsum(axis=-1)
    found = np.empty((len(wanted), *counts.shape[:-1]))
    for k, level in enumerate(wanted):
        rank = _rank(level, total[..., -1:])
        # The first bin whose total reaches the rank, and is not empty.
        bin_ = np.minimum((total < np.maximum(rank, 1e-9)).sum(axis=-1), BINS - 1)
        inside = np.take_along_axis(counts, bin_[..., None], -1)[..., 0]
        before = np.take_along_axis(total, bin_[..., None], -1)[..., 0] - inside
        part = (rank[..., 0] - before) / np.maximum(inside, 1)
        low, high = bounds[bin_], bounds[bin_ + 1]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            between = low * (high / low) ** part
        if margins:
            found[k] = value_of(np.where(bin_ == BINS - 1, 0.0, between))
            continue
        found[k] = np.where(bin_ == 0, bounds[1] * part, np.where(bin_ == BINS - 1, np.inf, between))
    return found


_FORMAT = "pinmobile ensemble 5"
_V = TypeVar("_V")


class _ByChannel(Generic[_V]):
    """What an ensemble says of each of `Scenario.channels`, by name."""

    def __getitem__(self, name: str) -> _V:
        named: Mapping[str, _V] = next(x for x in vars(self).values() if isinstance(x, Mapping))
        return named[one_of("channel", name, named)]

    @property
    def distance(self) -> _V:
        """That of the distance from the desired position [m]."""
        return self["distance"]

    @property
    def heading(self) -> _V:
        """That of the error of the heading [rad]."""
        return self["heading"]


@dataclass(frozen=True, eq=False)
class Bands(_ByChannel[Array]):
    """Quantiles over the robots, as functions of time.

    ``bands["end effector"]``, shape (L, G), are those of one of `Scenario.channels`: that share of the robots
    errs at most by this, or has at least this margin; infinite, or minus infinity, where fewer have not
    diverged.

    Attributes
    ----------
    t : ndarray, shape (G,)
        Times [s].
    levels : ndarray, shape (L,)
        Shares of the robots.
    quantiles : mapping of str to ndarray, shape (L, G)
        All of them by name.
    """

    t: Array
    levels: Array
    quantiles: Mapping[str, Array]


@dataclass(frozen=True)
class ErrorQuantile(_ByChannel[float]):
    """What a share of the robots stays within, all the time.

    ``within["tip-over margin"]`` is that of one of `Scenario.channels`: the share errs at most by this, or
    has at least this margin; infinite, or minus infinity, where fewer have not diverged.

    Attributes
    ----------
    sizes : mapping of str to float
        All of them by name.
    """

    sizes: Mapping[str, float]


@dataclass(frozen=True, eq=False, repr=False)
class Ensemble:
    """The records of n robots.

    Attributes
    ----------
    scenario : Scenario or Outline
        What was run; an `Outline`, its parts in words, after loading a file without the scenario.
    draws : dict of str to ndarray, shape (n,)
        What each robot got of each parameter that is spread.
    max_error, rms_error : ndarray, shape (n, c)
        Largest, and root of the mean squared, error of the reference's coordinates, x, y and psi first, from
        `Scenario.after` on [m, m, rad, ...]; of a diverged robot until then, NaN where it diverged before
        that time or at the start.
    max_distance : ndarray, shape (n,)
        Largest distance from the desired position [m], likewise.
    max_input : ndarray, shape (n, nu)
        Largest |input| from the start on, such as [N, N, N m]; of a diverged robot until then, NaN where
        there is none. `Scenario.coordinates` and `Scenario.inputs` have names and units.
    worst_metric, rms_metric : ndarray, shape (n, j)
        Worst, and root of the mean square, of each of `Scenario.recorded_metrics`: the largest size, or the
        smallest margin, likewise from `Scenario.after` on.
    diverged_at : ndarray, shape (n,)
        When the loop diverged [s]; NaN where it did not.
    counts : ndarray of int, shape (G, channels, BINS)
        At each time of `Scenario.grid`, how many robots have a distance, an error of the heading, and so on
        of `Scenario.channels`, of which size, see `pinmobile.loop._ensemble`.
    traces : dict of int to Rollout
        Everything of the robots that were asked for; of a diverged one until then.
    engine : str
        How they were run: ``"COMPILED"``, or ``"PYTHON"``, one after another.
    fallback_reason : str
        Why not by a faster engine; "" where there is none.
    """

    scenario: Any
    draws: Mapping[str, Array]
    max_error: Array
    rms_error: Array
    max_distance: Array
    max_input: Array
    worst_metric: Array
    rms_metric: Array
    diverged_at: Array
    counts: NDArray[np.int32]
    traces: Mapping[int, Rollout]
    engine: str = ""
    fallback_reason: str = ""

    def __post_init__(self) -> None:
        for array in (*self.draws.values(), *(getattr(self, name) for name in (*PER_ROBOT, "counts"))):
            array.setflags(write=False)

    @classmethod
    def of(
        cls,
        scenario: Scenario,
        draws: Mapping[str, Array],
        part: Part,
        traces: Iterable[int] = (),
        engine: str = "",
        fallback_reason: str = "",
    ) -> Ensemble:
        """Return the ensemble of all records of a scenario.

        Parameters
        ----------
        scenario : Scenario
            What was run.
        draws : mapping of str to ndarray, shape (n,)
            What was drawn.
        part : Part
            The records of all n.
        traces : iterable of int
            Robots of which a whole `Rollout` is made.
        engine, fallback_reason : str
            How they were run, and why not by a faster engine.
        """
        own = part._asdict()
        lived = own.pop("lived")
        for name in ("max_error", "max_distance", "rms_error", "worst_metric", "rms_metric"):
            own[name][lived <= scenario.begin] = np.nan
        own["max_input"][lived == 0] = np.nan
        own["diverged_at"] = np.append(scenario.t, np.nan)[np.minimum(lived, len(scenario.t))]
        own |= {"traces": {}, "engine": engine, "fallback_reason": fallback_reason}
        made = cls(scenario=scenario, draws=dict(draws), **own)
        object.__setattr__(made, "traces", {i: made.trace(i) for i in traces})
        return made

    def __len__(self) -> int:
        return int(self.scenario.n)

    @property
    def diverged(self) -> NDArray[np.bool_]:
        """Which robots diverged, shape (n,)."""
        return ~np.isnan(self.diverged_at)

    @property
    def events(self) -> tuple[str, ...]:
        """What some robots do from `Scenario.after` on that is worth a warning, such as tipping over."""
        happened = zip(self.scenario.recorded_metrics, (self.worst_metric > 0).sum(axis=0), strict=True)
        told = [(one, int(count)) for one, count in happened if one.worst == "ever" and count]
        return tuple(f"{count:,} of {len(self):,} robots {one.name}: {one.meaning}" for one, count in told)

    def error_quantile(self, share: float = 0.99) -> ErrorQuantile:
        """Return what a share of the robots stays within, exactly, a diverged one being beyond everything.

        From `Scenario.after` on, all the time.

        Raises
        ------
        InvalidArgument
            If `share` is not between 0 and 1.
        """
        level, found = checked_share(share), {}
        for one in self.scenario.channels:
            size = float(share_within(self._badness(one.name), level))
            found[one.name] = -size if one.is_margin else size
        return ErrorQuantile(found)

    def _badness(self, by: str) -> Array:
        """Return what is the larger the worse a robot is, shape (n,), infinite where it diverged."""
        values = self.largest(by)
        margins = [one.name for one in self.scenario.recorded_metrics if one.is_margin]
        return np.where(self.diverged, np.inf, -values if by in margins else values)

    def bands(self, levels: ArrayLike = (0.5, 0.9, 0.99)) -> Bands:
        """Return quantiles of the errors over time, to the width of a bin, 2 to 3 %.

        Parameters
        ----------
        levels : array_like, shape (L,)
            Shares of the robots, from 0 to 1.

        Raises
        ------
        InvalidArgument
            If one is not.
        """
        wanted = checked_levels(levels)
        found = quantiles_of(self.counts, wanted, self.scenario.channels)
        return Bands(self.scenario.grid, wanted, found)

    def worst(self, count: int = 5, by: str = "distance") -> NDArray[np.intp]:
        """Return the robots that did worst, the worst first, shape (count,), or (n,) where there are fewer.

        Those that diverged come first, in order of time; then those whose largest error is largest, or whose
        smallest margin is smallest.

        Parameters
        ----------
        count : int
            How many, at the most.
        by : str
            By what, see `largest`.

        Raises
        ------
        InvalidArgument, UnknownName
            If `count` is no whole number >= 1, or there is no such error.
        """
        earliest = np.where(self.diverged, self.diverged_at, np.inf)
        return np.lexsort((-self._badness(by), earliest))[: whole("count", count)]

    def largest(self, by: str = "distance") -> Array:
        """Return each robot's largest error, or smallest margin, shape (n,).

        Parameters
        ----------
        by : str
            "distance" from the desired position [m], "heading" [rad], a coordinate of the reference by its
            name, or one of `Scenario.recorded_metrics`, such as "end effector" [m] and "tip-over margin" [m].

        Raises
        ------
        UnknownName
            If there is no such error.
        """
        errors = {"distance": self.max_distance, "heading": self.max_error[:, 2]}
        coordinates = zip(self.scenario.coordinates, self.max_error.T, strict=True)
        errors |= {one.name: column for one, column in coordinates}
        metrics = zip(self.scenario.recorded_metrics, self.worst_metric.T, strict=True)
        errors |= {one.name: column for one, column in metrics}
        return errors[one_of("error", by, errors)]

    def member(self, i: int) -> Member:
        """Return robot i as the arguments of `simulate`.

        Raises
        ------
        InvalidArgument
            If there is no such robot, or the parts of the scenario are known in words alone.
        """
        index = self._index(i)
        if isinstance(self.scenario, Outline):
            raise InvalidArgument(
                f"i is {index}, a robot that cannot be made again: a file keeps the scenario in words (its "
                f"controller is {self.scenario.controller}); expected the ensemble of "
                "Ensemble.load(path, scenario), with the Scenario that was run"
            )
        return member_of(self.scenario, index)

    def _index(self, i: int) -> int:
        return whole("i", i, least=0, most=len(self) - 1)

    def trace(self, i: int) -> Rollout:
        """Return everything of robot i, kept or made by `simulate`: the same numbers but for rounding.

        Rounding stays small where the loop holds the robot to its reference. Where the loop is chaotic it
        grows until the two have nothing in common but their bounds, as do any two ways of computing it.

        Raises
        ------
        InvalidArgument
            If there is no such robot, or it is not kept and cannot be made, see `member`.
        Diverged
            If it is beyond the limit from the start.
        """
        if self._index(i) in self.traces:
            return self.traces[self._index(i)]
        member = self.member(i)
        try:
            return simulate(*member[:3], **member.options)
        except Diverged as diverged:
            if diverged.rollout is None:
                raise
            rollout: Rollout = diverged.rollout
            return rollout

    def save(self, path: str | PathLike[str]) -> None:
        """Write everything, to the last digit, as a NumPy archive (``.npz``); what is there is replaced.

        The parts of the scenario are kept in words, see `Outline`: whoever loads the file needs none of their
        classes.

        Raises
        ------
        InvalidArgument
            If the file cannot be written.
        FileError
            If the system fails, such as of a full disk; what was there is there still.
        """
        write_archive(path, _FORMAT, content_of(self))

    @classmethod
    def load(cls, path: str | PathLike[str], scenario: Scenario | None = None) -> Ensemble:
        """Return what `save` wrote.

        Parameters
        ----------
        path : path
            The file.
        scenario : Scenario, optional
            What was run: needed for `member`, and for `trace` of robots that are not kept, since a file
            holds numbers and words, no objects.

        Raises
        ------
        InvalidArgument
            If the file cannot be read, is damaged, is not such an archive, or is not of that scenario.
        FileError
            If the system fails.
        """
        file = location("path", path)
        known = None if scenario is None else Outline.of(scenario)
        made = read_archive(file, _FORMAT, cls._of_content)
        if scenario is None or known is None:
            return made
        found = made.scenario.difference(known)
        drawn = {} if found else scenario.draws()
        for name, values in drawn.items():
            if not alike(made.draws[name], values):
                found = f"it draws another {name}"
        if found:
            raise InvalidArgument(f"scenario is not that of {str(file)!r}: {found}")
        return replace(made, scenario=scenario)

    @classmethod
    def _of_content(cls, content: dict[str, Any]) -> Ensemble:
        del content["variables"]
        traces = {i: Rollout.of(each) for i, each in content.pop("traces").items()}
        return cls(**content, traces=traces)

    def to_xarray(self) -> Any:
        """Return the records as an xarray.Dataset, with the names that they have in the store of a sweep.

        Returns
        -------
        dataset : xarray.Dataset
            Dimensions ``robot``, ``coordinate``, ``input``, ``metric`` (where there is one), ``time``,
            ``channel``, ``level`` and ``bin``;
            each variable has attributes ``units`` and ``long_name``. What was drawn is ``drawn_mass`` and so
            on. Attribute ``scenario`` describes the run. The traces, which may differ in length,
            are not in it.

        Raises
        ------
        InvalidArgument
            If xarray is not installed.
        """
        return dataset_of(self, {"scenario": str(Outline.of(self.scenario)), "seed": self.scenario.seed})

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write one line per robot, with a header that has the units, and 17 significant digits.

        The columns are the robot's index, what was drawn for it (``drawn_mass [kg]`` and so on), its largest
        and rms errors, largest forces and distance, when it diverged, ``nan`` where it did not, and what else
        is judged, worst and rms.

        Raises
        ------
        InvalidArgument
            If the file cannot be written.
        FileError
            If the system fails, such as of a full disk; what was there is there still.
        """
        write_table(path, *columns_of(self))

    def __repr__(self) -> str:
        return f"<Ensemble: {self._judgement()}>"

    def __str__(self) -> str:
        samples = f"seed {self.scenario.seed}, {len(self.scenario.t)} samples each"
        named = self.scenario.coordinates, self.scenario.inputs
        judged = self.worst_metric, self.scenario.recorded_metrics
        rows = ranges(self.max_distance, self.max_error, self.max_input, *named, *judged)
        words = [str(self.scenario)] if isinstance(self.scenario, Outline) else []
        return "\n".join([self._judgement(), samples, *rows, *words])

    def _judgement(self) -> str:
        within, counted = self.error_quantile(0.99), (int(self.diverged.sum()), self.scenario.after)
        words = judgement(len(self), self.scenario.t[-1], (within.distance, within.heading), *counted)
        return "; ".join([words, *self.events])
