"""Steps of a derivation, with their texts, and functions from its results."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from shutil import get_terminal_size
from string import Template
from types import MappingProxyType
from typing import Any

import numpy as np
import sympy
from sympy import Expr, ImmutableMatrix, Symbol

from pinmobile.arrays import (
    Array,
    ArrayLike,
    broadcast_shapes,
    check_overflow,
    finite,
    instance,
    one_of,
    vector,
)
from pinmobile.derivation.chain import Chain, group_terms, reduce_terms
from pinmobile.dh import DHRow, JointType
from pinmobile.errors import InvalidArgument

Parameters = Mapping[str, ArrayLike]
_NONE: Parameters = MappingProxyType({})


@dataclass(frozen=True)
class Numeric:
    """Functions M, n and inputs of a derivation, for arrays.

    Coordinates have the order of the derivation. The argument ``params`` maps the name of each parameter to a
    number or an array. Arrays broadcast against the leading axes of the other arguments. Each function is
    compiled at its first call.

    Parameters
    ----------
    derivation : Derivation
        Derivation with the equations.

    See Also
    --------
    derivation.Derivation.numeric : method that returns this object
    closed_form.mass_matrix : formulas derived by hand

    Examples
    --------
    >>> import sympy
    >>> from pinmobile.derivation import Link, Numeric, derive
    >>> from pinmobile.dh import DHRow, DHTable, JointType
    >>> m, l = sympy.symbols("m l")
    >>> hinge = DHTable([DHRow(0, 0, 0, 0, JointType.REVOLUTE, "q")])
    >>> pendulum = derive(hinge, [Link(m, (l, 0, 0), sympy.zeros(3))])
    >>> Numeric(pendulum).mass_matrix([0], {"m": 2.0, "l": 0.5})
    array([[0.5]])
    """

    derivation: Derivation

    def __reduce__(self) -> tuple[type[Numeric], tuple[Derivation]]:
        # compiled functions cannot be pickled
        return type(self), (self.derivation,)

    def mass_matrix(self, q: ArrayLike, params: Parameters = _NONE) -> Array:
        """Return the mass matrix M(q).

        Parameters
        ----------
        q : array_like, shape (..., n)
            Coordinates [m or rad].
        params : mapping of str to array_like, shape (...)
            Parameters [SI units].

        Returns
        -------
        ndarray, shape (..., n, n)
            Mass matrix [kg, kg m or kg m^2].

        Raises
        ------
        InvalidArgument
            If a shape does not fit, a number is not finite, or a parameter is missing.
        UnknownName
            If `params` has a name that is not a parameter.
        """
        flat = self._evaluate("mass_matrix", {"q": q}, params)
        size = len(self.derivation.chain)
        return flat.reshape(*flat.shape[:-1], size, size)

    def nonlinear_effects(self, q: ArrayLike, v: ArrayLike, params: Parameters = _NONE) -> Array:
        """Return the nonlinear effects n(q, v).

        Parameters
        ----------
        q, v : array_like, shape (..., n)
            Coordinates [m or rad] and velocities [m/s or rad/s].
        params : mapping of str to array_like, shape (...)
            Parameters [SI units].

        Returns
        -------
        ndarray, shape (..., n)
            Centrifugal, Coriolis and gravitational terms [N or N m].

        Raises
        ------
        InvalidArgument
            If a shape does not fit, a number is not finite, or a parameter is missing.
        UnknownName
            If `params` has a name that is not a parameter.
        """
        return self._evaluate("nonlinear_effects", {"q": q, "v": v}, params)

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
        ndarray, shape (..., n)
            Generalised forces [N or N m].

        Raises
        ------
        InvalidArgument
            If a shape does not fit, a number is not finite, or a parameter is missing.
        UnknownName
            If `params` has a name that is not a parameter.
        """
        return self._evaluate("inputs", {"q": q, "v": v, "a": a}, params)

    @cached_property
    def _functions(self) -> dict[str, Callable[..., list[Any]]]:
        """Compiled functions by name of the result."""
        return {}

    def _function(self, name: str, state: Iterable[str]) -> Callable[..., list[Any]]:
        """Return the function of the entries of the state and the parameters that computes a result."""
        if name not in self._functions:
            derivation = self.derivation
            matrix = getattr(derivation, name)
            arguments = [symbol for letter in state for symbol in getattr(derivation, letter)]
            program = _program(derivation.assignments, matrix)
            # dummify: a joint may have the name sin, or x0 like the first common subexpression
            self._functions[name] = sympy.lambdify(
                [*arguments, *derivation.parameters],
                [_round_constants(entry) for entry in matrix],
                modules="numpy",
                dummify=True,
                docstring_limit=0,
                cse=(lambda entries: (program, entries)) if program else True,
            )
        return self._functions[name]

    def _evaluate(self, name: str, state: Mapping[str, ArrayLike], params: Parameters) -> Array:
        size = len(self.derivation.chain)
        arrays = [vector(name, value, size) for name, value in state.items()]
        arguments = [array[..., i] for array in arrays for i in range(size)] + self._values(params)
        leads = {name: array.shape[:-1] for name, array in zip(state, arrays, strict=True)}
        shape = broadcast_shapes(leads | {name: np.shape(value) for name, value in params.items()})
        with np.errstate(all="ignore"):
            entries = self._function(name, state)(*arguments)
        result = np.empty((*shape, len(entries)))
        for i, entry in enumerate(entries):
            result[..., i] = entry
        return check_overflow("an entry of the result", result)

    def _values(self, params: Parameters) -> list[Array]:
        names = [symbol.name for symbol in self.derivation.parameters]
        for name in instance("params", params, Mapping, f"a mapping with {', '.join(names)}"):
            one_of("parameter", name, names)
        if missing := [name for name in names if name not in params]:
            raise InvalidArgument(f"params lacks {', '.join(missing)}, expected {', '.join(names)}")
        return [finite(f"params[{name!r}]", params[name]) for name in names]


