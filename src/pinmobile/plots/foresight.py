"""What was measured of a robot beside what its identified model foretells."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from pinmobile.arrays import Array, positive, sequence
from pinmobile.errors import InvalidArgument, shown
from pinmobile.identification import Prediction
from pinmobile.palette import INK, colour
from pinmobile.plots.style import ShownFigure, Style, dress, headed, legend, tint

_WIDTH, _HEIGHT = 10.0, 6.4  # [in]
_NAMES = (("x", "m", 1e3, "mm"), ("y", "m", 1e3, "mm"), ("$\\psi$", "rad", 1e3, "mrad"))
_MEASURED: Style = {"color": "#9a9a9a", "linewidth": 3.2, "solid_capstyle": "round"}
_DEVIATIONS = 2.0  # of the noise, within which 95 of 100 differences lie
_MOST = 4000  # points of a line


def prediction(
    foretold: Prediction,
    *,
    title: str | None = None,
    ax: Sequence[Axes] | None = None,
    width: float | None = None,
) -> Figure:
    """Draw poses that were measured and those foretold, and their difference beside the sensor's noise.

    Each segment of the prediction starts anew; the band is what 95 of 100 differences would lie within if the
    sensor's noise were all that is left.

    Parameters
    ----------
    foretold : Prediction
        What `Identification.predict` returned.
    title : str, optional
        Heading of the figure.
    ax : sequence of six Axes, optional
        Axes to draw in: three of poses, then three of differences, x, y and psi each; by default those of a
        new figure.
    width : float, optional
        Of the new figure [in].

    Returns
    -------
    figure : matplotlib.figure.Figure
        The new one, or that of the first axes.

    Raises
    ------
    InvalidArgument
        If it is no prediction, there are not six axes, or `width` is not above zero.
    """
    if not isinstance(foretold, Prediction):
        raise InvalidArgument(f"foretold is {shown(foretold)}, expected what Identification.predict returns")
    heading = headed(title, f"Measured and foretold, {_span(foretold):.3g} s ahead")
    figure, grid = _grid(ax, width, heading)
    t = _broken(foretold.t)
    kept = np.arange(0, t.size, max(1, t.size // _MOST))
    for k, (name, unit, factor, small) in enumerate(_NAMES):
        poses, differences = grid[k]
        measured, predicted = foretold.measured[..., k], foretold.predicted[..., k]
        poses.plot(t[kept], _broken(measured)[kept], **_MEASURED)
        poses.plot(t[kept], _broken(predicted)[kept], color=colour(0), linewidth=1.4)
        poses.set_ylabel(f"{name} [{unit}]", fontsize=12)
        noise = factor * foretold.noise[k]
        band = _DEVIATIONS * noise
        differences.axhspan(-band, band, color=tint(INK, 0.12), linewidth=0)
        left = factor * _broken(measured - predicted)
        differences.plot(t[kept], left[kept], color=colour(0), linewidth=0.7)
        differences.set_ylabel(f"difference [{small}]", fontsize=11)
        told = f"rms {factor * foretold.rms[k]:.2g} {small}, noise {noise:.2g} {small}"
        differences.set_title(told, fontsize=11, color=INK, loc="left")
    for axes in grid[-1]:
        axes.set_xlabel("t [s]", fontsize=11)
    if ax is None:
        handles = [
            Line2D([], [], label="measured", **_MEASURED),
            Line2D([], [], label="foretold", color=colour(0), linewidth=1.4),
            Patch(color=tint(INK, 0.12), label="noise of the sensor, 95 %"),
        ]
        legend(figure, handles)
    return figure


def _grid(ax: Sequence[Axes] | None, width: float | None, heading: str) -> tuple[Figure, NDArray[np.object_]]:
    """Return the figure, and axes of shape (3, 2)."""
    wide = _WIDTH if width is None else positive("width", width, "in")
    if ax is not None:
        given = sequence("ax", ax, "six Axes") if not isinstance(ax, np.ndarray) else tuple(ax.ravel())
        if len(given) != 2 * len(_NAMES) or not all(isinstance(each, Axes) for each in given):
            raise InvalidArgument(f"ax is {shown(ax)}, expected six Axes")
        for each in given:
            dress(each)
        found = given[0].get_figure(root=True)
        return found, np.array(given, object).reshape(2, -1).T
    figure = ShownFigure(figsize=(wide, _HEIGHT * wide / _WIDTH), dpi=100, layout="constrained")
    figure.suptitle(heading, fontsize=14, color=INK)
    grid: NDArray[np.object_] = figure.subplots(len(_NAMES), 2, sharex=True, squeeze=False)
    for axes in grid.ravel():
        dress(axes)
    figure.align_ylabels()
    return figure, grid


def _span(foretold: Prediction) -> float:
    return float(foretold.t[0, -1] - foretold.t[0, 0])


def _broken(segments: Array) -> Array:
    """Return segments as one line that is broken between them, shape (S (L + 1),)."""
    gap = np.full((len(segments), 1), np.nan)
    return np.concatenate([segments, gap], axis=1).ravel()
