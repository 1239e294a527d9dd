"""`PlanarModel`: equations of motion in the plane that are linear in the identified parameters.

The body twist is nu = S eta with independent velocities eta. S is the identity for a body driven by forces,
and constant for wheels that roll without steering. The parameters are phi = (m, m x, m y, I | c | f), with I
about the body origin, viscous friction c and dry friction f along the rates A eta. M_w is the inertia of the
wheels::

    S' [ m a_u - m x r^2 - m y r'   ]
       [ m a_w + m x r' - m y r^2   ] + M_w eta' + A' (c A eta + f A eta / sqrt((A eta)^2 + e^2)) = F
       [ m x a_w - m y a_u + I r'   ]

with a_u = u' - r w and a_w = w' + r u. F is R(psi)' u for a body driven by forces, and B tau for wheels. The
torques tau are the inputs, or follow from voltages and wheel rates by the motor model with its given limits
and losses. Identified constant offsets are subtracted from u or tau. An identified scale of the inputs
multiplies the torque constants.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from pinmobile import parts
from pinmobile.arrays import Array, bounded, frozen, positive, scalar
from pinmobile.errors import InvalidArgument, format_value, unexpected_value
from pinmobile.forces import JointFriction, RollingResistance, ViscousFriction
from pinmobile.identification._estimates import Identification
from pinmobile.identification._estimator import solve
from pinmobile.identification._log import Log
from pinmobile.identification._preprocessing import DELAY_RANGE, PreprocessedLog
from pinmobile.identification._simulation import Quantity, Segments, simulate
from pinmobile.parts import Tabled, offers
from pinmobile.robot import MobileRobot
from pinmobile.urdf import Body
from pinmobile.wheels import Motor, MotorLaw

_STEP, _RUBBING_STEP = 5e-3, 1e-3  # [s], longest integration steps, without and with dry friction of motors
_LEAST_RESPONSE = 1e-3  # smallest response to an input, as a share of the largest
_RESPONSES = 3  # largest number of responses of a sensor


@dataclass(frozen=True, eq=False)
class PlanarProblem:
    """Unknowns of output error for a planar model: steps along some directions, and the delay.

    Parameters
    ----------
    model : PlanarModel
        Model of the robot.
    base : ndarray, shape (p,)
        Parameters at zero steps.
    basis : ndarray, shape (p, d)
        Directions with typical sizes.
    delay : float
        Delay of the poses [samples].
    free : bool
        Whether the delay is unknown; it is then the last unknown.
    """

    model: Any
    base: Array
    basis: Array
    delay: float
    free: bool = False

    is_linear: ClassVar[bool] = True

    @property
    def start(self) -> Array:
        """The first numbers, shape (P,)."""
        return np.zeros(self.basis.shape[1] + self.free)

    def sizes(self, p: Array) -> Array:
        """Return the sizes of the numbers, shape (P,)."""
        return np.ones(len(p))

    def values(self, p: Array) -> tuple[Array, Array]:
        """Return parameters, shape (..., p), and delays, shape (...), of numbers (..., P)."""
        delay = self.delay + (p[..., -1] if self.free else np.zeros(p.shape[:-1]))
        return self.base + p[..., : self.basis.shape[1]] @ self.basis.T, delay

    def is_possible(self, p: Array) -> bool:
        """Return whether a body can have these numbers, and the delay is near the initial delay."""
        phi, delay = self.values(p)
        return bool(self.model.are_possible(phi) and abs(delay - self.delay) < DELAY_RANGE)

    @property
    def rates(self) -> Callable[..., Any]:
        """Law of one state."""
        return self.model.rates  # type: ignore[no-any-return]

    @property
    def delay_index(self) -> int | None:
        """Index of an unknown delay: noise of a held input is smoother over whole samples."""
        return self.basis.shape[1] if self.free else None

    def rate_numbers(self, segments: Segments, p: Array) -> tuple[Array, Array, float]:
        """Return the parameters with known loads, delays and the longest time step."""
        phi, delay = self.values(p)
        body = np.repeat(phi[:, None], len(segments.y), axis=1)
        body[..., :4] += segments.load
        rubs = any(each.coulomb or each.efficiency < 1 for each in self.model.motors)
        return body, delay, _RUBBING_STEP if rubs else _STEP

    def outputs(self, segments: Segments, states: Array, numbers: Array) -> Array:
        """Return the poses, and rates of wheels where they are measured."""
        if segments.y.shape[-1] == 3:
            return states[..., :3]
        return np.concatenate([states[..., :3], states[..., 3:] @ self.model.A.T], axis=-1)

    def responses(self, segments: Segments, p: Array, starts: Array) -> Array:
        """Return the sensors' responses to inputs during the first time step, shape (r, L, m).

        The robot starts at rest without dry friction. The responses are the principal components over all
        headings and inputs.
        """
        (phi, delay), resting = self.values(p), starts.copy()
        resting[:, 3:], phi[self.model.dry], phi[self.model.offsets] = 0.0, 0.0, 0.0
        fixed, results = PlanarProblem(self.model, phi, self.basis[:, :0], float(delay)), []
        column = segments.lead - int(np.floor(delay))
        for unit in np.diag(segments.sizes):
            pulse = np.zeros((*segments.rows.shape, segments.inputs.shape[1]))
            pulse[:, column] = unit
            rows_u = np.arange(pulse[..., 0].size).reshape(segments.rows.shape)
            pulses = segments._replace(inputs=pulse.reshape(-1, pulse.shape[-1]), rows=rows_u)
            outputs = simulate(fixed, pulses, np.zeros((1, 0)), resting[None])[0] / segments.noise[:, None]
            results.append(outputs - outputs[:, :1])
        _, sizes, rows = np.linalg.svd(np.moveaxis(np.concatenate(results), -1, 0), full_matrices=False)
        sizes = np.where(sizes > _LEAST_RESPONSE * sizes[:, :1], sizes, 0.0)
        return np.asarray(np.moveaxis((sizes[..., None] * rows)[:, :_RESPONSES], 0, -1))


POSE = ("x", "m"), ("y", "m"), ("psi", "rad")
_SPEED, _WHEEL_SPEED = 0.01, 0.1  # where dry friction has 71 %: [m/s, rad/s] of a body, [rad/s] of wheels
_SLOW_RATE = 2e-3  # [rad/s], where losses of a motor have 71 % of their size; those of real ones are sharp
_GYRATION = 0.01  # [m], least radius of a body
_LIGHTEST = 0.02  # [kg]
_NOTHING = 1e-14  # of the largest variance
_MARGIN = 1e-6  # of what a bound lacks
_STEPS = 200  # of a search for a body, of which some ten are needed
_HORIZON = 2.0  # [s]
_AXES = "forward", "left", "yaw"
_BODY = (
    Quantity("mass", "kg", True, "mass"),
    Quantity("com_x", "m", False, "com.x"),
    Quantity("com_y", "m", False, "com.y"),
    Quantity("yaw_inertia", "kg m^2", True, "yaw_inertia"),
)
_BODY_FRICTION = ("viscous", "coefficients", "N s/m", "N m s"), ("rolling", "force", "N", "N m")
_JOINT_FRICTION = ("joint_viscous", "viscous", "N m s/rad"), ("joint_coulomb", "coulomb", "N m")


@dataclass(frozen=True, eq=False)
class PlanarModel:
    """Model of a robot in the plane that is linear in the identified parameters.

    Attributes
    ----------
    S : ndarray, shape (3, k)
        Body twist of the independent velocities.
    A : ndarray, shape (a, k)
        Rates with friction: along the body axes, or of the driven wheels.
    B : ndarray, shape (k, nu), or None
        Generalized force of the inputs; None: the input is a force in the inertial frame.
    inertia : ndarray, shape (k, k)
        Known contribution of the wheels to the mass matrix.
    speed : float
        Speed at which dry friction has 71 % of its size.
    wheels : tuple of str
        Names of the driven wheels with friction; empty for a body driven by forces.
    has_scale : bool
        Whether the last entry of phi is the scale of the inputs.
    motors : tuple of Motor
        Motor of each input if any input is a voltage; otherwise empty.
    offset : bool
        Whether phi has, after the friction, a constant offset of each input.
    blind : bool
        Whether only the rates of wheels are measured.
    """

    S: Array
    A: Array
    B: Array | None
    inertia: Array
    speed: float
    wheels: tuple[str, ...] = ()
    has_scale: bool = False
    motors: tuple[Motor, ...] = ()
    offset: bool = False
    blind: bool = False

    summary_size: ClassVar[int] = 4

    @classmethod
    def of(cls, robot: Any, speed: float | None = None, has_scale: bool = False) -> PlanarModel:
        """Return the model of a body driven by forces, or of a robot on wheels with torques or voltages.

        Raises
        ------
        InvalidArgument
            If wheels steer, slip, or share a motor, or the robot has arms.
        """
        if not offers(robot, Tabled):
            if robot is not None and (not isinstance(robot, MobileRobot) or robot.mounts):
                body = "a MobileRobot without arms (robot.with_locked_arms() has them locked)"
                wheels = "a WheeledRobot that rolls; for velocity inputs use identify_velocity"
                raise unexpected_value("robot", robot, f"{body}, or {wheels}")
            slow = positive("rolling_speed", _SPEED if speed is None else speed, "m/s")
            eye = frozen(np.eye(3))
            return cls(eye, eye, None, frozen(np.zeros((3, 3))), slow, has_scale=has_scale)
        slow = positive("rolling_speed", _WHEEL_SPEED if speed is None else speed, "rad/s")
        table = robot.table
        if table.axes or robot.ground.slips or table.couplings or robot.mounts:
            raise InvalidArgument(
                f"robot is {format_value(robot)}, with wheels that steer or slip, shared motors, or arms, "
                "expected wheels that roll and do not steer, with separate motors and without arms, such as "
                "a differential, mecanum or omni drive"
            )
        dynamics = robot.reduced(robot.rest, np.zeros(robot.nv))
        S, turning = dynamics.S[:3], dynamics.S[3:]
        names = tuple(each.name for each in table.actuators)
        inertia = dynamics.M - S.T @ robot.robot.mass_matrix(np.zeros(3)) @ S
        columns = np.stack([each.column for each in table.actuators], axis=-1)
        volts = any(each.unit == "V" for each in robot.inputs)
        motors = tuple(each.motor for each in table.actuators) if volts else ()
        S, A, B, inertia = (frozen(each) for each in (S, columns.T @ turning, dynamics.B, inertia))
        return cls(S, A, B, inertia, slow, names, has_scale, motors)

    def prior(self, robot: Any) -> Array:
        """Return phi of a robot."""
        body = (robot.robot if self.wheels else robot).with_locked_arms()
        values = np.zeros(self.size)
        values[:4] = body.mass, *body.com[:2], body.body.yaw_inertia
        values[self.size - self.has_scale :] = 1.0
        return self.phi(values)

    @property
    def measured(self) -> tuple[tuple[str, str], ...]:
        """Names and units of the measurements in results."""
        return tuple((n, "rad/s") for n in self.wheels) if self.blind else (*POSE,)

    @property
    def columns(self) -> slice:
        """Columns of these measurements in a segment."""
        return slice(3, None) if self.blind else slice(3)

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the measurements of a log."""
        return ("q", "wheel_rates") if self.wheels else ("q",)

    @property
    def free(self) -> int:
        """Number of independent velocities."""
        return int(self.S.shape[1])

    @property
    def nu(self) -> int:
        """Size of the input."""
        return 3 if self.B is None else int(self.B.shape[1])

    @property
    def inputs(self) -> dict[str, str]:
        """Units of the inputs by name."""
        if not self.wheels:
            return {"Fx": "N", "Fy": "N", "Mz": "N m"}
        return units_of(self.wheels, self.motors)

    @cached_property
    def quantities(self) -> tuple[Quantity, ...]:
        """Physical parameters, with the centre of mass and the inertia about it."""
        items = [*_BODY]
        for kind, path, *units in _JOINT_FRICTION if self.wheels else _BODY_FRICTION:
            rows = [(n, units[0]) for n in self.wheels] or zip(_AXES, [units[0], *units], strict=True)
            items += [Quantity(f"{kind}_{n}", unit, True, f"{path}.{n}") for n, unit in rows]
        if self.offset:
            pairs = [(n, "N m") for n in self.wheels] or [*self.inputs.items()]
            items += [Quantity(f"offset_{n}", unit, False) for n, unit in pairs]
        if self.has_scale:
            items.append(Quantity("input_scale", "", True))
        return tuple(items)

    @property
    def size(self) -> int:
        """Size of phi."""
        return 4 + 2 * len(self.A) + self.nu * self.offset + self.has_scale

    @property
    def dry(self) -> slice:
        """Slice of dry friction in phi."""
        return slice(4 + len(self.A), 4 + 2 * len(self.A))

    @property
    def offsets(self) -> slice:
        """Slice of the offsets of the inputs in phi."""
        return slice(self.dry.stop, self.size - self.has_scale)

    def to_physical(self, phi: Array) -> Array:
        """Return the physical parameters, shape (..., p): com = (m x, m y) / m, and the inertia about it."""
        m, mx, my, inertia = (phi[..., k] for k in range(4))
        I_com = inertia - (mx * mx + my * my) / m
        return np.concatenate([np.stack([m, mx / m, my / m, I_com], -1), phi[..., 4:]], -1)

    def phi(self, physical: Array) -> Array:
        """Return phi of physical parameters, shape (..., p)."""
        m, x, y, I_com = (physical[..., k] for k in range(4))
        first = np.stack([m, m * x, m * y, I_com + m * (x * x + y * y)], -1)
        return np.concatenate([first, physical[..., 4:]], -1)

    def slopes(self, phi: Array) -> Array:
        """Return the derivatives of the physical parameters with respect to phi, shape (p, p)."""
        m, mx, my = phi[:3]
        D = np.eye(len(phi))
        D[1, :2] = -mx / m**2, 1 / m
        D[2, [0, 2]] = -my / m**2, 1 / m
        D[3, :4] = (mx * mx + my * my) / m**2, -2 * mx / m, -2 * my / m, 1.0
        return D

    def are_possible(self, phi: Array) -> Any:
        """Return whether mass and yaw inertia about the centre of mass are positive, for phi (..., p)."""
        m, mx, my, inertia = (phi[..., k] for k in range(4))
        return (m > 0) & (m * inertia > mx * mx + my * my)

    def possible(self, phi: Array, scales: Array) -> Array:
        """Return phi with a positive mass and inertia: unchanged if possible, otherwise with small values."""
        values = np.array(phi)
        values[0] = max(values[0], 1e-2 * scales[0])
        steiner = (values[1] ** 2 + values[2] ** 2) / values[0]
        values[3] = max(values[3], steiner + 1e-2 * scales[3])
        return values

    def plausible(self, phi: Array, covariance: Array) -> Array:
        """Return the most likely parameters of a possible body with nonnegative friction.

        The result minimises (p - phi)' C^-1 (p - phi) subject to nonnegative friction and scale, and to the
        linear matrix inequality of a body with a radius of gyration of at least rho::

            [ I - rho^2 m  m x  m y ]
            [ m x          m    0   ]  >= 0
            [ m y          0    m   ]

        Both constraints are convex. Directions without covariance C do not change.

        Raises
        ------
        InvalidArgument
            If there is no such body.
        """
        from scipy.optimize import minimize  # slow to load

        friction = [k for k, item in enumerate(self.quantities) if item.nonnegative and k > 3]

        def slack(p: Array) -> Array:
            return np.concatenate([[p[0] - _LIGHTEST, _inertia_left(p)], p[friction]])

        if (slack(phi) >= 0).all():
            return phi
        values, vectors = np.linalg.eigh(covariance)
        free = values > _NOTHING * values.max()
        root, size = vectors[:, free] * np.sqrt(values[free]), np.abs(slack(phi)) + 1e-3 * np.abs(phi).max()
        bound = {"type": "ineq", "fun": lambda z: slack(phi + root @ z) / size}
        search = {"method": "SLSQP", "constraints": bound, "options": {"ftol": _MARGIN**2, "maxiter": _STEPS}}
        body = phi + root @ minimize(lambda z: (z @ z / 2, z), np.zeros(root.shape[1]), jac=True, **search).x
        if not (slack(body) >= -_MARGIN * size).all():
            raise InvalidArgument(
                f"log leads to a mass of {phi[0]:.3g} kg and a yaw inertia of {self.to_physical(phi)[3]:.3g} "
                "kg m^2, far from any possible body, expected both above zero"
            )
        body[3] += max(0.0, -_inertia_left(body))
        body[friction] = np.maximum(body[friction], 0.0)
        return np.asarray(body)

    def robot(self, estimates: Identification) -> Any:
        """Return the identified robot; see `Identification.robot`."""
        m, x, y, inertia = self.to_physical(estimates.plausible)[:4].tolist()
        prior = estimates.prior
        if prior is None:
            return MobileRobot(m, inertia, com=(x, y))
        new = with_inertia((prior.robot if self.wheels else prior).with_locked_arms(), m, x, y, inertia)
        if not self.wheels:
            return new
        if not self.motors:
            return parts.evolved(prior, robot=new)
        plant = parts.evolved(prior.wheeled, robot=new).by_voltage()
        if self.has_scale:
            scale = estimates.plausible[-1]
            constants = zip(plant.motor_paths, self.motors, strict=True)
            changes = {f"{path}.torque_constant": motor.torque_constant * scale for path, motor in constants}
            plant = parts.replace(plant, changes)
        return plant

    def forces(self, estimates: Identification) -> list[Any]:
        """Return the friction for `simulate`; see `Identification.forces`."""
        viscous, dry = np.split(self.to_physical(estimates.plausible)[4 : self.dry.stop], 2)
        if not self.wheels:
            return [ViscousFriction(viscous), RollingResistance(dry, self.speed)]
        names = [item.name for item in estimates.prior.coordinates]
        columns = np.zeros((2, len(names)))
        columns[:, [names.index(name) for name in self.wheels]] = viscous, dry
        return [JointFriction(columns[0], columns[1], self.speed, names)]

    def notes(self, estimates: Identification) -> list[str]:
        """Return notes on parameters that the log does not identify."""
        notes = ["the motion does not separate constant offsets of inputs from friction: taken as zero"]
        notes = notes * (not self.offset)
        if estimates.slippage is not None and estimates.slippage.matters:
            notes.append(str(estimates.slippage))
        if self.wheels:
            notes.append(
                "the log does not separate the inertia of the wheels from mass and yaw inertia: "
                f"{self.inertia[0, 0]:.3g} kg and {self.inertia[-1, -1]:.3g} kg m^2 are the given values"
                + ", as are motors with their friction and gears"
                * bool(self.motors)
            )
            if not self.has_scale:
                notes.append(
                    "all estimates are proportional to the given torque per input: a log with a known load "
                    "identifies this factor, identify([log, loaded], robot, loads=[None, load])"
                )
        return notes

    def predicted(
        self, estimates: Identification, log: Log, seconds: float | None
    ) -> tuple[Segments, Array, NDArray[np.bool_], Array]:
        """Return segments of a log, residuals, mask of good samples, and the noise of the sensors."""
        if log.q is None and not self.blind:
            raise InvalidArgument("log has no q, expected poses, as the identified logs have")
        run = PreprocessedLog.of(log, self, np.zeros(4))
        lag, longest = estimates.delay / run.dt, len(run.q) * run.dt - 2 * abs(estimates.delay) - 4 * run.dt
        length = scalar("seconds", _HORIZON if seconds is None else seconds)
        span = bounded("seconds", length, least=10 * run.dt, most=longest, unit="s")
        segments = run.segments(self, lag, span, run.rates is not None)
        search = PlanarProblem(self, estimates.phi, np.zeros((len(estimates.phi), 0)), lag)
        left = solve(search, segments, search.start).linear.residual
        return segments, left, segments.good, run.reported_noise

    def rows(self, a_u: Array, a_w: Array, turn: Array, square: Array, rates: Array, dry: Array) -> Array:
        """Return the regressor along the independent velocities, shape (n, k, p), without the input scale.

        Parameters
        ----------
        a_u, a_w : ndarray, shape (n,)
            Accelerations forward and to the left.
        turn, square : ndarray, shape (n,)
            r' and r^2.
        rates, dry : ndarray, shape (n, a)
            Rates with friction, and their regularised signs.
        """
        zero = np.zeros_like(a_u)
        columns = [a_u, -square, -turn, zero], [a_w, turn, -square, zero], [zero, a_w, -a_u, turn]
        body = np.stack([np.stack(row, axis=-1) for row in columns], axis=1)
        friction = [part[:, None, :] * self.A.T[None] for part in (rates, dry)]
        return np.concatenate([np.einsum("ai,naj->nij", self.S, body), *friction], axis=-1)

    def rates(self, z: Any, u: Any, phi: Any) -> Any:
        """Return the rates of pose and independent velocities, shape (3 + k,), of one state and input."""
        psi, eta = z[2], z[3:]
        nu, speeds = self.S @ eta, self.A @ eta
        a, c, s = len(self.A), np.cos(psi), np.sin(psi)
        scale = phi[self.size - 1] if self.has_scale else 1.0
        force = np.stack(torques_of(self.motors, u, speeds, scale))
        if self.offset:
            force = force - phi[self.offsets]
        if self.B is None:
            force = np.stack([c * force[0] + s * force[1], c * force[1] - s * force[0], force[2]])
        else:
            force = self.B @ force
        friction = phi[4 : 4 + a] * speeds + phi[self.dry] * speeds / np.sqrt(speeds * speeds + self.speed**2)
        M, h = inertia_of(phi, nu)
        M, force = self.S.T @ M @ self.S + self.inertia, force + self.S.T @ h - self.A.T @ friction
        return np.concatenate([pose_rate(psi, nu), np.linalg.solve(M, force)])


