"""LQR, MPC and the model that they track: theory, limits, wheels, arms, engines, and what is refused."""

from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile import MobileRobot, WheeledRobot, WheelTable
from pinmobile.arrays import Array
from pinmobile.controllers.lqr import riccati, tracked_model
from pinmobile.errors import NotSolved
from pinmobile.parts import evolved, replace
from pinmobile.plant import Context
from pinmobile.wheels import Motor
from tests.parts import Waving
from tests.refusals import refusals
from tests.rivals import ARM, CIRCLE, HEAVY, NOMINAL, OFF, SHORT

DIFFERENTIAL = pm.WheelTable.differential(0.1, 0.4)
WHEELED = pm.WheeledRobot(NOMINAL, DIFFERENTIAL)


def rows(controller: pm.LQR, robot: Any, trajectory: Any, dt: float = 0.01) -> tuple[Array, ...]:
    """Return the inputs, velocities and gains of all samples."""
    t = np.arange(round(trajectory.duration / dt) + 1) * dt
    context = Context.of(robot, dt=dt, t=t, reference=trajectory(t))
    return tuple(each.rows for each in controller.initial_state(context))


@pytest.mark.parametrize("robot", [NOMINAL, WHEELED])
def test_the_cost_of_a_motion_is_the_cost_to_go_and_no_other_input_costs_less(robot: Any) -> None:
    t = np.arange(201) * 0.01
    A, B = tracked_model(robot, SHORT(t)).discrete(0.01)
    controller = pm.LQR(robot)
    Q, R = np.asarray(controller.Q), np.asarray(controller.R)
    K, P = riccati(A, B, Q, R)
    assert np.array_equal(K, rows(controller, robot, SHORT)[2])
    start = np.random.default_rng(1).normal(size=len(Q)) * 0.1

    def cost(other: float) -> float:
        x, total = start, 0.0
        for k in range(len(A)):
            u = -K[k] @ x + other * np.sin(k + np.arange(len(R)))
            total += float(x @ Q @ x + u @ R @ u)
            x = A[k] @ x + B[k] @ u
        return total + float(x @ P[-1] @ x)

    least = float(start @ P[0] @ start)
    # 200 sums of products of numbers that P and Q make up to 1e4 apart.
    assert cost(0.0) == pytest.approx(least, rel=1e-10)
    assert min(cost(1.0), cost(-1.0)) > 1.001 * least


def test_on_wheels_it_comes_back_to_the_reference_and_without_errors_stays() -> None:
    heavy = pm.WheeledRobot(HEAVY, DIFFERENTIAL)
    given: Any = {"dt": 0.01, "engine": pm.Engine.COMPILED, "duration": 15.0}
    on = pm.simulate(WHEELED, pm.LQR(WHEELED), CIRCLE, **given)
    # The reference's input is held for dt, along which it turns by 6e-3 rad.
    assert np.abs((on.q[:, :3] - on.reference.q)[:, :2]).max() < 1e-3
    q, v = WHEELED.start(pm.Reference(*(x[0] for x in on.reference)))
    q = q + np.array([0.2, -0.2, 0.3, 0.0, 0.0])
    v = heavy.reduced(q, 0 * v).S @ heavy.independent(heavy.rest, 0 * v)
    run = pm.simulate(heavy, pm.LQR(WHEELED), CIRCLE, q0=q, v0=v, **given)
    off = np.linalg.norm((run.q[:, :3] - run.reference.q)[:, :2], axis=-1)
    assert off[0] > 0.28
    assert off[1000:].max() < 0.02


def test_arms_follow_too() -> None:
    start = Waving(ARM)(0.0).q + 0.05
    given: Any = {"integrator": pm.rk4, "engine": pm.Engine.COMPILED, "q0": start, "v0": np.zeros(ARM.nv)}
    run = pm.simulate(ARM, pm.LQR(ARM), Waving(ARM), dt=0.01, **given)
    assert np.abs(run.q - run.reference.q)[-1].max() < 0.02


