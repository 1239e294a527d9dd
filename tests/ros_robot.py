"""Simulated robot in a process with rclpy, which exchanges messages with the node of the example."""

import json
import runpy
import sys
import time
from collections import deque
from functools import partial
from typing import Any

import numpy as np

PATIENCE = 120.0  # s, for a machine with other work
BEGIN = 1_700_000_000_123_456_789  # ns


def run(node: str, samples: int, end: str) -> dict[str, Any]:
    """Return inputs received in a closed loop, those of another stepper, and what follows the loop."""
    import rclpy
    from rclpy.time import Time
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    from pinmobile import rk4

    stepper = runpy.run_path(node)["make_stepper"]()
    plant, dt, names = stepper.plant, stepper.dt, ["psi", "y", "x"]
    rclpy.init(args=[])
    robot, answers = rclpy.create_node("robot"), deque[list[float]]()
    robot.create_subscription(
        Float64MultiArray, "commands", lambda message: answers.append(message.data.tolist()), 10
    )
    publisher = robot.create_publisher(JointState, "joint_states", 10)
    limit = time.monotonic() + PATIENCE

    def wait(until: Any) -> None:
        while not until():
            assert time.monotonic() < limit, "no answer of the node"
            rclpy.spin_once(robot, timeout_sec=0.1)

    def publish(k: int, q: Any, v: Any) -> None:
        stamp = Time(nanoseconds=BEGIN + round(1e9 * k * dt)).to_msg()
        message = JointState(name=names, position=q[::-1].tolist(), velocity=v[::-1].tolist())
        message.header.stamp = stamp
        publisher.publish(message)

    def acceleration(u: Any, t: float, q: Any, v: Any) -> Any:
        return plant.forward_dynamics(q, v, u)

    wait(lambda: publisher.get_subscription_count() and robot.count_publishers("commands"))
    q, v, received, expected = np.array([0.0, 0.1, 0.0]), np.zeros(3), [], []
    for k in range(samples):
        publish(k, q, v)
        expected.append(stepper.step(k * dt, q, v).tolist())
        wait(lambda: answers)
        received.append(answers.popleft())
        u = np.array(received[-1])
        q, v = rk4(partial(acceleration, u), k * dt, q, v, dt)
    print("done", flush=True)
    if end == "nan":
        publish(samples, np.full(3, np.nan), v)
    elif end == "late":
        publish(samples - 1, q, v)
    wait(lambda: answers)
    stopped = [answers.popleft()]
    if end != "interrupt":  # the node stays stopped
        publish(samples + 1, q, v)
        wait(lambda: answers)
        stopped.append(answers.popleft())
    error = np.abs(q - stepper.rollout().reference.q[-1]).max()
    return {"received": received, "expected": expected, "stopped": stopped, "error": float(error)}


if __name__ == "__main__":
    print(json.dumps(run(sys.argv[1], int(sys.argv[2]), sys.argv[3])))
