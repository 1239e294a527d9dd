"""The notebooks run, check their claims, and are in step with their sources; what they carry can be read."""

import os
import re
import runpy
import subprocess
import sys
from collections.abc import Iterator
from html import unescape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import jupytext
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
from IPython.core.interactiveshell import InteractiveShell
from IPython.utils.capture import capture_output
from nbconvert import HTMLExporter
from traitlets.config import Config

from pinmobile.errors import ViewerError
from pinmobile.viewer.recording import find_chromium
from tests.chromium import Chromium

SOURCES = sorted((Path(__file__).parents[1] / "notebooks").glob("[0-9][0-9]_*.py"))
each = pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)


def stored(source: Path) -> Any:
    return jupytext.read(source.with_suffix(".ipynb"))


def outputs(notebook: Any) -> list[Any]:
    return [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]


def figures(found: list[Any]) -> list[Any]:
    return [output for output in found if "image/png" in output.get("data", {})]


def pictures_expected() -> int:
    """Return how many pictures the viewer's notebook has: without a Chromium, which CI must have, one."""
    if os.environ.get("CI") != "true":
        try:
            find_chromium()
        except ViewerError:
            return 1
    return len(figures(outputs(stored(VIEWING))))


@pytest.fixture(scope="module")
def executed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the notebook about the viewer, executed by nbconvert."""
    folder = tmp_path_factory.mktemp("executed")
    screen = ("DISPLAY", "WAYLAND_DISPLAY", "MPLBACKEND")
    screenless = {name: value for name, value in os.environ.items() if name not in screen}
    words = [sys.executable, "-m", "nbconvert", "--to", "notebook", "--output-dir", str(folder), "--execute"]
    words += [str(VIEWING.with_suffix(".ipynb"))]
    words += ["--ExecutePreprocessor.coalesce_streams=True"]  # a slow kernel sends a line in parts
    with TemporaryDirectory() as short:  # a short path; TCP ports are taken by others now and then
        words += ["--KernelManager.transport=ipc", f"--KernelManager.ip={short}/kernel"]
        done = subprocess.run(words, env=screenless, capture_output=True, text=True, check=False, timeout=900)
    assert done.returncode == 0, done.stderr
    return folder / VIEWING.with_suffix(".ipynb").name


def test_every_notebook_has_its_source() -> None:
    assert len(SOURCES) >= 5
    notebooks = (Path(__file__).parents[1] / "notebooks").glob("*.ipynb")
    assert sorted(path.with_suffix(".py") for path in notebooks) == SOURCES


@each
def test_the_notebook_has_the_cells_of_its_source(source: Path) -> None:
    first, second = (
        [(cell.cell_type, cell.source) for cell in notebook.cells]
        for notebook in (jupytext.read(source), stored(source))
    )
    assert first == second, "run `make notebooks`"


@each
def test_the_notebook_can_be_read_without_running_it(source: Path) -> None:
    assert source.with_suffix(".ipynb").stat().st_size < 500_000
    notebook = stored(source)
    counts = [cell.execution_count for cell in notebook.cells if cell.cell_type == "code"]
    assert counts == list(range(1, len(counts) + 1))
    found = outputs(notebook)
    assert not [output for output in found if output.output_type == "error" or output.get("name") == "stderr"]
    assert figures(found)
    assert found[-1].text.splitlines()[-1].startswith("Shown: ")
    texts = "".join(
        str(output.get("text", "")) + output.get("data", {}).get("text/plain", "") for output in found
    )
    assert not [folder for folder in ("/home/", "/root/", "/tmp/", "/Users/") if folder in texts]


VIEWING = next(source for source in SOURCES if source.stem == "05_viewing")


@pytest.mark.once
@pytest.mark.long
def test_nbconvert_executes_a_notebook_without_a_screen_and_a_warning(executed: Path) -> None:
    again = outputs(jupytext.read(executed))
    assert not [output for output in again if output.get("name") == "stderr"]
    assert again[-1].text.splitlines()[-1].startswith("Shown: ")
    assert len(figures(again)) == pictures_expected()


@pytest.fixture
def shell(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Return IPython's shell as a kernel has it, figures inline, but in this process: a kernel takes 6 s."""
    monkeypatch.chdir(SOURCES[0].parent)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(InteractiveShell, "enable_gui", lambda *_: None)
    InteractiveShell.clear_instance()
    with matplotlib.rc_context(), np.printoptions():
        made: Any = InteractiveShell.instance(config=Config(HistoryManager={"enabled": False}))
        made.enable_matplotlib("inline")
        yield made
        plt.close("all")
        made.enable_matplotlib("agg")
    InteractiveShell.clear_instance()


@pytest.mark.once
@pytest.mark.long
@pytest.mark.parametrize(
    "source", [source for source in SOURCES if source != VIEWING], ids=lambda path: path.stem
)
def test_it_runs_without_a_warning_and_its_claim_holds(source: Path, shell: Any) -> None:
    pictures = 0
    for cell in jupytext.read(source).cells:
        if cell.cell_type == "code":
            with capture_output() as made:
                shell.run_cell(cell.source).raise_error()
            assert not made.stderr
            pictures += sum("image/png" in shown.data for shown in made.outputs)
    assert made.stdout.splitlines()[-1].startswith("Shown: ")
    assert pictures == len(figures(outputs(stored(source))))


@pytest.mark.once
@pytest.mark.long
def test_the_scene_moves_in_the_converted_page(executed: Path, browser: Chromium, tmp_path: Path) -> None:
    scene = 'class="scene"'
    (cell,) = (cell for cell in stored(VIEWING).cells if "scene" in cell.metadata.get("tags", ()))
    (output,) = cell.outputs
    assert set(output.data) == {"image/png", "text/plain"}
    page = tmp_path / "viewing.html"
    text, _ = HTMLExporter().from_filename(str(executed))  # type: ignore[no-untyped-call]
    page.write_text(text, encoding="utf-8")
    (frame,) = re.findall(r"<iframe [^>]*>", text)
    assert scene in frame
    for part in ("pinmobile.play(", "meshcat/robot0", "meshcat/robot1", "computed torque"):
        assert part in unescape(frame)
    opened = browser.page(900, 700)
    # What the template wants of the network is not ours, and must not be waited for.
    opened.call("Network.setBlockedURLs", urls=["http://*", "https://*"])
    opened.open(page.as_uri())
    opened.wait_for("frames.length == 1 && !!frames[0].pinmobile && frames[0].pinmobile.ready()")
    opened.evaluate("document.querySelector('iframe.scene').scrollIntoView()")
    # The page's policy lets nobody evaluate text in it, not even us.
    opened.wait_for_changes("Number(frames[0].document.querySelector('input[type=range]').value)", 1)
    asked = [url for url in opened.requests if not url.startswith(("data:", "blob:", "file:", "about:"))]
    ours = [url for url in asked if "//cdnjs.cloudflare.com/" not in url]
    assert not ours
    opened.frames()
    assert opened.screenshot().getcolors(50) is None  # something is drawn
    opened.close()


def test_without_a_chromium_it_runs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PINMOBILE_CHROMIUM", "no-such-program")
    with matplotlib.rc_context(), np.printoptions():
        runpy.run_path(str(VIEWING))
    plt.close("all")
    said = capsys.readouterr().out
    assert said.count("No picture: PINMOBILE_CHROMIUM is 'no-such-program'") == 3
    assert said.splitlines()[-1].startswith("Shown: ")
