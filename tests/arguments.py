"""Every public callable with a valid call, and the wrong values that replace its arguments one by one.

As a program it runs them all in this process, under a limit of memory, and prints what came out wrong: see
test_arguments.py.
"""

import importlib
import inspect
import json
import resource
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields, is_dataclass, replace
from datetime import UTC, datetime
from decimal import Decimal
from fractions import Fraction
from functools import partial
from pathlib import Path
from random import Random
from typing import Any
from zlib import crc32

import matplotlib
import numpy as np
import pinocchio as pin

import pinmobile as pm
from pinmobile import PinmobileError, derivation, loop, urdf, viewer, wheels
from pinmobile.robot import Stance
from pinmobile.wheels import Motor, WheeledRobot, WheelTable
from tests import wheeled

MODULES = (
    *(
        "accuracy",
        "balance",
        "closed_form",
        "controllers",
        "derivation",
        "dh",
        "forces",
    ),
    *(
        "identification",
        "integrators",
        "paths",
        "plots",
        "reaching",
        "robot",
        "loop",
        "sweeps",
        "trajectories",
        "urdf",
    ),
    *("verification", "viewer", "wheels"),
)
SEED = 20240
THETA: list[float] = [0.26, 0.25, 0.03, 1.1, 0.2, 1.2]  # of a robot that takes speeds
SECONDS = 5  # of processor time for one call
MEMORY = 6 << 30  # of address space; libraries that only reserve it have some 3 GB

# What packages hand each other, checked: not for users.
INNER = {
    "controllers.gain_matrix",
    *("balance.body_zero_moment_point", "paths.within"),
    *("controllers.check_controller", "derivation.difference"),
    *("derivation.lagrange", "forces.noise_frequencies", "paths.pieces_of"),
    *("loop.Loop", "loop.part_of", "loop.step"),
    *("Scenario.find", "loop.run_scenario", "paths.Whole", "reaching.pose_error", "robot.System"),
    "Sweep.of_store",
    *(
        "trajectories.check_limits",
        "integrators.RungeKuttaNystrom",
        "Ensemble.of",
        "Scenario.holding",
    ),
    *(
        "integrators.check_integrator",
        "robot.Arm",
        "viewer.LiveWindow",
        "viewer.OfflineWindow",
    ),
    *("Rollout.of", "Rollout.arrays", "loop.Outline.of", "loop.Outline.from_description"),
    *("loop.Outline.description", "loop.Outline.difference", "loop.Part.of"),
    *("controllers.Changing", "controllers.Tracked"),
    *(f"{ground}.{name}" for ground in ("Rolling", "Coulomb") for name in ("dynamics", "check_robot")),
    "WheeledRobot.check_stands",
    *("wheels.Reduced.nearest", "wheels.Reduced.torques"),
    *("MobileRobot.check", "Load.check", "Load.impossible", "robot.Link", "robot.Mount.after"),
    "robot.UncheckedDynamics.forward_dynamics",
    *("PosePath.told", "Resolved.signals_at", "EndEffectorTracking.signals_at"),
    *(
        "VelocityRobot.integrator",
        "WheeledRobot.integrator",
    ),
    *(
        "Scenario.references",
        "NoiseForce.draw",
        "Scenario.starts",
        "Scenario.values",
    ),
    *(f"WheeledRobot.{name}" for name in ("follows", "measured", "slip_margins")),
    *(f"wheels.ByVoltage.{name}" for name in ("initial_state", "signals", "step")),
}
# What the library makes and users read: nobody calls the class.
RESULTS = {
    *("robot.UncheckedDynamics", "loop.Signal", "closed_form.ReducedModel"),
    *("Identification", "identification.Prediction"),
    *(
        "Clearance",
        "Context",
        "Diverged",
        "EndEffector",
        "Ensemble",
        "FileError",
        "InvalidArgument",
        "NotFinite",
        "NotSolved",
        "NotTraceable",
        "PinmobileError",
        "Reference",
        "Resolved",
        "Rollout",
    ),
    *("SchedulerError", "Sweep", "UnknownName", "Unreachable", "ViewerError", "JointType"),
    *("accuracy.Convergence", "accuracy.IntegratorReport", "derivation.Derivation", "derivation.Numeric"),
    "derivation.ReducedDerivation",
    *("derivation.Step", "loop.Bands", "Engine", "loop.Member", "loop.Part"),
    *("loop.Record", "loop.Sample"),
    "loop.Outline",
    *("loop.Within", "reaching.PoseTarget", "robot.Linearization", "robot.Mount"),
    *("robot.Mountable", "robot.Mountables", "verification.Comparison", "viewer.Recording"),
    *("closed_form.ReducedModel", "wheels.Allocation", "wheels.Forces", "wheels.Reduced"),
    "verification.Verification",
    "identification.VelocityIdentification",
}


class Sour:
    """What raises at whatever it is asked for."""

    def __getattr__(self, name: str) -> Any:
        raise RuntimeError(f"{name} is not to be had")


class Mute:
    """What has no representation."""

    def __repr__(self) -> str:
        raise RuntimeError("no words")


class Lying:
    """What says that it is an array, and gives something else."""

    def __array__(self, dtype: Any = None, copy: Any = None) -> Any:
        raise RuntimeError("no array after all")


