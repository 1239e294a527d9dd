"""Damaged URDFs from seeds: what is read and mounted of them is refused, or a robot with finite numbers.

A process of its own, ``python -m tests.damaged_urdfs FIRST LAST``, since what is looked for may be its end:
it says each seed before it begins, and then what went wrong, if anything did.
"""

import copy
import random
import resource
import sys
import tempfile
import traceback
import warnings
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from example_robot_data import getModelPath

from pinmobile import MobileRobot, PinmobileError
from pinmobile.urdf import shipped_urdf

_UR5 = "ur_description/urdf/ur5_robot.urdf"
_INERTIAL = (
    '<inertial><origin xyz="0.1 0 0.2" rpy="0 0 0.3"/><mass value="2"/>'
    '<inertia ixx="1" ixy="0" ixz="0" iyy="1.2" iyz="0" izz="1.5"/></inertial>'
)
_BASE = f"""<robot name="base">
<link name="base">{_INERTIAL}<visual><origin xyz="0 0 0.1"/><geometry><box size="0.6 0.4 0.2"/></geometry>
<material name="red"><color rgba="1 0 0 1"/></material></visual>
<collision><geometry><cylinder radius="0.2" length="0.3"/></geometry></collision></link>
<link name="wheel">{_INERTIAL}<visual><geometry><sphere radius="0.1"/></geometry></visual></link>
<link name="mast">{_INERTIAL}
<visual><geometry><mesh filename="package://x/y.stl" scale="1 1 1"/></geometry></visual></link>
<joint name="axle" type="continuous"><parent link="base"/><child link="wheel"/>
<origin xyz="0 0.2 0.1" rpy="-1.5708 0 0"/><axis xyz="0 0 1"/><limit effort="3" velocity="4"/></joint>
<joint name="bolt" type="fixed"><parent link="base"/><child link="mast"/><origin xyz="0 0 1"/></joint>
</robot>"""
_ARM = f"""<robot name="arm"><link name="root"/><link name="upper">{_INERTIAL}</link>
<link name="fore">{_INERTIAL}</link>
<joint name="shoulder" type="revolute"><parent link="root"/><child link="upper"/><origin xyz="0 0 0.1"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="9" velocity="1"/>
<dynamics damping="0.1" friction="0.2"/></joint>
<joint name="slide" type="prismatic"><parent link="upper"/><child link="fore"/>
<origin xyz="0 0 0.4" rpy="0.1 0.2 0.3"/><axis xyz="1 0 0"/>
<limit lower="-1" upper="1" effort="9" velocity="1"/>
<mimic joint="shoulder" multiplier="2" offset="0.1"/></joint></robot>"""
_WORDS = (
    *(
        "nan",
        "NaN",
        "inf",
        "-inf",
        "1e308",
        "-1e308",
        "1e-320",
        "1e400",
        "1e17",
        "-0",
        "0",
        "-1",
        "+1",
        "0x10",
    ),
    *(
        "",
        " ",
        "1,5",
        "1 2",
        "1 2 3",
        "1 2 3 4",
        "0 0 0",
        "9" * 400,
        "x" * 5000,
        "word",
        "${m}",
        "\u00e9\u4e2d",
    ),
)
_TAGS = ("link", "joint", "robot", "mass", "origin", "mimic", "limit", "sphere", "mesh", "visual", "parent")
_BOX = MobileRobot.box()
_MEMORY = 6 << 30  # [byte], of addresses: a matrix of a size that a file claims does not fit


def sources() -> list[str]:
    """Return the URDFs that are damaged."""
    ur5 = Path(getModelPath(_UR5)) / _UR5
    shipped = [shipped_urdf(name) for name in ("box", "lecture")]
    return [_BASE, _ARM, *(path.read_text() for path in (*shipped, ur5))]


def damaged(seed: int, texts: list[str]) -> bytes:
    """Return one of the texts with some bytes, or some elements and attributes, not as they were."""
    rng = random.Random(seed)
    text = rng.choice(texts)
    if rng.random() < 0.2:
        return _bytes(rng, bytearray(text.encode()))
    root = ElementTree.fromstring(text)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 6))):
        rng.choice((_value, _value, _value, _swap, _remove, _repeat, _nest, _rename, _chain))(rng, root)
    return ElementTree.tostring(root)


