"""Figures of ensembles, in words and numbers; figures for a paper: width, axes, letters, colours."""

import sys
from collections.abc import Callable
from importlib import import_module
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cycler import cycler
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.text import Text

import pinmobile as pm
from pinmobile import palette, plots
from pinmobile.errors import InvalidArgument
from pinmobile.loop import Engine, causes, worst_share
from pinmobile.plots.style import DASHES, format_percent, line_style, wrap_text
from tests.refusals import refused

pytestmark = pytest.mark.once

ROBOT = pm.MobileRobot(30, 1.3)
TRUE = pm.ComputedTorque(ROBOT)
SPREAD: dict[str, Any] = {
    "mass": pm.Uniform(24, 36),
    "force.x": pm.Normal(0, 0.04),
    "com.x": pm.Uniform(-0.05, 0.05),
}


Pair = dict[str, pm.Ensemble]


def run(controller: Any, spread: dict[str, Any], n: int = 300, duration: float = 20.0) -> pm.Ensemble:
    circle = pm.Tangent(pm.Circle(3, 0.1, duration))
    wind = [pm.ConstantForce((0, 0, 0))]
    return pm.ensemble(
        ROBOT, controller, circle, n=n, spread=spread, forces=wind, dt=0.1, engine=Engine.COMPILED
    )


@pytest.fixture(scope="module")
def pair() -> Pair:
    return {"PD": run(pm.PD([120, 120, 5.2], [120, 120, 5.2]), SPREAD), "computed torque": run(TRUE, SPREAD)}


@pytest.fixture(scope="module")
def diverging() -> pm.Ensemble:
    """Of these, the lightest fifth and some more diverge: the model is more than five times too heavy."""
    return run(TRUE, {"mass": pm.Uniform(4, 12), "force.x": pm.Normal(0, 0.02)})


def rows(figure: Figure, columns: int) -> list[list[Axes]]:
    return [figure.axes[:columns], figure.axes[columns : 2 * columns]]


