"""Parts whose parameters are spread: what they derive of them when they are made belongs to each robot."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from pinmobile import (
    COMPILED,
    PYTHON,
    InvalidArgument,
    MobileRobot,
    Uniform,
    ensemble,
    simulate,
)
from pinmobile.errors import SlowerEngine
from tests.parts import PID, Eight, Nodding

ROBOT = MobileRobot(30.0, 1.3, com=(0.1, 0.05))
PATH = Nodding(Eight())
OPTIONS: Any = {"dt": 0.02, "duration": 0.6}
KP = np.array([80.0, 100.0, 130.0])


class Stateless:
    def initial_state(self, context: Any) -> Any:
        return context.difference


class Damped(Stateless):
    """A plain class that derives the damping, as a number that it states or not, in a list or a closure."""

    parameters: Any = ("kp",)

    def __init__(self, kp: float, ratio: float = 1.0) -> None:
        self.kp, self.ratio = kp, ratio
        self.kd = 2 * ratio * np.sqrt(30.0 * kp)

    def __call__(self, t: float, q: Any, v: Any, reference: Any, difference: Any) -> Any:
        return self.kp * difference(q, reference.q) + self.kd * (reference.v - v), difference


class Stating(Damped):
    parameters = ("kp", "kd")


class Listing(Damped):
    def __init__(self, kp: float) -> None:
        super().__init__(kp)
        self.gains: Any = [kp, {"kd": self.kd}]
        self.kd = 0.0

    def __call__(self, t: float, q: Any, v: Any, reference: Any, difference: Any) -> Any:
        kp, more = self.gains
        return kp * difference(q, reference.q) + more["kd"] * (reference.v - v), difference


class Closing(Stateless):
    parameters = ("kp",)

    def __init__(self, kp: float) -> None:
        kd = 2 * np.sqrt(30.0 * kp)
        damping: Any = lambda rate: kd * rate  # noqa: E731
        self.kp, self.damping = kp, damping

    def __call__(self, t: float, q: Any, v: Any, reference: Any, difference: Any) -> Any:
        return self.kp * difference(q, reference.q) + self.damping(reference.v - v), difference


@dataclass
class OfDataclass(Stateless):
    kp: float
    kd: float = field(init=False)
    parameters: Any = ("kp", "kd")

    def __post_init__(self) -> None:
        self.kd = 2 * np.sqrt(30.0 * self.kp)

    __call__ = Damped.__call__


class Twice(Stateless):
    """A plain wrapper that derives something of what it wraps."""

    def __init__(self, controller: Any) -> None:
        self.controller, self.most = controller, 10 * controller.kp

    def __call__(self, t: float, q: Any, v: Any, reference: Any, state: Any) -> Any:
        u, state = self.controller(t, q, v, reference, state)
        return np.clip(u, -self.most, self.most) + 1e-3 * self.most, state


@dataclass
class Simple(Stateless):
    kp: float
    parameters: Any = ("kp",)

    def __call__(self, t: float, q: Any, v: Any, reference: Any, difference: Any) -> Any:
        return self.kp * difference(q, reference.q) + 120.0 * (reference.v - v), difference


MAKE: dict[str, tuple[Any, str]] = {
    "an attribute": (Damped, "kp"),
    "a stated attribute": (Stating, "kp"),
    "a list": (Listing, "kp"),
    "a closure": (Closing, "kp"),
    "a stated field": (OfDataclass, "kp"),
    "of an inner part": (lambda kp: Twice(Simple(kp)), "controller.controller.kp"),
}


@pytest.mark.parametrize("what", MAKE)
def test_what_is_derived_is_derived_for_each_robot(what: str) -> None:
    make, name = MAKE[what]
    with pytest.warns(SlowerEngine, match=r"makes \w+ of kp once; compute it in the law"):
        runs = ensemble(ROBOT, make(100.0), PATH, n=3, spread={name: KP}, **OPTIONS)
    assert runs.engine == "PYTHON"
    for i, kp in enumerate(KP):
        alone = simulate(ROBOT, make(kp), PATH, **OPTIONS)
        np.testing.assert_allclose(runs.max_error[i], alone.max_error(), rtol=1e-12)
        np.testing.assert_array_equal(runs.trace(i).u, alone.u)


class Hidden(Stateless):
    parameters = ("kp",)

    def __init__(self, gain: float) -> None:
        self.kp, self.kd = gain, 2 * np.sqrt(30.0 * gain)

    __call__ = Damped.__call__


class Changing(Hidden):
    """It keeps its argument under its name, but not as it was."""

    def __init__(self, kp: float) -> None:
        super().__init__(2 * kp)


class Constant(Hidden):
    def __init__(self) -> None:
        super().__init__(100.0)


@pytest.mark.parametrize("controller", [Hidden(100.0), Changing(50.0), Constant()])
def test_a_class_that_cannot_be_made_again_is_told_what_to_write(controller: Any) -> None:
    why = (
        rf"^controller is a {type(controller).__name__}, which cannot be made again with another kp and "
        r"may have made kd of that: expected an __init__ that takes kp and keeps each argument under its own "
        r"name, a dataclass, or with_parameters\(\*\*values\), which returns a new one$"
    )
    for engine in (None, COMPILED, PYTHON):
        with pytest.raises(InvalidArgument, match=why):
            ensemble(ROBOT, controller, PATH, n=3, spread={"kp": KP}, engine=engine, **OPTIONS)
    # What is not spread is nobody's to make again.
    assert ensemble(ROBOT, controller, PATH, n=3, spread={"mass": KP}, **OPTIONS).engine == "COMPILED"


class Remaking(Hidden):
    def with_parameters(self, kp: float) -> Any:
        return Remaking(kp)


def test_a_class_may_say_itself_how_it_is_made_again() -> None:
    remade: Any = Remaking
    with pytest.warns(SlowerEngine, match="makes kd of kp once"):
        runs = ensemble(ROBOT, remade(100.0), PATH, n=3, spread={"kp": KP}, **OPTIONS)
    for i, kp in enumerate(KP):
        np.testing.assert_array_equal(runs.trace(i).u, simulate(ROBOT, remade(kp), PATH, **OPTIONS).u)


class OfOne(Stateless):
    """Nothing is there that could be derived."""

    parameters = ("kp",)

    def __init__(self) -> None:
        self.kp = 100.0

    __call__ = Simple.__call__


class Wrapping(Stateless):
    parameters = ("kp",)

    def __init__(self, inner: Any, gain: float) -> None:
        self.controller, self.kp = inner, gain

    def initial_state(self, context: Any) -> Any:
        return self.controller.initial_state(context)

    def __call__(self, t: float, q: Any, v: Any, reference: Any, state: Any) -> Any:
        u, state = self.controller(t, q, v, reference, state)
        return u + self.kp * (reference.q - q), state


@pytest.mark.parametrize("controller", [OfOne(), Wrapping(PID(), 50.0)])
def test_a_class_that_derives_nothing_is_compiled(controller: Any) -> None:
    runs = ensemble(ROBOT, controller, PATH, n=3, spread={"kp": Uniform(80, 120)}, **OPTIONS)
    assert runs.engine == "COMPILED"
    assert len(np.unique(runs.max_error[:, 0])) == 3
    np.testing.assert_allclose(runs.max_error[1], runs.trace(1).max_error(), rtol=1e-11)
