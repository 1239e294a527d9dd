from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from attrs import evolve
from hypothesis import given, settings, strategies as st

from pinmobile import PD, ComputedTorque, InvalidArgument, MobileRobot, Reference
from pinmobile.controllers import plain_difference, planar_difference
from pinmobile.plant import Context
from tests.refusals import refusals, told

ROBOT = MobileRobot(10, 1.2, com=(0.15, 0.05))
CONTEXT = Context.of(ROBOT, dt=0.1)


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
    by=told,
)
