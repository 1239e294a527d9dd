"""`excitation`: informative motions for identification, within limits."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, bounded, check_integer, finite, positive, seeded, shaped
from pinmobile.identification._planar_model import PlanarModel
from pinmobile.parts import array, number, part
from pinmobile.robot import MobileRobot
from pinmobile.trajectories import Reference

_CANDIDATES, _STARTS = 60, 3  # number of random motions, and of the best of them that a search improves
_ORDERS = 16.0, 128.0  # of norms that replace the largest ratio to the limits
_ITERATIONS, _DIGITS = 60, 6  # of a search, and decimals of its numbers
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
        kind = "free body" if self.S is None else "on wheels"
        series = f"{len(self.coefficients)} harmonics of {self.period:g} s"
        return f"<Excitation: {kind}, {series}, over {self.duration:g} s>"

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

    def _way(self, starts: Array, span: Array) -> Array:
        """Return the displacement of a wheeled robot in the plane over time spans, complex, shape (...)."""
        psi, _, _, nu, _ = self._body(starts[..., None] + span[..., None] * (_NODES + 1) / 2)
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
        k = np.clip((times / step).astype(int), 0, len(self._knots) - 1)
        psi, r, turn, nu, rate = self._body(times)
        place = self.start[0] + 1j * self.start[1] + self._knots[k] + self._way(k * step, times - k * step)
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
    estimates. It scales each candidate so that the motion reaches the limits. A search along the exact
    gradient improves the best of 60 random candidates. A robot on wheels gets a motion along which its wheels
    roll.

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
    count, generator = check_integer("harmonics", harmonics, least=3), seeded("seed", seed)
    T, length = positive("period", period, "s"), positive("duration", duration, "s")
    assumption = MobileRobot.box() if robot is None else robot
    model = PlanarModel.of(assumption)
    prior = model.prior(assumption)
    problem = _Search(model, prior, (T, length, count), limits)
    shape = count, 2, model.free
    order = np.arange(1, count + 1)[:, None, None]
    draws = [generator.standard_normal(shape) / order for _ in range(_CANDIDATES)]
    draws.sort(key=lambda raw: problem.cost(problem.coefficients(raw))[0])
    candidates = [problem.coefficients(problem.improve(raw)) for raw in draws[:_STARTS]]
    return Excitation(min(candidates, key=lambda x: problem.cost(x)[0]), T, length, problem.S)


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
        self.series = np.array([np.concatenate(row, axis=1) for row in rows])  # columns of a_l, then of b_l
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
        return self.scale_to_limits(_at_rest(raw), np.inf)[0]

    def scale_to_limits(self, x: Array, order: float) -> tuple[Array, Callable[[Array], Array]]:
        """Return coefficients scaled into the limits, and the function that returns a gradient by `x`.

        The scale is the norm, of this order, of the ratios to the limits: an infinite order gives the largest
        ratio, and a finite one nearly the same with a gradient.
        """
        if self.S is None:
            limits = np.array(self.limits)[:, None] / self.between
            size, slope = _norm(np.abs(self.of(x)) / limits, order)
            by_size = self.back(slope * np.sign(self.of(x)) / limits)
            return _normalize(x, np.full(3, size), np.stack([by_size] * 3))
        S, rows, limits = np.abs(self.S[[0, 2]]), self.of(x)[1:], np.array(self.limits[1:])[:, [0, 2]]
        norms = [_norm(self.between * np.abs(rows) @ S[j] / limits[:, j, None], order) for j in range(2)]
        slopes = [
            np.sign(rows) * (slope * self.between / limits[:, j, None])[..., None] * S[j]
            for j, (_, slope) in enumerate(norms)
        ]
        sizes = np.maximum([size for size, _ in norms], 1e-9)
        one, pull = _normalize(x, sizes, np.stack([self.back([0 * rows[0], *each]) for each in slopes]))
        distance, by_far = self.reach(one, order)
        two, pull_far = _normalize(one, np.array([distance, 1.0]), np.stack([by_far, 0 * by_far]))
        return two, lambda g: pull(pull_far(g))

    def of(self, coefficients: Array) -> Array:
        """Return the coordinates of a period and their two derivatives, shape (3, n, k)."""
        return np.asarray(self.series @ np.concatenate([coefficients[:, 0], coefficients[:, 1]]))

    def back(self, slopes: Any) -> Array:
        """Return the gradient by the coefficients from that by the coordinates, shape (3, n, k)."""
        total = (np.swapaxes(self.series, 1, 2) @ np.asarray(slopes)).sum(axis=0)
        return np.stack(np.split(total, 2), axis=1)

    def reach(self, coefficients: Array, order: float) -> tuple[float, Array]:
        """Return the norm of 1 and of distances in x and y per limit over all periods, and its gradient."""
        assert self.S is not None
        q, eta, _ = self.of(coefficients)
        rotation = np.exp(1j * (q @ self.S[2])) * self.period / _PER_PERIOD
        nu, limits = eta @ (self.S[0] + 1j * self.S[1]), self.limits[0][:2, None]
        path, periods = np.cumsum(rotation * nu), np.ceil(self.duration / self.period) - 1
        places = np.stack([each for z in (path, path + periods * path[-1]) for each in (z.real, z.imag)])
        limits = np.tile(limits, (2, 1))
        size, slope = _norm(np.append(np.abs(places) / limits, 1.0), order)
        rows = slope[:-1].reshape(places.shape) * np.sign(places) / limits
        first, last = rows[0] + 1j * rows[1], rows[2] + 1j * rows[3]
        by_path = first + last
        by_path[-1] += periods * last.sum()
        by_nu = rotation.conj() * np.cumsum(by_path[::-1])[::-1]
        by_psi = (by_nu.conj() * 1j * nu).real
        by_eta = by_nu.real[:, None] * self.S[0] + by_nu.imag[:, None] * self.S[1]
        return size, self.back([by_psi[:, None] * self.S[2], by_eta, 0 * by_eta])

    def cost(self, coefficients: Array) -> tuple[float, Array]:
        """Return minus the logarithm of the determinant of the information matrix, and its gradient."""
        (q, eta, rate), model, a = self.of(coefficients), self.model, len(self.model.A)
        if self.S is None:
            rotation = np.exp(-1j * q[:, 2])
            nu, faster = (rotation * (each[:, 0] + 1j * each[:, 1]) for each in (eta, rate))
            r, turn, eta = eta[:, 2], rate[:, 2], np.column_stack([nu.real, nu.imag, eta[:, 2]])
        else:
            (forward, left, r), (du, dw, turn) = (eta @ self.S.T).T, (rate @ self.S.T).T
            nu = forward + 1j * left
            faster = du + 1j * dw + 1j * r * nu
        rates, size = eta @ model.A.T, self.scales * self.weights[:, None]
        slow = np.hypot(rates, model.speed)
        Y = model.rows(faster.real, faster.imag, turn, r * r, rates, rates / slow) * size
        flat = Y.reshape(-1, Y.shape[-1])
        information = flat.T @ flat / len(q) + 1e-12 * np.eye(flat.shape[1])
        by_row = (-2 / len(q) * np.linalg.solve(information, flat.T).T).reshape(Y.shape) * size
        body = np.einsum("ai,nij->naj", model.S, by_row[..., :4])
        by_faster = body[:, 0, 0] - body[:, 2, 2] + 1j * (body[:, 1, 0] + body[:, 2, 1])
        by_turn = body[:, 1, 1] - body[:, 0, 2] + body[:, 2, 3]
        by_r = -2 * r * (body[:, 0, 1] + body[:, 1, 2])
        viscous, dry = (
            np.einsum("nia,ai->na", by_row[..., 4 + a * j : 4 + a * (j + 1)], model.A) for j in (0, 1)
        )
        by_eta = (viscous + dry * model.speed**2 / slow**3) @ model.A
        if self.S is None:
            by_nu = by_eta[:, 0] + 1j * by_eta[:, 1]
            by_psi = (-1j * (by_nu.conj() * nu + by_faster.conj() * faster)).real
            by_v, by_a = rotation.conj() * by_nu, rotation.conj() * by_faster
            rows = (0 * r, 0 * r, by_psi), (by_v.real, by_v.imag, by_eta[:, 2] + by_r)
            slopes = [np.column_stack(row) for row in (*rows, (by_a.real, by_a.imag, by_turn))]
        else:
            by_nu, by_r = -1j * r * by_faster, by_r + (by_faster.conj() * 1j * nu).real
            by_eta = by_eta + np.column_stack([by_nu.real, by_nu.imag, by_r]) @ self.S
            slopes = [0 * q, by_eta, np.column_stack([by_faster.real, by_faster.imag, by_turn]) @ self.S]
        return -float(np.linalg.slogdet(information)[1]), self.back(slopes)

    def improve(self, raw: Array) -> Array:
        """Return raw coefficients with a lower cost, by a quasi-Newton search with norms of two orders.

        The search sees rounded numbers, so that its path does not depend on the rounding of a processor.
        """
        from scipy.optimize import minimize  # slow to load

        def norm_cost(x: Array, order: float) -> tuple[float, Array]:
            coefficients, pull = self.scale_to_limits(
                _at_rest(np.round(x.reshape(raw.shape), _DIGITS)), order
            )
            cost, by_coefficients = self.cost(coefficients)
            return round(cost, _DIGITS), np.round(_at_rest(pull(by_coefficients)).ravel(), _DIGITS)

        x = np.ravel(raw)
        for order in _ORDERS:
            begin, options = x / np.abs(x).mean(), {"maxiter": _ITERATIONS}
            x = minimize(norm_cost, begin, (order,), "L-BFGS-B", jac=True, options=options).x
        return np.round(x.reshape(raw.shape), _DIGITS)


def _at_rest(raw: Array) -> Array:
    """Return the nearest coefficients of a motion that begins and ends at rest."""
    order = np.arange(1, len(raw) + 1.0)[:, None]
    a = raw[:, 0] - raw[:, 0].mean(axis=0)
    return np.stack([a, raw[:, 1] - order * (order * raw[:, 1]).sum(axis=0) / (order**2).sum()], axis=1)


def _norm(ratios: Array, order: float) -> tuple[float, Array]:
    """Return the norm of positive ratios, and its gradient, which is zero for an infinite order."""
    largest = float(ratios.max())
    if np.isinf(order):
        return largest, 0 * ratios
    size = largest * float(((ratios / largest) ** order).sum() ** (1 / order))
    return size, (ratios / size) ** (order - 1)


def _normalize(x: Array, sizes: Array, slopes: Array) -> tuple[Array, Callable[[Array], Array]]:
    """Return columns divided by sizes that depend on them, and the function that returns a gradient by them.

    Parameters
    ----------
    x : ndarray, shape (L, 2, k)
        Coefficients.
    sizes, slopes : ndarray, shape (k,), (k, L, 2, k)
        Sizes and their derivatives by the coefficients.
    """
    return x / sizes, lambda g: g / sizes - np.tensordot((g * x).sum(axis=(0, 1)) / sizes**2, slopes, 1)
