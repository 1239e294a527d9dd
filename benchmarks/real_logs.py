"""Logs of real robots: how much of the motion commands explain, by kinematics, lags and an identified model.

Usage: python benchmarks/real_logs.py PATH [--only NAME ...]

PATH is a folder with clones of norlab-ulaval/norlab_WMRD and norlab-ulaval/doughnut_calib (skid steer:
Warthog and Husky), Lorenzo-Lyons/DART and skosmaga/wynda-wmr (cars), BrOleg5/Slippage-compensation (motors of
the omni wheels of a Robotino) and sousarbarb/optiodom (differential drive, three omni wheels, four mecanum
wheels). It needs pandas, openpyxl and scipy.

Two thirds of a log are for the fit. Models run free over the whole log: R^2 is that of the part for the fit
and of the rest. Errors of speeds [m/s] and rates [rad/s] are those after 0.1, 2 and 5 s from measured initial
values, in the rest. Rows in which commands do not act are left out, such as those in which an operator
drives. Commands of cars: throttle or speed, and the same times the steering.
"""

import argparse
import io
import pickle
import subprocess
import sys
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import import_module
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from measuring import about, console, say, table

import pinmobile as pm

Array = np.ndarray[Any, Any]
AHEAD, LAGS, DELAYS = (0.1, 2.0, 5.0), (0.03, 0.1, 0.2, 0.4, 0.8), np.arange(-0.2, 0.81, 0.05)  # [s]
CONTAINERS = {"DataFrame", "BlockManager", "_unpickle_block", "_reconstruct", "_frombuffer", "ndarray"}
CONTAINERS |= {"dtype", "slice", "Index", "RangeIndex", "_new_Index"}
PLANAR, TICK = np.array(["forward", "left", "yaw rate"]), np.pi * 0.084 / (43.7 * 64) / 0.05  # [m/s]


class Log(NamedTuple):
    """Commands and the motion that follows.

    Attributes
    ----------
    dt : float
        Time step of the motion [s].
    t, u : ndarray, shapes (N,) and (N, c)
        Times [s], and a command of each motion, constant until the next.
    grid : ndarray, shape (M,)
        Times of the motion [s].
    y : ndarray, shape (M, c)
        Speeds [m/s], yaw rates or rates of motors [rad/s].
    good : ndarray of bool, shape (M,)
        Whether commands act and the motion is measured.
    names : sequence of str
        What the motions are called.
    steering : ndarray, shape (N,), or None
        Steering angles that a car is commanded [rad].
    """

    dt: float
    t: Array
    u: Array
    grid: Array
    y: Array
    good: Array
    names: Any = ("speed", "yaw rate")
    steering: Any = None

    @property
    def parts(self) -> tuple[Array, Array]:
        """Which rows are for the fit, and which are the rest."""
        early = self.grid < np.quantile(self.grid[self.good], 2 / 3)
        return self.good & early, self.good & ~early

    def late(self, delay: float) -> Array:
        """Return the mean commands of each time step, late by a delay [s], shape (M, c)."""
        area = np.vstack([0 * self.u[:1], np.cumsum(self.u[:-1] * np.diff(self.t)[:, None], axis=0)])
        return (at(self.grid - delay + self.dt, self.t, area) - at(self.grid - delay, self.t, area)) / self.dt


Step = Callable[[Array, Array], Array]
# From a motion and the commands that act, shapes (..., c), to the next motion.


def at(times: Array, t: Array, x: Array) -> Array:
    """Return the columns of x at other times."""
    return np.column_stack([np.interp(times, t, column) for column in x.T])


def twist(t: Array, q: Array, grid: Array, half: float) -> Array:
    """Return the body twist by differences over +-half [s], shape (M, 3)."""
    d, psi = (at(grid + half, t, q) - at(grid - half, t, q)) / (2 * half), np.interp(grid, t, q[:, 2])
    c, s = np.cos(psi), np.sin(psi)
    return np.column_stack([c * d[:, 0] + s * d[:, 1], c * d[:, 1] - s * d[:, 0], d[:, 2]])


def near(mask: Array, n: int) -> Array:
    """Return the rows at most n rows from those of a mask."""
    return np.convolve(mask, np.ones(2 * n + 1), "same") > 0.5


def stored(clone: Path, commit: str, file: str) -> bytes:
    """Return a file of a clone."""
    done = subprocess.run(["git", "-C", str(clone), "show", f"{commit}:{file}"], capture_output=True)
    return done.stdout if done.returncode == 0 else sys.exit(f"{clone}: {done.stderr.decode().strip()}")


