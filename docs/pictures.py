"""Record the moving picture of README: ``python docs/pictures.py``. It needs a Chromium."""

from pathlib import Path

from pinmobile import Circle, ComputedTorque, MobileRobot, Spline, Tangent, WholeBody, rk4, simulate
from pinmobile.viewer import Viewer


def ur5() -> None:
    """Show an arm that bends while its base drives a circle."""
    robot = MobileRobot.box(mass=60, size=(0.8, 0.6, 0.3)).mount("ur5", at=(0.2, 0, 0.3, 0))
    bend = Spline([[0.0] * 6, [-0.5] * 6, [0.0] * 6], [0, 3, 6])
    motion = WholeBody(robot, Tangent(Circle(radius=1, rate=1.0, duration=6)), bend)
    run = simulate(robot, ComputedTorque(robot, kp=100, kd=20), motion, dt=0.002, integrator=rk4)
    with Viewer(robot) as viewer:
        viewer.record(run).save_gif(Path(__file__).with_name("ur5.gif"), fps=10, size=(840, 525))


if __name__ == "__main__":
    ur5()
