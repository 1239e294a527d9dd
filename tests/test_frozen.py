"""What the library computes and prints is what it did before."""

import json
import warnings
from functools import cache
from typing import Any

import numpy as np
import pytest

from tests.frozen import FILE, frozen

pytestmark = pytest.mark.once


@cache
def both() -> tuple[dict[str, Any], dict[str, Any]]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return json.loads(FILE.read_text()), frozen()


@pytest.mark.parametrize("kind", ["compiled", "ensembles", "tables"])
def test_bits_and_tables_are_as_they_were(kind: str) -> None:
    before, now = (found[kind] for found in both())
    assert now == before


@pytest.mark.parametrize(("kind", "near"), [("lapack", 1e-12), ("python", 1e-9)])
def test_numbers_are_as_they_were(kind: str, near: float) -> None:
    before, now = (found[kind] for found in both())
    assert list(now) == list(before)
    for name, numbers in before.items():
        size = np.abs(numbers).max()
        np.testing.assert_allclose(now[name], numbers, rtol=near, atol=near * size, err_msg=name)
