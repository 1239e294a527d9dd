"""Files of tapes and machine code, so that a loop that was built once is read in some milliseconds."""

import contextlib
import hashlib
import os
import sys
import tempfile
from pathlib import Path

__all__ = ["CODE", "LOOP", "Cache"]

CODE, LOOP = ".o", ".loop"
"""Endings of files."""

_MAGIC = b"pinmobile object 1\n"
_MOST = 512  # files of 5 to 200 kB


class Cache:
    """A folder of machine code and loops by key.

    Nothing that goes wrong in it is an error: what is not found is made.

    Parameters
    ----------
    folder : path, optional
        Where they are. By default the environment's ``PINMOBILE_CACHE``, else ``pinmobile`` in the user's
        folder for such files; an empty name, or a place where nothing can be written, means none.
    """

    def __init__(self, folder: str | os.PathLike[str] | None = None) -> None:
        self.folder = _default() if folder is None else Path(folder) if os.fspath(folder) else None

    def read(self, key: str, kind: str = CODE) -> bytes | None:
        """Return what a key has; None where there is none, or it is damaged or somebody else's."""
        if self.folder is None:
            return None
        try:
            with self._file(key, kind).open("rb") as file:
                if hasattr(os, "getuid") and os.fstat(file.fileno()).st_uid != os.getuid():
                    return None  # code that another user could write is not run
                found = file.read()
        except OSError:
            return None
        head, code = found[: len(_MAGIC) + 32], found[len(_MAGIC) + 32 :]
        return code if head == _MAGIC + hashlib.sha256(code).digest() else None

    def write(self, key: str, code: bytes, kind: str = CODE) -> None:
        """Keep what a key has, all of it or nothing."""
        if self.folder is None:
            return
        with contextlib.suppress(OSError):
            self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._thin()
            handle, name = tempfile.mkstemp(dir=self.folder, suffix=".part")
            try:
                with os.fdopen(handle, "wb") as file:
                    file.write(_MAGIC + hashlib.sha256(code).digest() + code)
                os.replace(name, self._file(key, kind))
            except BaseException:
                with contextlib.suppress(OSError):
                    os.unlink(name)
                raise

    def _file(self, key: str, kind: str) -> Path:
        assert self.folder is not None
        return self.folder / f"{key}{kind}"

    def _thin(self) -> None:
        """Remove the oldest files where there are too many."""
        assert self.folder is not None
        files = [entry for entry in os.scandir(self.folder) if entry.name.endswith((CODE, LOOP, ".part"))]
        if len(files) >= _MOST:
            for entry in sorted(files, key=lambda entry: entry.stat().st_mtime)[: _MOST // 4]:
                with contextlib.suppress(OSError):
                    os.unlink(entry.path)


def _default() -> Path | None:
    given = os.environ.get("PINMOBILE_CACHE")
    if given is not None:
        return Path(given) if given else None
    try:
        if sys.platform == "darwin":
            return Path.home() / "Library" / "Caches" / "pinmobile"
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    except RuntimeError:  # nobody's home
        return None
    return Path(base) / "pinmobile"
