"""Payloads that are picked up, in the hand or as a force: all engines, ensembles and the viewer."""

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinmobile as pm
from pinmobile import balance, plots
from pinmobile.controllers import TorqueToVoltage
from pinmobile.forces import PayloadForce
from pinmobile.integrators import semi_implicit_euler
from pinmobile.loop import reaction
from pinmobile.parts import replace as with_numbers
from pinmobile.plant import robot_at
from tests.refusals import refusals

G = 9.81
DT, BEGIN, END = 0.005, 0.2, 0.5
BOX = pm.MobileRobot.box(60.0, size=(0.8, 0.6, 0.3))
ARM = BOX.mount("ur5", at=(0.2, 0, 0.3, 0))
LOAD = pm.PayloadBody(4.0, (0.01, 0, 0.1), size=(0.1, 0.1, 0.2))
CRATE = pm.PayloadBody(12.0, (0.2, 0.05, 0.3), size=(0.2, 0.2, 0.2))
POSTURES = [[0.0, -0.8, 1.0, -0.2, 0.5, 0.0], [1.0, -0.6, 0.8, -0.2, 0.5, 0.0]]
LINE = pm.Tangent(pm.Line([0, 0], [0.3, 0], 0.8))
CURVE = pm.Tangent(pm.Circle(1.0, 0.5, 0.8))
MOTION = pm.WholeBody(ARM, LINE, pm.Spline(POSTURES, [0, 0.8]))
LAW = pm.ComputedTorque(ARM, kp=100, kd=20)
HELD = pm.PayloadTransfer(ARM, LOAD, BEGIN, END)
SIDES: dict[str, Any] = {"supports": [(0.25, 0), (-0.25, 0)], "mass": 1.0, "spin_inertia": 0.01}
MOTOR = pm.Motor(resistance=0.5, torque_constant=0.05, gear=30, voltage=48)
TABLE = pm.WheelTable.differential(0.5, 0.1, **SIDES)
POWERED = pm.WheeledRobot(BOX, pm.WheelTable.differential(0.5, 0.1, motor=MOTOR, **SIDES))
DRIVE = pm.Backstepping(pm.UnicycleTracking(), pm.WheeledRobot(BOX, TABLE))
OMNI = pm.WheelTable.mecanum(wheelbase=0.5, track=0.5, radius=0.1, spin_inertia=0.01)


def held_at(t: Any) -> Any:
    """Return whether samples are in the interval, without the library."""
    k = np.round(np.asarray(t) / DT)
    return (k >= round(BEGIN / DT)) & (k < round(END / DT))


def loops() -> dict[str, tuple[Any, Any, Any, Any, str | None]]:
    """Return robot, payload, controller, trajectory and frame by the kind of the plant's step."""
    volts = POWERED.by_voltage()
    by_volts = TorqueToVoltage(pm.Backstepping(pm.UnicycleTracking(), POWERED), volts)
    return {
        "arm": (ARM, LOAD, LAW, MOTION, None),
        "rolling": (pm.WheeledRobot(BOX, TABLE), CRATE, DRIVE, CURVE, "base_link"),
        "dry": (pm.WheeledRobot(BOX, TABLE, pm.Coulomb()), CRATE, DRIVE, CURVE, "base_link"),
        "volts": (volts, CRATE, by_volts, CURVE, None),
    }


