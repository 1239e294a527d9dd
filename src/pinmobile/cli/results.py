"""Output of run, ensemble, sweep, view and play: text, figures and files."""

import math
import socket
import threading
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.progress import Progress

from pinmobile import (
    Diverged,
    Ensemble,
    InvalidArgument,
    MobileRobot,
    PinmobileError,
    Rollout,
    Sweep,
    plots,
)
from pinmobile.arrays import Array
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
from pinmobile.cli.scenario_file import LoadedFile
from pinmobile.loop import run_scenario, versions
from pinmobile.metrics import format_si, metrics_of
from pinmobile.parts import evolved
from pinmobile.plant import PlantDescription
from pinmobile.sweeps import connect, run_points

_FILM_DURATION = 10.0  # [s] that a film lasts at most
_MAX_FIGURES, _LIMIT = 12, 160  # figures of a sweep, and letters of a robot
_UNITS = (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6))

FIGURES = {
    "path": "The desired path (dashed), the travelled path, and the robot at its actual poses.",
    "states": "{} over time, desired and actual.",
    "errors": "Desired minus actual {} over time, angles on the circle.",
    "forces": "The inputs, constant between samples.",
}
_EXTRA_FIGURES = {
    "balance": "Tip-over margin, required friction, and the zero-moment point.",
    "reaction": "Force and moment of the arm on the base, at its mount.",
    "wheel_torques": "Torques of the wheels, and of the steering axes.",
    "friction": "Force at each wheel as a share of its friction: a wheel slides at 1.",
    "slip": "Velocity of each wheel over the ground, along and across.",
    "loads": "Load of each wheel.",
}
"""Figures of robots that have the quantity; for other robots, the plots raise `InvalidArgument`."""


def draw(rollouts: dict[str, Rollout], folder: Path, prefix: str, bar: Progress) -> list[Picture]:
    """Write the four figures of some rollouts, one step of the progress bar each."""
    has_arms = any(len(run.labels) > 3 for run in rollouts.values())
    coordinates = "x, y, psi and each joint" if has_arms else "x, y and psi"
    pictures = []
    for name, caption in FIGURES.items():
        begin(bar, f"drawing {prefix}{name}")
        save_figure(getattr(plots, name)(rollouts), folder / f"{prefix}{name}.png")
        pictures.append(Picture(f"{prefix}{name}.png", caption.format(coordinates)))
    return pictures


def _draw_extras(run: Rollout, folder: Path, bar: Progress) -> list[Picture]:
    pictures = []
    for name, caption in _EXTRA_FIGURES.items():
        begin(bar, f"drawing {name}")
        with suppress(InvalidArgument):
            save_figure(getattr(plots, name)(run), folder / f"{name}.png")
            pictures.append(Picture(f"{name}.png", caption))
    return pictures


def show_run(words: Sequence[str], out: Path, film: Path | None, *, allow_code: bool) -> int:
    """Run a loop, print its result, and write records, figures and their index, also for a diverged run."""
    check_film(film)
    file = LoadedFile(words, allow_code=allow_code, unused=("spread", "grid", "cases"))
    _print_base(file)
    folder = output_folder(out)
    diverged: Diverged | None = None
    with progress(3 + len(FIGURES) + len(_EXTRA_FIGURES)) as bar:
        begin(bar, "simulating")
        try:
            with file.error_lines():
                rollout = file.content.simulate()
        except Diverged as error:
            if error.rollout is None:
                raise
            diverged, rollout = error, error.rollout
        begin(bar, "recording")
        rollout.save(folder / "rollout.npz")
        rollout.to_csv(folder / "rollout.csv")
        pictures = draw({file.title: rollout}, folder, "", bar) + _draw_extras(rollout, folder, bar)
        if film is not None:
            begin(bar, "filming")
            save_film({file.title: rollout}, film, file.title, bar)
    text = "\n".join([str(rollout), *_metrics(rollout)])
    if diverged is not None:
        text = f"{diverged}\n\nup to there:\n{text}"
    robot = str(file.content.robot)
    console.print(f"robot: {robot if len(robot) < _LIMIT else f'{robot[:_LIMIT]}...'}\n{text}", markup=False)
    page = index_page(folder, file.title, [Section("Results", text, pictures), _source_section(file)])
    console.print(f"wrote {folder / 'rollout.npz'}, rollout.csv and figures: open {page}", markup=False)
    command = f"open {film}" if film is not None else f"pinmobile view {folder / 'rollout.npz'}"
    console.print(f"see it move: {command}", markup=False)
    if diverged is not None:
        raise diverged
    return 0


