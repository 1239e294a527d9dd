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
from typing import IO, Any, TypeVar

import attrs
import numpy as np

from pinmobile.arrays import Array, location
from pinmobile.errors import FileError, InvalidArgument, PinmobileError

_T = TypeVar("_T")

# Errors that another path avoids. All other errors are faults of the system, such as a full disk.
_PATH_ERRORS = {
    *(errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EEXIST, errno.ENOTEMPTY, errno.ENAMETOOLONG),
    *(errno.EACCES, errno.EPERM, errno.EROFS, errno.ELOOP, errno.EINVAL, errno.ENXIO, errno.EILSEQ),
}


@contextmanager
def replace_file(
    path: str | PathLike[str], *, name: str = "path", scratch: Path | None = None
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
    scratch : Path, optional
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
    >>> from pinmobile.files import replace_file
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = pathlib.Path(folder, "run.bin")
    ...     with replace_file(path) as file:
    ...         file.write(b"complete") and path.exists()
    ...     path.read_bytes()
    False
    b'complete'
    """
    target = location(name, path)
    with file_errors("written", name, target):
        real = _real_target(target)
        temporary = real and (scratch or real.with_name(f".pinmobile-{os.urandom(8).hex()}.new"))
        open_flag = os.O_EXCL if temporary and not scratch else os.O_TRUNC
        flags = os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | open_flag
        raw = io.FileIO(os.open(temporary or target, flags, 0o666), "wb")
    try:
        file = io.BufferedWriter(raw)
        with file_errors("written", name, target):
            yield file
            file.flush()
            if real and temporary:
                _copy_mode(real, raw.fileno())
                os.fsync(raw.fileno())  # some file systems and quotas report a full disk only here
            raw.close()
            if real and temporary:
                os.replace(temporary, real)
    except BaseException:
        with suppress(OSError):
            raw.close()  # before its buffer, which would try to write the rest
        with suppress(OSError):
            if temporary:
                temporary.unlink()
        raise


def write(path: str | PathLike[str], data: bytes, *, name: str = "path", scratch: Path | None = None) -> None:
    """Write a file completely or not at all.

    Parameters
    ----------
    path : str or path-like
        File to write; it replaces an existing file.
    data : bytes
        Content.
    name : str
        Name of the argument, for the message.
    scratch : Path, optional
        Temporary file, see `replace_file`.

    Raises
    ------
    InvalidArgument
        If the path cannot be a file that this process may write.
    FileError
        If the system fails, for example because the disk is full.

    See Also
    --------
    files.replace_file : the same for content in pieces

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
    with replace_file(path, name=name, scratch=scratch) as file:
        file.write(data)


def write_table(path: str | PathLike[str], header: Sequence[str], columns: Sequence[Array]) -> None:
    """Write columns as CSV with 17 significant digits, which distinguish all float64 numbers.

    Parameters
    ----------
    path : str or path-like
        File to write; errors are those of `replace_file`.
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
    with replace_file(path) as file:
        titles = io.StringIO()
        csv.writer(titles, lineterminator="\n").writerow(header)  # quotes special characters of joint names
        file.write(titles.getvalue().encode())
        np.savetxt(file, np.column_stack(columns), fmt="%.17g", delimiter=",")


def check_form(given: str | int, expected: str | int) -> None:
    """Raise `ValueError` if a file has another format, or another version of it."""
    if given != expected:
        raise ValueError(f"its format is {given!r}, expected {expected!r}")


def check_match(path: str | PathLike[str], difference: str) -> None:
    """Raise `InvalidArgument` if a scenario differs from that of a file; the difference is "" if not."""
    if difference:
        raise InvalidArgument(f"scenario does not match {str(path)!r}: {difference}")


def check_suffix(name: str, path: Path, *suffixes: str) -> Path:
    """Return the path of a file that must have one of the suffixes, such as ``".gif"``."""
    if path.suffix.lower() not in suffixes:
        words = " or ".join(map(repr, suffixes))
        raise InvalidArgument(f"{name} is {str(path)!r}, expected a name that ends in {words}")
    return path


def write_file(path: str | PathLike[str], suffix: str, content: Callable[[], bytes]) -> Path:
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
    >>> from pinmobile.files import write_file
    >>> write_file("run.png", ".gif", lambda: b"")
    Traceback (most recent call last):
    ...
    pinmobile.errors.InvalidArgument: path is 'run.png', expected a name that ends in '.gif'
    """
    target = check_suffix("path", location("path", path), suffix)
    with replace_file(target) as file:
        with file_errors("made", "path", target):
            data = content()
        file.write(data)
    return target


@contextmanager
def file_errors(action: str, name: str, path: str | PathLike[str]) -> Iterator[None]:
    """Convert system errors within a ``with`` block to errors that name the file, see `file_error`.

    Parameters
    ----------
    action : str
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
    files.file_error : the error

    Examples
    --------
    >>> from pinmobile.files import file_errors
    >>> with file_errors("read", "path", "run.npz"):
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
        raise file_error(action, name, path, error) from error


def file_error(action: str, name: str, path: str | PathLike[str], error: OSError) -> PinmobileError:
    """Return the error of pinmobile for a system error about a file.

    Parameters
    ----------
    action : str
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
    files.file_errors : context manager that raises the error

    Examples
    --------
    >>> from pinmobile.files import file_error
    >>> error = OSError(5, "Input/output error")
    >>> file_error("read", "path", "run.npz", error)
    FileError("path is 'run.npz', which cannot be read: Input/output error")
    """
    reason, folder = error.strerror or str(error), Path(path).parent
    if action == "written" and error.errno in (errno.ENOENT, errno.ENOTDIR) and not folder.is_dir():
        reason = f"there is no folder {str(folder)!r}"
    message = f"{name} is {str(path)!r}, which cannot be {action}: {reason}"
    if error.errno in _PATH_ERRORS:
        return InvalidArgument(message)
    return FileError(message, errno=error.errno, filename=str(path))


def _real_target(path: Path) -> Path | None:
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


def _copy_mode(existing: Path, descriptor: int) -> None:
    """Give an open file the owner and the permissions of an existing file."""
    try:
        status = existing.stat()
    except FileNotFoundError:
        return
    with suppress(PermissionError):  # the file then belongs to the writer
        os.fchown(descriptor, status.st_uid, status.st_gid)
    os.fchmod(descriptor, stat.S_IMODE(status.st_mode))


_NAME = re.compile(r"[A-Za-z_][\w.]*", re.ASCII)


def write_archive(path: str | PathLike[str], form: str, content: Mapping[str, Any]) -> None:
    """Write content as a NumPy archive (``.npz``): arrays by their paths, everything else as JSON.

    Parameters
    ----------
    path : str or path-like
        File to write; errors are those of `replace_file`.
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
    description = json.dumps(_pack(dict(content), "", arrays))
    with replace_file(path) as file:
        np.savez(file, allow_pickle=False, format=form, description=description, **arrays)


def pack(value: object) -> str:
    """Return a value as JSON text, for `unpack`.

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
    files.unpack : the inverse

    Examples
    --------
    >>> from pinmobile import Circle
    >>> from pinmobile.files import pack, unpack
    >>> circle = Circle(1.0, 0.5, 4.0)
    >>> unpack(pack(circle)) == circle
    True
    """
    return json.dumps(_pack(value, "", None))


def unpack(text: str) -> Any:
    """Return the value of a text of `pack`.

    Parameters
    ----------
    text : str
        Text of `pack`.

    See Also
    --------
    files.pack : the inverse

    Examples
    --------
    >>> from pinmobile.files import pack, unpack
    >>> unpack(pack({"kp": (4.0, 9.0)}))
    {'kp': (4.0, 9.0)}
    """
    return _unpack(json.loads(text), {})


def _pack(value: Any, path: str, arrays: dict[str, Any] | None) -> Any:
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
        return [_pack(item, f"{path}.{k}", arrays) for k, item in enumerate(value)]
    if isinstance(value, Mapping):
        return {"mapping": [[key, _pack(x, _join(path, key), arrays)] for key, x in value.items()]}
    kind = type(value)
    name = f"{kind.__module__}:{kind.__qualname__}"
    if not _is_plain(kind):
        raise TypeError(f"{name} is not a class of pinmobile that a file can contain")
    if isinstance(value, Enum):
        return {"type": name, "member": value.name}
    data = {key: _pack(x, _join(path, key), None if attrs.has(kind) else arrays) for key, x in _state(value)}
    return {"type": name, "fields": data}


def _join(path: str, key: object) -> str:
    return f"{path}.{key}" if path else str(key)


def _is_plain(kind: Any) -> bool:
    """Return whether a class belongs to pinmobile and its objects consist of fields."""
    if not isinstance(kind, type) or not kind.__module__.startswith("pinmobile."):
        return False
    return dataclasses.is_dataclass(kind) or attrs.has(kind) or issubclass(kind, Enum | tuple)


_STORED: dict[Any, tuple[Callable[[Any], dict[str, Any]], Callable[..., Any]]] = {}


def keep(kind: type, values_of: Callable[[Any], dict[str, Any]], restore: Callable[..., Any]) -> None:
    """Register a class whose objects archives store by other values than its fields.

    Parameters
    ----------
    kind : type
        Class of pinmobile.
    values_of : callable
        Function that returns the stored values of an object by name.
    restore : callable
        Function of these values, as keyword arguments, that returns the object.

    See Also
    --------
    files.write_archive : write an archive

    Examples
    --------
    >>> from pinmobile.files import keep, pack, unpack
    >>> from pinmobile.signals import Signal
    >>> keep(Signal, Signal._asdict, Signal)
    >>> unpack(pack(Signal("N", 1.0)))
    Signal(unit='N', values=1.0)
    """
    _STORED[kind] = values_of, restore


def _state(value: Any) -> Iterable[tuple[str, Any]]:
    """Return the stored values of an object by name: its fields, or the values of `keep`."""
    if type(value) in _STORED:
        return _STORED[type(value)][0](value).items()
    if isinstance(value, tuple):
        return zip(value._fields, value, strict=True)  # type: ignore[attr-defined]
    if attrs.has(type(value)):
        return [(f.alias, getattr(value, f.name)) for f in attrs.fields(type(value)) if f.init]
    return [(f.name, getattr(value, f.name)) for f in dataclasses.fields(value) if f.init]


def _unpack(tree: Any, arrays: Mapping[str, Any]) -> Any:
    if isinstance(tree, list):
        return tuple(_unpack(item, arrays) for item in tree)
    if not isinstance(tree, dict):
        return tree
    if "array" in tree:
        return arrays[tree["array"]]
    if "numbers" in tree:
        return np.array(tree["numbers"], tree["dtype"]).reshape(tree["shape"])
    if "mapping" in tree:
        return {key: _unpack(item, arrays) for key, item in tree["mapping"]}
    module, _, name = tree["type"].partition(":")
    kind: Any = module.startswith("pinmobile.") and getattr(import_module(module), name)
    if not _is_plain(kind):
        raise ValueError(f"it has a {tree['type']}, expected a class of pinmobile")
    if "member" in tree:
        return kind[tree["member"]]
    fields = {key: _unpack(item, arrays) for key, item in tree["fields"].items()}
    return _STORED[kind][1](**fields) if kind in _STORED else kind(**fields)


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
        check_form(str(arrays["format"]), form)
        for array in arrays.values():
            array.setflags(write=False)
        return make(_unpack(json.loads(str(arrays["description"])), arrays))
    except OSError as error:
        raise file_error("read", "path", path, error) from error
    except Exception as error:  # zipfile and NumPy raise many errors for damaged files
        reason = f"it has no {error}" if isinstance(error, KeyError) else str(error) or type(error).__name__
        raise InvalidArgument(f"path is {str(path)!r}, which is not a {form!r} archive: {reason}") from error
