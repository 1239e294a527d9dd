"""Trajectories: a path and a heading give a reference (q, v, a); paths of arms complete it."""

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
