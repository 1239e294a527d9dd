"""`Rolling`: ground on which wheels roll without slip, level or on a ramp, its dynamics, and odometry."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from math import cos, pi, sin
from typing import Any, ClassVar, Protocol, final

import numpy as np

from pinmobile.arrays import Array, bounded, frozen, rotate, scalar
from pinmobile.compiled import choose
from pinmobile.controllers import Controller, State as ControlState, Wrapper, evaluate
from pinmobile.errors import InvalidArgument
from pinmobile.parts import by_value, child, integer, number as declared, part
from pinmobile.plant import Context
from pinmobile.robot import (
    ZERO,
    Matrix,
    Vector,
    applied,
    dot,
    factor,
    number,
    scalars,
    transpose,
    vector_of as stacked,
)
from pinmobile.signals import signals_of
from pinmobile.wheels._dynamics import State, WheeledDynamics, mass_columns
from pinmobile.wheels._kinematics import Kinematics
from pinmobile.wheels._loads import AxleGroup, groups_of
from pinmobile.wheels._table import WheelTable

_BASE = 3
_REDUNDANT = 1e-10  # relative tolerance of singular values of redundant rows
_RESTING = 1e-9  # [rad/s]: tolerance of the rate of an axis at its stop


class Ground(Protocol):
    """A ground with dynamics(wheeled), such as Rolling() or Coulomb().

    It supplies the dynamics of a robot on it: a `WheeledDynamics` with ``forward_dynamics(q, v, u, f)``, or
    with ``initial_state(context)`` and ``step(t, q, v, u, h, f, memory)``. The robot also has the optional
    methods of these dynamics, such as ``signals`` or ``project``. Their attribute ``slips`` is False if the
    wheels roll without slip; then the constraints are those of `WheeledRobot`. A ground may also have:

    - ``check_robot(wheeled)``, which raises an error for robots that cannot stand on it;
    - ``ramp``, a `Ramp` or None.
    """

    def dynamics(self, wheeled: Any, /) -> Any:
        """Return the dynamics of a `WheeledRobot` on this ground, for numbers, arrays or symbols."""


@final
@part
@by_value
class Ramp:
    """Inclined plane; x, y and psi of a robot on it are measured in the plane.

    Parameters
    ----------
    angle : float
        Inclination of the plane, in [0, pi / 2) [rad].
    direction : float
        Direction of steepest ascent from the inertial x axis [rad].

    Raises
    ------
    InvalidArgument
        If a number is not finite or not in its range.

    See Also
    --------
    Rolling : ground without slip
    Coulomb : ground with dry friction
    WheeledRobot : its method `on_ramp`

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.wheels import Ramp
    >>> ramp = Ramp(angle=np.radians(30))
    >>> ramp.fall(9.81).round(3) + 0.0  # [m/s^2]
    array([-4.905,  0.   , -8.496])
    """

    angle: float = declared(unit="rad", lower=0, fixed=True, doc="inclination of the plane")
    direction: float = declared(default=0.0, unit="rad", fixed=True, doc="direction of steepest ascent")

    def check(self) -> None:
        """Raise `InvalidArgument` if the plane is vertical or steeper."""
        bounded("angle", self.angle, below=pi / 2, unit="rad")

    def fall(self, g: float) -> Array:
        """Return gravity along the axes of the plane, shape (3,) [m/s^2].

        Parameters
        ----------
        g : float
            Gravity on level ground [m/s^2].
        """
        g = scalar("g", g)
        slope = -g * sin(self.angle)
        return frozen([slope * cos(self.direction), slope * sin(self.direction), -g * cos(self.angle)])


@final
@part
@by_value
class Rolling:
    """Ground on which wheels roll without slip, whatever force this needs: constraints of the velocities.

    Parameters
    ----------
    ramp : Ramp, optional
        Inclination of the ground; None: level ground.

    Attributes
    ----------
    slips : bool
        Whether wheels may slip, here False.

    Raises
    ------
    InvalidArgument
        If `ramp` is of another kind; in a robot, if its wheels cannot roll without slip.

    See Also
    --------
    Coulomb : ground with dry friction
    WheeledRobot : robot on a ground
    wheels.Ramp : inclination

    Examples
    --------
    >>> from pinmobile import MobileRobot, Rolling, WheeledRobot
    >>> from pinmobile import WheelTable
    >>> table = WheelTable.differential(0.4, 0.1, spin_inertia=0.01)
    >>> body = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> robot = WheeledRobot(body, table, Rolling())
    >>> still = 0 * robot.rest
    >>> a = robot.forward_dynamics(robot.rest, still, u=[3.0, 3.0])
    >>> print(f"{a[0]:.3f} m/s^2")  # 60 N / (30 kg + 2 kg)
    1.875 m/s^2
    """

    ramp: Ramp | None = child(Ramp, default=None, expected="a Ramp(angle, direction) or None")
    slips: ClassVar[bool] = False

    def dynamics(self, wheeled: Any) -> RollingDynamics:
        """Return the dynamics of a robot on this ground.

        Parameters
        ----------
        wheeled : WheeledRobot
            The robot.
        """
        return RollingDynamics(wheeled, wheeled.robot.array_dynamics)

    def check_robot(self, wheeled: Any) -> None:
        """Check that a robot can roll without slip.

        Parameters
        ----------
        wheeled : WheeledRobot
            The robot.

        Raises
        ------
        InvalidArgument
            If its wheels cannot roll, or a free steering axis has no inertia.
        """
        mobility = wheeled.mobility
        mobility.check_rolls("table", "; expected ground=Coulomb()")
        check_inertias(wheeled, mobility.choice.free)


def check_inertias(wheeled: Any, joints: Iterable[int]) -> None:
    """Raise `InvalidArgument` for unconstrained steering axes and wheels without inertia."""
    table = wheeled.table
    names = (*(axis.name for axis in table.axes), *table.names)
    for k in joints:
        if not wheeled.joint_inertias[k] > 0:
            raise InvalidArgument(
                f"{names[k]} of the table has no inertia, expected spin_inertia, and yaw_inertia to steer"
            )


@final
@dataclass(frozen=True, eq=False)
class RollingDynamics(WheeledDynamics):
    """Dynamics of a robot whose wheels roll without slip, without input validation."""

    slips: ClassVar[bool] = False

    @cached_property
    def groups(self) -> tuple[AxleGroup, ...]:
        """Wheels, alone or together, whose lateral force is determined; none for drives with gear trains."""
        return groups_of(self)

    def forward_dynamics(self, q: Any, v: Any, u: Any, f: Any = 0.0) -> Any:
        """Return a = S nu' + gamma, S' M S nu' = S' (tau - n - M gamma), shape (..., nv)."""
        state = self.state(q, v)
        M, (S, gamma) = self.inertia(state, q), self.null_space(state)
        force = self.input_force(state, u, f)
        effects = self.effects(state, q)
        proper_a = self.proper_acceleration(state, gamma)
        rest = [t - n - dot(row, proper_a) for t, n, row in zip(force, effects, M, strict=True)]
        solve, first = _solver(mass_columns(M, S), S), self.of_body
        rates = solve(applied(transpose(S), rest))
        for k, limit in self.stops:
            outward = stop_of(state.steering[k], limit, state.rates[k])
            change = dot(S[first + k], rates) + gamma[first + k]
            rates = stop_axis(rates, outward, change, S[first + k], solve(S[first + k]))
        return self.in_plane(state, [dot(row, rates) + g for row, g in zip(S, gamma, strict=True)], q)

    def constraint_forces(self, q: Array, v: Array, u: Array, f: Any = 0.0) -> Array:
        """Return the forces of the ground along all rows, shape (..., k), with least norm."""
        state, A_T = self.state(q, v), np.swapaxes(self.constraints(q, v)[0], -1, -2)
        rest = self.left(q, v, self.forward_dynamics(q, v, u, f))
        rest = rest - self.in_plane(state, self.input_force(state, u, f), q)
        return np.asarray(np.linalg.pinv(A_T, rcond=_REDUNDANT) @ rest[..., None])[..., 0]

    def project(self, q: Any, v: Any) -> Any:
        """Return the nearest rolling velocity in the mass metric, shape (..., nv).

        It is S (nu + x): nu follows from the velocity, and x corrects it for the rest, which contains only
        wheels and the body's lateral motion: S' M S x = S' M (v - S nu).
        """
        state = self.state(q, v)
        S, _ = self.null_space(state)
        rates = self.velocities(state)
        residual = self._slip_residual(state, S, rates)
        # Many robots start at rest, where the mass matrix is not needed.
        if not all(x is ZERO or (isinstance(x, float | np.ndarray) and not np.any(x)) for x in residual):
            MS = mass_columns(self.inertia(state, q), S)
            change = _solver(MS, S)(applied(MS, residual))
            rates = [x + y for x, y in zip(rates, change, strict=True)]
        for k, limit in self.stops:
            row, outward = S[self.of_body + k], stop_of(state.steering[k], limit)
            response = _solver(mass_columns(self.inertia(state, q), S), S)(row)
            rates = stop_axis(rates, outward, dot(row, rates), row, response)
        return self.in_plane(state, [dot(row, rates) for row in S], q)

    def _slip_residual(self, state: State, S: Matrix, nu: Vector) -> Vector:
        """Return v - S nu along the body's axes; it is zero for each coordinate in nu."""
        indices, first = self.choice.body, self.of_body
        residual: Vector = [ZERO] * self.nv
        if len(indices) == 1:
            a = self.rows(state)[indices[0]].base
            slip = dot(a, state.twist)
            residual[:2] = [a[0] * slip, a[1] * slip]
        elif indices:
            residual[:_BASE] = [x - dot(row, nu) for x, row in zip(state.twist, S[:_BASE], strict=True)]
        for joint, _ in self.choice.joints:
            residual[first + joint] = state.rates[joint] - dot(S[first + joint], nu)
        return residual


