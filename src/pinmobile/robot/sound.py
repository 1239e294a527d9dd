"""What no arm has: limits the wrong way round, numbers that are none, bodies that cannot exist."""

from collections.abc import Iterable

import numpy as np
import pinocchio as pin

from pinmobile.errors import InvalidArgument

__all__ = ["check_bodies", "check_joint_limits"]

_ROUNDING = 1e-9  # of the moments of inertia, relative: files carry as many digits
_GYRATION = 1e-9  # and of mass [m^2]: exporters leave noise of the size of 1e-18 where a moment is zero


def check_bodies(model: pin.Model, called: str) -> None:
    """Refuse a joint that carries what no rigid body is; a joint may carry nothing.

    Parameters
    ----------
    model : pin.Model
        The arm as it was read; what is fixed to a link is a part of it.
    called : str
        What the arm is called, for the message.

    Raises
    ------
    InvalidArgument
        If a mass, a centre of mass or an inertia is not finite, a mass is negative, or the principal
        moments of inertia are negative or break the triangle inequality.
    """
    for joint in range(model.njoints):
        body = model.inertias[joint]
        carrier = f"arm {called!r}: joint {model.names[joint]!r}" if joint else f"arm {called!r}: its root"
        mass, inertia = float(body.mass), np.array(body.inertia)
        if not np.isfinite(mass) or mass < 0:
            raise InvalidArgument(f"{carrier} carries a mass of {mass:g} kg, expected a finite number >= 0")
        if not np.isfinite(body.lever).all():
            raise InvalidArgument(
                f"{carrier} carries a centre of mass at {np.array(body.lever).tolist()} m, "
                "expected finite numbers"
            )
        if not np.isfinite(inertia).all():
            raise InvalidArgument(f"{carrier} carries an inertia {inertia.tolist()}, expected finite numbers")
        least, middle, most = moments = np.linalg.eigvalsh(inertia)
        slack = _ROUNDING * np.abs(moments).max() + _GYRATION * mass
        if least < -slack or most > least + middle + slack:
            raise InvalidArgument(
                f"{carrier} carries principal moments of inertia ({least:.6g}, {middle:.6g}, {most:.6g}) "
                "kg m^2, which no rigid body has: expected each >= 0 and at most the sum of the other two"
            )


def check_joint_limits(model: pin.Model, joints: Iterable[int], called: str) -> None:
    """Refuse limits that limit nothing: the least above the largest, negative ones, or no numbers.

    Parameters
    ----------
    model : pin.Model
        The arm as it was read.
    joints : iterable of int
        Those of its joints that move.
    called : str
        What the arm is called, for the message.

    Raises
    ------
    InvalidArgument
        The message names the joint.
    """
    for joint in joints:
        q = slice(model.idx_qs[joint], model.idx_qs[joint] + model.nqs[joint])
        v = slice(model.idx_vs[joint], model.idx_vs[joint] + model.nvs[joint])
        name = f"arm {called!r}: joint {model.names[joint]!r}"
        for least, most in zip(model.lowerPositionLimit[q], model.upperPositionLimit[q], strict=True):
            if not least <= most:
                raise InvalidArgument(
                    f"{name} has position limits from {least:g} to {most:g}, expected the lower one first"
                )
        for kind, given in (("velocity", model.velocityLimit[v]), ("effort", model.effortLimit[v])):
            for limit in given:
                if not limit >= 0:
                    raise InvalidArgument(f"{name} has {kind} limit {limit:g}, expected a number >= 0")