def texts(figure: Figure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def top_ticks(axes: Axes, height: float) -> list[str]:
    """Return the labels of the ticks at a height [data] and above."""
    ticks = zip(axes.get_yticks(), axes.get_yticklabels(), strict=True)
    minor = [(tick, "minor") for tick in axes.get_yticks(minor=True)]
    named = [(tick, label.get_text()) for tick, label in ticks]
    return [label for tick, label in (*named, *minor) if tick >= height * (1 - 1e-9)]


def drawn(figure: Figure) -> Any:
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    return canvas.get_renderer()


def apart(figure: Figure) -> None:
    """Fail where texts, legends or axes of a figure overlap."""
    renderer = drawn(figure)
    boxes = [one.get_tightbbox(renderer) for one in (*figure.texts, *figure.legends, *figure.axes)]
    for one, other in combinations(boxes, 2):
        assert one is not None
        assert other is not None
        assert not one.padded(-1.0).overlaps(other.padded(-1.0))


# Bands


def test_lines_are_the_quantiles_and_bands_lie_between_them(pair: Pair) -> None:
    levels = (0.5, 0.9, 0.99)
    for row, attribute in zip(rows(plots.bands(pair), 2), ("distance", "heading"), strict=True):
        for axes, made in zip(row, pair.values(), strict=True):
            bands = made.bands(levels)
            most = [[getattr(made.error_quantile(level), attribute)] for level in levels]
            quantiles = 1e3 * np.minimum(getattr(bands, attribute), most)
            quantiles[quantiles < 1e3 * 2**-34] = 0
            for line, quantile in zip(axes.lines, quantiles, strict=True):
                np.testing.assert_array_equal(line.get_xdata(), bands.t)
                np.testing.assert_allclose(np.asarray(line.get_ydata()), quantile, rtol=1e-12)
            filled = [c for c in axes.collections if isinstance(c, PolyCollection)]
            for band, top in zip(filled, quantiles, strict=True):
                points = np.asarray(band.get_paths()[0].vertices)
                assert points[:, 1].max() == pytest.approx(top.max())


def test_errors_that_differ_by_orders_have_logarithmic_axes(pair: Pair) -> None:
    exact = run(TRUE, {"mass": pm.Uniform(24, 36), "controller.mass": pm.SameAs("mass")}, n=50)
    distance, heading = (row[0] for row in rows(plots.bands({"PD": pair["PD"], "exact": exact}), 2))
    assert distance.get_yscale() == "log"
    assert distance.get_ylabel().endswith("logarithmic")
    medians = [made.bands(0.5).distance.max() * 1e3 for made in (pair["PD"], exact)]
    assert distance.get_ylim()[0] < min(medians)
    assert heading.get_yscale() == "linear"  # rounding is no order of magnitude
    assert not np.asarray(heading.figure.axes[3].lines[0].get_ydata()).any()


def test_words_say_who_stays_within_what(pair: Pair) -> None:
    top, low = rows(plots.bands(pair), 2)
    assert top[0].get_title(loc="left") == "99 % stay within 9.3 mm throughout"
    assert 9.2e-3 < pair["PD"].error_quantile(0.99).distance < 9.3e-3  # a bound is never rounded down
    assert low[0].get_title(loc="left").startswith("99 % stay within ")
    assert [note.get_text() for note in top[1].texts] == ["none of 300 diverged", "computed torque"]
    assert texts(plots.bands(pair)) == ["50 %", "90 %", "99 % of 300 robots"]


def test_a_single_ensemble_and_other_levels(pair: Pair) -> None:
    figure = plots.bands(pair["PD"], levels=(0.999, 0.25))
    assert len(figure.axes) == 2
    assert texts(figure) == ["25 %", "99.9 % of 300 robots"]
    assert plots.bands(pair["PD"], title="Circle").texts[0].get_text() == "Circle"
    one_level = plots.bands({"a": pair["PD"], "b": run(TRUE, SPREAD, n=10)}, levels=0.5)
    assert texts(one_level) == ["50 % of the robots"]


def test_bands_of_diverged_robots_leave_at_the_top(diverging: pm.Ensemble) -> None:
    figure = plots.bands(diverging)
    drawn(figure)
    axes = figure.axes[0]
    count = int(diverging.diverged.sum())
    assert 0 < count < 150
    assert axes.texts[0].get_text() == f"{count} of 300 diverged"
    assert axes.get_title(loc="left") == "99 % stay within no bound"
    median, _, outermost = (np.asarray(line.get_ydata()) for line in axes.lines)
    assert median[-1] < axes.get_ylim()[1] < outermost[-1]
    assert np.isinf(diverging.bands(0.99).distance[0, -1])


GAINS = ("gain", "1/s²", [1, 2.5, 4])
SPEEDS = ("speed", "", ["slow", "fast"])
VALUES = np.array([[1.0, 2.0, 3.0], [1.5, 40.0, np.inf]])


# Heatmap


def test_cells_are_the_values_the_first_at_the_left_and_at_the_bottom() -> None:
    figure = plots.heatmap(VALUES, x=GAINS, y=SPEEDS, label="error [mm]")
    axes, bar = figure.axes
    image = axes.images[0]
    shown: Any = image.get_array()
    np.testing.assert_array_equal(shown.filled(np.inf), VALUES)
    assert image.origin == "lower"
    written = {tuple(map(int, text.get_position())): text.get_text() for text in axes.texts}
    assert written == {(0, 0): "1.00", (1, 0): "2.00", (2, 0): "3.00",
                       (0, 1): "1.50", (1, 1): "40.0", (2, 1): "diverges"}  # fmt: skip
    assert [label.get_text() for label in axes.get_xticklabels()] == ["1", "2.5", "4"]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["slow", "fast"]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("gain [1/s²]", "speed")
    assert bar.get_ylabel() == "error [mm]"
    assert figure.texts[0].get_text() == "error [mm] over gain and speed"


@pytest.mark.parametrize(("largest", "scale"), [(19.0, "linear"), (21.0, "log")])
def test_colours_are_logarithmic_over_orders(largest: float, scale: str) -> None:
    figure = plots.heatmap([[1.0, largest, np.inf]], x=GAINS, y=("one", "", [1]), label="error [m]")
    assert figure.axes[1].get_yscale() == scale


def test_values_that_no_heatmap_shows_are_refused() -> None:
    with refused(r"^values has shape \(3, 2\), expected \(2, 3\): a row for each of y"):
        plots.heatmap(VALUES.T, x=GAINS, y=SPEEDS, label="error [mm]")
    with refused(r"^values\[4\] is 40.0, expected 1 <= values <= 30$"):
        plots.heatmap(VALUES, x=GAINS, y=SPEEDS, label="error [mm]", limits=(1, 30))


# Curves

ROWS: dict[str, Any] = {"pd": [3.0, np.inf, 1.0], "computed torque": [0.5, 0.4, 0.3]}
X = ("gain", "1/s²", [4, 9, 1])


def test_there_is_a_curve_for_each_name_in_the_order_of_the_parameter() -> None:
    figure = plots.curves(ROWS, x=X, label="error [mm]")
    (axes,) = figure.axes
    lines = [line for line in axes.lines if line.get_linestyle() == "-"]
    np.testing.assert_array_equal(lines[0].get_xdata(), [1, 4, 9])
    np.testing.assert_array_equal(lines[0].get_ydata(), [1, 3, np.nan])
    np.testing.assert_array_equal(lines[1].get_ydata(), [0.3, 0.5, 0.4])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("gain [1/s²]", "error [mm]")
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [*ROWS, "diverges"]


@pytest.mark.parametrize("largest", [3.0, 3000.0])
def test_what_diverges_is_a_cross_above_all_numbers_at_its_own_word(largest: float) -> None:
    rows = {**ROWS, "pd": [largest, np.inf, 1.0]}
    (axes,) = plots.curves(rows, x=X, label="error [mm]").axes
    crosses = [line for line in axes.lines if line.get_marker() == "x"]
    (cross,) = (line for line in crosses if len(np.ravel(line.get_xdata())))
    assert list(np.ravel(cross.get_xdata())) == [9]
    height = float(np.ravel(cross.get_ydata())[0])
    assert largest < height < axes.get_ylim()[1]
    assert top_ticks(axes, height) == ["diverges"]
    assert len(axes.get_yticks()) > 3


# Drivers


def test_the_title_names_what_drives_the_worst(pair: Pair) -> None:
    made = pair["computed torque"]
    assert plots.drivers(made).texts[0].get_text() == "mass drives the worst 5 % most, then force.x"
    title = plots.drivers(pair["PD"], share=0.2).texts[0].get_text()
    assert title == "mass drives the worst 20 % most"
    assert plots.drivers(made, title="Circle").texts[0].get_text() == "Circle"


def test_the_most_different_comes_first(pair: Pair) -> None:
    *panels, scatter = plots.drivers(pair["computed torque"]).axes
    assert [axes.get_xlabel() for axes in panels] == ["mass [kg]", "force.x [N]", "com.x [m]"]
    assert scatter.get_xlabel() == "mass [kg]"
    assert scatter.get_ylabel() == "largest distance from the desired position [mm]"
    assert panels[2].get_title(loc="left") == "plays no part"


def test_words_say_where_the_worst_are(pair: Pair) -> None:
    for label, outside in (("computed torque", True), ("PD", False)):
        made = pair[label]
        worst = worst_share(made, 0.1)
        first = causes(made, worst)[0]
        assert (first.name, first.outside, first.visible) == ("mass", outside, True)
        bad, good = (first.holds(made.draws["mass"][chosen]).mean() for chosen in (worst, ~worst))
        assert bad - good == pytest.approx(first.difference, abs=0.1)
        shares = [format_percent(round(float(share), 2)) for share in (bad, good)]
        title = plots.drivers(made, share=0.1).axes[0].get_title(loc="left")
        assert title == f"{first.place}:\n{shares[0]} of the worst, {shares[1]} of the others"
    assert first.place == f"above {first.low:.3g} kg"


def test_all_that_diverged_are_the_worst_if_they_are_more_than_the_share(diverging: pm.Ensemble) -> None:
    count = int(diverging.diverged.sum())
    assert np.array_equal(worst_share(diverging, 0.05), diverging.diverged)
    figure = plots.drivers(diverging)
    assert figure.get_suptitle() == "mass drives those that diverged most"
    assert {f"those that diverged: {count} robots", "where those are"} <= set(texts(figure))
    assert plots.drivers(diverging, share=0.5).get_suptitle().startswith("mass drives the worst 50 %")


def test_diverged_robots_are_crosses_at_their_own_word_above_all(diverging: pm.Ensemble) -> None:
    figure = plots.drivers(diverging)
    assert figure.axes[0].get_title(loc="left").startswith("below ")
    assert texts(figure)[-1] == "diverged"
    axes = figure.axes[-1]
    assert axes.get_yscale() == "log"
    heights = {float(y) for line in axes.lines[2:] for y in np.ravel(line.get_ydata())}
    (height,) = heights
    dots = np.concatenate([np.ravel(line.get_ydata()) for line in axes.lines[:2]])
    assert dots.max() < height < axes.get_ylim()[1]
    assert top_ticks(axes, dots.max() * 1.1) == ["diverged"]
    assert len(axes.get_yticks()) > 2
    apart(figure)


def test_of_a_multiple_the_factor_counts() -> None:
    factor = {"controller.mass": pm.SameAs("mass", pm.Uniform(0.8, 1.2))}
    spread = {"mass": pm.Uniform(20, 40), **factor, "com.x": 0.01}
    made = run(TRUE, spread | {"controller.yaw_inertia": pm.SameAs("yaw_inertia", 1.1)})
    figure = plots.drivers(made)
    assert figure.texts[0].get_text() == "controller.mass / mass drives the worst 5 % most"
    assert [axes.get_xlabel() for axes in figure.axes[:-1]] == ["controller.mass / mass", "mass [kg]"]


def test_what_has_no_drivers_is_refused(pair: Pair) -> None:
    drivers: Any = plots.drivers
    with refused(r"^ensemble is \{.*, expected an Ensemble$"):
        drivers(pair)
    with refused(r"^share is 0.0001, 0 of 300 robots, exp"):
        drivers(pair["PD"], share=1e-4)
    with refused(r"^ensemble has robots with the same parameters"):
        drivers(run(TRUE, {"mass": 31}, n=20))


def figures(pair: Pair) -> list[Callable[[], Figure]]:
    return [
        lambda: plots.bands(pair),
        lambda: plots.drivers(pair["computed torque"]),
        lambda: plots.heatmap(VALUES, x=GAINS, y=SPEEDS, label="error [mm]"),
        lambda: plots.curves(ROWS, x=X, label="error [mm]"),
    ]


def test_nothing_overlaps(pair: Pair) -> None:
    for draw in figures(pair):
        figure = draw()
        apart(figure)
        assert 400 < figure.bbox.width <= 1100


# -- figures for a paper ---------------------------------------------------------------------------


ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "docs"))
page: Any = import_module("figures")  # the script that draws them all


