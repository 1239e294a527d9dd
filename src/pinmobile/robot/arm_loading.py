"""Read the argument of `MobileRobot.mount` (loader, URDF or model), and list the shipped arms."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import attrs
import numpy as np
import pinocchio as pin

from pinmobile.arrays import (
    Array,
    ArrayLike,
    absent,
    between,
    instance,
    location,
    one_of,
    sequence,
    shaped,
    vector,
)
from pinmobile.errors import InvalidArgument, UnknownName, format_value
from pinmobile.robot.arms import Arm, Origin
from pinmobile.robot.linkage import convert_configuration, joints_of, replace_continuous_joints
from pinmobile.robot.urdf_checks import judge_links, urdf_model
from pinmobile.robot.visuals import VisualFile

_FINGERS = (
    "its fingers have no inertia: lock bravo_finger1_joint and bravo_finger2_joint "
    "(locked=, or --lock of the command)"
)
_NO_VISUALS = "its loader has no visuals: there is nothing to draw of it"


class Exceptional(NamedTuple):
    """Whether an arm mounts by its name alone, and a note on its defect."""

    mounts: bool
    reason: str


EXCEPTIONS = {
    "bluevolta_bravo7_gripper": Exceptional(False, _FINGERS),
    "bravo7_gripper": Exceptional(False, _FINGERS),
    "cassie": Exceptional(False, "its loader reads SDF, which Pinocchio's wheels are built without"),
    "falcon_bravo7_gripper": Exceptional(False, _FINGERS),
    "icub": Exceptional(
        False,
        "its reference posture aligns neck_pitch and neck_roll with no inertia between: try icub_reduced",
    ),
    "romeo": Exceptional(
        False, "24 joints of its hands, RHand and LHand beside fingers and thumbs, have no inertia"
    ),
    "simple_humanoid": Exceptional(True, _NO_VISUALS),
    "simple_humanoid_classical": Exceptional(True, _NO_VISUALS),
}
"""Robots that `MobileRobot.mount` rejects by name alone or that are not drawn, with the reason."""


class Mountable(NamedTuple):
    """A robot that `MobileRobot.mount` accepts by name.

    Attributes
    ----------
    name : str
        Argument of `MobileRobot.mount`.
    joints : int
        Number of joints that the arm adds to the robot, without root joint and wheels.
    mass : float
        Total mass [kg].
    note : str
        Defect of the arm, such as missing visual geometry; empty if there is none.

    See Also
    --------
    robot.mountable : table of all mountable robots
    MobileRobot.mount : put an arm on the body

    Examples
    --------
    >>> from pinmobile.robot import Mountable
    >>> arm = Mountable("ur5", joints=6, mass=20.994)
    >>> arm.mass * 9.81  # weight [N]
    205.95
    """

    name: str
    joints: int
    mass: float
    note: str = ""


class Mountables(dict[str, Mountable]):
    """Table of all mountable robots by name; its text also lists the names that do not mount, with reasons.

    Raises
    ------
    UnknownName
        If the table has no row of the requested name.

    See Also
    --------
    robot.mountable : function that returns this table
    robot.EXCEPTIONS : robots that do not mount by name alone

    Examples
    --------
    >>> from pinmobile.robot import Mountable, Mountables
    >>> table = Mountables(ur5=Mountable("ur5", 6, 20.994))
    >>> print(str(table).splitlines()[0])
    name                     joints  mass [kg]
    >>> table["ur5"].joints
    6
    """

    def __missing__(self, name: str) -> Mountable:
        raise UnknownName("mountable robot", str(name), tuple(self))

    def __str__(self) -> str:
        excluded = {name: reason for name, (mounts, reason) in sorted(EXCEPTIONS.items()) if not mounts}
        width = max(map(len, (*self, *excluded)))
        lines = [f"{'name':{width}} {'joints':>6} {'mass [kg]':>10}"]
        lines += [
            f"{row.name:{width}} {row.joints:6d} {row.mass:10.3f}  {row.note}".rstrip()
            for row in self.values()
        ]
        return "\n".join([*lines, *(f"{name:{width}} not: {reason}" for name, reason in excluded.items())])


@lru_cache(maxsize=1)
def mountable() -> Mountables:
    """Return the robots of example-robot-data that `MobileRobot.mount` accepts by name.

    The first call reads all files without meshes, which takes about two seconds. The result is then cached.

    Returns
    -------
    Mountables
        Table with name, number of joints and mass [kg] of each robot.

    See Also
    --------
    MobileRobot.mount : put such an arm on the body
    robot.EXCEPTIONS : robots that do not mount by name alone

    Examples
    --------
    >>> from pinmobile.robot import mountable
    >>> ur5 = mountable()["ur5"]
    >>> ur5.joints, round(ur5.mass, 3)
    (6, 20.994)
    """
    robots = Mountables()
    for name in sorted(_loaders()):
        mounts, note = EXCEPTIONS.get(name, Exceptional(True, ""))
        if mounts:
            model = _load_arm(name)._model
            robots[name] = Mountable(name, model.nv, sum(each.mass for each in model.inertias), note)
    return robots


def _load_arm(name: str, locked: tuple[str, ...] = ()) -> Arm:
    """Return a robot of example-robot-data.

    Raises
    ------
    UnknownName
        If no robot has this name.
    InvalidArgument
        If the loader fails, or the robot cannot be mounted.
    """
    loader = _loaders()[one_of("arm", name, _loaders())]
    geometry: dict[str, Any]
    try:
        if "__init__" in vars(loader) or not loader.urdf_filename:  # the loader does more than read a URDF
            robot = loader().robot
            model, rest = robot.model, robot.q0
            geometry = {"visual": robot.visual_model, "collision": robot.collision_model}
        else:
            model, rest, geometry = _read(loader)
    except Exception as error:
        exception = EXCEPTIONS.get(name)
        reason = exception.reason if exception else str(error) or type(error).__name__
        raise InvalidArgument(f"arm {name!r} cannot be loaded: {reason}") from error
    stands, rest = bool(loader.free_flyer), convert_configuration(model, rest)
    return Arm(Origin("loader", name), model, rest, locked, stands, **geometry)


def _loaders() -> dict[str, Any]:
    from example_robot_data import ROBOTS

    return dict(ROBOTS)


def _read(loader: Any) -> tuple[pin.Model, Array, dict[str, Any]]:
    """Return the loader's model without meshes, which would take a hundred times as long to read."""
    from example_robot_data import getModelPath, readParamsFromSrdf

    folder = Path(loader.path)
    urdf = folder / loader.urdf_subpath / loader.urdf_filename
    home = Path(getModelPath(str(urdf)))
    model = pin.buildModelFromUrdf(str(home / urdf))
    rest = pin.neutral(model)
    if loader.srdf_filename:
        srdf = home / folder / loader.srdf_subpath / loader.srdf_filename
        rest = readParamsFromSrdf(model, str(srdf), False, loader.has_rotor_parameters, loader.ref_posture)
    return model, rest, {"file": VisualFile(home / urdf, (home.parents[1],))}


