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
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")  # attributes of an <inertia>

_ATTRIBUTES = {
    "origin": "xyz rpy",
    "axis": "xyz",
    "box": "size",
    "cylinder": "radius length",
    "capsule": "radius length",
    "sphere": "radius",
    "mesh": "scale",
    "color": "rgba",
    "mass": "value",
    "inertia": " ".join(_MOMENTS),
    "limit": "lower upper effort velocity",
    "dynamics": "damping friction",
    "mimic": "multiplier offset",
    "safety_controller": "soft_lower_limit soft_upper_limit k_position k_velocity",
    "calibration": "rising falling",
}  # of elements in links, joints and materials: what is made of numbers
_COUNTS = {"xyz": 3, "rpy": 3, "size": 3, "scale": 3, "rgba": 4}  # and one of all others
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


def inertia_of(element: Element) -> Array:
    """Return what an <inertia> says, shape (3, 3) [kg m^2]."""
    xx, xy, xz, yy, yz, zz = (float(element.get(key, "0")) for key in _MOMENTS)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


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
        moments = np.linalg.eigvalsh(inertia_of(inertia))
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
    """Refuse what should be numbers, spelled as in C++, and is not, in a tree that is one.

    A reader drops what is about it, a link's whole inertia or shape, or refuses the file without a reason;
    so too where there is a space or a line end that it does not expect, of which the numbers are freed.
    """
    for part in (part for part in root if part.tag in ("link", "joint", "material")):
        called = f"{name}: {part.tag} {part.get('name')!r} has"
        for inertial in part.iterfind("inertial"):
            for tag in ("mass", "inertia"):
                if inertial.find(tag) is None:
                    raise InvalidArgument(f"{called} an <inertial> without <{tag}>, expected both")
        for element in part.iter():
            is_needed = element.tag in ("mass", "inertia")
            for key in _ATTRIBUTES.get(element.tag, "").split():
                text = element.get(key, "") if is_needed else element.get(key)
                count = _COUNTS.get(key, 1)
                if text is None:
                    continue
                found = text.split()
                finite = all(_NUMBER.fullmatch(word) and isfinite(float(word)) for word in found)
                if len(found) != count or not finite:
                    expected = "a finite number" if count == 1 else f"{count} finite numbers"
                    raise InvalidArgument(
                        f"{called} <{element.tag}> with {key} {text!r}, expected {expected}"
                    )
                if element.tag == "mass" and float(text) < 0:
                    raise InvalidArgument(f"{called} mass {text} kg, expected >= 0")
                element.set(key, " ".join(found))


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
        called, of = f"{name}: joint {joint.get('name')!r}", joint.get("type")
        if of not in _JOINTS:
            raise InvalidArgument(f"{called} has type {of!r}, expected one of {', '.join(_JOINTS)}")
        ends = {end: joint.find(end) for end in ("parent", "child")}
        parent, child = (None if at is None else at.get("link") for at in ends.values())
        for end, there in zip(ends, (parent, child), strict=True):
            if there not in known:
                raise InvalidArgument(f"{called} has {end} link {there!r}, which is not in the file")
        if child in above:
            raise InvalidArgument(
                f"{called} has child link {child!r}, which hangs on {above[child]!r} already, expected one "
                "parent of each link"
            )
        above[str(child)] = str(parent)
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
