"""Feedback of the error in configuration and velocity: PD, and computed torque."""

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, callable_as, finite, frozen
from pinmobile.controllers.protocol import Difference, InverseDynamics, State, planar_difference
from pinmobile.errors import InvalidArgument, shown

__all__ = [
    "PD",
    "ComputedTorque",
    "check_gains",
    "check_robot",
    "difference_of",
    "feedback",
    "gain_matrix",
    "own_difference",
]


@dataclass(frozen=True)
class _Own:
    robot: Any

    def __call__(self, q_d: Array, q: Array) -> Array:
        """Return the displacement from q to q_d."""
        return np.asarray(self.robot.difference(q, q_d))


def difference_of(robot: Any) -> Difference:
    """Return ``difference(q_d, q)`` as the robot takes it, for joints that are (cos, sin) in q too.

    Parameters
    ----------
    robot : MobileRobot or other plant
        Whose ``difference(q0, q1)`` is the displacement from q0 to q1, shape (..., nv).

    Raises
    ------
    InvalidArgument
        If it has none.
    """
    if not hasattr(robot, "difference"):
        raise InvalidArgument(f"robot is {shown(robot)}, expected a MobileRobot or other plant")
    return _Own(robot)


@final
@dataclass(frozen=True, eq=False)
class PD:
    """Proportional-derivative control, tau = Kp e + Kd e_dot with e = q_d - q (lecture, section 4).

    Parameters
    ----------
    kp, kd : array_like, shape (), (n,) or (n, n)
        Gains: a scalar, one per coordinate, or a matrix. For a force in N and an error in m, [N/m] and
        [N s/m].
    difference : callable
        ``difference(q_d, q)``: how two configurations are compared. The lecture's is `numpy.subtract`; that
        of a robot with joints that are (cos, sin) in q is ``difference_of(robot)``.

    Raises
    ------
    InvalidArgument
        If a gain has another shape or is not finite.
    """

    kp: ArrayLike
    kd: ArrayLike
    difference: Difference = planar_difference

    def __post_init__(self) -> None:
        check_gains(self, None)

    def initial_state(self) -> None:
        """Return None: there is no memory."""

    def __call__(self, t: float, q: Array, v: Array, reference: State, state: None) -> tuple[Array, None]:
        """Return the generalised force, shape (..., n), and None."""
        return feedback(self, q, v, reference), None


@final
@dataclass(frozen=True, eq=False)
class ComputedTorque:
    """Computed torque, tau = M(q) (a_d + Kd e_dot + Kp e) + n(q, v) (lecture, section 4).

    Parameters
    ----------
    robot : MobileRobot
        The model that the controller believes in; it need not be the one that is simulated.
    kp, kd : array_like, shape (), (n,) or (n, n)
        Gains [1/s^2] and [1/s]: a scalar, one per coordinate, or a matrix.
    difference : callable
        ``difference(q_d, q)``: how two configurations are compared; by default the robot's own. The lecture's
        is `numpy.subtract`.

    Raises
    ------
    InvalidArgument
        If a gain has another shape or is not finite.
    """

    robot: InverseDynamics
    kp: ArrayLike = 4
    kd: ArrayLike = 4
    difference: Difference = planar_difference

    def __post_init__(self) -> None:
        check_robot(self.robot, "inverse_dynamics")
        object.__setattr__(self, "difference", own_difference(self.robot, self.difference))
        check_gains(self, self.robot.nv)

    def initial_state(self) -> None:
        """Return None: there is no memory."""

    def __call__(self, t: float, q: Array, v: Array, reference: State, state: None) -> tuple[Array, None]:
        """Return the generalised force, shape (..., n), and None."""
        command = reference.a + feedback(self, q, v, reference)
        return self.robot.inverse_dynamics(q, v, command), None


def gain_matrix(name: str, gain: ArrayLike, n: int) -> Array:
    """Return a gain as a matrix.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    gain : array_like, shape (), (n,) or (n, n)
        The gain.
    n : int
        Number of coordinates.

    Raises
    ------
    InvalidArgument
        If the gain has another shape.
    """
    array = finite(name, gain)
    if array.shape not in ((), (n,), (n, n)):
        raise InvalidArgument(f"{name} has shape {array.shape}, expected (), ({n},) or ({n}, {n})")
    return array if array.ndim == 2 else np.diag(np.broadcast_to(array, n))


def check_robot(robot: Any, needs: str) -> None:
    """Refuse what has no sizes and no method of that name.

    Raises
    ------
    InvalidArgument
        If it is no robot.
    """
    sizes = getattr(robot, "nv", None), getattr(robot, "nq", getattr(robot, "nv", None))
    if isinstance(robot, type) or not hasattr(robot, needs) or not all(isinstance(n, int) for n in sizes):
        raise InvalidArgument(f"robot is {shown(robot)}, expected a MobileRobot")


def own_difference(robot: Any, difference: Difference) -> Difference:
    """Return the robot's own instead of the plane's where its configurations do not subtract."""
    subtracts = getattr(robot, "nq", robot.nv) == robot.nv
    return difference if subtracts or difference is not planar_difference else difference_of(robot)


def check_gains(controller: Any, n: int | None) -> None:
    """Check and freeze `kp` and `kd`, and check `difference`, of a controller that is being made.

    Parameters
    ----------
    controller : controller
        With these three attributes.
    n : int or None
        Number of coordinates, where it is known.

    Raises
    ------
    InvalidArgument
        If one is not what is expected.
    """
    for name in ("kp", "kd"):
        gain = finite(name, getattr(controller, name))
        if n is None and (gain.ndim > 2 or (gain.ndim == 2 and gain.shape[0] != gain.shape[1])):
            raise InvalidArgument(f"{name} has shape {gain.shape}, expected (), (n,) or (n, n)")
        if n is not None:
            gain_matrix(name, gain, n)
        object.__setattr__(controller, name, frozen(gain))
    callable_as("difference(q_d, q)", controller.difference)


def feedback(controller: Any, q: Array, v: Array, reference: State) -> Array:
    """Return Kp e + Kd e_dot of a controller that has `kp`, `kd` and `difference`, shape (..., n).

    Raises
    ------
    InvalidArgument
        If state, reference and gains do not fit together.
    """
    for name, actual, desired in (("q", q, reference.q), ("v", v, reference.v)):
        if actual.shape[-1:] != desired.shape[-1:]:
            raise InvalidArgument(f"{name} has shape {actual.shape}, the reference's has {desired.shape}")
    error, rate = controller.difference(reference.q, q), np.subtract(reference.v, v)
    if error.shape[-1:] != rate.shape[-1:]:
        raise InvalidArgument(
            f"difference gives shape {error.shape}, expected {rate.shape}: compare configurations of a robot "
            "with joints without limits by difference=difference_of(robot)"
        )
    return _amplified("kp", controller.kp, error) + _amplified("kd", controller.kd, rate)


def _amplified(name: str, gain: Any, error: Array) -> Array:
    n = error.shape[-1]
    if gain.ndim == 2:
        return error @ gain_matrix(name, gain, n).T
    if gain.shape not in ((), (n,)):
        gain_matrix(name, gain, n)
    return np.asarray(gain * error)
