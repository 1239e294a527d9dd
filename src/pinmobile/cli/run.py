"""Closed loops, run, recorded and drawn: one of the user's, the lecture's, and those shown live."""

import math
import signal
import socket
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.progress import Progress

from pinmobile import (
    COMPILED,
    LECTURE_TABLE,
    SLIDE_TABLE,
    Allocated,
    Backstepping,
    Diverged,
    InvalidArgument,
    MobileRobot,
    Rollout,
    Tracking,
    WheeledRobot,
    WheelTable,
    plots,
    simulate,
)
from pinmobile.arrays import positive
from pinmobile.cli.choices import COMPARED, CONTROLLERS, HEADINGS
from pinmobile.cli.options import LECTURE, Options, closed_loop
from pinmobile.cli.output import Picture, Section, begin, console, index_page, progress, save_figure
from pinmobile.files import write
from pinmobile.loop import error_text, why_unknown

if TYPE_CHECKING:
    from pinmobile.derivation import Derivation
    from pinmobile.verification import Verification
    from pinmobile.viewer import Overlays

_PLANE = 3  # coordinates of a bare base
_FILM = 10.0  # [s] that a film lasts at most

FIGURES = {
    "path": "The desired path (dashed), the travelled one, and the robot where it really was.",
    "states": "{} over time, desired and actual.",
    "errors": "Desired minus actual {} over time, angles on the circle.",
    "forces": "The generalised force, held between samples.",
}


def draw(rollouts: dict[str, Rollout], folder: Path, prefix: str, bar: Progress) -> list[Picture]:
    """Write the four figures of some rollouts, one step of the progress bar each.

    Parameters
    ----------
    rollouts : dict of str to Rollout
        What is drawn side by side.
    folder : Path
        Where to.
    prefix : str
        Beginning of the files' names.
    bar : rich.progress.Progress
        Its first task is advanced.
    """
    arms = any(len(run.labels) > _PLANE for run in rollouts.values())
    drawn = "x, y, psi and each joint" if arms else "x, y and psi"
    pictures = []
    for name, caption in FIGURES.items():
        begin(bar, f"drawing {prefix}{name}")
        save_figure(getattr(plots, name)(rollouts), folder / f"{prefix}{name}.png")
        pictures.append(Picture(f"{prefix}{name}.png", caption.format(drawn)))
    return pictures


def show_run(options: Options, folder: Path, *, gif: bool, mp4: bool, html: bool) -> int:
    """Run, print the judgement, and write records, figures and their index; a diverged run too."""
    loop, label = closed_loop(options), options["controller"]
    plant, title = loop["robot"], _titled(options)
    if mp4:
        _check_films()
    with progress(len(FIGURES) + 2 + gif + mp4 + html) as bar:
        begin(bar, "simulating")
        diverged: Diverged | None = None
        try:
            rollout = _simulated(loop)
        except Diverged as error:
            if error.rollout is None:
                raise
            diverged, rollout = error, error.rollout
        begin(bar, "recording")
        rollout.save(folder / "rollout.npz")
        rollout.to_csv(folder / "rollout.csv")
        pictures = draw({label: rollout}, folder, "", bar)
        if gif:
            begin(bar, "drawing the moving robot")
            plots.animate(rollout, folder / "animation.gif")
            pictures.insert(0, Picture("animation.gif", "The robot as it moves."))
        if mp4:
            pictures.insert(0, _film({label: rollout}, folder, "", bar))
        pages = []
        if html:
            begin(bar, "recording the scene")
            save_page({label: rollout}, folder / "scene.html", title)
            pages.append(Picture("scene.html", "See it move."))
    console.print(f"robot: {plant}, {plant.source}", markup=False)
    if diverged is not None:
        console.print("up to there:", markup=False)
    console.print(str(rollout), markup=False)
    text = str(rollout) if diverged is None else f"{diverged}\n\nup to there:\n{rollout}"
    page = index_page(folder, title, [Section("Results", text, pictures, pages)])
    console.print(
        f"wrote {folder / 'rollout.npz'} (Rollout.load reads it), rollout.csv and figures\nopen {page}",
        markup=False,
    )
    if html:
        console.print(f"see it move: open {folder / 'scene.html'}", markup=False)
    if diverged is not None:
        raise diverged
    return 0


