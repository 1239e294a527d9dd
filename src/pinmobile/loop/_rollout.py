"""`Rollout`: everything that a simulation recorded, with its own judgement, and its `EndEffector`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from os import PathLike
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, finite, frozen, increasing, location, real, shaped
from pinmobile.errors import InvalidArgument, shown
from pinmobile.files import packed, read_archive, unpacked, write_archive, write_table
from pinmobile.metrics import evaluate_metrics_of, in_words, metrics_of
from pinmobile.plant import (
    Coordinate,
    Input,
    PlantOutline,
    all_samples,
    configuration_names_of,
    coordinates_of,
    inputs_of,
    limits_exceeded,
    reference_sizes_of,
    stated,
    whole_configurations,
)
from pinmobile.reaching import error_sizes, pose_error, target_names
from pinmobile.signals import Signal
from pinmobile.trajectories import Reference

_BASE = 3


@dataclass(frozen=True, eq=False, repr=False)
class EndEffector:
    """A frame over the samples of a rollout; made by `Rollout.end_effector`.

    Attributes
    ----------
    frame : str
        Its name.
    t : ndarray, shape (N + 1,)
        Times [s].
    pose : ndarray, shape (N + 1, 4, 4)
        T_0_f, where it was.
    target : ndarray, shape (N + 1, 4, 4), or None
        Where it should have been; None where nothing says so.
    is_oriented : bool
        Whether the target says how it should stand too, not its position alone.
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
            return f"{self.frame} over {self.t[-1]:g} s, without target"
        metres, radians = self.max_error()
        turn = f", {radians:.3e} rad" if self.is_oriented else ""
        return f"{self.frame} over {self.t[-1]:g} s, largest error {metres:.3e} m{turn}"

    @property
    def position(self) -> Array:
        """Of its origin, shape (N + 1, 3) [m]."""
        return self.pose[:, :3, 3]

    @property
    def orientation(self) -> Array:
        """R_0_f, shape (N + 1, 3, 3)."""
        return self.pose[:, :3, :3]

    @cached_property
    def error(self) -> Array:
        """From its pose to the target's along the inertial axes, shape (N + 1, 6) [m, rad].

        The last three are the rotation vector; NaN where the position alone is followed.

        Raises
        ------
        InvalidArgument
            If there is no target.
        """
        if self.target is None:
            raise InvalidArgument(
                f"end effector {self.frame!r} has no target, expected a run of EndEffectorTracking, of a "
                "trajectory that solve_inverse_kinematics gave, or of a reference with the arm's coordinates"
            )
        error = pose_error(self.target, self.pose)
        if not self.is_oriented:
            error[:, _BASE:] = np.nan
        return frozen(error)

    @property
    def position_error(self) -> Array:
        """Of its origin, shape (N + 1, 3) [m]; raises as `error`."""
        return self.error[:, :_BASE]

    @property
    def orientation_error(self) -> Array:
        """Rotation vector from how it stands to how it should, shape (N + 1, 3) [rad]; as of `error`."""
        return self.error[:, _BASE:]

    @property
    def distance(self) -> Array:
        """Size of the position's error, shape (N + 1,) [m]; raises as `error`."""
        return np.asarray(error_sizes(self.error)[:, 0])

    @property
    def angle(self) -> Array:
        """Angle of the orientation's error, shape (N + 1,) [rad]; NaN where none is desired."""
        return np.asarray(error_sizes(self.error)[:, 1])

    def max_error(self) -> tuple[float, float]:
        """Return the largest distance [m] and the largest angle [rad] from the target, as of `error`."""
        way, turn = error_sizes(self.error).max(axis=0)
        return float(way), float(turn)


def aimed_at(rollout: Any) -> str | None:
    """Return the first frame of a rollout's plant whose target the run has; None where it has none."""
    names = stated(rollout.plant, "frame_names") or ()
    return next((name for name in names if target_names(name)[0] in rollout.signals), None)


