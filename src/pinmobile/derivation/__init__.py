"""The lecture's symbolic derivation, step by step, by sympy: of modified-DH chains, and of wheels."""

from pinmobile.derivation.chain import Chain, Link
from pinmobile.derivation.equations import derive, difference, lagrange, lecture
from pinmobile.derivation.reduction import (
    ReducedDerivation,
    RollerWheel,
    car,
    differential_drive,
    roller_drive,
)
from pinmobile.derivation.steps import Derivation, Numeric, Step

__all__ = [
    "Chain",
    "Derivation",
    "Link",
    "Numeric",
    "ReducedDerivation",
    "RollerWheel",
    "Step",
    "car",
    "derive",
    "difference",
    "differential_drive",
    "lagrange",
    "lecture",
    "roller_drive",
]
