"""What no arm has: limits the wrong way round, bodies that cannot exist, joints that nothing resists."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import pinocchio as pin

from pinmobile.arrays import Array
from pinmobile.errors import InvalidArgument
from pinmobile.robot.tree import parts_of

_ROUNDING = 1e-9  # of the moments of inertia, relative: files carry as many digits
_GYRATION = 1e-9  # and of mass [m^2]: exporters leave noise of the size of 1e-18 where a moment is zero
_SINGULAR = 1e-9  # what is left of a joint's inertia when all joints beyond it give way, as a share of it
_GENERIC = 20  # seed of the posture at which inertias are tried; any will do


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

    Damping and friction that push, or are no numbers, too.

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
        q, v = parts_of(model, joint)
        name = f"arm {called!r}: joint {model.names[joint]!r}"
        for least, most in zip(model.lowerPositionLimit[q], model.upperPositionLimit[q], strict=True):
            if not least <= most:
                raise InvalidArgument(
                    f"{name} has position limits from {least:g} to {most:g}, expected the lower one first"
                )
        for kind, given in (
            ("velocity limit", model.velocityLimit),
            ("effort limit", model.effortLimit),
            ("damping", model.damping),
            ("friction", model.friction),
        ):
            for number in given[v]:
                if not number >= 0:
                    raise InvalidArgument(f"{name} has {kind} {number:g}, expected a number >= 0")


def check_inertias(model: pin.Model, posture: Array, called: str) -> None:
    """Refuse a joint that nothing resists, at rest or at a posture like any other.

    Parameters
    ----------
    model : pin.Model
        The arm without what is locked.
    posture : ndarray, shape (nq,)
        Its reference posture.
    called : str
        What the arm is called, for the message.

    Raises
    ------
    InvalidArgument
        The message names the joint.
    """
    for joint, where in _weakest(model, posture):
        raise InvalidArgument(f"arm {called!r}: {_cause(model, joint, where)}, or that joint locked")


def check_whole(model: pin.Model, posture: Array) -> None:
    """Refuse what makes a robot's dynamics overflow, or lost to rounding, at rest or at another posture.

    Parameters
    ----------
    model : pin.Model
        The base and all that it carries.
    posture : ndarray, shape (nq,)
        In the order of the model.

    Raises
    ------
    InvalidArgument
        The message names the joint, and the heaviest part.
    """
    joint = max(range(model.njoints), key=lambda k: model.inertias[k].mass)
    heaviest = f"the heaviest, {model.inertias[joint].mass:g} kg, is on joint {model.names[joint]!r}"
    if not np.isfinite(pin.crba(model, model.createData(), np.array(posture))).all():
        raise InvalidArgument(
            "the robot's mass matrix is beyond 1.8e308, expected smaller masses or distances: " + heaviest
        )
    for joint, where in _weakest(model, posture):
        raise InvalidArgument(
            f"the robot's mass matrix is singular to rounding {where}: joint {model.names[joint]!r} alone "
            f"moves less than {_SINGULAR:g} of the inertia that it moves with those beyond, expected masses "
            f"and distances nearer to each other: {heaviest}"
        )


def _weakest(model: pin.Model, posture: Array) -> Iterator[tuple[int, str]]:
    """Yield a joint that nothing resists to rounding, and where, at each of two postures that have one."""
    if not model.nv:
        return
    data = model.createData()
    step = np.random.default_rng(_GENERIC).uniform(-1, 1, model.nv)
    generic = pin.integrate(model, np.array(posture), step)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        for where, q in (("at rest", posture), ("at a posture like any other", generic)):
            own = np.diag(pin.crba(model, data, q)).copy()
            pin.cholesky.decompose(model, data)
            left = np.array(data.D)
            # Elimination goes from the tips to the root, and what comes after a zero is no number.
            singular = np.flatnonzero(~(left > _SINGULAR * own))
            if len(singular):
                yield _joint_of(model, int(singular[-1])), where


def _cause(model: pin.Model, joint: int, where: str) -> str:
    """Return what is wrong with a joint that nothing resists, and what is expected."""
    name = repr(model.names[joint])
    moved = [model.inertias[beyond] for beyond in model.subtrees[joint]]
    if not any(body.mass or np.array(body.inertia).any() for body in moved):
        return f"joint {name} moves parts that have no inertia, expected inertia beyond each joint"
    return (
        f"the mass matrix is singular {where} about joint {name}: moved together with joints beyond "
        "it, it moves no inertia, expected another `rest`, inertia there"
    )


def _joint_of(model: pin.Model, k: int) -> int:
    """Return the joint of a velocity coordinate."""
    return next(j for j in range(1, model.njoints) if 0 <= k - model.idx_vs[j] < model.nvs[j])
