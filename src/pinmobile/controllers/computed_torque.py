"""Computed torque: by the model of a robot, with an integral, or of base and arms apart."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike
from pinmobile.controllers.controller import InverseDynamics, State
from pinmobile.controllers.feedback import (
    GAINS,
    amplified,
    check_arms,
    check_gains,
    check_robot,
    feedback,
    gain_matrix,
    gain_parameters,
    own_difference,
)
from pinmobile.controllers.held import check_held, double_integrators
from pinmobile.controllers.tracking_errors import check_model
from pinmobile.plant import Context, Difference, Parameter, leading_of

_BASE = 3  # coordinates of the base: x, y, psi


@final
@dataclass(frozen=True, eq=False)
class ComputedTorque:
    """Computed torque, tau = M(q) (a_d + Kd e_dot + Kp e) + n(q, v) (lecture, section 4).

    Of a robot on wheels that moves in every direction, the torques of least norm with which body and arms
    accelerate so; its reference is of these.

    Parameters
    ----------
    robot : MobileRobot or WheeledRobot
        The model that the controller believes in; it need not be the one that is simulated.
    kp, kd : array_like, shape (), (n,) or (n, n)
        Gains [1/s^2] and [1/s]: a scalar, one per coordinate, or a matrix; n is 3 and one for each degree of
        freedom of the arms.
    difference : callable
        ``difference(q0, q1)``: the displacement from q0 to q1; by default the robot's own. The lecture's is
        `plain_difference`.

    Raises
    ------
    InvalidArgument
        If a gain has another shape or is not finite, or no torques move the robot in every direction.
    """

    robot: InverseDynamics
    kp: ArrayLike = 4
    kd: ArrayLike = 4
    difference: Difference | None = None

    parameters: ClassVar[tuple[Parameter, ...]] = GAINS

    def __post_init__(self) -> None:
        check_robot(self, "inverse_dynamics")
        if hasattr(self.robot, "check_inverse_dynamics"):
            self.robot.check_inverse_dynamics()
        check_gains(self, max(leading_of(self.robot)))

    def initial_state(self, context: Context) -> None:
        """Return None: there is no memory."""

    def __call__(self, t: float, q: Array, v: Array, reference: State, state: None) -> tuple[Array, None]:
        """Return the generalised force, shape (..., n), and None."""
        command = reference.a + feedback(self, own_difference(self, self.robot), q, v, reference)
        return self.robot.inverse_dynamics(q, v, command), None


@final
@dataclass(frozen=True, eq=False)
class PID:
    """Computed torque with an integral, tau = M(q) (a_d + kd e' + kp e + ki z) + n(q, v), z' = e.

    The integral takes away the error that a constant force, or a wrong mass on a steady path, leaves. While
    any force that is applied is another than the law's, as where a limit holds, nothing is integrated.

    Parameters
    ----------
    robot : MobileRobot
        The model that the controller believes in; it need not be the one that is simulated.
    kp, ki, kd : array_like, shape (), (n,) or (n, n)
        Gains [1/s^2], [1/s^3] and [1/s]; by default three poles at -4 1/s. Stable where ki < kp kd.
    difference : callable
        ``difference(q0, q1)``: the displacement from q0 to q1; by default the robot's own.

    Raises
    ------
    InvalidArgument
        If an argument is something else; at the start of a run, if the loop is unstable at its dt.
    """

    robot: InverseDynamics
    kp: ArrayLike = 48.0
    ki: ArrayLike = 64.0
    kd: ArrayLike = 12.0
    difference: Difference | None = None

    parameters: ClassVar[tuple[Parameter, ...]] = (*GAINS, *gain_parameters("ki", "1/s^3"))

    def __post_init__(self) -> None:
        check_gains(self, check_model(self.robot, self.difference, "inverse_dynamics"), "ki")

    def initial_state(self, context: Context) -> tuple[Any, Any, Any, float]:
        """Return the integral, what it gained last, the last force, and the time between samples."""
        n = self.robot.nv

        def gains() -> dict[str, Array]:
            return {name: np.asarray(getattr(self, name), np.float64) for name in ("kp", "kd", "ki")}

        def loop(dt: float) -> Array:
            return double_integrators(dt, **{name: gain_matrix(name, x, n) for name, x in gains().items()})

        check_held(gains, loop, context.dt)
        none = np.zeros(n)
        return none, none, none, float(context.dt)

    def applied(self, u: Array, state: tuple[Any, Any, Any, float]) -> tuple[Any, Any, Any, float]:
        """Return the state, the integral as it was where another force is applied."""
        integral, gain, asked, dt = state
        differs = np.max(np.abs(u - asked), axis=-1, keepdims=True) > 0
        return integral - np.where(differs, gain, 0.0), gain, asked, dt

    def signals(self, state: tuple[Any, Any, Any, float]) -> dict[str, Any]:
        """Return the integral of the error."""
        return {"integral": ("m s, rad s", state[0])}

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any, Any, float]
    ) -> tuple[Array, tuple[Any, Any, Any, float]]:
        """Return the generalised force, shape (..., n), and the next state."""
        integral, _, _, dt = state
        difference = own_difference(self, self.robot)
        command = reference.a + feedback(self, difference, q, v, reference)
        command = command + amplified("ki", self.ki, integral)
        tau = self.robot.inverse_dynamics(q, v, command)
        gain = dt * difference(q, reference.q)
        return tau, (integral + gain, gain, tau, dt)


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

    parameters: ClassVar[tuple[Parameter, ...]] = GAINS

    def __post_init__(self) -> None:
        check_arms(self, "inverse_dynamics")

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
