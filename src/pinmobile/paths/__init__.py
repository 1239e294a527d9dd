"""Curves as functions of time: cubics, lines, polylines, figures; elsewhere, one after another."""

from pinmobile.paths.composite import CompositePath
from pinmobile.paths.curves import CubicVia, Hold, Line, RestToRest, Spline
from pinmobile.paths.figures import Circle, Lissajous
from pinmobile.paths.path import (
    Moved,
    Path,
    Piece,
    Value as Value,
    Whole,
    checked_path as checked_path,
    pieces_of,
    within,
)
from pinmobile.paths.polyline import Polyline

__all__ = [
    "Circle",
    "CompositePath",
    "CubicVia",
    "Hold",
    "Line",
    "Lissajous",
    "Moved",
    "Path",
    "Piece",
    "Polyline",
    "RestToRest",
    "Spline",
    "Whole",
    "pieces_of",
    "within",
]
