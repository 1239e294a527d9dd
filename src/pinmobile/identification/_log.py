"""`Log`: measured poses and inputs of a robot, and the ways to read them."""

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
_BRIDGED = 0.3  # [s] without a measurement: half a window of the weak form; a longer gap needs a guess
_LONGEST_STEP = 5.0  # [s]; larger steps are probably not in seconds
_FASTEST = 60.0  # [m/s]; faster positions are probably not in metres
_HELD, _OFTEN = 1.0, 20  # longest repetition of a slow sensor's pose [s]; number that shows such a sensor
_EVENLY = 0.9  # share of repetitions of the same length
_FASTEST_TURN = 12.0  # [rad/s], two turns a second; faster headings are probably in degrees
_WINDOW = 0.25  # [s] over which speeds are averaged, so that noise does not matter


def step(t: Array) -> float:
    """Return the time step [s]: the mean of all steps without a lost row."""
    steps = np.diff(t)
    return float(steps[steps < 1.5 * np.median(steps)].mean())


def lost_rows(given: Mapping[str, Array]) -> NDArray[np.bool_]:
    """Return the rows that have NaN in any array of a log, as a mask."""
    lost = [np.isnan(x).any(axis=tuple(range(1, x.ndim))) for x in given.values()]
    return np.asarray(np.logical_or.reduce(lost))


def check_times(given: Mapping[str, Array], kept: NDArray[np.int_], lost: NDArray[np.bool_]) -> None:
    """Reject times that do not increase, have another unit, or have a long gap.

    Parameters
    ----------
    given : mapping of str to ndarray
        Arrays of the log by name.
    kept : ndarray of int
        Indices of the rows with a known time and input.
    lost : ndarray of bool, shape (N,)
        Mask of the rows that have NaN in any array.
    """
    t, there = given["t"], kept[~lost[kept]]
    if len(there) < 2:
        raise InvalidArgument(f"t has {len(there)} rows without NaN, expected two or more")
    increasing("t", t[kept])
    usual = float(np.median(np.diff(t[kept])))
    if usual > _LONGEST_STEP:
        raise InvalidArgument(f"t has steps of {usual:g} s, expected seconds: are these milliseconds?")
    bridged = max(_HOLE, round(_BRIDGED / usual)), f"interpolation is a guess over more than {_BRIDGED} s"
    for at, (most, why) in ((kept, (_HOLE, "the inputs in the gap are unknown")), (there, bridged)):
        worst = int(np.diff(t[at]).argmax())
        first, last = at[[worst, worst + 1]]
        if t[last] - t[first] > (most + 1.5) * usual:
            gone = {name: int(lost_rows({name: x[first + 1 : last]}).sum()) for name, x in given.items()}
            name = max(gone, key=lambda each: gone[each])
            what = f"{name} has {gone[name]} rows of NaN in a row" if gone[name] else "t has a gap"
            raise InvalidArgument(
                f"{what}, between {t[first]:g} and {t[last]:g} s, expected {most} rows at most: {why}; cut "
                "the log there and pass the parts to identify as a list"
            )


def check_pose(t: Array, q: Array) -> None:
    """Reject poses that a slow sensor repeats, and poses in other units."""
    dt, psi = step(t), q[:, 2]
    apart = max(1, round(_WINDOW / dt))
    if len(t) <= apart:
        return
    lasts = np.diff(np.flatnonzero((np.diff(q, axis=0) != 0).any(axis=1)))
    held = lasts[lasts * dt < _HELD]  # during a longer repetition the robot stands still
    usual = float(np.median(held)) if len(held) > _OFTEN else 1.0
    if usual > 1 and (np.abs(held - usual) <= 1).mean() > _EVENLY:
        raise InvalidArgument(
            f"q repeats each pose in {usual:g} rows of {dt:.3g} s, expected each pose once: write NaN in the "
            "other rows, or use Log.from_streams"
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
            f"q has psi from {psi.min():.4g} to {psi.max():.4g}, a yaw rate of {fast:.3g} rad/s and more, "
            "expected radians: are these degrees?"
        )


