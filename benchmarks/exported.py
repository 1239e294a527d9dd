"""Exported C: time, size and memory of a step, beside the same law in Python, and on a Cortex-M4F.

python benchmarks/exported.py [--quick] [--rounds N]

The Cortex-M4F is emulated by qemu, which counts instructions; gcc-arm-none-eabi, libnewlib-arm-none-eabi and
qemu-system-arm are needed for this part. Both programs also run the exported test: in double precision, the
results have the bits of the library on both processors.
"""

import ctypes
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from measuring import Row, about, console, interleaved, options, say, table

import pinmobile as pm
from pinmobile.controllers import TorqueToVoltage
from pinmobile.export import export_c
from pinmobile.plant import Context

HERE = Path(__file__).parent / "cortex_m4"
DT = 0.001
STRICT = ("-std=c99", "-O2", "-ffp-contract=off")
ARM = ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", *STRICT)
QEMU = "qemu-system-arm -M mps2-an386 -nographic -semihosting -icount shift=0 -kernel"
TIMER = """
#include <time.h>
#define main tested
#include "robot_test.c"
#undef main
double nanoseconds(long steps);
double nanoseconds(long steps)
{
    robot_memory memory;
    robot_reference reference;
    robot_real u[sizeof robot_result_u[0] / sizeof(robot_real)];
    struct timespec start, end;
    robot_init(&memory);
    for (unsigned i = 0; i < sizeof reference.q / sizeof *reference.q; ++i)
        reference.q[i] = robot_given_reference_q[0][i];
    for (unsigned i = 0; i < sizeof reference.v / sizeof *reference.v; ++i) {
        reference.v[i] = robot_given_reference_v[0][i];
        reference.a[i] = robot_given_reference_a[0][i];
    }
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &start);
    for (long k = 0; k < steps; ++k)
        if (robot_step((double)k, robot_given_q[k % 64], robot_given_v[k % 64], &reference, &memory, u))
            return -1;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &end);
    const double whole = (double)(end.tv_sec - start.tv_sec), rest = (double)(end.tv_nsec - start.tv_nsec);
    return (whole * 1e9 + rest) / (double)steps;
}
"""


def laws() -> dict[str, tuple[Any, Any, Any]]:
    """Return plant, controller and, where the controller is designed along one, trajectory by name."""
    body = pm.MobileRobot(30.0, 1.3, com=(0.1, 0.05))
    motor = pm.Motor(resistance=1.2, torque_constant=0.05, voltage=24.0, gear=10.0)
    wheel: dict[str, Any] = {"mass": 1.0, "spin_inertia": 0.01, "motor": motor}
    drive = pm.WheeledRobot(body, pm.WheelTable.differential(0.5, 0.1, **wheel))
    mecanum = pm.WheeledRobot(body, pm.WheelTable.mecanum(0.5, 0.4, 0.1, **wheel))
    arm = pm.MobileRobot.box().mount("ur5")
    volts = TorqueToVoltage(pm.Backstepping(pm.UnicycleTracking(), drive), drive)
    path = pm.Tangent(pm.Circle(2.0, 0.5, 1.0))
    return {
        "PD": (body, pm.PD(120, 120), None),
        "LQR": (body, pm.LQR(body), path),
        "PID": (body, pm.PID(body), None),
        "computed torque": (body, pm.ComputedTorque(body, 4, 4), None),
        "backstepping, volts": (drive.by_voltage(), volts, None),
        "mecanum": (mecanum, pm.ControlAllocation(pm.ComputedTorque(body, 4, 4), mecanum), None),
        "UR5 on a base": (arm, pm.ComputedTorque(arm, 9, 6), None),
    }


def ran(*command: str | Path, folder: Path) -> str:
    """Return what a command prints; it runs in a folder."""
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=True)
    return done.stdout


def text_bytes(prefix: str, folder: Path, flags: Sequence[str]) -> int:
    """Return the bytes of code and constants of the exported source."""
    ran(f"{prefix}gcc", *flags, "-c", "robot.c", "-o", "robot.o", folder=folder)
    return int(ran(f"{prefix}size", "robot.o", folder=folder).splitlines()[1].split()[0])


