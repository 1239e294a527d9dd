"""Every declared number of every kind of part, changed alone: both engines follow it, and alike."""

import contextlib
from functools import cache
from typing import Any

import numpy as np
import pytest

from pinmobile import InvalidArgument, VelocityRobot
from pinmobile.compiled import robot_keys
from pinmobile.compiled.identity import is_traced
from pinmobile.controllers import AdaptiveVelocity, DynamicFeedback, Kanayama, VelocityCommand
from pinmobile.errors import NotTraceable
from pinmobile.loop import Loop, Samples
from pinmobile.loop._checks import sample_reference, select_integrator
from pinmobile.loop._engines import Compiled, python_samples
from pinmobile.parts import numbers, replace
from pinmobile.plant import Context
from pinmobile.trajectories import Reference
from tests.frozen import CIRCLE, by_lapack, loops

DT = 0.01
COMMANDED = VelocityRobot([0.26, 0.25, 0.03, 1.1, 0.2, 1.2], accelerations=(2.0, 4.0))
LOOPS = {name: (parts, options) for name, parts, options in (*loops(), *by_lapack()) if name != "skid-steer"}
OF_COMMANDS: dict[str, Any] = {
    "adaptive velocity": AdaptiveVelocity(COMMANDED, leakage=0.1),
    "dynamic feedback": VelocityCommand(DynamicFeedback(), COMMANDED),
    "Kanayama": VelocityCommand(Kanayama(), COMMANDED),
}
LOOPS |= {name: ((COMMANDED, each, CIRCLE), {}) for name, each in OF_COMMANDS.items()}
# Ends of the paths of numbers that no law uses in these loops, or not where they begin.
OF_MOTORS = "motor.gear", "motor.efficiency", "motor.viscous", "motor.coulomb"
OF_FRICTION = "friction.mu", "friction.rolling", "friction.across", "friction.slip"
AT_LIMITS = "forces.0.end", "dead_zone", "controller.steer", "controller.arms", "accelerations"
UNUSED = (*OF_MOTORS, *OF_FRICTION, *AT_LIMITS)
OF_MODELS = (
    *("mass", "yaw_inertia", "com", "spin_inertia", "resistance", "torque_constant"),
    *("left.y", "right.y", "radius"),
)
OTHERS = {  # of controllers that ask their models for little, or whose limits are far
    **dict.fromkeys(("PDGravity", "ADRC", "wheel speed", "mecanum Rolling", "mecanum Coulomb"), OF_MODELS),
    "volts": (*OF_MODELS, "controller.controller.steer", "controller.controller.arms"),
    "saturated": ("limits",),
    "all": ("ki",),
    "adaptive velocity": ("lower", "upper", "theta"),
    **dict.fromkeys(("commanded", "dynamic feedback", "Kanayama"), ("theta", "least")),
}
# Numbers that a faster loop changes too: of the controller of `mecanum Rolling`.
ELSEWHERE = {"mecanum Coulomb": ("controller.",)}
# A controller that believes in another axle refuses the reference; two wheels are always on one.
ITS_OWN_AXLE = "robot.ahead", "left.x", "right.x"


@cache
def made(name: str) -> tuple[Loop, Context, Any]:
    """Return a loop, its context, and a start off the reference, where all that has a rate moves."""
    (plant, controller, trajectory), options = LOOPS[name]
    integrator = select_integrator(plant, options.get("integrator"))
    forces = options.get("forces", ())
    loop = Loop(plant, controller, trajectory, forces, integrator, options.get("substeps", 1), Samples())
    steps = 3 if name.startswith("adaptive") else 2  # leakage is felt in the third
    context = context_of(loop, 1.0 + DT * np.arange(steps))
    q, v = plant.start(Reference(*(x[0] for x in context.reference)))
    moved = 0.05 * np.cos(np.arange(len(v)))
    q, v = plant.integrate(q, moved), v + 0.1 * np.sin(1.0 + np.arange(len(v)))
    return loop, context, (q, plant.project(q, v) if hasattr(plant, "project") else v)


def context_of(loop: Loop, t: Any) -> Context:
    """Return the context of the samples of a loop at times."""
    reference = sample_reference(loop.trajectory, t, loop.plant)
    return Context.of(loop.plant, dt=DT, t=t, reference=reference, trajectory=loop.trajectory)


def rows(samples: Any) -> Any:
    return {name: np.array([getattr(one, name) for one, _ in samples]) for name in ("q", "v", "u", "a")}


