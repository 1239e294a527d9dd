"""Files that are written completely or not at all, the format of archives, and their errors."""

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

# Errors that another path avoids. All other errors are faults of the system, such as a full disk.
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
    """Open a binary file that replaces the file at `path` when all content is on disk, as a context manager.

    If anything fails, or the process dies, an existing file remains unchanged. A new file gets the
    permissions of the umask, and an existing file keeps its permissions. A link remains, and its target is
    replaced. The function writes directly to devices, pipes and open files such as ``/dev/stdout``.

    Parameters
    ----------
    path : str or path-like
        File to write.
    name : str
        Name of the argument, for the message.
    through : Path, optional
        Temporary file for the content; default: a new file beside `path`.

    Yields
    ------
    file : binary file
        File to write to.

    Raises
    ------
    InvalidArgument
        If the path cannot be a file that this process may write.
    FileError
        If the system fails, for example because the disk is full.

    See Also
    --------
    files.write : write given content

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from pinmobile.files import replacing
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "run.bin")
    ...     with replacing(path) as file:
    ...         file.write(b"complete") and path.exists()
    ...     path.read_bytes()
    False
    b'complete'
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
                os.fsync(raw.fileno())  # some file systems and quotas report a full disk only here
            raw.close()
            if real and made:
                os.replace(made, real)
    except BaseException:
        with suppress(OSError):
            raw.close()  # before its buffer, which would try to write the rest
        with suppress(OSError):
            if made:
                made.unlink()
        raise


def write(path: str | PathLike[str], data: bytes, *, name: str = "path", through: Path | None = None) -> None:
    """Write a file completely or not at all.

    Parameters
    ----------
    path : str or path-like
        File to write; it replaces an existing file.
    data : bytes
        Content.
    name : str
        Name of the argument, for the message.
    through : Path, optional
        Temporary file, see `replacing`.

    Raises
    ------
    InvalidArgument
        If the path cannot be a file that this process may write.
    FileError
        If the system fails, for example because the disk is full.

    See Also
    --------
    files.replacing : the same for content in pieces

    Examples
    --------
    >>> from pinmobile import InvalidArgument
    >>> from pinmobile.files import write
    >>> try:
    ...     write("/no/such/folder/run.bin", b"")
    ... except InvalidArgument as error:
    ...     print(error)
    path is '/no/such/folder/run.bin', which cannot be written: ...
    """
    with replacing(path, name=name, through=through) as file:
        file.write(data)


def write_table(path: str | PathLike[str], header: Sequence[str], columns: Sequence[Array]) -> None:
    """Write columns as CSV with 17 significant digits, which distinguish all float64 numbers.

    Parameters
    ----------
    path : str or path-like
        File to write; errors are those of `replacing`.
    header : sequence of str
        Titles of the columns.
    columns : sequence of ndarray, shape (n,) or (n, m)
        One column, or m columns.

    See Also
    --------
    Rollout.to_csv : CSV file of a run

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import numpy as np
    >>> from pinmobile.files import write_table
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "run.csv")
    ...     columns = [np.arange(2), np.ones(2)]
    ...     write_table(path, ["t [s]", "x [m]"], columns)
    ...     print(path.read_text())
    t [s],x [m]
    0,1
    1,1
    """
    with replacing(path) as file:
        titles = io.StringIO()
        csv.writer(titles, lineterminator="\n").writerow(header)  # quotes special characters of joint names
        file.write(titles.getvalue().encode())
        np.savetxt(file, np.column_stack(columns), fmt="%.17g", delimiter=",")


def written(path: str | PathLike[str], suffix: str, content: Callable[[], bytes]) -> Path:
    """Check that a file can be written, then compute its content, write it, and return the path.

    Parameters
    ----------
    path : str or path-like
        File to write; it replaces an existing file.
    suffix : str
        Expected suffix, such as ``".gif"``.
    content : callable
        Function without arguments that returns the content as bytes.

    Returns
    -------
    path : pathlib.Path
        The file.

    Raises
    ------
    InvalidArgument
        If the path cannot be a file that this process may write, or has another suffix.
    FileError
        If the system fails, for example because the disk is full.

    See Also
    --------
    files.write : write given content

    Examples
    --------
    >>> from pinmobile.files import written
    >>> written("run.png", ".gif", lambda: b"")
    Traceback (most recent call last):
    ...
    pinmobile.errors.InvalidArgument: path is 'run.png', expected a name that ends in '.gif'
    """
    target = location("path", path)
    if target.suffix.lower() != suffix:
        raise InvalidArgument(f"path is {str(target)!r}, expected a name that ends in {suffix!r}")
    with replacing(target) as file, refusals("made", "path", target):
        file.write(content())
    return target


@contextmanager
def refusals(done: str, name: str, path: str | PathLike[str]) -> Iterator[None]:
    """Convert system errors within a ``with`` block to errors that name the file, see `cannot`.

    Parameters
    ----------
    done : str
        Participle for the message, such as ``"read"`` or ``"written"``.
    name : str
        Name of the argument.
    path : str or path-like
        File of the message.

    Raises
    ------
    InvalidArgument, FileError
        In place of an `OSError` within the block.

    See Also
    --------
    files.cannot : the error

    Examples
    --------
    >>> from pinmobile.files import refusals
    >>> with refusals("read", "path", "run.npz"):
    ...     raise FileNotFoundError(2, "No such file or directory")
    Traceback (most recent call last):
    ...
    pinmobile.errors.InvalidArgument: path is 'run.npz', which cannot be read: No such file or directory
    """
    try:
        yield
    except PinmobileError:
        raise
    except OSError as error:
        raise cannot(done, name, path, error) from error


def cannot(done: str, name: str, path: str | PathLike[str], error: OSError) -> PinmobileError:
    """Return the error of pinmobile for a system error about a file.

    Parameters
    ----------
    done : str
        Participle for the message, such as ``"read"`` or ``"written"``.
    name : str
        Name of the argument.
    path : str or path-like
        File of the message.
    error : OSError
        Error of the system.

    Returns
    -------
    error : InvalidArgument or FileError
        `FileError` if another path would not help: the disk is full, or a device fails.

    See Also
    --------
    files.refusals : context manager that raises the error

    Examples
    --------
    >>> from pinmobile.files import cannot
    >>> error = OSError(5, "Input/output error")
    >>> cannot("read", "path", "run.npz", error)
    FileError("path is 'run.npz', which cannot be read: Input/output error")
    """
    why, folder = error.strerror or str(error), Path(path).parent
    if done == "written" and error.errno in (errno.ENOENT, errno.ENOTDIR) and not folder.is_dir():
        why = f"there is no folder {str(folder)!r}"
    message = f"{name} is {str(path)!r}, which cannot be {done}: {why}"
    if error.errno in _OF_THE_PATH:
        return InvalidArgument(message)
    return FileError(message, errno=error.errno, filename=str(path))


class _Sink(io.FileIO):
    """Raw file with errors that name the file."""

    told: tuple[str, Path]

    def __init__(self, descriptor: int) -> None:
        super().__init__(descriptor, "wb")

    def write(self, data: ReadableBuffer, /) -> int:
        try:
            return super().write(data)
        except OSError as error:
            raise cannot("written", *self.told, error) from error


def _replaceable(path: Path) -> Path | None:
    """Return the target file of a path, or None if the path is not a regular file of a folder.

    Raises
    ------
    OSError
        If the file exists and this process may not write it, even if it may write the folder.
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
    """Return whether a path is an open file of a process, such as ``/dev/stdout``."""
    link = path
    while True:
        folder = Path(os.path.realpath(link.parent))
        if folder.name == "fd" and folder.parts[1] in ("dev", "proc"):
            return True
        if not link.is_symlink():
            return False
        link = folder / os.readlink(link)


