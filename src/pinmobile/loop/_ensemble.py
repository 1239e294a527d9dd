"""`Ensemble`: the results of the robots of a scenario, which judge themselves."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike, location, one_of, whole
from pinmobile.errors import Diverged, InvalidArgument
from pinmobile.files import read_archive, write_archive, write_table
from pinmobile.loop._description import Outline, alike, judgement, ranges
from pinmobile.loop._rollout import Rollout
from pinmobile.loop._scenario import Scenario
from pinmobile.loop._simulate import simulate
from pinmobile.loop._variables import (
    PER_ROBOT,
    Member,
    Part,
    checked_levels,
    checked_share,
    columns_of,
    content_of,
    dataset_of,
    member_of,
    quantiles_of,
    share_within,
)

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
        of `Scenario.channels`, of which size, see `pinmobile.loop._variables`.
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
