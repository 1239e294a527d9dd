"""Output of run, ensemble, sweep, view, play, export and identify: text, figures and files."""

from __future__ import annotations

import math
import socket
import threading
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path
from textwrap import shorten
from typing import Any

import attrs
import numpy as np
from matplotlib.figure import Figure
from rich.progress import Progress

from pinmobile import (
    Diverged,
    Ensemble,
    InvalidArgument,
    Log,
    MobileRobot,
    PinmobileError,
    Rollout,
    Sweep,
    identify,
    identify_velocity,
    plots,
)
from pinmobile.arrays import Array, absent, instance, one_of, sequence
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
from pinmobile.files import check_suffix
from pinmobile.identification import METHODS
from pinmobile.loop import run_scenario, versions
from pinmobile.metrics import format_si, metrics_of
from pinmobile.parts import child, evolved, number, option, parameters, part
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
_RUN_FIGURES = FIGURES | {
    "balance": "Tip-over margin, required friction, and the zero-moment point.",
    "reaction": "Force and moment of the arm on the base, at its mount.",
    "wheel_torques": "Torques of the wheels, and of the steering axes.",
    "friction": "Force at each wheel as a share of its friction: a wheel slides at 1.",
    "slip": "Velocity of each wheel over the ground, along and across.",
    "loads": "Load of each wheel.",
}
"""Figures of one run; the plots raise `InvalidArgument` for robots without the quantity."""


def draw(
    rollouts: dict[str, Rollout], folder: Path, prefix: str, bar: Progress, figures: Mapping[str, str]
) -> list[Picture]:
    """Write figures of some rollouts, one step of the progress bar each; leave out what they do not have."""
    has_arms = any(len(run.labels) > 3 for run in rollouts.values())
    coordinates = "x, y, psi and each joint" if has_arms else "x, y and psi"
    pictures = []
    for name, caption in figures.items():
        begin(bar, f"drawing {prefix}{name}")
        with suppress(InvalidArgument):
            save_figure(getattr(plots, name)(rollouts), folder / f"{prefix}{name}.png")
            pictures.append(Picture(f"{prefix}{name}.png", caption.format(coordinates)))
    return pictures


def show_run(words: Sequence[str], out: Path, film: Path | None, *, allow_code: bool) -> int:
    """Run a loop, print its result, and write records, figures and their index, also for a diverged run."""
    check_film(film)
    file = LoadedFile(words, allow_code=allow_code, unused=("spread", "grid", "cases"))
    _print_base(file)
    folder = output_folder(out)
    diverged: Diverged | None = None
    with progress(3 + len(_RUN_FIGURES)) as bar:
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
        pictures = draw({file.title: rollout}, folder, "", bar, _RUN_FIGURES)
        if film is not None:
            begin(bar, "filming")
            save_film({file.title: rollout}, film, file.title, bar)
    text = "\n".join([str(rollout), *_metrics(rollout)])
    if diverged is not None:
        text = f"{diverged}\n\nup to there:\n{text}"
    robot = shorten(repr(file.content.robot), _LIMIT, placeholder=" ...")
    console.print(f"robot: {robot}\n{text}")
    page = index_page(folder, file.title, [Section("Results", text, pictures), _source_section(file)])
    console.print(f"wrote {folder / 'rollout.npz'}, rollout.csv and figures: open {page}")
    command = f"open {film}" if film is not None else f"pinmobile view {folder / 'rollout.npz'}"
    console.print(f"see it move: {command}")
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
        words = f"{each.worst} {each.title}: {format_si(float(worst))}"
        lines.append(f"{each.name}: {'yes' if worst else 'no'}" if each.worst == "ever" else words)
    return lines


def check_film(film: Path | None) -> None:
    """Reject a film that cannot be made, before anything runs."""
    if film is None:
        return
    check_suffix("--film", film, ".html", ".gif", ".mp4", ".png")
    if film.suffix.lower() == ".mp4":
        from pinmobile.viewer import check_films

        check_films()
    output_folder(film.parent, "--film", film)


