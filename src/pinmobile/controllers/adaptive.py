"""Adaptive control: parameter estimates of a robot driven by forces, or by speed and yaw rate."""

from __future__ import annotations

from functools import partial
from typing import Any, final

import attrs
import numpy as np

from pinmobile.arrays import Array, between, bounded, frozen, instance, scalar, shaped, vector
from pinmobile.controllers.controller import AntiWindup, State, combined_error, is_equal_input, passive_torque
from pinmobile.controllers.feedback import SLOPE, BodyLaw, bound, comparison, coordinates_of
from pinmobile.controllers.kinematic_laws import (
    DualNumber,
    cos,
    rate_of,
    reference_of,
    reference_speeds,
    refuse_reference,
    sin,
    tanh,
    value_of,
)
from pinmobile.controllers.lqr import check_gains, diagonal, double_integrators
from pinmobile.parts import Commanded, Passive, array, child, each, number, option, part, structure
from pinmobile.plant import Context

_SIZE = 6
_EXCLUDED = "lower and upper exclude the robot's value,"  # of a message, see `between`
_POSITIVE_ENTRIES = 0, 1, 3, 5  # entries of theta that are positive: inertias and losses
_ESTIMATE_RATIO = 0.1  # smallest ratio of such an estimate and its nominal value
_FREE = np.where(np.isin(np.arange(_SIZE), _POSITIVE_ENTRIES), 0.0, np.inf)  # the others have no bound
_DISTANCE = 0.2  # [m], default for a robot whose point lies on its axle
_THETA_GAINS = (1.0, 1.0, 0.1, 4.0, 0.1, 4.0)  # gains of estimates, per inertia in their row
_REVERSE_SPEED, _SPEED_TOLERANCE = -1e-6, 1e-6  # [m/s]


_self_default = partial(attrs.Factory, takes_self=True)


