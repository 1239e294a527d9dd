"""`MPC`: linear time-varying model predictive control, and its condensed quadratic program."""

from __future__ import annotations

from contextlib import suppress
from functools import cached_property
from time import process_time
from typing import Any, NamedTuple, final

import numpy as np

from pinmobile.arrays import Array, count_steps, frozen, shaped
from pinmobile.controllers.controller import State
from pinmobile.controllers.feedback import bound
from pinmobile.controllers.lqr import (
    TrackedModel,
    WeightedLaw,
    check_gains,
    check_motion,
    full_reference,
    memoize,
    riccati,
    tracked_errors,
    tracked_model,
    weight_field,
)
from pinmobile.controllers.wrappers import estimate_force
from pinmobile.errors import InvalidArgument, NotSolved, NotTraceable, import_extra
from pinmobile.parts import Linearized, Rolling, able, array, child, integer, number, part
from pinmobile.plant import Context, inputs_of

_SOFT_FLAG = 8  # flag of daqp: a bound that may be violated at a cost
_UPPER_ACTIVE, _LOWER_ACTIVE = 1, 3  # flags of daqp: a bound that is active at the start
_BOUND_TOLERANCE = 1e-9  # tolerance of bounds in daqp


class Program(NamedTuple):
    """Quadratic program in z, the scaled difference of inputs and LQR inputs; its Hessian is the identity.

    Attributes
    ----------
    H, f : ndarray, shape (N nu, N nu), (N nu,)
        Cost z' H z / 2 + f' z.
    A : ndarray, shape (rows, N nu)
        Inputs and bounded states of each step, per z.
    lower, upper : ndarray, shape (rows,)
        Bounds of A z.
    sense : ndarray of int32, shape (rows,)
        Flags of the bounds: which of them are soft.
    """

    H: Array
    f: Array
    A: Array
    lower: Array
    upper: Array
    sense: Any

    def solve(self, duals: Array) -> tuple[Array, Array, int]:
        """Return z, the multiplier of each bound, and the exit flag of daqp, above 0 for a solution.

        Parameters
        ----------
        duals : ndarray, shape (rows,)
            Multipliers of a similar program: the solver starts with its active bounds.
        """
        solve = solver()
        flags = self.sense | np.where(duals > 0, _UPPER_ACTIVE, np.where(duals < 0, _LOWER_ACTIVE, 0))
        for sense in (flags.astype(np.int32), self.sense):
            z, _, flag, details = solve(
                self.H, self.f, self.A, self.upper, self.lower, sense.copy(), primal_tol=_BOUND_TOLERANCE
            )
            if flag > 0 and np.isfinite(z).all():
                return z, np.asarray(details["lam"]), flag
        return z, 0.0 * duals, min(flag, 0)


