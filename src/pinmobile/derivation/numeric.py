"""A derivation as numeric functions that broadcast over leading axes."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy
from sympy import Expr, ImmutableMatrix, Symbol

from pinmobile.arrays import Array, ArrayLike, finite, representable, vector
from pinmobile.errors import InvalidArgument, UnknownName, shown

if TYPE_CHECKING:
    from pinmobile.derivation.steps import Derivation

__all__ = ["Numeric"]

Parameters = Mapping[str, ArrayLike]
_NONE: Parameters = MappingProxyType({})


@dataclass(frozen=True)
class Numeric:
    """M, n and the inputs of a derivation, for arrays.

    Coordinates are in the order of the derivation. `params` maps the name of each of its parameters to a
    number or an array; its shape is broadcast against the leading axes of the other arguments. Each
    function is compiled when it is first called.

    Parameters
    ----------
    derivation : Derivation
        The equations.
    """

    derivation: "Derivation"

    def __reduce__(self) -> tuple[type["Numeric"], tuple["Derivation"]]:
        # compiled functions do not travel to other processes
        return type(self), (self.derivation,)

    def mass_matrix(self, q: ArrayLike, params: Parameters = _NONE) -> Array:
        """Return M(q).

        Parameters
        ----------
        q : array_like, shape (..., n)
            Coordinates [m or rad].
        params : mapping of str to array_like, shape (...)
            Parameters [SI units].

        Returns
        -------
        M : ndarray, shape (..., n, n)
            Mass matrix [kg, kg m or kg m^2].

        Raises
        ------
        InvalidArgument
            If a shape does not fit, a number is not finite, or a parameter is missing.
        UnknownName
            If `params` has a name that is no parameter.
        """
        flat = self._evaluate(self._mass_matrix, {"q": q}, params)
        size = len(self.derivation.chain)
        return flat.reshape(*flat.shape[:-1], size, size)

    def nonlinear_effects(self, q: ArrayLike, v: ArrayLike, params: Parameters = _NONE) -> Array:
        """Return n(q, v).

        Parameters
        ----------
        q, v : array_like, shape (..., n)
            Coordinates [m or rad] and velocities [m/s or rad/s].
        params : mapping of str to array_like, shape (...)
            Parameters [SI units].

        Returns
        -------
        n : ndarray, shape (..., n)
            Centrifugal, Coriolis and gravitational terms [N or N m].

        Raises
        ------
        InvalidArgument
            If a shape does not fit, a number is not finite, or a parameter is missing.
        UnknownName
            If `params` has a name that is no parameter.
        """
        return self._evaluate(self._nonlinear_effects, {"q": q, "v": v}, params)

    def inverse_dynamics(self, q: ArrayLike, v: ArrayLike, a: ArrayLike, params: Parameters = _NONE) -> Array:
        """Return the inputs M(q) a + n(q, v).

        Parameters
        ----------
        q, v, a : array_like, shape (..., n)
            Coordinates [m or rad], velocities [m/s or rad/s] and accelerations [m/s^2 or rad/s^2].
        params : mapping of str to array_like, shape (...)
            Parameters [SI units].

        Returns
        -------
        tau : ndarray, shape (..., n)
            Generalised forces [N or N m].

        Raises
        ------
        InvalidArgument
            If a shape does not fit, a number is not finite, or a parameter is missing.
        UnknownName
            If `params` has a name that is no parameter.
        """
        return self._evaluate(self._inputs, {"q": q, "v": v, "a": a}, params)

    @cached_property
    def _names(self) -> tuple[str, ...]:
        return tuple(symbol.name for symbol in self.derivation.parameters)

    @cached_property
    def _mass_matrix(self) -> Callable[..., list[Any]]:
        derivation = self.derivation
        return self._compiled(derivation.q, derivation.mass_matrix)

    @cached_property
    def _nonlinear_effects(self) -> Callable[..., list[Any]]:
        derivation = self.derivation
        return self._compiled(derivation.q + derivation.v, derivation.nonlinear_effects)

    @cached_property
    def _inputs(self) -> Callable[..., list[Any]]:
        derivation = self.derivation
        return self._compiled(derivation.q + derivation.v + derivation.a, derivation.inputs)

    def _compiled(self, state: tuple[Symbol, ...], matrix: ImmutableMatrix) -> Callable[..., list[Any]]:
        """Return a function of the entries of the state and of the parameters."""
        arguments = [*state, *self.derivation.parameters]
        program = _program(self.derivation.assignments, matrix)
        # dummify: a joint may be called sin, or x0 as the first common subexpression is
        function: Callable[..., list[Any]] = sympy.lambdify(
            arguments,
            [_rounded(entry) for entry in matrix],
            modules="numpy",
            dummify=True,
            docstring_limit=0,
            cse=(lambda entries: (program, entries)) if program else True,
        )
        return function

    def _evaluate(
        self, function: Callable[..., list[Any]], state: Mapping[str, ArrayLike], params: Parameters
    ) -> Array:
        size = len(self.derivation.chain)
        arrays = [vector(name, value, size) for name, value in state.items()]
        arguments = [array[..., i] for array in arrays for i in range(size)] + self._values(params)
        try:
            leading = np.broadcast_shapes(*(argument.shape for argument in arguments))
        except ValueError:
            shapes = ", ".join(f"{name} {np.shape(value)}" for name, value in {**state, **params}.items())
            raise InvalidArgument(f"shapes are {shapes}, expected leading axes that broadcast") from None
        with np.errstate(all="ignore"):
            entries = function(*arguments)
        result = np.empty((*leading, len(entries)))
        for i, entry in enumerate(entries):
            result[..., i] = entry
        return representable("an entry of the result", result)

    def _values(self, params: Parameters) -> list[Array]:
        names = self._names
        if not isinstance(params, Mapping):
            raise InvalidArgument(f"params is {shown(params)}, expected a mapping with {', '.join(names)}")
        if params.keys() != set(names):
            for name in params:
                if name not in names:
                    raise UnknownName("parameter", name, names)
            missing = ", ".join(name for name in names if name not in params)
            raise InvalidArgument(f"params lacks {missing}, expected {', '.join(names)}")
        return [finite(f"params[{name!r}]", params[name]) for name in names]


def _program(
    assignments: tuple[tuple[Symbol, Expr], ...], matrix: ImmutableMatrix
) -> list[tuple[Symbol, Expr]]:
    """Return the assignments that `matrix` depends on, in their order."""
    needed, program = set(matrix.free_symbols), []
    for symbol, value in reversed(assignments):
        if symbol in needed:
            needed |= value.free_symbols
            program.append((symbol, _rounded(value)))
    return program[::-1]


def _rounded(expression: Expr) -> Expr:
    """Return `expression` with its constants, such as sqrt(2), as floats."""
    constants = expression.atoms(sympy.Pow, sympy.Function, sympy.NumberSymbol)
    return expression.xreplace({c: c.evalf(17) for c in constants if c.is_number})
