"""`Whiteness`: whether what a model leaves of a log is the noise of sensors, which does not remember."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinmobile.arrays import Array

_LAGS = 20


class Whiteness(NamedTuple):
    """Autocorrelation of residuals.

    Attributes
    ----------
    correlation : ndarray, shape (m,)
        Of successive residuals, of each thing measured.
    bound : float
        Within which that of white noise lies 95 times in 100.
    p_value : ndarray, shape (m,)
        Of the test of Ljung and Box (1978) with 20 lags: how likely white noise is to look like this.
    """

    correlation: Array
    bound: float
    p_value: Array

    @property
    def is_white(self) -> bool:
        """Whether the residuals look like white noise: by the correlation of successive ones."""
        return bool((np.abs(self.correlation) <= 1.5 * self.bound).all())


def whiteness(residuals: Array, good: Array) -> Whiteness:
    """Return how white the residuals of segments are.

    Parameters
    ----------
    residuals : ndarray, shape (S, L, m)
        Zero where nothing was measured.
    good : ndarray, shape (S, L)
        1 where something was.
    """
    from scipy.stats import chi2  # here, because it takes long to load

    power = (residuals**2).sum(axis=(0, 1)) / good.sum()
    count = float(good.sum())
    correlations = []
    for lag in range(1, min(_LAGS, residuals.shape[1] - 1) + 1):
        pairs = (good[:, lag:] * good[:, :-lag]).sum()
        product = (residuals[:, lag:] * residuals[:, :-lag]).sum(axis=(0, 1))
        correlations.append(product / max(pairs, 1.0) / np.maximum(power, np.finfo(float).tiny))
    rho = np.array(correlations)
    lags = np.arange(1, len(rho) + 1)[:, None]
    Q = count * (count + 2) * (rho**2 / (count - lags)).sum(axis=0)
    return Whiteness(rho[0], 1.96 / np.sqrt(count), np.asarray(chi2.sf(Q, len(rho))))
