"""Robots on wheels that roll: every route to their dynamics, couplings, runs, and what is refused."""

from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from scipy.integrate import solve_ivp

import pinmobile as pm
from pinmobile import closed_form
from pinmobile.arrays import Array
from pinmobile.forces import SinusoidalForce
from pinmobile.wheels import AckermannSteering, DifferentialGear, GearTrain, Ramp, Wheel
from tests.refusals import begun, refusals, unknown
from tests.wheeled import BODY as BASE, CASTER, CORNERS, WHEEL as OWN, run

BODY: dict[str, Any] = {"mass": 30.0, "yaw_inertia": 2.3, "com": (0.05, 0.02)}
GEARED = pm.Motor(rotor_inertia=1e-4, gear=10)
DIFFERENTIAL = pm.WheelTable.differential(0.5, 0.1, x=0.07, supports=[(-0.2, 0)], motor=GEARED, **OWN)
FRONT = Wheel("front", 0.4, 0.0, 0.1, steering="driven", motor=GEARED, **OWN)
SIDES = [Wheel("l", 0, 0.2, 0.1, **OWN), Wheel("r", 0, -0.2, 0.1, **OWN)]
ROLLING = {
    "differential": DIFFERENTIAL,
    "mecanum": pm.WheelTable.mecanum(0.5, 0.4, 0.08, motor=GEARED, **OWN),
    "O": pm.WheelTable.mecanum(0.6, 0.4, 0.08, roller=-0.7, **OWN),
    "omni": pm.WheelTable.omni(0.25, 0.05, **OWN),
    "four omni": pm.WheelTable.omni(0.25, 0.05, n=4, first=0.3, **OWN),
    "swerve": pm.WheelTable.swerve([(0.3, 0.1), (-0.3, -0.1)], 0.06, supports=[(0, 0.3)], **OWN),
    "car": pm.WheelTable.car(0.6, 0.4, 0.1, motor=GEARED, **OWN),
    "casters": pm.WheelTable((*DIFFERENTIAL.wheels, CASTER)),
    "tricycle": pm.WheelTable((FRONT, *SIDES)),
}
SLIPPING = {
    "skid": pm.WheelTable.skid_steer(0.5, 0.4, 0.1, **OWN),
    "skid apart": pm.WheelTable.skid_steer(0.5, 0.4, 0.1, coupled=False, **OWN),
    "swerve": pm.WheelTable.swerve(CORNERS, 0.06, **OWN),
}


ARMED = BASE.mount("ur5", (0.1, 0, 0.3, 0))
STEP, ROLLS = {"tau", "loads", "cone", "power"}, {"M", "a", "lambda", "nu'", "M of nu"}
TILTED, SLOPE = pm.Rolling(Ramp(0.3, 1.0)), pm.Coulomb(ramp=Ramp(0.2, 0.5))
LIGHT = pm.WheelTable.differential(0.5, 0.1, x=0.07)
VERIFIED: dict[str, tuple[pm.WheelTable, Any, set[str]]] = {
    **{kind: (table, pm.Rolling(), ROLLS) for kind, table in ROLLING.items()},
    **{f"{kind} on a ramp": (ROLLING[kind], TILTED, {"a", "nu'"}) for kind in ("differential", "casters")},
    **{f"{kind}, slipping": (table, pm.Coulomb(), STEP) for kind, table in SLIPPING.items()},
    **{f"{kind} slips": (ROLLING[kind], SLOPE, STEP) for kind in ("casters", "omni")},
}


WITH_ARMS = "differential", "swerve", "car", "casters", "casters on a ramp", "skid, slipping"


@pytest.mark.parametrize("kind", VERIFIED)
def test_every_route_agrees(kind: str) -> None:
    table, ground, wanted = VERIFIED[kind]
    for robot in (BASE, ARMED) if kind in WITH_ARMS else (BASE,):
        verification = pm.verify(pm.WheeledRobot(robot, table, ground), states=10)
        assert verification.passed, str(verification)
        assert not verification.missing or isinstance(ground, pm.Coulomb)
        assert {row.quantity for row in verification.rows} >= wanted
        by_hand = [row.quantity for row in verification.rows if row.against == "closed form by hand"]
        if robot is BASE and kind in ("differential", "mecanum", "omni", "car"):
            assert by_hand == ["M of nu", "n of nu", "B of nu"]


