"""LQR and MPC of robots whose inputs are volts, beside backstepping, on a figure of eight."""

from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile import plots
from pinmobile.controllers import TorqueToVoltage
from pinmobile.wheels import Motor
from tests.parts import Eight

pytestmark = pytest.mark.once

DT = 0.01
VOLTS = 6.0
COIL: dict[str, Any] = {"resistance": 1.2, "torque_constant": 0.03, "voltage": VOLTS, "gear": 20.0}
MOTOR = Motor(**COIL, rotor_inertia=1e-5, viscous=1e-5, coulomb=0.004, efficiency=0.8)
WHEEL: dict[str, Any] = {"mass": 1.0, "spin_inertia": 0.01, "yaw_inertia": 0.006, "motor": MOTOR}
WHEEL |= {"supports": [(-0.2, 0.0), (0.2, 0.0)], "friction": pm.wheels.WheelFriction(mu=0.3)}
TABLE = pm.WheelTable.differential(0.5, 0.1, **WHEEL)
MODEL = pm.WheeledRobot(pm.MobileRobot(30.0, 2.3, com=(0.05, 0.0, 0.2)), TABLE)
HEAVY = pm.WheeledRobot(pm.MobileRobot(36.0, 2.76, com=(0.05, 0.0, 0.2)), TABLE, pm.Coulomb())


EIGHT = pm.Tangent(Eight(1.0, 25.0, 4 * np.pi))  # 1 m sin 0.5 t, 0.5 m sin t


def controllers() -> dict[str, Any]:
    volts = MODEL.by_voltage()
    return {
        "backstepping": TorqueToVoltage(pm.Backstepping(pm.UnicycleTracking(), MODEL), volts),
        "LQR": pm.LQR(volts),
        "LQR of torques": TorqueToVoltage(pm.LQR(MODEL), volts),
        "MPC": pm.MPC(volts, 20, 0.1),
    }


def run(robot: pm.WheeledRobot, name: str, off: float, duration: float) -> pm.Rollout:
    """Return a run that starts so far behind and beside the eight, where at all, at rest."""
    engine = None if name == "MPC" else pm.Engine.COMPILED
    q, v = MODEL.start(EIGHT(0.0))
    start = {"q0": q + np.array([-off, -off, 0, 0, 0]), "v0": 0 * v if off else v}
    given: dict[str, Any] = {"dt": DT, "duration": duration, "engine": engine}
    return pm.simulate(robot.by_voltage(), controllers()[name], EIGHT, **given, **start)


def distance(found: pm.Rollout) -> Any:
    return np.hypot(*(found.q[:, :2] - found.reference.q[:, :2]).T)


@pytest.mark.parametrize("name", controllers())
def test_each_keeps_to_the_eight_and_what_the_model_does_not_know_costs_a_few_millimetres(name: str) -> None:
    """Half a sample of the rate of the acceleration, up to 1.5 m/s^3, over gains of some 10 /s^2: 0.75 mm.

    Of a mass that is 20 % more, at up to 0.5 m/s^2, it is 10 mm.
    """
    on, off = (distance(run(robot, name, 0.0, 1.5)).max() for robot in (MODEL, HEAVY))
    assert on < 0.75e-3
    assert on < off < 10e-3


def test_volts_are_limited_and_a_model_with_limits_comes_back_sooner_than_a_regulator_cut_off() -> None:
    late = {}
    for name in ("LQR", "MPC"):
        found = run(HEAVY, name, 0.3, 4.0)
        assert np.abs(found.u).max() == VOLTS
        assert (np.abs(found.u) == VOLTS).any(axis=-1).mean() > 0.1
        late[name] = np.sqrt((distance(found)[200:] ** 2).mean())
    assert late["MPC"] < 0.7 * late["LQR"]
    assert plots.wheel_torques(found).axes[0].get_ylabel() == "voltage [V]"


def test_volts_of_the_reference_are_those_of_its_torques_and_rates() -> None:
    t = np.linspace(0.0, 4.0, 9)
    body, along = MODEL.by_voltage(), MODEL.array_dynamics.followed(EIGHT(t))
    volts = body.array_dynamics.followed(EIGHT(t))
    np.testing.assert_allclose(volts.u, body.volts_for(along.v, along.u), rtol=1e-12)
    assert np.abs(volts.u).max() < VOLTS
    # What limits exclude is told, as they do not clip it.
    with pytest.raises(pm.InvalidArgument, match="limits exclude the reference: at t = "):
        pm.simulate(body, pm.MPC(body, limits=3.0), EIGHT, dt=0.01, duration=1.0)


def test_limits_beyond_those_of_the_motors_are_refused_as_the_robot_would_cut_inputs_off() -> None:
    volts, weak = MODEL.by_voltage(), pm.WheelTable.differential(0.5, 0.1, motor=Motor(torque_limit=4.0))
    torques = pm.WheeledRobot(MODEL.robot, weak)
    rows: Any = (volts, 7.0, "7 V for left"), (volts, [6.0, 6.1], "6.1 V for right")
    for robot, limits, words in (*rows, (torques, 4.5, "4.5 N m for left")):
        with pytest.raises(pm.InvalidArgument, match=f"^limits has {words}, expected at most [46] "):
            pm.MPC(robot, limits=limits)
    assert pm.MPC(volts, limits=VOLTS).range[1].tolist() == pm.MPC(volts).range[1].tolist() == [VOLTS, VOLTS]
    # Where one is endless, the motor's own stays.
    assert [each.tolist() for each in pm.MPC(volts, limits=[5.0, np.inf]).range] == [[-5.0, -6.0], [5.0, 6.0]]


def test_volts_cost_by_default_what_their_torque_costs() -> None:
    robot = pm.WheeledRobot(MODEL.robot, pm.WheelTable.differential(0.5, 0.1, motor=Motor(**COIL)))
    # 0.03 N m/A times 20, over 1.2 ohm
    np.testing.assert_allclose(np.diag(np.asarray(pm.LQR(robot.by_voltage()).R)), 0.02 * 0.5**2, rtol=1e-12)


def test_volts_are_not_taken_for_torques_nor_torques_for_volts() -> None:
    volts = MODEL.by_voltage()
    q, v = MODEL.start(EIGHT(0.0))
    given: Any = {"dt": 0.01, "duration": 0.1, "q0": q, "v0": v}
    with pytest.raises(pm.InvalidArgument, match=r"robot has inputs in V, V, and the plant in N m, N m"):
        pm.simulate(MODEL, pm.LQR(volts), EIGHT, **given)
    with pytest.raises(pm.InvalidArgument, match=r"robot has inputs in N m, N m, and the plant in V, V"):
        pm.simulate(volts, pm.LQR(MODEL), EIGHT, **given)
