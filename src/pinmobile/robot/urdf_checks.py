"""Checks of a URDF that its readers leave out: they drop what is wrong, do not say why, or crash."""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Callable
from math import isfinite
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument

_JOINTS = ("fixed", "revolute", "continuous", "prismatic", "planar", "floating")
MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
"""Attributes of an <inertia>."""

_ORIGIN = {"xyz": 3, "rpy": 3}
_GEOMETRY = {
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
    "mesh": {"scale": 3},
}
# What is made of numbers in a link and in a joint, and of how many.
_NUMBERS: dict[str, dict[str, dict[str, int]]] = {
    "link": {
        "inertial/origin": _ORIGIN,
        **{f"{kind}/origin": _ORIGIN for kind in ("visual", "collision")},
        **{f"{kind}/geometry/{k}": v for kind in ("visual", "collision") for k, v in _GEOMETRY.items()},
        "visual/material/color": {"rgba": 4},
        "inertial/mass": {"value": 1},
        "inertial/inertia": dict.fromkeys(MOMENTS, 1),
    },
    "joint": {
        "origin": _ORIGIN,
        "axis": {"xyz": 3},
        "limit": dict.fromkeys(("lower", "upper", "effort", "velocity"), 1),
        "dynamics": {"damping": 1, "friction": 1},
        "mimic": {"multiplier": 1, "offset": 1},
        "safety_controller": dict.fromkeys(
            ("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity"), 1
        ),
        "calibration": {"rising": 1, "falling": 1},
    },
    "material": {"color": {"rgba": 4}},
}
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")

_ROUNDING = 1e-9
_SMALL = 1e-3  # of a body's least moment: what one of its links may lack
_ENDLESS = "1e16"  # [rad, m]: what files write that have to give a limit where there is none

_SHOWN = 5  # names in a message


def urdf_model(argument: str, path: Path) -> tuple[pin.Model, Element]:
    """Return the model of a file, and the file's tree, checked: what is checked is what Pinocchio is given.

    Raises
    ------
    InvalidArgument
        If there is no such file, or it is no URDF; the message names the argument or the
        file.
    """
    root = urdf_tree(argument, path)
    try:
        return pin.buildModelFromXML(ElementTree.tostring(root, encoding="unicode")), root
    except (ValueError, RuntimeError) as error:
        raise InvalidArgument(f"{path.name} is not a URDF that Pinocchio reads: {error}") from None


def urdf_tree(argument: str, path: Path) -> Element:
    """Return a file's tree, checked.

    Raises
    ------
    InvalidArgument
        As `urdf_model`, but for what Pinocchio refuses.
    """
    try:
        root = ElementTree.fromstring(path.read_text("utf-8-sig"))
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidArgument(f"{argument} is {str(path)!r}, which cannot be read: {error}") from None
    except ElementTree.ParseError as error:
        raise InvalidArgument(f"{path.name} is not well-formed XML: {error}") from None
    _check_tree(root, path.name)
    _check_numbers(root, path.name)
    _complete_limits(root)
    return root


def _complete_limits(root: Element) -> None:
    """Write into the file the limits that its readers ask for, as none.

    A revolute or prismatic joint without <limit>, or one without an effort or a velocity, is refused by
    Pinocchio's parser, and one without lower and upper would be held at zero.
    """
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


