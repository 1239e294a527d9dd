import math
import pickle
import re
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from pinmobile import PD, MobileRobot, Tangent, Uniform, ensemble
from pinmobile.errors import InvalidArgument
from pinmobile.paths import (
    Circle,
    CompositePath,
    CubicVia,
    Hold,
    Line,
    Lissajous,
    Path,
    Polyline,
    RestToRest,
    Spline,
    TransformedPath,
    pieces_of,
)
from tests.refusals import begun, refusals

derandomised = settings(derandomize=True, deadline=None, max_examples=30)
number = st.floats(-10, 10).map(lambda x: round(x, 3))
EPS = float(np.finfo(float).eps)

VIA_STOP = CubicVia((0, 0), (2, 2), (0, 4), 30, 60, via_velocity=(0, 0))
VIA_FREE = CubicVia((0, 0), (2, 2), (0, 4), 30, 60)
SPLINE = Spline([(0, 0), (1, 2), (3, -1), (4, 4)], (0, 1, 3, 4.5), start_velocity=(1, 0))
EIGHT = Lissajous(3, 2, 0.2, 0.4, 60)
QUINTIC = RestToRest((1, -2), (3, 4), 2.5)
LINE = Line((0, 1), (3, 1), 6)
TURN = Circle(1, 0.5, 4, (3, 2), heading=0.0)
ROUNDED = Polyline([(0, 0), (4, 0), (4, 3), (1, 4)], 0.5, 22.7, 0.3)
MOVED = TransformedPath(SPLINE, 1, -2, 0.7)
CHAINED = CompositePath([LINE, TURN])
PATHS = [
    *(VIA_STOP, VIA_FREE, SPLINE, EIGHT, Circle(3, 0.1, 60), QUINTIC, Hold((1, 2), 3)),
    *(LINE, TURN, Circle(2, -0.3, 9, phase=0.4), ROUNDED, MOVED, CHAINED),
]


@st.composite
def cubics(draw: st.DrawFn) -> CubicVia:
    n = draw(st.integers(1, 4))
    start, via, end, *velocities = (draw(st.lists(number, min_size=n, max_size=n)) for _ in range(6))
    t_via, rest = (draw(st.floats(0.1, 100)) for _ in range(2))
    if draw(st.booleans()):
        velocities[0] = None  # type: ignore[call-overload]
    through, *ends = velocities
    own = dict(zip(("start_velocity", "end_velocity"), ends, strict=True))
    return CubicVia(start, via, end, t_via, t_via + rest, through, **own)


# -- two cubics ------------------------------------------------------------------------------------


@derandomised
@given(cubics())
def test_a_cubic_passes_its_points_with_its_velocities(path: CubicVia) -> None:
    times = np.concatenate([np.linspace(piece.start, piece.end, 20) for piece in path.pieces])
    rate = max(np.abs(path.derivative(times, 1)).max(), 1.0)
    # The terms of a cubic are as large as its speed makes them, and cancel.
    scale = max(np.abs(path(times)).max(), rate * path.duration, 1.0)
    before, after = path.pieces
    for piece, t, r in (
        (before, 0.0, path.start),
        (before, path.t_via, path.via),
        (after, path.t_via, path.via),
        (after, path.t_end, path.end),
    ):
        np.testing.assert_allclose(piece.derivative(t, 0), r, rtol=0, atol=16 * EPS * scale)
    np.testing.assert_allclose(before.derivative(0.0, 1), path.start_velocity, rtol=0, atol=0)
    np.testing.assert_allclose(
        after.derivative(path.t_end, 1), path.end_velocity, rtol=0, atol=64 * EPS * rate
    )
    if path.via_velocity is not None:
        np.testing.assert_allclose(path.derivative(path.t_via, 1), path.via_velocity, rtol=0, atol=0)
    else:
        bends = [piece.derivative(path.t_via, 2) for piece in path.pieces]
        size = max(np.abs(path.derivative(times, 2)).max(), 1e-300)
        np.testing.assert_allclose(bends[0], bends[1], rtol=0, atol=1e-12 * size)


def test_the_lecture_s_via_free_coefficients() -> None:
    # Section 5.2 with the demonstration's numbers, solved by hand: v_via = (0, 1/10).
    before, after = VIA_FREE.pieces
    third = Fraction(1, 3)
    a = [[0, 0], [0, 0], [third / 50, third / 100], [-Fraction(1, 6750), -Fraction(1, 27000)]]
    b = [[2, 2], [0, Fraction(1, 10)], [-third / 50, 0], [Fraction(1, 6750), -Fraction(1, 27000)]]
    np.testing.assert_allclose(before.coefficients, np.array(a, float), rtol=1e-14, atol=1e-16)
    np.testing.assert_allclose(after.coefficients, np.array(b, float), rtol=1e-14, atol=1e-16)
    # Without a solver there is no rounding that differs from machine to machine: x' is zero.
    assert VIA_FREE.derivative(30.0, 1).tolist() == [0, 0.1]


