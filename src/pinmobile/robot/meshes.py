"""The meshes of a URDF: where they lie, and what is drawn where they are missing or cannot be read."""

import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from os.path import isfile
from pathlib import Path
from xml.etree import ElementTree

import pinocchio as pin

from pinmobile.errors import InvalidArgument
from pinmobile.robot.wellformed import urdf_tree

__all__ = ["VisualFile", "found", "readable", "shown"]

_INDICES = re.compile(rb"<(?:p|v|vcount)(?=[\s/>])")
_WHOLE_INDICES = re.compile(rb"<(p|v|vcount)(?=[\s/>])(?:[^<>]*/>|[^<>]*>[\d+\- \t\r\n]*</\1\s*>)")


@dataclass(frozen=True)
class VisualFile:
    """The file that says how a robot looks.

    Parameters
    ----------
    path : Path
        A URDF.
    package_dirs : tuple of Path
        Folders that ``package://`` refers to.
    base : tuple of 16 floats
        Pose of the body in the file's root with all joints at rest, row by row.
    """

    path: Path
    package_dirs: tuple[Path, ...]
    base: tuple[float, ...]


def readable(file: VisualFile, stacklevel: int) -> tuple[ElementTree.Element, list[str]]:
    """Return the file's tree without the visuals whose meshes are missing, and those files' names.

    Parameters
    ----------
    file : VisualFile
        The file.
    stacklevel : int
        Of the warning that names them: how far up the user's call is.

    Raises
    ------
    InvalidArgument
        If the file cannot be read any more, or is no URDF by now.
    """
    root = urdf_tree("path", file.path)  # again, since the file may be another one by now
    missing = _without_meshes(root, lambda mesh: _is_missing(mesh, file))
    if missing:
        listed = ", ".join(dict.fromkeys(missing))
        warnings.warn(f"{file.path.name}: not drawn, since missing: {listed}", stacklevel=stacklevel)
    return root, missing


def shown(
    model: pin.Model, root: ElementTree.Element, file: VisualFile, stacklevel: int
) -> tuple[pin.GeometryModel, list[str]]:
    """Return what a tree shows of its model, and the mesh files that cannot be read, taken out of the tree.

    Parameters
    ----------
    model : pin.Model
        The file's.
    root, file, stacklevel
        From `readable`, and as there.

    Raises
    ------
    InvalidArgument
        If the geometry cannot be read whatever the meshes.
    """
    broken = _without_meshes(root, _is_endless)
    try:
        seen = _geometry(model, root)
    except (ValueError, RuntimeError) as error:
        # Pinocchio does not say which of the files it was.
        damaged = _without_meshes(root, _is_broken)
        if not damaged:
            raise InvalidArgument(f"path is {str(file.path)!r}, which cannot be drawn: {error}") from None
        broken += damaged
        seen = _geometry(model, root)
    if broken:
        listed = ", ".join(dict.fromkeys(broken))
        warnings.warn(
            f"{file.path.name}: not drawn, since damaged or of a format that is not read: {listed}",
            stacklevel=stacklevel,
        )
    return seen, broken


def _geometry(model: pin.Model, root: ElementTree.Element) -> pin.GeometryModel:
    text = ElementTree.tostring(root, encoding="unicode")
    return pin.buildGeomFromUrdfString(model, text, pin.GeometryType.VISUAL)


def _without_meshes(root: ElementTree.Element, unusable: Callable[[ElementTree.Element], bool]) -> list[str]:
    """Take visuals whose meshes are unusable out of the tree and return the files' names."""
    names: list[str] = []
    for link in root.iterfind("link"):
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is not None and unusable(mesh):
                names.append(mesh.get("filename", ""))
                link.remove(visual)
    return names


def _is_missing(mesh: ElementTree.Element, file: VisualFile) -> bool:
    """Tell whether there is no file of that name; where there is one, write into the mesh where it lies."""
    path = found(mesh.get("filename", ""), file)
    if path is not None:
        mesh.set("filename", str(path))
    return path is None


def _is_endless(mesh: ElementTree.Element) -> bool:
    """Tell whether a Collada file has other than whole numbers among its indices.

    At such a letter assimp, by which Pinocchio reads meshes, stays for ever and takes more and more memory.
    """
    try:
        data = Path(mesh.get("filename", "")).read_bytes()
    except OSError:
        return False
    if not re.search(b"<collada", data.replace(b"\0", b""), re.IGNORECASE):
        return False
    # What is written in two bytes for each letter would have to be read in another way.
    return b"\0" in data or len(_INDICES.findall(data)) != len(_WHOLE_INDICES.findall(data))


def _is_broken(mesh: ElementTree.Element) -> bool:
    import coal

    try:
        coal.MeshLoader().load(mesh.get("filename", ""))
    except (ValueError, RuntimeError):
        return True
    return False


def found(name: str, file: VisualFile) -> Path | None:
    """Return where a mesh of the file lies, or None where it is not there."""
    scheme, apart, rest = name.rpartition("://")
    rest = rest.lstrip("/") if scheme == "package" else rest
    folders = (*file.package_dirs, file.path.parent) if scheme == "package" else (file.path.parent,)
    candidates = (folder / (rest if apart else name) for folder in folders)
    # Not `Path.is_file`, which raises where a name is longer than a file system allows.
    return next((path.resolve() for path in candidates if isfile(path)), None)
