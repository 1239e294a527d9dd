"""`ensemble`, the verb: the robots of a scenario run compiled, or one after another in Python."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any
from warnings import warn

import numpy as np

from pinmobile.arrays import Array, callable_as, instance, whole
from pinmobile.compiled import BINS, processors, robot_keys
from pinmobile.controllers import Controller
from pinmobile.errors import InvalidArgument, LimitWarning, NotFinite, NotTraceable, SlowerEngine
from pinmobile.forces import Force
from pinmobile.integrators import Integrator
from pinmobile.loop._checks import sampled
from pinmobile.loop._ensemble import Ensemble
from pinmobile.loop._loop import Loop
from pinmobile.loop._program import Compiled
from pinmobile.loop._python import in_python, with_compiled_plant
from pinmobile.loop._record import Worst
from pinmobile.loop._scenario import Scenario, checked_scenario
from pinmobile.loop._simulate import Engine, checked_engine
from pinmobile.loop._spread import Source
from pinmobile.loop._trace import arrays_of, initial_memory
from pinmobile.loop._variables import Part, bins_of, member_of
from pinmobile.metrics import metrics_of
from pinmobile.parts import OnCoordinates, evolved, replace as replaced
from pinmobile.plant import Context, Plant
from pinmobile.trajectories import Reference, Trajectory

_ONE_BY_ONE = 16  # robots between two reports of progress
_WORK = 2e7  # robots times samples that are compiled code's at once: some 0.3 s
_SAMPLED = 1e6  # the same where each robot has a reference of its own: some 200 MB of them


Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class Way:
    """How a scenario is run.

    Attributes
    ----------
    scenario : Scenario
        What is run.
    engine : Engine
        By which engine.
    fallback_reason : str
        Why not compiled; "" where it is, or the engine was asked for.
    program : Compiled or None
        Its compiled loop.
    """

    scenario: Scenario
    engine: Engine
    fallback_reason: str = ""
    program: Compiled | None = None

    def run(
        self,
        draws: Mapping[str, Array],
        start: int,
        stop: int,
        threads: int = 1,
        progress: Progress | None = None,
    ) -> Part:
        """Return the records of the robots from `start` to before `stop`, given what is drawn for these.

        Raises
        ------
        InvalidArgument
            If a metric becomes no number, of which nothing but the mean square tells.
        """
        return Part.joined(self._parts(draws, start, stop, threads, progress))

    def _parts(
        self, draws: Mapping[str, Array], start: int, stop: int, threads: int, progress: Progress | None
    ) -> Iterator[Part]:
        """Yield the records of some robots at a time, for progress and for little memory."""
        scenario, each = self.scenario, _ONE_BY_ONE
        if self.program is not None:
            work = _SAMPLED if scenario.has_own_references else _WORK
            each = 256 * max(1, min(256, round(work / len(scenario.t) / 256)))
        for first in range(start, stop, each):
            last = min(first + each, stop)
            own = {name: column[first - start : last - start] for name, column in draws.items()}
            if self.program is not None:
                part = _compiled(scenario, self.program, own, first, last, threads)
            else:
                part = Part.joined(self._in_python(own, first, last))
            for one, column in zip(scenario.recorded_metrics, part.rms_metric.T, strict=True):
                wrong = np.flatnonzero(np.isnan(column))
                if wrong.size:
                    raise InvalidArgument(
                        f"robot {first + wrong[0]}: plant is a {type(scenario.robot).__name__}, whose "
                        "evaluate_metrics(t, q, v, a, u, reference) returned NaN as "
                        f"{one.name!r}, expected a number"
                    )
            yield part
            if progress is not None:
                progress(last - start, stop - start)

    def _in_python(self, draws: Mapping[str, Array], start: int, stop: int) -> Iterator[Part]:
        """Yield the records of robots, one after another; errors name the robot."""
        for i in range(start, stop):
            own = {name: column[i - start : i - start + 1] for name, column in draws.items()}
            try:
                yield _alone(self.scenario, own, i, compiles=bool(self.fallback_reason))
            except Exception as error:
                is_plain = type(error) is InvalidArgument and not str(error).startswith("robot ")
                if is_plain:
                    raise InvalidArgument(f"robot {i}: {error}") from error
                error.add_note(f"robot {i} of the ensemble")
                raise


def way_of(scenario: Scenario, engine: Engine | None = None) -> Way:
    """Return how a scenario is run: as asked for, by default compiled where its parts allow.

    Raises
    ------
    InvalidArgument
        If the engine that is asked for cannot run it, or a parameter is spread that no law uses.
    """
    asked = checked_engine(engine)
    if asked is Engine.PYTHON:
        return Way(scenario, Engine.PYTHON)
    try:
        return Way(scenario, Engine.COMPILED, "", _as_compiled(scenario))
    except NotTraceable as error:
        if asked is not None:
            raise InvalidArgument(
                f"engine is Engine.COMPILED, which cannot run this: {error.reason}"
            ) from error
        return Way(scenario, Engine.PYTHON, f"not COMPILED: {error.reason}")


def _with_recorder(scenario: Scenario, loop: Loop | None = None) -> Loop:
    begin = float(scenario.begin) if scenario.begin else None
    loop = scenario.loop if loop is None else loop
    stated = [one.name for one in metrics_of(scenario.robot)]
    recorder = Worst(
        limit=scenario.limit,
        begin=begin,
        distances=((0, 1), (2,), *((k,) for k in range(3, scenario.size))),
        metrics=tuple((stated.index(one.name), one.is_margin) for one in scenario.recorded_metrics),
    )
    return evolved(loop, {"recorder": recorder})


class _Blind:
    """The context of robots that have references of their own: it shows none, as there is no one of all."""

    def __init__(self, context: Context) -> None:
        self._context = context

    def __getattr__(self, name: str) -> Any:
        if name in ("reference", "trajectory"):
            raise NotTraceable(
                f"the controller asks its context for the {name}, which each robot has of its own",
                "let it follow the reference of each sample, or spread no parameter of the trajectory",
            )
        return getattr(self._context, name)


def _context(scenario: Scenario) -> Any:
    """Return the context of a controller of many robots at once."""
    return _Blind(scenario.context) if scenario.has_own_references else scenario.context


def _starts_otherwise(scenario: Scenario, path: str) -> bool:
    """Return whether a number changes what the parts keep before the first sample."""
    value = np.asarray(scenario.find(path).leaf.value, np.float64)
    loops = scenario.loop, replaced(scenario.loop, {path: value * 1.001 + 1e-6})
    before, after = (arrays_of(initial_memory(loop, scenario.context)) for loop in loops)
    return any(not np.array_equal(one, other) for one, other in zip(before, after, strict=True))


def _as_compiled(scenario: Scenario) -> Compiled:
    at = Reference(*(part[0] for part in scenario.reference))
    compiled = Compiled(
        *(_with_recorder(scenario), _context(scenario), scenario.start, at),
        spread=scenario.entries,
        single=scenario.n == 1,  # code for one takes two thirds of the time where it fills no vectors
        own_reference=scenario.has_own_references,
    )
    unused = set(compiled.tape.unused)
    for name, one in scenario.found.items():
        # The plant's may not matter to one run, as the mass of what nobody pushes; it is its own.
        path = one.leaf.path
        if not path.startswith("plant.") and path in unused and not _starts_otherwise(scenario, path):
            raise InvalidArgument(
                f"spread has {name!r}, {one.meaning}, which no law of this loop uses, expected a number that "
                "matters"
            )
    return compiled


def _compiled(
    scenario: Scenario, program: Compiled, draws: Mapping[str, Array], start: int, stop: int, threads: int
) -> Part:
    """Return the records of the robots from `start` to before `stop`, which run side by side."""
    keys = {name: robot_keys(scenario.seed, name, range(start, stop)) for name in program.tape.keys}
    own = scenario.references(draws, stop - start, start)
    values = scenario.values(draws, start, stop)
    outcome = program.run(
        scenario.starts(draws, stop - start, own),
        scenario.t,
        Reference(*scenario.reference),
        tracks=own,
        values={path: value for path, value in values.items() if path in scenario.entries},
        keys=keys,
        every=scenario.stride,
        threads=threads,
    )
    return Part.of(scenario, program.recorded(outcome), outcome.counts)


def _alone(scenario: Scenario, draws: Mapping[str, Array], i: int, *, compiles: bool) -> Part:
    """Return the records of robot i, whose controller, or whose loop, runs in Python."""
    member = member_of(scenario, i, draws)
    reference = sampled(member.trajectory, scenario.t, member.robot)
    context = Context.of(
        member.robot, dt=scenario.dt, t=scenario.t, reference=reference, trajectory=member.trajectory
    )
    context = replace(context, seed=scenario.seed, member=i)
    parts = member.robot, member.controller, member.trajectory, member.options["forces"]
    loop = _with_recorder(scenario, Loop(*parts, scenario.integrator, scenario.substeps))
    q, v = (np.array(member.options[name], np.float64) for name in ("q0", "v0"))
    if compiles:
        with contextlib.suppress(NotTraceable):
            loop = with_compiled_plant(loop, context, q, v)
    record = loop.recorder.initial_state(scenario.size, loop.plant.nu)
    counts = np.zeros((len(scenario.grid), len(scenario.channels), BINS), np.int32)
    counts[..., -1] = 1  # of a robot that has diverged
    for channel, one in enumerate(scenario.channels):
        if one.is_margin:
            counts[:, channel, 0], counts[:, channel, -1] = 1, 0
    with np.errstate(all="ignore"), contextlib.suppress(NotFinite):
        for k, (_, found) in enumerate(in_python(loop, context, q, v)):
            record = found.state
            if not record["alive"]:
                break
            if k % scenario.stride == 0:
                sizes = bins_of(np.array(found.counted, np.float64))
                counts[k // scenario.stride] = 0
                counts[k // scenario.stride, range(len(sizes)), sizes] = 1
    return Part.of(scenario, {name: np.asarray(x)[None] for name, x in record.items()}, counts)


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
    forces: Sequence[Force | OnCoordinates] | Mapping[str, Force | OnCoordinates] = (),
    limit: float = 1e3,
    after: float = 0.0,
    every: int | None = None,
    metrics: Sequence[str] | None = None,
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
    metrics : sequence of str, optional
        What the robot states that is judged beside errors, by name; by default all, see `Scenario`.
    traces : iterable of int
        Robots of which a whole `Rollout` is kept, made by `simulate`.
    engine : Engine, optional
        `Engine.COMPILED`, the default where all parts can be compiled, or `Engine.PYTHON`, one robot after
        another.
    threads : int, optional
        Of compiled loops; by default one for each processor.
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
    LimitWarning
        Once, if robots tip over: see `Ensemble.events`.
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
        metrics=metrics,
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
    listed = instance("traces", traces, Iterable, "indices of robots, such as [0]")
    followed = [whole("traces", i, least=0, most=scenario.n - 1) for i in listed]
    draws = scenario.draws()
    way = way_of(scenario, engine)
    if way.fallback_reason and engine is None:
        warn(
            f"this ensemble runs by {way.engine!r}, {way.engine.value}; {way.fallback_reason}",
            SlowerEngine,
            stacklevel=3,
        )
    part = way.run(draws, 0, scenario.n, workers, progress)
    found = Ensemble.of(
        scenario, draws, part, followed, engine=repr(way.engine), fallback_reason=way.fallback_reason
    )
    if found.events:
        warn("; ".join(found.events), LimitWarning, stacklevel=3)
    return found


def part_of(
    scenario: Scenario, start: int, stop: int, engine: Engine | None = None
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
    draws = scenario.draws(start, stop)
    return draws, way_of(scenario, engine).run(draws, start, stop)
