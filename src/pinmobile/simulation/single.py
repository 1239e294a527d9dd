"""One robot's closed loop as compiled code: the records that the loop in Python keeps, of the same laws."""

from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled import Parts, Reference, Trace, program_of, robot_keys
from pinmobile.errors import InvalidArgument, NotTraceable
from pinmobile.plant import Context
from pinmobile.signals import Signal

__all__ = ["CompiledLoop"]


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
        q0: Array,
        v0: Array,
    ) -> None:
        parts = Parts(plant, controller, forces, integrator, Trace(), substeps)
        reference = Reference(*context.reference)
        first = Reference(*(part[0] for part in reference))
        try:
            _check_telling(parts)
            program = program_of(parts, context, (q0, v0), first, dt=context.dt, single=True)
        except NotTraceable as error:
            raise InvalidArgument(f"engine is COMPILED, which cannot run this: {error.reason}") from error
        member = range(context.member, context.member + 1)
        keys = {name: robot_keys(context.seed, name, member) for name in program.loop.keys}
        start = q0[None], v0[None]
        run = program.run(parts, context, start, context.t, reference, dt=context.dt, keys=keys)
        self._kept = [run.kept[name][0] for name in ("q", "v", "a", "u")]
        units = program.loop.units
        self._signals = {name: Signal(unit, run.kept[f"signal {name}"][0]) for name, unit in units.items()}

    def run(self, begin: int, end: int) -> None:
        """Do nothing: all samples are there."""

    def is_fine(self, begin: int, end: int, limit: float) -> bool:
        """Return False: it is not known yet whether the samples are finite and near the reference."""
        return False

    def check_again(self) -> None:
        """Do nothing: compiled laws have no memory but their state."""

    def samples(self, begin: int, end: int) -> tuple[Array, Array, Array, Array]:
        """Return q, v, a and u of the samples, one row each."""
        q, v, a, u = (np.array(part[begin:end]) for part in self._kept)
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
