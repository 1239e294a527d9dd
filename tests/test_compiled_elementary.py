"""Own elementary functions and noise: near the true ones, and with the same bits wherever they run."""

import math

import mpmath
import numpy as np
import pytest

from pinmobile.arrays import Array
from pinmobile.compiled import Noise, elementary, robot_keys
from pinmobile.compiled.memory import _minus_two_log, normals
from pinmobile.compiled.tape import COUNT, Tape, evaluate
from tests.tapes import compiled
from tests.test_compiled_loop import targets

RNG = np.random.default_rng(3)
SPECIAL = np.append(
    np.outer([1.0, -1.0], [0.0, 0.5, 1.0, 1e-300, 5e-324, 1e300, 709.5, 1e4, np.inf]), [0.625, np.nan]
)
WIDE = np.concatenate(
    [RNG.normal(0, 3, 600), RNG.uniform(-700, 700, 200), 10 ** RNG.uniform(-12, 3, 200), SPECIAL]
)
DOMAINS: dict[str, Array] = {
    "sin": RNG.uniform(-1e4, 1e4, 300),
    "cos": RNG.uniform(-1e4, 1e4, 300),
    "tan": RNG.uniform(-1.2, 1.2, 300),
    "exp": RNG.uniform(-700, 709, 300),
    "expm1": RNG.uniform(-2, 2, 300),
    "log": np.exp(RNG.uniform(-740, 700, 300)),
    "log1p": 10 ** RNG.uniform(-12, 3, 300),
    "sinh": RNG.uniform(-30, 30, 300),
    "cosh": RNG.uniform(-30, 30, 300),
    "tanh": RNG.uniform(-5, 5, 300),
    "arctan": RNG.normal(0, 3, 300),
    "arcsin": RNG.uniform(-1, 1, 300),
    "arccos": RNG.uniform(-1, 1, 300),
}
MPMATH = {"arctan": "atan", "arcsin": "asin", "arccos": "acos"}


@pytest.mark.parametrize("name", DOMAINS)
def test_a_function_is_off_by_a_few_units_of_the_last_place(name: str) -> None:
    x = DOMAINS[name]
    found = elementary.on_floats(getattr(elementary, name))(x)
    with mpmath.workdps(40):
        true = [getattr(mpmath, MPMATH.get(name, name))(mpmath.mpf(float(each))) for each in x]
        # Of a sine or cosine near its zero, as many bits are right as the reduced angle has: 2e-16 of 1.
        scale = [1.0 if name in ("sin", "cos") else abs(float(each)) for each in true]
        off = [abs(float(mpmath.mpf(float(a)) - b)) / s for a, b, s in zip(found, true, scale, strict=True)]
    assert max(off) < 8e-16


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("name", ["exp", "log", "tanh", "expm1", "sinh", "cosh", "arctan", "floor"])
def test_of_what_is_no_usual_number_a_function_is_what_numpy_says(name: str) -> None:
    x = np.array([0.0, np.inf, -np.inf, np.nan, 1.0, -1.0, 1e300, -1e300])
    np.testing.assert_allclose(
        elementary.on_floats(getattr(elementary, name))(x), getattr(np, name)(x), rtol=4e-16
    )


