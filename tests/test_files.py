"""What is written is there whole or not at all, whatever the system does in between."""

import errno
import os
import stat
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import pinmobile as pm
from pinmobile import plots
from pinmobile.cli.output import Section, index_page, save_figure
from pinmobile.errors import FileError
from pinmobile.files import replace_file, write
from pinmobile.loop import Engine
from pinmobile.viewer import Recording, Viewer
from tests.damage import full_disk
from tests.refusals import refused

ROBOT = pm.MobileRobot.lecture()
LOOP: Any = (ROBOT, pm.PD((120, 120, 0.4), (120, 120, 0.4)), pm.Tangent(pm.Circle(3, 0.1, 6)))
RUN = pm.simulate(*LOOP, dt=0.1)
ROBOTS = pm.ensemble(*LOOP, n=30, spread={"mass": pm.Uniform(8, 12)}, dt=0.1, engine=Engine.COMPILED)


def recording() -> Recording:
    with Viewer(ROBOT) as viewer:
        return viewer.record(RUN)


WRITERS: dict[str, Callable[[Path], object]] = {
    "run.npz": RUN.save,
    "run.csv": RUN.to_csv,
    "robots.npz": ROBOTS.save,
    "robots.csv": ROBOTS.to_csv,
    "page.html": lambda path: recording().save_html(path),
    "moving.gif": lambda path: plots.animate(RUN, path, fps=2),
    "film.gif": lambda path: recording().save_gif(path),
    "film.mp4": lambda path: recording().save_mp4(path),
    "still.png": lambda path: recording().screenshot(path),
    "figure.png": lambda path: save_figure(plots.path(RUN), path),
    "index.html": lambda path: index_page(path.parent, "title", [Section("text", "x" * 2000)]),
}


@pytest.fixture(autouse=True)
def without_chromium(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a browser draws is another test's; here something of a good size is enough."""
    for name in ("gif", "film", "take_picture"):
        monkeypatch.setattr(f"pinmobile.viewer.recording.{name}", lambda *_: b"picture" * 1000)


def held(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_leaves_the_file_that_was_there(tmp_path: Path, name: str) -> None:
    WRITERS[name](tmp_path / name)  # what it needs for the first time has files of its own
    (tmp_path / name).write_bytes(b"good")
    with full_disk(1000), pytest.raises(FileError) as caught:
        WRITERS[name](tmp_path / name)
    assert str(caught.value) == f"path is {str(tmp_path / name)!r}, which cannot be written: File too large"
    assert (caught.value.errno, caught.value.filename) == (errno.EFBIG, str(tmp_path / name))
    assert held(tmp_path) == {name: b"good"}
    (tmp_path / name).unlink()
    with full_disk(0), pytest.raises(FileError, match=name):
        WRITERS[name](tmp_path / name)
    assert held(tmp_path) == {}


@pytest.mark.parametrize("failure", [KeyboardInterrupt, MemoryError])
def test_a_write_that_ends_leaves_the_file_that_was(tmp_path: Path, failure: type[BaseException]) -> None:
    write(tmp_path / "file", b"good")

    def stop(done: int, total: int) -> None:
        raise failure

    def begin_and_stop() -> None:
        with replace_file(tmp_path / "file") as file:
            file.write(b"x" * 100_000)
            raise failure

    (tmp_path / "moving.gif").write_bytes(b"good")
    with pytest.raises(failure):
        plots.animate(RUN, tmp_path / "moving.gif", progress=stop)
    with pytest.raises(failure):
        begin_and_stop()
    assert held(tmp_path) == {"file": b"good", "moving.gif": b"good"}


@contextmanager
def umask(mask: int) -> Iterator[None]:
    before = os.umask(mask)
    try:
        yield
    finally:
        os.umask(before)


def permissions(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_permissions_are_those_that_open_gives(tmp_path: Path) -> None:
    with umask(0o027):
        RUN.save(tmp_path / "run.npz")
        (tmp_path / "plain").write_bytes(b"")
    assert permissions(tmp_path / "run.npz") == permissions(tmp_path / "plain") == 0o640
    (tmp_path / "run.npz").chmod(0o604)
    RUN.save(tmp_path / "run.npz")
    assert permissions(tmp_path / "run.npz") == 0o604


def test_a_link_stays_and_what_it_leads_to_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "file").write_bytes(b"old")
    (tmp_path / "link").symlink_to("there/file")
    (tmp_path / "further").symlink_to(tmp_path / "link")
    write(tmp_path / "further", b"new")
    assert (tmp_path / "there" / "file").read_bytes() == b"new"
    (tmp_path / "ahead").symlink_to("there/made")  # to nothing yet
    write(tmp_path / "ahead", b"made")
    assert held(tmp_path / "there") == {"file": b"new", "made": b"made"}
    assert all((tmp_path / name).is_symlink() for name in ("link", "further", "ahead"))
    (tmp_path / "round").symlink_to("round")
    with refused("round', which cannot be written: Too many levels of symbolic"):
        write(tmp_path / "round", b"")


def test_pipes_and_the_console_are_written_to_as_they_are(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    read: list[bytes] = []
    reader = threading.Thread(target=lambda: read.append((tmp_path / "pipe").read_bytes()))
    reader.start()
    RUN.to_csv(tmp_path / "pipe")
    reader.join()
    RUN.to_csv(tmp_path / "run.csv")
    assert read == [(tmp_path / "run.csv").read_bytes()]
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)
    code = "from pinmobile.files import write; write('/dev/stdout', b'x' * 100_000); print('after')"
    words = [sys.executable, "-c", code]
    assert subprocess.run(words, stdout=subprocess.PIPE, check=True, timeout=600).stdout.endswith(b"xafter\n")
    with (tmp_path / "out").open("wb") as out:
        subprocess.run(words, stdout=out, check=True, timeout=600)
        # As `open` does it: the process's own place in the file is still at its beginning.
        assert (tmp_path / "out").read_bytes() == b"after\n" + b"x" * (100_000 - 6)
        assert os.fstat(out.fileno()).st_ino == (tmp_path / "out").stat().st_ino


def test_of_two_that_write_at_once_one_is_whole(tmp_path: Path) -> None:
    contents = [bytes([k]) * 300_000 for k in range(8)]
    threads = [threading.Thread(target=write, args=(tmp_path / "file", data)) for data in contents]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert list(held(tmp_path)) == ["file"]
    assert (tmp_path / "file").read_bytes() in contents


def test_where_no_file_can_be_is_no_failure_of_the_system(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    nothing = {f"{name}/file": f"there is no folder '.*{name}'" for name in ("nowhere", "file")}
    for name, why in (nothing | {"folder": "Is a directory"}).items():
        with refused(f"^path is '.*', which cannot be written: {why}$"):
            RUN.save(tmp_path / name)
        for load in (pm.Rollout.load, pm.Ensemble.load):
            with refused(r"^path is '.*', which cannot be read: "):
                load(tmp_path / name)
