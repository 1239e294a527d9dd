"""Dynamics and control of ground robots on Pinocchio.

What needs sympy, matplotlib or meshcat is loaded when it is asked for: `verify`, and the modules
`derivation`, `verification`, `plots` and `viewer`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from pinmobile.controllers import PD, ComputedTorque, law, planar_difference
from pinmobile.dh import LECTURE_TABLE, SLIDE_TABLE, DHRow, DHTable, JointType
from pinmobile.errors import Diverged, InvalidArgument, PinmobileError, UnknownName, ViewerError
from pinmobile.integrators import constant_acceleration, rk4, semi_implicit_euler
from pinmobile.paths import Circle, CubicVia, Lissajous, Spline
from pinmobile.robot import Load, MobileRobot, mountable
from pinmobile.simulation import Rollout, simulate
from pinmobile.trajectories import FixedHeading, LectureHeading, Reference, Tangent
from pinmobile.urdf import shipped_urdf

if TYPE_CHECKING:
    from pinmobile.verification import verify

__version__ = "0.1.0"

__all__ = [
    "LECTURE_TABLE",
    "PD",
    "SLIDE_TABLE",
    "Circle",
    "ComputedTorque",
    "CubicVia",
    "DHRow",
    "DHTable",
    "Diverged",
    "FixedHeading",
    "InvalidArgument",
    "JointType",
    "LectureHeading",
    "Lissajous",
    "Load",
    "MobileRobot",
    "PinmobileError",
    "Reference",
    "Rollout",
    "Spline",
    "Tangent",
    "UnknownName",
    "ViewerError",
    "constant_acceleration",
    "law",
    "mountable",
    "planar_difference",
    "rk4",
    "semi_implicit_euler",
    "shipped_urdf",
    "simulate",
    "verify",
]

_LAZY_MODULES = ("derivation", "plots", "verification", "viewer")


def __getattr__(name: str) -> Any:
    if name == "verify":
        return import_module("pinmobile.verification").verify
    if name in _LAZY_MODULES:
        return import_module(f"pinmobile.{name}")
    raise AttributeError(f"module 'pinmobile' has no attribute {name!r}")
