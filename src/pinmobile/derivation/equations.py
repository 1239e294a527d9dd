"""The equations of motion, derived by Newton and Euler out and back along the chain, and by Lagrange."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import pi
from typing import Any
from warnings import warn

import sympy
from sympy import Expr, ImmutableMatrix, Symbol

import pinmobile.derivation.steps as say
from pinmobile.arrays import Array
from pinmobile.derivation.chain import Chain, Link, exact, exact_angle, normal
from pinmobile.derivation.steps import SIMPLIFIED_JOINTS, Derivation, Record, Wording
from pinmobile.dh import LECTURE_TABLE, DHTable, JointType
from pinmobile.errors import InvalidArgument, shown

ZERO = ImmutableMatrix([0, 0, 0])
_Z = ImmutableMatrix([0, 0, 1])
_FOUR_DECIMALS = 5e-5  # [rad], of a right angle that is written so


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
        alpha, a = _table_angle("alpha", row.alpha, k), exact("a", row.a)
        theta = _table_angle("theta", row.theta, k) + (q if revolute else 0)
        d = exact("d", row.d) + (0 if revolute else q)
        ca, sa = sympy.cos(alpha), sympy.sin(alpha)
        c, s = record.named(f"c_{k}", sympy.cos(theta)), record.named(f"s_{k}", sympy.sin(theta))
        T = [[c, -s, 0, a], [s * ca, c * ca, -sa, -d * sa], [s * sa, c * sa, ca, d * ca], [0, 0, 0, 1]]
        axes = (_Z, ZERO) if revolute else (ZERO, _Z)
        found.append(Joint(record.matrix(say.LOCAL, ImmutableMatrix(T), k), *axes))
    return tuple(found)


def _table_angle(name: str, value: float, k: int) -> Expr:
    """Return an angle of row `k` of a table: a right one where four decimals were meant for it."""
    angle, right = exact_angle(name, value), sympy.Rational(round(2 * value / pi), 2) * sympy.pi
    if angle == right or not right or abs(value - float(right)) > _FOUR_DECIMALS:
        return angle
    warn(f"{name} of row {k} is {value:.12g} rad, and the derivation takes {right}", stacklevel=5)
    return right


def placements(links: tuple[Joint, ...], record: Record) -> list[ImmutableMatrix]:
    """Return T_0_k for every frame, the ground's first: the products of the first k transforms."""
    T = [ImmutableMatrix.eye(4), links[0].T]
    for k, joint in enumerate(links[1:], 2):
        T.append(record.matrix(say.PLACEMENT, T[-1] * joint.T, k))
    return T


Vectors = list[ImmutableMatrix]