def _check_numbers(root: Element, name: str) -> None:
    """Refuse what should be numbers and is not, in a tree that is one.

    A reader drops what is about it, a link's whole inertia or shape, or refuses the file without a reason;
    so too where there is a space or a line end that it does not expect, of which the numbers are freed.

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
    for link in root.iterfind("link"):
        inertial = link.find("inertial")
        if inertial is not None:
            _check_inertial(inertial, f"{name}: link {link.get('name')!r}")
    for part in root:
        for path, counts in _NUMBERS.get(part.tag, {}).items():
            for element in part.iterfind(path):
                for key, count in counts.items():
                    if (text := element.get(key)) is None:
                        continue
                    called = f"{name}: {part.tag} {part.get('name')!r} has <{path}> with {key}"
                    numbers(text, count, called)
                    element.set(key, " ".join(text.split()))


def numbers(text: str, count: int, called: str) -> tuple[float, ...]:
    """Return the numbers of an attribute, spelled as the C++ language has them.

    Parameters
    ----------
    text : str
        The attribute.
    count : int
        How many there are.
    called : str
        What has them, for the message.

    Raises
    ------
    InvalidArgument
        If there are others than that many finite numbers.
    """
    words = text.split()
    found = tuple(map(float, words)) if all(map(_NUMBER.fullmatch, words)) else ()
    if len(found) != count or not all(map(isfinite, found)):
        expected = "a finite number" if count == 1 else f"{count} finite numbers"
        raise InvalidArgument(f"{called} {text!r}, expected {expected}")
    return found


def _check_tree(root: Element, name: str) -> None:
    """Refuse a file that is no tree of links."""
    if root.tag != "robot" or root.find("link") is None:
        raise InvalidArgument(f"{name} is not a URDF: expected a <robot> with links, got <{root.tag}>")
    links = [link.get("name", "") for link in root.iterfind("link")]
    joints = [joint.get("name", "") for joint in root.iterfind("joint")]
    for kind, names in (("link", links), ("joint", joints)):
        twice = [entry for entry, count in Counter(names).items() if count > 1]
        if twice:
            raise InvalidArgument(f"{name}: {kind} {twice[0]!r} is there twice, expected once")
    known, above = set(links), dict[str, str]()
    for joint in root.iterfind("joint"):
        parent, child = _check_joint(joint, known, name)
        if child in above:
            raise InvalidArgument(
                f"{name}: joint {joint.get('name')!r} has child link {child!r}, which hangs on "
                f"{above[child]!r} already, expected one parent of each link"
            )
        above[child] = parent
    roots = [link for link in links if link not in above]
    if len(roots) > 1:
        more = f" and {len(roots) - _SHOWN} more" if len(roots) > _SHOWN else ""
        raise InvalidArgument(
            f"{name} has root links {roots[:_SHOWN]}{more}, expected one that all others hang on"
        )
    for link in links:
        at, seen = link, set[str]()
        while at in above and at not in seen:
            seen.add(at)
            at = above[at]
        if at in seen:
            raise InvalidArgument(
                f"{name}: link {at!r} hangs on itself, by way of {above[at]!r}, expected one root that all "
                "links hang on"
            )


def _check_joint(joint: Element, links: set[str], name: str) -> tuple[str, str]:
    """Return the names of a joint's two links, which have to be there."""
    called = f"{name}: joint {joint.get('name')!r}"
    if joint.get("type") not in _JOINTS:
        raise InvalidArgument(
            f"{called} has type {joint.get('type')!r}, expected one of {', '.join(_JOINTS)}"
        )
    ends = []
    for end in ("parent", "child"):
        element = joint.find(end)
        link = None if element is None else element.get("link")
        if link is None or link not in links:
            raise InvalidArgument(f"{called} has {end} link {link!r}, which is not in the file")
        ends.append(link)
    parent, child = ends
    if parent == child:
        raise InvalidArgument(f"{called} has link {child!r} as its parent and its child, expected two links")
    return parent, child


def _check_inertial(inertial: Element, called: str) -> None:
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    if mass is None or inertia is None:
        missing = "mass" if mass is None else "inertia"
        raise InvalidArgument(f"{called} has an <inertial> without <{missing}>, expected both")
    for element, key, what in (
        (mass, "value", "mass"),
        *((inertia, key, f"inertia {key}") for key in MOMENTS),
    ):
        (value,) = numbers(element.get(key, ""), 1, f"{called} has {what}")
        if element is mass and value < 0:
            raise InvalidArgument(f"{called} has mass {mass.get('value')} kg, expected >= 0")