class Anything:
    """What has every attribute and can be called, and answers with itself."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return self

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        return self


class Tagged(np.ndarray[Any, Any]):
    """An array of a class of its own."""


def nested(depth: int) -> list[Any]:
    """Return a list in a list, so many times."""
    deep: list[Any] = [1.0]
    for _ in range(depth):
        deep = [deep]
    return deep


def itself() -> list[Any]:
    """Return a list that is its own entry."""
    ring: list[Any] = [1.0]
    ring.append(ring)
    return ring


# What is put in the place of an argument: made anew for each call, since some of them are used up.
KINDS: dict[str, Callable[[], Any]] = {
    "None": lambda: None,
    "NaN": lambda: float("nan"),
    "infinity": lambda: float("inf"),
    "minus infinity": lambda: -float("inf"),
    "zero": lambda: 0,
    "minus one": lambda: -1,
    "minus zero": lambda: -0.0,
    "half": lambda: 0.5,
    "1e308": lambda: 1e308,
    "-1e308": lambda: -1e308,
    "1e200": lambda: 1e200,
    "1e-308": lambda: 1e-308,
    "5e-324": lambda: 5e-324,
    "10**22": lambda: 10**22,
    "10**400": lambda: 10**400,
    "10**5000": lambda: 10**5000,
    "-2**63": lambda: -(2**63),
    "True": lambda: True,
    "complex": lambda: 1 + 2j,
    "text": lambda: "seven",
    "a number as text": lambda: "7",
    "empty text": lambda: "",
    "text with a null": lambda: "a\0b",
    "a surrogate": lambda: "\ud800",
    "long text": lambda: "x" * 100_000,
    "bytes": lambda: b"abc",
    "empty list": list,
    "empty tuple": tuple,
    "empty dict": dict,
    "empty array": lambda: np.empty((0, 3)),
    "one number in a list": lambda: [1.0],
    "seven numbers": lambda: np.arange(7.0),
    "a matrix": lambda: np.eye(5, 2),
    "four axes": lambda: np.ones((2, 2, 2, 3)),
    "many axes": lambda: np.ones((1,) * 60),
    "ragged": lambda: [[1.0, 2.0], [3.0]],
    "NaN among numbers": lambda: [0.0, float("nan"), 0.0],
    "1e308 thrice": lambda: [1e308, -1e308, 1e308],
    "None among numbers": lambda: [0.0, None, 0.0],
    "text among numbers": lambda: [0.0, "a", 0.0],
    "masked": lambda: np.ma.masked_array([1.0, 2.0, 3.0], [False, True, False]),
    "masked, nothing hidden": lambda: np.ma.masked_array([1.0, 2.0, 3.0]),
    "masked in a list": lambda: [1.0, np.ma.masked, 3.0],
    "complex array": lambda: np.ones(3, complex),
    "object array": lambda: np.array([1, None, {}], object),
    "numbers as objects": lambda: np.array([1.0, 2.0, 3.0], object),
    "text array": lambda: np.array(["a", "b", "c"]),
    "dates": lambda: np.array(["2026-01-01"] * 3, "datetime64[D]"),
    "durations": lambda: np.array([1, 2, 3], "timedelta64[s]"),
    "records": lambda: np.zeros(3, [("a", float)]),
    "booleans": lambda: np.array([True, False, True]),
    "half precision": lambda: np.ones(3, np.float16),
    "a subclass": lambda: np.arange(3.0).view(Tagged),
    "np.matrix": lambda: np.arange(3.0)[None].view(np.matrix),
    "a scalar array": lambda: np.array(2.0),
    "a set": lambda: {1.0, 2.0, 3.0},
    "a range": lambda: range(3),
    "a generator": lambda: (float(k) for k in range(3)),
    "a dict": lambda: {"a": 1.0},
    "a dict with other keys": lambda: {1: 2.0, None: 3.0},
    "a list of itself": itself,
    "nested 5,000 deep": lambda: nested(5_000),
    "a date": lambda: datetime(2026, 1, 1, tzinfo=UTC),
    "Decimal": lambda: Decimal("2.5"),
    "Decimal NaN": lambda: Decimal("NaN"),
    "Fraction": lambda: Fraction(5, 2),
    "a class": lambda: dict,
    "a class of the library": lambda: pm.PD,
    "a lambda of none": lambda: lambda: None,
    "a lambda of anything": lambda: lambda *arguments, **named: None,
    "a function that raises": lambda: raising,
    "a module": lambda: np,
    "an object": object,
    "sour": Sour,
    "mute": Mute,
    "lying": Lying,
    "anything": Anything,
    "another robot": lambda: WORLD.armed,
    "a robot": lambda: WORLD.robot,
    "a path": lambda: pm.Circle(1, 0.5, 1),
    "a trajectory": lambda: pm.Tangent(pm.Circle(1, 0.5, 1)),
    "a controller": lambda: pm.PD(1, 1),
    "a DH table": lambda: pm.LECTURE_TABLE,
    "a model": pin.Model,
    "a folder": lambda: WORLD.folder,
    "a file that is not there": lambda: WORLD.folder / "nothing" / "at all",
}


def raising(*arguments: Any, **named: Any) -> Any:
    """Raise what no library raises on purpose."""
    raise ZeroDivisionError("from the function itself")


def small_arm() -> pin.Model:
    """Return an arm of two joints with limits."""
    model = pin.Model()
    model.name = "small"
    parent = 0
    for k in range(2):
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.3 * k]))
        joint = model.addJoint(
            parent,
            pin.JointModelRY(),
            place,
            f"j{k}",
            np.full(1, 50.0),
            np.full(1, 5.0),
            np.full(1, -2.0),
            np.full(1, 2.0),
        )
        model.appendBodyToJoint(
            joint, pin.Inertia(1.0, np.array([0.0, 0.0, 0.15]), 0.01 * np.eye(3)), pin.SE3.Identity()
        )
        frame = model.addJointFrame(joint)
        model.addFrame(pin.Frame(f"l{k}", joint, frame, pin.SE3.Identity(), pin.FrameType.BODY))
        parent = joint
    return model


class World:
    """What the calls are made with; each made once, when it is first asked for."""

    def __init__(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="arguments"))

    def __getattr__(self, name: str) -> Any:
        if name not in MADE:
            raise AttributeError(name)
        made = self.__dict__[name] = MADE[name]()
        return made


def _ensemble(**more: Any) -> Any:
    return pm.ensemble(**(ENSEMBLE() | more))


def _viewer() -> Any:
    shown = viewer.Viewer(WORLD.robot)
    shown.display([0, 0, 0])
    return shown


def _turtlebot() -> Any:
    file = WORLD.folder / "turtlebot.urdf"
    file.write_text(wheeled.turtlebot("burger"))
    return file


def _rolls() -> Any:
    law = pm.ByOdometry(pm.Backstepping(pm.Tracking(), WORLD.wheeled), WORLD.wheeled.table)
    return pm.simulate(WORLD.wheeled, law, WORLD.trajectory, dt=0.02, duration=0.1, integrator=pm.rk4)


def _logged() -> Any:
    path = pm.excitation(WORLD.robot, duration=22.0, period=11.0)
    law = pm.ComputedTorque(WORLD.robot, 16, 8)
    run = pm.simulate(WORLD.robot, law, path, dt=0.05, integrator=pm.rk4)
    return pm.Log.from_rollout(run, 1e-3)


def _logged_csv() -> Any:
    file = WORLD.folder / "log.csv"
    WORLD.rollout.to_csv(file)
    return file


def _sweep() -> Any:
    return pm.sweep(_scenario(), WORLD.folder / "sweep.zarr", grid={"controller.kp": [1.0, 2.0]})


def _scenario() -> Any:
    named = {name: value for name, value in ENSEMBLE().items() if name not in ("engine", "traces")}
    named["controller"] = pm.PD(1.0, 1)
    return pm.Scenario(**named)


def _commands() -> Any:
    still = pm.FixedHeading(pm.Hold((0, 0), 21.0), 0.0)
    run = pm.simulate(WORLD.commanded, pm.RandomSteps(), still, dt=0.1, engine=pm.COMPILED)
    q = run.q + 1e-3 * np.random.default_rng(1).normal(size=run.q.shape)
    return pm.Log(run.t, q, run.u)


MADE: dict[str, Callable[[], Any]] = {
    "commanded": lambda: pm.VelocityRobot(THETA),
    "commands": _commands,
    "theta": lambda: pm.identify_velocity(WORLD.commands, seconds=1.0),
    "log": _logged,
    "log_csv": _logged_csv,
    "identified": lambda: pm.identify(WORLD.log, method="weak"),
    "foretold": lambda: WORLD.identified.predict(WORLD.log),
    "robot": lambda: pm.MobileRobot(10.0, 1.2, com=(0.15, 0.05)),
    "base": lambda: pm.MobileRobot(30.0, 1.3, com=(0.0, 0.0, 0.1), size=(0.6, 0.4, 0.25)),
    "differential": lambda: WheelTable.differential(
        0.46, 0.1, supports=[(0.25, 0), (-0.25, 0)], mass=1.0, spin_inertia=0.005, yaw_inertia=0.003
    ),
    "wheeled": lambda: WheeledRobot(WORLD.base, WORLD.differential),
    "mecanum": lambda: WheeledRobot(WORLD.base, WheelTable.mecanum(0.4, 0.48, 0.09)),
    "turtlebot": _turtlebot,
    "rolls": _rolls,
    "swerve": lambda: WheeledRobot(
        WORLD.robot, WheelTable.swerve([(0.3, 0.1), (-0.3, -0.1)], 0.1, yaw_inertia=0.01)
    ),
    "standing": lambda: WheeledRobot(
        WORLD.robot, WheelTable.differential(0.5, 0.1, supports=[(0.6, 0.0), (-0.6, 0.0)])
    ),
    "wheeled_motion": lambda: pm.Motion(WORLD.standing, np.zeros(5), np.zeros(5), np.zeros(5), np.zeros(2)),
    "electric": lambda: WheeledRobot(
        WORLD.robot,
        WheelTable.differential(
            0.5, 0.1, motor=Motor(resistance=1.0, torque_constant=0.03, voltage=24.0, gear=20.0)
        ),
    ),
    "arm": small_arm,
    "armed": lambda: WORLD.robot.mount(WORLD.arm, (0, 0, 0.2, 0), name="arm"),
    "q": lambda: np.array([0.1, 0.2, 0.3]),
    "path": lambda: pm.Circle(1, 0.5, 1),
    "trajectory": lambda: pm.Tangent(WORLD.path),
    "whole": lambda: pm.WholeBody(WORLD.armed, WORLD.trajectory, pm.Hold([0.3, 0.4], 1)),
    "rollout": lambda: pm.simulate(WORLD.robot, pm.PD(40, 20), WORLD.trajectory, dt=0.1),
    "told": lambda: replace(WORLD.rollout, signals={"margin": ("m", np.zeros(len(WORLD.rollout)))}),
    "arm_rollout": lambda: pm.simulate(WORLD.armed, pm.ComputedTorque(WORLD.armed), WORLD.whole, dt=0.1),
    "motion": lambda: pm.Motion(WORLD.robot, np.zeros(3), np.zeros(3), np.zeros(3)),
    "arm_motion": lambda: pm.Motion(WORLD.armed, np.zeros(5), np.zeros(5), np.zeros(5)),
    "target": lambda: pm.PosePath(pm.RestToRest([0.1, 0.0, 0.55], [0.2, 0.05, 0.55], 1)),
    "resolved": lambda: pm.resolve(WORLD.armed, WORLD.target, dt=0.1, tolerance=1.0),
    "ensemble": _ensemble,
    "scenario": _scenario,
    "sweep": _sweep,
    "report": lambda: pm.integrator_report(pm.rk4, steps=(0.1, 0.05), duration=0.2),
    "derivation": derivation.lecture,
    "reduced": derivation.differential_drive,
    "numeric": lambda: WORLD.derivation.numeric(),
    "viewer": _viewer,
    "recording": lambda: WORLD.viewer.record(WORLD.rollout, fps=5),
    "body": lambda: urdf.Body(10.0, np.zeros(3), np.eye(3)),
    "urdf": lambda: pm.shipped_urdf("box"),
    "ensemble_scenario": lambda: WORLD.ensemble.scenario,
    "saved_ensemble": lambda: (
        WORLD.ensemble.save(WORLD.folder / "ensemble.npz"),
        WORLD.folder / "ensemble.npz",
    )[1],
    "saved": lambda: (WORLD.rollout.save(WORLD.folder / "saved.npz"), WORLD.folder / "saved.npz")[1],
}
WORLD: Any = World()


def ENSEMBLE() -> dict[str, Any]:
    """Return a small ensemble."""
    return {
        "robot": WORLD.robot,
        "controller": pm.PD(40, 20),
        "trajectory": WORLD.trajectory,
        "n": 3,
        "spread": {"mass": pm.Uniform(9, 11)},
        "dt": 0.1,
        "seed": 1,
        "duration": 1.0,
        "integrator": pm.constant_acceleration,
        "substeps": 1,
        "forces": [pm.ConstantForce([0.1, 0, 0])],
        "limit": 1e3,
        "after": 0.0,
        "every": 2,
        "measures": [],
        "traces": [0],
        "engine": loop.COMPILED,
    }


@dataclass(frozen=True)
class Row:
    """A valid call: the arguments by name, and how many wrong values are tried in all, 0 for every one."""

    arguments: Callable[[], dict[str, Any]]
    tries: int = 0
    fixed: dict[str, Any] = field(default_factory=dict)


def row(tries: int = 0, /, **arguments: Any) -> Row:
    """Return a row; an argument that is a function without parameters named `later` is called when needed."""
    return Row(lambda: {name: _value(value) for name, value in arguments.items()}, tries)


class Later:
    """What is made when it is needed: an attribute of the world."""

    def __init__(self, name: str) -> None:
        self.name = name


def _value(value: Any) -> Any:
    if isinstance(value, Later):
        return getattr(WORLD, value.name)
    return value() if isinstance(value, partial) else value


def the(name: str) -> Later:
    """Return what stands for a part of the world in a row."""
    return Later(name)


Q, V, A = [0.1, 0.2, 0.3], [0.4, 0.5, 0.6], [0.7, 0.8, 0.9]
BODY = {"mass": 10.0, "yaw_inertia": 1.0, "com": (0.1, 0.05)}
PARAMS = {"m": 10.0, "xbc": 0.1, "ybc": 0.05, "Icz": 1.0}
MASSLESS = {"nonlinear_effects", "coriolis_matrix"}  # of which the yaw inertia is no argument
FOUR = [[0.3, 0.3, -0.3, -0.3], [0.2, -0.2, 0.2, -0.2], [0.0] * 4]
FIVE = [0.1, 0.2, 0.3, 0.4, 0.5]  # of a differential drive: body and wheels
MOTOR: dict[str, Any] = {
    **{"torque_limit": 5.0, "resistance": 1.0, "torque_constant": 0.05, "voltage": 12.0, "gear": 20.0},
    **{"efficiency": 0.9, "rotor_inertia": 1e-5, "viscous": 1e-5, "coulomb": 1e-3, "current": 10.0},
}
STATES: dict[str, dict[str, Any]] = {
    "mass_matrix": {"q": Q},
    "nonlinear_effects": {"q": Q, "v": V},
    "inverse_dynamics": {"q": Q, "v": V, "a": A},
    "forward_dynamics": {"q": Q, "v": V, "tau": A},
    "coriolis_matrix": {"q": Q, "v": V},
}

ROWS: dict[str, Row] = {
    "PD": row(kp=1, kd=[1, 2, 3], difference=pm.planar_difference),
    "ComputedTorque": row(robot=the("robot"), kp=4, kd=4, difference=pm.plain_difference),
    "Decoupled": row(robot=the("robot"), kp=4, kd=4, difference=pm.planar_difference),
    "PDGravity": row(robot=the("robot"), kp=4, kd=4, difference=pm.planar_difference),
    "PID": row(robot=the("robot"), kp=48, ki=64, kd=12, difference=pm.planar_difference),
    "SlidingMode": row(
        robot=the("robot"), slope=4, damping=4, reach=3, layer=0.1, difference=pm.planar_difference
    ),
    "SuperTwisting": row(robot=the("robot"), slope=4, k1=3, k2=3, difference=pm.planar_difference),
    "Adaptive": row(
        robot=the("robot"),
        slope=4,
        kd=[120, 120, 6],
        gamma=[20, 2, 2, 0.6],
        friction=False,
        speed=0.01,
        dead_zone=0.02,
        leakage=0.01,
        lower=[1, -9, -9, 0],
        upper=[90, 9, 9, 9],
        difference=pm.planar_difference,
    ),
    "LQR": row(robot=the("robot"), Q=[400, 400, 100, 20, 20, 5], R=[1e-3, 1e-3, 2e-2]),
    "MPC": row(
        robot=the("robot"),
        horizon=4,
        step=0.05,
        limits=[60, 60, 9],
        lower=np.full(6, -np.inf),
        upper=np.full(6, 5.0),
        Q=[400, 400, 100, 20, 20, 5],
        R=[1e-3, 1e-3, 2e-2],
        observer=10,
    ),
    "ADRC": row(robot=the("robot"), bandwidth=4, observer=20, inertia=[30, 30, 1.5]),
    "DisturbanceObserver": row(controller=pm.PD(1, 1), robot=the("robot"), gain=10),
    "Saturated": row(controller=pm.PD(1, 1), limits=[1, 2, 3]),
    "Allocated": row(controller=pm.PD(1, 1), robot=the("wheeled")),
    "Backstepping": row(law=pm.Tracking(), robot=the("wheeled"), k=10, steer=10, arms=2),
    "Driven": row(controller=pm.PD(1, 1), robot=the("electric")),
    "WheelSpeed": row(law=pm.Tracking(), robot=the("wheeled"), kp=1, ki=2),
    "VelocityCommand": row(law=pm.Tracking(), robot=the("commanded")),
    "AdaptiveVelocity": row(
        robot=the("commanded"),
        ahead=0.2,
        kp=0.8,
        saturation=0.2,
        k=[3, 4],
        gamma=[0.2, 0.2, 0.02, 1, 0.02, 1],
        leakage=0.01,
        lower=[0.01, 0.01, -9, 0.01, -9, 0.01],
        upper=np.full(6, 9.0),
    ),
    "RandomSteps": row(lowest=[-0.2, -1], largest=[0.8, 1], hold=[0.4, 2.5], seed=1),
    "VelocityRobot": row(
        theta=THETA, ahead=0.1, limits=[0.8, 1], accelerations=1.0, size=[0.4, 0.3, 0.2], source="a test"
    ),
    "VelocityRobot.check_start": row(q=[0, 0, 0], v=[0.5, 0, 0.1]),
    "VelocityRobot.commands": row(q=Q, v=V, rates=[1, 2]),
    "VelocityRobot.difference": row(q0=Q, q1=Q),
    "VelocityRobot.drawing": row(q=Q),
    "VelocityRobot.forward_dynamics": row(q=Q, v=V, u=[1, 2], f=0.0),
    "VelocityRobot.from_motors": row(wheeled=the("electric"), kp=0.5, kd=0.1),
    "VelocityRobot.independent": row(q=Q, v=V),
    "VelocityRobot.integrate": row(q=Q, dq=V),
    "VelocityRobot.pose": row(q=Q),
    "VelocityRobot.project": row(q=Q, v=V),
    "VelocityRobot.rate": row(q=Q, v=V),
    "VelocityRobot.rates": row(nu=[1, 2], u=[1, 2]),
    "VelocityRobot.reduced": row(q=Q, v=V),
    "VelocityRobot.regressor": row(q=Q, v=V, rates=[1, 2]),
    "VelocityRobot.rolling": row(q=Q, nu=[1, 2]),
    "VelocityRobot.start": row(reference=partial(lambda: WORLD.trajectory(0.0))),
    "identify_velocity": row(
        12, log=the("commands"), delay=0.0, ahead=0.0, accelerations=[9.0, 9.0], seconds=1.0
    ),
    "identification.VelocityIdentification.interval": row(level=0.9),
    "identification.VelocityIdentification.predict": row(12, log=the("commands")),
    "identification.VelocityIdentification.robot": row(),
    "identification.VelocityIdentification.spread": row(n=3, seed=1),
    "SwerveTracking": row(robot=the("swerve"), kp=2, k=10, steer=10, least=0.05),
    "Tracking": row(zeta=0.7, b=20),
    "Kanayama": row(k1=2, k2=10, k3=5),
    "Parking": row(k1=1, k2=3, k3=2, near=1e-3),
    "DynamicFeedback": row(kp=2, kd=2.8, least=0.05),
    "Delayed": row(controller=pm.PD(1, 1), samples=2),
    "NoisyMeasurement": row(controller=pm.PD(1, 1), std_q=0.1, std_v=[0.1, 0.1, 0.2], seed=1),
    "law": row(function=lambda t, q, v, reference: np.zeros(3)),
    "Context.of": row(plant=the("robot"), dt=0.1, t=[0.0, 0.1]),
    "Context.line": row(samples=2),
    "Context.normal": row(name="wheel slip", n=2),
    "Context.schedule": row(rows=[[1.0, 2.0]]),
    "plain_difference": row(q0=Q, q1=V),
    "planar_difference": row(q0=Q, q1=V),
    "EndEffectorTracking": row(
        robot=the("armed"),
        target=the("target"),
        frame="arm/l1",
        kp=100,
        kd=20,
        posture_kp=25,
        posture_kd=10,
        damping=0.01,
        velocity_limit=[1] * 5,
        acceleration_limit=[9] * 5,
        dt=0.01,
        integrator=pm.rk4,
    ),
    "Circle": row(radius=1, rate=0.5, duration=1, centre=[1, 2], phase=0.5, heading=None),
    "Lissajous": row(rx=1, ry=2, wx=0.5, wy=1, duration=1),
    "Circle.__call__": row(t=[0.1, 0.2]),
    "Circle.derivative": row(t=[0.1, 0.2], order=1),
    "Lissajous.__call__": row(t=[0.1, 0.2]),
    "Lissajous.derivative": row(t=[0.1, 0.2], order=1),
    "CompositePath": row(paths=[pm.Line([0, 0], [1, 0], 1), pm.Line([1, 0], [2, 0], 1)]),
    "Line": row(start=[0, 0], end=[1, 1], duration=1),
    "Moved": row(path=the("path"), x=1, y=2, angle=0.5),
    "Polyline": row(waypoints=[[0, 0], [1, 0], [1, 1]], corner_radius=0.2, duration=5, acceleration=2),
    "CompositePath.__call__": row(t=0.5),
    "CompositePath.derivative": row(t=0.5, order=1),
    "Line.__call__": row(t=0.5),
    "Line.derivative": row(t=0.5, order=1),
    "Moved.__call__": row(t=0.5),
    "Moved.derivative": row(t=0.5, order=1),
    "Polyline.__call__": row(t=0.5),
    "Polyline.derivative": row(t=0.5, order=1),
    "Circle.moved": row(x=1, y=2, angle=0.5),
    "CompositePath.moved": row(x=1, y=2, angle=0.5),
    "CubicVia.moved": row(x=1, y=2, angle=0.5),
    "Hold.moved": row(x=1, y=2, angle=0.5),
    "Line.moved": row(x=1, y=2, angle=0.5),
    "Lissajous.moved": row(x=1, y=2, angle=0.5),
    "Moved.moved": row(x=1, y=2, angle=0.5),
    "Polyline.moved": row(x=1, y=2, angle=0.5),
    "RestToRest.moved": row(x=1, y=2, angle=0.5),
    "Spline.moved": row(x=1, y=2, angle=0.5),
    "CubicVia": row(
        start=[0, 0],
        via=[1, 1],
        end=[2, 0],
        t_via=1,
        t_end=2,
        via_velocity=[0, 0],
        start_velocity=[0, 1],
        end_velocity=[1, 0],
    ),
    "CubicVia.__call__": row(t=0.5),
    "CubicVia.derivative": row(t=0.5, order=2),
    "Hold": row(point=[1, 2], duration=1),
    "Hold.__call__": row(t=0.5),
    "Hold.derivative": row(t=0.5, order=2),
    "RestToRest": row(start=[0, 0], end=[1, 1], duration=1),
    "RestToRest.__call__": row(t=0.5),
    "RestToRest.derivative": row(t=0.5, order=1),
    "Spline": row(
        waypoints=[[0, 0], [1, 1], [2, 0]], times=[0, 1, 2], start_velocity=[0, 1], end_velocity=[1, 0]
    ),
    "Spline.__call__": row(t=0.5),
    "Spline.derivative": row(t=0.5, order=1),
    "Tangent": row(path=the("path"), turn_time=0.5),
    "Tangent.__call__": row(t=[0.1, 0.5]),
    "FixedHeading": row(path=the("path"), psi=0.5),
    "FixedHeading.__call__": row(t=[0.1, 0.5]),
    "LectureHeading": row(path=the("path")),
    "LectureHeading.__call__": row(t=[0.1, 0.5]),
    "WholeBody": row(robot=the("armed"), base=the("trajectory"), joints=pm.Hold([0.3, 0.4], 1)),
    "WholeBody.__call__": row(t=[0.1, 0.5]),
    "PosePath": row(
        path=pm.Hold([0, 0, 1], 1), rotation=np.eye(3), final_rotation=np.eye(3), turn=None, times=None
    ),
    "PosePath.through": row(poses=[np.eye(4), np.eye(4)], times=[0.0, 1.0]),
    "clearance": row(robot=the("robot"), q=Q),
    "PosePath.__call__": row(t=[0.1, 0.5]),
    "MPC.within": row(limits=50.0, lower=[-1, -1], upper=[1, 2, 3]),
    "ConstantForce": row(force=[1, 2, 3], begin=0.5, end=1.5),
    "Payload": row(mass=2.0, at=[0.1, 0.2], when=1.0, yaw_inertia=0.1),
    "SinusoidalForce": row(amplitude=[1, 2, 3], frequency=0.5, phase=0.1),
    "NoiseForce": row(std=[1, 2, 3], bandwidth=2, seed=1),
    "NoiseForce.of_phases": row(std=[1, 2, 3], bandwidth=2, phases=np.zeros((16, 3))),
    "JointFriction": row(viscous=[1, 2, 3], coulomb=[0.1, 0.2, 0.3], speed=0.1),
    "JointFriction.of": row(robot=the("robot"), speed=0.1),
    "RollingResistance": row(force=[1, 2, 3], speed=0.01),
    "ViscousFriction": row(coefficients=None, forward=1, left=2, yaw=3),
    "Load": row(mass=1, com=(0, 0, 0.1), inertia=np.eye(3), size=(0.1, 0.1, 0.1)),
    "Motion": row(plant=the("robot"), q=Q, v=V, a=A, u=[1, 2, 3]),
    "Limit": row(value=1.5, what="left slips", time=0.5, factor=2),
    "contact_loads": row(motion=the("wheeled_motion")),
    "slip_margins": row(motion=the("wheeled_motion")),
    "fastest": row(plant=the("standing"), trajectory=the("trajectory"), samples=20),
    "steepest": row(plant=the("standing"), direction=0.5),
    "reaction_wrench": row(motion=the("arm_motion"), mount="arm"),
    "required_friction": row(motion=the("motion")),
    "balance.footprint_of": row(robot=the("robot"), footprint=[[-1, -1], [1, -1], [1, 1], [-1, 1]]),
    "tip_over_margin": row(motion=the("motion"), footprint=[[-1, -1], [1, -1], [1, 1], [-1, 1]]),
    "zero_moment_point": row(motion=the("motion")),
    "Uniform": row(low=1, high=2),
    "Uniform.support": row(),
    "Uniform.cdf": row(value=1.5),
    "Uniform.sample": row(generator=partial(np.random.default_rng, 1), size=3),
    "Normal": row(mean=1, std=2),
    "Normal.sample": row(generator=partial(np.random.default_rng, 1), size=3),
    "Relative": row(factor=pm.Normal(1, 0.1)),
    "loop.Samples": row(),
    "loop.Worst": row(limit=1.0, begin=1.0, distances=((0, 1), (2,)), measures=()),
    "Same": row(name="mass", factor=pm.Normal(1, 0.1)),
    "Scenario": Row(lambda: {k: v for k, v in ENSEMBLE().items() if k not in ("engine", "traces")}),
    "Scenario.draws": row(start=0, stop=2),
    "ensemble": Row(lambda: ENSEMBLE() | {"threads": 1, "progress": lambda done, n: None}, 300),
    "Ensemble.load": row(path=the("saved_ensemble"), scenario=the("ensemble_scenario")),
    "Ensemble.save": row(path=partial(lambda: WORLD.folder / "again.npz")),
    "Ensemble.to_csv": row(path=partial(lambda: WORLD.folder / "again.csv")),
    "Ensemble.to_xarray": row(),
    "Ensemble.bands": row(levels=[0.5, 0.9]),
    "Ensemble.largest": row(by="distance"),
    "Ensemble.member": row(i=0),
    "Ensemble.trace": row(i=0),
    "Ensemble.within": row(share=0.9),
    "Ensemble.worst": row(count=2, by="distance"),
    "sweep": row(
        60,
        scenario=the("scenario"),
        path=partial(lambda: WORLD.folder / "other.zarr"),
        grid={"controller.kp": [1.0, 2.0]},
        cases={"soft": {"controller.kd": 0.5}, "nominal": {}},
        client=None,
        chunk=2,
        progress=lambda done, n: None,
        version="1",
    ),
    "Sweep.answer": row(share=0.9),
    "Sweep.ensemble": row(**{"controller.kp": 1.0}),
    "Sweep.open": row(path=partial(lambda: WORLD.sweep.path), scenario=None, grid=None, cases=None),
    "Sweep.table": row(share=0.9, most=3),
    "Sweep.within": row(share=0.9, by="distance"),
    "MobileRobot": row(mass=10, yaw_inertia=1, com=(0.1, 0.05), size=(0.6, 0.4, 0.2), dh=pm.LECTURE_TABLE),
    "MobileRobot.box": row(mass=10, size=(0.6, 0.4, 0.2)),
    "MobileRobot.lecture": row(),
    "MobileRobot.from_body": row(
        body=the("body"),
        size=(0.6, 0.4, 0.2),
        dh=pm.LECTURE_TABLE,
        source="a test",
        stance=partial(Stance.of_box, (0.6, 0.4, 0.2)),
        locked_joints=("wheel",),
    ),
    "MobileRobot.with_body": row(body=the("body"), source="a test"),
    "MobileRobot.from_model": row(pin_model=partial(lambda: WORLD.robot.model), ground=-0.1),
    "MobileRobot.from_urdf": row(path=the("urdf"), package_dirs=(), ground=-0.1),
    "robot.Stance": row(footprint=[[-1, -1], [1, -1], [1, 1], [-1, 1]], top=0.5, grounded=True),
    "robot.Stance.of_box": row(size=(0.6, 0.4, 0.2)),
    "robot.Stance.written": row(),
    "MobileRobot.to_urdf": row(),
    "MobileRobot.mount": row(
        arm=the("arm"),
        at=(0, 0, 0.2, 0),
        name="arm",
        package_dirs=(),
        visual=None,
        collision=None,
        rest=[0.1, 0.2],
        locked=["j1"],
    ),
    "MobileRobot.attach": row(load=pm.Load(1), frame=None),
    "MobileRobot.lumped": row(q=Q),
    **{f"MobileRobot.{name}": row(**named) for name, named in STATES.items()},
    **{
        f"closed_form.{name}": row(
            **named, **{k: v for k, v in BODY.items() if not (k == "yaw_inertia" and name in MASSLESS)}
        )
        for name, named in STATES.items()
    },
    "closed_form.differential_drive": row(
        nu=[0.4, 0.5], **BODY, track=0.5, radius=0.1, spin_inertia=0.01, axle=0.05
    ),
    "closed_form.roller_drive": row(
        twist=V,
        **BODY,
        x=[0.2, -0.1, -0.1],
        y=[0.0, 0.2, -0.2],
        angle=[1.6, 3.7, 5.8],
        roller=[0.0, 0.1, 0.2],
        radius=0.1,
        spin_inertia=0.01,
    ),
    "closed_form.car": row(
        nu=[0.4, 0.5],
        steering=0.3,
        **BODY,
        wheelbase=0.5,
        radius=0.1,
        track=0.4,
        spin_inertia=0.01,
        steered_inertia=0.01,
    ),
    "MobileRobot.frame_name": row(frame="base_link"),
    "MobileRobot.effort": row(q=Q, wrench=A),
    "MobileRobot.pose": row(q=Q),
    "MobileRobot.rate": row(q=Q, v=V),
    "MobileRobot.start": row(reference=partial(lambda: WORLD.trajectory(0.0))),
    "MobileRobot.forward_dynamics_derivatives": row(q=Q, v=V, tau=A),
    "MobileRobot.linearize": row(q=Q, v=V, tau=A),
    "MobileRobot.linearize_tracked": row(q=Q, v=V, u=A),
    "MobileRobot.regressor": row(q=Q, v=V, a=A),
    "MobileRobot.difference": row(q0=Q, q1=V),
    "MobileRobot.integrate": row(q=Q, dq=V),
    "MobileRobot.jacobian": row(q=Q),
    "MobileRobot.gravity": row(q=Q),
    "MobileRobot.potential_energy": row(q=Q),
    "MobileRobot.kinetic_energy": row(q=Q, v=V),
    "MobileRobot.ground_wrench": row(q=Q, v=V, a=A),
    "MobileRobot.mount_wrench": row(q=np.zeros(5), v=np.zeros(5), a=np.zeros(5), mount=None),
    "MobileRobot.measured": row(
        **dict.fromkeys("qvau", np.zeros(5)), t=0.0, reference=partial(lambda: WORLD.trajectory(0.0))
    ),
    "MobileRobot.frame_drift": row(q=Q, v=V, frame=None),
    "MobileRobot.frame_jacobian": row(q=Q, frame=None),
    "MobileRobot.frame_placements": row(q=Q),
    "MobileRobot.solid_placements": row(q=Q),
    "MobileRobot.frame_pose": row(q=Q, frame=None),
    "MobileRobot.manipulability": row(q=np.zeros(5), frame=None),
    "MobileRobot.arm_manipulability": row(q=np.zeros(5), frame=None),
    "MobileRobot.random_configuration": row(generator=partial(np.random.default_rng, 1), shape=(2,)),
    "Resolved.__call__": row(t=[0.1, 0.5]),
    "Resolved.max_error": row(),
    "Log": Row(lambda: {"t": WORLD.log.t, "q": WORLD.log.q, "u": WORLD.log.u, "twist": None}, 60),
    "Log.between": row(start=0.0, stop=5.0),
    "Log.samples": row(),
    "Log.from_csv": row(path=the("log_csv"), columns=None),
    "Log.from_bag": row(path=the("log_csv"), topics={"q": "/odom", "u": "/wrench"}, stamps="header"),
    "Log.from_rollout": row(rollout=the("rollout"), noise=1e-3, input_noise=(1, 1, 0.1), delay=1, seed=0),
    "Log.from_streams": Row(
        lambda: {
            "t_q": WORLD.log.t,
            "q": WORLD.log.q,
            "t_u": WORLD.log.t,
            "u": WORLD.log.u,
            "twist": None,
            "wheel_rates": None,
        },
        60,
    ),
    "identify": row(60, log=the("log"), robot=None, loads=None, method="weak", delay=0.0, rolling_speed=0.01),
    "Identification.delay_interval": row(level=0.9),
    "Identification.interval": row(level=0.9),
    "Identification.robot": row(),
    "Identification.forces": row(),
    "Identification.spread": row(n=3, seed=0),
    "Identification.predict": row(60, log=the("log"), seconds=2.0),
    "excitation": row(
        60,
        robot=None,
        duration=10.0,
        period=10.0,
        position=(1, 1, 3),
        velocity=(1, 1, 1),
        acceleration=(1, 1, 2),
        harmonics=3,
        seed=0,
    ),
    "identification.Excitation": row(
        coefficients=np.ones((3, 2, 3)), period=5.0, duration=10.0, S=None, start=np.zeros(3)
    ),
    "identification.Excitation.__call__": row(t=1.0),
    "plots.prediction": row(60, foretold=the("foretold"), title="a title", ax=None, width=8.0),
    "Rollout.load": row(path=the("saved")),
    "Rollout.save": row(path=partial(lambda: WORLD.folder / "again.npz")),
    "Rollout.to_csv": row(path=partial(lambda: WORLD.folder / "again.csv")),
    "Rollout.max_error": row(),
    "EndEffector.max_error": row(),
    "Rollout.measures": row(),
    "Rollout.end_effector": row(frame=None),
    "Rollout.max_input": row(),
    "Rollout.rms_error": row(),
    "integrator_report": row(60, integrator=pm.rk4, robot=the("robot"), steps=(0.1, 0.05), duration=0.2),
    "mountable": row(),
    "resolve": row(
        200,
        robot=the("armed"),
        target=the("target"),
        frame="arm/l1",
        q0=np.array([0, 0, 0, 0.1, 0.1]),
        posture=np.zeros(2),
        dt=0.1,
        posture_gain=1.0,
        cost=[1, 1, 1, 1, 1],
        velocity_limit=[1] * 5,
        acceleration_limit=[9] * 5,
        damping=0.01,
        tolerance=1.0,
        clearance=None,
    ),
    "shipped_urdf": row(name="box"),
    "simulate": row(
        plant=the("robot"),
        controller=pm.PD(40, 20),
        trajectory=the("trajectory"),
        dt=0.1,
        duration=1.0,
        q0=Q,
        v0=V,
        integrator=pm.rk4,
        substeps=2,
        forces=[pm.ConstantForce([1, 0, 0])],
        limit=1e3,
    ),
    "vectorize": row(function=pm.MobileRobot.box().mass_matrix, axes=1, checked=True, keep=False),
    "verify": row(60, robot=the("robot"), states=3, seed=1),
    "DHRow": row(alpha=0, a=0, theta=0, d=0, joint=pm.JointType.REVOLUTE, variable="a"),
    "DHTable": row(rows=pm.LECTURE_TABLE.rows),
    "DHTable.placements": row(q=Q),
    "DHTable.transforms": row(q=Q),
    "dh.transform": row(alpha=0, a=0, theta=[0, 1], d=0),
    "urdf.Body": row(mass=1, com=[0, 0, 0], inertia=np.eye(3)),
    "urdf.box_inertia": row(mass=1, size=(1, 2, 3)),
    "urdf.write": row(table=pm.LECTURE_TABLE, body=the("body"), size=(1, 2, 3), name="robot", stance={}),
    "derivation.Chain": row(
        table=pm.LECTURE_TABLE,
        links=[None, None, derivation.Link.general(3)],
        order=("x", "y", "psi"),
        gravity=(0, 0, 0),
    ),
    "derivation.Chain.ordered": row(per_row=(1, 2, 3)),
    "derivation.Link": row(mass=1, com=(0, 0, 0), inertia=np.eye(3).tolist()),
    "derivation.Link.general": row(k=1),
    "derivation.derive": row(
        40,
        table=pm.LECTURE_TABLE,
        links=[None, None, derivation.Link(1, (0, 0, 0), np.eye(3).tolist())],
        order=("x", "y", "psi"),
        gravity=(0, 0, 0),
    ),
    "derivation.lecture": row(table=pm.LECTURE_TABLE),
    "derivation.Derivation.latex": row(),
    "derivation.Derivation.numeric": row(),
    "derivation.Derivation.written_out": row(expression=partial(lambda: WORLD.derivation.mass_matrix[0, 0])),
    "derivation.ReducedDerivation.latex": row(),
    "derivation.ReducedDerivation.written_out": row(
        expression=partial(lambda: WORLD.reduced.mass_matrix[0, 0])
    ),
    "derivation.RollerWheel": row(x=0.2, y=0.1, angle=0.1, roller=0.7, radius=0.1, spin_inertia=0.01),
    "derivation.RollerWheel.general": row(k=1),
    "derivation.car": row(),
    "derivation.differential_drive": row(),
    "derivation.roller_drive": row(wheels=[derivation.RollerWheel(0.2, 0.1, 0, 0.7)]),
    "derivation.Step.latex": row(),
    "derivation.Numeric.mass_matrix": row(q=Q, params=partial(lambda: dict(PARAMS))),
    "derivation.Numeric.nonlinear_effects": row(q=Q, v=V, params=partial(lambda: dict(PARAMS))),
    "derivation.Numeric.inverse_dynamics": row(q=Q, v=V, a=A, params=partial(lambda: dict(PARAMS))),
    "plots.animate": row(
        40,
        rollouts=the("rollout"),
        path=partial(lambda: WORLD.folder / "a.gif"),
        fps=2,
        speed=2,
        title="a title",
        progress=lambda done, n: None,
    ),
    "plots.balance": row(60, rollouts=the("rollout"), footprint=None, title="a title", ax=None, width=6.0),
    "plots.bands": row(
        60, ensembles=the("ensemble"), levels=(0.5, 0.9), by=["distance"], title="a title", ax=None, width=6.0
    ),
    "plots.curves": row(
        120, values={"a": [1, 2]}, x=("a", "m", [1, 2]), label="b", title="a title", ax=None, width=6.0
    ),
    "plots.drivers": row(
        60, ensemble=the("ensemble"), share=0.5, by="distance", title="a title", ax=None, width=9.0
    ),
    "plots.end_effector": row(
        60, rollouts=the("arm_rollout"), frame=None, title="a title", ax=None, width=5.0
    ),
    "plots.errors": row(60, rollouts=the("rollout"), title="a title", ax=None, width=6.0),
    "plots.forces": row(60, rollouts=the("rollout"), title="a title", ax=None, width=6.0),
    "plots.heatmap": row(
        120,
        values=[[1, 2], [3, 4]],
        x=("a", "m", [1, 2]),
        y=("b", "m", [1, 2]),
        label="c",
        title="a title",
        ax=None,
        width=6.0,
        limits=(1, 4),
    ),
    "plots.integrator": row(60, reports=the("report"), title="a title", ax=None, width=6.0),
    "plots.path": row(60, rollouts=the("rollout"), times=[0.1, 0.5], title="a title", ax=None, width=6.0),
    "plots.reaction": row(60, rollouts=the("arm_rollout"), mount="arm", title="a title", ax=None, width=6.0),
    "plots.signals": row(rollouts=the("told"), title="a title", ax=None, width=6.0),
    "plots.states": row(60, rollouts=the("rollout"), title="a title", ax=None, width=6.0),
    "plots.friction": row(60, rollouts=the("rolls"), title="a title", ax=None, width=6.0),
    "plots.loads": row(60, rollouts=the("rolls"), title="a title", ax=None, width=6.0),
    "plots.odometry": row(60, rollouts=the("rolls"), title="a title", ax=None, width=6.0),
    "plots.slip": row(60, rollouts=the("rolls"), title="a title", ax=None, width=6.0),
    "plots.wheel_torques": row(60, rollouts=the("rolls"), title="a title", ax=None, width=6.0),
    "Ackermann": row(wheels=("front_left", "front_right"), axle=0.1, name="steering"),
    "ByOdometry": row(
        controller=pm.PD(1, 1),
        table=the("differential"),
        ticks=1000,
        noise=0.1,
        seed=1,
    ),
    "Coulomb": row(mu=0.5, ramp=pm.Ramp(0.1), sweeps=100, tolerance=1e-9),
    "Differential": row(wheels=("left", "right"), motor=pm.Motor(), name="drive"),
    "Friction": row(mu=0.8, across=0.02, rolling=0.01, slip=0.1),
    "GearTrain": row(wheels=("left", "right"), ratios=[1.0, 2.0]),
    "Motor": row(**MOTOR, source="a test"),
    "Motor.armature_current": row(volts=[1, 2], rate=3),
    "Motor.no_load_rate": row(volts=6),
    "Motor.stall_torque": row(volts=6),
    "Motor.torque": row(volts=[1, 2], rate=3),
    "Ramp": row(angle=0.1, direction=0.2),
    "Ramp.fall": row(g=9.81),
    "Rolling": row(ramp=pm.Ramp(0.1)),
    "Support": row(x=1, y=2),
    "Wheel": row(
        name="left",
        x=0,
        y=0.2,
        radius=0.1,
        angle=0.1,
        steering="driven",
        trail=(-0.03, 0.005),
        roller=0.5,
        mass=1,
        spin_inertia=0.01,
        yaw_inertia=0.01,
        motor=pm.Motor(),
        friction=pm.Friction(),
        steering_limit=1.0,
    ),
    "WheelTable": row(
        wheels=[pm.Wheel("left", 0, 0.2, 0.1), pm.Wheel("right", 0, -0.2, 0.1)],
        supports=[pm.Support(0.2, 0)],
        couplings=[pm.GearTrain(("left", "right"))],
        source="a test",
    ),
    "WheelTable.car": row(wheelbase=0.6, track=0.4, radius=0.1, motor=pm.Motor(), steering_limit=0.6, mass=1),
    "WheelTable.differential": row(
        track=0.4, radius=0.1, x=0.1, supports=[(-0.2, 0)], motor=pm.Motor(), mass=1
    ),
    "WheelTable.mecanum": row(wheelbase=0.6, track=0.4, radius=0.1, roller=0.8, motor=pm.Motor(), mass=1),
    "WheelTable.omni": row(distance=0.3, radius=0.1, n=4, first=0.1, motor=pm.Motor(), mass=1),
    "WheelTable.skid_steer": row(
        wheelbase=0.6, track=0.4, radius=0.1, coupled=True, motor=pm.Motor(), mass=1
    ),
    "WheelTable.swerve": row(
        places=[(0.3, 0.1), (-0.3, -0.1)], radius=0.1, motor=pm.Motor(), supports=[(-0.2, 0)], mass=1
    ),
    "WheeledRobot": row(robot=the("base"), table=the("differential"), ground=pm.Coulomb(0.5)),
    "WheeledRobot.from_urdf": row(
        120,
        path=the("turtlebot"),
        package_dirs=(),
        table=None,
        ground=None,
        ground_z=None,
        rollers={},
        supports=[(-0.08, 0)],
    ),
    "wheels.read_wheels": row(
        robot=partial(lambda: pm.MobileRobot.from_urdf(WORLD.turtlebot)),
        radius={"${namespace}wheel_left_joint": 0.033},
        rollers={},
        driven=None,
        steering={},
        inertia=(1e-5, 1e-5),
        locked=(),
        supports=[(-0.08, 0)],
        couplings=(),
    ),
    "wheels.Mobility": row(table=the("differential")),
    "wheels.Mobility.of": row(table=the("differential")),
    "WheeledRobot.allocate": row(q=FIVE, tau=A),
    "WheeledRobot.allocate_scaled": row(q=FIVE, tau=A),
    "WheeledRobot.attach": row(load=pm.Load(1), frame=None),
    "WheeledRobot.check_inverse_dynamics": row(),
    "WheeledRobot.check_start": row(q=np.zeros(5), v=[1, 0, 0, 10, 10]),
    "WheeledRobot.constraint_drift": row(q=FIVE, v=FIVE),
    "WheeledRobot.constraint_forces": row(q=FIVE, v=FIVE, u=[1, 2], f=FIVE),
    "WheeledRobot.constraint_matrix": row(q=FIVE),
    "WheeledRobot.contacts": row(**{name: [[0.1] * 5] * 2 for name in "qva"}, u=[[1, 2], [3, 4]], signals={}),
    "WheeledRobot.difference": row(q0=FIVE, q1=FIVE),
    "WheeledRobot.drawing": row(q=FIVE),
    "WheeledRobot.frame_name": row(frame=None),
    "WheeledRobot.frame_pose": row(q=FIVE, frame=None),
    "WheeledRobot.solid_placements": row(q=FIVE),
    "WheeledRobot.contact_loads": row(q=FIVE, v=FIVE, a=FIVE),
    "WheeledRobot.effort": row(q=FIVE, wrench=A),
    "WheeledRobot.ground_wrench": row(q=FIVE, v=FIVE, a=FIVE),
    "WheeledRobot.mount_wrench": row(q=np.zeros(7), v=np.ones(7), a=np.ones(7), mount="arm"),
    "WheeledRobot.on_ramp": row(angle=0.1, direction=0.2),
    "WheeledRobot.forward_dynamics": row(q=FIVE, v=FIVE, u=[1, 2], f=FIVE),
    "WheeledRobot.independent": row(q=FIVE, v=FIVE),
    "WheeledRobot.integrate": row(q=FIVE, dq=FIVE),
    "WheeledRobot.inverse_dynamics": row(q=np.zeros(7), v=np.zeros(7), a=A),
    "WheeledRobot.kinetic_energy": row(q=FIVE, v=FIVE),
    "WheeledRobot.mass_matrix": row(q=FIVE),
    "WheeledRobot.mount": row(120, arm=the("arm"), at=(0, 0, 0.2, 0), name="arm"),
    "WheeledRobot.nonlinear_effects": row(q=FIVE, v=FIVE),
    "WheeledRobot.odometry": row(rates=[1, 2], steering=(), turning=()),
    "WheeledRobot.pose": row(q=FIVE),
    "WheeledRobot.rate": row(q=FIVE, v=FIVE),
    "WheeledRobot.reduced": row(q=FIVE, v=FIVE),
    "WheeledRobot.start": row(reference=partial(lambda: WORLD.trajectory(0.0))),
    "WheeledRobot.linearize_tracked": row(q=FIVE, v=FIVE, u=[1, 2]),
    "WheeledRobot.torques": row(q=FIVE, v=FIVE, rates=[1, 2]),
    "WheeledRobot.wheel_rates": row(twist=V, steering=(), turning=()),
    "Motor.from_sheet": row(
        voltage=12.0, stall_torque=2.0, stall_current=5.0, no_load_rate=20.0, no_load_current=0.2, gear=50.0
    ),
    "WheeledRobot.by_voltage": row(),
    "wheels.ByVoltage": row(wheeled=the("electric")),
    "wheels.ByVoltage.attach": row(load=pm.Load(1), frame=None),
    "wheels.ByVoltage.forward_dynamics": row(q=FIVE, v=FIVE, u=[1, 2], f=FIVE),
    "wheels.ByVoltage.linearize_tracked": row(q=FIVE, v=FIVE, u=[1, 2]),
    "wheels.ByVoltage.mount": row(120, arm=the("arm"), at=(0, 0, 0.2, 0), name="arm"),
    "wheels.ByVoltage.on_ramp": row(angle=0.1, direction=0.2),
    "wheels.ByVoltage.torques_at": row(v=FIVE, u=[1, 2]),
    "wheels.ByVoltage.volts_for": row(v=FIVE, torques=[1, 2]),
    "viewer.Arrows": row(force=1, moment=1),
    "viewer.Follow": row(distance=4),
    "viewer.Stay": row(eye=[1, 1, 1], target=[0, 0, 0]),
    "viewer.Overlays": row(
        grid=True,
        path=True,
        trail=True,
        caption=True,
        desired=False,
        body_frame=False,
        frames=(pm.LECTURE_TABLE,),
        arrows=viewer.Arrows(),
        camera=viewer.Follow(),
    ),
    "viewer.Viewer": row(80, plant=the("robot"), live=False, host="127.0.0.1", port=None, overlays=None),
    "viewer.Viewer.close": row(),
    "viewer.Viewer.display": row(q=Q),
    "viewer.Viewer.play": row(rollout=the("rollout"), speed=1, repeat=1, overlays=None),
    "viewer.Viewer.record": row(rollout=the("rollout"), fps=5, speed=1, overlays=None, title="a title"),
    "viewer.Viewer.screenshot": row(path=partial(lambda: WORLD.folder / "a.png"), t=0.1, size=(100, 100)),
    "viewer.Viewer.static_html": row(title="a title"),
    "viewer.Viewer.wait": row(timeout=0.1),
    "viewer.Recording.html": row(),
    "viewer.Recording.save_gif": row(
        path=partial(lambda: WORLD.folder / "a.txt"), fps=2, size=(100, 100), progress=None
    ),
    "viewer.Recording.save_html": row(path=partial(lambda: WORLD.folder / "a.html")),
    "viewer.Recording.save_mp4": row(
        path=partial(lambda: WORLD.folder / "a.txt"), fps=2, size=(100, 100), progress=None
    ),
    "viewer.Recording.screenshot": row(path=partial(lambda: WORLD.folder / "a.txt"), t=0.1, size=(100, 100)),
}

# Objects whose methods are called, by the class.
OWNERS: dict[str, Callable[[], Any]] = {
    "robot.Stance": lambda: Stance.of_box((0.6, 0.4, 0.2)),
    "EndEffectorTracking": lambda: pm.EndEffectorTracking(WORLD.armed, WORLD.target),
    "MPC": lambda: pm.MPC(WORLD.robot),
    "Circle": lambda: WORLD.path,
    "Lissajous": lambda: pm.Lissajous(1, 2, 0.5, 1, 1),
    "CompositePath": lambda: pm.CompositePath([WORLD.path]),
    "CubicVia": lambda: pm.CubicVia([0, 0], [1, 1], [2, 0], 1, 2),
    "Line": lambda: pm.Line([0, 0], [1, 1], 1),
    "Moved": lambda: WORLD.path.moved(1, 2, 0.5),
    "Polyline": lambda: pm.Polyline([[0, 0], [1, 0], [1, 1]], 0.2, 5),
    "Hold": lambda: pm.Hold([1, 2], 1),
    "RestToRest": lambda: pm.RestToRest([0, 0], [1, 1], 1),
    "Spline": lambda: pm.Spline([[0, 0], [1, 1], [2, 0]], [0, 1, 2]),
    "Tangent": lambda: WORLD.trajectory,
    "FixedHeading": lambda: pm.FixedHeading(WORLD.path, 0),
    "LectureHeading": lambda: pm.LectureHeading(WORLD.path),
    "WholeBody": lambda: WORLD.whole,
    "PosePath": lambda: WORLD.target,
    "JointFriction": lambda: pm.JointFriction,
    "NoiseForce": lambda: pm.NoiseForce,
    "Context": lambda: pm.Context.of(WORLD.robot, dt=0.1),
    "ConstantForce": lambda: pm.ConstantForce,
    "Payload": lambda: pm.Payload(2.0, [0.1, 0.2], 1.0),
    "SinusoidalForce": lambda: pm.SinusoidalForce,
    "ViscousFriction": lambda: pm.ViscousFriction,
    "RollingResistance": lambda: pm.RollingResistance,
    "Uniform": lambda: pm.Uniform(1, 2),
    "Normal": lambda: pm.Normal(1, 2),
    "Scenario": lambda: WORLD.scenario,
    "Ensemble": lambda: WORLD.ensemble,
    "Sweep": lambda: WORLD.sweep,
    "MobileRobot": lambda: WORLD.robot,
    "Motor": lambda: pm.Motor(**MOTOR),
    "Ramp": lambda: pm.Ramp(0.1),
    "WheelTable": lambda: WheelTable,
    "WheeledRobot": lambda: WORLD.wheeled,
    "WheeledRobot.by_voltage": lambda: WORLD.electric,
    "WheeledRobot.mount_wrench": lambda: WORLD.standing.mount(WORLD.arm, (0, 0, 0.2, 0), name="arm"),
    "WheeledRobot.inverse_dynamics": lambda: WORLD.mecanum,
    "WheeledRobot.check_inverse_dynamics": lambda: WORLD.mecanum,
    "wheels.ByVoltage": lambda: WORLD.electric.by_voltage(),
    "VelocityRobot": lambda: WORLD.commanded,
    "identification.VelocityIdentification": lambda: WORLD.theta,
    "wheels.Mobility": lambda: wheels.Mobility,
    "Resolved": lambda: WORLD.resolved,
    "Log": lambda: WORLD.log,
    "Identification": lambda: WORLD.identified,
    "identification.Excitation": lambda: pm.excitation(duration=10.0, period=10.0, harmonics=3),
    "Rollout": lambda: WORLD.rollout,
    "EndEffector": lambda: WORLD.arm_rollout.end_effector(),
    "DHTable": lambda: pm.LECTURE_TABLE,
    "derivation.Chain": lambda: derivation.Chain(pm.LECTURE_TABLE),
    "derivation.Link": lambda: derivation.Link,
    "derivation.Derivation": lambda: WORLD.derivation,
    "derivation.ReducedDerivation": lambda: WORLD.reduced,
    "derivation.RollerWheel": lambda: derivation.RollerWheel,
    "derivation.Numeric": lambda: WORLD.numeric,
    "derivation.Step": lambda: WORLD.derivation.steps[0],
    "viewer.Viewer": _viewer,
    "viewer.Recording": lambda: WORLD.recording,
}
# Those of which a valid call needs an arm.
ARMED = {"measured", "mount_wrench", "manipulability", "arm_manipulability"}
# Those of which a valid call is refused here: there is no live page, no file of that ending is made.
REFUSED = {
    "viewer.Viewer.play",
    "viewer.Viewer.wait",
    "viewer.Viewer.screenshot",
    "viewer.Recording.save_gif",
}
REFUSED |= {"Log.from_bag", "viewer.Recording.save_mp4", "viewer.Recording.screenshot"}
# Those that take arguments by position alone, or any number of them.
CALLED: dict[str, Callable[..., Any]] = {
    "WholeBody": lambda robot, base, joints: pm.WholeBody(robot, base, joints),
}


def public(module: Any) -> list[str]:
    """Return the public names: of a package those that it lists, of one module those that it defines."""
    if hasattr(module, "__all__"):
        return list(module.__all__)
    defined = (
        name for name, value in vars(module).items() if getattr(value, "__module__", "") == module.__name__
    )
    return sorted(name for name in defined if not name.startswith("_"))


def callables() -> Iterator[str]:
    """Yield the names of all public callables: of functions, classes and their methods."""
    seen: set[int] = set()
    for module in ("", *MODULES):
        home = importlib.import_module(f"pinmobile.{module}".rstrip("."))
        for name in public(home):
            value = getattr(home, name)
            full = f"{module}.{name}".lstrip(".")
            if not callable(value) or id(value) in seen or not _ours(value):
                continue
            seen.add(id(value))
            if not inspect.isclass(value):
                yield full
            elif not getattr(value, "_is_protocol", False):
                yield full
                if full not in INNER:
                    yield from (f"{full}.{method}" for method in _methods(value))


def _ours(value: Any) -> bool:
    return str(getattr(value, "__module__", "")).startswith("pinmobile")


def _methods(kind: type) -> Iterator[str]:
    if issubclass(kind, Exception):
        return
    held = {entry.name for entry in fields(kind)} if is_dataclass(kind) else set()
    inherited = set(dir(tuple)) if issubclass(kind, tuple) else set()
    for name in dir(kind):
        if (name.startswith("_") and name != "__call__") or name in held or name in inherited:
            continue
        found = inspect.getattr_static(kind, name)
        if callable(getattr(kind, name)) and not isinstance(found, property):
            yield name


def is_part(name: str) -> bool:
    """Tell whether a method is what the loop calls on its parts, with arrays that it made."""
    owner, _, method = name.rpartition(".")
    parts = ("PD", "ComputedTorque", "Decoupled", "PDGravity", "Saturated", "Delayed", "NoisyMeasurement")
    unsure = ("PID", "SlidingMode", "SuperTwisting", "Adaptive", "ADRC", "LQR", "MPC", "DisturbanceObserver")
    of_wheels = (
        "Allocated",
        "Backstepping",
        "ByOdometry",
        "Driven",
        "WheelSpeed",
        "VelocityCommand",
        "AdaptiveVelocity",
        "RandomSteps",
        "Tracking",
        "Kanayama",
        "Parking",
        "DynamicFeedback",
        "SwerveTracking",
    )
    forces = (
        "ConstantForce",
        "Payload",
        "SinusoidalForce",
        "NoiseForce",
        "RollingResistance",
        "ViscousFriction",
    )
    others = "EndEffectorTracking", "JointFriction", "loop.Samples", "loop.Worst"
    called = owner in (*parts, *unsure, *of_wheels, *forces, *others)
    integrators = ("constant_acceleration", "rk4", "semi_implicit_euler")
    return name in integrators or (
        called
        and method
        in (
            "__call__",
            "initial_state",
            "applied",
            "signals",
            "acceleration",
            "on_coordinates",
            "inertia",
            "check",
        )
    )


def resolved(name: str) -> Callable[..., Any]:
    """Return what a name of `callables` names, bound to an object where it is a method."""
    if name in CALLED:
        return CALLED[name]
    owner, _, method = name.rpartition(".")
    if owner in OWNERS and owner not in MODULES:
        own = OWNERS.get(name, OWNERS[owner])
        held = WORLD.armed if method in ARMED and name not in OWNERS else own()
        return getattr(held, method)  # type: ignore[no-any-return]
    home = importlib.import_module(f"pinmobile.{owner}".rstrip("."))
    return getattr(home, method)  # type: ignore[no-any-return]


class TooLong(BaseException):
    """A call took more processor time than it may."""


def _stop(*_: Any) -> None:
    raise TooLong


def _remembered(value: Any) -> Any:
    """Return what shows whether an argument was written into."""
    if isinstance(value, np.ndarray):
        return np.ndarray.tobytes(value), value.dtype, value.shape, value.flags.writeable
    if isinstance(value, list | dict):
        return [id(entry) for entry in value]
    return None


def attempt(function: Callable[..., Any], arguments: dict[str, Any]) -> str:
    """Return what is wrong with what a call with a wrong value leads to; nothing where all is well."""
    before = {name: _remembered(value) for name, value in arguments.items()}
    signal.setitimer(signal.ITIMER_VIRTUAL, SECONDS)
    try:
        answer = function(**arguments)
    except PinmobileError as error:
        answer = None
        if len(str(error)) > 20_000:
            return f"a message of {len(str(error))} letters"
        try:
            str(error).encode()
        except UnicodeEncodeError:
            return "a message that cannot be printed"
    except TooLong:
        return f"more than {SECONDS} s"
    except BaseException as error:
        if "from the function itself" in str(error) or "is not to be had" in str(error):
            return ""  # what a user's own function or object raises comes through
        place = traceback.extract_tb(error.__traceback__)
        ours = [frame for frame in place if "pinmobile" in frame.filename] or place
        where = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}"
        return f"{type(error).__name__} at {where}: {str(error)[:160]}"
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
    if hasattr(answer, "close") and isinstance(answer, viewer.Viewer):
        answer.close()
    changed = [name for name, value in arguments.items() if _remembered(value) != before[name]]
    return f"{', '.join(changed)} was written into" if changed else ""


# The same numbers otherwise: the answer must be the same, to the last bit.
CLOTHES: dict[str, Callable[[Any], Any]] = {
    "as an array": np.array,
    "as a tuple": lambda value: tuple(value) if np.ndim(value) else value,
    "read-only": lambda value: _read_only(np.array(value, float)),
    "in another byte order": lambda value: np.array(value, ">f8"),
    "in Fortran's order": lambda value: np.array(value, float, order="F"),
    "as long doubles": lambda value: np.array(value, np.longdouble),
    "as an array of a class of its own": lambda value: np.array(value, float).view(Tagged),
    "with gaps": lambda value: np.stack([value, value], axis=-1)[..., 0],
}


def _read_only(array: Any) -> Any:
    array.setflags(write=False)
    return array


def _essence(value: Any, depth: int = 4) -> Any:
    """Return what two equal answers have in common, to the last bit, as far as it is numbers and text."""
    if isinstance(value, int | float | np.number) or (isinstance(value, np.ndarray) and not value.ndim):
        return float(value)
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if isinstance(value, str | bytes):
        return value
    if depth and isinstance(value, list | tuple):
        return [_essence(entry, depth - 1) for entry in value]
    if depth and is_dataclass(value) and not isinstance(value, type):
        return [_essence(getattr(value, entry.name), depth - 1) for entry in fields(value)]
    return type(value).__name__


def dressed(name: str) -> Iterator[tuple[str, str, str]]:
    """Yield argument, clothes and what is wrong, where the same numbers come otherwise."""
    line, function = ROWS[name], resolved(name)
    if line.tries:
        return
    for argument, value in line.arguments().items():
        numeric = isinstance(value, int | float | list | tuple | np.ndarray) and not isinstance(value, bool)
        try:
            numbers = np.asarray(value) if numeric else np.asarray(None)
        except ValueError:
            continue
        if numbers.dtype.kind not in "fiu" or not numbers.size:
            continue
        expected = _essence(function(**line.arguments()))
        for clothes, dress in CLOTHES.items():
            try:
                answer = function(**line.arguments() | {argument: dress(value)})
            except PinmobileError:
                continue
            if _essence(answer) != expected:
                yield argument, clothes, "another answer"


def trials(name: str, share: int = 1) -> Iterator[tuple[str, str, str]]:
    """Yield argument, kind and what is wrong, for each wrong value of a callable, or one of so many."""
    line, function = ROWS[name], resolved(name)
    valid = line.arguments()
    try:
        function(**valid)
    except PinmobileError as error:
        if name not in REFUSED:
            yield "", "valid", f"refused: {error}"
    except Exception as error:
        yield "", "valid", f"{type(error).__name__}: {error}\n{traceback.format_exc()}"
    if name not in REFUSED:
        yield from dressed(name)
    pairs = [(argument, kind) for argument in valid for kind in KINDS]
    if line.tries and line.tries < len(pairs):
        pairs = Random(SEED + crc32(name.encode())).sample(pairs, line.tries)
    pairs = pairs[crc32(name.encode()) % share :: share]
    for argument, kind in pairs:
        yield argument, kind, attempt(function, line.arguments() | {argument: KINDS[kind]()})


def main(names: list[str]) -> None:
    """Run all trials, and print as JSON how many there were of each callable, and what was wrong."""
    import os
    import time

    matplotlib.use("Agg")
    os.chdir(WORLD.folder)
    signal.signal(signal.SIGVTALRM, _stop)
    for name in MADE:
        getattr(WORLD, name)
    WORLD.viewer.record(WORLD.rollout, fps=5)
    if sys.platform == "linux":
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        most = pages * resource.getpagesize() + MEMORY
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
    warnings.simplefilter("error")
    share = int(names.pop(0).removeprefix("--share=")) if names[:1] and "=" in names[0] else 1
    if names[:1] == ["--only"]:
        names = [name for name in sorted(ROWS) if any(part in name for part in names[1:])]
    for name in names or sorted(ROWS):
        found, count, begin = [], 0, time.process_time()
        for argument, kind, wrong in trials(name, share):
            count += 1
            if wrong:
                found.append(f"{argument} = {kind}: {wrong}")
        taken = time.process_time() - begin
        print(json.dumps({"name": name, "count": count, "wrong": found, "taken": taken}), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
