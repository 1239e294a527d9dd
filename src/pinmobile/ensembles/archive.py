"""An ensemble, to and from a NumPy archive: numbers with their names and units, parts in words."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import numpy as np

from pinmobile.arrays import Array, finite, text, whole
from pinmobile.ensembles.histogram import miscounted
from pinmobile.ensembles.outline import Outline
from pinmobile.ensembles.variables import PER_ROBOT, drawn, per_robot
from pinmobile.files import archive_of, unpacking
from pinmobile.simulation import Rollout
from pinmobile.simulation.storage import ARRAYS, described_run, restored_run, signal_columns
from pinmobile.trajectories import Reference

if TYPE_CHECKING:
    from pinmobile.ensembles.result import Ensemble

__all__ = ["read_ensemble", "write_ensemble"]

_FORMAT = "pinmobile ensemble 3"
_REFERENCE = tuple(f"reference_{name}" for name in Reference._fields)
_TRACE = tuple(f"trace_{name}" for name in ARRAYS)
_KINDS: Mapping[str, type] = {
    **dict.fromkeys(("t", *_REFERENCE, "draws", *PER_ROBOT), np.float64),
    "counts": np.int32,
    **dict.fromkeys((*_TRACE, "trace_signals"), np.float64),
}


def write_ensemble(file: IO[bytes], ensemble: "Ensemble") -> None:
    """Write an ensemble.

    The archive has the arrays of `PER_ROBOT` and ``counts``; ``draws`` with a row for each parameter; the
    traces one after the other, as ``trace_t`` and so on; times and reference; and ``description``, which
    tells, as JSON, what these are and what the parts were.

    Parameters
    ----------
    file : binary file
        Where to.
    ensemble : Ensemble
        What is written.
    """
    outline, traces = Outline.of(ensemble.scenario), ensemble.traces
    variables = {**per_robot(outline), **drawn(outline.parameters)}
    described = {
        "scenario": outline.description(),
        "engine": ensemble.engine,
        "why": ensemble.why,
        "variables": {name: one._asdict() for name, one in variables.items()},
        "traces": [
            {"index": i, "samples": len(one), "plant": described_run(one)} for i, one in traces.items()
        ],
    }
    recorded = [one.arrays() for one in traces.values()]
    beside = [signal_columns(one.signals, len(one)) for one in traces.values()]
    empty = {name: np.zeros(0 if name == "t" else (0, len(outline.coordinates))) for name in ARRAYS}
    np.savez(
        file,
        allow_pickle=False,
        format=_FORMAT,
        description=json.dumps(described),
        t=outline.t,
        **dict(zip(_REFERENCE, outline.reference, strict=True)),
        draws=np.array(list(ensemble.draws.values())).reshape(len(ensemble.draws), len(ensemble)),
        **{name: getattr(ensemble, name) for name in (*PER_ROBOT, "counts")},
        **{
            of: np.concatenate([one[name] for one in recorded or [empty]])
            for of, name in zip(_TRACE, ARRAYS, strict=True)
        },
        trace_signals=np.concatenate(beside or [np.zeros((0, 0))]),
    )


def read_ensemble(path: Path) -> dict[str, Any]:
    """Return the fields of the `Ensemble` that `write_ensemble` wrote.

    Raises
    ------
    InvalidArgument
        If the file cannot be read or is no such archive.
    FileError
        If the system fails.
    """
    named, described = archive_of(path, _FORMAT, "description", _KINDS)
    with unpacking(path, _FORMAT):
        reference = Reference(*(named[name] for name in _REFERENCE))
        outline = Outline.from_description(described["scenario"], named["t"], reference)
        _check(named, outline)
        return {
            "scenario": outline,
            "engine": text("engine", described["engine"]),
            "why": text("why", described["why"]),
            "draws": dict(zip(outline.parameters, named["draws"], strict=True)),
            "traces": _traces(named, described["traces"], outline),
            **{name: named[name] for name in (*PER_ROBOT, "counts")},
        }


def _check(named: Mapping[str, Array], outline: Outline) -> None:
    """Refuse records that no robots have."""
    n, diverged = outline.n, named["diverged_at"]
    sizes = {"diverged_at": (), "max_distance": (), "max_force": (len(outline.inputs),)}
    sizes |= dict.fromkeys(("max_error", "rms_error"), (len(outline.coordinates),))
    sizes |= dict.fromkeys(("worst_measure", "rms_measure"), (len(outline.judged),))
    margins = [one.is_margin for one in outline.judged]
    for name in PER_ROBOT:
        values, shape = named[name], (n, *sizes[name])
        if values.shape != shape:
            raise ValueError(f"{name} has shape {values.shape}, expected {shape}")
        if (values < 0).any(where=~np.array(margins, bool) if name == "worst_measure" else True):
            raise ValueError(f"{name} has {np.nanmin(values)}, expected none below 0")
    for name in PER_ROBOT:
        if name != "diverged_at" and np.isnan(named[name][np.isnan(diverged)]).any():
            raise ValueError(f"{name} has nan of a robot that did not diverge")
    if not np.isin(diverged[~np.isnan(diverged)], outline.t).all():
        raise ValueError("diverged_at has what is no time of t")
    if named["draws"].shape != (len(outline.parameters), n):
        raise ValueError(f"draws has shape {named['draws'].shape}, expected {(len(outline.parameters), n)}")
    finite("draws", named["draws"])
    why = miscounted(named["counts"], len(outline.grid), len(outline.channels), n)
    if why:
        raise ValueError(f"it {why}")


def _traces(named: Mapping[str, Array], described: Any, outline: Outline) -> dict[int, Rollout]:
    """Return the traces, by the index of their robot."""
    found: dict[int, Rollout] = {}
    start = 0
    for one in described:
        index, stop = whole("index", one["index"], least=0), start + whole("samples", one["samples"])
        if index >= outline.n or index in found:
            raise ValueError(f"it has a trace of robot {index}, expected 0 to {outline.n - 1}, each once")
        if stop > len(named["trace_t"]):
            raise ValueError(f"trace_t has {len(named['trace_t'])} samples, expected {stop} and more")
        arrays = {name: named[of][start:stop] for of, name in zip(_TRACE, ARRAYS, strict=True)}
        made = restored_run(one["plant"], named["trace_signals"][start:stop])
        found[index] = Rollout.of(arrays, **made)
        start = stop
    for name in (*_TRACE, "trace_signals"):
        if len(named[name]) != start:
            raise ValueError(f"{name} has {len(named[name])} samples, expected {start}")
    return found
