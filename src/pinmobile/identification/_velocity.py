"""`identify_velocity`: numbers of a robot with velocity inputs from logs of commands and motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pinmobile.arrays import ArrayLike, bounded, positive, scalar
from pinmobile.errors import InvalidArgument
from pinmobile.identification._car_model import CarModel
from pinmobile.identification._commands import (
    BLOCK,
    CAR_COMMANDS,
    CHANNELS,
    LEAST_BLOCKS,
    Run,
    channels_of,
    explained_parts,
    format_left_out,
    lead_of,
    parts_of,
    runs_of,
)
from pinmobile.identification._estimates import Identification
from pinmobile.identification._log import Log, logs_of, unused
from pinmobile.identification._search import few_of, searched
from pinmobile.identification._velocity_model import VelocityModel
from pinmobile.identification._velocity_robot import VelocityRobot

_ROUNDS = 2  # of lags and of parts that they explain
_HARD = 0.4  # first estimate of a limit of rates, as a share of the largest rate without it
_FARTHEST = 10.0  # [m]: largest distance ahead of the axle


def identify_velocity(
    log: Log | Sequence[Log],
    *,
    delay: float | None = None,
    ahead: float | None = 0.0,
    accelerations: ArrayLike | None = None,
    limits: ArrayLike | None = None,
    wheelbase: float | None = None,
) -> Identification:
    """Estimate a `VelocityRobot` or a `VelocityCar` from a log of its commands and its motion.

    The inputs of the log are commands of speed and yaw rate, and the estimates are theta. Commands of a car
    are speed and steering angle: the unit of the second input is ``"rad"``, or `wheelbase` is given. The
    estimates are then the fields of a `VelocityCar`. The measurements are the twist if the log has one, such
    as from encoders, and otherwise the pose.

    A first-order lag gives first estimates of gains, time constants, delay and limits of the commands.
    Sections that the commands do not explain, such as driving by hand, are left out and reported. Output
    error then fits simulations of segments to the measurements, as long as the noise allows. It weights
    residuals by their covariance and drops single samples beyond six standard deviations.

    The confidence intervals come from the jackknife over blocks of 2 to 5 s with Student's t. They are also
    valid if the noise is correlated. They do not cover the error of a wrong model: `free_run` of the result
    states how much of the motion the model explains, and `notes` whether results depend on the length of the
    segments.

    Both commands must change often and independently, for example by `controllers.RandomSteps`.

    Parameters
    ----------
    log : Log or sequence of Log
        Commands and motion, at least 20 blocks of 2 s: 41 s or more.
    delay : float, optional
        Delay of measurements relative to commands [s]; default: estimated. The intervals of the other
        numbers then include the uncertainty of the delay.
    ahead : float, optional
        Distance of the measured point ahead of the axle, of a car the rear one [m]; None: estimated from
        poses.
    accelerations : array_like, shape () or (2,), optional
        Largest absolute accelerations of the firmware, of speed and yaw rate [m/s^2, rad/s^2]; of a car,
        acceleration and steering rate [m/s^2, rad/s]; infinite: no limit. Default: estimated where the log
        shows a limit.
    limits : array_like, shape () or (2,), optional
        Largest absolute commands that the robot follows [m/s, rad/s or rad]; infinite: no limit. Default:
        estimated where the log shows a limit.
    wheelbase : float, optional
        Distance between the axles of a car, > 0 [m]: the gain of the steering is estimated. Default: the
        wheelbase is estimated, and the gain of the steering is 1.

    Returns
    -------
    found : Identification
        Estimates of the numbers of the robot; its method `robot` returns it.

    Raises
    ------
    InvalidArgument
        If the log is too short or from another robot, units are wrong, poses move sideways, commands do not
        change or explain less than a third of the motion, or an argument is out of range.

    See Also
    --------
    VelocityRobot : the model
    identification.VelocityCar : the model of a car
    controllers.RandomSteps : commands for an informative log
    identify : the same for a robot with forces, torques or voltages as inputs

    Examples
    --------
    >>> from pinmobile import FixedHeading, Hold, Log, VelocityRobot
    >>> from pinmobile import identify_velocity, simulate
    >>> from pinmobile.controllers import RandomSteps
    >>> robot = VelocityRobot([0.4, 0.3, 0.0, 1.0, 0.0, 1.0])
    >>> still = FixedHeading(Hold((0, 0), duration=44), psi=0)
    >>> run = simulate(robot, RandomSteps(), still, dt=0.1)
    >>> found = identify_velocity(Log.from_rollout(run, noise=1e-4))
    >>> found.theta[:2].round(2)  # robot: 0.4 and 0.3 [s]
    array([0.4, 0.3])
    """
    logs = logs_of(log)
    is_pose, is_car = logs[0].twist is None, wheelbase is not None or logs[0].units[1:] == ("rad",)
    sensor = "q" if is_pose else "twist"
    runs = runs_of(logs, is_pose, CAR_COMMANDS if is_car else CHANNELS)
    dt, lead = runs[0].dt, lead_of(runs)
    if ahead is None and not is_pose:
        raise InvalidArgument("ahead is None, expected a number [m]: a log of twists does not identify it")
    _check_changes(runs)
    late, far = (scalar(name, 0.0 if x is None else x) for name, x in (("delay", delay), ("ahead", ahead)))
    given = {
        "delay": bounded("delay", late, least=0, most=lead * dt, unit="s"),
        "ahead": bounded("ahead", far, least=-_FARTHEST, most=_FARTHEST, unit="m"),
    }
    if wheelbase is not None:
        given["wheelbase"] = positive("wheelbase", wheelbase, "m")
    model = (CarModel if is_car else VelocityModel)((), given, lead, dt, is_pose)
    most = VelocityRobot(
        np.ones(6),
        limits=np.inf if limits is None else limits,
        accelerations=np.inf if accelerations is None else accelerations,
    )
    given |= dict(zip(model.limits(), [*most.accelerations.tolist(), *most.limits.tolist()], strict=True))
    parts = parts_of(runs)
    for _ in range(_ROUNDS):  # what other drivers did hides the limits
        lags = [
            each.lag(lead, None if delay is None else round(late / dt)) for each in channels_of(few_of(parts))
        ]
        parts = explained_parts(runs, lags)
    sought, seen = {"delay": delay is None, "ahead": ahead is None}, model.limits_of(lags)
    for name, known in zip(model.limits(), (accelerations, accelerations, limits, limits), strict=True):
        sought[name] = known is None and np.isfinite(seen[name])
    order = [name for name, is_sought in sought.items() if is_sought]
    guess = {"delay": dt * float(np.mean([lag.late for lag in lags if lag.gain] or [0])), "ahead": 0.0} | seen
    start = np.append(model.start(lags), [guess[name] for name in order])
    model = replace(model, free=tuple(order))
    left_out, parts = format_left_out(runs, parts), model.started(parts, start)
    unknown = [] if accelerations is not None else [n for n in model.limits()[:2] if n not in order]
    tops = [
        lag._replace(steepest=_HARD * lag.top([run.u[:, k] for run in runs])) for k, lag in enumerate(lags)
    ]
    guesses = {n: model.limits_of(tops)[n] for n in unknown}
    found = searched(model, parts, start, guesses, lags, left_out)
    return replace(found, dropped=sum(one.dropped + unused(one, sensor) for one in logs))


def _check_changes(runs: Sequence[Run]) -> None:
    """Reject logs that are too short, and logs with constant commands."""
    spans = np.array([(len(run.u) - 1) * run.dt for run in runs])
    blocks = int(np.floor(spans / BLOCK).sum())
    if blocks < LEAST_BLOCKS:
        raise InvalidArgument(
            f"log is {spans.sum():.3g} s long, too short: it gives {blocks} blocks of {BLOCK:g} "
            f"s, expected at least {LEAST_BLOCKS} for valid intervals: a log of "
            f"{(LEAST_BLOCKS + 0.5) * BLOCK:g} s or more"
        )
    if not any(channel.moves for channel in channels_of(parts_of(runs))):
        raise InvalidArgument("log has constant commands, expected changing commands, such as RandomSteps")
