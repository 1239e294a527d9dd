"""What `MobileRobot.calls` offers to loops, in public order."""

from collections.abc import Callable
from typing import Any

from task import Body

from contestants.of_pinmobile import build


def calls(body: Body) -> dict[str, Callable[..., Any]]:
    offered = build(body).law
    return {
        "M": offered.mass_matrix,
        "n": offered.nonlinear_effects,
        "inverse": offered.inverse_dynamics,
        "forward": offered.forward_dynamics,
    }
