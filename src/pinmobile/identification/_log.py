"""`Log`: measured poses and inputs of a robot, and the ways to read them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any, NamedTuple, Self, final

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import (
    Array,
    ArrayLike,
    bounded,
    check_integer,
    finite,
    frozen,
    increasing,
    instance,
    positive,
    real,
    scalar,
    seeded,
    sequence,
    shaped,
)
from pinmobile.errors import InvalidArgument, format_names
from pinmobile.identification._files import clock_of, read_bag, read_csv, si_spelling
from pinmobile.identification._filters import LEAST_ROWS
from pinmobile.loop import Rollout
from pinmobile.plant import coordinates_of, inputs_of

_HOLE = 3  # rows in a row that may be lost at any time step
_BRIDGE = 0.3  # [s] without a measurement: half a window of the weak form; a longer gap needs a guess
_ONE_PHASE = 0.8  # smallest length of the mean of unit vectors at the phases of changes that have one phase
_NO_PHASE = 1e-3  # smaller phases count as zero [time steps]
_FINER = 10  # largest number of rows for a measurement where inputs are faster
_REPEATS = 0.1  # largest share of rows with the time of the row before
_SHORTEST = 2.0  # [s] of a part between gaps
_LONGEST_STEP = 5.0  # [s]; larger steps are probably not in seconds
_FASTEST = 60.0  # [m/s]; faster positions are probably not in metres
_HELD, _OFTEN = 1.0, 20  # longest repetition of a slow sensor's pose [s]; number that shows such a sensor
_EVEN_SHARE = 0.9  # share of repetitions of the same length
_FASTEST_TURN = 12.0  # [rad/s], two turns a second; faster headings are probably in degrees
_JITTER_ROWS, _JITTER_ROUNDS = 25, 3  # rows over which the jitter of times is averaged; refinements
_WINDOW = 0.25  # [s] over which speeds are averaged, so that noise does not matter


def step(t: Array) -> float:
    """Return the time step [s]: the mean of all steps without a lost row."""
    steps = np.diff(t)
    return float(steps[steps < 1.5 * np.median(steps)].mean())


def _mean_step(t: Array) -> float:
    """Return the time step [s], also where jitter makes some steps as long as if a row was lost."""
    from scipy.ndimage import uniform_filter1d  # slow to load

    dt = step(t)
    for _ in range(_JITTER_ROUNDS):
        turns = (t - t[0]) / dt
        if (np.diff(np.rint(turns)) > 0).all():
            break
        mean = uniform_filter1d(np.exp(2j * np.pi * turns), _JITTER_ROWS)
        numbers = np.rint(turns - np.unwrap(np.angle(mean)) / (2 * np.pi))
        dt = float(np.polyfit(numbers, t, 1)[0])
    return dt


def lost_rows(given: Mapping[str, Array]) -> NDArray[np.bool_]:
    """Return the rows that have NaN in any array of a log, as a mask."""
    masks = [np.isnan(x).any(axis=tuple(range(1, x.ndim))) for x in given.values()]
    return np.asarray(np.logical_or.reduce(masks))


def repeat_mask(t: Array, x: Array, slack: int) -> NDArray[np.bool_]:
    """Return the rows in which a slow sensor only repeats its last measurement, as a mask.

    A sensor is slow if nearly all of its values stay for the same number of rows, apart from standstill. The
    numbers may differ by `slack` and a quarter.
    """
    if len(x) <= _OFTEN:
        return np.zeros(len(x), bool)
    starts = np.flatnonzero((np.diff(x, axis=0, prepend=np.nan) != 0).any(axis=1))
    lasts, dt = np.diff(starts), step(t)
    lengths = lasts[lasts * dt < _HELD]
    usual = round(float(np.median(lengths))) if len(lengths) > _OFTEN else 1
    if usual == 1 or (np.abs(lengths - usual) <= max(slack, usual // 4)).mean() <= _EVEN_SHARE:
        return np.zeros(len(x), bool)
    ages = np.arange(len(x)) - starts[np.searchsorted(starts, np.arange(len(x)), side="right") - 1]
    last = np.repeat(np.append(lasts, usual), np.append(lasts, len(x) - starts[-1]))
    return np.asarray((ages % usual > 0) | ((ages > 0) & (last <= usual + 1)))


def check_pose(t: Array, q: Array) -> None:
    """Reject poses in other units."""
    dt, psi = step(t), q[:, 2]
    width = max(1, round(_WINDOW / dt))
    if len(t) <= width:
        return

    times = t[width:] - t[:-width]
    gapless = times < 2 * width * dt  # without a gap
    if not gapless.any():
        return

    def rates(x: Array) -> Array:
        return np.asarray(np.abs(x[width:] - x[:-width])[gapless] / times[gapless])

    speed, fast = np.median(np.hypot(rates(q[:, 0]), rates(q[:, 1]))), np.quantile(rates(psi), 0.9)
    if speed > _FASTEST:
        fault = f"q moves at {speed:.3g} m/s most of the time"
        raise InvalidArgument(f"{fault}, expected metres: are these centimetres or millimetres?")
    steps = np.abs(np.diff(psi))[np.diff(t) < 2 * dt]
    jumps = steps[steps > 1.9 * np.pi]
    turns = max(np.median(rates(np.unwrap(psi))), fast) > _FASTEST_TURN
    if np.median(jumps) > 4 * np.pi if jumps.size else turns:
        fault = f"q has psi from {psi.min():.4g} to {psi.max():.4g}, a yaw rate of {fast:.3g} rad/s and more"
        raise InvalidArgument(f"{fault}, expected radians: are these degrees?")


def held_integrals(t: Array, u: Array, edges: Array) -> Array:
    """Return the integrals of zero-order held inputs u between successive edges."""
    total = np.vstack([np.zeros(u.shape[1]), np.cumsum(u[:-1] * np.diff(t)[:, None], axis=0)])
    k = np.clip(np.searchsorted(t, edges, side="right") - 1, 0, len(t) - 1)
    return np.asarray(np.diff(total[k] + u[k] * (edges - t[k])[:, None], axis=0))


_POSE = 3  # x, y, psi
_SENSORS = "q", "twist", "wheel_rates", "joints"


def _check_motion(measured: Collection[str]) -> None:
    if not measured:
        raise InvalidArgument(f"{format_names(_SENSORS)} are None, expected at least one: measured motion")


class Samples(NamedTuple):
    """Log with equal time steps.

    Attributes
    ----------
    dt : float
        Time step [s].
    t : ndarray, shape (N,)
        Times since the first sample [s].
    is_valid : ndarray of bool, shape (N,)
        Whether the row was measured; other rows are interpolated.
    u, q, twist, wheel_rates, joints : ndarray, shape (N, ...), or None
        Arrays of `Log`.
    phase : float
        Time after that of a row at which its inputs begin [time steps].
    """

    dt: float
    t: Array
    is_valid: NDArray[np.bool_]
    u: Array
    q: Array | None = None
    twist: Array | None = None
    wheel_rates: Array | None = None
    joints: Array | None = None
    phase: float = 0.0


@final
@dataclass(frozen=True, eq=False, repr=False)
class Log:
    """Measured poses and inputs of a robot, for `identify` and `identify_velocity`.

    Times increase, with small jitter. A time that occurs twice counts once. A gap divides the log, see
    ``split``. A sensor that is slower than the rows has NaN between its measurements, or repeats them:
    repeated values do not count.

    Parameters
    ----------
    t : array_like, shape (N,)
        Times [s].
    q : array_like, shape (N, 3), or None
        Measured pose (x, y, psi) [m, m, rad]; None if it was not measured. psi may be wrapped or unwrapped. A
        row may have NaN here or in the other measurements: its input still counts.
    u : array_like, shape (N, nu)
        Input, constant from each time to the next. A body driven by forces has (Fx, Fy, Mz) in the inertial
        frame [N, N, N m]. Wheels have torques [N m], voltages [V] or currents [A]; currents need a known
        load, see `identify`. A robot with velocity inputs has (forward speed, yaw rate) [m/s, rad/s], a car
        (speed, steering angle) [m/s, rad]. Over rows with NaN the last known input holds.
    twist : array_like, shape (N, 3) or (N, 2), optional
        Measured body twist (forward, left, yaw rate) [m/s, m/s, rad/s], or (forward, yaw rate).
    wheel_rates : array_like, shape (N, k), optional
        Encoder rates of the driven wheels at the times, in the order of the inputs [rad/s]. The difference
        of two angles is the rate half a step before the later one.
    dropped : int
        Number of rows that a reader has already dropped, less the rows between slow measurements.
    units : tuple of str
        Units of the inputs: "N", "N m", "V", "A", "m/s", "rad/s" or "rad", or "" if unknown; () if all
        are unknown. `identify` rejects units that do not fit its robot.
    clock : tuple of 2 float
        Offset [s] and rate by which `from_streams` corrected the times of the inputs: offset + rate * time.
    joints : array_like, shape (N, k), optional
        Measured coordinates of the robot behind its pose: joints of arms and angles of wheels [rad].
    stream : tuple of ndarray, shape (M,) and (M, nu), optional
        Times [s] and inputs of which `u` has the means, from `from_streams`.

    Attributes
    ----------
    dropped : int
        Number of rows with NaN, and of repeated times.
    dt : float
        Time step [s].

    Raises
    ------
    InvalidArgument
        If a shape is wrong, times do not increase, nothing was measured, or numbers seem to be in degrees,
        millimetres or milliseconds. The message gives the reason.

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
    clock: tuple[float, float] = (0.0, 1.0)
    joints: Array | None = None
    stream: tuple[Array, Array] | None = None

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
        expected = f"units of all {given['u'].shape[1]} inputs, or none"
        units = tuple(si_spelling(str(unit)) for unit in sequence("units", self.units, expected))
        shaped("units", units, (0,), (given["u"].shape[1],), words=f": {expected}")
        object.__setattr__(self, "units", units)
        measured = [name for name in given if name not in ("t", "u")]
        _check_motion(measured)
        repeats = np.flatnonzero(np.diff(t) == 0) + 1
        if len(repeats) > _REPEATS * len(t):
            raise InvalidArgument(
                f"t has the time of the row before in {len(repeats)} of {len(t)} rows, expected increasing "
                "times: were they rounded?"
            )
        given = {name: np.delete(array, repeats, axis=0) for name, array in given.items()}
        masks = {name: lost_rows({name: array}) for name, array in given.items()}
        for name, rows in masks.items():
            if rows.all():
                raise InvalidArgument(f"{name} has {len(t)} rows, each with NaN, expected rows without NaN")
        valid = ~(masks["t"] | masks["u"])
        rows_y = np.flatnonzero(valid & ~np.logical_and.reduce([masks[name] for name in measured]))
        if len(rows_y) < 2:
            raise InvalidArgument(
                f"t has {len(rows_y)} rows with inputs and a measurement, expected two or more: for inputs "
                "in rows of their own, use Log.from_streams"
            )
        valid[: rows_y[0]] = valid[rows_y[-1] + 1 :] = False
        count = int(np.logical_or.reduce([*masks.values()]).sum()) + len(repeats)
        object.__setattr__(self, "dropped", self.dropped + count)
        given = {name: array[valid] for name, array in given.items()}
        increasing("t", given["t"], ": sort the rows by time, or split the log at this row")
        if (usual := float(np.median(np.diff(given["t"])))) > _LONGEST_STEP:
            raise InvalidArgument(f"t has steps of {usual:g} s, expected seconds: are these milliseconds?")
        for name, array in given.items():
            finite(name, np.where(np.isnan(array), 0.0, array))
        for name in measured:
            k, array = np.flatnonzero(~masks[name][valid]), np.array(given[name])
            k = k[~repeat_mask(given["t"][k], array[k], 1 if name == "q" else 0)]
            array[np.delete(np.arange(len(array)), k)], given[name] = np.nan, array
            if name == "q":
                check_pose(given["t"][k], array[k])
                array[k, 2] = np.unwrap(array[k, 2])
        for name, array in given.items():
            object.__setattr__(self, name, frozen(array))

    def _given(self) -> dict[str, Array]:
        arrays = {name: getattr(self, name) for name in ("t", "q", "u", *_SENSORS[1:])}
        return {name: real(name, x) for name, x in arrays.items() if x is not None or name in ("t", "u")}

    def _arrays(self, *names: str) -> dict[str, Array]:
        """Return those of the named measurements that there are."""
        return {name: x for name in names if (x := getattr(self, name)) is not None}

    def _rebuild(self, given: dict[str, Any]) -> Self:
        """Return the log with other rows, of which those with NaN are known."""
        return replace(self, **given, dropped=-int(lost_rows(given).sum()))

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        losses = f", {self.dropped} rows dropped" if self.dropped else ""
        measured = ", ".join(f"{n} of {x.shape[1]}" for n, x in self._given().items() if n != "t")
        offset, rate = self.clock
        clock = f", times of inputs {offset:.4g} s + {rate:.6g} t" if self.clock != (0.0, 1.0) else ""
        return f"<Log: {len(self)} samples over {self.t[-1] - self.t[0]:g} s, {measured}{losses}{clock}>"

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
        t = self.t - self.t[0]
        rows = (t >= scalar("start", start)) & (t < scalar("stop", stop))
        return self._rebuild({name: array[rows] for name, array in self._given().items()})

    def split(self, max_gap: float = _BRIDGE) -> list[Self]:
        """Return the parts of the log between gaps: times without a known input and a measurement.

        `identify` and `identify_velocity` split logs by this method.

        Parameters
        ----------
        max_gap : float
            Longest gap within a part [s]; three lost rows are always allowed.

        Raises
        ------
        InvalidArgument
            If `max_gap` is not positive.
        """
        longest, given = positive("max_gap", max_gap, "s"), dict[str, Any](self._given())
        measured = [x for name, x in given.items() if name not in ("t", "u")]
        rows = np.flatnonzero(~np.logical_and.reduce([lost_rows({"": x}) for x in measured]))
        steps = np.diff(self.t[rows])
        usual = float(np.median(steps))
        gaps = np.flatnonzero(steps > max(longest, _HOLE * usual) + 1.5 * usual)
        if not gaps.size:
            return [self]
        cuts = zip(np.append(rows[0], rows[gaps + 1]), np.append(rows[gaps], rows[-1]) + 1, strict=True)
        return [self._rebuild({name: x[a:b] for name, x in given.items()}) for a, b in cuts if b - a > 1]

    def resample(self, dt: float) -> Self:
        """Return the log with another time step, from its first sample on.

        Inputs become their means over the new steps, measurements are interpolated. A row whose nearest
        measurement is more than half a step away has NaN.

        Parameters
        ----------
        dt : float
            New time step [s].

        Raises
        ------
        InvalidArgument
            If `dt` is not positive, or the log is shorter than two steps.
        """
        span = float(self.t[-1] - self.t[0])
        steps = int(span / bounded("dt", scalar("dt", dt), above=0, most=span, unit="s") + 1e-6)
        t, given = self.t[0] + dt * np.arange(steps + 1), self._given()
        old, u = given.pop("t"), given.pop("u")
        valid = {name: ~lost_rows({name: x}) for name, x in given.items()}
        half = 0.5 * step(t) * (1 + 1e-9)
        rows: dict[str, Any] = {n: _sample(old[valid[n]], x[valid[n]], t, half) for n, x in given.items()}
        old, u = self._own_stream() or (old, u)
        return self._rebuild({"t": t, "u": _mean_inputs(old, u, t), **rows})

    def step_of(self, *names: str) -> float:
        """Return the time step of rows in which all named sensors that there are have measured [s].

        Raises
        ------
        InvalidArgument
            If there are no such rows.
        """
        given = self._arrays(*names)
        t = self.t[~lost_rows(given)]
        if len(t) < 2:
            raise InvalidArgument(
                f"log has {len(t)} rows with {' and '.join(given)}, expected two: see Log.from_streams"
            )
        return _mean_step(t)

    def samples(self, *names: str, dt: float | None = None, near: float | None = None) -> Samples:
        """Return named measurements at equal time steps, interpolated, with a mask of the measured rows.

        The time step is `dt` [s], with mean inputs; default: that of the measurements. With `near`, inputs
        begin at the phase of the time steps at which those of the stream change, the nearest to `near`.
        """
        dt = self.step_of(*names) if dt is None else dt
        given = self._arrays(*names)
        valid = ~lost_rows(given)
        t, given = self.t[valid], {name: x[valid] for name, x in given.items()}
        phases = np.exp(2j * np.pi * (t - t[0]) / dt)
        start = t[0] + dt * float(np.angle(phases.sum())) / (2 * np.pi)  # the first time has jitter too
        steps = np.rint((t - start) / dt).astype(int)
        times = dt * np.arange(steps[-1] + 1)
        grid, is_valid = start + times, np.zeros(len(times), bool)
        is_valid[steps] = True
        is_even = np.abs(t - grid[steps]).max() < 1e-3 * dt
        if not is_even or step(self.t) < 0.75 * dt:  # jitter, or a sensor that is slower than the inputs
            u = _mean_inputs(self.t, self.u, grid)
        else:
            rows = np.rint((self.t - start) / dt).astype(int)
            u = self.u[np.searchsorted(rows, np.arange(len(grid)), side="right") - 1]
        if not is_even or len(t) < len(grid):
            given = {name: _interpolate(_extend(t), _extend(x), grid) for name, x in given.items()}
        stream, phase = None if near is None else self._own_stream(), 0.0
        if stream and near is not None:
            phase = _phase(*stream, start, dt, near)
            u = _mean_inputs(*stream, grid + phase * dt) if phase else u
        return Samples(dt, times, is_valid, u, **given, phase=phase)

    def _own_stream(self) -> tuple[Array, Array] | None:
        """Return the stream if the inputs are its means; None if others have replaced them."""
        if self.stream is None:
            return None
        t, u = self.stream
        rows = np.diff(self.t, append=np.inf) < 1.5 * step(self.t)  # before a gap, the mean was another one
        same = np.isclose(_mean_inputs(t, u, self.t), self.u, rtol=0, atol=1e-9 * np.abs(u).max())
        return self.stream if same[rows].all() else None

    def rollout(self, robot: Any, *, delay: float = 0.0, **options: Any) -> Rollout:
        """Return the log as a rollout, beside a robot that replays its inputs.

        The states are the measured ones, and the reference is the motion of the robot from the same start. So
        figures and the viewer show the measured robot solid, the model as the ghost, and their difference as
        the error. A log without poses shows the odometry of its twist.

        Parameters
        ----------
        robot : plant
            Robot in the plane with the inputs of the log, such as ``robot()`` of an `Identification`.
        delay : float
            Delay of the inputs [s], such as that of an `Identification`.
        **options
            Of `simulate`, such as ``substeps`` and ``forces``.

        Raises
        ------
        InvalidArgument
            If the robot has other inputs, or `simulate` rejects an option.
        """
        from pinmobile.identification._filters import rollout_of

        return rollout_of(self, robot, delay, **options)

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
        joints: ArrayLike | None = None,
        t_twist: ArrayLike | None = None,
        t_wheel_rates: ArrayLike | None = None,
        t_joints: ArrayLike | None = None,
        one_clock: bool = True,
        units: Sequence[str] = (),
    ) -> Self:
        """Return the log of measurements and inputs with separate times.

        Each input is constant until the next one. The input of a row is the mean over its time step.
        `identify_velocity` takes the inputs at their own times where they change at a common phase of the
        time steps. The rows have the times of the fastest sensor, and times between them if inputs are
        faster. A sensor has NaN in the rows between its measurements.

        Parameters
        ----------
        t_q : array_like, shape (N,)
            Times of the poses [s].
        q : array_like, shape (N, 3), or None
            Poses [m, m, rad]; None if they were not measured.
        t_u : array_like, shape (M,)
            Times of the inputs [s].
        u : array_like, shape (M, nu)
            Inputs, see the class.
        twist, wheel_rates, joints : array_like, shape (N, ...), optional
            Twist, encoder rates and joint positions, see the class.
        t_twist, t_wheel_rates, t_joints : array_like, shape (N,), optional
            Their times [s]; default: `t_q`.
        one_clock : bool
            Whether all times are of one clock. If not, the offset and the rate of the clock of the inputs are
            estimated, and their times corrected.
        units : sequence of str
            Units of the inputs, see the class.

        Raises
        ------
        InvalidArgument
            If the class rejects the data, or the times overlap by less than half, as those of two clocks.
        """
        streams: dict[str, tuple[Array, Array]] = {}
        times: dict[str, Any] = {"q": t_q, "twist": t_twist, "wheel_rates": t_wheel_rates}
        times |= {"joints": t_joints, "u": t_u}
        given: Any = {"q": q, "twist": twist, "wheel_rates": wheel_rates, "joints": joints, "u": u}
        for name, x in given.items():
            if x is not None or name == "u":
                own = "q" if times[name] is None else name
                t = finite(f"t_{own}", times[own])
                increasing(f"t_{own}", t)
                x = np.array(shaped(name, real(name, x), (len(t), "k"), words=f", as t_{own} has"))
                valid = ~np.isnan(x).any(axis=1)
                if name == "q" and x.shape[1] == _POSE:
                    x[valid, 2] = np.unwrap(x[valid, 2])
                streams[name] = t, x
        times_u, inputs = streams.pop("u")
        _check_motion(streams)
        t = min((time for time, _ in streams.values()), key=step)
        offset, rate = 0.0, 1.0
        if not one_clock:
            name, motion = next(iter(streams.items()))
            offset, rate = clock_of(times_u, inputs, *motion, name == "q")
            times_u = offset + rate * times_u
        first, last = max(t[0], times_u[0]), min(t[-1], times_u[-1])
        if last - first < 0.5 * (t[-1] - t[0]):
            raise InvalidArgument(
                f"t_u is from {times_u[0]:.9g} to {times_u[-1]:.9g} s and t_q from {t[0]:.9g} to {t[-1]:.9g} "
                "s, expected a longer overlap by times of one clock: correct one, or give one_clock=False"
            )
        t = t[(t >= first) & (t <= times_u[-1])]
        half, factor = 0.5 * step(t) * (1 + 1e-9), min(round(step(t) / step(times_u)), _FINER)
        if factor > 1:  # rows without a measurement keep the times of faster inputs
            t = np.interp(np.arange((len(t) - 1) * factor + 1) / factor, np.arange(len(t)), t)
            half = half / factor
        rows: dict[str, Any] = {
            name: x[np.searchsorted(own, t)] if np.isin(t, own).all() else _sample(own, x, t, half)
            for name, (own, x) in streams.items()
        }
        count = max(int(lost_rows({name: x}).sum()) for name, (_, x) in streams.items())
        gaps = int(lost_rows(rows).sum()) - count  # rows between measurements are not lost
        rows = {"q": None, "u": _mean_inputs(times_u, inputs, t)} | rows
        names = tuple(sequence("units", units, "units of all inputs"))
        known = ~np.isnan(inputs).any(axis=1)
        stream = frozen(times_u[known]), frozen(inputs[known])
        return cls(t, **rows, dropped=-gaps, units=names, clock=(offset, rate), stream=stream)

    @classmethod
    def from_rollout(
        cls,
        rollout: Rollout,
        noise: ArrayLike = 0.0,
        input_noise: ArrayLike = 0.0,
        *,
        joint_noise: ArrayLike | None = None,
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
        joint_noise : array_like, shape () or (k,), optional
            Standard deviation of the noise of the coordinates behind the pose [rad]; None: not measured.
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
        lag, plant = check_integer("delay", delay, least=0, most=len(rollout) - 2), rollout.plant
        generator, end = seeded("seed", seed), len(rollout) - lag

        def noisy(name: str, deviation: ArrayLike, values: Array) -> Array:
            size = bounded(name, shaped(name, finite(name, deviation), (), values.shape[1:]), least=0)
            with np.errstate(over="ignore"):  # the class rejects infinite numbers
                return values + size * generator.standard_normal(values.shape)

        q, u = noisy("noise", noise, rollout.poses[:end]), noisy("input_noise", input_noise, rollout.u[lag:])
        names, inputs = [item.name for item in coordinates_of(plant)], inputs_of(plant)
        wheels = [names.index(item.name) for item in inputs if item.name in names]
        rates = rollout.v[:end, wheels] if wheels else None
        joints = None if joint_noise is None else noisy("joint_noise", joint_noise, rollout.q[:end, _POSE:])
        units = tuple(item.unit for item in inputs)
        return cls(rollout.t[lag:], q, u, None, rates, units=units, joints=joints)

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
        - wheel rates: names that begin with ``rate_``;
        - joint positions: names that begin with ``joint_``.

        Units such as ``[deg]``, ``[mm]`` and ``[ms]`` are converted to SI. Cells are separated by commas,
        semicolons, tabs or blanks. If the separator is not a comma, numbers may have decimal commas. Lines
        before the header that begin with ``#`` are skipped.

        Parameters
        ----------
        path : str or path-like
            File to read.
        columns : mapping of str to str or sequence of str, optional
            Names of the columns for ``t``, ``q``, ``u``, ``twist``, ``wheel_rates`` and ``joints``, where
            they differ from the above. Six columns of ``q`` are x, y and a quaternion (x, y, z, w).

        Raises
        ------
        InvalidArgument
            If the file cannot be read, a unit does not fit its column, or the class rejects the data.
        UnknownName
            If a column or a unit is unknown.
        """
        parts, units, short = read_csv(path, columns)
        times = parts.pop("t")[:, 0]
        given: dict[str, Any] = parts
        return cls(times, given.pop("q", None), given.pop("u"), **given, dropped=short, units=units)

    @classmethod
    def from_bag(cls, path: str | PathLike[str], topics: Mapping[str, str] | None = None) -> Self:
        """Read a log from a ROS 1 or ROS 2 bag, or from an MCAP file. ROS itself is not needed.

        The reader takes the times from the message headers. If messages have none, it takes the times of
        arrival. Without topics, it reads a file of `Rollout.to_mcap` with all digits, as `from_rollout` does.

        Parameters
        ----------
        path : str or path-like
            File ``.bag`` or ``.mcap``, or folder of a ROS 2 bag.
        topics : mapping of str to str, optional
            Topics of ``u`` and of ``q``, ``twist``, ``wheel_rates`` or ``joints``. Poses come from
            odometry, pose and transform messages. Inputs come from wrenches, twists (forward, yaw rate),
            joint efforts and arrays of numbers. Joint positions come from joint states and arrays.

        Raises
        ------
        InvalidArgument
            If the packages of the extra ``bags`` are not installed, the bag does not exist, a topic has
            messages of another type, or `from_streams` rejects the data.
        FileError
            If the bag is damaged. Damage shows in its structure and in the CRCs of its chunks. Without
            topics, if it is no file of `Rollout.to_mcap`.
        UnknownName
            If the bag has no such topic; the message lists its topics.
        """
        if topics is None:
            return cls.from_rollout(Rollout.from_mcap(path))
        streams = read_bag(path, topics)
        (t_u, u), (t_q, q) = streams.pop("u"), streams.pop("q", (np.zeros(0), None))
        arrays: dict[str, Any] = {name: x for name, (_, x) in streams.items()}
        arrays |= {f"t_{name}": t for name, (t, _) in streams.items()}
        return cls.from_streams(t_q, q, t_u, u, **arrays)


def logs_of(log: object) -> list[Log]:
    """Return one log, or several logs, as a list.

    Raises
    ------
    InvalidArgument
        If there is no log, or an entry is not a `Log`.
    """
    method = "from_rollout" if isinstance(log, Rollout) else "from_csv"
    hint = f": use Log.{method}" if isinstance(log, str | PathLike | Rollout) else ""
    expected = f"a Log or a sequence of Log{hint}"
    logs = [log] if isinstance(log, Log) else sequence("log", log, expected, 1)
    return [instance(f"log[{k}]", each, Log, expected) for k, each in enumerate(logs)]


_TAKEN_BY = {  # function, with its arguments, for inputs of each unit
    "N": "identify with robot=None or a MobileRobot",
    "N m": "identify with wheels without electric motors",
    "V": "identify with wheels with electric motors",
    "A": "identify with loads=[None, load], which makes the torque per ampere identifiable",
    **dict.fromkeys(("m/s", "rad/s"), "identify_velocity"),
    "deg": "np.radians",
}


def check_inputs(log: Log, name: str, expected: Mapping[str, str], words: str, other: str = "") -> None:
    """Reject inputs of another number or in other units.

    Parameters
    ----------
    log : Log
        The log.
    name : str
        Name of the log, for the message.
    expected : mapping of str to str
        Unit of each input, by name.
    words : str
        Expected inputs, for the message about their number.
    other : str
        Another unit that any input may have.
    """
    if log.u.shape[1] != len(expected):
        raise InvalidArgument(f"{name} has {log.u.shape[1]} inputs, expected {words}")
    for unit, (name_u, si) in zip(log.units, expected.items(), strict=False):
        if unit not in ("", si, other):
            is_other = unit in _TAKEN_BY and unit not in expected.values()
            hint = f"for {unit}, use {_TAKEN_BY[unit]}" if is_other else "are columns mixed up?"
            if (unit, si) == ("rad/s", "rad"):
                hint = "leave out wheelbase for commands of the yaw rate"
            raise InvalidArgument(f"{name} has input {name_u} in {unit}, expected {si}: {hint}")


def continuous(log: Log, name: str, *names: str) -> list[Log]:
    """Return the parts of a log between gaps of named measurements, without other measurements.

    Raises
    ------
    InvalidArgument
        If none of them is measured, or all parts are shorter than 2 s or 16 measurements.
    """
    if all(getattr(log, other) is None for other in names):
        raise InvalidArgument(f"{name} has no {' and no '.join(names)}, expected a measurement of the motion")
    others: dict[str, Any] = {other: None for other in _SENSORS if other not in names}
    parts = replace(log, **others, dropped=0).split()
    long = [run for run in parts if run.t[-1] - run.t[0] >= _SHORTEST and _count(run, names) >= LEAST_ROWS]
    long = parts if len(parts) == 1 else long
    if not long:
        longest = max(run.t[-1] - run.t[0] for run in parts)
        raise InvalidArgument(
            f"{name} has {len(parts)} parts between gaps of more than {_BRIDGE:g} s, the longest of "
            f"{longest:.2g} s, expected {_SHORTEST:g} s and {LEAST_ROWS} measurements or more"
        )
    return long


def unused_rows(log: Log, *names: str) -> int:
    """Return the number of rows with named measurements that are in none of the parts of a log."""
    return _count(log, names) - sum(_count(part, names) for part in continuous(log, "log", *names))


def _count(log: Log, names: Sequence[str]) -> int:
    given = log._arrays(*names)
    return int((~lost_rows(given)).sum()) if given else 0


def _sample(t: Array, x: Array, rows: Array, farthest: float) -> Array:
    """Return columns interpolated at rows, with NaN where no time t is near."""
    k = np.clip(np.searchsorted(t, rows), 1, len(t) - 1)
    gap = np.minimum(np.abs(rows - t[k - 1]), np.abs(t[k] - rows))
    return np.where(gap[:, None] <= farthest, _interpolate(t, x, rows), np.nan)


def _mean_inputs(t: Array, u: Array, rows: Array) -> Array:
    """Return the means of held inputs over the steps from each of some times, with NaN where one is NaN."""
    edges = np.append(rows, rows[-1] + step(rows))
    mean = held_integrals(t, np.nan_to_num(u), edges) / np.diff(edges)[:, None]
    missing = np.isnan(u).any(axis=1, keepdims=True)
    mean[held_integrals(t, missing.astype(float), edges)[:, 0] > 0] = np.nan
    return np.asarray(mean)


def _phase(t: Array, u: Array, start: float, dt: float, near: float) -> float:
    """Return the phase nearest to another one at which held inputs change; 0 if there is no common one."""
    changes = t[1:][(np.diff(u, axis=0) != 0).any(axis=1)]
    turn = np.exp(2j * np.pi * ((changes - start) / dt - near)).mean() if changes.size else 0.0
    phase = near + float(np.angle(turn)) / (2 * np.pi)
    return phase if abs(turn) > _ONE_PHASE and abs(phase - round(phase)) > _NO_PHASE else 0.0


def _extend(x: Array) -> Array:
    """Return rows with one more at each end, on the line through the last two."""
    return np.concatenate([2 * x[:1] - x[1:2], x, 2 * x[-1:] - x[-2:-1]])


def _interpolate(t: Array, columns: Array, grid: Array) -> Array:
    return np.column_stack([np.interp(grid, t, column) for column in columns.T])
