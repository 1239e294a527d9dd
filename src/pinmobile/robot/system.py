"""`MultibodySystem`: a tree of joints on the DH chain, with configurations, frames, dynamics and wrenches."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property, partial, wraps
from math import isfinite
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pinocchio as pin

from pinmobile.arrays import (
    LEAST_ANGLE,
    Array,
    ArrayLike,
    broadcast,
    finite,
    finite_answer,
    frozen,
    one_of,
    shaped,
    vector,
    wrap_angle,
)
from pinmobile.errors import InvalidArgument, NotTraceable, unexpected_value
from pinmobile.parts import Desired, holds_symbols, is_tracing, numeric_context, require, structure
from pinmobile.plant import Coordinate, Input
from pinmobile.robot import recursions
from pinmobile.robot.linkage import BODY_JOINT, circular_coordinates, joints_of
from pinmobile.robot.mounts import Mount, PayloadBody, named_frames
from pinmobile.robot.recursions import PinocchioBackend

_BASE = ("x", "m", "vx"), ("y", "m", "vy"), ("psi", "rad", "yaw_rate")
_UNLIMITED = 1e8  # a limit beyond this value counts as no limit
_Method = TypeVar("_Method", bound=Callable[..., Any])


class Linearization(NamedTuple):
    """First-order model of forward dynamics at a state: d(dq, dv)/dt = A (dq, dv) + B dtau.

    Attributes
    ----------
    A : ndarray, shape (..., 2 nv, 2 nv)
        State matrix ``[[0, I], [da/dq, da/dv]]`` [1, 1/s, 1/s^2].
    B : ndarray, shape (..., 2 nv, nv)
        Input matrix ``[[0], [M^-1]]`` [1/kg, ...].

    See Also
    --------
    MobileRobot.linearize : method that returns this object
    LQR : state feedback from such a model

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> robot = MobileRobot.lecture()
    >>> A, B = robot.linearize([0, 0, 0], [0, 0, 0], [0, 0, 0])
    >>> B[3:].diagonal() * [30, 30, 0.1]  # 1/m, 1/m, 1/Icz
    array([1., 1., 1.])
    """

    A: Array
    B: Array


def by_values(fast: Callable[..., Any] | None = None, states: int = 0) -> Callable[[_Method], _Method]:
    """Return a decorator for methods: Pinocchio evaluates numbers, the dynamics in NumPy evaluate symbols.

    Parameters
    ----------
    fast : callable, optional
        Pinocchio function of one state of float64 in public order. It is tried first.
    states : int
        Number of arguments of `fast`.

    Returns
    -------
    callable
        Decorator of a method.
    """

    def decorate(method: _Method) -> _Method:
        name = method.__name__

        @wraps(method)
        def run(self: MultibodySystem, *given: Any, **options: Any) -> Any:
            if fast is not None and len(given) == states and not options:
                result = self._number_law(fast, *given)
                if result is not None:
                    return result
            symbolic = self._engine is None
            for x in (*given, *options.values()) if options else given:
                if type(x) is not np.ndarray and holds_symbols(x):
                    symbolic = True
            if symbolic:
                return self._on_symbols(name, *given, **options)
            if not is_tracing():
                return method(self, *given, **options)
            with numeric_context():
                return method(self, *given, **options)

        return run  # type: ignore[return-value]

    return decorate


class MultibodySystem:
    """Base class of a kinematic tree on the DH chain, with Pinocchio's dynamics; `MobileRobot` implements it.

    Arrays of all methods have coordinates along the last axis, in the inertial frame: configuration q = (x,
    y, psi) [m, m, rad], velocity v = dq/dt [m/s, m/s, rad/s], acceleration a [m/s^2, m/s^2, rad/s^2] and
    generalised force tau = (Fx, Fy, Mz) [N, N, N m]. The arms' joints follow, arm by arm, with one number per
    joint in the joint's unit. A continuous joint is an angle, like psi. Leading axes broadcast. All methods
    raise `InvalidArgument` for a wrong last axis and for values that are not finite. They raise
    `errors.NotFinite` if the result is not finite. Several threads may call the methods at once.

    Pinocchio computes one state at a time, in about 5 to 20 microseconds; `vectorize` compiles a method for
    many states. If an argument or a parameter of the robot is a symbol (in a law that is being compiled), the
    methods compute the same expressions with symbols. Methods that cannot do so raise `errors.NotTraceable`.

    Attributes
    ----------
    mounts : tuple of Mount
        Mounted arms.
    loads : tuple of PayloadBody
        Attached loads.

    See Also
    --------
    MobileRobot : the public class with these methods
    vectorize : compile a method for many states

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> robot = MobileRobot.lecture()
    >>> q, v = [1.0, 0.0, 0.5], [0.2, 0.0, 3.0]
    >>> robot.forward_dynamics(q, v, [30.0, 0.0, 0.1])  # [m/s^2, rad/s^2]
    array([1., 0., 1.])
    >>> print(robot.kinetic_energy(q, v))  # [J]
    1.05
    """

    _engine: Any  # a `PinocchioBackend`; None if a parameter is a symbol
    _array_ways: Any  # dynamics in NumPy for symbols; the first object with a method evaluates it
    mounts: tuple[Mount, ...]
    loads: tuple[PayloadBody, ...]

    @property
    def model(self) -> pin.Model:
        """Copy of the Pinocchio model in the chain's order, (y, x, psi, ...)."""
        return self._model.copy()

    @property
    def _model(self) -> pin.Model:
        """Pinocchio model itself; no code writes into this object."""
        return self._numeric.model

    @property
    def _numeric(self) -> PinocchioBackend:
        """Pinocchio backend; raises `NotTraceable` if a parameter of the robot is a symbol."""
        if self._engine is None:
            raise NotTraceable(
                f"the Pinocchio model of a {type(self).__name__} with symbols as parameters",
                "use its methods for dynamics and kinematics",
            )
        return self._engine  # type: ignore[no-any-return]

    @property
    def nq(self) -> int:
        """Number of entries of q."""
        return self.nv

    @structure
    def nv(self) -> int:
        """Number of entries of v and a."""
        return self._numeric.nv

    @property
    def nu(self) -> int:
        """Number of entries of the input, the generalised force."""
        return self.nv

    @structure
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Names, units and limits of the nv entries of q: x, y, psi, then the arms' joints."""
        joints = joints_of(self._model, BODY_JOINT + 1)
        arms = ((each.name, "m" if each.slides else "rad", f"{each.name}_rate") for each in joints)
        limits = zip(self.lower.tolist(), self.upper.tolist(), strict=True)
        return tuple(
            Coordinate(name, unit, *limit, rate)
            for (name, unit, rate), limit in zip((*_BASE, *arms), limits, strict=True)
        )

    @structure
    def inputs(self) -> tuple[Input, ...]:
        """Names and units of the entries of the input: Fx, Fy, Mz, then forces and torques of the arms.

        The inputs have no limits here. `effort_limit` holds the limits of the motors; `InputSaturation`
        applies these limits to a controller.
        """
        names = ["Fx", "Fy", "Mz", *(axis.name for axis in self.coordinates[BODY_JOINT:])]
        units = ["N" if axis.unit == "m" else "N m" for axis in self.coordinates]
        return tuple(map(Input, names, units))

    @structure
    def reference_sizes(self) -> Mapping[int, int]:
        """Mapping from each n that a reference may have to the number of entries of q of n coordinates."""
        return MappingProxyType({n: n for n in range(BODY_JOINT, self.nv + 1)})

    @property
    def broadcasts(self) -> bool:
        """Whether the methods accept leading axes: True."""
        return True

    @structure
    def _limits(self) -> tuple[Array, Array, Array, Array]:
        model, of_arms = self._model, np.arange(self._model.nv) >= BODY_JOINT
        low, high = model.lowerPositionLimit, model.upperPositionLimit
        has_limits = of_arms & (low < high)  # files write equal limits, or zero, for unknown limits
        lower = np.where(has_limits & (low > -_UNLIMITED), low, -np.inf)
        upper = np.where(has_limits & (high < _UNLIMITED), high, np.inf)
        sizes = model.velocityLimit, model.effortLimit
        speed, effort = (np.where(of_arms & (x > 0) & (x < _UNLIMITED), x, np.inf) for x in sizes)
        return frozen(lower), frozen(upper), frozen(speed), frozen(effort)

    @property
    def lower(self) -> Array:
        """Lower position limits, shape (nq,) [m, m, rad, ...]; -inf for no limit."""
        return self._limits[0]

    @property
    def upper(self) -> Array:
        """Upper position limits, shape (nq,) [m, m, rad, ...]; inf for no limit."""
        return self._limits[1]

    @property
    def velocity_limit(self) -> Array:
        """Limits of the absolute velocities, shape (nv,) [m/s, m/s, rad/s, ...]; inf for no limit."""
        return self._limits[2]

    @property
    def effort_limit(self) -> Array:
        """Limits of the absolute generalised forces, shape (nv,) [N, N, N m, ...]; inf for no limit."""
        return self._limits[3]

    @structure
    def _resistances(self) -> tuple[Array, Array]:
        damping, friction = np.zeros((2, self.nv))
        for mount in self.mounts:
            damping[mount.v], friction[mount.v] = mount._model.damping, mount._model.friction
        return frozen(damping), frozen(friction)

    @property
    def joint_damping(self) -> Array:
        """Viscous damping of the arms' joints from their files, shape (nv,) [N s/m, N m s/rad].

        The entries of the base are zero. The dynamics omit this damping; add ``JointFriction.of(robot)`` to
        the forces of a loop to include it.
        """
        return self._resistances[0]

    @property
    def joint_friction(self) -> Array:
        """Dry friction of the arms' joints from their files, shape (nv,) [N, N m].

        The entries of the base are zero. The dynamics omit this friction; add ``JointFriction.of(robot)`` to
        the forces of a loop to include it.
        """
        return self._resistances[1]

    @structure
    def rest(self) -> Array:
        """Configuration at the origin with arms in their reference configurations, shape (nq,).

        The neutral configuration replaces a missing reference configuration. All values are clipped to the
        limits.
        """
        q = np.zeros(self.nq)
        for mount in self.mounts:
            q[mount.q] = mount.arm.posture
        return frozen(np.clip(q, self.lower, self.upper))

    def random_configuration(self, generator: np.random.Generator, shape: tuple[int, ...] = ()) -> Array:
        r"""Return random configurations within the limits, shape (\*shape, nq) [m, m, rad, ...].

        Coordinates without limits are drawn from -pi to pi rad, positions x and y from -1 to 1 m.

        Parameters
        ----------
        generator : numpy.random.Generator
            Source of the random numbers.
        shape : tuple of int
            Leading axes of the result.

        Returns
        -------
        ndarray, shape (\*shape, nq)
            Configurations.
        """
        q = generator.uniform(-np.pi, np.pi, (*shape, self.nq))
        q[..., :2] /= np.pi
        bounded_rows = np.isfinite(self.lower) & np.isfinite(self.upper)
        ends = self.lower[bounded_rows], self.upper[bounded_rows]
        q[..., bounded_rows] = generator.uniform(*ends, (*shape, np.count_nonzero(bounded_rows)))
        return q

    @structure
    def _circular(self) -> tuple[int, ...]:
        return circular_coordinates(self._model)

    @by_values()
    def integrate(self, q: ArrayLike, dq: ArrayLike) -> Array:
        """Return the configuration q + dq, shape (..., nq) [m, m, rad, ...]; angles are not wrapped.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        dq : array_like, shape (..., nv)
            Displacement [m, m, rad, ...].
        """
        q, dq = self._q(q), self._v("dq", dq)
        broadcast(q=q, dq=dq)
        with np.errstate(over="ignore"):
            return finite_answer(q + dq, q=q, dq=dq)

    @by_values()
    def difference(self, q0: ArrayLike, q1: ArrayLike) -> Array:
        """Return the displacement q1 - q0, shape (..., nv), with psi and continuous joints in (-pi, pi].

        Parameters
        ----------
        q0, q1 : array_like, shape (..., nq)
            Configurations [m, m, rad, ...].
        """
        shape = (self.nv,)
        if not (type(q0) is type(q1) is np.ndarray and q0.shape == q1.shape == shape):
            q0, q1 = self._q(q0, "q0"), self._q(q1, "q1")
            broadcast(q0=q0, q1=q1)
        displacement = q1 - q0
        is_one = displacement.ndim == 1
        if not (isfinite(np.vdot(displacement, displacement)) if is_one else np.isfinite(displacement).all()):
            q0, q1 = self._q(q0, "q0"), self._q(q1, "q1")
            finite_answer(displacement, q0=q0, q1=q1)
        for k in self._circular:
            angle = displacement[..., k]
            if angle.ndim or not LEAST_ANGLE < angle <= np.pi:  # in a loop, angles rarely need wrapping
                displacement[..., k] = wrap_angle(angle)
        return displacement

    def _each(self, law: Callable[..., Any], **arguments: ArrayLike) -> Array:
        """Return the values of a Pinocchio function for all rows of the arguments."""
        return self._numeric.each(law, False, **arguments)

    def _of_frame(self, law: Callable[..., Any], *given: Any, **arguments: ArrayLike) -> Array:
        """Return the values of a function of a frame for all rows; `given` holds its first arguments."""
        return self._numeric.each(partial(law, *given), True, **arguments)

    def _number_law(self, law: Callable[..., Any], *arguments: Any) -> Array | None:
        """Return the value of a Pinocchio function for one state of float64; None for other arguments.

        It takes a third of the time of `_each`. A loop calls this function.
        """
        engine = self._engine
        if engine is None:
            return None
        shape = (engine.nv,)
        for x in arguments:
            if type(x) is not np.ndarray or x.shape != shape or x.dtype != np.float64:
                return None
        answer = law(engine.public, engine.data, *arguments)
        return answer.copy() if isfinite(np.vdot(answer, answer)) else None

    def _on_symbols(self, name: str, *given: Any, **options: Any) -> Any:
        """Return the result of a method if an argument or the robot contains symbols."""
        for dynamics in self._array_ways:
            if hasattr(type(dynamics), name):
                return getattr(dynamics, name)(*given, **options)
        raise NotTraceable(
            f"{name} of a {type(self).__name__}, which accepts only numbers",
            "call it outside the law, with numbers",
        )

    def _q(self, q: ArrayLike, name: str = "q") -> Array:
        return vector(name, q, self.nq)

    def _at_origin(self, q: ArrayLike) -> Array:
        """Return q, checked, with x = y = 0.

        Pinocchio works in the inertial frame. Results that do not depend on x and y lose digits if x or y is
        large.
        """
        q_0 = self._q(q).copy()
        q_0[..., :2] = 0.0
        return q_0

    def _v(self, name: str, value: ArrayLike) -> Array:
        return vector(name, value, self.nv)

    @by_values()
    def pose(self, q: ArrayLike) -> Array:
        """Return the pose (x, y, psi) of the body, shape (..., 3) [m, m, rad].

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        """
        return self._q(q)[..., :BODY_JOINT].copy()

    @by_values()
    def pose_rate(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return the time derivative of the pose of the body, shape (..., 3) [m/s, m/s, rad/s].

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        v : array_like, shape (..., nv)
            Velocity [m/s, m/s, rad/s, ...].
        """
        q, v = self._q(q), self._v("v", v)
        lead = broadcast(q=q, v=v)
        return np.array(np.broadcast_to(v[..., :BODY_JOINT], (*lead, BODY_JOINT)))

    @structure
    def _frames(self) -> dict[str, int]:
        return named_frames(self._model)

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Names of the frames: frames of the chain, ``base_link``, and ``name/...`` for each arm."""
        return tuple(self._frames)

    @property
    def end_effector(self) -> str:
        """Name of the default frame: the tip of the first arm, or the body frame if there is no arm."""
        return self.mounts[0].tip if self.mounts else "base_link"

    def frame_name(self, frame: str | None = None) -> str:
        """Return the checked name of a frame; by default, `end_effector`.

        Parameters
        ----------
        frame : str, optional
            Name of the frame, one of `frame_names`.

        Raises
        ------
        UnknownName
            If the robot has no such frame.
        """
        return self._frame(frame)[0]

    @by_values()
    def frame_pose(self, q: ArrayLike, frame: str | None = None) -> Array:
        """Return T_0_f, the pose of a frame f in the inertial frame, shape (..., 4, 4) [1, m].

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        frame : str, optional
            Name of the frame, one of `frame_names`; by default, `end_effector`.

        Raises
        ------
        UnknownName
            If the robot has no such frame.
        """
        return self._of_frame(recursions.frame_pose, self._frame(frame)[1], q=q)

    @by_values()
    def frame_jacobian(self, q: ArrayLike, frame: str | None = None) -> Array:
        """Return the Jacobian J of a frame, shape (..., 6, nv).

        J v holds the velocity of the frame's origin and the angular velocity, along the axes of the inertial
        frame [m/s, rad/s].

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        frame : str, optional
            Name of the frame, one of `frame_names`; by default, `end_effector`.

        Raises
        ------
        UnknownName
            If the robot has no such frame.
        """
        return self._of_frame(recursions.frame_jacobian, self._frame(frame)[1], q=self._at_origin(q))

    @by_values()
    def frame_bias_acceleration(self, q: ArrayLike, v: ArrayLike, frame: str | None = None) -> Array:
        """Return the bias acceleration dJ/dt v of a frame, shape (..., 6): its acceleration if a = 0.

        It holds the acceleration of the frame's origin and the angular acceleration, along the axes of the
        inertial frame [m/s^2, rad/s^2]. J a + dJ/dt v is the time derivative of J v, see `frame_jacobian`.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        v : array_like, shape (..., nv)
            Velocity [m/s, m/s, rad/s, ...].
        frame : str, optional
            Name of the frame, one of `frame_names`; by default, `end_effector`.

        Raises
        ------
        UnknownName
            If the robot has no such frame.
        """
        return self._of_frame(recursions.frame_bias_acceleration, self._frame(frame)[1], q=q, v=v)

    @by_values()
    def manipulability(self, q: ArrayLike, frame: str | None = None) -> Array:
        """Return the manipulability sqrt(det J J') of base and arm together, shape (...) (Yoshikawa, 1985).

        This is the volume of the set of twists for unit velocities, in mixed units. It is zero in a singular
        configuration, and for fewer than six coordinates.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        frame : str, optional
            Name of the frame, one of `frame_names`; by default, `end_effector`.

        Raises
        ------
        UnknownName
            If the robot has no such frame.
        """
        return self._volume(self._frame(frame)[1], slice(None), q)

    @by_values()
    def arm_manipulability(self, q: ArrayLike, frame: str | None = None) -> Array:
        """Return the `manipulability` of the arm with the frame, for a fixed base, shape (...).

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        frame : str, optional
            Name of the frame, one of `frame_names`; by default, `end_effector`.

        Raises
        ------
        InvalidArgument
            If the frame does not belong to an arm.
        UnknownName
            If the robot has no such frame.
        """
        name, number = self._frame(frame)
        arms = [mount for mount in self.mounts if name.startswith(f"{mount.name}/")]
        if not arms:
            raise unexpected_value("frame", name, "a frame of an arm")
        return self._volume(number, arms[0].v, q)

    def _volume(self, number: int, part: slice, q: ArrayLike) -> Array:
        return self._of_frame(recursions.manipulability, number, part, q=self._at_origin(q))

    def _frame(self, name: str | None) -> tuple[str, int]:
        name = self.end_effector if name is None else name
        return one_of("frame", name, self._frames), self._frames[name]

    @by_values()
    def frame_placements(self, q: ArrayLike) -> Array:
        """Return T_0_k, the pose of each joint's frame in the inertial frame, shape (..., joints, 4, 4).

        The third frame is the body frame. It is the last one for a robot without arms.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        """
        return self._of_frame(recursions.joint_placements, q=q)

    @by_values()
    def jacobian(self, q: ArrayLike) -> Array:
        """Return J(psi), shape (..., nv, nv): v = J w, w begins with the twist (forward, left, yaw rate).

        The entries of w for the arms' joints equal those of v.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        """
        psi = self._q(q)[..., 2]
        J = np.zeros((*psi.shape, self.nv, self.nv))
        J[...] = np.eye(self.nv)
        J[..., 0, 0] = J[..., 1, 1] = np.cos(psi)
        J[..., 1, 0] = np.sin(psi)
        J[..., 0, 1] = -J[..., 1, 0]
        return J

    @property
    def inertial_parameters(self) -> Array:
        """Inertial parameters of the body and of each joint's link, shape (10 bodies,), see `regressor`.

        The ten parameters of a body are m, m c and Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the origin of the
        joint's frame [kg, kg m, kg m^2].
        """
        moving = range(BODY_JOINT, self._model.njoints)
        return np.concatenate([self._model.inertias[joint].toDynamicParameters() for joint in moving])

    @by_values(pin.crba, 1)
    def mass_matrix(self, q: ArrayLike) -> Array:
        """Return the mass matrix M(q), shape (..., nv, nv) [kg, kg m, kg m^2], by Pinocchio's CRBA.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        """
        return self._each(pin.crba, q=q)

    @by_values(pin.nonLinearEffects, 2)
    def nonlinear_effects(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return the nonlinear effects n(q, v), shape (..., nv) [N, N, N m, ...], by Pinocchio's RNEA.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        v : array_like, shape (..., nv)
            Velocity [m/s, m/s, rad/s, ...].
        """
        return self._each(pin.nonLinearEffects, q=q, v=v)

    @by_values(pin.rnea, 3)
    def inverse_dynamics(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """Return tau = M(q) a + n(q, v), shape (..., nv) [N, N, N m, ...], by Pinocchio's RNEA.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        v, a : array_like, shape (..., nv)
            Velocity and acceleration [m/s, m/s, rad/s, ...; per s].
        """
        return self._each(pin.rnea, q=q, v=v, a=a)

    @by_values(pin.aba, 3)
    def forward_dynamics(self, q: ArrayLike, v: ArrayLike, tau: ArrayLike, f: ArrayLike = 0.0) -> Array:
        """Return a = M(q)^-1 (tau + f - n(q, v)), shape (..., nv) [m/s^2, ...], by Pinocchio's ABA.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        v : array_like, shape (..., nv)
            Velocity [m/s, m/s, rad/s, ...].
        tau : array_like, shape (..., nv)
            Input, a generalised force [N, N, N m, ...].
        f : array_like, shape (..., nv), optional
            External generalised force [N, N, N m, ...]; 0 means none.
        """
        if type(f) is float and not f and (a := self._number_law(pin.aba, q, v, tau)) is not None:
            return a
        if np.ndim(f) or f:
            force, external = self._v("tau", tau), self._v("f", f)
            broadcast(tau=force, f=external)
            with np.errstate(over="ignore"):
                tau = finite_answer(force + external, tau=force, f=external)
        return self._each(pin.aba, q=q, v=v, tau=tau)

    @by_values()
    def generalized_force(self, q: ArrayLike, wrench: ArrayLike) -> Array:
        """Return the generalised force of a wrench on the body, shape (..., nv) [N, N, N m, ...].

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        wrench : array_like, shape (..., 3)
            Force at the origin of the body frame along the inertial axes, and moment about this origin,
            (Fx, Fy, Mz) [N, N, N m].
        """
        q, wrench = self._q(q), vector("wrench", wrench, BODY_JOINT)
        force = np.zeros((*broadcast(q=q, wrench=wrench), self.nv))
        force[..., :BODY_JOINT] = wrench
        return force

    @by_values()
    def start(self, reference: Any) -> tuple[Array, Array]:
        """Return the initial q and v for a reference, shape (nq,) and (nv,).

        Coordinates without a reference start at `rest` with zero velocity.

        Parameters
        ----------
        reference : Reference
            First sample of the reference: q and v of the first n coordinates, n in `reference_sizes`.

        Raises
        ------
        InvalidArgument
            If the argument is not a reference, or its number of coordinates is not in `reference_sizes`.
        """
        require("reference", reference, Desired)
        q = shaped("reference.q", finite("reference.q", reference.q), *((n,) for n in self.reference_sizes))
        v = shaped("reference.v", finite("reference.v", reference.v), q.shape)
        return np.append(q, self.rest[q.size :]), np.append(v, np.zeros(self.nv - v.size))

    @by_values()
    def coriolis_matrix(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return C(q, v), shape (..., nv, nv): C v = n(q, v) - g(q), and dM/dt - 2 C is skew-symmetric.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        v : array_like, shape (..., nv)
            Velocity [m/s, m/s, rad/s, ...].
        """
        return self._each(pin.computeCoriolisMatrix, q=self._at_origin(q), v=v)

    @by_values()
    def kinetic_energy(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return the kinetic energy v' M(q) v / 2, shape (...) [J].

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        v : array_like, shape (..., nv)
            Velocity [m/s, m/s, rad/s, ...].
        """
        return self._each(recursions.kinetic_energy, q=q, v=v)

    @by_values()
    def potential_energy(self, q: ArrayLike) -> Array:
        """Return the potential energy in the field of gravity, shape (...) [J]; the ground has height zero.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        """
        return self._each(pin.computePotentialEnergy, q=q)

    @by_values(pin.computeGeneralizedGravity, 1)
    def gravity(self, q: ArrayLike) -> Array:
        """Return the gravity term g(q), shape (..., nv) [N, N, N m, ...]; it is zero for the base.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        """
        return self._each(pin.computeGeneralizedGravity, q=q)

    @by_values()
    def regressor(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """Return the regressor Y(q, v, a), shape (..., nv, 10 bodies): tau = Y p without rotor inertias.

        The vector p is `inertial_parameters`.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        v, a : array_like, shape (..., nv)
            Velocity and acceleration [m/s, m/s, rad/s, ...; per s].
        """
        return self._each(recursions.regressor, q=q, v=v, a=a)

    @by_values()
    def linearize(self, q: ArrayLike, v: ArrayLike, tau: ArrayLike) -> Linearization:
        """Return the first-order model of forward dynamics at (q, v, tau).

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        v : array_like, shape (..., nv)
            Velocity [m/s, m/s, rad/s, ...].
        tau : array_like, shape (..., nv)
            Generalised force [N, N, N m, ...].

        Returns
        -------
        Linearization
            Matrices A, shape (..., 2 nv, 2 nv), and B, shape (..., 2 nv, nv).
        """
        return self._linearization(q, v, tau=tau)

    def _linearization(self, q: ArrayLike, v: ArrayLike, **push: ArrayLike) -> Linearization:
        derivative = self._each(recursions.derivatives, q=self._at_origin(q), v=v, **push)
        by_q, by_v, by_tau = np.moveaxis(derivative, -3, 0)
        A = np.zeros((*by_q.shape[:-2], 2 * self.nv, 2 * self.nv))
        B = np.zeros((*by_q.shape[:-2], 2 * self.nv, self.nv))
        A[..., : self.nv, self.nv :] = np.eye(self.nv)
        A[..., self.nv :, : self.nv], A[..., self.nv :, self.nv :] = by_q, by_v
        B[..., self.nv :, :] = by_tau
        return Linearization(A, B)

    @by_values()
    def linearize_tracked(self, q: ArrayLike, v: ArrayLike, u: ArrayLike) -> Linearization:
        """Return `linearize`, since the coordinates and v are the whole state of a robot that forces drive.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        v : array_like, shape (..., nv)
            Velocity [m/s, m/s, rad/s, ...].
        u : array_like, shape (..., nv)
            Input, a generalised force [N, N, N m, ...].
        """
        return self._linearization(q, v, u=u)

    @cached_property
    def weight(self) -> float:
        """Weight of the robot with arms and loads [N]."""
        if self._engine is None:
            return self._array_ways[-1].weight  # type: ignore[no-any-return]
        return float(pin.computeTotalMass(self._model) * np.linalg.norm(self._model.gravity.linear))

    @by_values()
    def ground_wrench(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """Return the wrench of the ground on the robot for a given motion, shape (..., 6) [N, N m].

        The wrench (force, moment) is along the axes of the body frame B, with the moment about the origin of
        B on the ground. It equals the rate of momentum of all bodies minus gravity, so it includes all other
        external forces.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        v, a : array_like, shape (..., nv)
            Velocity and acceleration [m/s, m/s, rad/s, ...; per s].
        """
        return self._each(recursions.ground_wrench, q=q, v=v, a=a)

    @by_values()
    def mount_wrench(self, q: ArrayLike, v: ArrayLike, a: ArrayLike, mount: str | None = None) -> Array:
        """Return the wrench of an arm and its loads on the body at the mount, shape (..., 6) [N, N m].

        The wrench (force, moment) is along the axes of the body frame B, not rotated by the mount's yaw, with
        the moment about the mount point. An arm at rest exerts its weight, (0, 0, -m g), and the moment (-m g
        y, m g x, 0), with its centre of mass at x and y from the mount point.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        v, a : array_like, shape (..., nv)
            Velocity and acceleration [m/s, m/s, rad/s, ...; per s].
        mount : str, optional
            Name of one of `mounts`; by default, the first one.

        Raises
        ------
        InvalidArgument
            If the robot carries no arm.
        UnknownName
            If no arm has this name.
        """
        arm = self._mount(mount)
        return self._each(partial(recursions.mount_wrench, arm, self._fixed(arm)), q=q, v=v, a=a)

    def _mount(self, name: str | None) -> Mount:
        if not self.mounts:
            raise InvalidArgument("robot carries no arm, expected a robot with one: robot.mount(...)")
        mounts = {mount.name: mount for mount in self.mounts}
        key = self.mounts[0].name if name is None else name
        return mounts[one_of("mount", key, mounts)]

    def _fixed(self, mount: Mount) -> pin.Inertia:
        """Return the inertia, in the body frame, of those parts of an arm that are fixed to the body."""
        fixed = mount.placement.act(mount._model.inertias[0])
        for load in self.loads:
            name = load.frame
            frame = self._model.frames[self._frames[name]]
            if frame.parentJoint == BODY_JOINT and name.startswith(f"{mount.name}/"):
                fixed += frame.placement.act(load.body)
        return fixed
