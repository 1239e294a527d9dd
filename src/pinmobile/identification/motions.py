"""`excitation`: motions that tell as much as they can of a robot, within limits."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, bounded, finite, frozen, positive, seeded, shaped, whole
from pinmobile.identification.chassis import Chassis
from pinmobile.identification.procedure import prior_of, to_chassis
from pinmobile.robot import MobileRobot
from pinmobile.trajectories import Reference

_CANDIDATES, _STEPS = 60, 2500  # random motions, and how often the best of them is changed
_FIRST_SIZE, _LARGER = 0.3, 1.5  # of changes, as a share of the coefficients; and by which they grow
_PER_PERIOD = 120  # samples of a period that the criterion takes
_KNOTS = 400  # per period, between which positions of wheels are integrated
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(6)
_TYPICAL = 0.25  # of the limits: speeds for which friction counts like forces


@final
@dataclass(frozen=True, eq=False)
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

    coefficients: Array
    period: float
    duration: float
    S: Array | None = None
    start: Array = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        S = None if self.S is None else finite("S", self.S)
        k = 3 if S is None else shaped("S", S, (3, "k>=1")).shape[1]
        given = shaped("coefficients", finite("coefficients", self.coefficients), ("L>=1", 2, k))
        start = shaped("start", finite("start", self.start), (3,))
        times = {name: positive(name, getattr(self, name), "s") for name in ("period", "duration")}
        arrays = {
            "coefficients": frozen(given),
            "start": frozen(start),
            "S": None if S is None else frozen(S),
        }
        for name, value in {**times, **arrays}.items():
            object.__setattr__(self, name, value)
        if S is not None:
            knots = np.arange(np.ceil(self.duration / self.period * _KNOTS) + 1) * (self.period / _KNOTS)
            whole_way = self._way(knots[:-1], np.full(len(knots) - 1, self.period / _KNOTS))
            sums = np.vstack([np.zeros(2), np.cumsum(whole_way, axis=0)])
            object.__setattr__(self, "_knots", frozen(sums))

    def __repr__(self) -> str:
        what = "pushed" if self.S is None else "on wheels"
        series = f"{len(self.coefficients)} harmonics of {self.period:g} s"
        return f"<Excitation: {what}, {series}, over {self.duration:g} s>"

    def _series(self, t: Array, order: int) -> Array:
        """Return the coordinates' derivative of an order, from their start on, shape (..., k)."""
        total: Array = np.zeros((*np.shape(t), self.coefficients.shape[2]))
        for each, (a, b) in enumerate(self.coefficients, 1):
            w = 2 * np.pi * each / self.period
            phase = np.asarray(w * t)[..., None]
            turned = phase + (order - 1) * np.pi / 2
            total = total + w ** (order - 1) * (a * np.cos(turned) + b * np.sin(turned))
            if order == 0:
                total = total + b / w
        return total

    def _way(self, since: Array, span: Array) -> Array:
        """Return how far the body goes in the plane, from times on for spans, shape (..., 2)."""
        assert self.S is not None
        at = since[..., None] + span[..., None] * (_NODES + 1) / 2
        forward, left, _ = np.moveaxis(self._series(at, 1) @ self.S.T, -1, 0)
        psi = self.start[2] + self._series(at, 0) @ self.S[2]
        c, s = np.cos(psi), np.sin(psi)
        both = np.stack([c * forward - s * left, s * forward + c * left], axis=-1)
        return np.asarray(span[..., None] / 2 * np.einsum("...nj,n->...j", both, _WEIGHTS))

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
        knots: Array = self._knots  # type: ignore[attr-defined]
        at = np.clip((times / step).astype(int), 0, len(knots) - 1)
        place = self.start[:2] + knots[at] + self._way(at * step, times - at * step)
        nu, rate = (self._series(times, order) @ self.S.T for order in (1, 2))
        psi = self.start[2] + self._series(times, 0) @ self.S[2]
        c, s = np.cos(psi), np.sin(psi)
        forward, left, r = np.moveaxis(nu, -1, 0)
        along, aside = rate[..., 0] - r * left, rate[..., 1] + r * forward
        q = np.stack([place[..., 0], place[..., 1], psi], axis=-1)
        v = np.stack([c * forward - s * left, s * forward + c * left, r], axis=-1)
        return Reference(q, v, np.stack([c * along - s * aside, s * along + c * aside, rate[..., 2]], -1))


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

    It makes the determinant of the information of the parameters that `identify` looks for as large as it
    can:
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
    chassis = to_chassis(believed)
    prior = prior_of(believed, chassis)
    assert prior is not None
    problem = _Search(chassis, prior, T, length, limits, count)
    shape = count, 2, chassis.free if chassis.free < 3 else 3
    draws = [
        generator.standard_normal(shape) / np.arange(1, count + 1)[:, None, None] for _ in range(_CANDIDATES)
    ]
    best = problem.improved(min(draws, key=problem.cost), generator)
    return problem.motion(best)


