"""`gradient`: losses of runs and their derivatives; `sensitivities`: derivatives of all samples of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace as replaced
from typing import Any, NamedTuple, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, bounded, finite, instance, one_of, positive, shaped
from pinmobile.controllers import Controller
from pinmobile.derivatives._problem import Direction, Inputs, Problem, loop_errors, problem_of
from pinmobile.errors import InvalidArgument, format_value
from pinmobile.forces import Force
from pinmobile.integrators import Integrator
from pinmobile.loop import Engine, Record, Rollout, Sample, Samples, Scenario, Source, simulate
from pinmobile.metrics import Metric, check_metric, format_si, metrics_of
from pinmobile.parts import OnCoordinates, named, option, part
from pinmobile.plant import Plant
from pinmobile.trajectories import Trajectory

REDUCTIONS = ("sum", "mean", "rms", "last", "largest", "smallest")
"""Reductions of the values of all samples to one number."""
_INITIAL = {"largest": -np.inf, "smallest": np.inf}


class Loss(NamedTuple):
    """Number of a run: a function of a sample or a metric, and how it is reduced.

    Attributes
    ----------
    of : callable or int
        Function of a sample, or index of a metric of the plant.
    reduction : str
        One of `REDUCTIONS`.
    name : str
        Name in messages.
    """

    of: Callable[[Sample], Any] | int
    reduction: str
    name: str

    @classmethod
    def read(cls, given: Any, reduction: str | None, scenario: Scenario, label: str = "loss") -> Loss:
        """Return the loss that a user means.

        Parameters
        ----------
        given : callable, str or Metric
            Function of a sample; or "distance", "heading", a coordinate or a metric of the plant by name.
        reduction : str, optional
            Default: the sum of a function; the worst value of a metric.
        scenario : Scenario
            Loop of the loss.
        label : str
            Name of the argument.

        Raises
        ------
        InvalidArgument, UnknownName
            If it is none of these.
        """
        if reduction is not None:
            one_of("reduction", reduction, REDUCTIONS)
        if isinstance(given, Metric) and given.function is not None:
            check_metric(given)
            worst = "smallest" if given.is_margin else "largest"
            return cls(given.function, reduction or worst, given.name)
        if not isinstance(given, str):
            expected = "a function of a sample or the name of a metric"
            return cls(instance(label, given, Callable, expected), reduction or "sum", label)
        plant = scenario.robot
        errors: dict[str, Any] = {"distance": _distance, "heading": _error_size(2)}
        errors |= {one.name: _error_size(i) for i, one in enumerate(scenario.coordinates)}
        metrics = {one.name: (i, one.is_margin) for i, one in enumerate(metrics_of(plant))}
        name = one_of(label, given, {**errors, **metrics})
        if name in errors:
            return cls(errors[name], reduction or "largest", name)
        index, is_margin = metrics[name]
        return cls(index, reduction or ("smallest" if is_margin else "largest"), name)

    def finish(self, value: Array, count: int) -> tuple[Array, Array]:
        """Return the loss of a recorded value, and its slope by the recorded value."""
        if self.reduction == "rms":
            root = np.sqrt(value / count)
            return root, np.divide(0.5 / count, root, out=np.zeros_like(root), where=root > 0)
        share = 1.0 / count if self.reduction == "mean" else 1.0
        return value * share, np.full_like(value, share)


def _distance(sample: Sample) -> Any:
    return np.sqrt((sample.error[:2] ** 2).sum())


def _error_size(i: int) -> Callable[[Sample], Any]:
    """Return the function of a sample that returns the size of an error."""
    return lambda sample: np.abs(sample.error[i])


@final
@part
class Losses:
    """Recorder of the losses; it keeps whether wheels slide."""

    losses: tuple[Loss, ...] = option(default=())
    signals, errors = True, True

    @property
    def metrics(self) -> tuple[tuple[int, bool], ...]:
        """Metrics of the plant that the recorder reads."""
        return tuple((loss.of, False) for loss in self.losses if isinstance(loss.of, int))

    def initial_state(self, n: int, nu: int) -> Any:
        """Return the losses of no sample."""
        return np.array([_INITIAL.get(loss.reduction, 0.0) for loss in self.losses])

    def __call__(self, sample: Sample, state: Any) -> Record:
        """Return the losses with one more sample."""
        values = []
        for i, loss in enumerate(self.losses):
            value = loss.of(sample) if callable(loss.of) else sample.measured[loss.of]
            if np.shape(value) != ():
                raise InvalidArgument(f"{loss.name} returned {format_value(value)}, expected a number")
            last = state[i]
            if loss.reduction in ("sum", "mean", "rms"):
                value = last + (value * value if loss.reduction == "rms" else value)
            elif loss.reduction != "last":
                is_new = value > last if loss.reduction == "largest" else value < last
                value = np.where(is_new, value, last)
            values.append(value + 0.0 * sample.t)
        kept = {name: sample.signals[name].value for name in ("slides",) if name in sample.signals}
        return Record(np.stack(values), kept=kept)


class Evaluation(NamedTuple):
    """Losses of n robots and their derivatives.

    Attributes
    ----------
    values : ndarray, shape (L, n)
        Losses.
    slopes : ndarray, shape (L, n, P)
        Derivatives by each entry of each number.
    directions : list of Direction
        The entries.
    inputs : Inputs
        Inputs of the machine code.
    """

    values: Array
    slopes: Array
    directions: list[Direction]
    inputs: Inputs


def evaluate_losses(problem: Problem, changes: Mapping[str, Any], mode: str | None) -> Evaluation:
    """Return the losses of the robots with other numbers, and their derivatives in a mode.

    Parameters
    ----------
    problem : Problem
        Loop with the recorder `Losses`.
    changes : mapping of str to ndarray
        Numbers by path.
    mode : str, optional
        ``"forward"`` or ``"reverse"``; None: only the values.
    """
    losses = problem.loop.recorder.losses
    first = next(leaf.first for leaf in problem.machine.tape.leaves if leaf.owner == "recorder")
    indices = [first + i for i in range(len(losses))]
    with loop_errors():
        inputs = problem.inputs(changes)
        directions = problem.directions(inputs, changes) if mode else []
        if mode == "forward":
            final, tangents, _ = problem.tangents(inputs, directions)
            slopes = tangents[indices]
        elif mode == "reverse":
            final, slopes = problem.adjoints(inputs, directions, indices)
        else:
            final, slopes = problem.plain(inputs), np.zeros((len(indices), problem.n, 0))
        pairs = [loss.finish(final[i], len(inputs.samples)) for loss, i in zip(losses, indices, strict=True)]
        values = np.array([value for value, _ in pairs])
        slopes = slopes * np.array([slope for _, slope in pairs])[:, :, None]
    return Evaluation(values, slopes, directions, inputs)


_RUNS = 64  # runs of a fit, beside eight for each number


@final
@dataclass(frozen=True)
class Gradient:
    """Value of a loss and its derivatives.

    Attributes
    ----------
    value : float, or ndarray of shape (n,)
        Loss; of each robot if there are several.
    by : dict of str to ndarray
        Derivative by each number, by its path, in the shape of the number; of robots, shape (n, ...).
    units : dict of str to str
        Unit of each number.
    mode : str
        ``"forward"``, ``"reverse"`` or a fit, and the reason.
    kinks : int, or ndarray of shape (n,)
        Number of times that a quantity changes to the other side of a kink, such as a limit, from one sample
        to the next. A derivative is that of the side of each sample.
    slides : int, or ndarray of shape (n,)
        Number of times that a wheel begins or ends to slide.
    errors : dict of str to ndarray
        Standard errors of the derivatives of a fit, see ``smooth`` of `gradient`.
    name : str
        Name of the loss, with its reduction.

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

    value: Any
    by: Mapping[str, Array]
    units: Mapping[str, str]
    mode: str
    kinks: Any = 0
    slides: Any = 0
    errors: Mapping[str, Array] | None = None
    name: str = "loss"

    def __str__(self) -> str:
        is_many = np.ndim(self.value) > 0
        title = f"mean over {np.size(self.value)} robots of {self.name}" if is_many else self.name
        lines = [f"{title} {np.mean(self.value):.6g}, {self.mode}"]
        for path, slopes in self.by.items():
            mean = np.mean(slopes, axis=0) if is_many else slopes
            numbers = [format_si(x, ".6g") for x in np.ravel(mean)]
            if self.errors:
                numbers = [f"{x} +- {e:.1g}" for x, e in zip(numbers, self.errors[path].ravel(), strict=True)]
            suffix = f" per {self.units[path]}" if self.units[path] else ""
            lines.append(
                f"  by {path}: {numbers[0] if len(numbers) == 1 else '(' + ', '.join(numbers) + ')'}{suffix}"
            )
        kinks, slides = int(np.sum(self.kinks)), int(np.sum(self.slides))
        if slides:
            times = f"{slides:,} time{'s' * (slides != 1)}"
            lines.append(
                f"  wheels change between rolling and sliding {times}: the derivative is local, and may say "
                "nothing about finite changes; smooth=0.01 fits the loss over 1 %"
            )
        elif kinks:
            lines.append(
                f"  the side of a kink changes {kinks:,} time{'s' * (kinks != 1)}; the slope is that of each "
                "sample's side"
            )
        return "\n".join(lines)