def torques_of(motors: Sequence[Motor], u: Any, rates: Any, scale: Any = 1.0) -> list[Any]:
    """Return the torques of the inputs at rates of their wheels, in numbers, arrays or symbols.

    Parameters
    ----------
    motors : sequence of Motor
        Motors; empty if the inputs are torques.
    u, rates : sequence, shape (nu,)
        Inputs and rates [rad/s].
    scale : scalar
        Factor on the torques, or on the torque constants of motors.
    """
    if not motors:
        return [scale * x for x in u]
    law = MotorLaw.of(motors)
    law = replace(law, torque_constant=scale * law.torque_constant)
    return [
        law.smooth_torque(k, law.volts(k, x), rate, rate / np.sqrt(rate * rate + _SLOW_RATE**2))
        if motor.is_electric
        else scale * x
        for k, (motor, x, rate) in enumerate(zip(motors, u, rates, strict=True))
    ]


def units_of(names: Sequence[str], motors: Sequence[Motor]) -> dict[str, str]:
    """Return the units of the inputs by name: voltages of electric motors, otherwise torques."""
    electric = [each.is_electric for each in motors] or [False] * len(names)
    return {n: "V" if volts else "N m" for n, volts in zip(names, electric, strict=True)}


def inertia_of(phi: Any, nu: Any) -> tuple[Any, Any]:
    """Return mass matrix and inertial force of a body with phi = (m, m x, m y, I, ...) and a body twist."""
    (m, mx, my, inertia), (forward, left, r) = (phi[k] for k in range(4)), (nu[k] for k in range(3))
    M = np.stack([np.stack([m, 0.0, -my]), np.stack([0.0, m, mx]), np.stack([-my, mx, inertia])])
    h = np.stack([r * (m * left + mx * r), r * (my * r - m * forward), -r * (mx * forward + my * left)])
    return M, h


def pose_rate(psi: Any, nu: Any) -> Any:
    """Return the rates of x, y and psi for a body twist, shape (3,)."""
    c, s = np.cos(psi), np.sin(psi)
    return np.stack([c * nu[0] - s * nu[1], s * nu[0] + c * nu[1], nu[2]])


def with_inertia(robot: MobileRobot, mass: float, x: float, y: float, yaw_inertia: float) -> MobileRobot:
    """Return a robot without arms with another mass, centre of mass and yaw inertia about it."""
    centre, J = np.array([x, y, robot.body.com[2]]), np.array(robot.body.inertia)
    tensor, J[2, 2] = J * (yaw_inertia / J[2, 2]), yaw_inertia
    # If the moments violate the triangle inequality, scale all moments of the prior instead.
    body = Body(mass, centre, J if J[2, 2] <= J[0, 0] + J[1, 1] else tensor)
    return robot.with_body(body, f"{robot.source}; identified from a log")


def _inertia_left(phi: Array) -> float:
    """Return the excess of the inertia about the centre of mass over the smallest possible inertia."""
    m, mx, my, inertia = phi[:4]
    return float(inertia - _GYRATION**2 * m - (mx * mx + my * my) / max(m, _LIGHTEST))