numbers = st.floats(-0.2, 0.2)
sizes = st.floats(0.03, 0.3)


@st.composite
def wheels(draw: st.DrawFn, k: int) -> Wheel:
    kind = draw(st.sampled_from(["tyre", "rollers", "caster", "steered", "offset"]))
    own: dict[str, Any] = {"mass": draw(st.floats(0, 1.5)), "spin_inertia": draw(st.floats(1e-3, 0.05))}
    own["yaw_inertia"] = draw(st.floats(1e-3, 0.02))
    if draw(st.booleans()):
        own["motor"] = pm.Motor(rotor_inertia=draw(st.floats(0, 1e-4)), gear=draw(st.floats(0.5, 30)))
    if kind == "rollers":
        own["roller"] = draw(st.floats(-1.0, 1.0))
    if kind in ("caster", "offset"):
        own["trail"] = (draw(st.floats(-0.1, -0.03)), draw(st.floats(-0.02, 0.02)))
    if kind not in ("tyre", "rollers"):
        own["steering"] = "free" if kind == "caster" else "driven"
    x, y = (draw(numbers) + 0.4 * sign for sign in ((1, 1), (-1, -1), (1, -1), (-1, 1))[k])
    return Wheel(f"w{k}", x, y, draw(sizes), draw(st.floats(-3, 3)), **own)


@given(st.data(), st.integers(1, 4), st.booleans(), st.integers(0, 2**32 - 1))
@settings(max_examples=12)
def test_every_route_agrees_for_any_table(data: st.DataObject, count: int, armed: bool, seed: int) -> None:
    table = pm.WheelTable(tuple(data.draw(wheels(k)) for k in range(count)))
    assume(table.mobility.is_regular)
    robot = pm.MobileRobot(30.0, 4.0, com=(0.05, 0.02, 0.2))
    wheeled = pm.WheeledRobot(robot.mount("double_pendulum") if armed else robot, table)
    verification = pm.verify(wheeled, states=5, seed=seed)
    assert verification.passed, str(verification)


# Couplings, by hand


def test_a_gear_train_turns_wheels_at_a_ratio() -> None:
    """A driven wheel and one of half its size, which a train turns twice as fast."""
    own: dict[str, Any] = {"mass": 0.5, "yaw_inertia": 0.003, "spin_inertia": 0.01}
    inner = Wheel("in", 0, 0.2, 0.1, motor=pm.Motor(), **own)
    free = Wheel("third", -0.3, 0.0, 0.1, roller=0.0, angle=1.2, **own)
    train = (GearTrain(("in", "out"), (1.0, 2.0)),)
    outer = (Wheel("out", x, y, 0.05, roller=0.0, **own) for x, y in ((0, 0.35), (0.3, 0.2)))
    beside, ahead = (pm.WheelTable((inner, each, free), couplings=train) for each in outer)
    assert "different rates" in beside.mobility.rolling_obstacle  # the body may not turn
    wheeled = pm.WheeledRobot(pm.MobileRobot(20.0, 1.5, com=(0.1, 0.05, 0.1)), ahead)
    assert pm.verify(wheeled, states=10).passed
    a = wheeled.forward_dynamics(wheeled.rest, np.zeros(wheeled.nv), [0.4])
    assert a[4] == pytest.approx(2 * a[3], rel=1e-12)


def test_an_open_differential_gives_each_wheel_half() -> None:
    pair = [Wheel("left", 0, 0.25, 0.1, **OWN), Wheel("right", 0, -0.25, 0.1, **OWN)]
    open_one = pm.WheeledRobot(BASE, pm.WheelTable(tuple(pair), (), (DifferentialGear(("left", "right")),)))
    each = pm.WheeledRobot(BASE, pm.WheelTable.differential(0.5, 0.1, **OWN))
    rng = np.random.default_rng(1)
    q = rng.normal(size=each.nq)
    v = each.project(q, rng.normal(size=each.nv))
    a, b = open_one.forward_dynamics(q, v, [0.6]), each.forward_dynamics(q, v, [0.3, 0.3])
    np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-13)


