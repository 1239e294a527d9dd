"""Slopes of simulated logs, and numbers of any plant from a log."""

from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.arrays import Array
from pinmobile.identification._car_model import CarModel
from pinmobile.identification._excitation import _Search
from pinmobile.identification._planar_model import PlanarModel, PlanarProblem
from pinmobile.identification._simulation import Segments, linearize, simulate
from pinmobile.identification._velocity_model import VelocityModel

NO_LIMIT = dict.fromkeys(VelocityModel.limits(), np.inf)


def segments_of(inputs: int, states: int, dt: float = 0.03, lead: int = 3) -> Segments:
    """Return three random segments of twelve samples."""
    rng, at = np.random.default_rng(0), np.arange(3)[:, None] * 15 + np.arange(12 + lead)
    starts, zeros = 0.3 + 0.1 * rng.standard_normal((3, states)), np.zeros((3, 12, 1))
    u = 1.0 + 0.3 * rng.standard_normal((60, inputs))
    times, load = np.full(3, dt), np.zeros((3, 4))
    return Segments(times, zeros[..., 0], zeros, zeros[..., 0] == 0, times, starts, u, at, lead, load)


def planar(robot: Any, free: bool) -> tuple[Any, Array]:
    """Return the problem of a robot in the plane, and numbers away from its start."""
    model = PlanarModel.of(robot)
    base = model.prior(robot) + 0.3 * np.ones(model.size)
    problem = PlanarProblem(model, base, np.eye(len(base))[:, : len(base) - 1], 1.4, free)
    return problem, problem.start + 0.05


def by_commands(kind: Any, first: list[float], is_pose: bool, **given: float) -> tuple[Any, Array]:
    """Return a model of commands with a delay, and its numbers."""
    none = dict.fromkeys(kind.limits(), np.inf) | {"ahead": 0.0} | given
    return kind(("delay",), none, 3, 0.03, is_pose), np.array([*first, 0.04])


MOTOR = pm.Motor(resistance=1.2, torque_constant=0.04, voltage=24.0, gear=30.0, viscous=1e-3)
DRIVE = pm.WheelTable.differential(0.5, 0.1, motor=MOTOR, mass=1.0, spin_inertia=0.005)
CAR = [0.3, 0.9, 0.15, 0.02, 0.4, 0.01, 0.1]
CASES = {
    "a body": (*planar(pm.MobileRobot(30.0, 1.3), True), 3, 6),
    "motors": (*planar(pm.WheeledRobot(pm.MobileRobot(30.0, 1.3), DRIVE).by_voltage(), False), 2, 5),
    "speeds": (*by_commands(VelocityModel, [0.3, 0.25, 0.01, 1.1, 0.02, 1.05], False), 2, 2),
    "poses": (*by_commands(VelocityModel, [0.3, 0.25, 0.01, 1.1, 0.02, 1.05], True), 2, 5),
    "a car": (*by_commands(CarModel, CAR, False), 2, 3),
}


@pytest.mark.parametrize("case", CASES)
def test_slopes_of_a_simulated_log_are_those_of_differences(case: str) -> None:
    model, p, inputs, states = CASES[case]
    segments = segments_of(inputs, states)
    starts, every = segments.start, np.arange(len(p))
    value, slopes = linearize(model, segments, p, starts, every)
    assert np.abs(value - simulate(model, segments, p[None], starts[None])[0]).max() < 1e-12

    def change(j: int, h: float) -> Array:
        way = h * np.eye(len(p) + states)[j]
        ways = np.stack([way, -way])
        pair = simulate(model, segments, p + ways[:, : len(p)], starts + ways[:, None, len(p) :])
        return np.asarray((pair[0] - pair[1]) / (2 * h))

    for j, slope in enumerate(slopes):
        if j == model.shifted:  # the difference over whole samples itself
            assert np.abs(slope - change(j, 1.0)).max() == 0
            continue
        coarse, fine = change(j, 2e-4), change(j, 1e-4)
        best, error = (4 * fine - coarse) / 3, np.abs(fine - coarse).max()  # Richardson
        assert np.abs(slope - best).max() < 1e-8 + 0.1 * error, j


MECANUM = pm.WheelTable.mecanum(0.4, 0.48, 0.09, mass=1.0, spin_inertia=0.005)
BODY = pm.MobileRobot(30.0, 1.3, com=(0.1, 0.05))


@pytest.mark.parametrize("robot", [BODY, pm.WheeledRobot(BODY, DRIVE), pm.WheeledRobot(BODY, MECANUM)])
@pytest.mark.parametrize("reach", [0.1, 3.0])
def test_the_gradient_of_the_information_is_that_of_differences(robot: Any, reach: float) -> None:
    model, rng = PlanarModel.of(robot), np.random.default_rng(0)
    limits = [np.array(x) for x in ((reach, reach, 3.0), (1.0, 1.0, 1.5), (1.5, 1.5, 3.0))]
    search = _Search(model, model.prior(robot), (20.0, 60.0, 5), limits)
    raw, way = rng.standard_normal((2, 5, 2, model.free))
    _, gradient = search.smooth_cost(raw, 16.0)

    def change(h: float) -> float:
        ahead, behind = (search.smooth_cost(raw + x * way, 16.0)[0] for x in (h, -h))
        return (ahead - behind) / (2 * h)

    best, error = (4 * change(5e-5) - change(1e-4)) / 3, abs(change(5e-5) - change(1e-4))
    assert abs((gradient * way).sum() - best) < 1e-7 + error


def test_a_designed_motion_informs_more_than_any_of_many_random_ones() -> None:
    limits = [np.array(x) for x in ((1.5, 1.5, np.pi), (1.0, 1.0, 1.5), (1.5, 1.5, 3.0))]
    model, rng = PlanarModel.of(BODY), np.random.default_rng(1)
    search = _Search(model, model.prior(BODY), (20.0, 60.0, 5), limits)
    random = [search.coefficients(rng.standard_normal((5, 2, 3))) for _ in range(300)]
    designed = np.asarray(pm.excitation(BODY).coefficients)
    assert search.cost(designed)[0] < min(search.cost(x)[0] for x in random) - 5.0
    assert np.allclose(search.coefficients(designed), designed)  # it reaches the limits
