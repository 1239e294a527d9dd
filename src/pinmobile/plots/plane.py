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
from PIL import Image

from pinmobile.arrays import Array, ArrayLike, bounded, callable_as, finite, positive, scalar, shaped
from pinmobile.errors import InvalidArgument
from pinmobile.files import write_file
from pinmobile.loop import Rollout
from pinmobile.plant import stated
from pinmobile.plots.style import (
    Layout,
    Rollouts,
    Sheet,
    Spot,
    Style,
    checked_title,
    colour,
    curve,
    desired,
    dress,
    dress_time,
    heading,
    ink,
    keys_of,
    labelled,
    letters,
    line_style,
    of_each,
    over,
    same_references,
    si,
    thinned,
    wrapped,
)

_POSTURES = 100  # of an arm, which the window shows
_EDGE = withStroke(linewidth=4.4, foreground="white")
_ARMS: Style = {"color": "#222222", "linewidth": 2.2, "solid_capstyle": "round", "path_effects": [_EDGE]}
_ARROW = 0.06  # length of the arrowhead of a plant without size, as a share of the axes

#         ______________
#        |    |\        |
#        |    |   \     |        the nose points along x_B
#        |    |   /     |
#        |____|/________|
_NOSE = np.array([[-0.1, -0.38], [0.48, 0.0], [-0.1, 0.38]])  # of length and width
_BOX = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
_DART = np.array([[0.6, 0.0], [-0.4, 0.35], [-0.2, 0.0], [-0.4, -0.35]])


class Body:
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
    otherwise : float
        Length of the arrowhead of a plant without size [m].
    **style
        Properties of all patches, such as ``zorder``.

    Attributes
    ----------
    patches : list of Polygon
        Patches; the outline comes first.
    """

    def __init__(self, axes: Axes, plant: object, colour: str, otherwise: float, **style: Any) -> None:
        size = _size(plant)
        self._shapes = [_BOX * size, _NOSE * size] if size is not None else [_DART * otherwise]
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
    robot = run.plant if stated(run.plant, "frame_placements") is not None else stated(run.plant, "robot")
    mounts = stated(robot, "mounts") or ()
    if not mounts:
        return np.zeros((len(times), 0, 2))
    q = np.stack([np.interp(times, run.t, column) for column in run.q[:, : robot.nq].T], axis=-1)
    joints, model = np.moveaxis(robot.frame_placements(q)[..., :2, 3], 1, 0), robot.model
    lines = []
    for mount in mounts:
        own = range(mount.joints.start, mount.joints.stop)
        lines += [(joints[model.parents[k] - 1], joints[k - 1]) for k in own if model.parents[k] in own]
        hand = model.frames[model.getFrameId(mount.tip)].parentJoint
        lines.append((joints[hand - 1], robot.frame_pose(q, mount.tip)[:, :2, 3]))
    gap = np.full((len(times), 2), np.nan)
    return np.stack([point for start, end in lines for point in (start, end, gap)], axis=1)


def diagonal(plant: object, otherwise: float) -> float:
    """Return the diagonal of the plant's outline [m], or `otherwise` if the plant has no size."""
    size = _size(plant)
    return otherwise if size is None else float(np.hypot(*size))


def _size(plant: object) -> Array | None:
    """Return length and width [m], or None for a plant without size."""
    try:
        size = finite("size", getattr(plant, "size", ()))
    except InvalidArgument:
        return None
    return size[:2] if size.ndim == 1 and len(size) >= 2 and (size[:2] > 0).all() else None


_BOXES = 8


