"""Torques, or commands, with which a robot on wheels moves as a kinematic law says."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from pinmobile.arrays import Array, callable_as, frozen, wrap_angle
from pinmobile.controllers.controller import State, check_wheels
from pinmobile.controllers.kinematic_laws import (
    LAW,
    Changing,
    KinematicLaw,
    Tracked,
    angle as heading_of,
    arctan,
    chosen,
    cos,
    rate_of,
    sin,
    value_of,
)
from pinmobile.errors import InvalidArgument, NotTraceable, shown
from pinmobile.parts import Commanded, Rolling, able, child, number, part, structure
from pinmobile.plant import Context

_BASE = 3
_SIDEWAYS = 1e-6  # [m/s], and relative to the speed: what a reference may move across the axle
_JUMP = 0.1  # [rad], by which a heading may turn from sample to sample beside what its rate says
_LEAST_SPEED = 1e-3  # [m/s] of a steered wheel, below which its direction is that of this speed
_NO_AXLE = 1e-9  # beside the square of what two axles determine
_KINDS = ((2, 0), (1, 1))


@final
@part
class Backstepping:
    """From a kinematic law to the input (Fierro and Lewis, J. Robotic Systems 14(3), 1997).

        M nu' + n = B u,   nu' = nu_c' + k (nu_c - nu)

    nu are the independent velocities of a robot whose wheels roll: of one with a fixed axle alone its speed
    and yaw rate, of a car its speed and steering rate; arms have theirs. nu_c is what the law says, nu_c' its
    rate by the chain rule. A car steers to delta_c, for which a wheel rolls as the law says, with

        delta_c' + steer (delta_c - delta)    as the rate that is wanted,

    whose own rate takes of delta_c'' what the reference has, from its last two samples. Arms follow their
    reference as v_r + arms (q_r - q).

    The reference is the pose of the body, and moves along the wheels of the fixed axle: a path of the body's
    origin with its tangent as heading where the origin lies on the axle. One that moves sideways or whose
    heading jumps is refused, with its time, when a loop begins; where each robot of an ensemble has a
    reference of its own, they are not looked at.

    Parameters
    ----------
    law : kinematic law
        Such as `UnicycleTracking`; what it needs of a reference is said there.
    robot : WheeledRobot or VelocityRobot
        The model that the controller believes in; of one that takes speeds the input is commands.
    k, steer, arms : float
        Gains of the velocities, of the steering angle and of the arms, > 0 [1/s]; with the torque held
        between samples, k dt below 0.5.

    Raises
    ------
    InvalidArgument
        If an argument is something else, the drive has no fixed axle or can move in every direction, or it
        has not a motor for each independent velocity.
    """

    law: Any = child(KinematicLaw, doc="kinematic law", expected=LAW)
    robot: Any = child(Rolling, doc="model of the controller")
    k: float = number(default=10.0, above=0.0, unit="1/s", doc="gain of the velocities")
    steer: float = number(default=10.0, above=0.0, unit="1/s", doc="gain of the steering angle")
    arms: float = number(default=2.0, above=0.0, unit="1/s", doc="gain of the arms")

    def check(self) -> None:
        """Raise `InvalidArgument` where the drive has no fixed axle, or too few motors."""
        callable_as("law(tracked, state)", self.law)
        mobility = self.robot.mobility
        if not has_axle(mobility):
            others = {(3, 0): "ComputedTorque(robot)", (1, 2): "SwerveTracking(robot)"}
            kind = mobility.mobility, mobility.steerability
            other = others.get(kind, "ControlAllocation(controller, robot)")
            if not mobility.is_regular:
                other = "WheelSpeed(law, robot, kp), where no wheel steers"
            raise InvalidArgument(
                f"robot is {mobility.kind}, expected one with a fixed axle: for this one, {other}"
            )
        check_wheels(self.robot)

    @structure
    def _n(self) -> int:
        """Coordinates that a reference has: x, y, psi and those of arms."""
        return int(max(self.robot.reference_sizes))

    @structure
    def _steers(self) -> tuple[float, Array] | None:
        """Largest angle of the one wheel that steers [rad], and where it is; None of a fixed axle alone."""
        robot = self.robot
        if not robot.mobility.steerability:
            return None
        return min(float(robot.coordinates[self._n].upper), np.pi / 2 - 1e-3), frozen(robot.pivots[0])

    @structure
    def _axle(self) -> Array:
        """The axle of the robot as it is given, which references follow."""
        return frozen(self.robot.axle)

    def initial_state(self, context: Context) -> tuple[Any, Any]:
        """Return the law's state, and what is known of the reference's steering: nothing."""
        reference = reference_of(context)
        if reference is not None:
            self._check_reference(np.asarray(context.t), reference)
        steering = None if self._steers is None else (0.0, 0.0, float(context.dt))
        return self.law.initial_state(context), steering

    def _check_reference(self, t: Array, reference: Any) -> None:
        """Refuse a reference that the wheels cannot follow."""
        if reference.v.shape[-1] != self._n:
            raise InvalidArgument(
                f"reference has {reference.v.shape[-1]} coordinates, expected {self._n}: x, y, psi and "
                "those of arms"
            )
        speed, w = speeds_along(self._axle, t, reference)
        if self._steers is not None:
            limit, pivot = self._steers
            angle = np.abs(_steering_angle(self._axle, pivot, speed, w))
            if (angle > limit).any():
                k = int(np.argmax(angle > limit))
                raise InvalidArgument(
                    f"reference turns so tightly that wheels are steered by {angle[k]:.3g} rad at t = "
                    f"{t[k]:g} s, expected at most {limit:.3g} rad"
                )
        self.law.check(t, speed, w)

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any]
    ) -> tuple[Array, tuple[Any, Any]]:
        """Return the input, shape (..., nu), and the next state."""
        inner, steering = state
        nu, n = self.robot.independent(q, v), self._n
        known, errors = tracked(self.robot, self.robot.axle, q, v, reference, nu[..., 0])
        (speed, yaw_rate), inner = self.law(known, inner)
        wanted = [speed] if self._steers else [speed, yaw_rate]
        for i in range(_BASE, n):
            rate, desired = reference.v[..., i] - v[..., i], reference.v[..., i]
            wanted.append(
                Changing(desired + self.arms * errors[..., i], reference.a[..., i] + self.arms * rate)
            )
        if self._steers:
            turn, steering = self._steered(q, nu, known, (speed, yaw_rate), steering)
            wanted.append(turn)
        rates = [rate_of(z) + self.k * (value_of(z) - nu[..., i]) for i, z in enumerate(wanted)]
        wanted_rates = np.stack(np.broadcast_arrays(*rates), axis=-1)
        commanded = able(self.robot, Commanded)
        inverse = commanded.commands if commanded else self.robot.torques
        return inverse(q, v, wanted_rates), (inner, steering)

    def _steered(
        self, q: Array, nu: Array, tracked: Tracked, command: tuple[Any, Any], memory: tuple[Any, Any, Any]
    ) -> tuple[Changing, tuple[Any, Any, Any]]:
        """Return the steering rate that is wanted, with its own, and what is known of the reference's."""
        before, known, dt = memory
        limit, _ = self._steers or (np.inf, None)
        angle = q[..., self._n]
        found = self._angle(*command)
        beyond = np.abs(found.value) > limit
        found = chosen(beyond, np.sign(found.value) * limit, found)
        rate = self._angle(tracked.speed, tracked.yaw_rate).rate
        grown = known * (rate - before) / dt
        wanted = found.rate + self.steer * (found.value - angle)
        turn = Changing(wanted, grown + self.steer * (found.rate - nu[..., -1]))
        return turn, (rate, 1.0 + 0.0 * known, dt)

    def _angle(self, speed: Any, yaw_rate: Any) -> Any:
        return _steering_angle(self.robot.axle, self.robot.pivots[..., 0, :], speed, yaw_rate)


