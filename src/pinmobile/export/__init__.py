"""Export of controllers and plants as C for the robot's own processor."""

from pinmobile.export._export import begun as begun, export_c
from pinmobile.export._law import InputRecorder as InputRecorder, Law as Law, noise_error as noise_error

__all__ = ["export_c"]
