"""What a controller is, what it asks of a reference and a robot, and how configurations are compared."""

from collections.abc import Callable
from typing import Any, Protocol, TypeAlias

import numpy as np

from pinmobile.arrays import LEAST_ANGLE, Array, ArrayLike, broadcast, callable_as, finite, wrap_angle
from pinmobile.errors import InvalidArgument, shown

__all__ = [
    "Controller",
    "Difference",
    "InverseDynamics",
    "State",
    "answer_of",
    "check_controller",
    "planar_difference",
]

Difference: TypeAlias = Callable[[Array, Array], Array]


class State(Protocol):
    """A configuration, a velocity and an acceleration, each of shape (..., n)."""

    @property
    def q(self) -> Array:
        """Configuration."""

    @property
    def v(self) -> Array:
        """Velocity."""

    @property
    def a(self) -> Array:
        """Acceleration."""


class InverseDynamics(Protocol):
    """What `ComputedTorque` needs of a robot."""

    @property
    def nv(self) -> int:
        """Size of v."""

    def inverse_dynamics(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """Return M(q) a + n(q, v)."""


class Controller(Protocol):
    """What `simulate` needs of a controller."""

    def initial_state(self) -> Any:
        """Return the state to start with; None where there is no memory."""

    def __call__(self, t: float, q: Array, v: Array, reference: Any, state: Any) -> tuple[Array, Any]:
        """Return the generalised force, shape (..., nu), and the next state."""


def check_controller(controller: Any) -> None:
    """Refuse what is no controller, such as a plain function or a class.

    Raises
    ------
    InvalidArgument
        If it is none.
    """
    if isinstance(controller, type) or not hasattr(controller, "initial_state"):
        raise InvalidArgument(
            f"controller is {shown(controller)}, expected a controller: wrap a function in law(...)"
        )
    callable_as("controller(t, q, v, reference, state)", controller)
    callable_as("controller.initial_state()", controller.initial_state)


def answer_of(
    controller: Controller, t: float, q: Array, v: Array, reference: Any, state: Any
) -> tuple[Array, Any]:
    """Return the force and the next state of a controller.

    Raises
    ------
    InvalidArgument
        If it returns something else than two.
    """
    answer = controller(t, q, v, reference, state)
    if type(answer) is not tuple or len(answer) != 2:
        raise InvalidArgument(f"controller returned {shown(answer)} at t = {t:g} s, expected (tau, state)")
    return answer


def planar_difference(q_d: Array, q: Array) -> Array:
    """Return q_d - q with the difference of the heading on the circle.

    Parameters
    ----------
    q_d, q : array_like, shape (..., n), n >= 3
        Configurations; the third coordinate is psi [rad].

    Returns
    -------
    error : ndarray, shape (..., n)
        Its third coordinate lies in (-pi, pi]. The lecture's own subtraction is `numpy.subtract`.

    Raises
    ------
    InvalidArgument
        If there is no third coordinate.
    """
    if type(q_d) is not np.ndarray or type(q) is not np.ndarray:
        q_d, q = finite("q_d", q_d), finite("q", q)
        broadcast(q_d=q_d[..., None], q=q[..., None])
    error = np.subtract(q_d, q, dtype=np.float64)
    if not error.ndim or error.shape[-1] < 3:
        raise InvalidArgument(
            f"configurations have shape {error.shape}, expected (..., n) with n >= 3; "
            "without a heading, compare them with difference=numpy.subtract"
        )
    if error.ndim > 1 or not LEAST_ANGLE < error[2] <= np.pi:
        error[..., 2] = wrap_angle(error[..., 2])
    return error
