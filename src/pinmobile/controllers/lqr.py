"""`LQR` along a reference, the linear model along it, and stability checks of sampled loops."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cached_property, partial
from typing import Any, NamedTuple, TypeVar, final
from weakref import WeakKeyDictionary

import attrs
import numpy as np

from pinmobile.arrays import Array, ArrayLike, bisect, finite, frozen, shaped, symmetric
from pinmobile.compiled import is_constant
from pinmobile.controllers.controller import State
from pinmobile.errors import InvalidArgument, NotTraceable, argument_errors
from pinmobile.parts import Electric, Followed, Linearized, Rolling, able, child, number, option, part
from pinmobile.plant import Context, Input, check_coordinates, full_configurations, inputs_of

_BASE = 3
_CACHE_SIZE = 4  # cached designs per robot
_SYMMETRY_TOLERANCE = 1e-9  # tolerance of symmetry, relative to the largest entry
_SPEED_TOLERANCE = 1e-6  # [m/s, rad/s]; a reference below it is at rest
_T = TypeVar("_T")


class TrackedModel(NamedTuple):
    """Linear model of the tracked state along a reference.

    The state contains the errors of the reference's n coordinates and of the m independent velocities. For a
    robot driven by forces, these are its v.

    Attributes
    ----------
    A, B : ndarray, shape (N + 1, n + m, n + m), (N + 1, n + m, nu)
        Model at each sample: d(dx)/dt = A dx + B du.
    u, nu : ndarray, shape (N + 1, nu), (N + 1, m)
        Input and independent velocities of the reference.
    """

    A: Array
    B: Array
    u: Array
    nu: Array

    def discrete(self, h: float) -> tuple[Array, Array]:
        """Return A and B of a step h with zero-order hold, by the matrix exponential.

        Parameters
        ----------
        h : float
            Time between two samples [s].
        """
        from scipy.linalg import expm

        k, n, m = self.B.shape
        block = np.zeros((k, n + m, n + m))
        block[:, :n, :n], block[:, :n, n:] = self.A, self.B
        exponential = expm(h * block)
        return exponential[:, :n, :n], exponential[:, :n, n:]


def tracked_model(robot: Any, reference: State) -> TrackedModel:
    """Return the linear model of a robot along a reference.

    Parameters
    ----------
    robot : MobileRobot or WheeledRobot
        The model.
    reference : Reference
        q, v and a at all samples, shape (N + 1, ...).

    Raises
    ------
    InvalidArgument
        If the reference does not contain all tracked coordinates, or the wheels cannot follow it.
    """
    try:
        body = getattr(robot, "array_dynamics", robot)  # the same in all engines
    except NotTraceable:
        body = robot
    if follower := able(body, Followed):
        motion = follower.followed(reference)
        A, B = body.linearize_tracked(motion.q, motion.v, motion.u)
        return TrackedModel(A, B, motion.u, motion.nu)
    q, v, a = reference.q, reference.v, reference.a
    hint = " of the robot: for a motion of base and arms use WholeBody(robot, base, *joints)"
    check_coordinates(v, body.nv, hint)
    u = body.inverse_dynamics(q, v, a)
    A, B = body.linearize_tracked(q, v, u)
    return TrackedModel(A, B, np.asarray(u), v)


class WeightedLaw:
    """Base class of laws with weights of errors and inputs of a robot along a reference."""

    robot: Any
    Q: Any
    R: Any
    input_weight: float

    @cached_property
    def _sizes(self) -> tuple[int, int, int]:
        """Numbers of tracked coordinates, independent velocities and inputs."""
        robot, zeros = self.robot, np.zeros(self.robot.nv)
        A, B = robot.linearize_tracked(robot.rest, zeros, np.zeros(robot.nu))
        m = len(robot.reduced(robot.rest, zeros).nu) if able(robot, Rolling) else int(robot.nv)
        return A.shape[-1] - m, m, B.shape[-1]

    @cached_property
    def _default_weights(self) -> tuple[Array, Array]:
        """Default weights of the tracked state and of the input, as diagonals.

        Errors cost 400 / m^2 and 100 / rad^2, velocities 20 and 5, forces 1e-3 / N^2, moments 2e-2 / (N m)^2.
        A voltage costs as much as the torque that it produces at rest.
        """
        robot, (n, m, _) = self.robot, self._sizes
        arms = n - _BASE
        base = {3: (20.0, 20.0, 5.0), 2: (20.0, 5.0), 1: (20.0,)}[m - arms]
        units = [entry.unit for entry in robot.coordinates[_BASE:n]]
        positions = [400.0, 400.0, 100.0, *(400.0 if unit == "m" else 100.0 for unit in units)]
        velocities = [*base, *(20.0 if unit == "m" else 5.0 for unit in units)]
        inputs: tuple[Input, ...] = inputs_of(robot)
        costs = np.array([1e-3 if entry.unit == "N" else 2e-2 for entry in inputs])
        if able(robot, Electric):
            largest = np.array([entry.upper if entry.unit == "V" else 1.0 for entry in inputs])
            costs *= (robot.torques_at(np.zeros(robot.nv), largest) / largest) ** 2
        return np.array(positions + velocities), costs

    def check(self) -> None:
        """Raise `InvalidArgument` if a weight has another size than its errors or inputs."""
        n, m, inputs = self._sizes
        for name, size in (("Q", n + m), ("R", inputs)):
            shaped(name, getattr(self, name), (size, size), words=f", or its diagonal, shape ({size},)")


def weight_field(index: int, doc: str) -> Any:
    """Declare Q or R of a `WeightedLaw`: a diagonal or a matrix, stored as a matrix."""
    default = attrs.Factory(lambda self: self._default_weights[index], takes_self=True)
    return option(default=default, doc=doc, check=partial(weight, above=index == 1))


def weight(name: str, value: ArrayLike, *, above: bool) -> Array:
    """Return a weight, a diagonal of shape (n,) or a matrix, as a read-only matrix after a check.

    Parameters
    ----------
    name : str
        Name of the argument.
    value : array_like
        The weight.
    above : bool
        Whether it must be positive definite; otherwise positive semidefinite.

    Raises
    ------
    InvalidArgument
        If it has another shape, or is not symmetric or not definite.
    """
    values = shaped(name, finite(name, value), ("n>=1",), ("n>=1", "n"))
    matrix = np.diag(values) if values.ndim == 1 else values
    largest = np.abs(symmetric(name, matrix, _SYMMETRY_TOLERANCE)).max()
    lowest = float(np.linalg.eigvalsh(matrix)[0])
    if not (lowest > 0 if above else lowest >= -_SYMMETRY_TOLERANCE * largest):
        definite = "positive definite" if above else "positive semidefinite"
        raise InvalidArgument(f"{name} has the eigenvalue {lowest:.3g}, expected a {definite} matrix")
    return frozen(matrix)


def full_reference(context: Context, robot: Any) -> Any:
    """Return the reference at all samples after a check that model and plant have the same inputs.

    Parameters
    ----------
    context : Context
        Context of the controller's initialisation.
    robot : robot
        Controller model.

    Raises
    ------
    InvalidArgument
        If the context has no reference, as in calls by hand, or only one of model and plant takes voltages.
    """
    plant, model = ([entry.unit for entry in inputs] for inputs in (context.inputs, inputs_of(robot)))
    if len(plant) == len(model) and ([unit == "V" for unit in plant] != [unit == "V" for unit in model]):
        raise InvalidArgument(
            f"robot has inputs in {', '.join(model)}, and the plant in {', '.join(plant)}, expected a "
            "model with the inputs of the plant: robot.by_voltage() takes volts, and "
            "TorqueToVoltage(controller, robot) "
            "turns torques into volts"
        )
    return context.reference


def check_motion(robot: Any, reference: Any, nu: Array, t: float) -> None:
    """Raise an error for a reference that ends at rest, if the robot cannot move in every direction.

    At rest the linear model of such a robot is not controllable: no input moves it sideways.

    Raises
    ------
    InvalidArgument
        If the reference ends at rest and the robot cannot move sideways.
    """
    if nu.shape[-1] < reference.v.shape[-1] and np.abs(reference.v[-1, :_BASE]).max() < _SPEED_TOLERANCE:
        raise InvalidArgument(
            f"reference ends at rest, at t = {t:g} s, where a {type(robot).__name__} that cannot move "
            "sideways has no controllable linear model, so that no gain exists; expected a reference that "
            "still moves at its end, a shorter duration=, or Backstepping(law, robot)"
        )


_designs: WeakKeyDictionary[Any, dict[Any, Any]] = WeakKeyDictionary()


def memoize(robot: Any, label: tuple[object, ...], arrays: tuple[Array, ...], make: Callable[[], _T]) -> _T:
    """Return a result that depends on a robot and some arrays, from the cache or computed.

    Parameters
    ----------
    robot : robot
        Robot; the cache holds results of immutable robots only.
    label : tuple
        Other values on which the result depends.
    arrays : tuple of ndarray
        Arrays on which the result depends.
    make : callable
        Function that computes the result.
    """
    if not is_constant(robot):
        return make()
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(f"{array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    designs = _designs.setdefault(robot, {})
    key = (*label, digest.digest())
    design = designs.get(key)
    if design is None:
        design = make()
        for old in list(designs)[: max(0, len(designs) - _CACHE_SIZE + 1)]:
            designs.pop(old, None)
        designs[key] = design
    return design


def tracked_errors(robot: Any, q: Array, v: Array, reference: State, nu: Array) -> Array:
    """Return the errors of the tracked state, shape (..., n + m), from a reference and its nu."""
    if not able(robot, Rolling):
        return np.concatenate([robot.difference(q, reference.q), nu - v], axis=-1)
    errors = robot.difference(q, full_configurations(q, reference.q))[..., : np.shape(reference.v)[-1]]
    return np.concatenate([errors, nu - robot.independent(q, v)], axis=-1)


_EIGENVALUE_ERROR = 1e-7  # numerical error of a double eigenvalue at 1
_STEP_FRACTION = 1e-3  # of a time step; a smaller bound counts as none


def double_integrators(dt: float, kp: Array, kd: Array, ki: Array) -> Array:
    """Return the matrix of x'' = u, u = -kp x - kd x' + ki z, z' = -x, with zero-order hold.

    Its shape is (..., 3 n, 3 n). Explicit Euler integrates z after u. Gains are matrices, shape (..., n, n).
    """
    kp, kd, ki = np.broadcast_arrays(kp, kd, ki)
    eye = np.eye(kp.shape[-1])
    force = np.concatenate([-kp, -kd, ki], axis=-1)
    rows = ([eye, dt * eye, 0 * eye], [0 * eye, eye, 0 * eye], [-dt * eye, 0 * eye, eye])
    pushes = np.concatenate([dt * dt / 2 * eye, dt * eye, 0 * eye])
    return np.asarray(np.block([list(row) for row in rows]) + pushes @ force)


def diagonal(gain: Array) -> Array:
    """Return gains of each coordinate, shape (..., n), as diagonal matrices."""
    return np.asarray(gain[..., None] * np.eye(gain.shape[-1]))


def check_gains(gains: Callable[[], dict[str, Any]], loop: Callable[[float], Array], dt: float) -> None:
    """Check that a sampled loop with an exact model of a rigid robot is stable.

    Symbolic gains, which differ between the robots of an ensemble, are not checked.

    Parameters
    ----------
    gains : callable
        Function that returns gains by name, for the message.
    loop : callable
        ``loop(dt)``: matrix from the error at one sample to that at the next, shape (..., k, k).
    dt : float
        Time between two samples [s].

    Raises
    ------
    InvalidArgument
        If an eigenvalue lies outside the unit circle; the message gives the largest stable time step.
    """

    def is_stable(step: float) -> bool:
        return bool((np.abs(np.linalg.eigvals(loop(step))) <= 1 + _EIGENVALUE_ERROR).all())

    try:
        given = {name: np.asarray(gain, np.float64) for name, gain in gains().items()}
        if is_stable(dt):
            return
    except (NotTraceable, TypeError):
        return
    words = ", ".join(f"{name} = {np.unique(gain).tolist()}" for name, gain in given.items())
    good, _ = bisect(0.0, dt, is_stable)
    fault = f"with a zero-order hold of dt = {dt:g} s, expected dt < {good:.3g} s, or smaller gains"
    if good < _STEP_FRACTION * dt:
        fault = "at any dt, expected other gains"
    raise InvalidArgument(f"gains {words} are unstable {fault}")


@final
@part
class LQR(WeightedLaw):
    """Linear quadratic regulator along a reference, u = u_d + K(t) (e; e_v), with gains at each sample.

    u_d is the reference's input. With A and B of the linear model at each sample, with zero-order hold::

        K_k = (R + B' P B)^-1 B' P A,   P_k = Q + A' P_{k+1} (A - B K_k),

    with P = P_{k+1} (Anderson and Moore, 1990); after the end, P is the infinite-horizon solution of the last
    A and B. e contains the errors of the reference's coordinates, and e_v those of the independent
    velocities: v of a robot driven by forces; on wheels, those of `WheeledRobot.reduced`, such as speed and
    yaw rate of a differential drive. To first order, this law minimises the sum of e' Q e + du' R du. The
    gains follow from the reference. All robots of a compiled ensemble share them: an ensemble that spreads
    ``input_weight`` or the controller model runs its robots one by one.

    Parameters
    ----------
    robot : MobileRobot or WheeledRobot
        Controller model, without steered wheels. For the result of ``by_voltage()``, inputs are voltages, and
        the model includes back-EMF and friction of the motors.
    Q : array_like, shape (n + m,) or (n + m, n + m), optional
        Weight of the errors of n coordinates and m velocities, positive semidefinite. Default: 400 / m^2,
        100 / rad^2, and 20 and 5 for their rates.
    R : array_like, shape (nu,) or (nu, nu), optional
        Weight of the input relative to the reference's, positive definite. Default: 1e-3 / N^2, 2e-2 / (N
        m)^2; a voltage costs as much as the torque that it produces at rest.
    input_weight : float
        Factor of R, > 0.

    Raises
    ------
    InvalidArgument
        If a weight has another shape or is not definite, or the robot steers wheels; at the start of a run,
        if the reference does not contain all coordinates of body and arms, the wheels cannot follow it, it
        ends at rest for a drive that cannot move sideways, or only one of model and plant takes voltages.

    See Also
    --------
    MPC : the same cost with limits of inputs
    ComputedTorque : feedback linearisation
    Backstepping : law for references that end at rest

    Examples
    --------
    >>> from pinmobile import LQR, Circle, MobileRobot
    >>> from pinmobile import Tangent, simulate
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> path = Tangent(Circle(radius=3.0, rate=0.1, duration=1.0))
    >>> for weight in 1.0, 100.0:
    ...     law = LQR(robot, input_weight=weight)
    ...     run = simulate(robot, law, path, dt=0.05, q0=[0.1, 0, 0])
    ...     print(f"at most {run.max_input()[0]:.0f} N")
    at most 52 N
    at most 6 N
    """

    robot: Any = child(Linearized, doc="model of the controller")
    Q: Any = weight_field(0, "weight of the errors")
    R: Any = weight_field(1, "weight of the input")
    input_weight: float = number(default=1.0, above=0.0, doc="factor of R, the weight of the input")

    def initial_state(self, context: Context) -> tuple[Any, Any, Any]:
        """Return the inputs, velocities and gains at all samples, as schedules."""
        reference = full_reference(context, self.robot)
        Q, R = self.Q, self.input_weight * self.R
        dt, t = float(context.dt), np.asarray(context.t)

        def design() -> tuple[Array, Array, Array]:
            model = tracked_model(self.robot, reference)
            check_motion(self.robot, reference, model.nu, float(t[-1]))
            gains, _ = riccati(*model.discrete(dt), Q, R)
            return frozen(model.u), frozen(model.nu), frozen(gains)

        arrays = (*reference, Q, R)
        return tuple(map(context.schedule, memoize(self.robot, ("LQR", dt), arrays, design)))  # type: ignore[return-value]

    def __call__(
        self, t: float, q: Array, v: Array, reference: State, state: tuple[Any, Any, Any]
    ) -> tuple[Array, tuple[Any, Any, Any]]:
        """Return the input, shape (..., nu), and the next state."""
        (u, next_u), (nu, next_nu), (gains, next_gains) = (schedule.next() for schedule in state)
        errors = tracked_errors(self.robot, q, v, reference, nu)
        return u + np.sum(gains * errors[..., None, :], axis=-1), (next_u, next_nu, next_gains)


def riccati(A: Array, B: Array, Q: Array, R: Array, stride: int = 1) -> tuple[Array, Array]:
    """Return gains and costs to go at all samples, backward from the infinite horizon of the last pair.

    Parameters
    ----------
    A, B : ndarray, shape (N + 1, n, n), (N + 1, n, nu)
        Model of the step from each sample over `stride` samples.
    Q, R : ndarray, shape (n, n), (nu, nu)
        Weights.
    stride : int
        Number of samples of a step; after the end, the last pair remains.

    Returns
    -------
    K, P : ndarray, shape (N + 1, nu, n), (N + 1 + stride, n, n)

    Raises
    ------
    InvalidArgument
        If the last pair is not controllable.
    """
    from scipy.linalg import solve_discrete_are

    K, P = np.empty(B.swapaxes(-1, -2).shape), np.empty((len(A) + stride, *Q.shape))
    with argument_errors(
        "robot has no controllable linear model at the end of the reference: ",
        "; expected a motor for each degree of freedom, and Q that weighs every coordinate",
        of=(np.linalg.LinAlgError, ValueError),
    ):
        last = solve_discrete_are(A[-1], B[-1], Q, R)
    P[len(A) :] = (last + last.T) / 2
    for k in reversed(range(len(A))):
        BP = B[k].T @ P[k + stride]
        K[k] = np.linalg.solve(R + BP @ B[k], BP @ A[k])
        cost = Q + A[k].T @ P[k + stride] @ (A[k] - B[k] @ K[k])
        P[k] = (cost + cost.T) / 2
    return K, P
