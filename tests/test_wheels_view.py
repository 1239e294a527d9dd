"""What is drawn of a robot on wheels: wheels turn as it rolls, forces stand where they touch the ground."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes

import pinmobile as pm
from pinmobile import Coulomb, WheeledRobot, WheelTable, plots
from pinmobile.arrays import Array
from pinmobile.controllers import Backstepping, UnicycleTracking
from pinmobile.palette import GRIPS, QUIET, SLIDES
from pinmobile.viewer import Overlays, Viewer
from pinmobile.viewer.motion import envelope, figure
from pinmobile.wheels import OdometryFeedback, Support
from tests import wheeled
from tests.parts import steady
from tests.wheeled import CASTER, WHEEL

pytestmark = pytest.mark.once

BOX = pm.MobileRobot(30.0, 1.3, com=(0.0, 0.0, 0.1), size=(0.6, 0.4, 0.25))
DIFFERENTIAL = WheelTable.differential(0.46, 0.1, supports=[(0.25, 0), (-0.25, 0)], **WHEEL)
TABLES: dict[str, WheelTable] = {
    "differential": DIFFERENTIAL,
    "mecanum": WheelTable.mecanum(0.4, 0.48, 0.09, **WHEEL),
    "omni": WheelTable.omni(0.22, 0.06, **WHEEL),
    "swerve": WheelTable.swerve([(0.2, 0.1), (-0.2, -0.1)], 0.06, supports=[(-0.2, 0.2)], **WHEEL),
    "car": WheelTable.car(0.5, 0.46, 0.1, **WHEEL),
    "caster": WheelTable((*WheelTable.differential(0.46, 0.1, **WHEEL).wheels, CASTER), (Support(0.2, 0),)),
}


@pytest.fixture(scope="module")
def rolls() -> pm.Rollout:
    """Return a differential drive that rolls on a circle."""
    robot = WheeledRobot(BOX, DIFFERENTIAL)
    believed = WheelTable.differential(0.46, 0.099, supports=[(0.25, 0), (-0.25, 0)], **WHEEL)
    law = OdometryFeedback(Backstepping(UnicycleTracking(), robot), believed)
    return pm.simulate(robot, law, pm.Tangent(pm.Circle(1, 0.5, 0.6)), dt=0.02, integrator=pm.rk4)


@pytest.fixture(scope="module")
def slides() -> pm.Rollout:
    """Return a mecanum base on ice, whose wheels slide."""
    robot = WheeledRobot(BOX, TABLES["mecanum"], Coulomb(0.05))
    return pm.simulate(robot, steady(2.0, 2.0, 2.0, 2.0), pm.Tangent(pm.Circle(1, 0.5, 0.2)), dt=0.02)


def posture(robot: WheeledRobot, seed: int) -> tuple[Array, Array]:
    """Return a state that rolls."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-0.6, 0.6, robot.nq)
    return q, robot.project(q, rng.uniform(-1, 1, robot.nv))


def geometries(robot: WheeledRobot) -> dict[str, Any]:
    """Return the shapes of what is drawn, by name."""
    return {item.name: item.geometry for item in robot.visual_model.geometryObjects}


def placed(robot: WheeledRobot, q: Array) -> dict[str, Array]:
    """Return the placements of what is drawn, by name."""
    return dict(zip(geometries(robot), robot.drawing(q), strict=True))


@pytest.mark.parametrize("name", TABLES)
def test_the_point_of_a_drawn_wheel_at_the_ground_stands_still_along_what_rolls(name: str) -> None:
    robot = WheeledRobot(BOX, TABLES[name])
    for seed in range(3):
        q, v = posture(robot, seed)
        now, ahead, behind = (placed(robot, robot.integrate(q, h * v)) for h in (0.0, 1e-6, -1e-6))
        for wheel in robot.table.wheels:
            key = f"{wheel.name}/tyre"
            centre = now[key][:3, 3]
            assert centre[2] == pytest.approx(wheel.radius, abs=1e-12)
            ground = np.linalg.inv(now[key]) @ [*centre[:2], 0.0, 1.0]
            speed = ((ahead[key] - behind[key]) @ ground)[:2] / 2e-6
            axle = now[key][:2, 1]
            along = np.array([axle[1], -axle[0]])
            if wheel.roller is None:
                assert abs(speed).max() < 1e-8
            else:
                turned = np.cos(wheel.roller) * along + np.sin(wheel.roller) * axle
                assert abs(turned @ speed) < 1e-8


def test_rollers_at_the_ground_lie_at_the_roller_angle_and_on_top_as_its_mirror_image() -> None:
    robot = WheeledRobot(BOX, TABLES["mecanum"])
    shapes = geometries(robot)
    for wheel in robot.table.wheels:
        points = np.array(shapes[f"{wheel.name}/spokes"].vertices())
        points = points[points[:, 2] < -0.75 * wheel.radius]  # the light roller is at the ground at rest
        _, _, axes = np.linalg.svd(points - points.mean(axis=0))
        assert wheel.roller is not None
        assert abs(axes[0] @ [np.cos(wheel.roller), np.sin(wheel.roller), 0]) == pytest.approx(1, abs=1e-2)
        dark = np.array(shapes[f"{wheel.name}/tyre"].vertices())
        top = dark[dark[:, 2] > 0.8 * wheel.radius]
        assert np.sign((top[:, 0] * top[:, 1]).sum()) == -np.sign(wheel.roller)


