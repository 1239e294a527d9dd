"""Curves as functions of time: via-point cubics, splines and Lissajous figures, with every derivative."""

from pinmobile.paths.cubic_via import CubicVia
from pinmobile.paths.lissajous import Circle, Lissajous
from pinmobile.paths.protocol import Path, Piece, Whole, pieces_of, within
from pinmobile.paths.spline import Spline

__all__ = ["Circle", "CubicVia", "Lissajous", "Path", "Piece", "Spline", "Whole", "pieces_of", "within"]