class Plan:
    """Model and matrices at all N + 1 samples, computed before the first one.

    Inputs are those of the gains K plus w. The cost of w alone is the sum of w' S w, S = R + B' P B. With S =
    L L' and z = L' w it is z' z, and daqp needs no factorisation. The responses to z of one sample at all
    later samples are computed in advance: the rows of a program are copies.

    Parameters
    ----------
    model : TrackedModel
        Linear model of the robot along the reference.
    x : ndarray, shape (N + 1, n + m)
        Tracked state of the reference.
    Q, R : ndarray
        Weights of one sample.
    dt : float
        Time between two samples [s].
    stride, horizon : int
        Number of samples of a prediction step, and number of steps.
    is_bounded : ndarray of bool, shape (n + m,)
        Whether each state is bounded.

    Attributes
    ----------
    F, K : ndarray, shape (N + 1, n + m, n + m), (N + 1, nu, n + m)
        Closed-loop model from each sample to the next step, and its gains.
    u, x : ndarray, shape (N + 1, nu), (N + 1, n + m)
        Input and tracked state of the reference.
    scales : ndarray, shape (N + 1, nu, nu)
        Input w per z.
    responses : ndarray, shape (N + 1, horizon, nu + bounded, nu)
        Later inputs, and bounded states after them, per z of each sample.
    A_nu, B_nu, B_pinv : ndarray, shape (N + 1, m, n + m), (N + 1, m, nu), (N + 1, nu, m)
        Rates of independent velocities per state and per input, and the pseudoinverse of the latter.
    """

    def __init__(
        self,
        model: TrackedModel,
        x: Array,
        Q: Array,
        R: Array,
        *,
        dt: float,
        stride: int,
        horizon: int,
        is_bounded: Array,
    ) -> None:
        A, B = model.discrete(stride * dt)
        K, P = riccati(A, B, stride * Q, stride * R, stride)
        S = stride * R + np.swapaxes(B, -1, -2) @ P[stride:] @ B
        m, last = model.nu.shape[-1], len(A) - 1
        self.stride, self.horizon, self.dt = stride, horizon, dt
        self.K, self.F, self.u, self.x = K, A - B @ K, frozen(model.u), frozen(x)
        self.scales = np.swapaxes(np.linalg.inv(np.linalg.cholesky(S)), -1, -2)
        self.A_nu, self.B_nu = model.A[:, -m:], model.B[:, -m:]
        self.B_pinv = np.linalg.pinv(self.B_nu)
        nu, soft = B.shape[-1], np.flatnonzero(is_bounded)
        self.responses = np.empty((last + 1, horizon, nu + len(soft), nu))
        samples, inputs, states = np.arange(last + 1), self.scales, B @ self.scales
        for lag in range(horizon):
            self.responses[:, lag, :nu], self.responses[:, lag, nu:] = inputs, states[:, soft]
            samples = np.minimum(samples + stride, last)
            inputs, states = -self.K[samples] @ states, self.F[samples] @ states
        self.hessian, self.gradient = np.eye(horizon * nu), np.zeros(horizon * nu)
        self.sense = np.tile(np.repeat(np.array([0, _SOFT_FLAG], np.int32), [nu, len(soft)]), horizon)

    def samples(self, k: int) -> Any:
        """Return the samples of a horizon, shape (horizon + 1,); after the end, the last one repeats."""
        return np.minimum(k + self.stride * np.arange(self.horizon + 1), len(self.u) - 1)

    def free_response(self, samples: Any, dx: Array) -> tuple[Array, Array]:
        """Return inputs and next states of the gains alone, shape (horizon, nu), (horizon, n + m)."""
        states = np.empty((self.horizon + 1, len(dx)))
        states[0] = dx
        for j, step in enumerate(self.F[samples[:-1]]):
            np.dot(step, states[j], out=states[j + 1])
        return -(self.K[samples[:-1]] @ states[:-1, :, None])[..., 0], states[1:]

    def program(self, samples: Any, lower: Array, upper: Array) -> Program:
        """Return the program of a horizon.

        Parameters
        ----------
        samples : ndarray of int, shape (horizon + 1,)
            Samples of the horizon.
        lower, upper : ndarray, shape (horizon, nu + kept)
            Bounds of inputs and states relative to those of the gains.
        """
        N, rows, nu = self.responses.shape[1:]
        A = np.zeros((N, rows, N * nu))
        for j, i in enumerate(samples[:-1]):
            A[j:, :, j * nu : (j + 1) * nu] = self.responses[i, : N - j]
        return Program(
            self.hessian, self.gradient, A.reshape(N * rows, N * nu), lower.ravel(), upper.ravel(), self.sense
        )


def solver() -> Any:
    """Return ``daqp.solve``.

    Raises
    ------
    InvalidArgument
        If daqp is not installed.
    """
    return import_extra("daqp", "mpc", "MPC").solve


_EXAMPLE_ROBOTS = 10_000
_RELATIVE_TOLERANCE = 1e-9  # relative tolerance of step / dt, and of limits compared with those of motors
_TEST_ERROR, _DOUBLINGS = 0.1, 8  # error of a timed call [m, rad], and number of its doublings


