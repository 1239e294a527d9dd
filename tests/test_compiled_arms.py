"""Robots with arms as compiled plants: against Pinocchio, MuJoCo and `simulate`, one by one."""

from copy import copy
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

import pinmobile as pm
from pinmobile.arrays import Array
from pinmobile.compiled import Cache, Program
from pinmobile.controllers import Decoupled
from pinmobile.errors import SlowerEngine
from pinmobile.integrators import rk4
from pinmobile.loop._run import plan_execution
from tests.parts import Waving
from tests.test_arms import mjcf
from tests.test_compiled_loop import targets

AT = (0.1, -0.05, 0.2, 0.4)
LOAD = pm.PayloadBody(1.0, (0, 0.01, 0.05), size=(0.1, 0.1, 0.1))
UR5 = pm.MobileRobot.box().mount("ur5", AT).attach(LOAD)
PENDULUM = pm.MobileRobot.box().mount("double_pendulum_continuous", AT)  # whose q has cosines and sines
CLOSE = 1e-10
WRAPPED = pm.InputSaturation(
    pm.MeasurementDelay(pm.MeasurementNoise(pm.ComputedTorque(UR5, 20, 8), 1e-4, 1e-4, seed=1), 1),
    UR5.effort_limit,
)


SPREAD: dict[str, Any] = {
    "mass": pm.Uniform(24, 36),
    "com.x": pm.Normal(0, 0.02),
    "forearm_link.mass": pm.Uniform(2, 3),
    "forearm_link.com.y": pm.Normal(0, 0.01),  # which is zero but for this
    "forearm_link.inertia.zz": pm.Uniform(0.004, 0.005),
    "rotors.elbow_joint": pm.Uniform(0.0, 0.2),
    "ur5.at.x": pm.Uniform(0.05, 0.15),
    "ur5.at.yaw": pm.Normal(0.4, 0.1),
    "loads.0.mass": pm.Uniform(0.5, 3),
    "loads.0.com.z": pm.Normal(0.05, 0.01),
    "controller.loads.0.mass": pm.SameAs("loads.0.mass"),
    "controller.forearm_link.mass": pm.Uniform(2, 3),
    "viscous": pm.Uniform(0, 0.3),
    "kp": pm.Relative(pm.Uniform(0.9, 1.1)),
}


def given(robot: pm.MobileRobot = UR5, controller: Any = None, spread: Any = SPREAD, **options: Any) -> Any:
    """Return the words of a scenario."""
    controller = pm.ComputedTorque(robot, 100, 20) if controller is None else controller
    trajectory = Waving(robot, options.pop("lasts", 0.6))
    words: Any = {"robot": robot, "controller": controller, "trajectory": trajectory, "spread": spread}
    words |= {"n": 5, "dt": 0.02, "seed": 3, "forces": [pm.JointFriction(np.zeros(robot.nv))]}
    return words | options


def run(*parts: Any, **options: Any) -> Any:
    return pm.ensemble(**given(*parts, **options))


def assert_members(runs: Any, *which: int) -> None:
    """Compare robots of an ensemble with what `simulate` makes of them, by Pinocchio."""
    for i in which:
        member = runs.arguments(i)
        alone = pm.simulate(*member[:3], **member.options)
        assert alone.engine == "PYTHON"
        np.testing.assert_allclose(runs.max_error[i], alone.max_error(), rtol=CLOSE, atol=CLOSE)
        np.testing.assert_allclose(runs.max_input[i], alone.max_input(), rtol=CLOSE, atol=1e-8)


def answers(body: Any, frame: str) -> Any:
    """Return what gives M, n, tau, a, pose and Jacobian for a state, an acceleration and a force."""

    def law(q: Any, v: Any, a: Any, tau: Any) -> Any:
        return (
            body.mass_matrix(q),
            body.nonlinear_effects(q, v),
            body.inverse_dynamics(q, v, a),
            body.forward_dynamics(q, v, tau),
            body.frame_pose(q, frame),
            body.frame_jacobian(q, frame),
        )

    return law


def by_mujoco(robot: pm.MobileRobot, states: Any, force: Array) -> Any:
    """Return the same of each state by MuJoCo, for a robot with one arm."""
    (mount,) = robot.mounts
    frame = mount.model.frames[mount.model.getFrameId(robot.end_effector.partition("/")[2])]
    model = mujoco.MjModel.from_xml_string(mjcf(robot, mount))
    data = mujoco.MjData(model)

    for q, v, a, tau in zip(*states, force, strict=True):
        data.qpos[:], data.qvel[:], data.qacc[:], data.qfrc_applied[:] = q, v, a, 0
        mujoco.mj_inverse(model, data)
        asked = data.qfrc_inverse.copy()
        data.qfrc_applied[:] = tau
        mujoco.mj_forward(model, data)
        M, pose, J = np.zeros((model.nv, model.nv)), np.eye(4), np.zeros((6, model.nv))
        mujoco.mj_fullM(model, data, M)
        link = frame.parentJoint + 2  # of the bodies, after the world, the base and the arm's foot
        R = data.xmat[link].reshape(3, 3)
        pose[:3, :3] = R @ frame.placement.rotation
        pose[:3, 3] = data.xpos[link] + R @ frame.placement.translation
        mujoco.mj_jac(model, data, J[:3], J[3:], pose[:3, 3], link)
        yield M, data.qfrc_bias.copy(), asked, data.qacc.copy(), pose, J


