"""Wheel joints of a robot's URDF, and a wheel table from them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import atan2, cos, hypot, pi, radians, sin
from os import PathLike
from pathlib import Path
from typing import Any
from warnings import warn
from xml.etree import ElementTree

import numpy as np

from pinmobile.arrays import (
    ArrayLike,
    bounded,
    finite,
    instance,
    one_of,
    positive,
    required,
    scalar,
    sequence,
    shaped,
)
from pinmobile.errors import InvalidArgument, format_value
from pinmobile.parts import evolved
from pinmobile.robot import LOCKED, TOUCH, MobileRobot, Swivel, WheelJoint, check_plane
from pinmobile.wheels._motors import Motor
from pinmobile.wheels._table import (
    DRIVEN,
    FIXED,
    FREE,
    Coupling,
    DifferentialGear,
    GearTrain,
    Support,
    Wheel,
    WheelTable,
    each_of,
)

_TRAIL = 1e-3  # [m]: smallest distance of a caster's wheel from its swivel
_ANGLE_TOLERANCE = 0.002  # [rad]: tolerance of multiples of 15 degrees, because files contain 1.57 and 3.14
_STEP = radians(15)
_ROUND = 0.02  # relative tolerance of equal moments across a wheel's axle, and of its centre of mass
_DIGITS = 12  # decimal digits of a length [m]
_LINE = 1e-3  # [m]: tolerance of axles on one line


@dataclass(frozen=True)
class _Reader:
    """Reader of the wheels in a robot's file, with the arguments of `read_wheels`."""

    robot: MobileRobot
    radius: Any = None
    rollers: Any = None
    driven: Any = None
    steering: Any = None
    inertia: Any = None
    locked: Any = ()
    supports: Any = None
    couplings: Any = ()
    words: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        instance("robot", self.robot, MobileRobot, "a MobileRobot")
        if not self._names:
            words = "no continuous joint about a horizontal axis; expected table="
            raise InvalidArgument(f"robot has no wheels in its file, {words}")
        if not self.joints:
            words = "all wheels of the robot; expected fewer"
            raise InvalidArgument(f"locked is {format_value(self.locked)}, {words}")
        for key in ("radius", "rollers", "steering", "inertia"):
            if isinstance(value := getattr(self, key), Mapping):
                self._check_names(key, value)

    @property
    def _names(self) -> list[str]:
        return [joint.name for joint in self.robot.undercarriage.wheels]

    def _check_names(self, key: str, names: Iterable[object]) -> list[str]:
        """Return names of wheels after a check."""
        return [one_of(f"wheel of {key}", name, self._names) for name in names]

    @cached_property
    def _locks(self) -> list[str]:
        return self._check_names("locked", sequence("locked", self.locked, "names of wheels"))

    @cached_property
    def joints(self) -> list[WheelJoint]:
        """Joints that become wheels of the table."""
        return [joint for joint in self.robot.undercarriage.wheels if joint.name not in self._locks]

    def _given(self, key: str, name: str) -> Any:
        """Return the argument for a wheel, None without one."""
        value = getattr(self, key)
        return value.get(name) if isinstance(value, Mapping) else value

    def radius_of(self, joint: WheelJoint) -> float:
        """Return the radius of a wheel [m]."""
        radius = self._given("radius", joint.name)
        if radius is not None and (isinstance(self.radius, Mapping) or joint.radius is None):
            return positive(f"radius of wheel {joint.name!r}", radius, "m")
        label, expected = f"radius of wheel {joint.name!r}", f"radius={{{joint.name!r}: ...}} [m]"
        return required(label, joint.radius, expected)  # type: ignore[no-any-return]

    def _inertia(self, joint: WheelJoint, radius: float) -> tuple[float, float]:
        """Return the inertia of a wheel about its axle and across it [kg m^2]."""
        given = self._given("inertia", joint.name)
        if given is not None:
            words = f"inertia of wheel {joint.name!r}"
            pair = shaped(words, finite(words, given), (2,), words=": about its axle and across it [kg m^2]")
            axial, across = bounded(words, pair, least=0, unit="kg m^2").tolist()
            return axial, across
        spin, (first, second), products, offset = joint.moments()
        way_out = (
            "its inertia would depend on the angle it has turned; expected equal moments across the axle and "
            f"a centre of mass on it, or inertia={{{joint.name!r}: (about the axle, across it)}} [kg m^2]"
        )
        if offset > _ROUND * radius:
            raise InvalidArgument(
                f"wheel {joint.name!r} has its centre of mass {1e3 * offset:.3g} mm off its axle: {way_out}"
            )
        if max(abs(first - second), products) > _ROUND * max(spin, first, second):
            raise InvalidArgument(
                f"wheel {joint.name!r} is not a solid of revolution about its axle: moments are "
                f"{spin:.4g} about it, {first:.4g} and {second:.4g} across, and products up to "
                f"{products:.2g} kg m^2: {way_out}"
            )
        if not spin > 0:
            raise InvalidArgument(
                f"wheel {joint.name!r} has no inertia in its file, expected an inertia, or "
                f"inertia={{{joint.name!r}: (about the axle, across it)}} [kg m^2]"
            )
        return spin, (first + second) / 2

    def _roller(self, joint: WheelJoint) -> float | None:
        """Return the angle of a wheel's rollers [rad]; None for a tyre."""
        given, name = self._given("rollers", joint.name), joint.name
        if given is None:
            if joint.carried:
                raise InvalidArgument(
                    f"wheel {name!r} carries joints {', '.join(map(repr, joint.carried[:3]))}, probably "
                    f"rollers; expected rollers={{{name!r}: angle from the rolling direction}} [rad]"
                )
            return None
        angle = scalar(f"rollers of wheel {name!r}", given)
        if isinstance(self.rollers, Mapping) or not angle:
            return angle
        middle = np.mean([each.centre for each in self.joints], axis=0)
        corners = {tuple(np.sign(np.round(each.centre - middle, 6)[:2])) for each in self.joints}
        forward = all(abs(each.axis[1]) > cos(_ANGLE_TOLERANCE) for each in self.joints)
        if not forward or len(self.joints) != 4 or corners != {(1, 1), (1, -1), (-1, 1), (-1, -1)}:
            raise InvalidArgument(
                f"rollers is {angle:g} rad for {len(self.joints)} wheels that are not four at the corners of "
                "a rectangle with axles along y; expected a mapping from their names"
            )
        x, y, _ = joint.centre - middle
        return -angle if x * y > 0 else angle

    def _forward(self, joint: WheelJoint, roller: float | None) -> float:
        """Return the angle of the rolling direction [rad]."""
        angle = round_angle(atan2(-joint.axis[0], joint.axis[1]))
        if abs(angle) < pi / 2 - 1e-9 or abs(angle - pi / 2) < 1e-9:
            return angle
        others = [each.axis for each in self.joints if each is not joint]
        is_single = all(abs(np.dot(joint.axis, axis)) < cos(_ANGLE_TOLERANCE) for axis in others)
        return angle if is_single and roller is not None else angle - pi if angle > 0 else angle + pi

    def _steering(self, joint: WheelJoint, roller: float | None) -> tuple[str, Swivel | None]:
        """Return the kind of a wheel's steering, and its swivel."""
        kind = self._given("steering", joint.name)
        if not joint.swivels and kind not in (None, FIXED):
            raise InvalidArgument(
                f"steering of wheel {joint.name!r} is {format_value(kind)}, but the file has no joint about "
                "the vertical above it; expected 'fixed'"
            )
        if not joint.swivels or kind == FIXED:
            return FIXED, None
        swivel, *others = joint.swivels
        if others:
            raise InvalidArgument(
                f"wheel {joint.name!r} has two joints about the vertical above it, {swivel.name!r} and "
                f"{others[0].name!r}; expected one joint, or steering={{{joint.name!r}: 'fixed'}}"
            )
        twins = [each.name for each in self.joints if swivel.name in (item.name for item in each.swivels)]
        if len(twins) > 1:
            raise InvalidArgument(
                f"wheels {', '.join(map(repr, twins))} share one swivel, {swivel.name!r}, which a wheel "
                "table cannot describe; expected locked=, or table="
            )
        if kind is not None:
            return one_of(f"steering of wheel {joint.name!r}", kind, (FIXED, DRIVEN, FREE)), swivel
        if np.isfinite(swivel.limit):
            return DRIVEN, swivel
        if hypot(joint.centre[0] - swivel.x, joint.centre[1] - swivel.y) > _TRAIL:
            return FREE, swivel
        if roller is None:
            raise InvalidArgument(
                f"wheel {joint.name!r} is right below its swivel {swivel.name!r}, which has no limits; "
                f"expected steering={{{joint.name!r}: 'driven'}} or 'fixed', or rollers="
            )
        return FIXED, None

    def _row(self, joint: WheelJoint) -> Wheel:
        """Return a wheel as a row of a table."""
        radius, roller = self.radius_of(joint), self._roller(joint)
        steering, swivel = self._steering(joint, roller)
        spin, across = self._inertia(joint, radius)
        (x, y, _), angle = joint.centre, self._forward(joint, roller)
        fields: dict[str, Any] = {"mass": joint.lump.mass, "yaw_inertia": across}
        if swivel is not None:
            c, s, ox, oy = cos(angle), sin(angle), x - swivel.x, y - swivel.y
            fields["trail"] = (to_length(c * ox + s * oy), to_length(c * oy - s * ox))
            fields["mass"], fields["yaw_inertia"] = swivel.turning(joint, across)
            x, y = swivel.x, swivel.y
            if swivel.limit > 0:
                fields["steering_limit"] = swivel.limit
        name, place = wheel_name(joint.name), (to_length(x), to_length(y))
        return Wheel(name, *place, radius, angle, steering, roller=roller, spin_inertia=spin, **fields)

    def table(self) -> WheelTable:
        """Return the table."""
        if isinstance(self.radius, float | int) and all(each.radius for each in self.joints):
            raise InvalidArgument(
                f"radius is {format_value(self.radius)} m, but the file defines the radius of every wheel; "
                "expected a mapping"
            )
        rows = [self._row(joint) for joint in self.joints]
        self._check_plane(rows)
        rows = self._on_lines(rows)
        names = self._motors_at(rows)
        pairs = zip(rows, self.joints, strict=True)
        rows = [evolved(row, motor=motor_of(joint)) if joint.name in names else row for row, joint in pairs]
        table = WheelTable(tuple(rows), self._supports(rows), tuple(self.couplings))
        return evolved(table, source="; ".join(self._sources(table)))

    def _check_plane(self, rows: Sequence[Wheel]) -> None:
        """Check that all wheels stand on one plane."""
        pairs = zip(self.joints, rows, strict=True)
        lowest = {joint.name: joint.centre[2] - row.radius for joint, row in pairs}
        lowest |= {"the ground": 0.0} if self.robot.grounded else {}
        check_plane("wheels", lowest, "other radii, or locked= for wheels that do not roll")

    def _on_lines(self, rows: Sequence[Wheel]) -> list[Wheel]:
        """Return the rows, with axles of fixed tyres that are almost on one line moved onto it.

        Raise an error for wheels on several axles if nothing states that they skid or have rollers.
        """
        result, largest = list(rows), 0.0
        fixed = [k for k, row in enumerate(rows) if row.steering == FIXED]
        tyres = [k for k in fixed if rows[k].roller is None]
        for k in tyres:
            line = [x for x in (_offset(rows[j]) for j in tyres if rows[j].angle == rows[k].angle)]
            line = [x for x in line if abs(x - _offset(rows[k])) <= _LINE]
            shift = sum(line) / len(line) - _offset(rows[k]) if max(line) > min(line) else 0.0
            if shift:
                x, y = rows[k].x + shift * cos(rows[k].angle), rows[k].y + shift * sin(rows[k].angle)
                result[k] = evolved(rows[k], x=to_length(x), y=to_length(y))
                largest = max(largest, abs(shift))
        if largest > 1e-9:
            self.words.append(f"axles put on one line, by {1e3 * largest:.2g} mm at most")
        axles = {(round(result[k].angle, 9), round(_offset(result[k]), 9)) for k in fixed}
        trains = any(isinstance(each, GearTrain) for each in self.couplings)
        if self.rollers is None and len(axles) > 1 and not trains:
            names = ", ".join(repr(rows[k].name) for k in fixed)
            raise InvalidArgument(
                f"rollers is not given, and wheels {names} are fixed on more than one axle: they skid or "
                "have rollers; expected rollers={} for tyres, rollers=pi / 4 for mecanum wheels, or a mapping"
            )
        return result

    def _motors_at(self, rows: Sequence[Wheel]) -> list[str]:
        """Return the names of the joints of wheels with a motor."""
        if self.driven is not None:
            return self._check_names("driven", sequence("driven", self.driven, "names of wheels"))
        coupled: set[str] = set()
        for each in self.couplings:
            if isinstance(each, DifferentialGear | GearTrain):
                coupled.update(each.wheels[isinstance(each, GearTrain) :])
        kind = FIXED if any(row.steering == FIXED for row in rows) else DRIVEN
        pairs = zip(self.joints, rows, strict=True)
        return [joint.name for joint, row in pairs if row.steering == kind and row.name not in coupled]

    def _supports(self, rows: Sequence[Wheel]) -> tuple[Support, ...]:
        """Return the given supports, or those of the file."""
        if self.supports is not None:
            return tuple(Support(*at) for at in each_of("supports", self.supports))
        centres, supports = [row.centre for row in rows], []
        places = list(self.robot.undercarriage.supports)
        for joint in self.robot.undercarriage.wheels:
            height = joint.centre[2] if self.robot.grounded else 0.0
            if joint.name in self._locks and (joint.radius is None or abs(height - joint.radius) <= TOUCH):
                places.append(joint.centre[:2])
        for place in places:
            x, y = map(to_length, place)
            if all(hypot(x - x0, y - y0) > _LINE for x0, y0 in centres):
                centres.append((x, y))
                supports.append(Support(x, y))
        return tuple(supports)

    def _sources(self, table: WheelTable) -> list[str]:
        """Return the origin of the table's numbers, in words."""
        sources = [f"wheels of its file: {', '.join(joint.name for joint in self.joints)}"]
        pairs, signs = list(zip(table.wheels, self.joints, strict=True)), joint_signs(self.robot, table)
        guess = "" if self.driven is not None else ", assumed because driven is not given"

        def tell(words: str, holds: Callable[[Wheel, WheelJoint], object]) -> None:
            names = [joint.name for row, joint in pairs if holds(row, joint)]
            if names:
                sources.append(f"{words} {', '.join(names) if len(names) < len(pairs) else 'all'}")

        def rounds(row: Wheel, joint: WheelJoint) -> bool:
            angle = atan2(-joint.axis[0], joint.axis[1])
            return abs(round_angle(angle) - angle) > 1e-9

        rubs = {joint.name for joint in self.joints if joint.damping or joint.friction}
        tell("radius by the collision geometry of", lambda row, joint: joint.radius == row.radius)
        tell("radius as given of", lambda row, joint: joint.radius != row.radius)
        tell("the joint turns the other way at", lambda row, joint: signs[row.name] < 0)
        tell("axes that the file rounds are exact at", rounds)
        given = "inertia as given, the whole's as in the file, of"
        tell(given, lambda row, joint: self._given("inertia", joint.name) is not None)
        tell(f"wheels with a motor{guess}:", lambda row, joint: row.motor)
        limit = "torque limit by the file's effort at"
        tell(limit, lambda row, joint: row.motor and np.isfinite(row.motor.torque_limit))
        limit = "rate limit by the file's velocity at"
        tell(limit, lambda row, joint: row.motor and np.isfinite(row.motor.rate_limit))
        words = "damping and friction of the joint are"
        tell(f"{words} the motor's at", lambda row, joint: row.motor and joint.name in rubs)
        tell(f"{words} left out at", lambda row, joint: not row.motor and joint.name in rubs)
        tell("turns freely behind its swivel:", lambda row, joint: row.steering == FREE)
        tell("steering driven at", lambda row, joint: row.steering == DRIVEN)
        tell("swivel locked of", lambda row, joint: joint.swivels and row.steering == FIXED)
        if self.rollers is not None:
            tell("rollers as given at", lambda row, joint: row.roller is not None)
        if self.rollers is None:
            sources.append("no wheel has rollers, assumed because rollers is not given")
        elif not any(row.roller is not None for row in table.wheels):
            sources.append("no rollers as given")
        sources += self.words
        if self.locked:
            sources.append(f"locked: {', '.join(self.locked)}")
        if table.supports:
            places = ", ".join(f"({each.x:.4g}, {each.y:.4g})" for each in table.supports)
            origin = f"where the file is within {1e3 * TOUCH:g} mm of the ground"
            given = "as given" if self.supports is not None else origin
            sources.append(f"supports without friction {given}, at {places} m")
        return sources