# -- splines ---------------------------------------------------------------------------------------


@derandomised
@given(st.integers(2, 8), st.integers(1, 3), st.data())
def test_a_spline_is_c2_through_its_waypoints(k: int, n: int, data: st.DataObject) -> None:
    points = np.array(data.draw(st.lists(number, min_size=k * n, max_size=k * n))).reshape(k, n)
    steps = data.draw(st.lists(st.floats(0.5, 5), min_size=k - 1, max_size=k - 1))
    path = Spline(points, [0, *np.cumsum(steps)], start_velocity=np.ones(n))
    np.testing.assert_allclose(path(path.times), points, rtol=0, atol=1e-12)
    np.testing.assert_allclose(path.derivative(0, 1), 1, rtol=0, atol=1e-12)
    np.testing.assert_allclose(path.derivative(path.duration, 1), 0, rtol=0, atol=1e-11)
    for left, right in zip(path.pieces, path.pieces[1:], strict=False):
        for order in (0, 1, 2):
            np.testing.assert_allclose(
                left.derivative(left.end, order), right.derivative(right.start, order), rtol=0, atol=1e-10
            )


# -- Lissajous figures -----------------------------------------------------------------------------


def test_lissajous_is_the_lecture_s_formula() -> None:
    t = np.linspace(0, 60, 601)
    expected = np.stack([3 * np.sin(0.2 * t), 2 - 2 * np.cos(0.4 * t)], axis=-1)
    np.testing.assert_allclose(EIGHT(t), expected, rtol=1e-14, atol=1e-15)


# -- rests -----------------------------------------------------------------------------------------


def test_a_quintic_goes_straight_from_rest_to_rest() -> None:
    path = RestToRest((1, -2, 0.5), (3, 4, 0.5), 2.5)
    for t, point in ((0.0, path.start), (2.5, path.end)):
        # The five terms are as large as 15 times the way.
        np.testing.assert_allclose(path(t), point, rtol=0, atol=30 * EPS * 6)
        for order in (1, 2):
            np.testing.assert_allclose(path.derivative(t, order), 0, atol=1e-13)
    np.testing.assert_allclose(path(1.25), (path.start + path.end) / 2, rtol=1e-14)
    speed = path.derivative(np.linspace(0, 2.5, 101), 1)
    np.testing.assert_allclose(speed.max(axis=0), 15 / 8 * (path.end - path.start) / 2.5, rtol=1e-14)
    assert path.pieces[0].derivative(1.0, 5)[0] == pytest.approx(720 * 2 / 2.5**5)


# -- all of them -----------------------------------------------------------------------------------


@pytest.mark.parametrize("path", PATHS, ids=repr)
@pytest.mark.parametrize("order", range(5))
def test_every_derivative_is_that_of_the_one_before(path: Path, order: int) -> None:
    t = np.linspace(0.013, 0.987, 40) * path.duration
    h = 1e-5 * path.duration
    # Between knots: central differences across one would mix two pieces.
    knots = [piece.start for piece in pieces_of(path)]
    t = t[[min(abs(x - k) for k in knots) > h for x in t]]
    slope = (path.derivative(t + h, order) - path.derivative(t - h, order)) / (2 * h)
    # h^2 / 6 of the third derivative from here, and the rounding of the values over h.
    curved = np.abs(path.derivative(t, order + 3)).max() * h**2 / 6
    rounding = 8 * EPS * (1 + np.abs(path.derivative(t, order)).max()) / h
    np.testing.assert_allclose(path.derivative(t, order + 1), slope, rtol=0, atol=2 * curved + rounding)


@pytest.mark.parametrize("path", PATHS, ids=repr)
def test_times_of_any_shape_broadcast_bit_for_bit(path: Path) -> None:
    t = np.linspace(0, path.duration, 24)
    for order in (0, 1, 2, 3, 7):
        whole = path.derivative(t, order)
        assert whole.shape == (24, 2)
        assert (path.derivative(t.reshape(2, 3, 4), order) == whole.reshape(2, 3, 4, 2)).all()
        assert path.derivative([], order).shape == (0, 2)
        for k, x in enumerate(t.tolist()):
            single = path.derivative(x, order)
            assert single.shape == (2,)
            assert single.tobytes() == whole[k].tobytes()
    assert (path(t) == path.derivative(t, 0)).all()


