"""What a rollout recorded, over time: states, errors and forces."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pinmobile.arrays import Array
from pinmobile.plots.layout import TALL, laid_out, stacked, titled
from pinmobile.plots.runs import Rollouts, labelled, same_references, thinned
from pinmobile.plots.style import DESIRED, colour, headed, heading, legend, line_style
from pinmobile.robot import MobileRobot
from pinmobile.simulation import Rollout

__all__ = ["draw", "errors", "forces", "states"]

_POSE = (("$x$", "m"), ("$y$", "m"), (r"$\psi$", "rad"))
_FORCE = (("$F_x$", "N"), ("$F_y$", "N"), ("$M_z$", "N m"))
_NEWTON = {"m": "N", "rad": "N m"}
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
    names = _names(_POSE, runs, drawn.values(), "q")
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
    names = _names(_POSE, runs, [run.error for run in runs.values()], "q")
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
    """Draw the generalised force over time, held from one sample to the next.

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
    # Only a force that belongs to v is Fx, Fy, Mz: other plants' inputs are their own.
    generalised = all(run.tau.shape == run.v.shape for run in runs.values())
    symbols = _FORCE if generalised else ()
    names = _names(symbols, runs, [run.tau for run in runs.values()], "u", force=True)
    figure, panels = laid_out(names, headed(title, "Force, held from one sample to the next"))
    for index, (label, run) in enumerate(runs.items()):
        draw(panels, run.t, run.tau, label=label, drawstyle="steps-post", **line_style(index, len(runs)))
    if len(runs) > 1:
        legend(figure, panels[0].lines)
    return figure


def _names(
    known: Sequence[tuple[str, str]],
    runs: Mapping[str, Rollout],
    arrays: Iterable[Array],
    letter: str,
    *,
    force: bool = False,
) -> list[tuple[str, str]]:
    """Return symbol and unit for the columns of the widest array; other units are unknown."""
    count = max(array.shape[1] for array in arrays)
    names = [*known[:count], *((f"${letter}_{{{k}}}$", "") for k in range(len(known), count))]
    robot = next((run.robot for run in runs.values() if run.error.shape[1] == count), None)
    if not known or not isinstance(robot, MobileRobot) or robot.nv != count:
        return names
    single = len(robot.mounts) == 1
    for k in range(len(known), count):
        name, unit = robot.coordinate_names[k], robot.coordinate_units[k]
        short = name.partition("/")[2] if single else name
        short = short.removesuffix("_joint").replace("_joint:", ":").replace("_", " ").replace("$", r"\$")
        names[k] = short, _NEWTON[unit] if force else unit
    return names


def _displacement(run: Rollout, q: Array) -> Array:
    """Return x, y, psi and the arms' angles and ways, shape (N, nv), of configurations, shape (N, nq).

    Angles of joints that are (cos, sin) in q are unwrapped; a configuration of an unknown robot is as it is.
    """
    robot = run.robot
    if not isinstance(robot, MobileRobot) or robot.nq == robot.nv:
        return q
    angles = robot.difference(robot.neutral, q)
    return np.hstack([q[:, :3], np.unwrap(angles[:, 3:], axis=0)])


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
