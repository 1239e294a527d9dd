"""An end effector's pose followed by base and arm together."""

from pinmobile.reaching.poses import (
    FrameTask,
    PosePath,
    PoseTarget,
    align_signs as align_signs,
    error_sizes as error_sizes,
    pose_error,
    target_names as target_names,
)
from pinmobile.reaching.trajectory import (
    EndEffectorTracking,
    InverseKinematicsTrajectory,
    solve_inverse_kinematics,
)

__all__ = [
    "EndEffectorTracking",
    "FrameTask",
    "InverseKinematicsTrajectory",
    "PosePath",
    "PoseTarget",
    "pose_error",
    "solve_inverse_kinematics",
]
