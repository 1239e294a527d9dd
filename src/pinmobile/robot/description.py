"""Robots as text: body, loads, arms and supports, each with its numbers and their source."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from pinmobile.arrays import Array
from pinmobile.robot.support_geometry import margin_inside


def numbers(values: Any, unit: str = "") -> str:
    """Return numbers as text, such as ``(0.1, 0, 0.2) m``."""
    each = [f"{value:.4g}" if abs(value) > 1e-12 else "0" for value in np.atleast_1d(values)]
    words = ", ".join(each)
    return f"{words if len(each) == 1 else f'({words})'} {unit}".rstrip()


def columns(rows: Sequence[Sequence[str]], indent: str = "  ") -> list[str]:
    """Return rows as lines with aligned columns."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [indent + "  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]


def interval(lower: float, upper: float, unit: str) -> str:
    """Return a range as text; "none" without limits."""
    if np.isinf([lower, upper]).all():
        return "none"
    return f"{lower:.4g} to {upper:.4g} {unit}" if lower != -upper else f"+-{upper:.4g} {unit}"


def stands(place: Array, corners: Array | None) -> str:
    """Return whether a robot stands on its supports, as a sentence.

    Parameters
    ----------
    place : ndarray, shape (2,)
        Point of the ground below the centre of mass, along gravity, in the body frame [m].
    corners : ndarray, shape (k, 2), or None
        Corners of the support polygon in the body frame [m]; None if it is unknown.
    """
    if corners is None:
        return "supports are unknown, or lie on one line"
    margin = float(margin_inside(corners, place))
    if margin < 0:
        return f"cannot stand: its centre of mass lies {-margin:.2g} m outside its supports"
    if margin < 1e-9:
        return "balances: its centre of mass is over the edge of its supports"
    return f"stands: its centre of mass is {margin:.2g} m inside the edge of its supports"


def of_robot(robot: Any, corners: Array | None, wheeled: Any = None) -> list[str]:
    """Return the lines about a `MobileRobot`, with the corners of its supports, and maybe on its wheels."""
    is_assumed = robot._source == "made from numbers" and robot.reference_inertia is None
    inertia = f"diagonal {numbers(np.diag(robot.body.inertia), 'kg m^2')}"
    rows = [
        ["mass", numbers(robot.mass, "kg")],
        ["centre of mass", numbers(robot.com, "m")],
        ["yaw inertia", f"{numbers(robot.yaw_inertia, 'kg m^2')} about the centre of mass"],
        ["inertia", inertia + ("; x, y assumed" if is_assumed else "")],
        ["size", f"{' x '.join(numbers(x) for x in robot.size)} m"],
    ]
    if corners is not None:
        spans = zip("xy", corners.min(axis=0), corners.max(axis=0), strict=True)
        words = ", ".join(f"{axis} {low:.4g} to {high:.4g} m" for axis, low, high in spans)
        rows.append(["supports", f"{len(corners)} corners, {words}"])
    notes, words = robot.source.removeprefix(robot._source), robot._source
    if wheeled is not None:  # its source knows which joints turn
        words = wheeled.source.removesuffix(f"; {wheeled.table.source}").removesuffix(notes)
    first, *rest = words.split("; ")
    lines = ["body", *columns([*rows, ["source", first], *(["", each] for each in rest)])]
    for load in robot.loads:
        place = f" on {load.frame}" if load.frame else ""
        lines.append(f"load{place}: {numbers(load.mass, 'kg')}, centre of mass {numbers(load.com, 'm')}")
    for mount in robot.mounts:
        mass = sum(link.mass for link in mount.links)
        place = f"{numbers(mount.at[:3], 'm')}, yaw {numbers(mount.at[3], 'rad')}"
        lines.append(f"arm {mount.name}: {numbers(mass, 'kg')} at {place}")
        heads = [["joint", "position", "speed", "effort"]]
        for k in range(mount.v.start, mount.v.stop):
            axis, speed, effort = robot.coordinates[k], robot.velocity_limit[k], robot.effort_limit[k]
            limits = [interval(axis.lower, axis.upper, axis.unit), interval(-speed, speed, f"{axis.unit}/s")]
            heads.append([axis.name, *limits, interval(-effort, effort, robot.inputs[k].unit)])
        lines += columns(heads)
    if robot.mounts:
        lines += ["numbers of arms: from their files or models"]
        lines += [f"  {each}" for each in notes.split("; ") if each]
    if robot.mounts or robot.loads:
        full = robot.with_locked_arms()
        place = f"centre of mass {numbers(full.com, 'm')} in the reference posture"
        lines.append(f"whole robot: {numbers(full.mass, 'kg')}, {place}")
    return lines


def of_wheels(wheeled: Any) -> list[str]:
    """Return the lines about the wheels and motors of a `WheeledRobot`."""
    table, rows = wheeled.table, [["motor", "stall torque", "top speed", "voltage", "current", "source"]]
    radii = {each.name: each.radius for each in table.wheels}
    for each in table.actuators:
        motor, speed = each.motor, "none"
        if np.isfinite(rate := motor.largest_rate):
            speed_text = f", {numbers(rate * radii[each.name], 'm/s')}" if each.name in radii else ""
            speed = numbers(rate, "rad/s") + speed_text
        limits = (motor.largest_torque, "N m"), (motor.voltage or np.inf, "V"), (motor.current, "A")
        torque, volts, current = (numbers(x, unit) if np.isfinite(x) else "none" for x, unit in limits)
        is_stated = motor.is_electric or np.isfinite(motor.largest_torque)
        source = motor.source or ("given" if is_stated else "none: a torque without limit")
        rows.append([each.name, torque, speed, volts, current, source])
    axes = [["steering", "angle"], *([x.name, interval(-x.limit, x.limit, "rad")] for x in table.axes)]
    return [
        "wheels",
        *(f"  {each}" for each in table.source.split("; ")),
        *(f"  {line}" for line in str(table).splitlines()),
        *columns(axes if table.axes else []),
        *columns(rows),
        f"ground: {wheeled.ground!r}",
    ]


def describe(robot: Any, wheeled: Any = None) -> str:
    """Return a `MobileRobot` as text, or a `WheeledRobot` on it."""
    corners, fall = robot.footprint, np.array([0.0, 0.0, -1.0])
    if wheeled is not None:
        corners, fall = wheeled.footprint, np.asarray(wheeled.fall)
    lines = of_robot(robot, corners, wheeled) + (of_wheels(wheeled) if wheeled is not None else [])
    com = np.array(robot.with_locked_arms().com)
    words = stands(com[:2] - com[2] * fall[:2] / fall[2], corners)
    return "\n".join([*lines, words + (" on this ramp, at psi = 0" if fall[:2].any() else "")])
