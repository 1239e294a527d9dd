"""Figures of rollouts, reports and ensembles: matplotlib without pyplot, so no window is needed."""

from pinmobile.plots.bands import bands
from pinmobile.plots.drivers import drivers
from pinmobile.plots.plane import animate, path
from pinmobile.plots.series import balance, errors, forces, reaction, signals, states
from pinmobile.plots.swept import curves, heatmap, integrator

__all__ = [
    "animate",
    "balance",
    "bands",
    "curves",
    "drivers",
    "errors",
    "forces",
    "heatmap",
    "integrator",
    "path",
    "reaction",
    "signals",
    "states",
]
