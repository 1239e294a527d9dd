"""Derivatives of a closed loop: how a number of a run changes with the numbers of its parts."""

from pinmobile.derivatives._gradient import Gradient, Sensitivities, gradient, sensitivities
from pinmobile.derivatives._poles import Margins, Poles, poles
from pinmobile.derivatives._tune import Constraint, Trial, Tuning, tune

__all__ = [
    "Constraint",
    "Gradient",
    "Margins",
    "Poles",
    "Sensitivities",
    "Trial",
    "Tuning",
    "gradient",
    "poles",
    "sensitivities",
    "tune",
]
