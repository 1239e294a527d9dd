"""How the robots of a scenario are run: compiled, on arrays, or one after another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled import (
    BINS,
    Memory,
    Noise,
    Parts,
    Place,
    Program,
    Reference,
    Stepped,
    Summary,
    arrays_of,
    check_schedules,
    children,
    derived,
    initial_memory,
    once,
    one_sample,
    program_of,
    robot_keys,
    tracking_errors,
)
from pinmobile.divergence import is_near
from pinmobile.ensembles.records import Part, bins_of, one_by_one
from pinmobile.ensembles.scenario import Scenario
from pinmobile.errors import InvalidArgument, NotTraceable
from pinmobile.measures import measures_of
from pinmobile.plant import Context
from pinmobile.simulation import ARRAYS, COMPILED, PINOCCHIO, Engine, check_same, checked_engine

_AT_ONCE = 4096  # robots on arrays
_ONE_BY_ONE = 16  # robots between two reports of progress
_STEP = 2e-5  # seconds of a step of one of many robots by Pinocchio, at least
_ANSWER = 0.5  # seconds between two answers of a process that runs robots one after another, about
_WORK = 2e7  # robots times samples that are compiled code's at once: some 0.3 s
_SAMPLED = 1e6  # the same where each robot has a reference of its own: some 200 MB of them
_ROWS = 4  # of three, rows could be taken for coordinates
_CLOSE = 1e-9  # of the largest number: rounding, which may depend on how many rows there are


@dataclass(frozen=True, eq=False)
class Way:
    """How a scenario is run.

    Attributes
    ----------
    scenario : Scenario
        What is run.
    engine : Engine
        By which engine.
    why : str
        Why not by a faster one; "" where there is none, or it was asked for.
    program : Program or None
        Its compiled loop.
    """

    scenario: Scenario
    engine: Engine
    why: str = ""
    program: Program | None = None

    def workers(self, threads: int) -> int:
        """Return how many threads of Python are worth it: compiled code has its own, Pinocchio locks."""
        return threads if self.engine is ARRAYS and not self.locks else 1

    @property
    def alone(self) -> bool:
        """Whether robots run one after another, so that the first tells what each costs."""
        return self.engine is PINOCCHIO

    @property
    def cost(self) -> float:
        """Seconds that a robot takes at least, of many at once whose model is Pinocchio's."""
        return len(self.scenario.t) * self.scenario.substeps * _STEP

    def shared(self, start: int, stop: int, workers: int, cost: float) -> list[tuple[int, int]]:
        """Divide the robots among processes; `cost` is what one takes alone [s]."""
        share = -(-(stop - start) // workers)
        if not self.alone:
            return self._each(start, stop, share)
        return self._each(start, stop, max(1, min(round(_ANSWER / cost), -(-share // 4))))

    def _each(self, start: int, stop: int, each: int) -> list[tuple[int, int]]:
        if self.engine is ARRAYS:
            most = _AT_ONCE
            if self.scenario.has_own_references:
                most = min(most, int(_SAMPLED / len(self.scenario.t)))
            each = max(_ROWS, min(each, most))
        return [(first, min(first + each, stop)) for first in range(start, stop, each)]

    @cached_property
    def locks(self) -> bool:
        """Whether its robots' laws hold the interpreter's lock, so that other processes would help."""
        return self.engine is PINOCCHIO or (self.engine is ARRAYS and _asks_pinocchio(self.scenario.parts))

    def __getstate__(self) -> dict[str, Any]:
        return {"scenario": self.scenario, "engine": self.engine, "why": self.why, "program": None}

    def divided(self, start: int, stop: int, threads: int) -> list[tuple[int, int]]:
        """Divide the robots so that every worker has something to do, and none too much at a time."""
        if self.engine is COMPILED:
            work = _SAMPLED if self.scenario.has_own_references else _WORK
            return self._each(start, stop, 256 * max(1, min(256, round(work / len(self.scenario.t) / 256))))
        share = -(-(stop - start) // self.workers(threads))
        return self._each(start, stop, share if self.engine is ARRAYS else _ONE_BY_ONE)

    def run(self, draws: Mapping[str, Array], start: int, stop: int, threads: int) -> Part:
        """Return the records of the robots from `start` to before `stop`, given what is drawn for these."""
        if self.engine is COMPILED:
            part = _compiled(self, draws, start, stop, threads)
        elif self.engine is ARRAYS:
            part = _on_arrays(self.scenario, draws, start, stop)
        else:
            part = one_by_one(self.scenario, start, stop)
        _check_measured(self.scenario, part, start)
        return part


def _check_measured(scenario: Scenario, part: Part, start: int) -> None:
    """Refuse measures that became no numbers, of which nothing but the mean square tells.

    Raises
    ------
    InvalidArgument
        If there is one.
    """
    for one, column in zip(scenario.judged, part.rms_measure.T, strict=True):
        wrong = np.flatnonzero(np.isnan(column))
        if wrong.size:
            raise InvalidArgument(
                f"robot {start + wrong[0]}: plant is a {type(scenario.robot).__name__}, whose measured(t, q, "
                f"v, a, u, reference) returned NaN as {one.name!r}, expected a number"
            )


def _asks_pinocchio(parts: Parts) -> bool:
    """Tell whether a part has a model whose law is no NumPy."""

    def asks(part: object) -> bool:
        try:
            if hasattr(part, "traced"):
                part.traced()
                return False
        except NotTraceable:
            return True
        return any(asks(child) for _, child in children(part))

    return any(asks(part) for path, part in parts.by_path() if path != "trajectory")


def way_of(scenario: Scenario, engine: Engine | None = None) -> Way:
    """Return how a scenario is run: as asked for, by default the fastest way that its parts allow.

    Raises
    ------
    InvalidArgument
        If the engine that is asked for cannot run it, or a parameter is spread that no law uses.
    """
    asked = checked_engine(engine, COMPILED, ARRAYS, PINOCCHIO)
    why: list[str] = []
    for each, way in ((COMPILED, _as_compiled), (ARRAYS, _as_arrays)):
        if asked is each or (asked is None and not (each is ARRAYS and _are_few(scenario))):
            try:
                found = way(scenario)
                return Way(scenario, each, "; ".join(why), found)
            except NotTraceable as error:
                refusal = error.reason
            if asked is not None:
                raise InvalidArgument(f"engine is {each!r}, which cannot run this: {refusal}")
            why.append(f"not {each!r}: {refusal}")
    return Way(scenario, PINOCCHIO, "; ".join(why))


def _are_few(scenario: Scenario) -> bool:
    """Tell whether robots one after another are faster than arrays of so few."""
    return scenario.n < getattr(scenario.parts.on_arrays().plant, "worth_arrays", 2)


def _with_recorder(scenario: Scenario) -> Parts:
    begin = float(scenario.begin) if scenario.begin else None
    parts = scenario.parts
    stated = [one.name for one in measures_of(parts.plant)]
    recorder = Summary(
        limit=scenario.limit,
        begin=begin,
        distances=((0, 1), (2,), *((k,) for k in range(3, scenario.size))),
        measures=tuple((stated.index(one.name), one.is_margin) for one in scenario.judged),
    )
    return Parts(parts.plant, parts.controller, parts.forces, parts.integrator, recorder, parts.substeps)


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
    """Return what the controller of many robots at once is told."""
    return _Blind(scenario.context) if scenario.has_own_references else scenario.context


def _values(scenario: Scenario, draws: Mapping[str, Array], start: int, stop: int) -> dict[Place, Array]:
    """Return what the loops of robots have of their own."""
    values, places = scenario.values(draws, start, stop), set(scenario.places)
    return {place: value for place, value in values.items() if place in places}


def _moved(scenario: Scenario, place: Place) -> Parts:
    """Return the parts of a scenario, made again with another value of one parameter."""
    parts = scenario.parts
    value = parts.on_arrays().parameters()[place]
    return parts.with_parameters({place: value * 1.001 + 1e-6}, remade=True)


def _starts_otherwise(scenario: Scenario, place: Place) -> bool:
    """Tell whether a parameter changes what the parts keep before the first sample."""
    before, after = (
        arrays_of(initial_memory(parts.on_arrays(), scenario.context, scenario.size))
        for parts in (scenario.parts, _moved(scenario, place))
    )
    return any(not np.array_equal(one, other) for one, other in zip(before, after, strict=True))


def _check_derived(scenario: Scenario) -> None:
    """Refuse parts that derive something from a spread parameter when they are made, which a copy lacks.

    Raises
    ------
    NotTraceable
        If there is one.
    """
    for stated in scenario.stated.values():
        place = stated.place
        if place not in scenario.places:
            continue
        # A part may derive of what stands in it, too; one that has `traced` is traced as it is then.
        way = scenario.parts.on_the_way(place.path)
        asked = [(path, part) for path, part in way if not hasattr(part, "traced")]
        if not asked:
            continue
        try:
            moved = _moved(scenario, place)
        except InvalidArgument:
            continue  # a value beside the nominal one is not allowed
        for path, part in asked:
            *_, (_, other) = moved.on_the_way(path)
            inner = {name.partition("[")[0] for name, _ in children(part)}
            name = derived(part, other, inner | ({place.name} if path == place.path else set()))
            if name:
                raise NotTraceable(
                    f"{path}, a {type(part).__name__}, makes {name} of {place.name} once",
                    "compute it in the law",
                )


def _is_alone(scenario: Scenario) -> bool:
    """Tell whether there is one robot, whose code takes two thirds of the time where it fills no vectors."""
    return scenario.n == 1


def _as_compiled(scenario: Scenario) -> Program:
    begins = scenario.begin > 0
    return once(  # type: ignore[no-any-return]
        scenario._memory_now(),
        ("program", tuple(scenario.spread), begins, _is_alone(scenario), *scenario._told),
        lambda: _program(scenario),
    )


def _check_judged(scenario: Scenario) -> None:
    """Refuse a plant whose measures differ from those of what is run in its place.

    Raises
    ------
    NotTraceable
        If it is such.
    """
    plant = scenario.parts.plant
    if scenario.judged and measures_of(scenario.parts.on_arrays().plant) != measures_of(plant):
        raise NotTraceable(
            f"plant, a {type(plant).__name__}, states measures that what its traced() returns does not",
            "give that the same measures",
        )


def _program(scenario: Scenario) -> Program:
    _check_judged(scenario)
    _check_derived(scenario)
    parts, at = _with_recorder(scenario), Reference(*(part[0] for part in scenario.reference))
    program = program_of(
        *(parts, _context(scenario), scenario.start, at),
        dt=scenario.dt,
        spread=scenario.places,
        single=_is_alone(scenario),
        own_reference=scenario.has_own_references,
    )
    unused = set(program.loop.unused)
    for name, stated in scenario.stated.items():
        # What the plant has may not matter to one run, as the mass of what nobody pushes; it is its own.
        place = stated.place
        if stated.path != "plant" and place in unused and not _starts_otherwise(scenario, place):
            of = f", {stated.parameter.meaning}" if stated.parameter.meaning else ""
            raise InvalidArgument(
                f"spread has {name!r}{of}, which no law of this loop uses, expected a parameter that matters"
            )
    return program


def _compiled(way: Way, draws: Mapping[str, Array], start: int, stop: int, threads: int) -> Part:
    scenario, program = way.scenario, way.program
    assert program is not None
    keys = {name: robot_keys(scenario.seed, name, range(start, stop)) for name in program.loop.keys}
    own = scenario.references(draws, stop - start, start)
    outcome = program.run(
        _with_recorder(scenario),
        _context(scenario),
        scenario.starts(draws, stop - start, own),
        scenario.t,
        Reference(*scenario.reference),
        dt=scenario.dt,
        tracks=None if own is None else Reference(*own),
        values=_values(scenario, draws, start, stop),
        keys=keys,
        every=scenario.stride,
        threads=threads,
        memory=scenario._memory,
    )
    return Part.of(scenario, outcome.memory.recorder, outcome.counts)


@dataclass(frozen=True)
class _Rows:
    """A loop of several robots on arrays."""

    parts: Parts
    memory: Memory
    q: Array
    v: Array
    references: Reference | None = None  # where each has its own

    def at(self, k: int, all_have: Reference) -> Reference:
        """Return the reference of sample k."""
        return Reference(*(part[k] for part in self.references or all_have))


def _rows(scenario: Scenario, draws: Mapping[str, Array], start: int, stop: int) -> _Rows:
    given = _with_recorder(scenario)
    parts = given.on_arrays().with_parameters(_values(scenario, draws, start, stop))
    own = scenario.references(draws, stop - start, start)

    def normal(name: str, n: int) -> Noise:
        return Noise(robot_keys(scenario.seed, name, range(start, stop)), n)

    memory = initial_memory(parts, _context(scenario), scenario.size, normal=normal)
    begin = scenario.starts(draws, stop - start, own)
    return _Rows(parts, memory, *begin, None if own is None else Reference(*own))


def _as_arrays(scenario: Scenario) -> None:
    """Refuse parts that are written for one robot, or that mix the rows of several.

    Raises
    ------
    NotTraceable
        If a part returns another shape, fails, or gives a robot beside others another number than alone.
    """
    _check_judged(scenario)
    check_schedules(scenario.parts.on_arrays(), _context(scenario), scenario.size, scenario.places)
    several = min(_ROWS, scenario.n)
    count = max(2, several)  # one alone is asked beside itself
    draws = {name: np.resize(column, count) for name, column in scenario.draws(0, several).items()}
    h = scenario.dt / scenario.substeps
    steps = np.arange(1.0, 1 + count * scenario.robot.nv).reshape(count, -1) * 1e-2  # no two rows alike

    def sampled(first: int, last: int, sample: int) -> tuple[Array, ...]:
        mine = {name: column[first:last] for name, column in draws.items()}
        rows = _rows(scenario, mine, first, last)
        q = np.stack(
            [
                rows.parts.plant.integrate(*each)
                for each in zip(rows.q, np.sin(7 * steps[first:last]) * 0.1, strict=True)
            ]
        )
        v = rows.v + np.sin(11 * steps[first:last]) * 0.1
        at, time = rows.at(sample, Reference(*scenario.reference)), float(scenario.t[sample])
        with np.errstate(all="ignore"):
            found = one_sample(rows.parts, float(sample), time, h, (q, v), at, rows.memory)
        shapes = {
            "u": (found.sample.u, (last - first, rows.parts.plant.nu)),
            "q": (found.q, (last - first, rows.parts.plant.nq)),
            "v": (found.v, (last - first, rows.parts.plant.nv)),
        }
        if scenario.judged:
            measures = (last - first, len(rows.parts.plant.measures))
            shapes["measured"] = found.sample.measured, measures
        for name, (array, shape) in shapes.items():
            if np.shape(array) != shape:
                raise NotTraceable(
                    f"{name} of {last - first} robots at once has shape {np.shape(array)}, expected {shape}",
                    "write laws for one row per robot: [..., i] and axis=-1",
                )
        return tuple(np.asarray(array, np.float64) for array, _ in shapes.values())

    _check_derived(scenario)
    last = len(scenario.t) - 1
    for sample in sorted({0, last // 2, last}):  # a law may be another one later
        time = scenario.t[sample]
        try:
            together = sampled(0, count, sample)
            alone = [sampled(i, i + 1, sample) for i in range(count)]
        except NotTraceable:
            raise
        except Exception as error:
            raise NotTraceable(
                f"with {count} robots at once a law raises {type(error).__name__} ({error})",
                "write laws for one row per robot: [..., i] and axis=-1",
            ) from error
        for k, name in enumerate(("u", "q", "v", "measured")[: len(together)]):
            single = np.concatenate([each[k] for each in alone])
            size = np.abs(np.nan_to_num(single)).max(initial=0.0)
            if not np.allclose(together[k], single, rtol=_CLOSE, atol=_CLOSE * size, equal_nan=True):
                raise NotTraceable(
                    f"{name} of {count} robots at once is not what each has alone at {time:g} s",
                    "write laws for one row per robot: [..., i] and axis=-1",
                )


def _on_arrays(scenario: Scenario, draws: Mapping[str, Array], start: int, stop: int) -> Part:
    rows = _rows(scenario, draws, start, stop)
    q, v, memory, h = rows.q, rows.v, rows.memory, scenario.dt / scenario.substeps
    counts = np.zeros((len(scenario.grid), len(scenario.channels), BINS), np.int32)
    begin, looked_at = scenario.start, None
    with np.errstate(all="ignore"):  # what overflows is judged
        for k, time in enumerate(scenario.t.tolist()):
            at = rows.at(k, Reference(*scenario.reference))
            errors = np.concatenate(tracking_errors(rows.parts.plant, q, v, at), axis=-1)
            alive = (memory.recorder["alive"] > 0.5) & is_near(errors, scenario.limit)
            # A robot that diverged goes on from the trajectory's start, so that no law sees NaN.
            q, v = np.where(alive[:, None], q, begin[0]), np.where(alive[:, None], v, begin[1])
            memory = memory._replace(recorder={**memory.recorder, "alive": np.where(alive, 1.0, 0.0)})
            asked = rows.parts, float(k), time, h, (q, v), at, memory
            found = one_sample(*asked)
            if k <= 1:  # the first is on the trajectory, where many laws give nothing
                looked_at = asked, found
            q, v, memory = found.q, found.v, found.memory
            if k % scenario.stride == 0:
                for row, size in zip(counts[k // scenario.stride], found.record.counted, strict=True):
                    row += np.bincount(bins_of(np.asarray(size)), minlength=BINS)
        if looked_at is not None:
            _check_again(*looked_at)
    return Part.of(scenario, memory.recorder, counts)


# The arguments of `one_sample`: parts, number and time of the sample, step, state, reference and memory.
_Asked: TypeAlias = tuple[Parts, float, float, float, tuple[Array, Array], Reference, Memory]


def _check_again(asked: _Asked, found: Stepped) -> None:
    """Refuse parts that answer differently when they are asked for a sample again after the last one."""
    again, t = one_sample(*asked), float(found.sample.t)
    acting = "plant or forces" if asked[0].forces else "plant"
    check_same("controller", t, found.sample.u, again.sample.u)
    check_same(acting, t, found.sample.a, again.sample.a)
    check_same("integrator", t, np.hstack([found.q, found.v]), np.hstack([again.q, again.v]))
