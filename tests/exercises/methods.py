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
    ("kinetic_energy", "return m * v_c @ v_c / 2 + I_cz * v[2] ** 2 / 2",
     "return m * v_c @ v_c + I_cz * v[2] ** 2",
     "factor of 2"),
    ("mass_matrix_rate", " = rate[2, 0]", "", "differs"),
    ("regressor", "return Y", "return Y.T", "shape (4, 3)"),
]  # fmt: skip
