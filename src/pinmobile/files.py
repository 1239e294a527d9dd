"""Files written whole or not at all, the one format of archives, and what refuses either."""

from __future__ import annotations

import csv
import dataclasses
import errno
import io
import json
import os
import re
import stat
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from enum import Enum
from importlib import import_module
from os import PathLike
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, TypeVar

import attrs
import numpy as np

from pinmobile.arrays import Array, location
from pinmobile.errors import FileError, InvalidArgument, PinmobileError

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

_T = TypeVar("_T")

# What a path is at fault for, and another one mends; all else is the system's: a full disk, a failing device.
_OF_THE_PATH = frozenset(
    {
        *(errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EEXIST, errno.ENOTEMPTY, errno.ENAMETOOLONG),
        *(errno.EACCES, errno.EPERM, errno.EROFS, errno.ELOOP, errno.EINVAL, errno.ENXIO, errno.EILSEQ),
    }
)


@contextmanager
def replacing(
    path: str | PathLike[str], *, name: str = "path", through: Path | None = None
) -> Iterator[IO[bytes]]:
    """Give a binary file to write to, which takes the place of what is at `path` once all of it is on disk.

    Where anything fails, or the process dies, what was there is there still. As with `open`, a new file has
    the permissions that the umask leaves, one that was there keeps its own, a link stays and what it leads to
    is replaced, and devices, pipes and open files such as ``/dev/stdout`` are written to as they are.

    Parameters
    ----------
    path : str or path-like
        The file.
    name : str
        Of the argument, for the message.
    through : Path, optional
        File in which the content is gathered; by default a new one beside the file, which is gone afterwards.

    Raises
    ------
    InvalidArgument
        If there can be no such file.
    FileError
        If the system fails, such as of a full disk.
    """
    target = location(name, path)
    with refusals("written", name, target):
        real = _replaceable(target)
        made = real and (through or real.with_name(f".pinmobile-{os.urandom(8).hex()}.new"))
        is_own = os.O_EXCL if made and not through else os.O_TRUNC
        raw = _Sink(os.open(made or target, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | is_own, 0o666))
    raw.told = name, target
    try:
        file = io.BufferedWriter(raw)
        yield file
        with refusals("written", name, target):
            file.flush()
            if real and made:
                _dress_as(real, raw.fileno())
                os.fsync(raw.fileno())  # some file systems, and quotas, tell only now that there is no room
            raw.close()
            if real and made:
                os.replace(made, real)
    except BaseException:
        with suppress(OSError):
            raw.close()  # before its buffer, which would try to write what is left
        with suppress(OSError):
            if made:
                made.unlink()
        raise


def write(path: str | PathLike[str], data: bytes, *, name: str = "path", through: Path | None = None) -> None:
    """Write a file as a whole; parameters and errors are those of `replacing`."""
    with replacing(path, name=name, through=through) as file:
        file.write(data)


def write_table(path: str | PathLike[str], header: Sequence[str], columns: Sequence[Array]) -> None:
    """Write columns as CSV with 17 significant digits, which tell every float64 from all others.

    Parameters
    ----------
    path : str or path-like
        The file; errors are those of `replacing`.
    header : sequence of str
        What stands above the columns.
    columns : sequence of ndarray, shape (n,) or (n, m)
        One column, or m of them.
    """
    with replacing(path) as file:
        titles = io.StringIO()
        csv.writer(titles, lineterminator="\n").writerow(header)  # quotes what a joint's name needs
        file.write(titles.getvalue().encode())
        np.savetxt(file, np.column_stack(columns), fmt="%.17g", delimiter=",")


def written(path: str | PathLike[str], suffix: str, content: Callable[[], bytes]) -> Path:
    """Write a file whose content takes its time, once it is known that it can be written; return its path.

    Raises
    ------
    InvalidArgument
        If there can be no such file, or its name ends in another suffix.
    FileError
        If the system fails, such as of a full disk.
    """
    target = location("path", path)
    if target.suffix.lower() != suffix:
        raise InvalidArgument(f"path is {str(target)!r}, expected a name that ends in {suffix!r}")
    with replacing(target) as file, refusals("made", "path", target):
        file.write(content())
    return target


