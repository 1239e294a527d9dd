"""URDF text of a DH chain with a rigid body on its last link."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
    sequence,
    shaped,
    symmetric,
    text,
)
from pinmobile.dh import DHTable, JointType, transform
from pinmobile.errors import InvalidArgument

_INERTIA_TOLERANCE = 1e-9  # tolerance of the triangle inequality: files have about eight digits


@dataclass(frozen=True, eq=False)
class Body:
    """Rigid body in its body frame B.

    Parameters
    ----------
    mass : float
        Mass [kg], > 0.
    com : array_like, shape (3,)
        Centre of mass in B [m].
    inertia : array_like, shape (3, 3)
        Inertia about the centre of mass, along the axes of B [kg m^2].

    Raises
    ------
    InvalidArgument
        If no rigid body has these values: the mass or yaw inertia is not positive, or the principal moments
        are negative or violate the triangle inequality. Also if the centre of mass is so far from the origin
        of B that rounding would lose the yaw inertia.

    See Also
    --------
    urdf.box_inertia : inertia of a homogeneous box
    MobileRobot.from_body : robot with a given body

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> from pinmobile.urdf import Body, box_inertia
    >>> body = Body(30.0, [0, 0, 0.1], box_inertia(30.0, (0.6, 0.4, 0.2)))
    >>> MobileRobot.from_body(body).yaw_inertia  # [kg m^2]
    1.3
    """

    mass: float
    com: Array
    inertia: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "mass", positive("mass", self.mass, "kg"))
        com = shaped("com", finite("com", self.com), (3,))
        inertia = shaped("inertia", finite("inertia", self.inertia), (3, 3))
        tolerance = _INERTIA_TOLERANCE * np.abs(symmetric("inertia", inertia, _INERTIA_TOLERANCE)).max()
        moments = np.linalg.eigvalsh(inertia)
        if moments[0] < -tolerance or moments[2] > moments[0] + moments[1] + tolerance or inertia[2, 2] <= 0:
            texts = ", ".join(f"{moment:.6g}" for moment in moments)
            raise InvalidArgument(
                f"inertia has principal moments ({texts}) kg m^2, which no rigid body has: expected each "
                ">= 0, none above the sum of the other two, and the yaw inertia > 0"
            )
        object.__setattr__(self, "com", frozen(com))
        object.__setattr__(self, "inertia", frozen(inertia / 2 + inertia.T / 2))

    @property
    def yaw_inertia(self) -> float:
        """Moment of inertia about the vertical axis through the centre of mass [kg m^2]."""
        return float(self.inertia[2, 2])


def box_inertia(mass: float, size: ArrayLike) -> Array:
    """Return the inertia of a homogeneous box about its centre.

    Parameters
    ----------
    mass : float
        Mass [kg].
    size : array_like, shape (3,)
        Length, width and height along x, y and z [m].

    Returns
    -------
    ndarray, shape (3, 3)
        Inertia ``diag(w^2 + h^2, l^2 + h^2, l^2 + w^2) m / 12`` [kg m^2].

    Raises
    ------
    InvalidArgument
        If the mass or a length is not positive or not finite.

    See Also
    --------
    MobileRobot.box : robot with this inertia
    urdf.Body : rigid body with an inertia

    Examples
    --------
    >>> from pinmobile.urdf import box_inertia
    >>> box_inertia(mass=30.0, size=(0.6, 0.4, 0.2)).diagonal()
    array([0.5, 1. , 1.3])
    """
    squares = np.square(lengths(size))
    return np.diag(positive("mass", mass, "kg") / 12 * (squares.sum() - squares))


def _quote(text: str) -> str:
    return f'"{escape(text)}"'


def write(
    table: DHTable,
    body: Body,
    *,
    size: ArrayLike,
    name: str = "pinmobile",
    stance: Mapping[str, str] | None = None,
    links: Sequence[Body] = (),
) -> str:
    """Return a chain with bodies on its last links as URDF text.

    Every joint frame of the text is the DH frame of its row. The joint moves along or about its z axis.

    Parameters
    ----------
    table : DHTable
        Chain of n rows.
    body : Body
        Body on ``base_link``, the last link without `links`.
    size : array_like, shape (3,)
        Length, width and height of the drawn box [m], which stands on the plane z = 0.
    name : str
        Name of the robot.
    stance : mapping of str to str, optional
        Attributes of the element <pinmobile> with the contact geometry, for a body that does not stand on its
        box. Other programs ignore this element.
    links : sequence of Body
        Bodies on the links after ``base_link``, those of an arm.

    Returns
    -------
    str
        URDF with links ``ground``, ``virtual_1``, ..., ``base_link`` and one joint per row with the name of
        its variable. Numbers have all digits.

    Raises
    ------
    InvalidArgument
        If an argument is not what is expected.

    See Also
    --------
    MobileRobot.to_urdf : text of a robot
    dh.DHTable : chain of joints

    Examples
    --------
    >>> from pinmobile.dh import LECTURE_TABLE
    >>> from pinmobile.urdf import Body, box_inertia, write
    >>> size = (0.6, 0.4, 0.2)
    >>> body = Body(30.0, [0, 0, 0.1], box_inertia(30.0, size))
    >>> write(LECTURE_TABLE, body, size=size).count("<joint")
    3
    """
    instance("table", table, DHTable, "a DHTable")
    instance("body", body, Body, "a pinmobile.urdf.Body")
    bodies = [body, *(instance("links", one, Body, "bodies") for one in sequence("links", links, "bodies"))]
    if len(bodies) > len(table):
        raise InvalidArgument(f"links has {len(links)} bodies, expected fewer than the {len(table)} rows")
    arms = [f"{variable}_link" for variable in table.variables[len(table) - len(bodies) + 1 :]]
    names = ["ground", *(f"virtual_{k}" for k in range(1, len(table) - len(arms))), "base_link", *arms]
    lines = ['<?xml version="1.0"?>', f"<robot name={_quote(text('name', name))}>"]
    lines += [f'  <link name="{link}"/>' for link in names[: -len(bodies)]]
    for link, one in zip(names[-len(bodies) :], bodies, strict=True):
        lines += _body_lines(link, one, lengths(size) if one is body else None)
    for row, parent, child in zip(table, names, names[1:], strict=False):
        # RotZ and TransZ commute, so the variable of either may come last.
        T = transform(row.alpha, row.a, row.theta, row.d)
        lines += [
            f'  <joint name="{row.variable}" type="{_URDF_TYPE[row.joint]}">',
            f'    <parent link="{parent}"/>',
            f'    <child link="{child}"/>',
            f'    <origin xyz="{_format(T[:3, 3])}" rpy="{_format(_roll_pitch_yaw(T[:3, :3]))}"/>',
            '    <axis xyz="0 0 1"/>',
            f'    <limit lower="-{_LIMIT}" upper="{_LIMIT}" effort="{_LIMIT}" velocity="{_LIMIT}"/>',
            "  </joint>",
        ]
    if stance is not None:
        attributes = [f"{key}={_quote(value)}" for key, value in stance.items()]
        lines.append(f"  <{' '.join(['pinmobile', *attributes])}/>")
    return "\n".join([*lines, "</robot>", ""])


def shipped_urdf(name: str) -> Path:
    """Return the path of a URDF of this package.

    Parameters
    ----------
    name : str
        ``"lecture"`` or ``"box"``, the robots of `MobileRobot.lecture` and `MobileRobot.box`.

    Returns
    -------
    pathlib.Path
        Path of the file.

    Raises
    ------
    UnknownName
        If the package has no such file. The message lists the available names.

    See Also
    --------
    MobileRobot.from_urdf : robot of a file

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> from pinmobile.urdf import shipped_urdf
    >>> MobileRobot.from_urdf(shipped_urdf("lecture")).mass  # [kg]
    30.0
    """
    package = Path(__file__).parent
    # The folder is in the package in a wheel, and at the top in a checkout.
    folders = (package / "models" / "urdf", package.parents[1] / "models" / "urdf")
    available = {path.stem: path for home in folders for path in sorted(home.glob("*.urdf"))}
    return available[one_of("shipped URDF", name, available)]


# Pinocchio would represent a continuous joint by (cos, sin); psi must stay one angle.
_URDF_TYPE = {JointType.PRISMATIC: "prismatic", JointType.REVOLUTE: "revolute"}
_LIMIT = "1e9"


def _body_lines(link: str, body: Body, size: Array | None) -> list[str]:
    i = body.inertia
    box: list[str] = []
    if size is not None:
        box = [
            "    <visual>",
            f'      <origin xyz="{_format([0, 0, size[2] / 2])}"/>',
            f'      <geometry><box size="{_format(size)}"/></geometry>',
            '      <material name="body"><color rgba="0.90 0.62 0.00 1"/></material>',
            "    </visual>",
        ]
    return [
        f'  <link name="{link}">',
        "    <inertial>",
        f'      <origin xyz="{_format(body.com)}"/>',
        f'      <mass value="{body.mass!r}"/>',
        f'      <inertia ixx="{_digits(i[0, 0])}" ixy="{_digits(i[0, 1])}" ixz="{_digits(i[0, 2])}"'
        f' iyy="{_digits(i[1, 1])}" iyz="{_digits(i[1, 2])}" izz="{_digits(i[2, 2])}"/>',
        "    </inertial>",
        *box,
        "  </link>",
    ]


def _digits(value: float) -> str:
    return repr(float(value) + 0.0)  # + 0.0 turns -0.0 into 0.0


def _format(values: ArrayLike) -> str:
    return " ".join(_digits(value) for value in np.asarray(values, np.float64))


def _roll_pitch_yaw(R: Array) -> tuple[float, float, float]:
    """Return the angles of RotZ(yaw) RotY(pitch) RotX(roll); for a pitch of +-pi/2, the yaw is 0."""
    cosine = hypot(R[0, 0], R[1, 0])
    pitch = atan2(-R[2, 0], cosine)
    if cosine < 1e-12:
        return atan2(-R[1, 2], R[1, 1]), pitch, 0.0
    return atan2(R[2, 1], R[2, 2]), pitch, atan2(R[1, 0], R[0, 0])
