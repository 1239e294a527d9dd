"""`export_c`, which writes a controller or a plant as C."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from pinmobile.arrays import Array, location, matching, one_of, positive, sequence
from pinmobile.compiled import pause_gc
from pinmobile.controllers import ContextView, Controller, check_controller
from pinmobile.errors import InvalidArgument, NotTraceable, argument_errors
from pinmobile.export._law import InputRecorder, InputSchedule, Law
from pinmobile.export._project import Project
from pinmobile.files import file_errors, write
from pinmobile.forces import Force
from pinmobile.integrators import Integrator
from pinmobile.loop import (
    Loop,
    check_forces,
    check_substeps,
    sample_reference,
    sample_times,
    select_integrator,
    start_of,
)
from pinmobile.parts import Following, OnCoordinates, evolved, require
from pinmobile.plant import Context, Plant, check_plant, reference_sizes_of, refuse_path
from pinmobile.trajectories import Reference, Trajectory

_NO_REFERENCE = "which is not known", "give its trajectory, whose samples become tables"
_MAX_TABLE = 2e6  # numbers of the table of a trajectory


def export_c(
    controller: Controller | None,
    plant: Plant,
    folder: str | PathLike[str],
    *,
    dt: float,
    trajectory: Trajectory | None = None,
    name: str = "robot",
    precision: str = "double",
    tunable: Sequence[str] = (),
    forces: Sequence[Force | OnCoordinates] | Mapping[str, Force | OnCoordinates] = (),
    integrator: Integrator | None = None,
    substeps: int = 1,
) -> Path:
    """Write a controller, or a plant, as C99 for the robot's own processor.

    The code computes one sample: ``name_step(t, q, v, &reference, &memory, u)``. It needs no heap, no global
    state, and of the C library only ``sqrt`` and ``fabs``. In double precision it has the bits of `simulate`,
    on every processor. Wrappers such as `DisturbanceObserver`, `MeasurementDelay` and
    `wheels.OdometryFeedback` are part of the controller. Limits of the plant's inputs are applied. The folder
    also contains a test program with recorded samples, a ``CMakeLists.txt``, and a ``README.md`` that states
    what was exported, its operations, its memory, and the effects of NaN and of stale measurements.

    Parameters
    ----------
    controller : controller or None
        Controller; None exports the plant, for tests with hardware in the loop: ``name_step(t, u, &memory)``
        advances its state.
    plant : MobileRobot or other plant
        Plant of the loop. A controller uses its inputs, limits and coordinates.
    folder : path
        Folder of the files, which are replaced.
    dt : float
        Time step [s].
    trajectory : trajectory, optional
        Trajectory. For a controller, its samples become a table; ``name_reference_at(t, &reference)``
        interpolates them by polynomials of order 5; in single precision, velocities by order 3 and
        accelerations linearly. Without it, the caller supplies the reference. An exported plant begins at
        its start, else at 0.
    name : str
        Prefix of all names and files.
    precision : str
        ``"double"`` or ``"single"``, for processors without doubles. Errors of single precision are about
        1e-6 of the largest result, 1e-5 with high gains.
    tunable : sequence of str
        Numbers that stay parameters, by path such as ``"kp"`` or ``"robot.mass"``; all others are constants.
    forces : sequence of callable, or mapping of str to callable
        External forces on an exported plant, see `simulate`.
    integrator : callable, optional
        Integrator of an exported plant, see `simulate`.
    substeps : int
        Integrator steps of an exported plant per dt.

    Returns
    -------
    folder : Path
        Folder with the files.

    Raises
    ------
    InvalidArgument
        If an argument is invalid, the law is not written in NumPy (such as `MPC`), it draws noise, or a
        tunable number acts before the first sample only.
    FileError
        If a file cannot be written.

    See Also
    --------
    simulate : run the same loop here.
    vectorize : machine code of a function for this processor.
    realtime.Stepper : the controller in Python, one sample per call.

    Examples
    --------
    >>> from pinmobile import ComputedTorque, MobileRobot
    >>> from pinmobile.export import export_c
    >>> robot = MobileRobot(mass=30.0, yaw_inertia=1.3)
    >>> law = ComputedTorque(robot, kp=4, kd=4)
    >>> folder = export_c(law, robot, "out/c", dt=0.01, tunable=["kp"])
    >>> sorted(file.name for file in folder.iterdir())
    ['CMakeLists.txt', 'README.md', 'robot.c', 'robot.h', 'robot_test.c']
    """
    one_of("precision", precision, ("double", "single"))
    words = "a name of lower-case letters, digits and _, such as 'robot'"
    matching("name", name, r"[a-z][a-z0-9_]{0,30}", words)
    paths = sequence("tunable", tunable, 'paths of numbers, such as ["kp"]')
    step, target = positive("dt", dt, "s"), location("folder", folder)
    check_plant(plant)
    if controller is not None:
        check_controller(controller)
    loop = Loop(
        plant,
        InputSchedule() if controller is None else controller,
        trajectory,
        check_forces(forces, plant),
        select_integrator(plant, integrator),
        check_substeps(substeps, 1),
    )
    argument = "plant" if controller is None else "controller"
    unable = argument_errors(f"{argument} cannot be exported: ", of=NotTraceable)
    with unable, pause_gc(), np.errstate(all="ignore"):
        context, start, first = initial_context(plant, loop.controller, step, trajectory)
        recorder = InputRecorder(as_measured=controller is not None)
        law = Law(evolved(loop, {"recorder": recorder}), context, start, first, paths)
    title = type(plant).__name__
    if controller is not None:
        title = f"{type(controller).__name__} of a {title}"
    has_table = controller is not None and trajectory is not None
    table = _table(context.reference) if has_table else None
    project = Project(law, name, single=precision == "single", table=table, title=title)
    with file_errors("written", "folder", target):
        target.mkdir(parents=True, exist_ok=True)
    for file, text in project.files().items():
        write(target / file, text.encode(), name="folder")
    return target


def _table(reference: Reference) -> Array:
    """Return the reference at all samples of a trajectory, shape (N + 1, 3 n)."""
    if reference.q.shape != reference.v.shape:
        raise InvalidArgument(
            "trajectory has configurations that are not as many as velocities, expected a trajectory of "
            "the first coordinates, or none: the caller then supplies the reference"
        )
    table = np.concatenate(reference, axis=1)
    if table.size > _MAX_TABLE:
        raise InvalidArgument(
            f"trajectory has {len(table):,} samples, a table of {table.size:,} numbers, expected at most "
            f"{_MAX_TABLE:,.0f}: give a larger dt, or no trajectory"
        )
    return table


def initial_context(
    plant: Plant, controller: Controller, dt: float, trajectory: Trajectory | None
) -> tuple[Any, tuple[Array, Array], Reference]:
    """Return context, initial state and first reference of a controller of a real robot.

    Parameters
    ----------
    plant, controller
        Plant and its controller.
    dt : float
        Time step [s].
    trajectory : trajectory, optional
        Trajectory; None: the reference of each sample is an argument.

    Raises
    ------
    NotTraceable
        If the controller reads a trajectory, and there is none.
    """
    if trajectory is not None:
        refuse_path("trajectory", trajectory)
        require("trajectory", trajectory, Following)
        t = sample_times(dt, None, trajectory.duration)
        reference = sample_reference(trajectory, t, plant)
        context = Context.of(plant, dt=dt, t=t, reference=reference, trajectory=trajectory)
        return context, start_of(plant, reference, None, None), Reference(*(x[0] for x in reference))
    sizes = reference_sizes_of(plant)
    smallest = min(sizes)
    rest = Reference(np.zeros((1, sizes[smallest])), *[np.zeros((1, smallest))] * 2)
    q, v = start_of(plant, rest, None, None)
    errors: list[Exception] = []
    for n in sorted(sizes, reverse=True):
        first = Reference(q[: sizes[n]], v[:n], np.zeros(n))
        full_context: Any = Context.of(plant, dt=dt, reference=Reference(*(x[None] for x in first)))
        blind_context: Any = ContextView(full_context, _NO_REFERENCE)
        try:  # the largest reference that the controller accepts
            controller(0.0, q.copy(), v.copy(), first, controller.initial_state(blind_context))
        except NotTraceable:
            raise
        except Exception as error:
            errors.append(error)
        else:
            return blind_context, (q, v), first
    raise errors[0]
