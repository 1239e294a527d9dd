"""Ensembles side by side: `ensemble` against C by hand and the peers, each checked, then timed.

Usage: python benchmarks/ensembles.py [--quick] [--rounds N] [--only WORD ...]

The work is in `fleet.py`, who takes part in `ensemble_contestants/__init__.py`. One whose figures are not
the expected ones is printed as WRONG and not timed; one that would take too long is left out, and named.
"""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from time import perf_counter

from ensemble_contestants import EVERYONE, LIMIT, MUJOCO_CLOSED, MUJOCO_OPEN, OURS, Entrant
from ensemble_costs import measure, show_first_calls, show_memory
from fleet import LECTURE, Figures, Fleet, Run, difference, simulated
from measuring import Row, about, console, interleaved, median_time, options, say, table
from rich.console import Console
from task import TOLERANCE

SIZES, QUICK_SIZES = (1, 100, 10_000, 1_000_000), (1, 100, 1_000)
JUDGED = 10_000  # robots, for the ratios that are asked for
LONGEST, QUICK_LONGEST = 12.0, 1.0  # a turn [s]
ONCE = 0.25  # of that: who takes longer has one turn, in which it is checked
PART = 0.1  # of the rollout, for those to whom all of it is too long
ASKED = {LIMIT: 0.5, MUJOCO_OPEN: 100, MUJOCO_CLOSED: 100}  # times as fast


@dataclass
class Line:
    """One contestant's rows and the work in them, by number of robots, and its largest difference."""

    one: Entrant
    rows: dict[int, Row] = field(default_factory=dict)
    fleets: dict[int, Fleet] = field(default_factory=dict)
    apart: float = 0.0

    @property
    def out(self) -> bool:
        """Whether it is missing, has failed or was wrong."""
        return any(row.word and not row.word.startswith("left out") for row in self.rows.values())

    def rate(self, n: int) -> float | None:
        """Return the robot-steps in a second, in millions."""
        row = self.rows.get(n)
        return self.fleets[n].steps / row.median / 1e6 if row and row.times else None

    def estimate(self, fleet: Fleet) -> float:
        """Return what a turn will take [s], by the largest ensemble so far that is not overhead alone."""
        known = [rate for n in self.rows if n >= 100 and (rate := self.rate(n))]
        return fleet.steps / known[-1] / 1e6 if known else 0.0

    def words(self) -> Iterator[str]:
        """Return what is to be said of it under the table."""
        timed = any(row.times for row in self.rows.values())
        if timed and self.one.easier:
            yield f"easier work: {self.one.easier}"
        parts = [f"{n:,}" for n, fleet in self.fleets.items() if fleet.task != LECTURE]
        if parts:
            yield f"n = {' and '.join(parts)}: the first {PART:.0%} of the steps"
        for n, row in self.rows.items():
            if row.word:
                yield f"n = {n:,}: {row.word}" if timed else row.word


def main(arguments: Sequence[str] | None = None) -> int:
    parser = options(__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="*", default=[], metavar="WORD", help="those with it in their name")
    parser.add_argument("--one", help="weigh this contestant in this process, and print JSON")
    parser.add_argument("--robots", type=int, default=1, help="how many with --one")
    parser.add_argument(
        "--duration", type=float, default=LECTURE.duration, help="of the rollout with --one [s]"
    )
    chosen = parser.parse_args(arguments)
    if chosen.one is not None:
        one = next(one for one in EVERYONE if one.name == chosen.one)
        print(measure(one, one.fleet_of(chosen.robots, chosen.duration)))
        return 0
    rounds = chosen.rounds or (1 if chosen.quick else 5)
    words = [word.lower() for word in chosen.only]
    people = [c for c in EVERYONE if not words or any(word in c.name.lower() for word in words)]
    sizes = QUICK_SIZES if chosen.quick else SIZES
    out = console()
    out.print(about(), f"medians over {rounds} interleaved rounds", sep="; ")
    reference = Fleet(2)
    apart = difference(simulated(reference), reference)
    say(out, [f"what is expected of two robots is what `simulate` returns, to {apart:.0e}"])
    longest, least = (QUICK_LONGEST, 0.0) if chosen.quick else (LONGEST, 0.1)
    lines, sound = race(people, sizes, rounds, longest, least, note=out.status)
    show_speeds(out, lines, sizes)
    show_ratios(out, {line.one: line for line in lines}, sizes)
    show_growth(out, lines, sizes, rounds)
    weighed = [(line.one, line.fleets) for line in lines if line.fleets]
    sound &= show_memory(out, weighed[: 2 if chosen.quick else None], sizes[-2:])
    if OURS in people:
        sound &= show_first_calls(out, chosen.quick)
    return 0 if sound and apart <= TOLERANCE else 1


