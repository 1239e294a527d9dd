"""What is simulated, and what its loop tells a controller before the first sample."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike, callable_as, finite, frozen, positive, sequence, text, whole
from pinmobile.errors import InvalidArgument, shown

if TYPE_CHECKING:
    from pinmobile.compiled.memory import Line, Noise, Schedule

Difference: TypeAlias = Callable[[Array, Array], Array]


def check_difference(difference: object) -> None:
    """Refuse what cannot be called as ``difference(q0, q1)``, and a subtraction of q1 from q0.

    Raises
    ------
    InvalidArgument
        If it is such.
    """
    if difference is np.subtract or difference is operator.sub:
        raise InvalidArgument(
            f"difference is {shown(difference)}, which returns q0 - q1, expected difference(q0, q1), the "
            "displacement from q0 to q1: write difference=plain_difference"
        )
    callable_as("difference(q0, q1)", difference)


def refuse_path(name: str, trajectory: object) -> None:
    """Refuse a path where a trajectory is expected, and one of poses, which has `rows` to follow.

    Raises
    ------
    InvalidArgument
        If it is one.
    """
    if hasattr(trajectory, "rows"):
        raise InvalidArgument(
            f"{name} is {shown(trajectory)}, a path of poses of an end effector, expected a trajectory of "
            "the robot's coordinates, such as resolve(robot, path)"
        )
    if hasattr(trajectory, "derivative"):
        raise InvalidArgument(
            f"{name} is {shown(trajectory)}, a path, which has no heading, expected a trajectory: wrap the "
            "path in Tangent or FixedHeading, such as Tangent(path)"
        )


class Plant(Protocol):
    """What a closed loop asks of a plant; `MobileRobot` is one. Shapes are those of one state.

    Beside this it may have what follows; a loop asks for it by name, and says what is missing:

    ``coordinates``, ``configuration_names``, ``inputs``
        Tuples of nv `Coordinate` (x, y, psi first), of nq names, and of nu `Input`, whose limits the loop
        applies. Without them everything has numbers for names.
    ``leading``
        Mapping of n to the number of entries of q: the lengths that a reference may have; {nv: nq} without.
    ``pose(q) -> (3,)``, ``rate(q, v) -> (3,)``
        x, y, psi of the body, and their rates: for forces on it, for plots and the viewer.
    ``effort(q, wrench) -> (nv,)``
        The generalised force of a wrench (Fx, Fy, Mz) on the body; without it no force pushes the body.
        ``forward_dynamics(q, v, u, f)`` then takes forces f, shape (nv,), beside the input.
    ``start(reference) -> (q, v)``
        Completes the first sample of a reference of the first n coordinates.
    ``check_start(q, v)``
        Raises where a start is none, such as off the constraints.
    ``project(q, v) -> v``
        The velocity that constraints such as rolling leave, after every substep.
    ``step(t, q, v, u, h, f, memory) -> Step``
        A step of its own in place of an integrator's; ``initial_state(context)`` is its first memory. The
        forces beside the input are a function of time and state, ``f(t, q, v) -> (nv,)``, asked wherever the
        step wants to know them; it returns 0.0 where nothing acts.
    ``compiles``
        True where `simulate` compiles a loop if no engine is given.
    ``integrator``
        That which `simulate` takes where none is given; constant_acceleration without.
    ``signals(t, q, v, u, f, memory) -> {name: (unit, value)}``
        What else is worth recording at a sample, such as contact forces: numbers, or rows of them.
    ``adds``, ``broadcasts``
        True where ``integrate(q, dq)`` is q + dq; where all methods take leading axes.
    ``calls()``
        Unchecked functions of one state, see `pinmobile.robot.Calls`, of a plant whose u is a generalised
        force, to which forces beside it are added.
    ``drawing(q) -> (k, 4, 4)``, ``visual_model``
        Placements in the inertial frame of the k objects of a `pin.GeometryModel`, which the viewer draws.
    ``contacts(q, v, a, u, signals) -> Contacts``
        What the ground does where the plant touches it, at n samples of a run: for the viewer and plots.
    ``ground_wrench(q, v, a) -> (..., 6)``, ``footprint``
        What `pinmobile.balance` asks, of many states at once: the wrench (fx, fy, fz, mx, my, mz) of the
        ground on the body, along and about the body's frame [N, N m]; and the corners (k, 2) of what it
        stands on [m].
    ``contact_loads(q, v, a) -> ContactLoads``, ``slip_margins(motion) -> SlipMargins``
        Also what `balance` asks: what each contact carries, and how far from slipping it is in a motion,
        which has q, v, a and u, and of a run ``signals``.
    ``follows(t, reference)``
        What goes along a reference: its ``at(factor)`` returns `ContactLoads`, `SlipMargins` and
        `TorqueMargins` where it goes so many times as fast.
    ``on_ramp(angle, direction) -> plant``
        The same on ground that rises by an angle, the way up from the inertial x axis [rad].
    ``measures``, ``measured(t, q, v, a, u, reference) -> (m,)``
        What is worth judging about a sample beside errors, a tuple of m `pinmobile.measures.Measure`, and the
        law that gives them, all numbers the plant's own: ensembles keep the worst of each.
    ``mounts``
        What of it reaches beyond its size, such as arms: where there is any, the viewer looks from lower, and
        makes room for it.
    ``size``
        Length, width and height of the box that is drawn [m], or of what ``drawing`` draws; without, an
        arrowhead, or a box of usual size.
    """

    @property
    def nq(self) -> int:
        """Size of q."""

    @property
    def nv(self) -> int:
        """Size of v and a."""

    @property
    def nu(self) -> int:
        """Size of the input u."""

    def forward_dynamics(self, q: Array, v: Array, u: Array, /) -> Array:
        """Return the acceleration, shape (nv,)."""

    def integrate(self, q: Array, dq: Array, /) -> Array:
        """Return the configuration that the displacement dq leads to, shape (nq,)."""

    def difference(self, q0: Array, q1: Array, /) -> Array:
        """Return the displacement from q0 to q1, shape (nv,)."""


class Step(NamedTuple):
    """What a plant's own step leads to.

    Attributes
    ----------
    q, v : ndarray, shape (nq,), (nv,)
        The state at its end.
    memory : any
        What the plant keeps, such as which contacts stick.
    """

    q: Array
    v: Array
    memory: object = None


class Contacts(NamedTuple):
    """What the ground does where a plant touches it, at n samples of a run: for the viewer and plots.

    Loads and margins that `pinmobile.balance` judges, of any states, are `ContactLoads` and `SlipMargins`.

    Attributes
    ----------
    names : tuple of str
        Of the k contacts.
    places : ndarray, shape (n, k, 2)
        Where they are in the inertial frame [m].
    directions : ndarray, shape (n, k)
        Angle of the first of each contact's two directions from the inertial x axis; the second is a quarter
        of a turn to the left [rad].
    forces : ndarray, shape (n, k, 2)
        Of the ground on the plant along these [N].
    determined : ndarray of bool, shape (k, 2)
        Whether the model determines them; of others only sums are, and what is told is a share.
    loads : ndarray, shape (n, k)
        [N]; not a number where they are not known.
    limits : ndarray, shape (n, k, 2)
        Largest friction in each direction [N]: of a disc where both are alike, else of each by itself, as of
        rollers; not a number where it is not known.
    slips : ndarray, shape (n, k, 2)
        Velocity at which the plant slides over the ground, along these directions [m/s].
    slides : ndarray of bool, shape (n, k)
        Whether all friction is used.
    centre : ndarray, shape (n, 2)
        Instantaneous centre of the body's rotation in the inertial frame [m]; infinite where there is none.
    """

    names: tuple[str, ...]
    places: Array
    directions: Array
    forces: Array
    determined: NDArray[np.bool_]
    loads: Array
    limits: Array
    slips: Array
    slides: NDArray[np.bool_]
    centre: Array


class ContactLoads(NamedTuple):
    """What each place where a robot touches the ground carries, of any states: for `pinmobile.balance`.

    Supports without wheels are among them. For the viewer, a run has `Contacts`.

    Attributes
    ----------
    names : tuple of str
        Of the contacts.
    values : ndarray, shape (..., k)
        Load of each, none below zero [N].
    springs : ndarray, shape (..., k)
        The same where contacts could pull too: below zero where one has lifted off [N].
    tips : ndarray of bool, shape (...)
        Where no loads balance the robot, which begins to tip over.
    """

    names: tuple[str, ...]
    values: Array
    springs: Array
    tips: NDArray[np.bool_]


class SlipMargins(NamedTuple):
    """How far wheels are from slipping, of any states: for `pinmobile.balance`.

    Of wheels whose shares of a force are not determined it is the sum. For the viewer, a run has `Contacts`.

    Attributes
    ----------
    names : tuple of str
        Of a wheel, or of the wheels of an axle, such as ``"left + right"``, of which only the sum of the
        forces across them is determined.
    values : ndarray, shape (..., k)
        Friction that is left, below zero where the ground would have to exert more than it can [N].
    along : ndarray, shape (..., wheels)
        Force of the ground along each wheel, or along the axis of its roller [N].
    across : ndarray, shape (..., k)
        That across them [N].
    """

    names: tuple[str, ...]
    values: Array
    along: Array
    across: Array


class TorqueMargins(NamedTuple):
    """How far inputs are from what their motors can do at their rates: for `pinmobile.balance`.

    Attributes
    ----------
    names : tuple of str
        Of the inputs.
    values : ndarray, shape (..., nu)
        Torque that is left, below zero where it would take more [N m]; infinite where there is no limit.
    """

    names: tuple[str, ...]
    values: Array


class Coordinate(NamedTuple):
    """One of the nv numbers of a displacement.

    Attributes
    ----------
    name, unit : str
        Such as ``"psi"`` and ``"rad"``.
    lower, upper : float
        Its limits, infinite where there is none.
    rate : str
        What its rate is called, such as ``"yaw_rate"``; by default ``"<name>_rate"``.
    """

    name: str
    unit: str
    lower: float = -np.inf
    upper: float = np.inf
    rate: str = ""


class Input(NamedTuple):
    """One of the nu numbers of an input.

    Attributes
    ----------
    name, unit : str
        Such as ``"Mz"`` and ``"N m"``.
    lower, upper : float
        Its limits, infinite where there is none.
    """

    name: str
    unit: str
    lower: float = -np.inf
    upper: float = np.inf


@dataclass(frozen=True)
class Parameter:
    """A number of a part that may differ from robot to robot: a part lists its own as ``parameters``.

    A spread, a sweep and a scenario file name it; the part's law reads it from its attribute.

    Attributes
    ----------
    name : str
        What a spread calls it, such as ``"kp_x"``.
    unit, meaning : str
        Its unit, "" for none, and what it is, in words.
    least : float
        Values must be above, or for 0 of a parameter that may vanish, at least this.
    may_vanish : bool
        Whether `least` itself is allowed.
    attribute : str
        The part's attribute that has it; by default, what it is called.
    entry : int or tuple of int, optional
        Which number of that attribute it is; None: all of them.
    write : callable, optional
        ``write(values, column, size)`` returns the attribute of m robots, shape (m, ...), from what it was,
        (m, ...), and the numbers of the parameter, (m,); `size` is the number of coordinates that the
        reference has. By default the numbers take the entry's place.
    neutral : float, optional
        Its number where it is not spread; by default, what the attribute has there.
    """

    name: str
    unit: str = ""
    meaning: str = ""
    least: float = -np.inf
    may_vanish: bool = True
    attribute: str = ""
    entry: int | tuple[int, ...] | None = None
    write: Callable[[Array, Array, int], Array] | None = None
    neutral: float | None = None

    @property
    def bound(self) -> str:
        """What is expected of its values, such as ``> 0``."""
        return f"{'>=' if self.may_vanish else '>'} {self.least:g}"

    def allows(self, values: Array) -> Any:
        """Tell which values are possible, shape (n,)."""
        return values >= self.least if self.may_vanish else values > self.least

    def written(self, values: Array, column: Array, size: int) -> Array:
        """Return the attribute of m robots with this parameter's numbers in it, shape (m, ...)."""
        if self.write is not None:
            return self.write(values, column, size)
        new = np.array(values, np.float64)
        if self.entry is None:
            new[:] = column.reshape(-1, *(1,) * (values.ndim - 1))
        else:
            new[:, *np.atleast_1d(self.entry)] = column
        return new

    def nominal(self, value: ArrayLike) -> float | None:
        """Return its number in an attribute of one robot; None where all its numbers are not alike."""
        if self.neutral is not None:
            return self.neutral
        array = np.asarray(value, np.float64)
        if isinstance(self.entry, tuple):
            return float(array[self.entry])
        array = array.diagonal() if array.ndim == 2 else array
        numbers = array if self.entry is None or not array.ndim else array[self.entry]
        return float(numbers.flat[0]) if (numbers == numbers.flat[0]).all() else None


