"""Robots on wheels of many tests, their runs, and real bases as small URDFs: the numbers of their files."""

from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

import pinmobile as pm
from pinmobile.wheels import Wheel
from tests.parts import steady

WHEEL: dict[str, Any] = {"mass": 1.0, "spin_inertia": 0.01, "yaw_inertia": 0.006}
BODY = pm.MobileRobot(30.0, 2.3, com=(0.05, 0.02, 0.2))
CENTRAL = pm.MobileRobot(30.0, 2.3, com=(0.0, 0.0, 0.2))
CASTER = Wheel("caster", -0.3, 0.02, 0.05, 0.3, steering="free", trail=(-0.03, 0.005), **WHEEL)
CORNERS = [(0.3, 0.2), (0.3, -0.2), (-0.3, 0.2), (-0.3, -0.2)]
G = float(np.linalg.norm(BODY.model.gravity.linear))


def run(
    robot: Any, u: Any, dt: float, duration: float, q: Any = None, v: Any = None, **more: Any
) -> pm.Rollout:
    """Return a run under constant inputs, by default from rest and on machine code."""
    where = pm.FixedHeading(pm.Hold([0.0, 0.0], duration), 0.0)
    q0, v0 = (robot.rest if q is None else q), (np.zeros(robot.nv) if v is None else v)
    own: dict[str, Any] = {"dt": dt, "q0": q0, "v0": v0, "engine": pm.Engine.COMPILED, "limit": 1e9}
    return pm.simulate(robot, steady(*u), where, **own | more)


def written(folder: Path, text: str, name: str = "base.urdf") -> Path:
    """Write a file into a folder and return its path."""
    path = folder / name
    path.write_text(text)
    return path


HALF_PI = "1.5707963267948966"


def inertial(mass: float, at: str = "0 0 0", rpy: str = "0 0 0", moments: str = "1 0 0 1 0 1") -> str:
    """Return an <inertial>; the moments are ixx ixy ixz iyy iyz izz."""
    named = zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), moments.split(), strict=True)
    words = " ".join(f'{name}="{value}"' for name, value in named)
    return f'<inertial><origin xyz="{at}" rpy="{rpy}"/><mass value="{mass}"/><inertia {words}/></inertial>'


def wheels_moments(xx: str, yy: str, zz: str, products: str = "0 0 0") -> str:
    """Return the <inertia> that `inertial` writes of these; products are ixy ixz iyz."""
    xy, xz, yz = products.split()
    return f'<inertia ixx="{xx}" ixy="{xy}" ixz="{xz}" iyy="{yy}" iyz="{yz}" izz="{zz}"/>'


def shape(kind: str, given: str, at: str = "0 0 0", rpy: str = "0 0 0", tag: str = "collision") -> str:
    """Return a <collision> or a <visual>."""
    return f'<{tag}><origin xyz="{at}" rpy="{rpy}"/><geometry><{kind} {given}/></geometry></{tag}>'


def link(name: str, *parts: str) -> str:
    """Return a link."""
    return f'<link name="{name}">{"".join(parts)}</link>'


def joint(
    name: str,
    kind: str,
    parent: str,
    child: str,
    at: str = "0 0 0",
    rpy: str = "0 0 0",
    axis: str = "0 1 0",
    limit: str = "",
) -> str:
    """Return a joint."""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{at}" rpy="{rpy}"/><axis xyz="{axis}"/>{limit}</joint>'
    )


def robot(*parts: str) -> str:
    """Return a URDF."""
    return f'<robot name="base">{"".join(parts)}</robot>'


def turtlebot(model: str) -> str:
    """Return the URDF of a TurtleBot 3."""
    return _file(f"turtlebot_{model}")


def _file(name: str) -> str:
    """Return a URDF of ours; a comment names the file that has its numbers."""
    return (Path(__file__).parent / "data" / "wheeled" / f"{name}.urdf").read_text()


husky, jackal, ridgeback, dingo, mp400, fetch, pmb2_on_casters = (
    partial(_file, name)
    for name in ("husky", "jackal", "ridgeback", "dingo", "mp400", "fetch", "pmb2_on_casters")
)


def pmb2() -> tuple[str, Path]:
    """Return PMB2, the base of example-robot-data's TIAGo without its torso, and its meshes' folder."""
    from example_robot_data import getModelPath

    inside = Path("tiago_description/robots/tiago_no_hand.urdf")
    folder = Path(getModelPath(str(inside)))
    root = ElementTree.parse(folder / inside).getroot()
    below: dict[str, list[ElementTree.Element]] = {}
    for element in root.findall("joint"):
        below.setdefault(element.find("parent").get("link", ""), []).append(element)  # type: ignore[union-attr]
    waiting = ["torso_fixed_link", "torso_fixed_column_link"]
    gone = set(waiting)
    while waiting:
        for element in below.get(waiting.pop(), []):
            waiting.append(element.find("child").get("link", ""))  # type: ignore[union-attr]
            gone.add(waiting[-1])
    for element in [*root.findall("link"), *root.findall("joint")]:
        child = element.find("child")
        if (element.get("name") if child is None else child.get("link")) in gone:
            root.remove(element)
    return ElementTree.tostring(root, encoding="unicode"), folder.parents[1]
