"""Export of controllers and plants as C for the robot's own processor."""

from pinmobile.export._export import export_c, initial_context as initial_context
from pinmobile.export._law import InputRecorder as InputRecorder, Law as Law, noise_error as noise_error

__all__ = ["export_c"]
