"""`MobileRobot`, the noun: parameters that check themselves, and the dynamics that follow from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any, final

import attrs
import numpy as np
import pinocchio as pin

from pinmobile import urdf
from pinmobile.arrays import (
    Array,
    ArrayLike,
    broadcast,
    finite,
    finite_answer,
    frozen,
    instance,
    lengths,
    location,
    sequence,
    shaped,
    text,
)
from pinmobile.dh import LECTURE_TABLE, DHTable
from pinmobile.errors import InvalidArgument, NotTraceable
from pinmobile.files import keep
from pinmobile.metrics import Metric
from pinmobile.parts import (
    Desired,
    Number,
    children,
    declare,
    evolved,
    fields_of,
    is_symbolic,
    number,
    numeric,
    option,
    part,
    required,
    structure,
    walk,
)
from pinmobile.robot.arm_loading import KeptArm, existing_folders, read_arm
from pinmobile.robot.arms import check_whole, com_field
from pinmobile.robot.articulated import ArticulatedDynamics, PlanarDynamics, Tree
from pinmobile.robot.linkage import BODY_JOINT
from pinmobile.robot.model_import import (
    LOCKED,
    build_model,
    check_chain,
    read_model,
    read_urdf,
)
from pinmobile.robot.mounts import (
    Mount,
    PayloadBody,
    assemble,
    checked_name,
    free_name,
    free_place,
)
from pinmobile.robot.pinocchio_backend import PinocchioBackend, UncheckedDynamics, in_public_order
from pinmobile.robot.support_geometry import ArmMetrics, Stance, Undercarriage
from pinmobile.robot.system import System, by_values
from pinmobile.robot.visuals import (
    Solids,
    VisualFile,
    add_carried,
    body_box,
    body_shapes,
    box_visuals,
    carried_shapes,
    read_visuals,
)


@attrs.frozen
class _Size(Number):
    """Declaration of the sides of the box that is drawn."""

    def checked(self, name: str, value: Any) -> tuple[float, ...]:
        """Return a tuple of floats."""
        return tuple(lengths(value).tolist())


def _frozen(name: str, inertia: Array | None) -> Array | None:
    return None if inertia is None else frozen(inertia)


@final
@part
class MobileRobot(System):
    """A rigid body on the chain prismatic y, prismatic x, revolute z, with Pinocchio's dynamics.

    Conventions, and the errors of the methods that it inherits: see `System`. With arms mounted, see
    `mount`, the parameters below are those of the base's body alone.

    Parameters
    ----------
    mass : float
        Mass [kg].
    yaw_inertia : float
        Inertia about the vertical through the centre of mass, Icz [kg m^2].
    com : sequence of 2 or 3 floats
        Centre of mass in the body frame (xbc, ybc) or (xbc, ybc, zbc) [m].
    size : sequence of 3 floats
        Length, width and height of the box that is drawn [m]; a robot made from numbers stands on it, too:
        see `footprint` and `top`.
    dh : DHTable
        The chain; the joint frames of `model` are its frames.

    Attributes
    ----------
    mounts : tuple of Mount
        Its arms.
    loads : tuple of PayloadBody
        What is attached to it.
    reference_inertia : ndarray, shape (3, 3), or None
        Inertia of the body about all axes, which grows with `yaw_inertia`; None: the same about all.
    locked_joints : tuple of str
        Joints of its file that are locked at rest: wheels, and what carries them.
    undercarriage : Undercarriage
        The wheels of its file, and what else it stands on, for a `WheeledRobot`; empty where it was not read
        from a file or a model.

    Raises
    ------
    InvalidArgument
        If a mass, inertia or size is not positive, a shape is wrong, a value is not finite, or `dh` is not
        a chain of prismatic y, prismatic x, revolute z.
    """

    mass: float = number(unit="kg", above=0, doc="mass of the robot")
    yaw_inertia: float = number(
        unit="kg m^2", above=0, doc="inertia of the robot about the vertical through its centre of mass"
    )
    com: Any = com_field((0.0, 0.0, 0.0), shapes=((2,), (3,)), doc="centre of mass of the robot")
    size: Any = declare(
        _Size("sides of the box that is drawn", "m", 0.0, shapes=((3,),), fixed=True), (0.6, 0.4, 0.2)
    )
    dh: DHTable = option(default=LECTURE_TABLE, check=check_chain, doc="the chain that carries it")
    mounts: tuple[Mount, ...] = children(Mount, default=(), kw_only=True, doc="arms on it")
    loads: tuple[PayloadBody, ...] = children(
        PayloadBody, default=(), kw_only=True, doc="loads that are attached to it"
    )
    # The plane feels Izz alone. Ixx = Iyy = Izz is a body that exists; diag(0, 0, Izz) is not.
    reference_inertia: Array | None = option(
        default=None, check=_frozen, kw_only=True, doc="inertia about all axes, which grows with yaw_inertia"
    )
    _stance: Stance | None = option(default=None, kw_only=True, doc="how it stands; None: as its box")
    _source: str = option(default="made from numbers", kw_only=True, doc="where its numbers come from")
    locked_joints: tuple[str, ...] = option(default=(), kw_only=True, doc="locked joints of its file")
    undercarriage: Undercarriage = option(default=Undercarriage(), kw_only=True, doc="wheels of its file")
    _looks: VisualFile | None = option(default=None, kw_only=True, doc="the file that says how it looks")

    def check(self) -> None:
        """Raise `InvalidArgument` where no body has its numbers, or its dynamics are lost to rounding."""
        if self._is_symbolic:
            return
        self.body  # noqa: B018 (it checks itself)
        if self.mounts or self.loads:
            check_whole(self._model, self.rest)

    @cached_property
    def _is_symbolic(self) -> bool:
        return any(is_symbolic(leaf.value) for leaf in walk(self))

    @numeric
    def body(self) -> urdf.Body:
        """Mass, centre of mass and inertia of the base's body."""
        if self._is_symbolic:
            raise NotTraceable(
                "the body of a MobileRobot whose numbers are symbols", "take its mass, yaw_inertia and com"
            )
        inertia = self.reference_inertia
        if inertia is None:
            inertia = np.diag([self.yaw_inertia] * 3)
        elif inertia[2, 2] != self.yaw_inertia:
            inertia = inertia * (self.yaw_inertia / inertia[2, 2])
        return urdf.Body(self.mass, np.array(self.com), inertia)

    @property
    def inertia_shares(self) -> tuple[float, float]:
        """The body's inertia xz and yz, as shares of the yaw inertia."""
        inertia = self.reference_inertia
        if inertia is None:
            return 0.0, 0.0
        xz, yz = (inertia[2, :2] / inertia[2, 2]).tolist()
        return xz, yz

    @numeric
    def _engine(self) -> PinocchioBackend | None:
        if self._is_symbolic:
            return None
        return PinocchioBackend(assemble(build_model(self.dh, self.body), self.mounts, self.loads))

    @numeric
    def stance(self) -> Stance:
        """How it stands: `footprint`, `top` and `grounded` are of it."""
        return Stance.of_box(self.size) if self._stance is None else self._stance

    @property
    def source(self) -> str:
        """Where its numbers come from, in words."""
        return self._source + _of_files(self.mounts)

    def __repr__(self) -> str:
        table = "" if self.dh == LECTURE_TABLE else f", dh={self.dh!r}"
        mounted = "".join(map(repr, self.mounts))
        attached = "".join(f".attach({load!r}, frame={load.frame!r})" for load in self.loads)
        return (
            f"MobileRobot(mass={self.mass!r}, yaw_inertia={self.yaw_inertia!r}, com={self.com!r}, "
            f"size={self.size!r}{table}){mounted}{attached}"
        ) + (f" with {LOCKED}" if self.locked_joints else "")

    def _key(self) -> tuple[object, ...]:
        own = self.mass, self.com, self.body.inertia.tobytes(), self.size, self.dh
        return *own, self.stance, self.mounts, self.loads

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, MobileRobot) or self._is_symbolic or other._is_symbolic:
            return self is other
        return self._key() == other._key()

    def __hash__(self) -> int:
        return object.__hash__(self) if self._is_symbolic else hash(self._key())

    @property
    def footprint(self) -> Array | None:
        """Corners of the convex polygon on which it stands, in the body's frame, shape (k, 2) [m].

        Counter-clockwise. Of a robot made from numbers the rectangle of its `size`; of a URDF the hull of
        what touches the ground: its wheels, and casters and skids that are fixed to it. None where that is
        not known: see `source`.
        """
        return self.stance.footprint  # type: ignore[no-any-return]

    @property
    def top(self) -> float | None:
        """Height above the ground of the body's highest point, where `mount` puts an arm [m].

        Of a robot made from numbers that of its `size`; of a URDF that of the collision geometry of what does
        not roll, or of what is drawn where there is none; an antenna counts. None where that is not known:
        see `source`.
        """
        return self.stance.top

    @property
    def is_box(self) -> bool:
        """Whether its body is the box of its `size` that stands on the ground."""
        return self._looks is None and self.stance == Stance.of_box(self.size)

    @property
    def grounded(self) -> bool:
        """Whether the body's origin is known to lie on the ground; if not, `balance` refuses the robot."""
        return self.stance.grounded

    @classmethod
    def lecture(cls) -> MobileRobot:
        """Return the lecture's robot: 30 kg, Icz = 0.1 kg m^2, centre of mass at the origin.

        A homogeneous box of its mass and size would have 1.3 kg m^2: see `MobileRobot.box`.
        """
        return cls(30.0, 0.1)

    @classmethod
    def box(cls, mass: float = 30.0, size: tuple[float, float, float] = (0.6, 0.4, 0.2)) -> MobileRobot:
        """Return a homogeneous box that stands on the ground; by default the lecture's, made physical.

        Parameters
        ----------
        mass : float
            Mass [kg].
        size : sequence of 3 floats
            Length, width and height [m].

        Raises
        ------
        InvalidArgument
            If the mass or a length is not positive or not finite, or the lengths are not three.
        """
        inertia = urdf.box_inertia(mass, size)
        body = urdf.Body(mass, np.array([0, 0, finite("size", size)[2] / 2]), inertia)
        return cls.from_body(body, size, LECTURE_TABLE, "a homogeneous box")

    @classmethod
    def from_urdf(
        cls,
        path: str | PathLike[str],
        package_dirs: str | PathLike[str] | Sequence[str | PathLike[str]] = (),
        *,
        ground: ArrayLike | None = None,
    ) -> MobileRobot:
        """Return the robot of a URDF; `source` says what was taken from it.

        The file either is the chain prismatic y, prismatic x, revolute z with a body on it, whatever its
        joints are called, or a bare base without it: a root link that carries fixed links, wheels
        (joints that are continuous, or revolute without limits or with those of a thousand turns) and joints
        that carry only wheels. A bare base is put on the chain, its wheels locked: it can be pushed sideways.

        B, ``base_link`` among `frame_names`, is the frame of the root link, moved along z to the ground. That
        is where the wheels stand, by the radii of their collision cylinders and spheres; else where a link
        base_footprint is; of the chain z = 0. Where nothing tells, it is taken to be at the origin of the
        root link, `grounded` is False, and what asks for a height is refused until `ground` is given.

        Parameters
        ----------
        path : str or path
            The file.
        package_dirs : str, path, or sequence of them
            Folder or folders that ``package://`` in the file's mesh names refers to.
        ground : float, optional
            The ground's z in the frame of the root link [m], whatever the file says of it.

        Raises
        ------
        InvalidArgument
            If the file cannot be read, is malformed, is neither of the two (the joint that is wrong is
            named), describes a body that cannot exist, its wheels are not within 5 mm of one plane, or
            `ground` is above its centre of mass.

        Warns
        -----
        UserWarning
            If a link has an inertia that no rigid body has, too small to matter.
        """
        folders = tuple(map(Path, existing_folders(package_dirs)))
        return cls(**read_urdf(location("path", path), folders, ground))

    @classmethod
    def from_model(cls, pin_model: pin.Model, *, ground: ArrayLike | None = None) -> MobileRobot:
        """Return the robot of a Pinocchio model, read as `from_urdf` reads a file; it is not kept.

        Parameters
        ----------
        pin_model : pin.Model
            The chain with a body, or a bare base with a free-flyer root, a planar root or none.
        ground : float, optional
            As in `from_urdf`; a model has no shapes, and does not tell its footprint and its top.

        Raises
        ------
        InvalidArgument
            If it is neither, or describes a body that cannot exist.
        """
        instance("pin_model", pin_model, pin.Model, "a pinocchio.Model")
        return cls(**read_model(pin_model, pin_model.name or "the model", ground))

    @classmethod
    def from_body(
        cls,
        body: urdf.Body,
        size: tuple[float, float, float] = (0.6, 0.4, 0.2),
        dh: DHTable = LECTURE_TABLE,
        source: str = "made from a body",
        *,
        stance: Stance | None = None,
        locked_joints: Sequence[str] = (),
    ) -> MobileRobot:
        """Return the robot whose body, with all six moments of inertia, is given.

        Parameters
        ----------
        body : pinmobile.urdf.Body
            Mass, centre of mass and inertia.
        size, dh
            As in the class.
        source : str
            Where the numbers come from, in words.
        stance : Stance, optional
            How it stands; by default as a box of `size`.
        locked_joints : sequence of str
            As in the class.

        Raises
        ------
        InvalidArgument
            If `body` or `stance` is something else, or `size` or `dh` is not what the class expects.
        """
        instance("body", body, urdf.Body, "a pinmobile.urdf.Body")
        instance("stance", stance, Stance | None, "a pinmobile.robot.Stance")
        locked = sequence("locked_joints", locked_joints, "names of joints")
        return cls(  # type: ignore[call-arg]  # attrs names arguments without the underscore
            body.mass,
            body.yaw_inertia,
            body.com,
            size,
            dh,
            reference_inertia=body.inertia,
            stance=stance,
            source=text("source", source),
            locked_joints=tuple(text(f"locked_joints[{k}]", name) for k, name in enumerate(locked)),
        )

    def with_body(self, body: urdf.Body, source: str) -> MobileRobot:
        """Return the bare robot that has another body, and looks and stands the same.

        Parameters
        ----------
        body : pinmobile.urdf.Body
            Mass, centre of mass and inertia.
        source : str
            Where they come from, in words.

        Raises
        ------
        InvalidArgument
            If one of them is something else.
        """
        instance("body", body, urdf.Body, "a pinmobile.urdf.Body")
        source = text("source", source)
        own = {"mass": body.mass, "yaw_inertia": body.yaw_inertia, "com": body.com}
        bare = {"mounts": (), "loads": (), "_source": source, "reference_inertia": body.inertia}
        return evolved(self, own | bare)

    @structure
    def _arm_metrics(self) -> ArmMetrics:
        return ArmMetrics.of(self)

    @property
    def metrics(self) -> tuple[Metric, ...]:
        """What is worth judging about it beside errors, none without arms: what `evaluate_metrics` returns.

        Of each arm how far its end effector is from where the reference puts it, and by what angle; where
        joints have limits, the largest effort of what they allow; and the tip-over margin, where footprint
        and ground are known.
        """
        return self._arm_metrics.metrics if self.mounts else ()

    @by_values()
    def evaluate_metrics(
        self, t: ArrayLike, q: ArrayLike, v: ArrayLike, a: ArrayLike, u: ArrayLike, reference: Any
    ) -> Array:
        """Return its `metrics`, shape (..., m).

        What the reference does not lead it puts where `rest` has it, as `start` does.

        Parameters
        ----------
        t : array_like, shape (...)
            Time [s], on which nothing depends.
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        v, a : array_like, shape (..., nv)
            Velocity and acceleration [m/s, m/s, rad/s, ...; per s].
        u : array_like, shape (..., nv)
            Input [N, N, N m, ...].
        reference : Reference
            Where the first coordinates should be.

        Raises
        ------
        InvalidArgument
            If an argument has another shape or is not finite.
        """
        required("reference", reference, Desired)
        wanted = [("...", n) for n in self.reference_sizes]
        desired = shaped("reference.q", finite("reference.q", reference.q), *wanted)
        state = {"q": self._q(q), "v": self._v("v", v), "a": self._v("a", a), "u": self._v("u", u)}
        lead = broadcast(**state, **{"reference.q": desired})
        if not self.mounts:
            return np.zeros((*lead, 0))
        numbers = state["q"], state["v"], state["a"], state["u"]
        with np.errstate(over="ignore"):
            found: Array = self._arm_metrics.evaluate_metrics(self, *numbers, desired)
        finite_answer(np.where(found == -np.inf, 0.0, found), **state)  # a margin may be minus infinity
        return found

    @structure
    def nv(self) -> int:
        """Size of v and a."""
        return BODY_JOINT + sum(len(mount.joint_names) for mount in self.mounts)

    @structure
    def tree(self) -> Tree:
        """Its structure; raises `NotTraceable` where a joint is neither revolute nor prismatic."""
        return Tree.of(self, in_public_order(build_model(self.dh, self.body)))

    @numeric
    def array_dynamics(self) -> PlanarDynamics | ArticulatedDynamics:
        """Return the same dynamics in NumPy, unchecked, for one state or many, of numbers or symbols.

        Raises
        ------
        NotTraceable
            If a joint of it is neither revolute nor prismatic.
        """
        if self.mounts:
            return self._articulated
        mass, inertia, (x, y) = self.mass, self.yaw_inertia, (self.com[0], self.com[1])
        if self.loads and not self._is_symbolic:
            bare = self.lumped()
            mass, inertia, (x, y) = bare.mass, bare.yaw_inertia, bare.com[:2]
        elif self.loads:
            own = [(each.mass, each.com, each.inertia[2]) for each in self.loads]
            bodies: list[Any] = [(mass, self.com, inertia), *own]
            mass = sum(m for m, _, _ in bodies)
            x, y = (sum(m * com[k] for m, com, _ in bodies) / mass for k in range(2))
            about: Any = sum(own + m * (com[0] * com[0] + com[1] * com[1]) for m, com, own in bodies)
            inertia = about - mass * (x * x + y * y)
        return PlanarDynamics(mass, inertia, x, y)

    @numeric
    def _articulated(self) -> ArticulatedDynamics:
        return ArticulatedDynamics.of(self)

    @numeric
    def _array_ways(self) -> tuple[Any, ...]:
        return self.array_dynamics, self._articulated

    @property
    def law(self) -> Any:
        """What a loop calls for one state, unchecked, in this thread alone: look it up once.

        Of numbers it is by Pinocchio, see `UncheckedDynamics`; of symbols `array_dynamics`.
        """
        if type(self) is not MobileRobot:  # what a subclass overrides is heard
            return self
        return self.array_dynamics if self._engine is None else UncheckedDynamics(self, self._engine)

    def mount(
        self,
        arm: str | PathLike[str] | pin.Model,
        at: ArrayLike | None = None,
        *,
        name: str | None = None,
        package_dirs: str | PathLike[str] | Sequence[str | PathLike[str]] = (),
        visual: pin.GeometryModel | None = None,
        collision: pin.GeometryModel | None = None,
        rest: ArrayLike | None = None,
        locked: Sequence[str] = (),
    ) -> MobileRobot:
        """Return the robot with an arm on its body; q and v then end with the arm's joints.

        A root of its own (free-flyer, planar) is replaced by the chain, and wheels are locked. Its joints and
        frames are called ``name/...``, and each joint has one number in q: a continuous joint is an angle,
        like psi. Its limits, its rotors and its reference posture are kept, and so are its joints' damping
        and friction, by which `JointFriction.of(robot)` acts. Equal position limits, as lower = upper = 0,
        and a velocity or effort limit of 0 are none: that is what files write, some of the loaders' too,
        where they know none. A joint that mimics another in a URDF, as the panda's second finger, moves
        freely, since Pinocchio's forward dynamics knows no mimic joints; a `pin.Model` that has them is
        refused. To keep such a joint still, name it in `locked`.

        Parameters
        ----------
        arm : str, path, pin.Model or pin.RobotWrapper
            One of `mountable()`, such as ``"ur5"``; a URDF; or a model.
        at : array_like, shape (4,), optional
            Where its root stands on the body: x, y, z above the ground and yaw [m, m, m, rad]; by default in
            the middle, at the height `top`, unless that is not known or another arm stands there. What has a
            free-flyer root, or a loader that gives it one, stands on its feet instead, its root as high as
            puts its lowest frame at rest there; so does what would otherwise hang below the ground.
        name : str, optional
            By default that of the arm; numbered where it is taken.
        package_dirs : str, path, or sequence of them
            Folder or folders that ``package://`` in a URDF's mesh names refers to.
        visual : pin.GeometryModel, optional
            What is drawn of a `pin.Model`.
        collision : pin.GeometryModel, optional
            What of a `pin.Model` may touch something: see `clearance`.
        rest : array_like, shape (arm's nq,), optional
            Its reference posture, one number for each joint beside a root of its own, within its limits; by
            default the loader's, or the neutral one, brought within them.
        locked : sequence of str
            Its joints that shall not move, at rest.

        Raises
        ------
        InvalidArgument
            If the arm cannot be read, or is larger than `MobileRobot.from_urdf` takes; a joint of it that is
            not locked has several axes, as a ball joint; a joint moves no inertia, carries what no rigid body
            is, or has limits that limit nothing; without `at`, the middle is taken or the top not known; or
            another argument is not what is expected.
        UnknownName
            If no loader has the name; the nearest come first.
        """
        shapes = {"visual": visual, "collision": collision}
        ready = read_arm(arm, package_dirs=package_dirs, rest=rest, locked=locked, **shapes)
        place = free_place(self.mounts, self.stance.top, ready) if at is None else at
        wanted = checked_name(name if name is not None else Path(ready.origin.value).stem)
        taken = {mount.name for mount in self.mounts}
        mount = Mount.after(self.nv, ready, free_name(wanted, taken), place)
        return evolved(self, {"mounts": (*self.mounts, mount)})

    def attach(self, load: PayloadBody, frame: str | None = None) -> MobileRobot:
        """Return the robot with a load fixed to one of its frames.

        Parameters
        ----------
        load : PayloadBody
            Mass, centre of mass, inertia, size.
        frame : str, optional
            One of `frame_names`; by default `end_effector`.

        Raises
        ------
        InvalidArgument
            If `load` is something else, or so heavy that the dynamics are lost to rounding beside it; or if
            the frame is of a virtual link of the chain, which moves with the robot in part only.
        UnknownName
            If there is no such frame.
        """
        instance("load", load, PayloadBody, "a PayloadBody")
        name, number = self._frame(frame)
        if self._model.frames[number].parentJoint < BODY_JOINT:
            raise InvalidArgument(
                f"frame is {name!r}, a virtual link, expected 'base_link' or a frame of an arm"
            )
        return evolved(self, {"loads": (*self.loads, evolved(load, {"frame": name}))})

    @property
    def base(self) -> MobileRobot:
        """The robot without what it carries."""
        return evolved(self, {"mounts": (), "loads": ()}) if self.mounts or self.loads else self

    def lumped(self, q: ArrayLike | None = None) -> MobileRobot:
        """Return the bare robot that has the mass and inertia of all, arms locked where they are.

        Parameters
        ----------
        q : array_like, shape (nq,) or (nq - 3,), optional
            Configuration, or the arms' part of it; by default `rest`.

        Raises
        ------
        InvalidArgument
            If it has another shape or is not finite.
        """
        posture = finite("q", self.rest if q is None else q)
        if posture.shape == (self.nq - 3,):
            posture = np.concatenate([np.zeros(3), posture])
        shaped("q", posture, (self.nq,), words=f" or ({self.nq - 3},)")
        total = self._numeric.composite(self._here(posture))
        body = urdf.Body(total.mass, total.lever, total.inertia)
        return self.with_body(body, f"{self.source}; arms locked")

    @property
    def visual_model(self) -> pin.GeometryModel:
        """A copy of what is drawn, each object on its joint of `model`: those of the body on the third.

        It is made when it is first asked for. Of a URDF that shows more than a box on the ground, all of
        that, wheels at rest; mesh files that are missing or cannot be read are named in a warning. Else a box
        of `size` on the ground, with a visible front. Then what is drawn of each arm, and the boxes of loads.
        """
        return self._seen[0].clone()

    @property
    def visual_joints(self) -> Mapping[str, tuple[str, ...]]:
        """Of each object of `visual_model` that a URDF shows, the joints of that file that would move it.

        Names, the nearest first; of `locked_joints` are those that are wheels.
        """
        return MappingProxyType(self._seen[1])

    @cached_property
    def _seen(self) -> tuple[pin.GeometryModel, dict[str, tuple[str, ...]]]:
        joint = BODY_JOINT
        if self._looks is None:
            visuals, joints = box_visuals(self.size, joint), dict[str, tuple[str, ...]]()
        else:
            visuals, joints = read_visuals(self._looks, self.size, joint)
        add_carried(visuals, self._model, self.mounts, self.loads)
        return visuals, joints

    @cached_property
    def solids(self) -> Solids:
        """What of it may touch something: the collision shapes of its body, arms and loads; see `clearance`.

        The body of a robot made from numbers is the box of its `size`; of a URDF all that its links have as
        <collision>, wheels at rest. Of meshes it is the convex hull.

        Raises
        ------
        InvalidArgument
            If body or an arm has none, or a file or a mesh cannot be read.
        """
        body = [body_box(self.size)] if self.is_box else body_shapes(self._looks, self.source)
        return Solids.on(self._model, (*body, *carried_shapes(self._model, self.mounts, self.loads)))

    def solid_placements(self, q: ArrayLike) -> Array:
        """Return where the shapes of `solids` are in the body's frame, shape (..., shapes, 4, 4).

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        """
        still = self._q(q).copy()
        still[..., :BODY_JOINT] = 0.0
        parts = self.frame_placements(still)[..., BODY_JOINT - 1 :, :, :]
        shapes = self.solids.shapes
        own = np.stack([each.placement.homogeneous for each in shapes])
        return np.asarray(parts[..., [each.part for each in shapes], :, :] @ own)

    def to_urdf(self) -> str:
        """Return the robot as URDF text, every number to the last digit.

        Loads on the body are part of it; of a robot with arms it is the base alone.
        """
        loaded = self.loads and not self.mounts
        box = self.stance == Stance.of_box(self.size)
        stance = None if box else self.stance.written()
        body = self.lumped().body if loaded else self.body
        return urdf.write(self.dh, body, size=self.size, stance=stance)


def _of_files(mounts: Sequence[Mount]) -> str:
    """Return what was made of the arms' files, in words."""
    told = ((mount.name, mount.arm.squared) for mount in mounts)
    return "".join(
        f"; {name}: right angles that its file rounds are exact ({', '.join(joints)})"
        for name, joints in told
        if joints
    )


def _kept(robot: MobileRobot) -> dict[str, Any]:
    """Return the arguments of `_restored`, as archives keep them: an arm by where it comes from."""
    kind: Any = MobileRobot
    own = {each.alias: getattr(robot, each.name) for each in attrs.fields(kind) if each.init}
    mounts = [{name: value for name, _, value in fields_of(mount)} for mount in robot.mounts]
    return own | {"mounts": [each | {"arm": KeptArm.of(each["arm"])} for each in mounts]}


def _restored(mounts: Sequence[dict[str, Any]], **own: Any) -> MobileRobot:
    """Return a robot again: arms are read, but have the links and motors that they had."""
    return MobileRobot(mounts=tuple(Mount(**each | {"arm": each["arm"].read()}) for each in mounts), **own)


keep(MobileRobot, _kept, _restored)
