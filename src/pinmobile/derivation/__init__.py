"""The lecture's symbolic derivation, step by step, by sympy, for any modified-DH table."""

from pinmobile.derivation.chain import Chain, Link
from pinmobile.derivation.equations import derive, difference, lagrange, lecture
from pinmobile.derivation.steps import Derivation, Numeric, Step

__all__ = ["Chain", "Derivation", "Link", "Numeric", "Step", "derive", "difference", "lagrange", "lecture"]
