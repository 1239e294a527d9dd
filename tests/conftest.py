"""Settings for all tests, and what several of them take."""

import gc
import os
import signal
import sys
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
settings.register_profile("default", deadline=None, max_examples=30)
settings.register_profile("ci", deadline=None, max_examples=30, derandomize=True)
settings.register_profile("repeated", settings.get_profile("ci"), max_examples=15)
PROFILE = "ci" if os.environ.get("CI") else "default"
settings.load_profile(PROFILE)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add how `.ci/run` repeats tests."""
    words = (
        "of each N tests the K-th, from 0, without pages and what is marked `once`: what a Python may change"
    )
    parser.addoption("--part", metavar="K/N", default="", help=words)


LONGEST: tuple[str, ...]
LONGEST = "notebooks", "cli", "identification", "viewer", "viewer_windows", "viewer_browser", "real_logs"
LONGEST += "readme", "export", "derivatives", "arguments", "payload_transfer", "sweeps_cluster", "surface"
LONGEST += ("wrong_model",)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Begin with the files that take longest; take the part that is asked for."""

    def rank(item: pytest.Item) -> int:
        name = item.path.stem.removeprefix("test_")
        return LONGEST.index(name) if name in LONGEST else len(LONGEST)

    items.sort(key=rank)
    this, _, of = config.getoption("--part").partition("/")
    if not this:
        return
    once = [item.get_closest_marker("once") or "page" in getattr(item, "fixturenames", ()) for item in items]
    kept = [item for item, left_out in zip(items, once, strict=True) if not left_out][int(this) :: int(of)]
    taken = set(kept)
    config.hook.pytest_deselected(items=[item for item in items if item not in taken])
    items[:] = kept


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Return a worker more than there are processors: many tests wait for a browser or another process."""
    processors = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count()
    return (processors or 1) + 1


def pytest_configure(config: pytest.Config) -> None:
    """Refuse to test with another kernel than the one that is asked for: a misspelt one is passed over."""
    why = refusal(os.environ.get("OPENBLAS_CORETYPE"))
    if why:
        raise pytest.UsageError(why)
    if config.getoption("--part"):
        settings.load_profile("repeated")
    gc.disable()  # the collection of tests keeps almost all that it makes: garbage collection takes a sixth


def pytest_collection_finish() -> None:
    """Let garbage be collected while tests run."""
    gc.enable()


@pytest.fixture(scope="module", autouse=True)
def frozen_heap() -> None:
    """Exempt what was imported and what earlier files keep from garbage collection."""
    gc.collect()
    gc.freeze()


def pytest_report_header(config: pytest.Config) -> str:
    """Return the kernels of the linear algebra, on which no result may hang."""
    return f"OpenBLAS: {', '.join(in_force().values()) or 'none'}"


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
