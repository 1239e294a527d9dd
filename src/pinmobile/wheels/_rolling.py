"""`Rolling`: ground on which wheels roll ideally, level or a ramp, and the dynamics of robots on it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from math import cos, pi, sin
from typing import Any, ClassVar, Protocol, final

import numpy as np

from pinmobile.arrays import Array, bounded, frozen, scalar
from pinmobile.compiled import choose
from pinmobile.errors import InvalidArgument
from pinmobile.parts import by_value, child, number as declared, part
from pinmobile.robot import ZERO, Matrix, Vector, applied, dot, number, solved, transposed
from pinmobile.wheels._dynamics import State, WheeledDynamics, through
from pinmobile.wheels._loads import AxleGroup, groups_of

_BASE = 3
_REDUNDANT = 1e-10  # relative, of singular values: rows that follow from others
_RESTING = 1e-9  # [rad/s], of an axis at its stop


class Ground(Protocol):
    """A ground with dynamics(wheeled), such as Rolling() or Coulomb().

    It supplies the law of a robot on it: a `WheeledDynamics` with ``forward_dynamics(q, v, u, f)``, or with
    ``initial_state(context)`` and ``step(t, q, v, u, h, f, memory)``; what else this has, such as ``signals``
    or ``project``, the robot has too; ``slips`` of this law is False where the wheels roll ideally, whose
    constraints are then those of `WheeledRobot`. A ground may have as well:

    - ``check_robot(wheeled)``, which refuses robots that it cannot carry;
    - ``ramp``, a `Ramp` or None.
    """

    def dynamics(self, wheeled: Any, /) -> Any:
        """Return the dynamics of a `WheeledRobot` on it, over numbers, arrays or symbols."""


@final
@part
@by_value
class Ramp:
    """A plane that rises; x, y and psi are then those in the plane.

    Parameters
    ----------
    angle : float
        Of the plane with the level, in [0, pi / 2) [rad].
    direction : float
        Of the way straight up, from the inertial x axis [rad].
    """

    angle: float = declared(unit="rad", lower=0, fixed=True, doc="angle of the plane with the level")
    direction: float = declared(default=0.0, unit="rad", fixed=True, doc="direction straight up")

    def check(self) -> None:
        """Raise `InvalidArgument` where it is as steep as a wall."""
        bounded("angle", self.angle, below=pi / 2, unit="rad")

    def fall(self, g: float) -> Array:
        """Return gravity along the axes of the plane, shape (3,) [m/s^2], from what it is straight down."""
        g = scalar("g", g)
        down = -g * sin(self.angle)
        return frozen([down * cos(self.direction), down * sin(self.direction), -g * cos(self.angle)])


@final
@part
@by_value
class Rolling:
    """Wheels roll without slip, whatever force that takes: constraints on the velocities.

    Parameters
    ----------
    ramp : Ramp, optional
        Which way the ground rises; None: it is level.

    Attributes
    ----------
    slips : bool
        Whether wheels may slip, here False.
    """

    ramp: Ramp | None = child(Ramp, default=None, optional=True, expected="a Ramp(angle, direction) or None")
    slips: ClassVar[bool] = False

    def dynamics(self, wheeled: Any) -> RollingDynamics:
        """Return the dynamics of a robot on it."""
        return RollingDynamics(wheeled, wheeled.robot.array_dynamics)

    def check_robot(self, wheeled: Any) -> None:
        """Refuse drives that cannot roll, and steering that nothing holds and that has no inertia."""
        mobility = wheeled.mobility
        if not mobility.is_regular:
            raise InvalidArgument(
                f"table cannot roll without slip: {mobility.rolling_obstacle}; expected a drive that can, or "
                "ground=Coulomb()"
            )
        check_inertias(wheeled, mobility.choice.free)


def check_inertias(wheeled: Any, joints: Iterable[int]) -> None:
    """Refuse steering coordinates and wheels that nothing holds and that have no inertia."""
    table = wheeled.table
    names = (*(axis.name for axis in table.axes), *table.names)
    for k in joints:
        if not wheeled.joint_inertias[k] > 0:
            raise InvalidArgument(
                f"{names[k]} of the table has no inertia about its axis, expected one > 0: give "
                "spin_inertia, and yaw_inertia of wheels that steer"
            )


@final
@dataclass(frozen=True, eq=False)
class RollingDynamics(WheeledDynamics):
    """A robot whose wheels roll ideally, unchecked."""

    slips: ClassVar[bool] = False

    @cached_property
    def groups(self) -> tuple[AxleGroup, ...]:
        """Wheels, alone or together, as their lateral forces are determined; none on gear trains."""
        return groups_of(self)

    def forward_dynamics(self, q: Any, v: Any, u: Any, f: Any = 0.0) -> Any:
        """Return a = S nu' + gamma, S' M S nu' = S' (tau - n - M gamma), shape (..., nv)."""
        state = self.state(q, v)
        M, (S, gamma) = self.inertia(state, q), self.null_space(state)
        force = self.generalised(state, u, f)
        effects = self.effects(state, q)
        felt = self.proper_acceleration(state, gamma)
        rest = [t - n - dot(row, felt) for t, n, row in zip(force, effects, M, strict=True)]
        pushed, first = through(M, S), self.of_body
        rates = _reduced(pushed, S, applied(transposed(S), rest))
        for k, limit in self.stops:
            outward = stop_of(state.steering[k], limit, state.rates[k])
            more = dot(S[first + k], rates) + gamma[first + k]
            rates = stopped(rates, outward, more, S[first + k], _reduced(pushed, S, S[first + k]))
        return self.in_plane(state, [dot(row, rates) + g for row, g in zip(S, gamma, strict=True)], q)

    def constraint_forces(self, q: Array, v: Array, u: Array, f: Any = 0.0) -> Array:
        """Return the forces of the ground along all rows, shape (..., k), the shortest that there are."""
        state, A_T = self.state(q, v), np.swapaxes(self.constraints(q, v)[0], -1, -2)
        rest = self.left(q, v, self.forward_dynamics(q, v, u, f))
        rest = rest - self.in_plane(state, self.generalised(state, u, f), q)
        return np.asarray(np.linalg.pinv(A_T, rcond=_REDUNDANT) @ rest[..., None])[..., 0]

    def project(self, q: Any, v: Any) -> Any:
        """Return the velocity that rolls and is nearest in the mass metric, shape (..., nv).

        It is S (nu + x): nu is read off the velocity, and of what is then left over, which wheels and the
        body's motion across them alone have, S' M S x = S' M (v - S nu).
        """
        state = self.state(q, v)
        S, _ = self.null_space(state)
        rates = self.velocities(state)
        off = self._off(state, S, rates)
        # Many robots that start at rest need no mass matrix.
        if not all(x is ZERO or (isinstance(x, float | np.ndarray) and not np.any(x)) for x in off):
            pushed = through(self.inertia(state, q), S)
            more = _reduced(pushed, S, applied(pushed, off))
            rates = [x + y for x, y in zip(rates, more, strict=True)]
        for k, limit in self.stops:
            row, pushed = S[self.of_body + k], through(self.inertia(state, q), S)
            rates = stopped(
                rates, stop_of(state.steering[k], limit), dot(row, rates), row, _reduced(pushed, S, row)
            )
        return self.in_plane(state, [dot(row, rates) for row in S], q)

    def _off(self, state: State, S: Matrix, nu: Vector) -> Vector:
        """Return v - S nu, along the body's axes: zero for each coordinate that is one of nu itself."""
        held, first = self.choice.body, self.of_body
        found: Vector = [ZERO] * self.nv
        if len(held) == 1:
            a = self.rows(state)[held[0]].base
            slip = dot(a, state.twist)
            found[:2] = [a[0] * slip, a[1] * slip]
        elif held:
            found[:_BASE] = [x - dot(row, nu) for x, row in zip(state.twist, S[:_BASE], strict=True)]
        for joint, _ in self.choice.joints:
            found[first + joint] = state.rates[joint] - dot(S[first + joint], nu)
        return found


def stop_of(angle: Any, limit: float, rate: Any = 0.0) -> Any:
    """Return 1 or -1, which way out is, at a steering stop that the angle has reached, and does not leave."""
    angle, rate = number(angle), number(rate)
    side = choose(angle >= limit, 1.0, choose(angle <= -limit, -1.0, 0.0))
    return choose(side * rate >= -_RESTING, side, 0.0)


def stopped(values: Vector, outward: Any, more: Any, row: Vector, response: Vector) -> Vector:
    """Return velocities or accelerations less what a stop takes from an axis that goes on outward.

    Parameters
    ----------
    values : list of scalars
        Of independent velocities, or of all.
    outward : scalar
        As of `stop_of`.
    more : scalar
        What the axis has.
    row, response : list of scalars
        The axis's rate per value, and values per impulse on the axis.
    """
    size = choose(outward * number(more) > 0.0, number(more) / number(dot(row, response)), 0.0)
    return [number(x - y * size) for x, y in zip(values, response, strict=True)]


def _reduced(through: Matrix, S: Matrix, right: Vector) -> Vector:
    """Return the solution of S' M S x = right, given S' M."""
    reduced = [applied(through, column) for column in transposed(S)]
    return solved(reduced, right, list(reversed(range(len(right)))))
