"""`identify` with `by`: numbers of any plant, from simulations of segments of its logs and their tangents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace as replaced
from functools import cached_property, lru_cache
from typing import Any, ClassVar, final

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, bounded, scalar, sequence
from pinmobile.compiled import (
    COUNT,
    Copy,
    Identity,
    Leaf,
    LoopTape,
    Program,
    Shape,
    Target,
    processors,
    tangent,
)
from pinmobile.errors import InvalidArgument, unexpected_value
from pinmobile.identification._estimates import Identification, format_directions
from pinmobile.identification._estimator import (
    LEAST_RESIDUAL,
    NORMAL,
    Fit,
    Linear,
    Whiteness,
    find_inliers,
    jackknife,
    r_squared,
    solve,
)
from pinmobile.identification._log import Log, continuous
from pinmobile.identification._simulation import PhysicalNumbers, Quantity, Same, Segments, simulate
from pinmobile.identification._velocity import TRAINING
from pinmobile.integrators import RungeKuttaNystrom
from pinmobile.loop import Loop, Trace, arrays_of, initial_memory, traced_numbers
from pinmobile.parts import NumberRef, Stepping, match_refs, named, numbers, offers, part, replace, shorten
from pinmobile.plant import Context, Plant, coordinates_of, stated
from pinmobile.trajectories import Reference

_LONGEST, _SEGMENTS, _SHORTEST = 1.0, 20, 10  # [s] of a segment; segments of a log; samples of a segment
_LONGEST_STEP = 5e-3  # [s] of the integrator
_MIN_EXPLAINED = 0.5  # smallest explained share of the accelerated motion in segments
_CUBIC_ROWS = 7  # samples of the cubic that gives first velocities
_ROUNDS = 3  # largest number of rounds without outliers
_SIZE = 0.02  # smallest typical size of a number: of a centre of mass [m]
_PRECISE = 10.0  # largest standard deviation of an identified direction, as a share of its size
_WHITENESS = 2.5  # multiple of the bound of white residuals that noise of the inputs may reach
_LEAST_NOISE = 1e-6  # of a sensor, as a share of its standard deviation
_midpoint = RungeKuttaNystrom("midpoint", (0.0, 0.5), ((), (0.125,)), ((), (0.5,)), (0.0, 0.5), (0.0, 1.0))


@final
@part
class _LoggedInputs:
    """Controller that applies the inputs of a log, which are the positions of its reference."""

    def initial_state(self, context: Context) -> Any:
        """Return no memory."""
        return ()

    def __call__(self, t: Any, q: Any, v: Any, reference: Reference, state: Any) -> tuple[Any, Any]:
        """Return the inputs of the sample."""
        return reference.q, state


@lru_cache(16)
def _programs(
    same: Same, dt: float, rows: tuple[tuple[str, int], ...], columns: tuple[int, ...]
) -> tuple[LoopTape, Program, Program]:
    """Return a plant's loop on a tape, its program, and the program of its tangents by numbers by path."""
    loop, spread, context, start, first = same.value
    identity = Identity.of(loop, initial_memory(loop, context)[2:], spread, ())
    loop_tape = Trace(loop, context, start, first, identity, spread, own_reference=True).result()
    # No sample is the first one: also the velocities at the start of a segment obey constraints.
    full = Copy(loop_tape, {COUNT: lambda tape: tape.const(1, "u")}).loop(loop_tape)
    nodes = [full.states[k][0] for k in columns]
    states = replaced(full, kept={"x": ((len(nodes),), nodes)}, counted=[])
    derivative, programs = tangent(states, [("row", full.parameters[path].first + i) for path, i in rows]), []
    for tape in (states, derivative):
        kinds = ("row", tape.rows, 0), ("uniform", tape.uniforms - 1, 1)
        leaves = {kind: Leaf("", kind, (size,), begin, kind) for kind, size, begin in kinds}
        changes: dict[str, Any] = {"kept": dict([[*tape.kept.items()][-1]]), "tracks": full.tracks}
        changes |= {"sizes": (len(tape.states), 0, *full.sizes[2:]), "leaves": [], "parameters": leaves}
        programs.append(Program(replaced(tape, **changes), shape=Shape(Target.host().lanes, 1)))
    return loop_tape, programs[0], programs[1]


