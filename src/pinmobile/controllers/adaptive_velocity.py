"""Adaptive control of a robot that takes speeds: its theta is estimated while it runs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, final

import numpy as np

from pinmobile.arrays import (
    Array,
    ArrayLike,
    endless_or_finite,
    frozen,
    non_negative,
    positive,
    real,
    scalar,
    vector,
)
from pinmobile.controllers.backstepping import reference_of, speeds_along
from pinmobile.controllers.controller import State
from pinmobile.controllers.held import check_held
from pinmobile.controllers.steering import Changing, cos, rate_of, sin, tanh, value_of
from pinmobile.controllers.tracking_errors import each_coordinate
from pinmobile.errors import InvalidArgument, shown
from pinmobile.plant import Context, Parameter

_SIZE = 6
_ABOVE_ZERO = 0, 1, 3, 5  # of theta: inertias and losses
_LEAST = 0.1  # of the nominal, which an estimate of these keeps
_AHEAD = 0.2  # [m], where the robot's own point is on its axle
_RATES = (1.0, 1.0, 0.1, 4.0, 0.1, 4.0)  # gains of estimates, per inertia of their row
_BACKWARDS, _STILL = -1e-6, 1e-6  # [m/s]


@final
@dataclass(frozen=True, eq=False)
class AdaptiveVelocity:
    """Adaptive control of a robot that takes speeds: a point ahead of its axle follows, theta is estimated.

    The kinematic law asks for the speed and yaw rate nu_d at which the point h, `ahead` of the axle, moves so
    as to come to that of the reference, h_d, and the estimate of theta gives the commands (Martins, Celeste,
    Carelli, Sarcinelli-Filho and Bastos-Filho, Control Engineering Practice 16, 2008)::

        nu_d = [c, s; -s/a, c/a] (h_d' + l tanh(kp (h_d - h) / l)),   e = nu_d - nu
        (u_c, w_c) = Y theta,   theta' = gamma Y' e - leakage (theta - first),
        Y = [s1, 0, -w^2, u, 0, 0; 0, s2, 0, 0, u w, w],   (s1, s2) = nu_d' + k e

    nu_d' follows from velocity and acceleration of reference and robot by the chain rule; nothing is
    differenced. Without leakage, e' diag(theta_1, theta_2) e / 2 and half the square of the estimates' errors
    over gamma together fall at e' diag(theta_1, theta_2) k e, so that e vanishes, and with it the error of
    the point; the estimates become right only where the motion excites them.

    What follows is a point, to which its heading comes by itself. Where that is the body's origin, `ahead`
    that of the robot, any reference of a position will do, and its heading is not looked at. Else it is the
    point as far ahead of the reference's pose, which must be one that wheels can follow, such as
    `Tangent(path)`, and not go backwards, where the robot would turn about.

    Estimates stay within their bounds; what they gain in a sample is taken back where the commands are
    limited and the gain would push them further.

    Parameters
    ----------
    robot : VelocityRobot
        The model whose theta is the first estimate.
    ahead : float, optional
        a, from the axle to the point, > 0 [m]; by default that of the robot, and 0.2 m where that is not
        above zero.
    kp : float
        Gain of the point's place, > 0 [1/s].
    saturation : float
        l, most speed along x and y that an error of the place asks for, > 0 [m/s].
    k : array_like, shape () or (2,)
        Gains of speed and yaw rate, > 0 [1/s].
    gamma : array_like, shape () or (6,), optional
        Gain of each estimate, >= 0: an expected error squared over what is allowed of the sum above. By
        default 1, 0.1 and 4 times theta_1 of theta_1, theta_3 and theta_4, and likewise theta_2 of the rest.
    leakage : float
        Rate at which estimates go back to the first, against drift, >= 0 [1/s]; it costs accuracy.
    lower, upper : array_like, shape (6,), optional
        Bounds of theta; by default a tenth of the robot's where it must be above zero.

    Raises
    ------
    InvalidArgument
        If an argument is something else, or the bounds exclude the robot's theta; at the start of a run, if
        the reference cannot be followed, or the loop is unstable at its dt with the mean of Y gamma Y' along
        the reference.
    """

    robot: Any
    ahead: float | None = None
    kp: float = 0.8
    saturation: float = 0.2
    k: ArrayLike = 3.0
    gamma: ArrayLike | None = None
    leakage: float = 0.0
    lower: ArrayLike | None = None
    upper: ArrayLike | None = None
    _follows_pose: bool = field(init=False, repr=False)

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter(
            "point_ahead",
            "m",
            "from the axle to the point that follows",
            0.0,
            may_vanish=False,
            attribute="ahead",
        ),
        Parameter("point_kp", "1/s", "gain of the point's place", 0.0, may_vanish=False, attribute="kp"),
        Parameter(
            "saturation", "m/s", "most speed that an error of the place asks for", 0.0, may_vanish=False
        ),
        Parameter("k", "1/s", "gain of the velocities", 0.0, may_vanish=False),
        Parameter("leakage", "1/s", "rate at which estimates go back to the first", 0.0),
    )

    def __post_init__(self) -> None:
        robot = self.robot
        if isinstance(robot, type) or not hasattr(robot, "commands"):
            raise InvalidArgument(f"robot is {shown(robot)}, expected a VelocityRobot")
        if hasattr(robot, "mobility"):  # what it becomes in a compiled loop has been looked at before
            self._look(robot)
        for name, unit in (("ahead", "m"), ("kp", "1/s"), ("saturation", "m/s")):
            object.__setattr__(self, name, positive(name, getattr(self, name), unit))
        object.__setattr__(self, "k", each_coordinate("k", self.k, 2, above=True))
        object.__setattr__(self, "leakage", non_negative("leakage", self.leakage, "1/s"))

    def _look(self, robot: Any) -> None:
        own = scalar("ahead of robot", robot.ahead)
        ahead = (own if own > 0 else _AHEAD) if self.ahead is None else positive("ahead", self.ahead, "m")
        object.__setattr__(self, "ahead", ahead)
        object.__setattr__(self, "_follows_pose", bool(ahead != own))
        theta, least = vector("theta of robot", robot.theta, _SIZE), np.full(_SIZE, -np.inf)
        least[list(_ABOVE_ZERO)] = _LEAST * theta[list(_ABOVE_ZERO)]
        gamma = np.array(_RATES) * _of_each(theta[:2]) if self.gamma is None else self.gamma
        object.__setattr__(self, "gamma", each_coordinate("gamma", gamma, _SIZE))
        for name, default, sign in (("lower", least, -1.0), ("upper", np.full(_SIZE, np.inf), 1.0)):
            given = getattr(self, name)
            bound = default if given is None else sign * endless_or_finite(name, sign * real(name, given))
            if bound.shape != (_SIZE,):
                raise InvalidArgument(f"{name} has shape {bound.shape}, expected ({_SIZE},)")
            object.__setattr__(self, name, frozen(bound))
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        outside = ~((lower <= theta) & (theta <= upper))
        if outside.any():
            j = int(outside.argmax())
            raise InvalidArgument(
                f"lower and upper of theta_{j + 1} are {lower[j]:g} and {upper[j]:g}, which exclude that of "
                f"the robot, {theta[j]:g}"
            )
        for j in _ABOVE_ZERO:
            if lower[j] <= 0:
                raise InvalidArgument(f"lower of theta_{j + 1} is {lower[j]:g}, expected > 0")

    def initial_state(self, context: Context) -> tuple[Any, Any, Any, Any, float]:
        """Return the robot's theta, that before, errors, commands asked for, and the time between samples."""
        reference = reference_of(context)
        if reference is not None and self._follows_pose:
            t = np.asarray(context.t)
            speed, _ = speeds_along(np.asarray(self.robot.axle), t, reference)
            if (speed < _BACKWARDS).any():
                j = int(np.argmax(speed < _BACKWARDS))
                raise InvalidArgument(
                    f"reference goes at {speed[j]:.3g} m/s at t = {t[j]:g} s, expected one that does not go "
                    "backwards, where a point ahead of the axle turns about"
                )
        self._check_held(context.dt, reference)
        none = np.zeros(2)
        return self.robot.theta, self.robot.theta, none, none, float(context.dt)

    def _check_held(self, dt: float, reference: Any) -> None:
        """Refuse gains at which place, velocity and estimate, the model exact, are unstable."""

        def gains() -> dict[str, Array]:
            found = {name: np.asarray(getattr(self, name)) for name in ("kp", "k", "gamma")}
            return found | {"theta": np.asarray(self.robot.theta)}

        def loop(dt: float) -> Array:
            kp, k, gamma, theta = gains().values()
            inertia, loss, kp = theta[..., :2], theta[..., [3, 5]], kp[..., None] + 0 * k
            decay = np.exp(-dt * loss / inertia)
            gained = (1 - decay) / loss  # of a velocity, per command
            moved = (dt - inertia * gained) / loss
            asked = inertia * k * kp, loss - inertia * (kp + k), 1 + 0 * kp
            grown = dt * _squares(gamma, reference)
            place = [1 - moved * asked[0], -inertia * gained - moved * asked[1], -moved]
            velocity = [gained * asked[0], decay + gained * asked[1], gained]
            estimate = [grown * kp, -grown, 1]
            rows = (np.stack(np.broadcast_arrays(kp, *row)[1:], -1) for row in (place, velocity, estimate))
            return np.stack(np.broadcast_arrays(*rows), axis=-2)

        check_held(gains, loop, dt)

    def applied(self, u: Array, state: tuple[Any, Any, Any, Any, float]) -> tuple[Any, Any, Any, Any, float]:
        """Return the state, estimates without what a limit of the commands kept them from, shape (..., 2)."""
        theta, before, errors, asked, dt = state
        further = (asked - u) * errors
        return np.where(_of_each(further) > 0.0, before, theta), before, errors, asked, dt

    def signals(self, state: tuple[Any, Any, Any, Any, float]) -> dict[str, Any]:
        """Return the estimate."""
        return {"theta": ("s, s, s m/rad^2, 1, s/m, 1", state[0])}

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any, Any, Any, float]
    ) -> tuple[Array, tuple[Any, Any, Any, Any, float]]:
        """Return the commands, shape (..., 2) [m/s, rad/s], and the next state."""
        theta, dt = state[0], state[-1]
        nu = self.robot.independent(q, v)
        wanted = self._wanted(q, nu, reference)
        errors = np.stack([value_of(each) for each in wanted], axis=-1) - nu
        rates = np.stack([rate_of(each) for each in wanted], axis=-1) + np.asarray(self.k) * errors
        u, w = nu[..., 0], nu[..., 1]
        columns = rates[..., 0], rates[..., 1], -w * w, u, u * w, w
        Y = np.stack(np.broadcast_arrays(*columns), axis=-1)
        parts = Y * theta
        asked = np.stack(
            [
                parts[..., 0] + parts[..., 2] + parts[..., 3],
                parts[..., 1] + parts[..., 4] + parts[..., 5],
            ],
            axis=-1,
        )
        grown = np.asarray(self.gamma) * Y * _of_each(errors) - self.leakage * (theta - self.robot.theta)
        after = np.minimum(np.maximum(theta + dt * grown, np.asarray(self.lower)), np.asarray(self.upper))
        return asked, (after, theta, errors, asked, dt)

    def _wanted(self, q: Array, nu: Array, reference: State) -> tuple[Changing, Changing]:
        """Return speed and yaw rate that the kinematic law asks for."""
        ahead, off = self.ahead, self.ahead - self.robot.ahead
        u, w = nu[..., 0], nu[..., 1]
        psi, turn = Changing(q[..., 2], w), Changing(reference.v[..., 2], reference.a[..., 2])
        psi_r = Changing(reference.q[..., 2], turn.value)
        c, s, c_r, s_r = cos(psi), sin(psi), cos(psi_r), sin(psi_r)
        own = u * c.value - ahead * (w * s.value), u * s.value + ahead * (w * c.value)
        places = off * (c_r.value - c.value), off * (s_r.value - s.value)
        turned = -(off * (turn * s_r)), off * (turn * c_r)
        x, y = (
            rate + self.saturation * tanh((self.kp / self.saturation) * Changing(place, rate.value - mine))
            for rate, place, mine in (
                (
                    Changing(reference.v[..., i], reference.a[..., i]) + turned[i],
                    reference.q[..., i] - q[..., i] + places[i],
                    own[i],
                )
                for i in range(2)
            )
        )
        return x * c + y * s, (y * c - x * s) / ahead


