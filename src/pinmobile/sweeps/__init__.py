"""Sweeps: ensembles at the points of a grid, in this process or on a Dask cluster, and their stores."""

from pinmobile.sweeps._points import Axis as Axis, Points as Points
from pinmobile.sweeps._sweep import Sweep, connect as connect, run_points as run_points, sweep

__all__ = ["Sweep", "sweep"]