def _print_base(file: LoadedFile) -> None:
    """Print what a command leaves out of a file for many runs, and how to select another controller."""
    tables = tomllib.loads(file.text)
    names = [name for name in ("spread", "grid", "cases") if name in tables]
    if names:
        console.print(
            f"no effect here: {', '.join(names)} of the file; the controller is "
            f"{type(file.content.controller).__name__}, select another by controller=...",
            markup=False,
            soft_wrap=True,
        )


def _source_section(file: LoadedFile) -> Section:
    """Return the section that repeats the results: the whole scenario and the versions of the packages."""
    try:
        scenario = file.to_toml()
    except InvalidArgument:  # a part of the user's own code
        scenario = "\n".join([file.text, *file.words])
    releases = ", ".join(f"{name} {version}" for name, version in versions().items())
    return Section("Scenario", f"# {releases}\n{scenario}")


def _metrics(run: Rollout) -> list[str]:
    """Return a line for each metric of the plant: its worst value."""
    signals = run.metrics() if run.plant is not None else {}
    lines = []
    for each in metrics_of(run.plant) if signals else ():
        values = signals[each.name].values
        worst = np.nanmin(values) if each.is_margin else np.nanmax(np.abs(values))
        lines.append(f"{each.worst} {each.title}: {format_si(float(worst))}")
    return lines


def check_film(film: Path | None) -> None:
    """Reject a film that cannot be made, before anything runs."""
    if film is None:
        return
    if film.suffix not in (".html", ".gif", ".mp4", ".png"):
        raise InvalidArgument(f"--film is {str(film)!r}, expected a file .html, .gif, .mp4 or .png")
    if film.suffix == ".mp4":
        from pinmobile.viewer import check_films

        check_films()
    output_folder(film.parent, "--film", film)


def save_film(
    rollouts: Mapping[str, Rollout], path: Path, title: str, bar: Progress, *, speed: float = 1.0
) -> None:
    """Write rollouts that move in one scene, the first solid; .gif is drawn from above."""
    if path.suffix == ".gif":
        plots.animate(rollouts, path)
        return
    from pinmobile.viewer import Overlays, Viewer

    run = next(iter(rollouts.values()))
    task = bar.add_task("frames", total=None)
    wheels = "contacts" in dir(run.plant)
    with Viewer(plant_of(rollouts), overlays=Overlays(contacts=wheels, centre=wheels)) as viewer:
        if path.suffix == ".mp4":
            longest = max(float(each.t[-1] - each.t[0]) for each in rollouts.values())
            viewer.record(rollouts, speed=max(1.0, longest / _FILM_DURATION)).save_mp4(
                path, progress=lambda done, total: bar.update(task, completed=done, total=total)
            )
        elif path.suffix == ".png":
            viewer.record(rollouts, speed=speed)
            viewer.screenshot(path, t=float(run.t[-1] - run.t[0]) / speed)
        else:
            viewer.record(rollouts, speed=speed, title=title).save_html(path)
    bar.remove_task(task)


def plant_of(rollouts: Mapping[str, Rollout]) -> Any:
    """Return the plant of the first rollout, or the robot of the lecture."""
    plant = next(iter(rollouts.values())).plant
    return MobileRobot.lecture() if plant is None else plant


def show_ensemble(words: Sequence[str], out: Path, *, allow_code: bool) -> int:
    """Run an ensemble, print it and draw it."""
    file = LoadedFile(words, allow_code=allow_code, unused=("grid", "cases"))
    scenario = file.scenario()
    folder = output_folder(out)
    if not file.content.spread and scenario.n > 1:
        console.print("spread is empty: all robots are equal", markup=False)
    with progress(scenario.n) as bar:
        runs = run_scenario(scenario, progress=lambda done, _: bar.update(bar.task_ids[0], completed=done))
    console.print(str(runs), markup=False)
    pictures = _ensemble_figures(runs, folder)
    page = index_page(folder, file.title, [Section("Results", str(runs), pictures), _source_section(file)])
    console.print(
        f"figures: open {page}\ncompare values or controllers: pinmobile sweep --help", markup=False
    )
    return 0


def _ensemble_figures(runs: Ensemble, folder: Path) -> list[Picture]:
    save_figure(plots.bands(runs), folder / "bands.png")
    pictures = [Picture("bands.png", "Errors over time: bounds for half, 90 % and 99 % of the robots.")]
    with suppress(InvalidArgument):  # the robots are equal, or too few
        save_figure(plots.drivers(runs, share=max(0.05, 1 / len(runs))), folder / "drivers.png")
        pictures.append(Picture("drivers.png", "Parameters that the robots with the largest errors share."))
    return pictures


