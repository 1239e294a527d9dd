"""`Identification`: estimates of a robot's parameters from its logs, with their uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, bounded, frozen, instance, scalar, seeded, whole
from pinmobile.errors import InvalidArgument
from pinmobile.identification._estimator import Whiteness
from pinmobile.identification._log import Log
from pinmobile.identification._preprocessing import Slippage

_UNSEEN = 0.02  # share of a parameter's direction that may be unidentifiable before its interval is endless
_FAR = 0.999  # level of the interval in which a plausible body must be
_ROUNDS = 200  # of draws


class Prediction(NamedTuple):
    """Measurements, and what the identified robot does under the same input.

    Attributes
    ----------
    names, units : tuple of k str
        Of the measurements: x, y and psi, or speed and yaw rate.
    t : ndarray, shape (S, L)
        Times since the first sample, of segments each of which starts anew [s].
    measured, predicted : ndarray, shape (S, L, k)
        Values [m, m, rad; or m/s, rad/s].
    rms : ndarray, shape (k,)
        Root mean square of their difference without outliers.
    noise : ndarray, shape (k,)
        Standard deviation of the sensor's noise: a bound of all predictions. Of a robot with velocity
        inputs, the rms of the residual of the identification.
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


def _residuals(*rows: Any) -> str:
    """Return names, units, residuals and noise of measurements in words."""
    return ", ".join(
        f"{name} {1e3 * left:.3g} m{unit} (noise {1e3 * noise:.3g})"
        for name, unit, left, noise in zip(*rows, strict=True)
    )