def _program(
    assignments: tuple[tuple[Symbol, Expr], ...], matrix: ImmutableMatrix
) -> list[tuple[Symbol, Expr]]:
    """Return the assignments on which `matrix` depends, in their order."""
    needed, program = set(matrix.free_symbols), []
    for symbol, value in reversed(assignments):
        if symbol in needed:
            needed |= value.free_symbols
            program.append((symbol, _round_constants(value)))
    return program[::-1]


def _round_constants(expression: Expr) -> Expr:
    """Return `expression` with constants such as sqrt(2) as floats."""
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


_A4_WIDTH = 62.0  # letters of a formula on a line of A4
_COMMAND = re.compile(r"\\[a-zA-Z]+|\\.")
_LETTERS = {"sin": 3.0, "cos": 3.0, "tan": 3.0, "left": 0.5, "right": 0.5, "dot": 0.0, "ddot": 0.0}


def _width(latex: str) -> float:
    """Return the approximate width of a formula in letters; a fraction is as wide as both of its parts."""
    letters, operators = _COMMAND.sub("", latex), len(re.findall(r" [-+=] ", latex))
    commands = sum(_LETTERS.get(each[1:], 1.0) for each in _COMMAND.findall(latex))
    return commands + 1.5 * operators + len(re.sub(r"[{}^_\s&]", "", letters))


