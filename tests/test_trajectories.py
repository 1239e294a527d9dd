import math
import warnings
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from pinmobile.arrays import Array, ArrayLike
from pinmobile.errors import LimitWarning
from pinmobile.paths import Circle, CompositePath, CubicVia, Hold, Lissajous, Path, RestToRest, Spline
from pinmobile.paths.path import PiecewisePolynomial, Polynomial
from pinmobile.trajectories import FixedHeading, LectureHeading, Reference, Tangent, Trajectory
from tests.refusals import begun, refusals
from tests.test_paths import EPS, VIA_FREE, VIA_STOP, derandomised

CIRCLE = Circle(3, 0.1, 60)
CROSSING = Lissajous(3, 3, 0.2, 0.1, 60)
# x' = 6 cos 3t, y' = 2 sin 2t: both vanish where cos t does, at odd multiples of pi/2.
REVERSING = Lissajous(2, 1, 3, 2, 10)
WAYPOINTS = Spline([(0, 0), (1, 2), (3, -1), (4, 4), (0, 0)], (0, 1, 3, 4.5, 8))
SMOOTH: list[Path] = [VIA_FREE, CIRCLE, CROSSING, WAYPOINTS, Circle(1, -1, 30)]
TRAJECTORIES: list[Trajectory] = [
    *(Tangent(path) for path in SMOOTH),
    Tangent(VIA_STOP, 5.0),
    Tangent(REVERSING, 0.7),
    FixedHeading(VIA_STOP, 1.5),
    LectureHeading(VIA_STOP),
]


class Cycloid:
    """A user's path, of a wheel of radius 1: v = 2 sin(t/2) (sin(t/2), cos(t/2)), cusps at 2 pi k.

        _         _
      /   \\     /   \\        psi = pi/2 - t/2 on the first arch: exact, and with a rate
     |     |   |     |       of -1/2 at rest and anywhere else
    -+-----+---+-----+-
    """

    def __init__(self, duration: float) -> None:
        self.duration = duration

    def __call__(self, t: ArrayLike) -> Array:
        return self.derivative(t, 0)

    def derivative(self, t: ArrayLike, order: int) -> Array:
        t = np.asarray(t, dtype=float)
        sine, cosine = (np.sin, np.cos, lambda s: -np.sin(s), lambda s: -np.cos(s)), order % 4
        wave = np.stack([-sine[cosine](t), -sine[(cosine + 1) % 4](t)], axis=-1)
        drift = {0: np.stack([t, np.ones_like(t)], axis=-1), 1: np.array([1.0, 0.0])}
        return np.asarray(wave + drift.get(order, 0.0))


class Drawn:
    """A path given by the polynomials of its velocity, piece by piece."""

    def __init__(self, knots: list[float], *velocities: tuple[ArrayLike, ArrayLike]) -> None:
        size = 1 + max(np.size(c) for pair in velocities for c in pair)
        rows = np.zeros((len(velocities), size, 2))
        for row, pair in zip(rows, velocities, strict=True):
            for j, column in enumerate(pair):
                row[1 : 1 + np.size(column), j] = np.atleast_1d(column) / np.arange(1, 1 + np.size(column))
        for k in range(1, len(rows)):
            powers = (knots[k] - knots[k - 1]) ** np.arange(size)
            rows[k, 0] = powers @ rows[k - 1]
        self._curve = PiecewisePolynomial(np.array(knots, dtype=float), rows)
        self.duration = float(knots[-1])

    @property
    def pieces(self) -> tuple[Polynomial, ...]:
        return self._curve.pieces

    def __call__(self, t: ArrayLike) -> Array:
        return self.derivative(t, 0)

    def derivative(self, t: ArrayLike, order: int) -> Array:
        return self._curve.derivative(np.asarray(t, dtype=float), order)


def roots(*times: float) -> Array:
    return np.asarray(np.polynomial.polynomial.polyfromroots(times), dtype=np.float64)


def on_the_circle(angle: Any) -> Any:
    return np.pi - np.mod(np.pi - angle, 2 * np.pi)


# -- along the tangent: exact values ---------------------------------------------------------------


