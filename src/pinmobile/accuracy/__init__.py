"""How good an integrator is: its order, the drift of what should stay, and what holding the force costs."""

from pinmobile.accuracy.convergence import Convergence
from pinmobile.accuracy.report import IntegratorReport, integrator_report

__all__ = ["Convergence", "IntegratorReport", "integrator_report"]
