"""A loop that is known is not traced again; one in which anything but a number has changed is."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from pinmobile.compiled import Parts, Place, Program, Reference, Trace, program_of
from tests.looping import (
    PD,
    Body,
    ComputedTorque,
    Delayed,
    Sinusoidal,
    circle,
    constant_acceleration,
    context,
    rk4,
)

pytestmark = pytest.mark.usefixtures("no_files")


@pytest.fixture
def no_files(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PINMOBILE_CACHE", "")


DT = 0.01
TIMES, CIRCLE = circle(DT, 50)
FIRST = Reference(*(x[0] for x in CIRCLE))
SCALE = 1.0
TABLE = np.array([1.0, 2.0, 3.0])
OPTIONS = {"scale": 1.0}


def scaled(e: Any) -> Any:
    return SCALE * e


class Scaled(PD):
    bias = 0.0

    def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
        e = scaled(reference.q - q) * OPTIONS["scale"]
        return self.kp * e * TABLE + self.kd * (reference.v - v) + self.bias, state


def loop(controller: Any, integrator: Any = constant_acceleration, forces: Any = ()) -> Parts:
    return Parts(Body(), controller, forces, integrator, Trace())


def program(parts: Parts, **options: Any) -> Program:
    return program_of(parts, context(DT), (CIRCLE.q[0], CIRCLE.v[0]), FIRST, dt=DT, **options)


def test_other_numbers_are_no_other_loop() -> None:
    one = program(loop(ComputedTorque(Body(), 4.0, 5.0), forces=(Sinusoidal(np.ones(3), 0.5),)))
    other = program(loop(ComputedTorque(Body(20.0), 8.0, 3.0), forces=(Sinusoidal(np.zeros(3), 0.7),)))
    assert one is other


def test_another_class_number_of_robots_or_setting_is_another_loop() -> None:
    known = program(loop(PD(4.0, 5.0)))
    assert program(loop(PD(4.0, 5.0))) is known
    assert program(loop(PD(4.0, 5.0), rk4)) is not known
    assert program(loop(Scaled(4.0, 5.0))) is not known
    assert program(loop(PD(4.0, 5.0)), single=True) is not known
    assert program(loop(PD(4.0, 5.0)), spread=[Place("plant", "mass")]) is not known
    delayed = program(loop(Delayed(PD(4.0, 5.0), 2)))
    assert program(loop(Delayed(PD(4.0, 5.0), 2))) is delayed
    assert program(loop(Delayed(PD(4.0, 5.0), 3))) is not delayed


def first_input(controller: Any) -> Any:
    parts = loop(controller)
    made = program(parts)
    start = CIRCLE.q[:1] + 0.1, CIRCLE.v[:1]
    return made.run(parts, context(DT), start, TIMES, CIRCLE, dt=DT).kept["u"][0, 0]


def test_a_changed_global_array_dict_or_attribute_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    controller = Scaled(4.0, 5.0)
    u = first_input(controller)
    monkeypatch.setitem(globals(), "SCALE", 2.0)
    np.testing.assert_allclose(first_input(controller), 2 * u, rtol=1e-14)
    TABLE[:] *= 3.0
    np.testing.assert_allclose(first_input(controller), 6 * u, rtol=1e-14)
    TABLE[:] /= 3.0
    monkeypatch.setitem(OPTIONS, "scale", 0.5)
    np.testing.assert_allclose(first_input(controller), u, rtol=1e-14)
    monkeypatch.setattr(Scaled, "bias", 1.0)
    np.testing.assert_allclose(first_input(controller), u + 1, rtol=1e-14)
    controller.bias = 2.0
    np.testing.assert_allclose(first_input(controller), u + 2, rtol=1e-14)


class Obliging:
    """It has whatever name it is asked for, but for those that Python itself looks for in a class."""

    __slots__ = ()

    def __getattr__(self, name: str) -> Any:
        return self


OBLIGING = Obliging()


def test_an_object_that_has_every_name_is_no_obstacle() -> None:
    class Holding(PD):
        def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
            gain = 3.0 if OBLIGING is not None else 0.0
            return gain * (reference.q - q), state

    np.testing.assert_allclose(first_input(Holding(1.0, 1.0)), -0.3, rtol=1e-12)


def test_a_changed_closure_is_noticed() -> None:
    def made(gain: float) -> tuple[Any, Any]:
        class Closed(PD):
            def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
                return gain * (reference.q - q), state

        def change(other: float) -> None:
            nonlocal gain
            gain = other

        return Closed(1.0, 1.0), change

    controller, change = made(2.0)
    u = first_input(controller)
    change(6.0)
    np.testing.assert_allclose(first_input(controller), 3 * u, rtol=1e-14)


@dataclass
class Settings:
    gain: float


def test_a_changed_object_inside_a_part_is_noticed() -> None:
    class Set(PD):
        def __init__(self, settings: Settings) -> None:
            super().__init__(1.0, 1.0)
            self.settings = settings

        def __call__(self, t: Any, q: Any, v: Any, reference: Any, state: Any) -> Any:
            return self.settings.gain * (reference.q - q), state

    settings = Settings(2.0)
    u = first_input(Set(settings))
    settings.gain = 6.0
    np.testing.assert_allclose(first_input(Set(settings)), 3 * u, rtol=1e-14)
