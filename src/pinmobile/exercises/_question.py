"""Questions of an exercise, and the verdicts on answers: functions, numbers and designs."""

from __future__ import annotations

import copy
import html
import inspect
import os
import sys
import warnings
from collections.abc import Callable, Iterable
from contextlib import redirect_stdout
from contextvars import ContextVar
from dataclasses import dataclass, field
from types import FrameType
from typing import Any, NamedTuple

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


class TimeLimit(BaseException):
    """A cell takes longer than it may."""


class Fault(Exception):
    """An answer that earns nothing: state and reason of its verdict."""


class Requirement(NamedTuple):
    """One requirement of a design: the value must be below the bound."""

    name: str
    value: float
    bound: float
    unit: str

    def __str__(self) -> str:
        met = "met" if self.value < self.bound else "NOT met"
        return f"{met}: {self.name} {self.value:.3g} {self.unit}, must be below {self.bound:g}"


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

    def _repr_html_(self) -> str:
        color = {"passed": "#0a6b2e", "empty": "#555555"}.get(self.state, "#9c3d00")
        return f'<div style="border-left: 4px solid {color}; padding: 0.3em">{html.escape(repr(self))}</div>'


# Receives each verdict; a file that is checked has a function of its own here.
RECORD: ContextVar[Callable[[Verdict], object]] = ContextVar("RECORD", default=lambda _: None)


@dataclass(frozen=True, kw_only=True)
class Question:
    """A question with points, hints and the diagnoses of known mistakes.

    Parameters
    ----------
    name : str
        Name of the answer in the notebook.
    key : str
        Exercise, course and name.
    points : int
        Points of a right answer.
    text : str
        The task.
    hints : tuple of str
        Hints, from the first to the most explicit.
    mistakes : tuple of pairs of str
        Expression for the answer with a mistake (for a design: whether it was made), and its diagnosis.
    reference : callable
        Function of the course's numbers and the arguments of the answer.
    numbers : object
        Numbers of the course, as attributes.
    """

    name: str
    key: str
    points: int
    text: str
    hints: tuple[str, ...]
    mistakes: tuple[tuple[str, str], ...]
    reference: Callable[..., Any] = field(repr=False)
    numbers: Any = field(repr=False)
    given: list[str] = field(default_factory=list, repr=False)

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
        except TimeLimit:
            state, words = "failed", "the answer takes longer than the time limit; is there an endless loop?"
        except (Exception, SystemExit) as error:
            state, words = "failed", f"the check did not work ({describe(error)}); restart and run all cells"
        verdict = Verdict(self.key, state, words, self.points if state == "passed" else 0, self.points)
        RECORD.get()(verdict)
        return verdict

    def judge(self, answer: Any) -> str:
        """Return why the answer is right, or raise `Fault`."""
        raise NotImplementedError

    def cells(self) -> tuple[str, str]:
        """Return the code of the answer's cell and of the check's cell."""
        raise NotImplementedError

    def mistake(self, agrees: Callable[[Callable[..., Any]], Any]) -> str:
        """Return the diagnosis of the first known mistake that agrees with the answer, or nothing."""
        names, scope = ("p", *self.arguments), self.reference.__globals__
        for text, words in self.mistakes:
            if agrees(lambda *given, text=text: eval(text, scope, dict(zip(names, given, strict=True)))):
                return f" {words}"
        return ""

    def factor(self, agrees: Callable[[Callable[..., Any]], Any]) -> str:
        """Return the diagnosis of a result that is wrong by a factor only, or nothing."""
        for factor, words in _FACTORS.items():
            for scale in (factor, 1 / factor):
                if agrees(lambda *given, scale=scale: scale * self.reference(*given)):
                    return f" {words}"
        return ""


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


def _as_array(value: Any, shape: tuple[int, ...]) -> Array:
    """Return a copy of what a student's function returned, as an array of the given shape."""
    if value is None or value is ...:
        raise Fault("empty", f"{_EMPTY}, and return the result")
    expected = f"an array of shape {shape}" if shape else "a number"
    try:
        got = np.array(value, dtype=float)
    except (Exception, SystemExit):
        raise Fault("wrong", f"the function returns {type(value).__name__}, expected {expected}") from None
    if got.shape != shape:
        raise Fault("wrong", f"the function returns an array of shape {got.shape}, expected {expected}")
    if not np.isfinite(got).all():
        raise Fault("wrong", "the function returns NaN or infinity, expected finite numbers")
    return got


