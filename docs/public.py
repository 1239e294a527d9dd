"""The public names of the library, topic by topic: the reference of the site has a page for each."""

import importlib

import pinmobile

__all__ = ["TOPICS", "find", "public", "spelled"]

# Each topic of the reference: its title and its modules.
TOPICS = {
    "robots": ("Robots", ["robot", "urdf", "dh"]),
    "wheels": ("Wheels, drives and motors", ["wheels"]),
    "trajectories": ("Paths, headings and trajectories", ["paths", "trajectories"]),
    "controllers": ("Controllers", ["controllers"]),
    "reaching": ("End effectors and clearance", ["reaching", "proximity"]),
    "forces": ("External forces", ["forces"]),
    "simulation": ("Simulation, ensembles and scenarios", ["loop", "integrators", "accuracy", "metrics"]),
    "sweeps": ("Sweeps", ["sweeps"]),
    "balance": ("Balance and contact", ["balance"]),
    "identification": ("Identification", ["identification"]),
    "derivation": ("Derivation and verification", ["derivation", "closed_form", "verification"]),
    "exercises": ("Exercises", ["exercises"]),
    "derivatives": ("Derivatives", ["derivatives"]),
    "realtime": ("Real time and export to C", ["realtime", "export"]),
    "plots": ("Figures", ["plots"]),
    "viewer": ("Viewer", ["viewer"]),
    "parts": ("User-defined parts", ["parts", "plant", "compiled"]),
    "errors": ("Errors and warnings", ["errors"]),
}


# A single file has no `__all__`: these of its names are public.
OF_FILES = {
    "accuracy": "Convergence IntegratorReport integrator_report",
    "balance": (
        "MotionStates reaction_wrench zero_moment_point body_zero_moment_point tip_over_margin "
        "contact_loads slip_margins MotionLimit max_path_speed max_slope required_friction"
    ),
    "closed_form": (
        "mass_matrix coriolis_matrix nonlinear_effects inverse_dynamics forward_dynamics ReducedModel "
        "differential_drive roller_drive car"
    ),
    "dh": "JointType DHRow DHTable LECTURE_TABLE SLIDE_TABLE transform",
    "errors": (
        "PinmobileError InvalidArgument UnknownName NotFinite NotTraceable Diverged NotSolved Unreachable "
        "FileError ViewerError SchedulerError SlowerEngine LimitWarning"
    ),
    "forces": (
        "Force ConstantForce SinusoidalForce NoiseForce PayloadForce ViscousFriction RollingResistance "
        "JointFriction"
    ),
    "integrators": "Integrator RungeKuttaNystrom constant_acceleration semi_implicit_euler rk4",
    "metrics": "Metric",
    "plant": "Plant Context Coordinate Input Step ContactLoads SlipMargins TorqueMargins",
    "proximity": "Clearance clearance",
    "urdf": "shipped_urdf Body box_inertia write",
}


def public(module: str) -> list[str]:
    """Return the public names of a module."""
    if module in OF_FILES:
        return OF_FILES[module].split()
    return list(importlib.import_module(f"pinmobile.{module}").__all__)


def spelled(module: str, name: str) -> str:
    """Return the shortest spelling of a public name after ``pinmobile.``."""
    return name if name in pinmobile.__all__ else f"{module}.{name}"


def find() -> dict[str, object]:
    """Return all public objects by their shortest spelling after ``pinmobile.``."""
    modules = [module for _, each in TOPICS.values() for module in each]
    return {
        spelled(module, name): getattr(importlib.import_module(f"pinmobile.{module}"), name)
        for module in modules
        for name in public(module)
    }