def _offset(row: Wheel) -> float:
    """Return the distance of a wheel's axle ahead of the origin [m]."""
    return cos(row.angle) * row.x + sin(row.angle) * row.y


def motor_of(joint: WheelJoint) -> Motor:
    """Return the motor of a wheel, from the numbers of its file."""
    if not (np.isfinite([joint.effort, joint.rate]).any() or joint.damping or joint.friction):
        return Motor()
    viscous, coulomb = max(joint.damping, 0.0), max(joint.friction, 0.0)
    return Motor(
        joint.effort,
        viscous=viscous,
        coulomb=coulomb,
        rate_limit=joint.rate,
        source=f"joint {joint.name}",
    )


def round_angle(angle: float) -> float:
    """Return an angle [rad], rounded to a multiple of 15 degrees if it is close to one."""
    nearest = round(angle / _STEP)
    exact = {-6: -pi / 2, 6: pi / 2, 12: pi, -12: pi}.get(nearest, nearest * _STEP)
    return exact if abs(angle - nearest * _STEP) < _ANGLE_TOLERANCE else angle


def to_length(x: float) -> float:
    """Return a length without rounding errors of rotations [m]."""
    return round(float(x), _DIGITS) + 0.0


def wheel_name(name: str) -> str:
    """Return the name of a joint as the name of a wheel."""
    return "".join("_" if letter in '/,":.' else letter for letter in name)


