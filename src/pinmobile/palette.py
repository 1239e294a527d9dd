"""Colours that the colour-blind tell apart, of figures and scenes."""

from __future__ import annotations

INK = "#222222"
QUIET = "#8a8f94"
AXES = ("#D55E00", "#009E73", "#0072B2")
"""Of x, y and z."""
GRIPS, SLIDES = "#009E73", "#D55E00"
"""Of a force that the ground can hold, and of one where it slides."""

# Okabe and Ito, "Color universal design", 2008, without black (the desired) and yellow (too pale for a line).
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")


def colour(index: int) -> str:
    """Return the colour of the rollout with this index."""
    return _COLOURS[index % len(_COLOURS)]
