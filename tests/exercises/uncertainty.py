"""Answers to exercise 6, and answers with mistakes."""

import numpy as np

I_cz, r, w, kp, kd, m, m_hat = 1.3, 3.0, 0.1, 4.0, 4.0, 30.0, 50.0


# %% circle_errors
def circle_errors(m, m_hat):
    needed, supplied = m * r * w**2, m_hat * r * w**2
    return [abs(needed - supplied) / (kp * m_hat), needed / (kp * m_hat)]


# %% break_even
break_even = m_hat / 2


# %% error_quantiles
def error_quantiles(delta):
    return np.array([0.99 * delta, 1 + 0.98 * delta]) * r * w**2 / kp


# %% share_within
def share_within(errors, bound):
    return sum(error <= bound for error in errors) / len(errors)


# %% eigenvalue
def eigenvalue(c):
    M = np.array([[m, 0, 0], [0, m, m * c], [0, m * c, I_cz + m * c**2]])
    return np.max(np.linalg.eigvals(np.linalg.solve(M, np.diag([m, m, I_cz]))).real)


# %% largest_offset
mu = 2 / (kd * 0.1)
largest_offset = np.sqrt((mu + 1 / mu - 2) * I_cz / m)

# %% controller
mass, gain = 30, 7

# %%
MISTAKES = [
    ("break_even", "/ 2", "/ 2 * 1000", "g and kg"),
    ("share_within", "return", "return 100 *", "per cent"),
    ("eigenvalue", "I_cz + m * c**2", "I_cz", "differs"),
    ("eigenvalue", "m * c, I_cz", "0, I_cz", "differs"),
    ("controller", "30, 7", "20, 7", "The model is too light"),
    ("controller", "30, 7", "40, 7", "The model is too heavy"),
    ("controller", "30, 7", "30, 2", "The gain is too small"),
    ("controller", "30, 7", "30, 15", "The gain is too large"),
    ("controller", "30, 7", "-30, 7", "must be above 0"),
]  # fmt: skip
