"""`WheelTable`: one row per wheel describes any drive, as a Denavit-Hartenberg table describes any arm."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from itertools import combinations
from math import cos, degrees, hypot, pi, radians, sin
from typing import Any, Self, TypeAlias, final

import numpy as np

from pinmobile.arrays import (
    ArrayLike,
    bounded,
    finite,
    instance,
    one_of,
    positive,
    scalar,
    sequence,
    shaped,
    text,
    whole,
)
from pinmobile.errors import InvalidArgument
from pinmobile.parts import by_value, children, entries_of, option, part, structure
from pinmobile.wheels._kinematics import Mobility
from pinmobile.wheels._motors import Motor
from pinmobile.wheels._wheel import (
    DRIVEN,
    FIXED,
    TORQUE,
    Ackermann,
    Actuator,
    Axis,
    Coupling,
    Differential,
    GearTrain,
    Support,
    Wheel,
)

_SAME_PLACE = 1e-6  # [m]
_OF_BODY = "x", "y", "psi"
_MOST = 1000  # wheels of a circle
_Places: TypeAlias = Iterable[ArrayLike]


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
    couplings : sequence of GearTrain, Differential, Ackermann
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
        (GearTrain, Differential, Ackermann), default=(), expected="GearTrain, Differential or Ackermann"
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
            if isinstance(coupling, Ackermann):
                self._check_axle(coupling)
        names = [*self.names, *(axis.name for axis in self.axes)]
        own = next((name for name in names if name in _OF_BODY), None)
        if own is not None:
            raise InvalidArgument(
                f"{own!r} names a wheel or its steering, and a coordinate of the body, expected another "
                "name: a row is Wheel(name, x, y, radius)"
            )
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise InvalidArgument(f"{twice!r} names two coordinates of the table, expected names that differ")

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
        return "\n".join([*lines, str(Mobility.of(self))])

    @structure
    def axes(self) -> tuple[Axis, ...]:
        """The steering coordinates, in the order of the table."""
        pairs = [each for each in self.couplings if isinstance(each, Ackermann)]
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

    def _check_axle(self, together: Ackermann) -> None:
        wheels = [self.wheels[self.names.index(name)] for name in together.wheels]
        for wheel in wheels:
            if wheel.steering == FIXED or any(wheel.trail) or wheel.angle or wheel.x == together.axle:
                raise InvalidArgument(
                    f"wheel {wheel.name!r} of Ackermann(...) is {wheel!r}, expected a steered one with "
                    f"angle 0, its centre on its pivot, away from the axle at x = {together.axle:g} m"
                )
        if len({wheel.steering for wheel in wheels}) > 1 or len({wheel.x for wheel in wheels}) > 1:
            raise InvalidArgument(
                f"wheels {', '.join(together.wheels)} of Ackermann(...) differ in x or steering, "
                "expected one axle"
            )

    @cached_property
    def actuators(self) -> tuple[Actuator, ...]:
        """The inputs, in the order of the table: of each row its wheel's, then its steering axis's."""
        ns, found, done = len(self.axes), list[Actuator](), set()

        def add(name: str, motor: Motor, turned: Sequence[int], path: str = "") -> None:
            column = tuple(1 / len(turned) if k in turned else 0.0 for k in range(ns + len(self)))
            found.append(Actuator(name, motor, column, path))

        for row, wheel in enumerate(self.wheels):
            if wheel.motor is not None:
                add(wheel.name, wheel.motor, [ns + row], f"wheels.{wheel.name}.motor")
            for key, each in entries_of(self.couplings):
                if isinstance(each, Differential) and key not in done and wheel.name in each.wheels:
                    done.add(key)
                    rows = [ns + self.names.index(name) for name in each.wheels]
                    add(each.name, each.motor, rows, f"couplings.{key}.motor")
            for k, axis in enumerate(self.axes):
                if axis.driven and axis.wheels[0] == row:
                    add(axis.name, TORQUE, [k])
        return tuple(found)

    @classmethod
    def differential(
        cls,
        track: float,
        radius: float,
        *,
        x: float = 0.0,
        supports: _Places = (),
        motor: Motor = TORQUE,
        **wheel: Any,
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
        motor : Motor
            Of each wheel.
        **wheel
            What else each has, see `Wheel`: ``mass``, ``spin_inertia``, ``yaw_inertia``, ``friction``.
        """
        half = positive("track", track, "m") / 2
        rows = [
            Wheel(name, x, y, radius, motor=motor, **wheel) for name, y in (("left", half), ("right", -half))
        ]
        return cls(tuple(rows), _supports(supports))

    @classmethod
    def skid_steer(
        cls,
        wheelbase: float,
        track: float,
        radius: float,
        *,
        coupled: bool = True,
        motor: Motor = TORQUE,
        **wheel: Any,
    ) -> Self:
        """Return four fixed wheels that turn by skidding.

        Parameters
        ----------
        wheelbase, track, radius : float
            Distances of the axles and of the sides, and radius of the wheels [m].
        coupled : bool
            Whether the wheels of a side are on one gear train, with one motor a side, in the front; or else
            each wheel has a motor.
        motor : Motor
            Of each side, or each wheel.
        **wheel
            What else each has, see `Wheel`.
        """
        instance("coupled", coupled, bool, "True or False")
        rows = [
            Wheel(name, x, y, radius, motor=None if coupled and name.startswith("rear") else motor, **wheel)
            for name, x, y in _corners(wheelbase, track)
        ]
        trains = (
            [GearTrain((f"front_{side}", f"rear_{side}")) for side in ("left", "right")] if coupled else []
        )
        return cls(tuple(rows), (), tuple(trains))

    @classmethod
    def mecanum(
        cls,
        wheelbase: float,
        track: float,
        radius: float,
        *,
        roller: float = pi / 4,
        motor: Motor = TORQUE,
        **wheel: Any,
    ) -> Self:
        """Return four mecanum wheels whose rollers form an X seen from above.

        Parameters
        ----------
        wheelbase, track, radius : float
            Distances of the axles and of the sides, and radius of the wheels [m].
        roller : float
            Angle of the rollers [rad]: positive for the X. A negative one is the O arrangement, which is
            refused on a square base: it could not turn.
        motor : Motor
            Of each wheel.
        **wheel
            What else each has, see `Wheel`.
        """
        angle = scalar("roller", roller)
        turns = angle > 0 or abs(wheelbase - track * abs(np.tan(angle))) >= 1e-3 * track
        if not (angle and turns):
            flaw = "form an O whose axes meet in its middle, so that it cannot turn"
            flaw = flaw if angle else "all roll along x, and none moves it sideways"
            raise InvalidArgument(
                f"roller is {angle:g} rad on a base of {wheelbase:g} by {track:g} m: the rollers {flaw}; "
                "expected the X, a positive angle, or WheelTable.omni(...)"
            )
        signs = {"front_left": -1, "front_right": 1, "rear_left": 1, "rear_right": -1}
        rows = [
            Wheel(name, x, y, radius, roller=signs[name] * angle, motor=motor, **wheel)
            for name, x, y in _corners(wheelbase, track)
        ]
        return cls(tuple(rows))

    @classmethod
    def omni(
        cls,
        distance: float,
        radius: float,
        *,
        n: int = 3,
        first: float = 0.0,
        motor: Motor = TORQUE,
        **wheel: Any,
    ) -> Self:
        """Return omni wheels on a circle, their axles through its middle.

        Parameters
        ----------
        distance, radius : float
            Of the wheels from the middle, and their radius [m].
        n : int
            How many, three and more.
        first : float
            Where the first one is, from the body's x [rad].
        motor : Motor
            Of each wheel.
        **wheel
            What else each has, see `Wheel`.
        """
        count, L = whole("n", n, least=3, most=_MOST), positive("distance", distance, "m")
        angles = (scalar("first", first) + 2 * pi * np.arange(count) / count).tolist()
        own: dict[str, Any] = {"roller": 0.0, "motor": motor, **wheel}
        rows = [
            Wheel(f"wheel_{k + 1}", L * cos(a), L * sin(a), radius, a + pi / 2, **own)
            for k, a in enumerate(angles)
        ]
        return cls(tuple(rows))

    @classmethod
    def swerve(
        cls, places: _Places, radius: float, *, motor: Motor = TORQUE, supports: _Places = (), **wheel: Any
    ) -> Self:
        """Return modules that each steer and drive.

        Parameters
        ----------
        places : iterable of (x, y)
            Where they stand [m].
        radius : float
            Of the wheels [m].
        motor : Motor
            Of each wheel's drive.
        supports : iterable of (x, y)
            Where casters without friction stand [m].
        **wheel
            What else each has, see `Wheel`.
        """
        rows = [
            Wheel(f"wheel_{k + 1}", *at, radius, steering=DRIVEN, motor=motor, **wheel)
            for k, at in enumerate(each_of("places", places))
        ]
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
        rear = [
            Wheel(f"rear_{side}", 0.0, y, radius, **wheel) for side, y in (("left", half), ("right", -half))
        ]
        front = [
            Wheel(f"front_{side}", L, y, radius, steering=DRIVEN, steering_limit=limit, **wheel)
            for side, y in (("left", half), ("right", -half))
        ]
        couplings = (
            Differential(("rear_left", "rear_right"), motor, "drive"),
            Ackermann(("front_left", "front_right")),
        )
        return cls((*rear, *front), (), couplings)


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
