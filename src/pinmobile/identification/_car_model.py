"""`CarModel`: numbers of a `VelocityCar` that logs identify."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.identification._commands import CAR_COMMANDS, Part, Run, segments_of
from pinmobile.identification._estimates import Identification, check_identifiable
from pinmobile.identification._lag import Lag
from pinmobile.identification._simulation import Quantity, Segments, simulate
from pinmobile.identification._velocity_car import CarLaw, VelocityCar
from pinmobile.identification._velocity_model import Sized, VelocityModel
from pinmobile.identification._velocity_robot import rolling_of

_LONGEST, _GAINS = (0.03, 10.0), (1e-4, 1e4)  # ranges of the wheelbase [m], and of gains
_AT_SPEED = "understeer", "cornering_drag"
_STEERING = 4  # index of the wheelbase, or of the gain of the steering if the wheelbase is known


def _sized(name: str, unit: str, positive: bool, *sizes: float) -> Sized:
    return Sized(Quantity(name, unit, positive, name), *sizes)


@dataclass(frozen=True, eq=False)
class CarModel(VelocityModel):
    """Model of a car: time constants, gains, offset of the steering, wheelbase, understeer, further numbers.

    The gain of the steering is 1 unless `given` has the ``"wheelbase"``: curvatures are the ratio of both.
    """

    inputs: ClassVar[Mapping[str, str]] = CAR_COMMANDS
    neutral: ClassVar[Mapping[str, float]] = {
        "speed_gain": 1.0,
        "steering_offset": 0.0,
        "understeer": 0.0,
        "cornering_drag": 0.0,
    }
    steepest: ClassVar[tuple[Sized, Sized]] = (
        Sized(Quantity("acceleration", "m/s^2", False, "rate_limits.acceleration"), np.inf),
        Sized(Quantity("steering_rate", "rad/s", False, "rate_limits.steering_rate"), np.inf),
    )
    most: ClassVar[tuple[Sized, Sized]] = (
        Sized(Quantity("largest_speed_command", "m/s", False), np.inf),
        Sized(Quantity("largest_steering_command", "rad", False), np.inf),
    )

    @property
    def first(self) -> tuple[Sized, ...]:  # type: ignore[override]
        """First seven numbers."""
        steering = _sized("wheelbase", "m", True, 0.3)
        if "wheelbase" in self.given:
            steering = _sized("steering_gain", "", False, 1.0)
        return (
            _sized("speed_time_constant", "s", True, 0.3, np.nan, 1e-6),
            _sized("speed_gain", "", False, 1.0),
            _sized("steering_time_constant", "s", True, 0.1, np.nan, 1e-6),
            _sized("steering_offset", "rad", False, 0.0, 0.3, 0.03),
            steering,
            _sized("understeer", "rad s^2/m", False, 0.0, 0.02, 0.005),
            _sized("cornering_drag", "", False, 0.0, 1.0, 0.1),
        )

    @property
    def is_linear(self) -> bool:  # type: ignore[override]
        """Whether the measurements are linear functions of the states: a yaw rate is not."""
        return self.is_pose

    def time_constants(self, p: Array) -> Array:
        """Return the time constants of the speed, and of both poles of the steering, shape (..., 2) [s]."""
        return np.asarray(p[..., [0, 2]] * [1.0, 0.5])

    def resolved(self, segments: Segments, p: Array) -> tuple[Array, Array, float]:
        """Return the numbers of the rates, delays [samples] and the longest time step [s]."""
        numbers, late, longest = super().resolved(segments, p)
        more = np.stack(self._by_steering(p), axis=-1)
        return np.concatenate([numbers, more[:, None]], axis=-1), late, longest

    def rates(self, z: Any, u: Any, numbers: Any) -> Any:
        """Return the rates of speed, steering angle and steering rate, and of the pose if it is measured."""
        law, u = self._law(numbers), np.minimum(np.maximum(u, -numbers[10:12]), numbers[10:12])
        faster = np.stack(law.rates((z[0], z[1], z[2]), u))
        if not self.is_pose:
            return faster
        twist = np.stack([z[0], z[0] * law.curvature(z[0], z[1])])
        return np.concatenate([faster, rolling_of(numbers[7], z[3:], twist)])

    @staticmethod
    def _law(numbers: Any) -> CarLaw:
        time, gain, late, offset, _, understeer, drag, _, *most = (numbers[..., k] for k in range(10))
        return CarLaw(numbers[..., 13], time, late, gain, numbers[..., 12], offset, understeer, drag, *most)

    def observed(self, segments: Segments, states: Array, numbers: Array) -> Array:
        """Return the measurements: poses, or speed and yaw rate."""
        if self.is_pose:
            return states[..., 3:]
        speed, curvature = states[..., 0], self._law(numbers[:, :, None]).curvature
        return np.stack([speed, speed * curvature(speed, states[..., 1])], axis=-1)

    def started(self, parts: Sequence[Part], p: Array) -> list[Part]:
        """Return parts whose steering has followed the commands since the start of its log."""
        runs = {id(part.run): part.run for part in parts}
        turned = {key: self._turned(run, p) for key, run in runs.items()}
        return [part._replace(run=turned[id(part.run)]) for part in parts]

    def _turned(self, run: Run, p: Array) -> Run:
        count, free = len(run.u), _Steering(self.free, self.given, self.lead, self.dt, False)
        plain = run._replace(y=run.nu, calm=run.nu, seen=np.ones(count, bool))
        length = self.dt * (count - self.lead)
        segments, _ = segments_of([Part(plain, 0, count)], self.lead, length, filled=False)
        segments.start[:, 1] = self._by_steering(p)[0] * segments.applied(0, 1)[0, :, 0, 1] + p[3]
        states = simulate(free, segments, p[None], segments.start[None])[0, 0]
        states = np.concatenate([np.repeat(states[:1], count - len(states), axis=0), states])
        return run._replace(state=np.column_stack([run.state[:, 0], states[:, 1:]]))

    def _by_steering(self, p: Array) -> tuple[Any, Any]:
        """Return the gain of the steering and the wheelbase, of numbers (..., P)."""
        number, known = p[..., _STEERING], self.given.get("wheelbase")
        return (1.0 + 0.0 * number, number) if known is None else (number, known + 0.0 * number)

    def robot(self, found: Identification) -> Any:
        """Return the identified car; effects of its speed that are not identifiable are zero."""
        unseen = zip(self.first, found.hidden > 0, strict=False)
        if any(lost and one.quantity.name not in _AT_SPEED for one, lost in unseen):
            check_identifiable("robot", found.unseen)
        others = {name: float(x[0]) for name, x in self.others(found.phi[None]).items()}
        values = dict(zip(found.names, found.phi[: len(self.first)].tolist(), strict=False))
        top, turning, *most = (others[name] for name in self.limits())
        source = f"identified from {found.samples} samples in {found.segments} segments"
        known = {"wheelbase": self.given.get("wheelbase")} | values
        return VelocityCar(
            **known, ahead=others["ahead"], limits=most, rate_limits=(top, turning), source=source
        )

    def problems(self, found: Identification, neutral: Sequence[str]) -> list[str]:
        """Return no problems."""
        return []

    def lags(self, p: Array) -> list[Lag]:
        """Return the lags of speed and curvature."""
        gain, wheelbase = self._by_steering(p)
        speed, curvature = self.lags_of(p, (p[1], p[0]), (gain / wheelbase, p[2]), scale=1 / wheelbase)
        limit = np.tan(min(curvature.limit, np.pi / 2))
        return [speed, curvature._replace(offset=p[3] / wheelbase, limit=limit)]

    def start(self, lags: Sequence[Lag]) -> Array:
        """Return first estimates of the first numbers from the lags of speed and curvature.

        Raises
        ------
        InvalidArgument
            If the car turns to the other side than its commands, and the wheelbase is not known.
        """
        speed, curvature = lags
        known, gain = self.given.get("wheelbase"), curvature.gain or 1.0
        if known is None and gain < 0:
            raise InvalidArgument(
                "log has steering commands that turn the car to the other side, expected positive angles "
                "to the left: change their sign, or give wheelbase"
            )
        steering = 1 / gain if known is None else gain * known
        offset = curvature.offset * (1 / gain if known is None else known)
        return np.array([speed.tau, speed.gain or 1.0, curvature.tau, offset, steering, 0.0, 0.0])

    def limits_of(self, lags: Sequence[Lag]) -> dict[str, float]:
        """Return the limits that lags have, by name: those of curvature as angles."""
        speed, curvature = lags
        wheelbase = self.given.get("wheelbase", 1 / (curvature.gain or 1.0))
        turns = curvature._replace(
            steepest=curvature.steepest * abs(wheelbase), limit=np.arctan(curvature.limit)
        )
        if np.isinf(curvature.limit):
            turns = turns._replace(limit=np.inf)
        return super().limits_of([speed, turns])

    def check(self, p: Array, lost: NDArray[np.bool_]) -> None:
        """Reject numbers of wrong units.

        Raises
        ------
        InvalidArgument
            If a gain or the wheelbase is out of range.
        """
        named = self.first[_STEERING].quantity
        least, most = _GAINS if "wheelbase" in self.given else _LONGEST
        if not (lost[_STEERING] or least < abs(p[_STEERING]) < most):
            raise InvalidArgument(
                f"log leads to {named.name} = {p[_STEERING]:.3g}, expected {least:g} to {most:g}: "
                "are commands in m/s and rad, positions in metres and psi in radians?"
            )


class _Steering(CarModel):
    """The model that also returns steering angle and rate."""

    def observed(self, segments: Segments, states: Array, numbers: Array) -> Array:
        """Return the states."""
        return states
