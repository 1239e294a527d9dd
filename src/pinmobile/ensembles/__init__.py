"""Many robots at once: drawn, run side by side, and summed up."""

from pinmobile.ensembles.distributions import (
    TRUE_MODEL,
    Distribution,
    Normal,
    Same,
    Source as Source,
    Uniform,
    check_mapping as check_mapping,
)
from pinmobile.ensembles.engines import way_of as way_of
from pinmobile.ensembles.outline import Outline, percent as percent
from pinmobile.ensembles.parameters import (
    GROUPS as GROUPS,
    PARAMETERS,
    resolved as resolved,
)
from pinmobile.ensembles.records import (
    Member,
    Part,
    checked_share as checked_share,
    edges as edges,
    miscounted as miscounted,
    share_within as share_within,
)
from pinmobile.ensembles.result import Bands, Ensemble, Within
from pinmobile.ensembles.running import ensemble, part_of, run_scenario
from pinmobile.ensembles.scenario import Scenario
from pinmobile.ensembles.variables import (
    LEVELS as LEVELS,
    NOTE as NOTE,
    PER_ROBOT as PER_ROBOT,
    SUMMED as SUMMED,
    coordinates as coordinates,
    drawn as drawn,
    drawn_name as drawn_name,
    over_all as over_all,
    per_robot as per_robot,
    summed as summed,
)
from pinmobile.simulation import COMPILED, PYTHON, Engine

__all__ = [
    "COMPILED",
    "PARAMETERS",
    "PYTHON",
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
