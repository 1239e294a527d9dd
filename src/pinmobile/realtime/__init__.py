"""Control of a real robot: `Stepper` computes one sample, `run_realtime` calls it at a fixed rate."""

from pinmobile.realtime._realtime import RealtimeReport, run_realtime
from pinmobile.realtime._stepper import Stepper

__all__ = ["RealtimeReport", "Stepper", "run_realtime"]
