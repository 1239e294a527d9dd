"""Ensembles along named axes: run anywhere, kept in a store that outlives any interruption."""

from pinmobile.sweeps.axes import Axis
from pinmobile.sweeps.cluster import connected
from pinmobile.sweeps.code import Code
from pinmobile.sweeps.grids import Grid, grid
from pinmobile.sweeps.result import Sweep
from pinmobile.sweeps.running import check_draws, sweep
from pinmobile.sweeps.table import length

__all__ = ["Axis", "Code", "Grid", "Sweep", "check_draws", "connected", "grid", "length", "sweep"]
