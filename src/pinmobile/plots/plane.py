"""Figures in the plane: desired and travelled path with the robot, also as a GIF; end effectors."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon
from matplotlib.patheffects import withStroke
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox
from PIL import Image

from pinmobile.arrays import Array, ArrayLike, bounded, callable_as, finite, positive, scalar, shaped
from pinmobile.errors import InvalidArgument
from pinmobile.files import write_file
from pinmobile.loop import Rollout
from pinmobile.plant import robot_at, stated
from pinmobile.plots.style import (
    Layout,
    Rollouts,
    Sheet,
    Spot,
    Style,
    check_title,
    colour,
    draw_curve,
    dress,
    dress_time,
    evaluate_each,
    font_size,
    format_si,
    ink,
    label_rollouts,
    label_style,
    legend_entries,
    line_style,
    reference_groups,
    reference_style,
    rounded_out,
    text_width,
    thin_samples,
    title_offset,
    wrap_text,
)

_MAX_POSTURES = 100  # of an arm, which the window shows
_EDGE = withStroke(linewidth=4.4, foreground="white")
_ARM_STYLE: Style = {"color": "#222222", "linewidth": 2.2, "solid_capstyle": "round", "path_effects": [_EDGE]}
_ARROW_SHARE = 0.06  # length of the arrowhead of a plant without size, as a share of the axes

#         ______________
#        |    |\        |
#        |    |   \     |        the nose points along x_B
#        |    |   /     |
#        |____|/________|
_NOSE = np.array([[-0.1, -0.38], [0.48, 0.0], [-0.1, 0.38]])  # of length and width
_BOX = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
_DART = np.array([[0.6, 0.0], [-0.4, 0.35], [-0.2, 0.0], [-0.4, -0.35]])


class RobotPatches:
    """Patches of a robot in axes: its outline with length along x_B, and a nose at its front.

    A plant without size is drawn as an arrowhead.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Axes to draw in.
    plant : MobileRobot or other plant, or None
        Plant; its ``size`` gives length and width [m].
    colour : str
        Colour of outline and nose.
    default_size : float
        Length of the arrowhead of a plant without size [m].
    **style
        Properties of all patches, such as ``zorder``.

    Attributes
    ----------
    patches : list of Polygon
        Patches; the outline comes first.
    """

    def __init__(self, axes: Axes, plant: object, colour: str, default_size: float, **style: Any) -> None:
        size = _size(plant)
        self._shapes = [_BOX * size, _NOSE * size] if size is not None else [_DART * default_size]
        fills = [to_rgba(colour, 0.25), colour] if size is not None else [colour]
        self.patches = [
            Polygon(shape, closed=True, facecolor=fill, edgecolor=colour, linewidth=1.2, **style)
            for shape, fill in zip(self._shapes, fills, strict=True)
        ]
        self.patches[0].set_label("robot")
        for patch in self.patches:
            axes.add_patch(patch)

    def move(self, pose: Array) -> None:
        """Move the robot to a pose (x, y, psi), shape (3,) [m, m, rad]."""
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        for patch, shape in zip(self.patches, self._shapes, strict=True):
            patch.set_xy(pose[:2] + shape @ np.array([[cos, sin], [-sin, cos]]))


def arm_links(run: Rollout, times: Array) -> Array:
    """Return the links of arms from above at `times`, shape (n, 3 k, 2) [m]: each two ends, and NaN."""
    plant = robot_at(run.plant, 0.0)
    robot = plant if stated(plant, "frame_placements") is not None else stated(plant, "robot")
    mounts = stated(robot, "mounts") or ()
    if not mounts:
        return np.zeros((len(times), 0, 2))
    q = np.stack([np.interp(times, run.t, column) for column in run.q[:, : robot.nq].T], axis=-1)
    joints, model = np.moveaxis(robot.frame_placements(q)[..., :2, 3], 1, 0), robot.model
    lines = []
    for mount in mounts:
        chain = range(mount.joints.start, mount.joints.stop)
        lines += [(joints[model.parents[k] - 1], joints[k - 1]) for k in chain if model.parents[k] in chain]
        tip_joint = model.frames[model.getFrameId(mount.tip)].parentJoint
        lines.append((joints[tip_joint - 1], robot.frame_pose(q, mount.tip)[:, :2, 3]))
    gap = np.full((len(times), 2), np.nan)
    return np.stack([point for start, end in lines for point in (start, end, gap)], axis=1)


def diagonal(plant: object, default_size: float) -> float:
    """Return the diagonal of the plant's outline [m], or `default_size` if the plant has no size."""
    size = _size(plant)
    return default_size if size is None else float(np.hypot(*size))


