import pickle
import re

import numpy as np
import pytest
from hypothesis import given, strategies as st

from pinmobile import arrays
from pinmobile.arrays import finite
from pinmobile.controllers import planar_difference
from pinmobile.errors import Diverged, FileError, InvalidArgument, PinmobileError, UnknownName, ViewerError
from tests.refusals import refusals, told


def test_every_error_is_a_pinmobile_error_and_a_builtin_one() -> None:
    pairs = {InvalidArgument: ValueError, UnknownName: KeyError, Diverged: ArithmeticError}
    for error, builtin in (pairs | {ViewerError: RuntimeError, FileError: OSError}).items():
        assert issubclass(error, PinmobileError)
        assert issubclass(error, builtin)


def test_unknown_name_lists_the_names_there_are_the_nearest_first() -> None:
    error = UnknownName("trajectory", "circel", ["via-stop", "circle"])
    assert str(error) == "unknown trajectory 'circel', did you mean 'circle'? available: circle, via-stop"
    copy = pickle.loads(pickle.dumps(error))
    assert str(copy) == str(error)
    assert copy.available == ("via-stop", "circle")


def test_unknown_name_states_that_there_are_none() -> None:
    assert str(UnknownName("metric", "gap", [])) == "unknown metric 'gap', available: none"


def test_names_that_a_terminal_would_obey_are_quoted_and_the_first_of_many_listed() -> None:
    error = UnknownName("topic", "\x1b[2J", ["/odom", "/odo\x1b[2Jm", *(f"/topic{k}" for k in range(9999))])
    assert str(error).startswith(
        "unknown topic '\\x1b[2J', did you mean '/odo\\x1b[2Jm'? available: '/odo\\x1b[2Jm', /odom, /topic0, "
    )
    assert str(error).isprintable()
    assert re.search(r", /topic\d+ and 9,\d{3} more$", str(error))
    assert len(error.available) == len(error.listed) == 10_001


def test_an_argument_is_known_by_name_and_may_be_called_otherwise() -> None:
    with pytest.raises(InvalidArgument) as refused:
        finite("com", [0.0, np.nan])
    error = refused.value
    assert (error.argument, str(error)) == ("com", "com[1] is nan, expected a finite number")
    copy = pickle.loads(pickle.dumps(error.calling("--model-com")))
    assert (copy.argument, str(copy)) == ("--model-com", "--model-com[1] is nan, expected a finite number")
    assert InvalidArgument("kp has shape (2,), expected ()").argument == "kp"


def test_file_error_has_what_the_system_said_also_from_another_process() -> None:
    error = FileError("disk is full", errno=28, filename="a/b")
    copy = pickle.loads(pickle.dumps(error))
    assert (str(copy), copy.errno, copy.filename) == ("disk is full", 28, "a/b")
    assert copy.args == ("disk is full",)


# -- arrays ----------------------------------------------------------------------------------------


test_what_is_not_expected_is_refused_by_name = refusals(
    (lambda: arrays.finite("q", np.array([[1, 2], [np.inf, 0]])), "q[1, 0] is inf, expected a finite number"),
    (lambda: arrays.finite("q", "fast"), "q is 'fast', expected real numbers"),
    (lambda: arrays.finite("q", 1j), "q is 1j, expected real numbers"),
    (lambda: arrays.finite("on", True), "on is True, expected real numbers"),
    (lambda: arrays.vector("q", 1.0, 3), "q has shape (), expected (..., 3)"),
    (lambda: arrays.scalar("dt", [1, 2]), "dt has shape (2,), expected one number"),
    (lambda: arrays.positive("mass", -3, "kg"), "mass is -3.0 kg, expected > 0"),
    (lambda: arrays.check_integer("substeps", 1.5), "substeps is 1.5, expected a whole number >= 1"),
    by=told,
)


@given(st.floats(-1e6, 1e6))
def test_wrapped_angle_lies_in_the_half_open_interval_and_points_the_same_way(angle: float) -> None:
    wrapped = float(arrays.wrap_angle(np.array(angle)))
    assert -np.pi < wrapped <= np.pi
    turns = (angle - wrapped) / (2 * np.pi)
    assert abs(turns - round(turns)) < 1e-9


def test_frozen_is_a_read_only_copy() -> None:
    source = np.ones(3)
    copy = arrays.frozen(source)
    source[0] = 5
    assert (copy[0], copy.flags.writeable) == (1, False)


@pytest.mark.parametrize("turns", [-7, 1, 3])
def test_rounding_does_not_choose_the_side_of_half_a_turn(turns: int) -> None:
    exact = turns * np.pi
    near = np.array([exact, np.nextafter(exact, 99), np.nextafter(exact, -99), exact + 1e-12, exact - 1e-12])
    np.testing.assert_allclose(arrays.wrap_angle(near), np.pi, rtol=0, atol=2e-9)
    errors = planar_difference(np.stack([0 * near, 0 * near, near - exact], axis=-1), np.array([0, 0, exact]))
    np.testing.assert_allclose(errors[:, 2], np.pi, rtol=0, atol=2e-9)
    for row, offset in zip(errors, near - exact, strict=True):
        assert planar_difference(np.array([0, 0, offset]), np.array([0, 0, exact]))[2] == row[2]
    farther = arrays.wrap_angle(exact + np.array([-1e-6, 1e-6]))
    np.testing.assert_allclose(farther, [np.pi - 1e-6, 1e-6 - np.pi], rtol=0, atol=1e-12)


def test_a_seed_is_what_numpy_takes_for_one_but_never_nothing() -> None:
    seeds = 7, np.int64(7), np.random.SeedSequence(7), np.random.PCG64(7)
    assert len({arrays.seeded("seed", seed).random() for seed in seeds}) == 1
    generator = np.random.default_rng(1)
    assert arrays.seeded("seed", generator) is generator
    for seed in (None, -1, 1.5, "a", True):
        with pytest.raises(InvalidArgument, match=r"^seed is .*, expected a whole number >= 0$"):
            arrays.seeded("seed", seed)
