"""Adaptive control of a robot that takes speeds: its theta is estimated while it runs."""

from __future__ import annotations

from functools import partial
from typing import Any, final

import attrs
import numpy as np

from pinmobile.arrays import Array, scalar, vector
from pinmobile.controllers.backstepping import reference_of, speeds_along
from pinmobile.controllers.controller import State
from pinmobile.controllers.feedback import bound
from pinmobile.controllers.held import check_held
from pinmobile.controllers.steering import Changing, cos, rate_of, sin, tanh, value_of
from pinmobile.errors import InvalidArgument
from pinmobile.parts import Commanded, array, child, number, part, structure
from pinmobile.plant import Context

_SIZE = 6
_ABOVE_ZERO = 0, 1, 3, 5  # of theta: inertias and losses
_LEAST = 0.1  # of the nominal, which an estimate of these keeps
_FREE = np.where(np.isin(np.arange(_SIZE), _ABOVE_ZERO), 0.0, np.inf)  # others have no bound
_AHEAD = 0.2  # [m], where the robot's own point is on its axle
_RATES = (1.0, 1.0, 0.1, 4.0, 0.1, 4.0)  # gains of estimates, per inertia of their row
_BACKWARDS, _STILL = -1e-6, 1e-6  # [m/s]


_usual = partial(attrs.Factory, takes_self=True)


@final
@part
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

    robot: Any = child(Commanded, doc="model whose theta is the first estimate")
    ahead: float = number(
        default=_usual(lambda self: self._own if self._own > 0 else _AHEAD),
        above=0.0,
        unit="m",
        doc="from the axle to the point that follows",
    )
    kp: float = number(default=0.8, above=0.0, unit="1/s", doc="gain of the point's place")
    saturation: float = number(
        default=0.2, above=0.0, unit="m/s", doc="most speed that an error of the place asks for"
    )
    k: Any = array(
        default=3.0,
        shapes=((), ("n",)),
        above=0.0,
        unit="1/s",
        doc="gain of the velocities",
        labels=("speed", "yaw_rate"),
        size=lambda self: 2,
    )
    gamma: Any = array(
        default=_usual(lambda self: np.array(_RATES) * _of_each(self._theta[:2])),
        shapes=((), ("n",)),
        lower=0.0,
        fixed=True,
        doc="gains of estimates",
        size=lambda self: _SIZE,
    )
    leakage: float = number(
        default=0.0, lower=0.0, unit="1/s", doc="rate at which estimates go back to the first"
    )
    lower: Any = bound(-1.0, "lower bounds of theta", _usual(lambda self: _LEAST * self._theta - _FREE))
    upper: Any = bound(1.0, "upper bounds of theta", _usual(lambda self: np.full(_SIZE, np.inf)))

    @property
    def _own(self) -> float:
        """From the axle of the robot to its own point [m]."""
        return scalar("ahead of robot", self.robot.ahead)

    @property
    def _theta(self) -> Array:
        """Theta of the robot, shape (6,)."""
        return vector("theta of robot", self.robot.theta, _SIZE)

    def check(self) -> None:
        """Raise `InvalidArgument` where bounds are none or exclude the robot's theta."""
        for name in ("lower", "upper"):
            shape = np.shape(getattr(self, name))
            if shape != (_SIZE,):
                raise InvalidArgument(f"{name} has shape {shape}, expected ({_SIZE},)")
        theta, lower, upper = self._theta, self.lower, self.upper
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

    @structure
    def _follows_pose(self) -> bool:
        """Whether the point is another than the robot's own, of which any reference will do."""
        return bool(self.ahead != self._own)

    def initial_state(self, context: Context) -> tuple[Any, Any, Any, Any, float]:
        """Return the robot's theta, that before, errors, commands asked for, and the time between samples."""
        reference = reference_of(context)
        if reference is not None and self._follows_pose:
            t = np.asarray(context.t)
            speed, _ = speeds_along(self.robot.axle, t, reference)
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

        def gains() -> dict[str, Any]:
            return {"kp": self.kp, "k": self.k, "gamma": self.gamma, "theta": self.robot.theta}

        def loop(dt: float) -> Array:
            kp, k, gamma, theta = map(np.asarray, gains().values())
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
        rates = np.stack([rate_of(each) for each in wanted], axis=-1) + self.k * errors
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
        grown = self.gamma * Y * _of_each(errors) - self.leakage * (theta - self.robot.theta)
        after = np.minimum(np.maximum(theta + dt * grown, self.lower), self.upper)
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
