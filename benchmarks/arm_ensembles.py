"""Ensembles of arms: UR5s and pandas on bases, each with its payload, base and friction, beside the peers.

Usage: python benchmarks/arm_ensembles.py [--quick] [--rounds N] [--only WORD ...]

The work is in `arm_fleet.py`: computed torque of the whole with the nominal model, the lecture's step. Who
takes part in `arm_ensemble_contestants/__init__.py`. Robots are checked against mass matrices and linear
solves before anybody is timed, as in `ensembles.py`.
"""

import os
import sys
import tempfile
from collections.abc import Mapping, Sequence

from arm_ensemble_contestants import ARMS, EVERYONE
from ensemble_costs import measure, show_memory, weighing
from ensemble_race import Line, race
from ensembles import show_speeds, times_as_fast
from measuring import about, console, last_line, picked, say, table
from rich.console import Console

SIZES, QUICK_SIZES = (1, 100, 10_000), (1, 20)
LONGEST, QUICK_LONGEST = 60.0, 0.05  # a turn [s]
STEP, RK4, AVX2 = "pinmobile ensemble", "pinmobile ensemble, rk4", "pinmobile ensemble, code for AVX2"
LOOP = "Pinocchio, loop in Python"
PARALLEL, MUJOCO = "Pinocchio, rnea and aba in parallel", "mujoco.rollout, open loop"
ASKED = (  # ours, the peer, robots, and how many times as fast ours is to be at least
    (STEP, PARALLEL, 10_000, 50),
    (STEP, MUJOCO, 10_000, 35),
    (RK4, PARALLEL, 10_000, 15),
    (AVX2, PARALLEL, 10_000, 25),
    (STEP, LOOP, 1, 15),
)
LIMITS = {"a new robot: nothing compiled": 0.5, "a known one: with its file": 0.02}  # [s]
FIRST = """
from time import perf_counter as now
start = now()
from pinmobile import Circle, ComputedTorque, CubicVia, JointFriction, PayloadBody, MobileRobot, Tangent
from pinmobile import Uniform, WholeBody, ensemble
imported = now()
robot = MobileRobot.box(30).mount("{arm}", (0.1, -0.05, 0.2, 0.4)).attach(PayloadBody(1.0, (0, 0, 0.05)))
base = Tangent(Circle(1, 0.5, 6))
joints = CubicVia(robot.rest[3:], robot.rest[3:], robot.rest[3:], 3, 6)
motion, controller = WholeBody(robot, base, joints), ComputedTorque(robot, 100, 20)
spread = {{"loads.0.mass": Uniform(0, 3), "mass": Uniform(24, 36), "viscous": Uniform(0, 0.3)}}
made = now()
for _ in range(2):
    done = ensemble(robot, controller, motion, n=100, spread=spread, dt=0.001, duration=0.1,
                    forces=[JointFriction(0.0)])
    assert done.engine == "COMPILED"
    if not _:
        first = now()
print("\\n", imported - start, made - imported, first - made, now() - first)
"""


def main(arguments: Sequence[str] | None = None) -> int:
    chosen = weighing(__doc__.splitlines()[0]).parse_args(arguments)
    if chosen.one is not None:
        one = next(one for one in EVERYONE if one.name == chosen.one)
        print(measure(one, one.lasting(chosen.robots, chosen.duration)))
        return 0
    rounds = chosen.rounds or (1 if chosen.quick else 5)
    sizes = QUICK_SIZES if chosen.quick else SIZES
    longest, least = (QUICK_LONGEST, 0.0) if chosen.quick else (LONGEST, 0.1)
    out = console()
    out.print(about(), f"medians over {rounds} interleaved rounds", sep="; ")
    sound = True
    for arm, everyone in ARMS.items():
        people = picked(everyone, chosen.only)
        if not people:
            continue
        lines, right = race(people, sizes, rounds, longest, least, note=out.status)
        sound &= right
        by_name = {line.one.name.partition(": ")[2]: line for line in lines}
        show_speeds(out, f"{arm} on a base: ensembles of n robots", by_name, sizes)
        show_ratios(out, arm, by_name)
        weighed = [(line.one, line.fleets) for line in lines if line.fleets]
        sound &= show_memory(out, weighed[: 1 if chosen.quick else None], sizes[-1:], "arm_ensembles.py")
        if STEP in by_name and not chosen.quick:
            sound &= show_first_results(out, arm)
    return 0 if sound else 1


def show_ratios(out: Console, arm: str, lines: Mapping[str, Line]) -> None:
    """Print what is asked of ours."""
    shown = table(f"\n{arm}: times as fast", "ours", "peer", "robots", "times", "asked, at least")
    for ours, peer, n, least in ASKED:
        times = times_as_fast(lines.get(ours), lines.get(peer), n)
        if times:
            shown.add_row(ours, peer, f"{n:,}", times, f"{least:g}")
    if shown.row_count:
        out.print(shown)


def show_first_results(out: Console, arm: str) -> bool:
    """Print what the first ensemble of a process takes, with an empty cache and with a filled one."""
    columns = ("import, s", "robot, s", "first ensemble, s", "second, s", "limit of the first, s")
    shown = table(f"\n{arm}: first ensemble of a process, 100 robots, 100 steps", "code", "", *columns)
    with tempfile.TemporaryDirectory(prefix="pinmobile-") as cache:
        for name, limit in LIMITS.items():
            with out.status(name):
                times = [first_result(arm, cache, name.startswith("a new")) for _ in range(3)]
            failed = next((word for word in times if isinstance(word, str)), "")
            if failed:
                say(out, [f"{arm}, {name}: {failed}"])
                return False
            best = min(times, key=lambda each: each[2])
            shown.add_row(name, "", *(f"{seconds:.3f}" for seconds in best), f"{limit:g}")
    out.print(shown)
    return True


def first_result(arm: str, cache: str, new: bool) -> tuple[float, ...] | str:
    """Return the times of the parts of `FIRST` in a fresh process [s], or the word on why it failed."""
    if new:
        for file in os.scandir(cache):
            os.unlink(file)
    command = [sys.executable, "-W", "ignore", "-c", FIRST.format(arm=arm.lower())]
    said = last_line(command, PINMOBILE_CACHE=cache)
    return said if said.startswith("FAILED") else tuple(map(float, said.split()))


if __name__ == "__main__":
    sys.exit(main())
