"""`WheelTable`: one row per wheel describes any drive, as a Denavit-Hartenberg table describes any arm."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property, partial
from itertools import combinations
from math import cos, degrees, hypot, pi, radians, sin
from typing import Any, NamedTuple, Self, TypeAlias, final

import attrs
import numpy as np
import pinocchio as pin

from pinmobile.arrays import (
    Array,
    ArrayLike,
    bounded,
    check_integer,
    distinct,
    finite,
    frozen,
    instance,
    one_of,
    positive,
    scalar,
    sequence,
    shaped,
    text,
    word,
)
from pinmobile.errors import InvalidArgument, argument_errors, unexpected_value
from pinmobile.parts import (
    by_value,
    child,
    children,
    declare,
    entries_of,
    number,
    option,
    part,
    structure,
)
from pinmobile.robot import Entries, hull
from pinmobile.urdf import Body
from pinmobile.wheels._kinematics import Mobility
from pinmobile.wheels._motors import Motor

_SAME_PLACE = 1e-6  # [m]
_NAME_CHECK = partial(word, excluded='/,":.')
_OF_BODY = "x", "y", "psi"
_MAX_WHEELS = 1000  # largest number of wheels on a circle
_Places: TypeAlias = Iterable[ArrayLike]
FIXED, DRIVEN, FREE = "fixed", "driven", "free"
_STEERING = (FIXED, DRIVEN, FREE)
_LARGEST_ROLLER = radians(89)  # closer to a right angle, the wheel can hardly drive
TORQUE = Motor()  # torque source without limits


@final
@part
@by_value
class WheelFriction:
    """Dry friction between a wheel and the ground, and rolling resistance of the wheel.

    The defaults are usual magnitudes, not measurements.

    Parameters
    ----------
    mu : float
        Coefficient of friction, >= 0: of a tyre in all directions, of a wheel with rollers along their axes.
    across : float
        Coefficient of friction across the axes of rollers, which turn in their bearings, >= 0.
    rolling : float
        Rolling resistance relative to the load, >= 0: a torque of at most ``rolling * radius * load`` holds
        the wheel at rest.
    slip : float
        Slip velocity per force before the wheel slides, >= 0 [m/(N s)]; 0: Coulomb's law.

    Raises
    ------
    InvalidArgument
        If a number is not finite or not in its range.

    See Also
    --------
    Coulomb : ground with dry friction
    wheels.Wheel : row of a wheel table

    Examples
    --------
    >>> from pinmobile import WheelTable
    >>> from pinmobile.wheels import WheelFriction
    >>> ice = WheelFriction(mu=0.1)
    >>> table = WheelTable.differential(0.4, 0.1, friction=ice)
    >>> [wheel.friction.mu for wheel in table.wheels]
    [0.1, 0.1]
    """

    mu: float = number(default=0.8, lower=0, doc="coefficient of friction")
    across: float = number(default=0.02, lower=0, doc="coefficient of friction across rollers")
    rolling: float = number(default=0.01, lower=0, doc="rolling resistance per load")
    slip: float = number(default=0.0, lower=0, unit="m/(N s)", doc="slip velocity per force")


@final
@part
@by_value
class Wheel:
    """Row of a wheel table.

    At a positive rate the wheel rolls along e = (cos angle, sin angle) in the body's frame. The direction n,
    a quarter turn to the left of e, is parallel to its axle.

    Parameters
    ----------
    name : str
        Name of the wheel and of its coordinate in q.
    x, y : float
        Position of the steering pivot in the body's frame, or of the centre of a wheel that does not steer
        [m].
    radius : float
        Radius, > 0 [m].
    angle : float
        Angle of the rolling direction e from the body's x axis [rad]; for a steered wheel, at steering angle
        zero.
    steering : str
        ``"fixed"``; ``"driven"`` by an actuator about the vertical axis of the pivot; ``"free"``, as casters.
    trail : sequence of 2 floats
        Position of the centre relative to the pivot along e and n [m]; the first entry of a caster is
        negative.
    roller : float, optional
        Angle from e to the axis of the roller at the ground [rad]; None: a tyre. It is 0 for an omni wheel,
        and pi / 4 or -pi / 4 for a mecanum wheel, the mirror image of the view from above.
    mass : float
        Mass, >= 0 [kg], a part of the robot's mass.
    spin_inertia, yaw_inertia : float
        Inertia about the axle, and about the vertical through the centre, >= 0 [kg m^2]; `motor` contains the
        inertia of its rotor.
    motor : Motor, optional
        Motor that drives the wheel; None: the wheel is passive.
    friction : WheelFriction
        Dry friction at the ground and rolling resistance of this wheel.
    steering_limit : float
        Largest steering angle to either side, > 0 [rad]: a stop without rebound. The angle may exceed it by
        the motion of one step.

    Raises
    ------
    InvalidArgument
        If a number is not finite or not in its range, or a name contains a forbidden character.

    See Also
    --------
    WheelTable : table of wheels
    wheels.Support : support without a wheel
    Motor : motor of a wheel

    Examples
    --------
    >>> from pinmobile import WheelTable
    >>> from pinmobile.wheels import Wheel
    >>> caster = Wheel("caster", x=-0.3, y=0.0, radius=0.05,
    ...                steering="free", trail=(-0.03, 0.0))
    >>> print(f"{caster.centre[0]:.2f} m")
    -0.33 m
    """

    name: str = option(check=_NAME_CHECK)
    x: float = number(unit="m", doc="position forward")
    y: float = number(unit="m", doc="position to the left")
    radius: float = number(unit="m", above=0, doc="radius")
    angle: float = number(default=0.0, unit="rad", fixed=True, doc="angle of the rolling direction")
    steering: str = option(default=FIXED, check=lambda name, value: one_of(name, value, _STEERING))
    trail: tuple[float, float] = declare(
        Entries("centre relative to the pivot, along and across", "m", shapes=((2,),), fixed=True, length=2),
        (0.0, 0.0),
    )
    roller: float | None = number(
        default=None,
        unit="rad",
        fixed=True,
        lower=-_LARGEST_ROLLER,
        upper=_LARGEST_ROLLER,
        doc="angle of the rollers' axes",
    )
    mass: float = number(default=0.0, unit="kg", lower=0, fixed=True, doc="mass")
    spin_inertia: float = number(default=0.0, unit="kg m^2", lower=0, doc="inertia about the axle")
    yaw_inertia: float = number(
        default=0.0, unit="kg m^2", lower=0, fixed=True, doc="inertia about the vertical through its centre"
    )
    motor: Motor | None = child(Motor, default=None, expected="a Motor")
    friction: WheelFriction = child(WheelFriction, default=WheelFriction(), expected="a WheelFriction")
    steering_limit: float = number(
        default=np.inf, unit="rad", above=0, fixed=True, doc="largest steering angle"
    )

    @property
    def centre(self) -> tuple[float, float]:
        """Position of the centre in the body's frame at steering angle zero [m]."""
        c, s = cos(self.angle), sin(self.angle)
        forward, left = self.trail
        return self.x + forward * c - left * s, self.y + forward * s + left * c

    @property
    def placement(self) -> pin.SE3:
        """Pose of the centre in the body's frame at steering angle zero, with y along the axle."""
        return pin.SE3(pin.utils.rotate("z", self.angle), np.array([*self.centre, self.radius]))

    @property
    def inertia(self) -> pin.Inertia:
        """Inertia about the centre, with y along the axle."""
        moments = np.diag([self.yaw_inertia, self.spin_inertia, self.yaw_inertia])
        return pin.Inertia(self.mass, np.zeros(3), moments)