def show_speeds(out: Console, lines: Sequence[Line], sizes: Sequence[int]) -> None:
    title = "\nEnsembles of n robots, 600 steps each: million robot-steps a second"
    columns = (*(f"n = {n:,}" for n in sizes), "largest difference")
    shown, others = table(title, "contestant", "version", *columns), []
    for line in lines:
        rates = [line.rate(n) for n in sizes]
        if any(rates):
            cells = (f"{rate:.3g}" if rate else "" for rate in rates)
            shown.add_row(line.one.name, line.one.peer.version, *cells, f"{line.apart:.0e}")
        others += [f"{line.one.name}: {word}" for word in line.words()]
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
    return f"{others.ratio(mine) if alike else rates[0] / rates[1]:.3g}"


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


def race(
    people: Sequence[Entrant],
    sizes: Sequence[int],
    rounds: int,
    longest: float = LONGEST,
    least: float = 0.0,
    note: Callable[[str], AbstractContextManager[object]] = nullcontext,
) -> tuple[list[Line], bool]:
    """Check all at each size, then time those who are right.

    Parameters
    ----------
    people : sequence of Entrant
        Who takes part.
    sizes : sequence of int
        Numbers of robots, in ascending order.
    rounds : int
        In each, all take one turn, but for those who take longer than `ONCE` of `longest`.
    longest : float
        A turn [s]; who would take longer, by the size before, does a part of the steps, or is left out.
    least : float
        Length of a turn [s]; shorter ones are repeated, and their median counts.
    note : callable
        Makes a context in which a word on what is going on is shown.

    Returns
    -------
    lines : list of Line
        `times` [s] of a row is empty where a contestant is missing, fails, is wrong or left out; `word` says
        so.
    sound : bool
        Whether all who are installed are right.
    """
    lines = [Line(one) for one in people]
    for n in sizes:
        turns = {}
        for line in (line for line in lines if not line.out):
            with note(f"checking {line.one.name}, n = {n:,}"):
                run = enter(line, n, longest)
            if run:
                turns[line.one.name] = lambda run=run: median_time(lambda: timed(run)[0], least)
        with note(f"timing {len(turns)} contestants, n = {n:,}, {rounds} rounds"):
            times = interleaved(turns, rounds)
        for line in lines:
            if line.one.name in times:
                line.rows[n].times = times[line.one.name]
    return lines, not any(line.out and line.one.peer.installed for line in lines)


def enter(line: Line, n: int, longest: float) -> Run | None:
    """Add the row for n robots; return what is to be timed, if it is right and not timed already."""
    row = line.rows[n] = Row(line.one.name)
    if not line.one.peer.installed:
        row.word = f"not installed: {line.one.peer.install}"
        return None
    fleets = (line.one.fleet_of(n, part * LECTURE.duration) for part in (1, PART))
    fleet = next((fleet for fleet in fleets if line.estimate(fleet) <= longest), None)
    if fleet is None:
        row.word = f"left out: about {line.estimate(line.one.fleet_of(n)):.0f} s a turn"
        return None
    try:
        run = line.one.prepare(fleet)
        took, figures = timed(run)
        apart = difference(figures, fleet)
    except Exception as error:  # whatever a peer raises: the others go on
        row.word = f"FAILED: {type(error).__name__}: {error}"
        return None
    if not apart <= TOLERANCE:
        row.word = f"WRONG, not timed: off by {apart:.1e}"
        return None
    line.apart, line.fleets[n] = max(line.apart, apart), fleet
    if took <= ONCE * longest:
        return run
    row.times = [took]
    return None


def timed(run: Run) -> tuple[float, Figures]:
    """Return what a run takes [s], and its figures."""
    start = perf_counter()
    figures = run()
    return perf_counter() - start, figures


if __name__ == "__main__":
    sys.exit(main())
