"""Figures of what the base feels: what is drawn is what is computed."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import pinmobile as pm
from pinmobile import plots
from pinmobile.balance import body_zero_moment_point, reaction_wrench, required_friction, tip_over_margin
from pinmobile.errors import UnknownName

pytestmark = pytest.mark.once

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


def drawn(figure: Figure) -> None:
    FigureCanvasAgg(figure).draw()  # type: ignore[no-untyped-call]  # matplotlib's own


def test_balance_draws_margin_friction_and_the_zero_moment_point() -> None:
    runs = {"slow": driven(1.0), "fast": driven(5.0)}
    figure = plots.balance(runs)
    drawn(figure)
    margin, friction, ground = figure.axes
    assert [axes.get_ylabel() for axes in figure.axes] == [
        "tip-over margin [m]",
        "required friction [-]",
        "left $y_B$ [m]",
    ]
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


def test_a_footprint_of_ones_own_is_drawn_and_counts() -> None:
    run, triangle = driven(1.0), [(-0.3, -0.2), (0.4, 0), (-0.3, 0.2)]
    figure = plots.balance(run, footprint=triangle)
    np.testing.assert_array_equal(figure.axes[0].lines[0].get_ydata(), tip_over_margin(run, triangle))
    assert not figure.legends
    with pytest.raises(pm.InvalidArgument, match="footprint has shape"):
        plots.balance(run, footprint=[(0, 0)])


def test_where_the_ground_does_not_carry_the_robot_there_is_a_gap() -> None:
    run = waved()
    a = run.a.copy()
    a[10:15, 4] = 400.0  # the arm flung down, so that the ground would have to pull
    lifted = replace(run, a=a)
    gaps = ~np.isfinite(tip_over_margin(lifted))
    assert 0 < gaps.sum() <= 5
    figure = plots.balance(lifted)
    drawn(figure)
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
    drawn(figure)
    assert [axes.get_ylabel() for axes in figure.axes] == [
        *(f"$f_{x}$ [N]" for x in "xyz"),
        *(f"$m_{x}$ [N m]" for x in "xyz"),
    ]
    for axes, column in zip(figure.axes, reaction_wrench(run).T, strict=True):
        np.testing.assert_array_equal(axes.lines[0].get_ydata(), column)
    assert len(figure.legends) == 1


@pytest.mark.parametrize("draw", [plots.balance, plots.reaction])
def test_what_is_no_rollout_of_a_robot_is_refused(draw: Any) -> None:
    with pytest.raises(pm.InvalidArgument, match="rollouts is 3, expected a Rollout"):
        draw(3)
    with pytest.raises(pm.InvalidArgument, match=r"rollouts\['a'\].plant is None, expected a MobileRobot"):
        draw({"a": replace(driven(1.0), plant=None)})


def test_a_reaction_needs_an_arm_of_that_name() -> None:
    with pytest.raises(pm.InvalidArgument, match="robot carries no arm"):
        plots.reaction(driven(1.0))
    with pytest.raises(UnknownName, match="unknown mount 'arm', available: ur5"):
        plots.reaction(waved(), mount="arm")