@dataclass(frozen=True, eq=False)
class Context:
    """What a controller is told before the first sample: ``controller.initial_state(context)``.

    It holds no dynamics of what is simulated: a controller whose model is wrong stays wrong. A loop makes it;
    `Context.of` makes one for calls by hand.

    Attributes
    ----------
    dt : float
        Time between two samples [s].
    t : ndarray, shape (N + 1,)
        Times of the samples [s].
    difference : callable
        ``difference(q0, q1)``: the displacement from q0 to q1 of the plant, shape (..., nv).
    integrate : callable
        ``integrate(q, dq)``: the plant's configuration to which a displacement leads, shape (..., nq).
    coordinates : tuple of Coordinate
        The plant's, in the order of v.
    inputs : tuple of Input
        The plant's, in the order of u.
    leading : mapping of int to int
        How many numbers of q the first n coordinates have, for each n that a reference may have.
    reference : Reference or None
        The reference at all samples, q, v and a of shape (N + 1, ...); None in calls by hand.
    trajectory : trajectory or None
        What it is sampled from, for those who look ahead; None in calls by hand.
    nv : int
        Size of v of the plant.
    seed, member : int
        What `normal` follows from: the seed of an ensemble, and the robot's number in it.
    delay : int
        Samples by which what the controller is told of the state is late, see `Delayed`.
    """

    dt: float
    t: Array
    difference: Difference
    integrate: Callable[[Array, Array], Array]
    coordinates: tuple[Coordinate, ...] = ()
    inputs: tuple[Input, ...] = ()
    leading: Mapping[int, int] = field(default_factory=dict)
    reference: Any = None
    trajectory: Any = None
    nv: int = 0
    seed: int = 0
    member: int = 0
    delay: int = 0

    @property
    def size(self) -> int:
        """Number of coordinates of the reference."""
        return int(np.shape(self.reference.v)[-1])

    def line(self, samples: int) -> Line:
        """Return a delay to keep in the state: ``old, line = line.push(values)``.

        What is pushed, a tree of arrays, comes back `samples` samples later; until then, the first does.
        """
        from pinmobile.compiled.memory import Line

        return Line(whole("samples", samples, least=0))

    def normal(self, name: str, n: int) -> Noise:
        """Return noise to keep in the state: ``numbers, noise = noise.draw()``.

        The n numbers of a sample are standard normal and independent; they follow from the seed, the member,
        the name and the number of the sample alone, and are the same bits in every engine.
        """
        from pinmobile.compiled.memory import Noise, robot_keys

        text("name", name)
        return Noise(robot_keys(self.seed, name, range(self.member, self.member + 1))[0], whole("n", n))

    def schedule(self, rows: ArrayLike) -> Schedule:
        """Return numbers known for each sample, to keep in the state: ``row, schedule = schedule.next()``.

        Such as gains that follow from the reference. All robots of an ensemble have the same.

        Parameters
        ----------
        rows : array_like, shape (N + 1, ...)
            One for each time in `t`.

        Raises
        ------
        InvalidArgument
            If they are not as many, or not finite.
        """
        from pinmobile.compiled.memory import Schedule

        found = finite("rows", rows)
        if found.shape[:1] != self.t.shape:
            raise InvalidArgument(
                f"rows has shape {found.shape}, expected ({len(self.t)}, ...), one for each sample"
            )
        return Schedule(frozen(found))

    @classmethod
    def of(
        cls, plant: Plant, *, dt: float, t: Array | None = None, reference: Any = None, trajectory: Any = None
    ) -> Context:
        """Return the context of a loop with this plant.

        Parameters
        ----------
        plant : MobileRobot or other plant
            What is simulated, or whose state is measured.
        dt : float
            Time between two samples [s].
        t : ndarray, shape (N + 1,), optional
            Times of the samples [s]; by default one, at 0.
        reference : Reference, optional
            The reference at these times.
        trajectory : trajectory, optional
            What it is sampled from.

        Raises
        ------
        InvalidArgument
            If the plant cannot compare and move configurations, `dt` is not above zero, or `t` is no row.
        """
        missing = [name for name in ("difference", "integrate") if not callable(getattr(plant, name, None))]
        if isinstance(plant, type) or missing:
            what = f", which has no {missing[0]}" if missing else ""
            raise InvalidArgument(f"plant is {shown(plant)}{what}, expected a MobileRobot or other plant")
        check_difference(plant.difference)
        times = finite("t", np.zeros(1) if t is None else t)
        if times.ndim != 1:
            raise InvalidArgument(f"t has shape {times.shape}, expected (N + 1,)")
        named = coordinates_of(plant), inputs_of(plant), leading_of(plant)
        return cls(
            positive("dt", dt, "s"),
            frozen(times),
            plant.difference,
            plant.integrate,
            *named,
            reference,
            trajectory,
            getattr(plant, "nv", 0),
        )


