"""`Sweep`: the results of a sweep, and its answer in words."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import location, one_of, whole
from pinmobile.errors import InvalidArgument
from pinmobile.loop import PER_ROBOT, Ensemble, Scenario, checked_share, drawn_name, percent, share_within
from pinmobile.metrics import in_words
from pinmobile.sweeps._points import Axis, Label, Points, describe, differences, index_of, place

_ROUNDING = 1e-9  # relative; a run's is orders less, and differences that matter are more


@final
@dataclass(frozen=True, eq=False, repr=False)
class Sweep:
    """Results of a sweep, read from its store when they are needed.

    Attributes
    ----------
    path : Path
        Folder of the store.
    axes : dict of str to Axis
        Values along each axis, by path; ``case`` for cases.
    dataset : xarray.Dataset
        All results, with the axes as dimensions, and ``robot``, ``coordinate``, ``time``, ``channel``,
        ``level``, ``chunk`` and ``bin``; each variable has attributes ``units`` and ``long_name``. NaN where
        results are missing.
    points : Points or None
        The scenarios; None if the store was opened without.
    """

    path: Path
    axes: Mapping[str, Axis]
    dataset: Any
    points: Points | None = None

    @classmethod
    def open(
        cls,
        path: str | PathLike[str],
        scenario: Scenario | None = None,
        *,
        grid: Mapping[str, Any] | None = None,
        cases: Mapping[str, Any] | None = None,
    ) -> Sweep:
        """Return the sweep of a store, complete or not.

        Parameters
        ----------
        path : path
            Its folder.
        scenario, grid, cases
            As given to `sweep`: needed for `ensemble`, because a store holds numbers, not objects. Objects
            that `sweep`'s ``version`` stands for are taken to be the same.

        Raises
        ------
        InvalidArgument
            If there is no store of a sweep, or not of these scenarios, a file of it cannot be read, or a
            package of the extra is missing.
        """
        from pinmobile.sweeps._store import attributes_of

        there = attributes_of(location("path", path))["determined_by"]
        points = None
        if scenario is not None:
            points = Points.of(scenario, grid, cases)
            found = differences(there, describe(points, there.get("version")))
            if found:
                raise InvalidArgument(f"scenario is not that of {str(path)!r}: {found}")
        return cls.of_store(location("path", path), points)

    @classmethod
    def of_store(cls, path: Path, points: Points | None) -> Sweep:
        """Return the sweep of a store whose points are known or not needed."""
        from pinmobile.sweeps._store import attributes_of, open_dataset

        axes = attributes_of(path)["determined_by"]["axes"].items()
        known = {name: Axis(tuple(axis["values"]), axis["unit"]) for name, axis in axes}
        return cls(path, known, open_dataset(path), points)

    @property
    def rivals(self) -> str | None:
        """The axis that `answer` compares: that of a controller, else the last one of names, or None."""
        named = [
            x for x, axis in self.axes.items() if len(axis.values) > 1 and isinstance(axis.values[0], str)
        ]
        laws = [name for name in named if name.split(".")[-1] == "controller"]
        return [*named, *laws][-1] if named else None

    def error_quantile(self, share: float = 0.99, by: str = "distance") -> Any:
        """Return the error that a share of the robots does not exceed from `Scenario.after` on, exactly.

        Parameters
        ----------
        share : float
            Share of the robots, 0 to 1.
        by : str
            Error or metric, as in `Ensemble.largest`.

        Returns
        -------
        within : xarray.DataArray, of the shape of the axes
            Such as the distance from the desired position [m]: infinite where too many robots diverge; of a
            margin, the margin that the share has at least. NaN where results are missing.

        Raises
        ------
        InvalidArgument
            If `share` is not between 0 and 1, or a file of the store cannot be read.
        UnknownName
            If there is no such error.
        """
        level, known = checked_share(share), self._judged()
        name, where, unit, sign = known[one_of("error", by, known)]
        data = self._read(self.dataset[[name, "diverged_at"]].isel(where))
        sizes = (sign * data[name]).where(data.diverged_at.isnull(), np.inf)
        found = sign * sizes.reduce(share_within, "robot", share=level)
        what = "distance from the desired position" if by == "distance" else by
        meaning = (
            f"{what} that {level * 100:g} % of the robots {'stay within' if sign > 0 else 'have at least'}"
        )
        return found.rename("within").drop_vars([*where]).assign_attrs({"units": unit, "long_name": meaning})

    def _judged(self) -> dict[str, tuple[str, dict[str, int], str, float]]:
        """Return array, place in it, unit, and sign (-1 of margins) of each error and metric, by name."""
        found = {"distance": ("max_distance", dict[str, int](), "m", 1.0)}
        for name, dimension in (("max_error", "coordinate"), ("worst_metric", "metric")):
            if name in self.dataset:
                attributes, labels = self.dataset[name].attrs, self.dataset[dimension].values.tolist()
                units, worst = (attributes.get(key, "").split(", ") for key in ("units", "worst"))
                for k, label in enumerate(labels):
                    sign = -1.0 if worst[k:] and worst[k] == "smallest" else 1.0
                    found[label] = name, {dimension: k}, units[k] if len(units) == len(labels) else "", sign
        return found | {"heading": ("max_error", {"coordinate": 2}, "rad", 1.0)}

    def _read(self, data: Any) -> Any:
        from pinmobile.sweeps._store import reading

        with reading(self.path):
            return data.load()

    @property
    def diverged(self) -> NDArray[np.int64]:
        """How many robots diverge, of the shape of the axes."""
        return np.asarray(self._read(self.dataset.diverged_at).notnull().sum("robot"), np.int64)

    def table(self, share: float = 0.99, most: int = 40) -> str:
        """Return a row for each of the first `most` points: values, `within`, and how many robots diverge.

        Raises
        ------
        InvalidArgument
            If `share` is not between 0 and 1, or a file of the store cannot be read.
        """
        within, diverged, limit = self.error_quantile(share).values, self.diverged, whole("most", most)
        heads = [f"{x} [{axis.unit}]" if axis.unit else x for x, axis in self.axes.items()]
        rows = [[*heads, f"{share * 100:g} % within", "diverged"]]
        for index in list(np.ndindex(within.shape))[:limit]:
            labels = [axis.text(i) for axis, i in zip(self.axes.values(), index, strict=True)]
            lost = "unknown" if np.isnan(within[index]) else f"{diverged[index]:,}"
            rows.append([*labels, length(float(within[index])), lost])
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(x.rjust(width) for x, width in zip(row, widths, strict=True)) for row in rows]
        rest = within.size - limit
        return "\n".join([*lines, *([f"... and {rest} more"] if rest > 0 else [])])

    def answer(self, share: float = 0.99) -> str:
        """Return in one line the distance that the share of the robots stays within in the worst case.

        There, the members of one axis are compared: the one of a controller by path, else the last one of
        names. If the sweep is incomplete, the line begins with the share that is done.

        Raises
        ------
        InvalidArgument
            If `share` is not between 0 and 1, or a file of the store cannot be read.
        """
        after = float(self.dataset.attrs.get("errors_from_s", 0.0))
        data = self._read(self.dataset[["max_distance", "diverged_at"]])
        done = float((data.max_distance.notnull() | data.diverged_at.notnull()).mean())
        begun = f"{done * 100:.3g} % of the robots are done" if done < 1 else ""
        within, diverged, n = self.error_quantile(share).values, self.diverged, self.dataset.sizes["robot"]
        if np.isnan(within).all():
            return f"{begun}, and all robots of no scenario"
        beside = self.rivals
        last = len(self.axes) if beside is None else list(self.axes).index(beside)
        within, diverged = (np.moveaxis(x if beside else x[..., None], last, -1) for x in (within, diverged))
        worst = _worst(within, diverged)
        places = place({name: axis for name, axis in self.axes.items() if name != beside}, worst)
        where = " and ".join(x for x, count in zip(places, within.shape[:-1], strict=True) if count > 1)
        labels = ("the robot" if n == 1 else "the robots",) if beside is None else self.axes[beside].values
        rows = (x[worst].tolist() for x in (within, diverged))
        sizes, lost = (dict(zip(map(str, labels), row, strict=True)) for row in rows)
        words = f"{begun and begun + ': '}{where and f'with {where}, '}{compared(sizes, share, lost, n)}"
        return since(after) + words

    def ensemble(self, **labels: Label) -> Ensemble:
        """Return the ensemble at one point.

        Parameters
        ----------
        **labels : float or str
            A value of each axis, by its name: ``**{"controller.kp": 4}``; of an axis with one value it may be
            left out.

        Raises
        ------
        UnknownName
            If there is no such axis.
        InvalidArgument
            If an axis is missing, a value is not one of its own, the scenarios are not given, the ensemble is
            incomplete, or a file of it cannot be read.
        """
        index = index_of(self.axes, {"plant" if name == "robot" else name: x for name, x in labels.items()})
        if self.points is None:
            raise InvalidArgument(
                f"scenario is missing, expected Sweep.open({str(self.path)!r}, scenario, grid=..., cases=...)"
            )
        scenario = self.points.scenarios[int(np.ravel_multi_index(index, self.points.shape))]
        data = self._read(self.dataset.isel(dict(zip(self.axes, index, strict=True))))
        if np.isnan(data["quantiles"]).all():
            raise InvalidArgument(
                f"labels are {labels}, of which robots are missing: start the same sweep again"
            )
        none = np.zeros((scenario.n, 0))
        records: dict[str, Any] = {name: np.array(data[name]) if name in data else none for name in PER_ROBOT}
        return Ensemble(
            scenario=scenario,
            draws={name: np.array(data[drawn_name(name)]) for name in scenario.spread},
            counts=np.array(data["counts"].sum("chunk"), np.int32),
            traces={},
            **records,
        )

    def __repr__(self) -> str:
        return f"<Sweep: {self.answer()}>"

    def __str__(self) -> str:
        return f"{self.table()}\n{self.answer()}"


def length(metres: float) -> str:
    """Return a length as text, in the unit that fits."""
    if not np.isfinite(metres):
        return "unknown" if np.isnan(metres) else "unbounded"
    printed = float(f"{metres:.3g}")  # a rounding error below a millimetre is a millimetre, not 1e+03 µm
    for unit, size in (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6)):
        if printed >= size:
            return f"{printed / size:.3g} {unit}"
    return f"{printed * 1e9:.3g} nm" if printed >= 1e-12 else f"{in_words(printed)} m"


def since(after: float) -> str:
    """Return in words the time from which on errors count, "" for the start."""
    return f"from t = {after:g} s on, " if after else ""


def compared(within: Mapping[str, float], share: float, diverged: Mapping[str, int], n: int) -> str:
    """Return in words the distance that the share of the robots stays within; it states the share once.

    Parameters
    ----------
    within : mapping of str to float
        Distance that the share of the robots stays within, by name [m].
    share : float
        The share.
    diverged : mapping of str to int
        How many robots diverge, by the same names.
    n : int
        How many robots each has.
    """
    words: list[str] = []
    stay, runs = "stay", "" if n == 1 else f" in {share * 100:g} % of runs"
    for label, distance in within.items():
        s = "" if label == "the robots" else "s"
        if np.isfinite(distance):
            words.append(f"{label} {stay and f'{stay}{s} '}within {length(distance)}{runs}")
            stay = runs = ""
        elif np.isnan(distance):
            words.append(f"{label} {'is' if s else 'are'} unknown")
        else:
            words.append(f"{label} diverge{s}{'' if n == 1 else f' in {percent(diverged[label], n)} runs'}")
    return ", ".join(words)


def _worst(within: NDArray[Any], diverged: NDArray[Any]) -> tuple[int, ...]:
    """Return the worst place along all axes but the last, that of rivals.

    Of two places the one with the larger distance is worse: of its worst rival first, then of the next, so
    that a rival without bound everywhere decides nothing; then the one where more robots diverge. Differences
    by rounding do not count: of equal places the first is taken, on every machine.
    """
    sizes = np.nan_to_num(within, nan=-1.0, posinf=np.inf).reshape(-1, within.shape[-1])
    left = np.arange(len(sizes))
    for values in (*np.sort(sizes, axis=-1).T[::-1], diverged.sum(axis=-1).ravel()):
        most = values[left].max()
        left = left[values[left] >= min(most, most * (1 - _ROUNDING))]
    return tuple(int(i) for i in np.unravel_index(int(left[0]), within.shape[:-1]))
