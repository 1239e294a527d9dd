"""`VelocityRobot` and `VelocityCar`: robots with velocity inputs; `VELOCITY_ROBOTS`: published parameters."""

from __future__ import annotations

import functools
import inspect
import tomllib
from collections.abc import Callable, Mapping
from functools import cached_property
from importlib.resources import files
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, TypeVar, final

import attrs
import numpy as np
import pinocchio as pin

from pinmobile.arrays import (
    Array,
    ArrayLike,
    broadcast,
    finite,
    finite_result,
    frozen,
    instance,
    lengths,
    non_negative,
    positive,
    shaped,
    text,
    vector,
    wrap_angle,
)
from pinmobile.errors import InvalidArgument, unexpected_value
from pinmobile.integrators import rk4
from pinmobile.parts import array, by_value, evolved, is_symbolic, number, option, part, structure
from pinmobile.plant import Coordinate, Input
from pinmobile.robot import MobileRobot
from pinmobile.wheels import ByVoltage, Reduced, WheeledRobot, WheelTable

# Units of the parameters by name. 1 and 2 are inertias of speed and yaw rate divided by the gain of the loop,
# 3 and 5 effects of a centre of mass ahead of the axle, 4 and 6 commands per steady value: 1 + losses / gain.
THETA = {f"theta_{k}": unit for k, unit in enumerate(("s", "s", "s m/rad^2", "", "s/m", ""), 1)}
ABOVE_ZERO = 0, 1, 3, 5  # zero inertia makes the model singular; zero losses make it unstable


def rates_of(theta: Any, limit: Any, nu: Any, u: Any) -> Any:
    """Return the rates of speed and yaw rate nu for commands u, limited to +-limit, shape (..., 2)."""
    speed, w = nu[..., 0], nu[..., 1]
    one, two, three, four, five, six = (theta[..., k] for k in range(len(THETA)))
    faster = (three * (w * w) - four * speed + u[..., 0]) / one
    turning = (u[..., 1] - five * (speed * w) - six * w) / two
    return np.minimum(np.maximum(stack(faster, turning), -limit), limit)


def rolling_of(ahead: Any, q: Any, nu: Any) -> Any:
    """Return the rates of x, y and psi of a point ahead of the axle, shape (..., 3)."""
    c, s, u, w = np.cos(q[..., 2]), np.sin(q[..., 2]), nu[..., 0], nu[..., 1]
    return stack(u * c - ahead * w * s, u * s + ahead * w * c, w)


def point_acceleration(ahead: Any, q: Any, nu: Any, rates: Any, *others: Any) -> Any:
    """Return the accelerations of x, y and psi of a point ahead of the axle, and others, shape (..., nv)."""
    c, s, u, w = np.cos(q[..., 2]), np.sin(q[..., 2]), nu[..., 0], nu[..., 1]
    forward, lateral = rates[..., 0] - ahead * (w * w), u * w + ahead * rates[..., 1]
    return stack(forward * c - lateral * s, forward * s + lateral * c, rates[..., 1], *others)


def stack(*columns: Any) -> Any:
    """Return broadcast columns along a new last axis."""
    return np.stack(np.broadcast_arrays(*columns), axis=-1)


_SAME = 1e-9  # largest relative difference of two equal wheels


def _pair_of(robot: WheeledRobot) -> tuple[Any, Any]:
    """Return a wheel and a motor of a robot on two equal driven wheels."""
    table, is_pair = robot.table, False
    if not (robot.robot.nv > 3 or table.axes or table.couplings) and len(table) == len(table.actuators) == 2:
        wheel, other = table.wheels
        a, b = ((each.x, each.radius, each.spin_inertia, abs(each.y)) for each in (wheel, other))
        is_plain = not (wheel.angle or other.angle or wheel.roller or other.roller) and wheel.y * other.y < 0
        is_pair = is_plain and np.allclose(a, b, _SAME, _SAME) and wheel.motor == other.motor
    if not (is_pair and wheel.motor and wheel.motor.is_electric):
        raise InvalidArgument(
            "wheeled has arms, or other wheels or motors, expected WheelTable.differential: two equal fixed "
            "wheels on one axle, each with the same Motor(resistance=..., torque_constant=..., voltage=...)"
        )
    return wheel, wheel.motor


ALL = 0  # size of an array with a number for each coordinate
_Method = TypeVar("_Method", bound=Callable[..., Any])


