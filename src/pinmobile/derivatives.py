"""Derivatives of a closed loop: how a number of a run changes with the numbers of its parts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace as replaced
from typing import Any, NamedTuple, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, callable_as, one_of, positive, scalar, sequence
from pinmobile.compiled import (
    Identity,
    LoopTape,
    Program,
    Shape,
    Target,
    adjoint,
    aligned,
    bits_of_indices,
    robot_keys,
    tangent,
    uncollected,
    without_delays,
)
from pinmobile.controllers import Controller
from pinmobile.errors import InvalidArgument, NotTraceable, shown
from pinmobile.forces import Force
from pinmobile.integrators import Integrator
from pinmobile.loop import (
    Loop,
    Record,
    Sample,
    Trace,
    arrays_of,
    checked_forces,
    checked_loop,
    checked_substeps,
    chosen_integrator,
    initial_memory,
    sample_times,
    sampled,
    scheduled_rows,
    start_of,
    traced_numbers,
)
from pinmobile.parts import Found, OnCoordinates, find, named, option, part, replace
from pinmobile.plant import Context, Plant, coordinates_of
from pinmobile.trajectories import Reference, Trajectory

_DOUBLE = 1e-7  # imaginary part that rounding gives to two equal real poles
_ROUNDING = 1e-12  # relative size of singular values that are 0
_FEW = 8  # numbers that forward mode computes in one rollout of some lanes
_STEP = 1e-3  # relative step of differences of what Python computes before the first sample


@final
@part
class _Loss:
    """Recorder that adds up a function of the samples."""

    function: Any = option(default=None)
    at_end: bool = option(default=False)
    signals, errors = True, True

    def initial_state(self, n: int, nu: int) -> Any:
        """Return the sum of no sample."""
        return np.zeros(())

    def __call__(self, sample: Sample, state: Any) -> Record:
        """Return the sum with one more sample."""
        value = self.function(sample)
        if np.shape(value) != ():
            raise InvalidArgument(f"loss returned {shown(value)}, expected a number")
        return Record(value + 0.0 * state if self.at_end else state + value)


@final
@dataclass(frozen=True)
class Gradient:
    """Value of a loss and its derivatives.

    Attributes
    ----------
    value : float
        Loss.
    by : dict of str to ndarray
        Derivative by each number, by its path, in the shape of the number.
    units : dict of str to str
        Unit of each number.
    mode : str
        ``"forward"`` or ``"reverse"``, and the reason.

    See Also
    --------
    derivatives.gradient : compute a gradient.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.derivatives import Gradient
    >>> by, units = {"kp": np.array(-0.3)}, {"kp": "N/m"}
    >>> print(Gradient(2.0, by, units, "forward mode, 1 number"))
    loss 2, forward mode, 1 number
      by kp: -0.3 per N/m
    """

    value: float
    by: Mapping[str, Array]
    units: Mapping[str, str]
    mode: str

    def __str__(self) -> str:
        lines = [f"loss {self.value:.6g}, {self.mode}"]
        for path, found in self.by.items():
            numbers = ", ".join(f"{x:.6g}" for x in found.ravel())
            per = f" per {self.units[path]}" if self.units[path] else ""
            lines.append(f"  by {path}: {numbers if found.size == 1 else f'({numbers})'}{per}")
        return "\n".join(lines)


class _Inputs(NamedTuple):
    """Inputs of the machine code, which Python computes before the first sample, or their tangents."""

    states: Array
    rows: Array
    uniforms: Array
    samples: Array


class _Problem:
    """Loop with a loss, and the numbers by which it is differentiated."""

    def __init__(self, loop: Loop, t: Array, dt: float, start: Any, by: Sequence[str]) -> None:
        self.loop, self.t, self.dt, self.given = loop, t, dt, start
        known = named(loop)
        self.found: dict[str, Found] = {}
        for name in by:
            one = find(loop, name, known, "by")
            self.found[one.path] = one
        spread = {
            path: np.ones(np.shape(one.leaf.value), bool)
            for path, one in ((each.leaf.path, each) for each in self.found.values())
            if path in traced_numbers(loop)
        }
        reference, context, (q, v) = self._begun(loop)
        begun = initial_memory(loop, context)
        identity = Identity.of(loop, begun[2:], spread, ())
        first = Reference(*(x[0] for x in reference))
        traced = Trace(loop, context, (q, v), first, identity, spread, own_schedules=True).result()
        self.longest = max((ring.samples for ring in traced.rings), default=0)
        self.tape = without_delays(traced)
        self.loss = next((leaf.first for leaf in self.tape.leaves if leaf.owner == "recorder"), -1)

    def _begun(self, loop: Loop) -> tuple[Reference, Context, tuple[Array, Array]]:
        """Return reference, context and initial state of a loop."""
        reference = sampled(loop.trajectory, self.t, loop.plant)
        context = Context.of(
            loop.plant, dt=self.dt, t=self.t, reference=reference, trajectory=loop.trajectory
        )
        q, v = start_of(loop.plant, reference, *self.given)
        q = np.asarray(loop.integrate(q, np.asarray(loop.start, float)), float)
        return reference, context, (q, v + np.asarray(loop.start_rate, float))

    def inputs(self, values: Mapping[str, Any]) -> _Inputs:
        """Return the inputs of the machine code for other numbers, by path."""
        loop, tape = replace(self.loop, values) if values else self.loop, self.tape
        reference, context, start = self._begun(loop)
        states, rows, uniforms = np.zeros(len(tape.states)), np.zeros(tape.rows), np.zeros(tape.uniforms)
        uniforms[0] = self.dt / loop.substeps
        states[: sum(map(len, start))] = np.concatenate(start)
        into = {"state": states, "row": rows, "uniform": uniforms}
        numbers = traced_numbers(loop)
        for path, leaf in tape.parameters.items():
            into[leaf.kind][leaf.first : leaf.first + numbers[path].size] = numbers[path].ravel()
        for leaf, value in zip(tape.leaves, arrays_of(initial_memory(loop, context)), strict=True):
            flat = np.broadcast_to(np.asarray(value, float), leaf.shape).ravel()
            into[leaf.kind][leaf.first : leaf.first + flat.size] = flat
        given = [np.reshape(each, (len(self.t), -1)) for each in scheduled_rows(loop, context)]
        return _Inputs(states, rows, uniforms, np.concatenate([self.t[:, None], *reference, *given], axis=1))

    def directions(self, inputs: _Inputs) -> Iterator[tuple[str, tuple[int, ...], _Inputs]]:
        """Yield path, entry and tangent of the inputs for each number.

        A number of the law has the slope 1. Other inputs that depend on a number in Python, such as the
        reference, are differentiated by central differences and Richardson's extrapolation.
        """
        zeros = _Inputs(*map(np.zeros_like, inputs))
        for path, one in self.found.items():
            value, leaf = np.asarray(one.leaf.value, float), self.tape.parameters.get(one.leaf.path)
            entries = [one.place(value.ndim)] if one.entry is not None else [*np.ndindex(value.shape)]
            for entry in entries:
                step = _STEP * max(1.0, abs(float(value[entry])))

                def moved(by: float, value: Array = value, entry: Any = entry, one: Found = one) -> _Inputs:
                    changed = np.array(value)
                    changed[entry] += by
                    return self.inputs({one.leaf.path: changed if changed.ndim else float(changed)})

                ahead = moved(step)
                if leaf is not None:
                    row = leaf.first + int(np.arange(value.size).reshape(value.shape)[entry])
                    ahead.rows[row] = inputs.rows[row]  # its own effect is known
                if all(map(np.array_equal, ahead, inputs)):
                    slopes = zeros._replace(rows=zeros.rows.copy())
                else:
                    points = zip(*(moved(step * x) for x in (0.5, -0.5, 1.0, -1.0)), strict=True)
                    slopes = _Inputs(*((8 * (a - b) - (c - d)) / (6 * step) for a, b, c, d in points))
                if leaf is not None:
                    slopes.rows[row] = 1.0
                yield path, entry, slopes

    def run(
        self,
        tape: LoopTape,
        inputs: _Inputs,
        states: Array,
        rows: Array,
        tracks: Array | None,
        extra: Any = (),
        first: int = 0,
    ) -> tuple[Array, dict[str, Array]]:
        """Return the states after the last sample, shape (states, n), and the kept values.

        Parameters
        ----------
        states, rows : ndarray, shape (states, n), (rows, n)
            Initial states and rows.
        tracks : ndarray, shape (N + 1, tracks, n), optional
            References of each robot.
        extra : sequence of ndarray, shape (N + 1,)
            Further columns of the samples.
        first : int
            Index of the first sample.
        """
        n, (_, _, uniforms, samples) = states.shape[1], inputs
        lanes = 1 if n == 1 else Target.here().lanes
        program = Program(tape, shape=Shape(lanes, 1))
        blocks = aligned((-(-n // lanes), len(tape.states) + tape.rows + len(tape.keys), lanes))
        keys = [robot_keys(0, name, range(1)).view(np.float64) for name in tape.keys]
        program.set_rows(blocks, 0, np.concatenate([states, rows, *(np.tile(key, (1, n)) for key in keys)]))
        kept = aligned((len(blocks), len(samples), tape.outputs_kept + tape.tracks, lanes))
        for k in range(len(samples) if tracks is not None else 0):
            program.set_rows(kept[:, k], tape.outputs_kept, tracks[k])  # type: ignore[index]
        nothing = np.empty((len(samples), 0))
        columns = [samples[:, 1:], *(np.reshape(each, (len(samples), 1)) for each in extra)]
        given = program.samples_of(samples[:, 0], (nothing,) * 3, uniforms, columns, first)
        program.called(blocks, given, uniforms, kept, n, 1, threads=1, first=first)
        final = blocks.swapaxes(0, 1)[: len(tape.states)].reshape(len(tape.states), -1)[:, :n]
        return final, program.kept_samples(kept, n)

    def forward(self, inputs: _Inputs, directions: Sequence[_Inputs]) -> tuple[float, Array]:
        """Return the loss and its derivatives along directions, in one run of the tangents."""
        tape, n = self.tape, len(self.tape.states)
        moved = [np.stack(some, axis=-1) for some in zip(*directions, strict=True)]
        operations = [("row", i) for i in np.flatnonzero(moved[1].any(axis=-1)).tolist()]
        operations += [("uniform", i) for i in np.flatnonzero(moved[2].any(axis=-1)).tolist()]
        columns = np.flatnonzero(moved[3].any(axis=(0, 2))).tolist()
        whole = tangent(tape, [*operations, *(("sample", i) for i in columns)])
        slopes = [moved[1 if kind == "row" else 2][i] for kind, i in operations]
        count = len(directions)
        states = np.concatenate([np.tile(inputs.states[:, None], count), moved[0]])
        rows = np.concatenate([np.tile(inputs.rows[:, None], count), np.reshape(slopes, (-1, count))])
        tracks = moved[3][:, columns] if columns else None
        final, _ = self.run(whole, inputs, states, rows, tracks)
        return float(final[self.loss, 0]), final[n + self.loss]

    def record(self, inputs: _Inputs) -> tuple[Array, Array]:
        """Return the states after the last sample, shape (n, 1), and of all samples, shape (N + 1, n)."""
        nodes = [now for now, _ in self.tape.states]
        tape = replaced(self.tape, kept={"state": ((len(nodes),), nodes)}, counted=[])
        final, kept = self.run(tape, inputs, inputs.states[:, None], inputs.rows[:, None], None)
        return final, kept["state"][0]

    def jacobian(self, inputs: _Inputs, k: int) -> Array:
        """Return the derivatives of the state at sample k + 1 by the state at sample k, shape (n, n)."""
        n, samples = len(self.tape.states), inputs.samples
        _, recorded = self.record(inputs._replace(samples=samples[: k + 1]))
        states = np.concatenate([np.tile(recorded[k][:, None], n), np.eye(n)])
        rows = np.tile(inputs.rows[:, None], n)
        one = inputs._replace(samples=samples[k : k + 1])
        final, _ = self.run(replaced(tangent(self.tape, []), kept={}), one, states, rows, None, first=k)
        return final[n:]

    def names(self) -> tuple[str, ...]:
        """Return the names of the states."""
        named_by = [one.name for one in coordinates_of(self.loop.plant)]
        nq, nv = self.tape.sizes[:2]
        found = named_by if nq == nv else [f"q[{i}]" for i in range(nq)]
        found += [one.rate or f"{one.name}_rate" for one in coordinates_of(self.loop.plant)]
        for leaf in self.tape.leaves:
            if leaf.kind == "state":
                found += [f"{leaf.owner} {leaf.path}"] * int(np.prod(leaf.shape))
        return (*found, *["delay"] * (len(self.tape.states) - len(found)))

    def reverse(self, inputs: _Inputs, directions: Sequence[_Inputs]) -> tuple[float, Array]:
        """Return the loss and its derivatives along directions, by a record and a run of the adjoints."""
        tape, n = self.tape, len(self.tape.states)
        states, rows, uniforms, samples = inputs
        wanted = [("row", i) for i in range(len(rows))] + [("uniform", i) for i in range(len(uniforms))]
        final, recorded = self.record(inputs)
        back = adjoint(tape, wanted, samples.shape[1])
        seed = np.zeros((n + len(wanted), 1))
        seed[self.loss] = 1.0
        turned = _Inputs(states, rows, uniforms, samples[::-1])
        tracks = recorded[::-1, :, None]
        found, by_sample = self.run(
            back, turned, seed, rows[:, None], tracks, [bits_of_indices(len(samples))]
        )
        slopes = (
            found[:n, 0],
            found[n : n + len(rows), 0],
            found[n + len(rows) :, 0],
            by_sample["sample"][0][::-1],
        )
        sums = [
            sum(float(np.vdot(a, b)) for a, b in zip(slopes, one, strict=True) if b.any())
            for one in directions
        ]
        return float(final[self.loss, 0]), np.array(sums)


@final
@dataclass(frozen=True, eq=False)
class Poles:
    """Poles of a sampled closed loop near one sample.

    Attributes
    ----------
    values : ndarray of complex, shape (n,)
        Eigenvalues z of the matrix, the largest first.
    matrix : ndarray, shape (n, n)
        Derivatives of the state after a sample by the state before it: plant, memory and delays.
    states : tuple of str
        Name of each state.
    dt, t : float
        Time step, and time of the sample [s].

    See Also
    --------
    derivatives.poles : linearize a loop.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.derivatives import Poles
    >>> values, matrix = np.array([0.9 + 0j]), np.array([[0.9]])
    >>> found = Poles(values, matrix, ("x",), dt=0.1, t=0.0)
    >>> found.frequency, found.damping  # [rad/s], [1]
    (array([1.05...]), array([1.]))
    """

    values: Any
    matrix: Array
    states: tuple[str, ...]
    dt: float
    t: float

    @property
    def continuous(self) -> Any:
        """Poles s = log(z) / dt, shape (n,) [1/s]; those of delays, z = 0, are minus infinity."""
        with np.errstate(divide="ignore"):
            size = np.log(np.abs(self.values))
        angle = np.where(np.isfinite(size), np.angle(self.values), 0.0)
        return size / self.dt + 1j * (angle / self.dt)

    @property
    def frequency(self) -> Array:
        """Natural frequency of each pole, shape (n,) [rad/s]."""
        return np.asarray(np.abs(self.continuous))

    @property
    def damping(self) -> Array:
        """Damping ratio of each pole, shape (n,): 1 if it is real and stable, below 0 if it is unstable."""
        s = self.continuous
        size = np.abs(s)
        known = np.isfinite(size) & (size > 0)
        return np.asarray(np.divide(-s.real, size, out=np.ones_like(size), where=known))

    def __str__(self) -> str:
        size = float(np.abs(self.values).max())
        word = "grow" if size > 1 + 1e-9 else "do not decay" if size > 1 - 1e-9 else "decay"
        dead = np.count_nonzero(self.values == 0)
        lines = [
            f"{len(self.values)} poles at t = {self.t:g} s, {dead} of them at 0, "
            f"largest |z| = {size:.4f}: small deviations {word} near this sample, which proves "
            "nothing about a whole trajectory"
        ]
        for z, w, d in zip(self.values, self.frequency, self.damping, strict=True):
            if z and z.imag >= 0:
                pair = " +- " if z.imag > 0 else "    "
                lines.append(f"  z = {z.real:7.4f}{pair}{z.imag:.4f}j, {w:8.3f} rad/s, damping {d:6.3f}")
        return "\n".join(lines)


def gradient(
    loss: Callable[[Sample], Any],
    plant: Plant,
    controller: Controller,
    trajectory: Trajectory,
    *,
    by: Sequence[str],
    dt: float,
    duration: float | None = None,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    integrator: Integrator | None = None,
    substeps: int = 1,
    forces: Sequence[Force | OnCoordinates] | Mapping[str, Force | OnCoordinates] = (),
    at_end: bool = False,
    mode: str | None = None,
) -> Gradient:
    """Return a loss of a run and its derivatives by numbers of the parts.

    The derivatives are exact up to rounding: the loop on its tape is differentiated, not the numbers of runs.
    Forward mode carries a tangent for each number; reverse mode runs the adjoints backwards, for all numbers
    at once. Rounding and comparisons have slope 0. At a kink, such as that of dry friction or of a limit, the
    derivative is that of one side: derivatives of laws with many kinks, such as sliding modes, say little.
    Plants with dry friction at their wheels (`Coulomb`) are refused.

    Parameters
    ----------
    loss : callable
        Function ``loss(sample)`` in NumPy that returns a number; the loss is its sum over the samples, see
        `loop.Sample`.
    plant, controller, trajectory, dt, duration, q0, v0, integrator, substeps, forces
        Closed loop, see `simulate`.
    by : sequence of str
        Numbers by path, such as ``"controller.kp"``, ``"mass"``, ``"trajectory.path.radius"`` or
        ``"start.x"``.
    at_end : bool
        Whether the loss is the function of the last sample.
    mode : str, optional
        ``"forward"`` or ``"reverse"``; default: reverse for more than 8 numbers.

    Returns
    -------
    Gradient
        Value and derivatives.

    Raises
    ------
    InvalidArgument
        If an argument is invalid, the loop cannot be compiled, its plant has dry friction at its wheels, or
        reverse mode is given for a loop with rounds, such as motors driven by voltages.

    See Also
    --------
    ensemble : effects of numbers on the results of many robots.

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Tangent
    >>> from pinmobile.derivatives import gradient
    >>> circle = Tangent(Circle(1.0, 0.5, 4.0))
    >>> parts = MobileRobot(30.0, 1.3), PD(120, 120), circle
    >>> def loss(sample):
    ...     return (sample.error[:2] ** 2).sum()
    >>> by = ["mass", "trajectory.path.radius"]
    >>> print(gradient(loss, *parts, by=by, dt=0.01))
    loss 0.955341, forward mode, 2 numbers
      by plant.mass: 0.0653035 per kg
      by trajectory.path.radius: 1.91068 per m
    """
    callable_as("loss(sample)", loss, "a function of a sample")
    names = sequence("by", by, 'paths of numbers, such as ["controller.kp"]')
    if not names:
        raise InvalidArgument("by is empty, expected paths of numbers")
    if mode is not None:
        one_of("mode", mode, ("forward", "reverse"))
    options: dict[str, Any] = {"dt": dt, "forces": forces, "integrator": integrator, "substeps": substeps}
    parts = plant, controller, trajectory, _Loss(loss, at_end)
    loop, t, step = _loop_of(*parts, duration=duration, **options)
    try:
        with uncollected(), np.errstate(all="ignore"):
            problem = _Problem(loop, t, step, (q0, v0), names)
            inputs = problem.inputs({})
            numbers = [*problem.directions(inputs)]
            has_rounds = any(operation[0] == "repeat" for operation in problem.tape.tape.operations)
            selected = mode or ("forward" if has_rounds or len(numbers) <= _FEW else "reverse")
            run = problem.forward if selected == "forward" else problem.reverse
            value, slopes = run(inputs, [one for _, _, one in numbers])
    except NotTraceable as error:
        raise InvalidArgument(f"this loop has no derivative: {error.reason}") from error
    found: dict[str, Array] = {}
    for (path, entry, _), slope in zip(numbers, slopes, strict=True):
        one = problem.found[path]
        if one.entry is not None:
            found[path] = np.array(slope)
            continue
        found.setdefault(path, np.zeros(np.shape(one.leaf.value)))[entry] = slope
    units = {path: one.unit for path, one in problem.found.items()}
    reason = "loop with rounds" if has_rounds else f"{len(numbers)} numbers"
    return Gradient(value, found, units, f"{selected} mode, {reason if mode is None else 'as given'}")


def _loop_of(
    plant: Plant, controller: Controller, trajectory: Trajectory, recorder: Any = None, **options: Any
) -> tuple[Loop, Array, float]:
    """Return a loop of checked parts, the times of its samples and its time step."""
    step, integrator = positive("dt", options["dt"], "s"), options["integrator"]
    chosen = chosen_integrator(plant, integrator)
    checked_loop(plant, controller, trajectory, chosen)
    t = sample_times(step, options.get("duration"), trajectory.duration)
    parts = plant, controller, trajectory, checked_forces(options["forces"], plant), chosen
    count = checked_substeps(options["substeps"], len(t))
    return Loop(*parts, count, recorder=recorder), t, step


def poles(
    plant: Plant,
    controller: Controller,
    trajectory: Trajectory,
    *,
    dt: float,
    at: float = 0.0,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    integrator: Integrator | None = None,
    substeps: int = 1,
    forces: Sequence[Force | OnCoordinates] | Mapping[str, Force | OnCoordinates] = (),
) -> Poles:
    """Return the poles of a sampled closed loop at a sample of its run.

    The loop with all its memory, delays and holds is linearized, exactly up to rounding. Eigenvalues inside
    the unit circle mean that small deviations decay if the loop stays at this sample, such as at rest or on
    a steady motion. Along a trajectory on which the matrix changes, they prove nothing about stability.

    Parameters
    ----------
    plant, controller, trajectory, dt, q0, v0, integrator, substeps, forces
        Closed loop, see `simulate`.
    at : float
        Time of the sample [s]; the first sample counts as the second one, after which delays are full.

    Returns
    -------
    Poles
        Eigenvalues, matrix, frequencies and damping ratios.

    Raises
    ------
    InvalidArgument
        If an argument is invalid, the loop cannot be compiled, or its plant has dry friction at its wheels.

    See Also
    --------
    derivatives.gradient : derivatives of a whole run.

    Examples
    --------
    >>> from pinmobile import PD, FixedHeading, Hold, MobileRobot
    >>> from pinmobile.derivatives import poles
    >>> rest = FixedHeading(Hold((0, 0), 1.0), 0.0)
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> found = poles(robot, PD(120, (120, 120, 10)), rest, dt=0.05)
    >>> found.values.size
    6
    >>> f"{abs(found.values).max():.3f}"
    '0.920'
    """
    options: dict[str, Any] = {"dt": dt, "forces": forces, "integrator": integrator, "substeps": substeps}
    loop, t, step = _loop_of(plant, controller, trajectory, **options)
    if not 0 <= scalar("at", at) <= t[-1]:
        raise InvalidArgument(f"at is {at} s, expected a time in the run, 0 to {t[-1]:g} s")
    k = min(max(1, round(at / step)), len(t) - 1)
    try:
        with uncollected(), np.errstate(all="ignore"):
            problem = _Problem(loop, t, step, (q0, v0), ())
            matrix = problem.jacobian(problem.inputs({}), k)
    except NotTraceable as error:
        raise InvalidArgument(f"this loop has no derivative: {error.reason}") from error
    # Chains of delays have poles 0, which rounding scatters: leave them out by the range of a power.
    power = np.linalg.matrix_power(matrix, 1 + problem.longest)
    left, sizes, _ = np.linalg.svd(power)
    basis = left[:, sizes > _ROUNDING * sizes[0]]
    values = np.zeros(len(matrix), complex)
    values[: basis.shape[1]] = np.linalg.eigvals(basis.T @ matrix @ basis)
    values.imag[np.abs(values.imag) < _DOUBLE] = 0.0
    order = np.lexsort([-values.imag, -np.round(np.abs(values), 6)])
    return Poles(values[order], matrix, problem.names(), step, float(t[k]))