def read_wheels(
    robot: MobileRobot,
    *,
    radius: float | Mapping[str, float] | None = None,
    rollers: float | Mapping[str, float] | None = None,
    driven: Sequence[str] | None = None,
    steering: str | Mapping[str, str] | None = None,
    inertia: ArrayLike | Mapping[str, ArrayLike] | None = None,
    locked: Sequence[str] = (),
    supports: Iterable[ArrayLike] | None = None,
    couplings: Sequence[Coupling] = (),
) -> WheelTable:
    """Return the wheel table of a robot read from a URDF or a model.

    Wheels have the names of their joints, in the model's order. The joint axis in the reference
    configuration, made horizontal, is the axle. Rounded angles in files, such as 1.57, become exact multiples
    of 15 degrees, and axles within 1 mm of one line are moved onto it. At a positive rate a wheel rolls
    forward (or to the left, if its axle is along x). If its joint turns in the opposite direction, as in
    mirrored frames, `WheeledRobot.joint_signs` is -1. A wheel with rollers whose axle is parallel to no other
    keeps its joint's direction.

    Masses and inertias are those of the links, which the robot's mass and inertia include. For a caster, the
    wheel's mass and yaw inertia include its fork. The effort of a driven joint becomes its motor's torque
    limit; damping and friction become those of the motor, and act if voltages drive it. Damping and friction
    of other joints are ignored. The property ``source`` of the table states the origin of each number.

    A mapping below has names of wheel joints.

    Parameters
    ----------
    robot : MobileRobot
        Robot with the ``undercarriage`` of its file.
    radius : float or mapping of str to float, optional
        Radius [m]; a number applies to all wheels without a radius in the file.
    rollers : float or mapping of str to float, optional
        Angle from the rolling direction to the axis of the roller at the ground [rad], see `wheels.Wheel`.
        Wheels that are not in a mapping are tyres, all of them with ``{}``. A number applies to all wheels: 0
        for omni wheels; otherwise for four mecanum wheels, whose rollers form an X in the view from above if
        it is positive. It is required if wheels are fixed on more than one axle, unless a gear train shows
        that they skid.
    driven : sequence of str, optional
        Wheels with a motor; default: wheels without a swivel, or, if there are none, wheels whose steering is
        driven; of a gear train only the first one, of a differential none.
    steering : str or mapping of str to str, optional
        ``"fixed"``, ``"driven"`` or ``"free"``, for all wheels on a swivel or for each. By default, a swivel
        with limits is driven; one without limits is free if the wheel trails behind it, and fixed for a wheel
        with rollers.
    inertia : sequence of 2 floats, or mapping of str to that, optional
        Inertia of a wheel about its axle and across it [kg m^2]; a pair applies to all wheels. Mass and
        inertia of the whole robot remain those of the file.
    locked : sequence of str
        Wheel joints that are not wheels of the table: where they touch the ground they are supports without
        friction.
    supports : sequence of (x, y), optional
        Positions of supports beside the wheels [m]; default: other contacts of the file with the ground.
    couplings : sequence of GearTrain, DifferentialGear or AckermannSteering
        Couplings, see `WheelTable`.

    Returns
    -------
    table : WheelTable
        The table; its ``source`` states the origin of its numbers.

    Raises
    ------
    InvalidArgument
        If there are no wheels; a radius is unknown; it is unknown whether wheels have rollers; wheels do not
        stand on one plane; a wheel is not a solid of revolution, or its steering has no row in a table; or an
        argument is of another kind.
    UnknownName
        If there is no wheel of a given name.

    See Also
    --------
    WheeledRobot : its constructor `from_urdf`
    WheelTable : tables from numbers

    Examples
    --------
    >>> import numpy as np
    >>> import pinocchio as pin
    >>> from pinmobile import MobileRobot
    >>> from pinmobile.wheels import read_wheels
    >>> model, disc = pin.Model(), np.diag([0.003, 0.005, 0.003])
    >>> for name, y in ("left", 0.2), ("right", -0.2):
    ...     place = pin.SE3(np.eye(3), np.array([0.0, y, 0.1]))
    ...     k = model.addJoint(0, pin.JointModelRUBY(), place, name)
    ...     wheel = pin.Inertia(1.0, np.zeros(3), disc)
    ...     model.appendBodyToJoint(k, wheel, pin.SE3.Identity())
    >>> robot = MobileRobot.from_model(model)
    >>> table = read_wheels(robot, radius=0.1)
    >>> [(wheel.name, wheel.x, wheel.y) for wheel in table.wheels]
    [('left', 0.0, 0.2), ('right', 0.0, -0.2)]
    """
    return _Reader(robot, radius, rollers, driven, steering, inertia, locked, supports, couplings).table()


