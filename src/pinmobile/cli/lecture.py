"""The lecture, from its derivation to its figures; `verify` and `derive` of any robot."""

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.progress import Progress

import pinmobile as pm
from pinmobile import plots
from pinmobile.cli.output import (
    Picture,
    Section,
    begin,
    console,
    index_page,
    output_folder,
    progress,
    save_figure,
)
from pinmobile.cli.results import FIGURES, check_film, draw, save_film
from pinmobile.cli.scenario_file import LoadedFile
from pinmobile.controllers import plain_difference, planar_difference
from pinmobile.files import write
from pinmobile.integrators import constant_acceleration
from pinmobile.loop import error_text
from pinmobile.trajectories import LectureHeading

if TYPE_CHECKING:
    from pinmobile.derivation import Derivation
    from pinmobile.verification import Verification

EXPECTED = {
    ("via stop", "PD"): ("3.219048e-03", "3.121481e-03"),
    ("via stop", "computed torque"): ("1.037037e-05", "1.037037e-05"),
    ("via free", "PD"): ("3.219048e-03", "1.613704e-03"),
    ("via free", "computed torque"): ("1.037037e-05", "2.592593e-06"),
    ("circle", "PD"): ("7.481303e-03", "7.481287e-03"),
    ("circle", "computed torque"): ("3.491279e-05", "3.491278e-05"),
}
"""Largest |error| in x and y [m] of the lecture's script, run in an independent interpreter."""

_VIA: dict[str, Any] = {"start": (0, 0), "via": (2, 2), "end": (0, 4), "t_via": 30.0, "t_end": 60.0}
_PATHS: dict[str, Any] = {
    "via stop": pm.CubicVia(**_VIA, via_velocity=(0, 0)),
    "via free": pm.CubicVia(**_VIA),
    "circle": pm.Circle(3.0, 0.1, 60.0),
}
_LABELS = "PD", "computed torque"
_GAINS = (120.0, 120.0, 0.4)
_TURN_TIME, _OFFSET, _COM_OFFSET = 2.0, 0.3, (0.1, 0.05)  # [s], [m], [m]
_STEPS = Picture("derivation.txt", "Every step of the derivation.")
_WHEELS = Picture(
    "wheels.png",
    f"{_OFFSET:g} m beside the path at the start: the free body slides back; on wheels PD does not come "
    "back, for no wheel pushes sideways, and backstepping steers back.",
)
Runs = dict[tuple[str, str], pm.Rollout]


def _loop(path: str, label: str, *, corrected: bool) -> dict[str, Any]:
    """Return the arguments of `simulate` for a loop of the lecture, with its or the corrected heading."""
    robot, curve = pm.MobileRobot.lecture(), _PATHS[path]
    difference = planar_difference if corrected else plain_difference
    return {
        "plant": robot,
        "controller": pm.PD(_GAINS, _GAINS, difference)
        if label == "PD"
        else pm.ComputedTorque(robot, 4.0, 4.0, difference),
        "trajectory": pm.Tangent(curve, _TURN_TIME) if corrected else LectureHeading(curve),
        "dt": 0.1,
        "integrator": constant_acceleration,
    }


def show_verification(words: Sequence[str], states: int, *, allow_code: bool) -> int:
    """Print the differences of the methods for the dynamics of a robot; return 0 if they agree."""
    from pinmobile import verify

    # Away from the lecture's com = (0, 0), where half of the terms vanish.
    file = LoadedFile(words or [f"robot=MobileRobot(10, 1.2, {(0.15, 0.05)})"], allow_code=allow_code)
    with progress(1, "deriving and comparing"):
        verification = verify(file.content.robot, states=states)
    console.print(f"{file.content.robot}\n{verification}")
    console.print(
        "all methods agree" if verification.passed else "verification failed: see the rows marked DIFFERS"
    )
    return 0 if verification.passed else 1


