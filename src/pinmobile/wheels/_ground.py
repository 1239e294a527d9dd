"""What wheels stand on: ground on which they roll ideally or slip, level or a ramp."""

from __future__ import annotations

from math import cos, pi, sin
from typing import Any, ClassVar, Protocol, final

from pinmobile.arrays import Array, bounded, frozen, scalar
from pinmobile.errors import InvalidArgument
from pinmobile.parts import by_value, child, integer, number, part
from pinmobile.wheels._coulomb import SlippingDynamics, led
from pinmobile.wheels._rolling import RollingDynamics
from pinmobile.wheels._wheel import column


class Ground(Protocol):
    """A ground with dynamics(wheeled), such as Rolling() or Coulomb().

    It supplies the law of a robot on it: a `WheeledDynamics` with ``forward_dynamics(q, v, u, f)``, or with
    ``initial_state(context)`` and ``step(t, q, v, u, h, f, memory)``; what else this has, such as ``signals``
    or ``project``, the robot has too. A ground may have as well:

    - ``check_robot(wheeled)``, which refuses robots that it cannot carry;
    - ``ramp``, a `Ramp` or None;
    - ``slips``, False where the wheels roll ideally: their constraints are then those of `WheeledRobot`.
    """

    def dynamics(self, wheeled: Any, /) -> Any:
        """Return the dynamics of a `WheeledRobot` on it, over numbers, arrays or symbols."""


@final
@part
@by_value
class Ramp:
    """A plane that rises; x, y and psi are then those in the plane.

    Parameters
    ----------
    angle : float
        Of the plane with the level, in [0, pi / 2) [rad].
    direction : float
        Of the way straight up, from the inertial x axis [rad].
    """

    angle: float = number(unit="rad", lower=0, fixed=True, doc="angle of the plane with the level")
    direction: float = number(default=0.0, unit="rad", fixed=True, doc="direction straight up")

    def check(self) -> None:
        """Raise `InvalidArgument` where it is as steep as a wall."""
        bounded("angle", self.angle, below=pi / 2, unit="rad")

    def fall(self, g: float) -> Array:
        """Return gravity along the axes of the plane, shape (3,) [m/s^2], from what it is straight down."""
        g = scalar("g", g)
        down = -g * sin(self.angle)
        return frozen([down * cos(self.direction), down * sin(self.direction), -g * cos(self.angle)])


@final
@part
@by_value
class Rolling:
    """Wheels roll without slip, whatever force that takes: constraints on the velocities.

    Parameters
    ----------
    ramp : Ramp, optional
        Which way the ground rises; None: it is level.

    Attributes
    ----------
    slips : bool
        Whether wheels may slip, here False.
    """

    ramp: Ramp | None = child(Ramp, default=None, optional=True, expected="a Ramp(angle, direction) or None")
    slips: ClassVar[bool] = False

    def dynamics(self, wheeled: Any) -> RollingDynamics:
        """Return the dynamics of a robot on it."""
        return RollingDynamics(**wheeled.terms)

    def check_robot(self, wheeled: Any) -> None:
        """Refuse drives that cannot roll, and steering that nothing holds and that has no inertia."""
        mobility, table = wheeled.mobility, wheeled.table
        if not mobility.is_regular:
            raise InvalidArgument(
                f"table cannot roll without slip: {mobility.why_not}; expected a drive that can, or "
                "ground=Coulomb()"
            )
        inertias = wheeled.joint_inertias
        for k in mobility.choice.free:
            if not inertias[k] > 0:
                axis = table.axes[k]
                wheel = table.names[axis.wheels[0]]
                raise InvalidArgument(
                    f"{axis.name} of the table has no inertia about its axis, expected one > 0: give "
                    f"yaw_inertia of wheel {wheel!r}"
                )


@final
@part
@by_value
class Coulomb:
    """Wheels stick while the ground can hold them, and slide beyond: dry friction of Coulomb's law.

    A robot on such ground has a step of its own: implicit in the velocities, impulses of all wheels found
    together, so that what sticks is at rest exactly and nothing is stiff. Steps of 0.01 s and less are of
    use; the error of fixed wheels falls with the square of the step, that of steered ones with the step.

    Loads depend on accelerations, these on friction, and friction on the loads: a step solves for all of
    them. Where friction presses the wheels on which it acts there may be several solutions. The step takes
    the one to which the accelerations of the step before lead; the signals state it: ``slides``, ``loads``
    and ``tips``, 1 where no loads balance the robot. ``missed`` is 1 where the step found no solution.

    Parameters
    ----------
    mu : float, optional
        Coefficient of friction of all wheels, along the axes of rollers for those that have some; None: each
        wheel's own, ``wheel.friction.mu``.
    ramp : Ramp, optional
        Which way the ground rises; None: it is level.
    sweeps : int
        Most rounds over all wheels in a pass; the signal ``missed`` says where they were too few.
    tolerance : float
        Largest change of a force in a round, as a share of the largest friction, at which it has been found.

    Attributes
    ----------
    slips : bool
        Whether wheels may slip, here True.
    """

    mu: float | None = number(
        default=None, optional=True, lower=0, doc="coefficient of friction of all wheels"
    )
    ramp: Ramp | None = child(Ramp, default=None, optional=True, expected="a Ramp(angle, direction) or None")
    sweeps: int = integer(default=200, least=1, doc="most rounds over all wheels in a pass")
    tolerance: float = number(default=1e-12, above=0, fixed=True, doc="change of a force that is none")
    slips: ClassVar[bool] = True

    def dynamics(self, wheeled: Any) -> SlippingDynamics:
        """Return the dynamics of a robot on it."""
        terms, wheels = wheeled.terms, wheeled.table.wheels
        own: dict[str, Any] = {
            name: frozen([getattr(wheel.friction, name) for wheel in wheels])
            for name in ("across", "rolling", "slip")
        }
        if self.mu is not None:
            own["mu"] = column([self.mu] * len(wheels))
        return SlippingDynamics(**terms | own, sweeps=self.sweeps, tolerance=self.tolerance)

    def check_robot(self, wheeled: Any) -> None:
        """Refuse what cannot be computed where wheels slip."""
        wheeled.check_stands()
        table = wheeled.table
        led(table)
        names = (*(axis.name for axis in table.axes), *table.names)
        for name, inertia in zip(names, wheeled.joint_inertias, strict=True):
            if not inertia > 0:
                raise InvalidArgument(
                    f"{name} of the table has no inertia about its axis, expected one > 0 where wheels slip: "
                    "give spin_inertia, and yaw_inertia of wheels that steer"
                )
