"""What `mount` takes, makes of it and refuses; and each robot that example-robot-data offers."""

import pickle
import warnings
from pathlib import Path
from typing import Any
from unittest import mock
from xml.etree import ElementTree

import example_robot_data
import numpy as np
import pinocchio as pin
import pytest

import pinmobile as pm
from pinmobile import verification
from pinmobile.errors import NotTraceable
from pinmobile.plant import PlantDescription
from pinmobile.robot import BODY_JOINT, EXCEPTIONS, mountable
from pinmobile.robot.visuals import VisualFile
from tests.refusals import begun, refusals, unknown
from tests.test_linkage import AT, assert_agrees

BOX = pm.MobileRobot.box()

ARM = """<robot name="two links">
  <link name="foot"><inertial><mass value="2"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><box size="0.1 0.1 0.1"/></geometry></visual></link>
  <link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="1"/>
    <inertia ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://arms/upper.stl"/></geometry></visual></link>
  <link name="lower">{lower}</link>
  <joint name="shoulder" type="continuous"><parent link="foot"/><child link="upper"/><axis xyz="0 0 1"/>
    <limit effort="30" velocity="2"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 0.4"/>
    <axis xyz="0 1 0"/><limit lower="-2" upper="1.5" effort="20" velocity="3"/></joint>
</robot>"""
INERTIAL = """<inertial><origin xyz="0 0 0.1"/><mass value="0.5"/>
  <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>"""


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    path = tmp_path / "arm.urdf"
    path.write_text(ARM.format(lower=INERTIAL))
    return path


def link(model: pin.Model, joint: int, mass: float = 1.0) -> None:
    body = pin.Inertia(mass, np.array([0.1, 0, 0.2]), mass * np.diag([0.02, 0.02, 0.02]))
    model.appendBodyToJoint(joint, body, pin.SE3.Identity())


def chain(*joints: Any) -> pin.Model:
    """Return joints in series, each with a link."""
    model, parent = pin.Model(), 0
    for number, joint in enumerate(joints):
        parent = model.addJoint(parent, joint, pin.SE3(np.eye(3), np.array([0, 0, 0.2])), f"j{number}")
        model.addJointFrame(parent)
        link(model, parent)
    return model


def test_a_urdf_is_mounted_and_a_mesh_that_is_missing_is_named(urdf: Path) -> None:
    robot = BOX.mount(urdf, (0, 0, 0.2, 0))
    assert (robot.nq, robot.nv) == (5, 5)
    assert robot.mounts[0].name == "arm"
    assert list(robot.model.names)[4:] == ["arm/shoulder", "arm/elbow"]
    np.testing.assert_array_equal(robot.lower[3:], [-np.inf, -2])
    np.testing.assert_array_equal(robot.effort_limit[3:], [30, 20])
    with pytest.warns(UserWarning, match=r"arm\.urdf: not drawn, since missing: package://arms/upper\.stl$"):
        shown = robot.visual_model.geometryObjects
    assert [item.name for item in shown] == ["body", "front", "wedge", "arm/foot_0"]
    foot = shown[3]
    assert foot.parentJoint == BODY_JOINT
    assert foot.placement.translation[2] == pytest.approx(0.2)


def test_a_mesh_is_found_in_a_package(urdf: Path, tmp_path: Path) -> None:
    (tmp_path / "packages" / "arms").mkdir(parents=True)
    facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
    (tmp_path / "packages" / "arms" / "upper.stl").write_text(f"solid s\n{facet}endsolid s\n")
    home = tmp_path / "packages"
    robot = BOX.mount(str(urdf), package_dirs=[home])
    item = robot.visual_model.geometryObjects[-1]
    assert (item.name, item.parentJoint) == ("arm/upper_0", BODY_JOINT + 1)


@pytest.mark.parametrize("roots", [(pin.JointModelFreeFlyer(),), (pin.JointModelPlanar(),)])
def test_a_root_of_its_own_is_replaced_by_the_chain(roots: tuple[Any, ...]) -> None:
    hinges = pin.JointModelRY(), pin.JointModelRX()
    model = chain(*roots, *hinges)
    robot = BOX.mount(model, (0.1, 0, 0.3, 0))
    assert (robot.nq, robot.nv) == (5, 5)
    assert robot == BOX.mount(
        model, (0.1, 0, 0.3, 0), rest=pin.integrate(model, pin.neutral(model), np.eye(model.nv)[0])
    )
    # The root's link rides on the body: it counts.
    assert robot.mass_matrix(robot.rest)[0, 0] == pytest.approx(BOX.mass + 3)