@dataclass(frozen=True)
class _Recursion:
    """Newton-Euler's recursion over a chain, for one motion.

    In every list, item k belongs to frame k and is expressed in it; item 0 is the ground.

    Attributes
    ----------
    joints : tuple of Joint
        The joints, from the ground outwards.
    v, a : tuple of sympy.Expr
        Velocities [m/s or rad/s] and accelerations [m/s^2 or rad/s^2], in the order of the rows.
    base : sympy.ImmutableMatrix, shape (3, 1)
        Acceleration of the ground [m/s^2]: upwards as fast as a body would fall.
    record : Record
        Knows the chain, and takes down the steps.
    """

    joints: tuple[Joint, ...]
    v: tuple[Expr, ...]
    a: tuple[Expr, ...]
    base: ImmutableMatrix
    record: Record

    def angular_velocities(self) -> Vectors:
        """Return omega [rad/s]."""
        omega = [ZERO]
        for k, joint in enumerate(self.joints):
            result = joint.R.T * omega[k] + joint.turn * self.v[k]
            omega.append(self.record.matrix(say.OMEGA, result, k + 1))
        return omega

    def linear_velocities(self, omega: Vectors) -> Vectors:
        """Return the velocities of the frames' origins [m/s]."""
        velocity = [ZERO]
        for k, joint in enumerate(self.joints):
            result = joint.R.T * (velocity[k] + omega[k].cross(joint.P)) + joint.slide * self.v[k]
            velocity.append(self.record.matrix(say.VELOCITY, result, k + 1))
        return velocity

    def angular_accelerations(self, omega: Vectors) -> Vectors:
        """Return alpha [rad/s^2]."""
        alpha = [ZERO]
        for k, joint in enumerate(self.joints):
            gyroscopic = (joint.R.T * omega[k]).cross(joint.turn * self.v[k])
            result = joint.R.T * alpha[k] + gyroscopic + joint.turn * self.a[k]
            alpha.append(self.record.matrix(say.ALPHA, result, k + 1))
        return alpha

    def linear_accelerations(self, omega: Vectors, alpha: Vectors) -> Vectors:
        """Return the accelerations of the frames' origins [m/s^2]."""
        a = [self.base]
        for k, joint in enumerate(self.joints):
            carried = joint.R.T * (a[k] + _lever(alpha[k], omega[k], joint.P))
            coriolis = 2 * omega[k + 1].cross(joint.slide * self.v[k])
            a.append(
                self.record.matrix(say.ACCELERATION, carried + coriolis + joint.slide * self.a[k], k + 1)
            )
        return a

    def inertial(self, omega: Vectors, alpha: Vectors, a: Vectors) -> tuple[Vectors, Vectors]:
        """Return inertial forces F [N], and moments N about the centres of mass [N m]."""
        heavy = {k: link for k, link in enumerate(self.record.chain.links, 1) if link}
        F, N = [ZERO] * len(a), [ZERO] * len(a)
        a_c = {
            k: self.record.matrix(say.ACCELERATION_COM, a[k] + _lever(alpha[k], omega[k], link.com), k)
            for k, link in heavy.items()
        }
        for k, link in heavy.items():
            F[k] = self.record.matrix(say.INERTIAL_FORCE, link.mass * a_c[k], k)
        for k, link in heavy.items():
            moment = link.inertia * alpha[k] + omega[k].cross(link.inertia * omega[k])
            N[k] = self.record.matrix(say.INERTIAL_MOMENT, moment, k)
        return F, N

    def forces(self, F: Vectors) -> Vectors:
        """Return f [N]: f_k is the force of link k - 1 on link k, and f_0 that of the ground, in frame 0."""
        f = [ZERO, *F[1:]]
        f[-1] = self.record.matrix(say.FORCE, F[-1], len(F) - 1)
        for k in range(len(F) - 2, -1, -1):
            words = say.FORCE if k else say.SHAKING_FORCE
            f[k] = self.record.matrix(words, self.joints[k].R * f[k + 1] + F[k], k)
        return f

    def moments(self, F: Vectors, N: Vectors, f: Vectors) -> Vectors:
        """Return n [N m]: the moments that belong to `f`, each about the origin of its frame."""
        com = [ZERO, *(link.com if link else ZERO for link in self.record.chain.links)]
        own = [N[k] + com[k].cross(F[k]) for k in range(len(N))]
        own[-1] = self.record.matrix(say.MOMENT, own[-1], len(N) - 1)
        for k in range(len(N) - 2, -1, -1):
            joint, words = self.joints[k], say.MOMENT if k else say.SHAKING_MOMENT
            passed_on = joint.R * own[k + 1] + joint.P.cross(joint.R * f[k + 1])
            own[k] = self.record.matrix(words, own[k] + passed_on, k)
        return own

    def inputs(self, omega: Vectors, alpha: Vectors, a: Vectors) -> tuple[Expr, ...]:
        """Return tau [N or N m] for a motion of the frames, in the order of the rows."""
        F, N = self.inertial(omega, alpha, a)
        f = self.forces(F)
        n = self.moments(F, N, f)
        tau = []
        for k, joint in enumerate(self.joints, 1):
            component = joint.slide.dot(f[k]) + joint.turn.dot(n[k])
            tau.append(self.record.scalar(say.INPUT, component, k))
        return tuple(tau)


def _lever(alpha: ImmutableMatrix, omega: ImmutableMatrix, arm: ImmutableMatrix) -> ImmutableMatrix:
    """Return how much more than the frame's origin a point at `arm` accelerates."""
    return alpha.cross(arm) + omega.cross(omega.cross(arm))


def derive(
    table: DHTable,
    links: Sequence[Link | None] | None = None,
    *,
    order: Sequence[str] | None = None,
    gravity: Sequence[Expr | float] | Array = (0, 0, 0),
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


def _columns(told: _Recursion) -> Derivation:
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


def _told(record: Record) -> tuple[_Recursion, tuple[Expr, ...]]:
    """Take all steps up to the inputs, in the lecture's order; return the inputs in the order of the rows."""
    chain, links = record.chain, joints(record)
    pose = placements(links, record)[-1]
    for words, column in ((say.POSITION, 3), (say.NORMAL, 0), (say.SLIDING, 1), (say.APPROACH, 2)):
        record.matrix(words, pose[:3, column])
    recursion = _Recursion(links, chain.v, chain.a, -chain.gravity, record)

    def in_base(words: Wording, vectors: Vectors) -> Vectors:
        record.matrix(words, pose[:3, :3] * vectors[-1])
        return vectors

    omega = in_base(say.OMEGA_BASE, recursion.angular_velocities())
    in_base(say.VELOCITY_BASE, recursion.linear_velocities(omega))
    alpha = in_base(say.ALPHA_BASE, recursion.angular_accelerations(omega))
    a = in_base(say.ACCELERATION_BASE, recursion.linear_accelerations(omega, alpha))
    return recursion, recursion.inputs(omega, alpha, a)


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


def _energies(record: Record, in_time: _Slope) -> tuple[Expr, Expr]:
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