RUNS = page.circle()
PANELS = {
    **{"path": 2, "states": 3, "errors": 6, "forces": 3, "bands": 4, "drivers": 4, "heatmap": 1, "curves": 1},
    **{"integrator": 6, "balance": 3, "reaction": 6, "wheel_torques": 2, "slip": 4, "odometry": 4},
}


def test_every_figure_is_on_the_page() -> None:
    assert {name.partition(" ")[0] for name in page.FIGURES} == set(plots.__all__) - {"animate"}


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in page.FIGURES if f"{name} of an arm" not in page.FIGURES])
def test_at_one_column_of_a_paper_no_word_is_cut_or_meets_another(name: str) -> None:
    with rc_context(page.LETTERS):
        figure = page.FIGURES[name](width=3.5)  # which would be refused
        assert figure.get_figwidth() == 3.5
        assert {text.get_fontsize() for text in figure.findobj(Text) if text.get_text()} >= {8.0}


def test_a_figure_too_narrow_for_its_words_is_refused() -> None:
    words = r"^width is 1.2 in, in which .*: expected a wider figure, or smaller letters, now rcParams\["
    for name in ("path", "curves"):
        with pytest.raises(InvalidArgument, match=words) as told:
            page.FIGURES[name](width=1.2)
        assert "$" not in str(told.value)
    with rc_context({"font.size": 30}), pytest.raises(InvalidArgument, match=r"font.size'\] = 30$"):
        plots.states(RUNS, width=3.5)
    with refused(r"^width is 1000.0 in, expected 0.5 <= width <= 100 in"):
        plots.states(RUNS, width=1e3)


