"""Gradients of closed loops: their cost in rollouts, and what is built first, beside JAX and CasADi.

OPENBLAS_NUM_THREADS=1 python benchmarks/derivatives.py [--quick] [--rounds N]

A rollout is a run of the loop's machine code without derivatives, 2 s at 1 ms (wheels: 401 samples). JAX and
CasADi have the same loops, written in `gradient_loops.py`; who is off by more than 1e-9 of the largest entry
is not timed. All times are of the processor, to which waiting threads of linear algebra would add.
"""

import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any
from unittest import mock

import numpy as np
from gradient_loops import ARM, BODY, MAKERS, PEERS, Case, cases, chain, loss
from measuring import Row, about, console, interleaved, median_time, options, processor_seconds, say, table

import pinmobile as pm
from pinmobile.compiled import program as compiled_program
from pinmobile.derivatives import _gradient, _problem, poles, tune
from pinmobile.derivatives._poles import _PROBE, _eigenvalues, _Inputs, _linearize, _Probe

TOLERANCE, STEP, SPREAD = 1e-9, 1e-5, {"mass": pm.Uniform(27, 33)}


def forgotten(folder: bool = False) -> None:
    """Forget the machine code of this process, and that of its folder too."""
    _problem._machines.clear()
    compiled_program._functions.clear()
    for file in os.scandir(os.environ["PINMOBILE_CACHE"]) if folder else ():
        os.unlink(file)


def place(problem: Any) -> int:
    """Return the index of the loss in the states."""
    return next(int(leaf.first) for leaf in problem.machine.tape.leaves if leaf.owner == "recorder")


def differences(problem: Any, inputs: Any, directions: Any, at: int) -> Any:
    """Return central differences by runs one after the other."""
    found = np.empty(len(directions))
    for p, one in enumerate(directions):
        rows, ends = inputs.rows.copy(), []
        step = STEP * max(1.0, abs(rows[one.row, 0]))
        for h in (step, -2 * step):
            rows[one.row] += h
            ends.append(problem.plain(inputs._replace(rows=rows))[at, 0])
        found[p] = (ends[0] - ends[1]) / (2 * step)
    return found


def build_times(work: Callable[[], Any], rounds: int) -> tuple[list[float], list[float]]:
    """Return seconds with an empty folder of machine code, and with that of the first time."""
    times: tuple[list[float], list[float]] = [], []
    for _ in range(rounds):
        for is_known, into in enumerate(times):
            forgotten(folder=not is_known)
            into.append(processor_seconds(work))
    return times


def of_peers(case: Case, inputs: Any, values: Any, words: dict[str, str]) -> dict[str, tuple[float, Any]]:
    """Return the seconds to build and the gradient of each peer; words on those that are missing."""
    found: dict[str, tuple[float, Any]] = {}
    for name, peer in PEERS.items():
        if not case.law or not peer.installed:
            words[name] = "not written" if peer.installed else "not installed"
            continue
        joints = chain(ARM) if case.law == "arm" else ()
        start = np.append(inputs.states[: 18 if joints else 6, 0], 0.0)
        build, made = MAKERS[name](case.law, joints, case.dt, start, inputs.samples, values), list[Any]()
        seconds = processor_seconds(lambda build=build, made=made: made.append(build()))
        found[name] = seconds, made[0]
    return found


