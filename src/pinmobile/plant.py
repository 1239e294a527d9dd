"""The plant of a closed loop, and the context that initialises controllers."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import (
    Array,
    ArrayLike,
    callable_as,
    check_integer,
    finite,
    frozen,
    positive,
    sequence,
    shaped,
    text,
)
from pinmobile.errors import InvalidArgument, format_value, unexpected_value
from pinmobile.parts import TimeVarying, able

if TYPE_CHECKING:
    from pinmobile.compiled import DelayLine, Noise, Schedule

#: Function ``difference(q0, q1)``: displacement from q0 to q1, shape (..., nv).
Difference: TypeAlias = Callable[[Array, Array], Array]


_DEFAULTS = dict.fromkeys(("nq", "nv", "nu"), 0) | dict.fromkeys(
    ("broadcasts", "compiles", "is_vector_space"), False
)


def stated(part: object, name: str) -> Any:
    """Return an optional attribute of a part or plant, see `plant.Plant`; without it, the default.

    Parameters
    ----------
    part : object
        Part or plant.
    name : str
        Name of the attribute.

    Returns
    -------
    value : any
        The attribute; default: 0 for sizes, False for flags, otherwise None.

    See Also
    --------
    plant.Plant : protocol with these attributes

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> from pinmobile.plant import stated
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> stated(robot, "nv"), stated(robot, "footprint_of_nothing")
    (3, None)
    """
    return getattr(part, name, _DEFAULTS.get(name))


def robot_at(plant: Any, t: Any) -> Any:
    """Return the robot that a plant is at a time or at the times of samples; any other plant unchanged.

    Parameters
    ----------
    plant : plant
        Plant.
    t : float or ndarray, shape (n,)
        Time, or times of n samples [s].

    Returns
    -------
    robot : plant
        Robot at the time. For several times, its methods accept n samples.

    See Also
    --------
    PayloadTransfer : plant that is one of two robots

    Examples
    --------
    >>> from pinmobile import MobileRobot, PayloadBody, PayloadTransfer
    >>> from pinmobile.plant import robot_at
    >>> robot = MobileRobot.box(mass=30.0)
    >>> plant = PayloadTransfer(robot, PayloadBody(5.0), begin=2.0)
    >>> robots = [robot_at(plant, t) for t in (1.0, 3.0)]
    >>> [robot.with_locked_arms().mass for robot in robots]  # [kg]
    [30.0, 35.0]
    """
    provider = able(plant, TimeVarying)
    return plant if provider is None else provider.robot_at(t)


def check_difference(difference: object) -> None:
    """Check a function ``difference(q0, q1)``.

    Parameters
    ----------
    difference : callable
        The function.

    Raises
    ------
    InvalidArgument
        If it is not callable with two arguments, or subtracts q1 from q0.

    See Also
    --------
    controllers.plain_difference : subtraction q1 - q0
    controllers.planar_difference : subtraction with the heading on the circle

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.controllers import planar_difference
    >>> from pinmobile.plant import check_difference
    >>> check_difference(planar_difference)
    >>> check_difference(np.subtract)
    Traceback (most recent call last):
        ...
    pinmobile.errors.InvalidArgument: difference is ... q0 - q1, ...
    """
    if difference is np.subtract or difference is operator.sub:
        raise InvalidArgument(
            f"difference is {format_value(difference)}, which returns q0 - q1, expected difference(q0, q1), "
            "the displacement from q0 to q1: write difference=plain_difference"
        )
    callable_as("difference(q0, q1)", difference)


def check_coordinates(v: Array, expected: int, hint: str) -> None:
    """Check that a reference with velocities v, shape (..., n), has the expected number of coordinates.

    Raises
    ------
    InvalidArgument
        If it has another number.
    """
    if v.shape[-1] != expected:
        raise InvalidArgument(f"reference has {v.shape[-1]} coordinates, expected {expected}{hint}")


def refuse_path(name: str, trajectory: object) -> None:
    """Check that a trajectory is not a path.

    Parameters
    ----------
    name : str
        Name of the argument, for the error message.
    trajectory : object
        The argument.

    Raises
    ------
    InvalidArgument
        If it is a path of the body or of an end effector.

    See Also
    --------
    Tangent : trajectory along a path
    solve_inverse_kinematics : trajectory from a path of poses

    Examples
    --------
    >>> from pinmobile import Circle, Tangent
    >>> from pinmobile.plant import refuse_path
    >>> circle = Circle(radius=3.0, rate=0.1, duration=10.0)
    >>> refuse_path("trajectory", Tangent(circle))
    >>> refuse_path("trajectory", circle)
    Traceback (most recent call last):
        ...
    pinmobile.errors.InvalidArgument: ... such as Tangent(path)
    """
    if stated(trajectory, "rows") is not None:
        raise InvalidArgument(
            f"{name} is {format_value(trajectory)}, a path of poses of an end effector, expected a "
            "trajectory of the robot's coordinates, such as solve_inverse_kinematics(robot, path)"
        )
    if stated(trajectory, "derivative") is not None:
        raise InvalidArgument(
            f"{name} is {format_value(trajectory)}, a path, which has no heading, expected a trajectory: "
            "wrap the path in Tangent or FixedHeading, such as Tangent(path)"
        )


class Plant(Protocol):
    """Simulated system of a closed loop, such as a `MobileRobot`. Shapes are those of one state.

    A plant has these sizes and methods, and either ``forward_dynamics(q, v, u, f)`` or a step of its own.
    Further methods are capabilities; `parts` has a protocol for each that a loop uses:

    - `parts.Stepping`: ``step(t, q, v, u, h, f, memory)`` replaces integrator and ``forward_dynamics``.
    - `parts.Constrained`: ``project(q, v)`` keeps velocities on constraints such as rolling.
    - `parts.Pushable`: ``pose(q)``, ``pose_rate(q, v)`` and ``generalized_force(q, wrench)`` let forces act
      on the body.
    - `parts.Starting`: ``start(reference)`` completes the first sample of a reference.
    - `parts.Remembering`: ``initial_state(context)`` is the memory before the first sample.
    - `parts.Measuring`: ``metrics`` and ``evaluate_metrics(...)`` are metrics; ensembles keep the worst.
    - `parts.Signalling`: ``signals(...)`` are further series worth recording.

    A plant describes itself by these attributes, all optional:

    ``coordinates``, ``configuration_names``, ``inputs``
        Tuples of nv `plant.Coordinate` (x, y, psi first), nq names, and nu `plant.Input`, whose limits the
        loop applies. A plant without them has numbers for names.
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

    The viewer and `balance` use further methods:

    ``drawing(q) -> (k, 4, 4)``, ``visual_model``
        Placements in the inertial frame of the k objects of a ``pin.GeometryModel``.
    ``contacts(q, v, a, u, signals) -> Contacts``
        Contacts with the ground at n samples of a run.
    ``ground_wrench(q, v, a) -> (..., 6)``, ``footprint``
        Wrench (fx, fy, fz, mx, my, mz) of the ground on the body, in the body frame [N, N m]; corners (k, 2)
        of the support polygon [m]. They take many states at once.
    ``contact_loads(q, v, a) -> ContactLoads``, ``slip_margins(motion) -> SlipMargins``
        Load of each contact, and its margin before slip in a motion, which has q, v, a and u.
    ``follows(t, reference)``
        Motion along a reference. Its ``at(factor)`` returns `plant.ContactLoads`, `plant.SlipMargins` and
        `plant.TorqueMargins` of the motion with its speed multiplied by a factor.
    ``on_ramp(angle, direction) -> plant``
        The same plant on ground that rises by an angle; the direction up is measured from the inertial x
        axis [rad].

    See Also
    --------
    MobileRobot : plant driven by forces
    WheeledRobot : plant on wheels
    VelocityRobot : plant driven by speed and yaw rate
    simulate : simulation of a plant

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import PD, Circle, Tangent, simulate
    >>> class PointMass:
    ...     nq = nv = nu = 3
    ...     def forward_dynamics(self, q, v, u, f=0.0):
    ...         return (u + f) / 30.0
    ...     def integrate(self, q, dq):
    ...         return q + dq
    ...     def difference(self, q0, q1):
    ...         return np.subtract(q1, q0)
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=2.0))
    >>> run = simulate(PointMass(), PD(120.0, 120.0), path, dt=0.02)
    >>> print(f"{1e3 * max(run.max_error()):.1f} mm")
    6.8 mm
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
        """Return the acceleration, shape (nv,).

        Parameters
        ----------
        q, v : ndarray, shape (nq,), (nv,)
            State.
        u : ndarray, shape (nu,)
            Applied input.
        """

    def integrate(self, q: Array, dq: Array, /) -> Array:
        """Return the configuration after a displacement, shape (nq,).

        Parameters
        ----------
        q : ndarray, shape (nq,)
            Configuration.
        dq : ndarray, shape (nv,)
            Displacement.
        """

    def difference(self, q0: Array, q1: Array, /) -> Array:
        """Return the displacement from q0 to q1, shape (nv,).

        Parameters
        ----------
        q0, q1 : ndarray, shape (nq,)
            Configurations.
        """


