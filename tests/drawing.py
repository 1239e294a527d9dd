"""Parts at random, as their fields are declared."""

import random
from typing import Any

import attrs
import numpy as np

import pinmobile as pm
from pinmobile.parts import Child, Number, Whole, fits, is_part_class, names_of, parameters, public_names
from pinmobile.wheels import WheelFriction

ODD = [5e-324, 1e22, 0.1, 1 / 3, -0.0, 2**53 + 0.0, 1e-7, 123456789.123456789]
PARTS = {name: one for name, one in public_names().items() if attrs.has(one) and is_part_class(one)}
# What numbers alone do not make: names, tables that fit each other, parts that only Python makes.
APART = {
    *("AckermannSteering", "Arm", "Adaptive", "AdaptiveVelocity", "ByVoltage", "Link", "Mount"),
    *("DifferentialGear", "GearTrain", "LQR", "MPC", "PayloadBody", "PayloadTransfer", "Wheel"),
    *("WheelTable", "WheeledRobot", "WholeBody"),
}


def drawn_number(declared: Number, rng: random.Random) -> Any:
    """Return numbers of a shape that is declared, within bounds, small ones and large ones."""
    shape = [3 if isinstance(n, str) else n for n in rng.choice(declared.shapes)]
    unit = np.array(
        [rng.choice(ODD) if rng.random() < 0.2 else rng.uniform(0.1, 9) for _ in range(int(np.prod(shape)))]
    )
    low = next((x for x in (declared.above, declared.lower) if x is not None), -5.0)
    high = declared.upper if declared.upper is not None else low + 10
    values = np.clip(np.where(np.isin(unit, ODD), unit, low + unit / 10 * (high - low)), low, high)
    values = np.where((values <= low) & (declared.above is not None), low + 0.5 * (high - low), values)
    if declared.endless and rng.random() < 0.3:
        return float("inf") if not shape else np.full(shape, np.inf)
    return values.reshape(shape) if shape else float(values[0])


def drawn(make: Any, rng: random.Random, depth: int = 0) -> Any:
    """Return a part at random, as its fields are declared."""
    values = {}
    for name, each in parameters(make).items():
        declared = each.declared
        if not each.is_required and rng.random() < 0.4:
            continue
        if isinstance(declared, Number):
            values[name] = drawn_number(declared, rng)
        elif isinstance(declared, Whole):
            values[name] = rng.randint(declared.least, min(declared.most, declared.least + 50))
        elif isinstance(declared, Child) and (each.is_required or depth < 1):
            values[name] = drawn_child(name, declared, rng, depth)
        elif each.is_required:
            values[name] = {"seed": 3, "std_q": 0.1}.get(name, rng.uniform(0.1, 1))
    return make(**values)


def robots() -> list[Any]:
    """Return robots of every kind, and wheels."""
    body = pm.MobileRobot(30.0, 1 / 3, com=(0.1, 0, 0.1))
    electric = pm.Motor(resistance=1.7, torque_constant=0.04, voltage=24.0)
    table = pm.WheelTable.differential(
        0.46, 0.1, supports=[(0.3, 0)], motor=electric, friction=WheelFriction(slip=1e-4)
    )
    swerve = pm.WheelTable.swerve([(0.2, 0.1), (-0.2, -0.1)], 0.05, yaw_inertia=0.001)
    wheeled, omni = pm.WheeledRobot(body, table), pm.WheeledRobot(body, pm.WheelTable.omni(0.2, 0.1))
    velocity = pm.VelocityRobot((0.26, 0.25, 0, 1, 0, 1))
    return [body, wheeled, wheeled.by_voltage(), pm.WheeledRobot(body, swerve), omni, velocity, table]


ROBOTS = robots()


def drawn_child(name: str, declared: Child, rng: random.Random, depth: int) -> Any:
    models = [one for one in ROBOTS if name in ("robot", "table") and fits(declared.kind, one)]
    if models:
        return rng.choice(models)
    names = [each for each in names_of(declared.kind) if each in PARTS and each not in APART]
    for _ in range(200 if names else 0):
        part = PARTS[rng.choice(names)]
        if depth < 2 or not any(isinstance(each.declared, Child) for each in parameters(part).values()):
            try:
                one = drawn(part, rng, depth + 1)
                return [one, one] if declared.many else one
            except (pm.InvalidArgument, ArithmeticError, AttributeError, RuntimeWarning):
                continue
    raise pm.InvalidArgument(f"{name} is not drawn")
