"""`Link`, `Chain`, and simplification of their exact expressions in sines and cosines."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import gcd, isclose, pi
from typing import Any

import numpy as np
import sympy
from sympy import Expr, ImmutableMatrix, Symbol
from sympy.polys.rings import PolyElement, PolyRing
from sympy.simplify.fu import TR10i

from pinmobile.arrays import Array, check_integer, distinct, sequence
from pinmobile.dh import DHTable, table_of
from pinmobile.errors import InvalidArgument, unexpected_value


def exact_value(name: str, value: object) -> Expr:
    """Return `value` as an expression without floating-point numbers.

    A float becomes the fraction of its shortest decimal form (0.3 becomes 3/10), which evaluates to the same
    float. Floats in expressions would prevent equal expressions from cancelling.

    Parameters
    ----------
    name : str
        Name of the argument in messages.
    value : float or sympy.Expr
        Value of the argument, in any unit.

    Raises
    ------
    InvalidArgument
        If the value is neither a finite real number nor an expression.
    """
    try:
        expression = sympy.sympify(value, strict=True)
    except Exception:  # conversion of a foreign value may raise any error
        expression = None
    if not isinstance(expression, Expr) or expression.has(sympy.nan, sympy.zoo, sympy.oo, sympy.I):
        raise unexpected_value(name, value, "a finite real number or a sympy expression")
    floats = expression.atoms(sympy.Float)
    return expression.xreplace({number: sympy.Rational(repr(float(number))) for number in floats})


def exact_matrix(name: str, value: Any, shape: tuple[int, int]) -> ImmutableMatrix:
    """Return `value` as a matrix of expressions without floating-point numbers.

    Parameters
    ----------
    name : str
        Name of the argument in messages.
    value : nested sequence, array or sympy.Matrix
        Entries, in any unit; a flat sequence is a column.
    shape : (int, int)
        Expected shape.

    Raises
    ------
    InvalidArgument
        If the value has another shape, or an entry is neither a finite real number nor an expression.
    """
    rows = value.tolist() if isinstance(value, sympy.MatrixBase | np.ndarray) else value
    is_flat = shape[1] == 1 and isinstance(rows, list | tuple) and not any(map(_is_row, rows))
    rows = [[row] for row in rows] if is_flat else rows
    fits = isinstance(rows, list | tuple) and len(rows) == shape[0]
    if isinstance(value, np.ma.MaskedArray) or not fits or not all(map(_is_row, rows)):
        rows = ((),)
    if any(len(row) != shape[1] for row in rows):
        expected = f"{shape[0]} entries" if shape[1] == 1 else f"shape {shape}"
        raise unexpected_value(name, value, expected)
    return ImmutableMatrix(*shape, [exact_value(name, entry) for row in rows for entry in row])


def _is_row(value: object) -> bool:
    return isinstance(value, list | tuple)


def exact_angle(name: str, value: float) -> Expr:
    """Return a multiple of pi/12 [rad] exactly, and any other angle like `exact_value`.

    Sines and cosines of these multiples are sums of square roots, which sympy cancels.

    Parameters
    ----------
    name : str
        Name of the argument in messages.
    value : float
        Angle [rad].

    Raises
    ------
    InvalidArgument
        If the value is not a finite real number.
    """
    twelfths = round(value * 12 / pi)
    if isclose(value, twelfths * pi / 12, rel_tol=1e-14, abs_tol=1e-15):
        return sympy.Rational(twelfths, 12) * sympy.pi
    return exact_value(name, value)


_MAX_TERMS = 8  # largest number of terms in a search for cos(q1 + q2), which takes seconds for more

_Powers = tuple[int, ...]


def normal_form(expression: Expr) -> Expr:
    """Return the normal form, without powers of cosines above the first; the normal form of zero is 0.

    Parameters
    ----------
    expression : sympy.Expr
        Polynomial in the sines and cosines of angles and in other symbols.
    """
    polynomial, pairs = _polynomial(sympy.expand_trig(expression))
    for cosine, sine in pairs:
        polynomial = _swap_square(polynomial, cosine, sine)
    return polynomial.as_expr()


def reduce_terms(expression: Expr) -> Expr:
    """Return the expanded expression, with cos^2 + sin^2 = 1 applied if this leaves fewer terms.

    Parameters
    ----------
    expression : sympy.Expr
        Polynomial in the sines and cosines of angles and in other symbols.
    """
    shortest, pairs = _polynomial(expression)
    for cosine, sine in pairs:
        candidates = [shortest, _swap_square(shortest, cosine, sine), _swap_square(shortest, sine, cosine)]
        shortest = min(candidates, key=len)
    return shortest.as_expr()


def group_terms(expression: Expr, levels: Sequence[Sequence[Symbol]]) -> Expr:
    """Return an expression with brackets, as a person writes: terms grouped by the symbols of each level.

    Parameters
    ----------
    expression : sympy.Expr
        Polynomial.
    levels : sequence of sequences of sympy.Symbol
        Symbols that define the brackets. Terms with the same powers of the symbols of the first level share a
        bracket. The second level groups the terms in each bracket, and so on.
    """
    polynomial, _ = _polynomial(expression)
    indices = {generator: i for i, generator in enumerate(polynomial.ring.symbols)}
    return _add_brackets(
        polynomial, [{indices[symbol] for symbol in level if symbol in indices} for level in levels]
    )


def _add_brackets(polynomial: PolyElement, levels: Sequence[set[int]]) -> Expr:
    if not levels:
        return _factor_out(polynomial)
    brackets: dict[_Powers, dict[_Powers, Any]] = defaultdict(dict)
    for powers, coefficient in polynomial.items():
        common = tuple(power if i in levels[0] else 0 for i, power in enumerate(powers))
        brackets[common][tuple(p - c for p, c in zip(powers, common, strict=True))] = coefficient
    ring, products = polynomial.ring, []
    for common, terms in brackets.items():
        factor = ring.term_new(common, ring.domain.one)
        products.append(_multiply(factor.as_expr(), _add_brackets(ring.from_dict(terms), levels[1:])))
    return sympy.Add(*products)


def _factor_out(polynomial: PolyElement) -> Expr:
    """Return `polynomial` with the common factors of all terms before a bracket."""
    if 1 < len(polynomial) <= _MAX_TERMS:
        polynomial, _ = _polynomial(TR10i(polynomial.as_expr()))
    if len(polynomial) < 2:
        return polynomial.as_expr()
    ring = polynomial.ring
    powers = tuple(map(min, zip(*polynomial, strict=True)))
    num, den = zip(*((int(c.numerator), int(c.denominator)) for c in polynomial.values()), strict=True)
    factor = ring.term_new(powers, ring.domain(gcd(*num), gcd(*den)))
    return _multiply(factor.as_expr(), polynomial.exquo(factor).as_expr())


def _multiply(factor: Expr, bracket: Expr) -> Expr:
    """Return the product, with the sign of the bracket's first term moved before the bracket."""
    if factor == 1:
        return bracket
    content, product = bracket.as_coeff_Mul()
    factors = list(sympy.Mul.make_args(product))
    for i, part in enumerate(factors):
        is_short = part.is_Add and len(part.args) <= _MAX_TERMS
        if is_short and part.as_ordered_terms()[0].could_extract_minus_sign():
            factors[i], content = -part, -content
    content *= factor
    # sympy would multiply a number into a sum
    is_sum = content.is_Number and len(factors) == 1 and factors[0].is_Add
    return sympy.Mul(content, *factors, evaluate=not is_sum)


