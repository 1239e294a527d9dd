"""See the robot move: meshcat, live in a browser or recorded as a page, a GIF, a film or a picture."""

from typing import TYPE_CHECKING

from pinmobile.viewer.pages import OfflineWindow
from pinmobile.viewer.recording import Recording, check_films as check_films
from pinmobile.viewer.scene_tree import Arrows, FixedCamera, Follow, Overlays
from pinmobile.viewer.viewer import Viewer

if TYPE_CHECKING:
    from pinmobile.viewer.live_run import LiveRun, play
    from pinmobile.viewer.window import LiveWindow

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


def __getattr__(name: str) -> object:
    if name == "LiveWindow":  # a recording needs no server
        from pinmobile.viewer.window import LiveWindow

        return LiveWindow
    if name in ("LiveRun", "play"):
        import pinmobile.viewer.live_run as found

        return getattr(found, name)
    raise AttributeError(f"module 'pinmobile.viewer' has no attribute {name!r}")
