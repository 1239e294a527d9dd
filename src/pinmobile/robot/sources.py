"""What `MobileRobot.mount` is given, as an `Arm`: a loader's name, a URDF, or a `pin.Model`."""

from collections.abc import Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array, location, sequence, vector
from pinmobile.errors import InvalidArgument, shown
from pinmobile.robot.arms import Arm, Origin
from pinmobile.robot.library import load_arm
from pinmobile.robot.pictures import FilePicture, GivenPicture
from pinmobile.robot.wellformed import check_freedom, judge_links, urdf_text

__all__ = ["existing_folders", "kept_arm", "read_arm"]

_NO_FRAME = 2**63  # beyond, Pinocchio means that there is none
_SLACK = 1e-9  # [m, rad]: a posture at a limit is there but for rounding


def read_arm(
    arm: Any,
    *,
    package_dirs: str | PathLike[str] | Sequence[str | PathLike[str]] = (),
    visual: pin.GeometryModel | None = None,
    rest: Any = None,
    locked: Sequence[str] = (),
) -> Arm:
    """Return what is to be mounted, read and checked.

    Parameters
    ----------
    arm, package_dirs, visual, rest, locked
        As in `MobileRobot.mount`.

    Raises
    ------
    InvalidArgument
        If it cannot be read or mounted, or is something else.
    UnknownName
        If no loader has the name.
    """
    held = (locked,) if isinstance(locked, str) else sequence("locked", locked, "a sequence of joints' names")
    if visual is not None and not isinstance(visual, pin.GeometryModel):
        raise InvalidArgument(f"visual is a {type(visual).__name__}, expected a pinocchio.GeometryModel")
    folders = existing_folders(package_dirs)
    if isinstance(arm, Arm):
        return arm
    if isinstance(arm, str | PathLike):
        file = _is_file(arm)
        arm = location("arm", arm) if file else arm
        _refuse_beside("a URDF" if file else "a loader's name", arm, visual=visual is not None)
        if file:
            made = _from_urdf(Path(arm).resolve(), folders, rest, held)
        else:
            _refuse_beside("a loader's name", arm, package_dirs=bool(folders))
            made = load_arm(str(arm), held)
            made = made if rest is None else replace(made, rest=_posture(made.whole, rest))
    else:
        _refuse_beside("a model", getattr(arm, "name", arm), package_dirs=bool(folders))
        made = _from_model(arm, visual, rest, held)
    if rest is not None:
        _check_rest(made)
    return made


def kept_arm(arm: str, *, package_dirs: Sequence[str], locked: Sequence[str], rest: Any) -> Arm:
    """Return an arm of a name or file again, with the reference posture that it had, clipped or not.

    Raises
    ------
    InvalidArgument, UnknownName
        If it is no longer there, or no longer has that many joints.
    """
    made = read_arm(arm, package_dirs=package_dirs, locked=locked)
    return replace(made, rest=_posture(made.whole, rest))


def _refuse_beside(kind: str, arm: Any, **given: bool) -> None:
    for argument, is_given in given.items():
        if is_given:
            takes = "a pinocchio.Model" if argument == "visual" else "a URDF"
            raise InvalidArgument(
                f"{argument} does not apply to {kind}, {str(arm)!r}, expected it beside {takes} alone"
            )


def existing_folders(package_dirs: Any) -> tuple[str, ...]:
    """Return the folders of ``package_dirs``, resolved; one of them may come alone.

    Raises
    ------
    InvalidArgument
        If it is something else, or one of them is no folder.
    """
    given = (package_dirs,) if isinstance(package_dirs, str | PathLike) else package_dirs
    try:
        paths = tuple(location("package_dirs", one) for one in given)
    except TypeError:
        raise InvalidArgument(f"package_dirs is {shown(package_dirs)}, expected folders") from None
    for path in paths:
        if not path.is_dir():
            raise InvalidArgument(f"package_dirs has {shown(str(path))}, expected a folder")
    return tuple(str(path.resolve()) for path in paths)


