"""`Scenario`: a closed loop, the number of its runs, and the numbers that differ from run to run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from typing import Any, final
from zlib import crc32

import numpy as np

from pinmobile.arrays import (
    Array,
    affordable,
    bounded,
    check_integer,
    finite,
    instance,
    positive,
    scalar,
    sequence,
    text,
)
from pinmobile.compiled import BINS, Noise, is_traced
from pinmobile.errors import InvalidArgument, UnknownName, argument_errors
from pinmobile.integrators import Integrator
from pinmobile.loop._checks import check_answers, check_run, sample_reference
from pinmobile.loop._loop import Loop, Sample
from pinmobile.loop._spread import (
    Relative,
    Source,
    check_draws,
    check_spread,
    check_supports,
    draw,
    draw_blocks,
    expand_patterns,
    slice_spread,
)
from pinmobile.loop._trace import initial_memory, initial_states, initial_velocities
from pinmobile.metrics import Metric, channels_of, select_metrics
from pinmobile.parts import (
    Constrained,
    NumberRef,
    Starting,
    Whole,
    able,
    find,
    named,
    numbers,
    parts_of,
    replace as replaced,
    spread_entries,
    spread_values,
    walk,
)
from pinmobile.plant import Context, Coordinate, Input, Parameter, all_samples
from pinmobile.trajectories import Reference, Trajectory

_TIME_ERROR = 1e-6  # tolerance of sample times, as a share of dt
_GRID = 60  # approximate number of intervals between counts


class RecordGrid:
    """Grid, times and channels of an ensemble, from a scenario or from its description."""

    t: Array
    dt: float
    after: float
    every: Any
    coordinates: Any
    recorded_metrics: Any

    @property
    def stride(self) -> int:
        """Samples between two entries of the bands."""
        return self.every or max(1, round((len(self.t) - 1) / _GRID))

    @property
    def begin(self) -> int:
        """Index of the first sample at or after the time `after`; the ensemble records errors from there."""
        return int(np.searchsorted(self.t, self.after - _TIME_ERROR * self.dt))

    @property
    def grid(self) -> Array:
        """Times of the bands, shape (G,) [s]."""
        return self.t[:: self.stride]

    @property
    def channels(self) -> tuple[Metric, ...]:
        """Metrics with bands over time: distance, heading, errors of more coordinates, recorded metrics."""
        return channels_of(self.coordinates, self.recorded_metrics)


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Scenario(RecordGrid):
    """Closed loop with n robots, each with its own parameters, start and disturbance.

    Parameters
    ----------
    robot : MobileRobot or other plant
        Nominal plant. The spread may name its numbers, and those of its loads, links, motors and arms.
    controller : controller
        Controller, see `simulate`.
    trajectory : trajectory
        Trajectory of all robots. If the spread names a number of the trajectory or its path, each robot has
        its own reference. All references have the same sample times.
    n : int
        Number of robots.
    spread : mapping of str to Distribution, number or array of shape (n,)
        Distributions of numbers, by path: ``"plant.mass"``, ``"forces.0.force.x"``, ``"controller.kp"``,
        ``"trajectory.path.radius"``, ``"start.x"``. The end of a path is enough: ``"mass"`` is the plant's
        number if it has one, otherwise the one nearest to the loop. A pattern, such as ``"*.friction.mu"``,
        means all that fit, each with its own draw. All other numbers are nominal. The
        controller model keeps its own numbers unless the spread names them, such as ``"controller.mass"``;
        `pinmobile.loop.TRUE_MODEL` gives it those of each robot.
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
        External forces, see `simulate`. A `forces.NoiseForce` or a `MeasurementNoise` has its own draws for
        each robot, which depend on this seed and its own.
    limit : float
        Largest error of a loop that has not diverged [m, rad, m/s, rad/s].

    after : float
        Time from which the ensemble records errors [s], so that the start of a run does not dominate them.
        Inputs, divergence and bands include the start.
    every : int, optional
        Samples between two entries of the bands over time; default: some 60 entries.
    metrics : sequence of str and Metric, or mapping of str to callable, optional
        Metrics to record beside errors: names of the robot's metrics, and `metrics.Metric` with a function of
        a `loop.Sample`. A mapping of names to functions adds metrics without unit, whose largest size is the
        worst, to all metrics of the robot. Default: all metrics of the robot. Compiled robots with arms take
        1.4 times as long with all metrics as with none, ``()``. The metric "tip over" counts robots that tip
        over.
    keep : sequence of str
        Names of signals that are kept for all robots at the times of the bands, see `Ensemble.kept`.

    Attributes
    ----------
    t : ndarray, shape (N + 1,)
        Times of the samples [s].
    reference : Reference
        Reference of the nominal robot at these times.

    Raises
    ------
    InvalidArgument, UnknownName
        If an argument is invalid, or draws are impossible; the message gives their share.

    See Also
    --------
    ensemble : run the robots of a scenario.
    sweep : run a scenario at the points of a grid.
    Uniform : distribution of a number.

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Scenario
    >>> from pinmobile import Tangent, Uniform
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> runs = Scenario(robot=robot, controller=PD(120, 120),
    ...                 trajectory=Tangent(Circle(1.0, 0.5, 4.0)),
    ...                 spread={"mass": Uniform(20, 40)},
    ...                 n=100, dt=0.02)
    >>> runs.draws(0, 3)["mass"]  # [kg]
    array([26.7, 20.7, 37.8])
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
    forces: Any = ()
    limit: float = 1e3
    after: float = 0.0
    every: int | None = None
    metrics: Sequence[str | Metric] | Mapping[str, Callable[[Sample], Any]] | None = None
    keep: Sequence[str] = ()
    t: Array = field(init=False, repr=False)
    reference: Reference = field(init=False, repr=False)

    def __post_init__(self) -> None:
        dt = positive("dt", self.dt, "s")
        duration = None if self.duration is None else positive("duration", self.duration, "s")
        options: Any = {name: getattr(self, name) for name in ("forces", "integrator", "substeps")}
        parts = self.robot, self.controller, self.trajectory
        loop, t = check_run(*parts, **options, dt=dt, duration=duration)
        n = check_integer("n", self.n)
        instance("spread", self.spread, Mapping, "a mapping of parameters to distributions")
        self._set(n=n, dt=dt, duration=duration, t=t, given=loop)
        self._set(**{name: getattr(loop, name) for name in options})
        self._set(
            seed=check_integer("seed", self.seed, least=0),
            limit=positive("limit", self.limit),
            after=bounded("after", scalar("after", self.after), least=0, most=float(t[-1]), unit="s"),
            every=None if self.every is None else check_integer("every", self.every),
            reference=sample_reference(self.trajectory, t, self.robot),
        )
        bands = f"the bands of {len(self.grid):,} times, every {self.stride} samples,"
        affordable(bands, (1 + len(self.channels)) * BINS * len(self.grid), "give a larger `every`")
        per_robot = 3 + 2 * self.size + len(self.inputs) + 2 * len(self.recorded_metrics) + len(self.spread)
        affordable(f"the records of {n:,} robots", per_robot * n, "give a smaller n")
        keep = [text("keep", name) for name in sequence("keep", self.keep, "names of signals")]
        self._set(keep=tuple(dict.fromkeys(keep)))
        size = 3 * len(keep) * n * len(self.grid)  # most signals have up to three entries
        affordable(f"the signals of {n:,} robots at {len(self.grid)} times", size, "give a larger `every`")
        try:
            spread = expand_patterns(self.spread, self.nominal_loop, self._named_numbers)
            self._set(spread=check_spread(spread, n, self.find))
        except UnknownName as error:
            self._check_shared(str(error.name))
            raise
        check_supports(self.spread, self.numbers)
        check_answers(self.nominal_loop, self.context, *self.start)

    def find(self, name: str, where: str = "spread") -> NumberRef:
        """Return the number of the loop that a name of the spread means.

        A name is a path or the end of a path. Of several paths with this end, the plant's own comes first,
        then the one nearest to the loop.

        Parameters
        ----------
        name : str
            Name of the number.
        where : str
            Name of the argument, for the message.

        Raises
        ------
        UnknownName
            If no path has this end.
        InvalidArgument
            If several paths are equally near.
        """
        return find(self.nominal_loop, name, self._named_numbers, where)

    @cached_property
    def _named_numbers(self) -> dict[str, NumberRef]:
        return named(self.nominal_loop)

    def _check_shared(self, name: str) -> None:
        """Reject a spread of a whole number, such as the samples of a delay: all robots share it."""
        for leaf in walk(self.nominal_loop):
            if isinstance(leaf.declared, Whole) and f".{leaf.path}".endswith(f".{name}"):
                raise InvalidArgument(
                    f"spread has {name!r}, a whole number of a {type(leaf.owner).__name__}, which all "
                    "robots of an ensemble share: run one ensemble for each value, or a sweep over them"
                )

    def _set(self, **values: object) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def __getstate__(self) -> dict[str, object]:
        # Derived attributes are computed again.
        return {item.name: getattr(self, item.name) for item in fields(self)}

    @property
    def size(self) -> int:
        """Number of coordinates of the reference."""
        return int(self.reference.v.shape[-1])

    @cached_property
    def context(self) -> Context:
        """Context of the controller's initialisation."""
        context = Context.of(
            self.robot, dt=self.dt, t=self.t, reference=self.reference, trajectory=self.trajectory
        )
        return replace(context, seed=self.seed)

    @cached_property
    def nominal_loop(self) -> Loop:
        """Nominal loop, before the spread changes the shapes of its numbers."""
        parts = self.robot, self.controller, self.trajectory, self.forces, self.integrator
        return Loop(*parts, self.substeps)

    @cached_property
    def _coordinates(self) -> tuple[Coordinate, ...]:
        return self.context.coordinates

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Coordinates of the reference."""
        return self._coordinates[: self.size]

    @property
    def inputs(self) -> tuple[Input, ...]:
        """The plant's inputs."""
        return self.context.inputs

    @cached_property
    def recorded_metrics(self) -> tuple[Metric, ...]:
        """Metrics that the ensemble records beside errors."""
        errors = "distance", "heading", *(one.name for one in self._coordinates)
        return select_metrics(self.robot, self.metrics, errors)

    @cached_property
    def numbers(self) -> dict[str, NumberRef]:
        """Numbers of the loop that the spread names, by its names."""
        return {name: self.find(name) for name in self.spread}

    @cached_property
    def loop(self) -> Loop:
        """Nominal loop; numbers of the spread have the shape that they have for each robot."""
        nominal: dict[str, Any] = {}
        for path, value in self._spread_values(self._ones, 1).items():
            given, shape = self._named_numbers[path].leaf.value, value.shape[1:]
            if given is None or np.shape(given) != shape:
                nominal[path] = np.broadcast_to(1.0 if given is None else given, shape)
        return replaced(self.nominal_loop, nominal) if nominal else self.nominal_loop

    @property
    def _ones(self) -> dict[str, Array]:
        """Draws of one robot that are all 1."""
        return {name: np.ones(1) for name in self.spread}

    def _spread_values(self, draws: Mapping[str, Array], count: int) -> dict[str, Array]:
        """Return the numbers of the spread of each robot, shape (count, ...), by path."""
        columns = [(number, draws[name], self._is_factor(name)) for name, number in self.numbers.items()]
        return spread_values(columns, count, self.size)

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Name, unit and meaning of the draws of the spread, by name."""
        words = {name: (number.unit, number.meaning) for name, number in self.numbers.items()}
        words |= {name: ("", f"factor of {words[name][1]}") for name in words if self._is_factor(name)}
        return {name: Parameter(name, *pair) for name, pair in words.items()}

    def _is_factor(self, name: str) -> bool:
        """Return whether the draws of a number are factors of a nominal array."""
        number = self.numbers[name]
        return isinstance(self.spread[name], Relative) and number.entry is None and number.is_array

    @cached_property
    def is_noisy(self) -> bool:
        """Whether the controller uses noise of its context."""
        names = []

        def noise(name: str, n: int) -> Noise:
            names.append(name)
            return Noise(0, n)

        initial_memory(self.loop, self.context, noise=noise)
        return bool(names)

    @property
    def has_own_references(self) -> bool:
        """Whether the spread names a number of the trajectory: each robot then has its own reference."""
        return any(number.path.startswith("trajectory.") for number in self.numbers.values())

    def references(self, values: Mapping[str, Array], count: int, first: int = 0) -> Reference | None:
        """Return each robot's own reference, q, v and a of shape (N + 1, count, ...), or None.

        Parameters
        ----------
        values : mapping of str to ndarray, shape (count, ...)
            Numbers of the robots by path, see `values`.
        count, first : int
            Number of robots, and index of the first, for messages.

        Raises
        ------
        InvalidArgument
            If the trajectory of a robot is impossible, too short, or does not fit the plant.
        """
        if not self.has_own_references:
            return None
        paths = {x.removeprefix("trajectory."): y for x, y in values.items() if x.startswith("trajectory.")}
        cache: dict[bytes, Reference] = {}
        references = Reference(*(np.empty((len(self.t), count, part.shape[1])) for part in self.reference))
        for i in range(count):
            numbers = {path: value[i] for path, value in paths.items()}
            key = b"".join(np.asarray(value).tobytes() for value in numbers.values())
            if key not in cache:
                with argument_errors(f"robot {first + i}: "):
                    cache[key] = self._own_reference(replaced(self.trajectory, numbers))
            for rows, part in zip(references, cache[key], strict=True):
                rows[:, i] = part
        return references

    def _own_reference(self, trajectory: Trajectory) -> Reference:
        """Return the reference of a robot's own trajectory, which must have the same shape for all robots."""
        longest = float(trajectory.duration)
        if longest < self.t[-1] * (1 - _TIME_ERROR):
            expected = f"{self.t[-1]:.9g} s as the ensemble"
            raise InvalidArgument(f"its trajectory lasts {longest:.9g} s, expected at least {expected}")
        reference = sample_reference(trajectory, np.minimum(self.t, longest), self.robot)
        if reference.v.shape != self.reference.v.shape:
            message = f"its trajectory has {reference.v.shape[1]} coordinates"
            raise InvalidArgument(f"{message}, expected {self.size} as all others")
        return reference

    @cached_property
    def _random_parts(self) -> dict[str, Any]:
        """Parts that draw numbers for each robot without a spread, by the paths of these numbers."""
        parts = parts_of(self.nominal_loop)
        return {f"{path}.{name}": part for path, part in parts for name in getattr(part, "drawn", ())}

    @cached_property
    def _last_draws(self) -> dict[str, dict[int, Array]]:
        """Draws of these parts for the last block of robots, kept for the next robots of the block."""
        return {}

    def values(self, draws: Mapping[str, Array], start: int, stop: int) -> dict[str, Array]:
        """Return the numbers of the robots from `start` to before `stop`, shape (stop - start, ...), by path.

        Parameters
        ----------
        draws : mapping of str to ndarray, shape (stop - start,)
            Draws of these robots, see `draws`.
        start, stop : int
            Range of robots.

        Raises
        ------
        InvalidArgument
            If a robot with the least or the largest value of a number is impossible.
        """
        arrays = self._spread_values(draws, stop - start)
        self._check_extremes(arrays, start)
        for path, part in self._random_parts.items():
            owner, _, name = path.rpartition(".")
            stream = f"{_stream_name(owner)} of {crc32(part.stream)}"
            last = self._last_draws.setdefault(path, {})
            arrays[path] = draw_blocks(stream, partial(_draw, part, name), self.seed, start, stop, last)
        return arrays

    def _check_extremes(self, values: Mapping[str, Array], first: int) -> None:
        """Raise the error of an impossible robot: machine code checks no number.

        A check takes a millisecond. These are the robots with the least and the largest value of each number.
        """
        varied = {x: y for x, y in values.items() if x.partition(".")[0] in ("plant", "controller", "forces")}
        columns = [np.reshape(x, (len(x), -1)) for x in varied.values()]
        ends = [(column.argmin(axis=0), column.argmax(axis=0)) for column in columns]
        for i in np.unique(np.concatenate([np.zeros((2, 0), int), *ends], axis=1)).tolist():
            with argument_errors(f"robot {first + i}: "):
                replaced(self.loop, {path: x[i] for path, x in varied.items()})

    @cached_property
    def entries(self) -> dict[str, Any]:
        """Masks of the entries that differ from robot to robot in the numbers of the loop, by path."""
        masks = spread_entries(list(self.numbers.values()), self._spread_values(self._ones, 1))
        traced = {path: x for path, x in masks.items() if is_traced(path)}
        leaves = numbers(self.nominal_loop)
        draws = {path: leaves[path].value for path in self._random_parts if path in leaves}
        return traced | {path: np.ones(np.shape(value), bool) for path, value in draws.items()}

    def starts(
        self, values: Mapping[str, Array], count: int, references: Reference | None = None
    ) -> tuple[Array, Array]:
        """Return the initial states of robots, shape (count, nq) and (count, nv).

        Parameters
        ----------
        values : mapping of str to ndarray, shape (count, ...)
            Numbers of the robots by path, see `values`.
        count : int
            Number of robots.
        references : Reference, optional
            References of the robots, see `references`.
        """
        plant, zeros = self.robot, np.zeros((count, self.robot.nv))
        dqs, rates = values.get("start", zeros), values.get("start_rate", zeros)
        plant_values = {path: value for path, value in values.items() if path.startswith("plant.")}
        if self._start_paths & plant_values.keys():  # such as radii of wheels
            first = (np.broadcast_to(x[0], (count, *x.shape[-1:])) for x in references or self.reference)
            q, v = initial_states(self.loop, plant_values, Reference(*first))
            q, v = np.asarray(all_samples(plant, "integrate", q, dqs)), v + rates
        elif references is None:
            start = self.start
            rows = np.broadcast_to(start[0], (count, plant.nq))
            q, v = all_samples(plant, "integrate", rows, dqs), start[1] + rates
        else:
            states = [self._start(Reference(*(part[0, i] for part in references))) for i in range(count)]
            q = np.array([plant.integrate(q, dq) for (q, _), dq in zip(states, dqs, strict=True)], np.float64)
            v = np.array([v for _, v in states]) + rates
        if able(plant, Constrained) and (plant_values or values.keys() & {"start", "start_rate"}):
            return q, initial_velocities(self.loop, plant_values, q, v)  # such as rolling
        return q, v

    @cached_property
    def _start_paths(self) -> set[str]:
        """Paths of the plant's numbers in the spread that change its start at the reference."""
        first = Reference(*(part[0] for part in self.reference))
        is_starting, start = able(self.robot, Starting) is not None, self.start
        paths = {number.leaf.path for number in self.numbers.values()} if is_starting else set()

        def is_changed(path: str) -> bool:
            value = np.asarray(self.find(path).leaf.value, np.float64)
            try:
                varied = replaced(self.loop, {path: value * 1.001 + 1e-6}).plant.start(first)
            except InvalidArgument:  # beyond the bounds of the number
                return True
            return not all(map(np.array_equal, varied, start))

        return {path for path in paths if path.startswith("plant.") and is_changed(path)}

    @property
    def start(self) -> tuple[Array, Array]:
        """Initial state of the nominal robot, shape (nq,) and (nv,)."""
        q, v = self._start(Reference(*(part[0] for part in self.reference)))
        return np.array(q, np.float64), np.array(v, np.float64)

    def _start(self, row: Reference) -> tuple[Array, Array]:
        """Return the state of the plant at a sample of a reference, (nq,) and (nv,)."""
        starter = able(self.robot, Starting)
        if starter is None:
            return row.q, row.v
        q, v = (finite(f"{name} of plant.start", x) for name, x in zip("qv", starter.start(row), strict=True))
        return q, v

    def subset(self, start: int, stop: int) -> Scenario:
        """Return the scenario for a process that runs the robots from `start` to before `stop`.

        Arrays of the spread contain only these robots. Everything else, draws included, is the same.

        Parameters
        ----------
        start, stop : int
            Range of robots.

        Returns
        -------
        Scenario
            Scenario with the same n.
        """
        part = copy(self)
        object.__setattr__(part, "spread", slice_spread(self.spread, start, stop))
        return part

    def draws(self, start: int = 0, stop: int | None = None) -> dict[str, Array]:
        """Return the draws of the robots from `start` to before `stop`, shape (stop - start,), by name.

        Parameters
        ----------
        start, stop : int
            Range of robots, 0 <= start < stop; default: all n.

        Raises
        ------
        InvalidArgument
            If values are impossible; the message gives their share.
        """
        first = check_integer("start", start, least=0, most=self.n - 1)
        last = self.n if stop is None else check_integer("stop", stop, least=first + 1, most=self.n)
        values = draw(self.spread, self.seed, first, last, self.find)
        check_draws(values, self.numbers)
        self._check_joint_draws(values, last - first)
        return values

    def _check_joint_draws(self, draws: Mapping[str, Array], count: int) -> None:
        """Reject draws that are possible one by one but not together: a part's `impossible` decides.

        Raises
        ------
        InvalidArgument
            If there are some; the message gives their share.
        """
        owners = {number.leaf.path.rpartition(".")[0]: number.leaf.owner for number in self.numbers.values()}
        checkers = {path: owner for path, owner in owners.items() if hasattr(owner, "impossible")}
        values = self._spread_values(draws, count) if checkers else {}
        for path, owner in checkers.items():
            part = {p.rpartition(".")[2]: x for p, x in values.items() if p.rpartition(".")[0] == path}
            wrong, expected = owner.impossible(part)
            if wrong.any():
                share = f"{np.count_nonzero(wrong)} of {count} draws ({wrong.mean():.2%})"
                message = f"spread gives {path} in {share} an inertia that no body has"
                raise InvalidArgument(f"{message}, {expected}")


def check_scenario(scenario: object) -> Scenario:
    """Return a scenario.

    Raises
    ------
    InvalidArgument
        If the argument is not a `Scenario`.
    """
    typed: Scenario = instance("scenario", scenario, Scenario, "a Scenario")
    return typed


def _draw(part: Any, name: str, generator: np.random.Generator, count: int) -> Array:
    return np.asarray(part.draw(generator, count)[name])


def _stream_name(path: str) -> str:
    """Return the name of a force in streams of random numbers, from its path."""
    first, _, rest = path.partition(".")
    return f"{first}[{rest}]" if rest.isdigit() else path
