"""Capabilities: small protocols for the abilities of a part, and the test for them."""

from __future__ import annotations

from functools import cache
from typing import Any, Protocol

from pinmobile.errors import InvalidArgument, format_value


class Comparing(Protocol):
    """A robot with difference(q0, q1)."""

    def difference(self, q0: Any, q1: Any, /) -> Any:
        """Return the displacement from q0 to q1, shape (nv,)."""


class Integrating(Comparing, Protocol):
    """A plant: something with nq, nv, nu, integrate(q, dq) and difference(q0, q1)."""

    def integrate(self, q: Any, dq: Any, /) -> Any:
        """Return the configuration that a displacement leads to, shape (nq,)."""


class Stepping(Protocol):
    """A plant with its own step, step(t, q, v, u, h, f, memory).

    The step replaces the integrator, for instance if the dynamics contain contacts or fast electrical states.
    `Remembering` supplies the initial memory.

    See Also
    --------
    parts.Remembering : parts with memory.
    simulate : run a loop.

    Examples
    --------
    >>> from pinmobile.plant import Step
    >>> class Falling:
    ...     def step(self, t, q, v, u, h, f, memory):
    ...         after = v - 9.81 * h  # [m/s]
    ...         return Step(q + h * after, after, memory)
    >>> float(Falling().step(0, 1.0, 0.0, 0, 0.1, None, None).v)
    -0.981
    """

    def step(self, t: Any, q: Any, v: Any, u: Any, h: Any, f: Any, memory: Any, /) -> Any:
        """Return the `plant.Step` from a state over a time h.

        Parameters
        ----------
        t : float
            Time [s].
        q, v, u : ndarray, shape (nq,), (nv,), (nu,)
            Configuration, velocity and applied input.
        h : float
            Length of the step [s].
        f : callable
            Function ``f(t, q, v)`` that returns the external forces at any time and state, shape (nv,); 0.0
            if there are none.
        memory : tree of ndarrays
            Memory of the plant.

        Returns
        -------
        Step
            Configuration, velocity and memory after the step.
        """


class Constrained(Protocol):
    """A plant with project(q, v), the projection of velocities on its constraints.

    The loop calls the method before each substep except the first, because the initial velocity stays as
    given. Rolling wheels, for instance, have no sideways velocity afterwards.

    See Also
    --------
    parts.Stepping : plants with their own step.

    Examples
    --------
    >>> import numpy as np
    >>> class OnRail:
    ...     def project(self, q, v):
    ...         return v * np.array([1, 0, 0])  # no sideways motion
    >>> OnRail().project(np.zeros(3), np.array([0.5, 0.1, 0.0]))
    array([0.5, 0. , 0. ])
    """

    def project(self, q: Any, v: Any, /) -> Any:
        """Return the velocity after projection on the constraints.

        Parameters
        ----------
        q, v : ndarray, shape (nq,), (nv,)
            Configuration and velocity.

        Returns
        -------
        ndarray, shape (nv,)
            Velocity that satisfies the constraints.
        """


class Pushable(Protocol):
    """A plant whose body can be pushed: pose(q), pose_rate(q, v) and generalized_force(q, wrench).

    Its ``forward_dynamics(q, v, u, f)`` accepts external forces f, shape (nv,). Plots and the viewer use the
    pose.

    See Also
    --------
    ConstantForce : wrench on the body.
    simulate : run a loop with forces.

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> robot.generalized_force([0, 0, 0], [5, 0, 0])  # [N, N, N m]
    array([5., 0., 0.])
    """

    def pose(self, q: Any, /) -> Any:
        """Return the pose (x, y, psi) of the body, shape (3,) [m, m, rad].

        Parameters
        ----------
        q : ndarray, shape (nq,)
            Configuration.
        """

    def pose_rate(self, q: Any, v: Any, /) -> Any:
        """Return the rates of the pose, shape (3,) [m/s, m/s, rad/s].

        Parameters
        ----------
        q, v : ndarray, shape (nq,), (nv,)
            Configuration and velocity.
        """

    def generalized_force(self, q: Any, wrench: Any, /) -> Any:
        """Return the generalized force of a wrench on the body, shape (nv,).

        Parameters
        ----------
        q : ndarray, shape (nq,)
            Configuration.
        wrench : ndarray, shape (3,)
            Force and moment (Fx, Fy, Mz) [N, N, N m].
        """