def arrays(**sizes: int) -> Callable[[_Method], _Method]:
    """Decorate a method so that it checks the sizes of its arrays; symbols pass unchecked."""

    def decorate(method: _Method) -> _Method:
        signature = inspect.signature(method)

        @functools.wraps(method)
        def run(self: Any, *given: Any, **keywords: Any) -> Any:
            if "nominal" in vars(self) or any(map(is_symbolic, (*given, *keywords.values()))):
                return method(self, *given, **keywords)
            bound = signature.bind(self, *given, **keywords).arguments
            arrays = {name: vector(name, bound[name], size or self.nq) for name, size in sizes.items()}
            broadcast(**arrays)
            return np.asarray(method(**(bound | arrays)))

        return finite_result(run)  # type: ignore[return-value]

    return decorate


_SIDESLIP_TOLERANCE = 1e-9  # largest sideways share of a start velocity


class Mobile(NamedTuple):
    """Type (mobility, steerability) of a drive with two driven wheels on one axle."""

    mobility: int = 2
    steerability: int = 0


def pair(doc: str, unit: str, labels: tuple[str, str], fixed: bool = False) -> Any:
    """Declare two positive limits; a scalar sets both."""
    options: dict[str, Any] = {"doc": doc, "unit": unit, "labels": labels, "above": 0, "fixed": fixed}
    return array(default=np.inf, shapes=((), ("n",)), size=lambda robot: 2, **options)


def size_of(name: str, value: Any) -> Any:
    """Return length, width and height of a drawn box."""
    return tuple(lengths(value).tolist())


class VelocityInputs:
    """Methods of robots on wheels with commands of their speed as inputs."""

    integrator: ClassVar[Any] = rk4
    broadcasts: ClassVar[bool] = True
    compiles: ClassVar[bool] = True
    reference_sizes: ClassVar[Mapping[int, int]] = MappingProxyType({3: 3})
    commanded: ClassVar[tuple[tuple[str, str], ...]]
    unforced: ClassVar[str]
    nq: ClassVar[int]
    ahead: float
    limits: Any
    rolling: Any
    _acceleration: Any
    _visuals: Any

    @structure
    def inputs(self) -> tuple[Input, ...]:
        """Commands with their limits."""
        rows = zip(self.commanded, self.limits, strict=True)
        return tuple(Input(*label, -float(limit), float(limit)) for label, limit in rows)

    @property
    def axle(self) -> Any:
        """Coefficients c of the no-slip constraint c . (u, v, r) = 0 across the wheels, shape (3,)."""
        ahead = np.asarray(self.ahead)
        return np.stack([0.0 * ahead, 0.0 * ahead + 1.0, -ahead], axis=-1)

    @arrays(q=ALL, dq=ALL)
    def integrate(self, q: ArrayLike, dq: ArrayLike) -> Any:
        """Return the configuration `q` + `dq`, shape (..., nq)."""
        return q + dq  # type: ignore[operator]

    @arrays(q0=ALL, q1=ALL)
    def difference(self, q0: Any, q1: Any) -> Any:
        """Return the displacement from `q0` to `q1`, shape (..., nv), with psi in (-pi, pi]."""
        d = q1 - q0
        return stack(d[..., 0], d[..., 1], wrap_angle(d[..., 2]), *(d[..., k] for k in range(3, self.nq)))

    @arrays(q=ALL)
    def pose(self, q: Any) -> Any:
        """Return the pose (x, y, psi), shape (..., 3) [m, m, rad]."""
        return q[..., :3]

    @arrays(q=ALL, v=ALL)
    def pose_rate(self, q: Any, v: Any) -> Any:
        """Return the rates of x, y and psi, shape (..., 3) [m/s, m/s, rad/s]."""
        return v[..., :3]

    @arrays(q=ALL, v=ALL)
    def independent(self, q: Any, v: Any) -> Any:
        """Return the independent velocities, shape (..., 2): speed along the wheels, and last entry of v."""
        return stack(np.cos(q[..., 2]) * v[..., 0] + np.sin(q[..., 2]) * v[..., 1], v[..., -1])

    @arrays(q=ALL, v=ALL)
    def project(self, q: Any, v: Any) -> Any:
        """Return `v` without sliding of the wheels, shape (..., nv)."""
        return self.rolling(q, self.independent(q, v))

    def check_start(self, q: ArrayLike, v: ArrayLike) -> None:
        """Reject a start at which the wheels slide sideways.

        Raises
        ------
        InvalidArgument
            If the velocity is not that of rolling wheels.
        """
        sideslip = float(np.abs(self.project(q, v) - np.asarray(v)).max(initial=0.0))
        if sideslip > _SIDESLIP_TOLERANCE * (1 + float(np.abs(v).max(initial=0.0))):
            raise InvalidArgument(
                f"start has wheels that slide sideways at {sideslip:.3g} m/s, expected rolling wheels: use a "
                "reference along which wheels roll, such as Tangent(path), or v0 = robot.project(q0, v0)"
            )

    @arrays(q=ALL, v=ALL, u=2)
    def forward_dynamics(self, q: Any, v: Any, u: Any, f: Any = 0.0) -> Any:
        """Return the acceleration, shape (..., nv) [m/s^2, m/s^2, rad/s^2, ...].

        Parameters
        ----------
        q, v : array_like, shape (..., nq)
            State with rolling wheels. The model only uses the `independent` velocities of v.
        u : array_like, shape (..., 2)
            Commands.
        f : array_like
            External forces: zero.

        Raises
        ------
        InvalidArgument
            If an array has another shape or is not finite, or `f` is not zero.
        """
        if not is_symbolic(f) and finite("f", f).any():
            raise unexpected_value("f", f, f"zero: {self.unforced} responds to a force")
        return self._acceleration(q, v, u)

    @property
    def visual_model(self) -> pin.GeometryModel:
        """Visual geometry, a copy: a box with a dark front, and wheels that do not spin."""
        return self._visuals.visual_model


