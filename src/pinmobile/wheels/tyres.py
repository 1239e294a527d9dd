"""Where wheels are, what of a file turns with them, and what of a robot on them may touch something."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array
from pinmobile.robot import BODY_JOINT, MobileRobot, Solid, Solids, body_box, number
from pinmobile.wheels.kinematics import Kinematics
from pinmobile.wheels.table import FIXED, WheelTable
from pinmobile.wheels.wheel_joints import wheel_name

ACROSS = 0.45
"""Width of a tyre, in radii."""
_LOWEST = 0.7  # of the height of a box: how high its bottom is at most
_TOP, _TOP_OF_FORK = 2.1, 2.35  # above the ground, in radii of the wheel
_SUPPORT = 0.3  # radius of what else it stands on, in radii of the largest wheel


class Tyres:
    """The shapes of a robot on wheels, and where they are.

    Those of its file that turn with a wheel steer with it; of wheels that no file shows it is a cylinder of a
    tyre's usual width. Wheels are round: that they spin does not count.

    Parameters
    ----------
    robot : MobileRobot
        Without wheels, or of a file that has them.
    table : WheelTable
        Its wheels.
    """

    def __init__(self, robot: MobileRobot, table: WheelTable) -> None:
        self._robot, self._table, self._kinematics = robot, table, Kinematics.of(table)
        own = robot.solids
        moved = {str(k): shape.joints for k, shape in enumerate(own.shapes)}
        rides = {int(name): row for name, row in riding(robot, table, moved).items()}
        spinning = {row for row, spins in rides.values() if spins}
        body = [self._of_body(shape) for shape in own.shapes]
        added = list(self._missing(spinning))
        self._rows = [
            *((k, row, spins) for k, (row, spins) in rides.items()),
            *((len(body) + k, row, True) for k, (row, _) in enumerate(added) if row >= 0),
        ]
        shapes = (*body, *(shape for _, shape in added))
        standing = {shapes[k].link for k, _, spins in self._rows if spins}
        standing |= {shape.link for row, shape in added if row < 0}
        self.solids: Solids = replace(own, shapes=shapes, standing=frozenset(standing))
        still = np.zeros(len(table.axes))
        self._own = np.stack([shape.placement.homogeneous for shape in shapes])
        for k, row, spins in self._rows:
            self._own[k] = np.linalg.inv(self._frames(still, spins)[row]) @ self._own[k]

    def _of_body(self, shape: Solid) -> Solid:
        """Return a shape of the robot without wheels; a box stands above them."""
        if not (self._robot.is_box and shape.part == 0 and shape.link == body_box(self._robot.size).link):
            return shape
        return body_box(self._robot.size, height_above_wheels(self._robot.size, self._table))

    def _missing(self, there: set[int]) -> Iterator[tuple[int, Solid]]:
        """Return the wheels that no file shows, with their rows, and what else it stands on, with -1."""
        import coal

        level = pin.utils.rotate("x", np.pi / 2)  # a cylinder's axis is z, an axle y
        frames = self._frames(np.zeros(len(self._table.axes)), True)
        for row, wheel in enumerate(self._table.wheels):
            if row not in there:
                placement = pin.SE3(frames[row]) * pin.SE3(level, np.zeros(3))
                tyre = coal.Cylinder(wheel.radius, ACROSS * wheel.radius)
                yield row, Solid(f"{wheel.name}/tyre", 0, placement, tyre)
        radius = _SUPPORT * max(wheel.radius for wheel in self._table.wheels)
        for k, support in enumerate(self._table.supports, start=1):
            placement = pin.SE3(np.eye(3), np.array([support.x, support.y, radius]))
            yield -1, Solid(f"support_{k}/ball", 0, placement, coal.Sphere(radius))

    def _frames(self, steering: Array, spins: bool) -> Array:
        lead = steering.shape[:-1]
        still = np.zeros((*lead, len(self._table))) if spins else None
        return wheel_frames(self._table, self._kinematics, steering, still, lead)

    def placements(self, q: Array) -> Array:
        """Return where the shapes are in the body's frame, shape (..., shapes, 4, 4).

        Parameters
        ----------
        q : ndarray, shape (..., nq)
            Configuration of the robot on wheels.
        """
        n, axes = self._robot.nq, len(self._table.axes)
        still = q[..., :n].copy()
        still[..., :BODY_JOINT] = 0.0
        parts = self._robot.frame_placements(still)[..., BODY_JOINT - 1 :, :, :]
        found = np.asarray(parts[..., [shape.part for shape in self.solids.shapes], :, :] @ self._own)
        steering = q[..., n : n + axes]
        frames = {spins: self._frames(steering, spins) for spins in (True, False)}
        for k, row, spins in self._rows:
            found[..., k, :, :] = frames[spins][..., row, :, :] @ self._own[k]
        return found


def wheel_frames(
    table: WheelTable, kinematics: Kinematics, steering: Array, wheels: Array | None, lead: tuple[int, ...]
) -> Array:
    """Return the frames of wheels, or of what steers with them, on the body, shape (..., wheels, 4, 4).

    x along e, z up; of a wheel at its centre, turned about its axle y; else on the ground below a pivot.

    Parameters
    ----------
    table, kinematics
        Of the wheels.
    steering : ndarray, shape (..., axes)
        Angles of the axes [rad].
    wheels : ndarray, shape (..., wheels), or None
        Angles of the wheels [rad]; None of what steers.
    lead : tuple of int
        Leading axes.
    """
    angles = list(np.moveaxis(steering, -1, 0))
    found = np.zeros((*lead, len(table), 4, 4))
    found[..., 3, 3] = 1.0
    for row, wheel in enumerate(table.wheels):
        head = kinematics.heading(row, angles)
        c, s = (number(x) for x in (head.c, head.s))
        _, centre = kinematics.centre(row, angles)
        x, y = (number(p) for p in centre) if wheels is not None else (wheel.x, wheel.y)
        phi = np.zeros(lead) if wheels is None else wheels[..., row]
        cp, sp = np.cos(phi), np.sin(phi)
        e, n = (c, s), (-s, c)
        frame = found[..., row, :, :]
        for i in range(2):
            frame[..., i, 0], frame[..., i, 1], frame[..., i, 2] = cp * e[i], n[i], sp * e[i]
        frame[..., 2, 0], frame[..., 2, 2] = -sp, cp
        frame[..., 0, 3], frame[..., 1, 3] = x, y
        frame[..., 2, 3] = 0.0 if wheels is None else wheel.radius
    return found


def riding(
    robot: MobileRobot, table: WheelTable, moved: Mapping[str, tuple[str, ...]]
) -> dict[str, tuple[int, bool]]:
    """Return which objects of a robot's file turn with a wheel: its row, and whether they spin with it.

    Parameters
    ----------
    robot : MobileRobot
        What was read from the file.
    table : WheelTable
        Its wheels.
    moved : mapping of str to tuple of str
        Of each object by name the joints of the file that would move it, the nearest first.
    """
    rows = {name: row for row, name in enumerate(table.names)}
    spinning: dict[str, int] = {}
    steering: dict[str, int] = {}
    for joint in robot.undercarriage.wheels:
        row = rows.get(wheel_name(joint.name))
        if row is not None:
            spinning[joint.name] = row
            if table.wheels[row].steering != FIXED:
                steering |= {swivel.name: row for swivel in joint.swivels[:1]}
    found: dict[str, tuple[int, bool]] = {}
    for name, joints in moved.items():
        for joint_name in joints:
            if joint_name in spinning or joint_name in steering:
                spins = joint_name in spinning
                found[name] = (spinning if spins else steering)[joint_name], spins
                break
    return found


def height_above_wheels(size: Sequence[float], table: WheelTable) -> float:
    """Return how high the bottom of a box stands above the ground: above wheels that are below it [m]."""
    length, width, height = size
    needed = [0.0]
    for wheel in table.wheels:
        x, y = (abs(value) for value in wheel.centre)
        reach = 0.5 * ACROSS * wheel.radius
        beside = x > length / 2 + wheel.radius or y > width / 2 + 0.9 * reach
        tall = _TOP if wheel.steering == FIXED else _TOP_OF_FORK
        needed.append((0.6 if beside else tall) * wheel.radius)
    return min(max(needed), _LOWEST * height)
