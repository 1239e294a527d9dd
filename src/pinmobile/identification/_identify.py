"""`identify`: the weak form, the delay and the identifiable directions, then output error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array, bounded, instance, one_of, scalar, sequence
from pinmobile.errors import InvalidArgument, shown
from pinmobile.identification._estimates import Identification
from pinmobile.identification._estimator import (
    Fit,
    Linear,
    ResidualNoise,
    Whiteness,
    input_noise_gradient,
    jackknife,
    solve,
    unexplained,
)
from pinmobile.identification._log import Log, check_steps, logs_of
from pinmobile.identification._planar_model import PlanarModel, PlanarProblem
from pinmobile.identification._preprocessing import PreprocessedLog, Slippage
from pinmobile.identification._simulation import Segments
from pinmobile.identification._weak_form import WINDOW, WeakFit, WeakForm
from pinmobile.robot import MobileRobot, PayloadBody
from pinmobile.wheels import WheeledRobot, WheelTable

METHODS = ("output error", "weak")

_CLIPPED = 0.02  # of the rows
_LEAST_SEGMENTS = 20  # fewer do not show how they differ
_LENGTHS = 2.0, 1.5, 1.0  # [s] of a segment, the first that gives enough of them
_LATEST, _EARLIEST = 0.3, 0.05  # [s], range of delays
_EXPLAINED = 0.5  # least share of the forces' mean square
_MOST_GIVEN = 0.1  # largest given delay, as a share of the log
_BIASED = 3.0  # standard deviations by which noise of inputs may bias output error
_DRIFT = 1.0  # sample by which a delay may change along a log
_MASSES = (0.02, 2e4)  # [kg] of ground robots
_WIDEST = 10.0  # [m], largest radius of gyration, and distance of the centre of mass
_LIGHTEST = 1.0  # [kg/m^2], mass per square of the radius of gyration; that of robots is some 100
_TIMES_NOMINAL = 30.0
_SIGNIFICANT = 5.0  # standard deviations
_COLOURED = 2.5  # times the bound of white residuals: five deviations of estimated noise
_EARLY, _SURE = 0.5, 3.0  # sample, and standard deviations, by which poses may come before their inputs
_DOMINANT = 0.9  # correlation of residuals that are almost only forces, which noise alone seldom has


def identify(
    log: Log | Sequence[Log],
    robot: Any = None,
    *,
    loads: Sequence[PayloadBody | None] | None = None,
    method: str = "output error",
    delay: float | None = None,
    rolling_speed: float | None = None,
) -> Identification:
    """Estimate mass, centre of mass, yaw inertia and friction from a robot log, with confidence intervals.

    The weak form, which needs no accelerations, gives the start. Then simulations of 2 s are fitted to the
    log (output error). Intervals are those of the jackknife over these segments (CR3) with Student's t. They
    are valid where poses and forces are noisy. They do not cover the error of a wrong structure, such as slip
    or resistance that depends on load: `Identification.is_noise` states whether residuals show one. A
    constant offset of each input is estimated too, where the motion separates it from friction. Inputs are
    constant between samples.

    Parameters
    ----------
    log : Log or sequence of Log
        Measurements: at least 20 s of an informative motion, see `excitation`.
    robot : MobileRobot, WheeledRobot or WheelTable, optional
        Robot assumed before: its numbers are kept where they are not identifiable; its wheels and motors stay
        as they are. A wheel table assumes nothing else; the input is volts where wheels have electric motors,
        otherwise torques. Default: a body pushed by forces.
    loads : sequence of PayloadBody or None, optional
        Load that the robot carried in each log, in the body's frame. Loads that differ identify the scale of
        the input too, such as an unknown torque constant: of logs of currents, the torque per ampere. One
        scale is for all inputs.
    method : str
        ``"output error"``, or ``"weak"``, the start alone: linear and fast, with intervals several times as
        wide where forces are known well, and similar ones where they are not. It replaces output error where
        noise of the inputs would bias that by more than three standard deviations.
    delay : float, optional
        Delay of poses relative to inputs [s]; default: estimated.
    rolling_speed : float, optional
        Speed at which dry friction has 71 % of its size; default 0.01 m/s and rad/s, of wheels 0.1 rad/s.

    Returns
    -------
    found : Identification
        The estimates.

    Raises
    ------
    InvalidArgument
        If the log is too short, or of another robot, the units are wrong, the clocks drift, or a direction is
        not identifiable and no robot is given.
    """
    logs = logs_of(log)
    one_of("method", method, METHODS)
    alone = isinstance(robot, WheelTable)
    robot = _on_wheels(robot) if alone else robot
    carried = _moments(loads, len(logs))
    model = PlanarModel.of(robot, rolling_speed, loads is not None)
    names = ["log"] if len(logs) == 1 else [f"log[{k}]" for k in range(len(logs))]
    triples = zip(logs, carried, names, strict=True)
    runs = [PreprocessedLog.of(one, model, each, name) for one, each, name in triples]
    check_steps([one.dt for one in runs])
    slips = [each for one, name in zip(runs, names, strict=True) if (each := Slippage.of(one, model, name))]
    worst = max(slips, key=lambda each: each.share, default=None)
    clipped = "; ".join(filter(None, (_clipped(one, model, n) for one, n in zip(logs, names, strict=True))))
    if delay is not None:
        most = _MOST_GIVEN * min(len(one.q) * one.dt for one in runs)
        delay = bounded("delay", scalar("delay", delay), least=-most, most=most, unit="s")
    prior = None if alone or robot is None else model.prior(robot)
    try:
        found = _identified(runs, model, prior, method, delay)
    except InvalidArgument as error:
        hints = [f"Its {worst}"] * bool(worst is not None and worst.matters) + [clipped] * bool(clipped)
        raise InvalidArgument(" ".join([str(error), *hints])) from error
    dropped = sum(one.dropped for one in logs)
    return replace(found, dropped=dropped, prior=robot, slippage=worst, clipped=clipped)


def _clipped(log: Log, model: PlanarModel, name: str) -> str:
    """Return which inputs of a log stay at their extremes, as clipped ones do; "" if none does."""
    found = []
    for one, u in zip(model.inputs, log.u.T, strict=True):
        extreme = ((u == u.max()) | (u == u.min())) & (u != 0) & (np.ptp(u) > 0)
        stays = extreme[2:] & (u[2:] == u[1:-1]) & (u[1:-1] == u[:-2])
        if stays.mean() > _CLIPPED:
            extremes = (
                f"stays at {u.min():.4g} or {u.max():.4g}, its extremes, in {stays.mean():.0%} of the rows"
            )
            found.append(f"input {one} of {name} {extremes}: if it was clipped, the estimates are wrong")
    return "; ".join(found)


def _identified(
    runs: Sequence[PreprocessedLog], model: PlanarModel, prior: Array | None, method: str, delay: float | None
) -> Identification:
    """Return the estimates from preprocessed logs."""
    dt, given = runs[0].dt, delay is not None
    seconds, form = _segment(runs), WeakForm.of(runs, model)
    for offset in (True, False):  # offsets where the motion identifies them
        form = replace(form, model=replace(model, offset=offset))
        scales = form.scales()
        seen, unseen = form.directions(scales)
        if not unseen.size:
            break
    model, told = form.model, _in_words(form.model, unseen)
    if prior is not None and model.offset:
        prior = np.insert(prior, model.dry.stop, np.zeros(model.nu))
    if told and prior is None:
        raise InvalidArgument(
            f"log has a motion of rank {seen.shape[1]} of {len(scales)}: {told}; expected one that excites "
            "more, see excitation, or robot=..., which is kept where nothing is seen"
        )
    basis, base = scales[:, None] * seen, np.zeros(len(scales)) if prior is None or not told else prior
    late = _first_delay(form, base, basis) if delay is None else delay / dt
    fit = form.extrapolated(late, base, basis, not given and not told)
    _check(model, fit, prior)
    rates = any(one.rates is not None for one in runs)
    segments = Segments.joined([one.segments(model, fit.delay, seconds, rates) for one in runs])
    kept = len(segments.start)
    if kept < _LEAST_SEGMENTS // 2:
        raise InvalidArgument(
            f"log has {kept} segments of {seconds:g} s in which half of the poses are measured and no "
            f"outliers, expected {_LEAST_SEGMENTS}: does the motion jump between poses?"
        )
    start = model.possible(fit.phi, scales)
    problem = PlanarProblem(model, start, basis, fit.delay, not given and not told)
    estimate = _output_error(problem, segments, method == METHODS[0])
    bias = estimate.bias
    if method == METHODS[0] and bias >= _BIASED:
        method, estimate = METHODS[1], _output_error(problem, segments, False)
    if method == METHODS[0]:
        phi, samples = problem.values(estimate.fit.p)
        late, freedom, free = float(samples), kept - 1, estimate.covariance
        covariance = basis @ free[: basis.shape[1], : basis.shape[1]] @ basis.T
        error = float(np.sqrt(free[-1, -1])) if problem.free else np.nan
        _check(model, fit._replace(phi=phi), prior)
    else:
        phi, covariance, late, error = fit.phi, fit.covariance, fit.delay, fit.delay_error
        freedom = max(5, round(sum(len(one.q) * one.dt for one in runs) / WINDOW) - len(phi))
    if not given:
        _check_late(late, error, dt)
    measured = segments.good[..., None] & np.isfinite(segments.noise)[:, None]
    residual = np.where(measured, estimate.plain.near.residual, 0.0)
    count = max(1, int(measured.sum()) - basis.shape[1] - segments.start.size)
    outliers = sum(one.outliers for one in runs)
    return Identification(
        model=model,
        phi=phi,
        covariance_of_phi=covariance,
        freedom=freedom,
        method=method,
        input_noise_bias=bias,
        rank=seen.shape[1],
        unseen=told,
        hidden=(unseen**2).sum(axis=1),
        unknown=scales[:, None] * unseen,
        delay=late * dt,
        delay_error=error * dt,
        dt=dt,
        outliers=outliers,
        dropped=0,
        samples=outliers + sum(int(one.good.sum()) for one in runs),
        segments=kept,
        seconds=seconds,
        noise=runs[0].noise,
        residual=np.sqrt((residual[..., :3] ** 2).sum(axis=(0, 1)) / segments.good.sum()),
        chi2=float((segments.weighed(residual) ** 2).sum()) / count,
        whiteness=_whiteness(estimate.plain, segments),
        is_noise=estimate.is_noise,
        explained=fit.explained,
    )


class _Estimate(NamedTuple):
    """Estimate by output error.

    Attributes
    ----------
    fit, plain : Fit
        The fit to residuals made white where noise of forces is behind them, and first states that fit best
        to residuals as they are.
    covariance : ndarray, shape (P, P)
        Covariance of the numbers.
    bias : float
        Bias by noise of the inputs, in standard deviations.
    is_noise : bool
        Whether noise of sensors and inputs explains the residual: otherwise the structure is wrong.
    """

    fit: Fit
    plain: Fit
    covariance: Array
    bias: float
    is_noise: bool


def _output_error(problem: PlanarProblem, segments: Segments, moves: bool) -> _Estimate:
    """Return the estimate of segments, or where nothing moves the residual at its start."""
    fit = plain = solve(problem, segments, problem.start, moves=moves)
    if problem.free:
        _check_drift(fit.near)
    gradient, bias = np.zeros(len(fit.p)), 0.0
    noise = None if _whiteness(fit, segments).is_white or not moves else _noise(problem, segments, fit)
    if noise is not None and not noise.remembers:
        # A controller may answer to a force that remembers: weights for it would be those of the answer.
        gradient = input_noise_gradient(problem, segments, fit, noise)
        near = Linear.of(problem, segments, fit.p, fit.starts, noise.white)
        way = np.linalg.lstsq(np.einsum("smp,smq->pq", near.J, near.J), gradient, rcond=None)[0]
        bias = float(np.sqrt(max(gradient @ way, 0.0)))
        if bias < _BIASED:
            shift = -near.J @ way
            fit = solve(problem, segments, fit.p, white=noise.white, starts=fit.starts, shift=shift)
            plain = solve(problem, segments, fit.p, moves=False)
    left = _whiteness(plain, segments)
    is_noise = left.is_white
    if not is_noise and np.abs(left.correlation).max() <= _DOMINANT:
        white = _noise(problem, segments, plain).white
        near = Linear.of(problem, segments, plain.p, plain.starts, white)
        left = Whiteness.of(near.e.reshape(segments.y.shape), segments.good)
        is_noise = bool(np.abs(left.correlation).max() <= _COLOURED * left.bound)
    return _Estimate(fit, plain, jackknife(fit.near, gradient), bias, is_noise)


def _noise(problem: PlanarProblem, segments: Segments, fit: Fit) -> ResidualNoise:
    answers = problem.responses(segments, fit.p, fit.starts)
    return ResidualNoise.of(
        segments.weighed(fit.near.residual), segments.good, float(segments.dt[0]), answers
    )


def _whiteness(fit: Fit, segments: Segments) -> Whiteness:
    return Whiteness.of(segments.weighed(fit.near.residual), segments.good)


def _moments(loads: Sequence[PayloadBody | None] | None, count: int) -> list[Array]:
    """Return mass, moments and inertia about the body's origin of the load of each log, shape (4,) each."""
    expected = (
        f"a PayloadBody or None for each of {count} logs, which differ: they identify the scale of the input"
    )
    given = [None] * count if loads is None else sequence("loads", loads, expected)
    found = []
    for each in given:
        load: Any = instance("loads", each, PayloadBody | None, expected)
        m, x, y, inertia = (load.mass, *load.com[:2], load.inertia[2]) if load else (0.0,) * 4
        found.append(np.array([m, m * x, m * y, inertia + m * (x * x + y * y)]))
    if len(found) != count or (loads is not None and all(np.array_equal(x, found[0]) for x in found)):
        raise InvalidArgument(f"loads is {shown(loads)}, expected {expected}")
    return found