class Containers(pickle.Unpickler):
    """Unpickler that makes containers of pandas and NumPy, and nothing else."""

    def find_class(self, module: str, name: str) -> Any:
        """Return a container; older tables name older places."""
        if module.split(".")[0] in ("pandas", "numpy", "builtins") and name in CONTAINERS:
            return super().find_class(module.replace("numpy.core", "numpy._core"), name)
        raise pickle.UnpicklingError(f"{module}.{name} is no container")


def unpickled(clone: Path, commit: str, file: str) -> tuple[Array, Array, Any]:
    """Return times [s], commands and the whole of a table."""
    rows = Containers(io.BytesIO(stored(clone, commit, file))).load()[3:]
    t = rows["ros_time"].to_numpy(float)
    return (t - t[0]) / 1e9, rows[["cmd_vel_x", "cmd_vel_omega"]].to_numpy(float), rows


def warthog(path: Path) -> Log:
    """Return 14 minutes of speeds of wheels and a gyro; between commands an operator drives."""
    file = "MS/GPS Pipeline/data_september8th/doughnut__2022-09-08-10-11-57.pkl"
    t, u, rows = unpickled(path / "norlab_WMRD", "dd932b56f4a7", file)
    angle, grid = rows[["wheel_pos_left", "wheel_pos_right"]].to_numpy(float), np.arange(50.0, 900.0, 0.05)
    seen, asked = angle.any(axis=1), t[u.any(axis=1)]  # other rows are without angles, or commands
    before, after = (at(grid + half, t[seen], angle[seen]).mean(axis=1) for half in (-0.25, 0.25))
    y = np.column_stack([0.3 * (after - before) / 0.5, np.interp(grid, t, rows["imu_z"].to_numpy(float))])
    idle = grid - asked[np.searchsorted(asked, grid) - 1] > 1.5
    return Log(0.05, t, u, grid, y, ~near(idle & (np.abs(y) > 0.1).any(axis=1), 20))


def husky(path: Path) -> Log:
    """Return four of eleven minutes on wet grass, in which commands act: speeds of wheels, yaw of scans."""
    file = "calib_data/husky_wheels_wetgrass/model_training_datasets/raw_dataframe.pkl"
    t, u, rows = unpickled(path / "doughnut_calib", "1d6d210fa3d2", file)
    x, y, z, w = rows[["icp_pos_x", "icp_pos_y", "icp_quat_z", "icp_quat_w"]].to_numpy(float).T
    new, q = np.diff(x, prepend=0) != 0, np.column_stack([x, y, np.unwrap(2 * np.arctan2(z, w))])
    grid, wheels = np.arange(1.0, t[-1] - 1, 0.05), rows[["meas_left_vel", "meas_right_vel"]].to_numpy(float)
    nu, acts = twist(t[new], q[new], grid, 0.25), np.interp(grid, t, rows["calib_state"] == "calib") == 1
    motion = np.column_stack([0.1651 * np.interp(grid, t, wheels.mean(axis=1)), nu[:, 2]])
    return Log(0.05, t, u, grid, motion, acts & ~near(np.hypot(nu[:, 0], nu[:, 1]) > 1.5, 20))


def dart(path: Path) -> Log:
    """Return 100 s of a car of 1:10 by throttle and steering, below motion capture."""
    file = "91_free_driving_16_sept_2024/car_1_Datarecording_09_16_2024_10_27_02.csv"
    raw = stored(path / "DART", "4b52523294ad", f"System_identification/Data/{file}").decode()
    rows = np.loadtxt(raw.splitlines(), delimiter=",", skiprows=1)
    acts, throttle, steering, t, x, y, psi = rows[rows[:, 0] > 0, 7:].T
    throttle, grid = throttle * acts, np.arange(t[0] + 0.1, t[-1] - 0.1, 0.05)
    u, q = np.column_stack([throttle, throttle * steering]), np.column_stack([x, y, np.unwrap(psi)])
    y, good = twist(t, q, grid, 0.05)[:, [0, 2]], np.interp(grid, t, acts) == 1
    return Log(0.05, t, u, grid, y, good, steering=0.35 * steering)


def slow_car(path: Path) -> Log:
    """Return 96 s of a slow car by speed and steering, whose poses jump."""
    raw = io.BytesIO(stored(path / "wynda-wmr", "351e60b1a3c0", "Experiment/data_dt.xlsx"))
    rows = import_module("openpyxl").load_workbook(raw).active.iter_rows(max_col=6, values_only=True)
    t, speed, steering, *q = np.array(list(rows), float).T
    grid, u = np.arange(t[0] + 1, t[-1] - 1, 0.1), np.column_stack([speed, -speed * steering])
    nu = twist(t, np.array(q).T, grid, 0.6)
    ahead = np.hypot(nu[:, 0], nu[:, 1])
    y = np.column_stack([ahead, nu[:, 2]])
    return Log(0.1, t, u, grid, y, ~near(ahead > 0.2, 10), steering=-steering)


