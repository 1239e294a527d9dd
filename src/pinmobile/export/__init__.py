"""Export of controllers and plants as C for the robot's own processor."""

from pinmobile.export._export import (
    context_without_trajectory as context_without_trajectory,
    export_c,
)
from pinmobile.export._law import Answer as Answer, Law as Law

__all__ = ["export_c"]
