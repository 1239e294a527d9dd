"""Answers to exercise 4, and answers with mistakes."""

import numpy as np

m, I_cz, x_bc, y_bc, r, w, kp, kd = 30.0, 1.3, 0.1, 0.05, 3.0, 0.1, 4.0, 4.0


# %% critical
def critical(omega):
    return omega**2, 2 * omega


# %% pd_force
def pd_force(kp, kd, q, v, q_d, v_d):
    e = q_d - q
    e[2] = np.arctan2(np.sin(e[2]), np.cos(e[2]))
    return kp * e + kd * (v_d - v)


# %% computed_torque
def computed_torque(M, n, gains, q, v, reference):
    kp, kd = gains
    q_d, v_d, a_d = reference
    e = q_d - q
    e[2] = (e[2] + np.pi) % (2 * np.pi) - np.pi
    return M @ (a_d + kd * (v_d - v) + kp * e) + n


# %% circle_error
circle_error = r * w**2 / kp

# %% largest_step
M = np.array([[m, 0, -m * y_bc], [0, m, m * x_bc], [-m * y_bc, m * x_bc, I_cz + m * (x_bc**2 + y_bc**2)]])
k = max(np.linalg.eigvals(np.linalg.inv(M) @ np.diag([kd * m, kd * m, kd * I_cz])).real)
largest_step = 2 / k

# %% gains
gain_p, gain_d = critical(2.6)

# %%
MISTAKES = [
    ("circle_error", "circle_error =", "circle_error = 1e3 *", "mm and m"),
    ("gains", "critical(2.6)", "critical(4)", "gain_p is too large"),
    ("gains", "critical(2.6)", "critical(1)", "gain_p is too small"),
    ("gains", "critical(2.6)", "6.76, 1.0", "overshoots"),
    ("gains", "critical(2.6)", "6.76, 9.0", "creeps"),
    ("gains", "critical(2.6)", "-1, 3", "Both gains must be above 0"),
    ("gains", "critical(2.6)", "1e9, 1e9", "diverged"),
]  # fmt: skip
