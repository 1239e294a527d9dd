"""Visual and collision geometry of a robot on wheels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array
from pinmobile.robot import (
    BODY,
    BODY_JOINT,
    Mesh,
    MobileRobot,
    Solid,
    Solids,
    body_box,
    box_visuals,
    merge_meshes,
    mesh_of,
    number,
    revolve,
)
from pinmobile.wheels._kinematics import Kinematics
from pinmobile.wheels._table import FIXED, Wheel, WheelTable
from pinmobile.wheels._urdf_reader import wheel_name

TYRE_WIDTH = 0.45  # width of a tyre in radii
_LOWEST = 0.7  # largest height of a box's bottom, relative to its height
_TOP, _TOP_OF_FORK = 2.1, 2.35  # height above the ground in radii of the wheel
_SUPPORT = 0.3  # radius of a drawn support in radii of the largest wheel


class Item(NamedTuple):
    """Attachment of an object to a joint of the robot without wheels, to a wheel, or to its steering.

    Attributes
    ----------
    joint : int
        Number of the joint, from 0; -1: a wheel.
    row : int
        Row of the wheel.
    spins : bool
        Whether it spins with the wheel; otherwise it only steers with it.
    placement : ndarray, shape (4, 4)
        Placement in this frame.
    """

    joint: int
    row: int
    spins: bool
    placement: Array


class _Objects:
    """Abstract base: objects of a robot on wheels, and their placements in the inertial frame.

    Objects of the robot's file move with the nearest of their joints that is a wheel's or its swivel's.
    `chains` has the joints of the file that move each object, the nearest first.
    """

    def __init__(self, robot: MobileRobot, table: WheelTable, chains: Mapping[str, tuple[str, ...]]) -> None:
        self.robot, self.table, self.items = robot, table, list[Item]()
        self._kinematics, self._n = Kinematics.of(table), robot.nq
        rows, carriers = {name: row for row, name in enumerate(table.names)}, dict[str, tuple[int, bool]]()
        for joint in robot.undercarriage.wheels:
            if (row := rows.get(wheel_name(joint.name))) is not None:
                steers = table.wheels[row].steering != FIXED
                carriers |= {swivel.name: (row, False) for swivel in joint.swivels[:1] if steers}
                carriers[joint.name] = row, True
        nearest = {name: next(filter(carriers.__contains__, joints), "") for name, joints in chains.items()}
        self._rides = {name: carriers[joint] for name, joint in nearest.items() if joint}
        present = {row for row, spins in self._rides.values() if spins}
        self.lacking = [(row, wheel) for row, wheel in enumerate(table.wheels) if row not in present]

    def _item(self, name: str, joint: int, placement: Array) -> Item:
        """Return the attachment of an object of the file to a joint, or to a wheel that moves it."""
        if name not in self._rides:
            return Item(joint, -1, False, placement)
        row, spins = self._rides[name]
        steering, wheels = np.zeros(len(self.table.axes)), np.zeros(len(self.table)) if spins else None
        frames = wheel_frames(self._kinematics, steering, wheels)
        return Item(-1, row, spins, np.linalg.inv(frames[row]) @ placement)

    def placements(self, q: Array) -> Array:
        """Return the placements of the objects in the inertial frame, shape (..., k, 4, 4).

        Parameters
        ----------
        q : ndarray, shape (..., nq)
            Configuration of the robot on wheels.
        """
        n, axes, lead = self._n, len(self.table.axes), q.shape[:-1]
        joints = self.robot.frame_placements(q[..., :n])
        body = joints[..., BODY_JOINT - 1, None, :, :]
        steering, wheels = q[..., n : n + axes], q[..., n + axes :]
        wheel_T = body @ wheel_frames(self._kinematics, steering, wheels)
        steering_T = body @ wheel_frames(self._kinematics, steering, None)
        poses = np.empty((*lead, len(self.items), 4, 4))
        for k, item in enumerate(self.items):
            turning = wheel_T if item.spins else steering_T
            frame = joints[..., item.joint, :, :] if item.joint >= 0 else turning[..., item.row, :, :]
            poses[..., k, :, :] = frame @ item.placement
        return poses


class Tyres(_Objects):
    """Collision geometry of a robot on wheels, and its placements.

    Shapes of the file that turn with a wheel steer with it. A wheel without shapes in the file is a cylinder
    of a usual tyre width. The rotation of wheels is ignored, because they are round.

    Parameters
    ----------
    robot : MobileRobot
        Robot without wheels, or from a file with wheels.
    table : WheelTable
        Wheels.
    """

    def __init__(self, robot: MobileRobot, table: WheelTable) -> None:
        import coal

        solids, standing, shapes = robot.solids, set[str](), list[Solid]()
        super().__init__(robot, table, {str(k): shape.joints for k, shape in enumerate(solids.shapes)})

        def add(shape: Solid, item: Item, stands: bool) -> None:
            shapes.append(shape)
            self.items.append(item)
            standing.update([shape.link] if stands else [])

        for k, shape in enumerate(solids.shapes):
            if robot.is_box and shape.part == 0 and shape.link == body_box(robot.size).link:
                shape = body_box(robot.size, height_above_wheels(robot.size, table))  # above the wheels
            item = self._item(str(k), BODY_JOINT - 1 + shape.part, shape.placement.homogeneous)
            add(shape, item, item.spins)
        level = pin.SE3(pin.utils.rotate("x", np.pi / 2), np.zeros(3))  # a cylinder's axis is z, an axle y
        for row, wheel in self.lacking:
            tyre = coal.Cylinder(wheel.radius, TYRE_WIDTH * wheel.radius)
            shape = Solid(f"{wheel.name}/tyre", 0, wheel.placement * level, tyre)
            add(shape, Item(-1, row, True, level.homogeneous), True)
        radius = _SUPPORT * max(wheel.radius for wheel in table.wheels)
        for k, support in enumerate(table.supports, start=1):
            place = pin.SE3(np.eye(3), np.array([support.x, support.y, radius]))
            ball = Solid(f"support_{k}/ball", 0, place, coal.Sphere(radius))
            add(ball, Item(BODY_JOINT - 1, -1, False, place.homogeneous), True)
        self.solids: Solids = replace(solids, shapes=tuple(shapes), standing=frozenset(standing))

    def placements(self, q: Array) -> Array:
        """Return the placements of the shapes in the body's frame, shape (..., shapes, 4, 4)."""
        q_body = q.copy()
        q_body[..., :BODY_JOINT] = 0.0
        q_body[..., self._n + len(self.table.axes) :] = 0.0
        return super().placements(q_body)