_SLACK = 1e-9  # [m, rad]: tolerance for rounding of a posture at a limit


def read_arm(
    arm: str | PathLike[str] | pin.Model,
    *,
    package_dirs: str | PathLike[str] | Sequence[str | PathLike[str]] = (),
    visual: pin.GeometryModel | None = None,
    collision: pin.GeometryModel | None = None,
    rest: ArrayLike | None = None,
    locked: Sequence[str] = (),
) -> Arm:
    """Return the arm to be mounted, read and checked.

    Parameters
    ----------
    arm, package_dirs, visual, collision, rest, locked
        As in `MobileRobot.mount`.

    Raises
    ------
    InvalidArgument
        If the arm cannot be read or mounted, or has another type.
    UnknownName
        If no loader has the name.
    """
    lock = (locked,) if isinstance(locked, str) else sequence("locked", locked, "a sequence of joints' names")
    for argument, shapes in (("visual", visual), ("collision", collision)):
        instance(argument, shapes, pin.GeometryModel | None, "a pinocchio.GeometryModel")
    folders = existing_folders(package_dirs)
    if isinstance(arm, Arm):
        return arm
    # A name has neither a slash nor a file ending. Text with either is a path, even if the file is missing.
    is_text = isinstance(arm, str | PathLike)
    is_file = is_text and (not isinstance(arm, str) or "/" in arm or arm.lower().endswith((".urdf", ".xml")))
    kind = "a URDF" if is_file else "a loader's name" if is_text else "a model"
    beside = {"visual": visual, "collision": collision} if is_text else {}
    label = str(arm if is_text else getattr(arm, "name", arm))
    absent(f"with {kind}, {label!r}: it applies to a pinocchio.Model", **beside)
    absent(
        f"with {kind}, {label!r}: it applies to a URDF",
        package_dirs=None if is_file or not folders else package_dirs,
    )
    if is_file:
        result = _from_urdf(location("arm", arm).resolve(), folders, rest, lock)
    elif is_text:
        result = _load_arm(str(arm), lock)
        result = result if rest is None else attrs.evolve(result, rest=_posture(result.whole, rest))
    else:
        result = _from_model(arm, visual, collision, rest, lock)
    if rest is not None:
        _check_rest(result)
    return result