class Step(NamedTuple):
    """State and memory after a step of a plant.

    Attributes
    ----------
    q, v : ndarray, shape (nq,), (nv,)
        State at the end of the step.
    memory : any
        Memory of the plant, such as the contacts that stick.

    See Also
    --------
    plant.Plant : protocol with a method `step` of its own

    Examples
    --------
    >>> from pinmobile import Coulomb, MobileRobot, WheeledRobot
    >>> from pinmobile import WheelTable
    >>> table = WheelTable.differential(
    ...     0.4, 0.1, supports=[(-0.3, 0)], spin_inertia=0.01)
    >>> body = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> robot = WheeledRobot(body, table, Coulomb())
    >>> q, memory = robot.rest, robot.initial_state()
    >>> step = robot.step(0.0, q, 0 * q, [3, 3], 0.01, 0.0, memory)
    >>> print(f"{step.v[0] / 0.01:.2f} m/s^2")
    1.78 m/s^2
    """

    q: Array
    v: Array
    memory: object = None


class Contacts(NamedTuple):
    """Contacts of a plant with the ground at n samples of a run, for the viewer and plots.

    `balance` uses `plant.ContactLoads` and `plant.SlipMargins`, which exist for any states.

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

    See Also
    --------
    WheeledRobot : its method `contacts`
    plant.ContactLoads : loads for any states

    Examples
    --------
    >>> from pinmobile import Backstepping, Circle, MobileRobot
    >>> from pinmobile import Tangent, UnicycleTracking, WheeledRobot
    >>> from pinmobile import WheelTable, simulate
    >>> table = WheelTable.differential(0.4, 0.1, spin_inertia=0.01)
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), table)
    >>> law = Backstepping(UnicycleTracking(), robot)
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=0.5))
    >>> run = simulate(robot, law, path, dt=0.05)
    >>> found = robot.contacts(run.q, run.v, run.a, run.u, {})
    >>> found.names, found.places[0].round(2).tolist()  # [m]
    (('left', 'right'), [[0.0, 0.2], [0.0, -0.2]])
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

    See Also
    --------
    WheeledRobot : its method `contact_loads`
    plant.SlipMargins : margins before slip

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import MobileRobot, WheeledRobot, WheelTable
    >>> table = WheelTable.skid_steer(
    ...     wheelbase=0.4, track=0.3, radius=0.1, spin_inertia=0.01)
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), table)
    >>> still = np.zeros(robot.nv)
    >>> loads = robot.contact_loads(robot.rest, still, still)
    >>> print(loads.names[0], f"{loads.values[0]:.1f} N")
    front_left 73.6 N
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

    See Also
    --------
    WheeledRobot : its method `slip_margins`
    plant.ContactLoads : loads of the contacts

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import MobileRobot, WheeledRobot, WheelTable
    >>> from pinmobile.balance import MotionStates
    >>> table = WheelTable.differential(
    ...     0.4, 0.1, supports=[(-0.3, 0)], spin_inertia=0.01)
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), table)
    >>> rest, still = robot.rest, np.zeros(robot.nv)
    >>> states = MotionStates(robot, rest, still, still, u=[2, 2])
    >>> margins = robot.slip_margins(states)
    >>> print(margins.names[0], f"{margins.values[0]:.0f} N")
    left + right 98 N
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

    See Also
    --------
    WheeledRobot : its method `follows`
    plant.SlipMargins : margins before slip

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import MobileRobot, Motor, RestToRest, Tangent
    >>> from pinmobile import WheeledRobot, WheelTable
    >>> table = WheelTable.differential(
    ...     0.4, 0.1, supports=[(-0.3, 0)], spin_inertia=0.01,
    ...     motor=Motor(torque_limit=9.0))
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), table)
    >>> path = Tangent(RestToRest([0, 0], [1, 0], duration=2.0))
    >>> t = np.linspace(0.0, 2.0, 41)
    >>> motion = robot.follows(t, path(t))
    >>> for factor in 1.0, 2.0:
    ...     *_, margins = motion.at(factor)
    ...     print(f"{margins.values.min():.1f} N m left")
    6.7 N m left
    -0.2 N m left
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

    See Also
    --------
    plant.Input : entry of the input
    plant.Input : input of a plant

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> robot.coordinates[2][:2]
    ('psi', 'rad')
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

    See Also
    --------
    plant.Coordinate : entry of a displacement
    plant.Coordinate : coordinate of a configuration

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> robot.inputs[2][:2]
    ('Mz', 'N m')
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

    See Also
    --------
    ensemble : spreads of parameters

    Examples
    --------
    >>> from pinmobile.plant import Parameter
    >>> Parameter("mass", "kg", "mass of the robot").unit
    'kg'
    """

    name: str
    unit: str = ""
    meaning: str = ""


