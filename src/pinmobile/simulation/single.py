"""One robot's closed loop as compiled code: the records that the loop in Python keeps, of the same laws."""

from __future__ import annotations

from math import isfinite
from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled import Parts, Reference, Trace, memory_of, once, program_of, robot_keys
from pinmobile.errors import InvalidArgument, NotTraceable
from pinmobile.plant import Context
from pinmobile.signals import Signal


def remembered(
    plant: Any, controller: Any, integrator: Any, substeps: int, forces: tuple[Any, ...], trajectory: Any
) -> dict[Any, Any]:
    """Return where what follows from the parts of a loop is remembered, see `memory_of`."""
    return memory_of(Parts(plant, controller, forces, integrator, None, substeps), trajectory)


class CompiledLoop:
    """Records of a compiled loop; it has run when it is made.

    Parameters
    ----------
    plant, controller, integrator, substeps, forces
        As in `simulate`, checked.
    context : Context
        What the controller is told; the reference is sampled at its times.
    q0, v0 : ndarray, shape (nq,) and (nv,)
        Start.
    memory : dict
        What `remembered` returned of the parts.

    Raises
    ------
    InvalidArgument
        If a law cannot be compiled; its line, and what to write instead.
    """

    stopped = None

    def __init__(
        self,
        plant: Any,
        controller: Any,
        integrator: Any,
        context: Context,
        substeps: int,
        forces: tuple[Any, ...],
        *,
        q0: Array,
        v0: Array,
        memory: dict[Any, Any],
    ) -> None:
        parts = Parts(plant, controller, forces, integrator, Trace(), substeps).varying(())
        self._desired = reference = Reference(*context.reference)
        whole = reference.q.shape[1] == plant.nq and reference.v.shape[1] == plant.nv
        self._adds = whole and getattr(plant, "adds", False)
        first = Reference(*(part[0] for part in reference))

        def known() -> Any:
            return program_of(parts, context, (q0, v0), first, dt=context.dt, single=True)

        try:
            _check_telling(parts)
            program = once(memory, ("single", substeps, context.dt, len(context.t), context.t[-1]), known)
        except NotTraceable as error:
            raise InvalidArgument(f"engine is COMPILED, which cannot run this: {error.reason}") from error
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

    def is_fine(self, begin: int, end: int, limit: float) -> bool:
        """Tell whether the samples are finite and near the reference; if in doubt, False."""
        if not self._adds:
            return False
        q, v, a, u = self.samples(begin, end)
        desired = [part[begin:end] for part in self._desired[:2]]
        # On the circle an error is less.
        near = all(np.abs(d - x).max() <= limit for d, x in zip(desired, (q, v), strict=True))
        return near and isfinite(a.sum() + u.sum())

    def check_again(self) -> None:
        """Do nothing: compiled laws have no memory but their state."""

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
