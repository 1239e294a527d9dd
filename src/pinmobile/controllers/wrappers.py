"""What stands between a controller and its robot: limits of the force, a delay, a noisy measurement.

Each wraps a controller and is one. They nest in any order; the outer one sees the measurement first, and
the force last.
"""

from __future__ import annotations

from hashlib import sha256
from typing import Any, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, frozen
from pinmobile.controllers.backstepping import has_axle, reference_of, speeds_along
from pinmobile.controllers.controller import Seen, State, Wrapper, answer_of, check_wheels, told
from pinmobile.errors import InvalidArgument, shown
from pinmobile.parts import Allocating, Controlling, child, each, integer, option, part, structure
from pinmobile.plant import Context, inputs_of, leading_of


def _seed(name: str, value: Any) -> Any:
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not (isinstance(value, np.random.SeedSequence) or (whole and value >= 0)):
        raise InvalidArgument(f"{name} is {shown(value)}, expected a whole number >= 0 or a SeedSequence")
    return value


@final
@part
class Saturated(Wrapper):
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

    controller: Any = child(Controlling, doc="wrapped controller")
    limits: Any = each(above=0.0, endless=True, unit="N, N, N m", doc="largest force of each coordinate")

    def initial_state(self, context: Context) -> Any:
        """Return the state that the wrapped controller starts with."""
        return self.controller.initial_state(context)

    def applied(self, u: Array, state: Any) -> Any:
        """Return the wrapped controller's state, told of the input that is applied, shape (..., n)."""
        return told(self.controller, u, state)

    def signals(self, state: Any) -> Any:
        """Return what the wrapped controller tells beside its input: name to (unit, value)."""
        return super().signals((state,))

    def __call__(self, t: float, q: Array, v: Array, reference: State, state: Any) -> tuple[Array, Any]:
        """Return the limited force, shape (..., n), and the wrapped controller's next state."""
        tau, state = answer_of(self.controller, t, q, v, reference, state)
        limits = _fitting("limits", self.limits, np.shape(tau)[-1:])
        return np.minimum(np.maximum(tau, -limits), limits), state


@final
@part
class Delayed(Wrapper):
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

    controller: Any = child(Controlling, doc="wrapped controller")
    samples: int = integer(doc="samples by which the measured state is late")

    def initial_state(self, context: Context) -> tuple[Any, Any]:
        """Return the state that the wrapped controller starts with, and a line without measurements."""
        late: Any = Seen(context, delay=context.delay + self.samples)
        return self.controller.initial_state(late), context.line(self.samples)

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any]
    ) -> tuple[Array, tuple[Any, Any]]:
        """Return the force, shape (..., n), and the next state: the wrapped one, past measurements."""
        inner, line = state
        (old_q, old_v), line = line.push((q, v))
        tau, inner = answer_of(self.controller, t, old_q, old_v, reference, inner)
        return tau, (inner, line)


@final
@part
class NoisyMeasurement(Wrapper):
    """A controller that is told of the state with white Gaussian noise added.

    The noise of sample k depends on the seed and k alone, so that a second run gets the same; it is
    `Context.normal`, the same in every engine. Where q and v have leading axes, all of them get the same
    noise, and in an ensemble each robot its own. That of q is a displacement, by which the plant's
    `integrate` moves q.

    Parameters
    ----------
    controller : controller
        What is wrapped.
    std_q, std_v : array_like, shape () or (n,)
        Standard deviation of each coordinate [m, m, rad, ...] and its rate [m/s, m/s, rad/s, ...], >= 0;
        n is the robot's nv: 3 and one for each degree of freedom of its arms.
    seed : int or SeedSequence
        Of the noise. In an ensemble, each robot has numbers of its own, which follow from this seed and the
        ensemble's.

    Raises
    ------
    InvalidArgument
        If `controller` is none, a standard deviation has another shape, is not finite or below zero, or
        `seed` is something else, such as a Generator, which would not repeat.
    """

    controller: Any = child(Controlling, doc="wrapped controller")
    std_q: Any = each(lower=0.0, unit="m, m, rad", doc="standard deviation of the measured q")
    std_v: Any = each(lower=0.0, unit="m/s, m/s, rad/s", doc="standard deviation of the measured v")
    seed: Any = option(doc="seed of the noise", check=_seed)

    @property
    def _name(self) -> str:
        """Name of its noise: another for each seed, and for each of several, one in the other."""
        within, inner = 0, self.controller
        while inner is not None:
            within += isinstance(inner, NoisyMeasurement)
            inner = getattr(inner, "controller", None)
        sequence = (
            self.seed if isinstance(self.seed, np.random.SeedSequence) else np.random.SeedSequence(self.seed)
        )
        return f"measurement {within} {sha256(sequence.generate_state(4).tobytes()).hexdigest()[:16]}"

    def initial_state(self, context: Context) -> tuple[Any, Any, Any]:
        """Return the state that the wrapped controller starts with, the noise, and how q moves."""
        noise = context.normal(self._name, 2 * context.nv)
        return self.controller.initial_state(context), noise, context.integrate

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any, Any]
    ) -> tuple[Array, tuple[Any, Any, Any]]:
        """Return the force, shape (..., n), and the next state: the wrapped one, the noise."""
        inner, noise, integrate = state
        n = np.shape(v)[-1]
        std_q, std_v = _fitting("std_q", self.std_q, (n,)), _fitting("std_v", self.std_v, (n,))
        numbers, noise = noise.draw()
        noisy = integrate(q, std_q * numbers[..., :n]), v + std_v * numbers[..., n:]
        tau, inner = answer_of(self.controller, t, *noisy, reference, inner)
        return tau, (inner, noise, integrate)


