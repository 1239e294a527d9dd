"""The figures of `ensemble` and `sweep`."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from pinmobile import Ensemble, InvalidArgument, plots
from pinmobile.cli.output import Picture, save_figure
from pinmobile.sweeps import Sweep

__all__ = ["ensemble_figures", "sweep_figures"]

_MOST = 12  # figures of a sweep
_UNITS = (("m", 1.0), ("mm", 1e-3), ("um", 1e-6))


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
    long = [name for name, axis in found.axes.items() if len(axis) > 1]
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


def _told(name: str, value: Any) -> str:
    return str(value) if isinstance(value, str) else f"{name} = {value:g}"


def _unit(values: Any) -> tuple[str, float]:
    """Return the unit in which the largest number that is bounded is read best, and its size [m]."""
    known = values[np.isfinite(values)]
    largest = float(known.max()) if known.size else 1.0
    return next(((unit, size) for unit, size in _UNITS if largest >= size), _UNITS[-1])
