"""Adaptive control: parameter estimates of a pushed body, or of a robot that takes speeds."""

from __future__ import annotations

from functools import partial
from typing import Any, final

import attrs
import numpy as np

from pinmobile.arrays import Array, bounded, frozen, instance, scalar, shaped, vector
from pinmobile.controllers.controller import State, combined, passive_torque
from pinmobile.controllers.feedback import SLOPE, OfBody, bound, check_bounds, comparison, coordinates_of
from pinmobile.controllers.kinematic_laws import (
    Changing,
    cos,
    rate_of,
    reference_of,
    sin,
    speeds_along,
    tanh,
    value_of,
)
from pinmobile.controllers.lqr import check_held, diagonal, double_integrators
from pinmobile.errors import InvalidArgument
from pinmobile.parts import Commanded, Passive, array, child, each, number, option, part, structure
from pinmobile.plant import Context

_SIZE = 6
_ABOVE_ZERO = 0, 1, 3, 5  # of theta: inertias and losses
_LEAST_EXCITATION = 0.1  # of the nominal, which an estimate of these keeps
_FREE = np.where(np.isin(np.arange(_SIZE), _ABOVE_ZERO), 0.0, np.inf)  # others have no bound
_AHEAD = 0.2  # [m], where the robot's own point is on its axle
_EXCITED_RATES = (1.0, 1.0, 0.1, 4.0, 0.1, 4.0)  # gains of estimates, per inertia of their row
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
        default=_usual(lambda self: np.array(_EXCITED_RATES) * _of_each(self._theta[:2])),
        shapes=((), ("n",)),
        lower=0.0,
        fixed=True,
        doc="gains of estimates",
        size=lambda self: _SIZE,
    )
    leakage: float = number(
        default=0.0, lower=0.0, unit="1/s", doc="rate at which estimates go back to the first"
    )
    lower: Any = bound(
        -1.0, "lower bounds of theta", _usual(lambda self: _LEAST_EXCITATION * self._theta - _FREE)
    )
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
            shaped(name, getattr(self, name), (_SIZE,))
        theta, lower, upper = self._theta, self.lower, self.upper
        check_bounds([f"theta_{j}" for j in range(1, _SIZE + 1)], lower, theta, upper)
        bounded("lower", np.where(_FREE == 0, lower, 1.0), above=0)

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


_BASE = 3  # coordinates of the base: x, y, psi
_BODY = 4  # parameters of a body in the plane: m, m com_x, m com_y, and inertia about the frame's vertical
_EACH = 10  # parameters of a body in space, as `regressor` has them
_RATES = (2 / 3, 1 / 15, 1 / 15, 1 / 50)  # gains of the estimates of a body in the plane, per kg of it
_RUBBING = (2.0, 1.0)  # of viscous friction and of that which does not grow, per diagonal of M,
_TURNING = 1.8  # and so many times that where a coordinate is an angle
_ROUNDING = 1e-9  # relative, within which a force is applied as it is asked for
_LEAST = 0.04  # of the nominal inertia about the centre of mass, which an estimate keeps


def _flag(name: str, value: Any) -> bool:
    return bool(instance(name, value, bool, "True or False"))


