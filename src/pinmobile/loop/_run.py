"""`ensemble` runs the robots of a scenario; `LoopStepper` advances one robot some samples at a time."""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any
from warnings import warn

import numpy as np

from pinmobile.arrays import Array, callable_as, check_integer, instance
from pinmobile.compiled import BINS, aligned, call, processors, robot_keys
from pinmobile.controllers import ContextView, Controller
from pinmobile.errors import (
    InvalidArgument,
    LimitWarning,
    NotFinite,
    NotTraceable,
    SlowerEngine,
    argument_errors,
)
from pinmobile.forces import Force
from pinmobile.integrators import Integrator
from pinmobile.loop._checks import sample_reference
from pinmobile.loop._description import Part, arguments_of, bins_of
from pinmobile.loop._engines import Compiled, compile_plant, python_samples
from pinmobile.loop._ensemble import Ensemble
from pinmobile.loop._loop import Loop, Sample, Samples, UntraceableMetric, Worst
from pinmobile.loop._rollout import Rollout
from pinmobile.loop._scenario import Scenario, check_scenario
from pinmobile.loop._simulate import Engine, check_engine, engine_errors, rollout_of
from pinmobile.loop._spread import SameAs, Source
from pinmobile.loop._trace import arrays_of, initial_memory, scheduled_rows, traced_numbers
from pinmobile.metrics import Metric, metrics_of
from pinmobile.parts import OnCoordinates, evolved, replace as replaced
from pinmobile.plant import Context, Plant
from pinmobile.signals import Signal
from pinmobile.trajectories import Reference, Trajectory

