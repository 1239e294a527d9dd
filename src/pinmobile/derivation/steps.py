"""A derivation and its steps: what is looked up, read, typeset and turned into numbers."""

import re
from dataclasses import dataclass, field
from shutil import get_terminal_size

import sympy
from sympy import Expr, ImmutableMatrix, Symbol

from pinmobile.derivation.chain import Chain
from pinmobile.derivation.numeric import Numeric
from pinmobile.errors import InvalidArgument, UnknownName, shown

__all__ = ["Assignments", "Derivation", "Step"]

Assignments = tuple[tuple[Symbol, Expr], ...]


def _latex(expression: Expr | ImmutableMatrix) -> str:
    names = {}
    for symbol in expression.free_symbols:
        if parts := re.fullmatch(r"(I)([cxyz]+\d*)|([xyz])(b?c\d*)", symbol.name):
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
    return "\n".join(f"  [{place}] = {entry}" for place, entry in zip(places, expression, strict=True))


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


@dataclass(frozen=True)
class Derivation:
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

    def __getitem__(self, name: str) -> Step:
        for step in self.steps:
            if step.name == name:
                return step
        raise UnknownName("step", name, [step.name for step in self.steps])

    def written_out(self, expression: Expr | ImmutableMatrix) -> Expr | ImmutableMatrix:
        """Return `expression` with every name of `assignments` replaced by what it stands for.

        Beyond three joints the result can be very long.

        Raises
        ------
        InvalidArgument
            If `expression` is something else.
        """
        if not isinstance(expression, Expr | ImmutableMatrix):
            raise InvalidArgument(f"expression is {shown(expression)}, expected a sympy expression or matrix")
        full: dict[Symbol, Expr] = {}
        for symbol, value in self.assignments:
            full[symbol] = value.xreplace(full)
        return expression.xreplace(full)

    def numeric(self) -> Numeric:
        """Return M, n and the inputs as fast functions of arrays; keep it, as it keeps what it compiles."""
        return Numeric(self)

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
