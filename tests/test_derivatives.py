"""Gradients of closed loops: forward beside reverse mode, both beside differences of runs."""

import inspect
from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile import controllers, forces, integrators, robot, wheels
from pinmobile.derivatives import Gradient, gradient, poles
from pinmobile.loop import Loop, Samples, errors_of, select_integrator, start_of
from pinmobile.parts import evolved, named, parts_of, replace
from tests.frozen import BODY, CIRCLE, MOTOR, WHEEL, WRONG, by_lapack, loops, table, turning
from tests.quick import every_fifth
from tests.test_every_number import by_compiled, context_of, varied

DT, DURATION = 0.01, 1.5
DRY = ("differential Coulomb", "mecanum Coulomb", "skid-steer")
LOOPS = {name: (parts, options) for name, parts, options in (*loops(), *by_lapack())}


def others() -> dict[str, Any]:
    """Return loops with the parts that the loops above do not have."""
    commanded = pm.VelocityRobot([0.26, 0.25, 0.03, 1.1, 0.2, 1.2], accelerations=(2.0, 4.0))
    drive = pm.WheeledRobot(BODY, table("differential"))
    car = pm.WheeledRobot(BODY, pm.WheelTable.car(0.5, 0.4, 0.1, **WHEEL))
    swerve = pm.WheeledRobot(BODY, pm.WheelTable.swerve([(0.3, 0.1), (-0.3, -0.1)], 0.06, **WHEEL))
    front = [wheels.Wheel("a", 0.3, 0.2, 0.1, **WHEEL), wheels.Wheel("b", 0.3, -0.2, 0.1, **WHEEL)]
    coupled = pm.WheelTable(tuple(front), couplings=(wheels.DifferentialGear(("a", "b"), MOTOR),))
    tall = pm.MobileRobot(30.0, 1.3, com=(0.1, 0.05, 0.2))
    standing = table("differential", supports=[(-0.3, 0.0)])
    carried = pm.PayloadTransfer(BODY, pm.PayloadBody(3.0, com=(0.1, 0.1, 0.2)), 0.5, 1.0, "base_link")
    crab = pm.FixedHeading(pm.Circle(1.0, 0.5, 6.0), 0.0)
    rest = pm.FixedHeading(pm.Hold((1.0, 0.5), 6.0), 0.3)
    unicycle, push = pm.UnicycleTracking(), pm.law(turning)
    feedback = controllers.VelocityCommand(controllers.DynamicFeedback(), commanded)
    odometry = wheels.OdometryFeedback(pm.Backstepping(unicycle, drive), drive.table)
    return {
        "adaptive velocity": (commanded, controllers.AdaptiveVelocity(commanded, leakage=0.1), CIRCLE),
        "dynamic feedback": (commanded, feedback, CIRCLE),
        "parking": (drive, pm.Backstepping(controllers.Parking(), drive), rest),
        "input delay": (BODY, controllers.InputDelay(pm.ComputedTorque(WRONG, 4.0, 4.0), 3), CIRCLE),
        "sampled": (BODY, controllers.Sampled(controllers.PID(WRONG), 5), CIRCLE),
        "odometry": (drive, odometry, CIRCLE),
        "random steps": (commanded, controllers.RandomSteps(), CIRCLE),
        "transfer": (carried, pm.ComputedTorque(BODY, 4.0, 4.0), CIRCLE),
        "ramp": (pm.WheeledRobot(tall, standing, pm.Rolling(wheels.Ramp(0.1, 0.5))), push, CIRCLE),
        "car": (car, pm.Backstepping(unicycle, car), CIRCLE),
        "swerve": (swerve, controllers.SwerveTracking(swerve), crab),
        "coupled": (pm.WheeledRobot(BODY, coupled), pm.law(lambda t, q, v, r: 5.0 + 0.0 * v[:1]), CIRCLE),
    }


