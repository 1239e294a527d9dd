"""Robots whose inputs are volts: motors inside the step, and controllers that drive them."""

from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile import Circle, Coulomb, Engine, MobileRobot, Motor, Rolling, Tangent, WheeledRobot, WheelTable
from pinmobile.arrays import Array
from pinmobile.balance import max_path_speed
from pinmobile.controllers import Backstepping, TorqueToVoltage, UnicycleTracking, WheelSpeed
from pinmobile.parts import evolved
from pinmobile.wheels import MOTORS, ByVoltage, DifferentialGear, Ramp, Support, Wheel, WheelFriction
from tests.parts import steady
from tests.refusals import refusals
from tests.wheeled import BODY, CASTER, CENTRAL, WHEEL, G, run

GRIPS = WheelFriction(mu=2.0, rolling=0.0)
ELECTRIC: Any = {
    "resistance": 1.2,
    "torque_constant": 0.03,
    "voltage": 24.0,
    "gear": 20.0,
    "rotor_inertia": 1e-5,
}
MOTOR = Motor(**ELECTRIC, viscous=1e-5, coulomb=0.004, efficiency=0.8, current=15.0)
PATH = pm.Tangent(pm.Circle(2.0, 0.3, 20.0))
R = 0.1


def table(motor: Motor, **others: Any) -> WheelTable:
    own = {**WHEEL, "friction": GRIPS, **others}
    return WheelTable.differential(0.5, R, motor=motor, supports=[(-0.2, 0.0), (0.2, 0.0)], **own)


def steps(
    robot: ByVoltage, u: tuple[float, ...], h: float, count: int, v: Any = None
) -> tuple[Array, Array, Any]:
    """Return the state after steps, and what is kept, without a loop."""
    q, v = robot.rest.copy(), np.zeros(robot.nv) if v is None else v
    memory: Any = robot.initial_state()
    for _ in range(count):
        q, v, memory = robot.step(0.0, q, v, np.array(u), h, 0.0, memory)
    return q, v, memory


GROUNDS = pytest.mark.parametrize("ground", [Rolling(), Coulomb()], ids=["rolling", "slipping"])


@GROUNDS
def test_a_run_at_a_steady_rate_balances_back_emf_and_friction_to_rounding(ground: Any) -> None:
    """model.md, 4: W = (k V / R - T_c) / (G (k^2 / R + b)), whatever the step."""
    robot = WheeledRobot(CENTRAL, table(MOTOR), ground).by_voltage()
    _, v, memory = steps(robot, (12.0, 12.0), 0.5, 60)
    np.testing.assert_allclose(v[-2:], MOTOR.no_load_rate(12.0), rtol=1e-12)
    np.testing.assert_allclose(memory.torques, 0.0, atol=1e-12)
    np.testing.assert_allclose(memory.currents, MOTOR.armature_current(12.0, v[-2:]), rtol=1e-11)


@pytest.mark.parametrize("slope", [0.1, -0.1], ids=["driving", "driven"])
def test_on_a_ramp_the_gear_takes_its_share_of_the_power_either_way(slope: float) -> None:
    """Up, the motors drive, and the efficiency is taken; down, wheels drive them, and it is given back by."""
    robot = WheeledRobot(CENTRAL, table(MOTOR), Rolling(Ramp(abs(slope), 0.0 if slope > 0 else np.pi)))
    volts = 12.0 if slope > 0 else 2.0
    _, v, memory = steps(robot.by_voltage(), (volts, volts), 0.5, 60)
    load = 30.0 * G * np.sin(slope) * R / 2
    np.testing.assert_allclose(memory.torques, load, rtol=1e-11)
    np.testing.assert_allclose(MOTOR.torque(volts, v[-2:]), load, rtol=1e-11)
    k, eta = 0.03, 0.8 if slope > 0 else 1 / 0.8
    expected = (k * volts / 1.2 - 0.004 - load / (eta * 20)) / (20 * (k * k / 1.2 + 1e-5))
    np.testing.assert_allclose(v[-2:], expected, rtol=1e-11)


