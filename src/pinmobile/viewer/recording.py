"""`Recording`: a scene and its motion, to be kept as a page, a GIF, a film or a picture."""

from collections.abc import Iterator
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from pinmobile.arrays import positive, scalar
from pinmobile.errors import InvalidArgument
from pinmobile.files import written
from pinmobile.viewer.encoding import film, film_encoder, gif
from pinmobile.viewer.page import recorded_page
from pinmobile.viewer.pictures import Progress, checked_size, picture_of, pictures_of

__all__ = ["Recording"]

_FASTEST = 50.0  # [1/s]; browsers slow down GIFs that are faster


class Recording:
    """What was recorded. `Viewer.record` makes it.

    Parameters
    ----------
    commands : list of bytes
        Meshcat's commands for the scene.
    tracks : list of dict
        Meshcat's animations of it, in seconds of the rollout.
    duration : float
        Of the rollout [s].
    fps : float
        Frames per second of a GIF or film.
    speed : float
        Seconds of the rollout per second.
    title : str
        Of the page.
    """

    def __init__(
        self,
        commands: list[bytes],
        tracks: list[dict[str, Any]],
        *,
        duration: float,
        fps: float,
        speed: float,
        title: str,
    ) -> None:
        self.tracks, self.duration, self.fps, self.speed, self.title = tracks, duration, fps, speed, title
        self._commands = commands

    def __repr__(self) -> str:
        return (
            f"<Recording: {self.duration:g} s, {self.fps:g} frames per second, {self.speed:g} times as fast>"
        )

    def html(self) -> str:
        """Return the page that plays it: self-contained, without a request to anywhere."""
        animation = {"tracks": self.tracks, "speed": self.speed, "end": self.duration}
        return recorded_page(self.title, self._commands, animation)

    def save_html(self, path: str | PathLike[str]) -> Path:
        """Write the page that plays it, which opens from the file system.

        Parameters
        ----------
        path : str or path-like
            The file, ending in ``.html``; what is there is replaced.

        Raises
        ------
        InvalidArgument
            If the file cannot be written.
        FileError
            If the system fails, such as of a full disk; what was there is there still.
        """
        return written(path, ".html", lambda: self.html().encode("utf-8"))

    def save_gif(
        self,
        path: str | PathLike[str],
        *,
        fps: float | None = None,
        size: tuple[int, int] = (720, 480),
        progress: Progress | None = None,
    ) -> Path:
        """Write a GIF, by a headless Chromium.

        Parameters
        ----------
        path : str or path-like
            The file, ending in ``.gif``.
        fps : float, optional
            Frames per second, at most 50; by default the recording's.
        size : tuple of 2 int
            Width and height [px].
        progress : callable, optional
            Called as ``progress(done, total)`` after each frame.

        Raises
        ------
        InvalidArgument
            If the file cannot be written or a number is not what is expected.
        FileError
            If the system fails, such as of a full disk; what was there is there still.
        ViewerError
            If there is no Chromium, or it fails.
        """
        rate = positive("fps", min(self.fps, 25.0) if fps is None else fps, "1/s")
        if rate > _FASTEST:
            raise InvalidArgument(f"fps is {fps} 1/s, expected at most {_FASTEST:g}")
        return written(path, ".gif", lambda: gif(self._frames(rate, size, progress), rate))

    def save_mp4(
        self,
        path: str | PathLike[str],
        *,
        fps: float | None = None,
        size: tuple[int, int] = (1280, 720),
        progress: Progress | None = None,
    ) -> Path:
        """Write a film, by a headless Chromium and imageio-ffmpeg (the extra ``pinmobile[mp4]``).

        Parameters are those of `save_gif`; width and height must be even.

        Raises
        ------
        InvalidArgument
            If the file cannot be written or a number is not what is expected.
        FileError
            If the system fails, such as of a full disk; what was there is there still.
        ViewerError
            If there is no Chromium or no imageio-ffmpeg, or one of them fails.
        """
        encoder = film_encoder()
        rate, even = positive("fps", self.fps if fps is None else fps, "1/s"), checked_size(size)
        if even[0] % 2 or even[1] % 2:
            raise InvalidArgument(f"size is {size}, expected even numbers")
        return written(path, ".mp4", lambda: film(encoder, self._frames(rate, size, progress), rate, even))

    def screenshot(
        self, path: str | PathLike[str], *, t: float = 0.0, size: tuple[int, int] = (1200, 800)
    ) -> Path:
        """Write a picture of the scene at a time, by a headless Chromium.

        Parameters
        ----------
        path : str or path-like
            The file, ending in ``.png``.
        t : float
            Time from the rollout's start [s].
        size : tuple of 2 int
            Width and height [px].

        Raises
        ------
        InvalidArgument
            If the file cannot be written, or the time is not in the recording.
        FileError
            If the system fails, such as of a full disk; what was there is there still.
        ViewerError
            If there is no Chromium, or it fails.
        """
        time = scalar("t", t)
        if not 0 <= time <= self.duration:
            raise InvalidArgument(f"t is {t} s, expected 0 <= t <= {self.duration:g} s")
        return written(path, ".png", lambda: picture_of(self.html(), size, time))

    def _frames(self, rate: float, size: tuple[int, int], progress: Progress | None) -> Iterator[Image.Image]:
        times = np.append(np.arange(0.0, self.duration, self.speed / rate), self.duration)
        return pictures_of(self.html(), size, times.tolist(), progress)
