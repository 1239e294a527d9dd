"""Answers to exercise 8, and answers with mistakes."""

import numpy as np

m, I_cz, x_bc, y_bc, r_w, b, I_w, l_s, mu = 30.0, 1.3, 0.1, 0.05, 0.1, 0.25, 0.005, 0.3, 0.5


# %% wheel_rates
def wheel_rates(v, omega):
    return (v - b * omega) / r_w, (v + b * omega) / r_w


# %% body_twist
def body_twist(left, right):
    return r_w * (left + right) / 2, r_w * (right - left) / (2 * b)


# %% constraint_matrix
def constraint_matrix(psi):
    c, s = np.cos(psi), np.sin(psi)
    return [[c, s, -b, -r_w, 0], [c, s, b, 0, -r_w], [-s, c, 0, 0, 0]]


# %% wheel_torques
def wheel_torques(F, M):
    return r_w * (F / 2 - M / (2 * b)), r_w * (F / 2 + M / (2 * b))


# %% acceleration
def acceleration(v, omega, left, right):
    I_o = I_cz + m * (x_bc**2 + y_bc**2)
    M = np.array([[m + 2 * I_w / r_w**2, -m * y_bc], [-m * y_bc, I_o + 2 * I_w * b**2 / r_w**2]])
    n = np.array([-m * x_bc * omega**2, m * x_bc * v * omega])
    push = np.array([left + right, b * (right - left)]) / r_w
    return np.linalg.solve(M, push - n)


# %% slip_torque
load = m * 9.81 * (l_s - x_bc) / l_s
slip_torque = mu * load / 2 * r_w

# %% tracking
zeta, k = 0.7, 0.9

# %%
MISTAKES = [
    ("constraint_matrix", "s, -b", "s, b", "differs"),
    ("constraint_matrix", ", [-s, c, 0, 0, 0]", "", "shape (2, 5)"),
    ("tracking", "0.7, 0.9", "0.05, 0.9", "weaves"),
    ("tracking", "0.7, 0.9", "0.7, 10", "k is too large"),
    ("tracking", "0.7, 0.9", "0.7, 0.1", "k is too small"),
]  # fmt: skip
