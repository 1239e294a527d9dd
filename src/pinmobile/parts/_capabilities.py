"""Capabilities: small protocols of what a part can do, the one test for them, and the one error."""

from __future__ import annotations

from functools import cache
from typing import Any, Protocol

from pinmobile.errors import InvalidArgument, shown


class Comparing(Protocol):
    """A robot with difference(q0, q1)."""

    def difference(self, q0: Any, q1: Any, /) -> Any:
        """Return the displacement from q0 to q1, shape (nv,)."""


class Integrating(Comparing, Protocol):
    """A plant: something with nq, nv, nu, integrate(q, dq) and difference(q0, q1)."""

    def integrate(self, q: Any, dq: Any, /) -> Any:
        """Return the configuration that a displacement leads to, shape (nq,)."""


class Stepping(Protocol):
    """A plant with a step of its own, step(t, q, v, u, h, f, memory).

    It replaces the integrator, for instance if the dynamics contain contacts or fast electrical states.
    `Remembering` supplies its first memory.
    """

    def step(self, t: Any, q: Any, v: Any, u: Any, h: Any, f: Any, memory: Any, /) -> Any:
        """Return the `Step` from a state by a time h.

        ``f(t, q, v)`` returns the external forces at any time and state, shape (nv,); 0.0 if there are none.
        """


class Constrained(Protocol):
    """A plant with project(q, v), the velocity that its constraints leave.

    The loop calls it before each substep but the first, as a start is taken as given: rolling wheels have no
    sideways velocity afterwards.
    """

    def project(self, q: Any, v: Any, /) -> Any:
        """Return the velocity that the constraints leave, shape (nv,)."""


class Pushable(Protocol):
    """A plant whose body can be pushed: pose(q), pose_rate(q, v) and generalized_force(q, wrench).

    Its ``forward_dynamics(q, v, u, f)`` takes external forces f, shape (nv,), beside the input. Plots and the
    viewer use the pose.
    """

    def pose(self, q: Any, /) -> Any:
        """Return x, y, psi of the body, shape (3,) [m, m, rad]."""

    def pose_rate(self, q: Any, v: Any, /) -> Any:
        """Return their rates, shape (3,)."""

    def generalized_force(self, q: Any, wrench: Any, /) -> Any:
        """Return the generalized force of a wrench (Fx, Fy, Mz) on the body, shape (nv,)."""


class Starting(Protocol):
    """A plant with start(reference), which completes the first sample of a reference.

    The reference has the first n coordinates of the plant, one of the lengths in ``reference_sizes``.
    """

    def start(self, reference: Any, /) -> Any:
        """Return q and v."""


class Remembering(Protocol):
    """A part with memory: initial_state(context)."""

    def initial_state(self, context: Any, /) -> Any:
        """Return the memory before the first sample."""


class Measuring(Protocol):
    """A plant with metrics: metrics, and evaluate_metrics(t, q, v, a, u, reference).

    Ensembles keep the worst value of each metric beside the errors.
    """

    @property
    def metrics(self) -> Any:
        """Tuple of m `pinmobile.metrics.Metric`: names, units and meanings of the metrics."""

    def evaluate_metrics(self, t: Any, q: Any, v: Any, a: Any, u: Any, reference: Any, /) -> Any:
        """Return the metrics of a sample, shape (m,)."""


class Signalling(Protocol):
    """A part with signals(...), further series worth recording.

    The arguments are those of its law: ``signals(state)`` of a controller, ``signals(t, pose, rate)`` or
    ``signals(t, q, v)`` of a force, ``signals(t, q, v, u, f, memory)`` of a plant.
    """

    def signals(self, *given: Any) -> Any:
        """Return a dict of name to (unit, value), a value being a number or a row of numbers."""


class _Sized(Protocol):
    """A plant."""

    @property
    def nv(self) -> int:
        """Size of v."""


class Invertible(Protocol):
    """A MobileRobot."""

    @property
    def nv(self) -> int:
        """Size of v."""

    def inverse_dynamics(self, q: Any, v: Any, a: Any, /) -> Any:
        """Return M(q) a + n(q, v), shape (nv,)."""


class Inverted(Protocol):
    """A robot with check_inverse_dynamics(), which says where it has none."""

    def check_inverse_dynamics(self) -> None:
        """Raise `InvalidArgument` where no input moves the robot in every direction."""


class Gravitating(_Sized, Protocol):
    """A MobileRobot."""

    def gravity(self, q: Any, /) -> Any:
        """Return g(q), shape (nv,)."""


class Passive(Invertible, Protocol):
    """A MobileRobot."""

    def nonlinear_effects(self, q: Any, v: Any, /) -> Any:
        """Return n(q, v), shape (nv,)."""

    def gravity(self, q: Any, /) -> Any:
        """Return g(q), shape (nv,)."""


