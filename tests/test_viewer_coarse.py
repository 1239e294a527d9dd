"""Meshes of fewer triangles."""

import coal
import numpy as np
import pytest

from pinmobile import MobileRobot
from pinmobile.viewer import Viewer
from pinmobile.viewer.shapes import coarse

pytestmark = pytest.mark.once


def sphere(n: int = 80) -> coal.BVHModelOBBRSS:
    """Return a sphere of radius 1 with 2 n^2 triangles."""
    polar, azimuth = np.meshgrid(np.linspace(0, np.pi, n + 1), np.linspace(0, 2 * np.pi, n + 1))
    points = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1)
    first = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()[:, None]
    faces = np.concatenate([first + np.array(corners) for corners in ((0, n + 2, n + 1), (0, 1, n + 2))])
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(faces), points.size // 3)
    mesh.addVertices(points.reshape(-1, 3))
    mesh.addTriangles(faces.astype(np.int32))
    mesh.endModel()
    return mesh


@pytest.mark.parametrize("share", [0.3, 0.05])
def test_a_coarse_mesh_has_about_that_share_and_the_same_shape(share: float) -> None:
    fine = sphere()
    mesh = coarse(fine, share)
    assert 0.4 < mesh.num_tris / (share * fine.num_tris) < 2.5
    distance = np.linalg.norm(mesh.vertices(), axis=1)
    cell = np.sqrt(3 * 4 * np.pi / (share * fine.num_tris))
    assert np.abs(distance - 1).max() < cell**2
    triangles = (mesh.tri_indices(k) for k in range(mesh.num_tris))
    a, b, c = np.array([mesh.vertices()[[t[0], t[1], t[2]]] for t in triangles]).transpose(1, 0, 2)
    outward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a + b + c)
    assert (outward > -1e-12).mean() > 0.99  # seen from outside still


def test_what_is_fine_enough_or_no_mesh_stays() -> None:
    few, fine, box = sphere(4), sphere(20), coal.Box(1, 1, 1)
    assert coarse(fine, 1.0) is fine
    assert coarse(few, 0.01) is few
    assert coarse(fine, 0.001).num_tris > 100
    assert coarse(box, 0.1) is box


def test_a_page_of_a_robot_with_a_million_triangles_stays_small() -> None:
    robot = MobileRobot.box().mount("b1_z1")
    with Viewer(robot) as viewer:
        viewer.display(robot.rest)
        assert len(viewer.static_html()) < 6e6
