"""`Sampled`, a controller or kinematic law that runs at a slower rate than the loop."""

from __future__ import annotations

from typing import Any, final, overload

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled import has_symbols, leaves, map_leaves
from pinmobile.controllers.controller import ContextView, Controller, evaluate, notify_applied
from pinmobile.controllers.kinematic_laws import value_of
from pinmobile.parts import child, integer, part
from pinmobile.plant import Context
from pinmobile.signals import signals_of


@final
@part
class Sampled:
    """Wrapper that runs a law at every n-th sample of the loop, and holds its output in between.

    It makes a slow outer law around a fast one: ``WheelSpeed(Sampled(UnicycleTracking(), 10), robot)`` tracks
    a path at a tenth of the rate of the wheels. The inner law has its own time step, n dt, in its `Context`:
    times, reference, delays and schedules of the context are those of its own samples. At each of them, it
    receives the measured state and the reference of that instant. In between, its output and memory are
    constant: a `Backstepping` around it takes their rates as zero. Noise of the context is that of the loop's
    samples.

    Parameters
    ----------
    controller : controller or kinematic law
        Law that runs at the slower rate.
    every : int
        Samples of the loop per sample of the law, n >= 1.

    Raises
    ------
    InvalidArgument
        If `every` is not a whole number >= 1.

    See Also
    --------
    MPC : law that is often too slow for each sample
    controllers.WheelSpeed : fast loop around a kinematic law

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import PD, Circle, MobileRobot
    >>> from pinmobile import Tangent, simulate
    >>> from pinmobile.controllers import Sampled
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> path = Tangent(Circle(1.0, 0.5, 4.0))
    >>> slow = Sampled(PD(120, 120), every=10)
    >>> run = simulate(robot, slow, path, dt=0.001)
    >>> steps = np.flatnonzero(np.diff(run.u[:, 0])) + 1
    >>> steps[:4]
    array([10, 20, 30, 40])
    """

    controller: Any = child(Controller, doc="law that runs at the slower rate")
    every: int = integer(default=10, least=1, doc="samples of the loop per sample of the law")

    @property
    def step_samples(self) -> int:
        """Samples of the loop per time step of the law, as `every`, by which other code knows slower laws."""
        return self.every

    def check(self, t: Array, speed: Array, yaw_rate: Array) -> None:
        """Raise `InvalidArgument` for a reference that a kinematic law cannot follow, shape (N,) each."""
        self.controller.check(t, speed, yaw_rate)

    def initial_state(self, context: Context) -> tuple[Any, ...]:
        """Return the law's state, the held output, the number of samples since, and whether it goes on."""
        requests: list[str] = []

        def delay(samples: int) -> Any:
            requests.append("delay")
            return context.delay(samples * self.every)

        def noise(name: str, n: int) -> Any:
            requests.append("noise")
            return context.noise(name, n)

        def schedule(rows: Any) -> Any:
            requests.append("schedule")
            return context.schedule(np.repeat(rows, self.every, axis=0)[: len(context.t)])

        slow: Any = _SlowContext(
            context,
            every=self.every,
            dt=self.every * context.dt,
            t=context.t[:: self.every],
            measurement_delay=-(-context.measurement_delay // self.every),
            delay=delay,
            noise=noise,
            schedule=schedule,
        )
        inner = self.controller.initial_state(slow)
        return inner, 0.0, 0.0, "goes on" if requests else ""

    def applied(self, u: Array, state: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return the next state; the law receives the applied input of its own samples, shape (..., nu)."""
        inner, *rest = state
        is_due = rest[1] == 1.0 % self.every  # the law has just run
        return _select_memory(is_due, notify_applied(self.controller, u, inner), inner), *rest

    def signals(self, state: tuple[Any, ...]) -> Any:
        """Return the signals of the law: name to (unit, value)."""
        return signals_of(self.controller, state[0])

    @overload
    def __call__(
        self, t: float, q: Array, v: Array, reference: Any, state: Any
    ) -> tuple[Array, tuple[Any, ...]]: ...
    @overload
    def __call__(self, tracked: Any, state: Any, /) -> tuple[tuple[Any, Any], tuple[Any, ...]]: ...
    def __call__(self, *given: Any) -> tuple[Any, tuple[Any, ...]]:  # type: ignore[misc]  # a loop gives no names
        """Return the held output, and the next state; the arguments are those of the law."""
        *arguments, (inner, last_output, count, runs_always) = given
        is_due = count == 0.0
        next_count = np.where(count >= self.every - 1.0, 0.0, count + 1.0)
        if runs_always or has_symbols(is_due) or is_due:
            if len(arguments) > 1:
                t, q, v, reference = arguments
                u, memory = evaluate(self.controller, t, q, v, reference, inner)
            else:  # a kinematic law, whose speeds may have rates: held, they have none
                pair, memory = self.controller(*arguments, inner)
                u = np.stack(np.broadcast_arrays(*map(value_of, pair)), axis=-1)
            last_output, inner = np.where(is_due, u, last_output), _select_memory(is_due, memory, inner)
        output = last_output if len(arguments) > 1 else (last_output[..., 0], last_output[..., 1])
        return output, (inner, last_output, next_count, runs_always)


class _SlowContext(ContextView):
    """Context of a law at each n-th sample."""

    every: int

    @property
    def reference(self) -> Any:
        """Reference at the samples of the law, if it is known."""
        samples = self._context.reference
        return None if samples is None else type(samples)(*(x[:: self.every] for x in samples))


def _select_memory(is_due: Any, new: Any, old: Any) -> Any:
    """Return the new memory where it is due, else the old one; delays, noise and schedules always go on."""
    old_leaves = iter([leaf for _, leaf in leaves(old)])
    return map_leaves(new, lambda leaf: np.where(is_due, leaf, next(old_leaves)))