@dataclass(frozen=True, kw_only=True)
class Function(Question):
    """A question for a function, which is compared with the reference at random states.

    Parameters
    ----------
    draw : callable
        Function of the course's numbers and a random generator that returns the arguments.
    """

    draw: Callable[[Any, np.random.Generator], tuple[Any, ...]] = field(repr=False)

    def judge(self, answer: Any) -> str:
        """Compare with the reference, then with known mistakes and factors."""
        if not callable(answer):
            raise Fault("wrong", f"the answer is {type(answer).__name__}, expected a function")
        rng = np.random.default_rng(1)
        states = [self.draw(self.numbers, rng) for _ in range(N_STATES)]

        def values(function: Callable[..., Any]) -> list[Array]:
            return [np.array(function(self.numbers, *copy.deepcopy(state)), dtype=float) for state in states]

        want = values(self.reference)
        with np.errstate(all="ignore"), warnings.catch_warnings(), open(os.devnull, "w") as nowhere:
            warnings.simplefilter("ignore")
            with redirect_stdout(nowhere):
                got = [_as_array(_call(answer, s), each.shape) for s, each in zip(states, want, strict=True)]
                again = _as_array(_call(answer, states[0]), want[0].shape)
        if not _close([again], got[:1]):
            raise Fault("wrong", "the function returns different values for the same arguments")
        if _close(got, want):
            return f"agrees with the reference at {N_STATES} random states"

        def agrees(twin: Callable[..., Any]) -> bool:
            return _close(got, values(twin))

        off = max(np.abs(a - b).max() / max(np.abs(b).max(), 1e-12) for a, b in zip(got, want, strict=True))
        reason = self.mistake(agrees) or self.factor(agrees)
        raise Fault("wrong", f"differs from the reference by up to {off:.1e} of its largest entry.{reason}")

    def cells(self) -> tuple[str, str]:
        """Return the function without its body, and its check."""
        head = f"def {self.name}({', '.join(self.arguments)}):"
        return f"{head}\n    ...", f"ask.{self.name}.check({self.name})"


def _close(one: Iterable[Array], other: Iterable[Array]) -> bool:
    """Return whether all arrays agree to a millionth of the largest entry."""
    return all(
        a.shape == b.shape and np.abs(a - b).max() <= 1e-6 * max(np.abs(b).max(), 1e-3)
        for a, b in zip(one, other, strict=True)
    )


def _as_float(answer: Any, expected: str) -> float:
    """Return a number that a student wrote."""
    try:
        value = np.nan if isinstance(answer, str | bytes | bool) else float(np.array(answer, float).item())
    except (Exception, SystemExit):
        value = np.nan
    if not np.isfinite(value):
        given = answer if isinstance(answer, float) else type(answer).__name__
        raise Fault("wrong", f"the answer is {given}, expected {expected}")
    return value


@dataclass(frozen=True, kw_only=True)
class Number(Question):
    """A question for a number, right to three digits.

    Parameters
    ----------
    unit : str
        Unit of the number.
    """

    unit: str

    def judge(self, answer: Any) -> str:
        """Compare with the reference, then with known mistakes and factors."""
        value = _as_float(answer, f"a number [{self.unit}]")

        def agrees(twin: Callable[..., Any]) -> bool:
            other = float(twin(self.numbers))
            return abs(value - other) <= 2e-3 * abs(other) + 1e-12

        if agrees(self.reference):
            return f"{value:g} {self.unit} is right"
        reason = self.mistake(agrees) or self.factor(agrees)
        raise Fault("wrong", f"{value:g} {self.unit} is not the value.{reason}")

    def cells(self) -> tuple[str, str]:
        """Return the name with dots, and its check."""
        return f"{self.name} = ...  # [{self.unit}]", f"ask.{self.name}.check({self.name})"


@dataclass(frozen=True, kw_only=True)
class Design(Question):
    """A question for a few numbers, which are simulated and judged by requirements."""

    def judge(self, answer: Any) -> str:
        """Simulate, and compare each result with its bound."""
        given = _entries(answer)
        if len(given) != len(self.arguments):
            raise Fault("wrong", f"the answer has {len(given)} numbers, expected {', '.join(self.arguments)}")
        values = [_as_float(each, "a finite number") for each in given]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            reason = self.mistake(lambda made: made(self.numbers, *values))
            try:
                found: list[Requirement] = self.reference(self.numbers, *values)
            except (ArithmeticError, ValueError) as error:  # Diverged and InvalidArgument are such
                raise Fault("wrong", f"it cannot be simulated, {describe(error)}.{reason}") from None
        words = "; ".join(map(str, found))
        if not all(each.value < each.bound for each in found):
            raise Fault("wrong", f"{words}.{reason}")
        return words

    def cells(self) -> tuple[str, str]:
        """Return the names with dots, and their check."""
        names, dots = ", ".join(self.arguments), ", ".join("..." for _ in self.arguments)
        return f"{names} = {dots}", f"ask.{self.name}.check(({names}))"
