"""See the robot move: meshcat, live in a browser or recorded as a page, a GIF, a film or a picture."""

from importlib import import_module
from typing import TYPE_CHECKING

from pinmobile.viewer.pages import OfflineWindow
from pinmobile.viewer.recording import Recording, check_films as check_films
from pinmobile.viewer.scene_tree import Arrows, FixedCamera, Follow, Overlays
from pinmobile.viewer.viewer import Viewer

if TYPE_CHECKING:
    from pinmobile.viewer.live_run import LiveRun, play
    from pinmobile.viewer.server import LiveWindow

__all__ = [
    "Arrows",
    "FixedCamera",
    "Follow",
    "LiveRun",
    "LiveWindow",
    "OfflineWindow",
    "Overlays",
    "Recording",
    "Viewer",
    "play",
]


_MODULES = {"LiveRun": "live_run", "LiveWindow": "server", "play": "live_run"}  # a recording needs no server


def __getattr__(name: str) -> object:
    if name in _MODULES:
        return getattr(import_module(f"pinmobile.viewer.{_MODULES[name]}"), name)
    raise AttributeError(f"module 'pinmobile.viewer' has no attribute {name!r}")
