"""What an ensemble costs besides time: memory, and the wait for its first call, each in a fresh process."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from ensemble_contestants import OURS, Entrant
from fleet import Fleet
from measuring import say, table
from rich.console import Console

from memory import resident

LIMITS = {"compiled, nothing cached": 15.0, "cached": 2.0}  # [s]
FIRST = """
from time import perf_counter as now
start = now()
from pinmobile import Circle, ComputedTorque, MobileRobot, Normal, Tangent, Uniform, ensemble
import pinmobile
imported, com = now(), "com.x" if hasattr(pinmobile, "parts") else "com_x"  # before parts, names had no dot
robot = MobileRobot(30.0, 1.3, com=(0.1, 0.0))
spread = {"mass": Uniform(20, 40), com: Normal(0.1, 0.02)}
trajectory = Tangent(Circle(3.0, 0.1, 60.0))
ensemble(robot, ComputedTorque(robot, 4, 4), trajectory, n=100, spread=spread, seed=0, dt=0.1)
print("\\n", imported - start, now() - imported)
"""


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
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        return f"FAILED: {(done.stderr.strip().splitlines() or [f'exit {done.returncode}'])[-1]}"
    before, peak = json.loads(done.stdout.splitlines()[-1])
    return f"{peak:.0f}", f"{peak - before:.0f}"


def measure(one: Entrant, fleet: Fleet) -> str:
    """Return resident memory before the run and at its peak [MiB], as JSON."""
    run = one.prepare(fleet)
    before = resident("VmRSS")
    run()
    return f"\n{json.dumps([before, resident('VmHWM')])}"


def show_first_calls(out: Console, quick: bool) -> bool:
    """Print what the first ensemble in a process takes, with an empty cache and with a filled one."""
    if quick or not OURS.peer.installed:
        say(out, [f"first call: {'left out of a smoke run' if quick else 'not installed'}"])
        return True
    columns = ("import, s", "call, s", "together, s", "limit")
    shown = table("\nFirst ensemble of a process, 100 robots", "code", "", *columns)
    with tempfile.TemporaryDirectory(prefix="pinmobile-") as cache:
        for name, limit in LIMITS.items():
            with out.status(name):
                times = first_call(cache)
            if isinstance(times, str):
                say(out, [f"first call, {name}: {times}"])
                return False
            shown.add_row(name, "", *(f"{seconds:.2f}" for seconds in (*times, sum(times))), f"{limit:g}")
    out.print(shown)
    return True


def first_call(cache: str, interpreter: Sequence[str] = (sys.executable,)) -> tuple[float, float] | str:
    """Return the import's and the call's time [s] in a fresh process, or the word on why it failed."""
    command = [*interpreter, "-W", "ignore", "-c", FIRST]
    # An older version's compiler keeps its files by the second name.
    environment = {**os.environ, "PINMOBILE_CACHE": cache, "NUMBA_CACHE_DIR": cache}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    if done.returncode:
        return f"FAILED: {(done.stderr.strip().splitlines() or [f'exit {done.returncode}'])[-1]}"
    imported, called = done.stdout.split()[-2:]
    return float(imported), float(called)
