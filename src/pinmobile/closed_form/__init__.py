"""The equations of motion derived by hand: of the lecture's body, and of drives whose wheels roll."""

from pinmobile.closed_form.body import (
    Numbers as Numbers,
    coriolis_matrix,
    forward_dynamics,
    inverse_dynamics,
    mass_matrix,
    nonlinear_effects,
    quietly as quietly,
    unchecked_coriolis_matrix as unchecked_coriolis_matrix,
    unchecked_forward_dynamics as unchecked_forward_dynamics,
    unchecked_inverse_dynamics as unchecked_inverse_dynamics,
    unchecked_mass_matrix as unchecked_mass_matrix,
)
from pinmobile.closed_form.drives import ReducedModel, car, differential_drive, roller_drive

__all__ = [
    "ReducedModel",
    "car",
    "coriolis_matrix",
    "differential_drive",
    "forward_dynamics",
    "inverse_dynamics",
    "mass_matrix",
    "nonlinear_effects",
    "roller_drive",
]