def joint_signs(robot: MobileRobot, table: WheelTable) -> dict[str, int]:
    """Return -1 for each wheel whose joint turns in the opposite direction, otherwise 1.

    Parameters
    ----------
    robot : MobileRobot
        Robot with the ``undercarriage`` of its file.
    table : WheelTable
        Its wheels, with the names of the joints.
    """
    joints = {wheel_name(joint.name): joint for joint in robot.undercarriage.wheels}
    rows = [wheel for wheel in table.wheels if wheel.name in joints]
    axes = [(wheel.name, wheel.angle, joints[wheel.name].axis) for wheel in rows]
    return {name: 1 if cos(angle) * axis[1] > sin(angle) * axis[0] else -1 for name, angle, axis in axes}


def source_of(robot: MobileRobot, table: WheelTable) -> str:
    """Return the origin of the numbers of a robot on wheels, in words."""
    locked, turns = robot.locked_joints, dict(zip(table.names, table.wheels, strict=True))
    moving = set[str]()
    for joint in robot.undercarriage.wheels:
        if wheel := turns.get(wheel_name(joint.name)):
            moving |= {joint.name, *(each.name for each in joint.swivels if wheel.steering != FIXED)}
    names = ", ".join(name for name in locked if name not in moving)
    words = robot.source.replace(f"; {LOCKED}", "")
    words = words.replace(f"; locked at rest: {', '.join(locked)}", names and f"; locked at rest: {names}")
    return f"{words}; {table.source}"


