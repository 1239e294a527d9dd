"""GNU Octave: the lecture's script, timed inside the interpreter."""

import subprocess
import tempfile
from pathlib import Path

import numpy as np
from task import Log, Run, Task

SCRIPT = Path(__file__).parents[1] / "lecture.m"


def rollout(task: Task) -> Run:
    body = task.body
    numbers = [task.dt, task.duration, body.mass, body.yaw_inertia, *body.com]

    def run() -> Log:
        with tempfile.TemporaryDirectory() as folder:
            output = Path(folder) / "log"
            command = ["octave-cli", "--no-init-file", str(SCRIPT), *map(repr, numbers), str(output)]
            done = subprocess.run(command, capture_output=True, text=True, check=True)
            log = np.fromfile(output).reshape(-1, 5, 3).transpose(1, 0, 2)
        seconds, peak = map(float, done.stdout.split())
        return Log(*log, seconds=seconds, peak=peak)

    return run
