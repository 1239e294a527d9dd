"""Dynamics and control of ground robots on Pinocchio.

The import loads neither NumPy nor Pinocchio. It loads a module of this package, and the libraries that the
module needs, when code first uses a name of the module.
"""

import pathlib
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING

# The import itself checks for Pinocchio, so that a program does not fail halfway.
_spec = find_spec("pinocchio")
_folders = (_spec.submodule_search_locations if _spec is not None else None) or ()
if not any(list(pathlib.Path(folder).glob("*pywrap*")) for folder in _folders):
    raise ImportError(
        f"{'No' if _spec is None else 'Another'} module is named 'pinocchio': pinmobile needs Pinocchio, "
        "whose package on PyPI is pin: pip install pin (pinocchio on PyPI is another project: uninstall it "
        "first)"
    )

if TYPE_CHECKING:
    from pinmobile import (
        accuracy as accuracy,
        balance as balance,
        derivatives as derivatives,
        dh as dh,
        export as export,
        plant as plant,
        urdf as urdf,
    )
    from pinmobile.compiled import *
    from pinmobile.controllers import *
    from pinmobile.errors import *
    from pinmobile.forces import *
    from pinmobile.identification import *
    from pinmobile.integrators import *
    from pinmobile.loop import *
    from pinmobile.paths import *
    from pinmobile.proximity import *
    from pinmobile.reaching import *
    from pinmobile.robot import *
    from pinmobile.sweeps import *
    from pinmobile.trajectories import *
    from pinmobile.verification import *
    from pinmobile.wheels import *

__version__ = "0.2.0"

# Each module with the names that the top level exports. Import all other names from their module.
_NAMES = {
    name: tuple(names.split())
    for name, names in {
        "compiled": "vectorize",
        "controllers": (
            "PD ControlAllocation Backstepping ComputedTorque MeasurementDelay MeasurementNoise "
            "PDGravity ADRC LQR MPC PID Adaptive DisturbanceObserver SlidingMode SuperTwisting "
            "InputSaturation UnicycleTracking law"
        ),
        "errors": "Diverged InvalidArgument PinmobileError",
        "forces": "ConstantForce JointFriction RollingResistance ViscousFriction",
        "identification": "Log VelocityRobot excitation identify identify_velocity",
        "integrators": "rk4",
        "loop": (
            "Engine Ensemble Loop Normal PayloadTransfer Relative Rollout SameAs Scenario Uniform ensemble "
            "simulate"
        ),
        "paths": "Circle CompositePath CubicVia Hold Line Lissajous Polyline RestToRest Spline",
        "proximity": "clearance",
        "reaching": "EndEffectorTracking FrameTask PosePath solve_inverse_kinematics",
        "robot": "PayloadBody MobileRobot",
        "sweeps": "Sweep sweep",
        "trajectories": "FixedHeading Reference Tangent WholeBody",
        "verification": "verify",
        "wheels": "Coulomb Motor Rolling WheelTable WheeledRobot",
    }.items()
} | dict.fromkeys(
    (
        *("accuracy", "arrays", "balance", "closed_form", "derivation", "derivatives", "dh"),
        *("exercises", "export", "files", "metrics", "palette", "parts", "plant", "plots"),
        *("realtime", "signals", "urdf", "viewer"),
    ),
    (),
)
_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names}
__all__ = sorted(_MODULE_OF)

if not TYPE_CHECKING:  # a type checker knows all names from the imports above, and reports others

    def __getattr__(name: str) -> object:
        if name in _NAMES:
            return import_module(f"pinmobile.{name}")
        if name in _MODULE_OF:
            value = getattr(import_module(f"pinmobile.{_MODULE_OF[name]}"), name)
            globals()[name] = value  # the next access does not call this function
            return value
        from difflib import get_close_matches

        near = [] if name.startswith("_") else get_close_matches(name, __dir__(), n=1)
        meant = f", did you mean {near[0]!r}?" if near else ""
        raise AttributeError(f"module 'pinmobile' has no attribute {name!r}{meant}")


def __dir__() -> list[str]:
    return sorted({*_NAMES, *_MODULE_OF, *(name for name in globals() if name.startswith("__"))})
