"""Figures of one rollout, or of several side by side: matplotlib without pyplot, so no window is needed."""

from pinmobile.plots.animation import animate
from pinmobile.plots.plane import path
from pinmobile.plots.series import errors, forces, states

__all__ = ["animate", "errors", "forces", "path", "states"]
