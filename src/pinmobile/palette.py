"""Colours of figures and scenes: distinguishable with a colour vision deficiency and in grey.

``INK`` is the colour of text and references, ``QUIET`` of notes and grids. ``AXES`` are the colours of the
x, y and z axes. ``GRIPS`` is the colour of a contact force within the friction limit, ``SLIDES`` of a
force at a sliding contact.
"""

from __future__ import annotations

INK = "#222222"
QUIET = "#8a8f94"
AXES = ("#D55E00", "#6CCBA9", "#00569E")
"""Colours of the x, y and z axes."""
GRIPS, SLIDES = "#00664B", "#EE7733"
"""Colours of a force within the friction limit, and of a force where the contact slides."""

# Hues like those of Okabe and Ito, "Color universal design", 2008. Their lightnesses differ, CIE L* of
# 33, 55, 71, 14, 79 and 43, so a grey copy has six greys. Each colour contrasts with white.
_COLOURS = ("#004C91", "#DB6109", "#52C29F", "#40103A", "#E9C04A", "#AE3D80")


def colour(index: int) -> str:
    """Return the colour of a rollout by its index.

    Parameters
    ----------
    index : int
        Index of the rollout; six colours repeat.

    Returns
    -------
    colour : str
        Colour as ``#rrggbb``.

    See Also
    --------
    plots.path : a figure with these colours

    Examples
    --------
    >>> from pinmobile.palette import colour
    >>> colour(0), colour(6) == colour(0)
    ('#004C91', True)
    """
    return _COLOURS[index % len(_COLOURS)]
