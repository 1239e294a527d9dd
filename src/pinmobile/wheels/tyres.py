"""What of a robot on wheels may touch something: its own shapes, its wheels and what else it stands on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array
from pinmobile.robot import BODY_JOINT, MobileRobot, Solid, Solids, body_box
from pinmobile.wheels.drawn import ACROSS, height_above_wheels, riding, wheel_frames
from pinmobile.wheels.kinematics import Kinematics
from pinmobile.wheels.table import WheelTable

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
