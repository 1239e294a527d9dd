"""`identify`: the weak form to start, the delay, what the motion tells, then output error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pinmobile.arrays import Array, bounded, instance, one_of, positive, scalar, sequence
from pinmobile.errors import InvalidArgument, shown
from pinmobile.identification.estimator import Fit, Linear, Segments, jackknife, solve, unexplained
from pinmobile.identification.log import Log, check_steps, logs_of
from pinmobile.identification.model import PlanarModel, Search
from pinmobile.identification.noise import ResidualNoise, pull
from pinmobile.identification.preprocessing import PreprocessedLog, Slippage
from pinmobile.identification.result import Identification
from pinmobile.identification.statistics import Whiteness, whiteness
from pinmobile.identification.weak_form import WINDOW, WeakFit, WeakForm
from pinmobile.parts import Tabled, offers
from pinmobile.robot import MobileRobot, PayloadBody
from pinmobile.wheels import WheeledRobot, WheelTable

METHODS = ("output error", "weak")

_SECONDS = 2.0  # of a segment
_LEAST_SEGMENTS = 20  # fewer tell too little of how they differ
_SHORTEST = 1.0  # [s] of a segment
_LATEST, _EARLIEST = 0.3, 0.05  # [s] of delays that are looked for
_EXPLAINED = 0.5  # of the forces' mean square; what explains less is another robot
_SPEED, _WHEEL_SPEED = 0.01, 0.1  # where dry friction has 71 %: [m/s, rad/s] of a body, [rad/s] of wheels
_MOST_GIVEN = 0.1  # of the log, a delay that is given
_OTHER = 1.0  # sample by which a delay that is given may be beside what the log tells
_PULLED = 3.0  # deviations by which noise of inputs may pull output error
_DRIFT = 1.0  # sample by which a delay may change along a log
_MASSES = (0.02, 2e4)  # [kg] of ground robots
_WIDEST = 10.0  # [m], radius of gyration, and distance of the centre of mass, of robots
_LIGHTEST = 1.0  # [kg/m^2], mass of robots per square of the radius of gyration, which have some 100
_TIMES_NOMINAL = 30.0
_SIGNIFICANT = 5.0  # deviations
_COLOURED = 2.5  # times the bound of white residuals: five deviations, of noise that is itself estimated
_EARLY, _SURE = 0.5, 3.0  # sample, and deviations, by which poses may come before their inputs
_DOMINANT = 0.9  # correlation of residuals that are next to nothing but forces, which noise alone seldom has
_CLIPPED = 0.02  # of the rows


def identify(
    log: Log | Sequence[Log],
    robot: Any = None,
    *,
    loads: Sequence[PayloadBody | None] | None = None,
    method: str = "output error",
    delay: float | None = None,
    rolling_speed: float | None = None,
) -> Identification:
    """Return mass, centre of mass, yaw inertia and friction of the robot that a log is of, with intervals.

    The weak form (accelerations are not needed) gives a start; then simulations of 2 s are fitted to the log
    (output error), and intervals are those of the jackknife over these segments (CR3) with Student's t: they
    hold where poses and forces are noisy. They do not cover the error that a wrong structure causes, such as
    slip or resistance that depends on load: `Identification.is_noise` says whether residuals show one. A
    constant offset of each input is found too, where the motion tells it from friction. Both methods take the
    input as held between samples.

    Parameters
    ----------
    log : Log or sequence of Log
        What was measured: at least 20 s of a motion that excites, see `excitation`.
    robot : MobileRobot, WheeledRobot or WheelTable, optional
        What is believed of the robot: kept where the motion tells nothing; its wheels and motors are taken as
        they are. Of wheels alone nothing else is believed; the input is volts where they have electric
        motors, else torques. Without it, a body that is pushed.
    loads : sequence of PayloadBody or None, optional
        Load that the robot carried in each log, in the body's frame. With loads that differ, the scale of the
        input is identified too, such as an unknown torque constant: of logs of currents it is the torque per
        ampere. One scale stands for all inputs.
    method : str
        ``"output error"``, or ``"weak"``, the start alone: linear and fast, its intervals several times
        as wide where forces are known well, and much the same where they are not. It is taken too where noise
        of the inputs would pull output error by more than three deviations.
    delay : float, optional
        By which poses come late [s]; without it, it is found.
    rolling_speed : float, optional
        Where dry friction has reached 71 % of its size: 0.01 m/s and rad/s, of wheels 0.1 rad/s.

    Returns
    -------
    found : Identification
        What was found.

    Raises
    ------
    InvalidArgument
        If the log is too short, or of another robot, the units are wrong, the clocks drift, or the motion
        leaves something unseen and no robot says what is believed of it: see the message.
    """
    logs = logs_of(log)
    one_of("method", method, METHODS)
    alone = isinstance(robot, WheelTable)
    robot = _on_wheels(robot) if alone else robot
    model, carried = _model(robot, rolling_speed, loads, len(logs))
    names = ["log"] if len(logs) == 1 else [f"log[{k}]" for k in range(len(logs))]
    triples = zip(logs, carried, names, strict=True)
    runs = [PreprocessedLog.of(one, model, each, name) for one, each, name in triples]
    check_steps([one.dt for one in runs])
    slips = [each for one, n in zip(runs, names, strict=True) if (each := Slippage.of(one, model, n))]
    worst = max(slips, key=lambda each: each.share, default=None)
    clipped = "; ".join(filter(None, (_clipped(one, model, n) for one, n in zip(logs, names, strict=True))))
    hints = [f"Its {worst}"] * (worst is not None and worst.matters) + [clipped] * bool(clipped)
    given = None if delay is None else _given_delay(delay, runs)
    try:
        found = _identified(runs, model, None if alone else prior_of(robot, model), method, given, hints)
    except InvalidArgument as error:  # which may come of slip, clipped inputs or a wrong delay
        raise InvalidArgument(" ".join([str(error), *hints])) from error
    dropped = sum(one.dropped for one in logs)
    return replace(found, dropped=dropped, prior=robot, slippage=worst, clipped=clipped)


def _identified(
    runs: Sequence[PreprocessedLog],
    model: PlanarModel,
    believed: Array | None,
    method: str,
    delay: float | None,
    hints: list[str],
) -> Identification:
    """Return what is found in preprocessed logs; what may be behind a refusal is added to the hints."""
    dt = runs[0].dt
    given = None if delay is None else delay / dt
    seconds = _segment(runs)
    form = WeakForm.of(runs, model)
    for offset in (True, False):  # offsets where the motion tells them
        form = replace(form, model=replace(model, offset=offset))
        scales = form.scales()
        seen, unseen = form.directions(scales)
        if not unseen.size:
            break
    model, told, prior = form.model, in_words(form.model, unseen), believed
    if prior is not None and model.offset:
        prior = np.insert(prior, model.dry.stop, np.zeros(model.nu))
    if told and prior is None:
        raise InvalidArgument(
            f"log has a motion of rank {seen.shape[1]} of {len(scales)}: {told}; expected one that excites "
            "more, see excitation, or robot=..., which is kept where nothing is seen"
        )
    basis, base = scales[:, None] * seen, np.zeros(len(scales)) if prior is None or not told else prior
    alone = fit = _weakly(form, base, basis, given)
    if given is not None:
        alone = _own_delay(form, base, basis, prior)
    other = _other_delay(delay, alone, dt)
    if delay is not None and np.isfinite(other):
        hints.append(
            f"Its delay of {1e3 * delay:g} ms was given, but with {1e3 * other:.1f} ms the motion explains "
            f"{alone.explained:.0%} of the inputs"
        )
    _check(model, fit, prior)
    sought, rates = given is None and not told, any(one.rates is not None for one in runs)
    segments = Segments.joined([one.segments(model, fit.delay, seconds, rates) for one in runs])
    kept = len(segments.start)
    if kept < _LEAST_SEGMENTS // 2:
        raise InvalidArgument(
            f"log has {kept} segments of {seconds:g} s in which half of the poses are measured and no "
            f"outliers, expected {_LEAST_SEGMENTS}: does the motion jump between poses?"
        )
    start = model.possible(fit.phi, scales)
    search = Search(model, start, basis, fit.delay, sought)
    estimate = _OutputError.of(search, segments, method == METHODS[0])
    asked, method = method, METHODS[0 if method == METHODS[0] and estimate.pulled < _PULLED else 1]
    phi, covariance, freedom = fit.phi, fit.covariance, kept - 1
    late, error = fit.delay, fit.delay_error
    if method == METHODS[0]:
        phi, found = search.values(estimate.weighed.p)
        late = float(found)
        free = estimate.covariance
        covariance = basis @ free[: basis.shape[1], : basis.shape[1]] @ basis.T
        error = float(np.sqrt(free[-1, -1])) if sought else np.nan
        _check(model, fit._replace(phi=phi), prior)
    else:
        windows = sum(len(one.q) * one.dt for one in runs) / WINDOW
        freedom = max(5, round(windows) - len(phi))
        if asked == METHODS[0]:
            estimate = replace(_OutputError.of(search, segments, False), pulled=estimate.pulled)
    if given is None:
        _check_late(late, error, dt)
    measured = segments.good[..., None] & np.isfinite(segments.noise)[:, None]
    residual = np.where(measured, estimate.plain.near.residual, 0.0)
    count = max(1, int(measured.sum()) - basis.shape[1] - segments.start.size)
    squares = (segments.weighed(residual) ** 2).sum()
    rms = np.sqrt((residual[..., :3] ** 2).sum(axis=(0, 1)) / segments.good.sum())
    outliers = sum(one.outliers for one in runs)
    samples = outliers + sum(int(one.good.sum()) for one in runs)
    own: dict[str, Any] = {
        **{"freedom": freedom, "method": method, "pulled": estimate.pulled, "rank": seen.shape[1]},
        **{"unseen": told, "hidden": (unseen**2).sum(axis=1), "unknown": scales[:, None] * unseen},
        **{"delay": late * dt, "delay_error": error * dt, "other_delay": other, "dt": dt},
        **{"outliers": outliers, "dropped": 0, "samples": samples, "segments": kept, "seconds": seconds},
        **{"noise": runs[0].noise, "residual": rms, "chi2": float(squares) / count},
        **{"whiteness": _whiteness(estimate.plain, segments), "is_noise": estimate.is_noise},
    }
    return Identification(model, phi, covariance, explained=fit.explained, **own)


@dataclass(frozen=True)
class _OutputError:
    """What output error finds: weighed where noise of forces is behind the residuals, and plain.

    Attributes
    ----------
    weighed, plain : Fit
        The estimate, and the first states that fit it best of residuals as they are.
    covariance : ndarray, shape (P, P)
        Of the numbers.
    pulled : float
        Deviations by which noise of the inputs pulls.
    is_noise : bool
        Whether noise of sensors and inputs explains what is left: else the structure is wrong.
    """

    weighed: Fit
    plain: Fit
    covariance: Array
    pulled: float
    is_noise: bool

    @classmethod
    def of(cls, search: Search, segments: Segments, moves: bool) -> _OutputError:
        """Return the estimate of segments, or where nothing moves what is left at its start."""
        found = plain = solve(search, segments, search.start, moves=moves)
        if search.free:
            _check_drift(found.near)
        pulling, pulled, is_white = np.zeros(len(found.p)), 0.0, _whiteness(found, segments).is_white
        noise = None if is_white else _noise(search, segments, found)
        if moves and noise is not None and not noise.remembers:
            # A controller may answer to a force that remembers: weights for it would be those of the answer.
            pulling = pull(search, segments, found, noise)
            near = Linear.of(search, segments, found.p, found.starts, noise.white)
            way = np.linalg.lstsq(np.einsum("smp,smq->pq", near.J, near.J), pulling, rcond=None)[0]
            pulled = float(np.sqrt(max(pulling @ way, 0.0)))
            if pulled < _PULLED:
                shift = -near.J @ way
                found = solve(search, segments, found.p, white=noise.white, starts=found.starts, shift=shift)
                plain = solve(search, segments, found.p, moves=False)
        left = _whiteness(plain, segments)
        is_noise = left.is_white
        if not is_noise and np.abs(left.correlation).max() <= _DOMINANT:
            white = _noise(search, segments, plain).white
            near = Linear.of(search, segments, plain.p, plain.starts, white)
            white_left = whiteness(near.e.reshape(segments.y.shape), segments.good)
            is_noise = bool(np.abs(white_left.correlation).max() <= _COLOURED * white_left.bound)
        return cls(found, plain, jackknife(found.near, pulling), pulled, is_noise)


def _noise(search: Search, segments: Segments, found: Fit) -> ResidualNoise:
    answers, residuals = (
        search.responses(segments, found.p, found.starts),
        segments.weighed(found.near.residual),
    )
    return ResidualNoise.of(residuals, segments.good, float(segments.dt[0]), answers)


def _whiteness(found: Fit, segments: Segments) -> Whiteness:
    return whiteness(segments.weighed(found.near.residual), segments.good)


def _weakly(form: WeakForm, base: Array, basis: Array, given: float | None) -> WeakFit:
    """Return the weak form's fit, at a delay that is given or found, in samples."""
    late = _first_delay(form, base, basis) if given is None else given
    return form.extrapolated(late, base, basis, given is None and basis.shape[1] == len(base))