@pytest.mark.parametrize(
    ("name", "law"),
    [
        ("input_weight", lambda x: pm.LQR(NOMINAL, R=x * np.array([1e-3, 1e-3, 2e-2]))),
        ("controller.mass", lambda x: pm.LQR(evolved(NOMINAL, mass=x))),
    ],
)
def test_gains_that_differ_from_robot_to_robot_are_those_of_each_alone(name: str, law: Any) -> None:
    given: Any = {"dt": 0.01, "integrator": pm.rk4, "seed": 1, "duration": 0.2}
    spread = {name: pm.Uniform(20, 40)}
    with pytest.warns(UserWarning, match=r"depends on controller\.[a-z_.]+, which differs"):
        found = pm.ensemble(HEAVY, pm.LQR(NOMINAL), SHORT, n=2, spread=spread, **given)
    assert found.engine == repr(pm.Engine.PYTHON)
    for x, error in zip(found.draws[name], found.rms_error, strict=True):
        alone = pm.ensemble(HEAVY, law(x), SHORT, n=1, spread={}, engine=pm.Engine.COMPILED, **given)
        assert np.abs(alone.rms_error[0] - error).max() < 1e-12


test_bad_arguments_are_refused = refusals(
    (lambda: pm.LQR(NOMINAL, R=[1, 2, 0]), r"R has the eigenvalue 0, expected a positive definite"),
    (lambda: pm.LQR(NOMINAL, Q=np.triu(np.ones((6, 6)))), "Q is not symmetric"),
    (
        lambda: pm.LQR(pm.WheeledRobot(NOMINAL, pm.WheelTable.car(0.6, 0.4, 0.1, yaw_inertia=0.006))),
        "steers wheels about 1 axes",
    ),
    (
        lambda: pm.simulate(WHEELED, pm.LQR(WHEELED), pm.Tangent(pm.RestToRest([0, 0], [1, 0], 2)), dt=0.01),
        "reference ends at rest, at t = 2 s, where a WheeledRobot that cannot move sideways",
    ),
    (
        lambda: pm.simulate(ARM, pm.LQR(ARM), SHORT, dt=0.01),
        "reference has 3 coordinates, expected 9 of the robot",
    ),
)


def test_a_drive_that_moves_in_every_direction_may_end_at_rest() -> None:
    mecanum = pm.WheeledRobot(NOMINAL, pm.WheelTable.mecanum(0.5, 0.4, 0.1))
    straight = pm.FixedHeading(pm.RestToRest([0, 0], [1, 0], 2), 0.0)
    run = pm.simulate(mecanum, pm.LQR(mecanum), straight, dt=0.01, engine=pm.Engine.COMPILED)
    assert np.abs(run.q[-1, :2] - [1, 0]).max() < 1e-3


# -- the first-order model of the tracked state ----------------------------------------------------


BODY = MobileRobot(mass=30, yaw_inertia=1.3, com=(0.1, 0.05))
ELECTRIC: Any = {"resistance": 1.2, "torque_constant": 0.03, "voltage": 1e3, "gear": 20.0}
MOTOR = Motor(**ELECTRIC, efficiency=0.8, rotor_inertia=1e-5, viscous=1e-3, coulomb=0.004)
ON_WHEELS: Any = {
    "differential": WheeledRobot(BODY, WheelTable.differential(0.1, 0.4)),
    "mecanum": WheeledRobot(BODY, WheelTable.mecanum(0.5, 0.4, 0.1)),
    "differential by volts": WheeledRobot(BODY, WheelTable.differential(0.1, 0.4, motor=MOTOR)).by_voltage(),
    "differential with an arm": WheeledRobot(ARM, WheelTable.differential(0.1, 0.4)),
}


def rolling(robot: WheeledRobot, generator: np.random.Generator) -> tuple[Array, Array]:
    q = np.append(robot.robot.random_configuration(generator), np.zeros(robot.nq - robot.robot.nq))
    S = robot.reduced(q, np.zeros(robot.nv)).S
    return q, S @ generator.normal(size=S.shape[-1])


@pytest.mark.parametrize("robot", [BODY, ARM])
def test_of_a_pushed_body_it_is_pinocchios(robot: MobileRobot) -> None:
    generator = np.random.default_rng(1)
    q = robot.random_configuration(generator, (3,))
    v, u = generator.normal(size=(2, 3, robot.nv))
    own, its = robot.array_dynamics.linearize_tracked(q, v, u), robot.linearize(q, v, u)
    for mine, other, same in zip(own, its, robot.linearize_tracked(q, v, u), strict=True):
        # Both are exact; a mass matrix with a condition number of some 1e4 amplifies rounding.
        assert np.abs(mine - other).max() < 1e-11 * np.abs(other).max()
        assert np.array_equal(other, same)


