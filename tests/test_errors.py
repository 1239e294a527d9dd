import pickle
import re

import numpy as np
import pytest

from pinmobile.arrays import finite
from pinmobile.errors import Diverged, FileError, InvalidArgument, PinmobileError, UnknownName, ViewerError


def test_every_error_is_a_pinmobile_error_and_a_builtin_one() -> None:
    pairs = {InvalidArgument: ValueError, UnknownName: KeyError, Diverged: ArithmeticError}
    for error, builtin in (pairs | {ViewerError: RuntimeError, FileError: OSError}).items():
        assert issubclass(error, PinmobileError)
        assert issubclass(error, builtin)


def test_unknown_name_lists_the_names_there_are_the_nearest_first() -> None:
    error = UnknownName("trajectory", "circel", ["via-stop", "circle"])
    assert str(error) == "unknown trajectory 'circel', did you mean 'circle'? available: circle, via-stop"
    copy = pickle.loads(pickle.dumps(error))
    assert str(copy) == str(error)
    assert copy.available == ("via-stop", "circle")


def test_unknown_name_states_that_there_are_none() -> None:
    assert str(UnknownName("metric", "gap", [])) == "unknown metric 'gap', available: none"


def test_names_that_a_terminal_would_obey_are_quoted_and_the_first_of_many_listed() -> None:
    error = UnknownName("topic", "\x1b[2J", ["/odom", "/odo\x1b[2Jm", *(f"/topic{k}" for k in range(9999))])
    assert str(error).startswith(
        "unknown topic '\\x1b[2J', did you mean '/odo\\x1b[2Jm'? available: '/odo\\x1b[2Jm', /odom, /topic0, "
    )
    assert str(error).isprintable()
    assert re.search(r", /topic\d+ and 9,\d{3} more$", str(error))
    assert len(error.available) == len(error.listed) == 10_001


def test_an_argument_is_known_by_name_and_may_be_called_otherwise() -> None:
    with pytest.raises(InvalidArgument) as refused:
        finite("com", [0.0, np.nan])
    error = refused.value
    assert (error.argument, str(error)) == ("com", "com[1] is nan, expected a finite number")
    copy = pickle.loads(pickle.dumps(error.calling("--model-com")))
    assert (copy.argument, str(copy)) == ("--model-com", "--model-com[1] is nan, expected a finite number")
    assert InvalidArgument("kp has shape (2,), expected ()").argument == "kp"


def test_file_error_has_what_the_system_said_also_from_another_process() -> None:
    error = FileError("disk is full", errno=28, filename="a/b")
    copy = pickle.loads(pickle.dumps(error))
    assert (str(copy), copy.errno, copy.filename) == ("disk is full", 28, "a/b")
    assert copy.args == ("disk is full",)
