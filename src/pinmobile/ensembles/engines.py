"""How the robots of a scenario are run: compiled, or one after another in Python."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled import (
    BINS,
    Parts,
    Place,
    Program,
    Reference,
    Summary,
    arrays_of,
    children,
    derived,
    initial_memory,
    once,
    program_of,
    robot_keys,
)
from pinmobile.ensembles.records import Part, Records, bins_of, member_of
from pinmobile.ensembles.scenario import Scenario
from pinmobile.errors import InvalidArgument, NotFinite, NotTraceable
from pinmobile.measures import measures_of
from pinmobile.plant import Context
from pinmobile.simulation import (
    COMPILED,
    PYTHON,
    Engine,
    checked_engine,
    in_python,
    sampled,
    with_compiled_plant,
)

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
        Why not compiled; "" where it is, or the engine was asked for.
    program : Program or None
        Its compiled loop.
    """

    scenario: Scenario
    engine: Engine
    why: str = ""
    program: Program | None = None

    def divided(self, start: int, stop: int) -> list[tuple[int, int]]:
        """Divide the robots so that progress is told and memory stays small."""
        each = _ONE_BY_ONE
        if self.engine is COMPILED:
            work = _SAMPLED if self.scenario.has_own_references else _WORK
            each = 256 * max(1, min(256, round(work / len(self.scenario.t) / 256)))
        return [(first, min(first + each, stop)) for first in range(start, stop, each)]

    def run(self, draws: Mapping[str, Array], start: int, stop: int, threads: int) -> Part:
        """Return the records of the robots from `start` to before `stop`, given what is drawn for these."""
        if self.engine is COMPILED:
            part = _compiled(self, draws, start, stop, threads)
        else:
            part = _in_python(self, draws, start, stop)
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


def way_of(scenario: Scenario, engine: Engine | None = None) -> Way:
    """Return how a scenario is run: as asked for, by default compiled where its parts allow.

    Raises
    ------
    InvalidArgument
        If the engine that is asked for cannot run it, or a parameter is spread that no law uses.
    """
    asked = checked_engine(engine, COMPILED, PYTHON)
    if asked is PYTHON:
        return Way(scenario, PYTHON)
    try:
        return Way(scenario, COMPILED, "", _as_compiled(scenario))
    except NotTraceable as error:
        if asked is not None:
            raise InvalidArgument(f"engine is COMPILED, which cannot run this: {error.reason}") from error
        return Way(scenario, PYTHON, f"not COMPILED: {error.reason}")


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


def _in_python(way: Way, draws: Mapping[str, Array], start: int, stop: int) -> Part:
    records = Records(start, stop)
    for i in range(start, stop):
        try:
            own = {name: column[i - start : i - start + 1] for name, column in draws.items()}
            records.put(i, i + 1, _alone(way.scenario, own, i, compiles=bool(way.why)))
        except InvalidArgument as error:
            if type(error) is InvalidArgument and not str(error).startswith("robot "):
                raise InvalidArgument(f"robot {i}: {error}") from error
            error.add_note(f"robot {i} of the ensemble")
            raise
        except Exception as error:
            error.add_note(f"robot {i} of the ensemble")
            raise
    return records.part()


def _alone(scenario: Scenario, draws: Mapping[str, Array], i: int, *, compiles: bool) -> Part:
    """Return the records of robot i, whose controller, or whose loop, runs in Python."""
    member = member_of(scenario, i, draws)
    reference = sampled(member.trajectory, scenario.t, member.robot)
    context = Context.of(
        member.robot, dt=scenario.dt, t=scenario.t, reference=reference, trajectory=member.trajectory
    )
    context = replace(context, seed=scenario.seed, member=i)
    parts = replace(
        _with_recorder(scenario),
        plant=member.robot,
        controller=member.controller,
        forces=member.options["forces"],
    )
    q, v = (np.array(member.options[name], np.float64) for name in ("q0", "v0"))
    if compiles:
        with contextlib.suppress(NotTraceable):
            parts = with_compiled_plant(parts, context, q, v)
    record = parts.recorder.initial_state(scenario.size, parts.plant.nu)
    counts = np.zeros((len(scenario.grid), len(scenario.channels), BINS), np.int32)
    counts[..., -1] = 1  # of a robot that has diverged
    for channel, one in enumerate(scenario.channels):
        if one.is_margin:
            counts[:, channel] = np.eye(BINS, dtype=np.int32)[0]
    with np.errstate(all="ignore"), contextlib.suppress(NotFinite):
        for k, found in enumerate(in_python(parts, context, q, v)):
            record = found.record.state
            if not record["alive"]:
                break
            if k % scenario.stride == 0:
                sizes = bins_of(np.array(found.record.counted, np.float64))
                counts[k // scenario.stride] = np.eye(BINS, dtype=np.int32)[sizes]
    return Part.of(scenario, {name: np.asarray(x)[None] for name, x in record.items()}, counts)
