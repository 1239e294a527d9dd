"""Every public name is documented: a summary, related names, and an example, which runs among the tests."""

import inspect
import re
import runpy
from pathlib import Path

import pytest

PUBLIC: dict[str, object] = runpy.run_path(str(Path(__file__).parents[1] / "docs" / "public.py"))["find"]()
# A constant or an alias has no docstring of its own.
DOCUMENTED = {name: each for name, each in PUBLIC.items() if inspect.isclass(each) or inspect.isroutine(each)}


@pytest.mark.parametrize("name", DOCUMENTED)
def test_it_has_related_names_that_exist_and_a_short_example(name: str) -> None:
    text = inspect.getdoc(DOCUMENTED[name]) or ""
    example = text.split("\nExamples\n--------\n")[1]
    lines = [line for line in example.splitlines() if line.startswith((">>> ", "... "))]
    assert 1 <= sum(line.startswith(">>> ") for line in lines) <= 12
    assert all(len(line) <= 72 for line in lines)
    related = text.split("\nSee Also\n--------\n")[1].split("\n\n")[0]
    rows = re.findall(r"^([\w., ]+)(?: :|$)", related, re.MULTILINE)
    assert rows
    for one in (each.strip().removeprefix("pinmobile.") for row in rows for each in row.split(",")):
        assert one in PUBLIC or one.rpartition(".")[0] in PUBLIC, one