def robotino(path: Path) -> Log:
    """Return three minutes of three motors."""
    raw = stored(path / "Slippage-compensation", "cf203b3ad5ab", "data/Robotino_data.mat")
    data = zlib.decompress(raw[raw.rindex(b"\x0f\0\0\0") + 8 :])  # the last element contains all
    x = [np.frombuffer(column[:72424]) for column in data.split(np.array([9, 72424], "<i4").tobytes())[1:]]
    t, *x = np.array(x)[:, np.diff(x[0], prepend=-1) > 1e-6]  # some times are there twice
    grid = np.arange(0.0, 179.9, 0.02)
    return Log(0.02, t, np.array(x[4::6]).T, grid, at(grid, t, np.array(x[2::6]).T), grid >= 0, "123")


def tracked(path: Path, name: str, wheels: int, unit: Sequence[float], *late: float) -> Log:
    """Return runs below motion capture, one after the other; in each, its clock is late by some seconds."""

    def read(end: str) -> list[list[str]]:
        file = f"data/{name}/{name.rpartition('/')[2]}{end}.csv"
        raw = stored(path / "optiodom", "8e025fd7a30c", file).decode()
        return [row.split(",") for row in raw.splitlines() if row[:3] == "Run" or row[:1].isdigit()]

    rows, us, qs, end, n = read(""), [], [], 0.0, len(unit)
    starts = [k for k, row in enumerate(rows) if row[0][:3] == "Run"] + [len(rows)]
    for k, by in enumerate(late):
        table = [row[:1] + row[4 + wheels :][:n] for row in rows[starts[k] + 1 : starts[k + 1]]]
        us.append(np.array(table, float) * [1, *unit])
        us[-1][:, 0] += end - us[-1][0, 0]
        qs.append(np.array(read(f"_run-{k + 1:02d}"), float)[:, :4] + [end + by, 0, 0, 0])
        end = us[-1][-1, 0] + 5.0
    u, q, planar = np.concatenate(us), np.concatenate(qs), [0, 1, 2] if n == 3 else [0, 2]
    t, grid = q[:, 0], np.arange(q[0, 0] + 0.2, q[-1, 0] - 0.2, 0.05)
    between, y = np.diff(t)[np.searchsorted(t, grid) - 1] > 1.0, twist(t, q[:, 1:], grid, 0.1)[:, planar]
    return Log(0.05, u[:, 0], u[:, 1:], grid, y, ~near(between, 5), PLANAR[planar])


def lagging(log: Log, lags: Sequence[float]) -> tuple[list[str], Array, Step]:
    """Return first-order lags of the commands, each with gain and delay, by output error.

    Returns
    -------
    told : list of str
        Parameters of each motion.
    u : ndarray, shape (M, c)
        Commands that act in each time step.
    step : callable
        Step of the model.
    """
    lfilter, train = import_module("scipy.signal").lfilter, log.parts[0]

    def error(k: int, lag: float, delay: float) -> tuple[float, ...]:
        kept, y = np.exp(-log.dt / lag), log.y[train, k]
        x = lfilter([0, 1 - kept], [1, -kept], log.late(delay)[:, k])[train]
        gain = x @ y / (x @ x)
        return ((y - gain * x) ** 2).sum(), gain, lag, delay

    best = [min(error(k, *each) for each in product(lags, DELAYS)) for k in range(log.y.shape[1])]
    for k, width in product(range(len(best)), 0.5 ** np.arange(7)):
        around = best[k][2] * 2.0 ** (width * np.arange(-1, 2)), best[k][3] + 0.03 * width * np.arange(-1, 2)
        best[k] = min(error(k, *each) for each in product(*around))
    _, gain, lag, delay = np.array(best).T
    kept, u = np.exp(-log.dt / lag), np.column_stack([log.late(by)[:, k] for k, by in enumerate(delay)])
    told = [f"gain {g:.3g}, {1e3 * by:.0f} ms late, lag {1e3 * x:.0f} ms" for _, g, x, by in best]
    return told, u, lambda z, now: kept * z + (1 - kept) * gain * now


