"""How far links are from one another and from the ground: beside MuJoCo, brute force and closed forms."""

import pickle
from pathlib import Path
from typing import Any

import coal
import mujoco
import numpy as np
import pinocchio as pin
import pytest

import pinmobile as pm
import tests.wheeled as wheeled
from pinmobile.arrays import Array
from pinmobile.errors import Unreachable
from pinmobile.proximity import Clearance
from pinmobile.reaching import InverseKinematicsTrajectory
from pinmobile.robot import Solid
from tests.test_arms import mjcf, numbers, placed

BOX = pm.MobileRobot.box(100, (0.8, 0.6, 0.3))
AT = (0.1, -0.05, 0.3, 0.4)
UR5 = BOX.mount("ur5", AT)
BENT = np.array([0, 0, 0, 0, -1.2, 1.6, -0.4, 1.57, 0])
LINKS = (  # of a UR5: its joint, and a capsule or a box along the way to the next
    ("base_link", 0, (0, 0, 0.05), "z", coal.Cylinder(0.075, 0.1)),
    ("shoulder_link", 1, (0, 0, 0), "z", coal.Sphere(0.065)),
    ("upper_arm_link", 2, (0, 0, 0.2125), "z", coal.Capsule(0.055, 0.425)),
    ("forearm_link", 3, (0, 0, 0.196), "z", coal.Box(0.09, 0.08, 0.36)),
    ("wrist_1_link", 4, (0, 0.05, 0), "x", coal.Cylinder(0.045, 0.1)),
    ("wrist_2_link", 5, (0, 0, 0.05), "z", coal.Capsule(0.04, 0.08)),
    ("wrist_3_link", 6, (0, 0.06, 0), "x", coal.Cylinder(0.04, 0.06)),
)


def of_primitives() -> pm.MobileRobot:
    """Return a UR5 on the box whose links are capsules, cylinders, spheres and boxes."""
    model, shapes = UR5.mounts[0].model, pin.GeometryModel()
    for name, joint, place, axis, shape in LINKS:
        turn = np.eye(3) if axis == "z" else pin.utils.rotate("x", np.pi / 2)
        at = pin.SE3(turn, np.array(place, np.float64))
        shapes.addGeometryObject(pin.GeometryObject(name, joint, at, shape))
    return BOX.mount(model, AT, name="ur5", collision=shapes, rest=BENT[3:])


PRIMITIVE = of_primitives()
PANDA = BOX.mount("panda_collision", AT)


def geom(name: str, solid: Solid) -> str:
    """Return a shape as MuJoCo has it."""
    shape, kind = solid.geometry, type(solid.geometry).__name__.lower()
    names = {"box": ["halfSide"], "sphere": ["radius"]}.get(kind, ["radius", "halfLength"])
    size = numbers(np.hstack([getattr(shape, name) for name in names]))
    return f'<geom name="{name}" type="{kind}" size="{size}" {placed(solid.placement)} mass="0"/>'


def by_mujoco(robot: pm.MobileRobot, q: Array, pairs: Any) -> Array:
    """Return the distances of pairs of links, shape (n, pairs): the least of those of their shapes."""
    geoms: dict[int, str] = {-1: '<geom name="ground" type="plane" size="9 9 1"/>'}
    names: dict[str, list[str]] = {"ground": ["ground"]}
    mount = robot.mounts[0]
    for k, solid in enumerate(robot.solids.shapes):
        geoms[solid.part] = geoms.get(solid.part, "") + geom(f"{k}", solid)
        names.setdefault(solid.link, []).append(f"{k}")
    model = mujoco.MjModel.from_xml_string(mjcf(robot, mount, geoms))
    model.opt.ccd_tolerance, model.opt.ccd_iterations = 1e-12, 1000
    data, found = mujoco.MjData(model), np.empty((len(q), len(pairs)))
    ids = {name: [model.geom(each).id for each in own] for name, own in names.items()}
    for row, out in zip(q, found, strict=True):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        for k, (a, b) in enumerate(pairs):
            ways = [mujoco.mj_geomDistance(model, data, i, j, 9.0, None) for i in ids[a] for j in ids[b]]
            out[k] = min(ways)
    return found


@pytest.mark.parametrize("robot", [PRIMITIVE, PANDA], ids=["ur5", "panda"])
def test_mujoco_has_the_same_distances(robot: pm.MobileRobot) -> None:
    q = robot.random_configuration(np.random.default_rng(1), (100,))
    found = pm.clearance(robot, q)
    theirs = by_mujoco(robot, q, found.pairs)
    assert found.distances.shape == (100, len(found.pairs))
    apart = theirs > 0
    assert apart.sum() > 1500
    np.testing.assert_allclose(found.distances[apart], theirs[apart], rtol=0, atol=1e-6)
    # Of what overlaps MuJoCo seeks a contact, not always the least way out of it: ours is no less.
    assert (~apart).sum() > 40
    assert (found.distances[~apart] < theirs[~apart] + 1e-6).all()
    assert (np.abs(found.distances - theirs)[~apart] < 1e-6).mean() > 0.8


