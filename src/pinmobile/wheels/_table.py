"""`WheelTable`: one row per wheel describes any drive, as a Denavit-Hartenberg table describes any arm."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
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
    finite,
    frozen,
    instance,
    one_of,
    positive,
    scalar,
    sequence,
    shaped,
    text,
    whole,
)
from pinmobile.errors import InvalidArgument, shown
from pinmobile.parts import (
    Number,
    by_value,
    child,
    children,
    declare,
    entries_of,
    is_symbolic,
    number,
    option,
    part,
    structure,
)
from pinmobile.robot import hull
from pinmobile.urdf import Body
from pinmobile.wheels._kinematics import Mobility
from pinmobile.wheels._motors import Motor

_SAME_PLACE = 1e-6  # [m]
_OF_BODY = "x", "y", "psi"
_MOST = 1000  # wheels of a circle
_Places: TypeAlias = Iterable[ArrayLike]
FIXED, DRIVEN, FREE = "fixed", "driven", "free"
_STEERING = (FIXED, DRIVEN, FREE)
_LARGEST_ROLLER = 89.0  # degrees: nearer to 90, a turn of the wheel moves next to nothing along the rollers
TORQUE = Motor()  # a source of torque without limits


@final
@part
@by_value
class WheelFriction:
    """Dry friction between a wheel and the ground, and in the wheel.

    The defaults are usual magnitudes, not measurements.

    Parameters
    ----------
    mu : float
        Coefficient of friction: of a tyre in all directions, of a wheel with rollers along their axes.
    across : float
        That across the axes of rollers, which turn in their bearings.
    rolling : float
        Rolling resistance as a share of the load: a torque of at most ``rolling * radius * load`` that holds
        the wheel at rest.
    slip : float
        Slip velocity per force before the wheel slides [m/(N s)]; 0: none, which is Coulomb's law.
    """

    mu: float = number(default=0.8, lower=0, doc="coefficient of friction")
    across: float = number(default=0.02, lower=0, fixed=True, doc="coefficient of friction across rollers")
    rolling: float = number(default=0.01, lower=0, fixed=True, doc="rolling resistance per load")
    slip: float = number(default=0.0, lower=0, unit="m/(N s)", fixed=True, doc="slip velocity per force")


@attrs.frozen
class _Two(Number):
    """Declaration of two numbers that are kept as a tuple."""

    def checked(self, name: str, value: Any) -> Any:
        """Return a tuple of floats."""
        return tuple(super().checked(name, value).tolist())


def _checked_name(name: str, value: Any) -> str:
    checked = text(name, value)
    if not checked.strip() or set('/,":.') & set(checked):
        raise InvalidArgument(
            f"{name} is {shown(checked)}, expected a word without slash, comma, colon, dot and quotation mark"
        )
    return checked


@final
@part
@by_value
class Wheel:
    """One row of a wheel table.

    The wheel rolls along e = (cos angle, sin angle) of the body's frame where its rate is positive; n, a
    quarter of a turn to the left of e, is the direction of its axle.

    Parameters
    ----------
    name : str
        Its own; its coordinate is called so.
    x, y : float
        Where its steering pivot stands in the body's frame, or its centre where it does not steer [m].
    radius : float
        [m].
    angle : float
        Of its rolling direction e from the body's x [rad]; where it steers, at steering angle zero.
    steering : str
        ``"fixed"``; ``"driven"`` by an actuator about the vertical through its pivot; ``"free"``, as casters.
    trail : sequence of 2 floats
        Its centre from the pivot along e and n [m]; a caster trails: the first is negative.
    roller : float, optional
        Angle of the axis of the roller that is at the ground, from e [rad]; None: a tyre. Of an omni wheel 0,
        of a mecanum wheel pi / 4 or -pi / 4, the mirror of what is seen from above.
    mass : float
        [kg], part of the robot's whole.
    spin_inertia, yaw_inertia : float
        About the axle, and about the vertical through its centre [kg m^2]; what a motor's rotor adds is in
        `motor`.
    motor : Motor, optional
        What drives it; None: nothing, it only rolls along.
    friction : WheelFriction
        Of its own.
    steering_limit : float
        Largest steering angle, to either side [rad]: a stop without rebound, found to what turns in a step.

    Raises
    ------
    InvalidArgument
        If a number is not finite or not in its range, or a name is none.
    """

    name: str = option(check=_checked_name)
    x: float = number(unit="m", doc="place forward")
    y: float = number(unit="m", doc="place to the left")
    radius: float = number(unit="m", above=0, doc="radius")
    angle: float = number(default=0.0, unit="rad", fixed=True, doc="angle of the rolling direction")
    steering: str = option(default=FIXED, check=lambda name, value: one_of(name, value, _STEERING))
    trail: tuple[float, float] = declare(
        _Two("centre from the pivot, along and across", "m", shapes=((2,),), fixed=True), (0.0, 0.0)
    )
    roller: float | None = number(
        default=None, unit="rad", optional=True, fixed=True, doc="angle of the rollers' axes"
    )
    mass: float = number(default=0.0, unit="kg", lower=0, fixed=True, doc="mass")
    spin_inertia: float = number(default=0.0, unit="kg m^2", lower=0, doc="inertia about the axle")
    yaw_inertia: float = number(
        default=0.0, unit="kg m^2", lower=0, fixed=True, doc="inertia about the vertical through its centre"
    )
    motor: Motor | None = child(Motor, default=None, optional=True, expected="a Motor")
    friction: WheelFriction = child(WheelFriction, default=WheelFriction(), expected="a WheelFriction")
    steering_limit: float = number(
        default=np.inf, unit="rad", above=0, endless=True, fixed=True, doc="largest steering angle"
    )

    def check(self) -> None:
        """Raise `InvalidArgument` where rollers are across the rolling direction."""
        if self.roller is not None and not abs(self.roller) <= radians(_LARGEST_ROLLER):
            raise InvalidArgument(
                f"roller of wheel {self.name!r} is {self.roller:.6g} rad, expected less than a right angle "
                "from the rolling direction (up to 89 degrees): the wheel could not drive"
            )

    @property
    def centre(self) -> tuple[float, float]:
        """Where its centre stands in the body's frame at steering angle zero [m]."""
        c, s = cos(self.angle), sin(self.angle)
        along, across = self.trail
        return self.x + along * c - across * s, self.y + along * s + across * c

    @property
    def placement(self) -> pin.SE3:
        """Pose of its centre in the body's frame at steering angle zero, y along the axle."""
        return pin.SE3(pin.utils.rotate("z", self.angle), np.array([*self.centre, self.radius]))

    @property
    def inertia(self) -> pin.Inertia:
        """Its inertia about its centre, y along the axle."""
        moments = np.diag([self.yaw_inertia, self.spin_inertia, self.yaw_inertia])
        return pin.Inertia(self.mass, np.zeros(3), moments)


