"""What the package shows and releases: names, import weight, typing, versions, wheel and sources."""

import ast
import importlib
import inspect
import pickle
import pkgutil
import pydoc
import re
import runpy
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

import pinmobile

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "pinmobile"
MODULES = sorted(
    m.name for m in pkgutil.walk_packages(pinmobile.__path__, "pinmobile.") if "__main__" not in m.name
)

FILES = sorted(PACKAGE.rglob("*.py"))

# Each module of the design, and what it may import of the others.
ALLOWED: dict[str, set[str]] = {
    "errors": set(),
    "arrays": {"errors"},
    "parts": {"arrays"},
    "files": {"arrays"},
    "dh": {"arrays"},
    "urdf": {"dh"},
    "closed_form": {"arrays"},
    "derivation": {"dh"},
    "signals": {"arrays"},
    "metrics": {"parts"},
    "compiled": {"parts"},
    "plant": {"compiled"},
    "integrators": {"parts"},
    "paths": {"parts"},
    "forces": {"plant"},
    "trajectories": {"paths", "plant"},
    "robot": {"plant", "files", "metrics", "urdf", "closed_form"},
    "controllers": {"plant", "signals"},
    "wheels": {"robot", "controllers", "integrators"},
    "verification": {"wheels", "derivation"},
    "balance": {"robot", "trajectories"},
    "proximity": {"robot"},
    "reaching": {"robot", "trajectories", "integrators", "proximity"},
    "loop": {"files", "controllers", "forces", "reaching"},
    "accuracy": {"loop"},
    "sweeps": {"loop"},
    "export": {"loop"},
    "derivatives": {"loop"},
    "realtime": {"export"},
    "identification": {"loop", "wheels"},
    "palette": set(),
    "plots": {"palette", "accuracy", "balance", "derivatives", "identification"},
    "viewer": {"palette", "loop"},
    "exercises": {"loop", "wheels"},
}


@cache
def below(module: str) -> set[str]:
    """Return the module, what it may import, and all below that."""
    return {module, "errors"}.union(*(below(other) for other in ALLOWED[module]))


@pytest.mark.parametrize("name", MODULES)
def test_a_package_lists_its_public_names_and_no_module_does(name: str) -> None:
    module = importlib.import_module(name)
    assert hasattr(module, "__all__") == hasattr(module, "__path__")
    assert all(hasattr(module, entry) for entry in getattr(module, "__all__", ()))


def test_a_name_that_is_not_there_is_answered_with_the_nearest() -> None:
    with pytest.raises(AttributeError, match=r"has no attribute 'Unifrom', did you mean 'Uniform'[?]$"):
        pinmobile.Unifrom  # type: ignore[attr-defined]  # noqa: B018 (the lookup is what is tested)
    with pytest.raises(AttributeError, match=r"has no attribute 'viewr', did you mean 'viewer'[?]$"):
        pinmobile.viewr  # type: ignore[attr-defined]  # noqa: B018
    assert not hasattr(pinmobile, "nothing_like_it_at_all")


def test_what_is_loaded_when_used_is_what_type_checkers_see_and_what_is_exported() -> None:
    tree = ast.parse((PACKAGE / "__init__.py").read_text())
    imported = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    seen = {str(node.module) for node in imported if any(alias.name == "*" for alias in node.names)}
    table = pinmobile._NAMES
    assert {f"pinmobile.{module}" for module, names in table.items() if names} == seen
    assert len(pinmobile.__all__) == sum(len(names) for names in table.values())
    for module, names in table.items():
        for name in names:
            assert getattr(pinmobile, name) is getattr(importlib.import_module(f"pinmobile.{module}"), name)
            assert name in vars(pinmobile)  # kept: the next use costs a look-up


def test_every_module_is_found_in_the_package_and_none_hides_a_name() -> None:
    on_disk = {
        path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()
    }
    assert set(pinmobile._NAMES) == on_disk - {"__init__", "__main__", "cli"}
    # A module that is loaded becomes an attribute of the package, in place of a name that is the same.
    assert not set(pinmobile.__all__) & on_disk


@cache
def nodes_of(path: Path) -> list[Any]:
    """Return what a file is made of."""
    return [*ast.walk(ast.parse(path.read_text()))]


@cache
def imports(path: Path) -> tuple[str, ...]:
    """Return the modules that a file imports, in its functions and for its types too."""
    return tuple(_imports(path))


@cache
def every_module() -> frozenset[str]:
    return frozenset(map(module_of, FILES))


