"""`Log`: measurements of a robot that moved, and the columns of its file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any, NamedTuple, Self, final

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import (
    Array,
    ArrayLike,
    bounded,
    finite,
    frozen,
    increasing,
    instance,
    real,
    scalar,
    seeded,
    sequence,
    shaped,
    whole,
)
from pinmobile.errors import InvalidArgument, shown
from pinmobile.identification._files import read_bag, read_csv
from pinmobile.loop import Rollout
from pinmobile.plant import coordinates_of, inputs_of

_HOLE = 3  # rows in a row that may be lost, with their inputs
_BRIDGED = 0.3  # [s] of rows without a measurement, half a window of the weak form: over more it is a guess
_LONGEST_STEP = 5.0  # [s]; times of longer steps are no seconds
_FASTEST = 60.0  # [m/s]; positions that change faster are no metres
_HELD, _OFTEN = 1.0, 20  # [s] for which a pose may be that of a slower sensor, and how often it must be
_EVENLY = 0.9  # of these
_FASTEST_TURN = 12.0  # [rad/s], two turns a second; what turns faster is told in degrees
_WINDOW = 0.25  # [s] over which speeds are looked at, so that noise is none


def step(t: Array) -> float:
    """Return the time between two samples: the mean of the steps that lack none."""
    steps = np.diff(t)
    return float(steps[steps < 1.5 * np.median(steps)].mean())


def lost_rows(given: Mapping[str, Array]) -> NDArray[np.bool_]:
    """Return which rows have NaN in any part of a log."""
    lost = [np.isnan(x).any(axis=tuple(range(1, x.ndim))) for x in given.values()]
    return np.asarray(np.logical_or.reduce(lost))


def check_times(given: Mapping[str, Array], kept: NDArray[np.int_], lost: NDArray[np.bool_]) -> None:
    """Refuse times that do not increase, are of another unit, or lack too many rows in a row.

    Parameters
    ----------
    given : mapping of str to ndarray
        Parts of the log.
    kept : ndarray of int
        Rows whose time and input are known.
    lost : ndarray of bool, shape (N,)
        Rows that have NaN in any part.
    """
    t, there = given["t"], kept[~lost[kept]]
    if len(there) < 2:
        raise InvalidArgument(f"t has {len(there)} times without NaN in their rows, expected more")
    increasing("t", t[kept])
    usual = float(np.median(np.diff(t[kept])))
    if usual > _LONGEST_STEP:
        raise InvalidArgument(f"t has steps of {usual:g} s, expected seconds: are these milliseconds?")
    bridged = max(_HOLE, round(_BRIDGED / usual)), f"over more than {_BRIDGED} s what is bridged is a guess"
    for at, (most, why) in ((kept, (_HOLE, "what was applied meanwhile is not known")), (there, bridged)):
        worst = int(np.diff(t[at]).argmax())
        first, last = at[[worst, worst + 1]]
        if t[last] - t[first] > (most + 1.5) * usual:
            gone = {name: int(lost_rows({name: x[first + 1 : last]}).sum()) for name, x in given.items()}
            name = max(gone, key=lambda each: gone[each])
            what = f"{name} has {gone[name]} rows of NaN in a row" if gone[name] else "t has a gap"
            raise InvalidArgument(
                f"{what}, between {t[first]:g} and {t[last]:g} s, expected {most} rows at most: {why}; cut "
                "the log there, identify takes several"
            )


def check_pose(t: Array, q: Array) -> None:
    """Refuse poses of a slower sensor, which stand in several rows each, and those of other units."""
    dt, psi = step(t), q[:, 2]
    apart = max(1, round(_WINDOW / dt))
    if len(t) <= apart:
        return
    lasts = np.diff(np.flatnonzero((np.diff(q, axis=0) != 0).any(axis=1)))
    held = lasts[lasts * dt < _HELD]  # longer is a robot that stands
    usual = float(np.median(held)) if len(held) > _OFTEN else 1.0
    if usual > 1 and (np.abs(held - usual) <= 1).mean() > _EVENLY:
        raise InvalidArgument(
            f"q has each pose in {usual:g} rows, of {dt:.3g} s each, expected it once, and NaN in rows "
            "where none was measured, or Log.from_streams"
        )

    def rates(x: Array) -> Array:
        return np.abs(x[apart:] - x[:-apart]) / (t[apart:] - t[:-apart])

    speed, fast = np.median(np.hypot(rates(q[:, 0]), rates(q[:, 1]))), np.quantile(rates(psi), 0.9)
    if speed > _FASTEST:
        raise InvalidArgument(
            f"q moves at {speed:.3g} m/s most of the time, expected metres: are these centimetres or "
            "millimetres?"
        )
    whole = (steps := np.abs(np.diff(psi)))[steps > 1.9 * np.pi]
    turns = max(np.median(rates(np.unwrap(psi))), fast) > _FASTEST_TURN
    if np.median(whole) > 4 * np.pi if whole.size else turns:
        raise InvalidArgument(
            f"q has psi from {psi.min():.4g} to {psi.max():.4g}, which turns at {fast:.3g} rad/s and more, "
            "expected radians: are these degrees?"
        )


def held_integrals(t: Array, u: Array, edges: Array) -> Array:
    """Return the integrals between edges of values u each of which holds from its time on."""
    spent = np.vstack([np.zeros(u.shape[1]), np.cumsum(u[:-1] * np.diff(t)[:, None], axis=0)])
    k = np.clip(np.searchsorted(t, edges, side="right") - 1, 0, len(t) - 1)
    return np.asarray(np.diff(spent[k] + u[k] * (edges - t[k])[:, None], axis=0))


_POSE = 3  # x, y, psi


class Samples(NamedTuple):
    """A log on times of equal steps.

    Attributes
    ----------
    dt : float
        The step [s].
    t : ndarray, shape (N,)
        Times since the first sample [s].
    seen : ndarray of bool, shape (N,)
        Whether it was measured at that time; what stands elsewhere is interpolated.
    q, u, twist, wheel_rates : ndarray, shape (N, ...), or None
        As in `Log`.
    """

    dt: float
    t: Array
    seen: NDArray[np.bool_]
    q: Array | None
    u: Array
    twist: Array | None
    wheel_rates: Array | None


@final
@dataclass(frozen=True, eq=False, repr=False)
class Log:
    """What was measured of a robot at times that increase in equal steps, but for jitter and lost rows.

    Parameters
    ----------
    t : array_like, shape (N,)
        Times [s].
    q : array_like, shape (N, 3), or None
        Measured pose (x, y, psi) [m, m, rad]; None where only the twist was measured. psi may be unwrapped or
        on the circle. Of rows with NaN here, or in what else is measured, the inputs count; at most 0.3 s of
        them in a row are bridged.
    u : array_like, shape (N, nu)
        Input that is applied from each time to the next, in its unit: of a body that is pushed (Fx, Fy, Mz)
        in the inertial frame [N, N, N m], of wheels torques [N m], volts or, with a load that tells what they
        are worth, currents [A], of a robot that takes velocities its commands (forward, yaw rate)
        [m/s, rad/s]. At most three rows in a row may have NaN: then what was applied before is taken.
    twist : array_like, shape (N, 3) or (N, 2), optional
        Measured body twist: forward, left, yaw rate [m/s, m/s, rad/s]; of two columns forward and yaw rate.
    wheel_rates : array_like, shape (N, k), optional
        Rates that the encoders of the driven wheels tell, in the order of the inputs [rad/s]: those at the
        times. A difference of two angles is the rate half a step before the later one.

    units : tuple of str
        Units of the inputs, as a header says: "N", "N m", "V", "A", "m/s" or "rad/s", or "" where they are
        not known; () where none is. `identify` refuses those that its robot does not take.

    Attributes
    ----------
    dropped : int
        Rows that held a number which is none (NaN).
    dt : float
        Time between two samples [s].

    Raises
    ------
    InvalidArgument
        If a shape does not fit, times do not increase or have gaps, or numbers are in degrees, in millimetres
        or milliseconds: see the message.
    """

    t: Array
    q: Array | None
    u: Array
    twist: Array | None = None
    wheel_rates: Array | None = None
    dropped: int = 0
    units: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        given = self._given()
        t, twist = given["t"], given.get("twist")
        if twist is not None and twist.ndim == 2 and twist.shape[1] == 2:
            given["twist"] = np.insert(twist, 1, 0.0, axis=1)
        shaped("t", t, ("N>=2",))
        for name, array in given.items():
            if name != "t":
                width = _POSE if name in ("q", "twist") else "k>=1"
                shaped(name, array, (len(t), width), words=", a row for each time")
        if not {"q", "twist"} & set(given):
            raise InvalidArgument("q is None, and there is no twist, expected one of them: what was measured")
        for name in given:
            if lost_rows({name: given[name]}).all():
                raise InvalidArgument(f"{name} has {len(t)} rows, and NaN in each, expected rows without")
        lost = lost_rows(given)
        known = np.flatnonzero(~lost_rows({"t": t, "u": given["u"]}))
        there = np.flatnonzero(~lost)
        kept = known[(known >= there[0]) & (known <= there[-1])] if there.size else there
        check_times(given, kept, lost)
        object.__setattr__(self, "dropped", self.dropped + int(lost.sum()))
        given, seen = {name: array[kept] for name, array in given.items()}, ~lost[kept]
        for name, array in given.items():
            finite(name, np.where(np.isnan(array), 0.0, array))
        if "q" in given:
            q = given["q"] = np.array(given["q"])
            check_pose(given["t"][seen], q[seen])
            q[seen, 2] = np.unwrap(q[seen, 2])
            q[~seen] = np.nan
        for name, array in given.items():
            object.__setattr__(self, name, frozen(array))

    def _given(self) -> dict[str, Array]:
        named = {name: getattr(self, name) for name in ("t", "q", "u", "twist", "wheel_rates")}
        return {name: real(name, x) for name, x in named.items() if x is not None or name in ("t", "u")}

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        lost = f", {self.dropped} rows dropped" if self.dropped else ""
        kept = [n for n in ("q", "u", "twist", "wheel_rates") if getattr(self, n) is not None]
        measured = ", ".join(f"{n} of {getattr(self, n).shape[1]}" for n in kept)
        return f"<Log: {len(self)} samples over {self.t[-1] - self.t[0]:g} s, {measured}{lost}>"

    @property
    def dt(self) -> float:
        """Time between two samples [s]."""
        return step(self.t)

    def between(self, start: float, stop: float) -> Self:
        """Return what was measured from one time to before another, counted from the first sample [s].

        Raises
        ------
        InvalidArgument
            If fewer than two samples are left.
        """
        since = self.t - self.t[0]
        kept = (since >= scalar("start", start)) & (since < scalar("stop", stop))
        new = {name: array[kept] for name, array in self._given().items()}
        return replace(self, **new, dropped=0)

    def samples(self) -> Samples:
        """Return it on times of equal steps: what jitters is interpolated, what is lost is told."""
        dt, given = self.dt, self._given()
        t, u = given.pop("t") - self.t[0], given.pop("u")
        there = ~lost_rows(given)
        steps = np.rint(t / dt).astype(int)
        grid = dt * np.arange(steps[-1] + 1)
        seen = np.zeros(len(grid), bool)
        seen[steps[there]] = True
        u = u[np.searchsorted(steps, np.arange(len(grid)), side="right") - 1]
        even = seen.all() and np.abs(t - grid).max() < 1e-3 * dt  # then nothing is to be interpolated
        measured: dict[str, Array] = (
            given if even else {n: _interpolated(t[there], x[there], grid) for n, x in given.items()}
        )
        parts = (measured.get(name) for name in ("twist", "wheel_rates"))
        return Samples(dt, grid, seen, measured.get("q"), u, *parts)

    @classmethod
    def from_streams(
        cls,
        t_q: ArrayLike,
        q: ArrayLike | None,
        t_u: ArrayLike,
        u: ArrayLike,
        *,
        twist: ArrayLike | None = None,
        wheel_rates: ArrayLike | None = None,
    ) -> Self:
        """Return the log of poses and inputs that have times of their own, by one clock.

        An input holds until the next one; that of a sample is the mean of what holds until the next sample.

        Parameters
        ----------
        t_q, q : array_like, shape (N,), (N, 3)
            Times [s] and poses; None where only the twist was measured.
        t_u, u : array_like, shape (M,), (M, nu)
            Times [s] and inputs.
        twist, wheel_rates : array_like, shape (N, ...), optional
            Measured at the times of the poses.

        Raises
        ------
        InvalidArgument
            As of the class; and if the times overlap so little that they are of two clocks.
        """
        given: dict[str, Array] = {}
        poses: dict[str, Any] = {"q": q, "twist": twist, "wheel_rates": wheel_rates}
        u = real("u", u)
        times = {"t_q": finite("t_q", t_q), "t_u": finite("t_u", t_u)}
        for time, parts in (("t_q", poses), ("t_u", {"u": u})):
            increasing(time, times[time])
            words, found = f", as {time} has", {n: real(n, x) for n, x in parts.items() if x is not None}
            given |= {n: shaped(n, x, (len(times[time]), "k"), words=words) for n, x in found.items()}
        t, held = times.values()
        first, last = max(t[0], held[0]), min(t[-1], held[-1])
        if last - first < 0.5 * (t[-1] - t[0]):
            raise InvalidArgument(
                f"t_u is from {held[0]:.9g} to {held[-1]:.9g} s and t_q from {t[0]:.9g} to {t[-1]:.9g} s, "
                "which overlap by less than half: two clocks, expected one; subtract what one is ahead"
            )
        inputs, kept = given.pop("u"), (t >= first) & (t <= held[-1])
        edges = np.append(t[kept], t[kept][-1] + step(t[kept]))
        mean = held_integrals(held, np.nan_to_num(inputs), edges) / np.diff(edges)[:, None]
        gone = np.isnan(inputs).any(axis=1, keepdims=True)
        mean[held_integrals(held, gone.astype(float), edges)[:, 0] > 0] = np.nan
        return cls(t[kept], u=mean, **{"q": None} | {name: x[kept] for name, x in given.items()})

    @classmethod
    def from_rollout(
        cls,
        rollout: Rollout,
        noise: ArrayLike = 0.0,
        input_noise: ArrayLike = 0.0,
        *,
        delay: int = 0,
        seed: Any = 0,
    ) -> Self:
        """Return what sensors would have logged of a simulated run.

        Simulate with ``integrator=rk4``: the default step holds the acceleration, which no robot does.

        Parameters
        ----------
        rollout : Rollout
            The run; of wheels, the rates of those that an input is named after are logged too.
        noise : array_like, shape () or (3,)
            Standard deviation of the noise of the pose [m, m, rad].
        input_noise : array_like, shape () or (nu,)
            That of what is told of the input, in its unit.
        delay : int
            Samples by which the pose comes late.
        seed : int, SeedSequence, BitGenerator or Generator
            Of the noise.

        Raises
        ------
        InvalidArgument
            If it is no rollout of a plant that tells where its body is, or a noise is below zero or of
            another shape.
        """
        instance("rollout", rollout, Rollout, "a Rollout")
        late, plant = whole("delay", delay, least=0, most=len(rollout) - 2), rollout.plant
        generator, end = seeded("seed", seed), len(rollout) - late

        def noisy(name: str, deviation: ArrayLike, values: Array) -> Array:
            size = bounded(name, shaped(name, finite(name, deviation), (), values.shape[1:]), least=0)
            with np.errstate(over="ignore"):  # a log has finite numbers
                return values + size * generator.standard_normal(values.shape)

        q, u = noisy("noise", noise, rollout.poses[:end]), noisy("input_noise", input_noise, rollout.u[late:])
        names, inputs = [one.name for one in coordinates_of(plant)], inputs_of(plant)
        wheels = [names.index(one.name) for one in inputs if one.name in names]
        rates = rollout.v[:end, wheels] if wheels else None
        return cls(rollout.t[late:], q, u, None, rates, units=tuple(one.unit for one in inputs))

    @classmethod
    def from_csv(
        cls, path: str | PathLike[str], columns: Mapping[str, str | Sequence[str]] | None = None
    ) -> Self:
        """Return the log of a CSV file whose header names its columns, units in brackets.

        Without `columns`, time is ``t`` or ``time``, the pose ``x``, ``y`` and ``psi``, ``yaw`` or ``theta``
        or a quaternion ``qx``, ``qy``, ``qz``, ``qw``, the inputs all that begin with ``u_``, or ``Fx``,
        ``Fy``, ``Mz``; the twist those with ``twist_``, and the rates of wheels those with ``rate_``: what
        `Rollout.to_csv` writes is read so. Units such as ``[deg]``, ``[mm]`` and ``[ms]`` are turned into
        those of SI, and refused where a column is of another quantity; those of inputs are kept. Between
        cells are commas, semicolons (then numbers may have decimal commas), tabs or blanks; lines before the
        header that begin with # are left out; times may be dates as of ISO 8601.

        Parameters
        ----------
        path : str or path-like
            The file.
        columns : mapping of str to str or sequence of str, optional
            Names of columns for ``t``, ``q``, ``u``, ``twist`` and ``wheel_rates``, where they are called
            otherwise; six of ``q`` are x, y and a quaternion (x, y, z, w).

        Raises
        ------
        InvalidArgument
            If it cannot be read, or as of the class.
        UnknownName
            If a column is not there.
        """
        parts, units, short = read_csv(path, columns)
        times = parts.pop("t")[:, 0]
        return cls(times, parts.pop("q", None), parts.pop("u"), **parts, dropped=short, units=units)

    @classmethod
    def from_bag(cls, path: str | PathLike[str], topics: Mapping[str, str]) -> Self:
        """Return the log of a ROS 1 or ROS 2 bag, or of an MCAP file; ROS itself is not needed.

        Times are those of the messages' headers where they have any, otherwise of arrival.

        Parameters
        ----------
        path : str or path-like
            A file ``.bag`` or ``.mcap``, or the folder of a bag of ROS 2.
        topics : mapping of str to str
            Topics of ``q`` and ``u``, and optionally of ``twist`` and ``wheel_rates``: poses are odometry,
            poses and transforms; inputs are wrenches, twists (forward, yaw rate), efforts of joints and
            arrays of numbers.

        Raises
        ------
        InvalidArgument
            If rosbags is not installed, there is no such bag, a topic has messages of another type, or as
            of `from_streams`.
        FileError
            If the bag is damaged, as far as its structure and the CRCs of its chunks show.
        UnknownName
            If the bag has no such topic: the message lists those it has.
        """
        streams = read_bag(path, topics)
        (t_u, u), (t, _) = streams.pop("u"), streams["q" if "q" in streams else "twist"]
        rows = {
            name: _interpolated(*each, t) if each[0] is not t else each[1] for name, each in streams.items()
        }
        return cls.from_streams(t, rows.pop("q", None), t_u, u, **rows)


def logs_of(log: object) -> list[Log]:
    """Return one log, or several, as a list.

    Raises
    ------
    InvalidArgument
        If there is none, or something else.
    """
    made = "from_rollout" if isinstance(log, Rollout) else "from_csv"
    hint = f": Log.{made} makes one" if isinstance(log, str | PathLike | Rollout) else ""
    expected = f"a Log, or several{hint}"
    logs = [log] if isinstance(log, Log) else [*sequence("log", log, expected)]
    if not logs or not all(isinstance(each, Log) for each in logs):
        raise InvalidArgument(f"log is {shown(log)}, expected {expected}")
    return logs


_TAKEN_BY = {  # functions and arguments for inputs of a unit
    "N": "robot=None or a MobileRobot",
    "N m": "wheels without electric motors",
    "V": "wheels with electric motors",
    "A": "loads=[None, load], which identify the torque per ampere",
    **dict.fromkeys(("m/s", "rad/s"), "identify_velocity"),
}


def check_units(log: Log, name: str, expected: Mapping[str, str], also: str = "") -> None:
    """Refuse inputs whose unit is neither that of the robot's, by name, nor another that each may have."""
    for unit, (one, wanted) in zip(log.units, expected.items(), strict=False):
        if unit not in ("", wanted, also):
            why = f"such inputs take {_TAKEN_BY[unit]}" if unit in _TAKEN_BY else "are columns mixed up?"
            raise InvalidArgument(f"{name} has input {one} in {unit}, expected {wanted}: {why}")


def check_steps(steps: Sequence[float]) -> None:
    """Refuse logs whose samples are not equally far apart."""
    low, high = min(steps), max(steps)
    if high > 1.001 * low:
        raise InvalidArgument(f"log has samples every {low:g} and {high:g} s, expected equal steps")


def _interpolated(t: Array, columns: Array, grid: Array) -> Array:
    return np.column_stack([np.interp(grid, t, column) for column in columns.T])
