"""What a rollout recorded, over time: states, errors, inputs and signals."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.palette import colour
from pinmobile.plant import all_samples, configuration_names_of, coordinates_of, leading_of
from pinmobile.plots.style import (
    DESIRED,
    TALL,
    Rollouts,
    headed,
    heading,
    labelled,
    laid_out,
    legend,
    line_style,
    same_references,
    stacked,
    thinned,
    titled,
)
from pinmobile.simulation import Rollout

_SYMBOLS = {
    **{"x": "$x$", "y": "$y$", "psi": r"$\psi$"},
    **{"Fx": "$F_x$", "Fy": "$F_y$", "Mz": "$M_z$"},
}
_ROUNDING = 1e-12  # what is smaller is drawn as the zero that it is


def states(rollouts: Rollouts, *, title: str | None = None) -> Figure:
    """Draw x, y and psi over time, desired and actual; of arms each joint too.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        All are drawn in the same axes.
    title : str, optional
        Heading of the figure.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else.
    """
    runs = labelled(rollouts)
    drawn = {label: _displacement(run, run.q) for label, run in runs.items()}
    names = _names((runs[label].plant, _named(runs[label].plant, x.shape[1])) for label, x in drawn.items())
    figure, panels = laid_out(names, headed(title, "Desired and actual pose"))
    for index, (label, run) in enumerate(runs.items()):
        draw(panels, run.t, drawn[label], label=label or "actual", **line_style(index, len(runs)))
    for labels in same_references(runs).values():
        run = runs[labels[0]]
        draw(panels, run.t, _displacement(run, run.reference.q), label="desired", **DESIRED)
    legend(figure, [Line2D([], [], label="desired", **DESIRED), *panels[0].lines[: len(runs)]])
    return figure


def errors(rollouts: Rollouts, *, title: str | None = None) -> Figure:
    """Draw the errors of x, y and psi, and of joints, over time, desired minus actual, on the circle.

    Controllers differ by orders of magnitude, so each rollout has a column with its own scale; above each
    panel stands the largest |error|.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Each gets a column.
    title : str, optional
        Heading of the figure.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else.
    """
    runs = labelled(rollouts)
    names = _names((run.plant, run.labels) for run in runs.values())
    note = "; each panel has its own scale" if len(runs) > 1 else ""
    heads = headed(title, f"Error: desired minus actual{note}")
    if len(names) > TALL:
        figure, grid = titled(names, len(runs), heads, height=1.2)
    else:
        figure, grid = stacked([(f"error in {symbol}", unit) for symbol, unit in names], len(runs), heads)
    for index, (label, run) in enumerate(runs.items()):
        column = grid[:, index]
        draw(column, run.t, run.error, label=label, color=colour(index), linewidth=1.8, zorder=3)
        for axes, (_, unit), values in zip(column, names, run.error.T, strict=False):
            axes.set_title(f"largest {_power(float(np.abs(values).max()))} {unit}", fontsize=11, loc="right")
        column[0].annotate(label, (0, 1), (0, 44 if len(names) > TALL else 26), **heading(index))
    return figure


def forces(rollouts: Rollouts, *, title: str | None = None) -> Figure:
    """Draw the plant's inputs over time, forces and torques, held from one sample to the next.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        All are drawn in the same axes.
    title : str, optional
        Heading of the figure.

    Returns
    -------
    figure : matplotlib.figure.Figure

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else.
    """
    runs = labelled(rollouts)
    names = _names((run.plant, [(one.name, one.unit) for one in run.inputs]) for run in runs.values())
    figure, panels = laid_out(names, headed(title, "Input, held from one sample to the next"))
    for index, (label, run) in enumerate(runs.items()):
        draw(panels, run.t, run.u, label=label, drawstyle="steps-post", **line_style(index, len(runs)))
    if len(runs) > 1:
        legend(figure, panels[0].lines)
    return figure


def signals(rollouts: Rollouts, *, title: str | None = None) -> Figure:
    """Draw the signals that the parts of the loop gave, each with its unit.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        All are drawn in the same axes; each signal of any has a panel.
    title : str, optional
        Heading of the figure.

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
    figure, panels = laid_out(names, headed(title, "Signals"))
    for axes, name in zip(panels, units, strict=True):
        for index, (label, run) in enumerate(runs.items()):
            if name not in run.signals:
                continue
            values = run.signals[name].values.reshape(len(run), -1)
            many = values.shape[1] > 1
            for k, column in enumerate(values.T):
                style = (
                    line_style(k, values.shape[1])
                    if many and len(runs) == 1
                    else line_style(index, len(runs))
                )
                draw(
                    [axes], run.t, column[:, None], label=f"{label} [{k}]".strip() if many else label, **style
                )
        if any(run.signals[name].values.ndim > 1 for run in runs.values() if name in run.signals):
            axes.legend(fontsize=9)
    if len(runs) > 1:
        legend(
            figure, [Line2D([], [], label=label, **line_style(k, len(runs))) for k, label in enumerate(runs)]
        )
    return figure


