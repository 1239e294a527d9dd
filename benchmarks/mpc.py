"""Model predictive control under limits: a call, and its start.

Usage: python benchmarks/mpc.py [--quick] [--rounds N] [--only WORD ...]

A body of 30 kg starts 0.58 m beside a circle and has 22 N and 3 N m to come to it: 40 steps of 0.05 s are
predicted at each of 600 samples. Bounds of states are soft: a corridor, and speeds. Of each: the median and
the 99th percentile of a call, in seconds of the processor (and of the clock, which a busy machine stretches),
how many calls a second the former allows, and the start along a reference of 10 s. Where it is
installed, crocoddyl's BoxFDDP on the nonlinear model too, of examples/nonlinear_mpc.py.
"""

import statistics
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np
from measuring import about, console, picked, say, selecting, table

import pinmobile as pm
from pinmobile.plant import Context

DT, STEPS, QUICK_STEPS = 0.01, 600, 60
ASKED = 500  # calls a second
ROBOT = pm.MobileRobot(mass=30.0, yaw_inertia=1.3, com=(0.1, 0.05))
CIRCLE = pm.Tangent(pm.Circle(radius=1.5, rate=0.6, duration=10.0))
START = CIRCLE(0.0).q + np.array([-0.3, -0.5, 0.4])
LIMITS = (22.0, 22.0, 3.0)
CORRIDOR = np.array([2.0, 3.0, np.inf, 1.1, 1.1, np.inf])
CLOSE = 20e-3  # [m], after which it counts as there
LATEST = 3.5  # [s], beyond which a controller does not do the work


def nonlinear() -> Any:
    """Return the controller of the example."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "examples"))
    try:
        from nonlinear_mpc import NonlinearMPC
    finally:
        sys.path.pop(0)
    return NonlinearMPC(ROBOT, LIMITS)


@dataclass(frozen=True)
class Contestant:
    """Who takes part, and what it needs."""

    name: str
    make: Callable[[], Any]
    needs: str = "daqp"


SOFT = partial(pm.MPC, ROBOT, limits=LIMITS, lower=-CORRIDOR, upper=CORRIDOR)
EVERYONE = (
    Contestant("MPC, limits of the input", partial(pm.MPC, ROBOT, limits=LIMITS)),
    Contestant("MPC, soft bounds of states too", SOFT),
    Contestant("crocoddyl, BoxFDDP, nonlinear", nonlinear, "crocoddyl"),
)


@dataclass(frozen=True)
class Calls:
    """What the calls of a run took [s], and when it was there."""

    start: float
    processor: Any
    clock: Any
    settled: float


def called(controller: Any, steps: int) -> Calls:
    """Return what each call takes along the circle, the body integrated beside it."""
    t = np.arange(round(CIRCLE.duration / DT) + 1) * DT
    reference = CIRCLE(t)
    begin = process_time()
    context = Context.of(ROBOT, dt=DT, t=t, reference=reference, trajectory=CIRCLE)
    state = controller.initial_state(context)
    started = process_time() - begin
    rows = [pm.Reference(*row) for row in zip(*reference, strict=True)]
    spent, off = np.empty((2, steps)), np.empty(steps)
    q, v = START, rows[0].v
    for k in range(steps):
        off[k] = np.hypot(*(q - rows[k].q)[:2])
        begun = process_time(), perf_counter()
        u, state = controller(t[k], q, v, rows[k], state)
        spent[:, k] = process_time() - begun[0], perf_counter() - begun[1]
        if hasattr(controller, "applied"):
            state = controller.applied(u, state)
        v = v + DT * ROBOT.forward_dynamics(q, v, u)
        q = q + DT * v
    far = np.flatnonzero(off > CLOSE)
    return Calls(started, *spent, settled=DT * (far[-1] + 1) if far.size else 0.0)


def show(out: Any, names: Sequence[Contestant], rounds: int, steps: int) -> bool:
    """Print the tables; tell whether all did the work."""
    shown = table(
        "\nA call, N = 40, three inputs",
        *("controller", "", "median, ms", "99 %, ms", "99 % by the clock, ms", "calls a second", "start, ms"),
        "within 20 mm, s",
    )
    others, sound = [], True
    if find_spec("daqp") is not None:  # what a process imports once is not of each start
        called(pm.MPC(ROBOT, horizon=1, limits=LIMITS), 1)
    for one in names:
        if find_spec(one.needs) is None:
            others.append(f"{one.name}: not installed: pip install {one.needs}")
            continue
        controller = one.make()
        first, *runs = [called(controller, steps) for _ in range(rounds + 1)]
        median, late, clock = (
            1e3 * statistics.median(np.quantile(getattr(run, which), share) for run in runs)
            for which, share in (("processor", 0.5), ("processor", 0.99), ("clock", 0.99))
        )
        there = runs[0].settled < LATEST or steps < STEPS  # a smoke run is too short
        sound &= there
        cells = (
            f"{median:.2f}",
            f"{late:.2f}",
            f"{clock:.2f}",
            f"{1e3 / late:,.0f}",
            f"{1e3 * first.start:.0f}",
        )
        shown.add_row(one.name, "" if there else "WRONG", *cells, f"{runs[0].settled:.2f}")
    out.print(shown)
    say(out, [f"asked: {ASKED} calls a second and more, of the slowest in a hundred", *others])
    return sound


def main(arguments: Sequence[str] | None = None) -> int:
    chosen = selecting(__doc__.splitlines()[0]).parse_args(arguments)
    rounds = chosen.rounds or (1 if chosen.quick else 5)
    steps = QUICK_STEPS if chosen.quick else STEPS
    out = console()
    out.print(about(), f"medians over {rounds} rounds", sep="; ")
    return 0 if show(out, picked(EVERYONE, chosen.only), rounds, steps) else 1


if __name__ == "__main__":
    sys.exit(main())