@final
@part
class AdaptiveVelocity(AntiWindup):
    """Adaptive control of a robot that takes speed and yaw rate; it estimates theta.

    A point at a distance a ahead of the axle follows the reference. The kinematic law commands the speed and
    yaw rate nu_d at which this point h approaches the reference point h_d. The estimate of theta gives the
    commands (Martins, Celeste, Carelli, Sarcinelli-Filho and Bastos-Filho, Control Engineering Practice 16,
    2008)::

        nu_d = [c, s; -s/a, c/a] (h_d' + l tanh(kp (h_d - h) / l)),   e = nu_d - nu
        (u_c, w_c) = Y theta,   theta' = gamma Y' e - leakage (theta - first),
        Y = [s1, 0, -w^2, u, 0, 0; 0, s2, 0, 0, u w, w],   (s1, s2) = nu_d' + k e

    nu_d' follows from velocity and acceleration of reference and robot by the chain rule, without finite
    differences. Without leakage, the sum of e' diag(theta_1, theta_2) e / 2 and half the squared estimation
    errors divided by gamma decreases at e' diag(theta_1, theta_2) k e. Therefore e converges to zero, and
    with it the error of the point. The estimates converge only if the motion excites them.

    If `ahead` is the robot's own value, the point is the body's origin: the reference may be any motion of a
    position, and its heading is not used. Otherwise the reference point lies ahead of the reference pose.
    Then the wheels must be able to follow the reference, such as ``Tangent(path)``, and it must not move
    backwards, where the robot would turn around.

    Estimates stay within their bounds. Where the commands are limited and an estimate would grow further, its
    last increment is removed.

    Parameters
    ----------
    robot : VelocityRobot
        Controller model; its theta is the initial estimate.
    ahead : float, optional
        Distance a from the axle to the point, > 0 [m]; default: the robot's, or 0.2 m if that is not above
        zero.
    kp : float
        Gain of the position error, > 0 [1/s].
    saturation : float
        Largest speed l along x and y that a position error commands, > 0 [m/s].
    k : array_like, shape () or (2,)
        Gains of speed and yaw rate, > 0 [1/s].
    gamma : array_like, shape () or (6,), optional
        Adaptation gain of each estimate, >= 0: expected squared error divided by the allowed value of the sum
        above. By default 1, 0.1 and 4 times theta_1 for theta_1, theta_3 and theta_4, and likewise with
        theta_2 for the others.
    leakage : float
        Leakage rate toward the initial estimates, against drift, >= 0 [1/s]; it costs accuracy.
    lower, upper : array_like, shape (6,), optional
        Bounds of theta; default: a tenth of the robot's value for the positive entries.

    Raises
    ------
    InvalidArgument
        If an argument is out of range, or the bounds exclude the robot's theta; at the start of a run, if the
        robot cannot follow the reference, or the sampled loop is unstable with the mean of Y gamma Y' along
        the reference.

    See Also
    --------
    VelocityRobot : plant and model of speed and yaw rate
    controllers.VelocityCommand : commands without a model
    Adaptive : adaptive control of forces
    identify_velocity : estimates theta from a log

    Examples
    --------
    >>> from pinmobile import Circle, Tangent
    >>> from pinmobile import VelocityRobot, simulate
    >>> from pinmobile.controllers import AdaptiveVelocity
    >>> robot = VelocityRobot(theta=[0.3, 0.2, 0, 1, 0, 1])
    >>> model = VelocityRobot(theta=[0.6, 0.4, 0, 1, 0, 1])
    >>> path = Tangent(Circle(radius=1.0, rate=0.5, duration=2.0))
    >>> run = simulate(robot, AdaptiveVelocity(model), path, dt=0.05,
    ...                v0=0 * robot.rest)
    >>> print(f"{1e3 * max(run.max_error()[:2]):.0f} mm from rest")
    50 mm from rest
    """

    robot: Any = child(Commanded, doc="controller model; its theta is the initial estimate")
    ahead: float = number(
        default=_self_default(lambda self: self._distance if self._distance > 0 else _DISTANCE),
        above=0.0,
        unit="m",
        doc="distance from the axle to the point that follows",
    )
    kp: float = number(default=0.8, above=0.0, unit="1/s", doc="gain of the position error")
    saturation: float = number(
        default=0.2, above=0.0, unit="m/s", doc="largest speed that a position error commands"
    )
    k: Any = array(
        default=3.0,
        shapes=((), ("n",)),
        above=0.0,
        unit="1/s",
        doc="gains of speed and yaw rate",
        labels=("speed", "yaw_rate"),
        size=lambda self: 2,
    )
    gamma: Any = array(
        default=_self_default(lambda self: np.array(_THETA_GAINS) * _expand_to_theta(self._theta[:2])),
        shapes=((), ("n",)),
        lower=0.0,
        fixed=True,
        doc="gains of estimates",
        size=lambda self: _SIZE,
    )
    leakage: float = number(
        default=0.0, lower=0.0, unit="1/s", doc="leakage rate toward the initial estimates"
    )
    lower: Any = bound(
        -1.0, "lower bounds of theta", _self_default(lambda self: _ESTIMATE_RATIO * self._theta - _FREE)
    )
    upper: Any = bound(1.0, "upper bounds of theta", _self_default(lambda self: np.full(_SIZE, np.inf)))

    @property
    def _distance(self) -> float:
        """Distance from the axle of the robot to its point [m]."""
        return scalar("ahead of robot", self.robot.ahead)

    @property
    def _theta(self) -> Array:
        """Theta of the robot, shape (6,)."""
        return vector("theta of robot", self.robot.theta, _SIZE)

    def check(self) -> None:
        """Raise `InvalidArgument` for bounds of a wrong shape, or that exclude the robot's theta."""
        for name in ("lower", "upper"):
            shaped(name, getattr(self, name), (_SIZE,))
        theta, lower, upper = self._theta, self.lower, self.upper
        between(_EXCLUDED, [f"theta_{j}" for j in range(1, _SIZE + 1)], theta, lower, upper)
        bounded("lower", np.where(_FREE == 0, lower, 1.0), above=0)

    @structure
    def _follows_pose(self) -> bool:
        """Whether the point differs from the robot's own, so that the reference's heading matters."""
        return bool(self.ahead != self._distance)

    def initial_state(self, context: Context) -> tuple[Any, Any, Any, Any, float]:
        """Return theta, the theta before, errors, the last commands, and the time step."""
        reference = reference_of(context)
        if reference is not None and self._follows_pose:
            t = np.asarray(context.t)
            speed, _ = reference_speeds(self.robot.axle, t, reference)
            refuse_reference(
                speed < _REVERSE_SPEED,
                lambda k: (
                    f"has a speed of {speed[k]:.3g} m/s at t = {t[k]:g} s, expected one that does not "
                    "move backwards, where a point ahead of the axle turns around"
                ),
            )
        self._check_gains(context.dt, reference)
        zeros = np.zeros(2)
        return self.robot.theta, self.robot.theta, zeros, zeros, float(context.dt)

    def _check_gains(self, dt: float, reference: Any) -> None:
        """Raise `InvalidArgument` for gains at which the sampled loop is unstable for an exact model."""

        def gains() -> dict[str, Any]:
            return {"kp": self.kp, "k": self.k, "gamma": self.gamma, "theta": self.robot.theta}

        def loop(dt: float) -> Array:
            kp, k, gamma, theta = map(np.asarray, gains().values())
            inertia, loss, kp = theta[..., :2], theta[..., [3, 5]], kp[..., None] + 0 * k
            decay = np.exp(-dt * loss / inertia)
            v_gain = (1 - decay) / loss  # velocity per command
            x_gain = (dt - inertia * v_gain) / loss
            command = inertia * k * kp, loss - inertia * (kp + k), 1 + 0 * kp
            estimate_gain = dt * _squares(gamma, reference)
            position = [1 - x_gain * command[0], -inertia * v_gain - x_gain * command[1], -x_gain]
            velocity = [v_gain * command[0], decay + v_gain * command[1], v_gain]
            estimate = [estimate_gain * kp, -estimate_gain, 1]
            rows = (np.stack(np.broadcast_arrays(kp, *row)[1:], -1) for row in (position, velocity, estimate))
            return np.stack(np.broadcast_arrays(*rows), axis=-2)

        check_gains(gains, loop, dt)

    def applied(self, u: Array, state: tuple[Any, Any, Any, Any, float]) -> tuple[Any, Any, Any, Any, float]:
        """Return the state without the increments that a limit makes useless, shape (..., 2)."""
        theta, previous, errors, command, dt = state
        windup = np.where(is_equal_input(u, command), 0.0, (command - u) * errors)
        return np.where(_expand_to_theta(windup) > 0.0, previous, theta), previous, errors, command, dt

    def signals(self, state: tuple[Any, Any, Any, Any, float]) -> dict[str, Any]:
        """Return the estimate of theta."""
        return {"theta": ("s, s, s m/rad^2, 1, s/m, 1", state[0])}

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any, Any, Any, float]
    ) -> tuple[Array, tuple[Any, Any, Any, Any, float]]:
        """Return the commands, shape (..., 2) [m/s, rad/s], and the next state."""
        theta, dt = state[0], state[-1]
        nu = self.robot.independent(q, v)
        desired = self._desired_velocities(q, nu, reference)
        errors = np.stack([value_of(velocity) for velocity in desired], axis=-1) - nu
        rates = np.stack([rate_of(velocity) for velocity in desired], axis=-1) + self.k * errors
        u, w = nu[..., 0], nu[..., 1]
        columns = rates[..., 0], rates[..., 1], -w * w, u, u * w, w
        Y = np.stack(np.broadcast_arrays(*columns), axis=-1)
        parts = Y * theta
        command = np.stack(
            [
                parts[..., 0] + parts[..., 2] + parts[..., 3],
                parts[..., 1] + parts[..., 4] + parts[..., 5],
            ],
            axis=-1,
        )
        theta_rate = self.gamma * Y * _expand_to_theta(errors) - self.leakage * (theta - self.robot.theta)
        next_theta = np.minimum(np.maximum(theta + dt * theta_rate, self.lower), self.upper)
        return command, (next_theta, theta, errors, command, dt)

    def _desired_velocities(self, q: Array, nu: Array, reference: State) -> tuple[DualNumber, DualNumber]:
        """Return the speed and yaw rate of the kinematic law, with their rates."""
        distance, offset = self.ahead, self.ahead - self.robot.ahead
        u, w = nu[..., 0], nu[..., 1]
        psi, turn = DualNumber(q[..., 2], w), DualNumber(reference.v[..., 2], reference.a[..., 2])
        psi_r = DualNumber(reference.q[..., 2], turn.value)
        c, s, c_r, s_r = cos(psi), sin(psi), cos(psi_r), sin(psi_r)
        velocity = u * c.value - distance * (w * s.value), u * s.value + distance * (w * c.value)
        shifts = offset * (c_r.value - c.value), offset * (s_r.value - s.value)
        shift_rates = -(offset * (turn * s_r)), offset * (turn * c_r)
        x, y = (
            rate + self.saturation * tanh((self.kp / self.saturation) * DualNumber(error, rate.value - v))
            for rate, error, v in (
                (
                    DualNumber(reference.v[..., i], reference.a[..., i]) + shift_rates[i],
                    reference.q[..., i] - q[..., i] + shifts[i],
                    velocity[i],
                )
                for i in range(2)
            )
        )
        return x * c + y * s, (y * c - x * s) / distance