def wheel_frames(kinematics: Kinematics, steering: Array, wheels: Array | None) -> Array:
    """Return the frames of wheels, or of their steering, in the body's frame, shape (..., wheels, 4, 4).

    x is along e, z up. The frame of a wheel is at its centre, rotated about its axle y; that of the steering
    is on the ground below the pivot.

    Parameters
    ----------
    kinematics : Kinematics
        The wheels.
    steering : ndarray, shape (..., axes)
        Angles of the axes [rad].
    wheels : ndarray, shape (..., wheels), or None
        Angles of the wheels [rad]; None for the steering.
    """
    angles = list(np.moveaxis(steering, -1, 0))
    frames = np.zeros((*steering.shape[:-1], len(kinematics.table), 4, 4))
    for row, wheel in enumerate(kinematics.table.wheels):
        head, (_, centre) = kinematics.heading(row, angles), kinematics.centre(row, angles)
        c, s, x, y = (number(each) for each in (head.c, head.s, *centre))
        phi: Any = 0.0 if wheels is None else wheels[..., row]
        cp, sp, z = np.cos(phi), np.sin(phi), wheel.radius
        if wheels is None:
            x, y, z = wheel.x, wheel.y, 0.0
        rows = [cp * c, -s, sp * c, x], [cp * s, c, sp * s, y], [-sp, 0, cp, z], [0, 0, 0, 1]
        for i, k in np.ndindex(4, 4):
            frames[..., row, i, k] = rows[i][k]
    return frames


def height_above_wheels(size: Sequence[float], table: WheelTable) -> float:
    """Return the height of a box's bottom above the ground, so that it is above its wheels [m]."""
    length, width, height = size
    needed = [0.0]
    for wheel in table.wheels:
        x, y = (abs(value) for value in wheel.centre)
        reach = 0.5 * TYRE_WIDTH * wheel.radius
        clears = x > length / 2 + wheel.radius or y > width / 2 + 0.9 * reach
        tall = _TOP if wheel.steering == FIXED else _TOP_OF_FORK
        needed.append((0.6 if clears else tall) * wheel.radius)
    return min(max(needed), _LOWEST * height)


