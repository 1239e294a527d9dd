"""`Viewer`: 3D scene of a robot and its rollouts, live or recorded."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from threading import RLock
from time import monotonic, sleep
from typing import TYPE_CHECKING, Any, TypeAlias

from pinmobile.arrays import ArrayLike, finite, instance, label_items, positive, shaped, text
from pinmobile.errors import ViewerError, argument_errors
from pinmobile.files import write_file
from pinmobile.loop import Rollout, at_samples
from pinmobile.plant import robot_at
from pinmobile.viewer.motion import figure, frame_times, row_of, tracks
from pinmobile.viewer.pages import OfflineWindow
from pinmobile.viewer.recording import Recording, recording_page, take_picture
from pinmobile.viewer.scene import Scene
from pinmobile.viewer.scene_tree import Overlays, Stage

if TYPE_CHECKING:
    from pinmobile.viewer.server import LiveWindow

Rollouts: TypeAlias = Rollout | Mapping[str, Rollout]

_LIVE_FPS = 50.0
_PAUSE = 1.0  # [s] pause at the end of a recording before it repeats


class Viewer:
    """A 3D scene of a robot or another plant, live in a browser or recorded.

    A viewer with ``live=False`` records and takes pictures. It opens no process and no port. A live viewer
    serves a page at `url` until it is closed. Several threads may use a viewer at once. A viewer is a context
    manager that closes it.

    Parameters
    ----------
    plant : MobileRobot or other plant
        Plant to draw: its visual geometry ``visual_model``, at the poses ``drawing(q)``. For a plant without
        visual geometry, a box of its ``size`` at its ``pose(q)``.
    live : bool
        Whether to serve a page.
    host : str
        Address to serve at. Only this machine can reach the default.
    port : int, optional
        Port to serve at; default: a free port.
    overlays : Overlays, optional
        Objects beside the robot; default: ``Overlays()``.

    Raises
    ------
    InvalidArgument
        If an argument is invalid, or the plant has no pose.
    ViewerError
        If the viewer cannot serve at this address.

    See Also
    --------
    viewer.Recording : result of ``record``
    viewer.Overlays : paths, arrows, contacts, camera
    viewer.play : a run in real time
    plots.path : the path from above as a figure

    Examples
    --------
    >>> from pinmobile import Circle, ComputedTorque, MobileRobot
    >>> from pinmobile import Tangent, simulate
    >>> from pinmobile.viewer import Viewer
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> motion = Tangent(Circle(1.0, 0.5, 2.0))
    >>> run = simulate(robot, ComputedTorque(robot), motion, dt=0.02)
    >>> recording = Viewer(robot).record(run)
    >>> recording
    <Recording: 2 s, 30 frames per second, 1 times as fast>
    >>> page = recording.html()  # or recording.save_html("run.html")
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
        self.plant, self.overlays = robot_at(plant, 0.0), _check_overlays(overlays, Overlays())
        self._figure = figure(self.plant)
        self._lock, self._closed = RLock(), False
        self._scene: Scene | None = None
        self._recording: Recording | None = None
        self._window: LiveWindow | OfflineWindow = OfflineWindow()
        if live:
            from pinmobile.viewer.server import LiveWindow  # here, since a recording needs no server

            self._window = LiveWindow(host, port)

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop serving. The viewer cannot be used any more."""
        self._closed = True
        self._window.close()

    @property
    def url(self) -> str:
        """Address of the live page; `ViewerError` if the viewer is not live."""
        return str(self._live_window("url").url)

    def wait(self, timeout: float = 60.0) -> None:
        """Wait until a browser shows the live page.

        Parameters
        ----------
        timeout : float
            Longest time to wait [s].

        Raises
        ------
        ViewerError
            If no browser opens the page in time, or the viewer is not live.
        """
        self._live_window("wait").wait(timeout)

    def display(self, q: ArrayLike) -> None:
        """Show the robot at a configuration.

        Parameters
        ----------
        q : array_like, shape (nq,)
            Configuration (x, y, psi, ...) [m, m, rad, ...].

        Raises
        ------
        InvalidArgument
            If `q` has another shape or is not finite.
        ViewerError
            If the viewer is closed.
        """
        pose = row_of(self._figure, self.plant, shaped("q", finite("q", q), (self.plant.nq,)))
        with self._lock:
            self._check_open()
            if self._scene is None:
                scene = self._new_scene(self.overlays)
                scene.draw_robot(pose)
                self._scene = scene  # only when the scene is complete
            self._scene.move(pose)

    def play(
        self, rollout: Rollouts, *, speed: float = 1.0, repeat: float = 1, overlays: Overlays | None = None
    ) -> None:
        """Show a rollout on the live page, and return at its end.

        Ctrl-C stops the playback. The viewer remains usable.

        Parameters
        ----------
        rollout : Rollout or mapping of str to Rollout
            Rollouts by label. The first robot is solid, the others are translucent. Each rollout shows its
            own plant. A rollout without a plant shows the plant of the viewer.
        speed : float
            Seconds of the rollout per second of playback.
        repeat : float
            Number of repetitions; ``math.inf`` repeats until an interruption.
        overlays : Overlays, optional
            Overlays for this playback; default: the overlays of the viewer.

        Raises
        ------
        InvalidArgument
            If an argument is invalid.
        ViewerError
            If the viewer is closed or not live.
        """
        self._live_window("play")
        runs, pace = _check_runs(rollout), positive("speed", speed)
        times = frame_times(runs, _LIVE_FPS, pace)
        with self._lock:
            scene = self._scene = self._new_scene(_check_overlays(overlays, self.overlays))
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
                sleep(_PAUSE)

    def record(
        self,
        rollout: Rollouts,
        *,
        fps: float = 30.0,
        speed: float = 1.0,
        overlays: Overlays | None = None,
        title: str = "pinmobile",
    ) -> Recording:
        """Record a rollout. The recording saves a page, a GIF, a film or a picture.

        Parameters
        ----------
        rollout : Rollout or mapping of str to Rollout
            Rollouts by label, see `play`.
        fps : float
            Frames per second.
        speed : float
            Seconds of the rollout per second of playback. The reader of a page can change the speed.
        overlays : Overlays, optional
            Overlays of this recording; default: the overlays of the viewer.
        title : str
            Title of the page.

        Returns
        -------
        recording : Recording
            Recorded scene and motion.

        Raises
        ------
        InvalidArgument
            If an argument is invalid.
        ViewerError
            If the viewer is closed.
        """
        title = text("title", title)
        runs, rate, pace = _check_runs(rollout), positive("fps", fps, "1/s"), positive("speed", speed)
        times = frame_times(runs, rate, pace)
        with self._lock:
            self._check_open()
            window = OfflineWindow()
            scene = Scene(Stage(window), self._figure, _check_overlays(overlays, self.overlays))
            scene.play(runs, times)
            scene.show(0)
            elapsed = times - times[0]
            animations = tracks(scene.channels, elapsed, float(elapsed[-1]) + _PAUSE * pace)
            self._recording = Recording(
                window.commands(), animations, duration=float(elapsed[-1]), fps=rate, speed=pace, title=title
            )
            return self._recording

    def screenshot(
        self, path: str | PathLike[str], *, t: float | None = None, size: tuple[int, int] = (1200, 800)
    ) -> Path:
        """Write a picture (PNG). A headless Chromium on this machine draws it.

        Parameters
        ----------
        path : str or path-like
            File to write, with the suffix ``.png``.
        t : float, optional
            Time in the last recording [s]; default: the present scene.
        size : tuple of 2 int
            Width and height [px].

        Returns
        -------
        path : pathlib.Path
            The file.

        Raises
        ------
        InvalidArgument
            If an argument is invalid, or the file cannot be written.
        FileError
            If the system fails, for example because the disk is full. An existing file remains unchanged.
        ViewerError
            If the viewer is closed, there is nothing to draw, or Chromium is missing or fails.
        """
        self._check_open()
        if t is not None:
            if self._recording is None:
                raise ViewerError("t needs a recording: call record first")
            return self._recording.screenshot(path, t=t, size=size)
        page = self.static_html()
        return write_file(path, ".png", lambda: take_picture(page, size, 0.0))

    def static_html(self, title: str = "pinmobile") -> str:
        """Return a self-contained page of the present scene as HTML, for example for a notebook.

        Parameters
        ----------
        title : str
            Title of the page.

        Raises
        ------
        ViewerError
            If the viewer is closed, or neither `display` nor `play` was called.
        """
        with self._lock:
            self._check_open()
            if self._scene is None:
                raise ViewerError("there is nothing to draw yet: call display or play first")
            animation = {"tracks": [], "speed": 1, "end": 0}
            return recording_page(text("title", title), self._window.commands(), animation)

    def _new_scene(self, overlays: Overlays) -> Scene:
        stage = Stage(self._window)
        stage.remove("meshcat")
        return Scene(stage, self._figure, overlays)

    def _live_window(self, name: str) -> LiveWindow:
        self._check_open()
        if isinstance(self._window, OfflineWindow):
            raise ViewerError(f"{name} needs a live viewer: Viewer(plant, live=True)")
        return self._window

    def _check_open(self) -> None:
        if self._closed:
            raise ViewerError("the viewer is closed")


def _check_overlays(overlays: Overlays | None, default: Overlays) -> Overlays:
    checked: Overlays = instance("overlays", default if overlays is None else overlays, Overlays, "Overlays")
    return checked


def _check_runs(rollouts: object) -> dict[str, Rollout]:
    """Return the rollouts by label; a single rollout has the label "".

    Raises
    ------
    InvalidArgument
        If the argument is not a rollout or a mapping, or is empty, or a plant has no pose.
    """
    runs = {label: at_samples(run) for label, run in label_items("rollout", rollouts, Rollout).items()}
    for label, run in runs.items():
        with argument_errors(f"rollout[{label!r}]." if label else "rollout."):
            _ = run.poses, run.reference_poses
    return runs
