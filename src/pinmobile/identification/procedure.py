"""`identify`: the weak form to start, the delay, what the motion tells, then output error."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from pinmobile.arrays import Array, frozen, one_of, positive, scalar
from pinmobile.errors import InvalidArgument, shown
from pinmobile.identification.chassis import Chassis
from pinmobile.identification.cleaning import Cleaned, Slippage
from pinmobile.identification.estimate import Identification
from pinmobile.identification.log import Log, check_steps, logs_of
from pinmobile.identification.observability import Setting, in_words
from pinmobile.identification.output_error import Estimate, OutputError, ResidualNoise, Segments
from pinmobile.identification.statistics import Whiteness, whiteness
from pinmobile.identification.weak_form import WINDOW, Fit, extrapolated, rows_of, solve
from pinmobile.robot import Load, MobileRobot
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
    loads: Sequence[Load | None] | None = None,
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
    loads : sequence of Load or None, optional
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
        leaves
        something unseen and no robot says what is believed of it: see the message.
    """
    logs = logs_of(log)
    one_of("method", method, METHODS)
    alone = isinstance(robot, WheelTable)
    robot = _on_wheels(robot) if alone else robot
    chassis, carried = _chassis(robot, rolling_speed, loads, len(logs))
    names = ["log"] if len(logs) == 1 else [f"log[{k}]" for k in range(len(logs))]
    cleaned = [
        Cleaned.of(one, chassis, each, name) for one, each, name in zip(logs, carried, names, strict=True)
    ]
    check_steps([one.dt for one in cleaned])
    told = [Slippage.of(one, chassis, name) for one, name in zip(cleaned, names, strict=True)]
    slips = [each for each in told if each is not None]
    clipped = "; ".join(
        filter(None, (_clipped(one, chassis, name) for one, name in zip(logs, names, strict=True)))
    )
    worst = max(slips, key=lambda each: each.share, default=None)
    hints = [f"Its {worst}"] if worst is not None and worst.matters else []
    hints += [clipped] if clipped else []
    given = None if delay is None else _given_delay(delay, cleaned)
    seconds = _segment(cleaned)
    rows = [rows_of(one, chassis) for one in cleaned]
    for each in (replace(chassis, offset=True), chassis):  # offsets where the motion tells them
        prior = None if alone else prior_of(robot, each)
        at = Setting.of(cleaned, rows, each, prior)
        seen, unseen = at.directions()
        if not unseen.size:
            break
    chassis = at.chassis
    if unseen.size and prior is None:
        raise InvalidArgument(
            f"log has a motion of rank {seen.shape[1]} of {len(at.scales)}: {in_words(at.chassis, unseen)}; "
            "expected one that excites more, see excitation, or robot=..., which is kept where nothing is "
            "seen"
        )
    believed = np.zeros(len(at.scales)) if prior is None else prior
    basis = at.scales[:, None] * seen
    base = believed if unseen.size else np.zeros_like(believed)
    sought = given is None and not unseen.size
    with _suspecting(hints):
        late = _first_delay(at, base, basis) if given is None else given / cleaned[0].dt
    fit = extrapolated(rows, chassis, late, base, basis, sought)
    own = fit if given is None else _own_delay(at, base, basis)
    with _suspecting(hints), _doubting(given, own, cleaned[0].dt):
        _check_explained(fit.explained)
        _check_units(chassis, fit.phi, prior)
    start, pulled = chassis.possible(fit.phi, at.scales), 0.0
    segments = [Segments.of(one, chassis, fit.delay, seconds) for one in cleaned]
    kept = sum(part.number for part in segments)
    if kept < _LEAST_SEGMENTS // 2:
        raise InvalidArgument(
            f"log has {kept} segments of {seconds:g} s in which half of the poses are measured and no "
            f"outliers, expected {_LEAST_SEGMENTS}: does the motion jump between poses?"
        )
    if method == METHODS[0]:
        estimate = _by_output_error(at, segments, start, basis, fit.delay, sought)
        pulled = estimate.pulled
        method = METHODS[0 if pulled < _PULLED else 1]
    if method == METHODS[0]:
        phi, covariance, freedom = estimate.phi, estimate.covariance, estimate.segments - 1
        late, error = estimate.delay, estimate.delay_error
        with _suspecting(hints), _doubting(given, own, cleaned[0].dt):
            _check_units(chassis, phi, prior)
    else:
        estimate = OutputError(segments, chassis, fit.delay, sought).solve(start, basis, 0)
        _check_drift(estimate.said)
        windows = sum(len(one.q) * one.dt for one in cleaned) / WINDOW
        phi, covariance, freedom = fit.phi, fit.covariance, max(5, round(windows) - len(fit.phi))
        late, error = fit.delay, fit.delay_error
    if given is None:
        with _suspecting(hints):
            _check_late(late, error, cleaned[0].dt)
    squares = sum((e[..., :3] ** 2).sum(axis=(0, 1)) for e in estimate.residuals)
    white = [whiteness(e, good) for e, good in zip(estimate.residuals, estimate.good, strict=True)]
    return Identification(
        chassis=chassis,
        phi=frozen(phi),
        covariance_of_phi=frozen(covariance),
        freedom=freedom,
        method=method,
        pulled=pulled,
        prior=robot,
        rank=seen.shape[1],
        unseen=in_words(chassis, unseen) if unseen.size else "",
        hidden=frozen((unseen**2).sum(axis=1)),
        unknown=frozen(at.scales[:, None] * unseen),
        delay=late * cleaned[0].dt,
        delay_error=error * cleaned[0].dt,
        other_delay=_other_delay(given, own, cleaned[0].dt),
        dt=cleaned[0].dt,
        outliers=sum(one.outliers for one in cleaned),
        dropped=sum(one.dropped for one in logs),
        slippage=worst,
        samples=sum(int(one.good.sum()) + one.outliers for one in cleaned),
        segments=estimate.segments,
        noise=frozen(cleaned[0].noise),
        chi2=estimate.chi2,
        whiteness=_worst(white),
        is_noise=_is_noise(estimate, segments, chassis),
        clipped=clipped,
        residual=frozen(np.sqrt(squares / sum(good.sum() for good in estimate.good))),
    )


