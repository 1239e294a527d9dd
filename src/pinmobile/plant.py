"""The plant of a closed loop, and the context that initializes controllers."""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import (
    Array,
    ArrayLike,
    callable_as,
    finite,
    frozen,
    positive,
    sequence,
    shaped,
    text,
    whole,
)
from pinmobile.errors import InvalidArgument, shown

if TYPE_CHECKING:
    from pinmobile.compiled import Line, Noise, Schedule

Difference: TypeAlias = Callable[[Array, Array], Array]


_DEFAULTS = dict.fromkeys(("nq", "nv", "nu"), 0) | dict.fromkeys(
    ("broadcasts", "compiles", "is_vector_space"), False
)


def stated(part: object, name: str) -> Any:
    """Return what a part states of itself by an optional name, see `Plant`; else its default."""
    return getattr(part, name, _DEFAULTS.get(name))


def check_difference(difference: object) -> None:
    """Check a function ``difference(q0, q1)``.

    Raises
    ------
    InvalidArgument
        If it cannot be called, or subtracts q1 from q0.
    """
    if difference is np.subtract or difference is operator.sub:
        raise InvalidArgument(
            f"difference is {shown(difference)}, which returns q0 - q1, expected difference(q0, q1), the "
            "displacement from q0 to q1: write difference=plain_difference"
        )
    callable_as("difference(q0, q1)", difference)


def refuse_path(name: str, trajectory: object) -> None:
    """Check that a trajectory is not a path.

    Raises
    ------
    InvalidArgument
        If it is a path of the body or of an end effector.
    """
    if stated(trajectory, "rows") is not None:
        raise InvalidArgument(
            f"{name} is {shown(trajectory)}, a path of poses of an end effector, expected a trajectory of "
            "the robot's coordinates, such as solve_inverse_kinematics(robot, path)"
        )
    if stated(trajectory, "derivative") is not None:
        raise InvalidArgument(
            f"{name} is {shown(trajectory)}, a path, which has no heading, expected a trajectory: wrap the "
            "path in Tangent or FixedHeading, such as Tangent(path)"
        )