def _names(named: Iterable[tuple[Any, Sequence[tuple[str, str]]]]) -> list[tuple[str, str]]:
    """Return symbol and unit for each panel: those of the first of the plants with the most columns."""
    plant, pairs = max(named, key=lambda one: len(one[1]))
    single = len(getattr(plant, "mounts", ())) == 1
    return [(_symbol(name.partition("/")[2] or name if single else name), unit) for name, unit in pairs]


def _symbol(name: str) -> str:
    """Return how a name is written beside axes."""
    short = name.removesuffix("_joint").replace("_joint:", ":").replace("_", " ").replace("$", r"\$")
    return _SYMBOLS.get(name, short)


def _named(plant: Any, count: int) -> list[tuple[str, str]]:
    """Return name and unit of each number of what `_displacement` returns."""
    coordinates = coordinates_of(plant)
    if len(coordinates) == count:
        return [(one.name, one.unit) for one in coordinates]
    units = {one.name: one.unit for one in coordinates}
    names = configuration_names_of(plant) or [f"[{k}]" for k in range(count)]
    return [(name, units.get(name, "")) for name in names]


def _displacement(run: Rollout, q: Array) -> Array:
    """Return x, y, psi and the arms' angles and ways, shape (N, n), of configurations, shape (N, m).

    Angles of joints that are (cos, sin) in q are unwrapped; a configuration of a plant that has no neutral
    one to compare with is as it is.
    """
    plant = run.plant
    if getattr(plant, "nq", 0) == getattr(plant, "nv", 0) or not hasattr(plant, "neutral"):
        return q
    length = q.shape[1]
    whole = np.hstack([q, np.broadcast_to(plant.neutral[length:], (len(q), plant.nq - length))])
    angles = all_samples(plant, "difference", np.broadcast_to(plant.neutral, whole.shape), whole)
    unwrapped = np.where(_wrapped(plant), np.unwrap(angles, axis=0), angles)
    leading = {numbers: n for n, numbers in leading_of(plant).items()}
    # psi, and what adds, is unwrapped in q already.
    names = {name: k for k, name in enumerate(configuration_names_of(plant))}
    for k, one in enumerate(plant.coordinates):
        if one.name in names:
            unwrapped[:, k] = whole[:, names[one.name]]
    return unwrapped[:, : leading[length]]


def _wrapped(plant: Any) -> Any:
    return np.array([one.unit == "rad" for one in coordinates_of(plant)])


def draw(column: Iterable[Axes], t: Array, values: Array, **style: Any) -> None:
    """Draw each coordinate, shape (N,) of values (N, n), in its axes."""
    for axes, line in zip(column, values.T, strict=False):
        kept = thinned(line)
        axes.plot(t[kept], line[kept], marker="o" if len(line) == 1 else "", **style)
        if np.abs(axes.dataLim.intervaly).max() < _ROUNDING:
            axes.set_ylim(-_ROUNDING, _ROUNDING)


def _power(value: float) -> str:
    if value == 0 or 0.01 <= value < 1000:
        return f"{value:.3g}"
    mantissa, exponent = f"{value:.2e}".split("e")
    return rf"${mantissa}\cdot 10^{{{int(exponent)}}}$"
