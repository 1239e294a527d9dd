"""Estimates of twenty short logs, as a table: neither restructuring nor another machine changes them.

`python -m tests.test_identification_frozen` prints the table.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from tests import test_identification as forces, test_velocity_identification as speeds

pytestmark = pytest.mark.once

TABLE = Path(__file__).with_suffix(".txt")
BELIEVED = pm.MobileRobot(20.0, 1.0)
WHEEL: dict[str, Any] = {"mass": 1.0, "spin_inertia": 0.005}


def short(log: pm.Log, offset: Any = 0.0) -> pm.Log:
    """Return half a minute of a log, with an offset of its inputs."""
    part = log.between(0.0, 31.0)
    return pm.Log(part.t, part.q, part.u + np.array(offset), part.twist, part.wheel_rates, units=part.units)


@cache
def run_by_torques() -> pm.Rollout:
    """Return the run of a differential drive by torques."""
    plant = forces.on_wheels(forces.BODY).wheeled
    path = pm.excitation(plant, duration=31.0, period=11.0)
    law = pm.Backstepping(pm.UnicycleTracking(), plant)
    return pm.simulate(plant, law, path, dt=0.02, substeps=4, engine=pm.Engine.COMPILED)


def of_mecanum() -> Any:
    """Return what is found of a base on mecanum wheels."""
    table = pm.WheelTable.mecanum(0.4, 0.48, 0.09, **WHEEL)
    plant, path = pm.WheeledRobot(forces.BODY, table), forces.motion()
    run = pm.simulate(
        plant, pm.ComputedTorque(plant), path, dt=0.02, duration=31.0, substeps=4, engine=pm.Engine.COMPILED
    )
    return pm.identify(
        pm.Log.from_rollout(run, 1e-3, 0.02, seed=1), pm.WheeledRobot(BELIEVED, table), method="weak"
    )


def of_a_car() -> pm.WheeledRobot:
    """Return a robot with wheels that steer, which is refused."""
    return pm.WheeledRobot(forces.BODY, pm.WheelTable.car(0.5, 0.4, 0.1, yaw_inertia=0.003, **WHEEL))


def spoiled() -> pm.Log:
    """Return a log with outliers and lost rows."""
    log, rng = forces.log(), np.random.default_rng(0)
    q, wild = np.array(log.q), rng.choice(1500, 30, replace=False)
    q[wild] += rng.choice([-1, 1], (30, 3)) * rng.uniform(0.05, 0.3, (30, 3))
    q[[100, 500]] = np.nan
    return short(pm.Log(log.t, q, log.u))


LIMITED = pm.VelocityRobot(speeds.ROBOT.theta, accelerations=(0.6, 1.5))
CASES: dict[str, Callable[[], Any]] = {
    "no noise": lambda: pm.identify(short(pm.Log.from_rollout(forces.driven()))),
    "noise": lambda: pm.identify(short(forces.log())),
    "noise of poses": lambda: pm.identify(short(forces.log(1, 0, forces=False))),
    "weak form": lambda: pm.identify(short(forces.log()), method="weak"),
    "late": lambda: pm.identify(short(forces.log(1, 3))),
    "late, ignored": lambda: pm.identify(short(forces.log(0, 3)), delay=0.0, method="weak"),
    "offset": lambda: pm.identify(short(forces.log(), (20.0, 0.0, -1.0))),
    "outliers": lambda: pm.identify(spoiled(), pm.MobileRobot(30.0, 1.5)),
    "straight": lambda: pm.identify(short(forces.straight()), pm.MobileRobot(30.0, 1.5)),
    "volts": lambda: pm.identify(short(forces.rolled(False)), forces.on_wheels(BELIEVED)),
    "wheels alone": lambda: pm.identify(
        short(forces.rolled(False)),
        pm.WheelTable.differential(0.5, 0.1, motor=forces.MOTOR, **WHEEL),
        method="weak",
    ),
    "loads": lambda: pm.identify(
        [short(forces.rolled(False)), short(forces.rolled(True))],
        forces.on_wheels(BELIEVED),
        loads=[None, forces.LOAD],
        method="weak",
    ),
    "torques": lambda: pm.identify(
        pm.Log.from_rollout(run_by_torques(), 1e-3, 0.02, seed=1), forces.on_wheels(BELIEVED).wheeled
    ),
    "noisy torques": lambda: pm.identify(
        pm.Log.from_rollout(run_by_torques(), 1e-3, 0.3, seed=1), forces.on_wheels(BELIEVED).wheeled
    ),
    "mecanum": of_mecanum,
    "car": lambda: pm.identify(forces.log(), of_a_car()),
    "speeds": lambda: pm.identify_velocity(speeds.logged()),
    "speeds, late poses": lambda: pm.identify_velocity(speeds.logged(late=3, pose=True)),
    "speeds, axle": lambda: pm.identify_velocity(
        speeds.logged(pm.VelocityRobot(speeds.ROBOT.theta, ahead=0.15), pose=True), ahead=None
    ),
    "speeds, limits": lambda: pm.identify_velocity(speeds.logged(LIMITED), accelerations=None, delay=0.0),
}


BODY = {"mass": 30.0, "com_x": 0.06, "com_y": 0.02, "yaw_inertia": 1.3}
THETA = {f"theta_{k}": x for k, x in enumerate(speeds.ROBOT.theta.tolist(), 1)}
OFFSET = {"offset_Fx": 20.0, "offset_Fy": 0.0, "offset_Mz": -1.0}
TRUE = {
    **dict.fromkeys(("no noise", "noise", "noise of poses", "weak form", "late", "outliers"), forces.TRUE),
    **dict.fromkeys(("volts", "wheels alone", "torques", "noisy torques", "mecanum"), BODY),
    "offset": forces.TRUE | OFFSET,
    "loads": BODY | {"input_scale": 1.0},
    **dict.fromkeys(("speeds", "speeds, late poses"), THETA),
    "speeds, axle": THETA | {"ahead": 0.15},
    "speeds, limits": THETA | {"acceleration": 0.6, "yaw_acceleration": 1.5},
}
LATE = {"late": 0.06, "speeds, late poses": 0.3}


def told(name: str) -> str:
    """Return a line of the table: the delay, then estimates with the half widths of their intervals."""
    try:
        found = CASES[name]()
    except pm.InvalidArgument as error:
        return f"{name}: {error}"
    pairs = zip(found.parameters.items(), np.sqrt(np.diag(found.covariance)), strict=True)
    numbers = [f"{each} {value:.7g} {2 * deviation:.4g}" for (each, value), deviation in pairs]
    counts = f"{found.method}, rank {found.rank}, {found.outliers} outliers, {found.dropped} dropped"
    return f"{name}: {counts}; late {found.delay:.7g} 0.002, {', '.join(numbers)}"


@pytest.mark.long
def test_estimates_are_those_of_the_table() -> None:
    lines = TABLE.read_text().splitlines()
    assert [line.partition(":")[0] for line in lines] == list(CASES)
    wrong = []
    for line in lines:
        name, now = line.partition(":")[0], told(line.partition(":")[0])
        (before, _, old), (after, _, new) = (text.partition("; ") for text in (line, now))
        wrong += [now] * (before != after)
        rows = zip(old.split(", "), new.split(", "), strict=True) if old and new else ()
        for (one, *numbers), (same, *others) in ([entry.split(" ") for entry in row] for row in rows):
            (value, half), (found, wide) = map(float, numbers), map(float, others)
            tolerance = 0.02 * half + 1e-5 * abs(value)
            if one != same or max(abs(found - value), abs(wide - half)) > tolerance:
                wrong.append(f"{name}: {one} is {found} +- {wide}, was {value} +- {half}")
            true = {"late": LATE.get(name, 0.0), **TRUE[name]}.get(one) if name in TRUE else None
            if true is not None and abs(found - true) > 2 * wide + 2e-3 * abs(true):
                wrong.append(f"{name}: {one} is {found} +- {wide}, truly {true}")
    assert not wrong


if __name__ == "__main__":
    print("\n".join(map(told, CASES)))
