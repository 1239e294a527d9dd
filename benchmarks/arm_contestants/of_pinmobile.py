"""pinmobile, by its public names."""

import numpy as np
from arm_task import AT, KD, KP, MASS, PERIOD, RADIUS, RATE, SIZE, WAY, ArmTask
from task import Log, Run

from pinmobile import Circle, ComputedTorque, CubicVia, MobileRobot, Tangent, WholeBody, simulate
from pinmobile.controllers import Decoupled


def build() -> MobileRobot:
    return MobileRobot.box(MASS, SIZE).mount("ur5", AT)


def trajectory_of(robot: MobileRobot) -> WholeBody:
    start = np.zeros(6)
    joints = CubicVia(start, start + WAY, start, PERIOD / 2, PERIOD)
    return WholeBody(robot, Tangent(Circle(RADIUS, RATE, PERIOD)), joints)


def rollout(task: ArmTask) -> Run:
    """Make robot, controller and trajectory first; `simulate` evaluates the references."""
    robot = build()
    controller, trajectory = ComputedTorque(robot, KP, KD), trajectory_of(robot)

    def run() -> Log:
        done = simulate(robot, controller, trajectory, dt=task.dt, duration=task.duration)
        return Log(done.q, done.v, done.a, done.u, done.error)

    return run


def largest_errors(task: ArmTask) -> dict[str, float]:
    """Return the largest error of any coordinate [m, rad], of the whole-body and the decoupled controller."""
    robot = build()
    trajectory, laws = trajectory_of(robot), {"whole body": ComputedTorque, "decoupled": Decoupled}
    return {
        name: float(
            simulate(robot, law(robot, KP, KD), trajectory, dt=task.dt, duration=task.duration)
            .max_error()
            .max()
        )
        for name, law in laws.items()
    }