def show_sweep(words: Sequence[str], out: Path | None, scheduler: str | None, *, allow_code: bool) -> int:
    """Run the ensembles at all points, print their table and the answer, and draw them."""
    file = LoadedFile(words, allow_code=allow_code)
    points = file.points()
    folder = output_folder(Path("out") / file.title if out is None else out)
    client = None if scheduler is None else connect(scheduler)
    store = folder / "sweep.zarr"
    if store.exists():
        console.print(f"{store} exists: if it is of this sweep, only what it lacks is run", markup=False)
    try:
        with progress(len(points.scenarios) * points.n, "sweeping") as bar:
            sweep = run_points(
                points,
                store,
                client=client,
                progress=lambda done, total: bar.update(bar.task_ids[0], completed=done, total=total),
            )
    except KeyboardInterrupt:
        raise PinmobileError("interrupted: repeat the command to resume") from None
    finally:
        if client is not None:
            client.close()
    console.print(f"{sweep.table()}\n\n{sweep.answer()}", markup=False)
    section = Section("Results", sweep.table(most=1000), _sweep_figures(sweep, folder))
    page = index_page(folder, sweep.answer(), [section, _source_section(file)])
    console.print(
        f"wrote {store}: xarray.open_zarr reads it, and pinmobile.Sweep.open\nopen {page}", markup=False
    )
    return 0


def _sweep_figures(sweep: Sweep, folder: Path) -> list[Picture]:
    """Draw the distance within which 99 % of the robots stay: curves over one axis, or maps of two axes."""
    bounds = sweep.error_quantile()
    varied = [name for name, axis in sweep.axes.items() if len(axis.values) > 1]
    numeric = [name for name in varied if bounds[name].dtype.kind in "fiu"]
    labels = [name for name in varied if name not in numeric]
    is_curve = len(numeric) == 1
    plane = [*labels[-1:], *numeric] if is_curve else (numeric if len(numeric) > 1 else varied)[-2:]
    if not plane or (not is_curve and len(plane) < 2):
        return []
    values = bounds.isel({name: 0 for name in sweep.axes if name not in varied})
    unit, size = _unit(values.values)
    finite = values.values[np.isfinite(values.values)] / size
    limits = (float(finite.min()), float(finite.max())) if finite.size else None
    label = f"99 % stay within [{unit}]"
    pictures = []
    for k, (title, part) in enumerate(_slices(values / size, [name for name in varied if name not in plane])):
        if k == _MAX_FIGURES:
            break
        columns = [(name, sweep.axes[name].unit, list(sweep.axes[name].values)) for name in plane]
        part = part.transpose(*plane)
        figure: Figure
        if is_curve:
            names = [str(one) for one in columns[0][2]] if len(plane) > 1 else [""]
            rows = dict(zip(names, np.reshape(part.values, (len(names), -1)), strict=True))
            figure = plots.curves(rows, x=columns[-1], label=label, title=title or None)
        else:
            y, x = columns
            figure = plots.heatmap(part.values, x=x, y=y, title=title or label, label=label, limits=limits)
        save_figure(figure, folder / f"within-{k}.png")
        caption = f"{title}{title and ': '}{label}, over {' and '.join(plane[::-1])}."
        pictures.append(Picture(f"within-{k}.png", caption))
    return pictures


def _slices(values: Any, names: list[str]) -> Iterator[tuple[str, Any]]:
    """Yield a description and the part of the values for each combination of values of some axes."""
    for index in np.ndindex(*(values.sizes[name] for name in names)):
        indices = dict(zip(names, index, strict=True))
        pairs = [(name, np.asarray(values[name])[i]) for name, i in indices.items()]
        words = [str(value) if isinstance(value, str) else f"{name} = {value:g}" for name, value in pairs]
        yield ", ".join(words), values.isel(indices)


def _unit(values: Array) -> tuple[str, float]:
    """Return the unit in which the largest finite number reads best, and its size [m]."""
    finite = values[np.isfinite(values)]
    largest = float(finite.max()) if finite.size else 1.0
    return next(((unit, size) for unit, size in _UNITS if largest >= size), _UNITS[-1])