def read_robot(path: str | PathLike[str], dirs: Any, ground_z: Any, given: Mapping[str, Any]) -> MobileRobot:
    """Return the robot of a URDF; given radii define the ground if the file does not.

    Parameters
    ----------
    path, dirs, ground_z
        As in `MobileRobot.from_urdf`.
    given : mapping of str to any
        Arguments of `read_wheels`.
    """
    robot = MobileRobot.from_urdf(path, dirs, ground=ground_z)
    _report_ignored(Path(path))
    if robot.grounded or given.get("radius") is None:
        return robot
    wheels = _Reader(robot, given["radius"], locked=given.get("locked", ()))
    lowest = [joint.centre[2] - wheels.radius_of(joint) for joint in wheels.joints]
    return MobileRobot.from_urdf(path, dirs, ground=sum(lowest) / len(lowest))


def _report_ignored(path: Path) -> None:
    """Warn about friction in a file that has no effect."""
    root, words = ElementTree.parse(path).getroot(), list[str]()
    joints = [
        str(joint.get("name"))
        for joint in root.findall("joint")
        for x in joint.findall("dynamics")
        if joint.get("type") != "fixed" and (float(x.get("damping", 0)) or float(x.get("friction", 0)))
    ]
    elements = (each for each in root.findall("gazebo") if each.findall("mu1") + each.findall("mu2"))
    links = [str(each.get("reference")) for each in elements]
    if joints:
        words.append(
            f"damping and friction of {_format_names(joints)} act only where motors take volts (by_voltage): "
            "use forces=[ViscousFriction(...)], or WheelFriction(rolling=...) of the wheels"
        )
    if links:
        words.append(f"mu1 and mu2 of {_format_names(links)} are not used: use ground=Coulomb(mu)")
    if words:
        warn(f"{path.name}: {'; '.join(words)}", stacklevel=4)


def _format_names(names: Sequence[str]) -> str:
    """Return names as text, at most three."""
    return ", ".join(names) if len(names) < 4 else f"{names[0]}, {names[1]} and {len(names) - 2} more"
