"""What stands between a controller and its robot: limits of the force, a delay, a noisy measurement.

Each wraps a controller and is one. They nest in any order; the outer one sees the measurement first, and
the force last.
"""

from dataclasses import dataclass, field
from threading import Lock
from typing import Any, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, endless_or_finite, finite, frozen, whole
from pinmobile.controllers.protocol import Controller, State, answer_of, check_controller, told
from pinmobile.errors import InvalidArgument, shown
from pinmobile.plant import Context

__all__ = ["Delayed", "NoisyMeasurement", "Saturated"]

_FIRST = 256  # samples of noise drawn at first


@final
@dataclass(frozen=True, eq=False)
class Saturated:
    """A controller whose force is limited, as a motor's is.

    Parameters
    ----------
    controller : controller
        What is wrapped.
    limits : array_like, shape () or (n,)
        Largest |tau| of each coordinate [N, N, N m], above zero; infinite where there is no limit, as in
        `MobileRobot.effort_limit`.

    Raises
    ------
    InvalidArgument
        If `controller` is none, or `limits` has another shape, is not finite, or not above zero.
    """

    controller: Controller
    limits: ArrayLike

    def __post_init__(self) -> None:
        check_controller(self.controller)
        limits = _per_coordinate("limits", self.limits, endless=True)
        if not (limits > 0).all():
            raise InvalidArgument(f"limits is {limits.min()}, expected > 0")
        object.__setattr__(self, "limits", limits)

    def initial_state(self, context: Context) -> Any:
        """Return the state that the wrapped controller starts with."""
        return self.controller.initial_state(context)

    def applied(self, u: Array, state: Any) -> Any:
        """Return the wrapped controller's state, told of the input that is applied, shape (..., n)."""
        return told(self.controller, u, state)

    def __call__(self, t: float, q: Array, v: Array, reference: State, state: Any) -> tuple[Array, Any]:
        """Return the limited force, shape (..., n), and the wrapped controller's next state."""
        tau, state = answer_of(self.controller, t, q, v, reference, state)
        limits = _fitting("limits", self.limits, np.shape(tau)[-1:])
        return np.minimum(np.maximum(tau, -limits), limits), state


@final
@dataclass(frozen=True, eq=False)
class Delayed:
    """A controller that is told of the state some samples late; of the reference it is told in time.

    Until there are that many, it is told of the first one.

    Parameters
    ----------
    controller : controller
        What is wrapped.
    samples : int
        How many samples late, >= 0.

    Raises
    ------
    InvalidArgument
        If `controller` is none, or `samples` no such number.
    """

    controller: Controller
    samples: int

    def __post_init__(self) -> None:
        check_controller(self.controller)
        object.__setattr__(self, "samples", whole("samples", self.samples, least=0))

    def initial_state(self, context: Context) -> tuple[Any, tuple[tuple[Array, Array], ...]]:
        """Return the state that the wrapped controller starts with, and no measurement."""
        return self.controller.initial_state(context), ()

    def applied(self, u: Array, state: Any) -> Any:
        """Return the state, with the wrapped controller told of the input that is applied, shape (..., n)."""
        return told(self.controller, u, state[0]), *state[1:]

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: Any
    ) -> tuple[Array, tuple[Any, tuple[tuple[Array, Array], ...]]]:
        """Return the force, shape (..., n), and the next state: the wrapped one, past measurements."""
        inner, past = state
        past = (*past, (np.array(q), np.array(v)))
        old_q, old_v = past[0]
        # What is kept is nobody else's to write into.
        tau, inner = answer_of(self.controller, t, old_q.copy(), old_v.copy(), reference, inner)
        return tau, (inner, past[max(len(past) - self.samples, 0) :])