LOOPS |= {name: (parts, {}) for name, parts in others().items()}
LOOPS["parking"][1]["q0"] = [0.1, 0.1, 0.2, 0.0, 0.0]
LOOPS["coupled"][1]["v0"] = [0.0] * 5
# What the derivatives of no loop need: solvers of their own, and what is no part of a loop.
NO_PARTS = {
    *("DualNumber", "Controller", "KinematicLaw", "State", "TrackingState", "Force", "Integrator"),
    *("Allocation", "Forces", "Mobility", "Reduced", "Arm", "Linearization", "Mountable", "Mountables"),
    *("MultibodySystem", "UncheckedDynamics", "ContactState", "MotorState", "SupportGeometry"),
}
REFUSED = ("MPC",)
# Where a number changes the side of a kink during the run, differences of runs are no derivatives.
KINKED = ("super-twisting", "adaptive", "constant", "all forces", "line")


def loss(sample: Any) -> Any:
    return (sample.error**2).sum() + 1e-6 * (sample.u**2).sum()


def base_of(name: str) -> tuple[Loop, dict[str, Any]]:
    (plant, controller, trajectory), options = LOOPS[name]
    own = {key: value for key, value in options.items() if key != "limit"}
    forces = own.get("forces", ())
    return Loop(plant, controller, trajectory, forces, own.get("integrator"), own.get("substeps", 1)), own


def chosen(loop: Loop) -> list[str]:
    """Return some numbers of each part."""
    known = [path for path, x in named(loop).items() if not x.label and 0 < np.size(x.leaf.value) < 10]
    # A controller that believes in another axle refuses the reference.
    known = [path for path in known if named(loop)[path].leaf.value is not None and "ahead" not in path]
    each = {"controller": 2, "plant": 2, "forces": 2}
    some = ([path for path in known if path.startswith(f"{part}.")][:count] for part, count in each.items())
    return [*chain.from_iterable(some), "start.x"]


def flat(found: Gradient) -> Any:
    return np.concatenate([each.ravel() for each in found.by.values()])


def differences(loop: Loop, own: dict[str, Any], paths: Sequence[str]) -> Any:
    """Return derivatives by extrapolated central differences of runs, and estimates of their errors."""
    loop = evolved(loop, recorder=Samples(), integrator=select_integrator(loop.plant, loop.integrator))
    known, others, steps = named(loop), list[Loop](), []
    for path in paths:
        one = known[path]
        nominal = np.asarray(one.leaf.value, float)
        entries = [one.place(nominal.ndim)] if one.entry is not None else [*np.ndindex(nominal.shape)]
        for entry in entries:
            steps.append(1e-5 * max(1.0, abs(nominal[entry])))
            for h in (steps[-1], -steps[-1], steps[-1] / 2, -steps[-1] / 2):
                moved = nominal.copy()
                moved[entry] += h
                others.append(replace(loop, {one.leaf.path: moved if moved.ndim else float(moved)}))
    t = DT * np.arange(round(min(DURATION, loop.trajectory.duration) / DT) + 1)
    context = context_of(loop, t)
    q, v = start_of(loop.plant, context.reference, own.get("q0"), own.get("v0"))
    starts = [(each.integrate(q, each.start), v + each.start_rate) for each in others]
    leaves = {known[path].leaf.path for path in paths}
    numbers = [path for path in varied(loop) if path in leaves]
    found = by_compiled(loop, context, [np.array(x) for x in zip(*starts, strict=True)], others, numbers)
    values = [
        float((errors_of(loop.plant, q, context.reference) ** 2).sum() + 1e-6 * (u**2).sum())
        for q, u in zip(found["q"], found["u"], strict=True)
    ]
    rises = np.reshape(values, (-1, 2, 2)) @ [1.0, -1.0]
    whole, half = (rises / np.outer(steps, [2.0, 1.0])).T
    return half + (half - whole) / 3, np.abs(half - whole)


