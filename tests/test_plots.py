"""Figures: what is drawn is what was recorded, where it was recorded, and it can be read."""

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from PIL import Image

import pinmobile as pm
from pinmobile import plots
from pinmobile.arrays import Array
from pinmobile.balance import body_zero_moment_point, reaction_wrench, required_friction, tip_over_margin
from pinmobile.controllers import PD, ComputedTorque, law
from pinmobile.errors import InvalidArgument
from pinmobile.loop import Rollout, simulate
from pinmobile.paths import Circle, CubicVia, Hold
from pinmobile.plots.style import format_si, layout_problem
from pinmobile.robot import MobileRobot
from pinmobile.trajectories import FixedHeading, Reference, Tangent, Trajectory
from pinmobile.wheels import Coulomb, WheeledRobot, WheelTable

pytestmark = pytest.mark.once

DRAWN: list[Callable[..., Figure]] = [plots.path, plots.states, plots.errors, plots.forces]
ROBOT = MobileRobot.lecture()
CIRCLE = Tangent(Circle(3, 0.1, 60))
VIA_STOP = Tangent(CubicVia((0, 0), (2, 2), (0, 4), 30, 60, via_velocity=(0, 0)), turn_time=2)


Runs = dict[str, Rollout]


def both(trajectory: Trajectory, dt: float = 0.1, **options: Any) -> Runs:
    controllers = {"PD": PD([120, 120, 0.4], [120, 120, 0.4]), "computed torque": ComputedTorque(ROBOT)}
    return {
        label: simulate(ROBOT, controller, trajectory, dt=dt, **options)  # type: ignore[arg-type]
        for label, controller in controllers.items()
    }


def shortened(run: Rollout, count: int) -> Rollout:
    columns = {name: getattr(run, name)[:count] for name in ("t", "q", "v", "a", "u", "error")}
    return replace(run, reference=Reference(*(part[:count] for part in run.reference)), **columns)


def robots(axes: Axes) -> list[Array]:
    return [
        np.asarray(p.get_xy())[:-1]
        for p in axes.patches
        if isinstance(p, Polygon) and p.get_label() == "robot"
    ]


def corners(pose: Array, length: float, width: float) -> Array:
    """Rear right, front right, front left, rear left: by rotating the body's axes, not the points."""
    forward = 0.5 * length * np.array([np.cos(pose[2]), np.sin(pose[2])])
    left = 0.5 * width * np.array([-np.sin(pose[2]), np.cos(pose[2])])
    offsets: Array = np.array([-forward - left, forward - left, forward + left, -forward + left])
    return pose[:2] + offsets


@pytest.fixture(scope="module")
def circle() -> Runs:
    return both(CIRCLE)


@pytest.fixture(scope="module")
def astray() -> Rollout:
    """Start 2.2 m and 2.5 rad beside the trajectory."""
    robot = MobileRobot(10, 1.2, size=(0.8, 0.3, 0.2))
    return simulate(robot, ComputedTorque(ROBOT), CIRCLE, dt=0.1, q0=(1, -2, 2.5))


# Path


def test_the_box_stands_at_the_actual_pose_not_at_the_desired_one(astray: Rollout) -> None:
    samples = [0, 5, 300]
    (axes,) = plots.path(astray, times=astray.t[samples]).axes
    drawn = robots(axes)
    for box, k in zip(drawn, samples, strict=True):
        np.testing.assert_allclose(box, corners(astray.q[k], 0.8, 0.3), atol=1e-12)
    # The lecture's animation: the desired position with the actual heading.
    mixed = np.append(astray.reference.q[0, :2], astray.q[0, 2])
    assert np.abs(drawn[0] - corners(mixed, 0.8, 0.3)).max() > 1


def test_signs_and_two_decimals_of_ticks_leave_room_for_the_label() -> None:
    arc = Tangent(Circle(1.0, 0.5, 3.0))
    figure = plots.path(simulate(MobileRobot(30, 1.3), PD(300, 150), arc, dt=0.01))
    figure.draw_without_rendering()
    assert "\N{MINUS SIGN}0.25" in [tick.get_text() for tick in figure.axes[0].get_yticklabels()]
    assert layout_problem(figure, figure.axes) == ""


