"""Modified-DH rows, transforms and tables, and the lecture's two tables of the same robot."""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from enum import Enum
from fractions import Fraction
from math import cos, pi, sin
from typing import Any

import numpy as np

from pinmobile.arrays import (
    Array,
    ArrayLike,
    broadcast,
    distinct,
    finite,
    instance,
    matching,
    one_of,
    scalar,
    sequence,
    vector,
)
from pinmobile.errors import InvalidArgument, PinmobileError, argument_errors, unexpected_value


class JointType(Enum):
    """Type of a joint; its variable adds to d (prismatic) or theta (revolute) of a `DHRow`.

    See Also
    --------
    dh.DHRow : row with such a joint

    Examples
    --------
    >>> from pinmobile.dh import LECTURE_TABLE
    >>> [row.joint.value for row in LECTURE_TABLE]
    ['prismatic', 'prismatic', 'revolute']
    """

    PRISMATIC = "prismatic"
    REVOLUTE = "revolute"


@dataclass(frozen=True)
class DHRow:
    """Row of a modified-DH table (Craig's form), for a joint variable of zero.

    The transform of the row is RotX(alpha) TransX(a) RotZ(theta) TransZ(d), the pose of frame k in frame k -
    1. The joint variable adds to `d` for a prismatic joint and to `theta` for a revolute joint, so every
    joint moves along or about z_k.

    Parameters
    ----------
    alpha : float
        Link twist alpha_{k-1} [rad]. All four numbers may be numbers of sympy, such as ``sympy.pi / 2``, or
        text such as ``"-3*pi/2"``.
    a : float
        Link length a_{k-1} [m].
    theta : float
        Joint angle theta_k without the variable [rad].
    d : float
        Joint offset d_k without the variable [m].
    joint : JointType or str
        Type of the joint, ``"revolute"`` or ``"prismatic"``.
    variable : str
        Name of the joint variable, such as ``"psi"``.

    Raises
    ------
    InvalidArgument
        If a number is not finite, such as text in degrees, or `joint` is not a `JointType`.

    See Also
    --------
    dh.DHTable : chain of such rows
    dh.transform : transform of a row

    Examples
    --------
    >>> from math import pi
    >>> from pinmobile.dh import DHRow, DHTable, JointType
    >>> elbow = DHRow(0, 0.5, 0, 0, JointType.REVOLUTE, "elbow")
    >>> DHTable([elbow]).transforms([pi / 2])[0, :2, :2]
    array([[ 0., -1.],
           [ 1.,  0.]])
    """

    alpha: float
    a: float
    theta: float
    d: float
    joint: JointType
    variable: str

    def __post_init__(self) -> None:
        for name in ("alpha", "a", "theta", "d"):
            value = getattr(self, name)
            if isinstance(value, str):
                value = _parse_number(name, value)
            elif getattr(value, "is_number", False) is True:  # a number of sympy, such as pi / 2
                value = float(value)
            value = scalar(name, value)
            if name in ("alpha", "theta") and abs(value) > _MAX_ANGLE:
                _reject_degrees(name, f"{value:g}", value)
            object.__setattr__(self, name, value)
        if isinstance(self.joint, str):
            kinds = {one.value: one for one in JointType}
            object.__setattr__(self, "joint", kinds[one_of("joint", self.joint, kinds)])
        instance("joint", self.joint, JointType, "a JointType")
        matching("variable", self.variable, r"[^\W\d]\w*", "a name")


_MAX_ANGLE = 2 * pi + 1e-9  # [rad], largest angle of a row
_DEGREES = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+))\s*(deg|degree|degrees|°)\s*")
_OPERATIONS: dict[type, Any] = {
    **{ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv},
    **{ast.USub: operator.neg, ast.UAdd: operator.pos},
}


def _parse_number(name: str, text: str) -> float:
    """Return the number of text such as ``3*pi/2``; text in degrees is refused with the number to type."""
    if match := _DEGREES.fullmatch(text):
        _reject_degrees(name, repr(text), match[1])
    try:
        return float(_evaluate(ast.parse(text.strip(), mode="eval").body))
    except (SyntaxError, ValueError, TypeError, LookupError, ArithmeticError, RecursionError):
        raise unexpected_value(name, text, "a number, such as 'pi/2'") from None


