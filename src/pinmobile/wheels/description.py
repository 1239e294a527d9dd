"""A wheel table from what a robot's file says of its wheels: taken, guessed, or asked for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import atan2, cos, hypot, sin
from os import PathLike
from pathlib import Path
from warnings import warn
from xml.etree import ElementTree

import numpy as np

from pinmobile.arrays import ArrayLike, sequence
from pinmobile.errors import InvalidArgument, shown
from pinmobile.parts import evolved
from pinmobile.robot import TOUCH, MobileRobot
from pinmobile.wheels.table import (
    DRIVEN,
    FIXED,
    FREE,
    Coupling,
    Differential,
    GearTrain,
    Support,
    Wheel,
    WheelTable,
    each_of,
)
from pinmobile.wheels.wheel_joints import (
    Given,
    WheelJoints,
    left_of,
    motor_of,
    snapped,
    to_length,
    wheel_name,
)

_LINE = 1e-3  # [m]: axles so near one line are on it


def read_wheels(
    robot: MobileRobot,
    *,
    radius: float | Mapping[str, float] | None = None,
    rollers: float | Mapping[str, float] | None = None,
    driven: Sequence[str] | None = None,
    steering: Mapping[str, str] | None = None,
    inertia: ArrayLike | Mapping[str, ArrayLike] | None = None,
    locked: Sequence[str] = (),
    supports: Iterable[ArrayLike] | None = None,
    couplings: Sequence[Coupling] = (),
) -> WheelTable:
    """Return the wheel table of a robot read from a URDF or a model; its `source` says what is from where.

    The wheels are called as their joints, in the model's order. The axis of a joint at rest is the axle, made
    level; angles that the file rounds, such as 1.57, are exact to 15 degrees, and axles within 1 mm of one
    line are on it. A wheel rolls forward (or left, where its axle is along x) at a positive rate; where
    its joint turns the other way, as in mirrored frames, `WheeledRobot.joint_signs` has -1. A wheel with
    rollers whose axle is parallel to no other keeps its joint's sense.

    Masses and inertias are those of the links, which the robot's whole holds already. Of a caster, what its
    fork's turning adds is in the wheel's mass and yaw inertia. The effort of a driven joint is its motor's
    torque limit, its damping and friction are the motor's, which act where it is driven by volts; those of
    other joints are left out.

    A mapping, below, has names of wheel joints.

    Parameters
    ----------
    robot : MobileRobot
        With the `undercarriage` of its file.
    radius : float or mapping of str to float, optional
        [m]; a number is that of all wheels of which the file does not tell it.
    rollers : float or mapping of str to float, optional
        Angle of the axis of the roller at the ground from the rolling direction [rad], see `Wheel`; wheels
        without are tyres, all of them with ``{}``. A number is that of all: 0 of omni wheels; else of four
        mecanum wheels, whose rollers form an X seen from above where it is positive. It must be given where
        wheels are fixed on more than one axle, unless a gear train says that they skid.
    driven : sequence of str, optional
        Wheels with a motor; by default those that hang on no swivel, or where there are none, those whose
        steering is driven; of a gear train the first one alone, of a differential none.
    steering : mapping of str to str, optional
        Of wheels on a swivel ``"fixed"``, ``"driven"`` or ``"free"``; by default a swivel with limits is
        driven, one that turns freely is free where the wheel trails behind it, and fixed of a wheel with
        rollers.
    inertia : sequence of 2 floats, or mapping of str to that, optional
        Of a wheel about its axle and across it [kg m^2]; a pair is that of all. The whole robot's mass and
        inertia stay those of the file.
    locked : sequence of str
        Wheel joints that are no wheels of the table: where they touch the ground they carry, without
        friction.
    supports : sequence of (x, y), optional
        Where it stands beside its wheels [m]; by default where the file has what touches the ground.
    couplings : sequence of GearTrain, Differential, Ackermann
        See `WheelTable`.

    Raises
    ------
    InvalidArgument
        If there are no wheels, a radius, or whether they have rollers, is not known, wheels do not stand on
        one plane, a wheel is no solid of revolution about its axle or hangs on what a table has no row for;
        or an argument is something else.
    UnknownName
        If there is no such wheel.
    """
    joined = sequence("couplings", couplings, "GearTrain, Differential or Ackermann")
    given = Given(radius, rollers, driven, steering, inertia, locked, supports, joined)
    return _Reader(WheelJoints(robot, given)).table()


def joint_signs(robot: MobileRobot, table: WheelTable) -> dict[str, int]:
    """Return of each wheel of its file 1, or -1 where the joint there turns the other way.

    Parameters
    ----------
    robot : MobileRobot
        With the `undercarriage` of its file.
    table : WheelTable
        Its wheels, called as the joints.
    """
    found = {wheel_name(joint.name): joint for joint in robot.undercarriage.wheels}
    rows = [wheel for wheel in table.wheels if wheel.name in found]
    return {
        wheel.name: 1 if left_of(wheel.angle) @ found[wheel.name].axis[:2] > 0 else -1  # axle +n is left of e
        for wheel in rows
    }


def read_robot(
    path: str | PathLike[str],
    package_dirs: str | PathLike[str] | Sequence[str | PathLike[str]],
    ground_z: ArrayLike | None,
    radius: float | Mapping[str, float] | None,
    locked: Sequence[str],
) -> MobileRobot:
    """Return the robot of a URDF, on the ground by given radii where the file does not tell where that is.

    Parameters
    ----------
    path, package_dirs, ground_z
        As in `MobileRobot.from_urdf`.
    radius, locked
        As in `read_wheels`.
    """
    robot = MobileRobot.from_urdf(path, package_dirs, ground=ground_z)
    _report_ignored(Path(path))
    if robot.grounded or radius is None:
        return robot
    wheels = WheelJoints(robot, Given(radius=radius, locked=locked))
    lowest = [joint.centre[2] - wheels.radius(joint) for joint in wheels.joints]
    return MobileRobot.from_urdf(path, package_dirs, ground=sum(lowest) / len(lowest))


def _report_ignored(path: Path) -> None:
    """Warn of what a file says of friction that changes nothing."""
    root = ElementTree.parse(path).getroot()
    joints, links = [], []
    for joint in root.findall("joint"):
        dynamics = joint.find("dynamics")
        given = () if dynamics is None else (dynamics.get(name, "0") for name in ("damping", "friction"))
        if any(float(x) for x in given) and joint.get("type") != "fixed":
            joints.append(str(joint.get("name")))
    for gazebo in root.findall("gazebo"):
        if gazebo.find("mu1") is not None or gazebo.find("mu2") is not None:
            links.append(str(gazebo.get("reference")))
    words = []
    if joints:
        words.append(
            f"damping and friction of {_listed(joints)} act where motors take volts alone (by_voltage): give "
            "forces=[ViscousFriction(...)], or Friction(rolling=...) of the wheels"
        )
    if links:
        words.append(f"mu1 and mu2 of {_listed(links)} are not used: give ground=Coulomb(mu)")
    if words:
        warn(f"{path.name}: {'; '.join(words)}", stacklevel=4)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) < 4 else f"{names[0]}, {names[1]} and {len(names) - 2} more"


class _Reader:
    """The table of a robot's wheels, and words for what became of them."""

    def __init__(self, wheels: WheelJoints) -> None:
        self.wheels, self.robot, self.given = wheels, wheels.robot, wheels.given
        self.joints, self.standing = wheels.joints, wheels.standing
        self.words: list[str] = []

    def table(self) -> WheelTable:
        """Return the table."""
        if isinstance(self.given.radius, (float, int)) and all(each.radius for each in self.joints):
            raise InvalidArgument(
                f"radius is {shown(self.given.radius)} m, but the file tells that of every wheel; expected a "
                "mapping for those that have another"
            )
        rows = [self.wheels.row(joint) for joint in self.joints]
        self._check_plane(rows)
        rows = self._on_lines(rows)
        self._check_told(rows)
        driven = self._driven(rows)
        rows = [
            evolved(row, motor=motor_of(joint)) if joint.name in driven else row
            for row, joint in zip(rows, self.joints, strict=True)
        ]
        supports = self._supports(rows)
        table = WheelTable(tuple(rows), supports, self.given.couplings)
        return WheelTable(table.wheels, table.supports, table.couplings, "; ".join(self._told(table)))

    def _check_plane(self, rows: Sequence[Wheel]) -> None:
        lowest = {
            joint.name: joint.centre[2] - row.radius for joint, row in zip(self.joints, rows, strict=True)
        }
        heights = [*lowest.values(), *([0.0] if self.robot.grounded else [])]
        if max(heights) - min(heights) > TOUCH:
            listed = ", ".join(f"{name} at z = {z:.4g}" for name, z in lowest.items())
            ground = ", the ground at z = 0" if self.robot.grounded else ""
            raise InvalidArgument(
                f"wheels do not stand on one plane, their lowest points being {listed}{ground} m, expected "
                f"them within {1e3 * TOUCH:g} mm, other radii, or locked= for those that do not roll"
            )

    def _on_lines(self, rows: Sequence[Wheel]) -> list[Wheel]:
        """Return the rows with axles of fixed tyres that are nearly on one line on it."""
        found, moved = list(rows), 0.0
        tyres = [k for k, row in enumerate(rows) if row.steering == FIXED and row.roller is None]
        offsets = {k: cos(rows[k].angle) * rows[k].x + sin(rows[k].angle) * rows[k].y for k in tyres}
        for k in tyres:
            line = [
                offsets[j]
                for j in tyres
                if rows[j].angle == rows[k].angle and abs(offsets[j] - offsets[k]) <= _LINE
            ]
            away = sum(line) / len(line) - offsets[k] if max(line) > min(line) else 0.0
            if away:
                angle = rows[k].angle
                found[k] = evolved(
                    rows[k],
                    x=to_length(rows[k].x + away * cos(angle)),
                    y=to_length(rows[k].y + away * sin(angle)),
                )
                moved = max(moved, abs(away))
        if moved > 1e-9:
            self.words.append(f"axles put on one line, by {1e3 * moved:.2g} mm at most")
        return found

    def _check_told(self, rows: Sequence[Wheel]) -> None:
        """Refuse to guess what wheels on several axles are, where nothing says that they skid."""
        fixed = [row for row in rows if row.steering == FIXED]
        axles = {
            (round(row.angle, 9), round(cos(row.angle) * row.x + sin(row.angle) * row.y, 9)) for row in fixed
        }
        trains = any(isinstance(each, GearTrain) for each in self.given.couplings)
        if self.given.rollers is None and len(axles) > 1 and not trains:
            raise InvalidArgument(
                f"rollers is not given, and wheels {', '.join(repr(row.name) for row in fixed)} are fixed on "
                "more than one axle: they are tyres that skid in turns, or have rollers, which files do not "
                "tell; expected rollers={} for tyres, rollers=pi / 4 for mecanum wheels, or a mapping"
            )

    def _driven(self, rows: Sequence[Wheel]) -> list[str]:
        if self.given.driven is not None:
            return [
                self.wheels.known("driven", name)
                for name in sequence("driven", self.given.driven, "names of wheels")
            ]
        shared: set[str] = set()
        for each in self.given.couplings:
            if isinstance(each, Differential):
                shared.update(each.wheels)
            elif isinstance(each, GearTrain):
                shared.update(each.wheels[1:])
        pairs = [pair for pair in zip(self.joints, rows, strict=True) if pair[1].name not in shared]
        fixed = [joint.name for joint, row in pairs if row.steering == FIXED]
        standing = any(row.steering == FIXED for row in rows)
        return fixed if standing else [joint.name for joint, row in pairs if row.steering == DRIVEN]

    def _supports(self, rows: Sequence[Wheel]) -> tuple[Support, ...]:
        if self.given.supports is not None:
            return tuple(Support(*at) for at in each_of("supports", self.given.supports))
        taken, found = [row.centre for row in rows], []
        for place in [*self.robot.undercarriage.supports, *(joint.centre[:2] for joint in self.standing)]:
            x, y = (to_length(number) for number in place)
            if all(hypot(x - x0, y - y0) > _LINE for x0, y0 in taken):
                taken.append((x, y))
                found.append(Support(x, y))
        return tuple(found)

    def _told(self, table: WheelTable) -> list[str]:
        """Return what is from where, in words."""
        pairs = list(zip(table.wheels, self.joints, strict=True))
        told = [f"wheels of its file: {', '.join(joint.name for joint in self.joints)}"]

        def tell(words: str, *chosen: bool) -> None:
            names = [joint.name for (_, joint), is_one in zip(pairs, chosen, strict=True) if is_one]
            if names:
                told.append(f"{words} {', '.join(names)}" if len(names) < len(pairs) else f"{words} all")

        by_hand = [joint.radius != row.radius for row, joint in pairs]
        tell("radius by the collision geometry of", *(not hand for hand in by_hand))
        tell("radius as given of", *by_hand)
        tell("the joint turns the other way at", *(s < 0 for s in joint_signs(self.robot, table).values()))
        exact = [abs(snapped(a := atan2(-joint.axis[0], joint.axis[1])) - a) > 1e-9 for _, joint in pairs]
        tell("axes that the file rounds are exact at", *exact)
        tell(
            "inertia as given, the whole's as in the file, of",
            *(self.wheels.told("inertia", joint.name) is not None for _, joint in pairs),
        )
        guess = "" if self.given.driven is not None else "guessed: "
        tell(f"{guess}motors at", *(row.motor is not None for row, _ in pairs))
        tell("torque limit by the file's effort at", *(_limited(row) for row, _ in pairs))
        rubs = [(row.motor is not None) + 1 if joint.damping or joint.friction else 0 for row, joint in pairs]
        tell("damping and friction of the joint are the motor's at", *(rub == 2 for rub in rubs))
        tell("damping and friction of the joint are left out at", *(rub == 1 for rub in rubs))
        tell("turns freely behind its swivel:", *(row.steering == FREE for row, _ in pairs))
        tell("steering driven at", *(row.steering == DRIVEN for row, _ in pairs))
        tell("swivel locked of", *(bool(joint.swivels) and row.steering == FIXED for row, joint in pairs))
        if self.given.rollers is None:
            told.append("guessed: no wheel has rollers, of which files do not tell")
        elif not any(row.roller is not None for row, _ in pairs):
            told.append("no rollers as given")
        else:
            tell("rollers as given at", *(row.roller is not None for row, _ in pairs))
        told += self.words
        if self.given.locked:
            told.append(f"locked: {', '.join(self.given.locked)}")
        if table.supports:
            places = ", ".join(f"({each.x:.4g}, {each.y:.4g})" for each in table.supports)
            near = f"where the file is within {1e3 * TOUCH:g} mm of the ground"
            given = "as given" if self.given.supports is not None else near
            told.append(f"supports without friction {given}, at {places} m")
        return told


def _limited(wheel: Wheel) -> bool:
    return wheel.motor is not None and np.isfinite(wheel.motor.torque_limit)
