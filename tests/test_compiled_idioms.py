"""NumPy as people write it, on symbols; elementary functions and noise, the same bits everywhere."""

import math
from collections.abc import Callable
from typing import Any

import mpmath
import numpy as np
import pytest
from numpy import linalg

from pinmobile import errors
from pinmobile.arrays import Array
from pinmobile.compiled import Noise, elementary, robot_keys
from pinmobile.compiled.functions import tracing
from pinmobile.compiled.memory import _minus_two_log, normals
from pinmobile.compiled.symbolic import entries, symbols
from pinmobile.compiled.tape import COUNT, Node, Tape, evaluate
from tests.tapes import compiled
from tests.test_compiled_loop import targets

K = np.array([[100.0, 1.0, -2.0], [1.0, 90.0, 0.5], [-2.0, 0.5, 20.0]])
LIMITS = np.array([1.0, 2.0, 3.0])
STATES = np.array([[0.7, -1.3, 2.1], [-0.2, 0.4, -3.3], [1.6, 2.4, 0.0]])


def empty_set(q: Any) -> Any:
    x = np.empty(q.shape)
    x[..., 0] = q[..., 1]
    x[..., 1:] = q[..., 1:]
    return x


def matrix_set(q: Any) -> Any:
    m = np.eye(3) * q[0]
    m[0, 1] = q[1]
    m[2, :2] += q[:2]
    return m @ q


def mask_set(q: Any) -> Any:
    x = q.copy()
    x[x > 1] = 1.0
    return x


def mask_add(q: Any) -> Any:
    x = q.copy()
    x[2] = np.mod(x[2] + np.pi, 2 * np.pi) - np.pi
    return x


def solved_by_exchange(q: Any) -> Any:
    return np.linalg.solve(np.array([[0.0, 1.0, 0.0], [1.0, q[0], 0.0], [0.0, 2.0, 3.0]]), q)


def whole_set(q: Any) -> Any:
    x = np.zeros(3, dtype=int)
    x[0] = q[0]
    return x


def tuples(q: Any) -> Any:
    x, y, psi = q
    return np.array((x, y * psi, 0))


def loop_of_steps(q: Any) -> Any:
    x = q
    for _ in range(5):
        x = x - 0.1 * np.sin(x)
    return x


def enumerated(q: Any) -> Any:
    out = np.zeros(3)
    for i, x in enumerate(q):
        out[i] = x * i
    return out


def formatted(q: Any) -> Any:
    assert f"{q}"
    assert q.shape == (3,)
    assert len(q) == 3
    return q


ROWS = np.array([[1.0, -2.0, 3.0], [-0.5, 1.5, 2.5]])

