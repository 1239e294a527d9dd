"""One call from Python side by side: dynamics of each peer, and steps of inverse kinematics.

Usage: python benchmarks/calls.py [--quick] [--rounds N] [--only WORD ...]

The centre of mass is off the axis. What a call returns is compared with the closed form before it is timed;
a call includes handing over the state, since engines that keep it are no use without.

The tool of a UR5 follows random paths of 6 s in steps of 0.01 s, on a planar base and on two wheels, with the
same limits and the same posture: seconds of the processor per step, and the largest error at the steps.
Beside them pink (`pip install pin-pink`), and for two wheels a quadratic program per step by daqp.
"""

import statistics
import sys
from collections.abc import Callable, Sequence
from functools import partial
from importlib.util import find_spec
from timeit import Timer
from typing import Any

import numpy as np
import pinocchio as pin
from contestants import MUJOCO, NUMPY, PINMOBILE, PYTHON, TOOLBOX, Contestant
from measuring import about, console, interleaved, picked, processor_seconds, say, selecting, table
from task import TOLERANCE, Body, forward_dynamics, mass_matrix, nonlinear_effects

import pinmobile as pm
from pinmobile.reaching import pose_error

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
    show_inverse_kinematics(out, 2 if chosen.quick else 100)
    return 0


ARMED = pm.MobileRobot.box(mass=165.0).mount("ur5", at=(0.25, 0, 0.31, 0))
ROLLING = pm.WheeledRobot(ARMED, pm.WheelTable.differential(0.5, 0.1, mass=1.0, spin_inertia=0.01))
START, STEP, MOST = np.array([0, 0, 0, 0, -1.2, 1.6, -0.4, 1.57, 0]), 0.01, 10.0


def random_path(seed: int) -> pm.PosePath:
    """Return poses of the tool for an arc of the base and a motion of the arm."""
    generator = np.random.default_rng(seed)
    t, speed, turn = np.arange(4.0) * 2, generator.uniform(0.05, 0.25), generator.uniform(-0.2, 0.2)
    base = speed / turn * np.stack([np.sin(turn * t), 1 - np.cos(turn * t), turn**2 / speed * t], axis=-1)
    arm = START[3:] + np.cumsum(generator.uniform(-0.25, 0.25, (4, 6)) * (t > 0)[:, None], axis=0)
    return pm.PosePath.through(ARMED.frame_pose(np.hstack([base, arm])), t)


def solved(robot: Any, target: pm.PosePath, poses: np.ndarray) -> Any:
    """Return the steps of pinmobile."""
    motion = pm.solve_inverse_kinematics(robot, target, q0=START, dt=STEP, tolerance=np.inf)
    return motion(motion.t).q


def by_pink(target: pm.PosePath, poses: np.ndarray) -> Any:
    """Return the steps of pink."""
    import pink
    from pink import limits, tasks

    model, order = ARMED.model, [1, 0, *range(2, 9)]
    model.velocityLimit[:3] = 1e3
    tool, posture = tasks.FrameTask("ur5/tool0", 1.0, 1.0), tasks.PostureTask(cost=1e-2)
    slow = limits.AccelerationLimit(model, np.full(9, MOST))
    kept = [limits.ConfigurationLimit(model), limits.VelocityLimit(model), slow]
    now, found = pink.Configuration(model, model.createData(), START[order]), [START]
    posture.set_target(START[order])
    for pose in poses[1:]:
        tool.set_target(pin.SE3(pose))
        v = pink.solve_ik(now, [tool, posture], STEP, solver="daqp", limits=kept)
        slow.set_last_integration(v, STEP)
        now.integrate_inplace(v, STEP)
        found.append(now.q[order])
    return found


def by_program(target: pm.PosePath, poses: np.ndarray) -> Any:
    """Return the steps of one quadratic program each, in speed, yaw rate and the joints."""
    import daqp

    found, x, most = [START], np.zeros(8), STEP * ARMED.velocity_limit[1:]
    for pose in poses[1:]:
        q, J = found[-1], ARMED.frame_jacobian(found[-1])
        A = np.column_stack([J[:, :2] @ (np.cos(q[2]), np.sin(q[2])), J[:, 2:]])
        wish = 1e-4 * np.r_[0, 0, STEP * (START - q)[3:]]
        f = -A.T @ pose_error(pose, ARMED.frame_pose(q)) - wish
        least = np.maximum.reduce([x - MOST * STEP**2, -most, ARMED.lower[1:] - q[1:]])
        limit = np.minimum.reduce([x + MOST * STEP**2, most, ARMED.upper[1:] - q[1:]])
        none, free = np.zeros((0, 8)), np.zeros(8, np.int32)
        x = daqp.solve(A.T @ A + 1e-4 * np.eye(8), f, none, limit, least, free)[0]
        half = q[2] + x[1] / 2
        found.append(q + np.r_[np.cos(half) * x[0], np.sin(half) * x[0], x[1:]])
    return found


SOLVERS: dict[str, tuple[Callable[..., Any], str]] = {
    "planar base: pinmobile": (partial(solved, ARMED), "pinmobile"),
    "planar base: pink": (by_pink, "pink"),
    "two wheels: pinmobile": (partial(solved, ROLLING), "pinmobile"),
    "two wheels: a program per step": (by_program, "daqp"),
}


def show_inverse_kinematics(out: Any, count: int) -> None:
    """Print the table of the solvers that are installed."""
    names = [name for name, (_, needs) in SOLVERS.items() if find_spec(needs) is not None]
    found = np.array([[step(name, random_path(k)) for name in names] for k in range(count)])
    shown = table(
        f"\nA step on {count} paths", "solver", "", "us", "mm, median", "mm, largest", "mrad, largest"
    )
    for name, (us, mm, mrad) in zip(names, np.moveaxis(found, 0, -1), strict=True):
        told = np.median(us), np.median(mm), mm.max(), mrad.max()
        shown.add_row(name, "", *(f"{x:.3g}" for x in told))
    out.print(shown)


def step(name: str, target: pm.PosePath) -> tuple[float, float, float]:
    """Return what a step takes [us], and the largest errors at the steps [mm, mrad]."""
    poses, kept = target(np.linspace(0, target.duration, round(target.duration / STEP) + 1)).pose, list[Any]()
    seconds = processor_seconds(lambda: kept.append(SOLVERS[name][0](target, poses)))
    error = pose_error(poses, ARMED.frame_pose(np.array(kept[0]))).reshape(-1, 2, 3)
    way, turn = 1e3 * np.linalg.norm(error, axis=-1).max(axis=0)
    return 1e6 * seconds / (len(poses) - 1), float(way), float(turn)


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
