"""The tests run under the kernel of OpenBLAS that they are asked to, or not at all."""

import os
import platform
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.kernels import in_force, refusal

ROOT = Path(__file__).parents[1]


def collected(kernel: str, *words: str) -> subprocess.CompletedProcess[str]:
    pytest_words = ["-m", "pytest", "--collect-only", "tests/test_errors.py", "-p", "no:cacheprovider"]
    command = [sys.executable, *pytest_words, *words]
    environment = os.environ | {"OPENBLAS_CORETYPE": kernel, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)


def test_the_kernel_in_force_stands_in_the_head_of_a_run_and_another_is_refused() -> None:
    run = collected("Haswel")
    assert run.returncode == pytest.ExitCode.USAGE_ERROR
    assert "OPENBLAS_CORETYPE is 'Haswel'" in run.stderr
    kernels = list(in_force().values())
    run = collected(kernels[0] if kernels else "")
    assert run.returncode == 0, run.stderr
    assert f"OpenBLAS: {', '.join(kernels) or 'none'}" in run.stdout.splitlines()
    assert refusal(os.environ.get("OPENBLAS_CORETYPE")) == ""


FAKE_MAKE = """#!/bin/sh
echo "make $* under ${OPENBLAS_CORETYPE-its own kernel}"
[ "$1 $OPENBLAS_CORETYPE" != "$FAILING" ]
"""


@pytest.fixture
def machine(tmp_path: Path) -> Path:
    """Return a folder with the script, and programs in ``bin`` that stand for those it starts."""
    for name, text in {"make": FAKE_MAKE, "chromium": "#!/bin/sh\n"}.items():
        program = tmp_path / "bin" / name
        program.parent.mkdir(exist_ok=True)
        program.write_text(text)
        program.chmod(0o755)
    (tmp_path / ".ci").mkdir()
    (tmp_path / ".ci" / "run").write_text((ROOT / ".ci" / "run").read_text())
    return tmp_path


def ran(machine: Path, pythons: int, failing: str = "") -> subprocess.CompletedProcess[str]:
    """Run the script where so many of the supported Pythons are found, by stand-ins."""
    for version in ("3.11", "3.12", "3.13"):
        known = "true" if int(version[2:]) < 11 + pythons else "false"
        python = machine / "bin" / f"python{version}"
        python.write_text(f"#!/bin/sh\n{known} || exit 1\necho {python}\n")
        python.chmod(0o755)
    environment = os.environ | {
        "PATH": f"{machine / 'bin'}:{os.environ['PATH']}",
        "PYENV_ROOT": str(machine),
        "FAILING": failing,
    }
    environment.pop("OPENBLAS_CORETYPE", None)
    command = ["bash", str(machine / ".ci" / "run")]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def expected_kernels() -> list[str]:
    if (platform.system(), platform.machine()) != ("Linux", "x86_64"):
        return []
    wide = "avx512f" in Path("/proc/cpuinfo").read_text().split()
    return ["Haswell", "Nehalem", *(["SkylakeX"] if wide else [])]


@pytest.mark.parametrize("pythons", [1, 2, 3])
def test_ci_runs_each_python_under_another_kernel_and_leaves_none_out(machine: Path, pythons: int) -> None:
    run = ran(machine, pythons)
    assert run.returncode == 0, run.stdout + run.stderr
    tested = [line for line in run.stdout.splitlines() if "] make test-all" in line]
    kernels = expected_kernels()
    for index in range(pythons):
        kernel = kernels[index % len(kernels)] if kernels else ""
        mark = f"[3.{10 + pythons - index}{' ' * bool(kernel)}{kernel}] make test-all PYTHON="
        assert any(
            line.startswith(mark) and line.endswith(f"under {kernel or 'its own kernel'}") for line in tested
        )
    assert all(any(line.endswith(f"under {kernel}") for line in tested) for kernel in kernels)
    assert len(tested) == max(pythons, len(kernels))


def test_ci_runs_everything_once_and_repeats_another_twelfth_on_each_other_python(machine: Path) -> None:
    lines = [line for line in ran(machine, 3).stdout.splitlines() if "] make test-all" in line]
    given = {line[1:5]: re.findall(r"ARGS=(.*) under", line)[0] for line in reversed(lines)}
    whole = "--assert=plain --showlocals --cov=pinmobile --cov-report=term:skip-covered"
    plain = "-n 0 --assert=plain"
    assert given == {"3.13": whole, "3.12": f"--part=0/12 {plain}", "3.11": f"--part=1/12 {plain}"}


@pytest.mark.long
@pytest.mark.once
def test_parts_are_all_but_pages_and_what_is_marked_once() -> None:
    asked = os.environ.get("OPENBLAS_CORETYPE", "")
    words = "-q", "tests/test_kernels.py", "tests/test_viewer_browser.py"
    found = [collected(asked, f"--part={k}/2", *words).stdout for k in range(2)]
    parts = [set(re.findall(r"^tests/.*::.*$", text, re.MULTILINE)) for text in found]
    assert len(set.union(*parts)) == sum(map(len, parts)) > 10
    assert not any("viewer_browser" in item or "marked_once" in item for item in set.union(*parts))


def test_ci_fails_where_one_of_the_runs_does(machine: Path) -> None:
    for kernel in expected_kernels():
        for pythons in (1, 3):
            assert ran(machine, pythons, failing=f"test-all {kernel}").returncode == 1
