"""Files of machine code: found again, and nothing that is wrong with them is the user's."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pinmobile.compiled import Cache, Target, processor
from tests.test_compiled_loop import COMPOSITIONS, built, ran

NAME = "computed torque"


def forget() -> None:
    processor._known.clear()


def results(cache: Cache) -> np.ndarray:
    forget()
    parts = COMPOSITIONS[NAME]()
    return np.asarray(ran(built(parts, cache=cache), parts, 5).counts)


def test_what_is_built_is_found_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    results(Cache(tmp_path / "deep" / "er"))
    (file,) = (tmp_path / "deep" / "er").iterdir()
    monkeypatch.setattr(Target, "build", lambda self, text: pytest.fail("built again"))
    results(Cache(tmp_path / "deep" / "er"))
    assert file.suffix == ".o"


@pytest.mark.parametrize("damage", [lambda b: b[: len(b) // 2], lambda b: b"", lambda b: b[:-1] + b"?"])
def test_a_damaged_file_is_built_again(tmp_path: Path, damage: object) -> None:
    cache = Cache(tmp_path)
    results(cache)
    (file,) = tmp_path.iterdir()
    whole = file.read_bytes()
    file.write_bytes(damage(whole))  # type: ignore[operator]
    results(cache)
    assert file.read_bytes() == whole


def test_where_nothing_can_be_written_it_is_built(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    results(Cache(blocked / "inside"))
    assert blocked.read_text() == ""


def test_a_file_of_another_user_is_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = Cache(tmp_path)
    cache.write("key", b"code")
    assert cache.read("key") == b"code"
    monkeypatch.setattr(os, "getuid", lambda: 12345678)
    assert cache.read("key") is None


def test_swapped_files_are_not_run(tmp_path: Path) -> None:
    cache = Cache(tmp_path)
    for key, kind in (("one", ".o"), ("other", ".o"), ("one", ".loop")):
        cache.write(key, f"{key} {kind}".encode(), kind)
    contents = [(tmp_path / name).read_bytes() for name in ("one.o", "other.o", "one.loop")]
    for name, content in zip(("other.o", "one.loop", "one.o"), contents, strict=True):
        (tmp_path / name).write_bytes(content)
    assert [cache.read("one"), cache.read("other"), cache.read("one", ".loop")] == [None, None, None]
    (tmp_path / "one.o").write_bytes(contents[0])
    assert cache.read("one") == b"one .o"


@pytest.mark.parametrize("mode", [0o770, 0o702, None])
def test_a_folder_that_others_may_write_to_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: int | None
) -> None:
    Cache(tmp_path).write("key", b"code")
    if mode is None:
        monkeypatch.setattr(os, "getuid", lambda: 12345678)
    else:
        tmp_path.chmod(mode)
    with pytest.warns(UserWarning, match=f"^the folder of machine code '{tmp_path}' is not used"):
        Cache(tmp_path)
    cache = Cache(tmp_path)  # of which nothing more is said
    assert cache.read("key") is None
    cache.write("other", b"code")
    assert [each.name for each in tmp_path.iterdir()] == ["key.o"]


def test_the_key_is_of_text_and_processor() -> None:
    one = Target("haswell", "", 4)
    assert one.key("text") != one.key("text ")
    assert one.key("text") != Target("haswell", "-avx2", 4).key("text")
    assert one.key("text") != Target("znver3", "", 4).key("text")


def test_the_folder_is_thinned_and_leaves_no_halves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pinmobile.compiled.processor._MOST", 8)
    cache = Cache(tmp_path)
    for i in range(40):
        cache.write(f"key{i}", b"code")
    assert len(list(tmp_path.iterdir())) <= 8
    assert cache.read("key39") == b"code"
    monkeypatch.setattr(os, "replace", lambda *_: (_ for _ in ()).throw(OSError("full")))
    cache.write("late", b"code")
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.parametrize("home", [None, "/nonexistent"])
def test_a_machine_without_home_builds(home: str | None) -> None:
    code = (
        "from tests.test_compiled_loop import COMPOSITIONS, built, ran; from pinmobile.compiled import Cache;"
        f"p = COMPOSITIONS[{NAME!r}](); ran(built(p, cache=Cache()), p, 3); print('fine')"
    )
    kept = {name: value for name, value in os.environ.items() if name not in ("HOME", "XDG_CACHE_HOME")}
    environment = kept if home is None else kept | {"HOME": home}
    environment |= {"PINMOBILE_CACHE": "/proc/nothing"} if home is None else {}
    root = Path(__file__).parents[1]
    words = [sys.executable, "-c", code]
    done = subprocess.run(words, env=environment, cwd=root, capture_output=True, text=True, check=False)
    assert done.stdout == "fine\n", done.stderr


def test_the_environment_names_the_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PINMOBILE_CACHE", str(tmp_path))
    assert Cache().folder == tmp_path
    monkeypatch.setenv("PINMOBILE_CACHE", "")
    assert Cache().folder is None