def _model(
    robot: Any, speed: float | None, loads: Sequence[PayloadBody | None] | None, count: int
) -> tuple[PlanarModel, list[Array]]:
    expected = f"a PayloadBody or None for each of {count} logs"
    given = [None] * count if loads is None else sequence("loads", loads, expected)
    if len(given) != count:
        raise InvalidArgument(f"loads is {shown(loads)}, expected {expected}")
    carried = [_moments(instance("loads", each, PayloadBody | None, expected)) for each in given]
    if loads is not None and all(np.array_equal(each, carried[0]) for each in carried):
        raise InvalidArgument(
            "loads has the same for all logs, expected loads that differ: their difference tells the scale "
            "of the input"
        )
    return planar_model(robot, speed, loads is not None), carried


def planar_model(robot: Any, speed: float | None = None, scaled: bool = False) -> PlanarModel:
    """Return a robot as its log sees it; see `identify`."""
    if offers(robot, Tabled):
        own = _WHEEL_SPEED if speed is None else positive("rolling_speed", speed, "rad/s")
        return PlanarModel.rolling(robot, own, scaled)
    if robot is not None and (not isinstance(robot, MobileRobot) or robot.mounts):
        raise InvalidArgument(
            f"robot is {shown(robot)}, expected a MobileRobot without arms (robot.lumped() has them locked), "
            "or a WheeledRobot whose wheels roll and do not steer; of a robot that takes speeds for commands "
            "take identify_velocity"
        )
    own = _SPEED if speed is None else positive("rolling_speed", speed, "m/s")
    return PlanarModel.pushed(own, scaled)


