"""Equations of motion of a chain, by the Newton-Euler recursion and by Lagrange's equations."""

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
from pinmobile.derivation.chain import Chain, Link, exact_angle, exact_value, normal_form
from pinmobile.derivation.steps import SIMPLIFIED_JOINTS, Derivation, Record, Wording
from pinmobile.dh import LECTURE_TABLE, DHTable, JointType
from pinmobile.errors import InvalidArgument, unexpected_value

ZERO = ImmutableMatrix([0, 0, 0])
_Z = ImmutableMatrix([0, 0, 1])
_ANGLE_TOLERANCE = 5e-5  # [rad]: rounding of a right angle in four decimals


@dataclass(frozen=True)
class Joint:
    """Transform of one row, and the axis of the joint.

    Attributes
    ----------
    T : sympy.ImmutableMatrix, shape (4, 4)
        Pose of frame k in frame k - 1.
    angular, linear : sympy.ImmutableMatrix, shape (3, 1)
        z_k and zero for a revolute joint, zero and z_k for a prismatic one.
    """

    T: ImmutableMatrix
    angular: ImmutableMatrix
    linear: ImmutableMatrix

    @property
    def R(self) -> ImmutableMatrix:
        """Rotation matrix of the transform."""
        return self.T[:3, :3]

    @property
    def P(self) -> ImmutableMatrix:
        """Translation of the transform [m]."""
        return self.T[:3, 3]


def joints(record: Record) -> tuple[Joint, ...]:
    """Return the joints of the chain, from the ground outwards."""
    chain, links = record.chain, []
    for k, (row, q) in enumerate(zip(chain.table, chain.q, strict=True), 1):
        is_revolute = row.joint is JointType.REVOLUTE
        alpha, a = _table_angle("alpha", row.alpha, k), exact_value("a", row.a)
        theta = _table_angle("theta", row.theta, k) + (q if is_revolute else 0)
        d = exact_value("d", row.d) + (0 if is_revolute else q)
        ca, sa = sympy.cos(alpha), sympy.sin(alpha)
        c, s = record.short(f"c_{k}", sympy.cos(theta)), record.short(f"s_{k}", sympy.sin(theta))
        T = [[c, -s, 0, a], [s * ca, c * ca, -sa, -d * sa], [s * sa, c * sa, ca, d * ca], [0, 0, 0, 1]]
        axes = (_Z, ZERO) if is_revolute else (ZERO, _Z)
        links.append(Joint(record.matrix(say.LOCAL, ImmutableMatrix(T), k), *axes))
    return tuple(links)


def _table_angle(name: str, value: float, k: int) -> Expr:
    """Return an angle of row `k` of a table; a right angle that is rounded to four decimals becomes exact."""
    angle, exact = exact_angle(name, value), sympy.Rational(round(2 * value / pi), 2) * sympy.pi
    if angle == exact or not exact or abs(value - float(exact)) > _ANGLE_TOLERANCE:
        return angle
    warn(f"{name} of row {k} is {value:.12g} rad; the derivation uses {exact}", stacklevel=5)
    return exact


def placements(links: tuple[Joint, ...], record: Record) -> list[ImmutableMatrix]:
    """Return T_0_k for every frame, starting with the ground: the products of the first k transforms."""
    T = [ImmutableMatrix.eye(4), links[0].T]
    for k, joint in enumerate(links[1:], 2):
        T.append(record.matrix(say.PLACEMENT, T[-1] * joint.T, k))
    return T


Vectors = list[ImmutableMatrix]