class Starting(Protocol):
    """A plant with start(reference), which completes the first sample of a reference.

    The reference has the first n coordinates of the plant; ``reference_sizes`` lists the allowed n.

    See Also
    --------
    simulate : run a loop from this state.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import Reference, WheelTable, WheeledRobot
    >>> from pinmobile import MobileRobot
    >>> table = WheelTable.differential(track=0.4, radius=0.1)
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), table)
    >>> zero, ahead = np.zeros(3), np.array([1.0, 0.0, 0.0])  # [m/s]
    >>> q, v = robot.start(Reference(zero, ahead, zero))
    >>> v[3:]  # rates of the wheels [rad/s]
    array([10., 10.])
    """

    def start(self, reference: Any, /) -> Any:
        """Return the initial configuration and velocity.

        Parameters
        ----------
        reference : Reference
            First sample of the reference.

        Returns
        -------
        q, v : ndarray, shape (nq,), (nv,)
            Initial configuration and velocity.
        """


class Remembering(Protocol):
    """A part with memory: initial_state(context).

    See Also
    --------
    plant.Context : argument of the method.

    Examples
    --------
    >>> import numpy as np
    >>> class Filter:  # low-pass filter of the velocity
    ...     def initial_state(self, context):
    ...         return np.zeros(3)
    ...     def __call__(self, t, q, v, reference, state):
    ...         state = 0.9 * state + 0.1 * v
    ...         return 20.0 * (reference.v - state), state
    >>> Filter().initial_state(None)
    array([0., 0., 0.])
    """

    def initial_state(self, context: Any, /) -> Any:
        """Return the memory before the first sample, a tree of arrays.

        Parameters
        ----------
        context : Context
            Data about the loop: time step, times, coordinates, inputs, reference, delays and noise.
        """


class Measuring(Protocol):
    """A plant with metrics: metrics, and evaluate_metrics(t, q, v, a, u, reference).

    Ensembles keep the worst value and the root mean square of each metric beside the errors. One sample gives
    the shape (m,), with vectors q, v, a and u. A plant with ``broadcasts = True`` gets leading axes too, and
    returns the shape (..., m). COMPILED traces the method with the loop: write it as a control law.

    See Also
    --------
    metrics.Metric : description of a metric.
    Rollout.metrics : metrics of a run.

    Examples
    --------
    >>> from pinmobile.metrics import Metric
    >>> class Cart:
    ...     metrics = (Metric("power", "W", "power of the motor"),)
    ...     def evaluate_metrics(self, t, q, v, a, u, reference):
    ...         return u[..., :1] * v[..., :1]
    >>> Cart.metrics[0].title
    'power [W]'
    """

    @property
    def metrics(self) -> Any:
        """Tuple of m `pinmobile.metrics.Metric`: names, units and meanings of the metrics."""

    def evaluate_metrics(self, t: Any, q: Any, v: Any, a: Any, u: Any, reference: Any, /) -> Any:
        """Return the metrics of a sample, shape (m,), or (..., m) if the plant ``broadcasts``.

        Parameters
        ----------
        t : float
            Time [s].
        q, v, a, u : ndarray, shape (nq,), (nv,), (nv,), (nu,)
            Configuration, velocity, acceleration and applied input.
        reference : Reference
            Reference of the sample.
        """


class Signalling(Protocol):
    """A part with signals(...), further series that a run records.

    The arguments are those of the part's law: ``signals(state)`` of a controller, ``signals(t, pose, rate)``
    or ``signals(t, q, v)`` of a force, ``signals(t, q, v, u, f, memory)`` of a plant.

    See Also
    --------
    Rollout.signals : recorded signals.
    loop.Signal : series with a unit.

    Examples
    --------
    >>> class Wind:
    ...     def __call__(self, t, pose, rate):
    ...         return [5.0, 0.0, 0.0]  # [N, N, N m]
    ...     def signals(self, t, pose, rate):
    ...         return {"wind": ("N", 5.0)}
    >>> Wind().signals(0.0, None, None)
    {'wind': ('N', 5.0)}
    """

    def signals(self, *given: Any) -> Any:
        """Return a dict of name to (unit, value); a value is a number or a row of numbers."""


class _Sized(Protocol):
    """A plant."""

    @property
    def nv(self) -> int:
        """Size of v."""


