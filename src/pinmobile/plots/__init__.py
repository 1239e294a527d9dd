"""Figures of one rollout or report, or of several: matplotlib without pyplot, so no window is needed."""

from pinmobile.plots.accuracy import integrator
from pinmobile.plots.animation import animate
from pinmobile.plots.ground import balance, reaction
from pinmobile.plots.plane import path
from pinmobile.plots.series import errors, forces, states

__all__ = ["animate", "balance", "errors", "forces", "integrator", "path", "reaction", "states"]
