"""A plain function as a controller."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from pinmobile.arrays import Array, ArrayLike, are_real, callable_as
from pinmobile.controllers.protocol import Controller
from pinmobile.errors import InvalidArgument, shown
from pinmobile.plant import Context

__all__ = ["law"]


@dataclass(frozen=True)
class _Law:
    function: Callable[[float, Array, Array, Any], ArrayLike]

    def initial_state(self, context: Context) -> None:
        """Return None: there is no memory."""

    def __call__(self, t: float, q: Array, v: Array, reference: Any, state: None) -> tuple[Array, None]:
        """Return what the function returns, and None."""
        force = self.function(t, q, v, reference)
        try:
            if not are_real(force):
                raise TypeError
            return np.asarray(force if force is not None else "nothing", np.float64), None
        except (TypeError, ValueError):
            raise InvalidArgument(
                f"function of the law returned {shown(force)} at t = {t:g} s, expected a force: nu numbers"
            ) from None


def law(function: Callable[[float, Array, Array, Any], ArrayLike]) -> Controller:
    """Return a controller without memory made of a plain function.

    Parameters
    ----------
    function : callable
        ``function(t, q, v, reference) -> tau``, with `reference` a `Reference`.

    Raises
    ------
    InvalidArgument
        If it cannot be called so.
    """
    return _Law(callable_as("function(t, q, v, reference)", function))
