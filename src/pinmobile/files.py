"""Files written whole or not at all, archives looked at before they are read, and what refuses either."""

from __future__ import annotations

import csv
import errno
import io
import json
import os
import stat
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from os import PathLike
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from pinmobile.arrays import Array, location
from pinmobile.errors import FileError, InvalidArgument, PinmobileError

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer

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


def archive_of(
    path: Path, form: str, description: str, kinds: Mapping[str, type]
) -> tuple[dict[str, Any], Any]:
    """Return the arrays of an archive that says its format, and what it says of itself beside them.

    Parameters
    ----------
    path : Path
        The file; its checksums tell whether it is damaged.
    form : str
        What its array ``format`` says.
    description : str
        Name of the array that holds the description, as JSON.
    kinds : mapping of str to type
        All other arrays, and the type of their numbers.

    Raises
    ------
    InvalidArgument
        If it cannot be read, is damaged, or holds something else.
    FileError
        If the system fails.
    """
    wanted = {"format", description, *kinds}
    try:
        with refusals("read", "path", path), path.open("rb") as file:
            if not zipfile.is_zipfile(file):  # else NumPy advises to load what may run code
                raise ValueError("it is no .npz file, or its end is lost")
            file.seek(0)
            with np.load(file) as archive:
                named = {name: archive[name] for name in wanted & set(archive)}
        other = str(named["format"])
        if other != form:
            raise ValueError(f"it is of another format, {other!r}")
        missing = sorted(wanted - named.keys())
        if missing:
            raise ValueError(f"it has no {', '.join(missing)}")
        del named["format"]
        described = json.loads(str(named.pop(description)))
        return {name: np.asarray(named[name], kind, order="C") for name, kind in kinds.items()}, described
    except PinmobileError:
        raise
    except Exception as error:  # whatever the bytes of a damaged file lead zipfile and NumPy to
        why = str(error) or type(error).__name__
        raise InvalidArgument(f"path is {str(path)!r}, which is no {form!r} archive: {why}") from error