class Plant(Protocol):
    """Simulated system of a closed loop, such as a `MobileRobot`. Shapes are those of one state.

    A plant has these sizes and methods, and either ``forward_dynamics(q, v, u, f)`` or a step of its own.
    Further methods are capabilities; `pinmobile.parts` has a protocol for each that a loop uses:

    - `Stepping`: ``step(t, q, v, u, h, f, memory)`` replaces integrator and ``forward_dynamics``.
    - `Constrained`: ``project(q, v)`` keeps velocities on constraints such as rolling.
    - `Pushable`: ``pose(q)``, ``pose_rate(q, v)`` and ``generalized_force(q, wrench)`` let forces act on
      the body.
    - `Starting`: ``start(reference)`` completes the first sample of a reference.
    - `Remembering`: ``initial_state(context)`` is the memory before the first sample.
    - `Measuring`: ``metrics`` and ``evaluate_metrics(...)`` are metrics, of which ensembles keep the worst.
    - `Signalling`: ``signals(...)`` are further series worth recording.

    A plant describes itself by these attributes, all optional:

    ``coordinates``, ``configuration_names``, ``inputs``
        Tuples of nv `Coordinate` (x, y, psi first), nq names, and nu `Input`, whose limits the loop applies.
        A plant without them has numbers for names.
    ``reference_sizes``
        Number of entries of q for each number of coordinates that a reference may have; default: {nv: nq}.
    ``compiles``
        True if `simulate` compiles the loop by default.
    ``integrator``
        Default integrator of `simulate`; without it, constant_acceleration.
    ``law``
        The dynamics without input validation, as a loop calls them; default: the plant itself.
    ``is_vector_space``, ``broadcasts``
        True if ``integrate(q, dq)`` is q + dq; True if all methods take leading axes.
    ``check_start(q, v)``
        Raises if a start is impossible, such as off the constraints.
    ``size``, ``mounts``
        Length, width and height of the drawn box [m]; arms that reach beyond it, for which the viewer makes
        room.

    The viewer and `pinmobile.balance` use further methods:

    ``drawing(q) -> (k, 4, 4)``, ``visual_model``
        Placements in the inertial frame of the k objects of a `pin.GeometryModel`.
    ``contacts(q, v, a, u, signals) -> Contacts``
        Contacts with the ground at n samples of a run.
    ``ground_wrench(q, v, a) -> (..., 6)``, ``footprint``
        Wrench (fx, fy, fz, mx, my, mz) of the ground on the body, in the body frame [N, N m]; corners (k, 2)
        of the support polygon [m]. They take many states at once.
    ``contact_loads(q, v, a) -> ContactLoads``, ``slip_margins(motion) -> SlipMargins``
        Load of each contact, and its margin before slip in a motion, which has q, v, a and u.
    ``follows(t, reference)``
        Motion along a reference. Its ``at(factor)`` returns `ContactLoads`, `SlipMargins` and `TorqueMargins`
        of the motion with its speed multiplied by a factor.
    ``on_ramp(angle, direction) -> plant``
        The same plant on ground that rises by an angle; the direction up is measured from the inertial x
        axis [rad].
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
    """State and memory after a step of a plant.

    Attributes
    ----------
    q, v : ndarray, shape (nq,), (nv,)
        State at the end of the step.
    memory : any
        Memory of the plant, such as the contacts that stick.
    """

    q: Array
    v: Array
    memory: object = None


class Contacts(NamedTuple):
    """Contacts of a plant with the ground at n samples of a run, for the viewer and plots.

    `pinmobile.balance` uses `ContactLoads` and `SlipMargins`, which exist for any states.

    Attributes
    ----------
    names : tuple of str
        Names of the k contacts.
    places : ndarray, shape (n, k, 2)
        Positions in the inertial frame [m].
    directions : ndarray, shape (n, k)
        Angle of the first of each contact's two directions from the inertial x axis; the second is a quarter
        of a turn to the left [rad].
    forces : ndarray, shape (n, k, 2)
        Forces of the ground on the plant along these directions [N].
    determined : ndarray of bool, shape (k, 2)
        Whether the model determines each force. If not, it determines only sums, and `forces` has a share.
    loads : ndarray, shape (n, k)
        Normal forces [N]; NaN if unknown.
    limits : ndarray, shape (n, k, 2)
        Largest friction in each direction [N]: radius of the friction disc if both are equal, otherwise the
        limit of each direction by itself (rollers); NaN if unknown.
    slips : ndarray, shape (n, k, 2)
        Slip velocity along these directions [m/s].
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
    """Load of each contact with the ground, for any states.

    Supports without wheels are contacts too.

    Attributes
    ----------
    names : tuple of str
        Names of the contacts.
    values : ndarray, shape (..., k)
        Load of each contact, >= 0 [N].
    springs : ndarray, shape (..., k)
        Load of each contact if contacts could also pull: negative for a contact that lifts off [N].
    tips : ndarray of bool, shape (...)
        Whether no loads balance the robot: it begins to tip over.
    """

    names: tuple[str, ...]
    values: Array
    springs: Array
    tips: NDArray[np.bool_]


class SlipMargins(NamedTuple):
    """Friction left before wheels slip, for any states.

    Wheels whose shares of a force are not determined have one margin, that of the sum.

    Attributes
    ----------
    names : tuple of str
        Name of a wheel, or of the wheels of an axle, such as ``"left + right"``, if only the sum of their
        lateral forces is determined.
    values : ndarray, shape (..., k)
        Remaining friction; negative if the motion needs more than the ground can exert [N].
    along : ndarray, shape (..., wheels)
        Force of the ground along each wheel, or along the axis of its roller [N].
    across : ndarray, shape (..., k)
        Lateral force of the ground [N].
    """

    names: tuple[str, ...]
    values: Array
    along: Array
    across: Array


