"""What `MobileRobot.mount` is given: a loader's name, a URDF, or a `pin.Model`; and which can be mounted."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import attrs
import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, ArrayLike, instance, location, one_of, sequence, shaped, vector
from pinmobile.errors import InvalidArgument, UnknownName, shown
from pinmobile.robot.arms import Arm, Origin
from pinmobile.robot.linkage import convert_configuration, joints_of, replace_continuous_joints
from pinmobile.robot.urdf_checks import judge_links, urdf_model
from pinmobile.robot.visuals import VisualFile

_FINGERS = (
    "its fingers have no inertia: lock bravo_finger1_joint and bravo_finger2_joint "
    "(locked=, or --lock of the command)"
)
_UNSEEN = "its loader has no visuals: there is nothing to draw of it"


class Exceptional(NamedTuple):
    """Whether a name mounts as it is, and what is exceptional about it."""

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
    "simple_humanoid": Exceptional(True, _UNSEEN),
    "simple_humanoid_classical": Exceptional(True, _UNSEEN),
}
"""Names that `MobileRobot.mount` refuses as they are, or that are not drawn, and why."""


class Mountable(NamedTuple):
    """A robot that can be mounted by its name.

    Attributes
    ----------
    name : str
        What `MobileRobot.mount` takes.
    joints : int
        Degrees of freedom that it brings, without a root and wheels.
    mass : float
        Of the whole of it [kg].
    note : str
        What it lacks, where it lacks something, such as visuals.
    """

    name: str
    joints: int
    mass: float
    note: str = ""


class Mountables(dict[str, Mountable]):
    """All robots that can be mounted, by name; printed, it is a table with the names that do not mount.

    Raises
    ------
    UnknownName
        If a row is asked for that is not there.
    """

    def __missing__(self, name: str) -> Mountable:
        raise UnknownName("mountable robot", str(name), tuple(self))

    def __str__(self) -> str:
        refused = {name: reason for name, (mounts, reason) in sorted(EXCEPTIONS.items()) if not mounts}
        width = max(map(len, (*self, *refused)))
        lines = [f"{'name':{width}} {'joints':>6} {'mass [kg]':>10}"]
        lines += [
            f"{row.name:{width}} {row.joints:6d} {row.mass:10.3f}  {row.note}".rstrip()
            for row in self.values()
        ]
        return "\n".join([*lines, *(f"{name:{width}} not: {reason}" for name, reason in refused.items())])


@lru_cache(maxsize=1)
def mountable() -> Mountables:
    """Return the robots of example-robot-data that `MobileRobot.mount` knows by name.

    It reads each of them once, without its meshes, which takes two seconds; after that it is remembered.
    """
    found = Mountables()
    for name in sorted(_loaders()):
        mounts, note = EXCEPTIONS.get(name, Exceptional(True, ""))
        if mounts:
            model = _load_arm(name)._model
            found[name] = Mountable(name, model.nv, sum(each.mass for each in model.inertias), note)
    return found


def _load_arm(name: str, locked: tuple[str, ...] = ()) -> Arm:
    """Return a robot of example-robot-data.

    Raises
    ------
    UnknownName
        If there is none of that name.
    InvalidArgument
        If its loader fails, or it cannot be mounted.
    """
    loader = _loaders()[one_of("arm", name, _loaders())]
    geometry: dict[str, Any]
    try:
        if "__init__" in vars(loader) or not loader.urdf_filename:  # it does more than read a URDF
            robot = loader().robot
            model, rest = robot.model, robot.q0
            geometry = {"visual": robot.visual_model, "collision": robot.collision_model}
        else:
            model, rest, geometry = _read(loader)
    except Exception as error:
        known = EXCEPTIONS.get(name)
        reason = known.reason if known else str(error) or type(error).__name__
        raise InvalidArgument(f"arm {name!r} cannot be loaded: {reason}") from error
    stands, rest = bool(loader.free_flyer), convert_configuration(model, rest)
    return Arm(Origin("loader", name), model, rest, locked, stands, **geometry)


def _loaders() -> dict[str, Any]:
    from example_robot_data import ROBOTS

    return dict(ROBOTS)


def _read(loader: Any) -> tuple[pin.Model, Array, dict[str, Any]]:
    """Return what the loader would read, without the meshes, which take a hundred times as long."""
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


_SLACK = 1e-9  # [m, rad]: a posture at a limit is there but for rounding


def read_arm(
    arm: str | PathLike[str] | pin.Model,
    *,
    package_dirs: str | PathLike[str] | Sequence[str | PathLike[str]] = (),
    visual: pin.GeometryModel | None = None,
    collision: pin.GeometryModel | None = None,
    rest: ArrayLike | None = None,
    locked: Sequence[str] = (),
) -> Arm:
    """Return what is to be mounted, read and checked.

    Parameters
    ----------
    arm, package_dirs, visual, collision, rest, locked
        As in `MobileRobot.mount`.

    Raises
    ------
    InvalidArgument
        If it cannot be read or mounted, or is something else.
    UnknownName
        If no loader has the name.
    """
    held = (locked,) if isinstance(locked, str) else sequence("locked", locked, "a sequence of joints' names")
    for argument, shapes in (("visual", visual), ("collision", collision)):
        instance(argument, shapes, pin.GeometryModel | None, "a pinocchio.GeometryModel")
    folders = existing_folders(package_dirs)
    if isinstance(arm, Arm):
        return arm
    # A name has neither slash nor ending; what looks like a path is one, there or not.
    is_text = isinstance(arm, str | PathLike)
    is_file = is_text and (not isinstance(arm, str) or "/" in arm or arm.lower().endswith((".urdf", ".xml")))
    kind = "a URDF" if is_file else "a loader's name" if is_text else "a model"
    beside = {"visual": visual, "collision": collision} if is_text else {}
    for argument, given in (beside | ({} if is_file else {"package_dirs": folders or None})).items():
        if given is not None:
            takes = "a URDF" if argument == "package_dirs" else "a pinocchio.Model"
            called = str(arm if is_text else getattr(arm, "name", arm))
            raise InvalidArgument(
                f"{argument} does not apply to {kind}, {called!r}, expected it beside {takes} alone"
            )
    if is_file:
        made = _from_urdf(location("arm", arm).resolve(), folders, rest, held)
    elif is_text:
        made = _load_arm(str(arm), held)
        made = made if rest is None else attrs.evolve(made, rest=_posture(made.whole, rest))
    else:
        made = _from_model(arm, visual, collision, rest, held)
    if rest is not None:
        _check_rest(made)
    return made


class KeptArm(NamedTuple):
    """An arm of a name or a file, as archives keep it: it is read again, and must have the same numbers.

    Attributes
    ----------
    origin, locked, rest
        As of `Arm`.
    numbers : ndarray
        Masses, inertias, damping, friction and rotors of its joints, in a row.
    """

    origin: Origin
    locked: tuple[str, ...]
    rest: Array
    numbers: Array

    @classmethod
    def of(cls, arm: Arm) -> KeptArm:
        """Return what is kept of an arm.

        Raises
        ------
        InvalidArgument
            If it is made of a `pin.Model`.
        """
        if arm.origin.kind == "model":
            raise InvalidArgument("it had an arm of a pin.Model, which an archive cannot keep")
        model = arm._model
        own = [inertia.toDynamicParameters() for inertia in model.inertias]
        numbers = np.concatenate([*own, model.damping, model.friction, model.armature])
        return cls(arm.origin, arm.locked, arm.rest, numbers)

    def read(self) -> Arm:
        """Return the arm again, with the reference posture that it had, clipped or not.

        Raises
        ------
        InvalidArgument, UnknownName
            If it is no longer there, or no longer has these numbers.
        """
        origin, locked, rest, numbers = self
        made = read_arm(origin.value, package_dirs=origin.package_dirs, locked=locked)
        made = attrs.evolve(made, rest=_posture(made.whole, rest))
        if not np.array_equal(KeptArm.of(made).numbers, numbers):
            raise InvalidArgument(
                "its masses, inertias, or joints' damping, friction and rotors are no longer those that were "
                f"kept: see {origin.value}"
            )
        return made


def existing_folders(package_dirs: str | PathLike[str] | Sequence[str | PathLike[str]]) -> tuple[str, ...]:
    """Return the folders of ``package_dirs``, resolved; one of them may come alone.

    Raises
    ------
    InvalidArgument
        If it is something else, or one of them is no folder.
    """
    given = (package_dirs,) if isinstance(package_dirs, str | PathLike) else package_dirs
    paths = tuple(
        location("package_dirs", one) for one in sequence("package_dirs", given, "a sequence of folders")
    )
    for path in paths:
        if not path.is_dir():
            raise InvalidArgument(f"package_dirs has {shown(str(path))}, expected a folder")
    return tuple(str(path.resolve()) for path in paths)


def _from_model(
    arm: pin.Model,
    visual: pin.GeometryModel | None,
    collision: pin.GeometryModel | None,
    rest: ArrayLike | None,
    locked: tuple[str, ...],
) -> Arm:
    kept = None
    if isinstance(arm, pin.RobotWrapper):
        visual = arm.visual_model if visual is None else visual
        collision = arm.collision_model if collision is None else collision
        kept, arm = arm.q0, arm.model
    instance("arm", arm, pin.Model, "a name, the path of a URDF, or a pinocchio.Model")
    if arm.njoints == 1:
        raise InvalidArgument(
            f"arm {arm.name!r} has no joints, expected one at least: a PayloadBody has none"
        )
    visual, collision = (each and each.clone() for each in (visual, collision))
    whole = replace_continuous_joints(arm)
    usual = _posture(whole, None if kept is None else convert_configuration(arm, vector("q0", kept, arm.nq)))
    posture = usual if rest is None else _posture(whole, rest)
    origin = Origin("model", arm.name or "arm")
    return Arm(origin, arm, posture, locked, usual=usual, visual=visual, collision=collision)


def _posture(model: pin.Model, rest: ArrayLike | None) -> Array:
    posture = pin.neutral(model) if rest is None else vector("rest", rest, model.nq)
    return shaped("rest", posture, (model.nq,))


def _check_rest(arm: Arm) -> None:
    """Refuse a reference posture outside the limits."""
    model = arm.whole
    for joint in joints_of(model):
        for k in range(joint.q.start, joint.q.stop) if joint.nq == 1 else ():
            least, most = model.lowerPositionLimit[k], model.upperPositionLimit[k]
            # Equal limits are none.
            if least < most and not least - _SLACK <= arm.rest[k] <= most + _SLACK:
                raise InvalidArgument(
                    f"rest has joint {joint.name!r} at {arm.rest[k]:.9g}, expected {least:.9g} to {most:.9g}"
                )


def _from_urdf(path: Path, folders: tuple[str, ...], rest: ArrayLike | None, locked: tuple[str, ...]) -> Arm:
    model, root = urdf_model("arm", path)
    file, origin = VisualFile(path, tuple(map(Path, folders))), Origin("urdf", str(path), folders)
    whole = replace_continuous_joints(model)
    arm = Arm(origin, model, _posture(whole, rest), locked, usual=pin.neutral(whole), file=file)

    def body_of(link: str) -> Array:
        joint = model.frames[model.getFrameId(link, pin.FrameType.BODY)].parentJoint
        return np.asarray(model.inertias[joint].inertia)

    judge_links(root, path.name, body_of, stacklevel=5)
    return arm
