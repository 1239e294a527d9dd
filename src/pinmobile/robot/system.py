"""`System`: a tree of joints on the DH chain: configurations, frames, dynamics, wrenches, in public order."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property, partial, wraps
from math import isfinite, prod
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

import numpy as np
import pinocchio as pin

from pinmobile.arrays import (
    LEAST_ANGLE,
    Array,
    ArrayLike,
    affordable,
    broadcast,
    finite,
    finite_answer,
    frozen,
    instance,
    one_of,
    sequence,
    shaped,
    vector,
    whole,
    wrap_angle,
)
from pinmobile.errors import InvalidArgument, NotTraceable, shown
from pinmobile.parts import Desired, holds_symbols, is_tracing, on_numbers, required, structure
from pinmobile.plant import Coordinate, Input
from pinmobile.robot import pinocchio_backend
from pinmobile.robot.linkage import BODY_JOINT, circular_coordinates, joints_of
from pinmobile.robot.mounts import Mount, PayloadBody, named_frames
from pinmobile.robot.pinocchio_backend import PinocchioBackend

_BASE = ("x", "m", "vx"), ("y", "m", "vy"), ("psi", "rad", "yaw_rate")
_FAR = 1e8  # beyond, a limit is none
_Method = TypeVar("_Method", bound=Callable[..., Any])


class Linearization(NamedTuple):
    """First-order model of forward dynamics about a state: d(dq, dv)/dt = A (dq, dv) + B dtau.

    Attributes
    ----------
    A : ndarray, shape (..., 2 nv, 2 nv)
        ``[[0, I], [da/dq, da/dv]]``.
    B : ndarray, shape (..., 2 nv, nv)
        ``[[0], [M^-1]]``.
    """

    A: Array
    B: Array


def by_values(fast: Callable[..., Any] | None = None, states: int = 0) -> Callable[[_Method], _Method]:
    """Let a method be answered by Pinocchio for numbers, and on symbols by the robot's dynamics in NumPy.

    Parameters
    ----------
    fast : callable, optional
        Pinocchio's function of one state of float64 in public order, which is tried first.
    states : int
        How many arguments that takes.
    """

    def decorate(method: _Method) -> _Method:
        name = method.__name__

        @wraps(method)
        def run(self: System, *given: Any, **options: Any) -> Any:
            if fast is not None and len(given) == states and not options:
                found = self._quick(fast, *given)
                if found is not None:
                    return found
            symbolic = self._engine is None
            for x in (*given, *options.values()) if options else given:
                if type(x) is not np.ndarray and holds_symbols(x):
                    symbolic = True
            if symbolic:
                return self._on_symbols(name, *given, **options)
            if not is_tracing():
                return method(self, *given, **options)
            with on_numbers():
                return method(self, *given, **options)

        return run  # type: ignore[return-value]

    return decorate


class System:
    """Abstract base: what follows from the Pinocchio model that its maker has set.

    All methods take and return, along the last axis and in the inertial frame: configuration
    q = (x, y, psi) [m, m, rad], velocity v = dq/dt [m/s, m/s, rad/s], acceleration a [m/s^2, m/s^2, rad/s^2]
    and generalised force tau = (Fx, Fy, Mz) [N, N, N m]; after these come the arms' joints, one after the
    other, in their units, with one number each. A continuous joint is an angle like psi. Leading axes
    broadcast. All raise `InvalidArgument` for arguments of another last axis or that are not finite, and
    `NotFinite` where the answer would not be. They may be called by several threads at once.

    Pinocchio takes one state at a time, some 5 to 20 microseconds each; `pinmobile.vectorize` compiles a
    method for many. Where an argument, or a number of the robot, is a symbol of a law that is being compiled,
    the methods compute the same on symbols; those that cannot raise `NotTraceable`.
    """

    _engine: Any  # an `PinocchioBackend`; None where it holds symbols
    mounts: tuple[Mount, ...]
    loads: tuple[PayloadBody, ...]

    @property
    def model(self) -> pin.Model:
        """A copy of the Pinocchio model, in the chain's order (y, x, psi, ...): write into it as you like."""
        return self._model.copy()

    @property
    def _model(self) -> pin.Model:
        """The model itself, which is only read."""
        return self._numeric.model

    @property
    def _numeric(self) -> PinocchioBackend:
        """Pinocchio's calls; raises `NotTraceable` where it holds symbols."""
        if self._engine is None:
            raise NotTraceable(
                f"the Pinocchio model of a {type(self).__name__} whose numbers are symbols",
                "ask it for its dynamics and kinematics",
            )
        return self._engine  # type: ignore[no-any-return]

    @property
    def nq(self) -> int:
        """Size of q."""
        return self.nv

    @structure
    def nv(self) -> int:
        """Size of v and a."""
        return self._numeric.nv

    @property
    def nu(self) -> int:
        """Size of the input, here the generalised force."""
        return self.nv

    @structure
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Each of the nv numbers of q: x, y, psi, then those of the arms' joints."""
        joints = joints_of(self._model, BODY_JOINT + 1)
        arms = ((each.name, "m" if each.slides else "rad", f"{each.name}_rate") for each in joints)
        limits = zip(self.lower.tolist(), self.upper.tolist(), strict=True)
        return tuple(
            Coordinate(name, unit, *limit, rate)
            for (name, unit, rate), limit in zip((*_BASE, *arms), limits, strict=True)
        )

    @structure
    def inputs(self) -> tuple[Input, ...]:
        """Each of the nu numbers of an input: Fx, Fy, Mz, then the forces and torques at the arms' joints.

        They have no limits: what motors can do, `effort_limit` knows, and `InputSaturation` holds a
        controller to.
        """
        names = ["Fx", "Fy", "Mz", *(one.name for one in self.coordinates[BODY_JOINT:])]
        units = ["N" if one.unit == "m" else "N m" for one in self.coordinates]
        return tuple(map(Input, names, units))

    @structure
    def reference_sizes(self) -> Mapping[int, int]:
        """How many numbers of q the first n coordinates have, for each n that a reference may have."""
        return MappingProxyType({n: n for n in range(BODY_JOINT, self.nv + 1)})

    @property
    def broadcasts(self) -> bool:
        """Whether its methods take leading axes, here True."""
        return True

    @structure
    def _limits(self) -> tuple[Array, Array, Array, Array]:
        model, arms = self._model, slice(BODY_JOINT, None)
        lower, upper = np.full(model.nv, -np.inf), np.full(model.nv, np.inf)
        speed, effort = upper.copy(), upper.copy()
        least, most = model.lowerPositionLimit[arms], model.upperPositionLimit[arms]
        known = least < most  # files write equal limits, or zero, where they know none
        lower[arms] = np.where(known & (least > -_FAR), least, -np.inf)
        upper[arms] = np.where(known & (most < _FAR), most, np.inf)
        for target, source in ((speed, model.velocityLimit[arms]), (effort, model.effortLimit[arms])):
            target[arms] = np.where((source > 0) & (source < _FAR), source, np.inf)
        return frozen(lower), frozen(upper), frozen(speed), frozen(effort)

    @property
    def lower(self) -> Array:
        """Least configuration, shape (nq,) [m, m, rad, ...]; -inf where there is no limit."""
        return self._limits[0]

    @property
    def upper(self) -> Array:
        """Largest configuration, shape (nq,) [m, m, rad, ...]; inf where there is no limit."""
        return self._limits[1]

    @property
    def velocity_limit(self) -> Array:
        """Largest |v|, shape (nv,) [m/s, m/s, rad/s, ...]; inf where there is no limit."""
        return self._limits[2]

    @property
    def effort_limit(self) -> Array:
        """Largest |tau|, shape (nv,) [N, N, N m, ...]; inf where there is no limit."""
        return self._limits[3]

    @structure
    def _resistances(self) -> tuple[Array, Array]:
        damping, friction = np.zeros((2, self.nv))
        for mount in self.mounts:
            damping[mount.v], friction[mount.v] = mount._model.damping, mount._model.friction
        return frozen(damping), frozen(friction)

    @property
    def joint_damping(self) -> Array:
        """Viscous damping of the arms' joints, shape (nv,) [N s/m, N m s/rad], as their files have it.

        Zero for the base. The dynamics leave it out; in a loop it acts where `JointFriction.of(robot)` does.
        """
        return self._resistances[0]

    @property
    def joint_friction(self) -> Array:
        """Dry friction of the arms' joints, shape (nv,) [N, N m], as their files have it.

        Zero for the base. The dynamics leave it out; in a loop it acts where `JointFriction.of(robot)` does.
        """
        return self._resistances[1]

    @structure
    def rest(self) -> Array:
        """Return the configuration at the origin with each arm in its reference posture, shape (nq,).

        Where its description has none, its neutral one. All is brought within the limits.
        """
        q = np.zeros(self.nq)
        for mount in self.mounts:
            q[mount.q] = mount.arm.posture
        return frozen(np.clip(q, self.lower, self.upper))

    def random_configuration(self, generator: np.random.Generator, shape: tuple[int, ...] = ()) -> Array:
        """Return configurations within the limits, shape (*shape, nq); without a limit, up to pi or 1 m.

        Parameters
        ----------
        generator : numpy.random.Generator
            Where the numbers come from.
        shape : tuple of int
            Leading axes.

        Raises
        ------
        InvalidArgument
            If an argument is something else, or the configurations would not fit into memory.
        """
        instance("generator", generator, np.random.Generator, "a numpy.random.Generator")
        shape = tuple(
            whole("shape", n, least=0) for n in sequence("shape", shape, "a tuple of whole numbers")
        )
        affordable("random configurations", 4.0 * self.nq * prod(shape), "draw fewer at a time")
        q = generator.uniform(-np.pi, np.pi, (*shape, self.nq))
        q[..., :2] /= np.pi
        limited = np.isfinite(self.lower) & np.isfinite(self.upper)
        q[..., limited] = generator.uniform(
            self.lower[limited], self.upper[limited], (*shape, np.count_nonzero(limited))
        )
        return q

    @structure
    def _circular(self) -> tuple[int, ...]:
        return circular_coordinates(self._model)

    @by_values()
    def integrate(self, q: ArrayLike, dq: ArrayLike) -> Array:
        """Return the configuration q + dq, shape (..., nq); psi and continuous joints go beyond pi."""
        q, dq = self._q(q), self._v("dq", dq)
        broadcast(q=q, dq=dq)
        with np.errstate(over="ignore"):
            return finite_answer(q + dq, q=q, dq=dq)

    @by_values()
    def difference(self, q0: ArrayLike, q1: ArrayLike) -> Array:
        """Return the displacement q1 - q0, shape (..., nv); psi and continuous joints in (-pi, pi]."""
        shape = (self.nv,)
        if not (type(q0) is type(q1) is np.ndarray and q0.shape == q1.shape == shape):
            q0, q1 = self._q(q0, "q0"), self._q(q1, "q1")
            broadcast(q0=q0, q1=q1)
        displacement = q1 - q0
        if not (
            isfinite(np.vdot(displacement, displacement))
            if displacement.ndim == 1
            else np.isfinite(displacement).all()
        ):
            q0, q1 = self._q(q0, "q0"), self._q(q1, "q1")
            finite_answer(displacement, q0=q0, q1=q1)
        for k in self._circular:
            angle = displacement[..., k]
            if angle.ndim or not LEAST_ANGLE < angle <= np.pi:  # in a loop it hardly ever is beyond
                displacement[..., k] = wrap_angle(angle)
        return displacement

    def _each(self, law: Callable[..., Any], **arguments: ArrayLike) -> Array:
        """Return what one of Pinocchio's laws gives for each row of the arguments."""
        return self._numeric.each(law, False, **arguments)

    def _of_frame(self, law: Callable[..., Any], *given: Any, **arguments: ArrayLike) -> Array:
        """Return the same of a frame, by its number and what else the law takes first."""
        return self._numeric.each(partial(law, *given), True, **arguments)

    def _quick(self, law: Callable[..., Any], *arguments: Any) -> Array | None:
        """Return what Pinocchio gives for one state of float64, as a loop asks; None of others.

        A third of the time of `_each`.
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
        """Return the answer of a method where an argument or the robot holds symbols."""
        for dynamics in self._array_ways:
            if hasattr(type(dynamics), name):
                return getattr(dynamics, name)(*given, **options)
        raise NotTraceable(
            f"{name} of a {type(self).__name__}, which takes numbers alone",
            "call it before the law, on numbers",
        )

    @property
    def _array_ways(self) -> tuple[Any, ...]:
        """Dynamics in NumPy, for symbols too; the first that has a method answers it."""
        return ()

    def _q(self, q: ArrayLike, name: str = "q") -> Array:
        return vector(name, q, self.nq)

    def _here(self, q: ArrayLike) -> Array:
        """Return q, checked, with x = y = 0.

        Where Pinocchio works in the inertial frame, what depends on neither loses digits to both far away.
        """
        moved = self._q(q).copy()
        moved[..., :2] = 0.0
        return moved

    def _v(self, name: str, value: ArrayLike) -> Array:
        return vector(name, value, self.nv)

    @by_values()
    def pose(self, q: ArrayLike) -> Array:
        """Return x, y and psi of the body, shape (..., 3) [m, m, rad]."""
        return self._q(q)[..., :BODY_JOINT].copy()

    @by_values()
    def pose_rate(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return the rates of x, y and psi of the body, shape (..., 3) [m/s, m/s, rad/s]."""
        q, v = self._q(q), self._v("v", v)
        lead = broadcast(q=q, v=v)
        return np.array(np.broadcast_to(v[..., :BODY_JOINT], (*lead, BODY_JOINT)))

    @structure
    def _frames(self) -> dict[str, int]:
        return named_frames(self._model)

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Names of the frames: the chain's, ``base_link``, and ``name/...`` of each arm."""
        return tuple(self._frames)

    @property
    def end_effector(self) -> str:
        """Default frame: the tip of the first arm, or the body's frame where there is none."""
        return self.mounts[0].tip if self.mounts else "base_link"

    def frame_name(self, frame: str | None = None) -> str:
        """Return the name of a frame, by default that of `end_effector`.

        Raises
        ------
        UnknownName
            If there is no such frame.
        """
        return self._frame(frame)[0]

    @by_values()
    def frame_pose(self, q: ArrayLike, frame: str | None = None) -> Array:
        """Return T_0_f, the pose of a frame, shape (..., 4, 4).

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        frame : str, optional
            One of `frame_names`; by default `end_effector`.

        Raises
        ------
        UnknownName
            If there is no such frame.
        """
        return self._of_frame(pinocchio_backend.frame_pose, self._frame(frame)[1], q=q)

    @by_values()
    def frame_jacobian(self, q: ArrayLike, frame: str | None = None) -> Array:
        """Return J, shape (..., 6, nv): J v is the velocity of the frame's origin and the angular velocity.

        Both are along the axes of the inertial frame [m/s, rad/s].

        Parameters
        ----------
        q, frame
            As in `frame_pose`, with the same error.
        """
        return self._of_frame(pinocchio_backend.frame_jacobian, self._frame(frame)[1], q=self._here(q))

    @by_values()
    def frame_drift(self, q: ArrayLike, v: ArrayLike, frame: str | None = None) -> Array:
        """Return dJ/dt v, shape (..., 6): a frame's acceleration where no coordinate accelerates.

        Of its origin, and angular, along the axes of the inertial frame [m/s^2, rad/s^2]: J a + dJ/dt v is
        the derivative of J v, see `frame_jacobian`.

        Parameters
        ----------
        q, frame
            As in `frame_pose`, with the same error.
        v : array_like, shape (..., nv)
            Velocity [m/s, m/s, rad/s, ...].
        """
        return self._of_frame(pinocchio_backend.frame_drift, self._frame(frame)[1], q=q, v=v)

    @by_values()
    def manipulability(self, q: ArrayLike, frame: str | None = None) -> Array:
        """Return sqrt(det J J'), shape (...), of base and arm together (Yoshikawa, 1985).

        The volume of the twists that velocities of length one give, in mixed units; zero where a direction
        is lost, so always for fewer than six coordinates.

        Parameters
        ----------
        q, frame
            As in `frame_pose`, with the same error.
        """
        return self._volume(self._frame(frame)[1], slice(None), q)

    @by_values()
    def arm_manipulability(self, q: ArrayLike, frame: str | None = None) -> Array:
        """Return `manipulability` of the arm that carries the frame alone, the base held, shape (...).

        Raises
        ------
        InvalidArgument
            If the frame is on no arm.
        UnknownName
            If there is no such frame.
        """
        name, number = self._frame(frame)
        arms = [mount for mount in self.mounts if name.startswith(f"{mount.name}/")]
        if not arms:
            raise InvalidArgument(f"frame is {shown(name)}, expected one of an arm")
        return self._volume(number, arms[0].v, q)

    def _volume(self, number: int, part: slice, q: ArrayLike) -> Array:
        return self._of_frame(pinocchio_backend.manipulability, number, part, q=self._here(q))

    def _frame(self, name: str | None) -> tuple[str, int]:
        name = self.end_effector if name is None else name
        return one_of("frame", name, self._frames), self._frames[name]

    @by_values()
    def frame_placements(self, q: ArrayLike) -> Array:
        """Return T_0_k, the pose of each joint's frame, shape (..., joints, 4, 4).

        The third is the body's; it is the last one where nothing is mounted.
        """
        return self._of_frame(pinocchio_backend.joint_placements, q=q)

    @by_values()
    def jacobian(self, q: ArrayLike) -> Array:
        """Return J(psi), shape (..., nv, nv): v = J twist, with the body twist (forward, left, yaw rate).

        What comes after the base is taken over as it is.
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
        """What `regressor` multiplies, shape (10 bodies,), those of the body and then of each joint's.

        m, m c, and Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the origin of the joint's frame [SI].
        """
        moving = range(BODY_JOINT, self._model.njoints)
        return np.concatenate([self._model.inertias[joint].toDynamicParameters() for joint in moving])

    @by_values(pin.crba, 1)
    def mass_matrix(self, q: ArrayLike) -> Array:
        """Return M(q), shape (..., nv, nv) [kg, kg m, kg m^2], by Pinocchio's CRBA."""
        return self._each(pin.crba, q=q)

    @by_values(pin.nonLinearEffects, 2)
    def nonlinear_effects(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return n(q, v), shape (..., nv) [N, N, N m], by Pinocchio's RNEA without acceleration."""
        return self._each(pin.nonLinearEffects, q=q, v=v)

    @by_values(pin.rnea, 3)
    def inverse_dynamics(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """Return tau = M(q) a + n(q, v), shape (..., nv) [N, N, N m], by Pinocchio's RNEA."""
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
            The input, a generalised force [N, N, N m, ...].
        f : array_like, shape (..., nv), optional
            Generalised forces beside it; 0: none.
        """
        if type(f) is float and not f and (found := self._quick(pin.aba, q, v, tau)) is not None:
            return found
        if np.ndim(f) or f:
            force, beside = self._v("tau", tau), self._v("f", f)
            broadcast(tau=force, f=beside)
            with np.errstate(over="ignore"):
                tau = finite_answer(force + beside, tau=force, f=beside)
        return self._each(pin.aba, q=q, v=v, tau=tau)

    @by_values()
    def generalized_force(self, q: ArrayLike, wrench: ArrayLike) -> Array:
        """Return the generalised force of a wrench on the body, shape (..., nv) [N, N, N m, ...].

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        wrench : array_like, shape (..., 3)
            Force along the inertial axes on the origin of the body's frame, and moment about it, (Fx, Fy, Mz)
            [N, N, N m].
        """
        q, wrench = self._q(q), vector("wrench", wrench, BODY_JOINT)
        whole = np.zeros((*broadcast(q=q, wrench=wrench), self.nv))
        whole[..., :BODY_JOINT] = wrench
        return whole

    @by_values()
    def start(self, reference: Any) -> tuple[Array, Array]:
        """Return the q and v with which a reference begins, shape (nq,) and (nv,).

        What it does not lead rests where `rest` has it.

        Parameters
        ----------
        reference : Reference
            Its first sample: q and v of the first n coordinates, n one of `reference_sizes`.

        Raises
        ------
        InvalidArgument
            If it is no reference, or has another number of coordinates.
        """
        required("reference", reference, Desired)
        q = shaped("reference.q", finite("reference.q", reference.q), *((n,) for n in self.reference_sizes))
        v = shaped("reference.v", finite("reference.v", reference.v), q.shape)
        return np.append(q, self.rest[q.size :]), np.append(v, np.zeros(self.nv - v.size))

    @by_values()
    def coriolis_matrix(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return C(q, v), shape (..., nv, nv): C v = n(q, v), and dM/dt - 2 C is skew-symmetric."""
        return self._each(pin.computeCoriolisMatrix, q=self._here(q), v=v)

    @by_values()
    def kinetic_energy(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return v' M(q) v / 2, shape (...) [J]."""
        return self._each(pinocchio_backend.kinetic_energy, q=q, v=v)

    @by_values()
    def potential_energy(self, q: ArrayLike) -> Array:
        """Return the energy in the field of gravity, shape (...) [J]; zero where all is on the ground."""
        return self._each(pin.computePotentialEnergy, q=q)

    @by_values(pin.computeGeneralizedGravity, 1)
    def gravity(self, q: ArrayLike) -> Array:
        """Return g(q), shape (..., nv) [N, N, N m]: what holds the robot at rest; none of it for the base."""
        return self._each(pin.computeGeneralizedGravity, q=q)

    @by_values()
    def regressor(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """Return Y(q, v, a), shape (..., nv, 10 bodies): tau = Y `inertial_parameters`, rotors left out."""
        return self._each(pinocchio_backend.regressor, q=q, v=v, a=a)

    @by_values()
    def linearize(self, q: ArrayLike, v: ArrayLike, tau: ArrayLike) -> Linearization:
        """Return the first-order model of forward dynamics about (q, v, tau)."""
        return self._linearized(q, v, tau=tau)

    def _linearized(self, q: ArrayLike, v: ArrayLike, **push: ArrayLike) -> Linearization:
        found = self._each(pinocchio_backend.derivatives, q=self._here(q), v=v, **push)
        by_q, by_v, by_tau = np.moveaxis(found, -3, 0)
        A = np.zeros((*by_q.shape[:-2], 2 * self.nv, 2 * self.nv))
        B = np.zeros((*by_q.shape[:-2], 2 * self.nv, self.nv))
        A[..., : self.nv, self.nv :] = np.eye(self.nv)
        A[..., self.nv :, : self.nv], A[..., self.nv :, self.nv :] = by_q, by_v
        B[..., self.nv :, :] = by_tau
        return Linearization(A, B)

    @by_values()
    def linearize_tracked(self, q: ArrayLike, v: ArrayLike, u: ArrayLike) -> Linearization:
        """Return `linearize`: what a reference leads, and v, are the whole state of what is pushed."""
        return self._linearized(q, v, u=u)

    @cached_property
    def weight(self) -> float:
        """Weight of the robot with all that it carries [N]."""
        if self._engine is None:
            return self._array_ways[-1].weight  # type: ignore[no-any-return]
        return float(pin.computeTotalMass(self._model) * np.linalg.norm(self._model.gravity.linear))

    @by_values()
    def ground_wrench(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """Return what the ground exerts on the robot that moves so, shape (..., 6).

        Along the axes of the body's frame B, with the moment about its origin, which lies on the ground: the
        rate of the momentum of all bodies, less gravity. Whatever else acts from outside is in it.
        """
        return self._each(pinocchio_backend.ground_wrench, q=q, v=v, a=a)

    @by_values()
    def mount_wrench(self, q: ArrayLike, v: ArrayLike, a: ArrayLike, mount: str | None = None) -> Array:
        """Return what an arm, with the loads on it, exerts on the body at its mount, shape (..., 6).

        Along the axes of the body's frame B (not turned by the mount's yaw), with the moment about the point
        of the mount. An arm at rest exerts its weight, (0, 0, -m g), and the moment of that,
        (-m g y, m g x, 0) with its centre of mass at x and y from the mount.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        v, a : array_like, shape (..., nv)
            Velocity and acceleration [m/s, m/s, rad/s, ...; per s].
        mount : str, optional
            Name of one of `mounts`; by default that of the first.

        Raises
        ------
        InvalidArgument
            If no arm is mounted.
        UnknownName
            If nothing is mounted by that name.
        """
        arm = self._mount(mount)
        return self._each(partial(pinocchio_backend.mount_wrench, arm, self._fixed(arm)), q=q, v=v, a=a)

    def _mount(self, name: str | None) -> Mount:
        if not self.mounts:
            raise InvalidArgument("robot carries no arm, expected one: robot.mount(...)")
        known = {mount.name: mount for mount in self.mounts}
        wanted = self.mounts[0].name if name is None else name
        return known[one_of("mount", wanted, known)]

    def _fixed(self, mount: Mount) -> pin.Inertia:
        """Return the inertia, in the body's frame, of what of an arm does not move on the body."""
        fixed = mount.placement.act(mount._model.inertias[0])
        for load in self.loads:
            name = load.frame
            frame = self._model.frames[self._frames[name]]
            if frame.parentJoint == BODY_JOINT and name.startswith(f"{mount.name}/"):
                fixed += frame.placement.act(load.body)
        return fixed
