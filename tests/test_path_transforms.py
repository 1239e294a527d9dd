"""Paths that are put anywhere: circles by centre, rounded polylines, moved, one after another."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from pinmobile import PD, MobileRobot, Tangent, Uniform, ensemble
from pinmobile.errors import InvalidArgument
from pinmobile.paths import Circle, CompositePath, Hold, Line, Polyline, Spline, pieces_of
from tests.refusals import begun, refusals

derandomised = settings(derandomize=True, deadline=None, max_examples=40)
angle = st.floats(-7, 7)
EPS = float(np.finfo(float).eps)


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


LINE = Line((0, 0), (3, 0), 6)

test_paths_that_do_not_meet_are_refused = refusals(
    (lambda: CompositePath([LINE, Line((3, 0.5), (6, 0.5), 6)]), "paths[1] starts at (3, 0.5) m, 0.5 m"),
    (lambda: CompositePath([LINE, Line((3, 0), (3, 3), 6)]), "paths[1] starts with the velocity (0, 0.5)"),
    (lambda: CompositePath([LINE, Hold((3, 0, 0), 1)]), "paths[1] has points of shape (3,), expected (2,)"),
    by=begun,
)


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


# -- what is refused -------------------------------------------------------------------------------


test_paths_refuse = refusals(
    (lambda: Circle(1, 1, 1, phase=1, heading=2), "heading is 2.0 rad beside phase = 1.0 rad, expected"),
    (lambda: Polyline([(0, 0), (0, 0), (1, 0)], 1, 1), "waypoints[1] is equal to waypoints[0], expected"),
    (lambda: Polyline([(0, 0), (1, 0), (0, 0)], 1, 1), "waypoints[1] has a turn of 180 degrees, expected"),
    (lambda: Polyline([(0, 0), (4, 0), (4, 0.5)], 0.5, 9), "waypoints[1] and waypoints[2] are 0.5 m"),
    (lambda: Polyline([(0, 0), (4, 0)], 0.5, 5, 1), "duration is 5 s, expected at least 5.47723 s for 4 m"),
    by=begun,
)
