"""The ros2_control controller of the example has the inputs of `simulate`, and stops the robot.

Small stand-ins take the place of the headers of ros2_control: they have the members that the controller uses.
"""

import ctypes
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pinmobile import Circle, ComputedTorque, Engine, MobileRobot, Tangent, simulate
from pinmobile.arrays import Array
from pinmobile.export import export_c
from tests.c_code import rows

EXAMPLE = Path(__file__).parents[1] / "examples" / "ros2" / "ros2_control"
STAND_INS = Path(__file__).parent / "data" / "ros2_control"
DT = 0.01

pytestmark = pytest.mark.once


@pytest.fixture(scope="module")
def run() -> Any:
    """Return the samples of a simulation."""
    robot = MobileRobot(mass=30, yaw_inertia=1.3, com=(0.1, 0.05))
    circle = Tangent(Circle(radius=2, rate=0.5, duration=2))
    return simulate(robot, ComputedTorque(robot, 4, 4), circle, dt=DT, engine=Engine.COMPILED)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return the function that runs the controller for all samples."""
    if not shutil.which("g++"):
        pytest.skip("g++ is not installed")
    folder = tmp_path_factory.mktemp("ros2_control")
    robot = MobileRobot(mass=30, yaw_inertia=1.3, com=(0.1, 0.05))
    circle = Tangent(Circle(radius=2, rate=0.5, duration=2))
    export_c(ComputedTorque(robot, 4, 4), robot, folder, dt=DT, trajectory=circle)
    shutil.copytree(STAND_INS, folder, dirs_exist_ok=True)
    flags = ["-O1", "-fPIC", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror", f"-I{folder}"]
    flags += [f"-I{EXAMPLE / 'include'}"]
    sources = "drive.cpp", str(EXAMPLE / "src" / "robot_controller.cpp"), "robot.o"
    for command in (
        ["gcc", "-std=c99", *flags, "-c", "robot.c"],
        ["g++", "-std=c++17", *flags, "-Wl,-Bsymbolic", "-shared", *sources, "-o", "drive.so"],
    ):
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
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
