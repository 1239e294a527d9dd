"""Operations of a tape: their NumPy functions, their types, and rules that simplify them."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np

UNIFORM, ROBOT, SAMPLE, STATE, ROUND = 1, 2, 4, 8, 16
"""Dependence of a node as bits: number of the run, of a robot, of a sample, of the state, of a round.

Nested rounds have twice the bit of the outer rounds.
"""


# Each operation on NumPy's numbers and arrays; `max` and `min` return the second argument if one is NaN.
NUMPY: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "div": np.divide,
    "neg": operator.neg,
    "abs": np.abs,
    "sqrt": np.sqrt,
    "max": lambda a, b: np.where(a > b, a, b),
    "min": lambda a, b: np.where(a < b, a, b),
    "gt": operator.gt,
    "ge": operator.ge,
    "lt": operator.lt,
    "le": operator.le,
    "eq": operator.eq,
    "ne": operator.ne,
    "and": operator.and_,
    "or": operator.or_,
    "xor": operator.xor,
    "not": np.logical_not,
    "select": np.where,
    "iadd": operator.add,
    "imul": operator.mul,
    "ixor": operator.xor,
    "iand": operator.and_,
    "ior": operator.or_,
    "shl": operator.lshift,
    "shr": operator.rshift,
    "bits": lambda x: np.asarray(x, np.float64).view(np.uint64),
    "real": lambda x: np.asarray(x, np.uint64).view(np.float64),
}


COMMUTE = frozenset(("add", "mul", "and", "or", "xor", "iadd", "imul", "ixor", "iand", "ior", "eq", "ne"))


_TRUTHS = frozenset(("gt", "ge", "lt", "le", "eq", "ne", "and", "or", "xor", "not"))


_WORDS = frozenset(("iadd", "imul", "ixor", "iand", "ior", "shl", "shr", "bits"))


WORD_NAMES = {"add": "iadd", "mul": "imul", "xor": "ixor", "and": "iand", "or": "ior"}


DTYPES = {"f": np.float64, "u": np.uint64, "b": np.bool_}


def kind_of(x: object) -> str:
    """Return the type of a plain number."""
    return "b" if isinstance(x, bool | np.bool_) else "f"


def result_kind(name: str, kinds: Sequence[str]) -> str:
    """Return the type of the result of an operation."""
    if name in _TRUTHS:
        return "b"
    if name in _WORDS:
        return "u"
    return kinds[1] if name == "select" else "f"


def operand_kinds(name: str, kinds: Sequence[str]) -> tuple[str, ...]:
    """Return the types of the operands of an operation."""
    if name in ("and", "or", "xor", "not"):
        return ("b",) * len(kinds)
    if name == "select":
        kind = kinds[1] if kinds[1] == kinds[2] else "u" if "u" in kinds[1:] else "f"
        return "b", kind, kind
    return (("u",) if (name in _WORDS and name != "bits") or name == "real" else ("f",)) * len(kinds)


_Constant: TypeAlias = float | None  # the value of a constant
_N: TypeAlias = Any  # a node of a tape
_Tape: TypeAlias = Any  # a tape; the rules use its `operations`, `depends`, `at`, `const` and `apply`


def _negand(tape: _Tape, x: _N) -> _N | None:
    operation = tape.operations[x.index]
    return tape.at(operation[1]) if operation[0] == "neg" else None


def _sum(tape: _Tape, a: _N, b: _N, va: _Constant, vb: _Constant) -> _N | None:
    if va == 0:
        return b
    if vb == 0:
        return a
    minus = _negand(tape, b)
    if minus is not None:
        return tape.apply("sub", a, minus)
    minus = _negand(tape, a)
    return None if minus is None else tape.apply("sub", b, minus)


def _difference(tape: _Tape, a: _N, b: _N, va: _Constant, vb: _Constant) -> _N | None:
    if vb == 0:
        return a
    if va == 0:
        return tape.apply("neg", b)
    minus = _negand(tape, b)
    return None if minus is None else tape.apply("add", a, minus)


def _product(tape: _Tape, a: _N, b: _N, va: _Constant, vb: _Constant) -> _N | None:
    for value, other in ((va, b), (vb, a)):
        if value == 0:
            return tape.const(0.0)
        if value is not None and abs(value) == 1:
            return other if value == 1 else tape.apply("neg", other)
    ma, mb = _negand(tape, a), _negand(tape, b)
    if ma is None and mb is None:
        return None
    product = tape.apply("mul", a if ma is None else ma, b if mb is None else mb)
    return product if ma is not None and mb is not None else tape.apply("neg", product)


def _quotient(tape: _Tape, a: _N, b: _N, va: _Constant, vb: _Constant) -> _N | None:
    if va == 0:
        return tape.const(0.0)
    if vb is not None:
        # A subnormal reciprocal would lose bits.
        fits = vb != 0 and 2.0**-1021 <= abs(vb) <= 2.0**1021
        return tape.apply("mul", a, 1.0 / vb) if fits else None
    varying = SAMPLE | STATE
    is_constant = not tape.depends[b.index] & varying and tape.depends[a.index] & varying
    return tape.apply("mul", a, tape.apply("div", 1.0, b)) if is_constant else None


def _logic_rule(decides: bool) -> Callable[..., Any]:
    """Return the rule of `and`, of which False decides the result, or of `or`, of which True does."""

    def rule(tape: _Tape, a: _N, b: _N, va: _Constant, vb: _Constant) -> _N | None:
        if va is not None or vb is not None:
            value, other = (va, b) if va is not None else (vb, a)
            return tape.const(decides, "b") if value == decides else other
        return a if a.index == b.index else None

    return rule


def _choice(tape: _Tape, c: _N, a: _N, b: _N, vc: _Constant, _: _Constant, __: _Constant) -> _N | None:
    if vc is not None:
        return a if vc else b
    return a if a.index == b.index else None


def _inverse_rule(name: str) -> Callable[..., Any]:
    def rule(tape: _Tape, x: _N, _: _Constant) -> _N | None:
        operation = tape.operations[x.index]
        return tape.at(operation[1]) if operation[0] == name else None

    return rule


def _same_operand(tape: _Tape, a: _N, b: _N, _: _Constant, __: _Constant) -> _N | None:
    return a if a.index == b.index else None


# Functions of a tape, operands and their values; each returns a simpler equivalent of the operation, or None.
RULES: dict[str, Callable[..., Any]] = {
    "add": _sum,
    "sub": _difference,
    "mul": _product,
    "div": _quotient,
    "and": _logic_rule(False),
    "or": _logic_rule(True),
    "select": _choice,
    "neg": _inverse_rule("neg"),
    "not": _inverse_rule("not"),
    "bits": _inverse_rule("real"),
    "real": _inverse_rule("bits"),
    "max": _same_operand,
    "min": _same_operand,
}
