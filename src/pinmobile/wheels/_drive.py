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

from pinmobile.arrays import Array, ArrayLike, absent, finite, finite_answer, frozen, shaped
from pinmobile.errors import InvalidArgument
from pinmobile.integrators import rk4
from pinmobile.parts import by_value, child, evolved, part, structure, takes
from pinmobile.plant import ContactLoads, Contacts, Coordinate, Input, SlipMargins
from pinmobile.robot import BODY_JOINT, LOCKED, Linearization, MobileRobot, PayloadBody, describe, number
from pinmobile.wheels._coulomb import Coulomb
from pinmobile.wheels._dynamics import PlantOnWheels, of_ground
from pinmobile.wheels._kinematics import Allocation, Reduced, rolling_motion
from pinmobile.wheels._loads import (
    Forces,
    TimeScaledMotion,
    contact_loads,
    contacts_of,
    ground_reaction,
    recorded_margins,
    rolling_margins,
)
from pinmobile.wheels._motors import column
from pinmobile.wheels._rolling import Ground, Ramp, Rolling, RollingDynamics
from pinmobile.wheels._table import WheelTable
from pinmobile.wheels._urdf_reader import joint_signs, read_robot, read_wheels, source_of
from pinmobile.wheels._visuals import Tyres, WheelVisuals
from pinmobile.wheels._voltage_dynamics import ByVoltage

_SLIP_TOLERANCE = 1e-9  # tolerance of slip at the start, relative to the largest rate


def _of_wheels(name: str, doc: str) -> Any:
    """Return a property with a parameter of all wheels."""
    wrapper = cached_property(lambda self: column([getattr(wheel, name) for wheel in self.table.wheels]))
    wrapper.__doc__ = doc
    return wrapper


def _of(owner: str, name: str, doc: str) -> Any:
    """Return a property with an attribute of another attribute."""
    return property(lambda self: getattr(getattr(self, owner), name), doc=doc)


def _count(doc: str, count: Callable[[Any], int]) -> Any:
    """Return a structural property that counts."""
    wrapper = structure(count)
    wrapper.__doc__ = doc
    return wrapper


