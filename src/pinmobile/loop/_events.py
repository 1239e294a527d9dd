"""Events of a run: limits that it exceeds, wheels that slide, and robots that tip over."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.metrics import Metric, metrics_of
from pinmobile.plant import Event, limit_events, robot_at, stated
from pinmobile.robot import margin_of_wrench

_SINCE = "(from t = {t} s, {count})"
_GROUND = {
    "tip over": "no loads of wheels and supports balance the robot: it tips over, which is not simulated "
    + _SINCE,
    "ground": f"loads and forces of the ground did not converge to their tolerance {_SINCE}; "
    "compare with half the time step",
}
_SLIDES = f"sliding: {{name}}, at up to {{value}} m/s at t = {{at}} s {_SINCE}"
_OVERSPEED = (
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
_SIMULATED_KINDS = {"saturation", "current limit", "slip"}
"""Kinds of events that a run simulates."""
_LEAST_SLIP = 1e-9  # [m/s], slower slip is rounding
_TIPS = Metric("tip-over margin", "m", "distance of the zero-moment point from the edge", "smallest")


def is_fault(event: Event) -> bool:
    """Return whether a run does not simulate what happens in an event."""
    return event.kind not in _SIMULATED_KINDS


def kinds_of(plant: object) -> tuple[str, ...]:
    """Return the kinds of events that a run of a plant may have."""
    metric_kinds = (_KINDS.get(m.name, m.name) for m in metrics_of(plant) if m.worst != "largest")
    return tuple(dict.fromkeys((*KINDS, *metric_kinds)))


def events_of(run: Any, *, with_metrics: bool = True) -> tuple[Event, ...]:
    """Return the events of a run, see `Rollout.events`.

    Parameters
    ----------
    run : Rollout
        Recorded samples.
    with_metrics : bool
        Whether events of the plant's metrics are included, which take longer.
    """
    plant = robot_at(run.plant, run.t)
    limits = limit_events(plant, run.t, run.q, run.v, run.u)
    events = [x for x in (*limits, *_motor_events(run, plant), *_ground_events(run, plant)) if x is not None]
    metrics = [x for x in metrics_of(plant) if x.worst != "largest"] if with_metrics else []
    values = {name: signal.values for name, signal in run.metrics().items()} if metrics else {}
    if with_metrics and not metrics and stated(plant, "table") is None and stated(plant, "grounded"):
        corners, wrench = plant.footprint, plant.ground_wrench(run.q, run.v, run.a)
        if corners is not None:  # a robot without arms: its ensembles do not record the margin
            metrics = [_TIPS]
            values = {_TIPS.name: margin_of_wrench(corners, wrench, plant.weight)}
    for x in metrics:
        event = _metric_event(x, run.t, values[x.name])
        if event is not None and all(event.kind != known_event.kind for known_event in events):
            events.append(event)
    return tuple(events)


def _motor_events(run: Any, plant: Any) -> Iterator[Event | None]:
    """Yield the events of motors: currents at their limits, speeds above those without load."""
    table, t = stated(plant, "table"), run.t
    motors = table.actuators if table is not None else ()
    if "currents" in run.signals:
        electric = [motor for motor in motors if motor.motor.is_electric]
        for motor, current in zip(electric, np.abs(run.signals["currents"].values).T, strict=True):
            limit = float(motor.motor.current)
            options: Any = {"words": _CURRENT, "limit": limit, "unit": "A", "slack": -1e-6 * limit}
            yield Event.of("current limit", motor.name, t, current, current - limit, **options)
    for motor in motors:
        rate = np.abs(run.v[:, run.v.shape[1] - len(motor.column) :] @ np.array(motor.column))
        limit = motor.motor.no_load_rate() if motor.motor.is_electric else np.inf
        options = {"words": _OVERSPEED, "limit": limit, "unit": "rad/s", "slack": 1e-6 * limit}
        yield Event.of("speed limit", motor.name, t, rate, rate - limit, **options)


def _ground_events(run: Any, plant: Any) -> Iterator[Event | None]:
    """Yield the events of a robot on the ground: it tips over, its loads do not converge, wheels slide."""
    table, t, signals = stated(plant, "table"), run.t, run.signals
    states = {name: signals[name].values for name in ("tips", "missed") if name in signals}
    if stated(plant, "contact_loads"):
        if "tips" not in states and any(metric.worst == "ever" for metric in metrics_of(plant)):
            states["tips"] = 1.0 * plant.contact_loads(run.q, run.v, run.a).tips  # rolling wheels: no signal
        for kind, name in {"tip over": "tips", "ground": "missed"}.items():
            if name in states:
                yield Event.of(kind, "", t, states[name], states[name], words=_GROUND[kind])
    if table is not None and "slides" in signals:
        speeds = np.hypot(signals["slip_along"].values, signals["slip_across"].values)
        slides = np.where(speeds > _LEAST_SLIP, speeds * signals["slides"].values, 0.0)
        names, fastest = np.array(table.names)[slides.max(axis=0) > 0], slides.max(axis=1)
        name = ", ".join(map(str, names))
        yield Event.of("slip", name, t, fastest, fastest, words=_SLIDES, unit="m/s")


def _metric_event(m: Metric, t: Array, values: Array) -> Event | None:
    """Return the event of a metric: a margin below 0, or what happens."""
    words = f"{_MARGIN}: {m.meaning}" if m.is_margin else f"{m.name} {_SINCE}: {m.meaning}"
    excess = -values if m.is_margin else values
    kind = _KINDS.get(m.name, m.name)
    return Event.of(kind, m.name, t, values, excess, words=words, unit=m.unit)
