"""`Prediction`: what was measured beside what an identified robot does under the same input."""

from __future__ import annotations

from typing import NamedTuple

from pinmobile.arrays import Array

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
        Deviation of the sensor's noise: what no prediction can be better than. Of a `VelocityIdentification`
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
