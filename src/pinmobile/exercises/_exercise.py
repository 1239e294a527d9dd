"""An exercise: its questions, the numbers of a course, and the notebook for students."""

from __future__ import annotations

import inspect
import re
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from pinmobile.errors import InvalidArgument, UnknownName, format_value
from pinmobile.exercises._question import Question

_F = TypeVar("_F", bound=Callable[..., Any])
_COURSE = tomllib.loads((Path(__file__).parent / "course.toml").read_text("utf-8"))


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
        Name of the module that defines it.
    text : str
        Title, and after it the introduction.
    symbols : str
        Names of the course's numbers that it uses.
    """

    name: str
    text: str
    symbols: str
    parts: list[tuple[Callable[..., Any], dict[str, Any]]] = field(default_factory=list, repr=False)

    @property
    def title(self) -> str:
        """First line of the text, without its full stop."""
        return self.text.splitlines()[0].rstrip(".")

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
        numbers, questions = course_numbers(self.symbols, course), []
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
        questions, numbers = self.questions(course), vars(course_numbers(self.symbols, course))
        start = f'ask = load_exercise("{self.name}", seed="{course}")'
        total, rules = sum(each.points for each in questions), _COURSE["rules"].format(questions[0].name)
        rows = {key: (value, *_COURSE["numbers"][key][3:]) for key, value in numbers.items()}
        lines = [f"{key} = {value:g}  # {text} [{unit or 1}]" for key, (value, unit, text) in rows.items()]
        head = f"# {self.title} ({total} points)\n{self.text.partition(chr(10))[2]}\n{rules}"
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


def exercise_names() -> list[str]:
    """Return the names of all exercises."""
    return sorted(path.stem[1:] for path in Path(__file__).parent.glob("_[0-9]*.py"))


def read_exercise(name: str) -> Exercise:
    """Return the exercise of a name.

    Raises
    ------
    UnknownName
        If there is none.
    """
    if name not in exercise_names():
        raise UnknownName("exercise", name, exercise_names())
    exercise: Exercise = import_module(f"pinmobile.exercises._{name}").EXERCISE
    return exercise


def check_course(course: object) -> str:
    """Return the name of a course.

    Raises
    ------
    InvalidArgument
        If it is no text, or contains signs that a notebook cannot store.
    """
    if not isinstance(course, str) or not re.fullmatch(r"[\w .:+-]*", course):
        raise InvalidArgument(
            f"seed is {format_value(course)}, expected letters, digits, spaces and _ . : + -"
        )
    return course


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