@GROUNDS
def test_the_current_is_limited_until_back_emf_leaves_less(ground: Any) -> None:
    robot = WheeledRobot(CENTRAL, table(MOTOR), ground).by_voltage()
    found = run(robot, (24.0, 24.0), 0.01, 2.0)
    currents, rates = found.signals["currents"].values[1:, 0], found.v[:, -1]
    free = (24.0 - 0.03 * 20 * rates) / 1.2
    assert np.all(currents[free[1:] > 15.0] == 15.0)
    assert np.all(currents[free[:-1] < 15.0] < 15.0)
    assert currents.min() < 10.0
    torques = found.signals["torques"].values[1:, 0]
    whole = currents == 15.0
    expected = 0.8 * 20 * (0.03 * 15.0 - 0.004 - 1e-5 * 20 * (rates[1:] + rates[:-1]) / 2)
    np.testing.assert_allclose(torques[whole], expected[whole], rtol=1e-4)
    assert whole.sum() > 5


@GROUNDS
def test_the_error_falls_with_the_square_of_the_step_and_engines_agree(ground: Any) -> None:
    robot = WheeledRobot(BODY, table(MOTOR), ground).by_voltage()
    best = run(robot, (12.0, 10.0), 0.01 / 32, 0.5)
    ends = [run(robot, (12.0, 10.0), h, 0.5) for h in (0.02, 0.01)]
    off = [max(np.abs(x.q[-1] - best.q[-1]).max(), np.abs(x.v[-1] - best.v[-1]).max()) for x in ends]
    assert off[0] < 0.01
    assert 3.5 < off[0] / off[1] < 4.5
    here = run(robot, (12.0, 10.0), 0.02, 0.5, engine=Engine.PYTHON)
    np.testing.assert_allclose(here.q, ends[0].q, rtol=0, atol=1e-13)
    np.testing.assert_allclose(here.v, ends[0].v, rtol=0, atol=1e-13)
    for name, signal in here.signals.items():
        np.testing.assert_allclose(signal.values, ends[0].signals[name].values, atol=1e-10, err_msg=name)


def test_electrical_energy_is_what_moves_and_what_is_lost() -> None:
    robot = WheeledRobot(BODY, table(MOTOR)).by_voltage()
    left = []
    for dt in (0.02, 0.01):
        found = run(robot, (12.0, 8.0), dt, 1.0)
        V, i, torque = (found.signals[name].values[1:] for name in ("volts", "currents", "torques"))
        W = (V - 1.2 * i) / (0.03 * 20)  # mean rate, by back-EMF
        assert (W > 0).all()
        shaft = 0.03 * i - 1e-5 * 20 * W - 0.004
        lost = 1.2 * i**2 + 1e-5 * (20 * W) ** 2 + 0.004 * 20 * W + (20 * shaft - torque) * W
        assert (20 * shaft * W - torque * W >= -1e-12).all()
        gained = float(robot.kinetic_energy(found.q[-1], found.v[-1]))
        left.append(dt * float((V * i - lost).sum()) - gained)
        assert dt * float((V * i).sum()) > 50.0
    assert abs(left[0]) < 0.2
    assert 3.5 < left[0] / left[1] < 4.5


@GROUNDS
def test_a_motor_far_stiffer_than_the_step_takes_the_rate_of_its_volts_at_once(ground: Any) -> None:
    """Time constants of less than 0.1 ms, at dt = 0.01: no ringing."""
    stiff = evolved(MOTOR, viscous=0.0, coulomb=0.0, efficiency=1.0, current=np.inf, resistance=1e-5)
    rough = table(stiff, friction=WheelFriction(mu=1e6, rolling=0.0))
    robot = WheeledRobot(CENTRAL, rough, ground).by_voltage()
    found = run(robot, (3.0, 3.0), 0.01, 0.2)
    rates = found.v[1:, -2:]
    assert np.abs(rates - 3.0 / (0.03 * 20)).max() < 0.02
    np.testing.assert_allclose(rates[-1], 5.0, rtol=1e-10)


