"""`Ensemble`: the results of the robots of a scenario, and the numbers that its worst robots share."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from os import PathLike
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike, check_integer, location, one_of, scalar
from pinmobile.errors import Diverged, InvalidArgument
from pinmobile.files import check_match, read_archive, write_archive, write_table
from pinmobile.loop._description import (
    ROBOT_ARRAYS,
    Arguments,
    Outline,
    Part,
    are_close,
    arguments_of,
    check_levels,
    check_share,
    columns_of,
    content_of,
    dataset_of,
    format_result,
    quantiles_of,
    share_quantile,
)
from pinmobile.loop._rollout import Rollout
from pinmobile.loop._scenario import Scenario
from pinmobile.loop._simulate import simulate
from pinmobile.loop._spread import SameAs
from pinmobile.metrics import Metric, format_si
from pinmobile.parts import shorten
from pinmobile.plant import exceeded_efforts
from pinmobile.signals import Signal

_CHANCE = 0.01  # that any of the parameters without effect is named
_SIDE_SHARE = 0.1  # share of the statistic below which one side counts as chance


class Cause(NamedTuple):
    """A parameter and the interval in which the worst robots have it.

    Attributes
    ----------
    name, unit : str
        Name and unit of the parameter.
    values : ndarray, shape (n,)
        Value of each robot.
    difference : float
        Kuiper's statistic of the worst against the others, 0 to 1.
    visible : bool
        Whether the difference is more than chance: by chance, any of the parameters is visible in 1 % of all
        ensembles.
    low, high : float
        Interval (low, high] of the worst robots; bounds may be infinite.
    outside : bool
        Whether the worst robots are outside the interval instead.
    """

    name: str
    unit: str
    values: Array
    difference: float
    visible: bool
    low: float
    high: float
    outside: bool

    @property
    def label(self) -> str:
        """Name and unit as an axis label."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @property
    def place(self) -> str:
        """Interval of the worst robots, in words."""
        unit = f" {self.unit}" if self.unit else ""
        if self.outside:
            return f"below {self.low:.3g} or above {self.high:.3g}{unit}"
        if np.isinf(self.low):
            return f"below {self.high:.3g}{unit}"
        if np.isinf(self.high):
            return f"above {self.low:.3g}{unit}"
        return f"from {self.low:.3g} to {self.high:.3g}{unit}"

    def holds(self, values: Array) -> NDArray[np.bool_]:
        """Return which values are in the interval of the worst robots."""
        is_inside = (values > self.low) & (values <= self.high)
        return ~is_inside if self.outside else is_inside


def worst_share(ensemble: Any, share: float, by: str = "distance") -> NDArray[np.bool_]:
    """Return a mask of the worst robots, shape (n,): the first of `Ensemble.worst`, or all with an event.

    If more robots diverged than this share, they are the worst robots.

    Raises
    ------
    InvalidArgument, UnknownName
        If `share` is outside (0, 1) or leaves no robot on one side, or there is no error of this name.
    """
    part, n = scalar("share", share), len(ensemble)
    count = round(part * n)
    if not (0 < part < 1 and 0 < count < n):
        expected = "above 0 and below 1, with at least 1 robot on each side"
        raise InvalidArgument(f"share is {part}, {count:,} of {n:,} robots, expected {expected}")
    happens = np.asarray(ensemble.largest(by) > 0)
    if is_event(ensemble, by) and 0 < happens.sum() < n:
        return happens
    if count < ensemble.diverged.sum() < n:
        return np.asarray(ensemble.diverged)
    worst = np.zeros(n, bool)
    worst[ensemble.worst(count, by)] = True
    return worst


def is_event(ensemble: Any, by: str) -> bool:
    """Return whether a name of `Ensemble.largest` is an event, which a robot has or has not."""
    return any(metric.name == by and metric.worst == "ever" for metric in ensemble.scenario.channels)


