"""Exported C as a function of all samples: a driver in C, compiled with the code and called by ctypes."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-ffp-contract=off")
SANITIZED = ("-fsanitize=undefined,address", "-fno-sanitize-recover=all")

CONTROLLER = """
#include "robot.h"
#include <string.h>
typedef const robot_real *given;
int drive(long n, given t, given q, given v, given r, robot_real *u);
int drive(long n, given t, given q, given v, given r, robot_real *u)
{
    robot_memory memory;
    robot_reference reference;
    robot_init(&memory);
    for (long k = 0; k < n; ++k) {
        memcpy(&reference, r + k * (long)(sizeof reference / sizeof *r), sizeof reference);
        const robot_status status = robot_step(t[k], q + k * NQ, v + k * NV, &reference, &memory, u + k * NU);
        if (status != ROBOT_OK) return (int)status;
    }
    return 0;
}
"""
PLANT = """
#include "robot.h"
#include <string.h>
typedef const robot_real *given;
int drive(long n, given t, given u, robot_real *q, robot_real *v);
int drive(long n, given t, given u, robot_real *q, robot_real *v)
{
    robot_memory memory;
    robot_init(&memory);
    for (long k = 0; k < n; ++k) {
        memcpy(q + k * NQ, memory.q, sizeof memory.q);
        memcpy(v + k * NV, memory.v, sizeof memory.v);
        const robot_status status = robot_step(t[k], u + k * NU, &memory);
        if (status != ROBOT_OK) return (int)status;
    }
    return 0;
}
"""


def compilers() -> list[str]:
    """Return the C compilers of this machine; in CI both must be there."""
    found = [name for name in ("gcc", "clang") if shutil.which(name)]
    if os.environ.get("CI") == "true" and len(found) < 2:
        pytest.fail(f"compilers are {found}, expected gcc and clang")
    if not found:
        pytest.skip("neither gcc nor clang is installed")
    return found


def compile_c(
    folder: Path,
    driver: str,
    sizes: Sequence[int],
    *flags: str,
    compiler: str = "gcc",
    sources: Sequence[str] = ("robot.c",),
) -> Any:
    """Return the function `drive` of exported code; sizes are nq, nv and nu."""
    with tempfile.NamedTemporaryFile(dir=folder, suffix=".so", delete=False) as file:
        library = file.name
    main = folder / "drive.c"
    main.write_text(driver)
    defined = [f"-D{name}={size}" for name, size in zip(("NQ", "NV", "NU"), sizes, strict=True)]
    command = [compiler, *STRICT, "-shared", "-fPIC", *defined, *flags, *sources, main.name]
    succeed(folder, [*command, "-o", library, "-lm"])
    drive: Any = ctypes.CDLL(library).drive
    drive.library = library
    return drive


def succeed(folder: Path, *commands: Sequence[str]) -> str:
    """Run commands in a folder, of which none may fail, and return what the last one prints."""
    for command in commands:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def call(drive: Any, *arrays: Any) -> int:
    """Return the status of a call for all samples, whose results are written into the last arrays."""
    given = [ctypes.c_void_p(x.ctypes.data) for x in arrays]
    return int(drive(ctypes.c_long(len(arrays[0])), *given))


def run_program(folder: Path, main: str, *flags: str) -> str:
    """Return what a program with the exported code prints."""
    (folder / "main.c").write_text(main)
    return succeed(folder, ["gcc", *STRICT, *flags, "robot.c", "main.c", "-o", "main", "-lm"], ["./main"])


def run_test_program(folder: Path, *flags: str, compiler: str = "gcc") -> str:
    """Return what the exported test program prints."""
    command = [compiler, *STRICT, *flags, "robot.c", "robot_test.c", "-o", "robot_test", "-lm"]
    return succeed(folder, command, ["./robot_test"])


def rows(*arrays: Any, kind: Any = np.float64) -> list[Any]:
    """Return contiguous arrays."""
    return [np.ascontiguousarray(x, kind) for x in arrays]
