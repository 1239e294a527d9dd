"""Many loops at once: `ensemble` and `sweep`, what they answer, and their figures."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from pinmobile import Ensemble, InvalidArgument, Same, Scenario, UnknownName, plots
from pinmobile.arrays import Array
from pinmobile.cli.choices import COMPARED, CONTROLLERS, SPREAD_FORMS
from pinmobile.cli.options import (
    Interrupted,
    Options,
    alone,
    as_option,
    check_lacking,
    closed_loop,
    numbers,
    scenario,
    without_model,
)
from pinmobile.cli.output import Picture, Section, console, index_page, output_folder, progress, save_figure
from pinmobile.cli.scenario_file import read_grid
from pinmobile.cli.tables import Code
from pinmobile.loop import run_scenario
from pinmobile.sweeps import Points, Sweep, compared, connected, run_points, since

_MOST = 12  # figures of a sweep
_UNITS = (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6))


def spread_of_words(words: Sequence[str]) -> dict[str, Any]:
    """Return what ``name=kind:numbers`` stands for, in the form of a scenario file.

    Raises
    ------
    InvalidArgument
        If the words are something else.
    """
    found: dict[str, Any] = {}
    for word in words:
        name, equals, rest = word.partition("=")
        kind, colon, values = rest.partition(":")
        if not equals or not rest or (colon and not values):
            raise InvalidArgument(f"--spread is {word!r}, expected NAME=FORM with the form {SPREAD_FORMS}")
        if name in found:
            times = sum(other.partition("=")[0] == name for other in words)
            raise InvalidArgument(f"--spread {name} is given {times} times, expected once")
        told = as_option(f"spread.{name}")
        if not colon:
            found[name] = alone(numbers(told, kind))
        elif kind == "same":
            other, _, factor = values.partition(",")
            found[name] = {"same": other, **({"factor": alone(numbers(told, factor))} if factor else {})}
        else:
            first, *others = numbers(told, values)
            found[name] = {kind: [first, *others] if others else first}
    return found


def show_ensemble(
    options: Options,
    spread: Sequence[str],
    folder: Path,
    *,
    one: bool,
    n: int,
    seed: int,
    after: float,
) -> int:
    """Run the ensembles of one controller or of both, print who stays within what, and draw it.

    Parameters
    ----------
    options : Options
        Those of `run`.
    spread : sequence of str
        What differs, as it was typed.
    folder : Path
        Where figures and their index page go.
    one : bool
        Whether one controller was asked for.
    n, seed, after
        As of a `Scenario`.
    """
    wanted = spread_of_words(spread)
    names = [str(options["controller"])] if one else list(COMPARED)
    if not one:
        gains = [name for choice in CONTROLLERS.values() for name in choice.takes]
        options.refuse(gains, "does not apply to both controllers, expected --controller")
    drawn: dict[str, Any] = {"n": n, "seed": seed, "after": after}
    lacks: dict[str, UnknownName] | None = None if one else {}
    loops = {_label(name): _loop(options, wanted, name, drawn, lacks) for name in names}
    check_lacking(lacks or {}, {name for loop in loops.values() for name in loop.spread})
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
    page = index_page(folder, answer, [Section("Results", text, pictures)])
    console.print(f"open {page}", markup=False)
    return 0


def show_sweep(
    file: Path,
    out: Path | None,
    scheduler: str | None,
    chunk: int | None,
    *,
    allow_code: bool = False,
    version: str | None = None,
) -> int:
    """Run the sweep of a file, print who stays within what, and draw it."""
    code = Code(file.absolute().parent) if allow_code else None
    return _show_sweep(file, read_grid(file, code), out, scheduler, chunk, version)


def _show_sweep(
    file: Path, grid: Points, out: Path | None, scheduler: str | None, chunk: int | None, version: str | None
) -> int:
    folder = output_folder(Path("out") / file.stem if out is None else out)
    store = folder / "sweep.zarr"
    _warn_if_alike(grid.scenarios)
    client = None if scheduler is None else connected(scheduler)
    try:
        with progress(len(grid.scenarios) * grid.n) as bar:

            def advance(done: int, total: int) -> None:
                bar.update(bar.task_ids[0], description="sweeping", completed=done, total=total)

            found = run_points(grid, store, client=client, chunk=chunk, progress=advance, version=version)
    except KeyboardInterrupt:
        raise Interrupted("interrupted: the same command goes on where it was") from None
    finally:
        if client is not None:
            client.close()
    console.print(found.table(), markup=False)
    answer = found.answer()
    console.print(f"\n{answer}", markup=False)
    section = Section("Results", found.table(most=1000), sweep_figures(found, folder))
    page = index_page(folder, answer, [section])
    console.print(
        f"wrote {store}: xarray.open_zarr reads it, and pinmobile.Sweep.open\nopen {page}", markup=False
    )
    return 0


def _label(name: str) -> str:
    return CONTROLLERS[name].label if name in CONTROLLERS else name


def _loop(
    options: Options,
    spread: Mapping[str, Any],
    name: str,
    drawn: Mapping[str, Any],
    lacks: dict[str, UnknownName] | None,
) -> Scenario:
    options = options.with_values(controller=name)
    if lacks is not None and not CONTROLLERS[name].believes:
        options = without_model(options)
    return scenario(closed_loop(options), spread, as_option, lacks=lacks, **drawn)


def _answer(made: Mapping[str, Ensemble], spread: Sequence[str]) -> str:
    """Say who stays within what; what only the controller's model differs in belongs to that controller."""
    of_all = set[str].intersection(*(set(each.scenario.spread) for each in made.values()))
    believed = [word for word in spread if word.partition("=")[0] not in of_all]
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