def measured(case: Case, rounds: int, least: float) -> tuple[list[str], list[str], bool]:
    """Return the cells of a case: costs in rollouts, and what is built; tell whether all agree."""
    mode = case.modes[-1]
    built = build_times(lambda: _gradient.evaluate_losses(case.problem(), {}, mode), rounds)
    problem = case.problem()
    exact = _gradient.evaluate_losses(problem, {}, mode)
    inputs, directions, at = exact.inputs, exact.directions, place(problem)
    words = {} if "reverse" in case.modes else {"reverse": "-"}
    peers = of_peers(case, inputs, np.array([inputs.rows[one.row, 0] for one in directions]), words)
    gradients: dict[str, Callable[[], Any]] = {
        "forward": lambda: problem.tangents(inputs, directions)[1][at, 0],
        "reverse": lambda: problem.adjoints(inputs, directions, [at])[1][0, 0],
        "central": lambda: differences(problem, inputs, directions, at),
        **{name: gradient for name, (_, gradient) in peers.items()},
    }
    scale, most, off = np.abs(exact.slopes).max(), 0.0, dict[str, float]()
    for name in [name for name in gradients if name not in words]:
        off[name] = float(np.abs(gradients[name]() - exact.slopes[0, 0]).max() / scale)
        if name != "central":
            most = max(most, off[name])
            if not off[name] <= TOLERANCE:
                words[name] = f"WRONG: {off[name]:.0e}"
    works = {name: gradient for name, gradient in gradients.items() if name not in words}
    works |= {"rollout": lambda: problem.plain(inputs)}
    works |= {"whole": lambda: _gradient.evaluate_losses(problem, {}, mode)}
    rows = timed(works, rounds, least)
    costs = {name: f"{row.ratio(rows['rollout']):,.3g}" for name, row in rows.items()} | words
    seconds = {name: f"{took:.2f}" for name, (took, _) in peers.items()}
    cells = [case.name, f"{problem.machine.tape.robot_size:,}", f"{1e3 * rows['rollout'].median:.2f}"]
    cells += [costs[name] for name in ("forward", "reverse", "whole", "central", *PEERS)]
    builds = [case.name, mode, *(f"{np.median(times):.2f}" for times in built)]
    builds += [*(seconds.get(name, words.get(name, "")) for name in PEERS)]
    sound = not any(word.startswith("WRONG") for word in words.values())
    apart = f"{most:.0e}" if len(off) > 2 else "-"
    return cells, [*builds, apart, f"{off['central']:.0e}"], sound


def timed(works: dict[str, Callable[[], Any]], rounds: int, least: float) -> dict[str, Row]:
    """Return seconds of the processor of each work, in rounds after a first time."""
    for work in works.values():
        work()
    turns = {
        name: partial(median_time, partial(processor_seconds, work), least) for name, work in works.items()
    }
    return {name: Row(name, times=times) for name, times in interleaved(turns, rounds).items()}


def of_ensemble(case: Case, rounds: int, least: float) -> list[str]:
    """Return the cells of the gradient of 64 robots with other masses, in ensembles."""
    problem = case.problem(n=64, spread=SPREAD)
    found = _gradient.evaluate_losses(problem, {}, "reverse")
    inputs, directions, at = found.inputs, found.directions, place(problem)
    works: dict[str, Callable[[], Any]] = {
        "plain": lambda: problem.plain(inputs),
        "forward": lambda: problem.tangents(inputs, directions)[1][at].mean(axis=0),
        "reverse": lambda: problem.adjoints(inputs, directions, [at])[1][0].mean(axis=0),
    }
    off = np.abs(works["forward"]() - works["reverse"]()).max() / np.abs(works["reverse"]()).max()
    rows = timed(works, rounds, least)
    ratios = [f"{rows[name].ratio(rows['plain']):.3g}" for name in ("forward", "reverse")]
    return [case.name, "", f"{1e3 * rows['plain'].median:.1f}", *ratios, f"{off:.0e}"]


def of_tuning(case: Case, rounds: int, **own: Any) -> list[str]:
    """Return the cells of tuning: iterations, losses, seconds the first time and with known code."""
    found: list[Any] = []

    def work() -> None:
        given = {"by": case.by, "q0": case.q0, "dt": case.dt, "progress": lambda trial: None}
        found[:] = [tune(loss, *case.parts, **given, **case.robot_size, **own)]

    seconds = (f"{np.median(times):.2f}" for times in build_times(work, rounds))
    trials, best = found[0].trials, found[0].best
    return [case.name, "", f"{len(trials)}", f"{trials[0].loss:.4g}", f"{best.loss:.4g}", *seconds]