def test_every_public_part_is_in_a_loop() -> None:
    seen = {"constant_acceleration", "rk4", "semi_implicit_euler", "law", *REFUSED, *NO_PARTS}
    for name in LOOPS:
        loop, _ = base_of(name)
        seen |= {type(one).__name__ for _, one in parts_of(loop)}
    modules = controllers, integrators, forces, robot, wheels
    public = {
        name
        for module in modules
        for name in getattr(module, "__all__", [])
        if inspect.isclass(getattr(module, name)) and not issubclass(getattr(module, name), Exception)
    }
    assert len(public) > 40
    assert public <= seen
    drawn = {type(parts[1]).__name__ for parts, _ in LOOPS.values()}
    assert {"LQR", "Backstepping", "Sampled"} <= drawn


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", every_fifth(LOOPS))
def test_forward_and_reverse_agree_with_each_other_and_with_runs(name: str) -> None:
    loop, own = base_of(name)
    parts = loop.plant, loop.controller, loop.trajectory
    duration = min(DURATION, loop.trajectory.duration)
    options: dict[str, Any] = {**own, "dt": DT, "duration": duration, "by": chosen(loop)}
    forward = gradient(loss, *parts, **options, mode="forward")
    found, scale = flat(forward), np.abs(flat(forward)).max()
    if name in DRY:
        with pytest.raises(pm.InvalidArgument, match='run forward only; use mode="forward"'):
            gradient(loss, *parts, **options, mode="reverse")
    else:
        reverse = gradient(loss, *parts, **options, mode="reverse")
        assert reverse.value == pytest.approx(forward.value, rel=1e-12)
        assert np.linalg.norm(flat(reverse) - found) <= 1e-12 * np.linalg.norm(found)
    if name in KINKED:
        return
    expected, error = differences(loop, own, [*forward.by])
    # Rounding of a loss of 200 samples, divided by the step, and the order of the differences; contacts of
    # dry friction are solved to 1e-9 of their impulses.
    assert (np.abs(found - expected) <= error + (1e-7 if name in DRY else 1e-8) * scale).all()


def test_a_path_and_the_last_sample_count() -> None:
    circle = pm.Tangent(pm.Circle(2.0, 0.5, 6.0))
    by = ["trajectory.path.radius", "trajectory.path.rate", "plant.com", "kp"]

    def far(sample: Any) -> Any:
        return np.sqrt((sample.q[:2] ** 2).sum())

    parts = BODY, pm.ComputedTorque(WRONG, 4.0, 4.0)
    found = gradient(far, *parts, circle, by=by, dt=DT, duration=2.0, reduction="last")

    def end(radius: float) -> float:
        run = pm.simulate(*parts, pm.Tangent(pm.Circle(radius, 0.5, 6.0)), dt=DT, duration=2.0)
        return float(np.hypot(*run.q[-1, :2]))

    assert found.value == pytest.approx(end(2.0), rel=1e-12)
    expected = (end(2.0 + 1e-4) - end(2.0 - 1e-4)) / 2e-4
    assert found.by["trajectory.path.radius"] == pytest.approx(expected, rel=1e-8)
    assert found.by["plant.com"].shape == (3,)
    assert found.mode == "forward mode, 6 numbers"
    assert str(found).splitlines()[1].startswith("  by trajectory.path.radius: ")
    assert " per m" in str(found)


def test_many_numbers_select_reverse_mode_and_elementary_functions_have_their_slopes() -> None:
    def policy(t: Any, q: Any, v: Any, reference: Any) -> Any:
        error = np.concatenate([reference.q - q, reference.v - v])
        bent = np.tanh(error) + np.arctan(0.3 * error) + np.expm1(0.1 * error) + np.log1p(error * error)
        turned = np.sin(error) * np.cos(0.5 * error) + np.exp(-error * error) - 1.0
        return 40.0 * (bent + turned)[:3] + 30.0 * np.arctan2(error[3:], 1.0 + error[:3] ** 2)

    by = ["mass", "yaw_inertia", "com", "start.x", "start.y", "start.psi", "start_rate.vx"]
    both = [
        gradient(loss, BODY, pm.law(policy), CIRCLE, by=by, dt=DT, duration=1.0, mode=mode)
        for mode in (None, "forward")
    ]
    assert both[0].mode == "reverse mode, 9 numbers"
    one, other = map(flat, both)
    assert np.linalg.norm(one - other) <= 1e-12 * np.linalg.norm(one)
    step = 1e-5
    values = []
    for sign in (1, -1):
        run = pm.simulate(
            BODY, pm.law(policy), CIRCLE, dt=DT, q0=CIRCLE(0.0).q + sign * step * np.eye(3)[0], duration=1.0
        )
        values.append((run.error**2).sum() + 1e-6 * (run.u**2).sum())
    assert both[0].by["start.x"] == pytest.approx((values[0] - values[1]) / (2 * step), rel=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"by": ["controller.kq"]}, "unknown parameter in by 'controller.kq'"),
        ({"loss": lambda sample: sample.error}, r"loss returned .*, expected a number"),
        ({"loss": lambda sample: 1.0 if sample.u[0] > 0 else 0.0}, "this loop has no derivative: .*np.where"),
        ({"controller": pm.PD(1e9, 1e9)}, "loss is nan with derivatives .*, expected finite numbers"),
        ({"controller": pm.MPC(BODY), "dt": 0.05}, "this loop has no derivative: .*MPC"),
    ],
)
def test_wrong_arguments_are_answered(change: dict[str, Any], message: str) -> None:
    given: dict[str, Any] = {"loss": loss, "controller": pm.PD(60, 60), "by": ["mass"], "dt": DT} | change
    parts = given.pop("loss"), BODY, given.pop("controller"), CIRCLE
    with pytest.raises((pm.InvalidArgument, pm.PinmobileError), match=message):
        gradient(*parts, **given)


