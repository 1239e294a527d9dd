"""Exercises: answers that are right, wrong, empty and hostile; the notebooks, and the command."""

import functools
import importlib
import inspect
import json
import re
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import nbformat
import numpy as np
import pytest

from pinmobile import dh
from pinmobile.cli import main
from pinmobile.exercises import check_exercises, list_exercises, load_exercise, start_exercises
from pinmobile.exercises._exercise import EXERCISE_NAMES, Question, read_exercise
from pinmobile.exercises._tool import run_cells

COURSES = ("", "ROB-26", "Mobile robots: 2nd year")
each = pytest.mark.parametrize("name", EXERCISE_NAMES)
QUESTIONS = [question for name in EXERCISE_NAMES for question in read_exercise(name).questions("")]
asked = pytest.mark.parametrize("question", QUESTIONS, ids=lambda question: question.key.replace("/", "-"))


def answers(name: str) -> ModuleType:
    """Return the module of answers to an exercise."""
    return importlib.import_module(f"tests.exercises.{name[3:]}")


@functools.cache
def solutions(name: str) -> dict[str, str]:
    """Return the code of the answer to each question."""
    text = Path(str(answers(name).__file__)).read_text()
    return dict(re.findall(r"^# %% (\w+)\n(.*?)(?=^# %%)", text, re.MULTILINE | re.DOTALL))


def is_design(question: Question) -> bool:
    """Return whether the answer is a few numbers for a simulation."""
    return question.draw is None and not question.unit


def cells(name: str, course: str = "", **changed: str) -> list[str]:
    """Return the code cells of a notebook with answers."""
    stored = [
        cell["source"]
        for cell in read_exercise(name).notebook(course)["cells"]
        if cell["cell_type"] == "code"
    ]
    for k, question in enumerate(read_exercise(name).questions(course)):
        assert not {question.name, *(question.arguments if is_design(question) else ())} & set(
            vars(question.numbers)
        )
        assert question.cells() == (stored[1 + 2 * k], stored[2 + 2 * k])
        stored[1 + 2 * k] = (solutions(name) | changed)[question.name]
    return stored


def run(code: list[str]) -> list[tuple[str, str]]:
    """Run cells in this process, and return states and words of all verdicts."""
    written: list[tuple[str, str]] = []
    run_cells(code, lambda _, state, words: written.append((state, words)))
    assert written.pop() == ("passed", "")
    return written


@each
@pytest.mark.parametrize("course", COURSES)
def test_right_answers_earn_all_points(name: str, course: str) -> None:
    written = run(cells(name, course))
    assert [state for state, _ in written] == ["passed"] * len(read_exercise(name).parts), written
    assert sum(question.points for question in read_exercise(name).questions(course)) == 12


@each
def test_the_notebook_of_a_student_has_no_answers_and_they_are_empty(name: str) -> None:
    notebook = read_exercise(name).notebook("ROB-26")
    nbformat.validate(nbformat.reads(json.dumps(notebook), as_version=4))  # type: ignore[no-untyped-call]
    text = json.dumps(notebook)
    for code in solutions(name).values():
        longest = max(re.findall(r"^(?!def) *(.*)$", code, re.MULTILINE), key=len)
        assert json.dumps(longest)[1:-1] not in text
    assert notebook["metadata"]["pinmobile"] == {"exercise": name, "seed": "ROB-26"}
    own = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert not any(cell["outputs"] for cell in own)
    written = run([cell["source"] for cell in own])
    assert {state for state, _ in written} == {"empty"}
    assert all(words.startswith("nothing is written yet, or `return` is missing") for _, words in written)


@each
def test_the_package_contains_no_line_of_an_answer(name: str) -> None:
    source = Path(inspect.getfile(read_exercise(name).parts[0][0])).read_text()
    lines = {
        line.strip().removeprefix("return ")
        for code in solutions(name).values()
        for line in code.splitlines()
    }
    assert [line for line in lines if len(line) > 12 and not line.startswith("def ") and line in source] == []


@each
def test_mistakes_of_size_and_shape_and_of_designs_are_named(name: str) -> None:
    names: dict[str, Any] = {}
    exec("\n".join(cells(name, "ROB-26")), names)
    for question, old, new, words in answers(name).MISTAKES:
        code = solutions(name)[question]
        assert old in code, (question, old)
        own = dict(names)
        exec(code.replace(old, new), own)
        verdict = eval(getattr(names["ask"], question).cells()[1], own)
        assert (verdict.state, verdict.points) == ("wrong", 0)
        assert words in verdict.words, verdict


