"""The hand-derived equations of motion of the lecture; everything broadcasts over leading axes.

The parameters are arrays too: one robot with many states, many robots with one state, or each its own.
With c = cos psi and s = sin psi, ``d = (xbc c - ybc s, xbc s + ybc c)`` is the centre of mass seen from the
body's origin, along the inertial axes. In these terms (lecture, section 3 of its mathematics)::

    M(q) = [   m       0      -m d_y          ]        n(q, v) = -m psi_dot^2 [ d_x ]
           [   0       m       m d_x          ]                               [ d_y ]
           [ -m d_y   m d_x    m |d|^2 + Icz  ]                               [  0  ]
"""

from pinmobile.closed_form.dynamics import (
    forward_dynamics,
    inverse_dynamics,
    unchecked_forward_dynamics,
    unchecked_inverse_dynamics,
)
from pinmobile.closed_form.terms import (
    coriolis_matrix,
    mass_matrix,
    nonlinear_effects,
    unchecked_coriolis_matrix,
    unchecked_mass_matrix,
)

__all__ = [
    "coriolis_matrix",
    "forward_dynamics",
    "inverse_dynamics",
    "mass_matrix",
    "nonlinear_effects",
    "unchecked_coriolis_matrix",
    "unchecked_forward_dynamics",
    "unchecked_inverse_dynamics",
    "unchecked_mass_matrix",
]