def _lines(symbol: str, expression: Expr | ImmutableMatrix) -> list[str]:
    """Return an equation as lines of an environment align*, none wider than a page of A4."""
    formula = _latex(expression)
    if isinstance(expression, ImmutableMatrix):
        rows, columns = expression.shape
        entries = {(i, j): expression[i, j] for i in range(rows) for j in range(columns)}
        widths = [max(_width(_latex(entries[i, j])) + 2.0 for i in range(rows)) for j in range(columns)]
        if sum(widths) + _width(symbol) <= _A4_WIDTH:
            return [f"{symbol} &= {formula}"]
        equations = []
        for (i, j), entry in entries.items():
            index = f"{i + 1},{j + 1}" if columns > 1 else f"{i + 1}"
            equations += _lines(rf"\left[{symbol}\right]_{{{index}}}", entry) if entry != 0 else []
        return equations
    if _width(symbol) + _width(formula) <= _A4_WIDTH:
        return [f"{symbol} &= {formula}"]
    terms = expression.as_ordered_terms()
    terms = terms if len(terms) > 1 else sympy.expand(expression).as_ordered_terms()
    pieces = [_latex(each) for each in terms]
    pieces = [each if each.startswith("-") or k == 0 else f"+ {each}" for k, each in enumerate(pieces)]
    lines = [f"{symbol} &= {pieces[0]}"]
    for piece in pieces[1:]:
        if _width(f"{lines[-1]} {piece}") <= _A4_WIDTH:
            lines[-1] += f" {piece}"
        else:
            lines.append(rf"&\quad {piece}")
    return lines


def _text(expression: Expr | ImmutableMatrix) -> str:
    text = str(sympy.pretty(expression, wrap_line=False))
    if max(map(len, text.splitlines())) <= get_terminal_size().columns:
        return text
    # too wide for the terminal: line by line
    if not isinstance(expression, ImmutableMatrix):
        return str(expression)
    rows, columns = expression.shape
    indices = [
        f"{i}, {j}" if columns > 1 else str(i) for i in range(1, rows + 1) for j in range(1, columns + 1)
    ]
    lines = [f"  [{index}] = {entry}" for index, entry in zip(indices, expression, strict=True) if entry]
    return "\n".join([*lines, "  all others = 0"] if len(lines) < len(indices) else lines)


