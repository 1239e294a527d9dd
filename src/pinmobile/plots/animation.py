"""The moving robot, as a GIF."""

from collections.abc import Callable, Iterator, Mapping
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from pinmobile.arrays import Array, callable_as, positive
from pinmobile.errors import InvalidArgument
from pinmobile.files import written
from pinmobile.palette import INK, colour
from pinmobile.plots.body import ARROW, Body
from pinmobile.plots.plane import TRAVELLED, panels, poses
from pinmobile.plots.runs import Rollouts, planar, thinned
from pinmobile.plots.style import headed
from pinmobile.simulation import Rollout

__all__ = ["animate"]

_LASTS = 10.0  # [s]; by default a longer run is shown in this time
_HELD = 1.0  # [s] for which the last frame stands
_FASTEST = 50.0  # [1/s]; browsers slow down GIFs that are faster
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
    """Write a GIF of the robot that moves along its path: its actual pose, and what it has travelled.

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        Each gets a panel; a shorter one waits at its end.
    path : str or path-like
        The file, ending in ``.gif``; what is there is replaced.
    fps : float
        Frames per second of the GIF, at most 50.
    speed : float, optional
        Seconds of the run per second of the GIF. By default 1, and more for a run of more than 10 s, which
        is shown in 10 s. The last frame stands for a second longer.
    title : str, optional
        Heading, beside the time.
    progress : callable, optional
        Called as ``progress(done, total)`` after each frame.

    Returns
    -------
    path : pathlib.Path
        The file.

    Raises
    ------
    InvalidArgument
        If `rollouts` is something else or has no pose, a number is not positive, or the file cannot be
        written.
    FileError
        If the system fails, such as of a full disk; what was there is there still.
    """
    runs = planar(rollouts)
    rate = positive("fps", fps, "1/s")
    if rate > _FASTEST:
        raise InvalidArgument(f"fps is {fps} 1/s, expected at most {_FASTEST:g}")
    start, end = min(run.t[0] for run in runs.values()), max(run.t[-1] for run in runs.values())
    pace = max((end - start) / _LASTS, 1.0) if speed is None else positive("speed", speed)
    times = np.append(np.arange(start, end - 1e-9 * pace, pace / rate), end)
    if progress is not None:
        callable_as("progress(done, total)", progress)
    scene = _Scene(runs, times, headed(title, ""), pace)
    return written(path, ".gif", lambda: _gif(_rendered(scene, progress), _durations(len(times), rate)))


def _gif(frames: Iterator[Image.Image], durations: list[int]) -> bytes:
    buffer = BytesIO()
    next(frames).save(buffer, "GIF", save_all=True, append_images=frames, duration=durations, loop=0)
    return buffer.getvalue()


def _agg(figure: Figure) -> Any:
    """Return a canvas without window for the figure; matplotlib's own is untyped."""
    return FigureCanvasAgg(figure)


class _Scene:
    """A figure whose still parts are drawn once."""

    def __init__(self, runs: Mapping[str, Rollout], times: Array, title: str, pace: float) -> None:
        self.figure, window, axes = panels(runs, "")
        self.figure.set_dpi(_DPI)
        self.canvas = _agg(self.figure)
        self.times = times
        (heading,) = self.figure.texts
        heading.set_text(title if pace == 1 else f"{title} ({pace:.3g} times as fast)".lstrip())
        heading.set(x=self.figure.subplotpars.left, ha="left")
        # Text is slow to draw: of the caption, only the time is drawn in each frame.
        place = self.figure.subplotpars.right, heading.get_position()[1]
        self.clock = self.figure.text(*place, "", ha="right", va="top", fontsize=14, color=INK, animated=True)
        self.movers = [
            _Mover(run, times, panel, Body(panel, run.plant, shade, ARROW * window.extent, animated=True))
            for run, panel, shade in zip(runs.values(), axes, map(colour, range(len(runs))), strict=True)
        ]
        self.canvas.draw()
        self.still = self.canvas.copy_from_bbox(self.figure.bbox)

    def frame(self, index: int) -> Image.Image:
        """Return the scene at the time with this index, in full colour."""
        self.canvas.restore_region(self.still)
        self.clock.set_text(f"t = {self.times[index]:.1f} s")
        self.figure.draw_artist(self.clock)
        for mover in self.movers:
            mover.draw(index)
        size = self.canvas.get_width_height(physical=True)
        return Image.frombytes("RGB", size, self.canvas.buffer_rgba(), "raw", "RGBX")


class _Mover:
    """A robot in its panel, and the line behind it."""

    def __init__(self, run: Rollout, times: Array, axes: Axes, body: Body) -> None:
        xy = run.poses[:, :2]
        kept = thinned(xy[:, 0], xy[:, 1])
        self.xy, self.reached = xy[kept], np.searchsorted(run.t[kept], times)
        self.poses, self.axes, self.body = poses(run, times), axes, body
        (self.desired,) = axes.lines  # drawn again, above what is travelled
        (self.line,) = axes.plot([], [], color=body.colour, animated=True, **TRAVELLED)

    def draw(self, index: int) -> None:
        """Draw both at the time with this index."""
        pose = self.poses[index]
        behind = np.vstack([self.xy[: self.reached[index]], pose[:2]])
        self.line.set_data(behind[:, 0], behind[:, 1])
        self.body.move(pose)
        for artist in (self.line, self.desired, *self.body.patches):
            self.axes.draw_artist(artist)


def _rendered(scene: _Scene, progress: Callable[[int, int], object] | None) -> Iterator[Image.Image]:
    """Yield the frames, all in the colours of the last one, which shows everything there is."""
    total = len(scene.times)
    palette = _palette(scene.frame(total - 1))
    for index in range(total):
        yield scene.frame(index).quantize(palette=palette, dither=Image.Dither.NONE)
        if progress is not None:
            progress(index + 1, total)


def _palette(image: Image.Image) -> Image.Image:
    """Return an image with a palette of the colours of `image`; its background stays white."""
    palette = image.quantize(_COLOURS, dither=Image.Dither.NONE)
    entries = np.array(palette.getpalette(), np.uint8).reshape(-1, 3)
    entries[entries.min(axis=1) > 240] = 255
    palette.putpalette(entries.tobytes())
    return palette


def _durations(count: int, fps: float) -> list[int]:
    """Return how long each frame stands [ms], in a GIF's hundredths of a second, which sum up right."""
    ticks = np.round(100 * np.arange(count + 1) / fps).astype(int)
    durations = 10 * np.diff(ticks)
    durations[-1] = round(1000 * _HELD)
    return [int(d) for d in durations]
