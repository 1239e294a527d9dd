"""One call from Python side by side: M(q), n(q, v), inverse and forward dynamics, of each peer.

Usage: python benchmarks/calls.py [--quick] [--rounds N] [--only WORD ...]

The centre of mass is off the axis. What a call returns is compared with the closed form before it is timed;
a call includes handing over the state, since engines that keep it are no use without.
"""

import statistics
import sys
from collections.abc import Callable, Sequence
from timeit import Timer

import numpy as np
from contestants import MUJOCO, NUMPY, PINMOBILE, PYTHON, TOOLBOX, Contestant
from measuring import about, console, interleaved, picked, say, selecting, table
from task import TOLERANCE, Body, forward_dynamics, mass_matrix, nonlinear_effects

BODY = Body(com=(0.1, 0.05))
Q, V, A = np.array([0.3, -0.2, 0.7]), np.array([0.4, 0.1, 0.5]), np.array([0.2, -0.3, 0.6])
FORCE = np.array([1.0, 2.0, 3.0])
GIVEN = {"M": (Q,), "n": (Q, V), "inverse": (Q, V, A), "forward": (Q, V, FORCE)}
RIGHT = {
    "M": mass_matrix(BODY, Q),
    "n": nonlinear_effects(BODY, Q, V),
    "inverse": mass_matrix(BODY, Q) @ A + nonlinear_effects(BODY, Q, V),
    "forward": forward_dynamics(BODY, Q, V, FORCE),
}
EVERYONE = (
    Contestant("pinmobile", PINMOBILE, "of_pinmobile"),
    Contestant("Pinocchio", PYTHON, "raw_pinocchio"),
    Contestant("closed form in numpy", NUMPY, "closed_form"),
    Contestant("MuJoCo", MUJOCO, "of_mujoco"),
    Contestant("Robotics Toolbox", TOOLBOX, "of_toolbox"),
)


def main(arguments: Sequence[str] | None = None) -> int:
    chosen = selecting(__doc__.splitlines()[0]).parse_args(arguments)
    rounds = chosen.rounds or (1 if chosen.quick else 9)
    people = picked(EVERYONE, chosen.only)
    number = 100 if chosen.quick else 5_000
    out = console()
    out.print(about(), f"medians over {rounds} interleaved rounds of {number} calls", sep="; ")
    with out.status("calling"):
        found = {one.name: calls_of(one) for one in people}
        turns = {
            (name, call): (lambda timer=timer: timer.timeit(number) / number * 1e6)
            for name, row in found.items()
            for call, timer in row.items()
            if isinstance(timer, Timer)
        }
        times = interleaved(turns, rounds)
    shown, others = table("\nOne call from Python, us", "library", "version", *GIVEN), []
    for one in people:
        row = found[one.name]
        if not row:
            others.append(f"{one.name}: not installed: {one.peer.install}")
            continue
        cells = [
            f"{statistics.median(times[one.name, call]):.2f}" if isinstance(what, Timer) else what
            for call, what in row.items()
        ]
        shown.add_row(one.name, one.peer.version, *cells)
    out.print(shown)
    say(out, others)
    return 0


def calls_of(one: Contestant) -> dict[str, Timer | str]:
    """Return for each call what times it, or the word in its place; nothing for who is not there."""
    if not one.peer.installed:
        return {}
    calls = one.calls(BODY)
    return {name: cell(calls.get(name), name) for name in GIVEN}


def cell(call: Callable[..., object] | None, name: str) -> Timer | str:
    """Return what times the call, or why it is not timed."""
    if call is None:
        return "none"
    given, right = GIVEN[name], RIGHT[name]
    apart = np.max(np.abs(np.asarray(call(*given)) - right)) / np.max(np.abs(right))
    if not apart <= TOLERANCE:
        return "WRONG"
    return Timer("call(*given)", globals={"call": call, "given": given})


if __name__ == "__main__":
    sys.exit(main())