@dataclass(frozen=True, eq=False)
class PlantProblem(PhysicalNumbers):
    """Unknown numbers of a plant: steps along some directions.

    Parameters
    ----------
    plant : plant
        Prior plant.
    unknowns : tuple of NumberRef
        The unknown numbers.
    base : ndarray, shape (k,)
        Numbers at zero steps.
    basis : ndarray, shape (k, d)
        Directions with typical sizes.
    dt, delay : float
        Time step [s], and delay of the measurements [samples].
    columns_of_state : tuple of int
        Measured entries of the state (q, v).
    """

    plant: Any
    unknowns: tuple[NumberRef, ...]
    base: Array
    basis: Array
    dt: float
    delay: int
    columns_of_state: tuple[int, ...]

    summary_size: ClassVar[int] = 4
    columns: ClassVar[slice] = slice(None)
    delay_index: ClassVar[int | None] = None

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """The unknown numbers, with the shortest different ends of their paths."""
        items = []
        for x, name in zip(self.unknowns, shorten(x.path for x in self.unknowns), strict=True):
            declaration: Any = x.leaf.declared
            nonnegative = declaration.above == 0.0 or declaration.lower == 0.0
            items.append(Quantity(name, x.unit, nonnegative, x.path))
        return tuple(items)

    @property
    def measured(self) -> tuple[tuple[str, str], ...]:
        """Names and units of the measurements."""
        axes = coordinates_of(self.plant)
        rows = [(axis.name, axis.unit) for axis in axes]
        rows += [(axis.rate or f"{axis.name}_rate", f"{axis.unit}/s") for axis in axes]
        return tuple(rows[k] for k in self.columns_of_state)

    def values(self, p: Array) -> Array:
        """Return the numbers, shape (..., k), of steps (..., d)."""
        return np.asarray(self.base + p @ self.basis.T)

    def make_plant(self, values: Array) -> Any:
        """Return the plant with other numbers."""
        leaves = numbers(self.plant)
        changes = {item.leaf.path: np.array(leaves[item.leaf.path].value, float) for item in self.unknowns}
        for item, value in zip(self.unknowns, values, strict=True):
            array = changes[item.leaf.path]
            array[item.place(array.ndim)] = value
        return replace(self.plant, {path: x if x.ndim else float(x) for path, x in changes.items()})

    def sizes(self, p: Array) -> Array:
        """Return the sizes of the steps, shape (d,)."""
        return np.ones(len(p))

    def is_possible(self, p: Array) -> bool:
        """Return whether the plant can have the numbers."""
        return bool(self.are_possible(self.values(p)))

    def are_possible(self, values: Array) -> Any:
        """Return which numbers, shape (..., k), a plant can have; losses may be below zero, as estimates."""
        bounds = [stated(item.leaf.declared, "above") for item in self.unknowns]
        return (values > [-np.inf if bound is None else bound for bound in bounds]).all(axis=-1)

    @cached_property
    def _code(self) -> tuple[dict[str, Array], list[int], tuple[Program, Program]]:
        """Return the inputs of the machine code by kind, the rows of the numbers, and both programs."""
        plant, steps = self.plant, int(np.ceil(self.dt / _LONGEST_STEP - 1e-9))
        loop = Loop(
            plant, _LoggedInputs(), integrator=None if offers(plant, Stepping) else _midpoint, substeps=steps
        )
        reference = Reference(np.zeros((2, plant.nu)), np.zeros((2, 0)), np.zeros((2, 0)))
        context = Context.of(plant, dt=self.dt, t=np.array([0.0, self.dt]), reference=reference)
        start, first = (np.zeros(plant.nq), np.zeros(plant.nv)), Reference(*(x[0] for x in reference))
        spread = {f"plant.{z.leaf.path}": np.ones(np.shape(z.leaf.value), bool) for z in self.unknowns}
        memory, shapes = initial_memory(loop, context), [np.shape(z.leaf.value) for z in self.unknowns]
        places = [z.place(len(shape)) for z, shape in zip(self.unknowns, shapes, strict=True)]
        indices = [int(np.ravel_multi_index(x, n)) if n else 0 for x, n in zip(places, shapes, strict=True)]
        rows = tuple((f"plant.{z.leaf.path}", k) for z, k in zip(self.unknowns, indices, strict=True))
        key = Identity.of(loop, memory[2:], spread, steps).key
        tape, *programs = _programs(
            Same((loop, spread, context, start, first), key), self.dt, rows, self.columns_of_state
        )
        counts = {"row": tape.rows, "uniform": tape.uniforms, "state": len(tape.states)}
        into = {kind: np.zeros(count) for kind, count in counts.items()}
        into["uniform"][0], numbers = self.dt / steps, traced_numbers(loop)
        given = [(leaf, numbers[path]) for path, leaf in tape.parameters.items()]
        for leaf, value in (*given, *zip(tape.leaves, arrays_of(memory), strict=True)):
            flat = np.broadcast_to(np.asarray(value, float), leaf.shape).ravel()
            into[leaf.kind][leaf.first : leaf.first + flat.size] = flat
        return into, [tape.parameters[path].first + i for path, i in rows], (programs[0], programs[1])

    def _run(self, segments: Segments, p: Array, starts: Array, directions: Array | None = None) -> Array:
        """Return the states of the samples, shape (N, L, n), or their slopes by numbers and start."""
        into, places, programs = self._code
        nu, n = self.plant.nu, starts.shape[-1]
        V, S = starts.shape[:2]
        N, L, states = V * S, segments.y.shape[1], np.tile(into["state"], (V * S, 1))
        row = np.tile(into["row"], (N, 1))
        row[:, places] = np.repeat(self.values(p), S, axis=0)
        states[:, :n] = starts.reshape(N, n)
        u = np.tile(segments.applied(self.delay, L)[0], (V, 1, 1))
        program = programs[directions is not None]
        if directions is not None:
            count = len(directions)
            tangents = np.zeros((count, len(into["state"])))
            tangents[:, :n] = directions[:, len(places) :]
            states = np.hstack([np.tile(states, (count, 1)), np.repeat(tangents, N, axis=0)])
            row = np.hstack([np.tile(row, (count, 1)), np.repeat(directions[:, : len(places)], N, axis=0)])
            u = np.tile(u, (count, 1, 1))
        empty, slopes_u = np.zeros((L, 0)), np.zeros((L, len(u), 0))
        outcome = program.run(
            (states, np.zeros((len(states), 0))),
            np.asarray(self.dt * np.arange(L)),
            (np.zeros((L, nu)), empty, empty),
            h=into["uniform"][0],
            values={"row": row, "uniform": into["uniform"][1:]},
            first=(),
            tracks=(np.moveaxis(u, 1, 0), slopes_u, slopes_u),
            threads=processors(),
        )
        (answer,) = outcome.kept.values()
        return np.asarray(answer)

    def simulate(self, segments: Segments, p: Array, starts: Array) -> Array:
        """Return simulated measurements, see `simulate`."""
        states = self._run(segments, p, starts)
        return states.reshape(*starts.shape[:2], *states.shape[1:])

    def linearize(
        self, segments: Segments, p: Array, starts: Array, numbers: NDArray[np.int_]
    ) -> tuple[Array, Array]:
        """Return simulated measurements and their slopes, see `linearize`."""
        states, n, k = self.simulate(segments, p[None], starts[None])[0], starts.shape[1], len(self.base)
        directions = np.zeros((len(numbers) + n, k + n))
        directions[: len(numbers), :k] = self.basis.T[numbers]
        directions[len(numbers) :, k:] = np.eye(n)
        slopes = self._run(segments, p[None], starts[None], directions)
        return states, np.nan_to_num(slopes.reshape(len(directions), len(starts), *slopes.shape[1:]))

    def plausible(self, p: Array, covariance: Array) -> Array:
        """Return the nearest numbers within the declared bounds."""
        lower, upper = ([stated(z.leaf.declared, name) for z in self.unknowns] for name in ("lower", "upper"))
        low, high = ([x if b is None else b for x, b in zip(p, each, strict=True)] for each in (lower, upper))
        return np.asarray(np.clip(p, low, high))

    def robot(self, estimates: Identification) -> Any:
        """Return the plant with the identified numbers."""
        return self.make_plant(estimates.plausible)

    def notes(self, estimates: Identification) -> list[str]:
        """Return no notes."""
        return []

    def predicted(
        self, estimates: Identification, log: Log, seconds: float | None
    ) -> tuple[Segments, Array, NDArray[np.bool_], Array]:
        """Return segments of a log, residuals, mask of good samples, and the noise of the sensors."""
        fixed: Any = replaced(self, base=estimates.phi, basis=np.zeros((len(self.base), 0)))
        segments = _segments([log], fixed, estimates.seconds if seconds is None else seconds)
        return segments, solve(fixed, segments, np.zeros(0)).linear.residual, segments.good, segments.noise[0]


