"""Answers to exercise 1, and answers with mistakes."""

import numpy as np

m, I_cz, x_bc, y_bc = 30.0, 1.3, 0.1, 0.05


# %% transform
def transform(alpha, a, theta, d):
    ca, sa, ct, st = np.cos(alpha), np.sin(alpha), np.cos(theta), np.sin(theta)
    return np.array(
        [
            [ct, -st, 0, a],
            [st * ca, ct * ca, -sa, -d * sa],
            [st * sa, ct * sa, ca, d * ca],
            [0, 0, 0, 1],
        ]
    )


# %% pose
def pose(q):
    x, y, psi = q
    T = transform(3 * np.pi / 2, 0, 3 * np.pi / 2, y)
    T = T @ transform(3 * np.pi / 2, 0, np.pi / 2, x)
    return T @ transform(np.pi / 2, 0, np.pi / 2 + psi, 0)


# %% com_jacobian
def com_jacobian(q):
    c, s = np.cos(q[2]), np.sin(q[2])
    return np.array([[1, 0, -(x_bc * s + y_bc * c)], [0, 1, x_bc * c - y_bc * s]])


# %% mass_matrix
def mass_matrix(q):
    c, s = np.cos(q[2]), np.sin(q[2])
    M = m * np.eye(3)
    M[0, 2] = M[2, 0] = -m * (x_bc * s + y_bc * c)
    M[1, 2] = M[2, 1] = m * (x_bc * c - y_bc * s)
    M[2, 2] = I_cz + m * (x_bc**2 + y_bc**2)
    return M


# %% nonlinear_effects
def nonlinear_effects(q, v):
    c, s = np.cos(q[2]), np.sin(q[2])
    return -m * v[2] ** 2 * np.array([x_bc * c - y_bc * s, x_bc * s + y_bc * c, 0])


# %% coupling
coupling = mass_matrix([0, 0, np.pi / 2])[0, 2]

# %%
MISTAKES = [
    ("com_jacobian", "[0, 1, x_bc * c - y_bc * s]", "[0, 1, 0]", "differs"),
    ("mass_matrix", "return M", "return 1000 * M", "factor of 1000"),
    ("nonlinear_effects", "-m", "m", "Only the sign is wrong"),
    ("coupling", "coupling =", "coupling = -", "Only the sign is wrong"),
]  # fmt: skip
