"""Motors at wheels: torque from voltage, with limits."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, final

import attrs
import numpy as np

from pinmobile.arrays import (
    Array,
    ArrayLike,
    broadcast,
    finite,
    finite_result,
    frozen,
    non_negative,
    positive,
    scalar,
    text,
)
from pinmobile.compiled import choose, scalar_max
from pinmobile.errors import InvalidArgument, format_value
from pinmobile.parts import by_value, is_symbolic, number as declared, option, part
from pinmobile.plant import LIMIT_TOLERANCE
from pinmobile.robot import ONE, ZERO, Vector, number, scalars
from pinmobile.wheels._contact import within

_ELECTRIC = "resistance", "torque_constant", "voltage"
# Parameters of a motor that may differ between robots.
CONSTANTS = "resistance", "torque_constant", "viscous", "coulomb", "efficiency", "gear"


@final
@part
@by_value
class Motor:
    """Direct-current motor with gear, or, without numbers, a torque source.

    All numbers are those of the motor, except for `torque_limit`, which applies at the wheel.

    Parameters
    ----------
    torque_limit : float
        Largest torque at the wheel, > 0 [N m]; infinite: limited only by current and voltage.
    resistance : float, optional
        Resistance of the armature, > 0 [ohm]; without it, the motor is a torque source.
    torque_constant : float, optional
        Torque per current, > 0 [N m/A], equal to back-EMF per rate [V s/rad].
    voltage : float, optional
        Largest voltage to either side, > 0 [V].
    gear : float
        Turns of the motor per turn of the wheel, > 0.
    efficiency : float
        Efficiency of the gear, in (0, 1].
    rotor_inertia : float
        Inertia of the rotor, >= 0 [kg m^2]; at the wheel it counts ``gear**2`` times.
    viscous : float
        Viscous friction per motor rate, >= 0 [N m s/rad].
    coulomb : float
        Dry friction of the motor, >= 0 [N m].
    current : float
        Largest current to either side, > 0 [A].
    rate_limit : float
        Largest rate of the wheel, > 0 [rad/s]. It limits no motion: events of a run state a faster wheel.
    source : str
        Origin of the numbers as text.

    Raises
    ------
    InvalidArgument
        If a number is not finite or not in its range, or only some of resistance, torque constant and voltage
        are given.

    See Also
    --------
    wheels.MOTORS : real motors
    WheelTable : wheels with motors
    WheeledRobot : its method `by_voltage`
    controllers.TorqueToVoltage : controller of such motors

    Examples
    --------
    >>> from pinmobile import Motor
    >>> motor = Motor(resistance=2, torque_constant=0.1, voltage=24,
    ...               gear=10)
    >>> print(f"{motor.stall_torque():.1f} N m at stall")
    12.0 N m at stall
    >>> print(f"{motor.no_load_rate():.1f} rad/s without load")
    24.0 rad/s without load
    """

    torque_limit: float = declared(
        default=np.inf, unit="N m", above=0, fixed=True, doc="largest torque at the wheel"
    )
    resistance: float | None = declared(default=None, unit="ohm", above=0, doc="resistance of the armature")
    torque_constant: float | None = declared(default=None, unit="N m/A", above=0, doc="torque constant")
    voltage: float | None = declared(default=None, unit="V", above=0, fixed=True, doc="largest voltage")
    gear: float = declared(default=1.0, above=0, doc="turns of the motor per turn of the wheel")
    efficiency: float = declared(default=1.0, above=0, upper=1, neutral=1, doc="efficiency of the gear")
    rotor_inertia: float = declared(
        default=0.0, unit="kg m^2", lower=0, fixed=True, doc="inertia of the rotor"
    )
    viscous: float = declared(default=0.0, unit="N m s/rad", lower=0, doc="viscous friction per motor rate")
    coulomb: float = declared(default=0.0, unit="N m", lower=0, doc="dry friction")
    current: float = declared(default=np.inf, unit="A", above=0, fixed=True, doc="largest current")
    rate_limit: float = declared(
        default=np.inf, unit="rad/s", above=0, fixed=True, doc="largest rate of the wheel"
    )
    source: str = option(default="", check=text)

    def check(self) -> None:
        """Raise `InvalidArgument` if numbers of an electric motor are missing."""
        given = {name: getattr(self, name) for name in _ELECTRIC}
        missing = ", ".join(name for name, value in given.items() if value is None)
        if missing and any(value is not None for value in given.values()):
            raise InvalidArgument(
                f"{missing} of a Motor is not given, expected all or none of {', '.join(_ELECTRIC)}"
            )

    @classmethod
    def from_sheet(
        cls,
        voltage: float,
        stall_torque: float,
        stall_current: float,
        no_load_rate: float,
        no_load_current: float = 0.0,
        *,
        gear: float = 1.0,
        **others: Any,
    ) -> Motor:
        """Return the motor with gear of a data sheet with stall and no-load values.

        R = V / i_s;  k G = (V - R i_0) / W_0;  T_c = k i_0;  efficiency = stall torque / (G k (i_s - i_0)).
        Without a no-load current there is no dry friction, and the efficiency contains all losses.

        Without a no-load current, torque, rate and voltage alone determine the torque with which the motor
        drives. If the sheet has no stall current, pass any current of at least
        ``stall_torque * no_load_rate / voltage``: `torque` and `margin` of a driving motor do
        not depend on it. Currents, and torques against the rate, do.

        Parameters
        ----------
        voltage : float
            Voltage of all other values [V].
        stall_torque, stall_current : float
            Torque at the wheel [N m] and current of the motor [A] at stall, at this voltage.
        no_load_rate, no_load_current : float
            Rate of the wheel [rad/s] and current of the motor [A] without load.
        gear : float
            Turns of the motor per turn of the wheel.
        **others
            Other parameters of `Motor`.

        Returns
        -------
        motor : Motor
            The motor.

        Raises
        ------
        InvalidArgument
            If a number is not finite or not in its range, or the stall current is too small for the stall
            torque, so the efficiency would exceed 1.

        Examples
        --------
        >>> from pinmobile import Motor
        >>> sheet = {"voltage": 12, "stall_torque": 0.6, "no_load_rate": 6}
        >>> for current in (0.3, 1.0):  # stall current [A]
        ...     motor = Motor.from_sheet(stall_current=current, **sheet)
        ...     print(f"{motor.torque(volts=12, rate=3):.2f} N m")
        0.30 N m
        0.30 N m
        """
        V, torque = positive("voltage", voltage, "V"), positive("stall_torque", stall_torque, "N m")
        i_s, G = positive("stall_current", stall_current, "A"), positive("gear", gear)
        W = positive("no_load_rate", no_load_rate, "rad/s")
        i_0 = non_negative("no_load_current", no_load_current, "A")
        R = V / i_s
        k = (V - R * i_0) / (G * W)
        given = G * k * (i_s - i_0)
        if not (0 < given < np.inf and 0 < k < np.inf):
            raise InvalidArgument(
                f"no_load_current is {i_0:g} A, expected less than stall_current, {i_s:g} A, and finite "
                f"numbers with {V:g} V, {W:g} rad/s and a gear of {G:g}"
            )
        share = torque / given
        if share > 1:
            bound = i_0 + (c := torque * W / V / 2) + (c * (c + 2 * i_0)) ** 0.5
            raise InvalidArgument(
                f"stall_current is {i_s:g} A, expected at least {bound:.4g} A for a stall_torque of "
                f"{torque:g} N m: check the units, or pass a larger stall_current"
            )
        data = {"resistance": R, "torque_constant": k, "voltage": V, "coulomb": k * i_0, "efficiency": share}
        return cls(**{**data, "gear": G, **others})

    def __repr__(self) -> str:
        kind: Any = Motor
        given = ((f.name, getattr(self, f.name), f.default) for f in attrs.fields(kind))
        return f"Motor({', '.join(f'{name}={x!r}' for name, x, default in given if x != default)})"

    @property
    def is_electric(self) -> bool:
        """Whether the motor takes volts."""
        return self.resistance is not None

    @property
    def reflected_inertia(self) -> float:
        """Inertia of the rotor at the wheel's axle [kg m^2]."""
        return self.gear**2 * self.rotor_inertia if self.rotor_inertia else 0.0

    @cached_property
    def _law(self) -> MotorLaw:
        """Equations of this motor."""
        if not self.is_electric:
            words = "expected a motor with resistance, torque_constant and voltage"
            raise InvalidArgument(f"motor is {format_value(self)}, a torque source, {words}")
        return MotorLaw.of((self,))

    @finite_result
    def armature_current(self, volts: ArrayLike, rate: ArrayLike) -> Array:
        """Return the current (V - k G W) / R within its limit, shape (...) [A].

        Parameters
        ----------
        volts : array_like, shape (...)
            Voltage [V], clipped to the largest voltage.
        rate : array_like, shape (...)
            Rate of the wheel [rad/s].

        Raises
        ------
        InvalidArgument
            If the motor is a torque source, or an argument is not finite.
        """
        return self._evaluate(MotorLaw.current, volts, rate)

    @finite_result
    def torque(self, volts: ArrayLike, rate: ArrayLike) -> Array:
        """Return the torque at the wheel, shape (...) [N m].

        eta^s G (k i - b G W - T_c sgn W), with s = 1 if the motor drives the gear and s = -1 if the wheel
        drives it. At rest, dry friction balances the torque up to T_c.

        Parameters
        ----------
        volts : array_like, shape (...)
            Voltage [V], clipped to the largest voltage.
        rate : array_like, shape (...)
            Rate of the wheel [rad/s].

        Raises
        ------
        InvalidArgument
            If the motor is a torque source, or an argument is not finite.
        """
        return self._evaluate(MotorLaw.torque, volts, rate)

    def _evaluate(self, law: Callable[..., Any], volts: ArrayLike, rate: ArrayLike) -> Array:
        """Return a function of `MotorLaw` at voltage and rate, after a check."""
        volts, rate = finite("volts", volts), finite("rate", rate)
        broadcast(volts=volts[..., None], rate=rate[..., None])
        return np.asarray(law(self._law, 0, self._law.volts(0, volts), rate))

    @finite_result
    def _free(self, volts: float | None) -> Array:
        """Return the no-load rate of the wheel, negative below the starting voltage [rad/s]."""
        return np.asarray(self._law.no_load_rate(0, self._volts(volts)))

    def _volts(self, volts: float | None) -> float:
        """Return a voltage, by default the largest [V]."""
        return self._law.volts(0, np.inf) if volts is None else scalar("volts", volts)

    def no_load_rate(self, volts: float | None = None) -> float:
        """Return the rate of the wheel without load [rad/s].

        Parameters
        ----------
        volts : float, optional
            Voltage [V]; default: the largest.
        """
        return max(float(self._free(volts)), 0.0)

    @property
    def largest_rate(self) -> Any:
        """Largest rate of the wheel [rad/s]: `rate_limit`, or less where it is slower without load."""
        if not self.is_electric:
            return self.rate_limit
        rate = scalar_max(self._law.no_load_rate(0, self._volts(None)), 0.0)
        return choose(rate < self.rate_limit, rate, self.rate_limit)

    def stall_torque(self, volts: float | None = None) -> float:
        """Return the torque at the wheel at rest [N m].

        Parameters
        ----------
        volts : float, optional
            Voltage [V]; default: the largest.
        """
        return float(self.torque(self._volts(volts), 0.0))

    @property
    def largest_torque(self) -> float:
        """Largest torque at the wheel [N m]: stall torque, or `torque_limit` of a torque source."""
        return self.stall_torque() if self.is_electric else self.torque_limit

    def margin(self, torque: Array, rate: Array) -> Array:
        """Return the remaining torque at a rate in the direction of the torque, shape (...) [N m].

        It is negative where the motor cannot provide the torque. Above the rate without load, a motor at its
        voltage brakes: a smaller braking torque is then out of reach, too.

        This is the torque at the largest voltage in the direction of `torque`, minus the magnitude of
        `torque`. It is negative if the motor cannot produce the torque at this rate. A torque against the
        rate has a larger margin, because the back-EMF helps. For the margins along a run, pass the torques
        ``run.u`` and the rates of the driven wheels, entries of ``run.v``.

        Parameters
        ----------
        torque : ndarray, shape (...)
            Torque at the wheel [N m].
        rate : ndarray, shape (...)
            Rate of the wheel [rad/s].

        Returns
        -------
        margin : ndarray, shape (...)
            Remaining torque; for a torque source, `torque_limit` minus the magnitude of `torque`.

        Examples
        --------
        >>> from pinmobile import Motor
        >>> motor = Motor.from_sheet(
        ...     voltage=12, stall_torque=0.6, stall_current=0.5,
        ...     no_load_rate=6)
        >>> motor.margin(torque=0.1, rate=3.0).round(2)  # [N m]
        np.float64(0.2)
        """
        if self.voltage is None:
            return np.asarray(self.torque_limit - np.abs(torque))
        way = np.where(torque < 0, -1.0, 1.0)
        left = self.torque(way * self.voltage, rate) * way - np.abs(torque)
        margin = np.abs(torque) - self.torque(-way * self.voltage, rate) * way
        return np.asarray(np.where(margin < 0, np.minimum(left, margin), left))

    @property
    def own_stall_torque(self) -> Any:
        """Stall torque of an electric motor at its voltage: a number, or a symbol in a spread [N m]."""
        return self._law.torque(0, self.voltage, 0.0)

    def lacks(self, torque: Any, rate: Any) -> Any:
        """Return whether an electric motor lacks a torque at a rate <= `largest_rate`: numbers or symbols."""
        way = choose(torque < 0.0, -1.0, 1.0)
        largest = way * self._law.torque(0, way * self.voltage, rate)
        is_weak = largest - abs(torque) < -LIMIT_TOLERANCE * self.own_stall_torque
        return choose(abs(rate) > self.largest_rate, False, is_weak)


