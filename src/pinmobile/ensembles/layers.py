"""The library's wrappers around a controller, and what they are around."""

from typing import Any

import numpy as np

from pinmobile.controllers import Delayed, NoisyMeasurement, Saturated
from pinmobile.errors import InvalidArgument

__all__ = ["check_layers", "core_of", "layers_of"]


def core_of(controller: Any) -> Any:
    """Return the controller inside all wrappers of the library."""
    layers = layers_of(controller)
    return layers[-1].controller if layers else controller


def layers_of(controller: Any) -> list[Any]:
    """Return the wrappers of the library around a controller, the outermost first."""
    layers = []
    while type(controller) in (Saturated, Delayed, NoisyMeasurement):
        layers.append(controller)
        controller = controller.controller
    return layers


def check_layers(controller: Any) -> None:
    """Refuse wrappers whose numbers are not those of one robot in the plane.

    Raises
    ------
    InvalidArgument
        If one has another shape than () or (3,).
    """
    for layer in layers_of(controller):
        for name in ("limits", "std_q", "std_v"):
            shape = np.shape(getattr(layer, name, 0.0))
            if shape not in ((), (3,)):
                raise InvalidArgument(f"{name} has shape {shape}, expected () or (3,)")