# What is determined (model.md, 2.2)


def test_of_redundant_rows_the_sum_is_determined() -> None:
    wheeled = pm.WheeledRobot(BASE, pm.WheelTable.differential(0.5, 0.1, x=0.07, **OWN))
    rng = np.random.default_rng(3)
    q = rng.normal(size=(20, wheeled.nq))
    v = wheeled.project(q, rng.normal(size=(20, wheeled.nv)))
    u = rng.normal(size=(20, 2))
    found = wheeled.constraint_forces(q, v, u)
    assert dict(zip(found.names, found.determined, strict=True)) == {
        "left rolling": True,
        "left lateral": False,
        "right rolling": True,
        "right lateral": False,
    }
    nu = wheeled.independent(q, v)
    model = closed_form.differential_drive(nu, **BODY, track=0.5, radius=0.1, spin_inertia=0.01, axle=0.07)
    rate = np.linalg.solve(model.M, (np.einsum("nij,nj->ni", model.B, u) - model.n)[..., None])[..., 0]
    spins = np.einsum("nij,ni->nj", model.B, rate)  # the wheels' accelerations
    np.testing.assert_allclose(found.values[:, [0, 2]], (u - 0.01 * spins) / 0.1, atol=1e-11)
    dx, dy, (speed, w) = 0.05 - 0.07, 0.02, nu.T
    lateral = 30 * (speed * w + dx * rate[:, 1] - dy * w**2)
    np.testing.assert_allclose(found.values[:, 1] + found.values[:, 3], lateral, atol=1e-11)
    np.testing.assert_allclose(found.values[:, 1], found.values[:, 3], atol=1e-11)


# What is refused


def table(*rows: Wheel, couplings: tuple[Any, ...] = ()) -> pm.WheelTable:
    return pm.WheelTable(rows, (), couplings)


LITTLE = pm.MobileRobot(1.5, 1.0)


test_bad_input_is_refused_each_with_its_own_words = refusals(
    (lambda: pm.WheeledRobot(BASE, SLIPPING["skid"], TILTED), "table cannot roll without slip: wheels '"),
    (lambda: pm.WheeledRobot(LITTLE, DIFFERENTIAL), "robot has a mass of 1.5 kg, and its wheels 2 kg"),
    (
        lambda: table(Wheel("a", 0, 0, 0.1), Wheel("b", 0, 0, 0.2)),
        "wheel 'a' and wheel 'b' have one position",
    ),
    (lambda: pm.WheelTable.mecanum(0.5, 0.4, 0.1, roller=0.0), "roller is 0 rad on a base of 0.5 by"),
    (lambda: table(Wheel("x", 0.0, 0.2, 0.1)), "table has the coordinate 'x' twice, expected"),
    (lambda: table(*SIDES, couplings=(AckermannSteering(("l", "r")),)), "wheel 'l' of AckermannSteer"),
    by=begun,
)


def test_a_gear_train_of_an_unknown_wheel_is_refused() -> None:
    with unknown("^unknown wheel of a GearTrain 'x'"):
        table(*SIDES, couplings=(GearTrain(("l", "x")),))


def test_a_start_that_does_not_roll_is_refused_and_projected_only_if_asked() -> None:
    wheeled = pm.WheeledRobot(BASE, DIFFERENTIAL)
    v0 = np.array([1.0, 0.2, 0.3, 0, 0])
    words = r"start does not roll: .* slips at .*; expected .* v0 = robot.project"
    with pytest.raises(pm.InvalidArgument, match=words):
        run(wheeled, (0, 0), 0.01, 0.1, v=v0)
    aside = pm.FixedHeading(pm.Spline([[0, 0], [0, 1]], [0, 1], start_velocity=(0, 1)), 0.0)
    words = r"^reference at its start does not roll: .* a reference that"
    with pytest.raises(pm.InvalidArgument, match=words):
        pm.simulate(wheeled, pm.law(lambda t, q, v, reference: np.zeros(2)), aside, dt=0.1)
    found = run(wheeled, (0, 0), 0.01, 0.1, v=wheeled.project(wheeled.rest, v0))
    assert np.abs(wheeled.constraint_matrix(found.q[-1]) @ found.v[-1]).max() < 1e-14


