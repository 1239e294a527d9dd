"""Orientations along a path of poses, and an end effector in rollouts, figures and the viewer."""

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinmobile as pm
from pinmobile import plots
from pinmobile.arrays import Array
from pinmobile.loop import EndEffector
from pinmobile.reaching import InverseKinematicsTrajectory, pose_error
from pinmobile.viewer import Overlays, Viewer
from tests.refusals import refusals, refused, unknown
from tests.test_viewer import tracks

ROBOT = pm.MobileRobot.box(100, (0.8, 0.6, 0.3)).mount("ur5", (0.1, 0, 0.3, 0))
BENT = np.array([0, 0, 0, 0, -1.2, 1.6, -0.4, 1.57, 0])
START = ROBOT.frame_pose(BENT)
STAYS = pm.Hold((0.3, -0.2, 0.9), 6.0)


def turned(*steps: tuple[str, float]) -> Array:
    R = np.eye(3)
    for axis, angle in steps:
        R = R @ pin.utils.rotate(axis, angle)
    return R


def poses(rotations: Any, points: Any) -> Array:
    T = np.tile(np.eye(4), (len(points), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = rotations, points
    return T


def some(n: int, largest: float, seed: int) -> tuple[Array, Array]:
    """Return poses, each turned by up to an angle from the one before, and times."""
    rng, rotations = np.random.default_rng(seed), [np.eye(3)]
    for _ in range(n - 1):
        axis = rng.normal(size=3)
        turn = pin.exp3(rng.uniform(0.2, 1) * largest * axis / np.linalg.norm(axis))
        rotations.append(rotations[-1] @ turn)
    return poses(rotations, rng.normal(size=(n, 3))), np.append(0, np.cumsum(rng.uniform(0.4, 1.5, n - 1)))


@pytest.mark.parametrize(("n", "largest"), [(2, 3.1), (9, 3.1), (40, 0.3)])
def test_a_path_through_poses_is_smooth_and_its_rates_are_exact(n: int, largest: float) -> None:
    T, times = some(n, largest, n)
    path = pm.PosePath.through(T, times)
    at = path(times)
    np.testing.assert_allclose(at.pose, T, atol=1e-12)
    np.testing.assert_allclose(at.twist[[0, -1]], 0, atol=1e-12)  # at rest at both ends
    h = 1e-6
    for k in range(1, n - 1):  # twist and its rate go on at the knots
        before, after = path(times[k] - h), path(times[k] + h)
        # Jerk is below 1e3 of the accelerations here.
        np.testing.assert_allclose(before.rate, after.rate, atol=2e3 * h * (1 + np.abs(at.rate).max()))
        np.testing.assert_allclose(before.twist, after.twist, atol=3 * h * (1 + np.abs(at.rate).max()))
    h, t = 1e-4, np.random.default_rng(0).uniform(0.01, times[-1] - 0.01, 60)
    t = t[np.abs(t[:, None] - times).min(axis=1) > 2 * h]
    ahead, here, behind = (path(t + k * h) for k in (1, 0, -1))
    # Differences are exact but for h^2 / 6 of a third derivative, below 1e4 of what turns by 3 rad in 0.4 s.
    scale = h**2 / 6 * 1e4
    np.testing.assert_allclose(pose_error(ahead.pose, behind.pose) / (2 * h), here.twist, atol=scale)
    np.testing.assert_allclose((ahead.twist - behind.twist) / (2 * h), here.rate, atol=10 * scale)


def test_turns_about_one_axis_are_the_spline_of_their_angles() -> None:
    angles, times = np.array([0, 1.0, 3.5, 5.0, 7.5]), np.array([0, 1, 2.5, 4, 6])
    path = pm.PosePath(STAYS, [turned(("z", a)) for a in angles], times=times)
    spline = pm.Spline(angles[:, None], times)
    t = np.linspace(0, 6, 31)
    found = path(t)
    np.testing.assert_allclose(
        found.pose[:, :3, :3], [turned(("z", float(a))) for a in spline(t)[:, 0]], atol=1e-12
    )
    for order, part in ((1, found.twist), (2, found.rate)):
        np.testing.assert_allclose(part[:, 5], spline.derivative(t, order)[:, 0], atol=1e-11)
        np.testing.assert_allclose(part[:, :5], 0, atol=1e-11)
    assert spline(6.0)[0] == 7.5  # beyond a whole turn


R0, R1 = np.eye(3), turned(("x", 0.4))
TWO = poses([R0, R1], [(0, 0, 0), (1, 0, 0)])


test_poses_that_make_no_path_are_refused = refusals(
    (lambda: pm.PosePath.through(TWO), r"times is None, expected the time of each pose"),
    (lambda: pm.PosePath.through(2 * TWO, [0, 1]), r"poses has last rows off by 1"),
    (
        lambda: pm.PosePath.through(poses([R0, turned(("z", np.pi))], [(0, 0, 0)] * 2), [0, 1]),
        r"rotation\[1\] is half a turn from rotation\[0\], expected less",
    ),
    (lambda: pm.PosePath(STAYS, [R0, R1], times=[0, 5]), r"times goes from 0 to 5 s, expected from 0 to 6 s"),
    (lambda: pm.PosePath(STAYS, [R0, 2 * R1], times=[0, 6]), r"rotation\[1\] has R' R off by 3"),
    (lambda: pm.PosePath(STAYS, R0, R1, turn=(0, 0, 1)), r"turn is .*, expected None with final_rotation"),
)


def test_a_path_through_poses_is_followed_all_the_way_round() -> None:
    steps = [turned(("z", a), ("x", 0.2 * np.sin(a))) for a in np.linspace(0, 1.8 * np.pi, 8)]
    way = START[:3, 3] + np.array([[0.2 * k, 0.05 * k * (7 - k), 0] for k in range(8)])
    target = pm.PosePath.through(poses([START[:3, :3] @ R for R in steps], way), np.linspace(0, 8, 8))
    found = pm.solve_inverse_kinematics(ROBOT, target, q0=BENT, dt=0.02)
    assert max(found.max_error()) < 1e-3


HAND = pm.PosePath(
    pm.Spline([START[:3, 3], START[:3, 3] + [0.4, 0.2, -0.1], START[:3, 3] + [0.8, 0, 0.1]], [0, 2, 4]),
    START[:3, :3],
    turn=(0.4, 0, 4.0),
)


@pytest.fixture(scope="module")
def way() -> InverseKinematicsTrajectory:
    return pm.solve_inverse_kinematics(ROBOT, HAND, q0=BENT, dt=0.02)


@pytest.fixture(scope="module")
def run(way: InverseKinematicsTrajectory) -> pm.Rollout:
    return pm.simulate(ROBOT, pm.EndEffectorTracking(ROBOT, HAND, dt=0.02), way, dt=0.02)


def target_of(hand: EndEffector) -> Array:
    assert hand.target is not None
    return hand.target


def check_hand(hand: EndEffector, run: pm.Rollout, q: Array | None = None) -> None:
    """Compare with what the target and the robot say themselves."""
    actual, wanted = ROBOT.frame_pose(run.q[:, :9] if q is None else q), HAND(run.t).pose
    np.testing.assert_allclose(hand.pose, actual, atol=1e-12)
    np.testing.assert_allclose(target_of(hand), wanted, atol=1e-12)
    error = pose_error(wanted, actual)
    np.testing.assert_allclose(hand.error, error, atol=1e-12)
    np.testing.assert_allclose(hand.distance, np.linalg.norm(error[:, :3], axis=1), atol=1e-12)
    np.testing.assert_allclose(hand.angle, np.linalg.norm(error[:, 3:], axis=1), atol=1e-12)
    np.testing.assert_array_equal(np.hstack([hand.position_error, hand.orientation_error]), hand.error)
    assert hand.max_error() == (hand.distance.max(), hand.angle.max())


def test_a_rollout_has_the_poses_and_targets_of_its_end_effector(run: pm.Rollout, tmp_path: Path) -> None:
    hand = run.end_effector()
    assert (hand.frame, hand.is_oriented) == ("ur5/tool0", True)
    check_hand(hand, run)
    assert max(hand.max_error()) < 1e-2
    np.testing.assert_array_equal(hand.position, hand.pose[:, :3, 3])
    np.testing.assert_array_equal(hand.orientation, hand.pose[:, :3, :3])
    assert hand.units["distance"] == "m"
    assert hand.units["orientation_error"] == "rad"
    metres, radians = hand.max_error()
    words = f"ur5/tool0 over 4 s, largest error {metres:.3e} m, {radians:.3e} rad"
    assert repr(hand) == f"<EndEffector: {words}>"
    assert str(run).endswith(f"end effector {words}")
    run.save(tmp_path / "run.npz")
    check_hand(pm.Rollout.load(tmp_path / "run.npz").end_effector(), run)
    run.to_csv(tmp_path / "run.csv")
    assert "target position of ur5/tool0[2] [m]" in (tmp_path / "run.csv").read_text().splitlines()[0]
    check_hand(pickle.loads(pickle.dumps(hand)), run)


def test_the_target_is_that_of_controller_trajectory_or_reference(
    way: InverseKinematicsTrajectory, run: pm.Rollout
) -> None:
    tracked = pm.simulate(ROBOT, pm.ComputedTorque(ROBOT, 100, 20), way, dt=0.02)
    check_hand(tracked.end_effector(), tracked)
    compiled = pm.simulate(ROBOT, pm.ComputedTorque(ROBOT, 100, 20), way, dt=0.02, engine=pm.Engine.COMPILED)
    check_hand(compiled.end_effector(), compiled)
    law = pm.EndEffectorTracking(ROBOT, HAND, dt=0.02)
    with refused(r"target poses.*solve_inverse_kinematics"):
        pm.simulate(ROBOT, law, way, dt=0.02, engine=pm.Engine.COMPILED)
    wrapped = pm.InputSaturation(law, 1e4)
    rest = pm.simulate(ROBOT, wrapped, way, dt=0.02, duration=1.0)
    check_hand(rest.end_effector(), rest)
    # A posture that is another one than the pose's: the controller's target counts.
    still = pm.WholeBody(ROBOT, pm.FixedHeading(pm.Hold((0, 0), 1.0), 0.0), pm.Hold(BENT[3:], 1.0))
    aimed = pm.simulate(ROBOT, pm.EndEffectorTracking(ROBOT, HAND, dt=0.02), still, dt=0.02)
    check_hand(aimed.end_effector(), aimed)
    led = pm.simulate(ROBOT, pm.ComputedTorque(ROBOT, 100, 20), still, dt=0.02).end_effector()
    np.testing.assert_allclose(target_of(led), np.broadcast_to(START, (51, 4, 4)), atol=1e-12)
    elbow = run.end_effector("ur5/forearm_link")
    np.testing.assert_allclose(target_of(elbow), ROBOT.frame_pose(run.reference.q, elbow.frame), atol=1e-12)


def test_the_end_effector_of_a_robot_on_wheels_is_that_of_its_arm(way: InverseKinematicsTrajectory) -> None:
    table = pm.WheelTable.mecanum(wheelbase=0.5, track=0.5, radius=0.08, mass=2.0, spin_inertia=0.006)
    robot = pm.WheeledRobot(ROBOT, table)
    rolled = pm.simulate(robot, pm.ComputedTorque(robot, 100, 20), way, dt=0.02, duration=1.0)
    hand = rolled.end_effector()
    check_hand(hand, rolled)
    assert hand.max_error()[0] < 1e-3
    assert robot.end_effector == robot.frame_name() == "ur5/tool0"
    assert robot.frame_names == ROBOT.frame_names


def test_what_has_no_target_or_no_frames_says_so(run: pm.Rollout) -> None:
    base = replace_reference(run)
    hand = base.end_effector()
    assert hand.target is None
    assert "without target" in repr(hand)
    with refused("target of end effector 'ur5/tool0' is None, expected a run with"):
        _ = hand.error
    with unknown(r"unknown frame 'tool', did you mean .* available: .*ur5/wrist_3_link"):
        run.end_effector("tool")
    with refused("has no poses of frames, expected a MobileRobot"):
        replace(run, plant=None, signals={}).end_effector()


def replace_reference(run: pm.Rollout) -> pm.Rollout:
    """Return the run with a reference of the base alone, and no target."""
    short = type(run.reference)(*(part[:, :3] for part in run.reference))
    return replace(run, reference=short, error=run.error[:, :3], signals={})


def test_signals_of_all_samples_at_once_are_checked() -> None:
    class Told:
        duration = 0.1

        def __init__(self, answer: Any) -> None:
            self.answer = answer

        def __call__(self, t: Any) -> Any:
            return pm.FixedHeading(pm.Hold((0, 0), 0.1), 0.0)(t)

        def signals_at(self, t: Array) -> Any:
            return self.answer

    box = pm.MobileRobot.box()
    with refused("result of Told.signals_at is 3, expected a dict of signals"):
        pm.simulate(box, pm.ComputedTorque(box, 1, 1), Told(3), dt=0.05)
    told = Told({"a": ("m", [1.0, 2.0, 3.0])})
    run = pm.simulate(box, pm.ComputedTorque(box, 1, 1), told, dt=0.05)
    assert run.signals["a"].values.tolist() == [1, 2, 3]


@pytest.mark.once
def test_the_figure_has_path_height_and_both_errors(run: pm.Rollout) -> None:
    hand = run.end_effector()
    for width, columns in ((3.5, 1), (9.0, 2)):
        figure = plots.end_effector(run, width=width)
        assert figure.get_figwidth() == width
        figure.draw_without_rendering()
        above, height, way, turn = figure.axes
        assert len({round(axes.get_position().x0, 1) for axes in figure.axes}) == columns
        labels = [axes.get_ylabel().replace("\n", " ") for axes in figure.axes]
        assert labels == ["y [m]", "z [m]", "distance [m]", "angle [rad]"]
        np.testing.assert_array_equal(above.lines[0].get_xydata(), hand.position[:, :2])
        np.testing.assert_array_equal(height.lines[0].get_ydata(), hand.position[:, 2])
        np.testing.assert_array_equal(way.lines[0].get_ydata(), hand.distance)
        np.testing.assert_array_equal(turn.lines[0].get_ydata(), hand.angle)
        assert hand.target is not None
        np.testing.assert_array_equal(above.lines[1].get_xydata(), hand.target[:, :2, 3])
        assert above.lines[1].is_dashed()
        assert [text.get_text() for text in figure.legends[0].texts] == ["target", "travelled"]
    both = plots.end_effector({"one": run, "two": replace_reference(run)}, title="Both")
    assert both.get_suptitle() == "Both"
    assert len(both.axes[0].lines) == 3
    assert len(both.axes[2].lines) == 1
    nothing = plots.end_effector(replace_reference(run))
    assert [axes.texts[0].get_text() for axes in nothing.axes[2:]] == ["there is no target"] * 2
    with unknown("unknown frame 'hand'"):
        plots.end_effector(run, frame="hand")
    with refused(r"rollouts\['a'\].plant is None, which has no poses of frames"):
        plots.end_effector({"a": replace(run, plant=None, signals={})})


@pytest.mark.once
def test_the_viewer_shows_trail_target_and_error_of_the_end_effector(run: pm.Rollout) -> None:
    hand = run.end_effector()
    with Viewer(ROBOT) as viewer:
        found = tracks(viewer.record(run, fps=10))
        bare = tracks(viewer.record(run, fps=10, overlays=Overlays(end_effector=False)))
        base = tracks(viewer.record(replace_reference(run), fps=10))
    node = "meshcat/hand0/trail/<object>"
    drawn = found[node, ".drawn"]["values"]
    assert drawn[0] == 0
    assert drawn[-1] == 36 * (len(run) - 1)  # all of its triangles
    said = found["meshcat/stage", ".caption"]["values"][20]
    k = 100  # at 2 s
    assert f"t = {run.t[k]:.1f} s" in said
    assert said.splitlines()[-1].startswith("end effector ")
    words = said.splitlines()[-1].removeprefix("end effector ").split(", ")
    metres, radians = (float(word.split()[0]) for word in words)
    scale = {"mm": 1e-3, "µm": 1e-6, "mrad": 1e-3, "µrad": 1e-6}
    units = [word.split()[1] for word in words]
    assert metres * scale[units[0]] == pytest.approx(hand.distance[k], rel=0.01)
    assert radians * scale[units[1]] == pytest.approx(hand.angle[k], rel=0.01)
    assert (node, ".drawn") not in bare
    assert "end effector" not in bare["meshcat/stage", ".caption"]["values"][20]
    assert (node, ".drawn") in base
    assert "end effector" not in base["meshcat/stage", ".caption"]["values"][20]