_DARK, _LIGHT, _GREY = (0.17, 0.17, 0.19, 1.0), (0.86, 0.87, 0.88, 1.0), (0.55, 0.56, 0.58, 1.0)
_SPOKES = 5
_ROLLERS = 10  # rollers per row of a wheel
_LONGEST = 0.8  # largest half length of a roller in radii of the wheel
_IN_ROWS = 0.35  # [rad]: rollers at a smaller angle are in two alternating rows


class WheelVisuals(_Objects):
    """Visual geometry of a robot on wheels, and its placements.

    Parameters
    ----------
    robot : MobileRobot
        Robot without wheels, or from a file with visuals of wheels.
    table : WheelTable
        Wheels.
    """

    def __init__(self, robot: MobileRobot, table: WheelTable) -> None:
        import coal

        super().__init__(robot, table, robot.visual_joints)
        self.visuals = pin.GeometryModel()
        items = list(robot.visual_model.geometryObjects)
        has_box = any(item.name == BODY for item in items)
        clearance = height_above_wheels(robot.size, table) if has_box else 0.0
        if has_box:
            box = BODY, "front", "wedge"
            rest = [item for item in items if item.parentJoint != BODY_JOINT or item.name not in box]
            items = [*box_visuals(robot.size, clearance).geometryObjects, *rest]
        for item in items:
            copy = item.copy()
            copy.parentJoint, copy.placement = 0, pin.SE3.Identity()
            self.visuals.addGeometryObject(copy)
            self.items.append(self._item(item.name, item.parentJoint - 1, item.placement.homogeneous))
        coupled = {row for axis in table.axes if axis.ackermann is not None for row in axis.wheels}
        lacking = dict(self.lacking)
        for row, wheel in enumerate(table.wheels):
            if row in lacking:
                parts = _tyre(wheel) if wheel.roller is None else _rollers(wheel, wheel.roller)
                for name, part, colour in zip(("tyre", "spokes"), parts, (_DARK, _LIGHT), strict=True):
                    self._add(f"{wheel.name}/{name}", mesh_of(*part), colour, Item(-1, row, True, np.eye(4)))
                if wheel.steering != FIXED and row not in coupled:
                    fork = mesh_of(*_fork(wheel))
                    self._add(f"{wheel.name}/fork", fork, _GREY, Item(-1, row, False, np.eye(4)))
            else:  # a bar makes the rotation of a smooth wheel visible
                R = wheel.radius
                bar = _box((-0.09 * R, -0.14 * R, 0.96 * R), (0.09 * R, 0.14 * R, 1.015 * R))
                self._add(f"{wheel.name}/bar", mesh_of(*bar), _DARK, Item(-1, row, True, np.eye(4)))
        radius = _SUPPORT * max(wheel.radius for wheel in table.wheels)
        top = max(clearance, 2.2 * radius)
        ball, cup = coal.Sphere(radius), coal.Cylinder(1.15 * radius, top - 1.1 * radius)
        shapes = ("ball", ball, radius, _LIGHT), ("cup", cup, (top + 1.1 * radius) / 2, _GREY)
        for k, support in enumerate(table.supports, 1):
            for name, shape, z, colour in shapes:
                placement = pin.SE3(np.eye(3), np.array([support.x, support.y, z])).homogeneous
                self._add(f"support_{k}/{name}", shape, colour, Item(BODY_JOINT - 1, -1, False, placement))

    def _add(self, name: str, shape: object, colour: Sequence[float], item: Item) -> None:
        """Add an object with its colour and attachment."""
        visual = pin.GeometryObject(name, 0, pin.SE3.Identity(), shape)
        visual.meshColor = np.array(colour)
        self.visuals.addGeometryObject(visual)
        self.items.append(item)


def _box(low: Sequence[float], high: Sequence[float]) -> Mesh:
    """Return a box between two corners."""
    corners = np.array([[(low, high)[i >> k & 1][k] for k in range(3)] for i in range(8)])
    quads = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))
    return corners, np.array([face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))])


def _about_axle(triangles: Mesh, angle: float) -> Mesh:
    """Return triangles rotated about the axle."""
    (c, s), (vertices, faces) = (np.cos(angle), np.sin(angle)), triangles
    return vertices @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T, faces


