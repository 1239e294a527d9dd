"""Many loops at once: `ensemble` and `sweep`, what came of them, and figures."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import typer

from pinmobile import Ensemble, InvalidArgument, Same, Scenario, sweep
from pinmobile.arrays import whole
from pinmobile.cli.interrupted import Interrupted
from pinmobile.cli.many_figures import ensemble_figures, sweep_figures
from pinmobile.cli.output import Section, console, index_page, output_folder, progress
from pinmobile.cli.scenario_file import read_grid
from pinmobile.cli.spreads import loop_of, scenario, spread_of_words, without_model
from pinmobile.ensembles import run_scenario
from pinmobile.sweeps import Code, Grid, connected
from pinmobile.sweeps.reading import attributes_of
from pinmobile.sweeps.table import compared, since

__all__ = ["run_options", "show_ensemble", "show_sweep"]

_NAMES = {"pd": "PD", "computed-torque": "computed torque"}
_OF_ONE = ("kp", "kd")


def run_options(words: Sequence[str], app: typer.Typer, name: str) -> tuple[dict[str, Any], bool]:
    """Return the options of `run` in some words, and whether a controller is among them.

    Raises
    ------
    InvalidArgument
        If one does not apply to many robots.
    """
    for word in words:
        if word.split("=")[0] in ("--gif", "--no-gif", "--html", "--no-html"):
            raise InvalidArgument(f"{word} does not apply to {name}, which draws no single robot")
    command: Any = typer.main.get_command(app)
    context = command.commands["run"].make_context(name, list(words))
    given = context.get_parameter_source("controller")
    return context.params, given is not None and given.name == "COMMANDLINE"


def show_ensemble(
    options: Mapping[str, Any],
    spread: Sequence[str],
    folder: Path,
    *,
    n: int,
    seed: int,
    after: float,
    one: bool,
) -> int:
    """Run the ensembles of one controller or of both, print who stays within what, and draw it."""
    wanted = spread_of_words(spread)
    names = [str(options["controller"])] if one else list(_NAMES)
    if not one:
        for name in _OF_ONE:
            if options[name] is not None:
                raise InvalidArgument(f"--{name} does not apply to both controllers, expected --controller")
    drawn: dict[str, Any] = {"n": n, "seed": seed, "after": after}
    loops = {_NAMES.get(name, name): _loop(options, wanted, name, drawn, one=one) for name in names}
    _warn_if_alike(loops.values())
    made: dict[str, Ensemble] = {}
    with progress(n * len(loops)) as bar:
        for k, (label, loop) in enumerate(loops.items()):

            def advance(done: int, _: int, before: int = k * n, label: str = label) -> None:
                bar.update(bar.task_ids[0], description=label, completed=before + done)

            made[label] = run_scenario(loop, progress=advance)
    text = "\n\n".join(f"{label}\n{ensemble}" for label, ensemble in made.items())
    console.print(text, markup=False)
    answer = since(after) + _answer(made, spread)
    console.print(f"\n{answer}", markup=False)
    pictures = ensemble_figures(made, folder)
    page = index_page(folder, answer, [Section("What came of it", text, pictures)])
    console.print(f"open {page}", markup=False)
    return 0


def show_sweep(
    file: Path, out: Path | None, scheduler: str | None, chunk: int | None, *, allow_code: bool = False
) -> int:
    """Run the sweep of a file, print who stays within what, and draw it."""
    if not allow_code:
        return _show_sweep(file, read_grid(file), out, scheduler, chunk)
    code = Code(file.absolute().parent)
    with code.errors():
        grid = read_grid(file, code)
        _tell_loaded(code)
        return _show_sweep(file, grid, out, scheduler, chunk)


def _tell_loaded(code: Code) -> None:
    """Say which files were run, and which modules of the same name were not."""
    hidden = code.hidden()
    for name, (where, _) in code.sources.items():
        beside = f", not the installed {name} ({hidden[name]})" if name in hidden else ""
        console.print(f"ran {where}{beside}", markup=False)
    for name, where in code.installed.items():
        console.print(f"ran {where}, the installed {name}", markup=False)


def _show_sweep(file: Path, grid: Grid, out: Path | None, scheduler: str | None, chunk: int | None) -> int:
    folder = output_folder(Path("out") / file.stem if out is None else out)
    store = folder / "sweep.zarr"
    size = _size(chunk, store)
    _warn_if_alike(grid.scenarios)
    client = None if scheduler is None else connected(scheduler)
    try:
        with progress(len(grid) * grid.n) as bar:

            def advance(done: int, total: int) -> None:
                bar.update(bar.task_ids[0], description="sweeping", completed=done, total=total)

            found = sweep(grid, store, client=client, chunk=size, progress=advance)
    except KeyboardInterrupt:
        raise Interrupted("interrupted: the same command goes on where it was") from None
    finally:
        if client is not None:
            client.close()
    console.print(found.table(), markup=False)
    answer = found.answer()
    console.print(f"\n{answer}", markup=False)
    page = index_page(
        folder, answer, [Section("What came of it", found.table(most=1000), sweep_figures(found, folder))]
    )
    console.print(
        f"wrote {store}: xarray.open_zarr reads it, and pinmobile.Sweep.open\nopen {page}", markup=False
    )
    return 0


def _loop(
    options: Mapping[str, Any],
    spread: Mapping[str, Any],
    name: str,
    drawn: Mapping[str, Any],
    *,
    one: bool,
) -> Scenario:
    options = {**options, "controller": name}
    if name == "pd" and not one:
        options, spread = without_model(options, spread)
    return scenario(loop_of(options), spread, **drawn)


def _answer(made: Mapping[str, Ensemble], spread: Sequence[str]) -> str:
    """Say who stays within what; what only the controller's model differs in belongs to that controller."""
    believed = [word for word in spread if word.startswith("model_")]
    shared = [word for word in spread if word not in believed] if len(made) > 1 else spread
    with_ = f"with {' and '.join(shared)}, " if shared else ""
    within = {label: each.within(0.99).distance for label, each in made.items()}
    diverged = {label: int(each.diverged.sum()) for label, each in made.items()}
    told = with_ + compared(within, 0.99, diverged, len(next(iter(made.values()))))
    if believed and len(made) > 1:
        told += f" ({' and '.join(believed)} for computed torque alone: PD believes in no model)"
    return told


def _warn_if_alike(scenarios: Iterable[Scenario]) -> None:
    """Say that robots are alike where nothing makes them differ, of ensembles of several."""
    if all(each.n > 1 and not any(map(_differs, each.spread.values())) for each in scenarios):
        console.print("nothing is spread: all robots are alike\n", markup=False)


def _differs(source: Any) -> bool:
    """Tell whether a source gives robots different numbers, by itself."""
    if isinstance(source, Same):
        return _differs(source.factor)
    return not (isinstance(source, np.ndarray) and source.ndim == 0)


def _size(chunk: int | None, store: Path) -> int | None:
    """Return the robots in a chunk; a store that is there keeps its own."""
    if chunk is None:
        return None
    size = whole("--chunk", chunk)
    if (store / "zarr.json").exists():
        there = attributes_of(store)["chunk"]
        if there != size:
            raise InvalidArgument(
                f"--chunk is {size}, expected {there} as in the store {str(store)!r}, or no --chunk"
            )
    return size
