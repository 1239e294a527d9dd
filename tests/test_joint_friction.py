"""`JointFriction`: what it does to arms in `simulate`, alone, on many states, and on symbols."""

from typing import Any

import numpy as np
import pytest

from pinmobile import JointFriction, MobileRobot, law, rk4, simulate
from pinmobile.arrays import Array
from pinmobile.trajectories import Reference
from tests.refusals import refusals

PANDA = MobileRobot.box().mount("panda")


class Resting:
    duration = 1.0

    def __call__(self, t: Any) -> Reference:
        zero = np.zeros((*np.shape(t), 3))
        return Reference(zero, zero, zero)


def test_each_coordinate_feels_its_own() -> None:
    friction = JointFriction((0, 2, 0, 1), (0, 0, 3, 4), 0.5)
    v = np.array([5.0, -2.0, 0.5, -3.0])
    expected = [0, 4, -3 / np.sqrt(2), 3 + 4 * 3 / np.hypot(3, 0.5)]
    np.testing.assert_allclose(friction.on_coordinates(0.0, v, v), expected, rtol=1e-15)
    many = np.stack([v, -v, 0 * v])
    np.testing.assert_array_equal(friction.on_coordinates(0.0, many, many)[1], np.negative(expected) + 0.0)
    np.testing.assert_array_equal(friction.on_coordinates(0.0, many, many)[2], np.zeros(4))
    assert (JointFriction(1, 2).on_coordinates(0.0, many, many) * many <= 0).all()


def test_by_default_it_is_that_of_the_files() -> None:
    friction = JointFriction.of(PANDA)
    np.testing.assert_array_equal(friction.viscous, PANDA.joint_damping)
    np.testing.assert_array_equal(friction.coulomb, PANDA.joint_friction)
    assert np.asarray(friction.viscous).max() > 0
    assert (np.asarray(friction.viscous)[:3] == 0).all()


def test_the_energy_that_an_arm_loses_is_the_work_of_its_friction() -> None:
    """Of a swing: the change of energy is the integral of the power of friction and input."""
    arm = np.append(np.zeros(3), np.ones(9))
    friction, v0 = JointFriction(0.5 * arm, 0.2 * arm, 0.2), np.linspace(-0.1, 0.15, 12) * arm

    def held(t: float, q: Array, v: Array, reference: Any) -> Array:
        return PANDA.gravity(PANDA.rest)

    run = simulate(
        PANDA, law(held), Resting(), dt=5e-4, duration=0.2, v0=v0, integrator=rk4, forces=[friction]
    )
    energy = PANDA.kinetic_energy(run.q, run.v) + PANDA.potential_energy(run.q)
    power = np.einsum("ki,ki->k", friction.on_coordinates(run.t, run.q, run.v) + run.u, run.v)
    work = np.sum((power[1:] + power[:-1]) / 2 * np.diff(run.t))  # the trapezoid's error goes with dt^2
    assert energy[-1] - energy[0] == pytest.approx(work, rel=1e-3)
    free = simulate(PANDA, law(held), Resting(), dt=5e-4, duration=0.2, v0=v0, integrator=rk4)
    assert np.abs(run.v[-1]).max() < np.abs(free.v[-1]).max()


test_what_is_no_friction_is_refused = refusals(
    (lambda: JointFriction((1, -1)), "viscous is -1.0 N s/m or N m s/rad, expected >= 0"),
    (
        lambda: simulate(
            PANDA, law(lambda *_: np.zeros(12)), Resting(), dt=0.1, forces=[JointFriction((1, 2))]
        ),
        r"viscous has shape \(2,\), expected \(\) or \(..., 12\), as v has",
    ),
)