def _numbers_of(plant: Any, patterns: Any) -> tuple[NumberRef, ...]:
    """Return the numbers that names or patterns mean; an array means its entries."""
    leaves, numbers = named(plant), dict[str, NumberRef]()
    given = [patterns] if isinstance(patterns, str) else patterns
    for name in sequence("by", given, "names of numbers, such as '*_link.mass'"):
        for item in match_refs(plant, name, leaves, "by"):
            entries = [NumberRef(item.leaf, *each) for each in item.leaf.entries.items()]
            for each in entries if item.entry is None and np.ndim(item.leaf.value) else [item]:
                numbers[each.path] = each
    return tuple(numbers.values())


def _segments(logs: Sequence[Log], problem: PlantProblem, seconds: float) -> Segments:
    """Return the segments of logs with measurements of the plant's coordinates."""
    from scipy.signal import savgol_filter  # slow to load

    parts, plant, nq = [], problem.plant, problem.plant.nq
    for log in logs:
        names = _sensors(log, plant)
        for piece in continuous(log, "log", *names):
            run = piece.samples(*names, dt=problem.dt)
            y = np.concatenate([getattr(run, name) for name in names], axis=1)
            states = np.zeros((len(y), nq + plant.nv))
            states[:, list(problem.columns_of_state)] = y
            of_q = [k for k in problem.columns_of_state if k < nq]
            width = min(_CUBIC_ROWS, len(y) - (len(y) + 1) % 2)
            smooth = [savgol_filter(states[:, of_q], width, 3, deriv=k, delta=run.dt, axis=0) for k in (0, 1)]
            states[:, of_q], states[:, [nq + k for k in of_q]] = smooth
            noise = NORMAL * np.median(np.abs(np.diff(y, 4, axis=0)), axis=0) / np.sqrt(70.0)  # 1+16+36+16+1
            noise = np.maximum(noise, _LEAST_NOISE * y.std(axis=0) + np.finfo(float).tiny)
            span = 0, len(y), round(seconds / run.dt), problem.delay, 0
            parts.append(Segments.cut(run.dt, (y, run.is_valid, states, run.u, noise), span, 0.0, 0.5))
    joint = Segments.join(parts)
    if len(joint.y) < _SEGMENTS // 2:
        raise InvalidArgument(
            f"log has {len(joint.y)} segments of {seconds:g} s, expected at least {_SEGMENTS // 2}: "
            f"{_SEGMENTS // 2 * seconds:g} s, or {_SEGMENTS * seconds:g} s for reliable intervals"
        )
    return joint._replace(noise=np.tile(np.median(joint.noise, axis=0), (len(joint.y), 1)))


