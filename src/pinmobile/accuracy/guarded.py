"""An integrator under watch, so that one that diverges or is none ends in words."""

import numpy as np

from pinmobile.accuracy.convergence import EPS
from pinmobile.arrays import Array
from pinmobile.errors import Diverged, InvalidArgument, shown
from pinmobile.integrators import Acceleration, Integrator

__all__ = ["FAR", "guarded"]

FAR = 1e-3 / EPS  # beyond, a metre is lost in rounding; well before anything overflows


def guarded(integrator: Integrator) -> Integrator:
    """Return the integrator, which raises where its answer is no state, or one that is far off.

    Parameters
    ----------
    integrator : callable
        What is watched: the step that comes back raises `InvalidArgument` where it returns something else
        than q and v, and `Diverged` where they are not finite, or larger than numbers can resolve.
    """

    def step(acceleration: Acceleration, t: float, q: Array, v: Array, dt: float) -> tuple[Array, Array]:
        with np.errstate(all="ignore"):
            answer = integrator(acceleration, t, q, v, dt)
        if type(answer) is not tuple or len(answer) != 2 or any(np.shape(x) != q.shape for x in answer):
            raise InvalidArgument(
                f"integrator returned {shown(answer)}, expected (q, v), each of shape {q.shape}"
            )
        if not np.abs(answer).max() < FAR:
            raise Diverged(
                f"the integrator diverged at t = {t + dt:g} s", time=t + dt, q=answer[0], v=answer[1]
            )
        return answer

    return step