def _bytes(rng: random.Random, data: bytearray) -> bytes:
    for _ in range(rng.choice((1, 1, 2, 8))):
        at = rng.randrange(len(data) + 1)
        match rng.randrange(3):
            case 0:
                data[at : at + 1] = bytes([rng.randrange(256)])
            case 1:
                del data[at : at + rng.choice((1, 10, len(data)))]
            case _:
                data[at:at] = rng.randbytes(4)
    return bytes(data)


def _value(rng: random.Random, root: Element) -> None:
    element, key = _attribute(rng, root)
    words = element.get(key, "").split(" ")
    if rng.random() < 0.1:
        del element.attrib[key]
    elif rng.random() < 0.4:
        words[rng.randrange(len(words))] = rng.choice(_WORDS)
        element.set(key, " ".join(words))
    else:
        element.set(key, rng.choice(_WORDS))


def _swap(rng: random.Random, root: Element) -> None:
    (one, a), (other, b) = _attribute(rng, root), _attribute(rng, root)
    one.attrib[a], other.attrib[b] = other.attrib[b], one.attrib[a]


def _remove(rng: random.Random, root: Element) -> None:
    element, parent = _below(rng, root)
    parent.remove(element)


def _repeat(rng: random.Random, root: Element) -> None:
    element, parent = _below(rng, root)
    for _ in range(rng.choice((1, 2, 50))):
        parent.insert(rng.randrange(len(parent) + 1), copy.deepcopy(element))


def _nest(rng: random.Random, root: Element) -> None:
    element = rng.choice(list(root.iter()))
    rng.choice(list(root.iter())).append(copy.deepcopy(element))


def _rename(rng: random.Random, root: Element) -> None:
    rng.choice(list(root.iter())).tag = rng.choice(_TAGS)


def _chain(rng: random.Random, root: Element) -> None:
    """Hang many links on one, in series or side by side, or the last one's child on the first."""
    count, kind = rng.choice((30, 150, 3000)), rng.choice(("fixed", "continuous", "floating"))
    links = [link.get("name", "") for link in root.iterfind("link")] or ["none"]
    start, wide = rng.choice(links), rng.random() < 0.3
    ends = [start, *(f"new{k}" for k in range(count))]
    for k in range(count):
        root.append(Element("link", name=ends[k + 1]))
        _join(root, f"j{k}", kind, start if wide else ends[k], ends[k + 1])
    if rng.random() < 0.3:
        _join(root, "last", kind, ends[-1], rng.choice(ends))


def _join(root: Element, name: str, kind: str, parent: str, child: str) -> None:
    joint = ElementTree.SubElement(root, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=parent)
    ElementTree.SubElement(joint, "child", link=child)


def _attribute(rng: random.Random, root: Element) -> tuple[Element, str]:
    there = [(element, key) for element in root.iter() for key in element.attrib]
    return rng.choice(there or [(root, root.attrib.setdefault("name", "") or "name")])


def _below(rng: random.Random, root: Element) -> tuple[Element, Element]:
    there = [(element, parent) for parent in root.iter() for element in parent]
    return rng.choice(there) if there else (ElementTree.SubElement(root, "link"), root)


def tried(path: Path) -> None:
    """Read a file as a robot and as an arm, and ask for what hangs on its numbers."""
    for mounted in (False, True):
        try:
            robot = _BOX.mount(path, at=(0, 0, 0.2, 0)) if mounted else MobileRobot.from_urdf(path)
            M = robot.mass_matrix(np.zeros(robot.nq))
            if not np.isfinite(M).all():
                raise AssertionError(f"M is {M.tolist()}")
            _ = robot.visual_model
        except PinmobileError as error:
            if len(str(error)) > 20_000:
                raise AssertionError(f"a message of {len(str(error))} letters") from None


def main(first: int, last: int) -> None:
    """Try the seeds from the first to before the last."""
    warnings.simplefilter("ignore")  # of meshes that are not there
    texts = sources()
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        for seed in range(first, last):
            print(f"seed {seed}", flush=True)
            path.write_bytes(damaged(seed, texts))
            try:
                tried(path)
            except Exception:
                print(traceback.format_exc(), flush=True)
                sys.exit(1)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