def test_supports_forks_and_arms_are_drawn_where_they_are() -> None:
    robot = WheeledRobot(BOX.mount("ur5"), TABLES["caster"])
    q, _ = posture(robot, 1)
    found = placed(robot, q)
    body = BOX.frame_placements(q[:3])[2]
    assert found["support_1/ball"][:3, 3] == pytest.approx((body @ [0.2, 0.0, 0.03, 1.0])[:3])
    assert found["caster/fork"][:3, 3] == pytest.approx((body @ [-0.3, 0.02, 0.0, 1.0])[:3])
    own = robot.robot
    frames, item = own.frame_placements(q[: own.nq]), own.visual_model.geometryObjects[-1]
    assert found[item.name] == pytest.approx(frames[item.parentJoint - 1] @ item.placement.homogeneous)
    assert envelope(figure(robot), np.append(robot.rest[:3], robot.rest)[None])[1] > 0.4
    many = np.stack([q, robot.rest])
    assert robot.drawing(many)[0] == pytest.approx(robot.drawing(q), abs=1e-12)


def test_wheels_that_a_file_shows_turn_and_are_not_doubled(tmp_path: Path) -> None:
    both = r"\g<0><visual>\1</visual>"
    text = re.sub(r"<collision>(.*?)</collision>", both, wheeled.husky())
    (tmp_path / "husky.urdf").write_text(text)
    robot = WheeledRobot.from_urdf(tmp_path / "husky.urdf", ground=Coulomb(), rollers={})
    names = geometries(robot)
    assert "wheel_0_link_0" in names
    assert not any(name.endswith(("/tyre", "/spokes")) for name in names)
    q = robot.rest.copy()
    still = placed(robot, q)
    shown = {item.name: item.placement.homogeneous for item in robot.robot.visual_model.geometryObjects}
    assert all(still[name] == pytest.approx(shown[name], abs=1e-12) for name in shown)
    q[3] = 0.7
    turned = placed(robot, q)
    assert turned["wheel_1_link_0"] == pytest.approx(still["wheel_1_link_0"])
    assert turned["wheel_0_link_0"][:3, 3] == pytest.approx(still["wheel_0_link_0"][:3, 3])
    spun = turned["wheel_0_link_0"][:3, :3] @ still["wheel_0_link_0"][:3, :3].T
    assert spun @ [0, 0, 1] == pytest.approx([np.sin(0.7), 0, np.cos(0.7)])  # its top goes ahead

    (tmp_path / "bare.urdf").write_text(wheeled.husky())
    bare = WheeledRobot.from_urdf(tmp_path / "bare.urdf", ground=Coulomb(), rollers={})
    assert "wheel_0/tyre" in geometries(bare)


def contacts_of(run: pm.Rollout) -> Any:
    """Return the contacts of a run."""
    return run.plant.contacts(run.q, run.v, run.a, run.u, run.signals)


def test_contacts_of_what_rolls_are_newtons_law_and_tell_what_is_not_determined(rolls: pm.Rollout) -> None:
    found = contacts_of(rolls)
    mass = sum(inertia.mass for inertia in BOX.model.inertias)
    c, s = np.cos(found.directions), np.sin(found.directions)
    x = (c * found.forces[..., 0] - s * found.forces[..., 1]).sum(axis=1)
    y = (s * found.forces[..., 0] + c * found.forces[..., 1]).sum(axis=1)
    assert np.stack([x, y], axis=1) == pytest.approx(mass * rolls.a[:, :2], abs=1e-6)
    assert found.determined.tolist() == [[True, False], [True, False]]
    assert not found.slides.any()
    assert np.all(found.loads > 0)
    assert found.limits[..., 0] == pytest.approx(0.8 * found.loads)
    assert found.centre == pytest.approx(np.tile([0.0, 1.0], (len(rolls), 1)), abs=0.02)
    away = found.places - rolls.q[:, None, :2]
    assert np.linalg.norm(away, axis=-1) == pytest.approx(0.23 * np.ones((len(rolls), 2)))


def test_loads_that_cannot_be_told_are_no_numbers() -> None:
    robot = WheeledRobot(BOX, WheelTable.differential(0.46, 0.1, **WHEEL))
    q, v = (x[None] for x in posture(robot, 2))
    found = robot.contacts(q, v, np.zeros_like(v), np.zeros((1, 2)), {})
    assert np.isnan(found.loads).all()
    assert np.isfinite(found.forces).all()


