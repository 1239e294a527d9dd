"""`ArticulatedBody`: the dynamics of a body with arms in the plane, for one state, many, or symbols.

It is what a `MobileRobot` with arms is to compiled loops and to loops on arrays: see `PlanarBody`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, Self, final

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinmobile.arrays import Array, finite, frozen, one_of, scalar, wrap_angle
from pinmobile.compiled import plain
from pinmobile.errors import InvalidArgument
from pinmobile.measures import Measure
from pinmobile.plant import Coordinate, Input, Parameter
from pinmobile.robot.complex_step import linearized
from pinmobile.robot.linkage import (
    ZERO,
    Body,
    Linkage,
    Matrix,
    Place,
    Vector,
    applied,
    cross,
    dot,
    exact,
    matrix_of,
    number,
    plus,
    regrouped,
    scalar_of,
    scalars,
    single,
    vector_of,
    volume,
    without_rounding,
)
from pinmobile.robot.mounts import LinkNumbers, Mount, are_impossible, body_parameters, named_frames
from pinmobile.robot.planar import BODY_PARAMETERS
from pinmobile.robot.recursions import Moving, Posture, by_matrix, operations
from pinmobile.robot.stance import Judgement

_BASE = 3  # joints, coordinates and numbers of q of the base; the last carries its body
_OF_BASE = ("mass", "yaw_inertia", "com_x", "com_y")
_OF_BODIES = ("masses", "coms", "inertias")
_OTHERS = (*_OF_BODIES, *(f"load_{name}" for name in _OF_BODIES), "rotors", "places", "upright")
_PLACE = {"at_x": "m", "at_y": "m", "at_z": "m", "at_yaw": "rad"}
_SHARED = 1.05  # the way by the mass matrix shares products of velocities with a controller's own dynamics
_DIGITS = 15  # of places on an arm [m], and of what is turned there


class Fixed(NamedTuple):
    """A frame that is fixed to a joint.

    Attributes
    ----------
    name : str
        Of the frame.
    joint : int
        Of the linkage.
    arm : int
        Which arm it is a part of, if it stands on the base where that does; else -1.
    R, p : ndarray, shape (3, 3), (3,)
        Its orientation and origin in the joint's frame [m].
    """

    name: str
    joint: int
    arm: int
    R: Array
    p: Array


@final
@dataclass(frozen=True, eq=False)
class ArticulatedBody:
    """A body in the plane that carries arms and loads, by recursions over its joints, unchecked.

    What is each robot's own has leading axes before the shapes below.

    Parameters
    ----------
    linkage : Linkage
        Its joints; the first three are the base's.
    links, loads, frames : tuple of Fixed
        Where the bodies below stand, and what has a name.
    arms : tuple of (str, (float, float, float, float))
        Names of the arms, and where they stand unless `places` are varied: x, y, z and yaw [m, m, m, rad].
    coordinates, inputs
        As of a plant.
    rest : ndarray, shape (nq,)
        Where what has no reference starts.
    mass, yaw_inertia, com_x, com_y : float
        Of the base's own body, as in `PlanarBody`.
    upright : ndarray, shape (3,)
        Of the same body, what the ground alone feels: height of the centre of mass [m], and inertia xz and yz
        about it, as shares of the yaw inertia, with which they grow.
    masses, coms, inertias : ndarray, shape (links,), (3 links,), (6 links,)
        Of each link, along the axes of its frame: mass, centre of mass, and inertia (xx, yy, zz, xy, xz, yz)
        about that [kg, m, kg m^2].
    load_masses, load_coms, load_inertias : ndarray
        The same of the loads.
    rotors : ndarray, shape (nv - 3,)
        What the motors of the arms' joints add to their inertias [kg m^2, kg].
    places : ndarray, shape (4 arms,)
        Where the arms stand.
    judgement : Judgement
        What is worth judging about it.
    end_effector : str
        The frame that is meant where none is named.
    varied : frozenset of (str, int), optional
        Attributes and entries that differ from robot to robot; of others, what is zero is left out, and where
        an arm stands is a constant. By default, all may differ.
    """

    linkage: Linkage
    links: tuple[Fixed, ...]
    loads: tuple[Fixed, ...]
    frames: tuple[Fixed, ...]
    arms: tuple[tuple[str, tuple[float, ...]], ...]
    coordinates: tuple[Coordinate, ...]
    inputs: tuple[Input, ...]
    rest: Array
    mass: Array | float
    yaw_inertia: Array | float
    com_x: Array | float
    com_y: Array | float
    masses: Array
    coms: Array
    inertias: Array
    load_masses: Array
    load_coms: Array
    load_inertias: Array
    rotors: Array
    places: Array
    upright: Array
    judgement: Judgement
    end_effector: str
    varied: frozenset[tuple[str, object]] | None = None
    matter: tuple[tuple[bool, ...], ...] = ()

    broadcasts: ClassVar[bool] = True
    EXPECTED: ClassVar[str] = "expected principal moments >= 0, none above the sum of the other two"

    def __post_init__(self) -> None:
        matter = (
            tuple(bool(x) or self._differs(name, k) for k, x in enumerate(getattr(self, name)))
            for name in _OTHERS
        )
        object.__setattr__(self, "matter", tuple(matter))

    def _differs(self, name: str, entry: int) -> bool:
        return self.varied is None or (name, entry) in self.varied

    def varying(self, entries: Iterable[tuple[str, object]]) -> Self:
        """Return it, told which attributes and entries of its parameters differ from robot to robot."""
        return replace(self, varied=frozenset(entries))

    def each_its_own(self) -> Self:
        """Return it with all numbers varying that are not zero: robots with such others have its `form`."""
        names = ((name, k) for name in _OTHERS for k, x in enumerate(getattr(self, name)) if x)
        return self.varying(names)

    @cached_property
    def form(self) -> tuple[Any, ...]:
        """What its laws are made of beside its `numbers`: kinematics, and which numbers are zero."""
        tree, base = self.linkage, [bool(getattr(self, name)) for name in _OF_BASE]
        arrays = tree.gravity, tree.axes, *(x for i in range(self.nv) for x in self._joint_own(i))
        fixed = [self.form_of(each) for each in (*self.links, *self.loads)]
        shape = tree.parents, tree.turns, tree.circular, len(self.links), self.matter
        return *shape, *base, *(x.tobytes() for x in arrays), *fixed

    def form_of(self, fixed: Fixed) -> tuple[Any, ...]:
        """Return what the laws know of something that stands still on a joint."""
        name = fixed.name.partition("/")[0]
        owner = [arm for arm, _ in self.arms].index(name) if "/" in fixed.name else -1
        return owner, fixed.joint, fixed.arm, *(x.tobytes() for x in self._own_place(*fixed[2:]))

    @property
    def numbers(self) -> dict[str, Array]:
        """What differs between robots of one `form`, by attribute."""
        base = {name: np.asarray(getattr(self, name)) for name in _OF_BASE if getattr(self, name)}
        return base | {name: getattr(self, name) for name in _OTHERS}

    @property
    def leading(self) -> dict[int, int]:
        """How many numbers of q the first n coordinates have, for each n that a reference may have."""
        return {n: n for n in range(_BASE, self.nv + 1)}

    @property
    def nq(self) -> int:
        """Size of q."""
        return len(self.rest)

    @property
    def nv(self) -> int:
        """Size of v and a."""
        return len(self.linkage)

    @property
    def nu(self) -> int:
        """Size of the input."""
        return self.nv

    @property
    def worth_arrays(self) -> int:
        """Number of robots from which on arrays of them are faster than Pinocchio one after another."""
        return 15 * self.nv

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """What may be spread: of the base, of links and loads, of motors, and where arms stand."""
        found = [replace(each, attribute=each.name) for each in BODY_PARAMETERS]
        for k, link in enumerate(self.links):
            found += body_parameters(k, "", f"_{link.name}", link.name)
        for k, load in enumerate(self.loads):
            after = f"_{k + 1}" if k else ""
            found += body_parameters(k, "load_", after, f"the load at {load.name}")
        for k, joint in enumerate(self.coordinates[_BASE:]):
            unit, meaning = "kg" if joint.unit == "m" else "kg m^2", f"inertia that the motor of {joint.name}"
            name = f"rotor_{joint.name}"
            found.append(
                Parameter(name, unit, f"{meaning} adds, of the robot", 0.0, attribute="rotors", entry=k)
            )
        for k, (arm, _) in enumerate(self.arms):
            for j, (name, unit) in enumerate(_PLACE.items()):
                meaning = f"{name.removeprefix('at_')} of where {arm} stands on the robot"
                entry = len(_PLACE) * k + j
                found.append(Parameter(f"{name}_{arm}", unit, meaning, attribute="places", entry=entry))
        return tuple(found)

    def _numbers(self, name: str) -> Vector:
        """Return the entries of an attribute; what is zero for all robots, as such."""
        entries, matter = scalars(getattr(self, name)), self.matter[_OTHERS.index(name)]
        return [x if own else ZERO for x, own in zip(entries, matter, strict=True)]

    @cached_property
    def _stands(self) -> list[Place | None]:
        """Where the arms stand; None where that is the same for all robots."""
        numbers, found = self._numbers("places"), []
        for arm in range(len(self.arms)):
            *origin, yaw = numbers[4 * arm : 4 * arm + 4]
            found.append(Place.about_z(yaw, origin) if self._moves(arm) else None)
        return found

    def _moves(self, arm: int) -> bool:
        """Tell whether an arm stands elsewhere on other robots."""
        return any(self._differs("places", 4 * arm + j) for j in range(4))

    def _own_place(self, arm: int, R: Array, p: Array) -> tuple[Array, Array]:
        """Return where something stands in its joint's frame, or on its arm, where that moves."""
        if arm < 0 or not self._moves(arm):
            return R, p
        x, y, z, yaw = self.arms[arm][1]
        c, s = np.cos(yaw), np.sin(yaw)
        back = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        # Rounded, it is the same wherever the arm stands.
        turn, origin = (np.round(array, _DIGITS) for array in (back @ R, back @ (p - [x, y, z])))
        return without_rounding(turn), without_rounding(origin)

    def _placed(self, arm: int, R: Array, p: Array) -> Place:
        """Return where something stands in its joint's frame, on an arm or not."""
        place, stand = Place.of(*self._own_place(arm, R, p)), self._stands[arm] if arm >= 0 else None
        return place if stand is None else place.within(stand)

    def _joint_own(self, i: int) -> tuple[Array, Array]:
        return self._own_place(*self._joint(i))

    def _joint(self, i: int) -> tuple[int, Array, Array]:
        """Return where a joint stands in that which it hangs on: its arm, if that stands there, and how."""
        tree = self.linkage
        name, on_base = tree.names[i].partition("/")[0], tree.parents[i] == _BASE - 1
        arm = [arm for arm, _ in self.arms].index(name) if on_base else -1
        return arm, tree.rotations[i], tree.offsets[i]

    @cached_property
    def _joints(self) -> list[Place]:
        """Where the joints stand in those that they hang on."""
        return [self._placed(*self._joint(i)) for i in range(self.nv)]

    def _base(self, z: Any = ZERO, xz: Any = ZERO, yz: Any = ZERO) -> Body:
        """Return the base's own body, `upright` of it as given."""
        mass, inertia, x, y = (single(plain(getattr(self, name))) for name in _OF_BASE)
        return Body.of(mass, [x, y, z], [ZERO, ZERO, inertia, ZERO, xz * inertia, yz * inertia])

    @cached_property
    def _bodies(self) -> list[Body]:
        """What is fixed to each joint, grouped so that least is to compute."""
        return regrouped(self.linkage, self._joints, self._carried(self._base()))

    @cached_property
    def _bodies_on_ground(self) -> list[Body]:
        """What is fixed to each joint, grouped so that the base's still feels what it does of the ground."""
        carried = self._carried(self._base(*self._numbers("upright")))
        return regrouped(self.linkage, self._joints, carried, _BASE - 1)

    def _carried(self, base: Body, before: str = "") -> list[Body]:
        """Return what is fixed to each joint: the base's body, and links and loads whose names begin so."""
        found = [Body.none() for _ in self.coordinates]
        found[_BASE - 1] = base
        for prefix, frames in (("", self.links), ("load_", self.loads)):
            masses, coms, inertias = (self._numbers(f"{prefix}{name}") for name in _OF_BODIES)
            for k, (name, joint, arm, R, p) in enumerate(frames):
                if name.startswith(before):
                    body = Body.of(masses[k], coms[3 * k : 3 * k + 3], inertias[6 * k : 6 * k + 6])
                    place = self._placed(arm, R, p)
                    found[joint] = found[joint].joined(body.turned(place.R).moved(place.p))
        return found

    @cached_property
    def _axes(self) -> list[Matrix]:
        """How the joints' frames are turned in Pinocchio's."""
        return [[[exact(x) for x in row] for row in turn] for turn in self.linkage.axes.tolist()]

    @cached_property
    def _motors(self) -> Vector:
        """What motors add to the inertias of the joints, in the order of the linkage."""
        return [*[ZERO] * _BASE, *self._numbers("rotors")]

    @cached_property
    def _by_matrix(self) -> bool:
        """Whether accelerations come by the mass matrix, or else by articulated bodies: as takes less."""
        known, key = self.linkage.counted, (self.varied, self.matter)
        if key not in known:
            by_bodies, by_mass_matrix = operations(self.linkage, self._joints, self._bodies, self._motors)
            known[key] = by_mass_matrix < _SHARED * by_bodies
        return known[key]

    def _posture(self, q: Array) -> Posture:
        return Posture(self.linkage, self._joints, scalars(q))

    def _moving(self, q: Array, v: Array) -> Moving:
        return Moving(self.linkage, self._joints, scalars(q), scalars(v))

    def forward_dynamics(self, q: Array, v: Array, u: Array, f: Array | float = 0.0) -> Array:
        """Return the acceleration, shape (..., nv)."""
        moving, bodies, motors = self._moving(q, v), self._bodies, self._motors
        way = by_matrix if self._by_matrix else Moving.accelerations
        return vector_of(way(moving, bodies, motors, scalars(u + f)), q)

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
        """Return C(q, v), shape (..., nv, nv), of Christoffel's symbols.

        n - g is quadratic in v, and each column of C its symmetric bilinear form, with a unit velocity.
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
        still = [ZERO] * self.nv
        moving = Moving(self.linkage, self._joints, scalars(q), still)
        return vector_of(moving.efforts(self._bodies, still), q)

    def kinetic_energy(self, q: Array, v: Array) -> Array:
        """Return v' M(q) v / 2, shape (...)."""
        moving, rates = self._moving(q, np.zeros(self.nv)), scalars(v)
        momenta = moving.efforts(self._bodies, rates, falling=False)
        pairs = zip(momenta, self._motors, rates, strict=True)
        return scalar_of(0.5 * dot(rates, [momentum + motor * rate for momentum, motor, rate in pairs]), q)

    def potential_energy(self, q: Array) -> Array:
        """Return the energy in the field of gravity, shape (...)."""
        moment = self._posture(q).first_moment(self._bodies_on_ground)
        return scalar_of(-dot(moment, map(exact, self.linkage.gravity.tolist())), q)

    def regressor(self, q: Array, v: Array, a: Array) -> Array:
        """Return Y(q, v, a), shape (..., nv, 10 bodies): of the base's body, and of each joint's after it."""
        found = self._moving(q, v).regressor(self._axes, _BASE - 1, scalars(a))
        return matrix_of([vector_of(row, q) for row in found])

    def linearize_tracked(self, q: Array, v: Array, u: Array) -> tuple[Array, Array]:
        """Return A, shape (..., 2 nv, 2 nv), and B, (..., 2 nv, nv), see `MobileRobot.linearize`."""
        return linearized(self, q, v, u)

    def mass_matrix(self, q: Array) -> Array:
        """Return M(q), shape (..., nv, nv)."""
        M = self._posture(q).mass_matrix(self._bodies)
        for i, motor in enumerate(self._motors):
            M[i][i] = M[i][i] + motor
        return matrix_of([vector_of(row, q) for row in M])

    def ground_wrench(self, q: Array, v: Array, a: Array) -> Array:
        """Return what the ground exerts on the robot, shape (..., 6): force, moment, along and about B."""
        force, moment = self._felt(self._bodies_on_ground, q, v, a)
        return vector_of([*force, *moment], q)

    def mount_wrench(self, q: Array, v: Array, a: Array, mount: str) -> Array:
        """Return what an arm exerts on the base, shape (..., 6), along the base's axes, about the mount."""
        arm = [name for name, _ in self.arms].index(mount)
        bodies = regrouped(self.linkage, self._joints, self._carried(Body.none(), f"{mount}/"), _BASE - 1)
        force, moment = self._felt(bodies, q, v, a)
        stand = self._stands[arm]
        at = [exact(x) for x in self.arms[arm][1][:3]] if stand is None else stand.p
        about = plus(moment, cross(force, at))
        return vector_of([-x for x in (*force, *about)], q)

    def _felt(self, bodies: Sequence[Body], q: Array, v: Array, a: Array) -> tuple[Vector, Vector]:
        """Return the force and the moment, along and about the base's frame, that let bodies move so."""
        base, forces = _BASE - 1, self._moving(q, v).wrenches(bodies, scalars(a))
        force, moment = (applied(self._axes[base], each[base]) for each in forces)
        return force, moment

    @property
    def weight(self) -> Any:
        """Weight of all that it is made of [N]."""
        total = single(plain(self.mass))
        for name in ("masses", "load_masses"):
            for mass in self._numbers(name):
                total = total + mass
        return number(total * float(np.linalg.norm(self.linkage.gravity)))

    @property
    def measures(self) -> tuple[Measure, ...]:
        """What is worth judging about it: see `MobileRobot.measures`."""
        return self.judgement.measures

    def measured(self, t: Array | float, q: Array, v: Array, a: Array, u: Array, reference: Any) -> Array:
        """Return its measures, shape (..., m)."""
        return self.judgement.measured(self, q, v, a, u, reference.q)

    def frame_pose(self, q: Array, frame: str | None = None) -> Array:
        """Return T_0_f, the pose of a frame, shape (..., 4, 4)."""
        fixed = self._frame(frame)
        R, p = self._posture(q).placed(fixed.joint, self._placed(*fixed[2:]))
        last = np.array([0.0, 0.0, 0.0, 1.0])
        return matrix_of([*(vector_of([*row, x], q) for row, x in zip(R, p, strict=True)), last])

    def frame_jacobian(self, q: Array, frame: str | None = None) -> Array:
        """Return J, shape (..., 6, nv): of the frame's origin, and angular, along the inertial axes."""
        fixed = self._frame(frame)
        J = self._posture(q).jacobian(fixed.joint, self._placed(*fixed[2:]).p)
        return matrix_of([vector_of(row, q) for row in J])

    def manipulability(self, q: Array, frame: str | None = None, arm: str = "") -> Array:
        """Return sqrt(det J J'), shape (...), of all coordinates, or of those of an arm alone."""
        fixed, names = self._frame(frame), self.linkage.names
        J = self._posture(q).jacobian(fixed.joint, self._placed(*fixed[2:]).p)
        ahead = arm and f"{arm}/"
        own = [k for k, name in enumerate(names) if name.startswith(ahead)]
        return scalar_of(volume([[row[k] for k in own] for row in J]), q)

    def frame_drift(self, q: Array, v: Array, frame: str | None = None) -> Array:
        """Return dJ/dt v, shape (..., 6), J as in `frame_jacobian`."""
        fixed = self._frame(frame)
        line, spin = self._moving(q, v).drift(fixed.joint, self._placed(*fixed[2:]).p)
        return vector_of([*line, *spin], q)

    def _frame(self, name: str | None) -> Fixed:
        name = self.end_effector if name is None else name
        known = {fixed.name: fixed for fixed in self.frames}
        return known[one_of("frame", name, known)]

    def integrate(self, q: Array, dq: Array) -> Array:
        """Return the configuration that a displacement leads to, shape (..., nq)."""
        return q + dq

    def difference(self, q0: Array, q1: Array) -> Array:
        """Return the displacement from q0 to q1, shape (..., nv); psi and continuous joints on the circle."""
        d, circular = q1 - q0, self.linkage.circular
        return np.stack(
            [wrap_angle(d[..., k]) if k in circular else d[..., k] for k in range(self.nv)], axis=-1
        )

    def pose(self, q: Array) -> Array:
        """Return x, y and psi of the body, shape (..., 3)."""
        return q[..., :_BASE]

    def rate(self, q: Array, v: Array) -> Array:
        """Return the rates of x, y and psi, shape (..., 3)."""
        return v[..., :_BASE]

    def effort(self, q: Array, wrench: Array) -> Array:
        """Return the generalised force of a wrench on the body, shape (..., nv)."""
        return np.concatenate([wrench, np.zeros((*np.shape(wrench)[:-1], self.nv - _BASE))], axis=-1)

    def start(self, reference: Any) -> tuple[Array, Array]:
        """Return the q and v with which a reference begins; what it does not lead rests."""
        n = reference.v.shape[-1]
        return np.append(reference.q, self.rest[n:]), np.append(reference.v, np.zeros(self.nv - n))

    def numbers_with(self, values: Mapping[str, Any]) -> dict[str, Array]:
        """Return the numbers of all attributes; some, by name of attribute or parameter, are others.

        Raises
        ------
        InvalidArgument
            If an array has another shape, a number is not what is expected, or no body has such an inertia.
        """
        found = {name: np.array(getattr(self, name), np.float64) for name in (*_OF_BASE, *_OTHERS)}
        for name, value in values.items():
            if name in found:
                array = finite(name, value)
                if array.shape != found[name].shape:
                    raise InvalidArgument(f"{name} has shape {array.shape}, expected {found[name].shape}")
                found[name] = array
        for parameter in self.parameters:
            array, entry = found[parameter.attribute], parameter.entry if parameter.entry is not None else ()
            if parameter.name in values and parameter.name not in found:
                array[entry] = scalar(parameter.name, values[parameter.name])
            if not parameter.allows(array[entry]):
                raise InvalidArgument(f"{parameter.name} is {array[entry]:g}, expected {parameter.bound}")
        for name, _ in self.impossible({name: array[None] for name, array in found.items()}):
            raise InvalidArgument(f"inertia of {name} is one that no body has, {self.EXPECTED}")
        return found

    def impossible(self, values: Mapping[str, Array]) -> Iterator[tuple[str, NDArray[np.bool_]]]:
        """Return the bodies that are drawn as no body is: their names, and of which of m robots, shape (m,).

        Parameters
        ----------
        values : mapping of str to ndarray, shape (m, ...)
            Attributes that differ.
        """
        for prefix, frames, kind in (("", self.links, ""), ("load_", self.loads, "load at ")):
            drawn, masses = values.get(f"{prefix}inertias"), values.get(f"{prefix}masses")
            if drawn is not None and frames:
                own = getattr(self, f"{prefix}masses") if masses is None else masses
                wrong = are_impossible(drawn.reshape(len(drawn), len(frames), 6), own)
                for k, fixed in enumerate(frames):
                    if wrong[:, k].any():
                        yield f"{kind}{fixed.name}", wrong[:, k]


