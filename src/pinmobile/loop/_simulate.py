"""`simulate`: a controller in the loop with a plant, checked before, judged after; and its engines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from enum import Enum
from typing import Any
from warnings import warn

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite, instance, positive, shaped, whole
from pinmobile.controllers import Controller
from pinmobile.errors import Diverged, InvalidArgument, LimitWarning, NotTraceable, SlowerEngine
from pinmobile.forces import Force
from pinmobile.integrators import Integrator
from pinmobile.loop._checks import (
    Last,
    check_answers,
    check_controllers_memory,
    checked_forces,
    checked_loop,
    checked_substeps,
    chosen_integrator,
    sample_times,
    sampled,
)
from pinmobile.loop._loop import Loop, named_forces
from pinmobile.loop._python import CompiledRun, PythonRun, Run, with_compiled_plant
from pinmobile.loop._record import is_near
from pinmobile.loop._rollout import Rollout
from pinmobile.parts import OnCoordinates, Starting, able
from pinmobile.plant import Context, Plant, all_samples, coordinates_of, stated, whole_configurations
from pinmobile.signals import told_at
from pinmobile.trajectories import Reference, Trajectory, check_limits


class Engine(Enum):
    """A way to run a closed loop."""

    PYTHON = "one robot at a time, in Python, with Pinocchio's dynamics of a MobileRobot: any parts"
    COMPILED = "laws run on symbols and compiled: parts written in NumPy"

    def __repr__(self) -> str:
        return self.name

    __str__ = __repr__


def checked_engine(engine: object) -> Engine | None:
    """Check that this is None or one of the engines, and return it.

    Raises
    ------
    InvalidArgument
        If it is something else.
    """
    found: Engine | None = instance("engine", engine, Engine | None, "Engine.PYTHON, Engine.COMPILED or None")
    return found


_CHUNK = 512  # samples between two looks for divergence
_NOT_ASKED = "not COMPILED, which runs what can be compiled where engine=Engine.COMPILED asks for it"


def simulate(
    plant: Plant,
    controller: Controller,
    trajectory: Trajectory,
    *,
    dt: float,
    duration: float | None = None,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    integrator: Integrator | None = None,
    substeps: int = 1,
    forces: Sequence[Force | OnCoordinates] | Mapping[str, Force | OnCoordinates] = (),
    limit: float = 1e3,
    engine: Engine | None = None,
    seed: int = 0,
    member: int = 0,
) -> Rollout:
    """Run the closed loop from 0 to `duration` and record every sample.

    The controller is asked at t = 0, dt, 2 dt, ...; its input is held in between, as a digital controller's
    is, within the limits that the plant states of its `inputs`. The integrator divides each dt into
    `substeps`. Input and acceleration are recorded at the last sample too. The other `forces` act in
    continuous time: each stage of the integrator sees them at its own time and state. They are part of the
    recorded acceleration, not of the recorded u. A plant with a step of its own takes that in place of an
    integrator's; its acceleration is the mean of the first substep.

    Parameters
    ----------
    plant : MobileRobot or other plant
        What is simulated: see `pinmobile.plant.Plant`.
    controller : controller
        See `pinmobile.controllers`; `law(f)` makes one of a plain function.
    trajectory : trajectory
        Gives the reference: ``trajectory(t)`` with `t` of shape (N + 1,), and a ``duration`` [s]. It has as
        many of the plant's first coordinates as its ``reference_sizes`` allows.
    dt : float
        Sampling time of the controller [s].
    duration : float, optional
        [s]; a whole number of dt, at most the trajectory's; by default the whole steps in the trajectory's.
    q0, v0 : array_like, shape (nq,) and (nv,), optional
        Start, within the joint limits of the plant's arms; by default on the trajectory, completed by the
        plant's ``start``.
    integrator : callable, optional
        One step of the plant, see `pinmobile.integrators`; by default the plant's own choice, and of one that
        has none constant_acceleration.
    substeps : int
        Steps of the integrator per dt.
    forces : sequence of callables, or mapping of names to callables
        What acts besides the controller, see `pinmobile.forces`. Each ``force(t, pose, rate)`` gets the
        body's (x, y, psi) and their rates, shape (3,), and returns the wrench (Fx, Fy, Mz) [N, N, N m]; one
        that has ``on_coordinates(t, q, v)`` returns a generalised force, shape (nv,).
    limit : float
        The loop counts as diverged when an error in a coordinate (psi on the circle) or in a velocity is
        beyond it [m, rad, m/s, rad/s].
    engine : Engine, optional
        `Engine.PYTHON` or `Engine.COMPILED`, the same laws as machine code; by default the plant's choice: a
        MobileRobot runs in Python, with Pinocchio's dynamics, a robot on wheels compiled, but for a
        controller that cannot be; `Rollout.fallback_reason` says why. COMPILED, where it is asked for and is
        not possible, is refused.
    seed, member : int
        What the noise of controllers follows from: the seed of an ensemble, and the robot's number in it.

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

    Warns
    -----
    SlowerEngine
        If a part keeps a loop from being compiled that by default is.
    LimitWarning
        Once, if the run exceeds limits of the robot, or the robot tips over: see `Rollout.events`.
    """
    dt, limit = positive("dt", dt, "s"), positive("limit", limit)
    integrator = chosen_integrator(plant, integrator)
    checked_loop(plant, controller, trajectory, integrator)
    t = sample_times(dt, duration, trajectory.duration)
    count, checked = checked_substeps(substeps, len(t)), checked_forces(forces, plant)
    asked = checked_engine(engine)
    compiles = asked is Engine.COMPILED or (asked is None and stated(plant, "compiles"))
    whole_loop = Loop(plant, controller, trajectory, checked, integrator, count)
    reference = sampled(trajectory, t, plant)
    start = _start(plant, reference, q0, v0)
    context = Context.of(plant, dt=dt, t=t, reference=reference, trajectory=trajectory)
    context = replace(context, seed=whole("seed", seed, least=0), member=whole("member", member, least=0))
    check_answers(plant, checked, integrator, *start, dt / count)
    check_controllers_memory(controller, context, *start)
    loop, why = _engaged(whole_loop, context, start, asked, compiles=compiles)
    made = {"engine": "COMPILED" if isinstance(loop, CompiledRun) else "PYTHON", "fallback_reason": why}
    if why.startswith("not") and compiles:
        warn(f"this loop runs by PYTHON: {why}", SlowerEngine, stacklevel=2)
    told, chunk = (controller, trajectory), len(t) if isinstance(loop, CompiledRun) else _CHUNK
    for begin in range(0, len(t), chunk):
        end = min(begin + chunk, len(t))
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # the check below reports it
            loop.fill(begin, end)
        if loop.is_fine(begin, end, limit):
            continue
        bad, why = _first_bad(plant, loop, reference, begin, end, limit)
        if bad is not None:
            kept = _rollout(plant, t, loop, reference, bad, made, told) if bad else None
            q, v, _, _ = loop.samples(bad, bad + 1)
            message = f"the loop diverged at t = {t[bad]:g} s (sample {bad} of {len(t) - 1}): {why}"
            message += _too_stiff(plant, checked, start[0], dt / count)
            message += "".join(f"; {event}" for event in (kept.events if kept else ()))
            raise Diverged(message, time=float(t[bad]), q=q[0], v=v[0], rollout=kept) from loop.stopped
    found = _rollout(plant, t, loop, reference, len(t), made, told)
    if found.events:
        warn("; ".join(found.events), LimitWarning, stacklevel=2)
    return found


def _engaged(
    loop: Loop, context: Context, start: tuple[Array, Array], asked: Engine | None, *, compiles: bool
) -> tuple[Run, str]:
    """Return the run by its engine, and why it is not compiled, where that was not asked for."""
    if not compiles:
        return PythonRun(loop, context, *start), _NOT_ASKED if asked is None else ""
    try:
        return CompiledRun(loop, context, *start), ""
    except NotTraceable as error:
        if asked is Engine.COMPILED:
            raise InvalidArgument(
                f"engine is Engine.COMPILED, which cannot run this: {error.reason}"
            ) from error
        why = error.reason
    try:
        compiled = with_compiled_plant(loop, context, *start)
    except NotTraceable:
        return PythonRun(loop, context, *start), f"not COMPILED: {why}"
    why = f"plant and forces are compiled, the controller runs in Python; not COMPILED: {why}"
    return PythonRun(compiled, context, *start), why


def _start(
    plant: Plant, reference: Reference, q0: ArrayLike | None, v0: ArrayLike | None
) -> tuple[Array, Array]:
    """Return the state to start with: as given, or on the reference as the plant completes it."""
    first = Reference(*(part[0] for part in reference))
    asked, by_default = tuple(part.tobytes() for part in first), q0 is None and v0 is None
    known = _started.get(plant, asked) if by_default else None
    if known is not None:
        return known[0].copy(), known[1].copy()
    starting = able(plant, Starting)
    if starting is not None:
        on_reference = starting.start(first)
    elif first.v.size == plant.nv:
        on_reference = first.q, first.v
    elif q0 is None or v0 is None:
        raise InvalidArgument(
            f"reference has the first {first.v.size} of {plant.nv} coordinates, and the plant, a "
            f"{type(plant).__name__}, has no start(reference), which completes them: give q0 and v0"
        )
    else:
        on_reference = np.zeros(plant.nq), np.zeros(plant.nv)
    found = []
    for name, given, default, size in zip(
        ("q0", "v0"), (q0, v0), on_reference, (plant.nq, plant.nv), strict=True
    ):
        own = finite(
            name if given is not None else f"{name} of plant.start", default if given is None else given
        )
        shaped(name, own, (size,))
        found.append(own)
    q, v = found
    if stated(plant, "velocity_limit") is not None:
        check_limits(plant, q, v)
    check = stated(plant, "check_start")
    if check is not None:
        try:
            check(q.copy(), v.copy())
        except InvalidArgument as error:
            if error.argument == "start" and q0 is None and v0 is None:
                raise error.calling("reference at its start") from None
            raise
    if by_default:
        _started.keep(plant, asked, (q.copy(), v.copy()))
    return q, v


_started = Last()
"""Starts of plants, by the bytes of the first reference."""


def errors_of(plant: Plant, q: Array, reference: Reference) -> Array:
    """Return the errors of samples, shape (N, n): from q to the reference's n coordinates."""
    whole = whole_configurations(plant, q, reference.q)
    return all_samples(plant, "difference", q, whole)[:, : reference.v.shape[1]]