def _titled(options: Options) -> str:
    """Return what a page of a run is called: controller, path and robot."""
    urdf = options["urdf"]
    robot = Path(urdf).name if urdf is not None else f"{options['robot'] or 'lecture'} robot"
    return f"{CONTROLLERS[options['controller']].label}: {options['trajectory'].replace('-', ' ')}, {robot}"


def _simulated(loop: Mapping[str, Any]) -> Rollout:
    """Return the run of what `closed_loop` returns."""
    return simulate(loop["robot"], **{name: part for name, part in loop.items() if name != "robot"})


def save_page(rollouts: Mapping[str, Rollout], path: Path, title: str, *, speed: float = 1.0) -> None:
    """Write a page that shows the rollouts in one scene: the first solid, the others as ghosts."""
    from pinmobile.viewer import Viewer  # meshcat is not needed by the other commands

    with Viewer(_plant(rollouts)) as viewer:
        viewer.record(rollouts, speed=speed, title=title).save_html(path)


def _check_films() -> None:
    from pinmobile.viewer import check_films

    check_films()


def _film(rollouts: Mapping[str, Rollout], folder: Path, prefix: str, bar: Progress) -> Picture:
    """Write a film of at most ten seconds, each frame told on the progress bar."""
    from pinmobile.viewer import Viewer

    begin(bar, f"filming {prefix}scene")
    task = bar.add_task("frames", total=None)
    pace = max(1.0, max(float(run.t[-1] - run.t[0]) for run in rollouts.values()) / _FILM)
    with Viewer(_plant(rollouts)) as viewer:
        viewer.record(rollouts, speed=pace).save_mp4(
            folder / f"{prefix}film.mp4",
            progress=lambda done, total: bar.update(task, completed=done, total=total),
        )
    bar.remove_task(task)
    return Picture(f"{prefix}film.mp4", "The robot in its scene as it moves.")


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
    """Return the run; check that its robot's arm can be had again: it would be missing."""
    why = why_unknown(path)
    if why:
        raise InvalidArgument(
            f"--rollout {str(path)!r} does not know its robot: {why}; in Python, "
            "dataclasses.replace(rollout, plant=...) tells it"
        )
    return run


def chosen_runs(options: Options | None) -> dict[str, Rollout]:
    """Return the run that options of `run` stand for; without any, the lecture's circle, twice."""
    if options is not None:
        return {options["controller"]: _simulated(closed_loop(options))}
    return {CONTROLLERS[name].label: _run_of_lecture(controller=name) for name in COMPARED}


def _run_of_lecture(**chosen: str) -> Rollout:
    return _simulated(closed_loop(LECTURE.with_values(**chosen)))


def overlays_of(*, follow: bool, frames: bool, arrows: bool) -> "Overlays":
    """Return the overlays that were asked for."""
    from pinmobile.viewer import Arrows, Follow, Overlays, Stay

    return Overlays(
        camera=Follow() if follow else Stay(),
        frames=(LECTURE_TABLE, SLIDE_TABLE) if frames else (),
        arrows=Arrows() if arrows else None,
    )


