"""A plain function as a controller."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from pinmobile.arrays import Array, ArrayLike
from pinmobile.controllers.protocol import Controller
from pinmobile.errors import InvalidArgument, shown

__all__ = ["law"]


@dataclass(frozen=True)
class _Law:
    function: Callable[[float, Array, Array, Any], ArrayLike]

    def initial_state(self) -> None:
        """Return None: there is no memory."""

    def __call__(self, t: float, q: Array, v: Array, reference: Any, state: None) -> tuple[Array, None]:
        """Return what the function returns, and None."""
        return np.asarray(self.function(t, q, v, reference), np.float64), None


def law(function: Callable[[float, Array, Array, Any], ArrayLike]) -> Controller:
    """Return a controller without memory made of a plain function.

    Parameters
    ----------
    function : callable
        ``function(t, q, v, reference) -> tau``, with `reference` a `Reference`.

    Raises
    ------
    InvalidArgument
        If it cannot be called.
    """
    if not callable(function):
        raise InvalidArgument(f"function is {shown(function)}, expected a function of t, q, v and reference")
    return _Law(function)
