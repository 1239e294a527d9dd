"""What a rollout recorded, over time: states, errors, inputs, signals, and what the base feels."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from pinmobile.arrays import Array, ArrayLike
from pinmobile.balance import (
    body_zero_moment_point,
    footprint_of,
    reaction_wrench,
    required_friction,
    tip_over_margin,
)
from pinmobile.errors import InvalidArgument
from pinmobile.loop import Rollout
from pinmobile.plant import Plant, configuration_names_of, coordinates_of
from pinmobile.plots.sheet import Canvas, Sheet, Spot, letters, over_titles, wrapped
from pinmobile.plots.style import (
    TALL,
    Rollouts,
    Style,
    colour,
    desired,
    dress,
    heading,
    ink,
    keys_of,
    labelled,
    laid_out,
    line_style,
    same_references,
    shortened,
    stacked,
    thinned,
    titled,
    with_method,
)

_SYMBOLS = {
    **{"x": "$x$", "y": "$y$", "psi": r"$\psi$"},
    **{"Fx": "$F_x$", "Fy": "$F_y$", "Mz": "$M_z$"},
}
_ROUNDING = 1e-12  # what is smaller is drawn and told as the rounding that it is


def states(
    rollouts: Rollouts, *, title: str | None = None, ax: Canvas | None = None, width: float | None = None
) -> Figure:
    """Draw x, y and psi over time, desired and actual; of arms each joint too.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        All are drawn in the same axes.
    title : str, optional
        Heading of the figure.
    ax : Axes, sequence of Axes, Figure or SubFigure, optional
        Where it is drawn: axes, one for each panel, or a figure that is filled; by default a new figure.
    width : float, optional
        Of a new figure [in]; by default that of ``rcParams["figure.figsize"]`` if you have set it, else what
        suits the panels. Its height follows, and its letters are those of ``rcParams``.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts`, `ax` or `width` is something else, or the figure too small for the labels.
    """
    runs = labelled(rollouts)
    names = _names((run.plant, _named(run.plant, run.q.shape[1])) for run in runs.values())
    sheet = Sheet(ax, width, _wide(len(names)))
    panels = laid_out(sheet, names)
    for index, (label, run) in enumerate(runs.items()):
        draw(panels, run.t, run.q, label=label or "actual", **line_style(index, len(runs)))
    for labels in same_references(runs).values():
        run = runs[labels[0]]
        draw(panels, run.t, run.reference.q, label="desired", **desired())
    keys = [Line2D([], [], label="desired", **desired()), *keys_of(runs, "actual")]
    return sheet.finish(title, "Desired and actual pose", keys)


def errors(
    rollouts: Rollouts, *, title: str | None = None, ax: Canvas | None = None, width: float | None = None
) -> Figure:
    """Draw the errors of x, y and psi, and of joints, over time, desired minus actual, on the circle.

    Controllers differ by orders of magnitude, so each rollout has a column with its own scale; above each
    panel stands the largest |error|.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Each gets a column.
    title : str, optional
        Heading of the figure.
    ax, width
        As in `states`.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts`, `ax` or `width` is something else, or the figure too small for the labels.
    """
    runs = labelled(rollouts)
    names = _names((run.plant, run.labels) for run in runs.values())
    note = "; each panel has its own scale" if len(runs) > 1 else ""
    if len(names) > TALL:
        sheet = Sheet(ax, width, max(9.0, 4.2 * len(runs)))
        grid = titled(sheet, names, len(runs), height=1.2)
    else:
        sheet = Sheet(ax, width, max(9.0, 3.2 * len(runs)))
        grid = stacked(sheet, [(f"error in {symbol}", unit) for symbol, unit in names], len(runs))
    for index, (label, run) in enumerate(runs.items()):
        column = grid[:, index]
        style = line_style(0, 1) | {"color": colour(index)}
        draw(column, run.t, run.error, label=label, **style)
        room = sheet.room(len(runs)) / (1 + (len(names) > TALL))
        for axes, (_, unit), values in zip(column, names, run.error.T, strict=False):
            largest = f"largest {_power(float(np.abs(values).max()))} {unit}"
            axes.set_title(wrapped(largest, letters(0.95), room), fontsize=letters(0.95), loc="right")
        over_titles(column[0], shortened(sheet, label, len(runs)), **heading(index))
    return sheet.finish(title, f"Error: desired minus actual{note}")


def forces(
    rollouts: Rollouts, *, title: str | None = None, ax: Canvas | None = None, width: float | None = None
) -> Figure:
    """Draw the plant's inputs over time, forces and torques, held from one sample to the next.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        All are drawn in the same axes.
    title : str, optional
        Heading of the figure.
    ax, width
        As in `states`.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts`, `ax` or `width` is something else, or the figure too small for the labels.
    """
    runs = labelled(rollouts)
    names = _names((run.plant, [(one.name, one.unit) for one in run.inputs]) for run in runs.values())
    sheet = Sheet(ax, width, _wide(len(names)))
    panels = laid_out(sheet, names)
    for index, (label, run) in enumerate(runs.items()):
        draw(panels, run.t, run.u, label=label, drawstyle="steps-post", **line_style(index, len(runs)))
    return sheet.finish(title, "Input, held from one sample to the next", keys_of(runs))


def signals(
    rollouts: Rollouts, *, title: str | None = None, ax: Canvas | None = None, width: float | None = None
) -> Figure:
    """Draw the signals that the parts of the loop gave, each with its unit.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        All are drawn in the same axes; each signal of any has a panel.
    title : str, optional
        Heading of the figure.
    ax, width
        As in `states`.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else, or has no signals.
    """
    runs = labelled(rollouts)
    units = {name: unit for run in runs.values() for name, (unit, _) in run.signals.items()}
    if not units:
        raise InvalidArgument("rollouts have no signals, expected at least one: see Rollout.signals")
    names = [(_symbol(name), unit) for name, unit in units.items()]
    sheet = Sheet(ax, width, _wide(len(names)))
    panels = laid_out(sheet, names)
    sizes = [values[0].size for run in runs.values() for _, values in run.signals.values()]
    most = max(sizes)

    def style(index: int, k: int, count: int) -> Style:
        """Dashes tell runs apart, and where a signal has several entries colours tell these."""
        if most == 1:
            return line_style(index, len(runs))
        return {**line_style(index, len(runs)), "color": colour(k) if count > 1 else ink()}

    for axes, name in zip(panels, units, strict=True):
        for index, run in enumerate(runs.values()):
            if name in run.signals:
                values = run.signals[name].values.reshape(len(run), -1)
                for k, column in enumerate(values.T):
                    draw([axes], run.t, column[:, None], **style(index, k, values.shape[1]))
    keys = [
        Line2D([], [], label=label, **style(index, 0, 1)) for index, label in enumerate(runs) if len(runs) > 1
    ]
    if most > 1:
        keys += [Line2D([], [], label=f"[{k}]", color=colour(k), linewidth=3.0) for k in range(most)]
    return sheet.finish(title, "Signals", keys)


def _wide(count: int) -> float:
    """Return the natural width of a figure with so many coordinates [in]."""
    return 9.0 if count <= TALL else 12.0


def _names(named: Iterable[tuple[object, Sequence[tuple[str, str]]]]) -> list[tuple[str, str]]:
    """Return symbol and unit for each panel: those of the first of the plants with the most columns."""
    plant, pairs = max(named, key=lambda one: len(one[1]))
    single = len(getattr(plant, "mounts", ())) == 1
    return [(_symbol(name.partition("/")[2] or name if single else name), unit) for name, unit in pairs]


def _symbol(name: str) -> str:
    """Return how a name is written beside axes."""
    short = name.removesuffix("_joint").replace("_", " ").replace("$", r"\$")
    return _SYMBOLS.get(name, short)


def _named(plant: Plant | None, count: int) -> list[tuple[str, str]]:
    """Return name and unit of each number of q."""
    coordinates = coordinates_of(plant)
    if len(coordinates) == count:
        return [(one.name, one.unit) for one in coordinates]
    units = {one.name: one.unit for one in coordinates}
    names = configuration_names_of(plant) or [f"[{k}]" for k in range(count)]
    return [(name, units.get(name, "")) for name in names]


def draw(column: Iterable[Axes], t: Array, values: Array, **style: Any) -> None:
    """Draw each coordinate, shape (N,) of values (N, n), in its axes."""
    for axes, line in zip(column, values.T, strict=False):
        kept = thinned(line)
        axes.plot(t[kept], line[kept], **{"marker": "o" if len(line) == 1 else ""} | style)
        if np.abs(axes.dataLim.intervaly).max() < _ROUNDING:
            axes.set_ylim(-_ROUNDING, _ROUNDING)


def _power(value: float) -> str:
    if value == 0 or 0.01 <= value < 1000:
        return f"{value:.3g}"
    if value < _ROUNDING:
        return r"$< 10^{-12}$"
    mantissa, exponent = f"{value:.2e}".split("e")
    return rf"${mantissa}\cdot 10^{{{int(exponent)}}}$"


_WRENCH = (
    ("$f_x$", "N"),
    ("$f_y$", "N"),
    ("$f_z$", "N"),
    ("$m_x$", "N m"),
    ("$m_y$", "N m"),
    ("$m_z$", "N m"),
)
_GROUNDED = "MobileRobot", "ground_wrench(q, v, a)"  # of `with_method`
_OUTLINE: Style = {
    "closed": True,
    "facecolor": "#f2f2f2",
    "edgecolor": "#777777",
    "linewidth": 1.4,
    "zorder": 1,
}
_LIMIT: Style = {"color": "#777777", "linestyle": (0, (4, 3)), "linewidth": 1.2, "zorder": 2}


def balance(
    rollouts: Rollouts,
    *,
    footprint: ArrayLike | None = None,
    title: str | None = None,
    ax: Canvas | None = None,
    width: float | None = None,
) -> Figure:
    """Draw tip-over margin and required friction over time, and the zero-moment point on the footprint.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        All are drawn in the same axes.
    footprint : array_like, shape (k, 2), optional
        As in `tip_over_margin`; by default each robot's own.
    title : str, optional
        Heading of the figure.
    ax, width
        As in `states`.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else, not of a `MobileRobot`, or `footprint` is no convex polygon.
    """
    runs = with_method(rollouts, *_GROUNDED)
    sheet = Sheet(ax, width, 11.0)
    spots: list[Spot] = [(0, 0), (1, 0), (slice(0, 2), 1)]
    if sheet.columns(2, 3.2) == 1:
        above, below, beside = sheet.axes([(0, 0), (1, 0), (2, slice(0, 1))], [2.2, 2.2, 4.4])
    else:
        above, below, beside = sheet.axes(spots, [2.1, 2.1], ratios=(1.25, 1))
    for axes, name in ((above, "tip-over margin [m]"), (below, "required friction [-]")):
        dress(axes)
        axes.set_ylabel(name)
    below.set_xlabel("t [s]")
    for index, (label, run) in enumerate(runs.items()):
        style = line_style(index, len(runs)) | {"label": label}
        margin = tip_over_margin(run, footprint)
        _line(above, run.t, margin, **style)
        _line(below, run.t, required_friction(run), **style)
        _mark_lift_off(sheet, (above, below), run.t, np.isneginf(margin), colour(index))
    span = [float(f([f(run.t) for run in runs.values()])) for f in (np.min, np.max)]
    if span[0] < span[1]:
        below.set_xlim(*span)
    if above.dataLim.y0 <= 0:
        above.axhline(0, **_LIMIT)
    below.set_ylim(bottom=min(0.0, below.get_ylim()[0]))
    _from_above(sheet, beside, runs, footprint)
    return sheet.finish(title, "Balance on the ground", keys_of(runs))


def reaction(
    rollouts: Rollouts,
    *,
    mount: str | None = None,
    title: str | None = None,
    ax: Canvas | None = None,
    width: float | None = None,
) -> Figure:
    """Draw the force and the moment that an arm exerts on the base over time, along the body's axes.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        All are drawn in the same axes.
    mount : str, optional
        As in `reaction_wrench`.
    title : str, optional
        Heading of the figure.
    ax, width
        As in `states`.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else, or not of a `MobileRobot` with an arm.
    UnknownName
        If nothing is mounted by that name.
    """
    runs = with_method(rollouts, *_GROUNDED)
    sheet = Sheet(ax, width, 9.0)
    grid = stacked(sheet, _WRENCH)
    for index, (label, run) in enumerate(runs.items()):
        style = line_style(index, len(runs))
        draw(grid[:, 0], run.t, reaction_wrench(run, mount), label=label, **style)
    return sheet.finish(title, "Force and moment of the arm on the base, at its mount", keys_of(runs))


def _line(axes: Axes, t: Array, values: Array, **style: Any) -> None:
    """Draw what is finite; where the ground does not carry the robot, there is a gap."""
    finite = np.where(np.isfinite(values), values, np.nan)
    kept = thinned(np.nan_to_num(finite))
    axes.plot(t[kept], finite[kept], **{"marker": "o" if len(t) == 1 else ""} | style)
    axes.margins(x=0.01, y=0.1)


def _mark_lift_off(
    sheet: Sheet, panels: tuple[Axes, ...], t: Array, lifted: NDArray[np.bool_], paint: str
) -> None:
    """Hatch the times at which the ground would have to pull, where there is nothing to draw."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], lifted, [False]]).astype(int)))
    for start, stop in edges.reshape(-1, 2):
        for axes in panels:
            until = t[min(stop, len(t) - 1)]
            axes.axvspan(
                t[start], until, facecolor="none", edgecolor=paint, hatch="///", linewidth=0, alpha=0.5
            )
    if lifted.any():
        words = "hatched: the ground does not carry the robot"
        panels[0].set_title(_note(sheet, words), fontsize=letters(0.95))


def _note(sheet: Sheet, words: str) -> str:
    return wrapped(words, letters(0.95), sheet.room(sheet.columns(2, 3.2)))


def _from_above(sheet: Sheet, axes: Axes, runs: dict[str, Rollout], footprint: ArrayLike | None) -> None:
    """Draw the footprint and the zero-moment point in the body's frame."""
    dress(axes)
    outlines = {
        corners.tobytes(): corners
        for corners in (footprint_of(run.plant, footprint) for run in runs.values())
    }
    for corners in outlines.values():
        axes.add_patch(Polygon(corners, label="footprint", **_OUTLINE))
    for index, run in enumerate(runs.values()):
        point = body_zero_moment_point(run)
        kept = thinned(*np.nan_to_num(point).T)
        style = line_style(index, len(runs))
        axes.plot(*point[kept].T, **style)
        carried = np.flatnonzero(np.isfinite(point[:, 0]))[:1]
        axes.plot(
            *point[carried].T, "o", color=colour(index), markersize=8, markeredgecolor="white", zorder=5
        )
    axes.autoscale_view()
    axes.margins(0.08)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("forward $x_B$ [m]")
    axes.set_ylabel("left $y_B$ [m]")
    axes.set_title(_note(sheet, "zero-moment point in the footprint, dot: first"), fontsize=letters(0.95))
