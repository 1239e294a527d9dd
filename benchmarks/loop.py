"""The loop of parts, beside another version of pinmobile: ensembles, rollouts, the first call of a process.

Usage: python benchmarks/loop.py [--quick] [--rounds N] [--only WORD ...] [--before PYTHON]

What is timed is in `loop_work.py`. PYTHON is the interpreter of an environment that has the other version.
In each round each version has a process of its own, in turn; it runs every row once before it times it.
"""

import json
import shutil
import statistics
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from loop_work import (
    FIRST_ENSEMBLE,
    FIRST_RESULTS,
    LONGEST,
    LOOPS,
    PRINTED,
    QUICK_ROBOTS,
    QUICK_STEPS,
    ROBOTS,
    RUNS,
    SHORT,
    STEPS,
)
from measuring import Row, about, console, last_line, picked, say, selecting, table
from rich.console import Console

BASE = "computed torque"
FIRST = ("first ensemble, nothing compiled", "first ensemble, with its files")
RATIOS = (
    ("ensemble, n = 16", "ensemble, n = 1"),
    ("simulate, Python", "raw Pinocchio loop"),
    ("simulate, compiled", "raw Pinocchio loop"),
)
HOW = (
    "the present version alone. For another beside it: git worktree add ../before COMMIT; "
    "python -m venv ../venv; ../venv/bin/pip install ../before (a version that needs numba: "
    "'../before[ensembles]'), and --before ../venv/bin/python"
)


EVERYONE = tuple(Row(name) for name in (*LOOPS, *RUNS, *FIRST, *FIRST_RESULTS))


def main(arguments: Sequence[str] | None = None) -> int:
    parser = selecting(__doc__.splitlines()[0])
    parser.add_argument("--before", metavar="PYTHON", help="interpreter that has the other version")
    chosen = parser.parse_args(arguments)
    if chosen.before and shutil.which(chosen.before) is None:
        parser.error(
            f"--before: {chosen.before} is no program, expected an interpreter such as .venv/bin/python"
        )
    rounds = chosen.rounds or (1 if chosen.quick else 5)
    names = [row.name for row in picked(EVERYONE, chosen.only)]
    if set(names) & set(LOOPS) and BASE not in names:
        names.insert(0, BASE)  # which the others are shares of
    versions = {"now": [sys.executable]}
    if chosen.before:
        # A path of sources that this interpreter was given is not the other's.
        versions = {"before": [chosen.before, "-E", "-s"], **versions}
    out = console()
    out.print(about(), f"medians over {rounds} interleaved rounds, one thread, CPU time", sep="; ")
    found: dict[str, dict[str, Row]] = {version: {name: Row(name) for name in names} for version in versions}
    with TemporaryDirectory(prefix="pinmobile-") as folder:
        for number in range(rounds):
            for version, interpreter in versions.items():
                with out.status(f"round {number + 1} of {rounds}, {version}"):
                    keep(found[version], told(interpreter, f"{folder}/{version}", names, chosen.quick))
    show_loops(out, found, chosen.quick)
    show_runs(out, found)
    say(out, words(found))
    if not chosen.before:
        say(out, [HOW])
    return int(any(row.word for row in found["now"].values()))


def told(
    interpreter: Sequence[str], folder: str, names: Sequence[str], quick: bool
) -> Mapping[str, float | str]:
    """Return the seconds of the rows in one process of a version, or a word on why there are none."""
    rows = [name for name in names if name in LOOPS or name in RUNS]
    answers: dict[str, float | str] = {}
    if rows:
        program = str(Path(__file__).with_name("loop_work.py"))
        command = [*interpreter, program, *(("--quick", "--least", "0") if quick else ()), *rows]
        said = last_line(command, PINMOBILE_CACHE=folder, NUMBA_CACHE_DIR=folder)
        answers |= dict.fromkeys(rows, said) if said.startswith("FAILED") else json.loads(said)
    if set(FIRST) & set(names):
        with TemporaryDirectory(prefix="pinmobile-") as empty:
            for name in FIRST:
                answers[name] = printed(interpreter, empty, FIRST_ENSEMBLE)
    for name in set(FIRST_RESULTS) & set(names):
        for _ in range(2):  # the first fills the folder
            answers[name] = printed(interpreter, folder, FIRST_RESULTS[name] + PRINTED)
    return {name: answers[name] for name in names}


