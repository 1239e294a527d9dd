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

import numpy as np

from pinmobile.arrays import Array
from pinmobile.exercises._exercise import Exercise, Numbers, uniform

EXERCISE = Exercise("01_equations", __doc__, "m I_cz x_bc y_bc")


def _turn(axis: int, angle: float) -> Array:
    """Return the elementary rotation about x (0) or z (2)."""
    T, (i, j) = np.eye(4), ((1, 2) if axis == 0 else (0, 1))
    T[i, i] = T[j, j] = np.cos(angle)
    T[j, i] = np.sin(angle)
    T[i, j] = -T[j, i]
    return T


def _move(axis: int, length: float) -> Array:
    """Return the elementary translation along x (0) or z (2)."""
    T = np.eye(4)
    T[axis, 3] = length
    return T


@EXERCISE.function(2, uniform(0, 0, 0, 0))
def transform(p: Numbers, alpha: float, a: float, theta: float, d: float) -> Array:
    """Return the transform of a row of the table, 4x4, RotX(alpha) TransX(a) RotZ(theta) TransZ(d).

    ? Write the four elementary matrices RotX, TransX, RotZ and TransZ, and multiply them with @.
    ? RotX leaves row and column 0 alone: [[1, 0, 0, 0], [0, c, -s, 0], [0, s, c, 0], [0, 0, 0, 1]].

    ! _turn(2, theta) @ _move(2, d) @ _move(0, a) @ _turn(0, alpha) =>
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
    return _turn(0, alpha) @ _move(0, a) @ _turn(2, theta) @ _move(2, d)


@EXERCISE.function(2, uniform(3))
def pose(p: Numbers, q: Array) -> Array:
    """Return the pose of the body in the inertial frame, T_0_3, a 4x4 matrix.

    ? The pose is the product of the three transforms, from the ground outwards.
    ? The first joint of the chain slides along y, the second along x: the variables are (y, x, psi).
    ? The product is what you would write down at once: RotZ(psi), with x and y in its last column.

    ! pose(p, q[[1, 0, 2]]) => x and y are exchanged: the first joint of the chain slides along y.
    ! pose(p, q * [1, 1, -1]) => The rotation is transposed: psi turns the body from x towards y.
    ! pose(p, q * [1, 1, 0]) => psi is missing: the third joint adds it to theta.
    ! np.linalg.inv(pose(p, q)) => This is the pose of the ground in the body frame, the inverse.
    """
    return _move(0, q[0]) @ _turn(2, np.pi / 2) @ _move(0, q[1]) @ _turn(2, q[2] - np.pi / 2)


@EXERCISE.function(2, uniform(3))
def com_jacobian(p: Numbers, q: Array) -> Array:
    """Return the Jacobian J of the centre of mass, 2x3: its velocity in {0} is J v.

    ? The centre of mass is at (x, y) + R(psi) (x_bc, y_bc). Differentiate with respect to x, y and psi.
    ? The first two columns are the identity; the third is dR/dpsi (x_bc, y_bc).

    ! com_jacobian(p, 0 * q) => The centre of mass does not turn with the body: use R(psi) (x_bc, y_bc).
    ! com_jacobian(p.but(x_bc=0, y_bc=0), q) => This is the Jacobian of the origin of the body frame.
    ! com_jacobian(p, q * [1, 1, -1]) => R(psi) is transposed: its first row is (cos, -sin).
    ! com_jacobian(p.but(x_bc=p.y_bc, y_bc=p.x_bc), q) => x_bc and y_bc are exchanged.
    ! com_jacobian(p.but(x_bc=p.y_bc, y_bc=-p.x_bc), q) =>
      The last column is the place of the centre of mass; it must be the derivative of that with psi.
    """
    c, s = np.cos(q[2]), np.sin(q[2])
    return np.array([[1, 0, -p.x_bc * s - p.y_bc * c], [0, 1, p.x_bc * c - p.y_bc * s]])


@EXERCISE.function(3, uniform(3))
def mass_matrix(p: Numbers, q: Array) -> Array:
    """Return the mass matrix M(q), 3x3, with which the kinetic energy is v' M v / 2.

    ? The kinetic energy is m |J v|^2 / 2 + I_cz psi_dot^2 / 2, with the J of the last question.
    ? M = m J' J + I_cz e e' with e = (0, 0, 1).

    ! mass_matrix(p.but(x_bc=-p.x_bc, y_bc=-p.y_bc), q) =>
      The terms that couple x and y with psi have the wrong sign.
    ! mass_matrix(p, q) - np.diag([0, 0, p.m * (p.x_bc**2 + p.y_bc**2)]) =>
      I_cz is about the centre of mass; about the origin, m (x_bc^2 + y_bc^2) is added (Steiner).
    ! mass_matrix(p.but(I_cz=0), q) => The yaw inertia I_cz is missing in the last entry.
    ! mass_matrix(p.but(I_cz=p.I_cz + p.m * (p.x_bc**2 + p.y_bc**2)), q) => Steiner's term is added twice.
    ! mass_matrix(p.but(x_bc=0, y_bc=0), q) => The centre of mass is taken at the origin of the body frame.
    ! mass_matrix(p, q * [1, 1, -1]) => R(psi) is transposed: psi has the wrong sign.
    ! mass_matrix(p, 0 * q) => The centre of mass does not turn with the body: the coupling depends on psi.
    """
    J = com_jacobian(p, q)
    return p.m * J.T @ J + p.I_cz * np.diag([0, 0, 1])


@EXERCISE.function(2, uniform(3, 3))
def nonlinear_effects(p: Numbers, q: Array, v: Array) -> Array:
    """Return the nonlinear effects n(q, v), three numbers, of M a + n = tau.

    ? Without accelerations, the centre of mass still accelerates towards the origin of {3}: dJ/dt v.
    ? n = m J' (dJ/dt v). In dJ/dt only the last column is not zero, and it is proportional to psi_dot.
    ? With d = R(psi) (x_bc, y_bc): n = -m psi_dot^2 (d_x, d_y, 0).

    ! nonlinear_effects(p, q, v) / v[2] => psi_dot is not squared: the force grows with its square.
    ! nonlinear_effects(p, q, v) @ [[0, 1, 0], [-1, 0, 0], [0, 0, 0]] =>
      This lies across the line from the centre of mass to the origin; the force acts along it.
    ! nonlinear_effects(p, q * [1, 1, -1], v) => R(psi) is transposed: psi has the wrong sign.
    ! nonlinear_effects(p.but(m=1), q, v) => The mass is missing: these are accelerations, not forces.
    ! nonlinear_effects(p, 0 * q, v) => This is along the axes of the body; n is along those of {0}.
    """
    J = com_jacobian(p, q)
    return -p.m * float(v[2]) ** 2 * np.array([J[1, 2], -J[0, 2], 0])


@EXERCISE.number(1, "kg m")
def coupling(p: Numbers) -> float:
    """Give the entry of M in row x and column psi, where psi is a right angle.

    ? Evaluate your mass matrix at q = (0, 0, pi/2).

    ! mass_matrix(p, np.zeros(3))[0, 2] => This is the entry at psi = 0.
    ! mass_matrix(p, np.array([0, 0, 90]))[0, 2] => This is the entry at psi = 90 rad: use pi/2.
    ! mass_matrix(p, np.array([0, 0, np.pi / 2]))[2, 2] => This is the last entry of the diagonal.
    """
    return float(mass_matrix(p, np.array([0, 0, np.pi / 2]))[0, 2])
