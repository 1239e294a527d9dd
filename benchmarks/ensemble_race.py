"""The race of the ensembles: who takes part is checked at each size, then timed in turn with the others."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

from ensemble_contestants import Entrant
from fleet import Figures, Run
from measuring import Row, interleaved, median_time
from task import TOLERANCE

ONCE = 0.2  # of the longest turn: who takes longer has one, in which it is checked
PART = 0.1  # of the rollout, for those to whom all of it is too long


@dataclass
class Line:
    """One contestant's rows and the work in them, by number of robots, and its largest difference."""

    one: Entrant
    rows: dict[int, Row] = field(default_factory=dict)
    fleets: dict[int, Any] = field(default_factory=dict)
    apart: float = 0.0

    @property
    def out(self) -> bool:
        """Whether it is missing, has failed or was wrong."""
        return any(row.word and not row.word.startswith("left out") for row in self.rows.values())

    def rate(self, n: int) -> float | None:
        """Return the robot-steps in a second, in millions."""
        row = self.rows.get(n)
        return self.fleets[n].steps / row.median / 1e6 if row and row.times else None

    def estimate(self, fleet: Any) -> float:
        """Return what a turn will take [s], by the largest ensemble so far that is not overhead alone."""
        known = [rate for n in self.rows if n >= 100 and (rate := self.rate(n))]
        return fleet.steps / known[-1] / 1e6 if known else 0.0

    def words(self) -> Iterator[str]:
        """Return what is to be said of it under the table."""
        timed = any(row.times for row in self.rows.values())
        if timed and self.one.easier:
            yield f"easier work: {self.one.easier}"
        parts = [f"{n:,}" for n, fleet in self.fleets.items() if fleet != self.one.work(n)]
        if parts:
            yield f"n = {' and '.join(parts)}: the first {PART:.0%} of the steps"
        for n, row in self.rows.items():
            if row.word:
                yield f"n = {n:,}: {row.word}" if timed else row.word


def race(
    people: Sequence[Entrant],
    sizes: Sequence[int],
    rounds: int,
    longest: float,
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
    fleets = (line.one.work(n, part) for part in (1, PART))
    fleet = next((fleet for fleet in fleets if line.estimate(fleet) <= longest), None)
    if fleet is None:
        row.word = f"left out: about {line.estimate(line.one.work(n)):.0f} s a turn"
        return None
    try:
        run = line.one.prepare(fleet)
        took, figures = timed(run)
        apart = line.one.apart(figures, fleet)
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
