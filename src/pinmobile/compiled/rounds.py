"""Rounds of a law until nothing changes any more, of numbers and arrays, and on the tape as a loop."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from pinmobile.compiled.tape import Node, root, select


def choose(condition: Any, a: Any, b: Any) -> Any:
    """Return a where a condition holds, else b: of numbers quicker than by NumPy."""
    if isinstance(condition, bool | np.bool_):
        return a if condition else b
    return select(condition, a, b)


def higher(a: Any, b: Any) -> Any:
    """Return the larger of two scalars."""
    return choose(a > b, a, b)


def square_root(x: Any) -> Any:
    """Return the square root of a scalar that is not below zero."""
    return math.sqrt(x) if isinstance(x, float) else root(x)


def repeated(
    law: Callable[[list[Any]], tuple[Sequence[Any], Any]], first: Sequence[Any], most: int
) -> list[Any]:
    """Return some numbers after rounds of a law.

    Compiled, a block of robots goes on until all are done; one that is done stays as it is, so that no robot
    depends on who is beside it.

    Parameters
    ----------
    law : callable
        ``law(numbers)`` returns the numbers after a round, and whether no further one is needed.
    first : sequence of scalars
        The numbers before the first round: numbers, arrays, or symbols.
    most : int
        Rounds at most, one or more.
    """
    for x in first:
        if type(x) is Node:
            return list(x.tape.repeated(law, first, most))
    carried, done = list(first), np.bool_(False)
    for _ in range(most):
        found, now = law(list(carried))
        if np.any(done):
            found = [np.where(done, old, new) for old, new in zip(carried, found, strict=True)]
        carried, done = list(found), done | now
        if np.all(done):
            break
    return carried
