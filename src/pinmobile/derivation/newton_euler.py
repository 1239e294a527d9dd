"""The derivation of the lecture: out along the chain with Newton and Euler, and back in."""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import sympy
from sympy import Expr

from pinmobile.derivation import wording as say
from pinmobile.derivation.chain import Chain, Link
from pinmobile.derivation.joints import ZERO, joints, placements
from pinmobile.derivation.record import SIMPLIFIED_JOINTS, Record
from pinmobile.derivation.recursion import Recursion, Vectors
from pinmobile.derivation.steps import Derivation
from pinmobile.derivation.wording import Wording
from pinmobile.dh import LECTURE_TABLE, DHTable
from pinmobile.errors import InvalidArgument, shown

__all__ = ["derive", "lecture"]


def derive(
    table: DHTable,
    links: Sequence[Link | None] | None = None,
    *,
    order: Sequence[str] | None = None,
    gravity: Any = (0, 0, 0),
) -> Derivation:
    """Derive the equations of motion of a chain, by Newton and Euler.

    Parameters
    ----------
    table : DHTable
        The joints, prismatic or revolute, in modified-DH form.
    links : sequence of Link or None, one per row, optional
        The link behind each joint, None for a virtual one without mass. By default `Link.general`, for all.
    order : sequence of str, optional
        The order in which coordinates, inputs, M and n are listed: a permutation of the table's variables.
        By default that of the rows.
    gravity : sequence of 3 floats or sympy.Expr, optional
        Acceleration of free fall in frame 0 [m/s^2]. By default none: the ground is level.

    Returns
    -------
    derivation : Derivation
        Its steps and its equations; simplified up to three joints, in named intermediate results beyond.

    Raises
    ------
    InvalidArgument
        If a length or a type is wrong, or two symbols would have the same name.
    UnknownName
        If `order` has a name that is not a variable of the table.
    """
    record = Record(Chain(table, links, order, gravity))
    recursion, tau = _told(record)
    return _coefficients(record, tau) if len(recursion.joints) <= SIMPLIFIED_JOINTS else _columns(recursion)


def lecture(table: DHTable = LECTURE_TABLE) -> Derivation:
    """Derive the lecture's mobile robot: one body behind three joints, listed as (x, y, psi).

    The body has mass m, its centre of mass at (xbc, ybc, 0) and the yaw inertia Icz (lecture 45, "Dynamic
    model"). The result is made once for each table and kept.

    Parameters
    ----------
    table : DHTable, optional
        Three joints with the variables x, y and psi, in any order.

    Returns
    -------
    derivation : Derivation
        With the parameters m [kg], xbc, ybc [m] and Icz [kg m^2].

    Raises
    ------
    InvalidArgument
        If the table has other variables.
    """
    if not isinstance(table, DHTable) or set(table.variables) != {"x", "y", "psi"}:
        raise InvalidArgument(f"table is {shown(table)}, expected a DHTable with the variables x, y and psi")
    return _lecture(table)


@lru_cache
def _lecture(table: DHTable) -> Derivation:
    m, xbc, ybc, Icz = sympy.symbols("m xbc ybc Icz")
    body = Link(m, (xbc, ybc, 0), sympy.diag(0, 0, Icz))
    return derive(table, (None, None, body), order=("x", "y", "psi"))


def _coefficients(record: Record, tau: Sequence[Expr]) -> Derivation:
    """Read M off as the lecture does: the coefficients of the accelerations in the inputs."""
    a = record.chain.a
    rest = dict.fromkeys(a, sympy.S.Zero)
    return record.finished(
        [[component.diff(acceleration) for acceleration in a] for component in tau],
        [component.xreplace(rest) for component in tau],
    )


def _columns(told: Recursion) -> Derivation:
    """Take for column k of M the inputs of a unit acceleration of joint k, at rest and without gravity.

    To read coefficients off, the inputs would have to be written out.
    """
    size = range(len(told.joints))
    zeros = (sympy.S.Zero,) * len(size)
    units = [tuple(sympy.S(int(i == k)) for i in size) for k in size]

    def inputs(tag: str, **motion: Any) -> tuple[Expr, ...]:
        other = replace(told, record=told.record.aside(tag), **motion)
        omega = other.angular_velocities()
        alpha = other.angular_accelerations(omega)
        return other.inputs(omega, alpha, other.linear_accelerations(omega, alpha))

    columns = [inputs(f"M{k + 1}", v=zeros, a=unit, base=ZERO) for k, unit in enumerate(units)]
    # of the two halves of M, this one stays clear of the joints beyond k
    M = [[columns[max(i, k)][min(i, k)] for k in size] for i in size]
    return told.record.finished(M, inputs("n", a=zeros))


def _told(record: Record) -> tuple[Recursion, tuple[Expr, ...]]:
    """Take all steps up to the inputs, in the lecture's order; return the inputs in the order of the rows."""
    chain, links = record.chain, joints(record)
    pose = placements(links, record)[-1]
    for words, column in ((say.POSITION, 3), (say.NORMAL, 0), (say.SLIDING, 1), (say.APPROACH, 2)):
        record.matrix(words, pose[:3, column])
    recursion = Recursion(links, chain.v, chain.a, -chain.gravity, record)

    def in_base(words: Wording, vectors: Vectors) -> Vectors:
        record.matrix(words, pose[:3, :3] * vectors[-1])
        return vectors

    omega = in_base(say.OMEGA_BASE, recursion.angular_velocities())
    in_base(say.VELOCITY_BASE, recursion.linear_velocities(omega))
    alpha = in_base(say.ALPHA_BASE, recursion.angular_accelerations(omega))
    a = in_base(say.ACCELERATION_BASE, recursion.linear_accelerations(omega, alpha))
    return recursion, recursion.inputs(omega, alpha, a)