@dataclass(frozen=True)
class _Recursion:
    """Newton-Euler recursion over a chain, for one motion.

    In every list, entry k belongs to frame k and is expressed in frame k; entry 0 belongs to the ground.

    Attributes
    ----------
    joints : tuple of Joint
        Joints from the ground outwards.
    v, a : tuple of sympy.Expr
        Velocities [m/s or rad/s] and accelerations [m/s^2 or rad/s^2], in the order of the rows.
    base : sympy.ImmutableMatrix, shape (3, 1)
        Acceleration of the ground [m/s^2], opposite to gravity.
    record : Record
        Record of the steps, with the chain.
    """

    joints: tuple[Joint, ...]
    v: tuple[Expr, ...]
    a: tuple[Expr, ...]
    base: ImmutableMatrix
    record: Record

    def angular_velocities(self) -> Vectors:
        """Return the angular velocities omega [rad/s]."""
        omega = [ZERO]
        for k, joint in enumerate(self.joints):
            result = joint.R.T * omega[k] + joint.angular * self.v[k]
            omega.append(self.record.matrix(say.OMEGA, result, k + 1))
        return omega

    def linear_velocities(self, omega: Vectors) -> Vectors:
        """Return the velocities of the frames' origins [m/s]."""
        velocity = [ZERO]
        for k, joint in enumerate(self.joints):
            result = joint.R.T * (velocity[k] + omega[k].cross(joint.P)) + joint.linear * self.v[k]
            velocity.append(self.record.matrix(say.VELOCITY, result, k + 1))
        return velocity

    def angular_accelerations(self, omega: Vectors) -> Vectors:
        """Return the angular accelerations alpha [rad/s^2]."""
        alpha = [ZERO]
        for k, joint in enumerate(self.joints):
            gyroscopic = (joint.R.T * omega[k]).cross(joint.angular * self.v[k])
            result = joint.R.T * alpha[k] + gyroscopic + joint.angular * self.a[k]
            alpha.append(self.record.matrix(say.ALPHA, result, k + 1))
        return alpha

    def linear_accelerations(self, omega: Vectors, alpha: Vectors) -> Vectors:
        """Return the accelerations of the frames' origins [m/s^2]."""
        a = [self.base]
        for k, joint in enumerate(self.joints):
            transport = joint.R.T * (a[k] + _rigid_term(alpha[k], omega[k], joint.P))
            coriolis = 2 * omega[k + 1].cross(joint.linear * self.v[k])
            a.append(
                self.record.matrix(say.ACCELERATION, transport + coriolis + joint.linear * self.a[k], k + 1)
            )
        return a

    def inertial_forces(self, omega: Vectors, alpha: Vectors, a: Vectors) -> tuple[Vectors, Vectors]:
        """Return inertial forces F [N], and inertial moments N about the centres of mass [N m]."""
        masses = {k: link for k, link in enumerate(self.record.chain.links, 1) if link}
        F, N = [ZERO] * len(a), [ZERO] * len(a)
        a_c = {
            k: self.record.matrix(say.ACCELERATION_COM, a[k] + _rigid_term(alpha[k], omega[k], link.com), k)
            for k, link in masses.items()
        }
        for k, link in masses.items():
            F[k] = self.record.matrix(say.INERTIAL_FORCE, link.mass * a_c[k], k)
        for k, link in masses.items():
            moment = link.inertia * alpha[k] + omega[k].cross(link.inertia * omega[k])
            N[k] = self.record.matrix(say.INERTIAL_MOMENT, moment, k)
        return F, N

    def forces(self, F: Vectors) -> Vectors:
        """Return f [N]: the force f_k of link k - 1 on link k, and the force f_0 of the ground in frame 0."""
        f = [ZERO, *F[1:]]
        f[-1] = self.record.matrix(say.FORCE, F[-1], len(F) - 1)
        for k in range(len(F) - 2, -1, -1):
            wording = say.FORCE if k else say.SHAKING_FORCE
            f[k] = self.record.matrix(wording, self.joints[k].R * f[k + 1] + F[k], k)
        return f

    def moments(self, F: Vectors, N: Vectors, f: Vectors) -> Vectors:
        """Return n [N m], the moments that belong to `f`, each about the origin of its frame."""
        com = [ZERO, *(link.com if link else ZERO for link in self.record.chain.links)]
        moments = [N[k] + com[k].cross(F[k]) for k in range(len(N))]
        moments[-1] = self.record.matrix(say.MOMENT, moments[-1], len(N) - 1)
        for k in range(len(N) - 2, -1, -1):
            joint, wording = self.joints[k], say.MOMENT if k else say.SHAKING_MOMENT
            next_link = joint.R * moments[k + 1] + joint.P.cross(joint.R * f[k + 1])
            moments[k] = self.record.matrix(wording, moments[k] + next_link, k)
        return moments

    def inputs(self, omega: Vectors, alpha: Vectors, a: Vectors) -> tuple[Expr, ...]:
        """Return the inputs tau [N or N m] for a motion of the frames, in the order of the rows."""
        F, N = self.inertial_forces(omega, alpha, a)
        f = self.forces(F)
        n = self.moments(F, N, f)
        tau = []
        for k, joint in enumerate(self.joints, 1):
            component = joint.linear.dot(f[k]) + joint.angular.dot(n[k])
            tau.append(self.record.scalar(say.INPUT, component, k))
        return tuple(tau)