def coordinates_of(plant: object) -> tuple[Coordinate, ...]:
    """Return the coordinates of a plant, in the order of v; numbers where it does not name them."""
    if hasattr(plant, "coordinates"):
        return sequence("plant.coordinates", plant.coordinates, "a sequence of Coordinate")
    return tuple(Coordinate(f"[{k}]", "") for k in range(getattr(plant, "nv", 0)))


def inputs_of(plant: object) -> tuple[Input, ...]:
    """Return the inputs of a plant, in the order of u; numbers where it does not name them."""
    if hasattr(plant, "inputs"):
        return sequence("plant.inputs", plant.inputs, "a sequence of Input")
    return tuple(Input(f"[{k}]", "") for k in range(getattr(plant, "nu", 0)))


def configuration_names_of(plant: object) -> tuple[str, ...]:
    """Return the name of each number in q: those of the coordinates where it has as many, else numbers."""
    if hasattr(plant, "configuration_names"):
        return sequence("plant.configuration_names", plant.configuration_names, "a sequence of names")
    count, named = getattr(plant, "nq", 0), coordinates_of(plant)
    return tuple(one.name for one in named) if len(named) == count else tuple(f"[{k}]" for k in range(count))


def leading_of(plant: object) -> Mapping[int, int]:
    """Return how many numbers of q the first n coordinates have, for each n that a reference may have."""
    found: Mapping[int, int] = getattr(plant, "leading", None) or {
        getattr(plant, "nv", 0): getattr(plant, "nq", 0)
    }
    return found


