"""Many states of a UR5 on its base at once: M(q), inverse and forward dynamics, of each peer.

Usage: python benchmarks/batches.py [--quick] [--rounds N] [--only WORD ...]

The robot is the nominal one of `arm_fleet.py`. What a batch returns is compared with M, n and a
linear solve before it is timed; a peer's own loop over the states, and handing over each, are part of it.
What the first call takes, which compiles, is told apart.
"""

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
from arm_fleet import ArmFleet, built
from contestants import MUJOCO, PINMOBILE, PYTHON, Peer
from measuring import Row, about, console, interleaved, median_time, picked, say, selecting, table
from task import TOLERANCE

Batch = Callable[..., np.ndarray]
GIVEN = {"M": 1, "inverse": 3, "forward": 3}  # how many of q, v and a
NV = 9
FEW = 499  # states that pinmobile asks Pinocchio for, one after another


@dataclass(frozen=True)
class Batcher:
    """One row of the table: its name, whose it is, and what returns its batches by name."""

    name: str
    peer: Peer
    batches: Callable[[], Mapping[str, Batch]]


def of_pinmobile() -> dict[str, Batch]:
    from arm_ensemble_contestants.of_pinmobile import words

    robot: Any = words(ArmFleet(1))["robot"]
    return {"M": robot.mass_matrix, "inverse": robot.inverse_dynamics, "forward": robot.forward_dynamics}


def one_by_one() -> dict[str, Batch]:
    """Return what pinmobile does of few states."""

    def in_parts(whole: Batch) -> Batch:
        def run(*given: np.ndarray) -> np.ndarray:
            starts = range(0, len(given[0]), FEW)
            return np.concatenate([whole(*(x[k : k + FEW] for x in given)) for k in starts])

        return run

    return {name: in_parts(whole) for name, whole in of_pinmobile().items()}


def of_pinocchio() -> dict[str, Batch]:
    import pinocchio as pin

    model = built("ur5")
    data = model.createData()

    def looped(function: Callable[..., np.ndarray], size: tuple[int, ...]) -> Batch:
        def run(*given: np.ndarray) -> np.ndarray:
            found = np.empty((len(given[0]), *size))
            for k, row in enumerate(zip(*given, strict=True)):
                found[k] = function(model, data, *row)
            return found

        return run

    nv = model.nv
    return {
        "M": looped(pin.crba, (nv, nv)),
        "inverse": looped(pin.rnea, (nv,)),
        "forward": looped(pin.aba, (nv,)),
    }


def in_parallel() -> dict[str, Batch]:
    """Return Pinocchio's functions that have threads of their own; none is of M."""
    import pinocchio as pin

    workers = os.cpu_count() or 1
    pool = pin.ModelPool(built("ur5"), workers)

    def turned(function: Callable[..., np.ndarray]) -> Batch:
        return lambda *given: function(workers, pool, *(x.T for x in given)).T

    return {"inverse": turned(pin.rneaInParallel), "forward": turned(pin.abaInParallel)}


