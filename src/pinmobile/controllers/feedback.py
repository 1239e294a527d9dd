"""Feedback of the error in configuration and velocity: PD, computed torque, and between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Protocol, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, frozen
from pinmobile.controllers.controller import InverseDynamics, State
from pinmobile.errors import InvalidArgument, shown
from pinmobile.plant import Context, Difference, Parameter, Plant, check_difference, leading_of


def _all(values: Array, column: Array, size: int) -> Array:
    return np.repeat(column[:, None], size, axis=1)


def _one(k: int, values: Array, column: Array, size: int) -> Array:
    new = values.copy() if values.ndim > 1 else np.repeat(values[:, None], size, axis=1)
    place: tuple[slice | int, ...] = (slice(None), *(k,) * (new.ndim - 1))
    new[place] = column
    return new


def _times(values: Array, column: Array, size: int) -> Array:
    return values * column.reshape(-1, *(1,) * (values.ndim - 1))


def gain_parameters(name: str, unit: str = "") -> tuple[Parameter, ...]:
    """Return the parameters of a gain of each coordinate: of all, of x, y and psi alone, and a factor."""
    words = f"{name} of all coordinates, in place of the controller's"
    return (
        Parameter(name, unit, words, attribute=name, write=_all),
        *(
            Parameter(
                f"{name}_{c}", unit, f"{name} of {c} alone", attribute=name, entry=k, write=partial(_one, k)
            )
            for k, c in enumerate(("x", "y", "psi"))
        ),
        Parameter(
            f"{name}_factor", "", f"by which {name} is multiplied", attribute=name, write=_times, neutral=1.0
        ),
    )


GAINS = (*gain_parameters("kp"), *gain_parameters("kd"))
"""The parameters of a controller with `kp` and `kd`."""


class Feedback(Protocol):
    """A controller of the errors of configuration and velocity."""

    @property
    def kp(self) -> ArrayLike:
        """Gain of the error in configuration."""

    @property
    def kd(self) -> ArrayLike:
        """Gain of that in velocity."""

    @property
    def difference(self) -> Difference | None:
        """How configurations are compared, where it was told."""


class ModelFeedback(Feedback, Protocol):
    """One with a model of the robot."""

    @property
    def robot(self) -> Any:
        """The model that the controller believes in."""


@final
@dataclass(frozen=True, eq=False)
class PD:
    """Proportional-derivative control (lecture, section 4): tau = Kp e + Kd e_dot, e = difference(q, q_d).

    Parameters
    ----------
    kp, kd : array_like, shape (), (n,) or (n, n)
        Gains: a scalar, one per coordinate, or a matrix. For a force in N and an error in m, [N/m] and
        [N s/m].
    difference : callable
        ``difference(q0, q1)``: the displacement from q0 to q1; the error is that from q to q_d. By default
        the plant's, which the state keeps; the lecture's is `plain_difference`.

    Raises
    ------
    InvalidArgument
        If a gain has another shape or is not finite.
    """

    kp: ArrayLike
    kd: ArrayLike
    difference: Difference | None = None

    parameters: ClassVar[tuple[Parameter, ...]] = GAINS

    def __post_init__(self) -> None:
        check_gains(self, None)

    def initial_state(self, context: Context) -> Difference:
        """Return the difference of configurations, by default the plant's."""
        return own_difference(self, context)

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: Difference
    ) -> tuple[Array, Difference]:
        """Return the generalised force, shape (..., n), and the state as it is."""
        if not callable(state):
            raise InvalidArgument(
                f"state is {shown(state)}, expected what initial_state(context) returns; called by hand, "
                "that is of Context.of(robot, dt=...)"
            )
        return feedback(self, state, q, v, reference), state


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


def check_robot(controller: ModelFeedback, needs: str) -> None:
    """Refuse a controller's robot that has no sizes, no method of that name, or no difference to use.

    Raises
    ------
    InvalidArgument
        If it is no robot.
    """
    robot = controller.robot
    sizes = getattr(robot, "nv", None), getattr(robot, "nq", getattr(robot, "nv", None))
    if isinstance(robot, type) or not hasattr(robot, needs) or not all(isinstance(n, int) for n in sizes):
        lacks = "" if not hasattr(robot, "nv") or hasattr(robot, needs) else f", which has no {needs}"
        raise InvalidArgument(f"robot is {shown(robot)}{lacks}, expected a MobileRobot")
    if controller.difference is None and not hasattr(robot, "difference"):
        raise InvalidArgument(
            f"robot is {shown(robot)}, which has no difference(q0, q1), expected one, or to be told how "
            "configurations are compared: difference=planar_difference"
        )


def own_difference(controller: Feedback, plant: Context | Plant | InverseDynamics | Gravity) -> Difference:
    """Return the difference that a controller was given, else its robot's, else a plant's or context's."""
    own = controller.difference
    return getattr(controller, "robot", plant).difference if own is None else own


