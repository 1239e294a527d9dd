"""What users call, with a valid call of each, and the wrong values that replace its arguments one by one.

As a program it runs them all in this process, under a limit of memory, and prints what came out wrong: see
test_arguments.py.
"""

import importlib
import inspect
import json
import os
import resource
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from random import Random
from typing import Any
from zlib import crc32

import matplotlib
import numpy as np
import pinocchio as pin

import pinmobile as pm
from pinmobile import PinmobileError, derivation, loop, urdf, viewer
from pinmobile.parts import parameters
from pinmobile.wheels import Motor, WheeledRobot, WheelTable
from tests import wheeled
from tests.drawing import APART, PARTS, drawn

SEED = 20240
THETA: list[float] = [0.26, 0.25, 0.03, 1.1, 0.2, 1.2]
SECONDS = 5  # of processor time for one call
MEMORY = 6 << 30  # of address space; libraries that only reserve it have some 3 GB

# What is put in the place of an argument, made anew for each call: what a user may type by mistake.
TRIES = 5  # of each callable
KINDS: dict[str, Callable[[], Any]] = {
    "None": lambda: None,
    "NaN": lambda: float("nan"),
    "infinity": lambda: float("inf"),
    "zero": lambda: 0,
    "minus one": lambda: -1,
    "10**22": lambda: 10**22,
    "True": lambda: True,
    "complex": lambda: 1 + 2j,
    "text": lambda: "seven",
    "a number as text": lambda: "7",
    "empty list": list,
    "one number in a list": lambda: [1.0],
    "seven numbers": lambda: np.arange(7.0),
    "a matrix": lambda: np.eye(5, 2),
    "four axes": lambda: np.ones((2, 2, 2, 3)),
    "ragged": lambda: [[1.0, 2.0], [3.0]],
    "NaN among numbers": lambda: [0.0, float("nan"), 0.0],
    "None among numbers": lambda: [0.0, None, 0.0],
    "text among numbers": lambda: [0.0, "a", 0.0],
    "masked": lambda: np.ma.masked_array([1.0, 2.0, 3.0], [False, True, False]),
    "object array": lambda: np.array([1, None, {}], object),
    "a dict": lambda: {"a": 1.0},
    "a class": lambda: dict,
    "a lambda of none": lambda: lambda: None,
    "a robot": lambda: WORLD.robot,
    "a path": lambda: pm.Circle(1, 0.5, 1),
    "a controller": lambda: pm.PD(1, 1),
}


def small_arm() -> pin.Model:
    """Return an arm of two joints with limits."""
    model = pin.Model()
    model.name = "small"
    parent = 0
    for k in range(2):
        place = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.3 * k]))
        limits = (np.full(1, limit) for limit in (50.0, 5.0, -2.0, 2.0))
        joint = model.addJoint(parent, pin.JointModelRY(), place, f"j{k}", *limits)
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


def _logged() -> Any:
    path = pm.excitation(WORLD.robot, duration=22.0, period=11.0)
    law = pm.ComputedTorque(WORLD.robot, 16, 8)
    run = pm.simulate(WORLD.robot, law, path, dt=0.05, integrator=pm.rk4)
    return pm.Log.from_rollout(run, 1e-3)


def _logged_csv() -> Any:
    file = WORLD.folder / "log.csv"
    WORLD.rollout.to_csv(file)
    return file


def _scenario() -> Any:
    named = {name: value for name, value in ENSEMBLE().items() if name not in ("engine", "traces")}
    named["controller"] = pm.PD(1.0, 1)
    return pm.Scenario(**named)


def _commands() -> Any:
    still = pm.FixedHeading(pm.Hold((0, 0), 42.0), 0.0)
    run = pm.simulate(WORLD.commanded, pm.controllers.RandomSteps(), still, dt=0.1, engine=pm.Engine.COMPILED)
    q = run.q + 1e-3 * np.random.default_rng(1).normal(size=run.q.shape)
    return pm.Log(run.t, q, run.u)


def _saved(one: Any, name: str) -> Any:
    one.save(WORLD.folder / name)
    return WORLD.folder / name


def _sweep() -> Any:
    return pm.sweep(_scenario(), WORLD.folder / "sweep.zarr", grid={"controller.kp": [1.0, 2.0]})


