"""Functions of one state, compiled for many."""

from typing import Any

import numpy as np
import pytest

from pinmobile import errors
from pinmobile.compiled import Batched, Cache
from tests.looping import Body
from tests.test_compiled_loop import targets

NONE = Cache("")
RNG = np.random.default_rng(8)


def test_a_function_is_the_same_for_many_states() -> None:
    body = Body(12.0, 0.9, (0.2, -0.1))
    q, v, u = RNG.normal(size=(3, 1003, 3))
    forward = Batched(body.forward_dynamics, [(3,), (3,), (3,)], cache=NONE)
    np.testing.assert_allclose(forward(q, v, u), body.forward_dynamics(q, v, u), rtol=1e-12, atol=1e-13)
    inverse = Batched(body.inverse_dynamics, [(3,), (3,), (3,)], cache=NONE)
    np.testing.assert_allclose(inverse(q, v, forward(q, v, u)), u, rtol=1e-11, atol=1e-11)
    np.testing.assert_array_equal(forward(q, v, u), forward(q, v, u, threads=2))
    np.testing.assert_array_equal(forward(q[:5], v[:5], u[:5]), forward(q, v, u)[:5])


def test_leading_axes_broadcast_and_several_arrays_come_back() -> None:
    def law(a: Any, x: Any) -> Any:
        return a @ x, x > 0, np.linalg.norm(x)

    a, x = RNG.normal(size=(4, 1, 2, 3)), RNG.normal(size=(5, 3))
    product, positive, norm = Batched(law, [(2, 3), (3,)], cache=NONE)(a, x)
    np.testing.assert_allclose(product, (a @ x[..., None])[..., 0], rtol=1e-13, atol=1e-14)
    np.testing.assert_array_equal(positive, np.broadcast_to(x > 0, (4, 5, 3)))
    np.testing.assert_allclose(norm, np.broadcast_to(np.linalg.norm(x, axis=-1), (4, 5)))
    one = Batched(lambda x: 2 * x, [(3,)], cache=NONE)
    assert one(x[0]).shape == (3,)
    assert one(x[:0]).shape == (0, 3)


def test_what_is_the_same_for_all_states_is_handed_over_once() -> None:
    def law(x: Any, A: Any, b: Any) -> Any:
        return A @ x + b, np.zeros(0), 3.0

    A, b, x = RNG.normal(size=(11, 3)), RNG.normal(size=11), RNG.normal(size=(21, 3))
    affine = Batched(law, [(3,), (11, 3), (11,)], alike=2, cache=NONE)
    assert affine.size == 12
    for n in (1, 3, 8, 21):
        found, nothing, three = affine(x[:n], A, b)
        np.testing.assert_allclose(found, x[:n] @ A.T + b, rtol=1e-13, atol=1e-13)
        assert nothing.shape == (n, 0)
        np.testing.assert_array_equal(three, np.full(n, 3.0))
    with pytest.raises(errors.InvalidArgument, match=r"expected \(\.\.\., 3\), \(11, 3\), \(11,\)$"):
        affine(x, A[None], b)


def test_a_law_of_too_many_operations_is_refused() -> None:
    with pytest.raises(errors.NotTraceable, match="more than 20 operations"):
        Batched(lambda x: np.sin(x), [(3,)], largest=20, cache=NONE)


def test_the_bits_are_those_of_every_processor() -> None:
    body = Body(12.0, 0.9, (0.2, -0.1))
    given = RNG.normal(size=(3, 101, 3))
    shapes = [(3,), (3,), (3,)]
    found = [
        Batched(body.forward_dynamics, shapes, target=target, cache=NONE)(*given)
        for target, _ in targets().values()
    ]
    for other in found[1:]:
        np.testing.assert_array_equal(found[0], other)


def test_other_shapes_are_refused() -> None:
    add = Batched(lambda x, y: x + y[0], [(3,), (2,)], cache=NONE)
    with pytest.raises(
        errors.InvalidArgument, match=r"shapes \[\(3,\), \(3,\)\], expected \(\.\.\., 3\), \(\.\.\., 2\)"
    ):
        add(np.zeros(3), np.zeros(3))
    with pytest.raises(errors.InvalidArgument, match="expected"):
        add(np.zeros(3))


def test_what_is_another_function_each_time_is_refused() -> None:
    count = [0]

    def counting(x: Any) -> Any:
        count[0] += 1
        return x * count[0]

    with pytest.raises(errors.NotTraceable, match="counting"):
        Batched(counting, [(3,)], cache=NONE)