def _imports(path: Path) -> Iterator[str]:
    for node in nodes_of(path):
        if isinstance(node, ast.ImportFrom) and node.module:
            named = {f"{node.module}.{alias.name}" for alias in node.names}
            modules = named if node.module == "pinmobile" else named & every_module()
            yield from modules or [node.module]
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


@pytest.mark.once
def test_a_module_imports_only_what_the_design_allows() -> None:
    checked = 0
    for path in FILES:
        part = path.relative_to(PACKAGE).parts[0].removesuffix(".py")
        if part not in ALLOWED:
            assert part in ("__init__", "__main__", "cli")
            continue
        for name in imports(path):
            if name.startswith("pinmobile."):
                assert name.split(".")[1] in below(part), f"{path} imports {name}"
                checked += 1
    assert checked > 50


def test_packages_are_imported_as_a_whole() -> None:
    """What crosses packages is what an __init__ tells: no thread waits for a package that waits for it."""
    for path in FILES:
        own = ("pinmobile", *path.relative_to(PACKAGE).parent.parts)
        for name in imports(path):
            parts = tuple(name.split("."))
            assert len(parts) <= 2 or parts[:2] == own[:2] or parts[0] != "pinmobile", (
                f"{path} imports {name}"
            )


def test_no_modules_import_each_other() -> None:
    known = {module_of(path): path for path in FILES}
    asked: dict[str, set[str]] = {}
    for name, path in known.items():
        found = {other for other in imports(path) if other in known and other not in (name, "pinmobile")}
        # A package's modules may be imported by it, which imports nobody who imports it.
        asked[name] = {other for other in found if not name.startswith(f"{other}.")}
        assert asked[name] == found, f"{name} imports the package that it is in"
    done: set[str] = set()

    def visit(name: str, above: tuple[str, ...]) -> None:
        assert name not in above, " imports ".join((*above[above.index(name) :], name))
        if name not in done:
            for other in sorted(asked[name]):
                visit(other, (*above, name))
            done.add(name)

    for name in known:
        visit(name, ())


