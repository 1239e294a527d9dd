"""Exercises 1 and 2: the equations of motion of the lecture's body, and models beside each other."""

from __future__ import annotations

from functools import cache

import numpy as np

import pinmobile as pm
from pinmobile import closed_form, dh
from pinmobile.arrays import Array
from pinmobile.exercises._exercise import Exercise, Numbers, uniform

EQUATIONS = Exercise("01_equations")


_LAST = np.diag([False, False, True])  # the last entry of the diagonal


@cache
def _made(mass: float, inertia: float, *com: float) -> pm.MobileRobot:
    return pm.MobileRobot(mass, inertia, com=com)


def robot(p: Numbers) -> pm.MobileRobot:
    """Return the robot of a course."""
    return _made(p.m, p.I_cz, p.x_bc, p.y_bc)


@EQUATIONS(2, uniform(0, 0, 0, 0))
def transform(p: Numbers, alpha: float, a: float, theta: float, d: float) -> Array:
    """Return the transform of a row of the table, 4x4, RotX(alpha) TransX(a) RotZ(theta) TransZ(d).

    ? Write the four elementary matrices RotX, TransX, RotZ and TransZ, and multiply them with @.
    ? A rotation about x leaves x alone: row and column 0 of RotX are those of the identity.

    ! transform(p, 0, 0, theta, d) @ transform(p, alpha, a, 0, 0) =>
      This is the standard DH form, RotZ TransZ TransX RotX; the table is in the modified form.
    ! transform(p, -alpha, a, -theta, d) =>
      Both rotations are transposed: RotZ has -sin above the diagonal, and so has RotX.
    ! transform(p, -alpha, a, theta, d) => RotX is transposed: it has -sin(alpha) above the diagonal.
    ! transform(p, alpha, a, -theta, d) => RotZ is transposed: it has -sin(theta) above the diagonal.
    ! transform(p, np.radians(alpha), a, np.radians(theta), d) =>
      The angles are taken for degrees; they are in radians.
    ! np.linalg.inv(transform(p, alpha, a, theta, d)) =>
      This is the inverse; the pose of frame k in frame k-1 is asked for.
    """
    return dh.transform(alpha, a, theta, d)


@EQUATIONS(2, uniform(3))
def pose(p: Numbers, q: Array) -> Array:
    """Return the pose of the body in the inertial frame, T_0_3, a 4x4 matrix.

    ? The pose is the product of the three transforms, from the ground outwards.
    ? The first joint of the chain slides along y, the second along x: the variables are (y, x, psi).

    ! pose(p, q[[1, 0, 2]]) => x and y are exchanged: the first joint of the chain slides along y.
    ! pose(p, q * [1, 1, -1]) => The rotation is transposed: psi turns the body from x towards y.
    ! pose(p, q * [1, 1, 0]) => psi is missing: the third joint adds it to theta.
    ! np.linalg.inv(pose(p, q)) => This is the pose of the ground in the body frame, the inverse.
    """
    return np.asarray(dh.LECTURE_TABLE.placements(q[[1, 0, 2]])[-1])


@EQUATIONS(2, uniform(3))
def com_jacobian(p: Numbers, q: Array) -> Array:
    """Return the Jacobian J of the centre of mass, 2x3: its velocity in {0} is J v.

    ? Your pose takes the centre of mass from the body frame to {0}.
    ? Differentiate its place with respect to x, y and psi.

    ! com_jacobian(p, 0 * q) => The centre of mass does not turn with the body: psi is missing.
    ! com_jacobian(p.but(x_bc=0, y_bc=0), q) => This is the Jacobian of the origin of the body frame.
    ! com_jacobian(p, q * [1, 1, -1]) => R(psi) is transposed: psi has the wrong sign.
    ! com_jacobian(p.but(x_bc=p.y_bc, y_bc=p.x_bc), q) => x_bc and y_bc are exchanged.
    ! com_jacobian(p.but(x_bc=p.y_bc, y_bc=-p.x_bc), q) =>
      The last column is the place of the centre of mass; it must be the derivative of that with psi.
    """
    return mass_matrix(p, q)[:2] / p.m


