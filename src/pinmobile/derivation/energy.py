"""The same equations by Lagrange, from the transforms alone, to confirm those by Newton and Euler."""

import sympy
from sympy import Expr, ImmutableMatrix, Symbol

from pinmobile.derivation import wording as say
from pinmobile.derivation.algebra import normal
from pinmobile.derivation.joints import joints, placements
from pinmobile.derivation.record import SIMPLIFIED_JOINTS, Record
from pinmobile.derivation.steps import Derivation
from pinmobile.errors import InvalidArgument

__all__ = ["difference", "lagrange"]


def lagrange(derivation: Derivation) -> Derivation:
    """Derive the equations of motion of the same chain by Lagrange.

    Velocities are derivatives of the positions in T_0_k, angular velocities come from the skew matrix
    dR/dt R', and d/dt (dL/dv) - dL/dq with L = K - V gives the inputs. Of the derivation by Newton and Euler
    nothing is used but its chain.

    Parameters
    ----------
    derivation : Derivation
        Whose chain to derive again.

    Returns
    -------
    derivation : Derivation
        The same equations, with other steps.
    """
    record = Record(derivation.chain)
    chain = record.chain
    in_time = _Slope(dict(zip(chain.q, chain.v, strict=True)), "t", record)
    K, V = _energies(record, in_time)
    to_v = [_Slope({v: sympy.S.One}, str(v), record) for v in chain.v]
    momenta = [record.scalar(say.MOMENTUM, slope(K), k) for k, slope in enumerate(to_v, 1)]
    M = [[slope(momentum) for slope in to_v] for momentum in momenta]
    n = [
        in_time(momentum) - _Slope({q: sympy.S.One}, str(q), record)(K - V)
        for momentum, q in zip(momenta, chain.q, strict=True)
    ]
    for k, (row, rest) in enumerate(zip(M, n, strict=True), 1):
        inertial = sum(m * a for m, a in zip(row, chain.a, strict=True))
        record.scalar(say.LAGRANGE, inertial + rest, k)
    return record.finished(M, n)


def difference(first: Derivation, second: Derivation) -> ImmutableMatrix:
    """Return the normal form of the difference of the inputs: zero if and only if the equations are the same.

    Parameters
    ----------
    first, second : Derivation
        Two derivations with the same coordinates, of up to three joints.

    Returns
    -------
    difference : sympy.ImmutableMatrix, shape (n, 1)
        `first.inputs - second.inputs` [N or N m].

    Raises
    ------
    InvalidArgument
        If their coordinates differ, or there are more than three.
    """
    if first.q != second.q or len(first.q) > SIMPLIFIED_JOINTS:
        raise InvalidArgument(
            f"coordinates are {first.q} and {second.q}, expected the same, {SIMPLIFIED_JOINTS} at most"
        )
    return (first.inputs - second.inputs).applyfunc(normal)


def _energies(record: Record, in_time: "_Slope") -> tuple[Expr, Expr]:
    """Return kinetic and potential energy [J]."""
    chain, T = record.chain, placements(joints(record), record)
    kinetic = potential = sympy.S.Zero
    for k, link in enumerate(chain.links, 1):
        if link:
            R = T[k][:3, :3]
            p = record.matrix(say.POSITION_COM, R * link.com + T[k][:3, 3], k)
            v = record.matrix(say.VELOCITY_COM, p.applyfunc(in_time), k)
            skew = R.applyfunc(in_time) * R.T
            omega = record.matrix(say.OMEGA_SKEW, ImmutableMatrix([skew[2, 1], skew[0, 2], skew[1, 0]]), k)
            own_v = record.matrix(say.VELOCITY_OWN, R.T * v, k)
            own_omega = record.matrix(say.OMEGA_OWN, R.T * omega, k)
            kinetic += link.mass * own_v.dot(own_v) / 2 + own_omega.dot(link.inertia * own_omega) / 2
            potential -= link.mass * chain.gravity.dot(p)
    return record.scalar(say.KINETIC, kinetic), record.scalar(say.POTENTIAL, potential)


class _Slope:
    """The derivative in one direction, which sees through the names of intermediate results.

    Parameters
    ----------
    direction : dict of sympy.Symbol to sympy.Expr
        The derivatives of the variables that are not constant.
    label : str
        Goes into the names of derivatives.
    record : Record
        Its treatment gave the names.
    """

    def __init__(self, direction: dict[Symbol, Expr], label: str, record: Record) -> None:
        self._known, self._label, self._record = direction, label, record

    def __call__(self, expression: Expr) -> Expr:
        slopes = {symbol: self._of(symbol) for symbol in sorted(expression.free_symbols, key=str)}
        return sympy.Add(*(expression.diff(symbol) * slope for symbol, slope in slopes.items() if slope))

    def _of(self, symbol: Symbol) -> Expr:
        if symbol not in self._known:
            meaning = self._record.treatment.meanings.get(symbol)
            slope = self(meaning) if meaning is not None else sympy.S.Zero
            self._known[symbol] = self._record.named(f"{symbol.name}_d{self._label}", slope)
        return self._known[symbol]
