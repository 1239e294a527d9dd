"""`MPC`: linear time-varying model predictive control along a reference, within limits."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, endless_or_finite, frozen, non_negative, positive, real, whole
from pinmobile.controllers.controller import State
from pinmobile.controllers.lqr import riccati
from pinmobile.controllers.observer import estimated
from pinmobile.controllers.tracked_model import (
    check_moves,
    remembered,
    sizes_of,
    tracked_errors,
    tracked_model,
    weight,
    weights_of,
    whole_reference,
)
from pinmobile.errors import InvalidArgument, NotSolved, NotTraceable
from pinmobile.plant import Context, Parameter, inputs_of

_SOFT = 8  # of daqp: a bound that may be violated, at a cost
_TIGHT = 1e-9  # within which daqp holds bounds
_CALL = 5e-4  # [s] a sample, about
_MANY = 10_000
_WHOLE = 1e-9  # relative rounding allowed in step / dt


class _Problem(NamedTuple):
    """A quadratic program of w, which is by how much inputs differ from those of the gains.

    Attributes
    ----------
    H : ndarray, shape (N nu, N nu)
        Of the cost w' H w / 2.
    A : ndarray, shape (rows, N nu)
        Inputs, and bounded states, by w.
    lower, upper : ndarray, shape (rows,)
        Bounds of A w.
    sense : ndarray of int32, shape (rows,)
        Which of them are soft.
    """

    H: Array
    A: Array
    lower: Array
    upper: Array
    sense: Any


class _Plan:
    """What is known of all samples at the start.

    Attributes
    ----------
    A, B, K, S : ndarray, shape (N + 1, ...)
        Of the prediction's step from each sample: model, gains, and R + B' P B.
    u, x : ndarray, shape (N + 1, nu), (N + 1, n + m)
        Input and tracked state of the reference.
    stride : int
        Samples of a prediction's step.
    """

    def __init__(self, *arrays: Array, stride: int) -> None:
        self.A, self.B, self.K, self.S, self.u, self.x = map(frozen, arrays)
        self.stride = stride


@final
@dataclass(frozen=True, eq=False)
class MPC:
    """Model predictive control along a reference: inputs within limits, by a quadratic program a sample.

    Over `horizon` steps of the model about the reference, dx+ = A dx + B (du + d), it makes the sum of
    dx' Q dx + (du + d)' R (du + d), and dx' P dx at the end, least, such that

        |u_d + du| <= limits,   and, where that can be, lower <= x <= upper.

    P is the cost to go of `LQR` with the same step, so that while nothing is limited both are the same. d is
    the force that is not modelled, of the generalised momentum (see `DisturbanceObserver`), taken as
    constant: so no constant force leaves an error. It needs daqp (Arnstroem, Bemporad and Axehill, 2022), the
    extra ``pinmobile[mpc]``, and is not compiled.

    Parameters
    ----------
    robot : MobileRobot or WheeledRobot
        The model that the controller believes in; wheels must not steer. Of what ``by_voltage()`` returns,
        inputs and `limits` are volts, see `LQR`.
    horizon : int
        Steps that are predicted.
    step : float
        Each of them, a whole number of time steps [s]. Some 2 s altogether are worth more than fine steps.
    limits : array_like, shape () or (nu,), optional
        Largest inputs, which may be infinite; by default those of the robot.
    lower, upper : array_like, shape (n + m,), optional
        Soft bounds of the n coordinates and m independent velocities; infinite where there is none.
    Q, R : array_like, optional
        Weights, as of `LQR`, for one time step of the controller.
    observer : float
        Rate of the estimated force of a robot that is pushed [1/s]; 0: none is estimated. On wheels none is.

    Raises
    ------
    InvalidArgument
        If an argument is something else; at the start of a run, if the limits exclude the reference, the step
        is no whole number of time steps, or as of `LQR`.
    NotSolved
        If a quadratic program has no solution.
    """

    robot: Any
    horizon: int = 40
    step: float = 0.05
    limits: ArrayLike | None = None
    lower: ArrayLike | None = None
    upper: ArrayLike | None = None
    Q: ArrayLike | None = None
    R: ArrayLike | None = None
    observer: float = 10.0
    range: tuple[Array, Array] = field(init=False, repr=False)

    parameters: ClassVar[tuple[Parameter, ...]] = ()

    def __post_init__(self) -> None:
        n, m, inputs = sizes_of(self.robot)
        usual = weights_of(self.robot)
        Q, R = (x if given is None else given for x, given in zip(usual, (self.Q, self.R), strict=True))
        found: dict[str, Any] = {
            "Q": weight("Q", Q, n + m, above=False),
            "R": weight("R", R, inputs, above=True),
            "horizon": whole("horizon", self.horizon),
            "step": positive("step", self.step, "s"),
            "observer": non_negative("observer", self.observer, "1/s"),
        }
        if self.limits is None:
            own = inputs_of(self.robot)
            found["range"] = frozen([x.lower for x in own]), frozen([x.upper for x in own])
        else:
            limits = endless_or_finite("limits", self.limits)
            if limits.shape not in ((), (inputs,)) or not (limits > 0).all():
                raise InvalidArgument(f"limits is {limits.tolist()}, expected () or ({inputs},) numbers > 0")
            limits = np.broadcast_to(limits, inputs)
            found |= {"limits": frozen(limits), "range": (frozen(-limits), frozen(limits))}
        for name, sign in (("lower", -1.0), ("upper", 1.0)):
            given = getattr(self, name)
            bound = sign * endless_or_finite(name, np.inf if given is None else sign * real(name, given))
            bound = np.broadcast_to(bound, n + m) if given is None else bound
            if bound.shape != (n + m,):
                raise InvalidArgument(f"{name} has shape {bound.shape}, expected ({n + m},)")
            found[name] = frozen(bound)
        if (found["lower"] >= found["upper"]).any():
            raise InvalidArgument(
                "lower is not below upper, expected soft bounds between which there is room"
            )
        for name, value in found.items():
            object.__setattr__(self, name, value)

    def initial_state(self, context: Context) -> tuple[Any, ...]:
        """Return the plan, the sample's number, and the observer's memory."""
        _solver()
        reference, dt, t = whole_reference(context), float(context.dt), np.asarray(context.t)
        stride = round(self.step / dt)
        if stride < 1 or abs(stride * dt - self.step) > _WHOLE * self.step:
            raise InvalidArgument(f"step is {self.step:g} s, expected a whole number of time steps, {dt:g} s")
        Q, R = np.asarray(self.Q), np.asarray(self.R)

        def design() -> _Plan:
            model = tracked_model(self.robot, reference)
            check_moves(self.robot, reference, model.nu, float(t[-1]))
            A, B = model.discrete(self.step)
            K, P = riccati(A, B, stride * Q, stride * R, stride)
            S = stride * R + np.swapaxes(B, -1, -2) @ P[stride:] @ B
            n = reference.v.shape[-1]
            x = np.concatenate([reference.q[..., :n], model.nu], axis=-1)
            return _Plan(A, B, K, S, model.u, x, stride=stride)

        given = (*reference, Q, R, t)
        plan = remembered(self.robot, ("MPC", dt, self.step), given, design)
        beyond = np.maximum(self.range[0] - plan.u, plan.u - self.range[1]).max(axis=-1)
        if (beyond >= 0).any():
            k = int(np.argmax(beyond))
            raise InvalidArgument(
                f"limits exclude the reference: at t = {t[k]:g} s it needs an input of {plan.u[k].tolist()}, "
                f"expected limits above that, and not {self.range[1].tolist()}"
            )
        none = np.zeros(self.robot.nv)
        return plan, 0, (0.0, none), np.zeros(plan.u.shape[-1]), np.zeros(plan.u.shape[-1]), dt

    @property
    def _observes(self) -> bool:
        return self.observer > 0 and not hasattr(self.robot, "independent")

    def applied(self, u: Array, state: tuple[Any, ...]) -> tuple[Any, ...]:
        """Return the state, told of the input that is applied, shape (nu,)."""
        plan, k, (begun, integral), asked, estimate, dt = state
        if self._observes:
            integral = integral + dt * (u - asked)
        return plan, k, (begun, integral), u, estimate, dt

    def signals(self, state: tuple[Any, ...]) -> dict[str, Any]:
        """Return the force that is estimated."""
        return {"disturbance": ("N, N m", state[4])}

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, ...]
    ) -> tuple[Array, tuple[Any, ...]]:
        """Return the input, shape (nu,), and the next state."""
        plan, k, (begun, integral), _, estimate, dt = state
        if not (type(q) is np.ndarray and q.ndim == 1):
            hours = _MANY * len(plan.u) * _CALL / 3600
            raise NotTraceable(
                f"MPC solves a quadratic program at each of {len(plan.u):,} samples, so that {_MANY:,} "
                f"robots take some {hours:.2g} h of a processor",
                "take LQR in Saturated, which is compiled",
            )
        rate = 0.0 * v
        if self._observes:
            estimate, integral, rate = estimated(self.robot, self.observer, q, v, begun, integral)
        errors = tracked_errors(self.robot, q, v, reference, plan.x[k][np.shape(reference.v)[-1] :])
        u = self._input(t, plan, k, -errors, estimate)
        if self._observes:
            integral = integral + dt * (u + rate)
        return u, (plan, min(k + 1, len(plan.u) - 1), (1.0, integral), u, estimate, dt)

    def _input(self, t: float, plan: _Plan, k: int, dx: Array, estimate: Array) -> Array:
        """Return the first input of the horizon."""
        at = np.minimum(k + plan.stride * np.arange(self.horizon + 1), len(plan.u) - 1)
        free, states, x = [], [], dx
        for i in at[:-1]:
            du = -plan.K[i] @ x
            free.append(du)
            x = plan.A[i] @ x + plan.B[i] @ du
            states.append(x)
        wanted = plan.u[at[:-1]] - estimate
        inputs, ahead = np.array(free), np.array(states)
        low, high = self.range[0] - wanted - inputs, self.range[1] - wanted - inputs
        desired = plan.x[at[1:]]
        under, over = np.asarray(self.lower) - desired - ahead, np.asarray(self.upper) - desired - ahead
        if (low <= 0).all() and (high >= 0).all() and (under <= 0).all() and (over >= 0).all():
            return np.asarray(wanted[0] + inputs[0])
        w = self._solved(t, dx, self._problem(plan, at[:-1], low, high, under, over))
        return np.asarray(np.clip(wanted[0] + inputs[0] + w, *self.range))

    def _problem(self, plan: _Plan, at: Any, low: Array, high: Array, under: Array, over: Array) -> _Problem:
        """Return the program of what is added to the gains' inputs: its cost has a block for each step."""
        N, nu, size = len(at), plan.u.shape[-1], plan.A.shape[-1]
        H, inputs, states = np.zeros((N * nu, N * nu)), np.zeros((N, nu, N * nu)), np.zeros((N, size, N * nu))
        x = np.zeros((size, N * nu))
        for j, i in enumerate(at):
            own = slice(j * nu, (j + 1) * nu)
            H[own, own] = plan.S[i]
            inputs[j] = -plan.K[i] @ x
            inputs[j][:, own] = np.eye(nu)
            x = plan.A[i] @ x + plan.B[i] @ inputs[j]
            states[j] = x
        kept = np.isfinite(np.asarray(self.lower)) | np.isfinite(np.asarray(self.upper))
        rows = np.concatenate([inputs.reshape(N * nu, -1), states[:, kept].reshape(-1, N * nu)])
        sense = np.full(len(rows), _SOFT, np.int32)
        sense[: N * nu] = 0
        lower = np.concatenate([low.ravel(), under[:, kept].ravel()])
        return _Problem(H, rows, lower, np.concatenate([high.ravel(), over[:, kept].ravel()]), sense)

    def _solved(self, t: float, dx: Array, problem: _Problem) -> Array:
        """Return the first nu numbers of the solution."""
        solve, nothing = _solver(), np.zeros(len(problem.H))
        H, A, lower, upper, sense = problem
        w, _, flag, _ = solve(H, nothing, A, upper, lower, sense, primal_tol=_TIGHT)
        if flag < 1 or not np.isfinite(w).all():
            raise NotSolved(
                f"the quadratic program of MPC at t = {t:g} s has no solution (daqp says {flag}), expected "
                "numbers that are finite; the error has its state and problem",
                time=t,
                state=dx,
                problem=problem._asdict(),
            )
        return np.asarray(w[: self.range[0].size])


def _solver() -> Any:
    try:
        from daqp import solve
    except ImportError:
        raise InvalidArgument(
            "MPC needs the package daqp, which is not installed: pip install 'pinmobile[mpc]'"
        ) from None
    return solve