class Invertible(Protocol):
    """A MobileRobot, or a plant with inverse_dynamics(q, v, a) and nv."""

    @property
    def nv(self) -> int:
        """Size of v."""

    def inverse_dynamics(self, q: Any, v: Any, a: Any, /) -> Any:
        """Return the generalized force M(q) a + n(q, v), shape (nv,)."""


class Inverted(Protocol):
    """A robot with check_inverse_dynamics(), which rejects a robot without inverse dynamics."""

    def check_inverse_dynamics(self) -> None:
        """Raise `InvalidArgument` if no input moves the robot in every direction."""


class Gravitating(_Sized, Protocol):
    """A MobileRobot."""

    def gravity(self, q: Any, /) -> Any:
        """Return the gravity term g(q), shape (nv,)."""


class Passive(Invertible, Protocol):
    """A MobileRobot."""

    def nonlinear_effects(self, q: Any, v: Any, /) -> Any:
        """Return the nonlinear effects n(q, v), shape (nv,)."""

    def gravity(self, q: Any, /) -> Any:
        """Return the gravity term g(q), shape (nv,)."""


class Observable(Invertible, Protocol):
    """A MobileRobot."""

    def coriolis_matrix(self, q: Any, v: Any, /) -> Any:
        """Return the Coriolis matrix C(q, v) from Christoffel symbols, shape (nv, nv)."""

    def gravity(self, q: Any, /) -> Any:
        """Return the gravity term g(q), shape (nv,)."""


class Linearized(_Sized, Protocol):
    """A MobileRobot or a WheeledRobot."""

    def linearize_tracked(self, q: Any, v: Any, u: Any, /) -> Any:
        """Return the matrices A and B of the tracked state."""


class Rolling(_Sized, Protocol):
    """A WheeledRobot."""

    def independent(self, q: Any, v: Any, /) -> Any:
        """Return the independent velocities."""

    def reduced(self, q: Any, v: Any, /) -> Any:
        """Return the dynamics in the independent velocities."""


class Followed(Protocol):
    """A robot on wheels that roll, followed(reference)."""

    def followed(self, reference: Any, /) -> Any:
        """Return states, inputs and independent velocities along a reference."""


class Tabled(Protocol):
    """A WheeledRobot."""

    @property
    def table(self) -> Any:
        """Wheels and motors of the robot."""


class Commanded(Protocol):
    """A VelocityRobot."""

    def commands(self, q: Any, v: Any, rates: Any, /) -> Any:
        """Return the commands that produce these rates of the independent velocities."""


class Driven(Protocol):
    """A VelocityRobot or a VelocityCar."""

    def command_for(self, speed: Any, yaw_rate: Any, /) -> Any:
        """Return the commands for a steady speed and yaw rate."""


class Allocating(Protocol):
    """A WheeledRobot."""

    @property
    def robot(self) -> Any:
        """Body with its arms."""

    def allocate_scaled(self, q: Any, force: Any, /) -> Any:
        """Return wheel torques for a force on body and arms, and the force that they cannot produce."""


class Electric(Protocol):
    """A WheeledRobot with electric motors."""

    def volts_for(self, v: Any, torques: Any, /) -> Any:
        """Return the motor voltages that produce these torques."""


class Powered(Protocol):
    """A WheeledRobot whose motors can be driven by voltage: by_voltage()."""

    def by_voltage(self) -> Any:
        """Return the same robot with motor voltages as its input."""


class Informed(Protocol):
    """A controller with applied(u, state), which receives the applied input."""

    def applied(self, u: Any, state: Any, /) -> Any:
        """Return the next memory, from the applied input and the memory."""


class OnCoordinates(Protocol):
    """A force on all coordinates, on_coordinates(t, q, v), such as friction in joints."""

    def on_coordinates(self, t: Any, q: Any, v: Any, /) -> Any:
        """Return the generalized force, shape (..., nv), in the units of the coordinates.

        Parameters
        ----------
        t : float or ndarray, shape (...)
            Time [s].
        q, v : ndarray, shape (..., nq) and (..., nv)
            Configuration and velocity.
        """


class Carried(Protocol):
    """A force that adds inertia to the body, inertia(t, pose).

    The force itself applies to constant velocity; the loop adds the reaction of the mass. The plant needs an
    integrator, and its first coordinates are x, y and psi of the body.
    """

    def inertia(self, t: Any, pose: Any, /) -> Any:
        """Return the additional mass matrix of the body, shape (..., 3, 3) [kg, kg m, kg m^2].

        Parameters
        ----------
        t : float or ndarray, shape (...)
            Time [s].
        pose : ndarray, shape (..., 3)
            Pose of the body [m, m, rad].
        """


