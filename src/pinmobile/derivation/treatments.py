"""Two ways to keep the expressions of a derivation small: simplify them, or give them names."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Protocol

from sympy import Expr, ImmutableMatrix, Symbol

from pinmobile.derivation.algebra import grouped, reduced
from pinmobile.derivation.chain import Chain

__all__ = ["Named", "Simplified", "Treatment"]

Matrices = tuple[ImmutableMatrix, ImmutableMatrix]


class Treatment(Protocol):
    """What becomes of each result."""

    @property
    def meanings(self) -> Mapping[Symbol, Expr]:
        """The symbols that stand for results, in the order in which they came up, and what they stand for."""

    def take(self, name: str, result: ImmutableMatrix) -> Matrices:
        """Return what later steps are to use in the place of `result`, and what the reader is to see."""


class Simplified:
    """Every result is written in few terms; the reader sees them grouped by motion, then by mass."""

    meanings: Mapping[Symbol, Expr] = MappingProxyType({})

    def __init__(self, chain: Chain) -> None:
        self._levels = (chain.v + chain.a, chain.masses)

    def take(self, name: str, result: ImmutableMatrix) -> Matrices:
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

    def take(self, name: str, result: ImmutableMatrix) -> Matrices:
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