def _polynomial(expression: Expr) -> tuple[PolyElement, list[tuple[int, int]]]:
    """Return `expression` as a polynomial, and the indices of its pairs of cosine and sine generators.

    Adding and multiplying polynomials is about ten times faster than expanding expressions.
    """
    generators, pairs = _generators(expression), []
    angles = {function.args[0] for function in generators if isinstance(function, sympy.cos | sympy.sin)}
    for angle in sorted(angles, key=sympy.default_sort_key):
        pair = sympy.cos(angle), sympy.sin(angle)
        generators += [function for function in pair if function not in generators]
        pairs.append((generators.index(pair[0]), generators.index(pair[1])))
    return PolyRing(generators, sympy.QQ).from_expr(expression), pairs


def _generators(expression: Expr) -> list[Expr]:
    """Return the generators of `expression` as a polynomial with rational coefficients."""
    generators, parts = set[Expr](), [expression]
    while parts:
        part = parts.pop()
        if part.is_Add or part.is_Mul:
            parts += part.args
        elif part.is_Pow and part.exp.is_Integer and part.exp > 0:
            parts.append(part.base)
        elif not part.is_Rational:
            generators.add(part)
    return sorted(generators, key=sympy.default_sort_key)


def _swap_square(polynomial: PolyElement, old: int, new: int) -> PolyElement:
    """Return `polynomial` with each square of generator `old` replaced by 1 minus the square of `new`."""
    squares: dict[int, dict[_Powers, Any]] = defaultdict(dict)
    for powers, coefficient in polynomial.items():
        count, remainder = divmod(powers[old], 2)
        squares[count][(*powers[:old], remainder, *powers[old + 1 :])] = coefficient
    ring, result = polynomial.ring, polynomial.ring.from_dict(squares.pop(0, {}))
    for count, terms in squares.items():
        result += ring.from_dict(terms) * (1 - ring.gens[new] ** 2) ** count
    return result


