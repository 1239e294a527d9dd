"""`tune`: numbers of the parts that make a loss of a run, or of an ensemble, as small as possible."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace as replaced
from typing import Any, NamedTuple, final

import numpy as np

from pinmobile.arrays import (
    Array,
    ArrayLike,
    between,
    check_integer,
    instance,
    one_of,
    real,
    sequence,
    shaped,
)
from pinmobile.controllers import Controller
from pinmobile.derivatives._gradient import Evaluation, Loss, Losses, evaluate_losses
from pinmobile.derivatives._problem import Problem, check_paths, problem_of
from pinmobile.errors import InvalidArgument, unexpected_value
from pinmobile.forces import Force
from pinmobile.integrators import Integrator
from pinmobile.loop import Sample, Scenario, Source
from pinmobile.metrics import Metric
from pinmobile.parts import NumberRef, OnCoordinates, replace
from pinmobile.plant import Plant, stated
from pinmobile.trajectories import Trajectory

OBJECTIVES = ("mean", "soft maximum", "worst")
_MAX_ROWS = 12  # numbers in a summary
_SOFTNESS = 0.02  # softness of the maximum, as a share of the first loss
_EXCESS_TOLERANCE = 1e-6  # violation of a constraint that counts as rounding
_SLOPE_TOLERANCE = 1e-12  # slope by a variable that is rounding, as a share of the first loss
_BOUND_TOLERANCE = 1e-6  # distance from a bound that counts as rounding, as a share of the bound
_MAX_LOG = 12.0  # largest logarithm of the ratio of a tuned number and the first one


class Constraint(NamedTuple):
    """Bounds of a number of each run, which every robot keeps.

    Attributes
    ----------
    of : callable, str or Metric
        Function of a sample, or a metric, as the loss of `gradient`.
    lower, upper : float
        Bounds of the reduced values.
    reduction : str, optional
        Reduction of the samples; default: the largest value of a function, the worst value of a metric.

    See Also
    --------
    derivatives.tune : tune with constraints.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.derivatives import Constraint
    >>> def force(sample):
    ...     return np.abs(sample.u[:2]).max()
    >>> Constraint(force, upper=150.0).upper  # [N]
    150.0
    """

    of: Callable[[Sample], Any] | str | Metric
    lower: float = -np.inf
    upper: float = np.inf
    reduction: str | None = None

    def read(self, scenario: Scenario) -> Loss:
        """Return the loss of the constraint."""
        label = "bounds of a Constraint"
        bounds = shaped(label, real(label, [self.lower, self.upper]), (2,))
        if not bounds[0] < bounds[1] or np.isinf(bounds).all():
            raise InvalidArgument(
                f"Constraint has bounds {self.lower} and {self.upper}, expected lower < upper"
            )
        reduction = self.reduction
        if reduction is None and not isinstance(self.of, str | Metric):
            reduction = "largest" if np.isfinite(self.upper) else "smallest"
        return Loss.read(self.of, reduction, scenario, "metric of a Constraint")

    def excess(self, value: Any) -> Any:
        """Return by how much values exceed the bounds."""
        return np.maximum(np.maximum(self.lower - value, value - self.upper), 0.0)

    def __str__(self) -> str:
        names = (stated(self.of, word) for word in ("name", "__name__"))
        name = self.of if isinstance(self.of, str) else next(filter(None, names), "number")
        low = f"{self.lower:g} <= " if np.isfinite(self.lower) else ""
        return f"{low}{name}{f' <= {self.upper:g}' if np.isfinite(self.upper) else ''}"


class Trial(NamedTuple):
    """Numbers that were tried.

    Attributes
    ----------
    numbers : ndarray, shape (P,)
        Values of the entries, in the order of `Tuning.names`.
    loss : float
        Objective: the loss of one robot, or the mean or largest loss of all.
    excess : float
        Largest violation of a constraint.

    See Also
    --------
    derivatives.Tuning : result with all trials.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.derivatives import Trial
    >>> Trial(np.array([120.0]), loss=0.3, excess=0.0).loss
    0.3
    """

    numbers: Array
    loss: float
    excess: float


@final
@dataclass(frozen=True, eq=False, repr=False)
class Tuning:
    """Result of `derivatives.tune`.

    Attributes
    ----------
    plant, controller, trajectory, forces
        Parts with the best numbers, and with those that follow them in the spread by `SameAs`.
    names : tuple of str
        Path of each tuned number; entries of an array have their index.
    units : tuple of str
        Units of these numbers.
    bounds : ndarray, shape (P, 2)
        Bounds of these numbers, infinite without one.
    trials : tuple of Trial
        All trials, the given numbers first.
    best : Trial
        Trial with the smallest loss that keeps the constraints.
    constraints : tuple of Constraint
        The constraints.
    objective : str
        "loss" of one robot; "mean loss" or "largest loss" of all.
    others : tuple of ndarray
        Losses before and after of robots that were not used for tuning, shape (n,) each; () for one robot.
    others_excess : ndarray, shape (n,)
        Largest violation of a constraint by each of these robots.
    method : str
        Method, mode of the gradients and reason of its end.
    seconds : float
        Time [s], of which `built` for machine code.
    built : float
        Time until the first trial [s].

    See Also
    --------
    derivatives.tune : tune a loop.

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Tangent
    >>> from pinmobile.derivatives import tune
    >>> circle = Tangent(Circle(1.0, 0.5, 4.0))
    >>> parts = MobileRobot(30.0, 1.3), PD(120, 120), circle
    >>> def loss(sample):
    ...     return (sample.error**2).sum() + 1e-5 * (sample.u**2).sum()
    >>> found = tune(loss, *parts, by=["kp", "kd"], dt=0.02)
    >>> len(found.names), found.best.loss < found.trials[0].loss
    (2, True)
    """

    plant: Any
    controller: Any
    trajectory: Any
    forces: Any
    names: tuple[str, ...]
    units: tuple[str, ...]
    bounds: Array
    trials: tuple[Trial, ...]
    best: Trial
    constraints: tuple[Constraint, ...]
    objective: str
    others: tuple[Array, ...]
    others_excess: Array
    method: str
    seconds: float
    built: float

    def __repr__(self) -> str:
        return f"<Tuning: {self.objective} {self.trials[0].loss:.6g} to {self.best.loss:.6g}>"

    def __str__(self) -> str:
        first, best, names = self.trials[0], self.best, self.names
        lines = [
            f"{self.objective} {first.loss:.6g} to {best.loss:.6g} by {len(names)} numbers, "
            f"{len(self.trials)} trials ({self.method})"
        ]
        width = max(map(len, names))
        sizes = np.where(first.numbers == 0, 1.0, np.abs(first.numbers))
        changes = np.abs(best.numbers - first.numbers) / sizes
        rows = np.sort(np.argsort(-changes)[:_MAX_ROWS])
        is_close = np.isclose(best.numbers[:, None], self.bounds, rtol=_BOUND_TOLERANCE, atol=0.0)
        at_bound = np.any(is_close, axis=1)
        for k in rows:
            unit = f" {self.units[k]}" if self.units[k] else ""
            bound = " (its bound)" if at_bound[k] else ""
            lines.append(
                f"  {names[k]:{width}}  {first.numbers[k]:10.4g} to {best.numbers[k]:10.4g}{unit}{bound}"
            )
        if len(names) > len(rows):
            lines.append(f"  ... and {len(names) - len(rows)} numbers that changed less")
        for constraint in self.constraints:
            is_kept = best.excess <= _EXCESS_TOLERANCE
            lines.append(f"  {constraint}: {'kept' if is_kept else f'exceeded by up to {best.excess:.3g}'}")
        if best.excess > _EXCESS_TOLERANCE:
            lines.append("  no trial keeps all constraints: these numbers exceed them least")
        if self.others:
            old, new = ((np.mean(x), np.quantile(x, 0.99), np.max(x)) for x in self.others)
            words = ("mean", "99 %", "largest")
            text = ", ".join(f"{w} {x:.4g} to {y:.4g}" for w, x, y in zip(words, old, new, strict=True))
            lines.append(f"  loss of {len(self.others[0])} other robots: {text}")
            excesses = self.others_excess[self.others_excess > _EXCESS_TOLERANCE]
            if excesses.size:
                lines.append(f"  {excesses.size} of them exceed a constraint, by up to {excesses.max():.3g}")
        return "\n".join(lines)


class _Variables:
    """Tuned numbers as variables of a minimiser: logarithms of positive ones, shares of others."""

    def __init__(self, problem: Problem, given: Mapping[str, Any]) -> None:
        self.problem, self.entries, self.names, self.units = problem, list[Any](), list[str](), list[str]()
        first, limits = list[float](), list[Any]()
        for path, ref in problem.numbers.items():
            value = problem.nominal[ref.leaf.path]
            field: Any = ref.leaf.declared
            above, low, high = (stated(field, name) for name in ("above", "lower", "upper"))
            low = above if above is not None else -np.inf if low is None else low
            pair = given.get(path)
            high = np.inf if high is None else high
            pair = (low, high) if pair is None else pair
            ends = real(f"by[{path!r}]", pair)
            if ends.shape != (2,) or not ends[0] < ends[1]:
                raise unexpected_value(f"by[{path!r}]", pair, "(lower, upper) with lower < upper")
            if ends[0] < low or ends[1] > high:
                raise unexpected_value(
                    f"by[{path!r}]", pair, f"narrower bounds than those declared, {field.bound}"
                )
            labels = {entry: label for label, entry in ref.leaf.entries.items() if len(entry) == value.ndim}
            for entry in problem.entries(ref):
                self.entries.append((ref.leaf.path, entry))
                indices = "".join(f"[{i}]" for i in entry)
                suffix = f".{labels[entry]}" if entry in labels else indices
                self.names.append(path if ref.entry is not None else path + suffix)
                self.units.append(NumberRef(ref.leaf, ref.label, entry or None).unit)
                first.append(float(value[entry]))
                limits.append(ends)
        self.first = np.array(first)
        self.low, self.high = np.array(limits, float).T
        between("by has bounds that exclude", self.names, self.first, self.low, self.high)
        self.is_log = (self.low >= 0) & (self.first > 0)
        self.scale = np.where(self.first == 0, 1.0, np.abs(self.first))

    @property
    def bounds(self) -> list[tuple[float | None, float | None]]:
        """Bounds of the variables."""
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = [np.clip(np.log(x / self.scale), -_MAX_LOG, _MAX_LOG) for x in (self.low, self.high)]
        shares = [(x - self.first) / self.scale for x in (self.low, self.high)]
        low, high = (np.where(self.is_log, x, y) for x, y in zip(logs, shares, strict=True))
        ends = ([None if np.isinf(x) else float(x) for x in column] for column in (low, high))
        return [*zip(*ends, strict=True)]

    def numbers(self, z: Array) -> Array:
        """Return the numbers of variables, shape (P,)."""
        shares = np.where(self.is_log, np.exp(np.where(self.is_log, z, 0.0)), 0.0)
        return np.where(self.is_log, self.first * shares, self.first + self.scale * z)

    def changes(self, numbers: Array) -> dict[str, Any]:
        """Return the values of the fields by path."""
        values: dict[str, Any] = {}
        for (path, entry), x in zip(self.entries, numbers, strict=True):
            values.setdefault(path, np.array(self.problem.nominal[path]))[entry] = x
        return {path: value if value.ndim else float(value) for path, value in values.items()}

    def slopes(self, numbers: Array) -> Array:
        """Return the slopes of the numbers by the variables, shape (P,)."""
        return np.where(self.is_log, numbers, self.scale)


@dataclass(eq=False)
class _Search:
    """Evaluations of the losses, each of which is kept."""

    variables: _Variables
    constraints: tuple[Constraint, ...]
    objective: str
    mode: str
    progress: Callable[[Trial], Any] | None
    trials: list[Trial] = field(default_factory=list)
    last: tuple[bytes, Evaluation | None] = (b"", None)
    unit: float = 1.0

    def evaluate(self, z: Array) -> Evaluation | None:
        """Return the evaluation at variables; None if the parts refuse the numbers."""
        key = z.tobytes()
        if key != self.last[0]:
            numbers, problem = self.variables.numbers(z), self.variables.problem
            try:
                result = evaluate_losses(problem, self.variables.changes(numbers), self.mode)
            except InvalidArgument:
                if not self.trials:
                    raise
                result = None
            self.last = key, result
            loss = excess = np.inf
            if result is not None and np.isfinite(result.values).all():
                loss = self.of(result.values[0])[0]
                excess = float(self.excess(result.values[1:]).max())
            self.trials.append(Trial(numbers, float(loss), excess))
            if self.progress is not None:
                self.progress(self.trials[-1])
        return self.last[1]

    def excess(self, values: Array) -> Array:
        """Return the largest violation of a constraint by each robot, shape (n,), of values (L, n)."""
        excesses = [constraint.excess(x) for constraint, x in zip(self.constraints, values, strict=True)]
        return np.asarray(np.max([np.zeros(self.variables.problem.n), *excesses], axis=0))

    def of(self, losses: Array, soft: float = 0.0) -> tuple[float, Array]:
        """Return the objective of the robots' losses, and its slopes by them."""
        if self.objective == "mean":
            return float(losses.mean()), np.full(losses.shape, 1.0 / losses.size)
        top = losses.max()
        if not soft:
            return float(top), (losses == top) / np.count_nonzero(losses == top)
        weights = np.exp((losses - top) / soft)
        return float(top + soft * np.log(weights.mean())), weights / weights.sum()

    def value(self, z: Array, soft: float = 0.0) -> tuple[float, Array]:
        """Return the objective and its gradient by the variables."""
        result = self.evaluate(z)
        if result is None or not np.isfinite(result.values).all() or not np.isfinite(result.slopes).all():
            return np.inf, np.zeros(len(z))
        value, weights = self.of(result.values[0], soft)
        return value, (weights @ result.slopes[0]) * self.variables.slopes(self.variables.numbers(z))

    def slacks(self, z: Array, bound: bool) -> tuple[Array, Array]:
        """Return distances from the bounds, >= 0 where they are kept, and their slopes by the variables.

        If `bound`, the last variable is a bound of all losses.
        """
        numbers = z[: len(self.variables.first)]
        result = self.evaluate(numbers)
        values, slopes = [np.zeros(0)], [np.zeros((0, len(z)))]
        if result is not None:
            J = result.slopes * self.variables.slopes(self.variables.numbers(numbers))
            J = np.concatenate([J, np.zeros((*J.shape[:2], len(z) - len(numbers)))], axis=2)
            if bound:
                values.append(z[-1] - result.values[0] / self.unit)
                slopes.append(np.eye(len(z))[-1] - J[0] / self.unit)
            for c, value, slope in zip(self.constraints, result.values[1:], J[1:], strict=True):
                for limit, sign in ((c.lower, 1.0), (c.upper, -1.0)):
                    if np.isfinite(limit):
                        size = max(abs(limit), 1e-3)
                        values.append(sign * (value - limit) / size)
                        slopes.append(sign * slope / size)
        return np.nan_to_num(np.concatenate(values)), np.nan_to_num(np.concatenate(slopes))