class TorqueSpeedLine(NamedTuple):
    """Torque of a motor at the wheel near a rate W: torque - slope W - hold sgn W.

    At rest, the torque takes any value within `hold` of this line.

    Attributes
    ----------
    torque : scalar
        Torque of the line at rate zero [N m].
    slope : scalar
        Decrease of the torque per rate, >= 0 [N m s/rad].
    hold : scalar
        Dry friction, >= 0 [N m].
    """

    torque: Any
    slope: Any
    hold: Any


Motors = Callable[[Vector, Any], list[TorqueSpeedLine]]
ExternalForceFunction = Callable[[Any, Any, Any], Any]
"""External generalised force as a function of t, q and v."""


def constant_force(f: Array) -> ExternalForceFunction:
    """Return the function of a constant force; an array without axes means no force."""
    return lambda t, q, v: f if f.ndim else 0.0


def theta(z: Any) -> Any:
    """Return the weight of a step's end in the rate of a motor, where z = h slope / inertia.

    (3 + z) / (6 + z) is 1/2 for a motor that is not stiff, and tends to 1. A single motor then follows its
    exponential to third order, and damps modes faster than the step (the Pade approximant (1, 2)).
    """
    return (3.0 + z) / (6.0 + z)


def column(values: Sequence[Any]) -> Any:
    """Return numbers or symbols, such as one for each wheel, as an array, shape (k,)."""
    return np.stack(values) if any(map(is_symbolic, values)) else frozen(values)


