"""R^2 of the velocities in free runs of a planar model over logs, and over their last third."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np

from pinmobile.arrays import Array
from pinmobile.identification._estimator import r_squared
from pinmobile.identification._planar_model import PlanarProblem
from pinmobile.identification._preprocessing import PreprocessedLog
from pinmobile.identification._search import TRAINED
from pinmobile.identification._simulation import Segments, simulate
from pinmobile.identification._weak_form import WeakForm, beside, fitted

_FREE = 10.0  # [s], length of a free run
_CHANNELS = "forward speed", "left speed", "yaw rate"
_STILL = 0.05  # speed per largest speed of a direction in which the robot does not move


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