def articulated(robot: Any, linkage: Linkage) -> ArticulatedBody:
    """Return the dynamics of a robot with arms.

    Parameters
    ----------
    robot : MobileRobot
        Its names, its body, and what it carries.
    linkage : Linkage
        Its tree, in public order.
    """
    model, numbers = robot._model, [LinkNumbers.of(mount._model) for mount in robot.mounts]
    frames = {
        name: _fixed(linkage, name, model.frames[k], robot.mounts)
        for name, k in named_frames(model).items()
        if model.frames[k].parentJoint >= _BASE  # those of the virtual links move with a part of the pose
    }
    links = []
    for k, mount in enumerate(robot.mounts):
        place, (root, *others) = mount.placement, mount.links
        links.append(Fixed(root, _BASE - 1, k, frozen(place.rotation), frozen(place.translation)))
        for joint, name in enumerate(others, mount.joints.start - 1):
            links.append(Fixed(name, joint, -1, frozen(linkage.axes[joint].T), frozen(np.zeros(3))))
    loads = [load for _, load in robot.loads]
    of_links = (np.concatenate([[], *(each[k].ravel() for each in numbers)]) for k in range(3))
    masses, coms, inertias = map(frozen, of_links)
    return ArticulatedBody(
        linkage=linkage,
        links=tuple(links),
        loads=tuple(frames[name] for name, _ in robot.loads),
        frames=tuple(frames.values()),
        arms=tuple((mount.name, mount.at) for mount in robot.mounts),
        coordinates=robot.coordinates,
        inputs=robot.inputs,
        rest=robot.rest,
        mass=robot.mass,
        yaw_inertia=robot.body.yaw_inertia,
        com_x=float(robot.body.com[0]),
        com_y=float(robot.body.com[1]),
        masses=masses,
        coms=coms,
        inertias=inertias,
        load_masses=frozen([load.mass for load in loads]),
        load_coms=frozen(np.ravel([load.com for load in loads])),
        load_inertias=frozen(np.ravel([load.six for load in loads])),
        rotors=frozen(np.concatenate([[], *(each.rotors for each in numbers)])),
        places=frozen(np.ravel([mount.at for mount in robot.mounts])),
        upright=frozen([robot.body.com[2], *(robot.body.inertia[2, :2] / robot.body.yaw_inertia)]),
        judgement=Judgement.of(robot),
        end_effector=robot.end_effector,
    )


def _fixed(linkage: Linkage, name: str, frame: pin.Frame, mounts: Sequence[Mount]) -> Fixed:
    joint = frame.parentJoint - 1
    turn, place = linkage.axes[joint].T, frame.placement
    own = [k for k, mount in enumerate(mounts) if name.startswith(f"{mount.name}/") and joint == _BASE - 1]
    return Fixed(
        name, joint, own[0] if own else -1, frozen(turn @ place.rotation), frozen(turn @ place.translation)
    )