def end_effector_of(rollout: Any, frame: str | None) -> EndEffector:
    """Return a frame of a rollout's plant over its samples.

    Parameters
    ----------
    rollout : Rollout
        The run.
    frame : str or None
        Its name; None: that whose target the run has, else the plant's ``end_effector``.

    Raises
    ------
    InvalidArgument
        If the plant does not tell where its frames are.
    UnknownName
        If there is no such frame.
    """
    plant = rollout.plant
    if not all(callable(stated(plant, name)) for name in ("frame_pose", "frame_name")):
        raise InvalidArgument(
            f"plant is {shown(plant)}, which does not tell where its frames are, expected a MobileRobot, a "
            "WheeledRobot, or a plant with frame_name(frame) and frame_pose(q, frame)"
        )
    name = plant.frame_name(aimed_at(rollout) if frame is None else frame)
    pose = plant.frame_pose(rollout.q, name)
    position, orientation = target_names(name)
    if position in rollout.signals:
        target = _told(rollout.signals, position, orientation)
        return EndEffector(name, rollout.t, pose, target, orientation in rollout.signals)
    if rollout.error.shape[1] < _coordinates_of(plant, name):
        return EndEffector(name, rollout.t, pose)
    desired = whole_configurations(plant, rollout.q, rollout.reference.q)
    return EndEffector(name, rollout.t, pose, plant.frame_pose(desired, name))


def _told(signals: Mapping[str, Signal], position: str, orientation: str) -> Array:
    """Return the poses of signals, shape (N + 1, 4, 4)."""
    place = signals[position].values
    target = np.tile(np.eye(4), (len(place), 1, 1))
    target[:, :3, 3] = place
    if orientation in signals:
        quaternions = signals[orientation].values
        target[:, :3, :3] = [pin.Quaternion(row).toRotationMatrix() for row in quaternions]
    return target


def _coordinates_of(plant: Any, frame: str) -> int:
    """Return how many of the first coordinates a reference needs to define the pose of a frame."""
    mounts = stated(plant, "mounts")
    if mounts is None:
        return int(plant.nv)
    own = (mount.v.stop for mount in mounts if frame.startswith(f"{mount.name}/"))
    return int(next(own, _BASE))


_POSE = 3  # x, y, psi
_RECORDED = ("t", "q", "v", "a", "u", "error")
_FORMAT = "pinmobile rollout 4"
_GROUND = {
    "tips": "no loads of wheels and supports balance the robot: it tips over, which is not simulated",
    "missed": "loads and forces of the ground were not found to their tolerance",
}


def error_text(value: float) -> str:
    """Return an error [m, rad] with seven digits, or without where it is rounding: there, machines differ."""
    return in_words(value, ".6e")