@final
@part
@by_value
class Support:
    """Support without friction, such as a ball caster: it carries load only.

    Parameters
    ----------
    x, y : float
        Contact point on the ground in the body's frame [m].

    Raises
    ------
    InvalidArgument
        If a number is not finite.

    See Also
    --------
    WheelTable : table with wheels and supports

    Examples
    --------
    >>> from pinmobile import WheelTable
    >>> from pinmobile.wheels import Support, Wheel
    >>> left = Wheel("left", x=0.0, y=0.2, radius=0.1)
    >>> right = Wheel("right", x=0.0, y=-0.2, radius=0.1)
    >>> table = WheelTable([left, right], [Support(-0.3, 0.0)])
    >>> table.footprint.round(2).tolist()  # [m]
    [[-0.3, 0.0], [0.0, -0.2], [0.0, 0.2]]
    """

    x: float = number(unit="m", fixed=True, doc="position forward")
    y: float = number(unit="m", fixed=True, doc="position to the left")


def _names(count: int) -> Any:
    """Return the check of a field of wheel names."""

    def check(name: str, value: Any) -> tuple[str, ...]:
        items = sequence(name, value, f"names of wheels, {count} or more", count)
        names = tuple(text(f"one of {name}", one) for one in items)
        distinct(f"{name} has", names)
        return names

    return check


