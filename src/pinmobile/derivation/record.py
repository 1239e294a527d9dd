"""The record of a derivation, and the ways to keep its expressions small: simplify them, or name them."""

from typing import Protocol

from sympy import Expr, ImmutableMatrix, Symbol

from pinmobile.derivation.algebra import grouped, reduced
from pinmobile.derivation.chain import Chain
from pinmobile.derivation.steps import Step
from pinmobile.derivation.wording import Wording

__all__ = ["Named", "Record", "Simplified", "Treatment", "Untouched"]

Matrices = tuple[ImmutableMatrix, ImmutableMatrix]


class Treatment(Protocol):
    """What becomes of each result."""

    def take(self, name: str, result: ImmutableMatrix) -> Matrices:
        """Return what later steps are to use in the place of `result`, and what the reader is to see."""


class Simplified:
    """Every result is written in few terms; the reader sees them grouped by motion, then by mass."""

    def __init__(self, chain: Chain) -> None:
        self._levels = [symbols for symbols in (chain.v + chain.a, chain.masses) if symbols]

    def take(self, name: str, result: ImmutableMatrix) -> Matrices:
        """Return `result` expanded, and with common factors before brackets."""
        few = result.applyfunc(reduced)
        return few, few.applyfunc(lambda entry: grouped(entry, self._levels))


class Untouched:
    """Every result is used as it is."""

    def take(self, name: str, result: ImmutableMatrix) -> Matrices:
        """Return `result`, twice."""
        return result, result


class Named:
    """Every entry of a result that is not a symbol gets a name, and later steps use the name.

    The expressions grow in proportion to the number of joints so; written out, they grow exponentially.

    Attributes
    ----------
    assignments : list of (sympy.Symbol, sympy.Expr)
        The names and what they stand for, in terms of earlier ones.
    """

    def __init__(self, chain: Chain) -> None:
        self.assignments: list[tuple[Symbol, Expr]] = []
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
            self.assignments.append((Symbol(name), entry))
            self._known |= {entry: Symbol(name), -entry: -Symbol(name)}
        return self._known[entry]


class Record:
    """Takes down each step of a derivation.

    Parameters
    ----------
    treatment : Treatment
        What becomes of each result.
    last : int
        Number of the last frame.
    tag : str, optional
        Goes into the names of results, where the same quantity occurs in another record too.

    Attributes
    ----------
    steps : list of Step
        What was taken down so far.
    """

    def __init__(self, treatment: Treatment, last: int, tag: str = "") -> None:
        self.steps: list[Step] = []
        self._treatment, self._last, self._tag = treatment, last, tag

    def matrix(self, wording: Wording, result: ImmutableMatrix, k: int = 0, **texts: str) -> ImmutableMatrix:
        """Take down the step of `wording` for index `k` and return what stands for `result` from now on."""
        name, title, explanation, symbol = wording.at(k=k, j=k - 1, n=self._last, **texts)
        kept, shown = self._treatment.take(self._tagged(name), ImmutableMatrix(result))
        self.steps.append(Step(name, title, explanation, symbol, shown))
        return kept

    def scalar(self, wording: Wording, result: Expr, k: int = 0, **texts: str) -> Expr:
        """Take down a step whose result is one expression, and return what stands for it from now on."""
        name, title, explanation, symbol = wording.at(k=k, j=k - 1, n=self._last, **texts)
        kept, shown = self._treatment.take(self._tagged(name), ImmutableMatrix([[result]]))
        self.steps.append(Step(name, title, explanation, symbol, shown[0]))
        return kept[0]

    def aside(self, name: str, result: Expr) -> Expr:
        """Return what stands for `result` from now on, without a step of its own."""
        return self._treatment.take(self._tagged(name), ImmutableMatrix([[result]]))[0][0]

    def _tagged(self, name: str) -> str:
        return name.replace("_", f"__{self._tag}_", 1) if self._tag else name
