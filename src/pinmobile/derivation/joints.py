"""The transforms of a modified-DH table, in symbols."""

from dataclasses import dataclass

import sympy
from sympy import ImmutableMatrix

from pinmobile.derivation import wording as say
from pinmobile.derivation.exact import exact, exact_angle
from pinmobile.derivation.record import Record
from pinmobile.dh import JointType

__all__ = ["ZERO", "Joint", "joints", "placements"]

ZERO = ImmutableMatrix([0, 0, 0])
_Z = ImmutableMatrix([0, 0, 1])


@dataclass(frozen=True)
class Joint:
    """The transform of one row, and what the joint moves about or along.

    Attributes
    ----------
    T : sympy.ImmutableMatrix, shape (4, 4)
        Pose of frame k in frame k - 1.
    turn, slide : sympy.ImmutableMatrix, shape (3, 1)
        z_k and zero for a revolute joint, zero and z_k for a prismatic one.
    """

    T: ImmutableMatrix
    turn: ImmutableMatrix
    slide: ImmutableMatrix

    @property
    def R(self) -> ImmutableMatrix:
        """Rotation of the transform."""
        return self.T[:3, :3]

    @property
    def P(self) -> ImmutableMatrix:
        """Translation of the transform [m]."""
        return self.T[:3, 3]


def joints(record: Record) -> tuple[Joint, ...]:
    """Return the joints of the chain, from the ground outwards."""
    chain, found = record.chain, []
    for k, (row, q) in enumerate(zip(chain.table, chain.q, strict=True), 1):
        revolute = row.joint is JointType.REVOLUTE
        alpha, a = exact_angle("alpha", row.alpha), exact("a", row.a)
        theta = exact_angle("theta", row.theta) + (q if revolute else 0)
        d = exact("d", row.d) + (0 if revolute else q)
        ca, sa = sympy.cos(alpha), sympy.sin(alpha)
        c, s = record.named(f"c_{k}", sympy.cos(theta)), record.named(f"s_{k}", sympy.sin(theta))
        T = [[c, -s, 0, a], [s * ca, c * ca, -sa, -d * sa], [s * sa, c * sa, ca, d * ca], [0, 0, 0, 1]]
        axes = (_Z, ZERO) if revolute else (ZERO, _Z)
        found.append(Joint(record.matrix(say.LOCAL, ImmutableMatrix(T), k), *axes))
    return tuple(found)


def placements(links: tuple[Joint, ...], record: Record) -> list[ImmutableMatrix]:
    """Return T_0_k for every frame, the ground's first: the products of the first k transforms."""
    T = [ImmutableMatrix.eye(4), links[0].T]
    for k, joint in enumerate(links[1:], 2):
        T.append(record.matrix(say.PLACEMENT, T[-1] * joint.T, k))
    return T
