"""Examples run, or say in one sentence which package they lack."""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

pytestmark = pytest.mark.once

EXAMPLES = Path(__file__).parents[1] / "examples"
NEEDED = {"nonlinear_mpc.py": "crocoddyl"}
PRINTED = {"nonlinear_mpc.py": ("NonlinearMPC within 20 mm after 2.", "MPC          within 20 mm after 2.")}


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.name)
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