class TorqueMargins(NamedTuple):
    """Torque left before inputs reach the limits of their motors.

    Attributes
    ----------
    names : tuple of str
        Names of the inputs.
    values : ndarray, shape (..., nu)
        Remaining torque at the rate [N m]; negative if the motion needs more, infinite without limits.
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
        Limits; infinite without one.
    rate : str
        Name of its rate, such as ``"yaw_rate"``; default: ``"<name>_rate"``.
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
        Limits; infinite without one.
    """

    name: str
    unit: str
    lower: float = -np.inf
    upper: float = np.inf


class Parameter(NamedTuple):
    """A number that differs from robot to robot, as results name it.

    Attributes
    ----------
    name, unit, meaning : str
        Its name in the spread, its unit, "" for none, and its meaning, as a noun phrase.
    """

    name: str
    unit: str = ""
    meaning: str = ""


@dataclass(frozen=True, eq=False)
class Context:
    """Argument of a controller's initialisation, ``controller.initial_state(context)``.

    It contains no dynamics of the simulated plant: a wrong controller model stays wrong. The loop makes it;
    `Context.of` makes one for calls by hand.

    Attributes
    ----------
    dt : float
        Time between two samples [s].
    t : ndarray, shape (N + 1,)
        Times of the samples [s].
    difference : callable
        ``difference(q0, q1)`` of the plant: displacement from q0 to q1, shape (..., nv).
    integrate : callable
        ``integrate(q, dq)`` of the plant: configuration after a displacement, shape (..., nq).
    coordinates : tuple of Coordinate
        Coordinates of the plant, in the order of v.
    inputs : tuple of Input
        Inputs of the plant, in the order of u.
    reference_sizes : mapping of int to int
        Number of entries of q for each number of coordinates that a reference may have.
    reference : Reference or None
        The reference at all samples, q, v and a of shape (N + 1, ...); None in calls by hand.
    trajectory : trajectory or None
        Trajectory of the reference, for preview; None in calls by hand.
    nv : int
        Size of v of the plant.
    seed, member : int
        Seed of the ensemble and number of the robot in it: `noise` derives its noise from them.
    measurement_delay : int
        Samples by which the measured state is late, see `MeasurementDelay`.
    """

    dt: float
    t: Array
    difference: Difference
    integrate: Callable[[Array, Array], Array]
    coordinates: tuple[Coordinate, ...] = ()
    inputs: tuple[Input, ...] = ()
    reference_sizes: Mapping[int, int] = field(default_factory=dict)
    reference: Any = None
    trajectory: Any = None
    nv: int = 0
    seed: int = 0
    member: int = 0
    measurement_delay: int = 0

    @property
    def size(self) -> int:
        """Number of coordinates of the reference."""
        return int(np.shape(self.reference.v)[-1])

    def delay(self, samples: int) -> Line:
        """Return a delay to keep in the state: ``old, line = line.push(values)``.

        ``push`` returns the tree of arrays that it received `samples` samples before; until then, the first.
        """
        from pinmobile.compiled import Line

        return Line(whole("samples", samples, least=0))

    def noise(self, name: str, n: int) -> Noise:
        """Return noise to keep in the state: ``numbers, noise = noise.draw()``.

        The n numbers of a sample are standard normal and independent. They depend only on the seed, the
        member, the name and the number of the sample, and have the same bits in every engine.
        """
        from pinmobile.compiled import Noise, robot_keys

        text("name", name)
        return Noise(robot_keys(self.seed, name, range(self.member, self.member + 1))[0], whole("n", n))

    def schedule(self, rows: ArrayLike) -> Schedule:
        """Return a row of numbers for each sample, to keep in the state: ``row, schedule = schedule.next()``.

        An example is gains that depend on the reference. All robots of an ensemble have the same rows.

        Parameters
        ----------
        rows : array_like, shape (N + 1, ...)
            One row for each time in `t`.

        Raises
        ------
        InvalidArgument
            If their number differs from that of `t`, or they are not finite.
        """
        from pinmobile.compiled import Schedule

        found = finite("rows", rows)
        shaped("rows", found, (len(self.t), *found.shape[1:]), words=", a row for each sample")
        return Schedule(frozen(found))

    @classmethod
    def of(
        cls, plant: Plant, *, dt: float, t: Array | None = None, reference: Any = None, trajectory: Any = None
    ) -> Context:
        """Return the context of a loop with this plant.

        Parameters
        ----------
        plant : MobileRobot or other plant
            Simulated plant.
        dt : float
            Time between two samples [s].
        t : ndarray, shape (N + 1,), optional
            Times of the samples [s]; default: one sample at 0.
        reference : Reference, optional
            The reference at these times.
        trajectory : trajectory, optional
            Trajectory of the reference.

        Raises
        ------
        InvalidArgument
            If the plant cannot compare and move configurations, `dt` is not above zero, or `t` is no row.
        """
        missing = [name for name in ("difference", "integrate") if not callable(stated(plant, name))]
        if isinstance(plant, type) or missing:
            what = f", which has no {missing[0]}" if missing else ""
            raise InvalidArgument(f"plant is {shown(plant)}{what}, expected a MobileRobot or other plant")
        check_difference(plant.difference)
        times = shaped("t", finite("t", np.zeros(1) if t is None else t), ("n",))
        named = coordinates_of(plant), inputs_of(plant), reference_sizes_of(plant)
        return cls(
            positive("dt", dt, "s"),
            frozen(times),
            plant.difference,
            plant.integrate,
            *named,
            reference,
            trajectory,
            stated(plant, "nv"),
        )


