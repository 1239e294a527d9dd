"""Figures of rollouts, reports and ensembles: matplotlib without pyplot, so no window is needed."""

from pinmobile.plots.parameter_curves import curves, heatmap, integrator
from pinmobile.plots.plane import animate, end_effector, path
from pinmobile.plots.sensitivity import bands, drivers, poles, sensitivities
from pinmobile.plots.series import (
    balance,
    errors,
    forces,
    friction,
    loads,
    odometry,
    prediction,
    reaction,
    signals,
    slip,
    states,
    wheel_torques,
)

__all__ = [
    "animate",
    "balance",
    "bands",
    "curves",
    "drivers",
    "end_effector",
    "errors",
    "forces",
    "friction",
    "heatmap",
    "integrator",
    "loads",
    "odometry",
    "path",
    "poles",
    "prediction",
    "reaction",
    "sensitivities",
    "signals",
    "slip",
    "states",
    "wheel_torques",
]
