"""See a run move: as a page in a file, or served live until it is interrupted."""

import math
import signal
import socket
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import typer

from pinmobile import (
    LECTURE_TABLE,
    PD,
    SLIDE_TABLE,
    Circle,
    ComputedTorque,
    InvalidArgument,
    MobileRobot,
    Rollout,
    Tangent,
    simulate,
)
from pinmobile.arrays import positive
from pinmobile.cli import choices
from pinmobile.cli.output import console
from pinmobile.simulation.storage import why_unknown

__all__ = ["chosen_runs", "overlays_of", "save_page", "saved_runs", "show_live"]


def save_page(rollouts: Mapping[str, Rollout], path: Path, title: str, *, speed: float = 1.0) -> None:
    """Write a page that shows the rollouts in one scene: the first solid, the others as ghosts."""
    from pinmobile.viewer import Viewer  # meshcat is not needed by the other commands

    with Viewer(_plant(rollouts)) as viewer:
        viewer.record(rollouts, speed=speed, title=title).save_html(path)


def saved_runs(paths: Sequence[Path], words: Sequence[str]) -> dict[str, Rollout]:
    """Return the rollouts in files, by the files' names.

    Raises
    ------
    InvalidArgument
        If one cannot be read or drawn, or there are options of `run` too.
    """
    if words:
        raise InvalidArgument(f"--rollout stands alone, but there is {words[0]!r} too")
    names = [path.stem if len({p.stem for p in paths}) == len(paths) else str(path) for path in paths]
    return {name: _known(path, Rollout.load(path)) for name, path in zip(names, paths, strict=True)}


def _known(path: Path, run: Rollout) -> Rollout:
    """Return the run, after refusing one of a robot whose arm cannot be had again: it would be missing."""
    why = why_unknown(path)
    if why:
        raise InvalidArgument(
            f"--rollout {str(path)!r} does not know its robot: {why}; in Python, "
            "dataclasses.replace(rollout, plant=...) tells it"
        )
    return run


def chosen_runs(words: Sequence[str], app: typer.Typer) -> dict[str, Rollout]:
    """Return the run that the options of `run` stand for; without any, the lecture's circle, twice.

    Raises
    ------
    InvalidArgument, UnknownName
        If an option is not what is expected, or writes files.
    """
    if not words:
        robot, reference = MobileRobot.lecture(), Tangent(Circle(3, 0.1, 60))
        laws: dict[str, Any] = {
            "PD": PD((120, 120, 0.4), (120, 120, 0.4)),
            "computed torque": ComputedTorque(robot, 4, 4),
        }
        return {name: simulate(robot, law, reference, dt=0.1) for name, law in laws.items()}
    for word in words:
        if word.split("=")[0] in ("--out", "--gif", "--no-gif", "--html", "--no-html"):
            raise InvalidArgument(f"{word} does not apply to view, which writes no files")
    command: Any = typer.main.get_command(app)
    options = command.commands["run"].make_context("view", list(words)).params
    plant, law, trajectory, settings = choices.closed_loop(**options)
    return {options["controller"]: simulate(plant, law, trajectory, **settings)}


def overlays_of(*, follow: bool, frames: bool, arrows: bool) -> Any:
    """Return the overlays that were asked for."""
    from pinmobile.viewer import Arrows, Follow, Overlays, Stay

    return Overlays(
        camera=Follow() if follow else Stay(),
        frames=(LECTURE_TABLE, SLIDE_TABLE) if frames else (),
        arrows=Arrows() if arrows else None,
    )


def show_live(
    rollouts: Mapping[str, Rollout], overlays: Any, *, host: str, port: int | None, speed: float
) -> int:
    """Serve the rollouts again and again until Ctrl-C or SIGTERM; both are the way to end it."""
    from pinmobile.viewer import Viewer

    positive("--speed", speed)
    with (
        _until_ended(),
        Viewer(_plant(rollouts), live=True, host=host, port=port, overlays=overlays) as viewer,
    ):
        served = viewer.url.split("://")[1].split("/")[0].rpartition(":")[2]
        console.print(f"open {viewer.url}", markup=False)
        console.print(
            f"from another machine: ssh -L {served}:{host}:{served} {socket.gethostname()}\n"
            "and open the same address there, with 127.0.0.1 as its host; Ctrl-C ends it",
            markup=False,
        )
        console.file.flush()
        viewer.play(rollouts, speed=speed, repeat=math.inf)
    return 0


@contextmanager
def _until_ended() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM end what is within, in order."""

    def end(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    except KeyboardInterrupt:
        console.print("\nended", markup=False)
    finally:
        signal.signal(signal.SIGTERM, before)


def _plant(rollouts: Mapping[str, Rollout]) -> Any:
    plant = next(iter(rollouts.values())).plant
    return MobileRobot.lecture() if plant is None else plant
