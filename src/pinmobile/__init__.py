"""Dynamics and control of ground robots on Pinocchio.

Importing it loads Pinocchio, and numpy with it; a module of its own when a name of that is first used.
"""

import sys

try:  # Ctrl-C ends the command here as it does later; typing takes long
    from importlib import import_module
    from typing import TYPE_CHECKING

    # At once: whoever lacks it is told by the import, not in the middle of a program.
    from pinocchio import Model
except ImportError as error:
    raise ImportError(
        f"{error}: pinmobile needs Pinocchio, whose package on PyPI is pin: pip install pin "
        "(pinocchio there is another project: uninstall it first)"
    ) from error
except KeyboardInterrupt:
    first = sys.argv[0] if sys.argv else ""
    if not (first.endswith("/pinmobile") or (first == "-m" and "pinmobile" in sys.orig_argv)):
        raise
    sys.stderr.write("pinmobile: interrupted\n")  # the command ends as it does everywhere else
    raise SystemExit(130) from None
del Model

if TYPE_CHECKING:
    from pinmobile.accuracy import integrator_report
    from pinmobile.balance import (
        Limit,
        Motion,
        contact_loads,
        fastest,
        reaction_wrench,
        required_friction,
        slip_margins,
        steepest,
        tip_over_margin,
        zero_moment_point,
    )
    from pinmobile.benchmarking import Benchmark, BenchmarkScenario, benchmark
    from pinmobile.compiled import vectorize
    from pinmobile.controllers import (
        ADRC,
        LQR,
        MPC,
        PD,
        PID,
        Adaptive,
        AdaptiveVelocity,
        Allocated,
        Backstepping,
        ComputedTorque,
        Decoupled,
        Delayed,
        DisturbanceObserver,
        Driven,
        DynamicFeedback,
        Kanayama,
        NoisyMeasurement,
        Parking,
        PDGravity,
        RandomSteps,
        Saturated,
        SlidingMode,
        SuperTwisting,
        SwerveTracking,
        Tracking,
        VelocityCommand,
        WheelSpeed,
        law,
        plain_difference,
        planar_difference,
    )
    from pinmobile.dh import LECTURE_TABLE, SLIDE_TABLE, DHRow, DHTable, JointType
    from pinmobile.errors import (
        Diverged,
        FileError,
        InvalidArgument,
        NotFinite,
        NotSolved,
        NotTraceable,
        PinmobileError,
        SchedulerError,
        UnknownName,
        Unreachable,
        ViewerError,
    )
    from pinmobile.forces import (
        ConstantForce,
        JointFriction,
        NoiseForce,
        Payload,
        RollingResistance,
        SinusoidalForce,
        ViscousFriction,
    )
    from pinmobile.identification import (
        Identification,
        Log,
        VelocityRobot,
        excitation,
        identify,
        identify_velocity,
    )
    from pinmobile.integrators import constant_acceleration, rk4, semi_implicit_euler
    from pinmobile.loop import (
        COMPILED,
        PYTHON,
        TRUE_MODEL,
        EndEffector,
        Engine,
        Ensemble,
        Normal,
        Relative,
        Rollout,
        Same,
        Scenario,
        Uniform,
        ensemble,
        simulate,
    )
    from pinmobile.paths import (
        Circle,
        CompositePath,
        CubicVia,
        Hold,
        Line,
        Lissajous,
        Moved,
        Polyline,
        RestToRest,
        Spline,
    )
    from pinmobile.plant import Context
    from pinmobile.proximity import Clearance, clearance
    from pinmobile.reaching import EndEffectorTracking, PosePath, Resolved, resolve
    from pinmobile.robot import Load, MobileRobot, mountable
    from pinmobile.sweeps import Axis, Sweep, grid, sweep
    from pinmobile.trajectories import FixedHeading, LectureHeading, Reference, Tangent, WholeBody
    from pinmobile.urdf import shipped_urdf
    from pinmobile.verification import verify
    from pinmobile.wheels import (
        Ackermann,
        ByOdometry,
        Coulomb,
        Differential,
        Friction,
        GearTrain,
        Motor,
        Ramp,
        Rolling,
        Support,
        Wheel,
        WheeledRobot,
        WheelTable,
    )

__version__ = "0.2.0"

