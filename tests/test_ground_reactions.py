"""What base and ground bear: wrenches, balance, loads, slip margins, fastest speeds, steepest ramps."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinmobile as pm
from pinmobile import Coulomb, Motor, Rolling, WheeledRobot, WheelTable, balance
from pinmobile.arrays import Array
from pinmobile.balance import (
    MotionStates,
    body_zero_moment_point,
    contact_loads,
    max_path_speed,
    max_slope,
    reaction_wrench,
    required_friction,
    slip_margins,
    tip_over_margin,
    zero_moment_point,
)
from pinmobile.controllers import PD, Backstepping, ControlAllocation, UnicycleTracking
from pinmobile.errors import UnknownName
from pinmobile.robot import BODY_JOINT
from pinmobile.robot.support_geometry import margin_inside
from pinmobile.wheels import Ramp, Support, Wheel, WheelFriction
from tests.refusals import refusals, refused
from tests.users import Follower, TwoWheels
from tests.wheeled import BODY, CASTER, WHEEL, G

DIFFERENTIAL = WheelTable.differential(0.5, 0.1, x=0.07, supports=[(-0.2, 0.0)], **WHEEL)
FRONT = Wheel("front", 0.4, 0.0, 0.1, steering="driven", motor=Motor(rotor_inertia=1e-4, gear=10), **WHEEL)
TABLES = {
    "differential": DIFFERENTIAL,
    "caster": WheelTable((*WheelTable.differential(0.5, 0.1, **WHEEL).wheels, CASTER)),
    "mecanum": WheelTable.mecanum(0.5, 0.4, 0.08, **WHEEL),
    "omni": WheelTable.omni(0.25, 0.05, **WHEEL),
    "tricycle": WheelTable((FRONT,), (Support(-0.2, 0.2), Support(-0.2, -0.2))),
    "car": WheelTable.car(0.6, 0.4, 0.1, **WHEEL),
}
BENT = BODY.mount("ur5").rest[3:]


def moving(robot: WheeledRobot, seed: int = 0) -> Any:
    """Return a state that rolls, with its acceleration and input."""
    rng = np.random.default_rng(seed)
    n, k = robot.robot.nq, len(robot.table.axes)
    q = rng.normal(size=robot.nq)
    q[:n] = robot.robot.random_configuration(rng)
    q[n : n + k] = rng.uniform(-0.5, 0.5, k)
    u, v = rng.normal(size=robot.nu), robot.project(q, rng.normal(size=robot.nv))
    return SimpleNamespace(plant=robot, q=q, v=v, a=robot.forward_dynamics(q, v, u), u=u)


def touching(robot: WheeledRobot, q: Array) -> Array:
    """Return where wheels and supports touch the ground, in the body's frame."""
    n, found = robot.robot.nq, []
    steered = {row: k for k, axis in enumerate(robot.table.axes) for row in axis.wheels}
    for row, wheel in enumerate(robot.table.wheels):
        angle = wheel.angle + (q[n + steered[row]] if row in steered else 0.0)
        c, s = np.cos(angle), np.sin(angle)
        o, p = wheel.trail
        found.append((wheel.x + c * o - s * p, wheel.y + s * o + c * p))
    return np.array([*found, *((each.x, each.y) for each in robot.table.supports)])


@pytest.mark.parametrize("name", TABLES)
def test_loads_balance_what_the_tree_of_bodies_needs(name: str) -> None:
    robot = WheeledRobot(BODY.mount("ur5"), TABLES[name], Rolling(ramp=Ramp(0.2, 0.5)))
    at = moving(robot)
    wrench = robot.ground_wrench(at.q, at.v, at.a)
    found = contact_loads(at)
    x, y = touching(robot, at.q).T
    sums = [found.springs.sum(), found.springs @ y, -found.springs @ x]
    np.testing.assert_allclose(sums, wrench[2:5], rtol=0, atol=1e-12)
    supports = (f"support {k + 1}" for k in range(len(x) - len(robot.table)))
    assert found.names == (*robot.table.names, *supports)
    if not found.tips:
        x_z, y_z = balance.body_zero_moment_point(at)
        np.testing.assert_allclose(found.values @ x / found.values.sum(), x_z, atol=1e-13)
        np.testing.assert_allclose(found.values @ y / found.values.sum(), y_z, atol=1e-13)
        assert (found.values >= 0).all()