_PROGRESS_SIZE = 16  # robots between two reports of progress
_WORK = 2e7  # robots times samples of one call of compiled code: some 0.3 s
_REFERENCE_WORK = 1e6  # the same if each robot has its own reference: some 200 MB of references


Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class ExecutionPlan:
    """Execution plan of a scenario.

    Attributes
    ----------
    scenario : Scenario
        Scenario of the runs.
    engine : Engine
        Engine of the runs.
    fallback_reason : str
        Reason why the engine is not `Engine.COMPILED`; "" if it is, or if the user gave the engine.
    program : Compiled or None
        Compiled loop.
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
        """Return the records of the robots from `start` to before `stop`.

        Parameters
        ----------
        draws : mapping of str to ndarray, shape (stop - start,)
            Draws of these robots.
        start, stop : int
            Range of robots.
        threads : int
            Threads of compiled code.
        progress : callable, optional
            Function ``progress(done, total)``.

        Raises
        ------
        InvalidArgument
            If a metric becomes NaN; its mean square shows this.
        """
        return Part.concatenate(self._parts(draws, start, stop, threads, progress))

    def _parts(
        self, draws: Mapping[str, Array], start: int, stop: int, threads: int, progress: Progress | None
    ) -> Iterator[Part]:
        """Yield the records of some robots at a time, which allows progress reports and limits memory."""
        scenario, size = self.scenario, _PROGRESS_SIZE
        if self.program is not None:
            work = _REFERENCE_WORK if scenario.has_own_references or scenario.keep else _WORK
            size = 256 * max(1, min(256, round(work / len(scenario.t) / 256)))
        for first in range(start, stop, size):
            last = min(first + size, stop)
            columns = {name: column[first - start : last - start] for name, column in draws.items()}
            if self.program is not None:
                part = _compiled_part(scenario, self.program, columns, first, last, threads)
            else:
                part = Part.concatenate(self._python_parts(columns, first, last))
            for k, column in zip(*np.isnan(part.rms_metric).nonzero(), strict=True):
                metric, source = scenario.recorded_metrics[column], "its function"
                if metric.function is None:
                    kind = type(scenario.robot).__name__
                    source = f"plant is a {kind}, whose evaluate_metrics(t, q, v, a, u, reference)"
                message = f"robot {first + k}: {source} returned NaN as {metric.name!r}"
                raise InvalidArgument(f"{message}, expected a number")
            yield part
            if progress is not None:
                progress(last - start, stop - start)

    def _python_parts(self, draws: Mapping[str, Array], start: int, stop: int) -> Iterator[Part]:
        """Yield the records of robots, one after another; errors name the robot."""
        for i in range(start, stop):
            columns = {name: column[i - start : i - start + 1] for name, column in draws.items()}
            try:
                yield _python_part(self.scenario, columns, i, compiles=bool(self.fallback_reason))
            except Exception as error:
                is_plain = type(error) is InvalidArgument and not str(error).startswith("robot ")
                if is_plain:
                    raise InvalidArgument(f"robot {i}: {error}") from error
                error.add_note(f"robot {i} of the ensemble")
                raise


def plan_execution(scenario: Scenario, engine: Engine | None = None) -> ExecutionPlan:
    """Return the execution plan of a scenario: the given engine, by default compiled if its parts allow.

    Parameters
    ----------
    scenario : Scenario
        Scenario of the runs.
    engine : Engine, optional
        Engine of the runs.

    Raises
    ------
    InvalidArgument
        If the given engine cannot run the scenario, or if no law uses a number of the spread.
    """
    selected = check_engine(engine)
    if selected is Engine.PYTHON:
        return ExecutionPlan(scenario, Engine.PYTHON)
    metric_errors = argument_errors(after=", or give engine=Engine.PYTHON", of=UntraceableMetric)
    try:
        with engine_errors(selected), metric_errors:
            has_own = scenario.has_own_references
            loop = _add_recorder(scenario)
            compiled = compile_loop(scenario, loop, hides_reference=has_own, own_reference=has_own)
            return ExecutionPlan(scenario, Engine.COMPILED, "", compiled)
    except NotTraceable as error:
        return ExecutionPlan(scenario, Engine.PYTHON, f"not COMPILED: {error.reason}")


def _add_recorder(scenario: Scenario, loop: Loop | None = None) -> Loop:
    begin = float(scenario.begin) if scenario.begin else None
    distances = ((0, 1), (2,), *((k,) for k in range(3, scenario.size)))
    names, recorded = [metric.name for metric in metrics_of(scenario.robot)], scenario.recorded_metrics
    metrics = tuple((names.index(x.name) if x.function is None else x, x.is_margin) for x in recorded)
    recorder = Worst(scenario.limit, begin, distances, metrics, tuple(scenario.keep))
    return evolved(scenario.loop if loop is None else loop, {"recorder": recorder})


_OWN_REFERENCE = (
    "which differs from robot to robot",
    "use the reference of each sample, or spread no parameter of the trajectory",
)


def _affects_start(scenario: Scenario, path: str) -> bool:
    """Return whether a number changes the memory of the parts before the first sample."""
    value = np.asarray(scenario.find(path).leaf.value, np.float64)
    loops = scenario.loop, replaced(scenario.loop, {path: value * 1.001 + 1e-6})
    nominal, changed = (arrays_of(initial_memory(loop, scenario.context)) for loop in loops)
    return any(not np.array_equal(x, y) for x, y in zip(nominal, changed, strict=True))


def compile_loop(
    scenario: Scenario, loop: Loop, *, hides_reference: bool, own_reference: bool = False
) -> Compiled:
    """Return the machine code of a loop whose numbers of the spread differ.

    Parameters
    ----------
    scenario : Scenario
        Scenario of the runs.
    loop : Loop
        Its loop, with a recorder.
    hides_reference : bool
        Whether the context hides the reference from the controller.
    own_reference : bool
        Whether each robot has its own reference.

    Raises
    ------
    NotTraceable
        If a law does not accept symbols, or reads a hidden reference.
    InvalidArgument
        If no law uses a number of the spread.
    """
    first = Reference(*(part[0] for part in scenario.reference))
    context: Any = ContextView(scenario.context, _OWN_REFERENCE) if hides_reference else scenario.context
    compiled = Compiled(
        *(loop, context, scenario.start, first),
        spread=scenario.entries,
        single=scenario.n == 1,  # code for one robot does not fill vectors: two thirds of the time
        own_reference=own_reference,
    )
    sources = [source.name for source in scenario.spread.values() if isinstance(source, SameAs)]
    unused = set(compiled.tape.unused) - {scenario.find(name).leaf.path for name in sources}
    idle = []
    for name, number in scenario.numbers.items():
        path = number.leaf.path
        if path in unused and not _affects_start(scenario, path):
            if not path.startswith("plant."):
                message = f"spread has {name!r}, {number.meaning}, which no law of this loop uses"
                raise InvalidArgument(f"{message}, expected a number that a law uses")
            idle.append(repr(name))
    if idle:  # such as the mass of a load at rest
        message = f"no law of this loop uses {', '.join(idle)} of the spread: the values have no effect"
        warn(message, stacklevel=5)
    return compiled


def _compiled_part(
    scenario: Scenario, program: Compiled, draws: Mapping[str, Array], start: int, stop: int, threads: int
) -> Part:
    """Return the records of the robots from `start` to before `stop`, computed by machine code."""
    keys = {name: robot_keys(scenario.seed, name, range(start, stop)) for name in program.tape.keys}
    values = scenario.values(draws, start, stop)
    references = scenario.references(values, stop - start, start)
    run = scenario.starts(values, stop - start, references), scenario.t, Reference(*scenario.reference)
    rows = {path: value for path, value in values.items() if path in scenario.entries}
    options: Any = {"keys": keys, "every": scenario.stride, "threads": threads}
    outcome = program.run(*run, tracks=references, values=rows, **options)
    signals = {
        name: Signal(unit, outcome.kept[f"signal {name}"][:, :: scenario.stride])
        for name, unit in program.tape.units.items()
    }
    return Part.of(scenario, program.recorder_memory(outcome), outcome.counts, signals)


def _python_part(scenario: Scenario, draws: Mapping[str, Array], i: int, *, compiles: bool) -> Part:
    """Return the record of robot i; its controller, or its whole loop, runs in Python."""
    member = arguments_of(scenario, i, draws)
    reference = sample_reference(member.trajectory, scenario.t, member.robot)
    context = Context.of(
        member.robot, dt=scenario.dt, t=scenario.t, reference=reference, trajectory=member.trajectory
    )
    context = replace(context, seed=scenario.seed, member=i)
    parts = member.robot, member.controller, member.trajectory, member.options["forces"]
    loop = _add_recorder(scenario, Loop(*parts, scenario.integrator, scenario.substeps))
    q, v = (np.array(member.options[name], np.float64) for name in ("q0", "v0"))
    if compiles:
        with contextlib.suppress(NotTraceable):
            loop = compile_plant(loop, context, q, v)
    record = loop.recorder.initial_state(scenario.size, loop.plant.nu)
    counts = np.zeros((len(scenario.grid), len(scenario.channels), BINS), np.int32)
    counts[..., -1] = 1  # a diverged robot counts in the last bin
    for channel, one in enumerate(scenario.channels):
        if one.is_margin:
            counts[:, channel, 0], counts[:, channel, -1] = 1, 0
    signals: dict[str, Signal] = {}
    with np.errstate(all="ignore"), contextlib.suppress(NotFinite):
        for k, (_, sample) in enumerate(python_samples(loop, context, q, v)):
            record = sample.state
            if not record["alive"]:
                break
            if k % scenario.stride == 0:
                sizes = bins_of(np.array(sample.counted, np.float64))
                counts[k // scenario.stride] = 0
                counts[k // scenario.stride, range(len(sizes)), sizes] = 1
                for name, unit in sample.units.items():
                    value = sample.kept[f"signal {name}"]
                    row = np.zeros((1, len(scenario.grid), *np.shape(value)))
                    signals.setdefault(name, Signal(unit, row)).values[0, k // scenario.stride] = value
    return Part.of(scenario, {name: np.asarray(x)[None] for name, x in record.items()}, counts, signals)


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
    metrics: Sequence[str | Metric] | Mapping[str, Callable[[Sample], Any]] | None = None,
    keep: Sequence[str] = (),
    traces: Iterable[int] = (),
    engine: Engine | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Ensemble:
    """Run a closed loop for `n` robots with different parameters, starts, gains or disturbances.

    The same seed gives the same numbers, bit for bit, for any number of threads.

    Parameters
    ----------
    robot : MobileRobot or other plant
        Nominal plant.
    controller : controller
        Controller, see `simulate`.
    trajectory : trajectory
        Trajectory of all robots, unless the spread names one of its numbers.
    n : int
        Number of robots.
    spread : mapping of str to Distribution, number or array of shape (n,)
        Distributions of numbers, by path such as ``"plant.mass"`` or its end ``"mass"``, see `Scenario`.
    dt : float
        Time step of the controller [s].
    seed : int
        Seed of all draws; those of robot i do not depend on n.
    duration : float, optional
        Duration of each run [s], see `simulate`.
    integrator : callable, optional
        Integrator of the plant, see `simulate`.
    substeps : int
        Integrator steps per dt.
    forces : sequence of callable, or mapping of str to callable
        External forces, see `simulate`.
    limit : float
        Largest error of a loop that has not diverged [m, rad, m/s, rad/s].
    after : float
        Time from which the ensemble records errors [s].
    every : int, optional
        Samples between two entries of the bands over time; default: some 60 entries.
    metrics : sequence of str and Metric, or mapping of str to callable, optional
        Metrics to record beside errors, see `Scenario`: names of the robot's metrics, or your own. A mapping
        such as ``{"gap": lambda sample: 2.0 - sample.q[0]}`` adds functions of a `loop.Sample` to all metrics
        of the robot; a `metrics.Metric` has a unit and a rule too. Default: all metrics of the robot.
    keep : sequence of str
        Names of signals of controller, forces or plant that are kept for all robots, see `Ensemble.kept`.
    traces : iterable of int
        Indices of robots whose samples, signals included, are kept as a `Rollout`, which `simulate` computes.
    engine : Engine, optional
        `Engine.COMPILED`, the default if all parts can be compiled, or `Engine.PYTHON`, which runs one robot
        after another.
    threads : int, optional
        Threads of compiled code; default: one for each processor.
    progress : callable, optional
        Function ``progress(done, n)``, called from time to time.

    Returns
    -------
    Ensemble
        Results of the robots.

    Raises
    ------
    InvalidArgument, UnknownName
        If an argument is invalid, draws are impossible, or the given engine cannot run the loop.

    Warns
    -----
    SlowerEngine
        If a part prevents the fastest engine. The message names the part and the code to write instead.
    LimitWarning
        Once, if robots tip over, see `Ensemble.events`.

    See Also
    --------
    simulate : run one robot.
    Scenario : loop and spread of an ensemble.
    sweep : ensembles at the points of a grid.

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Tangent
    >>> from pinmobile import Uniform, ensemble
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> parts = robot, PD(120, 120), Tangent(Circle(1.0, 0.5, 4.0))
    >>> spread = {"mass": Uniform(20.0, 40.0)}  # [kg]
    >>> runs = ensemble(*parts, n=100, spread=spread, dt=0.02)
    >>> runs.error_quantile(0.99).distance  # [m]
    0.079
    """
    loop: Any = {"robot": robot, "controller": controller, "trajectory": trajectory, "forces": forces}
    steps: Any = {"dt": dt, "duration": duration, "integrator": integrator, "substeps": substeps}
    records: Any = {"limit": limit, "after": after, "every": every, "metrics": metrics, "keep": keep}
    scenario = Scenario(**loop, **steps, **records, n=n, spread=spread, seed=seed)
    return run_scenario(scenario, traces=traces, engine=engine, threads=threads, progress=progress)


def run_scenario(
    scenario: Scenario,
    *,
    traces: Iterable[int] = (),
    engine: Engine | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Ensemble:
    """Run all robots of a scenario.

    Parameters
    ----------
    scenario : Scenario
        Loop and spread of the ensemble.
    traces : iterable of int
        Indices of robots whose samples are kept as a `Rollout`.
    engine : Engine, optional
        Engine of the runs, see `ensemble`.
    threads : int, optional
        Threads of compiled code; default: one for each processor.
    progress : callable, optional
        Function ``progress(done, n)``, called from time to time.

    Returns
    -------
    Ensemble
        Results of the robots.

    Raises
    ------
    InvalidArgument
        If an argument is invalid, or the given engine cannot run the loop.

    See Also
    --------
    ensemble : the same with the arguments of a scenario.

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Scenario
    >>> from pinmobile import Tangent, Uniform
    >>> from pinmobile.loop import run_scenario
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> runs = Scenario(robot=robot, controller=PD(120, 120),
    ...                 trajectory=Tangent(Circle(1.0, 0.5, 4.0)),
    ...                 spread={"mass": Uniform(20, 40)},
    ...                 n=100, dt=0.02)
    >>> run_scenario(runs).error_quantile(0.99).distance  # [m]
    0.079
    """
    check_scenario(scenario)
    workers = processors() if threads is None else check_integer("threads", threads)
    if progress is not None:
        callable_as("progress(done, n)", progress)
    indices = instance("traces", traces, Iterable, "indices of robots, such as [0]")
    members = [check_integer("traces", i, least=0, most=scenario.n - 1) for i in indices]
    draws = scenario.draws()
    plan = plan_execution(scenario, engine)
    if plan.fallback_reason and engine is None:
        words = f"this ensemble runs by {plan.engine!r}, {plan.engine.value}; {plan.fallback_reason}"
        warn(words, SlowerEngine, stacklevel=3)
    part = plan.run(draws, 0, scenario.n, workers, progress)
    texts = repr(plan.engine), plan.fallback_reason
    result = Ensemble.of(scenario, draws, part, members, *texts)
    if sentences := [words for happens, words in result.format_events() if happens]:
        warn("; ".join(sentences), LimitWarning, stacklevel=3)
    return result


def part_of(
    scenario: Scenario, start: int, stop: int, engine: Engine | None = None
) -> tuple[dict[str, Array], Part]:
    """Return the draws and records of the robots from `start` to before `stop`: one chunk of a sweep.

    Parameters
    ----------
    scenario : Scenario
        Loop and spread of the ensemble.
    start, stop : int
        Range of robots, 0 <= start < stop <= n.
    engine : Engine, optional
        See `ensemble`.

    Returns
    -------
    draws : dict of str to ndarray, shape (stop - start,)
        Value of each number of the spread for each robot.
    part : Part
        Records of the robots.

    Raises
    ------
    InvalidArgument
        If draws are impossible, or the given engine cannot run the loop.

    See Also
    --------
    loop.run_scenario : run all robots.
    loop.Part : records of some robots.

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Scenario
    >>> from pinmobile import Tangent, Uniform
    >>> from pinmobile.loop import part_of
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> runs = Scenario(robot=robot, controller=PD(120, 120),
    ...                 trajectory=Tangent(Circle(1.0, 0.5, 4.0)),
    ...                 spread={"mass": Uniform(20, 40)},
    ...                 n=100, dt=0.02)
    >>> draws, part = part_of(runs, 10, 20)
    >>> len(draws["mass"]), float(part.max_distance.max())  # [m]
    (10, 0.077)
    """
    draws = scenario.draws(start, stop)
    return draws, plan_execution(scenario, engine).run(draws, start, stop)


_MAX_NUMBERS, _OVERHEAD = 1 << 24, 64  # numbers that are kept, some 130 MB, and the size of three arrays


class LoopStepper:
    """Compiled loop of one robot that advances some samples at a time.

    The samples of a stepper are those of `simulate`, bit for bit, unless numbers or references change.

    Parameters
    ----------
    scenario : Scenario
        Loop of one robot. The numbers of its spread can change between two samples.

    Attributes
    ----------
    k : int
        Index of the next sample.
    values : dict of str to float
        Numbers of the spread, by name.
    follows : bool
        Whether the loop uses the reference of each sample only, so that `advance` may receive another one.

    Raises
    ------
    InvalidArgument
        If the loop cannot be compiled.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        metrics = tuple((k, metric.is_margin) for k, metric in enumerate(scenario.recorded_metrics))
        loop = evolved(scenario.loop, {"recorder": Samples(errors=True, metrics=metrics)})
        with argument_errors("this loop cannot run in real time: ", of=NotTraceable):
            self.follows = True
            try:
                self._compiled = compile_loop(scenario, loop, hides_reference=True)
            except NotTraceable:
                if scenario.has_own_references:
                    raise
                self.follows = False
                self._compiled = compile_loop(scenario, loop, hides_reference=False)
        self._code = self._compiled.program.code()
        self._rows = scheduled_rows(loop, scenario.context) if self._compiled.tape.schedule_size else []
        self.reset({name: float(drawn[0]) for name, drawn in scenario.draws().items()})

    def reset(self, values: Mapping[str, float]) -> None:
        """Begin again at the first sample, with these numbers of the spread."""
        self._blocks: Array = np.zeros(0)
        self.k, size = 0, max(1, sum(ring.samples for ring in self._compiled.tape.rings))
        self._rings, self._counts = aligned((size, 1)), np.zeros(1, np.int32)
        self._parts: deque[tuple[Array, Array, Array]] = deque()  # samples, kept values, numbers
        self._size = 0
        self.change(values)

    def change(self, values: Mapping[str, float]) -> None:
        """Use other numbers of the spread from the next sample on.

        Raises
        ------
        InvalidArgument
            If the trajectory is impossible with these numbers.
        """
        scenario, compiled = self.scenario, self._compiled
        draws = {name: np.array([value]) for name, value in values.items()}
        all_values = scenario.values(draws, 0, 1)
        references = scenario.references(all_values, 1)
        reference = scenario.reference if references is None else Reference(*(x[:, 0] for x in references))
        rows = {path: x for path, x in all_values.items() if path in scenario.entries}
        numbers, first = {**traced_numbers(compiled.loop), **rows}, compiled.first(rows, 1)
        keys = {name: robot_keys(scenario.seed, name, range(1)) for name in compiled.tape.keys}
        start = scenario.starts(all_values, 1, references)
        blocks = compiled.program.blocks_of(start, 1, numbers, first, keys)
        if self.k:
            states = len(compiled.tape.states)
            blocks[:, :states] = self._blocks[:, :states]
        h = scenario.dt / scenario.substeps
        self._blocks, self._uniforms = blocks, compiled.program.uniforms_of(h, numbers, first)
        self.values, self.reference = dict(values), reference

    @property
    def units(self) -> Mapping[str, str]:
        """Units of the signals, by name."""
        return self._compiled.tape.units

    def times(self, count: int) -> Array:
        """Return the times of the next samples, shape (count,) [s]."""
        t, k = self.scenario.t, self.k + np.arange(count)
        return np.where(k < len(t), t[np.minimum(k, len(t) - 1)], k * self.scenario.dt)

    def ahead(self, count: int) -> Reference:
        """Return the reference of the next samples; after its end, it rests."""
        k, last = self.k + np.arange(count), len(self.scenario.t) - 1
        q, v, a = (x[np.minimum(k, last)] for x in self.reference)
        moves = (k <= last)[:, None]
        return Reference(q, v * moves, a * moves)

    def advance(self, count: int, reference: Reference | None = None) -> dict[str, Array]:
        """Compute the next samples, and return them by name, shape (count, ...).

        Parameters
        ----------
        count : int
            Number of samples, at least 1.
        reference : Reference, optional
            Reference of these samples; default: `ahead`.
        """
        program, t = self._compiled.program, self.times(count)
        desired = Reference(*(np.ascontiguousarray(x, np.float64) for x in reference or self.ahead(count)))
        last = len(self.scenario.t) - 1
        rows = [schedule[np.minimum(self.k + np.arange(count), last)] for schedule in self._rows]
        samples = program.samples_of(t, desired, self._uniforms, rows, self.k)
        records = aligned((1, count, self._compiled.tape.outputs_kept, 1))
        arrays = self._blocks, samples, self._uniforms, self._rings, self._counts, records
        call(self._code, *arrays, first=self.k)
        self._parts.append((samples, records, np.array([*self.values.values()], np.float64)))
        self._size += samples.size + records.size + _OVERHEAD
        while self._size > _MAX_NUMBERS:
            first = self._parts.popleft()
            self._size -= first[0].size + first[1].size + _OVERHEAD
        self.k += count
        return {name: x[0] for name, x in program.kept_samples(records, 1).items()}

    def rollout(self) -> Rollout:
        """Return the samples since the last reset, until a number is not finite.

        The signals contain the numbers of the spread, by name.

        Raises
        ------
        InvalidArgument
            If there is no sample.
        """
        parts, scenario = list(self._parts), self.scenario
        if not parts:
            raise InvalidArgument("the run has no sample yet")
        sample_parts, blocks, values = zip(*parts, strict=True)
        samples, program = np.concatenate(sample_parts), self._compiled.program
        records = {name: x[0] for name, x in program.kept_samples(np.concatenate(blocks, axis=1), 1).items()}
        numbers = np.repeat(values, [*map(len, sample_parts)], axis=0).T
        records |= {f"signal {name}": column for name, column in zip(self.values, numbers, strict=True)}
        units = {**self.units, **{name: x.unit for name, x in scenario.numbers.items()}}
        nq, n = self._compiled.tape.sizes[3:]
        t, *reference, _ = np.split(samples, np.cumsum([1, nq, n, n]), axis=1)
        finite = np.isfinite(np.hstack([records[name] for name in "qvau"])).all(axis=1)
        end = len(t) if finite.all() else int(np.argmin(finite))
        run = scenario.nominal_loop, t[:, 0], records, Reference(*reference)
        return rollout_of(*run, end, units, engine="COMPILED")
