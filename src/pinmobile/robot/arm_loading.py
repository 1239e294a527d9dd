"""What `MobileRobot.mount` is given: a loader's name, a URDF, or a `pin.Model`; and which can be mounted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, ArrayLike, instance, location, sequence, shaped, vector
from pinmobile.errors import InvalidArgument, PinmobileError, UnknownName, shown
from pinmobile.robot.arms import Arm, Origin, Picture
from pinmobile.robot.linkage import convert_configuration, joints_of, replace_continuous_joints
from pinmobile.robot.urdf_checks import judge_links, urdf_model
from pinmobile.robot.visuals import FilePicture, FileShapes, GivenPicture

_FINGERS = (
    "its fingers have no inertia: lock bravo_finger1_joint and bravo_finger2_joint "
    "(locked=, or --lock of the command)"
)
_UNSEEN = "its loader has no visuals: there is nothing to draw of it"


class _Exceptional(NamedTuple):
    """What is exceptional about a name: whether it mounts as it is, and the reason."""

    mounts: bool
    reason: str


EXCEPTIONS: dict[str, _Exceptional] = {
    "bluevolta_bravo7_gripper": _Exceptional(False, _FINGERS),
    "bravo7_gripper": _Exceptional(False, _FINGERS),
    "cassie": _Exceptional(False, "its loader reads SDF, which Pinocchio's wheels are built without"),
    "falcon_bravo7_gripper": _Exceptional(False, _FINGERS),
    "icub": _Exceptional(
        False,
        "its reference posture aligns neck_pitch and neck_roll with no inertia between: try icub_reduced",
    ),
    "romeo": _Exceptional(
        False, "24 joints of its hands, RHand and LHand beside fingers and thumbs, have no inertia"
    ),
    "simple_humanoid": _Exceptional(True, _UNSEEN),
    "simple_humanoid_classical": _Exceptional(True, _UNSEEN),
}
"""Names that `MobileRobot.mount` refuses as they are, or that are not drawn, and why."""


@dataclass(frozen=True)
class Mountable:
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


@dataclass(frozen=True)
class Mountables:
    """All robots that can be mounted by name; printed, it is a table, and ``[name]`` is a row of it.

    Attributes
    ----------
    rows : tuple of Mountable
        In the order of their names.
    exceptions : tuple of (str, str)
        Names that the loaders know and that do not mount, with the reason.

    Raises
    ------
    UnknownName
        If a row is asked for that is not there.
    """

    rows: tuple[Mountable, ...]
    exceptions: tuple[tuple[str, str], ...]

    def __iter__(self) -> Iterator[Mountable]:
        return iter(self.rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __contains__(self, name: object) -> bool:
        return name in self.names or name in self.rows

    def __getitem__(self, name: str) -> Mountable:
        if name not in self.names:
            raise UnknownName("mountable robot", str(name), self.names)
        return self.rows[self.names.index(name)]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the rows."""
        return tuple(row.name for row in self.rows)

    def __str__(self) -> str:
        width = max(len(name) for name in (*self.names, *(name for name, _ in self.exceptions)))
        lines = [f"{'name':{width}} {'joints':>6} {'mass [kg]':>10}"]
        lines += [
            f"{row.name:{width}} {row.joints:6d} {row.mass:10.3f}  {row.note}".rstrip() for row in self.rows
        ]
        lines += [f"{name:{width}} not: {reason}" for name, reason in self.exceptions]
        return "\n".join(lines)


@lru_cache(maxsize=1)
def mountable() -> Mountables:
    """Return the robots of example-robot-data that `MobileRobot.mount` knows by name.

    It reads each of them once, without its meshes, which takes two seconds; after that it is remembered.
    """
    rows = []
    for name in sorted(_loaders()):
        mounts, note = EXCEPTIONS.get(name, _Exceptional(True, ""))
        if mounts:
            model = _load_arm(name)._model
            mass = sum(inertia.mass for inertia in model.inertias)
            rows.append(Mountable(name, model.nv, mass, note))
    refused = ((name, reason) for name, (mounts, reason) in sorted(EXCEPTIONS.items()) if not mounts)
    return Mountables(tuple(rows), tuple(refused))


def _load_arm(name: str, locked: tuple[str, ...] = ()) -> Arm:
    """Return a robot of example-robot-data.

    Raises
    ------
    UnknownName
        If there is none of that name.
    InvalidArgument
        If its loader fails, or it cannot be mounted.
    """
    loaders = _loaders()
    if name not in loaders:
        raise UnknownName("arm", name, sorted(loaders))
    loader = loaders[name]
    try:
        model, rest, picture, shapes = _made(loader) if _does_more(loader) else _read(loader)
    except PinmobileError:
        raise
    except Exception as error:
        known = EXCEPTIONS.get(name)
        reason = known.reason if known else str(error) or type(error).__name__
        raise InvalidArgument(f"arm {name!r} cannot be loaded: {reason}") from error
    stands = bool(loader.free_flyer)
    angles = convert_configuration(model, rest)
    return Arm(Origin("loader", name), model, angles, picture, locked, stands, shapes=shapes)


def _loaders() -> dict[str, Any]:
    from example_robot_data import ROBOTS

    return dict(ROBOTS)