@pytest.mark.parametrize(
    ("kind", "engine"), [*((kind, pm.Engine.COMPILED) for kind in loops()), ("arm", pm.Engine.PYTHON)]
)
def test_a_run_is_that_of_the_robot_with_the_load_while_held(kind: str, engine: pm.Engine) -> None:
    robot, load, law, motion, frame = loops()[kind]
    own: dict[str, Any] = {"integrator": pm.rk4} if kind == "arm" else {}
    given: dict[str, Any] = {"dt": DT, "duration": 0.2, "engine": engine}
    loaded = pm.simulate(robot.attach(load, frame), law, motion, **given, **own)
    alone = pm.simulate(robot, law, motion, **given, **own)
    assert np.abs(loaded.q - alone.q).max() > 1e-5
    for interval, expected in (((0.0, 9.0), loaded), ((-2.0, 0.0), alone)):
        run = pm.simulate(pm.PayloadTransfer(robot, load, *interval, frame), law, motion, **given)
        for name in "qvau":
            np.testing.assert_allclose(getattr(run, name), getattr(expected, name), rtol=1e-9, atol=1e-9)
    mixed = pm.simulate(pm.PayloadTransfer(robot, load, 0.1, frame=frame), law, motion, **given)
    k = round(0.1 / DT)  # the run is continuous there
    np.testing.assert_allclose(mixed.v[: k + 1], alone.v[: k + 1], rtol=1e-9, atol=1e-9)
    assert np.abs(mixed.q - alone.q).max() > 1e-6


def in_pinocchio(load: pm.PayloadBody | None = None) -> pin.Model:
    """Return Pinocchio's model of the arm, with a body on the joint of its tool."""
    model = pin.Model(ARM.model)
    if load is not None:
        frame = model.frames[model.getFrameId(ARM.end_effector)]
        inertia = pin.Inertia.FromBox(load.mass, *(load.size or ()))
        inertia.lever = np.array(load.com)
        model.appendBodyToJoint(frame.parentJoint, inertia, frame.placement)
    return model


def energy(model: pin.Model, data: pin.Data, q: Any, v: Any) -> float:
    """Return kinetic and potential energy [J]."""
    return float(pin.computeKineticEnergy(model, data, q, v) + pin.computePotentialEnergy(model, data, q))


def test_accelerations_and_energy_are_pinocchios_of_a_model_with_one_more_body() -> None:
    push = pm.ConstantForce([20, -10, 3])
    run = pm.simulate(HELD, LAW, MOTION, dt=DT, forces=[push])
    order = [1, 0, *range(2, ARM.nv)]  # Pinocchio's y before x
    models = {False: in_pinocchio(), True: in_pinocchio(LOAD)}
    datas = {held: model.createData() for held, model in models.items()}
    tau = run.u + np.append([20, -10, 3], np.zeros(6))
    energies = []
    for t, q, v, a, force in zip(run.t, run.q, run.v, run.a, tau, strict=True):
        held = bool(held_at(t))
        found = pin.aba(models[held], datas[held], q[order], v[order], force[order])
        np.testing.assert_allclose(a[order], found, rtol=1e-9, atol=1e-9)
        energies.append([energy(models[k], datas[k], q[order], v[order]) for k in (False, True)])
    k0, k1 = round(BEGIN / DT), round(END / DT)
    for held, first, last in ((False, 0, k0), (True, k0, k1), (False, k1, len(run.t) - 1)):
        gained = energies[last][held] - energies[first][held]
        work = np.sum(tau[first:last] * np.diff(run.q[first : last + 1], axis=0))  # constant between samples
        assert gained == pytest.approx(work, abs=1e-6)
    assert abs(energies[k0][True] - energies[k0][False]) > 10  # [J], the payload's own
    at = robot_at(run.plant, run.t)
    both = at.kinetic_energy(run.q, run.v) + at.potential_energy(run.q)
    expected = [pair[bool(held_at(t))] for pair, t in zip(energies, run.t, strict=True)]
    np.testing.assert_allclose(both - both[0], np.subtract(expected, expected[0]), atol=1e-9)


