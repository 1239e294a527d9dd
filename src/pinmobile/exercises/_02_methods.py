"""Exercise 2: model against model.

Prepare with notebook 2. A model that can be wrong needs a second one beside it. You write what the checks of
notebook 2 compare: the Coriolis matrix, the energy, the accelerations, and the regressor. You may use your
answers to exercise 1.

Everywhere q = (x, y, psi), v = dq/dt, a = dv/dt and tau = (F_x, F_y, M_z), with M(q) a + n(q, v) = tau.
"""

import numpy as np

from pinmobile import closed_form
from pinmobile.arrays import Array
from pinmobile.exercises._01_equations import mass_matrix, robot
from pinmobile.exercises._exercise import Exercise, Numbers, uniform

EXERCISE = Exercise("02_methods", __doc__, "m I_cz x_bc y_bc psi_0")


@EXERCISE(2, uniform(3, 3))
def kinetic_energy(p: Numbers, q: Array, v: Array) -> float:
    """Return the kinetic energy [J].

    ? Your mass matrix is defined by the kinetic energy.
    ? Or add the energy of the centre of mass and of the rotation about it.

    ! kinetic_energy(p.but(I_cz=1e-8), q, v) => The energy of turning is missing.
    ! kinetic_energy(p.but(x_bc=0, y_bc=0), q, v) => This is with the velocity of the origin, not of the mass.
    ! np.diag(mass_matrix(p, q)) @ v**2 / 2 => The terms off the diagonal of M are missing.
    ! v @ robot(p).nonlinear_effects(q, v) => This is a power, v' n.
    """
    return float(robot(p).kinetic_energy(q, v))


@EXERCISE(2, uniform(3, 3))
def mass_matrix_rate(p: Numbers, q: Array, v: Array) -> Array:
    """Return dM/dt on the way of the robot, a 3x3 matrix.

    ? M depends on psi alone: dM/dt = dM/dpsi psi_dot.
    ? Differentiate the two entries that couple x and y with psi; M is symmetric, and so is its rate.

    ! mass_matrix_rate(p, q, v) / v[2] => This is dM/dpsi; the factor psi_dot is missing.
    ! np.triu(mass_matrix_rate(p, q, v)) => The lower half is missing: dM/dt is symmetric.
    ! mass_matrix_rate(p, q * [1, 1, -1], v) => R(psi) is transposed: psi has the wrong sign.
    ! mass_matrix_rate(p, q + np.pi / 2, v) => It is differentiated twice.
    ! mass_matrix(p, q) * v[2] => This is M psi_dot; M is not differentiated.
    """
    step = 1e-5 * v
    return (mass_matrix(p, q + step) - mass_matrix(p, q - step)) / 2e-5


@EXERCISE(3, uniform(3, 3))
def coriolis_matrix(p: Numbers, q: Array, v: Array) -> Array:
    """Return the Coriolis matrix C(q, v) by Christoffel symbols, 3x3.

    Then C v = n, and dM/dt - 2 C is skew-symmetric.

    ? c_ijk = (dM_ij/dq_k + dM_ik/dq_j - dM_jk/dq_i) / 2, and C_ij is the sum of c_ijk v_k over k.
    ? M depends on psi alone: only derivatives with respect to q_3 are not zero. Most terms cancel.

    ! mass_matrix_rate(p, q, v) => This is dM/dt: then dM/dt - 2 C is symmetric, not skew-symmetric.
    ! mass_matrix_rate(p, q, v) / 2 => This is half of dM/dt: then dM/dt - 2 C = 0, but C v is not n.
    ! coriolis_matrix(p, q, v).T => It is transposed: C_ij v_j is summed over the columns.
    ! coriolis_matrix(p, q * [1, 1, -1], v) => R(psi) is transposed: psi has the wrong sign.
    ! coriolis_matrix(p, q, v) / v[2] => The factor psi_dot is missing.
    ! np.diag(robot(p).nonlinear_effects(q, v) / v) => C v = n holds, but dM/dt - 2 C is not skew-symmetric.
    """
    return closed_form.coriolis_matrix(q, v, mass=p.m, com=(p.x_bc, p.y_bc))


