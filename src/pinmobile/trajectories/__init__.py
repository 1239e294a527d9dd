"""A path and a heading law make a reference (q, v, a); beside paths of arms, one of the whole."""

from pinmobile.trajectories.headings import FixedHeading, LectureHeading, Tangent
from pinmobile.trajectories.reference import Reference, Trajectory, WholeBody, check_limits

__all__ = [
    "FixedHeading",
    "LectureHeading",
    "Reference",
    "Tangent",
    "Trajectory",
    "WholeBody",
    "check_limits",
]
