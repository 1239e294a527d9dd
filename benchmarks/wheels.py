"""Robots on wheels: a step that rolls and one that slips beside the bare body, Pinocchio with KKT and MuJoCo.

Usage: python benchmarks/wheels.py [--quick] [--rounds N] [--only WORD ...]

A differential drive under constant torques, and a four-wheel base, alone and as ensembles. Seconds are those
of the processor, of all threads together, so that what else runs on the machine does not count; a machine
with k processors does k times as much in a second. Whoever ends elsewhere than `simulate` is not timed.
"""

import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import pinocchio as pin
from measuring import Row, about, console, interleaved, picked, processor_seconds, say, selecting, table
from rich.console import Console

import pinmobile as pm
from pinmobile.paths import Hold
from pinmobile.wheels import Coulomb, WheeledRobot, WheelFriction, WheelTable

DT, STEPS, QUICK_STEPS = 0.005, 400, 40
ROBOTS, QUICK_ROBOTS = 10_000, 100
FEW = 200  # robots of a peer that would take minutes for all; its rate does not depend on how many
TORQUES = (0.30, 0.25)  # right and left would turn alike without their difference [N m]
SAME, MUJOCO_SAME = 1e-9, 0.02  # of the path
WHEEL: dict[str, Any] = {"mass": 1.0, "spin_inertia": 0.01, "yaw_inertia": 0.006}
SUPPORTS = [(0.25, 0.0), (-0.25, 0.0)]
MODEL = """
<mujoco><option timestep="{dt}" cone="elliptic" impratio="100" integrator="implicitfast"/>
<default><geom solref="0.005 1" solimp="0.98 0.999 0.001"/></default>
<worldbody><geom type="plane" size="9 9 1"/>
<body pos="0 0 0"><freejoint/><inertial pos="0 0 {height}" mass="{mass}" diaginertia="1 1.3 {yaw}"/>
<geom type="sphere" size=".03" pos=".25 0 .03" condim="1" priority="1" mass="0"/>
<geom type="sphere" size=".03" pos="-.25 0 .03" condim="1" priority="1" mass="0"/>
{wheels}</body></worldbody></mujoco>
"""
OF_WHEEL = """<body pos="0 {y} .1"><joint type="hinge" axis="0 1 0"/>
<inertial pos="0 0 0" mass="1" diaginertia=".006 .01 .006"/>
<geom type="sphere" size=".1" condim="3" friction=".8 0 0" priority="1" mass="0"/></body>"""


class Torques:
    """Torques that stay."""

    def __init__(self, *u: float) -> None:
        self.u = np.array(u)

    def initial_state(self, context: Any) -> None:
        """Return nothing: it has no memory."""
        return

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: None) -> tuple[Any, None]:
        """Return the torques."""
        return self.u + 0.0 * t, state


@dataclass(frozen=True)
class One:
    """Who takes part: `prepare(steps)` returns what runs and the pose in which it ends; None without one."""

    name: str
    prepare: Callable[[int], Callable[[], Any]]
    allowed: float | None = None  # how far from the expected pose; None: it is not the same work


def body() -> pm.MobileRobot:
    return pm.MobileRobot(27.0, 2.3, com=(0.0, 0.0, 0.15))


def differential(ground: Any = None) -> WheeledRobot:
    friction = WheelFriction(mu=0.8, rolling=0.0)
    drive = WheelTable.differential(0.5, 0.1, supports=SUPPORTS, friction=friction, **WHEEL)
    return WheeledRobot(body(), drive, ground)


def four(mu: float) -> WheeledRobot:
    drive = WheelTable.skid_steer(0.5, 0.4, 0.1, friction=WheelFriction(mu=mu), **WHEEL)
    return WheeledRobot(body(), drive)


def standing(steps: int) -> Any:
    return pm.FixedHeading(Hold([0.0, 0.0], steps * DT), 0.0)


