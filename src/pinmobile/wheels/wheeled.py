"""`WheeledRobot`: a robot on driven wheels, as a plant."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, Self, final

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
    one_of,
    positive,
    vector,
)
from pinmobile.constancy import constant
from pinmobile.errors import InvalidArgument, shown
from pinmobile.plant import Contacts, Coordinate, Input, Parameter, Step
from pinmobile.robot import BODY_JOINT, LOCKED, Load, MobileRobot, Mount, hull, number
from pinmobile.urdf import Body
from pinmobile.wheels.bearing import Bearing
from pinmobile.wheels.description import joint_signs, read_robot, read_wheels
from pinmobile.wheels.drawn import Picture
from pinmobile.wheels.ground import Coulomb, Ground, Rolling
from pinmobile.wheels.kinematics import Kinematics, Row
from pinmobile.wheels.mobility import Mobility
from pinmobile.wheels.motors import Beside, constant_force
from pinmobile.wheels.rolling import Reduced, RollingBody
from pinmobile.wheels.slipping import Grip, SlippingBody, led
from pinmobile.wheels.table import WheelTable
from pinmobile.wheels.touching import contacts_of
from pinmobile.wheels.tree import WheelTree
from pinmobile.wheels.voltage import ByVoltage

_SAME_LINE = 1e-6  # [m]
_OF_WHEELS = ("x", "y", "radius", "spin_inertia")  # what may differ from robot to robot
_OFF = 1e-9  # of a start's rates, beyond which it does not roll
_LEAST_NORM = 1e-6  # relative weight of torques beside what they are for, where limits hold them
_REDUNDANT = 1e-10  # relative, of eigenvalues: rows that follow from others


class Forces(NamedTuple):
    """What the ground does at the wheels.

    Attributes
    ----------
    names : tuple of str
        Of the rows, such as ``"left rolling"``.
    values : ndarray, shape (..., k)
        Force of the ground on the robot along each row [N], of a gear train what it transmits.
    determined : ndarray of bool, shape (k,)
        Whether rolling determines it; of the others only sums are, and they are shared so that the sum of
        squares is least.
    """

    names: tuple[str, ...]
    values: Array
    determined: Array


class Allocation(NamedTuple):
    """Torques for a force that is wanted on body and arms.

    Attributes
    ----------
    u : ndarray, shape (..., nu)
        The input [N m].
    residual : ndarray, shape (..., 3 + arms)
        What of the force wheels and joints do not supply: what is beyond their limits, and what no wheel
        can give, such as a force across the axle [N, N, N m, ...].
    """

    u: Array
    residual: Array


@final
@constant
@dataclass(frozen=True, eq=False, repr=False)
class WheeledRobot(Bearing):
    """A robot on wheels: q = (x, y, psi, arms, steering, wheels), u = torques at arms, wheels and axes.

    All methods broadcast over leading axes, and raise `InvalidArgument` for arguments of another last axis or
    that are not finite.

    Parameters
    ----------
    robot : MobileRobot
        The whole, wheels locked at their table angles: its mass, centre of mass and inertia hold the wheels'.
    table : WheelTable
        Its wheels; by default those of the file that it was read from, see `read_wheels`.
    ground : Rolling or Coulomb, optional
        What it stands on; by default `Rolling` where the drive can roll without slip, else `Coulomb`.

    Raises
    ------
    InvalidArgument
        If an argument is something else, the wheels cannot roll on such ground, or the robot without them is
        no body.
    """

    robot: MobileRobot
    table: WheelTable = None  # type: ignore[assignment]
    ground: Ground = None  # type: ignore[assignment]
    broadcasts: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if not isinstance(self.robot, MobileRobot):
            raise InvalidArgument(f"robot is {shown(self.robot)}, expected a MobileRobot")
        if self.table is None:
            object.__setattr__(self, "table", read_wheels(self.robot))
        if not isinstance(self.table, WheelTable):
            raise InvalidArgument(f"table is {shown(self.table)}, expected a WheelTable")
        mobility = self.mobility
        if self.ground is None:
            object.__setattr__(self, "ground", Rolling() if mobility.is_regular else Coulomb())
        if not isinstance(self.ground, Rolling | Coulomb):
            raise InvalidArgument(f"ground is {shown(self.ground)}, expected Rolling(...) or Coulomb(...)")
        if not (self.ground.slips or mobility.is_regular):
            raise InvalidArgument(
                f"table cannot roll without slip: {mobility.why_not}; expected a drive that can, or "
                "ground=Coulomb()"
            )
        _ = self._tree  # it checks that what is left without the wheels is a body
        if self.ground.slips:
            self._check_slipping()
        else:
            self._check_rolling()

    @cached_property
    def mobility(self) -> Mobility:
        """What the wheels let it do."""
        return Mobility.of(self.table)

    @cached_property
    def _tree(self) -> WheelTree:
        return WheelTree(self.robot, self.table, self._fall)

    @cached_property
    def _fall(self) -> Array:
        """Gravity along the axes of the plane, shape (3,) [m/s^2]."""
        g, ramp = np.array(self.robot.model.gravity.linear), self.ground.ramp
        return frozen(g) if ramp is None else ramp.fall(float(np.linalg.norm(g)))

    def _check_rolling(self) -> None:
        """Refuse steering that nothing holds and that has no inertia."""
        first = self.robot.nv
        for k in self.mobility.choice.free:
            if not self.mass_matrix(self.rest)[first + k, first + k] > 0:
                axis = self.table.axes[k]
                wheel = self.table.names[axis.wheels[0]]
                raise InvalidArgument(
                    f"{axis.name} of the table has no inertia about its axis, expected one > 0: give "
                    f"yaw_inertia of wheel {wheel!r}"
                )

    @cached_property
    def _is_massless(self) -> bool:
        """Whether wheels have no inertia, so that M is singular but for what rolls."""
        return not (np.diagonal(self.mass_matrix(self.rest))[self.robot.nv :] > 0).all()

    def _metric(self, M: Array, A: Array) -> Array:
        """Return a mass matrix that has an inverse.

        It is M, and where that has none M + m A' A, which what rolls does not feel.
        """
        return np.asarray(M + self.robot.mass * np.swapaxes(A, -1, -2) @ A) if self._is_massless else M

    def _check_slipping(self) -> None:
        """Refuse what cannot be computed on ground where wheels slip."""
        if not self.robot.grounded:
            raise InvalidArgument(
                "robot does not tell where its body's origin is above the ground, on which the loads of its "
                "wheels depend; expected one read with ground=, or ground=Rolling()"
            )
        led(self.table)
        self._check_places()
        moving = np.diagonal(self.mass_matrix(self.rest))[self.robot.nv :]
        for name, inertia in zip(
            (*(axis.name for axis in self.table.axes), *self.table.names), moving, strict=True
        ):
            if not inertia > 0:
                raise InvalidArgument(
                    f"{name} of the table has no inertia about its axis, expected one > 0 where wheels slip: "
                    "give spin_inertia, and yaw_inertia of wheels that steer"
                )

    @cached_property
    def _places(self) -> Array:
        """Where it touches the ground at steering angles zero, wheels and then supports, shape (k, 2) [m]."""
        places = [wheel.centre for wheel in self.table.wheels]
        return frozen([*places, *((each.x, each.y) for each in self.table.supports)])

    @cached_property
    def _has_area(self) -> bool:
        ones = np.ones((len(self._places), 1))
        return bool(np.linalg.matrix_rank(np.hstack([ones, self._places]), tol=_SAME_LINE) == 3)

    def _check_places(self) -> None:
        if not self._has_area:
            raise InvalidArgument(
                f"table has {len(self._places)} places where the robot stands, on one line, expected three "
                "that are not: give supports=[(x, y), ...], where casters stand"
            )

    @property
    def grounded(self) -> bool:
        """Whether the body's origin is known to lie on the ground; if not, nothing is known of its loads."""
        return self.robot.grounded

    @cached_property
    def footprint(self) -> Array | None:
        """Corners of what it stands on, wheels at steering angles zero and supports, shape (k, 2) [m].

        Counter-clockwise, in the body's frame; None where they are on one line.
        """
        corners = hull(self._places) if self._has_area else None
        return None if corners is None else frozen(corners)

    def _key(self) -> tuple[object, ...]:
        return self.robot, self.table, self.ground

    def __eq__(self, other: object) -> bool:
        return isinstance(other, WheeledRobot) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def __repr__(self) -> str:
        body = repr(self.robot).removesuffix(f" with {LOCKED}")
        return f"WheeledRobot({body}, {self.table!r}, {self.ground!r})"

    def __reduce__(self) -> tuple[object, ...]:
        return WheeledRobot, (self.robot, self.table, self.ground)

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
        robot = read_robot(path, package_dirs, ground_z, given.get("radius"), given.get("locked", ()))
        wheels = read_wheels(robot, **given) if table is None else table
        return cls(robot, wheels, ground)  # type: ignore[arg-type]

    @property
    def source(self) -> str:
        """Where its numbers come from, in words."""
        return f"{self.robot.source.replace(f'; {LOCKED}', '')}; {self.table.source}"

    @property
    def joint_signs(self) -> Mapping[str, int]:
        """Of each wheel of its file 1, or -1 where the joint there turns the other way."""
        return MappingProxyType(joint_signs(self.robot, self.table))

    def mount(self, arm: Any, at: ArrayLike | None = None, **options: Any) -> WheeledRobot:
        """Return the robot with an arm on its body: see `MobileRobot.mount`."""
        return WheeledRobot(self.robot.mount(arm, at, **options), self.table, self.ground)

    def attach(self, load: Load, frame: str | None = None) -> WheeledRobot:
        """Return the robot with a load fixed to one of its frames: see `MobileRobot.attach`."""
        return WheeledRobot(self.robot.attach(load, frame), self.table, self.ground)

    def by_voltage(self) -> ByVoltage:
        """Return the same robot whose input is volts, one per electric motor: see `ByVoltage`."""
        return ByVoltage(self)

    # Sizes and names

    @property
    def _joints(self) -> int:
        return len(self.table.axes) + len(self.table)

    @property
    def nq(self) -> int:
        """Size of q."""
        return self.robot.nq + self._joints

    @property
    def nv(self) -> int:
        """Size of v and a."""
        return self.robot.nv + self._joints

    @property
    def nu(self) -> int:
        """Size of the input."""
        return self.robot.nv - BODY_JOINT + len(self.table.actuators)

    @cached_property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Each of the nv numbers of a displacement: body, arms, steering axes, wheels."""
        axes = [Coordinate(axis.name, "rad", -axis.limit, axis.limit) for axis in self.table.axes]
        return (*self.robot.coordinates, *axes, *(Coordinate(name, "rad") for name in self.table.names))

    @cached_property
    def configuration_names(self) -> tuple[str, ...]:
        """Name of each of the nq numbers in q."""
        return (*self.robot.configuration_names, *(axis.name for axis in self.table.axes), *self.table.names)

    @cached_property
    def inputs(self) -> tuple[Input, ...]:
        """Each of the nu numbers of an input: the arms' joints, then the actuators in the table's order."""
        own = (
            Input(actuator.name, "N m", -actuator.motor.torque_limit, actuator.motor.torque_limit)
            for actuator in self.table.actuators
        )
        return (*self.robot.inputs[BODY_JOINT:], *own)

    @cached_property
    def leading(self) -> Mapping[int, int]:
        """How many numbers of q the first n coordinates have, for each n that a reference may have."""
        return MappingProxyType(dict(self.robot.leading))

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """What an ensemble may spread of its wheels; that of the body are the robot's."""
        found = []
        for attribute, unit, meaning, least in (
            ("radius", "m", "radius", 0.0),
            ("x", "m", "place forward", -np.inf),
            ("y", "m", "place to the left", -np.inf),
            ("spin_inertia", "kg m^2", "inertia about the axle", 0.0),
        ):
            for k, name in enumerate(self.table.names):
                found.append(
                    Parameter(
                        f"{attribute}_{name}",
                        unit,
                        f"{meaning} of wheel {name}",
                        least,
                        may_vanish=attribute != "radius",
                        attribute=attribute,
                        entry=k,
                    )
                )
        found.append(Parameter("mu", "", "coefficient of friction of all wheels", 0.0))
        for k, name in enumerate(self.table.names):
            meaning = f"coefficient of friction of wheel {name}"
            found.append(Parameter(f"mu_{name}", "", meaning, 0.0, attribute="mu", entry=k))
        if not self.robot.mounts:
            found.append(
                Parameter("com_z", "m", "height of the centre of mass", attribute="upright", entry=0)
            )
        sides = [wheel.y for wheel in self.table.wheels]
        if min(sides) < 0 < max(sides):
            width = max(sides) - min(sides)
            words = "largest distance between wheels to left and right, which all move in proportion"
            track = Parameter(
                "track", "m", words, 0.0, False, attribute="y", write=_Track(width), neutral=width
            )
            found.append(track)
        return tuple(found)

    def with_parameters(self, **values: ArrayLike) -> WheeledRobot:
        """Return the robot with other values of its `parameters`.

        Parameters
        ----------
        **values : float or array_like
            By the name of a parameter, or of an attribute with all its numbers, such as ``radius``.

        Raises
        ------
        InvalidArgument
            If a value is not possible, or an array has another shape.
        UnknownName
            If there is no such parameter.
        """
        named = {parameter.name: parameter for parameter in self.parameters}
        columns = {name: column.copy() for name, column in self._columns.items()}
        for name, value in values.items():
            given = finite(name, value)
            if name in columns and given.shape in ((), columns[name].shape):
                columns[name][...] = given
            elif name in named and given.ndim == 0:
                if not named[name].allows(given):
                    raise InvalidArgument(f"{name} is {given:g}, expected {named[name].bound}")
                column = named[name].attribute or name
                columns[column] = named[name].written(columns[column][None], given[None], BODY_JOINT)[0]
            else:
                one_of("parameter of a robot on wheels", name, [*named, *columns])
                raise InvalidArgument(f"{name} has shape {given.shape}, expected that of {name} of the robot")
        numbers = [columns[name].tolist() for name in _OF_WHEELS]
        wheels = [
            replace(wheel, x=x, y=y, radius=radius, spin_inertia=inertia)
            for wheel, x, y, radius, inertia in zip(self.table.wheels, *numbers, strict=True)
        ]
        frictions = zip(wheels, columns["mu"].tolist(), strict=True)
        wheels = [replace(wheel, friction=replace(wheel.friction, mu=mu)) for wheel, mu in frictions]
        robot, higher = self.robot, float(columns["upright"][0] - self._columns["upright"][0])
        if higher:
            if robot.mounts:
                raise InvalidArgument("upright is that of robots without arms, expected none with arms")
            robot = _raised(robot, higher)
        table = replace(self.table, wheels=tuple(wheels))
        return WheeledRobot(robot, table, self.ground.of_each_wheel())

    @cached_property
    def _columns(self) -> dict[str, Array]:
        found = {name: frozen([getattr(wheel, name) for wheel in self.table.wheels]) for name in _OF_WHEELS}
        mu = self.ground.mu
        found["mu"] = frozen([wheel.friction.mu if mu is None else mu for wheel in self.table.wheels])
        found["upright"] = self._upright
        return found

    @cached_property
    def _upright(self) -> Array:
        """Height of the centre of mass, and inertia xz and yz, of a robot without arms, shape (3,)."""
        if self.robot.mounts:
            return frozen(np.zeros(3))
        inertia = self.robot.lumped().model.inertias[BODY_JOINT]
        return frozen([inertia.lever[2], inertia.inertia[0, 2], inertia.inertia[1, 2]])

    @property
    def x(self) -> Array:
        """Where the wheels' pivots stand, forward, shape (wheels,) [m]."""
        return self._columns["x"]

    @property
    def y(self) -> Array:
        """Where the wheels' pivots stand, to the left, shape (wheels,) [m]."""
        return self._columns["y"]

    @property
    def radius(self) -> Array:
        """Of the wheels, shape (wheels,) [m]."""
        return self._columns["radius"]

    @property
    def spin_inertia(self) -> Array:
        """Of the wheels about their axles, shape (wheels,) [kg m^2]."""
        return self._columns["spin_inertia"]

    @property
    def mu(self) -> Array:
        """Coefficients of friction of the wheels, of rollers along their axes, shape (wheels,)."""
        return self._columns["mu"]

    @property
    def upright(self) -> Array:
        """What the ground alone feels of a robot without arms, shape (3,) [m, kg m^2, kg m^2].

        Height of the centre of mass, and inertia xz and yz about it.
        """
        return self._columns["upright"]

    # Configurations

    def _q(self, q: ArrayLike, name: str = "q") -> Array:
        array = vector(name, q, self.nq)
        self.robot.configuration(array[..., : self.robot.nq], name)
        return array

    def _v(self, name: str, value: ArrayLike) -> Array:
        return vector(name, value, self.nv)

    @cached_property
    def rest(self) -> Array:
        """Configuration at the origin, arms in their reference posture, shape (nq,)."""
        return frozen(np.append(self.robot.rest, np.zeros(self._joints)))

    def integrate(self, q: ArrayLike, dq: ArrayLike) -> Array:
        """Return the configuration that the displacement `dq` leads to from `q`, shape (..., nq)."""
        q, dq = self._q(q), self._v("dq", dq)
        lead = broadcast(q=q, dq=dq)
        own = self.robot.integrate(q[..., : self.robot.nq], dq[..., : self.robot.nv])
        with np.errstate(over="ignore"):
            rest = finite_answer(q[..., self.robot.nq :] + dq[..., self.robot.nv :], q=q, dq=dq)
        return np.concatenate([np.broadcast_to(own, (*lead, own.shape[-1])), rest], axis=-1)

    def difference(self, q0: ArrayLike, q1: ArrayLike) -> Array:
        """Return the displacement from `q0` to `q1`, shape (..., nv); that of psi lies in (-pi, pi]."""
        q0, q1 = self._q(q0, "q0"), self._q(q1, "q1")
        broadcast(q0=q0, q1=q1)
        n = self.robot.nq
        own = self.robot.difference(q0[..., :n], q1[..., :n])
        with np.errstate(over="ignore"):
            return np.concatenate([own, finite_answer(q1[..., n:] - q0[..., n:], q0=q0, q1=q1)], axis=-1)

    def pose(self, q: ArrayLike) -> Array:
        """Return x, y and psi of the body, shape (..., 3) [m, m, rad]."""
        return self._q(q)[..., :BODY_JOINT].copy()

    def rate(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return the rates of x, y and psi of the body, shape (..., 3) [m/s, m/s, rad/s]."""
        q, v = self._q(q), self._v("v", v)
        return np.array(np.broadcast_to(v[..., :BODY_JOINT], (*broadcast(q=q, v=v), BODY_JOINT)))

    def effort(self, q: ArrayLike, wrench: ArrayLike) -> Array:
        """Return the generalised force of a wrench on the body, shape (..., nv) [N, N, N m, ...]."""
        q, wrench = self._q(q), vector("wrench", wrench, BODY_JOINT)
        whole = np.zeros((*broadcast(q=q, wrench=wrench), self.nv))
        whole[..., :BODY_JOINT] = wrench
        return whole

    def _f(self, f: ArrayLike) -> Array:
        """Check generalised forces beside the input, 0 for none."""
        array = finite("f", f)
        return array if array.ndim == 0 and not array else self._v("f", array)

    def _of_axes(self, name: str, value: ArrayLike) -> Array:
        """Check numbers of the steering axes, none for zeros."""
        array, n = finite(name, value), len(self.table.axes)
        return np.zeros(n) if array.shape == (0,) else vector(name, array, n)

    # What is seen

    @property
    def mounts(self) -> tuple[Mount, ...]:
        """Its arms."""
        return self.robot.mounts

    @property
    def size(self) -> tuple[float, float, float]:
        """Length, width and height of the body [m]."""
        return self.robot.size

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

    def contacts(
        self, q: ArrayLike, v: ArrayLike, a: ArrayLike, u: ArrayLike, signals: Mapping[str, Any]
    ) -> Contacts:
        """Return what the ground does at the wheels at the samples of a run, see `Contacts`.

        Parameters
        ----------
        q, v, a, u : array_like, shape (n, ...)
            Of the samples.
        signals : mapping of str to Signal
            Of the run.
        """
        return contacts_of(
            self, self._q(q), self._v("v", v), self._v("a", a), vector("u", u, self.nu), signals
        )

    # Rolling

    def _split(self, q: Array, v: Array) -> tuple[Array, Array, Array]:
        """Return steering angles, body twist and joint rates of one state or many."""
        n, c, s = self.robot.nq, np.cos(q[..., 2]), np.sin(q[..., 2])
        twist = np.stack([c * v[..., 0] + s * v[..., 1], c * v[..., 1] - s * v[..., 0], v[..., 2]], axis=-1)
        return q[..., n : n + len(self.table.axes)], twist, v[..., self.robot.nv :]

    @cached_property
    def _kinematics(self) -> Kinematics:
        return Kinematics.of(self.table)

    @cached_property
    def _at_zero(self) -> list[Row]:
        """The rows where steering angles and rates are zero."""
        zeros = [0.0] * self._joints
        return self._kinematics.rows(zeros, [0.0] * BODY_JOINT, zeros)

    @cached_property
    def _still_rows(self) -> Array:
        """The rows along the body's axes, shape (k, nv), steering angles at zero."""
        rows = self._at_zero
        A = np.zeros((len(rows), self.nv))
        A[:, :BODY_JOINT] = [[number(x) for x in row.base] for row in rows]
        A[:, self.robot.nv :] = [[number(x) for x in row.joints] for row in rows]
        return frozen(A)

    @cached_property
    def _steered_rows(self) -> tuple[int, ...]:
        """Those that change with a steering angle."""
        steered = {row for axis in self.table.axes for row in axis.wheels}
        return tuple(i for i, row in enumerate(self._at_zero) if row.wheel in steered)

    def _rows(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return A, shape (..., k, nv), and what A v changes at where nothing accelerates, (..., k)."""
        still = self._still_rows
        c, s = np.cos(q[..., 2]), np.sin(q[..., 2])
        lead = q.shape[:-1] if v.ndim == 1 else np.broadcast_shapes(q.shape[:-1], v.shape[:-1])
        A = np.empty((*lead, *still.shape))
        A[...] = still
        w, ahead, aside = v[..., 2], c * v[..., 0] + s * v[..., 1], c * v[..., 1] - s * v[..., 0]
        drift = (w * aside)[..., None] * still[:, 0] - (w * ahead)[..., None] * still[:, 1]
        drift = drift if drift.shape[:-1] == lead else np.array(np.broadcast_to(drift, (*lead, len(still))))
        if self._steered_rows:
            n, nv, axes = self.robot.nq, self.robot.nv, len(self.table.axes)
            steering = [q[..., n + k] for k in range(axes)]
            rates = [v[..., nv + k] for k in range(self._joints)]
            rows = self._kinematics.rows(steering, [ahead, aside, w], rates)
            for i in self._steered_rows:
                for k, x in enumerate(rows[i].base):
                    A[..., i, k] = number(x)
                for k in range(axes):
                    A[..., i, nv + k] = number(rows[i].joints[k])
                drift[..., i] = number(rows[i].drift)
        x, y = A[..., 0].copy(), A[..., 1]
        c, s = c[..., None], s[..., None]
        A[..., 0], A[..., 1] = c * x - s * y, s * x + c * y
        return A, drift

    @in_numbers
    def constraint_matrix(self, q: ArrayLike) -> Array:
        """Return A(q), shape (..., k, nv): A v = 0 where the wheels roll; see `constraint_names`."""
        q = self._q(q)
        return self._rows(q, np.zeros(self.nv))[0]

    @in_numbers
    def constraint_drift(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return dA/dt v, shape (..., k) [m/s^2]: A a = -dA/dt v keeps rolling."""
        q, v = self._q(q), self._v("v", v)
        broadcast(q=q, v=v)
        return self._rows(q, v)[1]

    @cached_property
    def constraint_names(self) -> tuple[str, ...]:
        """Of each row of `constraint_matrix` its wheel and direction, such as ``"left rolling"``."""
        return tuple(
            f"{self.table.names[row.wheel]} {row.kind}" if row.wheel >= 0 else row.kind
            for row in self._at_zero
        )

    @cached_property
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

    # Dynamics

    @in_numbers
    def mass_matrix(self, q: ArrayLike) -> Array:
        """Return M(q), shape (..., nv, nv) [kg, kg m, kg m^2], by Pinocchio's CRBA, rotors included."""
        return self._tree.inertia(self._q(q))

    @in_numbers
    def nonlinear_effects(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return n(q, v), shape (..., nv) [N, N, N m, ...], by Pinocchio's RNEA."""
        q, v = self._q(q), self._v("v", v)
        broadcast(q=q, v=v)
        return self._tree.effects(q, v)

    @in_numbers
    def kinetic_energy(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return v' M(q) v / 2, shape (...) [J]."""
        q, v = self._q(q), self._v("v", v)
        broadcast(q=q, v=v)
        return np.asarray(np.einsum("...i,...ij,...j->...", v, self.mass_matrix(q), v) / 2)

    @in_numbers
    def forward_dynamics(self, q: ArrayLike, v: ArrayLike, u: ArrayLike, f: ArrayLike = 0.0) -> Array:
        """Return the acceleration, shape (..., nv) [m/s^2, ...].

        Of wheels that roll M a + n = B u + f + A' lambda and A a = -dA/dt v, solved together; where they
        slip, the mean over a short step, as dry friction has impulses and no force at an instant.

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State, which rolls.
        u : array_like, shape (..., nu)
            Torques [N m], see `inputs`.
        f : array_like, shape (..., nv), optional
            Generalised forces beside them.
        """
        if self.ground.slips:
            q, v, u = self._q(q), self._v("v", v), vector("u", u, self.nu)
            f = self._f(f)
            broadcast(q=q, v=v, u=u, **({"f": f} if f.ndim else {}))
            return np.asarray(self._traced.forward_dynamics(q, v, u, f if f.ndim else 0.0))
        return self._constrained(q, v, u, f, self._independent)[0]

    @in_numbers
    def constraint_forces(self, q: ArrayLike, v: ArrayLike, u: ArrayLike, f: ArrayLike = 0.0) -> Forces:
        """Return the forces of the ground at the wheels, and which of them rolling determines."""
        if self.ground.slips:
            raise InvalidArgument(
                "constraint_forces is asked of wheels on Coulomb ground, which no constraint holds, expected "
                "ground=Rolling(); their forces are in the signals of a run"
            )
        values = self._constrained(q, v, u, f, None)[1]
        return Forces(self.constraint_names, values, np.array(self.mobility.determined))

    @cached_property
    def _independent(self) -> list[int]:
        """Rows from which the others follow."""
        choice = self.mobility.choice
        return sorted({*choice.body, *(row for _, row in choice.joints)})

    def _constrained(
        self, q: ArrayLike, v: ArrayLike, u: ArrayLike, f: ArrayLike, rows: list[int] | None
    ) -> tuple[Array, Array]:
        """Return acceleration and constraint forces, by all rows or by some from which the others follow."""
        q, v, u, f = self._q(q), self._v("v", v), vector("u", u, self.nu), self._f(f)
        if q.ndim > 1 or v.ndim > 1 or u.ndim > 1 or f.ndim > 1:
            broadcast(q=q, v=v, u=u, **({"f": f} if f.ndim else {}))
        M, n = self._tree.inertia_and_effects(q, v)
        A, drift = self._rows(q, v)
        if rows is not None:
            A, drift = A[..., rows, :], drift[..., rows]
        M = self._metric(M, A)
        force = u @ self.input_matrix.T + f - n
        if self._is_massless:
            force = force - self.robot.mass * (np.swapaxes(A, -1, -2) @ drift[..., None])[..., 0]
        A_T = np.swapaxes(A, -1, -2)
        right = np.empty((*force.shape, 1 + A.shape[-2]))
        right[..., 0], right[..., 1:] = force, A_T
        found = np.linalg.solve(M, right)
        free, through = found[..., 0], found[..., 1:]
        wanted = -drift[..., None] - A @ free[..., None]
        G = A @ through
        if rows is None:
            multipliers: Array = np.asarray(np.linalg.pinv(G, rcond=_REDUNDANT, hermitian=True) @ wanted)
        else:
            multipliers = np.asarray(np.linalg.solve(G, wanted))
        a = free + (through @ multipliers)[..., 0]
        return finite_answer(a, q=q, v=v, u=u, f=f), multipliers[..., 0]

    # What the ground adds: a loop asks by name for what a plant can do

    def _where_it_slips(self, name: str) -> SlippingBody:
        if not self.ground.slips:
            raise AttributeError(f"a WheeledRobot on {type(self.ground).__name__} ground has no {name}")
        return self._slipping

    @property
    def project(self) -> Callable[[ArrayLike, ArrayLike], Array]:
        """``project(q, v)``: the velocity that rolls and is nearest in the mass metric, shape (..., nv)."""
        if self.ground.slips:
            raise AttributeError("a WheeledRobot whose wheels slip has no project")
        return self._projected

    @in_numbers
    def _projected(self, q: ArrayLike, v: ArrayLike) -> Array:
        q, v = self._q(q), self._v("v", v)
        M, _ = self._tree.inertia_and_effects(q, v)
        A = self._rows(q, v)[0][..., self._independent, :]
        M = self._metric(M, A)
        through = np.linalg.solve(M, np.swapaxes(A, -1, -2))
        return np.asarray(v - (through @ np.linalg.solve(A @ through, A @ v[..., None]))[..., 0])

    @in_numbers
    def reduced(self, q: ArrayLike, v: ArrayLike) -> Reduced:
        """Return the dynamics of the independent velocities, of Pinocchio's tree: see `Reduced`.

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State, which rolls.
        """
        q, v = self._q(q), self._v("v", v)
        lead = broadcast(q=q, v=v)
        q, v = (np.broadcast_to(x, (*lead, x.shape[-1])) for x in (q, v))
        rolling = self._rolling
        state = rolling.state(q, v)
        S, gamma = rolling.solution(state)
        columns = np.stack([rolling.in_plane(state, list(column), q) for column in zip(*S, strict=True)], -1)
        drift = rolling.in_plane(state, rolling.unmoved(state, S, gamma), q)
        M, n = self.mass_matrix(q), self.nonlinear_effects(q, v)
        n = n + np.einsum("...ij,...j->...i", M, drift)
        S_T = np.swapaxes(columns, -1, -2)
        nu = np.stack(np.broadcast_arrays(q[..., 0], *map(number, rolling.velocities(state)))[1:], -1)
        return Reduced(
            S_T @ M @ columns, np.einsum("...ij,...j->...i", S_T, n), S_T @ self.input_matrix, columns, nu
        )

    @in_numbers
    def inverse_dynamics(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
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
        q, v, a = self._q(q), self._v("v", v), vector("a", a, self.robot.nv)
        lead = broadcast(q=q, v=v, a=a)
        q, v, a = (np.broadcast_to(x, (*lead, x.shape[-1])) for x in (q, v, a))
        own = self.reduced(q, v)
        c, s = np.cos(q[..., 2]), np.sin(q[..., 2])
        wanted = [
            c * a[..., 0] + s * a[..., 1],
            c * a[..., 1] - s * a[..., 0],
            *np.moveaxis(a[..., 2:], -1, 0),
        ]
        # Rates of the body twist, which turns with the body.
        w, ahead, aside = (own.nu[..., k] for k in (2, 0, 1))
        wanted[:2] = [wanted[0] + w * aside, wanted[1] - w * ahead]
        force = np.einsum("...ij,...j->...i", own.M, np.stack(wanted, axis=-1)) + own.n
        return np.asarray(np.linalg.pinv(own.B) @ force[..., None])[..., 0]

    def check_inverse_dynamics(self) -> None:
        """Refuse a drive that cannot accelerate its body in every direction.

        Raises
        ------
        InvalidArgument
            With the drive's type, and what to take instead.
        """
        lead = f"robot is {self.mobility.kind}"
        if self.mobility.mobility < 3:
            raise InvalidArgument(
                f"{lead}, which cannot accelerate in every direction, so no torques are its inverse "
                "dynamics; expected an omnidirectional drive, or Backstepping(law, robot)"
            )
        still = self.reduced(self.rest, np.zeros(self.nv))
        if np.linalg.matrix_rank(still.B) < len(still.M):
            raise InvalidArgument(
                f"{lead} with {len(self.table.actuators)} motors, which cannot accelerate in every "
                "direction; expected a motor for each degree of freedom"
            )

    @in_numbers
    def independent(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return the independent velocities nu of a state that rolls, shape (..., m): see `Reduced`."""
        q, v = self._q(q), self._v("v", v)
        lead = broadcast(q=q, v=v)
        nu = map(number, self._rolling.velocities(self._rolling.state(q, v)))
        return np.stack([np.broadcast_to(x, lead) for x in nu], axis=-1)

    @in_numbers
    def torques(self, q: ArrayLike, v: ArrayLike, rates: ArrayLike) -> Array:
        """Return the input of least norm with which independent velocities change so, shape (..., nu) [N m].

        Parameters
        ----------
        q, v : array_like, shape (..., nq), (..., nv)
            State, which rolls.
        rates : array_like, shape (..., m)
            nu' of `Reduced` [m/s^2, rad/s^2].
        """
        own = self.reduced(q, v)
        rates = vector("rates", rates, own.nu.shape[-1])
        force = np.einsum("...ij,...j->...i", own.M, rates) + own.n
        return np.asarray(np.linalg.pinv(own.B) @ force[..., None])[..., 0]

    @cached_property
    def axle(self) -> Array:
        """Coefficients of the body twist in the velocity across the fixed wheels, shape (3,).

        Raises
        ------
        InvalidArgument
            If no wheel is fixed and keeps the body from moving across it.
        """
        choice = self.mobility.choice
        if not (choice.body and choice.is_fixed):
            raise InvalidArgument(f"robot is {self.mobility.kind}, which has no fixed axle")
        return frozen(self._rolling.axle)

    @cached_property
    def pivots(self) -> Array:
        """Where each axis steers a wheel, x, y, and its angle at zero, shape (axes, 3) [m, m, rad].

        Of an Ackermann pair it is the wheel in their middle.
        """
        return frozen(self._traced.pivots) if self.table.axes else frozen(np.zeros((0, 3)))

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
            if not array.ndim or array.shape[-1] < BODY_JOINT:
                raise InvalidArgument(f"{name} has shape {array.shape}, expected (..., n), n >= {BODY_JOINT}")
        broadcast(q=q, v=v)
        c, s, (a, b, arm) = np.cos(q[..., 2]), np.sin(q[..., 2]), self.axle
        return np.asarray((a * c - b * s) * v[..., 0] + (a * s + b * c) * v[..., 1] + arm * v[..., 2])

    @in_numbers
    def allocate(self, q: ArrayLike, tau: ArrayLike) -> Allocation:
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
        q, tau = self._q(q), vector("tau", tau, self.robot.nv)
        lead = broadcast(q=q, tau=tau)
        q, tau = (np.broadcast_to(x, (*lead, x.shape[-1])) for x in (q, tau))
        u, rest = np.empty((*lead, self.nu)), np.empty((*lead, self.robot.nv))
        for at in np.ndindex(lead):
            u[at], rest[at] = self._allocated(q[at], tau[at])
        return Allocation(u, rest)

    def _allocated(self, q: Array, tau: Array) -> tuple[Array, Array]:
        own = self.reduced(q, np.zeros(self.nv))
        metric = np.linalg.inv(np.linalg.cholesky(own.M))
        B, right = metric @ own.B, metric @ (own.S[: self.robot.nv].T @ tau)
        u = np.linalg.pinv(B) @ right
        lower, upper = (np.array([getattr(each, x) for each in self.inputs]) for x in ("lower", "upper"))
        if (u < lower).any() or (u > upper).any():
            from scipy.optimize import lsq_linear

            small = _LEAST_NORM * np.linalg.norm(B) * np.eye(self.nu)
            found = lsq_linear(
                np.vstack([B, small]), np.append(right, np.zeros(self.nu)), (lower, upper), tol=1e-14
            )
            u = np.clip(found.x, lower, upper)
        return u, self._missed(q, tau, u)

    def _missed(self, q: Array, tau: Array, u: Array) -> Array:
        """Return what of a force the wheels and joints do not supply, shape (..., 3 + arms)."""
        state = self._traced.state(q, np.zeros(self.nv))
        had = np.array([number(x) for x in self._traced.supplied(state, u)])
        x, y = had[:2].copy()
        had[:2] = state.c * x - state.s * y, state.s * x + state.c * y
        return np.asarray(tau - had)

    @in_numbers
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
        q, tau = self._q(q), vector("tau", tau, self.robot.nv)
        lead = broadcast(q=q, tau=tau)
        q, tau = (np.broadcast_to(x, (*lead, x.shape[-1])) for x in (q, tau))
        u, left = self._rolling.allocate_scaled(q, tau)
        return np.asarray(u), np.asarray(left)

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
        rates = map(number, self._kinematics.wheel_rates(*parts))
        return np.stack([np.broadcast_to(rate, lead) for rate in rates], axis=-1)

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

    def start(self, reference: Any) -> tuple[Array, Array]:
        """Return the q and v with which a reference begins, shape (nq,) and (nv,).

        Steered wheels point to where they go, and all roll; what the reference leaves out of the arms rests.
        """
        return self._traced.begun(*self.robot.start(reference))

    @property
    def initial_state(self) -> Callable[[Any], Grip]:
        """``initial_state(context)``: what the wheels keep before the first step, where they slip."""
        return self._where_it_slips("initial_state").initial_state

    @property
    def step(self) -> Callable[..., Step]:
        """``step(t, q, v, u, h, f, memory)``: the state a step later, where wheels slip.

        ``f(t, q, v)`` has the generalised forces beside the input, at mid-step; an array has those that stay.
        """
        self._where_it_slips("step")
        return self._stepped

    @property
    def signals(self) -> Callable[..., dict[str, tuple[str, Any]]]:
        """``signals(t, q, v, u, f, memory)``: what the ground does at the wheels, where they slip."""
        return self._where_it_slips("signals").signals

    def _stepped(
        self,
        t: float,
        q: ArrayLike,
        v: ArrayLike,
        u: ArrayLike,
        h: float,
        f: Beside | ArrayLike,
        memory: Grip,
    ) -> Step:
        q, v, u = self._q(q), self._v("v", v), vector("u", u, self.nu)
        beside = f if callable(f) else constant_force(self._f(f))
        h = positive("h", h, "s")
        if not isinstance(memory, Grip):
            raise InvalidArgument(
                f"memory is {shown(memory)}, expected what initial_state or a step returned"
            )
        return self._slipping.step(t, q, v, u, h, beside, memory)

    def check_start(self, q: ArrayLike, v: ArrayLike) -> None:
        """Refuse a start at which wheels on one gear train turn at different rates, or those that roll slip.

        Raises
        ------
        InvalidArgument
            If it is such.
        """
        q, v = self._q(q), self._v("v", v)
        broadcast(q=q, v=v)
        A = self.constraint_matrix(q)
        with np.errstate(all="ignore"):
            slips = finite_answer((A @ v[..., None])[..., 0], q=q, v=v)
        names, off = self.constraint_names, np.abs(slips).reshape(-1, A.shape[-2]).max(axis=0, initial=0.0)
        for name, slip in zip(names, off, strict=True):
            if (self.ground.slips and name != "train") or slip <= _OFF * (1 + float(np.abs(v).max())):
                continue
            if self.ground.slips:
                raise InvalidArgument(
                    f"start turns wheels of a gear train at different rates, {slip:.3g} m/s apart; expected "
                    "v0 in which they turn together"
                )
            raise InvalidArgument(
                f"start does not roll: {name} slips at {slip:.3g} m/s; expected "
                "v0 = robot.project(q0, v0), v0 of zeros, or a reference that the wheels can follow"
            )

    def traced(self) -> RollingBody | SlippingBody:
        """Return its dynamics over symbols or arrays."""
        return self._traced

    @cached_property
    def _common(self) -> dict[str, Any]:
        """What its dynamics over symbols or arrays are made of, whatever the ground."""
        return {
            **self._columns,
            "robot": self.robot.traced(),
            "table": self.table,
            "rotors": frozen([actuator.motor.reflected_inertia for actuator in self.table.actuators]),
            "fall": self._fall,
            "footprint": self.footprint,
            "stands": self.grounded and self._has_area,
            "choice": self.mobility.choice,
            "coordinates": self.coordinates,
            "inputs": self.inputs,
            "ends": tuple(self.leading.items()),
            "parameters": self.parameters,
        }

    @cached_property
    def _rolling(self) -> RollingBody:
        """The same robot on ground where it rolls."""
        if not self.mobility.is_regular:
            raise InvalidArgument(f"robot cannot roll without slip: {self.mobility.why_not}")
        return RollingBody(**self._common)

    @property
    def _traced(self) -> RollingBody | SlippingBody:
        return self._slipping if self.ground.slips else self._rolling

    @cached_property
    def _slipping(self) -> SlippingBody:
        names = ("across", "rolling", "slip")
        own: dict[str, Any] = {
            name: frozen([getattr(wheel.friction, name) for wheel in self.table.wheels]) for name in names
        }
        own |= self.ground.rounds
        return SlippingBody(**self._common, **own)


@final
@constant
@dataclass(frozen=True)
class _Track:
    """What moves all wheels of a table to the side in proportion: how a `Parameter` writes the track.

    Parameters
    ----------
    width : float
        Of the table [m].
    """

    width: float

    def __call__(self, values: Array, column: Array, size: int) -> Array:
        """Return y of the wheels, shape (m, wheels), with their tracks, shape (m,)."""
        del size
        return values * (column / self.width)[:, None]


def _raised(robot: MobileRobot, height: float) -> MobileRobot:
    """Return a robot whose body has its centre of mass higher by so much [m]."""
    body = robot.lumped().body
    com = body.com + np.array([0.0, 0.0, height])
    return robot.base.with_body(Body(body.mass, com, body.inertia), robot.source)
