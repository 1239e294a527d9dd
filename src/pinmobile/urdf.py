"""A DH chain and the rigid body that it carries, as URDF text."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from html import escape
from math import atan2, hypot
from pathlib import Path

import numpy as np

from pinmobile.arrays import (
    Array,
    ArrayLike,
    finite,
    frozen,
    instance,
    lengths,
    one_of,
    positive,
    representable,
    text,
)
from pinmobile.dh import DHTable, JointType, transform
from pinmobile.errors import InvalidArgument, shown

_INERTIA_ROUNDING = 1e-9  # files carry eight digits or so: a broken triangle is one broken by more
# Dynamics about B's origin take the yaw inertia from a difference to m |com|^2: six digits of it are left.
_DIGITS = 1e-9


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body in its own frame B.

    Parameters
    ----------
    mass : float
        Mass [kg], above zero.
    com : array_like, shape (3,)
        Centre of mass in B [m].
    inertia : array_like, shape (3, 3)
        Rotational inertia about the centre of mass, along the axes of B [kg m^2].

    Raises
    ------
    InvalidArgument
        If no rigid body has these: a mass or a principal moment that is not positive where it must be,
        or principal moments that break the triangle inequality; or the centre of mass is so far from B's
        origin that the yaw inertia is lost to rounding.
    """

    mass: float
    com: Array
    inertia: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "mass", positive("mass", self.mass, "kg"))
        com, inertia = finite("com", self.com), finite("inertia", self.inertia)
        if com.shape != (3,) or inertia.shape != (3, 3):
            raise InvalidArgument(
                f"com and inertia have shapes {com.shape} and {inertia.shape}, expected (3,) and (3, 3)"
            )
        slack = _INERTIA_ROUNDING * np.abs(inertia).max()
        if np.abs(inertia - inertia.T).max() > slack:
            raise InvalidArgument(f"inertia is not symmetric: {inertia.tolist()}")
        # The moments of a share of it: their sums may be beyond the largest number.
        unit = np.abs(inertia).max() or 1.0
        moments = np.linalg.eigvalsh(inertia / unit)
        slack = _INERTIA_ROUNDING
        if moments[0] < -slack or moments[2] > moments[0] + moments[1] + slack or inertia[2, 2] <= 0:
            listed = ", ".join(f"{unit * moment:.6g}" for moment in moments)
            raise InvalidArgument(
                f"inertia has principal moments ({listed}) kg m^2, which no rigid body has: expected each "
                ">= 0, none above the sum of the other two, and the yaw inertia > 0"
            )
        with np.errstate(over="ignore"):
            squares = self.mass * np.square(com)
        offset = float(squares[:2].sum()) if np.isfinite(squares.sum()) else np.inf
        if inertia[2, 2] < _DIGITS * offset:
            raise InvalidArgument(
                f"com is {com.tolist()} m with mass {self.mass:g} kg, beside which the yaw inertia about it, "
                f"{inertia[2, 2]:g} kg m^2, is lost to rounding: expected it to be {_DIGITS:g} of "
                f"m |com|^2 = {offset:g} kg m^2 at least"
            )
        object.__setattr__(self, "com", frozen(com))
        object.__setattr__(self, "inertia", frozen(inertia / 2 + inertia.T / 2))

    @property
    def yaw_inertia(self) -> float:
        """Inertia about the vertical through the centre of mass [kg m^2]."""
        return float(self.inertia[2, 2])


def box_inertia(mass: float, size: ArrayLike) -> Array:
    """Return the inertia of a homogeneous box about its centre [kg m^2].

    Parameters
    ----------
    mass : float
        Mass [kg].
    size : array_like, shape (3,)
        Length, width and height along x, y and z [m].

    Returns
    -------
    inertia : ndarray, shape (3, 3)
        ``diag(w^2 + h^2, l^2 + h^2, l^2 + w^2) m / 12``.

    Raises
    ------
    InvalidArgument
        If the mass or a length is not positive or not finite, or the inertia beyond the largest number.
    """
    with np.errstate(all="ignore"):
        squares = np.square(lengths(size))
        moments = positive("mass", mass, "kg") / 12 * (squares.sum() - squares)
    return np.diag(representable("the inertia of the box", moments))


def _quoted(text: str) -> str:
    return f'"{escape(text)}"'


