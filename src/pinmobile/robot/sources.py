"""What `MobileRobot.mount` is given, as an `Arm`: a loader's name, a URDF, or a `pin.Model`."""

from collections.abc import Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import pinocchio as pin

from pinmobile.arrays import Array, vector
from pinmobile.errors import InvalidArgument
from pinmobile.robot.arms import Arm, Origin
from pinmobile.robot.library import load_arm
from pinmobile.robot.pictures import FilePicture, GivenPicture
from pinmobile.robot.wellformed import urdf_text

__all__ = ["read_arm"]


def read_arm(
    arm: Any,
    *,
    package_dirs: Sequence[str | PathLike[str]] = (),
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
    held = tuple(map(str, locked)) if not isinstance(locked, str) else (locked,)
    if isinstance(arm, Arm):
        return arm
    if isinstance(arm, str | PathLike):
        if _is_file(arm):
            folders = tuple(str(Path(folder).resolve()) for folder in package_dirs)
            return _from_urdf(Path(arm).resolve(), folders, rest, held)
        made = load_arm(str(arm), held)
        if rest is None:
            return made
        return replace(made, rest=_posture(made.whole, rest))
    if hasattr(arm, "model") and hasattr(arm, "visual_model"):  # a pin.RobotWrapper
        visual = arm.visual_model if visual is None else visual
        rest = getattr(arm, "q0", None) if rest is None else rest
        arm = arm.model
    if not isinstance(arm, pin.Model):
        raise InvalidArgument(
            f"arm is a {type(arm).__name__}, expected a name, the path of a URDF, or a pinocchio.Model"
        )
    shown = pin.GeometryModel() if visual is None else visual
    origin = Origin("model", arm.name or "arm")
    return Arm(origin, arm.copy(), _posture(arm, rest), GivenPicture(shown), held)


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


def _from_urdf(path: Path, folders: tuple[str, ...], rest: Any, locked: tuple[str, ...]) -> Arm:
    for folder in folders:
        if not Path(folder).is_dir():
            raise InvalidArgument(f"package_dirs has {folder!r}, expected a folder")
    text, _ = urdf_text("arm", path)
    try:
        model = pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as error:
        raise InvalidArgument(f"{path.name} is not a URDF that Pinocchio reads: {error}") from None

    picture = FilePicture(path, tuple(map(Path, folders)))
    origin = Origin("urdf", str(path), folders)
    return Arm(origin, model, _posture(model, rest), picture, locked)
