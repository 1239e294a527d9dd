"""An exercise: its questions, the numbers of a course, and the notebook for students."""

from __future__ import annotations

import copy
import inspect
import os
import re
import sys
import tomllib
import warnings
from collections.abc import Callable, Iterable
from contextlib import redirect_stdout
from contextvars import ContextVar
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from random import Random
from types import FrameType, SimpleNamespace
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import numpy as np

from pinmobile.arrays import Array, matching, one_of

N_STATES = 50  # at which a function is compared
_FACTORS = {
    -1.0: "Only the sign is wrong.",
    2.0: "It is wrong by a factor of 2.",
    100.0: "It is wrong by a factor of 100: check the unit (cm and m, per cent and shares).",
    1e3: "It is wrong by a factor of 1000: check the unit (mm and m, g and kg, kN and N).",
    180 / np.pi: "It is wrong by a factor of 57.3: check degrees and radians.",
    2 * np.pi: "It is wrong by a factor of 2 pi: check turns and radians.",
}
_EMPTY = "nothing is written yet, or `return` is missing; replace the dots"


class Fault(Exception):
    """An answer that earns nothing: state and reason of its verdict."""


Requirement: TypeAlias = tuple[str, float, float, str]
"""Requirement of a design: name, value, bound above the value, and unit."""


@dataclass(frozen=True)
class Verdict:
    """Result of the check of one answer.

    Parameters
    ----------
    question : str
        Exercise, course and name of the question: ``"01_equations//transform"``.
    state : str
        ``"passed"``, ``"wrong"``, ``"failed"`` (the answer raised an error) or ``"empty"``.
    words : str
        Reason.
    points, out_of : int
        Points earned and available.
    """

    question: str
    state: str
    words: str
    points: int
    out_of: int

    def __bool__(self) -> bool:
        return self.state == "passed"

    def __repr__(self) -> str:
        name = self.question.rpartition("/")[2]
        return f"{self.state:6} {self.points}/{self.out_of}  {name}: {self.words}"


# Receives each verdict; a file that is checked has a function of its own here.
RECORD: ContextVar[Callable[[Verdict], object]] = ContextVar("RECORD", default=lambda _: None)