IDIOMS: dict[str, Callable[[Any], Any]] = {
    "arithmetic": lambda q: 2 * q - q / 3 + 1,
    "power of a half": lambda q: (q * q) ** 0.5 + (q * q + 1) ** 1.5 + (q * q + 1) ** -0.7,
    "power of zero": lambda q: q**0 + q,
    "power of a symbol": lambda q: np.abs(q) ** q[0] + 2.0 ** q[0] + np.power(q, np.round(q[0])),
    "powers": lambda q: q ** np.array([1, 2, 3]),
    "sum where": lambda q: np.sum(q, where=q > 0) + np.prod(q, where=np.abs(q) > 1),
    "array of whole numbers": lambda q: np.array([q[0], 2.7], dtype=int),
    "cut": lambda q: q.astype(int),
    "matmul": lambda q: K @ q,
    "dot of symbols": lambda q: q.dot(q),
    "inner": lambda q: np.inner(q, q),
    "sine": lambda q: np.sin(q) + np.cos(q[2]) + np.tan(q * 0.3),
    "ellipsis": lambda q: q[..., 2] * q[..., :2],
    "list index": lambda q: q[[2, 0]] * LIMITS[[0, 1]],
    "known mask": lambda q: q[np.array([True, False, True])],
    "clip": lambda q: np.clip(q, -1, 1),
    "maximum": lambda q: np.maximum(q, 0.0),
    "fmax": lambda q: np.fmax(q, 0.2) + np.fmin(q, q[0]),
    "abs": lambda q: abs(q) + np.abs(q) + np.fabs(q),
    "sign": lambda q: np.sign(q),
    "tanh": lambda q: np.tanh(q / 0.1) + np.tanh(q),
    "hyperbolic": lambda q: np.sinh(q) + np.cosh(q),
    "hypot": lambda q: np.hypot(q[0], q[1]),
    "sqrt": lambda q: np.sqrt(q * q + 1) + np.cbrt(q * q + 1),
    "exp": lambda q: np.exp(-q) + np.expm1(q) + np.exp2(q),
    "log": lambda q: np.log(q * q + 1) + np.log1p(q * q) + np.log10(q * q + 2) + np.log2(q * q + 2),
    "inverse sine": lambda q: np.arcsin(np.tanh(q)) + np.arccos(np.tanh(q)),
    "norm, imported": lambda q: linalg.norm(q) + linalg.norm(q, 1) + linalg.norm(q, np.inf),
    "norm of a matrix": lambda q: np.linalg.norm(np.outer(q, q)),
    "sum, kept dimension": lambda q: q / np.sum(q * q + 1, axis=-1, keepdims=True),
    "standard deviation": lambda q: np.std(q) + np.var(q) + q.std(),
    "prod": lambda q: np.prod(q) + q.prod(),
    "max": lambda q: np.max(np.abs(q)) + np.min(q),
    "reduce": lambda q: np.add.reduce(q * q) + np.multiply.reduce(q) + np.maximum.reduce(q),
    "einsum": lambda q: np.einsum("ij,...j->...i", K, q),
    "einsum of three": lambda q: np.einsum("i,ij,j", q, K, q),
    "concatenate": lambda q: np.concatenate([q[:2], [0.0]]),
    "hstack": lambda q: np.hstack([q[:2], q[2]]),
    "vstack": lambda q: np.vstack([q, 2 * q]),
    "column stack": lambda q: np.column_stack([q, 2 * q]) @ np.array([1.0, 2.0]),
    "block": lambda q: np.block([[np.diag(q), np.zeros((3, 1))], [q[None], np.ones((1, 1))]]),
    "append": lambda q: np.append(q, 1.0),
    "empty and set": empty_set,
    "matrix and set": matrix_set,
    "mask and set": mask_set,
    "entry and set": mask_add,
    "isfinite": lambda q: np.where(np.isfinite(q), q, 0),
    "isnan": lambda q: np.where(np.isnan(q), 0, q),
    "logical": lambda q: np.where(np.logical_and(q > 0, q < 1), 1.0, 0.0),
    "logical not": lambda q: np.where(np.logical_not(q > 0) | (q == 0.7), 1.0, q),
    "select": lambda q: np.select([q > 1, q < -1], [q * 0 + 1, q * 0 - 1], q),
    "any": lambda q: np.where(np.any(q > 1), 0, q),
    "all": lambda q: np.where((q < 5).all(), q, 0),
    "solve": lambda q: np.linalg.solve(np.array([[2 + q[0] * q[0], 0.1, 0], [0.1, 3, 0], [0, 0, 1.0]]), q),
    "solve with exchanges": solved_by_exchange,
    "solve a known matrix": lambda q: np.linalg.solve(K, q),
    "inverse": lambda q: np.linalg.inv(np.diag(q * q + 1)) @ q,
    "determinant": lambda q: np.linalg.det(np.diag(q * q + 1) + K),
    "cholesky": lambda q: np.linalg.cholesky(K + np.diag(q * q)),
    "pseudo-inverse": lambda q: np.linalg.pinv(np.stack([q, LIMITS])) @ np.ones(2),
    "cross": lambda q: np.cross(q, np.array([0.0, 0, 1])),
    "outer": lambda q: np.outer(q, q) @ q,
    "kron": lambda q: np.kron(q, np.ones(2)),
    "trace": lambda q: np.trace(np.outer(q, q)),
    "tensordot": lambda q: np.tensordot(K, q, axes=1),
    "roll": lambda q: np.roll(q, 1),
    "flip": lambda q: np.flip(q),
    "diff": lambda q: np.diff(q),
    "cumsum": lambda q: np.cumsum(q) + q.cumsum(),
    "diag": lambda q: np.diag(q) @ q,
    "ravel": lambda q: np.outer(q, q).ravel() + np.outer(q, q).flatten(),
    "new axis": lambda q: (q[:, None] * K).sum(0),
    "expand_dims": lambda q: np.squeeze(np.expand_dims(q, 0)),
    "transpose": lambda q: np.outer(q, LIMITS).T.transpose(),
    "tile": lambda q: np.tile(q, 2) + np.repeat(q, 2),
    "broadcast": lambda q: np.broadcast_to(q[0], (3,)) + q,
    "atleast_1d": lambda q: np.atleast_1d(q[0]) + np.atleast_2d(q)[0],
    "mod": lambda q: np.mod(q + np.pi, 2 * np.pi) - np.pi,
    "floor division": lambda q: q // 0.3 + np.floor(q) + np.ceil(q) + np.trunc(q),
    "fmod": lambda q: np.fmod(q, 0.37),
    "round": lambda q: np.round(q) + np.round(q, 1) + round(q[0], 1),
    "heaviside": lambda q: np.heaviside(q, 0.5),
    "copysign": lambda q: np.copysign(1.0, q),
    "degrees": lambda q: np.deg2rad(q) + np.rad2deg(q) + np.radians(q),
    "square": lambda q: np.square(q) + np.reciprocal(q * q + 1) + np.negative(q),
    "out": lambda q: np.add(q, 1.0, out=np.zeros(3)),
    "sum of Python": lambda q: sum(x * x for x in q) + q[0] * 0,
    "astype": lambda q: np.asarray(q, np.float64).astype(float) * 2,
    "truths as floats": lambda q: (q > 0).astype(float) * q,
    "truths times numbers": lambda q: (np.abs(q) < 1) * q,
    "count of truths": lambda q: np.sum(q > 0) + np.count_nonzero(q > 1),
    "unpacked": tuples,
    "unrolled": loop_of_steps,
    "enumerated": enumerated,
    "sinc": lambda q: np.sinc(q),
    "arctan2": lambda q: np.arctan2(q[1], q[0]) + np.arctan(q),
    "interp": lambda q: np.interp(q, [-1.0, 0.0, 2.0], [3.0, 0.0, 1.0]),
    "sort": lambda q: np.sort(q),
    "median": lambda q: np.median(q),
    "formatted": formatted,
    "divmod": lambda q: np.divmod(q, 0.7)[1],
    "isclose": lambda q: np.where(np.isclose(q, 0.7), 1.0, q),
    "polyval": lambda q: np.polyval([1.0, 2.0, 3.0], q),
    "linspace": lambda q: q[0] * np.linspace(0, 1, 4),
    "division by what is known to be zero": lambda q: np.where(q > 9, 1.0 / np.zeros(3), q),
    "functions of what is known": lambda q: q + np.arctan2(np.ones(3), np.zeros(3)) + np.exp(np.ones(3)) ** 2,
    "meshgrid": lambda q: np.meshgrid(q, LIMITS)[0],
    "split": lambda q: np.split(q, 3)[1],
    "moveaxis": lambda q: np.moveaxis(np.outer(q, q), 0, 1),
    "take": lambda q: np.take(q, [2, 1]),
    "triu": lambda q: np.triu(np.outer(q, q)),
    "ptp": lambda q: np.ptp(q),
    "more axes": lambda q: np.array(q, ndmin=2),
    "deviation of columns": lambda q: np.std(ROWS * q, axis=0, keepdims=True) + (ROWS * q).var(0, ddof=1),
    "largest and an initial value": lambda q: np.max(ROWS * q, axis=0, initial=0.5) + q.min(initial=-0.3),
    "nan_to_num by place": lambda q: np.nan_to_num(q, True, 1.0),
    "arrays of two shapes": lambda q: q * float(np.array_equal(q, q[:1])),
    "filled in another shape": lambda q: np.full_like(q, q[0], shape=(2, 2)),
    "upper triangle": lambda q: np.linalg.cholesky(np.outer(q, q) + 9.0 * np.eye(3), upper=True),
    "norm of two axes": lambda q: np.linalg.norm(ROWS * q, axis=(0, 1)),
}


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("name", IDIOMS)
def test_an_idiom_gives_on_symbols_what_it_gives_on_numbers(name: str) -> None:
    law = IDIOMS[name]
    tape = Tape()
    given = symbols([tape.input("state", i) for i in range(3)], (3,))
    with tracing([globals()]):
        traced = entries(law(given))
    for state in STATES:
        expected = np.asarray(law(state.copy()), float)
        nodes = [x if type(x) is Node else tape.const(x) for x in traced.reshape(-1)]
        inputs = {("state", i): x for i, x in enumerate(state)}
        values = np.array([float(x) for x in evaluate(tape, [node.index for node in nodes], inputs)])
        assert traced.shape == expected.shape
        np.testing.assert_allclose(values.reshape(expected.shape), expected, rtol=1e-13, atol=1e-14)


