from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
import sympy
from hypothesis import given, strategies as st

import pinmobile as pm
from pinmobile import InvalidArgument, MobileRobot
from pinmobile.derivation import Link, derive, lecture
from pinmobile.derivation.steps import _A4_WIDTH, _width
from pinmobile.dh import LECTURE_TABLE, SLIDE_TABLE, DHRow, DHTable, JointType, transform
from pinmobile.urdf import Body, box_inertia, shipped_urdf, write
from tests.refusals import holding, refusals, refused

# Every entry is a sum of few products of cosines and lengths: some roundings of numbers up to 100.
ROUNDING = 1e-13
lengths, angles = st.floats(-100, 100), st.floats(-20, 20)


@pytest.mark.parametrize("table", [LECTURE_TABLE, SLIDE_TABLE])
@given(lengths, lengths, angles)
def test_both_tables_put_the_body_at_x_y_psi(table: DHTable, y: float, x: float, psi: float) -> None:
    c, s = np.cos(psi), np.sin(psi)
    expected = [[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]]
    np.testing.assert_allclose(table.placements([y, x, psi])[-1], expected, atol=ROUNDING)


@given(angles, lengths, angles, lengths)
def test_transform_is_the_product_of_its_four_parts(alpha: float, a: float, theta: float, d: float) -> None:
    def rotation(axis: int, angle: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        T, (i, j) = np.eye(4), [k for k in range(3) if k != axis]
        T[i, i] = T[j, j] = np.cos(angle)
        T[j, i] = np.sin(angle)
        T[i, j] = -T[j, i]
        return T

    along_x, along_z = np.eye(4), np.eye(4)
    along_x[0, 3], along_z[2, 3] = a, d
    expected = rotation(0, alpha) @ along_x @ rotation(2, theta) @ along_z
    np.testing.assert_allclose(transform(alpha, a, theta, d), expected, atol=ROUNDING)


def test_right_angles_leave_exact_zeros() -> None:
    assert set(np.abs(LECTURE_TABLE.transforms([0, 0, 0])).ravel().tolist()) == {0.0, 1.0}


def test_a_table_refuses_what_is_no_table() -> None:
    row = DHRow(0, 0, 0, 0, JointType.REVOLUTE, "one")
    with pytest.raises(InvalidArgument, match="expected one DHRow or more"):
        DHTable(())
    with pytest.raises(InvalidArgument, match="expected different names"):
        DHTable((row, row))


NUMBERS: dict[str, float] = {
    **{"pi/2": np.pi / 2, "-3*pi/2": -1.5 * np.pi, "2*pi": 2 * np.pi, "-(pi + 1)/2": -(np.pi + 1) / 2},
    **{" 1.5e-2 ": 0.015},
}


@pytest.mark.parametrize("text", NUMBERS)
def test_a_number_may_be_text_with_pi(text: str) -> None:
    row = DHRow(text, text, 0, 0, "revolute", "q")  # type: ignore[arg-type]
    assert (row.alpha, row.a, row.joint) == (NUMBERS[text], NUMBERS[text], JointType.REVOLUTE)


@pytest.mark.parametrize(("text", "typed"), [("90 deg", "pi/2, or 1.570796327"), ("-180°", "-pi, or -3.14")])
def test_degrees_are_refused_with_the_number_to_type(text: str, typed: str) -> None:
    with refused(rf"^theta is '{text}', expected a number in rad, at most 2 pi in size: {typed}"):
        DHRow(0, 0, text, 0, "revolute", "q")  # type: ignore[arg-type]


def test_a_number_above_a_turn_is_taken_for_degrees() -> None:
    with refused(r"^alpha is 90, expected a number in rad, at most 2 pi in size: pi/2, or"):
        DHRow(90, 0, 0, 0, JointType.REVOLUTE, "q")
    assert DHRow(-2 * np.pi, 0, 2 * np.pi, 0, JointType.REVOLUTE, "q").theta == 2 * np.pi


@pytest.mark.parametrize("text", ["", "9**9", "1/0", "__import__('os')", "(" * 500])
def test_other_text_is_refused(text: str) -> None:
    with refused(r"^d is .*, expected a number, such as 'pi/2'$"):
        DHRow(0, 0, 0, text, "revolute", "q")  # type: ignore[arg-type]


I4 = np.array([[0.06, 0.005, 0], [0.005, 0.05, 0], [0, 0, 0.04]])
ROWS: list[Any] = [
    *LECTURE_TABLE,
    (0, 0.4, 0, 0, "revolute", "shoulder"),
    ("pi/2", 0, 0, 0.1, "revolute", "elbow"),
    {"alpha": -2.0, "a": 0.3, "theta": 0.7, "d": 0.05, "joint": "prismatic", "variable": "slide"},
]
BODIES: list[Any] = [
    Body(30.0, np.array([0.1, 0.05, 0.1]), np.diag([1.0, 1.0, 1.3])),
    Body(4.0, np.array([0.25, 0, 0.02]), I4),
    {"mass": 2.0, "com": (0.1, 0.03, 0), "inertia": I4},
    {"mass": 1.0, "com": (0, 0.02, 0.1), "inertia": I4},
]


def test_derivation_frames_urdf_and_simulation_follow_from_one_table() -> None:
    robot = pm.MobileRobot.from_dh(ROWS, BODIES)
    table = DHTable(tuple(ROWS))
    assert robot.chain == table
    model = pin.buildModelFromXML(robot.to_urdf())
    data = model.createData()
    order = [1, 0, 2, 3, 4, 5]  # the table has y before x
    q, v, a = np.random.default_rng(3).uniform(-1, 1, size=(3, 6))
    tau = robot.inverse_dynamics(q, v, a)
    np.testing.assert_allclose(tau, pin.rnea(model, data, q[order], v[order], a[order])[order], atol=1e-12)
    pin.forwardKinematics(model, data, q[order])
    frames = table.placements(q[order])
    np.testing.assert_allclose(frames[-1], data.oMi[6].homogeneous, atol=1e-12)
    np.testing.assert_allclose(frames[-1], robot.frame_pose(q, "arm/slide_link"), atol=1e-12)
    bodies = [one if isinstance(one, Body) else Body(**one) for one in BODIES]
    links: list[Any] = [None, None, *(Link(one.mass, one.com, one.inertia) for one in bodies)]
    names = ("x", "y", "psi", "shoulder", "elbow", "slide")
    derived = derive(table, links, order=names, gravity=(0, 0, -9.81)).numeric()
    np.testing.assert_allclose(derived.inverse_dynamics(q, v, a, {}), tau, atol=1e-9)
    assert pm.verify(robot).passed
    law = pm.ComputedTorque(robot, 25, 10)
    way = pm.WholeBody(robot, pm.Tangent(pm.Circle(1.0, 0.5, 1.0)), pm.Hold(robot.rest[3:], 1.0))
    runs = [pm.simulate(robot, law, way, dt=0.01, engine=engine) for engine in pm.Engine]
    np.testing.assert_allclose(runs[0].q, runs[1].q, atol=1e-9)


def test_a_table_and_its_bodies_must_fit() -> None:
    for rows, bodies in ((ROWS, BODIES[:2]), (ROWS[:2], BODIES[:1])):
        with refused(rf"^table has {len(rows)} rows and bodies {len(bodies)}, expected"):
            pm.MobileRobot.from_dh(rows, bodies)
    with refused("^table has joints revolute shoulder, revolute elbow, prismatic slide, "):
        pm.MobileRobot.from_dh([*ROWS[3:], *ROWS[:3]], BODIES)
    last = LECTURE_TABLE.rows[2]
    for wrong, off in ((replace(last, a=0.2), "0.2 m and 0 deg"), (replace(last, theta=0), "0 m and 90 deg")):
        with refused(f"^table has a last frame {off} away from the pose x = 0, y = 0, psi = 0 that"):
            pm.MobileRobot.from_dh([*LECTURE_TABLE.rows[:2], wrong], BODIES[:1])
    with refused(r"^rows\[0\]: alpha is '90 deg', .*: pi/2, .*; rows\[2\]: unknown joint 'R', available:"):
        derive([("90 deg", 0, 0, 0, "revolute", "a"), ROWS[1], (0, 0, 0, 0, "R", "b")])
    for at in ((0, 0, 0, 0), None):
        assert pm.MobileRobot(30.0, 1.3).mount("ur5", at).chain is None
    assert pm.MobileRobot.from_dh(LECTURE_TABLE, BODIES[:1]).chain == LECTURE_TABLE


def test_a_derivation_is_a_document_whose_lines_fit_the_page() -> None:
    links = [Link(sympy.Symbol(f"m{x}"), sympy.symbols(f"x{x} y{x} z{x}"), sympy.eye(3)) for x in "bcd"]
    for derived in (lecture(), derive(DHTable(tuple(ROWS[:5])), [None, None, *links])):
        text = derived.document()
        assert text.startswith(r"\documentclass")
        assert text.endswith("\\end{document}\n")
        lines = text.split(r"\begin{align*}")[1].split("\\\\\n")
        widths = [_width(line) for line in lines if "matrix" not in line]
        assert max(widths) < 1.5 * _A4_WIDTH  # of a term that cannot be broken; a line of A4 has room for 100
        assert any(r"&\quad" in line for line in lines)


# -- urdf ------------------------------------------------------------------------------------------


SHIPPED = Path(__file__).parents[1] / "models" / "urdf"
BODY = Body(10.0, np.array([0.15, 0.05, 0.02]), np.diag([1.0, 1.1, 1.2]))


@pytest.mark.parametrize("table", [LECTURE_TABLE, SLIDE_TABLE])
@given(st.floats(-100, 100), st.floats(-100, 100), st.floats(-20, 20))
def test_joint_frames_are_the_dh_frames(table: DHTable, y: float, x: float, psi: float) -> None:
    model = pin.buildModelFromXML(write(table, BODY, size=(1, 1, 1)))
    data, q = model.createData(), np.array([y, x, psi])
    pin.forwardKinematics(model, data, q)
    for k, placement in enumerate(table.placements(q), start=1):
        # Products of at most nine rounded factors with lengths up to 100.
        np.testing.assert_allclose(data.oMi[k].homogeneous, placement, atol=2e-13)


def test_shipped_files_are_what_the_library_writes() -> None:
    shipped = {"lecture": MobileRobot.lecture(), "box": MobileRobot.box()}
    assert sorted(path.stem for path in SHIPPED.glob("*")) == sorted(shipped)
    for name, robot in shipped.items():
        path = SHIPPED / f"{name}.urdf"
        assert path.read_text() == robot.to_urdf()
        assert shipped_urdf(name) == path
        assert MobileRobot.from_urdf(path) == robot


def test_box_has_the_inertia_of_a_homogeneous_box() -> None:
    assert MobileRobot.box().yaw_inertia == pytest.approx(30 * (0.6**2 + 0.4**2) / 12, rel=1e-15)
    assert np.diag(box_inertia(12, (1, 2, 3))).tolist() == [13, 10, 5]


def body(*moments: float) -> Body:
    return Body(1.0, np.zeros(3), np.diag(moments).astype(float))


test_a_body_that_cannot_exist_is_refused = refusals(
    (lambda: body(1, 1, -1), "principal moments (-1, 1, 1) kg m^2, which no rigid body has"),
    (lambda: body(1, 1, 2.1), "none above the sum of the other two"),
    (lambda: body(0, 0, 0), "the yaw inertia > 0"),
    by=holding,
)


def test_a_rotated_inertia_is_judged_by_its_principal_moments() -> None:
    R = pin.rpy.rpyToMatrix(0.4, -0.7, 1.1)
    Body(1, np.zeros(3), R @ np.diag([1.0, 1.0, 2.0]) @ R.T)
    with pytest.raises(InvalidArgument, match="no rigid body has"):
        Body(1, np.zeros(3), R @ np.diag([1.0, 1.0, 2.01]) @ R.T)
    with pytest.raises(InvalidArgument, match="not symmetric"):
        Body(1, np.zeros(3), np.eye(3) + np.triu(np.full((3, 3), 0.1), 1))


def test_attributes_are_quoted() -> None:
    text = write(LECTURE_TABLE, BODY, size=(1, 1, 1), stance={"top": '<&"'})
    found = ElementTree.fromstring(text).find("pinmobile")
    assert found is not None
    assert found.attrib == {"top": '<&"'}