def _of_each(rows: Any) -> Any:
    """Return numbers of speed and yaw rate, shape (..., 2), for each entry of theta, shape (..., 6)."""
    speed, turning = rows[..., 0], rows[..., 1]
    return np.stack([speed, turning, speed, speed, turning, turning], axis=-1)


def _squares(gamma: Array, reference: Any) -> Array:
    """Return the mean of Y gamma Y' along the motion of a reference's point, shape (2,)."""
    if reference is None:
        return np.zeros(2)
    (x, y), (ax, ay) = (np.moveaxis(part[..., :2], -1, 0) for part in (reference.v, reference.a))
    u = np.hypot(x, y)
    by = np.maximum(u, _STILL)
    faster, w = (x * ax + y * ay) / by, (x * ay - y * ax) / (by * by)
    still = u < _STILL
    faster, w = np.where(still, 0.0, faster), np.where(still, 0.0, w)
    speed = [np.mean(x) for x in (faster**2, w**4, u**2)]
    ahead = gamma[..., 0] * speed[0] + gamma[..., 2] * speed[1] + gamma[..., 3] * speed[2]
    turning = gamma[..., 4] * np.mean((u * w) ** 2) + gamma[..., 5] * np.mean(w**2)
    return np.stack([ahead, turning], axis=-1)