@final
@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Identification:
    """Estimates of a robot's parameters from its logs: the result of `identify` and `identify_velocity`.

    Attributes
    ----------
    model : PlanarModel or VelocityModel
        Model whose numbers were estimated.
    phi : ndarray, shape (p,)
        These numbers: of a body (m, m x, m y, I about its origin, friction, ...), in which its equations are
        linear; of a robot with velocity inputs theta, and further numbers.
    covariance_of_phi : ndarray, shape (p, p)
        Their covariance: by the jackknife over segments, of the weak form by Newey and West.
    freedom : int
        Degrees of freedom of Student's t.
    method : str
        ``"output error"``, or ``"weak"``, which noisy inputs select too.
    input_noise_bias : float
        Bias of output error by noise of the inputs, in standard deviations; 0 where it was not selected.
    prior : MobileRobot, WheeledRobot or None
        Robot assumed before; of wheels alone, an arbitrary body on them.
    rank : int
        Number of identifiable directions among p.
    unseen : str
        Directions that are not identifiable, in words; "" where all are.
    hidden : ndarray, shape (p,)
        Share of each parameter's direction that is not identifiable.
    unknown : ndarray, shape (p, d)
        Standard deviations of phi along these directions.
    delay, delay_error : float
        Delay of measurements relative to inputs, and its standard deviation [s]; NaN where it was given.
    dt, seconds : float
        Time step, and length of a segment [s].
    outliers, dropped, samples, segments : int
        Outliers; rows with NaN; samples; simulated segments.
    noise, residual : ndarray, shape (k,)
        Standard deviation of the sensors' noise, and rms of the residual; of velocities they are the same.
    chi2 : float
        Mean square of all residuals over the noise: 1 where only the sensors' noise is left.
    whiteness : Whiteness
        Correlation of the residuals.
    is_noise : bool
        Whether noise of sensors and inputs explains the residuals. Otherwise the structure of the model is
        wrong, and intervals are not valid.
    explained : float
        Share of the inputs that the motion explains; of velocities, of the motion that commands explain.
    slippage : Slippage or None
        Deviation of poses from rolling, of the worst log; None where it is not identifiable.
    clipped : str
        Inputs that stay at their extremes, in words; "" where none does.
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
    dropped: int
    samples: int
    segments: int
    noise: Array
    residual: Array
    whiteness: Whiteness
    is_noise: bool
    explained: float
    chi2: float = 1.0
    method: str = "output error"
    input_noise_bias: float = 0.0
    prior: Any = None
    slippage: Slippage | None = None
    clipped: str = ""

    def __post_init__(self) -> None:
        for name, value in vars(self).copy().items():
            if isinstance(value, np.ndarray):
                object.__setattr__(self, name, frozen(value))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(one.name for one in self.model.quantities)

    def _named(self, values: Any) -> Mapping[str, Any]:
        return MappingProxyType(dict(zip(self.names, values, strict=True)))

    @property
    def values(self) -> Array:
        """The estimates, shape (p,)."""
        return np.asarray(self.model.to_physical(self.phi))

    @property
    def theta(self) -> Array:
        """Of a robot with velocity inputs, its six numbers, shape (6,)."""
        return self.phi[:6]

    @property
    def parameters(self) -> Mapping[str, float]:
        """The estimates by name: of a body mass, centre of mass, yaw inertia about it and friction."""
        return self._named(self.values.tolist())

    @property
    def units(self) -> Mapping[str, str]:
        """Units of the parameters by name."""
        return self._named(one.unit for one in self.model.quantities)

    @property
    def covariance(self) -> Array:
        """Covariance of `parameters`, in their order, shape (p, p), by the delta method.

        It includes the uncertainty of directions that are not identifiable, in which the prior is kept.
        """
        D = self.model.slopes(self.phi)
        found = np.asarray(D @ (self.covariance_of_phi + self.unknown @ self.unknown.T) @ D.T)
        endless = np.flatnonzero(~self._identifiable & (np.diag(found) == 0))
        found[endless, endless] = np.inf
        return found

    @property
    def standard_errors(self) -> Mapping[str, float]:
        """Standard errors of the parameters by name; infinite where they are not identifiable."""
        return self._named(self._errors.tolist())

    @property
    def _errors(self) -> Array:
        return np.where(self._identifiable, np.sqrt(np.diag(self.covariance)), np.inf)

    @property
    def _identifiable(self) -> NDArray[np.bool_]:
        return np.asarray((self.model.slopes(self.phi)[:, self.hidden > _UNSEEN] == 0).all(axis=1))

    @property
    def is_identifiable(self) -> Mapping[str, bool]:
        """Whether the log identifies a parameter, by name."""
        return self._named(self._identifiable.tolist())

    def interval(self, level: float = 0.95) -> Mapping[str, tuple[float, float]]:
        """Return the confidence interval of each parameter by name.

        It is Student's; endless where the parameter is not identifiable, and not valid where `is_noise` is
        false: it does not cover the error of a wrong structure. Of a parameter that cannot be below zero it
        starts at zero or above; where the estimate is below zero, it ends at its half width.

        Parameters
        ----------
        level : float
            Confidence level, in (0, 1).

        Raises
        ------
        InvalidArgument
            If the level is not in this range.
        """
        half, bounded = self._deviations(level) * self._errors, [one.bounded for one in self.model.quantities]
        low, high = self.values - half, self.values + half
        low, high = (np.where(bounded, np.maximum(x, y), x) for x, y in ((low, 0.0), (high, half)))
        return self._named(zip(low.tolist(), high.tolist(), strict=True))

    def delay_interval(self, level: float = 0.95) -> tuple[float, float]:
        """Return the confidence interval of the delay [s]; NaN where it was given or is not identifiable.

        Parameters
        ----------
        level : float
            Confidence level, in (0, 1).
        """
        half = self._deviations(level) * self.delay_error
        return self.delay - half, self.delay + half

    def _deviations(self, level: float) -> float:
        """Return the half width of Student's interval in standard deviations."""
        from scipy.stats import t  # here, because it takes long to load

        share = bounded("level", scalar("level", level), above=0, below=1)
        return float(t.ppf(0.5 + share / 2, self.freedom))

    def __repr__(self) -> str:
        units, many = self.units, self.model.told_first
        first = ", ".join(f"{n} {v:.4g} {units[n]}".rstrip() for n, v in [*self.parameters.items()][:many])
        return f"<Identification: {first}; rank {self.rank} of {len(self.phi)}>"

    def __str__(self) -> str:
        width = max(map(len, self.names))
        valid = "95 % interval" if self.whiteness.is_white else "95 % if noise alone"
        header = f"{valid if self.is_noise else '95 %, not valid':^23}"
        lines = [f"{'':{width}} {'estimate':>10} {'std. error':>10}  {header}  unit"]
        rows = self.parameters.items(), self._errors, self.interval().values(), self.units.values()
        lines += [
            f"{name:{width}} {value:10.4g} {error:10.2g}  {low:10.4g} to {high:<9.4g}  {unit}".rstrip()
            for (name, value), error, (low, high), unit in zip(*rows, strict=True)
        ]
        return "\n".join([*lines, *self.notes])

    @property
    def notes(self) -> tuple[str, ...]:
        """Further findings, a sentence each."""
        low, high = (1e3 * each for each in self.delay_interval())
        rho = np.abs(self.whiteness.correlation).max()
        correlated = f"the residual is correlated ({rho:.2f} between successive samples)"
        bias = f"noise of the inputs biases output error by {self.input_noise_bias:.1f} standard deviations"
        found = [
            f"{self.samples} samples at {1 / self.dt:.4g} Hz, {self.dropped} dropped, {self.outliers} "
            f"outliers; {self.method}, {self.segments} segments of {self.seconds:g} s; rank {self.rank} of "
            f"{len(self.phi)}",
            f"{bias}: the weak form replaces it" if self.input_noise_bias and self.method == "weak" else "",
            f"delay of measurements {1e3 * self.delay:.3g} ms"
            + ("" if np.isnan(low) else f" (95 % interval {low:.3g} to {high:.3g})")
            + f": {self.delay / self.dt:.2f} samples",
            f"residual: {_residuals(*zip(*self.model.measured, strict=True), self.residual, self.noise)}",
            "the residual is white: noise of the sensors"
            if self.whiteness.is_white
            else f"{correlated} as noise of the inputs makes it: if it is that, the intervals are valid; "
            "they do not cover the error of a force that follows the motion and is not in the model, such as "
            "rolling resistance that depends on load"
            if self.is_noise
            else f"{correlated} otherwise or more than noise makes it: the structure of the model is wrong, "
            "and the intervals are not valid; is there slip, a clipped input, a limit of the firmware, a "
            "slope, or resistance that depends on load?",
            *(self.unseen, self.clipped, *self._negative, *self.model.notes(self)),
        ]
        return tuple(filter(None, found))

    @property
    def _negative(self) -> tuple[str, ...]:
        """Estimates below zero of parameters that cannot be, in words."""
        usual, far = self._deviations(0.95), self._deviations(_FAR)  # of eight, one exceeds 95 % by chance
        rows = zip(self.model.quantities, self.values, self._errors, strict=True)
        return tuple(
            f"{one.name} is {value:.3g} {one.unit}, below zero "
            + ("within" if value + far * error >= 0 else "(the model lacks a force) by more than")
            + f" its uncertainty, {usual * error:.3g}"
            for one, value, error in rows
            if one.bounded and value < 0 and np.isfinite(error)
        )

    @cached_property
    def plausible(self) -> Array:
        """The likeliest phi of a body whose friction brakes, shape (p,): phi itself where it is one.

        It is the nearest in the metric of the covariance. `robot` and `forces` use it; estimates and
        intervals stay as they are, because a projection would spoil the coverage of the intervals.

        Raises
        ------
        InvalidArgument
            If there is none, or none near the estimate.
        """
        body = self.model.plausible(self.phi, self.covariance_of_phi)
        found, there = self.values, self.model.to_physical(body)
        wide = self._deviations(_FAR) * np.sqrt(np.diag(self.covariance)) + 1e-9 * np.abs(found)
        for k in np.flatnonzero((np.abs(there - found) > wide)[:4]):
            one = self.model.quantities[k]
            raise InvalidArgument(
                f"log leads to a {one.name} of {found[k]:.4g} {one.unit}, but where friction brakes to "
                f"{there[k]:.4g}: {'; '.join(self._negative)}; expected a robot with all forces: is friction "
                "of its motors stated too high?"
            )
        return frozen(body)

    def robot(self) -> Any:
        """Return the identified robot, without the delay.

        Of a body, mass, centre of mass and inertia are `plausible`; numbers that a motion in the plane does
        not identify are those of the prior. An identified scale of volts is in the motors' torque constants.

        Raises
        ------
        InvalidArgument
            If there is no plausible body, or numbers of a robot with velocity inputs are not identifiable.
        """
        return self.model.robot(self)

    def forces(self) -> list[Any]:
        """Return the friction for `simulate`, none below zero, see `plausible`; theta includes its own."""
        return list(self.model.forces(self))

    def spread(self, n: int, seed: Any = 0) -> dict[str, Array]:
        """Return joint draws of the parameters for `ensemble`, by names such as ``"com.x"``.

        Friction is that of `forces`, which the loop needs.

        Parameters
        ----------
        n : int
            Number of draws.
        seed : int, SeedSequence, BitGenerator or Generator
            Seed of the draws.

        Returns
        -------
        spread : dict of str to ndarray, shape (n,)
            Draws of Student's t with the covariance: only those of a robot, with no friction below zero.

        Raises
        ------
        InvalidArgument
            If a parameter is not identifiable, or hardly a draw is of a robot.
        """
        n, generator = whole("n", n), seeded("seed", seed)
        check_identifiable("spread", self.unseen)
        values, vectors = np.linalg.eigh(self.covariance_of_phi)
        half, phi = vectors * np.sqrt(np.maximum(values, 0)), np.empty((0, len(self.phi)))
        for _ in range(_ROUNDS):
            normal = generator.standard_normal((n - len(phi), len(self.phi)))
            wide = np.sqrt(self.freedom / generator.chisquare(self.freedom, len(normal)))
            drawn = self.phi + wide[:, None] * (normal @ half.T)
            phi = np.vstack([phi, drawn[self.model.are_possible(drawn)]])
            if len(phi) == n:
                break
        else:
            raise InvalidArgument(
                "spread: the log leaves the parameters so uncertain that hardly a draw is of a robot, "
                "expected one that excites more"
            )
        return {
            one.path: np.maximum(x, 0.0) if one.bounded else x
            for one, x in zip(self.model.quantities, self.model.to_physical(phi).T, strict=True)
            if one.path
        }

    def predict(self, log: Log, seconds: float | None = None) -> Prediction:
        """Return the prediction of another log, beside the noise of its sensors.

        Segments start where they fit best, and are simulated from there.

        Parameters
        ----------
        log : Log
            Another log of the same robot, without a load, with the same measurements.
        seconds : float, optional
            Length of a segment [s]; default: as in the identification, or 2 s of a body.

        Raises
        ------
        InvalidArgument
            If it is too short, measures something else, or the prediction diverges from it.
        """
        instance("log", log, Log, "a Log")
        segments, residual, good, noise = self.model.predicted(self, log, seconds)
        names, units = zip(*self.model.measured, strict=True)
        measured, left = segments.y[..., : len(names)], residual[..., : len(names)]
        rms = np.sqrt((left[good] ** 2).mean(axis=0))
        return Prediction(names, units, segments.t, measured, measured - left, rms, noise)


def check_identifiable(what: str, unseen: str) -> None:
    """Refuse a method that needs all parameters where some are not identifiable."""
    if unseen:
        raise InvalidArgument(
            f"{what}() needs a log that identifies all: {unseen}; expected one that excites more, in which "
            "all velocities change independently"
        )