def show_derivation(words: Sequence[str], *, latex: bool, allow_code: bool) -> int:
    """Print the derivation of the robot's DH table, or of wheels with its mobility."""
    from pinmobile import derivation

    robot = LoadedFile(words, allow_code=allow_code).content.robot
    with progress(1, "deriving"):
        if isinstance(robot, pm.WheeledRobot):
            kind = robot.mobility.mobility, robot.mobility.steerability
            by_type = {
                (2, 0): derivation.differential_drive,
                (3, 0): derivation.roller_drive,
                (1, 1): derivation.car,
            }
            if kind not in by_type:
                raise pm.InvalidArgument(
                    f"robot has wheels of type {kind}, expected {', '.join(map(str, by_type))}: a "
                    "differential drive, wheels with rollers, or a car"
                )
            result: Any = by_type[kind]()
        else:
            result = _derive_chain(robot) if robot.mounts else derivation.lecture(robot.dh)
    # Not by the console, which would break the lines of LaTeX.
    print(result.document() if latex else result)
    return 0


def _derive_chain(robot: Any) -> "Derivation":
    """Return the derivation of a chain of base and arm, with symbols for the bodies' numbers but zeros."""
    import sympy

    from pinmobile.derivation import Link, derive

    def symbols(values: Any, names: Sequence[str]) -> list[Any]:
        return [sympy.Symbol(name) if value else 0 for name, value in zip(names, values, strict=True)]

    table = robot.chain
    if table is None:
        raise pm.InvalidArgument(
            "robot has arms that do not continue the DH table of the base, expected none, or "
            "MobileRobot.from_dh(table, bodies)"
        )
    solids = [(robot.mass, robot.com, robot.body.inertia)]
    solids += [(x.mass, x.com, x.body.inertia) for mount in robot.mounts for x in mount.links[1:]]
    links: list[Any] = [None, None]
    for k, (mass, com, inertia) in enumerate(solids, start=3):
        upper = [(i, j) for i in range(3) for j in range(i, 3)]
        moments = symbols([inertia[ij] for ij in upper], [f"I_{'xyz'[i]}{'xyz'[j]}{k}" for i, j in upper])
        tensor = sympy.zeros(3)
        for (i, j), moment in zip(upper, moments, strict=True):
            tensor[i, j] = tensor[j, i] = moment
        center = symbols(com, [f"{axis}_c{k}" for axis in "xyz"])
        links.append(Link(sympy.Symbol(f"m{k}") if mass else 0, center, tensor))
    gravity = (0, 0, -sympy.Symbol("g"))
    return derive(table, links, order=("x", "y", "psi", *table.variables[3:]), gravity=gravity)


def show_lecture(out: Path, *, gif: bool, mp4: bool) -> int:
    """Print the results of the lecture and write its figures; return 0 if all numbers agree."""
    from pinmobile import derivation, verify  # sympy is not needed by the other commands

    robot, folder = pm.MobileRobot.lecture(), output_folder(out)
    if mp4:
        check_film(folder / "film.mp4")
    with progress(6 + len(_PATHS) * (len(FIGURES) + 1 + gif + mp4)) as bar:
        begin(bar, "deriving")
        result = derivation.lecture()
        _print_heading("1  Derivation, from the DH table by recursive Newton-Euler")
        console.print(_format_equations(result))
        begin(bar, "verifying")
        # Away from the lecture's com = (0, 0), where half of the terms vanish.
        verification = verify(pm.MobileRobot(robot.mass, robot.yaw_inertia, com=_COM_OFFSET))
        _print_heading(f"\n2  Verification, with the centre of mass at {_COM_OFFSET} m")
        console.print(str(verification))
        begin(bar, "simulating")
        keys = [(path, label) for path in _PATHS for label in _LABELS]
        lecture_runs, corrected_runs = (
            {key: pm.simulate(**_loop(*key, corrected=is_so)) for key in keys} for is_so in (False, True)
        )
        _print_heading("\n3  Six closed loops, m = 30 kg, Icz = 0.1 kg m^2, dt = 0.1 s, 60 s")
        table, agree = _format_errors(lecture_runs, corrected_runs)
        console.print(table)
        begin(bar, "rolling")
        wheel_text, shifted = _compare_wheels()
        _print_heading("\n4  On wheels, those of a differential drive")
        console.print(wheel_text)
        begin(bar, "drawing")
        sections = _write_sections(folder, lecture_runs, corrected_runs, bar, gif=gif, mp4=mp4)
        begin(bar, "drawing wheels")
        save_figure(
            plots.path(shifted, title=f"{_OFFSET:g} m beside the path at the start"), folder / _WHEELS.file
        )
    write(folder / "derivation.txt", str(result).encode("utf-8"))
    texts = [
        Section("1  Derivation: M(q) and n(q, v)", _format_equations(result), pages=[_STEPS]),
        Section(f"2  Verification, with the centre of mass at {_COM_OFFSET} m", str(verification)),
        Section("3  Six closed loops", table),
        Section("4  On wheels: what they change", wheel_text, [_WHEELS]),
    ]
    page = index_page(folder, "The lecture: a mobile robot as a DH chain", [*texts, *sections])
    console.print(f"\n{_summary(verification, agree)}")
    console.print(f"every step of the derivation: {folder / 'derivation.txt'}")
    console.print(f"figures: open {page}\nsee it move: open {folder / 'circle.html'}")
    return 0 if agree and verification.passed else 1