@dataclass(frozen=True)
class Step:
    r"""One step of a derivation; a notebook shows a formula, ``print`` shows text.

    Attributes
    ----------
    name : str
        Key in the derivation, such as ``"omega_3"``.
    title : str
        Heading.
    explanation : str
        One sentence on the origin of the expression.
    symbol : str
        LaTeX of the left-hand side.
    expression : sympy.Expr or sympy.ImmutableMatrix
        Right-hand side [SI units].

    See Also
    --------
    derivation.Derivation : steps and equations

    Examples
    --------
    >>> import sympy
    >>> from pinmobile.derivation import Step
    >>> m, v = sympy.symbols("m v")
    >>> step = Step("K", "Kinetic energy", "Half m v^2.", "K", m * v**2 / 2)
    >>> step.latex()
    'K = \\frac{m v^{2}}{2}'
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


class StepList:
    """Base class of derivations: steps that users look up by name or print in order."""

    steps: tuple[Step, ...]
    assignments: Assignments

    def __getitem__(self, name: str) -> Step:
        steps = {step.name: step for step in self.steps}
        return steps[one_of("step", name, steps)]

    def written_out(self, expression: Expr | ImmutableMatrix) -> Expr | ImmutableMatrix:
        """Return `expression` with every name of `assignments` replaced by its expression.

        The result can be very long.

        Parameters
        ----------
        expression : sympy.Expr or sympy.ImmutableMatrix
            Expression or matrix with such names.

        Raises
        ------
        InvalidArgument
            If `expression` has another type.
        """
        instance("expression", expression, Expr | ImmutableMatrix, "a sympy expression or matrix")
        values: dict[Symbol, Expr] = {}
        for symbol, value in self.assignments:
            values[symbol] = value.xreplace(values)
        return expression.xreplace(values)

    def latex(self) -> str:
        """Return all steps as one LaTeX environment, in which no line is wider than a page of A4."""
        lines = []
        for step in self.steps:
            lines += [rf"&\text{{{step.title}}}", *_lines(step.symbol, step.expression)]
        return "\\begin{align*}\n" + " \\\\\n".join(lines) + "\n\\end{align*}"

    def document(self) -> str:
        """Return all steps as a document that pdflatex compiles, on A4."""
        packages = "\\usepackage[a4paper,margin=2cm]{geometry}\n\\usepackage{amsmath}\n\\allowdisplaybreaks"
        begin = f"\\documentclass{{article}}\n{packages}\n\\begin{{document}}\n\\small\n"
        return f"{begin}{self.latex()}\n\\end{{document}}\n"

    def _repr_latex_(self) -> str:
        return self.latex()

    def __str__(self) -> str:
        return "\n\n".join(map(str, self.steps))


@dataclass(frozen=True)
class Derivation(StepList):
    """Equations of motion M(q) a + n(q, v) = inputs, and the steps of their derivation.

    ``derivation["M"]`` is the step with the name M. Up to three joints, every expression is simplified. For
    more joints, each entry of a result has a name, which later steps use: omega_2x is the first entry of the
    step omega_2. A superscript marks the same quantity in another motion: M1 for a unit acceleration of joint
    1 alone, n for zero acceleration.

    Attributes
    ----------
    chain : Chain
        Derived chain. The coordinates below have the order ``chain.order``, not that of the rows.
    steps : tuple of Step
        Steps in their order.
    inputs : sympy.ImmutableMatrix, shape (n, 1)
        Generalised forces as functions of (q, v, a) [N or N m].
    mass_matrix : sympy.ImmutableMatrix, shape (n, n)
        M(q) [kg, kg m or kg m^2].
    nonlinear_effects : sympy.ImmutableMatrix, shape (n, 1)
        n(q, v): centrifugal, Coriolis and gravitational terms [N or N m].
    assignments : tuple of (sympy.Symbol, sympy.Expr)
        Names of intermediate results, each in terms of earlier ones; empty for up to three joints.

    See Also
    --------
    derivation.derive : function that returns this object
    derivation.lecture : derivation of the lecture's robot

    Examples
    --------
    >>> from pinmobile.derivation import lecture
    >>> robot = lecture()
    >>> robot.nonlinear_effects[2], robot["M"].title
    (0, 'Mass matrix')
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
        """Symbols in links and gravity. Their names are the keys of ``params`` in the numeric functions."""
        return self.chain.parameters

    def numeric(self) -> Numeric:
        """Return M, n and the inputs as fast functions of arrays; the object caches compiled code.

        Returns
        -------
        Numeric
            Functions of arrays.
        """
        return Numeric(self)


_Matrices = tuple[ImmutableMatrix, ImmutableMatrix]


@dataclass(frozen=True)
class Wording:
    """Texts of one kind of step.

    In all texts, $k stands for the index, $j for the previous index, and $n for the last frame.

    Attributes
    ----------
    name, title, explanation, symbol : str
        Key, heading, one sentence, and LaTeX of the left-hand side.
    prismatic, revolute : str
        Text of $extra in the explanation, for a prismatic or revolute joint k.
    """

    name: str
    title: str
    explanation: str
    symbol: str
    prismatic: str = ""
    revolute: str = ""

    def fill(self, k: int, last: int, row: DHRow, **texts: str) -> tuple[str, str, str, str]:
        """Return name, title, explanation and symbol for index `k` with the table's `row`."""
        extra = self.revolute if row.joint is JointType.REVOLUTE else self.prismatic
        values = {"k": k, "j": k - 1, "n": last, "joint": row.joint.value, "variable": row.variable, **texts}
        templates = (self.name, self.title, self.explanation.replace("$extra", extra), self.symbol)
        name, title, explanation, symbol = (Template(text).substitute(values) for text in templates)
        return name, title, explanation, symbol


