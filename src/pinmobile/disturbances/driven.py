"""Forces that are functions of time alone: constant, sinusoidal, noise."""

from dataclasses import dataclass, field
from typing import Any, ClassVar, Self, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, frozen, positive, representable, seeded
from pinmobile.disturbances.protocol import not_below_zero, numbers, spread, triple
from pinmobile.errors import InvalidArgument

__all__ = ["ConstantForce", "NoiseForce", "SinusoidalForce", "noise_frequencies"]

_GOLDEN = 0.6180339887498949  # the golden ratio's fraction: its multiples never come close to repeating


@final
@dataclass(frozen=True, eq=False)
class ConstantForce:
    """A constant force in the inertial frame, such as a steady wind.

    Parameters
    ----------
    force : array_like, shape (..., 3)
        (Fx, Fy, Mz) [N, N, N m].

    Raises
    ------
    InvalidArgument
        If it has another shape or is not finite.
    """

    force: ArrayLike

    def __post_init__(self) -> None:
        object.__setattr__(self, "force", triple("force", self.force))

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., 3) [N, N, N m]."""
        force: Any = self.force
        return spread(force, t, q)


@final
@dataclass(frozen=True, eq=False)
class SinusoidalForce:
    """A force amplitude * sin(2 pi frequency t + phase) in the inertial frame.

    Parameters
    ----------
    amplitude : array_like, shape (..., 3)
        [N, N, N m].
    frequency : array_like, shape (...)
        [Hz], not below zero.
    phase : array_like, shape (...)
        [rad].

    Raises
    ------
    InvalidArgument
        If a shape does not fit, a value is not finite, or a frequency is below zero.
    """

    amplitude: ArrayLike
    frequency: ArrayLike
    phase: ArrayLike = 0.0

    def __post_init__(self) -> None:
        amplitude = triple("amplitude", self.amplitude)
        frequency = not_below_zero("frequency", numbers("frequency", self.frequency))
        phase = numbers("phase", self.phase)
        try:
            np.broadcast_shapes(amplitude.shape[:-1], frequency.shape, phase.shape)
        except ValueError:
            raise InvalidArgument(
                f"amplitude, frequency and phase have leading shapes {amplitude.shape[:-1]}, "
                f"{frequency.shape} and {phase.shape}, expected shapes that broadcast"
            ) from None
        for name, value in (("amplitude", amplitude), ("frequency", frequency), ("phase", phase)):
            object.__setattr__(self, name, value)

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., 3) [N, N, N m]."""
        amplitude, frequency, phase = (np.asarray(x) for x in (self.amplitude, self.frequency, self.phase))
        wave = np.sin(np.multiply(t, 2 * np.pi * frequency) + phase)
        return spread(amplitude * wave[..., None], t, q)


@final
@dataclass(frozen=True, eq=False)
class NoiseForce:
    """Band-limited noise in the inertial frame, a smooth function of time.

    The spectral representation (Shinozuka and Deodatis, Simulation of stochastic processes by spectral
    representation, 1991): with K = `TERMS` cosines of equal power, one in each K-th of the band at the
    frequencies f_kj of `noise_frequencies`, component j is::

        std_j sqrt(2 / K) sum_k cos(2 pi f_kj t + phases[k, j])

    Over the phases, its mean is 0 and its root mean square is `std`, exactly, at any time; its spectrum is
    flat up to `bandwidth`, and nothing beyond. No two components share a frequency, so over a time T their
    correlation goes to zero with 1 / T. Two forces of one bandwidth do share theirs: one force of the root of
    both squares is what they are meant to be.

    Parameters
    ----------
    std : array_like, shape (..., 3)
        Root mean square of (Fx, Fy, Mz) [N, N, N m], not below zero.
    bandwidth : float
        Highest frequency [Hz].
    seed : int, SeedSequence or Generator
        Of the phases. In an ensemble, each robot has phases of its own, which follow from this seed and the
        ensemble's.

    Attributes
    ----------
    phases : ndarray, shape (..., TERMS, 3)
        Phases of the cosines, uniform on [0, 2 pi) [rad].

    Raises
    ------
    InvalidArgument
        If a shape does not fit, a value is not finite or below zero, or `seed` is none.
    """

    TERMS: ClassVar[int] = 16

    std: ArrayLike
    bandwidth: float
    seed: Any
    phases: Array = field(init=False, repr=False)
    _rates: Array = field(init=False, repr=False)  # 2 pi f_kj [rad/s], shape (TERMS, 3)

    def __post_init__(self) -> None:
        drawn = seeded("seed", self.seed).uniform(0, 2 * np.pi, (self.TERMS, 3))
        self._set(self.std, self.bandwidth, drawn)

    @classmethod
    def of_phases(cls, std: ArrayLike, bandwidth: float, phases: ArrayLike) -> Self:
        """Return the noise with given phases; its seed is None.

        Parameters
        ----------
        std, bandwidth
            As in the class.
        phases : array_like, shape (..., TERMS, 3)
            Of the cosines [rad].

        Raises
        ------
        InvalidArgument
            If a shape does not fit, or a value is not finite or below zero.
        """
        force = object.__new__(cls)
        object.__setattr__(force, "seed", None)
        force._set(std, bandwidth, phases)
        return force

    def _set(self, std: ArrayLike, bandwidth: float, phases: ArrayLike) -> None:
        deviation, angles = not_below_zero("std", triple("std", std)), finite("phases", phases)
        if angles.shape[-2:] != (self.TERMS, 3):
            raise InvalidArgument(f"phases has shape {angles.shape}, expected (..., {self.TERMS}, 3)")
        try:
            np.broadcast_shapes(deviation.shape[:-1], angles.shape[:-2])
        except ValueError:
            raise InvalidArgument(
                f"std and phases have leading shapes {deviation.shape[:-1]} and {angles.shape[:-2]}, "
                "expected shapes that broadcast"
            ) from None
        object.__setattr__(self, "std", deviation)
        object.__setattr__(self, "bandwidth", positive("bandwidth", bandwidth, "Hz"))
        object.__setattr__(self, "phases", frozen(angles))
        with np.errstate(over="ignore"):
            rates = representable("2 pi bandwidth", 2 * np.pi * noise_frequencies(self.bandwidth))
        object.__setattr__(self, "_rates", frozen(rates))

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., 3) [N, N, N m]."""
        turned = np.multiply.outer(t, self._rates)  # (..., K, 3)
        waves = np.cos(turned + self.phases).sum(axis=-2)
        return spread(np.asarray(self.std) * np.sqrt(2 / self.TERMS) * waves, t, q)


def noise_frequencies(bandwidth: float) -> Array:
    """Return the frequencies of the components of `NoiseForce`, shape (TERMS, 3) [Hz].

    One for each component in each of the K equal parts of the band,
    f_kj = bandwidth (k + frac((k + 1) g + j / 3)) / K with the golden ratio's fraction g: no two of a
    component have a common multiple, so its sum never repeats; those of two components are at least 0.28 of a
    part apart.

    Parameters
    ----------
    bandwidth : float
        Highest frequency [Hz].
    """
    k = np.arange(NoiseForce.TERMS)[:, None]
    return np.asarray(bandwidth * (k + ((k + 1) * _GOLDEN + np.arange(3) / 3) % 1.0) / NoiseForce.TERMS)