def _print_heading(words: str) -> None:
    """Print the heading of a section, bold up to its comma."""
    title, comma, rest = words.partition(",")
    console.print(f"[bold]{title}[/bold]{comma}{rest}", markup=True)


def _format_equations(derivation: "Derivation") -> str:
    """Return the distinct entries of M(q) and n(q, v), one line each."""
    import sympy

    M, n = derivation.mass_matrix, derivation.nonlinear_effects
    names = ("x", "y", "psi")
    entries = {f"M[{names[i]}, {names[j]}]": M[i, j] for i in range(3) for j in range(i, 3)}
    entries |= {f"n[{name}]": entry for name, entry in zip(names, n, strict=True)}
    return "\n".join(f"  {name:11} = {sympy.sstr(entry)}" for name, entry in entries.items())


def _format_errors(lecture: Runs, corrected: Runs) -> tuple[str, bool]:
    """Return a table of the largest errors beside those of the lecture, and whether all agree."""
    texts = {key: tuple(map(error_text, run.max_error())) for key, run in lecture.items()}
    agree = all(texts[key][:2] == expected for key, expected in EXPECTED.items())
    head = ("trajectory", "controller", "x [m]", "lecture", "y [m]", "lecture")
    lines = ["largest |error|", "{:10} {:15} {:>12} {:>12} {:>13} {:>12}".format(*head)]
    for key, (x, y) in EXPECTED.items():
        mark = "" if texts[key][:2] == (x, y) else "  DIFFERS"
        lines.append(f"{key[0]:10} {key[1]:15} {texts[key][0]:>12} {x:>12} {texts[key][1]:>13} {y:>12}{mark}")
    lines += [
        "",
        "with the lecture's heading, and with that put right, which the figures show:",
        f"{'trajectory':10} {_HEAD}",
    ]
    lines += [f"{path:10} {row}" for path in _PATHS for row in _error_rows(path, lecture, corrected)]
    lines += [
        "the lecture's heading jumps where the robot rests; put right, it follows the",
        f"tangent's limits, and turns on the spot for {_TURN_TIME:g} s where the path bends at rest",
    ]
    return "\n".join(lines), agree


_ROW = "{:15} {:9} {:>4} {:>12} {:>12} {:>12}"
_HEAD = _ROW.format("controller", "heading", "time", "x [m]", "y [m]", "psi [rad]")


def _error_rows(path: str, lecture: Runs, corrected: Runs) -> list[str]:
    """Return the largest errors on a path with the heading of the lecture and the corrected one, as rows."""
    return [
        _ROW.format(label, heading, f"{runs[path, label].t[-1]:g} s", *map(error_text, errors))
        for label in _LABELS
        for heading, runs in (("lecture's", lecture), ("put right", corrected))
        for errors in [runs[path, label].max_error()]
    ]


