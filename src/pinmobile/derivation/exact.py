"""Numbers and matrices as sympy expressions without rounding."""

from math import isclose, pi
from typing import Any

import numpy as np
import sympy
from sympy import Expr, ImmutableMatrix

from pinmobile.errors import InvalidArgument, shown

__all__ = ["exact", "exact_angle", "exact_matrix"]


def exact(name: str, value: Any) -> Expr:
    """Return `value` as an expression without floating-point numbers.

    A float becomes the fraction that its shortest decimal form spells (0.3 becomes 3/10) and evaluates to the
    same float again. With rounding inside, equal expressions would not cancel.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : float or sympy.Expr
        The argument, in any unit.

    Raises
    ------
    InvalidArgument
        If it is neither a finite real number nor an expression.
    """
    try:
        expression = sympy.sympify(value, strict=True)
    except Exception:  # whatever the value itself raises when it is asked for its numbers
        expression = None
    if not isinstance(expression, Expr) or expression.has(sympy.nan, sympy.zoo, sympy.oo, sympy.I):
        raise InvalidArgument(
            f"{name} is {shown(value)}, expected a finite real number or a sympy expression"
        )
    floats = expression.atoms(sympy.Float)
    return expression.xreplace({number: sympy.Rational(repr(float(number))) for number in floats})


def exact_matrix(name: str, value: Any, shape: tuple[int, int]) -> ImmutableMatrix:
    """Return `value` as a matrix of expressions without floating-point numbers.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : nested sequence, array or sympy.Matrix
        The entries, in any unit; a flat sequence is a column.
    shape : (int, int)
        What is expected.

    Raises
    ------
    InvalidArgument
        If it has another shape, or an entry is neither a finite real number nor an expression.
    """
    rows = value.tolist() if isinstance(value, sympy.MatrixBase | np.ndarray) else value
    flat = shape[1] == 1 and isinstance(rows, list | tuple) and not any(map(_is_row, rows))
    rows = [[row] for row in rows] if flat else rows
    fits = isinstance(rows, list | tuple) and len(rows) == shape[0]
    if isinstance(value, np.ma.MaskedArray) or not fits or not all(map(_is_row, rows)):
        rows = ((),)
    if any(len(row) != shape[1] for row in rows):
        wanted = f"{shape[0]} entries" if shape[1] == 1 else f"shape {shape}"
        raise InvalidArgument(f"{name} is {shown(value)}, expected {wanted}")
    return ImmutableMatrix(*shape, [exact(name, entry) for row in rows for entry in row])


def _is_row(value: Any) -> bool:
    return isinstance(value, list | tuple)


def exact_angle(name: str, value: float) -> Expr:
    """Return a multiple of pi/12 [rad] as such, any other angle as `exact` does.

    The sines and cosines of these multiples are sums of square roots, which sympy cancels by itself.

    Parameters
    ----------
    name : str
        Name of the argument, for the message.
    value : float
        The angle [rad].

    Raises
    ------
    InvalidArgument
        If it is not a finite real number.
    """
    twelfths = round(value * 12 / pi)
    if isclose(value, twelfths * pi / 12, rel_tol=1e-14, abs_tol=1e-15):
        return sympy.Rational(twelfths, 12) * sympy.pi
    return exact(name, value)