@cache
def module_of(path: Path) -> str:
    parts = ("pinmobile", *path.relative_to(PACKAGE).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@pytest.mark.once
def test_no_function_takes_more_than_seven_arguments_by_position() -> None:
    for path in FILES:
        for node in nodes_of(path):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
                given = [each.arg for each in (*node.args.posonlyargs, *node.args.args)]
                assert len(given) - (given[:1] in (["self"], ["cls"])) <= 7, f"{path}:{node.lineno}"


@pytest.mark.parametrize("name", sorted(pinmobile.__all__))
def test_help_names_types_as_they_are_called(name: str) -> None:
    assert "numpy._typing" not in pydoc.render_doc(getattr(pinmobile, name)), "ArrayLike is spelled out"


HEAVY = ("IPython", "asyncio", "dask", "llvmlite", "matplotlib", "meshcat", "numba", "scipy", "sympy", "zarr")


def fresh(code: str) -> str:
    """Return all that a new interpreter prints, warnings included."""
    words = [sys.executable, "-W", "error", "-c", code]
    done = subprocess.run(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    assert done.returncode == 0, done.stdout
    return done.stdout


def test_import_pulls_in_none_of_its_own_modules_and_no_library() -> None:
    """NumPy, whose settings it therefore leaves alone, is none of them."""
    loaded = fresh("import sys; before = {*sys.modules}; import pinmobile; print(*({*sys.modules} - before))")
    assert {name for name in loaded.split() if name.split(".")[0] not in sys.stdlib_module_names} == {
        "pinmobile"
    }


@pytest.mark.parametrize(
    ("use", "heavy"),
    [
        (
            "from pinmobile import PD, Circle, ComputedTorque, EndEffectorTracking, InvalidArgument; "
            "from pinmobile import Scenario, Spline, simulate, sweep; "
            "import pinmobile; pinmobile.balance, pinmobile.closed_form, pinmobile.loop",
            (),
        ),
        ("import pinmobile.derivation", ("sympy",)),
        ("import pinmobile.plots", ("matplotlib",)),
    ],
)
def test_a_first_use_pulls_in_what_it_needs_and_nothing_heavier(use: str, heavy: tuple[str, ...]) -> None:
    loaded = fresh(f"import sys; {use}; print(*{{name.split('.')[0] for name in sys.modules}})")
    assert set(loaded.split()) & set(HEAVY) == set(heavy)


@pytest.mark.once
@pytest.mark.long
def test_names_are_there_however_they_are_asked_for() -> None:
    made = pickle.dumps([pinmobile.PD(kp=2, kd=1), pinmobile.Uniform, pinmobile.rk4])
    fresh(
        f"import pickle; pd, kind, _ = pickle.loads({made!r}); import pinmobile; "
        "assert isinstance(pd, pinmobile.PD) and kind is pinmobile.Uniform\n"
        "import pinmobile.paths as paths; assert pinmobile.Circle is paths.Circle\n"
        "from pinmobile import *; PD, MobileRobot, ensemble, sweep, verify"
    )
    # inspect and pydoc walk through all that `dir` tells.
    assert {name for name, _ in inspect.getmembers(pinmobile)} >= set(pinmobile.__all__)
    assert "class ComputedTorque" in pydoc.plain(pydoc.render_doc(pinmobile))


@pytest.mark.parametrize(
    ("text", "said"),
    [(None, "No module is named 'pinocchio'"), ("class Plugin: pass", "Another module is named 'pinocchio'")],
)
def test_a_missing_or_another_pinocchio_is_told_at_once(tmp_path: Path, text: str | None, said: str) -> None:
    # -I and -S leave out PYTHONPATH and site-packages: no pinocchio but the one that is put there.
    if text is not None:
        (tmp_path / "pinocchio.py").write_text(text)
    code = f"import sys; sys.path[:0] = [{str(tmp_path)!r}, {str(PACKAGE.parent)!r}]; import pinmobile"
    words = [sys.executable, "-I", "-S", "-c", code]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    last = done.stderr.splitlines()[-1]
    assert last.startswith(f"ImportError: {said}")
    assert "pip install pin (pinocchio on PyPI is another project" in last


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
    assert {
        "pinmobile/py.typed",
        "pinmobile/scenarios/ur5.toml",
        "pinmobile/exercises/course.toml",
        "pinmobile/exercises/_equations.py",
    } <= names
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
        "import pinmobile, pathlib; from pinmobile import MobileRobot, urdf; "
        "home = pathlib.Path(pinmobile.__file__).parent; assert 'env' in str(home), home; "
        "path = urdf.shipped_urdf('lecture'); assert home in path.parents, path; "
        "assert MobileRobot.from_urdf(path) == MobileRobot.lecture(); "
        "from pinmobile.cli import main; raise SystemExit(main(['verify', '--states', '5']))"
    )
    done = subprocess.run(
        [str(python), "-c", code], capture_output=True, text=True, cwd=tmp_path, check=False, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert "all methods agree" in done.stdout


@pytest.mark.once
def test_no_package_reaches_for_what_is_private_in_another() -> None:
    """A name with an underscore that is read of something else than self is defined in the same package."""
    trees: dict[str, list[Any]] = {}
    for path in FILES:
        trees.setdefault(path.relative_to(PACKAGE).parts[0], []).extend(nodes_of(path))
    of_tuples = {"_asdict", "_fields", "_make", "_replace"}
    for package, nodes in trees.items():
        own = {node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)}
        own |= {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
        own |= {
            node.attr for node in nodes if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)
        }
        for node in nodes:
            if not isinstance(node, ast.Attribute) or node.attr[:1] != "_" or node.attr[-1:] == "_":
                continue
            whose = node.value.id if isinstance(node.value, ast.Name) else ""
            if whose not in ("self", "cls", "sys") and node.attr not in of_tuples:
                assert node.attr in own, f"{package} reads {ast.unparse(node)}"


ALONE = {"derivation", "viewer"}  # packages with a module of the same name


def test_no_name_of_a_file_occurs_twice() -> None:
    names = Counter(path.stem for path in FILES if path.stem not in ("__init__", "__main__"))
    assert [name for name, count in names.items() if count > 1] == []
    packages = {path.parent.name for path in FILES if path.name == "__init__.py"}
    assert packages & set(names) <= ALONE


def test_a_small_file_has_several_who_import_it() -> None:
    known = {module_of(path): path for path in FILES if path.name not in ("__init__.py", "__main__.py")}
    users: Counter[str] = Counter()
    for path in FILES:
        users.update({name for name in imports(path) if name in known})
    for name, path in known.items():
        assert users[name] > 1 or len(path.read_text().splitlines()) >= 120, name


def test_the_page_of_names_says_where_each_is() -> None:
    """Of the 134 names that the top level had, and of each row of the table that the README had."""
    page, rows = (ROOT / "docs" / "names.md").read_text().split("## Rows")
    names = re.findall(r"^\| (?!before)(.+?) \| (\w[^|]*?)(?: \| (.+))? \|$", page, re.M)
    assert len(names) == len({name for name, _, _ in names}) == 134
    for name, happened, now in names:
        old, new = name.strip("`"), now.strip("`")
        owner, _, last = new.rpartition(".")
        if happened == "cut":
            assert old not in pinmobile.__all__
            continue
        assert hasattr(getattr(pinmobile, owner) if owner else pinmobile, last), new
        assert (last == old) == (happened in ("kept", "moved")) or owner == "Engine", name
        assert (new in pinmobile.__all__) == (happened in ("kept", "renamed")) or owner == "Engine", name
    assert len(pinmobile.__all__) <= 75
    pages = re.findall(r"^\| (?!row).+ \| ([\w/-]+) \|$", rows, re.M)
    assert len(pages) == 27
    topics = runpy.run_path(str(ROOT / "docs" / "public.py"))["TOPICS"]
    for where in pages:
        folder, _, stem = where.partition("/")
        notebook = ROOT / "notebooks" / f"{stem}.ipynb"
        made = stem in topics if folder == "reference" else notebook.exists()
        assert made or (ROOT / "docs" / "site" / f"{where}.md").exists(), where


# -- what is released ------------------------------------------------------------------------------


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
README = (ROOT / "README.md").read_text()
RELATIVE = re.compile(r"\]\((?!https?:)[^)]*\)")


OUTSIDE = runpy.run_path(str(ROOT / "hatch_build.py"))["outside"]


def test_version_and_date_are_the_same_everywhere() -> None:
    version, date = re.findall(
        r"^## \[([\d.]+)\] - ([\d-]+)$", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE
    )[0]
    assert version == pinmobile.__version__
    citation = dict(re.findall(r"^([\w-]+): (.+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE))
    assert (citation["version"], citation["date-released"]) == (version, date)
    assert citation["license"] == PROJECT["project"]["license"]
    (author,) = PROJECT["project"]["authors"]
    assert f"- name: {author['name']}\n" in (ROOT / "CITATION.cff").read_text()
    assert author["name"].lower().removeprefix("the ") in (ROOT / "LICENSE").read_text()


@pytest.mark.once
def test_the_source_distribution_has_all_that_it_takes_to_show_and_test_it(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "build", "--sdist", "--no-isolation", "--outdir", str(tmp_path), str(ROOT)]
    subprocess.run(words, check=True, capture_output=True, timeout=300)
    (path,) = tmp_path.glob("*.tar.gz")
    with tarfile.open(path) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
        text = archive.extractfile(f"pinmobile-{pinmobile.__version__}/PKG-INFO")
        assert text is not None
        metadata = text.read().decode()
    folders = (".ci", ".github", "benchmarks", "docs", "examples", "models", "notebooks", "src", "tests")
    kept = [path for folder in folders for path in (ROOT / folder).rglob("*") if path.is_file()]
    wanted = {path.relative_to(ROOT).as_posix() for path in kept if "__pycache__" not in path.parts}
    alone = {path.name for path in ROOT.iterdir() if path.is_file() and path.name[:1] != "."}
    assert not wanted - names
    assert {*alone, "hatch_build.py", ".pre-commit-config.yaml", ".readthedocs.yaml", ".gitignore"} <= names
    assert not [name for name in names if "__pycache__" in name or name.startswith(("out/", ".venv/"))]
    assert not RELATIVE.findall(metadata)
    assert "# pinmobile\n" in metadata


def test_the_readme_of_a_distribution_needs_no_files_beside_it() -> None:
    assert RELATIVE.findall(README)
    bare = OUTSIDE(README, None)
    assert not RELATIVE.findall(bare)
    assert "[corrects its errors" not in bare
    assert "corrects its errors (`docs/site/explain/errata.md`)" in bare
    assert "recorded by" not in bare, "what stands below a picture goes with it"
    linked = OUTSIDE(README, "https://example.org/blob/v1/")
    assert not RELATIVE.findall(linked)
    assert "](https://example.org/raw/v1/docs/ur5.gif)\\\nA UR5 on its base" in linked
    assert "](https://example.org/blob/v1/docs/site/explain/errata.md)" in linked
    for block in re.findall(r"```.*?```", README, re.DOTALL):
        assert block in bare
        assert block in linked


def test_the_hooks_run_what_lint_runs() -> None:
    hooks = (ROOT / ".pre-commit-config.yaml").read_text()
    makefile = (ROOT / "Makefile").read_text()
    for tool in ("ruff check", "ruff format", "mypy"):
        assert f"entry: .venv/bin/{tool}" in hooks
        assert f"$(BIN)/{tool}" in makefile
    assert "http" not in hooks