def test_the_angle_of_two_numbers_is_right_in_all_quadrants() -> None:
    y, x = RNG.normal(size=(2, 1000))
    np.testing.assert_allclose(elementary.arctan2(y, x), np.arctan2(y, x), rtol=5e-16)
    axes = np.array([0.0, 0.0, 1.0, -1.0, 0.0]), np.array([1.0, -1.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(
        elementary.on_floats(elementary.arctan2)(*axes), [0, np.pi, np.pi / 2, -np.pi / 2, 0]
    )


@pytest.mark.parametrize("name", [*DOMAINS, "floor", "rounded"])
def test_the_bits_are_the_same_on_the_tape_in_numpy_and_on_every_processor(name: str) -> None:
    function = getattr(elementary, name)
    tape = Tape()
    x = tape.input("row", 0)
    node = function(x).index
    numpy = elementary.on_floats(function)(WIDE)
    (by_tape,) = evaluate(tape, [node], {("row", 0): WIDE})
    np.testing.assert_array_equal(by_tape, numpy)
    for label, (target, shape) in targets().items():
        np.testing.assert_array_equal(compiled(tape, node, WIDE, target, shape), numpy, err_msg=label)


def test_noise_has_the_same_bits_in_numpy_and_compiled() -> None:
    keys = robot_keys(4, "measurement", range(1000))
    tape = Tape()
    nodes = normals(tape.input("key", 0), tape.input(*COUNT), 5)
    for k in (0, 1, 77):
        values = evaluate(tape, [x.index for x in nodes], {("key", 0): keys, COUNT: np.uint64(k)})
        noise = Noise(keys[3], 5)
        for _ in range(k + 1):
            numbers, noise = noise.draw()
        np.testing.assert_array_equal(numbers, [value[3] for value in values])
    first = evaluate(tape, [nodes[1].index], {("key", 0): keys, COUNT: np.uint64(0)})
    for label, (target, shape) in targets().items():
        by_machine = compiled(tape, nodes[1].index, keys, target, shape, key=True)
        np.testing.assert_array_equal(by_machine, first[0], err_msg=label)


def split_mix(word: int) -> int:
    """Return the output of SplitMix64 at a state, as its authors write it, in Python's whole numbers."""
    word = (word ^ (word >> 30)) * 0xBF58476D1CE4E5B9 % 2**64
    word = (word ^ (word >> 27)) * 0x94D049BB133111EB % 2**64
    return word ^ (word >> 31)


def test_noise_is_box_and_mullers_of_split_mix_64() -> None:
    assert split_mix(0x9E3779B97F4A7C15) == 0xE220A8397B1DCDAF  # the first output of its seed 0
    keys = robot_keys(4, "measurement", range(300))
    k, pairs = 7, 3
    with np.errstate(over="ignore"):
        found = np.array(normals(keys, np.uint64(k), 2 * pairs)).reshape(pairs, 2, len(keys))
    for j, (x, y) in enumerate(found):
        for i, key in enumerate(keys.tolist()):
            word = split_mix((key + (k * pairs + j + 1) * 0x9E3779B97F4A7C15) % 2**64)
            sign, size, where, mirrored = word >> 63, (word >> 23) % 2**40, (word >> 1) % 2**22, word % 2
            radius = math.sqrt(-2 * math.log1p(-size / 2**40))
            angle = (where + 0.5 - 2**21) * math.pi / 2**23
            angle = (math.pi / 2 - angle if mirrored else angle) + math.pi * sign
            assert math.isclose(x[i], radius * math.cos(angle), rel_tol=0, abs_tol=2e-9 * radius)
            assert math.isclose(y[i], radius * math.sin(angle), rel_tol=0, abs_tol=2e-9 * radius)


@pytest.mark.parametrize("size", [0, 1, 2**39, 2**40 - 1])
def test_the_smallest_and_the_largest_noise_are_right(size: int) -> None:
    u = 1 - size / 2**40
    np.testing.assert_allclose(_minus_two_log(np.float64(u)), -2 * math.log(u), rtol=5e-11, atol=0)


def test_keys_follow_from_seed_name_and_robot() -> None:
    keys = robot_keys(1, "measurement", range(100))
    assert len(set(keys.tolist())) == 100
    np.testing.assert_array_equal(keys[40:60], robot_keys(1, "measurement", range(40, 60)))
    assert not set(keys.tolist()) & set(robot_keys(1, "wind", range(100)).tolist())
    assert not set(keys.tolist()) & set(robot_keys(2, "measurement", range(100)).tolist())
    np.testing.assert_array_equal(keys, robot_keys(np.random.SeedSequence(1), "measurement", range(100)))
