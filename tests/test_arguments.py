"""What comes of wrong arguments: one table of faults by kind, and a fuzz of every public callable.

FAULTS is the table: kinds of fault, an example of each that once ended in somebody else's error or in a wrong
number, and what the user is told. docs/site/reference/error-promises.md has its kinds in words. The fuzz,
tests/arguments.py, tries some thirty wrong values for every argument of what users call, in a process of its
own.
"""

import copy
import inspect
import json
import pickle
import re
import subprocess
import sys
import tomllib
import warnings
from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

import pinmobile
import pinmobile as pm
from pinmobile import closed_form
from pinmobile.arrays import finite
from pinmobile.cli import main
from pinmobile.errors import NotFinite, UnknownName
from pinmobile.loop import TRUE_MODEL
from pinmobile.urdf import shipped_urdf
from pinmobile.viewer import Viewer
from tests.arguments import ROWS

ROOT = Path(__file__).parents[1]
ROBOT = pm.MobileRobot.box()
ON_WHEELS = pm.WheeledRobot(ROBOT, pm.WheelTable.differential(0.4, 0.1))
CIRCLE = pm.Circle(radius=3, rate=0.1, duration=60)
PARTS = ROBOT, pm.PD(120, 120), pm.Tangent(CIRCLE)
LOOP: dict[str, Any] = {**dict(zip(("plant", "controller", "trajectory"), PARTS, strict=True)), "dt": 0.1}
MANY: dict[str, Any] = {**dict(zip(("robot", "controller", "trajectory"), PARTS, strict=True)), "dt": 0.1}
MANY |= {"n": 3, "spread": {"mass": pm.Uniform(29, 31)}, "engine": pm.Engine.COMPILED}
MASKED: Any = np.ma.masked_array([1.0, 2.0, 3.0], [False, True, False])
RAGGED: Any = [[1, 2], [3]]
NOTHING: Any = None
EMPTY: Any = []


def hidden() -> Any:
    """Return a mask within a list of arrays."""
    return [np.ma.masked_array([1.0, 2.0], [False, True]), [3.0, 4.0]]


def of_many(**changed: Any) -> Callable[[], Any]:
    """Return a call of `ensemble` with some arguments changed."""
    return lambda: pm.ensemble(**MANY | changed)


def of_loop(**changed: Any) -> Callable[[], Any]:
    """Return a call of `simulate` with some arguments changed."""
    return lambda: pm.simulate(**LOOP | changed)


FAULTS: dict[str, list[tuple[Any, ...]]] = {
    "another kind": [
        (lambda: shipped_urdf(NOTHING), "unknown shipped URDF None, available: box, lecture", UnknownName),
        (lambda: ROBOT.attach(pm.PayloadBody(1), frame=EMPTY), "unknown frame [], available: ", UnknownName),
        (
            lambda: ON_WHEELS.forward_dynamics(np.zeros(5), np.zeros(5), [1, 1], 3.0),
            "f has shape (), expected (..., 5)",
        ),
    ],
    "no numbers": [
        (lambda: pm.InputSaturation(pm.PD(1, 1), RAGGED), "limits is [[1, 2], [3]], expected real numbers"),
    ],
    "masked numbers": [
        (lambda: pm.ConstantForce(MASKED), "force is a masked array, expected an array without a mask"),
        (lambda: finite("q", hidden()), "q is a masked array, expected an array without a mask"),
        (lambda: closed_form.mass_matrix(MASKED, mass=1, yaw_inertia=1), "q is a masked array"),
    ],
    "beyond the largest number": [
        (
            lambda: closed_form.nonlinear_effects([0, 0, 0], [0, 0, 1e308], mass=1, com=(1, 0)),
            "the result is -inf for |q| up to 0, |v| up to 1e+308",
            NotFinite,
        ),
    ],
    "too much": [
        (of_many(substeps=10**12), "substeps is 1000000000000, expected at most 166,389,351"),
        (of_loop(dt=6e-07), "the records of 100,000,001 samples take 38.4 GB"),
    ],
    "no text": [
        (lambda: ROBOT.mount("ur5", name="a,b"), "name is 'a,b', expected a word without / ,"),
        (lambda: Viewer(ROBOT, live=True, host="[::1"), "host is '[::1', expected a name or an address"),
    ],
    "another part": [
        (of_loop(trajectory=CIRCLE), "a path, which has no heading, expected a trajectory: wrap the path"),
        (
            of_loop(trajectory=pm.PosePath(pm.Spline([[0, 0, 1], [1, 0, 1]], [0, 1]))),
            "a path of poses of an end effector, expected a trajectory of the robot's coordinates, such as",
        ),
        (of_loop(integrator=pm.PD(1, 1)), "a controller, expected an integrator, such as pinmobile.rk4"),
        (of_loop(plant=pm.MobileRobot), "and the sizes nq, nv, nu: an object, not a class"),
        (lambda: pm.Tangent(cast(Any, pm.Circle)), "expected an object: Circle(...)"),
    ],
    "another signature": [
        (
            of_loop(controller=pm.UnicycleTracking()),
            "a kinematic law goes into Backstepping, VelocityCommand or",
        ),
        (lambda: pm.law(cast(Any, lambda t, q: np.zeros(3))), "which cannot be called as function("),
        (of_loop(integrator=lambda q, v: (q, v)), "which cannot be called as integrator("),
        (lambda: pm.PD(1, 1, difference=lambda q: q), "which cannot be called as difference(q0, q1)"),
    ],
    "another shape returned": [
        (
            of_loop(controller=pm.law(lambda t, q, v, reference: [1.0, 2.0])),
            "controller returned array([1., 2.]) at t = 0 s, expected an array of shape (3,)",
        ),
        (of_loop(forces=[lambda t, q, v: np.zeros(2)]), "forces[0] returned array([0., 0.]) at t = 0 s"),
        (of_loop(integrator=lambda acceleration, t, q, v, dt: q), "expected (q, v) of shapes (3,) and (3,)"),
    ],
    "too long a step": [
        (
            of_loop(forces=[pm.ViscousFriction([1000, 1000, 0])]),
            "needs steps of the integrator of at most 0.06 s, and they are 0.1 s: give a smaller",
            pm.Diverged,
        )
    ],
}