def test_feet_stand_on_the_box_and_what_would_hang_below_the_ground_is_raised() -> None:
    robot = BOX.mount("anymal")
    assert robot.mounts[0].at[2] > 0.6
    assert _lowest(robot, "anymal") == pytest.approx(BOX.size[2])
    assert BOX.mount("anymal", (0, 0, 0.2, 0)).mounts[0].at == (0, 0, 0.2, 0)
    assert _lowest(BOX.mount("talos_arm", (0, 0, BOX.size[2], 0)), "talos_arm") < 0
    assert _lowest(BOX.mount("talos_arm"), "talos_arm") == pytest.approx(BOX.size[2])


def _lowest(robot: pm.MobileRobot, name: str) -> float:
    frames = [frame for frame in robot.frame_names if frame.startswith(f"{name}/")]
    return min(float(robot.frame_pose(robot.rest, frame)[2, 3]) for frame in frames)


def test_joints_are_locked_where_links_and_joints_share_a_name() -> None:
    name = "so100"
    free = BOX.mount(name)
    joint = str(free.mounts[0].model.names[1])
    held = BOX.mount(name, locked=[joint])
    assert held.nv == free.nv - 1
    assert set(held.frame_names) <= {*free.frame_names}
    np.testing.assert_allclose(held.gravity(held.rest)[3:], free.gravity(free.rest)[4:], atol=1e-9)


def test_two_arms_do_not_stand_in_the_same_place_unless_they_are_told_to() -> None:
    one = BOX.mount("ur5")
    with pytest.raises(pm.InvalidArgument, match=r"^at is not given for 'z1', and 'ur5' is already in the"):
        one.mount("z1")
    assert one.mount("z1", (0, 0, 0.2, 0)).mounts[1].at == one.mounts[0].at
    assert BOX.mount("ur5", (0.2, 0, 0.2, 0)).mount("z1").mounts[1].at == (0, 0, 0.2, 0)


def test_equal_limits_and_limits_of_zero_are_none(urdf: Path) -> None:
    urdf.write_text(
        ARM.format(lower=INERTIAL).replace(
            'lower="-2" upper="1.5" effort="20" velocity="3"', 'lower="0" upper="0" effort="0" velocity="0"'
        )
    )
    robot = BOX.mount(urdf)
    limits = robot.lower[-1], robot.upper[-1], robot.velocity_limit[-1], robot.effort_limit[-1]
    assert limits == (-np.inf, np.inf, np.inf, np.inf)


def test_a_joint_that_mimics_another_in_a_file_moves_freely(urdf: Path) -> None:
    mimic = '<mimic joint="shoulder"/><axis xyz="0 1 0"/>'
    urdf.write_text(ARM.format(lower=INERTIAL).replace('<axis xyz="0 1 0"/>', mimic))
    assert [one.name for one in BOX.mount(urdf).coordinates[3:]] == ["arm/shoulder", "arm/elbow"]


def test_a_model_with_a_free_flyer_stands_on_its_feet_and_an_arm_on_its_root() -> None:
    hanging = pin.Model()
    root = hanging.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    link(hanging, root)
    leg = hanging.addJoint(root, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0, 0, -0.3])), "leg")
    link(hanging, leg)
    assert BOX.mount(hanging).mounts[0].at == pytest.approx((0, 0, 0.5, 0))
    for name in ("ur5", "panda", "kinova"):
        assert BOX.mount(name).mounts[0].at == (0, 0, 0.2, 0)


def test_a_model_with_its_geometry_and_a_wrapper_of_one_are_mounted() -> None:
    wrapper = example_robot_data.load("double_pendulum_continuous")
    robot = BOX.mount(wrapper, name="pendulum")
    assert robot.nv == 5  # a chain of continuous joints is no wheel
    assert sum(item.name.startswith("pendulum/") for item in robot.visual_model.geometryObjects) == 3
    bare = BOX.mount(wrapper.model)
    assert len(bare.visual_model.geometryObjects) == 3
    shown = BOX.mount(wrapper.model, visual=wrapper.visual_model)
    assert len(shown.visual_model.geometryObjects) == 6
    assert (
        BOX.mount("double_pendulum_continuous").mass_matrix(robot.rest).tolist()
        == robot.mass_matrix(robot.rest).tolist()
    )


