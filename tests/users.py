"""Parts as a user writes them, for `simulate` and for arrays of robots."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from pinmobile import Context
from pinmobile.arrays import Array


@dataclass(frozen=True)
class PID:
    """What the limits took away is taken out of the integral (back-calculation)."""

    kp: float
    ki: float
    kd: float
    back: float = 2.0  # [1/s]; 0: the integral winds up

    def initial_state(self, context: Context) -> Any:
        return {"sum": np.zeros(3), "u": np.zeros(3), "dt": context.dt, "difference": context.difference}

    def __call__(self, t: float, q: Array, v: Array, reference: Any, state: Any) -> tuple[Array, Any]:
        error = state["difference"](q, reference.q)
        u = self.kp * error + self.kd * (reference.v - v) + state["sum"]
        return u, state | {"sum": state["sum"] + state["dt"] * self.ki * error, "u": u}

    def applied(self, u: Array, state: Any) -> Any:
        return state | {"sum": state["sum"] + state["dt"] * self.back * (u - state["u"])}