@pytest.mark.parametrize("name", [name for name in TABLES if name != "car"])
def test_forces_of_wheels_are_those_of_constraints(name: str) -> None:
    robot = WheeledRobot(BODY.mount("ur5"), TABLES[name])
    at = moving(robot, 1)
    found, loads = slip_margins(at), contact_loads(at).values
    forces = robot.constraint_forces(at.q, at.v, at.u)
    by_name = dict(zip(forces.names, forces.values, strict=True))
    for k, wheel in enumerate(robot.table.names):
        row = f"{wheel} rolling" if f"{wheel} rolling" in by_name else f"{wheel} roller"
        np.testing.assert_allclose(found.along[k], by_name[row], atol=1e-12)
    for group, across, margin in zip(found.names, found.across, found.values, strict=True):
        own = group.split(" + ")
        np.testing.assert_allclose(across, sum(by_name.get(f"{one} lateral", 0.0) for one in own), atol=1e-12)
        rows = [robot.table.names.index(one) for one in own]
        most, along = 0.8 * loads[rows], found.along[rows]
        if len(own) == 1:
            np.testing.assert_allclose(margin, most[0] - np.hypot(along[0], across), atol=1e-12)
        elif (most > np.abs(along)).all():
            expected = np.sqrt(most**2 - along**2).sum() - abs(across)
            np.testing.assert_allclose(margin, min(expected, (most - np.abs(along)).min()), atol=1e-12)


def test_a_wheel_that_would_pull_has_lifted_off() -> None:
    body = pm.MobileRobot(30.0, 2.3, com=(0.0, 0.0, 0.2))
    robot = WheeledRobot(body, WheelTable.mecanum(0.5, 0.4, 0.08, **WHEEL))
    still, a = np.zeros(robot.nv), np.zeros(robot.nv)
    a[:2] = 6.0, 6.0
    found = contact_loads(MotionStates(robot, robot.rest, still, a))
    assert found.springs.min() < 0
    assert found.values.min() == 0
    assert not found.tips
    np.testing.assert_allclose(found.values.sum(), 30 * G)
    assert contact_loads(MotionStates(robot, robot.rest, still, 4 * a)).tips


def test_a_wheel_that_lifts_off_lets_no_robot_tip_over() -> None:
    robot = WheeledRobot(pm.MobileRobot(30, 1.3, com=(0.15, 0.125, 0.2)), WheelTable.mecanum(0.4, 0.5, 0.1))
    place = pm.FixedHeading(pm.Hold((0, 0), 0.1), 0)
    run = pm.simulate(robot, pm.ComputedTorque(robot), place, dt=0.01)
    loads = contact_loads(run).values[0]
    table = robot.table
    x, y = (np.array([getattr(wheel, name) for wheel in table.wheels]) for name in "xy")
    np.testing.assert_allclose([loads.sum(), x @ loads, y @ loads], 30 * G * np.array([1, 0.15, 0.125]))
    assert loads.min() == 0
    assert tip_over_margin(run).min() == pytest.approx(0.05)
    assert run.metrics()["load"].values.max() == 0
    (lift,) = run.events
    assert (lift.kind, lift.name, lift.samples) == ("lift", "rear_right", len(run))


def test_a_driven_wheel_in_the_air_is_an_event_until_it_is_down_again() -> None:
    body = pm.MobileRobot(30, 1.3, com=(0.12, 0.12, 0.2))
    robot = WheeledRobot(body, WheelTable.mecanum(0.5, 0.4, 0.1, spin_inertia=0.01), pm.Coulomb())
    law, hold = pm.law(lambda t, q, v, reference: np.ones(4)), pm.FixedHeading(pm.Hold((0, 0), 1.0), 0)
    run = pm.simulate(robot, law, hold, dt=0.01)
    lift, in_air = next(x for x in run.events if x.kind == "lift"), run.signals["loads"].values[:, 3] == 0
    assert (lift.name, lift.t, lift.samples) == ("rear_right", 0.0, in_air.sum())
    # Nothing but its own inertia holds it: 1 N m / 0.01 kg m^2.
    np.testing.assert_allclose(np.diff(run.v[:, -1])[in_air[1:]], 100 * 0.01)


