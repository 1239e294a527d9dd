"""`MobileRobot`, the noun: parameters that check themselves, and the dynamics that follow from them."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import NamedTuple, final

import numpy as np
import pinocchio as pin

from pinmobile import urdf
from pinmobile.arrays import Array, ArrayLike, broadcast, finite, location, positive, vector, wrap_angle
from pinmobile.dh import LECTURE_TABLE, DHTable
from pinmobile.errors import InvalidArgument
from pinmobile.robot.engine import Engine, build_model
from pinmobile.robot.reading import read_model, read_urdf
from pinmobile.robot.visual import VisualFile, box_visuals, read_visuals

__all__ = ["Linearization", "MobileRobot"]


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


@final
@dataclass(frozen=True, eq=False, repr=False)
class MobileRobot:
    """A rigid body on the chain prismatic y, prismatic x, revolute z, with Pinocchio's dynamics.

    All methods take and return, along the last axis and in the inertial frame: configuration
    q = (x, y, psi) [m, m, rad], velocity v = dq/dt [m/s, m/s, rad/s], acceleration a [m/s^2, m/s^2, rad/s^2]
    and generalised force tau = (Fx, Fy, Mz) [N, N, N m]. Leading axes broadcast; Pinocchio takes one
    configuration at a time, so they are looped over. All raise `InvalidArgument` for arguments of another
    last axis or that are not finite.

    Parameters
    ----------
    mass : float
        Mass [kg].
    yaw_inertia : float
        Inertia about the vertical through the centre of mass, Icz [kg m^2].
    com : sequence of 2 or 3 floats
        Centre of mass in the body frame (xbc, ybc) or (xbc, ybc, zbc) [m].
    size : sequence of 3 floats
        Length, width and height of the box that is drawn [m].
    dh : DHTable
        The chain; the joint frames of `model` are its frames.

    Raises
    ------
    InvalidArgument
        If a mass, inertia or size is not positive, a shape is wrong, a value is not finite, or `dh` is not
        a chain of prismatic y, prismatic x, revolute z.
    """

    mass: float
    yaw_inertia: float
    com: tuple[float, ...] = (0.0, 0.0, 0.0)
    size: tuple[float, float, float] = (0.6, 0.4, 0.2)
    dh: DHTable = LECTURE_TABLE
    source: str = field(default="made from numbers", init=False)
    body: urdf.Body = field(init=False)
    _engine: Engine = field(init=False)
    _looks: VisualFile | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        com = finite("com", self.com)
        if com.shape not in ((2,), (3,)):
            raise InvalidArgument(f"com has shape {com.shape}, expected (2,) or (3,)")
        mass, inertia = positive("mass", self.mass, "kg"), positive("yaw_inertia", self.yaw_inertia, "kg m^2")
        # The plane feels Izz alone. Ixx = Iyy = Izz is a body that exists; diag(0, 0, Izz) is not.
        self._take(urdf.Body(mass, np.append(com, 0.0)[:3], np.diag([inertia] * 3)))

    def _take(self, body: urdf.Body) -> None:
        size = finite("size", self.size)
        if size.shape != (3,) or not (size > 0).all():
            raise InvalidArgument(f"size is {self.size}, expected three lengths > 0 m")
        _check_chain(self.dh)
        for name, value in {
            "mass": body.mass,
            "yaw_inertia": body.yaw_inertia,
            "com": tuple(body.com.tolist()),
            "size": tuple(size.tolist()),
            "body": body,
            "_engine": Engine(build_model(self.dh, body, "pinmobile")),
        }.items():
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        table = "" if self.dh == LECTURE_TABLE else f", dh={self.dh!r}"
        return (
            f"MobileRobot(mass={self.mass!r}, yaw_inertia={self.yaw_inertia!r}, com={self.com!r}, "
            f"size={self.size!r}{table})"
        )

    def _key(self) -> tuple[object, ...]:
        return self.mass, self.com, self.body.inertia.tobytes(), self.size, self.dh

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MobileRobot) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())

    def __reduce__(self) -> tuple[object, ...]:
        # A pin.Data is not worth keeping: it is made again from the parameters.
        return _restored, (self.body, self.size, self.dh, self.source, self._looks)

    @classmethod
    def lecture(cls) -> "MobileRobot":
        """Return the lecture's robot: 30 kg, Icz = 0.1 kg m^2, centre of mass at the origin.

        A homogeneous box of its mass and size would have 1.3 kg m^2: see `MobileRobot.box`.
        """
        return cls(30.0, 0.1)

    @classmethod
    def box(cls, mass: float = 30.0, size: tuple[float, float, float] = (0.6, 0.4, 0.2)) -> "MobileRobot":
        """Return a homogeneous box that stands on the ground; by default the lecture's, made physical.

        Parameters
        ----------
        mass : float
            Mass [kg].
        size : sequence of 3 floats
            Length, width and height [m].
        """
        height = vector("size", size, 3)[2]
        body = urdf.Body(mass, np.array([0, 0, height / 2]), urdf.box_inertia(mass, size))
        return cls.from_body(body, size, LECTURE_TABLE, "a homogeneous box")

    @classmethod
    def from_urdf(
        cls, path: str | PathLike[str], package_dirs: Sequence[str | PathLike[str]] = ()
    ) -> "MobileRobot":
        """Return the robot of a URDF; `source` says what was taken from it.

        The file either is the chain prismatic y, prismatic x, revolute z with a body on it, whatever its
        joints are called, or a bare base without it: a root link that carries fixed links, wheels
        (continuous joints) and joints that carry only wheels. A bare base is put on the chain, its wheels
        locked; B is the frame of its root link.

        Parameters
        ----------
        path : str or path
            The file.
        package_dirs : sequence of str or path
            Folders that ``package://`` in the file's mesh names refers to.

        Raises
        ------
        InvalidArgument
            If the file cannot be read, is malformed, is neither of the two (the joint that is wrong is
            named), or describes a body that cannot exist.
        """
        for folder in package_dirs:
            if not Path(folder).is_dir():
                raise InvalidArgument(f"package_dirs has {str(folder)!r}, expected a folder")
        file = location("path", path)
        reading = read_urdf(file)
        looks = VisualFile(file.resolve(), tuple(Path(d).resolve() for d in package_dirs), reading.base)
        return _restored(reading.body, reading.size, reading.table, reading.source, looks)

    @classmethod
    def from_model(cls, pin_model: pin.Model) -> "MobileRobot":
        """Return the robot of a Pinocchio model, read as `from_urdf` reads a file; it is not kept.

        Parameters
        ----------
        pin_model : pin.Model
            The chain with a body, or a bare base with a free-flyer root, a planar root or none.

        Raises
        ------
        InvalidArgument
            If it is neither, or describes a body that cannot exist.
        """
        if not isinstance(pin_model, pin.Model):
            raise InvalidArgument(f"pin_model is a {type(pin_model).__name__}, expected a pinocchio.Model")
        reading = read_model(pin_model, pin_model.name or "the model")
        return cls.from_body(reading.body, reading.size, reading.table, reading.source)

    @classmethod
    def from_body(
        cls,
        body: urdf.Body,
        size: tuple[float, float, float] = (0.6, 0.4, 0.2),
        dh: DHTable = LECTURE_TABLE,
        source: str = "made from a body",
    ) -> "MobileRobot":
        """Return the robot whose body, with all six moments of inertia, is given.

        Parameters
        ----------
        body : pinmobile.urdf.Body
            Mass, centre of mass and inertia.
        size, dh
            As in the class.
        source : str
            Where the numbers come from, in words.
        """
        if not isinstance(body, urdf.Body):
            raise InvalidArgument(f"body is {body!r}, expected a pinmobile.urdf.Body")
        robot = object.__new__(cls)
        for name, value in {"size": size, "dh": dh, "source": source}.items():
            object.__setattr__(robot, name, value)
        robot._take(body)
        return robot

    @cached_property
    def visual_model(self) -> pin.GeometryModel:
        """What is drawn: objects in the body's frame, which ride on the last joint of `model`.

        It is made when it is asked for. Of a URDF that shows more than a box, all that it shows, wheels at
        rest; mesh files that are missing are named in a warning. Else a box of `size` on the ground, with a
        visible front.
        """
        joint = self.model.njoints - 1
        if self._looks is None:
            return box_visuals(self.size, joint)
        return read_visuals(self._looks, self.size, joint)

    @property
    def model(self) -> pin.Model:
        """The Pinocchio model, in the chain's order (y, x, psi)."""
        return self._engine.model

    @property
    def nq(self) -> int:
        """Size of q."""
        return int(self.model.nq)

    @property
    def nv(self) -> int:
        """Size of v and a."""
        return int(self.model.nv)

    @property
    def nu(self) -> int:
        """Size of the input, here the generalised force."""
        return self.nv

    @property
    def inertial_parameters(self) -> Array:
        """What `regressor` multiplies, shape (10,): m, m c, and Ixx, Ixy, Iyy, Ixz, Iyz, Izz about B [SI]."""
        return np.array(self.model.inertias[self.model.njoints - 1].toDynamicParameters())

    def to_urdf(self) -> str:
        """Return the robot as URDF text, every number to the last digit."""
        return urdf.write(self.dh, self.body, size=self.size)

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Return M(q), shape (..., nv, nv) [kg, kg m, kg m^2], by Pinocchio's CRBA."""
        return self._square(self._engine.each(pin.crba, self._q(q)))

    def nonlinear_effects(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return n(q, v), shape (..., nv) [N, N, N m], by Pinocchio's RNEA without acceleration."""
        return self._engine.reorder(self._engine.each(pin.nonLinearEffects, self._q(q), self._v("v", v)))

    def inverse_dynamics(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """Return tau = M(q) a + n(q, v), shape (..., nv) [N, N, N m], by Pinocchio's RNEA."""
        arguments = self._q(q), self._v("v", v), self._v("a", a)
        return self._engine.reorder(self._engine.each(pin.rnea, *arguments))

    def forward_dynamics(self, q: ArrayLike, v: ArrayLike, tau: ArrayLike) -> Array:
        """Return a = M(q)^-1 (tau - n(q, v)), shape (..., nv) [m/s^2, m/s^2, rad/s^2], by Pinocchio's ABA."""
        arguments = self._q(q), self._v("v", v), self._v("tau", tau)
        return self._engine.reorder(self._engine.each(pin.aba, *arguments))

    def coriolis_matrix(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return C(q, v), shape (..., nv, nv): C v = n(q, v), and dM/dt - 2 C is skew-symmetric."""
        return self._square(self._engine.each(pin.computeCoriolisMatrix, self._q(q), self._v("v", v)))

    def kinetic_energy(self, q: ArrayLike, v: ArrayLike) -> Array:
        """Return v' M(q) v / 2, shape (...) [J]."""
        return self._engine.each(pin.computeKineticEnergy, self._q(q), self._v("v", v))

    def frame_placements(self, q: ArrayLike) -> Array:
        """Return T_0_k, the pose of each joint's frame, shape (..., 3, 4, 4); the last one is the body's."""

        def placements(model: pin.Model, data: pin.Data, q: Array) -> Array:
            pin.forwardKinematics(model, data, q)
            return np.stack([data.oMi[k].homogeneous for k in range(1, model.njoints)])

        return self._engine.each(placements, self._q(q))

    def jacobian(self, q: ArrayLike) -> Array:
        """Return J(psi), shape (..., nv, nv): v = J twist, with the body twist (forward, left, yaw rate)."""
        psi = self._q(q)[..., 2]
        J = np.zeros((*psi.shape, self.nv, self.nv))
        J[...] = np.eye(self.nv)
        J[..., 0, 0] = J[..., 1, 1] = np.cos(psi)
        J[..., 1, 0] = np.sin(psi)
        J[..., 0, 1] = -J[..., 1, 0]
        return J

    def regressor(self, q: ArrayLike, v: ArrayLike, a: ArrayLike) -> Array:
        """Return Y(q, v, a), shape (..., nv, 10): tau = Y `inertial_parameters`."""
        arguments = self._q(q), self._v("v", v), self._v("a", a)
        Y = self._engine.each(pin.computeJointTorqueRegressor, *arguments)
        return Y[..., self._engine.order, -10:]

    def forward_dynamics_derivatives(
        self, q: ArrayLike, v: ArrayLike, tau: ArrayLike
    ) -> tuple[Array, Array, Array]:
        """Return da/dq, da/dv, da/dtau = M^-1, each (..., nv, nv), by Pinocchio's ABA derivatives."""

        def derivatives(model: pin.Model, data: pin.Data, q: Array, v: Array, tau: Array) -> Array:
            return np.stack(pin.computeABADerivatives(model, data, q, v, tau))

        stacked = self._engine.each(derivatives, self._q(q), self._v("v", v), self._v("tau", tau))
        stacked = self._square(stacked)
        return stacked[..., 0, :, :], stacked[..., 1, :, :], stacked[..., 2, :, :]

    def linearize(self, q: ArrayLike, v: ArrayLike, tau: ArrayLike) -> Linearization:
        """Return the first-order model of forward dynamics about (q, v, tau)."""
        by_q, by_v, by_tau = self.forward_dynamics_derivatives(q, v, tau)
        A = np.zeros((*by_q.shape[:-2], 2 * self.nv, 2 * self.nv))
        B = np.zeros((*by_q.shape[:-2], 2 * self.nv, self.nv))
        A[..., : self.nv, self.nv :] = np.eye(self.nv)
        A[..., self.nv :, : self.nv], A[..., self.nv :, self.nv :] = by_q, by_v
        B[..., self.nv :, :] = by_tau
        return Linearization(A, B)

    def integrate(self, q: ArrayLike, dq: ArrayLike) -> Array:
        """Return the configuration that the displacement `dq` leads to from `q`, shape (..., nq)."""
        q, dq = self._q(q), self._v("dq", dq)
        broadcast(q=q, dq=dq)
        return q + dq

    def difference(self, q0: ArrayLike, q1: ArrayLike) -> Array:
        """Return the displacement from `q0` to `q1`, shape (..., nv); that of psi lies in (-pi, pi]."""
        q0, q1 = vector("q0", q0, self.nq), vector("q1", q1, self.nq)
        broadcast(q0=q0, q1=q1)
        displacement = q1 - q0
        displacement[..., 2] = wrap_angle(displacement[..., 2])
        return displacement

    def _q(self, q: ArrayLike) -> Array:
        return vector("q", q, self.nq)

    def _v(self, name: str, value: ArrayLike) -> Array:
        return vector(name, value, self.nv)

    def _square(self, matrices: Array) -> Array:
        order = self._engine.order
        return matrices[..., order[:, None], order]


def _restored(
    body: urdf.Body, size: tuple[float, float, float], dh: DHTable, source: str, looks: VisualFile | None
) -> MobileRobot:
    robot = MobileRobot.from_body(body, size, dh, source)
    object.__setattr__(robot, "_looks", looks)
    return robot


def _check_chain(table: DHTable) -> None:
    """Refuse a table whose last frame is not the planar pose (x, y, psi) for joint variables (y, x, psi)."""
    if not isinstance(table, DHTable):
        raise InvalidArgument(f"dh is a {type(table).__name__}, expected a DHTable")
    kinds = [row.joint for row in table]
    planar = kinds == [row.joint for row in LECTURE_TABLE]
    probes = np.array([[0, 0, 0], [0.7, -0.3, 1.1], [-1.0, 2.0, -2.5]])
    if planar:
        pose, expected = (dh.placements(probes)[:, -1] for dh in (table, LECTURE_TABLE))
        planar = bool(np.abs(pose - expected).max() < 1e-12)
    if not planar:
        raise InvalidArgument(
            f"dh with variables {table.variables} does not put its last frame at (x, y, psi), expected "
            "a chain of prismatic y, prismatic x, revolute psi whose last frame is the body's"
        )