def stop_of(angle: Any, limit: float, rate: Any = 0.0) -> Any:
    """Return 1 or -1, the outward direction at a steering stop that the angle has reached, or 0."""
    angle, rate = number(angle), number(rate)
    side = choose(angle >= limit, 1.0, choose(angle <= -limit, -1.0, 0.0))
    return choose(side * rate >= -_RESTING, side, 0.0)


def stop_axis(values: Vector, outward: Any, rate: Any, row: Vector, response: Vector) -> Vector:
    """Return velocities or accelerations without the outward motion of an axis at its stop.

    Parameters
    ----------
    values : list of scalars
        Independent velocities or accelerations, or all.
    outward : scalar
        Result of `stop_of`.
    rate : scalar
        Rate of the axis.
    row, response : list of scalars
        Rate of the axis per value, and values per impulse on the axis.
    """
    size = choose(outward * number(rate) > 0.0, number(rate) / number(dot(row, response)), 0.0)
    return [number(x - y * size) for x, y in zip(values, response, strict=True)]


def _solver(MS: Matrix, S: Matrix) -> Callable[[Vector], Vector]:
    """Return the solver of S' M S x = right, given S' M."""
    return factor([applied(MS, column) for column in transpose(S)])[0]


@final
@part
class OdometryFeedback(Wrapper):
    """Wrapper that replaces the measured pose with the pose of wheel odometry.

    It starts at the true pose. Encoders measure the rotation of each wheel between samples. The displacement
    of the body is the least-squares fit of all wheels, without lateral motion of tyres, by the wheel table of
    the wrapper; it is applied along the mean heading of the sample. Velocities are displacements divided by
    the time step. Angles of arms and steering axes are measured. Wrong numbers in the table, slip and coarse
    encoders make the pose drift. The signal ``believed_pose`` records the estimate beside the true pose.

    Parameters
    ----------
    controller : controller
        Wrapped controller.
    table : WheelTable
        Assumed wheels: those of the robot by name, with numbers that may differ.
    ticks : float, optional
        Encoder ticks per turn of a wheel, > 0; default: exact angles.
    noise : float
        Standard deviation of each wheel's measured rate, >= 0 [rad/s]; white.
    seed : int
        Seed of the noise.

    Raises
    ------
    InvalidArgument
        If an argument is of another kind or out of range, or the wheels do not determine the body's motion;
        at the start of a run, if the table has other wheels than the plant.

    See Also
    --------
    MeasurementNoise : noise of the measured state
    WheeledRobot : its method `odometry`

    Examples
    --------
    >>> from pinmobile import Backstepping, Circle, MobileRobot
    >>> from pinmobile import Tangent, UnicycleTracking, WheeledRobot
    >>> from pinmobile import WheelTable, simulate
    >>> from pinmobile.wheels import OdometryFeedback
    >>> table = WheelTable.differential(0.4, 0.1, spin_inertia=0.01)
    >>> worn = WheelTable.differential(0.4, 0.099, spin_inertia=0.01)
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), table)
    >>> law = Backstepping(UnicycleTracking(), robot)
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=2.0))
    >>> law = OdometryFeedback(law, worn)
    >>> run = simulate(robot, law, path, dt=0.1)
    >>> print(f"{1e3 * run.max_error()[0]:.0f} mm of 0.6 m")
    6 mm of 0.6 m
    """

    controller: Any = child(Controller)
    table: WheelTable = child(WheelTable, expected="a WheelTable")
    ticks: float | None = declared(default=None, above=0, fixed=True, doc="encoder ticks per turn of a wheel")
    noise: float = declared(default=0.0, lower=0, unit="rad/s", doc="standard deviation of wheel rates")
    seed: int = integer(default=0, doc="seed of the noise")

    def check(self) -> None:
        """Raise `InvalidArgument` if the wheels do not determine the body's motion."""
        Wrapper.check(self)
        self.table.mobility.check_odometry()

    @cached_property
    def _kinematics(self) -> Kinematics:
        """Rolling constraints of the assumed wheels."""
        return Kinematics.of(self.table)

    def initial_state(self, context: Context) -> tuple[Any, ...]:
        """Return the wrapped controller's state, the noise, the time step, and the odometry's memory."""
        names = tuple(axis.name for axis in context.coordinates)[-len(self.table) :]
        if context.coordinates and names != self.table.names:
            wheels, plants = ", ".join(self.table.names), ", ".join(names)
            raise InvalidArgument(f"table has the wheels {wheels}, expected those of the plant: {plants}")
        joints = np.zeros(len(self.table.axes) + len(self.table))
        noise = context.noise(f"odometry {self.seed}", len(self.table))
        inner = self.controller.initial_state(context)
        return inner, noise, float(context.dt), (np.zeros(3), joints, 0.0)

    def signals(self, state: Any) -> dict[str, Any]:
        """Return the estimated pose [m, rad] beside the signals of the wrapped controller."""
        return {**signals_of(self.controller, state[0]), "believed_pose": ("m, rad", state[3][0])}

    def __call__(
        self, t: float, q: Array, v: Array, reference: ControlState, state: Any
    ) -> tuple[Array, tuple[Any, ...]]:
        """Return the input, shape (..., nu), and the next state."""
        inner, noise, dt, (pose, angles, known) = state
        ns, nw = len(self.table.axes), len(self.table)
        n = ns + nw
        steering, wheels = q[..., -n : np.shape(q)[-1] - nw], q[..., -nw:]
        if self.ticks is not None:
            tick = 2 * np.pi / self.ticks
            wheels = tick * np.rint(wheels / tick)
        numbers, noise = noise.draw()
        joints = np.concatenate([steering, wheels], axis=-1)
        started = np.asarray(known)[..., None]
        pose, angles = pose + (1.0 - started) * q[..., :3], angles + (1.0 - started) * joints
        turns = joints - angles
        noisy = np.concatenate([0.0 * steering, self.noise * (numbers * dt)], axis=-1) + turns
        rates = started * noisy / dt + (1.0 - started) * v[..., -n:]
        motion = self._displacement((joints[..., :ns] + angles[..., :ns]) / 2, started * noisy)
        middle = pose[..., 2] + motion[..., 2] / 2
        pose = pose + rotate(np.cos(middle), np.sin(middle), motion)
        psi = pose[..., 2]
        speeds = rotate(np.cos(psi), np.sin(psi), self._displacement(steering, rates))
        seen_q = np.concatenate([pose, q[..., 3:-n], joints], axis=-1)
        seen_v = np.concatenate([speeds, v[..., 3:-n], rates], axis=-1)
        u, inner = evaluate(self.controller, t, seen_q, seen_v, reference, inner)
        return u, (inner, noise, dt, (pose, joints, 1.0 + 0.0 * known))

    def _displacement(self, steering: Any, joints: Any) -> Any:
        """Return the least-squares displacement, or twist, of the body, shape (..., 3)."""
        return stacked(self._kinematics.odometry(scalars(steering), scalars(joints)), joints)
