"""Every declared number of every kind of part, changed alone: both engines follow it, and alike."""

from functools import cache
from typing import Any

import numpy as np
import pytest

from pinmobile import InvalidArgument
from pinmobile.compiled.identity import is_traced
from pinmobile.loop import Loop, Samples
from pinmobile.loop._checks import chosen_integrator, sampled, started
from pinmobile.loop._engines import in_python
from pinmobile.loop._program import Compiled
from pinmobile.parts import numbers, replace
from pinmobile.plant import Context
from pinmobile.trajectories import Reference
from tests.frozen import by_lapack, loops

SAMPLES, DT = 6, 0.01
LOOPS = {name: (parts, options) for name, parts, options in (*loops(), *by_lapack())}
LONG = ("ur5", "ur5, base alone", "all", "all forces", "skid-steer", "mecanum Rolling", "mecanum Coulomb")
# Numbers that no law uses in these loops, or not in the first samples.
IDLE: dict[str, tuple[str, ...]] = {}


@cache
def made(name: str) -> tuple[Loop, Context, Any]:
    """Return a loop, its context, and a start off the reference, where all that has a rate moves."""
    (plant, controller, trajectory), options = LOOPS[name]
    integrator = chosen_integrator(plant, options.get("integrator"))
    forces = options.get("forces", ())
    loop = Loop(plant, controller, trajectory, forces, integrator, options.get("substeps", 1), Samples())
    t = 1.0 + DT * np.arange(SAMPLES)
    reference = sampled(trajectory, t, plant)
    q, v = started(plant, Reference(*(x[0] for x in reference)))
    context = Context.of(plant, dt=DT, t=t, reference=reference, trajectory=trajectory)
    moved = 0.05 * np.cos(np.arange(len(v)))
    q, v = plant.integrate(q, moved), v + 0.1 * np.sin(1.0 + np.arange(len(v)))
    return loop, context, (q, plant.project(q, v) if hasattr(plant, "project") else v)


def rows(samples: Any) -> Any:
    return {name: np.array([getattr(one, name) for one, _ in samples]) for name in ("q", "v", "u", "a")}


def by_python(loop: Loop, context: Context, start: Any) -> Any:
    return rows(list(in_python(loop, context, *start)))


def by_compiled(loop: Loop, context: Context, start: Any) -> Any:
    first = Reference(*(x[0] for x in context.reference))
    compiled = Compiled(loop, context, start, first, single=True)
    q, v = start
    from pinmobile.compiled import robot_keys

    keys = {name: robot_keys(context.seed, name, range(1)) for name in compiled.tape.keys}
    run = compiled.run((q[None], v[None]), context.t, Reference(*context.reference), keys=keys)
    return {name: run.kept[name][0] for name in ("q", "v", "u", "a")}


def changed(loop: Loop, path: str, value: Any) -> Loop | None:
    """Return the loop with another number, a little larger or, where that is impossible, smaller."""
    value = np.asarray(value, float)
    own = 1.0 + 0.01 * np.arange(1, value.size + 1).reshape(value.shape)
    for by, off in ((own, 1e-3), (own, 0.0), (1.01, 0.0), (1.0 / own, 0.0), (0.99, 0.0)):
        try:
            return replace(loop, {path: value * by + off * (value == 0.0)})
        except InvalidArgument:
            continue
    return None


@pytest.mark.parametrize("name", LOOPS)
def test_every_number_moves_both_engines_alike(name: str) -> None:
    loop, context, start = made(name)
    nominal, idle = by_python(loop, context, start), []
    for path, leaf in numbers(loop).items():
        if not is_traced(path) or path.startswith("recorder."):
            continue
        other = changed(loop, path, leaf.value)
        assert other is not None, path
        expected, found = by_python(other, context, start), by_compiled(other, context, start)
        for each, column in expected.items():
            size = max(np.abs(column).max(), 1e-3)
            np.testing.assert_allclose(
                found[each], column, rtol=0, atol=1e-9 * size, err_msg=f"{path}, {each}"
            )
        if all(np.array_equal(nominal[each], expected[each]) for each in expected):
            idle.append(path)
    print(name, idle)
