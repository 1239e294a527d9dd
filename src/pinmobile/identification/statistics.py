"""Statistics of estimates and residuals: Student's intervals and draws, whiteness, predictions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, bounded, scalar

NORMAL = 1.4826  # a normal distribution's standard deviation as a share of its median absolute one
_ROUNDS = 200  # in which draws that no robot has are drawn again
POSE = ("x", "m"), ("y", "m"), ("psi", "rad")
SPEEDS = ("speed", "m/s"), ("yaw rate", "rad/s")


class Prediction(NamedTuple):
    """What was measured, and what the identified robot does under the same input.

    Attributes
    ----------
    names, units : tuple of k str
        Of what was measured: x, y and psi, or speed and yaw rate.
    t : ndarray, shape (S, L)
        Times since the first sample, of segments each of which starts anew [s].
    measured, predicted : ndarray, shape (S, L, k)
        Values [m, m, rad; or m/s, rad/s].
    rms : ndarray, shape (k,)
        Of their difference, outliers left out.
    noise : ndarray, shape (k,)
        Deviation of the sensor's noise: what no prediction can be better than. Of a robot that takes speeds
        it is what the model left of the log that was identified from.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    t: Array
    measured: Array
    predicted: Array
    rms: Array
    noise: Array

    def __str__(self) -> str:
        told = [
            f"{name} {1e3 * rms:.3g} m{unit} (noise {1e3 * noise:.3g})"
            for name, unit, rms, noise in zip(self.names, self.units, self.rms, self.noise, strict=True)
        ]
        return f"rms of {self.t[0, -1] - self.t[0, 0]:.3g} s ahead: {', '.join(told)}"


def student_deviations(level: float, freedom: int) -> float:
    """Return how many standard deviations Student's interval has to each side."""
    from scipy.stats import t  # here, because it takes long to load

    share = bounded("level", scalar("level", level), above=0, below=1)
    return float(t.ppf(0.5 + share / 2, freedom))


def student_draws(
    n: int,
    centre: Array,
    root: Array,
    freedom: int,
    generator: np.random.Generator,
    is_possible: Callable[[Array], Any],
) -> Array:
    """Return draws of Student's t, shape (n, p), or fewer where hardly any is possible.

    Parameters
    ----------
    n : int
        How many.
    centre, root : ndarray, shape (p,), (p, p)
        Mean, and a root of the covariance.
    freedom : int
        Degrees of freedom.
    generator : Generator
        Source of the draws.
    is_possible : callable
        Which of some draws, shape (k, p), are of a robot; others are drawn again.
    """
    found = np.empty((0, len(centre)))
    for _ in range(_ROUNDS):
        missing = n - len(found)
        if not missing:
            break
        normal = generator.standard_normal((missing, len(centre)))
        wide = np.sqrt(freedom / generator.chisquare(freedom, missing))
        drawn = centre + wide[:, None] * (normal @ root.T)
        found = np.vstack([found, drawn[is_possible(drawn)]])
    return found


class Whiteness(NamedTuple):
    """Autocorrelation of residuals.

    Attributes
    ----------
    correlation : ndarray, shape (m,)
        Of successive residuals, of each thing measured.
    bound : float
        Within which that of white noise lies 95 times in 100.
    """

    correlation: Array
    bound: float

    @property
    def is_white(self) -> bool:
        """Whether the residuals look like white noise: by the correlation of successive ones."""
        return bool((np.abs(self.correlation) <= 1.5 * self.bound).all())


def whiteness(residuals: Array, good: NDArray[np.bool_]) -> Whiteness:
    """Return how white the residuals of segments are.

    Parameters
    ----------
    residuals : ndarray, shape (S, L, m)
        Zero where nothing was measured.
    good : ndarray of bool, shape (S, L)
        Where something was.
    """
    power = (residuals**2).sum(axis=(0, 1)) / good.sum()
    pairs = max((good[:, 1:] * good[:, :-1]).sum(), 1.0)
    product = (residuals[:, 1:] * residuals[:, :-1]).sum(axis=(0, 1)) / pairs
    return Whiteness(product / np.maximum(power, np.finfo(float).tiny), 1.96 / np.sqrt(float(good.sum())))