def check_gains(controller: Feedback, n: int | None, *more: str) -> None:
    """Check and freeze `kp`, `kd` and more, and check `difference`, of a controller that is being made.

    Parameters
    ----------
    controller : controller
        With these attributes.
    n : int or None
        Number of coordinates, where it is known.
    more : str
        Names of its other gains.

    Raises
    ------
    InvalidArgument
        If one is not what is expected.
    """
    names = ("kp", "kd", *more)
    for name in names:
        gain = finite(name, getattr(controller, name))
        if n is None and (gain.ndim > 2 or (gain.ndim == 2 and gain.shape[0] != gain.shape[1])):
            raise InvalidArgument(f"{name} has shape {gain.shape}, expected (), (n,) or (n, n)")
        if n is not None:
            gain_matrix(name, gain, n)
        object.__setattr__(controller, name, frozen(gain))
    if controller.difference is not None:
        check_difference(controller.difference)


def feedback(controller: Feedback, difference: Difference, q: Array, v: Array, reference: State) -> Array:
    """Return Kp e + Kd e_dot of a controller that has `kp` and `kd`, shape (..., n).

    Raises
    ------
    InvalidArgument
        If state, reference and gains do not fit together.
    """
    robot, wanted = getattr(controller, "robot", None), reference.q
    n = reference.v.shape[-1]
    if q.shape != wanted.shape or v.shape != reference.v.shape or (robot is not None and robot.nv != n):
        if robot is not None and n == max(leading_of(robot)) < v.shape[-1]:  # wheels have no reference
            lead, length = q.shape[:-1], wanted.shape[-1]
            wanted = np.concatenate([np.broadcast_to(wanted, (*lead, length)), q[..., length:]], axis=-1)
        else:
            _check_fit(robot, q, v, reference)
    error = difference(q, wanted)
    if error.shape[-1:] != v.shape[-1:]:
        raise InvalidArgument(
            f"difference gives shape {error.shape}, expected {v.shape}: compare configurations by the "
            "plant's own, difference=plant.difference"
        )
    rate = reference.v - v[..., :n]
    return amplified("kp", controller.kp, error[..., :n]) + amplified("kd", controller.kd, rate)


def _check_fit(robot: Any, q: Array, v: Array, reference: State) -> None:
    """Refuse a state, a reference and a model of different numbers of coordinates."""
    for name, actual, desired in (("q", q, reference.q), ("v", v, reference.v)):
        if actual.shape[-1:] != desired.shape[-1:]:
            raise InvalidArgument(f"{name} has shape {actual.shape}, the reference's has {desired.shape}")
    if robot is not None and robot.nv != v.shape[-1]:
        raise InvalidArgument(
            f"robot of the controller is {shown(robot)}, which has {robot.nv} coordinates, expected "
            f"{v.shape[-1]}, as the plant has"
        )


def amplified(name: str, gain: Any, error: Array) -> Array:
    """Return a gain times an error, shape (..., n)."""
    if not gain.ndim:
        return gain * error  # type: ignore[no-any-return]
    n = error.shape[-1]
    if gain.shape not in ((n,), (n, n)):
        gain_matrix(name, gain, n)
    if gain.ndim == 1:
        return gain * error  # type: ignore[no-any-return]
    # Not as a matrix product, whose rounding hangs on the processor.
    columns = [gain[:, k] * error[..., k, None] for k in range(n)]
    return np.asarray(sum(columns[1:], columns[0]))


_BASE = 3  # coordinates of the base: x, y, psi


class Gravity(Protocol):
    """What `PDGravity` needs of a robot."""

    @property
    def nv(self) -> int:
        """Size of v."""

    def gravity(self, q: ArrayLike) -> Array:
        """Return g(q)."""

    def difference(self, q0: Array, q1: Array, /) -> Array:
        """Return the displacement from q0 to q1, shape (..., nv)."""


@final
@dataclass(frozen=True, eq=False)
class PDGravity:
    """PD with gravity compensation, tau = Kp e + Kd e_dot + g(q) (Takegaki and Arimoto, 1981).

    It comes to rest at a reference that does: there is nothing left but g.

    Parameters
    ----------
    robot : MobileRobot
        The model whose gravity is compensated; it need not be the one that is simulated.
    kp, kd : array_like, shape (), (n,) or (n, n)
        Gains as in `PD`: [N/m] and [N s/m] for a way, [N m/rad] and [N m s/rad] for an angle.
    difference : callable
        ``difference(q0, q1)``: the displacement from q0 to q1; by default the robot's own.

    Raises
    ------
    InvalidArgument
        If a gain has another shape or is not finite.
    """

    robot: Gravity
    kp: ArrayLike
    kd: ArrayLike
    difference: Difference | None = None

    parameters: ClassVar[tuple[Parameter, ...]] = GAINS

    def __post_init__(self) -> None:
        check_arms(self, "gravity")

    def initial_state(self, context: Context) -> None:
        """Return None: there is no memory."""

    def __call__(self, t: float, q: Array, v: Array, reference: State, state: None) -> tuple[Array, None]:
        """Return the generalised force, shape (..., n), and None."""
        return feedback(self, own_difference(self, self.robot), q, v, reference) + self.robot.gravity(q), None


def check_arms(controller: ModelFeedback, needs: str) -> None:
    """Check gains and robot of a controller of base and arms that is being made, and refuse wheels.

    Raises
    ------
    InvalidArgument
        If one is not what is expected.
    """
    check_robot(controller, needs)
    if max(leading_of(controller.robot)) < controller.robot.nv:
        raise InvalidArgument(
            f"robot is {shown(controller.robot)}, which has wheels, expected "
            f"Allocated({type(controller).__name__}"
            "(robot.robot, ...), robot)"
        )
    check_gains(controller, controller.robot.nv)
