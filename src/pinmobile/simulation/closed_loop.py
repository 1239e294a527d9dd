"""`simulate`: a controller in the loop with a plant, checked before, judged after."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, positive, vector, whole
from pinmobile.controllers import Controller, check_controller
from pinmobile.disturbances import Force
from pinmobile.errors import Diverged, InvalidArgument
from pinmobile.integrators import Integrator, constant_acceleration
from pinmobile.simulation.loop import Loop
from pinmobile.simulation.plant import Plant
from pinmobile.simulation.rollout import Rollout
from pinmobile.trajectories import Reference, Trajectory

__all__ = ["simulate"]

_CHUNK = 512  # samples between two looks for divergence
_WHOLE = 1e-9  # relative rounding allowed in duration / dt
_PLANE = 3  # coordinates that a force on the body acts on
_MOST = 1e8  # samples: beyond, some 20 GB of numbers


def simulate(
    plant: Plant,
    controller: Controller,
    trajectory: Trajectory,
    *,
    dt: float,
    duration: float | None = None,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    integrator: Integrator = constant_acceleration,
    substeps: int = 1,
    forces: Sequence[Force] = (),
    limit: float = 1e3,
) -> Rollout:
    """Run the closed loop from 0 to `duration` and record every sample.

    The controller is asked at t = 0, dt, 2 dt, ...; its force is held in between, as a digital controller's
    is. The integrator divides each dt into `substeps`. Force and acceleration are recorded at the last
    sample too. The other `forces` act on the body in continuous time: each stage of the integrator sees them
    at its own time and state. They are part of the recorded acceleration, not of the recorded tau.

    Parameters
    ----------
    plant : MobileRobot or other plant
        What is simulated.
    controller : controller
        See `pinmobile.controllers`; `law(f)` makes one of a plain function.
    trajectory : trajectory
        Gives the reference: ``trajectory(t)`` with `t` of shape (N + 1,), and a ``duration`` [s].
    dt : float
        Sampling time of the controller [s].
    duration : float, optional
        [s]; a whole number of dt, at most the trajectory's, which is the default.
    q0, v0 : array_like, shape (nq,) and (nv,), optional
        Start; by default on the trajectory.
    integrator : callable
        One step of the plant, see `pinmobile.integrators`.
    substeps : int
        Steps of the integrator per dt.
    forces : sequence of callables
        What acts besides the controller, see `pinmobile.disturbances`: each ``force(t, q, v)`` gets the pose
        (x, y, psi) and its rate, shape (3,), and returns (Fx, Fy, Mz) [N, N, N m].
    limit : float
        The loop counts as diverged when an error in a coordinate (psi on the circle) or in a velocity is
        beyond it [m, rad, m/s, rad/s].

    Returns
    -------
    rollout : Rollout

    Raises
    ------
    InvalidArgument
        If an argument is not what is expected, or the controller or a force returns something else than a
        force.
    Diverged
        If a number is no longer finite or an error is beyond `limit`; it carries what was recorded before.
    """
    dt, limit = positive("dt", dt, "s"), positive("limit", limit)
    check_controller(controller)
    for name, value, attribute in (
        ("plant", plant, "forward_dynamics"),
        ("trajectory", trajectory, "duration"),
    ):
        if isinstance(value, type) or not hasattr(value, attribute):
            raise InvalidArgument(f"{name} is {value!r}, expected something with {attribute!r}")
    if isinstance(integrator, type) or not callable(integrator):
        raise InvalidArgument(
            f"integrator is {integrator!r}, expected one of pinmobile.integrators or such a step"
        )
    t = _sample_times(dt, duration, trajectory.duration)
    reference = _sampled(trajectory, t, plant)
    start = _start("q0", q0, reference.q[0]), _start("v0", v0, reference.v[0])
    count, checked = whole("substeps", substeps), _checked(forces, plant)
    loop = Loop(plant, controller, integrator, reference, t, dt, count, checked, *start)
    for begin in range(0, len(t), _CHUNK):
        end = min(begin + _CHUNK, len(t))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # the check below tells
            loop.run(begin, end)
        if loop.is_fine(begin, end, limit):
            continue
        bad, why = _first_bad(plant, loop, reference, begin, end, limit)
        if bad is not None:
            kept = _rollout(plant, t, loop, reference, bad) if bad else None
            q, v, _, _ = loop.samples(bad, bad + 1)
            message = f"the loop diverged at t = {t[bad]:g} s (sample {bad} of {len(t) - 1}): {why}"
            raise Diverged(message, time=float(t[bad]), q=q[0], v=v[0], rollout=kept)
    return _rollout(plant, t, loop, reference, len(t))


def _sample_times(dt: float, duration: float | None, longest: float) -> Array:
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
    if abs(steps * dt - total) > _WHOLE * total:
        below = int(total / dt)
        raise InvalidArgument(
            f"duration is {total} s, expected a whole number of steps dt = {dt} s, "
            f"such as {below * dt:.12g} s"
        )
    t = np.arange(steps + 1) * dt
    t[-1] = total
    return np.asarray(np.minimum(t, longest))


def _sampled(trajectory: Trajectory, t: Array, plant: Plant) -> Reference:
    try:
        reference = trajectory(t)
    except (TypeError, ValueError) as error:
        raise InvalidArgument(
            f"trajectory cannot be asked for an array of {len(t)} times: {error}"
        ) from error
    for name, size in (("q", plant.nq), ("v", plant.nv), ("a", plant.nv)):
        value = np.asarray(getattr(reference, name, None))
        if value.shape != (len(t), size):
            raise InvalidArgument(
                f"trajectory gives {name} of shape {value.shape} for {len(t)} times, "
                f"expected ({len(t)}, {size})"
            )
    return Reference(*(vector(f"trajectory's {n}", getattr(reference, n), s) for n, s in _sizes(plant)))


def _sizes(plant: Plant) -> tuple[tuple[str, int], ...]:
    return ("q", plant.nq), ("v", plant.nv), ("a", plant.nv)


def _checked(forces: Any, plant: Plant) -> tuple[Force, ...]:
    if callable(forces):
        raise InvalidArgument(f"forces is {forces!r}, expected a sequence of forces, such as [force]")
    try:
        listed = tuple(forces)
    except TypeError:
        raise InvalidArgument(f"forces is {forces!r}, expected a sequence of forces") from None
    for k, force in enumerate(listed):
        if isinstance(force, type) or not callable(force):
            raise InvalidArgument(f"forces[{k}] is {force!r}, expected a function of t, q and v")
    if listed and not plant.nu == plant.nv >= _PLANE:
        raise InvalidArgument(
            f"forces are given for a plant with nv = {plant.nv} and nu = {plant.nu}, "
            "expected one whose input is (Fx, Fy, Mz, ...)"
        )
    return listed


def _start(name: str, value: ArrayLike | None, default: Array) -> Array:
    if value is None:
        return default
    start = finite(name, value)
    if start.shape != default.shape:
        raise InvalidArgument(f"{name} has shape {start.shape}, expected {default.shape}")
    return start


def _first_bad(
    plant: Plant, loop: Loop, reference: Reference, begin: int, end: int, limit: float
) -> tuple[int | None, str]:
    """Return the first sample that is not acceptable, or None, and why."""
    samples = loop.samples(begin, end)
    finite = np.all([np.isfinite(part).all(axis=1) for part in samples], axis=0)
    good = int(np.argmin(finite)) if not finite.all() else end - begin
    if good:
        q, v = (part[:good] for part in samples[:2])
        window = slice(begin, begin + good)
        errors = np.hstack([plant.difference(q, reference.q[window]), reference.v[window] - v])
        beyond = np.abs(errors) > limit
        if beyond.any():
            k, column = map(int, np.argwhere(beyond)[0])
            names = [*("x", "y", "psi"), *(f"q[{j}]" for j in range(3, plant.nv))]
            what = f"the error in {'the rate of ' if column >= plant.nv else ''}{names[column % plant.nv]}"
            return begin + k, f"{what} is {errors[k, column]:.4g}, beyond the limit {limit:g}"
    if good < end - begin:
        parts = ("q", "v", "a", "tau")
        which = [n for n, part in zip(parts, samples, strict=True) if not np.isfinite(part[good]).all()]
        return begin + good, f"{', '.join(which)} not finite"
    return None, ""


def _rollout(plant: Plant, t: Array, loop: Loop, reference: Reference, end: int) -> Rollout:
    q, v, a, tau = samples = loop.samples(0, end)
    for array in samples:
        array.setflags(write=False)  # nobody else has it: the rollout need not copy
    error: Any = plant.difference(q, reference.q[:end])
    kept = Reference(*(part[:end] for part in reference))
    return Rollout(robot=plant, t=t[:end], q=q, v=v, a=a, tau=tau, error=error, reference=kept)
