from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from attrs import evolve
from hypothesis import given, settings, strategies as st

from pinmobile import PD, ComputedTorque, InvalidArgument, MobileRobot, Reference, UnicycleTracking
from pinmobile.controllers import (
    DualNumber,
    DynamicFeedback,
    Kanayama,
    KinematicLaw,
    Parking,
    TrackingState,
    plain_difference,
    planar_difference,
)
from pinmobile.plant import Context
from tests.refusals import begun, refusals, told

ROBOT = MobileRobot(10, 1.2, com=(0.15, 0.05))


def test_planar_difference_is_on_the_circle_and_the_lectures_is_not() -> None:
    """Errata: wrapping without wrapping the error gives a spike of 2 pi."""
    ahead, behind = np.array([0, 0, 0.01]), np.array([0, 0, 2 * np.pi - 0.01])
    assert planar_difference(behind, ahead)[2] == pytest.approx(0.02)
    assert plain_difference(behind, ahead)[2] == pytest.approx(0.02 - 2 * np.pi)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-20, 20), min_size=6, max_size=6), st.sampled_from([0.0, 1.0, -1.0, 3.0, -5.0]))
def test_the_planes_difference_is_the_robots_bit_for_bit(numbers: list[float], turns: float) -> None:
    """Also at half a turn, where rounding does not choose the side, for one and for many."""
    q0, q1 = np.reshape(numbers, (2, 3))
    for angle in (q1[2], q0[2] + turns * np.pi):
        q1[2] = angle
        expected = planar_difference(np.stack([q0, q0]), q1)
        for found in (planar_difference(q0, q1), ROBOT.difference(q0, q1), ROBOT.difference([q0], [q1])[0]):
            np.testing.assert_array_equal(found, expected[1])
        np.testing.assert_array_equal(plain_difference(q0, q1), q1 - q0)


def test_a_subtraction_of_the_wrong_sign_is_refused() -> None:
    with pytest.raises(InvalidArgument, match=r"which returns q0 - q1, .*: write .*=plain_difference$"):
        PD(1, 1, difference=np.subtract)


def test_a_model_without_a_difference_is_told_to_bring_one() -> None:
    model: Any = SimpleNamespace(nv=3, inverse_dynamics=ROBOT.inverse_dynamics)
    with pytest.raises(InvalidArgument, match=r"no difference\(q0, q1\), .*: difference=planar_difference$"):
        ComputedTorque(model)
    assert ComputedTorque(model, difference=planar_difference).difference is planar_difference


def test_a_controller_of_another_robot_compares_as_that_one() -> None:
    """A copy of it with another robot takes that robot's."""
    kinova, goal = MobileRobot.box().mount("kinova"), Reference(*np.zeros((3, 3)))
    controller: Any = ComputedTorque(kinova)
    moved = evolve(controller, robot=ROBOT, kp=4, kd=4)
    tau, _ = moved(0.0, np.zeros(3), np.zeros(3), goal, None)
    np.testing.assert_array_equal(tau, 0)


def test_pd_by_hand_starts_with_the_state_of_its_context() -> None:
    """A turn ahead is nowhere on the circle, for a robot in the plane and for one with round joints."""
    for robot in (ROBOT, MobileRobot.box().mount("kinova")):
        controller, n = PD(2, 1), robot.nv
        q = np.array([0, 0, 2 * np.pi, *np.full(n - 3, 0.1)])
        at, rest = Reference(*np.zeros((3, n))), np.zeros(n)
        state = controller.initial_state(Context.of(robot, dt=0.01))
        tau, state = controller(0.0, q, rest, at, state)
        np.testing.assert_allclose(tau, [0, 0, 0, *np.full(n - 3, -0.2)], atol=1e-12)
        again, _ = controller(0.01, q, rest, at, state)
        np.testing.assert_array_equal(again, tau)
        with pytest.raises(InvalidArgument, match=r"^state is None, .* Context\.of\(robot, dt=\.\.\.\)$"):
            controller(0.0, q, rest, at, None)  # type: ignore[arg-type]


test_gains_and_arguments_that_do_not_fit_are_refused = refusals(
    (lambda: PD(np.ones((2, 3)), 1), "kp has shape (2, 3), expected (), (n,) or (n, n)"),
    (lambda: ComputedTorque(ROBOT, kp=(1, 2)), "kp has shape (2,), expected (), (3,) or (3, 3)"),
    (lambda: ComputedTorque(ROBOT, kp=-4), "kp is -4.0 1/s^2, expected >= 0"),
    (lambda: PD(120, np.diag([1.0, 1.0, -0.5])), "kd is -0.5 N m s/rad, expected >= 0"),
    by=told,
)


# -- kinematic laws on the kinematic model ---------------------------------------------------------


T = np.arange(0.0, 1.0, 0.1)
FAST = Context.of(MobileRobot(1.0, 1.0), dt=0.001)
LAWS = UnicycleTracking(), Kanayama(), Parking(), DynamicFeedback()
NUMBERS = st.floats(-1.5, 1.5)


def derivative(tracked: TrackingState, v: float, w: float) -> tuple[float, float, float]:
    """Return the rates of the errors of a body that moves at (v, w)."""
    x, y, turn, speed, yaw_rate = tracked[:5]
    return w * y - v + speed * np.cos(turn), speed * np.sin(turn) - w * x, yaw_rate - w