def massful() -> pin.Model:
    return chain(pin.JointModelRY(), pin.JointModelRX())


test_unknown_names_come_with_the_nearest_ones = refusals(
    (lambda: BOX.mount("ur55"), "^unknown arm 'ur55', did you mean 'ur5'"),
    (lambda: BOX.mount("ur5", locked=["elbow"]), "^unknown joint 'elbow', did you mean 'elbow_joint'"),
    (
        lambda: BOX.mount("ur5").attach(pm.PayloadBody(1), "ur5/tool"),
        "^unknown frame 'ur5/tool', did you mean 'ur5/tool0' or ",
    ),
    (lambda: mountable()["ur55"], "^unknown mountable robot 'ur55', did you mean 'ur5'"),
    by=unknown,
)


def test_a_file_that_is_none_is_refused(urdf: Path, tmp_path: Path) -> None:
    with pytest.raises(pm.InvalidArgument, match=r"package_dirs has '.*nowhere', expected a folder"):
        BOX.mount(urdf, package_dirs=[tmp_path / "nowhere"])
    urdf.write_text("<robot>")
    with pytest.raises(pm.InvalidArgument, match=r"^arm\.urdf is not well-formed XML"):
        BOX.mount(urdf)
    urdf.write_text(ARM.format(lower=""))
    with pytest.raises(
        pm.InvalidArgument, match=r"^joint 'arm/elbow' moves parts that have no inertia, expected inertia"
    ):
        BOX.mount(urdf)


def unsound(**changed: Any) -> pin.Model:
    """Return two hinges, the first as they are, of the second a limit or its body changed."""
    model = massful()
    body = changed.pop("body", None)
    if body is not None:
        model.inertias[2] = pin.Inertia(body[0], np.array([0.1, 0, 0]), np.diag(body[1]))
    for name, value in changed.items():
        limits = np.array(getattr(model, name))
        limits[1] = value
        setattr(model, name, limits)
    model.name = "toy"
    return model


CROSSED = unsound(lowerPositionLimit=2.0, upperPositionLimit=-2.0)
test_arms_that_cannot_be_mounted_are_refused = refusals(
    (lambda: BOX.mount("ur5", name="a/b"), "name is 'a/b', expected a word without /"),
    (
        lambda: BOX.mount("ur5", rest=[0, 0, 9, 0, 0, 0]),
        "rest has joint 'elbow_joint' = 9, expected -3.14159265 <=",
    ),
    (
        lambda: BOX.mount("ur5", package_dirs=["."]),
        "package_dirs is ['.'], expected None with a loader's name, 'ur5'",
    ),
    (lambda: BOX.mount(pin.Model()), "arm '' has no joints, expected at least one"),
    (lambda: BOX.mount("no/such.urdf"), "arm is "),
    (lambda: BOX.mount("cassie"), "arm 'cassie' cannot be loaded: its loader reads SDF"),
    (lambda: BOX.mount(CROSSED), "arm 'toy': upper position limit of joint 'j1' is"),
    (
        lambda: BOX.mount(unsound(body=(-5, (1, 1, 1)))),
        "arm 'toy': link 'j1': mass is -5.0 kg, expected >= 0",
    ),
    (
        lambda: BOX.mount(unsound(body=(1, (1, 1, 2.001)))),
        "arm 'toy': link 'j1': inertia of j1 is one that no body has",
    ),
    by=begun,
)


def driven(robot: pm.MobileRobot) -> pm.Rollout:
    motion = pm.WholeBody(robot, pm.FixedHeading(pm.Circle(1, 0.1, 1), 0), *[None] * len(robot.mounts))
    return pm.simulate(robot, pm.ComputedTorque(robot, 100, 20), motion, dt=0.1)


