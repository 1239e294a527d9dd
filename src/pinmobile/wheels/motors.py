"""Motors at wheels: what turns volts into torque, and what limits either."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np

from pinmobile.arrays import (
    Array,
    ArrayLike,
    broadcast,
    finite,
    in_numbers,
    non_negative,
    positive,
    positive_or_endless,
    scalar,
    text,
)
from pinmobile.constancy import constant
from pinmobile.errors import InvalidArgument, shown

_ELECTRIC = {"resistance": "ohm", "torque_constant": "N m/A", "voltage": "V"}


@final
@constant
@dataclass(frozen=True)
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

    torque_limit: float = np.inf
    resistance: float | None = None
    torque_constant: float | None = None
    voltage: float | None = None
    gear: float = 1.0
    efficiency: float = 1.0
    rotor_inertia: float = 0.0
    viscous: float = 0.0
    coulomb: float = 0.0
    current: float = np.inf
    source: str = ""

    def __post_init__(self) -> None:
        given = {name: getattr(self, name) for name in _ELECTRIC}
        lacking = ", ".join(name for name, value in given.items() if value is None)
        if lacking and any(value is not None for value in given.values()):
            raise InvalidArgument(
                f"{lacking} of a Motor is not given, expected resistance, torque_constant and voltage, "
                "or none of them: a source of torque"
            )
        new: dict[str, float] = {}
        for name, unit in _ELECTRIC.items():
            if given[name] is not None:
                new[name] = positive(f"{name} of a Motor", given[name], unit)
        new["gear"] = positive("gear of a Motor", self.gear)
        new["efficiency"] = positive("efficiency of a Motor", self.efficiency)
        if new["efficiency"] > 1:
            raise InvalidArgument(f"efficiency of a Motor is {new['efficiency']:g}, expected one in (0, 1]")
        for name, unit in (("rotor_inertia", "kg m^2"), ("viscous", "N m s/rad"), ("coulomb", "N m")):
            new[name] = non_negative(f"{name} of a Motor", getattr(self, name), unit)
        for name, unit in (("torque_limit", "N m"), ("current", "A")):
            new[name] = positive_or_endless(f"{name} of a Motor", getattr(self, name), unit)
        if not np.isfinite(new["gear"] * new["gear"] * max(new["rotor_inertia"], 1.0)):
            raise InvalidArgument(
                f"gear of a Motor is {new['gear']:g} with a rotor inertia of {new['rotor_inertia']:g} "
                "kg m^2, whose square times it is beyond 1.8e308: expected less"
            )
        for name, number in {**new, "source": text("source", self.source)}.items():
            object.__setattr__(self, name, number)

    def __repr__(self) -> str:
        own = {name: getattr(self, name) for name in type(self).__dataclass_fields__}
        plain = {name: field.default for name, field in type(self).__dataclass_fields__.items()}
        return f"Motor({', '.join(f'{name}={x!r}' for name, x in own.items() if x != plain[name])})"

    @property
    def is_electric(self) -> bool:
        """Whether it takes volts."""
        return self.resistance is not None

    @property
    def reflected_inertia(self) -> float:
        """What its rotor adds to the wheel's inertia about the axle [kg m^2]."""
        return self.gear**2 * self.rotor_inertia

    def _electric(self, what: str) -> tuple[float, float, float]:
        if self.resistance is None or self.torque_constant is None or self.voltage is None:
            raise InvalidArgument(
                f"{what} is asked of {shown(self)}, a source of torque, expected a Motor with resistance, "
                "torque_constant and voltage"
            )
        return self.resistance, self.torque_constant, self.voltage

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
        volts, rate = finite("volts", volts), finite("rate", rate)
        broadcast(volts=volts[..., None], rate=rate[..., None])
        R, k, most = self._electric("a current")
        i = (np.clip(volts, -most, most) - k * self.gear * rate) / R
        return np.asarray(np.clip(i, -self.current, self.current))

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
        volts, rate = finite("volts", volts), finite("rate", rate)
        _, k, _ = self._electric("a torque")
        shaft = k * self.armature_current(volts, rate) - self.viscous * self.gear * rate
        rest = np.clip(shaft, -self.coulomb, self.coulomb)
        shaft = shaft - np.where(rate == 0, rest, self.coulomb * np.sign(rate))
        return np.asarray(self._through_gear(shaft, rate))

    def _through_gear(self, shaft: Any, rate: Any) -> Any:
        """Return the torque behind the gear of one before it."""
        drives = np.asarray(shaft * rate >= 0)
        torque = self.gear * shaft * np.where(drives, self.efficiency, 1 / self.efficiency)
        return np.clip(torque, -self.torque_limit, self.torque_limit)

    def no_load_rate(self, volts: float | None = None) -> float:
        """Return the rate of the wheel that runs free at a voltage, by default the largest [rad/s]."""
        return max(float(self._free(self._volts("a rate", volts))), 0.0)

    @in_numbers
    def _free(self, volts: float) -> Array:
        R, k, _ = self._electric("a rate")
        held = np.asarray(self.gear * (k * k / R + self.viscous))
        return np.asarray((k * volts / R - self.coulomb) / held)

    def _volts(self, what: str, volts: float | None) -> float:
        _, _, most = self._electric(what)
        return most if volts is None else scalar("volts", volts)

    def stall_torque(self, volts: float | None = None) -> float:
        """Return the torque at the wheel that is held, at a voltage, by default the largest [N m]."""
        return float(self.torque(self._volts("a torque", volts), 0.0))