def by_python(loop: Loop, context: Context, start: Any) -> Any:
    return rows(list(python_samples(loop, context, *start)))


def by_compiled(
    loop: Loop, context: Context, start: Any, others: list[Loop], paths: list[str] | None = None
) -> Any:
    """Return what robots do, of which each has the numbers (all, or those of paths) of another loop."""
    paths, n = varied(loop) if paths is None else paths, max(len(others), 1)
    first, starts = Reference(*(x[0] for x in context.reference)), [np.atleast_2d(x) for x in start]
    values = {
        path: np.array([np.asarray(numbers(one)[path].value, float) for one in others]) for path in paths
    }
    spread = {path: np.ones(value.shape[1:], bool) for path, value in values.items()}
    try:
        compiled = Compiled(loop, context, tuple(x[0] for x in starts), first, spread=spread)
    except NotTraceable:  # gains that follow from its numbers are those of all robots
        own = [[x[k % len(x)] for x in starts] for k in range(n)]
        found = [by_compiled(one, context, at, [one], []) for one, at in zip(others, own, strict=True)]
        return {name: np.concatenate([one[name] for one in found]) for name in found[0]}
    q, v = (np.tile(x, (n // len(x), 1)) for x in starts)
    keys = {name: np.repeat(robot_keys(context.seed, name, range(1)), n) for name in compiled.tape.keys}
    given: Any = {"values": values, "keys": keys}
    run = compiled.run((q, v), context.t, Reference(*context.reference), **given)
    return {name: run.kept[name] for name in ("q", "v", "u", "a")}


def varied(loop: Loop) -> list[str]:
    """Return the paths of the numbers of a loop's law."""
    return [path for path in numbers(loop) if is_traced(path) and not path.startswith("recorder.")]


def changed(loop: Loop, path: str, value: Any) -> Loop:
    """Return the loop with another number, a little larger or, where that is impossible, smaller."""
    value, both = np.asarray(value, float), [path]
    if path.endswith("wheels.left.x"):
        both.append(path.replace("left", "right"))
    own = 1.0 + 0.01 * np.arange(1, value.size + 1).reshape(value.shape)
    tried = [value * own + 1e-3 * (value == 0.0), value * 1.01, value / own, value * 0.99]
    if value.shape == (6,):  # of an inertia, the moments alone
        tried += [value + 1e-3 * np.array(axes) for axes in ([1, 1, 1, 0, 0, 0], [1, 0, 0, 1, 0, 1])]
    for other in tried:
        with contextlib.suppress(InvalidArgument):
            if not np.array_equal(other, value) or np.isinf(value).any():
                return replace(loop, dict.fromkeys(both, other if other.ndim else float(other)))
    raise AssertionError(f"{path} has no other value than {value}")


@pytest.mark.long
@pytest.mark.once
@pytest.mark.parametrize("name", LOOPS)
def test_every_number_moves_both_engines_alike(name: str) -> None:
    loop, context, start = made(name)
    nominal, unused = by_python(loop, context, start), []
    paths = [path for path in varied(loop) if not path.endswith("wheels.right.x")]
    paths = [path for path in paths if not (path.startswith("controller.") and path.endswith(ITS_OWN_AXLE))]
    paths = [path for path in paths if not any(part in path for part in ELSEWHERE.get(name, ()))]
    others = [changed(loop, path, numbers(loop)[path].value) for path in paths]
    found = by_compiled(loop, context, start, others)
    for k, (path, other) in enumerate(zip(paths, others, strict=True)):
        expected = by_python(other, context, start)
        for each, column in expected.items():
            within = 1e-9 * max(np.abs(column).max(), 1e-3)
            np.testing.assert_allclose(found[each][k], column, rtol=0, atol=within, err_msg=f"{path}, {each}")
        if all(np.array_equal(nominal[each], expected[each]) for each in expected):
            unused.append(path)
    if name == "volts":
        assert not [path for path in unused if path.startswith("plant.") and path.endswith("motor.gear")]
    if name in ("differential Coulomb", "mecanum Coulomb"):
        resisted = [path for path in paths if path.endswith("friction.rolling")]
        assert resisted
        assert not {*resisted} & {*unused}
    left = [path for path in unused if not path.endswith(UNUSED)]
    assert [
        path for path in left if path.startswith("plant.") or not path.endswith(OTHERS.get(name, ()))
    ] == []
