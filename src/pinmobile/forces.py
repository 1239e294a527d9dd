"""External forces on the plant: disturbances, payloads, friction and rolling resistance."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, ClassVar, Protocol, Self, final

import attrs
import numpy as np

from pinmobile.arrays import Array, ArrayLike, absent, frozen, rotate, seeded, sequence, shaped, text
from pinmobile.errors import InvalidArgument
from pinmobile.parts import Number, array, declare, number, option, part
from pinmobile.plant import coordinates_of


class Force(Protocol):
    """A generalised force on the body, as a function of time and state.

    Any callable of this form is a force. The loop calls it at every stage of the integrator. An optional
    ``signals(t, pose, rate) -> {name: (unit, value)}`` returns additional series to record once per sample.

    See Also
    --------
    ConstantForce : wind or a push
    ViscousFriction : friction of the body
    simulate : its argument `forces`

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import PD, Circle, MobileRobot
    >>> from pinmobile import Tangent, simulate
    >>> def drag(t, pose, rate):
    ...     speed = np.hypot(rate[..., :1], rate[..., 1:2])
    ...     return -5.0 * speed * rate * [1, 1, 0]
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> path = Tangent(Circle(radius=3.0, rate=0.5, duration=2.0))
    >>> law = PD(kp=120.0, kd=120.0)
    >>> run = simulate(robot, law, path, dt=0.02, forces=[drag])
    >>> print(f"{1e3 * max(run.max_error()):.0f} mm")
    179 mm
    """

    def __call__(self, t: float, pose: Array, rate: Array, /) -> Array:
        """Return (Fx, Fy, Mz) along the inertial axes, shape (..., 3) [N, N, N m].

        Parameters
        ----------
        t : float or ndarray, shape (...)
            Time [s].
        pose, rate : ndarray, shape (..., 3)
            Pose of the body [m, m, rad], and its rate [m/s, m/s, rad/s].
        """


def broadcast_force(tau: Array, t: ArrayLike, q: Array) -> Array:
    """Return a force for each time and pose, by broadcasting.

    Parameters
    ----------
    tau : ndarray, shape (..., 3)
        Force [N, N, N m].
    t : float or ndarray, shape (...)
        Times [s].
    q : ndarray, shape (..., 3)
        Poses [m, m, rad].

    Returns
    -------
    tau : ndarray, shape (..., 3)
        Force with the leading axes of times and poses [N, N, N m].

    See Also
    --------
    forces.Force : protocol of forces

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.forces import broadcast_force
    >>> broadcast_force(np.array([1.0, 0, 0]), 0.0, np.zeros((4, 3))).shape
    (4, 3)
    """
    shape = np.shape(q)
    if tau.shape == shape and not np.ndim(t):
        return tau
    return np.broadcast_to(tau, np.broadcast_shapes(tau.shape, shape, (*np.shape(t), 1)))


def unit_step(t: ArrayLike, begin: ArrayLike) -> Array:
    """Return 1 from a time on and 0 before it, with a tolerance of 1e-9 s.

    Parameters
    ----------
    t : array_like, shape (...)
        Times [s].
    begin : array_like, shape (...)
        Start [s].

    Returns
    -------
    active : ndarray, shape (...)
        1 or 0.

    See Also
    --------
    ConstantForce : force from one time to another

    Examples
    --------
    >>> from pinmobile.forces import unit_step
    >>> unit_step([0.0, 1.0, 2.0], 1.0)
    array([0., 1., 1.])
    """
    return np.where(np.subtract(t, begin) > -_TIME_TOLERANCE, 1.0, 0.0)


_TIME_TOLERANCE = 1e-9  # [s]
_TERMS = 16
_GOLDEN = 0.6180339887498949  # fractional part of the golden ratio: its multiples never nearly repeat


AXES = ("x", "y", "moment")
"""Labels of a wrench on the body."""


def check_interval(begin: float, end: float) -> None:
    """Check that a force, or a payload, ends after it begins."""
    if not end > begin:
        raise InvalidArgument(f"end is {end} s, expected above begin, {begin} s")


@final
@part
class ConstantForce:
    """Constant force in the inertial frame, such as a steady wind, or a push.

    An integrator evaluates the force at the times of its stages. So give `begin` and `end` as multiples of
    `dt`, or of the substep: a push that begins or ends between them is lost in part, or is too large.

    Parameters
    ----------
    force : array_like, shape (..., 3)
        (Fx, Fy, Mz) [N, N, N m].
    begin : float
        Start time [s].
    end : float, optional
        End time [s]; default: no end.

    Raises
    ------
    InvalidArgument
        If the force has another shape or is not finite, or `end` is not above `begin`.

    See Also
    --------
    forces.SinusoidalForce : force that oscillates
    forces.NoiseForce : random force
    PID : controller that removes the error of a constant force

    Examples
    --------
    >>> from pinmobile import ComputedTorque, ConstantForce, Hold
    >>> from pinmobile import FixedHeading, MobileRobot, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> place = FixedHeading(Hold([0.0, 0.0], 6.0), psi=0.0)
    >>> law = ComputedTorque(robot, kp=4.0, kd=4.0)
    >>> run = simulate(robot, law, place, dt=0.02,
    ...                forces=[ConstantForce([12, 0, 0])])
    >>> print(f"{run.q[-1, 0]:.3f} m")  # 12 N / (30 kg * 4 1/s^2)
    0.100 m
    """

    force: Any = array(shapes=((3,),), unit="N, N, N m", labels=AXES, doc="constant force")
    begin: float = number(default=0.0, unit="s", doc="start time of the force")
    end: float = number(default=np.inf, unit="s", doc="end time of the force")

    def check(self) -> None:
        """Raise `InvalidArgument` if the end is not above the start."""
        check_interval(self.begin, self.end)

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., 3) [N, N, N m].

        Parameters
        ----------
        t : float or ndarray, shape (...)
            Time [s].
        q, v : ndarray, shape (..., 3)
            Pose of the body [m, m, rad], and its rate [m/s, m/s, rad/s].
        """
        acts = unit_step(t, self.begin) * (1.0 - unit_step(t, self.end))
        return self.force * acts[..., None] + 0.0 * q  # type: ignore[no-any-return]


