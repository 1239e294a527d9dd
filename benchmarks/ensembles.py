"""Ensembles side by side: `ensemble` against C by hand and the peers, each checked, then timed.

Usage: python benchmarks/ensembles.py [--quick] [--rounds N] [--only WORD ...]

The work is in `fleet.py`, who takes part in `ensemble_contestants/__init__.py`. One whose figures are not
the expected ones is printed as WRONG and not timed; one that would take too long is left out, and named.
"""

import sys
from collections.abc import Mapping, Sequence

from ensemble_contestants import EVERYONE, LIMIT, MUJOCO_CLOSED, MUJOCO_OPEN, OURS, Entrant
from ensemble_costs import measure, show_memory, weighing
from ensemble_race import Line, race, timed
from fleet import Fleet, difference, simulated
from measuring import Row, about, console, interleaved, median_time, picked, say, table
from rich.console import Console
from task import TOLERANCE

SIZES, QUICK_SIZES = (1, 100, 10_000, 1_000_000), (1, 100, 1_000)
JUDGED = 10_000  # robots, for the ratios that are asked for
LONGEST, QUICK_LONGEST = 8.0, 1.0  # a turn [s]
ASKED = {LIMIT: 0.5, MUJOCO_OPEN: 100, MUJOCO_CLOSED: 100}  # times as fast


def main(arguments: Sequence[str] | None = None) -> int:
    chosen = weighing(__doc__.splitlines()[0]).parse_args(arguments)
    if chosen.one is not None:
        one = next(one for one in EVERYONE if one.name == chosen.one)
        print(measure(one, one.fleet_of(chosen.robots, chosen.duration)))
        return 0
    rounds = chosen.rounds or (1 if chosen.quick else 5)
    people = picked(EVERYONE, chosen.only)
    sizes = QUICK_SIZES if chosen.quick else SIZES
    out = console()
    out.print(about(), f"medians over {rounds} interleaved rounds", sep="; ")
    reference = Fleet(2)
    apart = difference(simulated(reference), reference)
    say(out, [f"what is expected of two robots is what `simulate` returns, to {apart:.0e}"])
    longest, least = (QUICK_LONGEST, 0.0) if chosen.quick else (LONGEST, 0.1)
    lines, sound = race(people, sizes, rounds, longest, least, note=out.status)
    title = "Ensembles of n robots, 600 steps each"
    show_speeds(out, title, {line.one.name: line for line in lines}, sizes)
    show_ratios(out, {line.one: line for line in lines}, sizes)
    show_growth(out, lines, sizes, rounds)
    weighed = [(line.one, line.fleets) for line in lines if line.fleets]
    weighed, at = (weighed[:2], sizes[-1:]) if chosen.quick else (weighed, sizes[-2:])
    sound &= show_memory(out, weighed, at)
    return 0 if sound and apart <= TOLERANCE else 1


def show_speeds(out: Console, title: str, lines: Mapping[str, Line], sizes: Sequence[int]) -> None:
    columns = (*(f"n = {n:,}" for n in sizes), "largest difference")
    shown = table(f"\n{title}: million robot-steps a second", "contestant", "version", *columns)
    others: list[str] = []
    for name, line in lines.items():
        rates = [line.rate(n) for n in sizes]
        if any(rates):
            cells = (f"{rate:.3g}" if rate else "" for rate in rates)
            shown.add_row(name, line.one.peer.version, *cells, f"{line.apart:.0e}")
        others += [f"{name}: {word}" for word in line.words()]
    out.print(shown)
    say(out, others)


def show_ratios(out: Console, lines: dict[Entrant, Line], sizes: Sequence[int]) -> None:
    """Print what is asked of ours, and how every contestant stands to the limit."""
    n = JUDGED if JUDGED in sizes else sizes[-1]
    columns = ("of C, AVX2", "pinmobile is as fast, times", "asked, at least")
    shown = table(f"\nRatios at n = {n:,}", "contestant", "version", *columns)
    for one, line in sorted(lines.items(), key=lambda pair: -(pair[1].rate(n) or 0.0)):
        if line.rate(n):
            cells = times_as_fast(line, lines.get(LIMIT), n), times_as_fast(lines.get(OURS), line, n)
            shown.add_row(one.name, one.peer.version, *cells, f"{ASKED[one]:g}" if one in ASKED else "")
    out.print(shown)


def times_as_fast(line: Line | None, base: Line | None, n: int) -> str:
    """Return the ratio of two rates, round by round where both had the same rounds of the same work."""
    rates = [one.rate(n) if one else None for one in (line, base)]
    if not all(rates):
        return ""
    mine, others = line.rows[n], base.rows[n]
    alike = line.fleets[n].steps == base.fleets[n].steps and len(mine.times) == len(others.times)
    ratio = others.ratio(mine) if alike else rates[0] / rates[1]
    return f"{ratio:,.0f}" if ratio >= 100 else f"{ratio:.3g}"


def show_growth(out: Console, lines: Sequence[Line], sizes: Sequence[int], rounds: int) -> None:
    """Print what a robot-step takes in the largest ensembles, measured anew and in turn."""
    sizes = sizes[-2:]
    found = [line.one for line in lines if line.one in (OURS, LIMIT) and all(map(line.rate, sizes))]
    if not found:
        return
    fleets = {(one, n): one.fleet_of(n) for one in found for n in sizes}
    runs = {key: key[0].prepare(fleet) for key, fleet in fleets.items()}
    with out.status(f"timing {' and '.join(f'{n:,}' for n in sizes)} robots in turn"):
        turns = {key: (lambda run=run: median_time(lambda: timed(run)[0], 0.2)) for key, run in runs.items()}
        times = interleaved(turns, min(rounds, 5))
    rows = {
        key: Row("", times=[seconds / fleets[key].steps * 1e9 for seconds in taken])
        for key, taken in times.items()
    }
    columns = (*(f"n = {n:,}, ns" for n in sizes), "ratio")
    shown = table("\nOne robot-step", "contestant", "version", *columns)
    for one in found:
        few, many = (rows[one, n] for n in sizes)
        cells = (f"{few.median:.2f}", f"{many.median:.2f}", f"{many.ratio(few):.2f}")
        shown.add_row(one.name, one.peer.version, *cells)
    out.print(shown)


if __name__ == "__main__":
    sys.exit(main())
