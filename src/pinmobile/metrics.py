"""`Metric`, what a plant states of a sample beside its errors; and sizes in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array, ArrayLike, one_of, sequence, shaped
from pinmobile.errors import InvalidArgument
from pinmobile.parts import Measuring, able

_WORST = ("largest", "smallest", "ever")
_SCALE = 2.0**-12  # of margins: below this, differences count; above it, ratios
_BEYOND = 2.0**20  # margins below minus this are as bad as any
_ROUNDING = 1e-12  # in SI units, of what a robot on the ground has


def in_words(size: float, form: str = ".4g") -> str:
    """Return a size in SI units as text; what is rounding as "< 1e-12", for there machines differ."""
    if 0 < abs(size) < _ROUNDING:
        return "< 1e-12" if size > 0 else "> -1e-12"
    return f"{size:{form}}"


class Metric(NamedTuple):
    """One of the numbers that a plant's ``evaluate_metrics`` gives for a sample.

    Attributes
    ----------
    name : str
        Such as ``"end effector"``: what `Ensemble.worst` and others call it.
    unit, meaning : str
        Its unit, "" for none, and what it is, in words.
    worst : str
        ``"largest"`` of a size, which is the worse the larger it is, whatever its sign; its sizes over time
        are told apart from 6e-11 to 1024. ``"smallest"`` of a margin, which is the worse the smaller it is,
        and may be negative; told apart from -512 to 512, near zero to 5e-6, elsewhere to 2 or 3 %. Choose
        the unit so that it fits. ``"ever"`` of an event, 1 where it happens, else 0: an ensemble counts and
        reports the robots to which it does.
    """

    name: str
    unit: str
    meaning: str
    worst: str = "largest"

    @property
    def is_margin(self) -> bool:
        """Whether it is the worse the smaller it is."""
        return self.worst == "smallest"

    @property
    def title(self) -> str:
        """Its name, with its unit where it has one."""
        return f"{self.name} [{self.unit}]" if self.unit not in ("", "1") else self.name


def size_of(margin: ArrayLike) -> Any:
    """Return a size > 0 that grows with a margin of any sign, to be counted in bins of a logarithm.

    That is m + sqrt(m^2 + c^2): its logarithm is asinh(m / c), near zero as a line and far from it as the
    logarithm of m or of -1 / m. So margins from -512 to 512 fall into the bins from 2^-34 to 2^10.
    """
    m = np.maximum(margin, -_BEYOND)
    return m + np.sqrt(m * m + _SCALE**2)


def value_of(size: Array) -> Array:
    """Return the margins whose `size_of` this is; of 0 minus infinity."""
    with np.errstate(divide="ignore"):
        return np.asarray((size - _SCALE**2 / size) / 2)


def metrics_of(plant: object) -> tuple[Metric, ...]:
    """Return the metrics of a plant, none of one without.

    Raises
    ------
    UnknownName
        If the worst of one is none of those of `Metric`.
    """
    stated = able(plant, Measuring)
    found = () if stated is None else tuple(stated.metrics)
    for one in found:
        one_of(f"worst of the metric {one.name!r}:", one.worst, _WORST)
    return found


def chosen(plant: object, names: object, taken: Sequence[str]) -> tuple[Metric, ...]:
    """Return the metrics of a plant that are asked for, in its order.

    Parameters
    ----------
    plant : plant
        Whose they are.
    names : sequence of str, or None
        Which; None: all.
    taken : sequence of str
        What else is called by a name, and judged.

    Raises
    ------
    InvalidArgument
        If `names` is something else, or a metric is called as something else is.
    UnknownName
        If the plant states no metric of a name.
    """
    stated = metrics_of(plant)
    every = [*taken, *(one.name for one in stated)]
    twice = next((name for name in every if every.count(name) > 1), None)
    if twice is not None:
        raise InvalidArgument(
            f"metrics of the plant, a {type(plant).__name__}, has {twice!r}, as an error or another metric "
            "is called, expected names that differ"
        )
    if names is None:
        return stated
    known = {one.name: one for one in stated}
    wanted = [one_of("metric", name, known) for name in sequence("metrics", names, "a sequence of names")]
    return tuple(one for one in stated if one.name in wanted)


def channels_of(coordinates: Sequence[Any], metrics: Sequence[Metric]) -> tuple[Metric, ...]:
    """Return what robots are compared by: errors of the reference's coordinates, and metrics.

    Parameters
    ----------
    coordinates : sequence of Coordinate
        Those that the reference has, x, y and psi first.
    metrics : sequence of Metric
        Those that are judged.
    """
    errors = [Metric(one.name, one.unit, f"error of {one.name}") for one in coordinates[3:]]
    return (
        Metric("distance", "m", "distance from the desired position"),
        Metric("heading", "rad", "error of the heading"),
        *errors,
        *metrics,
    )


def check_measured(plant: Any, q: Array, v: Array, reference: Any) -> None:
    """Refuse a plant whose metrics, at rest where it starts, have another shape or are no numbers.

    Parameters
    ----------
    plant : plant
        One that states metrics.
    q, v : ndarray, shape (nq,), (nv,)
        Where it starts.
    reference : Reference
        Of all samples.

    Raises
    ------
    InvalidArgument
        If it is such; infinity is a number.
    """
    first = type(reference)(*(x[0] for x in reference))
    found = evaluate_metrics_of(plant, np.zeros(()), q, v, np.zeros(plant.nv), np.zeros(plant.nu), first)
    for one, number in zip(metrics_of(plant), found, strict=True):
        if np.isnan(number):
            raise InvalidArgument(
                f"plant is a {type(plant).__name__}, whose evaluate_metrics(t, q, v, a, u, reference) "
                f"returned NaN as {one.name!r} where it starts, expected a number"
            )


def evaluate_metrics_of(plant: Any, t: Any, q: Any, v: Any, a: Any, u: Any, reference: Any) -> Any:
    """Return the metrics of a sample, shape (..., m), as the plant has them.

    Parameters
    ----------
    plant : plant
        One that states metrics.
    t : float
        Time [s].
    q, v, a, u : ndarray, shape (..., nq), (..., nv), (..., nv), (..., nu)
        State, acceleration and input.
    reference : Reference
        Of this sample.

    Raises
    ------
    InvalidArgument
        If it returns another shape.
    """
    copies = type(reference)(*(x.copy() for x in reference))
    found = plant.evaluate_metrics(t, q.copy(), v.copy(), a.copy(), u.copy(), copies)
    words = ": a number for each metric"
    asked = (
        f"what evaluate_metrics(t, q, v, a, u, reference) of the plant, a {type(plant).__name__}, returned,"
    )
    return shaped(asked, found, (*np.shape(v)[:-1], len(plant.metrics)), words=words)
