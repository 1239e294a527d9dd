"""Slopes of simulated logs, and numbers of any plant from a log."""

import re
from dataclasses import replace as replaced
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.arrays import Array
from pinmobile.cli import main
from pinmobile.identification._excitation import _Search
from pinmobile.identification._planar_model import PlanarModel
from pinmobile.parts import find, named, replace

BODY = pm.MobileRobot(30.0, 1.3, com=(0.1, 0.05))


def test_a_designed_motion_informs_more_than_any_of_many_random_ones() -> None:
    limits = [np.array(x) for x in ((1.5, 1.5, np.pi), (1.0, 1.0, 1.5), (1.5, 1.5, 3.0))]
    model, rng = PlanarModel.of(BODY), np.random.default_rng(1)
    search = _Search(model, model.prior(BODY), (20.0, 60.0, 5), limits)
    random = [search.coefficients(rng.standard_normal((5, 2, 3))) for _ in range(300)]
    designed = np.asarray(pm.excitation(BODY).coefficients)
    assert search.cost(designed)[0] < min(search.cost(x)[0] for x in random) - 5.0
    assert np.allclose(search.coefficients(designed), designed)  # it reaches the limits


ARM = pm.MobileRobot.box(mass=60.0, size=(0.8, 0.6, 0.3)).mount("ur5", at=(0.2, 0.0, 0.3, 0.0))
LINKS = ["*_link.mass", "*_link.com"]


@cache
def arm_log(seed: int = 0, noise: float = 1e-4) -> tuple[pm.Log, Any]:
    """Return four seconds of an arm on a box at 2 ms, and the arm, whose links differ from those of `ARM`."""
    rng, changes = np.random.default_rng(seed), dict[str, Any]()
    for path, one in named(ARM).items():
        if path.endswith("_link.mass"):
            changes[path] = float(one.value * (1 + 0.1 * rng.standard_normal()))
        if path.endswith("_link.com"):
            changes[path] = one.leaf.value + 0.01 * rng.standard_normal(3)
    true = replace(ARM, changes)
    bends = pm.Spline(0.6 * rng.uniform(-1, 1, (9, 6)), np.linspace(0, 4, 9))
    motion = pm.WholeBody(ARM, pm.Tangent(pm.Lissajous(1, 1, 0.4, 0.3, duration=4.0)), bends)
    law = pm.ComputedTorque(ARM, 100.0, 20.0)
    run = pm.simulate(true, law, motion, dt=0.002, integrator=pm.rk4, engine=pm.Engine.COMPILED)
    return pm.Log.from_rollout(run, noise, joint_noise=noise, seed=seed), true


def truth_of(found: Any, true: Any) -> Array:
    """Return the true values of the numbers that were found."""
    return np.array([float(find(true, one.path).value) for one in found.model.quantities])


def test_links_of_an_arm_are_found_within_their_intervals() -> None:
    shares, many = [], 0
    for seed in range(3):
        log, true = arm_log(seed)
        found = pm.identify(log, ARM, by=LINKS)
        low, high = np.array([*found.interval().values()]).T
        known, truth = np.isfinite(high), truth_of(found, true)
        assert found.is_noise, found.whiteness
        assert 0.9 < found.chi2 < 1.1
        shares.append(((low <= truth) & (truth <= high))[known])
        many += known.sum()
        assert found.rank < len(found.names) == 28
        assert not found.is_identifiable["base_link.mass"]  # it stands on the box
        assert "base_link.mass" in found.unseen
        right = found.parameters["upper_arm_link.mass"] / find(true, "upper_arm_link.mass").value
        assert abs(right - 1) < 0.05
    assert many > 30
    assert np.concatenate(shares).mean() > 0.85


def test_the_found_arm_is_an_ordinary_robot_and_predicts_another_log() -> None:
    found = pm.identify(arm_log(0)[0], ARM, by=LINKS)
    robot, other = found.robot(), arm_log(1)[0].between(0.0, 2.0)
    assert float(find(robot, "wrist_3_link.mass").value) == found.parameters["wrist_3_link.mass"]
    assert robot.nq == ARM.nq
    assert "shoulder_lift_joint" in str(found.predict(other))


def drive(scale: float = 1.0) -> Any:
    """Return a differential drive by voltage, with numbers that differ by a factor."""
    motor = pm.Motor(resistance=1.2, torque_constant=0.04 * scale, voltage=24.0, gear=30.0, viscous=2e-4)
    table = pm.WheelTable.differential(0.5, 0.1 * scale, motor=motor, mass=1.0, spin_inertia=0.005)
    return pm.WheeledRobot(pm.MobileRobot(30.0, 1.3, com=(0.06, 0.02)), table).by_voltage()


