"""Dynamics and control of ground robots on Pinocchio.

What only some need, and all that needs sympy, matplotlib, meshcat or numba, is loaded when it is asked for.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from pinmobile.controllers import (
    PD,
    ComputedTorque,
    Delayed,
    NoisyMeasurement,
    Saturated,
    law,
    planar_difference,
)
from pinmobile.dh import LECTURE_TABLE, SLIDE_TABLE, DHRow, DHTable, JointType
from pinmobile.disturbances import (
    ConstantForce,
    NoiseForce,
    RollingResistance,
    SinusoidalForce,
    ViscousFriction,
)
from pinmobile.errors import (
    Diverged,
    InvalidArgument,
    PinmobileError,
    SchedulerError,
    UnknownName,
    ViewerError,
)
from pinmobile.integrators import constant_acceleration, rk4, semi_implicit_euler
from pinmobile.paths import Circle, CubicVia, Lissajous, Spline
from pinmobile.robot import MobileRobot
from pinmobile.simulation import Rollout, simulate
from pinmobile.trajectories import FixedHeading, LectureHeading, Reference, Tangent
from pinmobile.urdf import shipped_urdf

if TYPE_CHECKING:
    from pinmobile.ensembles import Ensemble, Normal, Same, Scenario, Uniform, ensemble
    from pinmobile.sweeps import Axis, Sweep, grid, sweep
    from pinmobile.verification import verify

__version__ = "0.1.0"

__all__ = [
    "LECTURE_TABLE",
    "PD",
    "SLIDE_TABLE",
    "Axis",
    "Circle",
    "ComputedTorque",
    "ConstantForce",
    "CubicVia",
    "DHRow",
    "DHTable",
    "Delayed",
    "Diverged",
    "Ensemble",
    "FixedHeading",
    "InvalidArgument",
    "JointType",
    "LectureHeading",
    "Lissajous",
    "MobileRobot",
    "NoiseForce",
    "NoisyMeasurement",
    "Normal",
    "PinmobileError",
    "Reference",
    "RollingResistance",
    "Rollout",
    "Same",
    "Saturated",
    "Scenario",
    "SchedulerError",
    "SinusoidalForce",
    "Spline",
    "Sweep",
    "Tangent",
    "Uniform",
    "UnknownName",
    "ViewerError",
    "ViscousFriction",
    "constant_acceleration",
    "ensemble",
    "grid",
    "law",
    "planar_difference",
    "rk4",
    "semi_implicit_euler",
    "shipped_urdf",
    "simulate",
    "sweep",
    "verify",
]

_LAZY_MODULES = ("derivation", "ensembles", "plots", "sweeps", "verification", "viewer")
_LAZY_NAMES = {
    **dict.fromkeys(("Ensemble", "Normal", "Same", "Scenario", "Uniform", "ensemble"), "ensembles"),
    **dict.fromkeys(("Axis", "Sweep", "grid", "sweep"), "sweeps"),
    "verify": "verification",
}


def __getattr__(name: str) -> Any:
    if name in _LAZY_NAMES:
        return getattr(import_module(f"pinmobile.{_LAZY_NAMES[name]}"), name)
    if name in _LAZY_MODULES:
        return import_module(f"pinmobile.{name}")
    raise AttributeError(f"module 'pinmobile' has no attribute {name!r}")
