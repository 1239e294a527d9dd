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


def mounted(arms: Sequence[str], urdf: Path | None, at: str | None, dirs: Sequence[Path]) -> MobileRobot:
    """Return the box of 30 kg with the arms on it.

    Parameters
    ----------
    arms : sequence of str
        Names, mounted one after the other.
    urdf : Path, optional
        A file with an arm, in place of names.
    at : str, optional
        ``X,Y,Z,YAW`` of the only arm [m, m, m, rad].
    dirs : sequence of Path
        Where the file's ``package://`` is.

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
    if at is not None and len(wanted) > 1:
        raise InvalidArgument(f"--at places one arm, but there are {len(wanted)}")
    box = MobileRobot.box()
    if len(wanted) == 1:
        return box.mount(wanted[0], None if at is None else choices.point("--at", at), package_dirs=dirs)
    return _one_behind_the_other(box, wanted)


def _one_behind_the_other(robot: MobileRobot, arms: Sequence[Any]) -> MobileRobot:
    length = robot.size[0]
    for arm, x in zip(arms, np.linspace(length / 3, -length / 3, len(arms)), strict=True):
        (*_, mount) = robot.mount(arm).mounts
        robot = robot.mount(mount.arm, (x, *mount.at[1:]))
    return robot


def demonstration(robot: MobileRobot, duration: float) -> WholeBody:
    """Return the circle, beside it every joint 0.5 rad (0.1 m) away and back, or as far as it can in time."""
    rest, units = robot.difference(robot.neutral, robot.rest), np.array(robot.coordinate_units)
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
