"""README and pages of the documentation: their code prints what they say; links and numbers are right."""

import contextlib
import io
import re
import tomllib
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest

import pinmobile
from pinmobile.cli.scenario_file import LoadedFile

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def output(code: Any, names: dict[str, object]) -> str:
    """Run code and return what it prints."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        exec(code, names)
    return out.getvalue()


def test_every_python_block_prints_what_follows_it() -> None:
    names: dict[str, object] = {"__name__": "readme"}
    blocks = re.findall(r"```python\n(.*?)```\n\n```text\n(.*?)```", README, re.DOTALL)
    assert len(blocks) == README.count("```python")
    for code, printed in blocks:
        assert output(code, names) == printed


def test_it_is_short() -> None:
    assert len(README.splitlines()) <= 150
    assert len(table()) <= 15


def table() -> list[str]:
    """Return the rows of the table of capabilities."""
    return README.split("| task | call | page |\n|---|---|---|\n")[1].split("\n\n")[0].splitlines()


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


def test_the_names_it_mentions_exist() -> None:
    names = re.findall(r"`(?:pinmobile\.)?([A-Za-z_]\w+)", "\n".join(table()))
    assert {"MobileRobot", "ComputedTorque", "simulate", "ensemble", "sweep"} < set(names)
    for name in names:
        modules = (getattr(pinmobile, module) for module in pinmobile._NAMES)
        assert (
            name in ("pinmobile", "robot")
            or hasattr(pinmobile, name)
            or any(hasattr(m, name) for m in modules)
        ), name


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


# -- each page of the documentation is one program that runs alone and prints what the page says ---


SITE = Path(__file__).parents[1] / "docs" / "site"
PAGES = {
    path.relative_to(SITE).as_posix(): path.read_text(encoding="utf-8")
    for folder in ("start", "howto", "explain", "reference", "about")
    for path in sorted((SITE / folder).glob("*.md"))
}
BLOCK = re.compile(r"^```python\n(.*?)^```\n(?:\n```text\n(.*?)^```\n)?", re.DOTALL | re.MULTILINE)
FENCE = re.compile(r"^```(?:python|sh|toml)\n(.*?)^```\n", re.DOTALL | re.MULTILINE)
BUILT = ("../index.md", "index.md", "../gallery/", "../tutorials/")
"""What the build of the site puts beside the pages."""


@pytest.mark.once
@pytest.mark.long
@pytest.mark.parametrize("page", [page for page, text in PAGES.items() if BLOCK.search(text)])
def test_a_page_prints_what_it_says(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names: dict[str, object] = {"__name__": "page"}
    with np.printoptions(), matplotlib.rc_context():
        for code, printed in BLOCK.findall(PAGES[page]):
            assert output(compile(code, page, "exec"), names) == printed


@pytest.mark.parametrize("page", PAGES)
def test_a_page_is_well_formed(page: str) -> None:
    text = PAGES[page]
    assert text.startswith("# ")
    assert text.count("\n```") % 2 == 0
    for code in FENCE.findall(text):
        assert max(map(len, code.splitlines())) <= 88
    prose = re.sub(r"^```.*?^```\n", "", text, flags=re.DOTALL | re.MULTILINE)
    for link in re.findall(r"\]\((?!https?://|#)([^)#]+)(?:#[^)]*)?\)", prose):
        assert (
            link.startswith(BUILT)
            or link.endswith("/index.md")
            or (SITE / page).parent.joinpath(link).is_file()
        ), link


@pytest.mark.parametrize("page", [page for page, text in PAGES.items() if "```toml" in text])
def test_a_scenario_on_a_page_is_one(page: str, tmp_path: Path) -> None:
    for k, text in enumerate(re.findall(r"^```toml\n(.*?)^```\n", PAGES[page], re.DOTALL | re.MULTILINE)):
        if "mine:" in text:
            continue
        file = tmp_path / f"{k}.toml"
        file.write_text(text)
        assert LoadedFile([str(file)]).to_toml()
