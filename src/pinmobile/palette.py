"""Colours that the colour-blind tell apart, in grey too, of figures and scenes."""

from __future__ import annotations

INK = "#222222"
QUIET = "#8a8f94"
AXES = ("#D55E00", "#6CCBA9", "#00569E")
"""Of x, y and z."""
GRIPS, SLIDES = "#00664B", "#EE7733"
"""Of a force that the ground can hold, and of one where it slides."""

# Hues like those of Okabe and Ito, "Color universal design", 2008. Each has a lightness of its own, CIE L* of
# 33, 55, 71, 14, 79 and 43: a grey copy has six greys. None is too pale for a line on white.
_COLOURS = ("#004C91", "#DB6109", "#52C29F", "#40103A", "#E9C04A", "#AE3D80")


def colour(index: int) -> str:
    """Return the colour of the rollout with this index."""
    return _COLOURS[index % len(_COLOURS)]
