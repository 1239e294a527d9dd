"""The demonstration of `mount`: a box with arms on it, and a motion that couples base and arms."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pinmobile import Circle, CubicVia, InvalidArgument, MobileRobot, Tangent, WholeBody
from pinmobile.arrays import Array
from pinmobile.cli import choices
from pinmobile.robot.tree import parts_of

__all__ = ["RADIUS", "RATE", "WAY", "demonstration", "mounted"]

RADIUS, RATE = 1.0, 0.5  # of the circle [m], [rad/s]
WAY = {"rad": 0.5, "m": 0.1}  # that each joint goes and comes back


def mounted(
    arms: Sequence[str],
    urdf: Path | None = None,
    at: Sequence[str] = (),
    dirs: Sequence[Path] = (),
    locked: Sequence[str] = (),
) -> MobileRobot:
    """Return the box of 30 kg with the arms on it.

    Parameters
    ----------
    arms : sequence of str
        Names, mounted one after the other.
    urdf : Path, optional
        A file with an arm, in place of names.
    at : sequence of str
        ``X,Y,Z,YAW`` of each arm [m, m, m, rad], or none at all.
    dirs : sequence of Path
        Where the file's ``package://`` is.
    locked : sequence of str
        Joints of the only arm that shall not move.

    Raises
    ------
    InvalidArgument, UnknownName
        If there is no arm, or an option is not what is expected.
    """
    if urdf is not None and arms:
        raise InvalidArgument(f"--urdf stands for an arm, but there is {arms[0]!r} too")
    if dirs and urdf is None:
        raise InvalidArgument("--package-dir applies beside --urdf alone")
    wanted: list[Any] = [urdf] if urdf is not None else list(arms)
    if not wanted:
        raise InvalidArgument(
            "mount needs an arm: 'pinmobile mount ur5 --html out/ur5.html', or a file by --urdf; "
            "'pinmobile mount --list' prints the names"
        )
    if at and len(at) != len(wanted):
        raise InvalidArgument(
            f"--at is given {len(at)} times for {len(wanted)} arms, expected once for each arm"
        )
    if locked and len(wanted) > 1:
        raise InvalidArgument(f"--lock applies to one arm, but there are {len(wanted)}")
    box = MobileRobot.box()
    ready = [box.mount(arm, package_dirs=dirs, locked=locked).mounts[0] for arm in wanted]
    length = box.size[0] if len(wanted) > 1 else 0.0
    places = [
        (x, *mount.at[1:])
        for x, mount in zip(np.linspace(length, -length, len(ready)) / 3, ready, strict=True)
    ]
    for mount, place in zip(ready, [choices.point("--at", text) for text in at] or places, strict=True):
        box = box.mount(mount.arm, place)
    return box


def demonstration(robot: MobileRobot, duration: float) -> WholeBody:
    """Return the circle, beside it every joint 0.5 rad (0.1 m) away and back, or as far as it can in time."""
    rest, units = (
        robot.difference(robot.neutral, robot.rest),
        np.array([one.unit for one in robot.coordinates]),
    )
    way = np.select([units == unit for unit in WAY], list(WAY.values()))
    # A cubic from rest to rest is at most 3/2 as fast as on average; it has half the time.
    way = np.minimum(way, robot.velocity_limit * (duration / 2) / 1.5)
    up, down = (np.minimum(room, way) for room in _room(robot))
    upwards = np.where(np.isclose(up, down), _lifts(robot, way), up > down)
    target = rest + np.where(upwards, up, -down)
    paths = [
        CubicVia(rest[m.v], target[m.v], rest[m.v], duration / 2, duration) if rest[m.v].size else None
        for m in robot.mounts
    ]
    return WholeBody(robot, Tangent(Circle(RADIUS, RATE, duration)), *paths)


def _lifts(robot: MobileRobot, way: Array) -> Any:
    """Tell of which coordinates a larger one lifts the arm, rather than pressing it into the base."""
    moves = np.diag(way)
    higher, lower = (robot.potential_energy(robot.integrate(robot.rest, sign * moves)) for sign in (1, -1))
    return higher >= lower - 1e-9


def _room(robot: MobileRobot) -> tuple[Array, Array]:
    """Return how far each coordinate can go up and down from rest, within its limits, shape (nv,)."""
    up, down = np.full(robot.nv, np.inf), np.full(robot.nv, np.inf)
    model = robot.model
    for joint in range(1, model.njoints):
        if model.nqs[joint] == model.nvs[joint]:
            q, v = parts_of(model, joint)
            up[v], down[v] = robot.upper[q] - robot.rest[q], robot.rest[q] - robot.lower[q]
    return up, down
