"""`MobileRobot`: the parameters of a robot, and the dynamics that follow from them."""

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
    word,
)
from pinmobile.dh import LECTURE_TABLE, DHTable, table_of
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
    holds_symbols,
    number,
    numeric,
    option,
    part,
    require,
    structure,
)
from pinmobile.robot.arm_loading import KeptArm, existing_folders, read_arm
from pinmobile.robot.arms import check_whole, com_field, matrix_of_six
from pinmobile.robot.articulated import ArticulatedDynamics, PlanarDynamics, Tree
from pinmobile.robot.description import describe
from pinmobile.robot.linkage import BODY_JOINT
from pinmobile.robot.model_import import (
    LOCKED,
    build_model,
    check_chain,
    fields_of_body,
    read_model,
    read_urdf,
    rods_of,
    rows_of,
)
from pinmobile.robot.mounts import Mount, PayloadBody, assemble, free_name, free_place
from pinmobile.robot.recursions import PinocchioBackend, UncheckedDynamics, in_public_order
from pinmobile.robot.support_geometry import ArmMetrics, SupportGeometry, Undercarriage
from pinmobile.robot.system import MultibodySystem, by_values
from pinmobile.robot.visuals import Solids, VisualFile, visuals_of


@attrs.frozen
class _Size(Number):
    """Declaration of the lengths of the sides of the drawn box."""

    def convert(self, name: str, value: Any) -> tuple[float, ...]:
        """Return the lengths as a tuple of floats."""
        return tuple(lengths(value).tolist())


def _check_stance(name: str, value: Any) -> SupportGeometry | None:
    """Return a contact geometry after a check of its type."""
    checked: SupportGeometry | None
    checked = instance("stance", value, SupportGeometry | None, "a pinmobile.robot.SupportGeometry")
    return checked


def _frozen(name: str, inertia: Array | None) -> Array | None:
    return None if inertia is None else frozen(inertia)