def coordinates_of(plant: object) -> tuple[Coordinate, ...]:
    """Return the coordinates of a plant, in the order of v; without names, numbers."""
    found = stated(plant, "coordinates")
    if found is None:
        return tuple(Coordinate(f"[{k}]", "") for k in range(stated(plant, "nv")))
    return sequence("plant.coordinates", found, "a sequence of Coordinate")


def inputs_of(plant: object) -> tuple[Input, ...]:
    """Return the inputs of a plant, in the order of u; without names, numbers."""
    found = stated(plant, "inputs")
    if found is None:
        return tuple(Input(f"[{k}]", "") for k in range(stated(plant, "nu")))
    return sequence("plant.inputs", found, "a sequence of Input")


def configuration_names_of(plant: object) -> tuple[str, ...]:
    """Return the names of the entries of q: those of the coordinates if their number agrees, else numbers."""
    found = stated(plant, "configuration_names")
    if found is not None:
        return sequence("plant.configuration_names", found, "a sequence of names")
    count, named = stated(plant, "nq"), coordinates_of(plant)
    return tuple(one.name for one in named) if len(named) == count else tuple(f"[{k}]" for k in range(count))


def reference_sizes_of(plant: object) -> Mapping[int, int]:
    """Return the number of entries of q for each number of coordinates that a reference may have."""
    found: Mapping[int, int] = stated(plant, "reference_sizes") or {stated(plant, "nv"): stated(plant, "nq")}
    return found


_SLACK = 1e-6  # of a limit: error of an integrator