def gradient(
    loss: Callable[[Sample], Any] | str | Metric,
    plant: Plant,
    controller: Controller,
    trajectory: Trajectory,
    *,
    by: Sequence[str],
    dt: float,
    reduction: str | None = None,
    duration: float | None = None,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    integrator: Integrator | None = None,
    substeps: int = 1,
    forces: Sequence[Force | OnCoordinates] | Mapping[str, Force | OnCoordinates] = (),
    n: int = 1,
    spread: Mapping[str, Source] | None = None,
    seed: int = 0,
    mode: str | None = None,
    smooth: float | None = None,
) -> Gradient:
    """Return a loss of a run and its derivatives by numbers of the parts.

    The derivatives are exact up to rounding: the loop on its tape is differentiated, not the numbers of runs.
    Forward mode carries a tangent for each number; reverse mode runs the adjoints backwards, for all numbers
    at once. Rounding and comparisons have slope 0. At a kink, such as that of dry friction or of a limit, the
    derivative is that of one side: derivatives of laws with many kinks, such as sliding modes, say little.

    Parameters
    ----------
    loss : callable, str or Metric
        Function ``loss(sample)`` in NumPy that returns a number, see `loop.Sample`; or a metric by name:
        "distance", "heading", a coordinate, or one of the plant; or a `metrics.Metric` of your own.
    plant, controller, trajectory, dt, duration, q0, v0, integrator, substeps, forces
        Closed loop, see `simulate`.
    by : sequence of str
        Numbers by path, such as ``"controller.kp"``, ``"mass"``, ``"trajectory.path.radius"`` or
        ``"start.x"``; or by a pattern, such as ``"*.gear"``.
    reduction : str, optional
        "sum", "mean", "rms", "last", "largest" or "smallest" of the samples; default: the sum of a function,
        and the largest size or smallest margin of a metric.
    n, spread, seed
        Robots of an ensemble, see `ensemble`; the derivative by a number of the spread is that by the number
        of each robot.
    mode : str, optional
        ``"forward"`` or ``"reverse"``; default: reverse for more than 8 numbers, forward on dry friction.
    smooth : float, optional
        Half width, relative to each number, at most 0.5: the result is then value and slope of a linear fit
        to runs with numbers from this range, where the exact derivative is of no use. The width of a
        number that is 0, such as a displacement of the start, is relative to 1 of its unit.

    Returns
    -------
    Gradient
        Value and derivatives.

    Raises
    ------
    InvalidArgument
        If an argument is invalid, the loop cannot be compiled, or reverse mode is given for a plant with dry
        friction at its wheels.

    See Also
    --------
    derivatives.tune : lower a loss.
    derivatives.sensitivities : derivatives of all samples.
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
    if mode is not None:
        one_of("mode", mode, ("forward", "reverse"))
    options: dict[str, Any] = {"dt": dt, "duration": duration, "integrator": integrator, "substeps": substeps}
    options |= {"forces": forces, "n": n, "spread": spread, "seed": seed}
    problem = problem_of(
        *(plant, controller, trajectory, lambda scenario: Losses((Loss.read(loss, reduction, scenario),))),
        *(by, (q0, v0)),
        **options,
    )
    units = {path: number.unit for path, number in problem.numbers.items()}
    if smooth is not None:
        with loop_errors():
            return _fit_slopes(problem, bounded("smooth", positive("smooth", smooth), most=0.5))
    selected, reason = mode, "as given"
    if mode is None:
        selected, reason = problem.mode()
    result = evaluate_losses(problem, {}, selected)
    if n == 1 and not (np.isfinite(result.values).all() and np.isfinite(result.slopes).all()):
        raise InvalidArgument(
            f"loss is {result.values[0, 0]} with derivatives {format_value(result.slopes[0, 0])}, expected "
            "finite numbers: the run diverges, or the loss or a law has no finite value or slope at a sample"
        )
    with loop_errors():
        kinks, slides = problem.kinks(result.inputs)
    by_path = arrange_slopes(problem, result.directions, result.slopes[0])
    words, loss_part = f"{selected} mode, {reason}", problem.loop.recorder.losses[0]
    name = loss_part.name if loss_part.name == "loss" else f"{loss_part.reduction} {loss_part.name}"
    if n == 1:
        by_path = {path: x[0] for path, x in by_path.items()}
        times = int(kinks[0]), int(slides[0])
        return Gradient(float(result.values[0, 0]), by_path, units, words, *times, name=name)
    return Gradient(result.values[0], by_path, units, words, kinks, slides, name=name)


def arrange_slopes(problem: Problem, directions: Sequence[Direction], slopes: Array) -> dict[str, Array]:
    """Return slopes by each entry, shape (..., P), by path in the shape of each number."""
    arrays: dict[str, Array] = {}
    for p, direction in enumerate(directions):
        number = problem.numbers[direction.path]
        shape = () if number.entry is not None else problem.nominal[number.leaf.path].shape
        target = arrays.setdefault(direction.path, np.zeros((*slopes.shape[:-1], *shape)))
        index: Any = (..., *(direction.entry if shape else ()))
        target[index] = slopes[..., p]
    return arrays


def _fit_slopes(problem: Problem, share: float) -> Gradient:
    """Return the slopes of a linear fit to runs with numbers from a range around the given ones."""
    scenario = problem.scenario
    if scenario.n > 1:
        raise InvalidArgument("smooth is for one robot, expected n=1")
    refs = named(scenario.nominal_loop)
    entries, directions = dict[str, float](), list[Direction]()
    for path, number in problem.numbers.items():
        is_array = number.entry is None and np.ndim(number.leaf.value) > 0
        parts = [x for x in refs.values() if x.leaf.path == path and x.label] if is_array else [number]
        entries |= {part.path: float(part.value) for part in parts}
        directions += [Direction(path, part.entry or (), -1, None) for part in parts]
    values = np.array([*entries.values()])
    points = np.random.default_rng(scenario.seed).uniform(
        -1.0, 1.0, (_RUNS // 2 + 4 * len(values), len(values))
    )
    steps = np.concatenate([points, -points]) * share * np.where(values == 0, 1.0, np.abs(values))
    spread = {path: value + column for (path, value), column in zip(entries.items(), steps.T, strict=True)}
    robots = replaced(scenario, n=len(steps), spread=spread)
    losses = evaluate_losses(Problem(robots, problem.loop.recorder, (), problem.start), {}, None).values[0]
    columns = np.column_stack([np.ones(len(steps)), steps])
    fit, *_ = np.linalg.lstsq(columns, losses, rcond=None)
    variance = float(((losses - columns @ fit) ** 2).sum()) / (len(steps) - len(fit))
    deviation = np.sqrt(variance * np.diag(np.linalg.inv(columns.T @ columns)))
    slopes, errors = (arrange_slopes(problem, directions, x[1:]) for x in (fit, deviation))
    units = {path: number.unit for path, number in problem.numbers.items()}
    words = f"fit to {len(steps)} runs within {100 * share:g} % of each number"
    words += f", and {share:g} of those that are 0" if (values == 0).any() else ""
    return Gradient(float(fit[0]), slopes, units, words, errors=errors)


@final
@dataclass(frozen=True, eq=False, repr=False)
class Sensitivities:
    """Derivatives of the samples of a run.

    Attributes
    ----------
    rollout : Rollout
        The run.
    q, v, u, a : dict of str to ndarray
        Derivatives of configuration, velocity, input and acceleration by each number, by its path: shape
        (N + 1, nq, ...), followed by the shape of the number.
    units : dict of str to str
        Unit of each number.

    See Also
    --------
    derivatives.sensitivities : compute them.
    plots.sensitivities : figure with bands.

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Tangent
    >>> from pinmobile.derivatives import sensitivities
    >>> circle = Tangent(Circle(1.0, 0.5, 4.0))
    >>> parts = MobileRobot(30.0, 1.3), PD(120, 120), circle
    >>> found = sensitivities(*parts, by=["mass"], dt=0.02)
    >>> found.q["plant.mass"].shape
    (201, 3)
    >>> wide = found.deviation({"mass": 3.0})  # [m, m, rad]
    >>> wide.max(axis=0).round(4)
    array([0.0061, 0.0051, 0.    ])
    """

    rollout: Rollout
    q: Mapping[str, Array]
    v: Mapping[str, Array]
    u: Mapping[str, Array]
    a: Mapping[str, Array]
    units: Mapping[str, str]

    def deviation(self, deviations: Mapping[str, ArrayLike], of: str = "q") -> Array:
        """Return the standard deviation of each sample for independent errors of the numbers, to first order.

        Parameters
        ----------
        deviations : mapping of str to array_like
            Standard deviation of each number, by its path or the end of it.
        of : str
            "q", "v", "u" or "a".

        Returns
        -------
        ndarray, shape (N + 1, n)
            Standard deviations, in the units of the quantity.

        Raises
        ------
        InvalidArgument, UnknownName
            If a path or quantity is unknown, or a deviation does not fit its number.
        """
        slopes = getattr(self, one_of("of", of, ("q", "v", "u", "a")))
        instance("deviations", deviations, Mapping, "a mapping of paths to standard deviations")
        total: Any = 0.0
        for name, value in deviations.items():
            ends = [path for path in slopes if f".{path}".endswith(f".{name}")]
            path = ends[0] if len(ends) == 1 else one_of("deviations", name, slopes)
            size = bounded(f"deviations[{name!r}]", finite(f"deviations[{name!r}]", value), least=0)
            shaped(f"deviations[{name!r}]", size, (), slopes[path].shape[2:])
            square = (slopes[path] * size) ** 2
            total = total + square.reshape(*square.shape[:2], -1).sum(axis=2)
        return np.asarray(np.sqrt(total))

    def __repr__(self) -> str:
        return f"<Sensitivities: {self.rollout.t.size} samples by {', '.join(self.q)}>"


def sensitivities(
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
) -> Sensitivities:
    """Return the derivatives of all samples of a run by numbers of the parts, in forward mode.

    Parameters
    ----------
    plant, controller, trajectory, dt, duration, q0, v0, integrator, substeps, forces
        Closed loop, see `simulate`.
    by : sequence of str
        Numbers by path, see `gradient`.

    Returns
    -------
    Sensitivities
        The run and its derivatives.

    Raises
    ------
    InvalidArgument
        If an argument is invalid, or the loop cannot be compiled.

    See Also
    --------
    derivatives.gradient : derivatives of one number of the run.
    ensemble : finite changes of the numbers.

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Tangent
    >>> from pinmobile.derivatives import sensitivities
    >>> circle = Tangent(Circle(1.0, 0.5, 4.0))
    >>> parts = MobileRobot(30.0, 1.3), PD(120, 120), circle
    >>> found = sensitivities(*parts, by=["controller.kp"], dt=0.02)
    >>> found.q["controller.kp"][-1].round(6)  # [m, m, rad per N/m]
    array([-0.000402,  0.00022 , -0.      ])
    """
    options: dict[str, Any] = {"dt": dt, "duration": duration, "integrator": integrator, "substeps": substeps}
    options["forces"] = forces
    parts = plant, controller, trajectory
    problem = problem_of(*parts, lambda _: Samples(), by, (q0, v0), n=1, **options)
    run = simulate(*parts, q0=q0, v0=v0, engine=Engine.COMPILED, **options)
    with loop_errors():
        inputs = problem.inputs({})
        directions = problem.directions(inputs, {})
        _, _, kept = problem.tangents(inputs, directions)
    q, v, u, a = (
        arrange_slopes(problem, directions, np.moveaxis(kept[f"tangent {name}"][:, : len(run.t)], 0, -1))
        for name in ("q", "v", "u", "a")
    )
    return Sensitivities(run, q, v, u, a, {path: number.unit for path, number in problem.numbers.items()})