@each
def test_a_diagnosis_belongs_to_one_mistake_in_any_course(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pinmobile.exercises._exercise._call", lambda answer, state: answer(*state))
    total = set()
    for course in map(str, range(2)):
        for question in read_exercise(name).questions(course):
            total |= {words for _, words in question.mistakes}
            assert len({words for _, words in question.mistakes}) == len(question.mistakes)
            if course != "0" and not question.unit:
                continue
            for text, words in question.mistakes:
                if question.draw is not None:
                    verdict = question.check(functools.partial(_evaluate, text, question))
                    assert words in verdict.words, (course, verdict)
                elif question.unit:
                    assert words in question.check(_evaluate(text, question)).words, (course, text)
    assert len(total) >= 20


def _evaluate(text: str, question: Question, *state: object) -> Any:
    names = dict(zip(("p", *question.arguments), (question.numbers, *state), strict=True))
    return eval(text, question.reference.__globals__, names)


@asked
def test_hints_come_one_by_one(question: Question, capsys: pytest.CaptureFixture[str]) -> None:
    own = getattr(load_exercise(question.key.split("/")[0]), question.name)
    assert own.hints
    for _ in range(len(own.hints) + 2):
        own.hint()
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(": ")[0] for line in lines[:-2]] == [
        f"Hint {k + 1} of {len(own.hints)}" for k in range(len(own.hints))
    ]
    assert lines[-1] == lines[-2] == "That was the last hint. The notebook of the lecture has the derivation."


def _stop(*_: object) -> None:
    sys.exit(0)


def _endless(*given: object) -> object:
    return _endless(*given)


def _change(*given: Any) -> Any:
    for each in given:
        if isinstance(each, np.ndarray):
            each[...] = np.nan
    return given[0]


JUNK: dict[str, Any] = {
    "text": "text",
    "object": object(),
    "array": np.zeros((2, 3)),
    "huge": 10**400,
    "no arguments": lambda: 1,
    "shape": lambda *_: np.eye(7),
    "not finite": lambda *_: np.full((3, 3), np.nan),
    "exit": _stop,
    "recursion": _endless,
    "change": _change,
    "generator": lambda *_: (yield 1),
}


@asked
def test_junk_earns_no_points_nor_an_error(question: Question, capsys: pytest.CaptureFixture[str]) -> None:
    for name, junk in JUNK.items():
        for answer in (junk, (junk, junk)) if is_design(question) else (junk,):
            verdict = question.check(answer)
            assert not verdict, name
            assert verdict.points == 0
            assert 10 < len(verdict.words) < 600
            assert "did not work" not in verdict.words, (name, verdict)
    assert capsys.readouterr().out in ("", "0\n")


def test_wrong_entries_are_named_where_no_mistake_is_known() -> None:
    def one_cosine_wrong(alpha: float, a: float, theta: float, d: float) -> Any:
        T = dh.transform(alpha, a, theta, d)
        return np.where(np.arange(16).reshape(4, 4) == 7, 0.0, T)

    question = load_exercise("01_equations").transform
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pinmobile.exercises._exercise._call", lambda answer, state: answer(*state))
        verdict = question.check(one_cosine_wrong)
    assert verdict.words == "differs from the reference. Wrong are the entries [1, 3], counted from 0."


def test_an_unfinished_answer_is_empty() -> None:
    def unfinished(*_: object) -> None:
        raise NotImplementedError

    for answer in (None, (..., ...), unfinished):
        assert load_exercise("01_equations").transform.check(answer).state == "empty"


@pytest.mark.parametrize(
    "code",
    [
        "answer = pinmobile.MobileRobot(30, 1.3).mass_matrix",
        "answer = functools.partial(pinmobile.closed_form.mass_matrix, mass=1, yaw_inertia=1, com=(0, 0))",
        "ask = pinmobile.exercises.load_exercise('01_equations').mass_matrix\n"
        "def answer(q): return ask.reference(ask.numbers, q)",
        "model = pinmobile.MobileRobot(30, 1.3).model\n"
        "def answer(q): return pinocchio.crba(model, model.createData(), q)",
        "def helper(q):\n    try: return pinmobile.MobileRobot(30, 1.3).mass_matrix(q)\n"
        "    except Exception: return np.eye(3)\n"
        "def answer(q): return helper(q)",
    ],
)
def test_the_library_is_no_answer(code: str) -> None:
    names: dict[str, Any] = {"__name__": "__main__"}
    exec(f"import numpy as np, pinmobile, pinocchio, functools\n{code}", names)
    verdict = load_exercise("01_equations").mass_matrix.check(names["answer"])
    assert verdict.state == "wrong"
    assert "of the library; here it must compute the result" in verdict.words