@pytest.mark.parametrize("kind", ["differential", "mecanum", "car", "casters", "massless", "ur5"])
def test_what_is_projected_rolls_and_is_nearest(kind: str) -> None:
    table = {**ROLLING, "massless": LIGHT, "ur5": DIFFERENTIAL}[kind]
    wheeled = pm.WheeledRobot(ARMED if kind == "ur5" else BASE, table)
    rng = np.random.default_rng(5)
    q, v = rng.uniform(-0.5, 0.5, (20, wheeled.nq)), rng.normal(size=(20, wheeled.nv))
    near = wheeled.project(q, v)
    A = wheeled.constraint_matrix(q)
    assert np.abs(np.einsum("nij,nj->ni", A, near)).max() < 1e-13
    np.testing.assert_allclose(wheeled.project(q, near), near, atol=1e-13)
    # What was taken away is orthogonal to what rolls, in the mass metric.
    taken = np.einsum("nij,nj->ni", wheeled.mass_matrix(q), v - near)
    assert np.abs(np.einsum("nij,ni->nj", wheeled.reduced(q, near).S, taken)).max() < 1e-12
    # Independent velocities give the same: rounding, times the condition of M, some thousands.
    traced: Any = wheeled.array_dynamics
    np.testing.assert_allclose(traced.project(q, v), near, atol=1e-11)


# Runs


def by_hand(kind: str, nu: Array, delta: float) -> closed_form.ReducedModel:
    """Return the closed form of a drive."""
    table = ROLLING[kind]
    reflected = GEARED.reflected_inertia
    if kind == "differential":
        own = {"track": 0.5, "radius": 0.1, "spin_inertia": 0.01 + reflected, "axle": 0.07}
        return closed_form.differential_drive(nu, **BODY, **own)
    if kind == "car":
        own = {"wheelbase": 0.6, "track": 0.4, "radius": 0.1, "spin_inertia": 0.01, "steered_inertia": 0.006}
        found = closed_form.car(nu, delta, **BODY, **own)
        M = found.M + np.array([[reflected / 0.1**2, 0], [0, 0]])
        return found._replace(M=M, B=found.B[:, [0, 2]])
    wheel = {name: [getattr(each, name) for each in table.wheels] for name in ("x", "y", "angle", "roller")}
    return closed_form.roller_drive(nu, **BODY, **wheel, radius=0.08, spin_inertia=0.01 + reflected)


RUNS = {"differential": [0.5, 0.62], "mecanum": [0.3, 0.2, -0.1, 0.25], "car": [0.4, 0.0002]}


@pytest.mark.parametrize(
    ("ground", "volts", "engine"),
    [
        (pm.Rolling(), False, pm.Engine.PYTHON),
        (pm.Rolling(), True, pm.Engine.COMPILED),
        (pm.Coulomb(), True, pm.Engine.COMPILED),
    ],
)
def test_a_steering_axis_stays_at_its_stop_and_leaves_it(ground: Any, volts: bool, engine: Any) -> None:
    """It stops within what it turns in a step, and its torque pushes it no further."""
    motor = pm.Motor(resistance=1.0, torque_constant=0.02, voltage=24.0, gear=5.0)
    car = pm.WheelTable.car(0.6, 0.4, 0.1, steering_limit=0.3, **{**OWN, "motor": motor})
    robot: Any = pm.WheeledRobot(pm.MobileRobot(30.0, 3.0, com=(0.3, 0.0, 0.2)), car, ground)
    robot, push = (robot.by_voltage(), 0.1) if volts else (robot, 0.02)
    axis = robot.wheeled.robot.nv if volts else robot.robot.nv
    steered = np.full(robot.nu, push)
    there = pm.law(lambda t, q, v, reference: np.where(t < 2.0, 1.0, -0.5) * steered)
    here = pm.FixedHeading(pm.Hold([0, 0], 4.0), 0.0)
    zeros = {"q0": robot.rest, "v0": np.zeros(robot.nv)}
    angle = pm.simulate(robot, there, here, dt=0.01, limit=1e6, engine=engine, **zeros).q[:, axis]
    step = np.abs(np.diff(angle)).max()
    assert 0.3 - step < angle.max() <= 0.3 + step
    arrived = int(np.argmax(angle > angle.max() - 1e-9))
    assert arrived < 150
    np.testing.assert_allclose(angle[arrived:200], angle.max(), rtol=0, atol=1e-9)
    assert angle[-1] < 0.2
    assert angle.min() >= -0.3 - step


