"""The sweep that the tests interrupt, for other processes to import; as a program, it runs until killed."""

import os
import signal
import sys
from hashlib import sha256
from pathlib import Path

from pinmobile import (
    Axis,
    Circle,
    ComputedTorque,
    MobileRobot,
    Normal,
    Scenario,
    Tangent,
    Uniform,
    grid,
    sweep,
)
from pinmobile.sweeps import Grid, connected

CHUNK = 64


def scenario(gain: float = 4, error: float = 0.1, n: int = 200, seed: int = 1) -> Scenario:
    robot = MobileRobot.lecture()
    return Scenario(
        robot=robot,
        controller=ComputedTorque(robot, gain, 2 * gain**0.5),
        trajectory=Tangent(Circle(3, 0.1, 6)),
        n=n,
        spread={"mass": Uniform(30 * (1 - error), 30 * (1 + error)), "start.x": Normal(0, 0.01)},
        dt=0.1,
        seed=seed,
    )


def gains_and_errors() -> Grid:
    return grid(scenario, gain=Axis([4, 16], unit="1/s^2"), error=[0, 0.2])


def contents(store: Path) -> dict[str, str]:
    """Return every file of a store, hidden ones too, with the digest of its bytes."""
    files = (path for path in store.rglob("*") if path.is_file())
    return {str(path.relative_to(store)): sha256(path.read_bytes()).hexdigest() for path in files}


def run_until_killed(store: str, robots: str, scheduler: str = "") -> None:
    def kill(done: int, total: int) -> None:
        if done >= int(robots):
            os.kill(os.getpid(), signal.SIGKILL)

    client = connected(scheduler) if scheduler else None
    sweep(gains_and_errors(), store, chunk=CHUNK, client=client, progress=kill)


if __name__ == "__main__":
    run_until_killed(*sys.argv[1:])
