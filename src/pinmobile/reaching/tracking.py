"""Feedback of an end effector's pose, resolved into the force of base and arm."""

from dataclasses import dataclass, field
from typing import Any, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, non_negative, positive
from pinmobile.integrators import Integrator, check_integrator, constant_acceleration
from pinmobile.plant import Context
from pinmobile.reaching.bounds import Limits, bounded_least_squares, per_coordinate
from pinmobile.reaching.poses import PosePath, pose_error
from pinmobile.reaching.resolution import checked_target
from pinmobile.robot import MobileRobot

__all__ = ["EndEffectorTracking"]

_GAINS = ("kp", "kd", "posture_kp", "posture_kd")
# A force is held, not the acceleration, which changes within dt by some 1e-2 of itself: that much is left of
# what was beyond a limit by each.
_CORRECTIONS = 5


@final
@dataclass(frozen=True, eq=False)
class EndEffectorTracking:
    """Computed torque for a pose: tau = M(q) a + n(q, v), with the a that the pose asks for.

    a is what limits allow with the least |J a + dJ/dt v - (x_a + Kd e_dot + Kp e)|, and beside it the least
    damping |a - (a_r + kd_r (v_r - v) + kp_r (q_r - q))|: the reference that `simulate` passes on is the
    posture in what the pose leaves free (Nakamura and Hanafusa, 1986, at the level of accelerations; Khatib,
    1987). Positions and velocities within their limits stay there at every sample, as far as the model, `dt`
    and `integrator` are those of the plant: where the force that is held over `dt` would lead beyond a limit,
    another is chosen, whose acceleration may be beyond that limit by as much.

    Parameters
    ----------
    robot : MobileRobot
        The model that the controller believes in; its joints have one velocity each.
    target : PosePath
        Pose, or position alone; to be simulated no longer than it lasts.
    frame : str, optional
        What follows it, one of ``robot.frame_names``; by default ``robot.end_effector``.
    kp, kd : float
        Gains of the pose's error [1/s^2] and of its rate [1/s], >= 0.
    posture_kp, posture_kd : float
        Gains of the posture [1/s^2] and [1/s], >= 0.
    damping : float
        Weight of an acceleration beside that of the frame [m/rad], > 0.
    velocity_limit : array_like, shape () or (nv,), optional
        As in `resolve`.
    acceleration_limit : array_like, shape () or (nv,)
        As in `resolve`.
    dt : float
        Time over which a force is held, that of `simulate` [s], > 0: with another, limits are overrun.
    integrator : callable
        How the plant moves under it, that of `simulate`, likewise; `rk4` for all that moves on without steps.

    Raises
    ------
    InvalidArgument
        If an argument is not what is expected, or a joint has more than one velocity.
    UnknownName
        If there is no such frame.
    """

    robot: MobileRobot
    target: PosePath
    frame: str | None = None
    kp: float = 100.0
    kd: float = 20.0
    posture_kp: float = 25.0
    posture_kd: float = 10.0
    damping: float = 1e-2
    velocity_limit: ArrayLike | None = None
    acceleration_limit: ArrayLike = 20.0
    dt: float = 0.01
    integrator: Integrator = constant_acceleration
    _limits: Limits = field(init=False, repr=False)
    _corrections: int = field(init=False, repr=False)

    def __post_init__(self) -> None:
        checked_target(self.robot, self.target)
        own = {name: non_negative(name, getattr(self, name)) for name in _GAINS}
        own |= {name: positive(name, getattr(self, name)) for name in ("damping", "dt")}
        check_integrator(self.integrator)
        nv = self.robot.nv
        speed = self.robot.velocity_limit if self.velocity_limit is None else self.velocity_limit
        speed = per_coordinate("velocity_limit", speed, nv, zero=True)
        most = per_coordinate("acceleration_limit", self.acceleration_limit, nv)
        fixed = {"frame": self.robot.frame_name(self.frame), "velocity_limit": speed}
        limits = Limits(self.robot, speed, most)
        # Where the acceleration at the start of a step holds through it, the bounds of `ramps` are exact.
        held = [getattr(self.integrator, name, ()) for name in ("weights_q", "weights_v")] == [(0.5,), (1.0,)]
        object.__setattr__(self, "_corrections", 0 if held else _CORRECTIONS)
        for name, value in {**own, **fixed, "acceleration_limit": most, "_limits": limits}.items():
            object.__setattr__(self, name, value)

    def initial_state(self, context: Context) -> None:
        """Return None: there is no memory."""

    def __call__(self, t: float, q: Array, v: Array, reference: Any, state: None) -> tuple[Array, None]:
        """Return the generalised force, shape (nv,), and None."""
        return self._command(t, q, v, reference)[1], None

    def acceleration(self, t: float, q: Array, v: Array, reference: Any) -> Array:
        """Return the acceleration that is asked for, shape (nv,).

        Parameters
        ----------
        t : float
            Time [s].
        q, v : ndarray, shape (nq,) and (nv,)
            State.
        reference : Reference
            The posture: q, v and a.
        """
        return self._command(t, q, v, reference)[0]

    def _command(self, t: float, q: Array, v: Array, reference: Any) -> tuple[Array, Array]:
        """Return the acceleration that is asked for and its force, each of shape (nv,)."""
        robot, rows = self.robot, self.target.rows
        target = self.target(t)
        J = robot.frame_jacobian(q, self.frame)
        error = pose_error(target.pose, robot.frame_pose(q, self.frame))
        wanted = target.rate + self.kd * (target.twist - J @ v) + self.kp * error
        wanted -= robot.frame_drift(q, v, self.frame)
        posture = reference.a + self.posture_kd * (reference.v - v)
        posture = posture + self.posture_kp * robot.difference(q, reference.q)
        A = np.vstack([J[:rows], self.damping * np.eye(robot.nv)])
        b = np.concatenate([wanted[:rows], self.damping * posture])
        least, most = self._limits.ramps(q, v, self.dt)
        a = bounded_least_squares(A, b, least, most)
        force = robot.inverse_dynamics(q, v, a)
        for _ in range(self._corrections):
            low, high = self._limits.excess(*self._after(q, v, force), self.dt)
            if not (low.any() or high.any()):
                break
            # A bound that is moved past the other, as of what is locked, takes it along.
            up, down = np.where(low > 0, a + low, -np.inf), np.where(high > 0, a - high, np.inf)
            least, most = np.clip(least, up, down), np.clip(most, up, down)
            a = bounded_least_squares(A, b, least, most)
            force = robot.inverse_dynamics(q, v, a)
        return a, force

    def _after(self, q: Array, v: Array, force: Array) -> tuple[Array, Array]:
        """Return the state to which a held force leads, by the model and the integrator."""
        robot = self.robot

        def acceleration(t: float, displacement: Array, w: Array) -> Array:
            return robot.forward_dynamics(robot.integrate(q, displacement), w, force)

        displacement, w = self.integrator(acceleration, 0.0, np.zeros(robot.nv), v, self.dt)
        return robot.integrate(q, displacement), w