def test_balance_takes_robots_on_wheels_with_arms() -> None:
    arm = BODY.mount("ur5", (0.1, 0.0, 0.3, 0.0))
    robot = WheeledRobot(arm, DIFFERENTIAL)
    at, mine = still(robot), still(arm)
    for function in (balance.reaction_wrench, balance.zero_moment_point, balance.required_friction):
        np.testing.assert_allclose(function(at), function(mine), atol=1e-11)
    assert tip_over_margin(at) == tip_over_margin(mine, robot.footprint)
    # Wheels that turn faster push back on the body: the moment of their spin.
    faster = np.append(np.zeros(robot.nv - 2), [10.0, 10.0])
    change = robot.ground_wrench(robot.rest, 0 * faster, faster) - robot.ground_wrench(at.q, at.v, at.a)
    np.testing.assert_allclose(change, [0, 0, 0, 0, 2 * 0.01 * 10, 0], atol=1e-12)


def test_an_arm_at_rest_on_a_ramp_weighs_on_its_mount_along_the_slope_too() -> None:
    """It exerts its weight m g, and about the mount the moment of that at its centre of mass."""
    robot = WheeledRobot(BODY.mount("ur5", (0.1, -0.05, 0.3, 0.4)), DIFFERENTIAL)
    q, still = robot.rest.copy(), np.zeros(robot.nv)
    q[3:9], q[2] = [0.3, -1.2, 1.6, -0.4, 1.57, 0.2], 0.7
    level = balance.reaction_wrench(MotionStates(robot, q, still, still))
    weight = -level[2]
    x, y = level[4] / weight, -level[3] / weight
    angle, direction = 0.2, 0.5
    found = balance.reaction_wrench(MotionStates(robot.on_ramp(angle, direction), q, still, still))
    down = np.array([*(-np.sin(angle) * np.array([np.cos(direction - 0.7), np.sin(direction - 0.7)])), 0])
    down[2] = -np.cos(angle)
    np.testing.assert_allclose(found[:3], weight * down, rtol=1e-12)
    np.testing.assert_allclose(found[:3] @ found[3:], 0, atol=1e-9)  # a single force at the centre of mass
    np.testing.assert_allclose(found[5], weight * (x * down[1] - y * down[0]), rtol=1e-10)


def test_a_turn_too_fast_slides() -> None:
    mu = 0.8
    own: dict[str, Any] = {**WHEEL, "friction": WheelFriction(mu=mu, rolling=0.0)}
    table = WheelTable.differential(0.5, 0.1, supports=[(0.25, 0.0), (-0.25, 0.0)], **own)
    body, path = pm.MobileRobot(27.0, 2.3, com=(0.0, 0.0, 0.15)), pm.Circle(2, 0.2, 10)
    found = max_path_speed(WheeledRobot(body, table), pm.Tangent(path))
    assert found.event == "left + right slip"
    # Half of the weight is on the wheels, and forces along them are small where speed does not change.
    assert found.value == pytest.approx(np.sqrt(2 * mu * G / 2), rel=0.04)
    higher = WheeledRobot(pm.MobileRobot(27.0, 2.3, com=(0.0, 0.0, 0.4)), table)
    assert max_path_speed(higher, pm.Tangent(path)).value <= found.value
    # Driven faster than that on ground that slips, it slides; slower, it sticks.
    for factor, slides in ((0.97, False), (1.1, True)):
        rate = factor * found.value
        robot, way = WheeledRobot(body, table, Coulomb()), pm.Tangent(pm.Circle(2, rate / 2, 1.5))
        law = ControlAllocation(PD(400, 60), WheeledRobot(body, table))
        run = pm.simulate(robot, law, way, dt=0.005, engine=pm.Engine.COMPILED)
        assert (run.metrics()["slip"][1].max() > 1e-3) == slides


