"""`identify`: the weak form gives first estimates and the identifiable directions; output error refines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array, absent, bounded, instance, one_of, scalar, sequence
from pinmobile.errors import InvalidArgument, unexpected_value
from pinmobile.identification._estimates import Identification, format_directions
from pinmobile.identification._estimator import (
    LEAST_RESIDUAL,
    Fit,
    Linear,
    ResidualNoise,
    Whiteness,
    check_share,
    input_noise_gradient,
    jackknife,
    r_squared,
    solve,
)
from pinmobile.identification._files import clock_hint
from pinmobile.identification._log import Log, continuous, logs_of, lost_rows, unused_rows
from pinmobile.identification._planar_model import PlanarModel, PlanarProblem
from pinmobile.identification._plant import identify_plant
from pinmobile.identification._preprocessing import PreprocessedLog, Slippage
from pinmobile.identification._simulation import Segments, simulate_states
from pinmobile.identification._torque_car import identify_car
from pinmobile.identification._velocity import TRAINING
from pinmobile.identification._weak_form import WINDOW, WeakFit, WeakForm, append_columns, robust_fit
from pinmobile.parts import Tabled, offers
from pinmobile.robot import MobileRobot, PayloadBody
from pinmobile.wheels import WheeledRobot, WheelTable

METHODS = ("output error", "weak")

_CLIP_SHARE = 0.02  # share of rows at an extreme from which an input counts as clipped
_BOTH_WAYS = 0.05  # share of the rows in which a wheel turns fast, each way
_LEAST_SEGMENTS = 20  # fewer segments do not show the scatter
_LENGTHS = 2.0, 1.5, 1.0  # [s] of a segment: the first length that gives enough segments
_SHORTEST = (_LEAST_SEGMENTS + 0.5) * _LENGTHS[-1]  # [s], shortest log
_LATEST, _EARLIEST = 0.3, 0.05  # [s], range of delays
_MIN_EXPLAINED = 0.5  # smallest explained share of the mean square of the forces
_CLEAR = 0.95  # explained share of the forces above which their frame is clear
_FRAME_RATIO = 1 / 3  # largest ratio of unexplained shares, rotated to given, that shows the body frame
_MOST_GIVEN = 0.1  # largest given delay, as a share of the log
_MAX_BIAS = 3.0  # largest bias of output error by input noise [standard deviations]
_MASSES = (0.02, 2e4)  # [kg], range of ground robots
_WIDEST = 10.0  # [m], largest radius of gyration, and largest distance of the centre of mass
_LIGHTEST = 1.0  # [kg/m^2], smallest mass per squared radius of gyration; robots have about 100
_TIMES_NOMINAL = 30.0  # largest ratio of an estimated mass and the prior
_EARLY, _SURE = 0.5, 3.0  # samples, and standard deviations, by which poses may precede their inputs
_DOMINANT = 0.9  # correlation of residuals that unmodelled forces dominate; noise alone seldom reaches it
_WHITENESS = 2.5  # multiple of the bound of white residuals: five standard deviations of estimated noise
_DRIFT = 1.0  # largest change of the delay along a log [samples]
_SIGNIFICANT = 5.0  # standard deviations
_FREE = 10.0  # [s], length of a free run
_CHANNELS = "forward speed", "left speed", "yaw rate"
_MIN_SPEED = 0.05  # speed per largest speed of a direction in which the robot does not move


def identify(
    log: Log | Sequence[Log],
    robot: Any = None,
    *,
    loads: Sequence[PayloadBody | None] | None = None,
    by: str | Sequence[str] = (),
    method: str = "output error",
    delay: float | None = None,
    rolling_speed: float | None = None,
) -> Identification:
    """Estimate mass, centre of mass, yaw inertia and friction from a robot log, with confidence intervals.

    The weak form of the equations of motion, which needs no accelerations, gives first estimates. Output
    error then fits simulations of segments of 2 s to the log. The confidence intervals come from the
    jackknife over the segments (CR3) with Student's t.

    The intervals are valid if poses and forces are noisy. They do not cover the error of a wrong model, such
    as slip or resistance that depends on load: see `Identification.is_noise`. `identify` also estimates a
    constant offset of each input if the motion separates the offset from friction.

    Parameters
    ----------
    log : Log or sequence of Log
        Measurements: at least 20 s of an informative motion, see `excitation`.
    robot : MobileRobot, WheeledRobot or WheelTable, optional
        Prior robot. Its numbers replace those that the log does not identify. Its wheels and motors are not
        estimated. A wheel table gives only the wheels: its inputs are voltages if the wheels have electric
        motors, otherwise torques. Default: a body driven by forces, without prior numbers.

        The last input of a car (`WheelTable.car`) is its measured steering angle [rad], in place of a torque.
        Its wheels roll. If they have a `wheels.WheelFriction` with ``slip`` on `Coulomb` ground, the
        estimates include the cornering stiffness of both axles [N s/m] and the centre of mass.
    loads : sequence of PayloadBody or None, optional
        Load on the robot in each log, in the body frame. Loads that differ make the scale of the inputs
        identifiable, such as an unknown torque constant or the torque per ampere. All inputs have one scale.
    by : str or sequence of str
        Numbers of the robot to estimate in place of these, by path as in a spread: ``"left.radius"``, or by
        pattern, such as ``"*_link.mass"`` for all links of an arm. They are fitted to free runs of the robot
        over segments of the log, with their initial states. Directions that the log does not identify keep
        the prior values. The log has joint positions if the robot has arms.
    method : str
        ``"output error"`` or ``"weak"``. The weak form alone is linear and fast. Its intervals are several
        times as wide if the forces are well known, and similar otherwise. It also replaces output error if
        input noise would bias output error by more than three standard deviations.
    delay : float, optional
        Delay of poses relative to inputs [s]; default: estimated. With `by`: default 0, rounded to samples.
    rolling_speed : float, optional
        Speed at which the smoothed dry friction reaches 71 % of its size. Default: 0.01 m/s and rad/s for a
        body, 0.1 rad/s for wheels.

    Returns
    -------
    found : Identification
        Estimates with their uncertainty.

    Raises
    ------
    InvalidArgument
        If the log is too short or from another robot, units are wrong, clocks drift, or a parameter is not
        identifiable and `robot` is not given.

    See Also
    --------
    Log : measurements
    excitation : informative motion within limits
    identify_velocity : the same for a robot with velocity inputs
    identification.Identification : the result

    Examples
    --------
    A simulated robot of 30 kg gives the log:

    >>> from pinmobile import ComputedTorque, Lissajous, Log, Tangent
    >>> from pinmobile import MobileRobot, identify, rk4, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> motion = Tangent(Lissajous(1, 1, 1.0, 0.5, duration=24))
    >>> run = simulate(robot, ComputedTorque(robot), motion,
    ...                dt=0.1, integrator=rk4)
    >>> found = identify(Log.from_rollout(run, noise=1e-3), robot)
    >>> round(found.parameters["mass"], 1)  # [kg]
    30.0

    Any numbers of a robot, here its mass alone:

    >>> log = Log.from_rollout(run, noise=1e-3)
    >>> found = identify(log, MobileRobot(25.0, 1.3), by="mass")
    >>> round(found.robot().mass)  # [kg]
    30
    """
    logs = logs_of(log)
    selected = None if one_of("method", method, METHODS) == METHODS[0] else method
    if by:
        absent("with by", loads=loads, method=selected, rolling_speed=rolling_speed)
        return identify_plant(logs, robot, by, delay)
    is_table = isinstance(robot, WheelTable)
    robot = _on_wheels(robot) if is_table else robot
    if robot is not None and offers(robot, Tabled) and robot.table.axes:
        absent("for a car", loads=loads, method=selected)
        return identify_car(logs, robot, delay, rolling_speed, is_table)
    moments = _moments(loads, len(logs))
    model = PlanarModel.of(robot, rolling_speed, loads is not None)
    if model.wheels:
        logs = [_add_rates(one, model) for one in logs]
        model = replace(model, blind=all(one.q is None for one in logs))
    names = ["log"] if len(logs) == 1 else [f"log[{k}]" for k in range(len(logs))]
    triples = zip(logs, moments, names, strict=True)
    parts = [(each, load, n) for one, load, n in triples for each in continuous(one, n, *model.sensors)]
    dt = max(part.step_of(*model.sensors) for part, _, _ in parts)
    runs = [PreprocessedLog.of(part, model, load, name, dt) for part, load, name in parts]
    if model.wheels and model.nu == len(model.A):
        _check_signs(runs, model, [name for _, _, name in parts])
    slips = [Slippage.of(run, model, name) for run, (_, _, name) in zip(runs, parts, strict=True)]
    worst = max(filter(None, slips), key=lambda each: each.share, default=None)
    pairs = zip(logs, names, strict=True)
    clips = "; ".join(text for one, name in pairs for text in _format_clips(one, model, name))
    if delay is not None:
        largest = _MOST_GIVEN * min(len(one.q) * one.dt for one in runs)
        delay = bounded("delay", scalar("delay", delay), least=-largest, most=largest, unit="s")
    prior = None if is_table or robot is None else model.prior(robot)
    try:
        result = _estimate_body(runs, model, prior, method, delay)
    except InvalidArgument as error:
        slip = f"Its {worst}" if worst is not None and worst.matters else ""
        first = parts[0][0]
        motion: Any = first.wheel_rates if first.q is None else first.q
        hints = slip, clips, clock_hint(first.t, first.u, motion, first.q is not None)
        raise InvalidArgument(" ".join(filter(None, [str(error), *hints]))) from error
    rows = sum(one.dropped + unused_rows(one, *model.sensors) for one in logs)
    return replace(result, dropped=rows, prior=robot, slippage=worst, clipped=clips)


def _check_signs(runs: Sequence[PreprocessedLog], model: PlanarModel, names: Sequence[str]) -> None:
    """Reject inputs of wheels without a sign, as of a current sensor."""
    for run, name in zip(runs, names, strict=True):
        rates = run.rates_of(model)
        for name_u, u, rate in zip(model.inputs, run.u.T, rates.T, strict=True):
            usual = 0.1 * np.abs(rate).max()
            share = min((rate > usual).mean(), (rate < -usual).mean())
            if share > _BOTH_WAYS and (u.min() >= 0 or u.max() <= 0) and u.any():
                raise InvalidArgument(
                    f"{name} has input {name_u} from {u.min():.3g} to {u.max():.3g}, but its wheel turns "
                    "both ways, expected an input with a sign: of a current, np.copysign(current, command)"
                )


def _add_rates(log: Log, model: PlanarModel) -> Log:
    """Return a log with twists alone as a log with the rates of the wheels that roll so."""
    if log.twist is None or log.q is not None or log.wheel_rates is not None:
        return log
    rates = log.twist @ np.linalg.pinv(model.S).T @ model.A.T
    count = log.dropped - int(lost_rows({"": rates}).sum())
    return replace(log, twist=None, wheel_rates=rates, dropped=count)


def _format_clips(log: Log, model: PlanarModel, name: str) -> list[str]:
    """Return in words the inputs of a log that stay at their extremes, as clipped inputs do."""
    out = []
    for key, u in zip(model.inputs, log.u.T, strict=True):
        extreme = ((u == u.max()) | (u == u.min())) & (u != 0) & (np.ptp(u) > 0)
        stays = extreme[2:] & (u[2:] == u[1:-1]) & (u[1:-1] == u[:-2])
        if stays.mean() > _CLIP_SHARE:
            ends = f"at {u.min():.4g} or {u.max():.4g}, its extremes, in {stays.mean():.0%} of the rows"
            out.append(f"input {key} of {name} stays {ends}: if this input was clipped, estimates are wrong")
    return out


def _estimate_body(
    runs: Sequence[PreprocessedLog], model: PlanarModel, prior: Array | None, method: str, delay: float | None
) -> Identification:
    """Return the estimates from preprocessed logs."""
    dt, given = runs[0].dt, delay is not None
    seconds, form = _segment(runs), WeakForm.of(runs, model)
    for offset in (True, False):  # offsets where the motion identifies them
        form = replace(form, model=replace(model, offset=offset))
        scales = form.scales()
        span, null = form.directions(scales)
        if not null.size:
            break
    model, gaps = form.model, format_directions([one.name for one in form.model.quantities], null)
    if prior is not None and model.offset:
        prior = np.insert(prior, model.dry.stop, np.zeros(model.nu))
    if gaps and prior is None:
        raise InvalidArgument(
            f"log has a motion of rank {span.shape[1]} of {len(scales)}: {gaps}; expected a more informative "
            "motion (see excitation), or robot=... with prior values of these parameters"
        )
    basis, base = scales[:, None] * span, np.zeros(len(scales)) if prior is None or not gaps else prior
    lag = _first_delay(form, base, basis) if delay is None else delay / dt
    fit = form.extrapolate(lag, base, basis, not given and not gaps)
    if delay is not None:  # else `_first_delay` has checked it
        _check_frame(form, base, basis, np.array([lag]), fit.explained)
    _check(model, fit, prior)
    rates = any(one.rates is not None for one in runs)
    each = [one.segments(model, fit.delay, seconds, rates) for one in runs]
    ends = (TRAINING * len(one.q) * one.dt for one in runs)
    train = np.concatenate([part.t[:, 0] < end for part, end in zip(each, ends, strict=True)])
    segments = Segments.join(each)
    size = len(segments.start)
    if size < _LEAST_SEGMENTS // 2:
        raise InvalidArgument(
            f"log has {size} segments of {seconds:g} s with at least half of the poses measured and without "
            f"outliers, expected {_LEAST_SEGMENTS}: do the poses jump?"
        )
    start = model.possible(fit.phi, scales)
    problem = PlanarProblem(model, start, basis, fit.delay, not given and not gaps)
    estimate = _output_error(problem, segments, method == METHODS[0])
    bias = estimate.bias
    if method == METHODS[0] and bias >= _MAX_BIAS:
        method, estimate = METHODS[1], _output_error(problem, segments, False)
    if method == METHODS[0]:
        freedom, p = size - 1, estimate.fit.p
        free, _ = jackknife(estimate.fit.linear, estimate.gradient)
        phi, samples = problem.values(p)
        lag, error = float(samples), float(np.sqrt(free[-1, -1])) if problem.free else np.nan
        if problem.free and lag < 0:
            phi, _ = problem.values(p - free[:, -1] / free[-1, -1] * lag)  # the estimate for no delay
        covariance = basis @ free[: basis.shape[1], : basis.shape[1]] @ basis.T
        _check(model, fit._replace(phi=phi), prior)
        step = estimate.fit.linear.step(train)
    else:
        phi, covariance, lag, error = fit.phi, fit.covariance, fit.delay, fit.delay_error
        freedom = max(5, round(sum(len(one.q) * one.dt for one in runs) / WINDOW) - len(phi))
        p, step = np.zeros(basis.shape[1]), _weak_training_step(form, fit.delay, base, basis)
        problem = PlanarProblem(model, phi, basis, fit.delay)
    remarks = []
    if not given:
        _check_delay(lag, error, dt)
        if lag < -min(_EARLY, 2 * error):
            remarks.append(f"the delay is taken as zero: its estimate is {1e3 * lag * dt:.3g} ms")
        lag = max(lag, 0.0)
    measured = segments.good[..., None] & np.isfinite(segments.noise)[:, None]
    residual = np.where(measured, estimate.first_fit.linear.residual, 0.0)
    count = max(1, int(measured.sum()) - basis.shape[1] - segments.start.size)
    outliers, full = sum(one.outliers for one in runs), [one for one in runs if np.isfinite(one.noise).all()]
    return Identification(
        model=model,
        phi=phi,
        covariance_of_phi=covariance,
        freedom=freedom,
        method=method,
        input_noise_bias=bias,
        rank=span.shape[1],
        unseen=gaps,
        hidden=(null**2).sum(axis=1),
        unknown=scales[:, None] * null,
        delay=lag * dt,
        delay_error=error * dt,
        dt=dt,
        outliers=outliers,
        samples=outliers + sum(int(one.good.sum()) for one in runs),
        segments=size,
        seconds=seconds,
        noise=[*full, *runs][0].reported_noise,
        residual=np.sqrt((residual[..., model.columns] ** 2).sum(axis=(0, 1)) / segments.good.sum()),
        chi2=float((segments.weigh(residual) ** 2).sum()) / count,
        whiteness=_whiteness_of(estimate.first_fit, segments, LEAST_RESIDUAL),
        is_noise=estimate.is_noise,
        explained=fit.explained,
        remarks=tuple(remarks),
        free_run=_free_run(problem, runs, p, p + step),
    )


def _moments(loads: Sequence[PayloadBody | None] | None, count: int) -> list[Array]:
    """Return mass, first moments and inertia about the body origin of the load of each log, shape (4,)."""
    expected = (
        f"a PayloadBody or None for each of {count} logs: loads that differ identify the scale of inputs"
    )
    given = [None] * count if loads is None else sequence("loads", loads, expected)
    moments = []
    for each in given:
        load: Any = instance("loads", each, PayloadBody | None, expected)
        m, x, y, inertia = (load.mass, *load.com[:2], load.moments[2]) if load else (0.0,) * 4
        moments.append(np.array([m, m * x, m * y, inertia + m * (x * x + y * y)]))
    if len(moments) != count or (loads is not None and all(np.array_equal(x, moments[0]) for x in moments)):
        raise unexpected_value("loads", loads, expected)
    return moments


def _on_wheels(table: WheelTable) -> Any:
    """Return a wheeled robot with an arbitrary body that is heavier than the wheels."""
    robot = WheeledRobot(MobileRobot(1e4, 1e4), table)
    return robot.by_voltage() if any(each.motor.is_electric for each in table.actuators) else robot


def _check_delay(lag: float, error: float, dt: float) -> None:
    if lag < -_EARLY - _SURE * error:
        raise InvalidArgument(
            f"log has poses {-1e3 * lag * dt:.3g} ms ({-lag:.1f} samples) ahead of the inputs that move "
            "the robot, expected a delay >= 0: two clocks, clipped inputs, unknown forces? Or set delay=0"
        )


def _segment(logs: Sequence[PreprocessedLog]) -> float:
    """Return the length of segments [s]."""
    spans = np.array([len(log.q) * log.dt for log in logs])
    for seconds in _LENGTHS:
        if np.floor(spans / seconds - 0.3).sum() >= _LEAST_SEGMENTS:
            return seconds
    raise InvalidArgument(
        f"log is {spans.sum():.3g} s long, too short, expected at least {_SHORTEST:g} s, better 60 s"
    )


def _first_delay(form: WeakForm, base: Array, basis: Array) -> float:
    """Return the delay with the smallest residual of the weak form [samples]."""
    if basis.shape[1] < len(base):
        return 0.0  # the motion does not identify the delay
    few = [piece for log in form.logs for piece in log.few]
    form = form if len(few) == len(form.logs) else WeakForm.of(few, form.model)
    dt = form.logs[0].dt
    delays = np.arange(-max(2, round(_EARLIEST / dt)), max(4, round(_LATEST / dt)) + 0.25, 0.5)
    k, lag, share = form.first_delay(delays, base, basis)
    _check_frame(form, base, basis, delays, share)
    check_share(share, _MIN_EXPLAINED)
    if k == 0:
        _check_delay(lag, 0.0, dt)
    if k == len(delays) - 1:
        raise InvalidArgument(
            f"log has poses that lag the inputs by {dt * lag:.3g} s or more, expected less: do two clocks "
            "give the times?"
        )
    return lag


def _check_frame(form: WeakForm, base: Array, basis: Array, delays: Array, share: float) -> None:
    """Reject forces in the body frame: rotated by psi, they explain much more than the given share."""
    if form.model.B is not None or share > _CLEAR:
        return
    logs = []
    for log in form.logs:
        planar = np.exp(1j * log.q[:, 2]) * (log.u[:, 0] + 1j * log.u[:, 1])
        logs.append(replace(log, u=np.column_stack([planar.real, planar.imag, log.u[:, 2]])))
    _, _, other = replace(form, logs=logs).first_delay(delays, base, basis)
    if 1 - other < _FRAME_RATIO * (1 - share):
        raise InvalidArgument(
            f"log has forces that explain {max(share, 0.0):.0%} of the motion, {other:.0%} if they are in "
            "the body frame, expected forces in the inertial frame: rotate (Fx, Fy) by psi"
        )


def _check(model: PlanarModel, fit: WeakFit, prior: Array | None) -> None:
    """Reject estimates that no robot can have, or that differ too much from the prior."""
    check_share(fit.explained, _MIN_EXPLAINED)
    phi, mass = fit.phi, float(fit.phi[0])
    wrong, ratio = f"a mass of {mass:.3g} kg", 1.0 if prior is None else mass / prior[0]
    is_so = not _MASSES[0] < mass < _MASSES[1]
    if mass > 0 and not 1 / _TIMES_NOMINAL < ratio < _TIMES_NOMINAL:
        wrong, is_so = f"{wrong}, {ratio:.3g} times the mass of the robot", True
    elif not is_so and model.are_possible(phi):
        radius = float(np.sqrt(model.to_physical(phi)[3] / mass))
        is_so = max(radius, np.hypot(*phi[1:3]) / mass) > _WIDEST or mass < _LIGHTEST * radius**2
        wrong = f"a radius of gyration of {radius:.3g} m with {wrong}"
    if is_so:
        raise InvalidArgument(
            f"log leads to {wrong}, expected values of a robot: are forces in N, moments in N m, positions "
            "in metres and psi in radians, or do inputs have another sign or frame?"
        )


class _Estimate(NamedTuple):
    """Estimate by output error.

    Attributes
    ----------
    fit : Fit
        Fit to the residuals, whitened if force noise contributes to them.
    first_fit : Fit
        Fit of the initial states alone to residuals that are not whitened.
    gradient : ndarray, shape (P,)
        Contribution of input noise to the gradient.
    bias : float
        Bias by input noise, in standard deviations.
    is_noise : bool
        Whether sensor and input noise explains the residuals. Otherwise the model structure is wrong.
    """

    fit: Fit
    first_fit: Fit
    gradient: Array
    bias: float
    is_noise: bool


def _output_error(problem: PlanarProblem, segments: Segments, moves: bool) -> _Estimate:
    """Return the estimate from segments; if `moves` is false, estimate the initial states alone."""
    fit = first = solve(problem, segments, problem.start, moves=moves)
    if problem.free:
        last = np.arange(len(fit.p)) == len(fit.p) - 1
        given = fit.linear if moves else Linear.of(problem, segments, fit.p, fit.starts, lambda r, _: r, last)
        _check_drift(given)
    gradient, bias = np.zeros(len(fit.p)), 0.0
    noise = None if _whiteness_of(fit, segments).is_white or not moves else _noise(problem, segments, fit)
    if noise is not None and not noise.remembers:
        # The controller responds to a correlated force, so whitening would fit the controller's response.
        gradient = input_noise_gradient(problem, segments, fit, noise)
        linear = Linear.of(problem, segments, fit.p, fit.starts, noise.white)
        way = np.linalg.lstsq(linear.information, gradient, rcond=None)[0]
        bias = float(np.sqrt(max(float(gradient @ way), 0.0)))
        if bias < _MAX_BIAS:
            fit = solve(problem, segments, fit.p, white=noise.white, starts=fit.starts, pull=gradient)
            first = solve(problem, segments, fit.p, moves=False)
    left = _whiteness_of(first, segments, LEAST_RESIDUAL)
    is_noise = left.is_white
    if not is_noise and np.abs(left.correlation).max() <= _DOMINANT:
        white = _noise(problem, segments, first).white
        linear = Linear.of(problem, segments, first.p, first.starts, white, moves=False)
        left = Whiteness.of(linear.e.reshape(segments.y.shape), segments.good)
        is_noise = bool(np.abs(left.correlation).max() <= _WHITENESS * left.bound)
    return _Estimate(fit, first, gradient, bias, is_noise)


def _noise(problem: PlanarProblem, segments: Segments, fit: Fit) -> ResidualNoise:
    answers = problem.responses(segments.select(segments.few), fit.p, fit.starts[segments.few])
    left = segments.weigh(fit.linear.residual)
    return ResidualNoise.of(left, segments.good, float(segments.dt[0]), answers)


def _whiteness_of(fit: Fit, segments: Segments, least: float = 0.0) -> Whiteness:
    """Return the autocorrelation of the residuals of a fit."""
    return Whiteness.of(segments.weigh(fit.linear.residual), segments.good, least)


def _check_drift(linear: Linear) -> None:
    """Reject a log in which the delay drifts, because one of two clocks is faster."""
    gradient, curvature = linear.normal[:, 0, 0, -1], linear.normal[:, 0, -1, -1]
    time = np.linspace(-0.5, 0.5, len(gradient))
    weight = max(float((curvature * time**2).sum()), 1e-300)
    slope = float((gradient * time).sum()) / weight
    deviation = np.sqrt(((gradient - curvature * time * slope) ** 2 * time**2).sum()) / weight
    if abs(slope) > max(_DRIFT, _SIGNIFICANT * deviation):
        raise InvalidArgument(
            f"log has a delay of the poses that changes by {slope:.2g} samples from start to end, expected "
            "times of one clock: one of two clocks is faster"
        )


def _weak_training_step(form: WeakForm, delay: float, base: Array, basis: Array) -> Array:
    """Return the step along the directions of a basis to the fit of the weak form of early windows."""
    columns, y = form.equations(delay)
    Y = append_columns(form.Y, columns)
    train = np.concatenate([np.arange(n) < TRAINING * n for n in form.counts])
    first, _ = robust_fit(Y[train], y[train], [int(train.sum())], base, basis)
    full, _ = robust_fit(Y, y, form.counts, base, basis)
    return np.asarray(np.linalg.pinv(basis) @ (first.phi - full.phi))


def _free_run(
    problem: PlanarProblem, runs: Sequence[PreprocessedLog], p: Array, p_train: Array
) -> Mapping[str, tuple[float, float]]:
    """Return R^2 by channel: of all logs, and of the last third for numbers of the first two thirds.

    Parameters
    ----------
    problem : PlanarProblem
        The model.
    runs : sequence of PreprocessedLog
        The logs. Each free run starts from measured poses and velocities.
    p, p_train : ndarray, shape (P,)
        Numbers of the whole logs, and of the first two thirds.
    """
    model = problem.model
    all_rows, test_rows = list[Array](), list[Array]()
    for run in runs:
        seconds = min(_FREE, 0.3 * len(run.q) * run.dt)
        segments = run.segments(model, problem.delay, seconds, False)
        if not len(segments.y):
            continue
        twist = run.free_velocities(model) @ model.S.T
        measured = twist[np.rint(segments.t / run.dt).astype(int)]
        starts = np.repeat(segments.start[None], 2, axis=0)
        states, _ = simulate_states(problem, segments, np.stack([p, p_train]), starts)
        outputs = states[..., 3:] @ model.S.T
        all_rows.append(np.stack([measured, measured - outputs[0]])[:, segments.good])
        is_test = segments.good & (segments.t > TRAINING * len(run.q) * run.dt)
        test_rows.append(np.stack([measured, measured - outputs[1]])[:, is_test])
    if not all_rows:
        return {}
    rows = [np.concatenate(each, axis=1) for each in (all_rows, test_rows)]
    speeds = np.sqrt((rows[0][0] ** 2).mean(axis=0))
    moves = [*(speeds[:2] > _MIN_SPEED * speeds[:2].max()), True]
    shares = [r_squared(*each) for each in rows]
    pairs = zip(_CHANNELS, moves, *(share.tolist() for share in shares), strict=True)
    return MappingProxyType({name: (r2, r2_test) for name, is_moved, r2, r2_test in pairs if is_moved})
