"""`validate`: errors of predictions on the last third of a log, beside simpler models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from pinmobile.arrays import Array
from pinmobile.identification._commands import (
    CHANNELS,
    Lag,
    Part,
    channels_of,
    explained_parts,
    segments_of,
    speeds_of,
)
from pinmobile.identification._estimates import Identification
from pinmobile.identification._log import Log, logs_of
from pinmobile.identification._simulation import simulate
from pinmobile.identification._velocity import TRAINING, identify_velocity
from pinmobile.identification._velocity_model import VelocityModel

_HORIZONS = 0.1, 2.0, 5.0  # [s]
_STARTS = 10  # predictions that start within the longest horizon
_AT_ONCE = 0.05  # time constant of a robot without lag, as a share of the time step


@final
@dataclass(frozen=True, eq=False)
class Validation:
    """Errors of predictions of a hold-out, by model: the result of `identification.validate`.

    Attributes
    ----------
    horizons : ndarray, shape (H,)
        Times after the start of a prediction [s].
    names, units : tuple of k str
        Names and units of the columns: speed and yaw rate, and for poses distance and heading.
    rms : mapping of str to ndarray, shape (H, k)
        Root mean square errors of ``"kinematics"``, ``"lag"`` and ``"identified"``.
    identification : Identification
        Estimates from the first two thirds of the log.

    See Also
    --------
    identification.validate : compute these errors

    Examples
    --------
    >>> from pinmobile import FixedHeading, Hold, Log, VelocityRobot
    >>> from pinmobile import simulate
    >>> from pinmobile.controllers import RandomSteps
    >>> from pinmobile.identification import validate
    >>> robot = VelocityRobot([0.4, 0.3, 0.0, 1.0, 0.0, 1.0])
    >>> still = FixedHeading(Hold((0, 0), duration=90), psi=0)
    >>> run = simulate(robot, RandomSteps(), still, dt=0.1)
    >>> result = validate(Log.from_rollout(run, noise=1e-4))
    >>> for name in ("kinematics", "identified"):
    ...     print(name, result.rms[name][1, 2].round(2))  # after 2 s [m]
    kinematics 0.2
    identified 0.0
    """

    horizons: Array
    names: tuple[str, ...]
    units: tuple[str, ...]
    rms: Mapping[str, Array]
    identification: Identification

    def __str__(self) -> str:
        heads = [f"{name} [{unit}]" for name, unit in zip(self.names, self.units, strict=True)]
        lines = [f"{'rms error after':>15}  {'model':<10}  {'  '.join(heads)}"]
        for k, horizon in enumerate(self.horizons):
            for name, rms in self.rms.items():
                cells = "  ".join(f"{x:>{len(head)}.3g}" for x, head in zip(rms[k], heads, strict=True))
                lines.append(f"{horizon:13.3g} s  {name:<10}  {cells}")
        errors = self.rms["identified"]
        for name in ("kinematics", "lag"):
            worse = [n for k, n in enumerate(self.names) if (errors > self.rms[name])[1:, k].any()]
            lines += [f"no better than {name}: {', '.join(worse)}"] * bool(worse)
        return "\n".join(lines)


def validate(log: Log | Sequence[Log], **options: Any) -> Validation:
    """Return errors of predictions on the last third of each log, from what the first two thirds identify.

    Each prediction starts from the measured motion and runs free. Beside the identified robot stand
    a robot that follows its commands at once (kinematics), and a first-order lag of each channel with its
    gain, delay and limits. Sections that the commands do not explain do not count.

    Parameters
    ----------
    log : Log or sequence of Log
        Commands and poses or twists, see `identify_velocity`: 62 s or more.
    **options
        Of `identify_velocity`.

    Returns
    -------
    result : Validation
        Errors after 0.1, 2 and 5 s.

    Raises
    ------
    InvalidArgument
        If `identify_velocity` rejects the first two thirds, or the commands do not explain the last third.

    See Also
    --------
    identify_velocity : estimates from the whole log
    identification.Validation : the result

    Examples
    --------
    >>> from pinmobile import FixedHeading, Hold, Log, VelocityRobot
    >>> from pinmobile import simulate
    >>> from pinmobile.controllers import RandomSteps
    >>> from pinmobile.identification import validate
    >>> robot = VelocityRobot([0.4, 0.3, 0.0, 1.0, 0.0, 1.0])
    >>> still = FixedHeading(Hold((0, 0), duration=90), psi=0)
    >>> run = simulate(robot, RandomSteps(), still, dt=0.1)
    >>> print(str(validate(Log.from_rollout(run, noise=1e-4)))[:60])
    rms error after  model       speed [m/s]  yaw rate [rad/s]
    """
    logs = logs_of(log)
    spans = [float(one.t[-1] - one.t[0]) for one in logs]
    first = [one.between(0.0, TRAINING * span) for one, span in zip(logs, spans, strict=True)]
    last = [one.between(TRAINING * span, span + one.dt) for one, span in zip(logs, spans, strict=True)]
    estimates = identify_velocity(first, **options)
    model = estimates.model
    train, test = (model.runs(part) for part in (first, last))
    lags = [each.lag(model.lead) for each in channels_of(explained_parts(train, model.lags(estimates.phi)))]
    parts = explained_parts(test, model.lags(estimates.phi), minimum=-np.inf)  # also of a poor model
    dt = test[0].dt
    unit_lag = Lag(1.0, _AT_ONCE * dt, 0, np.inf)
    models = {"kinematics": model.of_lags([unit_lag, unit_lag]), "lag": model.of_lags(lags)}
    models["identified"] = model, estimates.phi
    every = round(1 / float(test[0].is_valid.mean()))
    horizons = np.maximum(every, np.rint(np.array(_HORIZONS) / dt)).astype(int)
    shifts = np.unique(np.linspace(0, horizons[-1], _STARTS, endpoint=False).astype(int)).tolist()
    pieces = [part._replace(start=part.start + shift) for part in parts for shift in shifts]
    columns = CHANNELS | ({"distance": "m", "heading": "rad"} if model.is_pose else {})
    rms = {}
    for name, (each, p) in models.items():
        rms[name] = _errors(each, p, pieces, horizons, every, name == "kinematics")
    return Validation(horizons * dt, tuple(columns), tuple(columns.values()), rms, estimates)


def _errors(
    model: VelocityModel, p: Array, parts: list[Part], horizons: Array, every: int, at_once: bool
) -> Array:
    """Return the rms errors, shape (H, k), of predictions that start from the measured motion."""
    squares = [_squares(replace(model, is_pose=False), p, speeds_of(parts), horizons, every, at_once)]
    if model.is_pose:
        x, y, psi = np.moveaxis(_squares(model, p, parts, horizons, every, at_once), -1, 0)
        squares.append(np.stack([x + y, psi], axis=-1))
    return np.asarray(np.sqrt(np.nanmean(np.concatenate(squares, axis=-1), axis=0)))


def _squares(
    model: VelocityModel, p: Array, parts: list[Part], horizons: Array, every: int, at_once: bool
) -> Array:
    """Return the squared errors of segments at the last measurement before each horizon, shape (S, H, m)."""
    parts = model.complete_states(parts, p)
    segments, _ = segments_of(parts, model.lead, (int(horizons[-1]) + 1) * model.dt, fill=False)
    starts = segments.start.copy()
    if at_once:
        starts[:, :2] = segments.applied(0, 1)[0, :, 0]
    outputs = simulate(model, segments, p[None], starts[None])[0]
    left = np.where(segments.good[..., None], segments.y - outputs, 0.0)
    rows = horizons[:, None] - np.arange(every)
    counts = segments.good[:, rows].sum(axis=2)[..., None]
    return np.where(counts > 0, (left[:, rows] ** 2).sum(axis=2) / np.maximum(counts, 1), np.nan)