@cache
def drive_log(joint_noise: float | None = None) -> pm.Log:
    """Return a log of voltages, poses and encoders, or angles of the wheels."""
    plant = drive()
    tracking = pm.Backstepping(pm.UnicycleTracking(), plant.wheeled)
    law = pm.controllers.TorqueToVoltage(tracking, plant)
    path = pm.excitation(plant, duration=12.0, period=6.0)
    run = pm.simulate(plant, law, path, dt=0.02, engine=pm.Engine.COMPILED)
    rng = np.random.default_rng(0)
    log = pm.Log.from_rollout(run, 1e-3, joint_noise=joint_noise)
    return replaced(log, wheel_rates=np.asarray(log.wheel_rates) + 0.02 * rng.standard_normal((len(log), 2)))


def test_wheels_and_motors_are_found_from_voltages() -> None:
    names = ["*.radius", "*.torque_constant"]
    found = pm.identify(drive_log(), drive(1.1), by=names)
    low, high = np.array([*found.interval(0.999).values()]).T
    truth = truth_of(found, drive())
    assert ((low <= truth) & (truth <= high)).all(), str(found)
    assert (high - low < 0.1 * truth).all()
    assert min(one for one, _ in found.free_run.values()) > 0.99


def test_outliers_do_not_matter() -> None:
    log = drive_log()
    q = np.array(log.q)
    q[100::150] += 0.3
    found = pm.identify(replaced(log, q=q), drive(1.1), by="left.radius")
    assert found.outliers >= 6
    assert abs(found.parameters["left.radius"] - 0.1) < 0.01


def test_numbers_that_have_one_effect_are_told_as_a_combination() -> None:
    names = ["torque_constant", "resistance", "viscous"]  # only k / R and k^2 / R + viscous have an effect
    found = pm.identify(drive_log(), drive(), by=[f"left.motor.{name}" for name in names])
    assert found.rank == 2, str(found)
    assert found.unseen.startswith("the motion identifies only combinations of motor.torque_constant")
    assert np.isinf(found.standard_errors["motor.resistance"])


@pytest.mark.parametrize(
    ("change", "options", "why"),
    [
        ({}, {"by": "nothing"}, "unknown parameter in by 'nothing'"),
        ({}, {"by": "left.radius", "loads": [None]}, "loads is [None], expected None with by"),
        ({}, {"by": "left.friction.mu"}, "log identifies none of the numbers"),
        ({"u": lambda u: -u}, {"by": "left.radius"}, "the given robot explains 0% of the motion"),
        ({"joints": lambda _: np.zeros((601, 3))}, {"by": "left.radius"}, "log has 3 joints, expected 2"),
    ],
)
def test_what_cannot_be_found_is_refused(change: Any, options: Any, why: str) -> None:
    log = drive_log()
    log = replaced(log, **{name: f(getattr(log, name)) for name, f in change.items()})
    with pytest.raises(pm.PinmobileError, match=re.escape(why)):
        pm.identify(log, drive(), **options)


def test_joint_positions_are_read_from_files_and_streams(tmp_path: Path) -> None:
    plant, prior = drive(), drive(1.1)
    log = drive_log(1e-3)
    joints = np.array(log.joints)
    rows = np.hstack([log.t[:, None], np.array(log.q), joints, log.u])
    titles = "t,x,y,psi,joint_left,joint_right,u_left [V],u_right [V]"
    path = tmp_path / "run.csv"
    np.savetxt(path, rows, delimiter=",", header=titles, comments="", fmt="%.17g")
    read = pm.Log.from_csv(path)
    np.testing.assert_array_equal(read.joints, joints)
    found = pm.identify(read, prior, by=["*.radius", "*.torque_constant"])
    assert np.abs(found.phi / truth_of(found, plant) - 1).max() < 0.01
    late = log.t[:-1] + 0.5 * log.dt
    streams = pm.Log.from_streams(log.t, log.q, log.t, log.u, joints=joints[:-1], t_joints=late)
    assert streams.joints is not None
    turned = 0.6 * log.dt * np.abs(np.asarray(log.wheel_rates)).max()  # in half a sample
    assert np.nanmax(np.abs(streams.joints - joints)) < turned + 0.01
    text = (
        "WheeledRobot(MobileRobot(30, 1.3), WheelTable.differential(0.5, 0.11, mass=1.0, "
        "motor='Motor(resistance=1.2, torque_constant=0.05, voltage=24, gear=30)')).by_voltage()"
    )
    assert main(["identify", str(path), f"--out={tmp_path}", "by=left.radius", f"robot={text}"]) == 0