def _fitting(name: str, value: ArrayLike, size: tuple[int, ...]) -> Array:
    """Check that a parameter is of this number of coordinates, and return it."""
    array = np.asarray(value)
    if array.shape[-1:] not in ((), size):
        raise InvalidArgument(f"{name} has shape {array.shape}, expected () or {size}")
    return array


@final
@part
class Allocated(Wrapper):
    """A controller of body and arms, such as `PD`, whose force the wheels are to give.

    It sees what a robot without wheels would be: the pose, the arms and their rates. What it returns, a force
    on x, y, psi and on the arms, becomes the torques of least norm that move the robot as that force would,
    all scaled by one factor where one is beyond its limit, see `WheeledRobot.allocate_scaled`. What of the
    force the wheels do not give, such as one across the axle, is recorded as the signal ``residual``, along
    x, y, psi and the arms.

    Where the drive has one fixed axle the reference moves along its wheels, as that of `Backstepping` does:
    one that moves sideways or whose heading jumps is refused, with its time, when a loop begins.

    Parameters
    ----------
    controller : controller
        What is wrapped.
    robot : WheeledRobot
        The model by which torques are found.

    Raises
    ------
    InvalidArgument
        If `controller` is none, `robot` is none with wheels, or has not a motor for each independent
        velocity.
    """

    controller: Any = child(Controlling, doc="wrapped controller")
    robot: Any = child(Allocating, doc="model by which torques are found")

    def check(self) -> None:
        """Raise `InvalidArgument` where no controller is wrapped, or the robot has too few motors."""
        super().check()
        check_wheels(self.robot)

    @structure
    def _axle(self) -> Array | None:
        """The axle of a drive that moves along one alone, which references follow."""
        return frozen(self.robot.axle) if has_axle(self.robot.mobility) else None

    def initial_state(self, context: Context) -> tuple[Any, Any, Any]:
        """Return the state that the wrapped controller starts with, and forces: left, and supplied."""
        reference = reference_of(context)
        if self._axle is not None and reference is not None:
            speeds_along(self._axle, np.asarray(context.t), reference)
        body = self.robot.robot
        own: Any = Seen(
            context,
            difference=body.difference,
            integrate=body.integrate,
            nv=body.nv,
            leading=leading_of(body),
            coordinates=context.coordinates[: body.nv],
            inputs=inputs_of(body),
        )
        none = np.zeros(body.nv)
        return self.controller.initial_state(own), none, none

    def applied(self, u: Array, state: Any) -> Any:
        """Return the state, with the wrapped controller told of the force that wheels give, (..., n)."""
        return told(self.controller, state[2], state[0]), *state[1:]

    def signals(self, state: Any) -> dict[str, Any]:
        """Return the force that the wheels do not give, beside what the wrapped controller tells."""
        return {**super().signals(state), "residual": ("N, N m", state[1])}

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: Any
    ) -> tuple[Array, tuple[Any, Any, Any]]:
        """Return the torques, shape (..., nu), and the next state."""
        body = self.robot.robot
        own = q[..., : body.nq], v[..., : body.nv]
        tau, inner = answer_of(self.controller, t, *own, reference, state[0])
        u, left = self.robot.allocate_scaled(q, tau)
        return u, (inner, left, tau - left)