def _chassis(
    robot: Any, speed: float | None, loads: Sequence[Load | None] | None, count: int
) -> tuple[Chassis, list[Array]]:
    carried = [np.zeros(4)] * count
    if loads is not None:
        given = list(loads) if isinstance(loads, Sequence) else []
        if len(given) != count or not all(each is None or isinstance(each, Load) for each in given):
            raise InvalidArgument(
                f"loads is {shown(loads)}, expected a Load or None for each of {count} logs"
            )
        carried = [np.zeros(4) if each is None else _moments(each) for each in given]
    scaled = loads is not None
    if scaled and all(np.array_equal(each, carried[0]) for each in carried):
        raise InvalidArgument(
            "loads has the same for all logs, expected loads that differ: their difference tells the scale "
            "of the input"
        )
    return to_chassis(robot, speed, scaled), carried


def to_chassis(robot: Any, speed: float | None = None, scaled: bool = False) -> Chassis:
    """Return a robot as its log sees it; see `identify`."""
    if hasattr(robot, "table") and hasattr(robot, "reduced"):
        own = _WHEEL_SPEED if speed is None else positive("rolling_speed", speed, "rad/s")
        return Chassis.rolling(robot, own, scaled)
    if robot is not None and (not isinstance(robot, MobileRobot) or robot.mounts):
        raise InvalidArgument(
            f"robot is {shown(robot)}, expected a MobileRobot without arms (robot.lumped() has them locked), "
            "or a WheeledRobot whose wheels roll and do not steer; of a robot that takes speeds for commands "
            "take identify_velocity"
        )
    own = _SPEED if speed is None else positive("rolling_speed", speed, "m/s")
    return Chassis.pushed(own, scaled)


def _on_wheels(table: WheelTable) -> Any:
    """Return a robot on wheels, of a body that holds them and of which nothing else is meant."""
    heavy = 1 + 10 * sum(wheel.mass for wheel in table.wheels)
    square = 1 + max(wheel.x**2 + wheel.y**2 for wheel in table.wheels)
    spread = 1 + 10 * sum(wheel.yaw_inertia for wheel in table.wheels)
    robot = WheeledRobot(MobileRobot(heavy, heavy * square + spread), table)
    electric = any(each.motor.is_electric for each in table.actuators)
    return robot.by_voltage() if electric else robot


def _given_delay(delay: float, logs: Sequence[Cleaned]) -> float:
    given, most = scalar("delay", delay), _MOST_GIVEN * min(len(one.q) * one.dt for one in logs)
    if not -most <= given <= most:
        raise InvalidArgument(f"delay is {given:g} s, expected {most:.3g} s at most: are these milliseconds?")
    return given