def _does_more(loader: Any) -> bool:
    """Return whether the loader does more than read a URDF."""
    return "__init__" in vars(loader) or not loader.urdf_filename


def _made(loader: Any) -> tuple[pin.Model, Array, Picture, Picture]:
    robot = loader().robot
    shown, solid = GivenPicture(robot.visual_model), GivenPicture(robot.collision_model)
    return robot.model, robot.q0, shown, solid


def _read(loader: Any) -> tuple[pin.Model, Array, Picture, Picture]:
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
    where = home / urdf, (home.parents[1],)
    return model, rest, FilePicture(*where), FileShapes(*where)


_NO_FRAME = 2**63  # beyond, Pinocchio means that there is none
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
    if isinstance(arm, str | PathLike):
        file = _is_file(arm)
        arm = location("arm", arm) if file else arm
        given = {"visual": visual is not None, "collision": collision is not None}
        _refuse_beside("a URDF" if file else "a loader's name", arm, **given)
        if file:
            made = _from_urdf(Path(arm).resolve(), folders, rest, held)
        else:
            _refuse_beside("a loader's name", arm, package_dirs=bool(folders))
            made = _load_arm(str(arm), held)
            made = made if rest is None else replace(made, rest=_posture(made.whole, rest))
    else:
        _refuse_beside("a model", getattr(arm, "name", arm), package_dirs=bool(folders))
        made = _from_model(arm, visual, collision, rest, held)
    if rest is not None:
        _check_rest(made)
    return made


def kept_arm(arm: str, *, package_dirs: Sequence[str], locked: Sequence[str], rest: ArrayLike) -> Arm:
    """Return an arm of a name or file again, with the reference posture that it had, clipped or not.

    Raises
    ------
    InvalidArgument, UnknownName
        If it is no longer there, or no longer has that many joints.
    """
    made = read_arm(arm, package_dirs=package_dirs, locked=locked)
    return replace(made, rest=_posture(made.whole, rest))


def _refuse_beside(kind: str, arm: object, **given: bool) -> None:
    for argument, is_given in given.items():
        if is_given:
            takes = "a URDF" if argument == "package_dirs" else "a pinocchio.Model"
            raise InvalidArgument(
                f"{argument} does not apply to {kind}, {str(arm)!r}, expected it beside {takes} alone"
            )


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
    if hasattr(arm, "model") and hasattr(arm, "visual_model"):  # a pin.RobotWrapper
        visual = arm.visual_model if visual is None else visual
        collision = getattr(arm, "collision_model", None) if collision is None else collision
        kept = getattr(arm, "q0", None)
        arm = arm.model
    instance("arm", arm, pin.Model, "a name, the path of a URDF, or a pinocchio.Model")
    if arm.njoints == 1:
        raise InvalidArgument(
            f"arm {arm.name!r} has no joints, expected one at least: a PayloadBody has none"
        )
    shown, solid = (pin.GeometryModel() if each is None else each.clone() for each in (visual, collision))
    _check_geometry("visual", arm, shown)
    _check_geometry("collision", arm, solid)
    whole = replace_continuous_joints(arm)
    usual = _posture(whole, None if kept is None else convert_configuration(arm, vector("q0", kept, arm.nq)))
    posture = usual if rest is None else _posture(whole, rest)
    origin = Origin("model", arm.name or "arm")
    shapes = GivenPicture(solid)
    return Arm(origin, arm.copy(), posture, GivenPicture(shown), locked, usual=usual, shapes=shapes)


def _is_file(arm: str | PathLike[str]) -> bool:
    # A name has neither; what looks like a path is one, there or not.
    return not isinstance(arm, str) or "/" in arm or arm.lower().endswith((".urdf", ".xml"))


def _posture(model: pin.Model, rest: ArrayLike | None) -> Array:
    posture = pin.neutral(model) if rest is None else vector("rest", rest, model.nq)
    shaped("rest", posture, (model.nq,))
    if not pin.isNormalized(model, posture, 1e-6):
        raise InvalidArgument(f"rest is {posture.tolist()}, expected quaternions of length one")
    return posture


def _check_geometry(argument: str, model: pin.Model, geometry: pin.GeometryModel) -> None:
    """Refuse geometry on joints or frames that the model does not have."""
    for item in geometry.geometryObjects:
        joint, frame = item.parentJoint, item.parentFrame
        if joint >= model.njoints or model.nframes <= frame < _NO_FRAME:
            raise InvalidArgument(
                f"{argument} has {item.name!r} on joint {joint} and frame {frame} of arm {model.name!r}, "
                f"which has {model.njoints} joints and {model.nframes} frames, expected that arm's geometry"
            )


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
    picture = FilePicture(path, tuple(map(Path, folders)))
    whole, origin = replace_continuous_joints(model), Origin("urdf", str(path), folders)
    shapes, usual = FileShapes(path, picture.package_dirs), pin.neutral(whole)
    arm = Arm(origin, model, _posture(whole, rest), picture, locked, usual=usual, shapes=shapes)

    def body_of(link: str) -> Array:
        joint = model.frames[model.getFrameId(link, pin.FrameType.BODY)].parentJoint
        return np.asarray(model.inertias[joint].inertia)

    judge_links(root, path.name, body_of, stacklevel=5)
    return arm
