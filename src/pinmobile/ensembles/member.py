"""One robot of an ensemble, as the arguments of `simulate`."""

from typing import Any, NamedTuple

from pinmobile.ensembles.scenario import Scenario


class Member(NamedTuple):
    """One robot of an ensemble: ``simulate(*member[:3], **member.options)`` runs it alone.

    Attributes
    ----------
    robot, controller, trajectory
        As in `simulate`.
    options : dict
        The other arguments of `simulate`.
    """

    robot: Any
    controller: Any
    trajectory: Any
    options: dict[str, Any]


def member_of(scenario: Scenario, i: int) -> Member:
    """Return robot i as the arguments of `simulate`.

    Parameters
    ----------
    scenario : Scenario
        Whose robot.
    i : int
        Its index, 0 <= i < n.
    """
    draws = scenario.draws(i, i + 1)
    values = {place: value[0] for place, value in scenario.values(draws, i, i + 1).items()}
    parts = scenario.parts.with_parameters(values, remade=True)
    own = scenario.references(draws, 1, i) if scenario.has_own_references else None
    q, v = scenario.starts(draws, 1, own)
    options = {
        "dt": scenario.dt,
        "duration": scenario.duration if own is None else float(scenario.t[-1]),
        "q0": q[0],
        "v0": v[0],
        "integrator": scenario.integrator,
        "substeps": scenario.substeps,
        "forces": parts.forces,
        "limit": scenario.limit,
    }
    if scenario.is_noisy:
        options |= {"seed": scenario.seed, "member": i}
    return Member(parts.plant, parts.controller, parts.trajectory, options)
