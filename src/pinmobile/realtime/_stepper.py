"""`Stepper`, a controller that computes one sample per call, with a record of the last samples."""

from __future__ import annotations

from math import inf, isfinite, prod
from typing import Any

import numpy as np

from pinmobile.arrays import (
    Array,
    ArrayLike,
    affordable,
    check_integer,
    finite,
    positive,
    real,
    required,
    shaped,
)
from pinmobile.compiled import Program, aligned, map_leaves, pause_gc
from pinmobile.controllers import Controller, check_controller
from pinmobile.errors import InvalidArgument, NotFinite, NotTraceable, unexpected_value
from pinmobile.export import InputRecorder, Law, initial_context, noise_error
from pinmobile.loop import (
    Loop,
    Rollout,
    control,
    errors_of,
    initial_memory,
    scheduled_rows,
    select_integrator,
    traced_numbers,
    tracking_errors,
)
from pinmobile.parts import evolved
from pinmobile.plant import Plant, check_plant, coordinates_of, stated
from pinmobile.signals import Signal, collect_signals, collect_time_signals, signals_of
from pinmobile.trajectories import Reference, Trajectory

_START_TIME = -1e-300  # time [s] before the first sample, which may be at 0


class _MachineCode:
    """Controller as machine code; raises `NotTraceable` if it cannot be compiled."""

    def __init__(self, loop: Loop, context: Any, start: tuple[Array, Array], first: Reference) -> None:
        with pause_gc():
            law = Law(evolved(loop, {"recorder": InputRecorder(errors=True)}), context, start, first)
            tape = law.controller_tape()
            program = Program(tape, single=True)
        pairs = zip(tape.leaves, law.values, strict=True)
        memory = [np.broadcast_to(np.asarray(value, np.float64), leaf.shape) for leaf, value in pairs]
        numbers, (q, v) = traced_numbers(loop), start
        keys = {name: np.zeros(1, np.uint64) for name in tape.keys}
        blocks = program.blocks_of((q[None], v[None]), 1, numbers, memory, keys)
        self._uniforms = program.uniforms_of(context.dt, numbers, memory)
        rings = aligned((max(1, sum(ring.samples for ring in tape.rings)),))
        self._counts = np.zeros(1, np.int32)
        block, n = blocks[0, :, 0], len(q) + len(v)
        self._state, self._memory = block[:n], (block[n : len(tape.states)], rings)
        self.kept = {name: shape for name, (shape, _) in tape.kept.items()}
        self.units = {name: tape.units[name.removeprefix("signal ")] for name in [*self.kept][2:]}
        self._blocks, self._size, self._function = blocks, n, program.code()

    def connect(self, row: Array, answer: Array) -> None:
        """Use a row of q, v, t, reference and schedules in each call, and write the answer to an array."""
        self._arguments_row, sample = row[: self._size], row[self._size :]
        arrays = self._blocks, sample, self._uniforms, self._memory[1], self._counts, answer
        block, inputs, uniform, rings, counts, outputs = (array.ctypes.data for array in arrays)
        arguments = block, 0, 1, inputs, 1, uniform, rings, counts, 1, 1, outputs
        kinds = self._function.argtypes  # type: ignore[attr-defined]  # of ctypes
        self._arguments = [kind(x) for kind, x in zip(kinds, arguments, strict=False)]  # made once

    def __call__(self, k: int) -> None:
        """Compute sample k."""
        self._state[...] = self._arguments_row
        self._function(*self._arguments, k)

    @property
    def memory(self) -> Any:
        """Memory after the last sample, a copy."""
        return np.concatenate(self._memory)

    @memory.setter
    def memory(self, value: Any) -> None:
        size = sum(map(len, self._memory))
        values = shaped(
            "memory", real("memory", value), (size,), words=", that of a stepper of the same parts"
        )
        self._memory[0][...], self._memory[1][...] = np.split(values, [len(self._memory[0])])


