"""The algebra of polynomials in sines and cosines: a normal form, a short form and a readable one."""

from collections import defaultdict
from collections.abc import Sequence

import sympy
from sympy import Expr, Symbol
from sympy.polys.rings import PolyElement
from sympy.simplify.fu import TR10i

__all__ = ["grouped", "normal", "reduced"]

_READABLE = 8  # terms in a bracket; in a longer one nobody sees cos(q1 + q2), and the search takes seconds


def normal(expression: Expr) -> Expr:
    """Return the normal form, in which no cosine has a power above the first; that of zero is 0.

    Parameters
    ----------
    expression : sympy.Expr
        A polynomial in the sines and cosines of angles, and in anything else.
    """
    polynomial, pairs = _polynomial(sympy.expand_trig(expression))
    for cosine, sine in pairs:
        polynomial = _traded(polynomial, cosine, sine)
    return polynomial.as_expr()


def reduced(expression: Expr) -> Expr:
    """Return the expanded expression, with cos^2 + sin^2 = 1 used wherever that leaves fewer terms.

    Parameters
    ----------
    expression : sympy.Expr
        A polynomial in the sines and cosines of angles, and in anything else.
    """
    shortest, pairs = _polynomial(expression)
    for cosine, sine in pairs:
        candidates = [shortest, _traded(shortest, cosine, sine), _traded(shortest, sine, cosine)]
        shortest = min(candidates, key=len)
    return shortest.as_expr()


def grouped(expression: Expr, levels: Sequence[Sequence[Symbol]]) -> Expr:
    """Return an expanded expression as it is written by hand: grouped by the symbols of each level.

    Parameters
    ----------
    expression : sympy.Expr
        A sum of products.
    levels : sequence of sequences of sympy.Symbol
        Terms with the same powers of the symbols of the first level go into one bracket; inside it the
        second level does the same, and so on.
    """
    if not levels:
        few = 1 < _length(expression) <= _READABLE
        return sympy.factor_terms(TR10i(expression) if few else expression)
    brackets: dict[Expr, list[Expr]] = defaultdict(list)
    for term in sympy.Add.make_args(expression):
        rest, common = term.as_independent(*levels[0], as_Add=False)
        brackets[common].append(rest)
    return sympy.Add(
        *(_times(common, grouped(sympy.Add(*rest), levels[1:])) for common, rest in brackets.items())
    )


def _times(common: Expr, bracket: Expr) -> Expr:
    """Return the product, with the sign of the first term in the bracket before the bracket."""
    if common == 1:
        return bracket
    content, rest = bracket.as_coeff_Mul()
    factors = list(sympy.Mul.make_args(rest))
    for i, factor in enumerate(factors):
        if factor.is_Add and factor.as_ordered_terms()[0].could_extract_minus_sign():
            factors[i], content = -factor, -content
    return sympy.Mul(content, common, *factors)


def _polynomial(expression: Expr) -> tuple[PolyElement, list[tuple[int, int]]]:
    """Return `expression` as a polynomial, and the places of its cosines and sines among the generators.

    Sums and products of polynomials are some twenty times faster than those of expressions.
    """
    generators, pairs = list(_generators(expression)), []
    angles = {g.args[0] for g in generators if isinstance(g, sympy.cos | sympy.sin)}
    for angle in sorted(angles, key=sympy.default_sort_key):
        pair = sympy.cos(angle), sympy.sin(angle)
        generators += [function for function in pair if function not in generators]
        pairs.append((generators.index(pair[0]), generators.index(pair[1])))
    return sympy.polys.rings.PolyRing(generators, sympy.QQ).from_expr(expression), pairs


def _generators(expression: Expr) -> dict[Expr, None]:
    found: dict[Expr, None] = {}
    stack = [expression]
    while stack:
        e = stack.pop()
        if e.is_Rational:
            continue
        if e.is_Add or e.is_Mul:
            stack.extend(e.args)
        elif e.is_Pow and e.exp.is_Integer and e.exp > 1:
            stack.append(e.base)
        else:
            found[e] = None
    return found


def _traded(polynomial: PolyElement, out: int, into: int) -> PolyElement:
    """Return `polynomial` with every square of generator `out` replaced by 1 minus that of `into`."""
    by_power = defaultdict(dict)
    for powers, coefficient in polynomial.items():
        half, rest = divmod(powers[out], 2)
        by_power[half][(*powers[:out], rest, *powers[out + 1 :])] = coefficient
    if set(by_power) <= {0}:
        return polynomial
    ring = polynomial.ring
    square = 1 - ring.gens[into] ** 2
    result = ring.zero
    for half, terms in by_power.items():
        result += ring.from_dict(terms) * square**half
    return result


def _length(expression: Expr) -> int:
    return len(sympy.Add.make_args(expression)) if expression else 0