def save_film(
    rollouts: Mapping[str, Rollout], path: Path, title: str, bar: Progress, *, speed: float = 1.0
) -> None:
    """Write rollouts that move in one scene, the first solid; .gif is drawn from above."""
    suffix = path.suffix.lower()
    if suffix == ".gif":
        plots.animate(rollouts, path)
        return
    from pinmobile.viewer import Overlays, Viewer

    run = next(iter(rollouts.values()))
    task = bar.add_task("frames", total=None)
    wheels = "contacts" in dir(run.plant)
    with Viewer(plant_of(rollouts), overlays=Overlays(contacts=wheels, centre=wheels)) as viewer:
        if suffix == ".mp4":
            longest = max(float(each.t[-1] - each.t[0]) for each in rollouts.values())
            viewer.record(rollouts, speed=max(1.0, longest / _FILM_DURATION)).save_mp4(
                path, progress=lambda done, total: bar.update(task, completed=done, total=total)
            )
        elif suffix == ".png":
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
        console.print("spread is empty: all robots are equal")
    with progress(scenario.n) as bar:
        runs = run_scenario(scenario, progress=lambda done, _: bar.update(bar.task_ids[0], completed=done))
    console.print(str(runs))
    pictures = _ensemble_figures(runs, folder)
    page = index_page(folder, file.title, [Section("Results", str(runs), pictures), _source_section(file)])
    console.print(f"figures: open {page}\ncompare values or controllers: pinmobile sweep --help")
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
        console.print(f"{store} exists: if it is of this sweep, only what it lacks is run")
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
    console.print(f"{sweep.table()}\n\n{sweep.answer()}")
    section = Section("Results", sweep.table(most=1000), _sweep_figures(sweep, folder))
    page = index_page(folder, sweep.answer(), [section, _source_section(file)])
    console.print(f"wrote {store}: xarray.open_zarr reads it, and pinmobile.Sweep.open\nopen {page}")
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
    slices = _slices(values / size, [name for name in varied if name not in plane])
    for k, (title, content) in enumerate(islice(slices, _MAX_FIGURES)):
        columns = [(name, sweep.axes[name].unit, list(sweep.axes[name].values)) for name in plane]
        content = content.transpose(*plane)
        figure: Figure
        if is_curve:
            names = [str(one) for one in columns[0][2]] if len(plane) > 1 else [""]
            rows = dict(zip(names, np.reshape(content.values, (len(names), -1)), strict=True))
            figure = plots.curves(rows, x=columns[-1], label=label, title=title or None)
        else:
            y, x = columns
            figure = plots.heatmap(content.values, x=x, y=y, title=title or label, label=label, limits=limits)
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
    """Serve a run, or saved rollouts, until Ctrl-C or SIGTERM; the folder of a run stands for its rollout."""
    files = [(word, Path(word) / "rollout.npz") for word in words]
    words = [str(file) if file.is_file() else word for word, file in files]
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
    if out is not None:
        check_suffix("--out", out, ".npz")
    file = LoadedFile(words, allow_code=allow_code, unused=("spread", "grid", "cases", "n"))
    from pinmobile.viewer import LiveRun

    if out is not None:
        output_folder(out.parent, "--out", out)
    scenario = evolved(file.content, spread={}, grid={}, cases={}, n=1).scenario()
    with LiveRun(scenario, sliders, host=host, port=port) as run, _until_interrupt():
        _print_address(run.url, host)
        threading.Event().wait()
    rollout = run.rollout()
    console.print(str(rollout))
    if out is None:
        console.print("to keep the run, repeat the command with --out run.npz")
    else:
        rollout.save(out)
        console.print(f"wrote {out}\nsee it move: pinmobile view {out}")
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
    console.print(f"wrote {folder}: {files}, CMakeLists.txt, README.md")
    for row in rows[1:]:
        label, _, value = row.strip("| ").partition(" | ")
        console.print(f"  {label:22} {value}")
    build = f"cc -std=c99 -O2 -ffp-contract=off {name}.c {name}_test.c -lm -o {name}_test"
    console.print(f"test it: cd {folder} && {build} && ./{name}_test")
    return 0


