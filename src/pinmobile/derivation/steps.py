"""A derivation and its steps: what is looked up, read, typeset and turned into numbers."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from shutil import get_terminal_size
from types import MappingProxyType
from typing import Any

import numpy as np
import sympy
from sympy import Expr, ImmutableMatrix, Symbol

from pinmobile.arrays import Array, ArrayLike, finite, instance, representable, vector
from pinmobile.derivation.chain import Chain
from pinmobile.errors import InvalidArgument, UnknownName, shown

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

    derivation: Derivation

    def __reduce__(self) -> tuple[type[Numeric], tuple[Derivation]]:
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


Assignments = tuple[tuple[Symbol, Expr], ...]


def _latex(expression: Expr | ImmutableMatrix) -> str:
    names = {}
    for symbol in expression.free_symbols:
        if parts := re.fullmatch(r"(I)([cwxyz]+\d*)|([xyz])(b?c\d*)", symbol.name):
            letter, index = (part for part in parts.groups() if part)
            names[symbol] = f"{letter}_{{{index}}}"
    return str(sympy.latex(expression, symbol_names=names))


def _text(expression: Expr | ImmutableMatrix) -> str:
    picture = str(sympy.pretty(expression, wrap_line=False))
    if max(map(len, picture.splitlines())) <= get_terminal_size().columns:
        return picture
    # a picture that the terminal breaks is not legible, a line is
    if not isinstance(expression, ImmutableMatrix):
        return str(expression)
    rows, columns = expression.shape
    places = [
        f"{i}, {j}" if columns > 1 else str(i) for i in range(1, rows + 1) for j in range(1, columns + 1)
    ]
    lines = [f"  [{place}] = {entry}" for place, entry in zip(places, expression, strict=True) if entry]
    return "\n".join([*lines, "  all others = 0"] if len(lines) < len(places) else lines)


@dataclass(frozen=True)
class Step:
    """One line of the derivation. In a notebook it shows as a formula, printed as text.

    Attributes
    ----------
    name : str
        Key in the derivation, such as ``"omega_3"``.
    title : str
        Heading.
    explanation : str
        One sentence: where the expression comes from.
    symbol : str
        LaTeX of the left-hand side.
    expression : sympy.Expr or sympy.ImmutableMatrix
        The right-hand side [SI units].
    """

    name: str
    title: str
    explanation: str
    symbol: str
    expression: Expr | ImmutableMatrix

    def latex(self) -> str:
        """Return the formula as LaTeX, without delimiters."""
        return f"{self.symbol} = {_latex(self.expression)}"

    def _repr_latex_(self) -> str:
        return rf"$\displaystyle {self.latex()}$"

    def __str__(self) -> str:
        return f"{self.title}\n  {self.explanation}\n{self.name} =\n{_text(self.expression)}"


class Told:
    """What is told in steps: they are looked up by name, and shown one after the other."""

    steps: tuple[Step, ...]
    assignments: Assignments

    def __getitem__(self, name: str) -> Step:
        for step in self.steps:
            if step.name == name:
                return step
        raise UnknownName("step", name, [step.name for step in self.steps])

    def written_out(self, expression: Expr | ImmutableMatrix) -> Expr | ImmutableMatrix:
        """Return `expression` with every name of `assignments` replaced by what it stands for.

        The result can be very long.

        Raises
        ------
        InvalidArgument
            If `expression` is something else.
        """
        instance("expression", expression, Expr | ImmutableMatrix, "a sympy expression or matrix")
        full: dict[Symbol, Expr] = {}
        for symbol, value in self.assignments:
            full[symbol] = value.xreplace(full)
        return expression.xreplace(full)

    def latex(self) -> str:
        """Return all steps as one LaTeX environment."""
        lines = (
            rf"&\text{{{step.title}}}\quad & {step.symbol} &= {_latex(step.expression)}"
            for step in self.steps
        )
        return "\\begin{alignat*}{2}\n" + " \\\\\n".join(lines) + "\n\\end{alignat*}"

    def _repr_latex_(self) -> str:
        return self.latex()

    def __str__(self) -> str:
        return "\n\n".join(map(str, self.steps))


@dataclass(frozen=True)
class Derivation(Told):
    """The equations of motion M(q) a + n(q, v) = inputs, and how they came about.

    `derivation["M"]` is the step of that name. Up to three joints every expression is simplified. Beyond,
    each entry of a result has a name, by which later steps refer to it: omega_2x is the first entry of the
    step omega_2. A superscript marks the same quantity in another motion: M1 with nothing but a unit
    acceleration of joint 1, n without acceleration.

    Attributes
    ----------
    chain : Chain
        What was derived. Coordinates below are in `chain.order`, not in that of the rows.
    steps : tuple of Step
        In the order in which they were taken.
    inputs : sympy.ImmutableMatrix, shape (n, 1)
        Generalised forces as functions of (q, v, a) [N or N m].
    mass_matrix : sympy.ImmutableMatrix, shape (n, n)
        M(q) [kg, kg m or kg m^2].
    nonlinear_effects : sympy.ImmutableMatrix, shape (n, 1)
        n(q, v): centrifugal, Coriolis and gravitational terms [N or N m].
    assignments : tuple of (sympy.Symbol, sympy.Expr)
        The names of intermediate results, each in terms of earlier ones; empty for up to three joints.
    """

    chain: Chain
    steps: tuple[Step, ...] = field(repr=False)
    inputs: ImmutableMatrix = field(repr=False)
    mass_matrix: ImmutableMatrix = field(repr=False)
    nonlinear_effects: ImmutableMatrix = field(repr=False)
    assignments: Assignments = field(repr=False)

    @property
    def q(self) -> tuple[Symbol, ...]:
        """Coordinates [m or rad]."""
        return self.chain.ordered(self.chain.q)

    @property
    def v(self) -> tuple[Symbol, ...]:
        """Velocities [m/s or rad/s]."""
        return self.chain.ordered(self.chain.v)

    @property
    def a(self) -> tuple[Symbol, ...]:
        """Accelerations [m/s^2 or rad/s^2]."""
        return self.chain.ordered(self.chain.a)

    @property
    def parameters(self) -> tuple[Symbol, ...]:
        """Symbols in links and gravity; their names are the keys of `params` in the numeric functions."""
        return self.chain.parameters

    def numeric(self) -> Numeric:
        """Return M, n and the inputs as fast functions of arrays; keep it, as it keeps what it compiles."""
        return Numeric(self)