LOCAL = Wording(
    "T_${j}_$k",
    "Transform of joint $k",
    "RotX(alpha) TransX(a) RotZ(theta) TransZ(d) of row $k of the table: the pose of frame $k in frame $j.",
    r"{}^{$j}T_{$k}",
)
PLACEMENT = Wording(
    "T_0_$k", "Pose of frame $k in the base", "The product of the first $k transforms.", r"{}^{0}T_{$k}"
)
POSITION = Wording("p", "Position", "The origin of frame $n in the base: the last column of T_0_$n.", "p")
NORMAL = Wording("n", "Normal vector", "The x axis of frame $n in the base.", r"\hat{n}")
SLIDING = Wording("s", "Sliding vector", "The y axis of frame $n in the base.", r"\hat{s}")
APPROACH = Wording("a", "Approach vector", "The z axis of frame $n in the base.", r"\hat{a}")
OMEGA = Wording(
    "omega_$k",
    "Angular velocity of frame $k",
    "The angular velocity of frame $j, rotated into frame $k$extra.",
    r"{}^{$k}\omega_{$k}",
    revolute=", plus the rate about z_$k",
)
OMEGA_BASE = Wording(
    "omega_0_$n",
    "Angular velocity in the base",
    "The angular velocity of frame $n, rotated into the base.",
    r"{}^{0}\omega_{$n}",
)
VELOCITY = Wording(
    "v_$k",
    "Linear velocity of frame $k",
    "v + omega x P of frame $j, rotated into frame $k$extra.",
    r"{}^{$k}v_{$k}",
    prismatic=", plus the rate along z_$k",
)
VELOCITY_BASE = Wording(
    "v_0_$n",
    "Linear velocity in the base",
    "The velocity of the origin of frame $n, rotated into the base.",
    r"{}^{0}v_{$n}",
)
ALPHA = Wording(
    "alpha_$k",
    "Angular acceleration of frame $k",
    "The angular acceleration of frame $j, rotated into frame $k$extra.",
    r"{}^{$k}\alpha_{$k}",
    revolute=", plus the gyroscopic term (the rotated omega_$j) x z_$k times the rate, "
    "plus the acceleration about z_$k",
)
ALPHA_BASE = Wording(
    "alpha_0_$n",
    "Angular acceleration in the base",
    "The angular acceleration of frame $n, rotated into the base.",
    r"{}^{0}\alpha_{$n}",
)
ACCELERATION = Wording(
    "a_$k",
    "Linear acceleration of frame $k",
    "a + alpha x P + omega x (omega x P) of frame $j, rotated into frame $k$extra.",
    r"{}^{$k}a_{$k}",
    prismatic=", plus the Coriolis term 2 omega_$k x z_$k times the rate, plus the acceleration along z_$k",
)
ACCELERATION_BASE = Wording(
    "a_0_$n",
    "Linear acceleration in the base",
    "The acceleration of the origin of frame $n, rotated into the base; gravity adds an upward acceleration.",
    r"{}^{0}a_{$n}",
)
ACCELERATION_COM = Wording(
    "a_c$k",
    "Acceleration of the centre of mass of link $k",
    "a + alpha x P_c + omega x (omega x P_c), where P_c is the centre of mass in frame $k.",
    r"{}^{$k}a_{c_{$k}}",
)
INERTIAL_FORCE = Wording(
    "F_$k",
    "Inertial force of link $k",
    "Newton: mass times the acceleration of the centre of mass.",
    r"{}^{$k}F_{$k}",
)
INERTIAL_MOMENT = Wording(
    "N_$k",
    "Inertial moment of link $k",
    "Euler: I alpha + omega x (I omega), about the centre of mass.",
    r"{}^{$k}N_{$k}",
)
FORCE = Wording(
    "f_$k",
    "Force at joint $k",
    "The force of link $j on link $k: its inertial force, plus the force on the next link.",
    r"{}^{$k}f_{$k}",
)
SHAKING_FORCE = Wording("f_0", "Shaking force", "The force of the ground on the chain.", r"{}^{0}f_{0}")
MOMENT = Wording(
    "n_$k",
    "Moment at joint $k",
    "The moment of link $j on link $k: N + P_c x F, plus n + P x f of the next link.",
    r"{}^{$k}n_{$k}",
)
SHAKING_MOMENT = Wording(
    "n_0",
    "Shaking moment",
    "The moment of the ground on the chain, about the origin of the base.",
    r"{}^{0}n_{0}",
)
INPUT = Wording(
    "tau_$k",
    "Input of joint $k",
    "The joint of $variable is $joint: its input is $extra.",
    r"\tau_{$k}",
    prismatic="the component of f_$k along z_$k",
    revolute="the component of n_$k about z_$k",
)
MASS_MATRIX = Wording(
    "M",
    "Mass matrix",
    "The coefficients of the accelerations of ($order) in the inputs ($inputs).",
    "M(q)",
)
NONLINEAR_EFFECTS = Wording(
    "n_v", "Nonlinear effects", "The inputs ($inputs) for zero acceleration.", r"n(q, \dot{q})"
)
POSITION_COM = Wording(
    "p_c$k",
    "Centre of mass of link $k",
    "T_0_$k applied to the centre of mass in frame $k.",
    r"{}^{0}p_{c_{$k}}",
)
VELOCITY_COM = Wording(
    "v_c$k",
    "Velocity of the centre of mass of link $k",
    "The derivative of its position with respect to time.",
    r"{}^{0}v_{c_{$k}}",
)
OMEGA_SKEW = Wording(
    "omega_0_$k",
    "Angular velocity of link $k",
    "From the skew matrix: the derivative of R_0_$k with respect to time, times the transpose of R_0_$k.",
    r"{}^{0}\omega_{$k}",
)
VELOCITY_OWN = Wording(
    "v_own$k",
    "Velocity of the centre of mass of link $k in its own axes",
    "The velocity, rotated into frame $k.",
    r"{}^{$k}v_{c_{$k}}",
)
OMEGA_OWN = Wording(
    "omega_own$k",
    "Angular velocity of link $k in its own axes",
    "The angular velocity, rotated into frame $k.",
    r"{}^{$k}\omega_{$k}",
)
KINETIC = Wording("K", "Kinetic energy", "The sum over all links of m v . v / 2 + omega . I omega / 2.", "K")
POTENTIAL = Wording("V", "Potential energy", "The sum over all links of -m g . p_c.", "V")
MOMENTUM = Wording(
    "P_$k",
    "Generalised momentum of $variable",
    "The derivative of L = K - V with respect to the rate of $variable.",
    r"\frac{\partial L}{\partial \dot{q}_{$k}}",
)
LAGRANGE = Wording(
    "tau_$k",
    "Input of joint $k",
    "Lagrange: the derivative of P_$k with respect to time, minus the derivative of L by $variable.",
    r"\tau_{$k}",
)


