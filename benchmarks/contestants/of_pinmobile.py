"""pinmobile, by its public names."""

from collections.abc import Callable
from math import remainder, tau
from typing import Any

import numpy as np
from task import GAIN, PD_GAINS, RADIUS, RATE, Body, Log, Run, Task

from pinmobile import PD, Circle, ComputedTorque, MobileRobot, Tangent, law, rk4, simulate
from pinmobile.integrators import constant_acceleration


def build(body: Body) -> MobileRobot:
    return MobileRobot(body.mass, body.yaw_inertia, com=body.com)


def own_law(t: float, q: np.ndarray, v: np.ndarray, reference: Any) -> np.ndarray:
    """PD, as a user writes it."""
    e = reference.q - q
    e[2] = remainder(e[2], tau)
    return PD_GAINS * (reference.v - v + e)


def rollout(task: Task) -> Run:
    """Make robot, controller and trajectory first; `simulate` evaluates the references."""
    robot = build(task.body)
    controller, trajectory = controller_of(task, robot), trajectory_of(task)
    return lambda: simulated(task, robot, controller, trajectory)


def rollout_with_trajectory(task: Task) -> Run:
    """Make the trajectory anew in each run, as a script that runs once does."""
    robot = build(task.body)
    controller = controller_of(task, robot)
    return lambda: simulated(task, robot, controller, trajectory_of(task))


def controller_of(task: Task, robot: MobileRobot) -> Any:
    if task.control == "computed torque":
        return ComputedTorque(robot, kp=GAIN, kd=GAIN)
    return law(own_law) if task.control == "own law" else PD(PD_GAINS, PD_GAINS)


def trajectory_of(task: Task) -> Tangent:
    return Tangent(Circle(RADIUS, RATE, task.duration))


def simulated(task: Task, robot: MobileRobot, controller: Any, trajectory: Tangent) -> Log:
    integrator = {"lecture": constant_acceleration, "rk4": rk4}[task.step]
    done = simulate(robot, controller, trajectory, dt=task.dt, integrator=integrator)
    return Log(done.q, done.v, done.a, done.u, done.error)


def calls(body: Body) -> dict[str, Callable[..., Any]]:
    robot = build(body)
    return {
        "M": robot.mass_matrix,
        "n": robot.nonlinear_effects,
        "inverse": robot.inverse_dynamics,
        "forward": robot.forward_dynamics,
    }
