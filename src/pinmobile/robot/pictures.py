"""What is drawn of what the body carries: of arms by their files or as given, of loads a box."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from pinmobile.robot.assembly import named_frames
from pinmobile.robot.engine import BODY_JOINT
from pinmobile.robot.meshes import VisualFile, readable, shown
from pinmobile.robot.mounts import Load, Mount
from pinmobile.robot.visual import drawn

__all__ = ["FilePicture", "GivenPicture", "add_carried"]

_LOAD_RGBA = (0.55, 0.55, 0.58, 1.0)


@dataclass(frozen=True)
class FilePicture:
    """What a URDF shows, each object on its own joint; read when it is called.

    Parameters
    ----------
    path, package_dirs
        As in `VisualFile`.
    """

    path: Path
    package_dirs: tuple[Path, ...]

    def __call__(self, model: pin.Model) -> pin.GeometryModel:
        """Return the geometry of the file's model; meshes that are missing or broken are named in a warning.

        Raises
        ------
        InvalidArgument
            If the file cannot be read any more.
        """
        file = VisualFile(self.path, self.package_dirs, ())
        root, _ = readable(file, stacklevel=8)
        return shown(model, root, file, stacklevel=8)[0]


@dataclass(frozen=True, eq=False)
class GivenPicture:
    """Geometry that is there already.

    Parameters
    ----------
    visual : pin.GeometryModel
        What is drawn.
    """

    visual: pin.GeometryModel

    def __call__(self, model: pin.Model) -> pin.GeometryModel:
        """Return it."""
        return self.visual


def add_carried(
    visuals: pin.GeometryModel,
    model: pin.Model,
    mounts: Sequence[Mount],
    loads: Sequence[tuple[str, Load]],
) -> None:
    """Add what is drawn of arms and loads, on the joints of the whole model."""
    import coal

    for mount in mounts:
        for item in mount.arm.visuals().geometryObjects:
            own = item.parentJoint
            joint = mount.joints.start + own - 1 if own else BODY_JOINT
            placement = item.placement if own else mount.placement * item.placement
            visuals.addGeometryObject(drawn(f"{mount.name}/{item.name}", joint, placement, item))
    frames = named_frames(model)
    for number, (name, load) in enumerate(loads, start=1):
        if load.size is None:
            continue
        frame = model.frames[frames[name]]
        placement = frame.placement * pin.SE3(np.eye(3), np.array(load.com))
        box = pin.GeometryObject(f"load{number}", frame.parentJoint, placement, coal.Box(*load.size))
        box.meshColor = np.array(_LOAD_RGBA)
        visuals.addGeometryObject(box)