@contextmanager
def refusals(done: str, name: str, path: str | PathLike[str]) -> Iterator[None]:
    """Raise what the system refuses within as an error that names the file, see `cannot`."""
    try:
        yield
    except PinmobileError:
        raise
    except OSError as error:
        raise cannot(done, name, path, error) from error


def cannot(done: str, name: str, path: str | PathLike[str], error: OSError) -> PinmobileError:
    """Return the error about a file that the system refuses.

    Parameters
    ----------
    done : str
        What cannot be done: ``"read"``, ``"written"``.
    name : str
        Of the argument.
    path : str or path-like
        The file.
    error : OSError
        What the system says.

    Returns
    -------
    error : InvalidArgument or FileError
        The latter where another path would not help: the disk is full, a device fails.
    """
    why, folder = error.strerror or str(error), Path(path).parent
    if done == "written" and error.errno in (errno.ENOENT, errno.ENOTDIR) and not folder.is_dir():
        why = f"there is no folder {str(folder)!r}"
    message = f"{name} is {str(path)!r}, which cannot be {done}: {why}"
    if error.errno in _OF_THE_PATH:
        return InvalidArgument(message)
    return FileError(message, errno=error.errno, filename=str(path))


class _Sink(io.FileIO):
    """A file whose errors name it, whoever writes into it."""

    told: tuple[str, Path]

    def __init__(self, descriptor: int) -> None:
        super().__init__(descriptor, "wb")

    def write(self, data: ReadableBuffer, /) -> int:
        try:
            return super().write(data)
        except OSError as error:
            raise cannot("written", *self.told, error) from error


def _replaceable(path: Path) -> Path | None:
    """Return the file that a path leads to, there or not; None where it is no name of a file in a folder.

    Raises
    ------
    OSError
        If it is there and cannot be written to: that its folder can be is not enough.
    """
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        return Path(os.path.realpath(path))
    if not stat.S_ISREG(mode) or _is_open_file(path):
        return None
    real = Path(os.path.realpath(path))
    os.close(os.open(real, os.O_WRONLY | os.O_CLOEXEC))
    return real


def _is_open_file(path: Path) -> bool:
    """Return whether a path leads to a file that some process has open, as ``/dev/stdout`` may."""
    link = path
    while True:
        folder = Path(os.path.realpath(link.parent))
        if folder.name == "fd" and folder.parts[1] in ("dev", "proc"):
            return True
        if not link.is_symlink():
            return False
        link = folder / os.readlink(link)


def _dress_as(there: Path, descriptor: int) -> None:
    """Give an open file the owner and the permissions of one that is there."""
    try:
        like = there.stat()
    except FileNotFoundError:
        return
    with suppress(PermissionError):  # it is then the writer's
        os.fchown(descriptor, like.st_uid, like.st_gid)
    os.fchmod(descriptor, stat.S_IMODE(like.st_mode))


_NAME = re.compile(r"[A-Za-z_][\w.]*", re.ASCII)


def write_archive(path: str | PathLike[str], form: str, content: Mapping[str, Any]) -> None:
    """Write a tree as a NumPy archive (``.npz``): its arrays by their paths, all else as JSON beside them.

    Parameters
    ----------
    path : str or path-like
        The file; errors are those of `replacing`.
    form : str
        Name and number of the format.
    content : mapping of str to object
        Arrays, numbers, text, tuples, mappings, and objects of the library's own classes of these.
    """
    arrays: dict[str, Any] = {}
    described = json.dumps(_packed(dict(content), "", arrays))
    with replacing(path) as file:
        np.savez(file, allow_pickle=False, format=form, description=described, **arrays)


def packed(value: object) -> str:
    """Return a value as text, from which `unpacked` makes it again.

    Raises
    ------
    TypeError
        If an object in it is not of the library's own classes.
    InvalidArgument
        If an object in it cannot be made again.
    """
    return json.dumps(_packed(value, "", None))


def unpacked(text: str) -> Any:
    """Return the value that `packed` returned as text."""
    return _unpacked(json.loads(text), {})


