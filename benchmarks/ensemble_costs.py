"""What an ensemble costs besides time: memory, each in a fresh process."""

import json
import sys
from argparse import ArgumentParser
from collections.abc import Mapping, Sequence
from pathlib import Path

from ensemble_contestants import Entrant
from fleet import Fleet
from measuring import last_line, say, selecting, table
from rich.console import Console

from memory import resident


def show_memory(
    out: Console,
    weighed: Sequence[tuple[Entrant, Mapping[int, Fleet]]],
    sizes: Sequence[int],
    program: str = "ensembles.py",
) -> bool:
    """Print the peaks of each contestant at its sizes; return whether all could be weighed."""
    columns = (f"{what}, n = {n:,}" for n in sizes for what in ("peak", "run"))
    title = "\nPeak resident memory of the process, and what of it the run added, MiB"
    shown, failed = table(title, "contestant", "version", *columns), []
    for one, fleets in weighed:
        cells: list[str] = []
        for n in sizes:
            with out.status(f"weighing {one.name}, n = {n:,}"):
                found = in_fresh_process(one, fleets[n], program) if n in fleets else ("", "")
            if isinstance(found, str):
                failed.append(f"{one.name}, n = {n:,}: {found}")
                found = ("", "")
            cells += found
        if any(cells):
            shown.add_row(one.name, one.peer.version, *cells)
    out.print(shown)
    say(out, failed)
    return not failed


def in_fresh_process(one: Entrant, fleet: Fleet, program: str) -> tuple[str, str] | str:
    """Return the cells of a contestant, or the word on why there are none."""
    work = ("--robots", str(fleet.n), "--duration", str(fleet.task.duration))
    command = [sys.executable, str(Path(__file__).with_name(program)), "--one", one.name, *work]
    said = last_line(command)
    if said.startswith("FAILED"):
        return said
    before, peak = json.loads(said)
    return f"{peak:.0f}", f"{peak - before:.0f}"


def weighing(description: str) -> ArgumentParser:
    """Return the options, with those of a process that weighs one contestant."""
    parser = selecting(description)
    parser.add_argument("--one", help="weigh this contestant in this process, and print JSON")
    parser.add_argument("--robots", type=int, default=1, help="how many with --one")
    parser.add_argument("--duration", type=float, help="of the rollout with --one [s]")
    return parser


def measure(one: Entrant, fleet: Fleet) -> str:
    """Return resident memory before the run and at its peak [MiB], as JSON."""
    run = one.prepare(fleet)
    before = resident("VmRSS")
    run()
    return f"\n{json.dumps([before, resident('VmHWM')])}"
