#include "robot_controller/robot_controller.hpp"

#include <cmath>
#include <cstddef>

#include "pluginlib/class_list_macros.hpp"
#include "rclcpp/logging.hpp"

namespace robot_controller
{

using controller_interface::CallbackReturn;
using controller_interface::InterfaceConfiguration;
using controller_interface::interface_configuration_type;
using controller_interface::return_type;

CallbackReturn RobotController::on_init()
{
  for (const auto * name : {"configuration", "velocity", "input"}) {
    auto_declare<std::vector<std::string>>(name, {});
  }
  return CallbackReturn::SUCCESS;
}

CallbackReturn RobotController::on_configure(const rclcpp_lifecycle::State &)
{
  const auto node = get_node();
  const auto q = node->get_parameter("configuration").as_string_array();
  const auto v = node->get_parameter("velocity").as_string_array();
  input_names_ = node->get_parameter("input").as_string_array();
  if (q.size() != ROBOT_NQ || v.size() != ROBOT_NV || input_names_.size() != ROBOT_NU) {
    RCLCPP_ERROR(
      node->get_logger(), "configuration, velocity and input need %d, %d and %d interfaces", ROBOT_NQ,
      ROBOT_NV, ROBOT_NU);
    return CallbackReturn::ERROR;
  }
  if (std::abs(get_update_rate() * static_cast<double>(ROBOT_DT) - 1.0) > 1e-3) {
    RCLCPP_ERROR(
      node->get_logger(), "update_rate is %u Hz, expected %g Hz", get_update_rate(),
      1.0 / static_cast<double>(ROBOT_DT));
    return CallbackReturn::ERROR;
  }
  state_names_ = q;
  state_names_.insert(state_names_.end(), v.begin(), v.end());
  return CallbackReturn::SUCCESS;
}

InterfaceConfiguration RobotController::state_interface_configuration() const
{
  return {interface_configuration_type::INDIVIDUAL, state_names_};
}

InterfaceConfiguration RobotController::command_interface_configuration() const
{
  return {interface_configuration_type::INDIVIDUAL, input_names_};
}

CallbackReturn RobotController::on_activate(const rclcpp_lifecycle::State &)
{
  robot_init(&memory_);
  has_begun_ = false;
  stop_reason_ = nullptr;
  return CallbackReturn::SUCCESS;
}

CallbackReturn RobotController::on_deactivate(const rclcpp_lifecycle::State &)
{
  if (stop_reason_ != nullptr) {
    RCLCPP_ERROR(get_node()->get_logger(), "the robot was stopped: %s", stop_reason_);
  }
  stop(stop_reason_);
  return CallbackReturn::SUCCESS;
}

// Compute one sample, without allocation and log. Time begins with the first sample.
return_type RobotController::update(const rclcpp::Time & time, const rclcpp::Duration & period)
{
  if (stop_reason_ != nullptr) {
    return stop(stop_reason_);
  }
  if (!has_begun_) {
    begin_ = time;
  } else if (period.seconds() > 2.0 * static_cast<double>(ROBOT_DT)) {
    return stop("a sample was left out");
  }
  has_begun_ = true;
  if (!measure()) {
    return stop("a state interface has no value");
  }
  const auto t = static_cast<robot_real>((time - begin_).seconds());
  robot_reference_at(t, &reference_);
  switch (robot_step(t, q_.data(), v_.data(), &reference_, &memory_, u_.data())) {
    case ROBOT_OK:
      return command() ? return_type::OK : stop("a command interface was not set");
    case ROBOT_STALE:
      return stop("time did not advance");
    default:
      return stop("a measurement or an input is NaN or infinite");
  }
}

bool RobotController::measure()
{
  for (std::size_t i = 0; i < state_interfaces_.size(); ++i) {
    const auto value = state_interfaces_[i].get_optional();
    if (!value.has_value()) {
      return false;
    }
    (i < ROBOT_NQ ? q_[i] : v_[i - ROBOT_NQ]) = static_cast<robot_real>(*value);
  }
  return true;
}

bool RobotController::command()
{
  bool is_set = true;
  for (std::size_t i = 0; i < command_interfaces_.size(); ++i) {
    is_set = command_interfaces_[i].set_value(static_cast<double>(u_[i])) && is_set;
  }
  return is_set;
}

return_type RobotController::stop(const char * reason)
{
  stop_reason_ = reason;
  u_.fill(0);
  command();
  return return_type::ERROR;
}

}  // namespace robot_controller

PLUGINLIB_EXPORT_CLASS(robot_controller::RobotController, controller_interface::ControllerInterface)