class _Simplifier:
    """Treatment that simplifies each result; the reader sees terms grouped by motion, then by mass."""

    meanings: Mapping[Symbol, Expr] = MappingProxyType({})

    def __init__(self, chain: Chain) -> None:
        self._levels = (chain.v + chain.a, chain.masses)

    def apply(self, name: str, result: ImmutableMatrix) -> _Matrices:
        """Return `result` expanded, and with common factors before brackets."""
        terms = result.applyfunc(reduce_terms)
        return terms, terms.applyfunc(lambda entry: group_terms(entry, self._levels))


class Namer:
    """Treatment that names every entry of a result except symbols, for use in later steps.

    The size of the expressions then grows linearly with the number of joints. Without names, it grows
    exponentially.

    Attributes
    ----------
    meanings : dict of sympy.Symbol to sympy.Expr
        Names with their expressions, each in terms of earlier ones.
    """

    def __init__(self, chain: Chain) -> None:
        self.meanings: dict[Symbol, Expr] = {}
        self._names = {symbol.name for symbol in (*chain.q, *chain.v, *chain.a, *chain.parameters)}
        self._symbols: dict[Expr, Expr] = {}

    def apply(self, name: str, result: ImmutableMatrix) -> _Matrices:
        """Return names for the entries of `result`, and `result`."""
        rows, columns = result.shape
        if columns == 1:
            suffixes = {1: [""], 3: list("xyz")}.get(rows, [f"_{i}" for i in range(1, rows + 1)])
        else:
            suffixes = [f"_{i}{j}" for i in range(1, rows + 1) for j in range(1, columns + 1)]
        entries = [self._name(name + suffix, entry) for suffix, entry in zip(suffixes, result, strict=True)]
        return ImmutableMatrix(rows, columns, entries), result

    def _name(self, name: str, entry: Expr) -> Expr:
        if entry.is_Atom or (-entry).is_Atom:
            return entry
        if entry not in self._symbols:
            while name in self._names:
                name += "_"
            self._names.add(name)
            self.meanings[Symbol(name)] = entry
            self._symbols |= {entry: Symbol(name), -entry: -Symbol(name)}
        return self._symbols[entry]