@pytest.mark.parametrize("name", PANELS)
def test_axes_of_ones_own_are_drawn_on(name: str) -> None:
    figure = Figure(figsize=(5 * PANELS[name], 5))
    own = [*figure.subplots(1, PANELS[name], squeeze=False)[0]]
    assert page.FIGURES[name](ax=own if len(own) > 1 else own[0]) is figure
    assert all(axes.has_data() for axes in own)
    assert [axes for axes in figure.axes if axes.get_label() != "<colorbar>"] == own
    assert not figure.texts  # a heading is the caller's
    with refused(rf"^ax is \d+ Axes, expected {len(own)}, one for each panel"):
        page.FIGURES[name](ax=[*own, own[0]])


def test_a_part_of_a_figure_is_filled() -> None:
    figure = Figure(layout="constrained")
    left, right = np.ravel(np.asarray(figure.subfigures(1, 2), object))
    assert plots.states(RUNS, ax=left) is figure
    assert plots.forces(RUNS, ax=right, title="Forces") is figure
    assert (len(left.axes), len(right.axes)) == (3, 3)
    assert right.get_suptitle() == "Forces"
    whole = Figure()
    assert plots.curves({"a": [1, 2]}, x=("x", "", [0, 1]), label="b", ax=whole) is whole
    assert whole.get_layout_engine() is not None  # so that words have room
    assert len(whole.axes) == 1


