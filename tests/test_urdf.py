from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, strategies as st

from pinmobile import InvalidArgument, MobileRobot
from pinmobile.dh import LECTURE_TABLE, SLIDE_TABLE, DHRow, DHTable, JointType
from pinmobile.errors import UnknownName
from pinmobile.urdf import Body, box_inertia, shipped_urdf, write

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


def test_frames_with_general_angles_are_the_dh_frames_too() -> None:
    rows = (
        DHRow(0.3, 0.2, -1.1, 0.4, JointType.REVOLUTE, "one"),
        DHRow(-2.0, 0.1, 0.7, -0.3, JointType.PRISMATIC, "two"),
        DHRow(np.pi / 2, 0.0, np.pi / 2, 0.2, JointType.REVOLUTE, "three"),
    )
    table, q = DHTable(rows), np.array([0.5, -0.2, 1.4])
    model = pin.buildModelFromXML(write(table, BODY, size=(1, 1, 1)))
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    for k, placement in enumerate(table.placements(q), start=1):
        np.testing.assert_allclose(data.oMi[k].homogeneous, placement, atol=1e-14)


def test_chain_keeps_psi_a_plain_angle_and_its_virtual_links_massless() -> None:
    model = pin.buildModelFromXML(MobileRobot.lecture().to_urdf())
    assert (model.nq, model.nv, list(model.names)) == (3, 3, ["universe", "y", "x", "psi"])
    assert [inertia.mass for inertia in model.inertias][1:] == [0, 0, 30]


def test_shipped_files_are_what_the_library_writes() -> None:
    shipped = {"lecture": MobileRobot.lecture(), "box": MobileRobot.box()}
    assert sorted(path.stem for path in SHIPPED.glob("*")) == sorted(shipped)
    for name, robot in shipped.items():
        path = SHIPPED / f"{name}.urdf"
        assert path.read_text() == robot.to_urdf()
        assert shipped_urdf(name) == path
        assert MobileRobot.from_urdf(path) == robot


def test_a_file_that_is_not_shipped_is_refused_with_the_names_there_are() -> None:
    with pytest.raises(UnknownName, match="unknown shipped URDF 'boks', available: box, lecture"):
        shipped_urdf("boks")


def test_box_has_the_inertia_of_a_homogeneous_box() -> None:
    assert MobileRobot.box().yaw_inertia == pytest.approx(30 * (0.6**2 + 0.4**2) / 12, rel=1e-15)
    assert np.diag(box_inertia(12, (1, 2, 3))).tolist() == [13, 10, 5]


@pytest.mark.parametrize(
    ("mass", "moments", "text"),
    [
        (1, (1, 1, -1), "principal moments (-1, 1, 1) kg m^2, which no rigid body has"),
        (1, (1, 1, 2.1), "none above the sum of the other two"),
        (1, (0, 0, 0), "the yaw inertia > 0"),
    ],
)
def test_a_body_that_cannot_exist_is_refused(mass: float, moments: tuple[float, ...], text: str) -> None:
    with pytest.raises(InvalidArgument) as caught:
        Body(mass, np.zeros(3), np.diag(moments).astype(float))
    assert text in str(caught.value)


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
