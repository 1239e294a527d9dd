"""ROS 2 node around a `Stepper`, which stops the robot if no measurement arrives."""

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from pinmobile import Circle, ComputedTorque, MobileRobot, Tangent
from pinmobile.realtime import Stepper


class ControllerNode(Node):
    """Node that answers each measurement with the inputs of the plant."""

    def __init__(self, stepper):
        super().__init__("controller")
        self.stepper, self.begin, self.is_stopped = stepper, None, False
        self.names = [coordinate.name for coordinate in stepper.plant.coordinates]
        self.publisher = self.create_publisher(Float64MultiArray, "commands", 1)
        self.create_subscription(JointState, "joint_states", self.control, 1)
        stale = self.declare_parameter("stale", 0.1).value  # s
        self.watchdog = self.create_timer(
            stale, self.stop, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        self.watchdog.cancel()  # the first measurement starts it

    def control(self, measured):
        """Answer a measurement. Time begins with the first one."""
        if self.is_stopped:
            self.stop()
            return
        self.watchdog.reset()
        try:
            stamp = Time.from_msg(measured.header.stamp).nanoseconds
            self.begin = stamp if self.begin is None else self.begin
            order = [measured.name.index(name) for name in self.names]
            q, v = (
                [values[k] for k in order]
                for values in (measured.position, measured.velocity)
            )
            u = self.stepper.step(1e-9 * (stamp - self.begin), q, v)
            self.publisher.publish(Float64MultiArray(data=u.tolist()))
        except Exception as error:  # any error stops the robot
            self.stop(str(error))

    def stop(self, reason="stale measurement"):
        """Publish zero inputs, and again at each period of the watchdog."""
        if not self.is_stopped:
            self.get_logger().error(f"the robot is stopped: {reason}")
            self.is_stopped = True
            self.watchdog.reset()
        self.publisher.publish(Float64MultiArray(data=[0.0] * self.stepper.plant.nu))


def make_stepper():
    """Return the controller. Replace it by yours."""
    robot = MobileRobot(mass=30, yaw_inertia=1.3, com=(0.1, 0.05))
    circle = Tangent(Circle(radius=2, rate=0.5, duration=12))
    return Stepper(ComputedTorque(robot, kp=4, kd=4), robot, dt=0.01, trajectory=circle)


def main():
    """Run the node until Ctrl-C, which stops the robot."""
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = ControllerNode(make_stepper())
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        while True:
            executor.spin_once(timeout_sec=0.1)
    except KeyboardInterrupt:
        node.stop("interrupt")


if __name__ == "__main__":
    main()