def test_other_things_than_axes_are_refused() -> None:
    with refused(r"^ax is 'axes', expected matplotlib's Axes, a sequence of them"):
        plots.states(RUNS, ax="axes")  # type: ignore[arg-type]
    with refused(r"^width is 3, expected None with ax, because its figure"):
        plots.states(RUNS, ax=Figure(), width=3)


def test_letters_sizes_and_cycles_are_the_users() -> None:
    own: dict[Any, Any] = {
        "font.size": 7.0,
        "figure.figsize": (5.0, 2.0),
        "lines.linewidth": 0.5,
        "text.color": "#112233",
    }
    cycle = cycler(color=["#ff0000", "#00ff00"]) + cycler(linestyle=[":", "-."])
    with rc_context(own | {"axes.prop_cycle": cycle}):
        figure = plots.states(RUNS)
        first, second, wanted = figure.axes[0].lines
        assert figure.get_figwidth() == 5.0
        assert figure.axes[0].yaxis.label.get_fontsize() == 7.0
        assert [str(line.get_color()).upper() for line in (first, second)] == ["#FF0000", "#00FF00"]
        assert [line.get_linestyle() for line in (first, second)] == [":", "-."]
        assert wanted.get_color() == "#112233"
        assert first.get_linewidth() < 2 * 0.5 * 1.5
    before = plots.states(RUNS)
    assert before.get_figwidth() == 9.0
    assert before.axes[0].lines[0].get_color() == palette.colour(0)


def lightness(colour: str) -> float:
    """Return CIE L*."""
    rgb = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return float(116 * np.cbrt(linear @ (0.2126, 0.7152, 0.0722)) - 16)


def test_colours_and_dashes_differ_in_grey() -> None:
    # A step of 5 in L* is seen side by side; lines apart want more.
    for colours in ([palette.colour(k) for k in range(6)], palette.AXES, (palette.GRIPS, palette.SLIDES)):
        assert min(abs(lightness(a) - lightness(b)) for a, b in combinations(colours, 2)) > 7
        assert max(map(lightness, colours)) < 80  # to be seen on white
    assert len(set(map(str, DASHES))) == len(DASHES) == 6
    styles = [line_style(k, 6) for k in range(6)]
    assert len({str(style["linestyle"]) for style in styles}) == 6


def test_a_unit_stays_on_the_line_of_its_bracket_or_number() -> None:
    assert wrap_text("estimate [kg m]", 10, 0.1).split("\n") == ["estimate", "[kg m]"]
    assert wrap_text("99 % stay within 77 mm", 10, 0.1).split("\n") == ["99 %", "stay", "within", "77 mm"]
