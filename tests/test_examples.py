"""Examples run, or say which package they lack; the build of the site runs those of the gallery."""

import ast
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

pytestmark = pytest.mark.once

EXAMPLES = Path(__file__).parents[1] / "examples"
GALLERY = sorted(EXAMPLES.glob("plot_*.py"))
NEEDED = {"nonlinear_mpc.py": "crocoddyl"}
PRINTED = {"nonlinear_mpc.py": ("NonlinearMPC within 20 mm after 2.", "MPC          within 20 mm after 2.")}


@pytest.mark.parametrize("path", sorted({*EXAMPLES.glob("*.py")} - {*GALLERY}), ids=lambda path: path.name)
def test_an_example_runs_or_says_what_it_needs(path: Path) -> None:
    done = subprocess.run([sys.executable, path], capture_output=True, text=True, timeout=300, check=False)
    needed = NEEDED.get(path.name)
    if needed is not None and find_spec(needed) is None:
        said = f"this example needs {needed}, which is not installed: pip install {needed}\n"
        assert (done.stdout, done.stderr, done.returncode) == ("", said, 1)
        return
    assert done.returncode == 0, done.stderr
    for words in PRINTED[path.name]:
        assert words in done.stdout


def test_the_gallery_has_twenty_scripts() -> None:
    assert len(GALLERY) == 20


@pytest.mark.parametrize("path", GALLERY, ids=lambda path: path.stem)
def test_a_script_of_the_gallery_is_short_and_begins_with_its_title(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    first = ast.parse(text).body[0]
    assert isinstance(first, ast.Expr)
    docstring = ast.get_docstring(ast.parse(text)) or ""
    title, line, empty, *words = docstring.splitlines()
    assert (line, empty, len(words) >= 2) == ("=" * len(title), "", True)
    code = [row for row in text.splitlines()[first.end_lineno :] if row.strip() and row.strip()[0] != "#"]
    assert len(code) <= 40