def simulated(robot: Any, u: Sequence[float], engine: Any = None) -> Callable[[int], Callable[[], Any]]:
    """Return what simulates a robot under torques."""

    def prepare(steps: int) -> Callable[[], Any]:
        return lambda: pm.simulate(robot, Torques(*u), standing(steps), dt=DT, engine=engine).q[-1, :3]

    return prepare


def raw(steps: int) -> Callable[[], Any]:
    """Return a loop over Pinocchio: CRBA, RNEA and one linear system with the rows of the wheels."""
    model, b, r = tree(), 0.25, 0.1
    data = model.createData()

    def run() -> Any:
        q, v, u = np.zeros(5), np.zeros(5), np.array([0.0, 0.0, 0.0, *TORQUES])
        K, right = np.zeros((8, 8)), np.zeros(8)
        for _ in range(steps):
            c, s = np.cos(q[2]), np.sin(q[2])
            M = pin.crba(model, data, q)
            n = pin.nonLinearEffects(model, data, q, v)
            A = np.array([[-s, c, 0, 0, 0], [c, s, -b, -r, 0], [c, s, b, 0, -r]])
            ahead = c * v[0] + s * v[1]
            K[:5, :5], K[:5, 5:], K[5:, :5] = M, A.T, A
            right[:5], right[5:] = u - n, (v[2] * ahead, 0.0, 0.0)
            a = np.linalg.solve(K, right)[:5]
            q, v = q + DT * v + DT**2 / 2 * a, v + DT * a
            c, s = np.cos(q[2]), np.sin(q[2])
            A = np.array([[-s, c, 0, 0, 0], [c, s, -b, -r, 0], [c, s, b, 0, -r]])
            through = np.linalg.solve(pin.crba(model, data, q), A.T)
            v = v - through @ np.linalg.solve(A @ through, A @ v)
        return q[:3]

    return run


def tree() -> pin.Model:
    """Return x, y, psi, and the left and the right wheel, by Pinocchio alone."""
    model, at = pin.Model(), 0
    for kind in (pin.JointModelPX(), pin.JointModelPY(), pin.JointModelRZ()):
        at = model.addJoint(at, kind, pin.SE3.Identity(), f"joint {at}")
    whole, spin = (
        pin.Inertia(27.0, np.array([0, 0, 0.15]), np.diag([1.0, 1.3, 2.3])),
        np.diag([0.006, 0.01, 0.006]),
    )
    for y in (0.25, -0.25):
        wheel, place = pin.Inertia(1.0, np.zeros(3), spin), pin.SE3(np.eye(3), np.array([0.0, y, 0.1]))
        whole -= place.act(wheel)
        joint = model.addJoint(at, pin.JointModelRY(), place, f"wheel {y}")
        model.appendBodyToJoint(joint, wheel, pin.SE3.Identity())
    model.appendBodyToJoint(at, whole, pin.SE3.Identity())
    return model


def of_mujoco() -> Any:
    """Return MuJoCo's model: sphere wheels, and casters without friction."""
    import mujoco

    yaw = 2.3 - 2 * (0.006 + 0.25**2)
    height = (27 * 0.15 - 2 * 0.1) / 25
    wheels = "".join(OF_WHEEL.format(y=y) for y in (0.25, -0.25))
    return mujoco.MjModel.from_xml_string(
        MODEL.format(dt=DT, height=height, mass=25.0, yaw=yaw, wheels=wheels)
    )


def pose_of(state: np.ndarray) -> np.ndarray:
    """Return x, y, psi of a free body's x, y, z and quaternion, shape (..., 3)."""
    w, x, y, z = np.moveaxis(state[..., 3:7], -1, 0)
    psi = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return np.stack([state[..., 0], state[..., 1], psi], axis=-1)


def alone(steps: int) -> Callable[[], Any]:
    """Return MuJoCo's loop."""
    import mujoco

    model = of_mujoco()
    data = mujoco.MjData(model)

    def run() -> Any:
        mujoco.mj_resetData(model, data)
        data.qfrc_applied[6:] = TORQUES
        for _ in range(steps):
            mujoco.mj_step(model, data)
        return pose_of(data.qpos)

    return run