def test_a_depth_that_coal_finds_only_roughly_is_that_of_mujoco() -> None:
    q = np.array([[0.7501, 0.4451, 0.4379, -1.0698, 1.7357, 2.9176, 4.8073, 5.1743, -4.2202]])
    found, pair = pm.clearance(PRIMITIVE, q), ("ur5/base_link", "ur5/wrist_1_link")
    theirs = by_mujoco(PRIMITIVE, q, [pair])
    np.testing.assert_allclose(found.distances[:, found.pairs.index(pair)], theirs[0], rtol=0, atol=1e-6)


def mesh(points: Any, faces: Any) -> Any:
    """Return a mesh as a file's is."""
    made = coal.BVHModelOBBRSS()
    made.beginModel(len(faces), len(points))
    made.addVertices(np.asarray(points, np.float64))
    made.addTriangles(np.asarray(faces, np.int32))
    made.endModel()
    return made


def cup(size: float = 0.2, wall: float = 0.02) -> Any:
    """Return a box that is open at the top, its floor at z = 0 and as thick as its walls."""
    a, b = size, size - wall
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]], np.float64)
    rings = [(a, 0.0), (a, 2 * size), (b, 2 * size), (b, wall)]
    points = [(*(r * corner), z) for r, z in rings for corner in square]
    faces = [(0, 2, 1), (0, 3, 2), (12, 13, 14), (12, 14, 15)]
    for ring in range(3):
        for k in range(4):
            i, j = 4 * ring + k, 4 * ring + (k + 1) % 4
            faces += [(i, j, i + 4), (j, j + 4, i + 4)]
    return mesh(points, faces)


def slider(*shapes: tuple[int, Any], rest: float = 1.0) -> pm.MobileRobot:
    """Return a box that carries two slides along z, one on the other, with shapes on either."""
    model, geometry = pin.Model(), pin.GeometryModel()
    for k in (1, 2, 3):
        joint = model.addJoint(k - 1, pin.JointModelPZ(), pin.SE3.Identity(), f"slide{k}")
        model.appendBodyToJoint(joint, pin.Inertia.FromBox(1.0, 0.1, 0.1, 0.1), pin.SE3.Identity())
        model.addBodyFrame(f"link{k}", joint, pin.SE3.Identity(), model.addJointFrame(joint))
    model.lowerPositionLimit, model.upperPositionLimit = np.full(3, -2.0), np.full(3, 2.0)
    for k, (joint, shape) in enumerate(shapes):
        item = pin.GeometryObject(f"shape{k}", joint, pin.SE3.Identity(), shape)
        geometry.addGeometryObject(item)
    return BOX.mount(model, (0, 0, 0.5, 0), name="arm", collision=geometry, rest=[rest, 0.0, rest])


@pytest.mark.parametrize(
    ("height", "distance"),
    [
        (0.5, np.hypot(0.1, 0.26) - 0.05),  # to the rim
        (0.12, 0.05),
        (0.06, -0.01),
    ],
)
def test_a_mesh_that_is_hollow_counts_as_it_is(height: float, distance: float) -> None:
    """Between a cup, 0.2 m wide inside, and a ball of 5 cm that is let down into it.

    |   o   |   0.1 - 0.05 from its walls, until it comes nearer to its floor, at 0.02
    |_______|
    """
    robot = slider((1, cup(0.12)), (3, coal.Sphere(0.05)))
    found = pm.clearance(robot, np.array([0.0, 0, 0, 0, 0, height]))
    near = found.distances[found.pairs.index(("arm/shape0", "arm/shape1"))]
    assert near == pytest.approx(distance, abs=1e-9) or (distance < 0 and near < 0)