class Following(Protocol):
    """A trajectory: trajectory(t) -> Reference(q, v, a), and its duration."""

    @property
    def duration(self) -> float:
        """Duration of the trajectory [s]."""

    def __call__(self, t: Any, /) -> Any:
        """Return the reference at one time or several times."""


class Desired(Protocol):
    """A Reference: q, v and a."""

    @property
    def q(self) -> Any:
        """Desired configuration."""

    @property
    def v(self) -> Any:
        """Desired velocity."""

    @property
    def a(self) -> Any:
        """Desired acceleration."""


class Touching(Protocol):
    """A plant that provides its contacts with the ground: contacts(q, v, a, u, signals)."""

    def contacts(self, q: Any, v: Any, a: Any, u: Any, signals: Any, /) -> Any:
        """Return the contacts at n samples."""


class Grounded(_Sized, Protocol):
    """A MobileRobot, or a plant with ground_wrench(q, v, a)."""

    def ground_wrench(self, q: Any, v: Any, a: Any, /) -> Any:
        """Return the wrench of the ground on the body, shape (..., 6)."""


class TimeVarying(Protocol):
    """A plant that is one of several robots at each time."""

    def robot_at(self, t: Any, /) -> Any:
        """Return the robot at a time, or the robots at the times of n samples as one plant."""

    def shown(self, t: Any, /) -> Any:
        """Return whether visual objects exist at times, by name; without those that always exist."""


class Loadable(Protocol):
    """A MobileRobot or a WheeledRobot."""

    def attach(self, load: Any, frame: Any = None, /) -> Any:
        """Return the robot with a load on one of its frames."""


@cache
def members(kind: type) -> tuple[str, ...]:
    """Return the names that a protocol requires, those of its base first."""
    names = (name for base in reversed(kind.__mro__[:-3]) for name in vars(base))
    return tuple(name for name in names if name == "__call__" or not name.startswith("_"))


def offers(part: object, kind: type) -> bool:
    """Return whether a part has all members of a protocol; a member that is None does not count."""
    return all(getattr(part, name, None) is not None for name in members(kind))


def able(part: Any, kind: type) -> Any:
    """Return the part if it has a capability, else None."""
    return part if offers(part, kind) else None


def format_missing(part: object, kind: type) -> str:
    """Return a text about the first missing member of a part that has other members of a protocol.

    The text is "" for a class, and for a part that has none or all of the members.
    """
    missing = "" if isinstance(part, type) else _first_missing(part, kind)
    return missing and f", which has no {missing}"


def _first_missing(part: object, kind: type) -> str:
    """Return the first missing member of a part that has other members of a protocol, otherwise ""."""
    names = [name for name in members(kind) if name != "__call__"]
    missing = [name for name in names if getattr(part, name, None) is None]
    return missing[0] if 0 < len(missing) < len(names) else ""


def advice(part: object) -> str:
    """Return a text that names the controllers of a robot with commands as inputs; "" for other parts."""
    if offers(part, Commanded):
        return ": use Backstepping, VelocityCommand or AdaptiveVelocity"
    return ": use VelocityCommand" if offers(part, Driven) else ""


def meaning(kind: type, part: object = None) -> str:
    """Return a capability as text: the first line of its docstring, or an object of a class that has it."""
    if isinstance(part, type) and members(kind) and (offers(part, kind) or _first_missing(part, kind)):
        return f"an object: {part.__name__}(...)"
    words = (kind.__doc__ or kind.__name__).split("\n")[0].rstrip(".")
    return words[:1].lower() + words[1:]


def require(name: str, part: Any, kind: type, reason: str = "") -> Any:
    """Return a part that must have a capability.

    Parameters
    ----------
    name, part : str, object
        Name and value of the argument.
    kind : protocol
        Capability.
    reason : str, optional
        Reason, for the message, such as ``"forces push its body"``.

    Raises
    ------
    InvalidArgument
        If the part does not have the capability.
    """
    if isinstance(part, type) or not offers(part, kind):
        text = format_missing(part, kind) + (reason and f", and {reason}")
        raise InvalidArgument(f"{name} is {format_value(part)}{text}, expected {meaning(kind, part)}")
    return part