def _on_wheels(table: WheelTable) -> Any:
    """Return a robot on wheels, with an arbitrary body heavier than these."""
    robot = WheeledRobot(MobileRobot(1e4, 1e4), table)
    return robot.by_voltage() if any(each.motor.is_electric for each in table.actuators) else robot


def _check_late(late: float, error: float, dt: float) -> None:
    if late < -_EARLY - _SURE * error:
        raise InvalidArgument(
            f"log has poses {-1e3 * late * dt:.3g} ms ({-late:.1f} samples) ahead of the inputs that move "
            "the robot, expected a delay of 0 or more: are they of two clocks, are inputs clipped, or does a "
            "force act that the model lacks? delay=0 takes it as zero."
        )


def _segment(logs: Sequence[PreprocessedLog]) -> float:
    """Return the length of segments [s]."""
    spans = np.array([len(one.q) * one.dt for one in logs])
    for seconds in _LENGTHS:
        if np.floor(spans / seconds - 0.3).sum() >= _LEAST_SEGMENTS:
            return seconds
    raise InvalidArgument(
        f"log is {spans.sum():.3g} s long, too short, expected at least "
        f"{(_LEAST_SEGMENTS + 0.5) * _LENGTHS[-1]:g} s, better 60 s: intervals come from many segments"
    )