@GROUNDS
def test_dry_friction_of_motors_holds_on_a_ramp_and_gives_way_beyond(ground: Any) -> None:
    """G T_c / efficiency a wheel: the gear's losses hold with it."""
    most = 2 * 20 * 0.004 / 0.8 / R
    for share in (0.98, 1.02):
        steep = evolved(ground, ramp=Ramp(float(np.arcsin(share * most / (30.0 * G)))))
        robot = WheeledRobot(CENTRAL, table(MOTOR), steep).by_voltage()
        q, v, memory = steps(robot, (0.0, 0.0), 0.02, 20)
        if share < 1:
            assert np.abs(q).max() < 1e-14
            assert np.abs(v).max() < 1e-14
            np.testing.assert_allclose(memory.torques, share * most * R / 2, rtol=1e-10)
        else:
            assert v[0] < -1e-5
            np.testing.assert_allclose(memory.torques, MOTOR.torque(0.0, v[-2:]), rtol=1e-2)


def drives() -> dict[str, WheelTable]:
    steered = {"steering": "driven", "motor": MOTOR, **WHEEL}
    differential = WheelTable.differential(0.5, R, motor=MOTOR, **WHEEL)
    front = [Wheel("a", 0.3, 0.2, R, **WHEEL), Wheel("b", 0.3, -0.2, R, **WHEEL)]
    return {
        "mecanum": WheelTable.mecanum(0.5, 0.4, 0.08, motor=MOTOR, **WHEEL),
        "tricycle": WheelTable((Wheel("front", 0.4, 0.0, R, **steered), *differential.wheels)),
        "caster": WheelTable((*differential.wheels, CASTER)),
        "open": WheelTable(tuple(front), couplings=(DifferentialGear(("a", "b"), MOTOR),)),
    }


@pytest.mark.parametrize(("name", "arm"), [(name, name == "tricycle") for name in drives()])
def test_accelerations_are_those_of_the_tree_under_the_torques_of_its_motors(name: str, arm: bool) -> None:
    """Pinocchio's tree with constraint forces, and `Motor.torque`, neither of which the step uses."""
    rng = np.random.default_rng(3)
    base = BODY.mount("ur5") if arm else BODY
    robot = WheeledRobot(base, drives()[name])
    volts = robot.by_voltage()
    q = np.append(base.random_configuration(rng), np.zeros(robot.nq - base.nq))
    v = robot.project(q, rng.normal(size=robot.nv))
    u = rng.normal(size=robot.nu) * [5.0 if each.unit == "V" else 0.5 for each in volts.inputs]
    torques, first = u.copy(), robot.nu - len(robot.table.actuators)
    for k, each in enumerate(robot.table.actuators):
        if each.motor.is_electric:
            rate = np.array(each.column) @ v[base.nv :]
            torques[first + k] = each.motor.torque(u[first + k], rate)
    np.testing.assert_allclose(volts.torques_at(v, u), torques, rtol=1e-12)
    expected = robot.forward_dynamics(q, v, torques)
    found = volts.forward_dynamics(q, v, u)
    assert np.abs(found - expected).max() < 2e-3 * (1 + np.abs(expected).max())


def test_the_volts_for_torques_give_them_within_the_limits_of_motors() -> None:
    robot = WheeledRobot(BODY, table(MOTOR)).by_voltage()
    rng = np.random.default_rng(0)
    v = np.zeros((100, robot.nv))
    v[:, -2:] = rng.uniform(-30.0, 30.0, (100, 2))
    wanted = rng.uniform(-10.0, 10.0, (100, 2))
    u = robot.volts_for(v, wanted)
    given = robot.torques_at(v, u)
    free = np.abs(u) < 24.0 - 1e-9
    free &= np.abs(np.abs(MOTOR.armature_current(u, v[:, -2:])) - 15.0) > 1e-9
    np.testing.assert_allclose(given[free], wanted[free], rtol=1e-10)
    assert 20 < free.sum() < 190