class _PythonCode:
    """Controller that runs in Python, with the interface of `_MachineCode`."""

    def __init__(self, loop: Loop, context: Any, start: tuple[Array, Array], first: Reference) -> None:
        self._loop, self._state = loop, initial_memory(loop, context, noise=_refuse_noise).controller
        self._sizes = len(start[0]), len(start[1]), 1, *map(len, first)
        signals = self._signals(self._state)
        self.kept = {"u": (loop.plant.nu,), "error": (2 * len(first.v),)}
        self.kept |= {f"signal {name}": signal.value.shape for name, signal in signals.items()}
        self.units = {f"signal {name}": signal.unit for name, signal in signals.items()}

    def _signals(self, memory: Any) -> Any:
        return collect_signals([("controller", signals_of(self._loop.controller, memory))])

    def connect(self, row: Array, answer: Array) -> None:
        """Use a row of q, v, t and reference in each call, and write the answer to an array."""
        self._answer = answer
        self._parts = np.split(row[: sum(self._sizes)], np.cumsum(self._sizes)[:-1])

    def __call__(self, k: int) -> None:
        """Compute sample k."""
        q, v, t, *reference = self._parts
        desired = Reference(*(x.copy() for x in reference))
        with np.errstate(all="ignore"):
            u, next_state = control(self._loop, float(t[0]), q, v, desired, self._state)
            errors = tracking_errors(self._loop.dynamics, q, v, desired)
        signals = (signal.value for signal in self._signals(next_state).values())
        self._answer[...] = np.concatenate([*map(np.ravel, (u, *errors, *signals))])
        self._state = next_state

    @property
    def memory(self) -> Any:
        """Memory after the last sample, a copy."""
        return map_leaves(self._state, lambda x: x.copy() if isinstance(x, np.ndarray) else x)

    @memory.setter
    def memory(self, value: Any) -> None:
        self._state = map_leaves(value, lambda x: x.copy() if isinstance(x, np.ndarray) else x)


def _refuse_noise(name: str, n: int) -> Any:
    raise noise_error(name)