def _print_address(url: str, host: str) -> None:
    """Print the address of a page, and how another machine opens it."""
    number = url.split("://")[1].split("/")[0].rpartition(":")[2]
    console.print(
        f"open {url}\n"
        f"from another machine: ssh -L {number}:{host}:{number} {socket.gethostname()}\n"
        "and open the same address on that machine, with the host 127.0.0.1; Ctrl-C ends the server",
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
        console.print("\nended")


_COMMAND_COUNT = 2  # number of inputs of a robot with velocity inputs


def _roles(name: str, value: Any) -> dict[str, Any]:
    """Return names by role; several names are a list, or text with commas."""
    expected = f"{name}.ROLE=NAME,NAME, such as {name}.q=px,py,angle"
    for role, names in instance(name, value, Mapping, expected).items():
        if isinstance(names, bool) or not isinstance(names, (str, int, list)):
            raise InvalidArgument(f"{name}.{role} is {names!r}, expected NAME or NAME,NAME")
    return {role: _split_names(names) for role, names in value.items()}


def _split_names(names: Any) -> Any:
    return names.split(",") if isinstance(names, str) and "," in names else names


@part
class IdentifyPaths:
    """Options of an identification: the prior robot, and the form of the logs.

    Attributes
    ----------
    robot : MobileRobot, WheeledRobot or WheelTable, optional
        Prior robot, or its wheels alone; its inputs are the inputs of the logs.
    loads : sequence of PayloadBody or "none", optional
        Known load of each log: loads that differ identify the scale of the inputs.
    by : str or sequence of str, optional
        Numbers of the robot to estimate, by name or pattern.
    method : str
        See `identify`.
    delay : float, optional
        Delay of poses relative to inputs [s]; default: estimated.
    wheelbase : float, optional
        Known distance between the axles of a car [m]: the gain of its steering is estimated.
    rolling_speed : float, optional
        Speed at which dry friction has 71 % of its size [m/s], for wheels [rad/s].
    columns, topics : mapping of str to str or sequence of str, optional
        Columns of a CSV file, or topics of a bag, by role: t, q, u, twist, wheel_rates, joints.
    """

    robot: Any = child(object, optional=True, doc="robot, or its wheels alone", expected="a robot or wheels")
    loads: Any = attrs.field(default=None)
    by: Any = option(default=(), check=lambda _, x: _split_names(x), doc="numbers to estimate: NAME,NAME")
    method: str = option(default=METHODS[0], doc=f"method: {' or '.join(METHODS)}")
    delay: Any = number(default=None, unit="s", doc="delay of poses relative to inputs")
    wheelbase: Any = number(default=None, unit="m", doc="distance between the axles of a car")
    rolling_speed: Any = number(default=None, doc="speed at which dry friction has 71 % of its size")
    columns: Any = option(
        default=None, check=_roles, doc="columns of a CSV file by role: t, q, u, twist, wheel_rates, joints"
    )
    topics: Any = option(default=None, check=_roles, doc="topics of a bag or MCAP file by role")


def show_identification(words: Sequence[str], out: Path) -> int:
    """Print the estimates from logs, and draw the longest log beside its prediction.

    Two inputs without a robot are commands of speed and yaw rate, or of a car: speed and steering angle.

    Raises
    ------
    InvalidArgument, UnknownName
        If an entry or a log is invalid; the message names the file.
    """
    paths = [Path(word) for word in words if "=" not in word]
    if not paths:
        raise InvalidArgument("LOG is missing, expected at least one file, such as run.csv")
    given = LoadedFile([word for word in words if "=" in word], kind=IdentifyPaths).content
    folder = output_folder(out)
    logs = [_load_log(path, given) for path in paths]
    log, path = max(zip(logs, paths, strict=True), key=lambda each: len(each[0]))
    are_commands = log.u.shape[1] == _COMMAND_COUNT and given.robot is None
    loads = given.loads
    if loads is not None:
        expected = 'one for each log: ["none", "PayloadBody(mass, com, inertia)"]'
        loads = [None if each == "none" else each for each in sequence("loads", loads, expected)]
    method = one_of("method", given.method, METHODS)
    with progress(2) as bar, _name_files(paths):
        begin(bar, "identifying")
        if are_commands:
            options = {"by": given.by or None, "method": None if method == METHODS[0] else method}
            reason = "for a log of commands of speed and yaw rate"
            absent(reason, **options, loads=loads, rolling_speed=given.rolling_speed)
            result: Any = identify_velocity(logs, delay=given.delay, wheelbase=given.wheelbase)
        else:
            numbers = {name: getattr(given, name) for name in ("by", "delay", "rolling_speed")}
            result = identify(logs, given.robot, loads=loads, method=method, **numbers)
        begin(bar, "drawing")
        prediction, figure = result.predict(log), folder / f"{path.stem}.png"
        save_figure(plots.prediction(prediction, title=f"{path.name}: measured and predicted"), figure)
    for text in ([] if given.robot is None else [f"robot: {given.robot!r}"]) + [str(result), str(prediction)]:
        console.print(text)
    console.print(f"measured and predicted: open {figure}")
    return 0


def _load_log(path: Path, given: IdentifyPaths) -> Log:
    with _name_files([path]):
        if given.topics or path.suffix == ".mcap":
            return Log.from_bag(path, given.topics or None)
        return Log.from_csv(path, given.columns)


@contextmanager
def _name_files(paths: Sequence[Path]) -> Iterator[None]:
    """Replace the names of logs in errors by the names of their files."""
    try:
        yield
    except InvalidArgument as error:
        argument, text = error.argument, str(error)
        name, _, index = argument.rstrip("]").partition("[")
        if name in parameters(IdentifyPaths):
            raise
        for k, path in enumerate(paths):
            text = text.replace(f"log[{k}]", "log" if index == str(k) else repr(str(path)))
        named = [paths[int(index)]] if name == "log" and index else paths
        files = ", ".join(repr(str(path)) for path in named)
        ending = text.removeprefix("path is ").removeprefix(files) if name == "path" else f": {text}"
        raise InvalidArgument(f"LOG is {files}{ending}", argument="LOG") from error