@final
@part
@by_value
class GearTrain:
    """Wheels that turn together by a chain or gears, as on one side of a skid-steer base.

    Parameters
    ----------
    wheels : sequence of str
        Names of two or more wheels.
    ratios : sequence of floats, optional
        Rate of each wheel, relative to each other; default: equal rates.

    Raises
    ------
    InvalidArgument
        If names are not different, or there is not one ratio other than zero per wheel.

    See Also
    --------
    wheels.DifferentialGear : gear with equal torques
    WheelTable : table with couplings

    Examples
    --------
    >>> from pinmobile import WheelTable
    >>> table = WheelTable.skid_steer(0.4, 0.3, 0.1)
    >>> [train.wheels for train in table.couplings]
    [('front_left', 'rear_left'), ('front_right', 'rear_right')]
    """

    wheels: tuple[str, ...] = option(check=_names(2))
    ratios: tuple[float, ...] = option(
        default=attrs.Factory(lambda train: (1.0,) * len(train.wheels), takes_self=True),
        check=lambda name, value: tuple(np.ravel(finite(name, value)).tolist()),
    )

    def check(self) -> None:
        """Raise `InvalidArgument` if there is not one ratio per wheel."""
        if len(self.ratios) != len(self.wheels) or not all(self.ratios):
            raise unexpected_value("ratios", self.ratios, f"{len(self.wheels)} numbers other than zero")


@final
@part
@by_value
class DifferentialGear:
    """Open differential: a motor turns at the mean rate of two wheels, with equal torques on both.

    Parameters
    ----------
    wheels : sequence of 2 str
        Names of the wheels.
    motor : Motor
        Motor of the gear.
    name : str
        Name of the input.

    Raises
    ------
    InvalidArgument
        If names are not different, or an argument is of another kind.

    See Also
    --------
    wheels.GearTrain : gear with equal rates
    WheelTable : its constructor `car` uses this gear

    Examples
    --------
    >>> from pinmobile import Motor, WheelTable
    >>> from pinmobile.wheels import DifferentialGear
    >>> motor = Motor(torque_limit=20.0)
    >>> car = WheelTable.car(0.5, 0.4, radius=0.1, motor=motor)
    >>> rear = "rear_left", "rear_right"
    >>> car.couplings[0] == DifferentialGear(rear, motor, "drive")
    True
    """

    wheels: tuple[str, ...] = option(check=_names(2))
    motor: Motor = child(Motor, default=TORQUE, expected="a Motor")
    name: str = option(default="differential", check=_NAME_CHECK)


