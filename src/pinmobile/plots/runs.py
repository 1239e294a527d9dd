"""What is drawn: the rollouts by label, and which of their samples a line needs."""

from collections.abc import Mapping
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument, shown
from pinmobile.simulation import Rollout

__all__ = ["Rollouts", "labelled", "named", "planar", "same_references", "thinned"]

Rollouts: TypeAlias = Rollout | Mapping[str, Rollout]

_Kind = TypeVar("_Kind")

_MOST = 4000  # samples drawn as they are
_BINS = 1000  # of a longer rollout; more than a figure has columns of pixels


def labelled(rollouts: Any) -> dict[str, Rollout]:
    """Return the rollouts by label; a single one has the label "".

    Parameters
    ----------
    rollouts : Rollout or mapping of str to Rollout
        What a caller wants drawn.

    Raises
    ------
    InvalidArgument
        If it is something else, or holds nothing.
    """
    return named("rollouts", rollouts, Rollout)


def named(argument: str, values: Any, kind: type[_Kind]) -> dict[str, _Kind]:
    """Return what is drawn by label; a single one has the label "".

    Parameters
    ----------
    argument : str
        Name of the argument, for the message.
    values : object or mapping of str to object
        What a caller wants drawn.
    kind : type
        What each must be.

    Raises
    ------
    InvalidArgument
        If it is something else, or holds nothing.
    """
    what = kind.__name__
    one = f"{'an' if what[0] in 'AEIOU' else 'a'} {what}"
    if isinstance(values, kind):
        return {"": values}
    if not isinstance(values, Mapping):
        raise InvalidArgument(
            f"{argument} is a {type(values).__name__}, expected {one} or a mapping of labels to {what}s"
        )
    if not values:
        raise InvalidArgument(f"{argument} is empty, expected at least one {what}")
    for label, value in values.items():
        if not isinstance(label, str) or not label:
            raise InvalidArgument(f"{argument} has the label {shown(label)}, expected a name")
        if not isinstance(value, kind):
            raise InvalidArgument(f"{argument}[{label!r}] is a {type(value).__name__}, expected {one}")
    return dict(values)


def planar(rollouts: Any) -> dict[str, Rollout]:
    """Return `labelled` rollouts, each of which has a pose (x, y, psi) to be drawn.

    Raises
    ------
    InvalidArgument
        If the plant of one does not tell where its body is, or as `labelled` does.
    """
    runs = labelled(rollouts)
    for label, run in runs.items():
        try:
            _ = run.poses
        except InvalidArgument as error:
            name = f"rollouts[{label!r}]" if label else "rollouts"
            raise InvalidArgument(f"{name}.{error}") from None
    return runs


def same_references(runs: Mapping[str, Rollout]) -> dict[bytes, list[str]]:
    """Return the labels of the rollouts in groups, each with one reference over the same times."""
    groups: dict[bytes, list[str]] = {}
    for label, run in runs.items():
        groups.setdefault(run.t.tobytes() + run.reference.q.tobytes(), []).append(label)
    return groups


def thinned(*columns: Array) -> NDArray[np.intp]:
    """Return the indices of the samples that a line needs, in order, its extremes among them.

    All samples of a short rollout; of a long one the first and last, and in each of 1000 stretches those
    where a column is smallest and largest. So no peak is lost, however short.

    Parameters
    ----------
    *columns : ndarray, shape (N,)
        What is drawn; for a curve in the plane, both its coordinates.
    """
    count = len(columns[0])
    if count <= _MOST:
        return np.arange(count)
    width = -(-count // _BINS)
    stretches = -(-count // width)
    starts = width * np.arange(stretches)
    kept = [np.array([0, count - 1])]
    for column in columns:
        padded = np.pad(column, (0, width * stretches - count), mode="edge").reshape(stretches, width)
        kept += [starts + padded.argmin(axis=1), starts + padded.argmax(axis=1)]
    return np.unique(np.minimum(np.concatenate(kept), count - 1))