MADE: dict[str, Callable[[], Any]] = {
    "commanded": lambda: pm.VelocityRobot(THETA),
    "commands": _commands,
    "log": _logged,
    "log_csv": _logged_csv,
    "identified": lambda: pm.identify(WORLD.log, method="weak"),
    "robot": lambda: pm.MobileRobot(10.0, 1.2, com=(0.15, 0.05)),
    "base": lambda: pm.MobileRobot(30.0, 1.3, com=(0.0, 0.0, 0.1), size=(0.6, 0.4, 0.25)),
    "differential": lambda: WheelTable.differential(
        0.46, 0.1, supports=[(0.25, 0), (-0.25, 0)], mass=1.0, spin_inertia=0.005, yaw_inertia=0.003
    ),
    "wheeled": lambda: WheeledRobot(WORLD.base, WORLD.differential),
    "turtlebot": _turtlebot,
    "swerve": lambda: WheeledRobot(
        WORLD.robot, WheelTable.swerve([(0.3, 0.1), (-0.3, -0.1)], 0.1, yaw_inertia=0.01)
    ),
    "standing": lambda: WheeledRobot(
        WORLD.robot, WheelTable.differential(0.5, 0.1, supports=[(0.6, 0.0), (-0.6, 0.0)])
    ),
    "wheeled_motion": lambda: pm.balance.MotionStates(
        WORLD.standing, np.zeros(5), np.zeros(5), np.zeros(5), np.zeros(2)
    ),
    "electric": lambda: WheeledRobot(
        WORLD.robot,
        WheelTable.differential(
            0.5, 0.1, motor=Motor(resistance=1.0, torque_constant=0.03, voltage=24.0, gear=20.0)
        ),
    ),
    "arm": small_arm,
    "armed": lambda: WORLD.robot.mount(WORLD.arm, (0, 0, 0.2, 0), name="arm"),
    "path": lambda: pm.Circle(1, 0.5, 1),
    "trajectory": lambda: pm.Tangent(WORLD.path),
    "rollout": lambda: pm.simulate(WORLD.robot, pm.PD(40, 20), WORLD.trajectory, dt=0.1),
    "told": lambda: replace(WORLD.rollout, signals={"margin": ("m", np.zeros(len(WORLD.rollout)))}),
    "motion": lambda: pm.balance.MotionStates(WORLD.robot, np.zeros(3), np.zeros(3), np.zeros(3)),
    "arm_motion": lambda: pm.balance.MotionStates(WORLD.armed, np.zeros(5), np.zeros(5), np.zeros(5)),
    "target": lambda: pm.PosePath(pm.RestToRest([0.1, 0.0, 0.55], [0.2, 0.05, 0.55], 1)),
    "ensemble": _ensemble,
    "scenario": _scenario,
    "sweep": _sweep,
    "derivation": derivation.lecture,
    "numeric": lambda: WORLD.derivation.numeric(),
    "viewer": _viewer,
    "recording": lambda: WORLD.viewer.record(WORLD.rollout, fps=5),
    "body": lambda: urdf.Body(10.0, np.zeros(3), np.eye(3)),
    "urdf": lambda: pm.urdf.shipped_urdf("box"),
    "ensemble_scenario": lambda: WORLD.ensemble.scenario,
    "saved_ensemble": lambda: _saved(WORLD.ensemble, "ensemble.npz"),
    "saved": lambda: _saved(WORLD.rollout, "saved.npz"),
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
        "integrator": pm.integrators.constant_acceleration,
        "substeps": 1,
        "forces": [pm.ConstantForce([0.1, 0, 0])],
        "limit": 1e3,
        "after": 0.0,
        "every": 2,
        "metrics": [],
        "traces": [0],
        "engine": loop.Engine.COMPILED,
    }


@dataclass(frozen=True)
class Row:
    """A valid call: arguments by name, how many wrong values are tried, and whether defaults are, too."""

    arguments: Callable[[], dict[str, Any]]
    tries: int = 0
    with_defaults: bool = False

    def given(self, function: Callable[..., Any]) -> dict[str, Any]:
        """Return the arguments of a call, made anew."""
        parameters = inspect.signature(function).parameters.values() if self.with_defaults else ()
        left_out = {each.name: each.default for each in parameters if each.default is not each.empty}
        return left_out | self.arguments()


def row(tries: int = 0, /, **arguments: Any) -> Row:
    """Return a row of the arguments without defaults; one that is `Later` or partial is made when needed."""
    return Row(lambda: {name: _value(value) for name, value in arguments.items()}, tries, True)


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
MASSLESS = {"nonlinear_effects", "coriolis_matrix"}
FIVE = [0.1, 0.2, 0.3, 0.4, 0.5]
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


MADE_BY_THE_LIBRARY = {"Loop", "Samples", "SupportGeometry", "Worst"}


