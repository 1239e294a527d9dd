"""Turns in rounds, so that the noise of a shared machine hits all alike, and the tables they end in."""

import argparse
import gc
import os
import platform
import re
import statistics
import subprocess
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, Protocol, TypeVar

from rich.console import Console
from rich.table import Table

Turn = Callable[[], float]
VECTORS = {"avx512f": "AVX-512", "avx2": "AVX2", "avx": "AVX", "sse2": "SSE2", "asimd": "NEON"}


class Named(Protocol):
    """Who takes part."""

    @property
    def name(self) -> str:
        """What its row is called."""


Someone = TypeVar("Someone", bound=Named)


@dataclass
class Row:
    """One line of a table: a name with its version, its numbers, or a word on why there are none."""

    name: str
    version: str = ""
    word: str = ""
    times: list[float] = field(default_factory=list)

    @property
    def median(self) -> float:
        """Median over the rounds."""
        return statistics.median(self.times)

    def ratio(self, base: "Row") -> float:
        """Return the median over the rounds of what this took of the base, round by round."""
        return statistics.median(mine / theirs for mine, theirs in zip(self.times, base.times, strict=True))


def interleaved(turns: Mapping[str, Turn], rounds: int) -> dict[str, list[float]]:
    """Return what each turn measured in each round; all take their turn in every round."""
    measured: dict[str, list[float]] = {name: [] for name in turns}
    for _ in range(rounds):
        for name, turn in turns.items():
            gc.collect()
            measured[name].append(turn())
    return measured


def median_time(work: Callable[[], float | None], least: float) -> float:
    """Return the median time of `work`, repeated for `least` seconds; what times itself returns its time."""
    times: list[float] = []
    while not times or sum(times) < least:
        start = perf_counter()
        own = work()
        times.append(perf_counter() - start if own is None else own)
    return statistics.median(times)


def processor_seconds(work: Callable[[], Any]) -> float:
    """Return the seconds of the processor that `work` takes: other work on the machine counts less."""
    start = process_time()
    work()
    return process_time() - start


def last_line(command: Sequence[str], **environment: str) -> str:
    """Return the last line that a process prints, or a word on why it failed, which begins with FAILED."""
    around = {**os.environ, **environment}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=around)
    if done.returncode:
        return f"FAILED: {(done.stderr.strip().splitlines() or [f'exit {done.returncode}'])[-1]}"
    return done.stdout.splitlines()[-1]


def options(description: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--quick", action="store_true", help="smoke run: one round, short rollouts")
    parser.add_argument("--rounds", type=int, help="rounds in which all take a turn")
    return parser


def selecting(description: str) -> argparse.ArgumentParser:
    """Return the options of what races contestants: some may be picked."""
    parser = options(description)
    parser.add_argument("--only", nargs="+", default=[], metavar="WORD", help="those with it in their name")
    return parser


def picked(people: Iterable[Someone], words: Sequence[str]) -> list[Someone]:
    """Return those who have one of the words in their name, in any case; all where there are no words."""
    wanted = [word.lower() for word in words]
    return [one for one in people if not wanted or any(word in one.name.lower() for word in wanted)]


def console() -> Console:
    """Return a console that does not fold tables where the output is a file or a pipe."""
    folded = Console(highlight=False)
    return folded if folded.is_terminal else Console(highlight=False, width=120)


def table(title: str, *columns: str) -> Table:
    """Return an empty table: names to the left, numbers to the right."""
    made = Table(
        title=title, title_justify="left", title_style="bold", box=None, pad_edge=False, padding=(0, 2)
    )
    for k, column in enumerate(columns):
        made.add_column(column, justify="left" if k < 2 else "right", no_wrap=k < 2)
    return made


def say(out: Console, lines: Iterable[str]) -> None:
    """Print under a table what is to be known of it, such as why rows are missing."""
    for line in lines:
        out.print(f"- {line}", markup=False)


def about() -> str:
    """Return what the numbers were measured on."""
    machine = f"{platform.machine()}{vectors() and ' with ' + vectors()}"
    return f"Python {platform.python_version()}, {machine}, {os.cpu_count()} processors"


def vectors() -> str:
    """Return the processor's widest vectors, where the system tells."""
    told = Path("/proc/cpuinfo")
    flags = set(re.findall(r"\w+", told.read_text())) if told.exists() else set()
    return next((name for flag, name in VECTORS.items() if flag in flags), "")
