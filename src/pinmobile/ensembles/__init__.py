"""Many robots at once: drawn, run side by side, and summed up."""

from pinmobile.ensembles.distributions import TRUE_MODEL, Distribution, Normal, Same, Uniform
from pinmobile.ensembles.member import Member
from pinmobile.ensembles.names import PARAMETERS
from pinmobile.ensembles.outline import Outline
from pinmobile.ensembles.part import Part
from pinmobile.ensembles.result import Bands, Ensemble, Within
from pinmobile.ensembles.running import ensemble, part_of, run_scenario
from pinmobile.ensembles.scenario import Scenario
from pinmobile.simulation.closed_loop import ARRAYS, COMPILED, PINOCCHIO, Engine

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
