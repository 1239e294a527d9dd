"""Settings for all tests, and what several of them take."""

import gc
import os
import signal
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from hypothesis import settings

from pinmobile import MobileRobot
from pinmobile.arrays import Array
from tests.chromium import Chromium, chromium
from tests.kernels import in_force, refusal

# What a shell runs in the background ignores Ctrl-C, which some tests are about.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
# No window is needed, on any machine.
matplotlib.use("Agg")
settings.register_profile("default", deadline=None, max_examples=60)
settings.register_profile("ci", deadline=None, max_examples=60, derandomize=True)
settings.register_profile("repeated", settings.get_profile("ci"), max_examples=20)
PROFILE = "ci" if os.environ.get("CI") else "default"
settings.load_profile(PROFILE)


SHARE = 6  # one of so many alike cases is taken where another Python takes all
MANY = 4  # cases of one test, from which on they are alike


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add how `.ci/run` shares the tests out."""
    words = (
        "of N runs, the K-th, from 0, takes all tests of every N-th file; of other files what a Python may "
        "change, without pages and most alike cases, of which each run takes others"
    )
    parser.addoption("--share", metavar="K/N", default="0/1", help=words)


def shared(config: pytest.Config) -> tuple[int, int]:
    """Return which of how many runs this one is."""
    this, _, of = config.getoption("--share").partition("/")
    if not (this.isdecimal() and of.isdecimal() and int(this) < int(of)):
        raise pytest.UsageError(f"--share is {config.getoption('--share')!r}, expected K/N with K < N")
    return int(this), int(of)


def is_own(config: pytest.Config, path: Path) -> bool:
    """Tell whether this run takes all tests of a file."""
    this, of = shared(config)
    files = sorted(each.name for each in Path(__file__).parent.glob("test_*.py"))
    return path.name in files[this::of]


def pytest_collectstart(collector: pytest.Collector) -> None:
    """Take fewer random examples in the files that another run takes whole."""
    if isinstance(collector, pytest.Module):
        settings.load_profile(PROFILE if is_own(collector.config, collector.path) else "repeated")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Of files that another run takes whole, leave out pages, what is marked ``once``, and alike cases."""
    this, of = shared(config)
    if of == 1:
        return
    seen: Counter[str] = Counter()
    cases = Counter(item.nodeid.partition("[")[0] for item in items)

    def taken(item: pytest.Item) -> bool:
        if is_own(config, item.path):
            return True
        if item.get_closest_marker("once"):
            return False
        test = item.nodeid.partition("[")[0]
        if item.get_closest_marker("alike") or cases[test] >= MANY:
            seen[test] += 1
            return seen[test] % SHARE == this % SHARE
        return "page" not in getattr(item, "fixturenames", ())

    kept: dict[bool, list[pytest.Item]] = {True: [], False: []}
    for item in items:
        kept[taken(item)].append(item)
    config.hook.pytest_deselected(items=kept[False])
    items[:] = kept[True]


def pytest_configure(config: pytest.Config) -> None:
    """Refuse to test with another kernel than the one that is asked for: a misspelt one is passed over."""
    why = refusal(os.environ.get("OPENBLAS_CORETYPE"))
    if why:
        raise pytest.UsageError(why)


def pytest_collection_finish() -> None:
    """Let the garbage collector pass over what was imported: it lives to the end of the tests."""
    gc.collect()
    gc.freeze()


def pytest_report_header(config: pytest.Config) -> str:
    """Return the kernels of the linear algebra, on which no result may hang."""
    return f"OpenBLAS: {', '.join(in_force().values()) or 'none'}"


@pytest.fixture(scope="module")
def share(request: pytest.FixtureRequest) -> int:
    """Return of how many random cases one is taken."""
    return 1 if is_own(request.config, request.path) else SHARE


@pytest.fixture(scope="session")
def browser() -> Iterator[Chromium]:
    """Return a browser that all tests share."""
    with chromium() as started:
        yield started


@pytest.fixture
def offset_robot() -> MobileRobot:
    """Return a robot whose centre of mass is not at its origin."""
    return MobileRobot(10.0, 1.2, com=(0.15, 0.05))


@pytest.fixture
def states() -> tuple[Array, Array, Array, Array]:
    """Return q, v, a and tau of shape (40, 3), headings near +-pi and states of rest among them."""
    rng = np.random.default_rng(7)
    q, v, a, tau = rng.normal(size=(4, 40, 3))
    q[:, 2] = rng.uniform(-10, 10, 40)
    q[:4, 2] = np.pi, -np.pi, np.nextafter(np.pi, 4), np.pi / 2
    v[4:6] = 0
    v[6, 2] = 1e-9
    return q, v, a, tau