def _packed(value: Any, path: str, arrays: dict[str, Any] | None) -> Any:
    """Return a value as JSON has it; its arrays are put beside it, those of parts stand in it."""
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        if arrays is None:
            return {"numbers": value.ravel().tolist(), "shape": value.shape, "dtype": value.dtype.str}
        name = path if _NAME.fullmatch(path) and path not in arrays else f"array {len(arrays)}"
        arrays[name] = value
        return {"array": name}
    if type(value) in (tuple, list):
        return [_packed(each, f"{path}.{k}", arrays) for k, each in enumerate(value)]
    if isinstance(value, Mapping):
        return {"mapping": [[key, _packed(x, _join(path, key), arrays)] for key, x in value.items()]}
    kind = type(value)
    name = f"{kind.__module__}:{kind.__qualname__}"
    if not _is_plain(kind):
        raise TypeError(f"{name} is no class of the library that a file can keep")
    if isinstance(value, Enum):
        return {"type": name, "member": value.name}
    own = {key: _packed(x, _join(path, key), None if attrs.has(kind) else arrays) for key, x in _kept(value)}
    return {"type": name, "fields": own}


def _join(path: str, key: object) -> str:
    return f"{path}.{key}" if path else str(key)


def _is_plain(kind: Any) -> bool:
    """Return whether objects of a class are made of their fields, by the library's own code."""
    if not isinstance(kind, type) or not kind.__module__.startswith("pinmobile."):
        return False
    return dataclasses.is_dataclass(kind) or attrs.has(kind) or issubclass(kind, Enum | tuple)


_KEPT: dict[Any, tuple[Callable[[Any], dict[str, Any]], Callable[..., Any]]] = {}


def keep(kind: type, kept: Callable[[Any], dict[str, Any]], restored: Callable[..., Any]) -> None:
    """Let archives keep objects of a class by what `kept` returns, the arguments of `restored`."""
    _KEPT[kind] = kept, restored


def _kept(value: Any) -> Iterable[tuple[str, Any]]:
    """Return what makes an object again, by argument: its fields, unless `keep` says something else."""
    if type(value) in _KEPT:
        return _KEPT[type(value)][0](value).items()
    if isinstance(value, tuple):
        return zip(value._fields, value, strict=True)  # type: ignore[attr-defined]
    if attrs.has(type(value)):
        return [(f.alias, getattr(value, f.name)) for f in attrs.fields(type(value)) if f.init]
    return [(f.name, getattr(value, f.name)) for f in dataclasses.fields(value) if f.init]


def _unpacked(tree: Any, arrays: Mapping[str, Any]) -> Any:
    if isinstance(tree, list):
        return tuple(_unpacked(each, arrays) for each in tree)
    if not isinstance(tree, dict):
        return tree
    if "array" in tree:
        return arrays[tree["array"]]
    if "numbers" in tree:
        return np.array(tree["numbers"], tree["dtype"]).reshape(tree["shape"])
    if "mapping" in tree:
        return {key: _unpacked(each, arrays) for key, each in tree["mapping"]}
    module, _, name = tree["type"].partition(":")
    kind: Any = module.startswith("pinmobile.") and getattr(import_module(module), name)
    if not _is_plain(kind):
        raise ValueError(f"it has a {tree['type']}, expected a class of the library")
    if "member" in tree:
        return kind[tree["member"]]
    fields = {key: _unpacked(each, arrays) for key, each in tree["fields"].items()}
    return _KEPT[kind][1](**fields) if kind in _KEPT else kind(**fields)


def read_archive(path: Path, form: str, make: Callable[[dict[str, Any]], _T]) -> _T:
    """Return what a function makes of the content that `write_archive` wrote, its arrays read-only.

    Raises
    ------
    InvalidArgument
        If the file cannot be read, is damaged, or holds something else.
    FileError
        If the system fails.
    """
    try:
        with path.open("rb") as file:
            if not zipfile.is_zipfile(file):  # else NumPy advises to load what may run code
                raise ValueError("it is no .npz file, or its end is lost")
            file.seek(0)
            with np.load(file) as archive:
                arrays = dict(archive)
        other = str(arrays["format"])
        if other != form:
            raise ValueError(f"it is of another format, {other!r}")
        for array in arrays.values():
            array.setflags(write=False)
        return make(_unpacked(json.loads(str(arrays["description"])), arrays))
    except OSError as error:
        raise cannot("read", "path", path, error) from error
    except Exception as error:  # whatever the bytes of a damaged file lead zipfile and NumPy to
        why = f"it has no {error}" if isinstance(error, KeyError) else str(error) or type(error).__name__
        raise InvalidArgument(f"path is {str(path)!r}, which is no {form!r} archive: {why}") from error
