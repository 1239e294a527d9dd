"""Every robot that example-robot-data offers: mounted, driven, drawn, or an exception with its reason."""

import warnings
from typing import Any
from unittest import mock
from xml.etree import ElementTree

import example_robot_data
import numpy as np
import pytest

import pinmobile as pm
from pinmobile import verification
from pinmobile.errors import NotTraceable, UnknownName
from pinmobile.robot import BODY_JOINT, EXCEPTIONS, mountable
from pinmobile.robot.visuals import VisualFile
from tests.test_linkage import AT, assert_agrees

NAMES = sorted(example_robot_data.ROBOTS)
REFUSED = [name for name, (mounts, _) in EXCEPTIONS.items() if not mounts]
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


@pytest.mark.parametrize("name", REFUSED)
def test_an_exception_that_works_is_none(name: str) -> None:
    assert name in NAMES
    with pytest.raises(pm.InvalidArgument, match=f"^(arm|.*joint) '{name}"):
        pm.MobileRobot.box().mount(name)


def test_what_an_exception_says_helps() -> None:
    robot = pm.MobileRobot.box().mount("icub", locked=("neck_roll",))
    assert robot.nv + 1 - 3 == robot.mounts[0].arm.whole.nv


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
