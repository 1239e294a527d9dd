"""Peak memory of the 60,001-sample rollout of each contestant, each in a process of its own.

Usage: python benchmarks/memory.py [--quick] [--only WORD ...]

The peak counts everything in the process: interpreter, libraries, model, rollout. What was there before the
rollout stands beside it, so the difference is the rollout's; its log alone is 6.9 MiB.
"""

import json
import re
import resource
import sys
from collections.abc import Sequence
from pathlib import Path

from contestants import EVERYONE, Contestant
from measuring import about, console, last_line, picked, say, selecting, table
from task import Task


def main(arguments: Sequence[str] | None = None) -> int:
    parser = selecting(__doc__.splitlines()[0])
    parser.add_argument("--one", help="measure this contestant in this process, and print JSON")
    chosen = parser.parse_args(arguments)
    task = Task(0.001, duration=3.0 if chosen.quick else 60.0)
    if chosen.one is not None:
        print("\n" + json.dumps(measure(next(one for one in EVERYONE if one.name == chosen.one), task)))
        return 0
    out = console()
    out.print(about())
    columns = ("contestant", "version", "before, MiB", "peak, MiB", "of the rollout, MiB")
    shown = table(f"\nPeak resident memory, dt = {task.dt} s, {task.samples:,} samples", *columns)
    others = []
    for one in picked(EVERYONE, chosen.only):
        with out.status(one.name):
            cells = cells_of(one, chosen.quick)
        if isinstance(cells, str):
            others.append(f"{one.name}: {cells}")
        else:
            shown.add_row(one.name, one.peer.version, *cells)
    out.print(shown)
    say(out, others)
    return 0


def cells_of(one: Contestant, quick: bool) -> tuple[str, ...] | str:
    """Return the numbers of a row, or the word on why there are none."""
    if not one.peer.installed:
        return f"not installed: {one.peer.install}"
    said = last_line([sys.executable, __file__, "--one", one.name, *["--quick"] * quick])
    if said.startswith("FAILED"):
        return said
    before, peak = json.loads(said)
    if before is None:
        return "", f"{peak:.0f}", ""
    return f"{before:.0f}", f"{peak:.0f}", f"{peak - before:.0f}"


def measure(one: Contestant, task: Task) -> tuple[float | None, float]:
    """Return resident memory before the rollout and at its peak [MiB]; another program says only the peak."""
    run = one.prepare(task)
    before = resident("VmRSS")
    log = run()
    return (before, resident("VmHWM")) if log.peak is None else (None, log.peak)


def resident(what: str) -> float:
    """Return the resident memory of this process now (VmRSS) or at its peak (VmHWM) [MiB]."""
    status = Path("/proc/self/status")
    if status.exists():
        return int(re.search(rf"{what}:\s*(\d+)", status.read_text())[1]) / 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # without /proc there is the peak alone
    return peak / 1024 / (1024 if sys.platform == "darwin" else 1)


if __name__ == "__main__":
    sys.exit(main())