def a_part(make: Any) -> Row:
    """Return a row of all that a part declares."""

    def arguments() -> dict[str, Any]:
        for seed in range(400):
            with suppress(pm.InvalidArgument, ArithmeticError, AttributeError):
                one = drawn(make, Random(seed))
                return {name: getattr(one, name) for name in parameters(make)}
        raise AssertionError(f"no {make} is drawn")

    return Row(arguments)


ROWS: dict[str, Row] = {
    **{name: a_part(make) for name, make in PARTS.items() if name not in APART | MADE_BY_THE_LIBRARY},
    "ViscousFriction": row(),
    "Adaptive": row(robot=the("robot")),
    "LQR": row(robot=the("robot")),
    "MPC": row(robot=the("robot"), horizon=4),
    "AdaptiveVelocity": row(robot=the("commanded")),
    "EndEffectorTracking": row(robot=the("armed"), target=the("target"), dt=0.01),
    "law": row(function=lambda t, q, v, reference: np.zeros(3)),
    "plain_difference": row(q0=Q, q1=V),
    "planar_difference": row(q0=Q, q1=V),
    "WholeBody": row(robot=the("armed"), base=the("trajectory"), joints=pm.Hold([0.3, 0.4], 1)),
    "PosePath": row(path=pm.Hold([0, 0, 1], 1)),
    "FrameTask": row(target=pm.PosePath(pm.Hold([0, 0, 1], 1), np.eye(3))),
    "PosePath.through": row(poses=[np.eye(4), np.eye(4)], times=[0.0, 1.0]),
    "Circle.__call__": row(t=[0.1, 0.2]),
    "Circle.derivative": row(t=[0.1, 0.2], order=1),
    "Tangent.__call__": row(t=[0.1, 0.5]),
    "Circle.moved": row(),
    "PayloadBody": row(mass=1),
    "MotionStates": row(plant=the("robot"), q=Q, v=V, a=A),
    "MotionLimit": row(value=1.5, event="left slips"),
    "max_path_speed": row(plant=the("standing"), trajectory=the("trajectory"), samples=20),
    "max_slope": row(plant=the("standing")),
    "tip_over_margin": row(motion=the("motion")),
    "zero_moment_point": row(motion=the("motion")),
    "reaction_wrench": row(motion=the("arm_motion")),
    "required_friction": row(motion=the("motion")),
    "contact_loads": row(motion=the("wheeled_motion")),
    "slip_margins": row(motion=the("wheeled_motion")),
    "clearance": row(robot=the("robot"), q=Q),
    "Relative": row(factor=pm.Normal(1, 0.1)),
    "SameAs": row(name="mass"),
    "Scenario": Row(lambda: {k: v for k, v in ENSEMBLE().items() if k not in ("engine", "traces")}),
    "ensemble": Row(lambda: ENSEMBLE() | {"threads": 1, "progress": lambda done, n: None}, 60),
    "Ensemble.load": row(path=the("saved_ensemble")),
    "Ensemble.bands": row(),
    "Ensemble.error_quantile": row(),
    "Ensemble.worst": row(),
    "sweep": row(scenario=the("scenario"), path=partial(lambda: WORLD.folder / "other.zarr")),
    "Sweep.error_quantile": row(),
    "MobileRobot": row(mass=10, yaw_inertia=1),
    "MobileRobot.box": row(),
    "MobileRobot.from_urdf": row(path=the("urdf")),
    "MobileRobot.mount": row(arm=the("arm")),
    "MobileRobot.attach": row(load=pm.PayloadBody(1)),
    "PayloadTransfer": row(robot=pm.MobileRobot(10, 1), load=pm.PayloadBody(1), begin=1.0),
    "MobileRobot.regressor": row(q=Q, v=V, a=A),
    "MobileRobot.frame_pose": row(q=Q),
    "MobileRobot.linearize": row(q=Q, v=V, tau=A),
    "Log": Row(lambda: {"t": WORLD.log.t, "q": WORLD.log.q, "u": WORLD.log.u, "twist": None}),
    "Log.between": row(start=0.0, stop=5.0),
    "Log.from_csv": row(path=the("log_csv")),
    "Log.from_rollout": row(rollout=the("rollout")),
    "Log.from_streams": Row(
        lambda: (
            dict(t_q=WORLD.log.t, q=WORLD.log.q, t_u=WORLD.log.t, u=WORLD.log.u)
            | {"units": ("N", "N", "N m"), "twist": None, "wheel_rates": None}
        )
    ),
    "identify": row(log=the("log")),
    "identify_velocity": row(log=the("commands")),
    "Identification.interval": row(),
    "Identification.spread": row(n=3),
    "Identification.predict": row(log=the("log")),
    "excitation": row(duration=10.0, period=10.0),
    "Rollout.load": row(path=the("saved")),
    "Rollout.save": row(path=partial(lambda: WORLD.folder / "again.npz")),
    "Rollout.end_effector": row(),
    "integrator_report": row(integrator=pm.rk4, steps=(0.1, 0.05), duration=0.2),
    "solve_inverse_kinematics": row(
        12, robot=the("armed"), target=the("target"), q0=np.array([0, 0, 0, 0.1, 0.1]), dt=0.1, tolerance=1.0
    ),
    "shipped_urdf": row(name="box"),
    "mountable": row(),
    "simulate": row(plant=the("robot"), controller=pm.PD(40, 20), trajectory=the("trajectory"), dt=0.1),
    "vectorize": row(function=pm.MobileRobot.box().mass_matrix),
    "verify": row(robot=the("robot"), states=3),
    "DHRow": row(alpha=0, a=0, theta=0, d=0, joint=pm.dh.JointType.REVOLUTE, variable="a"),
    "DHTable": row(rows=pm.dh.LECTURE_TABLE.rows),
    "DHTable.placements": row(q=Q),
    "urdf.Body": row(mass=1, com=[0, 0, 0], inertia=np.eye(3)),
    "urdf.box_inertia": row(mass=1, size=(1, 2, 3)),
    "urdf.write": row(table=pm.dh.LECTURE_TABLE, body=the("body"), size=(1, 2, 3)),
    "derivation.Chain": row(table=pm.dh.LECTURE_TABLE),
    "derivation.Link": row(mass=1, com=(0, 0, 0), inertia=np.eye(3).tolist()),
    "derivation.derive": row(table=pm.dh.LECTURE_TABLE),
    "derivation.RollerWheel": row(x=0.2, y=0.1, angle=0.1, roller=0.7),
    "derivation.Numeric.mass_matrix": row(q=Q, params=partial(lambda: dict(PARAMS))),
    "closed_form.differential_drive": row(nu=[0.4, 0.5], **BODY, track=0.5, radius=0.1),
    "plots.path": row(rollouts=the("rollout"), title="a title", width=6.0),
    "plots.curves": row(
        48, values={"a": [1, 2]}, x=("a", "m", [1, 2]), label="b", title="a title", ax=None, width=6.0
    ),
    "plots.heatmap": row(
        24,
        **{"values": [[1, 2], [3, 4]], "x": ("a", "m", [1, 2]), "y": ("b", "m", [1, 2]), "label": "c"},
        **{"title": "a title", "ax": None, "width": 6.0},
    ),
    "plots.animate": row(
        rollouts=the("rollout"), path=partial(lambda: WORLD.folder / "a.gif"), fps=2, speed=2
    ),
    "plots.bands": row(ensembles=the("ensemble"), title="a title", width=6.0),
    "plots.signals": row(rollouts=the("told"), title="a title", width=6.0),
    "AckermannSteering": row(wheels=("front_left", "front_right")),
    "DifferentialGear": row(wheels=("left", "right")),
    "GearTrain": row(wheels=("left", "right")),
    "Motor.torque": row(volts=[1, 2], rate=3),
    "Motor.from_sheet": row(voltage=12.0, stall_torque=2.0, stall_current=5.0, no_load_rate=20.0),
    "Wheel": row(name="left", x=0, y=0.2, radius=0.1),
    "WheelTable": row(wheels=[pm.wheels.Wheel("left", 0, 0.2, 0.1), pm.wheels.Wheel("right", 0, -0.2, 0.1)]),
    "WheelTable.car": row(wheelbase=0.6, track=0.4, radius=0.1, mass=1),
    "WheelTable.differential": row(track=0.4, radius=0.1, motor=pm.Motor(), mass=1),
    "WheelTable.mecanum": row(wheelbase=0.6, track=0.4, radius=0.1, motor=pm.Motor(), mass=1),
    "WheelTable.omni": row(distance=0.3, radius=0.1, motor=pm.Motor(), mass=1),
    "WheelTable.skid_steer": row(wheelbase=0.6, track=0.4, radius=0.1, motor=pm.Motor(), mass=1),
    "WheelTable.swerve": row(places=[(0.3, 0.1), (-0.3, -0.1)], radius=0.1, motor=pm.Motor(), mass=1),
    "WheeledRobot": row(robot=the("base"), table=the("differential")),
    "WheeledRobot.from_urdf": row(24, path=the("turtlebot"), rollers={}, supports=[(-0.08, 0)]),
    "WheeledRobot.mount": row(24, arm=the("arm"), name="arm"),
    "WheeledRobot.forward_dynamics": row(q=FIVE, v=FIVE, u=[1, 2]),
    "WheeledRobot.odometry": row(rates=[1, 2]),
    "WheeledRobot.allocate": row(q=FIVE, tau=A),
    "WheeledRobot.on_ramp": row(angle=0.1),
    "wheels.ByVoltage.forward_dynamics": row(q=FIVE, v=FIVE, u=[1, 2]),
    "viewer.Arrows": row(),
    "viewer.Follow": row(),
    "viewer.FixedCamera": row(),
    "viewer.Overlays": row(),
    "viewer.Viewer": row(16, plant=the("robot")),
    "viewer.Viewer.display": row(q=Q),
    "viewer.Viewer.record": row(rollout=the("rollout"), fps=5),
    "viewer.Recording.save_html": row(path=partial(lambda: WORLD.folder / "a.html")),
    **{f"MobileRobot.{name}": row(**named) for name, named in STATES.items()},
    **{
        f"closed_form.{name}": row(
            **named, **{k: v for k, v in BODY.items() if k != "yaw_inertia" or name not in MASSLESS}
        )
        for name, named in STATES.items()
    },
}

