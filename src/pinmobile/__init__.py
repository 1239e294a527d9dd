"""Dynamics and control of ground robots on Pinocchio.

What only some need, and all that needs sympy, matplotlib, meshcat or numba, is loaded when it is asked for.
"""

from difflib import get_close_matches
from importlib import import_module
from typing import TYPE_CHECKING, Any

from pinmobile.controllers import (
    PD,
    ComputedTorque,
    Decoupled,
    Delayed,
    NoisyMeasurement,
    PDGravity,
    Saturated,
    difference_of,
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
    FileError,
    InvalidArgument,
    PinmobileError,
    SchedulerError,
    UnknownName,
    Unreachable,
    ViewerError,
)
from pinmobile.integrators import constant_acceleration, rk4, semi_implicit_euler
from pinmobile.paths import Circle, CubicVia, Hold, Lissajous, RestToRest, Spline
from pinmobile.robot import Load, MobileRobot, mountable
from pinmobile.simulation import Rollout, simulate
from pinmobile.trajectories import FixedHeading, LectureHeading, Reference, Tangent, WholeBody
from pinmobile.urdf import shipped_urdf

if TYPE_CHECKING:
    from pinmobile.accuracy import integrator_report
    from pinmobile.balance import (
        Motion,
        reaction_wrench,
        required_friction,
        tip_over_margin,
        zero_moment_point,
    )
    from pinmobile.ensembles import TRUE_MODEL, Ensemble, Normal, Same, Scenario, Uniform, ensemble
    from pinmobile.reaching import EndEffectorTracking, PosePath, Resolved, resolve
    from pinmobile.sweeps import Axis, Sweep, grid, sweep
    from pinmobile.verification import verify

__version__ = "0.1.0"

__all__ = [
    "LECTURE_TABLE",
    "PD",
    "SLIDE_TABLE",
    "TRUE_MODEL",
    "Axis",
    "Circle",
    "ComputedTorque",
    "ConstantForce",
    "CubicVia",
    "DHRow",
    "DHTable",
    "Decoupled",
    "Delayed",
    "Diverged",
    "EndEffectorTracking",
    "Ensemble",
    "FileError",
    "FixedHeading",
    "Hold",
    "InvalidArgument",
    "JointType",
    "LectureHeading",
    "Lissajous",
    "Load",
    "MobileRobot",
    "Motion",
    "NoiseForce",
    "NoisyMeasurement",
    "Normal",
    "PDGravity",
    "PinmobileError",
    "PosePath",
    "Reference",
    "Resolved",
    "RestToRest",
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
    "Unreachable",
    "ViewerError",
    "ViscousFriction",
    "WholeBody",
    "constant_acceleration",
    "difference_of",
    "ensemble",
    "grid",
    "integrator_report",
    "law",
    "mountable",
    "planar_difference",
    "reaction_wrench",
    "required_friction",
    "resolve",
    "rk4",
    "semi_implicit_euler",
    "shipped_urdf",
    "simulate",
    "sweep",
    "tip_over_margin",
    "verify",
    "zero_moment_point",
]

_LAZY_MODULES = (
    "accuracy",
    "balance",
    "derivation",
    "ensembles",
    "plots",
    "reaching",
    "sweeps",
    "verification",
    "viewer",
)
_LAZY_NAMES = {
    name: module
    for module, names in {
        "accuracy": ("integrator_report",),
        "balance": (
            "Motion",
            "reaction_wrench",
            "required_friction",
            "tip_over_margin",
            "zero_moment_point",
        ),
        "ensembles": ("TRUE_MODEL", "Ensemble", "Normal", "Same", "Scenario", "Uniform", "ensemble"),
        "reaching": ("EndEffectorTracking", "PosePath", "Resolved", "resolve"),
        "sweeps": ("Axis", "Sweep", "grid", "sweep"),
        "verification": ("verify",),
    }.items()
    for name in names
}


def __getattr__(name: str) -> Any:
    if name in _LAZY_NAMES:
        return getattr(import_module(f"pinmobile.{_LAZY_NAMES[name]}"), name)
    if name in _LAZY_MODULES:
        return import_module(f"pinmobile.{name}")
    near = [] if name.startswith("_") else get_close_matches(name, __dir__(), n=1)
    meant = f", did you mean {near[0]!r}?" if near else ""
    raise AttributeError(f"module 'pinmobile' has no attribute {name!r}{meant}")


def __dir__() -> list[str]:
    mine = {"Any", "TYPE_CHECKING", "get_close_matches", "import_module"}
    return sorted({*globals(), *_LAZY_NAMES, *_LAZY_MODULES} - mine)
