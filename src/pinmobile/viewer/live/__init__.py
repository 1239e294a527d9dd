"""The live window: a scene in browsers, served by this process. It knows scenes, and nothing of robots."""

from pinmobile.viewer.live.window import LiveWindow

__all__ = ["LiveWindow"]