def near(times: list[float], duration: float) -> Array:
    """Return times at, next to and ever farther from the given ones, inside the path."""
    offsets = [0.0, *(side * 10.0 ** (k / 4) for k in range(-48, 1) for side in (1, -1))]
    found = np.unique([t + d for t in times for d in offsets])
    return found[(found >= 0) & (found <= duration)]


def test_a_cycloid_keeps_its_rate_into_and_out_of_its_cusps() -> None:
    path = Cycloid(6 * np.pi)
    trajectory = Tangent(path, turn_time=2.0)
    np.testing.assert_allclose(trajectory.turns, [2 * np.pi, 4 * np.pi + 2], rtol=1e-14)
    assert trajectory.duration == pytest.approx(6 * np.pi + 4)
    s = near([0.0, 2 * np.pi, 4 * np.pi, 6 * np.pi], path.duration)
    s = s[np.abs(s / (2 * np.pi) - np.round(s / (2 * np.pi))) > 1e-13]  # the sides of a cusp are told apart
    arch = np.floor(s / (2 * np.pi))
    q, v, a = trajectory(s + 2 * arch)
    # Half a turn to the left at every cusp.
    np.testing.assert_allclose(q[:, 2], np.pi / 2 - s / 2 + np.pi * arch, rtol=0, atol=1e-13)
    np.testing.assert_allclose(v[:, 2], -0.5, rtol=0, atol=1e-12)
    np.testing.assert_allclose(a[:, 2], 0, rtol=0, atol=1e-10)
    end = trajectory(trajectory.duration)
    np.testing.assert_allclose([end.q[2], end.v[2]], [np.pi / 2 - np.pi, -0.5], rtol=0, atol=1e-13)


@pytest.mark.parametrize("rounds", [1, 1000])
@pytest.mark.parametrize("rate", [0.1, -0.1])
def test_a_circle_s_heading_grows_with_time_through_many_rounds(rate: float, rounds: int) -> None:
    path = Circle(3, rate, rounds * 2 * np.pi / abs(rate))
    start = 0 if rate > 0 else np.pi
    t = np.sort(np.append(np.linspace(0, path.duration, 4 * rounds + 1), np.linspace(0, path.duration, 999)))
    q, v, a = Tangent(path)(t)
    np.testing.assert_allclose(q[:, 2], start + rate * t, rtol=4 * EPS, atol=4 * EPS)
    np.testing.assert_allclose(v[:, 2], rate, rtol=1e-14)
    np.testing.assert_allclose(a[:, 2], 0, rtol=0, atol=1e-15)


@derandomised
@given(
    st.lists(st.sampled_from([0.0, 0.25, 0.5, 0.75, 1.0]), min_size=1, max_size=6),
    st.integers(-3, 3),
    st.integers(-3, 3),
)
@example([0.5, 0.5], 1, 1)
@example([0.5] * 6, -1, 2)
@example([0.25] + [0.5] * 5, 0, 0)
@example([0.0] * 3 + [1.0] * 3, 0, 1)
def test_rests_of_any_order_have_a_parity(rests: list[float], slope: int, level: int) -> None:
    # v = (t - r_1) (t - r_2) ... (1, level + slope t), so that psi = atan(level + slope t), or its opposite.
    speed = roots(*rests)
    path = Drawn([0, 1], (speed, np.convolve(speed, [level, slope])))
    trajectory = Tangent(path, turn_time=1.0)
    odd = [r for r in sorted(set(rests)) if 0 < r < 1 and rests.count(r) % 2]
    np.testing.assert_allclose(trajectory.turns, np.array(odd) + np.arange(len(odd)), rtol=0, atol=1e-11)
    s = near([0, *odd, *rests, 1], 1)
    passed = np.searchsorted(odd, s, side="right")
    at = np.abs(s[:, None] - np.array([*odd, 9])).min(axis=1) < 2e-11
    s, passed = s[~at], passed[~at]  # on which side of a turn rounding puts these is its own affair
    q, v, a = trajectory(s + passed)
    w = level + slope * s
    negative = sum(r > 0 for r in rests) % 2 == 1
    heading = np.arctan(w) + np.pi * (passed + negative)
    np.testing.assert_allclose(on_the_circle(q[:, 2] - heading), 0, rtol=0, atol=1e-9)
    np.testing.assert_allclose(v[:, 2], slope / (1 + w**2), rtol=0, atol=1e-8)
    np.testing.assert_allclose(a[:, 2], -2 * w * slope**2 / (1 + w**2) ** 2, rtol=0, atol=1e-6)
    assert np.abs(np.diff(trajectory(np.linspace(0, trajectory.duration, 1001)).q[:, 2])).max() < 0.1