@pytest.mark.parametrize("path", PATHS, ids=repr)
def test_pieces_lie_end_to_end_and_agree_with_the_path(path: Path) -> None:
    pieces = pieces_of(path)
    assert pieces[0].start == 0
    assert pieces[-1].end == path.duration
    assert [p.end for p in pieces[:-1]] == [p.start for p in pieces[1:]]
    for piece in pieces:
        t = np.linspace(piece.start, piece.end, 7)[:-1]
        for order in range(4):  # at a knot from the right
            assert (piece.derivative(t, order) == path.derivative(t, order)).all()
    for order in range(4):
        assert (pieces[-1].derivative(path.duration, order) == path.derivative(path.duration, order)).all()


@pytest.mark.parametrize("path", PATHS, ids=repr)
def test_repr_can_be_pasted_back_and_equality_is_by_value(path: Path) -> None:
    again = eval(repr(path))
    assert again == path
    assert hash(again) == hash(path)
    assert pickle.loads(pickle.dumps(path)) == path
    strangers: list[object] = ["a path", None]
    assert path not in strangers
    assert path not in [other for other in PATHS if other is not path]


# -- what is refused -------------------------------------------------------------------------------


@pytest.mark.parametrize("path", PATHS, ids=repr)
def test_times_outside_are_refused(path: Path) -> None:
    end = path.duration
    asked: list[tuple[Any, str, float]] = [
        (end * 1.001, "", end * 1.001),
        ([0, -1e-9], "[1]", -1e-9),
        ([[0, 1], [2, end + 1]], "[1, 1]", end + 1),
    ]
    for t, place, value in asked:
        message = f"t{place} is {value} s, expected 0 <= t <= {end:.9g} s"
        with pytest.raises(InvalidArgument, match=f"^{re.escape(message)}$"):
            path(t)
        with pytest.raises(InvalidArgument, match=f"^{re.escape(message)}$"):
            path.derivative(t, 1)
    with pytest.raises(InvalidArgument, match=r"^order "):
        path.derivative(1.0, -1)


@pytest.mark.parametrize("path", PATHS, ids=repr)
def test_the_rounding_of_the_last_time_is_allowed(path: Path) -> None:
    assert (path(np.nextafter(path.duration, math.inf)) == path(path.duration)).all()
    assert (path(-1e-16) == path(0)).all()


STRAIGHT = Line((0, 0), (3, 0), 6)
test_impossible_paths_are_refused = refusals(
    (lambda: CubicVia((0, 0), (2, 2), (0, 4), 70, 60), "t_via is 70.0 s, expected 0 < t_via < 60 s"),
    (lambda: CubicVia((0, 0), (1, 2, 3), (0, 4), 30, 60), "via has shape (3,), expected (2,)"),
    (lambda: Spline([0, 1], [0, 1]), "waypoints has shape (2,), expected (k, n)"),
    (lambda: Spline([(0, 0), (1, 1)], [0, 1, 2]), "times has shape (3,), expected (2,), one per waypoint"),
    (lambda: Spline([(0, 0), (1, 1)], [1, 2]), "times[0] is 1.0 s, expected 0 <= times[0] <= 0 s"),
    (lambda: Spline([(0, 0), (1, 1), (2, 2)], [0, 2, 2]), "times[2] is 2.0 s after 2.0 s, expected more"),
    (lambda: RestToRest((1, 2), (1, 2, 3), 2), "end has shape (3,), expected (2,)"),
    (lambda: Hold((1, 2), 0), "duration is 0.0 s, expected > 0"),
    (lambda: CompositePath([STRAIGHT, Line((3, 0.5), (6, 0.5), 6)]), "paths[1] starts at (3, 0.5) m, 0.5 m"),
    (
        lambda: CompositePath([STRAIGHT, Line((3, 0), (3, 3), 6)]),
        "paths[1] starts with the velocity (0, 0.5)",
    ),
    (
        lambda: CompositePath([STRAIGHT, Hold((3, 0, 0), 1)]),
        "paths[1] has points of shape (3,), expected (2,)",
    ),
    (lambda: Circle(1, 1, 1, phase=1, heading=2), "heading is 2.0, expected None with phase = 1.0 rad"),
    (lambda: Polyline([(0, 0), (0, 0), (1, 0)], 1, 1), "waypoints[1] is equal to waypoints[0], expected"),
    (lambda: Polyline([(0, 0), (1, 0), (0, 0)], 1, 1), "waypoints[1] has a turn of 180 degrees, expected"),
    (lambda: Polyline([(0, 0), (4, 0), (4, 0.5)], 0.5, 9), "waypoints[1] and waypoints[2] are 0.5 m"),
    (lambda: Polyline([(0, 0), (4, 0)], 0.5, 5, 1), "duration is 5 s, expected at least 5.47723 s for 4 m"),
    by=begun,
)


