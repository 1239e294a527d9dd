"""`LQR` along a reference, the tracked linear model, and the stability of sampled loops."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cached_property, partial
from typing import Any, NamedTuple, TypeVar, final
from weakref import WeakKeyDictionary

import attrs
import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, frozen, shaped
from pinmobile.compiled import is_constant
from pinmobile.controllers.controller import State, completed
from pinmobile.errors import InvalidArgument, NotTraceable
from pinmobile.parts import Electric, Followed, Linearized, Rolling, able, child, number, option, part
from pinmobile.plant import Context, Input, inputs_of

_BASE = 3
_MOST = 4  # designs that are remembered of a robot
_SYMMETRIC = 1e-9  # of the largest number, by which a matrix may differ from its transpose
_STILL = 1e-6  # [m/s, rad/s], below which a reference is at rest
_T = TypeVar("_T")


class TrackedModel(NamedTuple):
    """First-order model of the tracked state, and what goes along the reference.

    Its state is the error of the reference's coordinates, of which there are n, and of the independent
    velocities, m of them: of a robot that is pushed they are its v.

    Attributes
    ----------
    A, B : ndarray, shape (N + 1, n + m, n + m), (N + 1, n + m, nu)
        Of each sample: d(dx)/dt = A dx + B du.
    u, nu : ndarray, shape (N + 1, nu), (N + 1, m)
        Input and independent velocities of the reference.
    """

    A: Array
    B: Array
    u: Array
    nu: Array

    def discrete(self, h: float) -> tuple[Array, Array]:
        """Return A and B of a step h with the input held, by the matrix exponential.

        Parameters
        ----------
        h : float
            Time between two samples [s].
        """
        from scipy.linalg import expm

        k, n, m = self.B.shape
        whole = np.zeros((k, n + m, n + m))
        whole[:, :n, :n], whole[:, :n, n:] = self.A, self.B
        found = expm(h * whole)
        return found[:, :n, :n], found[:, :n, n:]


def tracked_model(robot: Any, reference: State) -> TrackedModel:
    """Return the first-order model of a robot along a reference.

    Parameters
    ----------
    robot : MobileRobot or WheeledRobot
        The model.
    reference : Reference
        q, v and a at all samples, shape (N + 1, ...).

    Raises
    ------
    InvalidArgument
        If it has not all tracked coordinates, or wheels cannot follow it.
    """
    try:
        body = getattr(robot, "array_dynamics", robot)  # the same in all engines
    except NotTraceable:
        body = robot
    if following := able(body, Followed):
        along = following.followed(reference)
        A, B = body.linearize_tracked(along.q, along.v, along.u)
        return TrackedModel(A, B, along.u, along.nu)
    q, v, a = reference.q, reference.v, reference.a
    if v.shape[-1] != body.nv:
        raise InvalidArgument(
            f"reference has {v.shape[-1]} coordinates, expected all of the robot, {body.nv}: a motion of "
            "base and arms is WholeBody(robot, base, *joints)"
        )
    u = body.inverse_dynamics(q, v, a)
    A, B = body.linearize_tracked(q, v, u)
    return TrackedModel(A, B, np.asarray(u), v)


class Weighted:
    """What weighs the errors of a robot along a reference, and its inputs."""

    robot: Any
    Q: Any
    R: Any
    input_weight: float

    @cached_property
    def _sizes(self) -> tuple[int, int, int]:
        """How many coordinates are tracked, independent velocities and inputs there are."""
        robot, still = self.robot, np.zeros(self.robot.nv)
        A, B = robot.linearize_tracked(robot.rest, still, np.zeros(robot.nu))
        m = len(robot.reduced(robot.rest, still).nu) if able(robot, Rolling) else int(robot.nv)
        return A.shape[-1] - m, m, B.shape[-1]

    @cached_property
    def _usual(self) -> tuple[Array, Array]:
        """The usual weights of the tracked state and of the input, as diagonals.

        Errors cost 400 / m^2 and 100 / rad^2, of velocities 20 and 5, forces 1e-3 / N^2, moments
        2e-2 / (N m)^2, and volts what the torque costs that they give at rest.
        """
        robot, (n, m, _) = self.robot, self._sizes
        arms = n - _BASE
        own = {3: (20.0, 20.0, 5.0), 2: (20.0, 5.0), 1: (20.0,)}[m - arms]
        units = [each.unit for each in robot.coordinates[_BASE:n]]
        places = [400.0, 400.0, 100.0, *(400.0 if unit == "m" else 100.0 for unit in units)]
        speeds = [*own, *(20.0 if unit == "m" else 5.0 for unit in units)]
        inputs: tuple[Input, ...] = inputs_of(robot)
        costs = np.array([1e-3 if each.unit == "N" else 2e-2 for each in inputs])
        if able(robot, Electric):
            largest = np.array([each.upper if each.unit == "V" else 1.0 for each in inputs])
            costs *= (robot.torques_at(np.zeros(robot.nv), largest) / largest) ** 2
        return np.array(places + speeds), costs

    def check(self) -> None:
        """Raise `InvalidArgument` where a weight has not the size of what it weighs."""
        n, m, inputs = self._sizes
        for name, size in (("Q", n + m), ("R", inputs)):
            shaped(name, getattr(self, name), (size, size), words=f", or its diagonal, shape ({size},)")


def weighting(index: int, doc: str) -> Any:
    """Declare Q or R of what is `Weighted`: a diagonal or a matrix, kept as matrix."""
    usual = attrs.Factory(lambda self: self._usual[index], takes_self=True)
    return option(default=usual, doc=doc, check=partial(weight, above=index == 1))


def weight(name: str, value: ArrayLike, *, above: bool) -> Array:
    """Check a weight, a diagonal of shape (n,) or a matrix, and return the matrix, frozen.

    Parameters
    ----------
    name : str
        Of the argument.
    value : array_like
        The weight.
    above : bool
        Whether it must be positive definite; else semidefinite.

    Raises
    ------
    InvalidArgument
        If it is something else.
    """
    given = shaped(name, finite(name, value), ("n>=1",), ("n>=1", "n"))
    matrix = np.diag(given) if given.ndim == 1 else given
    largest = np.abs(matrix).max()
    if np.abs(matrix - matrix.T).max() > _SYMMETRIC * largest:
        raise InvalidArgument(f"{name} is not symmetric, expected a symmetric matrix")
    least = float(np.linalg.eigvalsh(matrix)[0])
    if not (least > 0 if above else least >= -_SYMMETRIC * largest):
        definite = "positive definite" if above else "positive semidefinite"
        raise InvalidArgument(f"{name} has the eigenvalue {least:.3g}, expected a {definite} matrix")
    return frozen(matrix)


def whole_reference(context: Context, robot: Any) -> Any:
    """Return the reference of all samples, along which a robot is linearised whose inputs are the plant's.

    Parameters
    ----------
    context : Context
        What a controller is told before the first sample.
    robot : robot
        The model that it believes in.

    Raises
    ------
    InvalidArgument
        If the context has none, as in calls by hand, or one takes volts and the other does not.
    """
    theirs, own = ([each.unit for each in inputs] for inputs in (context.inputs, inputs_of(robot)))
    if len(theirs) == len(own) and ([unit == "V" for unit in theirs] != [unit == "V" for unit in own]):
        raise InvalidArgument(
            f"robot has inputs in {', '.join(own)}, and what is driven in {', '.join(theirs)}, expected a "
            "robot of the same inputs: by_voltage() of wheels takes volts, and "
            "TorqueToVoltage(controller, robot) "
            "gives volts for torques"
        )
    if context.reference is None:
        raise InvalidArgument(
            "context has no reference, along which the robot is linearised, expected "
            "Context.of(plant, dt=..., t=..., reference=...)"
        )
    return context.reference


def check_moves(robot: Any, reference: Any, nu: Array, t: float) -> None:
    """Refuse a reference that ends at rest, of a robot that cannot move in every direction.

    There the first-order model cannot be controlled: no force moves it sideways.

    Raises
    ------
    InvalidArgument
        If it is such.
    """
    if nu.shape[-1] < reference.v.shape[-1] and np.abs(reference.v[-1, :_BASE]).max() < _STILL:
        raise InvalidArgument(
            f"reference ends at rest, at t = {t:g} s, where a {type(robot).__name__} that cannot move "
            "sideways cannot be controlled to first order, so that no gain exists; expected a reference that "
            "still moves at its end, a shorter duration=, or Backstepping(law, robot)"
        )


_designs: WeakKeyDictionary[Any, dict[Any, Any]] = WeakKeyDictionary()


def remembered(robot: Any, what: tuple[object, ...], arrays: tuple[Array, ...], make: Callable[[], _T]) -> _T:
    """Return what follows from a robot and some arrays, made once.

    Parameters
    ----------
    robot : robot
        What is constant is remembered with it.
    what : tuple
        What else it follows from.
    arrays : tuple of ndarray
        What it follows from.
    make : callable
        Makes it.
    """
    if not is_constant(robot):
        return make()
    digest = hashlib.sha256()
    for each in arrays:
        digest.update(f"{each.shape}".encode() + np.ascontiguousarray(each).tobytes())
    designs = _designs.setdefault(robot, {})
    key = (*what, digest.digest())
    found = designs.get(key)
    if found is None:
        found = make()
        for old in list(designs)[: max(0, len(designs) - _MOST + 1)]:
            designs.pop(old, None)
        designs[key] = found
    return found


def tracked_errors(robot: Any, q: Array, v: Array, reference: State, nu: Array) -> Array:
    """Return the errors of the tracked state, shape (..., n + m), of a state from a reference and its nu."""
    if not able(robot, Rolling):
        return np.concatenate([robot.difference(q, reference.q), nu - v], axis=-1)
    errors = robot.difference(q, completed(q, reference.q))[..., : np.shape(reference.v)[-1]]
    return np.concatenate([errors, nu - robot.independent(q, v)], axis=-1)


_ROUNDING = 1e-7  # by which an eigenvalue of a double root at 1 is computed too large
_SHARE = 1e-3  # of a time step, below which a bound is none


def double_integrators(dt: float, kp: Array, kd: Array, ki: Array) -> Array:
    """Return the loop of x'' = u, u = -kp x - kd x' + ki z, z' = -x, with u held, shape (..., 3 n, 3 n).

    The integral z is summed by explicit Euler after u. Gains are matrices, shape (..., n, n).
    """
    kp, kd, ki = np.broadcast_arrays(kp, kd, ki)
    one = np.eye(kp.shape[-1])
    force = np.concatenate([-kp, -kd, ki], axis=-1)
    rows = ([one, dt * one, 0 * one], [0 * one, one, 0 * one], [-dt * one, 0 * one, one])
    pushes = np.concatenate([dt * dt / 2 * one, dt * one, 0 * one])
    return np.asarray(np.block([list(row) for row in rows]) + pushes @ force)


def diagonal(gain: Array) -> Array:
    """Return gains of each coordinate, shape (..., n), as matrices."""
    return np.asarray(gain[..., None] * np.eye(gain.shape[-1]))


def check_held(gains: Callable[[], dict[str, Any]], loop: Callable[[float], Array], dt: float) -> None:
    """Refuse gains with which a loop of a rigid robot, its model exact, is unstable at this time step.

    Gains that are symbols, of robots that each have their own, are not looked at.

    Parameters
    ----------
    gains : callable
        Returns them by name, for the message.
    loop : callable
        ``loop(dt)`` returns the matrix from one sample's error to the next one's, shape (..., k, k).
    dt : float
        Time between two samples [s].

    Raises
    ------
    InvalidArgument
        If an eigenvalue lies outside the unit circle; with the longest time step at which none does.
    """

    def is_stable(step: float) -> bool:
        return bool((np.abs(np.linalg.eigvals(loop(step))) <= 1 + _ROUNDING).all())

    try:
        given = {name: np.asarray(gain, np.float64) for name, gain in gains().items()}
        if is_stable(dt):
            return
    except (NotTraceable, TypeError):
        return
    words = ", ".join(f"{name} = {np.unique(gain).tolist()}" for name, gain in given.items())
    good, bad = 0.0, dt
    for _ in range(40):
        middle = (good + bad) / 2
        good, bad = (middle, bad) if is_stable(middle) else (good, middle)
    if good < _SHARE * dt:
        raise InvalidArgument(f"gains {words} are unstable at any dt, expected others")
    raise InvalidArgument(
        f"gains {words} are unstable with an input that is held for dt = {dt:g} s, expected "
        f"dt < {good:.3g} s, or smaller gains"
    )


@final
@part
class LQR(Weighted):
    """The linear quadratic regulator along a reference, u = u_d + K(t) (e; e_v), with gains of each sample.

    Of the reference's input u_d, and of A and B of the model about each sample with the input held, it takes

        K_k = (R + B' P B)^-1 B' P A,   P_k = Q + A' P_{k+1} (A - B K_k),

    with P = P_{k+1} (Anderson and Moore, 1990), and after the end that of the last A and B for ever. Errors
    are of the reference's coordinates, e, and of the independent velocities, e_v: of a robot that is pushed,
    v; on wheels, those of `WheeledRobot.reduced`, such as speed and yaw rate of a differential drive. To
    first order, nothing makes the sum of e' Q e + du' R du smaller. The gains follow from the reference, and
    are the same for all robots of a compiled ensemble: one that spreads ``input_weight`` or the
    controller's model runs them one after another.

    Parameters
    ----------
    robot : MobileRobot or WheeledRobot
        The model that the controller believes in; wheels must not steer. Of what ``by_voltage()`` returns,
        inputs are volts, and the model has the motors' back-EMF and friction.
    Q : array_like, shape (n + m,) or (n + m, n + m), optional
        Weight of the n errors of coordinates and m of velocities, positive semidefinite. By default
        400 / m^2, 100 / rad^2, and 20 and 5 of their rates.
    R : array_like, shape (nu,) or (nu, nu), optional
        Weight of the input beside the reference's, positive definite. By default 1e-3 / N^2, 2e-2 / (N m)^2,
        and of volts what the torque costs that they give at rest.
    input_weight : float
        Factor of R, > 0.

    Raises
    ------
    InvalidArgument
        If an argument is something else, or wheels steer; at the start of a run, if the reference has not all
        coordinates of body and arms, wheels cannot follow it, or it ends at rest on a drive that cannot move
        sideways, or if one of robot and plant takes volts.
    """

    robot: Any = child(Linearized, doc="model of the controller")
    Q: Any = weighting(0, "weight of the errors")
    R: Any = weighting(1, "weight of the input")
    input_weight: float = number(default=1.0, above=0.0, doc="factor of R, the weight of the input")

    def initial_state(self, context: Context) -> tuple[Any, Any, Any]:
        """Return the inputs, velocities and gains of all samples, as schedules."""
        reference = whole_reference(context, self.robot)
        Q, R = self.Q, self.input_weight * self.R
        dt, t = float(context.dt), np.asarray(context.t)

        def design() -> tuple[Array, Array, Array]:
            model = tracked_model(self.robot, reference)
            check_moves(self.robot, reference, model.nu, float(t[-1]))
            gains, _ = riccati(*model.discrete(dt), Q, R)
            return frozen(model.u), frozen(model.nu), frozen(gains)

        given = (*reference, Q, R)
        return tuple(map(context.schedule, remembered(self.robot, ("LQR", dt), given, design)))  # type: ignore[return-value]

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any, Any]
    ) -> tuple[Array, tuple[Any, Any, Any]]:
        """Return the input, shape (..., nu), and the next state."""
        (u, held), (nu, speeds), (gains, feedback) = (schedule.next() for schedule in state)
        errors = tracked_errors(self.robot, q, v, reference, nu)
        return u + np.sum(gains * errors[..., None, :], axis=-1), (held, speeds, feedback)


def riccati(A: Array, B: Array, Q: Array, R: Array, stride: int = 1) -> tuple[Array, Array]:
    """Return gains and costs to go of all samples, backward from that of the last pair for ever.

    Parameters
    ----------
    A, B : ndarray, shape (N + 1, n, n), (N + 1, n, nu)
        Of the step from each sample, which leads `stride` samples on.
    Q, R : ndarray, shape (n, n), (nu, nu)
        Weights.
    stride : int
        Samples of a step; beyond the end, the last pair stays.

    Returns
    -------
    K, P : ndarray, shape (N + 1, nu, n), (N + 1 + stride, n, n)

    Raises
    ------
    InvalidArgument
        If the last pair cannot be controlled.
    """
    from scipy.linalg import solve_discrete_are

    K, P = np.empty(B.swapaxes(-1, -2).shape), np.empty((len(A) + stride, *Q.shape))
    try:
        last = solve_discrete_are(A[-1], B[-1], Q, R)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise InvalidArgument(
            f"robot cannot be controlled to first order at the end of the reference: {error}; expected a "
            "motor for each degree of freedom, and Q that weighs every coordinate"
        ) from error
    P[len(A) :] = (last + last.T) / 2
    for k in reversed(range(len(A))):
        pushed = B[k].T @ P[k + stride]
        K[k] = np.linalg.solve(R + pushed @ B[k], pushed @ A[k])
        cost = Q + A[k].T @ P[k + stride] @ (A[k] - B[k] @ K[k])
        P[k] = (cost + cost.T) / 2
    return K, P