def test_the_steepest_ramp_is_that_of_friction_and_weight() -> None:
    central = pm.MobileRobot(30.0, 2.3, com=(0.0, 0.0, 0.1))
    table = WheelTable.mecanum(0.5, 0.4, 0.08, friction=WheelFriction(mu=0.3), **WHEEL)
    for direction in (0.0, np.pi / 2):  # rollers hold along their axes, at half a right angle
        found = max_slope(WheeledRobot(central, table), direction)
        assert 0.15 < found.value < np.arctan(0.3)
        assert found.event.endswith("slips")
    # A support lifts where the weight points past the contacts that are left, here the axle.
    high = pm.MobileRobot(30.0, 2.3, com=(-0.08, 0.0, 0.2))
    friction = WheelFriction(mu=9.0)
    rough = WheelTable.differential(0.5, 0.1, supports=[(0.2, 0.0)], x=-0.2, friction=friction, **WHEEL)
    found = max_slope(WheeledRobot(high, rough))
    assert found.event == "support 1 lifts"
    np.testing.assert_allclose(np.tan(found.value), 0.12 / 0.2, rtol=1e-9)


def test_a_motor_s_torque_limits_the_ramp_and_less_of_it_at_speed_the_path() -> None:
    """Of 300 kg, m g sin(angle) r = 2 tau; and tau falls from stall to none at the rate of the free run."""
    motor, friction = Motor.from_sheet(24, 10, 20, 20), WheelFriction(mu=0.8, rolling=0.0)
    table = WheelTable.differential(0.5, 0.1, supports=[(0.3, 0.0)], motor=motor, friction=friction, **WHEEL)
    robot = WheeledRobot(pm.MobileRobot(300.0, 20.0, com=(0.1, 0.0, 0.2)), table)
    assert [(one.lower, one.upper) for one in robot.inputs] == [(-10.0, 10.0)] * 2
    found = max_slope(robot)
    assert found.event.endswith("lacks torque")
    np.testing.assert_allclose(300 * G * np.sin(found.value) * 0.1, 20.0, rtol=1e-9)
    along = max_path_speed(robot, pm.Tangent(pm.Line((0, 0), (10, 0), 10)))
    assert along.value == pytest.approx(20 * 0.1)
    assert along.event.endswith("lacks torque")
    # On a circle of radius R, w = v / R, the outer wheel drives with m x w r (v / b - w) / 2.
    x, b, r, R = 0.1, 0.25, 0.1, 2.0
    v = max_path_speed(robot, pm.Tangent(pm.Circle(R, 0.2, 10))).value
    drives = 300 * x * (v / R) * r * (v / b - v / R) / 2
    np.testing.assert_allclose(drives, 10 * (1 - v * (1 + b / R) / r / 20), rtol=1e-6)
    # An arm's joints count too.
    arm = WheeledRobot(robot.robot.mount("ur5").attach(pm.PayloadBody(60.0), "ur5/tool0"), table)
    with refused(r"at rest: ur5/\w+_joint lacks torque"):
        max_path_speed(arm, pm.Tangent(pm.Line((0, 0), (10, 0), 10)))


def test_what_rolls_is_judged_alike_in_all_engines() -> None:
    robot = WheeledRobot(BODY.mount("ur5"), TABLES["mecanum"])
    names = "end effector", "end effector angle", "tip-over margin", "load", "tip over", "slip margin"
    limits = "exceed a position limit", "exceed a speed limit"
    assert tuple(one.name for one in robot.metrics) == (*names, *limits)
    path = pm.WholeBody(robot.robot, pm.Tangent(pm.Circle(2, 0.3, 0.1)), pm.RestToRest(BENT, BENT + 0.1, 0.1))
    law = pm.ComputedTorque(robot)
    run, other = (pm.simulate(robot, law, path, dt=0.01, engine=engine) for engine in pm.Engine)
    judged, fast = run.metrics(), other.metrics()
    for name, (_, values) in judged.items():
        np.testing.assert_allclose(fast[name][1], values, atol=1e-7)
    np.testing.assert_allclose(judged["slip margin"][1], slip_margins(run).values.min(axis=1), atol=1e-9)
    loads = contact_loads(run)
    assert 0 < loads.tips.sum() < len(run)
    least = np.where(loads.tips, loads.springs.min(axis=1), loads.values.min(axis=1))
    np.testing.assert_allclose(judged["load"][1], least, atol=1e-9)
    np.testing.assert_allclose(judged["tip-over margin"][1], tip_over_margin(run), atol=1e-11)
    # In ensembles the law of the metrics is part of the loop, and compiled as that is.
    worst = [
        min(values) if one.is_margin else max(values)
        for one, (_, values) in zip(robot.metrics, judged.values(), strict=True)
    ]
    for engine in (pm.Engine.COMPILED, pm.Engine.PYTHON):
        spread: dict[str, Any] = {"mass": pm.Uniform(30.0, 30.0 + 1e-12)}
        each = pm.ensemble(robot, law, path, n=2, spread=spread, dt=0.01, engine=engine)
        np.testing.assert_allclose(each.worst_metric, [worst, worst], atol=1e-7)


