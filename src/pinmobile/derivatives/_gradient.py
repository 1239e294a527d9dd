"""`gradient`: a loss of a run, or of each robot of an ensemble, and its derivatives by numbers of parts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace as replaced
from typing import Any, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, bounded, one_of, positive, sequence
from pinmobile.controllers import Controller
from pinmobile.derivatives._losses import Loss, Losses, evaluate_losses
from pinmobile.derivatives._problem import Direction, Problem, loop_errors, problem_of
from pinmobile.errors import InvalidArgument
from pinmobile.forces import Force
from pinmobile.integrators import Integrator
from pinmobile.loop import Sample, Source
from pinmobile.metrics import Metric, format_si
from pinmobile.parts import OnCoordinates, named
from pinmobile.plant import Plant
from pinmobile.trajectories import Trajectory

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
    if not sequence("by", by, 'paths of numbers, such as ["controller.kp"]'):
        raise InvalidArgument("by is empty, expected paths of numbers")
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
    if n == 1 and not np.isfinite(result.values).all():
        raise InvalidArgument(
            f"loss is {result.values[0, 0]}, expected a finite number: the run diverges, or the loss has no "
            "value at one of its samples"
        )
    if n == 1 and not np.isfinite(result.slopes).all():
        raise InvalidArgument(
            "the derivatives are not finite: the run diverges, or a law has an infinite slope"
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
    entries, indices = dict[str, float](), list[tuple[str, Any]]()
    for path, number in problem.numbers.items():
        is_array = number.entry is None and np.ndim(number.leaf.value) > 0
        parts = [x for x in refs.values() if x.leaf.path == path and x.label] if is_array else [number]
        entries |= {part.path: float(part.value) for part in parts}
        indices += [(path, part.entry if is_array else ()) for part in parts]
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
    slopes: tuple[dict[str, Array], ...] = {}, {}
    for k, (path, entry) in enumerate(indices, 1):
        shape = (
            ()
            if problem.numbers[path].entry is not None
            else problem.nominal[problem.numbers[path].leaf.path].shape
        )
        for target, x in zip(slopes, (fit, deviation), strict=True):
            target.setdefault(path, np.zeros(shape))[entry if shape else ()] = x[k]
    units = {path: number.unit for path, number in problem.numbers.items()}
    words = f"fit to {len(steps)} runs within {100 * share:g} % of each number"
    words += f", and {share:g} of those that are 0" if (values == 0).any() else ""
    return Gradient(float(fit[0]), slopes[0], units, words, errors=slopes[1])
