"""Answers to exercise 2, and answers with mistakes."""

import numpy as np

m, I_cz, x_bc, y_bc, psi_0 = 30.0, 1.3, 0.1, 0.05, 0.7


# %% kinetic_energy
def kinetic_energy(q, v):
    c, s = np.cos(q[2]), np.sin(q[2])
    d = np.array([x_bc * c - y_bc * s, x_bc * s + y_bc * c])
    v_c = v[:2] + v[2] * np.array([-d[1], d[0]])
    return m * v_c @ v_c / 2 + I_cz * v[2] ** 2 / 2


# %% mass_matrix_rate
def mass_matrix_rate(q, v):
    c, s = np.cos(q[2]), np.sin(q[2])
    rate = np.zeros((3, 3))
    rate[0, 2] = rate[2, 0] = -m * (x_bc * c - y_bc * s) * v[2]
    rate[1, 2] = rate[2, 1] = -m * (x_bc * s + y_bc * c) * v[2]
    return rate


# %% coriolis_matrix
def coriolis_matrix(q, v):
    rate = mass_matrix_rate(q, v)
    return np.array([[0, 0, rate[0, 2]], [0, 0, rate[1, 2]], [0, 0, 0]])


# %% forward_dynamics
def forward_dynamics(q, v, tau):
    c, s = np.cos(q[2]), np.sin(q[2])
    d = np.array([x_bc * c - y_bc * s, x_bc * s + y_bc * c])
    M = m * np.eye(3)
    M[0, 2] = M[2, 0] = -m * d[1]
    M[1, 2] = M[2, 1] = m * d[0]
    M[2, 2] = I_cz + m * d @ d
    n = -m * v[2] ** 2 * np.array([d[0], d[1], 0])
    return np.linalg.inv(M) @ (tau - n)


# %% regressor
def regressor(q, v, a):
    c, s = np.cos(q[2]), np.sin(q[2])
    w = v[2]
    Y = np.zeros((3, 4))
    Y[:, 0] = a[0], a[1], 0
    Y[:, 1] = -s * a[2] - c * w**2, c * a[2] - s * w**2, c * a[1] - s * a[0]
    Y[:, 2] = -c * a[2] + s * w**2, -s * a[2] - c * w**2, -c * a[0] - s * a[1]
    Y[2, 3] = a[2]
    return Y


# %% slide_error
slide_error = m * (x_bc * np.sin(psi_0) + y_bc * np.cos(psi_0)) * (-0.3 - 0.25)

# %%
MISTAKES = [
    ("kinetic_energy", " + I_cz * v[2] ** 2 / 2", "", "energy of turning"),
    ("kinetic_energy", "v_c = v[:2] +", "v_c = v[:2] + 0 *", "velocity of the origin"),
    ("kinetic_energy", "return m * v_c @ v_c / 2 + I_cz * v[2] ** 2 / 2",
     "return m * v_c @ v_c + I_cz * v[2] ** 2",
     "factor of 2"),
    ("mass_matrix_rate", " * v[2]", "", "the factor psi_dot is missing"),
    ("mass_matrix_rate", "np.sin(q[2])", "-np.sin(q[2])", "psi has the wrong sign"),
    ("mass_matrix_rate", " = rate[2, 0]", "", "differs"),
    ("coriolis_matrix", "return", "return rate / 2 + 0 *", "C v is not n"),
    ("coriolis_matrix", "return", "return rate + 0 *", "not skew-symmetric"),
    ("coriolis_matrix", "return np.array([[0, 0, rate[0, 2]], [0, 0, rate[1, 2]], [0, 0, 0]])",
     "return np.array([[0, 0, 0], [0, 0, 0], [rate[0, 2], rate[1, 2], 0]])", "transposed"),
    ("forward_dynamics", "tau - n", "tau + n", "n has the wrong sign"),
    ("forward_dynamics", "tau - n", "tau", "The nonlinear effects n are missing"),
    ("forward_dynamics", "np.linalg.inv(M)", "M", "its inverse is needed"),
    ("regressor", "w = v[2]", "w = 0", "centrifugal"),
    ("regressor", "return Y", "return Y[:, [0, 2, 1, 3]]", "exchanged"),
    ("regressor", "return Y", "return Y.T", "shape (4, 3)"),
    ("slide_error", "-0.3 - 0.25", "-0.3 - 0.5", "psi_dot is not squared"),
    ("slide_error", "psi_0", "0", "along the axes of the body"),
    ("slide_error", "-0.3", "0.3", "lost its sign"),
]  # fmt: skip