_SLACK = 1e-6  # of a limit: what an integrator leaves


def limits_exceeded(plant: object, t: Array, q: Array, v: Array, u: Array | None = None) -> tuple[str, ...]:
    """Return a sentence for each limit of a plant that samples exceed: which, where most, and how far.

    Limits of position are those of `coordinates`, those of speed and torque those of the robot's joints,
    ``velocity_limit`` and ``effort_limit``.

    Parameters
    ----------
    plant : plant
        Whose limits they are.
    t, q, v, u : ndarray, shape (N,), (N, nq), (N, nv), (N, nu)
        The samples; without `u`, torques are left out.
    """
    named, found, names = coordinates_of(plant), [], list(configuration_names_of(plant))

    def check(values: Array, lower: float, upper: float, what: str, unit: str) -> None:
        beyond = np.maximum(lower - values, values - upper)
        k = int(beyond.argmax())
        limit = lower if values[k] < lower else upper
        if beyond[k] > _SLACK * abs(limit):
            first = t[np.argmax(beyond > _SLACK * abs(limit))]
            found.append(
                f"{what} {values[k]:.4g} {unit} at t = {t[k]:g} s, beyond its limit of {limit:.4g} {unit} "
                f"since t = {first:g} s"
            )

    for one in named:
        if np.isfinite([one.lower, one.upper]).any() and one.name in names:
            check(q[:, names.index(one.name)], one.lower, one.upper, f"{one.name} reaches", one.unit)
    robots: tuple[Any, ...] = (plant, getattr(plant, "robot", None))
    robot = next((each for each in robots if hasattr(each, "effort_limit")), None)
    if robot is None:
        return tuple(found)
    columns = [one.name for one in inputs_of(plant)] if u is not None else []
    for one, own, speed, effort in zip(
        coordinates_of(robot), inputs_of(robot), robot.velocity_limit, robot.effort_limit, strict=True
    ):
        at = [each.name for each in named].index(one.name)
        check(v[:, at], -speed, speed, f"{one.name} moves at", f"{one.unit}/s")
        if u is not None and own.name in columns:
            check(u[:, columns.index(own.name)], -effort, effort, f"input of {own.name} reaches", own.unit)
    return tuple(found)