def causes(ensemble: Any, worst: NDArray[np.bool_]) -> list[Cause]:
    """Return the parameters that differ between robots, in descending order of Kuiper's statistic.

    Parameters
    ----------
    ensemble : Ensemble
        Ensemble of robots.
    worst : ndarray of bool, shape (n,)
        Mask of the worst robots.

    Raises
    ------
    InvalidArgument
        If all robots have the same parameters.
    """
    parameters = [one for one in _parameters(ensemble) if np.ptp(one[2]) > 1e-12 * np.abs(one[2]).max()]
    if not parameters:
        message = "ensemble has robots with the same parameters"
        raise InvalidArgument(f"{message}, expected a spread of at least one parameter")
    rows = (_cause(*one, worst, _CHANCE / len(parameters)) for one in parameters)
    return sorted(rows, key=lambda one: -one.difference)


def _parameters(ensemble: Any) -> list[tuple[str, str, Array]]:
    """Return name, unit and values of each independent parameter; for `SameAs`, the factor."""
    rows, short_names = [], dict(zip(ensemble.draws, shorten(ensemble.draws), strict=True))
    for name, values in ensemble.draws.items():
        source = ensemble.scenario.spread[name]
        if isinstance(source, SameAs) and (base := ensemble.draws.get(source.name)) is not None:
            ratio = np.divide(values, base, out=np.ones_like(values), where=base != 0)
            rows.append((f"{short_names[name]} / {short_names[source.name]}", "", ratio))
        else:
            rows.append((short_names[name], ensemble.scenario.parameters[name].unit, values))
    return rows


def _cause(name: str, unit: str, values: Array, worst: NDArray[np.bool_], chance: float) -> Cause:
    # scipy.stats is slow to load, and other figures do not need it.
    from scipy.stats import ks_2samp

    bad, good = values[worst], values[~worst]
    # Up to `high`, the excess of the worst robots is largest; up to `low`, the excess of the others.
    above, below = (ks_2samp(bad, good, alternative=side, method="asymp") for side in ("greater", "less"))
    high, low = float(above.statistic_location), float(below.statistic_location)
    difference = float(above.statistic + below.statistic)
    size = np.sqrt(len(bad) * len(good) / len(values))
    # Kuiper's test: Stephens, J. R. Stat. Soc. B 32 (1970).
    square = max(1.0, difference * (size + 0.155 + 0.24 / size)) ** 2
    visible = bool((8 * square - 2) * np.exp(-2 * square) < chance)
    if above.statistic <= _SIDE_SHARE * difference:
        high = np.inf
    elif below.statistic <= _SIDE_SHARE * difference:
        low = -np.inf
    outside = high < low
    low, high = sorted((low, high))
    return Cause(name, unit.replace("^2", "²"), values, difference, visible, low, high, outside)


_FORMAT = "pinmobile ensemble 6"
_SHARE, _MIN_ROBOTS, _MAX_CAUSES = 0.05, 40, 3  # share of the worst, robots that it needs, numbers in a line
_MIN_WIDTH = 28  # smallest width of a row's name
_V = TypeVar("_V")


class _Channels(Generic[_V]):
    """Values of each of `Scenario.channels`, by name."""

    def __getitem__(self, name: str) -> _V:
        values: Mapping[str, _V] = next(x for x in vars(self).values() if isinstance(x, Mapping))
        return values[one_of("channel", name, values)]

    @property
    def distance(self) -> _V:
        """Value of the distance from the desired position [m]."""
        return self["distance"]

    @property
    def heading(self) -> _V:
        """Value of the heading error [rad]."""
        return self["heading"]


@dataclass(frozen=True, eq=False)
class Bands(_Channels[Array]):
    """Quantiles over the robots as functions of time; `Ensemble.bands` returns them.

    ``bands["end effector"]``, shape (L, G), contains the quantiles of one of `Scenario.channels`. At each
    time, this share of the robots has at most this error, or at least this margin. The quantile is infinite
    (of a margin: minus infinity) if too many robots have diverged, or exceed 1e9 or, of a margin, 5e8.

    Attributes
    ----------
    t : ndarray, shape (G,)
        Times [s].
    levels : ndarray, shape (L,)
        Quantile levels: shares of the robots.
    quantiles : mapping of str to ndarray, shape (L, G)
        Quantiles by the name of the channel.

    See Also
    --------
    Ensemble.bands : quantiles of an ensemble.
    Ensemble.error_quantile : quantile over the whole run.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.loop import Bands
    >>> rows = {"distance": np.array([[0.0, 0.1]])}  # [m]
    >>> bands = Bands(np.array([0.0, 1.0]), np.array([0.5]), rows)
    >>> bands.distance[0]  # [m]
    array([0. , 0.1])
    """

    t: Array
    levels: Array
    quantiles: Mapping[str, Array]


