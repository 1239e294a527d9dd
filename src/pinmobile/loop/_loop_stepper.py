"""`LoopStepper`, a compiled loop that advances some samples at a time, with numbers that may change."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np

from pinmobile.arrays import Array
from pinmobile.compiled import aligned, call, robot_keys
from pinmobile.errors import InvalidArgument, NotTraceable
from pinmobile.loop._record import Samples
from pinmobile.loop._rollout import Rollout
from pinmobile.loop._run import compile_loop
from pinmobile.loop._scenario import Scenario
from pinmobile.loop._simulate import rollout_of
from pinmobile.loop._trace import scheduled_rows, traced_numbers
from pinmobile.parts import evolved
from pinmobile.trajectories import Reference

_MAX_NUMBERS, _OVERHEAD = 1 << 24, 64  # numbers that are kept, some 130 MB, and the size of three arrays


class LoopStepper:
    """Compiled loop of one robot that advances some samples at a time.

    The samples of a stepper are those of `simulate`, bit for bit, unless numbers or references change.

    Parameters
    ----------
    scenario : Scenario
        Loop of one robot. The numbers of its spread can change between two samples.

    Attributes
    ----------
    k : int
        Index of the next sample.
    values : dict of str to float
        Numbers of the spread, by name.
    follows : bool
        Whether the loop uses the reference of each sample only, so that `advance` may receive another one.

    Raises
    ------
    InvalidArgument
        If the loop cannot be compiled.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        metrics = tuple((k, metric.is_margin) for k, metric in enumerate(scenario.recorded_metrics))
        loop = evolved(scenario.loop, {"recorder": Samples(errors=True, metrics=metrics)})
        try:
            self.follows = True
            try:
                self._compiled = compile_loop(scenario, loop, hides_reference=True)
            except NotTraceable:
                if scenario.has_own_references:
                    raise
                self.follows = False
                self._compiled = compile_loop(scenario, loop, hides_reference=False)
        except NotTraceable as error:
            raise InvalidArgument(f"this loop cannot run in real time: {error.reason}") from error
        self._code = self._compiled.program.code()
        self._rows = scheduled_rows(loop, scenario.context) if self._compiled.tape.schedule_size else []
        self.reset({name: float(drawn[0]) for name, drawn in scenario.draws().items()})

    def reset(self, values: Mapping[str, float]) -> None:
        """Begin again at the first sample, with these numbers of the spread."""
        self._blocks: Array = np.zeros(0)
        self.k, size = 0, max(1, sum(ring.samples for ring in self._compiled.tape.rings))
        self._rings, self._counts = aligned((size, 1)), np.zeros(1, np.int32)
        self._parts: deque[tuple[Array, Array, Array]] = deque()  # samples, kept values, numbers
        self._size = 0
        self.change(values)

    def change(self, values: Mapping[str, float]) -> None:
        """Use other numbers of the spread from the next sample on.

        Raises
        ------
        InvalidArgument
            If the trajectory is impossible with these numbers.
        """
        scenario, compiled = self.scenario, self._compiled
        draws = {name: np.array([value]) for name, value in values.items()}
        all_values = scenario.values(draws, 0, 1)
        references = scenario.references(all_values, 1)
        reference = scenario.reference if references is None else Reference(*(x[:, 0] for x in references))
        rows = {path: x for path, x in all_values.items() if path in scenario.entries}
        numbers, first = {**traced_numbers(compiled.loop), **rows}, compiled.first(rows, 1)
        keys = {name: robot_keys(scenario.seed, name, range(1)) for name in compiled.tape.keys}
        start = scenario.starts(all_values, 1, references)
        blocks = compiled.program.blocks_of(start, 1, numbers, first, keys)
        if self.k:
            states = len(compiled.tape.states)
            blocks[:, :states] = self._blocks[:, :states]
        h = scenario.dt / scenario.substeps
        self._blocks, self._uniforms = blocks, compiled.program.uniforms_of(h, numbers, first)
        self.values, self.reference = dict(values), reference

    @property
    def units(self) -> Mapping[str, str]:
        """Units of the signals, by name."""
        return self._compiled.tape.units

    def times(self, count: int) -> Array:
        """Return the times of the next samples, shape (count,) [s]."""
        t, k = self.scenario.t, self.k + np.arange(count)
        return np.where(k < len(t), t[np.minimum(k, len(t) - 1)], k * self.scenario.dt)

    def ahead(self, count: int) -> Reference:
        """Return the reference of the next samples; after its end, it rests."""
        k, last = self.k + np.arange(count), len(self.scenario.t) - 1
        q, v, a = (x[np.minimum(k, last)] for x in self.reference)
        moves = (k <= last)[:, None]
        return Reference(q, v * moves, a * moves)

    def advance(self, count: int, reference: Reference | None = None) -> dict[str, Array]:
        """Compute the next samples, and return them by name, shape (count, ...).

        Parameters
        ----------
        count : int
            Number of samples, at least 1.
        reference : Reference, optional
            Reference of these samples; default: `ahead`.
        """
        program, t = self._compiled.program, self.times(count)
        desired = Reference(*(np.ascontiguousarray(x, np.float64) for x in reference or self.ahead(count)))
        last = len(self.scenario.t) - 1
        rows = [schedule[np.minimum(self.k + np.arange(count), last)] for schedule in self._rows]
        samples = program.samples_of(t, desired, self._uniforms, rows, self.k)
        records = aligned((1, count, self._compiled.tape.outputs_kept, 1))
        arrays = self._blocks, samples, self._uniforms, self._rings, self._counts, records
        call(self._code, *arrays, first=self.k)
        self._parts.append((samples, records, np.array([*self.values.values()], np.float64)))
        self._size += samples.size + records.size + _OVERHEAD
        while self._size > _MAX_NUMBERS:
            first = self._parts.popleft()
            self._size -= first[0].size + first[1].size + _OVERHEAD
        self.k += count
        return {name: x[0] for name, x in program.kept_samples(records, 1).items()}

    def rollout(self) -> Rollout:
        """Return the samples since the last reset, until a number is not finite.

        The signals contain the numbers of the spread, by name.

        Raises
        ------
        InvalidArgument
            If there is no sample.
        """
        parts, scenario = list(self._parts), self.scenario
        if not parts:
            raise InvalidArgument("the run has no sample yet")
        sample_parts, blocks, values = zip(*parts, strict=True)
        samples, program = np.concatenate(sample_parts), self._compiled.program
        records = {name: x[0] for name, x in program.kept_samples(np.concatenate(blocks, axis=1), 1).items()}
        numbers = np.repeat(values, [*map(len, sample_parts)], axis=0).T
        records |= {f"signal {name}": column for name, column in zip(self.values, numbers, strict=True)}
        units = {**self.units, **{name: x.unit for name, x in scenario.numbers.items()}}
        nq, n = self._compiled.tape.sizes[3:]
        t, *reference, _ = np.split(samples, np.cumsum([1, nq, n, n]), axis=1)
        finite = np.isfinite(np.hstack([records[name] for name in "qvau"])).all(axis=1)
        end = len(t) if finite.all() else int(np.argmin(finite))
        run = scenario.nominal_loop, t[:, 0], records, Reference(*reference)
        return rollout_of(*run, end, units, engine="COMPILED")