def _on_wheels(table: WheelTable) -> Any:
    """Return a robot on wheels, of a body that holds them and of which nothing else is meant."""
    heavy = 1 + 10 * sum(wheel.mass for wheel in table.wheels)
    square = 1 + max(wheel.x**2 + wheel.y**2 for wheel in table.wheels)
    spread = 1 + 10 * sum(wheel.yaw_inertia for wheel in table.wheels)
    robot = WheeledRobot(MobileRobot(heavy, heavy * square + spread), table)
    electric = any(each.motor.is_electric for each in table.actuators)
    return robot.by_voltage() if electric else robot


def _given_delay(delay: float, logs: Sequence[PreprocessedLog]) -> float:
    most = _MOST_GIVEN * min(len(one.q) * one.dt for one in logs)
    return bounded("delay", scalar("delay", delay), least=-most, most=most, unit="s")


def _own_delay(form: WeakForm, base: Array, basis: Array, prior: Array | None) -> WeakFit:
    """Return the fit at the delay that a log itself tells; it is not a number where it tells none."""
    nothing = WeakFit(base, np.zeros((len(base), len(base))), np.inf, 0.0)
    if basis.shape[1] < len(base):
        return nothing
    try:
        fit = _weakly(form, base, basis, None)
        _check(form.model, fit, prior)
    except InvalidArgument:
        return nothing
    return fit