@final
@part
@by_value
class VelocityRobot(VelocityInputs):
    """A base on two driven wheels with commands of speed and yaw rate as inputs.

    The firmware of the robot controls both by the voltages of the motors. Six parameters theta describe the
    closed velocity loops::

        u' = (theta_3 / theta_1) w^2  - (theta_4 / theta_1) u + u_c / theta_1
        w' = -(theta_5 / theta_2) u w - (theta_6 / theta_2) w + w_c / theta_2
        x' = u cos psi - a w sin psi,  y' = u sin psi + a w cos psi,  psi' = w

    Here u is the speed along the wheels, w is the yaw rate, and (u_c, w_c) are the commands. q = (x, y, psi)
    is the pose of a point at distance a ahead of the axle, and v = dq/dt.

    The model accepts no forces: theta does not describe how the firmware responds to a force. The integrator
    is `rk4`. It needs time steps, or substeps, shorter than twice the smaller of `time_constants`.

    Parameters
    ----------
    theta : array_like, shape (6,)
        Parameters [s, s, s m/rad^2, -, s/m, -]. The first, second, fourth and sixth are positive.
    ahead : float
        Distance a of the body origin ahead of the axle [m].
    limits : array_like, shape () or (2,)
        Largest commands in both directions, > 0 [m/s, rad/s]; infinite: no limit.
    accelerations : array_like, shape () or (2,)
        Largest absolute values of u' and w' in the firmware, > 0 [m/s^2, rad/s^2]; infinite: no limit.
    size : array_like, shape (3,)
        Length, width and height of the drawn box [m].
    source : str
        Source of the numbers.

    Raises
    ------
    InvalidArgument
        If a number is not finite or out of range, or an array has another shape.

    See Also
    --------
    identify_velocity : estimate theta from a log
    Backstepping : control law that compensates the lag of the firmware
    controllers.VelocityCommand : control law that ignores the lag

    Notes
    -----
    `pinmobile.identification.VELOCITY_ROBOTS` maps names to robots with published theta. The source of each
    robot names the publication.

    References
    ----------
    C. De La Cruz and R. Carelli, IECON 2006 and Robotica 26 (2008). F. N. Martins et al., Journal of
    Intelligent and Robotic Systems 85 (2017).

    Examples
    --------
    >>> from pinmobile.identification import VELOCITY_ROBOTS
    >>> robot = VELOCITY_ROBOTS["pioneer_3dx_laser"]
    >>> robot.time_constants  # of speed and yaw rate [s]
    (0.26, 0.23)
    >>> robot.rates(nu=[0.0, 0.0], u=[1.0, 0.0])  # [m/s^2, rad/s^2]
    array([3.84, 0.  ])
    """

    theta: Any = array(
        shapes=((len(THETA),),),
        unit=", ".join(THETA.values()),
        labels=tuple(THETA),
        doc="parameters of the velocity loops",
    )
    ahead: float = number(default=0.0, unit="m", doc="distance of the body origin ahead of the axle")
    limits: Any = pair("largest commands", "m/s, rad/s", ("speed", "yaw_rate"), fixed=True)
    accelerations: Any = pair("largest |u'| and |w'|", "m/s^2, rad/s^2", ("acceleration", "yaw_acceleration"))
    size: tuple[float, float, float] = option(default=(0.45, 0.38, 0.25), check=size_of)
    source: str = option(default="", check=text)

    nq: ClassVar[int] = 3
    nv: ClassVar[int] = 3
    nu: ClassVar[int] = 2
    commanded: ClassVar[Any] = ("speed command", "m/s"), ("yaw rate command", "rad/s")
    unforced: ClassVar[str] = "theta does not describe how firmware"
    coordinates: ClassVar[tuple[Coordinate, ...]] = (
        Coordinate("x", "m", rate="vx"),
        Coordinate("y", "m", rate="vy"),
        Coordinate("psi", "rad", rate="yaw_rate"),
    )
    mobility: ClassVar[Mobile] = Mobile()
    rest: ClassVar[Array] = frozen(np.zeros(3))

    def check(self) -> None:
        """Check the signs of theta.

        Raises
        ------
        InvalidArgument
            If theta_1, theta_2, theta_4 or theta_6 is not positive.
        """
        for k in ABOVE_ZERO:
            positive(f"theta[{k}]", self.theta[k], [*THETA.values()][k])

    @classmethod
    def from_motors(
        cls, wheeled: WheeledRobot | ByVoltage, kp: float, kd: float = 0.0, **others: Any
    ) -> VelocityRobot:
        """Return the robot whose firmware controls the rates of two driven wheels by motor voltages.

        The voltage of a motor is ``kp (W_c - W) - kd W'``. W is the wheel rate, and W_c is its value for the
        commands. With kd = 0 this is the law of `WheelSpeed` without integral action. The robot has mass m
        and yaw inertia I about its centre of mass, at distance b ahead of the axle. Its wheels have radius r,
        distance d, and inertia J with rotor and gear. Its motors have resistance R and, at the wheel, torque
        constant K, back-EMF constant E and viscous friction B. The gains of speed and yaw rate are
        kT = kp / r and kR = kp d / (2 r), and likewise kdT and kdR::

            theta_1 = [(R/K) (m r^2 + 2 J) + 2 r kdT] / (2 r kT)
            theta_2 = [(R/K) (J d^2 + 2 r^2 (I + m b^2)) + 2 r d kdR] / (2 r d kR)
            theta_3 = (R/K) m b r / (2 kT)          theta_5 = (R/K) m b r / (d kR)
            theta_4 = (R/K) (K E / R + B) / (r kT) + 1
            theta_6 = (R/K) (K E / R + B) d / (2 r kR) + 1

        (De La Cruz and Carelli 2008.) The six numbers do not include dry friction of the motors, limits of
        voltage and current, and a centre of mass beside the middle. For gears with losses, the formulas hold
        while the motors drive the wheels.

        Parameters
        ----------
        wheeled : WheeledRobot or ByVoltage
            Robot with two equal fixed wheels with tyres on one axle, each with the same electric motor, and
            casters; without arms.
        kp : float
            Proportional gain, > 0 [V s/rad].
        kd : float
            Derivative gain, >= 0 [V s^2/rad].
        **others
            ``limits``, ``accelerations`` and ``size`` of the class.

        Returns
        -------
        robot : VelocityRobot
            Robot with this theta.

        Raises
        ------
        InvalidArgument
            If the robot has other wheels or motors, or arms, or a gain is out of range.

        Notes
        -----
        No theta represents firmware with integral action exactly. Simulate such firmware by `WheelSpeed`, and
        estimate the nearest theta by `identify_velocity`.
        """
        robot: Any = wheeled.wheeled if isinstance(wheeled, ByVoltage) else wheeled
        instance("wheeled", robot, WheeledRobot, "a WheeledRobot")
        kp, kd = positive("kp", kp, "V s/rad"), non_negative("kd", kd, "V s^2/rad")
        wheel, motor = _pair_of(robot)
        base, r, d = robot.robot, wheel.radius, 2 * abs(wheel.y)
        m, b = base.mass, float(base.com[0]) - wheel.x
        J, E = wheel.spin_inertia + motor.reflected_inertia, motor.gear * motor.torque_constant
        ratio = motor.resistance / (motor.efficiency * E)
        losses = E + ratio * motor.efficiency * motor.gear**2 * motor.viscous  # (R/K) (K E / R + B)
        T, R, dT, dR = kp / r, kp * d / (2 * r), kd / r, kd * d / (2 * r)
        turning = J * d * d + 2 * r * r * (base.yaw_inertia + m * b * b)
        theta = [
            (ratio * (m * r * r + 2 * J) + 2 * r * dT) / (2 * r * T),
            (ratio * turning + 2 * r * d * dR) / (2 * r * d * R),
            ratio * m * b * r / (2 * T),
            losses / (r * T) + 1,
            ratio * m * b * r / (d * R),
            losses * d / (2 * r * R) + 1,
        ]
        source = f"motors of a WheeledRobot, gains kp = {kp:g}, kd = {kd:g}"
        return cls(theta, **{"ahead": -wheel.x, "size": base.size, "source": source} | others)

    def __repr__(self) -> str:
        given = [f"[{', '.join(f'{x:.10g}' for x in self.theta)}]"]
        given += [f"ahead={self.ahead:g}"] if self.ahead else []
        for name, pair in (("limits", self.limits), ("accelerations", self.accelerations)):
            if np.isfinite(pair).any():
                given.append(f"{name}=({', '.join(f'{x:g}' for x in pair)})".replace("inf", "np.inf"))
        return f"VelocityRobot({', '.join(given)})"

    @property
    def time_constants(self) -> tuple[float, float]:
        """Time constants of speed and yaw rate without coupling: theta_1 / theta_4, theta_2 / theta_6 [s]."""
        one, two, _, four, _, six = self.theta.tolist()
        return one / four, two / six

    @property
    def problems(self) -> tuple[str, ...]:
        """Values of theta that motors and firmware cannot produce, in words; () if there are none.

        By `from_motors`, theta_3 / theta_5 = d kR / (2 kT) is positive. Losses of the motors make theta_4 and
        theta_6 larger than 1.
        """
        three, four, five, six = self.theta[2:].tolist()
        problems = [
            f"{name} is {value:g}, but motors with losses have more than 1: keep it if near 1"
            for name, value in (("theta_4", four), ("theta_6", six))
            if value < 1
        ]
        signs = [f"theta_3 is {three:g} and theta_5 is {five:g}, but both have the same sign in the model"]
        return (*problems, *signs * (three * five < 0))

    def command_for(self, speed: Any, yaw_rate: Any) -> Any:
        """Return the commands that a kinematic law gives: its speed and yaw rate, shape (..., 2)."""
        return stack(speed, yaw_rate)

    # Kinematics

    @arrays(q=3, nu=2)
    def rolling(self, q: Any, nu: Any) -> Any:
        """Return v for independent velocities `nu`, shape (..., 3) [m/s, m/s, rad/s]."""
        return rolling_of(self.ahead, q, nu)

    def start(self, reference: Any) -> tuple[Array, Array]:
        """Return q and v at the start of a reference, shape (3,) each, without velocity across the wheels."""
        q = shaped("reference.q", finite("reference.q", reference.q), (3,))
        return q, self.project(q, reference.v)

    # Dynamics

    @arrays(nu=2, u=2)
    def rates(self, nu: Any, u: Any) -> Any:
        """Return the rates of speed and yaw rate, shape (..., 2) [m/s^2, rad/s^2].

        Parameters
        ----------
        nu : array_like, shape (..., 2)
            Speed along the wheels and yaw rate [m/s, rad/s].
        u : array_like, shape (..., 2)
            Commands [m/s, rad/s].
        """
        return rates_of(self.theta, self.accelerations, nu, u)

    def _acceleration(self, q: Any, v: Any, u: Any) -> Any:
        nu = self.independent(q, v)
        return point_acceleration(self.ahead, q, nu, self.rates(nu, u))

    @arrays(q=3, v=3, rates=2)
    def commands(self, q: Any, v: Any, rates: Any) -> Any:
        """Return the commands for desired rates of speed and yaw rate, shape (..., 2) [m/s, rad/s].

        The commands are `regressor` times theta, without limits. `Backstepping` uses this method to
        compensate the lag of the firmware.

        Parameters
        ----------
        q, v : array_like, shape (..., 3)
            State with rolling wheels.
        rates : array_like, shape (..., 2)
            Desired rates of speed and yaw rate [m/s^2, rad/s^2].
        """
        nu, theta = self.independent(q, v), self.theta
        u, w = nu[..., 0], nu[..., 1]
        forward = theta[..., 0] * rates[..., 0] - theta[..., 2] * (w * w) + theta[..., 3] * u
        turning = theta[..., 1] * rates[..., 1] + theta[..., 4] * (u * w) + theta[..., 5] * w
        return stack(forward, turning)

    @arrays(q=3, v=3, rates=2)
    def regressor(self, q: Any, v: Any, rates: Any) -> Any:
        """Return the regressor Y with ``commands(q, v, rates) = Y theta``, shape (..., 2, 6).

        Parameters
        ----------
        q, v : array_like, shape (..., 3)
            State with rolling wheels.
        rates : array_like, shape (..., 2)
            Rates of speed and yaw rate [m/s^2, rad/s^2].
        """
        nu = self.independent(q, v)
        u, w = nu[..., 0], nu[..., 1]
        o = 0.0 * u
        forward = stack(rates[..., 0], o, -w * w, u, o, o)
        return np.stack([forward, stack(o, rates[..., 1], o, o, u * w, w)], axis=-2)

    @finite_result
    def reduced(self, q: ArrayLike, v: ArrayLike) -> Reduced:
        """Return the dynamics in nu = (speed, yaw rate): M nu' + n = B u and v = S nu.

        M is diag(theta_1, theta_2) [s], and B is the identity. The dynamics do not include the limits of
        acceleration.
        """
        nu = self.independent(q, v)
        lead = nu.shape[:-1]
        M, B = (np.broadcast_to(x, (*lead, 2, 2)) for x in (np.diag(self.theta[:2]), np.eye(2)))
        S = np.stack([np.broadcast_to(self.rolling(q, way), (*lead, 3)) for way in np.eye(2)], axis=-1)
        return Reduced(M, self.commands(q, v, np.zeros(2)), B, S, nu)

    # What is drawn

    @cached_property
    def _visuals(self) -> WheeledRobot:
        length, width, height = self.size
        radius, caster = min(0.45 * height, 0.3 * length), -np.sign(self.ahead or 1.0) * 0.3 * length
        table = WheelTable.differential(width, radius, x=-self.ahead, supports=[(caster, 0.0)], mass=1e-2)
        return WheeledRobot(MobileRobot(1.0, 1.0, size=self.size), table)

    def drawing(self, q: ArrayLike) -> Array:
        """Return the poses of the objects of `visual_model` in the inertial frame, shape (..., k, 4, 4)."""
        q = vector("q", q, 3)
        return np.asarray(self._visuals.drawing(np.concatenate([q, np.zeros((*q.shape[:-1], 2))], axis=-1)))