class KeptArm(NamedTuple):
    """Arm of a name or file as an archive stores it; to restore the arm, `read` reads the file again.

    Attributes
    ----------
    origin, locked, rest
        As in `Arm`.
    numbers : ndarray
        Masses, inertias, damping, friction and rotor inertias of the joints. The file must still contain
        them.
    """

    origin: Origin
    locked: tuple[str, ...]
    rest: Array
    numbers: Array

    @classmethod
    def of(cls, arm: Arm) -> KeptArm:
        """Return the stored form of an arm.

        Raises
        ------
        InvalidArgument
            If the arm was made from a `pin.Model`.
        """
        if arm.origin.kind == "model":
            raise InvalidArgument("it had an arm made from a pin.Model, which an archive cannot store")
        model = arm._model
        inertias = [inertia.toDynamicParameters() for inertia in model.inertias]
        numbers = np.concatenate([*inertias, model.damping, model.friction, model.armature])
        return cls(arm.origin, arm.locked, arm.rest, numbers)

    def read(self) -> Arm:
        """Return the arm again, with its stored reference configuration.

        Raises
        ------
        InvalidArgument, UnknownName
            If the file is missing, or no longer contains the stored numbers.
        """
        origin, locked, rest, numbers = self
        arm = read_arm(origin.value, package_dirs=origin.package_dirs, locked=locked)
        arm = attrs.evolve(arm, rest=_posture(arm.whole, rest))
        if not np.array_equal(KeptArm.of(arm).numbers, numbers):
            raise InvalidArgument(
                "its masses, inertias, or joints' damping, friction and rotors differ from the stored ones: "
                f"see {origin.value}"
            )
        return arm


def existing_folders(package_dirs: str | PathLike[str] | Sequence[str | PathLike[str]]) -> tuple[str, ...]:
    """Return the resolved folders of ``package_dirs``, which may be a single folder.

    Raises
    ------
    InvalidArgument
        If an entry has another type or is not a folder.
    """
    given = (package_dirs,) if isinstance(package_dirs, str | PathLike) else package_dirs
    folders = sequence("package_dirs", given, "a sequence of folders")
    paths = [location("package_dirs", folder) for folder in folders]
    for path in paths:
        if not path.is_dir():
            raise InvalidArgument(f"package_dirs has {format_value(str(path))}, expected a folder")
    return tuple(str(path.resolve()) for path in paths)


def _from_model(
    arm: pin.Model,
    visual: pin.GeometryModel | None,
    collision: pin.GeometryModel | None,
    rest: ArrayLike | None,
    locked: tuple[str, ...],
) -> Arm:
    q0 = None
    if isinstance(arm, pin.RobotWrapper):
        visual = arm.visual_model if visual is None else visual
        collision = arm.collision_model if collision is None else collision
        q0, arm = arm.q0, arm.model
    instance("arm", arm, pin.Model, "a name, the path of a URDF, or a pinocchio.Model")
    if arm.njoints == 1:
        raise InvalidArgument(
            f"arm {arm.name!r} has no joints, expected at least one: use robot.attach(PayloadBody(...))"
        )
    visual, collision = (each and each.clone() for each in (visual, collision))
    full = replace_continuous_joints(arm)
    usual = _posture(full, None if q0 is None else convert_configuration(arm, vector("q0", q0, arm.nq)))
    posture = usual if rest is None else _posture(full, rest)
    origin = Origin("model", arm.name or "arm")
    return Arm(origin, arm, posture, locked, usual=usual, visual=visual, collision=collision)


def _posture(model: pin.Model, rest: ArrayLike | None) -> Array:
    posture = pin.neutral(model) if rest is None else vector("rest", rest, model.nq)
    return shaped("rest", posture, (model.nq,))


def _check_rest(arm: Arm) -> None:
    """Raise `InvalidArgument` for a reference configuration outside the limits."""
    model = arm.whole
    for joint in joints_of(model):
        for k in range(joint.q.start, joint.q.stop) if joint.nq == 1 else ():
            lower, upper = model.lowerPositionLimit[k], model.upperPositionLimit[k]
            # Equal limits count as no limit.
            if lower < upper:
                value, bounds = arm.rest[[k]], (np.array([lower - _SLACK]), np.array([upper + _SLACK]))
                between("rest has joint", [repr(joint.name)], value, *bounds)


def _from_urdf(path: Path, folders: tuple[str, ...], rest: ArrayLike | None, locked: tuple[str, ...]) -> Arm:
    model, root = urdf_model("arm", path)
    file, origin = VisualFile(path, tuple(map(Path, folders))), Origin("urdf", str(path), folders)
    full = replace_continuous_joints(model)
    arm = Arm(origin, model, _posture(full, rest), locked, usual=pin.neutral(full), file=file)

    def body_of(link: str) -> Array:
        joint = model.frames[model.getFrameId(link, pin.FrameType.BODY)].parentJoint
        return np.asarray(model.inertias[joint].inertia)

    judge_links(root, path.name, body_of, stacklevel=5)
    rubbing = model.damping + model.friction
    rubs = [name for j, name in enumerate(model.names) if rubbing[model.idx_vs[j] :][: model.nvs[j]].any()]
    if rubs:
        warnings.warn(
            f"{path.name}: damping and friction of {', '.join(rubs)} act only in a loop with "
            "forces=[JointFriction.of(robot)]",
            stacklevel=5,
        )
    return arm
