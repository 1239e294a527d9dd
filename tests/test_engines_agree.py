"""Both engines side by side, over compositions of parts that fit."""

import random
from collections import Counter
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
import pytest

import pinmobile as pm
from pinmobile.controllers import AdaptiveVelocity, Decoupled, VelocityCommand
from pinmobile.forces import NoiseForce, PayloadForce, SinusoidalForce
from pinmobile.integrators import constant_acceleration, semi_implicit_euler
from pinmobile.loop import Engine, part_of, run_scenario
from tests.parts import PID, Cart, Eight, Follower, Nodding, SlidingMode, Smoothed, Spring, midpoint

N, DT, DURATION = 2, 0.01, 0.3  # 31 samples
ROBOT = pm.MobileRobot(30.0, 1.3, com=(0.1, 0.05))
WRONG = pm.MobileRobot(27.0, 1.1, com=(0.05, 0.0))


def _law(t: float, q: Any, v: Any, reference: Any) -> Any:
    return np.array([40.0, 50.0, 4.0]) * (reference.q - q) + 40.0 * np.tanh(reference.v - v)


COMMANDED = pm.VelocityRobot([0.26, 0.25, 0.03, 1.1, 0.2, 1.2], accelerations=(2.0, 4.0))
PLANTS: dict[str, Any] = {
    "offset": ROBOT,
    "loaded": ROBOT.attach(pm.PayloadBody(4.0, com=(0.1, -0.1, 0.2))),
    "cart": Cart(),
    "commanded": COMMANDED,
}
CONTROLLERS: dict[str, Any] = {
    "PD": pm.PD(40.0, 40.0),
    "PD, vector": pm.PD((60.0, 50.0, 4.0), (60.0, 50.0, 4.0)),
    "PD, matrix": pm.PD([[60.0, 5.0, 0.0], [3.0, 50.0, 1.0], [0.0, -1.0, 4.0]], 30.0),
    "computed torque": pm.ComputedTorque(ROBOT),
    "computed torque, wrong": pm.ComputedTorque(WRONG, kp=(3.0, 4.0, 5.0)),
    "PDGravity": pm.PDGravity(ROBOT, (60.0, 50.0, 4.0), (60.0, 50.0, 4.0)),
    "Decoupled": Decoupled(WRONG),
    "PID": PID(50.0, 10.0, 50.0),
    "sliding mode": SlidingMode(),
    "law": pm.law(_law),
    "follower": Follower(),
    "command": VelocityCommand(pm.UnicycleTracking(), COMMANDED),
    "backstepping": pm.Backstepping(pm.UnicycleTracking(), COMMANDED),
    "adaptive velocity": AdaptiveVelocity(COMMANDED, leakage=0.1),
}
WRAPPERS: dict[str, Any] = {
    "bare": lambda controller, limits: controller,
    "saturated": pm.InputSaturation,
    "delayed": lambda controller, limits: pm.MeasurementDelay(controller, 2),
    "noisy": lambda controller, limits: pm.MeasurementNoise(controller, 1e-3, 2e-3, seed=3),
    "smoothed": lambda controller, limits: Smoothed(controller, 0.8),
    "nested": lambda controller, limits: pm.InputSaturation(pm.MeasurementDelay(controller, 1), limits),
}
# Rolling: stiff as 1 N m / (0.1 rad/s) about rest, for which 2 * 1.3 * 0.1 / 0.3 s is the longest step.
STEADY: dict[str, Any] = {
    "free": (),
    "constant": (pm.ConstantForce((3.0, -2.0, 0.1)),),
    "viscous": (pm.ViscousFriction((5.0, 9.0, 0.4)),),
    "rolling": (pm.RollingResistance((2.0, 3.0, 0.3), 0.1),),
    "payload": (PayloadForce(6.0, (0.2, 0.1), 1.0, 0.1),),
    "spring": (Spring(),),
}
WAVING: dict[str, Any] = {
    "calm": (),
    "sine": (SinusoidalForce((2.0, 1.0, 0.1), 0.5, 0.3),),
    "noise": (NoiseForce((1.0, 2.0, 0.1), 2.0, seed=5),),
    "two sines": (SinusoidalForce((2.0, 1.0, 0.1), 0.5), SinusoidalForce((0.0, 1.0, 0.2), 1.5)),
}
INTEGRATORS: dict[str, Any] = {
    "acceleration": constant_acceleration,
    "semi-implicit": semi_implicit_euler,
    "rk4": pm.rk4,
    "midpoint": midpoint,
}
PATHS: dict[str, Any] = {
    "eight": Eight(),
    "circle": pm.Circle(1.5, 0.6, 4.0, (0.5, -1.0), heading=0.7),
    "line": pm.Line((0.5, 1.0), (3.0, -1.0), 4.0),
    "polyline": pm.Polyline([(0.0, 0.0), (1.2, 0.0), (1.6, 1.2)], 0.2, 4.0, 2.0),
    "moved": pm.Circle(1.0, 0.5, 4.0).moved(1.0, 2.0, 0.5),
    "one after another": pm.CompositePath(
        [
            pm.Polyline([(0.0, 0.0), (1.0, 0.0)], 0.2, 1.5, 6.0),  # from rest to rest
            pm.Polyline([(1.0, 0.0), (2.0, 0.0), (2.4, 0.8)], 0.2, 2.5, 4.0),
        ]
    ),
}
GAINS: Mapping[str, str] = {
    "PID": "kp",
    "sliding mode": "width",
    "follower": "along",
    "command": "zeta",
    "backstepping": "zeta",
    "adaptive velocity": "saturation",
}
FORCES: Mapping[str, str] = {
    "constant": "force.x",
    "viscous": "coefficients.forward",
    "rolling": "force.left",
    "payload": "mass",
    "spring": "stiffness",
}
OF_PATHS: Mapping[str, tuple[str, float]] = {
    "eight": ("trajectory.path.size", 2.0),
    "circle": ("trajectory.path.heading", 0.7),
    "line": ("trajectory.path.end.y", -1.0),
    "polyline": ("corner_radius", 0.2),
    "moved": ("angle", 0.5),
    "one after another": ("trajectory.path.paths.1.corner_radius", 0.2),
}
MODELS = ("computed torque", "computed torque, wrong", "Decoupled")
KINEMATIC = ("command", "backstepping", "adaptive velocity")
SPREADS = ("nothing", "mass", "gains", "model", "forces", "start", "reference")
FACTORS: dict[str, tuple[str, ...]] = {
    "controller": tuple(CONTROLLERS),
    "wrapper": tuple(WRAPPERS),
    "spread": SPREADS,
    "steady": tuple(STEADY),
    "waving": tuple(WAVING),
    "integrator": tuple(INTEGRATORS),
    "plant": tuple(PLANTS),
    "path": tuple(PATHS),
    "substeps": ("1", "3"),
}


