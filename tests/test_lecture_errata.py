"""The rows of the errata table on motion and control: what is right, and that the lecture's version is not.

The rows on equations stand in test_closed_form.py and test_derivation.py, the one on the animation in
test_plots.py.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinmobile as pm
from pinmobile import PD, Circle, ComputedTorque, CubicVia, MobileRobot, Rollout, Tangent, simulate
from pinmobile.cli.lecture import EXPECTED
from pinmobile.controllers import plain_difference
from pinmobile.trajectories import LectureHeading

VIA_STOP = pm.CubicVia((0, 0), (2, 2), (0, 4), 30, 60, via_velocity=(0, 0))
VIA_FREE = pm.CubicVia((0, 0), (2, 2), (0, 4), 30, 60)
LECTURE_GAINS = (120, 120, 0.4)


def test_derivatives_of_the_second_cubic_have_their_factors() -> None:
    """Slide, equation (3): b1 + b2 s + b3 s^2 as the velocity, b2 + 2 b3 s as the acceleration."""
    t, h = 47.0, 1e-3
    b = [VIA_FREE.derivative(30.0, k) / factorial for k, factorial in enumerate((1, 1, 2, 6))]
    s = t - 30
    slide = b[1] + b[2] * s + b[3] * s**2, b[2] + 2 * b[3] * s
    centred = (VIA_FREE(t + h) - VIA_FREE(t - h)) / (2 * h)
    centred_2 = (VIA_FREE(t + h) - 2 * VIA_FREE(t) + VIA_FREE(t - h)) / h**2
    # Cubic: the central difference is off by h^2 b3, and by rounding.
    np.testing.assert_allclose(VIA_FREE.derivative(t, 1), centred, atol=1e-9)
    np.testing.assert_allclose(VIA_FREE.derivative(t, 2), centred_2, atol=1e-8)
    assert np.abs(slide[0] - centred).max() > 1e-2
    assert np.abs(slide[1] - centred_2).max() > 1e-3


def test_heading_rate_on_a_vertical_tangent() -> None:
    """Lecture: divides by x_dot. Straight up, x_dot is 0 all the way; on a circle, at the quarter turns."""
    upwards = pm.CubicVia((0, 0), (0, 1), (1, 2), 5, 10, via_velocity=(0.0, 0.2), start_velocity=(0.0, 0.2))
    t = np.array([0.0, 1.0, 4.9])
    assert pm.Tangent(upwards)(t).q[:, 2].tolist() == [np.pi / 2] * 3
    assert pm.Tangent(upwards)(t).v[:, 2].tolist() == [0] * 3
    # Where x_dot passes through an exact zero and the path bends, the lecture's formula has no number.
    parabola = pm.CubicVia(
        (0.25, 0), (0, 0.5), (0.25, 1), 0.5, 1, (0, 1), start_velocity=(-1, 1), end_velocity=(1, 1)
    )
    assert parabola.derivative(0.5, 1).tolist() == [0, 1]
    expected = -parabola.derivative(0.5, 2)[0]
    assert abs(expected) > 0.1
    assert pm.Tangent(parabola)(0.5).v[2] == pytest.approx(expected, rel=1e-14)
    with np.errstate(divide="ignore", invalid="ignore"):
        (xd, yd), (xdd, ydd) = parabola.derivative(0.5, 1), parabola.derivative(0.5, 2)
        assert np.isnan((ydd / xd - yd * xdd / xd**2) / (yd**2 / xd**2 + 1))
    # Its script has 0 there, or the limit, as its solver rounds; here it is the limit.
    assert LectureHeading(parabola)(0.5).v[2] == pytest.approx(expected, rel=1e-14)


def test_heading_at_rest_is_the_limit_of_the_tangent() -> None:
    """Lecture: atan2(0, 0) = 0, a jump of the reference after the first sample."""
    first, next_to_last, last = 0.1, 59.9, 60.0
    right, lecture = pm.Tangent(VIA_FREE), LectureHeading(VIA_FREE)
    start = VIA_FREE.derivative(0.0, 2)
    assert right(0.0).q[2] == pytest.approx(np.arctan2(start[1], start[0]), abs=1e-15)
    assert abs(right(first).q[2] - right(0.0).q[2]) < 0.01
    assert abs(lecture(first).q[2] - lecture(0.0).q[2]) > 0.4
    assert abs(right(last).q[2] - right(next_to_last).q[2]) < 0.01
    assert abs(lecture(last).q[2] - lecture(next_to_last).q[2]) > 0.4


def test_a_cusp_is_a_turn_on_the_spot() -> None:
    """Lecture: the reference jumps by 90 degrees between two samples."""
    trajectory = pm.Tangent(VIA_STOP, turn_time=2.0)
    t = np.linspace(0, trajectory.duration, 6201)
    q, v, _ = trajectory(t)
    assert trajectory.duration == 62
    assert np.abs(np.diff(q[:, 2])).max() < 0.02
    turning = (t > 30) & (t < 32)
    np.testing.assert_array_equal(q[turning, :2], np.broadcast_to([2, 2], (turning.sum(), 2)))
    assert (v[turning, 2] > 0).all()  # to the left
    lecture = LectureHeading(VIA_STOP)(np.array([29.9, 30.1])).q[:, 2]
    assert lecture[1] - lecture[0] == pytest.approx(np.pi / 2)


def test_heading_acceleration_is_the_derivative_of_the_rate() -> None:
    """Lecture: psi_ddot_d = 0."""
    t, h = np.linspace(1, 59, 60), 1e-4  # not the via point, where psi_ddot jumps
    for make, is_right in ((pm.Tangent, True), (LectureHeading, False)):
        trajectory = make(VIA_FREE)
        centred = (trajectory(t + h).v[:, 2] - trajectory(t - h).v[:, 2]) / (2 * h)
        # h^2 of a third derivative below 1, and eps / h of rounding.
        assert (np.abs(trajectory(t).a[:, 2] - centred).max() < 1e-7) == is_right


def test_error_has_no_spike_where_the_heading_crosses_zero() -> None:
    """Lecture: wrapTo2Pi of the reference alone; seen with wx = 0.2."""
    path, robot = pm.Lissajous(3, 3, 0.2, 0.1, 60), pm.MobileRobot.lecture()
    lecture = LectureHeading(path)
    heading = lecture(np.arange(601) * 0.1).q[:, 2]
    assert np.abs(np.diff(heading)).max() > 6
    plain = pm.simulate(robot, pm.ComputedTorque(robot, difference=plain_difference), lecture, dt=0.1)
    assert np.abs(plain.u[:, 2]).max() > 2  # Icz Kp 2 pi: the loop unwinds a whole turn
    right = pm.simulate(robot, pm.ComputedTorque(robot), pm.Tangent(path), dt=0.1)
    assert np.abs(np.diff(right.reference.q[:, 2])).max() < 0.2
    assert np.abs(right.u[:, 2]).max() < 0.1
    assert right.max_error()[2] < 0.01
    # Even a wrapped reference does no harm where the error is taken on the circle.
    circle = pm.simulate(robot, pm.ComputedTorque(robot), lecture, dt=0.1)
    assert np.abs(circle.u[:, 2]).max() < 0.1


def test_pd_gains_that_are_four_times_m_diverge_with_an_offset_centre_of_mass() -> None:
    """Lecture: numbers past the largest float are results like any other."""
    offset = pm.MobileRobot(30, 0.1, com=(0.1, 0.05))
    gains = 4 * np.diag(pm.MobileRobot.lecture().mass_matrix([0, 0, 0]))
    assert gains.tolist() == pytest.approx(LECTURE_GAINS)
    with pytest.raises(pm.Diverged) as caught:
        pm.simulate(offset, pm.PD(LECTURE_GAINS, LECTURE_GAINS), pm.Tangent(pm.Circle(3, 0.1, 60)), dt=0.1)
    assert 0 < caught.value.time < 60
    assert np.isfinite(caught.value.rollout.q).all()


def test_the_lectures_inertia_is_a_preset_with_a_physical_one_beside_it() -> None:
    """diag(0, 0, Icz) is no body's inertia, and Icz = 0.1 is not that of a 30 kg box of this size."""
    lecture, box = pm.MobileRobot.lecture(), pm.MobileRobot.box()
    assert (lecture.mass, lecture.yaw_inertia, lecture.com) == (30, 0.1, (0, 0, 0))
    assert box.yaw_inertia == pytest.approx(1.3)
    assert box.size == lecture.size == (0.6, 0.4, 0.2)
    model = pin.buildModelFromXML(lecture.to_urdf())
    xx, yy, zz = np.diag(model.inertias[3].inertia)
    assert zz == 0.1
    assert xx == yy >= zz / 2