def show_live(words: Sequence[str], *, host: str, port: int | None, allow_code: bool) -> int:
    """Serve a run, or saved rollouts, until Ctrl-C or SIGTERM."""
    paths = [Path(word) for word in words if word.endswith(".npz")]
    if paths and len(paths) < len(words):
        others = [word for word in words if not word.endswith(".npz")]
        raise InvalidArgument(f"{others[0]!r} is beside saved rollouts, expected .npz files only")
    if paths:
        names = [path.stem if len({p.stem for p in paths}) == len(paths) else str(path) for path in paths]
        rollouts = {name: _load_run(path) for name, path in zip(names, paths, strict=True)}
    else:
        file = LoadedFile(words, allow_code=allow_code, unused=("spread", "grid", "cases"))
        rollouts = {file.title: file.content.simulate()}
    from pinmobile.viewer import Viewer

    with _until_interrupt(), Viewer(plant_of(rollouts), live=True, host=host, port=port) as viewer:
        _print_address(viewer.url, host)
        viewer.play(rollouts, speed=4.0, repeat=math.inf)
    return 0


def show_play(
    words: Sequence[str],
    sliders: Sequence[str],
    out: Path | None,
    *,
    host: str,
    port: int | None,
    allow_code: bool,
) -> int:
    """Run a loop in real time on a page until Ctrl-C or SIGTERM, and print its result and the next step."""
    if out is not None and out.suffix != ".npz":
        raise InvalidArgument(f"--out is {str(out)!r}, expected a file .npz")
    file = LoadedFile(words, allow_code=allow_code, unused=("spread", "grid", "cases", "n"))
    from pinmobile.viewer import LiveRun

    if out is not None:
        output_folder(out.parent, "--out", out)
    scenario = evolved(file.content, spread={}, grid={}, cases={}, n=1).scenario()
    with LiveRun(scenario, sliders, host=host, port=port) as run, _until_interrupt():
        _print_address(run.url, host)
        threading.Event().wait()
    rollout = run.rollout()
    console.print(str(rollout), markup=False)
    if out is None:
        console.print("to keep the run, repeat the command with --out run.npz", markup=False)
    else:
        rollout.save(out)
        console.print(f"wrote {out}\nsee it move: pinmobile view {out}", markup=False)
    return 0


def show_export(
    words: Sequence[str],
    out: Path,
    tunable: Sequence[str],
    *,
    name: str,
    precision: str,
    plant: bool,
    allow_code: bool,
) -> int:
    """Write the controller or the plant of a scenario as C, and print the files and the next step."""
    file = LoadedFile(words, allow_code=allow_code, unused=("spread", "grid", "cases", "n"))
    from pinmobile.export import export_c

    _print_base(file)
    output_folder(out, "--out")
    scenario = evolved(file.content, spread={}, grid={}, cases={}, n=1).scenario()
    options = {key: getattr(scenario, key) for key in ("forces", "integrator", "substeps") if plant}
    folder = export_c(
        None if plant else scenario.controller,
        scenario.robot,
        out,
        dt=scenario.dt,
        trajectory=scenario.trajectory,
        name=name,
        precision=precision,
        tunable=tunable,
        **options,
    )
    rows = [row for row in (folder / "README.md").read_text().splitlines() if row.startswith("| ")]
    files = ", ".join(sorted(each.name for each in folder.glob(f"{name}*.[ch]")))
    console.print(f"wrote {folder}: {files}, CMakeLists.txt, README.md", markup=False)
    for row in rows[1:]:
        label, _, value = row.strip("| ").partition(" | ")
        console.print(f"  {label:22} {value}", markup=False, highlight=False)
    build = f"cc -std=c99 -O2 -ffp-contract=off {name}.c {name}_test.c -lm -o {name}_test"
    console.print(f"test it: cd {folder} && {build} && ./{name}_test", markup=False, soft_wrap=True)
    return 0


def _print_address(url: str, host: str) -> None:
    """Print the address of a page, and how another machine opens it."""
    number = url.split("://")[1].split("/")[0].rpartition(":")[2]
    console.print(
        f"open {url}\n"
        f"from another machine: ssh -L {number}:{host}:{number} {socket.gethostname()}\n"
        "and open the same address on that machine, with the host 127.0.0.1; Ctrl-C ends the server",
        markup=False,
    )
    console.file.flush()


def _load_run(path: Path) -> Rollout:
    """Return a saved run; reject a run without its robot."""
    run = Rollout.load(path)
    if isinstance(run.plant, PlantDescription) and run.plant.reason:
        raise InvalidArgument(
            f"{str(path)!r} has no robot: {run.plant.reason}; in Python, "
            "dataclasses.replace(rollout, plant=...) adds it"
        )
    return run


@contextmanager
def _until_interrupt() -> Iterator[None]:
    """End a ``with`` block in order after Ctrl-C or SIGTERM."""
    try:
        yield
    except KeyboardInterrupt:
        console.print("\nended", markup=False)