@EQUATIONS(3, uniform(3))
def mass_matrix(p: Numbers, q: Array) -> Array:
    """Return the mass matrix M(q), 3x3, with which the kinetic energy is v' M v / 2.

    ? Write the kinetic energy of the centre of mass and of the rotation about it.
    ? Its velocity is J v, with the J of the last question. Collect what stands between v' and v.

    ! mass_matrix(p.but(x_bc=-p.x_bc, y_bc=-p.y_bc), q) =>
      The terms that couple x and y with psi have the wrong sign.
    ! np.where(_LAST, p.I_cz, mass_matrix(p, q)) =>
      I_cz is about the centre of mass; about the origin, a term is added (Steiner).
    ! mass_matrix(p.but(I_cz=1e-8), q) => The yaw inertia I_cz is missing in the last entry.
    ! mass_matrix(p.but(I_cz=mass_matrix(p, q)[2, 2]), q) => Steiner's term is added twice.
    ! mass_matrix(p.but(x_bc=0, y_bc=0), q) => The centre of mass is taken at the origin of the body frame.
    ! mass_matrix(p, q * [1, 1, -1]) => R(psi) is transposed: psi has the wrong sign.
    ! mass_matrix(p, 0 * q) => The centre of mass does not turn with the body: the coupling depends on psi.
    """
    return closed_form.mass_matrix(q, mass=p.m, yaw_inertia=p.I_cz, com=(p.x_bc, p.y_bc))


@EQUATIONS(2, uniform(3, 3))
def nonlinear_effects(p: Numbers, q: Array, v: Array) -> Array:
    """Return the nonlinear effects n(q, v), three numbers, of M a + n = tau.

    ? Without accelerations, the centre of mass still accelerates towards the origin of {3}: dJ/dt v.
    ? The force that this acceleration of the mass needs acts at the centre of mass. J' takes it to q.

    ! nonlinear_effects(p, q, v) / v[2] => psi_dot is not squared: the force grows with its square.
    ! nonlinear_effects(p, q, v) @ [[0, 1, 0], [-1, 0, 0], [0, 0, 0]] =>
      This lies across the line from the centre of mass to the origin; the force acts along it.
    ! nonlinear_effects(p, q * [1, 1, -1], v) => R(psi) is transposed: psi has the wrong sign.
    ! nonlinear_effects(p.but(m=1), q, v) => The mass is missing: these are accelerations, not forces.
    ! nonlinear_effects(p, 0 * q, v) => This is along the axes of the body; n is along those of {0}.
    """
    return closed_form.nonlinear_effects(q, v, mass=p.m, com=(p.x_bc, p.y_bc))


@EQUATIONS(1, unit="kg m")
def coupling(p: Numbers) -> float:
    """Give the entry of M in row x and column psi, where psi is a right angle.

    ? Evaluate your mass matrix at q = (0, 0, pi/2).

    ! mass_matrix(p, np.zeros(3))[0, 2] => This is the entry at psi = 0.
    ! mass_matrix(p, np.array([0, 0, 90]))[0, 2] => This is the entry at psi = 90 rad: use pi/2.
    ! mass_matrix(p, np.array([0, 0, np.pi / 2]))[2, 2] => This is the last entry of the diagonal.
    """
    return float(mass_matrix(p, np.array([0, 0, np.pi / 2]))[0, 2])


METHODS = Exercise("02_methods")


@METHODS(2, uniform(3, 3))
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


@METHODS(2, uniform(3, 3))
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


@METHODS(3, uniform(3, 3))
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


@METHODS(2, uniform(3, 3, 3))
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


@METHODS(2, uniform(3, 3, 3))
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


@METHODS(1, unit="N")
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