class _ObserverMemory(NamedTuple):
    """Memory of the observer: whether a sample came before, its integral, and its estimate."""

    is_ready: float
    integral: Array
    disturbance: Array


@final
@part
class MPC(WeightedLaw):
    """Model predictive control along a reference: a quadratic program per sample keeps inputs within limits.

    Over `horizon` steps of the linear model along the reference, dx+ = A dx + B (du + d), it minimises the
    sum of dx' Q dx + (du + d)' R (du + d) plus the final cost dx' P dx, subject to::

        -limits <= u_d + du <= limits,   and, where possible, lower <= x <= upper.

    P is the cost to go of `LQR` with the same step: while no limit is active, both laws are equal. d is a
    constant input disturbance that represents unmodelled effects. Its estimate removes the steady-state error
    under a constant force (Pannocchia and Rawlings, 2003). For a robot driven by forces it follows from the
    generalised momentum, see `DisturbanceObserver`; on wheels, from the difference of the independent
    velocities and the model. The solver is daqp (Arnstroem, Bemporad and Axehill, 2022), of the extra
    ``pinmobile[mpc]``; it starts with the active bounds of the sample before. The law is not compiled.

    Parameters
    ----------
    robot : MobileRobot or WheeledRobot
        Controller model, without steered wheels. For the result of ``by_voltage()``, inputs and `limits` are
        voltages, see `LQR`.
    horizon : int
        Number of predicted steps.
    step : float
        Length of a step, a whole number of time steps [s]. A horizon of about 2 s is worth more than fine
        steps.
    limits : array_like, shape () or (nu,), optional
        Largest inputs, at most those of the robot, which are the default and replace infinite entries.
    lower, upper : array_like, shape (k,), optional
        Soft bounds of the first k of the n coordinates and m independent velocities, such as x and y;
        infinite without a bound.
    Q, R : array_like, optional
        Weights as in `LQR`, for one time step of the controller.
    observer : float
        Rate of the estimate of d [1/s]; 0: no estimate.
    input_weight : float
        Factor of R, > 0.

    Raises
    ------
    InvalidArgument
        If an argument is out of range, or limits exceed those of the robot; at the start of a run, if the
        limits exclude the reference, the step is not a whole number of time steps, the horizon is not longer
        than the measurement delay (see `MeasurementDelay`), the estimate is unstable at this time step, or as
        in `LQR`.
    NotSolved
        If a quadratic program has no solution.

    See Also
    --------
    LQR : the same cost without limits, compiled
    InputSaturation : limits without prediction

    Examples
    --------
    >>> from pinmobile import MPC, Circle, MobileRobot
    >>> from pinmobile import Tangent, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> law = MPC(robot, limits=[15.0, 15.0, 5.0])
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=1.0))
    >>> run = simulate(robot, law, path, dt=0.05, q0=[0.1, 0, 0])
    >>> print(f"at most {run.max_input()[0]:.0f} N")
    at most 15 N
    """

    robot: Any = child(Linearized, doc="model of the controller")
    horizon: int = integer(default=40, least=1, doc="number of predicted steps")
    step: float = number(default=0.05, above=0.0, unit="s", fixed=True, doc="step of the prediction")
    limits: Any = array(
        default=None,
        shapes=((), ("n",)),
        above=0.0,
        endless=True,
        fixed=True,
        doc="largest inputs",
        size=lambda self: self._sizes[2],
    )
    lower: Any = bound(-1.0, "lower soft bounds", ())
    upper: Any = bound(1.0, "upper soft bounds", ())
    Q: Any = weight_field(0, "weight of the errors")
    R: Any = weight_field(1, "weight of the input")
    observer: float = number(
        default=10.0, lower=0.0, unit="1/s", fixed=True, doc="rate of the estimate of the disturbance"
    )
    input_weight: float = number(default=1.0, above=0.0, doc="factor of R, the weight of the input")

    def check(self) -> None:
        """Raise `InvalidArgument` if limits exceed the robot's, or lower bounds are not below upper ones."""
        super().check()
        limits = [np.inf] * self._sizes[2] if self.limits is None else self.limits
        for entry, limit in zip(inputs_of(self.robot), limits, strict=True):
            largest = min(-entry.lower, entry.upper)
            if largest * (1 + _RELATIVE_TOLERANCE) < limit < np.inf:
                raise InvalidArgument(
                    f"limits has {limit:.9g} {entry.unit} for {entry.name}, expected at most {largest:.9g} "
                    f"{entry.unit}, the limit of its motor, at which the robot cuts inputs off"
                )
        size = sum(self._sizes[:2])
        for name, infinite in (("lower", -np.inf), ("upper", np.inf)):
            given, bounds = getattr(self, name), np.full(size, infinite)
            k = min(given.size, size)
            bounds[:k] = shaped(name, given, (k,))
            object.__setattr__(self, name, frozen(bounds))
        if (self.lower >= self.upper).any():
            raise InvalidArgument("lower is not below upper, expected lower soft bounds below the upper ones")

    @cached_property
    def range(self) -> tuple[Array, Array]:
        """Smallest and largest inputs, shape (nu,) each [N, N m or V]."""
        entries = inputs_of(self.robot)
        lowest, highest = np.array([x.lower for x in entries]), np.array([x.upper for x in entries])
        if self.limits is not None:
            lowest, highest = np.maximum(lowest, -self.limits), np.minimum(highest, self.limits)
        return frozen(lowest), frozen(highest)

    def initial_state(self, context: Context) -> tuple[Any, ...]:
        """Return the plan, the sample number, the observer's memory, the last input, and the multipliers."""
        solver()
        reference = full_reference(context, self.robot)
        dt, t = float(context.dt), np.asarray(context.t)
        stride = count_steps("step", self.step, dt)
        if self.horizon * stride <= context.measurement_delay:
            raise InvalidArgument(
                f"horizon is {self.horizon * self.step:g} s, not longer than the delay of the measurement, "
                f"{context.measurement_delay * dt:g} s, expected more than "
                f"{context.measurement_delay / stride:.3g} steps"
            )
        check_gains(lambda: {"observer": self.observer}, lambda h: np.array([[1.0 - h * self.observer]]), dt)
        Q, R = self.Q, self.input_weight * self.R

        def design() -> Plan:
            model = tracked_model(self.robot, reference)
            check_motion(self.robot, reference, model.nu, float(t[-1]))
            x = np.concatenate([reference.q[..., : reference.v.shape[-1]], model.nu], axis=-1)
            sizes = {"stride": stride, "horizon": self.horizon, "is_bounded": self._is_bounded}
            return Plan(model, x, Q, R, dt=dt, **sizes)

        arrays = (*reference, Q, R, t, self._is_bounded)
        plan = memoize(self.robot, ("MPC", dt, self.step, self.horizon), arrays, design)
        excess = np.maximum(self.range[0] - plan.u, plan.u - self.range[1]).max(axis=-1)
        if (excess >= 0).any():
            k = int(np.argmax(excess))
            raise InvalidArgument(
                f"limits exclude the reference: at t = {t[k]:g} s it needs an input of {plan.u[k].tolist()}, "
                f"expected limits above that, instead of {self.range[1].tolist()}"
            )
        nu, m = plan.u.shape[-1], len(plan.A_nu[0])
        memory = _ObserverMemory(0.0, np.zeros(m), np.zeros(nu))
        return plan, 0, memory, np.zeros(nu), np.zeros(len(plan.sense))

    @property
    def _is_bounded(self) -> Any:
        """Whether each state is bounded, shape (n + m,)."""
        return np.isfinite(self.lower) | np.isfinite(self.upper)

    def applied(self, u: Array, state: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return the next state for the applied input, shape (nu,)."""
        plan, k, memory, _, duals = state
        return plan, k, memory, u, duals

    def signals(self, state: tuple[Any, ...]) -> dict[str, Any]:
        """Return the estimated input disturbance, and the number of active bounds."""
        units = ", ".join(dict.fromkeys(entry.unit for entry in inputs_of(self.robot)))
        return {
            "disturbance": (units, state[2].disturbance),
            "active_bounds": ("", float(np.count_nonzero(state[4]))),
        }

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, ...]
    ) -> tuple[Array, tuple[Any, ...]]:
        """Return the input, shape (nu,), and the next state."""
        plan, k, memory, last, duals = state
        if not (type(q) is np.ndarray and q.ndim == 1):
            words = f"MPC solves a quadratic program at each of {len(plan.u):,} samples"
            with suppress(TypeError):  # limits are symbols here, and the solver needs numbers
                hours = _EXAMPLE_ROBOTS * len(plan.u) * self._solve_time(plan) / 3600
                words += f", so that {_EXAMPLE_ROBOTS:,} robots take some {hours:.2g} h of a processor"
            raise NotTraceable(words, "use LQR in InputSaturation, which is compiled")
        dx = -tracked_errors(self.robot, q, v, reference, plan.x[k][np.shape(reference.v)[-1] :])
        if self.observer > 0:
            memory = self._observe(plan, k, q, v, dx, memory, last)
        u, duals = self._input(t, plan, k, dx, memory.disturbance, duals)
        return u, (plan, min(k + 1, len(plan.u) - 1), memory, u, duals)

    def _observe(
        self, plan: Plan, k: int, q: Array, v: Array, dx: Array, memory: _ObserverMemory, last: Array
    ) -> _ObserverMemory:
        """Return the observer's memory at a sample, with the last input `last`."""
        is_ready, integral, _ = memory
        if not able(self.robot, Rolling):
            integral = integral + plan.dt * last
            estimate, integral, rate = estimate_force(self.robot, self.observer, q, v, is_ready, integral)
            return _ObserverMemory(1.0, integral + plan.dt * rate, estimate)
        speeds = dx[-len(integral) :]
        integral = integral + plan.dt * (plan.B_nu[k - 1] @ last) if is_ready else speeds
        rates = self.observer * (speeds - integral)
        integral_rate = plan.A_nu[k] @ dx - plan.B_nu[k] @ plan.u[k] + rates
        return _ObserverMemory(1.0, integral + plan.dt * integral_rate, plan.B_pinv[k] @ rates)

    def _input(
        self, t: float, plan: Plan, k: int, dx: Array, estimate: Array, duals: Array
    ) -> tuple[Array, Array]:
        """Return the first input of the horizon, and the multipliers of its bounds."""
        samples, is_bounded = plan.samples(k), self._is_bounded
        inputs, states = plan.free_response(samples, dx)
        inputs += plan.u[samples[:-1]] - estimate
        states = (states + plan.x[samples[1:]])[:, is_bounded]
        lower = np.concatenate([self.range[0] - inputs, self.lower[is_bounded] - states], axis=-1)
        upper = np.concatenate([self.range[1] - inputs, self.upper[is_bounded] - states], axis=-1)
        if (lower <= 0).all() and (upper >= 0).all():
            return np.asarray(inputs[0]), 0.0 * duals
        program = plan.program(samples, lower, upper)
        z, duals, flag = program.solve(duals)
        if flag <= 0:
            raise NotSolved(
                f"the quadratic program of MPC at t = {t:g} s has no solution (exit flag {flag} of daqp), "
                "expected finite numbers; the error contains its state and problem",
                time=t,
                state=dx,
                problem=program._asdict(),
            )
        w = plan.scales[k] @ z[: len(estimate)]
        return np.asarray(np.clip(inputs[0] + w, *self.range)), duals

    def _solve_time(self, plan: Plan) -> float:
        """Return the processor time of one program with active bounds [s]."""
        zeros = np.zeros(plan.u.shape[-1])
        for k in range(_DOUBLINGS):
            dx = np.full(plan.x.shape[-1], _TEST_ERROR * 2**k)
            begin = process_time()
            _, duals = self._input(0.0, plan, 0, dx, zeros, np.zeros(len(plan.sense)))
            seconds = process_time() - begin
            if duals.any():
                break
        return seconds
