"""Poles of a sampled closed loop, and the margins of each of its inputs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import lcm
from typing import Any, NamedTuple, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, bounded, finite, required, shaped
from pinmobile.compiled import linearization
from pinmobile.controllers import Controller, Wrapper, evaluate, notify_applied
from pinmobile.derivatives._problem import Problem, loop_errors, problem_of
from pinmobile.errors import InvalidArgument
from pinmobile.forces import Force
from pinmobile.integrators import Integrator
from pinmobile.loop import Record, Sample
from pinmobile.parts import OnCoordinates, array, child, part, parts_of
from pinmobile.plant import Plant, coordinates_of, inputs_of, stated
from pinmobile.trajectories import Trajectory

_REAL_TOLERANCE = 1e-7  # imaginary part that rounding gives to two equal real poles
_RANK_TOLERANCE = 1e-12  # relative size of singular values that are 0
_UNIT_TOLERANCE = 1e-6  # distance from the unit circle that is rounding: multiple poles scatter
_ZERO_TOLERANCE = 1e-6  # largest size of a pole that is 0 up to rounding
_FREQUENCIES = 2000  # of the search for crossings, over five decades below half the sample rate
_GROUP = 256  # samples that are linearized together
_PROBE = "controller.probe"
_RESPONSE = "input_matrix", "output_matrix", "feedthrough"


@final
@part
class _Probe(Wrapper):
    """Wrapper that adds an input of which the controller does not know."""

    controller: Any = child(Controller, doc="controller")
    probe: Any = array(shapes=(("nu",),), doc="added input")

    def initial_state(self, context: Any) -> Any:
        """Return the state of the controller."""
        return (self.controller.initial_state(context),)

    def applied(self, u: Array, state: Any, shift: Array | None = None) -> Any:
        """Return the next state; the controller receives its own share."""
        return (notify_applied(self.controller, u - self.probe, state[0], shift),)

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        """Return the input and the next state."""
        u, inner = evaluate(self.controller, t, q, v, reference, state[0])
        return u + self.probe, (inner,)


@final
@part
class _Inputs:
    """Recorder of the inputs."""

    signals, errors = False, False

    def initial_state(self, n: int, nu: int) -> None:
        """Return None: the recorder has no memory."""

    def __call__(self, sample: Sample, state: None) -> Record:
        """Return the input as a record."""
        return Record(None, kept={"u": sample.u})


class Margins(NamedTuple):
    """Margins of one input of a stable loop, whose other inputs stay closed.

    Attributes
    ----------
    gain : (float, float)
        Smallest and largest factor of the input with which the loop stays stable.
    phase : float
        Phase lag with which the loop stays stable [rad].
    delay : float
        Delay with which the loop stays stable [s].
    disk : float
        Disk margin, from 0 to 2: the loop stays stable for gains from (2 - disk) / (2 + disk) to its inverse
        and for phases up to 2 arctan(disk / 2), also together (Seiler, Packard and Gahinet, "An introduction
        to disk margins", IEEE Control Systems Magazine 40, 2020).

    See Also
    --------
    derivatives.Poles.margins : margins of all inputs.

    Examples
    --------
    >>> from pinmobile.derivatives import Margins
    >>> print(Margins((0.0, 4.0), 0.7, 0.05, 0.6))
    gain 0 to 4, phase 40.1 deg, delay 0.05 s, disk 0.6
    """

    gain: tuple[float, float]
    phase: float
    delay: float
    disk: float

    def __str__(self) -> str:
        low, high = self.gain
        return (
            f"gain {low:.3g} to {high:.3g}, phase {np.degrees(self.phase):.1f} deg, "
            f"delay {self.delay:.3g} s, disk {self.disk:.3g}"
        )

    @classmethod
    def of(cls, sensitivity: Callable[[Array], Any], dt: float) -> Margins:
        """Return the margins of a loop from its sensitivity S = 1 / (1 + L) at frequencies [rad/s]."""
        from scipy.optimize import brentq, minimize_scalar

        def loop(w: Any) -> Any:
            return 1.0 / sensitivity(np.atleast_1d(w)) - 1.0

        top = np.pi / dt
        w = np.append(top * np.logspace(-5, 0, _FREQUENCIES)[:-1], top * (1 - 1e-12))
        values = loop(w)

        def crossings(function: Callable[[Any], Any], points: Any) -> list[float]:
            signs = np.sign(function(points))
            indices = np.flatnonzero(signs[1:] * signs[:-1] < 0)
            return [brentq(lambda x: function(loop(x))[0], w[k], w[k + 1], xtol=1e-12 * top) for k in indices]

        real = [float(loop(x)[0].real) for x in crossings(lambda x: x.imag, values)] + [
            float(values[-1].real)
        ]
        factors = [-1.0 / x for x in real if x < 0]
        unit = crossings(lambda x: np.abs(x) - 1.0, values)
        lags = [float(np.angle(-loop(x)[0])) % (2 * np.pi) for x in unit]
        peaks = np.abs(2.0 * sensitivity(w) - 1.0)
        k = int(peaks.argmax())
        interval = w[max(k - 1, 0)], w[min(k + 1, len(w) - 1)]
        best = minimize_scalar(lambda x: -abs(2.0 * sensitivity(np.atleast_1d(x))[0] - 1.0), bounds=interval)
        return cls(
            (
                max((x for x in factors if x < 1), default=0.0),
                min((x for x in factors if x > 1), default=np.inf),
            ),
            min((min(x, 2 * np.pi - x) for x in lags), default=np.inf),
            min((x / frequency for x, frequency in zip(lags, unit, strict=True)), default=np.inf),
            2.0 / max(-float(best.fun), float(peaks[k])),
        )


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
        Time step, or period of a loop with `Sampled` laws, and time of the sample [s].
    input_matrix : ndarray, shape (n, nu), optional
        Derivatives of the state after the sample by an addition to each input.
    output_matrix : ndarray, shape (nu, n), optional
        Derivatives of the input by the state.
    feedthrough : ndarray, shape (nu, nu), optional
        Derivatives of the input by the addition.
    inputs : tuple of str
        Name of each input.

    See Also
    --------
    derivatives.poles : linearize a loop.
    plots.poles : figure of the poles.

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
    input_matrix: Any = None
    output_matrix: Any = None
    feedthrough: Any = None
    inputs: tuple[str, ...] = ()

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
        is_known = np.isfinite(size) & (size * self.dt > _UNIT_TOLERANCE)
        return np.asarray(np.divide(-s.real, size, out=np.ones_like(size), where=is_known))

    @property
    def is_stable(self) -> bool:
        """Whether small deviations near this sample do not grow."""
        return bool(np.abs(self.values).max() <= 1.0 + _UNIT_TOLERANCE)

    def sensitivity(self, frequency: ArrayLike) -> Any:
        """Return the response of the inputs to additions to them, S = 1 / (1 + L).

        Parameters
        ----------
        frequency : array_like, shape (m,)
            Frequencies, 0 to pi / dt [rad/s].

        Returns
        -------
        ndarray of complex, shape (m, nu, nu)
            Responses.

        Raises
        ------
        InvalidArgument
            If the inputs change within the period of the loop.
        """
        expected = "a loop with one time step, or Sampled around its whole law: others have no margins"
        label = "the inputs change within the period of the loop: input_matrix"
        input_matrix = required(label, self.input_matrix, expected)
        z = np.exp(1j * np.asarray(frequency, float) * self.dt)[..., None, None]
        return self.feedthrough + self.output_matrix @ np.linalg.solve(
            z * np.eye(len(self.matrix)) - self.matrix, input_matrix
        )

    @cached_property
    def margins(self) -> Mapping[str, Margins]:
        """Margins of each input, by its name, while the others stay closed.

        Raises
        ------
        InvalidArgument
            If the loop is unstable near this sample.
        """
        if not self.is_stable:
            raise InvalidArgument(
                "the loop is unstable near this sample, expected a stable one: it has no margins"
            )

        def response(i: int) -> Callable[[Array], Any]:
            return lambda w: self.sensitivity(w)[:, i, i]

        with np.errstate(all="ignore"):
            return {name: Margins.of(response(i), self.dt) for i, name in enumerate(self.inputs)}

    def __str__(self) -> str:
        size = float(np.abs(self.values).max())
        word = "grow" if not self.is_stable else "do not decay" if size > 1 - _UNIT_TOLERANCE else "decay"
        count = np.count_nonzero(np.abs(self.values) <= _ZERO_TOLERANCE)
        lines = [
            f"{len(self.values)} poles at t = {self.t:g} s, {count} of them at 0, "
            f"largest |z| = {size:.4f}: small deviations {word} near this sample, which proves "
            "nothing about a whole trajectory"
        ]
        for z, w, d in zip(self.values, self.frequency, self.damping, strict=True):
            if abs(z) > _ZERO_TOLERANCE and z.imag >= 0:
                pair = " +- " if z.imag > 0 else "    "
                lines.append(f"  z = {z.real:7.4f}{pair}{z.imag:.4f}j, {w:8.3f} rad/s, damping {d:6.3f}")
        return "\n".join(lines)


def poles(
    plant: Plant,
    controller: Controller,
    trajectory: Trajectory,
    *,
    dt: float,
    at: ArrayLike = 0.0,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    integrator: Integrator | None = None,
    substeps: int = 1,
    forces: Sequence[Force | OnCoordinates] | Mapping[str, Force | OnCoordinates] = (),
) -> Any:
    """Return the poles of a sampled closed loop at a sample of its run, or at several.

    The loop with all its memory, delays and holds is linearized, exactly up to rounding. Eigenvalues inside
    the unit circle mean that small deviations decay if the loop stays at this sample, such as at rest or on
    a steady motion. Along a trajectory on which the matrix changes, they prove nothing about stability.

    A loop with `Sampled` laws is linearized over one period, the smallest in which each of them runs a whole
    number of times. It has margins if one `Sampled` holds all inputs for the period.

    Parameters
    ----------
    plant, controller, trajectory, dt, q0, v0, integrator, substeps, forces
        Closed loop, see `simulate`.
    at : float or array_like, shape (m,)
        Time of the sample [s], or times of several samples of one run, such as all along a trajectory; the
        first sample, or period, counts as the second one, after which delays are full.

    Returns
    -------
    Poles or tuple of Poles
        Eigenvalues, matrix, frequencies, damping ratios and margins of each input, at each time.

    Raises
    ------
    InvalidArgument
        If an argument is invalid, the run diverges before, or the loop cannot be compiled.

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
    probe = _Probe(controller, np.zeros(plant.nu))
    options: dict[str, Any] = {"dt": dt, "forces": forces, "integrator": integrator, "substeps": substeps}
    parts = plant, probe, trajectory
    problem = problem_of(*parts, lambda _: _Inputs(), [_PROBE], (q0, v0), n=1, **options)
    t = problem.scenario.t
    times = shaped("at", finite("at", at), (), ("n>=1",))
    times = np.atleast_1d(bounded("at", times, least=0, most=t[-1], unit="s"))
    samples = lcm(*(stated(law, "step_samples") or 1 for _, law in parts_of(problem.loop)))
    dt, last = samples * problem.scenario.dt, len(t) // samples - 1
    if last < 1 < samples:
        raise InvalidArgument(
            f"the run has {len(t)} samples, expected at least {2 * samples}: two periods of its Sampled laws"
        )
    indices = [samples * min(max(1, round(time / dt)), last) for time in times]
    with loop_errors():
        linear = _linearize(problem, indices, samples)
    is_held = (stated(controller, "step_samples") or 1) == samples
    n, longest = len(problem.machine.tape.states), problem.machine.longest
    names = _names(problem), tuple(entry.name for entry in inputs_of(plant))
    found = list[Poles]()
    for k, (matrix, output) in zip(indices, linear, strict=True):
        values, response = _eigenvalues(matrix[:, :n], longest), (matrix[:, n:], output[:, :n], output[:, n:])
        options = dict(zip(_RESPONSE, response, strict=True)) if is_held else {}
        found.append(Poles(values, matrix[:, :n], names[0], dt, float(t[k]), inputs=names[1], **options))
    return tuple(found) if np.ndim(at) else found[0]


def _eigenvalues(matrix: Array, longest: int) -> Any:
    """Return the eigenvalues of the loop, the largest first; its longest delay lasts some samples."""
    # Chains of delays have poles 0, which rounding scatters: leave them out by the range of a power.
    U, sizes, _ = np.linalg.svd(np.linalg.matrix_power(matrix, 1 + longest))
    basis = U[:, sizes > _RANK_TOLERANCE * sizes[0]]
    values = np.zeros(len(matrix), complex)
    values[: basis.shape[1]] = np.linalg.eigvals(basis.T @ matrix @ basis)
    values.imag[np.abs(values.imag) < _REAL_TOLERANCE] = 0.0
    return values[np.lexsort([-values.imag, -np.round(np.abs(values), 6)])]


def _linearize(problem: Problem, starts: Sequence[int], samples: int) -> list[tuple[Array, Array]]:
    """Return the derivatives of state and input by state and probe, (n, n + nu), (nu, n + nu).

    The state is that after some samples, from each start on; the input is that of the start.
    """
    machine, inputs = problem.machine, problem.inputs({})
    n, leaf = len(machine.tape.states), machine.tape.parameters[_PROBE]
    columns = [("row", leaf.first + i) for i in range(int(np.prod(leaf.shape)))]
    m = n + len(columns)
    history = inputs._replace(samples=inputs.samples[: max(starts) + samples])
    record = machine.of("recording", machine.state_recorder, False)
    states = record[1].kept_samples(problem.run(record, history, slice(None))[1], 1)["state"][0]
    if not (is_finite := np.isfinite(states).all(axis=1)).all():
        time = history.samples[is_finite.argmin(), 0]
        raise InvalidArgument(
            f"at is behind t = {time:g} s, where the run diverges, expected earlier samples"
        )
    program = machine.of("linearization", lambda: linearization(machine.tape, columns), True)
    identity = np.eye(m)
    rows = np.concatenate([np.tile(inputs.rows, m), identity[n:]])
    inputs = inputs._replace(states=identity[:n], rows=rows)
    matrices, outputs = dict[int, Array](), dict[int, Array]()
    indices = np.unique(np.add.outer(starts, range(samples)))
    for group in np.split(indices, np.flatnonzero(np.diff(indices) > 1) + 1):
        for begin in range(group[0], group[-1] + 1, _GROUP):
            end = min(begin + _GROUP, group[-1] + 1)
            tracks = np.broadcast_to(states[begin:end, :, None], (end - begin, n, m))
            tracks = np.concatenate([tracks, np.tile(inputs.tracks[begin:end], m)], axis=1)
            arguments = inputs._replace(samples=inputs.samples[begin:end], tracks=tracks)
            _, kept = problem.run(program, arguments, slice(None), first=begin, copies=m)
            found = program[1].kept_samples(kept, m)
            matrices |= zip(range(begin, end), found["tangent state"].transpose(1, 2, 0), strict=True)
            outputs |= zip(range(begin, end), found["tangent u"].transpose(1, 2, 0), strict=True)
    linear = list[tuple[Array, Array]]()
    for k in starts:
        effect = identity.copy()
        for i in range(k, k + samples):
            effect[:n] = matrices[i] @ effect
        linear.append((effect[:n], outputs[k]))
    return linear


def _names(problem: Problem) -> tuple[str, ...]:
    """Return the names of the states."""
    plant, tape = problem.scenario.robot, problem.machine.tape
    names = [coordinate.name for coordinate in coordinates_of(plant)]
    nq, nv = tape.sizes[:2]
    names = names if nq == nv else [f"q[{i}]" for i in range(nq)]
    names += [coordinate.rate or f"{coordinate.name}_rate" for coordinate in coordinates_of(plant)]
    for leaf in tape.leaves:
        if leaf.kind == "state":
            names += [f"{leaf.owner} {leaf.path}"] * int(np.prod(leaf.shape))
    return (*names, *["delay"] * (len(tape.states) - len(names)))