def _tyre(wheel: Wheel) -> tuple[Mesh, Mesh]:
    """Return tyre, and hub with spokes and a bar across the tread, which shows the rotation."""
    R = wheel.radius
    w = TYRE_WIDTH * R / 2
    ring = [(-w, 0.66), (-w, 0.9), (-0.7 * w, 1.0), (0.7 * w, 1.0), (w, 0.9), (w, 0.66), (-w, 0.66)]
    tyre = revolve([(y, r * R) for y, r in ring])
    hub = revolve([(-0.9 * w, 0.0), (-0.9 * w, 0.24 * R), (0.9 * w, 0.24 * R), (0.9 * w, 0.0)], 16)
    spoke = _box((-0.07 * R, -0.8 * w, 0.2 * R), (0.07 * R, 0.8 * w, 0.68 * R))
    spokes = [_about_axle(spoke, 2 * np.pi * k / _SPOKES) for k in range(_SPOKES)]
    ring = [(-0.85, 0.6), (-0.85, 0.68), (0.85, 0.68), (0.85, 0.6), (-0.85, 0.6)]
    rim = revolve([(y * w, r * R) for y, r in ring])
    bar = _box((-0.09 * R, -0.7 * w, 0.9 * R), (0.09 * R, 0.7 * w, 1.01 * R))
    sides = [_box((-0.09 * R, y - 0.1 * w, 0.7 * R), (0.09 * R, y + 0.1 * w, 0.92 * R)) for y in (-w, w)]
    return tyre, merge_meshes([hub, rim, bar, *sides, *spokes])


def _rollers(wheel: Wheel, roller: float) -> tuple[Mesh, Mesh]:
    """Return rollers, all but one, and the hub with that one.

    The axis of the roller at the ground is at the wheel's roller angle; from above, the mirror image is
    visible.
    """
    R = wheel.radius
    rows = 2 if abs(roller) < _IN_ROWS else 1
    thick = (0.16 if rows == 2 else 0.15) * R
    count = _ROLLERS if rows == 1 else 6
    reach = R - thick
    half = 1.15 * reach * np.tan(np.pi / (count * rows)) / np.cos(roller)
    half = min(half, _LONGEST * R)
    single = _roller(R, thick, half, roller)
    rollers = []
    for row in range(rows):
        vertices, faces = single
        copy = vertices + np.array([0.0, (row - (rows - 1) / 2) * 2.3 * thick, 0.0]), faces
        rollers += [_about_axle(copy, 2 * np.pi * (k + row / rows) / count) for k in range(count)]
    wide = half * abs(np.sin(roller)) + thick * (0.4 if rows == 1 else 2.2)
    rim = (reach - 0.5 * thick) if rows == 2 else (reach - 0.9 * thick)
    half_hub = [(-1.0, 0.0), (-1.0, 0.5), (-0.5, 1.0), (0.5, 1.0), (1.0, 0.5), (1.0, 0.0)]
    hub = revolve([(y * wide, r * rim) for y, r in half_hub])
    return merge_meshes(rollers[1:]), merge_meshes([rollers[0], hub])


def _roller(R: float, thick: float, half: float, angle: float) -> Mesh:
    """Return the roller at the ground, with a profile that makes the wheel round."""
    c, s, reach = np.cos(angle), np.sin(angle), R - thick
    ways = np.linspace(-half, half, 9)
    profile = [(a, R - float(np.hypot(a * c, reach))) for a in ways]
    vertices, faces = revolve([(ways[0], 0.0), *profile, (ways[-1], 0.0)], 12)
    axis, level = np.array([c, s, 0.0]), np.array([s, -c, 0.0])
    points = vertices[:, 1:2] * axis + vertices[:, :1] * level + vertices[:, 2:] * [0.0, 0.0, 1.0]
    return points - [0.0, 0.0, reach], faces


def _fork(wheel: Wheel) -> Mesh:
    """Return the fork of a steered wheel, in the frame on the ground below its pivot."""
    R, (ox, oy) = wheel.radius, wheel.trail
    w = TYRE_WIDTH * R / 2 if wheel.roller is None else 0.4 * R
    legs = [
        _box((ox - 0.09 * R, y - 0.05 * R, 0.9 * R), (ox + 0.09 * R, y + 0.05 * R, 2.1 * R))
        for y in (oy - w - 0.07 * R, oy + w + 0.07 * R)
    ]
    low, high = min(ox, 0.0) - 0.2 * R, max(ox, 0.0) + 0.2 * R
    crown = _box((low, min(oy, 0.0) - w - 0.12 * R, 2.08 * R), (high, max(oy, 0.0) + w + 0.12 * R, 2.22 * R))
    vertices, faces = revolve([(2.2 * R, 0.0), (2.2 * R, 0.2 * R), (2.6 * R, 0.2 * R), (2.6 * R, 0.0)], 16)
    post = vertices[:, [2, 0, 1]], faces
    return merge_meshes([*legs, crown, post])