@dataclass(frozen=True, eq=False)
class MotorLaw:
    """Equations of electric motors for scalars: numbers, arrays or symbols.

    Parameters
    ----------
    motors : sequence of Motor
        The motors.
    resistance, torque_constant, viscous, coulomb, efficiency, gear : ndarray, shape (..., motors)
        Their parameters, which may differ between robots.
    """

    motors: Sequence[Motor]
    resistance: Any
    torque_constant: Any
    viscous: Any
    coulomb: Any
    efficiency: Any
    gear: Any

    @classmethod
    def of(cls, motors: Sequence[Motor]) -> MotorLaw:
        """Return the equations of motors; a torque source has no constants, which are then zero."""
        rows = ([getattr(motor, name) for motor in motors] for name in CONSTANTS)
        return cls(motors, *(column([0.0 if x is None else x for x in row]) for row in rows))

    @cached_property
    def _numbers(self) -> list[list[Any]]:
        """Parameters of each motor, in the order of the fields."""
        parts = (getattr(self, name) for name in CONSTANTS)
        return [list(row) for row in zip(*map(scalars, parts), strict=True)]

    def volts(self, k: int, volts: Any) -> Any:
        """Return the voltage of a motor within its limit."""
        return within(number(volts), float(self.motors[k].voltage or 0.0))

    def current(self, k: int, volts: Any, rate: Any, *, clips: Any = True) -> Any:
        """Return the current of a motor at a voltage within its limit."""
        motor, (R, kt, *_, G) = self.motors[k], self._numbers[k]
        current = (volts - (number(kt) * number(G)) * rate) / number(R)
        if clips is False or not np.isfinite(motor.current):
            return current
        return choose(clips, within(current, motor.current), current)

    def push(self, k: int, volts: Any, rate: Any, *, clips: Any = True) -> TorqueSpeedLine:
        """Return the torque-speed line of a motor near a rate.

        Parameters
        ----------
        k : int
            Number of the motor.
        volts : scalar
            Voltage within the limit [V].
        rate : scalar
            Rate of the wheel [rad/s].
        clips : bool or symbol
            Whether the current limit applies.
        """
        motor, (R, kt, b, dry, share, G) = self.motors[k], self._numbers[k]
        R, kt, G = number(R), number(kt), number(G)
        i = self.current(k, volts, rate, clips=clips)
        emf = kt * kt * G / R
        if clips is not False and np.isfinite(motor.current):
            current = self.current(k, volts, rate, clips=False)
            emf = choose(clips, choose(abs(current) <= motor.current, emf, 0.0), emf)
        fall = emf if b is ZERO else emf + number(b) * G  # slope of the shaft's torque, per wheel rate
        shaft = kt * i if b is ZERO else kt * i - (number(b) * G) * rate
        if dry is ZERO and share is ONE:
            return self._clip_line(motor, G * shaft, G * shaft, G * fall, ZERO, rate)
        eta, dry = number(share), number(dry)
        inverse = 1.0 / eta
        drive, back = shaft - dry, shaft + dry
        gain, loss = choose(drive > 0.0, eta, inverse), choose(back > 0.0, inverse, eta)
        resting = choose(rate > 0.0, gain, choose(rate < 0.0, loss, eta))
        return self._clip_line(motor, G * (gain * drive), G * (loss * back), G * (resting * fall), ONE, rate)

    def _clip_line(
        self, motor: Motor, forward: Any, back: Any, slope: Any, holds: Any, rate: Any
    ) -> TorqueSpeedLine:
        """Return a motor's line within its torque limit, from its torques forwards and backwards."""
        limit = motor.torque_limit
        if np.isfinite(limit):
            torque = choose(rate < 0.0, back, forward)
            slope = choose(abs(torque) <= limit, slope, 0.0)
            forward, back = within(forward, limit), within(back, limit)
        if holds is ZERO:
            return TorqueSpeedLine(forward + slope * rate, slope, ZERO)
        hold = 0.5 * (back - forward)
        return TorqueSpeedLine(0.5 * (forward + back) + slope * rate, slope, hold)

    def torque(self, k: int, volts: Any, rate: Any, *, clips: bool = True) -> Any:
        """Return the torque of a motor at a rate; at rest, dry friction balances it as far as possible."""
        push = self.push(k, volts, rate, clips=clips)
        torque = push.torque - push.slope * rate
        if push.hold is ZERO:
            return torque
        friction = choose(rate > 0.0, push.hold, choose(rate < 0.0, -push.hold, within(torque, push.hold)))
        return torque - friction

    def smooth_torque(self, k: int, volts: Any, rate: Any, sign: Any) -> Any:
        """Return the torque of a motor with a smooth sign in dry friction and gear losses.

        Parameters
        ----------
        k : int
            Number of the motor.
        volts, rate : scalar
            Voltage within the limit [V], and rate of the wheel [rad/s].
        sign : scalar
            Sign of the rate, from -1 to 1.
        """
        motor, (_, kt, b, dry, share, G) = self.motors[k], [number(x) for x in self._numbers[k]]
        shaft = kt * self.current(k, volts, rate) - (b * G) * rate - dry * sign
        driving, braking = share + 1.0 / share, share - 1.0 / share
        torque = (0.5 * G) * (driving * shaft + braking * abs(shaft) * sign)
        return within(torque, motor.torque_limit) if np.isfinite(motor.torque_limit) else torque

    def no_load_rate(self, k: int, volts: Any) -> Any:
        """Return the rate of a wheel without load at a voltage, negative below the starting voltage."""
        R, kt, b, dry, _, G = (number(x) for x in self._numbers[k])
        return (kt * volts / R - dry) / (G * (kt * kt / R + b))

    def slopes(self, k: int, volts: Any, rate: Any) -> tuple[Any, Any]:
        """Return the decrease of a motor's torque per rate of the wheel, and its increase per volt.

        Limits of voltage and current are ignored; if the torque is limited, both are 0.
        """
        R, kt, b, *_, G = (number(x) for x in self._numbers[k])
        slope = self.push(k, volts, rate, clips=False).slope
        return slope, slope * kt / (G * (kt * kt + b * R))

    def required(self, k: int, torque: Any, rate: Any, *, clips: bool = True) -> Any:
        """Return the voltage at which a motor produces a torque at a rate, within its limits.

        Dry friction acts against the rate, or, at rest, against the torque.
        """
        motor, (R, kt, b, dry, share, G) = self.motors[k], [number(x) for x in self._numbers[k]]
        way = choose(rate > 0.0, 1.0, choose(rate < 0.0, -1.0, choose(torque < 0.0, -1.0, 1.0)))
        part = choose(torque * way >= 0.0, 1.0 / share, share)
        i = (torque * part / G + (b * G) * rate + dry * way) / kt
        if clips and np.isfinite(motor.current):
            i = within(i, motor.current)
        volts = R * i + (kt * G) * rate
        return within(volts, float(motor.voltage or 0.0)) if clips else volts


_SHEETS = tomllib.loads(Path(__file__).with_name("motors.toml").read_text("utf-8"))
MOTORS: Mapping[str, Motor] = MappingProxyType(
    {name: (Motor.from_sheet if "stall_torque" in own else Motor)(**own) for name, own in _SHEETS.items()}
)
"""Real motors by name, with numbers of the data sheets that ``source`` names, and estimates for the others.

Resistance, torque constant and efficiency of geared motors follow from stall and no-load values: see
`Motor.from_sheet`.
"""