SIMPLIFIED_JOINTS = 3
"""Largest number of joints for simplified results; beyond, results use named intermediate results."""


class Record:
    """Recorder of the steps of a derivation.

    Parameters
    ----------
    chain : Chain
        Derived chain.

    Attributes
    ----------
    steps : list of Step
        Recorded steps.
    treatment : Treatment
        Treatment of each result.
    """

    def __init__(self, chain: Chain) -> None:
        self.chain, self._tag = chain, ""
        self.steps: list[Step] = []
        simplifies = len(chain) <= SIMPLIFIED_JOINTS
        self.treatment: _Simplifier | Namer = _Simplifier(chain) if simplifies else Namer(chain)

    def branch(self, tag: str) -> Record:
        """Return an empty record with the same names, for results that are not steps of this derivation.

        New names contain `tag`, since this record has the same quantities.
        """
        other = Record(self.chain)
        other.treatment, other._tag = self.treatment, tag
        return other

    def matrix(self, wording: Wording, result: ImmutableMatrix, k: int = 0, **texts: str) -> ImmutableMatrix:
        """Record the step of `wording` for index `k`, and return the form of `result` for later steps."""
        row = self.chain.table.rows[max(k - 1, 0)]
        name, title, explanation, symbol = wording.fill(k, len(self.chain), row, **texts)
        form, text = self.treatment.apply(self._add_tag(name), ImmutableMatrix(result))
        self.steps.append(Step(name, title, explanation, symbol, text))
        return form

    def scalar(self, wording: Wording, result: Expr, k: int = 0, **texts: str) -> Expr:
        """Record a step with a single expression as its result; see `matrix`."""
        form = self.matrix(wording, ImmutableMatrix([[result]]), k, **texts)
        self.steps[-1] = replace(self.steps[-1], expression=self.steps[-1].expression[0])
        return form[0]

    def short(self, name: str, result: Expr) -> Expr:
        """Return the form of `result` for later steps, without recording a step."""
        return self.treatment.apply(self._add_tag(name), ImmutableMatrix([[result]]))[0][0]

    def derivation(self, M: Sequence[Sequence[Expr]], n: Sequence[Expr]) -> Derivation:
        """Record M and n, given in the order of the rows, and return the derivation."""
        chain = self.chain
        names = [f"tau_{chain.table.variables.index(name) + 1}" for name in chain.order]
        texts = {"order": ", ".join(chain.order), "inputs": ", ".join(names)}
        self.matrix(MASS_MATRIX, ImmutableMatrix(chain.ordered([*map(chain.ordered, M)])), 0, **texts)
        self.matrix(NONLINEAR_EFFECTS, ImmutableMatrix(chain.ordered(n)), 0, **texts)
        steps = {step.name: step.expression for step in self.steps}
        inputs = ImmutableMatrix([steps[name] for name in names])
        meanings = tuple(self.treatment.meanings.items())
        return Derivation(chain, tuple(self.steps), inputs, steps["M"], steps["n_v"], meanings)

    def _add_tag(self, name: str) -> str:
        # in names of sympy, __ begins a superscript and _ a subscript
        return name.replace("_", f"__{self._tag}_", 1) if self._tag else name
