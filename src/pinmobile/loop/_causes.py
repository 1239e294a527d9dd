"""Numbers of a spread that the worst robots of an ensemble share, by Kuiper's statistic."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, scalar
from pinmobile.errors import InvalidArgument
from pinmobile.loop._spread import SameAs
from pinmobile.parts import shorten

_CHANCE = 0.01  # that any of the parameters without effect is named
_SIDE_SHARE = 0.1  # share of the statistic below which one side counts as chance


class Cause(NamedTuple):
    """A parameter and the interval in which the worst robots have it.

    Attributes
    ----------
    name, unit : str
        Name and unit of the parameter.
    values : ndarray, shape (n,)
        Value of each robot.
    difference : float
        Kuiper's statistic of the worst against the others, 0 to 1.
    visible : bool
        Whether the difference is more than chance: by chance, any of the parameters is visible in 1 % of all
        ensembles.
    low, high : float
        Interval (low, high] of the worst robots; bounds may be infinite.
    outside : bool
        Whether the worst robots are outside the interval instead.
    """

    name: str
    unit: str
    values: Array
    difference: float
    visible: bool
    low: float
    high: float
    outside: bool

    @property
    def label(self) -> str:
        """Name and unit as an axis label."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @property
    def place(self) -> str:
        """Interval of the worst robots, in words."""
        unit = f" {self.unit}" if self.unit else ""
        if self.outside:
            return f"below {self.low:.3g} or above {self.high:.3g}{unit}"
        if np.isinf(self.low):
            return f"below {self.high:.3g}{unit}"
        if np.isinf(self.high):
            return f"above {self.low:.3g}{unit}"
        return f"from {self.low:.3g} to {self.high:.3g}{unit}"

    def holds(self, values: Array) -> NDArray[np.bool_]:
        """Return which values are in the interval of the worst robots."""
        is_inside = (values > self.low) & (values <= self.high)
        return ~is_inside if self.outside else is_inside


def worst_share(ensemble: Any, share: float, by: str = "distance") -> NDArray[np.bool_]:
    """Return a mask of the worst robots, shape (n,): the first of `Ensemble.worst`.

    Raises
    ------
    InvalidArgument, UnknownName
        If `share` is outside (0, 1) or leaves no robot on one side, or there is no error of this name.
    """
    part, n = scalar("share", share), len(ensemble)
    count = round(part * n)
    if not (0 < part < 1 and 0 < count < n):
        expected = "above 0 and below 1, with at least 1 robot on each side"
        raise InvalidArgument(f"share is {part}, {count:,} of {n:,} robots, expected {expected}")
    worst = np.zeros(n, bool)
    worst[ensemble.worst(count, by)] = True
    return worst


def causes(ensemble: Any, worst: NDArray[np.bool_]) -> list[Cause]:
    """Return the parameters that differ between robots, in descending order of Kuiper's statistic.

    Parameters
    ----------
    ensemble : Ensemble
        Ensemble of robots.
    worst : ndarray of bool, shape (n,)
        Mask of the worst robots.

    Raises
    ------
    InvalidArgument
        If all robots have the same parameters.
    """
    parameters = [one for one in _parameters(ensemble) if np.ptp(one[2]) > 1e-12 * np.abs(one[2]).max()]
    if not parameters:
        message = "ensemble has robots with the same parameters"
        raise InvalidArgument(f"{message}, expected a spread of at least one parameter")
    rows = (_cause(*one, worst, _CHANCE / len(parameters)) for one in parameters)
    return sorted(rows, key=lambda one: -one.difference)


def _parameters(ensemble: Any) -> list[tuple[str, str, Array]]:
    """Return name, unit and values of each independent parameter; for `SameAs`, the factor."""
    rows, short_names = [], dict(zip(ensemble.draws, shorten(ensemble.draws), strict=True))
    for name, values in ensemble.draws.items():
        source = ensemble.scenario.spread[name]
        if isinstance(source, SameAs) and (base := ensemble.draws.get(source.name)) is not None:
            ratio = np.divide(values, base, out=np.ones_like(values), where=base != 0)
            rows.append((f"{short_names[name]} / {short_names[source.name]}", "", ratio))
        else:
            rows.append((short_names[name], ensemble.scenario.parameters[name].unit, values))
    return rows


def _cause(name: str, unit: str, values: Array, worst: NDArray[np.bool_], chance: float) -> Cause:
    # scipy.stats is slow to load, and other figures do not need it.
    from scipy.stats import ks_2samp

    bad, good = values[worst], values[~worst]
    # Up to `high`, the excess of the worst robots is largest; up to `low`, the excess of the others.
    above, below = (ks_2samp(bad, good, alternative=side, method="asymp") for side in ("greater", "less"))
    high, low = float(above.statistic_location), float(below.statistic_location)
    difference = float(above.statistic + below.statistic)
    size = np.sqrt(len(bad) * len(good) / len(values))
    # Kuiper's test: Stephens, J. R. Stat. Soc. B 32 (1970).
    square = max(1.0, difference * (size + 0.155 + 0.24 / size)) ** 2
    visible = bool((8 * square - 2) * np.exp(-2 * square) < chance)
    if above.statistic <= _SIDE_SHARE * difference:
        high = np.inf
    elif below.statistic <= _SIDE_SHARE * difference:
        low = -np.inf
    outside = high < low
    low, high = sorted((low, high))
    return Cause(name, unit.replace("^2", "²"), values, difference, visible, low, high, outside)
