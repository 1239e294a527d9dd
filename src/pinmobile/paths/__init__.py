"""Paths: positions as functions of time, such as cubics, lines, polylines and circles."""

from pinmobile.paths.curves import Circle, CubicVia, Hold, Line, Lissajous, RestToRest, Spline
from pinmobile.paths.path import (
    Path,
    Piece,
    TransformedPath,
    Value as Value,
    Whole,
    check_path as check_path,
    pieces_of,
    within,
)
from pinmobile.paths.polyline import CompositePath, Polyline

__all__ = [
    "Circle",
    "CompositePath",
    "CubicVia",
    "Hold",
    "Line",
    "Lissajous",
    "Path",
    "Piece",
    "Polyline",
    "RestToRest",
    "Spline",
    "TransformedPath",
    "Whole",
    "pieces_of",
    "within",
]
