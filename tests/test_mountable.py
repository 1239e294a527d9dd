"""Every robot that example-robot-data offers: mounted, driven, drawn, or an exception with its reason."""

import warnings
from typing import Any
from unittest import mock
from xml.etree import ElementTree

import example_robot_data
import numpy as np
import pinocchio as pin
import pytest
import umsgpack

import pinmobile as pm
from pinmobile import verification
from pinmobile.arrays import Array
from pinmobile.errors import NotTraceable, UnknownName
from pinmobile.robot import BODY_JOINT, EXCEPTIONS, mountable
from pinmobile.robot.visuals import VisualFile
from pinmobile.viewer import Viewer
from tests.test_linkage import AT, assert_agrees

NAMES = sorted(example_robot_data.ROBOTS)
REFUSED = [name for name, (mounts, _) in EXCEPTIONS.items() if not mounts]
MASSLESS = tuple(
    f"{side}{part}"
    for side in "LR"
    for part in (
        "Hand",
        *(f"{finger}{k}" for finger in ("Finger1", "Finger2", "Finger3", "Thumb") for k in (1, 2, 3)),
    )
    if part != "Finger11"
)
READABLE = VisualFile.tree


class Drive:
    """The base drives a sine along x and turns, the arm holds its rest."""

    duration = 1.0

    def __init__(self, robot: pm.MobileRobot) -> None:
        self.robot = robot

    def __call__(self, t: Any) -> pm.Reference:
        q = np.tile(self.robot.rest, (*np.shape(t), 1))
        v, a = np.zeros((2, *np.shape(t), self.robot.nv))
        q[..., 0], v[..., 0], a[..., 0] = np.sin(t), np.cos(t), -np.sin(t)
        q[..., 2], v[..., 2] = 0.4 * t, 0.4
        return pm.Reference(q, v, a)


def boxes(file: VisualFile) -> ElementTree.Element:
    """Return the file with a box for each mesh that was found: to read them takes half a minute."""
    root = READABLE(file)
    for geometry in root.iterfind("link/visual/geometry"):
        mesh = geometry.find("mesh")
        if mesh is not None and "missing" not in mesh.attrib:
            geometry[:] = [ElementTree.Element("box", size="0.1 0.1 0.1")]
    return root


