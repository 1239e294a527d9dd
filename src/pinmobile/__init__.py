"""Dynamics and control of ground robots on Pinocchio.

Importing it loads a module of its own, and numpy and Pinocchio with it, when a name of that is first used.
"""

import pathlib
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING

# At once: whoever lacks Pinocchio is told by the import, not in the middle of a program.
_spec = find_spec("pinocchio")
_folders = (_spec.submodule_search_locations if _spec is not None else None) or ()
if not any(list(pathlib.Path(folder).glob("*pywrap*")) for folder in _folders):
    raise ImportError(
        f"{'No' if _spec is None else 'Another'} module is named 'pinocchio': pinmobile needs Pinocchio, "
        "whose package on PyPI is pin: pip install pin (pinocchio there is another project: uninstall it "
        "first)"
    )

if TYPE_CHECKING:
    from pinmobile.accuracy import *
    from pinmobile.balance import *
    from pinmobile.compiled import *
    from pinmobile.controllers import *
    from pinmobile.dh import *
    from pinmobile.errors import *
    from pinmobile.forces import *
    from pinmobile.identification import *
    from pinmobile.integrators import *
    from pinmobile.loop import *
    from pinmobile.paths import *
    from pinmobile.plant import *
    from pinmobile.proximity import *
    from pinmobile.reaching import *
    from pinmobile.robot import *
    from pinmobile.sweeps import *
    from pinmobile.trajectories import *
    from pinmobile.urdf import *
    from pinmobile.verification import *
    from pinmobile.wheels import *

__version__ = "0.2.0"

# Each module with the names that it gives to this one; others are imported by their own name.
_NAMES = {
    name: tuple(names.split())
    for name, names in {
        "accuracy": "integrator_report",
        "arrays": "",
        "balance": (
            "Limit Motion contact_loads fastest reaction_wrench required_friction slip_margins "
            "steepest tip_over_margin zero_moment_point"
        ),
        "closed_form": "",
        "compiled": "vectorize",
        "controllers": (
            "PD Allocated Backstepping ComputedTorque Decoupled Delayed Driven DynamicFeedback "
            "Kanayama NoisyMeasurement PDGravity ADRC LQR MPC PID Adaptive AdaptiveVelocity "
            "DisturbanceObserver SlidingMode SuperTwisting Parking RandomSteps Saturated "
            "SwerveTracking Tracking VelocityCommand WheelSpeed law plain_difference "
            "planar_difference"
        ),
        "derivation": "",
        "dh": "LECTURE_TABLE SLIDE_TABLE DHRow DHTable JointType",
        "divergence": "",
        "errors": (
            "Diverged FileError InvalidArgument NotFinite NotSolved NotTraceable PinmobileError "
            "SchedulerError UnknownName Unreachable ViewerError"
        ),
        "extras": "",
        "files": "",
        "forces": (
            "ConstantForce JointFriction NoiseForce Payload RollingResistance SinusoidalForce ViscousFriction"
        ),
        "identification": "Identification Log VelocityRobot excitation identify identify_velocity",
        "integrators": "constant_acceleration rk4 semi_implicit_euler",
        "loop": (
            "COMPILED PYTHON TRUE_MODEL EndEffector Engine Ensemble Normal Relative Rollout Same "
            "Scenario Uniform ensemble simulate"
        ),
        "measures": "",
        "palette": "",
        "parts": "",
        "paths": ("Circle CompositePath CubicVia Hold Line Lissajous Moved Polyline RestToRest Spline"),
        "plant": "Context",
        "plots": "",
        "proximity": "Clearance clearance",
        "reaching": "EndEffectorTracking PosePath Resolved resolve",
        "robot": "Load MobileRobot mountable",
        "signals": "",
        "sweeps": "Sweep sweep",
        "trajectories": "FixedHeading LectureHeading Reference Tangent WholeBody",
        "urdf": "shipped_urdf",
        "verification": "verify",
        "viewer": "",
        "wheels": (
            "Ackermann ByOdometry Coulomb Differential Friction GearTrain Motor Ramp Rolling Support "
            "Wheel WheelTable WheeledRobot"
        ),
    }.items()
}
_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names}
__all__ = sorted(_MODULE_OF)

if not TYPE_CHECKING:  # a type checker knows all names by the above, and reports others

    def __getattr__(name: str) -> object:
        if name in _NAMES:
            return import_module(f"pinmobile.{name}")
        if name in _MODULE_OF:
            value = getattr(import_module(f"pinmobile.{_MODULE_OF[name]}"), name)
            globals()[name] = value  # found without this function from now on
            return value
        from difflib import get_close_matches

        near = [] if name.startswith("_") else get_close_matches(name, __dir__(), n=1)
        meant = f", did you mean {near[0]!r}?" if near else ""
        raise AttributeError(f"module 'pinmobile' has no attribute {name!r}{meant}")


def __dir__() -> list[str]:
    return sorted({*_NAMES, *_MODULE_OF, *(name for name in globals() if name.startswith("__"))})
