"""The engines: the samples of one robot by Python, one after the other, or compiled."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled import robot_keys
from pinmobile.divergence import is_alive
from pinmobile.errors import InvalidArgument, NotFinite
from pinmobile.loop._loop import NOTHING, Loop, Record, Sample, initial, step
from pinmobile.loop._program import Compiled
from pinmobile.loop._record import Samples
from pinmobile.parts import evolved
from pinmobile.plant import Context
from pinmobile.signals import Recorder, Signal
from pinmobile.trajectories import Reference


def in_python(loop: Loop, context: Context, q0: Array, v0: Array) -> Iterator[tuple[Sample, Record]]:
    """Yield the samples of a loop in Python, until a number is not finite.

    Parameters
    ----------
    loop : Loop
        The closed loop, checked.
    context : Context
        Argument of the controller's `initial_state`; the reference is sampled at its times.
    q0, v0 : ndarray, shape (nq,) and (nv,)
        Start.
    """
    h, state, k = context.dt / loop.substeps, initial(loop, context, q0, v0), 0.0
    # Rows of its own: a controller may write into what it is given.
    rows = zip(*(part.copy() for part in context.reference), strict=True)
    for t, row in zip(context.t.tolist(), rows, strict=True):
        try:
            after, sample, record = step(loop, k, t, h, state, Reference(*row))
        except InvalidArgument as error:
            if not np.isfinite(np.concatenate(state[:2])).all():
                return  # an error of the part that refuses it
            if k:
                raise
            raise error_of_sizes(context, error) from error.__cause__
        yield sample, record
        state, k = after, k + 1.0


def error_of_sizes(context: Context, error: InvalidArgument) -> InvalidArgument:
    """Return an error of a controller; where the reference has not all coordinates, that may be why."""
    n, count = context.reference.v.shape[1], len(context.coordinates)
    if n == count or " has shape " not in str(error):
        return error
    if n == max(context.reference_sizes, default=count):  # wheels have no reference
        return InvalidArgument(
            f"{error}; expected a controller of wheels' torques, such as "
            f"ControlAllocation(controller, robot) makes "
            "of one of forces on the body"
        )
    return InvalidArgument(
        f"{error}; the reference has the first {n} of {count} coordinates, expected a controller that "
        "follows these, or a reference of all: a motion of base and arms is WholeBody(robot, base, *joints)"
    )


class _Signals:
    """A recorder of signals, without memory."""

    signals, errors = True, False

    def initial_state(self, n: int, nu: int) -> None:
        return None

    def __call__(self, sample: Sample, state: None) -> Record:
        return NOTHING


class PythonRun:
    """All samples of a loop in Python: see `in_python`."""

    def __init__(self, loop: Loop, context: Context, q0: Array, v0: Array) -> None:
        plant, t, reference = loop.plant, context.t, context.reference
        loop = evolved(loop, {"recorder": _Signals()})
        self._adds = getattr(plant, "is_vector_space", False) and reference.v.shape[1] == plant.nv
        self._desired = np.hstack([reference.q, reference.v])
        sizes = plant.nq, plant.nv, plant.nv, plant.nu
        self._rows = tuple(np.full((len(t), size), np.nan) for size in sizes)
        self._samples = in_python(loop, context, q0, v0)
        self._recorder = Recorder(t.tolist()) if loop.signals else None
        self.stopped: NotFinite | None = None

    def run(self, begin: int, end: int) -> None:
        """Fill the samples from `begin` to before `end`."""
        q, v, a, u = self._rows
        try:
            for k, (sample, _) in zip(range(begin, end), self._samples, strict=False):
                q[k], v[k], a[k], u[k] = sample.q, sample.v, sample.a, sample.u
                if self._recorder is not None:
                    self._recorder(k, sample.signals)
        except NotFinite as error:
            self.stopped = error  # the rest stays empty

    def samples(self, begin: int, end: int) -> tuple[Array, Array, Array, Array]:
        """Return q, v, a and u of the samples, one row each."""
        q, v, a, u = (part[begin:end] for part in self._rows)
        return q, v, a, u

    def signals(self, end: int) -> dict[str, Signal]:
        """Return the signals of the samples before `end`, by name."""
        return {} if self._recorder is None else self._recorder.signals(end)

    @np.errstate(over="ignore", invalid="ignore")  # an overflow is not fine
    def is_fine(self, begin: int, end: int, limit: float) -> bool:
        """Return whether the samples are finite and near the reference; if in doubt, False."""
        if not self._adds:
            return False
        q, v, a, u = self.samples(begin, end)
        errors = self._desired[begin:end] - np.hstack([q, v])  # on the circle they are less
        return bool(is_alive(errors, limit, u, a).all())


class CompiledRun(PythonRun):
    """The samples of a compiled loop; it has run when it is made.

    Raises
    ------
    NotTraceable
        If a law cannot be compiled; its line, and what to write instead.
    """

    def __init__(self, loop: Loop, context: Context, q0: Array, v0: Array) -> None:
        plant, reference = loop.plant, Reference(*context.reference)
        loop = evolved(loop, {"recorder": Samples()})
        whole = reference.q.shape[1] == plant.nq and reference.v.shape[1] == plant.nv
        self._adds = whole and getattr(plant, "is_vector_space", False)
        self._desired, self.stopped = np.hstack([reference.q, reference.v]), None
        first = Reference(*(part[0] for part in reference))
        compiled = Compiled(loop, context, (q0, v0), first, single=True)
        member = range(context.member, context.member + 1)
        keys = {name: robot_keys(context.seed, name, member) for name in compiled.tape.keys}
        run = compiled.run((q0[None], v0[None]), context.t, reference, keys=keys)
        self._rows = tuple(run.kept[name][0] for name in ("q", "v", "a", "u"))
        units = compiled.tape.units
        self._signals = {name: Signal(unit, run.kept[f"signal {name}"][0]) for name, unit in units.items()}

    def run(self, begin: int, end: int) -> None:
        """Do nothing: all samples are there."""

    def signals(self, end: int) -> dict[str, Signal]:
        """Return the signals of the samples before `end`, by name."""
        return {name: Signal(unit, values[:end]) for name, (unit, values) in self._signals.items()}
