"""A UR5 on its base, computed torque for the whole: `simulate` beside a raw Pinocchio loop and MuJoCo's.

Usage: python benchmarks/arm.py [--quick] [--rounds N] [--only WORD ...]

The task is in `arm_task.py`, who takes part in `arm_contestants/__init__.py`; all are checked before they are
timed, as in `rollout.py`. What the coupling between base and arm costs a controller that ignores it stands
below the table.
"""

import sys
from collections.abc import Sequence
from functools import lru_cache

from arm_contestants import EVERYONE, RAW, Carrier
from arm_contestants.of_pinmobile import largest_errors
from arm_contestants.of_pinocchio import terms
from arm_task import KD, KP, ArmTask, solved
from measuring import about, console, picked, selecting
from rollout import race, ranked
from task import TOLERANCE, Log, Run, difference


def main(arguments: Sequence[str] | None = None) -> int:
    chosen = selecting(__doc__.splitlines()[0]).parse_args(arguments)
    rounds = chosen.rounds or (1 if chosen.quick else 9)
    task = ArmTask(duration=0.6 if chosen.quick else ArmTask.duration)
    out = console()
    out.print(about(), f"medians over {rounds} interleaved rounds", sep="; ")
    least = 0.0 if chosen.quick else 0.2
    some = picked(EVERYONE, chosen.only)
    people = [one for one in EVERYONE if one is RAW or one in some]
    rows, sound = race(people, task, rounds, least, note=out.status, judge=check)
    title = f"UR5 on its base, nine coordinates, dt = {task.dt} s, {task.samples:,} samples"
    ranked(out, title, task, rows, rows[RAW.name])
    found = ", ".join(f"{name} {value:.1e}" for name, value in largest_errors(task).items())
    out.print(f"Largest error, kp = {KP:g}, kd = {KD:g}, in m or rad: {found}")
    return 0 if sound else 1


@lru_cache(maxsize=4)
def expected(task: ArmTask) -> Log:
    """Return what must come out, by another way than rnea and aba."""
    return solved(task, terms())


def check(one: Carrier, task: ArmTask) -> tuple[Run | None, str]:
    """Return what runs the task, or None if it is not done right, and a word on it."""
    try:
        run = one.prepare(task)
        apart = difference(run(), expected(task))
    except Exception as error:  # whatever a peer raises: the others go on
        return None, f"FAILED: {type(error).__name__}: {error}"
    if not apart <= TOLERANCE:
        return None, f"WRONG, not timed: off by {apart:.1e}"
    return run, f"{apart:.0e}"


if __name__ == "__main__":
    sys.exit(main())
