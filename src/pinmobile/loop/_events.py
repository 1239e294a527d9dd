"""Events of a run: limits that it exceeds, wheels that slide, and robots that tip over."""

from __future__ import annotations

from typing import Any

import numpy as np

from pinmobile.metrics import metrics_of
from pinmobile.plant import Event, limits_exceeded, robot_at, stated

_SINCE = "(from t = {t} s, {count})"
_GROUND = {
    "tip over": "no loads of wheels and supports balance the robot: it tips over, which is not simulated "
    + _SINCE,
    "ground": f"loads and forces of the ground did not converge to their tolerance {_SINCE}",
}
_SLIDES = f"sliding: {{name}}, at up to {{value}} m/s at t = {{at}} s {_SINCE}"
_FASTER = (
    "motor of {name} turns at {value} rad/s at t = {at} s, faster than {limit} rad/s, its speed without "
    "load, since t = {t} s"
)
_CURRENT = f"current of {{name}} is at its limit of {{limit}} A {_SINCE}"
_MARGIN = f"{{name}} is {{value}} {{unit}} at t = {{at}} s, below 0 {_SINCE}"
_KINDS = {"load": "tip over", "tip-over margin": "tip over", "slip margin": "slip"}
KINDS = (
    *("position limit", "speed limit", "effort limit", "saturation", "current limit"),
    *("tip over", "slip", "ground"),
)
"""Kinds of events of every plant; margins and events among the metrics of a plant are further kinds."""
_EXPECTED = {"saturation", "current limit", "slip"}
"""Kinds of events that a run simulates."""


def is_fault(event: Event) -> bool:
    """Return whether a run does not simulate what happens in an event."""
    return event.kind not in _EXPECTED


def kinds_of(plant: object) -> tuple[str, ...]:
    """Return the kinds of events that a run of a plant may have."""
    own = (_KINDS.get(one.name, one.name) for one in metrics_of(plant) if one.worst != "largest")
    return tuple(dict.fromkeys((*KINDS, *own)))


def events_of(run: Any, *, with_metrics: bool = True) -> tuple[Event, ...]:
    """Return the events of a run, see `Rollout.events`.

    Parameters
    ----------
    run : Rollout
        Recorded samples.
    with_metrics : bool
        Whether events of the plant's metrics are included, which take longer.
    """
    plant, t, signals = robot_at(run.plant, run.t), run.t, run.signals
    found: list[Event | None] = [*limits_exceeded(plant, t, run.q, run.v, run.u)]
    table, stands = stated(plant, "table"), bool(stated(plant, "contact_loads"))
    if table is not None and "currents" in signals:
        motors = [each for each in table.actuators if each.motor.is_electric]
        for one, current in zip(motors, np.abs(signals["currents"].values).T, strict=True):
            limit = float(one.motor.current)
            told: Any = {"words": _CURRENT, "limit": limit, "unit": "A", "slack": -1e-6 * limit}
            found.append(Event.of("current limit", one.name, t, current, current - limit, **told))
    for one in table.actuators if table is not None else ():
        rate = np.abs(run.v[:, run.v.shape[1] - len(one.column) :] @ np.array(one.column))
        limit = one.motor.no_load_rate() if one.motor.is_electric else np.inf
        told = {"words": _FASTER, "limit": limit, "unit": "rad/s", "slack": 1e-6 * limit}
        found.append(Event.of("speed limit", one.name, t, rate, rate - limit, **told))
    known = metrics_of(plant)
    happens = {"tip over": "tips", "ground": "missed"} if stands else {}
    for kind, name in happens.items():
        values = signals[name].values if name in signals else np.zeros(len(t))
        if name == "tips" and name not in signals and any(one.worst == "ever" for one in known):
            values = 1.0 * plant.contact_loads(run.q, run.v, run.a).tips  # rolling wheels have no such signal
        found.append(Event.of(kind, "", t, values, values, words=_GROUND[kind]))
    if table is not None and "slides" in signals:
        speeds = np.hypot(signals["slip_along"].values, signals["slip_across"].values)
        slides = speeds * signals["slides"].values
        names, fastest = np.array(table.names)[slides.max(axis=0) > 0], slides.max(axis=1)
        name = ", ".join(map(str, names))
        found.append(Event.of("slip", name, t, fastest, fastest, words=_SLIDES, unit="m/s"))
    for one in known if with_metrics else ():
        kind = _KINDS.get(one.name, one.name)
        if one.worst == "largest" or any(each and each.kind == kind for each in found):
            continue
        values = run.metrics()[one.name].values
        words = f"{_MARGIN}: {one.meaning}" if one.is_margin else f"{one.name} {_SINCE}: {one.meaning}"
        beyond = -values if one.is_margin else values
        found.append(Event.of(kind, one.name, t, values, beyond, words=words, unit=one.unit))
    return tuple(one for one in found if one is not None)
