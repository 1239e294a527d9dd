"""Dynamics of a body with or without arms, for one state, many states or symbols, and their linearization.

Compiled loops and loops on arrays use these dynamics of a `MobileRobot`; see `PlanarDynamics`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Protocol, Self, cast, final

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, frozen, wrap_angle
from pinmobile.closed_form import (
    Numbers,
    unchecked_coriolis_matrix,
    unchecked_forward_dynamics,
    unchecked_inverse_dynamics,
    unchecked_mass_matrix,
)
from pinmobile.compiled import Node, symbols
from pinmobile.errors import InvalidArgument, NotTraceable
from pinmobile.metrics import Metric
from pinmobile.parts import is_symbolic
from pinmobile.robot.linkage import (
    ONE,
    ZERO,
    Body,
    Linkage,
    Matrix,
    Placement,
    Vector,
    applied,
    cross,
    dot,
    exact,
    matrix_of,
    number,
    plus,
    regroup,
    scalar_of,
    scalars,
    single,
    vector_of,
    volume,
)
from pinmobile.robot.mounts import assemble, named_frames
from pinmobile.robot.recursions import LinkageDynamics, LinkageKinematics
from pinmobile.robot.support_geometry import ArmMetrics

_BASE = 3  # joints, coordinates and numbers of q of the base; the last carries its body
_STEP = 1e-30  # complex step; its square vanishes in rounding
_SAMPLES = 256  # number of samples per evaluation


def slopes(function: Callable[..., Any], directions: Array, *given: Array) -> Array:
    """Return the derivatives of a function along directions, shape (..., m, k).

    Parameters
    ----------
    function : callable
        Function ``function(step, *given)``, analytic in the step, shape (..., n). It broadcasts over leading
        axes and returns an array of shape (..., m).
    directions : ndarray, shape (k, n)
        Directions of the steps.
    *given : ndarray, shape (..., size)
        Points at which to take the derivatives; leading axes broadcast.
    """
    lead = np.broadcast_shapes(*(np.shape(x)[:-1] for x in given))
    points = (np.broadcast_to(np.asarray(x, np.float64), (*lead, np.shape(x)[-1])) for x in given)
    flat = [x.reshape(-1, 1, x.shape[-1]) for x in points]
    parts = [
        function(1j * _STEP * directions, *(x[i : i + _SAMPLES] for x in flat)).imag / _STEP
        for i in range(0, len(flat[0]), _SAMPLES)
    ]
    columns = np.concatenate(parts)  # (samples, k, m)
    return np.asarray(np.swapaxes(columns, -1, -2)).reshape(*lead, columns.shape[-1], len(directions))


class _Coordinates(Protocol):
    """Base class of functions of a robot's coordinates, and of the linearization of its dynamics."""

    @property
    def rest(self) -> Array:
        """Start of the coordinates without a reference, shape (nq,)."""

    @property
    def circular(self) -> tuple[int, ...]:
        """Coordinates with errors on the circle."""

    @property
    def nv(self) -> int:
        """Number of entries of v and a."""
        return len(self.rest)

    @property
    def nq(self) -> int:
        """Number of entries of q."""
        return self.nv

    @property
    def nu(self) -> int:
        """Number of entries of the input."""
        return self.nv

    def linearize_tracked(self, q: Array, v: Array, u: Array) -> tuple[Array, Array]:
        """Return A, shape (..., 2 nv, 2 nv), and B, (..., 2 nv, nv), see `MobileRobot.linearize`."""
        n, body = self.nv, cast(Any, self)

        def accelerations(step: Array, q: Array, v: Array, u: Array) -> Any:
            return body.forward_dynamics(q + step[..., :n], v + step[..., n : 2 * n], u + step[..., 2 * n :])

        # The dynamics do not depend on x and y.
        derivative = slopes(accelerations, np.eye(3 * n)[2:], q, v, u)
        lead = derivative.shape[:-2]
        A, B = np.zeros((*lead, 2 * n, 2 * n)), np.zeros((*lead, 2 * n, n))
        A[..., :n, n:] = np.eye(n)
        A[..., n:, 2:] = derivative[..., : 2 * n - 2]
        B[..., n:, :] = derivative[..., 2 * n - 2 :]
        return A, B

    def integrate(self, q: Array, dq: Array) -> Array:
        """Return q + dq."""
        return q + dq

    def difference(self, q0: Array, q1: Array) -> Array:
        """Return the displacement from q0 to q1, shape (..., nv), with psi and continuous joints wrapped."""
        d = q1 - q0
        angles = (wrap_angle(d[..., k]) if k in self.circular else d[..., k] for k in range(self.nv))
        return np.stack(list(angles), axis=-1)

    def pose(self, q: Array) -> Array:
        """Return the pose (x, y, psi) of the body, shape (..., 3)."""
        return q[..., :_BASE]

    def pose_rate(self, q: Array, v: Array) -> Array:
        """Return the rates of x, y and psi, shape (..., 3)."""
        return v[..., :_BASE]

    def generalized_force(self, q: Array, wrench: Array) -> Array:
        """Return the generalized force of a wrench on the body, shape (..., nv)."""
        return np.concatenate([wrench, np.zeros((*np.shape(wrench)[:-1], self.nv - _BASE))], axis=-1)

    def start(self, reference: Any) -> tuple[Array, Array]:
        """Return the initial q and v for a reference; coordinates without a reference are at rest."""
        n = reference.v.shape[-1]
        q = np.concatenate([reference.q, self.rest[n:]])
        return q, np.concatenate([reference.v, np.zeros(self.nv - n)])


