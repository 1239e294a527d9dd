"""`Identification`: what a log tells of a robot, and how well."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any, final

import numpy as np

from pinmobile import parts
from pinmobile.arrays import Array, bounded, frozen, instance, scalar, seeded, whole
from pinmobile.errors import InvalidArgument, shown
from pinmobile.forces import JointFriction, RollingResistance, ViscousFriction
from pinmobile.identification.chassis import Chassis
from pinmobile.identification.cleaning import Cleaned, Slippage
from pinmobile.identification.log import Log
from pinmobile.identification.output_error import OutputError, Segments
from pinmobile.identification.statistics import POSE, Prediction, Whiteness, student_deviations, student_draws
from pinmobile.parts import evolved
from pinmobile.robot import MobileRobot
from pinmobile.urdf import Body

_UNSEEN = 0.02  # share of a parameter's direction that may be unseen before its interval is endless
_MOST = 50_000_000  # draws
_FAR = 0.999  # interval in which a body must be that stands for what was found
_AHEAD = 2.0  # [s]
_DENSITIES = 20.0, 2e4  # [kg/m^2], mass per square of the radius of gyration; of boxes 12 m / (a^2 + b^2)


@final
@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Identification:
    """What `identify` found.

    Attributes
    ----------
    chassis : Chassis
        The robot, linear in what is identified.
    phi : ndarray, shape (p,)
        (m, m x, m y, I about the body's origin, friction), in which the equations are linear.
    covariance_of_phi : ndarray, shape (p, p)
        Of these.
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
        By which poses come later than inputs, and its deviation [s]; not a number where it was given. Where
        it was not, its uncertainty is in the covariance.
    other_delay : float
        What the log tells where a delay was given that is more than a sample and five deviations beside it
        [s]; else not a number.
    dt : float
        Time between two samples [s].
    outliers, dropped, samples, segments : int
        Poses that are outliers; rows with NaN; rows; segments that were simulated.
    slippage : Slippage or None
        How far poses are from rolling, of the log that is furthest; None where it cannot be told.
    noise : ndarray, shape (3,)
        Deviation of the noise of the pose, measured from the log [m, m, rad].
    residual : ndarray, shape (3,)
        Root of the mean squared residual of the pose [m, m, rad].
    chi2 : float
        Mean square of all residuals over the noise: 1 where the sensors' noise is all that is left.
    whiteness : Whiteness
        Correlation of the residuals.
    is_noise : bool
        Whether noise of sensors and inputs explains the residuals. Else the structure of the model is wrong,
        and intervals are not valid.
    clipped : str
        Inputs that stay at their extremes for long, in words; "" where none does.
    """

    chassis: Chassis
    phi: Array
    covariance_of_phi: Array
    freedom: int
    method: str
    pulled: float
    prior: Any
    rank: int
    unseen: str
    hidden: Array
    unknown: Array
    delay: float
    delay_error: float
    other_delay: float
    dt: float
    outliers: int
    dropped: int
    samples: int
    segments: int
    slippage: Slippage | None
    noise: Array
    residual: Array
    chi2: float
    whiteness: Whiteness
    is_noise: bool
    clipped: str

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(one.name for one in self.chassis.quantities)

    @property
    def parameters(self) -> Mapping[str, float]:
        """The estimates by name: mass, centre of mass, yaw inertia about it, friction; may be below zero."""
        told = self.chassis.told(self.phi)
        return MappingProxyType(dict(zip(self.names, told.tolist(), strict=True)))

    @property
    def units(self) -> Mapping[str, str]:
        """Units of the parameters by name."""
        return MappingProxyType({one.name: one.unit for one in self.chassis.quantities})

    @property
    def covariance(self) -> Array:
        """Covariance of `parameters`, in their order, shape (p, p); by the delta method.

        It has what is not known of unseen directions, in which the prior is kept.
        """
        D = self.chassis.slopes(self.phi)
        return np.asarray(D @ (self.covariance_of_phi + self.unknown @ self.unknown.T) @ D.T)

    @property
    def is_seen(self) -> Mapping[str, bool]:
        """Whether the motion tells a parameter, by name."""
        D = np.abs(self.chassis.slopes(self.phi)) > 0
        hidden = np.flatnonzero(self.hidden > _UNSEEN)
        return MappingProxyType({name: not D[k, hidden].any() for k, name in enumerate(self.names)})

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
        wide = self._deviations(level) * np.sqrt(np.diag(self.covariance))
        found: dict[str, tuple[float, float]] = {}
        for one, value, half in zip(self.chassis.quantities, self.parameters.values(), wide, strict=True):
            seen = self.is_seen[one.name]
            low, high = (value - half, value + half) if seen else (-np.inf, np.inf)
            found[one.name] = (max(low, 0.0), max(high, half)) if one.bounded else (low, high)
        return MappingProxyType({name: (float(low), float(high)) for name, (low, high) in found.items()})

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
        return student_deviations(level, self.freedom)

    def __repr__(self) -> str:
        first = ", ".join(f"{n} {v:.4g} {self.units[n]}" for n, v in list(self.parameters.items())[:4])
        return f"<Identification: {first}; rank {self.rank} of {len(self.phi)}>"

    def __str__(self) -> str:
        intervals, width = self.interval(), max(map(len, self.names))
        valid = "95 % interval" if self.whiteness.is_white else "95 % if noise alone"
        header = valid if self.is_noise else "95 %, not valid"
        lines = [f"{'':{width}} {'estimate':>10}  {header:^23}  unit"]
        for name, value in self.parameters.items():
            low, high = intervals[name]
            lines.append(
                f"{name:{width}} {value:10.4g}  {low:10.4g} to {high:<9.4g}  {self.units[name]}".rstrip()
            )
        return "\n".join([*lines, *self.notes])

    @property
    def notes(self) -> tuple[str, ...]:
        """What else there is to know, a sentence each."""
        found = [
            f"{self.samples} samples at {1 / self.dt:.4g} Hz, {self.dropped} dropped, {self.outliers} "
            f"outliers; {self.method}, {self.segments} segments; rank {self.rank} of {len(self.phi)}"
        ]
        if self.pulled and self.method == "weak":
            found.append(
                f"noise of the inputs would pull output error by {self.pulled:.1f} deviations: the weak form "
                "is taken in its place"
            )
        if self.unseen:
            found.append(self.unseen)
        low, high = (1e3 * each for each in self.delay_interval())
        late = "" if np.isnan(low) else f" (95 % interval {low:.3g} to {high:.3g})"
        found.append(f"poses come {1e3 * self.delay:.3g} ms late{late}: {self.delay / self.dt:.2f} samples")
        if np.isfinite(self.other_delay):
            found.append(
                f"the delay of {1e3 * self.delay:.3g} ms was given, but the log agrees with "
                f"{1e3 * self.other_delay:.1f} ms: with a wrong delay estimates and intervals are wrong"
            )
        noise, left = self.noise * 1e3, self.residual * 1e3
        found.append(
            f"noise of the pose {noise[0]:.3g} mm, {noise[1]:.3g} mm, {noise[2]:.3g} mrad; left by the model "
            f"{left[0]:.3g} mm, {left[1]:.3g} mm, {left[2]:.3g} mrad"
        )
        rho = np.abs(self.whiteness.correlation).max()
        found.append(
            "what is left is white: noise of the sensors"
            if self.whiteness.is_white
            else f"what is left is correlated ({rho:.2f} between successive samples) as noise of the inputs "
            "makes it: if it is that, the intervals hold; they do not cover the error of a force that "
            "follows the motion and is not in the model, such as rolling resistance that depends on load"
            if self.is_noise
            else f"what is left is correlated ({rho:.2f} between successive samples) otherwise or "
            "more than noise makes it: the structure of the model is wrong, and the intervals are not "
            "valid; is there slip, a clipped input, a slope, or resistance that depends on load?"
        )
        if self.clipped:
            found.append(self.clipped)
        if not self.chassis.offset:
            found.append("the motion does not tell constant offsets of inputs from friction: taken as zero")
        return (*found, *self._below_zero(), *self._of_size(), *self._of_wheels())

    def _of_size(self) -> tuple[str, ...]:
        """Return a question about a mass that robots of this size do not have, by its radius of gyration."""
        mass, _, _, inertia = self.chassis.told(self.phi)[:4].tolist()
        if not all(map(self.is_seen.get, ("mass", "yaw_inertia"))) or min(mass, inertia) <= 0:
            return ()
        density = mass**2 / inertia
        if _DENSITIES[0] < density < _DENSITIES[1]:
            return ()
        return (
            f"a mass of {mass:.3g} kg with a radius of gyration of {np.sqrt(inertia / mass):.2g} m is "
            f"implausible: robots have {_DENSITIES[0]:g} to {_DENSITIES[1]:g} kg per square metre of it; are "
            "inputs in N and N m, positions in m?",
        )

    def _below_zero(self) -> tuple[str, ...]:
        """Return what estimates are below zero of what cannot be, and why."""
        told, deviations = [], np.sqrt(np.diag(self.covariance))
        usual, far = self._deviations(0.95), self._deviations(_FAR)  # of eight, one is beyond 95 % by chance
        for one, value, sd in zip(self.chassis.quantities, self.parameters.values(), deviations, strict=True):
            if one.bounded and value < 0 and self.is_seen[one.name]:
                half = usual * sd
                why = (
                    f"within its uncertainty: the log tells that it is not above {half:.3g}"
                    if value + far * sd >= 0
                    else f"by more than its uncertainty, {half:.3g}: another force acts than the model has"
                )
                told.append(f"{one.name} is {value:.3g} {one.unit}, below zero {why}")
        return tuple(told)

    def _of_wheels(self) -> tuple[str, ...]:
        """Return what a log of wheels cannot tell."""
        if not self.chassis.wheels:
            return ()
        slips = (str(self.slippage),) if self.slippage is not None and self.slippage.matters else ()
        M = self.chassis.inertia
        told = [
            f"of mass and yaw inertia the wheels' own inertia cannot be told: {M[0, 0]:.3g} kg and "
            f"{M[-1, -1]:.3g} kg m^2 of it were taken as stated"
        ]
        if not self.chassis.scaled:
            told.append(
                "all of this hangs on the torque per input, which was taken as stated: a log with a known "
                "load tells it, identify([log, loaded], robot, loads=[None, load])"
            )
        if self.chassis.motors:
            told.append(
                "motors were taken as stated, with their friction and gears; friction is what these leave"
                if not self.chassis.scaled
                else "motors were taken as stated but for one scale of all their torque constants"
            )
        return (*slips, *told)

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
        body = self.chassis.plausible(self.phi, self.covariance_of_phi)
        found, there = self.chassis.told(self.phi), self.chassis.told(body)
        wide = self._deviations(_FAR) * np.sqrt(np.diag(self.covariance))
        for k in np.flatnonzero(np.abs(there - found)[:4] > wide[:4] + 1e-9 * np.abs(found[:4])):
            one = self.chassis.quantities[k]
            raise InvalidArgument(
                f"log leads to a {one.meaning} of {found[k]:.4g} {one.unit}, but where friction brakes to "
                f"{there[k]:.4g}: {'; '.join(self._below_zero()) or 'they do not go together'}; expected a "
                "robot with the forces that act, is friction of its motors stated too high?"
            )
        return frozen(body)

    def robot(self) -> Any:
        """Return the robot as identified; what a motion in the plane cannot tell stays as believed.

        Its mass, centre of mass and inertia are `plausible`: those found, or the likeliest that a body has.

        Raises
        ------
        InvalidArgument
            If what was found is of no body, nor near one.
        """
        m, x, y, inertia = self.chassis.told(self.plausible)[:4].tolist()
        if self.prior is None:
            return MobileRobot(m, inertia, com=(x, y))
        own = self.prior.robot if self.chassis.wheels else self.prior
        bare = own.lumped()
        new = bare.with_body(_body(bare.body, m, (x, y), inertia), f"{bare.source}; identified from a log")
        if not self.chassis.wheels:
            return new
        wheeled = getattr(self.prior, "wheeled", self.prior)
        made = evolved(wheeled, robot=new)
        if wheeled is self.prior:
            return made
        driven = made.by_voltage()
        if self.chassis.scaled:
            constants = zip(driven.motor_paths, self.torque_constants, strict=True)
            driven = parts.replace(driven, {f"{path}.torque_constant": k for path, k in constants})
        return driven

    @property
    def torque_constants(self) -> Array:
        """Torque constants of the motors, their resistances taken as stated, shape (motors,) [N m/A].

        Raises
        ------
        InvalidArgument
            If the log is of no motors, or its scale was not identified.
        """
        if not self.chassis.scaled or not self.chassis.motors:
            raise InvalidArgument(
                f"robot is {shown(self.prior)}, expected one by_voltage(), and loads that tell the scale"
            )
        nominal = np.array([each.torque_constant for each in self.chassis.motors])
        return np.asarray(nominal * self.plausible[-1])

    def forces(self) -> list[Any]:
        """Return the friction for `simulate`, none below zero: see `plausible`."""
        told = self.plausible[4:]
        count = len(self.chassis.A)
        viscous, dry = told[:count], told[count : 2 * count]
        if not self.chassis.wheels:
            return [ViscousFriction(viscous), RollingResistance(dry, self.chassis.speed)]
        names = [one.name for one in self.prior.coordinates]
        at = [names.index(name) for name in self.chassis.wheels]
        columns = np.zeros((2, len(names)))
        columns[0, at], columns[1, at] = viscous, dry
        return [JointFriction(columns[0], columns[1], self.chassis.speed, names)]

    def spread(self, n: int, seed: Any = 0) -> dict[str, Array]:
        """Return joint draws of the parameters for `ensemble`, as uncertain as the log left them.

        Names are those of a spread, such as ``"com.x"``; friction is that of `forces`, which the loop needs.

        Parameters
        ----------
        n : int
            How many.
        seed : int, SeedSequence, BitGenerator or Generator
            Of the draws.

        Returns
        -------
        spread : dict of str to ndarray, shape (n,)
            Draws of Student's t with the covariance; of no body they are drawn again, friction is not below
            zero.

        Raises
        ------
        InvalidArgument
            If something is unseen, or no draws are of a body.
        """
        count, generator = whole("n", n, most=_MOST), seeded("seed", seed)
        if self.unseen:
            raise InvalidArgument(
                f"the log leaves something unseen: {self.unseen}; expected one that tells all"
            )
        values, vectors = np.linalg.eigh(self.covariance_of_phi)
        half = vectors * np.sqrt(np.maximum(values, 0))

        def is_body(phi: Array) -> Any:
            m, mx, my, inertia = phi[:, :4].T
            return (m > 0) & (m * inertia > mx * mx + my * my)

        phi = student_draws(count, self.phi, half, self.freedom, generator, is_body)
        if len(phi) < count:
            raise InvalidArgument(
                "the log leaves mass and inertia so uncertain that hardly a draw is of a body"
            )
        told = self.chassis.told(phi)
        bounded = self.chassis.bounded
        told[:, bounded] = np.maximum(told[:, bounded], 0.0)
        quantities = self.chassis.quantities[: self.chassis.dry.stop]
        return {one.path: told[:, k] for k, one in enumerate(quantities)}

    def predict(self, log: Log, seconds: float = _AHEAD) -> Prediction:
        """Return how well the robot that was found foretells another log, beside the noise of its sensors.

        Segments start where they fit best, and are simulated from there.

        Parameters
        ----------
        log : Log
            Another log of the same robot, without a load.
        seconds : float
            How long a segment is [s].

        Raises
        ------
        InvalidArgument
            If it is none, or too short.
        """
        instance("log", log, Log, "a Log")
        run = Cleaned.of(log, self.chassis, np.zeros(4))
        late, longest = self.delay / run.dt, len(run.q) * run.dt - 2 * abs(self.delay) - 4 * run.dt
        ahead = bounded("seconds", scalar("seconds", seconds), least=10 * run.dt, most=longest, unit="s")
        segments = Segments.of(run, self.chassis, late, ahead)
        point, _, _ = OutputError([segments], self.chassis).started(self.phi, np.diag(self.phi + 1e-9))
        out = segments.simulated(self.chassis, point.starts[0][:, None], self.phi[None])[:, 0]
        predicted, measured = out[..., :3] * run.noise, segments.measured[..., :3] * run.noise
        left = (measured - predicted) * segments.good[..., None]
        rms = np.sqrt((left**2).sum(axis=(0, 1)) / segments.good.sum())
        t = np.asarray(segments.at * run.dt)
        names, units = zip(*POSE, strict=True)
        return Prediction(names, units, t, measured, predicted, rms, run.noise)


def _body(old: Body, mass: float, com: tuple[float, float], yaw_inertia: float) -> Body:
    """Return a body with another mass, centre of mass and yaw inertia; all else stays where it can."""
    centre = np.array([*com, old.com[2]])
    inertia = np.array(old.inertia)
    inertia[2, 2] = yaw_inertia
    try:
        return Body(mass, centre, inertia)
    except InvalidArgument:  # moments that break the triangle inequality: those of a body of the same form
        return Body(mass, centre, np.array(old.inertia) * (yaw_inertia / old.inertia[2, 2]))
