"""Figures of rollouts, reports and ensembles: matplotlib without pyplot, so no window is needed."""

from pinmobile.plots.accuracy import integrator
from pinmobile.plots.animation import animate
from pinmobile.plots.ground import balance, reaction
from pinmobile.plots.lines import curves
from pinmobile.plots.plane import path
from pinmobile.plots.quantiles import bands
from pinmobile.plots.series import errors, forces, signals, states
from pinmobile.plots.swept import heatmap
from pinmobile.plots.worst import drivers

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
