"""`Platform`: a robot and the wheels under it, whatever the ground."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
import pinocchio as pin

from pinmobile.arrays import (
    Array,
    ArrayLike,
    broadcast,
    finite,
    finite_answer,
    frozen,
    in_numbers,
    shaped,
    vector,
)
from pinmobile.errors import InvalidArgument
from pinmobile.parts import also_symbols, holds_symbols, structure
from pinmobile.plant import Coordinate, Input
from pinmobile.robot import BODY_JOINT, LOCKED, MobileRobot, Mount, hull, number
from pinmobile.wheels.description import joint_signs, wheel_name
from pinmobile.wheels.drawn import Picture
from pinmobile.wheels.kinematics import Mobility
from pinmobile.wheels.rows import column
from pinmobile.wheels.table import FIXED, WheelTable
from pinmobile.wheels.tree import Constraints

_SAME_LINE = 1e-6  # [m]


class Platform:
    """Abstract base: coordinates and inputs of a robot on wheels, its rows, and how it looks.

    Its maker sets `robot`, the whole with wheels locked at their table angles, and `table`, its wheels.
    """

    robot: MobileRobot
    table: WheelTable
    array_dynamics: Any

    @cached_property
    def _is_symbolic(self) -> bool:
        return holds_symbols(self)

    @structure
    def mobility(self) -> Mobility:
        """What the wheels let it do."""
        return Mobility.of(self.table)

    def _check_rolls(self) -> None:
        if not self.mobility.is_regular:
            raise InvalidArgument(f"robot cannot roll without slip: {self.mobility.why_not}")

    @structure
    def _places(self) -> Array:
        """Where it touches the ground at steering angles zero, wheels and then supports, shape (k, 2) [m]."""
        places = [wheel.centre for wheel in self.table.wheels]
        return frozen([*places, *((each.x, each.y) for each in self.table.supports)])

    @structure
    def _has_area(self) -> bool:
        ones = np.ones((len(self._places), 1))
        return bool(np.linalg.matrix_rank(np.hstack([ones, self._places]), tol=_SAME_LINE) == 3)

    def check_area(self) -> None:
        """Refuse a robot that stands on one line.

        Raises
        ------
        InvalidArgument
            If it does.
        """
        if not self._has_area:
            raise InvalidArgument(
                f"table has {len(self._places)} places where the robot stands, on one line, expected three "
                "that are not: give supports=[(x, y), ...], where casters stand"
            )

    @structure
    def grounded(self) -> bool:
        """Whether the body's origin is known to lie on the ground; if not, nothing is known of its loads."""
        return self.robot.grounded

    @structure
    def footprint(self) -> Array | None:
        """Corners of what it stands on, wheels at steering angles zero and supports, shape (k, 2) [m].

        Counter-clockwise, in the body's frame; None where they are on one line.
        """
        corners = hull(self._places) if self._has_area else None
        return None if corners is None else frozen(corners)

    @property
    def source(self) -> str:
        """Where its numbers come from, in words."""
        locked, turns = self.robot.locked_joints, dict(zip(self.table.names, self.table.wheels, strict=True))
        moving = set[str]()
        for joint in self.robot.undercarriage.wheels:
            if wheel := turns.get(wheel_name(joint.name)):
                moving |= {joint.name, *(each.name for each in joint.swivels if wheel.steering != FIXED)}
        held = ", ".join(name for name in locked if name not in moving)
        words = self.robot.source.replace(f"; {LOCKED}", "")
        words = words.replace(f"; locked at rest: {', '.join(locked)}", held and f"; locked at rest: {held}")
        return f"{words}; {self.table.source}"

    @property
    def joint_signs(self) -> Mapping[str, int]:
        """Of each wheel of its file 1, or -1 where the joint there turns the other way."""
        return MappingProxyType(joint_signs(self.robot, self.table))

    @structure
    def _rows(self) -> Constraints:
        """The rows of its wheels, and their kinematics."""
        return Constraints(self.table, self.robot.nv)

    @cached_property
    def _joints(self) -> int:
        return len(self.table.axes) + len(self.table)

    # Sizes and names

    @structure
    def nq(self) -> int:
        """Size of q."""
        return self.nv

    @structure
    def nv(self) -> int:
        """Size of v and a."""
        return self.robot.nv + self._joints

    @structure
    def nu(self) -> int:
        """Size of the input."""
        return self.robot.nv - BODY_JOINT + len(self.table.actuators)

    @structure
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Each of the nv numbers of q: body, arms, steering axes, wheels."""
        axes = [Coordinate(axis.name, "rad", -axis.limit, axis.limit) for axis in self.table.axes]
        return (*self.robot.coordinates, *axes, *(Coordinate(name, "rad") for name in self.table.names))

    @structure
    def inputs(self) -> tuple[Input, ...]:
        """Each of the nu numbers of an input: the arms' joints, then the actuators in the table's order."""
        own = (
            Input(actuator.name, "N m", -actuator.motor.largest_torque, actuator.motor.largest_torque)
            for actuator in self.table.actuators
        )
        return (*self.robot.inputs[BODY_JOINT:], *own)

    @structure
    def leading(self) -> Mapping[int, int]:
        """How many numbers of q the first n coordinates have, for each n that a reference may have."""
        return self.robot.leading

    # Numbers

    @cached_property
    def x(self) -> Any:
        """Where the wheels' pivots stand, forward, shape (wheels,) [m]."""
        return column([wheel.x for wheel in self.table.wheels])

    @cached_property
    def y(self) -> Any:
        """Where the wheels' pivots stand, to the left, shape (wheels,) [m]."""
        return column([wheel.y for wheel in self.table.wheels])

    @cached_property
    def radius(self) -> Any:
        """Of the wheels, shape (wheels,) [m]."""
        return column([wheel.radius for wheel in self.table.wheels])

    @cached_property
    def spin_inertia(self) -> Any:
        """Of the wheels about their axles, shape (wheels,) [kg m^2]."""
        return column([wheel.spin_inertia for wheel in self.table.wheels])

    # Configurations

    def _q(self, q: ArrayLike, name: str = "q") -> Array:
        return vector(name, q, self.nq)

    def _v(self, name: str, value: ArrayLike) -> Array:
        return vector(name, value, self.nv)

    def _f(self, f: ArrayLike) -> Array:
        """Check generalised forces beside the input, 0 for none."""
        array = finite("f", f)
        return array if array.ndim == 0 and not array else self._v("f", array)

    def _of_axes(self, name: str, value: ArrayLike) -> Array:
        """Check numbers of the steering axes, none for zeros."""
        array, n = finite(name, value), len(self.table.axes)
        return np.zeros(n) if array.shape == (0,) else vector(name, array, n)

    @structure
    def rest(self) -> Array:
        """Configuration at the origin, arms in their reference posture, shape (nq,)."""
        return frozen(np.append(self.robot.rest, np.zeros(self._joints)))

    @also_symbols
    def integrate(self, q: ArrayLike, dq: ArrayLike) -> Array:
        """Return the configuration q + dq, shape (..., nq)."""
        q, dq = self._q(q), self._v("dq", dq)
        broadcast(q=q, dq=dq)
        with np.errstate(over="ignore"):
            return finite_answer(q + dq, q=q, dq=dq)

    @also_symbols
    def difference(self, q0: ArrayLike, q1: ArrayLike) -> Array:
        """Return the displacement q1 - q0, shape (..., nv); psi and continuous joints in (-pi, pi]."""
        q0, q1 = self._q(q0, "q0"), self._q(q1, "q1")
        broadcast(q0=q0, q1=q1)
        n = self.robot.nq
        own = self.robot.difference(q0[..., :n], q1[..., :n])
        with np.errstate(over="ignore"):
            return np.concatenate([own, finite_answer(q1[..., n:] - q0[..., n:], q0=q0, q1=q1)], axis=-1)

    @also_symbols
    def pose(self, q: ArrayLike) -> Array:
        """Return x, y and psi of the body, shape (..., 3) [m, m, rad]."""
        return self._q(q)[..., :BODY_JOINT].copy()

    @also_symbols
    def rate(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return the rates of x, y and psi of the body, shape (..., 3) [m/s, m/s, rad/s]."""
        q, v = self._q(q), self._v("v", v)
        return np.array(np.broadcast_to(v[..., :BODY_JOINT], (*broadcast(q=q, v=v), BODY_JOINT)))

    @also_symbols
    def effort(self, q: ArrayLike, wrench: ArrayLike) -> Array:
        """Return the generalised force of a wrench on the body, shape (..., nv) [N, N, N m, ...]."""
        q, wrench = self._q(q), vector("wrench", wrench, BODY_JOINT)
        whole = np.zeros((*broadcast(q=q, wrench=wrench), self.nv))
        whole[..., :BODY_JOINT] = wrench
        return whole

    # What is seen

    @property
    def mounts(self) -> tuple[Mount, ...]:
        """Its arms."""
        return self.robot.mounts

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, width and height of the body [m]."""
        return self.robot.size  # type: ignore[no-any-return]

    @cached_property
    def _picture(self) -> Picture:
        return Picture(self.robot, self.table)

    @property
    def visual_model(self) -> pin.GeometryModel:
        """What is drawn, a copy: the robot's own visuals, and wheels and supports beside those that it has.

        Wheels have spokes, a bar across the tread, or the rollers of the table; a box stands above them.
        """
        return self._picture.visuals.clone()

    @in_numbers
    def drawing(self, q: ArrayLike) -> Array:
        """Return where the objects of `visual_model` are in the inertial frame, shape (..., k, 4, 4)."""
        return self._picture.placements(self._q(q))

    # Rows and rates

    @in_numbers
    def constraint_matrix(self, q: ArrayLike) -> Array:
        """Return A(q), shape (..., k, nv): A v = 0 where the wheels roll; see `constraint_names`."""
        q = self._q(q)
        return self._rows.at(q, np.zeros(self.nv))[0]

    @in_numbers
    def constraint_drift(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return dA/dt v, shape (..., k) [m/s^2]: A a = -dA/dt v keeps rolling."""
        q, v = self._q(q), self._v("v", v)
        broadcast(q=q, v=v)
        return self._rows.at(q, v)[1]

    @property
    def constraint_names(self) -> tuple[str, ...]:
        """Of each row of `constraint_matrix` its wheel and direction, such as ``"left rolling"``."""
        return self._rows.names

    @structure
    def _input_matrix(self) -> Array:
        arms = self.robot.nv - BODY_JOINT
        B = np.zeros((self.nv, self.nu))
        B[BODY_JOINT : self.robot.nv, :arms] = np.eye(arms)
        for k, actuator in enumerate(self.table.actuators):
            B[self.robot.nv :, arms + k] = actuator.column
        return frozen(B)

    @property
    def input_matrix(self) -> Array:
        """B, shape (nv, nu): the generalised force of an input is B u."""
        return self._input_matrix

    @also_symbols
    @in_numbers
    def wheel_rates(self, twist: ArrayLike, steering: ArrayLike = (), turning: ArrayLike = ()) -> Array:
        """Return the rates of the wheels that roll at a body twist, shape (..., wheels) [rad/s].

        Parameters
        ----------
        twist : array_like, shape (..., 3)
            Forward, left, yaw rate [m/s, m/s, rad/s].
        steering, turning : array_like, shape (..., axes), optional
            Steering angles and their rates; by default zero [rad, rad/s].
        """
        twist = vector("twist", twist, BODY_JOINT)
        angles, turns = self._of_axes("steering", steering), self._of_axes("turning", turning)
        lead = broadcast(twist=twist, steering=angles, turning=turns)
        parts = (list(np.moveaxis(x, -1, 0)) for x in (angles, twist, turns))
        rates = map(number, self._rows.kinematics.wheel_rates(*parts))
        return np.stack([np.broadcast_to(rate, lead) for rate in rates], axis=-1)

    @also_symbols
    @in_numbers
    def odometry(self, rates: ArrayLike, steering: ArrayLike = (), turning: ArrayLike = ()) -> Array:
        """Return the body twist that fits measured rates of the wheels best, shape (..., 3) [m/s, rad/s].

        The least squares of all rows, in which tyres do not move sideways.

        Parameters
        ----------
        rates : array_like, shape (..., wheels)
            Of the wheels [rad/s].
        steering, turning : array_like, shape (..., axes), optional
            Steering angles and their rates; by default zero [rad, rad/s].
        """
        rates, n = vector("rates", rates, len(self.table)), len(self.table.axes)
        angles, turns = self._of_axes("steering", steering), self._of_axes("turning", turning)
        lead = broadcast(rates=rates, steering=angles, turning=turns)
        q = np.zeros((*lead, self.nq))
        q[..., self.robot.nq : self.robot.nq + n] = angles
        A = self.constraint_matrix(q)
        joints = np.concatenate(
            [np.broadcast_to(turns, (*lead, n)), np.broadcast_to(rates, (*lead, len(self.table)))], axis=-1
        )
        known = np.einsum("...ij,...j->...i", A[..., self.robot.nv :], joints)
        return np.asarray(-np.linalg.pinv(A[..., :BODY_JOINT]) @ known[..., None])[..., 0]

    @cached_property
    def axle(self) -> Any:
        """Coefficients of the body twist in the velocity across the fixed wheels, shape (3,).

        Raises
        ------
        InvalidArgument
            If no wheel is fixed and keeps the body from moving across it.
        """
        choice = self.mobility.choice
        if not (choice.body and choice.is_fixed):
            raise InvalidArgument(f"robot is {self.mobility.kind}, which has no fixed axle")
        self._check_rolls()
        return self.array_dynamics.axle if self._is_symbolic else self._rows.base_of(choice.body[0])

    @in_numbers
    def lateral_velocity(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return how fast fixed wheels would slide sideways if the body moved so, shape (...) [m/s].

        Parameters
        ----------
        q, v : array_like, shape (..., n), (..., m), n and m >= 3
            Pose of the body and its rates, and whatever follows.

        Raises
        ------
        InvalidArgument
            If there is no fixed axle.
        """
        q, v = finite("q", q), finite("v", v)
        for name, array in (("q", q), ("v", v)):
            shaped(name, array, ("...", f"n>={BODY_JOINT}"))
        broadcast(q=q, v=v)
        c, s, (a, b, arm) = np.cos(q[..., 2]), np.sin(q[..., 2]), self.axle
        return np.asarray((a * c - b * s) * v[..., 0] + (a * s + b * c) * v[..., 1] + arm * v[..., 2])
