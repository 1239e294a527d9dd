"""The sweep that the tests interrupt, for other processes to import; as a program, it runs until killed."""

import os
import signal
import sys
from hashlib import sha256
from pathlib import Path
from typing import Any

import pinmobile as pm
from pinmobile.sweeps import Points, connect

CHUNK = 64
ROBOT = pm.MobileRobot.lecture()
GRID: dict[str, Any] = {
    "controller.kp": [4, 16],
    "spread.mass": {0.1: pm.Relative(pm.Uniform(0.9, 1.1)), 0.2: pm.Relative(pm.Uniform(0.8, 1.2))},
}


def scenario(**changed: Any) -> pm.Scenario:
    given: dict[str, Any] = {"n": 200, "spread": {"start.x": pm.Normal(0, 0.01)}, "dt": 0.1, "seed": 1}
    given |= {"robot": ROBOT, "controller": pm.ComputedTorque(ROBOT, 4, 4)}
    given |= {"trajectory": pm.Tangent(pm.Circle(3, 0.1, 6))}
    return pm.Scenario(**given | changed)


def points(**changed: Any) -> Points:
    return Points.of(scenario(**changed), GRID)


def swept(store: Path, **options: Any) -> pm.Sweep:
    given: dict[str, Any] = {"grid": GRID, "chunk": CHUNK}
    return pm.sweep(scenario(), store, **given | options)


def contents(store: Path) -> dict[str, str]:
    """Return every file of a store, hidden ones too, with the digest of its bytes."""
    files = (path for path in store.rglob("*") if path.is_file())
    return {str(path.relative_to(store)): sha256(path.read_bytes()).hexdigest() for path in files}


def run_until_killed(store: str, robots: str, scheduler: str = "") -> None:
    def kill(done: int, total: int) -> None:
        if done >= int(robots):
            os.kill(os.getpid(), signal.SIGKILL)

    swept(Path(store), client=connect(scheduler) if scheduler else None, progress=kill)


if __name__ == "__main__":
    run_until_killed(*sys.argv[1:])
