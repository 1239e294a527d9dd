"""`Identification`: estimates of a robot's parameters from its logs, with their uncertainty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, bounded, check_integer, frozen, instance, scalar, seeded
from pinmobile.errors import InvalidArgument
from pinmobile.identification._estimator import Whiteness
from pinmobile.identification._log import Log
from pinmobile.identification._preprocessing import Slippage

_LOST_SHARE = 0.02  # unidentifiable share of a parameter's direction from which its interval is infinite
_WIDE_LEVEL = 0.999  # level of the interval that must contain a plausible body
_ROUNDS = 200  # largest number of rounds of draws


class Prediction(NamedTuple):
    """Prediction of a log by an identified robot, beside the measurements: the result of `predict`.

    Attributes
    ----------
    names, units : tuple of k str
        Names and units of the measurements: x, y and psi, or speed and yaw rate.
    t : ndarray, shape (S, L)
        Times of the segments since the first sample [s]. Each segment has its own initial state.
    measured, predicted : ndarray, shape (S, L, k)
        Measured and predicted values [m, m, rad] or [m/s, rad/s].
    rms : ndarray, shape (k,)
        Root mean square of their difference, without outliers.
    noise : ndarray, shape (k,)
        Standard deviation of the sensor noise: no prediction has a smaller rms.

    See Also
    --------
    identification.Identification : its method ``predict`` returns a prediction
    plots.prediction : draw measured and predicted values

    Examples
    --------
    >>> from pinmobile import ComputedTorque, Lissajous, Log, Tangent
    >>> from pinmobile import MobileRobot, identify, rk4, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> motion = Tangent(Lissajous(1, 1, 1.0, 0.5, duration=24))
    >>> run = simulate(robot, ComputedTorque(robot), motion,
    ...                dt=0.1, integrator=rk4)
    >>> log = Log.from_rollout(run, noise=1e-3)
    >>> prediction = identify(log, robot).predict(log)
    >>> prediction.names, prediction.rms[:2].round(3)  # [m]
    (('x', 'y', 'psi'), array([0.001, 0.001]))
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    t: Array
    measured: Array
    predicted: Array
    rms: Array
    noise: Array

    def __str__(self) -> str:
        span, rows = self.t[0, -1] - self.t[0, 0], (self.names, self.units, self.rms, self.noise)
        return f"rms of {span:.3g} s ahead: {_residuals(*rows)}"


def _digits(value: float, error: float) -> int:
    """Return the number of digits with which an estimate differs from the ends of its interval."""
    with np.errstate(all="ignore"):
        size = np.log10(abs(value) / error)
    return int(np.clip(np.ceil(size) + 2, 4, 8)) if np.isfinite(size) else 4


def _residuals(*rows: Any) -> str:
    """Return names, units, residuals and noise of measurements as text."""
    return ", ".join(
        f"{name} {1e3 * left:.3g} m{unit}" + f" (noise {1e3 * noise:.3g})" * bool(noise != left)
        for name, unit, left, noise in zip(*rows, strict=True)
    )


