"""A path and a heading law make a reference (q, v, a); beside paths of arms, one of the whole."""

from pinmobile.trajectories.fixed import FixedHeading
from pinmobile.trajectories.lecture import LectureHeading
from pinmobile.trajectories.limits import check_limits
from pinmobile.trajectories.reference import Reference, Trajectory
from pinmobile.trajectories.tangent import Tangent
from pinmobile.trajectories.whole import WholeBody

__all__ = [
    "FixedHeading",
    "LectureHeading",
    "Reference",
    "Tangent",
    "Trajectory",
    "WholeBody",
    "check_limits",
]