def has_axle(mobility: Any) -> bool:
    """Return whether a drive has one fixed axle, along whose wheels alone it can move."""
    return (mobility.mobility, mobility.steerability) in _KINDS


def reference_of(context: Context) -> Any:
    """Return the reference of all samples; None where each robot has its own, or the context has none."""
    try:
        return context.reference
    except NotTraceable:
        return None


def check_heading(t: Array, reference: Any) -> tuple[Array, Array]:
    """Refuse a reference whose heading jumps, and return its headings and yaw rates, shape (N,)."""
    psi, w = reference.q[:, 2], reference.v[:, 2]
    jumps = np.abs(wrap_angle(np.diff(psi) - np.diff(t) * (w[1:] + w[:-1]) / 2))
    if len(jumps) and jumps.max() > _JUMP:
        k = int(np.argmax(jumps > _JUMP))
        raise InvalidArgument(
            f"reference turns its heading by {jumps[k]:.3g} rad at once at t = {t[k + 1]:g} s, "
            "expected one that "
            "the wheels can follow, such as Tangent(path, turn_time=...)"
        )
    return psi, w


@final
@part
class SwerveTracking:
    """Follow a pose with two modules that steer and drive, by torques at both.

    The body twist that is wanted is that of the reference with feedback of the pose, u = R' v_r + kp e; each
    module turns to where that takes it, or to the opposite, whichever is nearer, as `Backstepping` steers a
    car; the drive is the share of u that the angles as they are allow. It needs a reference that keeps each
    module moving, where both axles do not lie on one line; a module slower than `least` keeps its angle.

    Parameters
    ----------
    robot : WheeledRobot
        The model that the controller believes in: two modules, without arms.
    kp, k, steer : float
        Gains of the pose, of the velocities and of the steering angles, > 0 [1/s].
    least : float
        Speed of a module below which it keeps its angle, > 0 [m/s].

    Raises
    ------
    InvalidArgument
        If an argument is something else, or the robot another drive.
    """

    robot: Any = child(Rolling, doc="model of the controller")
    kp: float = number(default=2.0, above=0.0, unit="1/s", doc="gain of the pose")
    k: float = number(default=10.0, above=0.0, unit="1/s", doc="gain of the velocities")
    steer: float = number(default=10.0, above=0.0, unit="1/s", doc="gain of the steering angles")
    least: float = number(
        default=0.05, above=0.0, unit="m/s", doc="speed of a module below which it keeps its angle"
    )

    def check(self) -> None:
        """Raise `InvalidArgument` where the robot is another drive."""
        robot = self.robot
        if not isinstance(robot.nv, int):
            raise InvalidArgument(f"robot is {shown(robot)}, expected a WheeledRobot")
        kind = robot.mobility.mobility, robot.mobility.steerability
        if kind != (1, 2) or max(robot.reference_sizes) > _BASE or len(robot.inputs) != 4:
            raise InvalidArgument(
                f"robot is {robot.mobility.kind} with {len(robot.inputs)} inputs, expected two modules "
                "that steer and drive, without arms"
            )
        check_wheels(robot)

    def initial_state(self, context: Context) -> tuple[Any, float, float]:
        """Return what is known of the reference's steering rates, nothing, and the sampling time."""
        reference = reference_of(context)
        if reference is not None:
            check_heading(np.asarray(context.t), reference)
        return np.zeros(2), 0.0, float(context.dt)

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any, Any]
    ) -> tuple[Array, tuple[Any, Any, Any]]:
        """Return the input, shape (..., 4), and the next state."""
        before, known, dt = state
        nu = self.robot.independent(q, v)
        wanted = self._wanted(q, v, reference)
        own = self._turned(reference)
        rates, grown, axles = [], [], []
        for i in range(2):
            x, y, zero = (self.robot.pivots[..., i, j] for j in range(3))
            angle, turning = q[..., _BASE + i], nu[..., 1 + i]
            along, aside = wanted[0] - wanted[2] * y, wanted[1] + wanted[2] * x
            target = heading_of(aside, along) - zero
            near = Changing(target.value + np.pi * np.rint((angle - target.value) / np.pi), target.rate)
            slow = value_of(along * along + aside * aside) < self.least * self.least
            goal = chosen(slow, Changing(angle, 0.0 * angle), near)
            leads = heading_of(own[1] + own[2] * x, own[0] - own[2] * y).rate
            grown.append(leads)
            extra = np.where(slow, 0.0, np.asarray(known) * (leads - before[..., i]) / dt)
            z = goal.rate + self.steer * (goal.value - angle)
            rates.append(extra + self.steer * (goal.rate - turning) + self.k * (z - turning))
            head = Changing(angle + zero, turning)
            axles.append([-sin(head), cos(head), x * cos(head) + y * sin(head)])
        (a, b, m), (d, e, f) = axles
        about = [b * f - m * e, m * d - a * f, a * e - b * d]
        square = about[0] * about[0] + about[1] * about[1] + about[2] * about[2] + _NO_AXLE
        share = (about[0] * wanted[0] + about[1] * wanted[1] + about[2] * wanted[2]) / square
        first = share.rate + self.k * (share.value - nu[..., 0])
        u = self.robot.torques(q, v, np.stack(np.broadcast_arrays(first, *rates), axis=-1))
        leads = np.stack(np.broadcast_arrays(*grown), axis=-1)
        return u, (leads, 1.0 + 0.0 * known, dt)

    def _wanted(self, q: Array, v: Array, reference: State) -> list[Changing]:
        """Return the body twist that is wanted, with its rate."""
        lead, length = np.shape(q)[:-1], np.shape(reference.q)[-1]
        whole = np.concatenate([np.broadcast_to(reference.q, (*lead, length)), q[..., length:]], axis=-1)
        errors, w = self.robot.difference(q, whole), v[..., 2]
        ahead, aside = _along(q, errors)
        (vx, vy), (rx, ry), (ax, ay) = (_along(q, x) for x in (v, reference.v, reference.a))
        w_r = reference.v[..., 2]
        return [
            Changing(rx, ax + w * ry) + self.kp * Changing(ahead, rx - vx + w * aside),
            Changing(ry, ay - w * rx) + self.kp * Changing(aside, ry - vy - w * ahead),
            Changing(w_r, reference.a[..., 2]) + self.kp * Changing(errors[..., 2], w_r - w),
        ]

    def _turned(self, reference: State) -> list[Changing]:
        """Return the body twist of the reference, with its rate."""
        (rx, ry), (ax, ay) = (_along(reference.q, x) for x in (reference.v, reference.a))
        w = reference.v[..., 2]
        return [Changing(rx, ax + w * ry), Changing(ry, ay - w * rx), Changing(w, reference.a[..., 2])]


