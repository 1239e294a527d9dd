"""Ensembles along named axes: run anywhere, kept in a store that outlives any interruption."""

from pinmobile.sweeps.code import Code
from pinmobile.sweeps.contents import (
    Sweep,
    attributes_of as attributes_of,
    compared as compared,
    length,
    since as since,
)
from pinmobile.sweeps.grids import Axis, Grid, grid
from pinmobile.sweeps.workers import check_draws, connected, sweep

__all__ = ["Axis", "Code", "Grid", "Sweep", "check_draws", "connected", "grid", "length", "sweep"]