def check_plant(plant: object) -> None:
    """Refuse what is no plant, or one whose sizes contradict each other.

    Raises
    ------
    InvalidArgument
        If it is such.
    """
    sizes: dict[str, Any] = {size: getattr(plant, size, None) for size in ("nq", "nv", "nu")}
    nq, nv, _ = sizes.values()
    known = all(isinstance(value, int | np.integer) for value in sizes.values())
    if isinstance(plant, type) or not hasattr(plant, "forward_dynamics") or not known:
        raise InvalidArgument(
            f"plant is {shown(plant)}, expected something with 'forward_dynamics' and the sizes nq, nv, nu"
        )
    for name, size, listed in (
        ("coordinates", "nv", coordinates_of(plant)),
        ("configuration_names", "nq", configuration_names_of(plant)),
        ("inputs", "nu", inputs_of(plant)),
    ):
        if len(listed) != sizes[size]:
            raise InvalidArgument(
                f"plant has {size} = {sizes[size]} and {len(listed)} {name}, expected as many"
            )
    if not isinstance(leading_of(plant), Mapping) or not leading_of(plant):
        raise InvalidArgument(
            f"plant.leading is {shown(leading_of(plant))}, expected a mapping of n to numbers of q, such as "
            f"{{{nv}: {nq}}}"
        )
    for n, numbers in leading_of(plant).items():
        if n > nv or numbers > nq:
            raise InvalidArgument(
                f"plant.leading has {n}: {numbers}, expected at most nv = {nv} and nq = {nq}"
            )