def test_ensembles_tell_how_many_would_slip() -> None:
    table = WheelTable.differential(0.5, 0.1, supports=[(0.25, 0), (-0.25, 0)], **WHEEL)
    body, path = pm.MobileRobot(27.0, 2.3, com=(0.0, 0.0, 0.15)), pm.Tangent(pm.Circle(2, 0.8, 1))
    robot = WheeledRobot(body, table)
    spread: Any = {
        "left.friction.mu": pm.Uniform(0.1, 0.5),
        "right.friction.mu": pm.SameAs("left.friction.mu"),
        "left.y": pm.Normal(0.25, 0.001),
        "right.y": pm.SameAs("left.y", -1.0),
        "com.z": pm.Uniform(0.1, 0.2),
    }
    law = Backstepping(UnicycleTracking(), robot)
    rolling = pm.ensemble(robot, law, path, n=60, dt=0.005, spread=spread, seed=1)
    slides = rolling.largest("slip margin") < 0
    # With half of the weight on the wheels, v^2 / R = mu g / 2 where it begins.
    mu = rolling.draws["left.friction.mu"]
    assert 0.2 < slides.mean() < 0.8
    assert mu[slides].max() < 1.05 * 2 * 1.6**2 / 2 / G < 1.1 * mu[~slides].min()
    assert rolling.worst(1, by="slip margin")[0] == rolling.largest("slip margin").argmin()


LINE = WheeledRobot(BODY, WheelTable.differential(0.5, 0.1, **WHEEL))
ROLLS = WheeledRobot(BODY, DIFFERENTIAL)
SKID = WheeledRobot(BODY, WheelTable.skid_steer(0.5, 0.4, 0.1, **WHEEL))
CIRCLE = pm.Tangent(pm.Circle(2, 0.2, 10))


def still(robot: Any, u: Any = None) -> MotionStates:
    """Return a robot at rest."""
    return MotionStates(robot, robot.rest, np.zeros(robot.nv), np.zeros(robot.nv), u)


test_what_is_not_known_is_refused = refusals(
    (lambda: contact_loads(still(LINE)), "^table has 2 contacts on one line"),
    (lambda: slip_margins(still(SKID, np.zeros(SKID.nu))), "^motion has no signals"),
    (lambda: max_path_speed(SKID, CIRCLE), "cannot roll without slip"),
    (lambda: max_path_speed(ROLLS, CIRCLE), "^reference differs by"),
)


def test_a_robot_on_one_line_has_no_margins() -> None:
    assert (LINE.metrics, LINE.footprint) == ((), None)


def test_a_robot_by_voltage_tells_loads_and_takes_no_volts_for_torques() -> None:
    motor = Motor(resistance=1.0, torque_constant=0.03, voltage=24.0, gear=20.0)
    table = WheelTable.differential(0.5, 0.1, supports=[(0.2, 0.0), (-0.2, 0.0)], motor=motor, **WHEEL)
    robot = WheeledRobot(BODY, table)
    electric = robot.by_voltage()
    at = still(electric, [12.0, 12.0])
    np.testing.assert_array_equal(contact_loads(at).values, contact_loads(still(robot)).values)
    with refused(r"^motion.plant is ByVoltage\(...\), .* simulate motion"):
        slip_margins(at)
    names, fast = ["effort", "load", "tip over"], "exceed a speed limit"
    assert [one.name for one in electric.metrics] == [*names, fast]
    assert [one.name for one in robot.metrics] == [*names, "slip margin", fast, "exceed an effort limit"]
    assert max_slope(electric) == max_slope(robot)