def _load_robots(file: str) -> Mapping[str, VelocityRobot]:
    """Return the robots of a file by name. Their sources also state the peculiarities of the robots."""
    robots, rows = {}, (files("pinmobile") / "identification" / file).read_text("utf-8")
    for name, row in tomllib.loads(rows).items():
        bare = VelocityRobot(row["theta"], size=row["size"])
        sentences = f"{row['of']}; {row['source']}", row["odd"], *bare.problems
        robots[name] = evolved(bare, source=". ".join(sentences))
    return MappingProxyType(robots)


VELOCITY_ROBOTS = _load_robots("velocity_robots.toml")

_QUICKER = 4.0  # time constant of the steering angle per time constant of its rate: critical damping
_MAX_ANGLE = 1.4  # [rad], steering angle from which the curvature stays the same


def _box(car: Any) -> Any:
    """Return the size of the box of a car [m]."""
    return 1.4 * car.wheelbase, 0.7 * car.wheelbase, 0.3 * car.wheelbase


def curvature_of(car: Any, speed: Any, steering: Any) -> Any:
    """Return the curvature of the path of a car at a speed and a steering angle [1/m]."""
    angle = np.minimum(np.maximum(steering, -_MAX_ANGLE), _MAX_ANGLE)
    return np.tan(angle) / (car.wheelbase + car.understeer * (speed * speed))


