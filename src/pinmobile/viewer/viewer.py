"""`Viewer`: a robot and its rollouts on meshcat's stage, live or recorded."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from threading import RLock
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from pinmobile.arrays import ArrayLike, by_label, finite, instance, positive, shaped, text
from pinmobile.errors import InvalidArgument, ViewerError
from pinmobile.files import written
from pinmobile.loop import Rollout
from pinmobile.viewer.motion import Drawing, figure, frame_times, tracks
from pinmobile.viewer.pages import OfflineWindow
from pinmobile.viewer.recording import Recording, picture_of, recorded_page
from pinmobile.viewer.scene import Scene
from pinmobile.viewer.scene_tree import Overlays, Stage

if TYPE_CHECKING:
    from pinmobile.viewer.window import LiveWindow

Rollouts: TypeAlias = Rollout | Mapping[str, Rollout]

_FARTHEST = 1e9  # m; beyond, there is nothing to be seen
_LIVE_FPS = 50.0
_HELD = 1.0  # [s] that a recording stands at its end before it begins again


class Viewer:
    """A robot or other plant on meshcat's stage.

    Without `live` it opens nothing: no process, no port; it records and takes pictures. A live one serves
    a page at `url` until it is closed. It may be called from several threads.

    Parameters
    ----------
    plant : MobileRobot or other plant
        Whose `visual_model` is drawn, where its ``drawing(q)`` puts the objects; of one without, a box of its
        ``size`` at its ``pose(q)``.
    live : bool
        Serve a page.
    host : str
        Address to serve at; only this machine can reach the default.
    port : int, optional
        To serve at; by default one that is free.
    overlays : Overlays, optional
        What is shown beside the robot.

    Raises
    ------
    InvalidArgument
        If an argument is not what is expected.
    ViewerError
        If the page cannot be served there.
    """

    def __init__(
        self,
        plant: Any,
        *,
        live: bool = False,
        host: str = "127.0.0.1",
        port: int | None = None,
        overlays: Overlays | None = None,
    ) -> None:
        instance("live", live, bool, "True or False")
        self.plant, self.overlays = plant, _checked_overlays(overlays, Overlays())
        self._figure = figure(plant)
        self._lock, self._closed = RLock(), False
        self._scene: Scene | None = None
        self._recording: Recording | None = None
        self._window: LiveWindow | OfflineWindow = OfflineWindow()
        if live:
            from pinmobile.viewer.window import LiveWindow  # here, since a recording needs no server

            self._window = LiveWindow(host, port)

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop serving. A closed viewer does nothing more."""
        self._closed = True
        self._window.close()

    @property
    def url(self) -> str:
        """Address of the live page."""
        return str(self._live("url").url)

    def wait(self, timeout: float = 60.0) -> None:
        """Wait until a browser shows the live page.

        Parameters
        ----------
        timeout : float
            [s].

        Raises
        ------
        ViewerError
            If none has come by then, or the viewer is not live.
        """
        self._live("wait").wait(timeout)

    def display(self, q: ArrayLike) -> None:
        """Show the robot at a configuration.

        Parameters
        ----------
        q : array_like, shape (nq,)
            (x, y, psi, ...) [m, m, rad, ...].

        Raises
        ------
        InvalidArgument
            If it is something else, or not finite.
        ViewerError
            If the viewer is closed.
        """
        given = shaped("q", finite("q", q), (self.plant.nq,))
        pose = given
        if isinstance(self._figure, Drawing):
            pose = self._figure.row(given)
        elif self._figure is not self.plant:
            pose = np.asarray(self.plant.pose(given))
        if abs(pose[:2]).max() > _FARTHEST:
            raise InvalidArgument(f"q is {pose.tolist()}, expected x and y within {_FARTHEST:g} m")
        with self._lock:
            self._check_open()
            if self._scene is None:
                scene = self._new_scene(self.overlays)
                scene.alone(pose)
                self._scene = scene  # not before it is whole
            self._scene.move(pose)

    def play(
        self,
        rollout: Rollouts,
        *,
        speed: float = 1.0,
        repeat: float = 1,
        overlays: Overlays | None = None,
    ) -> None:
        """Show a rollout as it goes on, and return at its end.

        Ctrl-C ends it where it is; the viewer can be used on.

        Parameters
        ----------
        rollout : Rollout or mapping of str to Rollout
            The first is solid, the others are ghosts. Each is drawn as its own plant, the viewer's where it
            has none.
        speed : float
            Seconds of the rollout per second.
        repeat : float
            How often; ``math.inf`` goes on until it is interrupted.
        overlays : Overlays, optional
            In place of the viewer's.

        Raises
        ------
        InvalidArgument
            If an argument is not what is expected.
        ViewerError
            If the viewer is closed or not live.
        """
        self._live("play")
        runs, pace = _checked_runs(rollout), positive("speed", speed)
        times = frame_times(runs, _LIVE_FPS, pace)
        with self._lock:
            scene = self._scene = self._new_scene(_checked_overlays(overlays, self.overlays))
            scene.play(runs, times)
        done = 0
        while done < repeat:
            done += 1
            begin, frame = monotonic(), -1
            while frame < len(times) - 1:
                frame = max(frame + 1, int((monotonic() - begin) * _LIVE_FPS))
                with self._lock:
                    self._check_open()
                    scene.show(min(frame, len(times) - 1))
                sleep(max(begin + (frame + 1) / _LIVE_FPS - monotonic(), 0.0))
            if done < repeat:
                sleep(_HELD)

    def record(
        self,
        rollout: Rollouts,
        *,
        fps: float = 30.0,
        speed: float = 1.0,
        overlays: Overlays | None = None,
        title: str = "pinmobile",
    ) -> Recording:
        """Record a rollout, to be kept as a page, a GIF, a film or a picture.

        Parameters
        ----------
        rollout : Rollout or mapping of str to Rollout
            The first is solid, the others are ghosts. Each is drawn as its own plant, the viewer's where it
            has none.
        fps : float
            Frames per second.
        speed : float
            Seconds of the rollout per second; a page can be told another.
        overlays : Overlays, optional
            In place of the viewer's.
        title : str
            Of the page.

        Raises
        ------
        InvalidArgument
            If an argument is not what is expected.
        ViewerError
            If the viewer is closed.
        """
        title = text("title", title)
        runs, rate, pace = _checked_runs(rollout), positive("fps", fps, "1/s"), positive("speed", speed)
        times = frame_times(runs, rate, pace)
        with self._lock:
            self._check_open()
            window = OfflineWindow()
            scene = Scene(Stage(window), self._figure, _checked_overlays(overlays, self.overlays))
            scene.play(runs, times)
            scene.show(0)
            since = times - times[0]
            moving = tracks(scene.channels, since, float(since[-1]) + _HELD * pace)
            self._recording = Recording(
                window.commands(), moving, duration=float(since[-1]), fps=rate, speed=pace, title=title
            )
            return self._recording

    def screenshot(
        self, path: str | PathLike[str], *, t: float | None = None, size: tuple[int, int] = (1200, 800)
    ) -> Path:
        """Write a picture (PNG), by a headless Chromium found on the machine.

        Parameters
        ----------
        path : str or path-like
            The file, ending in ``.png``.
        t : float, optional
            Time in the last recording [s]; by default the scene is drawn as it is now.
        size : tuple of 2 int
            Width and height [px].

        Raises
        ------
        InvalidArgument
            If an argument is not what is expected, or the file cannot be written.
        FileError
            If the system fails, such as of a full disk; what was there is there still.
        ViewerError
            If the viewer is closed, there is nothing to draw, or no Chromium, or it fails.
        """
        self._check_open()
        if t is not None:
            if self._recording is None:
                raise ViewerError("there is no recording to take a picture of: call record first")
            return self._recording.screenshot(path, t=t, size=size)
        page = self.static_html()
        return written(path, ".png", lambda: picture_of(page, size, 0.0))

    def static_html(self, title: str = "pinmobile") -> str:
        """Return a self-contained page of the scene as it is now, such as for a notebook.

        Raises
        ------
        ViewerError
            If the viewer is closed, or nothing has been shown yet.
        """
        with self._lock:
            self._check_open()
            if self._scene is None:
                raise ViewerError("there is nothing to draw yet: call display or play first")
            return recorded_page(
                text("title", title), self._window.commands(), {"tracks": [], "speed": 1, "end": 0}
            )

    def _new_scene(self, overlays: Overlays) -> Scene:
        stage = Stage(self._window)
        stage.remove("meshcat")
        return Scene(stage, self._figure, overlays)

    def _live(self, what: str) -> LiveWindow:
        self._check_open()
        if isinstance(self._window, OfflineWindow):
            raise ViewerError(f"{what} needs a live viewer: Viewer(plant, live=True)")
        return self._window

    def _check_open(self) -> None:
        if self._closed:
            raise ViewerError("the viewer is closed")


def _checked_overlays(overlays: Overlays | None, default: Overlays) -> Overlays:
    found: Overlays = instance("overlays", default if overlays is None else overlays, Overlays, "Overlays")
    return found


def _checked_runs(rollouts: object) -> dict[str, Rollout]:
    """Return the rollouts by label; a single one has the label "".

    Raises
    ------
    InvalidArgument
        If it is something else, holds nothing, or the plant of one does not tell where its body is.
    """
    runs = by_label("rollout", rollouts, Rollout)
    for label, run in runs.items():
        try:
            _ = run.poses, run.reference_poses
        except InvalidArgument as error:
            where = f"rollout[{label!r}]" if label else "rollout"
            raise InvalidArgument(f"{where}.{error}") from None
    return runs