@final
@dataclass(frozen=True, eq=False)
class PlanarDynamics(_Coordinates):
    """Unchecked dynamics of a body in the plane, by the closed forms of `closed_form`.

    Parameters
    ----------
    mass, yaw_inertia, com_x, com_y : float, ndarray or symbols, shape (...)
        Mass [kg], moment of inertia about the vertical axis through the centre of mass [kg m^2], and centre
        of mass in the body frame [m].
    """

    mass: Numbers
    yaw_inertia: Numbers
    com_x: Numbers = 0.0
    com_y: Numbers = 0.0

    rest: ClassVar[Array] = frozen(np.zeros(3))
    circular: ClassVar[tuple[int, ...]] = (2,)

    @property
    def _body(self) -> tuple[Numbers, Numbers, Numbers, Numbers]:
        return self.mass, self.yaw_inertia, self.com_x, self.com_y

    def forward_dynamics(self, q: Array, v: Array, u: Array, f: Numbers = 0.0) -> Array:
        """Return the acceleration, shape (..., 3)."""
        return unchecked_forward_dynamics(q, v, u + f, *self._body)

    def mass_matrix(self, q: Array) -> Array:
        """Return M(q), shape (..., 3, 3)."""
        return unchecked_mass_matrix(q, *self._body)

    def coriolis_matrix(self, q: Array, v: Array) -> Array:
        """Return C(q, v), shape (..., 3, 3), with C v = n."""
        return unchecked_coriolis_matrix(q, v, self.mass, self.com_x, self.com_y)

    def kinetic_energy(self, q: Array, v: Array) -> Array:
        """Return v . M(q) v / 2, shape (...)."""
        double: Array = np.sum(v * self.inverse_dynamics(q, 0.0 * v, v), axis=-1)
        return double / 2

    def inverse_dynamics(self, q: Array, v: Array, a: Array) -> Array:
        """Return M(q) a + n(q, v), shape (..., 3)."""
        return unchecked_inverse_dynamics(q, v, a, *self._body)

    def nonlinear_effects(self, q: Array, v: Array) -> Array:
        """Return n(q, v), shape (..., 3)."""
        return unchecked_inverse_dynamics(q, v, np.zeros(np.shape(v)), *self._body)

    def gravity(self, q: Array) -> Array:
        """Return the gravity term, shape (..., 3): zero, since the ground is level."""
        return np.zeros(np.shape(q))


class Fixed(NamedTuple):
    """Frame that is fixed to a joint.

    Attributes
    ----------
    name : str
        Name of the frame.
    joint : int
        Index of the joint in the linkage.
    arm : int
        Index of the arm for a frame that is fixed to the arm's root; otherwise, -1.
    R, p : ndarray, shape (3, 3), (3,)
        Orientation and origin in the joint's frame, or in the frame of the arm's root [m].
    """

    name: str
    joint: int
    arm: int
    R: Array
    p: Array