@final
@part
class SinusoidalForce:
    """Sinusoidal force in the inertial frame, amplitude * sin(2 pi frequency t + phase).

    Parameters
    ----------
    amplitude : array_like, shape (3,)
        Amplitude of (Fx, Fy, Mz) [N, N, N m].
    frequency : float
        Frequency, >= 0 [Hz].
    phase : float
        Phase [rad].

    Raises
    ------
    InvalidArgument
        If a number is not finite or not in its range.

    See Also
    --------
    ConstantForce : steady force
    forces.NoiseForce : random force

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.forces import SinusoidalForce
    >>> shaker = SinusoidalForce([5.0, 0.0, 0.0], frequency=2.0)
    >>> shaker(0.125, np.zeros(3), np.zeros(3))  # [N, N, N m]
    array([5., 0., 0.])
    """

    amplitude: Any = array(
        shapes=((3,),), unit="N, N, N m", labels=AXES, doc="amplitude of the sinusoidal force"
    )
    frequency: float = number(lower=0, unit="Hz", doc="frequency of the sinusoidal force")
    phase: float = number(default=0.0, unit="rad", doc="phase of the sinusoidal force")

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., 3) [N, N, N m].

        Parameters
        ----------
        t : float or ndarray, shape (...)
            Time [s].
        q, v : ndarray, shape (..., 3)
            Pose of the body [m, m, rad], and its rate [m/s, m/s, rad/s].
        """
        wave = np.sin(np.multiply(t, 2 * np.pi * self.frequency) + self.phase)
        return broadcast_force(self.amplitude * wave[..., None], t, q)


def _phase_field(doc: str, function: Any) -> Any:
    """Declare a field whose default is a function of the phases."""
    default = attrs.Factory(lambda force: function(force.phases), takes_self=True)
    return declare(Number(doc, shapes=((_TERMS, 3),)), default, kw_only=True, repr=False)


@final
@part
class NoiseForce:
    """Band-limited noise in the inertial frame, a smooth function of time.

    The method is the spectral representation of Shinozuka and Deodatis (1991). It uses K = `TERMS` cosines of
    equal power, one in each K-th of the band, at the frequencies f_kj of ``noise_frequencies``.
    Component j is::

        std_j sqrt(2 / K) sum_k cos(2 pi f_kj t + phases[k, j])

    Over the phases, the mean is 0 and the root mean square is exactly `std` at any time. The spectrum is flat
    up to `bandwidth` and zero above it. The components have different frequencies, so over a time T their
    correlation decreases as 1 / T. Two forces with one bandwidth have the same frequencies: use one force
    instead, with the root of the sum of both squares.

    In an ensemble, each robot has its own phases, which follow from `seed` and the ensemble's seed.

    Parameters
    ----------
    std : array_like, shape (3,)
        Root mean square of (Fx, Fy, Mz), >= 0 [N, N, N m].
    bandwidth : float
        Highest frequency, > 0 [Hz].
    seed : int, SeedSequence or Generator
        Seed of the phases; None with given phases.
    phases : array_like, shape (TERMS, 3), optional
        Phases of the cosines [rad]; default: uniform, by the seed.
    in_phase, quadrature : array_like, shape (TERMS, 3), optional
        Cosines and sines of the phases, which follow from these.

    Raises
    ------
    InvalidArgument
        If a number is not finite or not in its range, or the seed is of another kind.

    See Also
    --------
    ConstantForce : steady force
    MeasurementNoise : noise of the measured state

    References
    ----------
    Shinozuka and Deodatis, Simulation of stochastic processes by spectral representation, 1991.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.forces import NoiseForce
    >>> gusts = NoiseForce([4.0, 4.0, 0.0], bandwidth=2.0, seed=1)
    >>> t = np.linspace(0.0, 200.0, 5001)
    >>> force = gusts(t, np.zeros((5001, 3)), np.zeros((5001, 3)))
    >>> force.std(axis=0).round(1)  # [N, N, N m]
    array([4., 4., 0.])
    """

    TERMS: ClassVar[int] = _TERMS
    drawn: ClassVar[tuple[str, ...]] = ("phases", "in_phase", "quadrature")
    determined_by: ClassVar[tuple[str, ...]] = ("std", "bandwidth", "phases")  # its seed may be a Generator

    std: Any = array(
        shapes=((3,),), lower=0, unit="N, N, N m", labels=AXES, doc="root mean square of the noise force"
    )
    bandwidth: float = number(above=0, unit="Hz", fixed=True, doc="highest frequency of the noise")
    seed: Any = option(doc="seed of the phases: int, SeedSequence or Generator; None with given phases")
    phases: Any = declare(
        Number("phases of the cosines, uniform on [0, 2 pi)", "rad", shapes=((_TERMS, 3),), fixed=True),
        attrs.Factory(lambda force: force._uniform(seeded("seed", force.seed)), takes_self=True),
        kw_only=True,
        repr=False,
    )
    in_phase: Any = _phase_field("cosines of the phases", np.cos)
    quadrature: Any = _phase_field("sines of the phases", np.sin)

    def _uniform(self, generator: np.random.Generator, *count: int) -> Array:
        """Return random phases, shape (..., TERMS, 3) [rad]."""
        return generator.uniform(0, 2 * np.pi, (*count, self.TERMS, 3))

    @cached_property
    def _rates(self) -> Array:
        """2 pi f_kj, shape (TERMS, 3) [rad/s]."""
        return frozen(2 * np.pi * noise_frequencies(self.bandwidth))

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., 3) [N, N, N m].

        Parameters
        ----------
        t : float or ndarray, shape (...)
            Time [s].
        q, v : ndarray, shape (..., 3)
            Pose of the body [m, m, rad], and its rate [m/s, m/s, rad/s].
        """
        angles = np.asarray(t)[..., None, None] * self._rates  # (..., K, 3), the same for all robots
        waves = self.in_phase * np.cos(angles) - self.quadrature * np.sin(angles)
        return broadcast_force(self.std * np.sqrt(2 / self.TERMS) * waves.sum(axis=-2), t, q)

    def draw(self, generator: np.random.Generator, count: int) -> dict[str, Array]:
        """Return the `drawn` fields of robots with their own phases, shape (count, TERMS, 3).

        Parameters
        ----------
        generator : Generator
            Random numbers.
        count : int
            Number of robots.
        """
        phases = self._uniform(generator, count)
        return {"phases": phases, "in_phase": np.cos(phases), "quadrature": np.sin(phases)}

    @property
    def stream(self) -> bytes:
        """Bytes from which, with the ensemble's seed, the phases of its robots follow."""
        return bytes(self.phases.tobytes())


