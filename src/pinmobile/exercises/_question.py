"""Questions of an exercise, and the verdicts on answers: functions, numbers and designs."""

from __future__ import annotations

import copy
import inspect
import os
import sys
import warnings
from collections.abc import Callable, Iterable
from contextlib import redirect_stdout
from contextvars import ContextVar
from dataclasses import dataclass, field
from types import FrameType
from typing import Any, TypeAlias

import numpy as np

from pinmobile.arrays import Array

N_STATES = 50  # at which a function is compared
_FACTORS = {
    -1.0: "Only the sign is wrong.",
    2.0: "It is wrong by a factor of 2.",
    100.0: "It is wrong by a factor of 100: check the unit (cm and m, per cent and shares).",
    1e3: "It is wrong by a factor of 1000: check the unit (mm and m, g and kg, kN and N).",
    180 / np.pi: "It is wrong by a factor of 57.3: check degrees and radians.",
    2 * np.pi: "It is wrong by a factor of 2 pi: check turns and radians.",
}
_EMPTY = "nothing is written yet; replace the dots"


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
        raise Fault("empty", _EMPTY) from None
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