def of_poles(rounds: int, least: float) -> list[str]:
    """Return the cells of the poles of a loop with delays along a run: states, and microseconds each."""
    law, rest = pm.MeasurementDelay(pm.PID(BODY), samples=3), pm.FixedHeading(pm.Hold((0, 0), 10.0), 0.0)
    parts, known = (BODY, _Probe(law, np.zeros(3)), rest), {"recorder": lambda _: _Inputs(), "by": [_PROBE]}
    problem = _problem.problem_of(*parts, dt=0.01, n=1, **known)
    indices, times = range(1, 1001), 0.01 * np.arange(1, 1001)
    works: dict[str, Callable[[], Any]] = {
        "matrix": lambda: _linearize(problem, indices, 1),
        "eigenvalues": lambda: [_eigenvalues(x[:, :states], 3) for x, _ in _linearize(problem, indices, 1)],
        "poles": lambda: poles(BODY, law, rest, dt=0.01, at=times),
        "one": lambda: poles(BODY, law, rest, dt=0.01),
    }
    states = len(problem.machine.tape.states)
    rows = timed(works, rounds, least)
    cells = [1e6 * row.median / (1 if name == "one" else len(times)) for name, row in rows.items()]
    return ["PID behind a delay", "", str(states), *(f"{cell:,.0f}" for cell in cells)]


def main(arguments: Sequence[str] | None = None) -> int:
    chosen = options(__doc__.splitlines()[0]).parse_args(arguments)
    rounds, least = chosen.rounds or (1 if chosen.quick else 7), 0.0 if chosen.quick else 0.02
    out, known, sound = console(), cases(), True
    out.print(about(), f"medians over {rounds} interleaved rounds", sep="; ")
    columns = "loop", "own", "ms", "forward", "reverse", "whole", "central", *PEERS
    costs = table("\nA gradient, in rollouts", *columns)
    columns = "loop", "mode", "first", "known", *PEERS, "apart", "central off"
    builds = table("\nBuilt before the first gradient, s", *columns)
    many = table("\n64 robots, in ensembles", "loop", "", "ensemble, ms", "forward", "reverse", "apart")
    tuned = table("\nTuning, s", "numbers", "", "trials", "loss", "to", "first", "known")
    columns = "loop", "", "states", "matrix", "+ eigenvalues", "poles()", "poles() of one sample"
    roots = table("\nPoles of each of 1,000 samples, us", *columns)
    with tempfile.TemporaryDirectory() as folder, mock.patch.dict(os.environ, PINMOBILE_CACHE=folder):
        _gradient.evaluate_losses(known["PD"].problem(), {}, "reverse")  # what a process starts once
        for case in known.values():
            with out.status(case.name):
                cells, built, agree = measured(case, rounds, least)
            costs.add_row(*cells)
            builds.add_row(*built)
            sound &= agree
        for name in ("PD", "com", "arm"):
            if name in known:
                many.add_row(*of_ensemble(known[name], rounds, least))
        most = 3 if chosen.quick else 100
        for name in ("arm", "policy"):
            if name in known:
                tuned.add_row(*of_tuning(known[name], min(rounds, 3), iterations=most))
        roots.add_row(*of_poles(rounds, least))
        forgotten()  # its folder is gone after this
    for shown in (costs, builds, many, tuned, roots):
        out.print(shown)
    notes = [
        "own: operations of a sample; ms: of a rollout",
        "whole: reverse (dry friction: forward) with what Python computes before it",
        "central: differences, one run after the other; off: from the exact ones, relative to the largest",
        "first, known: trace and machine code, with an empty folder and with the code in it; peers: once",
        "apart: largest difference between the exact gradients, relative to the largest entry",
        "-: dry friction is differentiated forward only; JAX: grad of scan, compiled; CasADi: interpreted",
    ]
    for name, peer in PEERS.items():
        notes.append(f"{name} {peer.version}" if peer.installed else f"{name}: not installed: {peer.install}")
    say(out, notes)
    return 0 if sound else 1


if __name__ == "__main__":
    sys.exit(main())
