"""What does not move of itself: the grid with its scale, the reference path, the triad of a frame."""

from itertools import pairwise

import numpy as np

from pinmobile.arrays import Array
from pinmobile.simulation import Rollout
from pinmobile.viewer import shapes
from pinmobile.viewer.palette import AXES, INK, QUIET
from pinmobile.viewer.stage import Extent, Stage

__all__ = ["ABOVE", "TRAIL", "draw_grid", "draw_path", "draw_triad"]

TRAIL, ABOVE = 2, 40
"""What is painted over what: the grid, trails, the path, words, and what shows through everything."""
_GRID, _PATH, _WORDS = 1, 8, 9

# Where the name of frame k stands, in lengths of the robot: frames 2 and 3 have one origin.
_AWAY = np.array([[-0.45, -0.35, 0.0], [-0.45, -0.35, 0.0], [-1.1, -0.6, 0.0], [1.2, 0.5, 0.0]])
_TO_AXIS = (
    np.eye(3),
    np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    np.array([[0.0, 0, -1], [0, 1, 0], [1, 0, 0]]),
)


def draw_grid(stage: Stage, extent: Extent) -> None:
    """Draw the grid, and write x and y at its edges."""
    xs, ys, tall = extent.lines(0), extent.lines(1), extent.tall
    # WebGL's lines are a pixel wide, and a software one drops those that cross the camera's plane.
    lines = [np.array([[x, y0], [x, y1]]) for x in xs for y0, y1 in pairwise(ys)]
    lines += [np.array([[x0, y], [x1, y]]) for y in ys for x0, x1 in pairwise(xs)]
    bands = shapes.joined([shapes.ribbon(line, 0.04 * tall) for line in lines])
    stage.put("meshcat/grid", shapes.flat(bands, "#c9cdd1", order=_GRID))
    words = [("x [m]", (xs[-1] + 1.6 * tall, ys[0])), ("y [m]", (xs[0] + 1.4 * tall, ys[-1] + 0.7 * tall))]
    longest = max(len(f"{x:g}") for x in xs)
    apart = int(np.ceil(0.7 * tall * longest / extent.step))  # lines from one word to the next
    words += [(f"{x:g}", (x, ys[0] - 0.75 * tall)) for x in xs if round(x / extent.step) % apart == 0]
    words += [(f"{y:g}", (xs[0] - (0.4 + 0.25 * len(f"{y:g}")) * tall, y)) for y in ys]
    for k, (text, (x, y)) in enumerate(words):
        stage.put(f"meshcat/scale/{k}", shapes.word(text, QUIET, tall, lying=True, order=_WORDS))
        stage.set(f"meshcat/scale/{k}", "position", [float(x), float(y), 0.0])


def draw_path(stage: Stage, run: Rollout, extent: Extent) -> None:
    """Draw the reference path of a rollout, dashed."""
    points = run.reference_poses[:: max(len(run) // 4000, 1), :2]
    dash = max(0.028 * extent.radius, 0.05 * extent.unit)
    bands = shapes.dashes(points, 0.025 * extent.unit, dash, 0.8 * dash)
    stage.put("meshcat/path", shapes.flat(bands, INK, order=_PATH))


def draw_triad(stage: Stage, path: str, label: str, extent: Extent, place: tuple[int, int]) -> Array:
    """Draw the axes of a frame at a node, and its name at another, and return by how much that stands aside.

    Parameters
    ----------
    stage : Stage
        Where.
    path : str
        Node of the axes; that of the name is called ``path + "name"``.
    label : str
        The name.
    extent : Extent
        Tells how large things are.
    place : tuple of 2 int
        Number of the table, and of the frame in it.

    Returns
    -------
    away : ndarray, shape (3,)
        From the origin of the frame to its name [m].
    """
    number, k = place
    vertices, faces = shapes.arrow(0.07 - 0.02 * min(number, 2))
    length = (0.9 + 0.3 * number) * extent.unit
    for axis, turned in enumerate(_TO_AXIS):
        arrow = length * vertices @ turned.T, faces
        stage.put(f"{path}/{'xyz'[axis]}", shapes.over(arrow, AXES[axis], order=ABOVE + axis))
    stage.put(f"{path}name", shapes.word(label, INK, 0.42 * extent.unit, lying=False, order=ABOVE + 5))
    return np.asarray(extent.unit * (_AWAY[min(k, 3)] + np.array([0, -0.5 * number, 0])))