# -- circles, lines and corners, moved and one after another ---------------------------------------

angle = st.floats(-7, 7)


def as_complex(points: Any) -> Any:
    return points[..., 0] + 1j * points[..., 1]


# -- circles ---------------------------------------------------------------------------------------


@derandomised
@given(st.floats(0.1, 10), st.floats(-3, 3), st.tuples(angle, angle), angle, st.integers(0, 5))
def test_circle(radius: float, rate: float, centre: tuple[float, float], phase: float, order: int) -> None:
    path, t = Circle(radius, rate, 20, centre, phase), np.linspace(0, 20, 30)
    expected = (1j * rate) ** order * radius * np.exp(1j * (rate * t + phase))
    if not order:
        expected += complex(*centre)
    # Of the angle, up to 67 rad, and of the sum.
    slack = 100 * EPS * max(radius * abs(rate) ** order, np.abs(expected).max())
    np.testing.assert_allclose(as_complex(path.derivative(t, order)), expected, rtol=0, atol=slack)


@pytest.mark.parametrize("rate", [0.5, -0.5, 0.0])
@pytest.mark.parametrize("centre", [None, (3.0, -1.0)])
def test_a_circle_starts_in_the_direction_of_its_heading(rate: float, centre: Any) -> None:
    for heading in (0.0, 1.0, np.pi / 2, -3.0):
        path = Circle(2, rate, 6, centre, heading=heading)
        velocity = as_complex(path.derivative(0, 1))
        assert velocity == pytest.approx(2 * abs(rate) * np.exp(1j * heading), abs=1e-15)
        if centre is None:
            assert (path(0) == 0).all()  # exactly: the centre lies where the origin is on the circle
        else:
            assert np.hypot(*(path(0) - centre)) == pytest.approx(2)
            side = 1 if rate >= 0 else -1  # the centre is on the left of who turns to the left
            assert (as_complex(path(0)) - complex(*centre)) / 2 == pytest.approx(
                -1j * side * np.exp(1j * heading)
            )


# -- lines and polylines ---------------------------------------------------------------------------


def test_a_line_is_straight_and_driven_at_one_speed() -> None:
    path = Line((1, 2, 3), (4, 2, -1), 2.5)
    t = np.array([0.0, 1.0, 2.5])
    np.testing.assert_allclose(path(t), [(1, 2, 3), (2.2, 2, 1.4), (4, 2, -1)], rtol=0, atol=1e-15)
    np.testing.assert_allclose(path.derivative(t, 1), [(1.2, 0, -1.6)] * 3, rtol=1e-15)
    assert not path.derivative(t, 2).any()


points = st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), min_size=3, max_size=6)


@derandomised
@given(points, st.floats(0.01, 0.1))
def test_a_polyline_is_continuous_up_to_its_jerk_and_keeps_its_speed(corners: Any, radius: float) -> None:
    try:
        path = Polyline(30 * np.array(corners), radius, 50)
    except InvalidArgument:
        with pytest.raises(InvalidArgument, match=r"apart, expected at|equal to waypoints|has a turn"):
            Polyline(30 * np.array(corners), radius, 50)
        return
    for before, after in pairwise(path.pieces):
        assert before.end == after.start
        for order in range(4):
            here, there = before.derivative(before.end, order), after.derivative(after.start, order)
            # A derivative is as large as the speed times the rates of the turns on both sides.
            sizes = [
                np.abs(each.derivative(np.linspace(each.start, each.end, 9), order)).max()
                for each in (before, after)
            ]
            np.testing.assert_allclose(here, there, rtol=0, atol=1e-12 * max(*sizes, 1))
    t = np.linspace(0, 50, 500)
    speeds = np.linalg.norm(path.derivative(t, 1), axis=-1)
    np.testing.assert_allclose(speeds, path.length / 50, rtol=1e-13)
    np.testing.assert_allclose(path(0), 30 * np.array(corners[0]), rtol=0, atol=0)
    np.testing.assert_allclose(path(50), 30 * np.array(corners[-1]), rtol=0, atol=1e-12)


