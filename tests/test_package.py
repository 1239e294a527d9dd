"""What is released: one version everywhere, a source distribution that has all, a README that is whole."""

import importlib.util
import re
import subprocess
import sys
import tarfile
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

import pinmobile

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
README = (ROOT / "README.md").read_text()
RELATIVE = re.compile(r"\]\((?!https?:)[^)]*\)")


def outside() -> Callable[[str, str | None], str]:
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.outside  # type: ignore[no-any-return]


def test_version_and_date_are_the_same_everywhere() -> None:
    version, date = re.findall(
        r"^## \[([\d.]+)\] - ([\d-]+)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE
    )[0]
    assert version == pinmobile.__version__
    citation = dict(re.findall(r"^([\w-]+): (.+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE))
    assert (citation["version"], citation["date-released"]) == (version, date)
    assert citation["license"] == PROJECT["project"]["license"]
    (author,) = PROJECT["project"]["authors"]
    assert f"- name: {author['name']}\n" in (ROOT / "CITATION.cff").read_text()
    assert author["name"].lower().removeprefix("the ") in (ROOT / "LICENSE").read_text()


@pytest.mark.once
def test_the_source_distribution_has_all_that_it_takes_to_show_and_test_it(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "build", "--sdist", "--no-isolation", "--outdir", str(tmp_path), str(ROOT)]
    subprocess.run(words, check=True, capture_output=True, timeout=300)
    (path,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(path) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
        text = archive.extractfile(f"pinmobile-{pinmobile.__version__}/PKG-INFO")
        assert text is not None
        metadata = text.read().decode()
    folders = (".ci", ".github", "benchmarks", "docs", "examples", "models", "notebooks", "src", "tests")
    kept = [path for folder in folders for path in (ROOT / folder).rglob("*") if path.is_file()]
    wanted = {path.relative_to(ROOT).as_posix() for path in kept if "__pycache__" not in path.parts}
    alone = {path.name for path in ROOT.iterdir() if path.is_file() and path.name[:1] != "."}
    assert not wanted - names
    assert {*alone, "hatch_build.py", ".pre-commit-config.yaml", ".readthedocs.yaml", ".gitignore"} <= names
    assert not [name for name in names if "__pycache__" in name or name.startswith(("out/", ".venv/"))]
    assert not RELATIVE.findall(metadata)
    assert "# pinmobile\n" in metadata


def test_the_readme_of_a_distribution_needs_no_files_beside_it() -> None:
    assert RELATIVE.findall(README)
    bare = outside()(README, None)
    assert not RELATIVE.findall(bare)
    assert "[corrects its errors" not in bare
    assert "corrects its errors (`docs/site/explain/errata.md`)" in bare
    assert "recorded by" not in bare, "what stands below a picture goes with it"
    linked = outside()(README, "https://example.org/blob/v1/")
    assert not RELATIVE.findall(linked)
    assert "](https://example.org/raw/v1/docs/ur5.gif)\\\nA UR5 on its base" in linked
    assert "](https://example.org/blob/v1/docs/site/explain/errata.md)" in linked
    for block in re.findall(r"```.*?```", README, re.DOTALL):
        assert block in bare
        assert block in linked


def test_the_hooks_run_what_lint_runs() -> None:
    hooks = (ROOT / ".pre-commit-config.yaml").read_text()
    makefile = (ROOT / "Makefile").read_text()
    for tool in ("ruff check", "ruff format", "mypy"):
        assert f"entry: .venv/bin/{tool}" in hooks
        assert f"$(BIN)/{tool}" in makefile
    assert "http" not in hooks
