"""The README's code runs and prints what it says; its figures and numbers are the library's."""

import contextlib
import io
import re
import tomllib
from pathlib import Path

import pinmobile

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def test_every_python_block_prints_what_follows_it() -> None:
    names: dict[str, object] = {"__name__": "readme"}
    blocks = re.findall(r"```python\n(.*?)```\n\n```text\n(.*?)```", README, re.DOTALL)
    assert len(blocks) == README.count("```python")
    for code, printed in blocks:
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            exec(code, names)
        assert out.getvalue() == printed


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
