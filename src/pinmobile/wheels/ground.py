"""What wheels stand on: ground on which they roll ideally or slip, level or a ramp."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from pinmobile.constancy import constant


@final
@constant
@dataclass(frozen=True)
class Rolling:
    """Wheels roll without slip, whatever force that takes: constraints on the velocities."""