def _differs(source: object) -> bool:
    """Return whether a source gives robots different numbers, by itself."""
    if isinstance(source, Same):
        return _differs(source.factor)
    return not (isinstance(source, np.ndarray) and source.ndim == 0)


def ensemble_figures(made: Mapping[str, Ensemble], folder: Path) -> list[Picture]:
    """Draw the bands of all ensembles, and of each what its worst robots have in common."""
    save_figure(plots.bands(made), folder / "bands.png")
    found = [Picture("bands.png", "Errors over time: what half, 90 % and 99 % of the robots stay within.")]
    for label, ensemble in made.items():
        file = f"drivers-{label.lower().replace(' ', '-')}.png"
        try:
            figure = plots.drivers(ensemble, share=max(0.05, 1 / len(ensemble)))
        except InvalidArgument:  # the robots are alike, or too few
            continue
        figure.suptitle(f"{label}: {figure.get_suptitle()}", fontsize=14)
        save_figure(figure, folder / file)
        found.append(Picture(file, f"{label}: what the robots that strayed farthest have in common."))
    return found


def sweep_figures(found: Sweep, folder: Path) -> list[Picture]:
    """Draw what 99 % of the robots stay within: curves over one axis of numbers, otherwise maps of two.

    Of further axes there is a figure for each value; maps have the same colours for the same numbers.
    """
    within = found.within()
    long = [name for name, axis in found.axes.items() if len(axis.values) > 1]
    numeric = [name for name in long if within[name].dtype.kind in "fiu"]
    named = [name for name in long if name not in numeric]
    curved = len(numeric) == 1
    drawn = [*named[-1:], *numeric] if curved else (numeric if len(numeric) > 1 else long)[-2:]
    if not drawn or (not curved and len(drawn) < 2):
        return []
    values = within.isel({name: 0 for name in found.axes if name not in long})
    unit, size = _unit(values.values)
    known = values.values[np.isfinite(values.values)] / size
    limits = (float(known.min()), float(known.max())) if known.size else None
    pictures = []
    for k, (where, part) in enumerate(_slices(values / size, [name for name in long if name not in drawn])):
        if k == _MOST:
            break
        label = f"99 % stay within [{unit}]"
        part = part.transpose(*drawn)
        if curved:
            figure = _curves(found, part, drawn, title=where or None, label=label)
        else:
            figure = _map(found, part, drawn, title=where or label, label=label, limits=limits)
        save_figure(figure, folder / f"within-{k}.png")
        caption = f"{where}{where and ': '}{label}, over {' and '.join(drawn[::-1])}."
        pictures.append(Picture(f"within-{k}.png", caption))
    return pictures


def _curves(found: Sweep, part: Any, drawn: list[str], *, title: str | None, label: str) -> Figure:
    *named, x = drawn
    names = [str(one) for one in found.axes[named[0]].values] if named else [""]
    rows = dict(zip(names, np.reshape(part.values, (len(names), -1)), strict=True))
    return plots.curves(rows, x=_axis(found, x), label=label, title=title)


def _map(found: Sweep, part: Any, drawn: list[str], **options: Any) -> Figure:
    y, x = (_axis(found, name) for name in drawn)
    return plots.heatmap(part.values, x=x, y=y, **options)


def _axis(found: Sweep, name: str) -> tuple[str, str, Any]:
    axis = found.axes[name]
    return name, axis.unit, list(axis.values)


def _slices(values: Any, names: list[str]) -> Iterator[tuple[str, Any]]:
    """Yield the parts for each value of some axes, and in words which they are."""
    for index in np.ndindex(*(values.sizes[name] for name in names)):
        where = dict(zip(names, index, strict=True))
        words = [_told(name, np.asarray(values[name])[i]) for name, i in where.items()]
        yield ", ".join(words), values.isel(where)


def _told(name: str, value: str | float) -> str:
    return str(value) if isinstance(value, str) else f"{name} = {value:g}"


def _unit(values: Array) -> tuple[str, float]:
    """Return the unit in which the largest number that is bounded is read best, and its size [m]."""
    known = values[np.isfinite(values)]
    largest = float(known.max()) if known.size else 1.0
    return next(((unit, size) for unit, size in _UNITS if largest >= size), _UNITS[-1])
