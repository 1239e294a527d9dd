"""What `simulate` refuses before it starts, and the times and references of its samples."""

from typing import TYPE_CHECKING, Any

import numpy as np

from pinmobile.arrays import Array, affordable, callable_as, positive, vector, whole
from pinmobile.controllers import check_controller
from pinmobile.disturbances import Force
from pinmobile.errors import InvalidArgument, shown
from pinmobile.integrators import check_integrator
from pinmobile.trajectories import Reference, Trajectory, check_limits

if TYPE_CHECKING:
    from pinmobile.plant import Plant

__all__ = ["checked_forces", "checked_loop", "checked_substeps", "sample_times", "sampled"]

_WHOLE = 1e-9  # relative rounding allowed in duration / dt
_PLANE = 3  # coordinates that a force on the body acts on
_MOST = 1e8  # samples
_SHORTER = "give a larger dt or a shorter duration"
_MOST_STEPS = 1e11  # of the integrator: days
_RECORDED = 16  # numbers for each coordinate of a sample: of the loop, the reference and the rollout


def checked_loop(plant: Any, controller: Any, trajectory: Any, integrator: Any) -> None:
    """Refuse what is no plant, controller, trajectory or integrator.

    Raises
    ------
    InvalidArgument
        If one of them is not.
    """
    check_controller(controller)
    if isinstance(trajectory, type) or not hasattr(trajectory, "duration"):
        raise InvalidArgument(f"trajectory is {shown(trajectory)}, expected something with 'duration'")
    if hasattr(trajectory, "derivative"):
        raise InvalidArgument(
            f"trajectory is {shown(trajectory)}, a path, which has no heading, expected a trajectory: "
            "Tangent(path) or FixedHeading(path, psi)"
        )
    sizes = [getattr(plant, size, None) for size in ("nq", "nv", "nu")]
    if isinstance(plant, type) or not hasattr(plant, "forward_dynamics") or not all(map(_is_size, sizes)):
        raise InvalidArgument(
            f"plant is {shown(plant)}, expected something with 'forward_dynamics' and the sizes nq, nv, nu"
        )
    callable_as("trajectory(t)", trajectory)
    check_integrator(integrator)


def _is_size(value: Any) -> bool:
    return isinstance(value, int | np.integer)


def checked_substeps(substeps: Any, samples: int) -> int:
    """Return the steps of the integrator per sample.

    Raises
    ------
    InvalidArgument
        If it is no whole number >= 1, or makes more steps than anybody waits for.
    """
    count = whole("substeps", substeps)
    if count * samples > _MOST_STEPS:
        raise InvalidArgument(
            f"substeps is {count}, which makes {count * samples:.3g} steps in {samples:,} samples, "
            f"expected at most {_MOST_STEPS:g}"
        )
    return count


def sample_times(dt: float, duration: float | None, longest: float) -> Array:
    """Return the times of the samples, shape (N + 1,) [s].

    Parameters
    ----------
    dt : float
        Sampling time > 0 [s].
    duration : float or None
        Time of the last sample [s]; None: `longest`.
    longest : float
        Duration of the trajectory [s].

    Raises
    ------
    InvalidArgument
        If the duration is no whole number of steps, or beyond the trajectory's.
    """
    longest = positive("trajectory.duration", longest, "s")
    total = longest if duration is None else positive("duration", duration, "s")
    if total > longest * (1 + _WHOLE):
        raise InvalidArgument(f"duration is {total} s, expected at most the trajectory's {longest} s")
    if dt > total * (1 + _WHOLE):
        raise InvalidArgument(f"dt is {dt} s, expected at most the duration, {total} s")
    if total / dt > _MOST:
        raise InvalidArgument(
            f"dt is {dt} s, which makes {total / dt:.3g} samples, expected at most {_MOST:g}"
        )
    steps = round(total / dt)
    affordable(f"the records of {steps + 1:,} samples", _RECORDED * _PLANE * (steps + 1), _SHORTER)
    if abs(steps * dt - total) > _WHOLE * total:
        below = int(total / dt)
        raise InvalidArgument(
            f"duration is {total} s, expected a whole number of steps dt = {dt} s, "
            f"such as {below * dt:.12g} s"
        )
    t = np.arange(steps + 1) * dt
    t[-1] = total
    return np.asarray(np.minimum(t, longest))


def sampled(trajectory: Trajectory, t: Array, plant: "Plant") -> Reference:
    """Return the reference at the times `t`, shape (N + 1,) [s].

    Raises
    ------
    InvalidArgument
        If what the trajectory gives does not fit the plant, or leaves its joint limits where it has any.
    """
    affordable(
        f"the records of {len(t):,} samples of {plant.nv} coordinates",
        _RECORDED * len(t) * plant.nv,
        _SHORTER,
    )
    try:
        reference = trajectory(t)
    except InvalidArgument:
        raise  # it says itself what it is about, such as a joint's limit
    except (TypeError, ValueError) as error:
        raise InvalidArgument(
            f"trajectory cannot be asked for an array of {len(t)} times: {error}"
        ) from error
    for name, size in (("q", plant.nq), ("v", plant.nv), ("a", plant.nv)):
        value = np.asarray(getattr(reference, name, None))
        if value.shape != (len(t), size):
            of_base = getattr(plant, "mounts", ()) and value.shape == (len(t), _PLANE)
            how = ": a motion of base and arms, WholeBody(robot, base, *joints)" if of_base else ""
            raise InvalidArgument(
                f"trajectory gives {name} of shape {value.shape} for {len(t)} times, "
                f"expected ({len(t)}, {size}){how}"
            )
    checked = Reference(*(vector(f"trajectory's {n}", getattr(reference, n), s) for n, s in _sizes(plant)))
    if getattr(plant, "mounts", ()):
        check_limits(plant, checked.q, checked.v, t)
    return checked


def _sizes(plant: "Plant") -> tuple[tuple[str, int], ...]:
    return ("q", plant.nq), ("v", plant.nv), ("a", plant.nv)


def checked_forces(forces: Any, plant: "Plant") -> tuple[Force, ...]:
    """Return the forces, after refusing what is none, or a plant that cannot feel them.

    Raises
    ------
    InvalidArgument
        If one is no function, or the plant's input is no generalised force.
    """
    if callable(forces):
        raise InvalidArgument(f"forces is {shown(forces)}, expected a sequence of forces, such as [force]")
    try:
        listed = tuple(forces)
    except TypeError:
        raise InvalidArgument(f"forces is {shown(forces)}, expected a sequence of forces") from None
    for k, force in enumerate(listed):
        callable_as(f"forces[{k}](t, q, v)", force)
    if listed and not plant.nu == plant.nv >= _PLANE:
        raise InvalidArgument(
            f"forces are given for a plant with nv = {plant.nv} and nu = {plant.nu}, "
            "expected one whose input is (Fx, Fy, Mz, ...)"
        )
    return listed