def _sensors(log: Log, plant: Any) -> list[str]:
    """Return the names of the measurements of a log that the fit uses."""
    names = ["q"] * (log.q is not None) + ["joints"] * (log.joints is not None)
    names += ["wheel_rates"] * (log.wheel_rates is not None and log.joints is None)
    count = 0 if log.joints is None else log.joints.shape[1]
    is_needed = log.joints is not None or any("/" in axis.name for axis in coordinates_of(plant))
    if is_needed and count != plant.nq - 3:
        raise InvalidArgument(
            f"log has {count} joints, expected {plant.nq - 3}: all coordinates behind the pose"
        )
    return names


def identify_plant(logs: Sequence[Log], plant: Any, patterns: Any, delay: float | None) -> Identification:
    """Return the estimates of numbers of a plant from logs, see `identify`."""
    if not offers(plant, Plant):
        expected = "a plant with the numbers of by: add it, such as robot=MobileRobot(30, 1.3)"
        raise unexpected_value("robot", plant, expected)
    unknowns, dt = _numbers_of(plant, patterns), max(log.dt for log in logs)
    base = np.array([float(item.value) for item in unknowns])
    sizes = np.maximum(np.abs(base), [max(np.abs(np.asarray(x.leaf.value)).max(), _SIZE) for x in unknowns])
    lag = 0 if delay is None else round(bounded("delay", scalar("delay", delay), least=0, unit="s") / dt)
    names, nq = _sensors(logs[0], plant), plant.nq
    columns = [*range(3)] * ("q" in names) + [*range(3, nq)] * ("joints" in names)
    if "wheel_rates" in names:
        axes = [item.name for item in coordinates_of(plant)]
        columns += [nq + axes.index(item.name) for item in plant.inputs if item.name in axes]
    first: Any = PlantProblem(plant, unknowns, base, np.diag(sizes), dt, lag, tuple(columns))
    span = sum(float(log.t[-1] - log.t[0]) for log in logs)
    seconds = max(min(_LONGEST, span / (_SEGMENTS + 0.5)), _SHORTEST * dt)
    segments = _segments(logs, first, seconds)
    white = lambda residuals, _: residuals  # noqa: E731
    linear = Linear.of(first, segments, 0 * base, segments.start, white)
    rank_space, null = _directions(linear)
    if not rank_space.size:
        raise InvalidArgument(
            "log identifies none of the numbers of by, expected a motion in which they matter"
        )
    problem = replaced(first, basis=sizes[:, None] * rank_space)
    fit = _fit_inliers(problem, segments, segments.start + linear.starts(0 * base))
    left = np.where(fit.good[..., None], fit.linear.residual, 0.0)
    motion = segments.y - segments.y[:, :1]
    line = np.linalg.qr(np.vander(np.arange(left.shape[1]), 2))[0]  # what initial states explain
    curved = segments.y - line @ (line.T @ segments.y)
    share = 1 - float((segments.weigh(left) ** 2).sum() / (segments.weigh(curved) ** 2).sum())
    if share < _MIN_EXPLAINED:
        raise InvalidArgument(
            f"the given robot explains {max(share, 0.0):.0%} of the motion over {seconds:.3g} s, "
            "expected most of it: name more wrong numbers in by, or correct sign, unit or order of inputs"
        )
    covariance, blocks = jackknife(fit.linear)
    whiteness = Whiteness.of(segments.weigh(left), fit.good, LEAST_RESIDUAL)
    states = int(fit.linear.start_change.any(axis=(0, 2)).sum()) * len(left)
    count = max(1, int(fit.good.sum()) * left.shape[-1] - rank_space.shape[1] - states)
    train = np.arange(len(left)) < TRAINING * len(left)
    test = segments.select(~train)
    p = fit.p + fit.linear.step(train[:, None] & np.ones(fit.linear.normal.shape[1], bool))
    errors = test.y - simulate(problem, test, p[None], fit.starts[None, ~train])[0]
    runs = [
        r_squared(x[good], e[good])
        for x, e, good in ((motion, left, fit.good), (motion[~train], errors, fit.good[~train]))
    ]
    pairs = zip(*(each.tolist() for each in runs), strict=True)
    outliers = int((segments.good & ~fit.good).sum())
    return Identification(
        model=problem,
        phi=problem.values(fit.p),
        covariance_of_phi=problem.basis @ covariance @ problem.basis.T,
        freedom=blocks - 1,
        rank=rank_space.shape[1],
        unseen=format_directions([item.name for item in problem.quantities], null),
        hidden=(null**2).sum(axis=1),
        unknown=sizes[:, None] * null,
        delay=lag * dt,
        delay_error=np.nan,
        dt=dt,
        seconds=seconds,
        outliers=outliers,
        dropped=sum(log.dropped for log in logs),
        samples=int(segments.good.sum()),
        segments=len(left),
        noise=segments.noise[0],
        residual=np.sqrt((left**2).sum(axis=(0, 1)) / fit.good.sum()),
        whiteness=whiteness,
        is_noise=bool(np.abs(whiteness.correlation).max() <= _WHITENESS * whiteness.bound),
        explained=share,
        chi2=float((segments.weigh(left) ** 2).sum()) / count,
        prior=plant,
        free_run=dict(zip([name for name, _ in problem.measured], pairs, strict=True)),
    )


def _directions(linear: Linear) -> tuple[Array, Array]:
    """Return the directions of scaled numbers that a log identifies, and the others."""
    values, vectors = np.linalg.eigh(linear.information)
    noise = max(1.0, float(linear.normal[..., 0, 0].sum()) / linear.e.size)
    regular = values > noise * _PRECISE**-2
    return vectors[:, regular], vectors[:, ~regular]


def _fit_inliers(problem: Any, segments: Segments, starts: Array) -> Fit:
    """Return the least squares without samples that are far off alone."""
    good, p = segments.good, np.zeros(problem.basis.shape[1])
    for _ in range(_ROUNDS):
        fit = solve(problem, segments._replace(good=good), p, starts=starts, passes=0)
        last, good = good, find_inliers(fit.linear.residual, good, segments.good)
        p, starts = fit.p, fit.starts
        if (good == last).all():
            break
    return fit._replace(good=last)
