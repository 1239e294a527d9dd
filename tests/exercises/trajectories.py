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
    ("cubic", "2 * a2 * t + 3 * a3 * t**2", "a2 * t + a3 * t**2", "The factors 2 and 3 are missing"),
    ("cubic", "2 * a2 * t + 3 * a3 * t**2", "(2 * a2 * t + 3 * a3 * t**2) * T", "A factor 1 / T is missing"),
    ("cubic", "start + a2", "a2", "The start is missing"),
    ("cubic", "2 * a2 * t + 3 * a3 * t**2", "0, 0", "shape (3,)"),
    ("heading_error", "return (psi_d - psi + np.pi) % (2 * np.pi) - np.pi", "return psi_d - psi",
     "plain difference"),
    ("heading_error", "psi_d - psi", "psi - psi_d", "Only the sign is wrong"),
    ("heading_error", "+ np.pi) % (2 * np.pi) - np.pi", ") % (2 * np.pi)", "between 0 and 2 pi"),
    ("heading_rate", "- v[1] * a[0]", "+ v[1] * a[0]", "The second term has the wrong sign"),
    ("heading_rate", "(v[0] ** 2 + v[1] ** 2)", "np.hypot(*v)", "divided by its square"),
    ("heading_rate", " - v[1] * a[0]", "", "The second term, v_y a_x, is missing"),
    ("heading_at_stop", "-a[1], -a[0]", "a[1], a[0]", "just after a start"),
    ("heading_at_stop", "-a[1], -a[0]", "-a[0], -a[1]", "atan2 takes y first"),
    ("heading_at_stop", "-a[1], -a[0]", "0, 0", "atan2(0, 0)"),
    ("circle", "r - r * c", "-r * c", "about the origin"),
    ("circle", "[q, v, a]", "[q, v, -np.array(a)]", "away from the centre"),
    ("circle", "r * s, r - r * c, w * t", "r - r * c, r * s, w * t", "differs"),
    ("peak_speed", "cubic(T / 2, T, 0, L)[1]", "L / T", "This is the mean speed"),
    ("peak_speed", "peak_speed =", "peak_speed = 1000 *", "factor of 1000"),
    ("peak_speed", "cubic(T / 2, T, 0, L)[1]", "1.875 * L / T", "degree five"),
    ("duration", "1.2 *", "0.5 *", "It is too short"),
    ("duration", "1.2 *", "9 *", "It is too long"),
]  # fmt: skip