def test_lines_are_the_desired_and_the_travelled_path(circle: Runs) -> None:
    for axes, run in zip(plots.path(circle).axes, circle.values(), strict=True):
        desired, travelled = axes.lines
        np.testing.assert_array_equal(desired.get_xydata(), run.reference.q[:, :2])
        np.testing.assert_array_equal(travelled.get_xydata(), run.q[:, :2])
        assert desired.is_dashed()
        assert travelled.get_linestyle() == "-"
        assert axes.get_aspect() == 1
    assert len({(axes.get_xlim(), axes.get_ylim()) for axes in plots.path(circle).axes}) == 1
    with pytest.raises(InvalidArgument, match=r"^times\[1\] is 61.0 s, expected 0 <= times <= 60 s$"):
        plots.path(circle, times=[0, 61])


def test_times_are_written_where_there_is_room(circle: Runs) -> None:
    for width, least in ((None, 7), (3.5, 3)):
        figure = plots.path(circle, width=width)
        figure.draw_without_rendering()
        for axes in figure.axes:
            texts = [text for text in axes.texts if text.get_text().endswith(" s")]
            boxes = [text.get_window_extent() for text in texts]
            assert least <= len(boxes) <= len(robots(axes))
            assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
            ticks = [tick.get_window_extent() for tick in axes.get_yticklabels()]
            assert not any(a.overlaps(b) for a in boxes for b in ticks)
    assert len(plots.path(circle, times=[0, 1, 2], width=3.5).axes[0].texts) == 4  # those and the label


def test_drawn_robots_do_not_overlap(circle: Runs) -> None:
    for axes in (*plots.path(circle).axes, *plots.path(both(VIA_STOP)).axes):
        centres = [box.mean(axis=0) for box in robots(axes)]
        assert 5 <= len(centres) <= 8
        assert min(np.hypot(*(a - b)) for a, b in combinations(centres, 2)) > np.hypot(0.6, 0.4)


# Series


def test_lines_are_the_recorded_and_the_desired(circle: Runs) -> None:
    runs = [*circle.values()]
    for k in range(3):
        *lines, desired = plots.states(circle).axes[k].lines
        for line, run in zip(lines, runs, strict=True):
            np.testing.assert_array_equal(line.get_xydata(), np.stack([run.t, run.q[:, k]], axis=-1))
        np.testing.assert_array_equal(desired.get_ydata(), runs[0].reference.q[:, k])
        assert desired.is_dashed()
        for axes, run in zip(plots.errors(circle).axes[2 * k : 2 * k + 2], runs, strict=True):
            np.testing.assert_array_equal(axes.lines[0].get_ydata(), run.error[:, k])
        for line, run in zip(plots.forces(circle).axes[k].lines, runs, strict=True):
            np.testing.assert_array_equal(line.get_ydata(), run.u[:, k])
            assert line.get_drawstyle() == "steps-post"
    errors = plots.errors(circle).axes
    assert errors[0].get_title(loc="right") == r"largest $7.48\cdot 10^{-3}$ m"
    assert 0 < np.abs(errors[-1].lines[0].get_ydata()).max() < 1e-13
    assert errors[-1].get_ylim() == (-1e-12, 1e-12)  # rounding is drawn as zero


def test_no_peak_is_lost() -> None:
    t, zero = np.linspace(0, 60, 60_001), np.zeros((60_001, 3))
    run = Rollout(ROBOT, t, zero, zero, zero, zero, zero, Reference(zero, zero, zero))
    tau = np.random.default_rng(0).normal(size=zero.shape)
    tau[41234, 1], tau[41235, 1] = 99, -99
    force = plots.forces(replace(run, u=tau)).axes[1].lines[0]
    x, y = np.asarray(force.get_xdata()), np.asarray(force.get_ydata())
    assert len(y) < 2100
    assert (y.max(), y.min()) == (99, -99)
    assert x[np.argmax(y)] == run.t[41234]
    assert x[-1] == 60