def test_a_lift_of_constant_force_falls_and_coasts_as_by_hand() -> None:
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "lift")
    model.appendBodyToJoint(joint, pin.Inertia(6.0, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
    model.addFrame(pin.Frame("hand", joint, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    lift = pm.MobileRobot.box(30.0).mount(model, at=(0, 0, 0.2, 0), name="lift")
    plant = pm.PayloadTransfer(lift, pm.PayloadBody(2.0), 0.2, 0.5, "lift/hand")
    force = np.array([0, 0, 0, 6.0 * G])
    motion = pm.WholeBody(lift, pm.FixedHeading(pm.Hold([0, 0], 1), 0), pm.Hold([0.0], 1))
    run = pm.simulate(plant, pm.law(lambda t, q, v, reference: force), motion, dt=0.01)
    a, held = -2.0 * G / 8.0, np.clip(run.t - 0.2, 0, 0.3)
    coasts = a * 0.3 * np.clip(run.t - 0.5, 0, None)
    np.testing.assert_allclose(run.q[:, 3], a * held**2 / 2 + coasts, atol=1e-12)
    np.testing.assert_allclose(run.v[:, 3], a * held, atol=1e-12)


def test_wheels_carry_the_payload_while_it_is_held() -> None:
    robot = pm.WheeledRobot(BOX, TABLE, pm.Coulomb())
    plant = pm.PayloadTransfer(robot, CRATE, BEGIN, END, "base_link")
    place = pm.FixedHeading(pm.Hold([0, 0], 1), 0)
    run = pm.simulate(plant, pm.law(lambda t, q, v, reference: np.zeros(2)), place, dt=DT, duration=0.8)
    loads, later = balance.contact_loads(run).values, held_at(run.t)
    np.testing.assert_allclose(loads.sum(1), G * (60.0 + 12.0 * later), rtol=1e-6)
    point = balance.body_zero_moment_point(run)  # at rest, below the centre of mass
    np.testing.assert_allclose(point, later[:, None] * np.array([0.2, 0.05]) * 12 / 72, atol=1e-6)
    assert run.metrics()["load"].values == pytest.approx(loads.min(1), abs=1e-9)
    assert not run.events


def test_a_box_tips_over_only_while_it_holds_what_is_too_far_ahead() -> None:
    box = pm.MobileRobot.box(mass=10.0, size=(0.4, 0.4, 0.2))
    plant = pm.PayloadTransfer(box, pm.PayloadBody(10.0, com=(0.5, 0, 0.2)), BEGIN, END, "base_link")
    place = pm.FixedHeading(pm.Hold([0, 0], 0.8), 0)
    run = pm.simulate(plant, pm.PD(100, 100), place, dt=DT)
    (event,) = run.events
    assert (event.kind, event.t, event.samples) == ("tip over", BEGIN, held_at(run.t).sum())
    assert event.value == pytest.approx(0.2 - 0.25)  # half the length, and where half the weight is


def test_metrics_margins_and_figures_of_each_sample_are_those_of_its_robot() -> None:
    robot = pm.WheeledRobot(ARM, OMNI)
    law = pm.ControlAllocation(LAW, robot)
    run = pm.simulate(pm.PayloadTransfer(robot, LOAD, BEGIN, END), law, MOTION, dt=DT)
    asked: tuple[Any, ...] = (
        *(balance.reaction_wrench, balance.zero_moment_point, balance.tip_over_margin),
        *(balance.required_friction, lambda run: balance.slip_margins(run).values),
        lambda run: np.stack([each.values for each in run.metrics().values()], axis=-1),
    )
    held = held_at(run.t)
    for ask in asked:
        loaded, alone = (ask(replace(run, plant=each)) for each in (robot.attach(LOAD), robot))
        assert not np.array_equal(loaded, alone)
        expected = np.where(held.reshape(-1, *(1,) * (loaded.ndim - 1)), loaded, alone)
        np.testing.assert_array_equal(ask(run), expected)
    for draw in (plots.loads, plots.friction, plots.wheel_torques, plots.balance, plots.path):
        draw(run)
    drawn = np.sum([np.asarray(line.get_ydata()) for line in plots.loads(run).axes[0].lines[:4]], axis=0)
    np.testing.assert_allclose(drawn, balance.contact_loads(run).values.sum(1), rtol=1e-9)


def test_an_ensemble_varies_mass_and_time_and_agrees_with_single_runs_in_python(tmp_path: Any) -> None:
    spread: dict[str, Any] = {
        "load.mass": pm.Uniform(0.5, 6),
        "plant.begin": pm.Uniform(0.1, 0.4),
        "plant.robot.mass": pm.Normal(60, 2),
    }
    found = pm.ensemble(HELD, LAW, MOTION, n=3, spread=spread, dt=DT, seed=2)
    assert found.engine == "COMPILED"
    for k in range(3):
        own = {path.removeprefix("plant."): float(values[k]) for path, values in found.draws.items()}
        plant = with_numbers(HELD, own)
        assert plant.loaded.loads[0].mass == plant.load.mass == own["load.mass"]
        run = pm.simulate(plant, LAW, MOTION, dt=DT, engine=pm.Engine.PYTHON)
        np.testing.assert_allclose(run.max_error(), found.max_error[k], rtol=1e-9)
        margin = run.metrics()["tip-over margin"].values.min()
        assert found.largest("tip-over margin")[k] == pytest.approx(margin, abs=1e-9)
    run.save(tmp_path / "run.npz")
    assert pm.Rollout.load(tmp_path / "run.npz").plant == plant


def test_the_viewer_draws_the_payload_while_it_is_held() -> None:
    from pinmobile.viewer import Viewer

    plant = pm.PayloadTransfer(BOX, CRATE, BEGIN, END, "base_link")
    run = pm.simulate(plant, pm.ComputedTorque(BOX), LINE, dt=DT)
    tracks = Viewer(plant).record(run, fps=100).tracks
    (own,) = [each for each in tracks if each["path"].endswith("load1")]
    (track,) = [each for each in own["clip"]["tracks"] if each["name"] == ".visible"]
    assert track["type"] == "bool"  # steps, without interpolation
    values = dict(zip(track["times"], track["values"], strict=True))
    assert {type(x) for x in values.values()} == {bool}  # a browser draws an object whose visible is 0
    assert values == {0: 0, 0.19: 0, BEGIN: 1, 0.49: 1, END: 0, 0.8: 0}


def test_invalid_transfers_are_refused_and_the_load_needs_a_time() -> None:
    for make, words in (
        (lambda: pm.PayloadTransfer(ARM, LOAD, 2, 2), r"end is 2.0 s, expected above begin, 2.0 s"),
        (lambda: pm.PayloadTransfer(ARM, LOAD, 2, frame="hand"), r"unknown frame 'hand', available: "),
        (lambda: pm.ComputedTorque(HELD, 1, 1), r"robot is PayloadTransfer\(.*expected a MobileRobot"),
        (lambda: pm.simulate(HELD, LAW, MOTION, dt=DT, integrator=pm.rk4), r"integrator is "),
    ):
        with pytest.raises(pm.PinmobileError, match=words):
            make()
    with pytest.raises(AttributeError, match=r"no mass_matrix: use its method robot_at\(t\), robot or"):
        _ = HELD.mass_matrix
    assert HELD.robot_at(BEGIN) is HELD.loaded
    assert HELD.robot_at(END) is ARM


# -- a load that is picked up midway ---------------------------------------------------------------


BODY = pm.MobileRobot(mass=30, yaw_inertia=1.3, com=(0.1, 0.05))
CIRCLE = pm.Tangent(pm.Circle(radius=1.5, rate=0.6, duration=2))
LATER = pm.Tangent(pm.Circle(1.5, 0.6, 1.0, (0.0, 1.5), heading=0.6))  # what is left after a second
INERTIA = (0.2, 0.0, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, 0.2)
CARRIED = PayloadForce(10, (0.25, 0.1), 1.0, 0.2)


@pytest.mark.parametrize(
    ("integrator", "engine"), [(semi_implicit_euler, pm.Engine.PYTHON), (pm.rk4, pm.Engine.COMPILED)]
)
def test_it_is_two_runs_that_are_joined_when_it_comes(integrator: Any, engine: Any) -> None:
    controller = pm.ComputedTorque(BODY, 16, 8)
    given: Any = {"dt": 0.01, "integrator": integrator, "engine": engine}
    whole = pm.simulate(BODY, controller, CIRCLE, forces=[CARRIED], **given)
    before = pm.simulate(BODY, controller, CIRCLE, duration=1.0, **given)
    loaded = BODY.attach(pm.PayloadBody(10, (0.25, 0.1, 0.1), INERTIA), "base_link")
    after = pm.simulate(
        loaded.with_locked_arms(), controller, LATER, q0=before.q[-1], v0=before.v[-1], **given
    )
    joined = np.vstack([before.q[:-1], after.q])
    jump = np.abs(after.a[0] - before.a[-1]).max()
    assert jump > 0.3
    # The last stage of the step before sees the load: a sixth of the jump for a step. Else rounding.
    close = 0.01 / 6 * jump if integrator is pm.rk4 else 1e-12
    assert np.abs(whole.q - joined).max() < close
    assert np.abs(whole.a[100:] - after.a).max() < 100 * close


def carrying(robot: Any, q: Any, v: Any, u: Any) -> Any:
    """Return the acceleration of a robot that carries the payload."""
    f = robot.generalized_force(q, CARRIED(2.0, robot.pose(q), robot.pose_rate(q, v)))
    f = f + reaction(robot, [CARRIED], 2.0, q, lambda more: robot.forward_dynamics(q, v, u, f + more))
    return robot.forward_dynamics(q, v, u, f)


def test_with_an_arm_and_on_wheels_too() -> None:
    load = pm.PayloadBody(10, (0.25, 0.1, 0.1), INERTIA)
    wheels = pm.WheelTable.differential(0.1, 0.4)
    generator = np.random.default_rng(5)
    arm = pm.MobileRobot.box().mount("ur5")
    for robot, loaded in (
        (arm, arm.attach(load, "base_link")),
        (pm.WheeledRobot(BODY, wheels), pm.WheeledRobot(BODY.attach(load, "base_link"), wheels)),
    ):
        q = robot.integrate(robot.rest, generator.normal(size=robot.nv))
        v, u = generator.normal(size=robot.nv), generator.normal(size=robot.nu)
        v = robot.project(q, v) if hasattr(robot, "project") else v
        found, wanted = carrying(robot, q, v, u), loaded.forward_dynamics(q, v, u)
        # Differences of accelerations by unit forces: rounding of the one by the size of the other.
        assert np.abs(found - wanted).max() < 1e-11 * np.abs(wanted).max()


def test_a_push_acts_between_its_times() -> None:
    push = pm.ConstantForce((3, 1, 0.1), 0.5, 1.2)
    q = np.zeros((4, 3))
    found = push(np.array([0.49, 0.5, 1.19, 1.2]), q, q)
    assert np.array_equal(found, np.outer([0, 1, 1, 0], [3, 1, 0.1]))


test_bad_arguments_are_refused = refusals(
    (lambda: pm.ConstantForce((1, 0, 0), 2.0, 1.0), "end is 1.0 s, expected above begin, 2.0 s"),
    (
        lambda: pm.simulate(
            pm.WheeledRobot(BODY, pm.WheelTable.mecanum(0.5, 0.4, 0.1, spin_inertia=0.01), pm.Coulomb()),
            pm.PD(1, 1),
            CIRCLE,
            dt=0.01,
            forces=[CARRIED],
        ),
        "which has its own step",
    ),
)


def test_the_inertia_of_a_box_follows_its_mass() -> None:
    """m (l^2 + w^2) / 12 is the box's, unless an inertia is given."""
    turn = pm.law(lambda t, q, v, reference: np.array([0.0, 0.0, 1.0]))
    rest, masses = pm.FixedHeading(pm.Hold((0, 0), 1), 0), np.array([5.0, 50.0])
    for inertia, expected in ((None, masses * 2 / 12), (np.eye(3), np.ones(2))):
        load = pm.PayloadBody(5.0, (0.1, 0, 0), inertia, (1, 1, 0.2))
        robot = pm.MobileRobot(30, 1.3).attach(load)
        runs = pm.ensemble(robot, turn, rest, n=2, spread={"loads.0.mass": masses}, dt=0.1)
        for member, moment in zip((0, 1), expected, strict=True):
            m = masses[member]
            whole = 1.3 + moment + 0.1**2 * m * 30 / (m + 30)  # about the common centre of mass
            assert runs.member(member).a[0, 2] == pytest.approx(1 / whole, rel=1e-12)