def _first_bad(
    plant: Plant, loop: Run, reference: Reference, begin: int, end: int, limit: float
) -> tuple[int | None, str]:
    """Return the first sample that is not acceptable, or None, and why."""
    samples = loop.samples(begin, end)
    finite = np.all([np.isfinite(part).all(axis=1) for part in samples], axis=0)
    good = int(np.argmin(finite)) if not finite.all() else end - begin
    if good:
        q, v = (part[:good] for part in samples[:2])
        window = Reference(*(part[begin : begin + good] for part in reference))
        n = window.v.shape[1]
        errors = np.hstack([errors_of(plant, q, window), window.v - v[:, :n]])
        near = is_near(errors[..., None], limit)  # of each error alone
        if not near.all():
            k, column = map(int, np.argwhere(~near)[0])
            named = coordinates_of(plant)[column % n].name
            what = f"the error in {'the rate of ' if column >= n else ''}{named}"
            return begin + k, f"{what} is {errors[k, column]:.4g}, beyond the limit {limit:g}"
    if good < end - begin:
        parts = ("q", "v", "a", "u")
        which = [n for n, part in zip(parts, samples, strict=True) if not np.isfinite(part[good]).all()]
        return begin + good, f"{', '.join(which)} not finite"
    return None, ""


def _too_stiff(plant: Any, forces: Any, q: Array, h: float) -> str:
    """Return what frictions ask of the step, where that is not met: such a loop shakes itself to pieces.

    With the damping C of all coordinates, explicit steps are stable up to 2 / max eig(M^-1 C), or some more.
    """
    if stated(plant, "mass_matrix") is None:
        return ""
    C = np.zeros((plant.nv, plant.nv))
    for force in named_forces(forces).values():
        if stated(force, "damping") is None:
            continue
        if able(force, OnCoordinates):
            C += np.diag(np.broadcast_to(force.damping, plant.nv))
            continue
        psi = plant.pose(q)[2]
        cos, sin = np.cos(psi), np.sin(psi)
        axes = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])  # of the body
        J = np.stack([plant.generalized_force(q, axis) for axis in axes])
        C += J.T @ np.diag(force.damping) @ J
    if not C.any():
        return ""
    rates = np.linalg.eigvals(np.linalg.solve(plant.mass_matrix(q), C))
    longest = 2 / max(float(np.abs(rates).max()), 1e-300)
    if h <= longest:
        return ""
    return (
        f"; the friction in `forces` needs steps of the integrator of at most {longest:.2g} s, and they are "
        f"{h:.2g} s: give a smaller dt, or substeps"
    )


def _rollout(
    plant: Plant,
    t: Array,
    loop: Run,
    reference: Reference,
    end: int,
    made: dict[str, str],
    parts: tuple[Controller, Trajectory],
) -> Rollout:
    q, v, a, u = loop.samples(0, end)
    kept = Reference(*(part[:end] for part in reference))
    error = errors_of(plant, q, kept)
    signals = told_at(t[:end], *parts) | loop.signals(end)
    return Rollout(plant, t[:end], q, v, a, u, error, kept, signals, **made)