@final
@part
class Adaptive(OfBody):
    """Adaptive control (Slotine and Li, 1987): the parameters phi of the model are estimated on the way.

        tau = Y phi + kd s,   phi' = gamma Y' s,   s = e' + slope e

    Y = Y(q, v, v_r, a_r) is the regressor, M a_r + C v_r + g = Y phi. With the right structure
    s' M s / 2 + (phi - true)' gamma^-1 (phi - true) / 2 falls at s' kd s, so that the error vanishes; the
    estimates become right only where the motion excites them. phi is that of a body in the plane, mass, mass
    times centre of mass, and inertia about the frame's vertical; of a robot with arms it is
    `inertial_parameters`. With friction, c and f of each coordinate follow, the base's along the body's axes:
    c v_r and f S(v_r), S(z) = z / sqrt(z^2 + speed^2).

    Of a step whose force is cut off by limits nothing is learnt: errors that these leave would drive phi
    away. After each step phi is brought back into its bounds, of which a body in the plane has one more: its
    inertia about the centre of mass stays above a share of the nominal.

    Parameters
    ----------
    robot : MobileRobot
        The model whose parameters are the first estimate.
    slope : array_like, shape () or (n,)
        Rate at which errors vanish where s does, > 0 [1/s].
    kd : array_like, shape () or (n,), optional
        Gain of s, > 0 [N s/m, N m s/rad]; by default 4 / s times the diagonal of M at rest.
    gamma : array_like, shape () or (p,), optional
        Gain of each parameter's estimate, >= 0: an expected error squared over what is allowed of the sum
        above; by default in proportion to the robot's mass, and with arms to what each body has.
    friction : bool
        Whether friction is estimated too.
    speed : float
        Of the friction that does not grow with speed, > 0 [m/s, rad/s].
    dead_zone : float
        Norm of s below which nothing is estimated, two or three times its noise, >= 0 [m/s, rad/s].
    leakage : float
        Rate at which estimates go back to the first, against drift, >= 0 [1/s]; it costs accuracy.
    lower, upper : array_like, shape (p,), optional
        Bounds of the parameters; by default a tenth of the nominal mass of each body, and friction >= 0.
    difference : callable
        ``difference(q0, q1)``: the displacement from q0 to q1; by default the robot's own.

    Raises
    ------
    InvalidArgument
        If an argument is something else, or the bounds exclude the robot's own parameters; at the start of a
        run, if the loop is unstable at its dt.
    """

    robot: Any = child(Passive, doc="model whose parameters are the first estimate")
    slope: Any = each(default=4.0, above=0.0, unit="1/s", doc=SLOPE, size=coordinates_of)
    kd: Any = each(
        default=attrs.Factory(lambda self: 4.0 * np.diagonal(self._inertia), takes_self=True),
        above=0.0,
        unit="N s/m, N s/m, N m s/rad",
        doc="gain of s",
        size=coordinates_of,
    )
    gamma: Any = array(default=None, shapes=((), ("p",)), lower=0.0, fixed=True, doc="gains of estimates")
    friction: bool = option(default=False, doc="whether friction is estimated too", check=_flag)
    speed: float = number(default=0.01, above=0.0, unit="m/s, rad/s", doc="of friction that does not grow")
    dead_zone: float = number(
        default=0.0, lower=0.0, unit="m/s, rad/s", doc="norm of s below which nothing is estimated"
    )
    leakage: float = number(
        default=0.0, lower=0.0, unit="1/s", doc="rate at which estimates go back to the first"
    )
    lower: Any = bound(-1.0, "lower bounds of the parameters")
    upper: Any = bound(1.0, "upper bounds of the parameters")
    difference: Any = comparison()

    @structure
    def _inertia(self) -> Array:
        """Mass matrix at rest."""
        return frozen(self.robot.mass_matrix(self.robot.rest))

    @structure
    def _nominal(self) -> Array:
        """The first estimate, shape (p,)."""
        M = self._inertia
        is_planar = len(M) == _BASE
        own = [M[0, 0], M[1, 2], -M[0, 2], M[2, 2]] if is_planar else self.robot.inertial_parameters
        return frozen(np.concatenate([own, np.zeros(2 * len(M) * self.friction)]))

    def check(self) -> None:
        """Complete gains and bounds; raise `InvalidArgument` where these exclude the first estimate."""
        super().check()
        nominal, M = self._nominal, self._inertia
        p, n = len(nominal), len(M)
        size = _BODY if n == _BASE else _EACH
        inertial = nominal[: p - 2 * n * self.friction]
        least = np.full(p, -np.inf)
        least[: len(inertial) : size] = nominal[: len(inertial) : size] / 10
        least[len(inertial) :] = 0.0  # of friction
        rates = float(self.robot.mass) * np.array(_RATES) if n == _BASE else _of_bodies(inertial)
        if self.friction:
            sizes = np.where(np.arange(n) < 2, 1.0, _TURNING) * np.diagonal(M)
            rates = np.concatenate([rates, *(rate * sizes for rate in _RUBBING)])
        for name, usual in (("gamma", rates), ("lower", least), ("upper", np.full(p, np.inf))):
            given = getattr(self, name)
            given = np.full(p, given) if isinstance(given, float) else given
            found = usual if given is None else given
            shaped(name, found, (p,), words=", or one number" if name == "gamma" else "")
            object.__setattr__(self, name, frozen(found))
        check_bounds([f"parameter {k}" for k in range(p)], self.lower, nominal, self.upper)

    def initial_state(self, context: Context) -> tuple[Any, ...]:
        """Return how far estimates are off the robot's own, now and before, a force, and the time step."""

        def loop(dt: float) -> Array:
            slope, gain = diagonal(self.slope), np.linalg.solve(self._inertia, diagonal(self.kd))
            kp = gain @ slope
            return double_integrators(dt, kp, gain + slope, 0 * kp)

        check_held(lambda: {"slope": self.slope, "kd": self.kd}, loop, context.dt)
        none = np.zeros(len(self._nominal))
        return none, none, np.zeros(self.robot.nv), float(context.dt)

    def applied(self, u: Array, state: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return the state, told of the force that is applied, shape (..., n)."""
        change, before, tau, dt = state
        is_whole = np.all(np.abs(u - tau) <= _ROUNDING * (1 + np.abs(tau)), axis=-1)[..., None]
        return np.where(is_whole, change, before), before, tau, dt

    def signals(self, state: tuple[Any, ...]) -> dict[str, Any]:
        """Return the estimates: of a body in the plane its mass, first moment, inertia; and friction."""
        phi, n = self._nominal + state[0], self.robot.nv
        inertial = phi[..., : len(self._nominal) - 2 * n] if self.friction else phi
        if n == _BASE:
            own = {
                "mass": ("kg", inertial[..., 0]),
                "first_moment": ("kg m", inertial[..., 1:3]),
                "inertia": ("kg m^2", inertial[..., 3]),
            }
        else:
            own = {"inertial_parameters": ("kg, kg m, kg m^2", inertial)}
        if self.friction:
            own |= {
                "viscous_friction": ("N s/m, N m s/rad", phi[..., -2 * n : -n]),
                "resistance": ("N, N m", phi[..., -n:]),
            }
        return own

    def _regressor(self, q: Array, v: Array, velocity: Array, acceleration: Array) -> Array:
        """Return Y(q, v, v_r, a_r), shape (..., n, p), of M a_r + C(q, v) v_r + g and of friction."""
        c, s = np.cos(q[..., 2]), np.sin(q[..., 2])
        if self.robot.nv == _BASE:
            found = _of_body(c, s, v, velocity, acceleration)
        else:
            of, still = self.robot.regressor, np.zeros(np.shape(v))
            found = (
                of(q, 0.5 * (v + velocity), acceleration)
                - of(q, 0.5 * (v - velocity), still)
                + of(q, still, still)
            )
        if not self.friction:
            return found
        own = [c * velocity[..., 0] + s * velocity[..., 1], c * velocity[..., 1] - s * velocity[..., 0]]
        own += [velocity[..., k] for k in range(2, self.robot.nv)]
        smooth = [rate / np.sqrt(rate * rate + self.speed * self.speed) for rate in own]
        columns = [column for group in (own, smooth) for column in self._pushes(group, c, s)]
        return np.concatenate([found, np.stack(columns, axis=-1)], axis=-1)

    def _pushes(self, rates: list[Any], c: Array, s: Array) -> list[Array]:
        """Return the forces that grow with each of these rates, shape (..., n) each."""
        none, found = 0.0 * rates[0], []
        for k, rate in enumerate(rates):
            rows = [none] * len(rates)
            rows[k] = rate
            if k == 0:
                rows[:2] = [c * rate, s * rate]
            elif k == 1:
                rows[:2] = [-s * rate, c * rate]
            found.append(np.stack(np.broadcast_arrays(*rows), axis=-1))
        return found

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, ...]
    ) -> tuple[Array, tuple[Any, ...]]:
        """Return the generalised force, shape (..., n), and the next state."""
        change, _, _, dt = state
        robot = self.robot
        s, velocity, acceleration = combined(self, q, v, reference)
        Y = self._regressor(q, v, velocity, acceleration)
        tau = passive_torque(robot, q, v, velocity, acceleration) + self.kd * s
        tau = tau + np.sum(Y * change[..., None, :], axis=-1)
        grown = self.gamma * np.sum(Y * s[..., :, None], axis=-2) - self.leakage * change
        adapts = np.sum(s * s, axis=-1, keepdims=True) >= np.asarray(self.dead_zone)[..., None] ** 2
        return tau, (self._possible(change + np.where(adapts, dt * grown, 0.0)), change, tau, dt)

    def _possible(self, change: Array) -> Array:
        """Return the estimates in their bounds."""
        phi = self._nominal + change
        phi = np.minimum(np.maximum(phi, self.lower), self.upper)
        if self.robot.nv > _BASE:
            return np.asarray(phi - self._nominal)
        m0, mx0, my0, I0 = self._nominal[:_BODY]
        least = _LEAST * (I0 - (mx0 * mx0 + my0 * my0) / m0)
        m, mx, my, inertia = (phi[..., k] for k in range(_BODY))
        inertia = np.maximum(inertia, (mx * mx + my * my) / m + least)
        parts = [m, mx, my, inertia, *(phi[..., k] for k in range(_BODY, len(self._nominal)))]
        return np.asarray(np.stack(parts, axis=-1) - self._nominal)


def _of_bodies(inertial: Array) -> Array:
    """Return gains for bodies in space, shape (10 bodies,): half of each number squared, per J."""
    rates = []
    for body in inertial.reshape(-1, _EACH):
        inertia = float(body[4] + body[6] + body[9])  # the trace
        sizes = [body[0], *(np.sqrt(max(body[0] * inertia, 0.0)),) * 3, *(inertia,) * 6]
        rates.append(np.square(sizes) / 4)
    return np.concatenate(rates)


def _of_body(c: Array, s: Array, v: Array, velocity: Array, acceleration: Array) -> Array:
    """Return the regressor of a body in the plane, shape (..., 3, 4)."""
    ax, ay, az = (acceleration[..., k] for k in range(_BASE))
    r, vz = v[..., 2], velocity[..., 2]
    none = 0.0 * (ax + r)
    rows = (
        (ax, -s * az - r * c * vz, -c * az + r * s * vz, none),
        (ay, c * az - r * s * vz, -s * az - r * c * vz, none),
        (none, c * ay - s * ax, -c * ax - s * ay, az),
    )
    return np.stack([np.stack(np.broadcast_arrays(*row), axis=-1) for row in rows], axis=-2)