def still(robot: Any = None) -> Any:
    base = pm.FixedHeading(pm.Hold((0.0, 0.0), 2.0), 0.0)
    return base if robot is None else pm.WholeBody(robot, base, pm.Hold(robot.rest[3:], 2.0))


def held(kp: float, kd: float, h: float, late: int = 0) -> Any:
    """Return the matrix of a unit mass with a held force, whose state is measured some samples late."""
    plant, push = np.array([[1.0, h], [0.0, 1.0]]), np.array([[h * h / 2], [h]])
    gain = np.array([[kp, kd]])
    size = 2 * (late + 1)
    A = np.zeros((size, size))
    A[:2, :2] = plant
    A[:2, size - 2 :] -= push @ gain
    A[2:, :-2] += np.eye(size - 2)
    return A


def near(found: Any, expected: Any, tolerance: float) -> bool:
    """Return whether the poles other than 0 are expected ones, in any order."""
    left = [*expected]
    for z in found[found != 0]:
        k = int(np.argmin(np.abs(np.array(left) - z)))
        if abs(left.pop(k) - z) > tolerance:
            return False
    return bool(np.abs(left).max(initial=0.0) < 0.05)


@pytest.mark.parametrize("late", [0, 4])
def test_poles_of_a_held_force_with_delay_are_those_of_the_closed_form(late: int) -> None:
    robot, h = pm.MobileRobot(30.0, 1.3), 0.05
    law: Any = pm.PD((120.0, 240.0, 6.5), (90.0, 120.0, 3.9))
    law = pm.MeasurementDelay(law, late) if late else law
    found = poles(robot, law, still(), dt=h, at=1.0)
    pairs = ((4.0, 3.0), (8.0, 4.0), (5.0, 3.0))
    expected = np.concatenate([np.linalg.eigvals(held(kp, kd, h, late)) for kp, kd in pairs])
    assert near(found.values, expected, 1e-9)
    assert found.matrix.shape == (6 + 6 * late,) * 2
    assert found.states[:6] == ("x", "y", "psi", "vx", "vy", "yaw_rate")
    assert found.states[6:] == ("delay",) * 6 * late
    assert found.t == 1.0
    sizes = np.abs(found.values)
    assert (np.diff(sizes) <= 1e-6).all()
    text = str(found)
    assert f"{6 + 6 * late} poles at t = 1 s" in text
    assert ("deviations decay" in text) == (sizes[0] < 1)


def test_poles_of_computed_torque_are_those_of_its_gains() -> None:
    arm, h = pm.MobileRobot.box().mount("ur5"), 0.01
    found = poles(arm, pm.ComputedTorque(arm, 9.0, 5.0), still(arm), dt=h, at=1.0)
    expected = np.tile(np.linalg.eigvals(held(9.0, 5.0, h)), 9)
    assert near(found.values, expected, 1e-6)  # nine equal pairs: the root of rounding
    s = np.linalg.eigvals([[0.0, 1.0], [-9.0, -5.0]])
    np.testing.assert_allclose(np.sort(found.frequency)[[0, -1]], np.sort(np.abs(s)), rtol=0.05)
    assert np.allclose(found.damping[found.values.imag != 0], 5 / 6, atol=0.03)
