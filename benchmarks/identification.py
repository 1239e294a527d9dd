"""From a log to parameters: how often 95 % intervals hold the true ones, and how long it takes.

Usage: python benchmarks/identification.py [--quick] [--runs N] [--only WORD ...]

Logs of 60 s of a body with ten unknown parameters, each run with a motion and noise of its own; `--runs 60`
tells coverage to about two in a hundred. Beside `identify`: least squares as most write it, that is central
differences, one fit and the covariance of white residuals.
Of each: the share of runs whose interval holds the true parameter, averaged over the parameters; how wide
intervals are beside 1.96 times the errors' root mean square (1: as needed); and seconds of the processor, at
100 Hz those of 6,000 samples.
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from time import process_time
from typing import Any

import numpy as np
from measuring import about, console, picked, say, selecting, table

import pinmobile as pm
from pinmobile.identification import Excitation

RUNS, QUICK_RUNS = 2, 1
NOISE = 1e-3  # [m, m, rad]
FORCE_NOISE = (1.0, 1.0, 0.15)  # [N, N, N m]
TOLD = {
    **{"mass": 32.0, "com_x": 0.12, "com_y": -0.04, "yaw_inertia": 1.6},
    **{"viscous_forward": 6.0, "viscous_left": 14.0, "viscous_yaw": 1.2},
    **{"rolling_forward": 4.0, "rolling_left": 7.0, "rolling_yaw": 0.6},
}
TRUE = np.array(list(TOLD.values()))
ROBOT = pm.MobileRobot(32.0, 1.6, com=(0.12, -0.04))
FRICTION = [pm.ViscousFriction(TRUE[4:7]), pm.RollingResistance(TRUE[7:10])]


@dataclass(frozen=True)
class Case:
    """What is between the robot and its log."""

    name: str
    rate: int = 100  # [Hz]
    force_noise: Any = 0.0
    unmodelled: bool = False
    delay: int = 0  # samples
    outliers: int = 0


CASES = (
    Case("pose noise, 50 Hz", 50),
    Case("pose noise, 100 Hz"),
    Case("pose noise, 200 Hz", 200),
    Case("+ force noise, 50 Hz", 50, FORCE_NOISE),
    Case("+ force noise, 100 Hz", 100, FORCE_NOISE),
    Case("+ force noise, 200 Hz", 200, FORCE_NOISE),
    Case("+ a force that is not modelled", 100, unmodelled=True),
    Case("+ force noise, 3 samples late", 100, FORCE_NOISE, delay=3),
    Case("+ force noise, 40 outliers", 100, FORCE_NOISE, outliers=40),
)

QUICK_CASES = CASES[1:2]


def motion(seed: int) -> Excitation:
    """Return a random motion, up to 1.5 m/s and 1.2 rad/s, at rest at both ends."""
    raw = np.random.default_rng((1, seed)).normal(size=(5, 2, 3))
    order = np.arange(1, 6.0)[:, None]
    a = raw[:, 0] / order - (raw[:, 0] / order).mean(axis=0)
    b = raw[:, 1] / order
    b = b - order * (order * b).sum(axis=0) / (order**2).sum()
    shape = Excitation(np.stack([a, b], 1), 20.0, 60.0)
    fastest = np.abs(shape(np.linspace(0, 20, 400)).v).max(axis=0)
    return Excitation(np.stack([a, b], 1) * np.array([1.5, 1.2, 1.2]) / fastest, 20.0, 60.0)


def made(case: Case, seed: int) -> pm.Log:
    """Return a log of a case."""
    forces: list[Any] = list(FRICTION)
    if case.unmodelled:
        forces.append(pm.forces.NoiseForce((1.0, 1.0, 0.1), 1.0, seed=seed))
    run = pm.simulate(
        ROBOT,
        pm.ComputedTorque(ROBOT, kp=16, kd=8),
        motion(seed),
        dt=1 / case.rate,
        integrator=pm.rk4,
        substeps=max(1, 400 // case.rate),
        forces=forces,
        engine=pm.Engine.COMPILED,
    )
    log = pm.Log.from_rollout(run, NOISE, case.force_noise, delay=case.delay, seed=seed)
    if not case.outliers:
        return log
    rng, q = np.random.default_rng((2, seed)), np.array(log.q)
    q[rng.choice(len(q), case.outliers, replace=False)] += rng.normal(0, 0.1, (case.outliers, 3))
    return pm.Log(log.t, q, log.u)


Answer = tuple[np.ndarray[Any, Any], np.ndarray[Any, Any], float]


@lru_cache(100)
def found_in(log: pm.Log, method: str) -> pm.identification.Identification:
    """Return what `identify` finds."""
    return pm.identify(log, method=method)


def by_identify(log: pm.Log, method: str = "output error") -> Answer:
    """Return estimates, intervals and the delay in samples."""
    found = found_in(log, method)
    return (
        np.array([found.parameters[name] for name in TOLD]),
        np.array([found.interval()[name] for name in TOLD]),
        found.delay / found.dt,
    )


def by_weak_form(log: pm.Log) -> Answer:
    """Return the same of the weak form alone."""
    return by_identify(log, "weak")


def by_least_squares(log: pm.Log) -> Answer:
    """Return the same of least squares as most write it."""
    t, q, u = log.t, np.asarray(log.q), log.u
    width = max(1, len(t) // 2400)  # 25 Hz
    t, q, u = t[::width], q[::width], u[::width]
    dt = t[1] - t[0]
    v, a = (q[2:] - q[:-2]) / (2 * dt), (q[2:] - 2 * q[1:-1] + q[:-2]) / dt**2
    psi, u = q[1:-1, 2], u[1:-1]
    c, s, zero = np.cos(psi), np.sin(psi), np.zeros(len(psi))
    R = np.array([[c, s, zero], [-s, c, zero], [zero, zero, zero + 1]]).transpose(2, 0, 1)
    nu, acceleration, tau = ((R @ each[..., None])[..., 0] for each in (v, a, u))
    r, turn = nu[:, 2], a[:, 2]
    au, aw = acceleration[:, 0], acceleration[:, 1]
    body = [[au, -(r**2), -turn, zero], [aw, turn, -(r**2), zero], [zero, aw, -au, turn]]
    rows = [np.stack(each, axis=-1) for each in body]
    friction = np.concatenate([np.eye(3) * nu[:, None], np.eye(3) * np.sign(nu)[:, None]], axis=-1)
    Y = np.concatenate([np.stack(rows, axis=1), friction], axis=-1).reshape(-1, 10)
    phi, *_ = np.linalg.lstsq(Y, tau.ravel(), rcond=None)
    left = tau.ravel() - Y @ phi
    covariance = left @ left / (len(left) - 10) * np.linalg.inv(Y.T @ Y)
    m, mx, my, inertia = phi[:4]
    told = np.array([m, mx / m, my / m, inertia - (mx**2 + my**2) / m, *phi[4:]])
    D = np.eye(10)
    D[1, :2], D[2, [0, 2]] = (-mx / m**2, 1 / m), (-my / m**2, 1 / m)
    D[3, :4] = (mx**2 + my**2) / m**2, -2 * mx / m, -2 * my / m, 1
    half = 1.96 * np.sqrt(np.diag(D @ covariance @ D.T))
    return told, np.column_stack([told - half, told + half]), 0.0


@dataclass(frozen=True)
class Contestant:
    """Who takes part.

    Attributes
    ----------
    name : str
        What its rows are called.
    answer : callable
        Estimates, intervals and delay of a log.
    tells_delay : bool
        Whether it finds the delay.
    """

    name: str
    answer: Callable[[pm.Log], Answer]
    tells_delay: bool = False


EVERYONE = (
    Contestant("identify", by_identify, tells_delay=True),
    Contestant("identify, weak form alone", by_weak_form, tells_delay=True),
    Contestant("least squares as most write it", by_least_squares),
)


@dataclass(frozen=True)
class Score:
    """What became of a case.

    Attributes
    ----------
    holds : ndarray, shape (10,)
        Share of runs whose interval holds the true parameter.
    width : float
        Of intervals beside what the errors need: half a width over 1.96 times the errors' root mean square.
    delay : tuple of 2 float
        Root mean square and largest of the delay's errors, in samples.
    seconds : float
        Of the processor, for one log.
    """

    holds: np.ndarray[Any, Any]
    width: float
    delay: tuple[float, float]
    seconds: float


def judged(one: Contestant, case: Case, logs: Sequence[pm.Log]) -> Score:
    """Return how a contestant did in a case."""
    answers, seconds = [], 0.0
    for log in logs:
        begun = process_time()
        answers.append(one.answer(log))
        seconds += (process_time() - begun) / len(logs)
    values, ranges, delays = (np.array(each) for each in zip(*answers, strict=True))
    holds = ((ranges[..., 0] <= TRUE) & (ranges[..., 1] >= TRUE)).mean(axis=0)
    needed = 1.96 * np.sqrt(((values - TRUE) ** 2).mean(axis=0))
    half = np.sqrt(((ranges[..., 1] - ranges[..., 0]) ** 2).mean(axis=0)) / 2
    width = float(np.median(half / needed))
    off = np.abs(delays - case.delay)
    return Score(holds, width, (float(np.sqrt((off**2).mean())), float(off.max())), seconds)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table of cases."""
    parser = selecting(__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, help="logs of each case; --rounds does the same")
    chosen = parser.parse_args(arguments)
    runs = chosen.runs or chosen.rounds or (QUICK_RUNS if chosen.quick else RUNS)
    shown = table(
        f"{runs} logs of 60 s, 10 parameters, 95 % intervals",
        *("case", "who", "hold, of 100", "worst parameter", "width / needed", "delay off", "CPU s"),
    )
    for case in QUICK_CASES if chosen.quick else CASES:
        logs = [made(case, seed) for seed in range(runs)]
        for one in picked(EVERYONE, chosen.only):
            score = judged(one, case, logs)
            shown.add_row(
                case.name,
                one.name,
                f"{100 * score.holds.mean():.1f}",
                f"{100 * score.holds.min():.0f}",
                f"{score.width:.2f}",
                "{:.2f}, {:.2f}".format(*score.delay) if one.tells_delay else "-",
                f"{score.seconds:.2f}",
            )
    out = console()
    out.print(shown)
    say(out, [about(), "delay off: root mean square and largest of its errors, in samples"])
    return 0


if __name__ == "__main__":
    sys.exit(main())
