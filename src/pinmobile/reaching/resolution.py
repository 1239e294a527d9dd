"""Inverse kinematics along a path of poses, base and arm together, limits held."""

import numpy as np

from pinmobile.arrays import Array, ArrayLike, endless_or_finite, finite, non_negative, positive
from pinmobile.errors import InvalidArgument, Unreachable, shown
from pinmobile.reaching.bounds import Limits, per_coordinate
from pinmobile.reaching.poses import PosePath, error_sizes
from pinmobile.reaching.resolved import Resolved
from pinmobile.reaching.solver import Solver, checked_configuration
from pinmobile.robot import MobileRobot

__all__ = ["checked_posture", "checked_target", "resolve"]

_MOST_STEPS = 1_000_000  # hours


def resolve(
    robot: MobileRobot,
    target: PosePath,
    *,
    frame: str | None = None,
    q0: ArrayLike | None = None,
    posture: ArrayLike | None = None,
    dt: float = 0.01,
    posture_gain: float = 1.0,
    cost: ArrayLike = 1.0,
    velocity_limit: ArrayLike | None = None,
    acceleration_limit: ArrayLike = 10.0,
    damping: float = 1e-2,
    tolerance: float = 1e-2,
) -> Resolved:
    """Return a trajectory of base and arm together on which a frame follows a path of poses.

    Step by step, damped least squares within bounds (Nakamura and Hanafusa, 1986): of the displacements that
    limits allow, that with the least error of the next pose, and of those nearly as good, that which is
    nearest to the way to the posture; corrected until the pose is met. At a singular posture and at a limit
    the error grows instead. The base goes in any direction. Track it by `ComputedTorque`.

    Parameters
    ----------
    robot : MobileRobot
        With or without arms; its joints have one velocity each.
    target : PosePath
        Pose, or position alone.
    frame : str, optional
        What follows it, one of ``robot.frame_names``; by default ``robot.end_effector``.
    q0 : array_like, shape (nq,), optional
        Where the search for the start begins; by default ``robot.rest`` and, where that fails, others.
    posture : array_like, shape (nq - 3,), optional
        To which the arms tend where the target leaves them free; by default as at the start.
    dt : float
        Time between control points [s]; their number is rounded up. The error is about a dt^2 / 6, with the
        acceleration a of the frame.
    posture_gain : float
        Rate of that [1/s], >= 0.
    cost : array_like, shape () or (nv,)
        Relative cost of each coordinate's motion, > 0: a high one keeps it still.
    velocity_limit : array_like, shape () or (nv,), optional
        Largest |v| [m/s, m/s, rad/s, ...]; by default the robot's; inf where there is none, zero locks.
    acceleration_limit : array_like, shape () or (nv,)
        Largest |a| [m/s^2, m/s^2, rad/s^2, ...] > 0, also when a joint brakes at its limit; it gives way to
        the limits of position and velocity.
    damping : float
        Weight of a displacement beside the error [m/rad], > 0.
    tolerance : float
        Largest distance and largest angle that are accepted, as of `Resolved.max_error` [m, rad]; infinite:
        any, see `Resolved.error`.

    Returns
    -------
    trajectory : Resolved
        To be followed from its beginning. There, the frame's velocity is that of the target but for an error
        in proportion to dt^2.

    Raises
    ------
    InvalidArgument
        If an argument is not what is expected, or a joint has more than one velocity.
    UnknownName
        If there is no such frame.
    Unreachable
        If an error is beyond the tolerance; it carries the trajectory.
    """
    checked_target(robot, target)
    name = robot.frame_name(frame)
    speed = robot.velocity_limit if velocity_limit is None else velocity_limit
    limits = Limits(
        robot,
        per_coordinate("velocity_limit", speed, robot.nv, zero=True),
        per_coordinate("acceleration_limit", acceleration_limit, robot.nv),
    )
    weights = positive("damping", damping) * np.diag(per_coordinate("cost", cost, robot.nv))
    most = endless_or_finite("tolerance", tolerance)  # infinite: whatever the error
    if most.ndim or not most > 0:
        raise InvalidArgument(f"tolerance is {shown(tolerance)}, expected > 0")
    tolerance = float(most)
    solver = Solver(robot, target, name, limits, weights)
    start = solver.start(q0)
    tending = start if posture is None else checked_posture(robot, posture)
    gain = non_negative("posture_gain", posture_gain, "1/s")
    wanted = target.duration / positive("dt", dt, "s")
    if not wanted <= _MOST_STEPS:
        raise InvalidArgument(
            f"dt is {dt} s, which makes {wanted:.3g} steps, expected at most {_MOST_STEPS:,}"
        )
    count = max(int(np.ceil(wanted - 1e-9)), 2)
    resolved = Resolved(robot, target, name, start, solver.steps(start, tending, gain, count))
    _judge(resolved, tolerance)
    return resolved


def checked_target(robot: MobileRobot, target: PosePath) -> None:
    """Refuse what is no robot or no path of poses.

    Raises
    ------
    InvalidArgument
        If one is not.
    """
    for name, value, kind in (("robot", robot, MobileRobot), ("target", target, PosePath)):
        if not isinstance(value, kind):
            raise InvalidArgument(f"{name} is {shown(value)}, expected a {kind.__name__}")


def checked_posture(robot: MobileRobot, posture: ArrayLike) -> Array:
    """Return a configuration whose arms are in a posture, shape (nq,).

    Raises
    ------
    InvalidArgument
        If it has another shape or is not finite.
    """
    arms = finite("posture", posture)
    if arms.shape != (robot.nq - 3,):
        raise InvalidArgument(
            f"posture has shape {arms.shape}, expected ({robot.nq - 3},), the arms' part of q"
        )
    return checked_configuration(robot, "posture", np.concatenate([np.zeros(3), arms]))


def _judge(resolved: Resolved, tolerance: float) -> None:
    sizes = error_sizes(resolved.error)
    beyond = sizes.max(axis=-1) > tolerance
    if beyond.any():
        k = int(np.argmax(beyond))
        way, turn = sizes[k]
        most = resolved.max_error()
        raise Unreachable(
            f"target is missed by {way:.3g} m and {turn:.3g} rad at t = {resolved.t[k]:g} s, expected "
            f"at most {tolerance:g}; the largest errors are {most[0]:.3g} m and {most[1]:.3g} rad",
            time=float(resolved.t[k]),
            resolved=resolved,
        )