def tune(
    loss: Callable[[Sample], Any] | str | Metric,
    plant: Plant,
    controller: Controller,
    trajectory: Trajectory,
    *,
    by: Sequence[str] | Mapping[str, tuple[float, float] | None],
    dt: float,
    reduction: str | None = None,
    constraints: Constraint | Sequence[Constraint] = (),
    duration: float | None = None,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    integrator: Integrator | None = None,
    substeps: int = 1,
    forces: Sequence[Force | OnCoordinates] | Mapping[str, Force | OnCoordinates] = (),
    n: int = 1,
    spread: Mapping[str, Source] | None = None,
    seed: int = 0,
    objective: str = "mean",
    iterations: int = 200,
    progress: Callable[[Trial], Any] | None = None,
) -> Tuning:
    """Return the parts with the numbers that minimise a loss, within bounds and constraints.

    SciPy's minimisers take exact gradients: L-BFGS-B; with constraints or the objective "worst", SLSQP. They
    find a minimum near the given numbers, not the smallest one of all. Positive numbers are varied by their
    logarithms.

    Parameters
    ----------
    loss, plant, controller, trajectory, dt, reduction, duration, q0, v0, integrator, substeps, forces
        Loss and closed loop, see `gradient`.
    by : sequence of str, or mapping of str to (float, float)
        Numbers by path, with bounds if they are narrower than those that the parts declare; None for those.
    constraints : sequence of Constraint
        Bounds of other numbers of the runs, such as forces and margins.
    n, spread, seed
        Robots of an ensemble, see `ensemble`. The result is checked on other robots, with the next seed.
    objective : str
        "mean" loss of the robots; "soft maximum"; or "worst", the largest loss, as a bound of all losses that
        is a variable.
    iterations : int
        Largest number of iterations of the minimiser, each of one or more trials.
    progress : callable, optional
        Function that is called with each `Trial`; default: a line on a terminal. Ctrl-C ends the search with
        the best trial so far.

    Returns
    -------
    Tuning
        The parts with the best numbers, all trials, and the losses of other robots.

    Raises
    ------
    InvalidArgument
        If an argument is invalid, the loop cannot be compiled, or the given numbers diverge.

    See Also
    --------
    derivatives.gradient : gradient of a loss.
    sweep : all combinations of some numbers.

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Tangent
    >>> from pinmobile.derivatives import tune
    >>> circle = Tangent(Circle(1.0, 0.5, 4.0))
    >>> parts = MobileRobot(30.0, 1.3), PD(120, 120), circle
    >>> by = {"kp": (1, 400), "kd": (1, 400)}
    >>> found = tune("distance", *parts, by=by, dt=0.02)
    >>> round(found.trials[0].loss, 4), round(found.best.loss, 4)  # [m]
    (0.0589, 0.0171)
    """
    from scipy.optimize import minimize

    start_time = time.perf_counter()
    one_of("objective", objective, OBJECTIVES)
    max_iterations = check_integer("iterations", iterations)
    given = dict(by) if isinstance(by, Mapping) else dict.fromkeys(check_paths(by))
    items = [constraints] if isinstance(constraints, Constraint) else constraints
    items = sequence("constraints", items, "a list of derivatives.Constraint")
    bounds = tuple(instance("constraints", one, Constraint, "derivatives.Constraint") for one in items)

    def losses(scenario: Scenario) -> Losses:
        limits = [limit.read(scenario) for limit in bounds]
        return Losses((Loss.read(loss, reduction, scenario), *limits))

    options: dict[str, Any] = {"dt": dt, "duration": duration, "integrator": integrator, "substeps": substeps}
    options |= {"forces": forces, "n": n, "spread": spread, "seed": seed}
    problem = problem_of(plant, controller, trajectory, losses, [*given], (q0, v0), **options)
    duplicates = {one.leaf.path for one in problem.numbers.values()} & problem.values.keys()
    if duplicates:
        raise InvalidArgument(f"by has {min(duplicates)!r}, which is in the spread, expected other numbers")
    wholes, parts = (
        {one.leaf.path for one in problem.numbers.values() if (one.entry is None) == is_whole}
        for is_whole in (True, False)
    )
    if len(problem.numbers) < sum(map(len, problem.refs_by_name.values())) or wholes & parts:
        raise InvalidArgument(f"by has {', '.join(given)}, of which two mean the same number")
    pairs = ((one.path, given[name]) for name, refs in problem.refs_by_name.items() for one in refs)
    variables = _Variables(problem, {path: pair for path, pair in pairs if pair is not None})
    mode, _ = problem.mode(1 + len(bounds))
    search = _Search(variables, bounds, objective, mode, progress or _show_trial)
    start = np.zeros(len(variables.names))
    first = search.evaluate(start)
    built = time.perf_counter() - start_time
    if first is None or not np.isfinite(first.values).all():
        raise InvalidArgument("the loop diverges with the given numbers, expected numbers with finite losses")
    size = max(abs(search.trials[0].loss), np.finfo(float).tiny)
    search.unit = size
    soft = _SOFTNESS * size if objective == "soft maximum" else 0.0
    bound = objective == "worst" and problem.n > 1
    settings = {"jac": True, "bounds": variables.bounds, "options": {"maxiter": max_iterations}}

    def scale_value(z: Array) -> tuple[float, Array]:
        if bound:
            return float(z[-1]), np.eye(len(z))[-1]
        value, slope = search.value(z, soft)
        return value / size, slope / size

    method = "SLSQP" if bounds or bound else "L-BFGS-B"
    if method == "SLSQP":
        slacks = {"fun": lambda z: search.slacks(z, bound)[0], "jac": lambda z: search.slacks(z, bound)[1]}
        settings |= {"constraints": [{"type": "ineq", **slacks}]}
        if bound:
            start = np.append(start, first.values[0].max() / size)
            settings["bounds"] = [*variables.bounds, (None, None)]
    try:
        with np.errstate(all="ignore"):
            result = minimize(scale_value, start, method=method, **settings)
            limit = result.nit >= max_iterations
            reason = (
                "converged" if result.success else "limit of iterations" if limit else "no further decrease"
            )
    except KeyboardInterrupt:
        reason = "stopped"
    if np.abs(first.slopes[0] * variables.slopes(variables.first)).max() <= _SLOPE_TOLERANCE * size:
        is_largest = Loss.read(loss, reduction, problem.scenario).reduction == "largest"
        reason = "no number changes the loss" + ", such as the largest error at the start" * is_largest
    if progress is None and sys.stderr.isatty():
        print(file=sys.stderr)
    best = min(search.trials, key=lambda one: (max(one.excess, _EXCESS_TOLERANCE), one.loss))
    changes = variables.changes(best.numbers)
    loop = replace(problem.scenario.nominal_loop, {**changes, **problem.copies(changes)})
    others: tuple[Array, ...] = ()
    excesses = np.zeros(0)
    if problem.n > 1:
        others_of = replaced(problem.scenario, seed=seed + 1)
        fresh = Problem(others_of, problem.loop.recorder, [*given], (q0, v0))
        old, new = (evaluate_losses(fresh, x, None).values for x in ({}, changes))
        others, excesses = (old[0], new[0]), search.excess(new[1:])
    words = "loss" if problem.n == 1 else "mean loss" if objective == "mean" else "largest loss"
    tuned_parts = loop.plant, loop.controller, loop.trajectory, loop.forces
    seconds = time.perf_counter() - start_time
    trials, limits = tuple(search.trials), np.stack([variables.low, variables.high], axis=1)
    keys = tuple(variables.names), tuple(variables.units), limits
    note = f"{method}, {mode} mode: {reason}"
    return Tuning(*tuned_parts, *keys, trials, best, bounds, words, others, excesses, note, seconds, built)


def _show_trial(trial: Trial) -> None:
    """Show a trial on a terminal."""
    if sys.stderr.isatty():
        print(f"\rloss {trial.loss:.6g}    ", end="", file=sys.stderr, flush=True)
