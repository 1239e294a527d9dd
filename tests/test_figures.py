"""Figures for a paper: at a width, on axes of one's own, in one's own letters and colours, in grey."""

import subprocess
import sys
from importlib import import_module
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cycler import cycler
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.text import Text

from pinmobile import palette, plots
from pinmobile.errors import InvalidArgument
from pinmobile.plots.style import DASHES, line_style, wrap_text

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "docs"))
page: Any = import_module("figures")  # the script that draws them all

pytestmark = pytest.mark.once

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
    with pytest.raises(InvalidArgument, match=r"^width is 1000.0 in, expected 0.5 <= width <= 100 in"):
        plots.states(RUNS, width=1e3)


@pytest.mark.parametrize("name", PANELS)
def test_axes_of_ones_own_are_drawn_on(name: str) -> None:
    figure = Figure(figsize=(5 * PANELS[name], 5))
    own = [*figure.subplots(1, PANELS[name], squeeze=False)[0]]
    assert page.FIGURES[name](ax=own if len(own) > 1 else own[0]) is figure
    assert all(axes.has_data() for axes in own)
    assert [axes for axes in figure.axes if axes.get_label() != "<colorbar>"] == own
    assert not figure.texts  # a heading is the caller's
    with pytest.raises(InvalidArgument, match=rf"^ax is \d+ Axes, expected {len(own)}, one for each panel"):
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
    with pytest.raises(
        InvalidArgument, match=r"^ax is 'axes', expected matplotlib's Axes, a sequence of them"
    ):
        plots.states(RUNS, ax="axes")  # type: ignore[arg-type]
    with pytest.raises(InvalidArgument, match=r"^width is 3, expected None with ax, because its figure"):
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


def test_pyplot_shows_what_comes_back(tmp_path: Path) -> None:
    (tmp_path / "windows.py").write_text(_BACKEND)
    code = (
        "import matplotlib; matplotlib.use('module://windows'); import matplotlib.pyplot as plt\n"
        "from pinmobile import plots\n"
        "figure = plots.curves({'a': [1, 2]}, x=('x', '', [0, 1]), label='b')\n"
        "assert plt.gcf() is figure; plt.show()\n"
        "plots.animate; plt.close(figure); plt.show()\n"
        "matplotlib.use('agg'); plots.curves({'a': [1, 2]}, x=('x', '', [0, 1]), label='b')\n"
        "print(plt.get_fignums())"
    )
    command = [sys.executable, "-c", code]
    environment = {"PYTHONPATH": f"{tmp_path}:{ROOT / 'src'}", "PATH": "", "HOME": str(tmp_path)}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.splitlines() == ["shown [1]", "shown []", "[]"]


def test_a_unit_stays_on_the_line_of_its_bracket_or_number() -> None:
    assert wrap_text("estimate [kg m]", 10, 0.1).split("\n") == ["estimate", "[kg m]"]
    assert wrap_text("99 % stay within 77 mm", 10, 0.1).split("\n") == ["99 %", "stay", "within", "77 mm"]
