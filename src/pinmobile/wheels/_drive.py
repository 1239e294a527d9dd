"""`WheeledRobot`: a robot on driven wheels, as a plant."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from os import PathLike
from types import MappingProxyType
from typing import Any, ClassVar, Self, final

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, ArrayLike, broadcast, finite, finite_answer, frozen, shaped
from pinmobile.errors import InvalidArgument, shown
from pinmobile.integrators import rk4
from pinmobile.metrics import Metric
from pinmobile.parts import Desired, also_symbols, by_value, child, evolved, part, required, structure, takes
from pinmobile.plant import ContactLoads, Contacts, Coordinate, Input, SlipMargins
from pinmobile.robot import BODY_JOINT, LOCKED, Linearization, MobileRobot, PayloadBody, number
from pinmobile.wheels._coulomb import Coulomb
from pinmobile.wheels._dynamics import PlantOnWheels, of_ground
from pinmobile.wheels._loads import (
    Forces,
    TimeScaledMotion,
    contact_loads,
    contacts_of,
    ground_reaction,
    recorded_margins,
    rolling_margins,
)
from pinmobile.wheels._rolling import Ground, Ramp, Rolling, RollingDynamics
from pinmobile.wheels._table import WheelTable, column
from pinmobile.wheels._urdf_reader import joint_signs, read_robot, read_wheels, source_of
from pinmobile.wheels._velocities import Allocation, Reduced, followed
from pinmobile.wheels._visuals import Tyres, WheelVisuals
from pinmobile.wheels._voltage_dynamics import ByVoltage

_OFF = 1e-9  # of a start's rates, beyond which it does not roll


def _of_wheels(name: str, doc: str) -> Any:
    found = cached_property(lambda self: column([getattr(wheel, name) for wheel in self.table.wheels]))
    found.__doc__ = doc
    return found


def _of(owner: str, name: str, doc: str) -> Any:
    return property(lambda self: getattr(getattr(self, owner), name), doc=doc)


def _counted(doc: str, count: Callable[[Any], int]) -> Any:
    found = structure(count)
    found.__doc__ = doc
    return found


@final
@part
@by_value
class WheeledRobot(PlantOnWheels):
    """A robot on wheels: q = (x, y, psi, arms, steering, wheels), u = torques at arms, wheels and axes.

    All methods broadcast over leading axes, and raise `InvalidArgument` for arguments of another last axis or
    that are not finite.

    Parameters
    ----------
    robot : MobileRobot
        The whole, wheels locked at their table angles: its mass, centre of mass and inertia hold the wheels'.
    table : WheelTable
        Its wheels; by default those of the file that it was read from, see `read_wheels`.
    ground : Rolling, Coulomb or other `Ground`, optional
        What it stands on; by default `Rolling` where the drive can roll without slip, else `Coulomb`.

    Raises
    ------
    InvalidArgument
        If an argument is something else, the wheels cannot roll on such ground, or the robot without them is
        no body.
    """

    robot: MobileRobot = child(MobileRobot, expected="a MobileRobot")
    table: WheelTable = child(WheelTable, expected="a WheelTable")
    ground: Any = child(Ground)
    integrator: ClassVar[Any] = rk4  # a lower order loses the way of a turn at speed

    def __init__(self, robot: MobileRobot, table: WheelTable | None = None, ground: Any = None) -> None:
        if table is None:
            table = read_wheels(robot)
        if ground is None and isinstance(table, WheelTable):
            ground = Rolling() if table.mobility.is_regular else Coulomb()
        self.__attrs_init__(robot, table, ground)  # type: ignore[attr-defined]

    def check(self) -> None:
        """Raise `InvalidArgument` where the ground cannot carry the robot, or wheels are heavier than it."""
        if hasattr(self.ground, "check_robot"):
            self.ground.check_robot(self)
        _ = self.bare_body

    def __repr__(self) -> str:
        body = repr(self.robot).removesuffix(f" with {LOCKED}")
        return f"WheeledRobot({body}, {self.table!r}, {self.ground!r})"

    @classmethod
    def from_urdf(
        cls,
        path: str | PathLike[str],
        package_dirs: str | PathLike[str] | Sequence[str | PathLike[str]] = (),
        *,
        table: WheelTable | None = None,
        ground: Ground | None = None,
        ground_z: ArrayLike | None = None,
        **given: Any,
    ) -> Self:
        """Return the robot of a URDF on the wheels that it has; `source` says what was taken, what guessed.

        Parameters
        ----------
        path, package_dirs
            As in `MobileRobot.from_urdf`.
        table : WheelTable, optional
            Its wheels; by default those of the file.
        ground : Rolling or Coulomb, optional
            As in the class.
        ground_z : float, optional
            The ground's z in the frame of the root link [m]; by default as `MobileRobot.from_urdf` finds it,
            or where the file does not tell, below the wheels by the radii in `given`.
        **given
            What the file does not tell of its wheels, see `read_wheels`: ``radius``, ``rollers``, ``driven``,
            ``steering``, ``inertia``, ``locked``, ``supports``, ``couplings``.

        Raises
        ------
        InvalidArgument
            As `MobileRobot.from_urdf`, `read_wheels` and the class; or if both a table and `given` are there.
        """
        if table is not None and given:
            raise InvalidArgument(f"{next(iter(given))} is given with table=, expected one of the two")
        robot = read_robot(path, package_dirs, ground_z, given)
        return cls(robot, read_wheels(robot, **given) if table is None else table, ground)

    def mount(self, arm: Any, at: ArrayLike | None = None, **options: Any) -> WheeledRobot:
        """Return the robot with an arm on its body: see `MobileRobot.mount`."""
        return WheeledRobot(self.robot.mount(arm, at, **options), self.table, self.ground)

    def attach(self, load: PayloadBody, frame: str | None = None) -> WheeledRobot:
        """Return the robot with a load fixed to one of its frames: see `MobileRobot.attach`."""
        return WheeledRobot(self.robot.attach(load, frame), self.table, self.ground)

    def by_voltage(self) -> ByVoltage:
        """Return the same robot whose input is volts, one per electric motor: see `ByVoltage`."""
        return ByVoltage(self)

    def on_ramp(self, angle: float, direction: float = 0.0) -> WheeledRobot:
        """Return the robot on ground that rises.

        Parameters
        ----------
        angle, direction : float
            As of `Ramp` [rad].
        """
        if not hasattr(self.ground, "ramp"):
            raise InvalidArgument(
                f"ground is {shown(self.ground)}, which has no ramp, expected Rolling() or Coulomb()"
            )
        return WheeledRobot(self.robot, self.table, evolved(self.ground, ramp=Ramp(angle, direction)))

    # Its dynamics

    @cached_property
    def array_dynamics(self) -> Any:
        """Its dynamics on its ground, a `WheeledDynamics`, for one state, many, or symbols, unchecked."""
        return self.ground.dynamics(self)

    @cached_property
    def _numeric(self) -> Any:
        """Its dynamics of numbers, arms by Pinocchio."""
        return replace(self.array_dynamics, robot=self.robot) if self.robot.mounts else self.array_dynamics

    @cached_property
    def _rolling(self) -> Any:
        """Its dynamics of numbers on ground where it rolls."""
        self._check_rolls()
        own = self._numeric
        return RollingDynamics(self, own.robot) if own.slips else own

    x = _of_wheels("x", "Where the wheels' pivots stand, forward, shape (wheels,) [m].")
    y = _of_wheels("y", "Where the wheels' pivots stand, to the left, shape (wheels,) [m].")
    radius = _of_wheels("radius", "Of the wheels, shape (wheels,) [m].")
    spin_inertia = _of_wheels("spin_inertia", "Of the wheels about their axles, shape (wheels,) [kg m^2].")

    mu = _of("array_dynamics", "mu", "Friction of the wheels, of rollers along their axes, shape (wheels,).")

    @cached_property
    def upright(self) -> Any:
        """What the ground alone feels of a robot without arms, shape (3,) [m, kg m^2, kg m^2].

        Height of the centre of mass, and inertia xz and yz about it.
        """
        own = vars(self.robot).get("nominal")
        if own is None or own.mounts:
            return self._upright
        com, (height, xz, yz) = self.robot.com, self._upright
        z = com[2] if len(com) > 2 else 0.0
        if own.loads:
            whole, alone = own.lumped().mass, own.mass
            loads = whole * height - alone * (own.com[2] if len(own.com) > 2 else 0.0)
            z = (self.robot.mass * z + loads) / (self.robot.mass + (whole - alone))
        return column([z, xz, yz])

    @structure
    def _upright(self) -> Array:
        if self.robot.mounts:
            return frozen(np.zeros(3))
        inertia = self.robot.lumped().model.inertias[BODY_JOINT]
        return frozen([inertia.lever[2], inertia.inertia[0, 2], inertia.inertia[1, 2]])

    @structure
    def fall(self) -> Array:
        """Gravity along the axes of the plane, shape (3,) [m/s^2]."""
        g, ramp = np.array(self.robot.model.gravity.linear), getattr(self.ground, "ramp", None)
        return frozen(g) if ramp is None else ramp.fall(float(np.linalg.norm(g)))

    @structure
    def bare_body(self) -> pin.Inertia:
        """Inertia of the body without its wheels, about its origin."""
        return self.table.taken_from(pin.Inertia(self.robot.model.inertias[BODY_JOINT]))

    @structure
    def joint_inertias(self) -> Array:
        """Diagonal of M at rest, of steering axes and wheels, shape (axes + wheels,)."""
        return frozen(np.diagonal(self.mass_matrix(self.rest))[self.robot.nv :])

    # Sizes and names

    mobility = _of("table", "mobility", "What the wheels let it do.")

    def _check_rolls(self) -> None:
        if not self.mobility.is_regular:
            raise InvalidArgument(f"robot cannot roll without slip: {self.mobility.rolling_obstacle}")

    _axes = _counted("Number of steering coordinates.", lambda self: len(self.table.axes))
    _wheels = _counted("Number of wheels.", lambda self: len(self.table))
    joints = _counted("Number of steering coordinates and wheels.", lambda self: self._axes + self._wheels)
    of_body = _counted("Number of coordinates of body and arms.", lambda self: self.robot.nv)
    nq = _counted("Size of q.", lambda self: self.nv)
    nv = _counted("Size of v and a.", lambda self: self.of_body + self.joints)
    nu = _counted("Size of the input.", lambda self: self.of_body - BODY_JOINT + len(self.table.actuators))

    @structure
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Each of the nv numbers of q: body, arms, steering axes, wheels."""
        axes = [Coordinate(axis.name, "rad", -axis.limit, axis.limit) for axis in self.table.axes]
        return (*self.robot.coordinates, *axes, *(Coordinate(name, "rad") for name in self.table.names))

    @structure
    def inputs(self) -> tuple[Input, ...]:
        """Each of the nu numbers of an input: the arms' joints, then the actuators in the table's order."""
        most = ((one.name, one.motor.largest_torque) for one in self.table.actuators)
        return (*self.robot.inputs[BODY_JOINT:], *(Input(name, "N m", -x, x) for name, x in most))

    reference_sizes = _of(
        "robot", "reference_sizes", "Numbers of q, for each count of coordinates of a reference."
    )

    @structure
    def rest(self) -> Array:
        """Configuration at the origin, arms in their reference posture, shape (nq,)."""
        return frozen(np.append(self.robot.rest, np.zeros(self.joints)))

    @property
    def source(self) -> str:
        """Where its numbers come from, in words."""
        return source_of(self.robot, self.table)

    @property
    def joint_signs(self) -> Mapping[str, int]:
        """Of each wheel of its file 1, or -1 where the joint there turns the other way."""
        return MappingProxyType(joint_signs(self.robot, self.table))

    # Where it stands

    grounded = _of("robot", "grounded", "Whether the body's origin is known to lie on the ground.")
    footprint = _of("table", "footprint", "Corners of what it stands on, see `WheelTable.footprint`.")

    def check_stands(self) -> None:
        """Raise `InvalidArgument` where its height is not known, or it stands on one line."""
        if not self.grounded:
            raise InvalidArgument(
                "robot does not tell where its body's origin is above the ground, on which the loads of its "
                "wheels depend; expected one read with ground=, or ground=Rolling()"
            )
        if self.footprint is None:
            raise InvalidArgument(
                f"table has {self._wheels + len(self.table.supports)} places where the robot stands, on one "
                "line, expected three that are not: give supports=[(x, y), ...], where casters stand"
            )

    # What is seen

    mounts = _of("robot", "mounts", "Its arms.")
    size = _of("robot", "size", "Length, width and height of the body [m].")

    @cached_property
    def _picture(self) -> WheelVisuals:
        return WheelVisuals(self.robot, self.table)

    @cached_property
    def _tyres(self) -> Tyres:
        return Tyres(self.robot, self.table)

    @property
    def visual_model(self) -> pin.GeometryModel:
        """What is drawn, a copy: the robot's own visuals, and wheels and supports beside those that it has.

        Wheels have spokes, a bar across the tread, or the rollers of the table; a box stands above them.
        """
        return self._picture.visuals.clone()

    @takes(q="nq")
    def drawing(self, q: ArrayLike) -> Any:
        """Return where the objects of `visual_model` are in the inertial frame, shape (..., k, 4, 4)."""
        return self._picture.placements(np.asarray(q))

    solids = _of("_tyres", "solids", "What of it may touch something; wheels do touch the ground.")

    @takes(q="nq")
    def solid_placements(self, q: ArrayLike) -> Any:
        """Return where the shapes of `solids` are in the body's frame, shape (..., shapes, 4, 4)."""
        return self._tyres.placements(np.asarray(q))

    end_effector = _of("robot", "end_effector", "Default frame: the tip of the first arm, or the body's.")
    frame_names = _of("robot", "frame_names", "Names of the frames, see `MobileRobot.frame_names`.")

    def frame_name(self, frame: str | None = None) -> str:
        """Return the name of a frame, by default that of `end_effector`: see `MobileRobot.frame_name`."""
        return self.robot.frame_name(frame)

    @takes(q="nq")
    def frame_pose(self, q: Any, frame: str | None = None) -> Any:
        """Return T_0_f, the pose of a frame, shape (..., 4, 4): see `MobileRobot.frame_pose`."""
        return self.robot.frame_pose(q[..., : self.robot.nq], frame)

    # Configurations

    @takes(q="nq", dq="nv")
    def integrate(self, q: ArrayLike, dq: ArrayLike) -> Any:
        """Return the configuration q + dq, shape (..., nq)."""
        return self._numeric.integrate(q, dq)

    @takes(q0="nq", q1="nq")
    def difference(self, q0: ArrayLike, q1: ArrayLike) -> Any:
        """Return the displacement q1 - q0, shape (..., nv); psi and continuous joints in (-pi, pi]."""
        return self._numeric.difference(q0, q1)

    @takes(q="nq")
    def pose(self, q: ArrayLike) -> Any:
        """Return x, y and psi of the body, shape (..., 3) [m, m, rad]."""
        return self._numeric.pose(q).copy()

    @takes(q="nq", v="nv")
    def pose_rate(self, q: ArrayLike, v: ArrayLike) -> Any:
        """Return the rates of x, y and psi of the body, shape (..., 3) [m/s, m/s, rad/s]."""
        return self._numeric.pose_rate(q, v).copy()

    @takes(q="nq", wrench=3)
    def generalized_force(self, q: ArrayLike, wrench: ArrayLike) -> Any:
        """Return the generalised force of a wrench on the body, shape (..., nv) [N, N, N m, ...]."""
        return self._numeric.generalized_force(q, wrench)

    def start(self, reference: Any) -> tuple[Array, Array]:
        """Return the q and v with which a reference begins, shape (nq,) and (nv,).

        Steered wheels point to where they go, and all roll; what the reference leaves out of the arms rests.
        """
        return replace(self.array_dynamics, robot=self.robot).start(reference)  # type: ignore[no-any-return]

    @takes(q="nq", v="nv")
    def check_start(self, q: Any, v: Any) -> None:
        """Refuse a start at which wheels on one gear train turn at different rates, or those that roll slip.

        Raises
        ------
        InvalidArgument
            If it is such.
        """
        slips = np.einsum("...ij,...j->...i", self.constraint_matrix(q), v)
        largest = np.abs(finite_answer(slips, q=q, v=v)).reshape(-1, slips.shape[-1]).max(axis=0)
        for name, slip in zip(self.constraint_names, largest, strict=True):
            is_held = name == "train" or not self.array_dynamics.slips
            if is_held and slip > _OFF * (1 + float(np.abs(v).max())):
                what = "a wheel of a gear train" if name == "train" else name
                raise InvalidArgument(
                    f"start does not roll: {what} slips at {slip:.3g} m/s; expected a reference that "
                    "the wheels can follow, such as Tangent(path), v0 = robot.project(q0, v0), or v0 of zeros"
                )

    # Rows and rates

    @takes(q="nq")
    def constraint_matrix(self, q: Any) -> Any:
        """Return A(q), shape (..., k, nv): A v = 0 where the wheels roll; see `constraint_names`."""
        return self._numeric.constraints(q, np.zeros(self.nv))[0]

    @takes(q="nq", v="nv")
    def constraint_drift(self, q: Any, v: Any) -> Any:
        """Return dA/dt v, shape (..., k) [m/s^2]: A a = -dA/dt v keeps rolling."""
        return self._numeric.constraints(q, v)[1]

    @cached_property
    def constraint_names(self) -> tuple[str, ...]:
        """Of each row of `constraint_matrix` its wheel and direction, such as ``"left rolling"``."""
        names, zeros = self.table.names, [0.0] * self.joints
        rows = self._numeric.kinematics.rows(zeros, [0.0] * BODY_JOINT, zeros)
        return tuple(f"{names[row.wheel]} {row.kind}" if row.wheel >= 0 else row.kind for row in rows)

    @structure
    def input_matrix(self) -> Array:
        """B, shape (nv, nu): the generalised force of an input is B u."""
        arms = self.robot.nv - BODY_JOINT
        B = np.zeros((self.nv, self.nu))
        B[BODY_JOINT : self.robot.nv, :arms] = np.eye(arms)
        for k, actuator in enumerate(self.table.actuators):
            B[self.robot.nv :, arms + k] = actuator.column
        return frozen(B)

    @takes(twist=3, steering="_axes", turning="_axes")
    def wheel_rates(self, twist: ArrayLike, steering: ArrayLike = (), turning: ArrayLike = ()) -> Any:
        """Return the rates of the wheels that roll at a body twist, shape (..., wheels) [rad/s].

        Parameters
        ----------
        twist : array_like, shape (..., 3)
            Forward, left, yaw rate [m/s, m/s, rad/s].
        steering, turning : array_like, shape (..., axes), optional
            Steering angles and their rates; by default zero [rad, rad/s].
        """
        return self._numeric.wheel_rates(twist, steering, turning)

    @takes(rates="_wheels", steering="_axes", turning="_axes")
    def odometry(self, rates: Any, steering: ArrayLike = (), turning: ArrayLike = ()) -> Any:
        """Return the body twist that fits measured rates of the wheels best, shape (..., 3) [m/s, rad/s].

        The least squares of all rows, in which tyres do not move sideways.

        Parameters
        ----------
        rates : array_like, shape (..., wheels)
            Of the wheels [rad/s].
        steering, turning : array_like, shape (..., axes), optional
            Steering angles and their rates; by default zero [rad, rad/s].
        """
        self.mobility.check_odometry()
        return self._numeric.odometry(rates, steering, turning)

    @cached_property
    def axle(self) -> Any:
        """Coefficients of the body twist in the velocity across the fixed wheels, shape (3,).

        Raises
        ------
        InvalidArgument
            If no wheel is fixed and keeps the body from moving across it.
        """
        if not self.mobility.choice.is_fixed:
            raise InvalidArgument(f"robot is {self.mobility.kind}, which has no fixed axle")
        self._check_rolls()
        return frozen(self.array_dynamics.axle)

    @cached_property
    def pivots(self) -> Any:
        """Where each axis steers a wheel, x, y, and its angle at zero, shape (axes, 3) [m, m, rad].

        Of an Ackermann pair it is the wheel in their middle.
        """
        return frozen(self.array_dynamics.pivots if self.table.axes else np.zeros((0, 3)))

    # Dynamics

    @takes(q="nq")
    def mass_matrix(self, q: ArrayLike) -> Any:
        """Return M(q), shape (..., nv, nv) [kg, kg m, kg m^2], rotors included."""
        return self._numeric.mass_matrix(q)

    @takes(q="nq", v="nv")
    def nonlinear_effects(self, q: ArrayLike, v: ArrayLike) -> Any:
        """Return n(q, v), shape (..., nv) [N, N, N m, ...]."""
        return self._numeric.nonlinear_effects(q, v)

    @takes(q="nq", v="nv")
    def kinetic_energy(self, q: Any, v: Any) -> Any:
        """Return v' M(q) v / 2, shape (...) [J]."""
        return np.asarray(np.einsum("...i,...ij,...j->...", v, self._numeric.mass_matrix(q), v) / 2)

    @takes(q="nq", v="nv", u="nu", f="nv")
    def forward_dynamics(self, q: ArrayLike, v: ArrayLike, u: ArrayLike, f: ArrayLike = 0.0) -> Any:
        """Return the acceleration, shape (..., nv) [m/s^2, ...].

        Of wheels that roll M a + n = B u + f + A' lambda and A a = -dA/dt v, solved in independent
        velocities, see `Reduced`; where they slip, the mean over a short step, as dry friction has impulses
        and no force at an instant.

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State, which rolls.
        u : array_like, shape (..., nu)
            Torques [N m], see `inputs`.
        f : array_like, shape (..., nv), optional
            Generalised forces beside them.
        """
        return self._numeric.forward_dynamics(q, v, u, f)

    @takes(q="nq", v="nv", u="nu", f="nv")
    def constraint_forces(self, q: Any, v: Any, u: Any, f: Any = 0.0) -> Forces:
        """Return the forces of the ground at the wheels, and which of them rolling determines."""
        if self.array_dynamics.slips:
            raise InvalidArgument(
                "constraint_forces is asked of wheels that may slip, which no constraint holds, expected "
                "ground=Rolling(); their forces are in the signals of a run"
            )
        values = self._numeric.constraint_forces(q, v, u, f)
        finite_answer(values, q=q, v=v, u=u, f=f)
        return Forces(self.constraint_names, values, self.mobility.determined.copy())

    @takes(q="nq", v="nv")
    def reduced(self, q: ArrayLike, v: ArrayLike) -> Reduced:
        """Return the dynamics of the independent velocities, where wheels roll: see `Reduced`.

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State, which rolls.
        """
        return self._rolling.reduced(q, v)  # type: ignore[no-any-return]

    @takes(q="nq", v="nv", a="of_body")
    def inverse_dynamics(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Any:
        """Return the input of least norm with which body and arms accelerate so, shape (..., nu) [N m].

        ``forward_dynamics(q, v, inverse_dynamics(q, v, a))`` begins with `a`; the inverse does not hold where
        there are more inputs than coordinates.

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State, which rolls.
        a : array_like, shape (..., 3 + arms)
            Acceleration of x, y, psi and the arms [m/s^2, rad/s^2, ...].

        Raises
        ------
        InvalidArgument
            If the drive cannot accelerate its body in every direction.
        """
        self.check_inverse_dynamics()
        return self._rolling.inverse_dynamics(q, v, a)

    def check_inverse_dynamics(self) -> None:
        """Refuse a drive that cannot accelerate its body in every direction.

        Raises
        ------
        InvalidArgument
            If it is such.
        """
        self._check_rolls()
        still = self.reduced(self.rest, np.zeros(self.nv)) if self.mobility.mobility == 3 else None
        if still is None or np.linalg.matrix_rank(still.B) < len(still.M):
            raise InvalidArgument(
                f"robot is {self.mobility.kind}, which cannot accelerate in every direction, so no torques "
                "are its inverse dynamics; expected an omnidirectional drive, or Backstepping(law, robot), "
                "and a motor for each degree of freedom"
            )

    @takes(q="nq", v="nv")
    def independent(self, q: ArrayLike, v: ArrayLike) -> Any:
        """Return the independent velocities nu of a state that rolls, shape (..., m): see `Reduced`."""
        return self._rolling.independent(q, v)

    @takes(q="nq", v="nv", u="nu")
    def linearize_tracked(self, q: ArrayLike, v: ArrayLike, u: ArrayLike) -> Linearization:
        """Return the first-order model of the tracked state, d(e, dnu)/dt = A (e, dnu) + B du.

        e has x, y, psi and the arms, as `difference` has them, and nu the independent velocities: see
        `Reduced`. Angles of wheels that do not steer do not matter. Slopes are by the complex step, exact but
        for rounding.

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State, which rolls.
        u : array_like, shape (..., nu)
            Torques [N m].

        Raises
        ------
        InvalidArgument
            If wheels steer, or an argument has another shape.
        """
        self._check_rolls()
        return Linearization(*self.array_dynamics.linearize_tracked(q, v, u))

    @takes(q="nq", v="nv")
    def torques(self, q: ArrayLike, v: ArrayLike, rates: ArrayLike) -> Any:
        """Return the input of least norm with which independent velocities change so, shape (..., nu) [N m].

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State, which rolls.
        rates : array_like, shape (..., m)
            nu' of `Reduced` [m/s^2, rad/s^2].
        """
        own = self._rolling.reduced(q, v)
        return own.torques(shaped("rates", finite("rates", rates), ("...", own.nu.shape[-1])))

    @takes(q="nq", tau="of_body")
    def allocate(self, q: Any, tau: Any) -> Allocation:
        """Return the torques within limits that come nearest to a force on body and arms.

        Where limits allow it they change the independent velocities as the force would, and have least norm;
        else the sum of squares of what they miss is least in the metric of the inverse mass, by a quadratic
        program. `allocate_scaled` is for loops.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration.
        tau : array_like, shape (..., 3 + arms)
            Force on x, y, psi and the arms [N, N, N m, ...].
        """
        lead, rolling, still = tau.shape[:-1], self._rolling, np.zeros(self.nv)
        u, rest = np.empty((*lead, self.nu)), np.empty((*lead, self.robot.nv))
        for at in np.ndindex(lead):
            own = rolling.reduced(q[at], still)
            u[at] = own.nearest(own.S[: self.robot.nv].T @ tau[at], self.inputs)
            state = rolling.state(q[at], still)
            rest[at] = tau[at] - [number(x) for x in state.outward(rolling.supplied(state, u[at]))]
        return Allocation(u, rest)

    @takes(q="nq", tau="of_body")
    def allocate_scaled(self, q: ArrayLike, tau: ArrayLike) -> tuple[Array, Array]:
        """Return torques for a force on body and arms, scaled by one factor into limits, and what is left.

        They have least norm; where one is beyond its limit all shrink alike, so that the force keeps its
        direction. It is the same arithmetic in all engines.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration.
        tau : array_like, shape (..., 3 + arms)
            Force on x, y, psi and the arms [N, N, N m, ...].
        """
        return self._rolling.allocate_scaled(q, tau)  # type: ignore[no-any-return]

    @of_ground
    @takes(q="nq", v="nv")
    def project(self, q: Any, v: Any) -> Any:
        """Return the velocity that rolls and is nearest in the mass metric, shape (..., nv)."""
        return self._numeric.project(q, v)

    # What the ground bears

    def _felt(self, q: Any, v: Any, a: Any) -> tuple[Any, list[Any]]:
        """Return the state, and accelerations along the body's axes less gravity in the plane."""
        state = self._numeric.state(q, v)
        return state, self._numeric.proper_acceleration(state, state.along(list(np.moveaxis(a, -1, 0))))

    @takes(q="nq", v="nv", a="nv")
    def ground_wrench(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Any:
        """Return what the ground exerts on the robot that moves so, shape (..., 6), wheels spinning.

        Along the axes of the body's frame, with the moment about its origin, which lies on the ground.
        Whatever else acts from outside is in it.
        """
        state, felt = self._felt(q, v, a)
        fx, fy, mz, *_ = self._numeric.needed(state, felt, q)
        found = [fx, fy, *ground_reaction(self._numeric, state, felt, q), mz]
        return np.stack(np.broadcast_arrays(*map(number, found)), axis=-1)

    @takes(q="nq", v="nv", a="nv")
    def mount_wrench(self, q: Any, v: Any, a: Any, mount: str | None = None) -> Any:
        """Return the wrench of an arm on the body at its mount, (..., 6): see `MobileRobot.mount_wrench`."""
        n, slack = self.robot.nv, self.array_dynamics._slack
        q, v, a = q[..., :n], v[..., :n], a[..., :n].copy()
        a[..., :2] -= self.fall[:2]  # gravity in the plane is as if the plane accelerated against it
        found, still = self.robot.mount_wrench(q, v, a, mount), np.zeros_like(v)
        return found - slack * self.robot.mount_wrench(q, still, still, mount) if slack else found

    @takes(q="nq", v="nv", a="nv")
    def contact_loads(self, q: Any, v: Any, a: Any) -> ContactLoads:
        """Return what each wheel and support carries, those of the supports behind.

        With more than three, as equal springs share it; what would pull has lifted off, and the others carry.

        Parameters
        ----------
        q, v, a : array_like, shape (..., nq), (..., nv), (..., nv)
            State and acceleration.
        """
        self.check_stands()
        return contact_loads(self._numeric, *self._felt(q, v, a), q)

    def slip_margins(self, motion: Any) -> SlipMargins:
        """Return the friction that each wheel, or axle, has left before it slips.

        Of wheels that roll it is ``mu N`` less the size of the ground's force, which follows from v, a and u;
        forces that push the body count as if the ground exerted them. Where rolling does not determine how
        wheels of an axle share the force across them, it is the axle's margin:
        ``sum sqrt((mu N)^2 - along^2) - |across|``, and no more than ``mu N - |along|`` of each. Wheels that
        may slip have margins in runs, whose signals tell the forces.

        Parameters
        ----------
        motion : Rollout or MotionStates
            With q, v, a and u.
        """
        self.check_stands()
        if self.array_dynamics.slips:
            return recorded_margins(self.array_dynamics, motion)
        if motion.u is None:
            raise InvalidArgument(
                "motion.u is None, expected the input, on which the forces of wheels depend: "
                "MotionStates(..., u=u)"
            )
        q, v, u, a = self._state(motion.q, motion.v, motion.u, motion.a)
        return rolling_margins(self._numeric, *self._felt(q, v, a), u, q)[1]

    def contacts(self, q: Any, v: Any, a: Any, u: Any, signals: Mapping[str, Any]) -> Contacts:
        """Return what the ground does at the wheels at the samples of a run, see `Contacts`.

        Parameters
        ----------
        q, v, a, u : array_like, shape (n, ...)
            Of the samples.
        signals : mapping of str to Signal
            Of the run.
        """
        q, v, u, a = self._state(q, v, u, a)
        return contacts_of(self, q, v, a, u, signals)

    def follows(self, t: ArrayLike, reference: Any) -> TimeScaledMotion:
        """Return what rolls along a reference: its ``at(factor)`` tells what the ground bears.

        Parameters
        ----------
        t : array_like, shape (N,)
            Times, ascending [s].
        reference : Reference
            At these times.
        """
        self.check_stands()
        along = followed(self._rolling, reference, finite("t", t))
        return TimeScaledMotion(self._rolling, along, self.robot.effort_limit[BODY_JOINT:])

    @property
    def metrics(self) -> tuple[Metric, ...]:
        """What is worth judging about it beside errors: what `evaluate_metrics` returns.

        The smallest load of wheels and supports; of wheels that roll the smallest slip margin, see
        `slip_margins`, and of those that may slip the largest velocity at which one slides; where there are
        limits, the largest torque of what motors allow; with arms, what is judged of these, see
        `MobileRobot.metrics`.
        """
        return self.array_dynamics.metrics  # type: ignore[no-any-return]

    @also_symbols
    def evaluate_metrics(
        self, t: ArrayLike, q: ArrayLike, v: ArrayLike, a: ArrayLike, u: ArrayLike, reference: Any
    ) -> Array:
        """Return its `metrics`, shape (..., m).

        Parameters
        ----------
        t : array_like, shape (...)
            Time [s], on which nothing depends.
        q, v, a, u : array_like, shape (..., nq), (..., nv), (..., nv), (..., nu)
            State, acceleration and input.
        reference : Reference
            Where the first coordinates should be.
        """
        required("reference", reference, Desired)
        wanted = [("...", n) for n in self.reference_sizes]
        given = [*self._state(q, v, u, a), shaped("reference.q", finite("reference.q", reference.q), *wanted)]
        lead = broadcast(**{"q": given[0], "reference.q": given[-1]})
        q, v, u, a, desired = (np.broadcast_to(x, (*lead, x.shape[-1])) for x in given)
        with np.errstate(all="ignore"):
            found = np.asarray(
                self.array_dynamics.evaluate_metrics(t, q, v, a, u, reference._replace(q=desired))
            )
        finite_answer(np.where(found == -np.inf, 0.0, found), q=q, v=v, a=a, u=u)  # a margin may be that
        return np.array(np.broadcast_to(found, (*lead, len(self.metrics))))