def _other_delay(given: float | None, own: WeakFit, dt: float) -> float:
    """Return the delay that a log tells [s], if it is another one than that given; else not a number."""
    off = np.nan if given is None else abs(own.delay - given / dt)
    return own.delay * dt if off > max(_OTHER, _SIGNIFICANT * own.delay_error) else np.nan


def _clipped(log: Log, model: PlanarModel, name: str) -> str:
    """Return which inputs of a log stay at their extremes for long, as clipped ones do; "" if none does."""
    found = []
    for one, u in zip(model.inputs, log.u.T, strict=True):
        extreme = ((u == u.max()) | (u == u.min())) & (u != 0) & (np.ptp(u) > 0)
        stays = extreme[2:] & (u[2:] == u[1:-1]) & (u[1:-1] == u[:-2])
        if stays.mean() > _CLIPPED:
            found.append(
                f"input {one} of {name} stays at {u.min():.4g} or {u.max():.4g}, its extremes, in "
                f"{stays.mean():.0%} of the rows: if it was clipped, estimates are wrong"
            )
    return "; ".join(found)


def _check_late(late: float, error: float, dt: float) -> None:
    if late < -_EARLY - _SURE * error:
        raise InvalidArgument(
            f"log has poses {-1e3 * late * dt:.3g} ms ({-late:.1f} samples) ahead of the inputs that move "
            "the robot, expected a delay of 0 or more: are they of two clocks or swapped columns of time, "
            "are inputs clipped, or does a force act that the model lacks? delay=0 takes it as zero."
        )


