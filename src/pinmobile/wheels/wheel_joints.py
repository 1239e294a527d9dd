"""`WheelJoints`: the wheels of a robot's file, each read as a row of a wheel table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import atan2, cos, hypot, pi, radians, sin

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, non_negative, one_of, positive, scalar, sequence
from pinmobile.errors import InvalidArgument, shown
from pinmobile.robot import TOUCH, MobileRobot, Swivel, WheelJoint
from pinmobile.wheels.motors import Motor
from pinmobile.wheels.table import DRIVEN, FIXED, FREE, Coupling, Wheel

_TRAIL = 1e-3  # [m]: a wheel nearer to its swivel than that does not trail
_ROUNDED = 0.002  # [rad] of a multiple of 15 degrees: files have 1.57 and 3.14
_STEP = radians(15)
_ROUND = 0.02  # share by which moments of a wheel may differ across its axle, and its com be off it
_DIGITS = 12  # of a length [m]


@dataclass(frozen=True)
class Given:
    """What is given beside the file: see `read_wheels`."""

    radius: float | Mapping[str, float] | None = None
    rollers: float | Mapping[str, float] | None = None
    driven: Sequence[str] | None = None
    steering: Mapping[str, str] | None = None
    inertia: ArrayLike | Mapping[str, ArrayLike] | None = None
    locked: Sequence[str] = ()
    supports: Iterable[ArrayLike] | None = None
    couplings: tuple[Coupling, ...] = ()


class WheelJoints:
    """The joints of a robot's file that are wheels, and what is given beside it.

    Parameters
    ----------
    robot : MobileRobot
        With the `undercarriage` of its file.
    given : Given
        Beside the file.
    """

    def __init__(self, robot: MobileRobot, given: Given) -> None:
        if not isinstance(robot, MobileRobot):
            raise InvalidArgument(f"robot is {shown(robot)}, expected a MobileRobot")
        self.robot, self.given = robot, given
        every = robot.undercarriage.wheels
        self.names = tuple(joint.name for joint in every)
        if not every:
            raise InvalidArgument(
                "robot has no wheels in its file, no joint that turns freely about a level axis; expected "
                "table="
            )
        locked = [self.known("locked", name) for name in sequence("locked", given.locked, "names of wheels")]
        self.joints = [joint for joint in every if joint.name not in locked]
        self.standing = [joint for joint in every if joint.name in locked and self._stands(joint)]
        if not self.joints:
            raise InvalidArgument(
                f"locked is {shown(given.locked)}, all wheels of the robot; expected some left"
            )
        for key in ("radius", "rollers", "steering", "inertia"):
            if isinstance(value := getattr(given, key), Mapping):
                for name in value:
                    self.known(key, name)
            elif key == "steering" and value is not None:
                raise InvalidArgument(f"steering is {shown(value)}, expected a mapping from names of wheels")

    def known(self, key: str, name: object) -> str:
        """Return the name of a wheel, checked."""
        return one_of(f"wheel of {key}", name, self.names)

    def _stands(self, joint: WheelJoint) -> bool:
        height = joint.centre[2] if self.robot.grounded else 0.0
        return joint.radius is None or abs(height - joint.radius) <= TOUCH

    def told(self, key: str, name: str) -> object:
        """Return what is given of a wheel, None for nothing."""
        value = getattr(self.given, key)
        return value.get(name) if isinstance(value, Mapping) else value

    def radius(self, joint: WheelJoint) -> float:
        """Return the radius of a wheel [m]."""
        mapped, own = isinstance(self.given.radius, Mapping), self.told("radius", joint.name)
        if own is not None and (mapped or joint.radius is None):
            return positive(f"radius of wheel {joint.name!r}", own, "m")  # type: ignore[arg-type]
        if joint.radius is None:
            raise InvalidArgument(
                f"radius of wheel {joint.name!r} is not known: its file has no collision cylinder or sphere "
                f"about the axle; expected radius={{{joint.name!r}: ...}} [m]"
            )
        return joint.radius

    def _inertia(self, joint: WheelJoint, radius: float) -> tuple[float, float]:
        """Return the inertia of a wheel about its axle and across it [kg m^2]."""
        own = self.told("inertia", joint.name)
        if own is not None:
            pair = finite(f"inertia of wheel {joint.name!r}", own)  # type: ignore[arg-type]
            if pair.shape != (2,):
                raise InvalidArgument(
                    f"inertia of wheel {joint.name!r} has shape {pair.shape}, expected (2,): about its axle "
                    "and across it [kg m^2]"
                )
            about, across = (
                non_negative(f"inertia of wheel {joint.name!r}", x, "kg m^2") for x in pair.tolist()
            )
            return about, across
        spin, (one, other), products, aside = joint.moments()
        way_out = (
            "its inertia would depend on the angle it has turned; expected equal moments across the axle and "
            f"a centre of mass on it, or inertia={{{joint.name!r}: (about the axle, across it)}} [kg m^2]"
        )
        if aside > _ROUND * radius:
            raise InvalidArgument(
                f"wheel {joint.name!r} has its centre of mass {1e3 * aside:.3g} mm off its axle: {way_out}"
            )
        if max(abs(one - other), products) > _ROUND * max(spin, one, other):
            raise InvalidArgument(
                f"wheel {joint.name!r} is no solid of revolution about its axle, with moments of {spin:.4g} "
                f"about it, {one:.4g} and {other:.4g} across, and products up to {products:.2g} kg m^2: "
                f"{way_out}"
            )
        if not spin > 0:
            raise InvalidArgument(
                f"wheel {joint.name!r} has no inertia in its file, expected one, or "
                f"inertia={{{joint.name!r}: (about the axle, across it)}} [kg m^2]"
            )
        return spin, (one + other) / 2

    def _roller(self, joint: WheelJoint) -> float | None:
        own, name = self.told("rollers", joint.name), joint.name
        if own is None:
            if joint.carried:
                raise InvalidArgument(
                    f"wheel {name!r} carries joints {', '.join(map(repr, joint.carried[:3]))}: their angle "
                    f"decides how it rolls; expected rollers={{{name!r}: angle from the rolling direction}} "
                    "[rad]"
                )
            return None
        angle = scalar(f"rollers of wheel {name!r}", own)  # type: ignore[arg-type]
        if isinstance(self.given.rollers, Mapping) or not angle:
            return angle
        middle = np.mean([each.centre for each in self.joints], axis=0)
        corners = {tuple(np.sign(np.round(each.centre - middle, 6)[:2])) for each in self.joints}
        forward = all(abs(each.axis[1]) > cos(_ROUNDED) for each in self.joints)
        if not forward or len(self.joints) != 4 or corners != {(1, 1), (1, -1), (-1, 1), (-1, -1)}:
            raise InvalidArgument(
                f"rollers is {angle:g} rad for {len(self.joints)} wheels that are not four at the corners of "
                "a rectangle, their axles along y; expected a mapping from their names"
            )
        x, y, _ = joint.centre - middle
        return -angle if x * y > 0 else angle

    def _forward(self, joint: WheelJoint, roller: float | None) -> float:
        """Return the angle of the rolling direction [rad]."""
        angle = snapped(atan2(-joint.axis[0], joint.axis[1]))
        if abs(angle) < pi / 2 - 1e-9 or abs(angle - pi / 2) < 1e-9:
            return angle
        alone = all(
            abs(np.dot(joint.axis, each.axis)) < cos(_ROUNDED) for each in self.joints if each is not joint
        )
        return angle if alone and roller is not None else angle - pi if angle > 0 else angle + pi

    def _steered(self, joint: WheelJoint, roller: float | None) -> tuple[str, Swivel | None]:
        asked = self.told("steering", joint.name)
        if not joint.swivels:
            if asked not in (None, FIXED):
                raise InvalidArgument(
                    f"steering of wheel {joint.name!r} is {shown(asked)}, but it hangs on no joint about the "
                    "vertical; expected 'fixed'"
                )
            return FIXED, None
        if asked == FIXED:
            return FIXED, None
        swivel, *more = joint.swivels
        if more:
            raise InvalidArgument(
                f"wheel {joint.name!r} hangs on two joints about the vertical, {swivel.name!r} and "
                f"{more[0].name!r}; expected one, or steering={{{joint.name!r}: 'fixed'}}"
            )
        twins = [each.name for each in self.joints if swivel.name in (one.name for one in each.swivels)]
        if len(twins) > 1:
            raise InvalidArgument(
                f"wheels {', '.join(map(repr, twins))} hang on one swivel, {swivel.name!r}, for which a "
                "table has no row; expected locked=, or a table= of your own"
            )
        if asked is not None:
            return one_of(f"steering of wheel {joint.name!r}", asked, (FIXED, DRIVEN, FREE)), swivel
        if np.isfinite(swivel.limit):
            return DRIVEN, swivel
        if hypot(joint.centre[0] - swivel.x, joint.centre[1] - swivel.y) > _TRAIL:
            return FREE, swivel
        if roller is None:
            raise InvalidArgument(
                f"wheel {joint.name!r} stands right below its swivel {swivel.name!r}, which the file does "
                "not say to be driven, and which nothing else could turn; expected "
                f"steering={{{joint.name!r}: 'driven'}} or 'fixed', or rollers="
            )
        return FIXED, None

    def row(self, joint: WheelJoint) -> Wheel:
        """Return a wheel as a row of a table."""
        radius, roller = self.radius(joint), self._roller(joint)
        steering, swivel = self._steered(joint, roller)
        spin, across = self._inertia(joint, radius)
        x, y, _ = joint.centre
        angle, mass, trail, limit = self._forward(joint, roller), joint.lump.mass, (0.0, 0.0), np.inf
        if swivel is not None:
            e, o = np.array([cos(angle), sin(angle)]), np.array([x - swivel.x, y - swivel.y])
            along, aside = (to_length(number) for number in (e @ o, left_of(angle) @ o))
            x, y, limit = swivel.x, swivel.y, swivel.limit
            trail = (along, aside)
            mass, across = swivel.turning(joint, across)
        return Wheel(
            wheel_name(joint.name),
            to_length(x),
            to_length(y),
            radius,
            angle,
            steering,
            trail,
            roller,
            mass,
            spin,
            across,
            steering_limit=limit if limit > 0 else np.inf,
        )


def motor_of(joint: WheelJoint) -> Motor:
    """Return what drives a wheel, as far as its file tells."""
    if not (np.isfinite(joint.effort) or joint.damping or joint.friction):
        return Motor()
    return Motor(
        joint.effort,
        viscous=max(joint.damping, 0.0),
        coulomb=max(joint.friction, 0.0),
        source=f"joint {joint.name}",
    )


def snapped(angle: float) -> float:
    """Return an angle [rad], that which a file rounds where it nearly is one of every 15 degrees."""
    nearest = round(angle / _STEP)
    exact = {-6: -pi / 2, 6: pi / 2, 12: pi, -12: pi}.get(nearest, nearest * _STEP)
    near = abs(angle - nearest * _STEP) < _ROUNDED
    return exact if near else angle


def to_length(x: float) -> float:
    """Return a length without what products of rotations leave of rounding [m]."""
    return round(float(x), _DIGITS) + 0.0


def left_of(angle: float) -> Array:
    """Return the direction a quarter of a turn to the left, shape (2,)."""
    return np.array([-sin(angle), cos(angle)])


def wheel_name(name: str) -> str:
    """Return the name of a joint as that of a wheel."""
    return "".join("_" if letter in '/,":.' else letter for letter in name)
