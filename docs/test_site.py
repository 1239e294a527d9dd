"""The built site in a browser: `make docs-test`. No error, no request, readable by everybody (WCAG 2 AA)."""

import json
import os
import re
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

import pytest
from tests.chromium import Chromium, Page, chromium

SITE = Path(os.environ.get("SITE", Path(__file__).parents[1] / "out" / "site")) / "html"
EXAMPLES = Path(__file__).parents[1] / "examples"
KINDS = (
    "index",
    "start/first-run",
    "tutorials/index",
    "tutorials/01_from_table_to_equations",
    "tutorials/exercises",
    "howto/index",
    "howto/wheels",
    "explain/errata",
    "gallery/index",
    "gallery/plot_circle",
    "reference/index",
    "reference/controllers",
    "reference/generated/pinmobile.PD",
    "reference/generated/pinmobile.MobileRobot",
    "reference/tables",
    "reference/command",
    "about/changelog",
    "search",
)
AXE = """axe.run({runOnly: ['wcag2a', 'wcag2aa']}).then(found => JSON.stringify(
    found.violations.map(each => [each.id, each.nodes.map(one => one.html)])))"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Chromium]:
    with chromium() as started:
        yield started


@pytest.fixture
def page(browser: Chromium) -> Iterator[Page]:
    page = browser.page(1200, 800)
    yield page
    page.close()


def opened(page: Page, name: str, query: str = "") -> None:
    """Open a page of the site; wait until its formulas are drawn."""
    path = SITE / f"{name}.html"
    assert path.exists(), "build the site first: make docs"
    page.open(path.as_uri() + query)
    page.wait_for("document.readyState == 'complete'")
    page.evaluate("window.MathJax && MathJax.startup ? MathJax.startup.promise : 0")


def foreign(page: Page) -> list[str]:
    """Return the requests that leave the site."""
    return [
        each for each in page.requests if not each.startswith((SITE.as_uri(), "data:", "blob:", "about:"))
    ]


@pytest.mark.parametrize("name", KINDS)
def test_a_page_of_each_kind_is_whole_and_readable_by_everybody(page: Page, name: str) -> None:
    opened(page, name)
    assert page.errors == []
    assert [each for each in page.console if each.startswith(("error", "warning"))] == []
    assert foreign(page) == []
    assert page.evaluate("document.querySelectorAll('mjx-merror').length") == 0
    page.evaluate(files("axe_core_python").joinpath("axe.min.js").read_text() + "; 0")
    assert json.loads(page.evaluate(AXE)) == []


@pytest.mark.parametrize(
    ("words", "found"), [("mass matrix", "MobileRobot"), ("ComputedTorque", "ComputedTorque")]
)
def test_search_works_from_files(page: Page, words: str, found: str) -> None:
    opened(page, "search", f"?q={words.replace(' ', '+')}")
    # The list grows while the search goes on.
    page.wait_for("document.querySelector('#search-results h2').textContent != 'Searching'")
    assert found in page.evaluate("document.querySelector('#search-results').innerText")


def test_a_recording_plays_when_it_is_asked_to_and_loads_nothing_before(page: Page) -> None:
    opened(page, "index")
    assert not [each for each in page.requests if each.endswith("circle.html")]
    page.evaluate("document.querySelector('.recording button').click()")
    page.wait_for("document.querySelector('.recording iframe') != null")
    page.frames(5)
    assert page.errors == []
    assert foreign(page) == []


@pytest.mark.parametrize(
    "name", ["index", "tutorials/01_from_table_to_equations", "reference/generated/pinmobile.PD"]
)
def test_pages_fit_a_narrow_screen(page: Page, name: str) -> None:
    page.resize(400, 800)
    opened(page, name)
    assert page.evaluate("document.documentElement.scrollWidth") <= 400


@pytest.mark.parametrize("script", sorted(EXAMPLES.glob("plot_*.py")), ids=lambda path: path.stem)
def test_a_script_of_the_gallery_prints_and_shows_something(script: Path) -> None:
    text = (SITE / "gallery" / f"{script.stem}.html").read_text()
    printed = re.findall(r'"sphx-glr-script-out.*?<pre>(.*?)</pre>', text, re.DOTALL)
    assert 1 <= len("".join(printed).strip().splitlines()) <= 3
    assert 'class="sphx-glr-single-img"' in text


def test_the_scripts_of_the_gallery_write_nothing_beside_them() -> None:
    assert {path.suffix for path in EXAMPLES.iterdir() if path.is_file()} == {".py", ".rst", ".urdf"}