def _along(q: Array, x: Array) -> tuple[Any, Any]:
    """Return the first two numbers of a vector in the plane along the body's axes."""
    c, s = np.cos(q[..., 2]), np.sin(q[..., 2])
    return c * x[..., 0] + s * x[..., 1], c * x[..., 1] - s * x[..., 0]


def speeds_along(axle: Array, t: Array, reference: Any) -> tuple[Array, Array]:
    """Return speed and yaw rate of a reference, shape (N,), of a drive with this fixed axle.

    Raises
    ------
    InvalidArgument
        If it moves sideways, or its heading jumps.
    """
    psi, w = check_heading(t, reference)
    a, b, arm = axle
    c, s = np.cos(psi), np.sin(psi)
    across = (a * c - b * s) * reference.v[:, 0] + (a * s + b * c) * reference.v[:, 1] + arm * w
    speed = (b * c + a * s) * reference.v[:, 0] + (b * s - a * c) * reference.v[:, 1]
    wrong = np.abs(across) > _SIDEWAYS * (1.0 + np.abs(speed))
    if wrong.any():
        k = int(np.argmax(wrong))
        raise InvalidArgument(
            f"reference moves sideways, at {across[k]:.3g} m/s across the fixed axle, at t = {t[k]:g} "
            "s, expected "
            "one that the wheels can follow, such as Tangent(path)"
        )
    return speed, w