@pytest.mark.parametrize("ground", [Rolling(Ramp(0.1)), Coulomb()])
@pytest.mark.parametrize("body", [BODY, BODY.mount("ur5", at=(0.1, 0, 0.3, 0))])
def test_metrics_of_a_motion_by_voltage_are_those_of_its_torques(body: Any, ground: Any) -> None:
    motor = Motor(resistance=0.4, torque_constant=0.05, voltage=48.0, gear=30.0)
    wheels = WheelTable.differential(0.5, 0.1, motor=motor, **WHEEL).wheels
    robot = WheeledRobot(body, WheelTable((*wheels, CASTER)), ground)
    q = np.append(body.rest, np.zeros(robot.nq - body.nq))
    v, a, u = np.full(robot.nv, 0.3), np.ones(robot.nv), np.full(robot.nu, 2.0)
    names = [metric.name for metric in robot.metrics]
    states = q, v, a, u, pm.Reference(body.rest, *np.zeros((2, body.nv)))
    torques, volts = (plant.evaluate_metrics(0, *states) for plant in (robot, robot.by_voltage()))
    for metric, x in zip(robot.by_voltage().metrics, volts, strict=True):
        if metric.name != "effort":
            assert x == torques[names.index(metric.name)], metric.name


# -- what the base feels ---------------------------------------------------------------------------


AT = (0.1, -0.05, 0.2, 0.4)
BOX = pm.MobileRobot.box()
UR5 = BOX.mount("ur5", AT).attach(pm.PayloadBody(2.0, (0.02, 0, 0.1)))
TWO = (
    BOX.mount("panda", AT).mount("kinova", (-0.1, 0.1, 0.2, -1.0)).attach(pm.PayloadBody(1.5, (0, 0.1, 0.1)))
)
HEIGHT = 0.1  # of the box's centre of mass [m]


def motion(robot: pm.MobileRobot, count: int = 6) -> MotionStates:
    rng = np.random.default_rng(11)
    v, a = rng.normal(size=(2, count, robot.nv))
    return MotionStates(robot, robot.random_configuration(rng, (count,)), v, a)


def planar(a: Any, v: Any = (0, 0, 0), psi: float = 0.7, robot: pm.MobileRobot = BOX) -> MotionStates:
    return MotionStates(robot, (1.0, 2.0, psi), v, a)


def momentum_rate(moving: Any, inertias: dict[int, pin.Inertia]) -> Array:
    """Return force and moment about the world's origin that bodies on joints need, from their poses alone.

    With p = T r of a body's points, the sums over its mass of p'' and p x p'' are in T'' J T', where J is the
    sum of r r' (4 x 4): differences of poses in time are all that is needed.
    """
    robot, h = moving.plant, 2e-3

    def poses(t: float) -> Array:
        displacement = t * moving.v + 0.5 * t * t * moving.a
        return np.asarray(robot.frame_placements(robot.integrate(moving.q, displacement)))

    stencil = ((-2, -1), (-1, 16), (0, -30), (1, 16), (2, -1))
    second = np.sum([weight * poses(k * h) for k, weight in stencil], axis=0) / (12 * h * h)
    second[..., 2, 3] += G
    T, total = poses(0.0), np.zeros((*np.shape(moving.q)[:-1], 4, 4))
    for joint, body in inertias.items():
        J = np.array(pin.PseudoInertia.FromInertia(body).toMatrix())
        total += second[..., joint - 1, :, :] @ J @ np.swapaxes(T[..., joint - 1, :, :], -1, -2)
    turned = [total[..., k, j] - total[..., j, k] for j, k in ((1, 2), (2, 0), (0, 1))]
    return np.concatenate([total[..., :3, 3], np.stack(turned, -1)], -1)


def seen_from(wrench: Array, moving: Any, point: Array) -> Array:
    """Return a wrench about the world's origin about a point of the body, along the body's axes."""
    T = moving.plant.frame_placements(moving.q)[..., BODY_JOINT - 1, :, :]
    origin = T[..., :3, :3] @ point + T[..., :3, 3]
    moment = wrench[..., 3:] - np.cross(origin, wrench[..., :3])
    return np.concatenate([part[..., None, :] @ T[..., :3, :3] for part in (wrench[..., :3], moment)], -1)[
        ..., 0, :
    ]


