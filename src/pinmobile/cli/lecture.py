"""The whole lecture: derivation, verification, six closed loops with its numbers, and all figures."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from pinmobile import (
    PD,
    Circle,
    ComputedTorque,
    CubicVia,
    LectureHeading,
    MobileRobot,
    Rollout,
    Tangent,
    derivation,
    planar_difference,
    plots,
    simulate,
    verify,
)
from pinmobile.cli.output import Picture, Section, console, index_page, progress
from pinmobile.cli.run import FIGURES, draw

__all__ = ["EXPECTED", "show_lecture"]

_PATHS: dict[str, Callable[[], Any]] = {
    "via stop": lambda: CubicVia((0, 0), (2, 2), (0, 4), 30, 60, via_velocity=(0, 0)),
    "via free": lambda: CubicVia((0, 0), (2, 2), (0, 4), 30, 60),
    "circle": lambda: Circle(3, 0.1, 60),
}
_CONTROLLERS: dict[str, Callable[..., Any]] = {
    "PD": lambda robot, difference: PD((120, 120, 0.4), (120, 120, 0.4), difference=difference),
    "computed torque": lambda robot, difference: ComputedTorque(robot, 4, 4, difference=difference),
}
_DT = 0.1
_TURN_TIME = 2.0

EXPECTED = {
    ("via stop", "PD"): ("3.219048e-03", "3.121481e-03"),
    ("via stop", "computed torque"): ("1.037037e-05", "1.037037e-05"),
    ("via free", "PD"): ("3.219048e-03", "1.613704e-03"),
    ("via free", "computed torque"): ("1.037037e-05", "2.592593e-06"),
    ("circle", "PD"): ("7.481303e-03", "7.481287e-03"),
    ("circle", "computed torque"): ("3.491279e-05", "3.491278e-05"),
}
"""Largest |error| in x and y [m] of the lecture's script, run in an independent interpreter."""

Runs = dict[tuple[str, str], Rollout]


def show_lecture(folder: Path, *, gif: bool) -> int:
    """Print the lecture's results and write its figures; return 0 if every number is the lecture's."""
    robot = MobileRobot.lecture()
    steps = 4 + len(_PATHS) * (len(FIGURES) + gif)
    with progress(steps) as bar:

        def begin(what: str) -> None:
            bar.update(bar.task_ids[0], description=what, advance=1)

        begin("deriving")
        derived = derivation.lecture()
        console.print("[bold]1  Derivation[/bold], from the DH table by recursive Newton-Euler")
        console.print(_equations(derived), markup=False)
        begin("verifying")
        verification = verify(robot)
        console.print("\n[bold]2  Verification[/bold]")
        console.print(verification, markup=False)
        begin("simulating")
        lecture_runs, right_runs = _simulate(robot)
        console.print("\n[bold]3  Six closed loops[/bold], m = 30 kg, Icz = 0.1 kg m^2, dt = 0.1 s, 60 s")
        table, same = _table(lecture_runs, right_runs)
        console.print(table)
        begin("drawing")
        sections = _sections(folder, right_runs, lecture_runs, gif, bar)
    summary = _summary(verification, same)
    (folder / "derivation.txt").write_text(str(derived), encoding="utf-8")
    texts = [
        Section("1  Derivation: M(q) and n(q, v)", _equations(derived)),
        Section("2  Verification", str(verification)),
        Section("3  Six closed loops", _plain(table)),
    ]
    page = index_page(folder, "The lecture: a mobile robot as a DH chain", [*texts, *sections])
    console.print(f"\n{summary}\nevery step of the derivation: {folder / 'derivation.txt'}", markup=False)
    console.print(f"figures: open {page}", markup=False)
    return 0 if same and verification.passed else 1


def _equations(derived: Any) -> str:
    return f"{derived['M']}\n\n{derived['n']}"


def _simulate(robot: MobileRobot) -> tuple[Runs, Runs]:
    """Return the runs as the lecture has them, slips included, and with its heading put right."""
    lecture: Runs = {}
    right: Runs = {}
    for trajectory, make in _PATHS.items():
        path = make()
        for name, controller in _CONTROLLERS.items():
            key = trajectory, name
            lecture[key] = simulate(robot, controller(robot, np.subtract), LectureHeading(path), dt=_DT)
            tangent = Tangent(path, turn_time=_TURN_TIME)
            right[key] = simulate(robot, controller(robot, planar_difference), tangent, dt=_DT)
    return lecture, right


def _table(lecture: Runs, right: Runs) -> tuple[Table, bool]:
    table = Table(title="largest |error|", title_justify="left")
    table.add_column("trajectory")
    table.add_column("controller")
    for column in ("x [m]", "lecture", "y [m]", "lecture", "psi [rad]", "put right"):
        table.add_column(column, justify="right")
    same = True
    for key, expected in EXPECTED.items():
        x, y, psi = (f"{value:.6e}" for value in lecture[key].max_error())
        agrees = (x, y) == expected
        same &= agrees
        style = None if agrees else "bold red"
        table.add_row(
            *key, x, expected[0], y, expected[1], psi, f"{right[key].max_error()[2]:.1e}", style=style
        )
    table.caption = "psi: with the lecture's heading, which jumps where the robot rests; put right, with the tangent's limits"
    return table, same


def _plain(table: Table) -> str:
    with console.capture() as capture:
        console.print(table)
    return capture.get()


def _summary(verification: Any, same: bool) -> str:
    largest = ", ".join(f"{name} {value:.0e}" for name, value in verification.largest.items())
    return "\n".join(
        [
            f"the routes {'agree' if verification.passed else 'do NOT agree'} (largest difference: {largest})",
            "all twelve numbers are the lecture's, to every digit"
            if same
            else "some numbers are NOT the lecture's: see the rows in red",
        ]
    )


def _sections(folder: Path, right: Runs, lecture: Runs, gif: bool, bar: Any) -> list[Section]:
    sections = []
    for trajectory in _PATHS:
        prefix = trajectory.replace(" ", "-") + "-"
        rollouts = {name: right[trajectory, name] for name in _CONTROLLERS}
        pictures = draw(rollouts, folder, prefix, bar)
        if gif:
            bar.update(bar.task_ids[0], description=f"drawing {prefix}animation", advance=1)
            plots.animate(rollouts, folder / f"{prefix}animation.gif")
            pictures.insert(
                0, Picture(f"{prefix}animation.gif", "The robot as it moves: PD, computed torque.")
            )
        sections.append(Section(f"4  {trajectory.capitalize()}: PD beside computed torque", "", pictures))
    return sections
