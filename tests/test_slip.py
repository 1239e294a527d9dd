"""Wheels on dry ground: they stick exactly, slide by Coulomb's law, and their loads balance the robot."""

import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile import Coulomb, MobileRobot, Rolling, WheeledRobot, WheelTable, errors, simulate
from pinmobile.controllers import WheelSpeed
from pinmobile.verification._wheels import WheelTree
from pinmobile.verification.bodies import tree_motion
from pinmobile.wheels import GearTrain, Motor, Ramp, WheelFriction
from tests import wheeled
from tests.parts import steady
from tests.wheeled import BODY, CENTRAL, CORNERS, WHEEL, G, run

DRY = WheelFriction(mu=0.6, rolling=0.0)
SKID = WheelTable.skid_steer(0.5, 0.4, 0.1, **WHEEL)


def skid(friction: WheelFriction, **others: Any) -> WheelTable:
    return WheelTable.skid_steer(0.5, 0.4, 0.1, **{**WHEEL, "friction": friction, **others})


@pytest.mark.once
def test_what_friction_can_hold_on_a_ramp_stays_and_what_it_cannot_accelerates() -> None:
    direction = 0.7  # of the ramp, neither ahead nor aside
    locked = skid(WheelFriction(mu=0.5, rolling=1e3))
    below = WheeledRobot(CENTRAL, locked, Coulomb(ramp=Ramp(np.arctan(0.98 * 0.5), direction)))
    held = run(below, (0.0, 0.0), 0.01, 1.0)
    # At most what forces, found to the tolerance, add to the speed in one step, for all the time.
    assert np.abs(held.q[:, :3]).max() < Coulomb().tolerance * 0.5 * G * 0.01
    angle = np.arctan(1.02 * 0.5)
    above = WheeledRobot(CENTRAL, locked, Coulomb(ramp=Ramp(angle, direction)))
    v = run(above, (0.0, 0.0), 0.01, 1.0).v[-1]
    expected = -G * (np.sin(angle) - 0.5 * np.cos(angle)) * np.array([np.cos(direction), np.sin(direction)])
    np.testing.assert_allclose(v[:2], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("mu", [0.3, 0.8])
def test_a_skid_steer_turns_as_if_its_track_were_wider_whatever_the_friction(mu: float) -> None:
    """Of a base that turns in place slowly."""
    table = skid(WheelFriction(mu=mu, rolling=0.0), motor=Motor(rotor_inertia=1e6))
    turning = np.array([0, 0, 0, -0.2, 0.2, -0.2, 0.2])
    v = run(WheeledRobot(CENTRAL, table), (0.0, 0.0), 0.01, 1.0, v=turning).v[-1]
    assert v[4] * 0.1 / v[2] / 0.2 == pytest.approx(1 + (0.25 / 0.2) ** 2, rel=1e-5)


GRIPS = {**WHEEL, "friction": WheelFriction(mu=500.0, across=0.0, rolling=0.0)}
DRIVES = {
    "differential": WheelTable.differential(0.5, 0.1, x=0.07, supports=[(-0.2, 0.0)], **GRIPS),
    "mecanum": WheelTable.mecanum(0.5, 0.4, 0.08, **GRIPS),
    "omni": WheelTable.omni(0.25, 0.05, **GRIPS),
    "car": WheelTable.car(0.6, 0.4, 0.1, **GRIPS),
}


@pytest.mark.parametrize("name", DRIVES)
def test_with_much_friction_wheels_roll(name: str) -> None:
    table, ahead = DRIVES[name], MobileRobot(30.0, 2.3, com=(0.1 if name == "car" else 0.02, 0.02, 0.2))
    ideal, grips = WheeledRobot(ahead, table), WheeledRobot(ahead, table, Coulomb())
    u = 0.2 * np.cos(np.arange(ideal.nu))
    u[-1] *= 0.05 if name == "car" else 1.0
    v = ideal.project(ideal.rest, [0.2, -0.1, 0.3, *np.zeros(ideal.nv - 3)])
    expected = run(ideal, u, 0.005, 0.5, v=v).q[-1]
    far = [np.abs(run(grips, u, h, 0.5, v=v).q[-1] - expected).max() for h in (0.01, 0.005)]
    assert far[0] < 1e-3
    assert far[0] / far[1] == pytest.approx(2.0 if name == "car" else 4.0, rel=0.1)


LIGHT: dict[str, Any] = {"mass": 0.05, "spin_inertia": 0.004, "yaw_inertia": 0.003}


def test_braking_wheels_slide_with_the_load_that_braking_leaves_them() -> None:
    """F = mu N and N L = m g (L - x) - F (h - r) - T: for mu (h - r) > L too, where to find one from the
    other again and again leads away from both."""
    height, mu, torque = 2.0, 1.5, 12
    L, x, r = 0.3, 0.1, 0.1
    own: dict[str, Any] = LIGHT | {"friction": WheelFriction(mu, rolling=0.0)}
    table = WheelTable.differential(0.5, 0.1, supports=[(L, 0)], **own)  # behind, with a support in front
    robot = WheeledRobot(MobileRobot(30.0, 3.0, com=(x, 0.0, height)), table, Coulomb())
    force = mu * (30 * G * (L - x) - 2 * torque) / (L + mu * (height - r))
    a = robot.forward_dynamics(robot.rest, np.zeros(5), [-torque, -torque])
    assert a[0] == pytest.approx(-force / 30, rel=1e-7)
    # In a run too, from its first sample, in every engine.
    for engine in (pm.Engine.COMPILED, pm.Engine.PYTHON):
        found = run(robot, (-torque, -torque), 0.01, 0.1, v=np.array([5.0, 0, 0, 0, 0]), engine=engine)
        # Loads are found to 1e-8 of the weight.
        np.testing.assert_allclose(found.a[:, 0], -force / 30, rtol=1e-7)
        assert not found.signals["missed"].values.any()
        assert not found.signals["tips"].values.any()


def test_locked_wheels_slide_straight_at_speed_whatever_the_step() -> None:
    """Friction of all wheels is against the way; it turns the body back, and never into a spin."""
    motor = Motor(resistance=1.2, torque_constant=0.05, voltage=24, gear=10, coulomb=50)
    robot = WheeledRobot(
        MobileRobot(30.0, 0.5, com=(0.0, 0.0, 0.2)), skid(DRY, motor=motor, mass=0.05, yaw_inertia=0.003)
    )
    found = run(robot.by_voltage(), (0, 0), 0.05, 2.0, v=np.array([30.0, 0.1, 0.1, 0, 0, 0, 0]))
    assert np.abs(found.v[:, 2]).max() < 0.2
    assert not found.signals["missed"].values.any()
    # It loses mu g: a force along the way, which the heading does not change.
    speed = np.hypot(found.v[-1, 0], found.v[-1, 1])
    assert speed == pytest.approx(np.hypot(30.0, 0.1) - 0.6 * G * 2.0, abs=2e-3)


def test_of_two_solutions_a_step_takes_that_of_the_step_before_and_says_which() -> None:
    """Locked wheels in front carry nothing at rest: unloaded they do not brake, and braking loads them all.

    With the weight W at x < 0 the wheels lift; braked by mu W at the height h it presses at x + mu h, beyond
    the wheels. Either follows from itself.
    """
    own: dict[str, Any] = LIGHT | {"friction": WheelFriction(mu=1.0, rolling=1e3)}
    supports = [(0, 0.1), (0, -0.1), (-0.3, 0.1), (-0.3, -0.1)]
    table = WheelTable.differential(0.5, 0.1, x=0.3, supports=supports, **own)
    body: Any = WheeledRobot(MobileRobot(30.0, 3.0, com=(-0.22, 0, 0.6)), table, Coulomb()).array_dynamics
    v, still = np.array([5.0, 0, 0, 0, 0]), body.initial_state()
    braked = still._replace(acceleration=np.array([-G, 0, 0, 0, 0]))
    for memory, a, tips in ((still, 0.0, 0), (braked, -G, 1)):
        for _ in range(2):  # and it stays with it
            step = body.step(0.0, np.zeros(5), v, np.zeros(2), 0.01, lambda t, q, v: 0.0, memory)
            memory = step.memory
            assert (step.v[0] - v[0]) / 0.01 == pytest.approx(a, abs=1e-7)
            assert (memory.tips, memory.missed) == (tips, 0)
            assert memory.loads[:2].sum() == pytest.approx(30 * G * tips, abs=1e-6)


def test_loads_on_a_ramp_and_of_spinning_wheels_are_those_of_the_tree() -> None:
    own = BODY.mount("ur5", at=[0.05, 0.0, 0.3, 0.2])
    robot, rng = WheeledRobot(own, SKID, Coulomb(ramp=Ramp(0.2, 0.5))), np.random.default_rng(4)
    q, v, a = robot.rest + 0.0, *(rng.normal(size=robot.nv) * 0.1 for _ in range(2))
    q[: own.nq] = own.integrate(own.rest, rng.normal(size=own.nv) * 0.3)
    v[-4:], a[-4:] = v[-4:] * 100, a[-4:] * 100
    found = robot.contact_loads(q, v, a)
    wrench = WheelTree(robot).ground_wrench(*tree_motion(robot, q, v, a)[0])  # by Pinocchio
    values, places = np.array(found.values), np.array([[wheel.x, wheel.y] for wheel in SKID.wheels])
    assert not found.tips
    sums = [values.sum(), values @ places[:, 1], -values @ places[:, 0]]
    np.testing.assert_allclose(sums, wrench[[2, 3, 4]], rtol=1e-11, atol=1e-10)


STEERED = WheelTable.swerve(CORNERS, 0.06, **{**WHEEL, "trail": (-0.01, 0.0)})


def test_energy_never_grows_without_input() -> None:
    rng = np.random.default_rng(0)
    robot = WheeledRobot(BODY, skid(WheelFriction(mu=0.5), coupled=False))
    v = rng.normal(size=robot.nv) * [1, 1, 2, 10, 10, 10, 10]
    found = run(robot, (0.0,) * 4, 0.01, 1.0, v=v)
    energy = robot.kinetic_energy(found.q, found.v)
    assert np.diff(energy).max() < 1e-13 * energy[0]
    assert energy[-1] < 0.5 * energy[0]


def test_rolling_resistance_holds_and_brakes() -> None:
    """At rest up to its bound; beyond, wheels accelerate with what is left."""
    robot = WheeledRobot(CENTRAL, skid(WheelFriction(rolling=0.02), coupled=False))
    bound = 0.02 * 0.1 * 30.0 * G
    assert np.abs(run(robot, (0.245 * bound,) * 4, 0.01, 0.2).q).max() < 1e-13
    v = run(robot, (0.5 * bound,) * 4, 0.01, 0.2).v[-1]
    assert v[0] == pytest.approx(0.2 * (bound / 0.1) / (30.0 + 4 * 0.01 / 0.1**2), rel=1e-10)


def test_an_ensemble_spreads_rolling_resistance_from_none() -> None:
    """Each robot accelerates by what the bound leaves of the torque, as alone."""
    robot = WheeledRobot(CENTRAL, skid(WheelFriction(rolling=0.0), coupled=False))
    where, torque, shares = pm.FixedHeading(pm.Hold([0.0, 0.0], 0.2), 0.0), 0.6, [0.0, 0.01, 0.03]
    spread = {f"{wheel.name}.friction.rolling": shares for wheel in robot.table.wheels}
    runs = pm.ensemble(robot, steady(*(torque,) * 4), where, dt=0.01, n=3, spread=spread)
    assert runs.engine == "COMPILED"
    force = 4 * np.maximum(torque / 0.1 - np.array(shares) * 30.0 * G / 4, 0.0)
    expected = 0.5 * 0.2**2 * force / (30.0 + 4 * 0.01 / 0.1**2)
    np.testing.assert_allclose(runs.max_error[:, 0], expected, rtol=1e-9)
    np.testing.assert_array_equal([runs.member(k).max_error() for k in range(3)], runs.max_error)


def test_a_tyre_that_gives_way_slips_in_proportion() -> None:
    locked = skid(WheelFriction(mu=0.5, rolling=1e3, slip=1e-3))
    robot = WheeledRobot(CENTRAL, locked, Coulomb(ramp=Ramp(0.1)))
    v = run(robot, (0.0, 0.0), 0.01, 0.5).v[-1]
    assert v[0] == pytest.approx(-30.0 * G * np.sin(0.1) / 4 * 1e-3, rel=1e-6)


def test_gear_trains_hold_whatever_the_friction() -> None:
    robot = WheeledRobot(BODY, skid(WheelFriction(mu=0.05)))
    v = run(robot, (20.0, -20.0), 0.01, 0.5).v
    np.testing.assert_array_equal(v[:, 3:5], v[:, 5:7])
    geared = WheelTable(SKID.wheels, (), (GearTrain(("front_left", "rear_left"), (1.0, -2.0)),))
    v = run(WheeledRobot(BODY, geared, Coulomb()), (1.0, 1.0), 0.01, 0.2).v
    np.testing.assert_allclose(v[:, 5], -2.0 * v[:, 3], rtol=1e-14)


def test_what_cannot_slip_is_refused(tmp_path: Path) -> None:
    (tmp_path / "fetch.urdf").write_text(wheeled.fetch())  # which does not tell where the ground is
    trains = GearTrain(("front_left", "rear_left")), GearTrain(("front_left", "rear_left"), (1.0, 2.0))
    for robot, table, words in (
        (MobileRobot.from_urdf(tmp_path / "fetch.urdf"), SKID, "ground="),
        (BODY, WheelTable.differential(0.5, 0.1, **WHEEL), "supports="),
        (BODY, WheelTable.skid_steer(0.5, 0.4, 0.1), "spin_inertia"),
        (BODY, WheelTable(SKID.wheels, (), trains), "two rates"),
    ):
        with pytest.raises(errors.InvalidArgument, match=words):
            WheeledRobot(robot, table, Coulomb())


@pytest.mark.parametrize("table", [SKID, STEERED], ids=["skid", "swerve"])
def test_forces_of_wheels_under_torques_at_random_are_found(table: WheelTable) -> None:
    robot, rng = WheeledRobot(BODY, table, Coulomb()), np.random.default_rng(10)
    q, v = np.zeros((20, robot.nq)), np.zeros((20, robot.nv))
    memory: Any = robot.initial_state(None)
    memory = type(memory)(*(np.broadcast_to(x, (20, *np.shape(x))) for x in memory))
    scale = np.array([1.0 if each.name.endswith("steering") else 10.0 for each in robot.inputs])
    for _ in range(3):
        u = rng.normal(size=(20, robot.nu)) * scale * rng.uniform(0, 2, size=(20, 1))
        q, v, memory = robot.step(0.0, q, v, u, 0.01, 0.0, memory)
        assert not memory.missed.any()


def test_a_run_says_at_which_steps_forces_were_not_found() -> None:
    robot = WheeledRobot(BODY, SKID, Coulomb(sweeps=2))
    missed = run(robot, (30.0, -25.0), 0.01, 0.2).signals["missed"].values
    assert missed.max() == 1
    assert run(WheeledRobot(BODY, SKID), (30.0, -25.0), 0.01, 0.2).signals["missed"].values.max() == 0


def test_forces_are_those_of_mid_step_and_as_accurate() -> None:
    """A drive that sticks, pushed by its wheels and held by a drag: m v' = F - c v, turned by a quarter.

    The error falls with the square of the step; with forces of a step's start it would with the step.
    """
    own = {**WHEEL, "friction": WheelFriction(rolling=0.0)}
    table = WheelTable.differential(0.4, 0.1, supports=[(0.2, 0.0)], **own)
    robot, c, T = WheeledRobot(CENTRAL, table, Coulomb(mu=5.0)), 60.0, 0.8
    mass, q = 30.0 + 2 * 0.01 / 0.1**2, robot.rest + 0.0
    q[2] = np.pi / 2
    top = 2 * 1.5 / 0.1 / c
    lag = mass / c
    expected = top * (T - lag * (1 - np.exp(-T / lag))), top * (1 - np.exp(-T / lag))
    off: list[list[float]] = []
    for h in (0.02, 0.01):
        more: dict[str, Any] = {"substeps": round(0.02 / h), "forces": [pm.ViscousFriction([c, 5.0, 1.0])]}
        found = run(robot, (1.5, 1.5), 0.02, T, q, **more)
        off.append([found.q[-1, 1] - expected[0], found.v[-1, 1] - expected[1]])
    np.testing.assert_allclose(np.array(off[0]) / off[1], 4.0, rtol=0.1)
    assert np.abs(off[1]).max() < 1e-4


def on_casters(height: float, ground: Any = None) -> WheeledRobot:
    """Return a robot that tips over in turns if its centre of mass is high."""
    table = WheelTable.differential(0.5, 0.1, supports=[(0.3, 0)], **WHEEL)
    return WheeledRobot(MobileRobot(30, 3, com=(0.1, 0, height)), table, ground or Coulomb(mu=0.8))


def test_a_divergence_of_a_robot_that_tips_over_says_so() -> None:
    robot = on_casters(0.6)
    circle = pm.Tangent(pm.Circle(1.0, 2.5, 2.0))
    words = r"the error in .*; no loads of wheels and supports balance the robot"
    with pytest.raises(errors.Diverged, match=words):
        simulate(robot, WheelSpeed(pm.UnicycleTracking(), robot, kp=2), circle, dt=0.02, limit=1.0)


@pytest.mark.parametrize(
    ("ground", "engine"), [(Rolling(), pm.Engine.COMPILED), (Coulomb(0.8), pm.Engine.PYTHON)]
)
def test_a_run_warns_of_a_robot_that_tips_over(ground: Any, engine: pm.Engine) -> None:
    path, words = pm.Tangent(pm.Circle(1.0, 1.5, 2.0)), r"it tips over, which is not simulated \(from t = "
    for height, tips in ((0.1, False), (0.9, True)):
        robot = on_casters(height, ground)
        law = WheelSpeed(pm.UnicycleTracking(), robot, kp=2)
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            found = simulate(robot, law, path, dt=0.02, duration=0.4, engine=engine)
        assert [bool(re.search(words, str(each.message))) for each in told] == [True] * tips
        # Dry ground records the loads of the step before.
        margin = pm.balance.tip_over_margin(found)[: -1 if isinstance(ground, Coulomb) else None].min()
        worst: list[Any] = [(each.value, each.unit) for each in found.events if each.kind == "tip over"]
        assert worst == [(pytest.approx(margin), "m")] * tips
