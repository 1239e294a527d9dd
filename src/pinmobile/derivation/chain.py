"""What is derived: links, their chain and the symbols of its motion."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from sympy import Expr, ImmutableMatrix, Symbol

from pinmobile.arrays import Array, instance, sequence, whole
from pinmobile.derivation.algebra import exact, exact_matrix
from pinmobile.dh import DHTable
from pinmobile.errors import InvalidArgument, shown


@dataclass(frozen=True)
class Link:
    """The mass distribution of one link, in symbols or numbers.

    Parameters
    ----------
    mass : sympy.Expr or float
        Mass [kg].
    com : sequence of 3 sympy.Expr or float
        Centre of mass in the frame of the link [m].
    inertia : 3 x 3 sympy.Expr or float
        Rotational inertia about the centre of mass, in the axes of the link [kg m^2]. It must be symmetric.

    Raises
    ------
    InvalidArgument
        If a shape is wrong, an entry is neither a finite number nor an expression, `mass` is negative or
        `inertia` not symmetric.
    """

    mass: Expr
    com: ImmutableMatrix
    inertia: ImmutableMatrix

    def __post_init__(self) -> None:
        object.__setattr__(self, "mass", exact("mass", self.mass))
        object.__setattr__(self, "com", exact_matrix("com", self.com, (3, 1)))
        object.__setattr__(self, "inertia", exact_matrix("inertia", self.inertia, (3, 3)))
        if self.mass.is_negative:
            raise InvalidArgument(f"mass is {self.mass} kg, expected >= 0")
        if self.inertia != self.inertia.T:
            raise InvalidArgument(f"inertia is {self.inertia.tolist()}, expected a symmetric matrix")

    @classmethod
    def general(cls, k: int) -> Link:
        """Return link `k` with every quantity a symbol: m1, xc1, yc1, zc1, Ixx1, Ixy1, ... for k = 1."""
        k = whole("k", k, least=0)
        inertia = [[Symbol(f"I{min(i, j)}{max(i, j)}{k}") for j in "xyz"] for i in "xyz"]
        return cls(Symbol(f"m{k}"), [Symbol(f"{axis}c{k}") for axis in "xyz"], inertia)

    @cached_property
    def parameters(self) -> tuple[Symbol, ...]:
        """The symbols in mass, centre of mass and inertia, in this order."""
        return _symbols([self.mass, *self.com, *self.inertia])


@dataclass(frozen=True)
class Chain:
    """A modified-DH table with its links, the order of its coordinates, and gravity.

    `q`, `v` and `a` are in the order of the rows here; `order` says how inputs, M and n list them.

    Parameters
    ----------
    table : DHTable
        The chain of joints.
    links : sequence of Link or None, one per row, optional
        The link behind each joint; None is a virtual one, without mass. By default `Link.general`, for all.
    order : sequence of str, optional
        A permutation of the table's variables. By default that of the rows.
    gravity : sequence of 3 sympy.Expr or float, optional
        Acceleration of free fall in frame 0 [m/s^2]. By default none: the ground is level.

    Raises
    ------
    InvalidArgument
        If a length or a type is wrong, or two symbols would have the same name.
    UnknownName
        If `order` has a name that is not a variable of the table.
    """

    table: DHTable
    links: tuple[Link | None, ...]
    order: tuple[str, ...]
    gravity: ImmutableMatrix

    def __init__(
        self,
        table: DHTable,
        links: Sequence[Link | None] | None = None,
        order: Sequence[str] | None = None,
        gravity: Sequence[Expr | float] | Array = (0, 0, 0),
    ) -> None:
        instance("table", table, DHTable, "a DHTable")
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
            raise InvalidArgument(f"links is {shown(self.links)}, expected {len(self)} of Link or None")
        if len(self.order) != len(variables) or set(variables) != {*map(str, self.order)}:
            raise InvalidArgument(f"order is {shown(self.order)}, expected a permutation of {variables}")
        names = Counter(symbol.name for symbol in (*self.q, *self.v, *self.a, *self.parameters))
        if twice := [name for name, count in names.items() if count > 1]:
            raise InvalidArgument(f"links and table give {twice} two meanings, expected distinct names")

    def __len__(self) -> int:
        return len(self.table)

    @cached_property
    def q(self) -> tuple[Symbol, ...]:
        """Joint variables, in the order of the rows."""
        return tuple(Symbol(name) for name in self.table.variables)

    @cached_property
    def v(self) -> tuple[Symbol, ...]:
        """Their rates: psidot, qdot1, ..."""
        return self._dotted("dot")

    @cached_property
    def a(self) -> tuple[Symbol, ...]:
        """Their accelerations: psiddot, qddot1, ..."""
        return self._dotted("ddot")

    @cached_property
    def parameters(self) -> tuple[Symbol, ...]:
        """The symbols in links and gravity, from the ground outwards."""
        found = [symbol for link in self.links if link for symbol in link.parameters]
        return tuple(dict.fromkeys([*found, *_symbols(self.gravity)]))

    @cached_property
    def masses(self) -> tuple[Symbol, ...]:
        """The symbols in the masses of the links."""
        return _symbols([link.mass for link in self.links if link])

    def ordered(self, per_row: Sequence[Any]) -> tuple[Any, ...]:
        """Return what is listed in the order of the rows, in `order`.

        Raises
        ------
        InvalidArgument
            If it is no sequence of one for each row.
        """
        per_row = sequence("per_row", per_row, f"a sequence of {len(self)}")
        if len(per_row) != len(self):
            raise InvalidArgument(f"per_row has {len(per_row)} entries, expected {len(self)}")
        return tuple(per_row[self.table.variables.index(name)] for name in self.order)

    def _dotted(self, dots: str) -> tuple[Symbol, ...]:
        # sympy sets xdot, qdot1 and qdot_a with a dot above the letter, but not q1dot
        return tuple(Symbol(re.sub(r"^[^\W\d_]*", rf"\g<0>{dots}", name)) for name in self.table.variables)


def _symbols(expressions: Sequence[Expr]) -> tuple[Symbol, ...]:
    found = (sorted(expression.free_symbols, key=str) for expression in expressions)
    return tuple(dict.fromkeys(symbol for symbols in found for symbol in symbols))
