"""An error over a ladder of steps, and the order that it shows."""

from dataclasses import dataclass
from typing import final

import numpy as np

from pinmobile.arrays import Array, frozen

__all__ = ["EPS", "Convergence"]

EPS = float(np.finfo(np.float64).eps)
_LEAST = 0.5  # an order below is that of an error that stays
_ABOVE = 10.0  # times rounding, from where on an error is the method's


@final
@dataclass(frozen=True, eq=False)
class Convergence:
    """How an error shrinks with the step.

    Attributes
    ----------
    name, unit : str
        What is wrong, and in what it is measured; the unit is empty where the error is relative.
    steps : ndarray, shape (n,)
        Steps, the largest first [s].
    errors : ndarray, shape (n,)
        Error at each step; infinite where the run diverged.
    rounding : ndarray, shape (n,)
        What rounding alone may amount to at each step.
    """

    name: str
    unit: str
    steps: Array
    errors: Array
    rounding: Array

    def __post_init__(self) -> None:
        errors = np.where(np.isfinite(self.errors), self.errors, np.inf)
        for name, value in (("steps", self.steps), ("errors", errors), ("rounding", self.rounding)):
            object.__setattr__(self, name, frozen(value))

    @property
    def exact(self) -> bool:
        """Whether the error is that of rounding at every step."""
        return bool((self.errors <= self.rounding).all())

    @property
    def order(self) -> float | None:
        """The slope of log error over log step, by least squares over the errors well above rounding.

        None where fewer than two are: then there is nothing to fit.
        """
        clear = (self.errors > _ABOVE * self.rounding) & np.isfinite(self.errors)
        if clear.sum() < 2:
            return None
        return float(np.polyfit(np.log(self.steps[clear]), np.log(self.errors[clear]), 1)[0])

    @property
    def converges(self) -> bool:
        """Whether the error vanishes with the step, down to rounding: its order is above one half, if any."""
        order = self.order
        return bool(np.isfinite(self.errors).all()) if order is None else order > _LEAST

    def __str__(self) -> str:
        if self.exact:
            return "exact to rounding"
        order = self.order
        if order is None:
            return "diverges" if np.isinf(self.errors).any() else "too close to rounding to tell"
        return f"order {order:.2f}" if self.converges else "does not converge"
