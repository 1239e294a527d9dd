"""`Benchmark`: scores of controllers in scenarios, as tables, a file and a summary."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, nan
from os import PathLike
from textwrap import fill
from time import process_time
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from pinmobile.arrays import Array, one_of
from pinmobile.balance import tip_over_margin
from pinmobile.benchmarking.situation import BenchmarkScenario
from pinmobile.controllers import Controller
from pinmobile.errors import Diverged, InvalidArgument
from pinmobile.files import write
from pinmobile.loop import Rollout
from pinmobile.plant import Context, inputs_of

_CALLS = 200  # of a controller that are timed


class Score(NamedTuple):
    """What a controller does in a scenario, and what it costs; infinite where it diverges.

    Attributes
    ----------
    largest, rms : float
        Distance from the desired position, from `BenchmarkScenario.after` on [m].
    largest_from_start, rms_from_start : float
        The same from the start on [m].
    force : float
        Root mean square of the force, or of what inputs have the unit of the first [N].
    chatter : float
        How much the input changes, of the axis where that is most: sum of its changes by time [N/s].
    recovery : float
        How long after `BenchmarkScenario.event` it is until the distance stays within the band [s].
    beyond : float
        How far it comes beyond a wall of the scenario [m].
    margin : float
        Smallest tip-over margin [m], negative where it tips over; NaN of a plant that does not tell.
    call : float
        CPU time of a call of the controller, by NumPy, at the first 200 samples of the run [s].
    """

    largest: float
    rms: float
    largest_from_start: float
    rms_from_start: float
    force: float
    chatter: float
    recovery: float
    beyond: float
    margin: float
    call: float


def scored(scenario: BenchmarkScenario, controller: Controller) -> Score:
    """Run a controller in a scenario, and judge the run."""
    try:
        run = scenario.run(controller)
    except Diverged as error:
        call = nan if error.rollout is None else _cost(scenario, controller, error.rollout)
        return Score(inf, inf, inf, inf, inf, inf, inf, inf if scenario.has_walls else 0.0, -inf, call)
    distance = np.linalg.norm(run.error[:, :2], axis=-1)
    counted = run.t >= min(scenario.after, run.t[-2]) - 1e-9
    inputs = inputs_of(scenario.robot)
    alike = [k for k, one in enumerate(inputs) if one.unit == inputs[0].unit]
    u = run.u[counted][:, alike]
    moved = np.abs(np.diff(u, axis=0)).sum(axis=0).max() / (run.t[-1] - run.t[counted][0])
    late = distance[counted]
    place = run.poses[:, :2]
    outside = np.maximum(np.asarray(scenario.lower) - place, place - np.asarray(scenario.upper))
    return Score(
        largest=float(late.max()),
        rms=_rms(late),
        largest_from_start=float(distance.max()),
        rms_from_start=_rms(distance),
        force=_rms(np.linalg.norm(u, axis=-1)),
        chatter=float(moved),
        recovery=_recovery(scenario, run.t, distance),
        beyond=max(float(outside.max()), 0.0),
        margin=_margin(run),
        call=_cost(scenario, controller, run),
    )


def _recovery(scenario: BenchmarkScenario, t: Array, distance: Array) -> float:
    outside = np.flatnonzero((distance > scenario.band) & (t >= scenario.event))
    if not len(outside):
        return 0.0
    last = outside[-1] + 1
    return inf if last == len(t) else float(t[last] - scenario.event)


def _margin(run: Rollout) -> float:
    try:
        return float(tip_over_margin(run).min())
    except InvalidArgument:
        return nan


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _cost(scenario: BenchmarkScenario, controller: Controller, run: Rollout) -> float:
    """Return the CPU time of a call [s], where a run began."""
    made: Any = scenario.around(controller)
    context = Context.of(
        run.plant, dt=scenario.dt, t=run.t, reference=run.reference, trajectory=scenario.trajectory
    )
    count = min(_CALLS, len(run.t))
    rows = [type(run.reference)(*(part[k] for part in run.reference)) for k in range(count)]
    state = made.initial_state(context)
    begin = process_time()
    for k, reference in enumerate(rows):
        _, state = made(run.t[k], run.q[k], run.v[k], reference, state)
    return (process_time() - begin) / count


_WIDTH = 110  # letters of a line of the verdict
_LOST = 1.0  # [m] off, from which a controller has lost its robot
_TOUCH = 1e-3  # [m] beyond a wall that do not count
_ALIKE = 1.1  # ratio of the largest to the smallest distance in which latency alone shows
_SMALL = 1e-3  # what is smaller is not told, in the units of tables
_NEAR = 1.05  # ratio to the least chatter that three digits tell badly
_LEAST = 1.0005  # ratio to the least chatter that the three digits of tables do not tell from it
_TIED = 1.01  # ratio to the best up to which others tie with it


class _Unit(NamedTuple):
    """How a measure is written."""

    words: str
    short: str
    unit: str
    factor: float


_UNITS = {
    "largest": _Unit("largest distance", "largest", "mm", 1e3),
    "rms": _Unit("rms distance", "rms", "mm", 1e3),
    "largest_from_start": _Unit("largest distance from the start on", "largest, all", "mm", 1e3),
    "rms_from_start": _Unit("rms distance from the start on", "rms, all", "mm", 1e3),
    "force": _Unit("rms force", "force", "N", 1.0),
    "chatter": _Unit("chatter", "chatter", "N/s", 1.0),
    "recovery": _Unit("recovered after", "recovered", "s", 1.0),
    "beyond": _Unit("beyond a wall by", "beyond a wall", "mm", 1e3),
    "margin": _Unit("smallest tip-over margin", "tip-over margin", "mm", 1e3),
    "call": _Unit("time of a call", "call", "us", 1e6),
}
_ALWAYS = ("largest", "largest_from_start", "chatter", "recovery", "call")


@final
@dataclass(frozen=True, eq=False)
class Benchmark:
    """Controllers in scenarios: what each does and costs.

    Parameters
    ----------
    scores : mapping of str to mapping of str to Score
        By controller, then by scenario.
    scenarios : mapping of str to BenchmarkScenario
        By name.
    """

    scores: Mapping[str, Mapping[str, Score]]
    scenarios: Mapping[str, BenchmarkScenario]

    def values(self, measure: str = "largest") -> Array:
        """Return a number of each score, shape (controllers, scenarios), in SI units.

        Parameters
        ----------
        measure : str
            Name of an attribute of `Score`.

        Raises
        ------
        UnknownName
            If there is none of that name.
        """
        one_of("measure", measure, Score._fields)
        return np.array([[getattr(one, measure) for one in row.values()] for row in self.scores.values()])

    def table(self, measure: str = "largest") -> str:
        """Return `values` as text: a row for each controller, a column for each scenario.

        Parameters
        ----------
        measure
            As of `values`, whose errors it raises.
        """
        numbers = self.values(measure) * _UNITS[measure].factor
        rows = [["", *self.scenarios]]
        rows += [[name, *map(_digits, row)] for name, row in zip(self.scores, numbers, strict=True)]
        return "\n".join([f"{_UNITS[measure].words} [{_UNITS[measure].unit}]", *_aligned(rows)])

    def details(self, scenario: str) -> str:
        """Return all numbers of a scenario as text, a row for each controller.

        Distances from the start on stand beside those of later, in which no transient is left.

        Parameters
        ----------
        scenario : str
            Its name.

        Raises
        ------
        UnknownName
            If there is none of that name.
        """
        one = self.scenarios[one_of("scenario", scenario, self.scenarios)]
        measures = [name for name in _UNITS if one.has_walls or name not in ("beyond", "margin")]
        heads = [f"{_UNITS[name].short} [{_UNITS[name].unit}]" for name in measures]
        rows = [["", *heads]]
        for name, row in self.scores.items():
            score = row[scenario]
            rows.append([name, *(_digits(getattr(score, each) * _UNITS[each].factor) for each in measures)])
        return "\n".join([f"{scenario}: {one.about}" if one.about else scenario, *_aligned(rows)])

    def to_csv(self, path: str | PathLike[str]) -> None:
        """Write all numbers as CSV: a row for each controller in each scenario, in SI units.

        Parameters
        ----------
        path : str or path-like
            The file.

        Raises
        ------
        InvalidArgument
            If there can be no such file.
        FileError
            If the system fails, such as of a full disk.
        """
        units = {name: one.unit.replace("mm", "m").replace("us", "s") for name, one in _UNITS.items()}
        lines = [["controller", "scenario", *(f"{name} [{units[name]}]" for name in Score._fields)]]
        for name, row in self.scores.items():
            lines += [[name, place, *(f"{number:.17g}" for number in score)] for place, score in row.items()]
        text = "".join(",".join(map(_quoted, line)) + "\n" for line in lines)
        write(path, text.encode("utf-8"))

    @property
    def verdict(self) -> str:
        """Who comes closest where, at what price, who chatters least, and who loses the robot, in words.

        Who is within 1 % of the best, or a micrometre, ties with it. Those who lose their robot, 1 m and more
        off, are compared with none.
        """
        said = [*self._closest(), *self._quietest(), *self._late(), *self._bounded(), *self._lost()]
        return "\n".join(fill(each, _WIDTH, subsequent_indent="  ") for each in said)

    def _open(self) -> list[int]:
        """Return the scenarios without walls, which judge by distance."""
        return [k for k, one in enumerate(self.scenarios.values()) if not one.has_walls]

    def _alike(self) -> list[int]:
        """Return the scenarios with a delay in which all but the lost come equally close."""
        largest, held, found = self.values(), self._held(), []
        for k, one in enumerate(self.scenarios.values()):
            ends = largest[held[:, k], k]
            if one.delay and len(ends) > 1 and ends.max() < _ALIKE * ends.min():
                found.append(k)
        return found

    def _held(self) -> NDArray[np.bool_]:
        """Return who has not lost the robot where, shape (controllers, scenarios)."""
        return np.asarray(self.values() < _LOST)

    def _closest(self) -> list[str]:
        """Say who comes closest where, of those who hold the robot, and at what chatter beside theirs."""
        held, alike, places = self._held(), self._alike(), list(self.scenarios)
        mm = 1e3 * np.where(held, self.values(), np.inf)
        chatter = np.where(held, self.values("chatter"), np.inf)
        wins: dict[tuple[int, ...], list[int]] = {}
        for k in self._open():
            if k not in alike and held[:, k].any():
                wins.setdefault(_best(mm[:, k]), []).append(k)
        said = []
        for who, won in sorted(wins.items(), key=lambda each: (-len(each[1]), each[0])):
            where = ", ".join(f"{places[k]} ({_range(mm[list(who), k])} mm)" for k in won)
            price = chatter[np.ix_(who, won)]
            ratio = _times(price, chatter[:, won].min(axis=0))
            finite = np.isfinite(ratio).all()
            more = f"{_range(ratio)} times the least" if finite else "where others have none"
            more = f"at most {ratio.max():.4g} times the least" if ratio.max() < _NEAR else more
            least = "the least" if ratio.max() < _LEAST else more
            said.append(f"{self._called(who)} in {where}, at {_range(price)} N/s of chatter, {least}")
        return [f"Closest after the start: {'; '.join(said)}."] if said else []

    def _quietest(self) -> list[str]:
        """Say who never chatters much more than the least, and how far off that is."""
        judged = self._open()
        chatter, mm = self.values("chatter")[:, judged], 1e3 * self.values()[:, judged]
        held = self._held()[:, judged].all(axis=1)
        if len(chatter) < 2 or not judged or not held.any():
            return []
        ratio = _times(chatter[held], chatter[held].min(axis=0)).max(axis=1)
        best = list(_best(ratio))
        who, most = np.flatnonzero(held)[best], ratio[best].max()
        if np.isinf(most):  # each chatters somewhere where another does not at all
            return []
        return [
            f"Least chatter of those who never lose the robot: {self._called(who)}, "
            f"{'always' if most < _LEAST else f'nowhere above {most:.4g} times'} the least, "
            f"{_range(mm[who])} mm off."
        ]

    def _called(self, who: Iterable[int]) -> str:
        """Return the names of those who are best, and of several that they tie."""
        names = [list(self.scores)[i] for i in who]
        return " and ".join(names) + (" tied" if len(names) > 1 else "")

    def _late(self) -> list[str]:
        said, largest, held = [], self.values(), self._held()
        for k in self._alike():
            place, one = list(self.scenarios.items())[k]
            ends, speed = 1e3 * largest[held[:, k], k], np.linalg.norm(one.trajectory(0.0).v[:2])
            said.append(
                f"In {place} all {'' if held[:, k].all() else 'who hold the robot '}are alike, "
                f"{_range(ends)} mm: speed times latency, {speed:.2g} m/s x "
                f"{1e3 * one.delay * one.dt:.3g} ms."
            )
        return said

    def _bounded(self) -> list[str]:
        """Say who stays within walls, to a millimetre, and upright, and how soon that recovers."""
        said = []
        for place, one in self.scenarios.items():
            if not one.has_walls:
                continue
            scores = {name: row[place] for name, row in self.scores.items()}
            kept = [
                f"{name} ({'stays off the path' if np.isinf(score.recovery) else f'{score.recovery:.3g} s'})"
                for name, score in scores.items()
                if score.beyond <= _TOUCH and not score.margin < 0
            ]
            far = [
                f"{name} ({_digits(1e3 * x.beyond)} mm)" for name, x in scores.items() if x.beyond > _TOUCH
            ]
            tips = [name for name, score in scores.items() if score.margin < 0]
            words = [
                f"In {place}, within the walls, upright, and recovered after: {', '.join(kept) or 'none'}"
            ]
            words += [f"beyond a wall: {', '.join(far)}"] if far else []
            everyone = len(tips) == len(scores) > 1
            words += [f"tipping over: {'all' if everyone else ', '.join(tips)}"] if tips else []
            said.append(f"{'; '.join(words)}.")
        return said

    def _lost(self) -> list[str]:
        largest, names, places = self.values(), list(self.scores), list(self.scenarios)
        lost = [
            f"{names[i]} in {places[k]} "
            + ("(diverges)" if np.isinf(largest[i, k]) else f"({largest[i, k]:.3g} m off)")
            for i, k in np.argwhere(~self._held())
        ]
        return [f"Lost: {'; '.join(lost)}."] if lost else []

    def __str__(self) -> str:
        """Return tables of scenarios without walls, one of each with walls, and the verdict."""
        walled = [name for name, one in self.scenarios.items() if one.has_walls]
        tables = [self.table(name) for name in _ALWAYS] if self._open() else []
        return "\n\n".join([*tables, *map(self.details, walled), self.verdict])


def _times(numbers: Array, least: Array) -> Array:
    """Return ratios, infinite where the least is nothing and 1 of nothing to nothing."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(numbers == least, 1.0, numbers / least)


def _best(numbers: Array) -> tuple[int, ...]:
    """Return the index of the least number, and of those that tie with it."""
    return tuple(int(i) for i in np.flatnonzero(numbers <= max(_TIED * numbers.min(), _SMALL)))


def _aligned(rows: Sequence[Sequence[str]]) -> Iterable[str]:
    wide = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for first, *rest in rows:
        numbers = (each.rjust(room) for each, room in zip(rest, wide[1:], strict=True))
        yield "  ".join([first.ljust(wide[0]), *numbers])


def _digits(number: float) -> str:
    if np.isnan(number):
        return "?"
    if 0 < abs(number) < _SMALL:
        return f"<{_SMALL:g}"
    return "-" if np.isinf(number) else f"{number:.3g}" if abs(number) < 1e3 else f"{number:.0f}"


def _range(numbers: Array) -> str:
    """Return what numbers lie between, in three digits."""
    low, high = _digits(float(numbers.min())), _digits(float(numbers.max()))
    return low if low == high else f"{low} to {high}"


def _quoted(entry: str) -> str:
    return '"' + entry.replace('"', '""') + '"' if any(each in entry for each in ',"\n') else entry