# -- the lecture's closed loops (its section 7), against an independent run of its script ----------


ROBOT = MobileRobot.lecture()
PATHS: dict[str, Any] = {
    "via stop": CubicVia((0, 0), (2, 2), (0, 4), 30, 60, via_velocity=(0, 0)),
    "via free": CubicVia((0, 0), (2, 2), (0, 4), 30, 60),
    "circle": Circle(3, 0.1, 60),
}
CONTROLLERS: dict[str, Any] = {
    "PD": PD((120, 120, 0.4), (120, 120, 0.4), difference=plain_difference),
    "computed torque": ComputedTorque(ROBOT, 4, 4, difference=plain_difference),
}


def lecture_run(path: str, controller: str) -> Rollout:
    return simulate(ROBOT, CONTROLLERS[controller], LectureHeading(PATHS[path]), dt=0.1)


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("controller", CONTROLLERS)
def test_largest_errors_are_the_lectures_to_every_printed_digit(path: str, controller: str) -> None:
    x, y, _ = lecture_run(path, controller).max_error()
    assert (f"{x:.6e}", f"{y:.6e}") == EXPECTED[path, controller]


@pytest.mark.parametrize(
    ("file", "path", "controller"),
    [("circle_pd", "circle", "PD"), ("via_free_ctc", "via free", "computed torque")],
)
def test_every_sample_is_the_scripts(file: str, path: str, controller: str) -> None:
    script = np.loadtxt(Path(__file__).parent / "data" / f"{file}.csv", delimiter=",")
    rollout = lecture_run(path, controller)
    np.testing.assert_allclose(rollout.t, script[:, 0], rtol=1e-15)
    np.testing.assert_allclose(rollout.q, script[:, 1:4], rtol=0, atol=1e-9)
    # Where the path ends at rest, the direction of the script's last speed, 1e-17, is noise: its heading
    # there, and the moment that follows from it, are not the lecture's.
    moving = slice(None, -1 if path == "via free" else None)
    errors = rollout.reference.q - rollout.q
    np.testing.assert_allclose(errors[:, :2], script[:, 4:6], rtol=0, atol=1e-9)
    np.testing.assert_allclose(errors[moving, 2], script[moving, 6], rtol=0, atol=1e-9)
    scale = np.abs(script[:, 7:]).max()
    np.testing.assert_allclose(rollout.u[:, :2], script[:, 7:9], rtol=1e-7, atol=1e-7 * scale)
    np.testing.assert_allclose(rollout.u[moving, 2], script[moving, 9], rtol=1e-7, atol=1e-7 * scale)


def test_heading_put_right_leaves_the_error_of_position_and_removes_that_of_heading() -> None:
    for name, controller in CONTROLLERS.items():
        lecture = lecture_run("via free", name)
        right = simulate(ROBOT, controller, Tangent(PATHS["via free"]), dt=0.1)
        np.testing.assert_allclose(right.max_error()[:2], lecture.max_error()[:2], rtol=1e-9)
        assert lecture.max_error()[2] > 0.4
        assert right.max_error()[2] < 0.02
