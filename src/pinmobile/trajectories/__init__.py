"""A path and a heading law make a reference (q, v, a); beside paths of arms, one of the whole."""

from pinmobile.trajectories.reference import (
    FixedHeading,
    LectureHeading,
    Reference,
    Tangent,
    Trajectory,
    WholeBody,
    check_limits,
)

__all__ = [
    "FixedHeading",
    "LectureHeading",
    "Reference",
    "Tangent",
    "Trajectory",
    "WholeBody",
    "check_limits",
]
