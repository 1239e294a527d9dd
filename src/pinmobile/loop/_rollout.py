"""`Rollout`, the recorded samples of a simulation, with its events, and `EndEffector`, a frame over them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from os import PathLike
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, finite, frozen, increasing, location, real, required, shaped
from pinmobile.errors import InvalidArgument, format_value
from pinmobile.files import pack, read_archive, unpack, write_archive, write_table
from pinmobile.loop._mcap import Columns, read_mcap, write_mcap
from pinmobile.metrics import Metric, evaluate_metrics_of, format_si, metrics_of
from pinmobile.plant import (
    LIMIT_TOLERANCE,
    Coordinate,
    Event,
    Input,
    PlantDescription,
    all_samples,
    configuration_names_of,
    coordinates_of,
    full_configurations,
    inputs_of,
    limit_events,
    reference_sizes_of,
    robot_at,
    stated,
)
from pinmobile.reaching import error_sizes, pose_error, target_names
from pinmobile.robot import WEIGHTLESS, margin_of_wrench
from pinmobile.signals import Signal
from pinmobile.trajectories import Reference

_SINCE = "(from t = {t} s, {count})"
_TIPS_OVER = (
    "no loads of wheels and supports balance the robot: it tips over, which is not simulated "
    f"{_SINCE}; tip-over margin {{value}} m at t = {{at}} s"
)
_MISSED = (
    f"loads and forces of the ground did not converge to their tolerance {_SINCE}; "
    "compare with half the time step and with Coulomb(tolerance=1e-6)"
)
_LIFTS = f"lifted: {{name}}, a driven wheel without load, which cannot push and may spin up {_SINCE}"
_SLIDES = f"sliding: {{name}}, at up to {{value}} m/s at t = {{at}} s {_SINCE}"
_OVERSPEED = (
    "motor of {name} turns at {value} rad/s at t = {at} s, faster than {limit} rad/s, its speed without "
    "load, since t = {t} s"
)
_TOO_FAST = (
    "wheel of {name} turns at {value} rad/s at t = {at} s, beyond its limit of {limit} rad/s since t = {t} s"
)
_TOO_WEAK = "torque of {name} is {value} N m more than its motor has at its rate at t = {at} s " + _SINCE
_CURRENT = f"current of {{name}} is at its limit of {{limit}} A {_SINCE}"
_MARGIN = f"{{name}} is {{value}} {{unit}} at t = {{at}} s, below 0 {_SINCE}"
_KINDS = {"load": "tip over", "tip-over margin": "tip over", "slip margin": "slip"}
_KINDS |= {f"exceed a {name}": name for name in ("position limit", "speed limit")}
_KINDS["exceed an effort limit"] = "effort limit"
KINDS = (
    *("position limit", "speed limit", "effort limit", "saturation", "current limit"),
    *("tip over", "lift", "slip", "ground"),
)
"""Kinds of events of every plant; margins and events among the metrics of a plant are further kinds."""
_SIMULATED_KINDS = {"saturation", "current limit", "lift", "slip"}
"""Kinds of events that a run simulates."""
_LEAST_SLIP = 1e-9  # [m/s], slower slip is rounding
_TIPS = Metric("tip-over margin", "m", "distance of the zero-moment point from the edge", "smallest")


def is_fault(event: Event) -> bool:
    """Return whether a run does not simulate what happens in an event."""
    return event.kind not in _SIMULATED_KINDS


def kinds_of(plant: object) -> tuple[str, ...]:
    """Return the kinds of events that a run of a plant may have."""
    metric_kinds = (_KINDS.get(m.name, m.name) for m in metrics_of(plant) if m.worst != "largest")
    return tuple(dict.fromkeys((*KINDS, *metric_kinds)))


def events_of(run: Any, *, with_metrics: bool = True) -> tuple[Event, ...]:
    """Return the events of a run, see `Rollout.events`.

    Parameters
    ----------
    run : Rollout
        Recorded samples.
    with_metrics : bool
        Whether events of the plant's metrics are included, which take longer.
    """
    plant = robot_at(run.plant, run.t)
    limits = limit_events(plant, run.t, run.q, run.v, run.u)
    events = [x for x in (*limits, *_motor_events(run, plant), *_ground_events(run, plant)) if x is not None]
    metrics = [x for x in metrics_of(plant) if x.worst != "largest"] if with_metrics else []
    values = {name: signal.values for name, signal in run.metrics().items()} if metrics else {}
    if with_metrics and not metrics and stated(plant, "table") is None and stated(plant, "grounded"):
        corners, wrench = plant.footprint, plant.ground_wrench(run.q, run.v, run.a)
        if corners is not None:  # a robot without arms: its ensembles do not record the margin
            metrics = [_TIPS]
            values = {_TIPS.name: margin_of_wrench(corners, wrench, plant.weight)}
    for x in metrics:
        event = _metric_event(x, run.t, values[x.name])
        if event is not None and all(event.kind != known_event.kind for known_event in events):
            events.append(event)
    return tuple(events)


def _motor_events(run: Any, plant: Any) -> Iterator[Event | None]:
    """Yield the events of motors: currents at limits, torques that they lack, too high speeds."""
    table, t = stated(plant, "table"), run.t
    motors = table.actuators if table is not None else ()
    if "currents" in run.signals:
        electric = [motor for motor in motors if motor.motor.is_electric]
        for motor, current in zip(electric, np.abs(run.signals["currents"].values).T, strict=True):
            limit = float(motor.motor.current)
            options: Any = {"words": _CURRENT, "limit": limit, "unit": "A", "slack": -1e-6 * limit}
            yield Event.of("current limit", motor.name, t, current, current - limit, **options)
    inputs = list(zip(run.inputs, run.u.T, strict=True))[len(run.inputs) - len(motors) :]
    for motor, (taken, torque) in zip(motors, inputs, strict=True):
        rate = run.v[:, run.v.shape[1] - len(motor.column) :] @ np.array(motor.column)
        limit = float(motor.motor.largest_rate)
        if motor.motor.is_electric and taken.unit == "N m":
            largest = float(motor.motor.largest_torque)
            if (np.abs(torque) > largest * (1 - np.abs(rate) / limit)).any():  # a motor has this, and more
                lacks = np.where(np.abs(rate) <= limit, -motor.motor.margin(torque, rate), 0.0)
                options = {"words": _TOO_WEAK, "unit": "N m", "slack": LIMIT_TOLERANCE * largest}
                yield Event.of("effort limit", motor.name, t, lacks, lacks, **options)
        rate = np.abs(rate)
        words = _TOO_FAST if limit == motor.motor.rate_limit else _OVERSPEED
        options = {"words": words, "limit": limit, "unit": "rad/s", "slack": 1e-6 * limit}
        yield Event.of("speed limit", motor.name, t, rate, rate - limit, **options)


def _ground_events(run: Any, plant: Any) -> Iterator[Event | None]:
    """Yield the events of a robot on wheels: it tips over, wheels lift or slide, loads do not converge."""
    table, t, signals = stated(plant, "table"), run.t, run.signals
    recorded = {name: signals[name].values for name in ("loads", "tips", "missed") if name in signals}
    stands = table is not None and plant.grounded and plant.footprint is not None
    if stands or "tips" in recorded:
        if "tips" not in recorded:  # rolling wheels
            computed = plant.contact_loads(run.q, run.v, run.a)
            recorded |= {"loads": computed.values, "tips": computed.tips}
        loads, tips = recorded["loads"], recorded["tips"] > 0
        if tips.any():
            margin = margin_of_wrench(plant.footprint, plant.ground_wrench(run.q, run.v, run.a), 0.0)
            if "tips" in signals:  # of the step before
                margin = np.concatenate([margin[:1], margin[:-1]])
            depth = np.where(tips, np.maximum(-margin, np.finfo(float).tiny), 0.0)
            yield Event.of("tip over", "", t, margin, depth, words=_TIPS_OVER, unit="m")
            tips[:1] |= tips[1:2]  # before the first step, signals have the loads at rest
        joints = {k for motor in table.actuators for k, x in enumerate(motor.column) if x}
        driven = [row for row in range(len(table)) if len(table.axes) + row in joints]
        lifted = loads[:, driven] <= WEIGHTLESS * loads.sum(axis=1, keepdims=True)
        lifted[tips] = False
        name, count = ", ".join(np.array(table.names)[driven][lifted.any(axis=0)]), 1.0 * lifted.sum(axis=1)
        yield Event.of("lift", name, t, count, count, words=_LIFTS)
    if "missed" in recorded:
        missed = recorded["missed"]
        yield Event.of("ground", "", t, missed, missed, words=_MISSED)
    if table is not None and "slides" in signals:
        speeds = np.hypot(signals["slip_along"].values, signals["slip_across"].values)
        slides = np.where(speeds > _LEAST_SLIP, speeds * signals["slides"].values, 0.0)
        names, fastest = np.array(table.names)[slides.max(axis=0) > 0], slides.max(axis=1)
        name = ", ".join(map(str, names))
        yield Event.of("slip", name, t, fastest, fastest, words=_SLIDES, unit="m/s")


def _metric_event(m: Metric, t: Array, values: Array) -> Event | None:
    """Return the event of a metric: a margin below 0, or what happens."""
    words = f"{_MARGIN}: {m.meaning}" if m.is_margin else f"{m.name} {_SINCE}: {m.meaning}"
    excess = -values if m.is_margin else values
    kind = _KINDS.get(m.name, m.name)
    return Event.of(kind, m.name, t, values, excess, words=words, unit=m.unit)


_BASE = 3  # x, y, psi


@dataclass(frozen=True, eq=False, repr=False)
class EndEffector:
    """Pose and target pose of a frame over the samples of a rollout; `Rollout.end_effector` returns it.

    Attributes
    ----------
    frame : str
        Name of the frame.
    t : ndarray, shape (N + 1,)
        Times [s].
    pose : ndarray, shape (N + 1, 4, 4)
        Pose T_0_f of the frame.
    target : ndarray, shape (N + 1, 4, 4), or None
        Target pose; None if no part of the loop defines one.
    is_oriented : bool
        Whether the target contains an orientation; otherwise it is a position.

    See Also
    --------
    Rollout.end_effector : end effector of a run.
    EndEffectorTracking : controller that tracks poses.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.loop import EndEffector
    >>> t, (pose, target) = [0, 1], np.tile(np.eye(4), (2, 2, 1, 1))
    >>> target[1, 0, 3] = 0.01
    >>> tool = EndEffector("tool", t, pose, target)
    >>> tool.max_error()  # [m], [rad]
    (0.01, 0.0)
    """

    units: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("position", "position_error", "distance"), "m"),
        **{"t": "s", "orientation": "", "orientation_error": "rad", "angle": "rad"},
    }

    frame: str
    t: Array
    pose: Array
    target: Array | None = None
    is_oriented: bool = True

    def __post_init__(self) -> None:
        for name in ("t", "pose", "target"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, frozen(getattr(self, name)))

    def __repr__(self) -> str:
        return f"<EndEffector: {self}>"

    def __str__(self) -> str:
        if self.target is None:
            return f"{self.frame} over {self.t[-1] - self.t[0]:g} s, without target"
        metres, radians = self.max_error()
        turn = f", {radians:.3e} rad" if self.is_oriented else ""
        return f"{self.frame} over {self.t[-1] - self.t[0]:g} s, largest error {metres:.3e} m{turn}"

    @property
    def position(self) -> Array:
        """Position of the frame's origin, shape (N + 1, 3) [m]."""
        return self.pose[:, :3, 3]

    @property
    def orientation(self) -> Array:
        """Rotation matrix R_0_f of the frame, shape (N + 1, 3, 3)."""
        return self.pose[:, :3, :3]

    @cached_property
    def error(self) -> Array:
        """Error from the pose to the target along the inertial axes, shape (N + 1, 6) [m, rad].

        The last three entries are the rotation vector; they are NaN if the target is a position.

        Raises
        ------
        InvalidArgument
            If there is no target.
        """
        expected = (
            "a run with EndEffectorTracking, with a trajectory of solve_inverse_kinematics, or with a "
            "reference of the arm's coordinates"
        )
        target = required(f"target of end effector {self.frame!r}", self.target, expected)
        error = pose_error(target, self.pose)
        if not self.is_oriented:
            error[:, _BASE:] = np.nan
        return frozen(error)

    @property
    def position_error(self) -> Array:
        """Position error of the origin, shape (N + 1, 3) [m]; see `error`."""
        return self.error[:, :_BASE]

    @property
    def orientation_error(self) -> Array:
        """Rotation vector from the orientation to its target, shape (N + 1, 3) [rad]; see `error`."""
        return self.error[:, _BASE:]

    @property
    def distance(self) -> Array:
        """Size of the position error, shape (N + 1,) [m]; see `error`."""
        return np.asarray(error_sizes(self.error)[:, 0])

    @property
    def angle(self) -> Array:
        """Angle of the orientation error, shape (N + 1,) [rad]; NaN if the target is a position."""
        return np.asarray(error_sizes(self.error)[:, 1])

    def max_error(self) -> tuple[float, float]:
        """Return the largest distance [m] and the largest angle [rad] from the target.

        Raises
        ------
        InvalidArgument
            If there is no target.
        """
        distance, angle = error_sizes(self.error).max(axis=0)
        return float(distance), float(angle)