def tracked(
    robot: Any, axle: Any, q: Array, v: Array, reference: State, own_speed: Any
) -> tuple[Tracked, Array]:
    """Return what a law tracks, with its rates, and the errors of all coordinates."""
    a, b, arm = axle[..., 0], axle[..., 1], axle[..., 2]
    lead, length = np.shape(q)[:-1], np.shape(reference.q)[-1]
    whole = np.concatenate([np.broadcast_to(reference.q, (*lead, length)), q[..., length:]], axis=-1)
    errors = robot.difference(q, whole)
    c, s = np.cos(q[..., 2]), np.sin(q[..., 2])
    c_r, s_r = np.cos(reference.q[..., 2]), np.sin(reference.q[..., 2])
    # Where body and reference go, and how far the axle of each is.
    x, y, x_r, y_r = b * c + a * s, b * s - a * c, b * c_r + a * s_r, b * s_r - a * c_r
    dx = reference.q[..., 0] - q[..., 0] + arm * (x_r - x)
    dy = reference.q[..., 1] - q[..., 1] + arm * (y_r - y)
    vx, vy, w_r, w = reference.v[..., 0], reference.v[..., 1], reference.v[..., 2], v[..., 2]
    speed, turn = x_r * vx + y_r * vy, errors[..., 2]
    gained = x_r * reference.a[..., 0] + y_r * reference.a[..., 1] + w_r * (x_r * vy - y_r * vx)
    ahead, aside = x * dx + y * dy, x * dy - y * dx
    found = Tracked(
        Changing(ahead, w * aside - own_speed + speed * np.cos(turn)),
        Changing(aside, speed * np.sin(turn) - w * ahead),
        Changing(turn, w_r - w),
        Changing(speed, gained),
        Changing(w_r, reference.a[..., 2]),
        Changing(gained, 0.0 * gained),
        Changing(own_speed, 0.0 * own_speed),
    )
    return found, errors


def _steering_angle(axle: Any, pivot: Any, speed: Any, yaw_rate: Any) -> Any:
    """Return the angle at which a steered wheel rolls where the axle moves so, with its rate."""
    a, b, arm = axle[..., 0], axle[..., 1], axle[..., 2]
    x, y = pivot[..., 0] - arm * b, pivot[..., 1] + arm * a  # from the axle
    c, s = np.cos(pivot[..., 2]), np.sin(pivot[..., 2])
    ahead = (b * c - a * s) * speed + (x * s - y * c) * yaw_rate
    aside = -(b * s + a * c) * speed + (x * c + y * s) * yaw_rate
    least = np.where(value_of(ahead) < 0.0, -_LEAST_SPEED, _LEAST_SPEED)
    return arctan(aside / chosen(np.abs(value_of(ahead)) < _LEAST_SPEED, least, ahead))