@final
@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Identification:
    """Estimates of a robot's parameters from its logs: the result of `identify` and `identify_velocity`.

    ``print(found)`` gives a table of the estimates with their intervals, and the `notes`.

    Attributes
    ----------
    model : object
        Internal model of the robot.
    phi : ndarray, shape (p,)
        Estimated numbers of the model. A body has (m, m x, m y, I about its origin, friction, ...): the
        equations of motion are linear in them. A robot with velocity inputs has theta and further numbers, a
        car the fields of `VelocityCar`.
    covariance_of_phi : ndarray, shape (p, p)
        Covariance of `phi`, by the jackknife over segments; for the weak form by Newey and West.
    freedom : int
        Degrees of freedom of Student's t.
    method : str
        ``"output error"`` or ``"weak"``. Noisy inputs also select the weak form.
    input_noise_bias : float
        Bias of output error by input noise, in standard deviations; 0 if the weak form was requested.
    prior : MobileRobot, WheeledRobot or None
        Prior robot. For a wheel table, an arbitrary body on these wheels.
    rank : int
        Number of identifiable directions of `phi`.
    unseen : str
        Directions that are not identifiable, in words; "" if all are identifiable.
    hidden : ndarray, shape (p,)
        Share of each parameter's direction that is not identifiable.
    unknown : ndarray, shape (p, d)
        Standard deviations of `phi` along the directions that are not identifiable.
    delay : float
        Delay of measurements relative to inputs [s].
    delay_error : float
        Standard deviation of the delay [s]; NaN if the delay was given.
    dt, seconds : float
        Time step, and length of a segment [s].
    outliers, dropped, samples, segments : int
        Numbers of outliers, rows with NaN, samples, and simulated segments.
    noise, residual : ndarray, shape (k,)
        Standard deviation of the sensor noise, and rms of the residual, for each measurement.
    chi2 : float
        Mean square of the residuals divided by the noise: 1 if only sensor noise remains.
    whiteness : object
        Autocorrelation of the residuals; ``whiteness.is_white`` states whether it is that of white noise.
    is_noise : bool
        Whether sensor and input noise explains the residuals. Otherwise the model structure is wrong, and the
        intervals are not valid.
    explained : float
        Share of the inputs that the motion explains. For a robot with velocity inputs, share of the motion
        that the commands explain.
    slippage : object or None
        Deviation of the poses from rolling, for the worst log; None if it is not identifiable.
    free_run : mapping of str to tuple of 2 float
        R^2 of the speeds of a free run, by channel: of the log, and of its last third for a fit to the rest.
        With forces, torques and voltages, a run ends after 10 s.
    remarks : tuple of str
        Further findings about the log: sections that are left out, a delay that is taken as zero, results
        that depend on the length of segments.
    clipped : str
        Inputs that stay at their extremes, in words; "" if there are none.

    See Also
    --------
    identify : estimate mass, inertia and friction
    identify_velocity : estimate the parameters of a robot with velocity inputs
    identification.Prediction : result of ``predict``
    ensemble : runs with robots from ``spread``

    Examples
    --------
    >>> from pinmobile import ComputedTorque, Lissajous, Log, Tangent
    >>> from pinmobile import MobileRobot, identify, rk4, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> motion = Tangent(Lissajous(1, 1, 1.0, 0.5, duration=24))
    >>> run = simulate(robot, ComputedTorque(robot), motion,
    ...                dt=0.1, integrator=rk4)
    >>> found = identify(Log.from_rollout(run, noise=1e-3), robot)
    >>> low, high = found.interval(0.95)["mass"]  # [kg]
    >>> low < 30 < high, high - low < 0.5
    (True, True)
    """

    model: Any
    phi: Array
    covariance_of_phi: Array
    freedom: int
    rank: int
    unseen: str
    hidden: Array
    unknown: Array
    delay: float
    delay_error: float
    dt: float
    seconds: float
    outliers: int
    samples: int
    segments: int
    noise: Array
    residual: Array
    whiteness: Whiteness
    is_noise: bool
    explained: float
    dropped: int = 0
    chi2: float = 1.0
    method: str = "output error"
    input_noise_bias: float = 0.0
    prior: Any = None
    slippage: Slippage | None = None
    clipped: str = ""
    free_run: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name, value in vars(self).copy().items():
            if isinstance(value, np.ndarray):
                object.__setattr__(self, name, frozen(value))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(quantity.name for quantity in self.model.quantities)

    def _map_names(self, values: Any) -> Mapping[str, Any]:
        return MappingProxyType(dict(zip(self.names, values, strict=True)))

    @property
    def values(self) -> Array:
        """Estimates, shape (p,), in the order of `names` and in the units of `units`."""
        return np.asarray(self.model.to_physical(self.phi))

    @property
    def theta(self) -> Array:
        """The six parameters of a robot with velocity inputs, shape (6,), see `VelocityRobot`."""
        return self.phi[:6]

    @property
    def parameters(self) -> Mapping[str, float]:
        """Estimates by name. A body has mass, centre of mass, yaw inertia about it, and friction."""
        return self._map_names(self.values.tolist())

    @property
    def units(self) -> Mapping[str, str]:
        """Units of the parameters, by name."""
        return self._map_names(quantity.unit for quantity in self.model.quantities)

    @property
    def covariance(self) -> Array:
        """Covariance of `values`, shape (p, p), by the delta method.

        The covariance includes the uncertainty of the directions that are not identifiable, in which the
        prior replaces the estimate.
        """
        D = self.model.slopes(self.phi)
        covariance = np.asarray(D @ (self.covariance_of_phi + self.unknown @ self.unknown.T) @ D.T)
        endless = np.flatnonzero(~self._identifiable & (np.diag(covariance) == 0))
        covariance[endless, endless] = np.inf
        return covariance

    @property
    def standard_errors(self) -> Mapping[str, float]:
        """Standard errors of the parameters, by name; infinite for parameters that are not identifiable."""
        return self._map_names(self._errors.tolist())

    @property
    def _errors(self) -> Array:
        return np.where(self._identifiable, np.sqrt(np.diag(self.covariance)), np.inf)

    @property
    def _identifiable(self) -> NDArray[np.bool_]:
        return np.asarray((self.model.slopes(self.phi)[:, self.hidden > _LOST_SHARE] == 0).all(axis=1))

    @property
    def is_identifiable(self) -> Mapping[str, bool]:
        """Whether the log identifies each parameter, by name."""
        return self._map_names(self._identifiable.tolist())

    def interval(self, level: float = 0.95) -> Mapping[str, tuple[float, float]]:
        """Return the confidence interval of each parameter, by name.

        The interval uses Student's t. It is infinite if the parameter is not identifiable. It is not valid if
        `is_noise` is false, because it does not cover the error of a wrong model. The interval of a
        parameter that cannot be negative starts at zero or above. If its estimate is negative, the interval
        ends at its half width.

        Parameters
        ----------
        level : float
            Confidence level, in (0, 1).

        Returns
        -------
        intervals : mapping of str to tuple of 2 float
            Lower and upper bound, in the unit of the parameter.

        Raises
        ------
        InvalidArgument
            If `level` is outside (0, 1).
        """
        half, bounds = self._deviations(level) * self._errors, [n.nonnegative for n in self.model.quantities]
        low, high = self.values - half, self.values + half
        low, high = (np.where(bounds, np.maximum(x, y), x) for x, y in ((low, 0.0), (high, half)))
        return self._map_names(zip(low.tolist(), high.tolist(), strict=True))

    def delay_interval(self, level: float = 0.95) -> tuple[float, float]:
        """Return the confidence interval of the delay [s]; NaN if the delay was given or is not identifiable.

        Like that of any number that cannot be negative, it is cut at zero.

        Parameters
        ----------
        level : float
            Confidence level, in (0, 1).

        Raises
        ------
        InvalidArgument
            If `level` is outside (0, 1).
        """
        half = self._deviations(level) * self.delay_error
        return float(np.maximum(self.delay - half, 0.0)), self.delay + half

    def _deviations(self, level: float) -> float:
        """Return the half width of Student's interval in standard deviations."""
        from scipy.stats import t  # slow to load

        share = bounded("level", scalar("level", level), above=0, below=1)
        return float(t.ppf(0.5 + share / 2, self.freedom))

    def __repr__(self) -> str:
        units, count = self.units, self.model.summary_size
        first = ", ".join(f"{n} {v:.4g} {units[n]}".rstrip() for n, v in [*self.parameters.items()][:count])
        return f"<Identification: {first}; rank {self.rank} of {len(self.phi)}>"

    def __str__(self) -> str:
        width = max(map(len, self.names))
        valid = "95 % interval" if self.whiteness.is_white else "95 % if noise alone"
        header = f"{valid if self.is_noise else '95 %, not valid':^23}"
        lines = [f"{'':{width}} {'estimate':>10} {'std. error':>10}  {header}  unit"]
        rows = self.parameters.items(), self._errors, self.interval().values(), self.units.values()
        for (name, value), error, (low, high), unit in zip(*rows, strict=True):
            n = _digits(value, error)
            numbers = f"{value:10.{n}g} {error:10.2g}  {low:10.{n}g} to {high:<9.{n}g}"
            lines.append(f"{name:{width}} {numbers}  {unit}".rstrip())
        return "\n".join([*lines, *self.notes])

    @property
    def notes(self) -> tuple[str, ...]:
        """Further findings, one sentence each."""
        low, high = (1e3 * each for each in self.delay_interval())
        rho = np.abs(self.whiteness.correlation).max()
        finding = f"the residual is correlated ({rho:.2f} between successive samples)"
        runs = [f"{name} {r2:.3g} (hold-out {r2_test:.3g})" for name, (r2, r2_test) in self.free_run.items()]
        bias = f"noise of the inputs biases output error by {self.input_noise_bias:.1f} standard deviations"
        sentences = [
            f"{self.samples} samples at {1 / self.dt:.4g} Hz, {self.dropped} dropped, {self.outliers} "
            f"outliers; {self.method}, {self.segments} segment{'s' * (self.segments != 1)} of "
            f"{'up to ' * (self.freedom >= self.segments)}{self.seconds:.3g} s; rank {self.rank} of "
            f"{len(self.phi)}",
            f"{bias}: the weak form replaces it" if self.input_noise_bias and self.method == "weak" else "",
            f"delay of measurements {1e3 * self.delay:.3g} ms"
            + ("" if np.isnan(low) else f" (95 % interval {low:.3g} to {high:.3g})")
            + f": {self.delay / self.dt:.2f} samples",
            f"residual: {_residuals(*zip(*self.model.measured, strict=True), self.residual, self.noise)}",
            "the residual is white: sensor noise explains it"
            if self.whiteness.is_white
            else f"{finding}, as with input noise: if input noise is the cause, the intervals are valid; "
            "they do not cover the error of a force that depends on the motion and is not in the model, such "
            "as rolling resistance that depends on load"
            if self.is_noise
            else f"{finding}, more than noise explains: the structure of the model is wrong, "
            "and the intervals are not valid; is there slip, a clipped input, a limit of the firmware, a "
            "slope, or resistance that depends on load?",
            f"R^2 of a free run: {'; '.join(runs)}" if runs else "",
            *(self.unseen, self.clipped, *self.remarks, *self._negative, *self.model.notes(self)),
        ]
        return tuple(filter(None, sentences))

    @property
    def _negative(self) -> tuple[str, ...]:
        """Negative estimates of parameters that cannot be negative, in words."""
        usual, wide = map(self._deviations, (0.95, _WIDE_LEVEL))  # one of eight exceeds 95 % by chance
        rows = zip(self.model.quantities, self.values, self._errors, strict=True)
        return tuple(
            f"{quantity.name} is {value:.3g} {quantity.unit}, below zero "
            + ("within" if value + wide * error >= 0 else "(the model lacks a force) by more than")
            + f" its uncertainty, {usual * error:.3g}"
            for quantity, value, error in rows
            if quantity.nonnegative and value < 0 and np.isfinite(error)
        )

    @cached_property
    def plausible(self) -> Array:
        """Most likely `phi` of a possible body with nonnegative friction, shape (p,).

        It equals `phi` if `phi` is possible. Otherwise it is the nearest possible one in the metric of the
        covariance. `robot` and `forces` use it. Estimates and intervals do not: a projection would spoil the
        coverage of the intervals.

        Raises
        ------
        InvalidArgument
            If there is no possible body near the estimate.
        """
        body = self.model.plausible(self.phi, self.covariance_of_phi)
        values, nearest = self.values, self.model.to_physical(body)
        wide = self._deviations(_WIDE_LEVEL) * np.sqrt(np.diag(self.covariance)) + 1e-9 * np.abs(values)
        for k in np.flatnonzero((np.abs(nearest - values) > wide)[:4]):
            quantity = self.model.quantities[k]
            raise InvalidArgument(
                f"log leads to a {quantity.name} of {values[k]:.4g} {quantity.unit}, but with nonnegative "
                f"friction to {nearest[k]:.4g}: {'; '.join(self._negative)}; expected a robot with all "
                "forces: is the given friction of its motors too high?"
            )
        return frozen(body)

    def robot(self) -> Any:
        """Return the identified robot, without the delay.

        A body gets mass, centre of mass and yaw inertia from `plausible`. Numbers that a motion in the plane
        does not identify come from the prior. The motors' torque constants contain an identified scale of
        voltages.

        Returns
        -------
        robot : MobileRobot, WheeledRobot, ByVoltage, VelocityRobot or VelocityCar
            Robot of the kind that was identified.

        Raises
        ------
        InvalidArgument
            If there is no plausible body, or a parameter of a robot with velocity inputs is not identifiable.
        """
        return self.model.robot(self)

    def forces(self) -> list[Any]:
        """Return the friction as forces for `simulate`, see `plausible`; empty for velocity inputs."""
        return list(self.model.forces(self))

    def spread(self, n: int, seed: Any = 0) -> dict[str, Array]:
        """Return joint draws of the parameters for `ensemble`, by names such as ``"com.x"``.

        The spread includes the friction coefficients of `forces`: the loop needs these forces. It leaves out
        the friction of a motor that drives several wheels.

        Parameters
        ----------
        n : int
            Number of draws.
        seed : int, SeedSequence, BitGenerator or Generator
            Seed of the draws.

        Returns
        -------
        spread : dict of str to ndarray, shape (n,)
            Draws of Student's t with the estimated covariance. Impossible bodies are drawn again, and
            friction is not negative.

        Raises
        ------
        InvalidArgument
            If a parameter is not identifiable, or almost all draws are impossible bodies.
        """
        n, generator = check_integer("n", n), seeded("seed", seed)
        check_identifiable("spread", self.unseen)
        values, vectors = np.linalg.eigh(self.covariance_of_phi)
        half, phi = vectors * np.sqrt(np.maximum(values, 0)), np.empty((0, len(self.phi)))
        for _ in range(_ROUNDS):
            normal = generator.standard_normal((n - len(phi), len(self.phi)))
            wide = np.sqrt(self.freedom / generator.chisquare(self.freedom, len(normal)))
            draws = self.phi + wide[:, None] * (normal @ half.T)
            phi = np.vstack([phi, draws[self.model.are_possible(draws)]])
            if len(phi) == n:
                break
        else:
            raise InvalidArgument(
                "spread: almost no draw is a possible robot, expected a log of a more informative motion"
            )
        return {
            quantity.path: np.maximum(x, 0.0) if quantity.nonnegative else x
            for quantity, x in zip(self.model.quantities, self.model.to_physical(phi).T, strict=True)
            if quantity.path
        }

    def predict(self, log: Log, seconds: float | None = None) -> Prediction:
        """Return the prediction of another log, beside the noise of its sensors.

        The prediction simulates segments of the log from the initial states that fit best.

        Parameters
        ----------
        log : Log
            Another log of the same robot, without a load, with the same measurements.
        seconds : float, optional
            Length of a segment [s]; default: 2 s for a body, otherwise the length of the identification.

        Returns
        -------
        prediction : Prediction
            Measured and predicted values.

        Raises
        ------
        InvalidArgument
            If the log is too short or has other measurements, or the prediction diverges.
        """
        instance("log", log, Log, "a Log")
        segments, residual, good, noise = self.model.predicted(self, log, seconds)
        names, units = zip(*self.model.measured, strict=True)
        measured, left = segments.y[..., self.model.columns], residual[..., self.model.columns]
        rms = np.sqrt((left[good] ** 2).mean(axis=0))
        return Prediction(names, units, segments.t, measured, measured - left, rms, noise)


def check_identifiable(method: str, directions: str) -> None:
    """Reject the call of a method that needs all parameters if some are not identifiable."""
    if directions:
        raise InvalidArgument(
            f"{method}() needs a log that identifies all parameters: {directions}; expected a motion in "
            "which all velocities change often and independently"
        )


def format_directions(quantities: Sequence[str], directions: Array) -> str:
    """Return in words the directions of the parameters that are not identifiable; "" if all are."""
    from scipy.sparse.csgraph import connected_components  # slow to load

    names, projector = np.array(quantities), directions @ directions.T
    share = np.diag(projector)
    single, rest = names[share > 0.98], np.flatnonzero((share > 0.02) & (share <= 0.98))
    count, group = connected_components(np.abs(projector[np.ix_(rest, rest)]) > 0.05)
    texts = [f"the motion does not identify {', '.join(single)}"] if single.size else []
    groups = (", ".join(names[rest[group == k]]) for k in range(count))
    return "; ".join([*texts, *(f"the motion identifies only combinations of {each}" for each in groups)])