def _dress_as(there: Path, descriptor: int) -> None:
    """Give an open file the owner and the permissions of an existing file."""
    try:
        like = there.stat()
    except FileNotFoundError:
        return
    with suppress(PermissionError):  # the file then belongs to the writer
        os.fchown(descriptor, like.st_uid, like.st_gid)
    os.fchmod(descriptor, stat.S_IMODE(like.st_mode))


_NAME = re.compile(r"[A-Za-z_][\w.]*", re.ASCII)


def write_archive(path: str | PathLike[str], form: str, content: Mapping[str, Any]) -> None:
    """Write content as a NumPy archive (``.npz``): arrays by their paths, everything else as JSON.

    Parameters
    ----------
    path : str or path-like
        File to write; errors are those of `replacing`.
    form : str
        Name and version of the format.
    content : mapping of str to object
        Arrays, numbers, text, tuples, mappings, and objects of classes of pinmobile with such fields.

    See Also
    --------
    files.read_archive : read the archive
    Rollout.save : archive of a run

    Examples
    --------
    >>> import pathlib, tempfile
    >>> from pinmobile.files import read_archive, write_archive
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "gains.npz")
    ...     write_archive(path, "gains 1", {"kp": (4.0, 9.0)})
    ...     read_archive(path, "gains 1", dict)
    {'kp': (4.0, 9.0)}
    """
    arrays: dict[str, Any] = {}
    described = json.dumps(_packed(dict(content), "", arrays))
    with replacing(path) as file:
        np.savez(file, allow_pickle=False, format=form, description=described, **arrays)