def _rigid_term(alpha: ImmutableMatrix, omega: ImmutableMatrix, arm: ImmutableMatrix) -> ImmutableMatrix:
    """Return the acceleration of a point at `arm` relative to the frame's origin."""
    return alpha.cross(arm) + omega.cross(omega.cross(arm))


def derive(
    table: DHTable | Sequence[Any],
    links: Sequence[Link | None] | None = None,
    *,
    order: Sequence[str] | None = None,
    gravity: Sequence[Expr | float] | Array = (0, 0, 0),
) -> Derivation:
    """Derive the equations of motion of a chain by the Newton-Euler recursion.

    Parameters
    ----------
    table : DHTable or sequence of rows
        Prismatic or revolute joints in modified-DH form.
    links : sequence of Link or None, one per row, optional
        Link after each joint; None is a virtual link without mass. By default, `Link.general` for all.
    order : sequence of str, optional
        Order of coordinates, inputs, M and n: a permutation of the table's variables. By default, the order
        of the rows.
    gravity : sequence of 3 floats or sympy.Expr, optional
        Acceleration of free fall in frame 0 [m/s^2]; by default, zero, since the ground is level.

    Returns
    -------
    Derivation
        Steps and equations. Up to three joints, they are simplified; for more joints, they use names for
        intermediate results.

    Raises
    ------
    InvalidArgument
        If a length or type is wrong, or two symbols would have the same name.
    UnknownName
        If `order` has a name that is not a variable of the table.

    Warns
    -----
    UserWarning
        If an angle of the table equals a right angle in only about four decimals. The derivation uses the
        right angle.

    See Also
    --------
    derivation.lagrange : the same equations by Lagrange
    derivation.lecture : equations of the lecture's robot
    derivation.Derivation.numeric : the equations as functions of arrays, for checks and for a plant
    derivation.Derivation.written_out : the equations without names of intermediate results

    Examples
    --------
    >>> import sympy
    >>> from pinmobile.derivation import Link, derive
    >>> from pinmobile.dh import DHRow, DHTable, JointType
    >>> m, l, g = sympy.symbols("m l g")
    >>> bob = Link(m, (l, 0, 0), sympy.zeros(3))
    >>> hinge = DHTable([DHRow(0, 0, 0, 0, JointType.REVOLUTE, "q")])
    >>> derive(hinge, [bob], gravity=(0, -g, 0)).inputs[0]  # pendulum
    g*l*m*cos(q) + l**2*m*qddot
    """
    record = Record(Chain(table, links, order, gravity))
    recursion, tau = _record_steps(record)
    return _coefficients(record, tau) if len(recursion.joints) <= SIMPLIFIED_JOINTS else _columns(recursion)


def lecture(table: DHTable = LECTURE_TABLE) -> Derivation:
    """Derive the equations of the lecture's mobile robot: one body behind the joints x, y and psi.

    The body has mass m, its centre of mass at (xbc, ybc, 0) and the yaw inertia Icz (lecture 45, "Dynamic
    model"). The result is cached for each table.

    Parameters
    ----------
    table : DHTable, optional
        Three joints with the variables x, y and psi, in any order.

    Returns
    -------
    Derivation
        Equations with the parameters m [kg], xbc, ybc [m] and Icz [kg m^2].

    Raises
    ------
    InvalidArgument
        If the table has other variables.

    See Also
    --------
    derivation.lagrange : the same equations by Lagrange
    closed_form.mass_matrix : the result as a function
    verify : comparison of all methods

    Examples
    --------
    >>> from pinmobile.derivation import lecture
    >>> lecture().mass_matrix[2, 2]
    Icz + m*(xbc**2 + ybc**2)
    """
    if not isinstance(table, DHTable) or set(table.variables) != {"x", "y", "psi"}:
        raise unexpected_value("table", table, "a DHTable with the variables x, y and psi")
    return _lecture(table)


@lru_cache
def _lecture(table: DHTable) -> Derivation:
    m, xbc, ybc, Icz = sympy.symbols("m xbc ybc Icz")
    body = Link(m, (xbc, ybc, 0), sympy.diag(0, 0, Icz))
    return derive(table, (None, None, body), order=("x", "y", "psi"))


