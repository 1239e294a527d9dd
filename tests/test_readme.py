"""The README's code runs and prints what it says; its figures and numbers are the library's."""

import contextlib
import io
import os
import re
import tomllib
from pathlib import Path

import pytest

import pinmobile
from pinmobile.cli.lecture import EXPECTED
from pinmobile.errors import ViewerError
from pinmobile.viewer.recording import find_chromium

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


@pytest.mark.once
@pytest.mark.long
def test_every_python_block_prints_what_follows_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "readme"}
    blocks = re.findall(r"```python\n(.*?)```(?:\n\n```text\n(.*?)```)?", README, re.DOTALL)
    assert len(blocks) > 2
    for code, printed in blocks:
        if "save_gif" in code and not has_chromium():
            continue
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            exec(code, names)
        assert out.getvalue() == printed
    assert (tmp_path / "circle.html").stat().st_size > 100_000
    assert (tmp_path / "tool.pdf").stat().st_size > 10_000
    assert (tmp_path / "tool.gif").exists() == has_chromium()


def has_chromium() -> bool:
    """Tell whether films can be made; CI must have what makes them."""
    try:
        find_chromium()
    except ViewerError:
        return os.environ.get("CI") == "true"
    return True


def test_every_picture_is_there() -> None:
    pictures = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", README)
    assert pictures
    for picture in pictures:
        assert (ROOT / picture).stat().st_size < 1_000_000


def test_every_link_into_the_project_leads_somewhere() -> None:
    links = re.findall(r"\]\((?!http)([^)]+)\)", README)
    assert len(links) > 4
    for link in links:
        assert (ROOT / link).exists(), link


def test_the_numbers_are_the_lectures() -> None:
    for trajectory in ("via stop", "via free", "circle"):
        row = [*EXPECTED[trajectory, "PD"], *EXPECTED[trajectory, "computed torque"]]
        assert f"| {trajectory} | {' | '.join(row)} |" in README


def test_the_names_it_mentions_exist() -> None:
    table = README.split("| ask | with |")[1].split("\n\n")[0]
    names = re.findall(r"`(?:pinmobile\.)?([A-Za-z_]\w+)", table)
    assert {"MobileRobot", "ComputedTorque", "simulate", "ensemble", "sweep"} < set(names)
    for name in names:
        modules = (getattr(pinmobile, module) for module in pinmobile._NAMES)
        assert name == "print" or hasattr(pinmobile, name) or any(hasattr(m, name) for m in modules), name


def test_the_pythons_it_names_are_the_projects() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert "Python 3.11 to 3.13" in README
    assert project["requires-python"] == ">=3.11,<3.14"


def test_every_make_target_it_names_is_there() -> None:
    makefile = (ROOT / "Makefile").read_text()
    targets = set(re.findall(r"make (\w+)", README))
    assert {"demo", "test"} <= targets
    for target in targets:
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target
