"""`TorqueCar`: mass, inertia, friction and cornering stiffness of a car with torques as inputs.

The body twist is nu = (u, v, r). The steering angle delta is measured. With the mass matrix M of body and
wheels, the nonlinear effects c, the directions b of the driven wheels and n across the axles::

    M nu' + c = sum_k (tau_k - friction_k) b_k - sum_i C_i (n_i nu) n_i

Rolling wheels have the twist nu = S u with S = (1, -x_r t, t), t = tan(delta) / L. The equation along S
contains no lateral force. L is the wheelbase, and x_r is the position of the rear axle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from pinmobile import parts
from pinmobile.arrays import Array, bounded, positive, scalar
from pinmobile.errors import InvalidArgument
from pinmobile.forces import JointFriction
from pinmobile.identification._commands import LEAST_BLOCKS, Part, Run, lead_of, parts_of
from pinmobile.identification._estimates import Identification, check_identifiable
from pinmobile.identification._estimator import unexplained_error
from pinmobile.identification._log import Log, unused_rows
from pinmobile.identification._planar_model import inertia_of, pose_rate, torques_of, units_of, with_inertia
from pinmobile.identification._simulation import Segments
from pinmobile.identification._velocity import search
from pinmobile.identification._velocity_model import ModelNumber, VelocityModel
from pinmobile.identification._weak_form import WINDOW, Bump
from pinmobile.wheels import ByVoltage, Motor

_SLOW = 0.1  # [rad/s], where dry friction has 71 % of its size
_STEP = 5e-3  # [s], longest integration step
_LONGEST = 3.0  # [s], longest segment: noise of the measured steering angle adds up
_SHORTEST = 20.0  # [s], shortest log
_STIFF = 0.5  # longest step per decay time of lateral velocities


class CarWheels(NamedTuple):
    """Geometry and wheels of a car, with one wheel in the middle of each axle.

    Attributes
    ----------
    rear, front : float
        Positions of the axles [m].
    fixed : ndarray, shape (a, 3)
        Rate of each motor per body twist, by the wheels of the rear axle.
    steered : ndarray, shape (a,)
        Rate of each motor per velocity along the front wheels.
    inertia : ndarray, shape (3, 3)
        Inertia of the rear wheels about their axles, for the body twist.
    spin : float
        Inertia of the front wheels about their axles, as a mass along the wheels [kg].
    names : tuple of str
        Names of the motors.
    motors : tuple of Motor
        Motors with voltages as inputs; empty for torques.
    steers : ndarray of bool, shape (n,)
        Mask of the wheels of the front axle.
    """

    rear: float
    front: float
    fixed: Array
    steered: Array
    inertia: Array
    spin: float
    names: tuple[str, ...]
    motors: tuple[Motor, ...]
    steers: NDArray[np.bool_]

    @classmethod
    def of(cls, robot: Any) -> Self:
        """Return the wheels of a robot.

        Raises
        ------
        InvalidArgument
            If the robot is no car: one fixed and one steered axle of wheels with tyres, without arms.
        """
        table, wheels, axis = robot.table, robot.table.wheels, robot.table.axes[0]
        steers = np.isin(np.arange(len(wheels)), axis.wheels)
        rear, front = (np.unique(np.array([w.x for w in wheels])[axle]) for axle in (~steers, steers))
        odd = any(w.roller or w.angle or any(w.trail) for w in wheels) or robot.mounts
        if odd or len(table.axes) > 1 or len(rear) * len(front) != 1 or rear == front:
            raise InvalidArgument(
                "robot has wheels that steer, and is no car, expected one fixed and one steered axle of "
                "wheels with tyres, one steering coordinate and no arms, such as WheelTable.car"
            )
        drives = [each for each in table.actuators if each.name != axis.name]
        columns = np.array([each.column[1:] for each in drives])
        rolling = np.array([(1 / w.radius, 0.0, -w.y / w.radius) for w in wheels])
        inertias = np.array([w.spin_inertia for w in wheels])
        if any(each.motor.is_electric for each in drives):
            inertias += np.array([each.motor.reflected_inertia for each in drives]) @ np.abs(columns)
        volts = any(item.unit == "V" for item in robot.inputs if item.name != axis.name)
        return cls(
            rear=float(rear[0]),
            front=float(front[0]),
            fixed=columns[:, ~steers] @ rolling[~steers],
            steered=columns[:, steers] @ rolling[steers, 0],
            inertia=(rolling[~steers].T * inertias[~steers]) @ rolling[~steers],
            spin=float(inertias[steers] @ rolling[steers, 0] ** 2),
            names=tuple(each.name for each in drives),
            motors=tuple(each.motor for each in drives) if volts else (),
            steers=steers,
        )


@dataclass(frozen=True, eq=False)
class TorqueCar(VelocityModel):
    """Model of a car with torques or voltages, and a measured steering angle, as inputs.

    Parameters
    ----------
    wheels : CarWheels
        Wheels and motors.
    body : Body
        Prior body, which has the numbers that are not estimated.
    slow : float
        Speed at which dry friction has 71 % of its size [rad/s].
    typical : tuple of 2 float
        Typical torque and rate of a motor [N m, rad/s].
    stiffness : tuple of 2 float
        Prior cornering stiffness of front and rear axle [N s/m]; () if the wheels roll.
    """

    wheels: Any = None
    body: Any = None
    slow: float = _SLOW
    typical: tuple[float, float] = (1.0, 1.0)
    stiffness: tuple[float, ...] = ()

    summary_size: ClassVar[int] = 2
    neutral: ClassVar[Mapping[str, float]] = {}
    limit_rows: ClassVar[tuple[ModelNumber, ...]] = ()
    ranges: ClassVar[dict[int, tuple[float, float, str]]] = {}

    @property
    def first(self) -> tuple[ModelNumber, ...]:  # type: ignore[override]
        """Numbers without the delay."""
        torque, rate = self.typical
        rows = [ModelNumber("mass", "kg", True, self.body.mass, path="mass")]
        if self.stiffness:
            rows.append(ModelNumber("com_x", "m", False, float(self.body.com[0]), 0.3, 0.03, path="com.x"))
        rows.append(ModelNumber("yaw_inertia", "kg m^2", True, self.body.yaw_inertia, path="yaw_inertia"))
        for kind, unit, size in (("viscous", "N m s/rad", torque / rate), ("coulomb", "N m", torque)):
            sizes = 0.0, size, 0.01 * size
            rows += [ModelNumber(f"joint_{kind}_{n}", unit, True, *sizes) for n in self.wheels.names]
        rows.append(ModelNumber("steering_offset", "rad", False, 0.0, 0.3, 0.03))
        axles = zip(("front", "rear"), self.stiffness, strict=False)
        return (*rows, *(ModelNumber(f"cornering_{axle}", "N s/m", True, each) for axle, each in axles))

    @property
    def _inertia(self) -> int:
        """Index of the yaw inertia; viscous and dry friction of each motor follow."""
        return 2 if self.stiffness else 1

    @property
    def _offset(self) -> int:
        """Index of the offset of the steering; the cornering stiffness follows."""
        return self._inertia + 1 + 2 * len(self.wheels.names)

    @property
    def is_linear(self) -> bool:  # type: ignore[override]
        """Whether the measurements are linear functions of the states: a yaw rate by steering is not."""
        return self.is_pose or bool(self.stiffness)

    def time_constants(self, p: Array) -> Array:
        """Return infinity: torques act at once."""
        return np.full((*p.shape[:-1], 2), np.inf)

    def rate_numbers(self, segments: Segments, p: Array) -> tuple[Array, Array, float]:
        """Return the numbers of the rates, delays [samples] and the longest time step [s]."""
        delays, longest = self.others(p)["delay"] / self.dt, _STEP
        if self.stiffness:
            real, lever = p.real, max(abs(self.wheels.front), abs(self.wheels.rear)) ** 2
            stiff = real[:, len(self.first) - 2 : len(self.first)].max() / real[:, 0].min()
            lever = lever * real[:, 0].max() / real[:, 2].min()
            longest = min(_STEP, _STIFF / (2 * stiff * max(1.0, lever)))
        return np.column_stack([p[:, : len(self.first)], delays])[:, None], delays, longest

    def rates(self, z: Any, u: Any, numbers: Any) -> Any:
        """Return the rates of the velocities, and of the pose if it is measured, of one state and input."""
        wheels, count, n = self.wheels, len(self.wheels.names), numbers
        m, x = n[0], n[1] if self.stiffness else float(self.body.com[0])
        first, offset, y = self._inertia + 1, self._offset, float(self.body.com[1])
        inertia, viscous, dry = n[first - 1], n[first : first + count], n[first + count : offset]
        steering, turning = u[count] + n[offset], u[count + 1]
        c, s, L = np.cos(steering), np.sin(steering), wheels.front - wheels.rear
        rolling, lateral = np.stack([c, s, wheels.front * s]), np.stack([-s, c, wheels.front * c])
        tangent = s / c / L
        S = np.stack([1.0 + 0.0 * tangent, -wheels.rear * tangent, tangent])
        nu = z[:3] if self.stiffness else S * z[0]
        M, force = inertia_of((m, m * x, m * y, inertia + m * (x * x + y * y)), nu)
        M = M + wheels.inertia + wheels.spin * rolling[:, None] * rolling[None, :]
        drives = [fixed + front * rolling for fixed, front in zip(wheels.fixed, wheels.steered, strict=True)]
        turns = [drive @ nu for drive in drives]
        torques = torques_of(wheels.motors, u[:count], turns)
        for torque, rate, drive, a, b in zip(torques, turns, drives, viscous, dry, strict=True):
            force = force + (torque - a * rate - b * rate / np.sqrt(rate * rate + self.slow**2)) * drive
        if self.stiffness:
            back = np.array([0.0, 1.0, wheels.rear])
            front, rear = n[offset + 1], n[offset + 2]
            force = force - front * (lateral @ nu) * lateral - rear * (back @ nu) * back
            faster = np.linalg.solve(M, force)
        else:
            yaw_rate = turning * (1 / (c * c) / L) * z[0]
            bias = np.stack([0.0 * yaw_rate, -wheels.rear * yaw_rate, yaw_rate])
            faster = np.stack([(S @ force - S @ (M @ bias)) / (S @ (M @ S))])
        return np.concatenate([faster, pose_rate(z[-1], nu)]) if self.is_pose else faster

    def outputs(self, segments: Segments, states: Array, numbers: Array) -> Array:
        """Return the measurements: poses, or speed and yaw rate."""
        if self.is_pose:
            return states[..., -3:]
        if self.stiffness:
            return states[..., [0, 2]]
        count, delays = len(self.wheels.names), numbers[:, 0, -1].real
        lag = np.maximum(np.floor(delays + 1e-9), 0).astype(int)
        share = (numbers[:, 0, -1] - lag)[:, None, None]
        length = states.shape[2]
        u_0, u_1, u_2 = (segments.applied(lag + k, length)[..., count] for k in (0, 1, 2))
        offset = numbers[:, :, None, self._offset]
        angle = (1 - share) * (u_0 + u_1) / 2 + share * (u_1 + u_2) / 2 + offset
        turn = states[..., 0] * np.tan(angle) / (self.wheels.front - self.wheels.rear)
        return np.stack([states[..., 0], turn], axis=-1)

    def problems(self, estimates: Identification, neutral: Sequence[str]) -> list[str]:
        """Return what the log cannot tell."""
        rolls = "rolling wheels: give the table a WheelFriction(slip=...) to estimate cornering stiffness"
        place = (
            f"the yaw inertia belongs to com_x = {float(self.body.com[0]):.3g} m of the given robot: the log "
            "identifies the inertia about the rear axle"
        )
        return [
            "the inertia of the wheels about their axles is the given value",
            "all estimates are proportional to the given torque per input",
            *[place, rolls] * (not self.stiffness),
        ]

    def robot(self, estimates: Identification) -> Any:
        """Return the identified car."""
        check_identifiable("robot", estimates.unseen)
        values, prior = estimates.parameters, estimates.prior
        (x, y, _), bare = self.body.com, prior.robot.with_locked_arms()
        body = with_inertia(bare, values["mass"], values.get("com_x", x), y, values["yaw_inertia"])
        new = parts.evolved(prior.wheeled if isinstance(prior, ByVoltage) else prior, robot=body)
        if self.stiffness:
            steers, rows = self.wheels.steers, []
            slips = steers.sum() / values["cornering_front"], (~steers).sum() / values["cornering_rear"]
            for wheel, slip in zip(new.table.wheels, np.where(steers, *slips).tolist(), strict=True):
                rows.append(parts.evolved(wheel, friction=parts.evolved(wheel.friction, slip=slip)))
            new = parts.evolved(new, table=parts.evolved(new.table, wheels=tuple(rows)))
        return new.by_voltage() if self.wheels.motors else new

    def forces(self, estimates: Identification) -> list[Any]:
        """Return the friction of the motors for `simulate`."""
        values, names = estimates.parameters, [item.name for item in estimates.prior.coordinates]
        table = estimates.prior.table
        columns = np.zeros((2, len(names)))
        drives = {each.name: np.array(each.column) for each in table.actuators}
        first = len(names) - len(next(iter(drives.values())))
        for n in self.wheels.names:
            shares = np.abs(drives[n])
            columns[0, first:] += max(values[f"joint_viscous_{n}"], 0.0) * shares * shares.sum()
            columns[1, first:] += max(values[f"joint_coulomb_{n}"], 0.0) * shares
        return [JointFriction(columns[0], columns[1], self.slow, names)]

    def runs(self, logs: list[Log]) -> list[Run]:
        """Return the logs with the mean steering angle and the steering rate of each time step."""
        runs = []
        for run in super().runs(logs):
            angle, angle_1 = run.u[:, -1:], np.append(run.u[1:, -1:], run.u[-1:, -1:], axis=0)
            u = np.column_stack([run.u[:, :-1], (angle + angle_1) / 2, (angle_1 - angle) / run.dt])
            speed, turn = run.nu.T
            slides = np.column_stack([speed, -self.wheels.rear * turn, turn])
            runs.append(run._replace(u=u, state=slides if self.stiffness else run.nu[:, :1]))
        return runs

    def explained_runs(self, runs: Sequence[Run], p: Array) -> list[Part]:
        """Return each run as one part."""
        return parts_of(runs)

    @property
    def inputs(self) -> Mapping[str, str]:  # type: ignore[override]
        """Units of the inputs by name."""
        return units_of(self.wheels.names, self.wheels.motors) | {"steering": "rad"}


def identify_car(
    logs: list[Log], robot: Any, delay: float | None, speed: float | None, is_alone: bool
) -> Identification:
    """Return the estimates for a car, or for wheels alone, see `identify`; `speed` is its rolling speed."""
    slow = positive("rolling_speed", _SLOW if speed is None else speed, "rad/s")
    wheels, is_pose, stiff = CarWheels.of(robot), logs[0].q is not None, tuple[float, ...]()
    slips = np.array([wheel.friction.slip for wheel in robot.table.wheels])
    if robot.ground.slips and (slips > 0).all():
        stiff = tuple(float((1 / slips[axle]).sum()) for axle in (wheels.steers, ~wheels.steers))
    body, given = robot.robot.with_locked_arms().body, {"delay": 0.0, "ahead": 0.0}
    model = TorqueCar((), given, 1, 1.0, is_pose, wheels=wheels, body=body, slow=slow, stiffness=stiff)
    runs = model.runs(logs)
    seconds = sum(len(run.u) * run.dt for run in runs)
    if seconds < _SHORTEST:
        raise InvalidArgument(
            f"log is {seconds:.3g} s long, too short, expected at least {_SHORTEST:g} s, better 60 s"
        )
    dt, lead, longest = runs[0].dt, lead_of(runs), min(_LONGEST, seconds / LEAST_BLOCKS)
    if delay is not None:
        given["delay"] = bounded("delay", scalar("delay", delay), least=0, most=lead * dt, unit="s")
    u = np.concatenate([run.u[:, : len(wheels.names)] for run in runs])
    torque = np.stack(torques_of(wheels.motors, u.T, 0.0 * u.T))
    turns = np.concatenate([run.nu[:, 0] for run in runs]) * np.abs(wheels.fixed[:, 0] + wheels.steered).max()
    size, rate = (max(float(np.sqrt(np.mean(x**2))), 1e-9) for x in (torque, turns))
    free = ("delay",) if delay is None else ()
    model = replace(model, free=free, lead=lead, dt=dt, typical=(size, rate), longest=longest)
    delays = range(lead) if delay is None else [given["delay"] / dt]
    start = _start(model, runs, delays, is_alone)
    rows = sum(one.dropped + unused_rows(one, "q" if is_pose else "twist") for one in logs)
    return replace(search(model, parts_of(runs), start, {}), prior=robot, dropped=rows)


def _start(model: TorqueCar, runs: Sequence[Run], delays: Sequence[float], is_alone: bool) -> Array:
    """Return first estimates by the weak form of straight motion, for the best of some delays [samples].

    If the wheels are given alone, the prior yaw inertia is arbitrary.
    """
    from scipy.optimize import nnls  # slow to load

    wheels, count, candidates = model.wheels, len(model.wheels.names), []
    for lag in delays:
        rows, forces = [], []
        for run in runs:
            integral, speed = Bump.of(WINDOW, run.dt).integrate, run.nu[:, :1]
            u = run.u[np.clip(np.arange(len(speed)) - round(lag), 0, None)]
            drives = wheels.fixed[:, 0] + wheels.steered / np.cos(u[:, count : count + 1])  # (N, a)
            turns = drives * speed
            torques = np.stack(torques_of(wheels.motors, u[:, :count].T, [*turns.T]), axis=-1)
            dry = turns / np.hypot(turns, model.slow)
            forces.append(integral((drives * torques).sum(axis=1)))
            friction = (integral((drives * rates).sum(axis=1)) for rates in (turns, dry))
            rows.append(np.stack([-integral(speed[:, 0], 1), *friction], axis=-1))
        fit, left = nnls(np.concatenate(rows), np.concatenate(forces))
        candidates.append((left, lag, fit))
    _, lag, (mass, viscous, dry) = min(candidates, key=lambda each: each[0])
    values = {"mass": mass - wheels.inertia[0, 0] - wheels.spin, "delay": lag * model.dt}
    for n in wheels.names:
        values |= {f"joint_viscous_{n}": viscous, f"joint_coulomb_{n}": dry}
    if values["mass"] <= 0:
        raise unexplained_error(0.0)
    if is_alone:
        values["yaw_inertia"] = mass * ((wheels.front - wheels.rear) / 2) ** 2
    priors = [*((item.name, item.prior) for item in model.first), *((n, 0.0) for n in model.free)]
    return np.array([values.get(name, prior) for name, prior in priors])
