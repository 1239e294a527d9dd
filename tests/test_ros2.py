"""The ROS 2 node of the example controls a simulated robot in another process, and stops it.

The test needs a Python with rclpy and the dependencies of pinmobile. It installs nothing: the environment
variable PINMOBILE_ROS_PYTHON is its interpreter, as `.ci/run` makes one.
"""

import json
import os
import random
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.ros_robot import PATIENCE

ROOT = Path(__file__).parents[1]
NODE = ROOT / "examples" / "ros2" / "controller_node.py"
SAMPLES = 150
VARIABLE = "PINMOBILE_ROS_PYTHON"

pytestmark = pytest.mark.once


@pytest.fixture(scope="module")
def python() -> str:
    """Return an interpreter that has rclpy."""
    named = os.environ.get(VARIABLE)
    command = [named or sys.executable, "-c", "import rclpy, sensor_msgs, std_msgs, pinocchio"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=PATIENCE)
    if named:
        assert done.returncode == 0, f"{VARIABLE}={named}: {done.stderr}"
    elif done.returncode:
        pytest.skip(f"rclpy is not installed here, and {VARIABLE} names no Python that has it")
    return command[0]


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """Return the environment of processes whose messages stay on this machine."""
    return {
        **os.environ,
        "PYTHONPATH": str(ROOT / "src"),
        "PYTHONDONTWRITEBYTECODE": "1",
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
        "ROS_LOCALHOST_ONLY": "1",
        "ROS_DOMAIN_ID": str(random.SystemRandom().randrange(1, 100)),
        "ROS_LOG_DIR": str(tmp_path),
        "ROS_HOME": str(tmp_path),
    }


@contextmanager
def started(command: list[str], environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    process = subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize("end", ["stale", "nan", "late", "interrupt"])
def test_the_node_has_a_steppers_inputs_and_stops(end: str, python: str, environment: dict[str, str]) -> None:
    stale = 5.0 if end == "stale" else 2 * PATIENCE
    node = [python, str(NODE), "--ros-args", "-p", f"stale:={stale}"]
    robot = [python, str(ROOT / "tests" / "ros_robot.py"), str(NODE), str(SAMPLES), end]
    with started(node, environment) as controller, started(robot, environment) as plant:
        assert plant.stdout is not None
        line = plant.stdout.readline()
        if end == "interrupt":
            controller.send_signal(signal.SIGINT)
        out = plant.stdout.read()  # `communicate` would leave out what `readline` has buffered
        _, err = plant.communicate(timeout=PATIENCE)
        assert line == "done\n", err
        assert plant.returncode == 0, err
        if end != "interrupt":
            controller.send_signal(signal.SIGINT)
        _, log = controller.communicate(timeout=PATIENCE)
        assert controller.returncode == 0, log
    found: dict[str, Any] = json.loads(out)
    assert len(found["received"]) == SAMPLES
    assert found["received"] == found["expected"]
    assert found["error"] < 0.1
    assert found["stopped"] == [[0.0, 0.0, 0.0]] * (1 if end == "interrupt" else 2)
    reason = {"stale": "stale measurement", "nan": "q", "late": "t is", "interrupt": "interrupt"}[end]
    assert f"the robot is stopped: {reason}" in log