def held_integrals(t: Array, u: Array, edges: Array) -> Array:
    """Return the integrals of zero-order held inputs u between successive edges."""
    spent = np.vstack([np.zeros(u.shape[1]), np.cumsum(u[:-1] * np.diff(t)[:, None], axis=0)])
    k = np.clip(np.searchsorted(t, edges, side="right") - 1, 0, len(t) - 1)
    return np.asarray(np.diff(spent[k] + u[k] * (edges - t[k])[:, None], axis=0))


_POSE = 3  # x, y, psi


class Samples(NamedTuple):
    """Log with equal time steps.

    Attributes
    ----------
    dt : float
        Time step [s].
    t : ndarray, shape (N,)
        Times since the first sample [s].
    seen : ndarray of bool, shape (N,)
        Whether the row was measured; other rows are interpolated.
    q, u, twist, wheel_rates : ndarray, shape (N, ...), or None
        Arrays of `Log`.
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
    """Measured poses and inputs of a robot, for `identify` and `identify_velocity`.

    The times increase in equal steps; small jitter and lost rows are allowed.

    Parameters
    ----------
    t : array_like, shape (N,)
        Times [s].
    q : array_like, shape (N, 3), or None
        Measured pose (x, y, psi) [m, m, rad]; None if only the twist was measured. psi may be wrapped or
        unwrapped. A row may have NaN here or in the other measurements: its input still counts. Gaps of up
        to 0.3 s are interpolated.
    u : array_like, shape (N, nu)
        Input, constant from each time to the next. A body driven by forces has (Fx, Fy, Mz) in the inertial
        frame [N, N, N m]. Wheels have torques [N m], voltages [V] or currents [A]; currents need a known
        load, see `identify`. A robot with velocity inputs has (forward speed, yaw rate) [m/s, rad/s].
        At most three successive rows may have NaN; the last known input fills them.
    twist : array_like, shape (N, 3) or (N, 2), optional
        Measured body twist (forward, left, yaw rate) [m/s, m/s, rad/s], or (forward, yaw rate).
    wheel_rates : array_like, shape (N, k), optional
        Encoder rates of the driven wheels at the times, in the order of the inputs [rad/s]. The difference
        of two angles is the rate half a step before the later one.
    dropped : int
        Number of rows that a reader has already dropped.
    units : tuple of str
        Units of the inputs: "N", "N m", "V", "A", "m/s" or "rad/s", or "" if unknown; () if all are unknown.
        `identify` rejects units that do not fit its robot.

    Attributes
    ----------
    dropped : int
        Number of rows with NaN.
    dt : float
        Time step [s].

    Raises
    ------
    InvalidArgument
        If a shape is wrong, times do not increase or have gaps, or numbers seem to be in degrees, millimetres
        or milliseconds. The message gives the reason.

    See Also
    --------
    identify : estimate mass, inertia and friction from a log
    identify_velocity : estimate the parameters of a robot with velocity inputs
    excitation : motion for an informative log

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import Log
    >>> t = np.linspace(0, 10, 101)
    >>> q = np.column_stack([0.1 * t**2, 0 * t, 0 * t])
    >>> Log(t, q, u=np.tile([6.0, 0.0, 0.0], (101, 1)))
    <Log: 101 samples over 10 s, q of 3, u of 3>
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
            raise InvalidArgument("q and twist are None, expected at least one of them: the measured motion")
        for name in given:
            if lost_rows({name: given[name]}).all():
                raise InvalidArgument(f"{name} has {len(t)} rows, each with NaN, expected rows without NaN")
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
        """Time step [s]."""
        return step(self.t)

    def between(self, start: float, stop: float) -> Self:
        """Return the part of the log from `start` to before `stop`.

        Parameters
        ----------
        start, stop : float
            Times since the first sample [s].

        Raises
        ------
        InvalidArgument
            If the part has fewer than two samples.
        """
        since = self.t - self.t[0]
        kept = (since >= scalar("start", start)) & (since < scalar("stop", stop))
        new = {name: array[kept] for name, array in self._given().items()}
        return replace(self, **new, dropped=0)

    def samples(self) -> Samples:
        """Return the log at equal time steps, interpolated, with a mask of the measured rows."""
        dt, given = self.dt, self._given()
        t, u = given.pop("t") - self.t[0], given.pop("u")
        there = ~lost_rows(given)
        steps = np.rint(t / dt).astype(int)
        grid = dt * np.arange(steps[-1] + 1)
        seen = np.zeros(len(grid), bool)
        seen[steps[there]] = True
        u = u[np.searchsorted(steps, np.arange(len(grid)), side="right") - 1]
        even = seen.all() and np.abs(t - grid).max() < 1e-3 * dt  # no interpolation is needed
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
        """Return the log of poses and inputs with separate times of one clock.

        Each input is constant until the next one. The input of a sample is the mean over its time step.

        Parameters
        ----------
        t_q : array_like, shape (N,)
            Times of the poses [s].
        q : array_like, shape (N, 3), or None
            Poses [m, m, rad]; None if only the twist was measured.
        t_u : array_like, shape (M,)
            Times of the inputs [s].
        u : array_like, shape (M, nu)
            Inputs, see the class.
        twist, wheel_rates : array_like, shape (N, ...), optional
            Twist and encoder rates at the times of the poses, see the class.

        Raises
        ------
        InvalidArgument
            If the class rejects the data, or the times overlap by less than half, as those of two clocks.
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
                "which overlap by less than half, expected times of one clock: correct the offset of one"
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
        """Return a simulated log: the poses and inputs of a run with sensor noise.

        Simulate with ``integrator=rk4``. The default integrator of `MobileRobot` keeps the acceleration
        constant within a step, which a real robot does not.

        Parameters
        ----------
        rollout : Rollout
            Simulated run. The log also has the rates of the wheels that inputs drive.
        noise : array_like, shape () or (3,)
            Standard deviation of the pose noise [m, m, rad].
        input_noise : array_like, shape () or (nu,)
            Standard deviation of the input noise, in the units of the inputs.
        delay : int
            Delay of the poses relative to the inputs [samples].
        seed : int, SeedSequence, BitGenerator or Generator
            Seed of the noise.

        Raises
        ------
        InvalidArgument
            If `rollout` is not a `Rollout` or its plant has no pose, or a standard deviation is negative or
            has another shape.
        """
        instance("rollout", rollout, Rollout, "a Rollout")
        late, plant = whole("delay", delay, least=0, most=len(rollout) - 2), rollout.plant
        generator, end = seeded("seed", seed), len(rollout) - late

        def noisy(name: str, deviation: ArrayLike, values: Array) -> Array:
            size = bounded(name, shaped(name, finite(name, deviation), (), values.shape[1:]), least=0)
            with np.errstate(over="ignore"):  # the class rejects infinite numbers
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
        """Read a log from a CSV file. Its header names the columns, with units in brackets.

        The reader recognises these names, among others those that `Rollout.to_csv` writes:

        - time: ``t``, ``time``, ``stamp`` or ``timestamp``;
        - pose: ``x``, ``y`` and ``psi``, ``yaw``, ``theta`` or ``heading``, or a quaternion ``qx``, ``qy``,
          ``qz``, ``qw``;
        - inputs: names that begin with ``u_``, or ``Fx``, ``Fy``, ``Mz``;
        - twist: names that begin with ``twist_``;
        - wheel rates: names that begin with ``rate_``.

        Units such as ``[deg]``, ``[mm]`` and ``[ms]`` are converted to SI. Cells are separated by commas,
        semicolons, tabs or blanks. If the separator is not a comma, numbers may have decimal commas. Lines
        before the header that begin with ``#`` are skipped.

        Parameters
        ----------
        path : str or path-like
            File to read.
        columns : mapping of str to str or sequence of str, optional
            Names of the columns for ``t``, ``q``, ``u``, ``twist`` and ``wheel_rates``, where they differ
            from the above. Six columns of ``q`` are x, y and a quaternion (x, y, z, w).

        Raises
        ------
        InvalidArgument
            If the file cannot be read, a unit does not fit its column, or the class rejects the data.
        UnknownName
            If a column or a unit is unknown.
        """
        parts, units, short = read_csv(path, columns)
        times = parts.pop("t")[:, 0]
        return cls(times, parts.pop("q", None), parts.pop("u"), **parts, dropped=short, units=units)

    @classmethod
    def from_bag(cls, path: str | PathLike[str], topics: Mapping[str, str]) -> Self:
        """Read a log from a ROS 1 or ROS 2 bag, or from an MCAP file. ROS itself is not needed.

        The reader takes the times from the message headers. If messages have none, it takes the times of
        arrival.

        Parameters
        ----------
        path : str or path-like
            File ``.bag`` or ``.mcap``, or folder of a ROS 2 bag.
        topics : mapping of str to str
            Topics of ``u`` and of ``q`` or ``twist``, and optionally of ``wheel_rates``. Poses come from
            odometry, pose and transform messages. Inputs come from wrenches, twists (forward, yaw rate),
            joint efforts and arrays of numbers.

        Raises
        ------
        InvalidArgument
            If rosbags is not installed, the bag does not exist, a topic has messages of another type, or
            `from_streams` rejects the data.
        FileError
            If the bag is damaged. Damage shows in its structure and in the CRCs of its chunks.
        UnknownName
            If the bag has no such topic; the message lists its topics.
        """
        streams = read_bag(path, topics)
        (t_u, u), (t, _) = streams.pop("u"), streams["q" if "q" in streams else "twist"]
        rows = {
            name: _interpolated(*each, t) if each[0] is not t else each[1] for name, each in streams.items()
        }
        return cls.from_streams(t, rows.pop("q", None), t_u, u, **rows)


def logs_of(log: object) -> list[Log]:
    """Return one log, or several logs, as a list.

    Raises
    ------
    InvalidArgument
        If there is no log, or an entry is not a `Log`.
    """
    made = "from_rollout" if isinstance(log, Rollout) else "from_csv"
    hint = f": use Log.{made}" if isinstance(log, str | PathLike | Rollout) else ""
    expected = f"a Log or a sequence of Log{hint}"
    logs = [log] if isinstance(log, Log) else [*sequence("log", log, expected)]
    if not logs or not all(isinstance(each, Log) for each in logs):
        raise InvalidArgument(f"log is {shown(log)}, expected {expected}")
    return logs


_TAKEN_BY = {  # arguments or function for inputs of each unit
    "N": "robot=None or a MobileRobot",
    "N m": "wheels without electric motors",
    "V": "wheels with electric motors",
    "A": "loads=[None, load], which makes the torque per ampere identifiable",
    **dict.fromkeys(("m/s", "rad/s"), "identify_velocity"),
}


def check_units(log: Log, name: str, expected: Mapping[str, str], also: str = "") -> None:
    """Reject inputs in other units.

    Parameters
    ----------
    log : Log
        The log.
    name : str
        Name of the log, for the message.
    expected : mapping of str to str
        Unit of each input, by name.
    also : str
        Another unit that any input may have.
    """
    for unit, (one, wanted) in zip(log.units, expected.items(), strict=False):
        if unit not in ("", wanted, also):
            why = f"for {unit}, use {_TAKEN_BY[unit]}" if unit in _TAKEN_BY else "are columns mixed up?"
            raise InvalidArgument(f"{name} has input {one} in {unit}, expected {wanted}: {why}")


def check_steps(steps: Sequence[float]) -> None:
    """Reject logs with different time steps."""
    low, high = min(steps), max(steps)
    if high > 1.001 * low:
        raise InvalidArgument(f"log has samples every {low:g} and {high:g} s, expected equal steps")


def _interpolated(t: Array, columns: Array, grid: Array) -> Array:
    return np.column_stack([np.interp(grid, t, column) for column in columns.T])
