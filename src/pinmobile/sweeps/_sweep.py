"""`sweep` runs the ensembles of a grid, in this process or on a Dask cluster; `Sweep` has the results."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, TypeAlias, final
from warnings import warn

import numpy as np
from numpy.typing import NDArray

import pinmobile.loop as loop
from pinmobile.arrays import Array, callable_as, check_integer, location, matching, one_of, required
from pinmobile.compiled import processors
from pinmobile.errors import (
    InvalidArgument,
    SchedulerError,
    SlowerEngine,
    format_value,
    import_extra,
    unexpected_value,
)
from pinmobile.files import check_match
from pinmobile.loop import Ensemble, Part, Scenario
from pinmobile.metrics import format_si
from pinmobile.sweeps._points import Axis, Changes, Label, Points, describe, differences, index_of, place_text

if TYPE_CHECKING:
    from pinmobile.sweeps._store import Job

_ROUNDING = 1e-9  # relative tolerance, between rounding errors and differences that matter


@final
@dataclass(frozen=True, eq=False, repr=False)
class Sweep:
    """Results of a sweep, which are read from its store when they are needed.

    Attributes
    ----------
    path : Path
        Folder of the store.
    axes : dict of str to Axis
        Values along each axis, by path; ``case`` for cases.
    dataset : xarray.Dataset
        All results, with the axes as dimensions, and ``robot``, ``coordinate``, ``time``, ``channel``,
        ``level``, ``chunk`` and ``bin``. Each variable has attributes ``units`` and ``long_name``. Missing
        results are NaN.
    points : Points or None
        Scenarios of the points; None if the store was opened without a scenario.

    See Also
    --------
    sweep : run a sweep.
    Ensemble : results at one point.

    Examples
    --------
    >>> from pinmobile import Sweep
    >>> Sweep.open("missing")
    Traceback (most recent call last):
        ...
    pinmobile.errors.InvalidArgument: store is 'missing', ...
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
        path : str or path
            Folder of the store.
        scenario : Scenario, optional
            Scenario of `sweep`. `ensemble` needs it, because a store contains numbers, not objects. Objects
            that the ``version`` of `sweep` represents count as unchanged.
        grid, cases : mapping, optional
            Grid and cases of `sweep`.

        Returns
        -------
        Sweep
            Results of the sweep.

        Raises
        ------
        InvalidArgument
            If the folder is not the store of a sweep, contains other scenarios or a damaged file, or a
            package of the extra is missing.
        """
        from pinmobile.sweeps._store import attributes_of

        description = attributes_of(location("path", path))["determined_by"]
        points = None
        if scenario is not None:
            points = Points.of(scenario, grid, cases)
            difference = differences(description, describe(points, description.get("version")))
            check_match(path, difference)
        return cls.of_store(location("path", path), points)

    @classmethod
    def of_store(cls, path: Path, points: Points | None) -> Sweep:
        """Return the sweep of a store whose points are known or not needed.

        Parameters
        ----------
        path : Path
            Folder of the store.
        points : Points or None
            Scenarios of the points.

        Returns
        -------
        Sweep
            Results of the sweep.
        """
        from pinmobile.sweeps._store import attributes_of, open_dataset

        axes = attributes_of(path)["determined_by"]["axes"].items()
        axes_read = {name: Axis(tuple(axis["values"]), axis["unit"]) for name, axis in axes}
        return cls(path, axes_read, open_dataset(path), points)

    @property
    def rivals(self) -> str | None:
        """Axis that `answer` compares: that of a controller, else the last axis of names, or None."""
        values = {name: axis.values[0] for name, axis in self.axes.items() if len(axis.values) > 1}
        names = [name for name, first in values.items() if isinstance(first, str)]
        laws = [name for name in names if name.split(".")[-1] == "controller"]
        return [*names, *laws][-1] if names else None

    def error_quantile(self, share: float = 0.99, by: str = "distance") -> Any:
        """Return the error that a share of the robots does not exceed after `Scenario.after`.

        Parameters
        ----------
        share : float
            Share of the robots, 0 to 1.
        by : str
            Error or metric, as in `Ensemble.largest`.

        Returns
        -------
        xarray.DataArray, with the shape of the axes
            Errors, such as the distance from the desired position [m], or margins that the share has at
            least. The result is exact, infinite if too many robots diverge, and NaN if results are missing.

        Raises
        ------
        InvalidArgument
            If `share` is not between 0 and 1, or a file of the store cannot be read.
        UnknownName
            If there is no such error.
        """
        level, arrays = loop.check_share(share), self._result_arrays()
        name, index, unit, sign = arrays[one_of("error", by, arrays)]
        data = self._read(self.dataset[[name, "diverged_at"]].isel(index))
        sizes = (sign * data[name]).where(data.diverged_at.isnull(), np.inf)
        result = sign * sizes.reduce(loop.share_quantile, "robot", share=level)
        label = "distance from the desired position" if by == "distance" else by
        verb = "stay within" if sign > 0 else "have at least"
        meaning = f"{label} that {level * 100:g} % of the robots {verb}"
        return result.rename("within").drop_vars([*index]).assign_attrs({"units": unit, "long_name": meaning})

    def _result_arrays(self) -> dict[str, tuple[str, dict[str, int], str, float]]:
        """Return array, place in it, unit, and sign (-1 for margins) of each error and metric, by name."""
        arrays = {"distance": ("max_distance", dict[str, int](), "m", 1.0)}
        for name, dimension in (("max_error", "coordinate"), ("worst_metric", "metric")):
            if name in self.dataset:
                attributes, labels = self.dataset[name].attrs, self.dataset[dimension].values.tolist()
                units, worst = (attributes.get(key, "").split(", ") for key in ("units", "worst"))
                for k, label in enumerate(labels):
                    sign = -1.0 if worst[k:] and worst[k] == "smallest" else 1.0
                    arrays[label] = name, {dimension: k}, units[k] if len(units) == len(labels) else "", sign
        return arrays | {"heading": ("max_error", {"coordinate": 2}, "rad", 1.0)}

    def _read(self, data: Any) -> Any:
        from pinmobile.sweeps._store import store_errors

        with store_errors(self.path):
            return data.load()

    @property
    def diverged(self) -> NDArray[np.int64]:
        """Number of diverged robots, with the shape of the axes."""
        return np.asarray(self._read(self.dataset.diverged_at).notnull().sum("robot"), np.int64)

    def table(self, share: float = 0.99, most: int = 40) -> str:
        """Return one row for each of the first points: values, error quantile, and number of diverged robots.

        Parameters
        ----------
        share : float
            Share of the robots, 0 to 1.
        most : int
            Largest number of rows.

        Returns
        -------
        str
            Lines of the table.

        Raises
        ------
        InvalidArgument
            If `share` is not between 0 and 1, or a file of the store cannot be read.
        """
        errors, diverged = self.error_quantile(share).values, self.diverged
        limit = check_integer("most", most)
        heads = [f"{x} [{axis.unit}]" if axis.unit else x for x, axis in self.axes.items()]
        rows = [[*heads, f"{share * 100:g} % within", "diverged"]]
        for index in list(np.ndindex(errors.shape))[:limit]:
            labels = [axis.text(i) for axis, i in zip(self.axes.values(), index, strict=True)]
            count = "unknown" if np.isnan(errors[index]) else f"{diverged[index]:,}"
            rows.append([*labels, format_length(float(errors[index])), count])
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(x.rjust(width) for x, width in zip(row, widths, strict=True)) for row in rows]
        rest = errors.size - limit
        return "\n".join([*lines, *([f"... and {rest} more"] if rest > 0 else [])])

    def answer(self, share: float = 0.99) -> str:
        """Return one line: the distance that a share of the robots does not exceed, in the worst case.

        The line compares the members of one axis, that of a controller or else the last axis of names. If the
        sweep is incomplete, the line begins with the finished share.

        Parameters
        ----------
        share : float
            Share of the robots, 0 to 1.

        Returns
        -------
        str
            One line.

        Raises
        ------
        InvalidArgument
            If `share` is not between 0 and 1, or a file of the store cannot be read.
        """
        after = float(self.dataset.attrs.get("errors_from_s", 0.0))
        data = self._read(self.dataset[["max_distance", "diverged_at"]])
        share_done = float((data.max_distance.notnull() | data.diverged_at.notnull()).mean())
        state = f"{share_done * 100:.3g} % of the robots are done" if share_done < 1 else ""
        errors, diverged, n = self.error_quantile(share).values, self.diverged, self.dataset.sizes["robot"]
        if np.isnan(errors).all():
            return f"{state}, but no scenario is complete"
        rivals = self.rivals
        last = len(self.axes) if rivals is None else list(self.axes).index(rivals)
        errors, diverged = (np.moveaxis(x if rivals else x[..., None], last, -1) for x in (errors, diverged))
        worst = _worst(errors, diverged)
        places = place_text({name: axis for name, axis in self.axes.items() if name != rivals}, worst)
        place = " and ".join(x for x, count in zip(places, errors.shape[:-1], strict=True) if count > 1)
        labels = ("the robot" if n == 1 else "the robots",) if rivals is None else self.axes[rivals].values
        rows = (x[worst].tolist() for x in (errors, diverged))
        sizes, fails = (dict(zip(map(str, labels), row, strict=True)) for row in rows)
        words = f"{state and state + ': '}{place and f'with {place}, '}{summarize(sizes, share, fails, n)}"
        return format_since(after) + words

    def ensemble(self, **labels: Label) -> Ensemble:
        """Return the ensemble at one point.

        Parameters
        ----------
        **labels : float or str
            Value of each axis, by its name: ``**{"controller.kp": 4}``. An axis with one value may be
            omitted.

        Returns
        -------
        Ensemble
            Results of the robots at this point.

        Raises
        ------
        UnknownName
            If there is no such axis.
        InvalidArgument
            If an axis is missing, a value is not on its axis, the scenarios are not given, the ensemble is
            incomplete, or a file of the store cannot be read.
        """
        index = index_of(self.axes, {"plant" if name == "robot" else name: x for name, x in labels.items()})
        expected = f"Sweep.open({str(self.path)!r}, scenario, grid=..., cases=...)"
        points: Points = required("scenario", self.points, expected)
        scenario = points.scenarios[int(np.ravel_multi_index(index, points.shape))]
        data = self._read(self.dataset.isel(dict(zip(self.axes, index, strict=True))))
        if np.isnan(data["quantiles"]).all():
            raise InvalidArgument(
                f"labels are {labels}, where robots are missing: start the same sweep again"
            )
        empty = np.zeros((scenario.n, 0))
        records: dict[str, Any] = {
            name: np.array(data[name]) if name in data else empty for name in loop.ROBOT_ARRAYS
        }
        return Ensemble(
            scenario=scenario,
            draws={name: np.array(data[loop.draw_name(name)]) for name in scenario.spread},
            counts=np.array(data["counts"].sum("chunk"), np.int32),
            traces={},
            **records,
        )

    def __repr__(self) -> str:
        return f"<Sweep: {self.answer()}>"

    def __str__(self) -> str:
        return f"{self.table()}\n{self.answer()}"


def format_length(metres: float) -> str:
    """Return a length [m] as text, in a suitable unit."""
    if not np.isfinite(metres):
        return "unknown" if np.isnan(metres) else "unbounded"
    rounded = float(f"{metres:.3g}")  # a rounding error below a millimetre is a millimetre, not 1e+03 µm
    for unit, size in (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6)):
        if rounded >= size:
            return f"{rounded / size:.3g} {unit}"
    return f"{rounded * 1e9:.3g} nm" if rounded >= 1e-12 else f"{format_si(rounded)} m"


def format_since(after: float) -> str:
    """Return the time from which errors count as text, "" for the start."""
    return f"from t = {after:g} s on, " if after else ""


def summarize(errors: Mapping[str, float], share: float, diverged: Mapping[str, int], n: int) -> str:
    """Return the distances that the share of the robots does not exceed as text, which states the share once.

    Parameters
    ----------
    errors : mapping of str to float
        Distance that the share of the robots does not exceed, by name [m].
    share : float
        Share of the robots.
    diverged : mapping of str to int
        Number of diverged robots, by the same names.
    n : int
        Number of robots for each name.
    """
    words: list[str] = []
    verb, runs = "stay", "" if n == 1 else f" in {share * 100:g} % of runs"
    for label, distance in errors.items():
        s = "" if label == "the robots" else "s"
        if np.isfinite(distance):
            words.append(f"{label} {verb and f'{verb}{s} '}within {format_length(distance)}{runs}")
            verb = runs = ""
        elif np.isnan(distance):
            words.append(f"{label} {'is' if s else 'are'} unknown")
        else:
            words.append(
                f"{label} diverge{s}{'' if n == 1 else f' in {loop.format_percent(diverged[label], n)} runs'}"
            )
    return ", ".join(words)


def _worst(errors: NDArray[Any], diverged: NDArray[Any]) -> tuple[int, ...]:
    """Return the index of the worst place along all axes but the last, that of rivals.

    The place with the larger distance is worse. The comparison begins with the worst rival and continues with
    the next, so that a rival that diverges everywhere decides nothing. Then the number of diverged robots
    counts. Rounding errors do not count: of equal places, the first one is returned on every machine.
    """
    sizes = np.nan_to_num(errors, nan=-1.0, posinf=np.inf).reshape(-1, errors.shape[-1])
    indices = np.arange(len(sizes))
    for values in (*np.sort(sizes, axis=-1).T[::-1], diverged.sum(axis=-1).ravel()):
        largest = values[indices].max()
        indices = indices[values[indices] >= min(largest, largest * (1 - _ROUNDING))]
    return tuple(int(i) for i in np.unravel_index(int(indices[0]), errors.shape[:-1]))


_CHUNK = 16384
_ANSWER_TIME = 10.0  # time limit of a scheduler's answer, and of its first worker [s]
_WORKER_TIME = 60.0  # time limit of a cluster without a worker, which is often started again [s]
_CHECK_TIME = 2.0  # time between two checks of a cluster without results [s]

Progress: TypeAlias = Callable[[int, int], None]


def sweep(
    scenario: Scenario,
    path: str | PathLike[str],
    *,
    grid: Mapping[str, Any] | None = None,
    cases: Mapping[str, Changes] | None = None,
    client: Any = None,
    chunk: int | None = None,
    progress: Progress | None = None,
    version: str | None = None,
) -> Sweep:
    """Run an ensemble at each point of grid x cases, and keep the results in a Zarr store that xarray reads.

    The work is divided into chunks of robots. Only this process writes the store. The numbers of a chunk are
    the same, bit for bit, wherever it is computed. After an interruption, even a kill, repeat the call: the
    sweep resumes and ends with the same store. The sweep computes results in missing files again.

    Parameters
    ----------
    scenario : Scenario
        Ensemble at each point. All points have the same number of robots and the same times of bands.
    path : str or path
        Folder of the store. It is created if it does not exist, and continued if it belongs to this sweep.
    grid : mapping of str to sequence or mapping, optional
        Values by path: of the loop, such as ``"controller.kp"``, ``"robot.mass"``, ``"forces.wind.force.x"``,
        ``"trajectory.path.radius"``, or of the scenario, such as ``"spread.mass"`` or ``"seed"``. A value is
        a number or a whole part. A mapping has labels: ``{"controller": {"PD": PD(120, 120), "computed
        torque": ComputedTorque(robot)}}``. The last axis runs fastest.
    cases : mapping of str to mapping of str to value, optional
        Values by path of each case, by name: ``{"nominal": {}, "push": {"forces.push": force}}``. They are
        the last axis, ``case``. A spread replaces the numbers that it names for each robot, also those of a
        part of a case; a `Relative` spread multiplies them instead.
    client : distributed.Client, optional
        Dask cluster that computes; default: this process, on all cores. The workers need pinmobile and your
        modules (``client.upload_file``).
    chunk : int, optional
        Robots in a chunk; default: 16384, or the size in the store.
    progress : callable, optional
        Function ``progress(done, total)`` of numbers of robots, called first with the contents of the store,
        then after each chunk.
    version : str, optional
        Word for objects whose contents a store cannot recognise, such as those of a compiled package. Change
        it whenever they change. Other sweeps do not need it.

    Returns
    -------
    Sweep
        Results of the sweep.

    Raises
    ------
    UnknownName
        If there is no such path.
    InvalidArgument
        If an argument is invalid, draws are impossible, the store belongs to another sweep (the message
        states the difference), a scenario has objects that cannot be recognised without `version`, or a
        package of the extra is missing.
    FileError
        If the system fails, for example because the disk is full; finished chunks remain.
    SchedulerError
        If the cluster has no worker, or is lost; finished chunks remain.

    Warns
    -----
    SlowerEngine
        If parts prevent the fastest engine for the remaining work. The message names them and the code to
        write instead.

    See Also
    --------
    ensemble : run one ensemble.
    Scenario : loop and spread of an ensemble.
    Sweep : results of a sweep.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from pinmobile import PD, Circle, MobileRobot, Scenario
    >>> from pinmobile import Tangent, Uniform, sweep
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> runs = Scenario(robot=robot, controller=PD(120, 120),
    ...                 trajectory=Tangent(Circle(1.0, 0.5, 4.0)),
    ...                 spread={"mass": Uniform(20, 40)},
    ...                 n=4, dt=0.02)
    >>> with TemporaryDirectory() as folder:
    ...     found = sweep(runs, folder, grid={"kp": [60, 120]})
    ...     found.error_quantile(0.99).values  # [m]
    array([0.124, 0.075])
    """
    points = Points.of(scenario, grid, cases)
    return run_points(points, path, client=client, chunk=chunk, progress=progress, version=version)


def run_points(
    points: Points,
    path: str | PathLike[str],
    *,
    client: Any = None,
    chunk: int | None = None,
    progress: Progress | None = None,
    version: str | None = None,
) -> Sweep:
    """Run the scenarios of points; see `sweep` for the other arguments, the result and the errors."""
    from pinmobile.sweeps._store import Store

    folder, size = location("path", path), _CHUNK if chunk is None else check_integer("chunk", chunk)
    if client is not None:
        _check_client(client)
    if progress is not None:
        callable_as("progress(done, total)", progress)
    if version is not None:
        matching("version", version, r"\s*\S[\s\S]*", 'a word, such as "1"')
    description = describe(points, version)
    with Store(folder, points, description, size) as store:
        if chunk is not None and store.chunk != size:
            raise InvalidArgument(f"chunk is {size}, expected {store.chunk} as in the store, or None")
        jobs = store.open_jobs()
        total = len(points.scenarios) * points.n
        remaining = sum(job.stop - job.start for job in jobs)
        _warn_slow(points, jobs)
        if progress is not None:
            progress(total - remaining, total)
        for job, draws, part in _results(points, jobs, client) if jobs else ():
            store.record(job, draws, part)
            remaining -= job.stop - job.start
            if progress is not None:
                progress(total - remaining, total)
    return Sweep.of_store(folder, points)


def _warn_slow(points: Points, jobs: Sequence[Job]) -> None:
    """Warn once about parts that prevent the fastest engine, here and not where chunks are computed."""
    reasons: dict[str, list[int]] = {}
    for k in sorted({job.scenario for job in jobs}):
        p = loop.plan_execution(points.scenarios[k])
        if p.fallback_reason:
            reasons.setdefault(f"by {p.engine!r}, {p.engine.value}; {p.fallback_reason}", []).append(k)
    lines = []
    for reason, places in reasons.items():
        rest = f" and {len(places) - 1} more" if len(places) > 1 else ""
        lines.append(f"{reason} (at {points.place(places[0])}{rest})")
    if lines:
        warn(f"this sweep runs {'; '.join(lines)}", SlowerEngine, stacklevel=4)


def _check_client(client: Any) -> None:
    kind = import_extra("distributed", "sweeps", "a sweep").Client
    if not isinstance(client, kind) or client.status != "running" or client.asynchronous:
        raise unexpected_value("client", client, "a distributed.Client that is connected to its scheduler")


def connect(address: str, timeout: float = _ANSWER_TIME) -> Any:
    """Return a ``distributed.Client`` of the scheduler at an address, such as ``tcp://127.0.0.1:8786``.

    Raises
    ------
    SchedulerError
        If no scheduler answers within `timeout` seconds.
    """
    import asyncio  # here, because most sweeps have no cluster

    distributed = import_extra("distributed", "sweeps", "a sweep")

    async def identity() -> Any:  # a client would wait forever for a silent server
        comm = await distributed.comm.connect(address, timeout=timeout)
        try:
            return await distributed.core.send_recv(comm, op="identity")
        finally:
            comm.abort()

    try:
        with ThreadPoolExecutor(1) as pool:  # the thread of a notebook already runs a loop
            pool.submit(asyncio.run, asyncio.wait_for(identity(), timeout)).result()
        return distributed.Client(address, timeout=timeout)
    except Exception as error:  # the answer of another server may raise any error
        raise SchedulerError(
            f"scheduler is {format_value(address)}, which does not answer within {timeout:g} s, expected an "
            f"address such as tcp://127.0.0.1:8786{f': {error}' * bool(str(error))}"
        ) from error


def _results(
    points: Points, jobs: Sequence[Job], client: Any
) -> Iterator[tuple[Job, dict[str, Array], Part]]:
    """Yield the draws and records of jobs, in any order; few of them wait in memory."""
    workers = processors()
    executor: Any = ThreadPoolExecutor(workers)
    if client is not None:
        try:
            client.wait_for_workers(1, timeout=_ANSWER_TIME)
        except OSError as error:
            raise _scheduler_error(client, f"has no worker after {_ANSWER_TIME:g} s") from error
        executor, workers = client.get_executor(pure=False), 2 * sum(client.nthreads().values())
    remaining, last_seen = iter(jobs), monotonic()
    futures: dict[Future[Any], Job] = {}

    def send() -> None:
        for job in remaining:
            scenario = points.scenarios[job.scenario]
            part_scenario = scenario if client is None else scenario.subset(job.start, job.stop)
            futures[executor.submit(loop.part_of, part_scenario, job.start, job.stop)] = job
            return

    try:
        for _ in range(workers + 1):
            send()
        while futures:
            finished, _ = wait(futures, timeout=_CHECK_TIME, return_when=FIRST_COMPLETED)
            last_seen = monotonic() if finished or client is None or client.nthreads() else last_seen
            if client is not None and (client.status != "running" or monotonic() - last_seen > _WORKER_TIME):
                raise _scheduler_error(client, f"is lost, or had no worker for {_WORKER_TIME:g} s")
            for future in finished:
                draws, part = _answer(future, client)
                yield futures.pop(future), draws, part
                send()
    finally:
        for future in futures:
            future.cancel()
        if client is None:
            executor.shutdown()


def _answer(future: Future[Any], client: Any) -> tuple[dict[str, Array], Part]:
    if client is None:
        return future.result()  # type: ignore[no-any-return]
    distributed = import_extra("distributed", "sweeps", "a sweep")
    try:
        draws, part = future.result()
    except (CancelledError, distributed.CancelledError, distributed.KilledWorker) as error:
        raise _scheduler_error(client, f"dropped a chunk ({type(error).__name__}: {error})") from error
    return draws, Part._make((*map(np.array, part[:-1]), {}))  # received arrays may be read-only


def _scheduler_error(client: Any, event: str) -> SchedulerError:
    address = client.scheduler.address if client.scheduler else ""
    return SchedulerError(
        f"scheduler {address} {event}; finished chunks are in the store: start the same sweep again to resume"
    )