def at_samples(rollout: Rollout) -> Rollout:
    """Return the rollout with its plant as the robot at the samples, see `plant.robot_at`."""
    plant = robot_at(rollout.plant, rollout.t)
    return rollout if plant is rollout.plant else replace(rollout, plant=plant)


def _collect_targets(signals: Mapping[str, Signal], position: str, orientation: str) -> Array:
    """Return the target poses in signals, shape (N + 1, 4, 4)."""
    positions = signals[position].values
    target = np.tile(np.eye(4), (len(positions), 1, 1))
    target[:, :3, 3] = positions
    if orientation in signals:
        quaternions = signals[orientation].values
        target[:, :3, :3] = [pin.Quaternion(row).toRotationMatrix() for row in quaternions]
    return target


def _coordinates_of(plant: Any, frame: str) -> int:
    """Return the number of first coordinates that determine the pose of a frame."""
    mounts = stated(plant, "mounts")
    if mounts is None:
        return int(plant.nv)
    counts = (mount.v.stop for mount in mounts if frame.startswith(f"{mount.name}/"))
    return int(next(counts, _BASE))


_ARRAY_NAMES = ("t", "q", "v", "a", "u", "error")
_FORMAT = "pinmobile rollout 4"


def error_text(value: float) -> str:
    """Return an error [m, rad] as text with seven digits; a rounding error becomes "< 1e-12"."""
    return format_si(value, ".6e")