def show_live(
    rollouts: Mapping[str, Rollout], overlays: "Overlays", *, host: str, port: int | None, speed: float
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


_CONTROLLERS = {CONTROLLERS[name].label: name for name in COMPARED}
_TURN_TIME = HEADINGS["tangent"].takes["turn_time"]
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

_PATHS = {name: name.replace(" ", "-") for name, _ in EXPECTED}

_OFF = 0.3
_WHEELS = Picture(
    "wheels.png",
    f"{_OFF:g} m beside the path at the start: the free body slides back; on wheels PD does not come back, "
    "for no wheel pushes sideways, and backstepping steers back.",
)

Runs = dict[tuple[str, str], Rollout]


def show_lecture(folder: Path, *, gif: bool, mp4: bool) -> int:
    """Print the lecture's results and write its figures; return 0 if every number is the lecture's."""
    from pinmobile import derivation, verify  # sympy is not needed by the other commands

    robot = MobileRobot.lecture()
    if mp4:
        _check_films()
    steps = 6 + len(_PATHS) * (len(FIGURES) + 1 + gif + mp4)
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
        lecture_runs, right_runs = _six_loops()
        console.print("\n[bold]3  Six closed loops[/bold], m = 30 kg, Icz = 0.1 kg m^2, dt = 0.1 s, 60 s")
        table, same = _table(lecture_runs, right_runs)
        console.print(table, markup=False)
        begin(bar, "rolling")
        rolled, beside = _on_wheels()
        console.print("\n[bold]4  On wheels[/bold], those of a differential drive")
        console.print(rolled, markup=False)
        begin(bar, "drawing")
        sections = _sections(folder, lecture_runs, right_runs, bar, gif=gif, mp4=mp4)
        begin(bar, "drawing wheels")
        save_figure(
            plots.path(beside, title=f"{_OFF:g} m beside the path at the start"), folder / _WHEELS.file
        )
    summary = _summary(verification, same)
    write(folder / "derivation.txt", str(derived).encode("utf-8"))
    texts = [
        Section("1  Derivation: M(q) and n(q, v)", _equations(derived), pages=[_STEPS]),
        Section(f"2  Verification, with the centre of mass at {_OFFSET} m", str(verification)),
        Section("3  Six closed loops", table),
        Section("4  On wheels: what they change", rolled, [_WHEELS]),
    ]
    page = index_page(folder, "The lecture: a mobile robot as a DH chain", [*texts, *sections])
    console.print(f"\n{summary}\nevery step of the derivation: {folder / 'derivation.txt'}", markup=False)
    console.print(f"figures: open {page}", markup=False)
    console.print(f"see it move: open {folder / 'circle.html'}", markup=False)
    return 0 if same and verification.passed else 1


def _equations(derived: "Derivation") -> str:
    """Return the distinct entries of M(q) and n(q, v), a line each."""
    import sympy

    M, n = derived.mass_matrix, derived.nonlinear_effects
    names = ("x", "y", "psi")
    entries = {f"M[{names[i]}, {names[j]}]": M[i, j] for i in range(3) for j in range(i, 3)}
    entries |= {f"n[{name}]": entry for name, entry in zip(names, n, strict=True)}
    return "\n".join(f"  {name:11} = {sympy.sstr(entry)}" for name, entry in entries.items())


def _six_loops() -> tuple[Runs, Runs]:
    """Return the runs as the lecture has them, slips included, and with its heading put right."""
    lecture: Runs = {}
    right: Runs = {}
    for path, trajectory in _PATHS.items():
        for label, controller in _CONTROLLERS.items():
            for runs, heading in ((lecture, "lecture"), (right, "tangent")):
                runs[path, label] = _run_of_lecture(
                    trajectory=trajectory, controller=controller, heading=heading
                )
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
        "with the lecture's heading, and with that put right, which the figures show:",
        f"{'trajectory':10} {_HEAD}",
    ]
    lines += [f"{path:10} {row}" for path in _PATHS for row in _both(path, lecture, right)]
    lines += [
        "the lecture's heading jumps where the robot rests; put right, it follows the",
        f"tangent's limits, and turns on the spot for {_TURN_TIME:g} s where the path bends at rest",
    ]
    return "\n".join(lines), same


_ROW = "{:15} {:9} {:>4} {:>12} {:>12} {:>12}"
_HEAD = _ROW.format("controller", "heading", "time", "x [m]", "y [m]", "psi [rad]")


def _both(path: str, lecture: Runs, right: Runs) -> list[str]:
    """Return the largest errors on a path with the lecture's heading and with that put right, a row each."""
    return [
        _ROW.format(label, heading, f"{runs[path, label].t[-1]:g} s", *map(error_text, errors))
        for label in _CONTROLLERS
        for heading, runs in (("lecture's", lecture), ("put right", right))
        for errors in [runs[path, label].max_error()]
    ]