@pytest.mark.parametrize("arm", ["ur5", "panda"])  # which has fingers that slide
def test_compiled_dynamics_are_those_of_pinocchio_and_of_mujoco(arm: str) -> None:
    robot, rng = pm.MobileRobot.box().mount(arm, AT), np.random.default_rng(2)
    q, (v, a, tau) = robot.random_configuration(rng, (7,)), rng.normal(size=(3, 7, robot.nv))
    q[:, 2] = rng.uniform(-12, 12, 7)
    tau *= robot.inverse_dynamics(q, v, a)
    law = answers(robot, robot.end_effector)
    found = pm.vectorize(law, keep=False)(q, v, a, tau)
    rows = [answers(robot, robot.end_effector)(*state) for state in zip(q, v, a, tau, strict=True)]
    everybody = {"Pinocchio": rows, "MuJoCo": list(by_mujoco(robot, (q, v, a), tau))}
    for who, theirs in everybody.items():
        for name, x, y in zip(
            ("M", "n", "tau", "a", "T", "J"), found, zip(*theirs, strict=True), strict=True
        ):
            off = np.abs(x - np.array(y)).max() / np.abs(y).max()
            assert off < CLOSE, f"{name}, {who}: {off}"


LIGHT: dict[str, Any] = {"spread": {"loads.0.mass": pm.Uniform(0.5, 3)}, "n": 2, "dt": 0.004}
PUSHES: dict[str, Any] = {"force.x": pm.Uniform(-5, 5), "coefficients.forward": pm.Uniform(0, 5)}
OPTIONS: dict[str, dict[str, Any]] = {
    "all numbers": {},
    "PDGravity": {"controller": pm.PDGravity(UR5, 20, 2), **LIGHT},
    "Decoupled": {"controller": Decoupled(UR5, 25, 10), **LIGHT},
    "wrapped": {"controller": WRAPPED, **LIGHT},
    "rk4, substeps and pushes on the base": {
        **{"spread": PUSHES, "forces": [pm.ConstantForce((0, 0, 0)), pm.ViscousFriction((0, 0, 0))]},
        **{"n": 2, "integrator": rk4, "substeps": 2},
    },
}


@pytest.mark.parametrize("name", OPTIONS)
def test_each_robot_of_an_ensemble_is_what_simulate_makes_of_it(name: str) -> None:
    runs = run(**OPTIONS[name])
    assert runs.engine == pm.Engine.COMPILED.name
    assert_members(runs, 0, len(runs) - 1)
    assert np.ptp(runs.max_error, axis=0).max() > 0


def test_six_seconds_of_a_closed_loop_are_those_of_pinocchio() -> None:
    robot = pm.MobileRobot.box().mount("kinova", AT)  # with continuous joints
    runs = run(
        robot, n=2, dt=0.01, lasts=6.0, spread={"mass": pm.Uniform(24, 36), "viscous": pm.Uniform(0, 0.05)}
    )
    assert runs.engine == pm.Engine.COMPILED.name
    assert_members(runs, 1)
    member = runs.arguments(1)
    usual, compiled = (pm.simulate(*member[:3], **member.options, engine=engine) for engine in pm.Engine)
    assert len(usual.t) == 601
    for name in ("q", "v", "a", "u"):
        x, y = getattr(compiled, name), getattr(usual, name)
        assert np.abs(x - y).max() < CLOSE * np.abs(y).max(), name


def test_the_bits_of_arms_are_those_of_every_processor() -> None:
    controller = pm.InputSaturation(
        pm.MeasurementNoise(pm.ComputedTorque(PENDULUM, 20, 8), 1e-4, 1e-4, seed=1), 50
    )
    spread = {f"{PENDULUM.mounts[0].links[-1].name}.mass": pm.Uniform(0.2, 0.4)}
    way = plan_execution(pm.Scenario(**given(PENDULUM, controller, spread, n=11)))
    assert way.program is not None
    draws, found = way.scenario.draws(), []
    for target, shape in targets().values():
        if shape.vectors > 1:
            continue
        built = copy(way.program)
        built.program = Program(built.tape, target, shape, cache=Cache(""))
        found.append(replace(way, program=built).run(draws, 0, 11, 1))
    assert len(found) > 2
    assert np.ptp(found[0].max_error, axis=0).min() > 0
    for other in found[1:]:
        for one, same in zip(found[0], other, strict=True):
            np.testing.assert_array_equal(one, same)


def test_inertias_that_no_body_has_are_refused_with_their_share() -> None:
    spread = {"forearm_link.inertia.zz": pm.Uniform(0.05, 0.15)}  # above 0.0989 a body has none
    with pytest.raises(pm.InvalidArgument) as caught:
        run(spread=spread, n=200)
    assert str(caught.value).startswith("spread gives plant.mounts.ur5.links.forearm_link in ")
    assert " of 200 draws (" in str(caught.value)
    assert str(caught.value).endswith("expected principal moments >= 0, none above the sum of the other two")
    with pytest.raises(pm.InvalidArgument, match=r"loads\.0\.mass"):
        run(spread={"loads.0.mass": pm.Uniform(-1, 1)})


@pytest.mark.long
@pytest.mark.once
def test_a_tree_that_is_too_large_runs_slower_and_says_so() -> None:
    robot = pm.MobileRobot.box(size=(1, 1, 0.5)).mount("tiago_dual", AT)
    with pytest.warns(SlowerEngine, match="runs by PYTHON.*not COMPILED.*more than 30000 operations"):
        runs = run(robot, spread={"mass": pm.Uniform(24, 36)}, n=2, dt=0.3)
    assert runs.engine == pm.Engine.PYTHON.name  # few robots are faster one by one than side by side
