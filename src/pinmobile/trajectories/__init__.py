"""A path in the plane and a heading law make a reference (q, v, a)."""

from pinmobile.trajectories.fixed import FixedHeading
from pinmobile.trajectories.lecture import LectureHeading
from pinmobile.trajectories.reference import Reference, Trajectory
from pinmobile.trajectories.tangent import Tangent

__all__ = ["FixedHeading", "LectureHeading", "Reference", "Tangent", "Trajectory"]
