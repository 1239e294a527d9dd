"""`Rollout`: everything that a simulation recorded, with its own judgement."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np

from pinmobile.arrays import Array, finite, frozen, increasing, location
from pinmobile.errors import InvalidArgument
from pinmobile.files import replacing, write_table
from pinmobile.robot import MobileRobot
from pinmobile.simulation.storage import read_archive, write_archive
from pinmobile.trajectories import Reference

__all__ = ["Rollout", "error_text"]

_NAMES = ("x", "y", "psi")
_UNITS = ("m", "m", "rad")
_ROUNDING = 1e-12  # [m, rad]
_RECORDED = ("t", "q", "v", "a", "tau", "error")


def error_text(value: float) -> str:
    """Return an error [m, rad] with seven digits, or without where it is rounding: there, machines differ."""
    return "< 1e-12" if 0 < value < _ROUNDING else f"{value:.6e}"


@dataclass(frozen=True, eq=False, repr=False)
class Rollout:
    """A closed loop, sample by sample, the last one included.

    Attributes
    ----------
    robot : MobileRobot or other plant
        What was simulated; None after loading the file of a plant that is no `MobileRobot`, or of one whose
        arm is no loader's and has no URDF that is still there.
    t : ndarray, shape (N + 1,)
        Times [s].
    q : ndarray, shape (N + 1, nq)
        Configuration; nq = nv = 3 where no arm is mounted.
    v, a : ndarray, shape (N + 1, nv)
        Velocity and acceleration; `a` is that at the start of each step.
    tau : ndarray, shape (N + 1, nv)
        Generalised force (Fx, Fy, Mz, ...) [N, N, N m, ...], held until the next sample.
    error : ndarray, shape (N + 1, nv)
        From the configuration to the reference, psi on the circle [m, m, rad, ...].
    reference : Reference
        Desired q, v and a, of the same shapes.

    Raises
    ------
    InvalidArgument
        If a number is not finite, times do not increase, or a shape is not what it is above.
    """

    robot: Any
    t: Array
    q: Array
    v: Array
    a: Array
    tau: Array
    error: Array
    reference: Reference

    def __post_init__(self) -> None:
        for name in _RECORDED:
            with np.errstate(over="ignore"):  # of the square of a time
                object.__setattr__(self, name, frozen(finite(name, getattr(self, name))))
        parts = zip(Reference._fields, self.reference, strict=True)
        desired = Reference(*(frozen(finite(f"reference.{name}", part)) for name, part in parts))
        object.__setattr__(self, "reference", desired)
        self._check_shapes()

    def _check_shapes(self) -> None:
        t, desired = self.t, self.reference
        increasing("t", t)
        of_plant = {"q": self.q, "v": self.v, "a": self.a, "tau": self.tau}
        tracked = {"error": self.error, "reference.v": desired.v, "reference.a": desired.a}
        for name, array in {**of_plant, **tracked, "reference.q": desired.q}.items():
            if array.ndim != 2 or len(array) != len(t):
                raise InvalidArgument(f"{name} has shape {array.shape}, expected ({len(t)}, ...) as t has")
        for name, size in (("q", "nq"), ("v", "nv"), ("a", "nv"), ("tau", "nu")):
            width = getattr(self.robot, size, (self.v if size == "nv" else of_plant[name]).shape[1])
            if of_plant[name].shape[1] != width:
                raise InvalidArgument(
                    f"{name} has shape {of_plant[name].shape}, expected ({len(t)}, {width})"
                )
        for name, array in tracked.items():
            if array.shape != self.error.shape or array.shape[1] > self.v.shape[1]:
                raise InvalidArgument(
                    f"{name} has shape {array.shape}, expected that of error and at most {self.v.shape}"
                )
        if desired.q.shape[1] > self.q.shape[1]:
            raise InvalidArgument(f"reference.q has shape {desired.q.shape}, expected {self.q.shape}")

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        errors = self._errors("largest", self.max_error())
        return f"<Rollout: {len(self)} samples over {self.t[-1]:g} s, {errors}{self._worst_joint()}>"

    def __str__(self) -> str:
        step = f" at dt = {self.t[1]:g} s" if len(self) > 1 else ""
        forces = zip(("Fx", "Fy", "Mz"), self.max_force(), ("N", "N", "N m"), strict=False)
        return "\n".join(
            [
                f"{len(self)} samples over {self.t[-1]:g} s{step}",
                self._errors("largest", self.max_error()),
                self._errors("rms", self.rms_error()),
                "largest force: " + ", ".join(f"{name} {value:.4g} {unit}" for name, value, unit in forces),
                *self._of_joints(),
            ]
        )

    @property
    def labels(self) -> tuple[tuple[str, str], ...]:
        """Name and unit of each column of `error`, shape (nv,); numbers where the robot is not known."""
        count = self.error.shape[1]
        if isinstance(self.robot, MobileRobot) and self.robot.nv == count:
            return tuple(zip(self.robot.coordinate_names, self.robot.coordinate_units, strict=True))
        known = tuple(zip(_NAMES, _UNITS, strict=True))
        return known[:count] + tuple((f"[{k}]", "") for k in range(len(known), count))

    def _worst_joint(self) -> str:
        """Return the joint with the largest error, as text; nothing where no arm is mounted."""
        largest = self.max_error()[len(_NAMES) :]
        if not largest.size:
            return ""
        worst = int(largest.argmax())
        name, unit = self.labels[len(_NAMES) + worst]
        return f", {name} {error_text(largest[worst])} {unit}".rstrip()

    def _of_joints(self) -> list[str]:
        """Return a table of the arms' joints; nothing where there are none."""
        labels = self.labels[len(_NAMES) :]
        if not labels or self.tau.shape != self.error.shape:
            return []
        width = max(len(name) for name, _ in labels)
        lines = [f"{'joint':{width}} {'largest error':>17} {'rms error':>17} {'largest force':>14}"]
        columns = (part[len(_NAMES) :] for part in (self.max_error(), self.rms_error(), self.max_force()))
        for (name, unit), largest, rms, force in zip(labels, *columns, strict=True):
            newton = {"m": "N  ", "rad": "N m"}.get(unit, "   ")
            errors = " ".join(f"{error_text(value):>13} {unit:3}" for value in (largest, rms))
            lines.append(f"{name:{width}} {errors} {force:10.4g} {newton}".rstrip())
        return lines

    @staticmethod
    def _errors(what: str, values: Array) -> str:
        named = zip(_NAMES, values, _UNITS, strict=False)
        listed = ", ".join(f"{name} {error_text(value)} {unit}" for name, value, unit in named)
        return f"{what} error: {listed}"

    def max_error(self) -> Array:
        """Return the largest |error| of each coordinate, shape (nv,) [m, m, rad, ...]."""
        return np.asarray(np.abs(self.error).max(axis=0))

    def rms_error(self) -> Array:
        """Return the root of the mean squared error of each coordinate, shape (nv,) [m, m, rad, ...]."""
        return np.asarray(np.sqrt(np.square(self.error).mean(axis=0)))

    def max_force(self) -> Array:
        """Return the largest |tau| of each coordinate, shape (nv,) [N, N, N m, ...]."""
        return np.asarray(np.abs(self.tau).max(axis=0))

    def save(self, path: str | PathLike[str]) -> None:
        """Write everything, to the last digit, as a NumPy archive (``.npz``); what is there is replaced.

        Raises
        ------
        InvalidArgument
            If the file cannot be written.
        FileError
            If the system fails, such as of a full disk; what was there is there still.
        """
        with replacing(path) as file:
            write_archive(file, self.arrays(), self.robot)

    def arrays(self) -> dict[str, Array]:
        """Return all arrays by the names that they have in a file, those of the reference among them."""
        reference = {f"reference_{name}": array for name, array in self.reference._asdict().items()}
        return {name: getattr(self, name) for name in _RECORDED} | reference

    @classmethod
    def of(cls, robot: Any, arrays: Mapping[str, Array]) -> "Rollout":
        """Return the rollout of a robot, or of None, that has the arrays of `arrays`."""
        reference = Reference(*(arrays[f"reference_{name}"] for name in Reference._fields))
        return cls(robot=robot, reference=reference, **{name: arrays[name] for name in _RECORDED})

    @classmethod
    def load(cls, path: str | PathLike[str]) -> "Rollout":
        """Return what `save` wrote.

        Raises
        ------
        InvalidArgument
            If the file cannot be read, is damaged, or is not such an archive.
        FileError
            If the system fails.
        """
        file = location("path", path)
        arrays, robot = read_archive(file)
        try:
            return cls.of(robot, arrays)
        except InvalidArgument as error:
            raise InvalidArgument(f"path is {str(file)!r}, which holds no rollout: {error}") from error

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write one line per sample, with a header and 17 significant digits.

        The columns are t, then q, v, a, tau, error and the desired q, each as x, y, psi and the names of
        the arms' joints; those have numbers where the robot is not known.

        Raises
        ------
        InvalidArgument
            If the file cannot be written.
        FileError
            If the system fails, such as of a full disk; what was there is there still.
        """
        groups = {"": self.q, "v_": self.v, "a_": self.a, "tau_": self.tau, "error_": self.error}
        groups["desired_"] = self.reference.q
        header = ["t", *(f"{group}{name}" for group, part in groups.items() for name in self._columns(part))]
        write_table(path, header, [self.t, *groups.values()])

    def _columns(self, part: Array) -> Sequence[str]:
        """Return the columns' names: x, y, psi and the joints; numbers where they have none."""
        width = part.shape[1]
        if isinstance(self.robot, MobileRobot):
            for named in (self.robot.configuration_names, self.robot.coordinate_names):
                if len(named) == width:
                    return named
        names = list(_NAMES) if width >= len(_NAMES) else []
        return [*names, *(str(k) for k in range(len(names), width))]
