"""`PayloadTransfer`: a robot that picks up a payload and releases it."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cached_property
from operator import attrgetter, methodcaller
from typing import Any, final

import numpy as np

from pinmobile.arrays import Array, ArrayLike, finite
from pinmobile.compiled import has_symbols, leaves, map_leaves
from pinmobile.forces import check_interval, unit_step
from pinmobile.integrators import rk4
from pinmobile.loop._loop import RecordedStep
from pinmobile.parts import Loadable, by_value, child, holds_symbols, number, option, part, replace, walk
from pinmobile.plant import stated
from pinmobile.robot import PayloadBody

_SHARED_NAMES = re.compile(  # attributes on which the load has no effect
    "n[qvu]|coordinates|configuration_names|inputs|reference_sizes|is_vector_space|compiles|broadcasts|rest|"
    "integrate|difference|pose|pose_rate|generalized_force|start|check_start|initial_state|lower|upper|"
    "velocity_limit|effort_limit|size|mounts|footprint|grounded|metrics|frame_names?|frame_pose|end_effector"
)
_TIMED_NAMES = re.compile("evaluate_metrics|signals")
_SAMPLE_NAMES = re.compile(
    "(ground|mount)_wrench|contact_loads|slip_margins|contacts|evaluate_metrics|signals|mass_matrix|gravity|"
    "nonlinear_effects|(inverse|forward)_dynamics|(kinetic|potential)_energy|weight"
)
_VISUAL_NAMES = re.compile("visual_model|model|drawing|frame_placements|top|table|robot|ground")


@final
@part
@by_value
class PayloadTransfer:
    """Plant that picks up a payload with a frame of a robot, and releases it.

    The payload belongs to the robot from `begin` to before `end`, with its weight and inertia. Otherwise the
    plant is the robot alone. The velocity is continuous at both times: the payload has the velocity of the
    frame. Each step uses the robot at its start, so the times take effect at a step. The step is that of the
    robot, if it has its own (dry ground, voltages), otherwise that of `rk4`; ``substeps`` divides it.

    Sizes, names, frames and metrics are those of the robot. Methods that depend on the load need the time:
    use ``plant.robot_at(t)``. Controllers accept a robot, not this plant: `robot` for a controller without
    the payload, `loaded` for a controller with the payload.

    Parameters
    ----------
    robot : MobileRobot or WheeledRobot
        Robot without the payload.
    load : PayloadBody
        Mass, centre of mass, inertia and size of the payload.
    begin : float
        Time from which the robot holds the payload [s].
    end : float, optional
        Time from which it does not [s]; default: no end.
    frame : str, optional
        Name of the frame that holds the payload; default: the end effector of the robot.

    Raises
    ------
    InvalidArgument
        If `end` is not above `begin`, or as in `MobileRobot.attach`.
    UnknownName
        If the robot has no such frame.

    See Also
    --------
    MobileRobot.attach : load for a whole run
    forces.PayloadForce : load on the body, without weight
    balance.tip_over_margin : margin of a run, with the payload while the robot holds it

    Examples
    --------
    >>> from pinmobile import Circle, ComputedTorque, MobileRobot
    >>> from pinmobile import PayloadBody, PayloadTransfer, Tangent
    >>> from pinmobile import simulate
    >>> robot = MobileRobot.box(mass=30.0)
    >>> crate = PayloadBody(10.0, com=(0.5, 0, 0.3))
    >>> plant = PayloadTransfer(robot, crate, begin=2.0, end=4.0)
    >>> robots = [plant.robot_at(t) for t in (1, 2, 4)]
    >>> [robot.with_locked_arms().mass for robot in robots]  # [kg]
    [30.0, 40.0, 30.0]
    >>> path = Tangent(Circle(1.0, rate=0.5, duration=6.0))
    >>> for model in (plant.robot, plant.loaded):
    ...     law = ComputedTorque(model, kp=4, kd=4)
    ...     run = simulate(plant, law, path, dt=0.01)
    ...     print(f"{1e3 * run.max_error().max():.0f} mm or mrad")
    219 mm or mrad
    64 mm or mrad
    """

    robot: Any = child(Loadable, expected="a MobileRobot or a WheeledRobot")
    load: PayloadBody = child(PayloadBody, expected="a PayloadBody")
    begin: float = number(unit="s", doc="time from which the robot holds the payload")
    end: float = number(default=np.inf, unit="s", doc="time from which it does not")
    frame: str | None = option(default=None, doc="frame that holds the payload; None: the end effector")

    def check(self) -> None:
        """Raise `InvalidArgument` if the end is not above the start, or the robot cannot hold the load."""
        check_interval(self.begin, self.end)
        _ = self.loaded

    @cached_property
    def loaded(self) -> Any:
        """Robot with the payload, as the last of its loads."""
        if "nominal" not in vars(self):
            return self.robot.attach(self.load, self.frame)
        robot = vars(self)["nominal"].loaded
        values = {leaf.path: leaf.value for leaf in walk(self.robot)}
        load_paths = [leaf.path for leaf in walk(robot) if leaf.path not in values]
        values |= dict(zip(load_paths, (leaf.value for leaf in walk(self.load)), strict=True))
        return replace(robot, {path: x for path, x in values.items() if holds_symbols(x)}, nominal=True)

    def __getattr__(self, name: str) -> Any:
        is_timed = _TIMED_NAMES.fullmatch(name)
        if "robot" not in vars(self) or not (is_timed or _SHARED_NAMES.fullmatch(name)):
            raise AttributeError(
                f"a PayloadTransfer has no {name}: use its method robot_at(t), robot or loaded"
            )
        x = getattr(self.robot, name)
        return (lambda t, *given: self._select(t, methodcaller(name, t, *given))) if is_timed else x

    def holds(self, t: ArrayLike) -> Any:
        """Return 1 at times at which the robot holds the payload, else 0, shape (...).

        Parameters
        ----------
        t : array_like, shape (...)
            Times [s].
        """
        return unit_step(t, self.begin) * (1.0 - unit_step(t, self.end))

    def robot_at(self, t: ArrayLike) -> Any:
        """Return the robot at a time, or a plant whose methods accept samples at several times.

        Parameters
        ----------
        t : float or ndarray, shape (n,)
            Time, or times of n samples [s].
        """
        times = finite("t", t)
        return _Samples(self, times) if times.ndim else self.loaded if self.holds(times) else self.robot

    def shown(self, t: ArrayLike) -> dict[str, Array]:
        """Return whether the robot holds the payload, for the name of its visual object; see `holds`.

        Parameters
        ----------
        t : array_like, shape (...)
            Times [s].
        """
        robot_names = {item.name for item in self.robot.visual_model.geometryObjects}
        names = (item.name for item in self.loaded.visual_model.geometryObjects)
        return {name: self.holds(t) for name in names if name not in robot_names}

    def step(self, t: Any, q: Any, v: Any, u: Any, h: Any, f: Any, memory: Any) -> Any:
        """Return the state after a step, see `parts.Stepping`.

        Parameters
        ----------
        t : float
            Time [s].
        q, v, u : ndarray, shape (nq,), (nv,), (nu,)
            State and input.
        h : float
            Length of the step [s].
        f : callable
            External forces ``f(t, q, v)``, shape (nv,).
        memory : any
            Memory from `initial_state` or the step before.
        """

        def step_of(robot: Any) -> Any:
            dynamics = stated(robot, "dynamics") or robot
            if stated(dynamics, "step"):
                return dynamics.step(t, q, v, u, h, f, memory)

            def acceleration(time: Any, dq: Any, rate: Any) -> Any:
                position = dynamics.integrate(q, dq)
                return dynamics.forward_dynamics(position, rate, u, f(time, position, rate))

            a = acceleration(t, 0.0 * v, v)
            shift, v_end = rk4.displaced(acceleration, a, t, v, h)
            end = dynamics.integrate(q, shift)
            return RecordedStep(
                end, dynamics.project(end, v_end) if stated(dynamics, "project") else v_end, memory, a
            )

        return self._select(t, step_of)

    def _select(self, t: Any, evaluate: Callable[[Any], Any]) -> Any:
        """Return a result of the robot with or without the payload, for each time."""
        is_loaded = self.holds(t)
        if not has_symbols(is_loaded) and not np.ndim(is_loaded):
            return evaluate(self.loaded if is_loaded else self.robot)
        unloaded = iter(leaves(evaluate(self.robot)))

        def choose(x: Any) -> Any:
            _, other = next(unloaded)
            if not has_symbols([x, other]) and np.array_equal(x, other):
                return x  # such as the names and sizes that the load does not change
            shape = np.shape(is_loaded) + (1,) * (np.ndim(x) - np.ndim(is_loaded))
            return np.where(np.reshape(is_loaded, shape) > 0, x, other)

        return map_leaves(evaluate(self.loaded), choose)


class _Samples:
    """Robot of a `PayloadTransfer` at the times of n samples."""

    def __init__(self, plant: PayloadTransfer, t: Array) -> None:
        self._plant, self._t = plant, t
        self.robot_at, self.shown = plant.robot_at, plant.shown

    def __repr__(self) -> str:
        return repr(self._plant)

    def __getattr__(self, name: str) -> Any:
        is_timed = _SAMPLE_NAMES.fullmatch(name)
        if not (is_timed or _SHARED_NAMES.fullmatch(name) or _VISUAL_NAMES.fullmatch(name)):
            raise AttributeError(f"a PayloadTransfer at several times has no {name}")
        x = getattr(self._plant.loaded, name)
        if not is_timed:
            return x
        if not callable(x):
            return self._plant._select(self._t, attrgetter(name))
        return lambda *given: self._plant._select(self._t, methodcaller(name, *given))