def _first_delay(form: WeakForm, base: Array, basis: Array) -> float:
    """Return the delay at which the weak form leaves least, in samples."""
    if basis.shape[1] < len(base):
        return 0.0  # the motion does not identify it
    dt = form.logs[0].dt
    delays = np.arange(-max(2, round(_EARLIEST / dt)), max(4, round(_LATEST / dt)) + 0.25, 0.5)
    k, late, explained = form.first_delay(delays, base, basis)
    if explained < _EXPLAINED:
        raise unexplained(explained)
    if k == 0:
        _check_late(late, 0.0, dt)
    if k == len(delays) - 1:
        raise InvalidArgument(
            f"log has poses that come late by {dt * late:.3g} s or more, expected less: are poses and "
            "inputs of two clocks?"
        )
    return late


def _check_drift(near: Linear) -> None:
    """Refuse a log whose delay changes along it, because one of two clocks is faster."""
    by_delay = near.J[..., -1]
    gradient, curvature = (by_delay * near.e).sum(axis=1), (by_delay**2).sum(axis=1)
    time = np.linspace(-0.5, 0.5, len(gradient))
    weight = max(float((curvature * time**2).sum()), 1e-300)
    slope = float((gradient * time).sum()) / weight
    deviation = np.sqrt(((gradient - curvature * time * slope) ** 2 * time**2).sum()) / weight
    if abs(slope) > max(_DRIFT, _SIGNIFICANT * deviation):
        raise InvalidArgument(
            f"log has poses whose delay changes by {slope:.2g} samples from start to end: two clocks, "
            "one of which is faster, expected times of one"
        )