def _own_delay(at: Setting, base: Array, basis: Array) -> Fit:
    """Return the fit at the delay that a log itself tells; it is not a number where it tells none."""
    nothing = Fit(base, np.zeros((len(base), len(base))), np.inf, 0.0)
    if basis.shape[1] < len(base):
        return nothing
    try:
        late = _first_delay(at, base, basis)
        fit = extrapolated(at.rows, at.chassis, late, base, basis, True)
        _check_explained(fit.explained)
        _check_units(at.chassis, fit.phi, at.prior)
    except InvalidArgument:
        return nothing
    return fit


def _other_delay(given: float | None, own: Fit, dt: float) -> float:
    """Return the delay that a log tells [s], if it is another one than that given; else not a number."""
    off = np.nan if given is None else abs(own.delay - given / dt)
    return own.delay * dt if off > max(_OTHER, _SIGNIFICANT * own.delay_error) else np.nan


@contextmanager
def _doubting(given: float | None, own: Fit, dt: float) -> Iterator[None]:
    """Blame the delay that was given for what is refused, where the log agrees with another one."""
    try:
        yield
    except InvalidArgument as error:
        other = _other_delay(given, own, dt)
        if np.isnan(other):
            raise
        told = str(error).partition(", expected")[0].removeprefix("log ")
        raise InvalidArgument(
            f"delay is {given:g} s, with which the log {told}; with {1e3 * other:.1f} ms the motion explains "
            f"{own.explained:.0%} of the inputs: expected that, or none, so that it is found"
        ) from error


@contextmanager
def _suspecting(hints: Sequence[str]) -> Iterator[None]:
    """Tell of slip and clipped inputs, where there are some, with what is refused: it may come of them."""
    try:
        yield
    except InvalidArgument as error:
        if not hints:
            raise
        raise InvalidArgument(" ".join([str(error), *hints])) from error


def _clipped(log: Log, chassis: Chassis, name: str) -> str:
    """Return which inputs of a log stay at their extremes for long, as clipped ones do; "" if none does."""
    found = []
    for one, u in zip(chassis.inputs, log.u.T, strict=True):
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


def _moments(load: Load) -> Array:
    x, y, _ = load.com
    return np.array([load.mass, load.mass * x, load.mass * y, load.inertia[2] + load.mass * (x * x + y * y)])


def prior_of(robot: Any, chassis: Chassis) -> Array | None:
    """Return what is believed of phi; None without a robot."""
    if robot is None:
        return None
    body = (robot.robot if chassis.wheels else robot).lumped()
    told = np.zeros(chassis.size)
    told[:4] = body.mass, *body.com[:2], body.body.yaw_inertia
    if chassis.scaled:
        told[-1] = 1.0
    return chassis.phi(told)


def _segment(logs: Sequence[Cleaned]) -> float:
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


def _first_delay(at: Setting, base: Array, basis: Array) -> float:
    """Return the delay at which the weak form leaves least, in samples, by a scan and a parabola."""
    if basis.shape[1] < len(base):
        return 0.0  # what hardly changes tells no time
    dt, chassis = at.logs[0].dt, at.chassis
    if chassis.scaled:  # whose scale tells no time either: all in proportion to it
        chassis, base, basis = replace(chassis, scaled=False), base[:-1], basis[:-1, :-1]
    delays = np.arange(-max(2, round(_EARLIEST / dt)), max(4, round(_LATEST / dt)) + 0.25, 0.5)
    fits = [solve(at.rows, chassis, d, base, basis, 2) for d in delays]
    costs = np.array([each.cost for each in fits])
    k = int(costs.argmin())
    _check_explained(fits[k].explained)
    if k == 0:
        _check_late(delays[k], 0.0, dt)
    if k == len(delays) - 1:
        raise InvalidArgument(
            f"log has poses that come late by {dt * delays[k]:.3g} s or more, expected less: are poses and "
            "inputs of two clocks?"
        )
    low, mid, high = costs[k - 1 : k + 2]
    return float(delays[k] + 0.25 * (low - high) / max(low - 2 * mid + high, 1e-300))