def _compare_wheels() -> tuple[str, dict[str, pm.Rollout]]:
    """Return a comparison with a differential drive as text, and runs that start beside a path."""
    table = pm.WheelTable.differential(
        0.3, 0.1, supports=[(0.2, 0), (-0.2, 0)], mass=0.5, spin_inertia=2.5e-3, yaw_inertia=1.3e-3
    )
    wheeled = pm.WheeledRobot(pm.MobileRobot.lecture(), table)
    head = f"{'':10} {'':23} {'free body':>21}   {'on wheels':>21}"
    columns = f"{'on path':>10} {'beside':>10}"
    lines = [
        "heading along the tangent; track 0.3 m, radius 0.1 m; distance from path [m]:",
        f"the largest, and what is left at the end of a start {_OFFSET:g} m beside it",
        head,
        f"{'trajectory':10} {'controller':23} {columns}   {columns}",
    ]
    runs: dict[str, pm.Rollout] = {}
    for path in _PATHS:
        for label in _LABELS:
            loop, is_pd = _loop(path, label, corrected=True), label == "PD"
            law: Any = pm.Backstepping(pm.UnicycleTracking(), wheeled, k=4)
            if is_pd:
                law = pm.ControlAllocation(loop["controller"], wheeled)
            wheel_loop = loop | {
                "plant": wheeled,
                "controller": law,
                "integrator": None,
                "engine": pm.Engine.COMPILED,
            }
            errors, offset = zip(*(_path_errors(one) for one in (loop, wheel_loop)), strict=True)
            numbers = (f"{largest:10.1e} {final:10.1e}" for largest, final in errors)
            lines.append(f"{path:10} {label if is_pd else f'{label}*':23} {'   '.join(numbers)}")
            if path == "via stop":
                runs |= {"PD, on wheels": offset[1]} if is_pd else {"computed torque, free": offset[0]}
                runs |= {} if is_pd else {"backstepping, on wheels": offset[1]}
    lines += ["* on wheels: backstepping with k = 4 1/s, for no torques are the inverse dynamics", ""]
    lines += [
        "Wheels carry the force across the axle that PD lacks on a curve, and give none",
        "to come back; backstepping steers back. What wheels cannot follow is refused:",
        *textwrap.wrap(_heading_error(wheeled), 79),
    ]
    return "\n".join(lines), runs


def _path_errors(loop: dict[str, Any]) -> tuple[tuple[float, float], pm.Rollout]:
    """Return the largest distance from the path, the final distance after a start beside it, and this run."""
    run = pm.simulate(**loop)
    x, y, psi = run.q[0, :3]
    q0 = run.q[0].copy()
    q0[:2] = x - _OFFSET * math.sin(psi), y + _OFFSET * math.cos(psi)
    offset = pm.simulate(**loop, q0=q0, v0=run.v[0])
    nominal, final = (np.hypot(*(one.reference.q - one.q[:, :3])[:, :2].T) for one in (run, offset))
    return (float(nominal.max()), float(final[-1])), offset


def _heading_error(wheeled: pm.WheeledRobot) -> str:
    """Return the error for the heading of the lecture, which jumps at the start of the path."""
    try:
        law = pm.Backstepping(pm.UnicycleTracking(), wheeled)
        pm.simulate(wheeled, law, LectureHeading(_PATHS["via stop"]), dt=0.1)
    except pm.InvalidArgument as error:
        return str(error)
    return ""


def _summary(verification: "Verification", agree: bool) -> str:
    largest = ", ".join(f"{name} {value:.0e}" for name, value in verification.largest.items())
    methods = f"the methods {'' if verification.passed else 'do NOT '}agree; largest differences: {largest}"
    if agree:
        return f"{methods}\nall twelve numbers are the lecture's, to every digit"
    return f"{methods}\nsome numbers are NOT the lecture's: see the rows marked DIFFERS"


def _write_sections(
    folder: Path, lecture: Runs, corrected: Runs, bar: Progress, *, gif: bool, mp4: bool
) -> list[Section]:
    sections = []
    for number, trajectory in enumerate(_PATHS, start=5):
        name = trajectory.replace(" ", "-")
        rollouts = {label: corrected[trajectory, label] for label in _LABELS}
        pictures = draw(rollouts, folder, f"{name}-", bar, FIGURES)
        films = {"animation.gif": "The robot as it moves: PD, computed torque."} if gif else {}
        films |= {"film.mp4": "The robot in its scene as it moves."} if mp4 else {}
        for film, caption in films.items():
            begin(bar, f"drawing {name}-{film}")
            save_film(rollouts, folder / f"{name}-{film}", "", bar)
            pictures.insert(0, Picture(f"{name}-{film}", caption))
        begin(bar, f"recording {name}-scene")
        page = folder / f"{name}.html"
        save_film(rollouts, page, f"{trajectory.capitalize()}: PD and computed torque", bar, speed=4)
        title = f"{number}  {trajectory.capitalize()}: PD beside computed torque"
        pages = [Picture(page.name, "See it move: both robots in one scene.")]
        rows = _error_rows(trajectory, lecture, corrected)
        text = "\n".join(["largest |error|; the figures show the heading that is put right", _HEAD, *rows])
        sections.append(Section(title, text, pictures, pages))
    return sections