def all_samples(plant: object, name: str, *rows: Array) -> Array:
    """Return what a method of the plant gives for each row of arrays (N, ...), stacked: (N, ...).

    Parameters
    ----------
    plant : plant
        One that ``broadcasts`` is asked once, others row by row.
    name : str
        Of the method.
    *rows : ndarray, shape (N, ...)
        Its arguments, N > 0.
    """
    method = getattr(plant, name)
    if getattr(plant, "broadcasts", False):
        return np.asarray(method(*rows))
    return np.stack([method(*(part.copy() for part in row)) for row in zip(*rows, strict=True)])


def whole_configurations(plant: Any, q: Array, reference: Array) -> Array:
    """Return the reference's configurations, shape (..., nq); what has no reference is where q is."""
    length = reference.shape[-1]
    if length == plant.nq:
        return reference
    return np.concatenate([reference, q[..., length:]], axis=-1)


@dataclass(frozen=True)
class PlantOutline:
    """A plant in words: what a file keeps of one whose class may not be at hand. It cannot be simulated.

    Attributes
    ----------
    kind : str
        What its class was called.
    coordinates, inputs : tuple of Coordinate, tuple of Input
        As the plant had them.
    configuration_names : tuple of str
        Of the nq numbers in q.
    leading : mapping of int to int
        As the plant had it.
    posed : tuple of 3 int, or None
        Which numbers of q are x, y and psi of the body; None where that is not known.
    size : tuple of 3 float, or None
        Length, width and height of what is drawn [m]; None: an arrowhead.
    """

    kind: str
    coordinates: tuple[Coordinate, ...]
    configuration_names: tuple[str, ...]
    inputs: tuple[Input, ...]
    leading: Mapping[int, int]
    posed: tuple[int, ...] | None = None
    size: tuple[float, ...] | None = None

    @classmethod
    def of(cls, plant: object, q: Array) -> PlantOutline:
        """Return the outline of a plant; configurations q, shape (N, nq), tell where its pose is in q."""
        if isinstance(plant, cls):
            return plant
        size = getattr(plant, "size", None)
        return cls(
            kind=type(plant).__name__,
            coordinates=tuple(Coordinate(*one) for one in coordinates_of(plant)),
            configuration_names=configuration_names_of(plant),
            inputs=tuple(Input(*one) for one in inputs_of(plant)),
            leading=dict(leading_of(plant)),
            posed=_posed(plant, q),
            size=None if size is None or np.shape(size) != (3,) else tuple(float(x) for x in size),
        )

    @property
    def nq(self) -> int:
        """Size of q."""
        return len(self.configuration_names)

    @property
    def nv(self) -> int:
        """Size of v and a."""
        return len(self.coordinates)

    @property
    def nu(self) -> int:
        """Size of the input u."""
        return len(self.inputs)

    @property
    def broadcasts(self) -> bool:
        """Whether its methods take leading axes, here True."""
        return True

    @property
    def pose(self) -> Callable[[Array], Array] | None:
        """What returns x, y and psi of the body, shape (..., 3) [m, m, rad], of q; None where not known."""
        return None if self.posed is None else lambda q: np.asarray(q)[..., list(self.posed or ())]


def _posed(plant: object, q: Array) -> tuple[int, ...] | None:
    """Return the numbers of q that are the pose, told by numbers that are all different."""
    if not callable(getattr(plant, "pose", None)) or not len(q):
        return None
    poses = all_samples(plant, "pose", q)
    found = [np.flatnonzero((q == column[:, None]).all(axis=0)) for column in poses.T]
    return tuple(int(where[0]) for where in found) if all(map(len, found)) else None
