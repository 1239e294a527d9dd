"""pinmobile, by its public names."""

from fleet import EVERY, GAIN, NOMINAL, Figures, Fleet, Run
from task import RADIUS, RATE

from pinmobile import Circle, ComputedTorque, MobileRobot, Tangent, ensemble


def rollout(fleet: Fleet) -> Run:
    """Make robot, controller and trajectory first."""
    robot = MobileRobot(NOMINAL.mass, NOMINAL.yaw_inertia, com=NOMINAL.com)
    controller = ComputedTorque(robot, GAIN, GAIN)
    trajectory = Tangent(Circle(RADIUS, RATE, fleet.task.duration))
    spread = {"mass": fleet.mass, "com.x": fleet.com}

    def run() -> Figures:
        done = ensemble(
            robot, controller, trajectory, n=fleet.n, spread=spread, seed=0, dt=fleet.task.dt, every=EVERY
        )
        figures = done.max_error, done.rms_error, done.max_input, done.max_distance
        return Figures(*figures, done.counts.transpose(1, 0, 2))

    return run
