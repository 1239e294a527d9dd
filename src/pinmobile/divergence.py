"""When a closed loop has diverged: one rule, which all engines ask."""

from __future__ import annotations

from typing import Any

import numpy as np


def is_near(errors: Any, limit: Any) -> Any:
    """Return where no error is beyond the limit, shape (...); what is no number is beyond.

    Parameters
    ----------
    errors : ndarray, shape (..., n)
        Of coordinates and of their rates [m, rad, m/s, rad/s].
    limit : float
        Largest size.
    """
    return np.all(np.abs(errors) <= limit, axis=-1)


def is_alive(errors: Any, limit: Any, u: Any, a: Any) -> Any:
    """Return at which samples a loop has not diverged, shape (...): the rule of all engines.

    A loop has diverged where an error or its rate is beyond the limit, or its input or acceleration is not
    finite.

    Parameters
    ----------
    errors, limit
        As in `is_near`.
    u, a : ndarray, shape (..., nu), (..., nv)
        Input and acceleration.
    """
    return is_near(errors, limit) & (np.abs(np.sum(u, axis=-1) + np.sum(a, axis=-1)) < np.inf)