def test_a_function_that_remembers_or_changes_its_results_is_refused() -> None:
    question = read_exercise("01_equations").questions("")[3]
    calls: list[int] = []

    def counting(q: Any) -> Any:
        calls.append(1)
        return np.eye(3) * len(calls)

    assert "different values for the same arguments" in question.check(counting).words
    shared = np.eye(3)

    def sharing(q: Any) -> Any:
        shared[...] += q[0]
        return shared

    assert "different values" in question.check(sharing).words


def test_numbers_in_other_units_are_recognised() -> None:
    question = next(each for each in QUESTIONS if each.name == "circle_error")
    right = question.reference(question.numbers)
    assert question.check(right).state == question.check(np.array([right])).state == "passed"
    assert question.check(np.float32(right * 1.001))
    assert not question.check(right * 1.01)
    for factor, words in ((-1, "sign"), (1e3, "mm and m"), (57.29578, "degrees"), (0.5, "factor of 2")):
        assert words in question.check(factor * right).words


def test_courses_have_their_own_numbers_and_the_same_on_every_machine() -> None:
    drawn = [read_exercise("08_wheels").questions(course)[0].numbers for course in COURSES]
    assert len({tuple(vars(each).values()) for each in drawn}) == len(COURSES)
    assert vars(drawn[1]) == EXPECTED
    same = read_exercise("01_equations").questions("ROB-26")[0].numbers
    assert (same.m, same.I_cz) == (EXPECTED["m"], EXPECTED["I_cz"])
    written = run([cells("04_control", "A")[0], *cells("04_control", "B")[1:]])
    assert {state for state, _ in written} == {"passed"}  # answers by the notebook's numbers
    numbers = [
        question.reference(question.numbers) for question in read_exercise("04_control").questions("A")[3:5]
    ]
    asked_of_b = read_exercise("04_control").questions("B")[3:5]
    assert not any(question.check(value) for question, value in zip(asked_of_b, numbers, strict=True))


EXPECTED = {
    **{"m": 37.0, "I_cz": 1.55, "x_bc": 0.17, "y_bc": 0.07, "r_w": 0.08},
    **{"b": 0.27, "I_w": 0.006, "l_s": 0.52, "mu": 0.38},
}


# The command


Typed = Callable[..., tuple[int, str, str]]


@pytest.fixture
def typed(capsys: pytest.CaptureFixture[str]) -> Typed:
    """Return what runs words and returns the exit code and what was printed."""
    return lambda *words: (main(["exercises", *map(str, words)]), *capsys.readouterr())


@pytest.fixture
def solved(tmp_path: Path) -> Path:
    """Return a notebook with right answers, and its folder with all notebooks."""
    start_exercises(tmp_path, seed="ROB-26")
    path = tmp_path / "01_equations.ipynb"
    notebook = json.loads(path.read_text())
    sources = iter(cells("01_equations", "ROB-26"))
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            cell["source"] = next(sources).splitlines(keepends=True)
    path.write_text(json.dumps(notebook))
    return path


def test_start_writes_notebooks_and_leaves_those_that_exist(typed: Typed, tmp_path: Path) -> None:
    assert typed("list") == (0, f"{list_exercises()}\n", "")
    assert len(re.findall(r"^\w+ +[67] questions, 12 points", list_exercises(), re.MULTILINE)) == 6
    folder = tmp_path / "new" / "course"
    code, out, _ = typed("start", folder, "--seed", "ROB-26")
    assert code == 0
    assert sorted(path.stem for path in folder.iterdir()) == EXERCISE_NAMES
    assert f"pinmobile exercises check {folder}/01_equations.ipynb" in out
    (folder / "02_methods.ipynb").write_text("mine")
    code, out, _ = typed("start", folder)
    assert code == 0
    assert out.count("exists, left as it is") == len(EXERCISE_NAMES)
    assert (folder / "02_methods.ipynb").read_text() == "mine"
    (tmp_path / "file").touch()
    code, _, err = typed("start", tmp_path / "file")
    assert code == 2
    assert "FOLDER is" in err
    assert typed("start", folder, "--seed", 'a"b')[0] == 2


