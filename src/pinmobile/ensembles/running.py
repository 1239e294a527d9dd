"""`ensemble`, the verb: the robots of a scenario in stretches, on all cores, in any order with one result.

Loops that hold the interpreter's lock, such as those that ask Pinocchio, run in worker processes: each an
interpreter of its own that runs no file of the user's and imports what pickled parts name. So nothing is
forked, and a script needs no guard around what it does.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from io import BytesIO
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from time import perf_counter
from traceback import format_exception
from types import FunctionType
from typing import Any, Self
from warnings import warn

from pinmobile.arrays import Array, callable_as, whole
from pinmobile.compiled import processors
from pinmobile.controllers import Controller
from pinmobile.ensembles.distributions import Source
from pinmobile.ensembles.engines import Way, way_of
from pinmobile.ensembles.records import Part, Records
from pinmobile.ensembles.result import Ensemble
from pinmobile.ensembles.scenario import Scenario, checked_scenario
from pinmobile.errors import InvalidArgument, SchedulerError, SlowerEngine, shown
from pinmobile.forces import CoordinateForce, Force
from pinmobile.integrators import Integrator
from pinmobile.simulation import Engine, Plant
from pinmobile.trajectories import Trajectory

_START = 1.5  # seconds of a processor until a worker runs its first robot: Python and Pinocchio start
_WORTH = 3  # starts of a worker that the rest must take: then two save a sixth of it at least

Progress = Callable[[int, int], None]


def ensemble(
    robot: Plant,
    controller: Controller,
    trajectory: Trajectory,
    *,
    n: int,
    spread: Mapping[str, Source],
    dt: float,
    seed: int = 0,
    duration: float | None = None,
    integrator: Integrator | None = None,
    substeps: int = 1,
    forces: Sequence[Force | CoordinateForce] = (),
    limit: float = 1e3,
    after: float = 0.0,
    every: int | None = None,
    measures: Sequence[str] | None = None,
    traces: Iterable[int] = (),
    engine: Engine | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Ensemble:
    """Run a closed loop `n` times, each time with a robot, a start, gains or disturbances of its own.

    The same seed gives the same numbers, bit for bit, for any number of threads.

    Parameters
    ----------
    robot, controller, trajectory, n, spread, seed, dt, duration, integrator, substeps, forces, limit
        See `Scenario`.
    after : float
        Time from which on errors are kept [s].
    every : int, optional
        Samples between two entries of the bands over time.
    measures : sequence of str, optional
        What the robot states that is judged beside errors, by name; by default all, see `Scenario`.
    traces : iterable of int
        Robots of which a whole `Rollout` is kept, made by `simulate`.
    engine : Engine, optional
        `COMPILED`, `ARRAYS` or `PINOCCHIO`, one robot after another; by default the first of these that can.
    threads : int, optional
        By default one for each processor. Of laws that hold the interpreter's lock, as Pinocchio's, that many
        processes, where the work is worth starting them and all parts can be pickled.
    progress : callable, optional
        Called as ``progress(done, n)`` from time to time.

    Returns
    -------
    ensemble : Ensemble

    Raises
    ------
    InvalidArgument, UnknownName
        If an argument is not what is expected, draws are impossible, or the engine that is asked for cannot
        run the loop.

    Warns
    -----
    SlowerEngine
        If a part keeps the loop from the fastest engine; it names the part and what to write instead.
    """
    scenario = Scenario(
        robot=robot,
        controller=controller,
        trajectory=trajectory,
        n=n,
        spread=spread,
        dt=dt,
        seed=seed,
        duration=duration,
        integrator=integrator,
        substeps=substeps,
        forces=forces,
        limit=limit,
        after=after,
        every=every,
        measures=measures,
    )
    return run_scenario(scenario, traces=traces, engine=engine, threads=threads, progress=progress)


def run_scenario(
    scenario: Scenario,
    *,
    traces: Iterable[int] = (),
    engine: Engine | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Ensemble:
    """Run all robots of a scenario; the arguments are those of `ensemble`.

    Raises
    ------
    InvalidArgument
        As `ensemble`.
    """
    checked_scenario(scenario)
    workers = processors() if threads is None else whole("threads", threads)
    if progress is not None:
        callable_as("progress(done, n)", progress)
    if isinstance(traces, str | bytes) or not isinstance(traces, Iterable):
        raise InvalidArgument(f"traces is {shown(traces)}, expected indices of robots, such as [0]")
    followed = [_traced(i, scenario.n) for i in traces]
    draws = scenario.draws()
    way = way_of(scenario, engine)
    if way.why and engine is None:
        warn(
            f"this ensemble runs by {way.engine!r}, {way.engine.value}; {way.why}", SlowerEngine, stacklevel=3
        )
    with Workers(workers) as processes:
        part, how = _run(way, draws, 0, scenario.n, workers, progress, processes)
    why = "; ".join(filter(None, (way.why, how)))
    return Ensemble.of(scenario, draws, part, followed, engine=repr(way.engine), why=why)


def part_of(
    scenario: Scenario,
    start: int,
    stop: int,
    engine: Engine | None = None,
    processes: Workers | None = None,
) -> tuple[dict[str, Array], Part]:
    """Return the draws and records of the robots from `start` to before `stop`: a chunk of a sweep.

    Parameters
    ----------
    scenario : Scenario
        Whose robots.
    start, stop : int
        Which of them, 0 <= start < stop <= n.
    engine : Engine, optional
        As in `ensemble`.
    processes : Workers, optional
        Where laws that hold the interpreter's lock may run.

    Returns
    -------
    draws : dict of str to ndarray, shape (stop - start,)
        What was drawn, by name.
    part : Part
        The records.

    Raises
    ------
    InvalidArgument
        As `ensemble`.
    """
    way, draws = way_of(scenario, engine), scenario.draws(start, stop)
    return draws, _run(way, draws, start, stop, 1, None, processes)[0]


def _run(
    way: Way,
    draws: Mapping[str, Array],
    start: int,
    stop: int,
    threads: int,
    progress: Progress | None,
    processes: Workers | None,
) -> tuple[Part, str]:
    """Return the records of the robots from `start` to before `stop`, given what is drawn for these.

    The string says how, where that is worth telling.
    """

    def drawn(first: int, last: int) -> Mapping[str, Array]:
        if (first, last) == (start, stop):
            return draws
        return {name: column[first - start : last - start] for name, column in draws.items()}

    def run(first: int, last: int) -> Part:
        return way.run(drawn(first, last), first, last, threads)

    stretches = way.divided(start, stop, threads)
    shared = way.locks and processes is not None and processes.count > 1
    if len(stretches) == 1 and not shared:
        part = run(start, stop)
        if progress is not None:
            progress(stop - start, stop - start)
        return part, ""
    records, done, how = Records(start, stop), 0, ""

    def put(first: int, last: int, part: Part) -> None:
        nonlocal done
        records.put(first, last, part)
        done += last - first
        if progress is not None:
            progress(done, stop - start)

    begin, workers = start, way.workers(threads)
    if shared:
        assert processes is not None
        began = perf_counter()
        if way.alone:  # the first robot tells what one costs
            begin = start + 1
            put(start, begin, run(start, begin))
            stretches = way.divided(begin, stop, threads)
        cost = perf_counter() - began if way.alone else way.cost
        if cost * (stop - begin) > _WORTH * _START:
            try:
                sent = packed_way(way)
            except InvalidArgument as error:
                how = f"in one process, as {error}"
            else:
                stretches = way.shared(begin, stop, processes.count, cost)
                workers = min(processes.count, len(stretches))
                how = f"in {workers} processes"

                def run(first: int, last: int) -> Part:
                    return processes.part(sent, drawn(first, last), first, last)

    give_up = None if processes is None else processes.end
    for first, last, part in _results(run, stretches, workers, give_up):
        put(first, last, part)
    return records.part(), how


def _results(
    run: Callable[[int, int], Part],
    stretches: Sequence[tuple[int, int]],
    workers: int,
    give_up: Callable[[], None] | None,
) -> Iterator[tuple[int, int, Part]]:
    """Yield the stretches with what `run` gives for each, by some threads, in any order."""
    if workers == 1:
        for stretch in stretches:
            yield *stretch, run(*stretch)
        return
    with ThreadPoolExecutor(workers) as pool:
        waiting = {pool.submit(run, *stretch): stretch for stretch in stretches}
        try:
            for future in as_completed(waiting):
                yield *waiting.pop(future), future.result()
        except BaseException:
            if give_up is not None:
                give_up()  # nobody waits for what they are doing
            raise
        finally:
            pool.shutdown(cancel_futures=True)


def _traced(i: int, n: int) -> int:
    index = whole("traces", i, least=0)
    if index >= n:
        raise InvalidArgument(f"traces has robot {index}, expected 0 to {n - 1}")
    return index


class _Pickler(pickle.Pickler):
    """A pickler that refuses what another process cannot have, though it has a name here."""

    def reducer_override(self, thing: object) -> Any:
        if isinstance(thing, type | FunctionType):
            home = sys.modules.get(thing.__module__)
            if thing.__module__ == "__main__" or getattr(home, "__spec__", None) is None:
                raise pickle.PicklingError(
                    f"{thing.__qualname__} is of {thing.__module__}, which they cannot import"
                )
        return NotImplemented


def packed_way(way: Way) -> bytes:
    """Return a way to run a scenario as bytes for workers.

    Raises
    ------
    InvalidArgument
        If a part cannot be sent to another process; the message says why, in a few words.
    """
    if not sys.executable:
        raise InvalidArgument("there is no interpreter to start workers with")
    buffer = BytesIO()
    try:
        _Pickler(buffer).dump(way)
    except Exception as error:  # whatever a part's own pickling raises
        said = " ".join(str(error).split())
        raise InvalidArgument(f"a part cannot be sent to other processes: {said}") from error
    return buffer.getvalue()


class _Worker:
    """A process, and the line to it."""

    def __init__(self) -> None:
        self.line, theirs = Pipe()
        code = (
            f"import sys; sys.path[:] = {sys.path!r}; "
            f"from pinmobile.ensembles.running import serve; serve({theirs.fileno()})"
        )
        # In a session of its own, Ctrl-C reaches this process alone, which ends the others.
        self.process = subprocess.Popen(
            [sys.executable, "-c", code], pass_fds=[theirs.fileno()], start_new_session=True
        )
        theirs.close()
        self.known: bytes | None = None

    def part(self, way: bytes, draws: Mapping[str, Array], start: int, stop: int) -> Part:
        try:
            if self.known is not way:
                self.line.send_bytes(way)
                self.known = way
            self.line.send_bytes(pickle.dumps((draws, start, stop)))
            answer = self.line.recv_bytes()
        except (EOFError, OSError) as error:
            code = self.process.wait()
            raise SchedulerError(
                f"a worker process ended with code {code} while it ran robots {start} to {stop - 1}"
            ) from error
        error_, result = pickle.loads(answer)
        if error_ is not None:
            raise error_
        return Part(*result)


class Workers:
    """Processes that run robots; they are started when they are first needed, and end with the block.

    Parameters
    ----------
    count : int
        How many at most.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._all: list[_Worker] = []
        self._free: list[_Worker] = []
        self._changed = threading.Condition()
        self._ended = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.end()

    def part(self, way: bytes, draws: Mapping[str, Array], start: int, stop: int) -> Part:
        """Return the records of the robots from `start` to before `stop`, by the next worker that is free.

        Parameters
        ----------
        way : bytes
            How they are run, as `packed_way` returns it.
        draws : mapping of str to ndarray, shape (stop - start,)
            What is drawn for them.
        start, stop : int
            Which robots.

        Raises
        ------
        SchedulerError
            If the worker is lost.
        Exception
            Whatever a part raises there.
        """
        worker = self._taken()
        try:
            return worker.part(way, draws, start, stop)
        finally:
            with self._changed:
                self._free.append(worker)
                self._changed.notify()

    def _taken(self) -> _Worker:
        with self._changed:
            while not self._free and len(self._all) == self.count and not self._ended:
                self._changed.wait()
            if self._ended:
                raise SchedulerError("the worker processes were ended")
            if not self._free:
                self._all.append(_Worker())
                return self._all[-1]
            return self._free.pop()

    def end(self) -> None:
        """End all workers at once, whatever they are doing."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        for worker in self._all:
            worker.process.terminate()
        for worker in self._all:
            worker.process.wait()
            worker.line.close()


def serve(descriptor: int) -> None:
    """Run robots as the process at the other end of a line asks, until it is gone.

    Parameters
    ----------
    descriptor : int
        Of this end of the line.
    """
    line = Connection(descriptor)
    while True:
        try:
            asked = pickle.loads(line.recv_bytes())
            if isinstance(asked, Way):
                way = asked
                continue
            draws, start, stop = asked
            answer: tuple[Exception | None, object] = None, tuple(way.run(draws, start, stop, 1))
        except EOFError:
            return
        except Exception as error:
            answer = _sent(error), None
        try:
            line.send_bytes(pickle.dumps(answer))
        except OSError:
            return


def _sent(error: Exception) -> Exception:
    """Return an error as it comes back: itself, with where it was raised, or its words where it does not."""
    trace = "".join(format_exception(error))
    try:
        found: Exception = pickle.loads(pickle.dumps(error))
        for note in getattr(error, "__notes__", []):
            if note not in getattr(found, "__notes__", []):
                found.add_note(note)
    except Exception:  # of a class that cannot be made again
        notes = "; ".join(["", *getattr(error, "__notes__", [])])
        found = InvalidArgument(f"a part raises {type(error).__name__}: {error}{notes}")
    found.add_note(f"in a worker process:\n{trace}")
    return found