class Observable(Invertible, Protocol):
    """A MobileRobot."""

    def coriolis_matrix(self, q: Any, v: Any, /) -> Any:
        """Return C(q, v) of Christoffel's symbols, shape (nv, nv)."""

    def gravity(self, q: Any, /) -> Any:
        """Return g(q), shape (nv,)."""


class Linearized(_Sized, Protocol):
    """A MobileRobot or a WheeledRobot."""

    def linearize_tracked(self, q: Any, v: Any, u: Any, /) -> Any:
        """Return A and B of the tracked state."""


class Rolling(_Sized, Protocol):
    """A WheeledRobot."""

    def independent(self, q: Any, v: Any, /) -> Any:
        """Return the independent velocities."""


class Followed(Protocol):
    """A robot on wheels that roll, followed(reference)."""

    def followed(self, reference: Any, /) -> Any:
        """Return states, inputs and independent velocities along a reference."""


class Tabled(Protocol):
    """A WheeledRobot."""

    @property
    def table(self) -> Any:
        """Its wheels and motors."""


class Commanded(Protocol):
    """A VelocityRobot."""

    def commands(self, q: Any, v: Any, rates: Any, /) -> Any:
        """Return the commands at which the independent velocities change so."""


class Allocating(Protocol):
    """A WheeledRobot."""

    @property
    def robot(self) -> Any:
        """Body and arms."""

    def allocate_scaled(self, q: Any, force: Any, /) -> Any:
        """Return torques for a force on body and arms, and what of it they leave."""


class Electric(Protocol):
    """A WheeledRobot with electric motors."""

    def volts_for(self, v: Any, torques: Any, /) -> Any:
        """Return the voltages that give these torques."""


class Powered(Protocol):
    """A WheeledRobot whose motors may take volts: by_voltage()."""

    def by_voltage(self) -> Any:
        """Return the same robot, which takes volts."""


class Informed(Protocol):
    """A controller with applied(u, state), which takes the input after all limits."""

    def applied(self, u: Any, state: Any, /) -> Any:
        """Return the next memory."""


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
    """A force that adds to the inertia of the body, inertia(t, pose).

    As a force it is called for a constant velocity; the loop adds the reaction of its mass. The plant needs
    an integrator; its first coordinates are x, y and psi of the body.
    """

    def inertia(self, t: Any, pose: Any, /) -> Any:
        """Return what it adds to the mass matrix of the body, shape (..., 3, 3) [kg, kg m, kg m^2].

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
        """Time at which it ends [s]."""

    def __call__(self, t: Any, /) -> Any:
        """Return the reference at a time, or at several."""


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
    """A plant that tells its contacts with the ground, with contacts(q, v, a, u, signals)."""

    def contacts(self, q: Any, v: Any, a: Any, u: Any, signals: Any, /) -> Any:
        """Return the contacts at n samples."""


class Grounded(_Sized, Protocol):
    """A MobileRobot, or a plant with ground_wrench(q, v, a)."""

    def ground_wrench(self, q: Any, v: Any, a: Any, /) -> Any:
        """Return the wrench of the ground on the body, shape (..., 6)."""


@cache
def members(kind: type) -> tuple[str, ...]:
    """Return the names that a protocol asks for, those of its base first."""
    names = (name for each in reversed(kind.__mro__[:-3]) for name in vars(each))
    return tuple(name for name in names if name == "__call__" or not name.startswith("_"))


def offers(part: object, kind: type) -> bool:
    """Return whether a part has all that a protocol asks for; what is None it has not."""
    return all(getattr(part, name, None) is not None for name in members(kind))


def able(part: Any, kind: type) -> Any:
    """Return the part as one with a capability; None where it has it not."""
    return part if offers(part, kind) else None


def lacks(part: object, kind: type) -> str:
    """Return in words what a part lacks that has other things of a protocol, "" of one that has none."""
    names = [name for name in members(kind) if name != "__call__"]
    lacking = [name for name in names if getattr(part, name, None) is None]
    return f", which has no {lacking[0]}" if 0 < len(lacking) < len(names) else ""


def meaning(kind: type) -> str:
    """Return a capability in words: the first sentence of its docstring."""
    words = (kind.__doc__ or kind.__name__).split("\n")[0].rstrip(".")
    return words[:1].lower() + words[1:]


def required(name: str, part: Any, kind: type, why: str = "") -> Any:
    """Return the part as one with a capability.

    Parameters
    ----------
    name, part : str, object
        The argument.
    kind : protocol
        The capability.
    why : str, optional
        What needs it, such as ``"forces push its body"``.

    Raises
    ------
    InvalidArgument
        If it has it not.
    """
    if isinstance(part, type) or not offers(part, kind):
        told = lacks(part, kind) + (why and f", and {why}")
        raise InvalidArgument(f"{name} is {shown(part)}{told}, expected {meaning(kind)}")
    return part