def limits_exceeded(plant: object, t: Array, q: Array, v: Array, u: Array | None = None) -> tuple[str, ...]:
    """Return a sentence for each limit of a plant that samples exceed, with the largest excess.

    `coordinates` contain limits of position, ``velocity_limit`` and ``effort_limit`` of the robot the others.

    Parameters
    ----------
    plant : plant
        Plant with limits.
    t, q, v, u : ndarray, shape (N,), (N, nq), (N, nv), (N, nu)
        Samples; without `u`, torques are not checked.
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
    robots = plant, stated(plant, "robot")
    robot: Any = next((each for each in robots if stated(each, "effort_limit") is not None), None)
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
    """Check a plant.

    Raises
    ------
    InvalidArgument
        If it is no plant, or its sizes contradict each other.
    """
    sizes: dict[str, Any] = {size: getattr(plant, size, None) for size in ("nq", "nv", "nu")}
    known = all(isinstance(value, int | np.integer) for value in sizes.values())
    if isinstance(plant, type) or stated(plant, "forward_dynamics") is None or not known:
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


def all_samples(plant: object, name: str, *rows: Array) -> Array:
    """Return the values of a method of the plant for each row of arrays (N, ...), stacked: (N, ...).

    Parameters
    ----------
    plant : plant
        A plant that ``broadcasts`` is called once, others row by row.
    name : str
        Name of the method.
    *rows : ndarray, shape (N, ...)
        Arguments of the method, N > 0.
    """
    method = getattr(plant, name)
    if stated(plant, "broadcasts"):
        return np.asarray(method(*rows))
    return np.stack([method(*(part.copy() for part in row)) for row in zip(*rows, strict=True)])


def whole_configurations(plant: Any, q: Array, reference: Array) -> Array:
    """Return the reference's configurations, shape (..., nq), completed by the last entries of q."""
    length = reference.shape[-1]
    if length == plant.nq:
        return reference
    return np.concatenate([reference, q[..., length:]], axis=-1)


@dataclass(frozen=True)
class PlantOutline:
    """Description of a plant, as files keep it if its class may not be available. It cannot be simulated.

    Attributes
    ----------
    kind : str
        Name of its class.
    coordinates, inputs : tuple of Coordinate, tuple of Input
        Coordinates and inputs of the plant.
    configuration_names : tuple of str
        Names of the nq entries of q.
    reference_sizes : mapping of int to int
        Lengths of references, see `Plant`.
    posed : tuple of 3 int, or None
        Entries of q that are x, y and psi of the body; None if unknown.
    size : tuple of 3 float, or None
        Length, width and height of the drawn box [m]; None: an arrowhead.
    reason : str
        Why a file does not have the robot itself; "" for a plant of a user's class.
    """

    kind: str
    coordinates: tuple[Coordinate, ...]
    configuration_names: tuple[str, ...]
    inputs: tuple[Input, ...]
    reference_sizes: Mapping[int, int]
    posed: tuple[int, ...] | None = None
    size: tuple[float, ...] | None = None
    reason: str = field(default="", compare=False)

    @classmethod
    def of(cls, plant: object, q: Array) -> PlantOutline:
        """Return the outline of a plant; configurations q, shape (N, nq), locate its pose in q."""
        if isinstance(plant, cls):
            return plant
        size = stated(plant, "size")
        return cls(
            kind=type(plant).__name__,
            coordinates=tuple(Coordinate(*one) for one in coordinates_of(plant)),
            configuration_names=configuration_names_of(plant),
            inputs=tuple(Input(*one) for one in inputs_of(plant)),
            reference_sizes=dict(reference_sizes_of(plant)),
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
        """True: its methods take leading axes."""
        return True

    @property
    def pose(self) -> Callable[[Array], Array] | None:
        """Function of q that returns x, y and psi of the body, shape (..., 3); None if unknown."""
        return None if self.posed is None else lambda q: np.asarray(q)[..., list(self.posed or ())]


def _posed(plant: object, q: Array) -> tuple[int, ...] | None:
    """Return the entries of q that equal the pose in all samples; None if there are none."""
    if not callable(stated(plant, "pose")) or not len(q):
        return None
    poses = all_samples(plant, "pose", q)
    found = [np.flatnonzero((q == column[:, None]).all(axis=0)) for column in poses.T]
    return tuple(int(where[0]) for where in found) if all(map(len, found)) else None