@dataclass(frozen=True)
class Link:
    """Mass distribution of one link, in symbols or numbers.

    Parameters
    ----------
    mass : sympy.Expr or float
        Mass [kg].
    com : sequence of 3 sympy.Expr or float
        Centre of mass in the frame of the link [m].
    inertia : 3 x 3 sympy.Expr or float
        Inertia about the centre of mass, along the axes of the link [kg m^2]. The matrix must be symmetric.

    Raises
    ------
    InvalidArgument
        If a shape is wrong, an entry is neither a finite number nor an expression, or `inertia` is not
        symmetric.

    See Also
    --------
    derivation.Chain : joints with links
    derivation.derive : equations of motion of a chain

    Examples
    --------
    >>> import sympy
    >>> from pinmobile.derivation import Link
    >>> m, l = sympy.symbols("m l")
    >>> rod = Link(m, (l / 2, 0, 0), sympy.diag(0, 1, 1) * m * l**2 / 12)
    >>> rod.inertia[2, 2]
    l**2*m/12
    """

    mass: Expr
    com: ImmutableMatrix
    inertia: ImmutableMatrix

    def __post_init__(self) -> None:
        object.__setattr__(self, "mass", exact_value("mass", self.mass))
        object.__setattr__(self, "com", exact_matrix("com", self.com, (3, 1)))
        object.__setattr__(self, "inertia", exact_matrix("inertia", self.inertia, (3, 3)))
        if self.inertia != self.inertia.T:
            raise InvalidArgument(f"inertia is {self.inertia.tolist()}, expected a symmetric matrix")

    @classmethod
    def general(cls, k: int) -> Link:
        """Return link `k` with a symbol for each quantity: m1, xc1, yc1, zc1, Ixx1, Ixy1, ... for k = 1.

        Parameters
        ----------
        k : int
            Index of the link, >= 0.
        """
        k = check_integer("k", k, least=0)
        inertia = [[Symbol(f"I{min(i, j)}{max(i, j)}{k}") for j in "xyz"] for i in "xyz"]
        return cls(Symbol(f"m{k}"), [Symbol(f"{axis}c{k}") for axis in "xyz"], inertia)

    @cached_property
    def parameters(self) -> tuple[Symbol, ...]:
        """Symbols in mass, centre of mass and inertia, in this order."""
        return _symbols([self.mass, *self.com, *self.inertia])