@dataclass(frozen=True, eq=False, repr=False)
class Rollout:
    """A closed loop, sample by sample, the last one included.

    Attributes
    ----------
    plant : MobileRobot or other plant
        What was simulated. Of a file whose plant is of a user's class, or has an arm that is no loader's and
        has no URDF that is still there, a `pinmobile.plant.PlantOutline`: its names and units.
    t : ndarray, shape (N + 1,)
        Times [s].
    q : ndarray, shape (N + 1, nq)
        Configuration.
    v, a : ndarray, shape (N + 1, nv)
        Velocity and acceleration; `a` is that at the start of each step.
    u : ndarray, shape (N + 1, nu)
        Input, within the plant's limits, held until the next sample; of a body that is pushed its generalised
        force (Fx, Fy, Mz, ...) [N, N, N m, ...].
    error : ndarray, shape (N + 1, n)
        From the configuration to the reference's n coordinates, psi on the circle [m, m, rad, ...].
    reference : Reference
        Desired q, v and a of the first n coordinates.
    signals : mapping of str to Signal
        Further series of the parts, by name, each with its unit.
    engine : str
        What ran the loop: ``"PYTHON"``, in Python, or ``"COMPILED"``; "" where that is not known.
    fallback_reason : str
        Why not a faster engine; "" where there is none, or it was asked for.

    Raises
    ------
    InvalidArgument
        If a number is not finite, times do not increase, or a shape is not what it is above.
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
        for name in _RECORDED:
            with np.errstate(over="ignore"):  # of the square of a time
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
        of_plant = {"q": self.q, "v": self.v, "a": self.a, "u": self.u}
        tracked = {"error": self.error, "reference.v": desired.v, "reference.a": desired.a}
        for name, array in {**of_plant, **tracked, "reference.q": desired.q}.items():
            shaped(name, array, (len(t), "k"), words=", as t has")
        for name, size in (("q", "nq"), ("v", "nv"), ("a", "nv"), ("u", "nu")):
            width: Any = getattr(self.plant, size, (self.v if size == "nv" else of_plant[name]).shape[1])
            shaped(name, of_plant[name], (len(t), width))
        for name, array in tracked.items():
            shaped(name, array, self.error.shape, words=", as error has")
        if self.error.shape[1] > self.v.shape[1] or desired.q.shape[1] > self.q.shape[1]:
            shaped("reference.q", desired.q, self.q.shape)

    def __len__(self) -> int:
        return len(self.t)

    def __reduce__(self) -> tuple[Any, ...]:
        own = {each.name: getattr(self, each.name) for each in fields(self)}
        return Rollout, tuple((own | {"signals": dict(self.signals)}).values())

    def __repr__(self) -> str:
        errors = self._errors("largest", self.max_error())
        return f"<Rollout: {len(self)} samples over {self.t[-1]:g} s, {errors}{self._worst_joint()}>"

    def __str__(self) -> str:
        step = f" at dt = {self.t[1]:g} s" if len(self) > 1 else ""
        listed = zip(self.inputs, self.max_input(), strict=True)
        inputs = [f"{one.name} {in_words(value)} {one.unit}".rstrip() for one, value in listed]
        return "\n".join(
            [
                f"{len(self)} samples over {self.t[-1]:g} s{step}",
                self._errors("largest", self.max_error()),
                self._errors("rms", self.rms_error()),
                "largest input: " + ", ".join(inputs[: self._led] if self._by_coordinate else inputs),
                *self._of_joints(),
                *self._of_end_effector(),
                *self.events,
            ]
        )

    @cached_property
    def events(self) -> tuple[str, ...]:
        """What happened beside the motion, a sentence each.

        Limits of position, speed and torque that were exceeded, and where the ground cannot carry the robot.
        """
        found = list(limits_exceeded(self.plant, self.t, self.q, self.v, self.u))
        for name, words in _GROUND.items() if stated(self.plant, "contact_loads") else ():
            told = np.empty(0, int)
            if name in self.signals:
                told = np.flatnonzero(self.signals[name].values)
            elif name == "tips" and any(one.worst == "ever" for one in metrics_of(self.plant)):
                # Wheels that roll do not record it.
                told = np.flatnonzero(self.plant.contact_loads(self.q, self.v, self.a).tips)
            if len(told):
                found.append(f"{words} (from t = {self.t[told[0]]:g} s, {len(told)} of {len(self)} samples)")
        return tuple(found)

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The coordinates that the reference has, one for each column of `error`."""
        count = self.error.shape[1]
        named = coordinates_of(self.plant) or tuple(Coordinate(f"[{k}]", "") for k in range(count))
        return named[:count]

    @property
    def inputs(self) -> tuple[Input, ...]:
        """The plant's inputs, one for each column of `u`."""
        return inputs_of(self.plant) or tuple(Input(f"[{k}]", "") for k in range(self.u.shape[1]))

    @property
    def labels(self) -> tuple[tuple[str, str], ...]:
        """Name and unit of each column of `error`, shape (n,)."""
        return tuple((one.name, one.unit) for one in self.coordinates)

    @property
    def poses(self) -> Array:
        """x, y and psi of the body, shape (N + 1, 3) [m, m, rad].

        Raises
        ------
        InvalidArgument
            If the plant does not tell where its body is.
        """
        return self._poses(self.q)

    @property
    def reference_poses(self) -> Array:
        """x, y and psi that the body should have, shape (N + 1, 3) [m, m, rad]; raises as `poses`."""
        return self._poses(whole_configurations(self, self.q, self.reference.q))

    @property
    def nq(self) -> int:
        """Size of q."""
        return int(self.q.shape[1])

    def _poses(self, q: Array) -> Array:
        if self.plant is None and self.nq >= _POSE:
            return q[:, :_POSE]
        if not callable(stated(self.plant, "pose")):
            kind = getattr(self.plant, "kind", type(self.plant).__name__)
            raise InvalidArgument(
                f"plant is a {kind}, which does not tell where its body is, expected one with pose(q), which "
                "returns x, y and psi"
            )
        return frozen(all_samples(self.plant, "pose", q))

    def metrics(self) -> dict[str, Signal]:
        """Return what the plant states as ``metrics``, with units, at all samples, by name.

        Raises
        ------
        InvalidArgument
            If the plant's ``evaluate_metrics`` returns another shape, or no real numbers.
        """
        known = metrics_of(self.plant)
        if not known:
            return {}
        recorded = self.t, self.q, self.v, self.a, self.u
        if stated(self.plant, "broadcasts"):
            found = evaluate_metrics_of(self.plant, *recorded, self.reference)
        else:
            samples = zip(*recorded, *self.reference, strict=True)
            rows = (
                evaluate_metrics_of(self.plant, t, q, v, a, u, Reference(*at))
                for t, q, v, a, u, *at in samples
            )
            found = np.stack(list(rows))
        return {one.name: Signal(one.unit, frozen(found[:, k])) for k, one in enumerate(known)}

    @property
    def _led(self) -> int:
        """How many coordinates stand in one line of text: the fewest that a reference may have."""
        return min(*reference_sizes_of(self.plant), self.error.shape[1]) if self.plant is not None else _POSE

    @property
    def _by_coordinate(self) -> bool:
        return bool(self.u.shape[1] == self.error.shape[1] == self.v.shape[1])

    def _worst_joint(self) -> str:
        """Return the joint with the largest error, as text; nothing where all stand in one line."""
        largest = self.max_error()[self._led :]
        if not largest.size:
            return ""
        worst = int(largest.argmax())
        name, unit = self.labels[self._led + worst]
        return f", {name} {error_text(largest[worst])} {unit}".rstrip()

    def _of_joints(self) -> list[str]:
        """Return a table of what stands in no line, the arms' joints; nothing where there are none."""
        led = self._led
        labels, forced = self.labels[led:], self._by_coordinate
        if not labels:
            return []
        width = max(len(name) for name, _ in labels)
        heads = f"{'joint':{width}} {'largest error':>17} {'rms error':>17}"
        lines = [f"{heads} {'largest input':>14}" if forced else heads]
        columns = (part[led:] for part in (self.max_error(), self.rms_error()))
        inputs = (
            zip(self.max_input()[led:], self.inputs[led:], strict=True) if forced else [None] * len(labels)
        )
        for (name, unit), largest, rms, pair in zip(labels, *columns, inputs, strict=True):
            errors = " ".join(f"{error_text(value):>13} {unit:3}" for value in (largest, rms))
            most = "" if pair is None else f"{in_words(pair[0]):>10} {pair[1].unit:3}"
            lines.append(f"{name:{width}} {errors} {most}".rstrip())
        return lines

    def _of_end_effector(self) -> list[str]:
        """Return a line of the frame whose target the run has; nothing where there is none."""
        return [] if aimed_at(self) is None else [f"end effector {self.end_effector()}"]

    def _errors(self, what: str, values: Array) -> str:
        named = list(zip(self.labels, values, strict=True))[: self._led]
        listed = ", ".join(f"{name} {error_text(value)} {unit}".rstrip() for (name, unit), value in named)
        return f"{what} error: {listed}"

    def end_effector(self, frame: str | None = None) -> EndEffector:
        """Return a frame over the samples: its path, where it should have been, and how far off it was.

        The target is that of the controller, such as `EndEffectorTracking`; else that of the trajectory, such
        as `solve_inverse_kinematics` gives; else where the reference puts the frame, if it has the arm's
        coordinates.

        Parameters
        ----------
        frame : str, optional
            One of the plant's ``frame_names``; by default the one whose target the run has, else its
            ``end_effector``.

        Raises
        ------
        InvalidArgument
            If the plant does not tell where its frames are.
        UnknownName
            If there is no such frame; it says which there are.
        """
        return end_effector_of(self, frame)

    def max_error(self) -> Array:
        """Return the largest |error| of each coordinate, shape (n,) [m, m, rad, ...]."""
        return np.asarray(np.abs(self.error).max(axis=0))

    def rms_error(self) -> Array:
        """Return the root of the mean squared error of each coordinate, shape (n,) [m, m, rad, ...]."""
        return np.asarray(np.sqrt(np.square(self.error).mean(axis=0)))

    def max_input(self) -> Array:
        """Return the largest |u| of each input, shape (nu,), in its unit."""
        return np.asarray(np.abs(self.u).max(axis=0))

    def save(self, path: str | PathLike[str]) -> None:
        """Write everything, to the last digit, as a NumPy archive (``.npz``); what is there is replaced.

        Raises
        ------
        InvalidArgument
            If the file cannot be written.
        FileError
            If the system fails, such as of a full disk; what was there is there still.
        """
        write_archive(path, _FORMAT, self.content())

    def content(self) -> dict[str, Any]:
        """Return all that a file keeps: a robot of the library as text, of another plant its outline."""
        own, plant = {each.name: getattr(self, each.name) for each in fields(self)}, ""
        outline = None if self.plant is None else PlantOutline.of(self.plant, self.q)
        try:
            plant = "" if outline is self.plant else packed(self.plant)
        except TypeError:  # a user's class
            pass
        except InvalidArgument as error:
            outline = outline and replace(outline, reason=str(error))
        return own | {"plant": plant, "outline": outline}

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> Rollout:
        """Return the rollout that has some `content`; of a robot that cannot be had again, the outline."""
        own = dict(content)
        outline = own.pop("outline")
        try:
            own["plant"] = unpacked(own["plant"]) if own["plant"] else outline
        except Exception as error:  # of an arm's file that is gone, or a robot of another release
            own["plant"] = replace(outline, reason=str(error))
        return cls(**own)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Rollout:
        """Return what `save` wrote.

        Raises
        ------
        InvalidArgument
            If the file cannot be read, is damaged, or is not such an archive.
        FileError
            If the system fails.
        """
        return read_archive(location("path", path), _FORMAT, cls.of)

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write one line per sample, with a header and 17 significant digits.

        The columns are t, then q, v, a, u, error, the desired q, and the signals, each with the plant's names
        and units, such as ``v_x [m/s]`` and ``u_Fx [N]``; numbers where the plant names none.

        Raises
        ------
        InvalidArgument
            If the file cannot be written.
        FileError
            If the system fails, such as of a full disk; what was there is there still.
        """
        coordinates, known = coordinates_of(self.plant), self.plant is not None
        units = {one.name: one.unit for one in coordinates}
        of_q = [(name, units.get(name, "")) for name in configuration_names_of(self.plant)]
        of_v = [(one.name, one.unit) for one in coordinates]
        of_u = [(one.name, one.unit) for one in self.inputs]
        groups: list[tuple[str, str, Array, Sequence[tuple[str, str]]]] = [
            ("", "", self.q, of_q),
            ("v_", "/s", self.v, of_v),
            ("a_", "/s^2", self.a, of_v),
            ("u_", "", self.u, of_u),
            ("error_", "", self.error, of_v),
            ("desired_", "", self.reference.q, of_q),
        ]
        header, columns = ["t [s]"], [self.t]
        for group, per, part, named in groups:
            width = part.shape[1]
            listed = named[:width] if known or group == "u_" else [(f"[{k}]", "") for k in range(width)]
            header += [_head(f"{group}{name}", f"{unit}{per}" if unit else "") for name, unit in listed]
            columns.append(part)
        for name, (unit, values) in self.signals.items():
            entries = [""] if values.ndim == 1 else [f"[{k}]" for k in range(values.shape[1])]
            header += [_head(f"signal_{name}{entry}", unit) for entry in entries]
            columns.append(values)
        write_table(path, header, columns)


def _head(name: str, unit: str) -> str:
    return f"{name} [{unit}]" if unit else name