@GROUNDS
def test_driven_follows_as_torques_would(ground: Any) -> None:
    table_ = table(MOTOR)
    wheeled = WheeledRobot(BODY, table_, ground)
    ideal = WheeledRobot(BODY, table_)
    q0, v0 = ideal.start(PATH(0.0))
    controller = TorqueToVoltage(Backstepping(UnicycleTracking(), ideal), wheeled)
    given: Any = {"dt": 0.005, "duration": 2.0, "q0": q0, "v0": v0, "engine": Engine.COMPILED}
    found = pm.simulate(wheeled.by_voltage(), controller, PATH, **given)
    assert found.engine == "COMPILED"
    assert np.abs(found.q[-1, :2] - PATH(2.0).q[:2]).max() < 0.02


@pytest.mark.parametrize("kind", ["skid", "torque"])
def test_wheel_speed_follows_by_loops_of_each_wheel(kind: str) -> None:
    if kind == "skid":
        wheels = WheelTable.skid_steer(0.2, 0.6, R, motor=MOTOR, **{**WHEEL, "friction": WheelFriction()})
    else:
        wheels = table(MOTOR)
    wheeled = WheeledRobot(CENTRAL, wheels)
    robot = wheeled if kind == "torque" else wheeled.by_voltage()
    controller = WheelSpeed(UnicycleTracking(), robot, kp=1.0, ki=20.0)
    q0, v0 = np.append(PATH(0.0).q, np.zeros(robot.nq - 3)), np.zeros(robot.nv)
    given: Any = {"dt": 0.005, "duration": 4.0, "q0": q0, "v0": v0, "engine": Engine.COMPILED}
    found = pm.simulate(robot, controller, PATH, **given)
    assert np.abs(found.q[-1, :2] - PATH(4.0).q[:2]).max() < 0.05


def test_the_integral_of_wheel_speed_does_not_wind_up() -> None:
    robot = WheeledRobot(CENTRAL, table(MOTOR)).by_voltage()
    controller = WheelSpeed(UnicycleTracking(), robot, kp=1.0, ki=20.0)
    none = np.zeros(2)
    state = (None, none, np.array([0.1, -0.1]), np.array([30.0, 30.0]), 0.01)
    _, integral, *_ = controller.applied(np.array([24.0, 24.0]), (None, none + 0.5, *state[2:]))
    np.testing.assert_allclose(integral, [0.4, 0.5])  # what would push it further is taken back


def test_inputs_are_volts_and_torques_with_the_limits_of_motors() -> None:
    wheeled = WheeledRobot(BODY.mount("ur5"), drives()["tricycle"])
    robot = wheeled.by_voltage()
    units = [each.unit for each in robot.inputs]
    assert units == ["N m"] * 6 + ["V", "N m", "V", "V"]
    assert robot.inputs[6].upper == 24.0
    limited = WheeledRobot(BODY, table(Motor(torque_limit=2.0)))
    found = run(limited, (5.0, -5.0), 0.01, 0.1)
    assert (found.u == [2.0, -2.0]).all()  # a motor's limit is part of what is applied
    assert repr(robot).endswith(".by_voltage()")