def _moments(load: PayloadBody | None) -> Array:
    """Return mass, its moments and inertia about the body's origin, shape (4,)."""
    if load is None:
        return np.zeros(4)
    x, y, _ = load.com
    return np.array([load.mass, load.mass * x, load.mass * y, load.inertia[2] + load.mass * (x * x + y * y)])


def prior_of(robot: Any, model: PlanarModel) -> Array | None:
    """Return what is believed of phi; None without a robot."""
    if robot is None:
        return None
    body = (robot.robot if model.wheels else robot).lumped()
    told = np.zeros(model.size)
    told[:4] = body.mass, *body.com[:2], body.body.yaw_inertia
    if model.scaled:
        told[-1] = 1.0
    return model.phi(told)


def _segment(logs: Sequence[PreprocessedLog]) -> float:
    """Return how long segments are [s]: 2 s, or less where that makes too few."""
    lengths = np.array([len(one.q) * one.dt for one in logs])
    for seconds in (_SECONDS, 1.5, _SHORTEST):
        if np.floor(lengths / seconds - 0.3).sum() >= _LEAST_SEGMENTS:
            return seconds
    pieces = f" in {len(logs)} pieces" if len(logs) > 1 else ""
    raise InvalidArgument(
        f"log is {lengths.sum():.3g} s long{pieces}, too short, expected at least "
        f"{(_LEAST_SEGMENTS + 0.5) * _SHORTEST:g} s, better 60 s: intervals come from {_LEAST_SEGMENTS} "
        "segments and more"
    )


def _first_delay(form: WeakForm, base: Array, basis: Array) -> float:
    """Return the delay at which the weak form leaves least, in samples."""
    if basis.shape[1] < len(base):
        return 0.0  # what hardly changes tells no time
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
    """Refuse a log whose delay changes along it, as that of two clocks of which one is faster does."""
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
    """Refuse estimates that no robot has, or not the one that is believed."""
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


def in_words(model: PlanarModel, unseen: Array) -> str:
    """Return what directions of the parameters are unseen, in words; "" where none is."""
    names = [one.name for one in model.quantities]
    hidden = unseen @ unseen.T
    alone = [names[k] for k in range(len(names)) if hidden[k, k] > 0.98]
    mixed = [k for k in range(len(names)) if 0.02 < hidden[k, k] <= 0.98]
    groups: list[list[int]] = []
    for k in mixed:
        near = [g for g in groups if any(abs(hidden[k, j]) > 0.05 for j in g)]
        groups = [g for g in groups if g not in near] + [[j for g in near for j in g] + [k]]
    told = [f"the motion does not tell {', '.join(alone)}"] if alone else []
    told += [f"of {', '.join(names[j] for j in sorted(g))} it tells combinations alone" for g in groups]
    return "; ".join(told)
