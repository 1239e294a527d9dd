"""`excitation`: informative motions for identification, within limits."""

from __future__ import annotations

from functools import cached_property
from typing import Any, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, bounded, finite, positive, seeded, shaped, whole
from pinmobile.identification._planar_model import PlanarModel
from pinmobile.parts import array, number, part
from pinmobile.robot import MobileRobot
from pinmobile.trajectories import Reference

_CANDIDATES, _STEPS = 60, 2500  # number of random motions, and of steps that improve the best one
_FIRST_SIZE, _LARGER = 0.3, 1.5  # first step size as a share of the coefficients, and its growth factor
_PER_PERIOD = 120  # samples of the criterion in a period
_KNOTS = 400  # knots of a period at which positions of wheeled robots are stored
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(6)
_TYPICAL = 0.25  # typical speed as a share of the limits, for the scale of friction


@final
@part
class Excitation:
    """Trajectory of finite Fourier series: the result of `excitation`.

    Coordinate i is q0_i plus the sum over l of a_li / w_l sin w_l t - b_li / w_l cos w_l t, with
    w_l = 2 pi l / period. For a robot on wheels, the series gives the integrals of its independent velocities
    (along the wheels and in yaw). The pose follows from them.

    Parameters
    ----------
    coefficients : array_like, shape (L, 2, k)
        Coefficients a_l and b_l of the velocities [m/s, m/s, rad/s].
    period : float
        Period of the series [s].
    duration : float
        Duration of the motion [s].
    S : array_like, shape (3, k), optional
        Body twist of the k independent velocities of wheels. None: the series gives x, y and psi.
    start : array_like, shape (3,), optional
        Pose at the start [m, m, rad].

    Raises
    ------
    InvalidArgument
        If the shapes do not fit, or a number is not finite or not positive.

    See Also
    --------
    excitation : find the most informative coefficients
    identify : estimate parameters from a log of the motion

    References
    ----------
    J. Swevers, C. Ganseman, D. B. Tukel, J. De Schutter and H. Van Brussel, "Optimal robot excitation and
    identification", IEEE Transactions on Robotics and Automation 13 (1997).

    Examples
    --------
    One harmonic of the velocity along x:

    >>> from pinmobile.identification import Excitation
    >>> a_b = [[[0.5, 0, 0], [0, 0, 0]]]  # a_1 and b_1 [m/s]
    >>> motion = Excitation(a_b, period=4.0, duration=8.0)
    >>> motion([0, 2, 4]).v[:, 0]  # [m/s]
    array([ 0.5, -0.5,  0.5])
    """

    coefficients: Array = array(shapes=(("L>=1", 2, "k"),), fixed=True, doc="coefficients of the velocities")
    period: float = number(unit="s", above=0.0, fixed=True, doc="period of the series")
    duration: float = number(unit="s", above=0.0, fixed=True, doc="duration of the motion")
    S: Array | None = array(default=None, shapes=((3, "k>=1"),), fixed=True, doc="body twist of wheels")
    start: Array = array(default=np.zeros(3), shapes=((3,),), fixed=True, doc="pose at the start")

    def check(self) -> None:
        """Check the number of velocities.

        Raises
        ------
        InvalidArgument
            If the coefficients are for another number of velocities than `S` has.
        """
        shaped("coefficients", self.coefficients, ("L", 2, 3 if self.S is None else self.S.shape[1]))

    @cached_property
    def _knots(self) -> Array:
        """Positions of a wheeled robot at the knots, relative to the start, as complex numbers."""
        step = self.period / _KNOTS
        begins: Array = np.arange(np.ceil(self.duration / step), dtype=np.float64) * step
        return np.append(0.0, np.cumsum(self._way(begins, np.full(begins.shape, step))))

    def __repr__(self) -> str:
        what = "free body" if self.S is None else "on wheels"
        series = f"{len(self.coefficients)} harmonics of {self.period:g} s"
        return f"<Excitation: {what}, {series}, over {self.duration:g} s>"

    def _series(self, t: Array, order: int) -> Array:
        """Return the derivative of the coordinates of an order, relative to their start, shape (..., k)."""
        w = 2j * np.pi / self.period * np.arange(1, len(self.coefficients) + 1)
        each = (self.coefficients[:, 0] - 1j * self.coefficients[:, 1]) * w[:, None] ** (order - 1)
        total = (np.exp(w * np.asarray(t)[..., None]) @ each).real
        return np.asarray(total - each.sum(axis=0).real if order == 0 else total)

    def _body(self, t: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Return yaw, yaw rate and yaw acceleration, and velocity and its rate in body axes (complex)."""
        assert self.S is not None
        zeroth, first, second = (self._series(t, order) @ self.S.T for order in range(3))
        psi, r = self.start[2] + zeroth[..., 2], first[..., 2]
        nu, rate = (each[..., 0] + 1j * each[..., 1] for each in (first, second))
        return psi, r, second[..., 2], nu, rate

    def _way(self, since: Array, span: Array) -> Array:
        """Return the displacement of a wheeled robot in the plane over time spans, complex, shape (...)."""
        psi, _, _, nu, _ = self._body(since[..., None] + span[..., None] * (_NODES + 1) / 2)
        return np.asarray(span / 2 * ((np.exp(1j * psi) * nu) @ _WEIGHTS))

    def __call__(self, t: ArrayLike) -> Reference:
        """Return pose, velocity and acceleration.

        Parameters
        ----------
        t : array_like, shape (...)
            Times [s].

        Returns
        -------
        reference : Reference
            Pose, velocity and acceleration, shape (..., 3) each.

        Raises
        ------
        InvalidArgument
            If a time is outside [0, `duration`].
        """
        times = bounded("t", finite("t", t), least=0, most=self.duration * (1 + 1e-12), unit="s")
        if self.S is None:
            zeroth = self.start + self._series(times, 0)
            return Reference(zeroth, self._series(times, 1), self._series(times, 2))
        step = self.period / _KNOTS
        at = np.clip((times / step).astype(int), 0, len(self._knots) - 1)
        psi, r, turn, nu, rate = self._body(times)
        place = self.start[0] + 1j * self.start[1] + self._knots[at] + self._way(at * step, times - at * step)
        v, a = np.exp(1j * psi) * nu, np.exp(1j * psi) * (rate + 1j * r * nu)
        pairs = (place, psi), (v, r), (a, turn)
        return Reference(*(np.stack([z.real, z.imag, angle], axis=-1) for z, angle in pairs))


def excitation(
    robot: Any = None,
    *,
    duration: float = 60.0,
    period: float = 20.0,
    position: ArrayLike = (1.5, 1.5, np.pi),
    velocity: ArrayLike = (1.0, 1.0, 1.5),
    acceleration: ArrayLike = (1.5, 1.5, 3.0),
    harmonics: int = 5,
    seed: Any = 0,
) -> Excitation:
    """Design an informative motion for `identify` within limits (D-optimal).

    The design maximises the determinant of the information matrix of the parameters that `identify`
    estimates. It scales each candidate so that the motion reaches the limits, and improves the best of 60
    random candidates. A robot on wheels gets a motion along which its wheels roll.

    Parameters
    ----------
    robot : MobileRobot or WheeledRobot, optional
        Prior robot; default: a box of 30 kg, 0.6 m by 0.4 m.
    duration : float
        Duration of the motion [s].
    period : float
        Period of the Fourier series [s].
    position : array_like, shape (3,)
        Largest distances from the start in x, y and psi [m, m, rad]. For wheels, psi has no limit.
    velocity : array_like, shape (3,)
        Largest rates of x, y and psi, or for wheels of the body twist (forward, left, yaw)
        [m/s, m/s, rad/s].
    acceleration : array_like, shape (3,)
        Largest derivatives of these rates [m/s^2, m/s^2, rad/s^2].
    harmonics : int
        Number of harmonics of the series, at least 3.
    seed : int, SeedSequence, BitGenerator or Generator
        Seed of the candidates.

    Returns
    -------
    motion : Excitation
        Trajectory that starts at rest and is at rest after each period.

    Raises
    ------
    InvalidArgument
        If a limit is not positive, or `identify` does not accept the robot.

    See Also
    --------
    identify : estimate the parameters from a log of the motion
    identification.Excitation : the trajectory

    Examples
    --------
    >>> from pinmobile import MobileRobot, excitation
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> motion = excitation(robot, velocity=(0.8, 0.8, 1.0))
    >>> motion
    <Excitation: free body, 5 harmonics of 20 s, over 60 s>
    >>> bool((abs(motion(range(60)).v) <= (0.8, 0.8, 1.0)).all())
    True
    """
    given = {"position": position, "velocity": velocity, "acceleration": acceleration}
    limits = [bounded(name, shaped(name, finite(name, x), (3,)), above=0) for name, x in given.items()]
    count, generator = whole("harmonics", harmonics, least=3), seeded("seed", seed)
    T, length = positive("period", period, "s"), positive("duration", duration, "s")
    believed = MobileRobot.box() if robot is None else robot
    model = PlanarModel.of(believed)
    prior = model.prior(believed)
    problem = _Search(model, prior, (T, length, count), limits)
    shape = count, 2, model.free if model.free < 3 else 3
    order = np.arange(1, count + 1)[:, None, None]
    draws = [generator.standard_normal(shape) / order for _ in range(_CANDIDATES)]
    best = problem.improved(min(draws, key=problem.cost), generator)
    return Excitation(problem.coefficients(best), T, length, problem.S)


class _Search:
    """Search for the most informative motion.

    Parameters
    ----------
    model : PlanarModel
        Model of the robot.
    prior : ndarray, shape (p,)
        Prior parameters phi.
    shape : tuple of float, float and int
        Period and duration of the motion [s], and number of harmonics.
    limits : list of ndarray, shape (3,)
        Limits of pose, velocity and acceleration.
    """

    def __init__(
        self, model: PlanarModel, prior: Array, shape: tuple[float, float, int], limits: list[Array]
    ):
        self.model, self.limits = model, limits
        self.period, self.duration, harmonics = shape
        self.S = None if model.free == 3 else model.S
        w = 2 * np.pi / self.period * np.arange(1, harmonics + 1)
        phase = w * (self.period / _PER_PERIOD) * np.arange(_PER_PERIOD)[:, None]
        c, s = np.cos(phase), np.sin(phase)
        rows = (s / w, (1 - c) / w), (c, s), (-w * s, w * c)
        self.series = [np.concatenate(row, axis=1) for row in rows]  # columns of a_l, then of b_l
        self.between = 1 + (np.pi * harmonics / _PER_PERIOD) ** 2 / 2  # largest ratio of peak and samples
        mass, force = prior[0], prior[0] * _TYPICAL * limits[2][0]
        lever = max(np.sqrt(prior[3] / mass), 1e-3)
        ends = np.array([force, force, force * lever])
        rates = np.abs(model.A) @ (np.linalg.pinv(model.S) @ (_TYPICAL * limits[1]))
        torque = np.abs(np.linalg.pinv(model.A.T)) @ np.abs(model.S.T) @ ends
        size = np.array([mass, mass * lever, mass * lever, prior[3]])
        self.scales = np.concatenate([size, torque / rates, torque])
        self.weights = 1 / np.maximum(np.abs(model.S.T) @ ends, 1e-12)

    def coefficients(self, raw: Array) -> Array:
        """Return coefficients of a motion that begins and ends at rest, scaled into the limits."""
        order = np.arange(1, len(raw) + 1.0)[:, None]
        a = raw[:, 0] - raw[:, 0].mean(axis=0)
        b = raw[:, 1] - order * (order * raw[:, 1]).sum(axis=0) / (order**2).sum()
        new = np.stack([a, b], axis=1)
        q, v, rate = self.of(new)
        if self.S is None:
            sizes = [np.abs(each).max(axis=0) * self.between for each in (q, v, rate)]
            return np.asarray(new / np.max(np.array(sizes) / self.limits, axis=0))
        bodies = [np.abs(each) @ np.abs(self.S).T for each in (v, rate)]
        shares = np.max([x.max(axis=0) / y for x, y in zip(bodies, self.limits[1:], strict=True)], axis=0)
        new = new / np.maximum(self.between * shares[[0, 2]], 1e-9)
        far = np.max(self.reach(*self.of(new)[:2]) / self.limits[0][:2])
        return np.asarray(new / np.array([max(far, 1.0), 1.0]))

    def of(self, coefficients: Array) -> list[Array]:
        """Return the coordinates of a period and their two derivatives, shape (n, k) each."""
        stacked = np.concatenate([coefficients[:, 0], coefficients[:, 1]])
        return [each @ stacked for each in self.series]

    def reach(self, way: Array, eta: Array) -> Array:
        """Return the largest distances in x and y over all periods, shape (2,) [m], for wheels."""
        assert self.S is not None
        psi = way @ self.S[2]
        forward, left, _ = (eta @ self.S.T).T
        c, s = np.cos(psi), np.sin(psi)
        step = self.period / _PER_PERIOD
        path = np.cumsum(np.column_stack([c * forward - s * left, s * forward + c * left]) * step, axis=0)
        last = path + (np.ceil(self.duration / self.period) - 1) * path[-1]
        return np.asarray(np.maximum(np.abs(path).max(axis=0), np.abs(last).max(axis=0)))

    def cost(self, raw: Array) -> float:
        """Return minus the logarithm of the determinant of the information matrix."""
        q, eta, rate = self.of(self.coefficients(raw))
        if self.S is None:
            eta, rate = _in_body(q[:, 2], eta, rate)
        Y = self.model.regressor(eta, rate) * self.scales * self.weights[:, None]
        flat = Y.reshape(-1, Y.shape[-1])
        sign, size = np.linalg.slogdet(flat.T @ flat / len(eta) + 1e-12 * np.eye(flat.shape[1]))
        return float(-size) if sign > 0 else np.inf

    def improved(self, raw: Array, generator: np.random.Generator) -> Array:
        """Return raw coefficients with a lower cost, by a (1+1) evolution strategy with the 1/5 rule.

        Rechenberg (1973). The search only compares costs, so rounding has little influence.
        """
        best, cost, size = raw, self.cost(raw), _FIRST_SIZE
        for _ in range(_STEPS):
            tried = best + size * np.abs(best).mean() * generator.standard_normal(best.shape)
            new = self.cost(tried)
            size *= _LARGER if new < cost else _LARGER**-0.25
            if new < cost:
                best, cost = tried, new
        return best


def _in_body(psi: Array, v: Array, a: Array) -> tuple[Array, Array]:
    """Return body twists and their rates from the derivatives of poses."""
    c, s = np.cos(psi), np.sin(psi)
    u, w, r = c * v[:, 0] + s * v[:, 1], c * v[:, 1] - s * v[:, 0], v[:, 2]
    du = c * a[:, 0] + s * a[:, 1] + r * w
    dw = c * a[:, 1] - s * a[:, 0] - r * u
    return np.column_stack([u, w, r]), np.column_stack([du, dw, a[:, 2]])
