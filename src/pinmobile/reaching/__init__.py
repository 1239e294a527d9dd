"""An end effector's pose followed by base and arm together."""

from pinmobile.reaching.poses import PosePath, PoseTarget, pose_error
from pinmobile.reaching.resolution import EndEffectorTracking, Resolved, resolve

__all__ = ["EndEffectorTracking", "PosePath", "PoseTarget", "Resolved", "pose_error", "resolve"]