@dataclass(frozen=True, eq=False)
class Tree:
    """Structure of a robot: all its data except masses, inertias, rotors and the placements of its arms.

    Attributes
    ----------
    linkage : Linkage
        Joints. The first three belong to the base; arms are at the body's origin.
    roots : tuple of int
        For each joint on an arm's root, the index of the arm; otherwise, -1.
    links : tuple of Fixed
        Frames of the bodies of all arms, arm by arm.
    frames : dict of str to Fixed
        Frames by name.
    arms : tuple of str
        Names of the arms.
    rest : ndarray, shape (nq,)
        Start of the coordinates without a reference.
    arm_metrics : ArmMetrics or None
        Metrics; None for a robot without arms.
    end_effector : str
        Default frame.
    """

    linkage: Linkage
    roots: tuple[int, ...]
    links: tuple[Fixed, ...]
    frames: dict[str, Fixed]
    arms: tuple[str, ...]
    rest: Array
    arm_metrics: ArmMetrics | None
    end_effector: str

    @classmethod
    def of(cls, robot: Any, base: pin.Model) -> Tree:
        """Return the structure of a robot, given the model of its base in public order.

        Raises
        ------
        NotTraceable
            If a joint is neither revolute nor prismatic.
        """
        model, arms = assemble(base, robot.mounts, at_origin=True), tuple(each.name for each in robot.mounts)
        linkage, links = Linkage.of(model), list[Fixed]()
        for k, mount in enumerate(robot.mounts):
            root, *others = (f"{mount.name}/{link.name}" for link in mount.links)
            links.append(Fixed(root, _BASE - 1, k, frozen(np.eye(3)), frozen(np.zeros(3))))
            for joint, name in enumerate(others, mount.v.start):
                links.append(Fixed(name, joint, -1, frozen(linkage.axes[joint].T), frozen(np.zeros(3))))
        return cls(
            linkage=linkage,
            roots=tuple(
                arms.index(name.partition("/")[0]) if parent == _BASE - 1 else -1
                for name, parent in zip(linkage.names, linkage.parents, strict=True)
            ),
            links=tuple(links),
            frames={
                name: _fixed(linkage, name, model.frames[k], arms)
                for name, k in named_frames(model).items()
                if model.frames[k].parentJoint >= _BASE  # without frames of virtual links
            },
            arms=arms,
            rest=robot.rest,
            arm_metrics=ArmMetrics.of(robot) if arms else None,
            end_effector=robot.end_effector,
        )


def _fixed(linkage: Linkage, name: str, frame: pin.Frame, arms: Sequence[str]) -> Fixed:
    joint, (arm, slash, _) = frame.parentJoint - 1, name.partition("/")
    turn, place = linkage.axes[joint].T, frame.placement
    root = arms.index(arm) if slash and joint == _BASE - 1 and arm in arms else -1
    return Fixed(name, joint, root, frozen(turn @ place.rotation), frozen(turn @ place.translation))


class Solid(NamedTuple):
    """Mass [kg], centre of mass [m] and inertia (xx, yy, zz, xy, xz, yz) about it [kg m^2], as scalars."""

    mass: Any
    com: Vector
    inertia: Vector

    @classmethod
    def of(cls, body: Any) -> Solid:
        """Return the parameters of a link or a load."""
        return cls(single(body.mass), entries_of(body.com), entries_of(body.moments))


def entries_of(x: Any) -> Vector:
    """Return the entries of a vector of numbers or symbols as scalars."""
    return scalars(x if is_symbolic(x) else np.asarray(x, np.float64))