def branching(q: Any) -> Any:
    return q if q[0] > 0 else -q


REFUSED: dict[str, tuple[Callable[[Any], Any], str]] = {
    "if": (branching, "np.where"),
    "and": (lambda q: (q[0] > 0) and (q[1] > 0), "np.logical_and"),
    "while": (lambda q: [x for x in q if x > 0], "np.where"),
    "math": (lambda q: math.sin(q[2]), "NumPy's function"),
    "index": (lambda q: LIMITS[q[0]], "np.where"),
    "selecting mask": (lambda q: q[q > 0], "np.where"),
    "argmax": (lambda q: q[np.argmax(q)], "np.max"),
    "eigenvalues": (lambda q: np.linalg.eigvalsh(np.outer(q, q)), "PYTHON"),
    "single precision": (lambda q: q.astype(np.float32), "float64"),
    "array of whole numbers": (whole_set, "arrays of floats"),
    "random": (lambda q: q + np.random.normal(size=3), "context.noise"),  # noqa: NPY002
    "array from outside": (lambda q: np.add(q, 1.0, out=LIMITS.copy()), "in the law"),
    "spectral norm": (lambda q: np.linalg.norm(np.outer(q, q), 2, axis=(0, 1)), "np.abs"),
    "unknown ufunc": (lambda q: np.nextafter(q, 1.0), "use one of"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_traced_is_refused_with_the_line_and_what_to_write(name: str) -> None:
    refused, instead = REFUSED[name]
    tape = Tape()
    given = symbols([tape.input("state", i) for i in range(3)], (3,))
    with pytest.raises(errors.NotTraceable) as caught, tracing([globals()]):
        refused(given)
    line = refused.__code__.co_firstlineno
    assert instead in caught.value.remedy
    assert "test_compiled_idioms.py" in caught.value.place
    assert any(f"line {line + more} of" in caught.value.place for more in range(3))


def test_numpy_is_itself_again_afterwards_and_for_other_threads() -> None:
    assert np.zeros is globals()["np"].zeros
    assert type(np.zeros(3)) is np.ndarray
    assert type(np).__name__ == "module"


# -- own elementary functions and noise ------------------------------------------------------------


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
