"""The lecture's closed loops (its section 7), against an independent run of its script."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pinmobile import PD, Circle, ComputedTorque, CubicVia, MobileRobot, Rollout, Tangent, simulate
from pinmobile.cli.lecture import EXPECTED
from pinmobile.controllers import plain_difference
from pinmobile.trajectories import LectureHeading

DATA = Path(__file__).parent / "data"
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
    script = np.loadtxt(DATA / f"{file}.csv", delimiter=",")
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
