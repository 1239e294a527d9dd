"""What CONTRIBUTING says of adding a part: its examples run, and its file and package alone know its name."""

import ast
import re
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import pinmobile
from pinmobile import controllers, forces, paths, trajectories
from pinmobile.parts._registry import public_names
from tests.test_readme import output
from tests.test_surface import nodes_of

ROOT = Path(__file__).parents[1]
CONTRIBUTING = (ROOT / "CONTRIBUTING.md").read_text()
SOURCE = Path(pinmobile.__file__).parent


def _public(package: ModuleType) -> dict[str, Any]:
    return {name: getattr(package, name) for name in getattr(package, "__all__", vars(package))}


def _parts(*packages: ModuleType) -> list[str]:
    kinds = [(name, one) for package in packages for name, one in _public(package).items()]
    own = tuple(package.__name__ for package in packages)
    classes = [
        (name, kind)
        for name, kind in kinds
        if isinstance(kind, type) and name in public_names() and kind.__module__.startswith(own)
    ]
    return [name for name, kind in classes if not getattr(kind, "_is_protocol", False)]


PARTS = _parts(controllers, forces)
REFERENCES = [name for name in _parts(paths, trajectories) if name not in ("Reference", "Whole")]
# Parts that a file uses to get its own work done, as a user does, not to know them from others.
USERS = {
    "accuracy.py": {"ComputedTorque", "Circle", "Tangent"},
    "cli/lecture.py": {
        *("PD", "ControlAllocation", "Backstepping", "ComputedTorque", "UnicycleTracking"),
        *("Circle", "CubicVia", "LectureHeading", "Tangent"),
    },
    "cli/scenario_file.py": {"Circle", "ComputedTorque", "Tangent"},  # where a file says nothing
    "exercises/_control.py": {"PD", "ComputedTorque", "Circle", "FixedHeading", "Hold", "Spline", "Tangent"},
    "exercises/_wheel_forces.py": {"Backstepping", "UnicycleTracking", "Circle", "Tangent"},
    "identification/_planar_model.py": {"JointFriction", "RollingResistance", "ViscousFriction"},
    "identification/_torque_car.py": {"JointFriction"},  # what was found
    "reaching/poses.py": {"Spline"},  # of positions, through poses
    "trajectories/reference.py": {"Hold"},
}
ALSO_A_DELAY = {
    *("plant.py", "loop/_trace.py"),
    *(f"compiled/{file}.py" for file in ("__init__", "identity", "memory")),
}


def test_the_examples_print_what_follows_them() -> None:
    names: dict[str, object] = {"__name__": "examples"}
    blocks = re.findall(r"```python\n(.*?)```(?:\n\n```text\n(.*?)```)?", CONTRIBUTING, re.DOTALL)
    assert sum(bool(printed) for _, printed in blocks) == 9
    for code, printed in blocks:
        assert output(code, names) == printed


def test_each_kind_of_part_has_a_short_example() -> None:
    sections = dict(re.findall(r"### An? (\w+)\n(.*?)(?=\n### |\Z)", CONTRIBUTING, re.DOTALL))
    assert " ".join(sections) == "controller wrapper force integrator path heading plant ground figure"
    for text in sections.values():
        assert text.count("```python") == 1
        assert len(text.splitlines()) < 75


def test_every_file_and_folder_that_is_named_is_there() -> None:
    named = re.findall(r"`((?:src|tests|pinmobile)/[\w/.]*|\.ci/run|CHANGELOG\.md)`", CONTRIBUTING)
    assert len(named) > 8
    for path in named:
        assert (ROOT / path).exists() or (ROOT / "src" / path).exists(), path


@cache
def names_in(file: Path) -> set[str]:
    """Return the names that a module's code has: imported, read, or asked of another; not words of text."""
    found: set[str] = set()
    for node in nodes_of(file):
        if isinstance(node, ast.Name):
            found.add(node.id)
        elif isinstance(node, ast.Attribute):
            found.add(node.attr)
        elif isinstance(node, ast.ImportFrom):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ClassDef):
            found.add(node.name)
    return found


def where(name: str) -> set[str]:
    """Return the files that know a name."""
    return {file.relative_to(SOURCE).as_posix() for file in SOURCE.rglob("*.py") if name in names_in(file)}


def test_the_parts_are_those_of_the_library() -> None:
    assert {"PD", "ComputedTorque", "InputSaturation", "MeasurementDelay", "NoiseForce"} < set(PARTS)


@pytest.mark.parametrize("name", [*PARTS, *REFERENCES])
def test_a_part_is_known_by_its_own_file_and_its_package_alone(name: str) -> None:
    part = public_names()[name]
    own = Path(*part.__module__.split(".")[1:]).with_suffix(".py")
    allowed = {own.as_posix(), (own.parent / "__init__.py").as_posix(), "__init__.py"}
    allowed |= {file for file, used in USERS.items() if name in used}
    allowed |= ALSO_A_DELAY if name == "DelayLine" else set()  # of `Context.delay`
    assert where(name) <= allowed
    of_package = {(own.parent / "__init__.py").as_posix()} - {"__init__.py"}  # a module lists nothing
    assert {own.as_posix(), *of_package} <= where(name)


def test_no_file_asks_a_part_what_it_is() -> None:
    """``type(x) is PD`` and ``isinstance(x, PD)`` would be a registry of one."""
    asked = []
    for file in SOURCE.rglob("*.py"):
        for node in nodes_of(file):
            if isinstance(node, ast.Compare) and "type" in {
                call.func.id
                for call in ast.walk(node.left)
                if isinstance(call, ast.Call) and isinstance(call.func, ast.Name)
            }:
                compared = {
                    each.id
                    for side in node.comparators
                    for each in ast.walk(side)
                    if isinstance(each, ast.Name)
                }
                asked += [(file.name, name) for name in compared & set(PARTS)]
    assert not asked
