"""Curves as functions of time: via-point cubics, splines, Lissajous figures, and from rest to rest."""

from pinmobile.paths.curves import Circle, CubicVia, Hold, Lissajous, RestToRest, Spline
from pinmobile.paths.path import Path, Piece, Whole, checked_path as checked_path, pieces_of, within

__all__ = [
    "Circle",
    "CubicVia",
    "Hold",
    "Lissajous",
    "Path",
    "Piece",
    "RestToRest",
    "Spline",
    "Whole",
    "pieces_of",
    "within",
]