def test_a_rollout_brings_its_robot_back(tmp_path: Path, urdf: Path) -> None:
    path = tmp_path / "run.npz"
    load = pm.PayloadBody(1.0, (0.1, 0, 0), ((0.1, 0, 0), (0, 0.2, 0), (0, 0, 0.25)))
    robot = (
        BOX.mount("kinova", (0.1, 0, 0.2, 0.3)).mount(urdf, locked=["elbow"], rest=(0.9, 0.1)).attach(load)
    )
    run = driven(robot)
    run.save(path)
    back = pm.Rollout.load(path)
    assert back.plant == robot
    np.testing.assert_array_equal(back.q, run.q)
    urdf.write_text(urdf.read_text().replace('<mass value="1"/>', '<mass value="1.5"/>'))
    assert pm.Rollout.load(path).plant == PlantDescription.of(robot, run.q)  # it is no longer what it was
    urdf.unlink()
    assert pm.Rollout.load(path).plant.coordinates == robot.coordinates  # the arrays are there
    np.testing.assert_array_equal(pm.Rollout.load(path).u, run.u)
    driven(BOX.mount(massful())).save(path)
    assert pm.Rollout.load(path).plant.kind == "MobileRobot"


RESISTED = ARM.format(lower=INERTIAL)
for _limit, _dynamics in (
    ('effort="30" velocity="2"/>', '<dynamics damping="0.7" friction="0.2"/>'),
    ('effort="20" velocity="3"/>', '<dynamics damping="0.3" friction="0.1"/>'),
):
    RESISTED = RESISTED.replace(_limit, _limit + _dynamics)
BASE = """<robot name="cart"><link name="base"><inertial><origin xyz="0 0 0.1"/><mass value="20"/>
  <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="wheel"><inertial><mass value="1"/>
  <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="axle" type="continuous"><parent link="base"/><child link="wheel"/><origin xyz="0 0.2 0.1"/>
  <axis xyz="0 1 0"/><dynamics damping="9" friction="8"/></joint></robot>"""


def test_damping_and_friction_of_joints_are_kept(urdf: Path, tmp_path: Path) -> None:
    urdf.write_text(RESISTED)
    cart = tmp_path / "cart.urdf"
    cart.write_text(BASE)
    base = pm.MobileRobot.from_urdf(cart)
    with pytest.warns(UserWarning, match=r"^arm.urdf: damping and friction of shoulder, elbow act only in"):
        robot = base.mount(urdf, (0, 0, 0.2, 0)).mount(urdf, (0.1, 0, 0.2, 0), locked=["shoulder"])
    for carrying in (robot, robot.attach(pm.PayloadBody(1.0)), pickle.loads(pickle.dumps(robot))):
        assert carrying.joint_damping.tolist() == [0, 0, 0, 0.7, 0.3, 0.3]
        assert carrying.joint_friction.tolist() == [0, 0, 0, 0.2, 0.1, 0.1]
        assert carrying.model.damping[3:].tolist() == [0.7, 0.3, 0.3]
    for bare in (base, robot.base, robot.with_locked_arms()):  # the wheels are locked
        assert bare.joint_damping.tolist() == bare.joint_friction.tolist() == [0, 0, 0]
    # Nothing acts by them.
    urdf.write_text(ARM.format(lower=INERTIAL))
    free = base.mount(urdf, (0, 0, 0.2, 0)).mount(urdf, (0.1, 0, 0.2, 0), locked=["shoulder"])
    q, v, tau = robot.rest, np.ones(6), np.ones(6)
    np.testing.assert_array_equal(robot.forward_dynamics(q, v, tau), free.forward_dynamics(q, v, tau))
    assert robot != free


def test_damping_and_friction_of_a_model_are_kept() -> None:
    model = unsound(damping=0.5, friction=0.25, armature=0.1, rotorInertia=0.01, rotorGearRatio=50.0)
    robot = BOX.mount(model, (0, 0, 0.2, 0)).attach(pm.PayloadBody(0.5))
    assert robot.joint_damping.tolist() == [0, 0, 0, 0, 0.5]
    assert robot.joint_friction.tolist() == [0, 0, 0, 0, 0.25]
    # What else the file says of a joint comes through, too.
    for name in ("armature", "rotorInertia", "rotorGearRatio", "effortLimit", "velocityLimit"):
        np.testing.assert_array_equal(getattr(robot.model, name)[3:], getattr(model, name), name)


# -- every robot that example-robot-data offers ----------------------------------------------------


NAMES = sorted(example_robot_data.ROBOTS)
REFUSED = [name for name, (mounts, _) in EXCEPTIONS.items() if not mounts]
READABLE = VisualFile.tree


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
    motion = pm.WholeBody(robot, pm.Tangent(pm.Circle(2.5, 0.4, 1.0)), *[None] * len(robot.mounts))
    rollout = pm.simulate(robot, pm.ComputedTorque(robot, 100, 20), motion, dt=0.02)
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
