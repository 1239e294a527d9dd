"""Figures of one rollout or report, or of several: matplotlib without pyplot, so no window is needed."""

from pinmobile.plots.accuracy import integrator
from pinmobile.plots.animation import animate
from pinmobile.plots.plane import path
from pinmobile.plots.series import errors, forces, states

__all__ = ["animate", "errors", "forces", "integrator", "path", "states"]
