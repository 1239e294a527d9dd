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
