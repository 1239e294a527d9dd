"""`Judgement`: what is worth judging about a robot with arms beside the errors of its coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.measures import Measure
from pinmobile.robot.stance import WEIGHTLESS, margin_inside, pressed_at


@dataclass(frozen=True, eq=False)
class Judgement:
    """The measures of a robot with arms, and their law, for Pinocchio's numbers as for symbols and arrays.

    Parameters
    ----------
    tips : tuple of (str, str)
        The arms' names, and the frames of their end effectors.
    effort_limit : ndarray, shape (nv,)
        Largest |u| [N, N m]; infinite where there is no limit.
    footprint : ndarray, shape (k, 2), or None
        What the robot stands on, where that and the ground's height are known [m].
    rest : ndarray, shape (nq,)
        Where the reference puts what it does not lead.
    """

    tips: tuple[tuple[str, str], ...]
    effort_limit: Array
    footprint: Array | None
    rest: Array

    @classmethod
    def of(cls, robot: Any) -> Judgement:
        """Return that of a `MobileRobot`."""
        tips = tuple((mount.name, mount.tip) for mount in robot.mounts)
        stands = robot.footprint if robot.grounded else None
        return cls(tips, robot.effort_limit, stands, robot.rest)

    @property
    def _limited(self) -> list[int]:
        return np.flatnonzero(np.isfinite(self.effort_limit)).tolist()

    @cached_property
    def measures(self) -> tuple[Measure, ...]:
        """What `measured` returns."""
        found = []
        for k, (arm, tip) in enumerate(self.tips):
            of = f" of {arm}" if k else ""  # the first arm's is the robot's
            where = "where the reference puts it"
            found.append(Measure(f"end effector{of}", "m", f"distance of {tip} from {where}"))
            found.append(Measure(f"end effector angle{of}", "rad", f"angle of {tip} to {where}"))
        if self._limited:
            words = "largest |force or torque| of a joint, of what its motor can do"
            found.append(Measure("effort", "", words))
        if self.footprint is not None:
            words = "distance of the zero-moment point inside the footprint's edge"
            found.append(Measure("tip-over margin", "m", words, "smallest"))
        return tuple(found)

    def measured(self, robot: Any, q: Any, v: Any, a: Any, u: Any, desired: Any) -> Any:
        """Return the measures of a robot that moves so, shape (..., m).

        Parameters
        ----------
        robot : MobileRobot or ArticulatedBody
            Whose kinematics and dynamics they are.
        q, v, a, u : ndarray, shape (..., nq), (..., nv), (..., nv), (..., nv)
            State, acceleration and input.
        desired : ndarray, shape (..., k)
            Where the reference has the first numbers of q.
        """
        rest = self.rest[np.shape(desired)[-1] :]
        rest = np.broadcast_to(rest, (*np.shape(desired)[:-1], len(rest)))
        desired = np.concatenate([desired, rest], axis=-1)
        found: list[Any] = []
        for _, tip in self.tips:
            found += _apart(robot.frame_pose(q, tip), robot.frame_pose(desired, tip))
        if self._limited:
            shares = np.abs(u[..., self._limited]) * (1.0 / self.effort_limit[self._limited])
            found.append(np.max(shares, axis=-1))
        if self.footprint is not None:
            wrench = robot.ground_wrench(q, v, a)
            carried = wrench[..., 2] > WEIGHTLESS * robot.weight
            margin = margin_inside(self.footprint, pressed_at(wrench, carried))
            found.append(np.where(carried, margin, -np.inf))
        return np.stack(np.broadcast_arrays(*found), axis=-1)


def _apart(one: Any, other: Any) -> tuple[Any, Any]:
    """Return the distance [m] and the angle [rad], in [0, pi], between poses, shape (..., 4, 4)."""
    way = other[..., :3, 3] - one[..., :3, 3]
    # Of the rotation from one to the other: 1 + 2 cos is its trace, and sin the length of its skew part.
    trace: Any = 0.0
    axis: list[Any] = [0.0, 0.0, 0.0]
    for k in range(3):
        x, y = one[..., :3, k], other[..., :3, k]
        trace = trace + x[..., 0] * y[..., 0] + x[..., 1] * y[..., 1] + x[..., 2] * y[..., 2]
        for i in range(3):
            j, m = (i + 1) % 3, (i + 2) % 3
            axis[i] = axis[i] + (x[..., j] * y[..., m] - x[..., m] * y[..., j])
    sine = 0.5 * np.sqrt(axis[0] * axis[0] + axis[1] * axis[1] + axis[2] * axis[2])
    return np.sqrt(np.sum(way * way, axis=-1)), np.arctan2(sine, 0.5 * (trace - 1.0))
