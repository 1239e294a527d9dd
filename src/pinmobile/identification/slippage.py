"""`Slippage`: by how much poses of a log move otherwise than its wheels roll."""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.identification.chassis import Chassis
from pinmobile.identification.cleaning import Cleaned

_WINDOW = 0.4  # [s] over which velocities are averaged, so that the noise of poses is 2 mm/s for each mm
_MEASURED = 0.9  # of a window
_CERTAIN = 5.0  # deviations of what noise alone would lead to
_LARGE = 4.0  # deviations, of a window in which wheels slip
_TOLD, _MOST = 0.01, 0.1  # of the speed: what is told, and with what masses are of no use
_LIKE = 1.5  # ratio, or its inverse: no radius is stated as wrongly as that
_MOSTLY = 0.8  # of the mean square


class Slippage(NamedTuple):
    """How far the poses of a log are from rolling.

    Velocities of the body that poses tell, less those that encoders tell, or where there are none less the
    nearest at which wheels roll, averaged over windows of 0.4 s. Yaw rates count by the speed of the wheels'
    contacts.

    Attributes
    ----------
    speed, noise : float
        Root of the mean square of the difference, that of the noise taken off, and of the noise [m/s].
    share : float
        The first as a share of the speed of the motion.
    time : float
        Share of the time in which it is more than the noise, and more than a hundredth of the speed.
    is_certain : bool
        Whether noise alone is no explanation.
    ratios : ndarray, shape (3,)
        Of the velocities that poses and encoders tell, forward, left and in yaw, that fit best; not numbers
        where there are no encoders, or wheels cannot move the body so.
    by_ratios : float
        Share of the mean square that these explain.
    """

    speed: float
    noise: float
    share: float
    time: float
    is_certain: bool
    ratios: Array
    by_ratios: float

    @property
    def matters(self) -> bool:
        """Whether it is certain, and large enough to be told."""
        return self.is_certain and self.share > _TOLD

    def __str__(self) -> str:
        return f"poses {self._told}"

    @property
    def _told(self) -> str:
        known = np.isfinite(self.ratios)
        ratios = self.ratios[known]
        like = self.by_ratios > _MOSTLY and ((ratios < _LIKE) & (ratios > 1 / _LIKE)).all()
        axes = [name for name, is_so in zip(("forward", "left", "in yaw"), known, strict=True) if is_so]
        each = " and ".join(f"{ratio:.3g} {axis}" for ratio, axis in zip(ratios, axes, strict=True))
        why = (
            f"ratios of {each} explain it, as of wheels of another radius or place than is stated"
            if like
            else "they slip, or poses are of another point or time, or encoders of another sign or order"
        )
        return (
            f"move otherwise than wheels roll, by {self.speed:.3g} m/s, {self.share:.1%} of the speed, in "
            f"{self.time:.0%} of the time, where noise explains {self.noise:.2g} m/s: {why}"
        )

    @classmethod
    def of(cls, run: Cleaned, chassis: Chassis, name: str = "log") -> Self | None:
        """Return that of a log; None where it cannot be told, as of a body that is pushed.

        Raises
        ------
        InvalidArgument
            If masses could not be told with as much of it; the message has the name.
        """
        if not chassis.wheels or (run.rates is None and chassis.free == 3):
            return None
        size = 2 * round(_WINDOW / run.dt / 2) + 1
        g = (1 - np.linspace(-1, 1, size + 2)[1:-1] ** 2) ** 3
        g /= g.sum()
        moved = run.twist
        rolled = run.free_velocities(chassis) @ chassis.S.T
        columns = np.concatenate([moved, rolled, run.good[:, None]], axis=1)
        means = np.lib.stride_tricks.sliding_window_view(columns, size, axis=0)[:: size // 4 + 1] @ g
        means = means[means[:, -1] > _MEASURED]
        if len(means) < 2:
            return None
        per_rate = chassis.A @ np.linalg.pinv(chassis.S)
        metric = np.array([1.0, 1.0, np.sqrt((per_rate[:, 2] ** 2).sum() / (per_rate[:, :2] ** 2).sum())])
        moved, rolled = means[:, :3] * metric, means[:, 3:6] * metric
        off = moved - rolled
        variance = (run.noise * metric) ** 2 * (np.diff(g, prepend=0.0, append=0.0) ** 2).sum() / run.dt**2
        told = 3
        if run.rates is None:  # velocities at which wheels roll are no difference
            free = np.eye(3) - chassis.S @ np.linalg.pinv(chassis.S)
            variance, told = (free**2) @ variance, 3 - chassis.free
        elif run.rates_noise is not None:
            gains = chassis.S @ np.linalg.pinv(chassis.A)
            variance = variance + metric**2 * (gains**2 @ run.rates_noise**2) * (g**2).sum()
        noise, motion = float(variance.sum()), float((moved**2).sum(axis=1).mean())
        each = (off**2).sum(axis=1)
        excess = float(each.mean()) - noise
        alone = max(len(run.q) / size * told, 1.0)  # numbers that do not hang together
        certain = excess > _CERTAIN * noise * np.sqrt(2 / alone) and excess > 0
        least = max(_LARGE**2 * noise, _TOLD**2 * motion)
        ratios, left = np.full(3, np.nan), off
        if run.rates is not None:
            power = (rolled**2).sum(axis=0)
            with np.errstate(all="ignore"):
                ratios = np.where(power > 1e-6 * power.sum(), (moved * rolled).sum(axis=0) / power, np.nan)
            left = moved - np.nan_to_num(ratios) * rolled
        after = max(float((left**2).sum(axis=1).mean()) - noise, 0.0)
        found = cls(
            float(np.sqrt(max(excess, 0.0))),
            float(np.sqrt(noise)),
            float(np.sqrt(max(excess, 0.0) / max(motion, 1e-300))),
            float((each > least).mean()),
            bool(certain),
            ratios,
            1 - after / excess if excess > 0 else 0.0,
        )
        if found.matters and found.share > _MOST:
            raise InvalidArgument(f"{name} has poses that {found._told}; expected wheels that roll")
        return found
