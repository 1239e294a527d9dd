"""`VelocityModel`: theta, delay and limits of a robot with velocity inputs, as numbers that logs identify."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, bounded, scalar
from pinmobile.identification._commands import BLOCK, CHANNELS, explained_parts, lead_of, runs_of, segments_of
from pinmobile.identification._estimates import Identification, check_identifiable
from pinmobile.identification._estimator import solve_robustly
from pinmobile.identification._lag import Lag
from pinmobile.identification._log import Log
from pinmobile.identification._planar_model import POSE
from pinmobile.identification._simulation import Quantity, Segments
from pinmobile.identification._velocity_robot import ABOVE_ZERO, THETA, VelocityRobot, rates_of, rolling_of

_EXPLAINED = 0.8  # explained share of the motion below which a note follows
_NEUTRAL = {"theta_3": 0.0, "theta_4": 1.0, "theta_5": 0.0, "theta_6": 1.0}  # without losses and offset
_QUICKEST = 0.1  # shortest time constant that a log shows, as a share of its time step
_FINE = 0.3  # longest time step of the integrator, as a share of the shortest time constant
_BENDS = 4  # factor on the number of steps where a limit of acceleration may end within a step
_MOST_STEPS = 40  # largest number of steps per sample
_SLOPE = 1e-6  # step of differences, as a share of the size of a number
STEEPEST = "acceleration", "yaw_acceleration"
MOST = "largest_speed_command", "largest_yaw_rate_command"
_OTHERS = {
    "delay": Quantity("delay", "s", True),
    "ahead": Quantity("ahead", "m", False, "ahead"),
    STEEPEST[0]: Quantity(STEEPEST[0], "m/s^2", False, f"accelerations.{STEEPEST[0]}"),
    STEEPEST[1]: Quantity(STEEPEST[1], "rad/s^2", False, f"accelerations.{STEEPEST[1]}"),
    MOST[0]: Quantity(MOST[0], "m/s", False),
    MOST[1]: Quantity(MOST[1], "rad/s", False),
}
_SIZES = {  # prior value, typical size (NaN: that of the number), smallest size
    **dict.fromkeys(("theta_1", "theta_2"), (0.3, np.nan, 1e-6)),
    **dict.fromkeys(("theta_4", "theta_6"), (1.0, np.nan, 1e-6)),
    **dict.fromkeys(("theta_3", "theta_5"), (0.0, 1.0, 0.1)),
    **{"delay": (0.0, 0.3, 0.1), "ahead": (0.0, 1.0, 0.1)},
    **{STEEPEST[0]: (1.0, np.nan, 1e-3), STEEPEST[1]: (3.0, np.nan, 1e-3)},
    **dict.fromkeys(MOST, (1.0, np.nan, 1e-3)),
}


@dataclass(frozen=True, eq=False)
class VelocityModel:
    """Model of a robot with velocity inputs: theta and further numbers.

    Parameters
    ----------
    free : tuple of str
        Further estimated numbers: ``"delay"``, ``"ahead"``, and limits of accelerations and commands.
    given : mapping of str to float
        Values of the numbers that are not estimated [s, m, m/s^2, rad/s^2, m/s, rad/s].
    lead : int
        Largest delay [samples].
    dt : float
        Time step [s].
    is_pose : bool
        Whether poses are measured; otherwise speed and yaw rate are.
    """

    free: tuple[str, ...]
    given: dict[str, float]
    lead: int
    dt: float
    is_pose: bool

    told_first: ClassVar[int] = 6
    columns: ClassVar[slice] = slice(None)

    @cached_property
    def quantities(self) -> tuple[Quantity, ...]:
        """Estimated numbers."""
        theta = [Quantity(n, unit, k in ABOVE_ZERO, f"theta.{n}") for k, (n, unit, _) in enumerate(THETA)]
        return (*theta, *(_OTHERS[name] for name in self.free))

    @cached_property
    def _sizes(self) -> Array:
        return np.asarray([_SIZES[one.name] for one in self.quantities]).T

    @property
    def measured(self) -> tuple[tuple[str, str], ...]:
        """Names and units of the measurements."""
        return POSE if self.is_pose else tuple(CHANNELS.items())

    def sizes(self, p: Array) -> Array:
        """Return the typical sizes of numbers near p, shape (P,)."""
        return np.asarray(np.maximum(np.abs(p), self._sizes[2]))

    def natural(self, p: Array) -> tuple[Array, Array]:
        """Return the typical sizes of numbers near p, and their prior values, shape (P,) each."""
        first, given, _ = self._sizes
        return np.where(np.isnan(given), np.abs(p), given), first

    def others(self, p: Array) -> dict[str, Array]:
        """Return delay, distance ahead of the axle and limits by name, shape (K,) each, for p (K, P)."""
        known = {name: np.full(len(p), value) for name, value in self.given.items()}
        return known | {name: p[:, 6 + k] for k, name in enumerate(self.free)}

    def is_possible(self, p: Array) -> bool:
        """Return whether the numbers p, shape (P,), are possible and the delay is within its range."""
        late, quickest = self.others(p[None])["delay"][0] / self.dt, (p[:2] / p[[3, 5]]).min()
        is_possible = np.isfinite(p).all() and self.are_possible(p) and quickest > _QUICKEST * self.dt
        return bool(is_possible and -1 < late <= self.lead)

    def are_possible(self, p: Array) -> Any:
        """Return which numbers, shape (..., P), a robot can have."""
        above = [k for k, one in enumerate(self.quantities) if k in ABOVE_ZERO or one.name in STEEPEST + MOST]
        return (p[..., above] > 0).all(axis=-1)

    def increments(self, p: Array) -> Array:
        """Return the steps of central differences, shape (P,)."""
        return _SLOPE * self.sizes(p)

    def resolved(self, segments: Segments, p: Array) -> tuple[Array, Array, float]:
        """Return the numbers of the rates, delays [samples] and the longest time step [s]."""
        others, theta = self.others(p), p[:, :6]
        numbers = np.column_stack([theta, others["ahead"], *(others[name] for name in STEEPEST + MOST)])[
            :, None
        ]
        bends = _BENDS if np.isfinite(numbers[..., 7:9]).any() else 1
        fastest = bends * (theta[:, [3, 5]] / theta[:, [0, 1]]).max()
        longest = self.dt / float(np.clip(self.dt * fastest / _FINE, 1, _MOST_STEPS))
        return numbers, others["delay"] / self.dt, longest

    def rates(self, z: Any, u: Any, numbers: Any) -> Any:
        """Return the rates of speed and yaw rate, and of x, y and psi if poses are measured."""
        given = np.minimum(np.maximum(u, -numbers[9:]), numbers[9:])
        faster = rates_of(numbers[:6], numbers[7:9], z[:2], given)
        return np.concatenate([faster, rolling_of(numbers[6], z[2:], z[:2])]) if self.is_pose else faster

    def observed(self, segments: Segments, states: Array) -> Array:
        """Return the measurements: poses, or speed and yaw rate."""
        return states[..., 2:] if self.is_pose else states

    def to_physical(self, p: Array) -> Array:
        """Return the numbers unchanged."""
        return p

    def slopes(self, p: Array) -> Array:
        """Return the identity: the derivatives of `to_physical`, shape (P, P)."""
        return np.eye(len(p))

    def plausible(self, p: Array, covariance: Array) -> Array:
        """Return the numbers unchanged."""
        return p

    def robot(self, found: Identification) -> VelocityRobot:
        """Return the identified robot; see `Identification.robot`."""
        check_identifiable("robot", found.unseen)
        others = {name: float(x[0]) for name, x in self.others(found.phi[None]).items()}
        source = f"identified from {found.samples} samples in {found.segments} segments"
        steepest, most = ([others[name] for name in names] for names in (STEEPEST, MOST))
        return VelocityRobot(found.theta, others["ahead"], most, steepest, source=source)

    def forces(self, found: Identification) -> list[Any]:
        """Return no forces: theta includes the losses."""
        return []

    def notes(self, found: Identification) -> list[str]:
        """Return notes on numbers that may be neutral, and on numbers that no robot can have."""
        bounds = found.interval()
        neutral = [n for n, x in _NEUTRAL.items() if bounds[n][0] <= x <= bounds[n][1]]
        told = [f"the interval of {n}{' - 1' * bool(_NEUTRAL[n])} contains zero" for n in neutral]
        if found.explained < _EXPLAINED:
            told.append(
                f"the model explains {found.explained:.0%} of a motion: do commands and motion come from one "
                "robot, with times of one clock?"
            )
        if not found.unseen:
            pairs = zip(found.names, found.theta.tolist(), strict=False)
            told += VelocityRobot([_NEUTRAL[n] if n in neutral else x for n, x in pairs]).problems
        return told

    def predicted(
        self, found: Identification, log: Log, seconds: float | None
    ) -> tuple[Segments, Array, NDArray[np.bool_], Array]:
        """Return segments of a log, residuals, mask of good samples, and the noise."""
        runs, length = runs_of([log], self.is_pose), scalar("seconds", BLOCK if seconds is None else seconds)
        bounded("seconds", length, least=3 * runs[0].dt, unit="s")
        lead = max(lead_of(runs), int(np.ceil(max(found.delay, 0.0) / runs[0].dt)) + 1)
        model = replace(self, dt=runs[0].dt, lead=lead)
        parts = explained_parts(runs, model.lags(found.phi), least=-np.inf)  # also of a poor model
        segments, calm = segments_of(parts, model.lead, length, filled=False)
        left, _ = solve_robustly(model, segments, found.phi, calm=calm)
        return segments, left.near.residual, left.good, found.noise

    def lags(self, p: Array) -> list[Lag]:
        """Return the lags of speed and yaw rate without coupling."""
        others = {name: float(x[0]) for name, x in self.others(p[None]).items()}
        late = max(0, round(others["delay"] / self.dt))
        pairs = zip((0, 1), (3, 5), MOST, STEEPEST, strict=True)
        return [Lag(1 / p[b], p[a] / p[b], late, others[most], others[top]) for a, b, most, top in pairs]
