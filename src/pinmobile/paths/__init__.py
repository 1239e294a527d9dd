"""Curves as functions of time: via-point cubics, splines, Lissajous figures, and from rest to rest."""

from pinmobile.paths.cubic_via import CubicVia
from pinmobile.paths.lissajous import Circle, Lissajous
from pinmobile.paths.protocol import Path, Piece, Whole, pieces_of, within
from pinmobile.paths.rest_to_rest import Hold, RestToRest
from pinmobile.paths.spline import Spline

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