def printed(interpreter: Sequence[str], folder: str, program: str) -> float | str:
    """Return the seconds that a program prints, with its machine code in a folder, or why it does not."""
    # An older version's compiler keeps its files by the second name.
    command, folders = [*interpreter, "-W", "ignore", "-c", program], ("PINMOBILE_CACHE", "NUMBA_CACHE_DIR")
    said = last_line(command, **dict.fromkeys(folders, folder))
    return said if said.startswith("FAILED") else float(said)


def keep(rows: Mapping[str, Row], answers: Mapping[str, float | str]) -> None:
    """Add a round to the rows; one that has a word keeps it, and is timed no more."""
    for name, answer in answers.items():
        row = rows[name]
        if isinstance(answer, str):
            row.word = answer
        else:
            row.times.append(answer)


def show_loops(out: Console, found: Mapping[str, Mapping[str, Row]], quick: bool) -> None:
    """Print the rows of many robots, with their shares of the speed of computed torque."""
    now = found["now"]
    names = [name for name in LOOPS if name in now]
    if not names:
        return
    columns = [f"{version}, ns" for version in found] + [f"{version}, of {BASE}" for version in found]
    n, steps = (QUICK_ROBOTS, QUICK_STEPS) if quick else (ROBOTS, STEPS)
    title = f"\nEnsembles of {n:,} robots, {steps:,} steps: a robot-step, and the speed as a share"
    shown = table(title, "loop", "", *columns, *(["times as fast as before"] if "before" in found else []))
    for name in names:
        times = [in_units(rows[name], 1e9) for rows in found.values()]
        shares = [ratio(rows[BASE], rows[name]) for rows in found.values()]
        shown.add_row(name, "", *times, *shares, *faster(found, name))
    out.print(shown)
    if "before" in found:
        say(out, [f"{SHORT} steps first, ten times as many where they take at most {LONGEST:g} s, then all"])


def show_runs(out: Console, found: Mapping[str, Mapping[str, Row]]) -> None:
    """Print the rows of one run, and what some take of others."""
    now = found["now"]
    names = [name for name in (*RUNS, *FIRST, *FIRST_RESULTS) if name in now]
    if not names:
        return
    columns = [f"{version}, ms" for version in found]
    shown = table(
        "\nOne run", "run", "", *columns, *(["times as fast as before"] if "before" in found else [])
    )
    for name in names:
        shown.add_row(name, "", *(in_units(rows[name], 1e3) for rows in found.values()), *faster(found, name))
    out.print(shown)
    for own, base in RATIOS:
        if own in now and base in now:
            parts = ((version, ratio(rows[own], rows[base])) for version, rows in found.items())
            said = ", ".join(f"{version} {part}" for version, part in parts if part)
            say(out, [f"time of `{own}`, of that of `{base}`: {said}"] if said else [])


def in_units(row: Row, per_second: float) -> str:
    return "" if row.word else f"{statistics.median(row.times) * per_second:.3g}"


def ratio(row: Row, base: Row) -> str:
    """Return what a row took of the base, the median of the ratios of each round."""
    return "" if row.word or base.word else f"{row.ratio(base):.2f}"


def faster(found: Mapping[str, Mapping[str, Row]], name: str) -> list[str]:
    """Return how many times as fast a row is as before, in the cell of a column that there may not be."""
    return [ratio(found["before"][name], found["now"][name])] if "before" in found else []


def words(found: Mapping[str, Mapping[str, Row]]) -> Iterable[str]:
    """Return which rows are missing, and why."""
    for version, rows in found.items():
        yield from (f"{name}, {version}: {row.word}" for name, row in rows.items() if row.word)


if __name__ == "__main__":
    sys.exit(main())