def _expand_to_theta(rows: Any) -> Any:
    """Return values of speed and yaw rate, shape (..., 2), for each entry of theta, shape (..., 6)."""
    speed, yaw_rate = rows[..., 0], rows[..., 1]
    return np.stack([speed, yaw_rate, speed, speed, yaw_rate, yaw_rate], axis=-1)


def _squares(gamma: Array, reference: Any) -> Array:
    """Return the mean of Y gamma Y' along the motion of a reference point, shape (2,)."""
    if reference is None:
        return np.zeros(2)
    (x, y), (ax, ay) = (np.moveaxis(part[..., :2], -1, 0) for part in (reference.v, reference.a))
    u = np.hypot(x, y)
    divisor = np.maximum(u, _SPEED_TOLERANCE)
    acceleration, w = (x * ax + y * ay) / divisor, (x * ay - y * ax) / (divisor * divisor)
    is_at_rest = u < _SPEED_TOLERANCE
    acceleration, w = np.where(is_at_rest, 0.0, acceleration), np.where(is_at_rest, 0.0, w)
    speed = [np.mean(x) for x in (acceleration**2, w**4, u**2)]
    speed_sum = gamma[..., 0] * speed[0] + gamma[..., 2] * speed[1] + gamma[..., 3] * speed[2]
    yaw_sum = gamma[..., 4] * np.mean((u * w) ** 2) + gamma[..., 5] * np.mean(w**2)
    return np.stack([speed_sum, yaw_sum], axis=-1)


