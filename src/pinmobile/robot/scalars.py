"""Scalars of which some are known to be 0, 1 or -1, and the algebra of short lists of them.

A scalar is anything that is added, multiplied and divided: a number, an array of numbers of many states, or a
symbol of a compiled loop. Vectors and matrices are lists, as symbols are no arrays of NumPy's.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any, TypeAlias

import numpy as np

from pinmobile.compiled.elementary import sincos
from pinmobile.compiled.tape import Node
from pinmobile.constancy import constant

__all__ = [
    "ENTRIES",
    "ONE",
    "ZERO",
    "Exact",
    "Matrix",
    "Vector",
    "added",
    "applied",
    "cross",
    "dot",
    "exact",
    "number",
    "plus",
    "product",
    "scaled",
    "sine_and_cosine",
    "skew",
    "symmetric",
    "transposed",
    "turned",
]

Vector: TypeAlias = list[Any]
Matrix: TypeAlias = list[list[Any]]

ENTRIES = (0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)
"""The entries of a symmetric matrix that differ."""


@constant
class Exact:
    """0, 1 or -1 that stands in a formula: products with it cost nothing."""

    __array_ufunc__ = None  # arrays leave the operation to it

    def __init__(self, value: float) -> None:
        self.value = value

    def __mul__(self, other: Any) -> Any:
        return other if self.value == 1 else -other if self.value else self

    __rmul__ = __mul__

    def __add__(self, other: Any) -> Any:
        if not self.value:
            return other
        return exact(self.value + other.value) if isinstance(other, Exact) else self.value + other

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return self + -other

    def __rsub__(self, other: Any) -> Any:
        return other + -self

    def __neg__(self) -> "Exact":
        return _EXACT[-self.value]

    def __truediv__(self, other: Any) -> Any:
        return self.value / other if self.value else self

    def __rtruediv__(self, other: Any) -> Any:
        return other * exact(1 / self.value)

    def __float__(self) -> float:
        return self.value


_EXACT = {value: Exact(value) for value in (0.0, 1.0, -1.0)}
ZERO, ONE = _EXACT[0.0], _EXACT[1.0]


def exact(x: Any) -> Any:
    """Return a scalar; where it is known to be 0, 1 or -1, as what costs nothing."""
    known = x.value if type(x) is Node else x
    return _EXACT.get(float(known), x) if isinstance(known, int | float) else x


def number(x: Any) -> Any:
    """Return a scalar, as a float where it is one of those that cost nothing."""
    return x.value if isinstance(x, Exact) else x


def sine_and_cosine(x: Any) -> tuple[Any, Any]:
    """Return sine and cosine of a scalar."""
    if isinstance(x, Exact | float | int):
        return exact(math.sin(x)), exact(math.cos(x))
    if hasattr(x, "sine_and_cosine"):
        return x.sine_and_cosine()  # type: ignore[no-any-return]
    return sincos(x) if type(x) is Node else (np.sin(x), np.cos(x))


def plus(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return [y if x is ZERO else x if y is ZERO else x + y for x, y in zip(a, b, strict=True)]


def scaled(k: Any, a: Vector) -> Vector:
    """Return k a."""
    return [k * x for x in a]


def dot(a: Iterable[Any], b: Iterable[Any]) -> Any:
    """Return a . b."""
    found: Any = ZERO
    for x, y in zip(a, b, strict=True):
        if x is not ZERO and y is not ZERO:
            found = x * y if found is ZERO else found + x * y
    return found


def cross(a: Vector, b: Vector) -> Vector:
    """Return a x b."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def applied(A: Matrix, x: Vector) -> Vector:
    """Return A x."""
    return [dot(row, x) for row in A]


def transposed(A: Matrix) -> Matrix:
    """Return A'."""
    return [list(column) for column in zip(*A, strict=True)]


def product(A: Matrix, B: Matrix) -> Matrix:
    """Return A B."""
    return [[dot(row, column) for column in zip(*B, strict=True)] for row in A]


def added(A: Matrix, B: Matrix) -> Matrix:
    """Return A + B."""
    return [plus(a, b) for a, b in zip(A, B, strict=True)]


def skew(a: Vector) -> Matrix:
    """Return the matrix whose product with x is a x x."""
    return [[ZERO, -a[2], a[1]], [a[2], ZERO, -a[0]], [-a[1], a[0], ZERO]]


def symmetric(J: Sequence[Any]) -> Matrix:
    """Return the matrix of (xx, yy, zz, xy, xz, yz)."""
    return [[J[0], J[3], J[4]], [J[3], J[1], J[5]], [J[4], J[5], J[2]]]


def turned(R: Matrix, J: Matrix) -> Matrix:
    """Return R J R' of a symmetric J."""
    A, found = product(R, J), [[ZERO] * 3 for _ in range(3)]
    for r, c in ENTRIES:
        found[r][c] = found[c][r] = dot(A[r], R[c])
    return found