def noise_frequencies(bandwidth: float) -> Array:
    """Return the frequencies of the components of `forces.NoiseForce`, shape (TERMS, 3) [Hz].

    Each component has one frequency in each of the K equal parts of the band, f_kj = bandwidth (k + frac((k +
    1) g + j / 3)) / K with the fractional part g of the golden ratio. No two frequencies of a component have
    a common multiple, so its sum never repeats. Frequencies of two components differ by at least 0.28 of a
    part.

    Parameters
    ----------
    bandwidth : float
        Highest frequency [Hz].

    Returns
    -------
    frequencies : ndarray, shape (TERMS, 3)
        Frequencies, increasing along the first axis [Hz].

    See Also
    --------
    forces.NoiseForce : noise with these frequencies

    Examples
    --------
    >>> from pinmobile.forces import noise_frequencies
    >>> frequencies = noise_frequencies(bandwidth=8.0)
    >>> frequencies.shape, bool(frequencies.max() < 8.0)
    ((16, 3), True)
    """
    k = np.arange(NoiseForce.TERMS)[:, None]
    return np.asarray(bandwidth * (k + ((k + 1) * _GOLDEN + np.arange(3) / 3) % 1.0) / NoiseForce.TERMS)


@final
@part
class PayloadForce:
    """Payload that appears on the body at a given time and then moves with it.

    The velocity is continuous: the payload appears with the velocity of its position. A payload at rest would
    slow the robot by the fraction mass / (robot's mass + mass), which no finite force can do. This force
    changes only the inertia: its weight does not affect wheels, tip-over margins and friction.

    With m, (x, y) and I below, and the body at psi, r = dpsi/dt, it adds to the body's mass matrix and
    forces::

        [[m, 0, -m k1], [0, m, m k2], [-m k1, m k2, I + m (x^2 + y^2)]]     (m k2 r^2, m k1 r^2, 0)

    with ``k1 = y cos psi + x sin psi`` and ``k2 = x cos psi - y sin psi``, as the closed form of a body does.

    Parameters
    ----------
    mass : float
        m, >= 0 [kg].
    at : array_like, shape (2,)
        Position (x, y) on the body, forward and to the left [m].
    when : float
        Time from which the payload is on the body [s].
    yaw_inertia : float
        I, yaw inertia about the payload's centre of mass, >= 0 [kg m^2].

    Raises
    ------
    InvalidArgument
        If a number is not finite or not in its range.

    See Also
    --------
    PayloadBody : payload with its weight, from the start
    Adaptive : controller that adapts to a payload

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.forces import PayloadForce
    >>> box = PayloadForce(mass=5.0, at=[0.2, 0.0], when=3.0)
    >>> box.inertia(4.0, np.zeros(3)).diagonal()  # [kg, kg, kg m^2]
    array([5. , 5. , 0.2])
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
        """Return k1 and k2, shape (...) [m]."""
        x, y = self.at[..., 0], self.at[..., 1]
        cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
        return y * cos + x * sin, x * cos - y * sin

    def inertia(self, t: ArrayLike, q: Array) -> Array:
        """Return the mass matrix that the payload adds to the body, shape (..., 3, 3) [kg, kg m, kg m^2].

        Parameters
        ----------
        t : float or ndarray, shape (...)
            Time [s].
        q : ndarray, shape (..., 3)
            Pose of the body [m, m, rad].
        """
        x, y = self.at[..., 0], self.at[..., 1]
        k1, k2 = self._lever(q)
        is_on = unit_step(t, self.when) + 0.0 * k1
        m = is_on * self.mass
        izz = is_on * self.yaw_inertia + m * (x * x + y * y)
        rows = [[m, 0.0 * m, -m * k1], [0.0 * m, m, m * k2], [-m * k1, m * k2, izz]]
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force beside the effect of the mass matrix, shape (..., 3) [N, N, N m].

        Parameters
        ----------
        t : float or ndarray, shape (...)
            Time [s].
        q, v : ndarray, shape (..., 3)
            Pose of the body [m, m, rad], and its rate [m/s, m/s, rad/s].
        """
        k1, k2 = self._lever(q)
        size = unit_step(t, self.when) * self.mass * v[..., 2] ** 2
        return broadcast_force(np.stack([size * k2, size * k1, 0.0 * size * k1], axis=-1), t, q)


