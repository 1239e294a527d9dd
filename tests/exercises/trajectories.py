"""Answers to exercise 3, and answers with mistakes."""

import numpy as np

r, w, L, T = 3.0, 0.1, 2.0, 5.0


# %% cubic
def cubic(t, T, start, end):
    a2, a3 = 3 * (end - start) / T**2, -2 * (end - start) / T**3
    return start + a2 * t**2 + a3 * t**3, 2 * a2 * t + 3 * a3 * t**2


# %% heading_error
def heading_error(psi, psi_d):
    return (psi_d - psi + np.pi) % (2 * np.pi) - np.pi


# %% heading_rate
def heading_rate(v, a):
    return (v[0] * a[1] - v[1] * a[0]) / (v[0] ** 2 + v[1] ** 2)


# %% heading_at_stop
def heading_at_stop(a):
    psi = np.arctan2(-a[1], -a[0])
    return [np.cos(psi), np.sin(psi)]


# %% circle
def circle(t):
    c, s = np.cos(w * t), np.sin(w * t)
    q = [r * s, r - r * c, w * t]
    v = [r * w * c, r * w * s, w]
    a = [-r * w**2 * s, r * w**2 * c, 0]
    return np.array([q, v, a])


# %% peak_speed
peak_speed = cubic(T / 2, T, 0, L)[1]

# %% duration
T_m = 1.2 * np.sqrt(30 * 6 * L / 40)

# %%
MISTAKES = [
    ("cubic", "2 * a2 * t + 3 * a3 * t**2", "0, 0", "shape (3,)"),
    ("heading_error", "psi_d - psi", "psi - psi_d", "Only the sign is wrong"),
    ("circle", "r * s, r - r * c, w * t", "r - r * c, r * s, w * t", "differs"),
    ("peak_speed", "peak_speed =", "peak_speed = 1000 *", "factor of 1000"),
    ("duration", "1.2 *", "0.5 *", "It is too short"),
    ("duration", "1.2 *", "9 *", "It is too long"),
]  # fmt: skip
