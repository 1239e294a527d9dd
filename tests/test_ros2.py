"""The ROS 2 node and the ros2_control controller of the examples: inputs of a stepper, and stops.

The test needs a Python with rclpy and the dependencies of pinmobile. It installs nothing: the environment
variable PINMOBILE_ROS_PYTHON is its interpreter, as `.ci/run` makes one.
"""

import ctypes
import json
import os
import random
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pinmobile import Circle, ComputedTorque, Engine, MobileRobot, Tangent, simulate
from pinmobile.arrays import Array
from pinmobile.export import export_c
from tests.c_code import rows, succeed
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


# -- the ros2_control controller of the example has the inputs of `simulate`, and stops the robot --


EXAMPLE = Path(__file__).parents[1] / "examples" / "ros2" / "ros2_control"
DT = 0.01
ROBOT = MobileRobot(mass=30, yaw_inertia=1.3, com=(0.1, 0.05))
LAW, CIRCLE = ComputedTorque(ROBOT, 4, 4), Tangent(Circle(radius=2, rate=0.5, duration=2))


@pytest.fixture(scope="module")
def run() -> Any:
    """Return the samples of a simulation."""
    return simulate(ROBOT, LAW, CIRCLE, dt=DT, engine=Engine.COMPILED)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return the function that runs the controller for all samples."""
    if not shutil.which("g++"):
        pytest.skip("g++ is not installed")
    folder = tmp_path_factory.mktemp("ros2_control")
    export_c(LAW, ROBOT, folder, dt=DT, trajectory=CIRCLE)
    shutil.copytree(Path(__file__).parent / "data" / "ros2_control", folder, dirs_exist_ok=True)
    flags = ["-O1", "-fPIC", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror", f"-I{folder}"]
    flags += [f"-I{EXAMPLE / 'include'}"]
    sources = "drive.cpp", str(EXAMPLE / "src" / "robot_controller.cpp"), "robot.o"
    linked = ["g++", "-std=c++17", *flags, "-Wl,-Bsymbolic", "-shared", *sources, "-o", "drive.so"]
    succeed(folder, ["gcc", "-std=c99", *flags, "-c", "robot.c"], linked)
    return ctypes.CDLL(str(folder / "drive.so")).drive


def driven(drive: Any, t: Array, q: Array, v: Array, rate: float = 100) -> tuple[int, Array, Array]:
    """Return the number of allocations, the inputs and whether each sample is an error."""
    u, status = np.full((len(t), 3), 7.0), np.full(len(t), 7.0)
    pointers = [ctypes.c_void_p(x.ctypes.data) for x in rows(t, q, v)]
    given = (ctypes.c_double(rate), ctypes.c_void_p(u.ctypes.data), ctypes.c_void_p(status.ctypes.data))
    return int(drive(ctypes.c_long(len(t)), *pointers, *given)), u, status != 0


def test_the_controller_has_the_inputs_of_a_simulation_without_allocation(drive: Any, run: Any) -> None:
    allocations, u, is_error = driven(drive, run.t, run.q, run.v)
    assert allocations == 0
    assert not is_error.any()
    np.testing.assert_array_equal(u, run.u)


@pytest.mark.parametrize("end", ["nan", "missing", "same time", "gap"])
def test_the_controller_stops_the_robot_and_stays_stopped(drive: Any, run: Any, end: str) -> None:
    t, q = run.t.copy(), run.q.copy()
    if end == "nan":
        q[100, 1] = np.nan
    elif end == "missing":
        q[100, 0] = np.inf
    else:
        t[100:] += {"same time": -DT, "gap": 5 * DT}[end]
    allocations, u, is_error = driven(drive, t, q, run.v)
    assert allocations == 0
    np.testing.assert_array_equal(u[:100], run.u[:100])
    np.testing.assert_array_equal(is_error, np.arange(len(t)) >= 100)
    assert not u[100:].any()


def test_the_controller_refuses_another_rate(drive: Any, run: Any) -> None:
    assert driven(drive, run.t, run.q, run.v, rate=50)[0] == -2
