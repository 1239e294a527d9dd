"""Feedback of the error in configuration and velocity: PD, computed torque, and between them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, ClassVar, NamedTuple, Protocol, final

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


class Compact(NamedTuple):
    """A law of feedback as a loop may compute it without a call: one matrix product, and one call of a robot.

    Attributes
    ----------
    gains : ndarray, shape (n, 2 n)
        Of (e, e_dot).
    turning : tuple of int
        Coordinates whose error is on the circle.
    inverse_dynamics : callable, optional
        Of the command, a_d added, where the law has one: ``inverse_dynamics(q, v, command)``.
    gravity : callable, optional
        What is added where the law has one: ``gravity(q)``.
    """

    gains: Array
    turning: tuple[int, ...]
    inverse_dynamics: Callable[[Array, Array, Array], Array] | None = None
    gravity: Callable[[Array], Array] | None = None


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

    @property
    def kinds(self) -> tuple[int, ...]:
        """Of each gain 0 where it is a number, 1 of each coordinate, 2 a matrix."""


class ModelFeedback(Feedback, Protocol):
    """One with a model of the robot."""

    @property
    def robot(self) -> Any:
        """The model that the controller believes in."""


def compacted(controller: Feedback, plant: Plant, call: str) -> Compact | None:
    """Return the compact form of a controller with `kp` and `kd`; None where configurations do not subtract.

    Parameters
    ----------
    controller : controller
        Whose law it is.
    plant : plant
        For whose configurations.
    call : str
        Which of its robot's unchecked calls it makes; "" for none.
    """
    difference, n = own_difference(controller, plant), plant.nv
    owner = getattr(difference, "__self__", None)
    bound = getattr(owner, "difference", None) == difference
    turning = getattr(owner if bound else difference, "turning", None)
    robot = getattr(controller, "robot", None)
    sizes = [each.nv for each in (robot, owner if bound else None) if each is not None]
    if turning is None or any(size != n for size in sizes):
        return None
    gains = np.hstack([gain_matrix(name, getattr(controller, name), n) for name in ("kp", "kd")])
    if not call:
        return Compact(gains, turning)
    if robot is None or not (hasattr(robot, "calls") and getattr(robot, "adds", False)):
        return None
    return Compact(gains, turning, **{call: getattr(robot.calls(), call)})


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
    kinds: tuple[int, int] = field(init=False, repr=False)

    parameters: ClassVar[tuple[Parameter, ...]] = GAINS

    def __post_init__(self) -> None:
        check_gains(self, None)

    def initial_state(self, context: Context) -> Difference:
        """Return the difference of configurations, by default the plant's."""
        return own_difference(self, context)

    def compact(self, plant: Plant) -> Compact | None:
        """Return its compact form, where there is one: for loops."""
        return compacted(self, plant, "")

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
    # What a gain is for one robot: 0 a number, 1 one for each coordinate, 2 a matrix; many have leading axes.
    object.__setattr__(controller, "kinds", tuple(np.ndim(getattr(controller, name)) for name in names))
    if controller.difference is not None:
        check_difference(controller.difference)


def feedback(controller: Feedback, difference: Difference, q: Array, v: Array, reference: State) -> Array:
    """Return Kp e + Kd e_dot of a controller that has `kp` and `kd`, shape (..., n).

    Raises
    ------
    InvalidArgument
        If state, reference and gains do not fit together.
    """
    robot = getattr(controller, "robot", None)
    n = np.shape(reference.v)[-1]
    if n < np.shape(v)[-1] and robot is not None and n == max(leading_of(robot)):  # wheels have no reference
        lead, length = np.shape(q)[:-1], np.shape(reference.q)[-1]
        whole = np.concatenate([np.broadcast_to(reference.q, (*lead, length)), q[..., length:]], axis=-1)
        error, rate = difference(q, whole)[..., :n], reference.v - v[..., :n]
        return _sum(controller, error, rate)
    for name, actual, desired in (("q", q, reference.q), ("v", v, reference.v)):
        if actual.shape[-1:] != desired.shape[-1:]:
            raise InvalidArgument(f"{name} has shape {actual.shape}, the reference's has {desired.shape}")
    if robot is not None and robot.nv != v.shape[-1]:
        raise InvalidArgument(
            f"robot of the controller is {shown(robot)}, which has {robot.nv} coordinates, expected "
            f"{v.shape[-1]}, as the plant has"
        )
    error, rate = difference(q, reference.q), np.subtract(reference.v, v)
    if error.shape[-1:] != rate.shape[-1:]:
        raise InvalidArgument(
            f"difference gives shape {error.shape}, expected {rate.shape}: compare configurations by the "
            "plant's own, difference=plant.difference"
        )
    return _sum(controller, error, rate)


def _sum(controller: Feedback, error: Array, rate: Array) -> Array:
    kinds = controller.kinds
    return amplified("kp", controller.kp, kinds[0], error) + amplified("kd", controller.kd, kinds[1], rate)


def amplified(name: str, given: ArrayLike, kind: int, error: Array) -> Array:
    """Return a gain times an error, shape (..., n); before the axes of its kind, the gain may have others."""
    n, gain = error.shape[-1], np.asarray(given)
    if gain.shape[gain.ndim - kind :] not in ((), (n,), (n, n)):
        gain_matrix(name, gain, n)
    if kind == 2:
        # Not as a matrix product, whose rounding depends on how many states there are.
        columns = [gain[..., k] * error[..., k, None] for k in range(n)]
        return np.asarray(sum(columns[1:], columns[0]))
    return np.asarray((gain[..., None] if not kind and gain.ndim else gain) * error)


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
    kinds: tuple[int, int] = field(init=False, repr=False)

    parameters: ClassVar[tuple[Parameter, ...]] = GAINS

    def __post_init__(self) -> None:
        check_arms(self, "gravity")

    def initial_state(self, context: Context) -> None:
        """Return None: there is no memory."""

    def compact(self, plant: Plant) -> Compact | None:
        """Return its compact form, where there is one: for loops."""
        return compacted(self, plant, "gravity")

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