def _travelled() -> Style:
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
        Times at which the robot is drawn [s]; default: up to 8 times, spread along the path.
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
    'position error at most 200 mm'
    """
    runs = labelled(rollouts)
    of_each(runs, lambda run: run.poses)
    instants: dict[str, Array] = {}
    for labels in same_references(runs).values():  # equal references have equal times, for comparison
        instants |= dict.fromkeys(labels, _spread(runs[labels[0]]))
    if times is not None:
        given = shaped("times", np.atleast_1d(finite("times", times)), ("n",))
        for label, run in runs.items():
            least, most = float(run.t[0]), float(run.t[-1])
            instants[label] = bounded("times", given, least=least, most=most, unit="s")
    figure, axes = panels(runs, "Desired and travelled path", **layout)
    otherwise = _arrowhead(axes[0])
    for index, (label, run) in enumerate(runs.items()):
        curve(axes[index], *run.poses[:, :2].T, color=colour(index), label="travelled", **_travelled())
        drawn = zip(
            instants[label], poses(run, instants[label]), arm_links(run, instants[label]), strict=True
        )
        for t, pose, arms in drawn:
            Body(axes[index], run.plant, colour(index), otherwise, zorder=5).move(pose)
            if len(arms):
                axes[index].plot(*arms.T, **_ARMS, zorder=5.5)
            _write_time(axes[index], t, pose, 0.5 * diagonal(run.plant, otherwise))
    return figure


def panels(
    runs: Mapping[str, Rollout], default: str, *, known: bool = True, **layout: Unpack[Layout]
) -> tuple[Figure, list[Axes]]:
    """Return a figure with a panel for each rollout, with its desired path, and a legend below.

    Parameters
    ----------
    runs : mapping of str to Rollout
        Rollouts by label.
    default : str
        Default heading.
    known : bool
        See `Sheet`.
    **layout
        See `Sheet`.
    """
    most = min(len(runs), 3)
    largest = (8.6 / most - 0.4, 4.8) if most > 1 else (7.0, 5.6)  # [in]
    shape = _shape(_window(runs, largest[0]))
    size = min(largest[0] / shape[0], largest[1] / shape[1])
    sheet = Sheet(0.85 + most * (shape[0] * size + 0.3) - 0.3, known=known, **layout)
    columns, keys = sheet.columns(most, 1.7), list(_keys(runs))
    window = _window(runs, sheet.width / columns)
    shape = _shape(window)
    room = (sheet.width - 5.5 * letters() / 72) / columns
    off = [si(float(run.distance.max()), "m") for run in runs.values()]
    notes = [wrapped(f"position error at most {each}", letters(0.95), room) for each in off]
    labels = [wrapped(label, letters(1.2), room, weight="bold") for label in runs]
    height, spots = 0.0, [divmod(k, columns) for k in range(len(runs))]
    if sheet.new:
        sizes = zip([1 + note.count("\n") for note in notes], labels, strict=True)
        above = max(lines + 1.5 * bool(label) * (label.count("\n") + 1) for lines, label in sizes)
        outside = sheet.below(keys), sheet.heading(default)
        height, grid = _placed(sheet, spots, shape, 1.3 * above + 0.8, *outside)
    else:
        grid = sheet.axes(spots, [3.0] * -(-len(runs) // columns), share="")
    for index, (axes, run) in enumerate(zip(grid, runs.values(), strict=True)):
        left, lowest = index % columns == 0, index + columns >= len(runs)
        dress(axes)
        axes.set_aspect("equal")
        axes.set(xlim=window[:, 0], ylim=window[:, 1])
        axes.set(xlabel="x [m]" if lowest else "", ylabel="y [m]" if left else "")
        axes.tick_params(labelleft=left, labelbottom=lowest)
        axes.set_title(notes[index], fontsize=letters(0.95))
        offset = 0, over(notes[index].count("\n") + 1)
        axes.annotate(labels[index], (0.5, 1), offset, ha="center", **heading(index))
        curve(axes, *run.reference_poses[:, :2].T, label="desired", **desired())
    return sheet.finish(default, keys, height=height), grid


def _placed(
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
    em = letters() / 72
    rows, columns = (1 + max(place) for place in zip(*spots, strict=True))
    left, right, beside = 4.7 * em, 1.4 * em, 2.2 * em
    below, between, above = keys + 3.4 * em, (titles + 1.8) * em, titles * em + heading
    wide = (sheet.width - left - right - beside * (columns - 1)) / columns
    tall = max(wide, em) * shape[1] / shape[0]
    height = below + rows * tall + (rows - 1) * between + above
    figure = sheet.figure
    figure.set_layout_engine("none")
    made: list[Axes] = []
    for row, column in spots:
        corner = left + column * (wide + beside), below + (rows - 1 - row) * (tall + between)
        place = corner[0] / sheet.width, corner[1] / height, max(wide, em) / sheet.width, tall / height
        shared = made[0] if made else None
        made.append(figure.add_axes(place, sharex=shared, sharey=shared))
    return height, made


def poses(run: Rollout, times: Array) -> Array:
    """Return the actual poses at `times`, shape (n, 3) [m, m, rad], by linear interpolation."""
    x, y, psi = run.poses.T
    return np.stack([np.interp(times, run.t, column) for column in (x, y, np.unwrap(psi))], axis=-1)


def _keys(runs: Mapping[str, Rollout]) -> Iterator[Patch | Line2D]:
    shade = colour(0) if len(runs) == 1 else "#777777"
    yield Line2D([], [], label="desired", **desired())
    yield Line2D([], [], label="travelled", color=shade, **_travelled())
    yield Patch(facecolor=(*(0.6,) * 3, 0.4), edgecolor=shade, label="robot")
    if any(arm_links(run, run.t[:1]).size for run in runs.values()):
        yield Line2D([], [], label="arm", **_ARMS)


def _shape(window: Array) -> Array:
    """Return the side lengths of a window; the longer side is 1."""
    sides = window[1] - window[0]
    return np.asarray(sides / sides.max())


def _arrowhead(axes: Axes) -> float:
    """Return the length of the arrowhead of a robot without size [m]."""
    return _ARROW * float(np.max(np.diff([axes.get_xlim(), axes.get_ylim()])))


def _window(runs: Mapping[str, Rollout], wide: float) -> Array:
    """Return the corners of the window of panels of a width [in], shape (2, 2) [m], with room for labels."""
    both = [part[:, :2] for run in runs.values() for part in (run.poses, run.reference_poses)]
    both += [arm_links(run, run.t[:: -(-len(run) // _POSTURES)]).reshape(-1, 2) for run in runs.values()]
    points = np.concatenate(both)
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    extent = float((high - low).max())
    robot = max(diagonal(run.plant, _ARROW * extent) for run in runs.values())
    words = min(2.6 * letters() / 72 / wide, 0.25)
    margin = 0.5 * robot + max(0.12, words / (1 - 2 * words)) * max(extent, robot) or 1.0
    room = np.maximum(0.25 * extent - 0.5 * (high - low), 0.0)  # a straight line needs some height too
    return np.stack([low - margin - room, high + margin + room])


def _write_time(axes: Axes, t: float, pose: Array, beside: float) -> None:
    """Write the time to the right of the robot."""
    right = float(np.sin(pose[2])), float(-np.cos(pose[2]))
    spot = pose[0] + beside * right[0], pose[1] + beside * right[1]
    offset = letters(1.8) * right[0], letters(0.9) * right[1]  # text is wider than high
    text: Style = {"ha": "center", "va": "center", "fontsize": letters(0.9), "color": ink(), "zorder": 6}
    axes.annotate(f"{t:.3g} s", spot, offset, textcoords="offset points", **text)


def _spread(run: Rollout) -> Array:
    """Return times at which drawings of the robot do not overlap, shape (n,) [s]."""
    xy = run.poses[:, :2]
    robot = diagonal(run.plant, _ARROW * float(np.ptp(xy, axis=0).max()))
    travelled = np.append(0.0, np.cumsum(np.hypot(*np.diff(xy, axis=0).T)))
    count = int(min(_BOXES - 1, travelled[-1] / (1.5 * robot))) if robot else 0
    between = np.searchsorted(travelled, np.linspace(0.0, travelled[-1], count + 1)[1:-1])
    kept: list[int] = []
    for k in (0, len(xy) - 1, *between):
        if all(np.hypot(*(xy[k] - xy[other])) > robot for other in kept):
            kept.append(int(k))
    return np.asarray(run.t[sorted(kept)])


_LASTS = 10.0  # [s], default duration of the GIF of a longer run
_HELD = 1.0  # [s], duration of the last frame
_FASTEST = 50.0  # [1/s]; browsers slow down faster GIFs
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
    runs = labelled(rollouts)
    of_each(runs, lambda run: run.poses)
    rate = bounded("fps", scalar("fps", fps), above=0, most=_FASTEST, unit="1/s")
    start, end = min(run.t[0] for run in runs.values()), max(run.t[-1] for run in runs.values())
    pace = max((end - start) / _LASTS, 1.0) if speed is None else positive("speed", speed)
    times = np.append(np.arange(start, end - 1e-9 * pace, pace / rate), end)
    if progress is not None:
        callable_as("progress(done, total)", progress)
    frames = _frames(_Scene(runs, times, checked_title(title) or "", pace), progress)
    ticks = np.round(100 * np.arange(len(times) + 1) / rate)  # of a GIF's hundredths of a second
    stand = [*(10 * np.diff(ticks[:-1])).astype(int).tolist(), round(1000 * _HELD)]  # [ms]

    def gif() -> bytes:
        buffer = BytesIO()
        next(frames).save(buffer, "GIF", save_all=True, append_images=frames, duration=stand, loop=0)
        return buffer.getvalue()

    return write_file(path, ".gif", gif)


def _agg(figure: Figure) -> Any:
    """Return a canvas without a window; the untyped class of matplotlib needs `Any`."""
    return FigureCanvasAgg(figure)


class _Scene:
    """Figure of an animation; its static parts are drawn once."""

    def __init__(self, runs: Mapping[str, Rollout], times: Array, title: str, pace: float) -> None:
        figure, panes = panels(runs, "", known=False)
        figure.set_dpi(_DPI)
        self.figure, self.times = figure, times
        self.canvas = _agg(figure)
        words = title if pace == 1 else f"{title} ({pace:.3g} times as fast)".lstrip()
        size, left, right = letters(1.2), panes[0].get_position().x0, panes[-1].get_position().x1
        high = 1 - size / 144 / figure.get_figheight()
        figure.text(left, high, words, va="top", fontsize=size)
        # Text is slow to draw: each frame draws only the time of the caption.
        clock: Style = {"ha": "right", "va": "top", "fontsize": size, "animated": True}
        self.clock = figure.text(right, high, "", **clock)
        self.movers = [
            _Mover(run, times, axes, colour(index))
            for index, (run, axes) in enumerate(zip(runs.values(), panes, strict=True))
        ]
        self.canvas.draw()
        self.still = self.canvas.copy_from_bbox(figure.bbox)

    def frame(self, index: int) -> Image.Image:
        """Return the frame of an index in full colour."""
        self.canvas.restore_region(self.still)
        self.clock.set_text(f"t = {self.times[index]:.1f} s")
        self.figure.draw_artist(self.clock)
        for mover in self.movers:
            mover.draw(index)
        size = self.canvas.get_width_height(physical=True)
        return Image.frombytes("RGB", size, self.canvas.buffer_rgba(), "raw", "RGBX")


class _Mover:
    """Moving robot in its panel, with the line of its travelled path."""

    def __init__(self, run: Rollout, times: Array, axes: Axes, shade: str) -> None:
        xy = run.poses[:, :2]
        kept = thinned(*xy.T)
        self.xy, self.reached = xy[kept], np.searchsorted(run.t[kept], times)
        self.poses, self.arms, self.axes = poses(run, times), arm_links(run, times), axes
        self.body = Body(axes, run.plant, shade, _arrowhead(axes), animated=True)
        (self.desired,) = axes.lines  # drawn again, above the travelled path
        (self.line,) = axes.plot([], [], color=shade, animated=True, **_travelled())
        (self.links,) = axes.plot([], [], animated=True, **_ARMS)

    def draw(self, index: int) -> None:
        """Draw robot and line in the frame of an index."""
        pose = self.poses[index]
        self.line.set_data(*np.vstack([self.xy[: self.reached[index]], pose[:2]]).T)
        self.links.set_data(*self.arms[index].T)
        self.body.move(pose)
        for artist in (self.line, self.desired, *self.body.patches, self.links):
            self.axes.draw_artist(artist)


def _frames(scene: _Scene, progress: Callable[[int, int], object] | None) -> Iterator[Image.Image]:
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


_WIDE, _TALL = (1.4, 1.4, 1.4), (2.8, 1.2, 1.2, 1.2)  # [in]: heights of rows
_NO_TARGET, _NO_ORIENTATION = "there is no target", "the target has no orientation"
_PLACES = (("x [m]", "y [m]"), ("", "z [m]"), ("", "distance [m]"), ("t [s]", "angle [rad]"))
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
    hands = of_each(labelled(rollouts), lambda run: run.end_effector(frame))
    sheet = Sheet(9.0, **layout)
    above, height, way, turn = _panels(sheet)
    for index, (label, hand) in enumerate(hands.items()):
        style = line_style(index, len(hands)) | {"label": label or "travelled"}
        curve(above, *hand.position[:, :2].T, **style)
        curve(height, hand.t, hand.position[:, 2], **style)
        if hand.target is not None:
            curve(way, hand.t, hand.distance, **style)
            if hand.is_oriented:
                curve(turn, hand.t, hand.angle, **style)
    aimed = [(hand.t, hand.target) for hand in hands.values() if hand.target is not None]
    for t, target in {t.tobytes() + target.tobytes(): (t, target) for t, target in aimed}.values():
        curve(above, *target[:, :2, 3].T, **desired())
        curve(height, t, target[:, 2, 3], **desired())
    for axes, none in ((way, _NO_TARGET), (turn, _NO_ORIENTATION if way.lines else _NO_TARGET)):
        axes.set_ylim(bottom=0.0)
        if not axes.lines:
            axes.text(0.5, 0.5, none, ha="center", va="center", transform=axes.transAxes)
    names = ", ".join(dict.fromkeys(hand.frame for hand in hands.values()))
    keys = [Line2D([], [], label="target", **desired())] if way.lines else []
    return sheet.finish(f"End effector {names}", [*keys, *keys_of(hands, "travelled")])


def _panels(sheet: Sheet) -> list[Axes]:
    """Return the axes: one above the other, or the path beside the axes over time."""
    if sheet.columns(2, 3.2) == 1:
        spots: list[Spot] = [(k, 0) for k in range(4)]
        above, *later = sheet.axes(spots, _TALL, share="")
    else:
        spots = [(slice(None), 0), (0, 1), (1, 1), (2, 1)]
        above, *later = sheet.axes(spots, _WIDE, ratios=(1.2, 1))
    panels = [above, *later]
    for axes, (x, y) in zip(panels, _PLACES, strict=True):
        dress_time(axes)
        axes.set(xlabel=x, ylabel=y)
        axes.ticklabel_format(axis="y", scilimits=(-3, 4), useMathText=True)
    above.set_aspect("equal", adjustable="datalim")
    above.margins(0.1)
    return panels
