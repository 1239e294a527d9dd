"""Reduced models of drives with ideally rolling wheels, derived step by step from the lecture's body."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Any, NamedTuple

import sympy
from sympy import Expr, Function, ImmutableMatrix, Symbol
from sympy.polys.matrices import DomainMatrix

from pinmobile.arrays import check_integer, distinct, instance, sequence, shaped
from pinmobile.derivation.chain import exact_angle, exact_value, group_terms, reduce_terms
from pinmobile.derivation.equations import lecture
from pinmobile.derivation.steps import Assignments, Step, StepList
from pinmobile.errors import InvalidArgument, format_value

_BODY = _, _, _PSI = sympy.symbols("x y psi")
_TWIST = _VX, _VY, _OMEGA = sympy.symbols("v_x v_y omega")
_DELTA, _DELTA_RATE = sympy.symbols("delta deltadot")
_R, _IW = sympy.symbols("r Iw")

_MAX_ANGLE = 1000  # [rad]: larger angles are not replaced by multiples of 15 degrees
_MASS_TEXT = (
    "The coefficients of nu' in S' (M a + n - B tau), a = S nu' + S_dot nu: constraint forces of rolling "
    "wheels do no work on rolling motions."
)
_EFFECTS_TEXT = "The remaining terms, for nu' = 0 and without torques."
_INPUT_TEXT = "The generalised forces along nu for unit torques."


@dataclass(frozen=True)
class RollerWheel:
    """Fixed wheel with rollers (mecanum or omni), in symbols or numbers.

    Parameters
    ----------
    x, y : sympy.Expr or float
        Position of the wheel in the body frame [m].
    angle : sympy.Expr or float
        Angle of the rolling direction from the body's x axis [rad].
    roller : sympy.Expr or float
        Angle of the axis of the roller at the ground from the rolling direction, within (-pi/2, pi/2) [rad].
    radius, spin_inertia : sympy.Expr or float, optional
        Radius [m] and moment of inertia about the axle [kg m^2]; by default, the symbols r and Iw.

    Raises
    ------
    InvalidArgument
        If a value is neither a finite number nor an expression, or a number is not in its range.

    See Also
    --------
    derivation.roller_drive : equations of motion of such wheels
    WheelTable : wheels of a robot

    Examples
    --------
    >>> from math import pi
    >>> from pinmobile.derivation import RollerWheel
    >>> mecanum = RollerWheel(0.2, 0.15, angle=0, roller=pi / 4)
    >>> mecanum.roller, mecanum.radius
    (pi/4, r)
    """

    x: Expr
    y: Expr
    angle: Expr
    roller: Expr
    radius: Expr = _R
    spin_inertia: Expr = _IW

    def __post_init__(self) -> None:
        for name in ("x", "y", "radius", "spin_inertia"):
            object.__setattr__(self, name, exact_value(name, getattr(self, name)))
        for name in ("angle", "roller"):
            value = exact_value(name, getattr(self, name))
            is_number = value.is_Rational and abs(value) < _MAX_ANGLE
            object.__setattr__(self, name, exact_angle(name, float(value)) if is_number else value)
        if (abs(self.roller) - sympy.pi / 2).is_nonnegative:
            raise InvalidArgument(f"roller is {format_value(self.roller)} rad, expected less than pi/2")

    @classmethod
    def general(cls, k: int) -> RollerWheel:
        """Return wheel `k` with a symbol for each quantity: x1, y1, delta1, gamma1, r1 and Iw1 for k = 1.

        Parameters
        ----------
        k : int
            Index of the wheel, >= 0.
        """
        k = check_integer("k", k, least=0)
        return cls(*sympy.symbols(f"x{k} y{k} delta{k} gamma{k} r{k} Iw{k}"))


@dataclass(frozen=True)
class ReducedDerivation(StepList):
    """Equations M nu' + n = B tau in independent velocities nu, and the steps of their derivation.

    ``derivation["S"]`` is the step with the name S. In the derivation of a car, some quantities of the front
    wheels have names, which later steps use.

    Attributes
    ----------
    steps : tuple of Step
        Steps in their order.
    coordinates : tuple of sympy.Symbol
        Coordinates of body, steering and wheels [m or rad].
    nu : tuple of sympy.Symbol
        Independent velocities [m/s or rad/s].
    mass_matrix : sympy.ImmutableMatrix, shape (m, m)
        Reduced mass matrix S' M S [kg, kg m, kg m^2].
    nonlinear_effects : sympy.ImmutableMatrix, shape (m, 1)
        Reduced nonlinear effects S' (M S_dot nu + n) [N, N m].
    input_matrix : sympy.ImmutableMatrix, shape (m, inputs)
        Reduced input matrix S' B, from torques to generalised forces along nu [1/m, 1].
    assignments : tuple of (sympy.Symbol, sympy.Expr)
        Names of intermediate results, each in terms of earlier ones.

    See Also
    --------
    derivation.differential_drive : two fixed wheels
    derivation.roller_drive : mecanum or omni wheels
    derivation.car : steered wheels

    Examples
    --------
    >>> from pinmobile.derivation import differential_drive
    >>> drive = differential_drive()
    >>> drive.nu, drive.input_matrix[1, :]
    ((v, omega), Matrix([[-b/r, b/r]]))
    """

    steps: tuple[Step, ...] = field(repr=False)
    coordinates: tuple[Symbol, ...]
    nu: tuple[Symbol, ...]
    mass_matrix: ImmutableMatrix = field(repr=False)
    nonlinear_effects: ImmutableMatrix = field(repr=False)
    input_matrix: ImmutableMatrix = field(repr=False)
    assignments: Assignments = field(repr=False)


class _Wheel(NamedTuple):
    """Wheel under the body: name, description and position; `lateral` is None for a wheel with rollers.

    `forward` is the rolling direction and `lateral` the direction without slip, as unit vectors in the body
    frame. `speed` is the ground speed along `forward` for a unit rate of the wheel.
    """

    name: str
    words: str
    position: tuple[Expr, Expr]
    forward: ImmutableMatrix
    lateral: ImmutableMatrix | None
    speed: Expr
    spin_inertia: Expr

    @property
    def angle(self) -> Symbol:
        return Symbol(f"phi_{self.name}")


def differential_drive() -> ReducedDerivation:
    """Derive the equations of two fixed wheels on one axle, nu = (v, omega): speed of its midpoint, yaw rate.

    The axle is at x = l in the body frame and 2 b wide. The result is cached.

    Returns
    -------
    ReducedDerivation
        Equations with the parameters m [kg], xbc, ybc [m], Icz [kg m^2] of the whole robot with locked
        wheels, l, b, r [m] and Iw [kg m^2]. The inputs are the torques of the left and the right wheel [N m].

    See Also
    --------
    closed_form.differential_drive : the same equations as a function
    WheelTable.differential : wheels of this drive

    Examples
    --------
    >>> from pinmobile.derivation import differential_drive
    >>> differential_drive().mass_matrix[0, 0]
    2*Iw/r**2 + m
    """
    return _differential_drive()


@lru_cache
def _differential_drive() -> ReducedDerivation:
    axle, b, speed = sympy.symbols("l b v")
    steps = _Steps(_BODY, {_VX: speed, _OMEGA: _OMEGA})
    return steps.derivation([_tyre(name, words, (axle, side)) for name, words, side in _sides(b)])


def roller_drive(wheels: Sequence[RollerWheel] | None = None) -> ReducedDerivation:
    """Derive the equations of fixed wheels with rollers (mecanum or omni), nu = (v_x, v_y, omega).

    Parameters
    ----------
    wheels : sequence of RollerWheel, optional
        Wheels; by default, four of `RollerWheel.general`.

    Returns
    -------
    ReducedDerivation
        Equations with the parameters m [kg], xbc, ybc [m], Icz [kg m^2] of the whole robot with locked
        wheels, and the symbols of the wheels. The inputs are the torques of the wheels [N m].

    Raises
    ------
    InvalidArgument
        If `wheels` is not a sequence of at least one `RollerWheel`.

    See Also
    --------
    closed_form.roller_drive : the same equations as a function
    WheelTable.mecanum : wheels of such a drive

    Examples
    --------
    >>> from math import pi
    >>> from pinmobile.derivation import RollerWheel, roller_drive
    >>> wheel = RollerWheel(0, 0, angle=0, roller=pi / 4)
    >>> roller_drive([wheel]).input_matrix.T
    Matrix([[1/r, 1/r, 0]])
    """
    given = [RollerWheel.general(k) for k in range(1, 5)] if wheels is None else wheels
    table = shaped("wheels", sequence("wheels", given, "a sequence of RollerWheel"), ("n>=1",))
    for k, row in enumerate(table):
        instance(f"wheels[{k}]", row, RollerWheel, "a RollerWheel")
    symbols = {symbol for row in table for value in vars(row).values() for symbol in value.free_symbols}
    angles = [Symbol(f"phi_{k}") for k in range(1, len(table) + 1)]
    motion = {*_BODY, *angles, *map(_rate, (*_BODY, *angles)), *_TWIST, *lecture().parameters}
    distinct("wheels and motion have the name", [*sorted(map(str, symbols)), *map(str, motion)])
    return _roller_drive(table)


@lru_cache
def _roller_drive(table: tuple[RollerWheel, ...]) -> ReducedDerivation:
    wheels = []
    for k, row in enumerate(table, 1):
        angle, speed = row.angle + row.roller, row.radius * sympy.cos(row.roller)
        axis = ImmutableMatrix([sympy.cos(angle), sympy.sin(angle)])
        wheels.append(_Wheel(str(k), f"wheel {k}", (row.x, row.y), axis, None, speed, row.spin_inertia))
    return _Steps(_BODY, {each: each for each in _TWIST}).derivation(wheels)


def car() -> ReducedDerivation:
    """Derive the equations of a car with four wheels, nu = (v, deltadot): rear speed, steering rate.

    The origin of the body frame is the midpoint of the rear axle. delta is the angle of a virtual wheel at
    the midpoint of the front axle, at x = L. Ackermann's law turns the two front wheels so that all axles
    intersect. The wheels of an axle are 2 b apart and share its torque equally. The result is cached.

    Returns
    -------
    ReducedDerivation
        Equations with the parameters m [kg], xbc, ybc [m], Icz [kg m^2] of the whole robot with locked
        wheels, L, b, r [m], Iw of each wheel about its axle and Iz of each front wheel about the vertical [kg
        m^2]. The inputs are the torques of the rear axle, the front axle and the steering [N m].

    See Also
    --------
    closed_form.car : the same equations as a function
    WheelTable.car : wheels of this drive

    Examples
    --------
    >>> from pinmobile.derivation import car
    >>> car().input_matrix[0, :]
    Matrix([[1/r, (k_fl + k_fr)/(2*r), 0]])
    """
    return _car()


@lru_cache
def _car() -> ReducedDerivation:
    wheelbase, b, Iz, speed = sympy.symbols("L b Iz v")
    steps = _Steps((*_BODY, _DELTA), {_VX: speed, _DELTA_RATE: _DELTA_RATE})
    rear = [_tyre(f"r{side}", f"rear {words}", (sympy.S.Zero, y)) for side, words, y in _sides(b)]
    front = [steps.add_steering(f"f{side}", f"front {words}", (wheelbase, y)) for side, words, y in _sides(b)]
    wheels = [*rear, *(wheel for wheel, _ in front)]
    ratios = [ratio for _, ratio in front]
    M = sympy.zeros(4, 4)
    M[2, 3] = M[3, 2] = Iz * sympy.Add(*ratios)
    M[3, 3] = Iz * sympy.Add(*(ratio**2 for ratio in ratios))
    half = sympy.Rational(1, 2)
    torques = [{wheel.angle: half for wheel in axle} for axle in (wheels[:2], wheels[2:])]
    return steps.derivation(wheels, M, [*torques, {_DELTA: sympy.S.One}])


def _sides(b: Expr) -> tuple[tuple[str, str, Expr], ...]:
    return ("l", "left wheel", b), ("r", "right wheel", -b)


def _tyre(name: str, words: str, position: tuple[Expr, Expr]) -> _Wheel:
    forward, left = ImmutableMatrix([1, 0]), ImmutableMatrix([0, 1])
    return _Wheel(name, words, position, forward, left, _R, _IW)


class _Steps:
    """Recorder of the steps for one drive.

    Parameters
    ----------
    coordinates : tuple of sympy.Symbol
        Coordinates of body and steering.
    velocities : dict of sympy.Symbol to sympy.Symbol
        Independent velocities of body and steering, and their names.
    """

    def __init__(self, coordinates: tuple[Symbol, ...], velocities: dict[Symbol, Symbol]) -> None:
        self._coordinates, self._velocities = coordinates, velocities
        self._steps: list[Step] = []
        self._names: dict[Expr, Expr] = {}
        self._meanings: list[tuple[Symbol, Expr]] = []
        self._lengths: dict[Symbol, Expr] = {}
        c, s, (xdot, ydot, turn) = sympy.cos(_PSI), sympy.sin(_PSI), map(_rate, _BODY)
        self._twist = ImmutableMatrix([c * xdot + s * ydot, c * ydot - s * xdot, turn])
        doc = "(v_x, v_y, omega): the rates of x and y, rotated into the body frame, and the yaw rate."
        self._add("u", "Velocity of the body", doc, "u", self._twist)

    def _add(self, name: str, title: str, doc: str, symbol: str, result: Any) -> Any:
        expression = result.xreplace(self._names)
        self._steps.append(Step(name, title, doc, symbol, expression))
        return expression

    def _add_short(
        self, name: str, title: str, doc: str, symbol: str, result: ImmutableMatrix
    ) -> ImmutableMatrix:
        """Record a result with few terms, grouped by motion, then by mass."""
        short = result.applyfunc(reduce_terms).xreplace(self._names)
        motion = [*self._velocities.values(), *map(_rate, self._coordinates)]
        masses = [each for each in short.free_symbols if re.match(r"m$|I\w", each.name)]
        terms: ImmutableMatrix = short.applyfunc(lambda entry: group_terms(entry, (motion, masses)))
        self._add(name, title, doc, symbol, terms)
        return terms

    def add_steering(self, name: str, words: str, position: tuple[Expr, Expr]) -> tuple[_Wheel, Expr]:
        """Record how Ackermann's law turns a wheel; return the wheel and the ratio of its rate to delta's."""
        (L, y), T = position, sympy.tan(_DELTA)
        direction = ImmutableMatrix([1 - y * T / L, T])
        square, change = direction.dot(direction), direction.diff(_DELTA)
        root = sympy.sqrt(square)
        forward, lateral = direction / root, ImmutableMatrix([-T, direction[0]]) / root
        k, g, slope = (Symbol(f"{letter}_{name}") for letter in ("k", "g", "gprime"))
        ratio = Function(g.name)(_DELTA)
        doc = (
            "Ackermann's law: all axles intersect at L / tan(delta) to the left of the rear midpoint, so the "
            "wheel's direction is (1 - y tan(delta) / L, tan(delta)), a vector of this length."
        )
        length = self._add(k.name, f"Length, {words}", doc, sympy.latex(k), root)
        self._names |= {square: k**2, root: k, 1 / root: 1 / k, T**2 + 1: sympy.cos(_DELTA) ** -2}
        doc = "This vector, scaled to length one."
        self._add(f"e_{name}", f"Direction, {words}", doc, f"e_{{{name}}}", forward)
        cross = sympy.factor(sympy.expand(direction[0] * change[1] - direction[1] * change[0]))
        doc = "The derivative of the wheel's angle by delta: the lateral part of the direction's derivative."
        first = self._add(g.name, f"Steering ratio, {words}", doc, sympy.latex(g), cross / square)
        slope_cross = sympy.factor(sympy.expand(cross.diff(_DELTA) * square - cross * square.diff(_DELTA)))
        title, doc = f"Slope of the steering ratio, {words}", "The derivative of the ratio by delta."
        second = self._add(slope.name, title, doc, sympy.latex(slope), slope_cross / square**2)
        self._names |= {ratio: g, ratio.diff(_DELTA): slope}
        self._meanings += [(k, length), (g, first), (slope, second)]
        self._lengths[k] = square
        return _Wheel(name, words, position, forward, lateral, _R, _IW), ratio

    def derivation(
        self,
        wheels: Sequence[_Wheel],
        steering: sympy.Matrix | None = None,
        torques: Sequence[dict[Symbol, Expr]] | None = None,
    ) -> ReducedDerivation:
        """Record all steps from the velocities at the ground to the reduced model.

        Parameters
        ----------
        wheels : sequence of _Wheel
            Wheels in the order of their coordinates.
        steering : sympy.Matrix, optional
            Contribution of the steering to the mass matrix of body and steering.
        torques : sequence of dict, optional
            Coordinates that each torque drives, with their shares; by default, one torque per wheel.
        """
        q = (*self._coordinates, *(wheel.angle for wheel in wheels))
        rates = ImmutableMatrix([_rate(each) for each in q])
        nu = ImmutableMatrix(list(self._velocities.values()))
        S = self._null_space(self._slips(wheels, rates), rates, nu)
        motion = dict(zip(rates, S * nu, strict=True))

        def time_rate(matrix: ImmutableMatrix) -> ImmutableMatrix:
            slopes = (_slope(matrix, x) * _rate(x) for x in self._coordinates)
            return sum(slopes, sympy.zeros(*matrix.shape))

        M = self._mass_matrix(wheels, steering)
        energy = (rates.T * M * rates)[0] / 2
        n = time_rate(M) * rates - ImmutableMatrix([_slope(energy, x) for x in q])
        doc = "Lagrange: the time derivative of M, times the rates, minus the derivatives of the energy by q."
        self._add_short("n", "Nonlinear effects", doc, r"n(q, \dot{q})", n)
        shares = [{wheel.angle: sympy.S.One} for wheel in wheels] if torques is None else torques
        B = ImmutableMatrix([[share.get(x, 0) for share in shares] for x in q])
        self._add("B", "Input matrix", "The generalised force of each torque.", "B", B)
        S_dot = time_rate(S).xreplace(motion)
        doc = "The time derivative of S along rolling motions."
        self._add("S_dot", "Rate of the null space", doc, r"\dot{S}", S_dot)
        forces = M * S_dot * nu + n.xreplace(motion)
        M_nu = self._add_short("M_nu", "Reduced mass matrix", _MASS_TEXT, "S^T M S", S.T * M * S)
        title, symbol = "Reduced nonlinear effects", r"S^T (M \dot{S} \nu + n)"
        n_nu = self._add_short("n_nu", title, _EFFECTS_TEXT, symbol, S.T * forces)
        B_nu = self._add_short("B_nu", "Reduced input matrix", _INPUT_TEXT, "S^T B", S.T * B)
        return ReducedDerivation(tuple(self._steps), q, tuple(nu), M_nu, n_nu, B_nu, tuple(self._meanings))

    def _slips(self, wheels: Sequence[_Wheel], rates: ImmutableMatrix) -> ImmutableMatrix:
        """Record the velocity of each wheel at the ground; return all in terms of the body's velocity."""
        slips = []
        for wheel in wheels:
            x, y = wheel.position
            centre = ImmutableMatrix([_VX - y * _OMEGA, _VY + x * _OMEGA])
            rows = [wheel.forward.dot(centre) - wheel.speed * _rate(wheel.angle)]
            doc = "Along the axis of the roller at the ground (the roller turns freely about this axis): "
            if wheel.lateral is not None:
                rows.append(wheel.lateral.dot(centre))
                doc = "Along the wheel and across the wheel: "
            doc += "the velocity of the wheel's centre minus the rolling speed. It must vanish."
            title, symbol = f"Velocity at the ground, {wheel.words}", f"s_{{{wheel.name}}}"
            self._add(f"s_{wheel.name}", title, doc, symbol, ImmutableMatrix(rows) if rows[1:] else rows[0])
            slips += rows
        return ImmutableMatrix(slips)

    def _null_space(
        self, slips: ImmutableMatrix, rates: ImmutableMatrix, nu: ImmutableMatrix
    ) -> ImmutableMatrix:
        """Record A and S; elimination with the independent velocities last gives the columns of S."""
        twist = dict(zip(_TWIST, self._twist, strict=True))
        A = slips.xreplace(twist).jacobian(rates)
        doc = "The coefficients of the rates in the velocities at the ground: A times the rates is zero."
        self._add("A", "Constraint matrix", doc, "A(q)", A)
        velocities = [*_TWIST, *rates[3:]]
        independent = list(self._velocities)
        columns = [*(each for each in velocities if each not in independent), *independent]
        rows = slips.xreplace(self._names).jacobian(columns)
        echelon = DomainMatrix.from_Matrix(rows).to_field().rref()[0]
        count = len(columns) - len(independent)
        ratios = -echelon.to_Matrix()[:count, count:]
        for k, square in self._lengths.items():
            ratios = ratios.applyfunc(partial(_shorten, k=k, square=square)).xreplace({k: sympy.sqrt(square)})
        values = dict(zip(columns, [*(ratios * nu), *nu], strict=True))
        c, s = sympy.cos(_PSI), sympy.sin(_PSI)
        vx, vy = values[_VX], values[_VY]
        rolling = [c * vx - s * vy, s * vx + c * vy, *(values[each] for each in velocities[2:])]
        S = ImmutableMatrix([sympy.expand(each, deep=False) for each in rolling]).jacobian(nu)
        names = ", ".join(map(str, nu))
        doc = f"The rates are S nu with nu = ({names}): each column is a rolling motion, A S = 0."
        self._add("S", "Null space", doc, "S(q)", S)
        return S

    def _mass_matrix(self, wheels: Sequence[_Wheel], steering: sympy.Matrix | None) -> ImmutableMatrix:
        body = sympy.zeros(len(self._coordinates))
        body[:3, :3] = lecture().mass_matrix
        doc = (
            "The lecture's mass matrix for the whole robot with locked wheels; a wheel adds its inertia "
            "about the axle; a spinning wheel, a solid of revolution, moves no mass"
        )
        if steering is not None:
            body += steering
            doc += "; a steered wheel adds Iz ((omega + g deltadot)^2 - omega^2) / 2 to the energy"
        M = ImmutableMatrix(sympy.diag(body, *(wheel.spin_inertia for wheel in wheels)))
        self._add("M", "Mass matrix, wheels included", f"{doc}.", "M(q)", M)
        return M


def _rate(coordinate: Symbol) -> Symbol:
    letter, bar, index = coordinate.name.partition("_")
    return Symbol(f"{letter}dot{bar}{index}")


def _slope(expression: Any, x: Symbol) -> Any:
    """Return the derivative; it keeps 1 / cos^2 delta as the derivative of tan(delta)."""
    T, tangent = Function("T")(_DELTA), sympy.tan(_DELTA)
    slope = expression.xreplace({tangent: T}).diff(x)
    return slope.xreplace({T.diff(_DELTA): sympy.cos(_DELTA) ** -2}).xreplace({T: tangent})


def _shorten(entry: Expr, k: Symbol, square: Expr) -> Expr:
    """Return `entry` with k in place of k^2 / k for a written-out k^2, if this is shorter."""
    return min(entry, sympy.cancel(entry * k / square) * k, key=sympy.count_ops)