@dataclass(frozen=True, eq=False, repr=False)
class Rollout:
    """Recorded samples of a closed loop, from t = 0 to the last sample.

    Attributes
    ----------
    plant : MobileRobot or other plant
        Simulated system. After loading a file, it is a `pinmobile.plant.PlantDescription` (names and units)
        if the file cannot restore the plant: its class belongs to a user, or the URDF of its arm is missing.
    t : ndarray, shape (N + 1,)
        Times [s].
    q : ndarray, shape (N + 1, nq)
        Configuration.
    v : ndarray, shape (N + 1, nv)
        Velocity.
    a : ndarray, shape (N + 1, nv)
        Acceleration at the start of each step.
    u : ndarray, shape (N + 1, nu)
        Applied input, constant until the next sample. For a body driven by forces: (Fx, Fy, Mz, ...) [N, N, N
        m, ...].
    error : ndarray, shape (N + 1, n)
        Tracking error of the reference's n coordinates; psi on the circle [m, m, rad, ...].
    reference : Reference
        Desired q, v and a of the first n coordinates.
    signals : mapping of str to Signal
        Further series of the parts with their units, by name.
    engine : str
        Engine that ran the loop, ``"PYTHON"`` or ``"COMPILED"``; "" if unknown.
    fallback_reason : str
        Reason why a faster engine could not run the loop; "" if there is none, or if the user gave the
        engine.

    Raises
    ------
    InvalidArgument
        If a number is not finite, the times do not increase, or an array has another shape.

    See Also
    --------
    simulate : run a closed loop.
    plots.path : figure of the path.
    loop.EndEffector : frame over the samples.

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot
    >>> from pinmobile import Tangent, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> path = Tangent(Circle(1.0, 0.5, 4.0))
    >>> run = simulate(robot, PD(120, 120), path, dt=0.02)
    >>> run.max_input()[:2]  # [N]
    array([7.9, 8.1])
    >>> float(run.rms_error()[0])  # [m]
    0.036
    """

    plant: Any
    t: Array
    q: Array
    v: Array
    a: Array
    u: Array
    error: Array
    reference: Reference
    signals: Mapping[str, Signal] = field(default_factory=dict)
    engine: str = ""
    fallback_reason: str = ""

    def __post_init__(self) -> None:
        for name in _ARRAY_NAMES:
            with np.errstate(over="ignore"):  # the square of a time may overflow
                object.__setattr__(self, name, frozen(finite(name, getattr(self, name))))
        parts = zip(Reference._fields, self.reference, strict=True)
        desired = Reference(*(frozen(finite(f"reference.{name}", part)) for name, part in parts))
        object.__setattr__(self, "reference", desired)
        self._check_shapes()
        signals = {name: Signal(unit, frozen(real(name, x))) for name, (unit, x) in self.signals.items()}
        for name, (_, values) in signals.items():
            shaped(f"signals[{name!r}]", values, (len(self.t),), (len(self.t), "k"))
        object.__setattr__(self, "signals", MappingProxyType(signals))

    def _check_shapes(self) -> None:
        t, desired = self.t, self.reference
        increasing("t", t)
        plant_arrays = {"q": self.q, "v": self.v, "a": self.a, "u": self.u}
        error_arrays = {"error": self.error, "reference.v": desired.v, "reference.a": desired.a}
        for name, array in {**plant_arrays, **error_arrays, "reference.q": desired.q}.items():
            shaped(name, array, (len(t), "k"), words=", as t has")
        for name, size_name in (("q", "q"), ("v", "v"), ("a", "v"), ("u", "u")):
            width: Any = getattr(self.plant, f"n{size_name}", plant_arrays[size_name].shape[1])
            shaped(name, plant_arrays[name], (len(t), width))
        for name, array in error_arrays.items():
            shaped(name, array, self.error.shape, words=", as error has")
        if self.error.shape[1] > self.v.shape[1] or desired.q.shape[1] > self.q.shape[1]:
            shaped("reference.q", desired.q, self.q.shape)

    def __len__(self) -> int:
        return len(self.t)

    def __reduce__(self) -> tuple[Any, ...]:
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        return Rollout, tuple((values | {"signals": dict(self.signals)}).values())

    def __repr__(self) -> str:
        errors, duration = self._format_errors("largest", self.max_error()), self.t[-1] - self.t[0]
        return f"<Rollout: {len(self)} samples over {duration:g} s, {errors}{self._format_joint()}>"

    def __str__(self) -> str:
        step = f" at dt = {self.t[1] - self.t[0]:g} s" if len(self) > 1 else ""
        pairs = zip(self.inputs, self.max_input(), strict=True)
        inputs = [f"{entry.name} {format_si(value)} {entry.unit}".rstrip() for entry, value in pairs]
        lines = [
            f"{len(self)} samples over {self.t[-1] - self.t[0]:g} s{step}",
            self._format_errors("largest", self.max_error()),
            self._format_errors("rms", self.rms_error()),
            "largest input: " + ", ".join(inputs[: self._line_size] if self._by_coordinate else inputs),
            *self._format_joints(),
            *([f"end effector {self.end_effector()}"] if self._target_frame else []),
            *map(str, self.events),
        ]
        return "\n".join(lines)

    @cached_property
    def events(self) -> tuple[Event, ...]:
        """Limits that the run exceeds, inputs and currents at their limits, slip, tipping over.

        Each `plant.Event` states what happens, when, and how much; its text is a sentence. Margins of the
        plant's metrics below 0 are events too.
        """
        return events_of(self)

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Coordinates of the reference, one for each column of `error`."""
        count = self.error.shape[1]
        names = coordinates_of(self.plant) or tuple(Coordinate(f"[{k}]", "") for k in range(count))
        return names[:count]

    @property
    def inputs(self) -> tuple[Input, ...]:
        """Inputs of the plant, one for each column of `u`."""
        return inputs_of(self.plant) or tuple(Input(f"[{k}]", "") for k in range(self.u.shape[1]))

    @property
    def labels(self) -> tuple[tuple[str, str], ...]:
        """Name and unit of each column of `error`, n pairs."""
        return tuple((coordinate.name, coordinate.unit) for coordinate in self.coordinates)

    @property
    def poses(self) -> Array:
        """Pose (x, y, psi) of the body, shape (N + 1, 3) [m, m, rad].

        Raises
        ------
        InvalidArgument
            If the plant does not provide the pose of its body.
        """
        return self._poses(self.q)

    @property
    def reference_poses(self) -> Array:
        """Desired pose (x, y, psi) of the body, shape (N + 1, 3) [m, m, rad].

        Raises
        ------
        InvalidArgument
            If the plant does not provide the pose of its body.
        """
        return self._poses(full_configurations(self.q, self.reference.q))

    @property
    def distance(self) -> Array:
        """Distance of the body from its desired position, shape (N + 1,) [m].

        Raises
        ------
        InvalidArgument
            If the plant does not provide the pose of its body.
        """
        dx, dy, _ = (self.reference_poses - self.poses).T
        return np.asarray(np.hypot(dx, dy))

    def _poses(self, q: Array) -> Array:
        if self.plant is None and q.shape[1] >= _BASE:
            return q[:, :_BASE]
        if not callable(stated(self.plant, "pose")):
            kind = getattr(self.plant, "kind", type(self.plant).__name__)
            expected = "a plant with pose(q), which returns x, y and psi"
            raise InvalidArgument(f"plant is a {kind}, which has no pose of its body, expected {expected}")
        return frozen(all_samples(self.plant, "pose", q))

    def metrics(self) -> dict[str, Signal]:
        """Return the plant's metrics at all samples, by name.

        Returns
        -------
        dict of str to Signal
            Values, shape (N + 1,), and unit of each metric; empty if the plant has no metrics.

        Raises
        ------
        InvalidArgument
            If the plant's ``evaluate_metrics`` returns another shape, or anything but real numbers.
        """
        metrics = metrics_of(self.plant)
        if not metrics:
            return {}
        arrays = self.t, self.q, self.v, self.a, self.u
        if stated(self.plant, "broadcasts"):
            values = evaluate_metrics_of(self.plant, *arrays, self.reference)
        else:
            rows = zip(zip(*arrays, strict=True), zip(*self.reference, strict=True), strict=True)
            values = np.stack([evaluate_metrics_of(self.plant, *row, Reference(*r)) for row, r in rows])
        return {metric.name: Signal(metric.unit, frozen(values[:, k])) for k, metric in enumerate(metrics)}

    @property
    def _line_size(self) -> int:
        """Number of coordinates in one line of text: the smallest allowed size of a reference."""
        return min(*reference_sizes_of(self.plant), self.error.shape[1]) if self.plant is not None else _BASE

    @property
    def _by_coordinate(self) -> bool:
        return bool(self.u.shape[1] == self.error.shape[1] == self.v.shape[1])

    def _format_joint(self) -> str:
        """Return the joint with the largest error as text; "" if all coordinates fit into one line."""
        largest = self.max_error()[self._line_size :]
        if not largest.size:
            return ""
        worst = int(largest.argmax())
        name, unit = self.labels[self._line_size + worst]
        return f", {name} {error_text(largest[worst])} {unit}".rstrip()

    def _format_joints(self) -> list[str]:
        """Return the lines of a table of the arms' joints; no line if there are none."""
        first = self._line_size
        labels, has_inputs = self.labels[first:], self._by_coordinate
        if not labels:
            return []
        width = max(len(name) for name, _ in labels)
        header = f"{'joint':{width}} {'largest error':>17} {'rms error':>17}"
        lines = [f"{header} {'largest input':>14}" if has_inputs else header]
        columns = (part[first:] for part in (self.max_error(), self.rms_error()))
        pairs: Any = zip(self.max_input()[first:], self.inputs[first:], strict=True)
        inputs = pairs if has_inputs else [None] * len(labels)
        for (name, unit), largest, rms, pair in zip(labels, *columns, inputs, strict=True):
            errors = " ".join(f"{error_text(value):>13} {unit:3}" for value in (largest, rms))
            size = "" if pair is None else f"{format_si(pair[0]):>10} {pair[1].unit:3}"
            lines.append(f"{name:{width}} {errors} {size}".rstrip())
        return lines

    def _format_errors(self, kind: str, values: Array) -> str:
        rows = list(zip(self.labels, values, strict=True))[: self._line_size]
        words = ", ".join(f"{name} {error_text(value)} {unit}".rstrip() for (name, unit), value in rows)
        return f"{kind} error: {words}"

    def end_effector(self, frame: str | None = None) -> EndEffector:
        """Return a frame over the samples: its pose, its target and its error.

        The target comes from the controller, such as `EndEffectorTracking`, else from the trajectory, such as
        that of `solve_inverse_kinematics`, else from the reference if it contains the arm's coordinates.

        Parameters
        ----------
        frame : str, optional
            One of the plant's ``frame_names``; default: the frame with a target, else the plant's
            ``end_effector``.

        Returns
        -------
        EndEffector
            Frame over the samples.

        Raises
        ------
        InvalidArgument
            If the plant does not provide poses of frames.
        UnknownName
            If there is no such frame; the message lists the frames.
        """
        plant = self.plant
        if not all(callable(stated(plant, name)) for name in ("frame_pose", "frame_name")):
            raise InvalidArgument(
                f"plant is {format_value(plant)}, which has no poses of frames, expected a MobileRobot, a "
                "WheeledRobot, or a plant with frame_name(frame) and frame_pose(q, frame)"
            )
        name = plant.frame_name(self._target_frame if frame is None else frame)
        pose = plant.frame_pose(self.q, name)
        position, orientation = target_names(name)
        if position in self.signals:
            target = _collect_targets(self.signals, position, orientation)
            return EndEffector(name, self.t, pose, target, orientation in self.signals)
        if self.error.shape[1] < _coordinates_of(plant, name):
            return EndEffector(name, self.t, pose)
        desired = full_configurations(self.q, self.reference.q)
        return EndEffector(name, self.t, pose, plant.frame_pose(desired, name))

    @property
    def _target_frame(self) -> str | None:
        """First frame of the plant with a target in the signals; None if there is none."""
        names = stated(self.plant, "frame_names") or ()
        return next((name for name in names if target_names(name)[0] in self.signals), None)

    def max_error(self) -> Array:
        """Return the largest absolute error of each coordinate, shape (n,) [m, m, rad, ...]."""
        return np.asarray(np.abs(self.error).max(axis=0))

    def rms_error(self) -> Array:
        """Return the root mean square error of each coordinate, shape (n,) [m, m, rad, ...]."""
        return np.asarray(np.sqrt(np.square(self.error).mean(axis=0)))

    def max_input(self) -> Array:
        """Return the largest absolute value of each input, shape (nu,), in the unit of the input."""
        return np.asarray(np.abs(self.u).max(axis=0))

    def save(self, path: str | PathLike[str]) -> None:
        """Write all samples, with all digits, to a NumPy archive (``.npz``); an existing file is replaced.

        Parameters
        ----------
        path : str or path
            Path of the file.

        Raises
        ------
        InvalidArgument
            If the file cannot be written.
        FileError
            If the system fails, for example because the disk is full; an existing file remains.
        """
        write_archive(path, _FORMAT, self.content())

    def content(self) -> dict[str, Any]:
        """Return the content of a file: the fields, with the plant as text or as a description."""
        values, plant = {item.name: getattr(self, item.name) for item in fields(self)}, ""
        outline = None if self.plant is None else PlantDescription.of(self.plant, self.q)
        try:
            plant = "" if outline is self.plant else pack(self.plant)
        except TypeError:  # the class belongs to a user
            pass
        except InvalidArgument as error:
            outline = outline and replace(outline, reason=str(error))
        return values | {"plant": plant, "outline": outline}

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> Rollout:
        """Return the rollout of a file's content; a plant that cannot be restored becomes its description.

        Parameters
        ----------
        content : mapping
            Result of `content`.

        Returns
        -------
        Rollout
            Recorded samples.
        """
        values = dict(content)
        outline = values.pop("outline")
        try:
            values["plant"] = unpack(values["plant"]) if values["plant"] else outline
        except Exception as error:  # the file of an arm is missing, or another release wrote the robot
            values["plant"] = replace(outline, reason=str(error))
        return cls(**values)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Rollout:
        """Return the rollout of a file that `save` wrote.

        Parameters
        ----------
        path : str or path
            Path of the file.

        Returns
        -------
        Rollout
            Recorded samples.

        Raises
        ------
        InvalidArgument
            If the file cannot be read, is damaged, or is not such an archive.
        FileError
            If the system fails.
        """
        return read_archive(location("path", path), _FORMAT, cls.of)

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write one line per sample to a text file, with a header and 17 significant digits.

        The columns are t, q, v, a, u, error, the desired q, and the signals. Their names contain the plant's
        names and units, such as ``v_x [m/s]`` and ``u_Fx [N]``, or numbers if the plant has no names.

        Parameters
        ----------
        path : str or path
            Path of the file.

        Raises
        ------
        InvalidArgument
            If the file cannot be written.
        FileError
            If the system fails, for example because the disk is full; an existing file remains.
        """
        columns = [part for part in self._columns() if part.key not in ("reference.v", "reference.a")]
        header = [_head(*title) for part in columns for title in part.titles]
        write_table(path, header, [part.values for part in columns])

    def to_mcap(self, path: str | PathLike[str], *, start: float = 0.0) -> None:
        """Write all samples to an MCAP file, which Foxglove, PlotJuggler and ROS 2 open; ROS is not needed.

        The topic ``/pinmobile/sample`` has t, q, v, a, u, error, reference and signals with all digits, for
        `from_mcap` and `Log.from_bag`. The metadata ``pinmobile`` state t, dt, names and units as text. The
        other topics are standard messages of ROS 2, at times rounded to nanoseconds:

        - ``/joint_states``: positions, velocities and efforts of all coordinates, x, y and psi included;
        - ``/odom`` and ``/twist``: the pose in the frame ``odom``, the twist in ``base_link``;
        - ``/wrench``: (Fx, Fy, Mz) of a body driven by forces, about its origin, along the axes of ``odom``;
        - ``/input``: u, an array of numbers.

        A plant without the pose of its body has no ``/odom`` and no ``/twist``.

        Parameters
        ----------
        path : str or path
            Path of the file, which ends in ``.mcap``; an existing file is replaced.
        start : float
            Time of t = 0 since 1970 [s].

        Raises
        ------
        InvalidArgument
            If the packages of the extra ``bags`` are not installed, the file cannot be written, or a time is
            before 1970 or after 2038, which the messages cannot express.
        FileError
            If the system fails, for example because the disk is full; an existing file remains.
        """
        write_mcap(path, self, _FORMAT, self._columns(), start)

    @classmethod
    def from_mcap(cls, path: str | PathLike[str]) -> Rollout:
        """Return the rollout of a file that `to_mcap` wrote, bit for bit.

        Parameters
        ----------
        path : str or path
            Path of the file.

        Returns
        -------
        Rollout
            Recorded samples.

        Raises
        ------
        InvalidArgument
            If the packages of the extra ``bags`` are not installed, or the file cannot be read.
        FileError
            If the file is damaged, is no MCAP file, or lacks the topic ``/pinmobile/sample``; or if the
            system fails.
        """
        return read_mcap(path, _FORMAT, cls.of)

    def _columns(self) -> list[Columns]:
        """Return all arrays with the names and units of their columns, in the order of a CSV file."""
        coordinates, has_plant = coordinates_of(self.plant), self.plant is not None
        units = {one.name: one.unit for one in coordinates}
        q_titles = [(name, units.get(name, "")) for name in configuration_names_of(self.plant)]
        v_titles = [(one.name, one.unit) for one in coordinates]
        u_titles = [(one.name, one.unit) for one in self.inputs]
        groups: Any = [
            ("q", "", "", self.q, q_titles),
            ("v", "v_", "/s", self.v, v_titles),
            ("a", "a_", "/s^2", self.a, v_titles),
            ("u", "u_", "", self.u, u_titles),
            ("error", "error_", "", self.error, v_titles),
            ("reference.q", "desired_", "", self.reference.q, q_titles),
            ("reference.v", "desired_v_", "/s", self.reference.v, v_titles),
            ("reference.a", "desired_a_", "/s^2", self.reference.a, v_titles),
        ]
        columns = [Columns("t", self.t, [("t", "s")])]
        for key, prefix, suffix, part, pairs in groups:
            width = part.shape[1]
            rows = pairs[:width] if has_plant or key == "u" else [(f"[{k}]", "") for k in range(width)]
            titles = [(f"{prefix}{name}", f"{unit}{suffix}" if unit else "") for name, unit in rows]
            columns.append(Columns(key, part, titles))
        for name, (unit, values) in self.signals.items():
            entries = [""] if values.ndim == 1 else [f"[{k}]" for k in range(values.shape[1])]
            titles = [(f"signal_{name}{entry}", unit) for entry in entries]
            columns.append(Columns(f"signals.{name}", values, titles))
        return columns


def _head(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name
