"""The record of a derivation, and two ways to keep its expressions small: simplified, or named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Protocol

from sympy import Expr, ImmutableMatrix, Symbol

import pinmobile.derivation.wording as say
from pinmobile.derivation.algebra import grouped, reduced
from pinmobile.derivation.chain import Chain
from pinmobile.derivation.steps import Derivation, Step
from pinmobile.derivation.wording import Wording

_Matrices = tuple[ImmutableMatrix, ImmutableMatrix]


class _Treatment(Protocol):
    """What becomes of each result."""

    @property
    def meanings(self) -> Mapping[Symbol, Expr]:
        """The symbols that stand for results, in the order in which they came up, and what they stand for."""

    def take(self, name: str, result: ImmutableMatrix) -> _Matrices:
        """Return what later steps are to use in the place of `result`, and what the reader is to see."""


class _Simplified:
    """Every result is written in few terms; the reader sees them grouped by motion, then by mass."""

    meanings: Mapping[Symbol, Expr] = MappingProxyType({})

    def __init__(self, chain: Chain) -> None:
        self._levels = (chain.v + chain.a, chain.masses)

    def take(self, name: str, result: ImmutableMatrix) -> _Matrices:
        """Return `result` expanded, and with common factors before brackets."""
        few = result.applyfunc(reduced)
        return few, few.applyfunc(lambda entry: grouped(entry, self._levels))


class Named:
    """Every entry of a result that is not a symbol gets a name, and later steps use the name.

    The expressions grow in proportion to the number of joints so; written out, they grow exponentially.

    Attributes
    ----------
    meanings : dict of sympy.Symbol to sympy.Expr
        The names and what they stand for, each in terms of earlier ones.
    """

    def __init__(self, chain: Chain) -> None:
        self.meanings: dict[Symbol, Expr] = {}
        self._taken = {symbol.name for symbol in (*chain.q, *chain.v, *chain.a, *chain.parameters)}
        self._known: dict[Expr, Expr] = {}

    def take(self, name: str, result: ImmutableMatrix) -> _Matrices:
        """Return names for the entries of `result`, and `result`."""
        rows, columns = result.shape
        if columns == 1:
            places = {1: [""], 3: list("xyz")}.get(rows, [f"_{i}" for i in range(1, rows + 1)])
        else:
            places = [f"_{i}{j}" for i in range(1, rows + 1) for j in range(1, columns + 1)]
        entries = [self._named(name + place, entry) for place, entry in zip(places, result, strict=True)]
        return ImmutableMatrix(rows, columns, entries), result

    def _named(self, name: str, entry: Expr) -> Expr:
        if entry.is_Atom or (-entry).is_Atom:
            return entry
        if entry not in self._known:
            while name in self._taken:
                name += "_"
            self._taken.add(name)
            self.meanings[Symbol(name)] = entry
            self._known |= {entry: Symbol(name), -entry: -Symbol(name)}
        return self._known[entry]


SIMPLIFIED_JOINTS = 3
"""Up to so many joints results are simplified; beyond, they are told in named intermediate results."""


class Record:
    """Takes down each step of a derivation.

    Parameters
    ----------
    chain : Chain
        What is derived.

    Attributes
    ----------
    steps : list of Step
        What was taken down so far.
    treatment : Treatment
        What becomes of each result.
    """

    def __init__(self, chain: Chain) -> None:
        self.chain, self._tag = chain, ""
        self.steps: list[Step] = []
        self.treatment: _Treatment = _Simplified(chain) if len(chain) <= SIMPLIFIED_JOINTS else Named(chain)

    def aside(self, tag: str) -> Record:
        """Return an empty record of the same names, for what is computed but not told.

        `tag` goes into new names, as the same quantities occur in this record.
        """
        other = Record(self.chain)
        other.treatment, other._tag = self.treatment, tag
        return other

    def matrix(self, wording: Wording, result: ImmutableMatrix, k: int = 0, **texts: str) -> ImmutableMatrix:
        """Take down the step of `wording` for index `k` and return what stands for `result` from now on."""
        row = self.chain.table.rows[max(k - 1, 0)]
        name, title, explanation, symbol = wording.at(k, len(self.chain), row, **texts)
        kept, shown = self.treatment.take(self._tagged(name), ImmutableMatrix(result))
        self.steps.append(Step(name, title, explanation, symbol, shown))
        return kept

    def scalar(self, wording: Wording, result: Expr, k: int = 0, **texts: str) -> Expr:
        """Take down a step whose result is one expression; see `matrix`."""
        kept = self.matrix(wording, ImmutableMatrix([[result]]), k, **texts)
        self.steps[-1] = replace(self.steps[-1], expression=self.steps[-1].expression[0])
        return kept[0]

    def named(self, name: str, result: Expr) -> Expr:
        """Return what stands for `result` from now on, without a step of its own."""
        return self.treatment.take(self._tagged(name), ImmutableMatrix([[result]]))[0][0]

    def finished(self, M: Sequence[Sequence[Expr]], n: Sequence[Expr]) -> Derivation:
        """Take down M and n, given in the order of the rows, and return the derivation."""
        order, variables = self.chain.order, self.chain.table.variables
        names = [f"tau_{variables.index(name) + 1}" for name in order]
        texts = {"order": ", ".join(order), "inputs": ", ".join(names)}
        rows = self.chain.ordered([self.chain.ordered(row) for row in M])
        self.matrix(say.MASS_MATRIX, ImmutableMatrix(rows), 0, **texts)
        self.matrix(say.NONLINEAR_EFFECTS, ImmutableMatrix(self.chain.ordered(n)), 0, **texts)
        shown = {step.name: step.expression for step in self.steps}
        inputs = ImmutableMatrix([shown[name] for name in names])
        meanings = tuple(self.treatment.meanings.items())
        return Derivation(self.chain, tuple(self.steps), inputs, shown["M"], shown["n_v"], meanings)

    def _tagged(self, name: str) -> str:
        # as sympy reads names, __ begins a superscript and _ a subscript
        return name.replace("_", f"__{self._tag}_", 1) if self._tag else name