# Figures


def test_one_sample_is_a_dot_that_can_be_seen(astray: Rollout) -> None:
    run = shortened(astray, 1)
    for k, axes in enumerate(plots.forces(run).axes):
        (line,) = axes.lines
        assert np.asarray(line.get_xydata()).tolist() == [[0.0, run.u[0, k]]]
        assert line.get_marker() == "o"  # a line of one point is nothing
        assert axes.get_ylim()[0] < run.u[0, k] < axes.get_ylim()[1]


def test_arms_are_drawn_where_their_frames_are() -> None:
    arm = pm.MobileRobot.box().mount("ur5", at=(0.2, 0.1, 0.3, 0.5))
    robot = pm.WheeledRobot(arm, pm.WheelTable.mecanum(0.4, 0.5, 0.1))
    start = np.array([0.3, -0.2, 0.7, 0.4, -1.2, 1.6, -0.4, 1.57, 0.0])
    still = pm.FixedHeading(pm.Hold([0.3, -0.2], 0.1), 0.7)
    q0 = np.concatenate([start, np.zeros(4)])
    run = pm.simulate(robot, pm.law(lambda t, q, v, r: np.zeros(10)), still, dt=0.01, q0=q0)
    (axes,) = plots.path(run, times=[0.0]).axes
    rows = [np.asarray(line.get_xydata()) for line in axes.lines]
    (drawn,) = [xy for xy in rows if np.isnan(xy).any()]
    joints = "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"
    names = [*(f"{joint}_joint" for joint in joints), "tool0"]
    frames = np.array([arm.frame_pose(start, f"ur5/{name}")[:2, 3] for name in names])
    np.testing.assert_allclose(drawn[1::3], frames, atol=1e-12)
    np.testing.assert_allclose(drawn[3::3], frames[:-1], atol=1e-12)


def test_a_path_needs_a_pose(circle: Runs) -> None:
    run = circle["PD"]
    desired = run.reference._replace(q=run.reference.q[:, :2])
    flat = replace(run, plant=None, q=run.q[:, :2], reference=desired)
    with pytest.raises(InvalidArgument, match=r"^rollouts\['a'\].plant is a NoneType, which has no pose"):
        plots.path({"a": flat})


_BACKEND = """
from matplotlib.backend_bases import FigureManagerBase
from matplotlib.backends.backend_agg import FigureCanvasAgg

class Manager(FigureManagerBase):
    @classmethod
    def pyplot_show(cls, *, block=None):
        from matplotlib._pylab_helpers import Gcf
        print("shown", sorted(Gcf.figs))

class FigureCanvas(FigureCanvasAgg):
    manager_class = Manager
"""


def test_pyplot_and_settings_are_left_alone_and_pyplot_shows_what_comes_back(
    circle: Runs, tmp_path: Path
) -> None:
    before = dict(matplotlib.rcParams)
    for draw in DRAWN:
        draw(circle)
    assert dict(matplotlib.rcParams) == before
    code = (
        "import sys; import pinmobile as pm; from pinmobile import plots\n"
        "run = pm.Rollout.load(sys.argv[1])\n"
        "[f(run)._repr_png_() for f in (plots.path, plots.states, plots.errors, plots.forces)]\n"
        "plots.animate(run, sys.argv[2])\n"
        "print({'matplotlib.pyplot', 'meshcat', 'sympy', 'tkinter'} & set(sys.modules))\n"
        "import matplotlib; matplotlib.use('module://windows'); import matplotlib.pyplot as plt\n"
        "figure = plots.curves({'a': [1, 2]}, x=('x', '', [0, 1]), label='b')\n"
        "assert plt.gcf() is figure; plt.show()\n"
        "plots.animate(run, sys.argv[2]); plt.close(figure); plt.show()\n"
        "matplotlib.use('agg'); plots.curves({'a': [1, 2]}, x=('x', '', [0, 1]), label='b')\n"
        "print(plt.get_fignums())"
    )
    (tmp_path / "windows.py").write_text(_BACKEND)
    shortened(circle["PD"], 2).save(tmp_path / "run.npz")
    command = [sys.executable, "-c", code, str(tmp_path / "run.npz"), str(tmp_path / "robot.gif")]
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("DISPLAY", raising=False)
        patch.delenv("MPLBACKEND", raising=False)
        patch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["set()", "shown [1]", "shown []", "[]"]