def in_python(plant: Any, law: Any, trajectory: Any) -> float:
    """Return the time of a call of a controller in Python [ns]."""
    t, reference = np.zeros(1), None
    if trajectory is not None:
        t = np.arange(1001) * DT
        reference = trajectory(t)
    n = max(plant.reference_sizes) if hasattr(plant, "reference_sizes") else plant.nv
    first = pm.Reference(np.zeros(n), np.zeros(n), np.zeros(n))
    context = Context.of(plant, dt=DT, t=t, reference=reference, trajectory=trajectory)
    state, q, v = law.initial_state(context), np.zeros(plant.nq), np.full(plant.nv, 0.1)
    law(0.0, q, v, first, state)
    start = perf_counter()
    for _ in range(20):
        law(0.0, q, v, first, state)
    return (perf_counter() - start) / 20 * 1e9


def on_cortex(folder: Path) -> tuple[int, str]:
    """Return the instructions of a step on the emulated processor, and the difference of the test."""
    flags = (*ARM, "--specs=rdimon.specs", "-T", HERE / "link.ld", "-I.")
    ran(
        "arm-none-eabi-gcc",
        *flags,
        HERE / "start.c",
        HERE / "count.c",
        "robot.c",
        "-lm",
        "-o",
        "a",
        folder=folder,
    )
    count, test = ran(*QEMU.split(), "a", folder=folder).splitlines()
    return int(count), test.split()[5].rstrip(",")


def main(arguments: Sequence[str] | None = None) -> int:
    chosen = options(__doc__.splitlines()[0]).parse_args(arguments)
    rounds, steps = chosen.rounds or (1 if chosen.quick else 7), 2_000 if chosen.quick else 100_000
    out, has_arm = console(), bool(shutil.which("arm-none-eabi-gcc") and shutil.which("qemu-system-arm"))
    out.print(about())
    shown = table(
        "\nA step in C, double, gcc -O2", "law", "operations", "ns", "in Python", "bytes", "memory", "stack"
    )
    small = table(
        "\nA step on a Cortex-M4F, gcc -O2", "law", "single", "bytes", "error", "double", "bytes", "error"
    )
    with tempfile.TemporaryDirectory() as name:
        for law_name, (plant, law, trajectory) in laws().items():
            folder = Path(name) / law_name.replace(" ", "-")
            export_c(law, plant, folder, dt=DT, trajectory=trajectory)
            (folder / "timer.c").write_text(TIMER)
            flags = (*STRICT, "-D_POSIX_C_SOURCE=200809L", "-shared", "-fPIC")
            ran("gcc", *flags, "timer.c", "robot.c", "-o", "timer.so", "-lm", folder=folder)
            timed = ctypes.CDLL(str(folder / "timer.so")).nanoseconds
            timed.restype = ctypes.c_double
            turns = {
                "C": lambda timed=timed: float(timed(ctypes.c_long(steps))),
                "Python": lambda parts=(plant, law, trajectory): in_python(*parts),
            }
            rows = {key: Row(key, times=times) for key, times in interleaved(turns, rounds).items()}
            facts = dict(re.findall(r"\| (.*?) \| (?:below )?([\d,]+)", (folder / "README.md").read_text()))
            shown.add_row(
                *(law_name, facts["operations of a step"], f"{rows['C'].median:.0f}"),
                f"{rows['Python'].ratio(rows['C']):,.0f} times",
                *(f"{text_bytes('', folder, STRICT):,}", facts["memory"], facts["largest stack"]),
            )
            row = [law_name]
            for precision in ("single", "double") if has_arm else ():
                export_c(law, plant, folder, dt=DT, trajectory=trajectory, precision=precision)
                count, error = on_cortex(folder)
                row += [f"{count:,}", f"{text_bytes('arm-none-eabi-', folder, ARM):,}", error]
            small.add_row(*row)
    out.print(shown)
    notes = ["bytes of code and constants; LQR has a table of gains at each of its 1,001 samples"]
    if has_arm:
        out.print(small)
        notes.append("instructions; error: largest difference of 64 samples from the library, N, N m or V")
    else:
        notes.append(
            "Cortex-M4F: not installed: apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi "
            "qemu-system-arm"
        )
    say(out, notes)
    return 0


if __name__ == "__main__":
    sys.exit(main())