_TWIST = ("forward", "left", "yaw")


@final
@part
class ViscousFriction:
    """Friction proportional to the body twist (u, v, r): tau = -J(psi) (c * J(psi)^T v).

    Parameters
    ----------
    coefficients : array_like, shape (3,), optional
        c, in place of the three parameters below [N s/m, N s/m, N m s].
    forward, left : float, optional
        Coefficients along the body's axes [N s/m]; default: 0.
    yaw : float, optional
        Coefficient of the yaw rate [N m s]; default: 0.

    Raises
    ------
    InvalidArgument
        If a coefficient is negative or not finite, or both forms are given.

    See Also
    --------
    RollingResistance : friction of constant size
    JointFriction : friction of each coordinate

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import ViscousFriction
    >>> drag = ViscousFriction(forward=20.0, left=200.0, yaw=5.0)
    >>> rate = np.array([1.0, 0.1, 0.5])
    >>> drag(0.0, np.zeros(3), rate)  # [N, N, N m]
    array([-20. , -20. ,  -2.5])
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
        values = forward, left, yaw
        if coefficients is not None:
            absent("with coefficients", **dict(zip(_TWIST, values, strict=True)))
        array = [0.0 if x is None else x for x in values] if coefficients is None else coefficients
        self.__attrs_init__(array)  # type: ignore[attr-defined]

    def __repr__(self) -> str:
        pairs = zip(_TWIST, self.coefficients.tolist(), strict=True)
        return f"ViscousFriction({', '.join(f'{name}={value!r}' for name, value in pairs)})"

    @property
    def damping(self) -> Array:
        """Coefficients of the body twist, shape (3,) [N s/m, N s/m, N m s]."""
        return self.coefficients  # type: ignore[no-any-return]

    def __call__(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., 3) [N, N, N m].

        Parameters
        ----------
        t : float or ndarray, shape (...)
            Time [s].
        q, v : ndarray, shape (..., 3)
            Pose of the body [m, m, rad], and its rate [m/s, m/s, rad/s].
        """
        cos, sin = np.cos(q[..., 2]), np.sin(q[..., 2])
        twist = rotate(cos, -sin, v)
        return broadcast_force(rotate(cos, sin, -self.coefficients * twist), t, q)


