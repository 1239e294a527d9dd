"""Computed torque with integral action."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike
from pinmobile.controllers.controller import InverseDynamics, State
from pinmobile.controllers.feedback import gain_parameters
from pinmobile.controllers.held import check_held, double_integrator
from pinmobile.controllers.tracking_errors import check_model, each_coordinate
from pinmobile.errors import InvalidArgument
from pinmobile.plant import Context, Difference, Parameter


@final
@dataclass(frozen=True, eq=False)
class ComputedTorquePID:
    """Computed torque with an integral, tau = M(q) (a_d + kd e' + kp e + ki z) + n(q, v), z' = e.

    The integral takes away the error that a constant force, or a wrong mass on a steady path, leaves. While
    any force that is applied is another than the law's, as where a limit holds, nothing is integrated.

    Parameters
    ----------
    robot : MobileRobot
        The model that the controller believes in; it need not be the one that is simulated.
    kp, ki, kd : array_like, shape () or (n,)
        Gains [1/s^2], [1/s^3] and [1/s], each >= 0, ki < kp kd; by default three poles at -4 1/s.
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

    parameters: ClassVar[tuple[Parameter, ...]] = (
        *gain_parameters("kp", "1/s^2"),
        *gain_parameters("ki", "1/s^3"),
        *gain_parameters("kd", "1/s"),
    )

    def __post_init__(self) -> None:
        n = check_model(self.robot, self.difference, "inverse_dynamics")
        kp, ki, kd = (each_coordinate(name, getattr(self, name), n) for name in ("kp", "ki", "kd"))
        if not ((ki < kp * kd) | (ki == 0)).all():
            raise InvalidArgument(f"ki is {ki.tolist()}, expected < kp kd = {(kp * kd).tolist()}")
        for name, gain in (("kp", kp), ("ki", ki), ("kd", kd)):
            object.__setattr__(self, name, gain)

    def initial_state(self, context: Context) -> tuple[Any, Any, Any, float]:
        """Return the integral, what it gained last, the last force, and the time between samples."""
        names = ("kp", "kd", "ki")

        def gains() -> dict[str, Array]:
            return {name: np.asarray(getattr(self, name)) for name in names}

        check_held(gains, lambda dt: double_integrator(dt, **gains()), context.dt)
        none = np.zeros(self.robot.nv)
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
        robot: Any = self.robot
        error = (self.difference or robot.difference)(q, reference.q)
        rate = np.subtract(reference.v, v)
        command = reference.a + self.kd * rate + self.kp * error + self.ki * integral
        tau = robot.inverse_dynamics(q, v, command)
        gain = dt * error
        return tau, (integral + gain, gain, tau, dt)