def _size(plant: object) -> Array | None:
    """Return length and width [m], or None for a plant without size."""
    try:
        size = finite("size", getattr(plant, "size", ()))
    except InvalidArgument:
        return None
    return size[:2] if size.ndim == 1 and len(size) >= 2 and (size[:2] > 0).all() else None


_MAX_BOXES = 8


def _path_style() -> Style:
    """Return the style of a travelled path: wider than the desired path above it, so that both show."""
    return {"linewidth": 1.9 * float(rcParams["lines.linewidth"]), "zorder": 3}


def path(rollouts: Rollouts, *, times: ArrayLike | None = None, **layout: Unpack[Layout]) -> Figure:
    """Draw the desired and the travelled path from above, and the robot at several times.

    The title of each panel gives the largest position error.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Rollouts by label, one panel each. All panels show the same part of the plane.
    times : array_like, shape (n,), optional
        Times at which the robot is drawn [s]; default: up to 8 times, spread along the path, written where
        there is room.
    **layout
        ``title``, ``ax`` and ``width``, see `plots.states`.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If `rollouts` is invalid, a plant has no pose, or a time is outside a rollout.

    See Also
    --------
    plots.states : the configuration over time
    plots.animate : the same as a GIF
    viewer.Viewer : scene in 3D

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Tangent
    >>> from pinmobile import plots, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> motion = Tangent(Circle(1, 1, 2))
    >>> run = simulate(robot, PD(120, 120), motion, dt=0.02)
    >>> figure = plots.path(run)
    >>> figure.axes[0].get_title()
    'position error at most 210 mm'
    """
    runs = label_rollouts(rollouts)
    evaluate_each(runs, lambda run: run.poses)
    instants: dict[str, Array] = {}
    for labels in reference_groups(runs).values():  # equal references have equal times, for comparison
        instants |= dict.fromkeys(labels, _drawing_times(runs[labels[0]]))
    if times is not None:
        given = shaped("times", np.atleast_1d(finite("times", times)), ("n",))
        for label, run in runs.items():
            first, last = float(run.t[0]), float(run.t[-1])
            instants[label] = bounded("times", given, least=first, most=last, unit="s")
    figure, axes = make_panels(runs, "Desired and travelled path", **layout)
    arrow_length = _arrow_length(axes[0])
    for index, (label, run) in enumerate(runs.items()):
        written: list[Bbox] = []
        draw_curve(axes[index], *run.poses[:, :2].T, color=colour(index), label="travelled", **_path_style())
        drawings = zip(
            instants[label], poses(run, instants[label]), arm_links(run, instants[label]), strict=True
        )
        for t, pose, arms in drawings:
            RobotPatches(axes[index], run.plant, colour(index), arrow_length, zorder=5).move(pose)
            if len(arms):
                axes[index].plot(*arms.T, **_ARM_STYLE, zorder=5.5)
            words = _write_time(axes[index], t, pose, 0.5 * diagonal(run.plant, arrow_length))
            if times is None and not _is_clear(words, run.poses[:, :2], written):
                words.remove()
    return figure