# Fourth-order differences with h = 2 ms: truncated to 1e-10, rounded to eps / h^2 = 6e-11, times 100 kg.
DIFFERENCES: dict[str, Any] = {"rtol": 1e-6, "atol": 1e-6}


def test_the_arms_reaction_is_its_weight_less_the_rate_of_its_momentum() -> None:
    moving, model = motion(TWO), TWO.model
    for mount in TWO.mounts:
        bodies = {joint: model.inertias[joint] for joint in range(mount.joints.start, mount.joints.stop)}
        bodies[BODY_JOINT] = mount.placement.act(mount.model.inertias[0])
        expected = -seen_from(momentum_rate(moving, bodies), moving, np.array(mount.at[:3]))
        np.testing.assert_allclose(reaction_wrench(moving, mount.name), expected, **DIFFERENCES)


@pytest.mark.parametrize("robot", [BOX, TWO], ids=["box", "two arms"])
def test_the_grounds_wrench_is_the_rate_of_all_momentum(robot: pm.MobileRobot) -> None:
    moving, model = motion(robot), robot.model
    bodies = {joint: model.inertias[joint] for joint in range(BODY_JOINT, model.njoints)}
    expected = seen_from(momentum_rate(moving, bodies), moving, np.zeros(3))
    wrench = robot.ground_wrench(moving.q, moving.v, moving.a)
    np.testing.assert_allclose(wrench, expected, **DIFFERENCES)
    # And its part in the plane is the generalised force of the base.
    tau = robot.inverse_dynamics(moving.q, moving.v, moving.a)
    cos, sin = np.cos(np.asarray(moving.q)[:, 2]), np.sin(np.asarray(moving.q)[:, 2])
    np.testing.assert_allclose(cos * wrench[:, 0] - sin * wrench[:, 1], tau[:, 0], atol=1e-10)
    np.testing.assert_allclose(wrench[:, 5], tau[:, 2], atol=1e-10)


def test_acceleration_shifts_it_back_by_h_a_over_g() -> None:
    a = np.array([[1.5, 0, 0], [0, -2.0, 0], [0, 0, 3.0]])
    np.testing.assert_allclose(zero_moment_point(planar(a)), [1, 2] - HEIGHT * a[:, :2] / G, atol=1e-15)
    np.testing.assert_allclose(required_friction(planar(a)), np.hypot(*a[:, :2].T) / G, atol=1e-15)


def test_the_margin_is_zero_where_the_body_begins_to_tip() -> None:
    # Braking so hard that gravity and inertia point at the front edge: a / g = (l / 2) / h.
    for share, sign in ((0.99, 1), (1.01, -1)):
        margin = tip_over_margin(planar((-share * G * 0.3 / HEIGHT, 0, 0), psi=0.0))
        assert np.sign(margin) == sign
        assert abs(margin) == pytest.approx(0.003, rel=1e-9)


def lifting(upwards: float) -> MotionStates:
    """Return a robot with a heavy load at the tip of its arm, which accelerates upwards."""
    robot = BOX.mount("ur5", AT).attach(pm.PayloadBody(300.0))
    q = robot.rest
    a = np.zeros(9)
    a[3:] = np.linalg.lstsq(robot.frame_jacobian(q)[:3, 3:], [0, 0, upwards], rcond=None)[0]
    return MotionStates(robot, q, np.zeros(9), a)


def test_where_the_ground_would_have_to_pull_the_answers_say_so() -> None:
    held, pulled = lifting(-5.0), lifting(-20.0)
    assert np.isfinite(zero_moment_point(held)).all()
    assert np.isnan(zero_moment_point(pulled)).all()
    assert tip_over_margin(pulled) == -np.inf
    assert required_friction(pulled) == np.inf


SQUARE = ((0, 0), (2, 0), (2, 2), (0, 2))


