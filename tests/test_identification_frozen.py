"""Estimates of twenty short logs, as a table: neither restructuring nor another machine changes them.

`python -m tests.test_identification_frozen` prints the table.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pinmobile import (
    COMPILED,
    Backstepping,
    ComputedTorque,
    InvalidArgument,
    Log,
    MobileRobot,
    Tracking,
    VelocityRobot,
    WheeledRobot,
    WheelTable,
    excitation,
    identify,
    identify_velocity,
    simulate,
)
from tests import test_identification as forces, test_velocity_identification as speeds

pytestmark = pytest.mark.once

TABLE = Path(__file__).with_suffix(".txt")
BELIEVED = MobileRobot(20.0, 1.0)
WHEEL: dict[str, Any] = {"mass": 1.0, "spin_inertia": 0.005}


def short(log: Log, offset: Any = 0.0) -> Log:
    """Return half a minute of a log, with an offset of its inputs."""
    part = log.between(0.0, 31.0)
    return Log(part.t, part.q, part.u + np.array(offset), part.twist, part.wheel_rates, units=part.units)


def by_torques(noise: float) -> Log:
    """Return the log of a differential drive whose torques are logged with noise."""
    plant = forces.on_wheels(forces.BODY).wheeled
    path = excitation(plant, duration=31.0, period=11.0)
    run = simulate(plant, Backstepping(Tracking(), plant), path, dt=0.02, substeps=4, engine=COMPILED)
    return Log.from_rollout(run, 1e-3, noise, seed=1)


def of_mecanum() -> Any:
    """Return what is found of a base on mecanum wheels."""
    table = WheelTable.mecanum(0.4, 0.48, 0.09, **WHEEL)
    plant, path = WheeledRobot(forces.BODY, table), forces.motion()
    run = simulate(plant, ComputedTorque(plant), path, dt=0.02, duration=31.0, substeps=4, engine=COMPILED)
    return identify(Log.from_rollout(run, 1e-3, 0.02, seed=1), WheeledRobot(BELIEVED, table), method="weak")


def of_a_car() -> WheeledRobot:
    """Return a robot with wheels that steer, which is refused."""
    return WheeledRobot(forces.BODY, WheelTable.car(0.5, 0.4, 0.1, **WHEEL))


def spoiled() -> Log:
    """Return a log with outliers and lost rows."""
    log, rng = forces.log(), np.random.default_rng(0)
    q, wild = np.array(log.q), rng.choice(1500, 30, replace=False)
    q[wild] += rng.choice([-1, 1], (30, 3)) * rng.uniform(0.05, 0.3, (30, 3))
    q[[100, 500]] = np.nan
    return short(Log(log.t, q, log.u))


LIMITED = VelocityRobot(speeds.ROBOT.theta, accelerations=(0.6, 1.5))
CASES: dict[str, Callable[[], Any]] = {
    "no noise": lambda: identify(short(Log.from_rollout(forces.driven()))),
    "noise": lambda: identify(short(forces.log())),
    "noise of poses": lambda: identify(short(forces.log(1, 0, forces=False))),
    "weak form": lambda: identify(short(forces.log()), method="weak"),
    "late": lambda: identify(short(forces.log(1, 3))),
    "late, ignored": lambda: identify(short(forces.log(0, 3)), delay=0.0, method="weak"),
    "offset": lambda: identify(short(forces.log(), (20.0, 0.0, -1.0))),
    "outliers": lambda: identify(spoiled(), MobileRobot(30.0, 1.5)),
    "straight": lambda: identify(short(forces.straight()), MobileRobot(30.0, 1.5)),
    "volts": lambda: identify(short(forces.rolled(False)), forces.on_wheels(BELIEVED)),
    "wheels alone": lambda: identify(
        short(forces.rolled(False)),
        WheelTable.differential(0.5, 0.1, motor=forces.MOTOR, **WHEEL),
        method="weak",
    ),
    "loads": lambda: identify(
        [short(forces.rolled(False)), short(forces.rolled(True))],
        forces.on_wheels(BELIEVED),
        loads=[None, forces.LOAD],
        method="weak",
    ),
    "torques": lambda: identify(by_torques(0.02), forces.on_wheels(BELIEVED).wheeled),
    "noisy torques": lambda: identify(by_torques(0.3), forces.on_wheels(BELIEVED).wheeled),
    "mecanum": of_mecanum,
    "car": lambda: identify(forces.log(), of_a_car()),
    "speeds": lambda: identify_velocity(speeds.logged()),
    "speeds, late poses": lambda: identify_velocity(speeds.logged(late=3, pose=True)),
    "speeds, axle": lambda: identify_velocity(
        speeds.logged(VelocityRobot(speeds.ROBOT.theta, ahead=0.15), pose=True), ahead=None
    ),
    "speeds, limits": lambda: identify_velocity(speeds.logged(LIMITED), accelerations=None, delay=0.0),
}


def told(name: str) -> str:
    """Return a line of the table: the delay, then estimates with the half widths of their intervals."""
    try:
        found = CASES[name]()
    except InvalidArgument as error:
        return f"{name}: {error}"
    pairs = zip(found.parameters.items(), np.sqrt(np.diag(found.covariance)), strict=True)
    numbers = [f"{each} {value:.7g} {2 * deviation:.4g}" for (each, value), deviation in pairs]
    return f"{name}: delay {found.delay:.7g} 0.002, {', '.join(numbers)}"


def test_estimates_are_those_of_the_table() -> None:
    lines = TABLE.read_text().splitlines()
    assert [line.partition(":")[0] for line in lines] == list(CASES)
    wrong = []
    for line in lines:
        name, _, before = line.partition(": ")
        now = told(name).partition(": ")[2]
        rows = [[entry.split(" ") for entry in text.split(", ")] for text in (before, now)]
        if not before.startswith("delay"):
            wrong += [now] * (now != before)
            continue
        assert [row[0] for row in rows[0]] == [row[0] for row in rows[1]], name
        for (one, *numbers), (_, *others) in zip(*rows, strict=True):
            (value, half), (new, wide) = map(float, numbers), map(float, others)
            tolerance = 0.02 * half + 1e-5 * abs(value)
            if not (np.isinf([half, wide]).all() or max(abs(new - value), abs(wide - half)) <= tolerance):
                wrong.append(f"{name}: {one} is {new} +- {wide}, was {value} +- {half}")
    assert not wrong


if __name__ == "__main__":
    print("\n".join(map(told, CASES)))
