"""What the caption says: time and errors, in units that suit them."""

from collections.abc import Mapping

import numpy as np

from pinmobile.arrays import Array
from pinmobile.simulation import Rollout
from pinmobile.viewer.motion import sampled

__all__ = ["captions"]


def captions(runs: Mapping[str, Rollout], times: Array) -> list[str]:
    """Return time and position errors for each frame, changing ten times a second at most.

    Parameters
    ----------
    runs : mapping of str to Rollout
        By label.
    times : ndarray, shape (n,)
        Of the frames [s].
    """
    ticks = np.floor(10 * (times - times[0]) + 1e-6)
    first = np.searchsorted(ticks, ticks)  # the frame in which the tick began
    at = times[first]
    rows = {
        f"{label}  " if label else "": sampled(at, run.t, np.hypot(run.error[:, :1], run.error[:, 1:2]))[:, 0]
        for label, run in runs.items()
    }
    written: dict[int, str] = {}
    for k in np.unique(first):
        errors = [f"{label}{_length(values[k])}" for label, values in rows.items()]
        written[int(k)] = "\n".join([f"t = {times[k]:.1f} s", "position error", *errors])
    return [written[int(k)] for k in first]


def _length(value: float) -> str:
    for scale, unit in ((1.0, "m"), (1e-3, "mm"), (1e-6, "µm"), (1e-9, "nm")):
        if value >= 0.9995 * scale or unit == "nm":
            break
    return f"{value / scale:.{2 if value < 9.995 * scale else 1 if value < 99.95 * scale else 0}f} {unit}"