def write(
    table: DHTable,
    body: Body,
    *,
    size: ArrayLike,
    name: str = "pinmobile",
    stance: Mapping[str, str] | None = None,
) -> str:
    """Return the chain with the body on its last link as URDF text.

    Every joint frame of the text is the DH frame of its row; the joint moves along or about its z. All
    links but the last are massless.

    Parameters
    ----------
    table : DHTable
        The chain, n rows.
    body : Body
        The body on the last link.
    size : array_like, shape (3,)
        Length, width and height of the box that shows the body [m]; it stands on the plane z = 0.
    name : str
        Name of the robot.
    stance : mapping of str to str, optional
        Attributes of an element <pinmobile>, which other readers pass over: how the body stands where that
        is not on its box.

    Returns
    -------
    text : str
        URDF with links ``ground``, ``virtual_1``, ..., ``base_link`` and one joint per row, named after
        its variable. Numbers are written so that they are read back exactly.

    Raises
    ------
    InvalidArgument
        If an argument is something else.
    """
    instance("table", table, DHTable, "a DHTable")
    instance("body", body, Body, "a pinmobile.urdf.Body")
    links = ["ground", *(f"virtual_{k}" for k in range(1, len(table))), "base_link"]
    lines = ['<?xml version="1.0"?>', f"<robot name={_quoted(text('name', name))}>"]
    lines += [f'  <link name="{link}"/>' for link in links[:-1]]
    lines += _body_lines(links[-1], body, lengths(size))
    for row, parent, child in zip(table, links, links[1:], strict=False):
        # RotZ and TransZ commute, so the variable may come last whichever of the two it belongs to.
        T = transform(row.alpha, row.a, row.theta, row.d)
        lines += [
            f'  <joint name="{row.variable}" type="{_URDF_TYPE[row.joint]}">',
            f'    <parent link="{parent}"/>',
            f'    <child link="{child}"/>',
            f'    <origin xyz="{_text(T[:3, 3])}" rpy="{_text(_roll_pitch_yaw(T[:3, :3]))}"/>',
            '    <axis xyz="0 0 1"/>',
            f'    <limit lower="-{_FAR}" upper="{_FAR}" effort="{_FAR}" velocity="{_FAR}"/>',
            "  </joint>",
        ]
    if stance is not None:
        if not (isinstance(stance, Mapping) and all(map(_is_attribute, stance))):
            raise InvalidArgument(
                f"stance is {shown(stance)}, expected a mapping whose keys are names of XML"
            )
        words = {key: text(f"stance[{key!r}]", value) for key, value in stance.items()}
        attributes = [f"{key}={_quoted(value)}" for key, value in words.items()]
        lines.append(f"  <{' '.join(['pinmobile', *attributes])}/>")
    return "\n".join([*lines, "</robot>", ""])


def _is_attribute(key: object) -> bool:
    return isinstance(key, str) and re.fullmatch(r"[A-Za-z_][\w.-]*", key) is not None


def shipped_urdf(name: str) -> Path:
    """Return the path of a URDF that comes with the package.

    Parameters
    ----------
    name : str
        ``"lecture"`` or ``"box"``: what `MobileRobot.lecture` and `MobileRobot.box` are.

    Raises
    ------
    UnknownName
        If there is no such file; the message lists those there are.
    """
    package = Path(__file__).parent
    # In the wheel the folder is in the package; in a checkout it is at the top.
    homes = (package / "models" / "urdf", package.parents[1] / "models" / "urdf")
    available = {path.stem: path for home in homes for path in sorted(home.glob("*.urdf"))}
    return available[one_of("shipped URDF", name, available)]


# A continuous joint would become Pinocchio's (cos, sin) pair; psi is to stay a plain angle.
_URDF_TYPE = {JointType.PRISMATIC: "prismatic", JointType.REVOLUTE: "revolute"}
_FAR = "1e9"


def _body_lines(link: str, body: Body, size: Array) -> list[str]:
    i = body.inertia
    return [
        f'  <link name="{link}">',
        "    <inertial>",
        f'      <origin xyz="{_text(body.com)}"/>',
        f'      <mass value="{body.mass!r}"/>',
        f'      <inertia ixx="{_number(i[0, 0])}" ixy="{_number(i[0, 1])}" ixz="{_number(i[0, 2])}"'
        f' iyy="{_number(i[1, 1])}" iyz="{_number(i[1, 2])}" izz="{_number(i[2, 2])}"/>',
        "    </inertial>",
        "    <visual>",
        f'      <origin xyz="{_text([0, 0, size[2] / 2])}"/>',
        f'      <geometry><box size="{_text(size)}"/></geometry>',
        '      <material name="body"><color rgba="0.90 0.62 0.00 1"/></material>',
        "    </visual>",
        "  </link>",
    ]


def _number(value: float) -> str:
    return repr(float(value) + 0.0)  # + 0.0 turns -0.0 into 0.0


def _text(values: ArrayLike) -> str:
    return " ".join(_number(value) for value in np.asarray(values, np.float64))


def _roll_pitch_yaw(R: Array) -> tuple[float, float, float]:
    """Return the angles of RotZ(yaw) RotY(pitch) RotX(roll); at a pitch of +-pi/2 the yaw is 0."""
    level = hypot(R[0, 0], R[1, 0])
    pitch = atan2(-R[2, 0], level)
    if level < 1e-12:
        return atan2(-R[1, 2], R[1, 1]), pitch, 0.0
    return atan2(R[2, 1], R[2, 2]), pitch, atan2(R[1, 0], R[0, 0])