@pytest.mark.parametrize(
    "fault", [pytest.param(row, id=f"{kind}: {row[1][:40]}") for kind, rows in FAULTS.items() for row in rows]
)
def test_a_fault_is_told_by_name(fault: tuple[Any, ...]) -> None:
    call, text, error = (*fault, pm.InvalidArgument)[:3]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(error) as caught:
            call()
    assert text in str(caught.value)
    assert len(str(caught.value)) < 2_000


def test_the_page_on_errors_tells_of_each_kind_of_the_table() -> None:
    page = (ROOT / "docs/site/reference/error-promises.md").read_text()
    assert re.findall(r"^\| ([^|]+?) \| [^|]+ \|$", page, re.MULTILINE)[1:] == [*FAULTS]
    for path in re.findall(r"`(tests/[^`]+)`", page):
        assert (ROOT / path).is_file()


def test_every_part_and_function_of_the_top_level_has_a_row() -> None:
    named = {name: getattr(pinmobile, name) for name in pinmobile.__all__}
    taken = {name for name, value in named.items() if inspect.isfunction(value) or is_made(value)}
    assert taken - READ <= set(ROWS)
    assert taken >= READ


READ = {"Loop", "Ensemble", "Reference", "Rollout", "Sweep"}
"""What the library makes and users read."""


def is_made(value: Any) -> bool:
    """Return whether a value is a class whose objects users make."""
    if not inspect.isclass(value) or issubclass(value, Exception | Enum):
        return False
    return not getattr(value, "_is_protocol", False)


@pytest.fixture(scope="module")
def fuzzed(request: pytest.FixtureRequest) -> dict[str, Any]:
    """Run the trials in a process of their own: a crash, or memory without bound, ends only that process."""
    test = test_wrong_values_end_in_an_error_of_the_library_or_an_answer.__name__
    asked = {item.name for item in request.session.items}
    names = [name for name in sorted(ROWS) if f"{test}[{name}]" in asked]
    words = [sys.executable, "-W", "ignore::DeprecationWarning", "-m", "tests.arguments", *names]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False, timeout=1800)
    found = {line["name"]: line for line in map(json.loads, done.stdout.splitlines())}
    assert done.returncode == 0, f"{done.returncode} after {list(found)[-1:]}: {done.stderr[-2000:]}"
    return found


@pytest.mark.long
@pytest.mark.parametrize("name", ROWS)
def test_wrong_values_end_in_an_error_of_the_library_or_an_answer(name: str, fuzzed: dict[str, Any]) -> None:
    assert fuzzed[name]["wrong"] == []


@pytest.mark.parametrize("one", [pm.Engine.PYTHON, pm.Engine.COMPILED, TRUE_MODEL], ids=["P", "C", "T"])
def test_engines_and_the_true_model_come_back_as_themselves(one: Any) -> None:
    assert pickle.loads(pickle.dumps(one)) is one
    assert copy.copy(one) is one
    assert copy.deepcopy(one) is one


def test_the_true_model_is_read_only() -> None:
    assert dict(TRUE_MODEL)["controller.mass"] == pm.SameAs("plant.mass")
    with pytest.raises(TypeError, match="does not support item assignment"):
        TRUE_MODEL["controller.mass"] = pm.SameAs("yaw_inertia")  # type: ignore[index]


def test_a_scenario_file_may_be_nested_deep(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "deep.toml"
    file.write_text("a = " + "[" * 5_000 + "]" * 5_000)
    with pytest.raises(RecursionError):
        tomllib.loads(file.read_text())
    assert main(["sweep", str(file)]) == 2
    assert "deep.toml: its values are nested too deep" in capsys.readouterr().err


INTERRUPTED = """
import sys

class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            raise KeyboardInterrupt

sys.modules.pop({module!r}, None)  # what the interpreter begins with differs
sys.meta_path.insert(0, Interrupting())
sys.argv = ["/usr/bin/pinmobile", "parts"]
from pinmobile.cli import main
sys.exit(main())
"""


@pytest.mark.parametrize("module", ["typer", "pinmobile.loop"])
def test_an_interrupt_while_the_command_loads_shows_no_traceback(module: str) -> None:
    words = [sys.executable, "-c", INTERRUPTED.format(module=module)]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=600)
    assert (done.returncode, done.stderr) == (130, "pinmobile: interrupted\n")


def test_packages_of_extras_are_those_of_the_project() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    kept = project["optional-dependencies"]

    def names(extra: str) -> set[str]:
        found: set[str] = set()
        for requirement in kept[extra]:
            own = re.fullmatch(r"pinmobile\[([\w,]+)\]", requirement)
            found |= (
                set().union(*map(names, own[1].split(","))) if own else {re.split(r"[>=<; ]", requirement)[0]}
            )
        return found

    for extra, packages in pm.errors.EXTRAS.items():
        assert set(packages) == names(extra)
