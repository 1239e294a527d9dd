"""A whole-body reference that follows a pose, with its own judgement."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from pinmobile.arrays import Array, ArrayLike, frozen
from pinmobile.paths import within
from pinmobile.reaching.poses import PosePath, error_sizes, pose_error
from pinmobile.robot import MobileRobot
from pinmobile.trajectories import Reference

__all__ = ["Resolved"]

_DEGREE = 3


@dataclass(frozen=True, eq=False, repr=False)
class Resolved:
    """A trajectory of all coordinates, a uniform cubic B-spline of them; made by `resolve`.

    q is twice continuously differentiable, and v and a are its derivatives. q, v and a are averages of the
    control points, their first and their second differences (de Boor, "A practical guide to splines", 1978):
    bounds that those hold hold at all times, not at samples alone.

    Attributes
    ----------
    robot : MobileRobot
        Whose coordinates they are.
    target : PosePath
        What was to be followed.
    frame : str
        The frame that follows it.
    start : ndarray, shape (nq,)
        Configuration at the first control point.
    controls : ndarray, shape (N + 3, nv)
        Displacements of the control points from `start`, evenly over time, one beyond either end.
    """

    robot: MobileRobot
    target: PosePath
    frame: str
    start: Array
    controls: Array
    _curve: Any = field(init=False)

    def __post_init__(self) -> None:
        # Here, because scipy is heavy and `EndEffectorTracking` does without it.
        from scipy.interpolate import BSpline

        for name in ("start", "controls"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        steps = np.arange(len(self.controls) + _DEGREE + 1.0) - _DEGREE
        knots = self.duration / (len(self.controls) - _DEGREE) * steps
        object.__setattr__(self, "_curve", BSpline(knots, self.controls, _DEGREE))

    def __repr__(self) -> str:
        metres, radians = self.max_error()
        turn = f", {radians:.3e} rad" if self.target.rows == 6 else ""
        return f"<Resolved: {self.frame} over {self.duration:g} s, largest error {metres:.3e} m{turn}>"

    @property
    def duration(self) -> float:
        """That of the target [s]."""
        return self.target.duration

    @property
    def t(self) -> Array:
        """Times of the control points between the ends, shape (N + 1,) [s]."""
        return np.linspace(0, self.duration, len(self.controls) - 2)

    def __call__(self, t: ArrayLike) -> Reference:
        """Return the reference.

        Parameters
        ----------
        t : array_like, shape (...)
            Times, 0 <= t <= duration [s].

        Returns
        -------
        reference : Reference
            q, shape (..., nq), v and a, shape (..., nv).

        Raises
        ------
        InvalidArgument
            If a time is outside.
        """
        times = within("t", t, self.duration)
        displacement, v, a = (self._curve(times, order) for order in range(3))
        # What rounding carries beyond a limit is cut off.
        q = np.clip(self.robot.integrate(self.start, displacement), self.robot.lower, self.robot.upper)
        return Reference(q, v, a)

    @cached_property
    def error(self) -> Array:
        """From the pose to its target at the times `t`, shape (N + 1, 6) [m, rad], along the inertial axes.

        The last three are the rotation vector; zero where the position alone is followed.
        """
        error = pose_error(self.target(self.t).pose, self.robot.frame_pose(self(self.t).q, self.frame))
        error[:, self.target.rows :] = 0
        return frozen(error)

    def max_error(self) -> tuple[float, float]:
        """Return the largest distance [m] and the largest angle [rad] from the target."""
        way, turn = error_sizes(self.error).max(axis=0)
        return float(way), float(turn)
