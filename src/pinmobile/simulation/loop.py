"""The inner loop of one robot, in Python or compiled: one row of numbers per sample.

In Python it makes few NumPy calls per step. It asks the plant alone, for what it has. Of a plant that offers
unchecked calls and simply adds displacements, feedback and step of the library's own are one matrix product
each.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from typing import Any, NamedTuple

import numpy as np

from pinmobile.arrays import LEAST_ANGLE, Array, are_real, wrap_angle
from pinmobile.compiled import Parts, Program, Reference as Rows, Trace, once, program_of, robot_keys
from pinmobile.controllers import Compact, Controller
from pinmobile.divergence import is_alive
from pinmobile.errors import InvalidArgument, NotFinite, NotTraceable, shown
from pinmobile.forces import CoordinateForce, Force
from pinmobile.integrators import Integrator, RungeKuttaNystrom
from pinmobile.plant import Context, Input, Plant
from pinmobile.signals import Recorder, Signal, recorder
from pinmobile.simulation.setup import check_same, shorter
from pinmobile.simulation.substeps import (
    Clock,
    acting,
    dynamics_of,
    own_steps,
    pushed,
    steps,
    steps_between_configurations,
    tabled_steps,
)
from pinmobile.trajectories import Reference

Control = Callable[[int, Array, Array, Array], Array]


class Loop:
    """Records of a closed loop, and the means to fill them.

    Parameters
    ----------
    plant, controller, integrator, substeps, forces
        As in `simulate`, checked; the integrator of a plant that has a step of its own is None.
    context : Context
        What the controller is told; the reference is sampled at its times.
    q0, v0 : ndarray, shape (nq,) and (nv,)
        Start.
    """

    def __init__(
        self,
        plant: Plant,
        controller: Controller,
        integrator: Integrator | None,
        context: Context,
        substeps: int,
        forces: tuple[Force | CoordinateForce, ...],
        *,
        q0: Array,
        v0: Array,
    ) -> None:
        t, reference = context.t, context.reference
        self.nq, self.nv, self.last = plant.nq, plant.nv, len(t) - 1
        self.adds = getattr(plant, "adds", False) and not hasattr(plant, "project")
        self.whole = reference.q.shape[1] == plant.nq and reference.v.shape[1] == plant.nv
        self.rows = np.full((len(t) + 1, self.nq + 2 * self.nv), np.nan)  # one to spare: each has a next one
        self.inputs = np.empty((len(t), plant.nu))
        self.rows[0, : self.nq + self.nv] = np.concatenate([q0, v0])
        self.desired = np.hstack([reference.q, reference.v])
        self.times = t.tolist()
        self.stopped: NotFinite | None = None
        push = pushed(forces, plant)
        clock = Clock(self.times, context.dt / substeps, substeps)
        tabled = isinstance(integrator, RungeKuttaNystrom) and self.adds
        act = acting(forces, plant, push)
        self.dynamics = dynamics_of(plant, act, kept=not tabled)
        self.own, memory = None, lambda: None
        self.acting = "plant or forces" if forces else "plant"
        self.asked: list[Asked] = []
        self.control, tell = self._controlled(plant, controller, context, integrator)
        if hasattr(plant, "step"):
            first = plant.initial_state(context) if hasattr(plant, "initial_state") else None
            self.own, memory = own_steps(plant.step, push, clock, first)
        elif tabled:
            self.advance = tabled_steps(integrator, self.dynamics, clock, self.nv)  # type: ignore[arg-type]
        elif self.adds:
            self.advance = steps(integrator, self.dynamics, clock)  # type: ignore[arg-type]
        else:
            self.advance = steps_between_configurations(integrator, plant, self.dynamics, clock)  # type: ignore[arg-type]
        self.recorder: Recorder | None = recorder(plant, forces, act, memory, tell, self.times)

    def _controlled(
        self, plant: Plant, controller: Controller, context: Context, integrator: Integrator | None
    ) -> tuple[Control, Callable[[], Mapping[str, Any]] | None]:
        """Return what gives the input at each sample, and what tells the controller's signals."""
        limits = _limits(context.inputs)
        tabled = self.adds and self.whole and isinstance(integrator, RungeKuttaNystrom)
        # A controller that wants to tell or to be told something more is asked.
        heard = hasattr(controller, "signals") or hasattr(controller, "applied")
        # A subclass that has another law has another compact form too, or none.
        own = next((each for each in type(controller).__mro__ if "__call__" in vars(each)), object)
        simple = limits is None and tabled and not heard and "compact" in vars(own)
        if simple and hasattr(controller, "compact"):
            compact = controller.compact(plant)
            if compact is not None:
                return _feedback(compact, self.desired, context.reference.a), None
        own_parts = {id(part): part for part in (plant, controller)}
        return _asked(controller, context, limits, self.asked, own_parts)

    def run(self, begin: int, end: int) -> None:
        """Fill the samples from `begin` to before `end`, and the state at `end`."""
        nq, n, last = self.nq, self.nq + self.nv, self.last
        control, own, record, times = self.control, self.own, self.recorder, self.times
        free, forced = self.dynamics
        advance = None if own is not None else self.advance
        rows, following = self.rows[begin:end], self.rows[begin + 1 : end + 1, :n]
        # Views that come from iteration cost half of those that come from indexing.
        parts = rows, rows[:, :nq], rows[:, nq:n], rows[:, :n], rows[:, n:], following, self.inputs[begin:end]
        k = begin
        try:
            for k, (row, q, v, state, acceleration, after, held) in enumerate(
                zip(*parts, strict=True), begin
            ):
                held[:] = u = control(k, state, q, v)
                if record is not None:
                    record(k, q, v, u)
                if advance is None:
                    own(k, q, v, u, acceleration, after)  # type: ignore[misc]
                    continue
                acceleration[:] = a = free(q, v, u) if forced is None else forced(times[k], q, v, u)
                if k < last:
                    advance(k, row, q, v, u, a, after)
        except NotFinite as error:
            self.stopped = error  # the rest stays empty
        except InvalidArgument:
            # A state that is not finite is refused by whoever is asked about it; the rest stays empty.
            if np.isfinite(self.rows[k, :n]).all():
                raise

    def check_again(self) -> None:
        """Refuse parts that answer otherwise for some samples when they are asked again after the last one.

        They keep something in themselves whose effect came late, after all that is asked before a run.

        Raises
        ------
        InvalidArgument
            If there is such a part.
        """
        nq, n = self.nq, self.nq + self.nv
        free, forced = self.dynamics
        with np.errstate(all="ignore"):
            for one in self.asked:
                q, v = self.rows[one.k, :nq], self.rows[one.k, nq:n]
                check_same("controller", self.times[one.k], one.u, one.ask(q.copy(), v.copy()))
            for k in _looked_at(self.last) if self.own is None else ():
                t, (q, v, a), u = self.times[k], np.split(self.rows[k], [nq, n]), self.inputs[k]
                again = free(q, v, u) if forced is None else forced(t, q, v, u)
                check_same(self.acting, t, a, again)

    def samples(self, begin: int, end: int) -> tuple[Array, Array, Array, Array]:
        """Return q, v, a and u of the samples, one row each."""
        nq, n = self.nq, self.nq + self.nv
        rows = self.rows[begin:end]
        parts = rows[:, :nq], rows[:, nq:n], rows[:, n:], self.inputs[begin:end]
        q, v, a, u = (part.copy() for part in parts)
        return q, v, a, u

    def signals(self, end: int) -> dict[str, Signal]:
        """Return what parts told beside states and inputs at the samples before `end`, by name."""
        return {} if self.recorder is None else self.recorder.signals(end)

    @np.errstate(over="ignore", invalid="ignore")  # what overflows is not fine
    def is_fine(self, begin: int, end: int, limit: float) -> bool:
        """Tell whether the samples are finite and near the reference; if in doubt, False."""
        if not (self.adds and self.whole):
            return False
        rows, n = self.rows[begin:end], self.nq + self.nv
        errors = self.desired[begin:end] - rows[:, :n]  # on the circle they are less
        return bool(is_alive(errors, limit, self.inputs[begin:end], rows[:, n:]).all())


