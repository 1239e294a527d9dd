"""Signals: named series with units that parts of a loop record beside states and inputs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import Array, ArrayLike, frozen, instance, real, shaped
from pinmobile.errors import InvalidArgument, UnknownName, unexpected_value

_MAX_DEPTH = 100  # nested wrappers


class Signal(NamedTuple):
    """Series that a part records, with one value per sample.

    Attributes
    ----------
    unit : str
        Unit of the values, such as ``"N"``; "" for none.
    values : ndarray, shape (N + 1,) or (N + 1, k)
        Values of the samples in this unit.

    See Also
    --------
    Rollout.signals : signals of a run by name.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.signals import Signal
    >>> force = Signal("N", np.array([0.0, 2.0, 1.0]))
    >>> float(force.values.max()), force.unit
    (2.0, 'N')
    """

    unit: str
    values: Array


class SignalSample(NamedTuple):
    """Value of a signal at one sample.

    Attributes
    ----------
    part : str
        Part that records the signal, such as ``"forces[1]"``.
    unit : str
        Unit of the value, "" for none.
    value : ndarray, shape () or (k,)
        Value at this sample.

    See Also
    --------
    signals.collect_signals : collect the signals of several parts.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile.signals import SignalSample
    >>> SignalSample("forces[0]", "N", np.array(3.0)).unit
    'N'
    """

    part: str
    unit: str
    value: Any


def signals_of(part: object, *given: object) -> Any:
    """Return the signals of a part, an empty dict if it has none.

    Parameters
    ----------
    part : object
        Part of a loop; it may have a method ``signals``.
    *given : object
        Arguments of this method.

    Returns
    -------
    dict of str to (str, value)
        Unit and value of each signal, by name.

    See Also
    --------
    signals.collect_signals : check and collect the signals of several parts.

    Examples
    --------
    >>> from pinmobile import PD
    >>> from pinmobile.signals import signals_of
    >>> signals_of(PD(4, 4), None)
    {}
    """
    return part.signals(*given) if hasattr(part, "signals") else {}


def number(name: str, value: ArrayLike) -> Array:
    """Return the value of a signal as an array.

    Parameters
    ----------
    name : str
        Name of the value, for the message.
    value : array_like, shape () or (k,)
        Real numbers; NaN and infinity are allowed.

    Returns
    -------
    ndarray, shape () or (k,)
        Value as float64.

    Raises
    ------
    InvalidArgument
        If the value is not a real number or a row of real numbers.

    Examples
    --------
    >>> from pinmobile.signals import number
    >>> number("force", [1, 2])
    array([1., 2.])
    """
    return shaped(name, np.array(real(name, value)), (), ("n",))


class _Samples(dict[str, SignalSample]):
    """Signals by name; an unknown name, such as in the function of a metric, raises `UnknownName`."""

    def __missing__(self, name: str) -> SignalSample:
        raise UnknownName("signal", name, self)


NO_SIGNALS: Mapping[str, SignalSample] = _Samples()


def collect_signals(
    parts: Iterable[tuple[str, Any]], value_of: Callable[[str, Any], Any] = number
) -> dict[str, SignalSample]:
    """Return the signals of several parts at one sample, by name.

    Parameters
    ----------
    parts : iterable of (str, mapping)
        Name of each part in messages, and its signals: a dict of name to (unit, value).
    value_of : callable
        Function ``value_of(name, value)`` that checks a value and returns it as an array.

    Returns
    -------
    dict of str to SignalSample
        Part, unit and value of each signal.

    Raises
    ------
    InvalidArgument
        If the signals of a part have another form, or two parts have a signal of the same name.

    See Also
    --------
    signals.SignalSample : value of a signal at one sample.

    Examples
    --------
    >>> from pinmobile.signals import collect_signals
    >>> found = collect_signals([("forces[0]", {"push": ("N", 3.0)})])
    >>> found["push"].part, float(found["push"].value)
    ('forces[0]', 3.0)
    """
    samples = _Samples()
    for part, signals in parts:
        instance(f"result of {part}.signals", signals, Mapping, "a dict of name to (unit, value)")
        for name, pair in signals.items():
            if type(pair) is not tuple or len(pair) != 2 or not isinstance(pair[0], str):
                raise unexpected_value(f"{part}.signals[{name!r}]", pair, "(unit, value)")
            if name in samples:
                raise InvalidArgument(
                    f"{samples[name].part} and {part} both have the signal {name!r}, expected another name"
                )
            samples[name] = SignalSample(part, pair[0], value_of(f"{part}.signals[{name!r}]", pair[1]))
    return samples


def collect_time_signals(t: Array, controller: object, trajectory: object) -> dict[str, Signal]:
    """Return the signals that a controller and a trajectory define as functions of time, by name.

    Such a signal depends on the time alone, for example a target. The function also searches controllers
    inside wrappers. If several parts define a signal of the same name, the result contains that of the
    outermost controller.

    Parameters
    ----------
    t : ndarray, shape (N,)
        Times of the samples [s].
    controller, trajectory : controller, trajectory
        Parts that may have a method ``signals_at(t)``. It returns a dict of name to (unit, values), with
        values of shape (N,) or (N, k).

    Returns
    -------
    dict of str to Signal
        Unit and values of each signal.

    Raises
    ------
    InvalidArgument
        If such a method returns anything else.

    Examples
    --------
    >>> import numpy as np
    >>> from pinmobile import PD, Circle, Tangent
    >>> from pinmobile.signals import collect_time_signals
    >>> path = Tangent(Circle(1.0, 0.5, 4.0))
    >>> collect_time_signals(np.array([0.0, 1.0]), PD(4, 4), path)
    {}
    """
    controllers: list[object] = []
    while controller is not None and len(controllers) < _MAX_DEPTH:
        controllers.append(controller)
        controller = getattr(controller, "controller", None)
    signals: dict[str, Signal] = {}
    for part in (trajectory, *reversed(controllers)):
        if isinstance(part, type) or not hasattr(part, "signals_at"):
            continue
        label = f"{type(part).__name__}.signals_at"
        series = instance(f"result of {label}", part.signals_at(t.copy()), Mapping, "a dict of signals")
        for name, (unit, values) in series.items():
            array = real(f"{label}[{name!r}]", values)
            shaped(f"{label}[{name!r}]", array, (len(t),), (len(t), "k"))
            signals[name] = Signal(unit, frozen(array))
    return signals