def _reject_degrees(name: str, value: str, degrees: Any) -> None:
    """Raise `InvalidArgument` for an angle in degrees, with the number in rad to type."""
    turns = Fraction(degrees) / 180
    num = {1: "pi", -1: "-pi"}.get(turns.numerator, f"{turns.numerator}*pi")
    fraction = "0" if turns == 0 else num if turns.denominator == 1 else f"{num}/{turns.denominator}"
    number = f"{float(turns) * pi:.10g}"
    exact = f"{fraction}, or {number}" if turns.denominator < 10**4 else number
    raise InvalidArgument(f"{name} is {value}, expected a number in rad, at most 2 pi in size: {exact}")


def _evaluate(node: Any) -> Any:
    """Return the value of numbers, pi and the four operations."""
    if isinstance(node, ast.Name):
        return {"pi": pi}[node.id]
    if isinstance(node, ast.UnaryOp):
        return _OPERATIONS[type(node.op)](_evaluate(node.operand))
    if isinstance(node, ast.BinOp):
        return _OPERATIONS[type(node.op)](_evaluate(node.left), _evaluate(node.right))
    if not isinstance(node, ast.Constant) or type(node.value) not in (int, float):
        raise ValueError
    return node.value


@dataclass(frozen=True)
class DHTable:
    """Serial chain: its DH rows from the ground outwards.

    In this class, q holds the joint variables in the order of the rows. For the lecture's tables, this
    order is (y, x, psi); the rest of the library uses (x, y, psi).

    Parameters
    ----------
    rows : sequence of DHRow, length n >= 1
        Rows with different variable names; a row may also be a mapping or a sequence of its six entries.

    Raises
    ------
    InvalidArgument
        If there is no row, rows are wrong, or two rows have the same variable. The message lists all wrong
        rows.

    See Also
    --------
    dh.LECTURE_TABLE : table of the lecture's script
    derivation.lecture : equations of motion from a table

    Examples
    --------
    >>> from math import pi
    >>> from pinmobile.dh import LECTURE_TABLE
    >>> y, x, psi = 2.0, 1.0, pi / 2
    >>> LECTURE_TABLE.placements([y, x, psi])[-1, :3, 3]  # [m]
    array([1., 2., 0.])
    """

    rows: tuple[DHRow, ...]

    def __post_init__(self) -> None:
        rows, messages = [], []
        for k, row in enumerate(sequence("rows", self.rows, "one DHRow or more", 1)):
            try:
                rows.append(_check_row(row))
            except PinmobileError as error:
                messages.append(f"rows[{k}]: {error}")
        if messages:
            raise InvalidArgument("; ".join(messages), "rows")
        object.__setattr__(self, "rows", tuple(rows))
        distinct("rows have the variable", self.variables)

    def __len__(self) -> int:
        return len(self.rows)

    def __iter__(self) -> Iterator[DHRow]:
        return iter(self.rows)

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of the joint variables, in the order of the rows."""
        return tuple(row.variable for row in self.rows)

    def transforms(self, q: ArrayLike) -> Array:
        """Return the transforms of all rows.

        Parameters
        ----------
        q : array_like, shape (..., n)
            Joint variables in the order of the rows [m or rad].

        Returns
        -------
        ndarray, shape (..., n, 4, 4)
            Transforms T: ``T[..., k - 1, :, :]`` is the pose of frame k in frame k - 1.

        Raises
        ------
        InvalidArgument
            If `q` has another last axis or is not finite.
        """
        q = vector("q", q, len(self))
        local = [
            transform(row.alpha, row.a, row.theta, row.d + q[..., k])
            if row.joint is JointType.PRISMATIC
            else transform(row.alpha, row.a, row.theta + q[..., k], row.d)
            for k, row in enumerate(self.rows)
        ]
        return np.stack(local, axis=-3)

    def placements(self, q: ArrayLike) -> Array:
        """Return the poses of all frames in the ground frame.

        Parameters
        ----------
        q : array_like, shape (..., n)
            Joint variables in the order of the rows [m or rad].

        Returns
        -------
        ndarray, shape (..., n, 4, 4)
            Poses T: ``T[..., k - 1, :, :]`` is T_0_k, the product of the first k transforms.

        Raises
        ------
        InvalidArgument
            If `q` has another last axis or is not finite.
        """
        placements = self.transforms(q)
        for k in range(1, len(self)):
            placements[..., k, :, :] = placements[..., k - 1, :, :] @ placements[..., k, :, :]
        return placements


def _check_row(row: Any) -> DHRow:
    """Return a row of a table from a mapping or a sequence of its entries."""
    names = ", ".join(each.name for each in fields(DHRow))
    try:
        if isinstance(row, Mapping):
            return DHRow(**row)
        row = DHRow(*row) if isinstance(row, Sequence) and not isinstance(row, str) else row
    except TypeError:
        raise unexpected_value("it", row, names) from None
    return instance("it", row, DHRow, f"a DHRow, or {names}")  # type: ignore[no-any-return]


def table_of(table: object) -> DHTable:
    """Return a table, also from a sequence of its rows.

    Parameters
    ----------
    table : DHTable or sequence of rows
        Rows as in `DHTable`.

    Raises
    ------
    InvalidArgument
        If rows are wrong; the message lists all of them.
    """
    if isinstance(table, DHTable):
        return table
    with argument_errors(argument="table"):
        return DHTable(sequence("table", table, "a DHTable, or its rows"))


def transform(alpha: float, a: float, theta: ArrayLike, d: ArrayLike) -> Array:
    """Return the transform RotX(alpha) TransX(a) RotZ(theta) TransZ(d) of a DH row.

    Parameters
    ----------
    alpha, a : float
        Link twist [rad] and link length [m].
    theta, d : array_like, shape (...)
        Joint angle [rad] and joint offset [m]; the shapes broadcast.

    Returns
    -------
    ndarray, shape (..., 4, 4)
        Homogeneous transform (Craig, Introduction to Robotics, 3rd ed. 2005, eq. 3.6).

    Raises
    ------
    InvalidArgument
        If a number is not finite, or the shapes do not broadcast.

    See Also
    --------
    dh.DHTable : transforms of a whole chain

    Examples
    --------
    >>> from math import pi
    >>> from pinmobile.dh import transform
    >>> transform(
    ...     alpha=0, a=1.0, theta=pi / 2, d=0.5)[[0, 2], 3]  # x, z [m]
    array([1. , 0.5])
    """
    theta, d = finite("theta", theta), finite("d", d)
    broadcast(theta=theta[..., None], d=d[..., None])
    theta, d = np.broadcast_arrays(theta, d)
    alpha, a = scalar("alpha", alpha), scalar("a", a)
    c, s, ca, sa = (_round_zeros(value) for value in (np.cos(theta), np.sin(theta), cos(alpha), sin(alpha)))
    T = np.zeros((*theta.shape, 4, 4))
    T[..., 0, 0], T[..., 0, 1], T[..., 0, 3] = c, -s, a
    T[..., 1, 0], T[..., 1, 1], T[..., 1, 2], T[..., 1, 3] = s * ca, c * ca, -sa, -d * sa
    T[..., 2, 0], T[..., 2, 1], T[..., 2, 2], T[..., 2, 3] = s * sa, c * sa, ca, d * ca
    T[..., 3, 3] = 1.0
    return T


def _round_zeros(value: ArrayLike) -> Array:
    """Return the value with rounded zeros, such as cos(pi / 2) = 6e-17, replaced by exact zeros."""
    value = np.asarray(value)
    return np.where(np.abs(value) < _ZERO_TOLERANCE, 0.0, value)


_ZERO_TOLERANCE = 2 * np.finfo(np.float64).eps


def _planar(*angles: tuple[float, float]) -> DHTable:
    joints = (JointType.PRISMATIC, JointType.PRISMATIC, JointType.REVOLUTE)
    return DHTable(
        tuple(
            DHRow(alpha, 0.0, theta, 0.0, joint, name)
            for (alpha, theta), joint, name in zip(angles, joints, ("y", "x", "psi"), strict=True)
        )
    )


LECTURE_TABLE = _planar((3 * pi / 2, 3 * pi / 2), (3 * pi / 2, pi / 2), (pi / 2, pi / 2))
"""DH table of the lecture's script: prismatic y, prismatic x, revolute psi."""

SLIDE_TABLE = _planar((3 * pi / 2, 3 * pi / 2), (3 * pi / 2, 3 * pi / 2), (3 * pi / 2, 3 * pi / 2))
"""DH table of the lecture's slide: the same pose of the body with other intermediate frames."""