_BASE = 3  # coordinates of the base: x, y, psi
_PLANAR = 4  # parameters of a body in the plane: m, m com_x, m com_y, and inertia about the frame's vertical
_SPATIAL = 10  # parameters of a body in space, as in `regressor`
_BODY_GAINS = (2 / 3, 1 / 15, 1 / 15, 1 / 50)  # gains of the estimates of a body in the plane, per kg of it
_FRICTION_GAINS = (2.0, 1.0)  # gains of viscous and dry friction, per diagonal entry of M
_ANGLE_FACTOR = 1.8  # factor of these gains if a coordinate is an angle
_INERTIA_RATIO = 0.04  # smallest ratio of the estimated and nominal inertia about the centre of mass


def _flag(name: str, value: Any) -> bool:
    """Return a value after a check that it is True or False."""
    return bool(instance(name, value, bool, "True or False"))


@final
@part
class Adaptive(BodyLaw, AntiWindup):
    """Adaptive control (Slotine and Li, 1987): it estimates the model's parameters phi in the run.

    ::

        tau = Y phi + kd s,   d phi/dt = gamma Y' s,   s = de/dt + slope e

    Y = Y(q, v, v_r, a_r) is the regressor: M a_r + C v_r + g = Y phi. If the model structure is right, the
    sum s' M s / 2 + (phi - true)' gamma^-1 (phi - true) / 2 decreases at s' kd s. Therefore the error
    converges to zero. The estimates converge only if the motion excites them. For a planar body, phi contains
    mass, mass times centre of mass, and inertia about the vertical axis of the frame; for a robot with arms
    it is `MobileRobot.inertial_parameters`. With `friction`, coefficients c and f of each coordinate follow,
    those of the base along the body's axes: c v_r and f S(v_r), S(z) = z / sqrt(z^2 + speed^2).

    A constant force is outside this model: it leaves an error and wrong estimates. A `DisturbanceObserver`
    around this controller removes the error. The observer also compensates the effect of a wrong mass, so
    that the estimates then hardly change.

    Steps whose force is cut off by limits do not change phi, because their errors would drive phi away. After
    each step phi is clipped to its bounds. A planar body has one more bound: its inertia about the centre of
    mass stays above a fraction of the nominal value.

    Parameters
    ----------
    robot : MobileRobot
        Controller model; its parameters are the initial estimate.
    slope : array_like, shape () or (n,)
        Decay rate of errors on the surface s = 0, > 0 [1/s].
    kd : array_like, shape () or (n,), optional
        Gain of s, > 0 [N s/m, N m s/rad]; default: 4 1/s times the diagonal of M at rest.
    gamma : array_like, shape () or (p,), optional
        Adaptation gain of each parameter, >= 0; a larger one estimates faster, and amplifies noise. To
        estimate the mass with the time constant T [s] where the reference accelerates at a [m/s^2], enter
        ``kd / (a^2 T)`` for it, such as 90 for kd = 80 N s/m, a = 0.54 m/s^2 and T = 3 s. Zero keeps a
        parameter. Default: for a planar body 20, 2, 2 and 0.6 at 30 kg, proportional to the mass; for a robot
        with arms, proportional to the parameters of each body.
    friction : bool
        Whether friction is estimated too.
    speed : float
        Speed at which dry friction has 71 % of its size, > 0 [m/s, rad/s].
    dead_zone : float
        Smallest norm of s that adapts the estimates, usually two or three times its noise, >= 0 [m/s, rad/s].
    leakage : float
        Leakage rate toward the initial estimates, against drift, >= 0 [1/s]; it costs accuracy.
    lower, upper : array_like, shape (p,), optional
        Bounds of the parameters; default: a tenth of the nominal mass of each body, and friction >= 0.
    difference : callable, optional
        ``difference(q0, q1)``: displacement from q0 to q1; default: the robot's.

    Raises
    ------
    InvalidArgument
        If an argument is out of range or has another shape, the bounds exclude the robot's parameters, or the
        robot has wheels; at the start of a run, if the sampled loop is unstable.

    See Also
    --------
    ComputedTorque : law for a known model
    controllers.AdaptiveVelocity : adaptive control of speed and yaw rate
    identify : estimates the parameters from a log

    Examples
    --------
    >>> from pinmobile import Adaptive, Circle, MobileRobot
    >>> from pinmobile import Tangent, simulate
    >>> robot, model = MobileRobot(30.0, 1.3), MobileRobot(20.0, 1.3)
    >>> path = Tangent(Circle(radius=0.4, rate=2.0, duration=2.0))
    >>> run = simulate(robot, Adaptive(model), path, dt=0.05)
    >>> print(f"{run.signals['mass'].values[-1]:.0f} kg, from 20 kg")
    25 kg, from 20 kg
    """

    robot: Any = child(Passive, doc="controller model; its parameters are the initial estimate")
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
    speed: float = number(default=0.01, above=0.0, unit="m/s, rad/s", doc="speed of dry friction")
    dead_zone: float = number(
        default=0.0, lower=0.0, unit="m/s, rad/s", doc="smallest norm of s that adapts the estimates"
    )
    leakage: float = number(
        default=0.0, lower=0.0, unit="1/s", doc="leakage rate toward the initial estimates"
    )
    lower: Any = bound(-1.0, "lower bounds of the parameters")
    upper: Any = bound(1.0, "upper bounds of the parameters")
    difference: Any = comparison()

    @structure
    def _inertia(self) -> Array:
        """Mass matrix at rest, shape (n, n)."""
        return frozen(self.robot.mass_matrix(self.robot.rest))

    @structure
    def _nominal(self) -> Array:
        """Initial estimate, shape (p,)."""
        M = self._inertia
        is_planar = len(M) == _BASE
        inertial = [M[0, 0], M[1, 2], -M[0, 2], M[2, 2]] if is_planar else self.robot.inertial_parameters
        return frozen(np.concatenate([inertial, np.zeros(2 * len(M) * self.friction)]))

    def check(self) -> None:
        """Complete gains and bounds; raise `InvalidArgument` if the bounds exclude the initial estimate."""
        super().check()
        nominal, M = self._nominal, self._inertia
        p, n = len(nominal), len(M)
        size = _PLANAR if n == _BASE else _SPATIAL
        inertial = nominal[: p - 2 * n * self.friction]
        lowest = np.full(p, -np.inf)
        lowest[: len(inertial) : size] = nominal[: len(inertial) : size] / 10
        lowest[len(inertial) :] = 0.0  # friction
        rates = float(self.robot.mass) * np.array(_BODY_GAINS) if n == _BASE else _spatial_gains(inertial)
        if self.friction:
            sizes = np.where(np.arange(n) < 2, 1.0, _ANGLE_FACTOR) * np.diagonal(M)
            rates = np.concatenate([rates, *(rate * sizes for rate in _FRICTION_GAINS)])
        for name, default in (("gamma", rates), ("lower", lowest), ("upper", np.full(p, np.inf))):
            given = getattr(self, name)
            given = np.full(p, given) if isinstance(given, float) else given
            values = default if given is None else given
            shaped(name, values, (p,), words=", or one number" if name == "gamma" else "")
            object.__setattr__(self, name, frozen(values))
        between(_EXCLUDED, [f"parameter {k}" for k in range(p)], nominal, self.lower, self.upper)

    def initial_state(self, context: Context) -> tuple[Any, ...]:
        """Return the change of the estimates, now and before, the last force, and the time step."""

        def loop(dt: float) -> Array:
            slope, gain = diagonal(self.slope), np.linalg.solve(self._inertia, diagonal(self.kd))
            kp = gain @ slope
            return double_integrators(dt, kp, gain + slope, 0 * kp)

        check_gains(lambda: {"slope": self.slope, "kd": self.kd}, loop, context.dt)
        zeros = np.zeros(len(self._nominal))
        return zeros, zeros, np.zeros(self.robot.nv), float(context.dt)

    def applied(self, u: Array, state: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return the next state for the applied force, shape (..., n)."""
        change, previous, tau, dt = state
        is_unlimited = np.all(is_equal_input(u, tau), axis=-1)[..., None]
        return np.where(is_unlimited, change, previous), previous, tau, dt

    def signals(self, state: tuple[Any, ...]) -> dict[str, Any]:
        """Return the estimates: mass, first moment and inertia of a planar body, else all; and friction."""
        phi, n = self._nominal + state[0], self.robot.nv
        inertial = phi[..., : len(self._nominal) - 2 * n] if self.friction else phi
        if n == _BASE:
            estimates = {
                "mass": ("kg", inertial[..., 0]),
                "first_moment": ("kg m", inertial[..., 1:3]),
                "inertia": ("kg m^2", inertial[..., 3]),
            }
        else:
            estimates = {"inertial_parameters": ("kg, kg m, kg m^2", inertial)}
        if self.friction:
            estimates |= {
                "viscous_friction": ("N s/m, N m s/rad", phi[..., -2 * n : -n]),
                "resistance": ("N, N m", phi[..., -n:]),
            }
        return estimates

    def _regressor(self, q: Array, v: Array, velocity: Array, acceleration: Array) -> Array:
        """Return Y(q, v, v_r, a_r), shape (..., n, p), for M a_r + C(q, v) v_r + g and friction."""
        c, s = np.cos(q[..., 2]), np.sin(q[..., 2])
        if self.robot.nv == _BASE:
            Y = _planar_regressor(c, s, v, velocity, acceleration)
        else:
            regressor, zeros = self.robot.regressor, np.zeros(np.shape(v))
            Y = (
                regressor(q, 0.5 * (v + velocity), acceleration)
                - regressor(q, 0.5 * (v - velocity), zeros)
                + regressor(q, zeros, zeros)
            )
        if not self.friction:
            return Y
        rates = [c * velocity[..., 0] + s * velocity[..., 1], c * velocity[..., 1] - s * velocity[..., 0]]
        rates += [velocity[..., k] for k in range(2, self.robot.nv)]
        smooth = [rate / np.sqrt(rate * rate + self.speed * self.speed) for rate in rates]
        columns = [column for group in (rates, smooth) for column in self._force_columns(group, c, s)]
        return np.concatenate([Y, np.stack(columns, axis=-1)], axis=-1)

    def _force_columns(self, rates: list[Any], c: Array, s: Array) -> list[Array]:
        """Return the forces proportional to each of these rates, shape (..., n) each."""
        zero, columns = 0.0 * rates[0], []
        for k, rate in enumerate(rates):
            rows = [zero] * len(rates)
            rows[k] = rate
            if k == 0:
                rows[:2] = [c * rate, s * rate]
            elif k == 1:
                rows[:2] = [-s * rate, c * rate]
            columns.append(np.stack(np.broadcast_arrays(*rows), axis=-1))
        return columns

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, ...]
    ) -> tuple[Array, tuple[Any, ...]]:
        """Return the generalised force, shape (..., n), and the next state."""
        change, _, _, dt = state
        robot = self.robot
        s, velocity, acceleration = combined_error(self, q, v, reference)
        Y = self._regressor(q, v, velocity, acceleration)
        tau = passive_torque(robot, q, v, velocity, acceleration) + self.kd * s
        tau = tau + np.sum(Y * change[..., None, :], axis=-1)
        phi_rate = self.gamma * np.sum(Y * s[..., :, None], axis=-2) - self.leakage * change
        adapts = np.sum(s * s, axis=-1, keepdims=True) >= np.asarray(self.dead_zone)[..., None] ** 2
        return tau, (self._clip(change + np.where(adapts, dt * phi_rate, 0.0)), change, tau, dt)

    def _clip(self, change: Array) -> Array:
        """Return the change of the estimates, clipped to their bounds."""
        phi = self._nominal + change
        phi = np.minimum(np.maximum(phi, self.lower), self.upper)
        if self.robot.nv > _BASE:
            return np.asarray(phi - self._nominal)
        m0, mx0, my0, I0 = self._nominal[:_PLANAR]
        lowest = _INERTIA_RATIO * (I0 - (mx0 * mx0 + my0 * my0) / m0)
        m, mx, my, inertia = (phi[..., k] for k in range(_PLANAR))
        inertia = np.maximum(inertia, (mx * mx + my * my) / m + lowest)
        parts = [m, mx, my, inertia, *(phi[..., k] for k in range(_PLANAR, len(self._nominal)))]
        return np.asarray(np.stack(parts, axis=-1) - self._nominal)


def _spatial_gains(inertial: Array) -> Array:
    """Return gains for bodies in space, shape (10 bodies,): half of each squared parameter, per joule."""
    rates = []
    for body in inertial.reshape(-1, _SPATIAL):
        inertia = float(body[4] + body[6] + body[9])  # the trace
        sizes = [body[0], *(np.sqrt(max(body[0] * inertia, 0.0)),) * 3, *(inertia,) * 6]
        rates.append(np.square(sizes) / 4)
    return np.concatenate(rates)


def _planar_regressor(c: Array, s: Array, v: Array, velocity: Array, acceleration: Array) -> Array:
    """Return the regressor of a planar body, shape (..., 3, 4)."""
    ax, ay, az = (acceleration[..., k] for k in range(_BASE))
    r, vz = v[..., 2], velocity[..., 2]
    zero = 0.0 * (ax + r)
    rows = (
        (ax, -s * az - r * c * vz, -c * az + r * s * vz, zero),
        (ay, c * az - r * s * vz, -s * az - r * c * vz, zero),
        (zero, c * ay - s * ax, -c * ax - s * ay, az),
    )
    return np.stack([np.stack(np.broadcast_arrays(*row), axis=-1) for row in rows], axis=-2)