def state_of(law: KinematicLaw, speed: float) -> Any:
    state = law.initial_state(FAST)
    return (speed, 1.0, state[2]) if state is not None else None


@settings(max_examples=40)
@given(NUMBERS, NUMBERS, NUMBERS, NUMBERS.filter(lambda x: abs(x) > 0.1), NUMBERS, NUMBERS, NUMBERS)
@pytest.mark.parametrize("law", LAWS, ids=lambda law: type(law).__name__)
def test_rates_of_commands_are_their_derivatives(
    law: KinematicLaw, x: float, y: float, turn: float, speed: float, yaw_rate: float, v: float, w: float
) -> None:
    if np.hypot(x, y) < 0.1 or (isinstance(law, Parking) and np.abs(np.arctan2(y, x)) > 3.0):
        return  # where the parking law jumps
    gained, turned, h = 0.3, -0.4, 1e-5
    at = TrackingState(x, y, turn, speed, yaw_rate, gained, v)
    rates = (*derivative(at, v, w), gained, turned, 0.0, 0.0)
    both = TrackingState(*(DualNumber(value, rate) for value, rate in zip(at, rates, strict=True)))
    state = state_of(law, speed)
    command, _ = law(both, state)
    ends = []
    for sign in (-1.0, 1.0):
        there = TrackingState(*(value + sign * h * rate for value, rate in zip(at, rates, strict=True)))
        moved = state and (state[0] + sign * h * command[0].rate, *state[1:])
        ends.append(law(there, moved)[0])
    for k in range(2):
        expected = [getattr(one[k], "value", one[k]) for one in ends]
        slope = (expected[1] - expected[0]) / (2 * h)
        assert command[k].rate == pytest.approx(slope, rel=1e-5, abs=1e-5)


def _of_tracking(law: Any, e: TrackingState) -> tuple[float, float]:
    k = 2 * law.zeta * np.sqrt(e.yaw_rate**2 + law.b * e.speed**2)
    fall = -k * (law.b * e.ahead**2 + e.turn**2)
    return (law.b * (e.ahead**2 + e.aside**2) + e.turn**2) / 2, fall


def _of_kanayama(law: Any, e: TrackingState) -> tuple[float, float]:
    fall = -law.k1 * e.ahead**2 - law.k3 / law.k2 * e.speed * np.sin(e.turn) ** 2
    return (e.ahead**2 + e.aside**2) / 2 + (1 - np.cos(e.turn)) / law.k2, fall


def _of_parking(law: Any, e: TrackingState) -> tuple[float, float]:
    rho, bearing = np.hypot(e.ahead, e.aside), np.arctan2(e.aside, e.ahead)
    approach = (bearing - e.turn + np.pi) % (2 * np.pi) - np.pi
    fall = -law.k1 * rho**2 * np.cos(bearing) ** 2 - law.k2 * bearing**2
    return (rho**2 + bearing**2 + law.k3 * approach**2) / 2, fall


CANDIDATES: list[tuple[Any, Callable[[Any, TrackingState], tuple[float, float]], tuple[float, float]]] = [
    (UnicycleTracking(), _of_tracking, (0.7, 0.4)),
    (UnicycleTracking(), _of_tracking, (-0.7, 0.4)),
    (Kanayama(), _of_kanayama, (0.7, 0.4)),
    (Parking(), _of_parking, (0.0, 0.0)),
]


@pytest.mark.parametrize(("law", "candidate", "moving"), CANDIDATES)
def test_lyapunov_functions_fall_as_the_papers_say(law: Any, candidate: Any, moving: Any) -> None:
    rng = np.random.default_rng(2)
    for _ in range(50):
        e = TrackingState(*rng.uniform(-1, 1, 3), *moving)
        (v, w), _ = law(e, None)
        h, rates = 1e-6, derivative(e, v, w)
        ends = [
            candidate(law, TrackingState(*(a + s * h * b for a, b in zip(e, rates, strict=False)), *moving))[
                0
            ]
            for s in (-1, 1)
        ]
        assert (ends[1] - ends[0]) / (2 * h) == pytest.approx(candidate(law, e)[1], abs=1e-6)


def test_errors_of_the_place_decay_as_two_poles_by_dynamic_feedback() -> None:
    law, e, h = DynamicFeedback(), np.array([0.0, 0.2, 0.0]), 1e-3
    state, squares = state_of(law, 0.6), []
    for _ in range(10000):
        tracked = TrackingState(e[0], e[1], e[2], 0.6, 0.3, 0.0, state[0])
        (v, w), state = law(tracked, state)
        e = e + h * np.array(derivative(tracked, float(v.value), float(w)))
        squares.append(np.hypot(e[0], e[1]))
    # s^2 + 2.8 s + 2 has its slow pole at -1.4 + 0 j and a little: e^(-1.4 t) and a polynomial.
    assert squares[-1] < 0.2 * 20 * np.exp(-1.3 * 10)


@pytest.mark.parametrize(
    ("law", "speed", "message"),
    [
        (Kanayama(), 0.5 - T, "reference has a speed of 0 m/s at t = 0.5 s, expected a reference"),
        (Parking(), np.maximum(T - 0.45, 0.0), "reference moves at t = 0.5 s, expected a goal at"),
    ],
)
def test_a_law_refuses_a_reference(law: KinematicLaw, speed: Any, message: str) -> None:
    with begun(message):
        law.check(T, np.where(np.abs(speed) < 1e-12, 0.0, speed), 0 * T)