def make_panels(
    runs: Mapping[str, Rollout], default: str, *, register: bool = True, **layout: Unpack[Layout]
) -> tuple[Figure, list[Axes]]:
    """Return a figure with a panel for each rollout, with its desired path, and a legend below.

    Parameters
    ----------
    runs : mapping of str to Rollout
        Rollouts by label.
    default : str
        Default heading.
    register : bool
        See `Sheet`.
    **layout
        See `Sheet`.
    """
    max_columns = min(len(runs), 3)
    largest = (8.6 / max_columns - 0.4, 4.8) if max_columns > 1 else (7.0, 5.6)  # [in]
    shape = _window_sides(_window(runs, largest[0]))
    size = min(largest[0] / shape[0], largest[1] / shape[1])
    sheet = Sheet(0.85 + max_columns * (shape[0] * size + 0.3) - 0.3, register=register, **layout)
    columns, keys = sheet.columns(max_columns, 1.7), list(_path_keys(runs))
    window = _window(runs, sheet.width / columns)
    shape = _window_sides(window)
    room = (sheet.width - 5.5 * font_size() / 72) / columns
    max_errors = [format_si(rounded_out(float(run.distance.max())), "m") for run in runs.values()]
    notes = [wrap_text(f"position error at most {each}", font_size(0.95), room) for each in max_errors]
    labels = [wrap_text(label, font_size(1.2), room, weight="bold") for label in runs]
    height, spots = 0.0, [divmod(k, columns) for k in range(len(runs))]
    if sheet.is_new:
        sizes = zip([1 + note.count("\n") for note in notes], labels, strict=True)
        title_lines = max(lines + 1.5 * bool(label) * (label.count("\n") + 1) for lines, label in sizes)
        margins = sheet.legend_height(keys), sheet.heading_height(default)
        height, grid = _place_axes(sheet, spots, shape, 1.3 * title_lines + 0.8, *margins)
    else:
        grid = sheet.axes(spots, [3.0] * -(-len(runs) // columns), share="")
    for index, (axes, run) in enumerate(zip(grid, runs.values(), strict=True)):
        left, lowest = index % columns == 0, index + columns >= len(runs)
        dress(axes)
        axes.set_aspect("equal")
        axes.set(xlim=window[:, 0], ylim=window[:, 1])
        axes.set(xlabel="x [m]" if lowest else "", ylabel="y [m]" if left else "")
        axes.tick_params(labelleft=left, labelbottom=lowest)
        axes.set_title(notes[index], fontsize=font_size(0.95))
        offset = 0, title_offset(notes[index].count("\n") + 1)
        axes.annotate(labels[index], (0.5, 1), offset, ha="center", **label_style(index))
        draw_curve(axes, *run.reference_poses[:, :2].T, label="desired", **reference_style())
    return sheet.finish(default, keys, height=height), grid


def _place_axes(
    sheet: Sheet, spots: Sequence[tuple[int, int]], shape: Array, titles: float, keys: float, heading: float
) -> tuple[float, list[Axes]]:
    """Return the height of a figure [in] and its axes, placed without a layout engine.

    Titles of axes with a fixed aspect collide in the layouts of matplotlib.

    Parameters
    ----------
    sheet : Sheet
        Sheet with a new figure.
    spots : sequence of tuple
        Row and column of each of the axes.
    shape : ndarray, shape (2,)
        Side lengths of the window; the longer side is 1.
    titles : float
        Height of the text above each of the axes, in font sizes.
    keys, heading : float
        Heights of legend and heading [in].
    """
    em = font_size() / 72
    rows, columns = (1 + max(rectangle) for rectangle in zip(*spots, strict=True))
    left, right, gap = 6.0 * em, 1.4 * em, 2.2 * em
    bottom, row_gap, top = keys + 3.4 * em, (titles + 1.8) * em, titles * em + heading
    width = (sheet.width - left - right - gap * (columns - 1)) / columns
    span = max(width, em) * shape[1] / shape[0]
    height = bottom + rows * span + (rows - 1) * row_gap + top
    figure = sheet.figure
    figure.set_layout_engine("none")
    panels: list[Axes] = []
    for row, column in spots:
        corner = left + column * (width + gap), bottom + (rows - 1 - row) * (span + row_gap)
        rectangle = corner[0] / sheet.width, corner[1] / height, max(width, em) / sheet.width, span / height
        shared = panels[0] if panels else None
        panels.append(figure.add_axes(rectangle, sharex=shared, sharey=shared))
    return height, panels


def poses(run: Rollout, times: Array) -> Array:
    """Return the actual poses at `times`, shape (n, 3) [m, m, rad], by linear interpolation."""
    x, y, psi = run.poses.T
    return np.stack([np.interp(times, run.t, column) for column in (x, y, np.unwrap(psi))], axis=-1)


def _path_keys(runs: Mapping[str, Rollout]) -> Iterator[Patch | Line2D]:
    shade = colour(0) if len(runs) == 1 else "#777777"
    yield Line2D([], [], label="desired", **reference_style())
    yield Line2D([], [], label="travelled", color=shade, **_path_style())
    yield Patch(facecolor=(*(0.6,) * 3, 0.4), edgecolor=shade, label="robot")
    if any(arm_links(run, run.t[:1]).size for run in runs.values()):
        yield Line2D([], [], label="arm", **_ARM_STYLE)


def _window_sides(window: Array) -> Array:
    """Return the side lengths of a window; the longer side is 1."""
    sides = window[1] - window[0]
    return np.asarray(sides / sides.max())


def _arrow_length(axes: Axes) -> float:
    """Return the length of the arrowhead of a robot without size [m]."""
    return _ARROW_SHARE * float(np.max(np.diff([axes.get_xlim(), axes.get_ylim()])))


def _window(runs: Mapping[str, Rollout], width: float) -> Array:
    """Return the corners of the window of panels of a width [in], shape (2, 2) [m], with room for labels."""
    parts = [part[:, :2] for run in runs.values() for part in (run.poses, run.reference_poses)]
    parts += [arm_links(run, run.t[:: -(-len(run) // _MAX_POSTURES)]).reshape(-1, 2) for run in runs.values()]
    points = np.concatenate(parts)
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    extent = float((high - low).max())
    robot = max(diagonal(run.plant, _ARROW_SHARE * extent) for run in runs.values())
    text_share = min(2.6 * font_size() / 72 / width, 0.25)
    margin = 0.5 * robot + max(0.12, text_share / (1 - 2 * text_share)) * max(extent, robot) or 1.0
    room = np.maximum(0.25 * extent - 0.5 * (high - low), 0.0)  # a straight line needs some height too
    return np.stack([low - margin - room, high + margin + room])


def _write_time(axes: Axes, t: float, pose: Array, distance: float) -> Annotation:
    """Write the time to the right of the robot."""
    right = float(np.sin(pose[2])), float(-np.cos(pose[2]))
    spot = pose[0] + distance * right[0], pose[1] + distance * right[1]
    offset = font_size(1.8) * right[0], font_size(0.9) * right[1]  # text is wider than high
    text: Style = {"ha": "center", "va": "center", "fontsize": font_size(0.9), "color": ink(), "zorder": 6}
    return axes.annotate(f"{t:.3g} s", spot, offset, textcoords="offset points", **text)


def _is_clear(words: Annotation, path: Array, written: list[Bbox]) -> bool:
    """Return whether text clears ticks, path, and the text that is written, and note its place."""
    axes, size = words.axes, font_size(0.9)
    assert axes is not None
    axes.apply_aspect()
    pixels = axes.get_figure(root=True).dpi  # type: ignore[union-attr]
    middle = axes.transData.transform(words.xy) + np.array(words.xyann) * pixels / 72
    half = 0.5 * pixels * np.array([text_width(words.get_text(), size) + 0.5 * size / 72, 1.2 * size / 72])
    points = axes.transData.transform(path)
    if (np.abs(points - middle) < half).all(axis=1).any():
        return False
    box, (lowest, highest) = Bbox([middle - half, middle + half]), axes.bbox.get_points()
    is_inside = (box.min >= lowest).all() and (box.max <= highest + pixels * size / 72).all()
    if not is_inside or any(box.overlaps(other) for other in written):
        return False
    written.append(box)
    return True


def _drawing_times(run: Rollout) -> Array:
    """Return times at which drawings of the robot do not overlap, shape (n,) [s]."""
    xy = run.poses[:, :2]
    robot = diagonal(run.plant, _ARROW_SHARE * float(np.ptp(xy, axis=0).max()))
    arc_length = np.append(0.0, np.cumsum(np.hypot(*np.diff(xy, axis=0).T)))
    count = int(min(_MAX_BOXES - 1, arc_length[-1] / (1.5 * robot))) if robot else 0
    candidates = np.searchsorted(arc_length, np.linspace(0.0, arc_length[-1], count + 1)[1:-1])
    indices: list[int] = []
    for k in (0, len(xy) - 1, *candidates):
        if all(np.hypot(*(xy[k] - xy[other])) > robot for other in indices):
            indices.append(int(k))
    return np.asarray(run.t[sorted(indices)])


_DEFAULT_DURATION = 10.0  # [s], default duration of the GIF of a longer run
_LAST_DURATION = 1.0  # [s], duration of the last frame
_MAX_RATE = 50.0  # [1/s]; browsers slow down faster GIFs
_DPI = 80
_COLOURS = 48


def animate(
    rollouts: Rollouts,
    path: str | PathLike[str],
    *,
    fps: float = 12.5,
    speed: float | None = None,
    title: str | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> Path:
    """Write a GIF of the moving robot from above, with its travelled path.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Rollouts by label, one panel each. A shorter rollout stops at its end.
    path : str or path-like
        File to write, with the suffix ``.gif``. It replaces an existing file.
    fps : float
        Frames per second of the GIF, at most 50.
    speed : float, optional
        Seconds of the run per second of the GIF. Default: 1, or for a run of more than 10 s the speed at
        which the GIF takes 10 s. The last frame stays for one second.
    title : str, optional
        Heading, beside the time.
    progress : callable, optional
        Function ``progress(done, total)`` that is called after each frame.

    Returns
    -------
    path : pathlib.Path
        The file.

    Raises
    ------
    InvalidArgument
        If `rollouts` is invalid or a plant has no pose, a number is not positive, or the file cannot be
        written.
    FileError
        If the system fails, for example because the disk is full. An existing file remains unchanged.

    See Also
    --------
    plots.path : the same as a figure
    viewer.Recording : GIFs and films in 3D

    Examples
    --------
    >>> import tempfile
    >>> from pinmobile import PD, Circle, MobileRobot, Tangent
    >>> from pinmobile import plots, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> motion = Tangent(Circle(1, 1, 1))
    >>> run = simulate(robot, PD(120, 120), motion, dt=0.02)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     plots.animate(run, f"{folder}/run.gif", fps=2).name
    'run.gif'
    """
    runs = label_rollouts(rollouts)
    evaluate_each(runs, lambda run: run.poses)
    rate = bounded("fps", scalar("fps", fps), above=0, most=_MAX_RATE, unit="1/s")
    start, end = min(run.t[0] for run in runs.values()), max(run.t[-1] for run in runs.values())
    pace = max((end - start) / _DEFAULT_DURATION, 1.0) if speed is None else positive("speed", speed)
    times = np.append(np.arange(start, end - 1e-9 * pace, pace / rate), end)
    if progress is not None:
        callable_as("progress(done, total)", progress)
    frames = _frames(_Animation(runs, times, check_title(title) or "", pace), progress)
    ticks = np.round(100 * np.arange(len(times) + 1) / rate)  # of a GIF's hundredths of a second
    durations = [*(10 * np.diff(ticks[:-1])).astype(int).tolist(), round(1000 * _LAST_DURATION)]  # [ms]

    def gif() -> bytes:
        buffer = BytesIO()
        next(frames).save(buffer, "GIF", save_all=True, append_images=frames, duration=durations, loop=0)
        return buffer.getvalue()

    return write_file(path, ".gif", gif)


def _agg(figure: Figure) -> Any:
    """Return a canvas without a window; the untyped class of matplotlib needs `Any`."""
    return FigureCanvasAgg(figure)


class _Animation:
    """Figure of an animation; its static parts are drawn once."""

    def __init__(self, runs: Mapping[str, Rollout], times: Array, title: str, pace: float) -> None:
        figure, panel_axes = make_panels(runs, "", register=False)
        figure.set_dpi(_DPI)
        self.figure, self.times = figure, times
        self.canvas = _agg(figure)
        words = title if pace == 1 else f"{title} ({pace:.3g} times as fast)".lstrip()
        size, left, right = font_size(1.2), panel_axes[0].get_position().x0, panel_axes[-1].get_position().x1
        height = 1 - size / 144 / figure.get_figheight()
        figure.text(left, height, words, va="top", fontsize=size)
        # Text is slow to draw: each frame draws only the time of the caption.
        clock: Style = {"ha": "right", "va": "top", "fontsize": size, "animated": True}
        self.clock = figure.text(right, height, "", **clock)
        self.robots = [
            _MovingRobot(run, times, axes, colour(index))
            for index, (run, axes) in enumerate(zip(runs.values(), panel_axes, strict=True))
        ]
        self.canvas.draw()
        self.background = self.canvas.copy_from_bbox(figure.bbox)

    def frame(self, index: int) -> Image.Image:
        """Return the frame of an index in full colour."""
        self.canvas.restore_region(self.background)
        self.clock.set_text(f"t = {self.times[index]:.1f} s")
        self.figure.draw_artist(self.clock)
        for mover in self.robots:
            mover.draw(index)
        size = self.canvas.get_width_height(physical=True)
        return Image.frombytes("RGB", size, self.canvas.buffer_rgba(), "raw", "RGBX")


class _MovingRobot:
    """Moving robot in its panel, with the line of its travelled path."""

    def __init__(self, run: Rollout, times: Array, axes: Axes, color: str) -> None:
        xy = run.poses[:, :2]
        samples = thin_samples(*xy.T)
        self.xy, self.counts = xy[samples], np.searchsorted(run.t[samples], times)
        self.poses, self.arms, self.axes = poses(run, times), arm_links(run, times), axes
        self.body = RobotPatches(axes, run.plant, color, _arrow_length(axes), animated=True)
        (self.reference,) = axes.lines  # drawn again, above the travelled path
        (self.line,) = axes.plot([], [], color=color, animated=True, **_path_style())
        (self.links,) = axes.plot([], [], animated=True, **_ARM_STYLE)

    def draw(self, index: int) -> None:
        """Draw robot and line in the frame of an index."""
        pose = self.poses[index]
        self.line.set_data(*np.vstack([self.xy[: self.counts[index]], pose[:2]]).T)
        self.links.set_data(*self.arms[index].T)
        self.body.move(pose)
        for artist in (self.line, self.reference, *self.body.patches, self.links):
            self.axes.draw_artist(artist)


def _frames(scene: _Animation, progress: Callable[[int, int], object] | None) -> Iterator[Image.Image]:
    """Yield the frames with the palette of the last frame, on white."""
    total = len(scene.times)
    palette = scene.frame(total - 1).quantize(_COLOURS, dither=Image.Dither.NONE)
    entries = np.array(palette.getpalette(), np.uint8).reshape(-1, 3)
    entries[entries.min(axis=1) > 240] = 255
    palette.putpalette(entries.tobytes())
    for index in range(total):
        yield scene.frame(index).quantize(palette=palette, dither=Image.Dither.NONE)
        if progress is not None:
            progress(index + 1, total)


_WIDE_HEIGHTS, _TALL_HEIGHTS = (1.4, 1.4, 1.4), (2.8, 1.2, 1.2, 1.2)  # [in]: heights of rows
_NO_TARGET, _NO_ORIENTATION = "there is no target", "the target has no orientation"
_AXIS_LABELS = (("x [m]", "y [m]"), ("", "z [m]"), ("", "distance [m]"), ("t [s]", "angle [rad]"))
"""Labels of the axes of path, height, distance and angle."""


def end_effector(rollouts: Rollouts, *, frame: str | None = None, **layout: Unpack[Layout]) -> Figure:
    """Draw the path of an end effector from above, its height, and the error of its pose.

    The error has two panels: distance and angle from the target.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Rollouts by label, all in the same axes.
    frame : str, optional
        Name of the frame, see `Rollout.end_effector`; default: the frame with a target, or the tip of the
        first arm.
    **layout
        ``title``, ``ax`` and ``width``, see `plots.states`. The axes show path, height, distance and
        angle.

    Returns
    -------
    figure : matplotlib.figure.Figure
        New figure, or the figure of ``ax``.

    Raises
    ------
    InvalidArgument
        If `rollouts`, ``ax`` or ``width`` is invalid, or a plant has no frames.
    UnknownName
        If there is no frame of this name; the message lists the frames.

    See Also
    --------
    Rollout.end_effector : the poses as numbers
    EndEffectorTracking : controller for a path of poses

    Examples
    --------
    >>> from pinmobile import FixedHeading, Hold, MobileRobot
    >>> from pinmobile import PDGravity, WholeBody, plots, simulate
    >>> robot = MobileRobot.box().mount("ur5")
    >>> base = FixedHeading(Hold((0, 0), duration=0.1), psi=0)
    >>> still = WholeBody(robot, base, Hold(robot.rest[3:], 0.1))
    >>> law = PDGravity(robot, 100, 20)
    >>> run = simulate(robot, law, still, dt=0.01)
    >>> figure = plots.end_effector(run)
    >>> [axes.get_ylabel() for axes in figure.axes]
    ['y [m]', 'z [m]', 'distance [m]', 'angle [rad]']
    """
    tips = evaluate_each(label_rollouts(rollouts), lambda run: run.end_effector(frame))
    sheet = Sheet(9.0, **layout)
    plane, heights, offsets, angles = _pose_panels(sheet)
    for index, (label, tip) in enumerate(tips.items()):
        style = line_style(index, len(tips)) | {"label": label or "travelled"}
        draw_curve(plane, *tip.position[:, :2].T, **style)
        draw_curve(heights, tip.t, tip.position[:, 2], **style)
        if tip.target is not None:
            draw_curve(offsets, tip.t, tip.distance, **style)
            if tip.is_oriented:
                draw_curve(angles, tip.t, tip.angle, **style)
    targets = [(tip.t, tip.target) for tip in tips.values() if tip.target is not None]
    for t, target in {t.tobytes() + target.tobytes(): (t, target) for t, target in targets}.values():
        draw_curve(plane, *target[:, :2, 3].T, **reference_style())
        draw_curve(heights, t, target[:, 2, 3], **reference_style())
    for axes, reason in ((offsets, _NO_TARGET), (angles, _NO_ORIENTATION if offsets.lines else _NO_TARGET)):
        axes.set_ylim(bottom=0.0)
        if not axes.lines:
            axes.text(0.5, 0.5, reason, ha="center", va="center", transform=axes.transAxes)
    names = ", ".join(dict.fromkeys(tip.frame for tip in tips.values()))
    keys = [Line2D([], [], label="target", **reference_style())] if offsets.lines else []
    return sheet.finish(f"End effector {names}", [*keys, *legend_entries(tips, "travelled")])


def _pose_panels(sheet: Sheet) -> list[Axes]:
    """Return the axes: one above the other, or the path beside the axes over time."""
    if sheet.columns(2, 3.2) == 1:
        spots: list[Spot] = [(k, 0) for k in range(4)]
        plane, *time_axes = sheet.axes(spots, _TALL_HEIGHTS, share="")
    else:
        spots = [(slice(None), 0), (0, 1), (1, 1), (2, 1)]
        plane, *time_axes = sheet.axes(spots, _WIDE_HEIGHTS, ratios=(1.2, 1))
    panels = [plane, *time_axes]
    for axes, (x, y) in zip(panels, _AXIS_LABELS, strict=True):
        dress_time(axes)
        axes.set(xlabel=x, ylabel=y)
        axes.ticklabel_format(axis="y", scilimits=(-3, 4), useMathText=True)
    plane.set_aspect("equal", adjustable="datalim")
    plane.margins(0.1)
    return panels
