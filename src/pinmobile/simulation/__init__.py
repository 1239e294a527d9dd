"""The closed loop, recorded: `simulate` and `Rollout`."""

from pinmobile.simulation.checks import checked_forces, checked_loop, sample_times, sampled
from pinmobile.simulation.closed_loop import Plant, simulate
from pinmobile.simulation.rollout import Rollout

__all__ = ["Plant", "Rollout", "checked_forces", "checked_loop", "sample_times", "sampled", "simulate"]
