"""An ensemble in words: what its robots stay within, and how large errors and forces are."""

import numpy as np

from pinmobile.arrays import Array

__all__ = ["judgement", "percent", "ranges"]

_COORDINATES = (("x", "m", "Fx", "N"), ("y", "m", "Fy", "N"), ("psi", "rad", "Mz", "N m"))


def judgement(n: int, duration: float, within: tuple[float, float], diverged: int, after: float) -> str:
    """Return in one line what came of n robots.

    Parameters
    ----------
    n : int
        Number of robots.
    duration : float
        Of each run [s].
    within : tuple of 2 floats
        What 99 % of them stay within [m, rad]; infinite where fewer have not diverged.
    diverged : int
        How many did.
    after : float
        Time from which on errors count [s].
    """
    sizes = f"within {within[0]:.4g} m and {within[1]:.4g} rad"
    since = f"from {after:g} s on " if after else ""
    if n == 1:
        return f"1 robot over {duration:g} s: {'diverged' if diverged else f'{since}stays {sizes}'}"
    start = f"{n:,} robots over {duration:g} s: "
    if np.isinf(within[0]):
        return f"{start}{diverged:,} diverged, {percent(diverged, n).removesuffix(' of')}"
    sizes = f"{since}99 % stay {sizes}"
    return f"{start}{sizes}, {f'{diverged:,} diverged' if diverged else 'none diverged'}"


def percent(part: int, n: int) -> str:
    """Return a part of n in words: ``96 % of``, or ``all``; what is not all is never told as 100 %."""
    if part == n:
        return "all"
    share = 100 * part / n
    return f"{share:.2g} % of" if share < 99 else "more than 99 % of"


def ranges(max_distance: Array, max_error: Array, max_force: Array) -> list[str]:
    """Return a row for each error and force: the least, the median and the largest over the robots.

    Parameters
    ----------
    max_distance : ndarray, shape (n,)
        Largest distance from the desired position [m].
    max_error, max_force : ndarray, shape (n, 3)
        Largest error [m, m, rad] and force [N, N, N m].
    """
    columns = {"largest distance [m]": max_distance}
    for k, (name, unit, force, newton) in enumerate(_COORDINATES):
        columns[f"largest error of {name} [{unit}]"] = max_error[:, k]
        columns[f"largest {force} [{newton}]"] = max_force[:, k]
    rows = []
    for name, values in columns.items():
        good = values[np.isfinite(values)]
        if len(good):
            low, middle, high = np.quantile(good, (0.0, 0.5, 1.0))
            rows.append(f"{name:<28} least {low:.4g}, median {middle:.4g}, largest {high:.4g}")
    return rows