@final
@part
class MobileRobot(MultibodySystem):
    """A planar mobile robot: a rigid body on a chain of joints, with arms and loads, computed by Pinocchio.

    The chain is prismatic y, prismatic x, revolute z. `robot.MultibodySystem` states the conventions of q, v,
    a and tau, and the errors of the inherited methods. If the robot carries arms (see `mount`), the
    parameters below describe the body of the base without arms.

    Parameters
    ----------
    mass : float
        Mass of the body [kg].
    yaw_inertia : float
        Moment of inertia Icz about the vertical axis through the centre of mass [kg m^2].
    com : sequence of 2 or 3 floats
        Centre of mass in the body frame, (xbc, ybc) or (xbc, ybc, zbc) [m].
    size : sequence of 3 floats
        Length, width and height of the drawn box [m]. If the robot is made from numbers, the box also gives
        `footprint` and `top`.
    dh : dh.DHTable
        DH table of the chain. The joint frames of `model` are the frames of this table.

    Attributes
    ----------
    mounts : tuple of robot.Mount
        Mounted arms.
    loads : tuple of PayloadBody
        Attached loads.
    reference_inertia : ndarray, shape (3, 3), or None
        Inertia of the body about the centre of mass, up to a factor [kg m^2]: the inertia is this matrix,
        scaled so that its last entry equals `yaw_inertia`. None means equal moments of inertia about all
        axes.
    locked_joints : tuple of str
        Names of joints of the URDF or model that are locked at rest: wheels, and joints that carry only
        wheels.
    undercarriage : Undercarriage
        Wheels and other ground contacts of the URDF or model, for a `WheeledRobot`. It is empty if the robot
        was not read from a URDF or a model.

    Raises
    ------
    InvalidArgument
        If a mass, an inertia or a length is not positive, a shape is wrong, a value is not finite, or `dh` is
        not a chain of prismatic y, prismatic x, revolute z.

    See Also
    --------
    WheeledRobot : the same robot on wheels, driven by motors
    simulate : run a controller on the robot
    verify : check that independent derivations of the dynamics agree

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> robot = MobileRobot(mass=20.0, yaw_inertia=0.5, com=(0.1, 0.0))
    >>> robot.mass_matrix([0, 0, 0]).diagonal()  # [kg, kg, kg m^2]
    array([20. , 20. ,  0.7])
    >>> q, v = [0, 0, 0], [0, 0, 2]  # turn at 2 rad/s on the spot
    >>> robot.nonlinear_effects(q, v)  # [N, N, N m]
    array([-8.,  0.,  0.])
    """

    mass: float = number(unit="kg", above=0, doc="mass of the robot")
    yaw_inertia: float = number(
        unit="kg m^2", above=0, doc="inertia of the robot about the vertical through its centre of mass"
    )
    com: Any = com_field((0.0, 0.0, 0.0), shapes=((2,), (3,)), doc="centre of mass of the robot")
    size: Any = declare(
        _Size("sides of the box that is drawn", "m", 0.0, shapes=((3,),), fixed=True), (0.6, 0.4, 0.2)
    )
    dh: DHTable = option(default=LECTURE_TABLE, check=check_chain, doc="chain that carries the body")
    mounts: tuple[Mount, ...] = children(Mount, default=(), kw_only=True, doc="mounted arms")
    loads: tuple[PayloadBody, ...] = children(PayloadBody, default=(), kw_only=True, doc="attached loads")
    # Planar motion depends only on Izz. A rigid body can have Ixx = Iyy = Izz, but not diag(0, 0, Izz).
    reference_inertia: Array | None = option(
        default=None, check=_frozen, kw_only=True, doc="inertia about all axes, scaled to yaw_inertia"
    )
    _stance: SupportGeometry | None = option(
        default=None, check=_check_stance, kw_only=True, doc="contact geometry; None: the box"
    )
    _source: str = option(default="made from numbers", kw_only=True, doc="origin of the numbers")
    locked_joints: tuple[str, ...] = option(default=(), kw_only=True, doc="locked joints of the file")
    undercarriage: Undercarriage = option(default=Undercarriage(), kw_only=True, doc="wheels of the file")
    _looks: VisualFile | None = option(default=None, kw_only=True, doc="file with the visual geometry")

    def check(self) -> None:
        """Raise `InvalidArgument` if no rigid body has these numbers, or rounding makes M(q) singular."""
        if self._is_symbolic:
            return
        self.body  # noqa: B018 (making the body checks its numbers)
        if self.mounts or self.loads:
            check_whole(self._model, self.rest)

    @cached_property
    def _is_symbolic(self) -> bool:
        return holds_symbols(self)

    @numeric
    def body(self) -> urdf.Body:
        """Mass, centre of mass and inertia of the body of the base."""
        if self._is_symbolic:
            raise NotTraceable(
                "the body of a MobileRobot with symbols as parameters", "use its mass, yaw_inertia and com"
            )
        inertia = self.reference_inertia
        if inertia is None:
            inertia = np.diag([self.yaw_inertia] * 3)
        elif inertia[2, 2] != self.yaw_inertia:
            inertia = inertia * (self.yaw_inertia / inertia[2, 2])
        return urdf.Body(self.mass, np.array(self.com), inertia)

    @property
    def inertia_shares(self) -> tuple[float, float]:
        """Products of inertia xz and yz of the body, divided by the yaw inertia."""
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
    def stance(self) -> SupportGeometry:
        """Contact geometry of the base: the source of `footprint`, `top` and `grounded`."""
        return SupportGeometry.of_box(self.size) if self._stance is None else self._stance

    @property
    def source(self) -> str:
        """Origin of the robot's numbers, as text: the file, and assumptions made in reading it."""
        pairs = ((mount.name, ", ".join(mount.arm.squared)) for mount in self.mounts)
        words = "right angles that its file rounds are exact"
        return self._source + "".join(f"; {name}: {words} ({joints})" for name, joints in pairs if joints)

    def __repr__(self) -> str:
        table = "" if self.dh == LECTURE_TABLE else f", dh={self.dh!r}"
        mounts = "".join(map(repr, self.mounts))
        loads = "".join(f".attach({load!r}, frame={load.frame!r})" for load in self.loads)
        return (
            f"MobileRobot(mass={self.mass!r}, yaw_inertia={self.yaw_inertia!r}, com={self.com!r}, "
            f"size={self.size!r}{table}){mounts}{loads}"
        ) + (f" with {LOCKED}" if self.locked_joints else "")

    def describe(self) -> str:
        """Return the numbers of the robot as text: body, loads, arms with limits, sources, and if it stands.

        ``print(robot)`` prints the same.

        Returns
        -------
        str
            Lines of text.

        Examples
        --------
        >>> from pinmobile import MobileRobot
        >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3, com=(0.4, 0, 0))
        >>> print(robot.describe().splitlines()[-1])
        cannot stand: its centre of mass lies 0.1 m outside its supports
        """
        return describe(self)

    __str__ = describe

    def _key(self) -> tuple[object, ...]:
        numbers = self.mass, self.com, self.body.inertia.tobytes(), self.size, self.dh
        return *numbers, self.stance, self.mounts, self.loads

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, MobileRobot) or self._is_symbolic or other._is_symbolic:
            return self is other
        return self._key() == other._key()

    def __hash__(self) -> int:
        return object.__hash__(self) if self._is_symbolic else hash(self._key())

    @property
    def footprint(self) -> Array | None:
        """Corners of the support polygon in the body frame, counter-clockwise, shape (k, 2) [m].

        The polygon is convex. For a robot made from numbers, it is the rectangle of `size`. For a URDF, it is
        the convex hull of the ground contacts: wheels, and casters and skids fixed to the base. It is None if
        the contacts are not known; `source` then gives the reason.
        """
        return self.stance.footprint  # type: ignore[no-any-return]

    @property
    def top(self) -> float | None:
        """Height of the body's highest point above the ground [m], where `mount` puts an arm by default.

        For a robot made from numbers, this is the height in `size`. For a URDF, it is the top of the
        collision geometry without wheels, or of the visual geometry if the file has no collision geometry. An
        antenna counts. It is None if the height is not known; `source` then gives the reason.
        """
        return self.stance.top

    @property
    def is_box(self) -> bool:
        """Whether the body is a box of dimensions `size` that stands on the ground."""
        return self._looks is None and self.stance == SupportGeometry.of_box(self.size)

    @property
    def grounded(self) -> bool:
        """Whether the height of the body frame is known. If not, `balance` rejects the robot."""
        return self.stance.grounded

    @classmethod
    def lecture(cls) -> MobileRobot:
        """Return the lecture's robot: 30 kg, Icz = 0.1 kg m^2, centre of mass at the origin.

        A homogeneous box of this mass and size would have Icz = 1.3 kg m^2: see `MobileRobot.box`.
        """
        return cls(30.0, 0.1)

    @classmethod
    def box(cls, mass: float = 30.0, size: tuple[float, float, float] = (0.6, 0.4, 0.2)) -> MobileRobot:
        """Return a homogeneous box that stands on the ground; by default, with the lecture's mass and size.

        Parameters
        ----------
        mass : float
            Mass [kg].
        size : sequence of 3 floats
            Length, width and height [m].

        Returns
        -------
        MobileRobot
            Robot with the inertia of the box and the centre of mass at half the height.

        Raises
        ------
        InvalidArgument
            If the mass or a length is not positive or not finite, or `size` does not have three entries.
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
        """Return the robot that a URDF describes; its `source` says which numbers come from the file.

        The file contains one of two models. The first is the chain prismatic y, prismatic x, revolute z with
        a body on it; its joints may have any names. The second is a base without this chain: a root link with
        fixed links, wheels and joints that carry only wheels. A wheel is a continuous joint, or a revolute
        joint without limits or with limits of at least a thousand turns. `MobileRobot` puts a base without a
        chain on the chain and locks its wheels, so a force can push it sideways.

        The body frame B (``base_link`` in `frame_names`) is the frame of the root link, moved along z to the
        ground. The height of the ground follows from the radii of the wheels' collision cylinders and
        spheres, otherwise from a link base_footprint. For a file with the chain, the ground is at z = 0. If
        the file has no such information, the ground is assumed at the origin of the root link and `grounded`
        is False. Functions that need a height then reject the robot until `ground` is given.

        Parameters
        ----------
        path : str or path
            Path of the URDF.
        package_dirs : str, path, or sequence of them
            Folder or folders to which ``package://`` in the file's mesh names refers.
        ground : float, optional
            Height z of the ground in the frame of the root link [m]. It overrides the file.

        Returns
        -------
        MobileRobot
            Robot on the chain, with locked wheels.

        Raises
        ------
        InvalidArgument
            If the file cannot be read, is malformed, or is neither of the two models (the message names the
            wrong joint); if no rigid body has a link's inertia; if the wheels' lowest points differ by more
            than 5 mm from one plane; or if `ground` is above the centre of mass.

        Warns
        -----
        UserWarning
            If no rigid body has a link's inertia, but the inertia is too small to affect the dynamics.
        """
        folders = tuple(map(Path, existing_folders(package_dirs)))
        return cls(**read_urdf(location("path", path), folders, ground))

    @classmethod
    def from_model(cls, pin_model: pin.Model, *, ground: ArrayLike | None = None) -> MobileRobot:
        """Return the robot that a Pinocchio model describes, by the same rules as `from_urdf`.

        Parameters
        ----------
        pin_model : pin.Model
            Chain with a body; or a base without this chain, with a free-flyer root, a planar root or no root
            joint. The robot keeps no reference to this object.
        ground : float, optional
            Height z of the ground in the frame of the root link [m], as in `from_urdf`. A model has no
            geometry, so `footprint` and `top` stay unknown.

        Returns
        -------
        MobileRobot
            Robot on the chain, with locked wheels.

        Raises
        ------
        InvalidArgument
            If the model is neither a chain nor a base, or no rigid body has its inertia.
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
        stance: SupportGeometry | None = None,
    ) -> MobileRobot:
        """Return the robot with a given body, including all six moments and products of inertia.

        Parameters
        ----------
        body : urdf.Body
            Mass, centre of mass and inertia.
        size : sequence of 3 floats
            Length, width and height of the drawn box [m].
        dh : dh.DHTable
            DH table of the chain.
        source : str
            Origin of the numbers, as text.
        stance : robot.SupportGeometry, optional
            Contact geometry; by default, the box of dimensions `size`.

        Returns
        -------
        MobileRobot
            Robot without arms and loads.

        Raises
        ------
        InvalidArgument
            If `body` or `stance` has another type, or `size` or `dh` is not what the class expects.
        """
        instance("body", body, urdf.Body, "a pinmobile.urdf.Body")
        return cls(  # type: ignore[call-arg]  # attrs names arguments without the underscore
            **fields_of_body(body), size=size, dh=dh, stance=stance, source=text("source", source)
        )

    @classmethod
    def from_dh(
        cls,
        table: DHTable | Sequence[Any],
        bodies: Sequence[urdf.Body | Mapping[str, Any]],
        *,
        size: tuple[float, float, float] = (0.6, 0.4, 0.2),
        name: str = "arm",
    ) -> MobileRobot:
        """Return the robot of a DH table: a planar base of three joints, then the joints of an arm on it.

        Parameters
        ----------
        table : dh.DHTable or sequence of rows
            Chain of n rows, n >= 3. The first three are a table such as `dh.LECTURE_TABLE`.
        bodies : sequence of urdf.Body or mapping, length n - 2
            Body on the third row and on each row after it: ``mass`` [kg], ``com`` [m] and ``inertia`` about
            it [kg m^2], in the frame of the row.
        size : sequence of 3 floats
            Length, width and height of the drawn box of the base [m].
        name : str
            Name of the arm. Its coordinates are ``arm/...``, with the variables of the table.

        Returns
        -------
        MobileRobot
            Robot, whose `chain` is the table.

        Raises
        ------
        InvalidArgument
            If the table does not begin with a planar base, or the bodies do not fit it.

        Examples
        --------
        >>> from pinmobile import MobileRobot
        >>> from pinmobile.dh import LECTURE_TABLE
        >>> elbow = {"alpha": 0, "a": 0.4, "theta": 0, "d": 0,
        ...          "joint": "revolute", "variable": "elbow"}
        >>> body = {"mass": 30.0, "com": (0, 0, 0), "inertia": [[1, 0, 0], [0, 1, 0], [0, 0, 1.3]]}
        >>> link = {"mass": 4.0, "com": (0.25, 0, 0), "inertia": [[0.06, 0, 0], [0, 0.06, 0], [0, 0, 0.06]]}
        >>> robot = MobileRobot.from_dh([*LECTURE_TABLE, elbow], [body, link])
        >>> [one.name for one in robot.coordinates], len(robot.chain)
        (['x', 'y', 'psi', 'arm/elbow'], 4)
        """
        chain = table_of(table)
        given = sequence("bodies", bodies, "a Body for the third row and each row after it")
        if len(given) != len(chain) - BODY_JOINT + 1 or len(chain) < BODY_JOINT:
            raise InvalidArgument(
                f"table has {len(chain)} rows and bodies {len(given)}, expected n >= 3 rows and n - 2 bodies"
            )
        for k, body in enumerate(given):
            instance(f"bodies[{k}]", body, (Mapping, urdf.Body), "a Body")
            if isinstance(body, Mapping) and body.keys() != {"mass", "com", "inertia"}:
                raise InvalidArgument(f"bodies[{k}] has {list(body)}, expected mass, com and inertia")
        check_chain("table", DHTable(chain.rows[:BODY_JOINT]))
        first, *others = (urdf.Body(**body) if isinstance(body, Mapping) else body for body in given)
        base = cls.from_body(first, size, DHTable(chain.rows[:BODY_JOINT]), "made from a DH table")
        if not others:
            return base
        rows = DHTable(chain.rows[BODY_JOINT:])
        arm = build_model(rows, *others, ends=[f"{variable}_link" for variable in rows.variables])
        visuals = rods_of(arm, [body.com for body in others])
        return base.mount(arm, (0.0, 0.0, 0.0, 0.0), name=text("name", name), visual=visuals)

    @property
    def chain(self) -> DHTable | None:
        """DH table of base and arm; None if the arm's joints do not continue that of the base."""
        if len(self.mounts) > 1 or any(any(mount.at) for mount in self.mounts):
            return None
        rows = [rows_of(mount.arm.model) for mount in self.mounts]
        return None if None in rows else DHTable((*self.dh, *(row for each in rows for row in each or ())))

    def with_body(self, body: urdf.Body, source: str) -> MobileRobot:
        """Return the robot without arms and loads, with another body but the same looks and contacts.

        Parameters
        ----------
        body : urdf.Body
            Mass, centre of mass and inertia.
        source : str
            Origin of these numbers, as text.

        Returns
        -------
        MobileRobot
            Robot without arms and loads.

        Raises
        ------
        InvalidArgument
            If `body` is not a `urdf.Body`, or `source` is not a text.
        """
        instance("body", body, urdf.Body, "a pinmobile.urdf.Body")
        source = text("source", source)
        return evolved(self, {**fields_of_body(body), "mounts": (), "loads": (), "_source": source})

    @structure
    def _arm_metrics(self) -> ArmMetrics:
        return ArmMetrics.of(self)

    @property
    def metrics(self) -> tuple[Metric, ...]:
        """Metrics that `evaluate_metrics` computes; empty for a robot without arms.

        For each arm, these are the distance and the angle between the end effector and its reference pose,
        and the largest ratio of a joint's force or torque to its effort limit, if joints have limits. The
        tip-over margin follows if footprint and ground are known.
        """
        return self._arm_metrics.metrics if self.mounts else ()

    @by_values()
    def evaluate_metrics(
        self, t: ArrayLike, q: ArrayLike, v: ArrayLike, a: ArrayLike, u: ArrayLike, reference: Any
    ) -> Array:
        """Return the values of `metrics`, shape (..., m).

        Coordinates without a reference have their reference at `rest`, as in `start`.

        Parameters
        ----------
        t : array_like, shape (...)
            Time [s]. The metrics do not depend on time.
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].
        v, a : array_like, shape (..., nv)
            Velocity and acceleration [m/s, m/s, rad/s, ...; per s].
        u : array_like, shape (..., nv)
            Input [N, N, N m, ...].
        reference : Reference
            Reference of the first coordinates.

        Returns
        -------
        ndarray, shape (..., m)
            One value for each of the m metrics, in the unit of the metric.

        Raises
        ------
        InvalidArgument
            If an argument has another shape or is not finite.
        """
        require("reference", reference, Desired)
        shapes = [("...", n) for n in self.reference_sizes]
        desired = shaped("reference.q", finite("reference.q", reference.q), *shapes)
        state = {"q": self._q(q), "v": self._v("v", v), "a": self._v("a", a), "u": self._v("u", u)}
        lead = broadcast(**state, **{"reference.q": desired})
        if not self.mounts:
            return np.zeros((*lead, 0))
        with np.errstate(over="ignore"):
            values: Array = self._arm_metrics.evaluate_metrics(self, **state, desired=desired)
        finite_answer(np.where(values == -np.inf, 0.0, values), **state)  # a margin may equal minus infinity
        return values

    @structure
    def nv(self) -> int:
        """Number of entries of v and a."""
        return BODY_JOINT + sum(len(mount.joint_names) for mount in self.mounts)

    @structure
    def tree(self) -> Tree:
        """Kinematic tree: joints, parents and axes.

        Raises
        ------
        NotTraceable
            If a joint is neither revolute nor prismatic.
        """
        return Tree.of(self, in_public_order(build_model(self.dh, self.body)))

    @numeric
    def array_dynamics(self) -> PlanarDynamics | ArticulatedDynamics:
        """Dynamics in NumPy, without checks, for one state or many, with numbers or symbols.

        Raises
        ------
        NotTraceable
            If a joint is neither revolute nor prismatic.
        """
        if self.mounts:
            return self._dynamics_of
        mass, inertia, (x, y) = self.mass, self.yaw_inertia, (self.com[0], self.com[1])
        if self.loads and not self._is_symbolic:
            bare = self.with_locked_arms()
            mass, inertia, (x, y) = bare.mass, bare.yaw_inertia, bare.com[:2]
        elif self.loads:
            loads = [(each.mass, each.com, each.moments[2]) for each in self.loads]
            bodies: list[Any] = [(mass, self.com, inertia), *loads]
            mass = sum(m for m, _, _ in bodies)
            x, y = (sum(m * com[k] for m, com, _ in bodies) / mass for k in range(2))
            total: Any = sum(loads + m * (com[0] * com[0] + com[1] * com[1]) for m, com, loads in bodies)
            inertia = total - mass * (x * x + y * y)
        return PlanarDynamics(mass, inertia, x, y)

    @numeric
    def _dynamics_of(self) -> ArticulatedDynamics:
        return ArticulatedDynamics.of(self)

    @numeric
    def _array_ways(self) -> tuple[Any, ...]:
        return self.array_dynamics, self._dynamics_of

    @property
    def dynamics(self) -> Any:
        """Unchecked dynamics of one state that a loop calls, for the current thread only.

        Read this property once before a loop. For a robot with numeric parameters, it is a
        `robot.UncheckedDynamics` on Pinocchio; for a robot with symbols, it is `array_dynamics`.
        """
        if type(self) is not MobileRobot:  # use the methods that a subclass overrides
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
        """Return the robot with an arm on its body; the entries of q and v for the arm's joints come last.

        The chain replaces a free-flyer or planar root joint of the arm, and wheels are locked. The names of
        joints and frames become ``name/...``. Each joint has one number in q: a continuous joint is an angle,
        like psi. The robot keeps limits, rotor inertias and reference configuration of the arm. It also keeps
        the joints' damping and friction, which act in a loop with `JointFriction`. Equal lower and upper
        position limits, and a velocity or effort limit of 0, count as no limit: many files write them for
        unknown limits.

        Pinocchio's forward dynamics does not support mimic joints. A URDF's mimic joint (such as the second
        finger of the panda) therefore moves freely; name it in `locked` to fix it. A `pin.Model` with mimic
        joints is rejected.

        Parameters
        ----------
        arm : str, path, pin.Model or pin.RobotWrapper
            Name of a shipped arm, such as ``"ur5"`` (`robot.mountable` lists them); path of a URDF; or model.
        at : array_like, shape (4,), optional
            Placement of the arm's root on the body: x, y, height z above the ground, and yaw [m, m, m, rad].
            By default, x = y = 0 at height `top`; this requires a known `top` and no other arm there. A robot
            with a free-flyer root, or a loader that adds one, stands on its feet: by default, its lowest
            frame in the reference configuration has the height `top`. An arm that would reach below the
            ground is raised in the same way.
        name : str, optional
            Name of the mounted arm; by default, the name of the loader, file or model. A number is appended
            to a name that exists already.
        package_dirs : str, path, or sequence of them
            Folder or folders to which ``package://`` in a URDF's mesh names refers.
        visual : pin.GeometryModel, optional
            Visual geometry for a `pin.Model`.
        collision : pin.GeometryModel, optional
            Collision geometry for a `pin.Model`, used by `clearance`.
        rest : array_like, shape (arm's nq,), optional
            Reference configuration of the arm within its limits, without root joint [rad or m]. By default,
            the loader's, or else the neutral one, clipped to the limits.
        locked : sequence of str
            Names of the arm's joints to lock in the reference configuration.

        Returns
        -------
        MobileRobot
            Robot with the arm as the last entry of `mounts`.

        Raises
        ------
        InvalidArgument
            If the arm cannot be read or is too large; if an unlocked joint has several axes (such as a ball
            joint), moves no inertia, has invalid limits or carries an inertia that no rigid body has; if `at`
            is missing and the default placement is occupied or its height unknown; or if another argument is
            invalid.
        UnknownName
            If no loader has the given name. The message lists the nearest names first.

        Examples
        --------
        >>> from pinmobile import MobileRobot
        >>> robot = MobileRobot.box(mass=60.0).mount("ur5")
        >>> robot.nq, robot.end_effector
        (9, 'ur5/tool0')
        >>> robot.frame_pose(robot.rest)[:3, 3].round(3)  # tool [m]
        array([0.817, 0.191, 0.195])
        """
        shapes = {"visual": visual, "collision": collision}
        ready = read_arm(arm, package_dirs=package_dirs, rest=rest, locked=locked, **shapes)
        place = free_place(self.mounts, self.stance.top, ready) if at is None else at
        prefix = word("name", Path(ready.origin.value).stem if name is None else name, '/,"')
        names = {mount.name for mount in self.mounts}
        mount = Mount.create(self.nv, ready, free_name(prefix, names), place)
        return evolved(self, {"mounts": (*self.mounts, mount)})

    def attach(self, load: PayloadBody, frame: str | None = None) -> MobileRobot:
        """Return the robot with a load fixed to one of its frames.

        Parameters
        ----------
        load : PayloadBody
            Mass, centre of mass, inertia and size of the load.
        frame : str, optional
            Name of the frame, one of `frame_names`; by default, `end_effector`.

        Returns
        -------
        MobileRobot
            Robot with the load as the last entry of `loads`.

        Raises
        ------
        InvalidArgument
            If `load` has another type; if the load is so heavy that rounding makes M(q) singular; or if the
            frame belongs to a link of the chain before the body.
        UnknownName
            If the robot has no such frame.
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
        """Robot without arms and loads."""
        return evolved(self, {"mounts": (), "loads": ()}) if self.mounts or self.loads else self

    def with_locked_arms(self, q: ArrayLike | None = None) -> MobileRobot:
        """Return the robot without arms whose body has the composite inertia, with arms locked at q.

        Parameters
        ----------
        q : array_like, shape (nq,) or (nq - 3,), optional
            Configuration, or its part for the arms [rad or m]; by default, `rest`.

        Returns
        -------
        MobileRobot
            Robot without arms and loads, with the total mass.

        Raises
        ------
        InvalidArgument
            If q has another shape or is not finite.
        """
        posture = finite("q", self.rest if q is None else q)
        if posture.shape == (self.nq - 3,):
            posture = np.concatenate([np.zeros(3), posture])
        shaped("q", posture, (self.nq,), words=f" or ({self.nq - 3},)")
        total = self._numeric.composite(self._at_origin(posture))
        body = urdf.Body(total.mass, total.lever, total.inertia)
        return self.with_body(body, f"{self.source}; arms locked")

    @property
    def visual_model(self) -> pin.GeometryModel:
        """Copy of the visual geometry; each object refers to a joint of `model` (the body: the third joint).

        The robot makes this geometry at the first access. A robot from a URDF with more than a box on the
        ground shows the file's geometry, with wheels at rest; a warning names mesh files that are missing or
        unreadable. Any other robot shows a box of dimensions `size` with a marked front. The geometry of the
        arms and the boxes of the loads follow.
        """
        return self._visuals_read[0].clone()

    @property
    def visual_joints(self) -> Mapping[str, tuple[str, ...]]:
        """Names of the URDF's joints that move each object of `visual_model`, nearest joint first.

        Only joints of the file count; from `locked_joints`, only the wheels.
        """
        return MappingProxyType(self._visuals_read[1])

    @cached_property
    def _visuals_read(self) -> tuple[pin.GeometryModel, dict[str, tuple[str, ...]]]:
        return visuals_of(self, self._looks)

    @cached_property
    def solids(self) -> Solids:
        """Collision geometry of body, arms and loads, which `clearance` uses.

        The body of a robot made from numbers is the box of dimensions `size`. The body of a robot from a URDF
        has all <collision> shapes of the links, with wheels at rest. Convex hulls replace meshes.

        Raises
        ------
        InvalidArgument
            If the body or an arm has no collision geometry, or a file or mesh cannot be read.
        """
        return Solids.of(self, self._looks)

    def solid_placements(self, q: ArrayLike) -> Array:
        """Return the placements of the shapes of `solids` in the body frame.

        Parameters
        ----------
        q : array_like, shape (..., nq)
            Configuration [m, m, rad, ...].

        Returns
        -------
        ndarray, shape (..., shapes, 4, 4)
            Homogeneous transforms, translation in m.
        """
        q_body = self._q(q).copy()
        q_body[..., :BODY_JOINT] = 0.0
        parts = self.frame_placements(q_body)[..., BODY_JOINT - 1 :, :, :]
        shapes = self.solids.shapes
        local = np.stack([each.placement.homogeneous for each in shapes])
        return np.asarray(parts[..., [each.part for each in shapes], :, :] @ local)

    def to_urdf(self) -> str:
        """Return the robot as URDF text with all digits of every number.

        The text contains the loads of a robot without arms, and the arm of `from_dh`. For other robots with
        arms, it describes only the base.
        """
        has_loads = self.loads and not self.mounts
        box = self.stance == SupportGeometry.of_box(self.size)
        stance = None if box else self.stance.written()
        body, table = self.with_locked_arms().body if has_loads else self.body, self.chain or self.dh
        arms = [link for mount in self.mounts for link in mount.links[1:]] if len(table) > BODY_JOINT else ()
        links = [urdf.Body(link.mass, link.com, matrix_of_six(link.inertia)) for link in arms]
        return urdf.write(table, body, size=self.size, stance=stance, links=links)


def _archive_fields(robot: MobileRobot) -> dict[str, Any]:
    """Return the arguments of `_restored` as archives store them; the source represents each arm."""
    kind: Any = MobileRobot
    fields = {each.alias: getattr(robot, each.name) for each in attrs.fields(kind) if each.init}
    mounts = [{name: value for name, _, value in fields_of(mount)} for mount in robot.mounts]
    return fields | {"mounts": [each | {"arm": KeptArm.of(each["arm"])} for each in mounts]}


def _restore(mounts: Sequence[dict[str, Any]], **fields: Any) -> MobileRobot:
    """Return the robot of an archive: read the arms again and restore their links and rotor inertias."""
    return MobileRobot(mounts=tuple(Mount(**each | {"arm": each["arm"].read()}) for each in mounts), **fields)


keep(MobileRobot, _archive_fields, _restore)