@dataclass(frozen=True)
class Chain:
    """Modified-DH table with links, an order of coordinates, and gravity.

    `q`, `v` and `a` have the order of the rows. `order` is the order in inputs, M and n.

    Parameters
    ----------
    table : DHTable or sequence of rows
        DH table of the joints.
    links : sequence of Link or None, one per row, optional
        Link after each joint; None is a virtual link without mass. By default, `Link.general` for all.
    order : sequence of str, optional
        Permutation of the table's variables; by default, the order of the rows.
    gravity : sequence of 3 sympy.Expr or float, optional
        Acceleration of free fall in frame 0 [m/s^2]; by default, zero, since the ground is level.

    Raises
    ------
    InvalidArgument
        If a length or type is wrong, or two symbols would have the same name.
    UnknownName
        If `order` has a name that is not a variable of the table.

    See Also
    --------
    derivation.derive : equations of motion of a chain
    dh.DHTable : table of the joints

    Examples
    --------
    >>> from pinmobile.derivation import Chain
    >>> from pinmobile.dh import LECTURE_TABLE
    >>> chain = Chain(LECTURE_TABLE, order=("x", "y", "psi"))
    >>> chain.v, chain.ordered(chain.v)
    ((ydot, xdot, psidot), (xdot, ydot, psidot))
    """

    table: DHTable
    links: tuple[Link | None, ...]
    order: tuple[str, ...]
    gravity: ImmutableMatrix

    def __init__(
        self,
        table: DHTable | Sequence[Any],
        links: Sequence[Link | None] | None = None,
        order: Sequence[str] | None = None,
        gravity: Sequence[Expr | float] | Array = (0, 0, 0),
    ) -> None:
        table = table_of(table)
        if links is None:
            links = [Link.general(k) for k in range(1, len(table) + 1)]
        order = table.variables if order is None else order
        object.__setattr__(self, "table", table)
        object.__setattr__(self, "links", sequence("links", links, "a sequence of Link or None"))
        object.__setattr__(self, "order", sequence("order", order, "a sequence of names"))
        object.__setattr__(self, "gravity", exact_matrix("gravity", gravity, (3, 1)))
        self._check()

    def _check(self) -> None:
        variables = self.table.variables
        if len(self.links) != len(self) or not all(isinstance(link, Link | None) for link in self.links):
            raise unexpected_value("links", self.links, f"{len(self)} of Link or None")
        if len(self.order) != len(variables) or set(variables) != {*map(str, self.order)}:
            raise unexpected_value("order", self.order, f"a permutation of {variables}")
        symbols = (*self.q, *self.v, *self.a, *self.parameters)
        distinct("links and table have the name", (symbol.name for symbol in symbols))

    def __len__(self) -> int:
        return len(self.table)

    @cached_property
    def q(self) -> tuple[Symbol, ...]:
        """Joint variables, in the order of the rows [m or rad]."""
        return tuple(Symbol(name) for name in self.table.variables)

    @cached_property
    def v(self) -> tuple[Symbol, ...]:
        """Rates of the joint variables [m/s or rad/s], named psidot, qdot1, ..."""
        return self._rate_symbols("dot")

    @cached_property
    def a(self) -> tuple[Symbol, ...]:
        """Accelerations of the joint variables [m/s^2 or rad/s^2], named psiddot, qddot1, ..."""
        return self._rate_symbols("ddot")

    @cached_property
    def parameters(self) -> tuple[Symbol, ...]:
        """Symbols in links and gravity, from the ground outwards."""
        symbols = [symbol for link in self.links if link for symbol in link.parameters]
        return tuple(dict.fromkeys([*symbols, *_symbols(self.gravity)]))

    @cached_property
    def masses(self) -> tuple[Symbol, ...]:
        """Symbols in the masses of the links."""
        return _symbols([link.mass for link in self.links if link])

    def ordered(self, per_row: Sequence[Any]) -> tuple[Any, ...]:
        """Return values that are listed in the order of the rows, in `order`.

        Parameters
        ----------
        per_row : sequence
            One value per row.

        Raises
        ------
        InvalidArgument
            If the argument is not a sequence with one value per row.
        """
        per_row = sequence("per_row", per_row, f"a sequence of {len(self)}")
        if len(per_row) != len(self):
            raise InvalidArgument(f"per_row has {len(per_row)} entries, expected {len(self)}")
        return tuple(per_row[self.table.variables.index(name)] for name in self.order)

    def _rate_symbols(self, dots: str) -> tuple[Symbol, ...]:
        # sympy typesets xdot, qdot1 and qdot_a with a dot above the letter, but not q1dot
        return tuple(Symbol(re.sub(r"^[^\W\d_]*", rf"\g<0>{dots}", name)) for name in self.table.variables)


def _symbols(expressions: Sequence[Expr]) -> tuple[Symbol, ...]:
    lists = (sorted(expression.free_symbols, key=str) for expression in expressions)
    return tuple(dict.fromkeys(symbol for symbols in lists for symbol in symbols))
