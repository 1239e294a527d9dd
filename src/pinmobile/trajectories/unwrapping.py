"""Which of its values, 2 pi apart, the heading along a path has; and where it jumps."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pinmobile.arrays import LEAST_ANGLE, Array
from pinmobile.constancy import constant
from pinmobile.trajectories.direction import Hodograph, Leg, Limit, halve, heading

_CELLS = 4
_LEVELS = 60
# A jump below this is rounding of a direction; what rounding the velocity adds comes on top.
_STRAIGHT = 1e-9
_ROUNDING = 1e-14


@dataclass(frozen=True, eq=False)
class Jump:
    """A jump of the heading at a knot or rest.

    Parameters
    ----------
    time : float
        When [s].
    before, after : ndarray, shape (3,)
        The heading and its first two derivatives on both sides [rad, rad/s, rad/s^2].
    speed : float
        The smaller of the speeds on both sides [m/s].
    """

    time: float
    before: Array
    after: Array
    speed: float


@constant
class Winding:
    """The heading along a path, unwrapped from a table made once: no time asked for matters to another.

    Between two times of the table the heading turns by less than 60 deg, so that the entry before a
    time tells which multiple of 2 pi belongs to the arctangent there.

    Parameters
    ----------
    hodograph : Hodograph
        The direction of motion.
    """

    def __init__(self, hodograph: Hodograph) -> None:
        legs = hodograph.legs
        nodes = _nodes(hodograph)
        u, _, _ = hodograph(nodes)
        first = np.searchsorted(nodes, [leg.head.time for leg in legs])
        ends = np.array([leg.tail.series[0] for leg in legs])  # (L, 2)
        # The end of a leg stands in the table beside the start of the next one, at the same time.
        behind = np.append(first[1:], len(nodes))
        times = np.insert(nodes, behind, [leg.tail.time for leg in legs])
        angles = np.insert(_angle(u), behind, _angle(ends))
        joints = behind[:-1] + np.arange(len(legs) - 1)  # the ends but the last
        steps = -np.round(np.diff(angles) / (2 * np.pi))
        jumps = np.diff(angles)[joints] + 2 * np.pi * steps[joints]
        # A half turn goes to the left, also where rounding has made it one to the right.
        to_the_right = jumps < _STRAIGHT - np.pi
        steps[joints[to_the_right]] += 1
        jumps[to_the_right] += 2 * np.pi
        rounds = np.cumsum(np.append(float(angles[0] <= LEAST_ANGLE), steps))
        self._times, self._psi = times, angles + 2 * np.pi * rounds
        self.jumps = tuple(
            _jump(legs[i], legs[i + 1], self._psi[joints[i]], self._psi[joints[i] + 1])
            for i in np.flatnonzero(np.abs(jumps) > _slack(hodograph))
        )

    def unwrap(self, t: Array, angle: Array) -> Array:
        """Return the heading [rad] at `t` [s] from its value in [-pi, pi], `angle`; all of shape (...)."""
        nearby = self._psi[np.searchsorted(self._times, t, side="right") - 1]
        return np.asarray(angle + 2 * np.pi * np.round((nearby - angle) / (2 * np.pi)))


def _nodes(hodograph: Hodograph) -> Array:
    cells = np.concatenate([_first_cells(leg) for leg in hodograph.legs])
    done, left = halve(hodograph, cells, _LEVELS)
    return np.sort(np.append(done[:, 0], left[:, 0]))


def _first_cells(leg: Leg) -> Array:
    start, end = leg.head.time, leg.tail.time
    # Where a series takes over u changes its scale: cells end there.
    first = min(start + max(leg.head.window, 0.0), end)
    last = max(end - max(leg.tail.window, 0.0), first)
    edges = np.unique([start, *np.linspace(first, last, _CELLS + 1), end])
    return np.stack([edges[:-1], edges[1:]], axis=-1)


def _jump(before: Leg, after: Leg, psi_before: float, psi_after: float) -> Jump:
    left, right = before.tail, after.head
    return Jump(
        right.time,
        _derivatives(left, psi_before),
        _derivatives(right, psi_after),
        min(left.speed, right.speed),
    )


def _derivatives(limit: Limit, psi: float) -> Array:
    u, du, half = np.concatenate([limit.series, np.zeros((2, 2))])[:3]
    _, rate, acceleration = heading(u, du, 2 * half)
    return np.array([psi, rate, acceleration])


def _slack(hodograph: Hodograph) -> Array:
    limits = ((before.tail, after.head) for before, after in pairwise(hodograph.legs))
    slowest = [min(limit.speed or hodograph.top for limit in pair) for pair in limits]
    return np.asarray(_STRAIGHT + _ROUNDING * hodograph.top / np.array(slowest))


def _angle(u: Array) -> Array:
    return np.asarray(np.arctan2(u[..., 1], u[..., 0]))