def fits(choice: Mapping[str, str]) -> bool:
    """Tell whether parts, as far as they are chosen, can be together."""
    plant, controller = choice.get("plant"), choice.get("controller")
    spread, steady = choice.get("spread"), choice.get("steady")
    if plant and controller and (plant == "cart") != (controller == "follower"):
        return False
    if plant and controller and (plant == "commanded") != (controller in KINEMATIC):
        return False
    if plant == "commanded" or controller in KINEMATIC:
        if choice.get("waving", "calm") != "calm" or steady not in (None, "free"):
            return False  # no force pushes it
        if spread in ("model", "forces"):
            return False
    if spread == "model":
        return plant != "cart" and (controller is None or controller in MODELS)
    return not (spread == "gains" and controller == "law") and not (spread == "forces" and steady == "free")


@cache
def compositions() -> list[dict[str, str]]:
    """Return two choices for each controller; of the parts that fit, those that were taken least."""
    draws, used, found = random.Random(3), Counter[tuple[str, str]](), []
    for controller in (*CONTROLLERS, *CONTROLLERS):
        choice = {"controller": controller}
        for factor, names in FACTORS.items():
            if factor not in choice:
                allowed = [choice | {factor: name} for name in names if fits(choice | {factor: name})]
                choice = min(allowed, key=lambda one: (used[factor, one[factor]], draws.random()))
        used.update(choice.items())
        found.append(choice)
    return found


