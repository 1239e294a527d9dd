"""`RandomSteps`: commands that excite a robot that takes speeds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, frozen, whole
from pinmobile.controllers import State
from pinmobile.errors import InvalidArgument
from pinmobile.plant import Context, Parameter

_TURN = 1 / (2 * np.pi)
_HALF_SAMPLE = 0.5


@final
@dataclass(frozen=True, init=False, eq=False)
class RandomSteps:
    """Speed and yaw rate that jump, independently of each other, to levels that are held for a while.

    Levels and times are equally likely anywhere between their bounds; they follow from the seed and, in an
    ensemble, the robot. State and reference are not looked at.

    Parameters
    ----------
    lowest, largest : array_like, shape (2,)
        Bounds of the levels, in the units of the inputs [m/s, rad/s].
    hold : array_like, shape (2,)
        Shortest and longest time for which a level is held [s].
    seed : int
        Of both.

    Raises
    ------
    InvalidArgument
        If an array has another shape or is not finite, upper bounds are below lower ones, a time is not above
        zero, or `seed` is no whole number.
    """

    lowest: Array
    largest: Array
    hold: Array
    seed: int

    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("shortest_hold", "s", "shortest time that a level is held", 0.0, False, "hold", 0),
        Parameter("longest_hold", "s", "longest time that a level is held", 0.0, False, "hold", 1),
    )

    def __init__(
        self,
        lowest: ArrayLike = (-0.2, -1.3),
        largest: ArrayLike = (0.8, 1.3),
        hold: ArrayLike = (0.4, 2.5),
        seed: int = 0,
    ) -> None:
        for name, value in (("lowest", lowest), ("largest", largest), ("hold", hold)):
            given = finite(name, value)
            if given.shape != (2,):
                raise InvalidArgument(f"{name} has shape {given.shape}, expected (2,)")
            object.__setattr__(self, name, frozen(given))
        if (self.largest < self.lowest).any():
            raise InvalidArgument(
                f"largest is {self.largest.tolist()}, expected at least lowest, {self.lowest.tolist()}"
            )
        if not 0 < self.hold[0] <= self.hold[1]:
            raise InvalidArgument(f"hold is {self.hold.tolist()}, expected 0 < shortest <= longest")
        object.__setattr__(self, "seed", whole("seed", seed, least=0))

    def initial_state(self, context: Context) -> tuple[Any, Any, Any, float]:
        """Return how long levels still hold, levels, the noise that draws them, and the sampling time."""
        return np.zeros(2), np.zeros(2), context.normal(f"random steps {self.seed}", 8), float(context.dt)

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any, Any, float]
    ) -> tuple[Array, tuple[Any, Any, Any, float]]:
        """Return the levels, shape (..., 2), and the next state."""
        left, level, noise, dt = state
        numbers, noise = noise.draw()
        # The direction of two normal numbers is equally likely anywhere.
        x, y = numbers[..., :4], numbers[..., 4:]
        share = 0.5 + _TURN * np.arctan2(y, x)
        ends = left < _HALF_SAMPLE * dt
        level = np.where(ends, self.lowest + (self.largest - self.lowest) * share[..., :2], level)
        longer = self.hold[..., :1] + (self.hold[..., 1:] - self.hold[..., :1]) * share[..., 2:]
        left = np.where(ends, longer, left) - dt
        return level, (left, level, noise, dt)