@dataclass(frozen=True)
class Question:
    """A question for a function, a number or a design, with hints and the diagnoses of known mistakes.

    Parameters
    ----------
    name : str
        Name of the answer in the notebook.
    key : str
        Exercise, course and name.
    text : str
        The task.
    hints : list of str
        Hints, from the first to the most explicit.
    mistakes : list of pairs of str
        Expression for the answer with a mistake (for a design: whether it was made), and its diagnosis.
    reference : callable
        Function of the course's numbers and the arguments of the answer.
    numbers : object
        Numbers of the course, as attributes.
    points : int
        Points of a right answer.
    draw : callable, optional
        For a function: it takes the course's numbers and a random generator, and returns the arguments.
    unit : str
        Unit of a number.
    """

    name: str
    key: str
    text: str
    hints: list[str]
    mistakes: list[list[str]]
    reference: Callable[..., Any]
    numbers: Any
    points: int
    draw: Callable[..., tuple[Any, ...]] | None
    unit: str
    given: list[str] = field(default_factory=list)

    def __repr__(self) -> str:
        return f"{self.name} ({self.points} point{'s' * (self.points > 1)})"

    @property
    def arguments(self) -> list[str]:
        """Names of the arguments of the answer."""
        return list(inspect.signature(self.reference).parameters)[1:]

    def hint(self) -> None:
        """Print one more hint per call; each says more than the one before."""
        if len(self.given) == len(self.hints):
            print("That was the last hint. The notebook of the lecture has the derivation.")
            return
        self.given.append(self.hints[len(self.given)])
        print(f"Hint {len(self.given)} of {len(self.hints)}: {self.given[-1]}")

    def check(self, answer: object) -> Verdict:
        """Return the verdict on an answer.

        Parameters
        ----------
        answer : object
            Function, number or tuple of numbers, as the question states.

        Returns
        -------
        verdict : Verdict
            State, reason and points. No answer raises an error here.
        """
        try:
            if any(each is None or each is ... for each in _entries(answer)):
                raise Fault("empty", _EMPTY)
            state, words = "passed", self.judge(answer)
        except Fault as fault:
            state, words = fault.args
        except (Exception, SystemExit) as error:
            state, words = "failed", f"the check did not work ({describe(error)}); restart and run all cells"
        verdict = Verdict(self.key, state, words, self.points if state == "passed" else 0, self.points)
        RECORD.get()(verdict)
        return verdict

    def judge(self, answer: Any) -> str:
        """Return why the answer is right, or raise `Fault`."""
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if self.draw is not None:
                return self._judge_function(answer)
            given, names = _entries(answer), self.arguments or [self.name]
            if len(given) != len(names):
                raise Fault("wrong", f"the answer has {len(given)} numbers, expected {', '.join(names)}")
            values = [_as_array(each, (), "the answer is") for each in given]
            if not self.unit:
                return self._judge_design(values)
            self.compare(values, [()], 2e-3, f"{values[0]:g} {self.unit} is not the value.")
            return f"{values[0]:g} {self.unit} is right"

    def _judge_function(self, answer: Any) -> str:
        if not callable(answer):
            raise Fault("wrong", f"the answer is {type(answer).__name__}, expected a function")
        rng = np.random.default_rng(1)
        states = [self.draw(self.numbers, rng) for _ in range(N_STATES)]  # type: ignore[misc]
        shape = np.shape(self.reference(self.numbers, *states[0]))
        with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere):
            got = [_as_array(_call(answer, s), shape, "the function returns") for s in [*states, states[0]]]
        if not _close(got[-1:], got[:1], 1e-6):
            raise Fault("wrong", "the function returns different values for the same arguments")
        self.compare(got[:-1], states, 1e-6, "differs from the reference.")
        return f"agrees with the reference at {N_STATES} random states"

    def _judge_design(self, values: list[Array]) -> str:
        reason = self.mistake(lambda made: made(self.numbers, *values))
        try:
            requirements: list[Requirement] = self.reference(self.numbers, *map(float, values))
        except (ArithmeticError, ValueError) as error:  # Diverged and InvalidArgument are such
            raise Fault("wrong", f"it cannot be simulated, {describe(error)}.{reason}") from None
        words = "; ".join(
            f"{'met' if x < bound else 'NOT met'}: {name} {x:.3g} {unit}, must be below {bound:g}"
            for name, x, bound, unit in requirements
        )
        if not all(x < bound for _, x, bound, _ in requirements):
            raise Fault("wrong", f"{words}.{reason}")
        return words

    def compare(self, got: list[Array], states: list[Any], tolerance: float, words: str) -> None:
        """Raise `Fault` with the diagnosis if values differ from the reference at the states."""

        def agrees(twin: Callable[..., Any]) -> bool:
            each = (np.array(twin(self.numbers, *copy.deepcopy(state)), float) for state in states)
            return _close(got, each, tolerance)

        def scaled(scale: float) -> bool:
            return agrees(lambda *given: scale * self.reference(*given))

        if not agrees(self.reference):
            factors = (text for factor, text in _FACTORS.items() if scaled(factor) or scaled(1 / factor))
            diagnosis = (
                self.mistake(agrees) or next(factors, "") or self._wrong_entries(got, states, tolerance)
            )
            raise Fault("wrong", f"{words} {diagnosis.strip()}".rstrip())

    def _wrong_entries(self, got: list[Array], states: list[Any], tolerance: float) -> str:
        """Return the indices of the entries that differ at any state, or nothing if all of them do."""
        right = np.array([self.reference(self.numbers, *copy.deepcopy(state)) for state in states], float)
        off = np.abs(np.array(got) - right).max(axis=0) > tolerance * np.abs(right).max()
        places = ", ".join(str(place.tolist()) for place in np.argwhere(off))
        return f"Wrong are the entries {places}, counted from 0." if off.any() and not off.all() else ""

    def mistake(self, agrees: Callable[[Callable[..., Any]], Any]) -> str:
        """Return the diagnosis of the first known mistake that agrees with the answer, or nothing."""
        names, scope = ("p", *self.arguments), self.reference.__globals__
        for text, words in self.mistakes:
            if agrees(lambda *given, text=text: eval(text, scope, dict(zip(names, given, strict=True)))):
                return f" {words}"
        return ""

    def cells(self) -> tuple[str, str]:
        """Return the code of the answer's cell and of the check's cell."""
        names, given = ", ".join(self.arguments), self.name
        answer = f"{given} = ...  # [{self.unit}]"
        if self.draw is not None:
            answer = f"def {given}({names}):\n    ..."
        elif names:
            answer, given = f"{names} = {', '.join('...' for _ in self.arguments)}", f"({names})"
        return answer, f"ask.{self.name}.check({given})"


def _entries(answer: object) -> list[object]:
    """Return the entries of a tuple or list, and anything else as one entry."""
    return list(answer) if isinstance(answer, tuple | list) else [answer]


def describe(error: BaseException) -> str:
    """Return the type and the message of an error, shortened."""
    try:
        return f"{type(error).__name__}: {error}"[:200].rstrip(": \n")
    except Exception:
        return type(error).__name__


