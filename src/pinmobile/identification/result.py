"""`Identification`: the estimates of a robot's parameters from its logs, and how uncertain they are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, affordable, frozen, instance, seeded, whole
from pinmobile.errors import InvalidArgument, shown
from pinmobile.identification.log import Log
from pinmobile.identification.preprocessing import Slippage
from pinmobile.identification.statistics import Prediction, Whiteness, student_deviations, student_draws

_UNSEEN = 0.02  # share of a parameter's direction that may be unseen before its interval is endless
_FAR = 0.999  # interval in which a body must be that stands for what was found


@final
@dataclass(frozen=True, eq=False, repr=False)
class Identification:
    """Estimates of a robot's parameters from its logs: what `identify` and `identify_velocity` return.

    Attributes
    ----------
    model : PlanarModel or VelocityModel
        The robot, whose numbers were estimated.
    phi : ndarray, shape (p,)
        These numbers: of a body (m, m x, m y, I about its origin, friction, ...), in which its equations are
        linear; of a robot that takes speeds theta, and what else was identified.
    covariance_of_phi : ndarray, shape (p, p)
        Of these, by the jackknife over segments.
    freedom : int
        Degrees of freedom of Student's t.
    method : str
        ``"output error"`` or ``"weak"``, which is taken too where inputs are noisy.
    pulled : float
        Deviations by which noise of the inputs would pull output error, if it was asked for; else 0.
    prior : MobileRobot, WheeledRobot or None
        What was believed; of wheels alone, a body on them of which nothing was.
    rank : int
        How many of the p directions the motion tells.
    unseen : str
        What it does not tell, in words; "" where it tells all.
    hidden : ndarray, shape (p,)
        Share of each parameter's direction that is unseen.
    unknown : ndarray, shape (p, d)
        By how much phi may be off for a prior that is off in each unseen direction: deviations.
    delay, delay_error : float
        By which measurements come later than inputs, and its deviation [s]; not a number where it was given.
        Where it was not, its uncertainty is in the covariance.
    other_delay : float
        What the log tells where a delay was given that is more than a sample and five deviations beside it
        [s]; else not a number.
    dt, seconds : float
        Time between two samples, and length of a segment [s].
    outliers, dropped, samples, segments : int
        Samples that are outliers; rows with NaN; rows; segments that were simulated.
    noise, residual : ndarray, shape (k,)
        Standard deviation of the noise of what was measured, and root mean square of what the model leaves;
        of speeds, or commands, noise is what is left.
    chi2 : float
        Mean square of all residuals over the noise: 1 where the sensors' noise is all that is left.
    whiteness : Whiteness
        Correlation of the residuals.
    is_noise : bool
        Whether noise of sensors and inputs explains the residuals. Else the structure of the model is wrong,
        and intervals are not valid.
    explained : float
        Share of the inputs that the motion explains, or of the motion that commands do.
    slippage : Slippage or None
        How far poses are from rolling, of the log that is furthest; None where it cannot be told.
    clipped : str
        Inputs that stay at their extremes for long, in words; "" where none does.
    """

    model: Any
    phi: Array
    covariance_of_phi: Array
    _: KW_ONLY
    freedom: int
    rank: int
    unseen: str
    hidden: Array
    unknown: Array
    delay: float
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
    pulled: float = 0.0
    prior: Any = None
    delay_error: float = np.nan
    other_delay: float = np.nan
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
        """Of a robot that takes speeds, its six numbers, shape (6,)."""
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
        """Covariance of `parameters`, in their order, shape (p, p); by the delta method.

        It has what is not known of unseen directions, in which the prior is kept.
        """
        D = self.model.slopes(self.phi)
        found = np.asarray(D @ (self.covariance_of_phi + self.unknown @ self.unknown.T) @ D.T)
        for k in np.flatnonzero(~self._seen & (np.diag(found) == 0)):
            found[k, k] = np.inf
        return found

    @property
    def standard_errors(self) -> Mapping[str, float]:
        """Of the parameters by name; infinite of what is unseen."""
        deviations = np.sqrt(np.diag(self.covariance))
        return self._named(np.where(self._seen, deviations, np.inf).tolist())

    @property
    def _seen(self) -> NDArray[np.bool_]:
        return np.asarray((self.model.slopes(self.phi)[:, self.hidden > _UNSEEN] == 0).all(axis=1))

    @property
    def is_seen(self) -> Mapping[str, bool]:
        """Whether the motion tells a parameter, by name."""
        return self._named(self._seen.tolist())

    def interval(self, level: float = 0.95) -> Mapping[str, tuple[float, float]]:
        """Return an interval of each parameter that holds the true one in a share of all logs, by name.

        It is Student's; endless where nothing is seen, and not valid where `is_noise` is false: it does not
        cover the error of a wrong structure. Of a parameter that cannot be below zero it is cut
        there, and goes up to its half width where the estimate is below: more is not told of what is small.

        Parameters
        ----------
        level : float
            The share, in (0, 1).

        Raises
        ------
        InvalidArgument
            If it is no such number.
        """
        half = self._deviations(level) * np.array([*self.standard_errors.values()])
        low, high = self.values - half, self.values + half
        bounded = np.array([one.bounded for one in self.model.quantities])
        low, high = (
            np.where(bounded, np.maximum(low, 0.0), low),
            np.where(bounded, np.maximum(high, half), high),
        )
        return self._named(zip(low.tolist(), high.tolist(), strict=True))

    def delay_interval(self, level: float = 0.95) -> tuple[float, float]:
        """Return an interval of the delay that holds the true one in a share of all logs [s].

        Parameters
        ----------
        level : float
            The share, in (0, 1).

        Returns
        -------
        low, high : float
            Not numbers where the delay was given, or the motion does not tell it.

        Raises
        ------
        InvalidArgument
            If the level is no such number.
        """
        half = self._deviations(level) * self.delay_error
        return self.delay - half, self.delay + half

    def _deviations(self, level: float) -> float:
        """Return how many standard deviations the interval of a level has to each side."""
        return student_deviations(level, self.freedom)

    def __repr__(self) -> str:
        units, many = self.units, self.model.told_first
        first = ", ".join(f"{n} {v:.4g} {units[n]}".rstrip() for n, v in [*self.parameters.items()][:many])
        return f"<Identification: {first}; rank {self.rank} of {len(self.phi)}>"

    def __str__(self) -> str:
        intervals, errors, width = self.interval(), self.standard_errors, max(map(len, self.names))
        valid = "95 % interval" if self.whiteness.is_white else "95 % if noise alone"
        header = f"{valid if self.is_noise else '95 %, not valid':^23}"
        lines = [f"{'':{width}} {'estimate':>10} {'std. error':>10}  {header}  unit"]
        for name, value in self.parameters.items():
            (low, high), error = intervals[name], errors[name]
            told = (
                f"{name:{width}} {value:10.4g} {error:10.2g}  {low:10.4g} to {high:<9.4g}  {self.units[name]}"
            )
            lines.append(told.rstrip())
        return "\n".join([*lines, *self.notes])

    @property
    def notes(self) -> tuple[str, ...]:
        """What else there is to know, a sentence each."""
        found = [
            f"{self.samples} samples at {1 / self.dt:.4g} Hz, {self.dropped} dropped, {self.outliers} "
            f"outliers; {self.method}, {self.segments} segments of {self.seconds:g} s; rank {self.rank} of "
            f"{len(self.phi)}"
        ]
        if self.pulled and self.method == "weak":
            found.append(
                f"noise of the inputs would pull output error by {self.pulled:.1f} deviations: the weak form "
                "is taken in its place"
            )
        low, high = (1e3 * each for each in self.delay_interval())
        late = "" if np.isnan(low) else f" (95 % interval {low:.3g} to {high:.3g})"
        found.append(
            f"measurements come {1e3 * self.delay:.3g} ms late{late}: {self.delay / self.dt:.2f} samples"
        )
        if np.isfinite(self.other_delay):
            found.append(
                f"the delay of {1e3 * self.delay:.3g} ms was given, but the log agrees with "
                f"{1e3 * self.other_delay:.1f} ms: with a wrong delay estimates and intervals are wrong"
            )
        each = zip(self.model.measured, 1e3 * self.noise, 1e3 * self.residual, strict=True)
        found.append(
            "left by the model: "
            + ", ".join(
                f"{name} {left:.3g} m{unit} (noise {noise:.3g})" for (name, unit), noise, left in each
            )
        )
        largest = np.abs(self.whiteness.correlation).max()
        rho = f"what is left is correlated ({largest:.2f} between successive samples)"
        found.append(
            "what is left is white: noise of the sensors"
            if self.whiteness.is_white
            else f"{rho} as noise of the inputs makes it: if it is that, the intervals hold; they do not "
            "cover the error of a force that follows the motion and is not in the model, such as rolling "
            "resistance that depends on load"
            if self.is_noise
            else f"{rho} otherwise or more than noise makes it: the structure of the model is wrong, and the "
            "intervals are not valid; is there slip, a clipped input, a limit of the firmware, a slope, or "
            "resistance that depends on load?"
        )
        said = filter(None, [self.unseen, self.clipped])
        return (*found, *said, *self.below_zero, *self.model.notes(self))

    @property
    def below_zero(self) -> tuple[str, ...]:
        """What estimates are below zero of what cannot be, and why."""
        told = []
        usual, far = self._deviations(0.95), self._deviations(_FAR)  # of eight, one is beyond 95 % by chance
        for one, value, sd in zip(
            self.model.quantities, self.values.tolist(), self.standard_errors.values(), strict=True
        ):
            if one.bounded and value < 0 and np.isfinite(sd):
                why = (
                    f"within its uncertainty: the log tells that it is not above {usual * sd:.3g}"
                    if value + far * sd >= 0
                    else f"by more than its uncertainty, {usual * sd:.3g}: the model lacks a force that acts"
                )
                told.append(f"{one.name} is {value:.3g} {one.unit}, below zero {why}")
        return tuple(told)

    @cached_property
    def plausible(self) -> Array:
        """The likeliest phi of a body whose friction brakes, shape (p,): phi itself where it is one.

        The nearest in the metric of the covariance, as `robot` and `forces` have it; estimates and intervals
        are not changed, as that would spoil what intervals hold.

        Raises
        ------
        InvalidArgument
            If there is none, or none near what was found.
        """
        body = self.model.plausible(self.phi, self.covariance_of_phi)
        found, there = self.values, self.model.to_physical(body)
        wide = self._deviations(_FAR) * np.sqrt(np.diag(self.covariance))
        for k in np.flatnonzero(np.abs(there - found)[:4] > wide[:4] + 1e-9 * np.abs(found[:4])):
            one = self.model.quantities[k]
            raise InvalidArgument(
                f"log leads to a {one.meaning} of {found[k]:.4g} {one.unit}, but where friction brakes to "
                f"{there[k]:.4g}: {'; '.join(self.below_zero) or 'they do not go together'}; expected a "
                "robot with the forces that act, is friction of its motors stated too high?"
            )
        return frozen(body)

    def robot(self) -> Any:
        """Return the robot as identified, without the delay.

        Of a body, mass, centre of mass and inertia are `plausible`: those found, or the likeliest that a body
        has; what a motion in the plane cannot tell stays as believed.

        Raises
        ------
        InvalidArgument
            If what was found is of no body, nor near one; or of a robot that takes speeds, if something is
            unseen.
        """
        return self.model.robot(self)

    @property
    def torque_constants(self) -> Array:
        """Torque constants of the motors, their resistances taken as stated, shape (motors,) [N m/A].

        Raises
        ------
        InvalidArgument
            If the log is of no motors, or its scale was not identified.
        """
        nominal = self.model.stated_constants
        if not len(nominal):
            raise InvalidArgument(
                f"robot is {shown(self.prior)}, expected one by_voltage(), and loads that tell the scale"
            )
        return np.asarray(nominal * self.plausible[-1])

    def forces(self) -> list[Any]:
        """Return the friction for `simulate`, none below zero, see `plausible`; theta has its own."""
        return list(self.model.forces(self))

    def spread(self, n: int, seed: Any = 0) -> dict[str, Array]:
        """Return joint draws of the parameters for `ensemble`, as uncertain as the log left them.

        Names are those of a spread, such as ``"com.x"`` or ``"theta.theta_1"``; friction is that of `forces`,
        which the loop needs.

        Parameters
        ----------
        n : int
            How many.
        seed : int, SeedSequence, BitGenerator or Generator
            Of the draws.

        Returns
        -------
        spread : dict of str to ndarray, shape (n,)
            Draws of Student's t with the covariance; of no robot they are drawn again, friction is not below
            zero.

        Raises
        ------
        InvalidArgument
            If something is unseen, or hardly a draw is of a robot.
        """
        n, generator = whole("n", n), seeded("seed", seed)
        affordable(f"spread: {n:,} draws", 4.0 * n * len(self.phi), "draw fewer at a time")
        check_seen("spread", self.unseen)
        values, vectors = np.linalg.eigh(self.covariance_of_phi)
        half = vectors * np.sqrt(np.maximum(values, 0))
        phi = student_draws(n, self.phi, half, self.freedom, generator, self.model.are_possible)
        if len(phi) < n:
            raise InvalidArgument(
                "spread: the log leaves the parameters so uncertain that hardly a draw is of a robot, "
                "expected one that tells more"
            )
        drawn = self.model.to_physical(phi)
        return {
            one.path: np.maximum(x, 0.0) if one.bounded else x
            for one, x in zip(self.model.quantities, drawn.T, strict=True)
            if one.path
        }

    def predict(self, log: Log, seconds: float | None = None) -> Prediction:
        """Return how well the robot that was found predicts another log, beside the noise of its sensors.

        Segments start where they fit best, and are simulated from there.

        Parameters
        ----------
        log : Log
            Another log of the same robot, without a load, with the same things measured.
        seconds : float, optional
            How long a segment is [s]; as in the identification, or 2 s of a body.

        Raises
        ------
        InvalidArgument
            If it is none, too short, measures something else, or what is predicted runs away from it.
        """
        instance("log", log, Log, "a Log")
        segments, residual, good, noise = self.model.predicted(self, log, seconds)
        names, units = zip(*self.model.measured, strict=True)
        measured, left = segments.y[..., : len(names)], residual[..., : len(names)]
        rms = np.sqrt((left[good] ** 2).mean(axis=0))
        return Prediction(names, units, segments.t, measured, measured - left, rms, noise)


def check_seen(what: str, unseen: str) -> None:
    """Refuse a method that needs all parameters where something is unseen."""
    if unseen:
        raise InvalidArgument(
            f"{what}() needs a log that tells all: {unseen}; expected one that excites more, in which all "
            "velocities change independently"
        )
