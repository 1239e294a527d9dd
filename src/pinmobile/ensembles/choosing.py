"""Which engine runs a scenario."""

from importlib.util import find_spec

from pinmobile.ensembles.by_arrays import ARRAYS, asked
from pinmobile.ensembles.by_kernel import COMPILED
from pinmobile.ensembles.part import Engine
from pinmobile.ensembles.probing import check_functions
from pinmobile.ensembles.scenario import Scenario
from pinmobile.errors import InvalidArgument, shown
from pinmobile.extras import installing

__all__ = ["chosen_engine"]


def chosen_engine(scenario: Scenario, engine: Engine | None) -> Engine:
    """Return the engine that is asked for, by default the compiled one wherever it can.

    Raises
    ------
    InvalidArgument
        If it cannot run the scenario, or numba is missing.
    """
    if engine is None and COMPILED.refusal(scenario):
        check_functions(scenario, asked)
        return ARRAYS
    chosen = COMPILED if engine is None else engine
    if not isinstance(chosen, Engine):
        raise InvalidArgument(
            f"engine is {shown(engine)}, expected COMPILED or ARRAYS of pinmobile.ensembles, or None"
        )
    refusal = chosen.refusal(scenario)
    if refusal:
        raise InvalidArgument(f"engine is {shown(chosen)}, which cannot run this: {refusal}")
    if chosen is COMPILED and find_spec("numba") is None:
        raise InvalidArgument(
            f"the compiled engine needs numba, which is not installed: {installing('ensembles')}, or choose "
            "engine=pinmobile.ensembles.ARRAYS, which is slower"
        )
    if chosen is ARRAYS:
        check_functions(scenario, asked)
    return chosen
