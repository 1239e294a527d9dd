"""`sensitivities`: derivatives of all samples of a run by numbers of the parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, bounded, finite, instance, one_of, sequence, shaped
from pinmobile.controllers import Controller
from pinmobile.derivatives._gradient import arrange_slopes
from pinmobile.derivatives._problem import loop_errors, problem_of
from pinmobile.errors import InvalidArgument
from pinmobile.forces import Force
from pinmobile.integrators import Integrator
from pinmobile.loop import Engine, Rollout, Samples, simulate
from pinmobile.parts import OnCoordinates
from pinmobile.plant import Plant
from pinmobile.trajectories import Trajectory


@final
@dataclass(frozen=True, eq=False, repr=False)
class Sensitivities:
    """Derivatives of the samples of a run.

    Attributes
    ----------
    rollout : Rollout
        The run.
    q, v, u, a : dict of str to ndarray
        Derivatives of configuration, velocity, input and acceleration by each number, by its path: shape
        (N + 1, nq, ...), followed by the shape of the number.
    units : dict of str to str
        Unit of each number.

    See Also
    --------
    derivatives.sensitivities : compute them.
    plots.sensitivities : figure with bands.

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Tangent
    >>> from pinmobile.derivatives import sensitivities
    >>> circle = Tangent(Circle(1.0, 0.5, 4.0))
    >>> parts = MobileRobot(30.0, 1.3), PD(120, 120), circle
    >>> found = sensitivities(*parts, by=["mass"], dt=0.02)
    >>> found.q["plant.mass"].shape
    (201, 3)
    >>> wide = found.deviation({"mass": 3.0})  # [m, m, rad]
    >>> wide.max(axis=0).round(4)
    array([0.0061, 0.0051, 0.    ])
    """

    rollout: Rollout
    q: Mapping[str, Array]
    v: Mapping[str, Array]
    u: Mapping[str, Array]
    a: Mapping[str, Array]
    units: Mapping[str, str]

    def deviation(self, deviations: Mapping[str, ArrayLike], of: str = "q") -> Array:
        """Return the standard deviation of each sample for independent errors of the numbers, to first order.

        Parameters
        ----------
        deviations : mapping of str to array_like
            Standard deviation of each number, by its path or the end of it.
        of : str
            "q", "v", "u" or "a".

        Returns
        -------
        ndarray, shape (N + 1, n)
            Standard deviations, in the units of the quantity.

        Raises
        ------
        InvalidArgument, UnknownName
            If a path or quantity is unknown, or a deviation does not fit its number.
        """
        slopes = getattr(self, one_of("of", of, ("q", "v", "u", "a")))
        instance("deviations", deviations, Mapping, "a mapping of paths to standard deviations")
        total: Any = 0.0
        for name, value in deviations.items():
            ends = [path for path in slopes if f".{path}".endswith(f".{name}")]
            path = ends[0] if len(ends) == 1 else one_of("deviations", name, slopes)
            size = bounded(f"deviations[{name!r}]", finite(f"deviations[{name!r}]", value), least=0)
            shaped(f"deviations[{name!r}]", size, (), slopes[path].shape[2:])
            square = (slopes[path] * size) ** 2
            total = total + square.reshape(*square.shape[:2], -1).sum(axis=2)
        return np.asarray(np.sqrt(total))

    def __repr__(self) -> str:
        return f"<Sensitivities: {self.rollout.t.size} samples by {', '.join(self.q)}>"


def sensitivities(
    plant: Plant,
    controller: Controller,
    trajectory: Trajectory,
    *,
    by: Sequence[str],
    dt: float,
    duration: float | None = None,
    q0: ArrayLike | None = None,
    v0: ArrayLike | None = None,
    integrator: Integrator | None = None,
    substeps: int = 1,
    forces: Sequence[Force | OnCoordinates] | Mapping[str, Force | OnCoordinates] = (),
) -> Sensitivities:
    """Return the derivatives of all samples of a run by numbers of the parts, in forward mode.

    Parameters
    ----------
    plant, controller, trajectory, dt, duration, q0, v0, integrator, substeps, forces
        Closed loop, see `simulate`.
    by : sequence of str
        Numbers by path, see `gradient`.

    Returns
    -------
    Sensitivities
        The run and its derivatives.

    Raises
    ------
    InvalidArgument
        If an argument is invalid, or the loop cannot be compiled.

    See Also
    --------
    derivatives.gradient : derivatives of one number of the run.
    ensemble : finite changes of the numbers.

    Examples
    --------
    >>> from pinmobile import PD, Circle, MobileRobot, Tangent
    >>> from pinmobile.derivatives import sensitivities
    >>> circle = Tangent(Circle(1.0, 0.5, 4.0))
    >>> parts = MobileRobot(30.0, 1.3), PD(120, 120), circle
    >>> found = sensitivities(*parts, by=["controller.kp"], dt=0.02)
    >>> found.q["controller.kp"][-1].round(6)  # [m, m, rad per N/m]
    array([-0.000402,  0.00022 , -0.      ])
    """
    if not sequence("by", by, 'paths of numbers, such as ["controller.kp"]'):
        raise InvalidArgument("by is empty, expected paths of numbers")
    options: dict[str, Any] = {"dt": dt, "duration": duration, "integrator": integrator, "substeps": substeps}
    options["forces"] = forces
    parts = plant, controller, trajectory
    problem = problem_of(*parts, lambda _: Samples(), by, (q0, v0), n=1, **options)
    run = simulate(*parts, q0=q0, v0=v0, engine=Engine.COMPILED, **options)
    with loop_errors():
        inputs = problem.inputs({})
        directions = problem.directions(inputs, {})
        _, _, kept = problem.tangents(inputs, directions)
    q, v, u, a = (
        arrange_slopes(problem, directions, np.moveaxis(kept[f"tangent {name}"][:, : len(run.t)], 0, -1))
        for name in ("q", "v", "u", "a")
    )
    return Sensitivities(run, q, v, u, a, {path: number.unit for path, number in problem.numbers.items()})