@EXERCISE(2, uniform(3, 3, 3))
def forward_dynamics(p: Numbers, q: Array, v: Array, tau: Array) -> Array:
    """Return the acceleration a for a given tau, three numbers.

    ? Solve M a + n = tau for a.
    ? np.linalg.solve(M, right-hand side) needs no inverse.

    ! forward_dynamics(p, q, 0 * v, tau) => The nonlinear effects n are missing.
    ! forward_dynamics(p, q, v, tau + 2 * robot(p).nonlinear_effects(q, v)) => n has the wrong sign.
    ! mass_matrix(p, q) @ mass_matrix(p, q) @ forward_dynamics(p, q, v, tau) =>
      M is multiplied; its inverse is needed.
    ! mass_matrix(p, q) @ forward_dynamics(p, q, v, tau) / np.diag(mass_matrix(p, q)) =>
      Only the diagonal of M is used: the coupling is missing.
    ! mass_matrix(p, q) @ tau + robot(p).nonlinear_effects(q, v) => This is inverse dynamics, tau from a.
    """
    return closed_form.forward_dynamics(q, v, tau, mass=p.m, yaw_inertia=p.I_cz, com=(p.x_bc, p.y_bc))


@EXERCISE(2, uniform(3, 3, 3))
def regressor(p: Numbers, q: Array, v: Array, a: Array) -> Array:
    """Return the regressor Y, a 3x4 matrix, with tau = Y (m, m x_bc, m y_bc, I_zz).

    I_zz is the yaw inertia about the origin of {3}.

    ? Write F_x, F_y and M_z out, and collect what multiplies m, m x_bc, m y_bc and I_zz.
    ? I_zz contains the term of Steiner, and stands in M_z alone, with psi_ddot.
    ? Column by column: which tau does m = 1 kg need at the origin? Which one does m x_bc = 1 kg m add?

    ! regressor(p, q, 0 * v, a) => The centrifugal terms are missing.
    ! regressor(p, q, v, a)[:, [0, 2, 1, 3]] => The columns of m x_bc and m y_bc are exchanged.
    ! regressor(p, q * [1, 1, -1], v, a) => R(psi) is transposed: psi has the wrong sign.
    ! regressor(p, q, v, a * [1, 1, 0]) => The terms with psi_ddot are missing.
    ! regressor(p, 0 * q, v, a) => psi is missing: this holds where the axes of {0} and {3} agree.
    """
    return robot(p).regressor(q, v, a)[:, np.r_[:3, 9]]


@EXERCISE(1, unit="N")
def slide_error(p: Numbers) -> float:
    """Give F_x of the slide less the right F_x, at psi = psi_0, psi_dot = 0.5 rad/s, psi_ddot = -0.3 rad/s^2.

    The slide has psi_dot^2 in place of psi_ddot: F_x = m (x_ddot - d_y psi_dot^2 - d_x psi_dot^2), where
    (d_x, d_y) = R(psi) (x_bc, y_bc).

    ? In the right F_x, d_y multiplies psi_ddot. All other terms cancel.
    ? d_y is the second entry of R(psi_0) (x_bc, y_bc).

    ! slide_error(p.but(psi_0=0)) => d_y is taken along the axes of the body; psi_0 turns it.
    ! slide_error(p.but(psi_0=p.psi_0 + np.pi / 2)) => This is with d_x in place of d_y.
    ! slide_error(p.but(psi_0=np.radians(p.psi_0))) => psi_0 is taken for degrees; it is in radians.
    ! slide_error(p) / 0.55 * 0.8 => psi_dot is not squared.
    ! slide_error(p) / -0.55 * 0.05 => psi_ddot has lost its sign.
    """
    return _force(p, 0.5**2) - _force(p, -0.3)


def _force(p: Numbers, turn: float) -> float:
    """Return F_x at psi = psi_0 and psi_dot = 0.5 rad/s for a value of psi_ddot."""
    return float(robot(p).inverse_dynamics([0, 0, p.psi_0], [0, 0, 0.5], [0, 0, turn])[0])