@pytest.mark.parametrize(
    ("value", "text"),
    [(0, "0 m"), (2.24, "2.2 m"), (12.34, "12 m"), (0.999, "1.0 m"), (0.37, "370 mm"), (3.49e-5, "35 µm"),
     (9.96e-6, "10 µm"), (3.5e-9, "3.5 nm"), (3.6e-11, "3.6e-11 m"), (3.55e-15, "0 m, within rounding")],
)  # fmt: skip
def test_sizes_are_written_with_two_digits(value: float, text: str) -> None:
    assert format_si(value, "m") == text


def gif(path: Path) -> tuple[list[Image.Image], list[int]]:
    frames, durations = [], []
    with Image.open(path) as image:
        for k in range(getattr(image, "n_frames", 1)):
            image.seek(k)
            durations.append(image.info["duration"])
            frames.append(image.convert("RGB"))
    return frames, durations


# Animate


def test_a_minute_takes_ten_seconds_and_little_room(circle: Runs, tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    fast = plots.animate(shortened(circle["PD"], 31), tmp_path / "fast.gif", speed=2, fps=10)  # 3 s
    assert sum(gif(fast)[1]) == pytest.approx(2500, abs=80)
    path = plots.animate(circle, str(tmp_path / "robot.gif"), progress=lambda *step: told.append(step))
    assert path == tmp_path / "robot.gif"
    assert path.stat().st_size < 400_000
    frames, durations = gif(path)
    assert len(frames) == 126
    assert durations == 125 * [80] + [1000]
    assert told == [(k, 126) for k in range(1, 127)]
    assert frames[0].getpixel((0, 0)) == (255, 255, 255)
    assert 500 < frames[0].width <= 720


def test_the_robot_is_where_it_was_not_where_it_should_be(circle: Runs, tmp_path: Path) -> None:
    run = shortened(circle["PD"], 2)
    q, desired = np.tile([2.0, 1.0, 0.3], (2, 1)), np.tile([-2.0, -1.0, 0.3], (2, 1))
    run = replace(run, q=q, reference=Reference(desired, 0 * q, 0 * q))
    frames, _ = gif(plots.animate(run, tmp_path / "robot.gif"))
    pixels = np.asarray(frames[-1]).astype(int)[: round(0.85 * frames[-1].height)]  # without the legend
    rows, columns = np.nonzero(pixels[..., 2] - pixels[..., 0] > 100)
    assert len(rows) > 50
    assert columns.min() > 0.6 * pixels.shape[1]
    assert rows.max() < 0.5 * pixels.shape[0]


def test_signals_of_several_runs_with_vectors_are_told_apart_and_no_legend_covers_them() -> None:
    table = WheelTable.skid_steer(0.5, 0.4, 0.1, mass=1.0, spin_inertia=0.01, yaw_inertia=0.006)
    push = law(lambda t, q, v, reference: np.array([3.0, 5.0]))
    runs = {
        f"mu {mu}": simulate(
            WheeledRobot(MobileRobot(30.0, 2.3, com=(0.05, 0.02, 0.2)), table, Coulomb(mu)),
            push,
            FixedHeading(Hold((0, 0), 0.1), 0.0),
            dt=0.01,
        )
        for mu in (0.3, 0.8)
    }
    figure = plots.signals(runs, title="")
    assert figure.get_suptitle() == ""
    for axes in figure.axes:
        assert axes.get_legend() is None
        looks = [(line.get_color(), line.get_linestyle()) for line in axes.lines]
        assert len(set(looks)) == len(looks) >= 2
    (legend,) = figure.legends
    texts = [text.get_text() for text in legend.get_texts()]
    assert texts == ["mu 0.3", "mu 0.8", "[0]", "[1]", "[2]", "[3]"]
    assert plots.signals(runs).get_suptitle() == "Signals"


# Balance

BOX = pm.MobileRobot.box()
UR5 = BOX.mount("ur5")


def driven(rate: float) -> pm.Rollout:
    return pm.simulate(
        BOX, pm.ComputedTorque(BOX, 25, 10), pm.Tangent(pm.Circle(1, rate, 2)), dt=0.02, q0=(0, 0.02, 0.1)
    )


def waved() -> pm.Rollout:
    """Return states of a robot with an arm that no controller made."""
    t = np.linspace(0, 1, 30)
    q, v, a = (np.outer(wave, np.linspace(0.1, 1, 9)) for wave in (np.sin(t), np.cos(t), -np.sin(t)))
    return pm.Rollout(UR5, t, q, v, a, 0 * v, 0 * v, pm.Reference(q, v, a))


def test_balance_draws_margin_friction_and_the_zero_moment_point() -> None:
    runs = {"slow": driven(1.0), "fast": driven(5.0)}
    figure = plots.balance(runs)
    margin, friction, ground = figure.axes
    assert [axes.get_ylabel()[-3:] for axes in figure.axes] == ["[m]", "[-]", "[m]"]
    assert (friction.get_xlabel(), ground.get_xlabel()) == ("t [s]", "forward $x_B$ [m]")
    for k, run in enumerate(runs.values()):
        np.testing.assert_array_equal(margin.lines[k].get_ydata(), tip_over_margin(run))
        np.testing.assert_array_equal(friction.lines[k].get_ydata(), required_friction(run))
        path = np.stack(ground.lines[2 * k].get_data(), axis=-1)
        np.testing.assert_array_equal(path, body_zero_moment_point(run))
    # The fast one tips: where that begins is marked.
    assert tip_over_margin(runs["fast"]).min() < 0
    assert np.all(np.asarray(margin.lines[-1].get_ydata()) == 0)
    (outline,) = ground.patches
    np.testing.assert_allclose(np.ptp(outline.get_path().vertices, axis=0), [0.6, 0.4])
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["slow", "fast"]


def test_where_the_ground_does_not_carry_the_robot_there_is_a_gap() -> None:
    run = waved()
    a = run.a.copy()
    a[10:15, 4] = 400.0  # the arm flung down, so that the ground would have to pull
    lifted = replace(run, a=a)
    gaps = ~np.isfinite(tip_over_margin(lifted))
    assert 0 < gaps.sum() <= 5
    figure = plots.balance(lifted)
    for axes in figure.axes[:2]:
        np.testing.assert_array_equal(np.isnan(np.asarray(axes.lines[0].get_ydata(), dtype=float)), gaps)
    (hatched,) = figure.axes[0].patches
    start, stop = hatched.get_extents().transformed(figure.axes[0].transData.inverted()).intervalx
    times = run.t[gaps]
    assert (start, stop) == pytest.approx((times[0], times[-1] + run.t[1]))
    assert "does not carry" in figure.axes[0].get_title()
    assert figure.axes[1].get_xlim() == (run.t[0], run.t[-1])


def test_reaction_draws_six_components_with_their_units() -> None:
    run = waved()
    figure = plots.reaction({"one": run, "other": run})
    assert [axes.get_ylabel() for axes in figure.axes] == [
        *(f"$f_{x}$ [N]" for x in "xyz"),
        *(f"$m_{x}$ [N m]" for x in "xyz"),
    ]
    for axes, column in zip(figure.axes, reaction_wrench(run).T, strict=True):
        np.testing.assert_array_equal(axes.lines[0].get_ydata(), column)
    assert len(figure.legends) == 1
