"""Two cubics that meet at a via point."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, frozen, positive, scalar
from pinmobile.errors import InvalidArgument
from pinmobile.paths.piecewise import PiecewisePath
from pinmobile.paths.polynomials import PiecewisePolynomial, hermite, stretch
from pinmobile.paths.values import of_point
from pinmobile.plant import Parameter

__all__ = ["CubicVia"]

_REST = (0.0, 0.0)


def _parameters(size: int, *, has_velocity: bool) -> tuple[Parameter, ...]:
    return (
        *of_point("via_start", "start", "start of the path", size),
        *of_point("via", "via", "via point of the path", size),
        *of_point("via_end", "end", "end of the path", size),
        Parameter("via_time", "s", "time at the via point", 0.0, may_vanish=False, attribute="t_via"),
        *(
            of_point("via_velocity", "via_velocity", "velocity at the via point", size, unit="m/s")
            if has_velocity
            else ()
        ),
    )


@dataclass(frozen=True, init=False, eq=False, repr=False)
class CubicVia(PiecewisePath):
    """Two cubics per coordinate, from start to end through a via point (lecture, section 5.1 and 5.2).

    With a = (a_0 ... a_3) before and b after the via point,

        r(t) = sum of a_k t^k  for t < t_via,      r(t) = sum of b_k (t - t_via)^k  after it.

    With `via_velocity` given these are two independent cubics, and the acceleration jumps at the via
    point. With it free, velocity and acceleration are continuous there.

    Parameters
    ----------
    start, via, end : array_like, shape (n,)
        The three points [m]; n = 2 in the plane, any n >= 1 is accepted.
    t_via, t_end : float
        Times at the last two [s], 0 < t_via < t_end.
    via_velocity : array_like, shape (n,), optional
        Velocity at the via point [m/s]; free where left out.
    start_velocity, end_velocity : array_like, shape (n,), optional
        Velocities at the ends [m/s]; at rest where left out, for any n.

    Raises
    ------
    InvalidArgument
        If a point or velocity has another shape or is not finite, or the times are out of order.
    """

    start: Array
    via: Array
    end: Array
    t_via: float
    t_end: float
    via_velocity: Array | None
    start_velocity: Array
    end_velocity: Array

    parameters: ClassVar[tuple[Parameter, ...]] = _parameters(2, has_velocity=True)

    def __init__(
        self,
        start: ArrayLike,
        via: ArrayLike,
        end: ArrayLike,
        t_via: float,
        t_end: float,
        via_velocity: ArrayLike | None = None,
        start_velocity: ArrayLike = _REST,
        end_velocity: ArrayLike = _REST,
    ) -> None:
        first = finite("start", start)
        if first.ndim != 1 or not first.size:
            raise InvalidArgument(f"start has shape {first.shape}, expected (n,)")
        n = first.size
        keep = {
            "start": frozen(first),
            "via": _point("via", via, n),
            "end": _point("end", end, n),
            "t_via": scalar("t_via", t_via),
            "t_end": positive("t_end", t_end, "s"),
            "via_velocity": None if via_velocity is None else _point("via_velocity", via_velocity, n),
            "start_velocity": _velocity("start_velocity", start_velocity, n),
            "end_velocity": _velocity("end_velocity", end_velocity, n),
        }
        for name, value in keep.items():
            object.__setattr__(self, name, value)
        if not 0 < self.t_via < self.t_end:
            raise InvalidArgument(f"t_via is {self.t_via} s, expected 0 < t_via < t_end = {self.t_end} s")
        stretch("t_via", self.t_via)
        stretch("t_end - t_via", self.t_end - self.t_via)
        object.__setattr__(self, "_curve", self._solve())
        stated = _parameters(n, has_velocity=self.via_velocity is not None)
        object.__setattr__(self, "parameters", stated)  # in place of those in the plane

    def _solve(self) -> PiecewisePolynomial:
        velocity = self._free_velocity() if self.via_velocity is None else self.via_velocity
        before = hermite(self.t_via, self.start, self.via, self.start_velocity, velocity)
        after = hermite(self.t_end - self.t_via, self.via, self.end, velocity, self.end_velocity)
        return PiecewisePolynomial(np.array([0.0, self.t_via, self.t_end]), np.array([before, after]))

    def _free_velocity(self) -> Array:
        # The lecture's 8 x 8 system in closed form, one coordinate at a time: with the mean velocities of the
        # two cubics, their accelerations at the via are (2 v0 + 4 v - 6 mean0) / t and
        # (6 mean1 - 4 v - 2 v1) / s. A solver rounds differently from machine to machine, and what is exactly
        # zero here, as x_dot at the via of the lecture, would be so on some alone.
        t, s = self.t_via, self.t_end - self.t_via
        before = 3 * ((self.via - self.start) / t) - self.start_velocity
        after = 3 * ((self.end - self.via) / s) - self.end_velocity
        return np.asarray((before * (s / self.t_end) + after * (t / self.t_end)) / 2)


def _point(name: str, value: ArrayLike, size: int) -> Array:
    array = finite(name, value)
    if array.shape != (size,):
        raise InvalidArgument(f"{name} has shape {array.shape}, expected ({size},)")
    return frozen(array)


def _velocity(name: str, value: ArrayLike, size: int) -> Array:
    return frozen(np.zeros(size)) if value is _REST else _point(name, value, size)
