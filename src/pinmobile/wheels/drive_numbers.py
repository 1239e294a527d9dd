"""`DriveNumbers`: what may differ from one robot on such wheels to another."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, frozen, one_of
from pinmobile.constancy import constant
from pinmobile.errors import InvalidArgument
from pinmobile.plant import Parameter
from pinmobile.robot import BODY_JOINT, MobileRobot
from pinmobile.urdf import Body
from pinmobile.wheels.table import WheelTable

_OF_WHEELS = {
    "radius": ("m", "radius", 0.0),
    "x": ("m", "place forward", -np.inf),
    "y": ("m", "place to the left", -np.inf),
    "spin_inertia": ("kg m^2", "inertia about the axle", 0.0),
}


@final
@constant
@dataclass(frozen=True, eq=False)
class DriveNumbers:
    """The numbers of a robot on wheels beside its body's own: columns with an entry for each wheel.

    Parameters
    ----------
    robot : MobileRobot
        The whole.
    table : WheelTable
        Its wheels.
    mu : float, optional
        Coefficient of friction of all wheels; by default each has its own.
    """

    robot: MobileRobot
    table: WheelTable
    mu: float | None = None

    @cached_property
    def columns(self) -> Mapping[str, Array]:
        """Places of the pivots, radii and inertias, friction, and `upright`, by attribute."""
        wheels = self.table.wheels
        found = {name: frozen([getattr(wheel, name) for wheel in wheels]) for name in _OF_WHEELS}
        found["mu"] = frozen([wheel.friction.mu if self.mu is None else self.mu for wheel in wheels])
        found["upright"] = self._upright
        return found

    @cached_property
    def _upright(self) -> Array:
        """Height of the centre of mass, and inertia xz and yz, of a robot without arms, shape (3,)."""
        if self.robot.mounts:
            return frozen(np.zeros(3))
        inertia = self.robot.lumped().model.inertias[BODY_JOINT]
        return frozen([inertia.lever[2], inertia.inertia[0, 2], inertia.inertia[1, 2]])

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """What an ensemble may spread of it."""
        found = []
        for attribute, (unit, meaning, least) in _OF_WHEELS.items():
            may_vanish = attribute != "radius"
            for k, name in enumerate(self.table.names):
                own = f"{attribute}_{name}", unit, f"{meaning} of wheel {name}", least
                found.append(Parameter(*own, may_vanish=may_vanish, attribute=attribute, entry=k))
        found.append(Parameter("mu", "", "coefficient of friction of all wheels", 0.0))
        for k, name in enumerate(self.table.names):
            meaning = f"coefficient of friction of wheel {name}"
            found.append(Parameter(f"mu_{name}", "", meaning, 0.0, attribute="mu", entry=k))
        if not self.robot.mounts:
            found.append(
                Parameter("com_z", "m", "height of the centre of mass", attribute="upright", entry=0)
            )
        sides = [wheel.y for wheel in self.table.wheels]
        if min(sides) < 0 < max(sides):
            width = max(sides) - min(sides)
            words = "largest distance between wheels to left and right, which all move in proportion"
            track = Parameter(
                "track", "m", words, 0.0, False, attribute="y", write=_Track(width), neutral=width
            )
            found.append(track)
        return tuple(found)

    def changed(self, values: Mapping[str, ArrayLike]) -> tuple[MobileRobot, WheelTable]:
        """Return the robot and the table that have other values, by parameter or by attribute.

        Raises
        ------
        InvalidArgument
            If a value is not possible, or an array has another shape.
        UnknownName
            If there is no such parameter.
        """
        columns = self._written(values)
        numbers = [columns[name].tolist() for name in _OF_WHEELS]
        wheels = [
            replace(wheel, **dict(zip(_OF_WHEELS, own, strict=True)))
            for wheel, *own in zip(self.table.wheels, *numbers, strict=True)
        ]
        frictions = zip(wheels, columns["mu"].tolist(), strict=True)
        wheels = [replace(wheel, friction=replace(wheel.friction, mu=mu)) for wheel, mu in frictions]
        robot, higher = self.robot, float(columns["upright"][0] - self._upright[0])
        if higher:
            if robot.mounts:
                raise InvalidArgument("upright is that of robots without arms, expected none with arms")
            robot = _raised(robot, higher)
        return robot, replace(self.table, wheels=tuple(wheels))

    def _written(self, values: Mapping[str, ArrayLike]) -> dict[str, Array]:
        """Return the columns with other values."""
        named = {parameter.name: parameter for parameter in self.parameters}
        columns = {name: column.copy() for name, column in self.columns.items()}
        for name, value in values.items():
            given = finite(name, value)
            if name in columns and given.shape in ((), columns[name].shape):
                columns[name][...] = given
            elif name in named and given.ndim == 0:
                if not named[name].allows(given):
                    raise InvalidArgument(f"{name} is {given:g}, expected {named[name].bound}")
                column = named[name].attribute or name
                columns[column] = named[name].written(columns[column][None], given[None], BODY_JOINT)[0]
            else:
                one_of("parameter of a robot on wheels", name, [*named, *columns])
                raise InvalidArgument(f"{name} has shape {given.shape}, expected that of {name} of the robot")
        return columns


@final
@constant
@dataclass(frozen=True)
class _Track:
    """What moves all wheels of a table to the side in proportion: how a `Parameter` writes the track.

    Parameters
    ----------
    width : float
        Of the table [m].
    """

    width: float

    def __call__(self, values: Array, column: Array, size: int) -> Array:
        """Return y of the wheels, shape (m, wheels), with their tracks, shape (m,)."""
        del size
        return values * (column / self.width)[:, None]


def _raised(robot: MobileRobot, height: float) -> MobileRobot:
    """Return a robot whose body has its centre of mass higher by so much [m]."""
    body = robot.lumped().body
    com = body.com + np.array([0.0, 0.0, height])
    return robot.base.with_body(Body(body.mass, com, body.inertia), robot.source)