__all__ = [
    "ADRC",
    "COMPILED",
    "LECTURE_TABLE",
    "LQR",
    "MPC",
    "PD",
    "PID",
    "PYTHON",
    "SLIDE_TABLE",
    "TRUE_MODEL",
    "Ackermann",
    "Adaptive",
    "AdaptiveVelocity",
    "Allocated",
    "Axis",
    "Backstepping",
    "Benchmark",
    "BenchmarkScenario",
    "ByOdometry",
    "Circle",
    "Clearance",
    "CompositePath",
    "ComputedTorque",
    "ConstantForce",
    "Context",
    "Coulomb",
    "CubicVia",
    "DHRow",
    "DHTable",
    "Decoupled",
    "Delayed",
    "Differential",
    "DisturbanceObserver",
    "Diverged",
    "Driven",
    "DynamicFeedback",
    "EndEffector",
    "EndEffectorTracking",
    "Engine",
    "Ensemble",
    "FileError",
    "FixedHeading",
    "Friction",
    "GearTrain",
    "Hold",
    "Identification",
    "InvalidArgument",
    "JointFriction",
    "JointType",
    "Kanayama",
    "LectureHeading",
    "Limit",
    "Line",
    "Lissajous",
    "Load",
    "Log",
    "MobileRobot",
    "Motion",
    "Motor",
    "Moved",
    "NoiseForce",
    "NoisyMeasurement",
    "Normal",
    "NotFinite",
    "NotSolved",
    "NotTraceable",
    "PDGravity",
    "Parking",
    "Payload",
    "PinmobileError",
    "Polyline",
    "PosePath",
    "Ramp",
    "RandomSteps",
    "Reference",
    "Relative",
    "Resolved",
    "RestToRest",
    "Rolling",
    "RollingResistance",
    "Rollout",
    "Same",
    "Saturated",
    "Scenario",
    "SchedulerError",
    "SinusoidalForce",
    "SlidingMode",
    "Spline",
    "SuperTwisting",
    "Support",
    "Sweep",
    "SwerveTracking",
    "Tangent",
    "Tracking",
    "Uniform",
    "UnknownName",
    "Unreachable",
    "VelocityCommand",
    "VelocityRobot",
    "ViewerError",
    "ViscousFriction",
    "Wheel",
    "WheelSpeed",
    "WheelTable",
    "WheeledRobot",
    "WholeBody",
    "benchmark",
    "clearance",
    "constant_acceleration",
    "contact_loads",
    "ensemble",
    "excitation",
    "fastest",
    "grid",
    "identify",
    "identify_velocity",
    "integrator_report",
    "law",
    "mountable",
    "plain_difference",
    "planar_difference",
    "reaction_wrench",
    "required_friction",
    "resolve",
    "rk4",
    "semi_implicit_euler",
    "shipped_urdf",
    "simulate",
    "slip_margins",
    "steepest",
    "sweep",
    "tip_over_margin",
    "vectorize",
    "verify",
    "zero_moment_point",
]

# The modules that are found in the package, and the names of each that the package has too.
_NAMES: dict[str, tuple[str, ...]] = {
    "accuracy": ("integrator_report",),
    "arrays": (),
    "balance": (
        "Limit",
        "Motion",
        "contact_loads",
        "fastest",
        "reaction_wrench",
        "required_friction",
        "slip_margins",
        "steepest",
        "tip_over_margin",
        "zero_moment_point",
    ),
    "benchmarking": ("Benchmark", "BenchmarkScenario", "benchmark"),
    "closed_form": (),
    "compiled": ("vectorize",),
    "controllers": (
        "PD",
        "Allocated",
        "Backstepping",
        "ComputedTorque",
        "Decoupled",
        "Delayed",
        "Driven",
        "DynamicFeedback",
        "Kanayama",
        "NoisyMeasurement",
        "PDGravity",
        "ADRC",
        "LQR",
        "MPC",
        "PID",
        "Adaptive",
        "AdaptiveVelocity",
        "DisturbanceObserver",
        "SlidingMode",
        "SuperTwisting",
        "Parking",
        "RandomSteps",
        "Saturated",
        "SwerveTracking",
        "Tracking",
        "VelocityCommand",
        "WheelSpeed",
        "law",
        "plain_difference",
        "planar_difference",
    ),
    "derivation": (),
    "dh": ("LECTURE_TABLE", "SLIDE_TABLE", "DHRow", "DHTable", "JointType"),
    "divergence": (),
    "errors": (
        "Diverged",
        "FileError",
        "InvalidArgument",
        "NotFinite",
        "NotSolved",
        "NotTraceable",
        "PinmobileError",
        "SchedulerError",
        "UnknownName",
        "Unreachable",
        "ViewerError",
    ),
    "extras": (),
    "files": (),
    "forces": (
        "ConstantForce",
        "JointFriction",
        "NoiseForce",
        "Payload",
        "RollingResistance",
        "SinusoidalForce",
        "ViscousFriction",
    ),
    "identification": (
        "Identification",
        "Log",
        "VelocityRobot",
        "excitation",
        "identify",
        "identify_velocity",
    ),
    "integrators": ("constant_acceleration", "rk4", "semi_implicit_euler"),
    "loop": (
        "COMPILED",
        "PYTHON",
        "TRUE_MODEL",
        "EndEffector",
        "Engine",
        "Ensemble",
        "Normal",
        "Relative",
        "Rollout",
        "Same",
        "Scenario",
        "Uniform",
        "ensemble",
        "simulate",
    ),
    "measures": (),
    "palette": (),
    "paths": (
        "Circle",
        "CompositePath",
        "CubicVia",
        "Hold",
        "Line",
        "Lissajous",
        "Moved",
        "Polyline",
        "RestToRest",
        "Spline",
    ),
    "plant": ("Context",),
    "plots": (),
    "proximity": ("Clearance", "clearance"),
    "reaching": ("EndEffectorTracking", "PosePath", "Resolved", "resolve"),
    "robot": ("Load", "MobileRobot", "mountable"),
    "signals": (),
    "sweeps": ("Axis", "Sweep", "grid", "sweep"),
    "trajectories": ("FixedHeading", "LectureHeading", "Reference", "Tangent", "WholeBody"),
    "urdf": ("shipped_urdf",),
    "verification": ("verify",),
    "viewer": (),
    "wheels": (
        "Ackermann",
        "ByOdometry",
        "Coulomb",
        "Differential",
        "Friction",
        "GearTrain",
        "Motor",
        "Ramp",
        "Rolling",
        "Support",
        "Wheel",
        "WheelTable",
        "WheeledRobot",
    ),
}
_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names}

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
