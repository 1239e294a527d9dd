"""Poses from measured speeds, and a log beside its inputs replayed by a simulated robot."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from pinmobile.arrays import Array, bounded, scalar
from pinmobile.errors import InvalidArgument, format_value
from pinmobile.identification._filters import FINEST, LEAST_ROWS, low_pass, remove_outliers
from pinmobile.integrators import rk4
from pinmobile.loop import Rollout
from pinmobile.plant import coordinates_of, inputs_of
from pinmobile.trajectories import Reference

_LATEST = 10.0  # [s], largest delay


class MeasuredMotion:
    """Trajectory through the measured poses of a log.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Times from 0 [s].
    q : ndarray, shape (N, 3)
        Poses.
    is_noisy : bool
        Whether velocities need a filter.
    """

    def __init__(self, t: Array, q: Array, is_noisy: bool) -> None:
        from scipy.interpolate import CubicSpline  # slow to load

        smooth = low_pass(q, float(t[1] - t[0])) if is_noisy else q
        self.duration, self._q, self._smooth = float(t[-1]), CubicSpline(t, q), CubicSpline(t, smooth)

    def __call__(self, t: Any) -> Reference:
        """Return the poses at times t, and their velocities and accelerations, filtered if noisy."""
        return Reference(self._q(t), self._smooth(t, 1), self._smooth(t, 2))


def rollout_of(log: Any, robot: Any, delay: float = 0.0, **options: Any) -> Rollout:
    """Return the log as a rollout, whose reference is the replay; see `Log.rollout`."""
    from pinmobile.controllers import law  # which imports this package
    from pinmobile.loop import simulate

    inputs, names = inputs_of(robot), [item.name for item in coordinates_of(robot)[:3]]
    if log.u.shape[1] != len(inputs) or names != ["x", "y", "psi"]:
        raise InvalidArgument(
            f"robot is {format_value(robot)}, with {len(inputs)} inputs, expected a robot in the plane with "
            f"{log.u.shape[1]}, as the log has"
        )
    for unit, item in zip(log.units, inputs, strict=False):
        if unit not in ("", item.unit):
            raise InvalidArgument(
                f"log has inputs in {', '.join(log.units)}, expected {', '.join(x.unit for x in inputs)}: "
                "the robot takes other inputs, such as a torque in place of a steering angle"
            )
    if log.q is None and log.twist is None:
        raise InvalidArgument("log has no poses and no twist, expected one of them: nothing else is drawn")
    if len(log.split()) > 1 or len(log) < LEAST_ROWS:
        raise InvalidArgument(f"log has gaps, or fewer than {LEAST_ROWS} rows, expected a part of split()")
    run = log.samples("q" if log.q is not None else "twist")
    lag = bounded("delay", scalar("delay", delay), least=0, most=_LATEST, unit="s")
    if run.q is None:
        measured, noise = odometry(np.asarray(run.twist), run.dt), np.zeros(3)
    else:
        measured, _, noise = remove_outliers(run.q, run.is_valid, run.dt, FINEST)
    u = run.u[np.clip(np.arange(len(run.t)) - round(lag / run.dt), 0, None)]
    motion = MeasuredMotion(run.t, measured, bool((noise > 2 * FINEST).any()))
    command = law(lambda t, q, v, reference: u[min(round(t / run.dt), len(u) - 1)])
    rollout = simulate(robot, command, motion, **{"dt": run.dt, "integrator": rk4, **options})
    q, v, a = (np.array(each) for each in (rollout.q, rollout.v, rollout.a))
    replay_x, n = rollout.reference, 3
    q[:, :n], v[:, :n], a[:, :n] = replay_x
    replay = Reference(rollout.q[:, :n], rollout.v[:, :n], rollout.a[:, :n])
    return replace(rollout, q=q, v=v, a=a, error=-rollout.error, reference=replay, signals={})


def odometry(twist: Array, dt: float) -> Array:
    """Return the poses from body twists, shape (N, 3), beginning at zero."""
    forward, left, turn = twist.T
    psi = np.append(0.0, np.cumsum(turn[:-1]) * dt)
    way = np.exp(1j * (psi + 0.5 * dt * turn)) * (forward + 1j * left)
    position = np.append(0.0, np.cumsum(way[:-1]) * dt)
    return np.column_stack([position.real, position.imag, psi])