@dataclass(frozen=True, eq=False)
class Context:
    """Argument of a controller's initialisation, ``controller.initial_state(context)``.

    It contains no dynamics of the simulated plant: a wrong controller model stays wrong. The loop makes it;
    ``Context.of`` makes one for calls by hand.

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

    See Also
    --------
    controllers.Controller : protocol of controllers, which receive it
    plant.Plant : protocol of plants

    Examples
    --------
    >>> from pinmobile import PD, MobileRobot
    >>> from pinmobile.plant import Context
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> context = Context.of(robot, dt=0.01)
    >>> memory = PD(kp=120.0, kd=60.0).initial_state(context)
    >>> [one.name for one in context.inputs]
    ['Fx', 'Fy', 'Mz']
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

    def delay(self, samples: int) -> DelayLine:
        """Return a delay to keep in the state: ``old, line = line.push(values)``.

        ``push`` returns the arrays that it received `samples` samples before; until then, it returns the
        first ones.

        Parameters
        ----------
        samples : int
            Delay in samples, >= 0.
        """
        from pinmobile.compiled import DelayLine

        return DelayLine(check_integer("samples", samples, least=0))

    def noise(self, name: str, n: int) -> Noise:
        """Return noise to keep in the state: ``numbers, noise = noise.draw()``.

        The n numbers of a sample are standard normal and independent. They depend only on the seed, the
        member, the name and the number of the sample, and have the same bits in every engine.

        Parameters
        ----------
        name : str
            Name of the noise; different names give independent numbers.
        n : int
            Number of values per sample.
        """
        from pinmobile.compiled import Noise, robot_keys

        text("name", name)
        return Noise(
            robot_keys(self.seed, name, range(self.member, self.member + 1))[0], check_integer("n", n)
        )

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
            If the number of rows differs from the number of times, or a number is not finite.
        """
        from pinmobile.compiled import Schedule

        table = finite("rows", rows)
        shaped("rows", table, (len(self.t), *table.shape[1:]), words=", a row for each sample")
        return Schedule(frozen(table))

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

        Returns
        -------
        context : Context
            The context.

        Raises
        ------
        InvalidArgument
            If `dt` is not above zero, or `t` has another shape.
        """
        check_difference(plant.difference)
        times = shaped("t", finite("t", np.zeros(1) if t is None else t), ("n",))
        descriptions = coordinates_of(plant), inputs_of(plant), reference_sizes_of(plant)
        return cls(
            positive("dt", dt, "s"),
            frozen(times),
            plant.difference,
            plant.integrate,
            *descriptions,
            reference,
            trajectory,
            stated(plant, "nv"),
        )


def coordinates_of(plant: object) -> tuple[Coordinate, ...]:
    """Return the coordinates of a plant, in the order of v; a plant without names gets numbers.

    Parameters
    ----------
    plant : plant
        Any plant.

    Returns
    -------
    coordinates : tuple of Coordinate
        nv coordinates.

    Raises
    ------
    InvalidArgument
        If the attribute ``coordinates`` is not a sequence.

    See Also
    --------
    plant.Coordinate : coordinate of a configuration
    plant.configuration_names_of : names of the entries of q

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> from pinmobile.plant import coordinates_of
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> [one.name for one in coordinates_of(robot)]
    ['x', 'y', 'psi']
    """
    coordinates = stated(plant, "coordinates")
    if coordinates is None:
        return tuple(Coordinate(f"[{k}]", "") for k in range(stated(plant, "nv")))
    return sequence("plant.coordinates", coordinates, "a sequence of Coordinate")


def inputs_of(plant: object) -> tuple[Input, ...]:
    """Return the inputs of a plant, in the order of u; a plant without names gets numbers.

    Parameters
    ----------
    plant : plant
        Any plant.

    Returns
    -------
    inputs : tuple of Input
        nu inputs, with their limits.

    Raises
    ------
    InvalidArgument
        If the attribute ``inputs`` is not a sequence.

    See Also
    --------
    plant.Input : input of a plant

    Examples
    --------
    >>> from pinmobile import VelocityRobot
    >>> from pinmobile.plant import inputs_of
    >>> robot = VelocityRobot(theta=[0.3, 0.2, 0, 1, 0, 1])
    >>> [(one.name, one.unit) for one in inputs_of(robot)]
    [('speed command', 'm/s'), ('yaw rate command', 'rad/s')]
    """
    inputs = stated(plant, "inputs")
    if inputs is None:
        return tuple(Input(f"[{k}]", "") for k in range(stated(plant, "nu")))
    return sequence("plant.inputs", inputs, "a sequence of Input")


def configuration_names_of(plant: object) -> tuple[str, ...]:
    """Return the names of the entries of q: those of the coordinates if their number agrees, else numbers.

    Parameters
    ----------
    plant : plant
        Any plant.

    Returns
    -------
    names : tuple of str
        nq names.

    Raises
    ------
    InvalidArgument
        If the attribute ``configuration_names`` is not a sequence.

    See Also
    --------
    plant.Input : input of a plant

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> from pinmobile.plant import configuration_names_of
    >>> configuration_names_of(MobileRobot(30.0, 1.3))
    ('x', 'y', 'psi')
    """
    names = stated(plant, "configuration_names")
    if names is not None:
        return sequence("plant.configuration_names", names, "a sequence of names")
    count, rows = stated(plant, "nq"), coordinates_of(plant)
    return tuple(row.name for row in rows) if len(rows) == count else tuple(f"[{k}]" for k in range(count))


def reference_sizes_of(plant: object) -> Mapping[int, int]:
    """Return the number of entries of q for each number of coordinates that a reference may have.

    Parameters
    ----------
    plant : plant
        Any plant.

    Returns
    -------
    sizes : mapping of int to int
        Its attribute ``reference_sizes``; default: {nv: nq}.

    See Also
    --------
    plant.Plant : protocol with this attribute

    Examples
    --------
    >>> from pinmobile import MobileRobot, WheeledRobot, WheelTable
    >>> from pinmobile.plant import reference_sizes_of
    >>> table = WheelTable.differential(0.4, 0.1, spin_inertia=0.01)
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), table)
    >>> robot.nq, dict(reference_sizes_of(robot))
    (5, {3: 3})
    """
    sizes: Mapping[int, int] = stated(plant, "reference_sizes") or {stated(plant, "nv"): stated(plant, "nq")}
    return sizes


LIMIT_TOLERANCE = 1e-6
"""Tolerance of integration errors, relative to a limit."""
_BEYOND = " {value} {unit} at t = {at} s, beyond its limit of {limit} {unit} since t = {t} s"
_LIMIT_WORDS = {
    "position limit": "{name} reaches" + _BEYOND,
    "speed limit": "{name} moves at" + _BEYOND,
    "effort limit": "input of {name} reaches" + _BEYOND,
    "saturation": "input {name} is at its limit of {limit} {unit} (from t = {t} s, {count})",
}


class Event(NamedTuple):
    """State of a run that a real robot may not reach or survive, see `Rollout.events`.

    Attributes
    ----------
    kind : str
        ``"position limit"``, ``"speed limit"`` or ``"effort limit"``, which a value exceeds;
        ``"saturation"`` of an input, or ``"current limit"``, which a value reaches; ``"tip over"``;
        ``"lift"`` of a driven wheel; ``"slip"``; ``"ground"``: its loads did not converge; or the name of a
        metric of the plant: a margin below 0, or what happens.
    name : str
        Coordinate, input, motor, wheel or metric.
    t : float
        Time of the first sample [s].
    at, value : float
        Time [s] and value of the worst sample.
    limit : float
        Limit of the value.
    unit : str
        Unit of value and limit, "" for none.
    samples : int
        Number of samples.
    words : str
        Sentence, which is also the text of the event.

    See Also
    --------
    Rollout.events : events of a run.
    simulate : run that ends at an event, by `stop_at`.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.plant import Event
    >>> t, gap = np.array([0.0, 0.1, 0.2]), np.array([0.2, -0.1, -0.3])
    >>> event = Event.of("gap", "gap", t, gap, -gap, words="gap: {value} m")
    >>> str(event), event.t, event.at
    ('gap: -0.3 m', 0.1, 0.2)
    """

    kind: str
    name: str
    t: float
    at: float
    value: float
    limit: float
    unit: str
    samples: int
    words: str

    def __str__(self) -> str:
        return self.words

    @classmethod
    def of(
        cls,
        kind: str,
        name: str,
        t: Array,
        values: Array,
        excess: Array,
        *,
        words: str,
        limit: float = 0.0,
        unit: str = "",
        slack: float = 0.0,
    ) -> Event | None:
        """Return the event of samples whose values are beyond a limit by more than the slack, or None.

        Parameters
        ----------
        kind, name, limit, unit
            As in the event.
        t, values, excess : ndarray, shape (N,)
            Times [s], values, and their excess, whose largest is the worst.
        words : str
            Sentence with places: ``{value}``, ``{limit}``, ``{unit}``, ``{at}``, ``{t}`` and ``{count}``.
        slack : float
            Excess that is no event.
        """
        happens = excess > slack
        if not happens.any():
            return None
        k, first, count = int(excess.argmax()), float(t[happens.argmax()]), int(happens.sum())
        t_worst, value = float(t[k]), float(values[k])
        fields = {"value": f"{value:.4g}", "limit": f"{limit:.4g}", "unit": unit, "name": name}
        fields |= {"at": f"{t_worst:g}", "t": f"{first:g}", "count": f"{count} of {len(t)} samples"}
        return cls(kind, name, first, t_worst, value, float(limit), unit, count, words.format(**fields))


def limit_slack(lower: ArrayLike, upper: ArrayLike) -> Array:
    """Return the excess over limits that is no event, shape (...): a share of the larger finite limit."""
    sizes = (np.where(np.isfinite(limit), np.abs(limit), 0.0) for limit in (lower, upper))
    return np.asarray(LIMIT_TOLERANCE * np.maximum(*sizes))


def first_times(events: Iterable[Event]) -> dict[str, float]:
    """Return the time of the first event of each kind [s], in the order of these times."""
    times: dict[str, float] = {}
    for event in sorted(events, key=lambda event: event.t):
        times.setdefault(event.kind, event.t)
    return times


def limit_events(plant: object, t: Array, q: Array, v: Array, u: Array | None = None) -> tuple[Event, ...]:
    """Return an event for each limit of a plant that samples exceed, and each input at its limit.

    ``coordinates`` contain the limits of position; ``velocity_limit`` and ``effort_limit`` of the robot
    contain the others; ``inputs`` contain the limits within which the loop keeps inputs.

    Parameters
    ----------
    plant : plant
        Plant with limits.
    t, q, v, u : ndarray, shape (N,), (N, nq), (N, nv), (N, nu)
        Times [s], states and inputs of the samples; without `u`, inputs are not checked.

    Returns
    -------
    events : tuple of Event
        One event per exceeded limit.

    See Also
    --------
    trajectories.check_limits : check of a reference

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import MobileRobot
    >>> from pinmobile.plant import limit_events
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)  # no limits
    >>> q, v = np.ones((1, 3)), np.zeros((1, 3))
    >>> limit_events(robot, np.zeros(1), q, v)
    ()
    """
    coordinates, names = coordinates_of(plant), list(configuration_names_of(plant))
    events: list[Event | None] = []

    def check(kind: str, name: str, values: Array, lower: float, upper: float, unit: str) -> None:
        excess = np.maximum(lower - values, values - upper)
        k = int(excess.argmax())
        limit = lower if lower - values[k] >= values[k] - upper else upper
        slack = -LIMIT_TOLERANCE * abs(limit) if kind == "saturation" else float(limit_slack(lower, upper))
        options: Any = {"words": _LIMIT_WORDS[kind], "limit": limit, "unit": unit, "slack": slack}
        events.append(Event.of(kind, name, t, values, excess, **options))

    for one in coordinates:
        if np.isfinite([one.lower, one.upper]).any() and one.name in names:
            check("position limit", one.name, q[:, names.index(one.name)], one.lower, one.upper, one.unit)
    applied = {} if u is None else dict(zip((one.name for one in inputs_of(plant)), u.T, strict=False))
    for entry in inputs_of(plant) if applied else ():
        check("saturation", entry.name, applied[entry.name], entry.lower, entry.upper, entry.unit)
    robot: Any = _limited_robot(plant)
    if robot is not None:
        rates = [one.name for one in coordinates]
        for one, motor, speed, effort in zip(
            coordinates_of(robot), inputs_of(robot), robot.velocity_limit, robot.effort_limit, strict=True
        ):
            if one.name in rates:
                check("speed limit", one.name, v[:, rates.index(one.name)], -speed, speed, f"{one.unit}/s")
            if motor.name in applied:
                check("effort limit", motor.name, applied[motor.name], -effort, effort, motor.unit)
    return tuple(one for one in events if one is not None)


def _limited_robot(plant: object) -> Any:
    """Return the plant or its robot, whichever states effort limits; None if neither does."""
    robots = plant, stated(plant, "robot")
    return next((entry for entry in robots if stated(entry, "effort_limit") is not None), None)


def exceeded_efforts(plant: object, largest: Mapping[str, Array]) -> Iterator[tuple[Input, float, Any]]:
    """Yield each input with an effort limit, the limit, and which robots exceed it, shape (n,).

    Parameters
    ----------
    plant : plant
        Plant of the robots.
    largest : mapping of str to ndarray, shape (n,)
        Largest size of each robot's input, by the input's name.
    """
    robot = _limited_robot(plant)
    for entry, effort in () if robot is None else zip(inputs_of(robot), robot.effort_limit, strict=True):
        if entry.name in largest:
            yield entry, effort, largest[entry.name] > effort * (1 + LIMIT_TOLERANCE)


def check_plant(plant: object) -> None:
    """Check that an object is a plant with consistent sizes.

    Parameters
    ----------
    plant : object
        The object.

    Raises
    ------
    InvalidArgument
        If it lacks ``forward_dynamics`` and ``step``, or a size, or its sizes contradict its names.

    See Also
    --------
    plant.Plant : protocol of plants

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> from pinmobile.plant import check_plant
    >>> check_plant(MobileRobot(mass=30.0, yaw_inertia=1.3))
    >>> check_plant(30.0)
    Traceback (most recent call last):
        ...
    pinmobile.errors.InvalidArgument: plant is 30.0, expected ...
    """
    sizes: dict[str, Any] = {size: getattr(plant, size, None) for size in ("nq", "nv", "nu")}
    has_sizes = all(isinstance(value, int | np.integer) for value in sizes.values())
    method = stated(plant, "forward_dynamics") or stated(plant, "step")
    if isinstance(plant, type) or not (method and has_sizes):
        raise unexpected_value("plant", plant, "a plant with 'forward_dynamics' and the sizes nq, nv, nu")
    for name, size, entries in (
        ("coordinates", "nv", coordinates_of(plant)),
        ("configuration_names", "nq", configuration_names_of(plant)),
        ("inputs", "nu", inputs_of(plant)),
    ):
        if len(entries) != sizes[size]:
            raise InvalidArgument(
                f"plant has {size} = {sizes[size]} and {len(entries)} {name}, expected equal numbers"
            )


def all_samples(plant: object, name: str, *rows: Array) -> Array:
    """Return the values of a method of the plant for each row of arrays (N, ...), stacked: (N, ...).

    Parameters
    ----------
    plant : plant
        Plant; if it ``broadcasts``, the method is called once, otherwise once per row.
    name : str
        Name of the method.
    *rows : ndarray, shape (N, ...)
        Arguments of the method, N > 0.

    Returns
    -------
    values : ndarray, shape (N, ...)
        Value for each row.

    See Also
    --------
    plant.Plant : its attribute ``broadcasts``

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import MobileRobot
    >>> from pinmobile.plant import all_samples
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> all_samples(robot, "mass_matrix", np.zeros((5, 3))).shape
    (5, 3, 3)
    """
    method = getattr(plant, name)
    if stated(plant, "broadcasts"):
        return np.asarray(method(*rows))
    return np.stack([method(*(part.copy() for part in row)) for row in zip(*rows, strict=True)])


def full_configurations(q: Array, reference: Array) -> Array:
    """Return the reference's configurations, completed by the last entries of q.

    Parameters
    ----------
    q : ndarray, shape (..., nq)
        Configurations [m, m, rad, ...].
    reference : ndarray, shape (..., n), n <= nq
        Configurations of the reference.

    Returns
    -------
    q : ndarray, shape (..., nq)
        The completed configurations.

    See Also
    --------
    plant.reference_sizes_of : possible sizes of a reference

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import MobileRobot, WheeledRobot, WheelTable
    >>> from pinmobile.plant import full_configurations
    >>> table = WheelTable.differential(0.4, 0.1, spin_inertia=0.01)
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), table)
    >>> full_configurations(robot.rest, np.ones(3))
    array([1., 1., 1., 0., 0.])
    """
    length, (*lead, size) = reference.shape[-1], q.shape
    if length == size:
        return reference
    return np.concatenate([np.broadcast_to(reference, (*lead, length)), q[..., length:]], axis=-1)


@dataclass(frozen=True)
class PlantDescription:
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

    See Also
    --------
    plant.Plant : protocol of plants
    Rollout : result, whose file contains a description

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> from pinmobile.plant import PlantDescription
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> outline = PlantDescription.of(robot, robot.rest[None])
    >>> outline.kind, outline.nv, outline.inputs[0].unit
    ('MobileRobot', 3, 'N')
    """

    kind: str
    coordinates: tuple[Coordinate, ...]
    configuration_names: tuple[str, ...]
    inputs: tuple[Input, ...]
    reference_sizes: Mapping[int, int]
    posed: tuple[int, ...] | None = None
    size: tuple[float, ...] | None = None
    reason: str = field(default="", compare=False)

    broadcasts: ClassVar[bool] = True
    """Its methods accept leading axes."""

    @classmethod
    def of(cls, plant: object, q: Array) -> PlantDescription:
        """Return the description of a plant.

        Parameters
        ----------
        plant : plant
            Any plant; a description is returned unchanged.
        q : ndarray, shape (N, nq)
            Configurations, which locate the entries of the pose in q.
        """
        if isinstance(plant, cls):
            return plant
        size = stated(plant, "size")
        return cls(
            kind=type(plant).__name__,
            coordinates=tuple(Coordinate(*row) for row in coordinates_of(plant)),
            configuration_names=configuration_names_of(plant),
            inputs=tuple(Input(*row) for row in inputs_of(plant)),
            reference_sizes=dict(reference_sizes_of(plant)),
            posed=_pose_entries(plant, q),
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
    def pose(self) -> Callable[[Array], Array] | None:
        """Function of q that returns x, y and psi of the body, shape (..., 3); None if unknown."""
        return None if self.posed is None else lambda q: np.asarray(q)[..., list(self.posed or ())]


def _pose_entries(plant: object, q: Array) -> tuple[int, ...] | None:
    """Return the entries of q that equal the pose in all samples; None without such entries."""
    if not callable(stated(plant, "pose")) or not len(q):
        return None
    poses = all_samples(plant, "pose", q)
    entries = [np.flatnonzero((q == column[:, None]).all(axis=0)) for column in poses.T]
    return tuple(int(indices[0]) for indices in entries) if all(map(len, entries)) else None
