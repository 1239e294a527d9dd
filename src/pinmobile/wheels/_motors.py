"""Motors at wheels: what turns volts into torque, and what limits either."""

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
    in_numbers,
    non_negative,
    positive,
    scalar,
    text,
)
from pinmobile.compiled import choose
from pinmobile.errors import InvalidArgument, shown
from pinmobile.parts import by_value, number as declared, option, part
from pinmobile.robot import ONE, ZERO, Vector, number, scalars
from pinmobile.wheels._contact import within

_ELECTRIC = "resistance", "torque_constant", "voltage"
CONSTANTS = "resistance", "torque_constant", "viscous", "coulomb", "efficiency"
"""Numbers of a motor that may differ from robot to robot."""


@final
@part
@by_value
class Motor:
    """A direct-current motor with its gear, or, without numbers, a source of torque.

    All numbers are the motor's own but for `torque_limit`, which is at the wheel.

    Parameters
    ----------
    torque_limit : float
        Largest torque at the wheel [N m]; infinite: none but what current and voltage allow.
    resistance : float, optional
        Of the armature [ohm]; without it, the motor is a source of torque alone.
    torque_constant : float, optional
        Torque per current [N m/A], which is the back-EMF per rate [V s/rad] too.
    voltage : float, optional
        Largest voltage, to either side [V].
    gear : float
        Turns of the motor per turn of the wheel.
    efficiency : float
        Of the gear, in (0, 1].
    rotor_inertia : float
        [kg m^2]; at the wheel it counts ``gear**2`` times.
    viscous : float
        Friction per rate of the motor [N m s/rad].
    coulomb : float
        Dry friction of the motor [N m].
    current : float
        Largest current, to either side [A].
    source : str
        Where the numbers come from.

    Raises
    ------
    InvalidArgument
        If a number is not finite or not in its range, or only some of resistance, torque constant and
        voltage are given.
    """

    torque_limit: float = declared(
        default=np.inf, unit="N m", above=0, endless=True, fixed=True, doc="largest torque at the wheel"
    )
    resistance: float | None = declared(
        default=None, unit="ohm", above=0, optional=True, doc="resistance of the armature"
    )
    torque_constant: float | None = declared(
        default=None, unit="N m/A", above=0, optional=True, doc="torque constant"
    )
    voltage: float | None = declared(
        default=None, unit="V", above=0, optional=True, fixed=True, doc="largest voltage"
    )
    gear: float = declared(default=1.0, above=0, fixed=True, doc="turns of the motor per turn of the wheel")
    efficiency: float = declared(default=1.0, above=0, upper=1, neutral=1, doc="efficiency of the gear")
    rotor_inertia: float = declared(
        default=0.0, unit="kg m^2", lower=0, fixed=True, doc="inertia of the rotor"
    )
    viscous: float = declared(default=0.0, unit="N m s/rad", lower=0, doc="friction per rate")
    coulomb: float = declared(default=0.0, unit="N m", lower=0, doc="dry friction")
    current: float = declared(
        default=np.inf, unit="A", above=0, endless=True, fixed=True, doc="largest current"
    )
    source: str = option(default="", check=text)

    def check(self) -> None:
        """Raise `InvalidArgument` where some numbers of an electric motor are missing, or too large."""
        given = {name: getattr(self, name) for name in _ELECTRIC}
        missing = ", ".join(name for name, value in given.items() if value is None)
        if missing and any(value is not None for value in given.values()):
            raise InvalidArgument(
                f"{missing} of a Motor is not given, expected resistance, torque_constant and voltage, "
                "or none of them: a source of torque"
            )
        if not np.isfinite(self.gear * self.gear * max(self.rotor_inertia, 1.0)):
            raise InvalidArgument(
                f"gear of a Motor is {self.gear:g} with a rotor inertia of {self.rotor_inertia:g} "
                "kg m^2, whose square times it is beyond 1.8e308: expected less"
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
        """Return the motor with gear of which a sheet tells how it runs free and how it stalls.

        R = V / i_s;  k G = (V - R i_0) / W_0;  T_c = k i_0;  efficiency = stall torque / (G k (i_s - i_0)).
        Without a current of the free run there is no dry friction, and the efficiency has all losses.

        Parameters
        ----------
        voltage : float
            At which all else is told [V].
        stall_torque, stall_current : float
            At the wheel [N m], of the motor [A].
        no_load_rate, no_load_current : float
            At the wheel [rad/s], of the motor [A].
        gear : float
            Turns of the motor per turn of the wheel.
        **others
            As of `Motor`.

        Raises
        ------
        InvalidArgument
            If a number is not finite or not in its range, or the gear would give more than it takes.
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
            raise InvalidArgument(
                f"stall_torque is {torque:g} N m, expected at most {torque / share:.4g} N m, which is what "
                "these currents and this rate give"
            )
        known = {"resistance": R, "torque_constant": k, "voltage": V, "coulomb": k * i_0, "efficiency": share}
        return cls(**{**known, "gear": G, **others})

    def __repr__(self) -> str:
        kind: Any = Motor
        given = ((f.name, getattr(self, f.name), f.default) for f in attrs.fields(kind))
        return f"Motor({', '.join(f'{name}={x!r}' for name, x, default in given if x != default)})"

    @property
    def is_electric(self) -> bool:
        """Whether it takes volts."""
        return self.resistance is not None

    @property
    def reflected_inertia(self) -> float:
        """What its rotor adds to the wheel's inertia about the axle [kg m^2]."""
        return self.gear**2 * self.rotor_inertia

    @cached_property
    def _law(self) -> MotorLaw:
        if not self.is_electric:
            words = "expected one with resistance, torque_constant and voltage"
            raise InvalidArgument(f"motor is {shown(self)}, a source of torque, {words}")
        return MotorLaw((self,), *([getattr(self, name)] for name in CONSTANTS))

    @in_numbers
    def armature_current(self, volts: ArrayLike, rate: ArrayLike) -> Array:
        """Return the current (V - k G W) / R within its limit, shape (...) [A].

        Parameters
        ----------
        volts : array_like, shape (...)
            Voltage [V]; beyond the largest it is the largest.
        rate : array_like, shape (...)
            Of the wheel [rad/s].

        Raises
        ------
        InvalidArgument
            If it is no electric motor, or an argument is not finite.
        """
        volts, rate = self._state(volts, rate)
        return np.asarray(self._law.current(0, self._law.volts(0, volts), rate))

    @in_numbers
    def torque(self, volts: ArrayLike, rate: ArrayLike) -> Array:
        """Return the torque at the wheel that turns at a rate, shape (...) [N m].

        eta^s G (k i - b G W - T_c sgn W), s = 1 where the motor drives the gear and -1 where it is driven;
        at rest dry friction takes what there is, up to T_c.

        Parameters
        ----------
        volts, rate
            As in `armature_current`.
        """
        volts, rate = self._state(volts, rate)
        return np.asarray(self._law.torque(0, self._law.volts(0, volts), rate))

    def _state(self, volts: ArrayLike, rate: ArrayLike) -> tuple[Array, Array]:
        volts, rate = finite("volts", volts), finite("rate", rate)
        broadcast(volts=volts[..., None], rate=rate[..., None])
        return volts, rate

    @in_numbers
    def _free(self, volts: float | None) -> Array:
        R, k = self._law._numbers[0][:2]
        held = self.gear * (k * k / R + self.viscous)
        return np.asarray((k * self._volts(volts) / R - self.coulomb) / held)

    def _volts(self, volts: float | None) -> float:
        return self._law.volts(0, np.inf) if volts is None else scalar("volts", volts)

    def no_load_rate(self, volts: float | None = None) -> float:
        """Return the rate of the wheel that runs free at a voltage, by default the largest [rad/s]."""
        return max(float(self._free(volts)), 0.0)

    def stall_torque(self, volts: float | None = None) -> float:
        """Return the torque at the wheel that is held, at a voltage, by default the largest [N m]."""
        return float(self.torque(self._volts(volts), 0.0))

    @property
    def largest_torque(self) -> float:
        """Largest torque at the wheel [N m]: that of stall, or `torque_limit` of a source of torque."""
        return self.stall_torque() if self.is_electric else self.torque_limit

    def margin(self, torque: Array, rate: Array) -> Array:
        """Return what is left of the torque that it has at a rate, shape (...) [N m]."""
        if self.voltage is None:
            return np.asarray(self.torque_limit - np.abs(torque))
        way = np.where(torque < 0, -1.0, 1.0)
        return np.asarray(self.torque(way * self.voltage, rate) * way - np.abs(torque))


class TorqueSpeedLine(NamedTuple):
    """What a motor does at the wheel near a rate W: the torque is torque - slope W - hold sgn W.

    At rest it is anything within hold of that.

    Attributes
    ----------
    torque : scalar
        [N m].
    slope : scalar
        [N m s/rad], >= 0.
    hold : scalar
        [N m], >= 0.
    """

    torque: Any
    slope: Any
    hold: Any


Motors = Callable[[Vector, Any], list[TorqueSpeedLine]]
ExternalForceFunction = Callable[[Any, Any, Any], Any]
"""Generalised forces beside the input, of t, q and v."""


def constant_force(f: Array) -> ExternalForceFunction:
    """Return what tells the same force at any time and state; an array without axes is none."""
    return lambda t, q, v: f if f.ndim else 0.0


def theta(z: Any) -> Any:
    """Return the weight of a step's end in the rate that a motor feels, where z = h slope / inertia.

    (3 + z) / (6 + z): half where it is not stiff, else towards 1. A motor alone then follows the exponential
    to third order and forgets at once what is faster than the step (the approximant (1, 2) of Pade).
    """
    return (3.0 + z) / (6.0 + z)


@dataclass(frozen=True, eq=False)
class MotorLaw:
    """The law of electric motors over scalars: numbers, arrays or symbols.

    Parameters
    ----------
    motors : sequence of Motor
        Each.
    resistance, torque_constant, viscous, coulomb, efficiency : ndarray, shape (..., motors)
        Their numbers, which may differ from robot to robot.
    """

    motors: Sequence[Motor]
    resistance: Any
    torque_constant: Any
    viscous: Any
    coulomb: Any
    efficiency: Any

    @cached_property
    def _numbers(self) -> list[list[Any]]:
        parts = self.resistance, self.torque_constant, self.viscous, self.coulomb, self.efficiency
        return [list(row) for row in zip(*map(scalars, parts), strict=True)]

    def volts(self, k: int, volts: Any) -> Any:
        """Return the voltage of a motor within its limit."""
        return within(number(volts), float(self.motors[k].voltage or 0.0))

    def current(self, k: int, volts: Any, rate: Any, *, clips: Any = True) -> Any:
        """Return the current of a motor at a voltage within its limit."""
        motor, (R, kt, *_) = self.motors[k], self._numbers[k]
        asked = (volts - (number(kt) * motor.gear) * rate) / number(R)
        if clips is False or not np.isfinite(motor.current):
            return asked
        return choose(clips, within(asked, motor.current), asked)

    def push(self, k: int, volts: Any, rate: Any, *, clips: Any = True) -> TorqueSpeedLine:
        """Return what a motor does near a rate.

        Parameters
        ----------
        k : int
            Which.
        volts : scalar
            Within the limit [V].
        rate : scalar
            Of the wheel [rad/s].
        clips : bool or symbol
            Whether the limit of the current is looked at.
        """
        motor, (R, kt, b, dry, share) = self.motors[k], self._numbers[k]
        R, kt, G = number(R), number(kt), motor.gear
        i = self.current(k, volts, rate, clips=clips)
        felt = kt * kt * G / R
        if clips is not False and np.isfinite(motor.current):
            asked = self.current(k, volts, rate, clips=False)
            felt = choose(clips, choose(abs(asked) <= motor.current, felt, 0.0), felt)
        fall = felt if b is ZERO else felt + number(b) * G  # of the shaft's torque, per rate of the wheel
        shaft = kt * i if b is ZERO else kt * i - (number(b) * G) * rate
        if dry is ZERO and share is ONE:
            return self._limited(motor, G * shaft, G * shaft, G * fall, ZERO, rate)
        eta, dry = number(share), number(dry)
        inverse = 1.0 / eta
        ahead, back = shaft - dry, shaft + dry
        by, by_back = choose(ahead > 0.0, eta, inverse), choose(back > 0.0, inverse, eta)
        resting = choose(rate > 0.0, by, choose(rate < 0.0, by_back, eta))
        return self._limited(motor, G * (by * ahead), G * (by_back * back), G * (resting * fall), ONE, rate)

    def _limited(
        self, motor: Motor, ahead: Any, back: Any, slope: Any, holds: Any, rate: Any
    ) -> TorqueSpeedLine:
        """Return what a motor does whose torques forwards and backwards are known, but for its limit."""
        most = motor.torque_limit
        if np.isfinite(most):
            now = choose(rate < 0.0, back, ahead)
            slope = choose(abs(now) <= most, slope, 0.0)
            ahead, back = within(ahead, most), within(back, most)
        if holds is ZERO:
            return TorqueSpeedLine(ahead + slope * rate, slope, ZERO)
        hold = 0.5 * (back - ahead)
        return TorqueSpeedLine(0.5 * (ahead + back) + slope * rate, slope, hold)

    def torque(self, k: int, volts: Any, rate: Any, *, clips: bool = True) -> Any:
        """Return the torque of a motor at a rate; at rest dry friction takes what there is."""
        push = self.push(k, volts, rate, clips=clips)
        torque = push.torque - push.slope * rate
        if push.hold is ZERO:
            return torque
        held = choose(rate > 0.0, push.hold, choose(rate < 0.0, -push.hold, within(torque, push.hold)))
        return torque - held

    def smooth_torque(self, k: int, volts: Any, rate: Any, sign: Any) -> Any:
        """Return the torque of a motor whose dry friction and loss of the gear go with a sign that is smooth.

        Parameters
        ----------
        k : int
            Which.
        volts, rate : scalar
            Within the limit [V], and of the wheel [rad/s].
        sign : scalar
            Of the rate, from -1 to 1.
        """
        motor, (_, kt, b, dry, share) = self.motors[k], [number(x) for x in self._numbers[k]]
        shaft = kt * self.current(k, volts, rate) - (b * motor.gear) * rate - dry * sign
        driving, driven = share + 1.0 / share, share - 1.0 / share
        torque = (0.5 * motor.gear) * (driving * shaft + driven * abs(shaft) * sign)
        return within(torque, motor.torque_limit) if np.isfinite(motor.torque_limit) else torque

    def slopes(self, k: int, volts: Any, rate: Any) -> tuple[Any, Any]:
        """Return by how much a motor's torque falls per rate of the wheel, and grows per volt.

        Limits of volts and currents are not looked at; where the torque is limited, both are 0.
        """
        motor, (R, kt, b, *_) = self.motors[k], [number(x) for x in self._numbers[k]]
        slope = self.push(k, volts, rate, clips=False).slope
        return slope, slope * kt / (motor.gear * (kt * kt + b * R))

    def needed(self, k: int, torque: Any, rate: Any, *, clips: bool = True) -> Any:
        """Return the voltage at which a motor gives a torque at a rate, within its limits.

        Dry friction is taken against the rate, of a wheel that stands against the torque.
        """
        motor, (R, kt, b, dry, share) = self.motors[k], [number(x) for x in self._numbers[k]]
        G = motor.gear
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
"""Real motors by name, numbers of their makers' sheets, which ``source`` names, and what these do not tell.

Of geared motors, resistance, torque constant and efficiency follow from stall and free run: see
`Motor.from_sheet`.
"""