@pytest.mark.parametrize("name", ON_WHEELS)
def test_on_wheels_it_is_the_difference_quotient_of_pinocchios_constrained_tree(name: str) -> None:
    robot = ON_WHEELS[name]
    generator = np.random.default_rng(2)
    q, v = rolling(robot, generator)
    u, n = generator.normal(size=robot.nu), robot.robot.nv
    u = u * [100.0 if each.unit == "V" else 1.0 for each in robot.inputs]
    nu, h = robot.independent(q, v), 1e-5

    def rates(q: Array, nu: Array, u: Array) -> Array:
        """Return the rates of the tracked state, nu' as a difference along the motion."""
        v = robot.reduced(q, np.zeros(robot.nv)).S @ nu
        by_torque = getattr(robot, "wheeled", robot)
        a = by_torque.forward_dynamics(q, v, u if by_torque is robot else robot.torques_at(v, u))
        ends = [robot.independent(robot.integrate(q, s * v), v + s * a) for s in (-h, h)]
        return np.concatenate([v[:n], (ends[1] - ends[0]) / (2 * h)])

    def moved(k: int, step: float) -> Array:
        x = np.zeros(n + len(nu) + len(u))
        x[k] = step
        dq = np.append(x[:n], np.zeros(robot.nv - n))
        return rates(robot.integrate(q, dq), nu + x[n : n + len(nu)], u + x[n + len(nu) :])

    found = np.hstack(robot.linearize_tracked(q, v, u))
    step = 1e-4
    expected = [(moved(k, step) - moved(k, -step)) / (2 * step) for k in range(found.shape[-1])]
    # Two nested differences: h^2 and step^2 of slopes of order 10, and 1e-16 / (h step) of rounding.
    assert np.abs(found - np.transpose(expected)).max() < 2e-6 * np.abs(found).max()


# -- model predictive control ----------------------------------------------------------------------


T: Array = np.asarray(np.arange(201) * 0.01, np.float64)


def asked(controller: Any, robot: Any, q: Array, v: Array) -> Array:
    """Return the first input."""
    context = Context.of(robot, dt=0.01, t=T, reference=SHORT(T))
    return np.asarray(controller(0.0, q, v, SHORT(0.0), controller.initial_state(context))[0])


@pytest.mark.parametrize("robot", [NOMINAL, WHEELED])
def test_it_is_lqr_while_nothing_is_limited_and_its_step_is_that_of_the_loop(robot: Any) -> None:
    q, v = robot.start(SHORT(0.0))
    q = robot.integrate(q, np.append([0.1, -0.05, 0.1], np.zeros(robot.nv - 3)))
    wanted = asked(pm.LQR(robot), robot, q, v)
    for horizon in (1, 20):
        found = asked(pm.MPC(robot, horizon, 0.01, limits=1e6, observer=0), robot, q, v)
        assert np.abs(found - wanted).max() < 1e-12 * np.abs(wanted).max()


def test_within_limits_it_is_the_solution_of_the_program_of_all_inputs() -> None:
    from scipy.optimize import lsq_linear

    step, N, limits = 0.05, 12, np.array([22.0, 22.0, 3.0])
    controller = pm.MPC(NOMINAL, N, step, limits=limits, observer=0)
    start, v = SHORT(0.0).q + np.array([-0.3, -0.5, 0.4]), SHORT(0.0).v
    found = asked(controller, NOMINAL, start, v)
    model = tracked_model(NOMINAL, SHORT(T))
    A, B = model.discrete(step)
    Q, R = 5 * np.asarray(controller.Q), 5 * np.asarray(controller.R)
    _, P = riccati(A, B, Q, R, 5)
    # Least squares in all inputs: rows of the roots of the weights, states by powers of the model.
    x, inputs = np.append(NOMINAL.difference(SHORT(0.0).q, start), np.zeros(3)), np.zeros((6, 3 * N))
    rows, right = [np.kron(np.eye(N), np.linalg.cholesky(R).T)], [np.zeros(3 * N)]
    for j in range(N):
        pick = np.zeros((3, 3 * N))
        pick[:, 3 * j : 3 * j + 3] = np.eye(3)
        x, inputs = A[5 * j] @ x, A[5 * j] @ inputs + B[5 * j] @ pick
        root = np.linalg.cholesky(Q if j < N - 1 else P[5 * N]).T
        rows.append(root @ inputs)
        right.append(-root @ x)
    u = model.u[: 5 * N : 5].ravel()
    box = np.tile(limits, N)
    best = lsq_linear(np.vstack(rows), np.concatenate(right), (-box - u, box - u), tol=1e-15)
    assert (np.abs(np.abs(best.x + u) - box) < 1e-6).sum() > 3
    # The other solver stops where its cost changes by 1e-15 of itself: inputs within the root of that.
    assert np.abs(found - (best.x + u)[:3]).max() < 1e-5 * 22


