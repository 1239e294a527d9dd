"""Rollouts side by side: `simulate` against a raw Pinocchio loop and the peers, each checked, then timed.

Usage: python benchmarks/rollout.py [--quick] [--rounds N] [--only WORD ...]

The task is in `task.py`, who takes part in `contestants/__init__.py`. A contestant whose trajectory is not
the expected one is printed as WRONG and not timed; one that is not installed, with what installs it.
"""

import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Any

from contestants import EVERYONE, OURS, RAW, SIMULATE, Contestant
from measuring import Row, about, console, interleaved, median_time, picked, say, selecting, table
from rich.console import Console
from task import TOLERANCE, Run, Task, difference, expected

STEPS = (0.1, 0.001)
OTHER_WORK = {
    "PD": {"control": "PD"},
    "computed torque, rk4": {"step": "rk4"},
    "a user's own law: PD, inline in the raw loop": {"control": "own law"},
}
CHECKED_OFFSET = 6_000  # samples of the check with the centre of mass off the axis, at most
SHARES = "of the raw loop: median of the ratios of each round, not ratio of the medians: rounds differ"


def main(arguments: Sequence[str] | None = None) -> int:
    parser = selecting(__doc__.splitlines()[0])
    chosen = parser.parse_args(arguments)
    rounds = chosen.rounds or (1 if chosen.quick else 7)
    out = console()
    out.print(about(), f"medians over {rounds} interleaved rounds", sep="; ")
    tasks = [Task(dt, duration=3.0 if chosen.quick and dt < 0.1 else 60.0) for dt in STEPS]
    some = picked(EVERYONE, chosen.only)
    people = [one for one in EVERYONE if one is RAW or one in some]
    least = 0.0 if chosen.quick else 0.1
    sound = [compare(out, task, people, rounds, least) for task in tasks]
    if SIMULATE in people:
        sound.append(compare_other_work(out, tasks, rounds, least))
    return 0 if all(sound) else 1


def compare(out: Console, task: Task, people: Sequence[Contestant], rounds: int, least: float) -> bool:
    """Print the table of one task; return whether all who took part did the work right."""
    title = f"Computed torque on the circle, dt = {task.dt} s, {task.samples:,} samples"
    rows, sound = race(people, task, rounds, least, note=out.status)
    ranked(out, title, task, rows, rows[RAW.name])
    return sound


def ranked(out: Console, title: str, task: Task, rows: dict[str, Row], base: Row) -> None:
    """Print who was timed, the fastest first, and under the table why the others were not."""
    shown = table(f"\n{title}", "contestant", "version", "us/step", "of the raw loop", "largest difference")
    timed = [row for row in rows.values() if row.times]
    for row in sorted(timed, key=lambda row: row.ratio(base) if base.times else row.median):
        shown.add_row(row.name, row.version, per_step(row, task), ratio(row, base), row.word)
    out.print(shown)
    say(out, [SHARES, *(f"{row.name}: {row.word}" for row in rows.values() if not row.times)])


def compare_other_work(out: Console, tasks: Sequence[Task], rounds: int, least: float) -> bool:
    """Print what `simulate` and the raw loop take for other controllers and the other integrator."""
    columns = ("work", "dt", "simulate, us/step", "raw loop, us/step", "of the raw loop")
    shown = table("\nOther work on the circle: simulate against the raw Pinocchio loop", *columns)
    all_sound, others = True, []
    for name, change in OTHER_WORK.items():
        for task in (replace(task, **change) for task in tasks):
            rows, sound = race(OURS, task, rounds, least, note=out.status)
            all_sound &= sound
            ours, base = (rows[one.name] for one in OURS)
            cells = (per_step(ours, task), per_step(base, task), ratio(ours, base))
            shown.add_row(name, str(task.dt), *cells)
            others += [f"{row.name}, {name}: {row.word}" for row in (ours, base) if not row.times]
    out.print(shown)
    say(out, [SHARES, *others])
    return all_sound


def per_step(row: Row, task: Task) -> str:
    return f"{row.median / task.samples * 1e6:.2f}" if row.times else ""


def ratio(row: Row, base: Row) -> str:
    return f"{row.ratio(base):.2f}" if row.times and base.times else ""


def check(one: Contestant, task: Task) -> tuple[Run | None, str]:
    """Return what runs the task, or None if it is not done right, and a word on it."""
    offset = task.offset()
    offset = replace(offset, duration=min(task.duration, CHECKED_OFFSET * task.dt))
    try:
        run = one.prepare(task)
        apart = max(difference(run(), expected(task)), difference(one.prepare(offset)(), expected(offset)))
    except Exception as error:  # whatever a peer raises: the others go on
        return None, f"FAILED: {type(error).__name__}: {error}"
    if not apart <= TOLERANCE:
        return None, f"WRONG, not timed: off by {apart:.1e}"
    return run, f"{apart:.0e}"


def race(
    people: Sequence[Contestant],
    task: Task,
    rounds: int,
    least: float = 0.0,
    note: Callable[[str], AbstractContextManager[object]] = nullcontext,
    judge: Callable[[Any, Any], tuple[Run | None, str]] = check,
) -> tuple[dict[str, Row], bool]:
    """Check all, then time those who are right.

    Parameters
    ----------
    people : sequence of Contestant
        Who takes part.
    task : Task
        What is done.
    rounds : int
        In each, all take one turn.
    least : float
        Length of a turn [s]; shorter rollouts are repeated, and their median counts.
    note : callable
        Makes a context in which a word on what is going on is shown.
    judge : callable
        Returns what runs the task, or None if it is not done right, and a word on it.

    Returns
    -------
    rows : dict of Row
        By name; `times` [s] is empty where a contestant is missing, fails or is wrong, and `word` says so.
    sound : bool
        Whether all who are installed are right.
    """
    rows = {one.name: Row(one.name, one.peer.version) for one in people}
    runs: dict[str, Run] = {}
    for one in people:
        row = rows[one.name]
        if not one.peer.installed:
            row.word = f"not installed: {one.peer.install}"
            continue
        with note(f"checking {one.name}"):
            run, row.word = judge(one, task)
        if run:
            runs[one.name] = run
    with note(f"timing {len(runs)} contestants, {rounds} rounds"):
        turns = {name: _turn(run, least) for name, run in runs.items()}
        for name, times in interleaved(turns, rounds).items():
            rows[name].times = times
    installed = [one for one in people if one.peer.installed]
    return rows, len(runs) == len(installed)


def _turn(run: Run, least: float) -> Callable[[], float]:
    return lambda: median_time(lambda: run().seconds, least)


if __name__ == "__main__":
    sys.exit(main())
