"""Exercise 1: from the table to the equations of motion.

Prepare with notebook 1. You derive the equations of the lecture's body step by step, from its table in the
modified Denavit-Hartenberg form:

| k | alpha | a | theta | d | joint |
|---|---|---|---|---|---|
| 1 | 3 pi/2 | 0 | 3 pi/2 | y | prismatic |
| 2 | 3 pi/2 | 0 | pi/2 | x | prismatic |
| 3 | pi/2 | 0 | pi/2 + psi | 0 | revolute |

Everywhere q = (x, y, psi) and v = dq/dt. The centre of mass lies at (x_bc, y_bc) in the body frame {3}.
"""

from __future__ import annotations

from functools import cache

import numpy as np

import pinmobile as pm
from pinmobile import closed_form, dh
from pinmobile.arrays import Array
from pinmobile.exercises._exercise import Exercise, Numbers, uniform

EXERCISE = Exercise("01_equations", __doc__, "m I_cz x_bc y_bc")


_LAST = np.diag([False, False, True])  # the last entry of the diagonal


@cache
def _made(mass: float, inertia: float, *com: float) -> pm.MobileRobot:
    return pm.MobileRobot(mass, inertia, com=com)


def robot(p: Numbers) -> pm.MobileRobot:
    """Return the robot of a course."""
    return _made(p.m, p.I_cz, p.x_bc, p.y_bc)


@EXERCISE(2, uniform(0, 0, 0, 0))
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


@EXERCISE(2, uniform(3))
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


@EXERCISE(2, uniform(3))
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


@EXERCISE(3, uniform(3))
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


@EXERCISE(2, uniform(3, 3))
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


@EXERCISE(1, unit="kg m")
def coupling(p: Numbers) -> float:
    """Give the entry of M in row x and column psi, where psi is a right angle.

    ? Evaluate your mass matrix at q = (0, 0, pi/2).

    ! mass_matrix(p, np.zeros(3))[0, 2] => This is the entry at psi = 0.
    ! mass_matrix(p, np.array([0, 0, 90]))[0, 2] => This is the entry at psi = 90 rad: use pi/2.
    ! mass_matrix(p, np.array([0, 0, np.pi / 2]))[2, 2] => This is the last entry of the diagonal.
    """
    return float(mass_matrix(p, np.array([0, 0, np.pi / 2]))[0, 2])