def test_errors_are_those_of_an_independent_implementation() -> None:
    for robot, observer, printed in ((HEAVY, 0.0, 5.48), (HEAVY, 10.0, 0.383), (OFF, 10.0, 0.214)):
        controller = pm.MPC(NOMINAL, 20, 0.01, observer=observer)
        run = pm.simulate(robot, controller, CIRCLE, dt=0.01, duration=10.0, integrator=pm.rk4, substeps=4)
        off = (run.q - run.reference.q)[run.t >= 5, :2]
        # Two percent, or half a unit of the last digit that is printed.
        assert 1e3 * np.linalg.norm(off, axis=-1).max() == pytest.approx(printed, rel=0.02, abs=5e-4)


def test_no_constant_force_leaves_an_error_nor_is_it_taken_from_what_limits_leave() -> None:
    still, force = (
        pm.FixedHeading(pm.Circle(radius=1.5, rate=0.6, duration=4), 0.3),
        np.array([12.0, -7.0, 1.5]),
    )
    given: Any = {"dt": 0.01, "integrator": pm.rk4, "forces": [pm.ConstantForce(force)]}
    run = pm.simulate(NOMINAL, pm.MPC(NOMINAL, limits=(60, 60, 9)), still, **given)
    without = pm.simulate(NOMINAL, pm.MPC(NOMINAL, limits=(60, 60, 9), observer=0), still, **given)
    last, other = (np.abs((x.q - x.reference.q)[-1]).max() for x in (run, without))
    assert last < 0.02 * other
    # Explicit Euler of the integral: order 1 in dt, along a reference that turns at 0.6 rad/s.
    assert np.abs(run.signals["disturbance"].values[-1] - force).max() < 0.02 * 12


def test_on_wheels_neither_a_ramp_nor_a_push_leaves_an_error() -> None:
    along = pm.FixedHeading(pm.Line((0, 0), (4, 0), duration=4.0), 0.0)
    pushed: Any = {"forces": [pm.ConstantForce((-20.0, 3.0, 2.0))]}
    for plant, given in ((WHEELED.on_ramp(0.1, 0.3), {}), (WHEELED, pushed)):
        runs = [pm.simulate(plant, pm.MPC(WHEELED, observer=x), along, dt=0.01, **given) for x in (10.0, 0.0)]
        mine, other = (np.abs((run.q[:, :3] - run.reference.q)[-1]).max() for run in runs)
        assert other > 0.05
        # What is left decays with the slowest pole of the loop, some 2 / s: e^-8.
        assert mine < 1e-3 * other
    # A wheel of 0.4 m at 0.05 m from the middle carries half the force, and the moment.
    wanted = 0.4 * np.array([-20 / 2 - 2 / 0.1, -20 / 2 + 2 / 0.1])
    assert runs[0].signals["disturbance"].values[-1] == pytest.approx(wanted, rel=1e-3)


def test_soft_bounds_hold_a_corridor_that_the_reference_leaves() -> None:
    across = pm.FixedHeading(pm.Lissajous(1.0, 0.6, 0.5, 1.0, duration=6.0), 0.0)
    endless = np.full(6, np.inf)
    upper = endless.copy()
    upper[1] = 0.4
    given: Any = {"dt": 0.01, "integrator": pm.rk4}
    free = pm.simulate(NOMINAL, pm.MPC(NOMINAL, observer=0), across, **given)
    bound = pm.simulate(NOMINAL, pm.MPC(NOMINAL, upper=upper, observer=0), across, **given)
    assert free.q[:, 1].max() > 0.55
    assert bound.q[:, 1].max() < 0.42


