"""pinmobile, by its public names; and its compiled loop as code for another processor."""

import copy
from collections.abc import Callable
from dataclasses import replace

from arm_fleet import AT, DT, KD, KP, LEVER, MASS, PAYLOAD, PERIOD, RADIUS, RATE, SIDE, SIZE, ArmFleet, motion
from fleet import Figures, Run

from pinmobile import (
    Circle,
    ComputedTorque,
    CubicVia,
    JointFriction,
    MobileRobot,
    PayloadBody,
    Scenario,
    Tangent,
    WholeBody,
    ensemble,
    rk4,
)
from pinmobile.compiled import LoopTape, Program, Shape, Target, processors
from pinmobile.loop._run import plan_execution
from pinmobile.urdf import box_inertia


def words(fleet: ArmFleet) -> dict[str, object]:
    """Return what `ensemble` and `Scenario` are told."""
    arm = fleet.task.arm
    cube = (SIDE,) * 3
    load = PayloadBody(PAYLOAD, LEVER, box_inertia(PAYLOAD, cube), cube)  # the same inertia for all
    robot = MobileRobot.box(MASS, SIZE).mount(arm, AT).attach(load)
    start, way = motion(arm)
    joints = CubicVia(start, start + way, start, PERIOD / 2, PERIOD)
    spread = {"loads.0.mass": fleet.payload, "mass": fleet.mass, "viscous": fleet.friction}
    return {
        "robot": robot,
        "controller": ComputedTorque(robot, KP, KD),
        "trajectory": WholeBody(robot, Tangent(Circle(RADIUS, RATE, PERIOD)), joints),
        "n": fleet.n,
        "spread": spread,
        "dt": DT,
        "duration": fleet.task.duration,
        "integrator": rk4 if fleet.task.step == "rk4" else None,
        "forces": [JointFriction(0.0)],
        "metrics": (),
    }


def rollout(fleet: ArmFleet) -> Run:
    """Make and compile robot, controller and trajectory first."""
    return ensembles(words(fleet))


def judged(fleet: ArmFleet) -> Run:
    """Judge end effector, effort and tip-over margin too, as is the default."""
    return ensembles({**words(fleet), "metrics": None})


def ensembles(told: dict[str, object]) -> Run:
    """Return what runs an ensemble, compiled."""
    plan_execution(Scenario(**told))

    def run() -> Figures:
        done = ensemble(**told)
        return Figures(done.max_error, done.rms_error, done.max_input)

    return run


def for_avx2(fleet: ArmFleet) -> Run:
    """Run what an ensemble runs, without its quantiles, as code for a processor without AVX-512."""
    return kernel(fleet, lambda tape: Program(tape, Target("haswell", "", 4), Shape(4, 1)))


def kernel(fleet: ArmFleet, made: Callable[[LoopTape], Program]) -> Run:
    """Return a function that runs a scenario by another program of its tape."""
    scenario = Scenario(**words(fleet))
    way = plan_execution(scenario)
    compiled = copy.copy(way.program)
    assert compiled is not None
    compiled.program = made(compiled.tape)
    way = replace(way, program=compiled)
    threads = processors()

    def run() -> Figures:
        done = way.run(scenario.draws(), 0, fleet.n, threads)
        return Figures(done.max_error, done.rms_error, done.max_input)

    return run