def _is_library(value: object) -> bool:
    """Return whether an object comes from pinmobile or Pinocchio."""
    home = getattr(value, "__module__", None) or getattr(value, "__name__", "")
    return str(home).partition(".")[0] in ("pinmobile", "pinocchio")


def _call(answer: Callable[..., Any], arguments: Iterable[Any]) -> Any:
    """Return the value of a student's function; refuse one that calls the library."""
    used: list[str] = []

    def watch(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and not used:
            names, scope = frame.f_code.co_names, frame.f_globals
            used.extend(name for name in names if _is_library(scope.get(name)))
            if str(scope.get("__name__")).startswith("pinmobile."):
                used.append(frame.f_code.co_name)

    own, before = copy.deepcopy(tuple(arguments)), sys.getprofile()
    try:
        sys.setprofile(watch)
        try:
            value = answer(*own)
        finally:
            sys.setprofile(before)
    except NotImplementedError:
        return None  # no answer yet
    except (Exception, SystemExit) as error:
        if not used:
            raise Fault("failed", f"the function raised {describe(error)}") from None
    if used:
        raise Fault("wrong", f"the function uses {used[0]} of the library; here it must compute the result")
    return value


def _as_array(value: Any, shape: tuple[int, ...], words: str) -> Array:
    """Return a copy of what a student wrote or returned, as an array of the given shape."""
    if value is None or value is ...:
        raise Fault("empty", _EMPTY)
    try:
        got = np.array(np.nan if isinstance(value, str | bool) else value, dtype=float)
    except (Exception, SystemExit):
        got = np.array(np.nan)
    if np.isfinite(got).all() and (got.shape == shape or (got.size == 1 and not shape)):
        return got.reshape(shape)
    given = f"of shape {got.shape}" if np.isfinite(got).all() else "not finite"
    expected = f"finite numbers of shape {shape}" if shape else "a finite number"
    raise Fault("wrong", f"{words} {type(value).__name__} {given}, expected {expected}")


def _close(one: Iterable[Array], other: Iterable[Array], tolerance: float) -> bool:
    """Return whether all arrays agree to a part of the largest entry."""
    return all(
        a.shape == b.shape and np.abs(a - b).max() <= tolerance * max(np.abs(b).max(), 1e-3)
        for a, b in zip(one, other, strict=True)
    )


_F = TypeVar("_F", bound=Callable[..., Any])
_COURSE = tomllib.loads((Path(__file__).parent / "course.toml").read_text("utf-8"))
_EXERCISES: dict[str, dict[str, str]] = _COURSE["exercises"]
EXERCISE_NAMES = [*_EXERCISES]


class Questions(SimpleNamespace):
    """Questions by name; the ``repr`` lists them with their points."""

    def __repr__(self) -> str:
        return "\n".join(map(repr, vars(self).values()))


class Numbers(SimpleNamespace):
    """Numbers of a course, as attributes."""

    if TYPE_CHECKING:

        def __getattribute__(self, name: str, /) -> float: ...

    def but(self, **values: float) -> Numbers:
        """Return the numbers with other values: what a mistake assumes."""
        return Numbers(**vars(self) | values)


def course_numbers(names: str, course: str) -> Numbers:
    """Return the numbers of a course, drawn from its name."""

    def draw(name: str) -> float:
        low, high, step, *_ = _COURSE["numbers"][name]
        steps = int(Random(f"{course}/{name}").random() * (round((high - low) / step) + 1))
        return float(round(low + steps * step, 6))

    return Numbers(**{name: draw(name) for name in names.split()})


def uniform(
    *sizes: int, low: float = -3.0, high: float = 3.0
) -> Callable[[Numbers, np.random.Generator], tuple[Any, ...]]:
    """Return a function that draws arrays of the given sizes; size 0 is a number."""
    return lambda _, rng: tuple(rng.uniform(low, high, n or None) for n in sizes)


@dataclass(frozen=True)
class Exercise:
    """A set of questions with one introduction.

    Parameters
    ----------
    name : str
        Its name in ``course.toml``, which has its title and introduction, and the names of its numbers.
    """

    name: str
    parts: list[tuple[Callable[..., Any], dict[str, Any]]] = field(default_factory=list, repr=False)

    @property
    def title(self) -> str:
        """First line of the text, without its full stop."""
        return str(_EXERCISES[self.name]["text"]).splitlines()[0].rstrip(".")

    def __call__(
        self, points: int, draw: Callable[..., Any] | None = None, unit: str = ""
    ) -> Callable[[_F], _F]:
        """Return a decorator that makes a reference a question for a function, a number or a design.

        The docstring of the function contains the task, hints after ``?``, and known mistakes after ``!``: an
        expression for the wrong result, ``=>``, and the diagnosis.
        """

        def register(reference: _F) -> _F:
            self.parts.append((reference, {"points": points, "draw": draw, "unit": unit}))
            return reference

        return register

    def questions(self, course: str) -> list[Question]:
        """Return the questions with the numbers of a course."""
        numbers, questions = course_numbers(_EXERCISES[self.name]["symbols"], course), []
        for reference, fixed in self.parts:
            text, *lines = re.split(r"^(?=[?!] )", inspect.getdoc(reference) or "", flags=re.M)
            items = [" ".join(line.split()) for line in lines]
            hints = [item[2:] for item in items if item[0] == "?"]
            mistakes = [item[2:].split(" => ") for item in items if item[0] == "!"]
            name, key = reference.__name__, f"{self.name}/{course}/{reference.__name__}"
            questions.append(Question(name, key, text.strip(), hints, mistakes, reference, numbers, **fixed))
        return questions

    def notebook(self, course: str) -> dict[str, Any]:
        """Return the notebook for students: tasks, empty answers and checks."""
        questions, (_, _, text) = self.questions(course), _EXERCISES[self.name]["text"].partition("\n")
        numbers = vars(questions[0].numbers)
        start = f'ask = load_exercise("{self.name}", seed="{course}")'
        total, rules = sum(each.points for each in questions), _COURSE["rules"].format(questions[0].name)
        rows = {key: (value, *_COURSE["numbers"][key][3:]) for key, value in numbers.items()}
        lines = [f"{key} = {value:g}  # {text} [{unit or 1}]" for key, (value, unit, text) in rows.items()]
        head = f"# {self.title} ({total} points)\n{text}\n{rules}"
        setup = f"import numpy as np\n\nfrom pinmobile.exercises import load_exercise\n\n{start}\n"
        cells = [_cell(0, "markdown", head), _cell(1, "code", setup + "\n".join(lines))]
        for letter, each in zip("abcdefgh", questions, strict=False):
            task = f"## {letter} {each!r}".replace("_", " ") + f"\n\n{each.text}"
            for kind, source in zip(("markdown", "code", "code"), (task, *each.cells()), strict=True):
                cells.append(_cell(len(cells), kind, source))
        kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
        metadata = {"kernelspec": kernel, "pinmobile": {"exercise": self.name, "seed": course}}
        return {"cells": cells, "metadata": metadata, "nbformat": 4, "nbformat_minor": 5}


def _cell(number: int, kind: str, source: str) -> dict[str, Any]:
    cell: dict[str, Any] = {"cell_type": kind, "id": f"cell-{number:02}", "metadata": {}, "source": source}
    return cell | ({"outputs": [], "execution_count": None} if kind == "code" else {})


def read_exercise(name: str) -> Exercise:
    """Return the exercise of a name.

    Raises
    ------
    UnknownName
        If there is none.
    """
    module, _, attribute = _EXERCISES[one_of("exercise", name, EXERCISE_NAMES)]["place"].partition(".")
    exercise: Exercise = getattr(import_module(f"pinmobile.exercises.{module}"), attribute)
    return exercise


def check_course(course: object) -> str:
    """Return the name of a course.

    Raises
    ------
    InvalidArgument
        If it is no text, or contains signs that a notebook cannot store.
    """
    return matching("seed", course, r"[\w .:+-]*", "letters, digits, spaces and _ . : + -")


def load_exercise(name: str, *, seed: str = "") -> SimpleNamespace:
    """Return the questions of an exercise, as attributes.

    Parameters
    ----------
    name : str
        Name of the exercise, such as ``"01_equations"``.
    seed : str
        Name of the course, from which the numbers are drawn.

    Returns
    -------
    ask : SimpleNamespace
        Questions by name: ``ask.transform.check(transform)``, ``ask.transform.hint()``. Its ``repr`` lists
        them with their points.

    Raises
    ------
    UnknownName
        If there is no such exercise.
    InvalidArgument
        If the seed contains other signs than letters, digits, spaces and ``_ . : + -``.

    See Also
    --------
    exercises.start_exercises : notebooks for students

    Examples
    --------
    >>> from pinmobile.exercises import load_exercise
    >>> ask = load_exercise("01_equations", seed="ROB-2026")
    >>> ask.coupling
    coupling (1 point)
    >>> ask.coupling.check(3.0)
    wrong  0/1  coupling: 3 kg m is not the value.
    """
    questions = read_exercise(name).questions(check_course(seed))
    return Questions(**{each.name: each for each in questions})