@pytest.mark.parametrize("trajectory", TRAJECTORIES[:-1], ids=repr)
def test_every_derivative_is_that_of_the_one_before(trajectory: Trajectory) -> None:
    t = np.linspace(0.0137, 0.9871, 97) * trajectory.duration
    if isinstance(trajectory, Tangent):
        vx, vy = trajectory(t).v[:, :2].T
        assert np.abs(np.sin(trajectory(t).q[:, 2]) * vx - np.cos(trajectory(t).q[:, 2]) * vy).max() < 1e-13
    h = 1e-6 * trajectory.duration
    before, at, after = trajectory(t - h), trajectory(t), trajectory(t + h)
    # h^2 / 6 times a third derivative: these stay below 1e4 in units of the duration; and rounding over h.
    atol = (1e4 * 1e-12 + 100 * EPS * 1e6) * np.array([10 / trajectory.duration, 10 / trajectory.duration**2])
    np.testing.assert_allclose(at.v, (after.q - before.q) / (2 * h), rtol=1e-7, atol=atol[0] * 10)
    np.testing.assert_allclose(at.a, (after.v - before.v) / (2 * h), rtol=1e-6, atol=atol[1] * 100)


# -- along the tangent: turns on the spot ----------------------------------------------------------


CUBIC = CubicVia((0, 0), (1, 1), (3, 4), 1, 3, (0, 0), start_velocity=(2, 0), end_velocity=(1, 5))


@pytest.mark.parametrize("turn_time", [0.1, 1.0, 30.0])
@pytest.mark.parametrize("path", [REVERSING, Cycloid(20.0), CUBIC], ids=["3:2", "cycloid", "cubic"])
def test_a_turn_meets_heading_rate_and_acceleration_on_both_sides(path: Path, turn_time: float) -> None:
    trajectory = Tangent(path, turn_time)
    assert len(trajectory.turns)
    for start in trajectory.turns:
        end = start + turn_time
        for t in (start, end):
            left, right = trajectory(t - 1e-9), trajectory(t + 1e-9)
            # 2e-9 s apart: the difference is that much of the next derivative, at most some 1e4.
            np.testing.assert_allclose(left.q, right.q, rtol=0, atol=1e-7)
            np.testing.assert_allclose(left.v, right.v, rtol=0, atol=1e-5)
            np.testing.assert_allclose(left.a[2], right.a[2], rtol=0, atol=1e-2 * (1 + 1 / turn_time**2))
        assert (trajectory(np.linspace(start, end, 9)[:-1]).v[:, :2] == 0).all()


def test_a_half_turn_goes_to_the_left_whatever_the_direction() -> None:
    for degrees in range(-180, 180, 5):
        tip = np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees))])
        trajectory = Tangent(CubicVia((0, 0), tip, (0, 0), 1, 2), turn_time=1.0)
        assert trajectory.turns.tolist() == pytest.approx([1.0])
        first, last = trajectory([0.0, 3.0]).q[:, 2]
        assert -np.pi < first <= np.pi
        assert last - first == pytest.approx(np.pi, abs=1e-9)


def test_a_turn_takes_the_shorter_way() -> None:
    for before, after, turn in (
        (170, -170, 20),
        (-170, 170, -20),
        (10, -80, -90),
        (0, 179, 179),
        (0, -179, -179),
    ):
        a, b = (np.array([math.cos(math.radians(d)), math.sin(math.radians(d))]) for d in (before, after))
        trajectory = Tangent(CubicVia((0, 0), a, a + b, 1, 2, via_velocity=(0, 0)), turn_time=1.0)
        first, last = np.degrees(trajectory([0.0, 3.0]).q[:, 2])
        assert first == pytest.approx(before)
        assert last - first == pytest.approx(turn)