@pytest.mark.parametrize("corners", [SQUARE, SQUARE[::-1], (*SQUARE[:2], (2, 1), *SQUARE[2:])])
def test_the_distance_from_the_edge_is_signed_and_to_the_corner_outside(corners: Any) -> None:
    moving = MotionStates(BOX, np.zeros(3), np.zeros(3), np.zeros(3))  # its point is the origin: a corner
    assert tip_over_margin(moving, corners) == pytest.approx(0, abs=1e-15)
    points = np.array([[1, 1], [1, 0.25], [5, 6], [1, -3], [np.nan, 0]])
    margin = margin_inside(np.array(SQUARE, dtype=float), points)
    np.testing.assert_allclose(margin, [1, 0.25, -5, -3, np.nan], atol=1e-15)
    outside = margin_inside(np.array(SQUARE, dtype=float), np.array([[1, -1e-15], [1, -1e-6]]))
    assert outside[0] >= 0 > outside[1]  # rounding is no edge passed


def test_a_footprint_is_in_the_bodys_frame() -> None:
    moving = MotionStates(BOX, (5.0, 6.0, np.pi / 2), np.zeros(3), np.zeros(3))
    assert tip_over_margin(moving, [(-0.1, -1), (0.7, -1), (0.7, 1), (-0.1, 1)]) == pytest.approx(0.1)


def test_a_footprint_that_is_not_convex_is_refused() -> None:
    with pytest.raises(pm.InvalidArgument, match=r"footprint is not convex at the corner \[0.5, 0.5\]"):
        tip_over_margin(planar((0, 0, 0)), [(0, 0), (2, 0), (0.5, 0.5), (0, 2)])


class Standing(TwoWheels):
    """Two wheels and a castor that tell what the ground bears, the centre of mass 0.3 m above it."""

    footprint = np.array([(-0.3, 0.0), (0.1, -0.2), (0.1, 0.2)])

    def pose(self, q: Array) -> Array:
        return q[..., :3]

    def ground_wrench(self, q: Array, v: Array, a: Array) -> Array:
        psi = q[..., 2]
        ahead = self.mass * (np.cos(psi) * a[..., 0] + np.sin(psi) * a[..., 1])
        left = self.mass * (np.cos(psi) * a[..., 1] - np.sin(psi) * a[..., 0])
        weight = np.full_like(ahead, self.mass * G)
        turning = self.yaw_inertia * a[..., 2]
        return np.stack([ahead, left, weight, -0.3 * left, 0.3 * ahead, turning], axis=-1)


def test_a_plant_of_ones_own_that_tells_what_the_ground_bears_stands_or_tips() -> None:
    path = pm.Tangent(pm.Circle(2, 0.25, 2))
    run = pm.simulate(Standing(), Follower(), path, dt=0.02, integrator=pm.rk4)
    inward = run.a[:, 1] * np.cos(run.q[:, 2]) - run.a[:, 0] * np.sin(run.q[:, 2])
    ahead = run.a[:, 0] * np.cos(run.q[:, 2]) + run.a[:, 1] * np.sin(run.q[:, 2])
    point = np.stack([-0.3 * ahead / G, -0.3 * inward / G], axis=-1)
    np.testing.assert_allclose(body_zero_moment_point(run), point, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(tip_over_margin(run), margin_inside(Standing.footprint, point))
    np.testing.assert_allclose(required_friction(run), np.hypot(ahead, inward) / G, rtol=0, atol=1e-13)
    with pytest.raises(pm.InvalidArgument, match="does not compute the wrench of an arm"):
        reaction_wrench(run)
    plant: Any = run.plant
    plant.footprint = Standing.footprint[::-1]  # clockwise
    np.testing.assert_array_equal(tip_over_margin(run), margin_inside(Standing.footprint, point))
    plant.ground_wrench = lambda q, v, a: np.zeros(3)
    with pytest.raises(pm.InvalidArgument, match=r"(?s)ground_wrench of motion.plant.*has shape"):
        required_friction(run)


def test_what_has_no_arm_is_refused() -> None:
    with pytest.raises(UnknownName, match="unknown mount 'arm', available: ur5"):
        reaction_wrench(MotionStates(UR5, UR5.rest, np.zeros(UR5.nv), np.zeros(UR5.nv)), "arm")
    with pytest.raises(pm.InvalidArgument, match="robot carries no arm, expected a robot with one"):
        reaction_wrench(planar((0, 0, 0)))