def _coefficients(record: Record, tau: Sequence[Expr]) -> Derivation:
    """Return the derivation with M as in the lecture: the coefficients of the accelerations in the inputs."""
    a = record.chain.a
    zeros = dict.fromkeys(a, sympy.S.Zero)
    return record.derivation(
        [[component.diff(acceleration) for acceleration in a] for component in tau],
        [component.xreplace(zeros) for component in tau],
    )


def _columns(recursion: _Recursion) -> Derivation:
    """Return the derivation with column k of M from the inputs for a unit acceleration of joint k alone.

    The motion is at rest and without gravity. Coefficients would require fully expanded inputs.
    """
    size = range(len(recursion.joints))
    zeros = (sympy.S.Zero,) * len(size)
    units = [tuple(sympy.S(int(i == k)) for i in size) for k in size]

    def inputs(tag: str, **motion: Any) -> tuple[Expr, ...]:
        other = replace(recursion, record=recursion.record.branch(tag), **motion)
        omega = other.angular_velocities()
        alpha = other.angular_accelerations(omega)
        return other.inputs(omega, alpha, other.linear_accelerations(omega, alpha))

    columns = [inputs(f"M{k + 1}", v=zeros, a=unit, base=ZERO) for k, unit in enumerate(units)]
    # this half of M does not contain the joints beyond k
    M = [[columns[max(i, k)][min(i, k)] for k in size] for i in size]
    return recursion.record.derivation(M, inputs("n", a=zeros))


def _record_steps(record: Record) -> tuple[_Recursion, tuple[Expr, ...]]:
    """Record all steps up to the inputs in the lecture's order; return the inputs in the rows' order."""
    chain, links = record.chain, joints(record)
    pose = placements(links, record)[-1]
    for wording, column in ((say.POSITION, 3), (say.NORMAL, 0), (say.SLIDING, 1), (say.APPROACH, 2)):
        record.matrix(wording, pose[:3, column])
    recursion = _Recursion(links, chain.v, chain.a, -chain.gravity, record)

    def rotate_to_base(wording: Wording, vectors: Vectors) -> Vectors:
        record.matrix(wording, pose[:3, :3] * vectors[-1])
        return vectors

    omega = rotate_to_base(say.OMEGA_BASE, recursion.angular_velocities())
    rotate_to_base(say.VELOCITY_BASE, recursion.linear_velocities(omega))
    alpha = rotate_to_base(say.ALPHA_BASE, recursion.angular_accelerations(omega))
    a = rotate_to_base(say.ACCELERATION_BASE, recursion.linear_accelerations(omega, alpha))
    return recursion, recursion.inputs(omega, alpha, a)


def lagrange(derivation: Derivation) -> Derivation:
    """Derive the equations of motion of the same chain by Lagrange's equations.

    Velocities are derivatives of the positions in T_0_k. Angular velocities are entries of the skew-symmetric
    matrix dR/dt R'. The inputs are d/dt (dL/dv) - dL/dq with L = K - V. This derivation uses only the chain
    of the other derivation.

    Parameters
    ----------
    derivation : Derivation
        Derivation with the chain.

    Returns
    -------
    Derivation
        The same equations with other steps.

    See Also
    --------
    derivation.derive : derivation by Newton and Euler
    derivation.difference : comparison of two derivations

    Examples
    --------
    >>> import sympy
    >>> from pinmobile.derivation import Link, derive, lagrange
    >>> from pinmobile.dh import DHRow, DHTable, JointType
    >>> m, l = sympy.symbols("m l")
    >>> bob = Link(m, (l, 0, 0), sympy.zeros(3))
    >>> hinge = DHTable([DHRow(0, 0, 0, 0, JointType.REVOLUTE, "q")])
    >>> lagrange(derive(hinge, [bob]))["K"].expression
    l**2*m*qdot**2/2
    """
    record = Record(derivation.chain)
    chain = record.chain
    time_slope = _Derivative(dict(zip(chain.q, chain.v, strict=True)), "t", record)
    K, V = _energies(record, time_slope)
    slopes = [_Derivative({v: sympy.S.One}, str(v), record) for v in chain.v]
    momenta = [record.scalar(say.MOMENTUM, slope(K), k) for k, slope in enumerate(slopes, 1)]
    M = [[slope(momentum) for slope in slopes] for momentum in momenta]
    n = [
        time_slope(momentum) - _Derivative({q: sympy.S.One}, str(q), record)(K - V)
        for momentum, q in zip(momenta, chain.q, strict=True)
    ]
    for k, (row, effects) in enumerate(zip(M, n, strict=True), 1):
        inertial = sum(m * a for m, a in zip(row, chain.a, strict=True))
        record.scalar(say.LAGRANGE, inertial + effects, k)
    return record.derivation(M, n)