class CompiledLoop:
    """Records of a compiled loop, as those of `Loop`; it has run when it is made.

    Parameters
    ----------
    plant, controller, integrator, substeps, forces, context, q0, v0
        As in `Loop`.
    memory : dict
        What `memory_of` returned of the parts.

    Raises
    ------
    InvalidArgument
        If a law cannot be compiled; its line, and what to write instead.
    """

    stopped = None

    def __init__(
        self,
        plant: Plant,
        controller: Controller,
        integrator: Integrator | None,
        context: Context,
        substeps: int,
        forces: tuple[Force | CoordinateForce, ...],
        *,
        q0: Array,
        v0: Array,
        memory: dict[Any, Any],
    ) -> None:
        parts = Parts(plant, controller, forces, integrator, Trace(), substeps).varying(())
        reference = Rows(*context.reference)
        self._desired = np.hstack([reference.q, reference.v])
        whole = reference.q.shape[1] == plant.nq and reference.v.shape[1] == plant.nv
        self._adds = whole and getattr(plant, "adds", False)
        first = Rows(*(part[0] for part in reference))

        def known() -> Program:
            return program_of(parts, context, (q0, v0), first, dt=context.dt, single=True)

        try:
            _check_telling(parts)
            program = once(memory, ("single", substeps, context.dt, len(context.t), context.t[-1]), known)
        except NotTraceable as error:
            raise InvalidArgument(f"engine is COMPILED, which cannot run this: {error.reason}") from error
        member = range(context.member, context.member + 1)
        keys = {name: robot_keys(context.seed, name, member) for name in program.loop.keys}
        start = q0[None], v0[None]
        run = program.run(
            parts, context, start, context.t, reference, dt=context.dt, keys=keys, memory=memory
        )
        self._kept = [run.kept[name][0] for name in ("q", "v", "a", "u")]
        units = program.loop.units
        self._signals = {name: Signal(unit, run.kept[f"signal {name}"][0]) for name, unit in units.items()}

    def run(self, begin: int, end: int) -> None:
        """Do nothing: all samples are there."""

    @np.errstate(over="ignore", invalid="ignore")  # what overflows is not fine
    def is_fine(self, begin: int, end: int, limit: float) -> bool:
        """Tell whether the samples are finite and near the reference; if in doubt, False."""
        if not self._adds:
            return False
        q, v, a, u = self.samples(begin, end)
        errors = self._desired[begin:end] - np.hstack([q, v])  # on the circle they are less
        return bool(is_alive(errors, limit, u, a).all())

    def check_again(self) -> None:
        """Do nothing: compiled laws have no memory but their state."""

    def samples(self, begin: int, end: int) -> tuple[Array, Array, Array, Array]:
        """Return q, v, a and u of the samples, one row each."""
        q, v, a, u = (part[begin:end] for part in self._kept)
        return q, v, a, u

    def signals(self, end: int) -> dict[str, Signal]:
        """Return what parts told beside states and inputs at the samples before `end`, by name."""
        return {name: Signal(unit, values[:end]) for name, (unit, values) in self._signals.items()}


