"""See the robot move: a meshcat stage, live in a browser or recorded to a page, a GIF, a film or a picture."""

from pinmobile.viewer.overlays import Arrows, Follow, Overlays, Stay
from pinmobile.viewer.recording import Recording
from pinmobile.viewer.viewer import Viewer

__all__ = ["Arrows", "Follow", "Overlays", "Recording", "Stay", "Viewer"]