@pytest.mark.parametrize(("theta", "side"), [(0.01, 1), (1.0, -1), (3.05, 1)])
def test_a_corner_is_no_tighter_than_its_radius(theta: float, side: int) -> None:
    radius, far = 0.4, 80.0
    way = [(0, 0), (far, 0), (far + far * np.cos(theta), side * far * np.sin(theta))]
    path = Polyline(way, radius, 160)
    _, turn, after = path.pieces
    # Where the last straight way begins the corner has come to: from the chord, which is another integral.
    np.testing.assert_allclose(
        turn.derivative(turn.end, 0), after.derivative(after.start, 0), rtol=0, atol=1e-13 * far
    )
    t = np.linspace(turn.start, turn.end, 1001)  # its middle is among them
    (vx, vy), (ax, ay) = path.derivative(t, 1).T, path.derivative(t, 2).T
    curvature = (vx * ay - vy * ax) / np.hypot(vx, vy) ** 3
    assert (side * curvature > -1e-12).all()
    assert np.abs(curvature).max() == pytest.approx(1 / radius, rel=1e-12)
    assert np.hypot(ax, ay).max() == pytest.approx(path.speed**2 / radius, rel=1e-12)


# -- moved -----------------------------------------------------------------------------------------


@derandomised
@given(st.floats(-5, 5), st.floats(-5, 5), angle, st.integers(0, 4))
def test_a_path_is_turned_and_then_shifted(x: float, y: float, turn: float, order: int) -> None:
    path = Spline([(0, 0), (1, 2), (3, -1)], (0, 1, 3), start_velocity=(1, 0))
    t = np.linspace(0, 3, 20)
    expected = np.exp(1j * turn) * as_complex(path.derivative(t, order))
    if not order:
        expected += x + 1j * y
    found = as_complex(path.moved(x, y, turn).derivative(t, order))
    np.testing.assert_allclose(found, expected, rtol=0, atol=8 * EPS * np.abs(expected).max(initial=1.0))
    for piece, other in zip(pieces_of(path.moved(x, y, turn)), path.pieces, strict=True):
        assert (piece.start, piece.end) == (other.start, other.end)


# -- one after another -----------------------------------------------------------------------------


def test_paths_follow_each_other() -> None:
    line, turn = Line((0, 1), (3, 1), 6), Circle(1, 0.5, 4, (3, 2), heading=0)
    path = CompositePath([line, turn])
    assert path.duration == 10
    for order in range(5):
        assert (path.derivative([0.0, 5.9], order) == line.derivative([0.0, 5.9], order)).all()
        assert (path.derivative([6.0, 8.0, 10.0], order) == turn.derivative([0.0, 2.0, 4.0], order)).all()
    assert [(piece.start, piece.end) for piece in path.pieces] == [(0, 6), (6, 10)]


def test_a_path_that_comes_to_rest_goes_on_in_another_direction() -> None:
    first = Polyline([(0, 0), (2, 0)], 1, 5, 0.8)
    path = CompositePath([first, Hold((2, 0), 1), first.moved(2, 0, np.pi / 2)])
    reference = Tangent(path, turn_time=2.0)
    assert reference.duration == 13  # it turns on the spot
    np.testing.assert_allclose(reference(13).q, (2, 2, np.pi / 2), rtol=0, atol=1e-13)
    np.testing.assert_allclose(reference(13).v, 0, atol=1e-13)


def test_rounding_is_no_jump() -> None:
    turn = Circle(1, 0.5, 3)
    end, direction = turn(3), turn.derivative(3, 1)
    assert CompositePath([turn, Line(end, end + 2 * direction, 2)]).duration == 5
    with pytest.raises(InvalidArgument, match=r"1e-08 m from"):
        CompositePath([turn, Line(end + np.array([1e-8, 0]), end + 2 * direction, 2)])


# -- in ensembles ----------------------------------------------------------------------------------


def test_a_spread_that_tears_a_path_apart_is_refused_for_the_robot_that_it_tears() -> None:
    path = CompositePath([Line((0, 1), (3, 1), 6), Circle(1, 0.5, 4, (3, 2), heading=0)])
    name = "trajectory.path.paths.0.end.x"
    with pytest.raises(InvalidArgument, match=r"^robot 0: paths\[1\] starts at \(3, 1\) m, "):
        ensemble(
            MobileRobot(30, 1.3), PD(120, 120), Tangent(path), n=2, spread={name: Uniform(3.1, 3.2)}, dt=0.1
        )
