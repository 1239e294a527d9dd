"""`Sweep`: what a store says and holds, with its own judgement in words: who stays within what."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from math import prod
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, location, one_of, whole
from pinmobile.errors import InvalidArgument, shown
from pinmobile.loop import PER_ROBOT, Ensemble, checked_share, drawn_name, percent, share_within
from pinmobile.measures import in_words
from pinmobile.sweeps.fingerprint import FORMAT, determined_by, differences, other_format
from pinmobile.sweeps.grids import Axis, Grid, Label, Scenarios, as_grid, imported, place_of, told

METADATA = "zarr.json"
"""The file in which a store, or an array of it, says what it is."""

_READ = (2, FORMAT)  # formats whose arrays are these
_MOST = 40  # rows of a table
_LONGEST = 10_000_000  # numbers of a coordinate, which is read whole
_TEXT = 1 << 24  # bytes of all texts of a coordinate
_ROUNDING = 1e-9  # relative; that of a run is less by some orders, and what people tell apart is more


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
    def open(cls, path: str | PathLike[str], scenarios: Scenarios | None = None) -> Sweep:
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
        with _reading(folder), _bounded():
            dataset = imported("xarray").open_zarr(folder, chunks=None, consolidated=True, zarr_format=3)
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

    def ensemble(self, **labels: Label) -> Ensemble:
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


def _bounded() -> AbstractContextManager[Any]:
    """Open arrays so that a chunk unpacks to the bytes that its array declares, and to no more."""
    zarr, codec = imported("zarr"), _bounded_zstd()
    zarr.registry.register_codec("zstd", codec, qualname="pinmobile")
    return zarr.config.set({"codecs.zstd": "pinmobile"})  # type: ignore[no-any-return]


@cache
def _bounded_zstd() -> Any:
    import asyncio  # here, as it takes a while and Zarr has it

    zstd = imported("zarr").codecs.ZstdCodec

    class BoundedZstd(zstd):  # type: ignore[misc, valid-type]
        def _decode_sync(self, chunk: Any, spec: Any) -> Any:
            declared = np.dtype(spec.dtype.to_native_dtype())
            packed, text = chunk.to_bytes(), declared.kind == "T" or declared.hasobject
            size, most = _unpacked_size(packed), _TEXT if text else prod(spec.shape) * declared.itemsize
            if size > most or (size < most and not text):
                raise ValueError(f"it unpacks to {size} bytes, expected {'at most ' * text}{most}")
            unpacked = np.empty(size, np.uint8)
            self._zstd_codec.decode(packed, out=unpacked)  # which has room for no more, whatever it says
            return spec.prototype.buffer.from_array_like(unpacked)

        async def _decode_single(self, chunk: Any, spec: Any) -> Any:
            return await asyncio.to_thread(self._decode_sync, chunk, spec)

        def __reduce__(self) -> Any:
            return _zstd_of, (self.to_dict(),)

    return BoundedZstd


def _zstd_of(described: Mapping[str, Any]) -> Any:
    return _bounded_zstd().from_dict(described)


def _unpacked_size(frame: bytes) -> int:
    """Return what the header of a Zstandard frame (RFC 8878, 3.1.1.1) says of its content [bytes]."""
    kind, single, dictionary = frame[4] >> 6, frame[4] >> 5 & 1, frame[4] & 3
    start = 6 - single + (0, 1, 2, 4)[dictionary]
    size = int.from_bytes(frame[start : start + (single, 2, 4, 8)[kind]], "little")
    return size + 256 if kind == 1 else size


def digest_of(mine: Mapping[str, Any], nodes: Mapping[str, Any], since: Mapping[str, Any]) -> str:
    """Return the digest of all that a store says of itself; what others write into its metadata is no part.

    Parameters
    ----------
    mine : mapping
        What it says of the sweep.
    nodes : mapping
        By the names of its arrays, their metadata.
    since : mapping
        The time from which on errors count, where it is the same for all.
    """
    return sha256(json.dumps([mine, nodes, since], sort_keys=True).encode()).hexdigest()


def attributes_of(path: Path) -> dict[str, Any]:
    """Return what a store says of itself, its arrays' metadata as ``nodes``.

    Raises
    ------
    InvalidArgument
        If there is no store of a sweep, that file is damaged, or another version made it otherwise.
    """
    file = path / METADATA
    try:
        metadata = json.loads(file.read_bytes())
        attributes = metadata["attributes"]
        mine: dict[str, Any] = json.loads(attributes["pinmobile_sweep"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        why = error.strerror if isinstance(error, OSError) else f"it lacks {error}"
        why = f"{error}" if isinstance(error, ValueError) else why
        raise InvalidArgument(
            f"store is {str(path)!r}, which is not the store of a sweep: {str(file)!r} cannot be read: {why}"
        ) from error
    try:
        if mine["determined_by"].get("format") not in (None, *_READ):
            raise InvalidArgument(other_format(path, mine["determined_by"]))
        digest = mine.pop("digest")
        nodes = {name: metadata["consolidated_metadata"]["metadata"][name] for name in mine["arrays"]}
        since = {name: attributes[name] for name in ("errors_from_s",) if name in attributes}
        if digest_of(mine, nodes, since) != digest:
            raise ValueError("it is not what was written")
        for name, node in metadata["consolidated_metadata"]["metadata"].items():
            _check_plain(name, node)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InvalidArgument(
            f"store is {str(path)!r}, of which {str(file)!r} is damaged: {error}; a new store of the same "
            "sweep has the same file"
        ) from error
    return {**mine, "nodes": nodes}


def _check_plain(name: str, node: Mapping[str, Any]) -> None:
    """Refuse an array with other codecs, which may run code, and a coordinate beyond all sweeps."""
    if node["zarr_format"] == 3 and node["node_type"] == "group":
        return
    codecs = [codec["name"] if isinstance(codec, dict) else codec for codec in node.get("codecs", ())]
    kind = "text" if node.get("data_type") == "string" else np.dtype(node.get("data_type")).kind
    expected = ["vlen-utf8" if kind == "text" else "bytes", "zstd"]
    plain = kind in ("text", *"biuf") and node["zarr_format"] == 3 and not node.get("storage_transformers")
    if not plain or codecs != expected:
        raise ValueError(
            f"array {shown(name)} is of type {shown(node.get('data_type'))} with the codecs {shown(codecs)}, "
            "expected numbers with the codecs bytes and zstd, or text with vlen-utf8 and zstd"
        )
    if node["dimension_names"] == [name] and prod(node["shape"]) > _LONGEST:
        raise ValueError(f"coordinate {name!r} declares {prod(node['shape']):,} numbers, above {_LONGEST:,}")


def coordinates_of(nodes: Mapping[str, Any]) -> list[str]:
    """Return the places of the coordinates' files."""
    return [f"{name}/c/0" for name, node in nodes.items() if node["dimension_names"] == [name]]


