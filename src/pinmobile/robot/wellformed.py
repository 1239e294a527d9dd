"""What a URDF must have that its readers drop or refuse without a reason."""

import warnings
from collections import Counter
from collections.abc import Callable
from math import isfinite
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument

__all__ = ["MOMENTS", "check_urdf", "complete_limits", "judge_links", "urdf_text"]

_JOINTS = ("fixed", "revolute", "continuous", "prismatic", "planar", "floating")
MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
"""Attributes of an <inertia>."""

_ROUNDING = 1e-9
_SMALL = 1e-3  # of a body's least moment: what one of its links may lack
_ENDLESS = "1e16"  # [rad, m]: what files write that have to give a limit where there is none


def urdf_text(argument: str, path: Path) -> tuple[str, Element]:
    """Return the text of a file and its tree, checked.

    Raises
    ------
    InvalidArgument
        If there is no such file, or it is no URDF; the message names the argument.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidArgument(f"{argument} is {str(path)!r}, which cannot be read: {error}") from None
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InvalidArgument(f"{path.name} is not well-formed XML: {error}") from None
    check_urdf(root, path.name)
    if complete_limits(root):
        text = ElementTree.tostring(root, encoding="unicode")
    return text, root


def complete_limits(root: Element) -> bool:
    """Write into the file the limits that its readers ask for, as none; return whether any were missing.

    A revolute or prismatic joint without <limit>, or one without an effort or a velocity, is refused by
    Pinocchio's parser, and one without lower and upper would be held at zero.
    """
    changed = False
    for joint in root.iterfind("joint"):
        limit, ends = joint.find("limit"), joint.get("type") in ("revolute", "prismatic")
        wanted = {"effort": "0", "velocity": "0"}
        if ends:
            limit = ElementTree.SubElement(joint, "limit") if limit is None else limit
            if limit.get("lower") is None and limit.get("upper") is None:
                wanted |= {"lower": f"-{_ENDLESS}", "upper": _ENDLESS}
        for key, value in wanted.items():
            if limit is not None and limit.get(key) is None:
                limit.set(key, value)
                changed = True
    return changed


def judge_links(root: Element, name: str, body_of: Callable[[str], Array], stacklevel: int) -> None:
    """Refuse a link whose inertia no rigid body has, or name it in a warning where it hardly matters.

    Parameters
    ----------
    root : xml.etree.ElementTree.Element
        The file.
    name : str
        Its name, for the message.
    body_of : callable
        Returns the inertia of all that is fixed together with a link, shape (3, 3) [kg m^2].
    stacklevel : int
        Of the warning: how far up the user's call is.

    Raises
    ------
    InvalidArgument
        If a principal moment of a link is negative by more than a thousandth of the least one of its body.
    """
    for link in root.iterfind("link"):
        inertia = link.find("inertial/inertia")
        if inertia is None:
            continue
        xx, xy, xz, yy, yz, zz = (float(inertia.get(key, "0")) for key in MOMENTS)
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if moments[0] >= -_ROUNDING * np.abs(moments).max():
            continue
        listed = ", ".join(f"{moment:.6g}" for moment in moments)
        said = (
            f"{name}: link {link.get('name')!r}: inertia has principal moments ({listed}) kg m^2, which no "
            "rigid body has: expected each >= 0"
        )
        if -moments[0] > _SMALL * np.linalg.eigvalsh(body_of(link.get("name", "")))[0]:
            raise InvalidArgument(said)
        warnings.warn(
            f"{said}; it is taken all the same, since it hardly matters to the body that it is a part of",
            stacklevel=stacklevel,
        )


def check_urdf(root: Element, name: str) -> None:
    """Refuse a file that is no tree of links, or a link whose mass or inertia is no number.

    Parameters
    ----------
    root : xml.etree.ElementTree.Element
        The file.
    name : str
        Its name, for the message.

    Raises
    ------
    InvalidArgument
        The message names the link or the joint that is wrong.
    """
    if root.tag != "robot" or root.find("link") is None:
        raise InvalidArgument(f"{name} is not a URDF: expected a <robot> with links, got <{root.tag}>")
    links = [link.get("name", "") for link in root.iterfind("link")]
    joints = [joint.get("name", "") for joint in root.iterfind("joint")]
    for kind, names in (("link", links), ("joint", joints)):
        twice = [entry for entry, count in Counter(names).items() if count > 1]
        if twice:
            raise InvalidArgument(f"{name}: {kind} {twice[0]!r} is there twice, expected once")
    for joint in root.iterfind("joint"):
        _check_joint(joint, links, name)
    for link in root.iterfind("link"):
        inertial = link.find("inertial")
        if inertial is not None:
            _check_inertial(inertial, f"{name}: link {link.get('name')!r}")
    children = {joint.find("child").get("link") for joint in root.iterfind("joint")}  # type: ignore[union-attr]
    roots = [link for link in links if link not in children]
    if len(roots) != 1:
        raise InvalidArgument(f"{name} has root links {roots}, expected one that all others hang on")


def _check_joint(joint: Element, links: list[str], name: str) -> None:
    called = f"{name}: joint {joint.get('name')!r}"
    if joint.get("type") not in _JOINTS:
        raise InvalidArgument(
            f"{called} has type {joint.get('type')!r}, expected one of {', '.join(_JOINTS)}"
        )
    for end in ("parent", "child"):
        element = joint.find(end)
        link = None if element is None else element.get("link")
        if link not in links:
            raise InvalidArgument(f"{called} has {end} link {link!r}, which is not in the file")


def _check_inertial(inertial: Element, called: str) -> None:
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is None or inertia is None:
        missing = "mass" if mass is None else "inertia"
        raise InvalidArgument(f"{called} has an <inertial> without <{missing}>, expected both")
    if _number(mass, "value", f"{called} has mass") < 0:
        raise InvalidArgument(f"{called} has mass {mass.get('value')} kg, expected >= 0")
    for key in MOMENTS:
        _number(inertia, key, f"{called} has inertia {key}")


def _number(element: Element, key: str, called: str) -> float:
    text = element.get(key, "")
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not isfinite(value):
        raise InvalidArgument(f"{called} {text!r}, expected a finite number")
    return value
