"""What the caption says: time and errors, in units that suit them."""

from collections.abc import Mapping

import numpy as np

from pinmobile.arrays import Array
from pinmobile.simulation import Rollout
from pinmobile.viewer.motion import sampled

__all__ = ["captions"]

_POSE = ("x", "y", "psi")


def captions(runs: Mapping[str, Rollout], times: Array) -> list[str]:
    """Return time and position errors for each frame, changing ten times a second at most.

    Beside a position error stands the largest of a joint that turns, where there are any.

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
        f"{label}  " if label else "": sampled(at, run.t, np.column_stack(_sizes(run)))
        for label, run in runs.items()
    }
    joints = any(values.shape[1] > 1 for values in rows.values())
    what = "position error, largest of a joint" if joints else "position error"
    written: dict[int, str] = {}
    for k in np.unique(first):
        errors = [
            label + ", ".join(_short(*pair) for pair in zip(values[k].tolist(), ("m", "rad"), strict=False))
            for label, values in rows.items()
        ]
        written[int(k)] = "\n".join([f"t = {times[k]:.1f} s", what, *errors])
    return [written[int(k)] for k in first]


def _sizes(run: Rollout) -> list[Array]:
    """Return the position error [m] and the largest of a joint that turns [rad], if there is one."""
    turning = [k for k, one in enumerate(run.coordinates) if one.name not in _POSE and one.unit == "rad"]
    place = np.hypot(run.error[:, 0], run.error[:, 1])
    return [place, np.abs(run.error[:, turning]).max(axis=1)] if turning else [place]


def _short(value: float, unit: str) -> str:
    for scale, prefix in ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n")):
        if value >= 0.9995 * scale or prefix == "n":
            break
    digits = 2 if value < 9.995 * scale else 1 if value < 99.95 * scale else 0
    return f"{value / scale:.{digits}f} {prefix}{unit}"
