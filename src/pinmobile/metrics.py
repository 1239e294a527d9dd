"""`Metric`, a number that ranks runs beside their errors; and quantities as text."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array, ArrayLike, callable_as, distinct, one_of, sequence, shaped, text
from pinmobile.parts import Measuring, able

_WORST_KINDS = ("largest", "smallest", "ever")
_SCALE = 2.0**-12  # bins of margins are linear below this size and logarithmic above
_MAX_SIZE = 2.0**30  # margins beyond this size count as equal
_ROUNDING_ERROR = 1e-12  # SI units; smaller quantities of a ground robot are rounding errors


def format_si(size: float, form: str = ".4g") -> str:
    """Return a quantity in SI units as text.

    A quantity of the size of rounding errors becomes ``"< 1e-12"``, because machines differ there.

    Parameters
    ----------
    size : float
        Quantity in SI units.
    form : str
        Format of the number.

    Returns
    -------
    str
        Text without unit.

    Examples
    --------
    >>> from pinmobile.metrics import format_si
    >>> format_si(0.123456), format_si(3e-15)
    ('0.1235', '< 1e-12')
    """
    if 0 < abs(size) < _ROUNDING_ERROR:
        return "< 1e-12" if size > 0 else "> -1e-12"
    return f"{size:{form}}"


class Metric(NamedTuple):
    """Description of one number of each sample, which the plant's ``evaluate_metrics`` or a function returns.

    Attributes
    ----------
    name : str
        Name, such as ``"end effector"``. `Ensemble.worst` and other methods use it.
    unit : str
        Unit, "" for none.
    meaning : str
        Meaning as a noun phrase.
    worst : str
        Rule that selects the worst value. ``"largest"``: a size, whose largest absolute value is the worst.
        The bins over time resolve sizes from 6e-11 to 1024. ``"smallest"``: a margin, whose smallest value is
        the worst; it may be negative. The bins resolve margins from -512 to 512, to 5e-6 near zero and to 2
        or 3 % elsewhere. Choose a unit in which the values fit. ``"ever"``: an event, 1 where it happens and
        0 elsewhere. An ensemble counts the robots in which it happens, and reports their number.
    function : callable or None
        Function of a `loop.Sample` that returns the number, for a metric of your own, see `ensemble`. It is
        compiled like a law. None: a metric of the plant.

    See Also
    --------
    ensemble : run many robots with metrics of your own.
    Ensemble.largest : worst value of each robot.
    parts.Measuring : plants with metrics.

    Examples
    --------
    >>> from pinmobile.metrics import Metric
    >>> margin = Metric("clearance", "m", "distance", "smallest")
    >>> margin.title, margin.is_margin
    ('clearance [m]', True)
    """

    name: str
    unit: str
    meaning: str
    worst: str = "largest"
    function: Callable[[Any], Any] | None = None

    @property
    def is_margin(self) -> bool:
        """Whether the smallest value is the worst."""
        return self.worst == "smallest"

    @property
    def title(self) -> str:
        """Name and, if there is one, unit."""
        return f"{self.name} [{self.unit}]" if self.unit not in ("", "1") else self.name


def size_of(margin: ArrayLike) -> Any:
    """Return a positive size that increases with a margin of any sign, for bins of a logarithm.

    The size is m + sqrt(m^2 + c^2). Its logarithm is asinh(m / c) plus a constant: linear near zero, and the
    logarithm of m or of -1 / m elsewhere. Margins from -2^29 to 2^29 thus fall into the bins from 2^-54 to
    2^30.

    Parameters
    ----------
    margin : array_like, any shape
        Margins.

    Returns
    -------
    ndarray, same shape
        Sizes > 0.

    See Also
    --------
    metrics.value_of : inverse function.

    Examples
    --------
    >>> from pinmobile.metrics import size_of, value_of
    >>> bool(size_of(-0.1) < size_of(0.0) < size_of(0.1))
    True
    >>> float(value_of(size_of(-0.1)))
    -0.1
    """
    m = np.clip(margin, -_MAX_SIZE, _MAX_SIZE)
    size = abs(m) + np.sqrt(m * m + _SCALE**2)
    return np.where(m < 0.0, _SCALE**2 / size, size)  # a difference would lose its digits


def value_of(size: Array) -> Array:
    """Return the margins of sizes: the inverse of `size_of`.

    Parameters
    ----------
    size : ndarray, any shape
        Sizes >= 0.

    Returns
    -------
    ndarray, same shape
        Margins; minus infinity for the size 0.

    See Also
    --------
    metrics.size_of : inverse function.

    Examples
    --------
    >>> from pinmobile.metrics import size_of, value_of
    >>> float(value_of(size_of(0.25)))
    0.25
    """
    with np.errstate(divide="ignore"):
        return np.asarray((size - _SCALE**2 / size) / 2)


def metrics_of(plant: object) -> tuple[Metric, ...]:
    """Return the metrics of a plant, an empty tuple if it has none.

    Parameters
    ----------
    plant : plant
        Plant, with the attribute ``metrics`` or without it.

    Returns
    -------
    tuple of Metric
        Metrics in the order of the plant.

    Raises
    ------
    UnknownName
        If the attribute ``worst`` of a metric is not one of those that `Metric` lists.

    See Also
    --------
    metrics.Metric : description of a metric.

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> from pinmobile.metrics import metrics_of
    >>> metrics_of(MobileRobot(mass=30.0, yaw_inertia=1.3))
    ()
    """
    provider = able(plant, Measuring)
    metrics = () if provider is None else tuple(provider.metrics)
    for metric in metrics:
        check_metric(metric)
    return metrics


def check_metric(metric: Metric) -> None:
    """Raise `UnknownName` if the attribute ``worst`` of a metric is not one of those that `Metric` lists."""
    one_of(f"worst of the metric {text('name of a metric', metric.name)!r}:", metric.worst, _WORST_KINDS)


def select_metrics(plant: object, selected: object, reserved: Sequence[str]) -> tuple[Metric, ...]:
    """Return the selected metrics: those of a plant, in its order, then those with functions.

    Parameters
    ----------
    plant : plant
        Plant with metrics.
    selected : sequence of str and Metric, mapping of str to callable, or None
        Selected metrics; those of a mapping are in addition to all of the plant; None: all of the plant.
    reserved : sequence of str
        Names of the errors, which no metric may have.

    Returns
    -------
    tuple of Metric
        Selected metrics.

    Raises
    ------
    InvalidArgument
        If `selected` is anything else, or a metric has the name of an error or of another metric.
    UnknownName
        If the plant has no metric of a name.

    Examples
    --------
    >>> from pinmobile import MobileRobot
    >>> from pinmobile.metrics import select_metrics
    >>> select_metrics(MobileRobot(30.0, 1.3), None, ["distance"])
    ()
    """
    plant_metrics = metrics_of(plant)
    if selected is None:
        entries: list[Any] = [one.name for one in plant_metrics]
    elif isinstance(selected, Mapping):
        user_metrics = [
            one._replace(name=name) if isinstance(one, Metric) else Metric(name, "", name, function=one)
            for name, one in selected.items()
        ]
        entries = [*(one.name for one in plant_metrics), *user_metrics]
    elif isinstance(selected, Metric):
        entries = [selected]
    else:
        entries = list(sequence("metrics", selected, 'a sequence of names or Metrics, or {"name": function}'))
    user_metrics = [one for one in entries if isinstance(one, Metric) and one.function is not None]
    for one in user_metrics:
        check_metric(one)
        callable_as(f"metrics[{one.name!r}](sample)", one.function, "a function of a sample")
    by_name, user_names = {one.name: one for one in plant_metrics}, [one.name for one in user_metrics]
    names = [one.name if isinstance(one, Metric) else one for one in entries]
    for name in names:
        if name not in user_names:
            one_of("metric", name, by_name)
    all_names = [*reserved, *(one.name for one in (*plant_metrics, *user_metrics))]
    for listed in (names, all_names):
        owners = f"errors ({', '.join(reserved)}) and metrics of the plant, a {type(plant).__name__}"
        distinct("metrics has", listed, f", also from those of {owners}")
    return (*(one for one in plant_metrics if one.name in names), *user_metrics)


def channels_of(coordinates: Sequence[Any], metrics: Sequence[Metric]) -> tuple[Metric, ...]:
    """Return the quantities that rank robots: errors of the reference's coordinates, and metrics.

    Parameters
    ----------
    coordinates : sequence of Coordinate
        Coordinates of the reference; x, y and psi first.
    metrics : sequence of Metric
        Recorded metrics.

    Returns
    -------
    tuple of Metric
        Distance, heading, errors of further coordinates, and the metrics.

    Examples
    --------
    >>> from pinmobile.metrics import channels_of
    >>> from pinmobile.plant import Coordinate
    >>> named = [Coordinate(x, "m") for x in ("x", "y", "psi")]
    >>> [one.title for one in channels_of(named, ())]
    ['distance [m]', 'heading [rad]']
    """
    errors = [Metric(x.name, x.unit, f"error of {x.name}") for x in coordinates[3:]]
    return (
        Metric("distance", "m", "distance from the desired position"),
        Metric("heading", "rad", "error of the heading"),
        *errors,
        *metrics,
    )


def evaluate_metrics_of(plant: Any, t: Any, q: Any, v: Any, a: Any, u: Any, reference: Any) -> Any:
    """Return the metrics of a sample, in the order of the plant.

    Parameters
    ----------
    plant : plant
        Plant with metrics.
    t : float
        Time [s].
    q, v, a, u : ndarray, shape (..., nq), (..., nv), (..., nv), (..., nu)
        Configuration, velocity, acceleration and input.
    reference : Reference
        Reference at this time.

    Returns
    -------
    ndarray, shape (..., m)
        Values of the metrics.

    Raises
    ------
    InvalidArgument
        If ``evaluate_metrics`` returns another shape.

    See Also
    --------
    Rollout.metrics : metrics of all samples.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import Circle, MobileRobot, Tangent
    >>> from pinmobile.metrics import evaluate_metrics_of
    >>> robot, zero = MobileRobot(30.0, 1.3), np.zeros(3)
    >>> at = Tangent(Circle(1.0, 0.5, 4.0))(0.0)
    >>> evaluate_metrics_of(robot, 0.0, *[zero] * 4, at).shape
    (0,)
    """
    copies = type(reference)(*(x.copy() for x in reference))
    values = plant.evaluate_metrics(t, q.copy(), v.copy(), a.copy(), u.copy(), copies)
    words = ": one number for each metric"
    label = f"result of evaluate_metrics(t, q, v, a, u, reference) of the plant, a {type(plant).__name__},"
    return shaped(label, values, (*np.shape(v)[:-1], len(plant.metrics)), words=words)