def test_a_turn_rate_that_a_hold_ends_is_reported_and_one_that_ends_straight_is_not() -> None:
    cubic = CubicVia((0, 0), (1, 0.5), (1.5, 2), 5, 10)
    with pytest.warns(LimitWarning, match=r"from 0\.03077 to 0 rad/s at t = 10 s, where the path rests"):
        Tangent(CompositePath([cubic, Hold((1.5, 2), 3)]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Tangent(CompositePath([RestToRest((0, 0), (1, 1), 3), Hold((1, 1), 2)]))
        Tangent(cubic)


# Late on a clock its steps are 1.5e-11 s, so that no speed is below 1e-12 of the largest.
LATE = 2.0**17


@pytest.mark.parametrize(
    ("path", "rests", "rtol"),
    [
        (Drawn([0, 1], (roots(0.3, 0.30001), roots(0.3, 0.30001, -2))), [0.3, 0.30001], 1e-10),
        (Drawn([0, 1], (roots(1e-9), roots(1e-9, 2))), [1e-9], 1e-12),
        (Drawn([0, 1], (roots(1 - 1e-9), roots(1 - 1e-9, 2))), [1 - 1e-9], 1e-12),
        (Drawn([0, 1, 2], ([-1 - 1e-9, 1], [0]), ([-1e-9, 1], [0])), [1 + 1e-9], 1e-15),
        (Drawn([0, LATE, LATE + 1], ([-0.3], [0.3]), (roots(0.3), -roots(0.3))), [LATE + 0.3], 1e-15),
        (Lissajous(3, 3, 0.3, 0.2, 1000 * np.pi), (np.pi / 2 + np.pi * np.arange(100)) / 0.1, 1e-13),
        (Lissajous(3, 0, 2 * np.pi, 0, 64), 0.25 + np.arange(128) / 2, 1e-13),
    ],
    ids=["close", "at the start", "at the end", "behind a knot", "late", "many", "in step with samples"],
)
def test_every_rest_is_found_in_its_place(path: Path, rests: ArrayLike, rtol: float) -> None:
    expected = np.asarray(rests) + np.arange(np.size(rests))
    np.testing.assert_allclose(Tangent(path, 1.0).turns, expected, rtol=rtol, atol=0)


def test_a_rest_just_outside_is_none() -> None:
    for rest in (-1e-9, 1 + 1e-9):
        trajectory = Tangent(Drawn([0, 1], (roots(rest), -roots(rest))))
        assert trajectory.turns.tolist() == []
        assert len(set(trajectory([0, 0.5, 1]).q[:, 2])) == 1


def test_a_dwell_keeps_the_heading() -> None:
    ahead, still, left = ([0, 6, -6], [0]), ([0], [0]), ([0], [0, 6, -6])
    path = Drawn([0, 1, 2, 3, 4, 5], still, ahead, still, left, still)
    trajectory = Tangent(path, turn_time=1.0)
    assert trajectory.turns.tolist() == [3.0]
    q, v, a = trajectory([0, 0.5, 1, 1.5, 2, 2.5, 3, 3.5, 4, 5, 6])
    np.testing.assert_allclose(np.degrees(q[:, 2]), [*[0] * 7, 45, 90, 90, 90], rtol=0, atol=1e-13)
    assert (v[[0, 1, 2, 5], 2] == 0).all()
    assert (a[[0, 1, 2, 5], 2] == 0).all()
    ends = Tangent(Drawn([0, 1, 2], left, still))
    assert ends.turns.size == 0
    np.testing.assert_allclose(ends([0, 1, 1.5, 2]).q[:, 2], np.pi / 2, rtol=1e-15)


# -- errata: what is right, and that the lecture's version is not ----------------------------------


@pytest.mark.parametrize("rounding", [0.0, 1e-17, -1e-17, 1e-15, -1e-15, -1e-12])
def test_a_start_due_west_has_the_heading_plus_pi_whatever_rounding_leaves_of_y(rounding: float) -> None:
    path = Drawn([0, 1, 2], ([-1.0], [rounding]), ([-1.0], [rounding]))
    headings = Tangent(path)([0.0, 0.5, 2.0]).q[:, 2]
    np.testing.assert_allclose(headings, np.pi, rtol=0, atol=1e-11)


# -- the lecture's heading -------------------------------------------------------------------------


def test_the_lecture_s_formulas() -> None:
    t = np.linspace(0.1, 59.9, 599)
    for path in (VIA_FREE, CIRCLE, CROSSING):
        q, v, a = LectureHeading(path)(t)
        (xd, yd), (xdd, ydd) = path.derivative(t, 1).T, path.derivative(t, 2).T
        np.testing.assert_allclose(q[:, 2], np.arctan2(yd, xd) % (2 * np.pi), rtol=0, atol=1e-15)
        moving = xd != 0  # as at the via of the free path
        xd, yd, xdd, ydd = (values[moving] for values in (xd, yd, xdd, ydd))
        # What cancels in the formula is at most |y''/x'| or |y' x''/x'^2|, with a rounding or two of each.
        size = (np.abs(ydd / xd) + np.abs(yd * xdd) / xd**2) / (yd**2 / xd**2 + 1)
        formula = (ydd / xd - (yd * xdd) / xd**2) / (yd**2 / xd**2 + 1)
        assert (np.abs(v[moving, 2] - formula) <= 8 * np.finfo(float).eps * size).all()
        assert (a[:, 2] == 0).all()
        for order, got in enumerate((q, v, a)):
            assert (got[:, :2] == path.derivative(t, order)).all()


# -- fixed heading ---------------------------------------------------------------------------------


# -- all of them -----------------------------------------------------------------------------------


@pytest.mark.parametrize("trajectory", TRAJECTORIES, ids=repr)
def test_no_time_matters_to_another(trajectory: Trajectory) -> None:
    t = np.linspace(0, trajectory.duration, 60)
    whole = trajectory(t)
    assert isinstance(whole, Reference)
    order = np.random.default_rng(0).permutation(60)
    shuffled = trajectory(t[order].reshape(3, 4, 5))
    for got, wanted in zip(shuffled, whole, strict=True):
        assert got.shape == (3, 4, 5, 3)
        assert got.tobytes() == wanted[order].tobytes()
    for k, time in enumerate(t.tolist()):
        for got, wanted in zip(trajectory(time), whole, strict=True):
            assert got.shape == (3,)
            assert got.tobytes() == wanted[k].tobytes()
    assert [got.shape for got in trajectory([])] == [(0, 3)] * 3


# -- what is refused -------------------------------------------------------------------------------


class Broken(Cycloid):
    """A user's path with something wrong."""

    def __init__(self, duration: float, pieces: tuple[Polynomial, ...] = (), spoilt: float = 0.0) -> None:
        super().__init__(duration)
        self.pieces, self._spoilt = pieces, spoilt

    def derivative(self, t: ArrayLike, order: int) -> Array:
        return super().derivative(t, order) + (self._spoilt if order else 0.0)


TORN = Polynomial(0.0, 1.0, np.zeros((2, 2))), Polynomial(1.5, 3.0, np.zeros((2, 2)))

test_tangent_refuses = refusals(
    (lambda: Tangent(VIA_STOP), "turn_time is None, expected > 0 s: the path rests at t = 30.0 s and its"),
    (lambda: Tangent(Drawn([0, 1, 2], ([1], [0]), ([0], [2])), 5.0), "path has a corner at t = 1.0 s,"),
    (lambda: Tangent(CubicVia((5, 5), (5, 5), (5, 5), 1, 2)), "path never moves, so it has no tangent;"),
    (
        lambda: Tangent(Drawn([0, 1], (roots(*[0] * 7), roots(*[0] * 7)))),
        "path has no direction at t = 0.0 s: its first 7 derivatives vanish there",
    ),
    (
        lambda: Tangent(CubicVia((0, 0, 0), (1, 1, 1), (2, 2, 2), 1, 2)),
        "path at t = 0 has shape (3,), expected (2,), a path in the plane",
    ),
    (lambda: Tangent(Broken(3.0, TORN)), "path.pieces has (start, end) [(0.0, 1.0), (1.5, 3.0)], expected"),
    (lambda: Tangent(Broken(3.0, spoilt=math.nan)), "path has no finite derivative of order 1 at t = "),
    by=begun,
)
