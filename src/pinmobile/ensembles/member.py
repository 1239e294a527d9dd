"""One robot of an ensemble, as the arguments of `simulate`."""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from pinmobile.controllers.controller import told
from pinmobile.ensembles.scenario import Scenario
from pinmobile.plant import Context
from pinmobile.signals import signals_of

__all__ = ["Member", "member_of"]


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


@dataclass(frozen=True)
class _OfRobot:
    """A controller whose noise is that of one robot of an ensemble."""

    controller: Any
    seed: int
    member: int

    def initial_state(self, context: Context) -> Any:
        """Return the controller's, told of the robot."""
        return self.controller.initial_state(replace(context, seed=self.seed, member=self.member))

    def applied(self, u: Any, state: Any) -> Any:
        """Return the controller's state, told of the input that is applied."""
        return told(self.controller, u, state)

    def signals(self, state: Any) -> Any:
        """Return the controller's signals."""
        return signals_of(self.controller, state)

    def __call__(self, t: float, q: Any, v: Any, reference: Any, state: Any) -> tuple[Any, Any]:
        """Return the controller's input and next state."""
        return self.controller(t, q, v, reference, state)  # type: ignore[no-any-return]


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
    controller = parts.controller
    if scenario.is_noisy:
        controller = _OfRobot(controller, scenario.seed, i)
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
    return Member(parts.plant, controller, parts.trajectory, options)