def test_what_is_wholly_inside_a_mesh_overlaps_it() -> None:
    block = coal.Box(0.6, 0.6, 0.6)
    corners = 0.3 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)]
    faces += [(2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    for shape in (block, mesh(corners, faces)):
        robot = slider((1, shape), (3, coal.Sphere(0.05)))
        q = np.array([[0, 0, 0, 0, 0, z] for z in (0.0, 0.1, 0.34, 0.36, 1.0)])
        found = pm.clearance(robot, q)
        near = found.distances[:, found.pairs.index(("arm/shape0", "arm/shape1"))]
        np.testing.assert_allclose(near, [-0.35, -0.25, -0.01, 0.01, 0.65], atol=1e-6)


def test_pairs_that_touch_at_rest_are_left_out_and_named_and_so_are_neighbours() -> None:
    robot = slider((1, coal.Box(1, 1, 1)), (2, coal.Box(0.2, 0.2, 0.2)), (3, coal.Sphere(0.1)), rest=0.55)
    found = pm.clearance(robot, robot.rest)
    assert found.left_out["arm/shape0", "arm/shape2"] == "touch at rest"
    assert found.left_out["arm/shape0", "arm/shape1"] == "joined by a joint"
    assert found.left_out["base_link", "ground"] == "at a constant distance"
    assert "touch at rest: arm/shape0 - arm/shape2" in str(found)
    assert ("base_link", "arm/shape2") in found.pairs
    higher = slider((1, coal.Box(1, 1, 1)), (3, coal.Sphere(0.1)), rest=1.0)
    assert ("arm/shape0", "arm/shape1") in pm.clearance(higher, higher.rest).pairs


def test_links_that_pass_each_other_closely_and_never_touch_do_not_count() -> None:
    found = pm.clearance(UR5, UR5.rest)
    never = {pair for pair, why in found.left_out.items() if why.startswith("never touch")}
    assert ("ur5/wrist_1_link", "ur5/wrist_3_link") in never  # 14 mm apart whatever wrist 2 does
    assert ("base_link", "ur5/upper_arm_link") in found.pairs  # two joints apart, and it can hit the box
    assert ("ur5/shoulder_link", "ur5/forearm_link") in found.pairs  # folded


def test_it_takes_any_leading_axes_wherever_the_robot_is_and_tells_the_smallest() -> None:
    q = PRIMITIVE.random_configuration(np.random.default_rng(4), (3, 4))
    found = pm.clearance(PRIMITIVE, q)
    assert found.distance.shape == (3, 4)
    assert found.smallest == found.distance.min() == found.distance[found.at]
    k = found.pairs.index(found.nearest)
    assert found.distances[(*found.at, k)] == found.smallest
    assert f"{found.smallest:.4g} m between {' and '.join(found.nearest)}" in repr(found)
    moved = q + np.where(np.arange(9) < 3, [1e3, -2e3, 0.7, 0, 0, 0, 0, 0, 0], 0)
    np.testing.assert_array_equal(pm.clearance(PRIMITIVE, moved).distances, found.distances)
    np.testing.assert_array_equal(pm.clearance(PRIMITIVE, q[1, 2]).distances, found.distances[1, 2])
    assert pm.clearance(PRIMITIVE, q[:0]).smallest == np.inf
    again = pickle.loads(pickle.dumps(found))
    np.testing.assert_array_equal(again.distances, found.distances)
    assert again.left_out == found.left_out
    with pytest.raises(ValueError, match="read-only"):
        found.distances[0] = 1


def test_a_load_is_its_box() -> None:
    loaded = slider((1, coal.Sphere(0.1)), (2, coal.Sphere(0.1)), (3, coal.Sphere(0.1)))
    loaded = loaded.attach(pm.PayloadBody(1.0, (0, 0, 0.5), size=(0.2, 0.2, 0.2)), "arm/link3")
    found = pm.clearance(loaded, np.array([0, 0, 0, 0, 0, 0.3]))
    at = found.pairs.index(("arm/shape0", "load 1"))
    assert found.distances[at] == pytest.approx(0.3 + 0.5 - 0.1 - 0.1, abs=1e-9)
    assert found.left_out["arm/shape2", "load 1"] == "at a constant distance"


SWERVE = pm.WheelTable.swerve(
    [(0.3, 0.25), (0.3, -0.25), (-0.3, 0.0)], radius=0.08, mass=1.0, spin_inertia=0.003, yaw_inertia=0.003
)


def test_wheels_are_cylinders_that_steer_stand_on_the_ground_and_are_in_the_arms_way() -> None:
    robot = pm.WheeledRobot(UR5, SWERVE)
    shapes = [shape.link for shape in robot.solids.shapes]
    q = robot.rest.copy()
    q[9:12] = 0.3, -1.1, 0.7
    q[:3] = 0.4, -0.2, 0.9  # the shapes are seen from the body
    placements = robot.solid_placements(q)
    drawn = {item.name: k for k, item in enumerate(robot.visual_model.geometryObjects)}
    body = robot.robot.frame_pose(q[:9], "base_link")
    for name in SWERVE.names:
        seen = np.linalg.inv(body) @ robot.drawing(q)[drawn[f"{name}/tyre"]]
        own = placements[shapes.index(f"{name}/tyre")]
        np.testing.assert_allclose(own[:3, 3], seen[:3, 3], atol=1e-12)
        np.testing.assert_allclose(np.abs(own[:3, 2]), np.abs(seen[:3, 1]), atol=1e-12)  # the axle
    found = pm.clearance(robot, q)
    for name in SWERVE.names:
        assert found.left_out[f"{name}/tyre", "ground"] == "stands on the ground"
    assert any("tyre" in pair[1] and "wrist" in pair[0] for pair in found.pairs)
    box = robot.solids.shapes[0]
    assert box.placement.translation[2] + box.geometry.halfSide[2] == pytest.approx(0.3)
    assert box.placement.translation[2] - box.geometry.halfSide[2] > 0.1  # above the wheels
    # The arm is where it was without wheels.
    bare = pm.clearance(UR5, q[:9])
    for pair in (("ur5/forearm_link", "ground"), ("base_link", "ur5/forearm_link")):
        both = [each.distances[each.pairs.index(pair)] for each in (found, bare)]
        assert both[0] == pytest.approx(both[1], abs=1e-9)


def test_shapes_of_a_file_are_taken_and_those_of_its_wheels_stand(tmp_path: Path) -> None:
    path = wheeled.written(tmp_path, wheeled.turtlebot("burger"))
    robot = pm.WheeledRobot.from_urdf(path).mount("ur5", (0, 0, 0.3, 0))
    shapes = {shape.link: shape for shape in robot.solids.shapes}
    assert len(robot.solids.standing) >= 2
    assert not any("tyre" in name for name in shapes)  # the file has its own
    found = pm.clearance(robot, robot.rest)
    for link in robot.solids.standing:
        assert found.left_out[link, "ground"] == "stands on the ground"
    body = pm.clearance(robot.robot, robot.robot.rest)
    assert body.smallest == pytest.approx(found.smallest, abs=1e-12)


def test_a_robot_without_collision_shapes_is_refused(tmp_path: Path) -> None:
    no_shapes = pm.MobileRobot.from_model(BOX.model)
    with pytest.raises(pm.InvalidArgument, match="robot has a body without collision shapes"):
        pm.clearance(no_shapes, no_shapes.rest)
    with pytest.raises(pm.InvalidArgument, match="robot is 3, which has no collision geometry"):
        pm.clearance(3, [0, 0, 0])
    seen = wheeled.written(tmp_path, wheeled.turtlebot("burger").replace("collision", "visual"))
    drawn = pm.MobileRobot.from_urdf(seen, ground=0.0)
    with pytest.raises(pm.InvalidArgument, match=r"without collision shapes \(base.urdf is "):
        pm.clearance(drawn, drawn.rest)
    lost = pm.MobileRobot.from_urdf(wheeled.written(tmp_path, wheeled.ridgeback(), "ridgeback.urdf"))
    expected = r"ridgeback.urdf has collision meshes that are missing: body-collision.stl; expected them"
    with pytest.raises(pm.InvalidArgument, match=expected):
        pm.clearance(lost, lost.rest)


LOCKED = np.where(np.arange(9) < 3, 0.0, UR5.velocity_limit)
START = UR5.frame_pose(BENT)


def down(way: Any) -> pm.PosePath:
    """Return a straight way of the hand's position from rest to rest."""
    return pm.PosePath(pm.Spline([START[:3, 3], START[:3, 3] + way], [0, 4]))


def test_resolve_reports_the_smallest_clearance_and_refuses_to_go_below_it() -> None:
    through = down((-0.45, 0.0, -0.35))  # into the box that carries it
    gone = pm.solve_inverse_kinematics(UR5, through, q0=BENT, velocity_limit=LOCKED, dt=0.02)
    assert gone.max_error()[0] < 1e-3
    assert isinstance(gone.clearance, Clearance)
    assert gone.clearance.smallest < 0
    np.testing.assert_array_equal(gone.clearance.distance, pm.clearance(UR5, gone(gone.t).q).distance)
    assert f"smallest clearance {gone.clearance.summary}" in repr(gone)
    with pytest.raises(Unreachable, match=r"clearance is .* m between .* expected at least 0.01 m") as caught:
        pm.solve_inverse_kinematics(UR5, through, q0=BENT, velocity_limit=LOCKED, dt=0.02, clearance=0.01)
    kept: InverseKinematicsTrajectory = caught.value.resolved
    k = int(np.argmax(kept.clearance.distance < 0.01))
    assert caught.value.time == kept.t[k]
    away = pm.solve_inverse_kinematics(
        UR5, down((0.1, 0.1, 0.1)), q0=BENT, velocity_limit=LOCKED, dt=0.02, clearance=0.01
    )
    assert away.clearance.smallest >= 0.01
