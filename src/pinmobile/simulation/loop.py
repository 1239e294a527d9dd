"""The samples of one robot: by Python, one after the other, or compiled."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled import (
    NOTHING,
    Memory,
    Parts,
    Program,
    Record,
    Reference,
    Sample,
    Stepped,
    once,
    one_sample,
    program_of,
    robot_keys,
)
from pinmobile.divergence import is_alive
from pinmobile.errors import InvalidArgument, NotFinite, NotTraceable
from pinmobile.plant import Context
from pinmobile.signals import Recorder, Signal
from pinmobile.simulation.setup import shorter


def in_python(parts: Parts, context: Context, q0: Array, v0: Array) -> Iterator[Stepped]:
    """Yield the samples of a loop in Python, until a number is not finite.

    Parameters
    ----------
    parts : Parts
        The loop, checked.
    context : Context
        What the controller is told; the reference is sampled at its times.
    q0, v0 : ndarray, shape (nq,) and (nv,)
        Start.
    """
    plant, reference, h = parts.plant, context.reference, context.dt / parts.substeps
    memory = Memory(
        plant.initial_state(context) if hasattr(plant, "initial_state") else None,
        parts.controller.initial_state(context),
        parts.recorder.initial_state(reference.v.shape[1], plant.nu),
    )
    # Rows of its own: a controller may write into what it is given.
    rows = zip(*(part.copy() for part in reference), strict=True)
    state, k = (q0, v0), 0.0
    for t, row in zip(context.t.tolist(), rows, strict=True):
        try:
            found = one_sample(parts, k, t, h, state, Reference(*row), memory)
        except InvalidArgument as error:
            if not np.isfinite(np.concatenate(state)).all():
                return  # whoever is asked about it refuses it
            if k:
                raise
            raise shorter(context, error) from error.__cause__
        yield found
        state, memory, k = (found.q, found.v), found.memory, k + 1.0


class _Told:
    """A recorder of what parts tell, which keeps nothing itself."""

    signals, errors = True, False

    def initial_state(self, n: int, nu: int) -> None:
        return None

    def __call__(self, sample: Sample, state: None) -> Record:
        return NOTHING


class Loop:
    """All samples of a loop in Python: see `in_python`."""

    def __init__(self, parts: Parts, context: Context, q0: Array, v0: Array) -> None:
        plant, t, reference = parts.plant, context.t, context.reference
        self._adds = getattr(plant, "adds", False) and reference.v.shape[1] == plant.nv
        self._desired = np.hstack([reference.q, reference.v])
        sizes = plant.nq, plant.nv, plant.nv, plant.nu
        self._rows = tuple(np.full((len(t), size), np.nan) for size in sizes)
        self._samples = in_python(replace(parts, recorder=_Told()), context, q0, v0)
        self._recorder = Recorder(t.tolist()) if replace(parts, recorder=_Told()).tells else None
        self.stopped: NotFinite | None = None

    def run(self, begin: int, end: int) -> None:
        """Fill the samples from `begin` to before `end`."""
        q, v, a, u = self._rows
        try:
            for k, (sample, *_) in zip(range(begin, end), self._samples, strict=False):
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
        """Return what parts told beside states and inputs at the samples before `end`, by name."""
        return {} if self._recorder is None else self._recorder.signals(end)

    @np.errstate(over="ignore", invalid="ignore")  # what overflows is not fine
    def is_fine(self, begin: int, end: int, limit: float) -> bool:
        """Tell whether the samples are finite and near the reference; if in doubt, False."""
        if not self._adds:
            return False
        q, v, a, u = self.samples(begin, end)
        errors = self._desired[begin:end] - np.hstack([q, v])  # on the circle they are less
        return bool(is_alive(errors, limit, u, a).all())


class CompiledLoop:
    """The samples of a compiled loop, as those of `Loop`; it has run when it is made.

    Parameters
    ----------
    parts, context, q0, v0
        As in `Loop`.
    memory : dict
        What `memory_of` returned of the parts.

    Raises
    ------
    NotTraceable
        If a law cannot be compiled; its line, and what to write instead.
    """

    stopped = None

    def __init__(
        self, parts: Parts, context: Context, q0: Array, v0: Array, *, memory: dict[Any, Any]
    ) -> None:
        plant, substeps, parts = parts.plant, parts.substeps, parts.varying(())
        reference = Reference(*context.reference)
        self._desired = np.hstack([reference.q, reference.v])
        whole = reference.q.shape[1] == plant.nq and reference.v.shape[1] == plant.nv
        self._adds = whole and getattr(plant, "adds", False)
        first = Reference(*(part[0] for part in reference))

        def known() -> Program:
            return program_of(parts, context, (q0, v0), first, dt=context.dt, single=True)

        _check_telling(parts)
        program = once(memory, ("single", substeps, context.dt, len(context.t), context.t[-1]), known)
        member = range(context.member, context.member + 1)
        keys = {name: robot_keys(context.seed, name, member) for name in program.loop.keys}
        start = q0[None], v0[None]
        run = program.run(
            parts, context, start, context.t, reference, dt=context.dt, keys=keys, memory=memory
        )
        self._kept = [run.kept[name][0] for name in ("q", "v", "a", "u")]
        units = program.loop.units
        self._signals = {name: Signal(unit, run.kept[f"signal {name}"][0]) for name, unit in units.items()}

    def run(self, begin: int, end: int) -> None:
        """Do nothing: all samples are there."""

    @np.errstate(over="ignore", invalid="ignore")  # what overflows is not fine
    def is_fine(self, begin: int, end: int, limit: float) -> bool:
        """Tell whether the samples are finite and near the reference; if in doubt, False."""
        if not self._adds:
            return False
        q, v, a, u = self.samples(begin, end)
        errors = self._desired[begin:end] - np.hstack([q, v])  # on the circle they are less
        return bool(is_alive(errors, limit, u, a).all())

    def samples(self, begin: int, end: int) -> tuple[Array, Array, Array, Array]:
        """Return q, v, a and u of the samples, one row each."""
        q, v, a, u = (part[begin:end] for part in self._kept)
        return q, v, a, u

    def signals(self, end: int) -> dict[str, Signal]:
        """Return what parts told beside states and inputs at the samples before `end`, by name."""
        return {name: Signal(unit, values[:end]) for name, (unit, values) in self._signals.items()}


def _check_telling(parts: Parts) -> None:
    """Refuse parts whose signals are not those of what is run in their place.

    Raises
    ------
    NotTraceable
        If there is one.
    """
    for (path, given), (_, own) in zip(parts.by_path(), parts.on_symbols().by_path(), strict=True):
        if hasattr(given, "signals") and not hasattr(own, "signals"):
            raise NotTraceable(
                f"{path}, a {type(given).__name__}, has signals, and what its traced() returns has none",
                "give that the same signals",
            )