def difference(first: Derivation, second: Derivation) -> ImmutableMatrix:
    """Return the normal form of the difference of the inputs, zero if and only if the equations are the same.

    Parameters
    ----------
    first, second : Derivation
        Derivations with the same coordinates, of up to three joints.

    Returns
    -------
    sympy.ImmutableMatrix, shape (n, 1)
        ``first.inputs - second.inputs`` [N or N m].

    Raises
    ------
    InvalidArgument
        If the coordinates differ, or there are more than three.

    See Also
    --------
    derivation.lagrange : second derivation of a chain
    verify : numerical comparison

    Examples
    --------
    >>> from pinmobile.derivation import derive, difference, lagrange
    >>> from pinmobile.dh import DHRow, DHTable, JointType
    >>> hinge = DHTable([DHRow(0, 0, 0, 0, JointType.REVOLUTE, "q")])
    >>> by_newton = derive(hinge)
    >>> difference(by_newton, lagrange(by_newton))
    Matrix([[0]])
    """
    if first.q != second.q:
        raise InvalidArgument(f"coordinates are {first.q} and {second.q}, expected equal ones")
    if len(first.q) > SIMPLIFIED_JOINTS:
        raise InvalidArgument(
            f"first and second have {len(first.q)} joints, expected at most {SIMPLIFIED_JOINTS}: compare "
            "numeric() of both at random states, or simplify the difference of entries of written_out()"
        )
    return (first.inputs - second.inputs).applyfunc(normal_form)


def _energies(record: Record, time_slope: _Derivative) -> tuple[Expr, Expr]:
    """Return kinetic and potential energy [J]."""
    chain, T = record.chain, placements(joints(record), record)
    kinetic = potential = sympy.S.Zero
    for k, link in enumerate(chain.links, 1):
        if link:
            R = T[k][:3, :3]
            p = record.matrix(say.POSITION_COM, R * link.com + T[k][:3, 3], k)
            v = record.matrix(say.VELOCITY_COM, p.applyfunc(time_slope), k)
            skew = R.applyfunc(time_slope) * R.T
            omega = record.matrix(say.OMEGA_SKEW, ImmutableMatrix([skew[2, 1], skew[0, 2], skew[1, 0]]), k)
            body_v = record.matrix(say.VELOCITY_OWN, R.T * v, k)
            body_omega = record.matrix(say.OMEGA_OWN, R.T * omega, k)
            kinetic += link.mass * body_v.dot(body_v) / 2 + body_omega.dot(link.inertia * body_omega) / 2
            potential -= link.mass * chain.gravity.dot(p)
    return record.scalar(say.KINETIC, kinetic), record.scalar(say.POTENTIAL, potential)


class _Derivative:
    """Directional derivative that includes named intermediate results.

    Parameters
    ----------
    direction : dict of sympy.Symbol to sympy.Expr
        Derivatives of the variables.
    label : str
        Label in the names of derivatives.
    record : Record
        Record with the names of intermediate results.
    """

    def __init__(self, direction: dict[Symbol, Expr], label: str, record: Record) -> None:
        self._slopes, self._label, self._record = direction, label, record

    def __call__(self, expression: Expr) -> Expr:
        slopes = {symbol: self._slope_of(symbol) for symbol in sorted(expression.free_symbols, key=str)}
        return sympy.Add(*(expression.diff(symbol) * slope for symbol, slope in slopes.items() if slope))

    def _slope_of(self, symbol: Symbol) -> Expr:
        if symbol not in self._slopes:
            meaning = self._record.treatment.meanings.get(symbol)
            slope = self(meaning) if meaning is not None else sympy.S.Zero
            self._slopes[symbol] = self._record.short(f"{symbol.name}_d{self._label}", slope)
        return self._slopes[symbol]
