"""Meshes of fewer triangles, for pages that a browser shall open at once."""

from typing import Any

import numpy as np

from pinmobile.arrays import Array

__all__ = ["coarse"]

_FEW = 300  # triangles that a mesh keeps: a wedge of eight would be gone


def coarse(shape: Any, share: float) -> Any:
    """Return a mesh with about that share of its triangles; what is no mesh, or has few, stays as it is.

    Vertices in one cell of a grid become one, their mean (Rossignac and Borrel, "Multi-resolution 3D
    approximations for rendering complex scenes", 1993): no triangle moves by more than a cell.

    Parameters
    ----------
    shape : coal.CollisionGeometry
        What is drawn.
    share : float
        From 0 to 1; with 1 it stays as it is.
    """
    count = getattr(shape, "num_tris", 0)
    if share >= 1 or count <= _FEW:
        return shape
    vertices = np.array(shape.vertices())
    triangles = (shape.tri_indices(k) for k in range(count))
    faces = np.array([[triangle[0], triangle[1], triangle[2]] for triangle in triangles])
    return _mesh(*_clustered(vertices, faces, _cell(vertices[faces], max(share * count, _FEW))))


def _cell(corners: Array, wanted: float) -> float:
    """Return the size of a cell of which the triangles, shape (n, 3, 3), leave about so many."""
    a, b, c = np.moveaxis(corners, 1, 0)
    area = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2
    return max(float(np.sqrt(3 * area / wanted)), 1e-9)  # a surface crosses 1.5 cells per size^2


def _clustered(vertices: Array, faces: Any, cell: float) -> tuple[Array, Any]:
    keys = np.floor((vertices - vertices.min(axis=0)) / cell).astype(np.int64)
    _, cluster = np.unique(keys, axis=0, return_inverse=True)
    cluster = cluster.ravel()
    number = np.bincount(cluster)
    means = np.column_stack([np.bincount(cluster, column) / number for column in vertices.T])
    merged = cluster[faces]
    a, b, c = merged.T
    merged = merged[(a != b) & (b != c) & (c != a)]
    # The same three corners in the same sense are one triangle.
    first = np.take_along_axis(merged, (merged.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    return means, np.unique(first, axis=0)


def _mesh(vertices: Array, faces: Any) -> Any:
    import coal

    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(faces), len(vertices))
    mesh.addVertices(vertices)
    mesh.addTriangles(faces.astype(np.int32))
    mesh.endModel()
    return mesh
