"""See the robot move: meshcat, live in a browser or recorded as a page, a GIF, a film or a picture."""

from pinmobile.viewer.live import LiveWindow
from pinmobile.viewer.offline import OfflineWindow
from pinmobile.viewer.overlays import Arrows, Follow, Overlays, Stay
from pinmobile.viewer.recording import Recording
from pinmobile.viewer.viewer import Viewer

__all__ = ["Arrows", "Follow", "LiveWindow", "OfflineWindow", "Overlays", "Recording", "Stay", "Viewer"]
