"""`OdometryFeedback`: a controller that knows the pose from what its wheels turned alone."""

from __future__ import annotations

from functools import cached_property
from typing import Any, final

import numpy as np

from pinmobile.arrays import Array
from pinmobile.controllers import Controller, State, answer_of, check_controller, told
from pinmobile.errors import InvalidArgument
from pinmobile.parts import child, integer, number, part
from pinmobile.plant import Context
from pinmobile.robot import ZERO, scalars, vector_of as stacked
from pinmobile.signals import signals_of
from pinmobile.wheels._kinematics import Kinematics
from pinmobile.wheels._table import WheelTable


@final
@part
class OdometryFeedback:
    """A controller that is told the pose that its wheels' encoders lead to, instead of the true one.

    It starts at the true pose. From sample to sample encoders tell how far each wheel has turned; the body's
    displacement is the one that fits all wheels best, tyres not moving sideways, by least squares of the
    table that it believes; along the heading half way. Velocities are displacements over the time between
    samples. Angles of arms and steering axes are known. What the table has wrong, wheels that slip and coarse
    encoders make the pose drift: the signal ``believed_pose``, beside the true one.

    Parameters
    ----------
    controller : controller
        What is wrapped.
    table : WheelTable
        What it believes: the robot's wheels, by name, with numbers that may differ.
    ticks : float, optional
        Of an encoder per turn of its wheel, > 0; by default it is exact.
    noise : float
        Standard deviation of each wheel's measured rate, >= 0 [rad/s]; white.
    seed : int
        Of the noise.

    Raises
    ------
    InvalidArgument
        If an argument is something else, or the wheels do not tell how the body moves.
    """

    controller: Any = child(Controller)
    table: WheelTable = child(WheelTable, expected="a WheelTable")
    ticks: float | None = number(
        default=None, above=0, optional=True, fixed=True, doc="ticks of an encoder per turn"
    )
    noise: float = number(default=0.0, lower=0, unit="rad/s", doc="deviation of measured wheel rates")
    seed: int = integer(default=0, doc="seed of the noise")

    def check(self) -> None:
        """Raise `InvalidArgument` where rates of the wheels do not tell how the body moves."""
        check_controller(self.controller)
        ns = len(self.table.axes)
        rows = self._kinematics.rows([ZERO] * ns, [ZERO] * 3, [ZERO] * (ns + len(self.table)))
        if np.linalg.matrix_rank(np.array([[float(x) for x in row.base] for row in rows])) < 3:
            raise InvalidArgument(
                "table does not tell by its wheels' rates how the body moves, expected rows of rank 3"
            )

    @cached_property
    def _kinematics(self) -> Kinematics:
        return Kinematics.of(self.table)

    def initial_state(self, context: Context) -> tuple[Any, ...]:
        """Return the wrapped controller's state, the noise, the sampling time, and that nothing is known."""
        names = tuple(one.name for one in context.coordinates)[-len(self.table) :]
        if context.coordinates and names != self.table.names:
            own, plants = ", ".join(self.table.names), ", ".join(names)
            raise InvalidArgument(f"table has the wheels {own}, expected those of the plant: {plants}")
        joints = np.zeros(len(self.table.axes) + len(self.table))
        noise = context.noise(f"odometry {self.seed}", len(self.table))
        inner = self.controller.initial_state(context)
        return inner, noise, float(context.dt), (np.zeros(3), joints, 0.0)

    def applied(self, u: Array, state: Any) -> Any:
        """Return the state, with the wrapped controller told of the input that is applied, (..., nu)."""
        return told(self.controller, u, state[0]), *state[1:]

    def signals(self, state: Any) -> dict[str, Any]:
        """Return the pose that it believes, beside what the wrapped controller tells."""
        return {**signals_of(self.controller, state[0]), "believed_pose": ("m, rad", state[3][0])}

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: Any
    ) -> tuple[Array, tuple[Any, ...]]:
        """Return the input, shape (..., nu), and the next state."""
        inner, noise, dt, (pose, before, known) = state
        ns, nw = len(self.table.axes), len(self.table)
        n = ns + nw
        steering, wheels = q[..., -n : np.shape(q)[-1] - nw], q[..., -nw:]
        if self.ticks is not None:
            tick = 2 * np.pi / self.ticks
            wheels = tick * np.rint(wheels / tick)
        numbers, noise = noise.draw()
        now = np.concatenate([steering, wheels], axis=-1)
        begun = np.asarray(known)[..., None]
        pose, before = pose + (1.0 - begun) * q[..., :3], before + (1.0 - begun) * now
        turned = now - before
        disturbed = np.concatenate([0.0 * steering, self.noise * (numbers * dt)], axis=-1) + turned
        rates = begun * disturbed / dt + (1.0 - begun) * v[..., -n:]
        moved = self._displacement((now[..., :ns] + before[..., :ns]) / 2, begun * disturbed)
        along = pose[..., 2] + moved[..., 2] / 2
        c, s = np.cos(along), np.sin(along)
        step = [c * moved[..., 0] - s * moved[..., 1], s * moved[..., 0] + c * moved[..., 1], moved[..., 2]]
        pose = pose + np.stack(step, axis=-1)
        twist, c, s = self._displacement(steering, rates), np.cos(pose[..., 2]), np.sin(pose[..., 2])
        speeds = [c * twist[..., 0] - s * twist[..., 1], s * twist[..., 0] + c * twist[..., 1], twist[..., 2]]
        seen_q = np.concatenate([pose, q[..., 3:-n], now], axis=-1)
        seen_v = np.concatenate([np.stack(speeds, axis=-1), v[..., 3:-n], rates], axis=-1)
        u, inner = answer_of(self.controller, t, seen_q, seen_v, reference, inner)
        return u, (inner, noise, dt, (pose, now, 1.0 + 0.0 * known))

    def _displacement(self, steering: Any, joints: Any) -> Any:
        """Return the body's displacement, or twist, that fits those of its joints best, shape (..., 3)."""
        return stacked(self._kinematics.odometry(scalars(steering), scalars(joints)), joints)
