"""Each page of the documentation is one program that runs alone and prints what the page says."""

import contextlib
import io
import re
from pathlib import Path

import matplotlib
import numpy as np
import pytest

from pinmobile.cli.scenario_file import LoadedFile

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
            out = io.StringIO()
            with contextlib.redirect_stdout(out):
                exec(compile(code, page, "exec"), names)
            assert out.getvalue() == printed


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
