"""The closed loop, recorded: `simulate` and `Rollout`."""

from pinmobile.simulation.closed_loop import simulate
from pinmobile.simulation.plant import Plant
from pinmobile.simulation.rollout import Rollout

__all__ = ["Plant", "Rollout", "simulate"]