ROLLOUT = "mujoco.rollout, wheel bodies"
RAW, MUJOCO = "Pinocchio and KKT, loop in Python", "MuJoCo, wheel bodies"
SINGLE = (
    One("bare body", simulated(body(), (0.3, 0.0, 0.05))),
    One("bare body, compiled", simulated(body(), (0.3, 0.0, 0.05), pm.Engine.COMPILED)),
    One("Rolling", simulated(differential(), TORQUES), SAME),
    One("Rolling, compiled", simulated(differential(), TORQUES, pm.Engine.COMPILED), SAME),
    One(
        "Coulomb, two wheels, compiled", simulated(differential(Coulomb()), TORQUES, pm.Engine.COMPILED), 1e-3
    ),
    One("Coulomb, four wheels that stick, compiled", simulated(four(0.8), (0.5, 0.5), pm.Engine.COMPILED)),
    One("Coulomb, four wheels that slide, compiled", simulated(four(0.4), (9.0, -9.0), pm.Engine.COMPILED)),
    One(RAW, raw, SAME),
    One(MUJOCO, alone, MUJOCO_SAME),
)


def together(
    robot: Any, controller: Any, trajectory: Any, spread: Any, metrics: Any = ()
) -> Callable[[int, int], Callable[[], Any]]:
    """Return what runs an ensemble."""

    def prepare(n: int, steps: int) -> Callable[[], Any]:
        given: dict[str, Any] = {
            "n": n,
            "dt": DT,
            "spread": spread,
            "duration": steps * DT,
            "metrics": metrics,
        }
        return lambda: pm.ensemble(robot, controller, trajectory, engine=pm.Engine.COMPILED, **given)

    return prepare


