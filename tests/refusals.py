"""What users are told of wrong arguments: single cases, and tables of calls and words."""

import re
from collections.abc import Callable
from typing import Any

import pytest

from pinmobile.errors import InvalidArgument, UnknownName


def refused(words: str) -> Any:
    """Return what checks that an argument is refused in words that a pattern describes."""
    return pytest.raises(InvalidArgument, match=words)


def told(text: str) -> Any:
    """Return what checks that an argument is refused in just these words."""
    return refused(rf"\A{re.escape(text)}\Z")


def begun(text: str) -> Any:
    """Return what checks that an argument is refused in words that begin so."""
    return refused(rf"\A{re.escape(text)}")


def holding(text: str) -> Any:
    """Return what checks that an argument is refused in words that have these among them."""
    return refused(re.escape(text))


def unknown(words: str) -> Any:
    """Return what checks that a name is refused in words that a pattern describes."""
    return pytest.raises(UnknownName, match=words)


def refusals(*rows: tuple[Callable[[], object], str], by: Callable[[str], Any] = refused) -> Any:
    """Return a test: each call is refused in its words."""

    @pytest.mark.parametrize(("call", "words"), rows, ids=[words[:60] for _, words in rows])
    def test(call: Callable[[], object], words: str) -> None:
        with by(words):
            call()

    return test