def spread_of(choice: Mapping[str, str]) -> dict[str, Any]:
    controller, steady = choice["controller"], choice["steady"]
    nominal = {"force.x": 3.0, "coefficients.forward": 5.0, "force.left": 3.0, "stiffness": 8.0}
    nominal["mass"] = 6.0
    gain = GAINS.get(controller, "kp")
    name, of_path = OF_PATHS[choice["path"]]
    found: dict[str, dict[str, Any]] = {
        "nothing": {},
        "mass": {"plant.mass": pm.Uniform(20.0, 35.0)}
        if choice["plant"] != "commanded"
        else {"plant.theta.theta_1": pm.Uniform(0.2, 0.3)},
        "gains": {f"controller.{gain}": pm.Relative(pm.Uniform(0.8, 1.2))},
        "model": {"controller.mass": pm.Uniform(25.0, 35.0), "controller.com.x": pm.Uniform(0.0, 0.1)},
        "start": {"start.x": pm.Uniform(-0.2, 0.2), "start.psi": pm.Uniform(-0.3, 0.3)},
        "reference": {name: pm.Uniform(*sorted((0.9 * of_path, 1.1 * of_path)))},
    }
    if steady in FORCES:
        found["forces"] = {f"forces.0.{FORCES[steady]}": pm.Uniform(0.5, nominal[FORCES[steady]])}
    return found[choice["spread"]]


def made(choice: Mapping[str, str], n: int = N) -> pm.Scenario:
    cart, commanded = (choice["plant"] == name for name in ("cart", "commanded"))
    limits = 0.2 if cart else (0.6, 0.9) if commanded else (15.0, 12.0, 1.5)
    return pm.Scenario(
        robot=PLANTS[choice["plant"]],
        controller=WRAPPERS[choice["wrapper"]](CONTROLLERS[choice["controller"]], limits),
        trajectory=(pm.Tangent if cart or commanded else Nodding)(PATHS[choice["path"]]),
        n=n,
        spread=spread_of(choice),
        dt=DT,
        seed=4,
        duration=DURATION,
        integrator=INTEGRATORS[choice["integrator"]],
        substeps=int(choice["substeps"]),
        forces=(*STEADY[choice["steady"]], *WAVING[choice["waving"]]),
    )


def test_every_part_is_in_a_composition() -> None:
    taken = {part for choice in compositions() for part in choice.items()}
    assert taken == {(factor, name) for factor, names in FACTORS.items() for name in names}
    assert all(map(fits, compositions()))


@cache
def compiled(k: int) -> tuple[pm.Scenario, pm.Ensemble]:
    """Return a composition and its ensemble by compiled code, one thread's."""
    scenario = made(compositions()[k])
    return scenario, run_scenario(scenario, engine=Engine.COMPILED, threads=1)


@pytest.mark.long
@pytest.mark.parametrize("k", range(len(compositions())))
def test_the_engines_agree(k: int) -> None:
    scenario, run = compiled(k)
    alone = run_scenario(scenario, engine=Engine.PYTHON)
    assert not alone.diverged.any()
    place, force = np.abs(scenario.reference.q).max(), alone.max_input.max()
    # Where nothing pushes, a force is what gains make of the rounding of places.
    sizes = {"max_error": place, "rms_error": place, "max_distance": place, "max_input": max(force, place)}
    for name, size in sizes.items():  # an error is a difference of coordinates, and rounded as these are
        here, there = getattr(run, name), getattr(alone, name)
        np.testing.assert_allclose(here, there, rtol=0, atol=1e-12 * size, err_msg=name)


@pytest.mark.parametrize("k", range(0, len(compositions()), 3))
def test_bits_hang_on_no_thread_chunk_or_number_of_robots(k: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pinmobile.compiled.program._THREAD_WORK", 1.0)  # every block is worth a thread
    scenario, run = compiled(k)
    many = run_scenario(made(compositions()[k], 20 * N), engine=Engine.COMPILED, threads=3)
    chunk = part_of(scenario, 1, N, Engine.COMPILED)[1]
    for name in ("max_error", "rms_error", "max_distance", "max_input"):
        np.testing.assert_array_equal(getattr(many, name)[:N], getattr(run, name), err_msg=name)
        np.testing.assert_array_equal(getattr(chunk, name), getattr(run, name)[1:], err_msg=name)
