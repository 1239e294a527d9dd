"""The notebooks run, check their claims, and are in step with their sources; what they carry can be read."""

import os
import runpy
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import jupytext
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest

SOURCES = sorted((Path(__file__).parents[1] / "notebooks").glob("[0-9][0-9]_*.py"))
each = pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)


def stored(source: Path) -> Any:
    return jupytext.read(source.with_suffix(".ipynb"))


def outputs(notebook: Any) -> list[Any]:
    return [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]


def figures(found: list[Any]) -> list[Any]:
    return [output for output in found if "image/png" in output.get("data", {})]


def test_every_notebook_has_its_source() -> None:
    assert len(SOURCES) >= 4
    notebooks = (Path(__file__).parents[1] / "notebooks").glob("*.ipynb")
    assert sorted(path.with_suffix(".py") for path in notebooks) == SOURCES


@each
def test_the_source_runs_without_a_warning_and_its_claim_holds(
    source: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with matplotlib.rc_context(), np.printoptions():
        runpy.run_path(str(source))
    plt.close("all")
    assert capsys.readouterr().out.splitlines()[-1].startswith("Shown: ")


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


@each
def test_nbconvert_executes_it_on_a_machine_without_a_screen(source: Path, tmp_path: Path) -> None:
    words = [sys.executable, "-m", "nbconvert", "--execute", "--to", "notebook"]
    words += ["--output-dir", str(tmp_path), str(source.with_suffix(".ipynb"))]
    screen = ("DISPLAY", "WAYLAND_DISPLAY", "MPLBACKEND")
    screenless = {name: value for name, value in os.environ.items() if name not in screen}
    with TemporaryDirectory() as folder:  # a short path; a TCP port is taken by another program now and then
        words += ["--KernelManager.transport=ipc", f"--KernelManager.ip={folder}/kernel"]
        done = subprocess.run(words, env=screenless, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    again = outputs(stored(tmp_path / source.name))
    assert not [output for output in again if output.get("name") == "stderr"]
    assert len(figures(again)) == len(figures(outputs(stored(source))))