@final
@part
class RollingResistance:
    """Rolling resistance: a force of constant size against the body twist, smooth near rest.

    With the body twist nu, component i along the body's axes is ``-force_i nu_i / sqrt(nu_i^2 + speed_i^2)``:
    linear well below `speed`, of size `force` well above it. Therefore a body on which a smaller force acts
    creeps instead of standing still. Near rest it is as stiff as a damper of force / speed: an explicit step
    must be shorter than about 2 mass speed / force.

    Parameters
    ----------
    force : array_like, shape (3,)
        Size forward, left and of the yaw moment, >= 0 [N, N, N m].
    speed : array_like, shape () or (3,)
        Speed at which the resistance has 71 % of its size, > 0 [m/s, m/s, rad/s].

    Raises
    ------
    InvalidArgument
        If a number is not finite or not in its range.

    See Also
    --------
    ViscousFriction : friction proportional to the speed
    wheels.WheelFriction : rolling resistance of each wheel, with standstill

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import RollingResistance
    >>> floor = RollingResistance([6.0, 60.0, 2.0])
    >>> rate = np.array([1.0, 0.01, 0.2])
    >>> floor(0.0, np.zeros(3), rate).round(1)  # [N, N, N m]
    array([ -6. , -42.4,  -2. ])
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
        """Return the force, shape (..., 3) [N, N, N m].

        Parameters
        ----------
        t : float or ndarray, shape (...)
            Time [s].
        q, v : ndarray, shape (..., 3)
            Pose of the body [m, m, rad], and its rate [m/s, m/s, rad/s].
        """
        cos, sin = np.cos(q[..., 2]), np.sin(q[..., 2])
        twist = rotate(cos, -sin, v)
        return broadcast_force(rotate(cos, sin, -self.force * twist / np.hypot(twist, self.speed)), t, q)


def _check_names(name: str, value: object) -> tuple[str, ...]:
    """Return names of coordinates after a check."""
    names = sequence(name, value, "names of the coordinates")
    return tuple(text(f"{name}[{k}]", name_k) for k, name_k in enumerate(names))


def _names(friction: JointFriction) -> Sequence[str]:
    """Return the labels of a friction's coordinates."""
    return friction.names