@final
@part
@by_value
class AckermannSteering:
    """Wheels that one steering angle turns so that all axles meet in one point.

    The angle is that of a virtual wheel in the middle, at y = 0 and the same x.

    Parameters
    ----------
    wheels : sequence of str
        Names of steered wheels, whose centres lie on their pivots.
    axle : float
        x of the fixed axle, on whose line all axles meet [m].
    name : str
        Name of the steering coordinate.

    Raises
    ------
    InvalidArgument
        If names are not different, or a number is not finite; in a table, if the wheels do not fit.

    See Also
    --------
    WheelTable : its constructor `car` uses this steering
    Backstepping : controller of cars

    Examples
    --------
    >>> from pinmobile import WheelTable
    >>> car = WheelTable.car(wheelbase=0.5, track=0.4, radius=0.1)
    >>> car.couplings[1].wheels, car.axes[0].name
    (('front_left', 'front_right'), 'steering')
    """

    wheels: tuple[str, ...] = option(check=_names(1))
    axle: float = number(default=0.0, unit="m", fixed=True, doc="position of the fixed axle, forward")
    name: str = option(default="steering", check=_NAME_CHECK)


Coupling = GearTrain | DifferentialGear | AckermannSteering


class Axis(NamedTuple):
    """Steering coordinate.

    Attributes
    ----------
    name : str
        Name of the coordinate.
    wheels : tuple of int
        Rows of the steered wheels.
    ackermann : float or None
        x of the axle on whose line all axles meet [m]; None: the angle of one wheel.
    driven : bool
        Whether an actuator turns it.
    limit : float
        Largest angle to either side [rad].
    """

    name: str
    wheels: tuple[int, ...]
    ackermann: float | None
    driven: bool
    limit: float


class Actuator(NamedTuple):
    """Input of a drive.

    Attributes
    ----------
    name : str
        Name of the input.
    motor : Motor
        Motor; for a steering axis a torque source without limits.
    column : tuple of floats
        Generalised force on each steering coordinate and then each wheel per torque; also the rate of the
        motor per rate of these.
    path : str
        Path of the motor in the table, such as ``"wheels.left.motor"``; "" for a steering axis.
    """

    name: str
    motor: Motor
    column: tuple[float, ...]
    path: str = ""