@final
@dataclass(frozen=True, eq=False)
class NoisyMeasurement:
    """A controller that is told of the state with white Gaussian noise added.

    The noise of sample k depends on the seed and k alone, so that a second run gets the same. Where q and v
    have leading axes, all of them get the same noise. That of q is a displacement: it is added where q has n
    numbers, as v has; an angle that is (cos, sin) in q is turned by it, as the plant's `integrate` does.

    Parameters
    ----------
    controller : controller
        What is wrapped.
    std_q, std_v : array_like, shape () or (n,)
        Standard deviation of each coordinate [m, m, rad, ...] and its rate [m/s, m/s, rad/s, ...], >= 0;
        n is the robot's nv: 3 and one for each degree of freedom of its arms.
    seed : int or SeedSequence
        Of the noise: row k of ``default_rng(seed).standard_normal((m, 2, n))`` is that of q and of v at
        sample k, in units of the standard deviation. In an ensemble, each robot has numbers of its own,
        which follow from this seed and the ensemble's.

    Raises
    ------
    InvalidArgument
        If `controller` is none, a standard deviation has another shape, is not finite or below zero, or
        `seed` is something else, such as a Generator, which would not repeat.
    """

    controller: Controller
    std_q: ArrayLike
    std_v: ArrayLike
    seed: Any
    _tables: dict[int, "_Table"] = field(init=False, repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        check_controller(self.controller)
        for name in ("std_q", "std_v"):
            std = _per_coordinate(name, getattr(self, name))
            if (std < 0).any():
                raise InvalidArgument(f"{name} is {std.min()}, expected >= 0")
            object.__setattr__(self, name, std)
        whole_number = isinstance(self.seed, int | np.integer) and not isinstance(self.seed, bool)
        if not (isinstance(self.seed, np.random.SeedSequence) or (whole_number and self.seed >= 0)):
            raise InvalidArgument(
                f"seed is {shown(self.seed)}, expected a whole number >= 0 or a SeedSequence"
            )

    def __reduce__(self) -> tuple[Any, ...]:
        # The tables are drawn again from the seed.
        return type(self), (self.controller, self.std_q, self.std_v, self.seed)

    def initial_state(self, context: Context) -> tuple[Any, int, Any]:
        """Return the state that the wrapped controller starts with, no samples so far, and how q moves."""
        return self.controller.initial_state(context), 0, context.integrate

    def applied(self, u: Array, state: Any) -> Any:
        """Return the state, with the wrapped controller told of the input that is applied, shape (..., n)."""
        return told(self.controller, u, state[0]), *state[1:]

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: Any
    ) -> tuple[Array, tuple[Any, int, Any]]:
        """Return the force, shape (..., n), and the next state: the wrapped one, samples so far."""
        inner, k, integrate = state
        size = np.shape(v)[-1:]
        std_q, std_v = _fitting("std_q", self.std_q, size), _fitting("std_v", self.std_v, size)
        n = size[0]
        if n not in self._tables:
            self._tables.setdefault(n, _Table(self.seed, n))
        row = self._tables[n].row(k)
        noisy = _displaced(q, std_q * row[0], n, integrate), v + std_v * row[1]
        tau, inner = answer_of(self.controller, t, *noisy, reference, inner)
        return tau, (inner, k + 1, integrate)


class _Table:
    """Rows of standard normal numbers, shape (m, 2, n), that grows; a row stays as it is."""

    def __init__(self, seed: Any, n: int) -> None:
        self._rng, self._lock = np.random.default_rng(seed), Lock()
        self._rows = self._rng.standard_normal((_FIRST, 2, n))

    def row(self, k: int) -> Array:
        """Return row k, shape (2, n)."""
        if k >= len(self._rows):
            with self._lock:  # two threads that draw at once would share out the rows
                while k >= len(self._rows):
                    more = self._rng.standard_normal(self._rows.shape)
                    self._rows = np.concatenate([self._rows, more])
        return np.asarray(self._rows[k])


def _displaced(q: Array, dq: Array, n: int, integrate: Any) -> Array:
    """Return q moved by dq, shape (n,): the sum where q has n numbers too, else as the plant steps it."""
    return q + dq if np.shape(q)[-1] == n else np.asarray(integrate(q, dq))


def _per_coordinate(name: str, value: ArrayLike, *, endless: bool = False) -> Array:
    array = (endless_or_finite if endless else finite)(name, value)
    if array.ndim > 1:
        raise InvalidArgument(f"{name} has shape {array.shape}, expected () or (n,)")
    return frozen(array)


def _fitting(name: str, value: Any, size: tuple[int, ...]) -> Array:
    """Return a checked parameter, after refusing one that belongs to another number of coordinates."""
    if value.shape not in ((), size):
        raise InvalidArgument(f"{name} has shape {value.shape}, expected () or {size}")
    return np.asarray(value)
