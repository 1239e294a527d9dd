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
DT = 0.01

pytestmark = pytest.mark.once

INTERFACE = """
#pragma once
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>
namespace rclcpp {
struct Duration {
    std::int64_t ns;
    double seconds() const { return static_cast<double>(ns) / 1e9; }
};
struct Time { std::int64_t ns = 0; };
inline Duration operator-(const Time & a, const Time & b) { return {a.ns - b.ns}; }
}
namespace rclcpp_lifecycle {
struct State {};
using Names = std::vector<std::string>;
struct Parameter {
    Names value;
    Names as_string_array() const { return value; }
};
struct LifecycleNode {
    std::map<std::string, Names> parameters;
    Parameter get_parameter(const std::string & name) const { return {parameters.at(name)}; }
    int get_logger() const { return 0; }
};
}
namespace hardware_interface {
struct LoanedStateInterface {
    std::optional<double> value;
    std::optional<double> get_optional() const { return value; }
};
struct LoanedCommandInterface {
    double value;
    [[nodiscard]] bool set_value(double x) { value = x; return true; }
};
}
namespace controller_interface {
enum class return_type : std::uint8_t { OK = 0, ERROR = 1 };
enum class CallbackReturn : std::uint8_t { SUCCESS = 97, FAILURE = 98, ERROR = 99 };
enum class interface_configuration_type : std::uint8_t { ALL = 0, INDIVIDUAL = 1, NONE = 2 };
struct InterfaceConfiguration {
    interface_configuration_type type;
    std::vector<std::string> names;
};
class ControllerInterface {
public:
    virtual ~ControllerInterface() = default;
    virtual CallbackReturn on_init() = 0;
    virtual CallbackReturn on_configure(const rclcpp_lifecycle::State &) = 0;
    virtual CallbackReturn on_activate(const rclcpp_lifecycle::State &) = 0;
    virtual CallbackReturn on_deactivate(const rclcpp_lifecycle::State &) = 0;
    virtual InterfaceConfiguration state_interface_configuration() const = 0;
    virtual InterfaceConfiguration command_interface_configuration() const = 0;
    virtual return_type update(const rclcpp::Time &, const rclcpp::Duration &) = 0;
    std::shared_ptr<rclcpp_lifecycle::LifecycleNode> get_node() { return node; }
    unsigned int get_update_rate() const { return rate; }
    template <typename T> void auto_declare(const std::string & name, const T & x)
    {
        node->parameters.emplace(name, x);
    }
    std::shared_ptr<rclcpp_lifecycle::LifecycleNode> node =
        std::make_shared<rclcpp_lifecycle::LifecycleNode>();
    unsigned int rate = 100;
    std::vector<hardware_interface::LoanedStateInterface> state_interfaces_;
    std::vector<hardware_interface::LoanedCommandInterface> command_interfaces_;
};
}
"""
LOGGING = """
#pragma once
#include <cstdio>
#define RCLCPP_ERROR(logger, ...) ((void)(logger), (void)std::printf(__VA_ARGS__))
"""
PLUGIN = """
#pragma once
#define PLUGINLIB_EXPORT_CLASS(type, base) static_assert(sizeof(type) >= sizeof(base));
"""
DRIVER = """
#include "robot_controller/robot_controller.hpp"
#include <cstdlib>
#include <new>
static long allocations = 0;
void * operator new(std::size_t n) { ++allocations; return std::malloc(n); }
void operator delete(void * p) noexcept { std::free(p); }
void operator delete(void * p, std::size_t) noexcept { std::free(p); }

using controller_interface::CallbackReturn;

// For each sample, u and status; returns the number of allocations, or a negative number.
extern "C" int drive(
    long n, const double * t, const double * q, const double * v, double rate, double * u, double * status)
{
    robot_controller::RobotController controller;
    controller.rate = static_cast<unsigned int>(rate);
    if (controller.on_init() != CallbackReturn::SUCCESS) return -1;
    controller.node->parameters["configuration"] = {"x", "y", "psi"};
    controller.node->parameters["velocity"] = {"vx", "vy", "yaw_rate"};
    controller.node->parameters["input"] = {"fx", "fy", "mz"};
    if (controller.on_configure({}) != CallbackReturn::SUCCESS) return -2;
    controller.state_interfaces_.resize(controller.state_interface_configuration().names.size());
    controller.command_interfaces_.resize(controller.command_interface_configuration().names.size());
    if (controller.on_activate({}) != CallbackReturn::SUCCESS) return -3;
    const long before = allocations;
    if (before == 0) return -4;
    rclcpp::Time last;
    for (long k = 0; k < n; ++k) {
        for (int i = 0; i < 3; ++i) {
            controller.state_interfaces_[i].value = q[3 * k + i];
            controller.state_interfaces_[3 + i].value = v[3 * k + i];
        }
        if (std::isinf(q[3 * k])) controller.state_interfaces_[0].value.reset();
        const rclcpp::Time now{1700000000123456789 + std::llround(1e9 * t[k])};
        status[k] = static_cast<double>(controller.update(now, now - last));
        last = now;
        for (int i = 0; i < 3; ++i) u[3 * k + i] = controller.command_interfaces_[i].value;
    }
    const long counted = allocations - before;
    for (auto & one : controller.command_interfaces_) one.value = 1.0;
    controller.on_deactivate({});
    for (auto & one : controller.command_interfaces_) if (one.value != 0.0) return -5;
    return static_cast<int>(counted);
}
"""


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
    texts = {
        "controller_interface/controller_interface.hpp": INTERFACE,
        "rclcpp/logging.hpp": LOGGING,
        "pluginlib/class_list_macros.hpp": PLUGIN,
        "drive.cpp": DRIVER,
    }
    for name, text in texts.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
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