# Objects whose methods are called, by the class.
OWNERS: dict[str, Callable[[], Any]] = {
    "Circle": lambda: WORLD.path,
    "Tangent": lambda: WORLD.trajectory,
    "PosePath": lambda: WORLD.target,
    "Ensemble": lambda: WORLD.ensemble,
    "Sweep": lambda: WORLD.sweep,
    "MobileRobot": lambda: WORLD.robot,
    "Motor": lambda: pm.Motor(**MOTOR),
    "WheelTable": lambda: WheelTable,
    "WheeledRobot": lambda: WORLD.wheeled,
    "wheels.ByVoltage": lambda: WORLD.electric.by_voltage(),
    "Log": lambda: WORLD.log,
    "Identification": lambda: WORLD.identified,
    "Rollout": lambda: WORLD.rollout,
    "DHTable": lambda: pm.dh.LECTURE_TABLE,
    "derivation.Numeric": lambda: WORLD.numeric,
    "viewer.Viewer": _viewer,
    "viewer.Recording": lambda: WORLD.recording,
}
# Those that take arguments by position alone.
CALLED: dict[str, Callable[..., Any]] = {
    "WholeBody": lambda robot, base, joints: pm.WholeBody(robot, base, joints)
}


def resolved(name: str) -> Callable[..., Any]:
    """Return what a row is of, bound to an object where it is a method."""
    if name in CALLED:
        return CALLED[name]
    owner, _, method = name.rpartition(".")
    if owner in OWNERS:
        return getattr(OWNERS[owner](), method)  # type: ignore[no-any-return]
    if not owner and not hasattr(pm, method):  # a part of a package
        owner = next(module for module in pm._NAMES if hasattr(getattr(pm, module), method))
    return getattr(importlib.import_module(f"pinmobile.{owner}".rstrip(".")), method)  # type: ignore[no-any-return]


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
        function(**arguments)
    except PinmobileError as error:
        return "" if len(str(error)) < 20_000 else f"a message of {len(str(error))} letters"
    except TooLong:
        return f"more than {SECONDS} s"
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)
        ours = [frame for frame in place if "pinmobile" in frame.filename] or place
        where = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}"
        return f"{type(error).__name__} at {where}: {str(error)[:160]}"
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
    changed = [name for name, value in arguments.items() if _remembered(value) != before[name]]
    return f"{', '.join(changed)} was written into" if changed else ""


def trials(name: str) -> Iterator[tuple[str, str, str]]:
    """Yield argument, kind and what is wrong, for each wrong value of a callable, or one of so many."""
    line, function = ROWS[name], resolved(name)
    valid = line.given(function)
    try:
        function(**valid)
    except Exception as error:
        yield "", "valid", f"{type(error).__name__}: {error}\n{traceback.format_exc()}"
    pairs = [(argument, kind) for argument in valid for kind in KINDS]
    most = line.tries or TRIES
    if most < len(pairs):
        pairs = Random(SEED + crc32(name.encode())).sample(pairs, most)
    for argument, kind in pairs:
        yield argument, kind, attempt(function, line.given(function) | {argument: KINDS[kind]()})


def main(names: list[str]) -> None:
    """Run the trials of callables, and print as JSON what was wrong with each."""
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
    for name in names:
        wrong = [f"{argument} = {kind}: {what}" for argument, kind, what in trials(name) if what]
        print(json.dumps({"name": name, "wrong": wrong}), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