@final
@part
@by_value
class Support:
    """A support without friction, such as a ball caster: it takes a load, and nothing else.

    Parameters
    ----------
    x, y : float
        Where it touches the ground, in the body's frame [m].
    """

    x: float = number(unit="m", fixed=True, doc="place forward")
    y: float = number(unit="m", fixed=True, doc="place to the left")


def _names(least: int) -> Any:
    """Return the check of a field of names of wheels."""

    def check(name: str, value: Any) -> tuple[str, ...]:
        names = tuple(text(f"one of {name}", one) for one in sequence(name, value, "names of wheels"))
        if len(names) < least or len(set(names)) < len(names):
            raise InvalidArgument(f"{name} is {shown(value)}, expected {least} different names or more")
        return names

    return check


@final
@part
@by_value
class GearTrain:
    """Wheels that turn together, as those of one side of a skid-steer base do: a chain or gears.

    Parameters
    ----------
    wheels : sequence of str
        Their names, two and more.
    ratios : sequence of floats, optional
        Rate of each, relative to each other; by default all turn alike.
    """

    wheels: tuple[str, ...] = option(check=_names(2))
    ratios: tuple[float, ...] = option(
        default=attrs.Factory(lambda train: (1.0,) * len(train.wheels), takes_self=True),
        check=lambda name, value: tuple(np.ravel(finite(name, value)).tolist()),
    )

    def check(self) -> None:
        """Raise `InvalidArgument` where there is not one ratio per wheel."""
        if len(self.ratios) != len(self.wheels) or not all(self.ratios):
            raise InvalidArgument(
                f"ratios is {shown(self.ratios)}, expected {len(self.wheels)} numbers other than zero, "
                "one per wheel"
            )