@final
@part
class JointFriction:
    """Viscous and dry friction of each coordinate; dry friction is smooth near rest.

    The force on coordinate i is ``-viscous_i v_i - coulomb_i v_i / sqrt(v_i^2 + speed_i^2)``. Therefore a
    joint on which a smaller force acts creeps instead of standing still. Near rest the dry part is as stiff
    as a damper of coulomb / speed: an explicit step must be shorter than about 2 inertia speed / coulomb.

    Parameters
    ----------
    viscous : array_like, shape () or (n,)
        Viscous friction, >= 0 [N s/m or N m s/rad].
    coulomb : array_like, shape () or (n,)
        Dry friction, >= 0 [N or N m].
    speed : array_like, shape () or (n,)
        Speed at which dry friction has 71 % of its size, > 0 [m/s or rad/s].
    names : sequence of str
        Names of the coordinates, as labels.

    Raises
    ------
    InvalidArgument
        If a number is not finite or not in its range, or sizes differ; in a run, if n differs from the
        plant's nv.

    See Also
    --------
    ViscousFriction : friction of the body
    RollingResistance : dry friction of the body

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import JointFriction
    >>> friction = JointFriction(viscous=2.0, coulomb=[0, 0, 1])
    >>> v = np.array([1.0, 0.5, 1.0])
    >>> friction.on_coordinates(0.0, 0 * v, v).round(2)
    array([-2., -1., -3.])
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
    names: Sequence[str] = option(default=(), check=_check_names, doc="names of the coordinates")

    @classmethod
    def of(cls, robot: Any, speed: ArrayLike = 0.01) -> Self:
        """Return the friction that the files of a robot's arms define.

        Parameters
        ----------
        robot : MobileRobot
            Robot with ``joint_damping``, ``joint_friction`` and names of coordinates; the base has no
            friction.
        speed : array_like, shape () or (nv,)
            Speed at which dry friction has 71 % of its size [m/s or rad/s].

        Returns
        -------
        friction : JointFriction
            Friction of all nv coordinates.
        """
        names = [coordinate.name for coordinate in coordinates_of(robot)]
        return cls(robot.joint_damping, robot.joint_friction, speed, names)

    @property
    def damping(self) -> Array:
        """Coefficients of the velocities, shape () or (nv,) [N s/m or N m s/rad]."""
        return np.asarray(self.viscous)

    def on_coordinates(self, t: ArrayLike, q: Array, v: Array) -> Array:
        """Return the force, shape (..., nv) [N or N m].

        Parameters
        ----------
        t : float or ndarray, shape (...)
            Time [s].
        q, v : ndarray, shape (..., nq), (..., nv)
            State of the plant.

        Raises
        ------
        InvalidArgument
            If the friction has another number of coordinates than v.
        """
        for name in ("viscous", "coulomb", "speed"):
            shaped(name, getattr(self, name), (), ("...", v.shape[-1]), words=", as v has")
        return -self.viscous * v - self.coulomb * v / np.hypot(v, self.speed)  # type: ignore[no-any-return]
