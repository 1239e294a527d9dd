"""Controllers of a base with arms that know less than computed torque: gravity alone, or no coupling."""

from dataclasses import dataclass, field
from typing import Any, ClassVar, Protocol, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike
from pinmobile.controllers.feedback import (
    GAINS,
    Compact,
    check_gains,
    check_robot,
    compacted,
    feedback,
    own_difference,
)
from pinmobile.controllers.protocol import InverseDynamics, State
from pinmobile.plant import Context, Difference, Parameter

__all__ = ["Decoupled", "Gravity", "PDGravity"]

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
        _check(self, "gravity")

    def initial_state(self, context: Context) -> None:
        """Return None: there is no memory."""

    def compact(self, plant: Any) -> Compact | None:
        """Return its compact form, where there is one: for loops."""
        return compacted(self, plant, "gravity")

    def __call__(self, t: float, q: Array, v: Array, reference: State, state: None) -> tuple[Array, None]:
        """Return the generalised force, shape (..., n), and None."""
        return feedback(self, own_difference(self, self.robot), q, v, reference) + self.robot.gravity(q), None


@final
@dataclass(frozen=True, eq=False)
class Decoupled:
    """Computed torque of the base and of the arms, each ignoring that the other moves.

    The base sees the arms as a load that is locked where they are, as `MobileRobot.lumped` has it; the arms
    see themselves on a base at rest, gravity included. With c = a_d + Kd e_dot + Kp e, parted into base and
    arms,

        tau_base = M_bb(q) c_b + n_b(q, (v_b, 0)),      tau_arm = M_aa(q) c_a + n_a(q, (0, v_a)).

    What `ComputedTorque` has beyond that is the coupling: M_ba, M_ab, and the products of v_b and v_a.

    Parameters
    ----------
    robot : MobileRobot
        The model that the controller believes in; it need not be the one that is simulated.
    kp, kd : array_like, shape (), (n,) or (n, n)
        Gains [1/s^2] and [1/s]: a scalar, one per coordinate, or a matrix.
    difference : callable
        ``difference(q0, q1)``: the displacement from q0 to q1; by default the robot's own.

    Raises
    ------
    InvalidArgument
        If a gain has another shape or is not finite.
    """

    robot: InverseDynamics
    kp: ArrayLike = 4
    kd: ArrayLike = 4
    difference: Difference | None = None
    kinds: tuple[int, int] = field(init=False, repr=False)

    parameters: ClassVar[tuple[Parameter, ...]] = GAINS

    def __post_init__(self) -> None:
        _check(self, "inverse_dynamics")

    def initial_state(self, context: Context) -> None:
        """Return None: there is no memory."""

    def __call__(self, t: float, q: Array, v: Array, reference: State, state: None) -> tuple[Array, None]:
        """Return the generalised force, shape (..., n), and None."""
        command = reference.a + feedback(self, own_difference(self, self.robot), q, v, reference)
        base = self.robot.inverse_dynamics(q, *map(_of_base, (v, command)))
        arms = self.robot.inverse_dynamics(q, *map(_of_arms, (v, command)))
        return np.concatenate([base[..., :_BASE], arms[..., _BASE:]], axis=-1), None


def _of_base(rate: Array) -> Array:
    part = np.zeros(rate.shape)
    part[..., :_BASE] = rate[..., :_BASE]
    return part


def _of_arms(rate: Array) -> Array:
    part = np.zeros(rate.shape)
    part[..., _BASE:] = rate[..., _BASE:]
    return part


def _check(controller: PDGravity | Decoupled, needs: str) -> None:
    check_robot(controller, needs)
    check_gains(controller, controller.robot.nv)
