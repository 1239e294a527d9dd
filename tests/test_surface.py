"""What the package shows: names, import weight, typing, and what the wheel carries."""

import ast
import importlib
import pkgutil
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

import pinmobile

ROOT = Path(__file__).parents[1]
MODULES = sorted(
    m.name for m in pkgutil.walk_packages(pinmobile.__path__, "pinmobile.") if "__main__" not in m.name
)

# Each module of the design, and what it may import of the others.
ALLOWED: dict[str, set[str]] = {
    "errors": set(),
    "arrays": {"errors"},
    "files": {"arrays"},
    "dh": {"arrays"},
    "urdf": {"dh"},
    "closed_form": {"arrays"},
    "derivation": {"dh"},
    "robot": {"arrays", "dh", "urdf"},
    "verification": {"robot", "closed_form", "derivation"},
    "paths": {"arrays"},
    "trajectories": {"paths"},
    "controllers": {"arrays"},
    "integrators": {"arrays"},
    "disturbances": {"arrays"},
    "simulation": {"files", "robot", "trajectories", "controllers", "integrators", "disturbances"},
    "accuracy": {"robot", "integrators", "simulation", "trajectories", "controllers"},
    "ensembles": {
        "closed_form",
        "robot",
        "trajectories",
        "controllers",
        "disturbances",
        "integrators",
        "simulation",
    },
    "sweeps": {"files", "ensembles"},
    "balance": {"robot"},
    "reaching": {"robot", "trajectories"},
    "plots": {"files", "simulation", "accuracy", "ensembles", "balance"},
    "viewer": {"files", "robot", "simulation"},
}


def below(module: str) -> set[str]:
    """Return the module, what it may import, and all below that."""
    return {module, "errors"}.union(*(below(other) for other in ALLOWED[module]))


@pytest.mark.parametrize("name", MODULES)
def test_all_lists_every_public_name_that_the_module_defines(name: str) -> None:
    module = importlib.import_module(name)
    assert module.__file__ is not None
    defined = {
        node.name
        for node in ast.parse(Path(module.__file__).read_text()).body
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and not node.name.startswith("_")
    }
    if name.startswith("pinmobile.cli.commands"):
        defined = set()  # its functions are the commands
    assert defined <= set(module.__all__)
    assert all(hasattr(module, entry) for entry in module.__all__)


def test_names_that_are_loaded_when_asked_for_are_listed_and_helpers_are_not() -> None:
    listed = dir(pinmobile)
    assert set(pinmobile.__all__) | {"plots", "sweeps", "viewer", "__version__"} <= set(listed)
    assert not {"Any", "TYPE_CHECKING", "import_module", "get_close_matches"} & set(listed)


def test_a_name_that_is_not_there_is_answered_with_the_nearest() -> None:
    with pytest.raises(AttributeError, match=r"has no attribute 'Unifrom', did you mean 'Uniform'[?]$"):
        pinmobile.Unifrom  # noqa: B018 (the lookup is what is tested)
    assert not hasattr(pinmobile, "nothing_like_it_at_all")


def test_all_of_the_package_is_what_it_imports() -> None:
    tree = ast.parse((ROOT / "src" / "pinmobile" / "__init__.py").read_text())
    imported = {
        alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("pinmobile.")
        for alias in node.names
    }
    assert set(pinmobile.__all__) == imported
    assert all(hasattr(pinmobile, name) for name in imported)


def test_a_module_imports_only_what_the_design_allows() -> None:
    checked = 0
    for path in sorted((ROOT / "src" / "pinmobile").rglob("*.py")):
        part = path.relative_to(ROOT / "src" / "pinmobile").parts[0].removesuffix(".py")
        if part not in ALLOWED:
            assert part in ("__init__", "__main__", "cli")
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            names: list[str] = []
            if isinstance(node, ast.ImportFrom) and node.module:
                names = (
                    [node.module]
                    if node.module != "pinmobile"
                    else [f"pinmobile.{a.name}" for a in node.names]
                )
            elif isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            for name in names:
                if name.startswith("pinmobile."):
                    assert name.split(".")[1] in below(part), f"{path} imports {name}"
                    checked += 1
    assert checked > 50


def test_import_pulls_in_nothing_heavier_than_numpy_and_pinocchio() -> None:
    code = (
        "import sys, pinocchio; before = set(sys.modules); import pinmobile; "
        "print(*sorted({m.split('.')[0] for m in set(sys.modules) - before} - set(sys.stdlib_module_names)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) <= {"numpy", "pinmobile"}
    assert done.stderr == ""


def test_importing_does_nothing_to_numpys_settings() -> None:
    code = (
        "import numpy as np; a = (np.get_printoptions(), np.geterr(), np.random.get_state()[1].sum()); "
        "import pinmobile; b = (np.get_printoptions(), np.geterr(), np.random.get_state()[1].sum()); "
        "print(a); print(b)"
    )
    words = [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    before, after = done.stdout.splitlines()
    assert before == after


def test_names_that_are_not_there_are_attribute_errors() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'viewr'"):
        pinmobile.viewr  # noqa: B018  # the look-up is the test


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    words = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    subprocess.run(words, check=True, capture_output=True, timeout=300)
    (path,) = folder.glob("*.whl")
    return path


def test_the_wheel_carries_the_urdfs_the_types_and_nothing_else(wheel: Path) -> None:
    names = set(zipfile.ZipFile(wheel).namelist())
    for shipped in (ROOT / "models" / "urdf").iterdir():
        assert f"pinmobile/models/urdf/{shipped.name}" in names
    assert "pinmobile/py.typed" in names
    assert all(name.split("/")[0] in ("pinmobile",) or ".dist-info/" in name for name in names)


def test_the_wheel_works_where_it_is_installed(wheel: Path, tmp_path: Path) -> None:
    venv.create(tmp_path / "env", with_pip=False)
    python = tmp_path / "env" / "bin" / "python"
    site = next((tmp_path / "env" / "lib").glob("python*")) / "site-packages"
    zipfile.ZipFile(wheel).extractall(site)
    # Its dependencies are those of this environment; pinmobile itself must come from the wheel.
    here = [entry for entry in sys.path if entry.endswith("site-packages")]
    (site / "dependencies.pth").write_text("\n".join(here))
    code = (
        "import pinmobile, pathlib; from pinmobile import MobileRobot, shipped_urdf; "
        "home = pathlib.Path(pinmobile.__file__).parent; assert 'env' in str(home), home; "
        "path = shipped_urdf('lecture'); assert home in path.parents, path; "
        "assert MobileRobot.from_urdf(path) == MobileRobot.lecture(); "
        "from pinmobile.cli import main; raise SystemExit(main(['verify', '--states', '5']))"
    )
    done = subprocess.run(
        [str(python), "-c", code], capture_output=True, text=True, cwd=tmp_path, check=False, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert "every route agrees" in done.stdout