@final
@dataclass(frozen=True, eq=False)
class ArticulatedDynamics(_Coordinates):
    """Unchecked dynamics of a body in the plane with arms and loads, by recursions over its joints.

    The parameters are scalars: numbers or symbols.

    Parameters
    ----------
    tree : Tree
        Structure of the robot.
    mass, yaw_inertia : scalar
        Mass and yaw inertia of the base's body [kg, kg m^2].
    com : list of 3 scalars
        Centre of mass of the base's body [m].
    shares : (float, float)
        Products of inertia xz and yz of the base's body, divided by the yaw inertia. Only the ground's wrench
        depends on them.
    links : list of Solid
        Bodies of the arms, along the axes of their frames.
    loads : list of (str, Solid)
        Loads with their frames.
    rotors : list of scalars
        Inertia of the motors at the arms' joints [kg m^2, kg].
    places : list of lists of 4 scalars
        Placements of the arms: x, y, z and yaw [m, m, m, rad].
    """

    tree: Tree
    mass: Any
    yaw_inertia: Any
    com: Vector
    shares: tuple[float, float]
    links: list[Solid]
    loads: list[tuple[str, Solid]]
    rotors: Vector
    places: list[Vector]

    @classmethod
    def of(cls, robot: Any) -> Self:
        """Return the dynamics of a `MobileRobot`, with numbers or symbols.

        Raises
        ------
        NotTraceable
            If a joint is neither revolute nor prismatic.
        """
        return cls(
            tree=robot.tree,
            mass=single(robot.mass),
            yaw_inertia=single(robot.yaw_inertia),
            com=entries_of(robot.com),
            shares=robot.inertia_shares,
            links=[Solid.of(link) for mount in robot.mounts for link in mount.links],
            loads=[(load.frame, Solid.of(load)) for load in robot.loads],
            rotors=[x for mount in robot.mounts for x in entries_of(mount.rotors)],
            places=[entries_of(mount.at) for mount in robot.mounts],
        )

    @property
    def linkage(self) -> Linkage:
        """Joints of the robot."""
        return self.tree.linkage

    @property
    def rest(self) -> Array:
        """Start of the coordinates without a reference, shape (nq,)."""
        return self.tree.rest

    @property
    def circular(self) -> tuple[int, ...]:
        """Coordinates with errors on the circle."""
        return self.linkage.circular

    @cached_property
    def _stands(self) -> list[Placement]:
        """Placements of the arms on the body."""
        return [Placement.about_z(yaw, origin) for *origin, yaw in self.places]

    def _place(self, arm: int, R: Array, p: Array) -> Placement:
        """Return a placement in its joint's frame, from a placement on an arm's root or in this frame."""
        place = Placement.of(R, p)
        return place if arm < 0 else place.within(self._stands[arm])

    @cached_property
    def _joints(self) -> list[Placement]:
        """Placements of the joints in their parents' frames."""
        tree = self.tree
        rows = zip(tree.roots, tree.linkage.rotations, tree.linkage.offsets, strict=True)
        return [self._place(*row) for row in rows]

    def _base(self, z: Any = ZERO, xz: Any = ZERO, yz: Any = ZERO) -> Body:
        """Return the base's body, with the parameters that affect only the ground's wrench."""
        inertia = self.yaw_inertia
        return Body.of(self.mass, [*self.com[:2], z], [ZERO, ZERO, inertia, ZERO, xz * inertia, yz * inertia])

    @cached_property
    def _bodies(self) -> list[Body]:
        """Body on each joint, regrouped for the fewest operations."""
        return regroup(self.linkage, self._joints, self._bodies_of(self._base()))

    @cached_property
    def _bodies_on_ground(self) -> list[Body]:
        """Body on each joint, regrouped without a change of the ground's wrench on the base."""
        bodies = self._bodies_of(self._base(self.com[2], *map(exact, self.shares)))
        return regroup(self.linkage, self._joints, bodies, _BASE - 1)

    def _bodies_of(self, base: Body, prefix: str = "") -> list[Body]:
        """Return the body on each joint: the base's body, and links and loads with a given prefix."""
        bodies = [Body.zero() for _ in self.rest]
        bodies[_BASE - 1] = base
        tree = self.tree
        loads = [(tree.frames[frame], solid) for frame, solid in self.loads]
        for (name, joint, arm, R, p), solid in (*zip(tree.links, self.links, strict=True), *loads):
            if name.startswith(prefix):
                place = self._place(arm, R, p)
                bodies[joint] = bodies[joint].merge(Body.of(*solid).rotate(place.R).shift(place.p))
        return bodies

    @cached_property
    def _axes(self) -> list[Matrix]:
        """Orientations of the joints' frames in Pinocchio's frames."""
        return [[[exact(x) for x in row] for row in turn] for turn in self.linkage.axes.tolist()]

    @cached_property
    def _motors(self) -> Vector:
        """Inertia of motors at the joints, in the order of the linkage."""
        return [*[ZERO] * _BASE, *self.rotors]

    def _posture(self, q: Array) -> LinkageKinematics:
        return LinkageKinematics(self.linkage, self._joints, scalars(q))

    def _moving(self, q: Array, v: Array) -> LinkageDynamics:
        return LinkageDynamics(self.linkage, self._joints, scalars(q), scalars(v))

    def forward_dynamics(self, q: Array, v: Array, u: Array, f: Array | float = 0.0) -> Array:
        """Return the acceleration, shape (..., nv)."""
        moving, bodies, motors = self._moving(q, v), self._bodies, self._motors
        return vector_of(moving.accelerations(bodies, motors, scalars(u + f)), q)

    def inverse_dynamics(self, q: Array, v: Array, a: Array) -> Array:
        """Return M(q) a + n(q, v), shape (..., nv)."""
        rates = scalars(a)
        efforts = self._moving(q, v).efforts(self._bodies, rates)
        pairs = zip(efforts, self._motors, rates, strict=True)
        return vector_of([effort + motor * rate for effort, motor, rate in pairs], q)

    def nonlinear_effects(self, q: Array, v: Array) -> Array:
        """Return n(q, v), shape (..., nv)."""
        return vector_of(self._moving(q, v).efforts(self._bodies, [ZERO] * self.nv), q)

    def coriolis_matrix(self, q: Array, v: Array) -> Array:
        """Return C(q, v), shape (..., nv, nv), with Christoffel symbols.

        n - g is quadratic in v. Each column of C is its symmetric bilinear form with a unit velocity.
        """
        columns = []
        for k in range(self.nv):
            unit = np.zeros(self.nv)
            unit[k] = 0.5
            half = 0.5 * v
            columns.append(self.nonlinear_effects(q, half + unit) - self.nonlinear_effects(q, half - unit))
        return np.stack(columns, axis=-1)

    def gravity(self, q: Array) -> Array:
        """Return g(q), shape (..., nv)."""
        zeros = [ZERO] * self.nv
        moving = LinkageDynamics(self.linkage, self._joints, scalars(q), zeros)
        return vector_of(moving.efforts(self._bodies, zeros), q)

    def kinetic_energy(self, q: Array, v: Array) -> Array:
        """Return v' M(q) v / 2, shape (...)."""
        moving, rates = self._moving(q, np.zeros(self.nv)), scalars(v)
        momenta = moving.efforts(self._bodies, rates, falling=False)
        pairs = zip(momenta, self._motors, rates, strict=True)
        return scalar_of(0.5 * dot(rates, [momentum + motor * rate for momentum, motor, rate in pairs]), q)

    def potential_energy(self, q: Array) -> Array:
        """Return the potential energy in the field of gravity, shape (...)."""
        moment = self._posture(q).first_moment(self._bodies_on_ground)
        return scalar_of(-dot(moment, map(exact, self.linkage.gravity.tolist())), q)

    def regressor(self, q: Array, v: Array, a: Array) -> Array:
        """Return Y(q, v, a), shape (..., nv, 10 bodies), for the base's body and each later joint's body."""
        rows = self._moving(q, v).regressor(self._axes, _BASE - 1, scalars(a))
        return matrix_of(rows, q)

    def mass_matrix(self, q: Array) -> Array:
        """Return M(q), shape (..., nv, nv)."""
        M = self._posture(q).mass_matrix(self._bodies)
        for i, motor in enumerate(self._motors):
            M[i][i] = M[i][i] + motor
        return matrix_of(M, q)

    def ground_wrench(self, q: Array, v: Array, a: Array) -> Array:
        """Return the ground's wrench on the robot, shape (..., 6): force and moment in the body frame B."""
        force, moment = self._base_wrench(self._bodies_on_ground, q, v, a)
        return vector_of([*force, *moment], q)

    def mount_wrench(self, q: Array, v: Array, a: Array, mount: str | None = None) -> Array:
        """Return an arm's wrench on the base, shape (..., 6), along the base's axes, about the mount."""
        arm = 0 if mount is None else self.tree.arms.index(mount)
        name = f"{self.tree.arms[arm]}/"
        bodies = regroup(self.linkage, self._joints, self._bodies_of(Body.zero(), name), _BASE - 1)
        force, moment = self._base_wrench(bodies, q, v, a)
        moment_m = plus(moment, cross(force, self._stands[arm].p))
        return vector_of([-x for x in (*force, *moment_m)], q)

    def _base_wrench(self, bodies: Sequence[Body], q: Array, v: Array, a: Array) -> tuple[Vector, Vector]:
        """Return the force and moment, in the base's frame, that accelerate the bodies in this way."""
        base, forces = _BASE - 1, self._moving(q, v).wrenches(bodies, scalars(a))
        force, moment = (applied(self._axes[base], each[base]) for each in forces)
        return force, moment

    @property
    def weight(self) -> Any:
        """Weight of the robot with all its parts [N]."""
        total = self.mass
        for solid in (*self.links, *(solid for _, solid in self.loads)):
            total = total + solid.mass
        weight = number(total * float(np.linalg.norm(self.linkage.gravity)))
        return symbols([weight], ()) if type(weight) is Node else weight

    @property
    def metrics(self) -> tuple[Metric, ...]:
        """Metrics of the robot, see `MobileRobot.metrics`."""
        return () if self.tree.arm_metrics is None else self.tree.arm_metrics.metrics

    def evaluate_metrics(
        self, t: Array | float, q: Array, v: Array, a: Array, u: Array, reference: Any
    ) -> Array:
        """Return the values of the metrics, shape (..., m)."""
        if self.tree.arm_metrics is None:
            return np.zeros((*np.shape(q)[:-1], 0))
        return self.tree.arm_metrics.evaluate_metrics(self, q, v, a, u, reference.q)

    def frame_pose(self, q: Array, frame: str | None = None) -> Array:
        """Return T_0_f, the pose of a frame, shape (..., 4, 4)."""
        fixed = self._frame(frame)
        R, p = self._posture(q).placement(fixed.joint, self._place(*fixed[2:]))
        rows = [[*row, x] for row, x in zip(R, p, strict=True)]
        return matrix_of([*rows, [ZERO, ZERO, ZERO, ONE]], q)

    def frame_jacobian(self, q: Array, frame: str | None = None) -> Array:
        """Return J, shape (..., 6, nv), of the frame's origin and orientation, along the inertial axes."""
        fixed = self._frame(frame)
        J = self._posture(q).jacobian(fixed.joint, self._place(*fixed[2:]).p)
        return matrix_of(J, q)

    def manipulability(self, q: Array, frame: str | None = None, *, arm: str = "") -> Array:
        """Return sqrt(det J J'), shape (...), for all coordinates, or only for those of an arm."""
        fixed, names = self._frame(frame), self.linkage.names
        J = self._posture(q).jacobian(fixed.joint, self._place(*fixed[2:]).p)
        prefix = arm and f"{arm}/"
        columns = [k for k, name in enumerate(names) if name.startswith(prefix)]
        return scalar_of(volume([[row[k] for k in columns] for row in J]), q)

    def arm_manipulability(self, q: Array, frame: str | None = None) -> Array:
        """Return the manipulability of the arm with the frame, for a fixed base, shape (...)."""
        arm, slash, _ = self._frame(frame).name.partition("/")
        if not slash:
            raise InvalidArgument(f"frame is {arm!r}, expected a frame of an arm")
        return self.manipulability(q, frame, arm=arm)

    def frame_bias_acceleration(self, q: Array, v: Array, frame: str | None = None) -> Array:
        """Return the bias acceleration dJ/dt v, shape (..., 6), with J as in `frame_jacobian`."""
        fixed = self._frame(frame)
        line, spin = self._moving(q, v).drift(fixed.joint, self._place(*fixed[2:]).p)
        return vector_of([*line, *spin], q)

    def _frame(self, name: str | None) -> Fixed:
        name = self.tree.end_effector if name is None else name
        if name not in self.tree.frames:
            raise NotTraceable(
                f"frame {name!r}, which is on a virtual link of the chain",
                f"use one of {', '.join(self.tree.frames)}",
            )
        return self.tree.frames[name]
