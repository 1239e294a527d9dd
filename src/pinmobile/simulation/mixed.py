"""A loop whose controller cannot be compiled: its plant and forces are, and the controller runs in Python."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from math import prod
from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled import (
    Parts,
    Place,
    Reference,
    Trace,
    aligned,
    initial_memory,
    leaves,
    mapped,
    moved_on,
    program_of,
    told_by,
)
from pinmobile.plant import Context

_U = Place("controller", "u")


class _Moved(NamedTuple):
    """A `Step` whose acceleration is that at its start."""

    q: Any
    v: Any
    memory: Any
    a: Any


@dataclass(frozen=True, eq=False)
class _Given:
    """A controller whose input is a number of each robot's."""

    u: Any
    parameters: Any = ("u",)

    def initial_state(self, context: object) -> None:
        return None

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: None) -> Any:
        return self.u, None


@dataclass(frozen=True, eq=False)
class _Whole:
    """A plant with the forces on it, as one that has a step of its own: all substeps, and what rolls."""

    inner: Parts

    def __getattr__(self, name: str) -> Any:
        if name in ("nq", "nv", "nu", "integrate", "difference", "coordinates"):
            return getattr(self.inner.plant, name)
        raise AttributeError(name)

    def initial_state(self, context: object) -> Any:
        plant = self.inner.plant
        return plant.initial_state(context) if hasattr(plant, "initial_state") else None

    def step(self, t: Any, q: Any, v: Any, u: Any, h: Any, f: Any, memory: Any) -> _Moved:
        a, q, v, memory = moved_on(self.inner, t, h / self.inner.substeps, q, v, u, memory)
        return _Moved(q, self.inner.law.project(q, v) if self.inner.is_constrained else v, memory, a)

    def signals(self, t: Any, q: Any, v: Any, u: Any, f: Any, memory: Any) -> dict[str, Any]:
        return {
            name: pair for _, told in told_by(self.inner, t, q, v, u, memory) for name, pair in told.items()
        }


class CompiledPlant:
    """A plant with the forces on it, each step of which is one call of machine code: for one loop alone.

    Parameters
    ----------
    parts : Parts
        The loop.
    context : Context
        What its controller is told.
    q, v : ndarray, shape (nq,), (nv,)
        Where it starts.

    Raises
    ------
    NotTraceable
        If plant, forces or integrator cannot be compiled.
    """

    def __init__(self, parts: Parts, context: Context, q: Array, v: Array) -> None:
        self.plant = plant = parts.plant
        self.nq, self.nv, self.nu = plant.nq, plant.nv, plant.nu
        self.integrate, self.difference = plant.integrate, plant.difference
        for name in ("inputs", "coordinates", "measures", "measured"):
            if hasattr(plant, name):
                setattr(self, name, getattr(plant, name))
        inner = replace(parts, controller=None, recorder=None, trajectory=None)
        whole = Parts(_Whole(inner), _Given(np.zeros(self.nu)), (), None, Trace())
        reference = Reference(*context.reference)
        first = Reference(*(part[0] for part in reference))
        options: dict[str, Any] = {"dt": context.dt, "spread": [_U], "single": True}
        program = program_of(whole, context, (q, v), first, **options)
        whole, self._loop = whole.on_symbols(), program.loop
        values, begun = whole.parameters(), initial_memory(whole, context, len(first.v))
        memory = [np.asarray(value, np.float64) for tree in begun for _, value in leaves(tree)]
        uniforms = program.uniforms_of(context.dt, values, memory)
        self._block = program.blocks_of((q[None], v[None]), 1, values, memory, {})
        self._row = self._block[0, :, 0]
        self._samples = program.samples_of(context.t, reference, uniforms, [])
        self._kept = aligned((1, 1, self._loop.outputs_kept, 1))
        self._dt, self._begun = context.dt, begun.plant
        self._uniforms, self._counts, self._rings = uniforms, np.zeros(1, np.int32), aligned((1, 1))
        where = (self._samples, uniforms, self._rings, self._counts, self._kept)
        sample, uniform, rings, counts, kept = (array.ctypes.data for array in where)
        self._first, self._stride = sample, self._samples.strides[0]
        self._call = partial(program.function, self._block.ctypes.data, 0, 1)
        self._behind = uniform, rings, counts, 1, 1, kept
        self._u = len(self._loop.states) + self._loop.parameters[_U].first
        self._leaves = [leaf for leaf in self._loop.leaves if leaf.owner == "plant"]
        self._signals: dict[str, Any] = {}

    def initial_state(self, context: object) -> Any:
        """Return what the plant keeps before the first sample."""
        return self._begun

    def step(self, t: float, q: Array, v: Array, u: Array, h: float, f: Any, memory: Any) -> _Moved:
        """Return the state a sample later; the forces are its own."""
        row, nq, n = self._row, self.nq, self.nq + self.nv
        row[:nq], row[nq:n], row[self._u : self._u + self.nu] = q, v, u
        for leaf, (_, value) in zip(self._leaves, leaves(memory), strict=True):
            if leaf.kind == "state":
                row[leaf.first : leaf.first + prod(leaf.shape)] = np.ravel(value)
        self._call(self._first + round(t / self._dt) * self._stride, 1, *self._behind)
        kept, first, found = self._kept[0, 0, :, 0], 0, {}
        for name, (shape, nodes) in self._loop.kept.items():
            found[name] = kept[first : first + len(nodes)].reshape(shape).copy()
            first += len(nodes)
        units = self._loop.units
        self._signals = {name: (unit, found[f"signal {name}"]) for name, unit in units.items()}
        places = iter(self._leaves)

        def after(value: Any) -> Any:
            leaf = next(places)
            if leaf.kind != "state":
                return value
            return row[leaf.first : leaf.first + prod(leaf.shape)].reshape(leaf.shape).copy()

        return _Moved(row[:nq].copy(), row[nq:n].copy(), mapped(memory, after), found["a"])

    def signals(self, *asked: Any) -> dict[str, Any]:
        """Return what plant and forces told at the sample whose step was the last."""
        return self._signals


def with_compiled_plant(parts: Parts, context: Context, q: Array, v: Array) -> Parts:
    """Return the loop with plant and forces as machine code; raises `NotTraceable` where they cannot be."""
    return replace(parts, plant=CompiledPlant(parts, context, q, v), forces=(), integrator=None, substeps=1)
