"""Checks of a URDF for errors that its readers ignore, do not explain, or do not survive."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from math import isfinite
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, distinct
from pinmobile.errors import InvalidArgument, argument_errors

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
}  # numeric attributes of elements in links, joints and materials
_COUNTS = {"xyz": 3, "rpy": 3, "size": 3, "scale": 3, "rgba": 4}  # one number for all others
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")

_ROUNDING = 1e-9
_SMALL = 1e-3  # largest negative moment of a link, as a share of its body's smallest moment
_ENDLESS = "1e16"  # [rad, m]: common value in files for no limit

_NAMES = 5  # names in a message


def urdf_model(argument: str, path: Path) -> tuple[pin.Model, Element]:
    """Return the model of a file, and the file's checked tree, from which Pinocchio reads the model.

    Raises
    ------
    InvalidArgument
        If the file does not exist, or is not a URDF. The message names the argument or the file.
    """
    root = urdf_tree(argument, path)
    with argument_errors(f"{path.name} is not a URDF that Pinocchio reads: ", of=(ValueError, RuntimeError)):
        return pin.buildModelFromXML(ElementTree.tostring(root, encoding="unicode")), root


def urdf_tree(argument: str, path: Path) -> Element:
    """Return a file's checked tree.

    Raises
    ------
    InvalidArgument
        As in `urdf_model`, without the checks by Pinocchio.
    """
    unreadable = f"{argument} is {str(path)!r}, which cannot be read: "
    with argument_errors(unreadable, of=(OSError, UnicodeDecodeError)):
        text = path.read_text("utf-8-sig")
    with argument_errors(f"{path.name} is not well-formed XML: ", of=ElementTree.ParseError):
        root = ElementTree.fromstring(text)
    _check_tree(root, path.name)
    _check_numbers(root, path.name)
    _complete_limits(root)
    return root


def _complete_limits(root: Element) -> None:
    """Add missing limits to the tree, with values that mean no limit.

    Pinocchio's parser rejects a revolute or prismatic joint without <limit>, effort or velocity. It would fix
    a joint without lower and upper limits at zero.
    """
    for joint in root.iterfind("joint"):
        limit, ends = joint.find("limit"), joint.get("type") in ("revolute", "prismatic")
        defaults = {"effort": "0", "velocity": "0"}
        if ends:
            limit = ElementTree.SubElement(joint, "limit") if limit is None else limit
            if limit.get("lower") is None and limit.get("upper") is None:
                defaults |= {"lower": f"-{_ENDLESS}", "upper": _ENDLESS}
        for key, value in defaults.items():
            if limit is not None and limit.get(key) is None:
                limit.set(key, value)


def inertia_of(element: Element) -> Array:
    """Return the inertia from an element <inertia>, shape (3, 3) [kg m^2]."""
    xx, xy, xz, yy, yz, zz = (float(element.get(key, "0")) for key in _MOMENTS)
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def judge_links(root: Element, name: str, body_of: Callable[[str], Array], stacklevel: int) -> None:
    """Reject a link with an inertia that no rigid body has; only warn if the inertia hardly matters.

    Parameters
    ----------
    root : xml.etree.ElementTree.Element
        Tree of the file.
    name : str
        Name of the file in messages.
    body_of : callable
        Function that returns the inertia of all links fixed to a link, shape (3, 3) [kg m^2].
    stacklevel : int
        Stack level of the warning.

    Raises
    ------
    InvalidArgument
        If a principal moment of a link is negative by more than a thousandth of the smallest one of its body.
    """
    for link in root.iterfind("link"):
        inertia = link.find("inertial/inertia")
        if inertia is None:
            continue
        moments = np.linalg.eigvalsh(inertia_of(inertia))
        if moments[0] >= -_ROUNDING * np.abs(moments).max():
            continue
        values = ", ".join(f"{moment:.6g}" for moment in moments)
        message = (
            f"{name}: link {link.get('name')!r}: inertia has principal moments ({values}) kg m^2, which no "
            "rigid body has: expected each >= 0"
        )
        if -moments[0] > _SMALL * np.linalg.eigvalsh(body_of(link.get("name", "")))[0]:
            raise InvalidArgument(message)
        warnings.warn(
            f"{message}; the inertia is used nevertheless, since it hardly affects the whole body",
            stacklevel=stacklevel,
        )


def _check_numbers(root: Element, name: str) -> None:
    """Reject invalid numbers in a tree, with the syntax of C++ for valid ones.

    For an invalid number, a reader drops the whole inertia or shape of a link, or rejects the file without a
    reason. Unexpected spaces and line ends have the same effect; this function removes them.
    """
    for part in (part for part in root if part.tag in ("link", "joint", "material")):
        label = f"{name}: {part.tag} {part.get('name')!r} has"
        for inertial in part.iterfind("inertial"):
            for tag in ("mass", "inertia"):
                if inertial.find(tag) is None:
                    raise InvalidArgument(f"{label} an <inertial> without <{tag}>, expected both")
        for element in part.iter():
            is_needed = element.tag in ("mass", "inertia")
            for key in _ATTRIBUTES.get(element.tag, "").split():
                text = element.get(key, "") if is_needed else element.get(key)
                count = _COUNTS.get(key, 1)
                if text is None:
                    continue
                words = text.split()
                finite = all(_NUMBER.fullmatch(word) and isfinite(float(word)) for word in words)
                if len(words) != count or not finite:
                    expected = "a finite number" if count == 1 else f"{count} finite numbers"
                    raise InvalidArgument(f"{label} <{element.tag}> with {key} {text!r}, expected {expected}")
                if element.tag == "mass" and float(text) < 0:
                    raise InvalidArgument(f"{label} mass {text} kg, expected >= 0")
                element.set(key, " ".join(words))


def _check_tree(root: Element, name: str) -> None:
    """Reject a file that is not a tree of links."""
    if root.tag != "robot" or root.find("link") is None:
        raise InvalidArgument(f"{name} is not a URDF: expected a <robot> with links, got <{root.tag}>")
    links = [link.get("name", "") for link in root.iterfind("link")]
    joints = [joint.get("name", "") for joint in root.iterfind("joint")]
    for kind, names in (("link", links), ("joint", joints)):
        distinct(f"{name} has the {kind}", names)
    link_names, parents = set(links), dict[str, str]()
    for joint in root.iterfind("joint"):
        label, of = f"{name}: joint {joint.get('name')!r}", joint.get("type")
        if of not in _JOINTS:
            raise InvalidArgument(f"{label} has type {of!r}, expected one of {', '.join(_JOINTS)}")
        ends = {end: joint.find(end) for end in ("parent", "child")}
        parent, child = (None if node is None else node.get("link") for node in ends.values())
        for end, link_end in zip(ends, (parent, child), strict=True):
            if link_end not in link_names:
                raise InvalidArgument(f"{label} has {end} link {link_end!r}, which is not in the file")
        if child in parents:
            raise InvalidArgument(
                f"{label} has child link {child!r}, which is already a child of {parents[child]!r}, expected "
                "one parent for each link"
            )
        parents[str(child)] = str(parent)
    roots = [link for link in links if link not in parents]
    if len(roots) > 1:
        rest = f" and {len(roots) - _NAMES} more" if len(roots) > _NAMES else ""
        raise InvalidArgument(f"{name} has root links {roots[:_NAMES]}{rest}, expected one root link")
    for link in links:
        node, visited = link, set[str]()
        while node in parents and node not in visited:
            visited.add(node)
            node = parents[node]
        if node in visited:
            raise InvalidArgument(
                f"{name}: link {node!r} is its own ancestor, by way of {parents[node]!r}, expected a tree"
            )