def packed(value: object) -> str:
    """Return a value as JSON text, for `unpacked`.

    Parameters
    ----------
    value : object
        Value as for `write_archive`.

    Raises
    ------
    TypeError
        If an object is not of a class of pinmobile.
    InvalidArgument
        If an object cannot be reconstructed.

    See Also
    --------
    files.unpacked : the inverse

    Examples
    --------
    >>> from pinmobile import Circle
    >>> from pinmobile.files import packed, unpacked
    >>> circle = Circle(1.0, 0.5, 4.0)
    >>> unpacked(packed(circle)) == circle
    True
    """
    return json.dumps(_packed(value, "", None))


def unpacked(text: str) -> Any:
    """Return the value of a text of `packed`.

    Parameters
    ----------
    text : str
        Text of `packed`.

    See Also
    --------
    files.packed : the inverse

    Examples
    --------
    >>> from pinmobile.files import packed, unpacked
    >>> unpacked(packed({"kp": (4.0, 9.0)}))
    {'kp': (4.0, 9.0)}
    """
    return _unpacked(json.loads(text), {})


def _packed(value: Any, path: str, arrays: dict[str, Any] | None) -> Any:
    """Return a value for JSON. Arrays go to `arrays`; arrays of parts become lists in the value."""
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
        raise TypeError(f"{name} is not a class of pinmobile that a file can contain")
    if isinstance(value, Enum):
        return {"type": name, "member": value.name}
    own = {key: _packed(x, _join(path, key), None if attrs.has(kind) else arrays) for key, x in _kept(value)}
    return {"type": name, "fields": own}


def _join(path: str, key: object) -> str:
    return f"{path}.{key}" if path else str(key)


def _is_plain(kind: Any) -> bool:
    """Return whether a class belongs to pinmobile and its objects consist of fields."""
    if not isinstance(kind, type) or not kind.__module__.startswith("pinmobile."):
        return False
    return dataclasses.is_dataclass(kind) or attrs.has(kind) or issubclass(kind, Enum | tuple)


_KEPT: dict[Any, tuple[Callable[[Any], dict[str, Any]], Callable[..., Any]]] = {}


def keep(kind: type, kept: Callable[[Any], dict[str, Any]], restored: Callable[..., Any]) -> None:
    """Register a class whose objects archives store by other values than its fields.

    Parameters
    ----------
    kind : type
        Class of pinmobile.
    kept : callable
        Function that returns the stored values of an object by name.
    restored : callable
        Function of these values, as keyword arguments, that returns the object.

    See Also
    --------
    files.write_archive : write an archive

    Examples
    --------
    >>> from pinmobile.files import keep, packed, unpacked
    >>> from pinmobile.signals import Signal
    >>> keep(Signal, Signal._asdict, Signal)
    >>> unpacked(packed(Signal("N", 1.0)))
    Signal(unit='N', values=1.0)
    """
    _KEPT[kind] = kept, restored


def _kept(value: Any) -> Iterable[tuple[str, Any]]:
    """Return the stored values of an object by name: its fields, or the values of `keep`."""
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
        raise ValueError(f"it has a {tree['type']}, expected a class of pinmobile")
    if "member" in tree:
        return kind[tree["member"]]
    fields = {key: _unpacked(each, arrays) for key, each in tree["fields"].items()}
    return _KEPT[kind][1](**fields) if kind in _KEPT else kind(**fields)


def read_archive(path: Path, form: str, make: Callable[[dict[str, Any]], _T]) -> _T:
    """Read an archive of `write_archive`, and return a function of its content.

    Parameters
    ----------
    path : Path
        File to read.
    form : str
        Expected name and version of the format.
    make : callable
        Function of the content. Arrays in the content are read-only.

    Raises
    ------
    InvalidArgument
        If the file cannot be read, is damaged, or has another format.
    FileError
        If the system fails.

    See Also
    --------
    files.write_archive : write the archive
    Rollout.load : read a run

    Examples
    --------
    >>> import pathlib
    >>> from pinmobile import InvalidArgument
    >>> from pinmobile.files import read_archive
    >>> try:
    ...     read_archive(pathlib.Path("gone.npz"), "gains 1", dict)
    ... except InvalidArgument as error:
    ...     print(error)
    path is 'gone.npz', which cannot be read: No such file ...
    """
    try:
        with path.open("rb") as file:
            if not zipfile.is_zipfile(file):  # otherwise NumPy advises to load pickles, which may run code
                raise ValueError("it is not an .npz file, or its end is missing")
            file.seek(0)
            with np.load(file) as archive:
                arrays = dict(archive)
        other = str(arrays["format"])
        if other != form:
            raise ValueError(f"its format is {other!r}")
        for array in arrays.values():
            array.setflags(write=False)
        return make(_unpacked(json.loads(str(arrays["description"])), arrays))
    except OSError as error:
        raise cannot("read", "path", path, error) from error
    except Exception as error:  # zipfile and NumPy raise many errors for damaged files
        why = f"it has no {error}" if isinstance(error, KeyError) else str(error) or type(error).__name__
        raise InvalidArgument(f"path is {str(path)!r}, which is not a {form!r} archive: {why}") from error