@final
@part
@by_value
class WheeledRobot(PlantOnWheels):
    """Robot on wheels: q = (x, y, psi, arms, steering, wheels), u = torques of arms, wheels and steering.

    All methods broadcast over leading axes. They raise `InvalidArgument` for arguments that are not finite or
    have another size of the last axis.

    Parameters
    ----------
    robot : MobileRobot
        Whole robot with wheels locked at their table angles: its mass, centre of mass and inertia include the
        wheels'.
    table : WheelTable
        Wheels; default: those of the file from which the robot was read, see `wheels.read_wheels`.
    ground : Rolling, Coulomb or other ground, optional
        Ground; default: `Rolling` if the drive can roll without slip, otherwise `Coulomb`.

    Raises
    ------
    InvalidArgument
        If an argument is of another kind, the wheels cannot roll on this ground, or the robot without its
        wheels is not a rigid body.

    See Also
    --------
    WheelTable : wheels of a drive
    Rolling : ground without slip
    Coulomb : ground with dry friction
    MobileRobot : robot driven by forces on its body

    Examples
    --------
    >>> from pinmobile import MobileRobot, WheeledRobot, WheelTable
    >>> table = WheelTable.differential(
    ...     track=0.4, radius=0.1, mass=1.0, spin_inertia=0.005)
    >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), table)
    >>> robot.wheel_rates([0.5, 0.0, 1.0])  # [rad/s]
    array([3., 7.])
    >>> [one.name for one in robot.coordinates]
    ['x', 'y', 'psi', 'left', 'right']
    """

    robot: MobileRobot = child(MobileRobot, expected="a MobileRobot")
    table: WheelTable = child(WheelTable, expected="a WheelTable")
    ground: Any = child(Ground)
    integrator: ClassVar[Any] = rk4  # a lower order is inaccurate in fast turns

    def __init__(self, robot: MobileRobot, table: WheelTable | None = None, ground: Any = None) -> None:
        if table is None:
            table = read_wheels(robot)
        if ground is None and isinstance(table, WheelTable):
            ground = Rolling() if table.mobility.is_regular else Coulomb()
        self.__attrs_init__(robot, table, ground)  # type: ignore[attr-defined]

    def check(self) -> None:
        """Raise `InvalidArgument` if the ground does not fit the robot, or wheels are heavier than it."""
        if hasattr(self.ground, "check_robot"):
            self.ground.check_robot(self)
        _ = self.bare_body

    def __repr__(self) -> str:
        body = repr(self.robot).removesuffix(f" with {LOCKED}")
        return f"WheeledRobot({body}, {self.table!r}, {self.ground!r})"

    def describe(self) -> str:
        """Return the numbers of the robot as text, see `MobileRobot.describe`, with wheels and motors.

        ``print(robot)`` prints the same.

        Returns
        -------
        str
            Lines of text.

        Examples
        --------
        >>> from pinmobile import MobileRobot, Motor, WheeledRobot, WheelTable
        >>> motor = Motor(resistance=2, torque_constant=0.5, voltage=24)
        >>> table = WheelTable.differential(0.5, 0.1, motor=motor)
        >>> robot = WheeledRobot(MobileRobot(30.0, 1.3), table)
        >>> print(robot.describe().splitlines()[-4])
          left   6 N m         48 rad/s, 4.8 m/s  24 V     none     given
        """
        return describe(self.robot, self)

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
        """Return the robot of a URDF with its wheels; `source` states the origin of each number.

        Parameters
        ----------
        path, package_dirs
            As in `MobileRobot.from_urdf`.
        table : WheelTable, optional
            Wheels; default: those of the file.
        ground : Rolling or Coulomb, optional
            As in the class.
        ground_z : float, optional
            z of the ground in the frame of the root link [m]; default: by `MobileRobot.from_urdf`, or, if the
            file does not define it, below the wheels by the radii in `given`.
        **given
            Parameters of wheels that the file does not define, see `wheels.read_wheels`: ``radius``,
            ``rollers``, ``driven``, ``steering``, ``inertia``, ``locked``, ``supports``, ``couplings``.

        Returns
        -------
        robot : WheeledRobot
            The robot.

        Raises
        ------
        InvalidArgument
            As in `MobileRobot.from_urdf`, `wheels.read_wheels` and the class; or if both a table and `given`
            are present.
        """
        if table is not None:
            absent("with table", **given)
        robot = read_robot(path, package_dirs, ground_z, given)
        return cls(robot, read_wheels(robot, **given) if table is None else table, ground)

    def mount(self, arm: Any, at: ArrayLike | None = None, **options: Any) -> WheeledRobot:
        """Return the robot with an arm on its body, see `MobileRobot.mount`.

        Parameters
        ----------
        arm, at, **options
            As in `MobileRobot.mount`.
        """
        return WheeledRobot(self.robot.mount(arm, at, **options), self.table, self.ground)

    def attach(self, load: PayloadBody, frame: str | None = None) -> WheeledRobot:
        """Return the robot with a payload on one of its frames, see `MobileRobot.attach`.

        Parameters
        ----------
        load : PayloadBody
            The payload.
        frame : str, optional
            Name of the frame.
        """
        return WheeledRobot(self.robot.attach(load, frame), self.table, self.ground)

    def by_voltage(self) -> ByVoltage:
        """Return the same robot with voltages as inputs of its electric motors, see `wheels.ByVoltage`."""
        return ByVoltage(self)

    def on_ramp(self, angle: float, direction: float = 0.0) -> WheeledRobot:
        """Return the robot on inclined ground.

        Parameters
        ----------
        angle, direction : float
            Inclination, and direction of steepest ascent from the inertial x axis [rad].

        Raises
        ------
        InvalidArgument
            If an angle is out of range.
        """
        return WheeledRobot(self.robot, self.table, evolved(self.ground, ramp=Ramp(angle, direction)))

    # Dynamics on its ground

    @cached_property
    def array_dynamics(self) -> Any:
        """Dynamics on its ground, for one state, many, or symbols, without input validation."""
        return self.ground.dynamics(self)

    @cached_property
    def _numeric(self) -> Any:
        """Dynamics of numbers; Pinocchio evaluates the arms."""
        return replace(self.array_dynamics, robot=self.robot) if self.robot.mounts else self.array_dynamics

    @cached_property
    def _rolling(self) -> Any:
        """Dynamics of numbers on ground without slip."""
        self.mobility.check_rolls("robot")
        dynamics = self._numeric
        return RollingDynamics(self, dynamics.robot) if dynamics.slips else dynamics

    x = _of_wheels("x", "Positions of the wheels' pivots, forward, shape (wheels,) [m].")
    y = _of_wheels("y", "Positions of the wheels' pivots, to the left, shape (wheels,) [m].")
    radius = _of_wheels("radius", "Radii of the wheels, shape (wheels,) [m].")
    spin_inertia = _of_wheels("spin_inertia", "Inertia about the axles, shape (wheels,) [kg m^2].")

    mu = _of("array_dynamics", "mu", "Friction coefficients, of rollers along their axes, shape (wheels,).")

    @cached_property
    def upright(self) -> Any:
        """Parameters of ground reactions of a robot without arms, shape (3,) [m, kg m^2, kg m^2].

        They are the height of the centre of mass, and the products of inertia xz and yz about it.
        """
        nominal = vars(self.robot).get("nominal")
        if nominal is None or nominal.mounts:
            return self._upright
        com, (height, xz, yz) = self.robot.com, self._upright
        z = com[2] if len(com) > 2 else 0.0
        if nominal.loads:
            mass, mass_0 = nominal.with_locked_arms().mass, nominal.mass
            loads = mass * height - mass_0 * (nominal.com[2] if len(nominal.com) > 2 else 0.0)
            z = (self.robot.mass * z + loads) / (self.robot.mass + (mass - mass_0))
        return column([z, xz, yz])

    @structure
    def _upright(self) -> Array:
        if self.robot.mounts:
            return frozen(np.zeros(3))
        inertia = self.robot.with_locked_arms().model.inertias[BODY_JOINT]
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
        """Diagonal of M at rest for steering axes and wheels, shape (axes + wheels,) [kg m^2]."""
        return frozen(np.diagonal(self.mass_matrix(self.rest))[self.robot.nv :])

    @structure
    def _accelerates_everywhere(self) -> bool:
        if self.mobility.mobility < 3:
            return False
        dynamics = self.reduced(self.rest, np.zeros(self.nv))
        return bool(np.linalg.matrix_rank(dynamics.B) == len(dynamics.M))

    # Sizes and names

    mobility = _of("table", "mobility", "Motions that the wheels allow.")

    _axes = _count("Number of steering coordinates.", lambda self: len(self.table.axes))
    _wheels = _count("Number of wheels.", lambda self: len(self.table))
    joints = _count("Number of steering coordinates and wheels.", lambda self: self._axes + self._wheels)
    of_body = _count("Number of coordinates of body and arms.", lambda self: self.robot.nv)
    nq = _count("Size of q.", lambda self: self.nv)
    nv = _count("Size of v and a.", lambda self: self.of_body + self.joints)
    nu = _count("Size of the input.", lambda self: self.of_body - BODY_JOINT + len(self.table.actuators))

    @structure
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Coordinates of q: body, arms, steering axes, wheels."""
        axes = [Coordinate(axis.name, "rad", -axis.limit, axis.limit) for axis in self.table.axes]
        return (*self.robot.coordinates, *axes, *(Coordinate(name, "rad") for name in self.table.names))

    @structure
    def inputs(self) -> tuple[Input, ...]:
        """Inputs of u: the arms' joints, then the actuators in the order of the table."""
        limits = ((one.name, one.motor.largest_torque) for one in self.table.actuators)
        return (*self.robot.inputs[BODY_JOINT:], *(Input(name, "N m", -x, x) for name, x in limits))

    reference_sizes = _of(
        "robot", "reference_sizes", "Number of entries of q per number of coordinates of a reference."
    )

    @structure
    def rest(self) -> Array:
        """Configuration at the origin, with arms in their reference posture, shape (nq,)."""
        return frozen(np.append(self.robot.rest, np.zeros(self.joints)))

    @property
    def source(self) -> str:
        """Origin of the numbers as text."""
        return source_of(self.robot, self.table)

    @property
    def joint_signs(self) -> Mapping[str, int]:
        """Sign of each wheel of the file: -1 if its joint turns in the opposite direction, otherwise 1."""
        return MappingProxyType(joint_signs(self.robot, self.table))

    # Contacts

    grounded = _of("robot", "grounded", "Whether the body's origin is known to lie on the ground.")
    footprint = _of("table", "footprint", "Corners of the support polygon, see `WheelTable`.")

    def check_stands(self) -> None:
        """Raise `InvalidArgument` if its height is unknown, or all its contacts lie on one line."""
        if not self.grounded:
            raise InvalidArgument(
                "robot has an unknown height above the ground, expected ground= in reading it, or Rolling()"
            )
        if self.footprint is None:
            raise InvalidArgument(
                f"table has {self._wheels + len(self.table.supports)} contacts on one line, expected three "
                "that are not: give supports=[(x, y), ...], the positions of casters"
            )

    # Geometry and frames

    mounts = _of("robot", "mounts", "Arms on the body.")
    size = _of("robot", "size", "Length, width and height of the body [m].")

    @cached_property
    def _picture(self) -> WheelVisuals:
        return WheelVisuals(self.robot, self.table)

    @cached_property
    def _tyres(self) -> Tyres:
        return Tyres(self.robot, self.table)

    @property
    def visual_model(self) -> pin.GeometryModel:
        """Visual geometry, a copy: the visuals of the robot, and wheels and supports that it lacks.

        Wheels have spokes, a bar across the tread, or the rollers of the table; a box is drawn above them.
        """
        return self._picture.visuals.clone()

    @takes(q="nq")
    def drawing(self, q: ArrayLike) -> Any:
        """Return the placements of the objects of `visual_model` in the inertial frame, shape (..., k, 4, 4).

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration.
        """
        return self._picture.placements(np.asarray(q))

    solids = _of("_tyres", "solids", "Collision geometry; wheels touch the ground.")

    @takes(q="nq")
    def solid_placements(self, q: ArrayLike) -> Any:
        """Return the placements of the shapes of `solids` in the body's frame, shape (..., shapes, 4, 4).

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration.
        """
        return self._tyres.placements(np.asarray(q))

    end_effector = _of("robot", "end_effector", "Default frame: tip of the first arm, or the body frame.")
    frame_names = _of("robot", "frame_names", "Names of the frames, see `MobileRobot.frame_names`.")

    def frame_name(self, frame: str | None = None) -> str:
        """Return the name of a frame, see `MobileRobot.frame_name`.

        Parameters
        ----------
        frame : str, optional
            Name; default: `end_effector`.
        """
        return self.robot.frame_name(frame)

    @takes(q="nq")
    def frame_pose(self, q: Any, frame: str | None = None) -> Any:
        """Return T_0_f, the pose of a frame, shape (..., 4, 4), see `MobileRobot.frame_pose`.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration.
        frame : str, optional
            Name; default: `end_effector`.
        """
        return self.robot.frame_pose(q[..., : self.robot.nq], frame)

    # Configurations

    @takes(q="nq", dq="nv")
    def integrate(self, q: ArrayLike, dq: ArrayLike) -> Any:
        """Return the configuration q + dq, shape (..., nq).

        Parameters
        ----------
        q, dq : array_like, shape (..., nq), (..., nv)
            Configuration and displacement.
        """
        return self._numeric.integrate(q, dq)

    @takes(q0="nq", q1="nq")
    def difference(self, q0: ArrayLike, q1: ArrayLike) -> Any:
        """Return the displacement q1 - q0, shape (..., nv); psi and continuous joints in (-pi, pi].

        Parameters
        ----------
        q0, q1 : array_like, shape (..., nq)
            Configurations.
        """
        return self._numeric.difference(q0, q1)

    @takes(q="nq")
    def pose(self, q: ArrayLike) -> Any:
        """Return x, y and psi of the body, shape (..., 3) [m, m, rad].

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration.
        """
        return self._numeric.pose(q).copy()

    @takes(q="nq", v="nv")
    def pose_rate(self, q: ArrayLike, v: ArrayLike) -> Any:
        """Return the rates of x, y and psi of the body, shape (..., 3) [m/s, m/s, rad/s].

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State.
        """
        return self._numeric.pose_rate(q, v).copy()

    @takes(q="nq", wrench=3)
    def generalized_force(self, q: ArrayLike, wrench: ArrayLike) -> Any:
        """Return the generalised force of a wrench on the body, shape (..., nv) [N, N, N m, ...].

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration.
        wrench : array_like, shape (..., 3)
            (Fx, Fy, Mz) along the inertial axes [N, N, N m].
        """
        return self._numeric.generalized_force(q, wrench)

    def start(self, reference: Any) -> tuple[Array, Array]:
        """Return the state at the start of a reference, shape (nq,) and (nv,).

        Steered wheels point in their direction of motion, and all wheels roll. Arms without a reference rest.

        Parameters
        ----------
        reference : Reference
            First sample of the reference.
        """
        return replace(self.array_dynamics, robot=self.robot).start(reference)  # type: ignore[no-any-return]

    @takes(q="nq", v="nv")
    def check_start(self, q: Any, v: Any) -> None:
        """Check that wheels on one gear train turn at consistent rates, and that rolling wheels do not slip.

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State at the start.

        Raises
        ------
        InvalidArgument
            If a constraint is violated.
        """
        slips = np.einsum("...ij,...j->...i", self.constraint_matrix(q), v)
        largest = np.abs(finite_answer(slips, q=q, v=v)).reshape(-1, slips.shape[-1]).max(axis=0)
        for name, slip in zip(self.constraint_names, largest, strict=True):
            must_roll = name == "train" or not self.array_dynamics.slips
            if must_roll and slip > _SLIP_TOLERANCE * (1 + float(np.abs(v).max())):
                wheel = "a wheel of a gear train" if name == "train" else name
                raise InvalidArgument(
                    f"start does not roll: {wheel} slips at {slip:.3g} m/s; expected a reference that "
                    "the wheels can follow, such as Tangent(path), v0 = robot.project(q0, v0), or v0 of zeros"
                )

    # Constraints and wheel rates

    @takes(q="nq")
    def constraint_matrix(self, q: Any) -> Any:
        """Return A(q), shape (..., k, nv): A v = 0 for rolling wheels, see `constraint_names`.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration.
        """
        return self._numeric.constraints(q, np.zeros(self.nv))[0]

    @takes(q="nq", v="nv")
    def constraint_drift(self, q: Any, v: Any) -> Any:
        """Return dA/dt v, shape (..., k) [m/s^2]: rolling continues if A a = -dA/dt v.

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State.
        """
        return self._numeric.constraints(q, v)[1]

    @cached_property
    def constraint_names(self) -> tuple[str, ...]:
        """Wheel and direction of each row of `constraint_matrix`, such as ``"left rolling"``."""
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
        """Return the rates of rolling wheels for a body twist, shape (..., wheels) [rad/s].

        Parameters
        ----------
        twist : array_like, shape (..., 3)
            Body twist: forward, left, yaw rate [m/s, m/s, rad/s].
        steering, turning : array_like, shape (..., axes), optional
            Steering angles and their rates; default: zero [rad, rad/s].
        """
        return self._numeric.wheel_rates(twist, steering, turning)

    @takes(rates="_wheels", steering="_axes", turning="_axes")
    def odometry(self, rates: Any, steering: ArrayLike = (), turning: ArrayLike = ()) -> Any:
        """Return the body twist from measured wheel rates, shape (..., 3) [m/s, m/s, rad/s].

        It is the least-squares solution of all rows, with no lateral motion of tyres.

        Parameters
        ----------
        rates : array_like, shape (..., wheels)
            Rates of the wheels [rad/s].
        steering, turning : array_like, shape (..., axes), optional
            Steering angles and their rates; default: zero [rad, rad/s].

        Raises
        ------
        InvalidArgument
            If the wheel rates do not determine the body's motion.
        """
        self.mobility.check_odometry()
        return self._numeric.odometry(rates, steering, turning)

    @cached_property
    def axle(self) -> Any:
        """Coefficients of the body twist in the lateral velocity at the fixed axle, shape (3,).

        Raises
        ------
        InvalidArgument
            If no fixed wheel prevents lateral motion of the body.
        """
        if not self.mobility.choice.is_fixed:
            raise InvalidArgument(f"robot is {self.mobility.kind}, which has no fixed axle")
        self.mobility.check_rolls("robot")
        return frozen(self.array_dynamics.axle)

    @cached_property
    def pivots(self) -> Any:
        """Position x, y and angle at zero of each steering axis, shape (axes, 3) [m, m, rad].

        For an Ackermann pair, it is the virtual wheel in the middle.
        """
        return frozen(self.array_dynamics.pivots if self.table.axes else np.zeros((0, 3)))

    # Dynamics

    @takes(q="nq")
    def mass_matrix(self, q: ArrayLike) -> Any:
        """Return M(q), shape (..., nv, nv) [kg, kg m, kg m^2], including rotors.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration.
        """
        return self._numeric.mass_matrix(q)

    @takes(q="nq", v="nv")
    def nonlinear_effects(self, q: ArrayLike, v: ArrayLike) -> Any:
        """Return n(q, v), shape (..., nv) [N, N, N m, ...].

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State.
        """
        return self._numeric.nonlinear_effects(q, v)

    @takes(q="nq", v="nv")
    def kinetic_energy(self, q: Any, v: Any) -> Any:
        """Return v' M(q) v / 2, shape (...) [J].

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State.
        """
        return np.asarray(np.einsum("...i,...ij,...j->...", v, self._numeric.mass_matrix(q), v) / 2)

    @takes(q="nq", v="nv", u="nu", f="nv")
    def forward_dynamics(self, q: ArrayLike, v: ArrayLike, u: ArrayLike, f: ArrayLike = 0.0) -> Any:
        """Return the acceleration, shape (..., nv) [m/s^2, ...].

        For rolling wheels, M a + n = B u + f + A' lambda and A a = -dA/dt v, solved in independent
        velocities, see `reduced`. For wheels that slip, it is the mean over a short step, because impulses
        describe dry friction.

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State; wheels roll.
        u : array_like, shape (..., nu)
            Torques [N m], see `inputs`.
        f : array_like, shape (..., nv), optional
            External generalised force.
        """
        return self._numeric.forward_dynamics(q, v, u, f)

    @of_ground
    @takes(q="nq", v="nv", u="nu", f="nv")
    def constraint_forces(self, q: Any, v: Any, u: Any, f: Any = 0.0) -> Forces:
        """Return the forces of the ground on rolling wheels, and which of them rolling determines.

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State; wheels roll.
        u : array_like, shape (..., nu)
            Torques [N m].
        f : array_like, shape (..., nv), optional
            External generalised force.

        Raises
        ------
        AttributeError
            If the wheels may slip.
        """
        values = self._numeric.constraint_forces(q, v, u, f)
        finite_answer(values, q=q, v=v, u=u, f=f)
        return Forces(self.constraint_names, values, self.mobility.determined.copy())

    @takes(q="nq", v="nv")
    def reduced(self, q: ArrayLike, v: ArrayLike) -> Reduced:
        """Return the dynamics of the independent velocities of rolling wheels: M dnu/dt + n = B u, v = S nu.

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State; wheels roll.
        """
        return self._rolling.reduced(q, v)  # type: ignore[no-any-return]

    @takes(q="nq", v="nv", a="of_body")
    def inverse_dynamics(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Any:
        """Return the input of least norm for an acceleration of body and arms, shape (..., nu) [N m].

        ``forward_dynamics(q, v, inverse_dynamics(q, v, a))`` begins with `a`. The converse does not hold if
        there are more inputs than coordinates.

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State; wheels roll.
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
        """Check that the drive can accelerate its body in every direction.

        Raises
        ------
        InvalidArgument
            If it cannot.
        """
        self.mobility.check_rolls("robot")
        if not self._accelerates_everywhere:
            raise InvalidArgument(
                f"robot is {self.mobility.kind}, which cannot accelerate in every direction and so has no "
                "inverse dynamics; expected an omnidirectional drive, or Backstepping(law, robot), "
                "and a motor for each degree of freedom"
            )

    @takes(q="nq", v="nv")
    def independent(self, q: ArrayLike, v: ArrayLike) -> Any:
        """Return the independent velocities nu of a rolling state, shape (..., m), see `reduced`.

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State; wheels roll.
        """
        return self._rolling.independent(q, v)

    @takes(q="nq", v="nv", u="nu")
    def linearize_tracked(self, q: ArrayLike, v: ArrayLike, u: ArrayLike) -> Linearization:
        """Return the linear model of the tracked state, d(e, dnu)/dt = A (e, dnu) + B du.

        e contains x, y, psi and the arms, as in `difference`, and nu the independent velocities, see
        `reduced`. Angles of wheels that do not steer have no effect. The complex-step method makes the
        derivatives exact up to rounding.

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State; wheels roll.
        u : array_like, shape (..., nu)
            Torques [N m].

        Returns
        -------
        model : Linearization
            A and B.

        Raises
        ------
        InvalidArgument
            If wheels steer, or an argument has another shape.
        """
        self.mobility.check_rolls("robot")
        return Linearization(*self.array_dynamics.linearize_tracked(q, v, u))

    @takes(q="nq", v="nv")
    def torques(self, q: ArrayLike, v: ArrayLike, rates: ArrayLike) -> Any:
        """Return the input of least norm for rates of the independent velocities, shape (..., nu) [N m].

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State; wheels roll.
        rates : array_like, shape (..., m)
            Rates of nu, see `reduced` [m/s^2, rad/s^2].
        """
        dynamics = self._rolling.reduced(q, v)
        return dynamics.torques(shaped("rates", finite("rates", rates), ("...", dynamics.nu.shape[-1])))

    @takes(q="nq", tau="of_body")
    def allocate(self, q: Any, tau: Any) -> Allocation:
        """Return the torques within limits whose effect is nearest to that of a force on body and arms.

        If limits allow, they change the independent velocities as the force would, with least norm. Otherwise
        a quadratic program minimises the residual in the metric of the inverse mass. `allocate_scaled` is
        faster, for loops.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration.
        tau : array_like, shape (..., 3 + arms)
            Force on x, y, psi and the arms [N, N, N m, ...].

        Returns
        -------
        allocation : Allocation
            Torques, and the part of the force that they do not exert.
        """
        lead, rolling, zeros = tau.shape[:-1], self._rolling, np.zeros(self.nv)
        u, rest = np.empty((*lead, self.nu)), np.empty((*lead, self.robot.nv))
        for row in np.ndindex(lead):
            reduced = rolling.reduced(q[row], zeros)
            u[row] = reduced.nearest(reduced.S[: self.robot.nv].T @ tau[row], self.inputs)
            state = rolling.state(q[row], zeros)
            rest[row] = tau[row] - [number(x) for x in state.outward(rolling.applied_force(state, u[row]))]
        return Allocation(u, rest)

    @takes(q="nq", tau="of_body")
    def allocate_scaled(self, q: ArrayLike, tau: ArrayLike) -> tuple[Array, Array]:
        """Return torques for a force on body and arms, scaled into limits by one factor, and the residual.

        The torques have least norm. If a torque exceeds its limit, one factor scales all of them, so that the
        force keeps its direction. All engines use the same arithmetic.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration.
        tau : array_like, shape (..., 3 + arms)
            Force on x, y, psi and the arms [N, N, N m, ...].

        Returns
        -------
        u : ndarray, shape (..., nu)
            Torques [N m].
        residual : ndarray, shape (..., 3 + arms)
            Part of the force that the torques do not exert [N, N, N m, ...].
        """
        return self._rolling.allocate_scaled(q, tau)  # type: ignore[no-any-return]

    @of_ground
    @takes(q="nq", v="nv")
    def project(self, q: Any, v: Any) -> Any:
        """Return the nearest rolling velocity in the mass metric, shape (..., nv).

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State; wheels may slip.
        """
        return self._numeric.project(q, v)

    # Ground reactions

    def _proper_state(self, q: Any, v: Any, a: Any) -> tuple[Any, list[Any]]:
        """Return the state, and proper accelerations in the plane along the body's axes."""
        state = self._numeric.state(q, v)
        return state, self._numeric.proper_acceleration(state, state.to_body(list(np.moveaxis(a, -1, 0))))

    @takes(q="nq", v="nv", a="nv")
    def ground_wrench(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Any:
        """Return the wrench of the ground on the robot in a motion, shape (..., 6) [N, N m].

        It is along the axes of the body's frame, with the moment about its origin, which lies on the ground.
        It includes the effect of spinning wheels and of all other external forces.

        Parameters
        ----------
        q, v, a : array_like, shape (..., nq), (..., nv), (..., nv)
            State and acceleration.
        """
        state, proper_a = self._proper_state(q, v, a)
        fx, fy, mz, *_ = self._numeric.required(state, proper_a, q)
        wrench = [fx, fy, *ground_reaction(self._numeric, state, proper_a, q), mz]
        return np.stack(np.broadcast_arrays(*map(number, wrench)), axis=-1)

    @takes(q="nq", v="nv", a="nv")
    def mount_wrench(self, q: Any, v: Any, a: Any, mount: str | None = None) -> Any:
        """Return the wrench of an arm on the body at its mount, (..., 6), see `MobileRobot.mount_wrench`.

        Parameters
        ----------
        q, v, a : array_like, shape (..., nq), (..., nv), (..., nv)
            State and acceleration.
        mount : str, optional
            Name of the arm.
        """
        n, reduction = self.robot.nv, self.array_dynamics.gravity_reduction
        q, v, a = q[..., :n], v[..., :n], a[..., :n].copy()
        a[..., :2] -= self.fall[:2]  # gravity in the plane acts like an acceleration of the plane against it
        wrench, zeros = self.robot.mount_wrench(q, v, a, mount), np.zeros_like(v)
        return wrench - reduction * self.robot.mount_wrench(q, zeros, zeros, mount) if reduction else wrench

    @takes(q="nq", v="nv", a="nv")
    def contact_loads(self, q: Any, v: Any, a: Any) -> ContactLoads:
        """Return the load of each wheel and then each support.

        More than three contacts share the load as equal springs do. A contact that would pull has lifted off,
        and the others carry its load.

        Parameters
        ----------
        q, v, a : array_like, shape (..., nq), (..., nv), (..., nv)
            State and acceleration.

        Raises
        ------
        InvalidArgument
            If the height of the robot is unknown, or its contacts lie on one line.
        """
        self.check_stands()
        return contact_loads(self._numeric, *self._proper_state(q, v, a), q)

    def slip_margins(self, motion: Any) -> SlipMargins:
        """Return the remaining friction of each wheel, or axle, before it slips.

        For rolling wheels, it is ``mu N`` minus the magnitude of the ground's force, which follows from v, a
        and u; external forces count as forces of the ground. If rolling determines only the sum of lateral
        forces of an axle, the margin is that of the axle: ``sum sqrt((mu N)^2 - along^2) - abs(across)``, and
        at most ``mu N - abs(along)`` of each wheel. For wheels that may slip, the signals of a run contain
        the forces.

        Parameters
        ----------
        motion : Rollout or MotionStates
            Motion with q, v, a and u.

        Raises
        ------
        InvalidArgument
            If the motion has no input, or, for wheels that may slip, no signals; or loads or forces are not
            determined.
        """
        self.check_stands()
        if self.array_dynamics.slips:
            return recorded_margins(self.array_dynamics, motion)
        q, v, u, a = self._state(motion.q, motion.v, motion.u, motion.a)
        return rolling_margins(self._numeric, *self._proper_state(q, v, a), u, q)[1]

    def contacts(self, q: Any, v: Any, a: Any, u: Any, signals: Mapping[str, Any]) -> Contacts:
        """Return the contacts with the ground at the samples of a run, see `plant.Contacts`.

        Parameters
        ----------
        q, v, a, u : array_like, shape (n, ...)
            Samples.
        signals : mapping of str to Signal
            Signals of the run.
        """
        q, v, u, a = self._state(q, v, u, a)
        return contacts_of(self, q, v, a, u, signals)

    def follows(self, t: ArrayLike, reference: Any) -> TimeScaledMotion:
        """Return the rolling motion along a reference; its ``at(factor)`` returns loads and margins.

        Parameters
        ----------
        t : array_like, shape (N,)
            Times, increasing [s].
        reference : Reference
            Reference at these times.

        Returns
        -------
        motion : TimeScaledMotion
            ``motion.at(factor)`` gives `plant.ContactLoads`, `plant.SlipMargins` and `plant.TorqueMargins` of
            the motion at ``factor`` times its speed.

        Raises
        ------
        InvalidArgument
            If wheels or motors cannot follow the reference, or contacts lie on one line.
        """
        self.check_stands()
        motion = rolling_motion(self._rolling, reference, finite("t", t))
        return TimeScaledMotion(self._rolling, motion, self.robot.effort_limit[BODY_JOINT:])
