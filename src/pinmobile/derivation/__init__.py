"""The lecture's symbolic derivation, step by step, by sympy, for any modified-DH table."""

from pinmobile.derivation.chain import Chain, Link
from pinmobile.derivation.energy import difference, lagrange
from pinmobile.derivation.newton_euler import derive, lecture
from pinmobile.derivation.numeric import Numeric
from pinmobile.derivation.steps import Derivation, Step

__all__ = ["Chain", "Derivation", "Link", "Numeric", "Step", "derive", "difference", "lagrange", "lecture"]
