"""Which parameters the worst robots of an ensemble have in common: what `drivers` draws."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, scalar
from pinmobile.ensembles import Ensemble, Same
from pinmobile.errors import InvalidArgument

__all__ = ["Cause", "causes", "worst_share"]

_CRITICAL = 2.001  # of Kuiper's test at 1 %: Stephens, J. R. Stat. Soc. B 32 (1970)
_ONE_SIDED = 0.1  # of the statistic; what the other side adds, if less, is chance


class Cause(NamedTuple):
    """A parameter, and where the worst robots have it.

    Attributes
    ----------
    name, unit : str
        Of the parameter.
    values : ndarray, shape (n,)
        What each robot got.
    difference : float
        Kuiper's statistic of the worst against the others, 0 to 1.
    visible : bool
        Whether that is more than chance allows.
    low, high : float
        The worst have it above the one and up to the other; these may be infinite.
    outside : bool
        Whether they have it outside that interval instead.
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
        """Name and unit, for an axis."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @property
    def place(self) -> str:
        """Where the worst robots have it, in words."""
        unit = f" {self.unit}" if self.unit else ""
        if self.outside:
            return f"below {self.low:.3g} or above {self.high:.3g}{unit}"
        if np.isinf(self.low):
            return f"below {self.high:.3g}{unit}"
        if np.isinf(self.high):
            return f"above {self.low:.3g}{unit}"
        return f"from {self.low:.3g} to {self.high:.3g}{unit}"

    def holds(self, values: Array) -> NDArray[np.bool_]:
        """Tell which values are where those of the worst robots are."""
        between = (values > self.low) & (values <= self.high)
        return ~between if self.outside else between


def worst_share(ensemble: Ensemble, share: float, by: str = "distance") -> NDArray[np.bool_]:
    """Return which robots are the worst, shape (n,): the first of `Ensemble.worst`.

    Raises
    ------
    InvalidArgument, UnknownName
        If `share` is not above 0 and below 1, or leaves no robot on one side; or there is no such error.
    """
    part, n = scalar("share", share), len(ensemble)
    count = round(part * n)
    if not (0 < part < 1 and 0 < count < n):
        raise InvalidArgument(
            f"share is {part}, {count:,} of {n:,} robots; expected above 0 and below 1, and at least 1 robot "
            "on either side"
        )
    worst = np.zeros(n, bool)
    worst[ensemble.worst(count, by)] = True
    return worst


def causes(ensemble: Ensemble, worst: NDArray[np.bool_]) -> list[Cause]:
    """Return the parameters in which robots differ, the one that tells the worst apart best first.

    Parameters
    ----------
    ensemble : Ensemble
        Whose parameters.
    worst : ndarray of bool, shape (n,)
        Which robots are the worst.

    Raises
    ------
    InvalidArgument
        If the robots differ in no parameter.
    """
    found = [
        _cause(name, unit, values, worst)
        for name, unit, values in _parameters(ensemble)
        if np.ptp(values) > 1e-12 * np.abs(values).max()
    ]
    if not found:
        raise InvalidArgument(
            "ensemble has robots that differ in no parameter, expected a spread in which they do"
        )
    return sorted(found, key=lambda one: -one.difference)


def _parameters(ensemble: Ensemble) -> list[tuple[str, str, Array]]:
    """Return name, unit and values of what is drawn by itself; of a `Same`, the factor."""
    found = []
    for name, values in ensemble.draws.items():
        source: Any = ensemble.scenario.spread[name]
        base = ensemble.draws.get(source.name) if isinstance(source, Same) else None
        if base is None:
            found.append((name, ensemble.scenario.parameters[name].unit, values))
        else:
            ratio = np.divide(values, base, out=np.ones_like(values), where=base != 0)
            found.append((f"{name} / {source.name}", "", ratio))
    return found


def _cause(name: str, unit: str, values: Array, worst: NDArray[np.bool_]) -> Cause:
    # Here, because scipy.stats takes longer to load than all that other figures need.
    from scipy.stats import ks_2samp

    bad, good = values[worst], values[~worst]
    # Up to `more`, there is most in excess of the worst's values; up to `fewer`, of the others'.
    above, below = (ks_2samp(bad, good, alternative=side, method="asymp") for side in ("greater", "less"))
    more, fewer = float(above.statistic_location), float(below.statistic_location)
    difference = float(above.statistic + below.statistic)
    size = np.sqrt(len(bad) * len(good) / len(values))
    visible = bool(difference * (size + 0.155 + 0.24 / size) > _CRITICAL)
    low, high, outside = fewer, more, False
    if above.statistic <= _ONE_SIDED * difference:
        high = np.inf
    elif below.statistic <= _ONE_SIDED * difference:
        low = -np.inf
    elif more < fewer:
        low, high, outside = more, fewer, True
    return Cause(name, unit.replace("^2", "²"), values, difference, visible, low, high, outside)