@dataclass(frozen=True)
class ErrorQuantile(_Channels[float]):
    """Quantile of the largest errors of the robots; `Ensemble.error_quantile` returns it.

    ``quantile["tip-over margin"]`` is the value of one of `Scenario.channels`: the share of the robots has at
    most this error, or at least this margin, during the whole run. The value is infinite (of a margin: minus
    infinity) if too many robots have diverged.

    Attributes
    ----------
    sizes : mapping of str to float
        Values by the name of the channel.

    See Also
    --------
    Ensemble.error_quantile : quantile of an ensemble.
    Ensemble.bands : quantiles over time.

    Examples
    --------
    >>> from pinmobile.loop import ErrorQuantile
    >>> quantile = ErrorQuantile({"distance": 0.08, "heading": 0.02})
    >>> quantile.distance, quantile["heading"]  # [m], [rad]
    (0.08, 0.02)
    """

    sizes: Mapping[str, float]


@dataclass(frozen=True, eq=False, repr=False)
class Ensemble:
    """Results of n robots.

    Attributes
    ----------
    scenario : Scenario or Outline
        Scenario of the runs. After loading a file without the scenario, it is an `Outline` with the parts as
        text.
    draws : dict of str to ndarray, shape (n,)
        Value of each number of the spread for each robot, by name.
    max_error, rms_error : ndarray, shape (n, c)
        Largest and root mean square error of the reference's coordinates (x, y and psi first) after the time
        `Scenario.after` [m, m, rad, ...]. For a diverged robot, they cover the time before divergence; they
        are NaN if the robot diverged before `Scenario.after` or at the start.
    max_distance : ndarray, shape (n,)
        Largest distance from the desired position in the same time [m].
    max_input : ndarray, shape (n, nu)
        Largest absolute value of each input from the start on, such as [N, N, N m]. For a diverged robot, it
        covers the time before divergence, or is NaN. `Scenario.inputs` has names and units.
    worst_metric, rms_metric : ndarray, shape (n, j)
        Worst value and root mean square of each of `Scenario.recorded_metrics` after the time
        `Scenario.after`: the largest size or the smallest margin.
    diverged_at : ndarray, shape (n,)
        Time of divergence [s]; NaN if the loop did not diverge.
    counts : ndarray of int, shape (G, channels, BINS)
        Number of robots by time of `Scenario.grid`, channel of `Scenario.channels` and bin of sizes.
    traces : dict of int to Rollout
        All samples of the selected robots; of a diverged robot, the samples before divergence.
    engine : str
        Engine that ran the robots: ``"COMPILED"``, or ``"PYTHON"``, one robot after another.
    fallback_reason : str
        Reason why a faster engine could not run the loop; "" if there is none.
    kept : mapping of str to Signal
        Signals of `Scenario.keep` by name, at the times of `Scenario.grid`: values of shape (n, G) or (n, G,
        k), NaN after divergence.

    See Also
    --------
    ensemble : run many robots.
    Scenario : loop and spread of an ensemble.
    sweep : ensembles at the points of a grid.
    plots.bands : figure of the quantiles over time.

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Tangent
    >>> from pinmobile import Uniform, ensemble
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> parts = robot, PD(120, 120), Tangent(Circle(1.0, 0.5, 4.0))
    >>> spread = {"mass": Uniform(20.0, 40.0)}
    >>> runs = ensemble(*parts, n=100, spread=spread, dt=0.02)
    >>> runs.error_quantile(0.99).distance  # [m]
    0.079
    >>> heaviest = runs.worst(1)[0]
    >>> float(runs.draws["mass"][heaviest])  # [kg]
    39.9
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
    kept: Mapping[str, Signal] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for signal in self.kept.values():
            signal.values.setflags(write=False)
        for array in (*self.draws.values(), *(getattr(self, name) for name in (*ROBOT_ARRAYS, "counts"))):
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
        """Return the ensemble of the records of a scenario.

        Parameters
        ----------
        scenario : Scenario
            Scenario of the runs.
        draws : mapping of str to ndarray, shape (n,)
            Values of the numbers of the spread.
        part : Part
            Records of all n robots.
        traces : iterable of int
            Indices of robots whose samples are kept as a `Rollout`.
        engine, fallback_reason : str
            Engine of the runs, and the reason why a faster engine could not run them.

        Returns
        -------
        Ensemble
            Results of the robots.
        """
        arrays = part._asdict()
        lived = arrays.pop("lived")
        for name in ("max_error", "max_distance", "rms_error", "worst_metric", "rms_metric"):
            arrays[name][lived <= scenario.begin] = np.nan
        arrays["max_input"][lived == 0] = np.nan
        arrays["diverged_at"] = np.append(scenario.t, np.nan)[np.minimum(lived, len(scenario.t))]
        arrays |= {"traces": {}, "engine": engine, "fallback_reason": fallback_reason}
        ensemble = cls(scenario=scenario, draws=dict(draws), **arrays)
        object.__setattr__(ensemble, "traces", {i: ensemble.member(i) for i in traces})
        return ensemble

    def __len__(self) -> int:
        return int(self.scenario.n)

    @property
    def diverged(self) -> NDArray[np.bool_]:
        """Whether each robot diverged, shape (n,)."""
        return ~np.isnan(self.diverged_at)

    @property
    def events(self) -> tuple[str, ...]:
        """Sentences about events after `Scenario.after`, such as the number of robots that tip over.

        They count robots with an event or a negative margin among the metrics, and inputs at their limits.
        """
        return tuple(words for _, words in self.format_events())

    def format_events(self) -> list[tuple[bool, str]]:
        """Return the sentences of `events`, each with whether a metric with the rule "ever" states it."""
        lines = []
        for metric in self.scenario.recorded_metrics:
            words = f"have a negative {metric.name}" if metric.is_margin else metric.name
            lines.append((metric.worst == "ever", f"{words}: {metric.meaning}", self._fails(metric)))
        for entry, largest in zip(self.scenario.inputs, self.max_input.T, strict=True):
            words = f"have input {entry.name} at its limit of {entry.upper:.4g} {entry.unit}".rstrip()
            lines.append((False, words, largest >= max(abs(entry.lower), abs(entry.upper))))
        largest_inputs = dict(zip([x.name for x in self.scenario.inputs], self.max_input.T, strict=True))
        for entry, effort, exceeds in exceeded_efforts(self.scenario.robot, largest_inputs):
            words = f"exceed the effort limit of {entry.name}, {effort:.4g} {entry.unit}"
            lines.append((False, words, exceeds))
        count = f"of {len(self):,} robots"
        return [(event, f"{fails.sum():,} {count} {words}") for event, words, fails in lines if fails.any()]

    def _fails(self, metric: Metric) -> NDArray[np.bool_]:
        """Return the robots with an event, or with a negative margin, shape (n,)."""
        values = self.largest(metric.name)
        return (values < 0) if metric.is_margin else (values > 0) & (metric.worst == "ever")

    @property
    def faults(self) -> dict[str, NDArray[np.bool_]]:
        """Robots that diverged, that have an event, or a negative margin, masks of shape (n,) by reason."""
        masks = {"diverged": self.diverged}
        for metric in self.scenario.recorded_metrics:
            masks[f"{metric.name} below 0" if metric.is_margin else metric.name] = self._fails(metric)
        return {reason: robots for reason, robots in masks.items() if robots.any()}

    def error_quantile(self, share: float = 0.99) -> ErrorQuantile:
        """Return the errors that a share of the robots does not exceed after `Scenario.after`.

        The result is exact. A diverged robot has an infinite error.

        Parameters
        ----------
        share : float
            Share of the robots, from 0 to 1.

        Returns
        -------
        ErrorQuantile
            Error or margin of each channel.

        Raises
        ------
        InvalidArgument
            If `share` is not between 0 and 1.
        """
        level, sizes = check_share(share), {}
        for channel in self.scenario.channels:
            size = float(share_quantile(self._badness(channel.name), level))
            sizes[channel.name] = -size if channel.is_margin else size
        return ErrorQuantile(sizes)

    def _badness(self, by: str) -> Array:
        """Return a number that is larger for a worse robot, shape (n,); infinity for a diverged robot."""
        values = self.largest(by)
        margins = [metric.name for metric in self.scenario.recorded_metrics if metric.is_margin]
        return np.where(self.diverged, np.inf, -values if by in margins else values)

    def bands(self, levels: ArrayLike = (0.5, 0.9, 0.99)) -> Bands:
        """Return quantiles of the errors over time; the width of a bin, 2 to 3 %, limits their accuracy.

        Parameters
        ----------
        levels : array_like, shape (L,)
            Quantile levels: shares of the robots, from 0 to 1.

        Returns
        -------
        Bands
            Quantiles of each channel.

        Raises
        ------
        InvalidArgument
            If a level is not between 0 and 1.
        """
        checked = check_levels(levels)
        quantiles = quantiles_of(self.counts, checked, self.scenario.channels)
        return Bands(self.scenario.grid, checked, quantiles)

    def worst(self, count: int = 5, by: str = "distance") -> NDArray[np.intp]:
        """Return the indices of the worst robots, the worst first, shape (count,) or (n,) if n is smaller.

        Diverged robots come first, in order of time. Robots with the largest error or the smallest margin
        follow.

        Parameters
        ----------
        count : int
            Largest number of robots.
        by : str
            Name of an error or metric, see `largest`.

        Returns
        -------
        ndarray of int, shape (count,)
            Indices of robots.

        Raises
        ------
        InvalidArgument, UnknownName
            If `count` is not a whole number >= 1, or there is no such error.
        """
        earliest = np.where(self.diverged, self.diverged_at, np.inf)
        return np.lexsort((-self._badness(by), earliest))[: check_integer("count", count)]

    def largest(self, by: str = "distance") -> Array:
        """Return each robot's largest error, or smallest margin, shape (n,).

        Parameters
        ----------
        by : str
            "distance" from the desired position [m], "heading" [rad], the name of a coordinate of the
            reference, or one of `Scenario.recorded_metrics`, such as "end effector" [m] or "tip-over margin"
            [m].

        Returns
        -------
        ndarray, shape (n,)
            Largest errors or smallest margins.

        Raises
        ------
        UnknownName
            If there is no such error.
        """
        by_name = {"distance": self.max_distance, **self._by_name(self.max_error, self.worst_metric)}
        return by_name[one_of("error", by, by_name)]

    def rms(self, by: str = "heading") -> Array:
        """Return each robot's root mean square of an error or metric, shape (n,).

        Parameters
        ----------
        by : str
            Name as in `largest`, except "distance".

        Returns
        -------
        ndarray, shape (n,)
            Root mean squares after `Scenario.after`.

        Raises
        ------
        UnknownName
            If there is no such error.
        """
        by_name = self._by_name(self.rms_error, self.rms_metric)
        return by_name[one_of("error", by, by_name)]

    def _by_name(self, errors: Array, metrics: Array) -> dict[str, Array]:
        names = [one.name for one in (*self.scenario.coordinates, *self.scenario.recorded_metrics)]
        return {"heading": errors[:, 2]} | dict(zip(names, [*errors.T, *metrics.T], strict=True))

    def arguments(self, i: int) -> Arguments:
        """Return robot i as the arguments of `simulate`.

        Parameters
        ----------
        i : int
            Index of the robot, 0 <= i < n.

        Returns
        -------
        Arguments
            Plant, controller, trajectory and options of this robot.

        Raises
        ------
        InvalidArgument
            If there is no such robot, or a file without its scenario supplied the ensemble.
        """
        index = self._index(i)
        if isinstance(self.scenario, Outline):
            raise InvalidArgument(
                f"i is {index}, a robot that cannot be made again: a file keeps the scenario as text (its "
                f"controller is {self.scenario.controller}); expected the ensemble of "
                "Ensemble.load(path, scenario), with the Scenario of the runs"
            )
        return arguments_of(self.scenario, index)

    def _index(self, i: int) -> int:
        return check_integer("i", i, least=0, most=len(self) - 1)

    def member(self, i: int) -> Rollout:
        """Return all samples of robot i, as kept or as `simulate` computes them.

        Both agree up to rounding. A loop that holds the robot to its reference keeps the difference small. A
        chaotic loop amplifies it.

        Parameters
        ----------
        i : int
            Index of the robot, 0 <= i < n.

        Returns
        -------
        Rollout
            Samples of the robot; of a diverged robot, the samples before divergence.

        Raises
        ------
        InvalidArgument
            If there is no such robot, or its samples are not kept and cannot be computed, see `arguments`.
        Diverged
            If the first sample exceeds the limit.
        """
        if self._index(i) in self.traces:
            return self.traces[self._index(i)]
        arguments = self.arguments(i)
        try:
            return simulate(*arguments[:3], **arguments.options)
        except Diverged as diverged:
            if diverged.rollout is None:
                raise
            rollout: Rollout = diverged.rollout
            return rollout

    def save(self, path: str | PathLike[str]) -> None:
        """Write all results, with all digits, to a NumPy archive (``.npz``); an existing file is replaced.

        The archive contains the parts of the scenario as text, see `Outline`. `load` thus needs none of their
        classes.

        Parameters
        ----------
        path : str or path
            Path of the file.

        Raises
        ------
        InvalidArgument
            If the file cannot be written.
        FileError
            If the system fails, for example because the disk is full; an existing file remains.
        """
        write_archive(path, _FORMAT, content_of(self))

    @classmethod
    def load(cls, path: str | PathLike[str], scenario: Scenario | None = None) -> Ensemble:
        """Return the ensemble of a file that `save` wrote.

        Parameters
        ----------
        path : str or path
            Path of the file.
        scenario : Scenario, optional
            Scenario of the runs. `arguments`, and `member` of robots whose samples are not kept, need it,
            because a file contains numbers and text, not objects.

        Returns
        -------
        Ensemble
            Results of the robots.

        Raises
        ------
        InvalidArgument
            If the file cannot be read, is damaged, is not such an archive, or belongs to another scenario.
        FileError
            If the system fails.
        """
        file = location("path", path)
        ensemble = read_archive(file, _FORMAT, cls._from_content)
        if scenario is None:
            return ensemble
        difference = ensemble.scenario.difference(Outline.of(scenario))
        for name, values in ({} if difference else scenario.draws()).items():
            if not are_close(ensemble.draws[name], values):
                difference = f"its draws of {name} differ"
        check_match(file, difference)
        return replace(ensemble, scenario=scenario)

    @classmethod
    def _from_content(cls, content: dict[str, Any]) -> Ensemble:
        del content["variables"]
        traces = {i: Rollout.of(trace) for i, trace in content.pop("traces").items()}
        return cls(**content, traces=traces)

    def to_xarray(self) -> Any:
        """Return the results as an xarray.Dataset, with the same names as in the store of a sweep.

        Returns
        -------
        xarray.Dataset
            Dimensions ``robot``, ``coordinate``, ``input``, ``metric`` (if there is one), ``time``,
            ``channel``, ``level`` and ``bin``. Each variable has attributes ``units`` and ``long_name``.
            Draws are ``drawn_mass`` and so on. The attribute ``scenario`` describes the runs. The dataset
            does not contain `traces`.

        Raises
        ------
        InvalidArgument
            If xarray is not installed.
        """
        return dataset_of(self, {"scenario": str(Outline.of(self.scenario)), "seed": self.scenario.seed})

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write one line per robot to a text file, with a header with units and 17 significant digits.

        The columns are the index of the robot, its draws (``drawn_mass [kg]`` and so on), its largest and rms
        errors, largest inputs and distance, the time of divergence (``nan`` if it did not diverge), and worst
        and rms metrics.

        Parameters
        ----------
        path : str or path
            Path of the file.

        Raises
        ------
        InvalidArgument
            If the file cannot be written.
        FileError
            If the system fails, for example because the disk is full; an existing file remains.
        """
        write_table(path, *columns_of(self))

    def __repr__(self) -> str:
        return f"<Ensemble: {'; '.join([self._format_result(), *self._failures()])}>"

    def __str__(self) -> str:
        samples = f"seed {self.scenario.seed}, {len(self.scenario.t)} samples each"
        rows, count = self._format_ranges(), np.count_nonzero(~self.diverged)
        if rows and count < len(self):
            rows.insert(0, f"the {count:,} robots that did not diverge:")
        words = [str(self.scenario)] if isinstance(self.scenario, Outline) else []
        spread = Outline.of(self.scenario).spread_in_words
        lines = [*([f"spread: {spread}"] if spread else []), *self._failures(), *self.events, *self._causes()]
        return "\n".join([self._format_result(), samples, *lines, *rows, *words])

    def _format_ranges(self) -> list[str]:
        """Return one row per error, input and metric: its range over the robots that did not diverge."""
        scenario, columns = self.scenario, {"largest distance [m]": self.max_distance}
        names = [_title(f"error of {one.name}", one.unit) for one in scenario.coordinates]
        errors = zip(names, self.max_error.T, strict=True)
        sizes = zip([_title(x.name, x.unit) for x in scenario.inputs], self.max_input.T, strict=True)
        for pair in zip_longest(errors, sizes):
            columns |= dict(filter(None, pair))
        pairs = zip(scenario.recorded_metrics, self.worst_metric.T, strict=True)
        columns |= {f"{one.worst} {one.title}": column for one, column in pairs if one.worst != "ever"}
        rows, width = [], max(_MIN_WIDTH, *map(len, columns))
        for name, values in columns.items():
            finite = values[~np.isnan(values) & ~self.diverged]
            if len(finite):
                low, middle, high = map(format_si, (finite.min(), np.median(finite), finite.max()))
                rows.append(f"{name:<{width}} least {low}, median {middle}, largest {high}")
        return rows

    def _failures(self) -> list[str]:
        """Return a line with the number of robots that failed and the reasons; no line if none did."""
        if not (faults := self.faults):
            return []
        count = int(np.any(list(faults.values()), axis=0).sum())
        reasons = ", ".join(f"{robots.sum():,} {reason}" for reason, robots in faults.items())
        return [f"failed: {count:,} of {len(self):,} robots ({reasons})"]

    def _causes(self) -> list[str]:
        """Return a line with the numbers of the spread that the worst robots share."""
        if len(self) < _MIN_ROBOTS or not any(np.ptp(values) > 0 for values in self.draws.values()):
            return []
        failed, lines = np.any(list(self.faults.values()) or [np.zeros(len(self), bool)], axis=0), []
        if 0 < failed.sum() < len(self) and (shared := self._shared(failed)):
            lines.append(f"the robots that failed have {shared}")
        shared = self._shared(worst_share(self, _SHARE)) or "nothing of the spread in common"
        return [*lines, f"the worst {_SHARE * 100:g} % by distance have {shared}"]

    def _shared(self, robots: NDArray[np.bool_]) -> str:
        """Return the numbers of the spread that some robots share, in words; "" for none."""
        visible = [cause for cause in causes(self, robots) if cause.visible]
        return ", ".join(f"{cause.name} {cause.place}" for cause in visible[:_MAX_CAUSES])

    def _format_result(self) -> str:
        errors, counts = self.error_quantile(0.99), (int(self.diverged.sum()), self.scenario.after)
        return format_result(len(self), self.scenario.t[-1], (errors.distance, errors.heading), *counts)


def _title(name: str, unit: str) -> str:
    return f"largest {name} [{unit}]" if unit else f"largest {name}"