def _from_model(arm: Any, visual: pin.GeometryModel | None, rest: Any, locked: tuple[str, ...]) -> Arm:
    kept = None
    if hasattr(arm, "model") and hasattr(arm, "visual_model"):  # a pin.RobotWrapper
        visual = arm.visual_model if visual is None else visual
        kept = getattr(arm, "q0", None)
        arm = arm.model
    if not isinstance(arm, pin.Model):
        raise InvalidArgument(
            f"arm is a {type(arm).__name__}, expected a name, the path of a URDF, or a pinocchio.Model"
        )
    if arm.njoints == 1:
        raise InvalidArgument(f"arm {arm.name!r} has no joints, expected one at least: a Load has none")
    check_freedom(arm.nv, f"arm {arm.name!r}")
    shown = pin.GeometryModel() if visual is None else visual.clone()
    _check_visual(arm, shown)
    usual = _posture(arm, kept)
    posture = usual if rest is None else _posture(arm, rest)
    origin = Origin("model", arm.name or "arm")
    return Arm(origin, arm.copy(), posture, GivenPicture(shown), locked, usual=usual)


def _is_file(arm: str | PathLike[str]) -> bool:
    # A name has neither; what looks like a path is one, there or not.
    return not isinstance(arm, str) or "/" in arm or arm.lower().endswith((".urdf", ".xml"))


def _posture(model: pin.Model, rest: Any) -> Array:
    posture = pin.neutral(model) if rest is None else vector("rest", rest, model.nq)
    if posture.shape != (model.nq,):
        raise InvalidArgument(f"rest has shape {posture.shape}, expected ({model.nq},)")
    if not pin.isNormalized(model, posture, 1e-6):
        raise InvalidArgument(f"rest is {posture.tolist()}, expected each (cos, sin) of length one")
    return posture


def _check_visual(model: pin.Model, visual: pin.GeometryModel) -> None:
    """Refuse geometry on joints or frames that the model does not have."""
    for item in visual.geometryObjects:
        joint, frame = item.parentJoint, item.parentFrame
        if joint >= model.njoints or model.nframes <= frame < _NO_FRAME:
            raise InvalidArgument(
                f"visual has {item.name!r} on joint {joint} and frame {frame} of arm {model.name!r}, which "
                f"has {model.njoints} joints and {model.nframes} frames, expected the geometry of that arm"
            )


def _check_rest(arm: Arm) -> None:
    """Refuse a reference posture outside the limits."""
    model = arm.whole
    for joint in range(1, model.njoints):
        if model.nqs[joint] != model.nvs[joint]:
            continue
        for k in range(model.idx_qs[joint], model.idx_qs[joint] + model.nqs[joint]):
            least, most = model.lowerPositionLimit[k], model.upperPositionLimit[k]
            # Equal limits are none.
            if least < most and not least - _SLACK <= arm.rest[k] <= most + _SLACK:
                raise InvalidArgument(
                    f"rest has joint {model.names[joint]!r} at {arm.rest[k]:.9g}, "
                    f"expected {least:.9g} to {most:.9g}"
                )


def _from_urdf(path: Path, folders: tuple[str, ...], rest: Any, locked: tuple[str, ...]) -> Arm:
    text, root = urdf_text("arm", path)
    try:
        model = pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as error:
        raise InvalidArgument(f"{path.name} is not a URDF that Pinocchio reads: {error}") from None
    picture = FilePicture(path, tuple(map(Path, folders)))
    origin, posture = Origin("urdf", str(path), folders), _posture(model, rest)
    arm = Arm(origin, model, posture, picture, locked, usual=pin.neutral(model))

    def body_of(link: str) -> Array:
        joint = model.frames[model.getFrameId(link, pin.FrameType.BODY)].parentJoint
        return np.asarray(model.inertias[joint].inertia)

    judge_links(root, path.name, body_of, stacklevel=5)
    return arm