@final
@part
@by_value
class DifferentialGear:
    """An open differential: one motor that turns at the mean rate of its wheels, with equal torques on them.

    Parameters
    ----------
    wheels : sequence of 2 str
        Their names.
    motor : Motor
        What drives it.
    name : str
        That of its input.
    """

    wheels: tuple[str, ...] = option(check=_names(2))
    motor: Motor = child(Motor, default=TORQUE, expected="a Motor")
    name: str = option(default="differential", check=_checked_name)


@final
@part
@by_value
class AckermannSteering:
    """Wheels that one steering angle turns so that all axles meet in one point.

    The angle is that of a wheel in the middle, at y = 0 and the same x.

    Parameters
    ----------
    wheels : sequence of str
        Their names; they are steered, and their centres lie on their pivots.
    axle : float
        x of the fixed axle, on whose line they meet [m].
    name : str
        That of the steering coordinate.
    """

    wheels: tuple[str, ...] = option(check=_names(1))
    axle: float = number(default=0.0, unit="m", fixed=True, doc="place of the fixed axle, forward")
    name: str = option(default="steering", check=_checked_name)


def column(values: Sequence[Any]) -> Any:
    """Return numbers or symbols, such as one for each wheel, as an array, shape (k,)."""
    return np.stack(values) if any(map(is_symbolic, values)) else frozen(values)


Coupling = GearTrain | DifferentialGear | AckermannSteering


