"""What may differ from robot to robot: every parameter by its name, with its unit and its bounds."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pinmobile.arrays import Array

__all__ = ["PARAMETERS", "Parameter"]


@dataclass(frozen=True)
class Parameter:
    """A number of each robot that may be spread.

    Attributes
    ----------
    unit : str
        Its unit, "" for none.
    meaning : str
        What it is, in words.
    least : float
        Values must be above, or for 0 of a parameter that may vanish, at least this.
    may_vanish : bool
        Whether `least` itself is allowed.
    """

    unit: str
    meaning: str
    least: float = -np.inf
    may_vanish: bool = True

    @property
    def bound(self) -> str:
        """What is expected of its values, such as ``> 0``."""
        return f"{'>=' if self.may_vanish else '>'} {self.least:g}"

    def allows(self, values: Array) -> Any:
        """Tell which values are possible, shape (n,)."""
        return values >= self.least if self.may_vanish else values > self.least


def _body(prefix: str, of: str) -> dict[str, Parameter]:
    return {
        f"{prefix}mass": Parameter("kg", f"mass of {of}", 0.0, may_vanish=False),
        f"{prefix}yaw_inertia": Parameter("kg m^2", f"yaw inertia of {of}", 0.0, may_vanish=False),
        f"{prefix}com_x": Parameter("m", f"centre of mass of {of}, forward"),
        f"{prefix}com_y": Parameter("m", f"centre of mass of {of}, left"),
    }


def _gains() -> dict[str, Parameter]:
    found = {}
    for gain in ("kp", "kd"):
        found[gain] = Parameter("", f"{gain} of all three coordinates, in place of the controller's")
        for coordinate in ("x", "y", "psi"):
            found[f"{gain}_{coordinate}"] = Parameter("", f"{gain} of {coordinate} alone")
        found[f"{gain}_factor"] = Parameter("", f"by which {gain} is multiplied")
    return found


def _forces() -> dict[str, Parameter]:
    axes = (("forward", "N"), ("left", "N"), ("yaw", "N m"))
    viscous = {"forward": "N s/m", "left": "N s/m", "yaw": "N m s"}
    return {
        "force_x": Parameter("N", "constant force along x"),
        "force_y": Parameter("N", "constant force along y"),
        "moment_z": Parameter("N m", "constant moment"),
        "sine_x": Parameter("N", "amplitude of the sinusoidal force along x"),
        "sine_y": Parameter("N", "amplitude of the sinusoidal force along y"),
        "sine_moment": Parameter("N m", "amplitude of the sinusoidal moment"),
        "sine_frequency": Parameter("Hz", "its frequency", 0.0),
        "sine_phase": Parameter("rad", "its phase"),
        "noise_x": Parameter("N", "rms of the noise force along x", 0.0),
        "noise_y": Parameter("N", "rms of the noise force along y", 0.0),
        "noise_moment": Parameter("N m", "rms of the noise moment", 0.0),
        **{f"viscous_{a}": Parameter(unit, f"viscous friction, {a}", 0.0) for a, unit in viscous.items()},
        **{f"rolling_{a}": Parameter(unit, f"rolling resistance, {a}", 0.0) for a, unit in axes},
    }


PARAMETERS: Mapping[str, Parameter] = {
    **_body("", "the robot"),
    **_body("model_", "the controller's model"),
    "start_x": Parameter("m", "start, from the trajectory's along x"),
    "start_y": Parameter("m", "start, from the trajectory's along y"),
    "start_psi": Parameter("rad", "start, from the trajectory's heading"),
    "start_vx": Parameter("m/s", "velocity at the start, from the trajectory's along x"),
    "start_vy": Parameter("m/s", "velocity at the start, from the trajectory's along y"),
    "start_yaw_rate": Parameter("rad/s", "yaw rate at the start, from the trajectory's"),
    **_gains(),
    **_forces(),
}
"""Every parameter that a spread may name."""
