"""The tool around exercises: it lists them, writes notebooks for students, and checks notebooks."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pinmobile.arrays import bounded, scalar
from pinmobile.errors import InvalidArgument, format_value
from pinmobile.exercises._exercise import (
    EXERCISE_NAMES,
    RECORD,
    Verdict,
    check_course,
    describe,
    read_exercise,
)
from pinmobile.files import file_errors

_LOADED = re.compile(
    r"""^[^#\n]*load_exercise\(\s*["'](\w+)["'](?:\s*,\s*seed\s*=\s*["']([\w .:+-]*)["'])?\s*\)""", re.M
)
_CHILD = "from pinmobile.exercises._tool import run_file; run_file()"
_STATES = ("passed", "wrong", "failed", "empty")


def list_exercises() -> str:
    """Return the names, points and titles of all exercises, one a line.

    Returns
    -------
    text : str
        A line for each exercise.

    See Also
    --------
    exercises.start_exercises : notebooks for students

    Examples
    --------
    >>> from pinmobile.exercises import list_exercises
    >>> print(list_exercises().splitlines()[1])
    02_methods       6 questions, 12 points  Exercise 2: model against model
    """
    lines = []
    for name in EXERCISE_NAMES:
        exercise = read_exercise(name)
        questions = exercise.questions("")
        points = sum(each.points for each in questions)
        lines.append(f"{name:16} {len(questions)} questions, {points:2} points  {exercise.title}")
    return "\n".join(lines)


def start_exercises(folder: str | os.PathLike[str] = "exercises", *, seed: str = "") -> list[str]:
    """Write the notebooks for students; leave files that are there already.

    Parameters
    ----------
    folder : path-like
        Folder for the notebooks, which is made where there is none.
    seed : str
        Name of the course, from which the numbers are drawn.

    Returns
    -------
    lines : list of str
        What happened to each notebook.

    Raises
    ------
    InvalidArgument
        If the folder cannot be made, or the name of the course has other signs than letters, digits, spaces
        and ``_ . : + -``.

    See Also
    --------
    exercises.check_exercises : points of the notebooks

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from pinmobile.exercises import start_exercises
    >>> with TemporaryDirectory() as folder:
    ...     len(start_exercises(folder, seed="ROB-2026"))
    6
    """
    home, lines = Path(folder), []
    check_course(seed)
    with file_errors("written", "FOLDER", home):
        home.mkdir(parents=True, exist_ok=True)
        for name in EXERCISE_NAMES:
            path = home / f"{name}.ipynb"
            if not path.exists():
                notebook = read_exercise(name).notebook(seed)
                path.write_text(json.dumps(notebook, indent=1) + "\n", encoding="utf-8")
                lines.append(str(path))
            else:
                lines.append(f"{path} exists, left as it is")
    return lines


@dataclass(frozen=True)
class Report:
    """Result of the check of one notebook.

    Parameters
    ----------
    name : str
        Path of the file.
    course : str
        Name of the course.
    verdicts : tuple of Verdict
        Last verdict of each question of the exercise.
    notes : tuple of str
        Errors of cells, and why the run ended early.
    """

    name: str
    course: str
    verdicts: tuple[Verdict, ...]
    notes: tuple[str, ...]

    @property
    def is_complete(self) -> bool:
        """Whether each question has passed."""
        return bool(self.verdicts) and all(self.verdicts)

    def __str__(self) -> str:
        points, out_of = (sum(getattr(each, key) for each in self.verdicts) for key in ("points", "out_of"))
        course = f", course {self.course}" if self.course else ""
        lines = [f"{self.name}{course}: {points} of {out_of} points"]
        return "\n  ".join([*lines, *map(repr, self.verdicts), *self.notes])


def check_exercises(
    files: Iterable[str | os.PathLike[str]], *, seed: str | None = None, limit: float = 60.0
) -> Iterator[Report]:
    """Run notebooks one by one, each in a process of its own, and return the verdicts.

    Parameters
    ----------
    files : iterable of path-like
        Notebooks (.ipynb) or py:percent files (.py).
    seed : str, optional
        Name of the course that the notebooks must have; default: any.
    limit : float
        Longest time for a notebook [s].

    Returns
    -------
    reports : iterator of Report
        One for each file, once it has been checked. A file that cannot be read has a note, no verdicts.

    Raises
    ------
    InvalidArgument
        If the limit is not above 0, or the name of the course has signs that it may not have.

    See Also
    --------
    exercises.start_exercises : notebooks for students

    Examples
    --------
    >>> from pinmobile.exercises import check_exercises
    >>> (report,) = check_exercises(["no such file.ipynb"])
    >>> report.is_complete
    False
    """
    bounded("limit", scalar("limit", limit), above=0, below=1e6, unit="s")
    course = None if seed is None else check_course(seed)
    return (_check(Path(file), course, limit) for file in files)