def _by_output_error(
    at: Setting, segments: Sequence[Segments], phi: Array, basis: Array, delay: float, sought: bool
) -> Estimate:
    """Return the estimate: of residuals as they are, and weighed where noise of forces is behind them."""
    found = OutputError(segments, at.chassis, delay, sought).solve(phi, basis)
    _check_drift(found.said)
    if _are_white(found.residuals, found.good):
        return found
    noise = _noise_of(found, segments, at.chassis)
    if any(each.remembers for each in noise):
        return found  # a controller may answer to such a force: weights for it would be those of the answer
    problem = OutputError(segments, at.chassis, found.delay, sought, noise)
    weighed = problem.solve(found.phi, basis, starts=found.starts)
    # What is left is told of first states that fit best, not of those that noise of forces weighs.
    there = OutputError([part._replace(delay=weighed.delay) for part in segments], at.chassis)
    plain = there.solve(weighed.phi, basis[:, :1], 0)
    return weighed._replace(starts=plain.starts, residuals=plain.residuals, chi2=plain.chi2)


def _noise_of(found: Estimate, segments: Sequence[Segments], chassis: Chassis) -> list[ResidualNoise]:
    return [
        ResidualNoise.of(e / part.noise, part.good, part.run.dt, part.responses(chassis, start, found.phi))
        for e, start, part in zip(found.residuals, found.starts, segments, strict=True)
    ]


def _is_noise(found: Estimate, segments: Sequence[Segments], chassis: Chassis) -> bool:
    """Return whether noise of sensors and inputs explains what is left: else the structure is wrong."""
    if _are_white(found.residuals, found.good):
        return True
    before = [whiteness(e, good) for e, good in zip(found.residuals, found.good, strict=True)]
    if np.abs(_worst(before).correlation).max() > _DOMINANT:
        return False
    late = [part._replace(delay=found.delay) for part in segments]
    problem = OutputError(late, chassis, found.delay, noise=_noise_of(found, late, chassis))
    left = zip(problem.innovations(found), found.good, strict=True)
    worst = _worst([whiteness(e, good) for e, good in left])
    return bool(np.abs(worst.correlation).max() <= _COLOURED * worst.bound)


def _are_white(residuals: Sequence[Array], good: Sequence[Array]) -> bool:
    return all(whiteness(e, each).is_white for e, each in zip(residuals, good, strict=True))


def _check_drift(said: Array) -> None:
    """Refuse a log whose delay changes along it, as that of two clocks of which one is faster does."""
    time = np.linspace(-0.5, 0.5, len(said))
    weight = max(float((said[:, 1] * time**2).sum()), 1e-300)
    slope = float((said[:, 0] * time).sum()) / weight
    deviation = np.sqrt(((said[:, 0] - said[:, 1] * time * slope) ** 2 * time**2).sum()) / weight
    if abs(slope) > max(_DRIFT, _SIGNIFICANT * deviation):
        raise InvalidArgument(
            f"log has poses whose delay changes by {slope:.2g} samples from start to end: two clocks, "
            "one of which is faster, expected times of one"
        )


def _check_explained(explained: float) -> None:
    if explained < _EXPLAINED:
        raise InvalidArgument(
            f"log has inputs of which the motion explains {max(explained, 0):.0%}, expected most: are they "
            "of another robot, in another frame, or of another sign?"
        )


def _check_units(chassis: Chassis, phi: Array, prior: Array | None) -> None:
    mass = phi[0]
    if prior is not None and mass > 0 and not 1 / _TIMES_NOMINAL < mass / prior[0] < _TIMES_NOMINAL:
        raise InvalidArgument(
            f"log leads to a mass of {mass:.3g} kg where the robot has {prior[0]:.3g} kg, expected about "
            "that: are its forces in newtons, its positions in metres?"
        )
    if not _MASSES[0] < mass < _MASSES[1]:
        why = (
            "have inputs the other sign, or another frame"
            if mass <= 0
            else "are forces in newtons, positions in metres"
        )
        raise InvalidArgument(
            f"log leads to a mass of {mass:.3g} kg, expected {_MASSES[0]:g} to {_MASSES[1]:g} kg: {why}?"
        )
    if not chassis.is_possible(phi):
        return
    radius = float(np.sqrt(chassis.told(phi)[3] / mass))
    if max(radius, np.hypot(phi[1], phi[2]) / mass) > _WIDEST or mass < _LIGHTEST * radius**2:
        raise InvalidArgument(
            f"log leads to a radius of gyration of {radius:.3g} m with a mass of {mass:.3g} kg, expected "
            "those of a robot: are forces in N, moments in N m, positions in metres and psi in radians?"
        )


def _worst(found: Sequence[Whiteness]) -> Whiteness:
    return max(found, key=lambda one: float(np.abs(one.correlation).max()))