@final
@part
@by_value
class WheelTable:
    """Wheels of a drive, with additional supports and couplings.

    Parameters
    ----------
    wheels : sequence of Wheel
        One row per wheel.
    supports : sequence of Support
        Supports beside the wheels.
    couplings : sequence of GearTrain, DifferentialGear or AckermannSteering
        Couplings of wheels, which hold whatever the friction.
    source : str
        Origin of the numbers as text; equality of tables ignores it.

    Raises
    ------
    InvalidArgument
        If there are no wheels, two have one name or position, a name is that of a body coordinate, or a
        coupling does not fit the wheels.

    See Also
    --------
    WheeledRobot : robot on the wheels of a table
    wheels.Wheel : row of a table
    wheels.read_wheels : table from a URDF

    Examples
    --------
    >>> from pinmobile import WheelTable
    >>> table = WheelTable.mecanum(0.4, track=0.3, radius=0.1)
    >>> print(str(table.mobility).splitlines()[0])
    type (3, 0), omnidirectional: mobility 3, steerability 0
    >>> len(WheelTable.swerve([(0.3, 0), (-0.3, 0)], 0.1).actuators)
    4
    """

    wheels: tuple[Wheel, ...] = children(Wheel, expected="Wheel(...)")
    supports: tuple[Support, ...] = children(Support, default=(), expected="Support(x, y)")
    couplings: tuple[Coupling, ...] = children(
        (GearTrain, DifferentialGear, AckermannSteering),
        default=(),
        expected="GearTrain, DifferentialGear or AckermannSteering",
    )
    source: str = option(default="wheels made from numbers", check=text, eq=False)

    def check(self) -> None:
        """Raise `InvalidArgument` if there are no wheels, or names, positions or couplings do not fit."""
        sequence("wheels", self.wheels, "one Wheel(...) or more", 1)
        _check_places(self.wheels, self.supports)
        for coupling in self.couplings:
            for name in coupling.wheels:
                one_of(f"wheel of a {type(coupling).__name__}", name, self.names)
            if isinstance(coupling, AckermannSteering):
                self._check_axle(coupling)
        distinct("table has the coordinate", [*_OF_BODY, *self.names, *(axis.name for axis in self.axes)])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the wheels."""
        return tuple(wheel.name for wheel in self.wheels)

    def __len__(self) -> int:
        return len(self.wheels)

    def __repr__(self) -> str:
        rows = f"[{', '.join(map(repr, self.wheels))}]"
        fields = {"supports": self.supports, "couplings": self.couplings}
        given = "".join(f", {key}={list(value)!r}" for key, value in fields.items() if value)
        return f"WheelTable({rows}{given})"

    def __str__(self) -> str:
        """Return the rows, the couplings, and the capabilities of the drive, see `Mobility`."""
        rows: list[tuple[str, ...]] = [
            ("wheel", "x [m]", "y [m]", "radius [m]", "rolls to", "steering", "rollers at", "motor")
        ]
        rows += [_format_row(wheel) for wheel in self.wheels]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
        if self.supports:
            places = ", ".join(f"({each.x:.4g}, {each.y:.4g}) m" for each in self.supports)
            lines.append(f"supports without friction: {places}")
        lines += [f"{type(each).__name__} of {', '.join(each.wheels)}" for each in self.couplings]
        return "\n".join([*lines, str(self.mobility)])

    @structure
    def axes(self) -> tuple[Axis, ...]:
        """Steering coordinates, in the order of the table."""
        pairs = [each for each in self.couplings if isinstance(each, AckermannSteering)]
        steerings = {name: each for each in pairs for name in each.wheels}
        axes: dict[Any, Axis] = {}
        for row, wheel in enumerate(self.wheels):
            is_driven, pair = wheel.steering == DRIVEN, steerings.get(wheel.name)
            if pair is not None:
                rows = tuple(self.names.index(name) for name in pair.wheels)
                limit = min(self.wheels[k].steering_limit for k in rows)
                is_driven = self.wheels[rows[0]].steering == DRIVEN
                axes.setdefault(pair, Axis(pair.name, rows, pair.axle, is_driven, limit))
            elif wheel.steering != FIXED:
                axes[row] = Axis(f"{wheel.name}_steering", (row,), None, is_driven, wheel.steering_limit)
        return tuple(axes.values())

    def _check_axle(self, steering: AckermannSteering) -> None:
        """Check that wheels fit an Ackermann steering."""
        wheels = [self.wheels[self.names.index(name)] for name in steering.wheels]
        first, axle = wheels[0], steering.axle
        for wheel in wheels:
            fits = wheel.steering != FIXED and wheel.x != axle and not (any(wheel.trail) or wheel.angle)
            if not fits or (wheel.steering, wheel.x) != (first.steering, first.x):
                raise InvalidArgument(
                    f"wheel {wheel.name!r} of AckermannSteering(...) is {wheel!r}, expected a steered wheel "
                    f"with angle 0, trail (0, 0) and the x of the others, away from the axle at {axle:g} m"
                )

    @cached_property
    def trains(self) -> list[tuple[int, int, float]]:
        """First wheel, other wheel, and their rate ratio, for each other wheel of the gear trains."""
        trains = []
        for train in self.couplings:
            if isinstance(train, GearTrain):
                first, *others = (self.names.index(name) for name in train.wheels)
                ratios = (ratio / train.ratios[0] for ratio in train.ratios[1:])
                trains += [(first, row, ratio) for row, ratio in zip(others, ratios, strict=True)]
        return trains

    @structure
    def mobility(self) -> Mobility:
        """Motions that the wheels allow."""
        return Mobility(self)

    @cached_property
    def actuators(self) -> tuple[Actuator, ...]:
        """Inputs in the order of the table: for each row its wheel's, then its steering axis's."""
        ns, actuators = len(self.axes), list[Actuator]()

        def add(name: str, motor: Motor, joints: Sequence[int], path: str = "") -> None:
            column = tuple(1 / len(joints) if k in joints else 0.0 for k in range(ns + len(self)))
            actuators.append(Actuator(name, motor, column, path))

        for row, wheel in enumerate(self.wheels):
            if wheel.motor is not None:
                add(wheel.name, wheel.motor, [ns + row], f"wheels.{wheel.name}.motor")
            for key, each in entries_of(self.couplings):
                rows = [self.names.index(name) for name in each.wheels]
                if isinstance(each, DifferentialGear) and min(rows) == row:
                    add(each.name, each.motor, [ns + k for k in rows], f"couplings.{key}.motor")
            for k, axis in enumerate(self.axes):
                if axis.driven and axis.wheels[0] == row:
                    add(axis.name, TORQUE, [k])
        return tuple(actuators)

    @structure
    def footprint(self) -> Array | None:
        """Corners of the support polygon of wheels at steering angles zero and supports, shape (k, 2) [m].

        They are counter-clockwise, in the body's frame; None if all contacts lie on one line.
        """
        places = [*(wheel.centre for wheel in self.wheels), *((each.x, each.y) for each in self.supports)]
        rank = np.linalg.matrix_rank(np.column_stack([np.ones(len(places)), places]), tol=_SAME_PLACE)
        corners = hull(np.array(places)) if rank == 3 else None
        return None if corners is None else frozen(corners)

    def taken_from(self, body: pin.Inertia) -> pin.Inertia:
        """Return the inertia of a body without its wheels.

        Parameters
        ----------
        body : pin.Inertia
            Inertia of the whole robot with wheels at their table angles, about the body's origin.

        Raises
        ------
        InvalidArgument
            If the wheels are heavier than the robot, or the rest is not a rigid body.
        """
        heavy, rest = sum(wheel.mass for wheel in self.wheels), pin.Inertia(body)
        if body.mass <= heavy:
            raise InvalidArgument(
                f"robot has a mass of {body.mass:.6g} kg, and its wheels {heavy:.6g} kg; expected the mass "
                "of the whole robot, with its wheels"
            )
        for wheel in self.wheels:
            rest -= wheel.placement.act(wheel.inertia)
        words = "; expected a robot whose mass and inertia include those of its wheels"
        with argument_errors("robot without its wheels is not a rigid body: ", words):
            Body(rest.mass, np.array(rest.lever), np.array(rest.inertia))
        return rest

    @classmethod
    def differential(
        cls, track: float, radius: float, *, x: float = 0.0, supports: _Places = (), **wheel: Any
    ) -> Self:
        """Return a table of two driven wheels on one axle, ``left`` and ``right``.

        Parameters
        ----------
        track : float
            Distance between the wheels, > 0 [m].
        radius : float
            Radius of the wheels, > 0 [m].
        x : float
            Position of the axle in the body's frame [m].
        supports : iterable of (x, y)
            Positions of casters without friction [m].
        **wheel
            Other parameters of each `wheels.Wheel`: ``mass``, ``spin_inertia``, ``yaw_inertia``,
            ``friction``, ``motor``; default: a torque source.
        """
        half, fields = positive("track", track, "m") / 2, {"motor": TORQUE, **wheel}
        rows = (Wheel(name, x, y, radius, **fields) for name, y in (("left", half), ("right", -half)))
        return cls(tuple(rows), _supports(supports))

    @classmethod
    def skid_steer(
        cls, wheelbase: float, track: float, radius: float, *, coupled: bool = True, **wheel: Any
    ) -> Self:
        """Return a table of four fixed wheels; the robot turns by skidding.

        Parameters
        ----------
        wheelbase : float
            Distance between the axles, > 0 [m].
        track : float
            Distance between the wheels of an axle, > 0 [m].
        radius : float
            Radius of the wheels, > 0 [m].
        coupled : bool
            Whether each side has one motor, at the front, and a gear train; otherwise each wheel has a motor.
        **wheel
            Other parameters of each `wheels.Wheel`: ``mass``, ``spin_inertia``, ``yaw_inertia``,
            ``friction``, ``motor`` of each side or wheel.
        """
        instance("coupled", coupled, bool, "True or False")
        data = {"motor": TORQUE, **wheel}
        rear = data | {"motor": None} if coupled else data
        places = _corners(wheelbase, track)
        rows = [Wheel(*item, radius, **(rear if item[0].startswith("rear") else data)) for item in places]
        sides = ("left", "right") if coupled else ()
        return cls(tuple(rows), (), tuple(GearTrain((f"front_{side}", f"rear_{side}")) for side in sides))

    @classmethod
    def mecanum(
        cls, wheelbase: float, track: float, radius: float, *, roller: float = pi / 4, **wheel: Any
    ) -> Self:
        """Return a table of four mecanum wheels whose rollers form an X in the view from above.

        Parameters
        ----------
        wheelbase : float
            Distance between the axles, > 0 [m].
        track : float
            Distance between the wheels of an axle, > 0 [m].
        radius : float
            Radius of the wheels, > 0 [m].
        roller : float
            Angle of the rollers [rad]: positive for the X arrangement, negative for the O arrangement, which
            cannot turn on a square base.
        **wheel
            Other parameters of each `wheels.Wheel`: ``mass``, ``spin_inertia``, ``yaw_inertia``,
            ``friction``, ``motor``; default: a torque source.

        Raises
        ------
        InvalidArgument
            If the base could not turn or not move sideways, or a number is not in its range.
        """
        angle, fields = scalar("roller", roller), {"motor": TORQUE, **wheel}
        turns = angle > 0 or abs(wheelbase - track * abs(np.tan(angle))) >= 1e-3 * track
        if not (angle and turns):
            flaw = "form an O whose axes meet in the middle, so that the base cannot turn"
            flaw = flaw if angle else "have axes along x, so that the base cannot move sideways"
            raise InvalidArgument(
                f"roller is {angle:g} rad on a base of {wheelbase:g} by {track:g} m: the rollers {flaw}; "
                "expected the X arrangement, a positive angle, or WheelTable.omni(...)"
            )
        signs = {"front_left": -1, "front_right": 1, "rear_left": 1, "rear_right": -1}
        places = _corners(wheelbase, track)
        return cls(tuple(Wheel(*place, radius, roller=signs[place[0]] * angle, **fields) for place in places))

    @classmethod
    def omni(cls, distance: float, radius: float, *, n: int = 3, first: float = 0.0, **wheel: Any) -> Self:
        """Return a table of omni wheels on a circle, with their axles through its centre.

        Parameters
        ----------
        distance, radius : float
            Distance of the wheels from the centre, and their radius, > 0 [m].
        n : int
            Number of wheels, >= 3.
        first : float
            Angle of the first wheel's position from the body's x axis [rad].
        **wheel
            Other parameters of each `wheels.Wheel`: ``mass``, ``spin_inertia``, ``yaw_inertia``,
            ``friction``, ``motor``; default: a torque source.
        """
        count, L = check_integer("n", n, least=3, most=_MAX_WHEELS), positive("distance", distance, "m")
        angles = (scalar("first", first) + 2 * pi * np.arange(count) / count).tolist()
        fields: dict[str, Any] = {"roller": 0.0, "motor": TORQUE, **wheel}
        places = [(f"wheel_{k}", L * cos(a), L * sin(a), radius, a + pi / 2) for k, a in enumerate(angles, 1)]
        return cls(tuple(Wheel(*place, **fields) for place in places))

    @classmethod
    def swerve(cls, places: _Places, radius: float, *, supports: _Places = (), **wheel: Any) -> Self:
        """Return a table of modules that steer and drive.

        Parameters
        ----------
        places : iterable of (x, y)
            Positions of the modules [m].
        radius : float
            Radius of the wheels, > 0 [m].
        supports : iterable of (x, y)
            Positions of casters without friction [m].
        **wheel
            Other parameters of each `wheels.Wheel`: ``mass``, ``spin_inertia``, ``yaw_inertia``,
            ``friction``, ``motor`` of the drive; default: a torque source.
        """
        data: dict[str, Any] = {"steering": DRIVEN, "motor": TORQUE, **wheel}
        rows = [Wheel(f"wheel_{k}", *xy, radius, **data) for k, xy in enumerate(each_of("places", places), 1)]
        return cls(tuple(rows), _supports(supports))

    @classmethod
    def car(
        cls,
        wheelbase: float,
        track: float,
        radius: float,
        *,
        motor: Motor = TORQUE,
        steering_limit: float = radians(40),
        **wheel: Any,
    ) -> Self:
        """Return a table of a car: rear wheels on an open differential, front wheels with Ackermann steering.

        The body's origin is the middle of the rear axle.

        Parameters
        ----------
        wheelbase : float
            Distance between the axles, > 0 [m].
        track : float
            Distance between the wheels of an axle, > 0 [m].
        radius : float
            Radius of the wheels, > 0 [m].
        motor : Motor
            Motor of the rear axle.
        steering_limit : float
            Largest steering angle to either side, in (0, pi / 2) [rad].
        **wheel
            Other parameters of each `wheels.Wheel`: ``mass``, ``spin_inertia``, ``yaw_inertia``,
            ``friction``.
        """
        L, half = positive("wheelbase", wheelbase, "m"), positive("track", track, "m") / 2
        limit = scalar("steering_limit", steering_limit)
        bounded("steering_limit", limit, above=0, below=pi / 2, unit="rad")
        front: dict[str, Any] = {"steering": DRIVEN, "steering_limit": limit}
        axles = ("rear", 0.0, wheel), ("front", L, front | wheel)
        sides = ("left", half), ("right", -half)
        rows = [Wheel(f"{end}_{side}", x, y, radius, **data) for end, x, data in axles for side, y in sides]
        drive = DifferentialGear(("rear_left", "rear_right"), motor, "drive")
        return cls(tuple(rows), (), (drive, AckermannSteering(("front_left", "front_right"))))


def _format_row(wheel: Wheel) -> tuple[str, ...]:
    """Return a row of the printed table."""
    return (
        wheel.name,
        *(f"{number:.4g}" for number in (wheel.x, wheel.y, wheel.radius)),
        f"{degrees(wheel.angle):.4g} deg",
        wheel.steering,
        "" if wheel.roller is None else f"{degrees(wheel.roller):.4g} deg",
        "" if wheel.motor is None else "yes",
    )


def _check_places(wheels: Sequence[Wheel], supports: Sequence[Support]) -> None:
    """Check that no two wheels or supports have the same position."""
    places = [(f"wheel {wheel.name!r}", *wheel.centre) for wheel in wheels]
    places += [(f"support {k + 1}", each.x, each.y) for k, each in enumerate(supports)]
    for (other, x0, y0), (name, x, y) in combinations(places, 2):
        if hypot(x - x0, y - y0) < _SAME_PLACE:
            raise InvalidArgument(f"{other} and {name} have one position, ({x:g}, {y:g}) m, expected two")


def _corners(wheelbase: float, track: float) -> list[tuple[str, float, float]]:
    """Return names and positions of four wheels at the corners of a rectangle."""
    a, b = positive("wheelbase", wheelbase, "m") / 2, positive("track", track, "m") / 2
    return [("front_left", a, b), ("front_right", a, -b), ("rear_left", -a, b), ("rear_right", -a, -b)]


def each_of(name: str, given: object) -> list[tuple[float, float]]:
    """Return positions in the plane.

    Parameters
    ----------
    name : str
        Name of the argument, for the error message.
    given : iterable of (x, y)
        The argument [m].

    Raises
    ------
    InvalidArgument
        If it is not a sequence of pairs of finite numbers.
    """
    rows = given.tolist() if isinstance(given, np.ndarray) else given
    pairs = ((f"{name}[{k}]", xy) for k, xy in enumerate(sequence(name, rows, "(x, y) of each [m]")))
    places = (shaped(label, finite(label, xy), (2,), words=": x and y of each [m]") for label, xy in pairs)
    return [(float(x), float(y)) for x, y in places]


def _supports(places: object) -> tuple[Support, ...]:
    """Return supports at positions."""
    return tuple(Support(*place) for place in each_of("supports", places))
