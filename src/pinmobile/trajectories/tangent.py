"""A path driven along its tangent, with turns on the spot where the tangent jumps."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from pinmobile.arrays import Array, ArrayLike, frozen, positive
from pinmobile.errors import InvalidArgument
from pinmobile.paths import Path, within
from pinmobile.plant import Parameter
from pinmobile.trajectories.hodograph import Hodograph, heading, hodograph
from pinmobile.trajectories.reference import Reference, joined, plane_path
from pinmobile.trajectories.turns import TurnsOnTheSpot
from pinmobile.trajectories.winding import Jump, Winding

__all__ = ["Tangent"]


@dataclass(frozen=True)
class Tangent:
    """Along a path with the heading along its tangent (lecture, section 5.4, and its errata).

        psi      = atan2(y', x'), unwrapped from (-pi, pi] at the start
        psi_dot  = (x' y'' - y' x'') / (x'^2 + y'^2),   psi_ddot its derivative

    Where the path rests these are the limits from the right (at its end from the left), exactly. Where
    the tangent jumps at a rest the path is held for `turn_time` while the heading turns on the spot, by
    the shorter way, a half turn to the left: the quintic that meets psi, psi_dot and psi_ddot on both
    sides. The trajectory lasts longer than the path by these turns. While the path dwells the heading
    stays.

    Parameters
    ----------
    path : Path
        A path of two coordinates. Derivatives of order 0 to 3 are asked for, higher ones where it rests.
    turn_time : float, optional
        How long each turn on the spot lasts [s], > 0. Without it a path that needs one is refused.

    Attributes
    ----------
    turns : ndarray, shape (m,)
        Times at which a turn on the spot begins, on the clock of the trajectory [s].

    Raises
    ------
    InvalidArgument
        If `path` is no path in the plane; never moves; has a corner that it does not rest at; needs to
        turn on the spot but has no `turn_time`; or `turn_time` is not above zero.
    """

    path: Path
    turn_time: float | None = None

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("turn_time", "s", "time of each turn on the spot", 0.0, may_vanish=False),
    )

    turns: Array = field(init=False, repr=False, compare=False)
    _hodograph: Hodograph = field(init=False, repr=False, compare=False)
    _winding: Winding = field(init=False, repr=False, compare=False)
    _stops: TurnsOnTheSpot = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        plane_path(self.path)
        if self.turn_time is None:
            object.__setattr__(self, "parameters", ())
        else:
            object.__setattr__(self, "turn_time", positive("turn_time", self.turn_time, "s"))
        direction = hodograph(self.path)
        winding = Winding(direction)
        for jump in winding.jumps:
            _check(jump, self.turn_time)
        stops = TurnsOnTheSpot(winding.jumps, self.turn_time or 0.0, float(self.path.duration))
        for name, value in (("_hodograph", direction), ("_winding", winding), ("_stops", stops)):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "turns", frozen(stops.starts))

    @property
    def duration(self) -> float:
        """The path's duration and that of all turns on the spot [s]."""
        return self._stops.duration

    def __call__(self, t: ArrayLike) -> Reference:
        """Return the reference.

        Parameters
        ----------
        t : array_like, shape (...)
            Times, 0 <= t <= duration [s].

        Returns
        -------
        reference : Reference
            Arrays of shape (..., 3).

        Raises
        ------
        InvalidArgument
            If a time is outside.
        """
        clock = within("t", t, self.duration)
        s = self._stops.path_times(clock)
        position, v, a, jerk = (np.asarray(self.path.derivative(s, order)) for order in range(4))
        angle, rate, acceleration = heading(*self._hodograph.along(s, v, a, jerk))
        headings = (self._winding.unwrap(s, angle), rate, acceleration)
        return self._stops.filled(clock, joined((position, v, a), headings))


def _check(jump: Jump, turn_time: float | None) -> None:
    before, after = np.degrees([jump.before[0], jump.after[0]])
    if jump.speed:
        raise InvalidArgument(
            f"path has a corner at t = {jump.time} s, from {before:.6g} deg to {after:.6g} deg, taken at "
            f"{jump.speed:.6g} m/s; expected no corner, or one that the path rests at"
        )
    if turn_time is None:
        raise InvalidArgument(
            f"turn_time is None, expected > 0 s: the path rests at t = {jump.time} s and its direction "
            f"jumps there, from {before:.6g} deg to {after:.6g} deg"
        )