def of_mujoco() -> dict[str, Batch]:
    import mujoco
    from arm_ensemble_contestants.of_mujoco import build

    model, data = build(0.001, built("ur5"))
    position, velocity, acceleration = data.qpos, data.qvel, data.qacc

    def M(q: np.ndarray) -> np.ndarray:
        found = np.empty((len(q), model.nv, model.nv))
        for k, row in enumerate(q):
            position[:] = row
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_crb(model, data)
            mujoco.mj_fullM(model, data, found[k])
        return found

    def inverse(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        found = np.empty_like(a)
        for k in range(len(q)):
            position[:], velocity[:], acceleration[:] = q[k], v[k], a[k]
            mujoco.mj_inverse(model, data)
            found[k] = data.qfrc_inverse
        return found

    def forward(q: np.ndarray, v: np.ndarray, force: np.ndarray) -> np.ndarray:
        found = np.empty_like(force)
        for k in range(len(q)):
            position[:], velocity[:], data.qfrc_applied[:] = q[k], v[k], force[k]
            mujoco.mj_forward(model, data)
            found[k] = acceleration
        return found

    return {"M": M, "inverse": inverse, "forward": forward}


BASE = Batcher("pinmobile, one state after another", PINMOBILE, one_by_one)
EVERYONE = (
    Batcher("pinmobile, batches", PINMOBILE, of_pinmobile),
    BASE,
    Batcher("Pinocchio, a loop in Python", PYTHON, of_pinocchio),
    Batcher("Pinocchio in parallel (C++)", PYTHON, in_parallel),
    Batcher("MuJoCo, a loop in Python", MUJOCO, of_mujoco),
)


def main(arguments: Sequence[str] | None = None) -> int:
    chosen = selecting(__doc__.splitlines()[0]).parse_args(arguments)
    rounds, n = chosen.rounds or (1 if chosen.quick else 9), 600 if chosen.quick else 10_000
    some = picked(EVERYONE, chosen.only)
    people = [one for one in EVERYONE if one is BASE or one in some]
    given, out, sound = states(n), console(), True
    out.print(about(), f"medians over {rounds} interleaved rounds of {n:,} states", sep="; ")
    rows, words = {}, {}
    turns: dict[tuple[str, str], Callable[[], float]] = {}
    with out.status("batches"):
        right = expected(given)
        for one in people:
            for name in GIVEN:
                run, word = check(one, name, given, right)
                rows[one.name, name], words[one.name, name] = Row(one.name, one.peer.version, word), word
                sound &= not word.startswith(("WRONG", "FAILED"))
                if run is not None:
                    least = 0.0 if chosen.quick else 0.1
                    turns[one.name, name] = lambda run=run, least=least: median_time(run, least)
        for key, times in interleaved(turns, rounds).items():
            rows[key].times = times
    shown, notes = table(f"\nUR5 on its base, {n:,} states, us each", "library", "version", *GIVEN), []
    for one in people:
        cells: list[str] = []
        for name in GIVEN:
            row = rows[one.name, name]
            if row.times:
                cells.append(f"{1e6 * row.median / n:.3f} ({1 / row.ratio(rows[BASE.name, name]):.1f} x)")
            else:
                cells.append("none" if row.word == "none" else "-")
        shown.add_row(one.name, one.peer.version, *cells)
        told = dict.fromkeys(words[one.name, name] for name in GIVEN)
        notes += [f"{one.name}: {word}" for word in told if word not in ("", "none")]
    out.print(shown)
    say(out, [*notes, f"x: how many times as fast as {BASE.name}, the median of the ratios of each round"])
    return 0 if sound else 1


def states(n: int) -> tuple[np.ndarray, ...]:
    """Return q, v and a, shape (n, 9) each: any posture, and what an arm is asked for."""
    rng = np.random.default_rng(1)
    return rng.uniform(-np.pi, np.pi, (n, NV)), *rng.normal(size=(2, n, NV))


def expected(given: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    """Return what must come out, by another way than rnea and aba."""
    import pinocchio as pin

    model = built("ur5")
    data = model.createData()
    M = np.array([pin.crba(model, data, q) for q in given[0]])
    n = np.array([pin.nle(model, data, q, v) for q, v in zip(*given[:2], strict=True)])
    a = given[2]
    forward = np.linalg.solve(M, (a - n)[..., None])[..., 0]
    return {"M": M, "inverse": (M @ a[..., None])[..., 0] + n, "forward": forward}


def check(
    one: Batcher, name: str, given: Sequence[np.ndarray], right: Mapping[str, np.ndarray]
) -> tuple[Callable[[], None] | None, str]:
    """Return what is timed, or None if it is not done right, and a word on it."""
    if not one.peer.installed:
        return None, f"not installed: {one.peer.install}"
    try:
        batch = one.batches().get(name)
        if batch is None:
            return None, "none"
        wanted = given[: GIVEN[name]]
        start = perf_counter()
        found = batch(*wanted)
        first = perf_counter() - start
        apart = float(np.max(np.abs(found - right[name])) / np.max(np.abs(right[name])))
    except Exception as error:  # whatever a peer raises: the others go on
        return None, f"FAILED: {type(error).__name__}: {error}"
    if not apart <= TOLERANCE:
        return None, f"WRONG, not timed: {name} is off by {apart:.1e}"

    def run() -> None:
        batch(*wanted)

    return run, f"the first {name} takes {1e3 * first:.0f} ms" if one.batches is of_pinmobile else ""


if __name__ == "__main__":
    sys.exit(main())
