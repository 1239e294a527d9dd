"""Forces that no controller asked for: disturbances, friction, rolling resistance."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, ClassVar, Protocol, Self, final

import attrs
import numpy as np

from pinmobile.arrays import Array, ArrayLike, frozen, representable, seeded, sequence, shaped, text
from pinmobile.errors import InvalidArgument, shown
from pinmobile.parts import (
    Number,
    array,
    declare,
    number,
    option,
    part,
)
from pinmobile.plant import coordinates_of


class Force(Protocol):
    """A generalised force on the body, as a function of time and state.

    Any callable of this form is a force; the loop calls it at every stage of the integrator. An optional
    ``signals(t, pose, rate) -> {name: (unit, value)}`` returns further series to record, once per sample.
    """

    def __call__(self, t: float, pose: Array, rate: Array, /) -> Array:
        """Return (Fx, Fy, Mz) along the inertial axes, shape (..., 3) [N, N, N m].

        Parameters
        ----------
        t : float or ndarray, shape (...)
            Time [s].
        pose, rate : ndarray, shape (..., 3)
            Of the body [m, m, rad], and its rate [m/s, m/s, rad/s].
        """


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
_TERMS = 16
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

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., 3) [N, N, N m]."""
        acts = since(t, self.begin) * (1.0 - since(t, self.end))
        return self.force * acts[..., None] + 0.0 * q  # type: ignore[no-any-return]


@final
@part
class SinusoidalForce:
    """A force amplitude * sin(2 pi frequency t + phase) in the inertial frame."""

    amplitude: Any = array(
        shapes=((3,),), unit="N, N, N m", labels=AXES, doc="amplitude of the sinusoidal force"
    )
    frequency: float = number(lower=0, unit="Hz", doc="frequency of the sinusoidal force")
    phase: float = number(default=0.0, unit="rad", doc="phase of the sinusoidal force")

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., 3) [N, N, N m]."""
        wave = np.sin(np.multiply(t, 2 * np.pi * self.frequency) + self.phase)
        return spread(self.amplitude * wave[..., None], t, q)


def _of_phases(doc: str, function: Any) -> Any:
    default = attrs.Factory(lambda force: function(force.phases), takes_self=True)
    return declare(Number(doc, shapes=((_TERMS, 3),)), default, kw_only=True, repr=False)


@final
@part
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

    In an ensemble, each robot has phases of its own, which follow from `seed` and the ensemble's.
    """

    TERMS: ClassVar[int] = _TERMS
    drawn: ClassVar[tuple[str, ...]] = ("phases", "in_phase", "quadrature")
    determined_by: ClassVar[tuple[str, ...]] = ("std", "bandwidth", "phases")  # its seed may be a Generator

    std: Any = array(
        shapes=((3,),), lower=0, unit="N, N, N m", labels=AXES, doc="root mean square of the noise force"
    )
    bandwidth: float = number(above=0, unit="Hz", fixed=True, doc="highest frequency of the noise")
    seed: Any = option(doc="seed of the phases: int, SeedSequence or Generator; None of given phases")
    phases: Any = declare(
        Number("phases of the cosines, uniform on [0, 2 pi)", "rad", shapes=((_TERMS, 3),), fixed=True),
        attrs.Factory(lambda force: force._uniform(seeded("seed", force.seed)), takes_self=True),
        kw_only=True,
        repr=False,
    )
    in_phase: Any = _of_phases("cosines of the phases", np.cos)
    quadrature: Any = _of_phases("sines of the phases", np.sin)

    @classmethod
    def of_phases(cls, std: ArrayLike, bandwidth: float, phases: ArrayLike) -> Self:
        """Return the noise with given phases of the cosines, shape (TERMS, 3) [rad]; its seed is None."""
        return cls(std, bandwidth, None, phases=phases)

    def _uniform(self, generator: np.random.Generator, *count: int) -> Array:
        return generator.uniform(0, 2 * np.pi, (*count, self.TERMS, 3))

    def check(self) -> None:
        """Raise `InvalidArgument` where a frequency is beyond the largest number."""
        self._rates  # noqa: B018

    @cached_property
    def _rates(self) -> Array:
        """2 pi f_kj, shape (TERMS, 3) [rad/s]."""
        with np.errstate(over="ignore"):
            return frozen(representable("2 pi bandwidth", 2 * np.pi * noise_frequencies(self.bandwidth)))

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., 3) [N, N, N m]."""
        turned = np.asarray(t)[..., None, None] * self._rates  # (..., K, 3), the same for all robots
        waves = self.in_phase * np.cos(turned) - self.quadrature * np.sin(turned)
        return spread(self.std * np.sqrt(2 / self.TERMS) * waves.sum(axis=-2), t, q)

    def draw(self, generator: np.random.Generator, count: int) -> dict[str, Array]:
        """Return the `drawn` fields of robots that have phases of their own, shape (count, TERMS, 3)."""
        phases = self._uniform(generator, count)
        return {"phases": phases, "in_phase": np.cos(phases), "quadrature": np.sin(phases)}

    @property
    def stream(self) -> bytes:
        """What the drawn phases of robots follow from, beside their ensemble's seed."""
        return bytes(self.phases.tobytes())


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