def sent(robot: pm.MobileRobot, q: Array) -> dict[str, Array]:
    """Return where the viewer puts each object, shape (4, 4), as what it sends to a browser says."""
    objects, poses = set(), {}
    with Viewer(robot) as viewer:
        viewer.display(q)
        commands = [umsgpack.unpackb(command) for command in viewer._window.commands()]
    for command in commands:
        path, kind = command["path"].lstrip("/"), command["type"]
        if kind == "set_object":
            objects.add(path)
        elif kind == "set_transform":
            poses[path] = np.reshape(command["matrix"], (4, 4)).T
        elif command["property"] == "position":
            poses.setdefault(path, np.eye(4))[:3, 3] = command["value"]
        elif command["property"] == "quaternion":
            poses.setdefault(path, np.eye(4))[:3, :3] = pin.Quaternion(np.array(command["value"])).matrix()
    home = "meshcat/robot0/visuals/"
    return {
        path.removeprefix(home): poses["meshcat/robot0"] @ poses[path]
        for path in objects
        if path.startswith(home)
    }


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in NAMES if name not in REFUSED][::3])
def test_each_mounts_drives_and_draws(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = pm.MobileRobot.box().mount(name, AT)
    assert robot.nv > 3 or name in ("hector", "iris")  # a quadrotor without an arm is a load
    assert robot.model.nq == robot.nq == robot.nv  # each joint has one number
    assert all(joint.startswith(f"{name}/") for joint in list(robot.model.names)[BODY_JOINT + 1 :])
    # Building machine code of all takes minutes; test_linkage has it of some.
    refused = mock.Mock(side_effect=NotTraceable("not", "asked for"))
    monkeypatch.setattr(verification, "compiled_dynamics", refused)
    assert pm.verify(robot, states=2).passed
    if robot.nv > 3:
        assert_agrees(robot)
    rollout = pm.simulate(robot, pm.ComputedTorque(robot, 100, 20), Drive(robot), dt=0.02)
    # The step is exact where the acceleration is constant: what is left is its change, h^3 / 6, per step,
    # damped with 1 / kd, some 1e-6 m; the arm has nothing to do but to hold.
    assert rollout.max_error()[:3].max() < 1e-4
    assert rollout.max_error()[3:].max(initial=0) < 1e-9
    monkeypatch.setattr(VisualFile, "tree", boxes)
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # of meshes that are missing
        visual = robot.visual_model
    items = visual.geometryObjects
    shown = [item for item in items if item.name.startswith(f"{name}/")]
    assert (len(shown) == 0) == (name in EXCEPTIONS)  # what mounts, and is in the table, has no visuals
    assert {item.parentJoint for item in shown} <= set(range(BODY_JOINT, robot.model.njoints))
    q = robot.random_configuration(np.random.default_rng(1))
    there, T = sent(robot, q), robot.frame_placements(q)
    assert {*there} == {item.name for item in items}
    for item in items:
        # A sum of a few metres, some dozen roundings.
        placement = T[item.parentJoint - 1] @ item.placement.homogeneous
        np.testing.assert_allclose(there[item.name], placement, atol=1e-12)


@pytest.mark.parametrize("name", REFUSED)
def test_an_exception_that_works_is_none(name: str) -> None:
    assert name in NAMES
    with pytest.raises(pm.InvalidArgument, match=f"^(arm|.*joint) '{name}"):
        pm.MobileRobot.box().mount(name)


@pytest.mark.parametrize(
    ("name", "locked"),
    [
        ("icub", ("neck_roll",)),
        ("romeo", MASSLESS),
    ],
)
def test_what_exceptions_say_helps_helps(name: str, locked: tuple[str, ...]) -> None:
    robot = pm.MobileRobot.box().mount(name, locked=locked)
    assert robot.nv + len(locked) - 3 == robot.mounts[0].arm.whole.nv


def test_what_is_wrong_with_icub_and_romeo_is_said() -> None:
    text = r"^the mass matrix is singular at rest about joint 'icub/neck_roll': if the joints"
    with pytest.raises(pm.InvalidArgument, match=text):
        pm.MobileRobot.box().mount("icub")
    fingers = [name for name in MASSLESS if "Hand" not in name]
    with pytest.raises(
        pm.InvalidArgument, match="joint 'romeo/RHand' moves parts that have no inertia, expected inertia"
    ):
        pm.MobileRobot.box().mount("romeo", locked=fingers)
    assert len(MASSLESS) == int(EXCEPTIONS["romeo"].reason.split()[0])


def test_a_row_is_found_by_its_name() -> None:
    listed = mountable()
    assert listed["ur5"].joints == 6
    assert "ur5" in listed
    assert "icub" not in listed
    assert listed["ur5"].note == ""
    assert listed["simple_humanoid"].note == EXCEPTIONS["simple_humanoid"].reason
    with pytest.raises(UnknownName, match=r"^unknown mountable robot 'ur55', did you mean 'ur5'"):
        listed["ur55"]


def test_the_list_is_a_table_of_all_of_them() -> None:
    listed = mountable()
    assert {*listed, *REFUSED} == set(NAMES)
    assert len(listed) == len(NAMES) - len(REFUSED) == 66
    panda = listed["panda"]
    assert (panda.joints, round(panda.mass, 3)) == (9, 17.452)
    lines = str(listed).splitlines()
    assert len(lines) == 1 + len(NAMES)
    assert lines[0].split() == ["name", "joints", "mass", "[kg]"]
    assert any(line.startswith("cassie") and "not: its loader reads SDF" in line for line in lines)
    assert mountable() is listed  # it is read once


def test_wheels_are_locked() -> None:
    (mount,) = pm.MobileRobot.box().mount("tiago").mounts
    names = {str(joint) for joint in mount.model.names}
    assert not any("wheel" in joint or "caster" in joint for joint in names)
    assert any("wheel" in str(joint) for joint in mount.arm.whole.names)
