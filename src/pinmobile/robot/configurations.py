"""Configurations of a body on the chain and what it carries, their limits and steps, in public order."""

from abc import abstractmethod
from collections.abc import Mapping
from functools import cached_property
from math import isfinite, prod
from types import MappingProxyType

import numpy as np
import pinocchio as pin

from pinmobile.arrays import (
    LEAST_ANGLE,
    Array,
    ArrayLike,
    affordable,
    broadcast,
    finite_answer,
    frozen,
    sequence,
    vector,
    whole,
    wrap_angle,
)
from pinmobile.errors import InvalidArgument, shown
from pinmobile.plant import Coordinate, Input
from pinmobile.robot.articulated import ArticulatedBody
from pinmobile.robot.assembly import limits, resistances
from pinmobile.robot.batches import MANY, answers
from pinmobile.robot.coordinates import configuration_names, coordinates, inputs, leading
from pinmobile.robot.engine import Engine, Law
from pinmobile.robot.mounts import Load, Mount
from pinmobile.robot.tree import joint_kind, parts_of

__all__ = ["ChainConfigurations"]

_UNIT = 1e-6  # how far (cos, sin) or a quaternion may be from length one


class ChainConfigurations:
    """Abstract base: what follows from the kinds of joints in the Pinocchio model.

    Conventions: see `ChainDynamics`.
    """

    _engine: Engine
    mounts: tuple[Mount, ...]
    loads: tuple[tuple[str, Load], ...]

    @property
    def model(self) -> pin.Model:
        """A copy of the Pinocchio model, in the chain's order (y, x, psi, ...): write into it as you like."""
        return self._model.copy()

    @property
    def _model(self) -> pin.Model:
        """The model itself, which is only read."""
        return self._engine.model

    @property
    def nq(self) -> int:
        """Size of q."""
        return self._engine.nq

    @property
    def nv(self) -> int:
        """Size of v and a."""
        return self._engine.nv

    @property
    def nu(self) -> int:
        """Size of the input, here the generalised force."""
        return self.nv

    @cached_property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Each of the nv numbers of a displacement: x, y, psi, then those of the arms' joints."""
        return coordinates(self._model, self.lower, self.upper)

    @cached_property
    def inputs(self) -> tuple[Input, ...]:
        """Each of the nu numbers of an input: Fx, Fy, Mz, then the forces and torques at the arms' joints.

        They have no limits: what motors can do, `effort_limit` knows, and `Saturated` holds a controller to.
        """
        return inputs(self.coordinates)

    @cached_property
    def leading(self) -> Mapping[int, int]:
        """How many numbers of q the first n coordinates have, for each n that a reference may have."""
        return MappingProxyType(leading(self._model))

    @property
    def adds(self) -> bool:
        """Whether `integrate` adds displacements to q number by number, in both of which psi is the third."""
        return self.nq == self.nv and type(self).integrate is ChainConfigurations.integrate

    @property
    def turning(self) -> tuple[int, ...] | None:
        """Coordinates that `difference` takes on the circle where it subtracts all, else None."""
        own = type(self).difference is ChainConfigurations.difference
        return (2,) if own and self.adds else None

    @property
    def broadcasts(self) -> bool:
        """Whether its methods take leading axes, here True."""
        return True

    @cached_property
    def configuration_names(self) -> tuple[str, ...]:
        """Name of each of the nq numbers in q; of a joint without limits ``name:cos`` and ``name:sin``."""
        return configuration_names(self._model)

    @cached_property
    def _limits(self) -> tuple[Array, Array, Array, Array]:
        lower, upper, speed, effort = map(frozen, limits(self._model, self.mounts))
        return lower, upper, speed, effort

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

    @cached_property
    def _resistances(self) -> tuple[Array, Array]:
        damping, friction = map(frozen, resistances(self.nv, self.mounts))
        return damping, friction

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

    @cached_property
    def neutral(self) -> Array:
        """Configuration with all coordinates at zero, angles that are (cos, sin) among them, shape (nq,)."""
        return frozen(self._engine.reorder(pin.neutral(self._model)))

    @cached_property
    def rest(self) -> Array:
        """Configuration at the origin with each arm in its reference posture, shape (nq,).

        Where its description has none, its neutral one. All is brought within the limits.
        """
        q = self.neutral.copy()
        for mount in self.mounts:
            q[mount.q] = mount.arm.posture
        return frozen(np.clip(q, self.lower, self.upper))

    def random_configuration(self, generator: "np.random.Generator", shape: tuple[int, ...] = ()) -> Array:
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
        if not isinstance(generator, np.random.Generator):
            raise InvalidArgument(f"generator is {shown(generator)}, expected a numpy.random.Generator")
        shape = tuple(
            whole("shape", n, least=0) for n in sequence("shape", shape, "a tuple of whole numbers")
        )
        affordable("random configurations", 4.0 * self.nq * prod(shape), "draw fewer at a time")
        free = generator.uniform(-np.pi, np.pi, (*shape, self.nv))
        free[..., :2] /= np.pi
        q = self.integrate(np.broadcast_to(self.neutral, (*shape, self.nq)), free)
        limited = np.isfinite(self.lower) & np.isfinite(self.upper)
        q[..., limited] = generator.uniform(
            self.lower[limited], self.upper[limited], (*shape, np.count_nonzero(limited))
        )
        return q

    def integrate(self, q: ArrayLike, dq: ArrayLike) -> Array:
        """Return the configuration that the displacement `dq` leads to from `q`, shape (..., nq).

        x, y, psi and joints with one number each add, psi beyond pi too; other joints by Pinocchio.
        """
        q, dq = self._q(q), self._v("dq", dq)
        broadcast(q=q, dq=dq)
        if self.nq == self.nv:
            with np.errstate(over="ignore"):
                return finite_answer(q + dq, q=q, dq=dq)
        return self._each(_INTEGRATED, q=q, dq=dq)

    def integrate_jacobian(self, q: ArrayLike, dq: ArrayLike) -> Array:
        """Return how `integrate` turns rates of `dq` into velocities, shape (..., nv, nv).

        Where a displacement dq changes at the rate r, the configuration ``integrate(q, dq)`` moves with the
        velocity J r. J is the identity but for joints that turn about several axes, or turn and slide: of a
        ball joint it is the right Jacobian of the exponential map.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        dq : array_like, shape (..., nv)
            Displacement [m, m, rad, ...].
        """
        q, dq = self._q(q), self._v("dq", dq)
        return self._each(_INTEGRATE_JACOBIAN, q=q, dq=dq)

    def difference(self, q0: ArrayLike, q1: ArrayLike) -> Array:
        """Return the displacement from `q0` to `q1`, shape (..., nv); that of psi lies in (-pi, pi].

        That of joints without limits is taken on the circle too, by Pinocchio; others are subtracted.
        """
        q0, q1 = self._q(q0, "q0"), self._q(q1, "q1")
        small = q0.ndim == q1.ndim == 1 and isfinite(np.vdot(q0, q0) + np.vdot(q1, q1))
        if small and self.nq == self.nv:
            displacement = q1 - q0  # in a loop: it cannot overflow
        elif self.nq == self.nv:
            broadcast(q0=q0, q1=q1)
            with np.errstate(over="ignore"):
                displacement = finite_answer(q1 - q0, q0=q0, q1=q1)
        else:
            broadcast(q0=q0, q1=q1)
            displacement = self._each(_DIFFERENCE, q0=q0, q1=q1)
        angle = displacement[..., 2]
        if angle.ndim or not LEAST_ANGLE < angle <= np.pi:  # in a loop it hardly ever is beyond
            displacement[..., 2] = wrap_angle(angle)
        return displacement

    def _each(self, law: Law, **arguments: Array) -> Array:
        """Return what a law gives for each row of the arguments, in public order.

        Leading axes broadcast; what comes back is stacked along them. From `MANY` states on it is compiled.

        Raises
        ------
        NotFinite
            If what comes back is not finite.
        """
        engine, rows = self._engine, []
        for argument in arguments.values():
            if argument.ndim != 1:
                return self._stacked(law, **arguments)
            rows.append(argument[engine.orders[len(argument)]])
        # A copy: Pinocchio hands out views of its data.
        answer = law.order(engine, np.array(law.run(engine.model, engine.data, *rows)))
        return answer if isfinite(np.vdot(answer, answer)) else finite_answer(answer, **arguments)

    def _stacked(self, law: Law, **arguments: Array) -> Array:
        """Return what `_each` does of arguments with leading axes."""
        engine, lead = self._engine, broadcast(**arguments)
        model, data, n = engine.model, engine.data, prod(lead)
        if n >= MANY and law.name:
            found = answers(self._for_many, law, **arguments)
            if found is not None:
                return found
        stacked = [
            engine.reorder(np.broadcast_to(argument, (*lead, argument.shape[-1]))).reshape(
                n, argument.shape[-1]
            )
            for argument in arguments.values()
        ]
        if not n:
            probes = (np.zeros(row.shape[1]) for row in stacked[1:])
            shape = np.shape(law.order(engine, np.asarray(law.run(model, data, pin.neutral(model), *probes))))
            return np.empty((*lead, *shape))
        rows = [np.array(law.run(model, data, *row)) for row in zip(*stacked, strict=True)]
        found = law.order(engine, np.stack(rows).reshape((*lead, *rows[0].shape)))
        return finite_answer(found, **arguments)

    @property
    @abstractmethod
    def _for_many(self) -> ArticulatedBody | None:
        """What does the same for many states at once; None where a joint has more than one coordinate."""

    def configuration(self, value: ArrayLike, name: str = "q") -> Array:
        """Return configurations as float64, shape (..., nq), after refusing what are none.

        Parameters
        ----------
        value : array_like, shape (..., nq)
            Configurations [m, m, rad, ...].
        name : str
            What they are called, for the message.
        """
        return self._q(value, name)

    def _q(self, q: ArrayLike, name: str = "q") -> Array:
        array = vector(name, q, self.nq)
        for part, joint in self._unit_parts:
            off = np.abs(np.linalg.norm(array[..., part], axis=-1) - 1)
            if off.size and not off.max() <= _UNIT:
                raise InvalidArgument(
                    f"{name}[..., {part.start}:{part.stop}] of joint {joint!r} has a length off by "
                    f"{off.max():.3g}, expected length one: step it with `integrate`"
                )
        return array

    def _here(self, q: ArrayLike) -> Array:
        """Return q, checked, with x = y = 0.

        Where Pinocchio works in the inertial frame, what depends on neither loses digits to both far away.
        """
        moved = self._q(q).copy()
        moved[..., :2] = 0.0
        return moved

    def _v(self, name: str, value: ArrayLike) -> Array:
        return vector(name, value, self.nv)

    @cached_property
    def _unit_parts(self) -> tuple[tuple[slice, str], ...]:
        """The parts of q that lie on a circle or a sphere, and their joints' names."""
        model, parts = self._model, []
        for j in range(1, model.njoints):
            # In Pinocchio's order: (cos, sin), a quaternion, (x, y, cos, sin), (x, y, z, quaternion).
            circle = (model.nqs[j], model.nvs[j]) == (2, 1) or "Planar" in joint_kind(model, j)
            sphere = (model.nqs[j], model.nvs[j]) in ((4, 3), (7, 6))
            width = 2 if circle else 4 if sphere else 0
            end = parts_of(model, j)[0].stop
            if width:
                parts.append((slice(end - width, end), str(model.names[j])))
        return tuple(parts)


def _integrated(model: pin.Model, data: pin.Data, q: Array, dq: Array) -> Array:
    return np.asarray(pin.integrate(model, q, dq))


def _integrate_jacobian(model: pin.Model, data: pin.Data, q: Array, dq: Array) -> Array:
    return np.asarray(pin.dIntegrate(model, q, dq, pin.ArgumentPosition.ARG1))


def _difference(model: pin.Model, data: pin.Data, q0: Array, q1: Array) -> Array:
    return np.asarray(pin.difference(model, q0, q1))


_INTEGRATED = Law(_integrated, "integrate", order=Engine.reorder, turns=False)
_INTEGRATE_JACOBIAN = Law(_integrate_jacobian, order=Engine.reorder_square)
_DIFFERENCE = Law(_difference, "difference", order=Engine.reorder, turns=False)
