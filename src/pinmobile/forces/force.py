"""What a force is, and those that are functions of time alone: constant, sinusoidal, noise."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field
from typing import Any, ClassVar, Protocol, Self, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, frozen, positive, representable, seeded, vector
from pinmobile.errors import InvalidArgument
from pinmobile.parts import array, number, part
from pinmobile.plant import Parameter


class Force(Protocol):
    """A generalised force on the body, as a function of time and state.

    Any callable of this form will do in `simulate`, which asks it at every stage of the integrator. One with
    ``signals(t, q, v) -> {name: (unit, value)}`` tells once per sample what is worth recording.
    """

    def __call__(self, t: float, q: Array, v: Array, /) -> Array:
        """Return (Fx, Fy, Mz) along the inertial axes, shape (..., 3) [N, N, N m].

        Parameters
        ----------
        t : float or ndarray, shape (...)
            Time [s].
        q, v : ndarray, shape (..., 3)
            Pose [m, m, rad] and its rate [m/s, m/s, rad/s].
        """


class CoordinateForce(Protocol):
    """A generalised force on all coordinates of a plant, such as friction in its joints."""

    def on_coordinates(self, t: float, q: Array, v: Array, /) -> Array:
        """Return the force, shape (..., nv), in the units of the plant's coordinates.

        Parameters
        ----------
        t : float or ndarray, shape (...)
            Time [s].
        q, v : ndarray, shape (..., nq) and (..., nv)
            Configuration and velocity.
        """


def triple(name: str, value: ArrayLike) -> Array:
    """Return `value` as a read-only array, shape (..., 3).

    Raises
    ------
    InvalidArgument
        If it has another shape or is not finite.
    """
    return frozen(vector(name, value, 3))


def numbers(name: str, value: ArrayLike) -> Array:
    """Return `value` as a read-only array, shape (...).

    Raises
    ------
    InvalidArgument
        If it is not finite.
    """
    return frozen(finite(name, value))


def not_below_zero(name: str, value: Array) -> Array:
    """Check that no entry is below zero, and return `value`, shape (...).

    Raises
    ------
    InvalidArgument
        If there is one.
    """
    if (value < 0).any():
        raise InvalidArgument(f"{name} is {value[value < 0][0]}, expected >= 0")
    return value


def spread(tau: Array, t: ArrayLike, q: Array) -> Array:
    """Return `tau`, shape (..., 3), as one for each of the times and poses."""
    shape = np.shape(q)
    if tau.shape == shape and not np.ndim(t):
        return tau
    return np.broadcast_to(tau, np.broadcast_shapes(tau.shape, shape, (*np.shape(t), 1)))


def since(t: ArrayLike, begin: ArrayLike) -> Array:
    """Return 1 from a time on [s] and 0 before it, to the rounding of times, shape (...)."""
    return np.where(np.subtract(t, begin) > -_ROUNDING, 1.0, 0.0)


_ROUNDING = 1e-9  # [s]
_GOLDEN = 0.6180339887498949  # the golden ratio's fraction: its multiples never come close to repeating


AXES = ("x", "y", "moment")
"""Labels of a wrench on the body."""


@final
@part
class ConstantForce:
    """A constant force in the inertial frame, such as a steady wind, or a push.

    Parameters
    ----------
    force : array_like, shape (..., 3)
        (Fx, Fy, Mz) [N, N, N m].
    begin : float
        From which time on it acts [s].
    end : float, optional
        From which time on it acts no more [s]; by default it does not end.

    Raises
    ------
    InvalidArgument
        If it has another shape or is not finite, or does not end after it begins.
    """

    force: Any = array(shapes=((3,),), unit="N, N, N m", labels=AXES, doc="constant force")
    begin: float = number(default=0.0, unit="s", doc="time from which the force acts")
    end: float = number(default=np.inf, unit="s", endless=True, doc="time from which it acts no more")

    def check(self) -> None:
        """Raise `InvalidArgument` where the force ends before it begins."""
        if not self.end > self.begin:
            raise InvalidArgument(f"end is {self.end} s, expected above begin, {self.begin} s")

    @classmethod
    def nothing(cls) -> Self:
        """Return the force that is none, which a spread gives its size."""
        return cls(np.zeros(3))

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., 3) [N, N, N m]."""
        acts = since(t, self.begin) * (1.0 - since(t, self.end))
        return self.force * acts[..., None] + 0.0 * q


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

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("sine_x", "N", "amplitude of the sinusoidal force along x", attribute="amplitude", entry=0),
        Parameter("sine_y", "N", "amplitude of the sinusoidal force along y", attribute="amplitude", entry=1),
        Parameter("sine_moment", "N m", "amplitude of the sinusoidal moment", attribute="amplitude", entry=2),
        Parameter("sine_frequency", "Hz", "its frequency", 0.0, attribute="frequency"),
        Parameter("sine_phase", "rad", "its phase", attribute="phase"),
    )
    needs: ClassVar[str] = "sine_frequency"

    @classmethod
    def nothing(cls) -> Self:
        """Return the force that is none, which a spread gives its size and its frequency."""
        return cls(np.zeros(3), 0.0)

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
    in_phase, quadrature : ndarray, shape (..., TERMS, 3)
        Their cosines and sines.

    Raises
    ------
    InvalidArgument
        If a shape does not fit, a value is not finite or below zero, or `seed` is none.
    """

    TERMS: ClassVar[int] = 16

    std: ArrayLike
    bandwidth: float
    seed: int | np.random.SeedSequence | np.random.Generator | None  # None: of given phases
    phases: Array = field(init=False, repr=False)
    in_phase: Array = field(init=False, repr=False)
    quadrature: Array = field(init=False, repr=False)
    _rates: Array = field(init=False, repr=False)  # 2 pi f_kj [rad/s], shape (TERMS, 3)

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("noise_x", "N", "rms of the noise force along x", 0.0, attribute="std", entry=0),
        Parameter("noise_y", "N", "rms of the noise force along y", 0.0, attribute="std", entry=1),
        Parameter("noise_moment", "N m", "rms of the noise moment", 0.0, attribute="std", entry=2),
    )
    drawn: ClassVar[tuple[str, ...]] = ("in_phase", "quadrature")
    determined_by: ClassVar[tuple[str, ...]] = ("std", "bandwidth", "phases")  # its seed may be a Generator

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
        object.__setattr__(self, "in_phase", frozen(np.cos(angles)))
        object.__setattr__(self, "quadrature", frozen(np.sin(angles)))
        with np.errstate(over="ignore"):
            rates = representable("2 pi bandwidth", 2 * np.pi * noise_frequencies(self.bandwidth))
        object.__setattr__(self, "_rates", frozen(rates))

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., 3) [N, N, N m]."""
        turned = np.asarray(t)[..., None, None] * self._rates  # (..., K, 3), the same for all robots
        waves = self.in_phase * np.cos(turned) - self.quadrature * np.sin(turned)
        return spread(np.asarray(self.std) * np.sqrt(2 / self.TERMS) * waves.sum(axis=-2), t, q)

    def draw(self, generator: np.random.Generator, count: int) -> dict[str, Array]:
        """Return phases for robots that have their own, as `in_phase` and `quadrature`, (count, TERMS, 3)."""
        phases = generator.uniform(0, 2 * np.pi, (count, self.TERMS, 3))
        return {"in_phase": np.cos(phases), "quadrature": np.sin(phases)}

    def with_parameters(self, **values: Array) -> Self:
        """Return it with another `std`, `in_phase` or `quadrature`."""
        new = copy(self)
        for name, value in values.items():
            object.__setattr__(new, name, frozen(np.asarray(value, np.float64)))
        if "in_phase" in values:
            object.__setattr__(new, "phases", frozen(np.arctan2(new.quadrature, new.in_phase)))
        return new

    @property
    def stream(self) -> bytes:
        """What the drawn phases of robots follow from, beside their ensemble's seed."""
        return self.phases.tobytes()


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