def identified(log: Log) -> tuple[list[str], Array, Step]:
    """Return the same of the model that pinmobile identifies from the pieces of a log, of 81 rows or more."""
    rows = np.flatnonzero(log.parts[0])
    pieces = [part for part in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if len(part) > 80]
    u, units = log.u, ("m/s", "rad/s")
    if log.steering is not None:
        u, units = np.column_stack([u[:, 0], log.steering]), ("m/s", "rad")
    logs = [pm.Log.from_streams(log.grid[k], None, log.t, u, twist=log.y[k]) for k in pieces]
    found = pm.identify_velocity([replace(each, units=units) for each in logs])
    robot, told = found.robot(), " ".join(f"{x:.2g}" for x in found.phi[: len(found.model.first)])
    finer = 5 + int(2 * log.dt / min(found.model.time_constants(found.phi)))
    h, now = log.dt / finer, log._replace(u=u).late(found.delay)
    now = np.clip(now, -robot.limits, robot.limits)
    told = [told, f"numbers above, {1e3 * found.delay:.0f} ms late"]
    if log.steering is None:
        return told, now, repeated(lambda z, u: z + h * np.asarray(robot.rates(z, u)), finer)
    (most, fastest), T, turned = robot.rate_limits, robot.steering_time_constant, np.zeros(2)
    for row in now:  # the steering follows its commands alone
        wanted = robot.steering_gain * row[1] + robot.steering_offset
        for _ in range(finer):
            rate = np.clip((wanted - turned[0]) / T, -fastest, fastest)
            turned = turned + h * np.array([turned[1], 4 * (rate - turned[1]) / T])
        row[1] = turned[0]

    def drive(z: Array, u: Array) -> Array:
        speed, k = z[..., 0], robot.curvature(z[..., 0], u[..., 1])
        drag = robot.cornering_drag * speed * np.abs(speed) * k * np.tan(u[..., 1])
        faster = (robot.speed_gain * u[..., 0] - speed) / robot.speed_time_constant - drag
        speed = speed + h * np.clip(faster, -most, most)
        return np.stack([speed, speed * robot.curvature(speed, u[..., 1])], axis=-1)

    return told, now, repeated(drive, finer)


def repeated(step: Step, count: int) -> Step:
    """Return a number of steps as one."""

    def steps(z: Array, u: Array) -> Array:
        for _ in range(count):
            z = step(z, u)
        return z

    return steps


def scores(log: Log, u: Array, step: Step) -> Array:
    """Return of each motion R^2 in the part for the fit and in the rest, and the errors after AHEAD."""
    free, gone = np.zeros_like(log.y), np.cumsum(~log.good)
    for k in range(len(free) - 1):
        free[k + 1] = step(free[k], u[k])
    rows = [1 - ((log.y - free)[part] ** 2).mean(axis=0) / log.y[part].var(axis=0) for part in log.parts]
    for n in (round(seconds / log.dt) for seconds in AHEAD):
        begun = np.flatnonzero(log.parts[1][:-n] & (gone[n:] == gone[:-n]))
        z = log.y[begun]
        for k in range(n):
            z = step(z, u[begun + k])
        rows.append(np.sqrt(((z - log.y[begun + n]) ** 2).mean(axis=0)))
    return np.array(rows).T


LOGS = {each.__name__: each for each in (warthog, husky, dart, slow_car, robotino)}
RUNS: dict[str, tuple[Any, ...]] = {
    "differential": ("diff/free/030120210006", 2, (TICK, 20), 0.08, 0.03, 0.33, -0.02),
    "omni": ("omni3/joystick/221220202235", 3, (1, 1, 1), 3.77, 2.22, 1.09, 2.18, 1.02, 1.3, 5.26, 0.99),
    "mecanum": ("omni4/square/080920201205", 4, (1, 1, 1), -0.06, -0.07, -0.1, -0.11),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("path", type=Path, help="folder with the clones")
    parser.add_argument("--only", nargs="+", default=[*LOGS, *RUNS], choices=[*LOGS, *RUNS], metavar="NAME")
    chosen, out, words = parser.parse_args(arguments), console(), [about()]
    shown = table("Logs of real robots", "motion", "model", "R2 fit", "rest", *(f"{x:g} s" for x in AHEAD))
    for name in chosen.only:
        try:
            log = LOGS[name](chosen.path) if name in LOGS else tracked(chosen.path, *RUNS[name])
            for lags in ((1e-9,), LAGS, ()):  # kinematics, lags, and the identified model
                told, u, step = lagging(log, lags) if lags else identified(log)
                for motion, model, row in zip(log.names, told, scores(log, u, step), strict=True):
                    shown.add_row(f"{name}: {motion}", model, *(f"{x:.4f}" for x in row))
        except pm.PinmobileError as error:
            words.append(f"{name}, identified: {error}")
        except ImportError as lack:
            sys.exit(f"{lack.name} is missing: pip install {lack.name}")
    out.print(shown)
    say(out, words)
    return 0


if __name__ == "__main__":
    sys.exit(main())
