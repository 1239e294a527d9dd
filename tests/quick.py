"""Which cases of a long family `make test` keeps."""

from collections.abc import Iterable

import pytest
from _pytest.mark.structures import ParameterSet


def every_fifth(names: Iterable[str]) -> list[ParameterSet]:
    """Return names as parameters of a test; all but every fifth are long."""
    return [pytest.param(name, marks=[pytest.mark.long] * bool(k % 5)) for k, name in enumerate(names)]