@final
@part
class PayloadForce:
    """A load on the body from a time on, which then moves with it.

    The velocity is continuous: the load comes at the velocity of the place where it is put. One that is put
    down at rest would slow the robot by a share of mass / (robot's mass + mass), a jump that no force makes.
    It changes inertia alone: what it weighs is not felt by wheels, tip-over margins and friction.

    With m, (x, y) and I below, and the body at psi, r = psi', it adds to the body's mass matrix and forces::

        [[m, 0, -m k1], [0, m, m k2], [-m k1, m k2, I + m (x^2 + y^2)]]     (m k2 r^2, m k1 r^2, 0)

    with ``k1 = y cos psi + x sin psi`` and ``k2 = x cos psi - y sin psi``, as the closed form of a body does.
    """

    mass: float = number(lower=0, unit="kg", doc="mass of the payload")
    at: Any = array(
        shapes=((2,),), unit="m", labels=("x", "y"), doc="position of the payload, forward and left"
    )
    when: float = number(unit="s", doc="time from which the payload is on the body")
    yaw_inertia: float = number(
        default=0.0, lower=0, unit="kg m^2", doc="yaw inertia of the payload about its own centre of mass"
    )

    def _lever(self, pose: Array) -> tuple[Array, Array]:
        """Return k1 and k2 of the class, shape (...) [m]."""
        x, y = self.at[..., 0], self.at[..., 1]
        cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        return y * cos + x * sin, x * cos - y * sin

    def inertia(self, t: ArrayLike, q: Array) -> Array:
        """Return the mass matrix that it adds to the body, shape (..., 3, 3) [kg, kg m, kg m^2].

        Parameters
        ----------
        t : float or ndarray, shape (...)
            Time [s].
        q : ndarray, shape (..., 3)
            Pose of the body [m, m, rad].
        """
        x, y = self.at[..., 0], self.at[..., 1]
        k1, k2 = self._lever(q)
        here = since(t, self.when) + 0.0 * k1
        m = here * self.mass
        izz = here * self.yaw_inertia + m * (x * x + y * y)
        rows = [[m, 0.0 * m, -m * k1], [0.0 * m, m, m * k2], [-m * k1, m * k2, izz]]
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return what it does beside its mass matrix, shape (..., 3) [N, N, N m]."""
        k1, k2 = self._lever(q)
        size = since(t, self.when) * self.mass * v[..., 2] ** 2
        return spread(np.stack([size * k2, size * k1, 0.0 * size * k1], axis=-1), t, q)


_TWIST = ("forward", "left", "yaw")


@final
@part
class ViscousFriction:
    """Friction in proportion to the body twist (u, v, r): tau = -J(psi) (c * J(psi)^T v).

    Parameters
    ----------
    coefficients : array_like, shape (3,), optional
        The c above, in place of the three that follow.
    forward, left : float, optional
        Along the body's axes [N s/m]; none where left out.
    yaw : float, optional
        Against turning [N m s], likewise.
    """

    coefficients: Any = array(
        shapes=((3,),), lower=0, unit="N s/m, N s/m, N m s", labels=_TWIST, doc="viscous friction"
    )

    def __init__(
        self,
        coefficients: ArrayLike | None = None,
        *,
        forward: float | None = None,
        left: float | None = None,
        yaw: float | None = None,
    ) -> None:
        each = forward, left, yaw
        for name, value in zip(_TWIST, each, strict=True):
            if coefficients is not None and value is not None:
                raise InvalidArgument(f"{name} is {shown(value)} beside coefficients, expected one of them")
        given = [0.0 if x is None else x for x in each] if coefficients is None else coefficients
        self.__attrs_init__(given)  # type: ignore[attr-defined]

    def __repr__(self) -> str:
        each = zip(_TWIST, self.coefficients.tolist(), strict=True)
        return f"ViscousFriction({', '.join(f'{name}={value!r}' for name, value in each)})"

    @property
    def damping(self) -> Array:
        """Factor of the twist, shape (3,) [N s/m, N s/m, N m s]."""
        return self.coefficients  # type: ignore[no-any-return]

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., 3) [N, N, N m]."""
        cos, sin = np.cos(q[..., 2]), np.sin(q[..., 2])
        twist = _turned(cos, -sin, v)
        return spread(_turned(cos, sin, -self.coefficients * twist), t, q)