def damaged(path: Path) -> str:
    """Return in words which file of a store cannot be read."""
    arrays = attributes_of(path)["arrays"]
    with _bounded():
        group = imported("zarr").open_group(path, mode="r", zarr_format=3, use_consolidated=True)
    for name in arrays:
        for file in sorted((path / name / "c").rglob("*")):
            place = file.relative_to(path / name / "c").parts
            if file.is_file() and all(part.isdecimal() for part in place):
                try:
                    group[name].blocks[tuple(map(int, place))]
                except Exception as error:  # whatever its codecs say
                    return f"{str(file)!r} cannot be read: {error}"
    return "a file cannot be read"


def length(metres: float) -> str:
    """Return a length in words, in a unit that suits it."""
    if not np.isfinite(metres):
        return "unknown" if np.isnan(metres) else "unbounded"
    printed = float(f"{metres:.3g}")  # what is as good as a millimetre is one, and not 1e+03 µm
    for unit, size in (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6)):
        if printed >= size:
            return f"{printed / size:.3g} {unit}"
    return f"{printed * 1e9:.3g} nm" if printed >= 1e-12 else f"{in_words(printed)} m"


def since(after: float) -> str:
    """Return in words from which time on errors count, nothing where that is the start."""
    return f"from t = {after:g} s on, " if after else ""


def compared(within: Mapping[str, float], share: float, diverged: Mapping[str, int], n: int) -> str:
    """Return in words who stays within what, the share told once, of a single robot not at all.

    Parameters
    ----------
    within : mapping of str to float
        By name in the singular, what the share of the robots stays within [m].
    share : float
        The share.
    diverged : mapping of str to int
        How many robots did, by the same names.
    n : int
        How many robots each has.
    """
    words: list[str] = []
    bounded = False
    for label, distance in within.items():
        if np.isfinite(distance):
            said = f"{label} within" if bounded else f"{label} stays within"
            words.append(f"{said} {length(distance)}{'' if bounded else _of_runs(share, n)}")
            bounded = True
        else:
            words.append(f"{label} {_unbounded(distance, diverged[label], n, 'is', 'diverges')}")
    return ", ".join(words)


