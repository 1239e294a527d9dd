"""Logs of commands and motion: runs at equal time steps, parts that the commands explain, and segments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.identification._filters import FINEST, twist_of, without_outliers
from pinmobile.identification._lag import Channel, Lag
from pinmobile.identification._log import Log, check_units, continuous
from pinmobile.identification._simulation import Segments

CHANNELS = {"speed": "m/s", "yaw rate": "rad/s"}  # names and units
CAR_COMMANDS = {"speed": "m/s", "steering angle": "rad"}
LEAST_BLOCKS = 20  # smallest number of blocks of the jackknife
BLOCK, _LONG_BLOCK = 2.0, 5.0  # [s], their length: the longest that a log allows
_LATEST, _MOST_LATE = 0.6, 60  # largest delay [s] and [samples]
LEAST = 0.3  # smallest explained share of the motion
_MOST_UNEXPLAINED = 0.5  # largest share of a log under other control
_USUAL, _SLOW = 0.9, 0.3  # quantile of the usual speed, and the share of it from which curvatures are known
_STEEPEST = 1.3  # [rad], steering commands beyond it have no curvature


class Run(NamedTuple):
    """A log with equal time steps.

    Attributes
    ----------
    log : int
        Index of the log.
    start : float
        Time of the first row since the start of the log [s].
    dt : float
        Time step [s].
    u : ndarray, shape (N, 2)
        Commands.
    y, calm : ndarray, shape (N, k)
        Measurements, and the same without gross outliers.
    seen : ndarray of bool, shape (N,)
        Rows with a measurement.
    nu : ndarray, shape (N, 2)
        Speed and yaw rate, filtered if poses are measured.
    state : ndarray, shape (N, n)
        First estimates of the states of the model, without a pose: `nu`, or for a car its speed, steering
        angle and steering rate.
    is_car : bool
        Whether the second command is a steering angle.
    """

    log: int
    start: float
    dt: float
    u: Array
    y: Array
    calm: Array
    seen: NDArray[np.bool_]
    nu: Array
    state: Array
    is_car: bool


class Part(NamedTuple):
    """Samples `start` to before `stop` of a run."""

    run: Run
    start: int
    stop: int


def runs_of(logs: list[Log], is_pose: bool, inputs: Mapping[str, str]) -> list[Run]:
    """Return the checked logs, with the units of their inputs by name, at equal time steps."""
    is_car = inputs is CAR_COMMANDS
    for one in logs:
        if one.u.shape[1] != len(inputs):
            raise InvalidArgument(
                f"log has {one.u.shape[1]} inputs, expected two, commands of speed and yaw rate: for forces, "
                "torques or voltages use identify; commands of sideways speeds are not identified"
                if is_car or inputs is CHANNELS
                else f"log has {one.u.shape[1]} inputs, expected {', '.join(inputs)}: of a car, give the "
                "steering angle [rad] in place of its torque"
            )
        check_units(one, "log", inputs)
    if any((one.twist is None) != is_pose for one in logs):
        raise InvalidArgument("log has a twist, and another log has none, expected a twist in all or in none")
    name, found = "q" if is_pose else "twist", []
    pairs = [(k, part) for k, one in enumerate(logs) for part in continuous(one, "log", name)]
    dt = max(part.dt for _, part in pairs)
    for k, part in pairs:
        run = part.samples(name, dt=dt)
        if run.twist is not None:
            y = calm = nu = run.twist[:, [0, 2]]
        else:
            y = np.asarray(run.q)
            calm, _, _ = without_outliers(y, run.seen, run.dt, FINEST)
            nu = twist_of(calm, run.dt)
            _check_heading(nu)
            nu = nu[:, [0, 2]]
        state = np.column_stack([nu[:, 0], run.u[:, 1], 0 * nu[:, 0]]) if is_car else nu
        start = float(part.t[0] - logs[k].t[0])
        found.append(Run(k, start, run.dt, run.u, y, calm, run.seen, nu, state, is_car))
    return found


def _check_heading(twist: Array) -> None:
    """Reject poses that move sideways more than forward, even for a point ahead of the axle."""
    forward, left, turn = twist.T
    aside = left - (left @ turn) / max(float(turn @ turn), 1e-300) * turn
    speeds = [float(np.sqrt(np.mean(x**2))) for x in (forward, aside)]
    if speeds[1] > speeds[0]:
        raise InvalidArgument(
            f"log has poses that move sideways at {speeds[1]:.3g} m/s and forward at {speeds[0]:.3g} m/s, "
            "expected psi in the direction of travel [rad]: is psi in degrees, from a compass, of another "
            "frame, or with times of another clock?"
        )


def lead_of(runs: Sequence[Run]) -> int:
    """Return the largest delay of a command [samples]."""
    longest = max(len(run.u) for run in runs)
    return max(3, min(_MOST_LATE, round(_LATEST / runs[0].dt), longest // 10))


def block_of(parts: Sequence[Part]) -> int:
    """Return the length of a block of the jackknife [samples]."""
    dt = parts[0].run.dt
    span = dt * _samples(parts) / (LEAST_BLOCKS + 1)
    return max(3, round(min(max(span, BLOCK), _LONG_BLOCK) / dt))


def parts_of(runs: Sequence[Run]) -> list[Part]:
    """Return each run as one part."""
    return [Part(run, 0, len(run.u)) for run in runs]


def speeds_of(parts: Sequence[Part]) -> list[Part]:
    """Return parts with speed and yaw rate as measurements."""
    return [part._replace(run=part.run._replace(y=part.run.nu, calm=part.run.nu)) for part in parts]


def channels_of(parts: Sequence[Part]) -> list[Channel]:
    """Return commands and motion of speed and yaw rate, or for a car of speed and curvature."""
    dt, names = parts[0].run.dt, [*CHANNELS]
    commands = [run.u[a:b] for run, a, b in parts]
    motions = [np.where(run.seen[:, None], run.nu, np.nan)[a:b] for run, a, b in parts]
    is_car = parts[0].run.is_car
    if is_car:
        names[1] = "curvature"
        slow = _SLOW * np.nanquantile(np.abs(np.concatenate(motions)[:, 0]), _USUAL)
        wheels = [np.tan(np.clip(u[:, 1], -_STEEPEST, _STEEPEST)) for u in commands]
        commands = [np.column_stack([u[:, 0], wheel]) for u, wheel in zip(commands, wheels, strict=True)]
        fast = [np.where(np.abs(nu[:, 0]) > slow, nu[:, 0], np.nan) for nu in motions]
        motions = [np.column_stack([nu[:, 0], nu[:, 1] / v]) for nu, v in zip(motions, fast, strict=True)]
    return [
        Channel(name, [u[:, k] for u in commands], [y[:, k] for y in motions], dt, is_car and k == 1)
        for k, name in enumerate(names)
    ]


def explained_parts(runs: Sequence[Run], lags: Sequence[Lag], least: float = LEAST) -> list[Part]:
    """Return the parts of runs whose motion the commands explain, by at least a share of each channel.

    Raises
    ------
    InvalidArgument
        If the commands explain too little of the motion.
    """
    channels, found = channels_of(parts_of(runs)), []
    masks = [channel.unexplained(lag) for channel, lag in zip(channels, lags, strict=True)]
    for run, one, other in zip(runs, *masks, strict=True):
        edges = np.flatnonzero(np.diff(~(one | other), prepend=False, append=False)).reshape(-1, 2)
        found += [Part(run, a, b) for a, b in edges.tolist() if (b - a) * run.dt > BLOCK]
    left_out = 1 - _samples(found) / _samples(parts_of(runs))
    pairs = zip(channels_of(found) if found else channels, lags, strict=True)
    shares = {channel.name: channel.share(lag) for channel, lag in pairs}
    check_explained(shares, lags, runs[0].dt, left_out, least)
    return found


def check_explained(
    shares: Mapping[str, float | None],
    lags: Sequence[Lag],
    dt: float,
    left_out: float = 0.0,
    least: float = LEAST,
) -> None:
    """Reject commands that explain too small shares of the motion by channel, or nothing in most of the log.

    The share of a channel with constant commands is None.
    """
    if left_out <= _MOST_UNEXPLAINED and all(share is None or share >= least for share in shares.values()):
        return
    found = " and ".join(
        f"nothing of the {name}, whose command is constant"
        if share is None
        else f"{max(share, 0.0):.0%} of the {name} (delay {1e3 * lag.late * dt:.3g} ms, gain {lag.gain:.3g}, "
        f"time constant {lag.tau:.2g} s)"
        for (name, share), lag in zip(shares.items(), lags, strict=True)
    )
    where = f" nothing in {left_out:.0%} of the log, and in the rest" * (left_out > _MOST_UNEXPLAINED)
    raise InvalidArgument(
        f"log has commands that explain{where} {found}, expected most of it: are the commands from another "
        "robot or another driver, with another sign, or with times of another clock?"
        + " Steering angles of a car need their unit, rad, or wheelbase."
        * ("curvature" not in shares)
    )


def format_left_out(runs: Sequence[Run], parts: Sequence[Part]) -> str:
    """Return the sections of runs outside the parts as text; "" if there are none."""
    gaps, several = list[tuple[float, str]](), len({run.log for run in runs}) > 1
    for run in runs:
        edges = [0, *(edge for part in parts if part.run is run for edge in part[1:]), len(run.u)]
        where = f"log[{run.log}] " * several
        for a, b in np.reshape(edges, (-1, 2)).tolist():
            times = f"{where}{run.start + a * run.dt:.4g} to {run.start + b * run.dt:.4g} s"
            gaps += [((b - a) * run.dt, times)] * (b > a)
    if not gaps:
        return ""
    total = sum(seconds for seconds, _ in gaps)
    return (
        f"{total:.3g} s of the log are left out: there the commands do not explain the motion, as if "
        f"another driver had taken over: {', '.join(text for _, text in gaps)}"
    )


def segments_of(
    parts: Sequence[Part], lead: int, seconds: float, filled: bool = True
) -> tuple[Segments, NDArray[np.bool_]]:
    """Return segments of a length [s], and a mask of samples without gross outliers.

    If `filled`, long segments are whole blocks, and the last one of a part is filled up; otherwise it is left
    out.
    """
    dt, block = parts[0].run.dt, block_of(parts)
    length = max(3, round(seconds / dt))
    length, found, calms = block * round(length / block) if filled and length > block else length, [], []
    for run, a, b in parts:
        N, is_pose = len(run.u), run.y.shape[1] > len(CHANNELS)
        first = max(a, lead if a == 0 else 0)
        at = first + np.arange(max(0, -(-(b - first) // length)) * length).reshape(-1, length)
        inside = (at < b) & run.seen[np.minimum(at, N - 1)]
        least = max(3.0, 0.5 * min(length, block) * run.seen.mean())
        kept = (inside.sum(axis=1) >= least) & (filled | (at[:, -1] < b))
        at, inside = np.minimum(at[kept], N - 1), inside[kept]
        states = np.concatenate([run.state, run.calm] if is_pose else [run.state], axis=-1)
        near = np.clip(at[:, :1] - lead - 1 + np.arange(lead + 1 + length + 1), 0, N - 1)
        times, noise, load = np.full(len(at), dt), np.ones((len(at), run.y.shape[1])), np.zeros((len(at), 4))
        start = states[at[:, 0]]
        found.append(Segments(times, at * dt, run.y[at], inside, noise, start, run.u, near, lead + 1, load))
        calms.append((run.calm == run.y).all(axis=-1)[at])
    if not any(len(each.y) for each in found):
        raise InvalidArgument(
            f"log has no part of {length * dt:.3g} s with measurements, expected a longer one"
        )
    return Segments.joined(found), np.concatenate(calms)


def _samples(parts: Sequence[Part]) -> int:
    return sum(part.stop - part.start for part in parts)
