// ros2_control controller around the code that `export_c` writes with name="robot".
#ifndef ROBOT_CONTROLLER__ROBOT_CONTROLLER_HPP_
#define ROBOT_CONTROLLER__ROBOT_CONTROLLER_HPP_

#include <array>
#include <string>
#include <vector>

#include "controller_interface/controller_interface.hpp"
#include "robot.h"

namespace robot_controller
{

// Parameters: names of all interfaces, in the order of the entries that robot.h states.
//   configuration: state interfaces of q, such as "left_wheel/position"
//   velocity: state interfaces of v
//   input: command interfaces of u, such as "left_wheel/effort"
class RobotController : public controller_interface::ControllerInterface
{
public:
  controller_interface::CallbackReturn on_init() override;
  controller_interface::CallbackReturn on_configure(const rclcpp_lifecycle::State & state) override;
  controller_interface::CallbackReturn on_activate(const rclcpp_lifecycle::State & state) override;
  controller_interface::CallbackReturn on_deactivate(const rclcpp_lifecycle::State & state) override;
  controller_interface::InterfaceConfiguration state_interface_configuration() const override;
  controller_interface::InterfaceConfiguration command_interface_configuration() const override;
  controller_interface::return_type update(
    const rclcpp::Time & time, const rclcpp::Duration & period) override;

private:
  bool measure();
  bool command();
  controller_interface::return_type stop(const char * reason);

  std::vector<std::string> state_names_, input_names_;
  std::array<robot_real, ROBOT_NQ> q_{};
  std::array<robot_real, ROBOT_NV> v_{};
  std::array<robot_real, ROBOT_NU> u_{};
  robot_memory memory_{};
  robot_reference reference_{};
  rclcpp::Time begin_;
  bool has_begun_ = false;
  const char * stop_reason_ = nullptr;  // it stays stopped until the next activation
};

}  // namespace robot_controller

#endif  // ROBOT_CONTROLLER__ROBOT_CONTROLLER_HPP_