class _Search:
    """The search for a motion.

    Parameters
    ----------
    chassis : Chassis
        The robot.
    prior : ndarray, shape (p,)
        What is believed of it.
    period, duration : float
        Of the motion [s].
    limits : list of ndarray, shape (3,)
        Of pose, velocity and acceleration.
    harmonics : int
        Of the series.
    """

    def __init__(
        self,
        chassis: Chassis,
        prior: Array,
        period: float,
        duration: float,
        limits: list[Array],
        harmonics: int,
    ) -> None:
        self.chassis, self.period, self.duration, self.limits = chassis, period, duration, limits
        self.S = None if chassis.free == 3 else chassis.S
        w = 2 * np.pi / period * np.arange(1, harmonics + 1)
        phase = w * (period / _PER_PERIOD) * np.arange(_PER_PERIOD)[:, None]
        zeroth = np.concatenate([np.sin(phase) / w, (1 - np.cos(phase)) / w], axis=1)
        first = np.concatenate([np.cos(phase), np.sin(phase)], axis=1)
        second = np.concatenate([-w * np.sin(phase), w * np.cos(phase)], axis=1)
        self.series = zeroth, first, second  # of all cosines, then all sines
        self.between = 1 + (np.pi * harmonics / _PER_PERIOD) ** 2 / 2  # peaks over those of samples
        mass, force = prior[0], prior[0] * _TYPICAL * limits[2][0]
        lever = max(np.sqrt(prior[3] / mass), 1e-3)
        ends = np.array([force, force, force * lever])
        rates = np.abs(chassis.A) @ (np.linalg.pinv(chassis.S) @ (_TYPICAL * limits[1]))
        torque = np.abs(np.linalg.pinv(chassis.A.T)) @ np.abs(chassis.S.T) @ ends
        size = np.array([mass, mass * lever, mass * lever, prior[3]])
        self.scales = np.concatenate([size, torque / rates, torque])
        self.weights = 1 / np.maximum(np.abs(chassis.S.T) @ ends, 1e-12)

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
        shares = np.max(
            [each.max(axis=0) / x for each, x in zip(bodies, self.limits[1:], strict=True)], axis=0
        )
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
        again = np.ceil(self.duration / self.period) - 1
        return np.asarray(
            np.max([np.abs(path).max(axis=0), np.abs(path + again * path[-1]).max(axis=0)], axis=0)
        )

    def motion(self, raw: Array) -> Excitation:
        """Return the motion of raw coefficients."""
        return Excitation(self.coefficients(raw), self.period, self.duration, self.S)

    def cost(self, raw: Array) -> float:
        """Return minus the logarithm of the information's determinant."""
        q, eta, rate = self.of(self.coefficients(raw))
        if self.S is None:
            eta, rate = _in_body(q[:, 2], eta, rate)
        Y = self.chassis.regressor(eta, rate) * self.scales * self.weights[:, None]
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
