"""Control in real time over UDP: jitter and missed deadlines, beside a robot process in C.

python benchmarks/realtime.py [--quick] [--seconds S] [--rate HZ ...]

The robot is a UR5 on a mobile base, its plant exported to C; it sends its state 1000 times per second. The
controller is computed torque in `run_realtime`. A last run interrupts the connection for 200 ms.
"""

import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from measuring import about, console, options, say, table

from pinmobile import Circle, ComputedTorque, MobileRobot, Spline, Tangent, WholeBody
from pinmobile.export import export_c
from pinmobile.realtime import RealtimeReport, Stepper, run_realtime

HERE = Path(__file__).parent
ROBOT = 0.001  # time step of the robot [s]
STALE = 0.1  # [s]
SCHEDULING = {"SCHED_FIFO": 50, "as before": None}


def parts(seconds: float) -> tuple[MobileRobot, Any]:
    """Return the robot and its trajectory."""
    robot = MobileRobot.box(mass=60, size=(0.8, 0.6, 0.3)).mount("ur5", at=(0.2, 0, 0.3, 0))
    base = Tangent(Circle(radius=2.0, rate=0.25, duration=seconds))
    arm = Spline([[0.0] * 6, [-0.5] * 6, [0.0] * 6], [0, seconds / 2, seconds])
    return robot, WholeBody(robot, base, arm)


def built(folder: Path, seconds: float) -> Path:
    """Return the program of the robot, compiled from its exported plant."""
    robot, motion = parts(seconds)
    export_c(None, robot, folder, dt=ROBOT, trajectory=motion)
    program = folder / "robot"
    sizes = [f"-DN{x.upper()}={getattr(robot, f'n{x}')}" for x in "qvu"]
    words = [
        "cc",
        "-std=gnu99",
        "-O2",
        *sizes,
        f"-I{folder}",
        str(HERE / "realtime.c"),
        str(folder / "robot.c"),
    ]
    subprocess.run([*words, "-o", str(program), "-lm"], check=True)
    return program


class Line:
    """UDP connection to the robot process.

    Attributes
    ----------
    last, stopped : float
        Times of the last measurement and of the stop [s].
    missed_share : float
        Share of the deadlines that the robot process missed itself, after its end.
    """

    def __init__(self, program: Path, seconds: float, fifo: bool, silent: float) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.bind(("127.0.0.1", 0))
            self._robot = other.getsockname()
        words = [self._robot[1], self._socket.getsockname()[1], round(1e9 * ROBOT), seconds, int(fifo)]
        command = [str(program), *map(str, words), str(round(1e9 * silent))]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        self._socket.settimeout(10.0)
        self._socket.recv(4096)  # the robot is there
        self._socket.setblocking(False)
        self.last = self.stopped = self.missed_share = 0.0

    def read(self) -> Any:
        """Return the newest measurement; None if there is none."""
        data = None
        while True:
            try:
                data = self._socket.recv(4096)
            except BlockingIOError:
                break
        if data is None:
            return None
        state = np.frombuffer(data)
        self.last = float(state[0])
        n = len(state) // 2
        return self.last, state[1 : 1 + n], state[1 + n :]

    def write(self, u: Any) -> None:
        """Send an input."""
        self._socket.sendto(u, self._robot)

    def stop(self) -> None:
        """Stop the robot."""
        self.stopped = time.monotonic()
        self._socket.sendto(b"stop", self._robot)

    def close(self) -> None:
        """Wait for the end of the robot process."""
        late, count = map(int, self._process.communicate(timeout=10.0)[0].split())
        self.missed_share = late / count
        self._socket.close()


def measured(
    program: Path, seconds: float, rate: float, priority: int | None, silent: float = 0.0
) -> tuple[RealtimeReport, Line]:
    """Return the report of a run, and its connection."""
    robot, motion = parts(seconds)
    stepper = Stepper(ComputedTorque(robot, 100, 20), robot, dt=1 / rate, trajectory=motion)
    line = Line(program, seconds + 5, priority is not None, silent)
    try:
        ways = line.read, line.write
        report = run_realtime(stepper, *ways, stop=line.stop, rate=rate, stale=STALE, priority=priority)
    finally:
        line.close()
    return report, line


def main(arguments: Sequence[str] | None = None) -> int:
    parser = options(__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, help="duration of each run (s); default: 60")
    parser.add_argument("--rate", type=float, nargs="+", default=[200.0, 1000.0], help="samples per second")
    chosen = parser.parse_args(arguments)
    seconds = chosen.seconds or (2.0 if chosen.quick else 60.0)
    out = console()
    out.print(about())
    if shutil.which("cc") is None:
        say(out, ["not measured: a C compiler is missing"])
        return 0
    with tempfile.TemporaryDirectory(prefix="pinmobile-") as folder:
        program = built(Path(folder), seconds)
        show_jitter(out, program, seconds, chosen.rate)
        return 0 if show_interruption(out, program, seconds) else 1


def show_jitter(out: Any, program: Path, seconds: float, rates: Sequence[float]) -> None:
    columns = ("Hz", "scheduling", "missed", "of", "%", "late, median", "99 %", "99.9 %", "largest")
    columns += ("sent, 99.9 %", "error, mm", "C alone, %")
    shown = table(f"\nControl over UDP, {seconds:g} s; times in us", *columns)
    for rate in rates:
        for name, priority in SCHEDULING.items():
            with out.status(f"{rate:g} Hz, {name}"):
                report, line = measured(program, seconds, rate, priority)
            scheduled = "FIFO" in report.scheduling[0] and "failed" not in report.scheduling[0]
            word = name if scheduled == (priority is not None) else "SCHED_FIFO not allowed"
            late = [f"{1e6 * x:.0f}" for x in report.quantiles().values()]
            response = f"{1e6 * report.quantiles('response time')['99.9 %']:.0f}"
            error = f"{1e3 * report.rollout.max_error()[:2].max():.2f}" if report.rollout else ""
            counts = f"{report.overruns}", f"{report.deadlines:,}", f"{100 * report.missed_share:.3f}"
            robot = f"{100 * line.missed_share:.3f}"
            word += "" if report.reason == "duration" else f" ({report.reason})"
            shown.add_row(f"{rate:g}", word, *counts, *late, response, error, robot)
    out.print(shown)
    say(
        out,
        [
            "late: from the beginning of a period to its sample; sent: to the input that is sent",
            "C alone: deadlines that the robot process, at 1000 Hz, missed itself: the share of the machine",
        ],
    )


def show_interruption(out: Any, program: Path, seconds: float) -> bool:
    """Show the time from the last measurement to `stop`, and return whether it is as stated."""
    report, line = measured(program, seconds, 1000.0, 50, silent=min(1.0, seconds / 2))
    took, stated = line.stopped - line.last, STALE + 0.001
    say(
        out,
        [
            f"connection interrupted for 200 ms: end by {report.reason}, stop() {1e3 * took:.2f} ms after "
            f"the last measurement; stated: {1e3 * stated:.0f} ms and the jitter"
        ],
    )
    return report.reason == "stale measurement" and took < stated + 0.02


if __name__ == "__main__":
    sys.exit(main())