def test_an_ensemble_says_why_it_is_slow_and_how_long_many_would_take() -> None:
    given: Any = {"dt": 0.01, "n": 2, "seed": 1, "spread": {"mass": pm.Uniform(28, 32)}, "duration": 0.1}
    words = r"quadratic program at each of 11 samples, so that 10,000 robots take some [\d.e-]+ h"
    with pytest.warns(UserWarning, match=words):
        found = pm.ensemble(NOMINAL, pm.InputSaturation(pm.MPC(NOMINAL), 100), SHORT, **given)
    assert found.engine == "PYTHON"
    with pytest.raises(pm.InvalidArgument, match="10,000 robots"):
        pm.ensemble(NOMINAL, pm.MPC(NOMINAL), SHORT, engine=pm.Engine.COMPILED, **given)
    with pytest.raises(pm.InvalidArgument, match="quadratic program at each of 11 samples; use LQR"):
        pm.ensemble(NOMINAL, pm.MPC(NOMINAL, limits=50), SHORT, engine=pm.Engine.COMPILED, **given)


def test_a_program_that_fails_keeps_its_state_and_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    from daqp import solve

    from pinmobile.controllers import mpc

    monkeypatch.setattr(mpc, "solver", lambda: lambda H, *given, **no: (np.zeros(len(H)), 0.0, -1, {}))
    start = SHORT(0.0).q + np.array([-0.3, -0.5, 0.4])
    with pytest.raises(NotSolved, match="at t = 0 s has no solution") as caught:
        asked(pm.MPC(NOMINAL, 4, limits=(22, 22, 3)), NOMINAL, start, SHORT(0.0).v)
    assert caught.value.time == 0
    H, f, A, lower, upper, sense = caught.value.problem.values()
    assert solve(H, f, A, upper, lower, sense)[2] == 1


def test_rows_of_a_program_are_what_its_inputs_do_to_the_model() -> None:
    box = np.array([1.0, np.inf, np.inf, np.inf, 1.0, np.inf])
    controller = pm.MPC(NOMINAL, 9, 0.05, upper=box)
    plan = controller.initial_state(Context.of(NOMINAL, dt=0.01, t=T, reference=SHORT(T)))[0]
    A, B = tracked_model(NOMINAL, SHORT(T)).discrete(0.05)
    for k in (0, 180):  # from the second, the horizon reaches beyond the end
        at, z = plan.samples(k), np.cos(np.arange(27.0))
        program = plan.program(at, np.zeros((9, 5)), np.zeros((9, 5)))
        x, wanted = np.zeros(6), []
        for i, own in zip(at[:-1], z.reshape(9, 3), strict=True):
            u = plan.scales[i] @ own - plan.K[i] @ x
            x = A[i] @ x + B[i] @ u
            wanted.append([*u, x[0], x[4]])
        assert np.abs(program.A @ z - np.ravel(wanted)).max() < 1e-12 * np.abs(wanted).max()


test_bad_arguments_of_mpc_are_refused = refusals(
    (
        lambda: pm.simulate(NOMINAL, pm.MPC(NOMINAL, limits=5), SHORT, dt=0.01),
        "limits exclude the reference: at t",
    ),
    (
        lambda: pm.simulate(NOMINAL, pm.MPC(NOMINAL, step=0.025), SHORT, dt=0.01),
        "step is 0.025 s, expected a whole",
    ),
    (
        lambda: pm.simulate(NOMINAL, pm.MPC(NOMINAL, observer=201), SHORT, dt=0.01),
        r"gains observer = \[201.0\] are unstable .* dt < 0.00995 s",
    ),
    (lambda: pm.MPC(NOMINAL, lower=np.ones(6), upper=np.zeros(6)), "lower is not below upper"),
)


def test_states_without_bounds_may_be_left_out() -> None:
    told = pm.MPC(NOMINAL, limits=(30, 30, 5), lower=[-9] * 6, upper=(3.1, 4.0))
    assert told.upper.tolist() == [3.1, 4, *[np.inf] * 4]
    assert told.lower.tolist() == [-9] * 6
    assert replace(told, {"limits": 50}).range[1].tolist() == [50, 50, 50]
