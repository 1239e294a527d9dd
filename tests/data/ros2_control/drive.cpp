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
