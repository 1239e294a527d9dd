"""`Sweep`: what a store holds, with its own judgement."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from pinmobile.arrays import location, one_of, whole
from pinmobile.ensembles import PER_ROBOT, Ensemble, checked_share, drawn_name, share_within
from pinmobile.errors import InvalidArgument, shown
from pinmobile.sweeps.fingerprint import determined_by, differences
from pinmobile.sweeps.grids import Axis, Grid, as_grid, imported, place_of
from pinmobile.sweeps.layout import attributes_of, coordinates_of, damaged, other_format
from pinmobile.sweeps.table import answer, since, table


@dataclass(frozen=True, eq=False, repr=False)
class Sweep:
    """The records of a sweep, read from its store when they are asked for.

    Attributes
    ----------
    path : Path
        Folder of the store.
    axes : dict of str to Axis
        What was swept.
    dataset : xarray.Dataset
        Everything, with the axes as dimensions, and ``robot``, ``coordinate``, ``time``, ``channel``,
        ``level`` and ``bin``; each variable has attributes ``units`` and ``long_name``. NaN where it is not
        known yet.
    grid : Grid or None
        The scenarios; None where the store was opened without.
    rivals : str or None
        The axis whose members `answer` compares with each other.
    """

    path: Path
    axes: Mapping[str, Axis]
    dataset: Any
    grid: Grid | None
    rivals: str | None

    @classmethod
    def open(cls, path: str | PathLike[str], scenarios: Any = None) -> Sweep:
        """Return the sweep of a store, complete or not.

        Parameters
        ----------
        path : path
            Its folder.
        scenarios : Grid, mapping, sequence or Scenario, optional
            What was run, as given to `sweep`: needed for `ensemble`, since a store holds numbers, no objects.
            What was told by `sweep`'s ``version`` alone is taken to be the same.

        Raises
        ------
        InvalidArgument
            If there is no store of a sweep, or not of these scenarios (of a store of an earlier format nobody
            can tell), a file of it cannot be read, or a package of the extra is missing.
        """
        for package in ("zarr", "xarray"):
            imported(package)
        folder = location("path", path)
        attributes = attributes_of(folder)
        there = attributes["determined_by"]
        grid = None
        if scenarios is not None:
            grid = as_grid(scenarios)
            other = other_format(folder, there)
            if other:
                raise InvalidArgument(f"{other}; without scenarios, Sweep.open reads it")
            found = differences(there, determined_by(grid, there.get("version")))
            if found:
                raise InvalidArgument(f"scenarios are not those of {str(folder)!r}: {found}")
        for place in coordinates_of(attributes["nodes"]):
            if not (folder / place).is_file():
                raise InvalidArgument(
                    f"store is {str(folder)!r}, of which {str(folder / place)!r} is gone; start the same "
                    "sweep again to have it written again"
                )
        axes = {name: Axis(axis["values"], axis["unit"]) for name, axis in there["axes"].items()}
        with _reading(folder):
            dataset = imported("xarray").open_zarr(folder, chunks=None, consolidated=True)
        return cls(folder, axes, dataset, grid, attributes["rivals"])

    def within(self, share: float = 0.99, by: str = "distance") -> Any:
        """Return what a share of the robots stays within from `Scenario.after` on, exactly.

        Parameters
        ----------
        share : float
            From 0 to 1.
        by : str
            Of what, as in `Ensemble.largest`.

        Returns
        -------
        within : xarray.DataArray, of the shape of the axes
            Such as the distance from the desired position [m]: infinite where fewer have not diverged, of a
            margin, which the share has at least, minus infinity; NaN where it is not known yet.

        Raises
        ------
        InvalidArgument
            If `share` is not between 0 and 1, or a file of the store cannot be read.
        UnknownName
            If there is no such error.
        """
        level, known = checked_share(share), self._judged()
        name, place, unit, sign = known[one_of("error", by, known)]
        with _reading(self.path):
            data = self.dataset[[name, "diverged_at"]].isel(place).load()
        sizes = (sign * data[name]).where(data.diverged_at.isnull(), np.inf)
        found = sign * sizes.reduce(share_within, "robot", share=level)
        what = "distance from the desired position" if by == "distance" else by
        stay = "stay within" if sign > 0 else "have at least"
        meaning = f"{what} that {level * 100:g} % of the robots {stay}"
        attributes = {"units": unit, "long_name": meaning}
        return found.rename("within").drop_vars(list(place)).assign_attrs(attributes)

    def _judged(self) -> dict[str, tuple[str, dict[str, int], str, float]]:
        """Return by name of what is judged its array, where it is in that, its unit, and -1 of margins."""
        found = {"distance": ("max_distance", dict[str, int](), "m", 1.0)}
        for name, dimension in (("max_error", "coordinate"), ("worst_measure", "measure")):
            if name in self.dataset:
                attributes, labels = self.dataset[name].attrs, self.dataset[dimension].values.tolist()
                units = attributes["units"].split(", ")
                worst = attributes["worst"].split(", ") if "worst" in attributes else len(labels) * [""]
                for k, label in enumerate(labels):
                    unit = units[k] if len(units) == len(labels) else ""
                    found[label] = name, {dimension: k}, unit, -1.0 if worst[k] == "smallest" else 1.0
        found["heading"] = "max_error", {"coordinate": 2}, "rad", 1.0
        return found

    def table(self, share: float = 0.99, most: int = 40) -> str:
        """Return a row for each of the first `most` scenarios: its values, `within` and how many diverged.

        Raises
        ------
        InvalidArgument
            If `share` is not between 0 and 1, or a file of the store cannot be read.
        """
        within = self.within(share).values
        return table(self.axes, within, self._diverged(), share, whole("most", most))

    def _diverged(self) -> Any:
        return self.dataset.diverged_at.notnull().sum("robot").values

    def answer(self, share: float = 0.99) -> str:
        """Return in one line what the share of the robots stays within where the worst happens.

        There, the members of one axis are compared with each other: of the axis whose values are controllers
        (of a mapping of names to controllers), else of the one called ``controller``, else of the last axis
        of names. Where there is none, it is the worst of all.

        Of a sweep that is not complete, it begins with how much is done.

        Raises
        ------
        InvalidArgument
            If `share` is not between 0 and 1, or a file of the store cannot be read.
        """
        within = self.within(share).values
        known = self.dataset.max_distance.notnull() | self.dataset.diverged_at.notnull()
        counted = self._diverged(), self.dataset.sizes["robot"]
        after = float(self.dataset.attrs.get("errors_from_s", 0.0))
        words = answer(self.axes, within, *counted, share, done=float(known.mean()), beside=self.rivals)
        return since(after) + words

    def ensemble(self, **labels: Any) -> Ensemble:
        """Return the ensemble of one scenario.

        Parameters
        ----------
        **labels : float or str
            A value of each axis, by its name; of an axis with one value it may be left out.

        Raises
        ------
        UnknownName
            If there is no such axis.
        InvalidArgument
            If an axis is missing, a value is not one of its own, the scenarios are not known, its records are
            not there yet, or a file of theirs cannot be read.
        """
        index = place_of(self.axes, labels)
        if self.grid is None:
            raise InvalidArgument(
                f"the scenarios are not known, expected Sweep.open({str(self.path)!r}, scenarios) with those "
                "that were given to sweep"
            )
        scenario = self.grid.scenarios[int(np.ravel_multi_index(index, self.grid.shape))]
        with _reading(self.path):
            data = self.dataset.isel(dict(zip(self.axes, index, strict=True))).load()
        counts = np.array(data.counts)
        if not counts.any():
            raise InvalidArgument(
                f"scenario {labels} has no records yet: start the same sweep again to go on"
            )
        none = np.zeros((scenario.n, 0))
        records: dict[str, Any] = {name: np.array(data[name]) if name in data else none for name in PER_ROBOT}
        return Ensemble(
            scenario=scenario,
            draws={name: np.array(data[drawn_name(name)]) for name in scenario.spread},
            counts=counts,
            traces={},
            **records,
        )

    def __repr__(self) -> str:
        return f"<Sweep: {self.answer()}>"

    def __str__(self) -> str:
        return f"{self.table()}\n{self.answer()}"


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Name the file of a store that cannot be read."""
    try:
        yield
    except Exception as error:  # whatever the codecs say
        raise InvalidArgument(
            f"store is {shown(str(path))}, of which {damaged(path)}; remove that file, and start "
            "the same sweep again to have it computed again"
        ) from error