class Axis(NamedTuple):
    """A steering coordinate.

    Attributes
    ----------
    name : str
        Of the coordinate.
    wheels : tuple of int
        Rows that it turns.
    ackermann : float or None
        x of the axle on whose line their axles meet [m]; None: it is the one wheel's own angle.
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
    """One of the inputs of a drive.

    Attributes
    ----------
    name : str
        Of the input.
    motor : Motor
        What it is; of a steering axis one without limits.
    column : tuple of floats
        What its torque is to each steering coordinate and then each wheel; its rate is the product with
        theirs.
    path : str
        Where the table has its motor, such as ``"wheels.left.motor"``; "" of a steering axis.
    """

    name: str
    motor: Motor
    column: tuple[float, ...]
    path: str = ""


@final
@part
@by_value
class WheelTable:
    """The wheels of a drive, what supports the robot beside them, and what couples them.

    Parameters
    ----------
    wheels : sequence of Wheel
        One row each.
    supports : sequence of Support
        Where the robot stands beside its wheels.
    couplings : sequence of GearTrain, DifferentialGear, AckermannSteering
        What holds whatever the friction.
    source : str
        Where its numbers come from, in words; no part of what makes two tables equal.

    Raises
    ------
    InvalidArgument
        If there are no wheels, two have one name or stand in one place, one is called as a coordinate of
        the body, or a coupling does not fit them.
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
        """Raise `InvalidArgument` where there are no wheels, or names, places or couplings do not fit."""
        for name in ("wheels", "supports", "couplings"):
            sequence(name, getattr(self, name), "a sequence")
        if not self.wheels:
            raise InvalidArgument("wheels is empty, expected Wheel(...), one per row")
        _check_places(self.wheels, self.supports)
        for coupling in self.couplings:
            for name in coupling.wheels:
                one_of(f"wheel of a {type(coupling).__name__}", name, self.names)
            if isinstance(coupling, AckermannSteering):
                self._check_axle(coupling)
        names = [*_OF_BODY, *self.names, *(axis.name for axis in self.axes)]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise InvalidArgument(
                f"{twice!r} names two coordinates of the robot, expected names that differ: a row is "
                "Wheel(name, x, y, radius)"
            )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the wheels."""
        return tuple(wheel.name for wheel in self.wheels)

    def __len__(self) -> int:
        return len(self.wheels)

    def __repr__(self) -> str:
        rows = f"[{', '.join(map(repr, self.wheels))}]"
        beside = {"supports": self.supports, "couplings": self.couplings}
        given = "".join(f", {key}={list(value)!r}" for key, value in beside.items() if value)
        return f"WheelTable({rows}{given})"

    def __str__(self) -> str:
        """Return the rows, what couples them, and what the drive can do: see `Mobility`."""
        rows: list[tuple[str, ...]] = [
            ("wheel", "x [m]", "y [m]", "radius [m]", "rolls to", "steering", "rollers at", "motor")
        ]
        rows += [_told(wheel) for wheel in self.wheels]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
        if self.supports:
            places = ", ".join(f"({each.x:.4g}, {each.y:.4g}) m" for each in self.supports)
            lines.append(f"supports without friction: {places}")
        lines += [f"{type(each).__name__} of {', '.join(each.wheels)}" for each in self.couplings]
        return "\n".join([*lines, str(self.mobility)])

    @structure
    def axes(self) -> tuple[Axis, ...]:
        """The steering coordinates, in the order of the table."""
        pairs = [each for each in self.couplings if isinstance(each, AckermannSteering)]
        shared = {name: each for each in pairs for name in each.wheels}
        found: dict[Any, Axis] = {}
        for row, wheel in enumerate(self.wheels):
            driven, together = wheel.steering == DRIVEN, shared.get(wheel.name)
            if together is not None:
                rows = tuple(self.names.index(name) for name in together.wheels)
                limit = min(self.wheels[k].steering_limit for k in rows)
                driven = self.wheels[rows[0]].steering == DRIVEN
                found.setdefault(together, Axis(together.name, rows, together.axle, driven, limit))
            elif wheel.steering != FIXED:
                found[row] = Axis(f"{wheel.name}_steering", (row,), None, driven, wheel.steering_limit)
        return tuple(found.values())

    def _check_axle(self, together: AckermannSteering) -> None:
        wheels = [self.wheels[self.names.index(name)] for name in together.wheels]
        first, axle = wheels[0], together.axle
        for wheel in wheels:
            fits = wheel.steering != FIXED and wheel.x != axle and not (any(wheel.trail) or wheel.angle)
            if not fits or (wheel.steering, wheel.x) != (first.steering, first.x):
                raise InvalidArgument(
                    f"wheel {wheel.name!r} of AckermannSteering(...) is {wheel!r}, expected a "
                    f"steered one with angle "
                    f"0, its centre on its pivot, away from the axle at x = {axle:g} m, beside the others"
                )

    @cached_property
    def trains(self) -> list[tuple[int, int, float]]:
        """Of gear trains, the first wheel, each other one, and how many times as fast that turns."""
        found = []
        for train in self.couplings:
            if isinstance(train, GearTrain):
                first, *others = (self.names.index(name) for name in train.wheels)
                ratios = (ratio / train.ratios[0] for ratio in train.ratios[1:])
                found += [(first, row, ratio) for row, ratio in zip(others, ratios, strict=True)]
        return found

    @structure
    def mobility(self) -> Mobility:
        """What its wheels let a robot do."""
        return Mobility(self)

    @cached_property
    def actuators(self) -> tuple[Actuator, ...]:
        """The inputs, in the order of the table: of each row its wheel's, then its steering axis's."""
        ns, found = len(self.axes), list[Actuator]()

        def add(name: str, motor: Motor, turned: Sequence[int], path: str = "") -> None:
            column = tuple(1 / len(turned) if k in turned else 0.0 for k in range(ns + len(self)))
            found.append(Actuator(name, motor, column, path))

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
        return tuple(found)

    @structure
    def footprint(self) -> Array | None:
        """Corners of what it stands on, wheels at steering angles zero and supports, shape (k, 2) [m].

        Counter-clockwise, in the body's frame; None where they are on one line.
        """
        places = [*(wheel.centre for wheel in self.wheels), *((each.x, each.y) for each in self.supports)]
        rank = np.linalg.matrix_rank(np.column_stack([np.ones(len(places)), places]), tol=_SAME_PLACE)
        corners = hull(np.array(places)) if rank == 3 else None
        return None if corners is None else frozen(corners)

    def taken_from(self, body: pin.Inertia) -> pin.Inertia:
        """Return what is left of a body without the wheels, which are part of it."""
        heavy, rest = sum(wheel.mass for wheel in self.wheels), pin.Inertia(body)
        if body.mass <= heavy:
            raise InvalidArgument(
                f"robot has a mass of {body.mass:.6g} kg, and its wheels {heavy:.6g} kg, which are part of "
                "it; expected the mass of the whole"
            )
        for wheel in self.wheels:
            rest -= wheel.placement.act(wheel.inertia)
        try:
            Body(rest.mass, np.array(rest.lever), np.array(rest.inertia))
        except InvalidArgument as error:
            words = "expected a robot whose mass and inertia hold those of its wheels"
            raise InvalidArgument(f"robot without its wheels is no body: {error}; {words}") from None
        return rest

    @classmethod
    def differential(
        cls, track: float, radius: float, *, x: float = 0.0, supports: _Places = (), **wheel: Any
    ) -> Self:
        """Return two driven wheels on one axle, ``left`` and ``right``.

        Parameters
        ----------
        track : float
            Distance of the wheels [m].
        radius : float
            [m].
        x : float
            Of the axle in the body's frame [m].
        supports : iterable of (x, y)
            Where casters without friction stand [m].
        **wheel
            What else each has, see `Wheel`: ``mass``, ``spin_inertia``, ``yaw_inertia``, ``friction``,
            ``motor``, by default a source of torque.
        """
        half, own = positive("track", track, "m") / 2, {"motor": TORQUE, **wheel}
        rows = (Wheel(name, x, y, radius, **own) for name, y in (("left", half), ("right", -half)))
        return cls(tuple(rows), _supports(supports))

    @classmethod
    def skid_steer(
        cls, wheelbase: float, track: float, radius: float, *, coupled: bool = True, **wheel: Any
    ) -> Self:
        """Return four fixed wheels that turn by skidding.

        Parameters
        ----------
        wheelbase, track, radius : float
            Distances of the axles and of the sides, and radius of the wheels [m].
        coupled : bool
            Whether the wheels of a side are on one gear train, with one motor a side, in the front; or else
            each wheel has a motor.
        **wheel
            What else each has, see `Wheel`; ``motor`` is that of each side, or each wheel.
        """
        instance("coupled", coupled, bool, "True or False")
        own = {"motor": TORQUE, **wheel}
        rear = own | {"motor": None} if coupled else own
        places = _corners(wheelbase, track)
        rows = [Wheel(*at, radius, **(rear if at[0].startswith("rear") else own)) for at in places]
        sides = ("left", "right") if coupled else ()
        return cls(tuple(rows), (), tuple(GearTrain((f"front_{side}", f"rear_{side}")) for side in sides))

    @classmethod
    def mecanum(
        cls, wheelbase: float, track: float, radius: float, *, roller: float = pi / 4, **wheel: Any
    ) -> Self:
        """Return four mecanum wheels whose rollers form an X seen from above.

        Parameters
        ----------
        wheelbase, track, radius : float
            Distances of the axles and of the sides, and radius of the wheels [m].
        roller : float
            Angle of the rollers [rad]: positive for the X. A negative one is the O arrangement, which is
            refused on a square base: it could not turn.
        **wheel
            What else each has, see `Wheel`; ``motor`` is a source of torque by default.
        """
        angle, own = scalar("roller", roller), {"motor": TORQUE, **wheel}
        turns = angle > 0 or abs(wheelbase - track * abs(np.tan(angle))) >= 1e-3 * track
        if not (angle and turns):
            flaw = "form an O whose axes meet in its middle, so that it cannot turn"
            flaw = flaw if angle else "all roll along x, and none moves it sideways"
            raise InvalidArgument(
                f"roller is {angle:g} rad on a base of {wheelbase:g} by {track:g} m: the rollers {flaw}; "
                "expected the X, a positive angle, or WheelTable.omni(...)"
            )
        signs = {"front_left": -1, "front_right": 1, "rear_left": 1, "rear_right": -1}
        places = _corners(wheelbase, track)
        return cls(tuple(Wheel(*at, radius, roller=signs[at[0]] * angle, **own) for at in places))

    @classmethod
    def omni(cls, distance: float, radius: float, *, n: int = 3, first: float = 0.0, **wheel: Any) -> Self:
        """Return omni wheels on a circle, their axles through its middle.

        Parameters
        ----------
        distance, radius : float
            Of the wheels from the middle, and their radius [m].
        n : int
            How many, three and more.
        first : float
            Where the first one is, from the body's x [rad].
        **wheel
            What else each has, see `Wheel`; ``motor`` is a source of torque by default.
        """
        count, L = whole("n", n, least=3, most=_MOST), positive("distance", distance, "m")
        angles = (scalar("first", first) + 2 * pi * np.arange(count) / count).tolist()
        own: dict[str, Any] = {"roller": 0.0, "motor": TORQUE, **wheel}
        places = [(f"wheel_{k}", L * cos(a), L * sin(a), radius, a + pi / 2) for k, a in enumerate(angles, 1)]
        return cls(tuple(Wheel(*at, **own) for at in places))

    @classmethod
    def swerve(cls, places: _Places, radius: float, *, supports: _Places = (), **wheel: Any) -> Self:
        """Return modules that each steer and drive.

        Parameters
        ----------
        places : iterable of (x, y)
            Where they stand [m].
        radius : float
            Of the wheels [m].
        supports : iterable of (x, y)
            Where casters without friction stand [m].
        **wheel
            What else each has, see `Wheel`; ``motor`` is that of its drive.
        """
        own: dict[str, Any] = {"steering": DRIVEN, "motor": TORQUE, **wheel}
        rows = [Wheel(f"wheel_{k}", *at, radius, **own) for k, at in enumerate(each_of("places", places), 1)]
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
        """Return four wheels: rear ones on an open differential, front ones steered by Ackermann's law.

        The body's origin is in the middle of the rear axle.

        Parameters
        ----------
        wheelbase, track, radius : float
            Distances of the axles and of the sides, and radius of the wheels [m].
        motor : Motor
            Of the rear axle.
        steering_limit : float
            Largest steering angle, to either side [rad].
        **wheel
            What else each has, see `Wheel`.
        """
        L, half = positive("wheelbase", wheelbase, "m"), positive("track", track, "m") / 2
        limit = scalar("steering_limit", steering_limit)
        bounded("steering_limit", limit, above=0, below=pi / 2, unit="rad")
        steered: dict[str, Any] = {"steering": DRIVEN, "steering_limit": limit}
        axles = ("rear", 0.0, wheel), ("front", L, steered | wheel)
        sides = ("left", half), ("right", -half)
        rows = [Wheel(f"{end}_{side}", x, y, radius, **own) for end, x, own in axles for side, y in sides]
        drive = DifferentialGear(("rear_left", "rear_right"), motor, "drive")
        return cls(tuple(rows), (), (drive, AckermannSteering(("front_left", "front_right"))))


def _told(wheel: Wheel) -> tuple[str, ...]:
    return (
        wheel.name,
        *(f"{number:.4g}" for number in (wheel.x, wheel.y, wheel.radius)),
        f"{degrees(wheel.angle):.4g} deg",
        wheel.steering,
        "" if wheel.roller is None else f"{degrees(wheel.roller):.4g} deg",
        "" if wheel.motor is None else "yes",
    )


def _check_places(wheels: Sequence[Wheel], supports: Sequence[Support]) -> None:
    places = [(f"wheel {wheel.name!r}", *wheel.centre) for wheel in wheels]
    places += [(f"support {k + 1}", each.x, each.y) for k, each in enumerate(supports)]
    for (other, x0, y0), (name, x, y) in combinations(places, 2):
        if hypot(x - x0, y - y0) < _SAME_PLACE:
            raise InvalidArgument(f"{other} and {name} stand in one place, ({x:g}, {y:g}) m, expected two")


def _corners(wheelbase: float, track: float) -> list[tuple[str, float, float]]:
    a, b = positive("wheelbase", wheelbase, "m") / 2, positive("track", track, "m") / 2
    return [("front_left", a, b), ("front_right", a, -b), ("rear_left", -a, b), ("rear_right", -a, -b)]


def each_of(name: str, given: object) -> list[tuple[float, float]]:
    """Return places in the plane.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    given : iterable of (x, y)
        The argument [m].

    Raises
    ------
    InvalidArgument
        If it is something else.
    """
    places = given.tolist() if isinstance(given, np.ndarray) else given
    found = []
    for k, at in enumerate(sequence(name, places, "(x, y) of each [m]")):
        place = shaped(f"{name}[{k}]", finite(f"{name}[{k}]", at), (2,), words=": x and y of each [m]")
        found.append((float(place[0]), float(place[1])))
    return found


def _supports(places: object) -> tuple[Support, ...]:
    return tuple(Support(*at) for at in each_of("supports", places))
