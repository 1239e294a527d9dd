"""`LQR`: the linear quadratic regulator along a reference."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from pinmobile.arrays import Array, frozen
from pinmobile.controllers.controller import State
from pinmobile.controllers.tracked_model import (
    Weighted,
    check_moves,
    remembered,
    tracked_errors,
    tracked_model,
    weighting,
    whole_reference,
)
from pinmobile.errors import InvalidArgument
from pinmobile.parts import Linearized, child, number, part
from pinmobile.plant import Context


@final
@part
class LQR(Weighted):
    """The linear quadratic regulator along a reference, u = u_d + K(t) (e; e_v), with gains of each sample.

    Of the reference's input u_d, and of A and B of the model about each sample with the input held, it takes

        K_k = (R + B' P B)^-1 B' P A,   P_k = Q + A' P_{k+1} (A - B K_k),

    with P = P_{k+1} (Anderson and Moore, 1990), and after the end that of the last A and B for ever. Errors
    are of the reference's coordinates, e, and of the independent velocities, e_v: of a robot that is pushed,
    v; on wheels, those of `WheeledRobot.reduced`, such as speed and yaw rate of a differential drive. To
    first order, nothing makes the sum of e' Q e + du' R du smaller. The gains follow from the reference, and
    are the same for all robots of a compiled ensemble: one that spreads ``input_weight`` or the
    controller's model runs them one after another.

    Parameters
    ----------
    robot : MobileRobot or WheeledRobot
        The model that the controller believes in; wheels must not steer. Of what ``by_voltage()`` returns,
        inputs are volts, and the model has the motors' back-EMF and friction.
    Q : array_like, shape (n + m,) or (n + m, n + m), optional
        Weight of the n errors of coordinates and m of velocities, positive semidefinite. By default
        400 / m^2, 100 / rad^2, and 20 and 5 of their rates.
    R : array_like, shape (nu,) or (nu, nu), optional
        Weight of the input beside the reference's, positive definite. By default 1e-3 / N^2, 2e-2 / (N m)^2,
        and of volts what the torque costs that they give at rest.
    input_weight : float
        Factor of R, > 0.

    Raises
    ------
    InvalidArgument
        If an argument is something else, or wheels steer; at the start of a run, if the reference has not all
        coordinates of body and arms, wheels cannot follow it, or it ends at rest on a drive that cannot move
        sideways, or if one of robot and plant takes volts.
    """

    robot: Any = child(Linearized, doc="model of the controller")
    Q: Any = weighting(0, "weight of the errors")
    R: Any = weighting(1, "weight of the input")
    input_weight: float = number(default=1.0, above=0.0, doc="factor of R, the weight of the input")

    def initial_state(self, context: Context) -> tuple[Any, Any, Any]:
        """Return the inputs, velocities and gains of all samples, as schedules."""
        reference = whole_reference(context, self.robot)
        Q, R = self.Q, self.input_weight * self.R
        dt, t = float(context.dt), np.asarray(context.t)

        def design() -> tuple[Array, Array, Array]:
            model = tracked_model(self.robot, reference)
            check_moves(self.robot, reference, model.nu, float(t[-1]))
            gains, _ = riccati(*model.discrete(dt), Q, R)
            return frozen(model.u), frozen(model.nu), frozen(gains)

        given = (*reference, Q, R)
        return tuple(map(context.schedule, remembered(self.robot, ("LQR", dt), given, design)))  # type: ignore[return-value]

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any, Any]
    ) -> tuple[Array, tuple[Any, Any, Any]]:
        """Return the input, shape (..., nu), and the next state."""
        (u, held), (nu, speeds), (gains, feedback) = (schedule.next() for schedule in state)
        errors = tracked_errors(self.robot, q, v, reference, nu)
        return u + np.sum(gains * errors[..., None, :], axis=-1), (held, speeds, feedback)


def riccati(A: Array, B: Array, Q: Array, R: Array, stride: int = 1) -> tuple[Array, Array]:
    """Return gains and costs to go of all samples, backward from that of the last pair for ever.

    Parameters
    ----------
    A, B : ndarray, shape (N + 1, n, n), (N + 1, n, nu)
        Of the step from each sample, which leads `stride` samples on.
    Q, R : ndarray, shape (n, n), (nu, nu)
        Weights.
    stride : int
        Samples of a step; beyond the end, the last pair stays.

    Returns
    -------
    K, P : ndarray, shape (N + 1, nu, n), (N + 1 + stride, n, n)
    """
    K, P = np.empty(B.swapaxes(-1, -2).shape), np.empty((len(A) + stride, *Q.shape))
    P[len(A) :] = last_cost(A[-1], B[-1], Q, R)
    for k in reversed(range(len(A))):
        pushed = B[k].T @ P[k + stride]
        K[k] = np.linalg.solve(R + pushed @ B[k], pushed @ A[k])
        cost = Q + A[k].T @ P[k + stride] @ (A[k] - B[k] @ K[k])
        P[k] = (cost + cost.T) / 2
    return K, P


def last_cost(A: Array, B: Array, Q: Array, R: Array) -> Array:
    """Return the cost to go of a pair that stays, by the discrete algebraic Riccati equation.

    Raises
    ------
    InvalidArgument
        If it has no solution.
    """
    from scipy.linalg import solve_discrete_are

    try:
        P = solve_discrete_are(A, B, Q, R)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise InvalidArgument(
            f"robot cannot be controlled to first order at the end of the reference: {error}; expected a "
            "motor for each degree of freedom, and Q that weighs every coordinate"
        ) from error
    return np.asarray((P + P.T) / 2)