def test_an_ensemble_spreads_motor_constants() -> None:
    robot = WheeledRobot(BODY, table(MOTOR)).by_voltage()
    where = pm.FixedHeading(pm.Hold([0.0, 0.0], 0.2), 0.0)
    resistance = np.array([1.2, 2.4, 3.6])
    spread = {"left.motor.resistance": resistance}
    found = pm.ensemble(robot, steady(12.0, 12.0), where, dt=0.01, n=3, spread=spread, limit=1e9)
    left, right = robot.table.wheels
    for k, x in enumerate(resistance):
        wheels = evolved(left, motor=evolved(MOTOR, resistance=float(x))), right
        other = WheeledRobot(BODY, WheelTable(wheels, robot.table.supports)).by_voltage()
        alone = run(other, (12.0, 12.0), 0.01, 0.2)
        np.testing.assert_allclose(found.max_error[k], alone.max_error(), rtol=1e-12)
    assert found.engine == "COMPILED"


@pytest.mark.parametrize(
    ("name", "voltage", "stall", "current", "rpm"),
    [
        ("dynamixel_xl430_w250", 11.1, 1.4, 1.3, 57.0),
        ("dynamixel_xm430_w210", 12.0, 3.0, 2.3, 77.0),
        ("pololu_37d_50_12v", 12.0, 0.210 * 9.80665, 5.5, 200.0),
        ("faulhaber_1331t012sr", 12.0, 9.9e-3, 0.876, 9900.0),
    ],
)
def test_real_motors_stall_and_run_free_as_their_sheets_say(
    name: str, voltage: float, stall: float, current: float, rpm: float
) -> None:
    """The last one's sheet has its constants; stall and free run follow, to what it rounds."""
    motor = MOTORS[name]
    rel = 1e-9 if name != "faulhaber_1331t012sr" else 5e-3
    assert motor.stall_torque(voltage) == pytest.approx(stall, rel=rel)
    assert float(motor.armature_current(voltage, 0.0)) == pytest.approx(current, rel=rel)
    assert motor.no_load_rate(voltage) * 60 / (2 * np.pi) == pytest.approx(rpm, rel=rel)
    assert motor.source


OPEN = evolved(drives()["open"], supports=(Support(-0.3, 0.0),))


test_what_has_no_volts_is_refused = refusals(
    (
        lambda: WheeledRobot(BODY, table(Motor())).by_voltage(),
        "table has no electric motor, which takes volts",
    ),
    (lambda: WheeledRobot(BODY, OPEN, Coulomb()).by_voltage(), "slip independently, expected"),
    (lambda: TorqueToVoltage(steady(0.0), BODY), "expected a WheeledRobot with electric motors"),
    (lambda: WheelSpeed(UnicycleTracking(), WheeledRobot(BODY, drives()["tricycle"]), 1.0), "that steer"),
    (lambda: Motor.from_sheet(12.0, 3.0, 1.0, 10.0), "stall_current is 1 A, expected at least 2.5 A"),
)


@pytest.mark.parametrize("torque", [-1e-6, 0.0, 1e-6])
def test_beyond_the_rate_without_load_a_motor_lacks_torque_in_both_directions(torque: float) -> None:
    motor = Motor.from_sheet(12, 0.6, 0.3, 6)  # at 8 rad/s, 12 V brake with .2 N m
    assert motor.margin(np.array(torque), np.array(8.0)) == pytest.approx(-0.2, abs=2e-6)
    assert motor.margin(np.array(-torque), np.array(-8.0)) == pytest.approx(-0.2, abs=2e-6)


def test_the_largest_speed_on_a_circle_is_that_of_the_outer_wheel() -> None:
    motor = Motor.from_sheet(12, 0.6, 0.3, 6)
    wheels = WheelTable.differential(0.288, 0.033, supports=[(-0.1, 0), (0.1, 0)], motor=motor)
    cart = WheeledRobot(MobileRobot(1.6, 0.02, com=(-0.006, 0, 0.02)), wheels)
    speed = max_path_speed(cart, Tangent(Circle(0.5, 0.2, 6.0)), samples=50)
    assert speed.value == pytest.approx(6 * 0.033 / (1 + 0.144 / 0.5), rel=1e-3)
    assert speed.event == "right lacks torque"
