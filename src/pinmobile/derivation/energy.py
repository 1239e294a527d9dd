"""The same equations by Lagrange, from the transforms alone, to confirm those by Newton and Euler."""

import sympy
from sympy import Expr, ImmutableMatrix

from pinmobile.derivation import wording as say
from pinmobile.derivation.algebra import normal
from pinmobile.derivation.chain import Chain
from pinmobile.derivation.joints import joints, placements
from pinmobile.derivation.newton_euler import SIMPLIFIED_JOINTS, finished
from pinmobile.derivation.record import Record, Simplified, Untouched
from pinmobile.derivation.steps import Derivation
from pinmobile.errors import InvalidArgument

__all__ = ["difference", "lagrange"]


def lagrange(derivation: Derivation) -> Derivation:
    """Derive the equations of motion of the same chain by Lagrange.

    Velocities are derivatives of the positions in T_0_k, angular velocities come from the skew matrix
    dR/dt R', and d/dt (dL/dv) - dL/dq with L = K - V gives the inputs. Nothing else is taken from `derivation`
    than its chain.

    Parameters
    ----------
    derivation : Derivation
        Whose chain to derive again.

    Returns
    -------
    derivation : Derivation
        The same equations with other steps. Beyond three joints nothing is simplified, and the expressions
        become long.
    """
    chain = derivation.chain
    treatment = Simplified(chain) if len(chain) <= SIMPLIFIED_JOINTS else Untouched()
    record = Record(treatment, len(chain))
    kinetic, potential = _energies(chain, record)
    momenta = sympy.Matrix([kinetic]).jacobian(chain.v)
    mass = momenta.jacobian(chain.v)
    slope = sympy.Matrix([kinetic - potential]).jacobian(chain.q)
    rest = momenta.jacobian(chain.q) * sympy.Matrix(chain.v) - slope.T
    tau = mass * sympy.Matrix(chain.a) + rest
    for k, variable in enumerate(chain.table.variables, 1):
        record.scalar(say.LAGRANGE_INPUT, tau[k - 1], k, variable=variable)
    rows = [chain.ordered(row) for row in mass.tolist()]
    return finished(chain, record, chain.ordered(rows), chain.ordered(rest), ())


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


def _energies(chain: Chain, record: Record) -> tuple[Expr, Expr]:
    """Return kinetic and potential energy [J]."""
    T = placements(joints(chain, record), record)
    kinetic = potential = sympy.S.Zero
    for k, link in enumerate(chain.links, 1):
        if link:
            p = record.matrix(say.POSITION_COM, T[k][:3, :3] * link.com + T[k][:3, 3], k)
            v = record.matrix(say.V_COM, _rate(p, chain), k)
            skew = _rate(T[k][:3, :3], chain) * T[k][:3, :3].T
            omega = record.matrix(say.OMEGA_SKEW, ImmutableMatrix([skew[2, 1], skew[0, 2], skew[1, 0]]), k)
            own = T[k][:3, :3].T * omega
            kinetic += link.mass * v.dot(v) / 2 + own.dot(link.inertia * own) / 2
            potential -= link.mass * chain.gravity.dot(p)
    return record.scalar(say.KINETIC, kinetic), record.scalar(say.POTENTIAL, potential)


def _rate(matrix: ImmutableMatrix, chain: Chain) -> ImmutableMatrix:
    """Return the derivative of a function of q with respect to time."""
    terms = (matrix.diff(q) * v for q, v in zip(chain.q, chain.v, strict=True))
    return sum(terms, start=ImmutableMatrix.zeros(*matrix.shape))