def rolled_out(n: int, steps: int) -> Callable[[], Any]:
    """Return mujoco.rollout of one model under the torques, from n starts."""
    import mujoco
    from mujoco.rollout import Rollout

    model, threads = of_mujoco(), os.cpu_count() or 1
    datas, pool = [mujoco.MjData(model) for _ in range(threads)], Rollout(nthread=threads)
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
    start = np.zeros((n, size))
    mujoco.mj_getState(model, datas[0], start[0], mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
    start[:] = start[0]
    forces = np.tile([0.0, 0, 0, 0, 0, 0, *TORQUES], (n, steps, 1))

    def run() -> Any:
        pool.rollout(model, datas, start, forces, control_spec=mujoco.mjtState.mjSTATE_QFRC_APPLIED.value)

    return run


def fleets() -> dict[str, Callable[[int, int], Callable[[], Any]]]:
    """Return the ensembles by name."""
    longest = STEPS * DT
    path, still = pm.Tangent(pm.Circle(2, 0.2, longest)), standing(STEPS)
    rolling, spread = differential(), {"mass": pm.Uniform(24, 30), "left.radius": pm.Normal(0.1, 0.0005)}
    ur5 = WheeledRobot(body().mount("ur5", (0.0, 0.0, 0.2, 0.0)), differential().table)
    arms = pm.WholeBody(ur5.robot, path, Hold(ur5.robot.rest[3:], longest))
    by_wrench = pm.ControlAllocation(pm.PD(50, 20), rolling)
    mass = {"mass": pm.Uniform(24, 30)}
    return {
        "bare body, PD": together(body(), pm.PD(50, 20), path, mass),
        "rolling, torques": together(rolling, Torques(*TORQUES), still, spread),
        "rolling, ControlAllocation(PD)": together(rolling, by_wrench, path, spread),
        "rolling, ControlAllocation(PD), load and slip margin judged": together(
            rolling, by_wrench, path, spread, None
        ),
        "rolling, Backstepping": together(
            rolling, pm.Backstepping(pm.UnicycleTracking(), rolling), path, spread
        ),
        "rolling with a UR5, torques": together(ur5, Torques(*[0.0] * 6, *TORQUES), still, mass),
        "rolling with a UR5, ControlAllocation(PD)": together(
            ur5, pm.ControlAllocation(pm.PD(50, 20), ur5), arms, mass
        ),
        "Coulomb, four wheels that stick": together(four(0.8), Torques(0.5, 0.5), still, mass),
        "Coulomb, four wheels that slide": together(four(0.4), Torques(9.0, -9.0), still, mass),
        ROLLOUT: rolled_out,
    }


ASKED = {
    "rolling, torques": 100.0,
    "rolling with a UR5, torques": 25.0,
    "Coulomb, four wheels that stick": 2.0,
    "Coulomb, four wheels that slide": 0.3,
}
EVERYONE = (*SINGLE, *(One(name, lambda steps: lambda: None) for name in fleets()))


def main(arguments: Sequence[str] | None = None) -> int:
    chosen = selecting(__doc__.splitlines()[0]).parse_args(arguments)
    rounds = chosen.rounds or (1 if chosen.quick else 5)
    out = console()
    out.print(about(), f"medians over {rounds} interleaved rounds of processor seconds", sep="; ")
    sound = show_steps(out, picked(SINGLE, chosen.only), QUICK_STEPS if chosen.quick else STEPS, rounds)
    names = [one.name for one in picked(EVERYONE[len(SINGLE) :], chosen.only)]
    size = (QUICK_ROBOTS, QUICK_STEPS) if chosen.quick else (ROBOTS, STEPS)
    sound &= show_ensembles(out, names, *size, rounds)
    return 0 if sound else 1


def show_steps(out: Console, people: Sequence[One], steps: int, rounds: int) -> bool:
    """Print what a step of one robot takes."""
    expected = simulated(differential(), TORQUES)(steps)()
    runs, words, apart, sound = {}, [], {}, True
    for one in people:
        try:
            run = one.prepare(steps)
            found = np.abs(run() - expected).max() / np.hypot(*expected[:2])
        except ImportError as error:
            words.append(f"{one.name}: not installed, {error}")
            continue
        apart[one.name] = f"{found:.0e}" if one.allowed is not None else ""
        if one.allowed is not None and not found <= one.allowed:
            words.append(f"{one.name}: WRONG, not timed: off by {found:.1e} of the path")
            sound = False
            continue
        runs[one.name] = partial(processor_seconds, run)
    times = interleaved(runs, rounds)
    shown = table(
        f"\nOne robot on wheels, dt = {DT} s, {steps} steps", "contestant", "", "us/step", "off, of the path"
    )
    for name, taken in sorted(times.items(), key=lambda pair: Row("", times=pair[1]).median):
        shown.add_row(name, "", f"{Row('', times=taken).median / steps * 1e6:.2f}", apart[name])
    out.print(shown)
    say(out, words)
    return sound


def show_ensembles(out: Console, names: Sequence[str], n: int, steps: int, rounds: int) -> bool:
    """Print how many robot-steps of an ensemble a second of one processor does."""
    runs, words, everyone, count = {}, [], fleets(), os.cpu_count() or 1
    for name in names:
        try:
            run = everyone[name](min(n, FEW) if name == ROLLOUT else n, steps)
            with out.status(name):
                run()
        except ImportError as error:
            words.append(f"{name}: not installed, {error}")
            continue
        runs[name] = partial(processor_seconds, run)
    times = interleaved(runs, rounds)
    title = f"\nEnsembles of {n:,} robots, {steps} steps: million robot-steps"
    columns = ("a processor second", f"a second, {count} processors", "asked, at least")
    shown = table(title, "contestant", "", *columns)
    for name, taken in times.items():
        rate = (min(n, FEW) if name == ROLLOUT else n) * steps / Row("", times=taken).median / 1e6
        asked = f"{ASKED[name]:g}" if name in ASKED else ""
        shown.add_row(name, "", f"{rate:.3g}", f"{count * rate:.3g}", asked)
    out.print(shown)
    say(out, words)
    return True


if __name__ == "__main__":
    sys.exit(main())
