"""Many states of a robot at once: the laws of `ArticulatedBody`, compiled over leading axes.

What is compiled belongs to the form of a robot, which is its kinematics and which of its numbers are zero.
Masses, centres of mass, inertias, rotors and places of arms are handed over.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from math import prod
from typing import Any

import numpy as np

from pinmobile.arrays import Array, affordable, broadcast, finite_answer
from pinmobile.compiled import Batched, copied, processors
from pinmobile.errors import NotTraceable
from pinmobile.robot.articulated import ArticulatedBody
from pinmobile.robot.dh_chain import Law

MANY = 500
"""Number of states from which on they are compiled."""

_LARGEST = 12_000  # operations: building takes a second or two
_MOST = 128  # programs that stay
_FAR = 1e5  # [rad]: beyond, sine and cosine of compiled code lose digits
_lock = threading.Lock()
_known: OrderedDict[Any, Batched | None] = OrderedDict()


def answers(body: ArticulatedBody | None, law: Law, **arguments: Array) -> Array | None:
    """Return what a law gives for many states, in public order; None where it cannot be compiled.

    Parameters
    ----------
    body : ArticulatedBody, optional
        The robot, by `ArticulatedBody.each_its_own`.
    law : Law
        What is asked.
    **arguments : ndarray, shape (..., size)
        The states.

    Raises
    ------
    NotFinite
        If an answer is not finite.
    InvalidArgument
        If the answers would not fit into memory.
    """
    if body is None:
        return None
    program = _program(body, law, [x.shape[-1] for x in arguments.values()])
    if program is None:
        return None
    n = prod(broadcast(**arguments))
    affordable(f"{law.name} of {n:,} states", 1.0 * n * program.size, "ask for fewer at a time")
    near = [_near(body, x) if law.turns and name == "q" else x for name, x in arguments.items()]
    answer, squares = program(*near, *body.numbers.values(), threads=processors())
    return answer if np.isfinite(squares).all() else finite_answer(answer, **arguments)


def _program(body: ArticulatedBody, law: Law, sizes: list[int]) -> Batched | None:
    frames = [fixed for fixed in body.frames if fixed.name in law.options]
    arms = [k for k, (name, _) in enumerate(body.arms) if name in law.options]
    if law.options and not (frames or arms):
        return None  # of a virtual link, which moves with a part of the pose
    key = law.name, body.form, *map(body.form_of, frames), *arms
    with _lock:
        if key in _known:
            _known.move_to_end(key)
            return _known[key]
    made = _made(body, law, sizes)
    with _lock:
        _known[key] = made
        while len(_known) > _MOST:
            _known.popitem(last=False)
    return made


def _made(body: ArticulatedBody, law: Law, sizes: list[int]) -> Batched | None:
    names, numbers = list(body.numbers), body.numbers.values()

    def of_one(*given: Any) -> Any:
        state, own = given[: len(sizes)], given[len(sizes) :]
        robot = copied(body, dict(zip(names, own, strict=True)), {})
        answer = getattr(robot, law.name)(*state, *law.options)
        return answer, np.sum(answer * answer)  # which is finite where the answer is

    shapes = [*((size,) for size in sizes), *(x.shape for x in numbers)]
    try:
        return Batched(of_one, shapes, alike=len(names), pure=True, largest=_LARGEST)
    except NotTraceable:
        return None


def _near(body: ArticulatedBody, q: Array) -> Array:
    """Return configurations whose angles are within some turns."""
    if max(q.max(), -q.min()) <= _FAR:
        return q
    near, tree = q.copy(), body.linkage
    for at, turns, circle in zip(tree.q, tree.turns, tree.circles, strict=True):
        if turns and not circle:
            angle = near[..., at]
            far = np.abs(angle) > _FAR
            angle[far] = np.arctan2(np.sin(angle[far]), np.cos(angle[far]))
    return near