@final
@part
class RollingResistance:
    """Rolling resistance: a force of constant size against the body twist, regularised about rest.

    Component i along the body's axes is ``-force_i nu_i / sqrt(nu_i^2 + speed_i^2)`` with the twist nu:
    linear well below `speed`, of size `force` well above it. So it is smooth, and a body on which a smaller
    force acts creeps instead of standing still. About rest it is as stiff as a damper of force / speed: an
    explicit step must be shorter than about 2 mass speed / force.
    """

    force: Any = array(
        shapes=((3,),), lower=0, unit="N, N, N m", labels=_TWIST, doc="size of the rolling resistance"
    )
    speed: Any = array(
        default=0.01,
        shapes=((), (3,)),
        above=0,
        unit="m/s, m/s, rad/s",
        labels=_TWIST,
        doc="speed at which the resistance has 71 % of its size",
    )

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., 3) [N, N, N m]."""
        cos, sin = np.cos(q[..., 2]), np.sin(q[..., 2])
        twist = _turned(cos, -sin, v)
        return spread(_turned(cos, sin, -self.force * twist / np.hypot(twist, self.speed)), t, q)


def _turned(cos: Array, sin: Array, vector: Array) -> Array:
    """Return the first two components turned by the angle, the third as it is, shape (..., 3)."""
    x, y = vector[..., 0], vector[..., 1]
    along = cos * x - sin * y
    turned = np.empty((*along.shape, 3))
    turned[..., 0] = along
    turned[..., 1] = sin * x + cos * y
    turned[..., 2] = vector[..., 2]
    return turned


def _checked_names(name: str, value: object) -> tuple[str, ...]:
    given = sequence(name, value, "names of the coordinates")
    return tuple(text(f"{name}[{k}]", each) for k, each in enumerate(given))


def _names(friction: JointFriction) -> Sequence[str]:
    return friction.names


@final
@part
class JointFriction:
    """Viscous and dry friction of each coordinate, the dry one regularised about rest.

    Coordinate i feels ``-viscous_i v_i - coulomb_i v_i / sqrt(v_i^2 + speed_i^2)``: smooth, so that a joint
    on which a smaller force acts creeps instead of standing still. About rest the dry part is as stiff as a
    damper of coulomb / speed: an explicit step must be shorter than about 2 inertia speed / coulomb.
    """

    viscous: Any = array(
        shapes=((), ("n",)),
        lower=0,
        unit="N s/m or N m s/rad",
        labels=_names,
        doc="viscous friction of the coordinates",
    )
    coulomb: Any = array(
        default=0.0,
        shapes=((), ("n",)),
        lower=0,
        unit="N or N m",
        labels=_names,
        doc="dry friction of the coordinates",
    )
    speed: Any = array(
        default=0.01,
        shapes=((), ("n",)),
        above=0,
        unit="m/s or rad/s",
        doc="speed at which dry friction has 71 % of its size",
    )
    names: Sequence[str] = option(default=(), check=_checked_names, doc="names of the coordinates")

    def check(self) -> None:
        """Raise `InvalidArgument` where the arrays are of different numbers of coordinates."""
        sizes = {name: np.size(x) for name, x in vars(self).items() if np.ndim(x) and len(x)}
        if len(set(sizes.values())) > 1:
            told = ", ".join(f"{name} {size}" for name, size in sizes.items())
            raise InvalidArgument(f"numbers of coordinates are {told}, expected as many of each")

    @classmethod
    def of(cls, robot: Any, speed: ArrayLike = 0.01) -> Self:
        """Return the friction that the files of a robot's arms have.

        Parameters
        ----------
        robot : MobileRobot
            Its `joint_damping` and `joint_friction` are taken, and the names of its coordinates; the base
            has none.
        speed : array_like, shape () or (nv,)
            As in the class.

        Raises
        ------
        InvalidArgument
            If it has no such properties.
        """
        asked = ("joint_damping", "joint_friction", "coordinates")
        missing = [name for name in asked if not hasattr(robot, name)]
        if isinstance(robot, type) or missing:
            raise InvalidArgument(f"robot is {shown(robot)}, expected a MobileRobot")
        names = [one.name for one in coordinates_of(robot)]
        return cls(robot.joint_damping, robot.joint_friction, speed, names)

    @property
    def damping(self) -> Array:
        """Factor of the velocities, shape () or (nv,) [N s/m or N m s/rad]."""
        return np.asarray(self.viscous)

    def on_coordinates(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., nv) [N or N m].

        Raises
        ------
        InvalidArgument
            If it is the friction of another number of coordinates.
        """
        for name in ("viscous", "coulomb", "speed"):
            shaped(name, getattr(self, name), (), ("...", v.shape[-1]), words=", as v has")
        return -self.viscous * v - self.coulomb * v / np.hypot(v, self.speed)  # type: ignore[no-any-return]
