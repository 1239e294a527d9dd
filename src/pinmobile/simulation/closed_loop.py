"""`simulate`: a controller in the loop with a plant, checked before, judged after."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, positive
from pinmobile.controllers import Controller
from pinmobile.disturbances import Force
from pinmobile.errors import Diverged, InvalidArgument
from pinmobile.integrators import Integrator, constant_acceleration
from pinmobile.plant import Context, Plant
from pinmobile.simulation.checks import checked_forces, checked_loop, checked_substeps, sample_times, sampled
from pinmobile.simulation.loop import Loop
from pinmobile.simulation.rollout import Rollout
from pinmobile.trajectories import Reference, Trajectory, check_limits

__all__ = ["simulate"]

_CHUNK = 512  # samples between two looks for divergence


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
        Start, within the joint limits of the plant's arms; by default on the trajectory.
    integrator : callable
        One step of the plant, see `pinmobile.integrators`. The library's keep their order for joints that
        turn about several axes; a callable of one's own sees their displacement as if it changed at the
        velocity, and is of order 2 at most for these.
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
    checked_loop(plant, controller, trajectory, integrator)
    t = sample_times(dt, duration, trajectory.duration)
    reference = sampled(trajectory, t, plant)
    start = _start("q0", q0, reference.q[0]), _start("v0", v0, reference.v[0])
    if getattr(plant, "mounts", ()):
        check_limits(plant, *start)
    count, checked = checked_substeps(substeps, len(t)), checked_forces(forces, plant)
    context = Context.of(plant, dt=dt, t=t, reference=reference, trajectory=trajectory)
    loop = Loop(plant, controller, integrator, context, count, checked, *start)
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
            message += _too_stiff(plant, checked, start[0], dt / count)
            raise Diverged(message, time=float(t[bad]), q=q[0], v=v[0], rollout=kept) from loop.stopped
    return _rollout(plant, t, loop, reference, len(t))


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
            numbered = [*("x", "y", "psi"), *(f"v[{j}]" for j in range(3, plant.nv))]
            names = getattr(plant, "coordinate_names", numbered)
            what = f"the error in {'the rate of ' if column >= plant.nv else ''}{names[column % plant.nv]}"
            return begin + k, f"{what} is {errors[k, column]:.4g}, beyond the limit {limit:g}"
    if good < end - begin:
        parts = ("q", "v", "a", "tau")
        which = [n for n, part in zip(parts, samples, strict=True) if not np.isfinite(part[good]).all()]
        return begin + good, f"{', '.join(which)} not finite"
    return None, ""


def _too_stiff(plant: Any, forces: Sequence[Any], q: Array, h: float) -> str:
    """Return what frictions ask of the step, where that is not met: such a loop shakes itself to pieces.

    With the damping C of the body's axes, explicit steps are stable up to 2 / max eig(M^-1 C), or some more.
    """
    dampings = [force.damping for force in forces if hasattr(force, "damping")]
    if not dampings or not hasattr(plant, "mass_matrix"):
        return ""
    ahead = np.array(q)
    ahead[2] = 0.0  # where the inertial axes are the body's
    rates = np.linalg.eigvals(np.linalg.solve(plant.mass_matrix(ahead)[:3, :3], np.diag(sum(dampings))))
    longest = 2 / max(float(np.abs(rates).max()), 1e-300)
    if h <= longest:
        return ""
    return (
        f"; the friction in `forces` needs steps of the integrator of at most {longest:.2g} s, and they are "
        f"{h:.2g} s: give a smaller dt, or substeps"
    )


def _rollout(plant: Plant, t: Array, loop: Loop, reference: Reference, end: int) -> Rollout:
    q, v, a, tau = loop.samples(0, end)
    error: Any = plant.difference(q, reference.q[:end])
    kept = Reference(*(part[:end] for part in reference))
    return Rollout(robot=plant, t=t[:end], q=q, v=v, a=a, tau=tau, error=error, reference=kept)
