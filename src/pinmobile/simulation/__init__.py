"""The closed loop, recorded: `simulate` and `Rollout`."""

from pinmobile.simulation.closed_loop import Plant, simulate
from pinmobile.simulation.rollout import Rollout

__all__ = ["Plant", "Rollout", "simulate"]
