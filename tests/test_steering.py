"""Kinematic laws on the kinematic model: rates by the chain rule, Lyapunov functions, refusals."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from pinmobile import InvalidArgument, MobileRobot, UnicycleTracking
from pinmobile.controllers import DualNumber, DynamicFeedback, Kanayama, KinematicLaw, Parking, TrackingState
from pinmobile.plant import Context

T = np.arange(0.0, 1.0, 0.1)
CONTEXT = Context.of(MobileRobot(1.0, 1.0), dt=0.001)
LAWS = UnicycleTracking(), Kanayama(), Parking(), DynamicFeedback()
NUMBERS = st.floats(-1.5, 1.5)


def derivative(tracked: TrackingState, v: float, w: float) -> tuple[float, float, float]:
    """Return the rates of the errors of a body that moves at (v, w)."""
    x, y, turn, speed, yaw_rate = tracked[:5]
    return w * y - v + speed * np.cos(turn), speed * np.sin(turn) - w * x, yaw_rate - w


def state_of(law: KinematicLaw, speed: float) -> Any:
    state = law.initial_state(CONTEXT)
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
    ("law", "speed", "yaw_rate", "message"),
    [
        (Kanayama(), 0.5 - T, 0 * T, "reference has a speed of 0 m/s at t = 0.5 s, expected a reference"),
        (Parking(), np.maximum(T - 0.45, 0.0), 0 * T, "reference moves at t = 0.5 s, expected a goal at"),
    ],
)
def test_a_law_refuses_a_reference(law: KinematicLaw, speed: Any, yaw_rate: Any, message: str) -> None:
    with pytest.raises(InvalidArgument) as error:
        law.check(T, np.where(np.abs(speed) < 1e-12, 0.0, speed), yaw_rate)
    assert str(error.value).startswith(message)