def _on_wheels() -> tuple[str, dict[str, Rollout]]:
    """Return what the wheels of a differential drive change, as text, and runs that start beside a path."""
    table = WheelTable.differential(
        0.3, 0.1, supports=[(-0.2, 0)], mass=0.5, spin_inertia=2.5e-3, yaw_inertia=1.3e-3
    )
    wheeled = WheeledRobot(MobileRobot.lecture(), table)
    head = f"{'':10} {'':23} {'free body':>21}   {'on wheels':>21}"
    columns = f"{'on path':>10} {'beside':>10}"
    lines = [
        "heading along the tangent; track 0.3 m, radius 0.1 m; distance from path [m]:",
        f"the largest, and what is left at the end of a start {_OFF:g} m beside it",
        head,
        f"{'trajectory':10} {'controller':23} {columns}   {columns}",
    ]
    shown: dict[str, Rollout] = {}
    for path, trajectory in _PATHS.items():
        for label, controller in _CONTROLLERS.items():
            chosen = {"trajectory": trajectory, "controller": controller, "heading": "tangent"}
            loop = closed_loop(LECTURE.with_values(**chosen))
            pd = label == "PD"
            on_wheels = (
                Allocated(loop["controller"], wheeled) if pd else Backstepping(Tracking(), wheeled, k=4)
            )
            rolled = loop | {"robot": wheeled, "controller": on_wheels, "engine": COMPILED}
            del rolled["integrator"]
            found, beside = zip(*(_on_and_beside(one) for one in (loop, rolled)), strict=True)
            what = label if pd else f"{label}*"
            numbers = (f"{on:10.1e} {off:10.1e}" for on, off in found)
            lines.append(f"{path:10} {what:23} {'   '.join(numbers)}")
            if path == "via stop":
                shown |= {"PD, on wheels": beside[1]} if pd else {"computed torque, free": beside[0]}
                shown |= {} if pd else {"backstepping, on wheels": beside[1]}
    lines += ["* on wheels: backstepping with k = 4 1/s, for no torques are the inverse dynamics", ""]
    lines += [
        "Wheels carry the force across the axle that PD lacks on a curve, and give none",
        "to come back; backstepping steers back. What wheels cannot follow is refused:",
        *textwrap.wrap(_refused(wheeled), 79),
    ]
    return "\n".join(lines), shown


def _on_and_beside(loop: Mapping[str, Any]) -> tuple[tuple[float, float], Rollout]:
    """Return the largest distance on the path, what is left at the end of a start beside it, and that run."""
    run = _simulated(loop)
    x, y, psi = run.q[0, :3]
    q0 = run.q[0].copy()
    q0[:2] = x - _OFF * math.sin(psi), y + _OFF * math.cos(psi)
    beside = _simulated({**loop, "q0": q0, "v0": run.v[0]})
    far, left = (np.hypot(*(one.reference.q - one.q[:, :3])[:, :2].T) for one in (run, beside))
    return (float(far.max()), float(left[-1])), beside


def _refused(wheeled: WheeledRobot) -> str:
    """Return what is said of the lecture's own heading, which jumps where the path begins."""
    loop = closed_loop(LECTURE.with_values(trajectory="via-stop", heading="lecture"))
    try:
        simulate(wheeled, Backstepping(Tracking(), wheeled), loop["trajectory"], dt=loop["dt"])
    except InvalidArgument as error:
        return str(error)
    return ""


def _summary(verification: "Verification", same: bool) -> str:
    largest = ", ".join(f"{name} {value:.0e}" for name, value in verification.largest.items())
    routes = f"the routes {'' if verification.passed else 'do NOT '}agree; largest differences: {largest}"
    if same:
        return f"{routes}\nall twelve numbers are the lecture's, to every digit"
    return f"{routes}\nsome numbers are NOT the lecture's: see the rows marked DIFFERS"


def _sections(
    folder: Path, lecture: Runs, right: Runs, bar: Progress, *, gif: bool, mp4: bool
) -> list[Section]:
    sections = []
    for number, trajectory in enumerate(_PATHS, start=5):
        prefix = f"{_PATHS[trajectory]}-"
        rollouts = {name: right[trajectory, name] for name in _CONTROLLERS}
        pictures = draw(rollouts, folder, prefix, bar)
        if gif:
            begin(bar, f"drawing {prefix}animation")
            plots.animate(rollouts, folder / f"{prefix}animation.gif")
            pictures.insert(
                0, Picture(f"{prefix}animation.gif", "The robot as it moves: PD, computed torque.")
            )
        if mp4:
            pictures.insert(0, _film(rollouts, folder, prefix, bar))
        begin(bar, f"recording {prefix}scene")
        name = f"{_PATHS[trajectory]}.html"
        save_page(rollouts, folder / name, f"{trajectory.capitalize()}: PD and computed torque", speed=4)
        title = f"{number}  {trajectory.capitalize()}: PD beside computed torque"
        pages = [Picture(name, "See it move: both robots in one scene.")]
        rows = _both(trajectory, lecture, right)
        text = "\n".join(["largest |error|; the figures show the heading that is put right", _HEAD, *rows])
        sections.append(Section(title, text, pictures, pages))
    return sections
