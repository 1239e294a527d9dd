"""`Scenario`, the noun: one loop, how often it is run, and what differs from run to run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from typing import Any, final
from zlib import crc32

import numpy as np

from pinmobile.arrays import Array, ArrayLike, affordable, finite, positive, scalar, whole
from pinmobile.compiled import (
    BINS,
    Noise,
    Parts,
    Place,
    check_made_again,
    children,
    initial_memory,
    memory_of,
    once,
)
from pinmobile.ensembles.distributions import (
    Source,
    check_mapping,
    check_supports,
    checked_spread,
    draw,
    held,
    in_blocks,
)
from pinmobile.ensembles.parameters import (
    Stated,
    check_possible,
    check_together,
    nominal_of,
    resolved,
    start_parameters,
    stated_by,
    written,
)
from pinmobile.errors import InvalidArgument, UnknownName
from pinmobile.forces import CoordinateForce, Force
from pinmobile.integrators import Integrator
from pinmobile.measures import Measure, channels_of, check_measured, chosen
from pinmobile.plant import Context, Coordinate, Input, Parameter
from pinmobile.simulation import (
    Plant,
    check_answers,
    check_controllers_memory,
    checked_forces,
    checked_loop,
    checked_substeps,
    chosen_integrator,
    sample_times,
    sampled,
    started,
)
from pinmobile.trajectories import Reference, Trajectory

_SAME = 1e-6  # of dt: a time that is meant to be a sample's
_GRID = 60  # intervals between counts, about
_MOST = 100_000_000  # robots
_RECORD = 150  # bytes for each, about


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Scenario:
    """A closed loop that is run `n` times, each time with a robot, a start or a disturbance of its own.

    Parameters
    ----------
    robot : MobileRobot or other plant
        The nominal one. Loads that are attached to a robot without arms are part of its body; with arms,
        they, each link and motor, and where arms stand may be spread, see `MobileRobot.parameters`.
    controller : controller
        As in `simulate`.
    trajectory : trajectory
        The same for all, unless a parameter of it or of its path is spread: then it is made again for each
        robot, whose errors are those to its own reference. All are sampled at the same times.
    n : int
        Number of robots.
    spread : mapping of str to Distribution, number or array of shape (n,)
        What differs, by the names of the parameters that the parts state; of the library's own, see
        `PARAMETERS`, such as ``"force.x"`` of a `ConstantForce`. Where two parts have one of a name, the part
        is named too: ``"forces[1].force.x"``. What is not named is nominal; the controller believes in its
        own robot unless ``model_mass`` and the like are named (`TRUE_MODEL`: it knows the truth).
    seed : int
        All draws follow from it; robot i's do not depend on n.
    dt, duration, integrator, substeps, forces, limit
        As in `simulate`. A `NoiseForce` has phases of its own for each robot, a `NoisyMeasurement` numbers
        of its own; they follow from the seed here together with theirs.
    after : float
        Errors are kept from this time on [s], so that what a start costs until the robot has settled is not
        taken for what the controller costs; forces, divergence and the bands over time are kept from the
        start.
    every : int, optional
        Samples between two entries of the bands over time; by default there are some 60.
    measures : sequence of str, optional
        Names of what the robot states as ``measures`` that is judged beside errors; by default all. Robots
        with arms, compiled, then take some 1.4 times as long as with none, ``()``.

    Raises
    ------
    InvalidArgument, UnknownName
        If an argument is not what is expected, or draws are impossible (with their share).
    """

    robot: Any
    controller: Any
    trajectory: Trajectory
    n: int
    spread: Mapping[str, Source]
    dt: float
    seed: int = 0
    duration: float | None = None
    integrator: Integrator | None = None
    substeps: int = 1
    forces: Sequence[Any] = ()
    limit: float = 1e3
    after: float = 0.0
    every: int | None = None
    measures: Sequence[str] | None = None
    t: Array = field(init=False, repr=False)
    reference: Reference = field(init=False, repr=False)

    def __post_init__(self) -> None:
        checked_loop(self.robot, self.controller, self.trajectory, self.integrator)
        self._set(integrator=chosen_integrator(self.robot, self.integrator))
        n = whole("n", self.n)
        if n > _MOST:
            raise InvalidArgument(
                f"n is {n:,}, expected at most {_MOST:,}, whose records take {_MOST * _RECORD / 1e9:.0f} GB"
            )
        dt = positive("dt", self.dt, "s")
        check_mapping(self.spread)
        self._set(forces=checked_forces(self.forces, self.robot))
        duration = None if self.duration is None else positive("duration", self.duration, "s")
        t = sample_times(dt, duration, self.trajectory.duration)
        every = max(1, round((len(t) - 1) / _GRID)) if self.every is None else whole("every", self.every)
        self._set(
            n=n,
            dt=dt,
            duration=duration,
            seed=whole("seed", self.seed, least=0),
            substeps=checked_substeps(self.substeps, len(t)),
            limit=positive("limit", self.limit),
            after=time_within("after", self.after, t),
            every=every,
            t=t,
        )
        self._set(reference=sampled(self.trajectory, t, self.robot, self._memory))
        affordable(
            f"the bands of {len(self.grid):,} times, every {every} samples,",
            (1 + len(self.channels)) * BINS * len(self.grid),
            "give a larger `every`",
        )
        own = 3 + 2 * self.size + len(self.inputs) + 2 * len(self.judged) + len(self.spread)
        affordable(f"the records of {n:,} robots", own * n, "give a smaller n")
        try:
            self._set(spread=checked_spread(self.spread, n, self.known))
        except UnknownName as error:
            self._refuse_shared(str(error.name))
            raise
        check_supports(self.spread, self.parameters)
        once(self._memory, ("made again", *sorted(self.spread)), self._check_made_again)
        once(self._memory, ("answers", *self._told), self._check_answers)

    def _refuse_shared(self, name: str) -> None:
        """Refuse a spread of what a part has and all robots share, such as the samples of a delay."""
        parts = list(self._given.by_path())
        for path, part in parts:  # and those within them
            own = name.removeprefix(f"{path}.")
            if own.isidentifier() and isinstance(getattr(part, own, None), int | np.integer):
                raise InvalidArgument(
                    f"spread has {name!r}, a whole number of {path}, a {type(part).__name__}, which all "
                    "robots of an ensemble share: run one ensemble for each value, or a sweep over them"
                )
            parts += [(f"{path}.{child}", each) for child, each in children(part)]

    def _check_made_again(self) -> bool:
        """Refuse parts with a spread parameter that keep what may follow from it and cannot be made again."""
        for path, name in (one.place for one in self.stated.values() if one.path):
            check_made_again(path, self._given.at(path), [name])
        return True

    def _check_answers(self) -> bool:
        """Refuse parts whose answers have other shapes than they should, or are others when asked again."""
        h = self.dt / self.substeps
        if self.judged:
            check_measured(self.robot, *self._beginning(self.robot), self.reference)
        check_answers(self.robot, self.forces, self.integrator, *self._beginning(self.robot), h)
        q, v = self.start
        check_controllers_memory(self.controller, self.context, q, v)
        for k, force in enumerate(self.forces):
            shape = np.shape(_asked(force, self._on_arrays.plant, q, v))
            if len(shape) != 1:
                raise InvalidArgument(
                    f"forces[{k}] gives shape {shape} for one robot, expected (3,): "
                    "name in spread what differs"
                )
        return True

    def _set(self, **values: object) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def _told(self) -> tuple[object, ...]:
        """What its laws may ask for beside the parts: substeps, times and the seed."""
        return self.substeps, self.dt, len(self.t), float(self.t[-1]), self.seed, self.judged

    def _memory_now(self) -> dict[Any, Any]:
        """Return where what follows from its parts is remembered as long as they stay; see `memory_of`."""
        return memory_of(self._given, self.trajectory)

    @cached_property
    def _memory(self) -> dict[Any, Any]:
        return self._memory_now()

    def __getstate__(self) -> dict[str, object]:
        # What is made of the fields is made again.
        return {each.name: getattr(self, each.name) for each in fields(self)}

    @property
    def stride(self) -> int:
        """Samples between two entries of the bands."""
        return self.every or 1

    @property
    def begin(self) -> int:
        """First sample whose error is kept."""
        return first_counted(self.t, self.after, self.dt)

    @property
    def size(self) -> int:
        """Number of coordinates that the reference has."""
        return int(self.reference.v.shape[-1])

    @cached_property
    def context(self) -> Context:
        """What the controller is told before the first sample."""
        context = Context.of(
            self.robot, dt=self.dt, t=self.t, reference=self.reference, trajectory=self.trajectory
        )
        return replace(context, seed=self.seed)

    @cached_property
    def _given(self) -> Parts:
        own = self.robot, self.controller, tuple(self.forces), self.integrator
        return Parts(*own, None, self.substeps, self.trajectory)

    @cached_property
    def _on_arrays(self) -> Parts:
        return self._given.on_arrays()

    @cached_property
    def known(self) -> dict[str, list[Stated]]:
        """What its parts and its start state, by name, and by path and name; what a spread may name."""
        return once(self._memory, "known", lambda: stated_by(self._on_arrays, self._coordinates))  # type: ignore[no-any-return]

    @cached_property
    def _coordinates(self) -> tuple[Coordinate, ...]:
        return self.context.coordinates

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The coordinates that the reference has."""
        return self._coordinates[: self.size]

    @property
    def inputs(self) -> tuple[Input, ...]:
        """The plant's inputs."""
        return self.context.inputs

    @cached_property
    def judged(self) -> tuple[Measure, ...]:
        """What of the robot is judged beside errors."""
        errors = "distance", "heading", *(one.name for one in self._coordinates)
        return chosen(self.robot, self.measures, errors)

    @property
    def channels(self) -> tuple[Measure, ...]:
        """What is counted over time: distance, heading, errors of further coordinates, and measures."""
        return channels_of(self.coordinates, self.judged)

    @cached_property
    def stated(self) -> dict[str, Stated]:
        """What is spread, by name, and the part that has it."""
        return {name: resolved(name, self.known) for name in self.spread}

    @cached_property
    def _in_order(self) -> dict[str, Stated]:
        """Return `stated` in the order in which parts state it."""
        return {name: self.stated[name] for name in sorted(self.stated, key=list(self.known).index)}

    @cached_property
    def parts(self) -> Parts:
        """The parts of its loop; what is spread has the shape that it takes for each robot."""
        grown = once(self._memory, ("grown", tuple(self.spread)), self._grown)
        given = self._given.with_parameters(grown, remade=True) if grown else self._given
        stated = [one for one in self.stated.values() if one.path]
        return given.varying((one.place, one.parameter.entry) for one in stated)

    def _grown(self) -> dict[Place, Array]:
        """Return the attributes that take another shape when they are spread."""
        values = self._on_arrays.parameters()
        draws = {name: np.array([self.nominal.get(name, 1.0)]) for name in self.spread}
        wanted = written(self._in_order, draws, values, 1, self.size)
        return {place: one[0] for place, one in wanted.items() if one.shape[1:] != values[place].shape}

    @property
    def parameters(self) -> dict[str, Parameter]:
        """What is spread, by name."""
        return {name: stated.parameter for name, stated in self.stated.items()}

    @cached_property
    def is_noisy(self) -> bool:
        """Whether its controller asks its context for noise."""
        asked = []

        def normal(name: str, n: int) -> Noise:
            asked.append(name)
            return Noise(0, n)

        initial_memory(self.parts.on_arrays(), self.context, self.size, normal=normal)
        return bool(asked)

    @property
    def has_own_references(self) -> bool:
        """Whether a parameter of the trajectory is spread, so that each robot has a reference of its own."""
        return any(one.is_of_trajectory for one in self.stated.values())

    def references(self, draws: Mapping[str, Array], count: int, first: int = 0) -> Reference | None:
        """Return each robot's own reference, q, v and a of shape (N + 1, count, ...), or None.

        Parameters
        ----------
        draws : mapping of str to ndarray, shape (count,)
            What was drawn for them.
        count, first : int
            How many robots, and the number of the first, for messages.

        Raises
        ------
        InvalidArgument
            If a robot's trajectory cannot be made, is too short, or does not fit the plant.
        """
        if not self.has_own_references:
            return None
        alone = Parts(None, None, trajectory=self.parts.trajectory)
        own = written(self._in_order, draws, alone.parameters(), count, self.size)
        known: dict[bytes, Reference] = {}
        found = Reference(*(np.empty((len(self.t), count, part.shape[1])) for part in self.reference))
        for i in range(count):
            values = {place: value[i] for place, value in own.items()}
            key = b"".join(value.tobytes() for value in values.values())
            try:
                if key not in known:
                    made = alone.with_parameters(values, remade=True).trajectory
                    known[key] = self._sampled(made)
            except InvalidArgument as error:
                raise InvalidArgument(f"robot {first + i}: {error}") from error
            for rows, part in zip(found, known[key], strict=True):
                rows[:, i] = part
        return found

    def _sampled(self, trajectory: Trajectory) -> Reference:
        """Return the reference that a robot's own trajectory gives, which must have the shape of all."""
        longest = float(trajectory.duration)
        if longest < self.t[-1] * (1 - _SAME):
            raise InvalidArgument(
                f"its trajectory lasts {longest:.9g} s, expected at least {self.t[-1]:.9g} s, as the ensemble"
            )
        reference = sampled(trajectory, np.minimum(self.t, longest), self.robot)
        if reference.v.shape != self.reference.v.shape:
            raise InvalidArgument(
                f"its trajectory has {reference.v.shape[1]} coordinates, expected {self.size}, as of all"
            )
        return reference

    @property
    def places(self) -> tuple[Place, ...]:
        """What each robot's loop has of its own: attributes that are spread, and those that it draws."""
        spread = [one.place for one in self.stated.values() if one.path and not one.is_of_trajectory]
        return tuple(dict.fromkeys([*spread, *self._drawn]))

    @cached_property
    def _drawn(self) -> dict[Place, Any]:
        """The attributes that each robot draws, and the parts that draw them."""
        parts = self._given.by_path()
        return {Place(path, name): part for path, part in parts for name in getattr(part, "drawn", ())}

    def values(self, draws: Mapping[str, Array], start: int, stop: int) -> dict[Place, Array]:
        """Return what the robots from `start` to before `stop` have of their own, shape (stop - start, ...).

        Parameters
        ----------
        draws : mapping of str to ndarray, shape (stop - start,)
            What `draws` gives for them.
        start, stop : int
            Which robots.

        Returns
        -------
        values : dict of Place to ndarray
            Those of the trajectory too, which is no part of the loop.
        """
        nominal = self.parts.on_arrays().parameters()
        found = written(self._in_order, draws, nominal, stop - start, self.size)
        for place, part in self._drawn.items():
            stream = f"{place.path} of {crc32(part.stream)}"
            own = partial(_drawn_by, part, place.name)
            found[place] = in_blocks(stream, own, self.seed, start, stop)
        return found

    def starts(
        self, draws: Mapping[str, Array], count: int, references: Reference | None = None
    ) -> tuple[Array, Array]:
        """Return where robots start, shape (count, nq) and (count, nv).

        Parameters
        ----------
        draws : mapping of str to ndarray, shape (count,)
            What was drawn for them.
        count : int
            How many.
        references : Reference, optional
            Their own, as `references` returns them.
        """
        plant = self.parts.on_arrays().plant
        names = once(self._memory, "starts", lambda: [x.name for x in start_parameters(self._coordinates)])
        off = np.zeros((2, count, plant.nv))
        for k, name in enumerate(names):
            if name in draws:
                off[k // plant.nv, :, k % plant.nv] = draws[name]
        if references is None:
            q, v = self.start
            return self._rolled(draws, _moved(plant, q, off[0]), v + off[1], off)
        firsts = (Reference(*(part[0, i] for part in references)) for i in range(count))
        begun = [self._beginning(plant, at) for at in firsts]
        moved = [plant.integrate(q, dq) for (q, _), dq in zip(begun, off[0], strict=True)]
        return self._rolled(draws, np.array(moved, np.float64), np.array([v for _, v in begun]) + off[1], off)

    def _rolled(self, draws: Mapping[str, Array], q: Array, v: Array, off: Array) -> tuple[Array, Array]:
        """Return starts with the velocities that each robot's constraints, such as rolling, leave."""
        parts = self.parts.on_arrays()
        if not hasattr(parts.plant, "project"):
            return q, v
        values = written(self._in_order, draws, parts.parameters(), len(q), self.size)
        own = {place: value for place, value in values.items() if place.path.partition(".")[0] == "plant"}
        if not (own or off.any()):
            return q, v
        if getattr(parts.plant, "broadcasts", False):
            return q, np.asarray(parts.with_parameters(own).plant.project(q, v), np.float64)
        found = []
        for k, row in enumerate(zip(q, v, strict=True)):
            mine = {place: value[k] for place, value in own.items()}
            found.append(parts.with_parameters(mine, remade=True).plant.project(*row))
        return q, np.array(found, np.float64)

    @property
    def start(self) -> tuple[Array, Array]:
        """Where the nominal robot starts, shape (nq,) and (nv,)."""
        q, v = once(self._memory, "start", lambda: self._beginning(self.parts.on_arrays().plant))
        return np.array(q, np.float64), np.array(v, np.float64)

    def _beginning(self, plant: Plant, at: Reference | None = None) -> tuple[Array, Array]:
        """Return where a plant is at the first sample of a reference, by default of all, (nq,) and (nv,)."""
        at = Reference(*(part[0] for part in self.reference)) if at is None else at
        if not hasattr(plant, "start"):
            return at.q, at.v
        q, v = (finite(f"{name} of plant.start", x) for name, x in zip("qv", started(plant, at), strict=True))
        return q, v

    @property
    def grid(self) -> Array:
        """Times of the bands, shape (G,) [s]."""
        return self.t[:: self.stride]

    @cached_property
    def nominal(self) -> dict[str, float]:
        """The values of the parameters, as far as each is one number."""
        return once(self._memory, "nominal", lambda: nominal_of(self.known, self._on_arrays.parameters()))  # type: ignore[no-any-return]

    def holding(self, start: int, stop: int) -> Scenario:
        """Return what another process needs of this to run the robots from `start` to before `stop`.

        Explicit arrays of a spread are cut to those robots; all else, and what it draws, is the same.
        """
        part = copy(self)
        object.__setattr__(part, "spread", held(self.spread, start, stop))
        return part

    def draws(self, start: int = 0, stop: int | None = None) -> dict[str, Array]:
        """Return what was drawn for the robots from `start` to before `stop`, shape (stop - start,), by name.

        Parameters
        ----------
        start, stop : int
            Which robots, 0 <= start < stop; by default all n.

        Raises
        ------
        InvalidArgument
            If values are impossible; the message tells their share.
        """
        first, last = whole("start", start, least=0), self.n if stop is None else whole("stop", stop)
        if not first < last <= self.n:
            raise InvalidArgument(f"start is {first} and stop {last}, expected 0 <= start < stop <= {self.n}")
        values = draw(self.spread, self.seed, first, last, self.nominal)
        check_possible(values, self.stated)
        check_together(values, self._in_order, self.parts.on_arrays(), last - first, self.size)
        return values


def checked_scenario(scenario: object) -> Scenario:
    """Check that this is a scenario, and return it.

    Raises
    ------
    InvalidArgument
        If it is something else.
    """
    if not isinstance(scenario, Scenario):
        raise InvalidArgument(f"scenario is a {type(scenario).__name__}, expected a Scenario")
    return scenario


def first_counted(t: Array, after: float, dt: float) -> int:
    """Return the first of the samples at times `t` whose error is kept, those `after` a time."""
    return int(np.searchsorted(t, after - _SAME * dt))


def time_within(name: str, value: ArrayLike, t: Array) -> float:
    """Return a time of a run that has samples at times `t`.

    Raises
    ------
    InvalidArgument
        If it is not.
    """
    time = scalar(name, value)
    if not 0 <= time <= t[-1]:
        raise InvalidArgument(f"{name} is {time} s, expected from 0 to the duration, {t[-1]:g} s")
    return time


def _drawn_by(part: Any, name: str, generator: np.random.Generator, count: int) -> Array:
    return np.asarray(part.draw(generator, count)[name])


def _asked(force: Force | CoordinateForce, plant: Any, q: Array, v: Array) -> ArrayLike:
    if hasattr(force, "on_coordinates"):
        return force.on_coordinates(0.0, q.copy(), v.copy())
    return force(0.0, plant.pose(q).copy(), plant.rate(q, v).copy())


def _moved(plant: Plant, q: Array, displacements: Array) -> Array:
    """Return where displacements, shape (m, nv), lead to, shape (m, nq): at once where the plant can."""
    ends = [plant.integrate(q, displacements[k]) for k in (0, -1)]
    try:
        found = np.asarray(plant.integrate(q, displacements), np.float64)
        if found.shape == (len(displacements), plant.nq) and np.array_equal(found[[0, -1]], ends):
            return found
    except (TypeError, ValueError, IndexError):
        pass  # it is for one state
    return np.array([plant.integrate(q, each) for each in displacements], np.float64)
