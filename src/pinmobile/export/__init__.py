"""Export of controllers and plants as C for the robot's own processor."""

from pinmobile.export._export import export_c

__all__ = ["export_c"]