def test_the_plant_s_own_integrator_keeps_to_an_arc_at_speed() -> None:
    """Without torques and with the mass above the axle it goes on along a circle of radius v / w."""
    wheels = pm.WheelTable.differential(0.5, 0.1, supports=[(-0.3, 0)], mass=1.0, spin_inertia=0.005)
    robot = pm.WheeledRobot(pm.MobileRobot(30.0, 1.3, com=(0, 0, 0.2)), wheels)
    v0 = robot.project(robot.rest, [30.0, 0.0, 0.5, *robot.wheel_rates([30.0, 0.0, 0.5])])
    far = []
    for dt in (0.02, 0.01):
        found = run(robot, (0, 0), dt, 10.0, v=v0)
        arc = 60.0 * np.stack([np.sin(0.5 * found.t), 1 - np.cos(0.5 * found.t)], axis=-1)
        far.append(np.abs(found.q[:, :2] - arc).max())
    assert far[1] < 1e-8
    assert far[0] / far[1] > 3.5  # order 2, at least


@pytest.mark.parametrize("kind", RUNS)
def test_a_run_is_that_of_the_dynamics_derived_by_hand(kind: str) -> None:
    """DOP853 of scipy on the closed form, in which nothing can drift."""
    wheeled, u, T = pm.WheeledRobot(BASE, ROLLING[kind]), np.array(RUNS[kind]), 4.0
    push = SinusoidalForce([3.0, 2.0, 1.0], 0.4)
    q0, v0, axes = wheeled.rest.copy(), np.zeros(wheeled.nv), len(wheeled.table.axes)
    q0[2:4], v0[:3] = (0.4, 0.15 * axes), (0.5, 0.2, 0.3)
    v0 = wheeled.project(q0, v0)
    its = run(wheeled, u, 0.005, T, q0, v0, forces=[push])
    first = wheeled.independent(q0, v0)

    def body(y: Array) -> tuple[Array, Array, Array]:
        """Return the twist's columns by nu, nu, and the heading's turn."""
        nu, c, s = y[4:], np.cos(y[2]), np.sin(y[2])
        columns = {
            "differential": np.array([[1, 0], [0, -0.07], [0, 1.0]]),
            "mecanum": np.eye(3),
            "car": np.array([[1, 0], [0, 0], [np.tan(y[3]) / 0.6, 0]]),
        }[kind]
        return columns, nu, np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])

    def rates(t: float, y: Array) -> Array:
        columns, nu, R = body(y)
        model = by_hand(kind, nu, y[3])
        force = model.B @ u + columns.T @ (R.T @ push(t, y[:3], R @ (columns @ nu))) - model.n
        return np.concatenate([R @ (columns @ nu), [nu[-1] * axes], np.linalg.solve(model.M, force)])

    start = np.concatenate([q0[:3], [0.15 * axes], first])
    samples = its.t[::40]
    found = solve_ivp(rates, (0, T), start, "DOP853", samples, rtol=1e-12, atol=1e-13)
    assert found.success
    y = found.y.T
    np.testing.assert_allclose(its.q[::40, :3], y[:, :3], atol=1e-8)
    if axes:
        np.testing.assert_allclose(its.q[::40, 3], y[:, 3], atol=1e-8)
    np.testing.assert_allclose(wheeled.independent(its.q, its.v)[::40], y[:, 4:], atol=1e-8)
    drift = np.einsum("nij,nj->ni", wheeled.constraint_matrix(its.q), its.v)
    assert np.abs(drift).max() < 1e-14