def _check(model: PlanarModel, fit: WeakFit, prior: Array | None) -> None:
    """Refuse estimates of no robot, or of another one than is assumed."""
    if fit.explained < _EXPLAINED:
        raise unexplained(fit.explained)
    phi, mass = fit.phi, float(fit.phi[0])
    wrong, ratio = f"a mass of {mass:.3g} kg", 1.0 if prior is None else mass / prior[0]
    is_so = not _MASSES[0] < mass < _MASSES[1]
    if mass > 0 and not 1 / _TIMES_NOMINAL < ratio < _TIMES_NOMINAL:
        wrong, is_so = f"{wrong}, {ratio:.3g} times that of the robot", True
    elif not is_so and model.are_possible(phi):
        radius = float(np.sqrt(model.to_physical(phi)[3] / mass))
        is_so = max(radius, np.hypot(*phi[1:3]) / mass) > _WIDEST or mass < _LIGHTEST * radius**2
        wrong = f"a radius of gyration of {radius:.3g} m with {wrong}"
    if is_so:
        raise InvalidArgument(
            f"log leads to {wrong}, expected those of a robot: are forces in N, moments in N m, positions in "
            "metres and psi in radians, or have inputs another sign or frame?"
        )


def _in_words(model: PlanarModel, unseen: Array) -> str:
    """Return directions of the parameters that are not identifiable in words; "" where all are."""
    from scipy.sparse.csgraph import connected_components  # here, because it takes long to load

    names, hidden = np.array([one.name for one in model.quantities]), unseen @ unseen.T
    share = np.diag(hidden)
    alone, mixed = names[share > 0.98], np.flatnonzero((share > 0.02) & (share <= 0.98))
    count, group = connected_components(np.abs(hidden[np.ix_(mixed, mixed)]) > 0.05)
    told = [f"the motion does not tell {', '.join(alone)}"] if alone.size else []
    groups = (", ".join(names[mixed[group == k]]) for k in range(count))
    return "; ".join([*told, *(f"of {each} it tells combinations alone" for each in groups)])