def answer(
    axes: Mapping[str, Axis],
    within: Array,
    diverged: NDArray[np.int64],
    n: int,
    share: float,
    *,
    done: float = 1.0,
    beside: str | None = None,
) -> str:
    """Return the answer in one line, for the values at which the worst happens.

    Where a member of `beside` is unbounded at all of them, the others tell where that is.

    Parameters
    ----------
    axes : mapping of str to Axis
        What was swept.
    within : ndarray, of the shape of the axes
        Distance that the share of the robots stays within [m]; NaN where nothing is known.
    diverged : ndarray of int, of the shape of the axes
        How many robots did.
    n : int
        How many robots each scenario has.
    share : float
        The share.
    done : float
        Share of all robots that has been run.
    beside : str, optional
        The axis whose members are compared with each other.
    """
    worst = _worst(within, diverged, None if beside is None else list(axes).index(beside))
    places = zip(axes.items(), worst, strict=True)
    where = [told(name, axis, int(i)) for (name, axis), i in places if name != beside and len(axis) > 1]
    begun = f"{done * 100:.3g} % of the robots are done" if done < 1 else ""
    if begun and np.isnan(within).all():
        return f"{begun}, and of no scenario all"
    prefix = f"{begun}: " if begun else ""
    if where:
        prefix += f"with {' and '.join(where)}, "
    if beside is None:
        distance = float(within[worst])
        if n == 1:
            return prefix + compared({"the robot": distance}, share, {"the robot": int(diverged[worst])}, n)
        if np.isfinite(distance):
            return f"{prefix}the robots stay within {length(distance)}{_of_runs(share, n)}"
        return f"{prefix}the robots {_unbounded(distance, int(diverged[worst]), n, 'are', 'diverge')}"
    place = list(axes).index(beside)
    others = tuple(int(i) for k, i in enumerate(worst) if k != place)

    def row(values: NDArray[Any]) -> dict[str, Any]:
        mine = np.moveaxis(values, place, -1)[others]
        return dict(zip(map(str, axes[beside].values), mine.tolist(), strict=True))

    return prefix + compared(row(within), share, row(diverged), n)


def _worst(within: Array, diverged: NDArray[np.int64], beside: int | None) -> tuple[int, ...]:
    """Return the place where the worst happens; along the axis of rivals, any.

    Of two places that with the larger distance is worse, of its rivals first the worst, then the next and so
    on: one that is unbounded everywhere decides nothing. Then that of which more robots diverge. What differs
    by less than rounding may is the same, and of the same the first is taken, on every machine.
    """
    axis = within.ndim if beside is None else beside
    sizes, lost = (values[..., None] if beside is None else values for values in (within, diverged))
    moved = np.moveaxis(np.nan_to_num(sizes, nan=-1.0, posinf=np.inf), axis, -1)
    rivals = moved.shape[-1]
    left = np.arange(moved.size // rivals)
    ranked = np.sort(moved.reshape(-1, rivals), axis=-1)[:, ::-1]
    for values in (*ranked.T, lost.sum(axis=axis).ravel()):
        most = values[left].max()
        left = left[values[left] >= min(most, most * (1 - _ROUNDING))]
    place = [int(i) for i in np.unravel_index(int(left[0]), moved.shape[:-1])]
    return tuple(place if beside is None else [*place[:beside], 0, *place[beside:]])


def _of_runs(share: float, n: int) -> str:
    return "" if n == 1 else f" in {share * 100:g} % of runs"


def _unbounded(distance: float, diverged: int, n: int, be: str, diverge: str) -> str:
    if np.isnan(distance):
        return f"{be} unknown"
    return diverge if n == 1 else f"{diverge} in {percent(diverged, n)} runs"


def table(
    axes: Mapping[str, Axis], within: Array, diverged: NDArray[np.int64], share: float, most: int = _MOST
) -> str:
    """Return one row for each scenario, the first `most` of them; what is not known yet is "unknown".

    Parameters
    ----------
    axes, within, diverged, share
        As of `answer`.
    most : int
        Rows, at most.
    """
    heads = [f"{name} [{axis.printed_unit}]" if axis.printed_unit else name for name, axis in axes.items()]
    rows = [[*heads, f"{share * 100:g} % within", "diverged"]]
    for index in list(np.ndindex(within.shape))[:most]:
        labels = [_text(list(axis.values)[i]) for axis, i in zip(axes.values(), index, strict=True)]
        distance = float(within[index])
        rows.append([*labels, length(distance), "unknown" if np.isnan(distance) else f"{diverged[index]:,}"])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = ["  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
    rest = within.size - most
    return "\n".join([*lines, *([f"... and {rest} more"] if rest > 0 else [])])


def _text(label: Label) -> str:
    return label if isinstance(label, str) else f"{label:g}"
