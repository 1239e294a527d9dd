"""`excitation`: motions that tell as much as they can of a robot, within limits."""

from __future__ import annotations

from functools import cached_property
from typing import Any, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, bounded, finite, positive, seeded, shaped, whole
from pinmobile.identification._planar_model import PlanarModel
from pinmobile.parts import array, number, part
from pinmobile.robot import MobileRobot
from pinmobile.trajectories import Reference

_CANDIDATES, _STEPS = 60, 2500  # random motions, and how often the best of them is changed
_FIRST_SIZE, _LARGER = 0.3, 1.5  # of changes, as a share of the coefficients; and by which they grow
_PER_PERIOD = 120  # samples of a period that the criterion takes
_KNOTS = 400  # per period, between which positions of wheels are integrated
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(6)
_TYPICAL = 0.25  # of the limits: speeds for which friction counts like forces


@final
@part
class Excitation:
    """A motion of finite Fourier series that begins and ends at rest: what `excitation` returns.

    Swevers, Ganseman, Tukel, De Schutter and Van Brussel (1997): coordinate i is q0_i plus the sum over l of
    a_li / w_l sin w_l t - b_li / w_l cos w_l t, w_l = 2 pi l / period. Of wheels the coordinates are free
    velocities, integrated: those along the wheels and in yaw, from which the pose follows.

    Attributes
    ----------
    coefficients : ndarray, shape (L, 2, k)
        Of sines and cosines of the velocities.
    period, duration : float
        Of the series, and how long it is repeated [s].
    S : ndarray, shape (3, k), or None
        Body twist of the free velocities of wheels; None: the coordinates are those of the pose.
    start : ndarray, shape (3,)
        Pose at the start [m, m, rad].
    """

    coefficients: Array = array(shapes=(("L>=1", 2, "k"),), fixed=True, doc="of sines and cosines")
    period: float = number(unit="s", above=0.0, fixed=True, doc="period of the series")
    duration: float = number(unit="s", above=0.0, fixed=True, doc="duration of the motion")
    S: Array | None = array(default=None, shapes=((3, "k>=1"),), fixed=True, doc="body twist of wheels")
    start: Array = array(default=np.zeros(3), shapes=((3,),), fixed=True, doc="pose at the start")

    def check(self) -> None:
        """Raise `InvalidArgument` where there are not as many coefficients as velocities."""
        shaped("coefficients", self.coefficients, ("L", 2, 3 if self.S is None else self.S.shape[1]))

    @cached_property
    def _knots(self) -> Array:
        """Positions of wheels at knots, from the start on, as complex numbers."""
        step = self.period / _KNOTS
        begins: Array = np.arange(np.ceil(self.duration / step), dtype=np.float64) * step
        return np.append(0.0, np.cumsum(self._way(begins, np.full(begins.shape, step))))

    def __repr__(self) -> str:
        what = "pushed" if self.S is None else "on wheels"
        series = f"{len(self.coefficients)} harmonics of {self.period:g} s"
        return f"<Excitation: {what}, {series}, over {self.duration:g} s>"

    def _series(self, t: Array, order: int) -> Array:
        """Return the coordinates' derivative of an order, from their start on, shape (..., k)."""
        w = 2j * np.pi / self.period * np.arange(1, len(self.coefficients) + 1)
        each = (self.coefficients[:, 0] - 1j * self.coefficients[:, 1]) * w[:, None] ** (order - 1)
        total = (np.exp(w * np.asarray(t)[..., None]) @ each).real
        return np.asarray(total - each.sum(axis=0).real if order == 0 else total)

    def _body(self, t: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Return yaw, its two derivatives, and velocity and its rate along the body, complex, of wheels."""
        assert self.S is not None
        zeroth, first, second = (self._series(t, order) @ self.S.T for order in range(3))
        psi, r = self.start[2] + zeroth[..., 2], first[..., 2]
        nu, rate = (each[..., 0] + 1j * each[..., 1] for each in (first, second))
        return psi, r, second[..., 2], nu, rate

    def _way(self, since: Array, span: Array) -> Array:
        """Return how far wheels go in the plane, complex, from times on for spans, shape (...)."""
        psi, _, _, nu, _ = self._body(since[..., None] + span[..., None] * (_NODES + 1) / 2)
        return np.asarray(span / 2 * ((np.exp(1j * psi) * nu) @ _WEIGHTS))

    def __call__(self, t: ArrayLike) -> Reference:
        """Return where to be and how to move at times, shape (...) [s].

        Raises
        ------
        InvalidArgument
            If a time is outside 0 to `duration`.
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
    """Return a motion from which parameters can be told as well as its limits allow: D-optimal.

    It maximises the determinant of the information of the parameters that `identify` estimates:
    each candidate is scaled into the limits, so that these are reached; the best of random ones is improved.
    Robots on wheels get motions that they can roll.

    Parameters
    ----------
    robot : MobileRobot or WheeledRobot, optional
        The robot, as it is believed to be; by default 30 kg of 0.6 m by 0.4 m.
    duration, period : float
        How long it moves, and how long a period of the series is [s].
    position : array_like, shape (3,)
        Largest way from the start in x, y and psi [m, m, rad]; psi of wheels may turn further.
    velocity, acceleration : array_like, shape (3,)
        Largest rates of x, y and psi, of wheels of the body: forward, left, yaw [m/s, m/s, rad/s; per s].
    harmonics : int
        Of the series, at least 3.
    seed : int, SeedSequence, BitGenerator or Generator
        Of the candidates.

    Raises
    ------
    InvalidArgument
        If a limit is not above zero, or the robot is none that `identify` takes.
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
    """The search for a motion.

    Parameters
    ----------
    model : PlanarModel
        The robot.
    prior : ndarray, shape (p,)
        What is believed of it.
    shape : tuple of float, float and int
        Period and duration of the motion [s], and number of harmonics.
    limits : list of ndarray, shape (3,)
        Of pose, velocity and acceleration.
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
        self.series = [np.concatenate(row, axis=1) for row in rows]  # of all cosines, then all sines
        self.between = 1 + (np.pi * harmonics / _PER_PERIOD) ** 2 / 2  # peaks over those of samples
        mass, force = prior[0], prior[0] * _TYPICAL * limits[2][0]
        lever = max(np.sqrt(prior[3] / mass), 1e-3)
        ends = np.array([force, force, force * lever])
        rates = np.abs(model.A) @ (np.linalg.pinv(model.S) @ (_TYPICAL * limits[1]))
        torque = np.abs(np.linalg.pinv(model.A.T)) @ np.abs(model.S.T) @ ends
        size = np.array([mass, mass * lever, mass * lever, prior[3]])
        self.scales = np.concatenate([size, torque / rates, torque])
        self.weights = 1 / np.maximum(np.abs(model.S.T) @ ends, 1e-12)

    def coefficients(self, raw: Array) -> Array:
        """Return coefficients that begin and end at rest, scaled into the limits."""
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
        """Return how far wheels come in x and y, shape (2,), a period over and over."""
        assert self.S is not None
        psi = way @ self.S[2]
        forward, left, _ = (eta @ self.S.T).T
        c, s = np.cos(psi), np.sin(psi)
        step = self.period / _PER_PERIOD
        path = np.cumsum(np.column_stack([c * forward - s * left, s * forward + c * left]) * step, axis=0)
        last = path + (np.ceil(self.duration / self.period) - 1) * path[-1]
        return np.asarray(np.maximum(np.abs(path).max(axis=0), np.abs(last).max(axis=0)))

    def cost(self, raw: Array) -> float:
        """Return minus the logarithm of the information's determinant."""
        q, eta, rate = self.of(self.coefficients(raw))
        if self.S is None:
            eta, rate = _in_body(q[:, 2], eta, rate)
        Y = self.model.regressor(eta, rate) * self.scales * self.weights[:, None]
        flat = Y.reshape(-1, Y.shape[-1])
        sign, size = np.linalg.slogdet(flat.T @ flat / len(eta) + 1e-12 * np.eye(flat.shape[1]))
        return float(-size) if sign > 0 else np.inf

    def improved(self, raw: Array, generator: np.random.Generator) -> Array:
        """Return raw coefficients with a lower cost: evolution of one, with the rule of one fifth.

        Rechenberg (1973). It compares costs alone, so that rounding does not choose its way.
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
    """Return body twists and their rates, of the derivatives of poses."""
    c, s = np.cos(psi), np.sin(psi)
    u, w, r = c * v[:, 0] + s * v[:, 1], c * v[:, 1] - s * v[:, 0], v[:, 2]
    du = c * a[:, 0] + s * a[:, 1] + r * w
    dw = c * a[:, 1] - s * a[:, 0] - r * u
    return np.column_stack([u, w, r]), np.column_stack([du, dw, a[:, 2]])