class Stepper:
    """Controller of a real robot: ``u = stepper.step(t, q, v)`` computes one sample.

    A controller in NumPy runs as machine code, with the bits of `simulate`. Any other controller, such as
    `MPC`, runs in Python; `fallback_reason` states why. Limits of the plant's inputs are applied, and a
    controller such as `DisturbanceObserver` receives the applied input. Velocities are used as measured.

    A trajectory is sampled when the stepper is made. The reference of a call is the sample nearest to its
    time, without interpolation; schedules of gains follow it. After the end, the reference rests.

    All arrays are allocated when the stepper is made. A call makes no objects that remain.

    Parameters
    ----------
    controller : controller
        Controller, without simulated noise.
    plant : MobileRobot or other plant
        Plant whose inputs, limits and coordinates the controller uses.
    dt : float
        Time step [s].
    trajectory : trajectory, optional
        Source of the reference; without it, each call needs a reference.
    capacity : int
        Number of recorded samples; the last ones remain.

    Attributes
    ----------
    k : int
        Number of samples since the initial memory.
    engine : str
        ``"COMPILED"`` or ``"PYTHON"``.
    fallback_reason : str
        Reason why the engine is not ``"COMPILED"``; "" if it is.

    Raises
    ------
    InvalidArgument
        If an argument is invalid, the controller draws noise, or it reads the trajectory and there is none.

    See Also
    --------
    realtime.run_realtime : calls at a fixed rate.
    simulate : the same controller with a simulated plant.

    Examples
    --------
    >>> from pinmobile import Circle, ComputedTorque, MobileRobot, Tangent
    >>> from pinmobile.realtime import Stepper
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> circle = Tangent(Circle(radius=1.0, rate=0.5, duration=4.0))
    >>> law = ComputedTorque(robot, kp=4, kd=4)
    >>> stepper = Stepper(law, robot, dt=0.01, trajectory=circle)
    >>> stepper.step(0.0, [0, 0.1, 0], [0.5, 0, 0.5]) + 0.0  # [N, N, N m]
    array([ 0. , -4.5,  0. ])
    """

    def __init__(
        self,
        controller: Controller,
        plant: Plant,
        *,
        dt: float,
        trajectory: Trajectory | None = None,
        capacity: int = 60_000,
    ) -> None:
        self.controller, self.plant, self.trajectory = controller, plant, trajectory
        self.dt, self.capacity = positive("dt", dt, "s"), check_integer("capacity", capacity)
        context, start, first = self._start()
        loop = Loop(plant, controller, trajectory, (), select_integrator(plant, None), 1)
        self.fallback_reason = ""
        self._law: _MachineCode | _PythonCode
        try:
            self._law = _MachineCode(loop, context, start, first)
        except NotTraceable as error:
            self.fallback_reason = f"not COMPILED: {error.reason}"
            self._law = _PythonCode(loop, context, start, first)
        self.engine = "PYTHON" if self.fallback_reason else "COMPILED"
        schedules = [np.reshape(x, (len(x), -1)) for x in scheduled_rows(loop, context)]
        schedule = np.concatenate([np.zeros((len(context.t), 0)), *schedules], axis=1)
        self._arrays(start, first, schedule)
        self._rows: Any = None
        self._rate, self._end = 1 / self.dt, len(context.t)
        if trajectory is not None:
            rows = np.hstack([*context.reference, schedule])
            rest = rows[-1].copy()
            rest[len(first.q) : len(first.q) + 2 * len(first.v)] = 0.0
            self._rows = np.vstack([rows, rest])
        self.k = self._count = self._length = 0
        self._last: float = _START_TIME

    def _start(self) -> tuple[Any, tuple[Array, Array], Reference]:
        """Return context, initial state and first reference."""
        plant, trajectory = self.plant, self.trajectory
        check_controller(self.controller)
        check_plant(plant)
        try:
            return initial_context(plant, self.controller, self.dt, trajectory)
        except NotTraceable as error:
            raise InvalidArgument(
                f"trajectory is None, but {error.obstacle}: expected its trajectory", "trajectory"
            ) from error

    def _arrays(self, start: tuple[Array, Array], first: Reference, schedule: Array) -> None:
        """Allocate the arguments of a call, and the record."""
        sizes = {"q": len(start[0]), "v": len(start[1]), "t": 1}
        sizes |= {f"reference.{name}": len(x) for name, x in first._asdict().items()}
        sizes |= {"schedule": schedule.shape[1]}
        sizes |= {name: prod(shape) for name, shape in self._law.kept.items()}
        affordable("the record", self.capacity * sum(sizes.values()), "give a smaller capacity")
        ends = np.cumsum([0, *sizes.values()])
        self._row = aligned((int(ends[-1]),))
        self._parts = {name: self._row[i:j] for name, i, j in zip(sizes, ends, ends[1:], strict=False)}
        self._q, self._v, self._t, *self._reference = [*self._parts.values()][:6]
        self._nq, self._nv = len(self._q), len(self._v)
        self._measurement, self._numbers, self._reference_row = (
            self._row[i:j] for i, j in ((0, ends[3]), (0, ends[6]), (ends[3], ends[7]))
        )
        self._parts["schedule"][...] = schedule[0]
        self._u, self._error = self._parts["u"], self._parts["error"]
        self._law.connect(self._row[: ends[7]], self._row[ends[7] :])
        self._record = np.full((self.capacity, len(self._row)), 0.0)  # written, so that no page is missing

    def step(self, t: float, q: ArrayLike, v: ArrayLike, reference: Reference | None = None) -> Array:
        """Return the input of a sample, shape (nu,), within the limits of the plant.

        Parameters
        ----------
        t : float
            Time, after the last sample [s].
        q, v : array_like, shape (nq,), (nv,)
            Measured configuration and velocity.
        reference : Reference, optional
            Reference of the sample; default: the sample of the trajectory nearest to `t`.

        Raises
        ------
        InvalidArgument
            If an argument has another shape, is NaN or infinite, or the time does not increase. The memory
            stays as it was.
        NotFinite
            If the input is NaN or infinite. The sample is not recorded.
        """
        try:
            is_valid = len(q) == self._nq and len(v) == self._nv and self._last < t < inf  # type: ignore[arg-type]
            self._q[...], self._v[...], self._t[0] = q, v, t
            if reference is None:
                row = int(t * self._rate + 0.5)
                self._reference_row[...] = self._rows[row if row < self._end else self._end]
            else:
                is_valid = is_valid and self._set_reference(reference)
            is_valid = is_valid and isfinite(sum(self._measurement.tolist()))
        except (AttributeError, OverflowError, TypeError, ValueError):
            self._refuse(t, q, v, reference)
            raise
        if not is_valid:
            self._refuse(t, q, v, reference)
        self._law(self.k)
        u = self._u.copy()
        if not isfinite(sum(u.tolist())) and not np.isfinite(u).all():
            raise NotFinite(f"controller returned u = {u} at t = {t:g} s, expected finite numbers")
        self._record[self._count % self.capacity] = self._row
        self._count += 1
        self._length += self._length < self.capacity
        self.k += 1
        self._last = t
        return u

    def _set_reference(self, reference: Reference) -> bool:
        """Use a reference for this sample, and return whether it is valid."""
        for target, value in zip(self._reference, reference, strict=True):
            if len(value) != len(target):
                return False
            target[...] = value
        return isfinite(sum(self._numbers.tolist()))

    def _refuse(self, t: float, q: ArrayLike, v: ArrayLike, reference: Reference | None) -> None:
        """Raise the error of the first invalid argument; none is if only their sum is infinite."""
        shaped("t", finite("t", t), ())
        if not t > self._last:
            raise InvalidArgument(
                f"t is {t} s, expected a time >= 0, after the last sample at {max(self._last, 0.0):g} s"
            )
        values: dict[str, Any] = {"q": q, "v": v}
        if self.trajectory is None:
            required("reference", reference, "a Reference: the stepper has no trajectory")
        if reference is not None:
            values |= {f"reference.{x}": stated(reference, x) for x in Reference._fields}
        for name, value in values.items():
            shaped(name, finite(name, value), (len(self._parts[name]),))

    @property
    def largest_error(self) -> float:
        """Largest error of a coordinate or of its rate at the last sample [m, rad, m/s, rad/s, ...]."""
        return float(np.abs(self._error).max())

    def format_largest_error(self) -> str:
        """Return name and value of the largest error at the last sample, such as ``error of x is 0.3 m``."""
        coordinates = coordinates_of(self.plant)[: len(self._error) // 2]
        names = [(one.name, one.unit) for one in coordinates]
        names += [(one.rate or f"{one.name}_rate", f"{one.unit or '1'}/s") for one in coordinates]
        i = int(np.abs(self._error).argmax())
        return f"error of {names[i][0]} is {self._error[i]:.6g} {names[i][1]}".rstrip()

    @property
    def memory(self) -> Any:
        """Memory of the controller between two samples, a copy; set it to continue from there.

        It is an object for a stepper of the same parts. If it is set, the record begins anew.
        """
        return self.k, self._law.memory

    @memory.setter
    def memory(self, value: Any) -> None:
        if not isinstance(value, tuple) or len(value) != 2:
            raise unexpected_value("memory", value, "the memory of a stepper")
        self._law.memory = value[1]
        self.k = check_integer("memory", value[0], least=0)
        self.clear()

    def clear(self) -> None:
        """Remove the recorded samples; the memory of the controller stays."""
        self._count, self._length, self._last = 0, 0, _START_TIME

    def remove_last(self) -> None:
        """Remove the last recorded sample, such as one without effect on the robot; the memory stays."""
        if self._length:
            self._count -= 1
            self._length -= 1

    def __len__(self) -> int:
        return self._length

    def __bool__(self) -> bool:
        return True  # also without samples

    def rollout(self) -> Rollout:
        """Return the recorded samples, at most `capacity`.

        Its acceleration is the mean until the next sample, a difference of velocities; that of the last
        sample is repeated.

        Raises
        ------
        InvalidArgument
            If there is no sample.
        """
        if not self._length:
            raise InvalidArgument("the stepper has no sample yet")
        order = np.arange(self._count - len(self), self._count) % self.capacity
        ends = np.cumsum([len(part) for part in self._parts.values()])[:-1]
        columns = dict(zip(self._parts, np.split(self._record[order], ends, axis=1), strict=True))
        q, v, t = columns["q"], columns["v"], columns["t"][:, 0]
        reference = Reference(*(columns[f"reference.{name}"] for name in Reference._fields))
        a = np.zeros_like(v)
        if len(t) > 1:
            a[:-1] = np.diff(v, axis=0) / np.diff(t)[:, None]
            a[-1] = a[-2]
        signals = collect_time_signals(t, self.controller, self.trajectory)
        for name, unit in self._law.units.items():
            values = columns[name].reshape(len(t), *self._law.kept[name])
            signals[name.removeprefix("signal ")] = Signal(unit, values)
        error, texts = errors_of(self.plant, q, reference), (self.engine, self.fallback_reason)
        return Rollout(self.plant, t, q, v, a, columns["u"], error, reference, signals, *texts)
