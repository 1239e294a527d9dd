"""Figures of linearized loops: poles in the plane of z, and errors with bands of uncertain numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Unpack

import numpy as np
from matplotlib.figure import Figure, SubFigure
from matplotlib.lines import Line2D

from pinmobile.arrays import ArrayLike, instance, label_items
from pinmobile.derivatives import Poles, Sensitivities
from pinmobile.palette import QUIET
from pinmobile.plots.series import errors
from pinmobile.plots.style import Layout, Sheet, Style, colour, font_size, tint

_MARKS = "x+1234"
_DAMPING_RATIOS = 0.2, 0.4, 0.6, 0.8  # damping ratios with a curve
_LABEL = 70  # point of a curve at which its ratio is written
_DEVIATIONS = 2.0  # standard deviations


def poles(found: Poles | Mapping[str, Poles], **layout: Unpack[Layout]) -> Figure:
    """Draw poles in the plane of z, with the unit circle and curves of constant damping ratio.

    Deviations decay if all poles are inside the circle. Poles near 1 are slow.

    Parameters
    ----------
    found : Poles or mapping of str to Poles
        Poles by label, all in the same axes.
    **layout
        ``title``, ``ax`` and ``width``, see `plots.states`.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If `found` are not poles.

    See Also
    --------
    derivatives.poles : poles of a loop

    Examples
    --------
    >>> from pinmobile import PD, FixedHeading, Hold, MobileRobot
    >>> from pinmobile import plots
    >>> from pinmobile.derivatives import poles
    >>> rest = FixedHeading(Hold((0, 0), 1.0), 0.0)
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> figure = plots.poles(poles(robot, PD(120, 120), rest, dt=0.05))
    >>> figure.axes[0].get_xlabel()
    'real part of z'
    """
    table: dict[str, Poles] = label_items("found", found, Poles)
    sheet = Sheet(6.0, **layout)
    (axes,) = sheet.axes([(0, 0)], [5.2], share="")
    circle = np.exp(1j * np.linspace(0.0, 2 * np.pi, 361))
    axes.plot(circle.real, circle.imag, color=QUIET, linewidth=1.2)
    angle = np.linspace(0.0, np.pi, 181)
    for ratio in _DAMPING_RATIOS:
        z = np.exp((-ratio / np.sqrt(1 - ratio**2) + 1j) * angle)
        for side in (1, -1):
            axes.plot(z.real, side * z.imag, color=QUIET, linewidth=0.6, linestyle=":")
        axes.annotate(
            f"{ratio:g}", (z[_LABEL].real, z[_LABEL].imag), color=QUIET, fontsize=font_size(0.8), ha="center"
        )
    keys = []
    for k, (label, one) in enumerate(table.items()):
        mark: Style = {"marker": _MARKS[k % len(_MARKS)], "color": colour(k), "linestyle": ""}
        mark |= {"markeredgewidth": 1.8}
        axes.plot(one.values.real, one.values.imag, markersize=font_size(0.8), **mark)
        keys.append(Line2D([], [], label=label or "poles", **mark))
    size = max(1.15, *(1.05 * float(np.abs(one.values).max()) for one in table.values()))
    axes.set(xlim=(-size, size), ylim=(-size, size), aspect="equal")
    axes.set(xlabel="real part of z", ylabel="imaginary part of z")
    keys.append(Line2D([], [], color=QUIET, linewidth=1.2, label="stability limit"))
    keys.append(Line2D([], [], color=QUIET, linewidth=0.6, linestyle=":", label="damping ratio"))
    one = next(iter(table.values()))
    return sheet.finish(f"Poles near t = {one.t:g} s, dt = {1e3 * one.dt:g} ms", keys)


def sensitivities(
    found: Sensitivities, deviations: Mapping[str, ArrayLike], **layout: Unpack[Layout]
) -> Figure:
    """Draw the error of a run with a band of two standard deviations for uncertain numbers, to first order.

    Parameters
    ----------
    found : Sensitivities
        Derivatives of a run.
    deviations : mapping of str to array_like
        Standard deviations of the numbers, see `Sensitivities.deviation`.
    **layout
        ``title``, ``ax`` and ``width``, see `plots.states`.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If `found` or `deviations` is invalid.

    See Also
    --------
    derivatives.sensitivities : derivatives of a run
    plots.bands : bands of an ensemble, for finite changes

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Tangent
    >>> from pinmobile import plots
    >>> from pinmobile.derivatives import sensitivities
    >>> circle = Tangent(Circle(1.0, 0.5, 4.0))
    >>> parts = MobileRobot(30.0, 1.3), PD(120, 120), circle
    >>> found = sensitivities(*parts, by=["mass"], dt=0.02)
    >>> figure = plots.sensitivities(found, {"mass": 3.0})
    >>> len(figure.axes)
    3
    """
    instance("found", found, Sensitivities, "derivatives.Sensitivities")
    run = found.rollout
    band = _DEVIATIONS * found.deviation(deviations)[:, : run.error.shape[1]]
    words = "Error, and a band of two standard deviations of " + ", ".join(deviations)
    figure = errors(run, **({"title": words} | layout))
    given = layout.get("ax")
    panels = figure.axes if given is None or isinstance(given, Figure | SubFigure) else np.ravel(given)  # type: ignore[arg-type]
    for axes, error, size in zip(panels, run.error.T, band.T, strict=False):
        axes.fill_between(run.t, error - size, error + size, color=tint(colour(0), 0.3), linewidth=0)
    return figure