def test_contacts_of_what_slides_are_the_signals_at_the_limit(slides: pm.Rollout) -> None:
    found = contacts_of(slides)
    assert found.slides[1:].all()
    shares = np.abs(found.forces / found.limits)
    assert shares[1:, :, 0] == pytest.approx(1.0)
    assert found.limits[1:, :, 0] == pytest.approx(0.05 * found.loads[1:])
    assert np.all(found.slips[2:, :, 0] * found.forces[2:, :, 0] < 0)  # friction brakes what slides


def test_a_page_has_discs_forces_centre_and_colours(rolls: pm.Rollout, slides: pm.Rollout) -> None:
    shown = Overlays(contacts=True, centre=True)
    for run, paint, other in ((rolls, QUIET, SLIDES), (slides, SLIDES, QUIET)):
        with Viewer(run.plant, overlays=shown) as viewer:
            recording = viewer.record(run, fps=20)
        tracks = {track["path"]: track["clip"]["tracks"] for track in recording.tracks}
        contacts = [path for path in tracks if path.startswith("meshcat/contacts/")]
        assert len({path.split("/")[2] for path in contacts}) == len(run.plant.table)
        assert "meshcat/centre/way" in tracks
        sent = b"".join(recording._commands)
        legend = sent[sent.rindex(b"legend") :]
        assert paint.encode() in legend
        assert b"mu N" in legend
        assert b"1 m = " in legend
        assert GRIPS.encode() in legend  # of the discs
        if run is rolls:
            assert other.encode() not in legend
            found = contacts_of(run)
            place = next(t for t in tracks["meshcat/contacts/0/grips/disc"] if t["name"] == ".position")
            assert place["values"][:3] == pytest.approx([*found.places[0, 0], 0.0], abs=1e-4)
            assert place["values"][-3:] == pytest.approx([*found.places[-1, 0], 0.0], abs=1e-4)


@pytest.mark.parametrize("figure", [plots.wheel_torques, plots.friction, plots.slip, plots.loads])
def test_figures_have_lines_and_units(
    figure: Callable[..., Any], rolls: pm.Rollout, slides: pm.Rollout
) -> None:
    drawn = figure({"rolls": rolls, "slides": slides})
    first, second = drawn.axes[:2]
    supports = [len(run.plant.table.supports) if figure is plots.loads else 0 for run in (rolls, slides)]
    entries = [len(axes.get_legend().get_texts()) for axes in (first, second)]
    assert entries == [2 + supports[0], 4 + supports[1]]
    assert any(supports) == (figure is plots.loads)
    assert re.search(r"\[(N m|-|m/s|N)\]", first.get_ylabel())
    assert len({line.get_color() for line in second.lines[:4]}) == 4
    assert len({str(line._dash_pattern) for line in second.lines[:4]}) == 4
    still = pm.FixedHeading(pm.Hold((0, 0), 0.1), 0)
    bare = pm.simulate(pm.MobileRobot.lecture(), pm.PD(1, 1), still, dt=0.1)
    with pytest.raises(pm.InvalidArgument, match=r"rollouts.plant is .*, expected a WheeledRobot"):
        figure(bare)


def test_torques_of_steering_axes_have_axes_of_their_own(rolls: pm.Rollout) -> None:
    robot = WheeledRobot(BOX, TABLES["swerve"])
    turns = pm.simulate(robot, steady(1.0, 0.01, 1.0, 0.01), pm.Tangent(pm.Circle(1, 0.5, 0.1)), dt=0.02)
    drive, other, steering, none = plots.wheel_torques({"swerve": turns, "differential": rolls}).axes
    assert [axes.get_ylabel() for axes in (drive, steering)] == ["torque [N m]", "steering torque [N m]"]
    assert [len(axes.lines) for axes in (drive, other, steering, none)] == [2, 2, 2, 0]
    assert np.ptp(steering.lines[0].get_ydata()) == 0.0


def test_figures_tell_shares_friction_and_odometry(rolls: pm.Rollout, slides: pm.Rollout) -> None:
    def words(axes: Axes) -> list[str]:
        return [text.get_text() for text in axes.get_legend().get_texts()]  # type: ignore[union-attr]

    assert words(plots.friction(rolls).axes[0]) == ["left (share)", "right (share)"]
    top = max(np.max(np.asarray(line.get_ydata())) for line in plots.friction(slides).axes[0].lines[:4])
    assert top == pytest.approx(1.0)
    path, off = plots.odometry(rolls).axes
    assert words(path) == ["desired", "true", "believed"]
    believed = rolls.signals["believed_pose"].values
    assert off.lines[0].get_ydata() == pytest.approx(np.hypot(*(believed - rolls.poses)[:, :2].T))
    with pytest.raises(pm.InvalidArgument, match="no signal believed_pose"):
        plots.odometry(slides)
    alone = WheeledRobot(BOX, WheelTable.differential(0.46, 0.1, **WHEEL))
    with pytest.raises(pm.InvalidArgument, match="unknown loads"):
        plots.friction(replace(rolls, plant=alone))