def test_check_prints_points_and_says_whether_all_is_complete(typed: Typed, solved: Path) -> None:
    code, out, err = typed("check", solved, "--seed", "ROB-26")
    assert (code, err) == (0, "")
    assert out.startswith(f"{solved}, course ROB-26: 12 of 12 points\n  passed 2/2  transform: agrees")
    code, out, _ = typed("check", solved, "--seed", "another")
    assert code == 1
    assert "0 of 12 points" in out
    assert "the notebook has the numbers of course ROB-26, expected another" in out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["check", "missing.ipynb"], "FILE is 'missing.ipynb', expected a notebook"),
        (["check", "other.py"], "no cell calls load_exercise"),
        (["check", "list.ipynb"], "TypeError"),
        (["check", "good.py", "--limit", "0"], "limit is 0.0 s, expected 0 < limit < 1000000 s"),
        (["check", "good.py", "--seed", "a/b"], "seed is 'a/b'"),
    ],
)
def test_wrong_words_end_with_code_2(
    typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("other.py").write_text("# load_exercise('01_equations')\n")
    Path("list.ipynb").write_text("[1]")
    Path("good.py").write_text("ask = load_exercise('01_equations')\n")
    code, out, err = typed(*words)
    assert (code, out) == (2, "")
    assert said in err


HOSTILE = """# %%
import os, sys, time
import numpy as np
from pinmobile.exercises import load_exercise
ask = load_exercise('04_control')
# %%
%matplotlib inline
!ls
def critical(omega):
    return omega
# %%
ask.critical.check(critical)
# %%
sys.exit(0)
# %%
raise KeyboardInterrupt
# %%
print("x" * 10_000_000)
# %%
def broken(
# %%
ask.critical.check = lambda answer: True
# %%
keep, np.array = np.array, None
ask.pd_force.check(lambda *given: given[0])
np.array = keep
# %%
ask.circle_error.check(np.float64(1e-300))
# %%
ask.circle_error.check(1.0)
# %%
sys.stdout.close()
np.random.seed = np.abs = print
# %%
ask.largest_step.check(2.0)
# %%
os._exit(0 if "quiet" in os.environ else 7)
# %%
ask.gains.check((6.76, 5.2))
"""


def test_hostile_notebooks_are_run_to_their_end_without_a_traceback(typed: Typed, tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(HOSTILE)
    code, out, err = typed("check", path)
    assert (code, err) == (1, "")
    lines = [line.strip() for line in out.splitlines()]
    assert lines[0] == f"{path}: 0 of 12 points"
    assert lines[1].startswith("wrong  0/2  critical: the function returns")
    assert lines[2].startswith("failed 0/2  pd_force: the check did not work (TypeError")
    assert lines[4].startswith("wrong  0/1  circle_error: 1 m is not the value")
    assert lines[6] == "empty  0/3  gains: no verdict: its check did not run"
    assert lines[7:9] == ["code cell 5: SystemExit: 0", "code cell 6: KeyboardInterrupt"]
    assert lines[9].startswith("code cell 8: SyntaxError")
    assert lines[10].startswith("code cell 9: FrozenInstanceError")
    assert lines[-1] == "the notebook ended its own process"
    assert "Traceback" not in out


STUBBORN = """
ask = load_exercise('01_equations')
# %%
import subprocess, sys, time
child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)'])
open('pid', 'w').write(str(child.pid))
while True:
    try:
        time.sleep(600)
    except BaseException:
        pass
"""


def test_a_notebook_that_cannot_be_interrupted_is_stopped_with_its_processes(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(STUBBORN)
    start = time.monotonic()
    (report,) = check_exercises([path], limit=6)
    assert time.monotonic() - start < 15
    assert report.notes[-1] == "the notebook was stopped after 6 s"
    assert not report.is_complete
    time.sleep(0.1)
    state = Path("/proc", (tmp_path / "pid").read_text(), "stat")
    assert not state.exists() or state.read_text().split()[2] == "Z"


FORGED = """
ask = load_exercise('01_equations')
# %%
import gc, io, json
files = [each for each in gc.get_objects() if type(each) is io.TextIOWrapper]
(sheet,) = [each for each in files if "sheet.jsonl" in str(each.name)]
sheet.write('[1]\\n{}\\n["01_equations//pose", "great", ""]\\n["note", "", "' + "x" * 10_000 + '"]\\n')
"""


def test_records_that_a_notebook_makes_up_are_not_believed(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(FORGED)
    (report,) = check_exercises([path], limit=30)
    assert str(report).splitlines()[0] == f"{path}: 0 of 12 points"
    assert len(str(report)) < 2000