def read_cells(path: Path) -> tuple[list[str], str, str]:
    """Return the code cells of a notebook or of a py:percent file, and the names of exercise and course.

    Raises
    ------
    InvalidArgument
        If the file is no notebook of an exercise.
    """
    expected = "expected a notebook (.ipynb or .py) that pinmobile exercises start wrote"
    try:
        text = path.read_text(encoding="utf-8")
        if path.suffix == ".ipynb":
            stored = (each for each in json.loads(text)["cells"] if each["cell_type"] == "code")
            cells = ["".join(each["source"]) for each in stored]
        else:
            cells = re.split(r"^# %%.*$", text, flags=re.M)
    except (OSError, ValueError, KeyError, TypeError) as error:
        reason = error.strerror if isinstance(error, OSError) else describe(error)
        raise InvalidArgument(f"FILE is {format_value(str(path))}, {expected} ({reason})") from None
    loaded = _LOADED.search("\n".join(cells))
    if loaded is None or loaded[1] not in EXERCISE_NAMES:
        raise InvalidArgument(f"FILE is {format_value(str(path))}, {expected}: no cell calls load_exercise")
    return cells, loaded[1], loaded[2] or ""


def _check(path: Path, given_course: str | None, limit: float) -> Report:
    """Run the cells, and return the last verdict of each question with the numbers of the course."""
    try:
        cells, name, own = read_cells(path)
    except InvalidArgument as error:
        return Report(str(path), "", (), (str(error),))
    course, found, notes = own if given_course is None else given_course, dict[str, Any](), list[str]()
    if own != course:
        notes.append(f"the notebook has the numbers of course {own or '(none)'}, expected {course}")
    with tempfile.TemporaryDirectory() as folder:
        program, sheet = Path(folder, "cells.json"), Path(folder, "sheet.jsonl")
        program.write_text(json.dumps(cells), encoding="utf-8")
        end = _run_child([str(program), str(sheet)], path.parent, limit)
        lines = sheet.read_text("utf-8", "replace").splitlines() if sheet.is_file() else []
    for line in lines:
        with suppress(ValueError, TypeError):  # of lines that the notebook wrote itself
            key, state, words = json.loads(line)
            found[key] = (state if state in _STATES else "failed", str(words)[:900])
            notes += [found[key][1][:300]] if key == "note" else []
    verdicts = []
    for each in read_exercise(name).questions(course):
        state, words = found.get(each.key, ("empty", "no verdict: its check did not run"))
        verdicts.append(Verdict(each.key, state, words, each.points * (state == "passed"), each.points))
    notes = notes[:20] if "end" in found else [*notes[:20], end]
    return Report(str(path), course, tuple(verdicts), tuple(notes))


def _run_child(words: Sequence[str], folder: Path, limit: float) -> str:
    """Run the cells in a process group of its own, and return why it may have ended early."""
    search = f"{Path(__file__).parents[2]}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    options: dict[str, Any] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.DEVNULL)
    options["env"] = os.environ | {"MPLBACKEND": "Agg", "PYTHONPATH": search}
    command = [sys.executable, "-c", _CHILD, *words]
    with subprocess.Popen(command, cwd=folder, start_new_session=True, **options) as child:
        with suppress(subprocess.TimeoutExpired):
            child.wait(limit)
        reason = "ended its own process" if child.poll() is not None else f"was stopped after {limit:g} s"
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(child.pid, signal.SIGKILL)
    return f"the notebook {reason}"


def run_file() -> None:
    """Run the cells of a file and write a line of JSON for each verdict: the work of the process."""
    program, path = sys.argv[1:3]
    sys.argv[1:] = []
    with open(path, "a", buffering=1, encoding="utf-8") as sheet:
        cells = json.loads(Path(program).read_text("utf-8"))
        run_cells(cells, lambda *entry: sheet.write(json.dumps(entry) + "\n"))


def run_cells(cells: Iterable[str], write: Callable[[str, str, str], object]) -> None:
    """Run cells one after the other.

    Parameters
    ----------
    cells : iterable of str
        Code of the cells.
    write : callable
        Receives key, state and words of each verdict; the key is "note" for errors, and "end" at last.
    """
    names: dict[str, Any] = {"__name__": "__main__", "display": print}
    token = RECORD.set(lambda verdict: write(verdict.question, verdict.state, verdict.words))
    for number, source in enumerate(cells, 1):
        try:
            exec(_compile(source, number), names)
        except BaseException as error:
            write("note", "failed", f"code cell {number}: {describe(error)}")
    RECORD.reset(token)
    write("end", "passed", "")


def _compile(source: str, number: int) -> Any:
    """Return the code of a cell; commands of the notebook (% and !) are left out."""
    try:
        return compile(source, f"<cell {number}>", "exec")
    except SyntaxError:
        return compile(re.sub(r"^[ \t]*[%!?].*$", "", source, flags=re.M), f"<cell {number}>", "exec")
