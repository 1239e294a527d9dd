"""Robots whose numbers are symbols: the same dynamics as Pinocchio's of robots with such numbers."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pinmobile import MobileRobot, PayloadBody
from pinmobile.arrays import Array
from pinmobile.compiled.functions import tracing
from pinmobile.compiled.symbolic import Symbols, entries, symbols
from pinmobile.compiled.tape import Node, Tape, evaluate
from pinmobile.parts import numbers, replace
from tests.test_vectorize import LOAD, asked

AT = (0.1, -0.05, 0.5, 0.4)
ROBOTS = {
    "bare": MobileRobot(30.0, 1.1, com=(0.1, -0.05, 0.2)),
    "loaded": MobileRobot(30.0, 1.1, com=(0.1, -0.05, 0.2)).attach(LOAD).attach(PayloadBody(2.0)),
    "ur5": MobileRobot.box().mount("ur5", AT).attach(LOAD).attach(PayloadBody(2.0), "base_link"),
    "two": MobileRobot.box().mount("kinova", AT).mount("ur3", (-0.2, 0, 0.2, 0), name="left"),
}


class Traced:
    """A robot whose numbers are symbols of a tape, and numbers to put in their place."""

    def __init__(self, robot: MobileRobot, *, growth: float = 0.02, zeros: bool = False) -> None:
        self.tape, self.inputs = Tape(10**6), dict[Any, float]()
        changes: dict[str, Any] = {}
        given: dict[str, Any] = {}
        for path, leaf in numbers(robot).items():
            value = np.asarray(leaf.value, np.float64)
            new = value * (1 + growth)
            given[path] = new
            changes[path] = self._symbols(new, zeros)
        self.robot = replace(robot, changes, nominal=True)
        self.other = replace(robot, given)

    def _symbols(self, value: Array, zeros: bool = True) -> Symbols:
        nodes: list[Any] = []
        for x in value.ravel():
            if not x and not zeros:
                nodes.append(0.0)
            else:
                nodes.append(self.tape.input("state", len(self.inputs)))
                self.inputs["state", len(self.inputs)] = float(x)
        return symbols(nodes, value.shape)

    def state(self, *arrays: Array) -> list[Any]:
        return [self._symbols(x) for x in arrays]

    def answer(self, function: Callable[..., Any], *given: Any) -> Array:
        """Return what a function of symbols gives for the numbers."""

        def law() -> Any:
            return function(*given)

        with tracing():
            found = law()
        table = np.asarray(entries(found), object)
        nodes = [x if type(x) is Node else self.tape.const(float(x)) for x in table.ravel()]
        values = evaluate(self.tape, [x.index for x in nodes], self.inputs)
        return np.array(values, float).reshape(table.shape)


@pytest.mark.parametrize(("name", "zeros"), [("loaded", True), ("ur5", True), ("two", False)])
def test_dynamics_on_symbols_are_those_of_the_robot_with_such_numbers(name: str, zeros: bool) -> None:
    traced = Traced(ROBOTS[name], zeros=zeros)
    rng, other = np.random.default_rng(5), traced.other
    v, a = rng.normal(size=(2, other.nv))
    given = {"q": other.random_configuration(rng), "v": v, "a": a}
    on_tape = dict(zip(given, traced.state(*given.values()), strict=True))
    methods = asked(traced.other) | {"coriolis_matrix": ("qv",), "integrate": ("qv",), "difference": ("qv",)}
    for method, (letters, *options) in (methods | {"pose": ("q",), "pose_rate": ("qv",)}).items():
        expected = getattr(traced.other, method)(*(given[x] for x in letters), *options)
        found = traced.answer(getattr(traced.robot, method), *(on_tape[x] for x in letters), *options)
        assert found.shape == np.shape(expected), method
        assert np.abs(found - expected).max() < 1e-9 * (1e-2 + np.abs(expected).max()), method
