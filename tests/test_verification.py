import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pinmobile import LECTURE_TABLE, SLIDE_TABLE, DHTable, InvalidArgument, MobileRobot, closed_form, verify
from pinmobile.arrays import Array


@given(
    st.floats(1e-2, 1e4),
    st.floats(1e-3, 1e3),
    st.tuples(st.floats(-3, 3), st.floats(-3, 3)),
    st.sampled_from([LECTURE_TABLE, SLIDE_TABLE]),
    st.integers(0, 2**32 - 1),
)
@settings(max_examples=40)
def test_every_route_agrees_for_any_robot(
    mass: float, inertia: float, com: tuple[float, float], table: DHTable, seed: int
) -> None:
    verification = verify(MobileRobot(mass, inertia, com=com, dh=table), states=20, seed=seed)
    assert verification.passed, str(verification)


def test_four_quantities_are_compared_on_three_routes() -> None:
    verification = verify(MobileRobot(10, 1.2, com=(0.15, 0.05)))
    assert [row.quantity for row in verification.rows] == ["M"] * 3 + ["n"] * 3 + ["tau"] * 3 + ["a"] * 3
    assert set(verification.largest) == {"M", "n", "tau", "a"}
    assert verification.largest["tau"] < 1e-14
    assert {row.bound for row in verification.rows[:9]} == {1e-12}


@pytest.mark.parametrize(
    ("function", "quantity"),
    [
        ("mass_matrix", "M"),
        ("nonlinear_effects", "n"),
        ("inverse_dynamics", "tau"),
        ("forward_dynamics", "a"),
    ],
)
def test_a_route_that_is_off_by_little_is_seen(
    monkeypatch: pytest.MonkeyPatch, function: str, quantity: str
) -> None:
    right = getattr(closed_form, function)

    def off(*arguments: Array, **body: Array) -> Array:
        return np.asarray(right(*arguments, **body) * (1 + 1e-10))

    monkeypatch.setattr(closed_form, function, off)
    verification = verify(MobileRobot(10, 1.2, com=(0.15, 0.05)))
    wrong = {row.quantity for row in verification.rows if not row.agrees}
    assert wrong == {quantity}
    assert not verification.passed
    assert "DIFFERS" in str(verification)


def test_the_same_seed_gives_the_same_numbers() -> None:
    robot = MobileRobot(10, 1.2, com=(0.15, 0.05))
    assert verify(robot, seed=3) == verify(robot, seed=np.random.default_rng(3))
    assert verify(robot, seed=3) != verify(robot, seed=4)


def test_printed_it_is_a_table() -> None:
    lines = str(verify(MobileRobot(10, 1.2), states=5)).splitlines()
    assert lines[0] == "5 random states, each route against the closed form"
    assert len(lines) == 14
    assert lines[2].startswith("M   Pinocchio (CRBA, RNEA, ABA)")


def test_what_is_near_the_end_of_rounding_agrees_within_bounds_and_does_not_crash() -> None:
    assert verify(MobileRobot(1, 1e-3, com=(9e2, 0)), states=5).passed
    with pytest.raises(InvalidArgument, match="robot is 3, expected a MobileRobot"):
        verify(3)  # type: ignore[arg-type]


def test_no_states_are_refused() -> None:
    with pytest.raises(InvalidArgument, match="states is 0, expected a whole number >= 1"):
        verify(MobileRobot(10, 1.2), states=0)
