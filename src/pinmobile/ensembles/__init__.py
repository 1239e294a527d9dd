"""Many robots at once: drawn, run side by side, and summed up."""

from pinmobile.ensembles.distributions import TRUE_MODEL, Distribution, Normal, Same, Uniform
from pinmobile.ensembles.histogram import BINS as BINS
from pinmobile.ensembles.histogram import checked_share as checked_share
from pinmobile.ensembles.histogram import edges as edges
from pinmobile.ensembles.histogram import miscounted as miscounted
from pinmobile.ensembles.histogram import share_within as share_within
from pinmobile.ensembles.member import Member
from pinmobile.ensembles.names import GROUPS as GROUPS
from pinmobile.ensembles.names import PARAMETERS
from pinmobile.ensembles.names import resolved as resolved
from pinmobile.ensembles.names import with_spread_forces as with_spread_forces
from pinmobile.ensembles.outline import Outline
from pinmobile.ensembles.outline import percent as percent
from pinmobile.ensembles.part import Part
from pinmobile.ensembles.processes import Workers as Workers
from pinmobile.ensembles.result import Bands, Ensemble, Within
from pinmobile.ensembles.running import ensemble, part_of, run_scenario
from pinmobile.ensembles.scenario import Scenario
from pinmobile.ensembles.variables import LEVELS as LEVELS
from pinmobile.ensembles.variables import NOTE as NOTE
from pinmobile.ensembles.variables import PER_ROBOT as PER_ROBOT
from pinmobile.ensembles.variables import SUMMED as SUMMED
from pinmobile.ensembles.variables import coordinates as coordinates
from pinmobile.ensembles.variables import drawn as drawn
from pinmobile.ensembles.variables import drawn_name as drawn_name
from pinmobile.ensembles.variables import over_all as over_all
from pinmobile.ensembles.variables import per_robot as per_robot
from pinmobile.ensembles.variables import summed as summed
from pinmobile.ensembles.ways import way_of as way_of
from pinmobile.simulation import ARRAYS, COMPILED, PINOCCHIO, Engine

__all__ = [
    "ARRAYS",
    "COMPILED",
    "PARAMETERS",
    "PINOCCHIO",
    "TRUE_MODEL",
    "Bands",
    "Distribution",
    "Engine",
    "Ensemble",
    "Member",
    "Normal",
    "Outline",
    "Part",
    "Same",
    "Scenario",
    "Uniform",
    "Within",
    "ensemble",
    "part_of",
    "run_scenario",
]
