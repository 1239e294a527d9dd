"""The whole lecture: derivation, verification, six closed loops with its numbers, and all figures."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import sympy

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
    plain_difference,
    planar_difference,
    plots,
    simulate,
    verify,
)
from pinmobile.cli.output import Picture, Section, begin, console, index_page, progress
from pinmobile.cli.run import FIGURES, draw
from pinmobile.cli.view import save_page
from pinmobile.files import write
from pinmobile.simulation.rollout import error_text

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
_OFFSET = (0.1, 0.05)
_STEPS = Picture("derivation.txt", "Every step of the derivation.")

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
    steps = 4 + len(_PATHS) * (len(FIGURES) + 1 + gif)
    with progress(steps) as bar:
        begin(bar, "deriving")
        derived = derivation.lecture()
        console.print("[bold]1  Derivation[/bold], from the DH table by recursive Newton-Euler")
        console.print(_equations(derived), markup=False)
        begin(bar, "verifying")
        # Away from the lecture's com = (0, 0), where half of the terms vanish.
        verification = verify(MobileRobot(robot.mass, robot.yaw_inertia, com=_OFFSET))
        console.print(f"\n[bold]2  Verification[/bold], with the centre of mass at {_OFFSET} m")
        console.print(str(verification), markup=False)
        begin(bar, "simulating")
        lecture_runs, right_runs = _simulate(robot)
        console.print("\n[bold]3  Six closed loops[/bold], m = 30 kg, Icz = 0.1 kg m^2, dt = 0.1 s, 60 s")
        table, same = _table(lecture_runs, right_runs)
        console.print(table, markup=False)
        begin(bar, "drawing")
        sections = _sections(folder, right_runs, gif, bar)
    summary = _summary(verification, same)
    write(folder / "derivation.txt", str(derived).encode("utf-8"))
    texts = [
        Section("1  Derivation: M(q) and n(q, v)", _equations(derived), pages=[_STEPS]),
        Section(f"2  Verification, with the centre of mass at {_OFFSET} m", str(verification)),
        Section("3  Six closed loops", table),
    ]
    page = index_page(folder, "The lecture: a mobile robot as a DH chain", [*texts, *sections])
    console.print(f"\n{summary}\nevery step of the derivation: {folder / 'derivation.txt'}", markup=False)
    console.print(f"figures: open {page}", markup=False)
    console.print(f"see it move: open {folder / 'circle.html'}", markup=False)
    return 0 if same and verification.passed else 1


def _equations(derived: Any) -> str:
    """Return the distinct entries of M(q) and n(q, v), a line each."""
    M, n = derived.mass_matrix, derived.nonlinear_effects
    names = ("x", "y", "psi")
    entries = {f"M[{names[i]}, {names[j]}]": M[i, j] for i in range(3) for j in range(i, 3)}
    entries |= {f"n[{name}]": entry for name, entry in zip(names, n, strict=True)}
    return "\n".join(f"  {name:11} = {sympy.sstr(entry)}" for name, entry in entries.items())


def _simulate(robot: MobileRobot) -> tuple[Runs, Runs]:
    """Return the runs as the lecture has them, slips included, and with its heading put right."""
    lecture: Runs = {}
    right: Runs = {}
    for trajectory, make in _PATHS.items():
        path = make()
        for name, controller in _CONTROLLERS.items():
            key = trajectory, name
            lecture[key] = simulate(robot, controller(robot, plain_difference), LectureHeading(path), dt=_DT)
            tangent = Tangent(path, turn_time=_TURN_TIME)
            right[key] = simulate(robot, controller(robot, planar_difference), tangent, dt=_DT)
    return lecture, right


def _table(lecture: Runs, right: Runs) -> tuple[str, bool]:
    """Return the largest errors beside the lecture's, as text, and whether all are the same."""
    found = {key: tuple(map(error_text, run.max_error())) for key, run in lecture.items()}
    same = all(found[key][:2] == expected for key, expected in EXPECTED.items())
    head = ("trajectory", "controller", "x [m]", "lecture", "y [m]", "lecture")
    lines = ["largest |error|", "{:10} {:15} {:>12} {:>12} {:>13} {:>12}".format(*head)]
    for key, (x, y) in EXPECTED.items():
        mark = "" if found[key][:2] == (x, y) else "  DIFFERS"
        lines.append(f"{key[0]:10} {key[1]:15} {found[key][0]:>12} {x:>12} {found[key][1]:>13} {y:>12}{mark}")
    lines += [
        "",
        "{:10} {:15} {:>25} {:>26}".format("trajectory", "controller", "psi [rad]", "psi, put right"),
    ]
    for key in EXPECTED:
        lines.append(
            f"{key[0]:10} {key[1]:15} {found[key][2]:>25} {error_text(right[key].max_error()[2]):>26}"
        )
    lines += [
        "the lecture's heading jumps where the robot rests; put right, it follows the",
        f"tangent's limits, and turns on the spot for {_TURN_TIME:g} s where the path bends at rest",
    ]
    return "\n".join(lines), same


def _summary(verification: Any, same: bool) -> str:
    largest = ", ".join(f"{name} {value:.0e}" for name, value in verification.largest.items())
    return "\n".join(
        [
            f"the routes {'' if verification.passed else 'do NOT '}agree; largest differences: {largest}",
            "all twelve numbers are the lecture's, to every digit"
            if same
            else "some numbers are NOT the lecture's: see the rows marked DIFFERS",
        ]
    )


def _sections(folder: Path, right: Runs, gif: bool, bar: Any) -> list[Section]:
    sections = []
    for number, trajectory in enumerate(_PATHS, start=4):
        prefix = trajectory.replace(" ", "-") + "-"
        rollouts = {name: right[trajectory, name] for name in _CONTROLLERS}
        pictures = draw(rollouts, folder, prefix, bar)
        if gif:
            begin(bar, f"drawing {prefix}animation")
            plots.animate(rollouts, folder / f"{prefix}animation.gif")
            pictures.insert(
                0, Picture(f"{prefix}animation.gif", "The robot as it moves: PD, computed torque.")
            )
        begin(bar, f"recording {prefix}scene")
        name = trajectory.replace(" ", "-") + ".html"
        save_page(rollouts, folder / name, f"{trajectory.capitalize()}: PD and computed torque", speed=4)
        title = f"{number}  {trajectory.capitalize()}: PD beside computed torque"
        pages = [Picture(name, "See it move: both robots in one scene.")]
        sections.append(Section(title, "with the heading put right", pictures, pages))
    return sections