def faster_of(car: Any, state: Any, u: Any) -> tuple[Any, Any, Any]:
    """Return the rates of speed, steering angle and steering rate of a car.

    The car has the numbers of a `VelocityCar`, which may be arrays or symbols.
    """
    (speed, steering, turning), T = state, car.steering_time_constant
    k, square = curvature_of(car, speed, steering), speed * speed
    bend = k * k * (car.wheelbase + car.understeer * square)
    faster = (car.speed_gain * u[0] - speed) / car.speed_time_constant
    faster = faster - car.cornering_drag * speed * np.abs(speed) * bend
    target = (car.steering_gain * u[1] + car.steering_offset - steering) / T
    acceleration, rate = car.rate_limits[..., 0], car.rate_limits[..., 1]
    faster = np.minimum(np.maximum(faster, -acceleration), acceleration)
    target = np.minimum(np.maximum(target, -rate), rate)
    return faster, turning, _QUICKER * (target - turning) / T


@final
@part
@by_value
class VelocityCar(VelocityInputs):
    """A car with commands of speed and steering angle as inputs: a kinematic bicycle with lags.

    The firmware of the car controls speed u and steering angle delta with time constants T. The wheels roll,
    and the path has the curvature k at the middle of the rear axle::

        u' = (g_u u_c - u) / T_u - c u |u| k tan delta
        delta'' = 4 ((g_d delta_c + delta_0 - delta) / T_d - delta') / T_d
        k = tan delta / (L + K u^2),   psi' = k u
        x' = u cos psi - a psi' sin psi,  y' = u sin psi + a psi' cos psi

    Limits of rates bound u', and the quotient (g_d delta_c + delta_0 - delta) / T_d.

    Here (u_c, delta_c) are the commands, L is the wheelbase, K is the understeer, and c is the cornering
    drag. The steering is critically damped, and T_d is its delay behind a command that changes slowly.
    q = (x, y, psi, delta) is the pose of a point at distance a ahead of the rear axle and the steering angle,
    and v = dq/dt.

    The curvature is that of 1.4 rad at larger steering angles, which are an event of a run. With oversteer
    it is infinite at the speed sqrt(-L / K).

    The model accepts no forces. The integrator is `rk4`. It needs time steps, or substeps, shorter than T_u
    and T_d.

    Parameters
    ----------
    wheelbase : float
        Distance L between the axles, > 0 [m].
    speed_time_constant, steering_time_constant : float
        Time constants T_u and T_d, > 0 [s].
    speed_gain, steering_gain : float
        Steady speed g_u and steering angle g_d per command.
    steering_offset : float
        Steering angle delta_0 of the command 0 [rad].
    understeer : float
        Steering angle K per lateral acceleration, beyond that of rolling wheels [rad s^2/m]; negative:
        oversteer.
    cornering_drag : float
        Braking c by the lateral force of the front wheels, per lateral acceleration and tan delta. Without
        control of the speed, it is the share of the mass on the front axle.
    ahead : float
        Distance a of the body origin ahead of the rear axle [m].
    limits : array_like, shape () or (2,)
        Largest commands in both directions, > 0 [m/s, rad]; infinite: no limit.
    rate_limits : array_like, shape () or (2,)
        Largest acceleration and steering rate in the firmware, > 0 [m/s^2, rad/s]; infinite: no limit.
    size : array_like, shape (3,), optional
        Length, width and height of the drawn box [m]; default: of a car with this wheelbase.
    source : str
        Source of the numbers.

    Raises
    ------
    InvalidArgument
        If a number is not finite or out of range, or an array has another shape.

    See Also
    --------
    identify_velocity : estimate the numbers from a log
    VelocityRobot : robot with commands of speed and yaw rate
    WheelTable : its constructor `car` returns wheels of a car with masses and torques
    controllers.VelocityCommand : commands from a kinematic law

    Notes
    -----
    The understeer is that of the linear single-track model in a steady turn. The model has no sideslip at the
    rear axle.

    References
    ----------
    R. Rajamani, Vehicle Dynamics and Control, 2nd edition, chapters 2 and 3 (Springer 2012).

    Examples
    --------
    >>> from pinmobile import law, simulate
    >>> from pinmobile.identification import VelocityCar
    >>> car = VelocityCar(wheelbase=0.3, speed_time_constant=0.2,
    ...                   steering_time_constant=0.1)
    >>> float(car.curvature(speed=1.0, steering=0.2).round(3))  # [1/m]
    0.676
    """

    wheelbase: float = number(above=0, unit="m", doc="distance between the axles")
    speed_time_constant: float = number(above=0, unit="s", doc="time constant of the speed")
    steering_time_constant: float = number(above=0, unit="s", doc="time constant of the steering")
    speed_gain: float = number(default=1.0, doc="steady speed per command")
    steering_gain: float = number(default=1.0, doc="steady steering angle per command")
    steering_offset: float = number(default=0.0, unit="rad", doc="steering angle of the command 0")
    understeer: float = number(default=0.0, unit="rad s^2/m", doc="steering angle per lateral acceleration")
    cornering_drag: float = number(default=0.0, doc="braking by the lateral force of the front wheels")
    ahead: float = number(default=0.0, unit="m", doc="distance of the body origin ahead of the rear axle")
    limits: Any = pair("largest commands", "m/s, rad", ("speed", "steering"), fixed=True)
    rate_limits: Any = pair(
        "largest acceleration and steering rate", "m/s^2, rad/s", ("acceleration", "steering_rate")
    )
    size: Any = option(default=attrs.Factory(_box, takes_self=True), check=size_of)
    source: str = option(default="", check=text)

    nq: ClassVar[int] = 4
    nv: ClassVar[int] = 4
    nu: ClassVar[int] = 2
    commanded: ClassVar[Any] = ("speed command", "m/s"), ("steering command", "rad")
    unforced: ClassVar[str] = "the model does not describe how a car"
    coordinates: ClassVar[Any] = (
        *VelocityRobot.coordinates,
        Coordinate("steering", "rad", -_MAX_ANGLE, _MAX_ANGLE),
    )
    rest: ClassVar[Array] = frozen(np.zeros(4))

    def check(self) -> None:
        """Raise `InvalidArgument` if commands have no effect."""
        for name in ("speed_gain", "steering_gain"):
            if getattr(self, name) == 0.0:
                raise InvalidArgument(f"{name} is 0, expected another number: no command moves this car")

    # Kinematics

    def curvature(self, speed: Any, steering: Any) -> Any:
        """Return the curvature of the path of the rear axle [1/m] at a speed [m/s] and an angle [rad]."""
        return curvature_of(self, speed, steering)

    def command_for(self, speed: Any, yaw_rate: Any) -> Any:
        """Return the commands for a steady speed and yaw rate, shape (..., 2) [m/s, rad].

        At rest the steering is straight.
        """
        at_rest = speed == 0.0
        curvature = np.where(at_rest, 0.0, yaw_rate / np.where(at_rest, 1.0, speed))
        steering = np.arctan((self.wheelbase + self.understeer * (speed * speed)) * curvature)
        return stack(speed / self.speed_gain, (steering - self.steering_offset) / self.steering_gain)

    @arrays(q=4, nu=2)
    def rolling(self, q: Any, nu: Any) -> Any:
        """Return v, shape (..., 4), for speed and steering rate `nu`, shape (..., 2) [m/s, rad/s]."""
        speed = nu[..., 0]
        twist = stack(speed, speed * self.curvature(speed, q[..., 3]))
        return np.concatenate([rolling_of(self.ahead, q, twist), nu[..., 1:]], axis=-1)

    def start(self, reference: Any) -> tuple[Array, Array]:
        """Return q and v at the start of a reference, shape (4,) each, with rolling and steered wheels."""
        pose = shaped("reference.q", finite("reference.q", reference.q), (3,))
        vx, vy, yaw_rate = np.asarray(reference.v, float)
        speed = np.cos(pose[2]) * vx + np.sin(pose[2]) * vy
        steering = self.command_for(speed, yaw_rate)[1] * self.steering_gain + self.steering_offset
        q = np.append(pose, steering)
        return q, self.rolling(q, np.array([speed, 0.0]))

    # Dynamics

    def _acceleration(self, q: Any, v: Any, u: Any) -> Any:
        speed, turning = (self.independent(q, v)[..., k] for k in (0, 1))
        faster, _, steering = faster_of(self, (speed, q[..., 3], turning), (u[..., 0], u[..., 1]))
        length = self.wheelbase + self.understeer * (speed * speed)
        k = self.curvature(speed, q[..., 3])
        bends = turning * (1 / length + k * k * length)  # k' by the steering angle
        bends = np.where(np.abs(q[..., 3]) < _MAX_ANGLE, bends, 0.0)
        bends = bends - 2 * self.understeer * speed * faster * k / length
        nu, rates = stack(speed, k * speed), stack(faster, bends * speed + k * faster)
        return point_acceleration(self.ahead, q, nu, rates, steering)

    # What is drawn

    @cached_property
    def _visuals(self) -> WheeledRobot:
        L, (_, width, height) = float(self.wheelbase), self.size
        wheels: dict[str, Any] = {"steering_limit": _MAX_ANGLE, "spin_inertia": 1e-3, "yaw_inertia": 1e-3}
        table = WheelTable.car(L, 0.9 * width, min(0.45 * height, 0.2 * L), **wheels)
        drive, steering = table.couplings  # with the origin in the middle, as the box
        rows = [evolved(wheel, x=wheel.x - 0.5 * L) for wheel in table.wheels]
        table = WheelTable(tuple(rows), (), (drive, evolved(steering, axle=-0.5 * L)))
        return WheeledRobot(MobileRobot(1.0, 1.0, size=self.size), table)

    def drawing(self, q: ArrayLike) -> Array:
        """Return the poses of the objects of `visual_model` in the inertial frame, shape (..., k, 4, 4)."""
        q, robot = vector("q", q, 4), self._visuals
        q_robot = np.zeros((*q.shape[:-1], robot.nq))
        middle = 0.5 * self.wheelbase - self.ahead
        q_robot[..., :2] = q[..., :2] + middle * stack(np.cos(q[..., 2]), np.sin(q[..., 2]))
        q_robot[..., 2:4] = q[..., 2:]
        return np.asarray(robot.drawing(q_robot))
