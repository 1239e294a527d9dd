"""Settings for all tests, and what several of them take."""

import gc
import os
import signal
import sys
from collections import Counter
from collections.abc import Iterator

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
settings.load_profile("ci" if os.environ.get("CI") else "default")


SHARE = 4  # one of so many alike cases is taken where another Python takes all
MANY = 4  # cases of one test, from which on they are alike


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add what `.ci/run` says on all Pythons but the first."""
    words = "all is tested by another Python: leave out what this one does not change, and most alike cases"
    parser.addoption("--repeated", action="store_true", help=words)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Where that is asked for, leave out pages, what is marked ``once``, and three of four alike cases."""
    if not config.getoption("--repeated"):
        return
    seen: Counter[str] = Counter()
    cases = Counter(item.nodeid.partition("[")[0] for item in items)

    def taken(item: pytest.Item) -> bool:
        if item.get_closest_marker("once"):
            return False
        test = item.nodeid.partition("[")[0]
        if item.get_closest_marker("alike") or cases[test] >= MANY:
            seen[test] += 1
            return seen[test] % SHARE == sys.version_info.minor % SHARE  # each Python takes others
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
    if config.getoption("--repeated"):
        settings.load_profile("repeated")


def pytest_collection_finish() -> None:
    """Let the garbage collector pass over what was imported: it lives to the end of the tests."""
    gc.collect()
    gc.freeze()


def pytest_report_header(config: pytest.Config) -> str:
    """Return the kernels of the linear algebra, on which no result may hang."""
    return f"OpenBLAS: {', '.join(in_force().values()) or 'none'}"


@pytest.fixture(scope="session")
def share(request: pytest.FixtureRequest) -> int:
    """Return of how many random cases one is taken."""
    return SHARE if request.config.getoption("--repeated") else 1


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
