"""Output error of a planar model, and R^2 of its velocities in free runs over logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.identification._estimator import (
    Fit,
    Linear,
    ResidualNoise,
    Whiteness,
    input_noise_gradient,
    r_squared,
    solve,
)
from pinmobile.identification._planar_model import PlanarProblem
from pinmobile.identification._preprocessing import PreprocessedLog
from pinmobile.identification._search import TRAINED
from pinmobile.identification._simulation import Segments, simulate
from pinmobile.identification._weak_form import WeakForm, beside, fitted

_BIASED = 3.0  # largest bias of output error by input noise [standard deviations]
_DOMINANT = 0.9  # correlation of residuals that unmodelled forces dominate; noise alone seldom reaches it
_COLOURED = 2.5  # multiple of the bound of white residuals: five standard deviations of estimated noise
_DRIFT = 1.0  # largest change of the delay along a log [samples]
_SIGNIFICANT = 5.0  # standard deviations
_FREE = 10.0  # [s], length of a free run
_CHANNELS = "forward speed", "left speed", "yaw rate"
_STILL = 0.05  # speed per largest speed of a direction in which the robot does not move


class Estimate(NamedTuple):
    """Estimate by output error.

    Attributes
    ----------
    fit : Fit
        Fit to the residuals, whitened if force noise contributes to them.
    plain : Fit
        Fit of the initial states alone to residuals that are not whitened.
    gradient : ndarray, shape (P,)
        Contribution of input noise to the gradient.
    bias : float
        Bias by input noise, in standard deviations.
    is_noise : bool
        Whether sensor and input noise explains the residuals. Otherwise the model structure is wrong.
    """

    fit: Fit
    plain: Fit
    gradient: Array
    bias: float
    is_noise: bool


def output_error(problem: PlanarProblem, segments: Segments, moves: bool) -> Estimate:
    """Return the estimate from segments; if `moves` is false, estimate the initial states alone."""
    fit = plain = solve(problem, segments, problem.start, moves=moves)
    if problem.free:
        late = np.arange(len(fit.p)) == len(fit.p) - 1
        given = fit.near if moves else Linear.of(problem, segments, fit.p, fit.starts, lambda r, _: r, late)
        _check_drift(given)
    gradient, bias = np.zeros(len(fit.p)), 0.0
    noise = None if whiteness_of(fit, segments).is_white or not moves else _noise(problem, segments, fit)
    if noise is not None and not noise.remembers:
        # The controller responds to a correlated force, so whitening would fit the controller's response.
        gradient = input_noise_gradient(problem, segments, fit, noise)
        near = Linear.of(problem, segments, fit.p, fit.starts, noise.white)
        way = np.linalg.lstsq(near.information, gradient, rcond=None)[0]
        bias = float(np.sqrt(max(float(gradient @ way), 0.0)))
        if bias < _BIASED:
            fit = solve(problem, segments, fit.p, white=noise.white, starts=fit.starts, pull=gradient)
            plain = solve(problem, segments, fit.p, moves=False)
    left = whiteness_of(plain, segments)
    is_noise = left.is_white
    if not is_noise and np.abs(left.correlation).max() <= _DOMINANT:
        white = _noise(problem, segments, plain).white
        near = Linear.of(problem, segments, plain.p, plain.starts, white, moves=False)
        left = Whiteness.of(near.e.reshape(segments.y.shape), segments.good)
        is_noise = bool(np.abs(left.correlation).max() <= _COLOURED * left.bound)
    return Estimate(fit, plain, gradient, bias, is_noise)


def _noise(problem: PlanarProblem, segments: Segments, fit: Fit) -> ResidualNoise:
    answers = problem.responses(segments.some(segments.few), fit.p, fit.starts[segments.few])
    return ResidualNoise.of(
        segments.weighed(fit.near.residual), segments.good, float(segments.dt[0]), answers
    )


def whiteness_of(fit: Fit, segments: Segments) -> Whiteness:
    """Return the autocorrelation of the residuals of a fit."""
    return Whiteness.of(segments.weighed(fit.near.residual), segments.good)


def _check_drift(near: Linear) -> None:
    """Reject a log in which the delay drifts, because one of two clocks is faster."""
    gradient, curvature = near.normal[:, 0, 0, -1], near.normal[:, 0, -1, -1]
    time = np.linspace(-0.5, 0.5, len(gradient))
    weight = max(float((curvature * time**2).sum()), 1e-300)
    slope = float((gradient * time).sum()) / weight
    deviation = np.sqrt(((gradient - curvature * time * slope) ** 2 * time**2).sum()) / weight
    if abs(slope) > max(_DRIFT, _SIGNIFICANT * deviation):
        raise InvalidArgument(
            f"log has a delay of the poses that changes by {slope:.2g} samples from start to end, expected "
            "times of one clock: one of two clocks is faster"
        )


class _Velocities(PlanarProblem):
    """The problem with velocities in place of measurements."""

    def observed(self, segments: Segments, states: Array, numbers: Array) -> Array:
        """Return the body twist."""
        return np.asarray(states[..., 3:] @ self.model.S.T)


def trained_weakly(form: WeakForm, delay: float, base: Array, basis: Array) -> Array:
    """Return the step along the directions of a basis to the fit of the weak form of early windows."""
    columns, y = form.equations(delay)
    Y = beside(form.Y, columns)
    early = np.concatenate([np.arange(n) < TRAINED * n for n in form.counts])
    first, _ = fitted(Y[early], y[early], [int(early.sum())], base, basis)
    whole, _ = fitted(Y, y, form.counts, base, basis)
    return np.asarray(np.linalg.pinv(basis) @ (first.phi - whole.phi))


def free_run(
    problem: PlanarProblem, runs: Sequence[PreprocessedLog], p: Array, early: Array
) -> Mapping[str, tuple[float, float]]:
    """Return R^2 by channel: of all logs, and of the last third for numbers of the first two thirds.

    Parameters
    ----------
    problem : PlanarProblem
        The model.
    runs : sequence of PreprocessedLog
        The logs. Each free run starts from measured poses and velocities.
    p, early : ndarray, shape (P,)
        Numbers of the whole logs, and of the first two thirds.
    """
    model = problem.model
    free = _Velocities(model, problem.base, problem.basis, problem.delay, problem.free)
    found, late = list[Array](), list[Array]()
    for run in runs:
        seconds = min(_FREE, 0.3 * len(run.q) * run.dt)
        segments = run.segments(model, problem.delay, seconds, False)
        if not len(segments.y):
            continue
        twist = run.free_velocities(model) @ model.S.T
        measured = twist[np.rint(segments.t / run.dt).astype(int)]
        starts = np.repeat(segments.start[None], 2, axis=0)
        out = simulate(free, segments, np.stack([p, early]), starts)
        found.append(np.stack([measured, measured - out[0]])[:, segments.good])
        held = segments.good & (segments.t > TRAINED * len(run.q) * run.dt)
        late.append(np.stack([measured, measured - out[1]])[:, held])
    if not found:
        return {}
    rows = [np.concatenate(each, axis=1) for each in (found, late)]
    speeds = np.sqrt((rows[0][0] ** 2).mean(axis=0))
    moves = [*(speeds[:2] > _STILL * speeds[:2].max()), True]
    shares = [r_squared(*each) for each in rows]
    pairs = zip(_CHANNELS, moves, *(share.tolist() for share in shares), strict=True)
    return MappingProxyType({name: (one, other) for name, is_moved, one, other in pairs if is_moved})