class Asked(NamedTuple):
    """What a controller answered at sample k, and what asks it that again with its state of then."""

    k: int
    u: Array
    ask: Callable[[Array, Array], Any]


def _looked_at(last: int) -> set[int]:
    """Return the samples whose answers are asked for again: an early one, the middle one and the last.

    The very first is on the trajectory, where many laws give nothing.
    """
    return {min(1, last), last // 2, last}


def _limits(inputs: Sequence[Input]) -> tuple[Array, Array] | None:
    """Return the least and the largest input, shape (nu,); None where nothing has a limit."""
    sides = [
        np.array(
            [np.inf * sign if getattr(one, side, None) is None else getattr(one, side) for one in inputs]
        )
        for side, sign in (("lower", -1), ("upper", 1))
    ]
    lower, upper = (np.asarray(side, np.float64) for side in sides)
    return (lower, upper) if np.isfinite([lower, upper]).any() else None


def _asked(
    controller: Controller,
    context: Context,
    limits: tuple[Array, Array] | None,
    asked: list[Asked],
    own_parts: Mapping[int, object],
) -> tuple[Control, Callable[[], Mapping[str, Any]] | None]:
    """Return the input of any controller, which gets copies that are its own, and what tells its signals.

    Of some samples it is written down in `asked` what would ask the controller again.
    """
    times, state = context.t.tolist(), controller.initial_state(context)
    tell = getattr(controller, "applied", None)
    # `control` is called once per sample, in order; what it is told is its own to write into.
    references = (Reference(*(part.copy() for part in row)) for row in zip(*context.reference, strict=True))
    shape, looked_at = (len(context.inputs),), _looked_at(len(times) - 1)

    def again(k: int, state: object) -> Callable[[Array, Array], Any] | None:
        try:
            kept = deepcopy(state, dict(own_parts))
        except Exception:  # whatever an object says that cannot be copied: it is not asked again
            return None
        row = Reference(*(part[k].copy() for part in context.reference))
        return lambda q, v: controller(times[k], q, v, row, kept)[0]

    def control(k: int, row: Array, q: Array, v: Array) -> Array:
        nonlocal state
        ask = again(k, state) if k in looked_at else None
        try:
            answer = controller(times[k], q.copy(), v.copy(), next(references), state)
        except InvalidArgument as error:
            if k:
                raise
            raise shorter(context, error) from error.__cause__
        if type(answer) is not tuple or len(answer) != 2:
            raise InvalidArgument(
                f"controller returned {shown(answer)} at t = {times[k]:g} s, expected (u, state)"
            )
        u, state = answer
        if type(u) is not np.ndarray or u.shape != shape or not are_real(u):
            wrong = InvalidArgument(
                f"controller returned {shown(u)} at t = {times[k]:g} s, expected an array of shape {shape}"
                f"{'' if are_real(u) else ' of real numbers'}"
            )
            raise shorter(context, wrong)
        if ask is not None:
            asked.append(Asked(k, u.copy(), ask))
        if limits is not None:
            u = np.clip(u, *limits)
        if tell is not None:
            state = tell(u.copy(), state)
        return u

    return control, (lambda: controller.signals(state)) if hasattr(controller, "signals") else None


def _feedback(compact: Compact, desired: Array, accelerations: Array) -> Control:
    """Return the force of a law of feedback."""
    gains, turning, inverse, gravity = compact
    n = len(gains)
    error, command = np.empty(2 * n), np.empty(n)
    subtract, add, times_gains, pi = np.subtract, np.add, gains.dot, np.pi

    def control(k: int, state: Array, q: Array, v: Array) -> Array:
        subtract(desired[k], state, error)
        for i in turning:
            if not LEAST_ANGLE < error[i] <= pi:
                error[i] = wrap_angle(error[i])
        times_gains(error, command)
        if gravity is not None:
            add(command, gravity(q), command)
        if inverse is None:
            return command
        add(command, accelerations[k], command)
        return inverse(q, v, command)

    return control


def _check_telling(parts: Parts) -> None:
    """Refuse parts whose signals are not those of what is run in their place.

    Raises
    ------
    NotTraceable
        If there is one.
    """
    for (path, given), (_, own) in zip(parts.by_path(), parts.on_symbols().by_path(), strict=True):
        if hasattr(given, "signals") and not hasattr(own, "signals"):
            raise NotTraceable(
                f"{path}, a {type(given).__name__}, has signals, and what its traced() returns has none",
                "give that the same signals",
            )
